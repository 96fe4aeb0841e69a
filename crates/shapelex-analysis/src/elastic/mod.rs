//! Elastic distance and correspondence of curves: the best match of their directions over all reparametrisations.
//!
//! ```text
//! cos d_ε(a, b) = sup ∫₀¹ w(s) √γ'(s) ds,   w(s) = ε ⟨u_a(s), O u_b(γ(s))⟩ + 1 − ε
//! ```
//!
//! `u` are unit tangents as functions of the fraction of the length, `γ` is non-decreasing and onto, `O` a rotation; closed curves may
//! begin anywhere. It is the geodesic distance of the square-root velocities `r'/√|r'|` of unit length, weighted between bending (`ε`)
//! and stretching. Copies that are moved, scaled and parametrised otherwise have the distance 0. Of closed curves it is the extrinsic
//! distance: geodesics may leave the closed curves.
//!
//! Curves are polygons of `M` equal lengths, for which the best map within a segment is known in closed form, so that only the places
//! `t_i` of the ends of segments are sought:
//!
//! ```text
//! F(t_0 ≤ … ≤ t_M) = Σ_i √(g_i / M),   g_i = ∫_{t_i}^{t_{i+1}} (w_i⁺)² dt
//! ```
//!
//! [`settings`] — what is compared and how thoroughly; [`curve`] — curves as tangents; [`space`] — pairs and matrices of distances;
//! `program` — the best path within a band around another one; `strips` — value, rotation and refinement of a path; `candidates` —
//! where to begin; `search` — the search of a pair; `polish` — close pairs, with the tangents of the splines; [`template`] — means of
//! curves, and matches to them; [`refit`] — curves with the parameters of a template.
//!
//! Source: Srivastava, Klassen, Joshi, Jermyn, *Shape analysis of elastic curves in Euclidean spaces* (TPAMI 2011); Lahiri, Robinson,
//! Klassen, arXiv 1501.00577, for polygons; Bauer, Bruveris, Marsland, Michor, arXiv 1207.5965, for the weights.

mod candidates;
pub mod curve;
mod pairing;
mod polish;
mod program;
pub mod refit;
mod search;
pub mod settings;
pub mod space;
mod strips;
pub mod template;

/// Rotations as matrices; those of the plane have a third axis that stays.
type Rotation = [[f64; 3]; 3];

/// No rotation.
const IDENTITY: Rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
