//! Reading and writing small files in tests.

use super::super::format::Format;
use super::super::limits::Limits;
use super::super::options::{ReadOptions, WriteOptions};
use super::super::record::{Geometry, Mesh, Record};
use super::super::source::Source;
use crate::error::FileError;
use crate::summary::Summary;

/// All records of a file.
pub(super) fn read(format: &Format, bytes: &[u8]) -> Result<(Vec<Record>, Summary), FileError> {
    read_within(format, bytes, Limits::default())
}

/// All records of a file within limits.
pub(super) fn read_within(
    format: &Format,
    bytes: &[u8],
    limits: Limits,
) -> Result<(Vec<Record>, Summary), FileError> {
    let mut found = Vec::new();
    let mut source = Source::new(bytes, limits)?;
    let summary = super::super::read(format, &mut source, &ReadOptions::default(), &mut |record| {
        found.push(record);
        Ok(())
    })?;
    Ok((found, summary))
}

/// The sentence of a refusal.
pub(super) fn refusal(format: &Format, bytes: &[u8]) -> String {
    read(format, bytes).unwrap_err().to_string()
}

/// A file of records.
pub(super) fn write(
    format: &Format,
    records: &[Record],
    options: &WriteOptions,
) -> Result<Vec<u8>, FileError> {
    let mut bytes = Vec::new();
    let mut writer = format.writer(&mut bytes, options)?;
    for record in records {
        writer.push(record)?;
    }
    writer.finish()?;
    Ok(bytes)
}

/// The mesh of a record.
pub(super) fn mesh(record: &Record) -> &Mesh {
    match &record.geometry {
        Geometry::Mesh(mesh) => mesh,
        other => panic!("{other:?} is no mesh"),
    }
}

/// Every beginning of a file is refused, or read without a panic if it is a text that may end there.
pub(super) fn cut_off(format: &Format, bytes: &[u8], may_end: bool) {
    for length in 0..bytes.len() {
        let read = read(format, &bytes[..length]);
        assert!(may_end || read.is_err(), "{length} of {} bytes are read", bytes.len());
    }
}

/// Bytes changed at every place are read or refused, without a panic.
pub(super) fn changed(format: &Format, bytes: &[u8]) {
    for k in 0..bytes.len() {
        for change in [0x01, 0x80, 0xff] {
            let mut changed = bytes.to_vec();
            changed[k] ^= change;
            let _ = read(format, &changed);
        }
    }
}
