//! Arrays in the format NPY of NumPy: a header, which is a Python literal, and the items one after the other.

use std::io::Read;

use super::super::limits::Limits;
use super::super::options::ReadOptions;
use super::super::record::Points;
use crate::error::{FileError, Place};

/// First bytes of a file.
pub(super) const MAGIC: &[u8] = b"\x93NUMPY";
/// Largest number of bytes of a header.
const MAX_HEADER: usize = 1 << 16;
/// Largest number of axes.
const MAX_AXES: usize = 32;

/// Items of an array.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Items {
    Float,
    Signed,
    Unsigned,
    Flag,
    /// Code points of 32 bits, padded with zeros.
    Text,
    /// Bytes of text, padded with zeros.
    Bytes,
}

/// The header of an array.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Header {
    pub(super) items: Items,
    /// Number of bytes of an item.
    pub(super) size: usize,
    big_endian: bool,
    pub(super) fortran: bool,
    pub(super) shape: Vec<usize>,
}

fn malformed(detail: impl Into<String>) -> FileError {
    FileError::malformed(Place::tag("header of the array"), detail)
}

/// The next `count` bytes, for which memory is taken as they arrive.
pub(super) fn exactly(reader: &mut impl Read, count: usize) -> Result<Vec<u8>, FileError> {
    let mut bytes = Vec::new();
    let found = reader.take(count as u64).read_to_end(&mut bytes)?;
    if found == count {
        return Ok(bytes);
    }
    Err(FileError::truncated(Place::default(), format!("expected {count} bytes of an array, got {found}")))
}

impl Header {
    /// Reads the header of an array.
    ///
    /// # Errors
    /// Other bytes, items that are not numbers, flags or texts: Python objects foremost, which are programs.
    pub(super) fn read(reader: &mut impl Read) -> Result<Self, FileError> {
        let head = exactly(reader, MAGIC.len() + 2)?;
        let version =
            head.strip_prefix(MAGIC).ok_or_else(|| malformed("expected \\x93NUMPY, got other bytes"))?;
        let length = match version[0] {
            1 => exactly(reader, 2)?.iter().rev().fold(0, |sum, byte| (sum << 8) | usize::from(*byte)),
            2 | 3 => exactly(reader, 4)?.iter().rev().fold(0, |sum, byte| (sum << 8) | usize::from(*byte)),
            other => return Err(malformed(format!("expected version 1, 2 or 3 of the format, got {other}"))),
        };
        if length > MAX_HEADER {
            return Err(malformed(format!("expected a header of at most {MAX_HEADER} bytes, got {length}")));
        }
        let text = String::from_utf8(exactly(reader, length)?);
        Self::parse(&text.map_err(|_| malformed("expected UTF-8 text, got other bytes"))?)
    }

    fn parse(text: &str) -> Result<Self, FileError> {
        let wrong = || {
            malformed(format!(
                "expected a literal such as {{'descr': '<f8', 'fortran_order': False, 'shape': (3, 2)}}, got {text}"
            ))
        };
        let (mut descr, mut fortran, mut shape) = (None, None, None);
        let mut rest =
            text.trim().strip_prefix('{').and_then(|text| text.strip_suffix('}')).ok_or_else(wrong)?.trim();
        while !rest.is_empty() {
            let (key, after) = quoted(rest).ok_or_else(wrong)?;
            let after = after.trim_start().strip_prefix(':').ok_or_else(wrong)?.trim_start();
            rest = match key {
                "descr" if after.starts_with('[') => {
                    return Err(unsupported("structures of several fields"));
                }
                "descr" => {
                    let (value, after) = quoted(after).ok_or_else(wrong)?;
                    descr = Some(value);
                    after
                }
                "fortran_order" => {
                    let (value, name) =
                        if after.starts_with("True") { (true, "True") } else { (false, "False") };
                    fortran = Some(value);
                    after.strip_prefix(name).ok_or_else(wrong)?
                }
                "shape" => {
                    let (axes, after) =
                        after.strip_prefix('(').and_then(|text| text.split_once(')')).ok_or_else(wrong)?;
                    let axes = axes.split(',').map(str::trim).filter(|axis| !axis.is_empty());
                    // Python 2 wrote `3L`.
                    let axes = axes
                        .map(|axis| axis.trim_end_matches('L').parse().ok())
                        .collect::<Option<Vec<usize>>>();
                    shape = Some(axes.filter(|axes| axes.len() <= MAX_AXES).ok_or_else(wrong)?);
                    after
                }
                _ => return Err(wrong()),
            };
            rest = rest.trim_start();
            rest = rest.strip_prefix(',').unwrap_or(rest).trim_start();
        }
        let (descr, fortran, shape) =
            (descr.ok_or_else(wrong)?, fortran.ok_or_else(wrong)?, shape.ok_or_else(wrong)?);
        let (items, size, big_endian) = type_of(descr)?;
        Ok(Self { items, size, big_endian, fortran, shape })
    }

    /// Number of items, if 64 bits hold it.
    pub(super) fn count(&self) -> Result<u64, FileError> {
        let count = self.shape.iter().try_fold(1_u64, |count, axis| count.checked_mul(*axis as u64));
        count.filter(|count| count.checked_mul(self.size as u64).is_some()).ok_or_else(|| {
            FileError::too_large(
                Place::tag("header of the array"),
                format!("expected fewer items, got a shape of {:?}", self.shape),
            )
        })
    }

    /// Whether items are numbers.
    pub(super) fn is_number(&self) -> bool {
        matches!(self.items, Items::Float | Items::Signed | Items::Unsigned)
    }

    /// The number that an item is; a flag is 0 or 1.
    pub(super) fn number(&self, item: &[u8]) -> f64 {
        let mut bytes = [0; 8];
        for (k, byte) in item.iter().take(8).enumerate() {
            let at = if self.big_endian { self.size - 1 - k } else { k };
            bytes[at.min(7)] = *byte;
        }
        let word = u64::from_le_bytes(bytes);
        match (self.items, self.size) {
            (Items::Float, 4) => f64::from(f32::from_bits(u32::try_from(word).unwrap_or_default())),
            (Items::Float, _) => f64::from_bits(word),
            // The sign is moved to the first bit and back; numbers beyond 2⁵³ are rounded.
            (Items::Signed, size) => {
                let shift = 64 - 8 * size.clamp(1, 8);
                ((word << shift).cast_signed() >> shift) as f64
            }
            _ => word as f64,
        }
    }

    /// The text that an item is.
    pub(super) fn text(&self, item: &[u8]) -> Option<String> {
        if self.items == Items::Bytes {
            let end = item.iter().rposition(|byte| *byte != 0).map_or(0, |at| at + 1);
            return String::from_utf8(item[..end].to_vec()).ok();
        }
        let point = |bytes: &[u8]| {
            let bytes = <[u8; 4]>::try_from(bytes).ok()?;
            char::from_u32(if self.big_endian {
                u32::from_be_bytes(bytes)
            } else {
                u32::from_le_bytes(bytes)
            })
        };
        let text = item.chunks_exact(4).map(point).collect::<Option<String>>()?;
        Some(text.trim_end_matches('\0').to_owned())
    }
}

/// A text in quotes, and the text after it.
fn quoted(text: &str) -> Option<(&str, &str)> {
    let quote = text.chars().next().filter(|quote| matches!(quote, '\'' | '"'))?;
    text[1..].split_once(quote)
}

fn unsupported(found: &str) -> FileError {
    let detail = format!("expected an array of numbers, flags or texts, got {found}");
    FileError::unsupported(Place::tag("header of the array"), detail)
}

fn type_of(descr: &str) -> Result<(Items, usize, bool), FileError> {
    let order = descr.chars().next().filter(|order| matches!(order, '<' | '>' | '|' | '='));
    let rest = &descr[usize::from(order.is_some())..];
    let mut rest = rest.chars();
    let kind = rest.next();
    let size: Option<usize> = rest.as_str().parse().ok();
    let (items, size) = match (kind, size) {
        (Some('O'), _) => {
            return Err(unsupported(
                "Python objects, which are programs; save it with a type such as float64",
            ));
        }
        (Some('f'), Some(size @ (4 | 8))) => (Items::Float, size),
        (Some('i'), Some(size @ (1 | 2 | 4 | 8))) => (Items::Signed, size),
        (Some('u'), Some(size @ (1 | 2 | 4 | 8))) => (Items::Unsigned, size),
        (Some('b'), Some(1)) => (Items::Flag, 1),
        (Some('U'), Some(count @ ..=0xff_ffff)) => (Items::Text, 4 * count),
        (Some('S'), Some(count @ ..=0xff_ffff)) => (Items::Bytes, count),
        _ => return Err(unsupported(&format!("items of type '{descr}'"))),
    };
    Ok((items, size, order == Some('>')))
}

/// How the shapes of an array lie: their number, points of each, coordinates of each point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Layout {
    pub(super) shapes: usize,
    pub(super) points: usize,
    pub(super) dimension: usize,
}

impl Layout {
    /// Three axes are shapes × points × coordinates. Two are points × coordinates of one shape, or with the option `dimension`
    /// shapes × coordinates of all their points.
    ///
    /// # Errors
    /// Items that are not numbers, other numbers of axes, more points than `limits` allow.
    pub(super) fn of(header: &Header, options: &ReadOptions, limits: &Limits) -> Result<Self, FileError> {
        header.count()?;
        if !header.is_number() {
            return Err(unsupported("flags or texts as points"));
        }
        let layout = match (header.shape.as_slice(), options.dimension) {
            ([shapes, points, dimension], None) => {
                Self { shapes: *shapes, points: *points, dimension: *dimension }
            }
            ([shapes, points, dimension], Some(wanted)) if *dimension == wanted => {
                Self { shapes: *shapes, points: *points, dimension: *dimension }
            }
            ([points, dimension], None) => Self { shapes: 1, points: *points, dimension: *dimension },
            ([shapes, width], Some(dimension)) if dimension > 0 && width.is_multiple_of(dimension) => {
                Self { shapes: *shapes, points: width / dimension, dimension }
            }
            (shape, None) => {
                return Err(malformed(format!(
                    "expected shapes × points × coordinates, or points × coordinates, got {shape:?}"
                )));
            }
            (shape, Some(dimension)) => {
                return Err(malformed(format!(
                    "expected points of {dimension} coordinates, got an array of shape {shape:?}"
                )));
            }
        };
        if layout.shapes > 0 && (layout.points == 0 || layout.dimension == 0) {
            return Err(malformed(format!(
                "expected at least one point and one coordinate, got {:?}",
                header.shape
            )));
        }
        limits.points(layout.points as u64, || Place::tag("header of the array"))?;
        limits.points(layout.dimension as u64, || Place::tag("header of the array"))?;
        Ok(layout)
    }

    /// Number of coordinates of a shape.
    pub(super) fn width(&self) -> usize {
        self.points.saturating_mul(self.dimension)
    }

    /// A shape of an array in Fortran order, all items of which are in `bytes`. Its axes are the given ones.
    pub(super) fn transposed(&self, header: &Header, bytes: &[u8], shape: usize) -> Points {
        let flat = header.shape.len() == 2 && self.shapes != 1;
        let mut coordinates = Vec::with_capacity(self.width());
        for point in 0..self.points {
            for axis in 0..self.dimension {
                let at = match header.shape.as_slice() {
                    [shapes, _] if flat => shape + shapes * (point * self.dimension + axis),
                    [_, _] if self.points == header.shape[0] => point + self.points * axis,
                    [shapes, _] => shape + shapes * (point * self.dimension + axis),
                    _ => shape + self.shapes * (point + self.points * axis),
                };
                let item = bytes.get(at * header.size..(at + 1) * header.size).unwrap_or_default();
                coordinates.push(header.number(item));
            }
        }
        Points::from_rows(self.dimension, coordinates)
    }
}

/// The bytes before the items of an array in C order: `descr` is the type of NumPy, such as `<f8`.
pub fn header_bytes(descr: &str, shape: &[usize]) -> Vec<u8> {
    const ALIGNMENT: usize = 64;
    const BEFORE: usize = 10;
    let axes = shape.iter().map(|axis| format!("{axis},")).collect::<Vec<_>>().join(" ");
    let axes = if shape.len() > 1 { axes.trim_end_matches(',') } else { &axes };
    let mut text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({axes}), }}");
    let padding = (ALIGNMENT - (BEFORE + text.len() + 1) % ALIGNMENT) % ALIGNMENT;
    text.push_str(&" ".repeat(padding));
    text.push('\n');
    let length = u16::try_from(text.len()).expect("three numbers fill no 64 KiB");
    [MAGIC, b"\x01\x00", &length.to_le_bytes(), text.as_bytes()].concat()
}
