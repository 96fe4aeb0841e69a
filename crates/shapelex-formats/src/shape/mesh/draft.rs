//! What was read of a shape, on its way to a record.

use std::collections::BTreeMap;

use super::super::error::{FileError, Place};
use super::super::record::Sink;
use super::super::record::{Domain, Faces, Field, Geometry, Mesh, Points, Record};
use super::super::summary::Summary;

/// Most fields of a shape: a name that is taken is looked for among all of them.
const MAX_FIELDS: usize = 1000;

/// Vertices with the polygons and lines between them.
pub(super) struct Draft {
    /// The vertices.
    pub(super) vertices: Points,
    /// Polygons, perhaps with less than three corners.
    pub(super) faces: Faces,
    /// Open and closed lines. A closed one ends with its first vertex.
    pub(super) lines: Vec<Vec<u32>>,
    fields: BTreeMap<String, Field>,
    /// Names of fields beyond the most.
    beyond: Vec<String>,
    /// Name of the shape.
    pub(super) name: Option<String>,
    /// What else the file says.
    pub(super) metadata: serde_json::Map<String, serde_json::Value>,
    place: Place,
}

impl Draft {
    /// A shape in space at a place.
    pub(super) fn new(place: Place) -> Self {
        Self {
            vertices: Points::new(3),
            faces: Faces::default(),
            lines: Vec::new(),
            fields: BTreeMap::new(),
            beyond: Vec::new(),
            name: None,
            metadata: serde_json::Map::new(),
            place,
        }
    }

    /// Adds a field, under another name if it is taken.
    pub(super) fn field(&mut self, name: &str, domain: Domain, width: usize, values: Vec<f64>) {
        if self.fields.len() >= MAX_FIELDS {
            self.beyond.push(name.to_owned());
            return;
        }
        let taken = self.fields.contains_key(name);
        let mut free =
            if taken && domain == Domain::Faces { format!("face_{name}") } else { name.to_owned() };
        let mut number = 2_u32;
        while self.fields.contains_key(&free) {
            free = format!("{name}_{number}");
            number += 1;
        }
        self.fields.insert(free, Field { domain, width, values });
    }

    /// Gives on a mesh, else the lines, else the points as landmarks.
    pub(super) fn send(mut self, summary: &mut Summary, sink: Sink<'_>) -> Result<(), FileError> {
        if self.vertices.is_empty() {
            return Err(FileError::malformed(self.place, "expected points, got none"));
        }
        for name in &self.beyond {
            summary.drop("fields beyond the first thousand", Some(name), || self.place.clone());
        }
        self.drop_small_faces(summary);
        if self.faces.is_empty() {
            for name in self.fields.keys() {
                summary.drop("fields of points without faces", Some(name), || self.place.clone());
            }
            if self.lines.is_empty() {
                return self.landmarks(summary, sink);
            }
            return self.curves(sink);
        }
        for _ in &self.lines {
            summary.drop("lines beside the faces", None, || self.place.clone());
        }
        let mesh = Mesh { vertices: self.vertices, faces: self.faces, fields: self.fields };
        let record = Record::new(mesh, self.place);
        sink(Record { name: self.name, metadata: self.metadata, ..record })
    }

    /// Faces of less than three corners bound nothing: they are left out with their values.
    fn drop_small_faces(&mut self, summary: &mut Summary) {
        let kept: Vec<bool> = self.faces.iter().map(|face| face.len() >= 3).collect();
        if kept.iter().all(|kept| *kept) {
            return;
        }
        let faces = std::mem::take(&mut self.faces);
        for (face, kept) in faces.iter().zip(&kept) {
            if *kept {
                self.faces.push(face.iter().copied());
            } else {
                summary.drop("faces of less than three corners", None, || self.place.clone());
            }
        }
        for field in self.fields.values_mut().filter(|field| field.domain == Domain::Faces) {
            let rows = field.values.chunks_exact(field.width.max(1)).zip(&kept);
            field.values = rows.filter(|(_, kept)| **kept).flat_map(|(row, _)| row.to_vec()).collect();
        }
    }

    fn landmarks(self, summary: &mut Summary, sink: Sink<'_>) -> Result<(), FileError> {
        let warning = "points without faces are read as landmarks";
        if !summary.warnings.iter().any(|known| known == warning) {
            summary.warnings.push(warning.into());
        }
        let record = Record::new(Geometry::Landmarks(self.vertices), self.place);
        sink(Record { name: self.name, metadata: self.metadata, ..record })
    }

    fn curves(self, sink: Sink<'_>) -> Result<(), FileError> {
        let rows: Vec<&[f64]> = self.vertices.rows().collect();
        let several = self.lines.len() > 1;
        for (k, line) in self.lines.iter().enumerate() {
            let place = Place { item: Some(k as u64), ..self.place.clone() };
            let closed = line.len() > 3 && line.first() == line.last();
            let mut points = Points::new(3);
            for vertex in &line[..line.len() - usize::from(closed)] {
                let row = rows.get(*vertex as usize).ok_or_else(|| {
                    let detail = format!("expected indices of points below {}, got {vertex}", rows.len());
                    FileError::malformed(place.clone(), detail)
                })?;
                points.push(row);
            }
            let name = self.name.as_ref().filter(|_| !several).cloned();
            let record = Record::new(Geometry::Curve { points, closed }, place);
            sink(Record { name, metadata: self.metadata.clone(), ..record })?;
        }
        Ok(())
    }
}
