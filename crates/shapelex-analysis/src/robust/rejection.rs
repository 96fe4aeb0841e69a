//! Which shapes are wrong: from their scores and residuals to the factors of their weights.

use super::groups::outside_groups;
use super::minority::Scores;
use super::moments::{Moments, square};
use super::sources::ROUNDING;
use crate::factors::Minority;

/// Weight of the densest majority.
pub(super) const MAJORITY: f64 = 0.65;

/// Standard deviations of a normal distance up to which a shape counts fully, and from which on not at all.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limits {
    full: f64,
    none: f64,
}

/// Limits for means and covariances of the scores: included shapes widen them. Of normal data, 0.13 % lie beyond the first.
const STRICT: Limits = Limits { full: 3.0, none: 5.0 };

/// Limits of the factors themselves: real data have longer tails than normal ones, and a right shape left out may turn a mode
/// more than a wrong one kept that is hardly farther away.
const FINAL: Limits = Limits { full: 4.5, none: 6.0 };

/// Fraction of the spatial signs that the components explain.
const SHARE: f64 = 0.95;

/// Number of distinct shapes for each component.
const SHAPES_PER_COMPONENT: f64 = 8.0;

/// Limits grow by `1 + 5/n` for `n` shapes: the spread of few is uncertain.
const FEW: f64 = 5.0;

/// Most steps of a search that ends by itself long before.
const STEPS: usize = 50;

/// Quartiles of the standard normal distribution: ± this.
const QUARTILE: f64 = 0.674_489_750_196_081_7;

/// Least standard deviation of a normal distance, as a fraction of its centre: distances that vary less are equal.
const LEAST_SPREAD: f64 = 1e-3;

/// Rounding errors of cumulated weights, as a fraction of their sum.
const TIE: f64 = 1e-12;

/// Number of equal weights that `weights` are worth, `(Σw)²/Σw²`; zero without weights.
pub(super) fn effective(weights: &[f64]) -> f64 {
    let sum: f64 = weights.iter().sum();
    let squares: f64 = weights.iter().map(|weight| weight * weight).sum();
    if squares > 0.0 { sum * sum / squares } else { 0.0 }
}

/// Positions in the order of ascending values.
pub(super) fn order(values: &[f64]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    order
}

/// The least of the values at ascending positions `order` up to which a fraction `part` of the weight lies.
fn quantile(values: &[f64], weights: &[f64], order: &[usize], part: f64) -> f64 {
    let total: f64 = order.iter().map(|&k| weights[k]).sum();
    let mut below = 0.0;
    for &k in order {
        below += weights[k];
        if below >= part * total * (1.0 - TIE) {
            return values[k];
        }
    }
    order.last().map_or(0.0, |&k| values[k])
}

/// The least value up to which a fraction `part` of the weight lies. Equal weights take no sorting.
pub(super) fn smallest(values: &[f64], weights: &[f64], part: f64) -> f64 {
    let equal = weights.first().is_some_and(|first| *first > 0.0 && weights.iter().all(|w| w == first));
    if !equal {
        return quantile(values, weights, &order(values), part);
    }
    let at = (part * values.len() as f64 * (1.0 - TIE)).ceil() as usize;
    let mut values = values.to_vec();
    *values.select_nth_unstable_by(at.saturating_sub(1), f64::total_cmp).1
}

/// Weighted median.
pub(super) fn median(values: &[f64], weights: &[f64]) -> f64 {
    smallest(values, weights, 0.5)
}

/// Distances as standard normal numbers, `(v^⅔ − centre)/spread`, with a centre and spread that a third of outliers above does not
/// carry away: those of the lower half first, then the quartiles of all within the limit, until these stay the same. `spread`
/// is multiplied by `inflation`, and is at least `least^⅔`.
pub(super) fn normal(values: &[f64], weights: &[f64], inflation: f64, least: f64) -> Vec<f64> {
    let powers: Vec<f64> = values.iter().map(|value| value.cbrt().powi(2)).collect();
    let order = order(&powers);
    let of = |within: &[usize], part| quantile(&powers, weights, within, part);
    let wide =
        |centre: f64, spread: f64| spread.max(LEAST_SPREAD * centre).max(least.cbrt().powi(2)) * inflation;
    let mut centre = of(&order, 0.5);
    let mut spread = wide(centre, (centre - of(&order, 0.25)) / QUARTILE);
    let mut within = 0;
    for _ in 0..STEPS {
        let count = order.partition_point(|&k| powers[k] <= centre + STRICT.full * spread);
        if count == within {
            break;
        }
        within = count;
        let kept = &order[..within];
        centre = of(kept, 0.5);
        spread = wide(centre, (of(kept, 0.75) - of(kept, 0.25)) / (2.0 * QUARTILE));
    }
    powers.iter().map(|power| (power - centre) / spread).collect()
}

impl Limits {
    /// One up to the first limit, zero from the second one on, and smooth between.
    fn factor(self, deviation: f64) -> f64 {
        let part = ((deviation - self.full) / (self.none - self.full)).clamp(0.0, 1.0);
        (1.0 - part * part).powi(2)
    }
}

/// All shapes by their leading scores and the residuals of these.
pub(super) struct Description {
    /// `q` scores of each shape, one after the other.
    scores: Vec<f64>,
    components: usize,
    /// Residuals of the scores.
    residuals: Vec<f64>,
    weights: Vec<f64>,
    /// Number of distinct shapes of the same weight that the weights are worth.
    distinct: f64,
    inflation: f64,
    /// Norm of the mean.
    size: f64,
}

impl Description {
    /// From `(scores, squared deviation, weight)` of each shape, and the share of each score in the spatial signs. As many
    /// scores are used as explain [`SHARE`], and as there are enough shapes for.
    pub(super) fn new(described: Vec<(Vec<f64>, f64, f64)>, shares: Vec<f64>, size: f64) -> Self {
        let weights: Vec<f64> = described.iter().map(|(.., weight)| *weight).collect();
        let squares: Vec<f64> = described.iter().map(|(_, square, _)| *square).collect();
        let distinct = effective(&merged(&squares, &weights));
        let mut explained = 0.0;
        let explaining = shares.iter().take_while(|share| {
            let further = explained < SHARE;
            explained += *share;
            further
        });
        let components = explaining.count().min(((distinct - 1.0) / SHAPES_PER_COMPONENT).max(0.0) as usize);
        let scores: Vec<f64> =
            described.iter().flat_map(|(scores, ..)| &scores[..components]).copied().collect();
        let left = |(k, square): (usize, &f64)| {
            let known = &scores[k * components..(k + 1) * components];
            (square - known.iter().map(|t| t * t).sum::<f64>()).max(0.0).sqrt()
        };
        let residuals = squares.iter().enumerate().map(left).collect();
        let inflation = 1.0 + FEW / distinct.max(1.0);
        Self { scores, components, residuals, weights, distinct, inflation, size }
    }

    /// Weights of the shapes, as given.
    pub(super) fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// Number of distinct shapes of the same weight in a part `weight` of all.
    pub(super) fn distinct_of(&self, weight: f64) -> f64 {
        self.distinct * weight / self.weights.iter().sum::<f64>()
    }

    /// The factor of each shape, for the next estimate. `known`: factors of an earlier description, instead of the densest
    /// majority.
    pub(super) fn factors(&self, known: Option<&[f64]>) -> Vec<f64> {
        self.within(STRICT, known)
    }

    /// The factor of each shape in the estimate. `known`: factors of an earlier description.
    pub(super) fn final_factors(&self, known: &[f64]) -> Vec<f64> {
        self.within(FINAL, Some(known))
    }

    fn within(&self, limits: Limits, known: Option<&[f64]>) -> Vec<f64> {
        let outside = normal(&self.residuals, &self.weights, self.inflation, ROUNDING * self.size);
        let of = |limits: Limits, inside: &[f64]| -> Vec<f64> {
            inside.iter().zip(&outside).map(|(a, b)| limits.factor(a.max(*b))).collect()
        };
        if self.components == 0 {
            return of(limits, &outside);
        }
        let mut weights = match known {
            Some(known) => self.weights.iter().zip(known).map(|(weight, factor)| weight * factor).collect(),
            None => self.majority(),
        };
        let mut inside = Vec::new();
        for _ in 0..REWEIGHTED {
            let distances: Vec<f64> = self.distances(&weights).iter().map(|square| square.sqrt()).collect();
            inside = normal(&distances, &self.weights, self.inflation, LEAST_DISTANCE);
            let factors = of(STRICT, &inside);
            weights = self.weights.iter().zip(factors).map(|(weight, factor)| weight * factor).collect();
        }
        of(limits, &inside)
    }

    /// Weights of the shapes of the densest majority, zero for the others: begun with the shapes that are near to the medians of the
    /// scores, each step keeps those near to the mean of the ones before, in the metric of their covariance. The determinant of
    /// that never rises.
    fn majority(&self) -> Vec<f64> {
        let mut chosen = self.nearest(&self.median_distances());
        for _ in 0..STEPS {
            let next = self.nearest(&self.distances(&chosen));
            if next == chosen {
                break;
            }
            chosen = next;
        }
        chosen
    }

    fn nearest(&self, distances: &[f64]) -> Vec<f64> {
        let limit = smallest(distances, &self.weights, MAJORITY);
        let pairs = distances.iter().zip(&self.weights);
        pairs.map(|(distance, weight)| if *distance <= limit { *weight } else { 0.0 }).collect()
    }

    /// `Σ_i ((t_i − median)/median deviation)²` of each shape.
    fn median_distances(&self) -> Vec<f64> {
        let mut distances = vec![0.0; self.weights.len()];
        for i in 0..self.components {
            let scores: Vec<f64> = self.scores.iter().skip(i).step_by(self.components).copied().collect();
            let centre = median(&scores, &self.weights);
            let away: Vec<f64> = scores.iter().map(|score| (score - centre).abs()).collect();
            let scale = median(&away, &self.weights).max(ROUNDING * self.size);
            distances.iter_mut().zip(away).for_each(|(sum, away)| *sum += (away / scale).powi(2));
        }
        distances
    }

    /// Squared Mahalanobis distances in the mean and covariance under `weights`.
    fn distances(&self, weights: &[f64]) -> Vec<f64> {
        let q = self.components;
        let Moments { mean, mut covariance, .. } = Moments::of(&self.scores, q, weights);
        let least = (ROUNDING * self.size).powi(2).max(ROUNDING.powi(2) * covariance.trace());
        (0..q).for_each(|i| covariance[(i, i)] += least);
        // The diagonal makes it definite.
        let Some(root) = covariance.cholesky() else { return vec![0.0; self.weights.len()] };
        let (lower, mut away) = (root.unpack(), vec![0.0; q]);
        self.scores.chunks_exact(q).map(|t| square(&lower, &mean, t, &mut away)).collect()
    }

    /// The compact minority among the shapes with these factors, if there is one.
    pub(super) fn minority(&self, factors: &[f64]) -> Option<Minority> {
        let Self { scores, components, weights, size, .. } = self;
        Scores { scores, q: *components, weights }.minority(factors, *size)
    }

    /// Zero for the shapes in [groups](super::groups) of wrong ones, one for the others. `start`: scores of a change of the start
    /// point, which is not a difference.
    pub(super) fn outside_groups(&self, start: Option<Vec<f64>>) -> Vec<f64> {
        let q = self.components;
        if q == 0 {
            return vec![1.0; self.weights.len()];
        }
        let mut scores = self.scores.clone();
        let start = start.map(|start| start[..q].to_vec()).unwrap_or_default();
        let square: f64 = start.iter().map(|s| s * s).sum();
        if square > (ROUNDING * self.size).powi(2) {
            for t in scores.chunks_exact_mut(q) {
                let part = t.iter().zip(&start).map(|(t, s)| t * s).sum::<f64>() / square;
                t.iter_mut().zip(&start).for_each(|(t, s)| *t -= part * s);
            }
        }
        outside_groups(&scores, q, &self.weights, self.distinct)
    }
}

/// Number of times that mean and covariance of the scores are estimated from the shapes within the limit.
const REWEIGHTED: usize = 3;

/// Mahalanobis distance below which shapes are equally near: distances that vary have the size of the root of the dimension.
const LEAST_DISTANCE: f64 = 1e-2;

/// Weights of equal shapes added up, by their distances: copies of a shape have equal bits, so that one given twice counts as one of
/// twice the weight.
fn merged(squares: &[f64], weights: &[f64]) -> Vec<f64> {
    let mut merged: Vec<f64> = Vec::new();
    let mut last = f64::NAN;
    for k in order(squares) {
        match merged.last_mut() {
            Some(sum) if squares[k] == last => *sum += weights[k],
            _ => merged.push(weights[k]),
        }
        last = squares[k];
    }
    merged
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers between 0 and 1, evenly spread by the golden ratio.
    fn even(k: usize) -> f64 {
        (k as f64 * 0.618_033_988_749_895).fract()
    }

    #[test]
    fn normal_distances_keep_their_weight_and_outliers_lose_it() {
        // Distances with two degrees of freedom: √(−2 ln u).
        let clean: Vec<f64> = (1..=700).map(|k| (-2.0 * even(k).max(1e-6).ln()).sqrt()).collect();
        let of = |values: &[f64]| -> Vec<f64> {
            let weights = vec![1.0; values.len()];
            normal(values, &weights, 1.0, 1e-8).into_iter().map(|z| STRICT.factor(z)).collect()
        };
        let alone = of(&clean);
        assert!(alone.iter().sum::<f64>() > 695.0, "{}", alone.iter().sum::<f64>());
        let with: Vec<f64> = clean.iter().copied().chain((0..300).map(|k| 8.0 + even(k))).collect();
        let found = of(&with);
        assert!(found[..700].iter().sum::<f64>() > 690.0);
        assert!(found[700..].iter().all(|factor| *factor == 0.0));
    }

    #[test]
    fn equal_distances_and_rounding_errors_reject_nothing() {
        for values in [vec![0.0; 9], vec![0.3; 9], (0..9).map(|k| 1e-12 * even(k)).collect::<Vec<_>>()] {
            assert!(
                normal(&values, &[1.0; 9], 1.0, 1e-8).into_iter().map(|z| STRICT.factor(z)).all(|f| f == 1.0)
            );
        }
    }

    #[test]
    fn a_weight_of_two_is_the_shape_twice() {
        let described = |k: usize, weight: f64| {
            let scores = vec![even(k) - 0.5, 0.3 * (even(3 * k) - 0.5)];
            let square = scores.iter().map(|t| t * t).sum::<f64>() + 0.01 * even(7 * k);
            (scores, square, weight)
        };
        let wrong = |k: usize| (vec![3.0 + even(k), -2.0], 13.0 + even(k), 1.0);
        let shares = || vec![0.8, 0.19];
        let once = (0..40).map(|k| described(k, if k == 7 { 2.0 } else { 1.0 })).chain((0..12).map(wrong));
        let twice = (0..40).map(|k| described(k, 1.0)).chain((0..12).map(wrong)).chain([described(7, 1.0)]);
        let once = Description::new(once.collect(), shares(), 1.0);
        let twice = Description::new(twice.collect(), shares(), 1.0);
        assert_eq!((once.components, once.inflation), (2, twice.inflation));
        let (once, twice) = (once.factors(None), twice.factors(None));
        assert!(once.iter().zip(&twice).all(|(a, b)| (a - b).abs() < 1e-12));
        assert_eq!(twice[7], twice[52]);
        assert!(once[40..].iter().all(|f| *f == 0.0) && once[..40].iter().sum::<f64>() > 39.0);
    }

    #[test]
    fn equal_weights_have_the_quantiles_of_others() {
        let values: Vec<f64> = (0..41).map(|k| (even(3 * k) * 16.0).round()).collect();
        let mut weights = [0.3; 41];
        for part in [0.25, 0.5, 0.65, 1.0] {
            weights[7] = 0.3;
            let equal = smallest(&values, &weights, part);
            weights[7] = 0.3 + 1e-14;
            assert_eq!(equal, smallest(&values, &weights, part), "{part}");
        }
    }

    #[test]
    fn weights_are_worth_a_number_of_equal_ones() {
        assert_eq!([effective(&[2.0; 4]), effective(&[]), effective(&[0.0])], [4.0, 0.0, 0.0]);
        assert!(effective(&[1.0, 1e-9, 1e-9]) < 1.001);
    }
}
