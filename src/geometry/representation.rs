//! What a shape is made of, and the space it lives in.
//!
//! ```text
//! r(u) = Σ_{k<N} c[k] φ_per(N u − k),   u ∈ [0, 1),   φ_per(t) = Σ_n φ(t − nN)
//! ```
//!
//! A shape is an `N × d` matrix of control points `c`. Its space brings one Gram operator `Φ`
//! (`N × N`), `⟨r, s⟩ = tr(cᵣᵀ Φ c_s)`; nothing above this layer knows how `Φ` is made.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::GeometryError;
use super::generator::{Generator, GeneratorKind};
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
            Self::ClosedCurve { dimension, .. } | Self::Landmarks { dimension, .. } => *dimension,
        }
    }

    /// `N`.
    pub fn size(&self) -> usize {
        match self {
            Self::ClosedCurve { control_points, .. } => *control_points,
            Self::Landmarks { points, .. } => *points,
        }
    }

    /// Fewest points of the kind.
    pub fn fewest(&self) -> usize {
        match self {
            Self::ClosedCurve { generator, .. } => generator.properties().fewest_control_points,
            Self::Landmarks { .. } => 2,
        }
    }

    /// Whether the shape is a curve with a parameter, to be evaluated, measured and resampled.
    pub fn is_curve(&self) -> bool {
        matches!(self, Self::ClosedCurve { .. })
    }

    /// Field of the size, for messages.
    pub fn size_field(&self) -> &'static str {
        match self {
            Self::ClosedCurve { .. } => "control_points",
            Self::Landmarks { .. } => "points",
        }
    }
}

/// A representation made ready: the generator, the Gram operator and the interpolation filter.
#[derive(Debug, Clone)]
pub struct ShapeSpace {
    representation: Representation,
    generator: Option<Generator>,
    gram: Arc<dyn SymmetricOperator>,
    /// Samples at the knots as a circulant operator on control points; none when they are equal.
    sampling: Option<Circulant>,
}

impl ShapeSpace {
    /// Prepares `representation`. Cost: one generator (`~20 µs`) and two FFTs of length `N`.
    ///
    /// # Errors
    /// [`GeometryError::TooFewPoints`] below the fewest points of the kind.
    pub fn new(representation: &Representation) -> Result<Self, GeometryError> {
        let (found, needed) = (representation.size(), representation.fewest());
        if found < needed {
            return Err(GeometryError::TooFewPoints { found, needed });
        }
        let (generator, gram, sampling): (_, Arc<dyn SymmetricOperator>, _) = match representation {
            Representation::ClosedCurve { control_points, generator: kind, .. } => {
                let generator = kind.build(*control_points)?;
                let gram = Circulant::new(&gram_row(&generator, *control_points, 0, 0))?;
                let sampling = (!kind.properties().interpolating)
                    .then(|| Circulant::new(&sampling_row(&generator, *control_points)))
                    .transpose()?;
                (Some(generator), Arc::new(gram), sampling)
            }
            Representation::Landmarks { points, .. } => {
                (None, Arc::new(ScaledIdentity::new(*points, 1.0 / *points as f64)), None)
            }
        };
        Ok(Self { representation: representation.clone(), generator, gram, sampling })
    }

    /// What was prepared.
    pub fn representation(&self) -> &Representation {
        &self.representation
    }

    /// The generator, when the shapes are curves.
    pub fn generator(&self) -> Option<&Generator> {
        self.generator.as_ref()
    }

    /// The Gram operator `Φ`.
    pub fn gram(&self) -> &Arc<dyn SymmetricOperator> {
        &self.gram
    }

    /// Control points of the shape that passes through `points` (`N × d`) at the knots `u = k/N`.
    ///
    /// The points themselves for interpolating generators, a circulant solve otherwise.
    pub fn interpolate(&self, mut points: Matrix) -> Matrix {
        if let Some(sampling) = &self.sampling {
            sampling.solve(points.as_mut_slice());
        }
        points
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
