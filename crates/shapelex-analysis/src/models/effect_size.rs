//! p values and effect sizes of lists of a statistic: the observed value first, then those of the permutations.
//!
//! ```text
//! p = #{b ≥ 0: s_b ≥ s_0 (1 − 1e-9)}/(B + 1)
//! Z = (t_0 − t̄)/σ,   t the Box–Cox transform of s with the λ that fits the permuted values, t̄ and σ of all B + 1 values
//! ```
//!
//! Source: Collyer and Adams 2018; the transformation: Box and Cox 1964.

use crate::inference::reaches;

/// Bound of the exponents of the transformation.
const MOST: f64 = 5.0;
/// Step of the grid before the likelihood equation is solved.
const STEP: f64 = 0.05;
/// Exponents below which the transformation is the logarithm.
const LOGARITHM: f64 = 1e-3;

/// Transformation before a statistic is standardised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum Transform {
    /// Box and Cox, with the exponent of the largest likelihood.
    #[default]
    BoxCox,
    /// The logarithm.
    Log,
    /// None.
    None,
}

/// An effect size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EffectSize {
    /// `Z`.
    pub z: f64,
    /// Exponent of the transformation.
    pub lambda: f64,
    /// `t_0 − t̄`.
    pub difference: f64,
    /// `σ`.
    pub deviation: f64,
}

impl EffectSize {
    /// `(d_1 − d_2)/√(σ_1² + σ_2²)` of the effects of two samples, `d = t_0 − t̄`: nearly normal if they are equal. `None` if neither
    /// varies.
    ///
    /// Source: Adams and Collyer 2016.
    pub fn compared(&self, other: &Self) -> Option<f64> {
        let deviation = self.deviation.hypot(other.deviation);
        (deviation > 0.0).then(|| (self.difference - other.difference) / deviation)
    }
}

/// Number of values that reach the first one, itself included.
pub fn reaching(values: &[f64]) -> usize {
    let Some(&observed) = values.first() else { return 0 };
    values.iter().filter(|value| reaches(**value, observed)).count()
}

/// Takes out one of the `values` behind the first that equals it best: all exchanges were made, the observed one among them.
pub(crate) fn drop_observed(values: &mut Vec<f64>) {
    let Some(&observed) = values.first() else { return };
    let distance = |k: usize| (values[k] - observed).abs();
    if let Some(nearest) = (1..values.len()).min_by(|&a, &b| distance(a).total_cmp(&distance(b))) {
        values.swap_remove(nearest);
    }
}

/// Effect size of the first of `values`; `None` without others, or if a value is not finite.
pub fn effect_size(values: &[f64], transform: Transform) -> Option<EffectSize> {
    if values.len() < 2 || values.iter().any(|value| !value.is_finite()) {
        return None;
    }
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let shifted: Vec<f64> = match transform {
        Transform::None => values.to_vec(),
        _ if least <= 0.0 => values.iter().map(|value| value - least + 1e-4).collect(),
        _ => values.to_vec(),
    };
    let lambda = match transform {
        Transform::BoxCox => exponent(&shifted[1..]),
        Transform::Log => 0.0,
        Transform::None => 1.0,
    };
    let moved: Vec<f64> = shifted.iter().map(|value| transformed(*value, lambda)).collect();
    let count = moved.len() as f64;
    let mean = moved.iter().sum::<f64>() / count;
    let variance = moved.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
    let (difference, deviation) = (moved[0] - mean, variance.sqrt());
    let z = if variance > 0.0 { difference / deviation } else { 0.0 };
    z.is_finite().then_some(EffectSize { z, lambda, difference, deviation })
}

fn transformed(value: f64, lambda: f64) -> f64 {
    if lambda.abs() < LOGARITHM { value.ln() } else { (value.powf(lambda) - 1.0) / lambda }
}

/// The exponent that maximises the likelihood of `values`, all positive.
fn exponent(values: &[f64]) -> f64 {
    let logs: Vec<f64> = values.iter().map(|value| value.ln()).collect();
    let mean = logs.iter().sum::<f64>() / logs.len() as f64;
    // Values over their geometric mean: the likelihood is that of the variance alone.
    let logs: Vec<f64> = logs.iter().map(|log| log - mean).collect();
    let count = (2.0 * MOST / STEP).round() as usize;
    let at = |k: usize| -MOST + STEP * k as f64;
    let best = (0..=count)
        .min_by(|&a, &b| log_variance(&logs, at(a)).total_cmp(&log_variance(&logs, at(b))))
        .unwrap_or(0);
    let (mut low, mut high) = (at(best.saturating_sub(1)), at((best + 1).min(count)));
    if slope(&logs, low) > 0.0 || slope(&logs, high) < 0.0 {
        return at(best);
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if slope(&logs, middle) > 0.0 {
            high = middle
        } else {
            low = middle
        }
        if high - low < 1e-10 {
            break;
        }
    }
    0.5 * (low + high)
}

/// The transform `(e^{λx} − 1)/λ` and its derivative by `λ`.
fn box_cox(x: f64, lambda: f64) -> (f64, f64) {
    let product = lambda * x;
    if product.abs() < 1e-4 {
        // The series: no digits are lost near λ = 0.
        return (
            x * (1.0 + product / 2.0 + product * product / 6.0),
            x * x * (0.5 + product / 3.0 + product * product / 8.0),
        );
    }
    let value = product.exp_m1() / lambda;
    (value, (x * product.exp() - value) / lambda)
}

/// Logarithm of the sum of squares about the mean.
fn log_variance(logs: &[f64], lambda: f64) -> f64 {
    let values: Vec<f64> = logs.iter().map(|x| box_cox(*x, lambda).0).collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let sum: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    if sum.is_finite() { sum.ln() } else { f64::INFINITY }
}

/// Half of the derivative of the sum of squares by `λ`, whose sign is that of its logarithm.
fn slope(logs: &[f64], lambda: f64) -> f64 {
    let pairs: Vec<(f64, f64)> = logs.iter().map(|x| box_cox(*x, lambda)).collect();
    let mean = pairs.iter().map(|(value, _)| value).sum::<f64>() / pairs.len() as f64;
    pairs.iter().map(|(value, change)| (value - mean) * change).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_that_are_all_equal_have_no_effect() {
        let found = effect_size(&[2.0; 5], Transform::BoxCox).unwrap();
        assert_eq!(found.z, 0.0);
        assert_eq!(reaching(&[2.0; 5]), 5);
        assert_eq!(effect_size(&[1.0], Transform::BoxCox), None);
        assert_eq!(effect_size(&[1.0, f64::INFINITY], Transform::BoxCox), None);
    }

    #[test]
    fn the_logarithm_is_the_transformation_of_lognormal_values() {
        // Symmetric logarithms: the likelihood is largest at 0 by symmetry.
        let values: Vec<f64> = [0.3_f64, -1.0, 1.0, -0.4, 0.4, -0.1, 0.1].map(f64::exp).to_vec();
        let found = effect_size(&values, Transform::BoxCox).unwrap();
        assert!(found.lambda.abs() < 1e-8, "{found:?}");
        let log = effect_size(&values, Transform::Log).unwrap();
        assert!((found.z - log.z).abs() < 1e-7);
    }

    #[test]
    fn negative_statistics_are_shifted() {
        let found = effect_size(&[0.5, -0.2, 0.1, 0.0, -0.3], Transform::BoxCox).unwrap();
        let moved = effect_size(&[0.8001, 0.1001, 0.4001, 0.3001, 0.0001], Transform::BoxCox).unwrap();
        assert!((found.z - moved.z).abs() < 1e-6, "{found:?} {moved:?}");
    }
}
