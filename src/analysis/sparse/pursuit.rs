//! Orthogonal matching pursuit.

use super::{Atoms, Signal, SparseCode, ascending};
use crate::analysis::AnalysisError;
use crate::numeric::cholesky::ActiveCholesky;

/// Codes with a fixed number of atoms: the atom that correlates best with what is left (by the cosine) joins, and all
/// coefficients are fitted anew.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pursuit {
    /// Most atoms of a code; fewer when the shape is reproduced before.
    pub nonzeros: usize,
}

/// What is left of a shape below this part of its norm is rounding.
const NOTHING_LEFT: f64 = 1e-12;

impl Pursuit {
    /// The codes of whitened `shapes` (`n` numbers each). Cost `O(nJ)` for the correlations of a shape and `O(J k²)` for
    /// `k` atoms.
    ///
    /// # Errors
    /// None today; the signature is that of the other coders.
    pub fn codes(&self, atoms: &Atoms, shapes: &[f64]) -> Result<Vec<SparseCode>, AnalysisError> {
        atoms.each(shapes, |signal| Ok(self.code(atoms, signal)))
    }

    fn code(&self, atoms: &Atoms, signal: &Signal<'_>) -> SparseCode {
        let gram = atoms.gram();
        let mut factor = ActiveCholesky::default();
        let mut excluded = vec![false; atoms.len()];
        let mut values = Vec::new();
        while factor.indices().len() < self.nonzeros {
            let residual = atoms.residual_correlations(signal, factor.indices(), &values);
            let cosine = |j: usize| residual[j].abs() / gram[(j, j)].sqrt().max(f64::MIN_POSITIVE);
            let free = (0..atoms.len()).filter(|&j| !excluded[j]);
            // Of equal ones the first, so that rounding in the order of a maximum decides nothing.
            let best = free.fold(None, |best: Option<usize>, j| match best {
                Some(other) if cosine(other) >= cosine(j) => best,
                _ => Some(j),
            });
            let Some(best) = best.filter(|&j| cosine(j) > NOTHING_LEFT * signal.energy.sqrt()) else { break };
            excluded[best] = true;
            if factor.push(gram, best) {
                values = factor.indices().iter().map(|&j| signal.correlations[j]).collect();
                factor.solve(&mut values);
            }
        }
        let (indices, values) = ascending(factor.indices(), &values);
        atoms.measured(signal, indices, values, 0.0)
    }
}
