//! The header of a PLY file.

use super::super::scalar::Scalar;
use super::super::scan::{Scan, count, shown, text, words, wrong};
use crate::error::FileError;

/// How values are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Encoding {
    Text,
    Binary { big_endian: bool },
}

impl Encoding {
    fn of(name: &[u8], scan: &Scan<'_>) -> Result<Self, FileError> {
        let known = [Self::Text, Self::Binary { big_endian: false }, Self::Binary { big_endian: true }];
        let found = known.into_iter().find(|encoding| encoding.name().as_bytes() == name);
        found.ok_or_else(|| wrong(name, "ascii, binary_little_endian or binary_big_endian", scan.place()))
    }

    /// Its word in the header.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Text => "ascii",
            Self::Binary { big_endian: false } => "binary_little_endian",
            Self::Binary { big_endian: true } => "binary_big_endian",
        }
    }
}

/// One value a row, or a list with the type of its length.
#[derive(Debug, Clone, Copy)]
pub(super) enum Type {
    One(Scalar),
    List(Scalar, Scalar),
}

pub(super) struct Property {
    pub(super) name: String,
    pub(super) of: Type,
}

pub(super) struct Element {
    pub(super) name: String,
    /// A claim.
    pub(super) count: u64,
    pub(super) properties: Vec<Property>,
}

pub(super) struct Header {
    pub(super) encoding: Encoding,
    pub(super) elements: Vec<Element>,
}

/// Most elements and properties of a file: those of real files are a few dozens.
const MAX_ENTRIES: usize = 1000;

impl Header {
    /// Reads up to `end_header`.
    pub(super) fn read(scan: &mut Scan<'_>) -> Result<Self, FileError> {
        let first = scan.line().unwrap_or_default();
        if first.trim_ascii_end() != b"ply" {
            return Err(wrong(first, "'ply'", scan.place()));
        }
        let (mut encoding, mut elements, mut entries) = (None, Vec::<Element>::new(), 0);
        loop {
            let Some(line) = scan.line() else {
                return Err(FileError::truncated(
                    scan.place(),
                    "expected end_header, got the end of the file",
                ));
            };
            let place = || scan.place();
            let all: Vec<&[u8]> = words(line).take(6).collect();
            match all[..] {
                [b"end_header"] => break,
                [] | [b"comment" | b"obj_info", ..] => {}
                [b"format", name, version] => {
                    encoding = Some(Encoding::of(name, scan)?);
                    if version != b"1.0" {
                        return Err(wrong(version, "version 1.0", place()));
                    }
                }
                [b"element", name, number] => elements.push(Element {
                    name: text(name, place)?.to_owned(),
                    count: count(number, "a number of rows", place)?,
                    properties: Vec::new(),
                }),
                [b"property", ref rest @ ..] => {
                    let property = property(rest, scan)?;
                    let Some(element) = elements.last_mut() else {
                        return Err(FileError::malformed(place(), "expected an element, got a property"));
                    };
                    if element.properties.iter().any(|known| known.name == property.name) {
                        let detail =
                            format!("expected properties of different names, got two {}", property.name);
                        return Err(FileError::malformed(place(), detail));
                    }
                    element.properties.push(property);
                }
                _ => return Err(wrong(line, "a line of the header", place())),
            }
            entries += usize::from(matches!(all.first(), Some(&(b"element" | b"property"))));
            if entries > MAX_ENTRIES {
                let detail = format!("expected at most {MAX_ENTRIES} elements and properties, got more");
                return Err(FileError::too_large(place(), detail));
            }
        }
        let encoding =
            encoding.ok_or_else(|| FileError::malformed(scan.place(), "expected a format, got none"))?;
        Ok(Self { encoding, elements })
    }
}

fn property(rest: &[&[u8]], scan: &Scan<'_>) -> Result<Property, FileError> {
    let place = || scan.place();
    let (of, name) = match *rest {
        [b"list", length, value, name] => {
            let length = scalar(length, scan)?;
            if matches!(length, Scalar::F32 | Scalar::F64) {
                return Err(FileError::malformed(
                    place(),
                    "expected whole numbers as lengths of lists, got others",
                ));
            }
            (Type::List(length, scalar(value, scan)?), name)
        }
        [value, name] => (Type::One(scalar(value, scan)?), name),
        _ => {
            let detail = format!("expected a type and a name of a property, got {} words", rest.len());
            return Err(FileError::malformed(place(), detail));
        }
    };
    Ok(Property { name: text(name, place)?.to_owned(), of })
}

fn scalar(word: &[u8], scan: &Scan<'_>) -> Result<Scalar, FileError> {
    Ok(match word {
        b"char" | b"int8" => Scalar::I8,
        b"uchar" | b"uint8" => Scalar::U8,
        b"short" | b"int16" => Scalar::I16,
        b"ushort" | b"uint16" => Scalar::U16,
        b"int" | b"int32" => Scalar::I32,
        b"uint" | b"uint32" => Scalar::U32,
        b"float" | b"float32" => Scalar::F32,
        b"double" | b"float64" => Scalar::F64,
        other => {
            let detail = format!("expected a type of PLY, got {}", shown(other));
            return Err(FileError::malformed(scan.place(), detail));
        }
    })
}
