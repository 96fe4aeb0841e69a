//! Stanford PLY: text and both byte orders. One shape a file.
//!
//! Properties of vertices and faces become fields: `nx ny nz` are `normals`, `red green blue alpha` are `colours`, `s t` and `u v`
//! are `texture_coordinates`; others have their name. A list of as many values in every row is a field of that width.

mod header;
mod write;

use super::super::format::Format;
use super::super::limits::{Limits, Room};
use super::super::options::ReadOptions;
use super::super::record::Sink;
use super::super::record::{Domain, Kind};
use super::super::source::Source;
use super::draft::Draft;
use super::scalar::{Scalar, index};
use super::scan::Scan;
use super::{COLOURS, NORMALS, TEXTURE};
use crate::error::{FileError, Place};
use crate::summary::Summary;
use header::{Element, Encoding, Header, Type};

/// Stanford PLY.
pub(in super::super) static FORMAT: Format = Format {
    id: "ply",
    name: "Stanford PLY",
    media_types: &["application/ply", "model/ply"],
    extensions: &["ply"],
    recognise: |head| head.starts_with(b"ply\n") || head.starts_with(b"ply\r"),
    kinds: &[Kind::Mesh, Kind::Landmarks],
    options: &[],
    read: Some(read),
    open: Some(write::open),
};

/// Properties that are one field together.
const GROUPS: [(&str, &[&str]); 7] = [
    (NORMALS, &["nx", "ny", "nz"]),
    (COLOURS, &["red", "green", "blue", "alpha"]),
    (COLOURS, &["red", "green", "blue"]),
    (COLOURS, &["r", "g", "b"]),
    (TEXTURE, &["s", "t"]),
    (TEXTURE, &["u", "v"]),
    (TEXTURE, &["texture_u", "texture_v"]),
];

fn read(source: &mut Source<'_>, _: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let bytes = source.bytes()?;
    let mut scan = Scan::new(&bytes);
    let room = Room::new(&limits, bytes.len());
    let header = Header::read(&mut scan)?;
    let mut summary = Summary::default();
    let mut draft = Draft::new(Place::default());
    let mut seen = [false; 2];
    for element in &header.elements {
        let place = Place::tag(format!("element {}", element.name));
        let rows = Rows::read(&mut scan, element, header.encoding, (&limits, &room))
            .map_err(|error| error.at(place.clone()))?;
        let known = ["vertex", "face"].iter().position(|name| *name == element.name);
        match known {
            Some(k) if seen[k] => {
                let detail = "expected one element of this name, got two";
                return Err(FileError::malformed(place, detail));
            }
            Some(0) => rows.vertices(element, &mut draft, &mut summary)?,
            Some(_) => rows.faces(element, &mut draft, &mut summary)?,
            None if element.count > 0 => {
                summary.drop("elements other than vertices and faces", Some(&element.name), || place);
            }
            None => {}
        }
        if let Some(k) = known {
            seen[k] = true;
        }
    }
    scan.expect_end()?;
    if !seen[0] {
        return Err(FileError::malformed(Place::default(), "expected an element vertex, got none"));
    }
    summary.set("encoding", header.encoding.name());
    draft.send(&mut summary, sink)?;
    Ok(summary)
}

/// The rows of an element, by property.
struct Rows {
    columns: Vec<Column>,
}

/// Values of a property: one a row, or lists.
#[derive(Default)]
struct Column {
    values: Vec<f64>,
    /// End of each list in `values`; empty if there is one value a row.
    ends: Vec<usize>,
}

impl Column {
    /// Reads the value or the list of a row. Only values that have room are kept.
    fn read(
        &mut self,
        scan: &mut Scan<'_>,
        of: &Type,
        encoding: Encoding,
        room: Option<&Room>,
    ) -> Result<(), FileError> {
        let (count, scalar) = match *of {
            Type::One(scalar) => (1, scalar),
            Type::List(of_count, scalar) => {
                let length = value(scan, of_count, encoding)?;
                let length = index(length).ok_or_else(|| {
                    FileError::malformed(
                        Place::default(),
                        format!("expected a length of a list, got {length}"),
                    )
                })?;
                (length as usize, scalar)
            }
        };
        if let Some(room) = room {
            // A list that claims more values than there are bytes ends with the file.
            room.take(scan.rest().len().min(count), Place::default)?;
        }
        for _ in 0..count {
            let value = value(scan, scalar, encoding)?;
            if room.is_some() {
                self.values.push(value);
            }
        }
        if room.is_some() && matches!(of, Type::List(..)) {
            self.ends.push(self.values.len());
        }
        Ok(())
    }

    fn lists(&self) -> impl Iterator<Item = &[f64]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, end)| &self.values[start..*end])
    }
}

impl Rows {
    fn read(
        scan: &mut Scan<'_>,
        element: &Element,
        encoding: Encoding,
        (limits, room): (&Limits, &Room),
    ) -> Result<Self, FileError> {
        match element.name.as_str() {
            "vertex" => _ = limits.points(element.count, Place::default)?,
            "face" => _ = limits.faces(element.count, Place::default)?,
            "tristrips" => {
                let detail = "expected polygons as the element face, got strips of triangles";
                return Err(FileError::unsupported(Place::default(), detail));
            }
            _ => {}
        }
        let mut columns: Vec<Column> = element.properties.iter().map(|_| Column::default()).collect();
        let kept = matches!(element.name.as_str(), "vertex" | "face");
        // A row without properties takes no bytes.
        let count = if element.properties.is_empty() { 0 } else { element.count };
        for row in 0..count {
            for (property, column) in element.properties.iter().zip(&mut columns) {
                column.read(scan, &property.of, encoding, kept.then_some(room)).map_err(|error| {
                    let tag = Some(format!("element {}, property {}", element.name, property.name));
                    error.at(Place { tag, ..Place::item(row) })
                })?;
            }
        }
        Ok(Self { columns })
    }

    fn vertices(
        mut self,
        element: &Element,
        draft: &mut Draft,
        summary: &mut Summary,
    ) -> Result<(), FileError> {
        let place = || Place::tag("element vertex");
        let mut axes = Vec::new();
        for name in ["x", "y", "z"] {
            let one = |p: &header::Property| p.name == name && matches!(p.of, Type::One(_));
            let at = element.properties.iter().position(one).ok_or_else(|| {
                FileError::malformed(place(), format!("expected a property {name}, got none"))
            })?;
            axes.push(std::mem::take(&mut self.columns[at].values));
        }
        for ((x, y), z) in axes[0].iter().zip(&axes[1]).zip(&axes[2]) {
            draft.vertices.push(&[*x, *y, *z]);
        }
        self.fields(element, Domain::Vertices, &["x", "y", "z"], draft, summary);
        Ok(())
    }

    fn faces(self, element: &Element, draft: &mut Draft, summary: &mut Summary) -> Result<(), FileError> {
        let names = ["vertex_indices", "vertex_index"];
        let list = |p: &header::Property| names.contains(&p.name.as_str()) && matches!(p.of, Type::List(..));
        let Some(at) = element.properties.iter().position(list) else {
            if element.count == 0 {
                return Ok(());
            }
            let detail = "expected a list property vertex_indices, got none";
            return Err(FileError::malformed(Place::tag("element face"), detail));
        };
        let mut face = Vec::new();
        for (k, row) in self.columns[at].lists().enumerate() {
            face.clear();
            for value in row {
                face.push(index(*value).ok_or_else(|| {
                    let place = Place { tag: Some("element face".into()), ..Place::item(k as u64) };
                    FileError::malformed(place, format!("expected an index of a vertex, got {value}"))
                })?);
            }
            draft.faces.push(face.iter().copied());
        }
        let name = element.properties[at].name.clone();
        self.fields(element, Domain::Faces, &[&name], draft, summary);
        Ok(())
    }

    /// Adds all properties but some as fields.
    fn fields(
        mut self,
        element: &Element,
        domain: Domain,
        but: &[&str],
        draft: &mut Draft,
        summary: &mut Summary,
    ) {
        let mut free: Vec<bool> =
            element.properties.iter().map(|p| !but.contains(&p.name.as_str())).collect();
        for (name, parts) in GROUPS {
            let of = |part: &&str| {
                element.properties.iter().position(|p| p.name == **part && matches!(p.of, Type::One(_)))
            };
            let found: Vec<usize> = parts.iter().filter_map(of).filter(|k| free[*k]).collect();
            if found.len() < parts.len() {
                continue;
            }
            let rows = self.columns[found[0]].values.len();
            let row = |row: usize| found.iter().map(move |k| (*k, row));
            let values = (0..rows).flat_map(row).map(|(k, row)| self.columns[k].values[row]).collect();
            draft.field(name, domain, parts.len(), values);
            found.iter().for_each(|k| free[*k] = false);
        }
        for (k, property) in element.properties.iter().enumerate().filter(|(k, _)| free[*k]) {
            let column = std::mem::take(&mut self.columns[k]);
            let width = match property.of {
                Type::One(_) => Some(1),
                Type::List(..) => {
                    let width = column.lists().next().map_or(0, <[f64]>::len);
                    column.lists().all(|list| list.len() == width).then_some(width).filter(|width| *width > 0)
                }
            };
            match width {
                Some(width) => draft.field(&property.name, domain, width, column.values),
                None => summary.drop("lists of several lengths", Some(&property.name), || {
                    Place::tag(format!("element {}", element.name))
                }),
            }
        }
    }
}

fn value(scan: &mut Scan<'_>, scalar: Scalar, encoding: Encoding) -> Result<f64, FileError> {
    match encoding {
        Encoding::Text => scan.number("a number"),
        Encoding::Binary { big_endian } => {
            let bytes = scan.take(scalar.size(), "a value")?;
            Ok(scalar.decode(bytes, big_endian))
        }
    }
}

#[cfg(test)]
mod tests;
