//! The lasso, by its regularisation path or from a nearby code.
//!
//! ```text
//! gap = λ‖α‖₁ − θ αᵀDᵀr + ½(1 − θ)²‖r‖²,   r = x − Dα,   θ = min(1, λ/‖Dᵀr‖_∞)
//! ```
//!
//! The path ends at the requested `λ` with the exact code; the gap, in a form free of cancellation, certifies it. If ties
//! or dependent columns break the path, coordinate descent and exact steps on its support complete it. A nearby previous
//! code already has the right support and signs: one exact step on it replaces the path.

use super::atoms::Atoms;
use super::code::DEFAULT_TOLERANCE;
use super::code::SparseCode;
use super::code::{Fit, Signal, in_order, used};
use super::encode::EncodeOne;
use super::path::Path;
use crate::AnalysisError;
use shapelex_numeric::cholesky::ActiveCholesky;
use shapelex_numeric::kernels::{add_scaled, column, dot, largest, largest_magnitude, sum_of_magnitudes};

/// Lasso coder with a certificate. On atoms of several columns, every column has a separate coefficient.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lasso {
    /// The penalty `λ > 0`.
    pub lambda: f64,
    /// Whether coefficients must be non-negative.
    pub nonnegative: bool,
    /// Duality gap to reach, relative to `½‖x‖²`.
    pub tolerance: f64,
}

/// A knot of the regularisation path. Between two knots the code is linear in `λ`.
#[derive(Debug, Clone, PartialEq)]
pub struct Knot {
    /// The penalty.
    pub lambda: f64,
    /// Atoms in use, ascending.
    pub indices: Vec<usize>,
    /// Their coefficients, `b` per atom.
    pub values: Vec<f64>,
}

/// Maximum number of rounds of coordinate descent and polishing.
const MAX_ROUNDS: usize = 1000;

/// Sweeps of coordinate descent per round: sweeps find the support, and polishing finds the values on it.
const SWEEPS: usize = 20;

/// Rounds of one sweep from a previous code. If the code is further away, the path is faster.
const WARM_ROUNDS: usize = 3;

/// Scratch memory of the lasso.
#[derive(Debug, Default)]
pub(super) struct LassoWork {
    path: Path,
    factor: ActiveCholesky,
    /// `α`, one number per column.
    code: Vec<f64>,
    /// `Dᵀr`.
    residual: Vec<f64>,
    /// The exact code of a support.
    target: Vec<f64>,
}

impl Lasso {
    /// A coder of signed or non-negative codes with the default tolerance.
    pub fn new(lambda: f64, nonnegative: bool) -> Self {
        Self { lambda, nonnegative, tolerance: DEFAULT_TOLERANCE }
    }

    /// The knots of the path of one whitened shape, from `λ_max` to `self.lambda`.
    pub fn path(&self, atoms: &Atoms, shape: &[f64]) -> Vec<Knot> {
        let correlation = |j: usize| dot(column(atoms.matrix(), j), shape);
        let correlations: Vec<f64> = (0..atoms.columns()).map(correlation).collect();
        let mut knots = Vec::new();
        Path::default().follow(self, atoms, &correlations, |lambda, columns, values| {
            let mut code = vec![0.0; atoms.columns()];
            columns.iter().zip(values).for_each(|(&j, &value)| code[j] = value);
            let (indices, values) = used(&code, atoms.block());
            knots.push(Knot { lambda, indices, values });
        });
        knots
    }

    /// `λ‖α‖₁`.
    pub(super) fn penalty(&self, values: &[f64]) -> f64 {
        self.lambda * sum_of_magnitudes(values)
    }

    /// Strength of a correlation against the penalty.
    pub(super) fn strength(&self, correlation: f64) -> f64 {
        if self.nonnegative { correlation } else { correlation.abs() }
    }

    /// The dual norm of correlations.
    pub(super) fn strongest(&self, correlations: &[f64]) -> f64 {
        if self.nonnegative { largest(correlations).max(0.0) } else { largest_magnitude(correlations) }
    }
}

impl EncodeOne for Lasso {
    type Work = LassoWork;

    /// Cost: `O(nJ)` per shape for the correlations and `O(Jk)` per step of its path, with `k` atoms in use; from a previous
    /// code `O(Jk + k³)` if support and signs do not change.
    fn code(
        &self,
        atoms: &Atoms,
        signal: &Signal<'_>,
        previous: Option<&SparseCode>,
        work: &mut LassoWork,
    ) -> Result<SparseCode, AnalysisError> {
        let mut at = Search { lasso: self, atoms, signal, work };
        match previous.and_then(|previous| at.resumed(previous)) {
            Some(code) => Ok(code),
            None => at.solved(),
        }
    }
}

/// The search for one code.
struct Search<'a> {
    lasso: &'a Lasso,
    atoms: &'a Atoms,
    signal: &'a Signal<'a>,
    work: &'a mut LassoWork,
}

impl Search<'_> {
    fn clear(&mut self) {
        self.work.code.clear();
        self.work.code.resize(self.atoms.columns(), 0.0);
    }

    /// The duality gap to reach.
    fn wanted(&self) -> f64 {
        self.lasso.tolerance * 0.5 * self.signal.energy
    }

    /// The code found from a previous one; `None` if that is too far away.
    fn resumed(&mut self, previous: &SparseCode) -> Option<SparseCode> {
        self.clear();
        if !previous.start(self.atoms, &mut self.work.code) {
            return None;
        }
        if self.lasso.nonnegative {
            self.work.code.iter_mut().for_each(|value| *value = value.max(0.0));
        }
        for round in 0..=WARM_ROUNDS {
            if round > 0 {
                self.sweep();
            }
            self.polish();
            let (fit, penalty, gap) = self.certificate();
            if gap <= self.wanted() {
                return Some(fit.measured(self.atoms, self.signal, &self.work.code, penalty, Some(gap)));
            }
        }
        None
    }

    /// The code found from the end of its path.
    fn solved(&mut self) -> Result<SparseCode, AnalysisError> {
        let (lasso, wanted, path) = (self.lasso, self.wanted(), &mut self.work.path);
        path.follow(lasso, self.atoms, self.signal.correlations, |_, _, _| ());
        let (fit, penalty, gap) = path.certificate(lasso, self.signal);
        if gap <= wanted {
            let code = in_order(path.columns(), path.values(), self.atoms.block());
            return Ok(fit.certified(self.signal, code, penalty, Some(gap)));
        }
        self.clear();
        let end = self.work.path.columns().iter().zip(self.work.path.values());
        end.for_each(|(&j, &value)| self.work.code[j] = value);
        self.completed()
    }

    /// The code found by descent from one that is not exact.
    fn completed(&mut self) -> Result<SparseCode, AnalysisError> {
        let mut best = f64::INFINITY;
        for _ in 0..=MAX_ROUNDS {
            let (fit, penalty, gap) = self.certificate();
            best = gap.min(best);
            if best <= self.wanted() {
                return Ok(fit.measured(self.atoms, self.signal, &self.work.code, penalty, Some(gap)));
            }
            let settled = (0..SWEEPS).any(|_| !self.sweep());
            self.polish();
            if settled && self.certificate().2 >= best {
                break;
            }
        }
        Err(AnalysisError::NoConvergence {
            index: 0,
            iterations: MAX_ROUNDS,
            gap: best,
            tolerance: self.wanted(),
        })
    }

    /// Fit, penalty and gap of the current code.
    fn certificate(&mut self) -> (Fit, f64, f64) {
        let LassoWork { code, residual, .. } = &mut *self.work;
        self.atoms.residual(self.signal.correlations, code, residual);
        let fit = Fit::of(self.signal, code, residual);
        let penalty = self.lasso.penalty(code);
        (fit, penalty, fit.gap(penalty, self.lasso.lambda, self.lasso.strongest(residual)))
    }

    /// Moves towards the exact code for the current support and signs, and drops coefficients that cross zero on the way. The
    /// objective never rises.
    fn polish(&mut self) {
        let LassoWork { code, factor, target, .. } = &mut *self.work;
        factor.clear();
        let mut used = (0..code.len()).filter(|&j| code[j] != 0.0);
        if !used.all(|j| factor.push(self.atoms.gram(), j)) {
            return;
        }
        loop {
            let right = |&j: &usize| self.signal.correlations[j] - self.lasso.lambda * code[j].signum();
            target.clear();
            target.extend(factor.indices().iter().map(right));
            factor.solve(target);
            let crossing = first_crossing(code, factor.indices(), target);
            let step = crossing.map_or(1.0, |(step, _)| step);
            for (&j, &t) in factor.indices().iter().zip(target.iter()) {
                code[j] += step * (t - code[j]);
            }
            let Some((_, position)) = crossing else { return };
            code[factor.indices()[position]] = 0.0;
            factor.remove(position);
        }
    }

    /// One pass of coordinate descent over all columns, with the residual up to date. Returns whether anything changed.
    fn sweep(&mut self) -> bool {
        let LassoWork { code, residual, .. } = &mut *self.work;
        let mut changed = false;
        for j in 0..code.len() {
            let gram = column(self.atoms.gram(), j);
            if gram[j] == 0.0 {
                continue;
            }
            let target = residual[j] + gram[j] * code[j];
            let size = (self.lasso.strength(target) - self.lasso.lambda).max(0.0) / gram[j];
            let new = target.signum() * size;
            if new != code[j] {
                add_scaled(residual, code[j] - new, gram);
                code[j] = new;
                changed = true;
            }
        }
        changed
    }
}

/// The fraction of the way to `target` at which the first coefficient reaches zero, with its position.
fn first_crossing(code: &[f64], columns: &[usize], target: &[f64]) -> Option<(f64, usize)> {
    let mut first: Option<(f64, usize)> = None;
    for (position, (&j, &t)) in columns.iter().zip(target).enumerate() {
        let step = code[j] / (code[j] - t);
        if t * code[j] <= 0.0 && first.is_none_or(|(least, _)| step < least) {
            first = Some((step, position));
        }
    }
    first
}
