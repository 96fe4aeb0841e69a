//! Parts read of a shape, on their way to a record.

use std::collections::BTreeMap;

use super::super::record::Sink;
use super::super::record::{Domain, Faces, Field, Geometry, Mesh, Points, Record};
use crate::error::{FileError, Place};
use crate::summary::Summary;

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
    /// Next number to try behind each name that is taken: many fields of one name would try all numbers again and again.
    numbers: BTreeMap<String, u32>,
    /// Fields that are left out: their kinds and names.
    lost: Vec<(&'static str, String)>,
    /// Number of cells of points. Alone they say no more than the points do.
    pub(super) point_cells: u64,
    /// Name of the shape.
    pub(super) name: Option<String>,
    /// Further facts of the file.
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
            numbers: BTreeMap::new(),
            lost: Vec::new(),
            point_cells: 0,
            name: None,
            metadata: serde_json::Map::new(),
            place,
        }
    }

    /// Whether one more field is kept; notes the name of one that is not. Asked before values are made only for the field.
    pub(super) fn keeps(&mut self, name: &str) -> bool {
        let keeps = self.fields.len() < MAX_FIELDS;
        if !keeps {
            self.lose("fields beyond the first thousand", name);
        }
        keeps
    }

    /// Notes a field that is left out.
    pub(super) fn lose(&mut self, what: &'static str, name: &str) {
        self.lost.push((what, name.to_owned()));
    }

    /// Adds a field, under another name if it is taken.
    pub(super) fn field(&mut self, name: &str, domain: Domain, width: usize, values: Vec<f64>) {
        if self.keeps(name) {
            let free = self.free(name, domain);
            self.fields.insert(free, Field { domain, width, values });
        }
    }

    /// The name, or one made of it that is not taken.
    fn free(&mut self, name: &str, domain: Domain) -> String {
        if !self.fields.contains_key(name) {
            return name.to_owned();
        }
        if domain == Domain::Faces {
            let free = format!("face_{name}");
            if !self.fields.contains_key(&free) {
                return free;
            }
        }
        let number = self.numbers.entry(name.to_owned()).or_insert(2);
        loop {
            let free = format!("{name}_{number}");
            *number += 1;
            if !self.fields.contains_key(&free) {
                return free;
            }
        }
    }

    /// Gives on a mesh, else the lines, else the points as landmarks.
    pub(super) fn send(mut self, summary: &mut Summary, sink: Sink<'_>) -> Result<(), FileError> {
        if self.vertices.is_empty() {
            return Err(FileError::malformed(self.place, "expected points, got none"));
        }
        let place = self.place.clone();
        for (what, name) in &self.lost {
            summary.drop(what, Some(name), || place.clone());
        }
        self.drop_small_faces(summary);
        let is_alone = self.faces.is_empty() && self.lines.is_empty();
        if self.point_cells > 0 && !is_alone {
            let what = "cells of points beside lines or polygons";
            summary.drop_many(what, self.point_cells, None, || place.clone());
        }
        if self.faces.is_empty() {
            for name in self.fields.keys() {
                summary.drop("fields of points without faces", Some(name), || place.clone());
            }
            return if is_alone { self.landmarks(summary, sink) } else { self.curves(summary, sink) };
        }
        if !self.lines.is_empty() {
            summary.drop_many("lines beside the faces", self.lines.len() as u64, None, || place);
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

    /// A curve for each line. The second one is named `{name}/2`.
    fn curves(self, summary: &mut Summary, sink: Sink<'_>) -> Result<(), FileError> {
        let rows: Vec<&[f64]> = self.vertices.rows().collect();
        let mut is_used = vec![false; rows.len()];
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
                is_used[*vertex as usize] = true;
            }
            let numbered = |name: &String| if k > 0 { format!("{name}/{}", k + 1) } else { name.clone() };
            let name = self.name.as_ref().map(numbered);
            let record = Record::new(Geometry::Curve { points, closed }, place);
            sink(Record { name, metadata: self.metadata.clone(), ..record })?;
        }
        let unused = is_used.iter().filter(|used| !**used).count();
        if unused > 0 {
            summary.drop_many("points of no line", unused as u64, None, || self.place.clone());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_number_behind_a_name_is_tried_once() {
        let mut draft = Draft::new(Place::default());
        for name in ["a_4", "a", "a", "a", "a", "b"] {
            draft.field(name, Domain::Vertices, 1, Vec::new());
        }
        for _ in 0..2 {
            draft.field("a", Domain::Faces, 1, Vec::new());
        }
        let names: Vec<&str> = draft.fields.keys().map(String::as_str).collect();
        assert_eq!(names, ["a", "a_2", "a_3", "a_4", "a_5", "a_6", "b", "face_a"]);
        for _ in 0..MAX_FIELDS {
            draft.field("a", Domain::Vertices, 1, Vec::new());
        }
        // One number for each field of the name, and the one that another field has.
        assert_eq!((draft.fields.len(), draft.lost.len()), (MAX_FIELDS, 8));
        assert_eq!(draft.numbers["a"], 7 + MAX_FIELDS as u32 - 8);
    }
}
