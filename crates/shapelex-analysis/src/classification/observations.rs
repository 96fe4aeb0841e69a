//! Inputs of classifiers, and their answers.

use crate::dictionary::model::Model;
use crate::metric::norm;
use crate::preparation::Preparation;
use crate::sparse::SparseCode;
use shapelex_numeric::dense::Matrix;

/// Shapes with everything that classifiers look at.
#[derive(Debug, Clone, Copy)]
pub struct Observations<'a> {
    /// Whitened shapes as given, centred when the class translates: one after the other.
    pub shapes: &'a [f64],
    /// The same in the form that is coded.
    pub prepared: &'a [f64],
    /// Their codes.
    pub codes: &'a [SparseCode],
}

impl<'a> Observations<'a> {
    /// Number of shapes.
    pub fn count(&self) -> usize {
        self.codes.len()
    }

    /// Numbers of a shape.
    pub(super) fn length(&self) -> usize {
        self.shapes.len() / self.count().max(1)
    }

    pub(super) fn shape(&self, k: usize) -> &'a [f64] {
        &self.shapes[k * self.length()..(k + 1) * self.length()]
    }

    pub(super) fn prepared(&self, k: usize) -> &'a [f64] {
        &self.prepared[k * self.length()..(k + 1) * self.length()]
    }
}

/// How shapes are described to classifiers.
#[derive(Debug, Clone, Copy)]
pub struct Description<'a> {
    /// How they are brought into pose.
    pub preparation: &'a Preparation,
    /// Model in which they are coded.
    pub model: &'a Model,
    /// Whether the logarithm of the size `ln ‖r − r̄‖` is a feature.
    pub size: bool,
}

impl Description<'_> {
    /// Features of the shapes, one a column: the code (scores; coefficients; for moved atoms their norms), then the
    /// logarithm of the size when that is asked for. `p × K`.
    pub fn features(&self, observations: Observations<'_>) -> Matrix {
        let atoms = self.model.len();
        let mut features = Matrix::zeros(atoms + usize::from(self.size), observations.count());
        for (k, mut column) in features.column_iter_mut().enumerate() {
            let code = &observations.codes[k];
            let block = code.values.len() / code.indices.len().max(1);
            for (&j, values) in code.indices.iter().zip(code.values.chunks_exact(block.max(1))) {
                column[j] = if block == 1 { values[0] } else { norm(values) };
            }
            if self.size {
                column[atoms] = norm(observations.shape(k)).ln();
            }
        }
        features
    }
}

/// Shapes of known classes.
#[derive(Debug, Clone, Copy)]
pub struct Labelled<'a> {
    /// The shapes.
    pub observations: Observations<'a>,
    /// Weights of the shapes in means.
    pub weights: &'a [f64],
    /// The class of every shape, from 0.
    pub classes: &'a [usize],
    /// Number of classes.
    pub count: usize,
}

impl Labelled<'_> {
    /// Shapes of every class.
    pub(super) fn sizes(&self) -> Vec<usize> {
        let mut sizes = vec![0; self.count];
        self.classes.iter().for_each(|&c| sizes[c] += 1);
        sizes
    }
}

/// Evidence of a classifier about a shape, class by class.
#[derive(Debug, Clone, PartialEq)]
pub struct Evidence {
    /// Distance to every class: relative residual, Mahalanobis distance, or distance to the nearest member.
    pub distances: Vec<f64>,
    /// The larger, the likelier; confidences are `∝ exp(β score)`.
    pub scores: Vec<f64>,
}

impl Evidence {
    /// Of relative residuals: the score is `−d²`.
    pub(super) fn from_residuals(distances: Vec<f64>) -> Self {
        let scores = distances.iter().map(|d| -d * d).collect();
        Self { distances, scores }
    }

    /// Classes from the likeliest on; of equal scores the nearer one, then the first.
    pub fn ranking(&self) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.scores.len()).collect();
        order.sort_by(|&a, &b| {
            let by_score = self.scores[b].total_cmp(&self.scores[a]);
            by_score.then(self.distances[a].total_cmp(&self.distances[b])).then(a.cmp(&b))
        });
        order
    }

    /// The likeliest class.
    pub fn best(&self) -> usize {
        let better = |a: usize, b: usize| {
            let by_score = self.scores[a].total_cmp(&self.scores[b]);
            by_score.then(self.distances[b].total_cmp(&self.distances[a])).is_lt()
        };
        (1..self.scores.len()).fold(0, |best, c| if better(best, c) { c } else { best })
    }
}
