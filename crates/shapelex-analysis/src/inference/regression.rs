//! Linear regression of aligned shapes on one attribute, adjusted for covariates.
//!
//! ```text
//! y_k = β_0 + Σ_j z_kj γ_j + a_k b + e_k       weighted least squares
//! b = Σ_k w_k ã_k y_k / Σ_k w_k ã_k²,          ã the attribute minus its regression on the covariates
//! F = (n − p − 2) S_a / S_full,   S_a = ‖b‖² Σ w ã²,   S_full = S_reduced − S_a
//! ```
//!
//! `S_reduced` is the sum of squared distances that the covariates do not explain. The permutations follow Freedman and
//! Lane: residuals of the regression on the covariates are exchanged, each with the root of its weight. With `Q` the
//! orthonormal basis of intercept and covariates, `q` the attribute orthogonal to it, and `R` the residuals, a relabelling
//! `π` costs the product `R π[Q q]`:
//!
//! ```text
//! S_a^π = ‖R π q‖²,   S_reduced^π = ‖R‖² − ‖R π Q‖²
//! ```
//!
//! Without covariates and with equal weights, this is the exact test that permutes the attribute.
//!
//! Sources: Freedman and Lane 1983; Anderson and Robinson 2001; the score of a shape: Drake and Klingenberg 2008.

use super::super::AnalysisError;
use super::permutation::{Draws, Tally};
use super::reaches;
use super::span::Span;
use crate::random::{shuffle, stream};
use crate::watch::Watch;
use shapelex_numeric::dense::{self, Matrix};
use shapelex_numeric::parallel;

/// Minimum fraction of its norm that a column must keep after orthogonalisation against the previous columns.
pub(super) const COLLINEAR: f64 = 1e-9;

/// Approximate number of columns per product.
pub(super) const COLUMNS: usize = 64;

/// Design of the regression: orthonormal columns for intercept, covariates and attribute, each scaled by the root weights.
#[derive(Debug, Clone)]
pub struct Design {
    /// `Q`: intercept and covariates.
    covariates: Vec<Vec<f64>>,
    /// `q`.
    attribute: Vec<f64>,
    /// `√(Σ w ã²)`.
    length: f64,
    roots: Vec<f64>,
}

/// The column of a design that is linearly dependent on the columns before it, so that there is no regression.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Collinear {
    /// The covariate column with this index.
    Covariate(usize),
    /// The attribute.
    Attribute,
}

/// Linear regression on the attribute.
#[derive(Debug, Clone, PartialEq)]
pub struct Regression {
    /// `b`: change per unit of the attribute, one number per row of the vectors.
    pub slope: Vec<f64>,
    /// `R²` of the attribute after the covariates: `S_a` over the total of squared distances from the mean.
    pub r_squared: f64,
    /// Partial `R²`, `S_a/S_reduced`: the explained fraction of the residual of the covariates.
    pub partial_r_squared: f64,
    /// `R²` of attribute and covariates together.
    pub model_r_squared: f64,
    /// `F`; `None` if it is infinite.
    pub pseudo_f: Option<f64>,
    /// Residual degrees of freedom, `n − p − 2`.
    pub degrees: usize,
    /// Tally of the draws whose `F` reaches the observed one.
    pub tally: Tally,
}

impl Regression {
    /// The regression with `S_a`, `S_reduced` and the total of squared distances from the mean.
    pub(super) fn of(slope: Vec<f64>, [own, reduced, total]: [f64; 3], degrees: usize, tally: Tally) -> Self {
        let left = reduced - own;
        Self {
            slope,
            r_squared: part(own, total),
            partial_r_squared: part(own, reduced),
            model_r_squared: if total > 0.0 { (1.0 - left.max(0.0) / total).clamp(0.0, 1.0) } else { 0.0 },
            pseudo_f: (left > 1e-12 * total).then(|| own / left * degrees as f64),
            degrees,
            tally,
        }
    }
}

impl Design {
    /// Builds the design from covariate columns, the attribute and the weights, with one number per shape each.
    ///
    /// # Errors
    /// The first column that is constant or depends linearly on the columns before it.
    pub fn new(covariates: &[Vec<f64>], attribute: &[f64], weights: &[f64]) -> Result<Self, Collinear> {
        let roots: Vec<f64> = weights.iter().map(|weight| weight.sqrt()).collect();
        let mut basis = vec![normalised(&roots)];
        for (index, column) in covariates.iter().enumerate() {
            let (unit, _) = beside(&basis, column, &roots).ok_or(Collinear::Covariate(index))?;
            basis.push(unit);
        }
        let (attribute, length) = beside(&basis, attribute, &roots).ok_or(Collinear::Attribute)?;
        Ok(Self { covariates: basis, attribute, length, roots })
    }

    /// Residual degrees of freedom.
    pub fn degrees(&self) -> usize {
        self.roots.len().saturating_sub(self.covariates.len() + 1)
    }

    /// Regression of the columns of `vectors`. `watch` is asked before every product, and counts the draws.
    ///
    /// Cost: a singular value decomposition, and `n m (p + 2)` multiply-adds per draw for vectors with a span of dimension `m`.
    ///
    /// # Errors
    /// [`AnalysisError::Interrupted`] once `watch` stops; a failure of an eigenproblem.
    pub fn regress(
        &self,
        vectors: &Matrix,
        weights: &[f64],
        draws: Draws<'_>,
        watch: &dyn Watch,
    ) -> Result<Regression, AnalysisError> {
        let span = Span::new(vectors, weights)?;
        let total = span.total();
        let residuals = self.residuals(span.scores);
        let (own, reduced) = self.sums(&residuals, &[(0..self.roots.len()).collect()])[0];
        let observed = part(own, reduced);
        let reaching = self.count_reaching(&residuals, observed, draws, watch)?;
        let degrees = self.degrees();
        let tally = Tally { exceeding: reaching, permutations: draws.permutations, exact: false };
        Ok(Regression::of(self.slope(vectors), [own, reduced, total], degrees, tally))
    }

    /// `b = Σ w ã y / Σ w ã²`, computed about the first vector to avoid cancellation.
    fn slope(&self, vectors: &Matrix) -> Vec<f64> {
        let first = vectors.column(0).into_owned();
        let mut slope = vec![0.0; vectors.nrows()];
        for ((y, q), root) in vectors.column_iter().zip(&self.attribute).zip(&self.roots) {
            let factor = q * root / self.length;
            slope.iter_mut().zip(y.iter().zip(first.iter())).for_each(|(b, (y, f))| *b += factor * (y - f));
        }
        slope
    }

    /// Residuals of the rows after the covariates, scaled by the root weights.
    fn residuals(&self, mut rows: Matrix) -> Matrix {
        for (mut column, &root) in rows.column_iter_mut().zip(&self.roots) {
            column.scale_mut(root);
        }
        for q in &self.covariates {
            let q = Matrix::from_column_slice(q.len(), 1, q);
            let products = dense::multiply(&rows, &q);
            rows -= products * q.transpose();
        }
        rows
    }

    /// `(S_a, S_reduced)` with the residual of shape `order[k]` in the place of the residual of shape `k`.
    fn sums(&self, residuals: &Matrix, orders: &[Vec<usize>]) -> Vec<(f64, f64)> {
        let columns: Vec<&Vec<f64>> = self.covariates.iter().chain([&self.attribute]).collect();
        let mut permuted = Matrix::zeros(self.roots.len(), orders.len() * columns.len());
        for (b, order) in orders.iter().enumerate() {
            for (c, column) in columns.iter().enumerate() {
                for (k, &from) in order.iter().enumerate() {
                    permuted[(from, b * columns.len() + c)] = column[k];
                }
            }
        }
        let products = dense::multiply(residuals, &permuted);
        let squares: Vec<f64> = products.column_iter().map(|column| column.norm_squared()).collect();
        let whole = residuals.norm_squared();
        let of = |squares: &[f64]| {
            let (covariates, own) = squares.split_at(self.covariates.len());
            (own[0], (whole - covariates.iter().sum::<f64>()).max(own[0]))
        };
        squares.chunks_exact(columns.len()).map(of).collect()
    }

    fn count_reaching(
        &self,
        residuals: &Matrix,
        observed: f64,
        draws: Draws<'_>,
        watch: &dyn Watch,
    ) -> Result<usize, AnalysisError> {
        let strata = members(draws.strata);
        let together = (COLUMNS / (self.covariates.len() + 1)).max(1);
        let order = |index: usize| {
            let mut order: Vec<usize> = (0..self.roots.len()).collect();
            let mut random = stream(draws.seed, index);
            strata.iter().for_each(|stratum| shuffle(&mut random, stratum, &mut order));
            order
        };
        let batches = parallel::try_map(draws.permutations.div_ceil(together), &|batch| {
            watch.check()?;
            let last = draws.permutations.min((batch + 1) * together);
            let orders: Vec<_> = (batch * together..last).map(order).collect();
            let sums = self.sums(residuals, &orders);
            watch.worked(orders.len());
            Ok(sums.into_iter().filter(|&(own, reduced)| reaches(part(own, reduced), observed)).count())
        });
        batches.map(|counts| counts.into_iter().sum())
    }
}

pub(super) fn part(own: f64, whole: f64) -> f64 {
    if whole > 0.0 { (own / whole).min(1.0) } else { 0.0 }
}

fn members(strata: &[usize]) -> Vec<Vec<usize>> {
    let mut members = vec![Vec::new(); strata.iter().map(|stratum| stratum + 1).max().unwrap_or(0)];
    strata.iter().enumerate().for_each(|(k, &stratum)| members[stratum].push(k));
    members
}

fn norm(x: &[f64]) -> f64 {
    x.iter().map(|value| value * value).sum::<f64>().sqrt()
}

fn normalised(x: &[f64]) -> Vec<f64> {
    let length = norm(x);
    x.iter().map(|value| value / length).collect()
}

/// Direction and length of the component of a column, scaled by the root weights, that is orthogonal to `basis`. `None` if
/// there is none.
fn beside(basis: &[Vec<f64>], column: &[f64], roots: &[f64]) -> Option<(Vec<f64>, f64)> {
    // Centred on the middle value, so that a column far from zero keeps its digits.
    let middle = column.iter().copied().fold(f64::MAX, f64::min) * 0.5
        + column.iter().copied().fold(f64::MIN, f64::max) * 0.5;
    let spread = column.iter().map(|value| (value - middle).abs()).fold(0.0, f64::max);
    let size = column.iter().map(|value| value.abs()).fold(0.0, f64::max);
    if !(spread > COLLINEAR * size) {
        return None;
    }
    let mut unit: Vec<f64> =
        column.iter().zip(roots).map(|(value, root)| (value - middle) / spread * root).collect();
    let before = norm(&unit);
    // Two rounds of Gram–Schmidt suffice.
    for _ in 0..2 {
        for q in basis {
            let product: f64 = unit.iter().zip(q).map(|(u, q)| u * q).sum();
            unit.iter_mut().zip(q).for_each(|(u, q)| *u -= product * q);
        }
    }
    let length = norm(&unit);
    (length > COLLINEAR * before).then(|| (normalised(&unit), length * spread))
}

#[cfg(test)]
mod tests {
    use rand::RngExt;

    use super::*;
    use crate::watch::Unwatched;

    fn noise(i: usize, k: usize) -> f64 {
        stream(17, 1000 * i + k).random_range(-0.5..0.5)
    }

    fn regress(y: &Matrix, covariates: &[Vec<f64>], attribute: &[f64], weights: &[f64]) -> Regression {
        let design = Design::new(covariates, attribute, weights).unwrap();
        let strata = vec![0; weights.len()];
        let draws = Draws { strata: &strata, seed: 1, permutations: 199 };
        design.regress(y, weights, draws, &Unwatched).unwrap()
    }

    #[test]
    fn five_points_as_worked_by_hand() {
        // a = 1…5, y = 2, 1, 4, 3, 5: slope 0.8, squares 10 about the mean, 6.4 of the line, F = 3 · 6.4/3.6.
        let y = Matrix::from_row_slice(1, 5, &[2.0, 1.0, 4.0, 3.0, 5.0]);
        let found = regress(&y, &[], &[1.0, 2.0, 3.0, 4.0, 5.0], &[1.0; 5]);
        assert!((found.slope[0] - 0.8).abs() < 1e-14);
        assert!((found.r_squared - 0.64).abs() < 1e-14 && (found.partial_r_squared - 0.64).abs() < 1e-14);
        assert!((found.pseudo_f.unwrap() - 3.0 * 6.4 / 3.6).abs() < 1e-12);
        assert_eq!(found.degrees, 3);
    }

    #[test]
    fn covariates_are_taken_out_and_weights_count_shapes() {
        let n = 12;
        let attribute: Vec<f64> = (0..n).map(|k| k as f64 + noise(3, k)).collect();
        let covariate: Vec<f64> = (0..n).map(|k| 2.0 * k as f64 + noise(5, k)).collect();
        let y = Matrix::from_fn(4, n, |i, k| {
            1e3 + i as f64 * covariate[k] - 0.5 * (i as f64 + 1.0) * attribute[k]
        });
        let found = regress(&y, std::slice::from_ref(&covariate), &attribute, &vec![1.0; n]);
        for (i, slope) in found.slope.iter().enumerate() {
            assert!((slope + 0.5 * (i as f64 + 1.0)).abs() < 1e-9, "{i}: {slope}");
        }
        assert!((found.model_r_squared - 1.0).abs() < 1e-9 && found.pseudo_f.is_none());

        // For the fitted line, a shape of weight two is equivalent to the shape given twice.
        let noisy = Matrix::from_fn(3, 5, |i, k| noise(i, k + 40));
        let doubled = noisy.select_columns(&[0, 1, 2, 2, 3, 4]);
        let a = [1.0, 2.5, 3.0, 4.0, 6.0];
        let weighted = regress(&noisy, &[], &a, &[1.0, 1.0, 2.0, 1.0, 1.0]);
        let twice = regress(&doubled, &[], &[1.0, 2.5, 3.0, 3.0, 4.0, 6.0], &[1.0; 6]);
        assert!((weighted.r_squared - twice.r_squared).abs() < 1e-12);
        weighted.slope.iter().zip(&twice.slope).for_each(|(a, b)| assert!((a - b).abs() < 1e-12));
    }

    #[test]
    fn columns_that_say_nothing_are_named() {
        let (a, weights) = ([1.0, 2.0, 4.0, 8.0], [1.0; 4]);
        let error = |covariates: &[Vec<f64>], a: &[f64]| Design::new(covariates, a, &weights).unwrap_err();
        assert_eq!(error(&[], &[3.0; 4]), Collinear::Attribute);
        assert_eq!(error(&[], &[1e12, 1e12, 1e12, 1e12 + 1e-3]), Collinear::Attribute);
        assert_eq!(error(&[vec![3.0, 5.0, 9.0, 17.0]], &a), Collinear::Attribute);
        assert_eq!(error(&[vec![0.0, 0.0, 1.0, 0.0], vec![2.0; 4]], &a), Collinear::Covariate(1));
    }

    #[test]
    fn a_dependence_is_found_and_the_order_of_threads_is_not() {
        let n = 30;
        let attribute: Vec<f64> = (0..n).map(|k| noise(11, k)).collect();
        let y = Matrix::from_fn(6, n, |i, k| noise(i, k) + if i == 2 { 2.0 * attribute[k] } else { 0.0 });
        let pool = |threads: usize| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let run = || regress(&y, &[(0..n).map(|k| noise(20, k)).collect()], &attribute, &vec![1.0; n]);
        let found = pool(1).install(run);
        assert_eq!(found, pool(3).install(run));
        assert_eq!(found.tally.exceeding, 0);
    }
}
