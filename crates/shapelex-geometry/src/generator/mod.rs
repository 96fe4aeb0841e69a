//! Generators: centred, even, compactly supported functions `φ` whose integer shifts span a shape space.
//!
//! ```text
//! φ(t) = Σ_{m<n} C[p][m] s^m     on [−N/2 + p/2, −N/2 + (p+1)/2],  s = (t − mid_p)/H ∈ [−1, 1],  H = 1/4
//! ```
//!
//! Every generator is stored as short Taylor vectors on its half-integer intervals, computed once by propagating the
//! differential equation `L(D) φ = 0` from knot to knot. There is no division by a pole. The form is therefore accurate to
//! a few ulp for any number of control points, where closed trigonometric formulas lose `10⁻¹⁷ M²` to `10⁻¹⁸ M⁴`.
//!
//! * [`Poles`] — the exponents of a generator;
//! * [`bspline`] — exponential B-splines from their poles;
//! * [`interpolator`] — two families of interpolators built from them;
//! * [`refinement`] — the two-scale relations between grids;
//! * [`Generator`] — the piecewise form: evaluation, exact inner products;
//! * [`GeneratorKind`] — the catalogue of generators.

pub mod bspline;
mod catalogue;
pub mod interpolator;
mod piecewise;
mod poles;
pub mod refinement;

pub use catalogue::{Built, Exact, Family, GeneratorKind, GeneratorProperties, PoleList, Recipe};
pub use piecewise::{
    Generator, HALF_PIECE, differentiate, evaluate_taylor, integrate_product, phantoms, recentre,
};
pub use poles::{MAX_POLES, MAX_REAL_PART, Poles};
