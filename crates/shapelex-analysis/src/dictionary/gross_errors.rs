//! Gross errors among held-out shapes: they are found together and left out of the limit of outliers, which they would hide each
//! other behind.
//!
//! ```text
//! 1. start       the densest 65 % of the scores, by concentration steps from their medians
//! 2. measures    m_k = max(z(ln D_k²), z(ln Q_k)),   D² Mahalanobis distance from the shapes that are left,   z standardised
//! 3. gap         in ascending order, the normalised spacings (n − i)(m₍ᵢ₊₁₎ − m₍ᵢ₎) of an exponential tail are equally distributed:
//!                k of them with the sum S are followed by one beyond g with probability (1 + g/S)^−k
//! 4. cut         above the least likely gap of the upper fifth, if one of so many is that wide once in 100 sets; then 2 once more
//! 5. groups      cut shapes that are nearer to their own median than to the others are a group of shapes and not an error: they stay
//! ```
//!
//! Components follow gross errors: with a tenth of them, the variances of the scores are theirs, and their `T²` is like that of the
//! others. `D²` is measured in the variances of the shapes that are left, each without itself. Tails of measures are exponential in
//! their logarithms at most ([`novelty`](super::novelty)), so that a gap is wide only where shapes of another kind begin: of 3000
//! sets of 400 normal values, 0.1 % lost some.
//!
//! Nothing is drawn at random, and the order of the shapes does not matter.
//!
//! Sources: Rényi 1953 (normalised spacings); Rousseeuw and Van Driessen 1999 (concentration steps); Cook and Weisberg 1982 (leaving
//! one out of a Mahalanobis distance).

use super::model::{Spread, squared_distance};
use super::novelty::Logarithms;
use crate::metric::norm;
use shapelex_numeric::dense::Matrix;

/// Part of the held-out shapes in which gross errors are looked for: twice the promised part, since a sample of 400 may have a few
/// percent more than the cohort.
const MOST: f64 = 0.2;

/// Part of the values below the first gap: those above it tell how wide gaps are.
const BELOW: f64 = 0.6;

/// Probability that a set without gross errors loses some.
const LEVEL: f64 = 0.01;

/// Minimum number of different spacings that a gap is compared with.
const FEWEST_SPACINGS: usize = 2;

/// Part of the shapes with which the search begins.
const MAJORITY: f64 = 0.65;

/// Maximum number of concentration steps, and of rounds of measures and cuts, which end sooner.
const STEPS: usize = 30;
const ROUNDS: usize = 10;

/// Shapes of a group of this many, and of this part of the cut shapes, are not errors.
const LEAST_GROUP: usize = 5;
const PART_OF_CUT: f64 = 0.5;

/// A shape belongs to a group if its distance from the median of the group is below this part of its distance from the others.
const NEAR: f64 = 0.5;

/// Standard deviation of a normal distribution divided by its median absolute deviation.
const NORMAL_DEVIATION: f64 = 1.482_602_218_505_602;

/// Held-out shapes, their scores and their residuals, one after the other in any order.
pub(super) struct Held<'a> {
    /// Prepared shapes, as many numbers each.
    pub(super) posed: &'a [f64],
    /// Scores in the components of all shapes; empty for sparse atoms.
    pub(super) scores: &'a [Vec<f64>],
    /// `Q` of each shape without itself.
    pub(super) residuals: &'a [f64],
}

/// The held-out shapes without gross errors.
pub(super) struct Typical {
    /// Whether each shape is typical.
    pub(super) kept: Vec<bool>,
    /// `D²` of each shape, of a typical one without itself, and mean and covariance of the scores; `None` for sparse atoms.
    pub(super) distances: Option<(Vec<f64>, Spread)>,
}

impl Typical {
    /// `None` if there are no gross errors, or too few shapes to tell.
    pub(super) fn of(held: &Held<'_>) -> Option<Self> {
        let count = held.residuals.len();
        let components = held.scores.first().map_or(0, Vec::len);
        let mut protected = vec![false; count];
        loop {
            let found = held.search(components, &protected)?;
            let group = held.group(&found.kept);
            if group.is_empty() {
                return Some(found);
            }
            group.iter().for_each(|&k| protected[k] = true);
        }
    }
}

impl Held<'_> {
    /// Alternates measures and cuts. Protected shapes are never cut.
    fn search(&self, components: usize, protected: &[bool]) -> Option<Typical> {
        let count = self.residuals.len();
        let residuals: Vec<f64> = self.residuals.iter().map(|q| q.max(f64::MIN_POSITIVE).ln()).collect();
        let mut typical = Typical { kept: vec![true; count], distances: None };
        let mut logarithms = self.start(components).map(|distances| logarithms_of(&distances));
        let mut standardised = [standardised_by_median(&residuals)].to_vec();
        standardised.extend(logarithms.as_deref().map(standardised_by_median));
        for _ in 0..ROUNDS {
            let measures = (0..count).map(|k| standardised.iter().map(|z| z[k]).fold(f64::MIN, f64::max));
            let kept = cut(&measures.collect::<Vec<f64>>(), protected);
            let is_settled = kept == typical.kept;
            typical.kept = kept;
            typical.distances = self.distances(components, &typical.kept);
            if is_settled {
                break;
            }
            logarithms = typical.distances.as_ref().map(|(distances, _)| logarithms_of(distances));
            standardised = [standardised_by(&residuals, &typical.kept)].to_vec();
            standardised.extend(logarithms.as_deref().map(|values| standardised_by(values, &typical.kept)));
        }
        typical.kept.contains(&false).then_some(typical)
    }

    /// Squared distances of the scores from their densest majority; `None` for sparse atoms, and for too few shapes.
    fn start(&self, components: usize) -> Option<Vec<f64>> {
        let size = (MAJORITY * self.scores.len() as f64).ceil() as usize;
        if components == 0 || size < 2 * components + 2 {
            return self.by_medians(components);
        }
        let nearest = |distances: &[f64]| {
            let mut order: Vec<usize> = (0..distances.len()).collect();
            order.sort_by(|&i, &j| distances[i].total_cmp(&distances[j]));
            let limit = distances[order[size - 1]];
            distances.iter().map(|distance| *distance <= limit).collect::<Vec<bool>>()
        };
        let mut chosen = nearest(&self.by_medians(components)?);
        for _ in 0..STEPS {
            let next = nearest(&self.distances_from(&self.spread(&chosen)));
            if next == chosen {
                break;
            }
            chosen = next;
        }
        Some(self.distances_from(&self.spread(&chosen)))
    }

    /// `Σ_i ((s_i − median)/median deviation)²` of each shape.
    fn by_medians(&self, components: usize) -> Option<Vec<f64>> {
        let mut distances = vec![0.0; self.scores.len()];
        for i in 0..components {
            let scores: Vec<f64> = self.scores.iter().map(|scores| scores[i]).collect();
            let standard = standardised_by_median(&scores);
            distances.iter_mut().zip(standard).for_each(|(sum, z)| *sum += z * z);
        }
        (components > 0).then_some(distances)
    }

    /// Mean and covariance of the scores of the shapes that are `kept`.
    fn spread(&self, kept: &[bool]) -> Spread {
        let chosen: Vec<&[f64]> = members(self.scores, kept).map(Vec::as_slice).collect();
        let (n, q) = (chosen.len() as f64, chosen.first().map_or(0, |scores| scores.len()));
        let mean: Vec<f64> = (0..q).map(|i| chosen.iter().map(|s| s[i]).sum::<f64>() / n).collect();
        let mut covariance = Matrix::zeros(q, q);
        for scores in chosen {
            let away: Vec<f64> = scores.iter().zip(&mean).map(|(score, mean)| score - mean).collect();
            for j in 0..q {
                (0..q).for_each(|i| covariance[(i, j)] += away[i] * away[j] / (n - 1.0).max(1.0));
            }
        }
        Spread::new(mean, covariance)
    }

    fn distances_from(&self, spread: &Spread) -> Vec<f64> {
        self.scores.iter().map(|scores| spread.distance(scores)).collect()
    }

    /// `D²` of all shapes in mean and covariance of those that are `kept`, of these each without itself:
    ///
    /// ```text
    /// D₋ₖ² = (m/(m − 1))² (m − 2)/(m − 1) D²/(1 − m D²/(m − 1)²)      of m shapes
    /// ```
    fn distances(&self, components: usize, kept: &[bool]) -> Option<(Vec<f64>, Spread)> {
        let m = kept.iter().filter(|kept| **kept).count() as f64;
        if components == 0 || m < components as f64 + 3.0 {
            return None;
        }
        let spread = self.spread(kept);
        let mut distances = self.distances_from(&spread);
        for (distance, _) in distances.iter_mut().zip(kept).filter(|(_, kept)| **kept) {
            let left = (1.0 - m * *distance / (m - 1.0).powi(2)).max(f64::EPSILON);
            *distance *= (m / (m - 1.0)).powi(2) * (m - 2.0) / (m - 1.0) / left;
        }
        Some((distances, spread))
    }

    /// The shapes that were cut and are a group; empty if there is none.
    fn group(&self, kept: &[bool]) -> Vec<usize> {
        let cut: Vec<usize> = (0..kept.len()).filter(|&k| !kept[k]).collect();
        if cut.len() < LEAST_GROUP {
            return Vec::new();
        }
        let length = self.posed.len() / kept.len();
        let shape = |k: usize| &self.posed[k * length..(k + 1) * length];
        let typical = members(&self.posed.chunks_exact(length).collect::<Vec<_>>(), kept)
            .fold(vec![0.0; length], |sum, y| sum.iter().zip(*y).map(|(s, y)| s + y).collect());
        let left = (kept.len() - cut.len()) as f64;
        let centre: Vec<f64> = typical.iter().map(|sum| sum / left).collect();
        let middle: Vec<f64> =
            (0..length).map(|i| median(cut.iter().map(|&k| shape(k)[i]).collect())).collect();
        let is_near = |k: &usize| {
            let (own, others) = (squared_distance(shape(*k), &middle), squared_distance(shape(*k), &centre));
            own < NEAR * NEAR * others && others > f64::EPSILON * norm(&centre)
        };
        let group: Vec<usize> = cut.iter().copied().filter(is_near).collect();
        let is_group = group.len() >= LEAST_GROUP && group.len() as f64 >= PART_OF_CUT * cut.len() as f64;
        if is_group { group } else { Vec::new() }
    }
}

fn members<'a, T>(values: &'a [T], kept: &'a [bool]) -> impl Iterator<Item = &'a T> {
    values.iter().zip(kept).filter(|(_, kept)| **kept).map(|(value, _)| value)
}

fn logarithms_of(values: &[f64]) -> Vec<f64> {
    values.iter().map(|value| value.max(f64::MIN_POSITIVE).ln()).collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// `(x − median)/deviation`, with the deviation of a normal distribution of this median absolute deviation.
fn standardised_by_median(values: &[f64]) -> Vec<f64> {
    let centre = median(values.to_vec());
    let away = median(values.iter().map(|value| (value - centre).abs()).collect());
    let logarithms = Logarithms::new(centre, NORMAL_DEVIATION * away);
    values.iter().map(|value| logarithms.standard(*value)).collect()
}

/// `(x − mean)/deviation` of the values that are kept.
fn standardised_by(values: &[f64], kept: &[bool]) -> Vec<f64> {
    let own: Vec<f64> = members(values, kept).copied().collect();
    let logarithms = Logarithms::of_logarithms(&own);
    values.iter().map(|value| logarithms.standard(*value)).collect()
}

/// Which values are below the wide gaps, or protected.
fn cut(measures: &[f64], protected: &[bool]) -> Vec<bool> {
    let mut ascending: Vec<f64> = measures.to_vec();
    ascending.sort_by(f64::total_cmp);
    let left = typical_count(&ascending);
    let limit = ascending.get(left).copied().unwrap_or(f64::INFINITY);
    measures.iter().zip(protected).map(|(measure, protected)| *protected || *measure < limit).collect()
}

/// Number of ascending values below the first of the wide gaps: the widest one is cut above, and the rest looked at again.
fn typical_count(ascending: &[f64]) -> usize {
    let fewest = ascending.len() - (MOST * ascending.len() as f64) as usize;
    let mut count = ascending.len();
    while count > fewest {
        let unlikely = (((count - fewest) as f64) / LEVEL).ln();
        let widest = widest_gap(&ascending[..count], fewest).filter(|(score, _)| *score > unlikely);
        let Some((_, at)) = widest else { break };
        count = at;
    }
    count
}

/// `−ln p` of the least likely gap that begins at `first` values or more, and the number of values below it. Equal values make no
/// spacings: copies of shapes tell nothing about the width of gaps.
fn widest_gap(ascending: &[f64], first: usize) -> Option<(f64, usize)> {
    let count = ascending.len();
    let spacing = |i: usize| (count - i) as f64 * (ascending[i] - ascending[i - 1]);
    let (mut spacings, mut sum, mut widest) = (0, 0.0, None);
    for i in ((BELOW * count as f64) as usize + 1)..count {
        let gap = spacing(i);
        if i >= first && spacings >= FEWEST_SPACINGS {
            let score = spacings as f64 * (gap / sum).ln_1p();
            if widest.is_none_or(|(most, _)| score > most) {
                widest = Some((score, i));
            }
        }
        if gap > 0.0 {
            (spacings, sum) = (spacings + 1, sum + gap);
        }
    }
    widest
}
