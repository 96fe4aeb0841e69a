//! Generators: centred, even, compactly supported functions `φ` whose integer shifts span a shape space.
//!
//! ```text
//! φ(t) = Σ_{m<n} C[p][m] s^m     on [−N/2 + p/2, −N/2 + (p+1)/2],  s = (t − mid_p)/H ∈ [−1, 1],  H = 1/4
//! ```
//!
//! Every generator is stored as short Taylor vectors on its half-integer intervals, computed once by
//! propagating the differential equation `L(D) φ = 0` from knot to knot. Nothing divides by a pole, so
//! the form is accurate to a few ulp for any number of control points, where closed trigonometric
//! formulas lose `10⁻¹⁷ M²` to `10⁻¹⁸ M⁴`.
//!
//! * [`Poles`] — the exponents that a generator is made of;
//! * [`bspline`] — exponential B-splines from their poles;
//! * [`Generator`] — the piecewise form: evaluation, exact inner products;
//! * [`GeneratorKind`] — the catalogue that users choose from.

pub mod bspline;
mod catalogue;
mod piecewise;

pub use bspline::Poles;
pub use catalogue::{GeneratorKind, GeneratorProperties};
pub use piecewise::{Generator, HALF_PIECE, evaluate_taylor};
