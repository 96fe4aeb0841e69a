//! Optimised orthogonal matching pursuit (orthogonal least squares).

use super::atoms::Atoms;
use super::code::{Signal, SparseCode};
use super::encode::EncodeOne;
use super::pursuit_blocks::BlockPursuit;
use super::pursuit_columns::ColumnPursuit;
use crate::AnalysisError;

/// Coder with a fixed number of atoms. In every step, the atom that leaves the smallest residual joins with all of its
/// columns, and all coefficients are fitted anew.
///
/// With `Q` an orthonormal basis of the columns in use, `r = (I − QQᵀ)x` and `S_j = U_jᵀ(I − QQᵀ)U_j`, atom `j` captures
/// `rᵀU_j S_j⁻¹ U_jᵀr` of `‖r‖²`. Plain orthogonal matching pursuit compares `‖U_jᵀr‖²/s_j` instead, and passes over atoms
/// that are similar to those in use, as learnt atoms are. Source: Chen, Billings and Luo 1989.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pursuit {
    /// Maximum number of atoms in a code; fewer if the shape is reproduced earlier.
    pub nonzeros: usize,
}

/// Relative correlation below which a correlation is rounding error.
pub(super) const NOTHING_LEFT: f64 = 1e-12;

/// Remaining fraction of its squared norm below which a column depends on those in use. Gram matrices square the
/// condition number, and eight digits of the remainder should be right.
pub(super) const INDEPENDENT: f64 = 1e-8;

/// Scratch memory of a pursuit.
#[derive(Debug, Default)]
pub(super) struct PursuitWork {
    columns: ColumnPursuit,
    blocks: BlockPursuit,
}

impl EncodeOne for Pursuit {
    type Work = PursuitWork;

    /// Cost: `O(nJb)` per shape for the correlations and `O(J b² k (k + b))` for `k` atoms. A column that depends on those
    /// in use has coefficient zero. Never fails.
    fn code(
        &self,
        atoms: &Atoms,
        signal: &Signal<'_>,
        _: Option<&SparseCode>,
        work: &mut PursuitWork,
    ) -> Result<SparseCode, AnalysisError> {
        Ok(match atoms.block() {
            1 => work.columns.code(atoms, signal, self.nonzeros),
            _ => work.blocks.code(atoms, signal, self.nonzeros),
        })
    }
}
