//! Faults of edges that the normal-based scheme splits.

/// Reason why an edge cannot be split.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum EdgeFault {
    /// The ends of the edge coincide.
    #[error("its ends coincide")]
    NoLength,
    /// A normal at one end is not a unit vector.
    #[error("a normal at its ends is not of unit length")]
    NotUnit,
    /// Both normals are parallel to the edge, so the plane in which it bends is undefined.
    #[error("the normals at both ends are parallel to it")]
    AlongBoth,
    /// The normals are on opposite sides of the edge.
    #[error("the normals at its ends are on opposite sides of it")]
    Opposite,
}
