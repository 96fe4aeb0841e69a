//! Opening archives (zip), and their faults.

use std::io::Cursor;

use zip::ZipArchive;
use zip::result::ZipError;

use super::error::{FaultKind, FileError, Place};

/// An archive whose bytes are held.
pub(super) type Archive = ZipArchive<Cursor<Vec<u8>>>;

/// The archive that a whole file is, by the directory at its end.
///
/// # Errors
/// Bytes without a directory.
pub(super) fn opened(bytes: Vec<u8>) -> Result<Archive, FileError> {
    let end = Place::byte(bytes.len() as u64);
    ZipArchive::new(Cursor::new(bytes)).map_err(|error| match error {
        ZipError::InvalidArchive(_) => {
            let detail = "expected the directory of a zip archive at the end of the file, got other bytes";
            FileError::truncated(end, detail)
        }
        other => fault(other).at(end),
    })
}

/// A fault of an archive in our words.
pub(super) fn fault(error: ZipError) -> FileError {
    match error {
        ZipError::Io(error) => error.into(),
        ZipError::InvalidArchive(what) => {
            FileError::new(FaultKind::Malformed, format!("expected a whole zip archive, got a fault: {what}"))
        }
        ZipError::CompressionMethodNotSupported(method) => {
            let detail = format!("expected files stored or compressed by deflate, got method {method}");
            FileError::new(FaultKind::Unsupported, detail)
        }
        other => FileError::new(
            FaultKind::Unsupported,
            format!("expected an archive without encryption or parts, got: {other}"),
        ),
    }
}
