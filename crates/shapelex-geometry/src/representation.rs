//! Representations of shapes, and the shape spaces prepared from them.
//!
//! ```text
//! closed   r(u) = Σ_{k<M} c[k] φ_per(M u − k),   φ_per(t) = Σ_n φ(t − nM)
//! open     r(u) = Σ_{k=−K}^{M+K} c[k] φ(M u − k),   K = ⌈support/2⌉ − 1
//! surface  σ(u, v) = Σ_{k,l} c[k, l] φ_u(M_u u − k) φ_v(M_v v − l)
//! subdivision  X = S_{K−1} ⋯ S_0 c
//! ```
//!
//! A shape is an `N × d` matrix of control points `c`. Its space provides one Gram operator `Φ` (`N × N`),
//! `⟨r, s⟩ = tr(cᵣᵀ Φ c_s)`; the layers above do not depend on how `Φ` is made.

use std::sync::Arc;

use super::GeometryError;
use super::generator::{Generator, GeneratorKind};
use super::knot_line::Line;
use super::subdivision::Subdivision;
use super::subdivision::basis::SubdivisionBasis;
use super::surface::basis::{Extent, SurfaceBasis, Tangents};
use super::surface::motion::Motions;
use super::surface::seam::Seam;
use super::surface::{Topology, sphere};
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::operator::{ScaledIdentity, SymmetricOperator};

/// Representation of a shape: kind, dimension, size and generator.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields))]
pub enum Representation {
    /// A closed spline curve in the plane or in space.
    ClosedCurve {
        /// Dimension of the points: 2 or 3.
        #[cfg_attr(feature = "schema", schema(minimum = 2, maximum = 3))]
        dimension: usize,
        /// Number of control points `N`. Minimum: 3.
        #[cfg_attr(feature = "schema", schema(minimum = 3))]
        control_points: usize,
        /// The generator of the curve.
        generator: GeneratorKind,
    },
    /// An open spline curve in the plane or in space, on `u ∈ [0, 1]`. A shape is given by `M + 1` points on the curve, or by
    /// all `M + 1 + 2K` control points, including the `K = ⌈support/2⌉ − 1` beyond each end (one less at the end of
    /// `shifted_exponential`).
    OpenCurve {
        /// Dimension of the points: 2 or 3.
        #[cfg_attr(feature = "schema", schema(minimum = 2, maximum = 3))]
        dimension: usize,
        /// Number of intervals `M` between knots.
        #[cfg_attr(feature = "schema", schema(minimum = 1))]
        intervals: usize,
        /// The generator of the curve.
        generator: GeneratorKind,
    },
    /// A tensor-product surface in space. A shape is given by a grid of points on it, `[u][v][x, y, z]`: `M_u × M_v` on a
    /// torus, `M_u × (M_v + 1)` on a cylinder or a sphere (there with the poles at both ends of every list along `v`), and
    /// `(M_u + 1) × (M_v + 1)` on a plane. Control points are rows with `v` fastest and include those beyond open edges. On a
    /// sphere they are `M_u × (M_v − 1)` rows, then the poles, then the handles of the north and the south pole: two for each on a
    /// `sphere`, one for each meridian on a `sharp_sphere`.
    Surface {
        /// Topology of the surface: the directions in which it closes.
        topology: Topology,
        /// How a torus is glued along `u`. Default: `straight`.
        #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Seam::is_straight"))]
        seam: Seam,
        /// `M_u` and `M_v`: number of control points along closed directions, number of intervals between knots along open ones.
        #[cfg_attr(feature = "schema", schema(min_items = 2, max_items = 2))]
        control_points: [usize; 2],
        /// Generators along `u` and `v`. Default: `trigonometric` along closed directions and from pole to pole, `cubic` along
        /// open ones.
        #[cfg_attr(feature = "schema", schema(required = false, min_items = 2, max_items = 2))]
        generators: [GeneratorKind; 2],
    },
    /// A closed triangle mesh in space whose faces are refined by a subdivision scheme. A shape is given by its control
    /// vertices, or by their positions on the refined mesh.
    Subdivision(Subdivision),
    /// Points without interpolation, in the discrete metric `Φ = I/N`.
    Landmarks {
        /// Dimension of the points: 2 or 3.
        #[cfg_attr(feature = "schema", schema(minimum = 2, maximum = 3))]
        dimension: usize,
        /// Number of landmarks. Minimum: 2.
        #[cfg_attr(feature = "schema", schema(minimum = 2))]
        points: usize,
    },
}

impl Representation {
    /// How often the control mesh can be split; `None` for shapes without one.
    pub fn most_splits(&self) -> Option<usize> {
        self.subdivision().map(|mesh| mesh.level)
    }

    /// Number of control points after so many splits of the control mesh.
    pub fn size_after(&self, splits: usize) -> usize {
        let mesh = self.subdivision().filter(|_| splits > 0);
        mesh.map_or_else(|| self.size(), |mesh| mesh.connectivity.size().split(splits).vertices)
    }

    /// The representation after one split of the control mesh; `None` where it has none to split.
    ///
    /// # Errors
    /// A control mesh that is not closed, or without rules.
    pub fn split(&self) -> Result<Option<Self>, GeometryError> {
        let finer = self.subdivision().map_or(Ok(None), Subdivision::finer)?;
        Ok(finer.map(|(finer, _)| Self::Subdivision(finer)))
    }

    /// Whether so many splits of the control mesh make another representation of this one.
    ///
    /// # Errors
    /// A control mesh that is not closed, or without rules.
    pub fn becomes(&self, wanted: &Self, splits: usize) -> Result<bool, GeometryError> {
        let mut found = self.clone();
        for left in (1..=splits).rev() {
            // A mesh of another size is not split: it may be of any size.
            let splits = found.most_splits().is_some() && found.size_after(left) == wanted.size();
            let Some(finer) = (if splits { found.split()? } else { None }) else { return Ok(false) };
            found = finer;
        }
        Ok(found == *wanted)
    }

    /// Dimension of the points, `d`.
    pub fn dimension(&self) -> usize {
        match self {
            Self::ClosedCurve { dimension, .. }
            | Self::OpenCurve { dimension, .. }
            | Self::Landmarks { dimension, .. } => *dimension,
            Self::Surface { .. } | Self::Subdivision(_) => 3,
        }
    }

    /// Number of rows of the matrix of control points, `N`.
    pub fn size(&self) -> usize {
        match self {
            Self::ClosedCurve { control_points, .. } => *control_points,
            Self::OpenCurve { intervals, generator, .. } => {
                let [before, after] = generator.beyond();
                intervals + 1 + before + after
            }
            Self::Landmarks { points, .. } => *points,
            Self::Surface { topology, control_points, generators, .. } => {
                let extent = Extent { topology: *topology, intervals: *control_points };
                extent.size([0, 1].map(|i| generators[i].beyond()))
            }
            Self::Subdivision(subdivision) => subdivision.connectivity.size().vertices,
        }
    }

    /// Number of points on the shape that determine it.
    pub fn point_count(&self) -> usize {
        match self {
            Self::OpenCurve { intervals, .. } => intervals + 1,
            Self::Surface { topology, control_points, .. } => {
                let [u, v] = Extent { topology: *topology, intervals: *control_points }.grid();
                u.saturating_mul(v)
            }
            _ => self.size(),
        }
    }

    /// The numbers that the client chose, one per direction.
    pub fn knots(&self) -> Vec<Knots<'_>> {
        let closed = |field, count, generator: &'_ GeneratorKind| {
            (field, count, generator.properties().fewest_control_points)
        };
        let open = |field, count, generator: &'_ GeneratorKind| {
            (field, count, generator.properties().fewest_intervals)
        };
        let one = |(field, count, fewest), generator, generator_field, closed| Knots {
            field,
            count,
            fewest,
            generator,
            generator_field,
            closed,
        };
        match self {
            Self::ClosedCurve { control_points, generator, .. } => vec![one(
                closed("control_points", *control_points, generator),
                Some(generator),
                "generator",
                true,
            )],
            Self::OpenCurve { intervals, generator, .. } => {
                vec![one(open("intervals", *intervals, generator), Some(generator), "generator", false)]
            }
            Self::Landmarks { points, .. } => vec![one(("points", *points, 2), None, "", false)],
            Self::Subdivision(_) => {
                vec![one(("connectivity", self.size(), MIN_VERTICES), None, "", false)]
            }
            Self::Surface { topology, control_points, generators, .. } => [0, 1]
                .map(|i| {
                    let field = ["control_points/0", "control_points/1"][i];
                    let (count, generator) = (control_points[i], &generators[i]);
                    let found = match topology {
                        // Half of a great circle, with special conditions at its ends.
                        Topology::Sphere if i == 1 => {
                            let fewest = generator.fewest_along_meridian();
                            let rings = sphere::MIN_ALONG_MERIDIAN + usize::from(generator.is_shifted());
                            (field, count, fewest.max(rings))
                        }
                        // Continued beyond its ends, as open lines are.
                        Topology::SharpSphere if i == 1 => {
                            let fewest = generator.fewest_along_meridian();
                            let poles = generator.properties().smoothness + 2;
                            let rings = sphere::MIN_ALONG_MERIDIAN + usize::from(generator.is_shifted());
                            (field, count, fewest.max(rings).max(poles - 1))
                        }
                        _ if topology.closed()[i] => closed(field, count, generator),
                        _ => open(field, count, generator),
                    };
                    let generator_field = ["generators/0", "generators/1"][i];
                    one(found, Some(generator), generator_field, topology.closed()[i])
                })
                .into(),
        }
    }

    /// Number of control points, intervals or landmarks along the first direction.
    pub fn count(&self) -> usize {
        self.knots()[0].count
    }

    /// Smallest valid number along the first direction.
    pub fn fewest(&self) -> usize {
        self.knots()[0].fewest
    }

    /// The same kind of curve with `count` control points or intervals; other shapes are unchanged.
    pub fn with_count(&self, count: usize) -> Self {
        let mut other = self.clone();
        match &mut other {
            Self::ClosedCurve { control_points, .. } => *control_points = count,
            Self::OpenCurve { intervals, .. } => *intervals = count,
            Self::Landmarks { .. } | Self::Surface { .. } | Self::Subdivision(_) => {}
        }
        other
    }

    /// The same kind of curve with another generator; other shapes are unchanged.
    pub fn with_generator(&self, kind: GeneratorKind) -> Self {
        let mut other = self.clone();
        match &mut other {
            Self::ClosedCurve { generator, .. } | Self::OpenCurve { generator, .. } => *generator = kind,
            Self::Landmarks { .. } | Self::Surface { .. } | Self::Subdivision(_) => {}
        }
        other
    }

    /// The generator, if the shape is a curve with a parameter that can be evaluated, measured and resampled.
    pub fn generator(&self) -> Option<&GeneratorKind> {
        match self {
            Self::ClosedCurve { generator, .. } | Self::OpenCurve { generator, .. } => Some(generator),
            Self::Landmarks { .. } | Self::Surface { .. } | Self::Subdivision(_) => None,
        }
    }

    /// Topology and size, if the shape is a tensor-product surface.
    pub fn extent(&self) -> Option<Extent> {
        match self {
            Self::Surface { topology, control_points, .. } => {
                Some(Extent { topology: *topology, intervals: *control_points })
            }
            _ => None,
        }
    }

    /// The control mesh with its scheme, if the shape is a subdivision surface.
    pub fn subdivision(&self) -> Option<&Subdivision> {
        match self {
            Self::Subdivision(subdivision) => Some(subdivision),
            _ => None,
        }
    }

    /// Whether the shape is a closed curve.
    pub fn is_closed(&self) -> bool {
        matches!(self, Self::ClosedCurve { .. })
    }
}

/// Number of vertices of the smallest closed mesh.
const MIN_VERTICES: usize = 4;

/// A number that the client chose, with its limits.
#[derive(Debug, Clone, Copy)]
pub struct Knots<'a> {
    /// Path of the field.
    pub field: &'static str,
    /// Number of control points, intervals or landmarks.
    pub count: usize,
    /// The smallest valid number.
    pub fewest: usize,
    /// The generator of the direction; `None` for landmarks.
    pub generator: Option<&'a GeneratorKind>,
    /// Path of the field of the generator.
    pub generator_field: &'static str,
    /// Whether the direction is closed.
    pub closed: bool,
}

/// A prepared representation: its basis and its Gram operator.
#[derive(Debug, Clone)]
pub struct ShapeSpace {
    representation: Representation,
    basis: Basis,
    gram: Arc<dyn SymmetricOperator>,
}

/// Basis whose coefficients are the control points.
#[derive(Debug, Clone)]
enum Basis {
    /// No basis: the control points are the shape.
    Points,
    /// Basis along one direction.
    Curve(Line),
    /// Basis along two directions.
    Surface(Arc<SurfaceBasis>),
    /// Refinement steps of a subdivision scheme.
    Subdivision(Arc<SubdivisionBasis>),
}

impl ShapeSpace {
    /// Prepares `representation`. Cost: as for its [`Line`], [`SurfaceBasis`] or [`SubdivisionBasis`].
    ///
    /// # Errors
    /// [`GeometryError::TooFewPoints`] below the minimum of the kind; errors of the generator or the control mesh.
    pub fn new(representation: &Representation) -> Result<Self, GeometryError> {
        for Knots { count: found, fewest: needed, .. } in representation.knots() {
            if found < needed {
                return Err(GeometryError::TooFewPoints { found, needed });
            }
        }
        let (basis, gram): (_, Arc<dyn SymmetricOperator>) = match representation {
            Representation::ClosedCurve { generator, .. } | Representation::OpenCurve { generator, .. } => {
                let line = Line::new(generator, representation.count(), representation.is_closed())?;
                let gram = line.gram().clone();
                (Basis::Curve(line), gram)
            }
            Representation::Surface { topology, seam, control_points, generators } => {
                let extent = Extent { topology: *topology, intervals: *control_points };
                let basis = SurfaceBasis::new(extent, *seam, generators)?;
                let gram = basis.gram().clone();
                (Basis::Surface(Arc::new(basis)), gram)
            }
            Representation::Subdivision(subdivision) => {
                let basis = SubdivisionBasis::new(subdivision)?;
                let gram = basis.gram().clone();
                (Basis::Subdivision(Arc::new(basis)), gram)
            }
            Representation::Landmarks { points, .. } => {
                (Basis::Points, Arc::new(ScaledIdentity::new(*points, 1.0 / *points as f64)))
            }
        };
        Ok(Self { representation: representation.clone(), basis, gram })
    }

    /// Shapes that are `points` points of `dimension` coordinates, without interpolation.
    ///
    /// # Errors
    /// As [`new`](Self::new).
    pub fn of_points(dimension: usize, points: usize) -> Result<Self, GeometryError> {
        Self::new(&Representation::Landmarks { dimension, points })
    }

    /// The representation of the space.
    pub fn representation(&self) -> &Representation {
        &self.representation
    }

    /// The basis, if the shapes are curves.
    pub fn line(&self) -> Option<&Line> {
        match &self.basis {
            Basis::Curve(line) => Some(line),
            _ => None,
        }
    }

    /// The basis, if the shapes are surfaces.
    pub fn surface(&self) -> Option<&SurfaceBasis> {
        self.shared_surface().map(Arc::as_ref)
    }

    /// The shared basis, if the shapes are surfaces.
    pub(crate) fn shared_surface(&self) -> Option<&Arc<SurfaceBasis>> {
        match &self.basis {
            Basis::Surface(basis) => Some(basis),
            _ => None,
        }
    }

    /// The refinement steps, if the shapes are subdivision surfaces.
    pub fn subdivision(&self) -> Option<&SubdivisionBasis> {
        match &self.basis {
            Basis::Subdivision(basis) => Some(basis),
            _ => None,
        }
    }

    /// The generator, if the shapes are curves.
    pub fn generator(&self) -> Option<&Generator> {
        self.line().map(Line::generator)
    }

    /// Whether constants are reproduced, so that moving all control points moves the shape.
    pub fn reproduces_constants(&self) -> bool {
        match &self.basis {
            // The rows of every step sum to one.
            Basis::Points | Basis::Subdivision(_) => true,
            Basis::Curve(line) => line.reproduces_constants(),
            Basis::Surface(basis) => basis.reproduces_constants(),
        }
    }

    /// Reverses `u` in one coordinate of the control points: `r(u)` becomes `r(−u)`, along open directions `r(1 − u)`.
    /// Landmarks and control meshes have no direction and are unchanged.
    pub fn reverse(&self, column: &mut [f64]) {
        match &self.basis {
            Basis::Points | Basis::Subdivision(_) => {}
            // u → −u keeps row 0.
            Basis::Curve(line) if line.is_closed() => column[1..].reverse(),
            Basis::Curve(_) => column.reverse(),
            Basis::Surface(basis) => basis.reverse(column),
        }
    }

    /// The motions of the parameters of surfaces that close, for cylinders and tori with reversals if `reverses`; `None` for other
    /// shapes.
    pub fn motions(&self, reverses: bool) -> Option<Motions> {
        self.surface().and_then(|basis| Motions::new(basis, reverses))
    }

    /// The Gram operator `Φ`.
    pub fn gram(&self) -> &Arc<dyn SymmetricOperator> {
        &self.gram
    }

    /// Control points of the shape that interpolates `points` at the knots: see [`Line::interpolate`],
    /// [`SurfaceBasis::interpolate`] and [`SubdivisionBasis::interpolate`].
    ///
    /// # Errors
    /// [`GeometryError::NoInterpolation`], for subdivision surfaces only.
    pub fn interpolate(&self, points: Matrix) -> Result<Matrix, GeometryError> {
        self.interpolate_with(points, &Tangents::default())
    }

    /// As [`Self::interpolate`], with the tangents of a surface at its poles; other shapes have none.
    ///
    /// # Errors
    /// As for [`Self::interpolate`]; [`GeometryError::Surface`] for smooth spheres of shifted splines, which have fewer rings than the
    /// points.
    pub fn interpolate_with(&self, points: Matrix, tangents: &Tangents) -> Result<Matrix, GeometryError> {
        match &self.basis {
            Basis::Points => Ok(points),
            Basis::Curve(line) => Ok(line.interpolate(points)),
            Basis::Surface(basis) if !basis.meets_points() => {
                let detail = "the points have one ring more than there are control points between the poles with \
                              \"shifted_exponential\": give control_points instead";
                Err(GeometryError::Surface { field: "generators/1", detail: detail.into() })
            }
            Basis::Surface(basis) => Ok(basis.interpolate(&points, tangents)),
            Basis::Subdivision(basis) => basis.interpolate(&points),
        }
    }
}
