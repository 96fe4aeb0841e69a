//! A compact minority among the shapes that a robust estimate keeps: it is told, not left out.
//!
//! ```text
//! 1. start       the shape with the least sum of squared distances to the nearest 65 % of the weight (trimmed medoid)
//! 2. majority    the nearest 65 % to their own mean, in turns: the sum of their squared distances never rises
//! 3. minority    of the others those that are nearer to their own mean than half of their distance from the majority, beginning with the
//!                shape that has most weight about it in this sense; hardly a shape stands between the two means
//! ```
//!
//! Distances are those of shapes, not divided by the variation of the set as those of the [description](super::rejection): another
//! kind of shape widens that variation until it is within it. But sets of one kind may have such a part as well (two sides of a tooth, grains seen
//! from two sides), so that only a person can tell which it is.
//!
//! Nothing is drawn at random, and nothing depends on the order of the shapes.

use super::rejection::{MAJORITY, order, smallest};
use crate::factors::Minority;

/// Least share of a minority in the weight.
const LEAST: f64 = 0.08;

/// Fewest shapes of a minority.
const FEWEST: usize = 5;

/// A shape belongs to the minority if its distance from the mean of that is below this part of its distance from the majority.
const NEAR: f64 = 0.5;

/// Most weight in the middle half of the way between the two means, as a part of that of the minority: in the tail of a single kind more
/// shapes stand there than beyond.
const BETWEEN: f64 = 0.25;

/// Least part of the minority that the estimate keeps: shapes that it leaves out need not be told.
const KEPT: f64 = 0.5;

/// Least distance of the mean from that of the majority, in parts of its norm: a tail of a set moves it by less.
const LEAST_DISTANCE: f64 = 0.02;

/// Most shapes with which the search begins, and most distances from them.
const STARTS: usize = 400;
const DISTANCES: usize = 4_000_000;

/// Most turns of each search, which mostly end after a few.
const STEPS: usize = 50;

/// The scores of weighted shapes, `q` each.
pub(super) struct Scores<'a> {
    pub(super) scores: &'a [f64],
    pub(super) q: usize,
    pub(super) weights: &'a [f64],
}

fn squared(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

impl Scores<'_> {
    fn rows(&self) -> impl Iterator<Item = &[f64]> {
        self.scores.chunks_exact(self.q)
    }

    fn distances(&self, centre: &[f64]) -> Vec<f64> {
        self.rows().map(|t| squared(t, centre)).collect()
    }

    /// Mean of the shapes by these weights.
    fn mean(&self, weights: &[f64]) -> Vec<f64> {
        let total: f64 = weights.iter().sum();
        let mut mean = vec![0.0; self.q];
        for (t, weight) in self.rows().zip(weights) {
            mean.iter_mut().zip(t).for_each(|(sum, t)| *sum += weight / total * t);
        }
        mean
    }

    /// Weights of the nearest shapes, zero for the others.
    fn nearest(&self, distances: &[f64]) -> Vec<f64> {
        let limit = smallest(distances, self.weights, MAJORITY);
        let pairs = distances.iter().zip(self.weights);
        pairs.map(|(distance, weight)| if *distance <= limit { *weight } else { 0.0 }).collect()
    }

    /// Weights of the densest majority, zero for the others.
    fn majority(&self) -> Vec<f64> {
        let by_distance = order(&self.distances(&self.mean(self.weights)));
        let starts = STARTS.min(DISTANCES / self.weights.len()).clamp(1, self.weights.len());
        let candidates = (0..starts).map(|i| by_distance[i * self.weights.len() / starts]);
        let begun = candidates.map(|k| {
            let distances = self.distances(&self.scores[k * self.q..(k + 1) * self.q]);
            let near = self.nearest(&distances);
            (distances.iter().zip(&near).map(|(distance, weight)| distance * weight).sum::<f64>(), near)
        });
        let mut chosen = begun.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, near)| near).unwrap_or_default();
        for _ in 0..STEPS {
            let next = self.nearest(&self.distances(&self.mean(&chosen)));
            if next == chosen {
                break;
            }
            chosen = next;
        }
        chosen
    }

    /// Weights of the shapes that are not of the majority with this `centre` and agree with each other, zero for the others.
    fn apart(&self, majority: &[f64], centre: &[f64]) -> Vec<f64> {
        let far: Vec<f64> = self.weights.iter().zip(majority).map(|(weight, near)| weight - near).collect();
        let others = self.distances(centre);
        let about = |middle: &[f64]| -> Vec<f64> {
            let own = self.distances(middle);
            let is_near = |k: usize| own[k] < NEAR * NEAR * others[k];
            (0..far.len()).map(|k| if is_near(k) { far[k] } else { 0.0 }).collect()
        };
        let farthest = order(&others).into_iter().rev().filter(|&k| far[k] > 0.0);
        let starts = STARTS.min(DISTANCES / self.weights.len()).max(1);
        let begun = farthest.take(starts).map(|k| about(&self.scores[k * self.q..(k + 1) * self.q]));
        let mut members =
            begun.max_by(|a, b| a.iter().sum::<f64>().total_cmp(&b.iter().sum())).unwrap_or_default();
        for _ in 0..STEPS {
            if members.iter().all(|weight| *weight == 0.0) {
                break;
            }
            let next = about(&self.mean(&members));
            if next == members {
                break;
            }
            members = next;
        }
        members
    }

    /// Weight of the shapes in the middle half of the way from `centre` to `other`.
    fn between(&self, centre: &[f64], other: &[f64]) -> f64 {
        let way: Vec<f64> = other.iter().zip(centre).map(|(o, c)| o - c).collect();
        let length = squared(other, centre);
        let place =
            |t: &[f64]| t.iter().zip(centre).zip(&way).map(|((t, c), w)| (t - c) * w).sum::<f64>() / length;
        let is_between = |t: &[f64]| (0.25..=0.75).contains(&place(t));
        self.rows().zip(self.weights).filter(|(t, _)| is_between(t)).map(|(_, weight)| weight).sum()
    }

    /// The minority among the shapes with these `factors`, if there is one. `size`: norm of the mean.
    pub(super) fn minority(&self, factors: &[f64], size: f64) -> Option<Minority> {
        let kept: Vec<f64> =
            self.weights.iter().zip(factors).map(|(weight, factor)| weight * factor).collect();
        if self.q == 0 || self.weights.len() < 2 * FEWEST || kept.iter().sum::<f64>() <= 0.0 {
            return None;
        }
        let majority = self.majority();
        let centre = self.mean(&majority);
        let members = self.apart(&majority, &centre);
        let shapes = members.iter().filter(|weight| **weight > 0.0).count();
        let weight: f64 = members.iter().sum();
        let share = weight / self.weights.iter().sum::<f64>();
        let counting: f64 = members.iter().zip(factors).map(|(weight, factor)| weight * factor).sum();
        let distance = squared(&self.mean(&kept), &centre).sqrt() / size;
        let is_told =
            shapes >= FEWEST && share >= LEAST && counting >= KEPT * weight && distance >= LEAST_DISTANCE;
        let stands_apart = || self.between(&centre, &self.mean(&members)) <= BETWEEN * weight;
        (is_told && stands_apart()).then_some(Minority { shapes, share, distance })
    }
}

#[cfg(test)]
mod tests {
    use rand::rngs::ChaCha12Rng;
    use rand::{RngExt, SeedableRng};
    use rand_distr::StandardNormal;

    use super::*;

    /// Normal scores with falling deviations, and a group of `wrong` shapes at `away` from them with a fifth of the deviations.
    fn scores(right: usize, wrong: usize, away: f64, seed: u64) -> Vec<f64> {
        let mut random = ChaCha12Rng::seed_from_u64(seed);
        let mut shape = |scale: f64, shift: f64| -> Vec<f64> {
            let draw = |i: usize| scale * random.sample::<f64, _>(StandardNormal) / (1.0 + i as f64);
            let mut shape: Vec<f64> = (0..6).map(draw).collect();
            (shape[1], shape[3]) = (shape[1] + shift, shape[3] + shift);
            shape
        };
        let right: Vec<Vec<f64>> = (0..right).map(|_| shape(0.05, 0.0)).collect();
        let wrong: Vec<Vec<f64>> = (0..wrong).map(|_| shape(0.01, away)).collect();
        [right, wrong].concat().concat()
    }

    fn found(scores: &[f64], factors: &[f64]) -> Option<Minority> {
        let weights = vec![1.0; factors.len()];
        Scores { scores, q: 6, weights: &weights }.minority(factors, 1.0)
    }

    #[test]
    fn a_compact_minority_that_counts_is_told() {
        for (seed, (right, wrong)) in [(35, 15), (140, 60), (70, 10)].into_iter().enumerate() {
            let all = scores(right, wrong, 0.2, seed as u64);
            let told = found(&all, &vec![1.0; right + wrong]).unwrap();
            assert!(told.shapes.abs_diff(wrong) <= 1, "{told:?} for {wrong}");
            let moved = wrong as f64 / (right + wrong) as f64 * 0.2 * 2.0_f64.sqrt();
            assert!((told.distance - moved).abs() < 0.3 * moved, "{told:?} for {moved}");
            // Shapes left out are not told.
            let without: Vec<f64> = (0..right + wrong).map(|k| if k < right { 1.0 } else { 0.0 }).collect();
            assert_eq!(found(&all, &without), None);
        }
    }

    #[test]
    fn sets_of_one_kind_have_none() {
        for seed in 0..20 {
            for count in [20, 60, 300] {
                assert_eq!(
                    found(&scores(count, 0, 0.0, seed), &vec![1.0; count]),
                    None,
                    "{count}, seed {seed}"
                );
            }
        }
        assert_eq!(found(&[0.5; 60], &[1.0; 10]), None, "equal shapes");
    }

    #[test]
    fn the_order_does_not_matter() {
        let all = scores(80, 30, 0.2, 9);
        let backwards: Vec<f64> = all.chunks_exact(6).rev().flatten().copied().collect();
        let (one, other) = (found(&all, &[1.0; 110]).unwrap(), found(&backwards, &[1.0; 110]).unwrap());
        assert_eq!(one.shapes, other.shapes);
        assert!((one.distance - other.distance).abs() < 1e-12);
    }
}
