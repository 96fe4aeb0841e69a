//! The compact protocol of Thrift, in which Parquet has its metadata and the headers of pages: fields with a tag, the type of the value,
//! and the difference of their ids.
//!
//! Functions remove the bytes they read from the front.
//!
//! Source: Apache Thrift, compact protocol.

// Tags of types.
const TRUE: u8 = 1;
pub(super) const FALSE: u8 = 2;
const BYTE: u8 = 3;
const I16: u8 = 4;
pub(super) const I32: u8 = 5;
const I64: u8 = 6;
const DOUBLE: u8 = 7;
const BINARY: u8 = 8;
const LIST: u8 = 9;
const SET: u8 = 10;
pub(super) const STRUCT: u8 = 12;

/// Depth of values that are skipped: those of Parquet take nine.
const MAX_DEPTH: usize = 16;
/// Number of items of a list. The library takes memory for all of them before it reads one.
const MAX_ITEMS: u64 = 1 << 16;

/// Bytes that do not follow the protocol, or not the expected types.
#[derive(Debug)]
pub(super) struct Broken;

/// The type of a field that the library reads.
pub(super) enum Kind {
    Bool,
    Byte,
    I16,
    I32,
    I64,
    Double,
    Binary,
    List(&'static Kind),
    Struct(Known),
}

/// Ids and types of the fields of a structure that the library reads; it skips others.
pub(super) type Known = &'static [(i64, Kind)];

impl Kind {
    fn has(&self, tag: u8) -> bool {
        match self {
            Self::Bool => tag == TRUE || tag == FALSE,
            Self::Byte => tag == BYTE,
            Self::I16 => tag == I16,
            Self::I32 => tag == I32,
            Self::I64 => tag == I64,
            Self::Double => tag == DOUBLE,
            Self::Binary => tag == BINARY,
            Self::List(_) => tag == LIST,
            Self::Struct(_) => tag == STRUCT,
        }
    }
}

/// Checks that the known fields of a structure have their types. The library reads them without a look at their tags: where a tag is
/// another, it would read on at another byte than a reader that skips by the tag.
pub(super) fn check(bytes: &mut &[u8], known: Known) -> Result<(), Broken> {
    let mut fields = Fields::default();
    while let Some((id, tag)) = fields.next(bytes)? {
        match known.iter().find(|(known, _)| *known == id) {
            Some((_, kind)) if kind.has(tag) => check_value(bytes, kind, tag)?,
            Some(_) => return Err(Broken),
            None => skip(bytes, tag)?,
        }
    }
    Ok(())
}

fn check_value(bytes: &mut &[u8], kind: &Kind, tag: u8) -> Result<(), Broken> {
    match kind {
        Kind::Struct(known) => check(bytes, known),
        Kind::List(item) => {
            let (count, tag) = list(bytes)?;
            if count > 0 && !item.has(tag) {
                return Err(Broken);
            }
            (0..count).try_for_each(|_| check_value(bytes, item, tag))
        }
        _ => skip(bytes, tag),
    }
}

/// Fields of a structure.
#[derive(Default)]
pub(super) struct Fields {
    id: i64,
}

impl Fields {
    /// Id and tag of the next field, or `None` at the end of the structure.
    pub(super) fn next(&mut self, bytes: &mut &[u8]) -> Result<Option<(i64, u8)>, Broken> {
        let head = byte(bytes)?;
        let tag = head & 0x0f;
        if tag == 0 {
            return Ok(None);
        }
        let id = match head >> 4 {
            0 => zigzag(bytes)?,
            step => self.id + i64::from(step),
        };
        // The library keeps 16 bits.
        self.id = i16::try_from(id).map_err(|_| Broken)?.into();
        Ok(Some((self.id, tag)))
    }
}

/// Number of items of a list, and their tag.
pub(super) fn list(bytes: &mut &[u8]) -> Result<(u64, u8), Broken> {
    let head = byte(bytes)?;
    let count = if head >> 4 == 15 { varint(bytes)? } else { u64::from(head >> 4) };
    let tag = head & 0x0f;
    // No list of Parquet has Booleans, of which the library skips any number without a byte.
    if count > MAX_ITEMS || (count > 0 && tag <= FALSE) {
        return Err(Broken);
    }
    Ok((count, tag))
}

fn byte(bytes: &mut &[u8]) -> Result<u8, Broken> {
    let (first, rest) = bytes.split_first().ok_or(Broken)?;
    *bytes = rest;
    Ok(*first)
}

/// A number of up to 64 bits, seven a byte.
pub(super) fn varint(bytes: &mut &[u8]) -> Result<u64, Broken> {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let next = byte(bytes)?;
        value |= u64::from(next & 0x7f) << shift;
        if next & 0x80 == 0 {
            return Ok(value);
        }
    }
    Err(Broken)
}

/// A signed number.
pub(super) fn zigzag(bytes: &mut &[u8]) -> Result<i64, Broken> {
    let value = varint(bytes)?;
    let half = i64::try_from(value >> 1).map_err(|_| Broken)?;
    Ok(if value & 1 == 0 { half } else { -half - 1 })
}

fn take(bytes: &mut &[u8], count: u64) -> Result<(), Broken> {
    let count = usize::try_from(count).ok();
    *bytes = count.and_then(|count| bytes.get(count..)).ok_or(Broken)?;
    Ok(())
}

/// Skips a value of any type.
pub(super) fn skip(bytes: &mut &[u8], tag: u8) -> Result<(), Broken> {
    skip_nested(bytes, tag, 0)
}

fn skip_nested(bytes: &mut &[u8], tag: u8, depth: usize) -> Result<(), Broken> {
    if depth > MAX_DEPTH {
        return Err(Broken);
    }
    match tag {
        TRUE | FALSE => Ok(()),
        BYTE => take(bytes, 1),
        I16 | I32 | I64 => varint(bytes).map(drop),
        DOUBLE => take(bytes, 8),
        BINARY => {
            let length = varint(bytes)?;
            take(bytes, length)
        }
        LIST | SET => {
            let (count, tag) = list(bytes)?;
            (0..count).try_for_each(|_| skip_nested(bytes, tag, depth + 1))
        }
        STRUCT => {
            let mut fields = Fields::default();
            while let Some((_, tag)) = fields.next(bytes)? {
                skip_nested(bytes, tag, depth + 1)?;
            }
            Ok(())
        }
        _ => Err(Broken),
    }
}
