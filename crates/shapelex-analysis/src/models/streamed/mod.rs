//! A linear model of more shapes than fit into memory: of sums over a stream of them.
//!
//! * `design` — the design, with the `rows` that shapes with equal attributes share; `source` — shapes on their way into the sums;
//! * [`keyed`] — exchanges of which nothing is stored; `sums` — what is summed; `solved` — the table that the sums determine; `cost` — predicted.
//!
//! ```text
//! pass 1, 2, …   the mean, as of all shapes of a store, and the weights
//! last pass      U = QᵀY, T, S, and U_b = QᵀY[π_b], X_b = QᵀQ[π_b] of all draws at once
//! A_j = U_b − X_b M_j U,   SS_j = ‖B_jᵀ A_j‖²,   RSS_j = ‖R_j‖² − ‖A_j‖²          as of residuals in memory
//! ```
//!
//! `Q` is known before the last pass, from the attributes and the weights; residuals are not, and need not be: exchanges are linear. So
//! exchanges take no pass of their own. With equal lists of exchanges, tables are those of models in memory up to rounding; the lists
//! themselves are those of [`KeyedExchange`].
//!
//! Memory: the attributes, the different rows of the design, the weights, and the sums; none of it grows with the numbers of a shape times
//! the number of shapes.

mod cost;
mod design;
pub mod keyed;
mod rows;
mod solved;
mod source;
mod sums;
#[cfg(test)]
mod tests;

pub use self::cost::StreamWork;
pub use self::keyed::KeyedExchange;

use self::design::{MOST_OF_SCATTER, StreamedDesign};
use self::solved::Solved;
use self::source::{Brought, Weighed};
use self::sums::{DesignSums, Summed};
use super::anova::{FEWEST_EXCHANGES, average};
use super::error::ModelError;
use super::outcome::ModelRecord;
use super::study::{ModelQuestion, Response};
use crate::AnalysisError;
use crate::accumulate::{ShapeSource, ShapesInMemory, Watched, accumulate};
use crate::alignment::{MeanShape, mean_shape};
use crate::inference::aligned::{StudySpace, check_weight_range, mean_warnings};
use crate::inference::error::StudyError;
use crate::matching::Placed;
use crate::mean_record::MeanRecord;
use crate::watch::Watch;

/// Shapes of a stream with their mean and their weights.
pub struct StreamedShapes<'a> {
    source: &'a dyn ShapeSource,
    space: StudySpace<'a>,
    mean: Option<MeanShape>,
    weights: Vec<f64>,
}

impl<'a> StreamedShapes<'a> {
    /// The shapes of a source, prepared with [`Method::translates`](crate::alignment::Method::translates), after the passes of their mean,
    /// or after one for their weights alone if only numbers are modelled. `watch` is asked between parts.
    ///
    /// # Errors
    /// [`StudyError::Weights`]; degenerate or too few shapes; errors of the source; [`AnalysisError::Interrupted`] once `watch` stops.
    pub fn new(
        source: &'a dyn ShapeSource,
        space: StudySpace<'a>,
        needs_mean: bool,
        watch: &dyn Watch,
    ) -> Result<Self, StudyError> {
        let watched = Watched::new(source, watch);
        let weighed = Weighed::new(&watched);
        let StudySpace { metric, method, frame, matching, .. } = space;
        let mean = needs_mean.then(|| mean_shape(&weighed, metric, method, frame, matching)).transpose()?;
        let weights = weighed.into_weights()?;
        let smallest = weights.iter().copied().fold(f64::MAX, f64::min);
        check_weight_range(smallest, weights.iter().copied().fold(0.0, f64::max))?;
        Ok(Self { source, space, mean, weights })
    }

    /// The model of the shapes, in one pass. What [`ModelQuestion`] asks beside table, coefficients, predictions and a reduced model is
    /// left out, as are blocks and error terms.
    ///
    /// Cost: the mean's passes and one more; `n q (P + q)(1 + B)` multiply-adds for `n` shapes of `P` numbers, a design of rank `q` and `B`
    /// draws.
    ///
    /// # Errors
    /// As [`model`](super::study::model).
    pub fn model(&self, question: &ModelQuestion<'_>, watch: &dyn Watch) -> Result<ModelRecord, ModelError> {
        let mean = self.mean.as_ref().filter(|_| !matches!(question.response, Response::Numbers(_)));
        let length = mean.map_or(1, |mean| mean.whitened.len());
        let streamed = StreamedDesign::new(question, &self.weights, length)?;
        let strata: Option<Vec<u32>> =
            question.testing.strata.map(|labels| labels.iter().map(|&label| label as u32).collect());
        let distinct = streamed.basis.rows.distinct(strata.as_deref());
        let exchange = match distinct < FEWEST_EXCHANGES {
            true => None,
            false => streamed.exchange(strata.as_deref(), question),
        };
        let has_intercept = question.formula.intercept;
        let numbers = match question.response {
            Response::Numbers(numbers) => Some(numbers),
            Response::Shape | Response::Scores(_) => None,
        };
        let origin = match (mean, numbers) {
            (Some(mean), _) if has_intercept => mean.whitened.clone(),
            (None, Some(numbers)) if has_intercept => vec![average(numbers, &self.weights)],
            (Some(mean), _) => vec![0.0; mean.whitened.len()],
            (None, _) => vec![0.0],
        };
        let summed = Summed {
            basis: &streamed.basis,
            origin: &origin,
            exchange: exchange.as_ref(),
            scatter: origin.len() <= MOST_OF_SCATTER && strata.is_none(),
        };
        let sums = self.sums(summed, mean, numbers, watch)?;
        let metric = mean.map(|_| self.space.metric);
        let solved = Solved::new(&streamed, summed, sums);
        let mut record = solved.record(question, metric, distinct)?;
        record.pooled = mean.map(|mean| MeanRecord::of(mean, self.space.metric.dimension()));
        record.anova.warnings.splice(0..0, mean.map_or_else(Vec::new, mean_warnings));
        Ok(record)
    }

    fn sums<'s>(
        &self,
        summed: Summed<'s>,
        mean: Option<&MeanShape>,
        numbers: Option<&[f64]>,
        watch: &dyn Watch,
    ) -> Result<DesignSums<'s>, AnalysisError> {
        let Some(mean) = mean else {
            let numbers = numbers.unwrap_or_default().to_vec();
            let source = ShapesInMemory::prepared(numbers, self.weights.clone());
            return accumulate(&Watched::new(&source, watch), || DesignSums::new(summed));
        };
        let watched = Watched::new(self.source, watch);
        let (matching, placements) = (self.space.matching, mean.placements.as_slice());
        let placed = Placed { source: &watched, matching, placements };
        let brought = Brought { source: &placed, space: self.space, mean: &mean.whitened };
        accumulate(&brought, || DesignSums::new(summed))
    }
}
