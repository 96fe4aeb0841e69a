//! Shapes as OBJ text, one object a record.

use std::collections::HashMap;
use std::io::Write;

use super::super::super::options::WriteOptions;
use super::super::super::record::{Domain, Field, Mesh, Record};
use super::super::super::text::{name_fits, unfit};
use super::super::super::write::{Opened, Output, Writer};
use super::super::part::{Part, count_lost};
use super::super::scalar::index;
use super::super::{COLOURS, NORMALS, TEXTURE, TEXTURE_OF_CORNERS};
use super::NORMALS_OF_CORNERS;
use crate::error::FileError;
use crate::summary::Summary;

/// Names of the field of vertices and of that of corners, and the number of components of a value.
const TEXTURES: ([&str; 2], usize) = ([TEXTURE, TEXTURE_OF_CORNERS], 2);
const DIRECTIONS: ([&str; 2], usize) = ([NORMALS, NORMALS_OF_CORNERS], 3);

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
        let (fields, lists) = (written_fields(part), written_lists(part, record));
        count_lost(part, record, &lists, &mut self.summary, |name, _| fields.contains(&name));
        // Points before the first object would be taken for those of the objects behind them.
        let is_bare = !matches!(part, Part::Curve(..)) && faces(part).is_none();
        if self.summary.records > 0 || record.name.is_some() || is_bare {
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
        let texture = self.attribute("vt", 1, mesh, TEXTURES)?;
        let normals = self.attribute("vn", 2, mesh, DIRECTIONS)?;
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
        for name in places.iter().flat_map(Names::unused) {
            self.summary.drop("groups and materials of no face", Some(name), || record.place.clone());
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
        (names, width): ([&'static str; 2], usize),
    ) -> Result<Attribute, FileError> {
        let found = values(mesh, names, width);
        let by_vertex = found.is_some_and(|(name, _)| name == names[0]);
        let mut indices = Vec::new();
        // Only asked, never gone through: its order does not matter.
        let mut known: HashMap<[u64; 3], u64> = HashMap::new();
        for row in found.map_or(&[][..], |(_, field)| &field.values).chunks_exact(width) {
            if row.iter().any(|value| value.is_nan()) {
                indices.push(None);
                continue;
            }
            let next = self.before[at] + 1;
            let bits = [0, 1, 2].map(|k| row.get(k).map_or(0, |value| value.to_bits()));
            let index = if by_vertex { next } else { *known.entry(bits).or_insert(next) };
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
        Ok(Attribute { by_vertex, indices })
    }
}

/// The faces of a part that has some.
fn faces(part: Part<'_>) -> Option<&Mesh> {
    match part {
        Part::Mesh(mesh) if !mesh.faces.is_empty() => Some(mesh),
        _ => None,
    }
}

/// Names of the fields that OBJ has a place for.
fn written_fields(part: Part<'_>) -> Vec<&'static str> {
    let mut found = Vec::new();
    found.extend(part.vertex_field(COLOURS, &[3, 4]).map(|_| COLOURS));
    let Some(mesh) = faces(part) else { return found };
    for (names, width) in [TEXTURES, DIRECTIONS] {
        found.extend(values(mesh, names, width).map(|(name, _)| name));
    }
    found.extend(["group", "material"].into_iter().filter(|name| positions(mesh, name).is_some()));
    found
}

/// Keys of the metadata that are lists of names of groups and materials.
fn written_lists(part: Part<'_>, record: &Record) -> Vec<&'static str> {
    let is_list = |key: &&str| {
        let list = record.metadata.get(*key).and_then(|list| list.as_array());
        list.is_some_and(|list| list.iter().all(|name| name.is_string()))
    };
    let known = if faces(part).is_some() { &["groups", "materials"][..] } else { &[] };
    known.iter().copied().filter(is_list).collect()
}

/// The field of vertices, else that of corners, with `width` numbers for each of them. Without faces nothing refers to one.
fn values<'m>(mesh: &'m Mesh, names: [&'static str; 2], width: usize) -> Option<(&'static str, &'m Field)> {
    let corners: usize = mesh.faces.iter().map(<[u32]>::len).sum();
    let domains = [(Domain::Vertices, mesh.vertices.len()), (Domain::Faces, corners)];
    names.into_iter().zip(domains).filter(|_| !mesh.faces.is_empty()).find_map(|(name, (domain, count))| {
        let fits = |field: &&Field| field.domain == domain && field.values.len() == count * width;
        mesh.fields.get(name).filter(fits).map(|field| (name, field))
    })
}

/// The field that gives the position of the group or the material of each face in the list of their names.
fn positions<'m>(mesh: &'m Mesh, name: &str) -> Option<&'m Field> {
    let fits = |field: &&Field| field.domain == Domain::Faces && field.width == 1;
    let field = mesh.fields.get(name).filter(fits)?;
    field.values.iter().all(|value| index(*value).is_some()).then_some(field)
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

/// Names of groups or materials, and the last written ones.
struct Names<'a> {
    keyword: &'static str,
    list: Vec<String>,
    is_used: Vec<bool>,
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
        let is_used = vec![false; list.len()];
        Ok(Self { keyword, list, is_used, field: positions(mesh, name), last: None })
    }

    fn write(&mut self, face: usize, output: &mut dyn Write) -> std::io::Result<()> {
        let value = self.field.and_then(|field| index(field.values[face]));
        let at = value.map_or(0, |value| value as usize);
        let unknown = self.list.is_empty() && self.field.is_none();
        if unknown || self.last == Some(at) {
            return Ok(());
        }
        self.last = Some(at);
        if let Some(used) = self.is_used.get_mut(at) {
            *used = true;
        }
        let name = self.list.get(at).cloned().unwrap_or_else(|| at.to_string());
        writeln!(output, "{} {name}", self.keyword)
    }

    /// Names that no face has. One that is empty says nothing.
    fn unused(&self) -> impl Iterator<Item = &String> {
        let unused = self.list.iter().zip(&self.is_used).filter(|(_, used)| !**used);
        unused.map(|(name, _)| name).filter(|name| !name.is_empty())
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
