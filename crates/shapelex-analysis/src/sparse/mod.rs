//! Sparse codes of shapes in the atoms of a dictionary.
//!
//! ```text
//! lasso                          min_α ½‖x − Dα‖² + λ‖α‖₁     (optionally with α ≥ 0)
//! group lasso                    min_a ½‖x − Σ_j U_j a_j‖² + λ Σ_j ‖a_j‖₂
//! orthogonal matching pursuit    min_a ½‖x − Σ_j U_j a_j‖²  over supports that grow by the atom with the smallest residual
//! ```
//!
//! in whitened coordinates (`n = d·N` rows), where Euclidean norms are `L₂` norms of shapes. An atom is a column, or a block
//! `U_j` of `b` columns: the atom transformed by the members of a class of transformations, so that every shape uses its own
//! member `a_j` and needs no alignment. After the correlations `Dᵀx`, all work is done in the Gram matrix `DᵀD`: a batch of
//! shapes costs one product with the atoms.
//!
//! * [`Atoms`] — the atoms with their Gram matrix;
//! * [`SparseCode`] — a code with its certificate;
//! * [`Lasso`] — codes to a given duality gap, and the whole regularisation path;
//! * [`GroupLasso`] — the same for blocks;
//! * [`Pursuit`] — codes with a given number of atoms;
//! * [`Coder`] — any of these; [`Encode`] — their common trait.
//!
//! Source: Schmitter 2017, (4.27) with the square that is missing in Theorem 3; blocks after Yuan and Lin 2006.

mod atoms;
mod code;
mod coder;
mod encode;
mod group;
mod lasso;
mod path;
mod pursuit;
mod pursuit_blocks;
mod pursuit_columns;

pub use atoms::Atoms;
pub use code::SparseCode;
pub use coder::Coder;
pub use encode::Encode;
pub use group::GroupLasso;
pub use lasso::{Knot, Lasso};
pub use pursuit::Pursuit;
