//! Histograms of a permutation statistic: the reference of the observed value.

/// Number of bins: enough to see the shape of a distribution, few enough for every pair of fifty groups.
pub const BINS: usize = 40;

/// `R²` of the relabellings, without the observed labelling, in bins of equal width from 0 to `upper`.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ExplainedHistogram {
    /// Upper end of the last bin: the largest `R²` of the relabellings, or the observed one if it is larger.
    pub upper: f64,
    /// Number of relabellings in each of the 40 bins; a value between two bins counts in the upper one. The sum is `permutations`.
    pub counts: Vec<usize>,
}

impl ExplainedHistogram {
    /// Histogram of `values`, whose order does not matter. If `holds_observed`, the observed labelling is one of them, and is
    /// left out. `None` without values.
    pub(crate) fn new(values: &[f64], observed: f64, holds_observed: bool) -> Option<Self> {
        if values.is_empty() {
            return None;
        }
        let upper = values.iter().copied().fold(observed, f64::max);
        // Without any variation all values are 0, in the first bin.
        let per_unit = if upper > 0.0 { BINS as f64 / upper } else { 0.0 };
        let bin = |value: f64| ((value * per_unit) as usize).min(BINS - 1);
        let mut counts = vec![0; BINS];
        for &value in values {
            counts[bin(value)] += 1;
        }
        if holds_observed {
            // The same sums in another order may fall on the other side of a border.
            let near =
                values.iter().copied().min_by(|a, b| (a - observed).abs().total_cmp(&(b - observed).abs()));
            counts[bin(near.unwrap_or(observed))] -= 1;
        }
        Some(Self { upper, counts })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(histogram: &ExplainedHistogram) -> Vec<(usize, usize)> {
        histogram.counts.iter().copied().enumerate().filter(|(_, count)| *count > 0).collect()
    }

    #[test]
    fn bins_reach_from_zero_to_the_largest_value() {
        let found = ExplainedHistogram::new(&[0.0, 0.1, 0.2, 0.35, 0.4], 0.2, false).unwrap();
        assert_eq!((found.upper, found.counts.len()), (0.4, BINS));
        assert_eq!(filled(&found), [(0, 1), (10, 1), (20, 1), (35, 1), (39, 1)]);
        // The observed value is larger than all others: there is room up to it.
        let found = ExplainedHistogram::new(&[0.1, 0.1], 0.8, false).unwrap();
        assert_eq!((found.upper, filled(&found)), (0.8, vec![(5, 2)]));
    }

    #[test]
    fn the_observed_labelling_is_left_out_once_even_if_rounded_otherwise() {
        let (observed, rounded) = (0.2, 0.2 - 1e-17);
        let found = ExplainedHistogram::new(&[0.4, rounded, 0.2 - 1e-3], observed, true).unwrap();
        assert_eq!(found.counts.iter().sum::<usize>(), 2);
        assert_eq!(filled(&found), [(19, 1), (39, 1)]);
    }

    #[test]
    fn without_variation_all_values_are_in_the_first_bin() {
        let found = ExplainedHistogram::new(&[0.0; 3], 0.0, true).unwrap();
        assert_eq!((found.upper, filled(&found)), (0.0, vec![(0, 2)]));
        assert_eq!(ExplainedHistogram::new(&[], 0.5, false), None);
    }
}
