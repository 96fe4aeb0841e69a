//! Opening archives (zip), and their faults.

use std::io::Cursor;

use zip::ZipArchive;
use zip::read::{ArchiveOffset, Config};
use zip::result::ZipError;

use super::error::{FaultKind, FileError, Place};

/// An archive whose bytes are held.
pub(super) type Archive = ZipArchive<Cursor<Vec<u8>>>;

/// First bytes of the record behind the directory.
const END: &[u8] = b"PK\x05\x06";
/// Number of bytes at the end of a file, a little more than those among which the library looks for the record.
const TAIL: usize = 0x1_1000;
/// Most such records there: the library tries one after the other until one has a directory. Archives that are stored in an archive
/// have some.
const MAX_ENDS: usize = 64;

/// The archive that a whole file is, by the directory at its end.
///
/// # Errors
/// Bytes without a directory, those with others before the archive; files that overlap.
pub(super) fn opened(bytes: Vec<u8>) -> Result<Archive, FileError> {
    check_ends(&bytes)?;
    let end = Place::byte(bytes.len() as u64);
    // The library would look for where an archive might begin, again and again in bytes that are arranged so.
    let config = Config { archive_offset: ArchiveOffset::Known(0) };
    let opened = ZipArchive::with_config(config, Cursor::new(bytes));
    let mut archive = opened.map_err(|error| match error {
        ZipError::InvalidArchive(_) => {
            let detail = "expected the directory of a zip archive at the end of the file, and the archive at its beginning, \
                          got other bytes";
            FileError::truncated(end, detail)
        }
        other => fault(other).at(end),
    })?;
    // The same bytes could be those of any number of files.
    if archive.has_overlapping_entries().map_err(fault)? {
        let detail = "expected files with bytes of their own in the archive, got some that overlap";
        return Err(FileError::new(FaultKind::Malformed, detail));
    }
    Ok(archive)
}

/// Refuses many records that may be that behind the directory.
fn check_ends(bytes: &[u8]) -> Result<(), FileError> {
    let tail = &bytes[bytes.len().saturating_sub(TAIL)..];
    let count = tail.windows(END.len()).filter(|bytes| *bytes == END).count();
    if count <= MAX_ENDS {
        return Ok(());
    }
    let detail = format!("expected at most {MAX_ENDS} ends of archives at the end of the file, got {count}");
    Err(FileError::new(FaultKind::Malformed, detail))
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

#[cfg(test)]
mod tests {
    use std::io::Write;

    use zip::ZipWriter;
    use zip::write::SimpleFileOptions;

    use super::*;

    fn archive() -> Vec<u8> {
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        zip.start_file("a", SimpleFileOptions::default()).unwrap();
        zip.write_all(b"hello").unwrap();
        zip.finish().unwrap().into_inner()
    }

    #[test]
    fn archives_are_not_looked_for_in_arranged_bytes() {
        assert_eq!(opened(archive()).unwrap().len(), 1);
        assert_eq!(opened([&archive()[..], b"others behind"].concat()).unwrap().len(), 1);
        let late = opened([b"others before", &archive()[..]].concat()).unwrap_err();
        assert_eq!(late.kind, FaultKind::Truncated);
        assert!(late.to_string().contains("and the archive at its beginning, got other bytes"), "{late}");
        let empty = [END, &[0; 18]].concat();
        assert!(opened([archive(), empty.repeat(MAX_ENDS - 1)].concat()).is_ok());
        let many = opened([archive(), empty.repeat(MAX_ENDS)].concat()).unwrap_err().to_string();
        assert_eq!(many, "expected at most 64 ends of archives at the end of the file, got 65");
    }
}
