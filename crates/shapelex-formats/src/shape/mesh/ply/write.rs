//! A mesh or points as PLY.

use std::collections::BTreeSet;
use std::io::Write;

use super::super::super::options::WriteOptions;
use super::super::super::record::{Domain, Field, Record};
use super::super::super::write::{Opened, Output, Writer};
use super::super::part::{Part, count_lost, drop_name, one_only, refused};
use super::super::{COLOURS, NORMALS, TEXTURE};
use crate::error::FileError;
use crate::summary::Summary;

struct File<'a> {
    output: Output<'a>,
    text: bool,
    summary: Summary,
}

pub(super) fn open<'a>(output: Output<'a>, options: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(File { output, text: options.is_text(), summary: Summary::default() }))
}

/// A field as properties.
struct Columns<'a> {
    field: &'a Field,
    names: Vec<String>,
    /// Whole numbers of a byte.
    bytes: bool,
    /// One list property in place of one property a component.
    list: bool,
}

impl<'a> Columns<'a> {
    fn of(name: &str, field: &'a Field) -> Self {
        let plain = name.strip_prefix("face_").filter(|_| field.domain == Domain::Faces).unwrap_or(name);
        let known: &[&str] = match (plain, field.width) {
            (NORMALS, 3) => &["nx", "ny", "nz"],
            (COLOURS, 3) => &["red", "green", "blue"],
            (COLOURS, 4) => &["red", "green", "blue", "alpha"],
            (TEXTURE, 2) => &["s", "t"],
            _ => &[],
        };
        let is_byte = |x: &f64| x.fract() == 0.0 && (0.0..=255.0).contains(x);
        // Colours from 0 to 1 are not bytes.
        let bytes =
            plain == COLOURS && field.values.iter().all(is_byte) && field.values.iter().any(|x| *x > 1.0);
        let names =
            if known.is_empty() { vec![one_word(name)] } else { known.iter().map(|n| (*n).into()).collect() };
        Self { field, names, bytes, list: known.is_empty() && field.width != 1 }
    }

    fn header(&self) -> String {
        let kind = if self.bytes { "uchar" } else { "double" };
        if self.list {
            return format!("property list uchar {kind} {}\n", self.names[0]);
        }
        self.names.iter().map(|name| format!("property {kind} {name}\n")).collect()
    }

    fn write(&self, row: usize, file: &mut File<'_>) -> Result<(), FileError> {
        let values = &self.field.values[row * self.field.width..(row + 1) * self.field.width];
        if self.list {
            file.byte(u8::try_from(values.len()).unwrap_or(u8::MAX))?;
        }
        for value in values {
            match self.bytes {
                // Checked to be whole numbers of a byte.
                true => file.byte(*value as u8)?,
                false => file.number(*value)?,
            }
        }
        Ok(())
    }
}

/// Gives the properties of an element different names: the standard ones stay, others get underscores at their end.
fn make_distinct(columns: &mut [Columns<'_>], taken: &[&str]) {
    let mut taken: BTreeSet<String> = taken.iter().map(|name| (*name).to_owned()).collect();
    let (standard, others): (Vec<_>, Vec<_>) = columns.iter_mut().partition(|column| column.names.len() > 1);
    taken.extend(standard.iter().flat_map(|column| column.names.iter().cloned()));
    for name in others.into_iter().flat_map(|column| &mut column.names) {
        while !taken.insert(name.clone()) {
            name.push('_');
        }
    }
}

impl Writer for File<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        if self.summary.records > 0 {
            return Err(one_only("PLY"));
        }
        let part = Part::of(record, "PLY")?;
        let faces = match part {
            Part::Mesh(mesh) => Some(&mesh.faces),
            Part::Points(_) => None,
            Part::Curve(..) => return Err(refused(record, "PLY", "a curve")),
        };
        // The length of a list is a byte.
        let fits = |field: &Field| (1..256).contains(&field.width);
        let columns = |domain: Domain| {
            let all = part.fields().filter(move |(_, field)| field.domain == domain && fits(field));
            all.map(|(name, field)| Columns::of(name, field)).collect()
        };
        drop_name(record, &mut self.summary);
        count_lost(part, record, &[], &mut self.summary, |_, field| fits(field));
        let mut of_vertices: Vec<Columns<'_>> = columns(Domain::Vertices);
        let mut of_faces: Vec<Columns<'_>> = columns(Domain::Faces);
        make_distinct(&mut of_vertices, &["x", "y", "z"]);
        make_distinct(&mut of_faces, &["vertex_indices", "vertex_index"]);
        let encoding = if self.text { "ascii" } else { "binary_little_endian" };
        let head = |columns: &[Columns<'_>]| columns.iter().map(Columns::header).collect::<String>();
        let axes = "property double x\nproperty double y\nproperty double z\n";
        let count = part.points().len();
        write!(
            self.output,
            "ply\nformat {encoding} 1.0\nelement vertex {count}\n{axes}{}",
            head(&of_vertices)
        )?;
        if let Some(faces) = faces {
            let list = "property list uint int vertex_indices\n";
            // Many programs take no longer type of the length than a byte.
            let small = faces.iter().all(|face| face.len() < 256);
            let list = if small { list.replace("uint", "uchar") } else { list.into() };
            write!(self.output, "element face {}\n{list}{}", faces.len(), head(&of_faces))?;
        }
        self.output.write_all(b"end_header\n")?;
        for (k, row) in part.points().rows().enumerate() {
            row.iter().try_for_each(|x| self.number(*x))?;
            of_vertices.iter().try_for_each(|columns| columns.write(k, self))?;
            self.end_of_row()?;
        }
        let small = faces.is_some_and(|faces| faces.iter().all(|face| face.len() < 256));
        for (k, face) in faces.into_iter().flat_map(|faces| faces.iter().enumerate()) {
            match u8::try_from(face.len()) {
                Ok(length) if small => self.byte(length)?,
                _ => self.index(u32::try_from(face.len()).unwrap_or(u32::MAX))?,
            }
            face.iter().try_for_each(|vertex| self.index(*vertex))?;
            of_faces.iter().try_for_each(|columns| columns.write(k, self))?;
            self.end_of_row()?;
        }
        self.summary.records += 1;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        if self.summary.records == 0 {
            let empty = "ply\nformat ascii 1.0\nelement vertex 0\nproperty double x\nproperty double y\nproperty double z\nend_header\n";
            self.output.write_all(empty.as_bytes())?;
        }
        self.output.flush()?;
        Ok(self.summary)
    }
}

impl File<'_> {
    fn number(&mut self, value: f64) -> Result<(), FileError> {
        match self.text {
            true => write!(self.output, "{value} ")?,
            false => self.output.write_all(&value.to_le_bytes())?,
        }
        Ok(())
    }

    fn byte(&mut self, value: u8) -> Result<(), FileError> {
        match self.text {
            true => write!(self.output, "{value} ")?,
            false => self.output.write_all(&[value])?,
        }
        Ok(())
    }

    fn index(&mut self, value: u32) -> Result<(), FileError> {
        match self.text {
            true => write!(self.output, "{value} ")?,
            false => self.output.write_all(&value.to_le_bytes())?,
        }
        Ok(())
    }

    fn end_of_row(&mut self) -> Result<(), FileError> {
        if self.text {
            self.output.write_all(b"\n")?;
        }
        Ok(())
    }
}

/// A name as a property: no spaces.
fn one_word(name: &str) -> String {
    name.chars().map(|c| if c.is_whitespace() || c.is_control() { '_' } else { c }).collect()
}
