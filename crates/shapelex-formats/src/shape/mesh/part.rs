//! Parts of a record for writers.

use super::super::record::{Domain, Field, Geometry, Mesh, Points, Record};
use super::super::text::left_out;
use super::scalar::single;
use crate::error::{FaultKind, FileError};
use crate::summary::Summary;

/// A geometry in space without missing points.
#[derive(Clone, Copy)]
pub(super) enum Part<'a> {
    /// A mesh.
    Mesh(&'a Mesh),
    /// Points without faces.
    Points(&'a Points),
    /// Points along a curve, and whether it is closed.
    Curve(&'a Points, bool),
}

impl<'a> Part<'a> {
    /// The geometry of a record.
    pub(super) fn of(record: &'a Record, format: &str) -> Result<Self, FileError> {
        let part = match &record.geometry {
            Geometry::Mesh(mesh) => Self::Mesh(mesh),
            Geometry::Landmarks(points) => Self::Points(points),
            Geometry::Curve { points, closed } => Self::Curve(points, *closed),
            Geometry::Fourier(_) => return Err(refused(record, format, "Fourier coefficients")),
        };
        if part.points().dimension() != 3 {
            return Err(refused(record, format, "a shape of the plane"));
        }
        if part.points().coordinates().iter().any(|x| x.is_nan()) {
            return Err(refused(record, format, "missing points"));
        }
        Ok(part)
    }

    /// The points or vertices.
    pub(super) fn points(&self) -> &'a Points {
        match self {
            Self::Mesh(mesh) => &mesh.vertices,
            Self::Points(points) | Self::Curve(points, _) => points,
        }
    }

    /// The fields, by name.
    pub(super) fn fields(&self) -> impl Iterator<Item = (&'a String, &'a Field)> {
        let fields = match self {
            Self::Mesh(mesh) => Some(&mesh.fields),
            _ => None,
        };
        fields.into_iter().flatten()
    }

    /// A field of vertices with a width.
    pub(super) fn vertex_field(&self, name: &str, widths: &[usize]) -> Option<&'a Field> {
        let fits = |field: &&Field| field.domain == Domain::Vertices && widths.contains(&field.width);
        self.fields().find(|(known, _)| *known == name).map(|(_, field)| field).filter(fits)
    }
}

/// A record that a format cannot hold.
pub(super) fn refused(record: &Record, format: &str, what: &str) -> FileError {
    let name = record.name.as_ref().map(|name| format!(" of shape '{name}'")).unwrap_or_default();
    let detail = format!("expected shapes in space that {format} can hold, got {what}{name}");
    FileError::unsupported(record.place.clone(), detail)
}

/// A second record for a format that holds one.
pub(super) fn one_only(format: &str) -> FileError {
    FileError::new(
        FaultKind::Unsupported,
        format!("expected one shape, as {format} holds only one, got several"),
    )
}

/// Coordinates in single precision.
pub(super) fn singles(record: &Record, points: &Points, format: &str) -> Result<Vec<f32>, FileError> {
    let rounded = points.coordinates().iter().map(|x| single(*x)).collect::<Option<Vec<f32>>>();
    rounded.ok_or_else(|| refused(record, format, "coordinates beyond single precision"))
}

/// Counts the parts of a record that are not written: fields that `written` does not take, and parts that no format of meshes holds,
/// such as labels and attributes. `kept`: keys of the metadata that are written.
pub(super) fn count_lost(
    part: Part<'_>,
    record: &Record,
    kept: &[&str],
    summary: &mut Summary,
    written: impl Fn(&str, &Field) -> bool,
) {
    let place = || record.place.clone();
    if let Part::Mesh(mesh) = part
        && mesh.faces.is_empty()
    {
        summary.drop("meshes without faces, written as points", record.name.as_deref(), place);
    }
    for (name, _) in part.fields().filter(|(name, field)| !written(name, field)) {
        summary.drop("fields that the format has no place for", Some(name), place);
    }
    left_out(summary, record, kept);
}

/// Counts the name of a record, for formats that have no place for one.
pub(super) fn drop_name(record: &Record, summary: &mut Summary) {
    if let Some(name) = &record.name {
        summary.drop("names", Some(name), || record.place.clone());
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use serde_json::json;

    use super::super::super::format::Format;
    use super::super::super::options::{Encoding, WriteOptions};
    use super::super::super::record::{Faces, Ring};
    use super::super::{COLOURS, NORMALS, TEXTURE, gltf, obj, particles, ply, stl, vtk};
    use super::*;
    use crate::shape::Place;

    /// A triangle with all that a record can say.
    fn triangle() -> Record {
        let mut faces = Faces::default();
        faces.push([0, 1, 2]);
        let field =
            |domain, width: usize, rows: usize| Field { domain, width, values: vec![1.0; width * rows] };
        let fields = BTreeMap::from([
            (COLOURS.into(), field(Domain::Faces, 3, 1)),
            (NORMALS.into(), field(Domain::Faces, 3, 1)),
            (TEXTURE.into(), field(Domain::Vertices, 2, 3)),
            ("material".into(), field(Domain::Faces, 1, 1)),
            ("wide".into(), field(Domain::Vertices, 256, 3)),
        ]);
        let vertices = Points::from_rows(3, vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        let metadata = json!({ "groups": ["left"], "materials": ["red", "blue", ""], "scanner": 7 });
        Record {
            name: Some("a".into()),
            subject: Some("p".into()),
            label: Some("b".into()),
            labels: BTreeMap::from([("age".into(), super::super::super::Value::Number(7.0))]),
            weight: Some(2.0),
            metadata: metadata.as_object().unwrap().clone(),
            ring: Some(Ring { object: 0, part: 0, hole: false }),
            ..Record::new(Mesh { vertices, faces, fields }, Place::item(4))
        }
    }

    /// Parts of a record left out: kind, names.
    fn lost(format: &Format, record: &Record, encoding: Encoding) -> Vec<(String, String)> {
        let options = WriteOptions { encoding: Some(encoding), ..WriteOptions::default() };
        let mut writer = format.writer(std::io::sink(), &options).unwrap();
        writer.push(record).unwrap();
        let summary = writer.finish().unwrap();
        assert!(summary.dropped.iter().all(|dropped| dropped.first == Place::item(4)), "{summary:?}");
        summary.dropped.into_iter().map(|dropped| (dropped.what, dropped.names.join(" "))).collect()
    }

    #[test]
    fn what_meshes_cannot_say_is_counted() {
        let (fields, groups) = ("fields that the format has no place for", "groups and materials of no face");
        let all = ["groups materials scanner", "scanner"];
        for (format, encoding, before, metadata, after) in [
            (
                &obj::FORMAT,
                Encoding::Text,
                &[(fields, "colours normals wide")][..],
                all[1],
                Some((groups, "red")),
            ),
            (&ply::FORMAT, Encoding::Binary, &[("names", "a"), (fields, "wide")], all[0], None),
            (
                &stl::FORMAT,
                Encoding::Text,
                &[(fields, "colours material texture_coordinates wide")],
                all[0],
                None,
            ),
            (
                &stl::FORMAT,
                Encoding::Binary,
                &[(fields, "colours material texture_coordinates wide"), ("names", "a")],
                all[0],
                None,
            ),
            (&gltf::FORMAT, Encoding::Binary, &[(fields, "colours material normals wide")], all[0], None),
            (&vtk::FORMAT, Encoding::Binary, &[], all[0], None),
        ] {
            let common = ["label", "labels", "subject", "weight", "ring"].map(|what| (what, "a"));
            let expected = before.iter().chain(&common).copied().chain([("metadata", metadata)]).chain(after);
            let expected: BTreeMap<&str, &str> = expected.collect();
            let found = lost(format, &triangle(), encoding);
            let found: BTreeMap<&str, &str> = found.iter().map(|(what, names)| (&**what, &**names)).collect();
            assert_eq!(found, expected, "{}", format.id);
        }
    }

    #[test]
    fn what_points_cannot_say_is_counted() {
        let points = Points::from_rows(3, vec![1.0, 2.0, 3.0]);
        let landmarks = Record { geometry: Geometry::Landmarks(points.clone()), ..triangle() };
        for format in [&obj::FORMAT, &ply::FORMAT, &gltf::FORMAT, &vtk::FORMAT, &particles::FORMAT] {
            let found = lost(format, &landmarks, Encoding::Binary);
            let has_name = matches!(format.id, "obj" | "gltf" | "vtk");
            assert_eq!(found.iter().any(|(what, _)| what == "names"), !has_name, "{found:?}");
            let metadata = ("metadata".to_owned(), "groups materials scanner".to_owned());
            assert!(found.contains(&metadata) && found.iter().any(|(what, _)| what == "weight"), "{found:?}");
        }
        let bare = Record { geometry: Mesh { vertices: points, ..Mesh::default() }.into(), ..triangle() };
        let found = lost(&vtk::FORMAT, &bare, Encoding::Binary);
        assert!(found.contains(&("meshes without faces, written as points".into(), "a".into())), "{found:?}");
    }
}
