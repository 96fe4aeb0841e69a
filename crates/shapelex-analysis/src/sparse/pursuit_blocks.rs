//! The pursuit among atoms of several columns.

use super::atoms::Atoms;
use super::code::{Fit, Signal, SparseCode};
use super::pursuit::{INDEPENDENT, NOTHING_LEFT};
use shapelex_numeric::kernels::{add_columns, add_scaled, column, dot, largest};

/// Scratch memory, and the state of a pursuit.
#[derive(Debug, Default)]
pub(super) struct BlockPursuit {
    /// Columns in use.
    columns: Vec<usize>,
    /// `DᵀQ`: one column for each column in use, one after the other.
    basis: Vec<f64>,
    /// `Dᵀr`, exactly zero on the columns in use.
    residual: Vec<f64>,
    /// `S_j`: `b × b` numbers per atom.
    rest: Vec<f64>,
    /// `rᵀU_j S_j⁻¹ U_jᵀr`.
    captured: Vec<f64>,
    /// `−Qᵀu` of the column that joins; at the end `Qᵀx`.
    shares: Vec<f64>,
    /// `0 … k − 1`: the columns of the basis.
    places: Vec<usize>,
    /// `S_j` and `U_jᵀr` while they are factored.
    factor: Vec<f64>,
    code: Vec<f64>,
}

impl BlockPursuit {
    pub(super) fn code(&mut self, atoms: &Atoms, signal: &Signal<'_>, nonzeros: usize) -> SparseCode {
        self.reset(atoms, signal, nonzeros);
        for _ in 0..nonzeros {
            let Some(best) = self.best(atoms, signal) else { break };
            for column in best * atoms.block()..(best + 1) * atoms.block() {
                self.join(atoms, column);
            }
        }
        self.fit(signal);
        Fit::of(signal, &self.code, &self.residual).measured(atoms, signal, &self.code, 0.0, None)
    }

    fn reset(&mut self, atoms: &Atoms, signal: &Signal<'_>, nonzeros: usize) {
        let (all, block) = (atoms.columns(), atoms.block());
        self.columns.clear();
        self.places.clear();
        self.basis.resize(all * nonzeros.min(atoms.len()) * block, 0.0);
        self.residual.clear();
        self.residual.extend_from_slice(signal.correlations);
        self.rest.clear();
        let diagonal = |i: usize| if i.is_multiple_of(block + 1) { 1.0 } else { 0.0 };
        let blocks = atoms.energies().iter();
        self.rest.extend(blocks.flat_map(|e| (0..block * block).map(move |i| e * diagonal(i))));
        self.captured.resize(atoms.len(), 0.0);
        self.code.clear();
        self.code.resize(all, 0.0);
    }

    /// The atom that captures most; the first one in a tie. `None` if no atom is both independent of those in use and
    /// correlated with the residual: the shape is then reproduced as far as possible.
    fn best(&mut self, atoms: &Atoms, signal: &Signal<'_>) -> Option<usize> {
        let (block, noise) = (atoms.block(), NOTHING_LEFT.powi(2) * signal.energy);
        let parts = self.captured.iter_mut().zip(atoms.energies());
        let blocks = self.residual.chunks_exact(block).zip(self.rest.chunks_exact(block * block));
        for ((captured, energy), (r, rest)) in parts.zip(blocks) {
            *captured = match dot(r, r) > noise * energy {
                true => inverse_form(rest, r, INDEPENDENT * energy, &mut self.factor),
                false => 0.0,
            };
        }
        let most = largest(&self.captured);
        if most > 0.0 { self.captured.iter().position(|&part| part == most) } else { None }
    }

    /// Adds a column if it is independent of those in use.
    fn join(&mut self, atoms: &Atoms, index: usize) {
        let (block, used) = (atoms.block(), self.columns.len());
        let (atom, place) = (index / block, index % block);
        let pivot = self.rest[atom * block * block + place * (block + 1)];
        if !(pivot > INDEPENDENT * atoms.energies()[atom]) {
            self.residual[index] = 0.0;
            return;
        }
        // The new direction, q = (u − QQᵀu)/√pivot, in terms of its products with all columns.
        let all = self.residual.len();
        let (known, new) = self.basis.split_at_mut(used * all);
        let direction = &mut new[..all];
        direction.copy_from_slice(column(atoms.gram(), index));
        self.shares.clear();
        self.shares.extend(known.chunks_exact(all).map(|q| -q[index]));
        add_columns(direction, known, &self.places, &self.shares);
        let scale = 1.0 / pivot.sqrt();
        let product = self.residual[index] * scale;
        for (value, residual) in direction.iter_mut().zip(&mut self.residual) {
            *value *= scale;
            *residual -= product * *value;
        }
        for (rest, v) in self.rest.chunks_exact_mut(block * block).zip(direction.chunks_exact(block)) {
            for (row, a) in rest.chunks_exact_mut(block).zip(v) {
                add_scaled(row, -a, v);
            }
        }
        self.columns.push(index);
        self.places.push(used);
        for &column in &self.columns {
            self.residual[column] = 0.0;
        }
    }

    /// The coefficients: `U = Q Lᵀ`, where `L` consists of the rows of the basis in use, so `α = L⁻ᵀ L⁻¹ Uᵀx`.
    fn fit(&mut self, signal: &Signal<'_>) {
        let all = self.residual.len();
        let entry = |row: usize, k: usize| self.basis[k * all + self.columns[row]];
        self.shares.clear();
        for (row, &index) in self.columns.iter().enumerate() {
            let known: f64 = (0..row).map(|k| entry(row, k) * self.shares[k]).sum();
            self.shares.push((signal.correlations[index] - known) / entry(row, row));
        }
        for (row, &index) in self.columns.iter().enumerate().rev() {
            let value = self.shares[row] / entry(row, row);
            (0..row).for_each(|k| self.shares[k] -= entry(row, k) * value);
            self.code[index] = value;
        }
    }
}

/// `xᵀS⁻¹x` for a symmetric positive semidefinite matrix, by elimination. Directions with a remainder of at most `least`
/// are skipped.
fn inverse_form(s: &[f64], x: &[f64], least: f64, work: &mut Vec<f64>) -> f64 {
    let n = x.len();
    work.clear();
    work.extend_from_slice(s);
    work.extend_from_slice(x);
    let (s, x) = work.split_at_mut(n * n);
    let mut sum = 0.0;
    for k in 0..n {
        let pivot = s[k * n + k];
        if !(pivot > least) {
            continue;
        }
        sum += x[k] * x[k] / pivot;
        for i in k + 1..n {
            let factor = s[k * n + i] / pivot;
            x[i] -= factor * x[k];
            for j in k + 1..n {
                s[i * n + j] -= factor * s[k * n + j];
            }
        }
    }
    sum
}
