//! Reading of VTK legacy files.

use super::super::super::limits::{Limits, Room};
use super::super::super::options::ReadOptions;
use super::super::super::record::Sink;
use super::super::super::record::{Domain, Faces};
use super::super::super::source::Source;
use super::super::cells::{self, Cells, by_ends};
use super::super::draft::Draft;
use super::super::scalar::{Scalar, index};
use super::super::scan::{Scan, count, shown, text, words, wrong};
use super::super::{NORMALS, TEXTURE};
use crate::error::{FileError, Place};
use crate::summary::Summary;

/// Carriers of attributes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Carrier {
    Points,
    Cells,
    File,
}

struct Reader<'a> {
    scan: Scan<'a>,
    binary: bool,
    limits: Limits,
    room: Room,
    draft: Draft,
    /// Cells of `POLYDATA`: vertices, lines, polygons and strips, in the order of their data.
    parts: [Faces; 4],
    /// Cells of `UNSTRUCTURED_GRID`, with their types.
    cells: Faces,
    types: Vec<u32>,
    carrier: Carrier,
    /// Number of rows of the attributes, a claim.
    rows: usize,
    /// Attributes of cells: name, width, values.
    of_cells: Vec<(String, usize, Vec<f64>)>,
    summary: Summary,
}

pub(super) fn read(source: &mut Source<'_>, _: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let bytes = source.bytes()?;
    let mut scan = Scan::new(&bytes);
    let first = scan.line().unwrap_or_default();
    if !first.starts_with(b"# vtk DataFile Version ") {
        return Err(wrong(first, "'# vtk DataFile Version'", scan.place()));
    }
    // The title is free text.
    scan.line();
    let encoding = scan.line().unwrap_or_default().trim_ascii();
    let binary = match encoding {
        b"ASCII" => false,
        b"BINARY" => true,
        other => return Err(wrong(other, "'ASCII' or 'BINARY'", scan.place())),
    };
    let mut reader = Reader {
        scan,
        binary,
        limits,
        room: Room::new(&limits, bytes.len()),
        draft: Draft::new(Place::default()),
        parts: Default::default(),
        cells: Faces::default(),
        types: Vec::new(),
        carrier: Carrier::File,
        rows: 0,
        of_cells: Vec::new(),
        summary: Summary::default(),
    };
    reader.summary.set("encoding", if binary { "binary" } else { "ascii" });
    while reader.section()? {}
    reader.send(sink)
}

impl<'a> Reader<'a> {
    /// Reads a section. Returns `false` at the end of the file.
    fn section(&mut self) -> Result<bool, FileError> {
        self.scan.skip_spaces();
        let Some(line) = self.scan.line() else { return Ok(false) };
        let all: Vec<&[u8]> = words(line).collect();
        let place = self.scan.place();
        let keyword = all.first().map(|word| word.to_ascii_uppercase()).unwrap_or_default();
        match (&keyword[..], &all[1.min(all.len())..]) {
            (b"DATASET", [name]) => {
                if !matches!(*name, b"POLYDATA" | b"UNSTRUCTURED_GRID") {
                    let detail = format!("expected POLYDATA or UNSTRUCTURED_GRID, got {}", shown(name));
                    return Err(FileError::unsupported(place, detail));
                }
            }
            (b"POINTS", [number, of]) => self.points(number, of, &place)?,
            (b"VERTICES", [number, size]) => self.parts[0] = self.list(number, size, &place)?,
            (b"LINES", [number, size]) => self.parts[1] = self.list(number, size, &place)?,
            (b"POLYGONS", [number, size]) => self.parts[2] = self.list(number, size, &place)?,
            (b"TRIANGLE_STRIPS", [number, size]) => self.parts[3] = self.list(number, size, &place)?,
            (b"CELLS", [number, size]) => self.cells = self.list(number, size, &place)?,
            (b"CELL_TYPES", [number]) => {
                let number = self.count(number, &place)?;
                let types = self.values(b"int", number, "types of cells")?.unwrap_or_default();
                self.types = indices(&types, "types of cells", &place)?;
            }
            (b"POINT_DATA", [number]) => {
                self.carrier = Carrier::Points;
                self.rows = self.count(number, &place)?;
                if self.rows != self.draft.vertices.len() {
                    let detail =
                        format!("expected data of {} points, got {}", self.draft.vertices.len(), self.rows);
                    return Err(FileError::malformed(place, detail));
                }
            }
            (b"CELL_DATA", [number]) => {
                self.carrier = Carrier::Cells;
                self.rows = self.count(number, &place)?;
            }
            // A description of the array before, up to an empty line.
            (b"METADATA", []) => while self.scan.line().is_some_and(|line| !line.trim_ascii().is_empty()) {},
            (b"FIELD", [_, number]) => self.field(number, &place)?,
            (other, rest) => self.attribute(other, rest, line, &place)?,
        }
        Ok(true)
    }

    fn points(&mut self, number: &[u8], of: &[u8], place: &Place) -> Result<(), FileError> {
        let number = count(number, "a number of points", || place.clone())?;
        let number = self.limits.points(number, || place.clone())?;
        if !self.draft.vertices.is_empty() {
            return Err(FileError::malformed(place.clone(), "expected one list of points, got two"));
        }
        let Some(values) = self.values(of, number.saturating_mul(3), "coordinates")? else {
            return Err(wrong(of, "a type of coordinates", place.clone()));
        };
        values.chunks_exact(3).for_each(|point| self.draft.vertices.push(point));
        Ok(())
    }

    /// Cells: their lengths and indices in turn, or offsets and indices (version 5).
    fn list(&mut self, number: &[u8], size: &[u8], place: &Place) -> Result<Faces, FileError> {
        let number = count(number, "a number of cells", || place.clone())?;
        let number = self.limits.faces(number, || place.clone())?;
        let size = self.count(size, place)?;
        if self.scan.rest().starts_with(b"OFFSETS ") {
            let [ends, list] = [("OFFSETS", number), ("CONNECTIVITY", size)].map(|(keyword, count)| {
                self.scan.skip_spaces();
                let line = self.scan.line().unwrap_or_default();
                match words(line).collect::<Vec<_>>()[..] {
                    [word, of] if word == keyword.as_bytes() => {
                        let values = self.values(of, count, "indices")?.unwrap_or_default();
                        indices(&values, "offsets and indices of points", place)
                    }
                    _ => Err(wrong(line, &format!("{keyword} with a type"), self.scan.place())),
                }
            });
            let (ends, list) = (ends?, list?);
            return by_ends(&list, ends.get(1..).unwrap_or_default(), || place.clone());
        }
        let values = self.values(b"int", size, "lengths and indices of cells")?.unwrap_or_default();
        let values = indices(&values, "lengths and indices of cells", place)?;
        let mut cells = Faces::default();
        let mut at = 0;
        for k in 0..number {
            let cell = values.get(at).and_then(|length| values.get(at + 1..at + 1 + *length as usize));
            let cell = cell.ok_or_else(|| {
                let detail = format!("expected {number} cells in {size} numbers, got {k}");
                FileError::malformed(place.clone(), detail)
            })?;
            cells.push(cell.iter().copied());
            at += 1 + cell.len();
        }
        if at < values.len() {
            let detail = format!("expected {at} numbers of {number} cells, got {}", values.len());
            return Err(FileError::malformed(place.clone(), detail));
        }
        Ok(cells)
    }

    /// Attributes of points or cells that begin with their kind.
    fn attribute(
        &mut self,
        keyword: &[u8],
        rest: &[&[u8]],
        line: &[u8],
        place: &Place,
    ) -> Result<(), FileError> {
        let (name, of, width): (&[u8], &[u8], usize) = match (keyword, rest) {
            (b"SCALARS", [name, of]) => (name, of, 1),
            (b"SCALARS", [name, of, width]) => (name, of, self.count(width, place)?),
            (b"COLOR_SCALARS", [name, width]) => {
                (name, if self.binary { b"unsigned_char" } else { b"float" }, self.count(width, place)?)
            }
            (b"NORMALS" | b"VECTORS", [name, of]) => (name, of, 3),
            (b"TENSORS", [name, of]) => (name, of, 9),
            (b"TENSORS6", [name, of]) => (name, of, 6),
            (b"TEXTURE_COORDINATES", [name, width, of]) => (name, of, self.count(width, place)?),
            (b"GLOBAL_IDS" | b"PEDIGREE_IDS" | b"EDGE_FLAGS", [name, of]) => (name, of, 1),
            (b"LOOKUP_TABLE", [name, size]) => {
                let of: &[u8] = if self.binary { b"unsigned_char" } else { b"float" };
                let size = self.count(size, place)?.saturating_mul(4);
                self.values(of, size, "colours of a table")?;
                self.summary.drop("tables of colours", Some(&shown(name)), || place.clone());
                return Ok(());
            }
            _ => return Err(wrong(line, "a section of a VTK file", place.clone())),
        };
        if keyword == b"SCALARS" && self.scan.rest().starts_with(b"LOOKUP_TABLE ") {
            self.scan.line();
        }
        let values = self.values(of, self.rows.saturating_mul(width), "an attribute")?;
        let name = match (keyword, width) {
            (b"NORMALS", 3) => NORMALS.into(),
            (b"TEXTURE_COORDINATES", 2) => TEXTURE.into(),
            _ => decoded(name, place)?,
        };
        self.add(name, width, self.rows, values, place)
    }

    fn field(&mut self, number: &[u8], place: &Place) -> Result<(), FileError> {
        let carrier = self.carrier;
        for _ in 0..count(number, "a number of arrays", || place.clone())? {
            self.scan.skip_spaces();
            let line = self.scan.line().unwrap_or_default();
            let place = self.scan.place();
            let all: Vec<&[u8]> = words(line).collect();
            if all[..] == [&b"METADATA"[..]] {
                while self.scan.line().is_some_and(|line| !line.trim_ascii().is_empty()) {}
                continue;
            }
            let [name, width, rows, of] = all[..] else {
                return Err(wrong(line, "name, components, rows and type of an array", place));
            };
            let (width, rows) = (self.count(width, &place)?, self.count(rows, &place)?);
            let values = self.values(of, width.saturating_mul(rows), "an array")?;
            self.carrier = carrier;
            self.add(decoded(name, &place)?, width, rows, values, &place)?;
        }
        Ok(())
    }

    /// Keeps an array, if it is one of numbers of points or cells.
    fn add(
        &mut self,
        name: String,
        width: usize,
        rows: usize,
        values: Option<Vec<f64>>,
        place: &Place,
    ) -> Result<(), FileError> {
        let Some(values) = values else {
            self.summary.drop("arrays of texts", Some(&name), || place.clone());
            return Ok(());
        };
        if self.carrier != Carrier::File && rows != self.rows {
            let detail = format!("expected {} rows of array '{name}', got {rows}", self.rows);
            return Err(FileError::malformed(place.clone(), detail));
        }
        match self.carrier {
            _ if width == 0 => self.summary.drop("arrays without components", Some(&name), || place.clone()),
            Carrier::Points => self.draft.field(&name, Domain::Vertices, width, values),
            Carrier::Cells => self.of_cells.push((name, width, values)),
            Carrier::File => self.summary.drop("arrays of the whole file", Some(&name), || place.clone()),
        }
        Ok(())
    }

    /// Values of a type; `None` for texts, which are skipped.
    fn values(&mut self, of: &[u8], count: usize, what: &str) -> Result<Option<Vec<f64>>, FileError> {
        let of = of.to_ascii_lowercase();
        let scalar = match &of[..] {
            b"unsigned_char" => Scalar::U8,
            b"char" | b"signed_char" => Scalar::I8,
            b"unsigned_short" => Scalar::U16,
            b"short" => Scalar::I16,
            b"unsigned_int" => Scalar::U32,
            b"int" | b"vtkidtype" => Scalar::I32,
            b"unsigned_long" | b"vtktypeuint64" => Scalar::U64,
            b"long" | b"vtktypeint64" => Scalar::I64,
            b"float" => Scalar::F32,
            b"double" => Scalar::F64,
            b"bit" if self.binary => {
                let bytes = self.scan.take(count.div_ceil(8), what)?;
                self.room.take(count, || self.scan.place())?;
                return Ok(Some((0..count).map(|k| f64::from(bytes[k / 8] >> (7 - k % 8) & 1)).collect()));
            }
            b"bit" => Scalar::U8,
            b"string" if !self.binary => {
                for _ in 0..count {
                    if self.scan.line().is_none() {
                        let detail = format!("expected {count} texts, got the end of the file");
                        return Err(FileError::truncated(self.scan.place(), detail));
                    }
                }
                return Ok(None);
            }
            other => {
                return Err(FileError::unsupported(
                    self.scan.place(),
                    format!("expected an array of numbers, got one of {}", shown(other)),
                ));
            }
        };
        if self.binary {
            let bytes = self.scan.take(count.saturating_mul(scalar.size()), what)?;
            self.room.take(count, || self.scan.place())?;
            return Ok(Some(scalar.decode_all(bytes, true)));
        }
        let mut values = Vec::new();
        for _ in 0..count {
            values.push(self.scan.number("a number")?);
        }
        Ok(Some(values))
    }

    fn count(&self, word: &[u8], place: &Place) -> Result<usize, FileError> {
        let found = count(word, "a count", || place.clone())?;
        // More than memory holds: no file has as many.
        Ok(usize::try_from(found).unwrap_or(usize::MAX))
    }

    fn send(mut self, sink: Sink<'_>) -> Result<Summary, FileError> {
        if self.cells.len() != self.types.len() {
            let detail = format!("expected types of {} cells, got {}", self.cells.len(), self.types.len());
            return Err(FileError::malformed(Place::tag("CELL_TYPES"), detail));
        }
        let mut cells = Cells::default();
        let kinds = [cells::POINTS, cells::LINE, cells::POLYGON, cells::STRIP];
        for (part, kind) in self.parts.iter().zip(kinds) {
            cells.add(part, |_| kind, &mut self.draft, &mut self.summary);
        }
        cells.add(&self.cells, |k| self.types[k], &mut self.draft, &mut self.summary);
        self.limits.faces(self.draft.faces.len() as u64, Place::default)?;
        // Taken one by one: values of cells are not needed beside those of faces.
        for (name, width, values) in std::mem::take(&mut self.of_cells) {
            let place = || Place::tag(format!("CELL_DATA {name}"));
            if cells.count().checked_mul(width) != Some(values.len()) {
                let detail =
                    format!("expected data of {} cells, got {}", cells.count(), values.len() / width);
                return Err(FileError::malformed(place(), detail));
            }
            cells
                .field(&name, width, &values, &mut self.draft, &self.room)
                .map_err(|error| error.at(place()))?;
        }
        self.draft.send(&mut self.summary, sink)?;
        Ok(self.summary)
    }
}

fn indices(values: &[f64], what: &str, place: &Place) -> Result<Vec<u32>, FileError> {
    let fault = |value: &f64| FileError::malformed(place.clone(), format!("expected {what}, got {value}"));
    values.iter().map(|value| index(*value).ok_or_else(|| fault(value))).collect()
}

/// A name, in which `%20` is a space.
fn decoded(name: &[u8], place: &Place) -> Result<String, FileError> {
    let mut bytes = Vec::new();
    let mut rest = name;
    while let [first, others @ ..] = rest {
        let code = others.get(..2).and_then(|code| std::str::from_utf8(code).ok());
        match code.and_then(|code| u8::from_str_radix(code, 16).ok()) {
            Some(code) if *first == b'%' => {
                bytes.push(code);
                rest = &others[2..];
            }
            _ => {
                bytes.push(*first);
                rest = others;
            }
        }
    }
    text(&bytes, || place.clone()).map(str::to_owned)
}
