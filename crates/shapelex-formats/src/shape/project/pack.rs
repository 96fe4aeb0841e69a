//! Archives of a project and the files that it names.

use std::collections::BTreeSet;
use std::io::{Cursor, Read, Write};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::super::limits::Limits;
use super::super::options::ReadOptions;
use super::super::source::Source;
use super::{Column, FORMAT, Project, Table, relative};
use crate::error::{FaultKind, FileError, Place};

/// Most folders that a path may be above that of the project: the names of all files grow with them.
const MAX_ABOVE: usize = 32;

/// Folder of an archive that stands for that of the project, if it names files above. None of these is in a folder called so.
const OWN: &str = "(folder of the project)";

/// An archive of a project called `name`, and the files that it names and `options` want. `open` gives a file by its path from the
/// folder of the project.
///
/// The same files make the same bytes.
///
/// # Errors
/// Faults of the project; a file that cannot be opened; more bytes than may be held.
pub fn pack_project<R: Read>(
    bytes: &[u8],
    name: &str,
    options: &ReadOptions,
    limits: &Limits,
    mut open: impl FnMut(&str) -> std::io::Result<R>,
) -> Result<Vec<u8>, FileError> {
    let project = Project::new(&Table::read(&mut Source::new(bytes, *limits)?)?, options)?;
    let above = |path: &str| path.split('/').take_while(|part| *part == "..").count();
    let deepest = project.files.iter().map(|file| above(&file.path)).max().unwrap_or(0);
    if deepest > MAX_ABOVE {
        let detail = format!("expected files at most {MAX_ABOVE} folders above the project, got {deepest}");
        return Err(FileError::new(FaultKind::Malformed, detail));
    }
    let folder = format!("{OWN}/").repeat(deepest);
    let packed = SimpleFileOptions::default().compression_method(CompressionMethod::Deflated);
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    zip.start_file(format!("{folder}{name}"), packed).map_err(unwritten)?;
    zip.write_all(bytes)?;
    let (mut known, mut content) = (BTreeSet::new(), bytes.len() as u64);
    for file in project.files {
        let Some(path) = super::within(&folder, &file.path).filter(|path| known.insert(path.clone())) else {
            continue;
        };
        let failed = |error: std::io::Error| {
            let detail = format!("expected a file that the project names, got '{}': {error}", file.path);
            FileError::of(FaultKind::Io, file.place(), detail)
        };
        zip.start_file(path, packed).map_err(unwritten)?;
        let left = (limits.held as u64).saturating_sub(content);
        content += std::io::copy(&mut open(&file.path).map_err(failed)?.take(left + 1), &mut zip)?;
        if content > limits.held as u64 {
            let detail =
                format!("expected at most {} bytes of all files of a project, got more", limits.held);
            return Err(FileError::too_large(file.place(), detail));
        }
    }
    Ok(zip.finish().map_err(unwritten)?.into_inner())
}

/// The paths of all files that a project names, from its folder: those that are read, and all others. Empty for other files.
pub fn named_files(source: &mut Source<'_>) -> Vec<String> {
    let table = Table::read(source).unwrap_or_default();
    let is_file = |column: &str| matches!(Column::of(column), Column::Files(..) | Column::OtherFiles);
    let values = table.rows.iter().flatten().filter(|(column, _)| is_file(column));
    values.filter_map(|(_, path)| relative(path).ok()).collect()
}

fn unwritten(error: zip::result::ZipError) -> FileError {
    FileError::of(
        FaultKind::Io,
        Place::default(),
        format!("expected an archive of a {}, got {error}", FORMAT.name),
    )
}
