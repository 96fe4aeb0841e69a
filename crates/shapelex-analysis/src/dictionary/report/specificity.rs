//! Specificity: distances of random shapes to the nearest training shape, for each number of components.
//!
//! ```text
//! ‖x_m − y_k‖² = Σ_{i ≤ m} (s_i − s_ki)² + ‖y_k − ŷ_k,m‖²      x_m = ȳ + Σ_{i ≤ m} s_i ξ_i
//! ```
//!
//! One pass over the scores gives the distances for all numbers of components, and the shapes themselves are not needed.

use super::sample::Sample;
use super::{ByNumber, PointSets, Scale};
use crate::AnalysisError;
use crate::dictionary::model::Spread;
use crate::watch::Watch;
use rand::SeedableRng;
use rand::rngs::ChaCha12Rng;
use rand_distr::{Distribution, StandardNormal};
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::parallel;

/// Draws shapes from the normal distribution of the scores. Cost: `draws · shapes · count`.
///
/// # Errors
/// [`AnalysisError::Interrupted`].
pub(super) fn specificity(
    sample: &Sample,
    spread: &Spread,
    scale: &Scale,
    sets: &PointSets<'_>,
    (draws, seed): (usize, u64),
    watch: &dyn Watch,
) -> Result<ByNumber, AnalysisError> {
    let count = spread.mean.len();
    let root = lower_root(&spread.covariance);
    let mut random = ChaCha12Rng::seed_from_u64(seed);
    let mut draw = || {
        let z = Matrix::from_fn(count, 1, |_, _| StandardNormal.sample(&mut random));
        let scores = &root * z;
        spread.mean.iter().zip(scores.iter()).map(|(m, s)| m + s).collect::<Vec<f64>>()
    };
    let drawn: Vec<Vec<f64>> = (0..draws).map(|_| draw()).collect();
    let rests: Vec<Vec<f64>> = (0..sample.count()).map(|k| rests(sample, k, count)).collect();
    let chosen = sets.chosen(draws, count);
    let of = |at: usize| {
        watch.check()?;
        let scores = &drawn[at];
        let nearest = nearest(sample, &rests, scores);
        watch.worked(1);
        let points = nearest.iter().map(|&(square, k)| scale.length(k, square.sqrt())).collect();
        let shown = chosen.binary_search(&at).is_ok();
        let distance = |(m, &(_, k)): (usize, &(f64, usize))| {
            let mut z = vec![0.0; sample.values.len()];
            z[..m].copy_from_slice(&scores[..m]);
            sets.distance(&sets.shape(sample.shape(k)), &sets.shape(&z)).map(|found| scale.set(k, found))
        };
        let distances: Option<Vec<f64>> =
            if shown { nearest.iter().enumerate().map(distance).collect() } else { None };
        Ok((points, distances))
    };
    let found: Vec<(Vec<f64>, Option<Vec<f64>>)> = parallel::try_map::<_, AnalysisError>(drawn.len(), &of)?;
    Ok(ByNumber::of(found))
}

/// `‖y_k − ŷ_k,m‖²` for 0, 1, …, `count` components.
fn rests(sample: &Sample, k: usize, count: usize) -> Vec<f64> {
    let z = sample.shape(k);
    let mut rests: Vec<f64> = Vec::with_capacity(count + 1);
    // From the small end, so that nothing cancels.
    let mut rest = sample.outside[k] + z[count..].iter().map(|z| z * z).sum::<f64>();
    rests.push(rest);
    for z in z[..count].iter().rev() {
        rest += z * z;
        rests.push(rest);
    }
    rests.reverse();
    rests
}

/// The squared distance to the nearest shape, and its position, for each number of components; the first of equally near ones.
fn nearest(sample: &Sample, rests: &[Vec<f64>], scores: &[f64]) -> Vec<(f64, usize)> {
    let mut best = vec![(f64::MAX, 0); scores.len() + 1];
    for (k, rests) in rests.iter().enumerate() {
        let mut sum = 0.0;
        for (m, rest) in rests.iter().enumerate() {
            if sum + rest < best[m].0 {
                best[m] = (sum + rest, k);
            }
            if let Some(score) = scores.get(m) {
                sum += (score - sample.shape(k)[m]).powi(2);
            }
        }
    }
    best
}

/// `L` with `C = L Lᵀ`, lower triangular, so that the first scores are the same whatever follows. Directions without variance get
/// zeros: `C` is positive semi-definite.
fn lower_root(covariance: &Matrix) -> Matrix {
    let n = covariance.nrows();
    let mut root = Matrix::zeros(n, n);
    for j in 0..n {
        let product = |i: usize, root: &Matrix| (0..j).map(|l| root[(i, l)] * root[(j, l)]).sum::<f64>();
        let pivot = covariance[(j, j)] - product(j, &root);
        if !(pivot > SEMIDEFINITE * covariance[(j, j)]) {
            continue;
        }
        root[(j, j)] = pivot.sqrt();
        for i in j + 1..n {
            root[(i, j)] = (covariance[(i, j)] - product(i, &root)) / root[(j, j)];
        }
    }
    root
}

/// Pivot, as a fraction of its variance, that is rounding error.
const SEMIDEFINITE: f64 = 1e-12;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_semidefinite_matrix_has_a_lower_root() {
        let columns = Matrix::from_row_slice(4, 2, &[1.0, 0.5, -2.0, 1.0, 0.3, 0.2, 0.0, 3.0]);
        let covariance = &columns * columns.transpose();
        let root = lower_root(&covariance);
        assert!((&root * root.transpose() - &covariance).norm() < 1e-12 * covariance.norm());
        assert_eq!(root[(0, 1)], 0.0);
        assert_eq!(lower_root(&Matrix::zeros(2, 2)), Matrix::zeros(2, 2));
    }
}
