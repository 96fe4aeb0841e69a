//! Orders of lists of shapes, and positions in them.

use std::fmt;
use std::str::FromStr;

use super::engine::Row;
use super::error::StoreError;
use crate::domain::attribute::Attribute;

/// Position in the storage order of a cohort, just after a shape. Opaque to clients.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Cursor {
    pub(super) chunk: i64,
    pub(super) position: i64,
}

/// Error: a cursor that this store did not write.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected a cursor of this service")]
pub struct CursorError;

impl fmt::Display for Cursor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:x}-{:x}", self.chunk, self.position)
    }
}

impl FromStr for Cursor {
    type Err = CursorError;

    fn from_str(text: &str) -> Result<Self, CursorError> {
        let number = |hex: &str| {
            let plain = hex.bytes().all(|b| b.is_ascii_hexdigit());
            let number = i64::from_str_radix(hex, 16).map_err(|_| CursorError)?;
            plain.then_some(number).ok_or(CursorError)
        };
        let (chunk, position) = text.split_once('-').ok_or(CursorError)?;
        Ok(Self { chunk: number(chunk)?, position: number(position)? })
    }
}

/// Order of a list of shapes: numbers come first, then texts, then shapes without the attribute; equal ones in storage
/// order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Order {
    /// The attribute.
    pub attribute: Attribute,
    /// Whether large values come first.
    pub descending: bool,
}

/// Value by which a list is ordered.
#[derive(Debug, Clone, PartialEq)]
pub enum SortKey {
    /// A number.
    Number(f64),
    /// A text.
    Text(String),
    /// The shape has no such attribute.
    Missing,
}

impl SortKey {
    pub(super) fn read(row: &Row) -> Result<Self, StoreError> {
        if let Some(number) = row.get("order_number")? {
            return Ok(Self::Number(number));
        }
        Ok(row.get::<Option<String>>("order_text")?.map_or(Self::Missing, Self::Text))
    }
}

/// Position in a list of shapes, just after a shape. Opaque to clients.
#[derive(Debug, Clone, PartialEq)]
pub struct ListCursor {
    /// Place of the shape.
    pub place: Cursor,
    /// Its value, in a list ordered by an attribute.
    pub key: Option<SortKey>,
}

impl fmt::Display for ListCursor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.place)?;
        match &self.key {
            None => Ok(()),
            Some(SortKey::Number(number)) => write!(f, "-n{:016x}", number.to_bits()),
            Some(SortKey::Text(text)) => {
                f.write_str("-t")?;
                text.bytes().try_for_each(|byte| write!(f, "{byte:02x}"))
            }
            Some(SortKey::Missing) => f.write_str("-m"),
        }
    }
}

impl FromStr for ListCursor {
    type Err = CursorError;

    fn from_str(text: &str) -> Result<Self, CursorError> {
        let (place, key) = match text.match_indices('-').nth(1) {
            Some((end, _)) => (&text[..end], Some(&text[end + 1..])),
            None => (text, None),
        };
        Ok(Self { place: place.parse()?, key: key.map(sort_key).transpose()? })
    }
}

/// Reads the key of a cursor.
fn sort_key(text: &str) -> Result<SortKey, CursorError> {
    if !text.is_ascii() || text.len() < 2 {
        return if text == "m" { Ok(SortKey::Missing) } else { Err(CursorError) };
    }
    let (kind, hex) = text.split_at(1);
    match kind {
        "n" => {
            let bits = u64::from_str_radix(hex, 16).map_err(|_| CursorError)?;
            Some(f64::from_bits(bits))
                .filter(|number| number.is_finite())
                .map(SortKey::Number)
                .ok_or(CursorError)
        }
        "t" => {
            let byte = |at: usize| u8::from_str_radix(hex.get(at..at + 2)?, 16).ok();
            let bytes: Option<Vec<u8>> = (0..hex.len()).step_by(2).map(byte).collect();
            let text = bytes.and_then(|bytes| String::from_utf8(bytes).ok());
            text.filter(|text| !text.contains('\0')).map(SortKey::Text).ok_or(CursorError)
        }
        _ => Err(CursorError),
    }
}
