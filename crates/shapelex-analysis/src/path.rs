//! Paths between two shapes.
//!
//! ```text
//! plane   c(τ) = (1 − τ) c_1 + τ c_2
//! sphere  r(τ) = sin((1 − τ)θ)/sin θ · r_1/‖r_1‖ + sin(τθ)/sin θ · r_2/‖r_2‖,   θ = arccos ⟨r_1, r_2⟩/(‖r_1‖‖r_2‖)
//! ```
//!
//! `τ = 0` is the first shape, `τ = 1` the second, others extrapolate. Both are linear in the shapes, so they may
//! be formed from control points; only `θ` and the norms need the metric.
//!
//! Source: Schmitter 2017, (7.14)–(7.18); (7.17) presumes unit norms, and the directions of (7.16) and (7.18) differ.

use super::AnalysisError;
use super::metric::Metric;

/// Angles below this are a straight line to working precision.
const FLAT: f64 = 1e-7;

/// Between antipodes the great circle is not determined.
const ANTIPODAL: f64 = 1e-7;

/// A path from `first` to `second`, both `d·N` coordinate-major control points.
#[derive(Debug, Clone)]
pub struct Path {
    first: Vec<f64>,
    second: Vec<f64>,
    /// `θ` on the sphere, none in the plane.
    angle: Option<f64>,
}

impl Path {
    /// The straight path.
    pub fn plane(first: Vec<f64>, second: Vec<f64>) -> Self {
        Self { first, second, angle: None }
    }

    /// The great circle between the unit-norm shapes.
    ///
    /// # Errors
    /// [`AnalysisError::NoExtent`] for a shape of norm zero (0 the first, 1 the second),
    /// [`AnalysisError::Antipodal`] when the shapes are opposite.
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

    /// `θ` in radians, on the sphere.
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
