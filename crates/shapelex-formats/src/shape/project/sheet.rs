//! The table of a project, whatever it is written in.

use std::collections::BTreeMap;

use serde::Deserialize;
use serde_json::Value;

use super::super::error::{FaultKind, FileError, Place};
use super::super::limits::Limits;
use super::super::text::shown;
use super::workbook;
use crate::words::plain;

/// The values of a subject by their columns.
pub(super) type Row = BTreeMap<String, String>;

#[derive(Deserialize)]
struct Document {
    data: Vec<BTreeMap<String, Value>>,
}

/// The subjects of a project, at most as many as records.
pub(super) fn rows(bytes: &[u8], limits: &Limits) -> Result<Vec<Row>, FileError> {
    let rows = if workbook::is_workbook(bytes) { workbook::rows(bytes, limits)? } else { document(bytes)? };
    if rows.len() as u64 > limits.records {
        let detail = format!("expected at most {} subjects, got {}", limits.records, rows.len());
        return Err(FileError::too_large(Place::default(), detail));
    }
    Ok(rows)
}

fn document(bytes: &[u8]) -> Result<Vec<Row>, FileError> {
    let document: Document = serde_json::from_slice(bytes).map_err(|error| {
        let at =
            Place { tag: Some(format!("column {}", error.column())), ..Place::line(error.line() as u64) };
        let kind = if error.is_eof() { FaultKind::Truncated } else { FaultKind::Malformed };
        FileError::of(kind, at, plain(&error))
    })?;
    let row = |(item, values): (usize, BTreeMap<String, Value>)| {
        let text = |(column, value)| {
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
            Ok((column, text))
        };
        values.into_iter().map(text).collect()
    };
    document.data.into_iter().enumerate().map(row).collect()
}
