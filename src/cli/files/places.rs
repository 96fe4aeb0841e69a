//! The files that arguments name: files themselves, folders and patterns.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::content::{PROJECT, is_standard, named_files};
use crate::wire::files;

/// A file, and how it was named.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Place {
    pub(super) path: PathBuf,
    /// Whether it was found in a folder, where other files may lie too.
    pub(super) in_folder: bool,
}

/// All files, in the order of the arguments; those of folders and patterns in the order of their paths. Those of folders that a project
/// among them names belong to it.
///
/// # Errors
/// A file that does not exist, a pattern without files, a folder that cannot be read.
pub(super) fn expand(arguments: &[PathBuf]) -> Result<Vec<Place>, String> {
    let mut found = Vec::new();
    for argument in arguments {
        if is_standard(argument) || argument.is_file() {
            found.push(Place { path: argument.clone(), in_folder: false });
        } else if argument.is_dir() {
            walk(argument, &mut found)?;
        } else {
            let before = found.len();
            for path in matching(argument)? {
                match path.is_dir() {
                    true => walk(&path, &mut found)?,
                    false => found.push(Place { path, in_folder: false }),
                }
            }
            if found.len() == before {
                return Err(format!(
                    "{}: expected a file, a folder or a pattern, got none",
                    argument.display()
                ));
            }
        }
    }
    let projects = found.iter().filter(|place| may_be_project(&place.path));
    let named: BTreeSet<PathBuf> = projects.flat_map(|place| named_files(&place.path)).collect();
    found.retain(|place| !(place.in_folder && named.contains(&place.path)));
    Ok(found)
}

/// Whether a file is called as projects are.
fn may_be_project(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    files::detect(&[], Some(&name)).is_ok_and(|format| format.id == PROJECT)
}

/// Adds all files below a folder, but hidden ones.
fn walk(folder: &Path, found: &mut Vec<Place>) -> Result<(), String> {
    let failed = |error: std::io::Error| format!("{}: {error}", folder.display());
    let entries =
        std::fs::read_dir(folder).map_err(failed)?.collect::<Result<Vec<_>, _>>().map_err(failed)?;
    let mut paths: Vec<PathBuf> = entries.iter().map(std::fs::DirEntry::path).collect();
    paths.sort();
    let is_hidden =
        |path: &Path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'));
    for path in paths.into_iter().filter(|path| !is_hidden(path)) {
        // A link to a folder may lead back here.
        match path.is_dir() {
            true if path.is_symlink() => {}
            true => walk(&path, found)?,
            false => found.push(Place { path, in_folder: true }),
        }
    }
    Ok(())
}

fn matching(pattern: &Path) -> Result<Vec<PathBuf>, String> {
    let text = pattern.to_string_lossy();
    let paths = glob::glob(&text).map_err(|error| format!("{text}: expected a pattern, got {error}"))?;
    paths.collect::<Result<_, _>>().map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_folders_and_patterns_come_in_order() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::create_dir(path("b")).unwrap();
        for name in ["c.txt", "a.txt", "b/d.txt", ".hidden"] {
            std::fs::write(path(name), "").unwrap();
        }
        let names = |arguments: &[PathBuf]| -> Vec<(String, bool)> {
            let places = expand(arguments).unwrap().into_iter();
            let name = |place: Place| {
                (place.path.strip_prefix(folder.path()).unwrap().display().to_string(), place.in_folder)
            };
            places.map(name).collect()
        };
        let found = |list: &[(&str, bool)]| {
            list.iter().map(|(name, is)| ((*name).to_owned(), *is)).collect::<Vec<_>>()
        };
        assert_eq!(
            names(&[folder.path().to_owned()]),
            found(&[("a.txt", true), ("b/d.txt", true), ("c.txt", true)])
        );
        assert_eq!(
            names(&[path("c.txt"), path("?.txt")]),
            found(&[("c.txt", false), ("a.txt", false), ("c.txt", false)])
        );
        assert!(expand(&[path("x*")]).unwrap_err().contains("got none"));
    }
}
