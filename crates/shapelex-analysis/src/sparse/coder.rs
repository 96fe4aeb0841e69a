//! The choice among coders.

use super::atoms::Atoms;
use super::code::SparseCode;
use super::encode::Encode;
use super::group::GroupLasso;
use super::lasso::Lasso;
use super::pursuit::Pursuit;
use crate::AnalysisError;

/// A sparse coder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Coder {
    /// Lasso: one penalised coefficient per column.
    Lasso(Lasso),
    /// Group lasso: one penalised member of the class per atom.
    GroupLasso(GroupLasso),
    /// Matching pursuit with a given number of atoms.
    Pursuit(Pursuit),
}

impl Coder {
    /// The codes of whitened `shapes` (`n` numbers each), in order.
    ///
    /// # Errors
    /// The first error of a shape, as for the respective coder.
    pub fn codes(&self, atoms: &Atoms, shapes: &[f64]) -> Result<Vec<SparseCode>, AnalysisError> {
        self.encode(atoms, shapes, None)
    }

    /// As [`Self::codes`], for codes near the `previous` ones (by position). A penalised code starts from the previous one,
    /// with the same certificate; a pursuit starts afresh.
    ///
    /// # Errors
    /// As for [`Self::codes`].
    pub fn codes_from(
        &self,
        atoms: &Atoms,
        shapes: &[f64],
        previous: &[SparseCode],
    ) -> Result<Vec<SparseCode>, AnalysisError> {
        self.encode(atoms, shapes, Some(previous))
    }

    /// The penalty `λ` on magnitudes; 0 for a pursuit.
    pub fn lambda(&self) -> f64 {
        match self {
            Self::Lasso(lasso) => lasso.lambda,
            Self::GroupLasso(lasso) => lasso.lambda,
            Self::Pursuit(_) => 0.0,
        }
    }

    /// The penalty term of the objective, for atoms of `block` columns.
    pub fn penalty(&self, code: &SparseCode, block: usize) -> f64 {
        match self {
            Self::Lasso(lasso) => lasso.penalty(&code.values),
            Self::GroupLasso(lasso) => lasso.penalty(&code.values, block),
            Self::Pursuit(_) => 0.0,
        }
    }

    fn encode(
        &self,
        atoms: &Atoms,
        shapes: &[f64],
        previous: Option<&[SparseCode]>,
    ) -> Result<Vec<SparseCode>, AnalysisError> {
        match self {
            Self::Lasso(lasso) => lasso.encode(atoms, shapes, previous),
            Self::GroupLasso(lasso) => lasso.encode(atoms, shapes, previous),
            Self::Pursuit(pursuit) => pursuit.encode(atoms, shapes, previous),
        }
    }
}
