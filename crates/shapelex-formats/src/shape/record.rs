//! A shape of a file, with the facts of the file about it.

use std::collections::BTreeMap;

use serde_json::{Map, Value as Json};

use super::json::{SCALAR, map_bytes, map_characters, text_characters};
use super::limits::{MAX_COORDINATE, MAX_DIMENSION};
use super::naming::Scope;
use crate::error::{FaultKind, FileError, Place};
use crate::unit::{Ratio, Unit};
use crate::value::Value;

/// Takes the next record of a file. Its error ends the reading and is returned.
pub type Sink<'a> = &'a mut dyn FnMut(Record) -> Result<(), FileError>;

/// A shape of a file, with its attributes.
#[derive(Debug, Clone, PartialEq)]
pub struct Record {
    /// The shape.
    pub geometry: Geometry,
    /// Unit of its coordinates, where the file gives one.
    pub unit: Option<Unit>,
    /// Name of the shape within the file: the external id where it is stored.
    pub name: Option<String>,
    /// Option of reading that gives a shape in space as one of the plane that it lies in: `contours=plane`.
    pub planar_by: Option<&'static str>,
    /// Identity that no shape of another file has, such as one of unique identifiers; it is the name where the shape is stored.
    pub id: Option<String>,
    /// How far the name reaches.
    pub scope: Scope,
    /// Who the shape is of, as the file identifies them. Only where it was asked for, and never stored: a keyed digest is.
    pub person: Option<String>,
    /// Opaque identifier of the subject; never a name of a person.
    pub subject: Option<String>,
    /// Class label.
    pub label: Option<String>,
    /// Attributes: texts, numbers and Booleans by name.
    pub labels: BTreeMap<String, Value>,
    /// Weight in means.
    pub weight: Option<f64>,
    /// Further facts of the file about the shape.
    pub metadata: Map<String, Json>,
    /// Its place among the rings of an object with several parts or with holes.
    pub ring: Option<Ring>,
    /// Where it is in the file.
    pub place: Place,
}

impl Record {
    /// A shape of which nothing else is known.
    pub fn new(geometry: impl Into<Geometry>, place: Place) -> Self {
        Self {
            geometry: geometry.into(),
            unit: None,
            name: None,
            planar_by: None,
            id: None,
            scope: Scope::File,
            person: None,
            subject: None,
            label: None,
            labels: BTreeMap::new(),
            weight: None,
            metadata: Map::new(),
            ring: None,
            place,
        }
    }

    /// Whether it has no points.
    pub fn is_empty(&self) -> bool {
        match &self.geometry {
            Geometry::Curve { points, .. } | Geometry::Landmarks(points) => points.is_empty(),
            Geometry::Mesh(mesh) => mesh.vertices.is_empty(),
            Geometry::Fourier(_) => false,
        }
    }

    /// The same in another unit, if it can be: coordinates, and the unit where the metadata name it. Positions of planes and
    /// slices in the metadata stay in the unit of the file.
    ///
    /// # Errors
    /// A length where the other unit is none, and the other way round; coordinates beyond the limits in the other unit.
    pub fn converted(mut self, from: Unit, to: Unit) -> Result<Self, FileError> {
        let Some(ratio) = from.to(to) else {
            let detail = format!("expected coordinates in {}, got {}", to.word(), from.word());
            return Err(FileError::new(FaultKind::Unsupported, detail));
        };
        let stated = self.metadata.get("unit").and_then(Json::as_str).and_then(Unit::find);
        if stated.is_some() && stated == self.unit && stated != Some(to) {
            self.metadata.insert("unit".into(), to.word().into());
        }
        self.unit = Some(to);
        if ratio != Ratio::ONE {
            self.geometry.scale(ratio);
            self.check()?;
        }
        Ok(self)
    }

    /// About the number of bytes that it takes in memory.
    pub fn bytes(&self) -> usize {
        self.geometry_bytes() + self.attribute_bytes()
    }

    /// About the number of bytes that it takes without attributes and metadata.
    pub(super) fn geometry_bytes(&self) -> usize {
        /// Of the record itself.
        const OWN: usize = 64;
        let numbers = match &self.geometry {
            Geometry::Curve { points, .. } | Geometry::Landmarks(points) => points.coordinates.len(),
            Geometry::Mesh(mesh) => {
                let fields = mesh.fields.values().map(|field| field.values.len()).sum::<usize>();
                mesh.vertices.coordinates.len() + mesh.faces.indices.len() + mesh.faces.len() + fields
            }
            Geometry::Fourier(fourier) => fourier.cosine.len() + fourier.sine.len(),
        };
        OWN + numbers * size_of::<f64>()
    }

    /// About the number of bytes that attributes and metadata take.
    pub(super) fn attribute_bytes(&self) -> usize {
        let each = size_of::<(String, Value)>();
        self.attribute_size(str::len, each, each) + map_bytes(&self.metadata)
    }

    /// About the number of characters of attributes and metadata where they are written.
    pub(super) fn attribute_characters(&self) -> usize {
        self.attribute_size(text_characters, 0, SCALAR) + map_characters(&self.metadata)
    }

    /// Sizes of texts, and beside them those of every attribute that is a text, and of every other one.
    fn attribute_size(&self, size: impl Fn(&str) -> usize, text: usize, other: usize) -> usize {
        let texts = [&self.name, &self.id, &self.person, &self.subject, &self.label]
            .into_iter()
            .flatten()
            .map(|text| size(text));
        let label = |(name, value): (&String, &Value)| {
            size(name) + if let Value::Text(content) = value { text + size(content) } else { other }
        };
        texts.sum::<usize>() + self.labels.iter().map(label).sum::<usize>()
    }

    /// Checks the parts that every reader must keep: coordinates, faces and fields.
    ///
    /// # Errors
    /// The first fault.
    pub fn check(&self) -> Result<(), FileError> {
        let dimension = self.geometry.dimension();
        if dimension > MAX_DIMENSION {
            let detail = format!("expected points of at most {MAX_DIMENSION} coordinates, got {dimension}");
            return Err(FileError::malformed(Place::default(), detail));
        }
        let checked = match &self.geometry {
            Geometry::Curve { points, .. } | Geometry::Landmarks(points) => points.check(),
            Geometry::Mesh(mesh) => mesh.check(),
            Geometry::Fourier(fourier) => fourier.check(),
        };
        checked.map_err(|detail| FileError::malformed(Place::default(), detail))
    }
}

/// One ring of an object that has holes or several parts. All rings of an object stand next to each other in a file, and are
/// separate records: nothing is merged.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ring {
    /// Position of the object in the file, from 0.
    pub object: u64,
    /// Part of the object, from 0.
    pub part: u64,
    /// Whether it bounds a hole of that part.
    pub hole: bool,
}

/// Kinds of geometry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// Contours and open curves.
    Curve,
    /// Homologous points.
    Landmarks,
    /// Meshes of polygons.
    Mesh,
    /// Elliptic Fourier coefficients.
    Fourier,
}

/// The shape of a record.
#[derive(Debug, Clone, PartialEq)]
pub enum Geometry {
    /// Points in order along a curve.
    Curve {
        /// The points; a closed curve does not repeat its first one.
        points: Points,
        /// Whether the last point is joined to the first one.
        closed: bool,
    },
    /// Homologous points; some may be missing.
    Landmarks(Points),
    /// A mesh of polygons in space.
    Mesh(Mesh),
    /// Elliptic Fourier coefficients of a closed curve.
    Fourier(Fourier),
}

impl Kind {
    /// Word in options and answers.
    pub fn name(self) -> &'static str {
        match self {
            Self::Curve => "curve",
            Self::Landmarks => "landmarks",
            Self::Mesh => "mesh",
            Self::Fourier => "fourier",
        }
    }
}

impl Geometry {
    /// Its points: vertices of a mesh, none of Fourier coefficients.
    pub fn points(&self) -> Option<&Points> {
        match self {
            Self::Curve { points, .. } | Self::Landmarks(points) => Some(points),
            Self::Mesh(mesh) => Some(&mesh.vertices),
            Self::Fourier(_) => None,
        }
    }

    /// Number of coordinates of a point.
    pub fn dimension(&self) -> usize {
        match self {
            Self::Fourier(fourier) => fourier.dimension(),
            other => other.points().map_or(0, Points::dimension),
        }
    }

    /// Multiplies all coordinates.
    fn scale(&mut self, ratio: Ratio) {
        let scale = |numbers: &mut [f64]| numbers.iter_mut().for_each(|x| *x = ratio.times(*x));
        match self {
            Self::Curve { points, .. } | Self::Landmarks(points) => scale(&mut points.coordinates),
            Self::Mesh(mesh) => scale(&mut mesh.vertices.coordinates),
            Self::Fourier(Fourier { constant, cosine, sine }) => {
                [constant, cosine, sine].into_iter().for_each(|numbers| scale(numbers));
            }
        }
    }

    /// Its kind.
    pub fn kind(&self) -> Kind {
        match self {
            Self::Curve { .. } => Kind::Curve,
            Self::Landmarks(_) => Kind::Landmarks,
            Self::Mesh(_) => Kind::Mesh,
            Self::Fourier(_) => Kind::Fourier,
        }
    }
}

impl From<Mesh> for Geometry {
    fn from(mesh: Mesh) -> Self {
        Self::Mesh(mesh)
    }
}

impl From<Fourier> for Geometry {
    fn from(fourier: Fourier) -> Self {
        Self::Fourier(fourier)
    }
}

/// Points of one dimension, some of which may be missing.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Points {
    dimension: usize,
    /// Row-major; a missing point is NaN in every coordinate.
    coordinates: Vec<f64>,
}

impl Points {
    /// No points yet.
    pub fn new(dimension: usize) -> Self {
        Self { dimension, coordinates: Vec::new() }
    }

    /// Points by row-major coordinates, whose number is a multiple of `dimension`.
    pub fn from_rows(dimension: usize, coordinates: Vec<f64>) -> Self {
        debug_assert!(dimension > 0 && coordinates.len().is_multiple_of(dimension));
        Self { dimension, coordinates }
    }

    /// Adds a point of `dimension` coordinates.
    pub fn push(&mut self, point: &[f64]) {
        debug_assert_eq!(point.len(), self.dimension);
        self.coordinates.extend_from_slice(point);
    }

    /// Adds a missing point.
    pub fn push_missing(&mut self) {
        self.coordinates.extend(std::iter::repeat_n(f64::NAN, self.dimension));
    }

    /// Removes the last point.
    pub fn pop(&mut self) {
        self.coordinates.truncate(self.coordinates.len().saturating_sub(self.dimension));
    }

    /// Number of coordinates of a point.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.coordinates.len().checked_div(self.dimension).unwrap_or(0)
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.coordinates.is_empty()
    }

    /// Row-major coordinates; a missing point is NaN in every coordinate.
    pub fn coordinates(&self) -> &[f64] {
        &self.coordinates
    }

    /// The points one by one.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &[f64]> + DoubleEndedIterator {
        self.coordinates.chunks_exact(self.dimension.max(1))
    }

    /// Positions of the missing points, in order.
    pub fn missing(&self) -> Vec<usize> {
        let is_missing = |(k, row): (usize, &[f64])| row.iter().all(|x| x.is_nan()).then_some(k);
        self.rows().enumerate().filter_map(is_missing).collect()
    }

    /// Drops the last point if it repeats the first one, as many formats close their rings. Returns whether it did.
    pub fn open(&mut self) -> bool {
        let repeated = self.len() > 1 && self.rows().next() == self.rows().next_back();
        if repeated {
            self.pop();
        }
        repeated
    }

    /// Every coordinate is finite and within the limit, or its point is missing.
    fn check(&self) -> Result<(), String> {
        for (k, row) in self.rows().enumerate() {
            let missing = row.iter().all(|x| x.is_nan());
            match row.iter().find(|x| !(x.abs() <= MAX_COORDINATE)) {
                Some(x) if !missing => {
                    return Err(format!(
                        "expected coordinates within ±{MAX_COORDINATE:e}, got {x:e} in point {k}"
                    ));
                }
                _ => {}
            }
        }
        Ok(())
    }
}

/// A mesh of polygons in space, with values at its vertices or faces.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Mesh {
    /// Positions of the vertices, in three dimensions.
    pub vertices: Points,
    /// The polygons.
    pub faces: Faces,
    /// Arrays of values by name.
    pub fields: BTreeMap<String, Field>,
}

impl Mesh {
    /// Three coordinates a vertex, none of them missing, faces of three or more existing vertices, whole fields.
    fn check(&self) -> Result<(), String> {
        if self.vertices.dimension() != 3 {
            return Err(format!("expected vertices with 3 coordinates, got {}", self.vertices.dimension()));
        }
        self.vertices.check()?;
        if let Some(vertex) = self.vertices.missing().first() {
            return Err(format!("expected finite coordinates, got none at vertex {vertex}"));
        }
        let count = self.vertices.len();
        for (k, face) in self.faces.iter().enumerate() {
            if face.len() < 3 {
                return Err(format!("expected faces of at least 3 vertices, got {} in face {k}", face.len()));
            }
            if let Some(vertex) = face.iter().find(|vertex| **vertex as usize >= count) {
                return Err(format!("expected indices of vertices below {count}, got {vertex} in face {k}"));
            }
        }
        for (name, field) in &self.fields {
            let carriers = match field.domain {
                Domain::Vertices => count,
                Domain::Faces => self.faces.len(),
            };
            if carriers.checked_mul(field.width) != Some(field.values.len()) {
                let expected = format!("{carriers} × {}", field.width);
                return Err(format!(
                    "expected {expected} values of field '{name}', got {}",
                    field.values.len()
                ));
            }
        }
        Ok(())
    }
}

/// Polygons as lists of indices of vertices, all in one vector.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Faces {
    indices: Vec<u32>,
    /// End of each face in `indices`.
    ends: Vec<usize>,
}

impl Faces {
    /// Adds a polygon.
    pub fn push(&mut self, face: impl IntoIterator<Item = u32>) {
        self.indices.extend(face);
        self.ends.push(self.indices.len());
    }

    /// Number of polygons.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// Whether there are no polygons.
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// The polygons one by one.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &[u32]> {
        (0..self.ends.len())
            .map(|k| &self.indices[k.checked_sub(1).map_or(0, |k| self.ends[k])..self.ends[k]])
    }

    /// Triangles; a polygon of more corners becomes a fan around its first one.
    pub fn triangles(&self) -> impl Iterator<Item = [u32; 3]> {
        self.iter()
            .flat_map(|face| (1..face.len().saturating_sub(1)).map(|k| [face[0], face[k], face[k + 1]]))
    }
}

/// Values at the vertices or faces of a mesh, such as colours, thickness or labels.
#[derive(Debug, Clone, PartialEq)]
pub struct Field {
    /// Elements that have a value each.
    pub domain: Domain,
    /// Number of components of a value.
    pub width: usize,
    /// Values, row-major. NaN where the file has none.
    pub values: Vec<f64>,
}

/// Elements to which the values of a field belong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Domain {
    /// One value a vertex.
    Vertices,
    /// One value a face.
    Faces,
}

/// A closed curve by elliptic Fourier coefficients:
///
/// ```text
/// r(t) = c + Σ_{k=1…n} a_k cos 2πkt + b_k sin 2πkt,   0 ≤ t < 1
/// ```
///
/// In the plane the classical names are `a_k = (A_k, C_k)`, `b_k = (B_k, D_k)` (Kuhl and Giardina 1982).
#[derive(Debug, Clone, PartialEq)]
pub struct Fourier {
    /// `c`, one number a dimension.
    pub constant: Vec<f64>,
    /// `a_k`, n × d, row-major.
    pub cosine: Vec<f64>,
    /// `b_k`, n × d, row-major.
    pub sine: Vec<f64>,
}

impl Fourier {
    /// Number of coordinates of a point.
    pub fn dimension(&self) -> usize {
        self.constant.len()
    }

    /// Number of harmonics.
    pub fn harmonics(&self) -> usize {
        self.cosine.len().checked_div(self.dimension()).unwrap_or(0)
    }

    fn check(&self) -> Result<(), String> {
        let Self { constant, cosine, sine } = self;
        if constant.is_empty() || cosine.len() != sine.len() || !cosine.len().is_multiple_of(constant.len()) {
            return Err(
                "expected four coefficients of every harmonic in the plane, got another number".into()
            );
        }
        let all = || [constant, cosine, sine].into_iter().flatten();
        match all().find(|x| !(x.abs() <= MAX_COORDINATE)) {
            Some(x) => Err(format!("expected coefficients within ±{MAX_COORDINATE:e}, got {x:e}")),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_numbers_stay_whole() {
        for (text, value, written) in [
            ("61", Value::Number(61.0), "61"),
            ("61.0", Value::Number(61.0), "61"),
            ("61.5", Value::Number(61.5), "61.5"),
            ("-9007199254740991", Value::Number(-9_007_199_254_740_991.0), "-9007199254740991"),
            ("9007199254740992", "9007199254740992".into(), "\"9007199254740992\""),
            ("9007199254740993", "9007199254740993".into(), "\"9007199254740993\""),
            ("18446744073709551615", "18446744073709551615".into(), "\"18446744073709551615\""),
            ("-9223372036854775808", "-9223372036854775808".into(), "\"-9223372036854775808\""),
            ("1e300", Value::Number(1e300), "1e+300"),
            ("true", Value::Bool(true), "true"),
            ("\"61\"", "61".into(), "\"61\""),
        ] {
            let found: Value = serde_json::from_str(text).expect("a value");
            assert_eq!(found, value, "{text}");
            assert_eq!(serde_json::to_string(&found).expect("a text"), written);
        }
    }

    #[test]
    fn attributes_have_the_characters_that_are_written() {
        let mut record = Record::new(Geometry::Landmarks(Points::new(2)), Place::default());
        record.name = Some("a\n".into());
        let labels = [("n", Value::Number(0.1)), ("yes", Value::Bool(true)), ("t", "\u{1}bc".into())];
        record.labels = labels.map(|(name, value)| (name.to_owned(), value)).into();
        assert_eq!(record.attribute_characters(), 7 + (1 + 8) + (3 + 8) + (1 + 6 + 2));
        assert_eq!(record.attribute_bytes(), 2 + 5 + 3 + 3 * size_of::<(String, Value)>());
    }
}
