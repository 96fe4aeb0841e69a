//! Novelty detection: how far from the training shapes a shape must be to count as an outlier, calibrated on held-out shapes.
//!
//! ```text
//! m = max( (ln T² − a)/b, (ln Q − c)/e )      a, c means and b, e standard deviations of the n held-out logarithms
//! ```
//!
//! A shape is an outlier at level `q` if its `m` exceeds a limit that one of `n + 1` exchangeable values exceeds with
//! probability `1 − q`. If five or more values lie beyond the limit, it is an order statistic (`(n + 1) q`, with linear
//! interpolation). With fewer, the distances `x` of the `k` largest values from the value before them are modelled as
//! exponential. Their predictive distribution is
//!
//! ```text
//! P(x > s) = (1 + s/Σx)^−k,      so that      limit = m₍ₙ₋ₖ₎ + Σx (((k + 1)/((n + 1)(1 − q)))^(1/k) − 1)
//! ```
//!
//! Gross errors among the held-out shapes are left out first (`gross_errors`): a few of them would stretch
//! the fitted tail until no other shape is an outlier. `T²` is then the squared distance in mean and covariance of the scores of the
//! shapes that are left.
//!
//! One limit serves both measures: separate limits at level `q` would give up to twice as many false alarms. Logarithms are
//! used because `T²` and `Q` of few shapes have power-law tails.
//!
//! Sources: Vovk, Gammerman and Shafer 2005 (ranks); Weissman 1978 (exponential spacings of the largest values); the
//! predictive distribution is Lomax's, exact for exponential distances.

/// Minimum and maximum number of largest values to which a tail is fitted; between them, one value in `PART_IN_TAIL`.
/// Measured on random halves of fourteen sets of outlines (`docs/evaluation.md`): with 20 values, a longer tail gives half of
/// the expected alarms at 0.99; a tail of the square root of their number gives up to one and a half times as many at 0.95.
const IN_TAIL: (usize, usize) = (5, 20);
const PART_IN_TAIL: usize = 5;

/// Minimum number of values beyond the limit for which the limit is an order statistic, which is calibrated for every
/// distribution. A fitted tail is not: with 150 uniform values it gave 6.4 % of alarms instead of 5.
const ENOUGH_BEYOND: f64 = 5.0;

/// Minimum standard deviation of a logarithm: shapes that are all described to rounding are not standardised.
const MIN_DEVIATION: f64 = 1e-6;

/// Smallest value of a measure, so that its logarithm is finite.
const LEAST: f64 = 1e-300;

/// Mean and standard deviation of logarithms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Logarithms {
    /// Their mean.
    pub mean: f64,
    /// Their standard deviation.
    pub deviation: f64,
}

impl Logarithms {
    /// From positive values; zeros count as the smallest value.
    pub fn of(values: &[f64]) -> Self {
        Self::of_logarithms(&values.iter().map(|value| value.max(LEAST).ln()).collect::<Vec<f64>>())
    }

    /// From logarithms.
    pub(super) fn of_logarithms(logarithms: &[f64]) -> Self {
        let n = logarithms.len() as f64;
        let mean = logarithms.iter().sum::<f64>() / n.max(1.0);
        let squares: f64 = logarithms.iter().map(|l| (l - mean) * (l - mean)).sum();
        Self::new(mean, (squares / (n - 1.0).max(1.0)).sqrt())
    }

    /// With the smallest deviation that is told from rounding, or more.
    pub(super) fn new(mean: f64, deviation: f64) -> Self {
        Self { mean, deviation: deviation.max(MIN_DEVIATION) }
    }

    /// A logarithm as a number of standard deviations.
    pub(super) fn standard(self, logarithm: f64) -> f64 {
        (logarithm - self.mean) / self.deviation
    }

    fn standardise(self, value: f64) -> f64 {
        self.standard(value.max(LEAST).ln())
    }
}

/// Standardises the two outlier measures so that they can be compared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Novelty {
    /// Logarithms of `T²`; `None` for sparse codes.
    pub distances: Option<Logarithms>,
    /// Logarithms of `Q = ‖y − ŷ‖²`.
    pub residuals: Logarithms,
}

impl Novelty {
    /// The combined measure `m`.
    pub fn measure(&self, distance: Option<f64>, residual: f64) -> f64 {
        let by_residual = self.residuals.standardise(residual);
        match self.distances.zip(distance) {
            Some((logarithms, distance)) => by_residual.max(logarithms.standardise(distance)),
            None => by_residual,
        }
    }
}

/// The limit that a new value exceeds with probability `1 − quantile`, given exchangeable values in ascending order.
/// Infinite for fewer than two values.
pub fn limit(ascending: &[f64], quantile: f64) -> f64 {
    let n = ascending.len();
    if n < 2 {
        return f64::INFINITY;
    }
    let in_tail = n.div_ceil(PART_IN_TAIL).clamp(IN_TAIL.0, IN_TAIL.1).min(n - 1);
    let (start, beyond) = (n - in_tail - 1, (n + 1) as f64 * (1.0 - quantile));
    // A new value lies beyond the start of the tail with probability (in_tail + 1)/(n + 1).
    let ratio = (in_tail + 1) as f64 / beyond;
    if beyond < ENOUGH_BEYOND && ratio > 1.0 {
        let threshold = ascending[start];
        let sum: f64 = ascending[start + 1..].iter().map(|value| value - threshold).sum();
        return threshold + sum * (ratio.powf(1.0 / in_tail as f64) - 1.0);
    }
    let place = ((n + 1) as f64 * quantile - 1.0).max(0.0);
    let below = (place as usize).min(n - 2);
    ascending[below] + (place - below as f64) * (ascending[below + 1] - ascending[below])
}

#[cfg(test)]
mod tests {
    use rand::rngs::ChaCha12Rng;
    use rand::{RngExt, SeedableRng};

    use super::*;

    /// Fraction of new values beyond the limit of `n` others; `draw` maps uniform numbers in (0, 1) to values.
    fn false_alarms(n: usize, quantile: f64, draw: impl Fn(f64) -> f64) -> f64 {
        let mut random = ChaCha12Rng::seed_from_u64(n as u64);
        let trials = 10_000;
        let mut alarms = 0;
        for _ in 0..trials {
            let mut next = || draw(random.random_range(f64::EPSILON..1.0));
            let mut values: Vec<f64> = (0..n).map(|_| next()).collect();
            let new = next();
            values.sort_by(f64::total_cmp);
            alarms += usize::from(new > limit(&values, quantile));
        }
        alarms as f64 / f64::from(trials)
    }

    /// Exponential values give the nominal rate of alarms, for any number of values. The standard error of a fraction of
    /// 10 000 is at most 0.003.
    #[test]
    fn false_alarms_of_exponential_values_are_nominal() {
        for n in [5, 20, 55, 150, 500] {
            for quantile in [0.9, 0.95, 0.99, 0.999] {
                let found = false_alarms(n, quantile, |u| -u.ln());
                assert!((found - (1.0 - quantile)).abs() < 0.01, "{found} at {quantile} of {n}");
            }
        }
    }

    /// Values with shorter tails give fewer alarms than nominal, never more: logistic values a few, uniform values, which
    /// are bounded, half of them.
    #[test]
    fn shorter_tails_give_no_more_false_alarms() {
        for n in [20, 55, 150] {
            for quantile in [0.95, 0.99] {
                let logistic = false_alarms(n, quantile, |u| (u / (1.0 - u)).ln());
                assert!((logistic - (1.0 - quantile)).abs() < 0.012, "{logistic} at {quantile} of {n}");
                let uniform = false_alarms(n, quantile, |u| u);
                assert!(uniform < 1.0 - quantile + 0.01, "{uniform} at {quantile} of {n}");
            }
        }
    }

    #[test]
    fn limits_by_hand() {
        // The 70th of 99 values is exceeded by 30 of 100.
        let values: Vec<f64> = (1..100).map(f64::from).collect();
        assert!((limit(&values, 0.7) - 70.0).abs() < 1e-12);
        // The tail of twenty begins at 79 and sums to 1 + … + 20 = 210: 21 of 100 are beyond.
        let expected = 79.0 + 210.0 * (21.0_f64.powf(0.05) - 1.0);
        assert!((limit(&values, 0.99) - expected).abs() < 1e-9);
        assert_eq!(limit(&[1.0], 0.9), f64::INFINITY);
        // Equal values: any larger value is new.
        assert_eq!(limit(&[2.0; 7], 0.99), 2.0);
    }

    #[test]
    fn the_larger_measure_counts() {
        let [e1, e3] = [1.0_f64.exp(), 3.0_f64.exp()];
        let logarithms = Logarithms::of(&[e1, e3]);
        assert!(
            (logarithms.mean - 2.0).abs() < 1e-15 && (logarithms.deviation - 2.0_f64.sqrt()).abs() < 1e-15
        );
        let novelty = Novelty { distances: Some(logarithms), residuals: logarithms };
        assert!((novelty.measure(Some(e3), e1) - 0.5_f64.sqrt()).abs() < 1e-15);
        assert!((novelty.measure(Some(e1), e3) - 0.5_f64.sqrt()).abs() < 1e-15);
        let sparse = Novelty { distances: None, ..novelty };
        assert!((sparse.measure(None, e1) + 0.5_f64.sqrt()).abs() < 1e-15);
        assert!(Logarithms::of(&[0.0, 0.0]).standardise(1e-20) > 1e3, "beyond rounding");
    }
}
