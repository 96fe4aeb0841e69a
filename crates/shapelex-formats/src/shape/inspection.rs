//! Content of a file, without keeping its shapes.

use std::collections::BTreeMap;

use serde::Serialize;

use super::record::{Geometry, Kind, Record};
use crate::summary::{Summary, shortened};
use crate::value::Value;

/// Number of names kept of a group, and of labels of a file.
const NAMES: usize = 20;
/// Number of different labels that are counted.
const LABELS: usize = 100;

/// Content of a file. Memory does not depend on its length.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Inspection {
    /// Records by kind and dimension.
    pub groups: Vec<Group>,
    /// Number of records by class label; beyond the first 100 labels, none is added. Of one longer than 1024 bytes the first ones are
    /// kept, so that those with the same beginning count together.
    pub labels: BTreeMap<String, u64>,
    /// Names of attributes, with the number of records that have them; as many as labels.
    pub attributes: BTreeMap<String, u64>,
}

/// Records of one kind and one dimension.
#[derive(Debug, Clone, Serialize)]
pub struct Group {
    /// Their kind.
    pub kind: Kind,
    /// Number of coordinates of a point.
    pub dimension: usize,
    /// Number of them.
    pub records: u64,
    /// Least and largest number of points, vertices or harmonics.
    pub points: [usize; 2],
    /// Least and largest number of faces, of meshes.
    pub faces: [usize; 2],
    /// Number of closed curves.
    pub closed: u64,
    /// Number of rings that bound holes.
    pub holes: u64,
    /// Number of records with missing points.
    pub incomplete: u64,
    /// Names of the first ones.
    pub names: Vec<String>,
    /// Least coordinates; empty without points.
    pub lower: Vec<f64>,
    /// Largest coordinates; empty without points.
    pub upper: Vec<f64>,
}

impl Inspection {
    /// Counts a record. Cost: one pass over its points.
    pub fn add(&mut self, record: &Record) {
        let (kind, dimension) = (record.geometry.kind(), record.geometry.dimension());
        let is_same = |group: &&mut Group| (group.kind, group.dimension) == (kind, dimension);
        let group = match self.groups.iter_mut().find(is_same) {
            Some(group) => group,
            None => {
                self.groups.push(Group::new(kind, dimension));
                self.groups.last_mut().expect("a group was added")
            }
        };
        group.add(record);
        if let Some(label) = &record.label {
            count(&mut self.labels, label);
        }
        for (name, value) in &record.labels {
            if !matches!(value, Value::Text(text) if text.is_empty()) {
                count(&mut self.attributes, name);
            }
        }
    }
}

fn count(counts: &mut BTreeMap<String, u64>, name: &str) {
    let name = shortened(name);
    if let Some(count) = counts.get_mut(&name) {
        *count += 1;
    } else if counts.len() < LABELS {
        counts.insert(name, 1);
    }
}

/// Widens a range whose ends are zero before the first value.
fn widen(range: &mut [usize; 2], value: usize, is_first: bool) {
    *range = if is_first { [value; 2] } else { [range[0].min(value), range[1].max(value)] };
}

impl Group {
    fn new(kind: Kind, dimension: usize) -> Self {
        Self {
            kind,
            dimension,
            records: 0,
            points: [0; 2],
            faces: [0; 2],
            closed: 0,
            holes: 0,
            incomplete: 0,
            names: Vec::new(),
            lower: Vec::new(),
            upper: Vec::new(),
        }
    }

    fn add(&mut self, record: &Record) {
        let is_first = self.records == 0;
        self.records += 1;
        let (points, faces) = match &record.geometry {
            Geometry::Mesh(mesh) => (mesh.vertices.len(), mesh.faces.len()),
            Geometry::Fourier(fourier) => (fourier.harmonics(), 0),
            other => (other.points().map_or(0, super::record::Points::len), 0),
        };
        widen(&mut self.points, points, is_first);
        widen(&mut self.faces, faces, is_first);
        self.closed += u64::from(matches!(record.geometry, Geometry::Curve { closed: true, .. }));
        self.holes += u64::from(record.ring.as_ref().is_some_and(|ring| ring.hole));
        if let Some(name) = record.name.as_ref().filter(|_| self.names.len() < NAMES) {
            self.names.push(shortened(name));
        }
        let mut is_incomplete = false;
        for row in record.geometry.points().into_iter().flat_map(|points| points.rows()) {
            match row.iter().any(|x| x.is_nan()) {
                true => is_incomplete = true,
                false => self.cover(row),
            }
        }
        self.incomplete += u64::from(is_incomplete);
    }

    /// Widens the box.
    fn cover(&mut self, row: &[f64]) {
        if self.lower.is_empty() {
            (self.lower, self.upper) = (row.to_vec(), row.to_vec());
        }
        for (k, x) in row.iter().enumerate() {
            self.lower[k] = self.lower[k].min(*x);
            self.upper[k] = self.upper[k].max(*x);
        }
    }
}

/// An inspection with the summary of the reader, as it is answered.
#[derive(Debug, Clone, Serialize)]
pub struct Inspected {
    /// Id of the format.
    pub format: &'static str,
    /// Summary by the reader.
    #[serde(flatten)]
    pub summary: Summary,
    /// Kinds of its records.
    #[serde(flatten)]
    pub found: Inspection,
}

#[cfg(test)]
mod tests {
    use super::super::{Place, Points};
    use super::*;

    #[test]
    fn records_are_counted_by_kind_and_dimension() {
        let curve =
            |rows: &[f64]| Geometry::Curve { points: Points::from_rows(2, rows.to_vec()), closed: true };
        let mut found = Inspection::default();
        let named = |name: &str, geometry| Record {
            name: Some(name.into()),
            label: Some("cell".into()),
            ..Record::new(geometry, Place::default())
        };
        found.add(&named("a", curve(&[0.0, 5.0, 2.0, -1.0])));
        found.add(&named("b", curve(&[3.0, 1.0, 2.0, 2.0, 1.0, 1.0])));
        let mut landmarks = Points::from_rows(3, vec![1.0, 2.0, 3.0]);
        landmarks.push_missing();
        found.add(&Record::new(Geometry::Landmarks(landmarks), Place::default()));
        let [curves, points] = found.groups.as_slice() else { panic!("{:?}", found.groups) };
        assert_eq!((curves.records, curves.points, curves.closed), (2, [2, 3], 2));
        assert_eq!((&curves.lower[..], &curves.upper[..]), (&[0.0, -1.0][..], &[3.0, 5.0][..]));
        assert_eq!(curves.names, ["a", "b"]);
        assert_eq!((points.dimension, points.incomplete, &points.upper[..]), (3, 1, &[1.0, 2.0, 3.0][..]));
        assert_eq!(found.labels["cell"], 2);
    }

    #[test]
    fn of_long_labels_and_names_the_first_bytes_are_kept() {
        let mut found = Inspection::default();
        for end in ["b", "c"] {
            let long = "a".repeat(1 << 20) + end;
            found.add(&Record {
                label: Some(long.clone()),
                labels: [(long, Value::Bool(true))].into(),
                ..Record::new(Geometry::Landmarks(Points::new(2)), Place::default())
            });
        }
        let expected = BTreeMap::from([("a".repeat(1024), 2)]);
        assert_eq!((&found.labels, &found.attributes), (&expected, &expected));
    }
}
