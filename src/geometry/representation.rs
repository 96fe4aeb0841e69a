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
use super::generator::{Generator, GeneratorKind, Poles};
use super::open::{OpenInterpolation, open_gram, phantoms};
use crate::numeric::NumericError;
use crate::numeric::banded::Banded;
use crate::numeric::circulant::Circulant;
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

/// A representation made ready: the generator, the Gram operator and the interpolation at the knots.
#[derive(Debug, Clone)]
pub struct ShapeSpace {
    representation: Representation,
    generator: Option<Arc<Generator>>,
    poles: Poles,
    gram: Arc<dyn SymmetricOperator>,
    interpolation: Interpolation,
}

/// From points at the knots to control points.
#[derive(Debug, Clone)]
enum Interpolation {
    /// They are equal.
    Equal,
    /// The samples are a circulant operator on the control points.
    Circulant(Circulant),
    /// Open curves.
    Open(Arc<OpenInterpolation>),
}

impl ShapeSpace {
    /// Prepares `representation`. Cost: one generator, once, and two FFTs of length `N` (closed) or a banded
    /// factorisation (open).
    ///
    /// # Errors
    /// [`GeometryError::TooFewPoints`] below the fewest points of the kind; errors of the generator.
    pub fn new(representation: &Representation) -> Result<Self, GeometryError> {
        let (found, needed) = (representation.count(), representation.fewest());
        if found < needed {
            return Err(GeometryError::TooFewPoints { found, needed });
        }
        let Some(kind) = representation.generator() else {
            let n = representation.size();
            return Ok(Self {
                representation: representation.clone(),
                generator: None,
                poles: Poles::zeros(1),
                gram: Arc::new(ScaledIdentity::new(n, 1.0 / n as f64)),
                interpolation: Interpolation::Equal,
            });
        };
        let built = kind.build(found)?;
        let (generator, interpolating) = (built.generator.clone(), kind.properties().interpolating);
        let (gram, interpolation): (Arc<dyn SymmetricOperator>, _) = if representation.is_closed() {
            let interpolation = if interpolating {
                Interpolation::Equal
            } else {
                Interpolation::Circulant(Circulant::new(&sampling_row(&generator, found)).map_err(dependent)?)
            };
            let gram = Circulant::new(&gram_row(&generator, found, 0, 0)).map_err(dependent)?;
            (Arc::new(gram), interpolation)
        } else {
            let open = OpenInterpolation::new(&generator, &built.poles, found, interpolating);
            let gram = Banded::new(open_gram(&generator, found, 0)).map_err(dependent)?;
            (Arc::new(gram), Interpolation::Open(Arc::new(open.map_err(dependent)?)))
        };
        Ok(Self {
            representation: representation.clone(),
            generator: Some(generator),
            poles: built.poles.clone(),
            gram,
            interpolation,
        })
    }

    /// What was prepared.
    pub fn representation(&self) -> &Representation {
        &self.representation
    }

    /// The generator, when the shapes are curves.
    pub fn generator(&self) -> Option<&Generator> {
        self.generator.as_deref()
    }

    /// The poles of the functions that the generator reproduces, on the grid of the knots.
    pub fn poles(&self) -> &Poles {
        &self.poles
    }

    /// Whether moving all control points moves the shape: constants are reproduced.
    pub fn reproduces_constants(&self) -> bool {
        self.poles.zeros > 0
    }

    /// The Gram operator `Φ`.
    pub fn gram(&self) -> &Arc<dyn SymmetricOperator> {
        &self.gram
    }

    /// Control points of the shape that passes through `points` (`N × d`, `(M + 1) × d` for open curves) at the
    /// knots `u = k/M`.
    ///
    /// The points themselves for interpolating generators, a circulant solve otherwise; open curves extend by
    /// annihilation beyond their ends.
    pub fn interpolate(&self, mut points: Matrix) -> Matrix {
        match &self.interpolation {
            Interpolation::Equal => points,
            Interpolation::Circulant(sampling) => {
                sampling.solve(points.as_mut_slice());
                points
            }
            Interpolation::Open(open) => open.interpolate(&points),
        }
    }
}

/// An operator that is not definite to working precision means dependent shifts.
fn dependent(error: NumericError) -> GeometryError {
    match error {
        NumericError::NotPositiveDefinite { size, smallest } => GeometryError::Dependent { size, smallest },
        other => other.into(),
    }
}

/// First row of the circulant `∫₀¹ φ_0^(d₁)(u) φ_k^(d₂)(u) du = N^{d₁+d₂−1} Σ_n a_{d₁d₂}[k + nN]`.
///
/// `d₁ + d₂` must be even, else the row belongs to an antisymmetric matrix.
pub fn gram_row(generator: &Generator, n: usize, d1: usize, d2: usize) -> Vec<f64> {
    let reach = generator.support() as isize - 1;
    let factor = (n as f64).powi((d1 + d2) as i32 - 1);
    let mut row = vec![0.0; n];
    for m in -reach..=reach {
        row[m.rem_euclid(n as isize) as usize] += factor * generator.correlation(d1, d2, m);
    }
    row
}

/// `b[k mod N] += φ(k)`: the samples at the knots are this circulant times the control points.
fn sampling_row(generator: &Generator, n: usize) -> Vec<f64> {
    let reach = generator.support() as isize / 2;
    let mut row = vec![0.0; n];
    for k in -reach..=reach {
        row[k.rem_euclid(n as isize) as usize] += generator.evaluate(k as f64, 0);
    }
    row
}
