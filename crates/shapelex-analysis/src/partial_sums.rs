//! Partial sums: the sum of one part of the shapes, made from its description.

use crate::AnalysisError;
use crate::accumulate::{Accumulator, ScatterSum, ShapeSource, merge_serialised};
use crate::alignment::Method;
use crate::frame::{self, FrameSum};
use crate::matching::Matching;
use crate::mean::ProjectorSum;
use crate::metric::Metric;
use crate::pass::{Aligned, Pass, Sum};
use crate::pca::FunctionalPca;
use crate::preparation::{Pose, Posed, Preparation};
use crate::procrustes::{self, FittedSum};
use shapelex_numeric::dense::Matrix;

/// Metric and alignment of shapes.
#[derive(Debug, Clone, Copy)]
pub struct Measured<'a> {
    /// The metric.
    pub metric: &'a Metric,
    /// Projection or Procrustes.
    pub method: &'a Method,
    /// Start points, directions, mirror images.
    pub matching: &'a Matching,
}

impl Preparation {
    /// Metric, alignment method and matching of the shapes.
    pub fn measured(&self) -> Measured<'_> {
        Measured { metric: &self.metric, method: &self.method, matching: &self.matching }
    }
}

impl Pass {
    /// The sum over the shapes of `source`, as [`Accumulator::to_bytes`] writes it.
    ///
    /// # Errors
    /// Errors of the source; [`AnalysisError::NotAnAccumulator`] when pass and method do not fit together.
    pub fn make(&self, source: &dyn ShapeSource, measured: Measured<'_>) -> Result<Vec<u8>, AnalysisError> {
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

    /// Sums of this pass as [`make`](Self::make) returns them, merged in their order: the sum of a group of
    /// [`FAN_IN`](crate::accumulate::FAN_IN) parts, or of as many groups. The first one may be the result of an earlier call.
    ///
    /// # Errors
    /// [`AnalysisError::NotAnAccumulator`] for bytes that are not a sum of this pass.
    pub fn merge(&self, sums: &[&[u8]], measured: Measured<'_>) -> Result<Vec<u8>, AnalysisError> {
        self.sum.merge(sums, measured)
    }
}

impl Sum {
    fn make(&self, source: &dyn ShapeSource, measured: Measured<'_>) -> Result<Vec<u8>, AnalysisError> {
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
            _ => Err(AnalysisError::NotAnAccumulator),
        }
    }

    fn merge(&self, sums: &[&[u8]], measured: Measured<'_>) -> Result<Vec<u8>, AnalysisError> {
        let length = measured.metric.len();
        let fits = |numbers: &[f64]| !numbers.is_empty() && numbers.len().is_multiple_of(length);
        match (self, measured.method) {
            (Self::Projectors, Method::Projection(class)) => {
                merge_serialised(sums, || ProjectorSum::new(class, length))
            }
            (Self::Frame { elements }, _) if fits(elements) => {
                let elements = Matrix::from_column_slice(length, elements.len() / length, elements);
                merge_serialised(sums, || FrameSum::new(&elements))
            }
            (Self::Fits { fit, mean }, _) if mean.len() == length => {
                merge_serialised(sums, || FittedSum::new(*fit, mean))
            }
            (Self::Scatter { origin }, _) if origin.len() == length => {
                merge_serialised(sums, || ScatterSum::about(origin.clone()))
            }
            _ => Err(AnalysisError::NotAnAccumulator),
        }
    }
}
