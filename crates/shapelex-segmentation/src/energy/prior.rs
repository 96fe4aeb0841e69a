//! The shape prior: distance from the class of a reference.
//!
//! ```text
//! E_prior = ‖c − c*‖²/V^{2/d},   c* = nearest member of the class of the reference
//! ∂E = 2Ψ(c − c*)/V^{2/d} − (2/d) E ∂V/V
//! ```
//!
//! The reference is a shape, or the span of several shapes under a linear class, such as the mean and the components of a
//! dictionary. `c*` is `P c` for linear classes and a Procrustes fit for rotations of space; by the envelope theorem its change does not
//! enter the gradient. Without the division by the volume, the term would pull every shape towards a point.
//!
//! Several references make a choice: the nearest one attracts, at each shape anew, so that a run chooses its structure among several
//! dictionaries (thesis 8.2). The energy is continuous where the choice changes, its gradient is not.
//!
//! Equal parameters are compared: the first shape should be the posed reference. The affine class contains reflections and flat
//! shapes.

use std::sync::Arc;

use shapelex_analysis::AnalysisError;
use shapelex_analysis::alignment::{Method, Projector};
use shapelex_analysis::dictionary::prior::{Energy as SpanEnergy, Prior as SpanPrior};
use shapelex_analysis::metric::Metric;
use shapelex_analysis::transformation::TransformationClass;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::sparse::SparseRows;

use super::shape::{Shape, forbidden};
use crate::boundary::{Boundary, Differential};
use crate::frame::Frame;

/// The attracting shape or span.
#[derive(Debug, Clone)]
enum Attractor {
    /// The class of a shape, given by its control points, coordinate-major.
    Class { method: Method, reference: Vec<f64> },
    /// All combinations of shapes under a linear class.
    Span(SpanPrior),
}

/// Squared distance from the class of a reference, relative to the size of the shape.
#[derive(Debug, Clone)]
pub struct Prior<const D: usize> {
    metric: Metric,
    /// The nearest of them attracts.
    attractors: Vec<Arc<Attractor>>,
    /// From free points to the control points of the metric, and the transpose; `None` if they are the same.
    lift: Option<[SparseRows; 2]>,
    frame: Frame<D>,
    /// The boundary that measures enclosed areas and volumes; `None` for that of the samples of the image.
    enclosing: Option<Arc<dyn Boundary<D>>>,
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
        Ok(Self::of(metric, Attractor::Class { method, reference }, lift, frame))
    }

    /// Prepares the span of `shapes` under a linear class: all sums of their members. Shapes are control points in the world,
    /// coordinate-major. Cost: an orthogonal basis of all transformed shapes.
    pub fn spanned(
        metric: Metric,
        class: &TransformationClass,
        shapes: &[Vec<f64>],
        lift: Option<SparseRows>,
        frame: Frame<D>,
    ) -> Self {
        let whitened = |shape: &Vec<f64>| {
            let mut shape = shape.clone();
            if class.translates() {
                metric.centre(&mut shape);
            }
            metric.whiten(&mut shape);
            shape
        };
        let shapes: Vec<Vec<f64>> = shapes.iter().map(whitened).collect();
        let span = SpanPrior::new(&metric, class, &shapes, 1.0);
        Self::of(metric, Attractor::Span(span), lift, frame)
    }

    fn of(metric: Metric, attractor: Attractor, lift: Option<SparseRows>, frame: Frame<D>) -> Self {
        let lift = lift.map(|lift| [lift.clone(), lift.transpose()]);
        Self { metric, attractors: vec![Arc::new(attractor)], lift, frame, enclosing: None }
    }

    /// The same with the references of another prior on the same control points to choose from.
    #[must_use]
    pub fn or(mut self, other: Self) -> Self {
        self.attractors.extend(other.attractors);
        self
    }

    /// The same, with enclosed areas and volumes measured by this boundary.
    #[must_use]
    pub fn measured_by(self, enclosing: Arc<dyn Boundary<D>>) -> Self {
        Self { enclosing: Some(enclosing), ..self }
    }

    /// The nearest attractor, with the squared distance of control points in the world, coordinate-major, and its gradient. `None` for
    /// degenerate shapes.
    fn nearest(&self, shape: &[f64]) -> Option<(usize, (f64, Vec<f64>))> {
        let found = self.attractors.iter().enumerate();
        let found = found.filter_map(|(index, one)| Some((index, self.distance(one, shape.to_vec())?)));
        found.min_by(|(_, (a, _)), (_, (b, _))| a.total_cmp(b))
    }

    /// The position of the reference that attracts free points. `None` for degenerate shapes.
    pub fn chosen(&self, rows: &[[f64; D]]) -> Option<usize> {
        self.nearest(&columns(&self.world(rows))).map(|(index, _)| index)
    }

    /// Control points in the world.
    fn world(&self, rows: &[[f64; D]]) -> Vec<[f64; D]> {
        let lifted = self.lift.as_ref().map(|[lift, _]| lift.apply(rows));
        lifted.as_deref().unwrap_or(rows).iter().map(|point| self.frame.to_world(*point)).collect()
    }

    fn distance(&self, attractor: &Attractor, shape: Vec<f64>) -> Option<(f64, Vec<f64>)> {
        match attractor {
            Attractor::Span(span) => {
                let SpanEnergy { energy, gradient } = span.energy(&shape);
                Some((energy, gradient))
            }
            Attractor::Class { method, reference } => {
                let projector = Projector::new(&self.metric, method, shape.clone());
                let nearest = projector.project(reference.clone()).ok()?;
                let mut residual: Vec<f64> =
                    shape.iter().zip(&nearest.control_points).map(|(c, p)| c - p).collect();
                let value = self.metric.inner(&residual, &residual);
                self.metric.apply(&mut residual);
                Some((value, residual.into_iter().map(|value| 2.0 * value).collect()))
            }
        }
    }

    /// The squared distance `‖c − c*‖²` and its gradient, before the division by the size. `None` for degenerate shapes.
    pub fn squared_distance(&self, rows: &[[f64; D]]) -> Option<Differential<D>> {
        let (_, (value, slopes)) = self.nearest(&columns(&self.world(rows)))?;
        let n = self.metric.size();
        let slope = |i: usize| self.frame.turn_back(std::array::from_fn(|c| slopes[c * n + i]));
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
        let exact = self.enclosing.as_ref().map(|boundary| boundary.volume(&boundary.sample(shape.rows)));
        let volume = exact.as_ref().unwrap_or(&shape.volume);
        let relative = (volume.value > 0.0).then(|| self.relative(shape.rows, volume)).flatten();
        relative.unwrap_or_else(|| forbidden(shape.rows.len()))
    }

    /// `‖c − c*‖²/|V|^{2/d}` and its gradient for a shape with the volume `V` of either sign. `None` for degenerate shapes, and
    /// without volume.
    pub fn relative(&self, rows: &[[f64; D]], volume: &Differential<D>) -> Option<Differential<D>> {
        let distance = self.squared_distance(rows).filter(|_| volume.value != 0.0)?;
        let power = 2.0 / D as f64;
        let mut energy = distance.times(volume.value.abs().powf(-power));
        energy.add_gradient(-power * energy.value / volume.value, &volume.gradient);
        energy.value.is_finite().then_some(energy)
    }
}

/// Coordinate-major numbers.
fn columns<const D: usize>(rows: &[[f64; D]]) -> Vec<f64> {
    (0..D).flat_map(|c| rows.iter().map(move |row| row[c])).collect()
}
