//! Scores: how a shape compares with the training shapes of a dictionary.

use super::coding::CodedShape;
use super::content::{HeldOutMeasure, HeldOutStatistics, Statistics};
use super::in_use::Dictionary;
use super::model::{Model, squared_distance};
use super::novelty::{self, Logarithms, Novelty};
use crate::sparse::SparseCode;

/// Comparison of a shape with the training shapes.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// Scores; `None` for sparse dictionaries.
    pub scores: Option<Vec<f64>>,
    /// Squared Mahalanobis distance of the scores.
    pub t_squared: Option<f64>,
    /// Fraction of the training shapes, held out if possible, with a smaller or equal distance.
    pub t_squared_rank: Option<f64>,
    /// Squared prediction error `‖y − ŷ‖²`.
    pub residual: f64,
    /// Fraction of the training shapes, held out if possible, with a smaller or equal error.
    pub residual_rank: f64,
    /// Whether the larger of the two measures exceeds their common limit.
    pub outlier: bool,
}

impl Dictionary {
    /// Score of an encoded shape. Among shapes like those of the training, the fraction `1 − quantile` counts as
    /// outliers; `quantile` is at least 0.5 and below 1.
    pub fn score(&self, coded: &CodedShape, quantile: f64) -> Score {
        self.score_of(&coded.prepared.whitened, &coded.code, quantile)
    }

    /// Score of the prepared shape `y` with this code.
    pub(crate) fn score_of(&self, y: &[f64], code: &SparseCode, quantile: f64) -> Score {
        let residual = squared_distance(y, &self.model.reconstruct(code));
        let scores = matches!(self.model, Model::Components { .. }).then(|| code.values.clone());
        let compared = self.compared(self.model.distance(code), scores.as_deref(), residual, quantile);
        Score { scores, ..compared }
    }

    /// Compares both measures of a shape with those of the training shapes. With the scores, the distance of them from the held-out
    /// shapes without gross errors decides in place of `T²`, where there were some.
    pub(super) fn compared(
        &self,
        t_squared: Option<f64>,
        scores: Option<&[f64]>,
        residual: f64,
        quantile: f64,
    ) -> Score {
        let statistics = &self.content.statistics;
        let known = Known::of(statistics);
        let outlier = match &statistics.held_out {
            Some(held_out) => {
                let novelty = novelty_of(held_out);
                let among_typical = scores.and_then(|scores| self.typical_distance(scores));
                let measure = match among_typical.zip(logarithms_of_typical(held_out)) {
                    Some((distance, logarithms)) => {
                        Novelty { distances: Some(logarithms), ..novelty }.measure(Some(distance), residual)
                    }
                    None => novelty.measure(t_squared, residual),
                };
                measure > novelty::limit(&held_out.novelty, quantile)
            }
            None => {
                residual > value_at(known.residuals, quantile)
                    || t_squared.is_some_and(|distance| distance > value_at(known.t_squared, quantile))
            }
        };
        Score {
            scores: None,
            t_squared,
            t_squared_rank: t_squared.map(|distance| rank(known.t_squared, distance)),
            residual,
            residual_rank: rank(known.residuals, residual),
            outlier,
        }
    }
}

/// Reference values of both measures, ascending: of held-out training shapes if available, otherwise of the training
/// shapes themselves.
pub(crate) struct Known<'a> {
    /// Distances `T²`; empty for sparse dictionaries.
    pub(crate) t_squared: &'a [f64],
    /// Squared prediction errors `‖y − ŷ‖²`.
    pub(crate) residuals: &'a [f64],
}

impl<'a> Known<'a> {
    pub(crate) fn of(statistics: &'a Statistics) -> Self {
        if let Some(held_out) = &statistics.held_out {
            let t_squared = held_out.t_squared.as_ref().map_or(&[][..], |measure| &measure.values);
            return Self { t_squared, residuals: &held_out.residuals.values };
        }
        let t_squared = statistics.scores.as_ref().map_or(&[][..], |scores| &scores.t_squared);
        Self { t_squared, residuals: &statistics.residuals }
    }
}

fn novelty_of(held_out: &HeldOutStatistics) -> Novelty {
    let logarithms =
        |measure: &HeldOutMeasure| Logarithms { mean: measure.log_mean, deviation: measure.log_deviation };
    Novelty {
        distances: held_out.t_squared.as_ref().map(logarithms),
        residuals: logarithms(&held_out.residuals),
    }
}

/// Logarithms of the distances among the held-out shapes without gross errors, if there were some.
fn logarithms_of_typical(held_out: &HeldOutStatistics) -> Option<Logarithms> {
    let scores = held_out.gross_errors.as_ref()?.scores.as_ref()?;
    Some(Logarithms { mean: scores.log_mean, deviation: scores.log_deviation })
}

/// Fraction of the ascending `values` that are at most `value`.
pub(crate) fn rank(values: &[f64], value: f64) -> f64 {
    values.partition_point(|known| *known <= value) as f64 / values.len().max(1) as f64
}

/// Quantile of ascending values, with linear interpolation; infinite if there are none.
pub(crate) fn value_at(values: &[f64], quantile: f64) -> f64 {
    let Some(last) = values.len().checked_sub(1) else { return f64::INFINITY };
    let place = quantile * last as f64;
    let below = place.floor() as usize;
    let above = (below + 1).min(last);
    values[below] + (place - below as f64) * (values[above] - values[below])
}
