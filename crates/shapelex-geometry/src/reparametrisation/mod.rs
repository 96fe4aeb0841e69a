//! Reparametrisations: smooth maps of the parameter sphere to itself, maps of a line, and the shapes that they give.
//!
//! ```text
//! γ(x) = R_o · flow_a(R_i x)       flow_a = f⁴,   f(y) = (y + ¼ w_a(y))/|…|,   w_a(y) = Σ_j a_j ∇Y_j(y) + b_j y × ∇Y_j(y)
//! T_γ c = argmin ‖r∘γ − Σ c'φ‖_Φ   with the residual and the folded part of the area as its certificate
//! ```
//!
//! `Y_j` are spherical harmonics of degree 1 to `L`, so that turning the sphere maps the fields of one degree among themselves: no
//! direction, and no pole of a surface, is preferred. The flow is a diffeomorphism while every step `f` is one.
//!
//! * [`harmonics`] — solid harmonics with derivatives; [`flow`] — the maps and their derivatives by the coefficients;
//! * [`nodes`] — points of the sphere that the rotations of the icosahedron permute;
//! * [`spherical`] — shapes as functions of directions, and refits; [`line`](mod@line) — refits of curves.
//!
//! Sources: Davies, Twining and Taylor 2008 (reparametrisations of a sphere by composed maps); Brechbühler, Gerig and Kübler 1995.

pub mod flow;
pub mod harmonics;
pub mod line;
pub mod nodes;
pub mod spherical;

pub use flow::Reparametrisation;
pub use line::LineRefit;
pub use nodes::Nodes;
pub use spherical::{Refit, Spherical};
