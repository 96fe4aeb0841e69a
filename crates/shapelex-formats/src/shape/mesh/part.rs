//! What writers take of a record.

use super::super::error::{FaultKind, FileError};
use super::super::record::{Domain, Field, Geometry, Mesh, Points, Record};
use super::super::summary::Summary;
use super::scalar::single;

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

/// Counts the fields that are not written.
pub(super) fn drop_fields(
    part: Part<'_>,
    record: &Record,
    summary: &mut Summary,
    written: impl Fn(&str) -> bool,
) {
    for (name, _) in part.fields().filter(|(name, _)| !written(name)) {
        summary.drop("fields that the format has no place for", Some(name), || record.place.clone());
    }
}
