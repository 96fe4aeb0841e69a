//! Predicted work of learning and coding, in multiply-adds.

use super::model::Model;

/// Multiply-adds of an eigenproblem, divided by the cube of its size.
pub const EIGENPROBLEM: f64 = 1.0;

/// Multiply-adds of a product of dense matrices, in time: caches and vectors make it as fast as a twentieth of plain ones.
pub const PRODUCT: f64 = 0.05;

/// Multiply-adds of learning atoms, in time.
pub const CODING: f64 = 0.4;

/// Fraction of the columns that a penalised code uses, which determines the length of a regularisation path.
pub(super) const USED: f64 = 0.3;

/// Size of a learning problem.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Size {
    /// Number of shapes.
    pub shapes: f64,
    /// Numbers of a shape, `d·N`.
    pub length: f64,
    /// Dimension `d`.
    pub dimension: f64,
    /// Number of parameters of the transformation class.
    pub class: f64,
}

/// Work and memory of learning.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cost {
    /// Multiply-adds if learning runs all of its passes.
    pub multiply_adds: f64,
    /// Numbers held in memory besides the shapes.
    pub numbers: f64,
}

/// Multiply-adds of the sparse code of a shape of `length` numbers that uses `used` of `columns` columns.
pub(super) fn code_operations(length: f64, columns: f64, used: f64) -> f64 {
    length * columns + used * columns * used.sqrt() + used * length
}

impl Model {
    /// Multiply-adds of the code of a shape of `length` numbers.
    pub fn work(&self, length: usize) -> f64 {
        let (n, atoms) = (length as f64, self.len() as f64);
        match self {
            Self::Components { .. } => n * atoms,
            Self::Sparse { algebra, .. } => {
                let columns = atoms * algebra.parameters().max(1) as f64;
                code_operations(n, columns, (USED * columns).min(n))
            }
        }
    }
}
