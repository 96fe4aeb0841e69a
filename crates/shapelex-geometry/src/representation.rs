//! What a shape is made of, and the space it lives in.
//!
//! ```text
//! closed   r(u) = Σ_{k<M} c[k] φ_per(M u − k),   φ_per(t) = Σ_n φ(t − nM)
//! open     r(u) = Σ_{k=−K}^{M+K} c[k] φ(M u − k),   K = ⌈support/2⌉ − 1
//! surface  σ(u, v) = Σ_{k,l} c[k, l] φ_u(M_u u − k) φ_v(M_v v − l)
//! subdivision  X = S_{K−1} ⋯ S_0 c
//! ```
//!
//! A shape is an `N × d` matrix of control points `c`. Its space brings one Gram operator `Φ`
//! (`N × N`), `⟨r, s⟩ = tr(cᵣᵀ Φ c_s)`; nothing above this layer knows how `Φ` is made.

use std::sync::Arc;

use super::GeometryError;
use super::generator::{Generator, GeneratorKind};
use super::line::Line;
use super::open::phantoms;
use super::subdivision::Subdivision;
use super::subdivision::basis::SubdivisionBasis;
use super::surface::basis::{Extent, SurfaceBasis, Tangents};
use super::surface::seam::Seam;
use super::surface::{Topology, sphere};
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::operator::{ScaledIdentity, SymmetricOperator};

/// Kind, dimension, size and generator: everything needed to read control points.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields))]
pub enum Representation {
    /// A closed spline curve in the plane or in space.
    ClosedCurve {
        /// 2 or 3.
        #[cfg_attr(feature = "schema", schema(minimum = 2, maximum = 3))]
        dimension: usize,
        /// Number of control points `N`, at least 3.
        #[cfg_attr(feature = "schema", schema(minimum = 3))]
        control_points: usize,
        /// The generator of the curve.
        generator: GeneratorKind,
    },
    /// An open spline curve in the plane or in space, on `u ∈ [0, 1]`. A shape is `M + 1` points on the curve, or all
    /// `M + 1 + 2K` control points with those beyond its ends.
    OpenCurve {
        /// 2 or 3.
        #[cfg_attr(feature = "schema", schema(minimum = 2, maximum = 3))]
        dimension: usize,
        /// Number of intervals `M` between knots.
        #[cfg_attr(feature = "schema", schema(minimum = 1))]
        intervals: usize,
        /// The generator of the curve.
        generator: GeneratorKind,
    },
    /// A tensor-product surface in space. A shape is a grid of points on it, `[u][v][x, y, z]`: `M_u × M_v` on a torus,
    /// `M_u × (M_v + 1)` on a cylinder, and on a sphere with its poles at both ends of every `v`, `(M_u + 1) × (M_v + 1)` on a
    /// plane. Its control points are rows with `v` fastest, those beyond open edges included; on a sphere
    /// `M_u × (M_v − 1)`, then the poles, and the handles of the north and of the south.
    Surface {
        /// How it closes.
        topology: Topology,
        /// How a torus is glued along `u`; `straight` unless given.
        #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Seam::is_straight"))]
        seam: Seam,
        /// `M_u` and `M_v`: control points along closed directions, intervals between knots along open ones.
        control_points: [usize; 2],
        /// The generators along `u` and `v`; `trigonometric` along closed directions and from pole to pole, `keys` along open
        /// ones unless given.
        generators: [GeneratorKind; 2],
    },
    /// A closed triangle mesh in space whose faces are refined by a subdivision scheme. A shape is its control vertices, or where
    /// these are on the refined mesh.
    Subdivision(Subdivision),
    /// Points without interpolation, in the discrete metric `Φ = I/N`.
    Landmarks {
        /// 2 or 3.
        #[cfg_attr(feature = "schema", schema(minimum = 2, maximum = 3))]
        dimension: usize,
        /// Number of landmarks, at least 2.
        #[cfg_attr(feature = "schema", schema(minimum = 2))]
        points: usize,
    },
}

impl Representation {
    /// `d`.
    pub fn dimension(&self) -> usize {
        match self {
            Self::ClosedCurve { dimension, .. }
            | Self::OpenCurve { dimension, .. }
            | Self::Landmarks { dimension, .. } => *dimension,
            Self::Surface { .. } | Self::Subdivision(_) => 3,
        }
    }

    /// `N`, the rows of the matrix of control points.
    pub fn size(&self) -> usize {
        match self {
            Self::ClosedCurve { control_points, .. } => *control_points,
            Self::OpenCurve { intervals, generator, .. } => intervals + 1 + 2 * phantoms(generator.support()),
            Self::Landmarks { points, .. } => *points,
            Self::Surface { topology, control_points, generators, .. } => {
                let extent = Extent { topology: *topology, intervals: *control_points };
                extent.size([0, 1].map(|i| generators[i].support()))
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

    /// The numbers that the client chose, one a direction.
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
                vec![one(("connectivity", self.size(), FEWEST_VERTICES), None, "", false)]
            }
            Self::Surface { topology, control_points, generators, .. } => [0, 1]
                .map(|i| {
                    let field = ["control_points/0", "control_points/1"][i];
                    let (count, generator) = (control_points[i], &generators[i]);
                    let found = match topology {
                        // Half a great circle, with conditions of its own at its ends.
                        Topology::Sphere if i == 1 => {
                            let (field, count, around) = closed(field, count, generator);
                            (field, count, around.div_ceil(2).max(sphere::FEWEST_ALONG_MERIDIAN))
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

    /// The number of the first direction.
    pub fn count(&self) -> usize {
        self.knots()[0].count
    }

    /// The fewest that the first direction takes.
    pub fn fewest(&self) -> usize {
        self.knots()[0].fewest
    }

    /// The same kind of curve with another number; other shapes stay as they are.
    pub fn with_count(&self, count: usize) -> Self {
        let mut other = self.clone();
        match &mut other {
            Self::ClosedCurve { control_points, .. } => *control_points = count,
            Self::OpenCurve { intervals, .. } => *intervals = count,
            Self::Landmarks { .. } | Self::Surface { .. } | Self::Subdivision(_) => {}
        }
        other
    }

    /// The same kind of curve with another generator; other shapes stay as they are.
    pub fn with_generator(&self, kind: GeneratorKind) -> Self {
        let mut other = self.clone();
        match &mut other {
            Self::ClosedCurve { generator, .. } | Self::OpenCurve { generator, .. } => *generator = kind,
            Self::Landmarks { .. } | Self::Surface { .. } | Self::Subdivision(_) => {}
        }
        other
    }

    /// The generator, when the shape is a curve with a parameter: to be evaluated, measured and resampled.
    pub fn generator(&self) -> Option<&GeneratorKind> {
        match self {
            Self::ClosedCurve { generator, .. } | Self::OpenCurve { generator, .. } => Some(generator),
            Self::Landmarks { .. } | Self::Surface { .. } | Self::Subdivision(_) => None,
        }
    }

    /// The numbers of a surface.
    pub fn extent(&self) -> Option<Extent> {
        match self {
            Self::Surface { topology, control_points, .. } => {
                Some(Extent { topology: *topology, intervals: *control_points })
            }
            _ => None,
        }
    }

    /// The control mesh and its scheme.
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

/// Vertices of the smallest closed mesh.
const FEWEST_VERTICES: usize = 4;

/// A number that the client chose, and what depends on it.
#[derive(Debug, Clone, Copy)]
pub struct Knots<'a> {
    /// Where it stands.
    pub field: &'static str,
    /// Control points, intervals or landmarks.
    pub count: usize,
    /// The smallest such number.
    pub fewest: usize,
    /// The generator of the direction; landmarks have none.
    pub generator: Option<&'a GeneratorKind>,
    /// Where it stands.
    pub generator_field: &'static str,
    /// Whether the end is the start.
    pub closed: bool,
}

/// A representation made ready: its basis and the Gram operator.
#[derive(Debug, Clone)]
pub struct ShapeSpace {
    representation: Representation,
    basis: Basis,
    gram: Arc<dyn SymmetricOperator>,
}

/// What control points are the coefficients of.
#[derive(Debug, Clone)]
enum Basis {
    /// Nothing: they are the shape.
    Points,
    /// One direction.
    Curve(Line),
    /// Two directions.
    Surface(Arc<SurfaceBasis>),
    /// The steps of a scheme.
    Subdivision(Arc<SubdivisionBasis>),
}

impl ShapeSpace {
    /// Prepares `representation`. Cost: that of its [`Line`], [`SurfaceBasis`] or [`SubdivisionBasis`].
    ///
    /// # Errors
    /// [`GeometryError::TooFewPoints`] below the fewest points of the kind; errors of the generator or the control mesh.
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

    /// What was prepared.
    pub fn representation(&self) -> &Representation {
        &self.representation
    }

    /// The basis, when the shapes are curves.
    pub fn line(&self) -> Option<&Line> {
        match &self.basis {
            Basis::Curve(line) => Some(line),
            _ => None,
        }
    }

    /// The basis, when the shapes are surfaces.
    pub fn surface(&self) -> Option<&SurfaceBasis> {
        match &self.basis {
            Basis::Surface(basis) => Some(basis),
            _ => None,
        }
    }

    /// The steps of the scheme, when the shapes are subdivision surfaces.
    pub fn subdivision(&self) -> Option<&SubdivisionBasis> {
        match &self.basis {
            Basis::Subdivision(basis) => Some(basis),
            _ => None,
        }
    }

    /// The generator, when the shapes are curves.
    pub fn generator(&self) -> Option<&Generator> {
        self.line().map(Line::generator)
    }

    /// Whether moving all control points moves the shape: constants are reproduced.
    pub fn reproduces_constants(&self) -> bool {
        match &self.basis {
            // The rows of every step sum to one.
            Basis::Points | Basis::Subdivision(_) => true,
            Basis::Curve(line) => line.reproduces_constants(),
            Basis::Surface(basis) => basis.reproduces_constants(),
        }
    }

    /// Runs through `u` backwards: `r(u)` becomes `r(−u)`, along open directions `r(1 − u)`. Of one coordinate of control
    /// points; landmarks and control meshes, which have no direction, stay as they are.
    pub fn reverse(&self, column: &mut [f64]) {
        match &self.basis {
            Basis::Points | Basis::Subdivision(_) => {}
            // −n keeps row 0.
            Basis::Curve(line) if line.is_closed() => column[1..].reverse(),
            Basis::Curve(_) => column.reverse(),
            Basis::Surface(basis) => basis.reverse(column),
        }
    }

    /// The Gram operator `Φ`.
    pub fn gram(&self) -> &Arc<dyn SymmetricOperator> {
        &self.gram
    }

    /// Control points of the shape that passes through `points` at the knots: see [`Line::interpolate`],
    /// [`SurfaceBasis::interpolate`] and [`SubdivisionBasis::interpolate`].
    ///
    /// # Errors
    /// Only of subdivision surfaces: [`GeometryError::NoInterpolation`].
    pub fn interpolate(&self, points: Matrix) -> Result<Matrix, GeometryError> {
        match &self.basis {
            Basis::Points => Ok(points),
            Basis::Curve(line) => Ok(line.interpolate(points)),
            Basis::Surface(basis) => Ok(basis.interpolate(&points, &Tangents::default())),
            Basis::Subdivision(basis) => basis.interpolate(&points),
        }
    }
}
