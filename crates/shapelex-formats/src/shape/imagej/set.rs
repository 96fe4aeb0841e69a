//! Several regions as a zip of files, stored without compression: most are smaller than their headers. The same records give the same bytes.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;

use flate2::Crc;

use super::super::objects::Grouping;
use super::super::options::WriteOptions;
use super::super::record::Record;
use super::super::write::{Opened, Output, Writer};
use super::encode::{file, warn};
use crate::error::{FaultKind, FileError};
use crate::summary::Summary;

/// Version of the zip format that is needed, and the flag of names in UTF-8.
const VERSION: u16 = 20;
const UTF8: u16 = 0x0800;
/// 1 January 1980, the first day that the format knows.
const DATE: u16 = 0x0021;
/// Most files of a zip without extensions, and most bytes of a name.
const MOST: usize = 65535;
const LONGEST: usize = 200;
/// Bytes that a file of the zip takes until its end: its name three times, in the directory and among the names.
const ENTRY: usize = 1000;

/// A file within the zip.
struct Entry {
    name: String,
    sum: u32,
    size: u32,
    offset: u32,
}

/// A zip that is being written.
struct Set<'a> {
    output: Output<'a>,
    grouping: Grouping,
    offset: u32,
    entries: Vec<Entry>,
    names: Names,
    rounded: u64,
    summary: Summary,
}

/// Names so far.
#[derive(Default)]
struct Names {
    taken: BTreeSet<String>,
    /// How often each name was wished for.
    wished: BTreeMap<String, u64>,
}

pub(super) fn open<'a>(output: Output<'a>, _: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(Set {
        output,
        grouping: Grouping::default(),
        offset: 0,
        entries: Vec::new(),
        names: Names::default(),
        rounded: 0,
        summary: Summary::default(),
    }))
}

impl Writer for Set<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let before = self.grouping.push(record, &mut self.summary);
        self.summary.records += 1;
        self.region(&before)
    }

    fn held(&self) -> usize {
        self.grouping.held() + self.entries.len() * ENTRY
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        let left = self.grouping.finish();
        self.region(&left)?;
        let mut directory = Vec::new();
        for entry in &self.entries {
            directory.extend_from_slice(b"PK\x01\x02");
            directory.extend_from_slice(&VERSION.to_le_bytes());
            entry.describe(&mut directory);
            directory.extend_from_slice(&[0; 10]);
            directory.extend_from_slice(&entry.offset.to_le_bytes());
            directory.extend_from_slice(entry.name.as_bytes());
        }
        let size = size(directory.len())?;
        let count = u16::try_from(self.entries.len()).map_err(|_| too_many())?;
        directory.extend_from_slice(b"PK\x05\x06\0\0\0\0");
        directory.extend_from_slice(&count.to_le_bytes());
        directory.extend_from_slice(&count.to_le_bytes());
        directory.extend_from_slice(&size.to_le_bytes());
        directory.extend_from_slice(&self.offset.to_le_bytes());
        directory.extend_from_slice(&[0; 2]);
        self.output.write_all(&directory)?;
        self.output.flush()?;
        warn(self.rounded, &mut self.summary);
        Ok(self.summary)
    }
}

impl Set<'_> {
    /// Adds the region of the rings of one object.
    fn region(&mut self, records: &[Record]) -> Result<(), FileError> {
        let Some(first) = records.first() else { return Ok(()) };
        if self.entries.len() == MOST {
            return Err(too_many().at(first.place.clone()));
        }
        let (content, rounded) = file(records, first, &mut self.summary)?;
        self.rounded += rounded;
        let mut sum = Crc::new();
        sum.update(&content);
        let name = self.names.next(first.name.as_deref(), self.entries.len());
        let entry = Entry { name, sum: sum.sum(), size: size(content.len())?, offset: self.offset };
        let mut header = b"PK\x03\x04".to_vec();
        entry.describe(&mut header);
        header.extend_from_slice(entry.name.as_bytes());
        let end = size(header.len())?.checked_add(entry.size).and_then(|size| self.offset.checked_add(size));
        self.offset = end.ok_or_else(|| too_large().at(first.place.clone()))?;
        self.output.write_all(&header)?;
        self.output.write_all(&content)?;
        self.entries.push(entry);
        Ok(())
    }
}

impl Entry {
    /// Appends the fields that the header of the file and the directory share.
    fn describe(&self, bytes: &mut Vec<u8>) {
        for number in [VERSION, UTF8, 0, 0, DATE] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        for number in [self.sum, self.size, self.size] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        let length = u16::try_from(self.name.len()).expect("names are cut to a few hundred bytes");
        bytes.extend_from_slice(&length.to_le_bytes());
        bytes.extend_from_slice(&[0; 2]);
    }
}

impl Names {
    /// A name that no other file has: that of the region where it can be one, with a number if it is taken.
    fn next(&mut self, name: Option<&str>, position: usize) -> String {
        let unfit =
            |c: char| c.is_control() || matches!(c, '/' | '\\' | ':' | '*' | '?' | '"' | '<' | '>' | '|');
        let mut base = name.unwrap_or_default().trim_matches(['.', ' ']).replace(unfit, "_");
        base.truncate(base.floor_char_boundary(LONGEST));
        if base.is_empty() {
            base = format!("{:06}", position + 1);
        }
        let wished = self.wished.entry(base.clone()).or_default();
        loop {
            *wished += 1;
            let name = if *wished == 1 { format!("{base}.roi") } else { format!("{base}-{wished}.roi") };
            if self.taken.insert(name.clone()) {
                return name;
            }
        }
    }
}

fn size(length: usize) -> Result<u32, FileError> {
    u32::try_from(length).map_err(|_| too_large())
}

fn too_large() -> FileError {
    FileError::new(FaultKind::TooLarge, "expected less than 4 GiB of regions in one zip, got more")
}

fn too_many() -> FileError {
    FileError::new(FaultKind::TooLarge, format!("expected at most {MOST} regions in one zip, got more"))
}

#[cfg(test)]
mod tests {
    use super::super::super::{Geometry, Limits, Place, Points, ReadOptions, Ring, Source};
    use super::super::{FORMAT, SET};
    use super::*;

    fn line(name: Option<&str>, x: f64) -> Record {
        let points = Points::from_rows(2, vec![x, 0.0, 1.0, 1.0]);
        let geometry = Geometry::Curve { points, closed: false };
        Record { name: name.map(str::to_owned), ..Record::new(geometry, Place::default()) }
    }

    #[test]
    fn files_stand_where_the_directory_says() {
        let records = [
            line(Some("a/b"), 0.5),
            line(Some("a_b"), 0.1),
            line(None, 2.0),
            line(Some("../c"), 3.0),
            Record { ring: Some(Ring { object: 0, part: 0, hole: false }), ..line(Some("d"), 4.0) },
            Record { ring: Some(Ring { object: 0, part: 1, hole: false }), ..line(Some("d"), 5.0) },
        ];
        let mut bytes = Vec::new();
        let mut writer = SET.writer(&mut bytes, &WriteOptions::default()).expect("a writer");
        records.iter().for_each(|record| writer.push(record).expect("written"));
        let summary = writer.finish().expect("the end");
        assert_eq!((summary.records, summary.warnings.len()), (6, 1));
        let u32_at =
            |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]) as usize;
        let end = bytes.len() - 22;
        assert_eq!((&bytes[end..end + 4], bytes[end + 10]), (&b"PK\x05\x06"[..], 5));
        let mut at = u32_at(end + 16);
        assert_eq!(at + u32_at(end + 12), end);
        let (mut names, mut firsts) = (Vec::new(), Vec::new());
        while at < end {
            assert_eq!(&bytes[at..at + 4], b"PK\x01\x02");
            let (size, length, offset) = (u32_at(at + 24), usize::from(bytes[at + 28]), u32_at(at + 42));
            let name = &bytes[at + 46..at + 46 + length];
            assert_eq!(&bytes[offset + 30..offset + 30 + length], name);
            names.push(String::from_utf8(name.to_vec()).expect("text"));
            let content = &bytes[offset + 30 + length..offset + 30 + length + size];
            let mut sum = Crc::new();
            sum.update(content);
            assert_eq!((u32_at(at + 16), u32_at(offset + 14)), (sum.sum() as usize, sum.sum() as usize));
            let mut source = Source::new(content, Limits::default()).expect("a source");
            super::super::super::read(&FORMAT, &mut source, &ReadOptions::default(), &mut |record| {
                let Geometry::Curve { points, .. } = &record.geometry else { panic!("{record:?}") };
                firsts.push(points.coordinates()[0]);
                Ok(())
            })
            .expect("a region");
            at += 46 + length;
        }
        assert_eq!(names, ["a_b.roi", "a_b-2.roi", "000003.roi", "_c.roi", "d.roi"]);
        assert_eq!(firsts, [0.5, f64::from(0.1_f32), 2.0, 3.0, 4.0, 5.0]);
    }

    #[test]
    fn names_are_never_taken_twice() {
        let mut names = Names::default();
        let found: Vec<String> = ["a", "a-2", "a", "", "000004"]
            .iter()
            .enumerate()
            .map(|(k, name)| names.next(Some(name), k))
            .collect();
        assert_eq!(found, ["a.roi", "a-2.roi", "a-3.roi", "000004.roi", "000004-2.roi"]);
        assert!(names.next(Some(&"ä".repeat(500)), 9).len() < 210);
    }
}
