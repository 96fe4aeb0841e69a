//! Passes over shapes that can be made somewhere else: what is summed, as a value that can be written down.
//!
//! A sum over many shapes is made in parts of [`PART`](super::accumulate::PART) shapes. Whoever has the shapes of a
//! part, the metric and the class that is removed makes its sum from a [`Pass`], with the same bits as everybody
//! else: numbers are written so that they come back exactly.

use super::AnalysisError;
use super::accumulate::{Accumulator, ShapeSource};
use super::alignment::Method;
use super::dictionary::preparation::{Pose, Posed, Preparation};
use super::frame;
use super::matching::Matching;
use super::mean::ProjectorSum;
use super::metric::Metric;
use super::pca::FunctionalPca;
use super::procrustes::{self, Fit};
use shapelex_numeric::dense::Matrix;

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

/// What shapes are measured by, and how they are brought together.
#[derive(Debug, Clone, Copy)]
pub struct Measured<'a> {
    /// The metric.
    pub metric: &'a Metric,
    /// Projection or Procrustes.
    pub method: &'a Method,
    /// Start points, directions, mirror images.
    pub matching: &'a Matching,
}

impl Pass {
    /// The sum over the shapes of `source`, as [`Accumulator::to_bytes`] writes it.
    ///
    /// # Errors
    /// Errors of the source; [`AnalysisError::NotAnAccumulator`] when pass and method do not fit together.
    pub fn make<S: ShapeSource>(&self, source: &S, measured: Measured<'_>) -> Result<Vec<u8>, S::Error> {
        let Some(Aligned { mean, normalise }) = &self.aligned else {
            return self.sum.make(source, measured);
        };
        let preparation = Preparation {
            metric: measured.metric.clone(),
            method: measured.method.clone(),
            matching: measured.matching.clone(),
            mean: mean.clone(),
            pose: Pose::Aligned { normalise: *normalise },
        };
        self.sum.make(&Posed { source, preparation: &preparation }, measured)
    }
}

impl Sum {
    fn make<S: ShapeSource>(&self, source: &S, measured: Measured<'_>) -> Result<Vec<u8>, S::Error> {
        let length = measured.metric.len();
        let fits = |numbers: &[f64]| !numbers.is_empty() && numbers.len().is_multiple_of(length);
        match (self, measured.method) {
            (Self::Projectors, Method::Projection(class)) => {
                Ok(ProjectorSum::of(source, class, length)?.to_bytes())
            }
            (Self::Frame { elements }, _) if fits(elements) => {
                let elements = Matrix::from_column_slice(length, elements.len() / length, elements);
                Ok(frame::training_sum(source, &elements)?.to_bytes())
            }
            (Self::Fits { fit, mean }, _) if mean.len() == length => {
                Ok(procrustes::fitted_sum(source, *fit, mean)?.to_bytes())
            }
            (Self::Scatter { origin }, _) if origin.len() == length => {
                Ok(FunctionalPca::scatter(source, origin)?.to_bytes())
            }
            _ => Err(AnalysisError::NotAnAccumulator.into()),
        }
    }
}
