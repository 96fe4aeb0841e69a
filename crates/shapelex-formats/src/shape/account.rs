//! Memory of all records of a file together.

use std::cell::Cell;
use std::rc::Rc;

use super::limits::{Bound, Budget, Limits, MAX_ATTRIBUTES};
use super::record::Record;
use crate::error::{FaultKind, FileError};

/// Bytes that the records of a file take in memory for each byte of its content: a coordinate of two characters takes eight.
const EXPANSION: u64 = 4;
/// Most bytes of memory, as estimated, that attributes and metadata of a record take without being counted as long. A ring of three
/// points has some thirty bytes of a file to itself: all copies of this size are some tens of times as long as the file, and need no bound.
const SHORT: usize = 1 << 10;
/// Characters of long attributes and metadata of all records: the rings of an object, and rows with one entry of a dictionary, have
/// copies of facts that the file states once.
const CHARACTERS: Bound =
    Bound { what: "characters of long attributes and metadata", free: 64 << 20, per_byte: 16 };

/// Counts records, and their memory.
#[derive(Debug)]
pub(super) struct Account {
    limits: Limits,
    /// Number of records.
    pub(super) records: u64,
    bytes: u64,
    /// Characters of long attributes and metadata.
    characters: Budget,
}

impl Account {
    /// For records of a file. `read` counts its bytes and those of the files within it.
    pub(super) fn new(limits: Limits, read: Rc<Cell<u64>>) -> Self {
        Self { limits, records: 0, bytes: 0, characters: Budget::new(CHARACTERS, read) }
    }

    /// Adds a record.
    ///
    /// # Errors
    /// [`FaultKind::TooLarge`]: more records, or larger ones, than `limits` allow.
    pub(super) fn add(&mut self, record: &Record) -> Result<(), FileError> {
        self.records += 1;
        if self.records > self.limits.records {
            return Err(too_large(format!("expected at most {} shapes, got more", self.limits.records)));
        }
        let attributes = record.attribute_bytes();
        if attributes > MAX_ATTRIBUTES {
            let detail = format!(
                "expected attributes and metadata of at most {MAX_ATTRIBUTES} bytes in memory, got {attributes}"
            );
            return Err(too_large(detail));
        }
        self.bytes = self.bytes.saturating_add((record.geometry_bytes() + attributes) as u64);
        let most = self.limits.content.saturating_mul(EXPANSION);
        if self.bytes > most {
            let detail = format!("expected shapes that take at most {most} bytes in memory in all, got more");
            return Err(too_large(detail));
        }
        if attributes <= SHORT {
            return Ok(());
        }
        self.characters.take(record.attribute_characters() as u64)
    }
}

fn too_large(detail: String) -> FileError {
    FileError::new(FaultKind::TooLarge, detail)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::super::find;
    use super::super::options::ReadOptions;
    use super::super::source::Source;
    use super::super::testing::records_within;
    use super::*;
    use crate::error::Place;

    fn read(format: &str, file: &[u8], limits: Limits) -> Result<usize, FileError> {
        let format = find(format).unwrap();
        records_within(format, file, &ReadOptions::default(), limits).map(|(records, _)| records.len())
    }

    fn count(format: &str, file: &[u8]) -> usize {
        read(format, file, Limits::default()).unwrap()
    }

    fn fault(format: &str, file: &[u8]) -> FileError {
        read(format, file, Limits::default()).unwrap_err()
    }

    fn rings(note: usize, rings: usize) -> Vec<u8> {
        let list = vec!["[[[0,0],[1,0],[0,1],[0,0]]]"; rings].join(",");
        let properties = format!(r#""properties":{{"note":"{}"}}"#, "x".repeat(note));
        let geometry = format!(r#""geometry":{{"type":"MultiPolygon","coordinates":[{list}]}}"#);
        format!(r#"{{"type":"Feature",{properties},{geometry}}}"#).into_bytes()
    }

    #[test]
    fn copies_of_long_texts_are_bounded_by_the_bytes_of_the_file() {
        let file = rings(1 << 20, 90);
        let error = fault("geojson", &file);
        assert_eq!((error.kind, error.place.item), (FaultKind::TooLarge, Some(0)));
        let most = CHARACTERS.free + CHARACTERS.per_byte * file.len() as u64;
        let expected = format!(
            "expected at most {most} characters of long attributes and metadata in {} bytes, got more",
            file.len()
        );
        assert_eq!(error.detail, expected);
        assert_eq!(count("geojson", &rings(1 << 20, 75)), 75);
        // Those that are not long are free, and so are the facts of every shape itself.
        assert_eq!(count("geojson", &rings(300, 300_000)), 300_000);
        let line = format!(r#"{{"points":[[0,0],[1,1]],"metadata":{{"note":"{}"}}}}"#, "x".repeat(1 << 20));
        assert_eq!(count("ndjson", [line.as_str(); 90].join("\n").as_bytes()), 90);
    }

    #[test]
    fn copies_of_numbers_and_control_characters_are_bounded_as_they_are_written() {
        // Written, two bytes of the file take 8 characters, or 6.
        let numbers = format!("[{}0]", "0,".repeat(100_000));
        let controls = format!("\"{}\"", "\\n".repeat(1 << 20));
        for (note, fewer, more) in [(numbers, 85, 95), (controls, 14, 18)] {
            let given = |rings: usize| {
                let list = vec!["[[[0,0],[1,0],[0,1],[0,0]]]"; rings].join(",");
                let geometry = format!(r#""geometry":{{"type":"MultiPolygon","coordinates":[{list}]}}"#);
                let file = format!(r#"{{"type":"Feature","properties":{{"note":{note}}},{geometry}}}"#);
                let mut source = Source::new(file.as_bytes(), Limits::default()).unwrap();
                let (format, options) = (find("geojson").unwrap(), ReadOptions::default());
                super::super::read(format, &mut source, &options, &mut |_| Ok(()))
            };
            assert_eq!(given(fewer).unwrap().records, fewer as u64);
            assert_eq!(given(more).unwrap_err().kind, FaultKind::TooLarge);
        }
    }

    #[test]
    fn bytes_of_the_files_of_an_archive_are_counted_as_they_come_out() {
        let archive = |files: usize, file: &[u8]| {
            let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
            for k in 0..files {
                let options = zip::write::SimpleFileOptions::default();
                writer.start_file(format!("{k}.geojson"), options).unwrap();
                writer.write_all(file).unwrap();
            }
            writer.finish().unwrap().into_inner()
        };
        // Each has 20 MiB of copies in 1 MiB, and is within the bound.
        let file = rings(1 << 20, 20);
        assert_eq!(count("zip", &archive(5, &file)), 100);
        let error = fault("zip", &archive(20, &file));
        assert_eq!(
            (error.kind, error.place.entry.as_deref()),
            (FaultKind::TooLarge, Some("16.geojson")),
            "{error}"
        );
    }

    #[test]
    fn numbers_of_shapes_are_bounded() {
        let limits = Limits { records: 2, ..Limits::default() };
        let error = read("ndjson", &b"{\"points\":[[0,1]]}\n".repeat(3), limits).unwrap_err();
        assert_eq!(error.to_string(), "line 3: expected at most 2 shapes, got more");
        assert_eq!(*error.place, Place::line(3));
    }
}
