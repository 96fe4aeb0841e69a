//! VTK XML files: `PolyData` (.vtp) and the polygons of `UnstructuredGrid` (.vtu), as text, base64 or appended raw, compressed by
//! zlib or not. Each piece is a separate shape.

use super::super::format::Format;
use super::super::limits::{Bound, Budget, Limits, Room};
use super::super::options::ReadOptions;
use super::super::record::Sink;
use super::super::record::{Domain, Faces, Kind};
use super::super::source::Source;
use super::cells::{self, Cells, by_ends};
use super::draft::Draft;
use super::encoded::{Bytes, inflate};
use super::scalar::{Scalar, index};
use super::scan::{count, number, shown, words};
use super::xml::{Element, parse};
use super::{NORMALS, TEXTURE};
use crate::error::{FileError, Place};
use crate::summary::Summary;

/// VTK XML files.
pub(in super::super) static FORMAT: Format = Format {
    id: "vtp",
    name: "VTK XML",
    media_types: &["application/vnd.kitware.vtp+xml"],
    extensions: &["vtp", "vtu"],
    recognise: |head| head.windows(8).any(|word| word == b"<VTKFile"),
    kinds: &[Kind::Mesh, Kind::Curve, Kind::Landmarks],
    options: &[],
    read: Some(read),
    open: None,
};

fn read(source: &mut Source<'_>, _: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let bytes = source.bytes()?;
    // Appended data may not be text: they begin after the start of its element.
    let start = bytes.windows(13).position(|word| word == b"<AppendedData");
    let end = start
        .and_then(|start| bytes[start..].iter().position(|byte| *byte == b'>').map(|end| start + end + 1));
    let text = std::str::from_utf8(&bytes[..end.unwrap_or(bytes.len())]).map_err(|error| {
        FileError::malformed(Place::byte(error.valid_up_to() as u64), "expected UTF-8 text, got other bytes")
    })?;
    let root = parse(text.trim_start_matches('\u{feff}'), &limits, "AppendedData")?;
    let room = Room::new(&limits, bytes.len());
    let arrays = Arrays::of(&root, &bytes[end.unwrap_or(bytes.len())..], room, source)?;
    let (grid, is_grid) =
        match (root.attribute("type"), root.child("PolyData"), root.child("UnstructuredGrid")) {
            (Some("PolyData"), Some(data), _) => (data, false),
            (Some("UnstructuredGrid"), _, Some(data)) => (data, true),
            (other, ..) => {
                let detail = format!(
                    "expected data of type PolyData or UnstructuredGrid, got {}",
                    other.unwrap_or("none")
                );
                return Err(FileError::unsupported(root.place(), detail));
            }
        };
    let mut summary = Summary::default();
    if let Some(data) = grid.child("FieldData") {
        for array in &data.children {
            summary.drop("arrays of the whole file", array.attribute("Name"), || array.place());
        }
    }
    let mut pieces = 0;
    for (k, piece) in grid.all("Piece").enumerate() {
        let place = Place { item: Some(k as u64), ..piece.place() };
        let mut draft = Draft::new(place.clone());
        arrays
            .piece(piece, is_grid, &mut draft, &mut summary)
            .map_err(|error| error.at(Place::item(k as u64)))?;
        draft.send(&mut summary, sink)?;
        pieces += 1;
    }
    if pieces == 0 {
        return Err(FileError::malformed(grid.place(), "expected a Piece, got none"));
    }
    Ok(summary)
}

/// Bytes from which the arrays of a file may be decoded. The file has fewer where arrays name the same ones, and nothing may come out of
/// them: spaces of base64, empty blocks of zlib.
const DECODED: Bound = Bound { what: "bytes that arrays are decoded from", free: 8 << 20, per_byte: 16 };
/// As many of them are counted for each compressed block, which is some work even if it is empty.
const BLOCK: usize = 64;

/// How arrays are encoded.
struct Arrays<'a> {
    big_endian: bool,
    /// Type of the lengths before arrays.
    header: Scalar,
    compressed: bool,
    appended: Option<Bytes<'a>>,
    limits: Limits,
    room: Room,
    decoded: Budget,
}

impl<'a> Arrays<'a> {
    fn of(root: &Element<'_>, rest: &'a [u8], room: Room, source: &Source<'_>) -> Result<Self, FileError> {
        let (limits, decoded) = (*source.limits(), source.budget(DECODED));
        let refused = |what: &str, value: &str| {
            FileError::unsupported(root.place(), format!("expected {what}, got {}", shown(value.as_bytes())))
        };
        if root.name != "VTKFile" {
            return Err(FileError::malformed(
                root.place(),
                format!("expected VTKFile, got {}", shown(root.name.as_bytes())),
            ));
        }
        let big_endian = match root.attribute("byte_order") {
            None | Some("LittleEndian") => false,
            Some("BigEndian") => true,
            Some(other) => return Err(refused("byte_order LittleEndian or BigEndian", other)),
        };
        let header = match root.attribute("header_type") {
            None | Some("UInt32") => Scalar::U32,
            Some("UInt64") => Scalar::U64,
            Some(other) => return Err(refused("header_type UInt32 or UInt64", other)),
        };
        let compressed = match root.attribute("compressor") {
            None | Some("") => false,
            Some("vtkZLibDataCompressor") => true,
            Some(other) => return Err(refused("compressor vtkZLibDataCompressor", other)),
        };
        let appended = match root.child("AppendedData") {
            None => None,
            Some(element) => {
                // The data begin after an underscore.
                let start = rest.iter().position(|byte| *byte == b'_').ok_or_else(|| {
                    FileError::truncated(element.place(), "expected data that begin with '_', got none")
                })?;
                let data = &rest[start + 1..];
                Some(match element.attribute("encoding") {
                    Some("raw") => Bytes::Raw(data),
                    None | Some("base64") => Bytes::base64(data),
                    Some(other) => return Err(refused("encoding raw or base64", other)),
                })
            }
        };
        Ok(Self { big_endian, header, compressed, appended, limits, room, decoded })
    }

    fn piece(
        &self,
        piece: &Element<'_>,
        is_grid: bool,
        draft: &mut Draft,
        summary: &mut Summary,
    ) -> Result<(), FileError> {
        let number = claim(piece, "NumberOfPoints")?;
        let number = self.limits.points(number, || piece.place())?;
        let points = piece.child("Points").and_then(|points| points.child("DataArray"));
        if let Some(array) = points {
            let (width, values) = self.values(array, None)?;
            if width != 3 || values.len() != 3 * number {
                let detail = format!(
                    "expected {number} × 3 coordinates, got {} × {width}",
                    values.len() / width.max(1)
                );
                return Err(FileError::malformed(array.place(), detail));
            }
            values.chunks_exact(3).for_each(|point| draft.vertices.push(point));
        }
        let mut cells = Cells::default();
        if is_grid {
            if let Some(part) = piece.child("Cells") {
                let (faces, kinds) = (self.cells(part)?, self.indices(part, "types")?);
                if kinds.len() != faces.len() {
                    let detail = format!("expected types of {} cells, got {}", faces.len(), kinds.len());
                    return Err(FileError::malformed(part.place(), detail));
                }
                cells.add(&faces, |k| kinds[k], draft, summary);
            }
        } else {
            let parts = [
                ("Verts", cells::POINTS),
                ("Lines", cells::LINE),
                ("Polys", cells::POLYGON),
                ("Strips", cells::STRIP),
            ];
            for (name, kind) in parts {
                if let Some(part) = piece.child(name) {
                    cells.add(&self.cells(part)?, |_| kind, draft, summary);
                }
            }
        }
        self.limits.faces(draft.faces.len() as u64, || piece.place())?;
        self.data(piece.child("PointData"), number, summary, |name, width, values| {
            draft.field(name, Domain::Vertices, width, values);
            Ok(())
        })?;
        let count = cells.count();
        self.data(piece.child("CellData"), count, summary, |name, width, values| {
            cells.field(name, width, &values, draft, &self.room)
        })
    }

    /// Polygons by their indices and ends.
    fn cells(&self, part: &Element<'_>) -> Result<Faces, FileError> {
        let ends = self.indices(part, "offsets")?;
        self.limits.faces(ends.len() as u64, || part.place())?;
        by_ends(&self.indices(part, "connectivity")?, &ends, || part.place())
    }

    fn indices(&self, part: &Element<'_>, name: &str) -> Result<Vec<u32>, FileError> {
        let Some(array) = part.all("DataArray").find(|array| array.attribute("Name") == Some(name)) else {
            // A part without cells may have no arrays.
            return Ok(Vec::new());
        };
        let (_, values) = self.values(array, None)?;
        let fault = |value: &f64| {
            FileError::malformed(array.place(), format!("expected whole numbers from 0, got {value}"))
        };
        values.iter().map(|value| index(*value).ok_or_else(|| fault(value))).collect()
    }

    /// Arrays of points or of cells.
    fn data(
        &self,
        data: Option<&Element<'_>>,
        rows: usize,
        summary: &mut Summary,
        mut add: impl FnMut(&str, usize, Vec<f64>) -> Result<(), FileError>,
    ) -> Result<(), FileError> {
        let Some(data) = data else { return Ok(()) };
        for array in &data.children {
            let name = array.attribute("Name").unwrap_or_default();
            if array.attribute("type").is_none_or(|of| scalar(of).is_none()) {
                summary.drop("arrays of texts", Some(name), || array.place());
                continue;
            }
            let (width, values) = self.values(array, Some(rows))?;
            if Some(values.len()) != rows.checked_mul(width) {
                let detail = format!("expected {rows} × {width} values, got {}", values.len());
                return Err(FileError::malformed(array.place(), detail));
            }
            let name = match (data.attribute("Normals"), data.attribute("TCoords"), width) {
                (Some(normals), _, 3) if normals == name => NORMALS,
                (_, Some(texture), 2) if texture == name => TEXTURE,
                (_, _, 0) => {
                    summary.drop("arrays without components", Some(name), || array.place());
                    continue;
                }
                _ => name,
            };
            add(name, width, values).map_err(|error| error.at(array.place()))?;
        }
        Ok(())
    }

    /// Number of components and values of an array. Empty arrays may have no data.
    fn values(&self, array: &Element<'_>, rows: Option<usize>) -> Result<(usize, Vec<f64>), FileError> {
        let of = array.attribute("type").unwrap_or_default();
        let Some(scalar) = scalar(of) else {
            return Err(FileError::unsupported(
                array.place(),
                format!("expected a type of numbers, got {}", shown(of.as_bytes())),
            ));
        };
        let width = match array.attribute("NumberOfComponents") {
            Some(_) => usize::try_from(claim(array, "NumberOfComponents")?).unwrap_or(usize::MAX),
            None => 1,
        };
        let place = || array.place();
        let bytes = match array.attribute("format") {
            None | Some("ascii") => {
                let all = words(array.text.as_bytes()).map(|word| number(word, "a number", place));
                return Ok((width, all.collect::<Result<_, _>>()?));
            }
            Some("binary") if array.text.trim().is_empty() || rows == Some(0) => Vec::new(),
            Some("binary") => self.block(Bytes::base64(array.text.as_bytes()), array)?,
            Some("appended") => {
                let offset = usize::try_from(claim(array, "offset")?).unwrap_or(usize::MAX);
                let from = |bytes: &'a [u8]| {
                    bytes.get(offset..).ok_or_else(|| {
                        FileError::truncated(
                            place(),
                            format!("expected an offset up to {}, got {offset}", bytes.len()),
                        )
                    })
                };
                match &self.appended {
                    Some(Bytes::Raw(bytes)) => self.block(Bytes::Raw(from(bytes)?), array)?,
                    Some(Bytes::Base64(text, _)) => self.block(Bytes::base64(from(text)?), array)?,
                    None => return Err(FileError::malformed(place(), "expected appended data, got none")),
                }
            }
            Some(other) => {
                let detail =
                    format!("expected format ascii, binary or appended, got {}", shown(other.as_bytes()));
                return Err(FileError::unsupported(place(), detail));
            }
        };
        if !bytes.len().is_multiple_of(scalar.size()) {
            let detail = format!("expected a multiple of {} bytes, got {}", scalar.size(), bytes.len());
            return Err(FileError::malformed(place(), detail));
        }
        self.room.take(bytes.len() / scalar.size(), place)?;
        Ok((width, scalar.decode_all(&bytes, self.big_endian)))
    }

    /// The bytes of an array. Arrays may name the same part of the file, so each reading of it counts.
    fn block(&self, mut bytes: Bytes<'_>, array: &Element<'_>) -> Result<Vec<u8>, FileError> {
        let before = bytes.left();
        let (found, blocks) = self.blocks(&mut bytes, array)?;
        let read = (before - bytes.left()).saturating_add(blocks.saturating_mul(BLOCK));
        self.decoded.take(read as u64).map_err(|error| error.at(array.place()))?;
        Ok(found)
    }

    /// The bytes of an array, after their number or the sizes of their compressed blocks; and the number of these blocks.
    fn blocks(&self, bytes: &mut Bytes<'_>, array: &Element<'_>) -> Result<(Vec<u8>, usize), FileError> {
        let place = || array.place();
        let sizes = |count: usize, bytes: &mut Bytes<'_>| -> Result<Vec<usize>, FileError> {
            let raw = bytes.take(count.saturating_mul(self.header.size()), place)?;
            let size = |value: f64| {
                // Sizes up to 2⁵³ are exact; no memory holds more.
                let fits = value <= self.limits.held as f64;
                fits.then_some(value as usize).ok_or_else(|| {
                    FileError::too_large(
                        place(),
                        format!("expected at most {} bytes, got {value}", self.limits.held),
                    )
                })
            };
            self.header.decode_all(&raw, self.big_endian).into_iter().map(size).collect()
        };
        if !self.compressed {
            let size = sizes(1, bytes)?[0];
            return Ok((bytes.take(size, place)?, 0));
        }
        let head = sizes(3, bytes)?;
        let (blocks, whole, last) = (head[0], head[1], head[2]);
        let compressed = sizes(blocks, bytes)?;
        let mut all = Vec::new();
        for (k, size) in compressed.iter().enumerate() {
            let is_last = k + 1 == blocks && last > 0;
            let data = bytes.take(*size, place)?;
            let block = inflate(&data, if is_last { last } else { whole }, place)?;
            if all.len() + block.len() > self.limits.held {
                let detail = format!("expected at most {} bytes of an array, got more", self.limits.held);
                return Err(FileError::too_large(place(), detail));
            }
            all.extend(block);
        }
        Ok((all, blocks))
    }
}

fn scalar(of: &str) -> Option<Scalar> {
    Some(match of {
        "Int8" => Scalar::I8,
        "UInt8" => Scalar::U8,
        "Int16" => Scalar::I16,
        "UInt16" => Scalar::U16,
        "Int32" => Scalar::I32,
        "UInt32" => Scalar::U32,
        "Int64" => Scalar::I64,
        "UInt64" => Scalar::U64,
        "Float32" => Scalar::F32,
        "Float64" => Scalar::F64,
        _ => return None,
    })
}

fn claim(element: &Element<'_>, name: &str) -> Result<u64, FileError> {
    let value = element.attribute(name).unwrap_or_default().trim();
    count(value.as_bytes(), &format!("a whole number {name}"), || element.place())
}

#[cfg(test)]
mod tests;
