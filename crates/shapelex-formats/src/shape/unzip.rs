//! Opening archives (zip), and their faults.

use std::io::Cursor;

use zip::ZipArchive;
use zip::read::{ArchiveOffset, Config};
use zip::result::ZipError;

use crate::error::{FaultKind, FileError, Place};

/// An archive whose bytes are held.
pub(super) type Archive = ZipArchive<Cursor<Vec<u8>>>;

/// First bytes of an entry of the directory.
const ENTRY: &[u8] = b"PK\x01\x02";
/// First bytes of the record behind the directory.
const END: &[u8] = b"PK\x05\x06";
/// First bytes of the record before it in archives of zip64.
const LARGE_END: &[u8] = b"PK\x06\x07";
/// Number of bytes at the end of a file, a little more than those among which the library looks for the record.
const TAIL: usize = 0x1_1000;
/// Most such records there that the library would follow: it tries one after the other, until one has a directory.
const MAX_ENDS: usize = 64;

/// The archive that a whole file is, by the directory at its end.
///
/// # Errors
/// Bytes without a directory, those with others before the archive; files that overlap.
pub(super) fn opened(bytes: Vec<u8>) -> Result<Archive, FileError> {
    check_ends(&bytes)?;
    let (is_ended, length) = (is_ended(&bytes), bytes.len() as u64);
    let end = || Place::byte(length);
    // The library would look for where an archive might begin, again and again in bytes that are arranged so.
    let config = Config { archive_offset: ArchiveOffset::Known(0) };
    let opened = ZipArchive::with_config(config, Cursor::new(bytes));
    let mut archive = opened.map_err(|error| match error {
        ZipError::InvalidArchive(_) => {
            let detail = "expected the directory of a zip archive at the end of the file, and the archive at its beginning, \
                          got other bytes";
            FileError::truncated(end(), detail)
        }
        other => fault(other).at(end()),
    })?;
    if !is_ended {
        return Err(FileError::malformed(
            end(),
            "expected the end of the file after the zip archive, got other bytes",
        ));
    }
    // The same bytes could be those of any number of files.
    match archive.has_overlapping_entries() {
        Ok(false) => Ok(archive),
        Ok(true) => {
            let detail = "expected files with bytes of their own in the archive, got some that overlap";
            Err(FileError::new(FaultKind::Malformed, detail))
        }
        Err(error) => {
            let broken = (0..archive.len()).find(|k| archive.by_index_raw(*k).is_err());
            Err(fault(error).at(broken.map_or_else(Place::default, |k| Place::item(k as u64))))
        }
    }
}

/// Whether the file ends with a record behind its directory: 22 bytes, and a comment of the length that the last two tell. The directory
/// ends there, or where the records of zip64 begin, whose last one has 20 bytes.
fn is_ended(bytes: &[u8]) -> bool {
    let number = |at: usize, count: usize| {
        let digits = bytes.get(at..at + count).unwrap_or_default();
        digits.iter().rev().fold(0, |number, digit| number << 8 | usize::from(*digit))
    };
    let tail = bytes.len().saturating_sub(TAIL);
    (tail..bytes.len()).any(|at| {
        let is_last = bytes[at..].starts_with(END) && at + 22 + number(at + 20, 2) == bytes.len();
        let is_large = at >= 20 && bytes[at - 20..].starts_with(LARGE_END);
        is_last && (is_large || number(at + 12, 4) + number(at + 16, 4) == at)
    })
}

/// Refuses many records that may be that behind the directory.
fn check_ends(bytes: &[u8]) -> Result<(), FileError> {
    let tail = bytes.len().saturating_sub(TAIL);
    let count = (tail..bytes.len()).filter(|at| has_directory(bytes, *at)).count();
    if count <= MAX_ENDS {
        return Ok(());
    }
    let detail = format!("expected at most {MAX_ENDS} ends of archives at the end of the file, got {count}");
    Err(FileError::new(FaultKind::Malformed, detail))
}

/// Whether there is a record that may be that behind the directory: its offset is that of an entry, or one of its numbers stands in
/// another record (zip64). Those of archives that are stored in an archive count from the beginning of the inner archive.
fn has_directory(bytes: &[u8], at: usize) -> bool {
    let Some(&record) = bytes[at..].strip_prefix(END).and_then(|record| record.first_chunk::<16>()) else {
        return false;
    };
    let [disk, first_disk, own_count, count] = [0, 2, 4, 6].map(|at| [record[at], record[at + 1]]);
    let [size, offset] = [8, 12].map(|at| [record[at], record[at + 1], record[at + 2], record[at + 3]]);
    let is_elsewhere =
        [disk, first_disk, own_count, count].contains(&[0xff; 2]) || [size, offset].contains(&[0xff; 4]);
    let entry = usize::try_from(u32::from_le_bytes(offset)).ok().and_then(|offset| bytes.get(offset..));
    is_elsewhere || entry.is_some_and(|entry| entry.starts_with(ENTRY))
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
        let ended = |file: Vec<u8>| opened(file).map(|archive| archive.len()).map_err(|error| error.detail);
        let refused = Err("expected the end of the file after the zip archive, got other bytes".to_owned());
        assert_eq!(ended([&archive()[..], b"others behind"].concat()), refused);
        assert_eq!(ended([archive(), archive()].concat()), refused);
        let late = opened([b"others before", &archive()[..]].concat()).unwrap_err();
        assert_eq!(late.kind, FaultKind::Truncated);
        assert!(late.to_string().contains("and the archive at its beginning, got other bytes"), "{late}");
        let file = archive();
        let end = &file[file.len() - 22..];
        assert_eq!(ended([&file, &end.repeat(MAX_ENDS - 1)[..]].concat()), refused);
        let elsewhere = [END, &[0; 14], &[0xff; 2], &[0; 2]].concat();
        for end in
            [end, &[END, &[0; 12], &[0xff; 4], &[0; 2]].concat(), &[END, &[0xff; 2], &[0; 16]].concat()]
        {
            let many = opened([&file, &end.repeat(MAX_ENDS)[..]].concat()).unwrap_err().to_string();
            assert_eq!(many, "expected at most 64 ends of archives at the end of the file, got 65");
        }
        // No number, and no directory there.
        assert_eq!(ended([&file, &elsewhere.repeat(MAX_ENDS)[..], end].concat()), refused);
    }

    #[test]
    fn archives_that_are_stored_in_an_archive_have_ends() {
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        let stored = SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
        for k in 0..200 {
            zip.start_file(k.to_string(), stored).unwrap();
            zip.write_all(&archive()).unwrap();
        }
        let file = zip.finish().unwrap().into_inner();
        let tail = &file[file.len().saturating_sub(TAIL)..];
        assert!(tail.windows(END.len()).filter(|bytes| *bytes == END).count() > MAX_ENDS);
        assert_eq!(opened(file).unwrap().len(), 200);
    }

    #[test]
    fn a_file_that_is_broken_is_named() {
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        for name in ["a", "b"] {
            zip.start_file(name, SimpleFileOptions::default()).unwrap();
        }
        let mut file = zip.finish().unwrap().into_inner();
        let header = b"PK\x03\x04";
        let second = file.windows(4).rposition(|bytes| bytes == header).unwrap();
        file[second] = b'p';
        assert_eq!(opened(file).unwrap_err().place.item, Some(1));
    }
}
