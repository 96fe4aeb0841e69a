//! Estimates with intervals.

use crate::quantile::quantile;

/// Half of the width of a normal interval that covers 95 %, in standard errors.
const NORMAL: f64 = 1.96;

/// Tails of an interval that covers 95 %.
const TAILS: [f64; 2] = [0.025, 0.975];

/// An estimate with an interval that covers 95 %.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Interval {
    /// The estimate.
    pub value: f64,
    /// Lower end; null if it cannot be estimated.
    pub low: Option<f64>,
    /// Upper end; null if it cannot be estimated.
    pub high: Option<f64>,
}

impl Interval {
    /// The mean of independent non-negative values, ± 1.96 standard errors; without ends for a single value.
    pub(super) fn of_mean(values: &[f64]) -> Self {
        let (value, deviation) = moments(values);
        if values.len() < 2 {
            return Self { value, low: None, high: None };
        }
        let reach = NORMAL * deviation / (values.len() as f64).sqrt();
        Self { value, low: Some((value - reach).max(0.0)), high: Some(value + reach) }
    }

    /// An estimate of at most `most`, ± 1.96 standard deviations of its values in resampled data; without ends for fewer than two.
    /// Resamples have fewer different shapes, which makes their first components seem larger: their quantiles would leave the
    /// estimate out.
    pub(super) fn around(value: f64, most: f64, resampled: &[f64]) -> Self {
        if resampled.len() < 2 {
            return Self { value, low: None, high: None };
        }
        let (_, deviation) = moments(resampled);
        let reach = NORMAL * deviation;
        Self { value, low: Some((value - reach).max(0.0)), high: Some((value + reach).min(most)) }
    }

    /// The mean of the values of draws, with their quantiles at 2.5 and 97.5 %.
    pub(super) fn of_draws(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let [low, high] = TAILS.map(|tail| Some(quantile(&values, tail)));
        Self { value: moments(&values).0, low, high }
    }
}

/// Mean and standard deviation.
pub(super) fn moments(values: &[f64]) -> (f64, f64) {
    let count = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|x| (x - mean).powi(2)).sum();
    (mean, (squares / (count - 1.0).max(1.0)).sqrt())
}
