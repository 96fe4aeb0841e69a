//! What must stay true of the structure: the arrows of the layers, no knots, a bound for every loop.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use crate::imports::{Graph, circles};

/// The layers from top to bottom: a file uses its own layer and those below. The lowest are crates, `shapelex-…`.
const LAYERS: [&[&str]; 9] = [
    &["cli", "server", "config", "health", "store_location", "telemetry", "testing"],
    DOORS,
    &["service"],
    &["store"],
    &["domain"],
    &["wire", FILES, CRATES[0]],
    &[CRATES[1]],
    &[CRATES[2]],
    &[CRATES[3]],
];

/// The layer of the crate `shapelex-formats`.
const FILES: &str = "files";

/// The layers of arithmetic, each a crate of its own: Cargo keeps their arrows.
const CRATES: [&str; 4] = ["segmentation", "analysis", "geometry", "numeric"];

/// The crate `shapelex-engine`, a workspace and program.
const ENGINE: &str = "engine";

/// The modules through which work comes in: none uses another one.
const DOORS: &[&str] = &["api", "worker"];

/// The first layer that knows nothing of the outer world.
const FIRST_PURE: &str = "wire";

/// Words of the outer world: network, storage, async, clocks, files.
const OUTER_WORDS: [&str; 10] = [
    "axum",
    "http::",
    "hyper",
    "sqlx",
    "tokio",
    "SystemTime",
    "Instant",
    "Timestamp::now",
    "std::net",
    "std::fs",
];

fn level(module: &str) -> Option<usize> {
    LAYERS.iter().position(|layer| layer.contains(&module))
}

/// What is wrong with one file; `path` is that of [`program`].
fn violations(path: &str, text: &str) -> Vec<String> {
    let modules: Vec<&str> = path.trim_end_matches(".rs").trim_end_matches("/mod").split('/').collect();
    let Some(own) = level(modules[0]) else { return vec![format!("{path} belongs to no layer")] };
    let pure = own >= level(FIRST_PURE).unwrap();
    let mut found = Vec::new();
    // Words in comments are allowed: they explain who uses the file.
    let code: Vec<&str> = text.lines().map(|line| line.split("//").next().unwrap()).collect();
    // Cargo keeps the arrows of crates.
    let used = if CRATES.contains(&modules[0]) || modules[0] == FILES {
        BTreeSet::new()
    } else {
        used_modules(&code.join("\n"), modules.len())
    };
    for used in used {
        match level(&used) {
            Some(other) if other == own && used != modules[0] && DOORS.contains(&modules[0]) => {
                found.push(format!("{path} uses another door, {used}"));
            }
            Some(other) if other >= own => {}
            Some(_) => found.push(format!("{path} uses the higher layer {used}")),
            None => found.push(format!("{path} uses {used}, which belongs to no layer")),
        }
    }
    for (number, line) in code.iter().enumerate().filter(|_| pure) {
        for word in OUTER_WORDS.iter().filter(|word| has_word(line, word)) {
            found.push(format!("{path}:{}: {word} is of the outer world", number + 1));
        }
    }
    found
}

/// Top-level modules that the code names: behind `crate::`, and behind enough `super::`.
fn used_modules(code: &str, depth: usize) -> BTreeSet<String> {
    let to_root = "super::".repeat(depth);
    [String::from("crate::"), to_root]
        .iter()
        .flat_map(|root| code.split(root.as_str()).skip(1))
        .flat_map(|rest| match rest.strip_prefix('{') {
            Some(group) => names_of_group(group),
            None => vec![name(rest).to_owned()],
        })
        // `crate::` of a macro's own arguments, or a star.
        .filter(|name| !name.is_empty() && name != "super" && name != "self")
        .collect()
}

pub(crate) fn name(text: &str) -> &str {
    let end = text.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(text.len());
    &text[..end]
}

/// First names of the entries of `a::b, c::{d, e}, f}…`.
fn names_of_group(text: &str) -> Vec<String> {
    let (mut depth, mut entry, mut names) = (0, String::new(), Vec::new());
    for c in text.chars() {
        match c {
            '{' => depth += 1,
            '}' if depth == 0 => break,
            '}' => depth -= 1,
            ',' if depth == 0 => names.push(std::mem::take(&mut entry)),
            c if depth == 0 => entry.push(c),
            _ => {}
        }
    }
    names.push(entry);
    names.iter().map(|entry| name(entry.trim()).to_owned()).collect()
}

fn has_word(line: &str, word: &str) -> bool {
    let is_part = |c: char| c.is_alphanumeric() || c == '_';
    line.match_indices(word).any(|(start, _)| {
        let (before, after) = (&line[..start], &line[start + word.len()..]);
        !before.ends_with(is_part) && (word.ends_with(':') || !after.starts_with(is_part))
    })
}

fn sources(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries
        .flat_map(|path| if path.is_dir() { sources(&path) } else { vec![path] })
        .filter(|path| path.extension().is_some_and(|e| e == "rs"))
        .collect()
}

/// The sources below a folder, by their paths behind `prefix`.
fn files_below(prefix: &str, folder: &Path) -> Vec<(String, String)> {
    let named = |file: PathBuf| {
        let path = file.strip_prefix(folder).unwrap().to_str().unwrap().replace('\\', "/");
        (format!("{prefix}{path}"), std::fs::read_to_string(&file).unwrap())
    };
    sources(folder).into_iter().map(named).collect()
}

/// The sources of the program, by their paths below `src`; those of a crate are in the folder of its layer.
pub(crate) fn program() -> Vec<(String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let crates = CRATES.map(|layer| (format!("{layer}/"), root.join(format!("crates/shapelex-{layer}/src"))));
    let files = (format!("{FILES}/"), root.join("crates/shapelex-formats/src"));
    // Its folders are the layers `store` and `domain`.
    let stored = (String::new(), root.join("crates/shapelex-store/src"));
    let folders = [(String::new(), root.join("src")), stored, files].into_iter().chain(crates);
    folders.flat_map(|(prefix, folder)| files_below(&prefix, &folder)).collect()
}

#[test]
fn the_layers_use_only_what_is_below_them() {
    let files = program();
    assert!(files.len() > 250, "{} files", files.len());
    let inside = files.iter().filter(|(path, _)| path != "lib.rs" && path != "main.rs");
    let found: Vec<String> = inside.flat_map(|(path, text)| violations(path, text)).collect();
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn the_guard_of_the_layers_sees_a_bad_line() {
    let bad = [
        ("wire/svg.rs", "use crate::domain::id;"),
        ("store/mod.rs", "use crate::{domain::id, api::problem::{Problem, self}};"),
        ("service/pool.rs", "use super::super::api;"),
        ("api/v1/mod.rs", "use super::super::config::ServeConfig;"),
        ("wire/svg.rs", "let now = std::time::Instant::now();"),
        ("wire/svg.rs", "use http::StatusCode;"),
        ("numeric/dense.rs", "    tokio::spawn(work);"),
        ("worker/mod.rs", "use crate::api::problem::Problem;"),
        ("api/v1/administration/jobs.rs", "use crate::worker::Worker;"),
        ("jobs/mod.rs", ""),
        ("api/mod.rs", "use crate::jobs;"),
    ];
    for (path, line) in bad {
        assert_eq!(violations(path, line).len(), 1, "{path}: {line}: {:?}", violations(path, line));
    }
    let good = [
        ("cli.rs", "use crate::{api, server};"),
        ("api/v1/administration/jobs.rs", "use crate::api::extract::Prefer;"),
        ("service/compute.rs", "use super::App;\nuse crate::numeric::dense::Matrix;"),
        ("wire/svg.rs", "// once a tokio task\nlet instantaneous = \"http://www.w3.org\";"),
        ("analysis/mean.rs", "use super::{metric, subspace};"),
    ];
    for (path, line) in good {
        assert_eq!(violations(path, line), [""; 0], "{path}: {line}");
    }
}

/// Words that tell kinds of shapes apart.
const KIND_WORDS: [&str; 5] = ["Representation::", ".surface()", ".subdivision()", ".line()", ".generator()"];

/// Lines of a file above the geometry that tell kinds of shapes apart; not those of tests and comments.
fn kind_questions<'a>(path: &str, text: &'a str) -> Vec<&'a str> {
    let asks_freely =
        ["geometry/", "numeric/", "wire/", "files/"].iter().any(|layer| path.starts_with(layer));
    if asks_freely || path.ends_with("/tests.rs") {
        return Vec::new();
    }
    let code = text.split("\n#[cfg(test)]").next().unwrap_or_default();
    let lines = code.lines().map(|line| line.split("//").next().unwrap_or_default().trim());
    lines.filter(|line| KIND_WORDS.iter().any(|word| line.contains(word))).collect()
}

/// A new kind of shape has its code in the geometry, and its JSON in `wire`.
#[test]
fn kinds_of_shapes_are_told_apart_in_the_geometry_only() {
    for (path, text) in program() {
        let found = kind_questions(&path, &text);
        assert!(found.is_empty(), "{path} tells kinds of shapes apart: {found:#?}");
    }
    let bad = "match x {\n    Representation::Landmarks { .. } => {}\n}\nlet a = space.line();";
    assert_eq!(kind_questions("service/shapes/fit.rs", bad).len(), 2);
    assert_eq!(kind_questions("analysis/pca.rs", "// Representation::\n#[cfg(test)]\n.surface()"), [""; 0]);
    assert_eq!(kind_questions("geometry/size.rs", bad), [""; 0]);
}

/// Lines of a file of arithmetic that begin a loop which no range or list ends; not those of tests and comments.
fn open_loops(text: &str) -> Vec<&str> {
    let code = text.split("\n#[cfg(test)]").next().unwrap_or_default();
    let lines = code.lines().map(|line| line.split("//").next().unwrap_or_default().trim());
    lines.filter(|line| line.starts_with("while ") || line.ends_with("loop {")).collect()
}

/// What ends a loop is written down where operators look for limits.
#[test]
fn every_open_loop_of_the_arithmetic_has_its_bound_in_the_table() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let limits = std::fs::read_to_string(root.join("docs/limits.md")).unwrap();
    let rows: Vec<&str> = limits.lines().filter(|line| line.starts_with("| `")).collect();
    for (path, text) in program() {
        let arithmetic = CRATES.contains(&path.split('/').next().unwrap());
        let loops = open_loops(&text);
        if arithmetic && !loops.is_empty() {
            let named = rows.iter().any(|row| row.starts_with(&format!("| `{path}`")));
            assert!(named, "{path} has loops whose bound is not in docs/limits.md: {loops:#?}");
        }
    }
    assert_eq!(
        open_loops("a\n    while x {\n // while\nlet y = loop {\n#[cfg(test)]\nwhile z {"),
        ["while x {", "let y = loop {"]
    );
}

/// Files and tests that a page names as `G/mesh.rs` or `GT/subdivision.rs::name` and that are not there. The short names are explained
/// on the page.
fn missing_from(page: &str) -> Vec<String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = |short: &str| match short {
        "T" => Some("tests/suite".to_owned()),
        "N" | "G" | "A" | "X" | "GT" | "AT" | "XT" => {
            let name = match &short[..1] {
                "N" => "numeric",
                "G" => "geometry",
                "A" => "analysis",
                _ => "segmentation",
            };
            let part = if short.len() == 2 { "tests/suite" } else { "src" };
            Some(format!("crates/shapelex-{name}/{part}"))
        }
        _ => None,
    };
    let is_missing = |text: &&str| {
        let (path, function) = text.split_once("::").map_or((*text, None), |(path, name)| (path, Some(name)));
        let Some((folder, rest)) =
            path.split_once('/').and_then(|(short, rest)| Some((folder(short)?, rest)))
        else {
            return false;
        };
        let Ok(code) = std::fs::read_to_string(root.join(folder).join(rest)) else { return true };
        function.is_some_and(|name| !code.contains(&format!("fn {name}(")))
    };
    let quoted = page.split('`').skip(1).step_by(2).filter(|text| text.contains(".rs"));
    quoted.filter(is_missing).map(str::to_owned).collect()
}

#[test]
fn the_page_of_sources_names_files_and_tests_that_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let page = std::fs::read_to_string(root.join("docs/sources.md")).unwrap();
    assert_eq!(missing_from(&page), [""; 0]);
    assert_eq!(
        missing_from("`G/mesh.rs` `G/no.rs` `GT/main.rs::none` `T/structure.rs::missing_from`"),
        ["G/no.rs", "GT/main.rs::none"]
    );
}

/// The graph of all crates: those of the program, and the engine, which is a workspace.
static IMPORTS: LazyLock<Graph> = LazyLock::new(|| {
    let engine = Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/shapelex-engine/src");
    let all = program().into_iter().chain(files_below(&format!("{ENGINE}/"), &engine));
    // They name everything, and nothing names them.
    let roots = ["lib.rs", "main.rs", "engine/main.rs"];
    let files: Vec<(String, String)> = all.filter(|(path, _)| !roots.contains(&path.as_str())).collect();
    Graph::new(&files, &[CRATES.as_slice(), &[FILES, ENGINE]].concat())
});

/// Most files that import one another in a loop.
const MAX_KNOT: usize = 6;

#[test]
fn no_knot_is_large() {
    let Graph { paths, arrows } = &*IMPORTS;
    assert!(arrows.iter().map(BTreeSet::len).sum::<usize>() > 6000, "imports are not found");
    for knot in circles(arrows) {
        let knot: Vec<&str> = knot.iter().map(|&file| &*paths[file]).collect();
        assert!(knot.len() <= MAX_KNOT, "{} files import one another: {knot:#?}", knot.len());
    }
}

/// The folders whose rooms form no circle: all of the sources together, each crate, and each folder of the program.
fn houses(paths: &[String]) -> BTreeSet<&str> {
    paths.iter().filter_map(|path| Some(path.split_once('/')?.0)).chain([""]).collect()
}

/// The room of a file in a house: the file itself, or the folder in the house that holds it.
fn room<'a>(house: &str, path: &'a str) -> Option<&'a str> {
    let inside = if house.is_empty() { path } else { path.strip_prefix(house)?.strip_prefix('/')? };
    Some(inside.split('/').next()?.trim_end_matches(".rs"))
}

/// Circles of the rooms of a house, as the imports that tie them.
fn circles_of_rooms(house: &str, Graph { paths, arrows }: &Graph) -> Vec<String> {
    let names: BTreeSet<&str> = paths.iter().filter_map(|path| room(house, path)).collect();
    let names: Vec<&str> = names.into_iter().collect();
    let number = |file: usize| names.binary_search(&room(house, &paths[file])?).ok();
    let arrows =
        arrows.iter().enumerate().flat_map(|(file, others)| others.iter().map(move |&other| (file, other)));
    let between = arrows.filter_map(|(from, to)| {
        let rooms = [number(from)?, number(to)?];
        (rooms[0] != rooms[1]).then(|| (rooms, format!("{} → {}", paths[from], paths[to])))
    });
    let between: Vec<([usize; 2], String)> = between.collect();
    let mut reaches = vec![BTreeSet::new(); names.len()];
    for ([from, to], _) in &between {
        reaches[*from].insert(*to);
    }
    let ties = |circle: Vec<usize>| {
        let within = between.iter().filter(|(rooms, _)| rooms.iter().all(|room| circle.contains(room)));
        within.map(|(_, tie)| tie.as_str()).collect::<Vec<_>>().join("\n")
    };
    circles(&reaches).into_iter().map(ties).collect()
}

/// There is no exception: what two rooms want of each other is in a room below both, or what ties them is in one above.
#[test]
fn no_circle_runs_through_folders() {
    let houses = houses(&IMPORTS.paths);
    for house in
        ["", "analysis", "engine", "files", "geometry", "numeric", "segmentation", "store", "service", "api"]
    {
        assert!(houses.contains(house), "{house} was not read");
    }
    for house in houses {
        let found = circles_of_rooms(house, &IMPORTS);
        assert!(found.is_empty(), "circles of folders in '{house}':\n{}", found.join("\n\n"));
    }
}

#[test]
fn circles_of_folders_are_found() {
    let files = [
        ("service/mod.rs", "pub mod app;\npub mod jobs;"),
        ("service/app/mod.rs", "pub use self::error::Fault;\nmod error;"),
        ("service/app/error.rs", "use crate::service::jobs;\npub struct Fault(jobs::Job);"),
        ("service/jobs.rs", "use crate::service::app::Fault;\npub struct Job(Option<Box<Fault>>);"),
        ("service/audit.rs", "use crate::service::app::Fault;"),
    ];
    let graph = Graph::new(&files.map(|(path, text)| (path.into(), text.into())), &CRATES);
    let circle = "service/app/error.rs → service/jobs.rs\nservice/jobs.rs → service/app/error.rs";
    assert_eq!(circles_of_rooms("service", &graph), [circle]);
    assert_eq!(circles_of_rooms("", &graph), [""; 0]);
}

/// Names, lengths in lines, and whether they are handlers, of the functions of a file; not those of tests.
fn functions(text: &str) -> Vec<(String, usize, bool)> {
    let lines: Vec<&str> = text.split("\n#[cfg(test)]").next().unwrap_or_default().lines().collect();
    let (mut found, mut is_handler) = (Vec::new(), false);
    for (start, line) in lines.iter().enumerate() {
        is_handler |= line.starts_with("#[utoipa::path");
        let Some(called) = function_name(line) else { continue };
        let indent = &line[..line.len() - line.trim_start().len()];
        let closing = |line: &str| line.strip_prefix(indent).is_some_and(|rest| rest.starts_with('}'));
        // A declaration without a body ends before the body of another one begins.
        let ends =
            |line: &&str| closing(line) || (line.ends_with(';') && !line.starts_with(&format!("{indent} ")));
        let length = match line.ends_with('}') || line.ends_with(';') {
            true => 1,
            false => lines[start + 1..].iter().position(ends).map_or(1, |more| more + 2),
        };
        found.push((called.to_owned(), length, std::mem::take(&mut is_handler)));
    }
    found
}

/// The name of the function that a line declares.
fn function_name(line: &str) -> Option<&str> {
    let declaration = line.trim_start();
    let (before, after) = declaration.split_once("fn ")?;
    let modifiers = before.split(' ').filter(|word| !word.is_empty());
    let mut modifiers = modifiers.filter(|word| !word.starts_with("pub") && !word.ends_with(')'));
    modifiers.all(|word| ["async", "const", "in"].contains(&word)).then(|| name(after))
}

/// Most lines of a function, from its name to its closing brace.
const MAX_FUNCTION: usize = 60;
/// Most lines of a handler: it reads the request, calls the service, and writes the answer.
const MAX_HANDLER: usize = 25;

#[test]
fn functions_are_small() {
    let mut found = Vec::new();
    for (path, text) in program() {
        for (function, length, is_handler) in functions(&text) {
            let most = if is_handler { MAX_HANDLER } else { MAX_FUNCTION };
            if length > most {
                found.push(format!("{path}: {function} has {length} lines, at most {most}"));
            }
        }
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
    let text = "#[utoipa::path(get)]\npub(super) async fn a(\n    b: u8,\n) -> u8 {\n    b\n}\nimpl C {\n    fn d() {}\n\n    \
                fn e() {\n        1\n    }\n}\n#[cfg(test)]\nfn f() {\n}";
    let wanted = [("a", 5, true), ("d", 1, false), ("e", 3, false)];
    assert_eq!(functions(text), wanted.map(|(name, length, handler)| (name.to_owned(), length, handler)));
}

#[test]
fn only_the_api_and_the_server_speak_http() {
    let words = ["axum", "http::", "hyper", "StatusCode"];
    for (path, text) in
        program().iter().filter(|(path, _)| !path.starts_with("api/") && !path.starts_with("server/"))
    {
        for (number, line) in text.lines().enumerate() {
            let code = line.split("//").next().unwrap();
            let word = words.iter().find(|word| has_word(code, word));
            assert!(word.is_none(), "{path}:{}: {} belongs to api and server", number + 1, word.unwrap());
        }
    }
}
