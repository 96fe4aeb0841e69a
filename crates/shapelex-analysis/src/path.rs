//! Paths between two shapes.
//!
//! ```text
//! plane   c(τ) = (1 − τ) c_1 + τ c_2
//! sphere  r(τ) = sin((1 − τ)θ)/sin θ · r_1/‖r_1‖ + sin(τθ)/sin θ · r_2/‖r_2‖,   θ = arccos ⟨r_1, r_2⟩/(‖r_1‖‖r_2‖)
//! ```
//!
//! `τ = 0` is the first shape, `τ = 1` the second; other values extrapolate. Both paths are linear in the shapes and can
//! be formed from control points; only `θ` and the norms need the metric.
//!
//! Source: Schmitter 2017, (7.14)–(7.18); (7.17) presumes unit norms, and the directions of (7.16) and (7.18) differ.

use super::AnalysisError;
use super::metric::Metric;

/// Angle below which the path is straight to working precision.
const FLAT: f64 = 1e-7;

/// Distance from `π` below which the great circle between two shapes is not determined.
const ANTIPODAL: f64 = 1e-7;

/// Kind of path between two shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case"))]
pub enum PathKind {
    /// Straight line `(1 − τ) r_1 + τ r_2`.
    #[default]
    Plane,
    /// Great circle between the shapes scaled to unit `L₂` norm.
    Sphere,
}

/// Positions on a path.
#[derive(Debug, Clone, PartialEq)]
pub enum Positions {
    /// Equally spaced from 0 to 1, at least two.
    Steps(usize),
    /// The given positions.
    At(Vec<f64>),
}

impl Positions {
    /// Number of positions.
    pub fn count(&self) -> usize {
        match self {
            Self::At(list) => list.len(),
            Self::Steps(count) => *count,
        }
    }

    /// All positions.
    pub fn list(self) -> Vec<f64> {
        match self {
            Self::At(list) => list,
            Self::Steps(count) => (0..count).map(|i| i as f64 / (count - 1) as f64).collect(),
        }
    }
}

/// A path from `first` to `second`, both `d·N` coordinate-major control points.
#[derive(Debug, Clone)]
pub struct Path {
    first: Vec<f64>,
    second: Vec<f64>,
    /// `θ` on the sphere, `None` in the plane.
    angle: Option<f64>,
}

impl Path {
    /// The path of a kind.
    ///
    /// # Errors
    /// As [`Self::sphere`].
    pub fn new(
        kind: PathKind,
        metric: &Metric,
        first: Vec<f64>,
        second: Vec<f64>,
    ) -> Result<Self, AnalysisError> {
        match kind {
            PathKind::Plane => Ok(Self::plane(first, second)),
            PathKind::Sphere => Self::sphere(metric, first, second),
        }
    }

    /// The straight path.
    pub fn plane(first: Vec<f64>, second: Vec<f64>) -> Self {
        Self { first, second, angle: None }
    }

    /// The great circle between the unit-norm shapes.
    ///
    /// # Errors
    /// [`AnalysisError::NoExtent`] for a shape of norm zero (index 0 for the first, 1 for the second),
    /// [`AnalysisError::Antipodal`] if the shapes are opposite.
    pub fn sphere(metric: &Metric, mut first: Vec<f64>, mut second: Vec<f64>) -> Result<Self, AnalysisError> {
        for (index, shape) in [&mut first, &mut second].into_iter().enumerate() {
            let norm = metric.inner(shape, shape).sqrt();
            if !(norm > 0.0) {
                return Err(AnalysisError::NoExtent { index, norm, size: norm });
            }
            shape.iter_mut().for_each(|value| *value /= norm);
        }
        let angle = metric.inner(&first, &second).clamp(-1.0, 1.0).acos();
        if angle > std::f64::consts::PI - ANTIPODAL {
            return Err(AnalysisError::Antipodal { angle });
        }
        Ok(Self { first, second, angle: Some(angle) })
    }

    /// `θ` in radians; `None` in the plane.
    pub fn angle(&self) -> Option<f64> {
        self.angle
    }

    /// Control points at `τ`.
    pub fn at(&self, tau: f64) -> Vec<f64> {
        let (a, b) = match self.angle {
            Some(angle) if angle > FLAT => {
                (((1.0 - tau) * angle).sin() / angle.sin(), (tau * angle).sin() / angle.sin())
            }
            _ => (1.0 - tau, tau),
        };
        self.first.iter().zip(&self.second).map(|(x, y)| a * x + b * y).collect()
    }
}
