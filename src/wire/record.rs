//! Shapes of files as posted shapes.
//!
//! | record | points of landmarks | curve | surface with two parameters | subdivision surface |
//! |---|---|---|---|---|
//! | curve, landmarks | its points | its points | refused | refused |
//! | mesh | its vertices | refused | a fit | its vertices as control points, if the faces agree |
//! | Fourier coefficients | refused | the curve itself, else `samples` points | refused | refused |

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value as Json};

use super::checked::{Checked, Metadata, Raw};
use super::fault::Fault;
use super::files::{Faces, Fourier, Geometry, Mesh, Place, Points, Record, Summary, Value};
use super::json;
use super::shape::{PointList, ShapeInput};
use super::unit::Unit;
use crate::geometry::capability::domain::Domain;
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::representation::Representation;

/// Maximum number of missing points that are named of one shape.
const NAMED: usize = 20;
/// Maximum number of points that a curve of Fourier coefficients is sampled at.
pub const MAX_SAMPLES: usize = 10_000;

/// Plane onto which curves in space are projected.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Plane {
    /// The first two coordinates, such as those of axial slices.
    Xy,
    /// The first and the third coordinate.
    Xz,
    /// The last two coordinates.
    Yz,
}

impl Plane {
    fn axes(self) -> [usize; 2] {
        match self {
            Self::Xy => [0, 1],
            Self::Xz => [0, 2],
            Self::Yz => [1, 2],
        }
    }
}

/// How records become shapes of a representation.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Placing {
    /// Plane of shapes in space, where the representation is planar. Default: they are refused.
    pub plane: Option<Plane>,
    /// Number of points at which Fourier coefficients are sampled, where the representation does not contain their curves.
    pub samples: Option<usize>,
    /// Text before names, instead of the name of the file.
    pub prefix: Option<String>,
    /// Unit of the coordinates, whatever the file says.
    pub unit: Option<Unit>,
    /// Unit in which shapes are stored, once it is known.
    pub stored_unit: Option<Unit>,
    /// Name of the file, by which its shapes are named.
    pub name: Option<String>,
    /// Facts of all shapes where their records say nothing.
    pub facts: Facts,
    /// Maximum size of the metadata of a shape in bytes.
    pub metadata_bytes: usize,
}

/// Attributes of all shapes of a file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Facts {
    /// Subject.
    pub subject: Option<String>,
    /// Class label.
    pub label: Option<String>,
    /// Further attributes.
    pub labels: BTreeMap<String, Value>,
    /// Weight in means.
    pub weight: Option<f64>,
}

impl Facts {
    /// A further attribute by its name and the text of its value: a number or a Boolean where it is one of JSON, a text in quotation
    /// marks or any other text as it is.
    pub fn add(&mut self, name: &str, text: &str) {
        let value = match serde_json::from_str(text) {
            Ok(Json::Bool(yes)) => Value::Bool(yes),
            Ok(Json::String(text)) => Value::Text(text),
            Ok(Json::Number(number)) => Value::number(&number).unwrap_or_else(|| text.into()),
            _ => text.into(),
        };
        self.labels.insert(name.into(), value);
    }
}

/// Counts the parts of a record that are not stored: the fields of meshes, and their faces where the vertices become landmarks. Without a
/// domain, those that no cohort stores.
pub fn count_unstored(record: &Record, domain: Option<Domain>, summary: &mut Summary) {
    let Geometry::Mesh(mesh) = &record.geometry else { return };
    let place = || record.place.clone();
    for name in mesh.fields.keys() {
        summary.drop("fields of meshes", Some(name), place);
    }
    if domain == Some(Domain::Points) && !mesh.faces.is_empty() {
        summary.drop("faces of meshes whose vertices become landmarks", record.name.as_deref(), place);
    }
}

/// Shape made of a record.
#[derive(Debug)]
pub enum Placed {
    /// A shape as posted.
    Shape(ShapeInput),
    /// Attributes, and a mesh to which a surface is fitted.
    Mesh(ShapeInput, TriangleMesh),
    /// Attributes, and a curve that the representation may contain.
    Fourier(ShapeInput, Fourier),
}

impl Placing {
    /// The shape of a record in a representation.
    ///
    /// # Errors
    /// All faults of the record, with pointers into the posted shape.
    pub fn place(&self, record: Record, representation: &Representation) -> Result<Placed, Vec<Fault>> {
        let record = self.in_stored_unit(record)?;
        let Record { geometry, planar_by, .. } = record;
        let attributes =
            self.attributes(Record { geometry: Geometry::Landmarks(Points::default()), ..record });
        let (domain, dimension) = (representation.domain(), representation.dimension());
        match (geometry, domain) {
            (Geometry::Curve { points, closed }, Domain::Points | Domain::Line { .. }) => {
                let closed = domain.is_line().then_some(Checked::of(Some(closed)));
                let points = self.points(points, dimension, planar_by)?;
                Ok(with_points(points, ShapeInput { closed, ..attributes }))
            }
            (Geometry::Landmarks(points), Domain::Points | Domain::Line { .. }) => {
                Ok(with_points(self.points(points, dimension, planar_by)?, attributes))
            }
            (Geometry::Mesh(mesh), Domain::Points) => {
                Ok(with_points(self.points(mesh.vertices, dimension, None)?, attributes))
            }
            (Geometry::Mesh(mesh), Domain::Sheet { .. }) => Ok(Placed::Mesh(attributes, triangles(&mesh)?)),
            (Geometry::Mesh(mesh), Domain::Vertices) => {
                check_faces(&mesh.faces, representation)?;
                let control_points = self.points(mesh.vertices, dimension, None)?;
                let control_points = Some(Box::new(control_points));
                Ok(Placed::Shape(ShapeInput { control_points, ..attributes }))
            }
            (Geometry::Fourier(fourier), Domain::Line { closed: true }) => {
                match fourier.dimension() == dimension {
                    true => Ok(Placed::Fourier(attributes, fourier)),
                    false => Err(wrong_dimension(fourier.dimension(), dimension, "")),
                }
            }
            (other, _) => {
                let (found, kind) = (other.kind().name(), representation.kind_name());
                let detail = format!("expected a shape that can be a {kind}, got one of the kind {found}");
                Err(vec![Fault::new("", detail)])
            }
        }
    }

    /// Unit of the coordinates of a record, where it is known.
    pub fn unit_of(&self, record: &Record) -> Option<Unit> {
        self.unit.or(record.unit)
    }

    /// A record in the unit in which shapes are stored.
    fn in_stored_unit(&self, record: Record) -> Result<Record, Vec<Fault>> {
        match self.unit_of(&record).zip(self.stored_unit) {
            None => Ok(record),
            Some((from, to)) => {
                record.converted(from, to).map_err(|error| vec![Fault::new("", error.detail)])
            }
        }
    }

    /// The facts of all shapes, as a shape without points.
    pub fn said(&self) -> ShapeInput {
        self.attributes(Record::new(Geometry::Landmarks(Points::default()), Place::default()))
    }

    /// Attributes of a shape: its name, labels and metadata, and the facts of all shapes where the record says nothing.
    fn attributes(&self, record: Record) -> ShapeInput {
        let Record { name, subject, label, mut labels, weight, mut metadata, ring, .. } = record;
        if let Some(ring) = ring {
            labels.entry("hole".into()).or_insert(Value::Bool(ring.hole));
            metadata.entry("ring").or_insert_with(|| json::to_value(&ring).unwrap_or_default());
        }
        let Facts { subject: of, label: class, labels: further, weight: usual } = &self.facts;
        for (name, value) in further {
            labels.entry(name.clone()).or_insert_with(|| value.clone());
        }
        let (subject, label, weight) =
            (subject.or_else(|| of.clone()), label.or_else(|| class.clone()), weight.or(*usual));
        let text = |text: Option<String>| text.map(|text| Checked::of(Some(text)));
        ShapeInput {
            external_id: text(name),
            subject: text(subject),
            label: text(label),
            labels: if labels.is_empty() { None } else { Raw::of(&labels) },
            weight: weight.map(|weight| Checked::of(Some(weight))),
            metadata: self.metadata(metadata),
            ..ShapeInput::default()
        }
    }

    fn metadata(&self, metadata: Map<String, Json>) -> Option<Box<Metadata>> {
        let most = self.metadata_bytes;
        (!metadata.is_empty()).then(|| Box::new(Metadata::within(&Json::Object(metadata), most)))
    }

    /// Points without missing ones, in the dimension of the representation.
    fn points(
        &self,
        points: Points,
        wanted: usize,
        planar_by: Option<&str>,
    ) -> Result<PointList, Vec<Fault>> {
        let missing = points.missing();
        if !missing.is_empty() {
            let fault = |k: &usize| {
                let detail = "expected coordinates, got a missing point: shapes of a cohort are whole \
                              (POST /v1/pca/incomplete takes shapes with missing points)";
                Fault::new(format!("/points/{k}"), detail)
            };
            return Err(missing.iter().take(NAMED).map(fault).collect());
        }
        let found = points.dimension();
        match (found, wanted, self.plane) {
            _ if found == wanted || points.is_empty() => {
                Ok(PointList::of_rows(found.max(1), points.coordinates().to_vec()))
            }
            (3, 2, Some(plane)) => {
                let [a, b] = plane.axes();
                let coordinates = points.rows().flat_map(|row| [row[a], row[b]]).collect();
                Ok(PointList::of_rows(2, coordinates))
            }
            (3, 2, None) => {
                let own = planar_by.map(|option| format!("{option} gives each in the plane of its slice; "));
                let hint = format!(" ({}plane=xy, xz or yz projects them)", own.unwrap_or_default());
                Err(wrong_dimension(found, wanted, &hint))
            }
            _ => Err(wrong_dimension(found, wanted, "")),
        }
    }
}

fn with_points(points: PointList, attributes: ShapeInput) -> Placed {
    Placed::Shape(ShapeInput { points: Some(Box::new(points)), ..attributes })
}

fn wrong_dimension(found: usize, wanted: usize, hint: &str) -> Vec<Fault> {
    let detail = format!(
        "expected {wanted} coordinates per point (the dimension of the representation), got {found}{hint}"
    );
    vec![Fault::new("/points", detail)]
}

/// The mesh of triangles; polygons of more corners become fans.
fn triangles(mesh: &Mesh) -> Result<TriangleMesh, Vec<Fault>> {
    let vertices = mesh.vertices.coordinates().as_chunks().0.to_vec();
    let triangles = TriangleMesh { vertices, normals: None, faces: mesh.faces.triangles().collect() };
    match triangles.check_faces() {
        Ok(()) => Ok(triangles),
        Err(error) => Err(vec![Fault::new("/faces", error.to_string())]),
    }
}

/// Checks that the faces of a mesh are those of the control mesh of a representation, in any order.
fn check_faces(faces: &Faces, representation: &Representation) -> Result<(), Vec<Fault>> {
    let refused = |detail: &str| Err(vec![Fault::new("/faces", detail)]);
    let Some(control) = representation.control_faces() else {
        return refused("expected a representation with a control mesh, got another one");
    };
    let begin = |[a, b, c]: [u32; 3]| {
        let least = a.min(b).min(c);
        if least == a {
            [a, b, c]
        } else if least == b {
            [b, c, a]
        } else {
            [c, a, b]
        }
    };
    let mut wanted: Vec<[u32; 3]> = control.into_iter().map(begin).collect();
    let mut found: Vec<[u32; 3]> = faces.triangles().map(begin).collect();
    wanted.sort_unstable();
    found.sort_unstable();
    if wanted == found {
        return Ok(());
    }
    refused(
        "expected the faces of the control mesh of the representation, got others: fit the mesh with \
         POST /v1/fit, or post its points",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::generator::GeneratorKind;

    fn curves() -> Representation {
        let generator = GeneratorKind::Trigonometric {};
        Representation::ClosedCurve { dimension: 2, control_points: 5, generator }
    }

    fn record(geometry: Geometry) -> Record {
        Record { name: Some("a".into()), ..Record::new(geometry, Place::item(0)) }
    }

    fn fault(placing: &Placing, geometry: Geometry, representation: &Representation) -> String {
        let faults = placing.place(record(geometry), representation).unwrap_err();
        format!("{} {}", faults[0].pointer, faults[0].detail)
    }

    #[test]
    fn curves_in_space_need_a_plane() {
        let curve = || Geometry::Curve {
            points: Points::from_rows(3, vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0]),
            closed: true,
        };
        let text = fault(&Placing::default(), curve(), &curves());
        assert!(text.starts_with("/points expected 2 coordinates") && text.contains("plane=xy"), "{text}");
        let drawn = Record { planar_by: Some("contours=plane"), ..record(curve()) };
        let faults = Placing::default().place(drawn, &curves()).unwrap_err();
        let hint = "(contours=plane gives each in the plane of its slice; plane=xy, xz or yz projects them)";
        assert!(faults[0].detail.ends_with(hint), "{}", faults[0].detail);
        let placing = Placing { plane: Some(Plane::Xz), metadata_bytes: 1000, ..Placing::default() };
        let Placed::Shape(shape) = placing.place(record(curve()), &curves()).unwrap() else { panic!() };
        let points = shape.points.unwrap();
        assert_eq!(points.checked(2).unwrap(), [1.0, 3.0, 4.0, 6.0, 7.0, 10.0]);
        assert_eq!(shape.external_id.unwrap().get().unwrap().as_deref(), Some("a"));
    }

    #[test]
    fn facts_hold_where_records_say_nothing() {
        let mut facts = Facts { subject: Some("p".into()), weight: Some(2.0), ..Facts::default() };
        for (name, text) in
            [("age", "61"), ("ward", "B"), ("code", "\"007\""), ("big", "007"), ("dead", "false")]
        {
            facts.add(name, text);
        }
        let placing = Placing { facts, ..Placing::default() };
        let own = Record { subject: Some("own".into()), ..record(Geometry::Landmarks(Points::default())) };
        let own = Record { labels: [("age".to_owned(), Value::Number(3.0))].into(), ..own };
        let (own, other) = (placing.attributes(own), placing.said());
        let subject = |shape: &ShapeInput| shape.subject.as_ref().unwrap().get().unwrap().clone();
        assert_eq!((subject(&own).as_deref(), subject(&other).as_deref()), (Some("own"), Some("p")));
        let mut errors = Vec::new();
        let mut labels = |shape: ShapeInput| -> Option<Json> { shape.labels?.read(1000, "", &mut errors) };
        let rest = serde_json::json!({"age": 3, "ward": "B", "code": "007", "big": "007", "dead": false});
        assert_eq!(labels(own), Some(rest.clone()));
        assert_eq!(labels(other).unwrap()["age"], 61);
    }

    #[test]
    fn missing_points_are_named_by_index() {
        let mut points = Points::from_rows(2, vec![1.0, 2.0]);
        points.push_missing();
        let landmarks = Representation::Landmarks { dimension: 2, points: 2 };
        let text = fault(&Placing::default(), Geometry::Landmarks(points), &landmarks);
        assert!(text.starts_with("/points/1 expected coordinates, got a missing point"), "{text}");
    }

    #[test]
    fn a_mesh_is_no_curve() {
        let text = fault(&Placing::default(), Mesh::default().into(), &curves());
        assert_eq!(text, " expected a shape that can be a closed_curve, got one of the kind mesh");
    }

    #[test]
    fn rings_say_whether_they_bound_a_hole() {
        let points = Points::from_rows(2, vec![0.0; 6]);
        let ring = Some(super::super::files::Ring { object: 4, part: 1, hole: true });
        let record = Record { ring, ..record(Geometry::Curve { points, closed: true }) };
        let placing = Placing { metadata_bytes: 1000, ..Placing::default() };
        let Placed::Shape(shape) = placing.place(record, &curves()).unwrap() else { panic!() };
        let mut errors = Vec::new();
        let metadata = shape.metadata.unwrap().take("", &mut errors).unwrap();
        assert_eq!(metadata, serde_json::json!({"ring": {"object": 4, "part": 1, "hole": true}}));
        let labels: Option<Json> = shape.labels.unwrap().read(1000, "", &mut errors);
        assert_eq!(labels, Some(serde_json::json!({"hole": true})));
    }
}
