//! Passes over shapes that can be made somewhere else: what is summed, as a value that can be written down.
//!
//! A sum over many shapes is made in parts of [`PART`](crate::accumulate::PART) shapes. Whoever has the shapes of a
//! part, the metric and the class that is removed makes its sum from a [`Pass`], with the same bits as everybody
//! else: numbers are written so that they come back exactly.

use crate::fit::Fit;

/// What is summed over which form of the shapes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Pass {
    /// The mean that shapes are aligned to first; none when they are summed as given.
    pub aligned: Option<Aligned>,
    /// What is summed.
    pub sum: Sum,
}

/// How shapes are brought into the form that is summed.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Aligned {
    /// The whitened mean shape.
    pub mean: Vec<f64>,
    /// Whether to divide by the norm.
    pub normalise: bool,
}

/// What is summed.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case", tag = "kind"))]
pub enum Sum {
    /// [`ProjectorSum`].
    Projectors,
    /// The sum that chooses the member of a mean space which is closest to the shapes.
    Frame {
        /// Whitened basis of the mean space, one element after the other.
        elements: Vec<f64>,
    },
    /// The fitted shapes of an iteration of Procrustes.
    Fits {
        /// What is fitted.
        fit: Fit,
        /// What they are fitted to, whitened.
        mean: Vec<f64>,
    },
    /// [`ScatterSum`](super::accumulate::ScatterSum).
    Scatter {
        /// What is subtracted from every whitened shape.
        origin: Vec<f64>,
    },
}
