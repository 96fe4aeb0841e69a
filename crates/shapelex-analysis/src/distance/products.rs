//! The inner products of a pair from which its score is formed.

use crate::fit::{Fit, Scaling, best_correlation};
use crate::transformation::{Structure, TransformationClass};
use shapelex_numeric::dense::Matrix;

use super::best::TIE;

/// Relative distance from the span of a class above which a matrix does not belong to the class.
pub(super) const IN_SPAN: f64 = 1e-9;

/// A signed inner product of a column of the first shape with one of the second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Term {
    pub(super) left: usize,
    pub(super) right: usize,
    pub(super) sign: f64,
}

/// Score of a pair, formed from its products. A larger score means a smaller distance.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Score {
    /// `Σ p²`.
    Squares,
    /// The single product itself.
    Single,
    /// `max tr(RᵀH)` of the `3 × 3` products.
    Rotation,
}

/// Number of columns of a class, the products whose squares sum to `tr(P₁P₂)` up to a factor, and the largest such sum.
pub(super) fn class_products(class: &TransformationClass) -> (usize, Vec<Vec<Term>>, f64) {
    let d = class.dimension();
    match class.structure {
        // tr(P₁P₂) = d ‖Q₁ᵀQ₂‖², I = d²
        Structure::PerCoordinate => (d, each_with_each(d), d as f64),
        Structure::PerAxis => (d, (0..d).map(|c| vec![plus(c, c)]).collect(), d as f64),
        // |z₁* z₂|² of the unit vectors of both planes
        Structure::Complex => (2, complex_products(), 1.0),
        Structure::General => {
            let rank = class.matrices().len();
            let inner = |i: usize, j: usize| (0..d).map(|c| plus(i * d + c, j * d + c)).collect();
            let products = (0..rank).flat_map(|i| (0..rank).map(move |j| inner(i, j))).collect();
            (rank * d, products, rank as f64)
        }
    }
}

pub(super) fn fit_products(fit: Fit) -> (Vec<Vec<Term>>, Score) {
    match (fit.rotates, fit.dimension) {
        (false, d) => (vec![(0..d).map(|c| plus(c, c)).collect()], Score::Single),
        // tr(RᵀH) is largest at |H₀₀ + H₁₁ + i(H₁₀ − H₀₁)|
        (true, 2) => (complex_products(), Score::Squares),
        (true, d) => (each_with_each(d), Score::Rotation),
    }
}

pub(super) fn plus(left: usize, right: usize) -> Term {
    Term { left, right, sign: 1.0 }
}

/// `H`, row by row.
pub(super) fn each_with_each(d: usize) -> Vec<Vec<Term>> {
    (0..d).flat_map(|c| (0..d).map(move |e| vec![plus(c, e)])).collect()
}

/// Real and imaginary part of `z₁* z₂`.
pub(super) fn complex_products() -> Vec<Vec<Term>> {
    vec![vec![plus(0, 0), plus(1, 1)], vec![plus(0, 1), Term { sign: -1.0, ..plus(1, 0) }]]
}

/// Whether `M B M` belongs to the class for all its matrices `B`, where `M` mirrors the first coordinate.
pub(super) fn is_mirrored_into_itself(class: &TransformationClass) -> bool {
    let d = class.dimension();
    let stacked = |matrix: &Matrix| Matrix::from_column_slice(d * d, 1, matrix.as_slice());
    let units: Vec<Matrix> = class.matrices().iter().map(|b| stacked(b) / b.norm()).collect();
    let columns: Vec<f64> = units.iter().flat_map(|column| column.iter().copied()).collect();
    let span = Matrix::from_vec(d * d, units.len(), columns).qr().q();
    units.iter().all(|column| {
        let mirrored = Matrix::from_fn(d * d, 1, |k, _| {
            let turns = (k % d == 0) != (k / d == 0);
            if turns { -column[(k, 0)] } else { column[(k, 0)] }
        });
        (&mirrored - &span * span.tr_mul(&mirrored)).norm() <= IN_SPAN
    })
}

/// `max tr(RᵀH)` for the `3 × 3` matrix `H`, given row by row.
pub(super) fn rotation_score(products: &[f64]) -> f64 {
    let fit = Fit { dimension: 3, rotates: true, scaling: Scaling::None };
    best_correlation(&Matrix::from_row_slice(3, 3, products), fit)
}

/// Scores of all start points from their products, which hold one list of start points per product.
///
/// `tr(RᵀH) ≤ √3 ‖H‖`: a start point with a bound below the best score so far is not decomposed. Its score is the bound, so
/// it is never chosen.
pub(super) fn rotation_scores(products: &[f64], scores: &mut [f64]) {
    let n = scores.len();
    let at = |s: usize| products.iter().skip(s).step_by(n);
    for (s, score) in scores.iter_mut().enumerate() {
        *score = (3.0 * at(s).map(|p| p * p).sum::<f64>()).sqrt();
    }
    let mut best = f64::NEG_INFINITY;
    for (s, score) in scores.iter_mut().enumerate() {
        if *score * (1.0 + TIE) < best {
            continue;
        }
        *score = rotation_score(&at(s).copied().collect::<Vec<f64>>());
        best = best.max(*score);
    }
}
