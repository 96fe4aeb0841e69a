//! The bytes of a file on this machine.

use std::fs::File;
use std::io::{Cursor, Read};
use std::path::{Path, PathBuf};

use bytes::Bytes;

use crate::service::files::FileFormat;
use crate::wire::files::{self, FileError, Limits, ReadOptions, Source};

/// Id of the format of projects, which only name the files of their shapes.
pub(super) const PROJECT: &str = "swproj";
/// Id of the format of archives.
const ARCHIVE: &str = "zip";

pub(super) fn is_standard(path: &Path) -> bool {
    path == Path::new("-")
}

/// A path in a message.
pub(super) fn shown(path: &Path) -> String {
    if is_standard(path) { "standard input".into() } else { path.display().to_string() }
}

/// An open file with its format. A project becomes an archive that has the files too.
pub(super) struct Opened {
    pub(super) format: FileFormat,
    pub(super) source: Source<'static>,
    /// The archive of a project.
    pub(super) packed: Option<Bytes>,
}

impl Opened {
    /// Opens a file; `-` is standard input.
    pub(super) fn new(
        path: &Path,
        stated: Option<FileFormat>,
        options: &ReadOptions,
    ) -> Result<Self, FileError> {
        let (format, mut source) = open(path, stated)?;
        if format.id() != PROJECT || is_standard(path) {
            return Ok(Self { format, source, packed: None });
        }
        let packed = Bytes::from(pack(path, &mut source, options)?);
        let source = Source::new(Cursor::new(packed.clone()), Limits::default())?;
        Ok(Self { format: FileFormat::find(ARCHIVE).unwrap_or(format), source, packed: Some(packed) })
    }
}

fn open(path: &Path, stated: Option<FileFormat>) -> Result<(FileFormat, Source<'static>), FileError> {
    let reader: Box<dyn Read> = match is_standard(path) {
        true => Box::new(std::io::stdin()),
        false => Box::new(File::open(path)?),
    };
    let source = Source::new(reader, Limits::default())?;
    let name = path.file_name().map(|name| name.to_string_lossy());
    let format = match stated {
        Some(format) => format,
        None => FileFormat::detect(source.head(), name.as_deref())?,
    };
    Ok((format, source))
}

/// An archive of a project and the files that it names. Only files of shapes are taken: a project may name any.
fn pack(path: &Path, source: &mut Source<'_>, options: &ReadOptions) -> Result<Vec<u8>, FileError> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    files::pack_project(&source.bytes()?, &name, options, &Limits::default(), |file| {
        let opened = open(&folder.join(file), None);
        opened.map(|(_, source)| source).map_err(|error| std::io::Error::other(error.to_string()))
    })
}

/// The files that a project names, if a file is one.
pub(super) fn named_files(path: &Path) -> Vec<PathBuf> {
    match open(path, None) {
        Ok((format, mut source)) if format.id() == PROJECT => {
            let folder = path.parent().unwrap_or(Path::new(""));
            files::named_files(&mut source).iter().map(|file| joined(folder, file)).collect()
        }
        _ => Vec::new(),
    }
}

/// A path from a folder, without `..` where the folder has a name for it.
fn joined(folder: &Path, file: &str) -> PathBuf {
    let mut path = folder.to_owned();
    for part in file.split('/') {
        match part {
            ".." if path.file_name().is_some() => drop(path.pop()),
            _ => path.push(part),
        }
    }
    path
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_lose_the_folders_that_they_leave() {
        for (folder, file, expected) in
            [("a/b", "../c/d", "a/c/d"), ("a", "b", "a/b"), ("", "../b", "../b"), ("a", "../../b", "../b")]
        {
            assert_eq!(joined(Path::new(folder), file), Path::new(expected));
        }
    }
}
