//! Groups of wrong shapes that agree with each other.
//!
//! ```text
//! y_k           scores of the shapes in their three leading components, with covariance I
//! two groups    each with its own mean m, covariance C (shrunk towards that within both) and share p; shape k is in the one with the
//!               larger s_k = ln p − ½ ln |C| − ½ (y_k − m)ᵀ C⁻¹ (y_k − m)
//! gain          mean of s_k, less that of a single group, −½ tr I
//! separation    distance of the two means in the covariance within
//! ```
//!
//! Shapes of another organ lie close together, but in a set that varies widely they are not farther from its mean than its own
//! shapes. No distance from the majority tells them; that they keep to themselves does. A group is left out if the gain is
//! at least [`GAIN`] plus [`GAIN_OF_FEW`] for each shape, its separation [`SEPARATION`], and a third of all shapes are wrong at most.
//!
//! The search begins at the directions of extreme kurtosis: the eigenvectors of `Σ |y_k|² y_k y_kᵀ`, among which is the direction between
//! two normal groups, whatever it is (unless their shares are 0.21 and 0.79, where the kurtosis is that of the normal
//! distribution). Each is cut where two groups explain it best, turned to the discriminant of these, cut again, and the
//! two groups alternate with their memberships until these stay the same. Nothing is drawn at random, and nothing depends on the order
//! of the shapes.
//!
//! Sources: Tyler, Critchley, Dümbgen and Oja 2009 (two scatter matrices find Fisher's discriminant); Peña and Prieto 2001 (directions of
//! extreme kurtosis); Celeux and Govaert 1992 (classification likelihood).

use shapelex_numeric::dense::{Matrix, symmetric_eigen};

use super::moments::{Moments, square};
use super::rejection::order;

/// Largest part of the weight in groups of wrong shapes, and in mirror images.
pub(super) const MOST_WRONG: f64 = 1.0 / 3.0 + 1e-9;

/// Number of leading components in which groups are searched. Of more, small groups that any set has gain as much as wrong ones.
const DIRECTIONS: usize = 3;

/// Least share of a group in the weight; smaller ones are left to the distances.
const LEAST: f64 = 0.08;

/// Maximum number of groups.
const GROUPS: usize = 3;

/// Fewest distinct shapes among which groups are searched.
const FEWEST: f64 = 30.0;

/// Least gain: thirteen real sets without wrong shapes had 0.57 at most, but for two in which a group began elsewhere; 30 % of
/// another organ 0.89 and more.
const GAIN: f64 = 0.6;

/// Addition to the least gain, divided by the number of shapes: two groups describe normal scores of few shapes better than
/// one.
const GAIN_OF_FEW: f64 = 20.0;

/// Least separation. A core and its tails are two groups as well, but about the same mean.
const SEPARATION: f64 = 3.0;

/// Cuts along a direction, each turning it to the discriminant of the two sides.
const TURNS: usize = 3;

/// Maximum number of alternations, which mostly end after a few.
const STEPS: usize = 30;

/// Least variance of whitened scores within a group: copies of one shape are a group without extent.
const LEAST_VARIANCE: f64 = 1e-6;

/// Zero for the shapes in groups of wrong ones, one for the others. `scores`: `components` numbers of each shape; `distinct`: number of
/// distinct shapes of the same weight that the weights are worth.
pub(super) fn outside_groups(scores: &[f64], components: usize, weights: &[f64], distinct: f64) -> Vec<f64> {
    let mut kept = vec![1.0; weights.len()];
    let total: f64 = weights.iter().sum();
    for _ in 0..GROUPS {
        let standing: Vec<f64> = weights.iter().zip(&kept).map(|(weight, kept)| weight * kept).collect();
        let part = standing.iter().sum::<f64>() / total;
        let (count, most) = (distinct * part, 1.0 - (1.0 - MOST_WRONG) / part);
        if count < FEWEST || most < LEAST {
            break;
        }
        let Some(points) = Points::new(scores, components, &standing, count) else { break };
        let Some(group) = points.best(most) else { break };
        if group.gain < GAIN + GAIN_OF_FEW / count || group.separation < SEPARATION {
            break;
        }
        kept.iter_mut().zip(&group.members).filter(|(_, member)| **member).for_each(|(kept, _)| *kept = 0.0);
    }
    kept
}

/// Whitened scores, with weights that sum to the number of shapes they are worth; shapes of weight zero belong to no group.
struct Points {
    y: Vec<f64>,
    q: usize,
    weights: Vec<f64>,
    count: f64,
}

/// A division into two groups.
struct Group {
    members: Vec<bool>,
    gain: f64,
    separation: f64,
}

impl Points {
    /// `None` if the scores do not vary.
    fn new(scores: &[f64], components: usize, weights: &[f64], count: f64) -> Option<Self> {
        let scale = count / weights.iter().sum::<f64>();
        let weights: Vec<f64> = weights.iter().map(|weight| weight * scale).collect();
        let all = Moments::of(scores, components, &weights);
        let eigen = symmetric_eigen(&all.covariance);
        let mut descending: Vec<usize> = (0..components).collect();
        descending.sort_by(|&i, &j| eigen.eigenvalues[j].total_cmp(&eigen.eigenvalues[i]));
        let largest = descending.first().map_or(0.0, |&i| eigen.eigenvalues[i]);
        let varies = |&&i: &&usize| eigen.eigenvalues[i] > 1e-10 * largest;
        let leading: Vec<usize> = descending.iter().take(DIRECTIONS).filter(varies).copied().collect();
        if leading.is_empty() || largest <= f64::MIN_POSITIVE {
            return None;
        }
        let whitened = |t: &[f64], i: usize| -> f64 {
            let away = t.iter().zip(&all.mean).map(|(t, mean)| t - mean);
            let product: f64 = away.zip(eigen.eigenvectors.column(i).iter()).map(|(a, v)| a * v).sum();
            product / eigen.eigenvalues[i].sqrt()
        };
        let rows = scores.chunks_exact(components);
        let y =
            rows.flat_map(|t| leading.iter().map(move |&i| (t, i))).map(|(t, i)| whitened(t, i)).collect();
        Some(Self { y, q: leading.len(), weights, count })
    }

    fn rows(&self) -> impl Iterator<Item = (&[f64], f64)> {
        self.y.chunks_exact(self.q).zip(self.weights.iter().copied())
    }

    /// The division of the largest gain of those that the directions of extreme kurtosis lead to, the smaller group with a share
    /// of at most `most`.
    fn best(&self, most: f64) -> Option<Group> {
        let mut fourth = Matrix::zeros(self.q, self.q);
        for (y, weight) in self.rows() {
            let length: f64 = y.iter().map(|y| y * y).sum();
            for j in 0..self.q {
                (0..self.q).for_each(|i| fourth[(i, j)] += weight * length * y[i] * y[j]);
            }
        }
        let directions = symmetric_eigen(&fourth).eigenvectors;
        let found = directions.column_iter().filter_map(|direction| {
            let sides = self.sides(direction.iter().copied().collect(), most)?;
            self.settle(sides).filter(|group| self.fits(&group.members, most))
        });
        found.fold(None, |best: Option<Group>, group| match best {
            Some(best) if best.gain >= group.gain => Some(best),
            _ => Some(group),
        })
    }

    /// Whether the share of the members is within the limits.
    fn fits(&self, members: &[bool], most: f64) -> bool {
        let inside: f64 = self.weights.iter().zip(members).filter(|(_, m)| **m).map(|(w, _)| w).sum();
        (LEAST..=most).contains(&(inside / self.count))
    }

    /// The smaller side of the best cut across a direction, which turns with it.
    fn sides(&self, mut direction: Vec<f64>, most: f64) -> Option<Vec<bool>> {
        let mut members = None;
        for _ in 0..TURNS {
            let along: Vec<f64> =
                self.rows().map(|(y, _)| y.iter().zip(&direction).map(|(y, v)| y * v).sum()).collect();
            let cut = self.cut(&along, most)?;
            let [rest, group] = self.both(&cut);
            let root = rest.within(&group, LEAST_VARIANCE).cholesky()?;
            direction = root.solve(&rest.towards(&group)).as_slice().to_vec();
            members = Some(cut);
        }
        members
    }

    /// The smaller side of the cut of `along` that two groups of equal variance explain best; both sides are larger than [`LEAST`].
    fn cut(&self, along: &[f64], most: f64) -> Option<Vec<bool>> {
        let order: Vec<usize> = order(along).into_iter().filter(|&k| self.weights[k] > 0.0).collect();
        let sums =
            |k: usize| (self.weights[k], self.weights[k] * along[k], self.weights[k] * along[k].powi(2));
        let add = |a: (f64, f64, f64), b: (f64, f64, f64)| (a.0 + b.0, a.1 + b.1, a.2 + b.2);
        let all = order.iter().map(|&k| sums(k)).fold((0.0, 0.0, 0.0), add);
        let scatter = |s: (f64, f64, f64)| (s.2 - s.1 * s.1 / s.0).max(0.0);
        let mut below = (0.0, 0.0, 0.0);
        let mut best: Option<(f64, f64, bool)> = None;
        for pair in order.windows(2) {
            below = add(below, sums(pair[0]));
            let part = below.0 / all.0;
            // Equal shapes are on one side.
            if along[pair[0]] >= along[pair[1]] || !(LEAST..=most).contains(&part.min(1.0 - part)) {
                continue;
            }
            let above = (all.0 - below.0, all.1 - below.1, all.2 - below.2);
            let within = (scatter(below) + scatter(above)).max(LEAST_VARIANCE * all.2);
            let gain = part * part.ln() + (1.0 - part) * (1.0 - part).ln() - 0.5 * within.ln();
            if best.is_none_or(|(most, ..)| gain > most) {
                best = Some((gain, along[pair[0]], part < 0.5));
            }
        }
        let (_, limit, lower) = best?;
        let member = |(value, weight): (&f64, &f64)| *weight > 0.0 && (*value <= limit) == lower;
        Some(along.iter().zip(&self.weights).map(member).collect())
    }

    /// Moments of the others and of the members.
    fn both(&self, members: &[bool]) -> [Moments; 2] {
        [false, true].map(|side| {
            let own = self.weights.iter().zip(members);
            let own: Vec<f64> = own.map(|(w, m)| if *m == side { *w } else { 0.0 }).collect();
            Moments::of(&self.y, self.q, &own)
        })
    }

    /// Alternates the two groups with their memberships. `None` once one of them has too few shapes for a covariance.
    fn settle(&self, mut members: Vec<bool>) -> Option<Group> {
        let q = self.q as f64;
        let (mut gain, mut separation) = (0.0, 0.0);
        for _ in 0..STEPS {
            let both = self.both(&members);
            if both.iter().any(|group| group.weight <= q + 2.0) {
                return None;
            }
            let [rest, group] = &both;
            let (within, towards) = (rest.within(group, LEAST_VARIANCE), rest.towards(group));
            separation = within.clone().cholesky()?.solve(&towards).dot(&towards).sqrt();
            let mut densities = Vec::with_capacity(2);
            for own in &both {
                let covariance = (&own.covariance * own.weight + &within * q) / (own.weight + q);
                let root = covariance.cholesky()?.unpack();
                let volume: f64 = (0..self.q).map(|i| root[(i, i)].ln()).sum();
                densities.push(((own.weight / self.count).ln() - volume, &own.mean, root));
            }
            let mut away = vec![0.0; self.q];
            let mut of = |i: usize, y: &[f64]| {
                let (constant, mean, root) = &densities[i];
                constant - 0.5 * square(root, mean, y, &mut away)
            };
            gain = 0.5 * q;
            let mut next = Vec::with_capacity(members.len());
            for (y, weight) in self.rows() {
                let (outside, inside) = (of(0, y), of(1, y));
                gain += weight / self.count * outside.max(inside);
                next.push(weight > 0.0 && inside > outside);
            }
            if next == members {
                break;
            }
            members = next;
        }
        Some(Group { members, gain, separation })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Deterministic pseudo-random numbers, nearly normal with deviation one.
    struct Random(u64);

    impl Random {
        fn even(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        }

        fn normal(&mut self) -> f64 {
            (0..12).map(|_| self.even()).sum::<f64>() - 6.0
        }
    }

    /// A wide set, and a tight group at 1.8 deviations from its mean in each of three scores: four scores each.
    fn wide_and_tight(wide: usize, tight: usize, seed: u64) -> Vec<f64> {
        let mut random = Random(seed);
        let mut of = |deviation: f64, shift: f64| -> Vec<f64> {
            let score =
                |i: usize| (deviation * random.normal() + if i < 3 { shift } else { 0.0 }) / (1.0 + i as f64);
            (0..4).map(score).collect()
        };
        let right: Vec<Vec<f64>> = (0..wide).map(|_| of(1.0, 0.0)).collect();
        let wrong: Vec<Vec<f64>> = (0..tight).map(|_| of(0.15, 1.8)).collect();
        [right, wrong].concat().concat()
    }

    fn found(scores: &[f64], weights: &[f64]) -> Vec<f64> {
        outside_groups(scores, 4, weights, weights.iter().sum())
    }

    #[test]
    fn a_tight_group_within_a_wide_set_is_found() {
        for seed in 1..6 {
            let kept = found(&wide_and_tight(140, 60, seed), &[1.0; 200]);
            let right: f64 = kept[..140].iter().sum();
            let wrong: f64 = kept[140..].iter().sum();
            assert!(
                right >= 130.0 && wrong <= 2.0,
                "seed {seed}: {right} of 140 right, {wrong} of 60 wrong kept"
            );
        }
    }

    #[test]
    fn sets_without_a_group_are_kept_whole() {
        for seed in 1..6 {
            let mut random = Random(seed);
            for count in [30, 60, 300] {
                let normal: Vec<f64> = (0..4 * count).map(|_| random.normal()).collect();
                let flat: Vec<f64> = (0..4 * count).map(|_| random.even()).collect();
                let skewed: Vec<f64> = (0..4 * count).map(|_| -random.even().max(1e-9).ln()).collect();
                // Normal with a separate deviation for each shape: long tails about one centre.
                let tails = (0..count).flat_map(|_| {
                    let deviation = random.even().max(0.1).recip();
                    (0..4).map(|_| deviation * random.normal()).collect::<Vec<f64>>()
                });
                for (name, scores) in
                    [("tails", tails.collect()), ("normal", normal), ("even", flat), ("skewed", skewed)]
                {
                    let kept: f64 = found(&scores, &vec![1.0; count]).iter().sum();
                    assert_eq!(kept, count as f64, "{name}, {count} shapes, seed {seed}");
                }
            }
        }
    }

    #[test]
    fn neither_order_nor_copies_matter() {
        let scores = wide_and_tight(100, 40, 7);
        let kept = found(&scores, &[1.0; 140]);
        let backwards: Vec<f64> = scores.chunks_exact(4).rev().flatten().copied().collect();
        let reversed: Vec<f64> = found(&backwards, &[1.0; 140]).into_iter().rev().collect();
        assert_eq!(reversed, kept);
        let copied = [scores.clone(), scores[12..16].to_vec()].concat();
        let copied = outside_groups(&copied, 4, &[1.0; 141], 140.5);
        let mut weights = [1.0; 140];
        weights[3] = 2.0;
        assert_eq!(copied[..140], outside_groups(&scores, 4, &weights, 140.5));
        assert_eq!(copied[140], copied[3]);
    }

    #[test]
    fn few_or_equal_shapes_are_no_group() {
        let few = wide_and_tight(20, 8, 10);
        assert_eq!(found(&few, &[1.0; 28]), vec![1.0; 28]);
        assert_eq!(found(&[0.25; 160], &[1.0; 40]), vec![1.0; 40]);
    }
}
