//! What a shape is made of, and the space it lives in.
//!
//! ```text
//! closed   r(u) = Σ_{k<M} c[k] φ_per(M u − k),   φ_per(t) = Σ_n φ(t − nM)
//! open     r(u) = Σ_{k=−K}^{M+K} c[k] φ(M u − k),   K = ⌈support/2⌉ − 1
//! ```
//!
//! A shape is an `N × d` matrix of control points `c`. Its space brings one Gram operator `Φ`
//! (`N × N`), `⟨r, s⟩ = tr(cᵣᵀ Φ c_s)`; nothing above this layer knows how `Φ` is made.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::GeometryError;
use super::generator::{Generator, GeneratorKind};
use super::line::Line;
use super::open::phantoms;
use crate::numeric::dense::Matrix;
use crate::numeric::operator::{ScaledIdentity, SymmetricOperator};

/// Kind, dimension, size and generator: everything needed to read control points.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Representation {
    /// A closed spline curve in the plane or in space.
    ClosedCurve {
        /// 2 or 3.
        #[schema(minimum = 2, maximum = 3)]
        dimension: usize,
        /// Number of control points `N`, at least 3.
        #[schema(minimum = 3)]
        control_points: usize,
        /// The generator of the curve.
        generator: GeneratorKind,
    },
    /// An open spline curve in the plane or in space, on `u ∈ [0, 1]`. A shape is `M + 1` points on the curve, or all
    /// `M + 1 + 2K` control points with those beyond its ends.
    OpenCurve {
        /// 2 or 3.
        #[schema(minimum = 2, maximum = 3)]
        dimension: usize,
        /// Number of intervals `M` between knots.
        #[schema(minimum = 1)]
        intervals: usize,
        /// The generator of the curve.
        generator: GeneratorKind,
    },
    /// Points without interpolation, in the discrete metric `Φ = I/N`.
    Landmarks {
        /// 2 or 3.
        #[schema(minimum = 2, maximum = 3)]
        dimension: usize,
        /// Number of landmarks, at least 2.
        #[schema(minimum = 2)]
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
        }
    }

    /// `N`, the rows of the matrix of control points.
    pub fn size(&self) -> usize {
        match self {
            Self::ClosedCurve { control_points, .. } => *control_points,
            Self::OpenCurve { intervals, generator, .. } => intervals + 1 + 2 * phantoms(generator.support()),
            Self::Landmarks { points, .. } => *points,
        }
    }

    /// Number of points on the shape that determine it.
    pub fn point_count(&self) -> usize {
        match self {
            Self::OpenCurve { intervals, .. } => intervals + 1,
            _ => self.size(),
        }
    }

    /// The number that the client chose: control points, intervals or landmarks.
    pub fn count(&self) -> usize {
        match self {
            Self::OpenCurve { intervals, .. } => *intervals,
            _ => self.size(),
        }
    }

    /// The smallest such number.
    pub fn fewest(&self) -> usize {
        match self {
            Self::ClosedCurve { generator, .. } => generator.properties().fewest_control_points,
            Self::OpenCurve { generator, .. } => generator.properties().fewest_intervals,
            Self::Landmarks { .. } => 2,
        }
    }

    /// Its field, for messages.
    pub fn count_field(&self) -> &'static str {
        match self {
            Self::ClosedCurve { .. } => "control_points",
            Self::OpenCurve { .. } => "intervals",
            Self::Landmarks { .. } => "points",
        }
    }

    /// The same kind of curve with another number; landmarks stay as they are.
    pub fn with_count(&self, count: usize) -> Self {
        let mut other = self.clone();
        match &mut other {
            Self::ClosedCurve { control_points, .. } => *control_points = count,
            Self::OpenCurve { intervals, .. } => *intervals = count,
            Self::Landmarks { .. } => {}
        }
        other
    }

    /// The same kind of curve with another generator; landmarks stay as they are.
    pub fn with_generator(&self, kind: GeneratorKind) -> Self {
        let mut other = self.clone();
        match &mut other {
            Self::ClosedCurve { generator, .. } | Self::OpenCurve { generator, .. } => *generator = kind,
            Self::Landmarks { .. } => {}
        }
        other
    }

    /// The generator, when the shape is a curve with a parameter: to be evaluated, measured and resampled.
    pub fn generator(&self) -> Option<&GeneratorKind> {
        match self {
            Self::ClosedCurve { generator, .. } | Self::OpenCurve { generator, .. } => Some(generator),
            Self::Landmarks { .. } => None,
        }
    }

    /// Whether the shape is a closed curve.
    pub fn is_closed(&self) -> bool {
        matches!(self, Self::ClosedCurve { .. })
    }
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
}

impl ShapeSpace {
    /// Prepares `representation`. Cost: that of its [`Line`].
    ///
    /// # Errors
    /// [`GeometryError::TooFewPoints`] below the fewest points of the kind; errors of the generator.
    pub fn new(representation: &Representation) -> Result<Self, GeometryError> {
        let (found, needed) = (representation.count(), representation.fewest());
        if found < needed {
            return Err(GeometryError::TooFewPoints { found, needed });
        }
        let (basis, gram): (_, Arc<dyn SymmetricOperator>) = match representation {
            Representation::ClosedCurve { generator, .. } | Representation::OpenCurve { generator, .. } => {
                let line = Line::new(generator, found, representation.is_closed())?;
                let gram = line.gram().clone();
                (Basis::Curve(line), gram)
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
            Basis::Points => None,
        }
    }

    /// The generator, when the shapes are curves.
    pub fn generator(&self) -> Option<&Generator> {
        self.line().map(Line::generator)
    }

    /// Whether moving all control points moves the shape: constants are reproduced.
    pub fn reproduces_constants(&self) -> bool {
        match &self.basis {
            Basis::Points => true,
            Basis::Curve(line) => line.reproduces_constants(),
        }
    }

    /// The Gram operator `Φ`.
    pub fn gram(&self) -> &Arc<dyn SymmetricOperator> {
        &self.gram
    }

    /// Control points of the shape that passes through `points` at the knots: see [`Line::interpolate`].
    pub fn interpolate(&self, points: Matrix) -> Matrix {
        match &self.basis {
            Basis::Points => points,
            Basis::Curve(line) => line.interpolate(points),
        }
    }
}
