//! Sparse codes.
//!
//! ```text
//! min_α ½‖x − Dα‖² + λ‖α‖₁      gap = primal − dual,  dual(θ) = ½‖x‖² − ½‖x − θ‖²,  ‖Dᵀθ‖_∞ ≤ λ
//! ```
//!
//! in whitened coordinates (`n = d·N` rows), where norms are `L₂` norms of shapes. Coordinate descent on the
//! precomputed Gram matrix finds the support and signs; on them the code is the solution of a small linear system,
//! exact to rounding. The answer carries its duality gap.
//!
//! Source: Schmitter 2017, (4.27) with the square that Theorem 3 misses; the dual is the usual one of the lasso.

use super::AnalysisError;
use super::metric::dot;
use crate::numeric::dense::{Matrix, Vector, transpose_multiply};

/// Sweeps of coordinate descent at the most.
const MAX_SWEEPS: usize = 100_000;

/// Atoms of a dictionary with their Gram matrix, made ready for many codes.
#[derive(Debug, Clone)]
pub struct Lasso {
    atoms: Matrix,
    gram: Matrix,
    lambda: f64,
    /// Gap that is reached, relative to `½‖x‖²`.
    tolerance: f64,
}

/// A sparse code with its certificate.
#[derive(Debug, Clone, PartialEq)]
pub struct SparseCode {
    /// `α`, one entry an atom.
    pub code: Vec<f64>,
    /// `½‖x − Dα‖² + λ‖α‖₁`.
    pub objective: f64,
    /// Primal minus dual value: the objective is at most this far above the minimum.
    pub duality_gap: f64,
}

impl Lasso {
    /// For the whitened atoms (one a column, `n × J`), the penalty `λ > 0` and a relative gap.
    pub fn new(atoms: Matrix, lambda: f64, tolerance: f64) -> Self {
        let gram = transpose_multiply(&atoms, &atoms);
        Self { atoms, gram, lambda, tolerance }
    }

    /// `‖Dᵀx‖_∞`: from this penalty on the code is zero.
    pub fn lambda_max(&self, x: &[f64]) -> f64 {
        self.correlations(x).amax()
    }

    fn correlations(&self, x: &[f64]) -> Vector {
        Vector::from_iterator(
            self.atoms.ncols(),
            self.atoms.column_iter().map(|atom| dot(atom.as_slice(), x)),
        )
    }

    /// The code of the whitened shape `x`.
    ///
    /// Cost `O(nJ)` for the correlations and `O(J)` per changed coefficient and sweep.
    ///
    /// # Errors
    /// [`AnalysisError::NoConvergence`] when the gap is not reached, with the one that is.
    pub fn code(&self, x: &[f64]) -> Result<SparseCode, AnalysisError> {
        let correlations = self.correlations(x);
        let energy = 0.5 * dot(x, x);
        let wanted = self.tolerance * energy;
        let mut code = Vector::zeros(self.atoms.ncols());
        // Dᵀ(x − Dα), kept up to date
        let mut residual = correlations.clone();
        let mut best: Option<SparseCode> = None;
        for sweep in 0..MAX_SWEEPS {
            let changed = self.sweep(&mut code, &mut residual);
            // The certificate costs a product with the atoms: look when the sweep did little, and now and then.
            if sweep % 10 != 9 && changed > 1e-3 * self.lambda {
                continue;
            }
            for candidate in [self.polished(&code, &correlations), Some(code.clone())].into_iter().flatten() {
                let certified = self.certify(x, candidate);
                if best.as_ref().is_none_or(|b| certified.duality_gap < b.duality_gap) {
                    best = Some(certified);
                }
            }
            if let Some(found) = best.as_ref().filter(|b| b.duality_gap <= wanted) {
                return Ok(found.clone());
            }
            if changed == 0.0 {
                break;
            }
        }
        let gap = best.map_or(f64::INFINITY, |b| b.duality_gap);
        Err(AnalysisError::NoConvergence { iterations: MAX_SWEEPS, gap, tolerance: wanted })
    }

    /// One pass over all atoms; the largest change of a correlation.
    fn sweep(&self, code: &mut Vector, residual: &mut Vector) -> f64 {
        let mut largest: f64 = 0.0;
        for j in 0..code.len() {
            let curvature = self.gram[(j, j)];
            if curvature == 0.0 {
                continue;
            }
            let old = code[j];
            let new = soft(residual[j] + curvature * old, self.lambda) / curvature;
            if new != old {
                residual.axpy(old - new, &self.gram.column(j), 1.0);
                code[j] = new;
                largest = largest.max((new - old).abs() * curvature);
            }
        }
        largest
    }

    /// The exact solution for the support and signs of `code`, when it keeps them:
    /// `G_AA α_A = D_Aᵀx − λ sign(α_A)`.
    fn polished(&self, code: &Vector, correlations: &Vector) -> Option<Vector> {
        let support: Vec<usize> = (0..code.len()).filter(|&j| code[j] != 0.0).collect();
        let k = support.len();
        let gram = Matrix::from_fn(k, k, |a, b| self.gram[(support[a], support[b])]);
        let right =
            Vector::from_fn(k, |a, _| correlations[support[a]] - self.lambda * code[support[a]].signum());
        let solution = gram.cholesky()?.solve(&right);
        let keeps = support.iter().zip(solution.iter()).all(|(&j, value)| value * code[j] > 0.0);
        keeps.then(|| {
            let mut polished = Vector::zeros(code.len());
            support.iter().zip(solution.iter()).for_each(|(&j, &value)| polished[j] = value);
            polished
        })
    }

    fn certify(&self, x: &[f64], code: Vector) -> SparseCode {
        let residual = Vector::from_column_slice(x) - &self.atoms * &code;
        let objective = 0.5 * residual.norm_squared() + self.lambda * code.lp_norm(1);
        let bound = self.lambda / self.correlations(residual.as_slice()).amax().max(f64::MIN_POSITIVE);
        let energy = residual.norm_squared().max(f64::MIN_POSITIVE);
        let scale = (dot(x, residual.as_slice()) / energy).clamp(-bound, bound);
        let dual = 0.5 * dot(x, x) - 0.5 * (Vector::from_column_slice(x) - residual * scale).norm_squared();
        SparseCode { code: code.as_slice().to_vec(), objective, duality_gap: (objective - dual).max(0.0) }
    }
}

/// `sign(v) max(|v| − λ, 0)`.
fn soft(value: f64, lambda: f64) -> f64 {
    value.signum() * (value.abs() - lambda).max(0.0)
}
