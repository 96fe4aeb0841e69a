//! Rasterisation of shapes to grid cells, and overlap measures of two rasterised shapes.
//!
//! ```text
//! Jaccard  J = |A ∩ B| / |A ∪ B|          Dice  2 |A ∩ B| / (|A| + |B|)
//! Hausdorff  max(max_{a ∈ ∂A} d(a, ∂B), max_{b ∈ ∂B} d(b, ∂A))
//! ```
//!
//! A cell belongs to a mesh, a curve or a polygon if the winding number about its centre is not zero: a cell enclosed twice in
//! one direction is inside, so that a contour walked twice is itself and overlapping outlines are united; a cell enclosed once in
//! each direction is outside, so that a hole is a contour in the opposite direction.
//!
//! # Order of cells
//! The last axis of a [`Mask`] is the fastest: the cell `(i, j, k)` at `x = first[0] + i spacing[0]` and so on is number
//! `(i · size[1] + j) · size[2] + k`. Files of pictures and volumes have x fastest: see [`Mask::from_x_fastest`].
//!
//! # Ties
//! Every comparison is half-open, `lower ≤ centre < upper` in each coordinate. If shapes tile space or the plane, each
//! centre therefore belongs to exactly one of them, even on common faces, edges and vertices. Common sides that lie across
//! an axis may be cut into different triangles; oblique ones must have the same triangles.

mod compare;
mod curves;
mod distance;
mod fill;
mod grid;
#[cfg(test)]
mod tests;

pub use compare::{Overlap, overlap, overlap_unless_stopped};
pub use curves::from_curves;
pub use fill::{from_contours, from_mesh};
pub use grid::{Grid, Mask};
