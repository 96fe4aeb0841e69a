//! The shape prior: distance from the class of a reference.
//!
//! ```text
//! E_prior = ‖c − c*‖²/V^{2/d},   c* = nearest member of the class of the reference
//! ∂E = 2Ψ(c − c*)/V^{2/d} − (2/d) E ∂V/V
//! ```
//!
//! `c*` is `P c` for linear classes and a Procrustes fit for rotations of space; by the envelope theorem its change does not
//! enter the gradient. Without the division by the volume, the term would pull every shape towards a point.
//!
//! Equal parameters are compared: the first shape should be the posed reference. The affine class contains reflections and flat
//! shapes.

use shapelex_analysis::AnalysisError;
use shapelex_analysis::alignment::{Method, Projector};
use shapelex_analysis::metric::Metric;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::sparse::SparseRows;

use super::shape::{Shape, forbidden};
use crate::boundary::Differential;
use crate::frame::Frame;

/// Squared distance from the class of a reference, relative to the size of the shape.
#[derive(Debug, Clone)]
pub struct Prior<const D: usize> {
    metric: Metric,
    method: Method,
    /// Control points of the reference, coordinate-major.
    reference: Vec<f64>,
    /// From free points to the control points of the metric, and the transpose; `None` if they are the same.
    lift: Option<[SparseRows; 2]>,
    frame: Frame<D>,
}

impl<const D: usize> Prior<D> {
    /// Prepares a reference, given by its control points in the world.
    ///
    /// # Errors
    /// [`AnalysisError`] if the reference has no extent, or less than the class needs.
    pub fn new(
        metric: Metric,
        method: Method,
        reference: &[[f64; D]],
        lift: Option<SparseRows>,
        frame: Frame<D>,
    ) -> Result<Self, AnalysisError> {
        let reference = columns(reference);
        Projector::new(&metric, &method, reference.clone()).project(reference.clone())?;
        let lift = lift.map(|lift| [lift.clone(), lift.transpose()]);
        Ok(Self { metric, method, reference, lift, frame })
    }

    /// The squared distance `‖c − c*‖²` and its gradient, before the division by the size. `None` for degenerate shapes.
    pub fn squared_distance(&self, rows: &[[f64; D]]) -> Option<Differential<D>> {
        let lifted = self.lift.as_ref().map(|[lift, _]| lift.apply(rows));
        let world: Vec<[f64; D]> =
            lifted.as_deref().unwrap_or(rows).iter().map(|point| self.frame.to_world(*point)).collect();
        let shape = columns(&world);
        let projector = Projector::new(&self.metric, &self.method, shape.clone());
        let nearest = projector.project(self.reference.clone()).ok()?;
        let mut residual: Vec<f64> = shape.iter().zip(&nearest.control_points).map(|(c, p)| c - p).collect();
        let value = self.metric.inner(&residual, &residual);
        self.metric.apply(&mut residual);
        let n = self.metric.size();
        let slope = |i: usize| self.frame.turn_back(std::array::from_fn(|c| 2.0 * residual[c * n + i]));
        let gradient: Vec<[f64; D]> = (0..n).map(slope).collect();
        let gradient = match &self.lift {
            Some([_, transpose]) => transpose.apply(&gradient),
            None => gradient,
        };
        Some(Differential { value, gradient })
    }

    /// Second derivatives of the squared distance over `V^{2/d}`, with the volume held fixed: exact for linear classes, whose
    /// gradients are linear, and a difference over one cell for others. Zero for degenerate shapes.
    pub(super) fn curvature(&self, shape: &Shape<'_, D>) -> Matrix {
        let size = D * shape.rows.len();
        let scale = shape.volume.value.abs().powf(-2.0 / D as f64);
        let slopes = |rows: &[[f64; D]]| self.squared_distance(rows).map(|found| found.gradient.concat());
        let mut sum = Matrix::zeros(size, size);
        let Some(here) = slopes(shape.rows) else { return sum };
        let mut rows = shape.rows.to_vec();
        for column in 0..size {
            rows[column / D][column % D] += 1.0;
            let moved = slopes(&rows).unwrap_or_else(|| here.clone());
            rows[column / D][column % D] -= 1.0;
            (0..size).for_each(|row| sum[(row, column)] = scale * (moved[row] - here[row]));
        }
        sum
    }

    /// Value and gradient; infinite for shapes without volume.
    pub fn evaluate(&self, shape: &Shape<'_, D>) -> Differential<D> {
        let (volume, rows) = (&shape.volume, shape.rows.len());
        if !(volume.value > 0.0) {
            return forbidden(rows);
        }
        let Some(distance) = self.squared_distance(shape.rows) else { return forbidden(rows) };
        let power = 2.0 / D as f64;
        let mut energy = distance.times(volume.value.powf(-power));
        energy.add_gradient(-power * energy.value / volume.value, &volume.gradient);
        energy
    }
}

/// Coordinate-major numbers.
fn columns<const D: usize>(rows: &[[f64; D]]) -> Vec<f64> {
    (0..D).flat_map(|c| rows.iter().map(move |row| row[c])).collect()
}
