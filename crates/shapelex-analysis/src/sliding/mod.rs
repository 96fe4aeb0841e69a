//! Semilandmarks that slide along curves and on surfaces until they correspond.
//!
//! ```text
//! bending energy: t = (UᵀBU)⁻¹ UᵀB (y − ref);   distance: t = Uᵀ(y − ref);   y ← y − U t
//! ```
//!
//! `U` has a column for each curve slider, along the chord of its neighbours, and two for each surface slider, in its tangent plane;
//! `B` is the bending energy matrix of the consensus.
//!
//! The iteration of other programs ([`gpagen`]) slides the points that have slid, from round to round. It does not converge, since all
//! shapes may slide together with their mean, and ends with its tenth round. [`centred`] fixes that: displacements are those of one linear
//! solve from the points as given, and have the mean 0 over the shapes. It converges, and does not depend on the order of shapes.
//!
//! [`table`] — tables of sliders; [`along`] — points along splines, which slide in their parameters; [`error`] — reasons why nothing slides.

pub mod along;
pub mod centred;
mod directions;
pub mod error;
pub mod gpagen;
mod superimposed;
pub mod table;

pub use directions::SlidingCriterion;

/// Shapes that have slid.
#[derive(Debug, Clone, PartialEq)]
pub struct Slid {
    /// Consensus of the superimposed shapes, coordinate-major.
    pub consensus: Vec<f64>,
    /// Superimposed shapes, in the order given.
    pub aligned: Vec<Vec<f64>>,
    /// Shapes in their own position and size; none of [`gpagen`], which leaves their frame.
    pub points: Option<Vec<Vec<f64>>>,
    /// Displacements of the curve sliders along their directions, in units of centroid size, in ascending order of the points; none of
    /// [`gpagen`].
    pub displacements: Option<Vec<Vec<f64>>>,
    /// Number of rounds.
    pub rounds: usize,
    /// Distance by which the consensus moved in the last round.
    pub last_move: f64,
    /// Whether the last round left the result as it was.
    pub converged: bool,
    /// Squared size of the mean of the shapes, times their number, after every round of [`gpagen`].
    pub criterion: Vec<f64>,
    /// Number of displacements that are longer than the distance to the neighbour on that side.
    pub passed: usize,
}
