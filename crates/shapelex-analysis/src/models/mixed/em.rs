//! Free covariances of groups and residuals, by expectation and maximisation.
//!
//! In the coordinates `T` with `TΣ_eTᵀ = I` and `TΣ_bTᵀ = diag g`, every coordinate has its own `h_i = g/(1 + n_i g)` and
//! `V⁻¹ = I − Z diag(h) Zᵀ`; with `K = (XᵀV⁻¹X)⁻¹`, `W = XᵀV⁻¹Z`, `U` and `E` the expected effects and residuals,
//!
//! ```text
//! Σ_b ← T⁻¹ (UᵀU + diag c_b) T⁻ᵀ/S,   c_b = Σ h_i + g² tr WᵀKW
//! Σ_e ← T⁻¹ (EᵀE + diag c_e) T⁻ᵀ/n,   c_e = Σ n_i h_i + tr K XᵀV⁻²X
//! ```
//!
//! Ordinary likelihood has no terms with `K`. Every three steps are extrapolated (SQUAREM), because the iteration is slow near singular
//! `Σ_b`. Sources: Laird and Ware 1982; Varadhan and Roland 2008.

use super::Criterion;
use super::sums::GroupSums;
use crate::AnalysisError;
use crate::watch::Watch;
use shapelex_numeric::dense::{self, Matrix};

/// Most rounds of three steps.
const ROUNDS: usize = 2000;
/// Change of an entry, over the largest, below which the iteration ends.
const STILL: f64 = 1e-10;

/// Covariances of groups and residuals.
#[derive(Debug, Clone)]
pub struct Covariances {
    /// `Σ_b`, `m × m`.
    pub between: Matrix,
    /// `Σ_e`, `m × m`.
    pub within: Matrix,
}

/// The optimum.
#[derive(Debug, Clone)]
pub struct Free {
    /// The covariances, of the effects of `Z`.
    pub covariances: Covariances,
    /// The log-likelihood.
    pub log_likelihood: f64,
    /// Whether `Σ_b` is singular.
    pub boundary: bool,
    /// Whether the iteration came to rest.
    pub converged: bool,
    /// Change of the coefficients of the basis from least squares, `p × m`.
    pub change: Matrix,
    /// Expected effects of the groups, `S × m`.
    pub effects: Matrix,
    /// Posterior variance of the effects of each group, summed over the coordinates.
    pub posterior: Vec<f64>,
}

/// What a step sees.
struct Step {
    next: Covariances,
    log_likelihood: f64,
    least: f64,
    change: Matrix,
    effects: Matrix,
    posterior: Vec<f64>,
}

/// The largest likelihood with free covariances, for `EᵀE` (`m × m`) of the residuals of the fixed part. `None` if these span fewer
/// dimensions than coordinates.
///
/// Cost of a step: `m³ + m (S p² + p³)`.
///
/// # Errors
/// [`AnalysisError::Interrupted`] once `watch` stops.
pub fn free(
    sums: &GroupSums,
    gram: &Matrix,
    criterion: Criterion,
    watch: &dyn Watch,
) -> Result<Option<Free>, AnalysisError> {
    let half = gram / (2.0 * sums.degrees(Criterion::Reml));
    let problem = Problem { sums, gram, criterion };
    let mut at = Covariances { between: half.clone(), within: half };
    let mut converged = false;
    for _ in 0..ROUNDS {
        watch.check()?;
        let Some(first) = problem.step(&at) else { return Ok(None) };
        if moved(&at, &first.next) < STILL {
            converged = true;
            break;
        }
        let Some(second) = problem.step(&first.next) else { return Ok(None) };
        at = match extrapolated(&at, &first.next, &second.next) {
            // The leap is kept only if it does not lose likelihood.
            Some(leap) => match problem.step(&leap) {
                Some(third) if third.log_likelihood >= second.log_likelihood => third.next,
                _ => second.next,
            },
            None => second.next,
        };
    }
    Ok(problem.step(&at).map(|last| Free {
        covariances: at,
        log_likelihood: last.log_likelihood,
        boundary: last.least < super::FLAT,
        converged,
        change: last.change,
        effects: last.effects,
        posterior: last.posterior,
    }))
}

/// Largest change of an entry over the largest entry.
fn moved(a: &Covariances, b: &Covariances) -> f64 {
    let largest = b.between.amax().max(b.within.amax());
    (&a.between - &b.between).amax().max((&a.within - &b.within).amax()) / largest
}

/// The leap along three points: `x_0 − 2αr + α²v`, `r = x_1 − x_0`, `v = x_2 − x_1 − r`, `α = −‖r‖/‖v‖`.
fn extrapolated(a: &Covariances, b: &Covariances, c: &Covariances) -> Option<Covariances> {
    let steps = |a: &Matrix, b: &Matrix, c: &Matrix| (b - a, c - b - (b - a));
    let (between, within) =
        (steps(&a.between, &b.between, &c.between), steps(&a.within, &b.within, &c.within));
    let length = |x: &Matrix, y: &Matrix| (x.norm_squared() + y.norm_squared()).sqrt();
    let alpha = -length(&between.0, &within.0) / length(&between.1, &within.1);
    let leap = |a: &Matrix, (r, v): &(Matrix, Matrix)| a - r * (2.0 * alpha) + v * (alpha * alpha);
    (alpha < -1.0 && alpha.is_finite())
        .then(|| Covariances { between: leap(&a.between, &between), within: leap(&a.within, &within) })
}

struct Problem<'a> {
    sums: &'a GroupSums,
    gram: &'a Matrix,
    criterion: Criterion,
}

impl Problem<'_> {
    /// One step; `None` if the covariances are not positive.
    fn step(&self, at: &Covariances) -> Option<Step> {
        let (sums, m) = (self.sums, self.gram.nrows());
        let cholesky = at.within.clone().cholesky()?;
        let lower = cholesky.l();
        let half = lower.solve_lower_triangular(&at.between)?;
        let relative = lower.solve_lower_triangular(&half.transpose())?;
        let eigen = dense::symmetric_eigen(&(0.5 * (&relative + relative.transpose())));
        let (least, most) = (eigen.eigenvalues.min(), eigen.eigenvalues.max());
        if !(least > -1e-10 * (1.0 + most)) {
            return None;
        }
        let back = &lower * &eigen.eigenvectors;
        // T = (C W)⁻¹, one column for each coordinate of Tᵀ.
        let forward = lower.transpose().solve_upper_triangular(&eigen.eigenvectors)?;
        let gram = forward.transpose() * self.gram * &forward;
        let effects =
            Matrix::from_fn(sums.ze.len(), m, |i, k| sums.ze[i].row(0).dot(&forward.column(k).transpose()));
        let own: Vec<Coordinate> = (0..m)
            .map(|k| self.coordinate(eigen.eigenvalues[k].max(0.0), &effects, gram[(k, k)], k))
            .collect::<Option<_>>()?;
        let (degrees, count) = (sums.degrees(self.criterion), m as f64);
        let log_within = 2.0 * lower.diagonal().iter().map(|pivot| pivot.ln()).sum::<f64>();
        let restricted = if self.is_restricted() { count * sums.log_design } else { 0.0 };
        let all: f64 = own.iter().map(|own| own.terms).sum();
        let constant = degrees * count * std::f64::consts::TAU.ln();
        let log_likelihood =
            -0.5 * (constant + degrees * log_within + restricted + all) + 0.5 * count * sums.log_weights;
        let next = self.next(&own, &gram, &back);
        let of = |rows: usize, get: &dyn Fn(&Coordinate, usize) -> f64| {
            Matrix::from_fn(rows, m, |i, k| get(&own[k], i)) * back.transpose()
        };
        let change = of(sums.rank(), &|own, i| own.change[i]);
        let effects = of(sums.zz.len(), &|own, i| own.effects[i]);
        let lengths: Vec<f64> = back.column_iter().map(|column| column.norm_squared()).collect();
        let posterior = |zz: &Matrix| {
            let of = |(g, length): (&f64, &f64)| length * g.max(0.0) / (1.0 + zz[(0, 0)] * g.max(0.0));
            eigen.eigenvalues.iter().zip(&lengths).map(of).sum()
        };
        let posterior = sums.zz.iter().map(posterior).collect();
        Some(Step { next, log_likelihood, least, change, effects, posterior })
    }

    fn is_restricted(&self) -> bool {
        self.criterion == Criterion::Reml
    }

    /// A canonical coordinate with the variance `g`.
    fn coordinate(&self, g: f64, effects: &Matrix, square: f64, k: usize) -> Option<Coordinate> {
        let (sums, p) = (self.sums, self.sums.rank());
        let h: Vec<f64> = sums.zz.iter().map(|zz| g / (1.0 + zz[(0, 0)] * g)).collect();
        let (mut inside, mut twice) = (Matrix::identity(p, p), Matrix::identity(p, p));
        let (mut along, mut total, mut log_determinant) = (Matrix::zeros(p, 1), square, 0.0);
        for (i, (zq, &h)) in sums.zq.iter().zip(&h).enumerate() {
            let (n, z) = (sums.zz[i][(0, 0)], effects[(i, k)]);
            let outer = zq.transpose() * zq;
            inside -= &outer * h;
            twice -= outer * (2.0 * h - n * h * h);
            along -= zq.transpose() * (h * z);
            total -= h * z * z;
            log_determinant += (n * g).ln_1p();
        }
        let cholesky = inside.cholesky()?;
        let inverse = cholesky.inverse();
        let change = &inverse * &along;
        total -= change.dot(&along);
        let left: Vec<f64> =
            sums.zq.iter().enumerate().map(|(i, zq)| effects[(i, k)] - (zq * &change)[(0, 0)]).collect();
        let expected = left.iter().zip(&h).map(|(left, h)| left * h).collect();
        let (mut of_groups, mut of_residuals) = (h.iter().sum::<f64>(), 0.0);
        for (i, (zq, &h)) in sums.zq.iter().zip(&h).enumerate() {
            let n = sums.zz[i][(0, 0)];
            of_residuals += n * h;
            if self.is_restricted() {
                of_groups += (g / (1.0 + n * g)).powi(2) * (zq * &inverse * zq.transpose())[(0, 0)];
            }
        }
        let mut terms = log_determinant + total;
        if self.is_restricted() {
            of_residuals += inverse.dot(&twice.transpose());
            terms += 2.0 * cholesky.l_dirty().diagonal().iter().map(|pivot| pivot.ln()).sum::<f64>();
        }
        let change = change.iter().copied().collect();
        Some(Coordinate { change, left, effects: expected, of_groups, of_residuals, terms })
    }

    fn next(&self, own: &[Coordinate], gram: &Matrix, back: &Matrix) -> Covariances {
        let sums = self.sums;
        let groups = Matrix::from_fn(own.len(), own.len(), |k, l| {
            let products = own[k].effects.iter().zip(&own[l].effects).map(|(a, b)| a * b).sum::<f64>();
            products + if k == l { own[k].of_groups } else { 0.0 }
        });
        let residuals = Matrix::from_fn(own.len(), own.len(), |k, l| {
            let (a, b) = (&own[k], &own[l]);
            let fixed: f64 = a.change.iter().zip(&b.change).map(|(a, b)| a * b).sum();
            let of = |i: usize| {
                let n = sums.zz[i][(0, 0)];
                n * a.effects[i] * b.effects[i] - a.effects[i] * b.left[i] - b.effects[i] * a.left[i]
            };
            let random: f64 = (0..a.effects.len()).map(of).sum();
            gram[(k, l)] + fixed + random + if k == l { a.of_residuals } else { 0.0 }
        });
        Covariances {
            between: back * groups * back.transpose() / sums.zz.len() as f64,
            within: back * residuals * back.transpose() / sums.shapes as f64,
        }
    }
}

/// A canonical coordinate.
struct Coordinate {
    /// Change of the coefficients.
    change: Vec<f64>,
    /// `Z_iᵀr`.
    left: Vec<f64>,
    /// Expected effects.
    effects: Vec<f64>,
    /// `c_b`.
    of_groups: f64,
    /// `c_e`.
    of_residuals: f64,
    /// Its part of `−2ℓ`.
    terms: f64,
}
