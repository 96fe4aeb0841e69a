//! Differences between groups of aligned shapes.
//!
//! ```text
//! Δ = ȳ_1 − ȳ_0,   c = W_0 W_1 / (W_0 + W_1),   T = Σ_k w_k (y_k − ȳ)(y_k − ȳ)ᵀ
//! distance ‖Δ‖      R² = c ‖Δ‖²/tr T      F = (n − 2) R²/(1 − R²)      T² = (n − 2) v/(1 − v),  v = c Δᵀ T⁺ Δ
//! ```
//!
//! Relabelling does not change `T`, so every statistic of a relabelling is computed from the weighted sums of one group: a
//! column of one matrix product. `R²` and `v` lie between 0 and 1 and grow with `F` and `T²`, so they are compared instead.
//! Hotelling's statistic is computed from the leading principal coordinates (there are fewer shapes than coordinates), and
//! at every point along the shape, where the maximum over all points corrects for their number.
//!
//! Sources: Anderson 2001 (F, which is that of squared distances); Hotelling 1931; the maximum over points: Nichols and
//! Holmes 2002.

use std::borrow::Cow;

use super::super::AnalysisError;
use super::histogram::ExplainedHistogram;
use super::permutation::{Relabellings, Tally};
use super::reaches;
use super::span::{Span, centre_rows};
use crate::watch::Watch;
use shapelex_numeric::dense::{self, Matrix};
use shapelex_numeric::parallel;

/// Number of columns per product: enough for the kernel, few enough for the cache.
const COLUMNS: usize = 64;

/// Fraction of the variance in the leading principal coordinates of Hotelling's statistic …
const LEADING_VARIANCE: f64 = 0.95;

/// … whose number is at most the number of shapes over this, so that the scatter within groups is well determined.
const LEADING_PART: usize = 4;

/// Relative variance of a point in a direction, as a fraction of the largest of all points, below which it is rounding.
const POINT_RANK: f64 = 1e-10;

/// Value of `1 − v` below which the groups differ without any scatter within them.
const NO_SCATTER: f64 = 1e-12;

/// Data of a comparison; every matrix has one column per shape.
#[derive(Debug, Clone)]
pub struct Sample {
    /// Aligned shapes, in coordinates in which the metric is Euclidean.
    pub coordinates: Matrix,
    /// Aligned shapes at points along them, coordinate-major: `d·S` rows.
    pub points: Matrix,
    /// Dimension of the points, `d`.
    pub dimension: usize,
    /// Sizes before alignment, one measure per row.
    pub sizes: Matrix,
    /// Positive weights.
    pub weights: Vec<f64>,
}

/// A statistic with the tally of its permutation test.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tested {
    /// Value of the statistic; `None` if it is infinite.
    pub value: Option<f64>,
    /// Tally of the relabellings that reach it.
    pub tally: Tally,
}

/// The effect at points along the shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Effect {
    /// `Δ`, coordinate-major, `d·S` numbers.
    pub difference: Vec<f64>,
    /// `T²` of every point; `None` if it is infinite.
    pub t_squared: Vec<Option<f64>>,
    /// For every point, the tally of the relabellings whose largest `T²` reaches that of the point.
    pub tallies: Vec<Tally>,
}

/// Comparison of two groups; differences are the second minus the first.
#[derive(Debug, Clone, PartialEq)]
pub struct PairTests {
    /// Distance of the means, `‖Δ‖`.
    pub distance: Tested,
    /// Pseudo-F, `F`.
    pub pseudo_f: Tested,
    /// `R²`: the fraction of the squared distances that the groups explain.
    pub r_squared: f64,
    /// `T²` of the leading principal coordinates.
    pub hotelling: Tested,
    /// Number of these coordinates.
    pub components: usize,
    /// The effect along the shape.
    pub effect: Effect,
    /// Difference of the means of every size; the test ignores its sign.
    pub sizes: Vec<Tested>,
    /// `R²` of the relabellings; `None` without relabellings.
    pub histogram: Option<ExplainedHistogram>,
}

/// Comparison of all groups at once.
#[derive(Debug, Clone, PartialEq)]
pub struct OverallTest {
    /// Pseudo-F, `F = ((n − G) Σ_g W_g ‖ȳ_g − ȳ‖²)/((G − 1) Σ_g Σ_{k∈g} w_k ‖y_k − ȳ_g‖²)`.
    pub pseudo_f: Tested,
    /// The fraction of the squared distances that the groups explain.
    pub r_squared: f64,
    /// `R²` of the relabellings; `None` without relabellings.
    pub histogram: Option<ExplainedHistogram>,
}

/// Results of relabellings.
#[derive(Debug, Clone, PartialEq)]
struct Reached {
    /// For every statistic, the number of relabellings that reach the observed one.
    counts: Vec<usize>,
    /// `R²` of every relabelling.
    explained: Vec<f64>,
}

impl Reached {
    fn histogram(&self, observed: f64, relabellings: &Relabellings) -> Option<ExplainedHistogram> {
        ExplainedHistogram::new(&self.explained, observed, relabellings.hold_observed())
    }
}

impl Sample {
    /// The shapes at `members`, in that order.
    pub fn select(&self, members: &[usize]) -> Cow<'_, Self> {
        if members.iter().copied().eq(0..self.weights.len()) {
            return Cow::Borrowed(self);
        }
        Cow::Owned(Self {
            coordinates: self.coordinates.select_columns(members),
            points: self.points.select_columns(members),
            dimension: self.dimension,
            sizes: self.sizes.select_columns(members),
            weights: members.iter().map(|&k| self.weights[k]).collect(),
        })
    }

    /// Compares the two groups of `relabellings`, which cover all shapes of the sample. `watch` is asked before every
    /// product, and counts the relabellings.
    ///
    /// Cost: `n (m + d·S)` multiply-adds per relabelling, for `m` coordinates and `S` points, and a singular value
    /// decomposition.
    ///
    /// # Errors
    /// [`AnalysisError::Interrupted`] once `watch` stops; a failure of an eigenproblem.
    pub fn compare_pair(
        &self,
        relabellings: &Relabellings,
        watch: &dyn Watch,
    ) -> Result<PairTests, AnalysisError> {
        let features = PairFeatures::new(self)?;
        let observed = features.evaluate(relabellings.observed());
        let reached = count_reaching(relabellings, COLUMNS, watch, observed.tallied(), |batch| {
            let outcomes = features.evaluate_all(batch);
            let counts = outcomes.iter().fold(vec![0; observed.tallied()], |mut counts, outcome| {
                outcome.count(&observed, &mut counts);
                counts
            });
            Reached { counts, explained: outcomes.iter().map(|outcome| outcome.explained).collect() }
        })?;
        Ok(features.tests(self, &observed, &reached, relabellings))
    }

    /// Compares all groups of `relabellings` at once.
    ///
    /// Cost: `G n m` multiply-adds per relabelling.
    ///
    /// # Errors
    /// As for [`Self::compare_pair`].
    pub fn compare_all(
        &self,
        relabellings: &Relabellings,
        watch: &dyn Watch,
    ) -> Result<OverallTest, AnalysisError> {
        let mut centred = self.coordinates.clone();
        centre_rows(&mut centred, &self.weights);
        let columns = centred.column_iter().zip(&self.weights);
        let total: f64 = columns.map(|(y, w)| w * y.norm_squared()).sum();
        let groups = relabellings.groups();
        let explained = |labels: &[Vec<usize>]| self.explained(&centred, labels, groups, total);
        let observed = explained(&[relabellings.observed().to_vec()])[0];
        let together = (COLUMNS / groups).max(1);
        let reached = count_reaching(relabellings, together, watch, 1, |batch| {
            let explained = explained(batch);
            let count = explained.iter().filter(|&&value| reaches(value, observed)).count();
            Reached { counts: vec![count], explained }
        })?;
        let (n, g) = (self.weights.len() as f64, groups as f64);
        let value = odds(observed).map(|odds| odds * (n - g) / (g - 1.0));
        let pseudo_f = Tested { value, tally: relabellings.tally(reached.counts[0]) };
        let histogram = reached.histogram(observed, relabellings);
        Ok(OverallTest { pseudo_f, r_squared: observed, histogram })
    }

    /// `R²` of every labelling.
    fn explained(&self, centred: &Matrix, labels: &[Vec<usize>], groups: usize, total: f64) -> Vec<f64> {
        let mut indicators = Matrix::zeros(self.weights.len(), labels.len() * groups);
        let mut weights = vec![0.0; labels.len() * groups];
        for (b, labels) in labels.iter().enumerate() {
            for (k, (&group, &weight)) in labels.iter().zip(&self.weights).enumerate() {
                indicators[(k, b * groups + group)] = weight;
                weights[b * groups + group] += weight;
            }
        }
        let sums = dense::multiply(centred, &indicators);
        let between: Vec<f64> =
            sums.column_iter().zip(&weights).map(|(sum, weight)| sum.norm_squared() / weight).collect();
        let part = |between: &[f64]| {
            if total > 0.0 { (between.iter().sum::<f64>() / total).min(1.0) } else { 0.0 }
        };
        between.chunks_exact(groups).map(part).collect()
    }
}

/// `v/(1 − v)`; `None` if `1 − v` is rounding.
fn odds(v: f64) -> Option<f64> {
    (1.0 - v > NO_SCATTER).then(|| v / (1.0 - v))
}

/// Sums the counts of `count` over all relabellings, in parallel batches of at most `together`, and joins the values. The sum of
/// integers does not depend on the order.
fn count_reaching(
    relabellings: &Relabellings,
    together: usize,
    watch: &dyn Watch,
    counts: usize,
    count: impl Fn(&[Vec<usize>]) -> Reached + Sync,
) -> Result<Reached, AnalysisError> {
    let draws = relabellings.draws();
    let batches = parallel::try_map(draws.div_ceil(together), &|batch| {
        watch.check()?;
        let labels = |index| {
            let mut labels = vec![0; relabellings.observed().len()];
            relabellings.relabel(index, &mut labels);
            labels
        };
        let batch: Vec<_> = (batch * together..draws.min((batch + 1) * together)).map(labels).collect();
        let counted = count(&batch);
        watch.worked(batch.len());
        Ok::<_, AnalysisError>(counted)
    })?;
    let mut sum = Reached { counts: vec![0; counts], explained: Vec::new() };
    for part in batches {
        sum.counts.iter_mut().zip(part.counts).for_each(|(sum, part)| *sum += part);
        sum.explained.extend(part.explained);
    }
    Ok(sum)
}

/// Statistics of one labelling.
#[derive(Debug, Clone, PartialEq)]
struct Outcome {
    distance: f64,
    explained: f64,
    leading: f64,
    points: Vec<f64>,
    sizes: Vec<f64>,
}

impl Outcome {
    /// Length of the list of counts: distance, F, T², points, sizes.
    fn tallied(&self) -> usize {
        3 + self.points.len() + self.sizes.len()
    }

    /// Counts the statistics of `observed` that this outcome reaches.
    fn count(&self, observed: &Self, counts: &mut [usize]) {
        let largest = self.points.iter().copied().fold(0.0, f64::max);
        let statistics = [
            (self.distance, observed.distance),
            (self.explained, observed.explained),
            (self.leading, observed.leading),
        ];
        let points = observed.points.iter().map(|&point| (largest, point));
        let sizes = self.sizes.iter().zip(&observed.sizes).map(|(a, b)| (a.abs(), b.abs()));
        for (count, (own, wanted)) in counts.iter_mut().zip(statistics.into_iter().chain(points).chain(sizes))
        {
            *count += usize::from(reaches(own, wanted));
        }
    }
}

/// Rows, each with mean zero, whose weighted sums over a group determine all statistics of two groups.
struct PairFeatures {
    /// Principal coordinates; then points, each in coordinates with unit scatter; then sizes.
    rows: Matrix,
    eigenvalues: Vec<f64>,
    components: usize,
    points: usize,
    dimension: usize,
    sizes: usize,
    weights: Vec<f64>,
}

impl PairFeatures {
    fn new(sample: &Sample) -> Result<Self, AnalysisError> {
        let Span { scores, eigenvalues } = Span::new(&sample.coordinates, &sample.weights)?;
        let points = whitened_points(sample);
        let mut sizes = sample.sizes.clone();
        centre_rows(&mut sizes, &sample.weights);
        let parts = [&scores, &points, &sizes];
        let mut rows = Matrix::zeros(parts.iter().map(|part| part.nrows()).sum(), sample.weights.len());
        let mut first = 0;
        for part in parts {
            rows.rows_mut(first, part.nrows()).copy_from(part);
            first += part.nrows();
        }
        Ok(Self {
            rows,
            components: leading(&eigenvalues, sample.weights.len()),
            eigenvalues,
            points: points.nrows() / sample.dimension,
            dimension: sample.dimension,
            sizes: sizes.nrows(),
            weights: sample.weights.clone(),
        })
    }

    fn evaluate(&self, labels: &[usize]) -> Outcome {
        self.evaluate_all(&[labels.to_vec()]).swap_remove(0)
    }

    fn evaluate_all(&self, batch: &[Vec<usize>]) -> Vec<Outcome> {
        let indicators = Matrix::from_fn(self.weights.len(), batch.len(), |k, b| {
            if batch[b][k] == 1 { self.weights[k] } else { 0.0 }
        });
        let total: f64 = self.weights.iter().sum();
        let sums = dense::multiply(&self.rows, &indicators);
        let columns = sums.column_iter().zip(indicators.column_iter());
        columns
            .map(|(sums, indicator)| {
                let own: f64 = indicator.iter().sum();
                self.outcome(sums.as_slice(), own * (total - own) / total)
            })
            .collect()
    }

    /// Statistics from the sums `c Δ` of all rows. These are the sums over the second group, because every row has mean zero.
    fn outcome(&self, sums: &[f64], c: f64) -> Outcome {
        let (scores, rest) = sums.split_at(self.eigenvalues.len());
        let (points, sizes) = rest.split_at(self.points * self.dimension);
        let squared: f64 = scores.iter().map(|s| s * s).sum();
        let total: f64 = self.eigenvalues.iter().sum();
        let leading = scores.iter().zip(&self.eigenvalues).take(self.components);
        let point =
            |i: usize| (0..self.dimension).map(|a| points[a * self.points + i].powi(2)).sum::<f64>() / c;
        Outcome {
            distance: squared.sqrt() / c,
            explained: if total > 0.0 { (squared / c / total).min(1.0) } else { 0.0 },
            leading: leading.map(|(s, value)| s * s / value).sum::<f64>() / c,
            points: (0..self.points).map(point).collect(),
            sizes: sizes.iter().map(|s| s / c).collect(),
        }
    }

    fn tests(
        &self,
        sample: &Sample,
        observed: &Outcome,
        reached: &Reached,
        relabellings: &Relabellings,
    ) -> PairTests {
        let degrees = self.weights.len() as f64 - 2.0;
        let statistic = |v: f64| odds(v).map(|odds| degrees * odds);
        let reaching = &reached.counts;
        let tested = |value, i: usize| Tested { value, tally: relabellings.tally(reaching[i]) };
        let sizes = 3 + self.points;
        PairTests {
            distance: tested(Some(observed.distance), 0),
            pseudo_f: tested(statistic(observed.explained), 1),
            r_squared: observed.explained,
            hotelling: tested(statistic(observed.leading), 2),
            components: self.components,
            effect: Effect {
                difference: difference(sample, relabellings.observed()),
                t_squared: observed.points.iter().map(|&v| statistic(v)).collect(),
                tallies: (3..sizes).map(|i| relabellings.tally(reaching[i])).collect(),
            },
            sizes: (0..self.sizes).map(|i| tested(Some(observed.sizes[i]), sizes + i)).collect(),
            histogram: reached.histogram(observed.explained, relabellings),
        }
    }
}

/// Number of leading coordinates for Hotelling's statistic.
fn leading(eigenvalues: &[f64], shapes: usize) -> usize {
    let total: f64 = eigenvalues.iter().sum();
    let mut sum = 0.0;
    let below = eigenvalues.iter().take_while(|&&value| {
        let before = sum < LEADING_VARIANCE * total;
        sum += value;
        before
    });
    below.count().min((shapes / LEADING_PART).max(1)).min(eigenvalues.len())
}

/// The points along the shapes, each in coordinates in which its scatter is the identity: `Λ^{−1/2} Uᵀ p` for
/// `Σ w p pᵀ = U Λ Uᵀ`. Directions without variation become zero.
fn whitened_points(sample: &Sample) -> Matrix {
    let mut points = sample.points.clone();
    centre_rows(&mut points, &sample.weights);
    let d = sample.dimension;
    let count = points.nrows() / d;
    let scatters: Vec<_> = (0..count)
        .map(|i| {
            let entry = |a: usize, b: usize| {
                let columns = points.column_iter().zip(&sample.weights);
                columns.map(|(p, w)| w * p[a * count + i] * p[b * count + i]).sum::<f64>()
            };
            dense::symmetric_eigen(&Matrix::from_fn(d, d, entry))
        })
        .collect();
    let largest = scatters.iter().flat_map(|s| s.eigenvalues.iter()).copied().fold(0.0, f64::max);
    let mut whitened = Matrix::zeros(points.nrows(), points.ncols());
    for (i, scatter) in scatters.iter().enumerate() {
        for (a, &value) in scatter.eigenvalues.iter().enumerate() {
            if value <= POINT_RANK * largest {
                continue;
            }
            let direction = scatter.eigenvectors.column(a) / value.sqrt();
            for (k, point) in points.column_iter().enumerate() {
                whitened[(a * count + i, k)] = (0..d).map(|b| direction[b] * point[b * count + i]).sum();
            }
        }
    }
    whitened
}

/// Mean of the second group minus that of the first, at the points.
fn difference(sample: &Sample, labels: &[usize]) -> Vec<f64> {
    let mut sums = [vec![0.0; sample.points.nrows()], vec![0.0; sample.points.nrows()]];
    let mut weights = [0.0; 2];
    for ((point, &label), &weight) in sample.points.column_iter().zip(labels).zip(&sample.weights) {
        sums[label].iter_mut().zip(point.iter()).for_each(|(sum, value)| *sum += weight * value);
        weights[label] += weight;
    }
    let [first, second] = sums;
    first.iter().zip(second).map(|(first, second)| second / weights[1] - first / weights[0]).collect()
}

#[cfg(test)]
mod tests {
    use rand::RngExt;

    use super::*;
    use crate::random::stream;
    use crate::watch::{StopWhen, Unwatched};

    fn noise(i: usize, k: usize) -> f64 {
        stream(17, 1000 * i + k).random_range(-0.5..0.5)
    }

    fn sample(rows: usize, shapes: usize, shift: f64) -> Sample {
        let points = Matrix::from_fn(rows, shapes, |i, k| {
            noise(i, k) + if k >= shapes / 2 && i == 0 { shift } else { 0.0 }
        });
        let sizes = Matrix::from_fn(1, shapes, |_, k| 2.0 + noise(rows, k));
        Sample { coordinates: points.clone(), points, dimension: 2, sizes, weights: vec![1.0; shapes] }
    }

    fn halves(shapes: usize) -> Vec<usize> {
        (0..shapes).map(|k| usize::from(k >= shapes / 2)).collect()
    }

    #[test]
    fn one_coordinate_gives_the_classical_statistics() {
        // Groups 1, 2, 3 and 5, 7, 9 of one number: means 2 and 7, squares within 2 + 8, pooled variance 2.5.
        let values = [1.0, 2.0, 3.0, 5.0, 7.0, 9.0];
        let points = Matrix::from_fn(2, 6, |i, k| if i == 0 { values[k] } else { 0.0 });
        let sizes = Matrix::from_row_slice(1, 6, &values);
        let sample =
            Sample { coordinates: points.clone(), points, dimension: 2, sizes, weights: vec![1.0; 6] };
        let relabellings = Relabellings::new(halves(6), 2, &[0; 6], 0, 100);
        let tests = sample.compare_pair(&relabellings, &Unwatched).unwrap();
        let t_squared = 25.0 / (2.5 * (1.0 / 3.0 + 1.0 / 3.0));
        for value in
            [tests.pseudo_f.value, tests.hotelling.value, tests.effect.t_squared[0]].map(Option::unwrap)
        {
            assert!((value - t_squared).abs() < 1e-12, "{value} for {t_squared}");
        }
        assert!((tests.distance.value.unwrap() - 5.0).abs() < 1e-14);
        assert!((tests.sizes[0].value.unwrap() - 5.0).abs() < 1e-14);
        assert_eq!(tests.effect.difference, [5.0, 0.0]);
        // Of the 20 choices of three numbers, this one and its complement are farthest apart.
        let tally = Tally { exceeding: 1, permutations: 19, exact: true };
        let found =
            [tests.distance.tally, tests.hotelling.tally, tests.effect.tallies[0], tests.sizes[0].tally];
        assert_eq!(found, [tally; 4]);
        assert_eq!(tally.p(), Some(0.1));
    }

    #[test]
    fn enumeration_is_brute_force() {
        let sample = sample(6, 6, 0.4);
        let relabellings = Relabellings::new(halves(6), 2, &[0; 6], 0, 1000);
        let tests = sample.compare_pair(&relabellings, &Unwatched).unwrap();
        let distance = |second: &[usize]| {
            let mean = |members: &mut dyn Iterator<Item = usize>| {
                members.map(|k| sample.coordinates.column(k).into_owned()).reduce(|a, b| a + b).unwrap() / 3.0
            };
            let first = mean(&mut (0..6).filter(|k| !second.contains(k)));
            (mean(&mut second.iter().copied()) - first).norm()
        };
        let observed = distance(&[3, 4, 5]);
        let mut reaching = 0;
        for a in 0..6 {
            for b in a + 1..6 {
                for c in b + 1..6 {
                    reaching += usize::from(distance(&[a, b, c]) >= observed - 1e-12);
                }
            }
        }
        assert!((tests.distance.value.unwrap() - observed).abs() < 1e-12);
        let wanted = Tally { exceeding: reaching - 1, permutations: 19, exact: true };
        assert_eq!((tests.distance.tally, tests.pseudo_f.tally), (wanted, wanted));
        // An overall test of two groups is the test of the pair.
        let overall = sample.compare_all(&relabellings, &Unwatched).unwrap();
        assert_eq!(overall.pseudo_f.tally, wanted);
        assert!((overall.r_squared - tests.r_squared).abs() < 1e-12);
    }

    #[test]
    fn groups_that_are_shifted_are_told_apart_where_they_are() {
        let relabellings = Relabellings::new(halves(40), 2, &[0; 40], 3, 499);
        let tests = sample(20, 40, 1.0).compare_pair(&relabellings, &Unwatched).unwrap();
        assert_eq!((tests.distance.tally.exceeding, tests.effect.tallies[0].exceeding), (0, 0));
        assert!(tests.effect.tallies[1..].iter().all(|tally| tally.p().unwrap() > 0.05));
    }

    #[test]
    fn threads_do_not_matter_and_seeds_do() {
        let run = |threads: usize, seed| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let relabellings = Relabellings::new(halves(30), 2, &[0; 30], seed, 300);
            pool.install(|| sample(10, 30, 0.2).compare_pair(&relabellings, &Unwatched).unwrap())
        };
        assert_eq!(run(1, 5), run(3, 5));
        assert_ne!(run(1, 5), run(1, 6));
    }

    #[test]
    fn equal_shapes_differ_by_nothing_and_stopping_stops() {
        let relabellings = Relabellings::new(halves(20), 2, &[0; 20], 0, 50);
        let points = Matrix::from_element(4, 20, 1.5);
        let sizes = Matrix::from_element(1, 20, 0.1);
        let sample =
            Sample { coordinates: points.clone(), points, dimension: 2, sizes, weights: vec![0.3; 20] };
        let tests = sample.compare_pair(&relabellings, &Unwatched).unwrap();
        assert_eq!((tests.distance.value, tests.distance.tally.p()), (Some(0.0), Some(1.0)));
        assert_eq!(tests.sizes[0].tally.p(), Some(1.0));
        assert_eq!(sample.compare_pair(&relabellings, &StopWhen(&|| true)), Err(AnalysisError::Interrupted));
    }
}
