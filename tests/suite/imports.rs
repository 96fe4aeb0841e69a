//! The graph of imports: for every file of the sources the files whose items it names.

use std::collections::{BTreeMap, BTreeSet};

/// The sources, and the arrows between them.
pub(crate) struct Graph {
    pub(crate) paths: Vec<String>,
    /// For every file the others that it names, as positions in `paths`.
    pub(crate) arrows: Vec<BTreeSet<usize>>,
}

impl Graph {
    /// The arrows of `files`, pairs of path and text; those of a crate in `crates` begin with its name.
    pub(crate) fn new(files: &[(String, String)], crates: &[&str]) -> Self {
        let tested: BTreeSet<String> =
            files.iter().flat_map(|(path, text)| test_modules(path, text)).collect();
        let is_test = |path: &str| {
            let modules = modules(path);
            (1..=modules.len()).any(|count| tested.contains(&modules[..count].join("/")))
        };
        let read = files.iter().filter(|(path, _)| !is_test(path));
        let sources: Vec<Source> = read.map(|(path, text)| Source::new(path, text, crates)).collect();
        let places = sources.iter().enumerate().map(|(k, source)| (source.modules.join("/"), k)).collect();
        let sources = Sources { sources, places, crates };
        let arrows = (0..sources.sources.len()).map(|file| sources.named(file)).collect();
        Self { paths: sources.sources.into_iter().map(|source| source.path).collect(), arrows }
    }
}

/// The groups of positions that reach one another along arrows, each in order.
pub(crate) fn circles(arrows: &[BTreeSet<usize>]) -> BTreeSet<Vec<usize>> {
    let from = |start: usize| {
        let (mut seen, mut waiting) = (BTreeSet::new(), vec![start]);
        while let Some(position) = waiting.pop() {
            waiting.extend(arrows[position].iter().filter(|other| seen.insert(**other)));
        }
        seen
    };
    let reached: Vec<BTreeSet<usize>> = (0..arrows.len()).map(from).collect();
    let circle = |start: usize| -> Vec<usize> {
        reached[start].iter().copied().filter(|other| reached[*other].contains(&start)).collect()
    };
    (0..arrows.len()).map(circle).filter(|circle| circle.len() > 1).collect()
}

/// A file as the graph reads it, without comments and tests.
struct Source {
    path: String,
    /// `a/b` of `a/b.rs` and `a/b/mod.rs`.
    modules: Vec<String>,
    /// Paths of its imports from the root of the program, by the names that they give.
    names: BTreeMap<String, Vec<String>>,
    /// Modules of which everything is imported.
    globs: Vec<Vec<String>>,
    /// Its code without imports.
    code: String,
}

impl Source {
    fn new(path: &str, text: &str, crates: &[&str]) -> Self {
        let modules = modules(path);
        let text = text.split("\n#[cfg(test)]\nmod tests {").next().unwrap();
        let lines: Vec<&str> = text.lines().map(|line| line.split("//").next().unwrap()).collect();
        let (imports, code) = split(&lines.join("\n"));
        let (mut names, mut globs) = (BTreeMap::new(), Vec::new());
        for import in imports.iter().flat_map(|tree| leaves(tree)) {
            let (leaf, name) = import.split_once(" as ").unwrap_or((&import, ""));
            let leaf = leaf.trim().trim_end_matches("::self");
            let Some(absolute) = absolute(&modules, leaf, crates) else { continue };
            match leaf.rsplit("::").next() {
                Some("*") => globs.push(absolute),
                last => {
                    let name = if name.is_empty() { last.unwrap_or_default() } else { name.trim() };
                    names.insert(name.to_owned(), absolute);
                }
            }
        }
        Self { path: path.to_owned(), modules, names, globs, code }
    }

    /// Whether the file declares an item.
    fn declares(&self, item: &str) -> bool {
        const KINDS: [&str; 8] = ["struct", "enum", "fn", "trait", "type", "const", "static", "macro_rules!"];
        KINDS.iter().any(|kind| {
            let declaration = format!("{kind} {item}");
            let mut found = self.code.match_indices(&declaration);
            found.any(|(start, _)| !self.code[start + declaration.len()..].starts_with(is_word))
        })
    }
}

struct Sources<'a> {
    sources: Vec<Source>,
    /// Positions by the modules of the files.
    places: BTreeMap<String, usize>,
    crates: &'a [&'a str],
}

/// Most re-exports that are followed from one to the next: a path that names itself has no end.
const MOST_STEPS: usize = 8;

impl Sources<'_> {
    /// The files that a file names.
    fn named(&self, file: usize) -> BTreeSet<usize> {
        let source = &self.sources[file];
        let imported = source.names.values().chain(&source.globs).cloned();
        let written = paths_of(&source.code);
        let written = written.iter().filter_map(|path| self.written(source, path));
        let found = imported.chain(written).filter_map(|path| self.defining(&path, MOST_STEPS));
        found.filter(|other| *other != file).collect()
    }

    /// The path from the root that is meant by one in the code, which begins with the root, an imported name, or a child module.
    fn written(&self, source: &Source, path: &str) -> Option<Vec<String>> {
        let (first, rest) = path.split_once("::")?;
        let rest = rest.split("::").map(str::to_owned);
        if let Some(imported) = source.names.get(first) {
            return Some(imported.iter().cloned().chain(rest).collect());
        }
        let absolute = absolute(&source.modules, path, self.crates)?;
        let is_child = self.places.contains_key(&format!("{}/{first}", source.modules.join("/")));
        let is_rooted = ["crate", "self", "super"].contains(&first) || first.starts_with("shapelex_");
        (is_child || is_rooted).then_some(absolute)
    }

    /// The file that defines what a path names: re-exports are followed.
    fn defining(&self, path: &[String], steps: usize) -> Option<usize> {
        let place = |count: &usize| self.places.get(&path[..*count].join("/")).copied();
        let (count, file) = (1..=path.len()).rev().find_map(|count| Some((count, place(&count)?)))?;
        let (Some(item), Some(steps)) = (path.get(count), steps.checked_sub(1)) else { return Some(file) };
        let source = &self.sources[file];
        if let Some(imported) = source.names.get(item) {
            let through: Vec<String> = imported.iter().chain(&path[count + 1..]).cloned().collect();
            return self.defining(&through, steps).or(Some(file));
        }
        let of_all = source.globs.iter().filter_map(|glob| {
            let through: Vec<String> = glob[..glob.len() - 1].iter().chain(&path[count..]).cloned().collect();
            self.defining(&through, steps).filter(|other| self.sources[*other].declares(item))
        });
        (!source.declares(item)).then(|| of_all.into_iter().next()).flatten().or(Some(file))
    }
}

/// Modules of a file that are compiled for tests alone.
fn test_modules(path: &str, text: &str) -> Vec<String> {
    let declared = text.split("#[cfg(test)]\n").skip(1).filter_map(|rest| {
        let (declaration, name) = rest.lines().next()?.split_once("mod ")?;
        let is_module = declaration.trim().is_empty() || declaration.trim().starts_with("pub");
        is_module.then(|| name.strip_suffix(';')).flatten()
    });
    declared.map(|name| format!("{}/{name}", modules(path).join("/"))).collect()
}

/// `a/b` of `a/b.rs` and `a/b/mod.rs`; those of a crate begin with its layer.
fn modules(path: &str) -> Vec<String> {
    let path = path.trim_end_matches(".rs");
    let path = path.strip_suffix("/mod").or_else(|| path.strip_suffix("/lib")).unwrap_or(path);
    path.split('/').map(str::to_owned).collect()
}

/// The trees of the imports of a file, and its code without them.
fn split(code: &str) -> (Vec<String>, String) {
    let (mut imports, mut others) = (Vec::new(), String::new());
    let mut rest = code;
    while let Some(start) = rest.match_indices("use ").map(|(start, _)| start).find(|start| {
        let before = rest[..*start].rsplit('\n').next().unwrap_or_default().trim();
        before.is_empty() || (before.starts_with("pub") && !before.contains(';'))
    }) {
        let end = rest[start..].find(';').map_or(rest.len(), |length| start + length);
        others.push_str(&rest[..start]);
        imports.push(rest[start + "use ".len()..end].to_owned());
        rest = &rest[end..];
    }
    others.push_str(rest);
    (imports, others)
}

/// The paths of `a::{b, c::{d, e as f}}`.
fn leaves(tree: &str) -> Vec<String> {
    let tree = tree.trim();
    let Some((head, rest)) = tree.split_once('{') else { return vec![tree.to_owned()] };
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

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// `a::b::c` in the middle of code, but not in `pub(in …)`.
fn paths_of(code: &str) -> Vec<String> {
    let is_part = |c: char| is_word(c) || c == ':';
    let mut found = Vec::new();
    for (start, _) in code.match_indices("::") {
        let before = code[..start].trim_end_matches(is_word);
        let begin = before.len();
        if begin == start || before.ends_with(':') || before.ends_with("(in ") {
            continue;
        }
        let rest = &code[begin..];
        let path = rest[..rest.find(|c| !is_part(c)).unwrap_or(rest.len())].trim_end_matches(':');
        if path.contains("::") && !path.ends_with("super") {
            found.push(path.to_owned());
        }
    }
    found
}

/// The path from the root of the program that a file of the module `own` writes as `leaf`.
fn absolute(own: &[String], leaf: &str, crates: &[&str]) -> Option<Vec<String>> {
    let segments: Vec<&str> = leaf.split("::").map(str::trim).collect();
    let crate_root = own.first().filter(|layer| crates.contains(&layer.as_str()));
    let (base, rest) = match segments[0] {
        "crate" => (crate_root.into_iter().cloned().collect(), &segments[1..]),
        "self" => (own.to_vec(), &segments[1..]),
        "super" => {
            let ups = segments.iter().take_while(|segment| **segment == "super").count();
            (own[..own.len().checked_sub(ups)?].to_vec(), &segments[ups..])
        }
        other => match other.strip_prefix("shapelex_") {
            // Its modules are layers.
            Some("store") => (Vec::new(), &segments[1..]),
            Some("formats") => (vec!["files".to_owned()], &segments[1..]),
            Some(layer) if crates.contains(&layer) => (vec![layer.to_owned()], &segments[1..]),
            _ => (own.to_vec(), &segments[..]),
        },
    };
    Some(base.into_iter().chain(rest.iter().map(|segment| (*segment).to_owned())).collect())
}

#[test]
fn imports_are_read() {
    let files = [
        (
            "service/app/mod.rs",
            "pub mod error;\npub use self::error::{Fault as Refusal, *};\npub struct App;",
        ),
        ("service/app/error.rs", "pub enum Fault {}\npub fn log() {}"),
        ("service/jobs/mod.rs", "pub struct Job;"),
        ("service/gate/mod.rs", "mod pass;\n#[cfg(test)]\nmod tests;\nfn f() { pass::open() }"),
        ("service/gate/pass.rs", "pub fn open() {}"),
        ("service/gate/tests.rs", "use crate::service::jobs::Job;"),
        ("analysis/lib.rs", "pub struct AnalysisError;"),
        ("analysis/pca.rs", ""),
        ("analysis/mean.rs", ""),
    ];
    let cases: [(&str, &str, &[&str]); 11] = [
        ("service/x.rs", "use crate::service::app::{App, error::{Fault, self}};", &["app/mod", "app/error"]),
        ("service/x.rs", "use super::app::Refusal;\nuse super::app::log;", &["app/error"]),
        ("service/x.rs", "use super::app;\nfn f() -> app::Refusal {}", &["app/mod", "app/error"]),
        (
            "service/app/x.rs",
            "use super::{App};\nfn f() -> super::super::jobs::Job {}",
            &["app/mod", "jobs/mod"],
        ),
        ("service/x.rs", "pub(in crate::service::jobs) fn f() {} // crate::service::jobs", &[]),
        ("service/x.rs", "macro_rules! m { () => { $crate::service::jobs::Job } }", &["jobs/mod"]),
        ("service/x.rs", "fn f() {}\n#[cfg(test)]\nmod tests {\n    use crate::service::jobs;\n}", &[]),
        ("service/x.rs", "use shapelex_analysis::pca::Pca as Components;", &["analysis/pca"]),
        ("analysis/x.rs", "use crate::mean::MeanSpace;\nuse super::AnalysisError;", &["lib", "mean"]),
        ("service/gate/mod.rs", "", &["gate/pass"]),
        ("service/gate/tests.rs", "", &[]),
    ];
    for (path, text, wanted) in cases {
        let own = (!text.is_empty()).then(|| (path.to_owned(), text.to_owned()));
        let files = files.iter().map(|(path, text)| ((*path).to_owned(), (*text).to_owned())).chain(own);
        let Graph { paths, arrows } = Graph::new(&files.collect::<Vec<_>>(), &["analysis"]);
        let place = paths.iter().position(|other| other == path);
        let found = place.into_iter().flat_map(|file| &arrows[file]).map(|&other| &*paths[other]);
        let found: Vec<&str> = found.collect();
        let all = found.iter().zip(wanted).all(|(path, end)| path.ends_with(&format!("{end}.rs")));
        assert!(found.len() == wanted.len() && all, "{path}: {text}: {found:?}");
    }
}
