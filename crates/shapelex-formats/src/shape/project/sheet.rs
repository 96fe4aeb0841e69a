//! The table of a project, whatever it is written in.

use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use serde::Deserialize;
use serde_json::Value;

use super::super::json::Weights;
use super::super::limits::Limits;
use super::super::source::Source;
use super::super::text::shown;
use super::workbook;
use crate::error::{FaultKind, FileError, Place};
use crate::words::plain;

/// The values of a subject by their columns. All rows of a workbook have the same names of these, which may be long.
pub(super) type Row = BTreeMap<Rc<str>, String>;

#[derive(Deserialize)]
struct Document {
    data: Vec<BTreeMap<String, Value>>,
}

/// A table whose rows are subjects.
#[derive(Debug, Default, PartialEq)]
pub(in super::super) struct Table {
    pub(super) rows: Vec<Row>,
    /// Number of bytes that came out of a workbook, which is an archive; 0 for JSON.
    pub(in super::super) unpacked: u64,
}

impl Table {
    /// The table of a project, with at most as many rows as records. Workbooks may hold any table.
    ///
    /// # Errors
    /// Other files, those that take more bytes than may be held or read.
    pub(in super::super) fn read(source: &mut Source<'_>) -> Result<Self, FileError> {
        let bytes = source.bytes()?;
        let limits = *source.limits();
        let table = match workbook::is_workbook(&bytes) {
            true => workbook::table(&bytes, source)?,
            false => Self { rows: document(&bytes, &limits)?, unpacked: 0 },
        };
        if table.rows.len() as u64 > limits.records {
            let detail = format!("expected at most {} subjects, got {}", limits.records, table.rows.len());
            return Err(FileError::too_large(Place::default(), detail));
        }
        Ok(table)
    }

    /// Names of all columns, sorted.
    pub(super) fn columns(&self) -> Vec<&str> {
        let columns: BTreeSet<&str> =
            self.rows.iter().flat_map(|row| row.keys().map(|name| &**name)).collect();
        columns.into_iter().collect()
    }
}

/// Memory of rows: a map of a few members each, most of them texts.
pub(super) const ROWS: Weights = Weights { object: 704, list: 0, item: 64 };

fn document(bytes: &[u8], limits: &Limits) -> Result<Vec<Row>, FileError> {
    ROWS.check(bytes, limits.held, Place::default)?;
    let document: Document = serde_json::from_slice(bytes).map_err(|error| {
        let at =
            Place { tag: Some(format!("column {}", error.column())), ..Place::line(error.line() as u64) };
        let kind = if error.is_eof() { FaultKind::Truncated } else { FaultKind::Malformed };
        FileError::of(kind, at, plain(&error))
    })?;
    let row = |(item, values): (usize, BTreeMap<String, Value>)| {
        let text = |(column, value): (String, Value)| {
            let text = match value {
                Value::Null => String::new(),
                Value::String(text) => text,
                Value::Bool(value) => value.to_string(),
                Value::Number(value) => value.to_string(),
                other => {
                    let place = Place { tag: Some(column), ..Place::item(item as u64) };
                    let detail = format!("expected a text or a number, got {}", shown(&other.to_string()));
                    return Err(FileError::malformed(place, detail));
                }
            };
            Ok((column.into(), text))
        };
        values.into_iter().map(text).collect()
    };
    document.data.into_iter().enumerate().map(row).collect()
}
