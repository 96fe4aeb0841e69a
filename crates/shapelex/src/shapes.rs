//! Sets of shapes of one kind: contours, landmarks, surfaces.

use std::fmt::Debug;
use std::marker::PhantomData;
use std::sync::Arc;

use shapelex_analysis::conversion::Conversion;
use shapelex_analysis::correspondence::Correspondence;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::Representation;
use shapelex_geometry::resample::RepeatedPoints;
use shapelex_geometry::subdivision::control::ControlMesh;
use shapelex_geometry::subdivision::{LoopWeights, Scheme, Subdivision};

use crate::error::{Error, Result};
use crate::points::Points;
use crate::setting::Prepared;

/// Number of control points of a contour unless [`Contours::resample`] says another.
const CONTROL_POINTS: usize = 64;

/// Contours: points in order along closed or open curves, as many as each one has.
pub type Contours = Shapes<Contour>;
/// Landmarks: points that correspond, the same number in all shapes.
pub type Landmarks = Shapes<Landmark>;
/// Surfaces: meshes that share their faces, or control points of one representation.
pub type Surfaces = Shapes<Surface>;

/// Curves.
#[derive(Debug, Clone)]
pub struct Contour;
/// Points that correspond.
#[derive(Debug, Clone)]
pub struct Landmark;
/// Surfaces.
#[derive(Debug, Clone)]
pub struct Surface;

/// Shapes of one kind, with names and labels.
#[derive(Debug, Clone)]
pub struct Shapes<K> {
    pub(crate) set: Set,
    kind: PhantomData<K>,
}

/// Shapes of any kind.
#[derive(Debug, Clone)]
pub(crate) struct Set {
    pub(crate) shapes: Vec<Points>,
    pub(crate) names: Vec<Option<String>>,
    pub(crate) labels: Vec<Option<String>>,
    pub(crate) form: Form,
}

/// How points make shapes.
#[derive(Debug, Clone)]
pub(crate) enum Form {
    /// Curves that are resampled to so many control points.
    Curve { dimension: usize, closed: bool, control_points: usize },
    /// Control points of a representation, or landmarks.
    Given(Representation),
}

impl Set {
    pub(crate) fn new(shapes: Vec<Points>, form: Form) -> Self {
        let none = vec![None; shapes.len()];
        Self { names: none.clone(), labels: none, shapes, form }
    }

    pub(crate) fn representation(&self) -> Representation {
        match &self.form {
            Form::Curve { dimension, closed: true, control_points } => Representation::ClosedCurve {
                dimension: *dimension,
                control_points: *control_points,
                generator: GeneratorKind::Bspline { degree: 3 },
            },
            Form::Curve { dimension, closed: false, control_points } => Representation::OpenCurve {
                dimension: *dimension,
                intervals: control_points.saturating_sub(1),
                generator: GeneratorKind::Bspline { degree: 3 },
            },
            Form::Given(representation) => representation.clone(),
        }
    }

    /// How points correspond unless a setting says it.
    pub(crate) fn correspondence(&self) -> Correspondence {
        match &self.form {
            Form::Curve { closed: true, .. } => Correspondence::Cyclic,
            Form::Curve { closed: false, .. } => Correspondence::ArcLength,
            Form::Given(_) => Correspondence::Landmarks,
        }
    }

    /// Control points in a prepared space, one shape after the other, coordinate-major.
    pub(crate) fn control_points(&self, prepared: &Prepared) -> Result<Vec<f64>> {
        let (space, recipe) = (prepared.space(), &prepared.recipe);
        let conversion = Conversion {
            space,
            correspondence: recipe.correspondence,
            direction: recipe.direction,
            repeated_points: RepeatedPoints::Drop,
        };
        let mut found = Vec::with_capacity(self.shapes.len() * space.representation().size());
        for (index, shape) in self.shapes.iter().enumerate() {
            let refused = |detail| Error::Shape { index, detail };
            if shape.dimension() != prepared.dimension() {
                let (expected, got) = (prepared.dimension(), shape.dimension());
                return Err(refused(format!("expected points with {expected} coordinates, got {got}")));
            }
            if let Some(at) = shape.fault() {
                let (point, value) = (at / shape.dimension(), shape.as_flat()[at]);
                let most = shapelex_numeric::MAX_NUMBER;
                return Err(refused(format!(
                    "point {point}: expected a number within ±{most:e}, got {value}"
                )));
            }
            let converted = match &self.form {
                Form::Curve { .. } => conversion.interpolate(shape.matrix()),
                Form::Given(_) => conversion.take(shape.matrix()),
            };
            let converted = converted.map_err(|fault| refused(fault.detail))?;
            found.extend_from_slice(converted.control_points.as_slice());
        }
        Ok(found)
    }
}

impl<K> Shapes<K> {
    pub(crate) fn of(set: Set) -> Self {
        Self { set, kind: PhantomData }
    }

    /// Number of shapes.
    pub fn len(&self) -> usize {
        self.set.shapes.len()
    }

    /// Whether there are no shapes.
    pub fn is_empty(&self) -> bool {
        self.set.shapes.is_empty()
    }

    /// The points of the shapes, as they were given.
    ///
    /// ```
    /// let landmarks = shapelex::Landmarks::new([vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]])?;
    /// assert_eq!(landmarks.points()[0].len(), 3);
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn points(&self) -> &[Points] {
        &self.set.shapes
    }

    /// The names of the shapes in their file.
    pub fn names(&self) -> &[Option<String>] {
        &self.set.names
    }

    /// The labels of the shapes, by which they are compared.
    pub fn labels(&self) -> &[Option<String>] {
        &self.set.labels
    }

    /// The shapes with these labels, one for each.
    ///
    /// # Errors
    /// [`Error::Setting`] for another number of labels.
    ///
    /// ```
    /// let triangle = |k: usize| vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0 + k as f64]];
    /// let landmarks = shapelex::Landmarks::new((0..4).map(triangle))?;
    /// let labelled = landmarks.clone().with_labels(["small", "small", "large", "large"])?;
    /// assert_eq!(labelled.labels()[2].as_deref(), Some("large"));
    /// assert!(landmarks.with_labels(["small"]).is_err());
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn with_labels<L: Into<String>>(mut self, labels: impl IntoIterator<Item = L>) -> Result<Self> {
        let labels: Vec<Option<String>> = labels.into_iter().map(|label| Some(label.into())).collect();
        let (expected, got) = (self.len(), labels.len());
        if expected != got {
            let detail = format!("expected {expected}, one for each shape, got {got}");
            return Err(Error::Setting { field: "labels", detail });
        }
        self.set.labels = labels;
        Ok(self)
    }

    /// The representation of the shapes, as the service names it.
    pub fn representation(&self) -> Representation {
        self.set.representation()
    }
}

impl Contours {
    /// Closed contours from their points in the plane or in space; the first point is not repeated at the end, or it is.
    ///
    /// # Errors
    /// [`Error::Shape`] for a contour with fewer than three points.
    ///
    /// ```
    /// let square = vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    /// let contours = shapelex::Contours::new([square])?.resample(16);
    /// assert_eq!(contours.representation().size(), 16);
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn new<const D: usize>(contours: impl IntoIterator<Item = Vec<[f64; D]>>) -> Result<Self> {
        Self::from_points(contours.into_iter().map(|rows| Points::from_arrays(&rows)), true)
    }

    /// Open curves from their points, from one end to the other.
    ///
    /// # Errors
    /// [`Error::Shape`] for a curve with fewer than three points.
    ///
    /// ```
    /// let arc = |k: usize| (0..30).map(move |i| [0.1 * i as f64, (0.1 * (i + k) as f64).sin()]).collect::<Vec<_>>();
    /// let curves = shapelex::Contours::open((0..5).map(arc))?.resample(12);
    /// assert_eq!(curves.mean(shapelex::Class::Similarity)?.shapes, 5);
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn open<const D: usize>(curves: impl IntoIterator<Item = Vec<[f64; D]>>) -> Result<Self> {
        Self::from_points(curves.into_iter().map(|rows| Points::from_arrays(&rows)), false)
    }

    /// Contours from points, all closed or all open.
    ///
    /// # Errors
    /// [`Error::Shape`] for points of another dimension than the first ones, or fewer than three.
    pub fn from_points(contours: impl IntoIterator<Item = Points>, closed: bool) -> Result<Self> {
        let shapes: Vec<Points> = contours.into_iter().collect();
        let dimension = dimension_of(&shapes)?;
        if let Some(index) = shapes.iter().position(|shape| shape.len() < 3) {
            let detail = format!("expected at least 3 points, got {}", shapes[index].len());
            return Err(Error::Shape { index, detail });
        }
        let form = Form::Curve { dimension, closed, control_points: CONTROL_POINTS };
        Ok(Self::of(Set::new(shapes, form)))
    }

    /// The same contours by so many control points each; 64 without. More follow a contour more closely, and cost more.
    #[must_use]
    pub fn resample(mut self, count: usize) -> Self {
        if let Form::Curve { control_points, .. } = &mut self.set.form {
            *control_points = count;
        }
        self
    }
}

impl Landmarks {
    /// Landmarks from their points, which correspond by their order.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of points than the first shape has.
    ///
    /// ```
    /// use shapelex::{Error, Landmarks};
    ///
    /// let found = Landmarks::new([vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], vec![[0.0, 0.0], [1.0, 0.0]]]);
    /// assert!(matches!(found, Err(Error::Shape { index: 1, .. })));
    /// ```
    pub fn new<const D: usize>(shapes: impl IntoIterator<Item = Vec<[f64; D]>>) -> Result<Self> {
        Self::from_points(shapes.into_iter().map(|rows| Points::from_arrays(&rows)))
    }

    /// Landmarks from points.
    ///
    /// # Errors
    /// As for [`Self::new`].
    pub fn from_points(shapes: impl IntoIterator<Item = Points>) -> Result<Self> {
        let shapes: Vec<Points> = shapes.into_iter().collect();
        let (dimension, points) = (dimension_of(&shapes)?, shapes[0].len());
        equally_many(&shapes, points)?;
        let form = Form::Given(Representation::Landmarks { dimension, points });
        Ok(Self::of(Set::new(shapes, form)))
    }
}

impl Surfaces {
    /// Meshes in space that share their triangles: vertices correspond by their order.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of vertices than the first mesh has; [`Error::Setting`] for faces that form no surface.
    ///
    /// ```
    /// use shapelex::{Class, Surfaces};
    ///
    /// let faces = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]];
    /// let solid = |k: usize| vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0 + 0.1 * k as f64, 0.0], [0.0, 0.0, 2.0]];
    /// let meshes = Surfaces::meshes(&faces, (0..6).map(solid))?;
    /// let mean = meshes.mean(Class::Similarity)?;
    /// assert_eq!((mean.shapes, mean.control_points.len()), (6, 4));
    /// # Ok::<(), shapelex::Error>(())
    /// ```
    pub fn meshes(faces: &[[u32; 3]], shapes: impl IntoIterator<Item = Vec<[f64; 3]>>) -> Result<Self> {
        let connectivity = ControlMesh::Faces(faces.to_vec());
        let scheme = Scheme::Loop(LoopWeights::default());
        let mesh = Subdivision { scheme, level: 0, connectivity };
        mesh.control().map_err(|error| Error::Setting { field: "faces", detail: error.to_string() })?;
        let shapes = shapes.into_iter().map(|rows| Points::from_arrays(&rows));
        Self::from_points(Representation::Subdivision(mesh), shapes)
    }

    /// Surfaces of a representation, or other shapes of one, from their control points.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of control points than the representation has.
    pub fn from_points(
        representation: Representation,
        shapes: impl IntoIterator<Item = Points>,
    ) -> Result<Self> {
        let shapes: Vec<Points> = shapes.into_iter().collect();
        equally_many(&shapes, representation.size())?;
        Ok(Self::of(Set::new(shapes, Form::Given(representation))))
    }
}

/// The number of coordinates of all points.
fn dimension_of(shapes: &[Points]) -> Result<usize> {
    let Some(first) = shapes.first() else {
        return Err(Error::Setting { field: "shapes", detail: "expected at least 1, got 0".into() });
    };
    let dimension = first.dimension();
    match shapes.iter().position(|shape| shape.dimension() != dimension || !(2..=3).contains(&dimension)) {
        None => Ok(dimension),
        Some(index) => {
            let (expected, got) = (dimension.clamp(2, 3), shapes[index].dimension());
            let detail = format!("expected points with {expected} coordinates, got {got}");
            Err(Error::Shape { index, detail })
        }
    }
}

fn equally_many(shapes: &[Points], expected: usize) -> Result<()> {
    match shapes.iter().position(|shape| shape.len() != expected) {
        None => Ok(()),
        Some(index) => {
            let detail =
                format!("expected {expected} points, as all shapes have, got {}", shapes[index].len());
            Err(Error::Shape { index, detail })
        }
    }
}

/// Shared part of several results: the prepared space.
pub(crate) type Space = Arc<Prepared>;
