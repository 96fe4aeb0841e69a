//! What must stay true of the structure: the arrows of the layers, no knots, a bound for every loop.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The layers from top to bottom: a file uses its own layer and those below. The lowest are crates, `shapelex-…`.
const LAYERS: [&[&str]; 9] = [
    &["cli", "server", "config", "health", "store_location", "telemetry"],
    DOORS,
    &["service"],
    &["store"],
    &["domain"],
    &["formats", FILES, CRATES[0]],
    &[CRATES[1]],
    &[CRATES[2]],
    &[CRATES[3]],
];

/// The crate `shapelex-formats`, whose name is also that of a module.
const FILES: &str = "files";

/// The layers of arithmetic, each a crate of its own: Cargo keeps their arrows.
const CRATES: [&str; 4] = ["segmentation", "analysis", "geometry", "numeric"];

/// The modules through which work comes in: none uses another one.
const DOORS: &[&str] = &["api", "worker"];

/// The first layer that knows nothing of the outer world.
const FIRST_PURE: &str = "formats";

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

/// The sources of the program, by their paths below `src`; those of a crate are in the folder of its layer.
pub(crate) fn program() -> Vec<(String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let crates = CRATES.map(|layer| (format!("{layer}/"), root.join(format!("crates/shapelex-{layer}/src"))));
    let files = (format!("{FILES}/"), root.join("crates/shapelex-formats/src"));
    // Its folders are the layers `store` and `domain`.
    let stored = (String::new(), root.join("crates/shapelex-store/src"));
    let folders = [(String::new(), root.join("src")), stored, files].into_iter().chain(crates);
    folders
        .flat_map(|(prefix, folder)| {
            sources(&folder).into_iter().map(move |file| {
                let path = file.strip_prefix(&folder).unwrap().to_str().unwrap().replace('\\', "/");
                (format!("{prefix}{path}"), std::fs::read_to_string(&file).unwrap())
            })
        })
        .collect()
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
        ("formats/svg.rs", "use crate::domain::id;"),
        ("store/mod.rs", "use crate::{domain::id, api::problem::{Problem, self}};"),
        ("service/pool.rs", "use super::super::api;"),
        ("api/v1/mod.rs", "use super::super::config::ServeConfig;"),
        ("formats/svg.rs", "let now = std::time::Instant::now();"),
        ("formats/svg.rs", "use http::StatusCode;"),
        ("numeric/dense.rs", "    tokio::spawn(work);"),
        ("worker/mod.rs", "use crate::api::problem::Problem;"),
        ("api/v1/jobs.rs", "use crate::worker::Worker;"),
        ("jobs/mod.rs", ""),
        ("api/mod.rs", "use crate::jobs;"),
    ];
    for (path, line) in bad {
        assert_eq!(violations(path, line).len(), 1, "{path}: {line}: {:?}", violations(path, line));
    }
    let good = [
        ("cli.rs", "use crate::{api, server};"),
        ("api/v1/jobs.rs", "use crate::api::extract::Prefer;"),
        ("service/compute.rs", "use super::App;\nuse crate::numeric::dense::Matrix;"),
        ("formats/svg.rs", "// once a tokio task\nlet instantaneous = \"http://www.w3.org\";"),
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
        ["geometry/", "numeric/", "formats/", "files/"].iter().any(|layer| path.starts_with(layer));
    if asks_freely || path.ends_with("/tests.rs") {
        return Vec::new();
    }
    let code = text.split("\n#[cfg(test)]").next().unwrap_or_default();
    let lines = code.lines().map(|line| line.split("//").next().unwrap_or_default().trim());
    lines.filter(|line| KIND_WORDS.iter().any(|word| line.contains(word))).collect()
}

/// A new kind of shape has its code in the geometry, and its JSON in the formats.
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

/// The files that a file names in its imports and paths, tests left out, as positions in `files`.
fn imports(files: &BTreeMap<String, usize>, path: &str, text: &str) -> BTreeSet<usize> {
    let own: Vec<String> = modules(path);
    let code = text.split("\n#[cfg(test)]\nmod tests").next().unwrap();
    let code: Vec<&str> = code.lines().map(|line| line.split("//").next().unwrap()).collect();
    let code = code.join("\n");
    let used =
        code.split("use ").skip(1).filter_map(|rest| rest.split_once(';')).flat_map(|(tree, _)| leaves(tree));
    let written = paths_of(&code);
    used.chain(written)
        .filter_map(|leaf| absolute(&own, &leaf))
        .filter_map(|segments| {
            (1..=segments.len()).rev().find_map(|count| files.get(&segments[..count].join("/")).copied())
        })
        .collect()
}

/// `a/b` of `a/b.rs` and `a/b/mod.rs`; those of a crate begin with its layer.
fn modules(path: &str) -> Vec<String> {
    let path = path.trim_end_matches(".rs");
    let path = path.strip_suffix("/mod").or_else(|| path.strip_suffix("/lib")).unwrap_or(path);
    path.split('/').map(str::to_owned).collect()
}

/// The paths of `a::{b, c::{d, e as f}}`.
fn leaves(tree: &str) -> Vec<String> {
    let tree = tree.trim();
    let Some((head, rest)) = tree.split_once('{') else {
        return vec![tree.split(" as ").next().unwrap().trim().to_owned()];
    };
    let (mut depth, mut entry, mut entries) = (0, String::new(), Vec::new());
    for c in rest.chars() {
        match c {
            '}' if depth == 0 => break,
            ',' if depth == 0 => entries.push(std::mem::take(&mut entry)),
            c => {
                depth += i32::from(c == '{') - i32::from(c == '}');
                entry.push(c);
            }
        }
    }
    entries.push(entry);
    let entries = entries.iter().filter(|entry| !entry.trim().is_empty());
    entries.flat_map(|entry| leaves(&format!("{head}{}", entry.trim()))).collect()
}

/// `crate::a::b` and `super::a` in the middle of code, but not in `pub(in …)`.
fn paths_of(code: &str) -> Vec<String> {
    let is_part = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
    let begins = |word: &'static str| {
        code.match_indices(word).filter(|(start, _)| {
            let before = &code[..*start];
            !before.ends_with(is_part) && !before.ends_with("in ")
        })
    };
    let path = |start: usize| {
        let rest = &code[start..];
        rest[..rest.find(|c| !is_part(c)).unwrap_or(rest.len())].trim_end_matches(':').to_owned()
    };
    ["crate::", "super::"]
        .into_iter()
        .flat_map(begins)
        .map(|(start, _)| path(start))
        .filter(|path| path.contains("::") && !path.ends_with("super"))
        .collect()
}

/// The path from the root of the program of what a file of the module `own` calls `leaf`.
fn absolute(own: &[String], leaf: &str) -> Option<Vec<String>> {
    let segments: Vec<&str> = leaf.split("::").map(str::trim).collect();
    let crate_root = own.first().filter(|layer| CRATES.contains(&layer.as_str()));
    let (base, rest) = match segments[0] {
        "crate" => (crate_root.into_iter().cloned().collect(), &segments[1..]),
        "self" => (own.to_vec(), &segments[1..]),
        "super" => {
            let ups = segments.iter().take_while(|segment| **segment == "super").count();
            (own[..own.len().checked_sub(ups)?].to_vec(), &segments[ups..])
        }
        other => match other.strip_prefix("shapelex_").filter(|layer| CRATES.contains(layer)) {
            Some(layer) => (vec![layer.to_owned()], &segments[1..]),
            None => (own.to_vec(), &segments[..]),
        },
    };
    Some(base.into_iter().chain(rest.iter().map(|segment| (*segment).to_owned())).collect())
}

/// For every file the files it reaches by imports.
fn reached(imports: &[BTreeSet<usize>]) -> Vec<BTreeSet<usize>> {
    let from = |start: usize| {
        let (mut seen, mut waiting) = (BTreeSet::new(), vec![start]);
        while let Some(file) = waiting.pop() {
            waiting.extend(imports[file].iter().filter(|other| seen.insert(**other)));
        }
        seen
    };
    (0..imports.len()).map(from).collect()
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

/// Paths of the files, and what each imports.
fn import_graph() -> (Vec<String>, Vec<BTreeSet<usize>>) {
    let files: Vec<(String, String)> =
        program().into_iter().filter(|(path, _)| path != "lib.rs" && path != "main.rs").collect();
    let places = files.iter().enumerate().map(|(k, (path, _))| (modules(path).join("/"), k)).collect();
    let edges = files.iter().enumerate().map(|(k, (path, text))| {
        let mut found = imports(&places, path, text);
        found.remove(&k);
        found
    });
    let edges = edges.collect();
    (files.into_iter().map(|(path, _)| path).collect(), edges)
}

/// Most files that import one another in a loop.
const MAX_KNOT: usize = 6;

#[test]
fn no_knot_is_large() {
    let (paths, imports) = import_graph();
    assert!(imports.iter().map(BTreeSet::len).sum::<usize>() > 1000, "imports are not found");
    let reached = reached(&imports);
    for (file, path) in paths.iter().enumerate() {
        let knot: Vec<&str> = reached[file]
            .iter()
            .filter(|other| reached[**other].contains(&file))
            .map(|&k| &*paths[k])
            .collect();
        assert!(knot.len() <= MAX_KNOT, "{path} is in a knot of {} files: {knot:?}", knot.len());
    }
}

#[test]
fn no_circle_runs_through_folders_of_the_service() {
    let (paths, imports) = import_graph();
    let folder = |path: &str| {
        let inside = path.strip_prefix("service/").filter(|rest| *rest != "mod.rs")?;
        Some(inside.split('/').next().unwrap().trim_end_matches(".rs").to_owned())
    };
    let mut names: Vec<String> = paths.iter().filter_map(|path| folder(path)).collect();
    names.sort();
    names.dedup();
    let number = |path: &str| folder(path).and_then(|name| names.binary_search(&name).ok());
    let mut between = vec![BTreeSet::new(); names.len()];
    for (file, others) in imports.iter().enumerate() {
        let Some(from) = number(&paths[file]) else { continue };
        between[from]
            .extend(others.iter().filter_map(|&other| number(&paths[other])).filter(|to| *to != from));
    }
    let reached = reached(&between);
    for (folder, name) in names.iter().enumerate() {
        let circle: Vec<&String> = reached[folder]
            .iter()
            .filter(|other| reached[**other].contains(&folder))
            .map(|&k| &names[k])
            .collect();
        assert!(circle.is_empty(), "{name} is in a circle of folders: {circle:?}");
    }
}

#[test]
fn imports_are_read() {
    let files = [
        "service/app/mod.rs",
        "service/app/error.rs",
        "service/jobs/mod.rs",
        "analysis/lib.rs",
        "analysis/pca.rs",
        "analysis/mean.rs",
    ];
    let places: BTreeMap<String, usize> =
        files.iter().enumerate().map(|(k, path)| (modules(path).join("/"), k)).collect();
    let cases: [(&str, &str, &[usize]); 6] = [
        ("service/jobs/mod.rs", "use crate::service::app::{App, error::{Fault, self}};", &[0, 1]),
        ("service/app/error.rs", "use super::{App};\nfn f() -> super::super::jobs::Job {}", &[0, 2]),
        ("service/app/error.rs", "pub(in crate::service) fn f() {} // crate::service::jobs", &[]),
        ("analysis/pca.rs", "use crate::mean::MeanSpace;\nuse super::AnalysisError;", &[3, 5]),
        ("service/jobs/mod.rs", "use shapelex_analysis::pca::Pca as Components;", &[4]),
        (
            "service/app/mod.rs",
            "pub use self::error::Fault;\n#[cfg(test)]\nmod tests { use crate::service::jobs; }",
            &[1],
        ),
    ];
    for (path, text, wanted) in cases {
        assert_eq!(imports(&places, path, text), wanted.iter().copied().collect(), "{path}: {text}");
    }
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
