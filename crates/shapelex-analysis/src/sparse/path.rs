//! The regularisation path of the lasso.
//!
//! ```text
//! α_A(λ − γ) = α_A(λ) + γ v,   v = G_AA⁻¹ s_A        G = DᵀD,  s the signs on the active set A
//! Dᵀr(λ − γ) = Dᵀr(λ) − γ q,   q = G_{·A} v
//! ```
//!
//! From `λ_max` downwards the code is linear between knots. At a knot a column joins (its correlation with the residual
//! reaches the penalty) or leaves (its coefficient reaches zero). A step costs one solve and one product with `k` columns
//! of the Gram matrix, without allocation.
//!
//! Source: Osborne, Presnell, Turlach 2000 and Efron et al. 2004.

use super::atoms::Atoms;
use super::lasso::Lasso;
use shapelex_numeric::cholesky::ActiveCholesky;
use shapelex_numeric::kernels::{add_columns, add_scaled};

/// Relative step, as a fraction of the current penalty, below which nothing happens: a coefficient that has just joined at
/// zero does not leave there.
const SAME: f64 = 1e-12;

/// Number of columns that are checked together for joining.
const GLANCE: usize = 8;

/// The state of the path at the penalty `lambda`.
#[derive(Debug, Default)]
pub(super) struct Path {
    lambda: f64,
    /// `A` with the factor of `G_AA`.
    factor: ActiveCholesky,
    /// `s_A`.
    signs: Vec<f64>,
    /// `α_A`.
    values: Vec<f64>,
    /// `L⁻¹s_A` with the factor `L` of `G_AA`.
    half: Vec<f64>,
    /// `v`.
    direction: Vec<f64>,
    /// `Dᵀr`, exactly `λ s` on the active set.
    residual: Vec<f64>,
    /// `q`, exactly `s` on the active set.
    slope: Vec<f64>,
    /// Columns that depend on active ones, until one of those leaves.
    dependent: Vec<usize>,
    /// The column that has just left, with its sign: its correlation and the penalty cross once between knots.
    dropped: Option<(usize, f64)>,
}

/// Event that ends a step.
#[derive(Debug, Clone, Copy)]
enum Event {
    /// The requested penalty is reached.
    End,
    /// This column joins with this sign.
    Join(usize, f64),
    /// The active column at this position leaves.
    Drop(usize),
}

impl Path {
    /// Active columns, in arbitrary order.
    pub(super) fn columns(&self) -> &[usize] {
        self.factor.indices()
    }

    /// Their coefficients.
    pub(super) fn values(&self) -> &[f64] {
        &self.values
    }

    /// Follows the path of a shape with `correlations = Dᵀx` from `λ_max` to the penalty of `lasso`. `visit` is called at
    /// every knot and at the end.
    pub(super) fn follow(
        &mut self,
        lasso: &Lasso,
        atoms: &Atoms,
        correlations: &[f64],
        mut visit: impl FnMut(f64, &[usize], &[f64]),
    ) {
        self.reset(lasso, correlations);
        if !(self.lambda > lasso.lambda) {
            return;
        }
        // A path has few more knots than columns. The limit is for paths that rounding sends round in circles.
        for _ in 0..8 * atoms.columns() + 8 {
            self.turn(atoms);
            let (step, event) = self.next_event(lasso);
            self.advance(step);
            match event {
                Event::End => {
                    self.lambda = lasso.lambda;
                    self.settle(correlations);
                    visit(self.lambda, self.columns(), &self.values);
                    return;
                }
                Event::Join(column, sign) => {
                    visit(self.lambda, self.columns(), &self.values);
                    self.join(atoms, column, sign);
                }
                Event::Drop(position) => {
                    self.values[position] = 0.0;
                    visit(self.lambda, self.columns(), &self.values);
                    self.drop(position);
                }
            }
        }
    }

    /// Starts at `λ_max` without active columns.
    fn reset(&mut self, lasso: &Lasso, correlations: &[f64]) {
        self.factor.clear();
        self.signs.clear();
        self.half.clear();
        self.values.clear();
        self.dependent.clear();
        self.dropped = None;
        self.residual.clear();
        self.residual.extend_from_slice(correlations);
        self.lambda = lasso.strongest(correlations);
    }

    /// Computes the direction from here, and the resulting slope of the correlations.
    fn turn(&mut self, atoms: &Atoms) {
        self.direction.clear();
        self.direction.extend_from_slice(&self.half);
        self.factor.solve_upper(&mut self.direction);
        self.slope.clear();
        self.slope.resize(self.residual.len(), 0.0);
        add_columns(&mut self.slope, atoms.gram().as_slice(), self.factor.indices(), &self.direction);
        for (&j, &sign) in self.factor.indices().iter().zip(&self.signs) {
            self.slope[j] = sign;
        }
    }

    /// The first event below the current penalty, and the step to it. Active columns need no special treatment: their step to
    /// their own sign does not exist, and the one to the other sign is below zero.
    fn next_event(&self, lasso: &Lasso) -> (f64, Event) {
        let mut first = (self.lambda - lasso.lambda, Event::End);
        let (residuals, last_residuals) = self.residual.as_chunks::<GLANCE>();
        let (slopes, last_slopes) = self.slope.as_chunks::<GLANCE>();
        let mut base = 0;
        for (residual, slope) in residuals.iter().zip(slopes) {
            if outgrows(lasso, residual, slope, first.0, self.lambda - first.0) {
                self.consider(lasso, base, residual, slope, &mut first);
            }
            base += GLANCE;
        }
        self.consider(lasso, base, last_residuals, last_slopes, &mut first);
        for (position, (value, direction)) in self.values.iter().zip(&self.direction).enumerate() {
            let step = -value / direction;
            if step > SAME * self.lambda && step <= first.0 {
                first = (step, Event::Drop(position));
            }
        }
        first
    }

    /// Updates `first` if one of the columns from `base` on joins earlier: `sign (r − γ q) = λ − γ`, with the sign of the
    /// correlation that exceeds the penalty after the step.
    fn consider(
        &self,
        lasso: &Lasso,
        base: usize,
        residual: &[f64],
        slope: &[f64],
        first: &mut (f64, Event),
    ) {
        for (j, (&r, &q)) in (base..).zip(residual.iter().zip(slope)) {
            let reached = r - first.0 * q;
            if !(lasso.strength(reached) > self.lambda - first.0) {
                continue;
            }
            let sign = reached.signum();
            let (room, speed) = ((self.lambda - sign * r).max(0.0), 1.0 - sign * q);
            if room < first.0 * speed && self.may_join(j, sign) {
                *first = (room / speed, Event::Join(j, sign));
            }
        }
    }

    fn may_join(&self, column: usize, sign: f64) -> bool {
        self.dropped != Some((column, sign)) && !self.dependent.contains(&column)
    }

    fn advance(&mut self, step: f64) {
        self.lambda -= step;
        add_scaled(&mut self.values, step, &self.direction);
        add_scaled(&mut self.residual, -step, &self.slope);
        for (&j, sign) in self.factor.indices().iter().zip(&self.signs) {
            self.residual[j] = sign * self.lambda;
        }
        self.dropped = None;
    }

    fn join(&mut self, atoms: &Atoms, column: usize, sign: f64) {
        if self.factor.push(atoms.gram(), column) {
            self.half.push(self.factor.last_of_lower(&self.half, sign));
            self.signs.push(sign);
            self.values.push(0.0);
            self.residual[column] = sign * self.lambda;
        } else {
            self.dependent.push(column);
        }
    }

    fn drop(&mut self, position: usize) {
        self.dropped = Some((self.factor.indices()[position], self.signs.remove(position)));
        self.values.remove(position);
        self.factor.remove(position);
        self.half.clear();
        self.half.extend_from_slice(&self.signs);
        self.factor.solve_lower(&mut self.half);
        self.dependent.clear();
    }

    /// Recomputes the coefficients at the current penalty, `G_AA⁻¹(c_A − λ s_A)`, to remove the rounding of the steps.
    fn settle(&mut self, correlations: &[f64]) {
        for ((value, &j), sign) in self.values.iter_mut().zip(self.factor.indices()).zip(&self.signs) {
            *value = correlations[j] - self.lambda * sign;
        }
        self.factor.solve(&mut self.values);
    }
}

/// Whether any correlation `r − step·q` exceeds the penalty left after the step. Branch-free, because few columns do.
fn outgrows(lasso: &Lasso, r: &[f64; GLANCE], q: &[f64; GLANCE], step: f64, penalty: f64) -> bool {
    let mut any = false;
    for (r, q) in r.iter().zip(q) {
        any |= lasso.strength(r - step * q) > penalty;
    }
    any
}
