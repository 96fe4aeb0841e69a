//! NRRD: a header of text lines, and the numbers after it as they are, inside of gzip, or as text.

use std::collections::BTreeMap;

use flate2::read::MultiGzDecoder;

use super::error::ImageError;
use super::file::{Description, ImageFile};
use super::format::LabelNames;
use super::grid::{Grid, LengthUnit, cross};
use super::limits::{Limits, reserve};
use super::stream::{DEFLATE_RATIO, STREAM_BYTES, Stream};
use super::value::{Numbers, Source, Target, ValueType};
use crate::unit::Unit;
use crate::words::MAX_NAME;

/// Name in messages.
pub(super) const NAME: &str = "NRRD";

const CELLS: &str = "NRRD cells";

/// Number of characters of a field that a message shows.
const SHOWN: usize = 40;

/// Used part of a header, checked.
struct Header {
    grid: Grid,
    numbers: Numbers,
    encoding: Encoding,
    /// Position of the numbers.
    offset: usize,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Encoding {
    Raw,
    Gzip,
    Text,
}

pub(super) fn describe(bytes: &[u8], limits: &Limits) -> Result<Description, ImageError> {
    let Header { grid, numbers, .. } = Header::new(bytes, limits)?;
    let memory_bytes = grid.cells() as u64 * size_of::<f32>() as u64 + STREAM_BYTES;
    Ok(Description { grid, stored: numbers.stored, channels: 1, memory_bytes })
}

pub(super) fn read<T: Target>(bytes: &[u8], limits: &Limits) -> Result<ImageFile<T>, ImageError> {
    let header = Header::new(bytes, limits)?;
    let data = &bytes[header.offset..];
    let cells = header.grid.cells();
    let expected = cells as u64 * header.numbers.stored.bytes() as u64;
    let (mut stream, most) = match header.encoding {
        Encoding::Text => {
            return Ok(ImageFile { grid: header.grid, values: text(data, cells)? });
        }
        Encoding::Raw => (Stream::new(data, NAME), data.len() as u64),
        Encoding::Gzip => {
            let most = (data.len() as u64).saturating_mul(DEFLATE_RATIO);
            (Stream::new(MultiGzDecoder::new(data), NAME), most)
        }
    };
    if most < expected {
        return Err(ImageError::Truncated { place: CELLS, expected, found: most });
    }
    let mut values = reserve(cells)?;
    let width = header.numbers.stored.bytes();
    stream.blocks(expected, width, CELLS, |block| header.numbers.decode(block, &mut values))?;
    stream.end(expected, CELLS)?;
    Ok(ImageFile { grid: header.grid, values })
}

/// Names of segments as 3D Slicer writes them: `Segment0_LabelValue:=1`, `Segment0_Name:=liver`.
pub(super) fn names(bytes: &[u8], limits: &Limits) -> Result<LabelNames, ImageError> {
    Header::new(bytes, limits)?;
    let (fields, _) = Fields::new(bytes)?;
    let name = |(key, label): (&String, &String)| {
        let segment = key.strip_suffix("_LabelValue")?;
        let name = fields.pairs.get(&format!("{segment}_Name"))?;
        Some((label.trim().parse().ok()?, name.trim().to_owned()))
    };
    let names: BTreeMap<u32, String> = fields.pairs.iter().filter_map(name).collect();
    if let Some(long) = names.values().find(|name| name.len() > MAX_NAME) {
        let fault = format!("expected names of segments of at most {MAX_NAME} bytes, got {}", long.len());
        return Err(ImageError::corrupt(NAME, fault));
    }
    Ok(LabelNames { of: names, warnings: Vec::new() })
}

/// The lines of a header.
struct Fields {
    /// `name: text`; names in lower case.
    fields: BTreeMap<String, String>,
    /// `key:=text`.
    pairs: BTreeMap<String, String>,
}

impl Fields {
    /// The fields, and where the empty line that ends them ends.
    fn new(bytes: &[u8]) -> Result<(Self, usize), ImageError> {
        let mut found = Self { fields: BTreeMap::new(), pairs: BTreeMap::new() };
        let mut offset = 0;
        for (number, line) in bytes.split_inclusive(|byte| *byte == b'\n').enumerate() {
            offset += line.len();
            if !line.ends_with(b"\n") {
                break;
            }
            let line = std::str::from_utf8(line).map_err(|_| {
                ImageError::corrupt(
                    NAME,
                    format!("expected UTF-8 text in line {}, got other bytes", number + 1),
                )
            })?;
            let line = line.trim_end_matches(['\n', '\r']);
            if line.is_empty() {
                return Ok((found, offset));
            }
            // The first line is the magic one.
            if number > 0 && !line.starts_with('#') {
                found.line(line, number + 1)?;
            }
        }
        Err(ImageError::Short { format: NAME })
    }

    fn line(&mut self, line: &str, number: usize) -> Result<(), ImageError> {
        let fault = |what: &str| ImageError::corrupt(NAME, format!("expected {what} in line {number}"));
        let (map, key, text) = match (line.split_once(":="), line.split_once(": ")) {
            (Some((key, text)), other) if other.is_none_or(|(name, _)| name.len() > key.len()) => {
                (&mut self.pairs, key.to_owned(), text)
            }
            (_, Some((name, text))) => (&mut self.fields, name.trim().to_lowercase(), text),
            _ => return Err(fault("'field: text' or 'key:=text', got neither")),
        };
        match map.insert(key, text.trim().to_owned()) {
            None => Ok(()),
            Some(_) => Err(fault("each field once, got one again")),
        }
    }

    fn get(&self, name: &str) -> Option<&str> {
        self.fields.get(name).map(String::as_str)
    }

    fn required(&self, name: &'static str) -> Result<&str, ImageError> {
        self.get(name)
            .ok_or_else(|| ImageError::corrupt(NAME, format!("expected a field '{name}', got none")))
    }
}

fn unsupported(expected: &'static str, found: &str) -> ImageError {
    let found = found.chars().take(SHOWN).collect();
    ImageError::Unsupported { format: NAME, expected, found }
}

impl Header {
    fn new(bytes: &[u8], limits: &Limits) -> Result<Self, ImageError> {
        let (fields, offset) = Fields::new(bytes)?;
        if let Some(file) = fields.get("data file").or_else(|| fields.get("datafile")) {
            return Err(unsupported("cells after the header", &format!("those of another file ({file})")));
        }
        for name in ["line skip", "lineskip", "byte skip", "byteskip"] {
            if let Some(skip) = fields.get(name).filter(|skip| *skip != "0") {
                return Err(unsupported("cells right after the header", &format!("{name} {skip}")));
            }
        }
        let encoding = match fields.required("encoding")? {
            "raw" => Encoding::Raw,
            "gzip" | "gz" => Encoding::Gzip,
            "ascii" | "text" | "txt" => Encoding::Text,
            other => return Err(unsupported("the encoding raw, gzip or ascii", other)),
        };
        let stored = value_type(fields.required("type")?)?;
        let big_endian = match fields.get("endian") {
            Some("little") => false,
            Some("big") => true,
            None if stored.bytes() == 1 || encoding == Encoding::Text => false,
            other => {
                let found = other.unwrap_or("none");
                return Err(ImageError::corrupt(
                    NAME,
                    format!("expected the endian little or big, got {found}"),
                ));
            }
        };
        let axes = Axes::new(&fields)?;
        let size = limits.size(axes.size)?;
        let cells = size.iter().map(|size| *size as u128).product::<u128>();
        limits.bytes(CELLS, cells * stored.bytes() as u128 + offset as u128)?;
        let grid = Grid::new(size, axes.affine, [axes.unit; 3])?;
        Ok(Self { grid, numbers: Numbers { stored, big_endian, scale: None }, encoding, offset })
    }
}

/// Size and positions.
struct Axes {
    size: [u64; 3],
    affine: [[f64; 4]; 3],
    unit: LengthUnit,
}

impl Axes {
    fn new(fields: &Fields) -> Result<Self, ImageError> {
        let count: usize = match fields.required("dimension")?.parse() {
            Ok(count @ 2..=3) => count,
            _ => return Err(unsupported("2 or 3 axes (dimension)", fields.required("dimension")?)),
        };
        let sizes = words(fields.required("sizes")?, count, "sizes")?;
        let mut size = [1; 3];
        for (size, word) in size.iter_mut().zip(sizes) {
            *size = word.parse().map_err(|_| {
                let word: String = word.chars().take(SHOWN).collect();
                ImageError::corrupt(NAME, format!("expected whole numbers in sizes, got '{word}'"))
            })?;
        }
        if let Some(kinds) = fields.get("kinds") {
            let spatial = |kind: &&str| ["domain", "space", "???", "none"].contains(kind);
            if let Some(kind) = words(kinds, count, "kinds")?.iter().find(|kind| !spatial(kind)) {
                return Err(unsupported("one number for each cell (kinds domain or space)", kind));
            }
        }
        let unit = unit(fields)?;
        let mut affine = match fields.get("space directions") {
            Some(text) => directions(text, count, fields.get("space origin"))?,
            None => spacings(fields.get("spacings"), count)?,
        };
        affine.iter_mut().flatten().for_each(|entry| *entry = unit.millimetres(*entry));
        let sizes = ["space directions", "spacings"].iter().any(|name| fields.get(name).is_some());
        let unit = if unit == LengthUnit::Unknown && !sizes { LengthUnit::Cell } else { unit };
        Ok(Self { size, affine, unit })
    }
}

/// A list of `count` words.
fn words<'a>(text: &'a str, count: usize, name: &str) -> Result<Vec<&'a str>, ImageError> {
    let words: Vec<&str> = text.split_whitespace().collect();
    if words.len() == count {
        return Ok(words);
    }
    Err(ImageError::corrupt(NAME, format!("expected {count} entries of {name}, got {}", words.len())))
}

fn number(word: &str, name: &str) -> Result<f64, ImageError> {
    word.trim().parse().ok().filter(|x: &f64| x.is_finite()).ok_or_else(|| {
        let word: String = word.chars().take(SHOWN).collect();
        ImageError::corrupt(NAME, format!("expected finite numbers in {name}, got '{word}'"))
    })
}

/// One spacing an axis, 1 where there is none.
fn spacings(text: Option<&str>, count: usize) -> Result<[[f64; 4]; 3], ImageError> {
    let mut affine = [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]];
    let Some(text) = text else { return Ok(affine) };
    for (axis, word) in words(text, count, "spacings")?.into_iter().enumerate() {
        // A file that knows no spacing along an axis says so.
        affine[axis][axis] = if word.eq_ignore_ascii_case("nan") { 1.0 } else { number(word, "spacings")? };
    }
    Ok(affine)
}

/// The steps from cell to cell and the first cell, as vectors `(x,y,z)` of two or three coordinates.
fn directions(text: &str, count: usize, origin: Option<&str>) -> Result<[[f64; 4]; 3], ImageError> {
    let vectors = vectors(text, "space directions")?;
    if vectors.len() != count {
        let fault = format!("expected {count} vectors of space directions, got {}", vectors.len());
        return Err(ImageError::corrupt(NAME, fault));
    }
    let mut columns = [[0.0; 3]; 4];
    columns[..count].copy_from_slice(&vectors);
    if count == 2 {
        let normal = cross(columns[0], columns[1]);
        let length = normal.iter().map(|x| x * x).sum::<f64>().sqrt();
        columns[2] = normal.map(|x| if length > 0.0 { x / length } else { 0.0 });
    }
    if let Some(origin) = origin {
        match self::vectors(origin, "space origin")?[..] {
            [first] => columns[3] = first,
            ref found => {
                let fault = format!("expected one vector of space origin, got {}", found.len());
                return Err(ImageError::corrupt(NAME, fault));
            }
        }
    }
    Ok(std::array::from_fn(|r| std::array::from_fn(|c| columns[c][r])))
}

/// Vectors in parentheses; the third coordinate of those in the plane is 0.
fn vectors(text: &str, name: &str) -> Result<Vec<[f64; 3]>, ImageError> {
    let fault = || ImageError::corrupt(NAME, format!("expected vectors '(x,y,z)' in {name}, got other text"));
    if text.contains("none") {
        return Err(unsupported("one number for each cell (space directions without none)", text));
    }
    let mut found = Vec::new();
    for part in text.split(')') {
        let part = part.trim();
        if part.is_empty() {
            continue;
        }
        let inner = part.strip_prefix('(').ok_or_else(fault)?;
        let numbers: Vec<f64> = inner.split(',').map(|word| number(word, name)).collect::<Result<_, _>>()?;
        found.push(match numbers[..] {
            [x, y] => [x, y, 0.0],
            [x, y, z] => [x, y, z],
            _ => return Err(fault()),
        });
    }
    Ok(found)
}

/// The unit of all axes, `"mm" "mm" "mm"`. Spaces of patients are in millimetres if nothing else is said.
fn unit(fields: &Fields) -> Result<LengthUnit, ImageError> {
    let Some(text) = fields.get("space units").or_else(|| fields.get("units")) else {
        let patient = fields.get("space").is_some_and(|space| {
            let space = space.to_lowercase();
            ["lps", "ras", "las"].contains(&space.as_str()) || space.ends_with("superior")
        });
        return Ok(if patient { LengthUnit::Millimetre } else { LengthUnit::Unknown });
    };
    let mut units = text.split('"').map(str::trim).filter(|unit| !unit.is_empty());
    let first = units.next().unwrap_or_default();
    if units.any(|unit| unit != first) {
        return Err(unsupported("one unit of all axes", text));
    }
    match Unit::find(first) {
        _ if ["", "???"].contains(&first) => Ok(LengthUnit::Unknown),
        Some(unit) if unit != Unit::None => Ok(unit.into()),
        _ => Err(unsupported("lengths in m, cm, mm, um, nm or inch (space units)", first)),
    }
}

fn value_type(text: &str) -> Result<ValueType, ImageError> {
    match text.to_lowercase().as_str() {
        "signed char" | "int8" | "int8_t" => Ok(ValueType::I8),
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => Ok(ValueType::U8),
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => {
            Ok(ValueType::I16)
        }
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => Ok(ValueType::U16),
        "int" | "signed int" | "int32" | "int32_t" => Ok(ValueType::I32),
        "uint" | "unsigned int" | "uint32" | "uint32_t" => Ok(ValueType::U32),
        "longlong"
        | "long long"
        | "long long int"
        | "signed long long"
        | "signed long long int"
        | "int64"
        | "int64_t" => Ok(ValueType::I64),
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => {
            Ok(ValueType::U64)
        }
        "float" => Ok(ValueType::F32),
        "double" => Ok(ValueType::F64),
        _ => Err(unsupported("integers or floating-point numbers of 8 to 64 bits (type)", text)),
    }
}

/// Numbers in a text, between blanks or commas. Whole numbers do not pass through a floating-point type.
fn text<T: Target>(bytes: &[u8], cells: usize) -> Result<Vec<T>, ImageError> {
    let text = std::str::from_utf8(bytes).map_err(|_| {
        ImageError::corrupt(NAME, "expected numbers as text after the header, got other bytes")
    })?;
    // Every number takes a digit and a blank.
    if bytes.len() / 2 + 1 < cells {
        return Err(ImageError::Values { what: CELLS, expected: cells, found: bytes.len() / 2 + 1 });
    }
    let mut values = reserve(cells)?;
    for word in text.split(|c: char| c.is_ascii_whitespace() || c == ',').filter(|word| !word.is_empty()) {
        if values.len() == cells {
            return Err(ImageError::Values { what: CELLS, expected: cells, found: cells + 1 });
        }
        values.push(match word.parse::<i64>() {
            Ok(whole) => whole.to(values.len())?,
            Err(_) => number(word, "the cells")?.to(values.len())?,
        });
    }
    if values.len() < cells {
        return Err(ImageError::Values { what: CELLS, expected: cells, found: values.len() });
    }
    Ok(values)
}
