//! Coordinates of shapes in their span.
//!
//! ```text
//! y_k = x_k − x̄,   YᵀY = V Λ Vᵀ,   coordinates Λ^{1/2} Vᵀ      (isometric: ‖Y z‖ = ‖Λ^{1/2} Vᵀ z‖ for all z)
//! ```
//!
//! Statistics that depend on distances alone are the same in these coordinates, which are fewer than the shapes.

use super::super::AnalysisError;
use shapelex_numeric::dense::{self, Matrix};

/// Relative eigenvalue below which a direction is rounding error.
const RANK: f64 = 1e-14;

/// Principal coordinates of vectors about their mean.
#[derive(Debug, Clone)]
pub struct Span {
    /// Scores along the principal directions, one column per vector: `m × n`.
    pub scores: Matrix,
    /// `λ_i = Σ_k w_k score_ik²`, descending, all positive; empty if all vectors are equal.
    pub eigenvalues: Vec<f64>,
}

impl Span {
    /// Span of the `n` columns of `vectors` with positive `weights`: principal directions of `Σ w (x − x̄)(x − x̄)ᵀ`.
    ///
    /// Cost: `n² r` or `n r²` for vectors of length `r`, and an eigenproblem of the smaller of the two sizes.
    ///
    /// # Errors
    /// A failure of the eigenproblem.
    pub fn new(vectors: &Matrix, weights: &[f64]) -> Result<Self, AnalysisError> {
        let mut weighted = vectors.clone();
        centre_rows(&mut weighted, weights);
        let roots: Vec<f64> = weights.iter().map(|weight| weight.sqrt()).collect();
        for (mut column, &root) in weighted.column_iter_mut().zip(&roots) {
            column.scale_mut(root);
        }
        let mut span = Self::of_scaled(&weighted)?;
        for (mut column, &root) in span.scores.column_iter_mut().zip(&roots) {
            column.unscale_mut(root);
        }
        Ok(span)
    }

    /// Span of columns `z` as they are: principal directions of `Σ z zᵀ`. Cost and errors: as for [`Self::new`].
    ///
    /// # Errors
    /// A failure of the eigenproblem.
    pub fn of_scaled(weighted: &Matrix) -> Result<Self, AnalysisError> {
        let (length, count) = weighted.shape();
        if count <= length {
            let gram = dense::gram(weighted.as_slice(), length);
            let pairs = dense::leading_eigenpairs(&gram, count)?;
            let kept = rank(&pairs.values);
            let scores = Matrix::from_fn(kept, count, |i, k| pairs.values[i].sqrt() * pairs.vectors[(k, i)]);
            return Ok(Self { scores, eigenvalues: pairs.values[..kept].to_vec() });
        }
        let mut scatter = Matrix::zeros(length, length);
        dense::add_outer_products(&mut scatter, weighted.as_slice(), 1.0);
        let pairs = dense::leading_eigenpairs(&scatter, length)?;
        let kept = rank(&pairs.values);
        let directions = pairs.vectors.columns(0, kept).into_owned();
        let scores = dense::transpose_multiply(&directions, weighted);
        Ok(Self { scores, eigenvalues: pairs.values[..kept].to_vec() })
    }

    /// `Σ λ_i`: the weighted sum of squared distances from the mean.
    pub fn total(&self) -> f64 {
        self.eigenvalues.iter().sum()
    }
}

fn rank(values: &[f64]) -> usize {
    let largest = values.first().copied().unwrap_or(0.0);
    values.iter().take_while(|&&value| value > 0.0 && value > RANK * largest).count()
}

/// Subtracts the weighted mean from every row. A row without variation becomes exactly zero.
pub(crate) fn centre_rows(rows: &mut Matrix, weights: &[f64]) {
    let total: f64 = weights.iter().sum();
    for mut row in rows.row_iter_mut() {
        // Computed about the first value, so that a constant row leaves no rounding error.
        let first = row[0];
        let mean =
            row.iter().zip(weights).map(|(value, weight)| weight * (value - first)).sum::<f64>() / total;
        row.iter_mut().for_each(|value| *value = (*value - first) - mean);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_keep_distances_on_both_routes() {
        for (length, count) in [(7, 5), (3, 9)] {
            let vectors = Matrix::from_fn(length, count, |i, k| ((i + 1) as f64 * (k * k + 2) as f64).sin());
            let weights: Vec<f64> = (0..count).map(|k| 1.0 + 0.5 * k as f64).collect();
            let span = Span::new(&vectors, &weights).unwrap();
            assert_eq!(span.eigenvalues.len(), length.min(count - 1));
            for i in 0..count {
                for j in 0..count {
                    let before = (vectors.column(i) - vectors.column(j)).norm();
                    let after = (span.scores.column(i) - span.scores.column(j)).norm();
                    assert!((before - after).abs() < 1e-12, "{before} {after}");
                }
            }
            for (i, value) in span.eigenvalues.iter().enumerate() {
                let row = span.scores.row(i);
                let sum: f64 = row.iter().zip(&weights).map(|(s, w)| w * s * s).sum();
                assert!((sum - value).abs() < 1e-12 * span.total());
            }
        }
    }

    #[test]
    fn equal_vectors_span_nothing() {
        let vectors = Matrix::from_fn(4, 3, |i, _| 0.1 * i as f64);
        let span = Span::new(&vectors, &[1.0, 0.3, 2.0]).unwrap();
        assert_eq!((span.eigenvalues.len(), span.total()), (0, 0.0));
    }
}
