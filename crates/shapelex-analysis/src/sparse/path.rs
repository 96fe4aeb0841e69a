//! The regularisation path of the lasso.
//!
//! ```text
//! α_A(λ − γ) = α_A(λ) + γ v,   v = G_AA⁻¹ s_A        G = DᵀD,  s the signs on the active set A
//! Dᵀr(λ − γ) = Dᵀr(λ) − γ q,   q = G_{·A} v
//! ```
//!
//! From `λ_max` downwards the code is linear between knots. At a knot a column joins (its correlation with the residual
//! reaches the penalty) or leaves (its coefficient reaches zero). A step costs one solve and one pass over the columns: it
//! takes the step before, forms the new slope from `k` columns of the Gram matrix, and looks for the next event.
//!
//! Source: Osborne, Presnell, Turlach 2000 and Efron et al. 2004.

use super::atoms::Atoms;
use super::code::{Fit, Signal};
use super::lasso::Lasso;
use shapelex_numeric::cholesky::ActiveCholesky;
use shapelex_numeric::kernels::{add_scaled, column};
use shapelex_numeric::lanes::{
    ColumnStack, LANES, Lanes, Largest, Pieces, add_pieces, set_pieces, vectorised,
};

/// Relative step, as a fraction of the current penalty, below which nothing happens: a coefficient that has just joined at
/// zero does not leave there.
const SAME: f64 = 1e-12;

/// The state of the path at the penalty `lambda`.
#[derive(Debug, Default)]
pub(super) struct Path {
    lambda: f64,
    /// `A` with the factor of `G_AA`.
    factor: ActiveCholesky,
    /// `G_{·A}`.
    gram: ColumnStack,
    /// `s_A`.
    signs: Vec<f64>,
    /// `α_A`.
    values: Vec<f64>,
    /// `L⁻¹s_A` with the factor `L` of `G_AA`.
    half: Vec<f64>,
    /// `v`.
    direction: Vec<f64>,
    /// `Dᵀr` before the last step; zero on the active set, so that nothing there looks like an event.
    residual: Vec<Lanes>,
    /// `q` of the last step; zero on the active set.
    slope: Vec<Lanes>,
    /// Zero on the active set, one elsewhere.
    free: Vec<Lanes>,
    /// The last step, `γ`.
    step: f64,
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
        let Some((column, sign)) = self.reset(lasso, correlations) else { return };
        visit(self.lambda, self.columns(), &self.values);
        self.join(atoms, column, sign);
        // A path has few more knots than columns. The limit is for paths that rounding sends round in circles.
        for _ in 0..8 * atoms.columns() + 8 {
            self.direction.clear();
            self.direction.extend_from_slice(&self.half);
            self.factor.solve_upper(&mut self.direction);
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

    /// Starts at `λ_max` without active columns. Returns the first one to join, with its sign, unless the penalty of `lasso`
    /// leaves nothing.
    fn reset(&mut self, lasso: &Lasso, correlations: &[f64]) -> Option<(usize, f64)> {
        self.factor.clear();
        self.gram.reset(correlations.len(), 0);
        self.signs.clear();
        self.half.clear();
        self.values.clear();
        self.dependent.clear();
        self.dropped = None;
        set_pieces(&mut self.residual, correlations);
        self.slope.clear();
        self.slope.resize(self.residual.len(), [0.0; LANES]);
        self.free.clear();
        self.free.resize(self.residual.len(), [1.0; LANES]);
        self.step = 0.0;
        let signs = signs(lasso);
        let largest = vectorised(
            #[inline(always)]
            || {
                let mut largest = Largest::above(lasso.lambda);
                for (k, residual) in self.residual.iter().enumerate() {
                    largest.offer(k, &strengths(signs, residual));
                }
                largest
            },
        );
        let (lambda, column) = largest.found()?;
        self.lambda = lambda;
        Some((column, correlations[column].signum()))
    }

    /// Takes the last step, computes the slope of the correlations from here, and finds the first event below the current
    /// penalty, with the step to it.
    fn next_event(&mut self, lasso: &Lasso) -> (f64, Event) {
        let (signs, step) = (signs(lasso), self.step);
        let mut first = (self.lambda - lasso.lambda, Event::End);
        vectorised(
            #[inline(always)]
            || {
                for k in 0..self.residual.len() {
                    let mut slope = [0.0; LANES];
                    add_pieces(&mut slope, self.gram.piece(k), &self.direction);
                    let (mut residual, last, free) = (self.residual[k], self.slope[k], self.free[k]);
                    for l in 0..LANES {
                        residual[l] -= step * last[l];
                    }
                    for l in 0..LANES {
                        slope[l] *= free[l];
                    }
                    (self.residual[k], self.slope[k]) = (residual, slope);
                    if outgrows(signs, &residual, &slope, first.0, self.lambda - first.0) {
                        self.consider(lasso, k, &mut first);
                    }
                }
            },
        );
        for (position, (value, direction)) in self.values.iter().zip(&self.direction).enumerate() {
            let step = -value / direction;
            if step > SAME * self.lambda && step <= first.0 {
                first = (step, Event::Drop(position));
            }
        }
        first
    }

    /// Updates `first` if one of the columns of piece `k` joins earlier: `sign (r − γ q) = λ − γ`, with the sign of the
    /// correlation that exceeds the penalty after the step.
    #[inline(never)]
    fn consider(&self, lasso: &Lasso, k: usize, first: &mut (f64, Event)) {
        for (j, (&r, &q)) in (k * LANES..).zip(self.residual[k].iter().zip(&self.slope[k])) {
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
        self.step = step;
        add_scaled(&mut self.values, step, &self.direction);
        self.dropped = None;
    }

    fn join(&mut self, atoms: &Atoms, index: usize, sign: f64) {
        if self.factor.push(atoms.gram(), index) {
            self.half.push(self.factor.last_of_lower(&self.half, sign));
            self.signs.push(sign);
            self.values.push(0.0);
            self.gram.push_column(column(atoms.gram(), index));
            self.set(index, 0.0, 0.0);
        } else {
            self.dependent.push(index);
        }
    }

    /// Sets the correlation of a column from here on, and whether the column is free.
    fn set(&mut self, column: usize, residual: f64, free: f64) {
        let (piece, lane) = (column / LANES, column % LANES);
        self.residual[piece][lane] = residual;
        self.slope[piece][lane] = 0.0;
        self.free[piece][lane] = free;
    }

    fn drop(&mut self, position: usize) {
        let (column, sign) = (self.factor.indices()[position], self.signs.remove(position));
        self.dropped = Some((column, sign));
        self.set(column, sign * self.lambda, 1.0);
        self.values.remove(position);
        self.factor.remove(position);
        self.gram.remove(position);
        self.half.clear();
        self.half.extend_from_slice(&self.signs);
        self.factor.solve_lower(&mut self.half);
        self.dependent.clear();
    }

    /// Fit, penalty and gap of the code at the end of the path, from a fresh residual.
    pub(super) fn certificate(&mut self, lasso: &Lasso, signal: &Signal<'_>) -> (Fit, f64, f64) {
        let correlations = Pieces::of(signal.correlations);
        let Self { residual, gram, direction, values, .. } = self;
        direction.clear();
        direction.extend(values.iter().map(|value| -value));
        let signs = signs(lasso);
        let strongest = vectorised(
            #[inline(always)]
            || {
                let mut most = [0.0; LANES];
                for (k, residual) in residual.iter_mut().enumerate() {
                    let mut fresh = *correlations.at(k);
                    add_pieces(&mut fresh, gram.piece(k), direction);
                    *residual = fresh;
                    let strengths = strengths(signs, &fresh);
                    for l in 0..LANES {
                        most[l] = if strengths[l] > most[l] { strengths[l] } else { most[l] };
                    }
                }
                most
            },
        );
        let strongest = strongest.into_iter().fold(0.0, f64::max);
        let fit = Fit::on(signal, self.columns(), &self.values, |j| self.residual[j / LANES][j % LANES]);
        let penalty = lasso.penalty(&self.values);
        (fit, penalty, fit.gap(penalty, lasso.lambda, strongest))
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
#[inline(always)]
fn outgrows(signs: u64, r: &Lanes, q: &Lanes, step: f64, penalty: f64) -> bool {
    let mut reached = [0.0; LANES];
    for l in 0..LANES {
        reached[l] = r[l] - step * q[l];
    }
    let mut exceed = 0;
    for strength in strengths(signs, &reached) {
        exceed |= u64::from(strength > penalty);
    }
    exceed != 0
}

/// The bits of correlations that count: all for non-negative codes, all but the sign for others.
fn signs(lasso: &Lasso) -> u64 {
    if lasso.nonnegative { u64::MAX } else { u64::MAX >> 1 }
}

/// Strength of correlations against the penalty.
#[inline(always)]
fn strengths(signs: u64, correlations: &Lanes) -> Lanes {
    let mut strengths = [0.0; LANES];
    for l in 0..LANES {
        strengths[l] = f64::from_bits(correlations[l].to_bits() & signs);
    }
    strengths
}
