//! The choice among coders.

use super::atoms::Atoms;
use super::code::SparseCode;
use super::encode::Encode;
use super::group::GroupLasso;
use super::lasso::Lasso;
use super::pursuit::Pursuit;
use crate::AnalysisError;

/// A way to code shapes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Coder {
    /// One penalised coefficient a column.
    Lasso(Lasso),
    /// One penalised member of the class an atom.
    GroupLasso(GroupLasso),
    /// A given number of atoms.
    Pursuit(Pursuit),
}

impl Coder {
    /// The codes of whitened `shapes` (`n` numbers each), in order.
    ///
    /// # Errors
    /// Of the first shape that has one, as those of the coder.
    pub fn codes(&self, atoms: &Atoms, shapes: &[f64]) -> Result<Vec<SparseCode>, AnalysisError> {
        self.encode(atoms, shapes, None)
    }

    /// [`Self::codes`] when the codes are near `previous` ones (by position): a penalised code starts there, with the
    /// same certificate. A pursuit starts afresh.
    ///
    /// # Errors
    /// As [`Self::codes`].
    pub fn codes_from(
        &self,
        atoms: &Atoms,
        shapes: &[f64],
        previous: &[SparseCode],
    ) -> Result<Vec<SparseCode>, AnalysisError> {
        self.encode(atoms, shapes, Some(previous))
    }

    /// The penalty on magnitudes, 0 for a pursuit.
    pub fn lambda(&self) -> f64 {
        match self {
            Self::Lasso(lasso) => lasso.lambda,
            Self::GroupLasso(lasso) => lasso.lambda,
            Self::Pursuit(_) => 0.0,
        }
    }

    /// What the objective counts besides half of the squared error, for atoms of `block` columns.
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
