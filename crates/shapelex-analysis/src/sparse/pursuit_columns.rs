//! The pursuit among atoms of one column.

use super::atoms::Atoms;
use super::code::{Fit, Signal, SparseCode, in_order};
use super::pursuit::{INDEPENDENT, NOTHING_LEFT};
use shapelex_numeric::cholesky::ActiveCholesky;
use shapelex_numeric::kernels::column;
use shapelex_numeric::lanes::{
    ColumnStack, LANES, Lanes, Largest, Pieces, add_pieces, set_pieces, vectorised,
};

/// Scratch memory, and the state of a pursuit. One pass over the atoms does all that a step needs.
#[derive(Debug, Default)]
pub(super) struct ColumnPursuit {
    /// `DᵀQ`.
    basis: ColumnStack,
    /// `Dᵀr`.
    residual: Vec<Lanes>,
    /// `S_j`.
    rest: Vec<Lanes>,
    /// `−Qᵀu` of the column that joins.
    shares: Vec<f64>,
    /// The columns in use, in the order in which they joined, with the factor of their Gram matrix.
    factor: ActiveCholesky,
    /// Coefficients of the columns in use.
    values: Vec<f64>,
}

impl ColumnPursuit {
    pub(super) fn code(&mut self, atoms: &Atoms, signal: &Signal<'_>, nonzeros: usize) -> SparseCode {
        let noise = NOTHING_LEFT.powi(2) * signal.energy;
        let mut best = self.begin(atoms, signal, nonzeros, noise);
        for place in 1..=nonzeros {
            let Some(index) = best else { break };
            self.take(index);
            // Nothing is chosen after the last one.
            best = if place < nonzeros { self.join(atoms, index, noise) } else { None };
        }
        self.fit(signal)
    }

    /// Begins without columns. Returns the first one to join.
    fn begin(&mut self, atoms: &Atoms, signal: &Signal<'_>, nonzeros: usize, noise: f64) -> Option<usize> {
        self.factor.clear();
        self.basis.reset(atoms.len(), nonzeros.min(atoms.len()));
        set_pieces(&mut self.residual, signal.correlations);
        set_pieces(&mut self.rest, atoms.energies());
        let largest = vectorised(
            #[inline(always)]
            || {
                let mut largest = Largest::above(0.0);
                for (k, (residual, rest)) in self.residual.iter().zip(&self.rest).enumerate() {
                    largest.offer(k, &captured(residual, rest, rest, noise));
                }
                largest
            },
        );
        largest.found().map(|(_, index)| index)
    }

    /// Adds a column to those in use: the products with the basis are its row of the factor.
    fn take(&mut self, index: usize) {
        let (piece, lane) = (index / LANES, index % LANES);
        let products = self.basis.piece(piece).iter().map(|q| q[lane]);
        self.factor.push_row(products, self.rest[piece][lane], index);
    }

    /// Adds a column to the basis, and returns the one that captures most of the residual; the first one in a tie. `None` if no
    /// column is both independent of those in use and correlated with the residual: the shape is reproduced as far as possible.
    fn join(&mut self, atoms: &Atoms, index: usize, noise: f64) -> Option<usize> {
        let (column, energies) = (Pieces::of(column(atoms.gram(), index)), Pieces::of(atoms.energies()));
        let Self { basis, residual, rest, shares, .. } = self;
        let (piece, lane) = (index / LANES, index % LANES);
        shares.clear();
        shares.extend(basis.piece(piece).iter().map(|q| -q[lane]));
        let scale = 1.0 / rest[piece][lane].sqrt();
        let product = residual[piece][lane] * scale;
        let largest = vectorised(
            #[inline(always)]
            || {
                let mut largest = Largest::above(0.0);
                basis.push(
                    #[inline(always)]
                    |k, known| {
                        // The new direction, q = (u − QQᵀu)/√S, in terms of its products with all columns.
                        let mut direction = *column.at(k);
                        add_pieces(&mut direction, known, shares);
                        let (mut r, mut s) = (residual[k], rest[k]);
                        for l in 0..LANES {
                            direction[l] *= scale;
                        }
                        for l in 0..LANES {
                            r[l] -= product * direction[l];
                        }
                        for l in 0..LANES {
                            s[l] -= direction[l] * direction[l];
                        }
                        (residual[k], rest[k]) = (r, s);
                        largest.offer(k, &captured(&r, &s, energies.at(k), noise));
                        direction
                    },
                );
                largest
            },
        );
        largest.found().map(|(_, index)| index)
    }

    /// The code with the coefficients that fit best. The residual is orthogonal to the columns in use.
    fn fit(&mut self, signal: &Signal<'_>) -> SparseCode {
        let Self { factor, values, .. } = self;
        let columns = factor.indices();
        values.clear();
        values.extend(columns.iter().map(|&index| signal.correlations[index]));
        factor.solve(values);
        let fit = Fit::on(signal, columns, values, |_| 0.0);
        fit.certified(signal, in_order(columns, values, 1), 0.0, None)
    }
}

/// `r²/S` of every column, or zero where the column depends on those in use or is not correlated with the residual. Everything
/// is computed for every column, so that the compiler vectorises the loop.
#[inline(always)]
fn captured(residual: &Lanes, rest: &Lanes, energies: &Lanes, noise: f64) -> Lanes {
    let mut captured = [0.0; LANES];
    for l in 0..LANES {
        let square = residual[l] * residual[l];
        let counts = (rest[l] > INDEPENDENT * energies[l]) & (square > noise * energies[l]);
        let part = square / if counts { rest[l] } else { 1.0 };
        captured[l] = if counts { part } else { 0.0 };
    }
    captured
}
