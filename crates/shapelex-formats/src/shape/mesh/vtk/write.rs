//! Shapes as VTK legacy files, `POLYDATA` with all fields as arrays.

use std::io::Write;

use super::super::super::options::WriteOptions;
use super::super::super::record::{Domain, Faces, Field, Record};
use super::super::super::write::{Opened, Output, Writer};
use super::super::part::{Part, count_lost, one_only, refused};
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

impl Writer for File<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        if self.summary.records > 0 {
            return Err(one_only("VTK"));
        }
        let part = Part::of(record, "VTK")?;
        let count =
            u32::try_from(part.points().len()).map_err(|_| refused(record, "VTK", "more than 2³² points"))?;
        count_lost(part, record, &[], &mut self.summary, |_, field| field.width > 0);
        self.head(record.name.as_deref())?;
        writeln!(self.output, "POINTS {count} double")?;
        self.numbers(part.points().coordinates(), 3)?;
        let mut own = Faces::default();
        match part {
            Part::Mesh(mesh) => self.cells("POLYGONS", &mesh.faces)?,
            Part::Points(_) => {
                (0..count).for_each(|k| own.push([k]));
                self.cells("VERTICES", &own)?;
            }
            Part::Curve(_, closed) => {
                let repeated = (closed && count > 2).then_some(0);
                own.push((0..count).chain(repeated));
                self.cells("LINES", &own)?;
            }
        }
        for (keyword, domain) in [("POINT_DATA", Domain::Vertices), ("CELL_DATA", Domain::Faces)] {
            let fields: Vec<(&String, &Field)> =
                part.fields().filter(|(_, field)| field.domain == domain && field.width > 0).collect();
            let Some((_, first)) = fields.first() else { continue };
            writeln!(
                self.output,
                "{keyword} {}\nFIELD FieldData {}",
                first.values.len() / first.width,
                fields.len()
            )?;
            for (name, field) in fields {
                let rows = field.values.len() / field.width;
                writeln!(self.output, "{} {} {rows} double", encoded(name), field.width)?;
                self.numbers(&field.values, field.width)?;
            }
        }
        self.summary.records += 1;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        if self.summary.records == 0 {
            self.head(None)?;
            self.output.write_all(b"POINTS 0 double\n")?;
        }
        self.output.flush()?;
        Ok(self.summary)
    }
}

impl File<'_> {
    fn head(&mut self, name: Option<&str>) -> Result<(), FileError> {
        // The title has at most 255 characters.
        let plain = |c: char| if c.is_ascii() && !c.is_ascii_control() { c } else { '_' };
        let title: String = name.unwrap_or("shape").chars().map(plain).take(255).collect();
        let encoding = if self.text { "ASCII" } else { "BINARY" };
        writeln!(self.output, "# vtk DataFile Version 3.0\n{title}\n{encoding}\nDATASET POLYDATA")?;
        Ok(())
    }

    /// Cells, each as its length and its indices.
    fn cells(&mut self, keyword: &str, cells: &Faces) -> Result<(), FileError> {
        let size: usize = cells.iter().map(|cell| 1 + cell.len()).sum();
        writeln!(self.output, "{keyword} {} {size}", cells.len())?;
        for cell in cells.iter() {
            let length = u32::try_from(cell.len()).unwrap_or(u32::MAX);
            self.row(std::iter::once(&length).chain(cell), |value| value.to_be_bytes())?;
        }
        self.end_rows()
    }

    fn numbers(&mut self, values: &[f64], width: usize) -> Result<(), FileError> {
        for row in values.chunks(width) {
            self.row(row, |value| value.to_be_bytes())?;
        }
        self.end_rows()
    }

    /// Values as a line of text, or as their bytes.
    fn row<'v, T: std::fmt::Display + 'v, const N: usize>(
        &mut self,
        values: impl IntoIterator<Item = &'v T>,
        bytes: impl Fn(&T) -> [u8; N],
    ) -> Result<(), FileError> {
        for value in values {
            match self.text {
                true => write!(self.output, "{value} ")?,
                false => self.output.write_all(&bytes(value))?,
            }
        }
        if self.text {
            writeln!(self.output)?;
        }
        Ok(())
    }

    /// Bytes end in a line break too.
    fn end_rows(&mut self) -> Result<(), FileError> {
        if !self.text {
            writeln!(self.output)?;
        }
        Ok(())
    }
}

/// A name as one word.
fn encoded(name: &str) -> String {
    let plain = |byte: u8| byte.is_ascii_graphic() && !matches!(byte, b'%' | b'"');
    name.bytes()
        .map(|byte| if plain(byte) { char::from(byte).to_string() } else { format!("%{byte:02X}") })
        .collect()
}
