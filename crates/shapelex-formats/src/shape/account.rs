//! What the records of a file take in memory, all together.

use super::error::{FaultKind, FileError};
use super::limits::{Budget, Limits, MAX_ATTRIBUTES};
use super::record::Record;

/// Bytes that the records of a file take in memory for each byte of its content: a coordinate of two characters takes eight.
const EXPANSION: u64 = 4;
/// Attributes and metadata that take fewer bytes in memory are no long ones.
const SHORT: usize = 1 << 10;
/// Characters of long attributes and metadata that the records of any file may have in all.
const FREE: u64 = 64 << 20;
/// Further ones for each byte of the file that has been read: the rings of an object, and rows with one entry of a dictionary, have
/// copies of what the file says once.
const COPIES: u64 = 16;

/// Counts records, and what they take.
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
    pub(super) fn new(limits: Limits) -> Self {
        let characters = Budget::new("characters of long attributes and metadata", FREE, COPIES);
        Self { limits, records: 0, bytes: 0, characters }
    }

    /// Adds a record, after `read` bytes of the file and of those within it.
    ///
    /// # Errors
    /// [`FaultKind::TooLarge`]: more records, or larger ones, than `limits` allow.
    pub(super) fn add(&mut self, record: &Record, read: u64) -> Result<(), FileError> {
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
        self.characters.take(record.attribute_characters() as u64, read)
    }
}

fn too_large(detail: String) -> FileError {
    FileError::new(FaultKind::TooLarge, detail)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::super::error::Place;
    use super::super::find;
    use super::super::options::ReadOptions;
    use super::super::testing::records_within;
    use super::*;

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
        let most = FREE + COPIES * file.len() as u64;
        let expected = format!(
            "expected at most {most} characters of long attributes and metadata in {} bytes, got more",
            file.len()
        );
        assert_eq!(error.detail, expected);
        assert_eq!(count("geojson", &rings(1 << 20, 75)), 75);
        // Those that are not long are free, and so is what every shape says itself.
        assert_eq!(count("geojson", &rings(300, 300_000)), 300_000);
        let line = format!(r#"{{"points":[[0,0],[1,1]],"metadata":{{"note":"{}"}}}}"#, "x".repeat(1 << 20));
        assert_eq!(count("ndjson", [line.as_str(); 90].join("\n").as_bytes()), 90);
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
