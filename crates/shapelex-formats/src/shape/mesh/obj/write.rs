//! Shapes as OBJ text, one object a record.

use std::collections::HashMap;
use std::io::Write;

use super::super::super::error::FileError;
use super::super::super::options::WriteOptions;
use super::super::super::record::{Domain, Field, Mesh, Record};
use super::super::super::summary::Summary;
use super::super::super::text::{name_fits, unfit};
use super::super::super::write::{Opened, Output, Writer};
use super::super::part::{Part, drop_fields};
use super::super::{COLOURS, NORMALS, TEXTURE, TEXTURE_OF_CORNERS};
use super::NORMALS_OF_CORNERS;

const WRITTEN: [&str; 7] =
    [COLOURS, NORMALS, TEXTURE, TEXTURE_OF_CORNERS, NORMALS_OF_CORNERS, "group", "material"];

struct Objects<'a> {
    output: Output<'a>,
    /// Numbers of vertices, texture coordinates and normals so far.
    before: [u64; 3],
    summary: Summary,
}

pub(super) fn open<'a>(output: Output<'a>, _: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(Objects { output, before: [0; 3], summary: Summary::default() }))
}

impl Writer for Objects<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let part = Part::of(record, "OBJ")?;
        drop_fields(part, record, &mut self.summary, |name| WRITTEN.contains(&name));
        if self.summary.records > 0 || record.name.is_some() {
            let name = one_line(record.name.as_deref().unwrap_or_default());
            name_fits(&name).map_err(|detail| unfit(record, detail))?;
            writeln!(self.output, "o {name}")?;
        }
        let first = self.before[0] + 1;
        let count = part.points().len() as u64;
        let colours = part.vertex_field(COLOURS, &[3, 4]);
        for (k, row) in part.points().rows().enumerate() {
            write!(self.output, "v {} {} {}", row[0], row[1], row[2])?;
            for value in
                colours.map_or(&[][..], |field| &field.values[k * field.width..(k + 1) * field.width])
            {
                write!(self.output, " {value}")?;
            }
            writeln!(self.output)?;
        }
        self.before[0] += count;
        match part {
            Part::Mesh(mesh) => self.mesh(record, mesh, first)?,
            Part::Points(_) => {}
            Part::Curve(_, closed) => {
                self.output.write_all(b"l")?;
                let repeated = closed.then_some(first).filter(|_| count > 2);
                for index in (first..first + count).chain(repeated) {
                    write!(self.output, " {index}")?;
                }
                writeln!(self.output)?;
            }
        }
        self.summary.records += 1;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        self.output.flush()?;
        Ok(self.summary)
    }
}

impl Objects<'_> {
    fn mesh(&mut self, record: &Record, mesh: &Mesh, first: u64) -> Result<(), FileError> {
        let texture = self.attribute("vt", 1, mesh, TEXTURE, TEXTURE_OF_CORNERS, 2)?;
        let normals = self.attribute("vn", 2, mesh, NORMALS, NORMALS_OF_CORNERS, 3)?;
        let mut places =
            [Names::of(record, mesh, "g", "group")?, Names::of(record, mesh, "usemtl", "material")?];
        let mut corner = 0;
        for (k, face) in mesh.faces.iter().enumerate() {
            for names in &mut places {
                names.write(k, &mut self.output)?;
            }
            self.output.write_all(b"f")?;
            for vertex in face {
                let at = |attribute: &Attribute| attribute.index(u64::from(*vertex), corner);
                let index = first + u64::from(*vertex);
                match (at(&texture), at(&normals)) {
                    (None, None) => write!(self.output, " {index}")?,
                    (Some(place), None) => write!(self.output, " {index}/{place}")?,
                    (None, Some(normal)) => write!(self.output, " {index}//{normal}")?,
                    (Some(place), Some(normal)) => write!(self.output, " {index}/{place}/{normal}")?,
                }
                corner += 1;
            }
            writeln!(self.output)?;
        }
        Ok(())
    }

    /// Writes the values of a field of vertices or corners: those of corners once for all that have the same. Values that are not
    /// there are left out.
    fn attribute(
        &mut self,
        keyword: &str,
        at: usize,
        mesh: &Mesh,
        of_vertices: &str,
        of_corners: &str,
        width: usize,
    ) -> Result<Attribute, FileError> {
        let corners: usize = mesh.faces.iter().map(<[u32]>::len).sum();
        let field = |name: &str, domain, count: usize| {
            let fits = |field: &&Field| field.domain == domain && field.values.len() == count * width;
            mesh.fields.get(name).filter(fits)
        };
        let vertices = field(of_vertices, Domain::Vertices, mesh.vertices.len());
        let found = vertices.or_else(|| field(of_corners, Domain::Faces, corners));
        let mut indices = Vec::new();
        // Only asked, never gone through: its order does not matter.
        let mut known: HashMap<[u64; 3], u64> = HashMap::new();
        for row in found.map_or(&[][..], |field| &field.values).chunks_exact(width) {
            if row.iter().any(|value| value.is_nan()) {
                indices.push(None);
                continue;
            }
            let next = self.before[at] + 1;
            let bits = [0, 1, 2].map(|k| row.get(k).map_or(0, |value| value.to_bits()));
            let index = if vertices.is_some() { next } else { *known.entry(bits).or_insert(next) };
            indices.push(Some(index));
            if index < next {
                continue;
            }
            self.before[at] = next;
            write!(self.output, "{keyword}")?;
            for value in row {
                write!(self.output, " {value}")?;
            }
            writeln!(self.output)?;
        }
        Ok(Attribute { by_vertex: vertices.is_some(), indices })
    }
}

/// Indices of values, in the order of vertices or of corners.
struct Attribute {
    by_vertex: bool,
    indices: Vec<Option<u64>>,
}

impl Attribute {
    fn index(&self, vertex: u64, corner: usize) -> Option<u64> {
        let at = if self.by_vertex { usize::try_from(vertex).ok()? } else { corner };
        self.indices.get(at).copied().flatten()
    }
}

/// Names of groups or materials, and what was written last.
struct Names<'a> {
    keyword: &'static str,
    list: Vec<String>,
    field: Option<&'a Field>,
    last: Option<usize>,
}

impl<'a> Names<'a> {
    /// Names that the reader refuses are refused here too.
    fn of(record: &Record, mesh: &'a Mesh, keyword: &'static str, name: &str) -> Result<Self, FileError> {
        let list = record.metadata.get(&format!("{name}s")).and_then(|list| list.as_array());
        let text = |value: &serde_json::Value| value.as_str().map(one_line).unwrap_or_default();
        let list: Vec<String> = list.into_iter().flatten().map(text).collect();
        list.iter().try_for_each(|name| name_fits(name)).map_err(|detail| unfit(record, detail))?;
        let fits = |field: &&Field| field.domain == Domain::Faces && field.width == 1;
        Ok(Self { keyword, list, field: mesh.fields.get(name).filter(fits), last: None })
    }

    fn write(&mut self, face: usize, output: &mut dyn Write) -> std::io::Result<()> {
        let value = self.field.and_then(|field| super::super::scalar::index(field.values[face]));
        let at = value.map_or(0, |value| value as usize);
        let unknown = self.list.is_empty() && self.field.is_none();
        if unknown || self.last == Some(at) {
            return Ok(());
        }
        self.last = Some(at);
        let name = self.list.get(at).cloned().unwrap_or_else(|| at.to_string());
        writeln!(output, "{} {name}", self.keyword)
    }
}

/// A name on one line, without the sign of comments. A backslash at its end would take the next line in.
fn one_line(name: &str) -> String {
    let mut line: String = name.chars().map(|c| if c.is_control() || c == '#' { '_' } else { c }).collect();
    if line.trim_end().ends_with('\\') {
        line.push('_');
    }
    line
}
