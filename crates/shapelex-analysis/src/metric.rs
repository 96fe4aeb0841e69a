//! The inner product of shapes.
//!
//! ```text
//! ⟨r, s⟩ = Σ_c cᵀ_{r,c} Φ c_{s,c}     x = R c,  RᵀR = Φ     r̄ = mᵀ c,  m = Φ1 / (1ᵀΦ1)
//! ```

use std::sync::Arc;

use crate::rows::{Row, columns_of, rows_of};
use shapelex_geometry::representation::ShapeSpace;
use shapelex_numeric::operator::SymmetricOperator;

/// The metric `Ψ = I_d ⊗ Φ` on control points, coordinate-major (`d·N` numbers a shape).
#[derive(Debug, Clone)]
pub struct Metric {
    gram: Arc<dyn SymmetricOperator>,
    dimension: usize,
    /// `m`, which sums to one.
    centre: Vec<f64>,
}

impl Metric {
    /// Metric from the Gram operator `Φ` of the basis (a partition of unity) and the dimension `d`.
    pub fn new(gram: Arc<dyn SymmetricOperator>, dimension: usize) -> Self {
        let mut centre = vec![1.0; gram.size()];
        gram.apply(&mut centre);
        let total: f64 = centre.iter().sum();
        centre.iter_mut().for_each(|weight| *weight /= total);
        Self { gram, dimension, centre }
    }

    /// The metric of a shape space.
    pub fn of(space: &ShapeSpace) -> Self {
        Self::new(space.gram().clone(), space.representation().dimension())
    }

    /// Number of control points, `N`.
    pub fn size(&self) -> usize {
        self.gram.size()
    }

    /// Number of coordinates, `d`.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Length of a flattened shape, `d·N`.
    pub fn len(&self) -> usize {
        self.size() * self.dimension
    }

    /// Whether shapes have no coordinates (always false).
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// `x = R c`, in place, for any number of shapes. Plain dot products of whitened shapes are `L₂` products.
    pub fn whiten(&self, shapes: &mut [f64]) {
        self.gram.whiten(shapes);
    }

    /// `c = R⁻¹ x`, in place, for any number of shapes.
    pub fn unwhiten(&self, shapes: &mut [f64]) {
        self.gram.unwhiten(shapes);
    }

    /// The whitened shape with these control points.
    pub fn whitened(&self, rows: &[Row]) -> Vec<f64> {
        let mut columns = columns_of(rows, self.dimension());
        self.whiten(&mut columns);
        columns
    }

    /// The control points of a whitened shape.
    pub fn rows(&self, whitened: &[f64]) -> Vec<Row> {
        let mut control_points = whitened.to_vec();
        self.unwhiten(&mut control_points);
        rows_of(&control_points, self.dimension())
    }

    /// `Ψ c`, in place, for any number of shapes.
    pub fn apply(&self, shapes: &mut [f64]) {
        self.gram.apply(shapes);
    }

    /// Mean position `r̄ = ∫ r` of one shape: `d` numbers.
    pub fn centroid(&self, control_points: &[f64]) -> Vec<f64> {
        control_points.chunks_exact(self.size()).map(|coordinate| dot(coordinate, &self.centre)).collect()
    }

    /// Subtracts the mean position of one shape in place and returns it.
    pub fn centre(&self, control_points: &mut [f64]) -> Vec<f64> {
        let centroid = self.centroid(control_points);
        for (coordinate, mean) in control_points.chunks_exact_mut(self.size()).zip(&centroid) {
            coordinate.iter_mut().for_each(|value| *value -= mean);
        }
        centroid
    }

    /// `⟨a, b⟩` of two shapes given by their control points.
    pub fn inner(&self, a: &[f64], b: &[f64]) -> f64 {
        let mut applied = b.to_vec();
        self.gram.apply(&mut applied);
        dot(a, &applied)
    }
}

pub use shapelex_numeric::kernels::dot;

/// Euclidean norm.
pub fn norm(a: &[f64]) -> f64 {
    dot(a, a).sqrt()
}
