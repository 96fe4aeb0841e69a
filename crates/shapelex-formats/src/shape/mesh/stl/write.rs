//! Meshes as STL, binary or text. Polygons become fans of triangles.

use std::io::Write;

use super::super::super::options::WriteOptions;
use super::super::super::record::{Domain, Mesh, Record};
use super::super::super::write::{Opened, Output, Writer};
use super::super::NORMALS;
use super::super::part::{Part, count_lost, drop_name, one_only, refused, singles};
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
        if self.summary.records > 0 && !self.text {
            return Err(one_only("binary STL"));
        }
        let part = Part::of(record, "STL")?;
        let mesh = match part {
            Part::Mesh(mesh) if !mesh.faces.is_empty() => mesh,
            _ => return Err(refused(record, "STL", "a shape without faces")),
        };
        // Normals of faces are computed again.
        count_lost(part, record, &[], &mut self.summary, |name, field| {
            name == NORMALS && field.domain == Domain::Faces
        });
        if !self.text {
            drop_name(record, &mut self.summary);
        }
        self.drop_loose_vertices(mesh, record);
        let singles = singles(record, part.points(), "STL")?;
        let exact = singles.iter().zip(part.points().coordinates()).all(|(a, b)| f64::from(*a) == *b);
        if !exact && self.summary.warnings.is_empty() {
            self.summary.warnings.push("coordinates are rounded to single precision".into());
        }
        let point = |vertex: u32| [0, 1, 2].map(|axis| singles[3 * vertex as usize + axis]);
        let triangles = mesh.faces.triangles().map(|face| face.map(point));
        if self.text {
            self.solid(record.name.as_deref().unwrap_or_default(), triangles)?;
        } else {
            let count = u32::try_from(mesh.faces.triangles().count())
                .map_err(|_| refused(record, "STL", "more than 2³² triangles"))?;
            self.output.write_all(&[0; 80])?;
            self.output.write_all(&count.to_le_bytes())?;
            for triangle in triangles {
                let [a, b, c] = triangle;
                let numbers = [normal(&triangle), a, b, c];
                let mut bytes: Vec<u8> =
                    numbers.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect();
                bytes.extend([0, 0]);
                self.output.write_all(&bytes)?;
            }
        }
        self.summary.records += 1;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        if self.summary.records == 0 && !self.text {
            self.output.write_all(&[0; 84])?;
        }
        self.output.flush()?;
        Ok(self.summary)
    }
}

impl File<'_> {
    /// Counts the vertices of no face: triangles are all that STL holds.
    fn drop_loose_vertices(&mut self, mesh: &Mesh, record: &Record) {
        let mut is_used = vec![false; mesh.vertices.len()];
        mesh.faces.iter().flatten().for_each(|vertex| is_used[*vertex as usize] = true);
        for _ in is_used.iter().filter(|is_used| !**is_used) {
            self.summary.drop("vertices of no face", None, || record.place.clone());
        }
    }

    fn solid(&mut self, name: &str, triangles: impl Iterator<Item = [[f32; 3]; 3]>) -> Result<(), FileError> {
        let name: String = name.chars().map(|c| if c.is_control() { '_' } else { c }).collect();
        writeln!(self.output, "solid {name}")?;
        for triangle in triangles {
            let [x, y, z] = normal(&triangle);
            writeln!(self.output, "facet normal {x} {y} {z}\nouter loop")?;
            for [x, y, z] in triangle {
                writeln!(self.output, "vertex {x} {y} {z}")?;
            }
            writeln!(self.output, "endloop\nendfacet")?;
        }
        writeln!(self.output, "endsolid {name}")?;
        Ok(())
    }
}

/// Unit normal of a triangle; 0 if it has no area.
fn normal([a, b, c]: &[[f32; 3]; 3]) -> [f32; 3] {
    let side = |p: &[f32; 3]| [0, 1, 2].map(|k| f64::from(p[k]) - f64::from(a[k]));
    let (u, v) = (side(b), side(c));
    let normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    let length = normal[0].hypot(normal[1]).hypot(normal[2]);
    if length > 0.0 { normal.map(|x| (x / length) as f32) } else { [0.0; 3] }
}
