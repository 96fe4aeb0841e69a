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
}

impl Encode for Coder {
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
