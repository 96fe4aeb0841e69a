//! Passes over shapes that another process can compute: the description of a sum, as a serialisable value.
//!
//! A sum over many shapes is made in parts of [`PART`](crate::accumulate::PART) shapes. A caller that has the shapes of a
//! part, the metric and the class that is removed makes its sum from a [`Pass`], with the same bits as any other
//! process: numbers are written so that they come back exactly.

use crate::AnalysisError;
use crate::fit::Fit;

/// One pass over the shapes: the sum, and the form of the shapes that it takes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Pass {
    /// The mean to which shapes are aligned first. `None` to sum the shapes as given.
    pub aligned: Option<Aligned>,
    /// The sum.
    pub sum: Sum,
}

/// Alignment of the shapes before they are summed.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Aligned {
    /// The whitened mean shape.
    pub mean: Vec<f64>,
    /// Whether to divide every shape by its norm.
    pub normalise: bool,
}

/// Kind of sum.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "snake_case", tag = "kind"))]
pub enum Sum {
    /// [`ProjectorSum`](crate::mean::ProjectorSum).
    Projectors,
    /// The sum that determines the member of a mean space closest to the shapes.
    Frame {
        /// Whitened basis of the mean space, one element after the other.
        elements: Vec<f64>,
    },
    /// Sum of the fitted shapes, in one iteration of Procrustes.
    Fits {
        /// The kind of fit.
        fit: Fit,
        /// Whitened mean to which the shapes are fitted.
        mean: Vec<f64>,
    },
    /// [`ScatterSum`](super::accumulate::ScatterSum).
    Scatter {
        /// Whitened shape that is subtracted from every shape.
        origin: Vec<f64>,
    },
}

/// Consecutive shapes that another process codes with the same atoms, while a dictionary is learnt.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Group<'a> {
    /// Number of the epoch, from 0 on. Codes start from those of the epoch before.
    pub epoch: usize,
    /// Position of the first shape.
    pub first: usize,
    /// Position after the last one.
    pub end: usize,
    /// Atoms, whitened, one after the other.
    pub atoms: &'a [f64],
    /// Whitened mean by which shapes are prepared; empty if the source prepares none.
    pub mean: &'a [f64],
}

/// Codes a group of shapes and returns their sums, as [`Coding::to_bytes`](crate::dictionary::learning::Coding::to_bytes) writes them.
pub type CodeGroup<'a> = Box<dyn Fn(Group<'_>) -> Result<Vec<u8>, AnalysisError> + 'a>;
