//! Factors of bands, learnt from the training shapes: each is completed by the components of all other subjects.
//!
//! ```text
//! δ_i = √((r_i − r̂_i)ᵀ C_i⁻¹ (r_i − r̂_i))      at the hidden places i of a held-out shape, of which a patch or arc is hidden
//! pointwise      the quantile of all δ_i, every hidden part counting once
//! simultaneous   q^(1−w) l^w,   w = 20/(20 + S),   S subjects, each with several hidden parts:
//!                q the quantile of max_i δ_i,   l = exp(a + b t_{S−1} √(1 + 1/S)),   a, b mean and deviation of ln max_i δ_i
//! ```
//!
//! Components without a subject are exact downdates, as in the report card. The mean shape to which shapes are aligned is that of all. Hidden parts
//! are of 10 to 40 % of a shape: arcs of curves, patches of surfaces, neighbouring and scattered landmarks by turns.
//!
//! Few subjects determine the quantile of the largest errors badly, and one of them determines it alone where it is raised to that of the next
//! whole subject, as in split conformal prediction. So it is drawn towards the predictive quantile of a lognormal distribution, the more the fewer
//! subjects there are. The weight and its alternatives are measured on thirty sets (`docs/evaluation.md`).

use super::assessed::{PartMeasures, PartScore};
use super::conditioning::{Posterior, Seen};
use super::model::PosteriorModel;
use super::places::{AtPlaces, selected};
use crate::AnalysisError;
use crate::dictionary::in_use::Dictionary;
use crate::dictionary::model::Spread;
use crate::dictionary::novelty::{Logarithms, Novelty, limit};
use crate::dictionary::report::TrainingShapes;
use crate::dictionary::report::sample::{Part, Sample};
use crate::dictionary::score::{rank, value_at};
use crate::dictionary::work::{EIGENPROBLEM, PRODUCT};
use crate::metric::Metric;
use crate::quantile::student_quantile;
use crate::watch::Watch;
use rand::rngs::ChaCha12Rng;
use rand::seq::index::sample;
use rand::{RngExt, SeedableRng};
use shapelex_geometry::representation::ShapeSpace;
use shapelex_geometry::sampling::Places;
use shapelex_numeric::dense::{FULL_SOLVER_SIZE, Matrix, multiply};
use shapelex_numeric::kernels::add_scaled;
use shapelex_numeric::parallel;

/// Hidden fractions of a shape, by turns.
const HIDDEN: [f64; 4] = [0.1, 0.2, 0.3, 0.4];
/// Most subjects that are left out, evenly spread.
pub const MAX_SUBJECTS: usize = 256;
/// Number of quantiles that are kept.
const KEPT: usize = 1001;
/// Number of subjects for which the quantile of the largest errors and that of a lognormal distribution count alike.
const LOGNORMAL: f64 = 20.0;
/// Fewest subjects: of two others, one component at most is known.
const MIN_SUBJECTS: usize = 3;

/// Distances of held-out shapes from their predictions, in standard deviations.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// Number of subjects that were left out.
    pub subjects: usize,
    /// Number of shapes that were completed, each several times.
    pub shapes: usize,
    /// Quantiles of the distances of hidden places, ascending.
    pointwise: Vec<f64>,
    /// Quantiles of the largest distance of each hidden part, ascending, and their logarithms.
    simultaneous: Vec<f64>,
    logarithms: Logarithms,
    /// Quantiles of the misfit of the seen parts for each free number, ascending.
    seen: Vec<f64>,
    /// The same parts by how unlike the model they are, for each hidden fraction.
    extents: Vec<Extent>,
}

/// Parts of held-out shapes of which one fraction was hidden, one of each shape, by how unlike the model their seen parts are.
#[derive(Debug, Clone, PartialEq)]
struct Extent {
    hidden: f64,
    /// `t` and `s` of [`PartMeasures`], ascending.
    distances: Vec<f64>,
    residuals: Vec<f64>,
    /// The common measure of both, ascending, and its scale.
    together: Vec<f64>,
    scale: Novelty,
}

impl Extent {
    fn of(hidden: f64, measures: &[PartMeasures]) -> Self {
        let sorted = |of: &dyn Fn(&PartMeasures) -> f64| {
            let mut values: Vec<f64> = measures.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        let (distances, residuals) = (sorted(&|m| m.distance), sorted(&|m| m.residual));
        let scale =
            Novelty { distances: Some(Logarithms::of(&distances)), residuals: Logarithms::of(&residuals) };
        let together = sorted(&|m| scale.measure(Some(m.distance), m.residual));
        Self { hidden, distances, residuals, together, scale }
    }

    fn score(&self, measures: PartMeasures, quantile: f64) -> PartScore {
        let together = self.scale.measure(Some(measures.distance), measures.residual);
        PartScore {
            is_outlier: together > limit(&self.together, quantile),
            distance_rank: rank(&self.distances, measures.distance),
            residual_rank: rank(&self.residuals, measures.residual),
        }
    }
}

/// A hidden part of a held-out shape.
struct Trial {
    /// Index of the hidden fraction.
    extent: usize,
    distances: Vec<f64>,
    /// Misfit of the seen part for each free number.
    seen: f64,
    measures: PartMeasures,
}

impl Calibration {
    fn of(trials: &[Trial], subjects: usize, shapes: usize) -> Self {
        let mut all: Vec<(f64, f64)> = trials
            .iter()
            .flat_map(|trial| trial.distances.iter().map(|d| (*d, 1.0 / trial.distances.len() as f64)))
            .collect();
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        let sorted = |values: Vec<f64>| {
            let mut values = values;
            values.sort_by(f64::total_cmp);
            thinned(&values)
        };
        let largest = |trial: &Trial| trial.distances.iter().copied().fold(0.0, f64::max);
        let largest: Vec<f64> = trials.iter().map(largest).collect();
        Self {
            subjects,
            shapes,
            pointwise: weighted_quantiles(&all),
            logarithms: Logarithms::of(&largest),
            simultaneous: sorted(largest),
            seen: sorted(trials.iter().map(|trial| trial.seen).collect()),
            extents: HIDDEN
                .iter()
                .enumerate()
                .filter_map(|(extent, hidden)| {
                    let of = trials.iter().filter(|trial| trial.extent == extent).map(|trial| trial.measures);
                    let measures: Vec<PartMeasures> = of.collect();
                    (!measures.is_empty()).then(|| Extent::of(*hidden, &measures))
                })
                .collect(),
        }
    }

    /// Compares the seen part of a shape, of which the fraction `hidden` is missing, with the parts of held-out shapes of which nearly as much
    /// was hidden. Among parts like those of the training, the fraction `1 − quantile` counts as outliers.
    pub fn score(&self, measures: PartMeasures, hidden: f64, quantile: f64) -> PartScore {
        let away = |extent: &&Extent| (extent.hidden - hidden).abs();
        let nearest = self.extents.iter().min_by(|a, b| away(a).total_cmp(&away(b)));
        nearest.expect("a calibration has trials").score(measures, quantile)
    }

    /// Factor of standard deviations of a pointwise band.
    pub fn pointwise(&self, level: f64) -> f64 {
        value_at(&self.pointwise, level)
    }

    /// Factor of standard deviations of a simultaneous band, and whether there are enough subjects for the level: one of `S + 1` is expected
    /// beyond it.
    pub fn simultaneous(&self, level: f64) -> (f64, bool) {
        let subjects = self.subjects as f64;
        let weight = LOGNORMAL / (LOGNORMAL + subjects);
        let t = student_quantile(level, self.subjects.saturating_sub(1).max(1));
        let Logarithms { mean, deviation } = self.logarithms;
        let lognormal = mean + deviation * t * (1.0 + 1.0 / subjects).sqrt();
        let own = value_at(&self.simultaneous, level).max(f64::MIN_POSITIVE).ln();
        (((1.0 - weight) * own + weight * lognormal).exp(), level * (subjects + 1.0) <= subjects)
    }

    /// Fraction of the held-out parts whose seen points fit better, or as well, for `misfit` a free number.
    pub fn rank(&self, misfit: f64) -> f64 {
        rank(&self.seen, misfit)
    }

    /// Memory in bytes.
    pub fn bytes(&self) -> usize {
        let extents: usize = self.extents.iter().map(|extent| 3 * extent.together.len() + 8).sum();
        8 * (self.pointwise.len() + self.simultaneous.len() + self.seen.len() + extents) + 64
    }
}

/// Quantiles `0, 1/1000, … 1` of ascending values with weights.
fn weighted_quantiles(all: &[(f64, f64)]) -> Vec<f64> {
    let total: f64 = all.iter().map(|(_, weight)| weight).sum();
    let (mut at, mut sum) = (0, all.first().map_or(0.0, |(_, weight)| *weight));
    let quantile = |k: usize| {
        let wanted = total * k as f64 / (KEPT - 1) as f64;
        while sum < wanted && at + 1 < all.len() {
            at += 1;
            sum += all[at].1;
        }
        all[at].0
    };
    if all.is_empty() { Vec::new() } else { (0..KEPT).map(quantile).collect() }
}

fn thinned(values: &[f64]) -> Vec<f64> {
    match values.len() {
        0..=KEPT => values.to_vec(),
        _ => (0..KEPT).map(|k| value_at(values, k as f64 / (KEPT - 1) as f64)).collect(),
    }
}

/// Factor of a band of normal errors without calibration: the square root of the quantile of `χ²` with `d` degrees of freedom.
pub fn normal_factor(level: f64, dimension: usize) -> f64 {
    if dimension == 2 {
        return (-2.0 * (1.0 - level).ln()).sqrt();
    }
    // P(|x| ≤ f) = ∫₀^f √(2/π) x² e^(−x²/2) dx of three coordinates.
    let density = |x: f64| (2.0 / std::f64::consts::PI).sqrt() * x * x * (-x * x / 2.0).exp();
    upper_limit(12.0, density, level)
}

/// Steps in which integrals are taken between 0 and the end.
const STEPS_OF_INTEGRALS: usize = 200;

/// `∫ f` between two limits, by Simpson's rule on one step.
fn integral_of_step(low: f64, high: f64, f: impl Fn(f64) -> f64) -> f64 {
    (high - low) / 6.0 * (f(low) + 4.0 * f(0.5 * (low + high)) + f(high))
}

/// The `x` between 0 and `most` for which `∫₀ˣ f = wanted`; `f` is not negative. The step that contains it is halved.
fn upper_limit(most: f64, f: impl Fn(f64) -> f64 + Copy, wanted: f64) -> f64 {
    let at = |i: usize| most * i as f64 / STEPS_OF_INTEGRALS as f64;
    let (mut step, mut sum) = (0, 0.0);
    while step + 1 < STEPS_OF_INTEGRALS {
        let part = integral_of_step(at(step), at(step + 1), f);
        if sum + part >= wanted {
            break;
        }
        (step, sum) = (step + 1, sum + part);
    }
    let (mut low, mut high) = (at(step), at(step + 1));
    for _ in 0..50 {
        let middle = 0.5 * (low + high);
        if sum + integral_of_step(at(step), middle, f) < wanted { low = middle } else { high = middle }
    }
    high
}

/// How parts of shapes are hidden.
struct Hiding<'a> {
    places: &'a Places,
    /// Points of the mean, coordinate-major.
    mean: &'a [f64],
    dimension: usize,
    /// Whether arcs may go around the end.
    closed: bool,
}

impl Hiding<'_> {
    /// Hides a part: which of the places. An arc of curves, the neighbours of a place of surfaces and landmarks, of these by turns
    /// scattered ones.
    fn part(&self, turn: usize, random: &mut ChaCha12Rng) -> Vec<bool> {
        let count = self.places.count();
        let number =
            ((HIDDEN[turn % HIDDEN.len()] * count as f64).round() as usize).clamp(1, count.max(2) - 1);
        let chosen: Vec<usize> = match self.places {
            Places::Curve(_) => {
                let first = random.random_range(0..if self.closed { count } else { count - number + 1 });
                (first..first + number).map(|i| i % count).collect()
            }
            Places::Landmarks(_) if (turn / HIDDEN.len() + turn) % 2 == 1 => {
                sample(random, count, number).into_vec()
            }
            _ => {
                let centre = random.random_range(0..count);
                let away = |i: &usize| -> f64 {
                    let difference = |c: usize| self.mean[c * count + i] - self.mean[c * count + centre];
                    (0..self.dimension).map(|c| difference(c).powi(2)).sum()
                };
                let mut order: Vec<usize> = (0..count).collect();
                order.sort_by(|a, b| away(a).total_cmp(&away(b)));
                order[..number].to_vec()
            }
        };
        let mut hidden = vec![false; count];
        chosen.into_iter().for_each(|i| hidden[i] = true);
        hidden
    }
}

/// Training shapes at the places of the grid, in the coordinates of their spectrum.
struct Held<'a> {
    model: &'a PosteriorModel,
    sample: &'a Sample,
    places: Places,
    closed: bool,
    /// Points of the mean, and of each direction as a column.
    mean: Vec<f64>,
    basis: Matrix,
}

impl<'a> Held<'a> {
    fn new(model: &'a PosteriorModel, space: &ShapeSpace, sample: &'a Sample) -> Self {
        let places = Places::along(space, model.size());
        let (n, d) = (model.size(), model.dimension());
        let points = |whitened: &[f64]| {
            let mut shape = whitened.to_vec();
            model.metric.unwhiten(&mut shape);
            places.points(space, &Matrix::from_vec(n, d, shape))
        };
        let columns: Vec<f64> = sample.basis.column_iter().flat_map(|q| points(q.as_slice())).collect();
        let mean = points(&sample.mean);
        let basis = Matrix::from_vec(mean.len(), sample.values.len(), columns);
        Self { model, sample, mean, basis, places, closed: space.representation().is_closed() }
    }

    /// Shapes of the others at the places.
    fn without(&self, subject: usize, part: &Part) -> AtPlaces {
        let (sample, pairs) = (self.sample, &part.pairs);
        let members = &sample.subjects[subject];
        let others = sample.count() - members.len();
        let mean = match sample.centred {
            true => vec![0.0; pairs.values.len()],
            // About the origin, shapes have the mean scores Vᵀ Σ w z / Σ w.
            false => {
                (pairs.vectors.transpose() * self.mean_coordinates(subject, part.weight)).as_slice().to_vec()
            }
        };
        let spread = Spread::from_moments(&pairs.values, mean, others, part.weight);
        let root = spread.root();
        let mut centre = part.shift.clone();
        pairs.vectors.column_iter().zip(&spread.mean).for_each(|(v, s)| {
            centre.iter_mut().zip(v.iter()).for_each(|(sum, v)| *sum += s * v);
        });
        let moved = &self.basis * Matrix::from_vec(centre.len(), 1, centre);
        let modes = multiply(&self.basis, &multiply(&pairs.vectors, &root)).transpose();
        AtPlaces {
            dimension: self.model.dimension(),
            mean: self.mean.iter().zip(moved.iter()).map(|(m, by)| m + by).collect(),
            modes,
            noise: self.model.grid.noise.clone(),
        }
    }

    /// `Σ w z / Σ w` of the shapes of all subjects but one.
    fn mean_coordinates(&self, subject: usize, weight: f64) -> Matrix {
        let mut mean = Matrix::zeros(self.sample.values.len(), 1);
        let left_out = &self.sample.subjects[subject];
        for (k, share) in self.sample.weights.iter().map(|w| w / weight).enumerate() {
            if !left_out.contains(&k) {
                add_scaled(mean.as_mut_slice(), share, self.sample.shape(k));
            }
        }
        mean
    }

    /// Completes the shapes of a subject by the components of all others.
    fn trials(&self, subject: usize, seed: u64) -> Result<Vec<Trial>, AnalysisError> {
        let members = &self.sample.subjects[subject];
        let part = self.sample.without(subject, self.model.components())?;
        let at = self.without(subject, &part);
        let mut trials = Vec::new();
        for &k in members.iter().take(HIDDEN.len()) {
            let mut random = ChaCha12Rng::seed_from_u64(seed);
            random.set_stream(k as u64);
            let z = Matrix::from_column_slice(self.sample.values.len(), 1, self.sample.shape(k));
            let away = &self.basis * z;
            let points: Vec<f64> = self.mean.iter().zip(away.iter()).map(|(m, by)| m + by).collect();
            let hiding = Hiding {
                places: &self.places,
                mean: &self.mean,
                dimension: self.model.dimension(),
                closed: self.closed,
            };
            for turn in 0..HIDDEN.len() {
                let hidden = hiding.part(k + turn, &mut random);
                // A part that leaves too little for the pose says nothing.
                trials.extend(self.trial(&at, &points, &hidden, (k + turn) % HIDDEN.len()).ok());
            }
        }
        Ok(trials)
    }

    fn trial(
        &self,
        at: &AtPlaces,
        points: &[f64],
        hidden: &[bool],
        extent: usize,
    ) -> Result<Trial, AnalysisError> {
        let d = self.model.dimension();
        let of = |wanted: bool| (0..hidden.len()).filter(|&i| hidden[i] == wanted).collect::<Vec<usize>>();
        let (seen, unseen) = (of(false), of(true));
        let known = Seen::of(at.select(&seen), selected(points, d, &seen));
        let posterior = Posterior::new(&known, &self.model.freedom)?;
        let distances = posterior.at(&at.select(&unseen)).distances(&selected(points, d, &unseen))?;
        Ok(Trial { extent, distances, seen: posterior.misfit_per_number(), measures: posterior.measures() })
    }
}

/// Work of a calibration besides reading and aligning its shapes, in multiply-adds. `unknowns`: number of scores and of unknowns of
/// the pose.
pub fn calibration_work(metric: &Metric, shapes: usize, subjects: usize, unknowns: usize) -> f64 {
    let (n, k, u) = (metric.len() as f64, shapes as f64, unknowns as f64);
    let rank = n.min(k);
    let components =
        if rank <= FULL_SOLVER_SIZE as f64 { rank.powi(3) } else { rank * rank * (0.6 * u + 10.0) };
    let spectrum = PRODUCT * k * n * (n.min(k) + rank) + EIGENPROBLEM * rank.powi(3);
    let subject = EIGENPROBLEM * components + n * rank * u;
    let trial = STEPS * n * u * u;
    let each = (shapes as f64 / subjects.max(1) as f64).min(HIDDEN.len() as f64) * HIDDEN.len() as f64;
    spectrum + subjects.min(MAX_SUBJECTS) as f64 * (subject + each * trial)
}

/// Steps of a posterior, its covariances among them.
const STEPS: f64 = 8.0;

impl Posterior {
    /// `(|z|² + Σ |q − ŷ|²/v) / m`: squared Mahalanobis distance of the seen part from the mean, for each of its `m` free numbers.
    pub fn misfit_per_number(&self) -> f64 {
        (self.distance().powi(2) + self.misfit) / self.freedom.max(1) as f64
    }
}

impl Dictionary {
    /// Learns the factors of bands from the training shapes.
    ///
    /// Cost: for each of at most 256 subjects an eigenproblem of the size of the spectrum, and four posteriors a shape.
    ///
    /// # Errors
    /// As [`Self::report`], and [`AnalysisError::TooFewShapes`] if no hidden part could be completed.
    pub fn calibrate(
        &self,
        space: &ShapeSpace,
        model: &PosteriorModel,
        mut shapes: TrainingShapes,
        seed: u64,
        watch: &dyn Watch,
    ) -> Result<Calibration, AnalysisError> {
        let (sample, _) = self.training_sample(&mut shapes)?;
        watch.check()?;
        let held = Held::new(model, space, &sample);
        let all = sample.subjects.len();
        let chosen: Vec<usize> =
            (0..all.min(MAX_SUBJECTS)).map(|i| i * all / all.min(MAX_SUBJECTS)).collect();
        let trials: Vec<Vec<Trial>> = parallel::try_map(chosen.len(), &|i| {
            watch.check()?;
            held.trials(chosen[i], seed)
        })?;
        let trials: Vec<Trial> = trials.into_iter().flatten().collect();
        if trials.is_empty() || all < MIN_SUBJECTS {
            return Err(AnalysisError::TooFewShapes { found: all, needed: MIN_SUBJECTS });
        }
        let shapes = chosen.iter().map(|&subject| sample.subjects[subject].len().min(HIDDEN.len())).sum();
        Ok(Calibration::of(&trials, chosen.len(), shapes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trial(extent: usize, largest: f64, measures: (f64, f64)) -> Trial {
        let measures = PartMeasures { distance: measures.0, residual: measures.1 };
        Trial { extent, distances: vec![0.5 * largest, largest], seen: 1.0, measures }
    }

    /// Of a lognormal distribution, the factor is its quantile; of few subjects one wild error does not set it alone.
    #[test]
    fn simultaneous_factors_of_few_subjects_are_drawn_towards_a_lognormal() {
        let normal = |k: usize, n: usize| {
            let p = (k as f64 + 0.5) / n as f64;
            if p < 0.5 { -student_quantile(1.0 - p, 10_000) } else { student_quantile(p, 10_000) }
        };
        let of = |n: usize, wild: f64| {
            let trials = (0..n).map(|k| {
                trial(
                    k % 4,
                    (1.0 + 0.3 * normal(k, n)).exp() * if k + 1 == n { wild } else { 1.0 },
                    (1.0, 1.0),
                )
            });
            Calibration::of(&trials.collect::<Vec<_>>(), n / 4, n / 4).simultaneous(0.95)
        };
        let wanted = (1.0 + 0.3 * 1.644_854_f64).exp();
        let (found, enough) = of(800, 1.0);
        assert!((found / wanted - 1.0).abs() < 0.01 && enough, "{found} {wanted}");
        let (few, enough) = of(56, 1.0);
        assert!(few > wanted && few < 1.15 * wanted && !enough, "{few} {wanted}");
        assert!(of(56, 5.0).0 < 1.3 * wanted, "{}", of(56, 5.0).0);
    }

    /// Parts are compared with those of which nearly as much was hidden.
    #[test]
    fn parts_are_compared_with_parts_of_their_extent() {
        let trials: Vec<Trial> = (0..400)
            .map(|k| {
                trial(
                    k % 4,
                    1.0,
                    (
                        0.5 + (k / 4) as f64 / 100.0,
                        if k % 4 == 3 { 4.0 } else { 1.0 } + (k / 4) as f64 / 100.0,
                    ),
                )
            })
            .collect();
        let calibration = Calibration::of(&trials, 100, 100);
        let of = |hidden: f64, residual: f64| {
            calibration.score(PartMeasures { distance: 1.0, residual }, hidden, 0.95)
        };
        assert!(of(0.2, 4.5).is_outlier && !of(0.6, 4.5).is_outlier && !of(0.2, 1.5).is_outlier);
        assert!(
            (of(0.4, 4.495).residual_rank - 0.5).abs() < 1e-12
                && (of(0.1, 1.0).distance_rank - 0.51).abs() < 1e-12
        );
        assert!(calibration.score(PartMeasures { distance: 9.0, residual: 1.5 }, 0.2, 0.95).is_outlier);
    }
}
