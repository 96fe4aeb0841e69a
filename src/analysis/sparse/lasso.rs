//! The lasso by its regularisation path.
//!
//! ```text
//! α_A(λ) = u − λ v,   u = G_AA⁻¹ c_A,   v = G_AA⁻¹ s_A        c = Dᵀx,  G = DᵀD,  s the signs on the active set A
//! gap = λ‖α‖₁ − θ αᵀDᵀr + ½(1 − θ)²‖r‖²,   r = x − Dα,   θ = min(1, λ/‖Dᵀr‖_∞)
//! ```
//!
//! From `λ_max` down the code is linear between knots where an atom joins (its correlation with the residual reaches
//! `λ`) or leaves (its coefficient reaches zero). The path ends at the wanted `λ` with the exact code; the gap, in a form
//! free of cancellation, proves it. Where ties and dependent atoms break the path, coordinate descent and exact steps on its support finish.
//!
//! Source: Osborne, Presnell, Turlach 2000 and Efron et al. 2004 for the path; the dual is the usual one.

use super::{Atoms, Signal, SparseCode, ascending};
use crate::analysis::AnalysisError;
use crate::analysis::metric::dot;
use crate::numeric::cholesky::ActiveCholesky;

/// Lasso codes to a certificate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lasso {
    /// The penalty `λ > 0`.
    pub lambda: f64,
    /// Whether coefficients must not be negative.
    pub nonnegative: bool,
    /// Gap that is reached, relative to `½‖x‖²`.
    pub tolerance: f64,
}

/// A knot of the regularisation path: the code is linear in `λ` between two of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Knot {
    /// The penalty.
    pub lambda: f64,
    /// Atoms that are used, ascending.
    pub indices: Vec<usize>,
    /// Their coefficients.
    pub values: Vec<f64>,
}

/// A gap of `10⁻¹⁰` of `½‖x‖²` says that ten digits of the objective are right.
const DEFAULT_TOLERANCE: f64 = 1e-10;

/// Rounds of coordinate descent and polishing at the most.
const MAX_ROUNDS: usize = 1000;

/// Sweeps of coordinate descent in a round: they find the support, polishing the values on it.
const SWEEPS: usize = 20;

/// A knot this near above the present penalty is at it.
const SAME: f64 = 1e-12;

impl Lasso {
    /// Signed or non-negative codes with the default tolerance.
    pub fn new(lambda: f64, nonnegative: bool) -> Self {
        Self { lambda, nonnegative, tolerance: DEFAULT_TOLERANCE }
    }

    /// The codes of whitened `shapes` (`n` numbers each). Cost `O(nJ)` for the correlations of a shape and `O(Jk)` for
    /// every step of its path, with `k` atoms in use.
    ///
    /// # Errors
    /// [`AnalysisError::NoConvergence`] when the gap of a shape is not reached, with the one that is.
    pub fn codes(&self, atoms: &Atoms, shapes: &[f64]) -> Result<Vec<SparseCode>, AnalysisError> {
        atoms.each(shapes, |signal| self.code(atoms, signal))
    }

    /// The knots of the path of one whitened shape from `λ_max` to `self.lambda`.
    pub fn path(&self, atoms: &Atoms, shape: &[f64]) -> Vec<Knot> {
        let correlations: Vec<f64> =
            atoms.matrix().column_iter().map(|atom| dot(atom.as_slice(), shape)).collect();
        let signal = Signal { correlations: &correlations, energy: dot(shape, shape) };
        let mut knots = Vec::new();
        self.follow(atoms, &signal, |lambda, indices, values| {
            let (indices, values) = ascending(indices, values);
            knots.push(Knot { lambda, indices, values });
        });
        knots
    }

    fn code(&self, atoms: &Atoms, signal: &Signal<'_>) -> Result<SparseCode, AnalysisError> {
        let mut code = vec![0.0; atoms.len()];
        self.follow(atoms, signal, |_, indices, values| {
            code.iter_mut().for_each(|value| *value = 0.0);
            indices.iter().zip(values).for_each(|(&j, &value)| code[j] = value);
        });
        let wanted = self.tolerance * 0.5 * signal.energy;
        let mut gap = f64::INFINITY;
        for _ in 0..=MAX_ROUNDS {
            let certified = self.certified(atoms, signal, &code);
            gap = certified.duality_gap.unwrap_or(f64::INFINITY).min(gap);
            if gap <= wanted {
                return Ok(certified);
            }
            let settled = (0..SWEEPS).any(|_| !self.sweep(atoms, signal, &mut code));
            self.polish(atoms, signal, &mut code);
            if settled && self.certified(atoms, signal, &code).duality_gap.is_some_and(|now| now >= gap) {
                break;
            }
        }
        Err(AnalysisError::NoConvergence { iterations: MAX_ROUNDS, gap, tolerance: wanted })
    }

    /// Moves towards the exact code of the present support and signs, leaving out what crosses zero on the way: the
    /// objective never rises.
    fn polish(&self, atoms: &Atoms, signal: &Signal<'_>, code: &mut [f64]) {
        loop {
            let support: Vec<usize> = (0..code.len()).filter(|&j| code[j] != 0.0).collect();
            let mut factor = ActiveCholesky::default();
            if !support.iter().all(|&j| factor.push(atoms.gram(), j)) {
                return;
            }
            let right = |&j: &usize| signal.correlations[j] - self.lambda * code[j].signum();
            let mut target: Vec<f64> = support.iter().map(right).collect();
            factor.solve(&mut target);
            let crossings = support.iter().zip(&target).filter(|&(&j, &t)| t * code[j] <= 0.0);
            let first =
                crossings.map(|(&j, &t)| (code[j] / (code[j] - t), j)).fold(None, |best, next| match best {
                    Some(other) if other <= next => Some(other),
                    _ => Some(next),
                });
            let step = first.map_or(1.0, |(step, _)| step);
            for (&j, &t) in support.iter().zip(&target) {
                code[j] += step * (t - code[j]);
            }
            match first {
                Some((_, j)) => code[j] = 0.0,
                None => return,
            }
        }
    }

    /// What a correlation counts towards the penalty.
    fn strength(&self, correlation: f64) -> f64 {
        if self.nonnegative { correlation } else { correlation.abs() }
    }

    /// Follows the path from `λ_max` to `self.lambda`; `visit` sees every knot and the end.
    fn follow(&self, atoms: &Atoms, signal: &Signal<'_>, mut visit: impl FnMut(f64, &[usize], &[f64])) {
        let (gram, c) = (atoms.gram(), signal.correlations);
        let mut factor = ActiveCholesky::default();
        let mut signs: Vec<f64> = Vec::new();
        // Atoms that depend on active ones, until something changes the set.
        let mut dependent = vec![false; atoms.len()];
        // A correlation and the penalty cross once between knots: what leaves does not come back with its sign.
        let mut dropped: Option<(usize, f64)> = None;
        let first = (0..atoms.len()).fold(None, |best: Option<usize>, j| match best {
            Some(other) if self.strength(c[other]) >= self.strength(c[j]) => best,
            _ => Some(j),
        });
        let Some(first) = first.filter(|&j| self.strength(c[j]) > self.lambda) else { return };
        let mut current = self.strength(c[first]);
        factor.push(gram, first);
        signs.push(c[first].signum());
        visit(current, factor.indices(), &[0.0]);
        // A path has few knots more than atoms; a limit for those that rounding makes go round in circles.
        for _ in 0..8 * atoms.len() + 8 {
            let active = factor.indices().to_vec();
            let (mut u, mut v): (Vec<f64>, Vec<f64>) =
                (active.iter().map(|&j| c[j]).collect(), signs.clone());
            factor.solve(&mut u);
            factor.solve(&mut v);
            let join = self.next_join(atoms, c, &active, &u, &v, current, |j, sign| {
                dependent[j] || dropped == Some((j, sign))
            });
            let drop = (0..active.len())
                .map(|i| (u[i] / v[i], i))
                .filter(|(lambda, _)| *lambda > 0.0 && *lambda < current * (1.0 - SAME))
                .fold(None, |best: Option<(f64, usize)>, next| match best {
                    Some(other) if other.0 >= next.0 => best,
                    _ => Some(next),
                });
            let next = join.map_or(0.0, |(lambda, ..)| lambda).max(drop.map_or(0.0, |(lambda, _)| lambda));
            let lambda = next.max(self.lambda);
            let mut values: Vec<f64> = u.iter().zip(&v).map(|(u, v)| u - lambda * v).collect();
            dropped = None;
            match (join, drop) {
                _ if next <= self.lambda => {
                    visit(self.lambda, &active, &values);
                    return;
                }
                (_, Some((lambda, position))) if lambda >= next => {
                    values[position] = 0.0;
                    visit(lambda, &active, &values);
                    dropped = Some((active[position], signs[position]));
                    let kept: Vec<(usize, f64)> = active.iter().copied().zip(signs.iter().copied()).collect();
                    factor.remove(gram, position);
                    let sign = |j: &usize| kept.iter().find(|(index, _)| index == j).map_or(1.0, |(_, s)| *s);
                    signs = factor.indices().iter().map(sign).collect();
                    dependent.iter_mut().for_each(|flag| *flag = false);
                }
                (Some((lambda, index, sign)), _) => {
                    visit(lambda, &active, &values);
                    if factor.push(gram, index) {
                        signs.push(sign);
                    } else {
                        dependent[index] = true;
                    }
                }
                (None, _) => return,
            }
            current = lambda;
            if factor.indices().is_empty() {
                return;
            }
        }
    }

    /// The largest penalty up to `current` at which an atom joins, with the atom and its sign.
    #[allow(clippy::too_many_arguments)] // the state of the path, in the letters of its formula
    fn next_join(
        &self,
        atoms: &Atoms,
        c: &[f64],
        active: &[usize],
        u: &[f64],
        v: &[f64],
        current: f64,
        excluded: impl Fn(usize, f64) -> bool,
    ) -> Option<(f64, usize, f64)> {
        // Dᵀr = p + λ q on the inactive atoms
        let (mut p, mut q) = (c.to_vec(), vec![0.0; c.len()]);
        for ((&a, u), v) in active.iter().zip(u).zip(v) {
            let column = atoms.gram().column(a);
            for ((p, q), g) in p.iter_mut().zip(&mut q).zip(column.iter()) {
                *p -= u * g;
                *q += v * g;
            }
        }
        let signs: &[f64] = if self.nonnegative { &[1.0] } else { &[1.0, -1.0] };
        let mut best: Option<(f64, usize, f64)> = None;
        for j in (0..c.len()).filter(|j| !active.contains(j)) {
            for &sign in signs.iter().filter(|&&sign| !excluded(j, sign)) {
                // sign (p + λ q) = λ, and the correlation outgrows λ below it
                let slope = 1.0 - sign * q[j];
                if slope <= 0.0 {
                    continue;
                }
                let lambda = (sign * p[j] / slope).min(current);
                if lambda > 0.0 && best.is_none_or(|(other, ..)| lambda > other) {
                    best = Some((lambda, j, sign));
                }
            }
        }
        best
    }

    /// One pass of coordinate descent over all atoms; whether anything changed.
    fn sweep(&self, atoms: &Atoms, signal: &Signal<'_>, code: &mut [f64]) -> bool {
        let all: Vec<usize> = (0..code.len()).collect();
        let mut residual = atoms.residual_correlations(signal, &all, code);
        let mut changed = false;
        for j in 0..code.len() {
            let curvature = atoms.gram()[(j, j)];
            if curvature == 0.0 {
                continue;
            }
            let target = residual[j] + curvature * code[j];
            let new = target.signum() * (self.strength(target) - self.lambda).max(0.0) / curvature;
            if new != code[j] {
                let step = code[j] - new;
                residual.iter_mut().zip(atoms.gram().column(j).iter()).for_each(|(r, g)| *r += step * g);
                code[j] = new;
                changed = true;
            }
        }
        changed
    }

    fn certified(&self, atoms: &Atoms, signal: &Signal<'_>, code: &[f64]) -> SparseCode {
        let all: Vec<usize> = (0..code.len()).collect();
        let (indices, values) = ascending(&all, code);
        let residual = atoms.residual_correlations(signal, &indices, &values);
        let strongest = residual.iter().map(|&r| self.strength(r)).fold(0.0, f64::max);
        let theta = if strongest > self.lambda { self.lambda / strongest } else { 1.0 };
        let penalty = self.lambda * values.iter().map(|value| value.abs()).sum::<f64>();
        let fitted: f64 = indices.iter().zip(&values).map(|(&j, value)| value * residual[j]).sum();
        let found = atoms.measured(signal, indices, values, self.lambda);
        let error = 2.0 * (found.objective - penalty);
        let gap = penalty - theta * fitted + 0.5 * (1.0 - theta).powi(2) * error;
        SparseCode { duality_gap: Some(gap.max(0.0)), ..found }
    }
}
