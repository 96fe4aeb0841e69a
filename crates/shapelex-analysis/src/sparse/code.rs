//! Sparse codes and their certificates.

use super::atoms::Atoms;
use shapelex_numeric::kernels::dot;

/// A gap of `10⁻¹⁰` of `½‖x‖²` says that ten digits of the objective are right.
pub(super) const DEFAULT_TOLERANCE: f64 = 1e-10;

/// A sparse code with its certificate.
#[derive(Debug, Clone, PartialEq)]
pub struct SparseCode {
    /// Atoms in use, ascending.
    pub indices: Vec<usize>,
    /// Their coefficients: `b` numbers for every index, where `b` is the number of columns of an atom.
    pub values: Vec<f64>,
    /// `½‖x − Dα‖²` plus the penalty (a pursuit has none).
    pub objective: f64,
    /// Primal minus dual value of the lasso: an upper bound on the distance of the objective from the minimum.
    pub duality_gap: Option<f64>,
    /// Relative error of the reconstruction, `‖x − Dα‖/‖x‖`.
    pub relative_error: f64,
}

impl SparseCode {
    /// The code as a dense vector over all `columns` columns of the atoms.
    pub fn dense(&self, columns: usize) -> Vec<f64> {
        let mut dense = vec![0.0; columns];
        self.scatter(&mut dense);
        dense
    }

    /// Number of real numbers in the code.
    pub fn parameters(&self) -> usize {
        self.values.len()
    }

    /// Writes the coefficients into their columns.
    fn scatter(&self, dense: &mut [f64]) {
        let block = self.values.len() / self.indices.len().max(1);
        for (&j, values) in self.indices.iter().zip(self.values.chunks_exact(block.max(1))) {
            dense[j * block..(j + 1) * block].copy_from_slice(values);
        }
    }

    /// Writes the coefficients into the columns of `atoms`. Returns whether there are any and they fit.
    pub(super) fn start(&self, atoms: &Atoms, dense: &mut [f64]) -> bool {
        let fits = self.values.len() == self.indices.len() * atoms.block()
            && self.indices.iter().all(|&j| j < atoms.len())
            && !self.indices.is_empty();
        if fits {
            self.scatter(dense);
        }
        fits
    }
}

/// The data of a shape that its code depends on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Signal<'a> {
    /// `Dᵀx`.
    pub(super) correlations: &'a [f64],
    /// `‖x‖²`.
    pub(super) energy: f64,
}

/// Fit of a dense code.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fit {
    /// `‖r‖²`, `r = x − Dα`.
    error: f64,
    /// `αᵀDᵀr`.
    fitted: f64,
}

impl Fit {
    /// Fit of a dense code from its `residual` `Dᵀr`: `‖r‖² = ‖x‖² − αᵀ(Dᵀx + Dᵀr)`.
    pub(super) fn of(signal: &Signal<'_>, code: &[f64], residual: &[f64]) -> Self {
        let fitted = dot(code, residual);
        let error = (signal.energy - dot(code, signal.correlations) - fitted).max(0.0);
        Self { error, fitted }
    }

    /// The duality gap of a code with `penalty = λ Ω(α)`, where `strongest` is the dual norm of `Dᵀr`.
    ///
    /// ```text
    /// gap = λΩ(α) − θ αᵀDᵀr + ½(1 − θ)²‖r‖²,   θ = min(1, λ/Ω*(Dᵀr))
    /// ```
    pub(super) fn gap(&self, penalty: f64, lambda: f64, strongest: f64) -> f64 {
        let theta = if strongest > lambda { lambda / strongest } else { 1.0 };
        (penalty - theta * self.fitted + 0.5 * (1.0 - theta).powi(2) * self.error).max(0.0)
    }

    /// As [`Self::of`], for a code with these `values` in its `columns` and a residual that is `residual(j)` there.
    pub(super) fn on(
        signal: &Signal<'_>,
        columns: &[usize],
        values: &[f64],
        residual: impl Fn(usize) -> f64,
    ) -> Self {
        let (mut fitted, mut explained) = (0.0, 0.0);
        for (&j, value) in columns.iter().zip(values) {
            fitted += value * residual(j);
            explained += value * signal.correlations[j];
        }
        Self { error: (signal.energy - explained - fitted).max(0.0), fitted }
    }

    /// The sparse code with its objective, gap and relative error.
    pub(super) fn measured(
        &self,
        atoms: &Atoms,
        signal: &Signal<'_>,
        code: &[f64],
        penalty: f64,
        duality_gap: Option<f64>,
    ) -> SparseCode {
        self.certified(signal, used(code, atoms.block()), penalty, duality_gap)
    }

    /// The sparse code with these indices and values.
    pub(super) fn certified(
        &self,
        signal: &Signal<'_>,
        (indices, values): (Vec<usize>, Vec<f64>),
        penalty: f64,
        duality_gap: Option<f64>,
    ) -> SparseCode {
        SparseCode {
            indices,
            values,
            objective: 0.5 * self.error + penalty,
            duality_gap,
            relative_error: if signal.energy > 0.0 { (self.error / signal.energy).sqrt() } else { 0.0 },
        }
    }
}

/// Indices of the blocks with coefficients that are not zero, and their values, from `values` in `columns` in any order.
pub(super) fn in_order(columns: &[usize], values: &[f64], block: usize) -> (Vec<usize>, Vec<f64>) {
    let mut pairs: Vec<(usize, f64)> = Vec::with_capacity(columns.len());
    pairs.extend(columns.iter().copied().zip(values.iter().copied()).filter(|(_, value)| *value != 0.0));
    pairs.sort_unstable_by_key(|(column, _)| *column);
    let (mut indices, mut values) =
        (Vec::with_capacity(pairs.len()), Vec::with_capacity(pairs.len() * block));
    for (column, value) in pairs {
        if indices.last() != Some(&(column / block)) {
            indices.push(column / block);
            values.resize(values.len() + block, 0.0);
        }
        let start = values.len() - block;
        values[start + column % block] = value;
    }
    (indices, values)
}

/// Indices of the non-zero blocks of a dense code, with their values.
pub(super) fn used(code: &[f64], block: usize) -> (Vec<usize>, Vec<f64>) {
    let blocks = code.chunks_exact(block).enumerate();
    let used = blocks.filter(|(_, values)| values.iter().any(|value| *value != 0.0));
    let indices: Vec<usize> = used.map(|(j, _)| j).collect();
    let mut values = Vec::with_capacity(indices.len() * block);
    indices.iter().for_each(|&j| values.extend_from_slice(&code[j * block..(j + 1) * block]));
    (indices, values)
}
