//! The report card of a dictionary of components: how well its modes describe shapes, and the changes along them.
//!
//! | measure | with the first `m` modes |
//! |---|---|
//! | compactness | explained fraction of the variance |
//! | generalisation | error of shapes of a subject, described by components of all other subjects |
//! | specificity | distance of random shapes to the nearest training shape |
//! | stability | angles of modes, intervals of variances, under resampling of subjects |
//! | learning curve | generalisation with components of fewer subjects |
//! | named measurements | change with each mode, in units that people know |
//!
//! Everything is computed in the coordinates of the spectrum of the training shapes (`sample`), so that no component is learnt anew from
//! shapes: leaving a subject out, resampling and learning from fewer are downdates and sums of small matrices, and exact. The mean
//! shape to which shapes are aligned is kept, as in [`downdate`](super::downdate).
//!
//! Lengths are in the unit of the cohort: the pose of each shape is undone by its size.
//!
//! Sources: Davies, Twining, Cootes, Waterton, Taylor 2002 (the three measures); Efron, Tibshirani 1993 (bootstrap).

mod generalisation;
mod interval;
mod learning_curve;
pub mod measurement;
mod record;
pub(in crate::dictionary) mod sample;
mod specificity;
mod stability;
#[cfg(test)]
pub(crate) mod tests;

use self::generalisation::generalisation;
pub use self::interval::Interval;
use self::interval::moments;
pub use self::learning_curve::LearningPoint;
use self::learning_curve::{DRAWS, learning_curve};
use self::measurement::{Dimension, Functional, Quantity, value};
pub use self::record::{Errors, MeasuredMode, MeasurementReport, ModeReport, ReportCard, WantedShape};
use self::sample::Sample;
use self::specificity::specificity;
pub use self::stability::Angle;
use self::stability::stability;
use super::in_use::Dictionary;
use super::model::Model;
use super::recipe::Recipe;
use super::work::{EIGENPROBLEM, PRODUCT};
use crate::AnalysisError;
use crate::accumulate::{Mark, ShapesInMemory, prepare, ranked};
use crate::metric::{Metric, dot, norm};
use crate::robust::mean_by;
use crate::rows::rows_of;
use crate::strata::strata;
use crate::watch::{Counted, Watch};
use shapelex_geometry::representation::ShapeSpace;
use shapelex_numeric::dense::{FULL_SOLVER_SIZE, Matrix};

/// Maximum number of modes of a report.
pub const MAX_MODES: usize = 64;

/// Distances as sets of points that are computed for each measure.
const SET_DISTANCES: usize = 1000;

/// Fewest and most shapes of which distances as sets of points are computed.
const SHOWN: [usize; 2] = [10, 100];

/// A named measurement, with values for which the most likely shape is wanted.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
pub struct Measurement {
    /// Name, once in a request.
    pub name: String,
    /// Quantity that is measured.
    pub measure: Quantity,
    /// Values for which the most likely shape is returned, at most 20, in the unit of the cohort or in degrees.
    #[cfg_attr(feature = "serde", serde(default))]
    #[cfg_attr(feature = "schema", schema(max_items = 20))]
    pub values: Vec<f64>,
}

/// Content of a report.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ReportOptions {
    /// Number of modes, at most [`MAX_MODES`].
    pub modes: usize,
    /// Number of random shapes of the specificity.
    pub draws: usize,
    /// Number of resamples of the stability.
    pub resamples: usize,
    /// Seed of all random choices.
    pub seed: u64,
    /// Named measurements.
    pub measurements: Vec<Measurement>,
}

/// Training shapes of a dictionary, as stored.
#[derive(Debug)]
pub struct TrainingShapes {
    /// `d·N` coordinate-major control points for each shape.
    pub control_points: Vec<f64>,
    /// Weights.
    pub weights: Vec<f64>,
    /// Subject of each shape, numbered from 0 without gaps.
    pub subjects: Vec<usize>,
}

impl TrainingShapes {
    /// The same in the order of their [marks](crate::accumulate::Mark), whatever order they were given in; subjects are numbered in
    /// this order.
    fn ranked(self) -> Self {
        let Self { control_points, weights, subjects } = self;
        let length = control_points.len() / weights.len().max(1);
        let order = ranked(&Mark::of_all(&control_points, &weights), 0);
        let rows = order.iter().flat_map(|&k| &control_points[k * length..(k + 1) * length]).copied();
        let mut numbers: Vec<Option<usize>> = vec![None; subjects.iter().max().map_or(0, |last| last + 1)];
        let mut count = 0;
        let mut number = |&k: &usize| {
            *numbers[subjects[k]].get_or_insert_with(|| {
                count += 1;
                count - 1
            })
        };
        Self {
            control_points: rows.collect(),
            subjects: order.iter().map(&mut number).collect(),
            weights: order.iter().map(|&k| weights[k]).collect(),
        }
    }
}

/// Lengths in the unit of the cohort.
struct Scale {
    /// Size of each shape as given, over its size in the pose of the dictionary.
    sizes: Vec<f64>,
    /// Mean of these.
    mean: f64,
    /// Norm of the constant function one: norms over it are root mean squares.
    one: f64,
}

impl Scale {
    fn new(metric: &Metric, sizes: Vec<f64>) -> Self {
        let mut ones = vec![0.0; metric.len()];
        ones[..metric.size()].fill(1.0);
        let mean = sizes.iter().sum::<f64>() / sizes.len() as f64;
        Self { sizes, mean, one: metric.inner(&ones, &ones).sqrt() }
    }

    /// Root mean square distance for the norm of a difference of shape `k` in pose.
    fn length(&self, k: usize, norm: f64) -> f64 {
        self.sizes[k] * norm / self.one
    }

    /// A distance between points of shape `k` in pose.
    fn set(&self, k: usize, distance: f64) -> f64 {
        self.sizes[k] * distance
    }
}

/// Errors by number of components, from 0 on: root mean square distances.
struct ByNumber {
    /// Of corresponding points.
    points: Vec<Interval>,
    /// As sets of points, of some of the shapes; `None` for landmarks.
    sets: Option<Vec<Interval>>,
}

impl ByNumber {
    /// Means of lists with an entry for each number of components, of points and of sets where there are some.
    fn of(lists: Vec<(Vec<f64>, Option<Vec<f64>>)>) -> Self {
        let (points, sets): (Vec<_>, Vec<_>) = lists.into_iter().unzip();
        let sets: Vec<Vec<f64>> = sets.into_iter().flatten().collect();
        let means = |lists: &[Vec<f64>]| {
            let entries = lists.first().map_or(0, Vec::len);
            let of = |i: usize| lists.iter().map(|list| list[i]).collect::<Vec<f64>>();
            (0..entries).map(|i| Interval::of_mean(&of(i))).collect()
        };
        Self { points: means(&points), sets: (!sets.is_empty()).then(|| means(&sets)) }
    }
}

/// Distances of shapes as sets of points.
struct PointSets<'a> {
    space: &'a ShapeSpace,
    metric: &'a Metric,
    sample: &'a Sample,
}

impl PointSets<'_> {
    /// Positions of the shapes, among `count`, whose distances are computed for `modes` modes: evenly spread, ascending.
    fn chosen(&self, count: usize, modes: usize) -> Vec<usize> {
        let most = (SET_DISTANCES / (modes + 1)).clamp(SHOWN[0], SHOWN[1]).min(count);
        (0..most).map(|i| i * count / most).collect()
    }

    /// Control points of the shape with the coordinates `z`: `N × d`.
    fn shape(&self, z: &[f64]) -> Matrix {
        let mut shape = self.sample.whitened(z);
        self.metric.unwhiten(&mut shape);
        Matrix::from_vec(self.metric.size(), self.metric.dimension(), shape)
    }

    /// Distance of two shapes; `None` for landmarks.
    fn distance(&self, a: &Matrix, b: &Matrix) -> Option<f64> {
        self.space.set_distance(a, b)
    }
}

/// Work of a report besides reading and aligning its shapes, in multiply-adds: measured, to a factor of 1.5.
pub fn report_work(space: &ShapeSpace, shapes: usize, subjects: usize, options: &ReportOptions) -> f64 {
    let representation = space.representation();
    let (n, k) = ((representation.size() * representation.dimension()) as f64, shapes as f64);
    let (rank, modes) = (n.min(k), options.modes as f64);
    let components = match rank <= FULL_SOLVER_SIZE as f64 {
        true => rank.powi(3),
        false => KRYLOV * rank * rank * (2.0 * modes + 32.0),
    };
    let scatter = SCATTER * k * rank * rank;
    let spectrum = PRODUCT * k * n * (n.min(k) + rank) + EIGENPROBLEM * rank.powi(3);
    let left_out = subjects as f64 * components;
    let resampled = options.resamples as f64 * (scatter + components + modes.powi(4));
    let curve = (6 * DRAWS) as f64 * (scatter + components);
    let random = options.draws as f64 * k * (modes + 1.0);
    let count =
        (SHOWN[0] as f64 * (modes + 1.0)).max(SET_DISTANCES as f64).min(SHOWN[1] as f64 * (modes + 1.0));
    let sets = 2.0 * count * space.set_distance_work();
    spectrum + left_out + resampled + curve + random + sets
}

/// Multiply-adds of an eigenproblem for few pairs, divided by the size of its space and the square of its size.
const KRYLOV: f64 = 0.3;

/// Multiply-adds of a scatter, divided by its number of vectors and the square of their size, in the time of single ones.
const SCATTER: f64 = 0.01;

/// Memory of a report in bytes, besides its shapes as given.
pub fn report_bytes(length: usize, shapes: usize, options: &ReportOptions) -> f64 {
    let (n, k) = (length as f64, shapes as f64);
    let rank = n.min(k);
    8.0 * (4.0 * k * n
        + n * rank
        + k * rank
        + 8.0 * rank * rank
        + options.draws as f64 * options.modes as f64)
}

impl Dictionary {
    /// The report card of a dictionary of components, from its training shapes.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] at `dictionary` for sparse codes and below three subjects or without variation, at
    /// `shapes` if these are not the training shapes, at `measurements` for one without a value; degenerate shapes; [`AnalysisError::Interrupted`].
    pub fn report(
        &self,
        space: &ShapeSpace,
        mut shapes: TrainingShapes,
        options: &ReportOptions,
        watch: &dyn Watch,
    ) -> Result<ReportCard, AnalysisError> {
        let (sample, sizes) = self.training_sample(&mut shapes)?;
        watch.check()?;
        let count = options.modes.min(self.model.len()).min(sample.values.len());
        let scale = Scale::new(self.metric(), sizes);
        self.measured(space, &shapes, &sample, &scale, (options, count), watch)
    }

    /// The shapes that the dictionary was learnt from in the coordinates of their spectrum, and their sizes as given over those in
    /// pose, in an order that depends on the shapes alone: some of them are then chosen by their places, and by drawn ones. `shapes` are without those that were left out then; their weights are moved.
    ///
    /// # Errors
    /// As [`Self::report`].
    pub(in crate::dictionary) fn training_sample(
        &self,
        shapes: &mut TrainingShapes,
    ) -> Result<(Sample, Vec<f64>), AnalysisError> {
        let Model::Components { pca, .. } = &self.model else {
            let detail = "expected a dictionary of components, got sparse codes: they have no modes";
            return Err(AnalysisError::Parameter { field: "dictionary", detail: detail.into() });
        };
        let given = TrainingShapes {
            control_points: std::mem::take(&mut shapes.control_points),
            weights: std::mem::take(&mut shapes.weights),
            subjects: std::mem::take(&mut shapes.subjects),
        };
        *shapes = self.retained(given)?.ranked();
        let prepared = self.preparation.prepare(&shapes.control_points)?;
        let mut given = shapes.control_points.clone();
        prepare(self.metric(), self.preparation.method.translates(), 0, &mut given)?;
        let sizes = given.chunks_exact(self.metric().len()).zip(&prepared);
        let sizes = sizes.map(|(given, posed)| norm(given) / norm(&posed.whitened)).collect();
        let whitened = prepared.into_iter().flat_map(|shape| shape.whitened).collect();
        let posed = ShapesInMemory::prepared(whitened, std::mem::take(&mut shapes.weights));
        let sample = Sample::new(&posed, &self.preparation.mean, pca.centred, &shapes.subjects)?;
        if sample.subjects.len() < MIN_SUBJECTS {
            let detail =
                format!("expected shapes of at least {MIN_SUBJECTS} subjects, got {}", sample.subjects.len());
            return Err(AnalysisError::Parameter { field: "dictionary", detail });
        }
        if pca.eigenvalues.is_empty() || sample.values.is_empty() {
            let detail = "expected shapes that vary, got equal ones: they have no modes";
            return Err(AnalysisError::Parameter { field: "dictionary", detail: detail.into() });
        }
        let mut learnt_from = pca.eigenvalues.iter().zip(&sample.values);
        let same = |(a, b): (&f64, &f64)| (a - b).abs() <= SAME * pca.eigenvalues[0];
        if !learnt_from.all(same) {
            let detail = "expected the shapes from which the dictionary was learnt, got others";
            return Err(AnalysisError::Parameter { field: "shapes", detail: detail.into() });
        }
        Ok((sample, sizes))
    }

    fn measured(
        &self,
        space: &ShapeSpace,
        shapes: &TrainingShapes,
        sample: &Sample,
        scale: &Scale,
        (options, count): (&ReportOptions, usize),
        watch: &dyn Watch,
    ) -> Result<ReportCard, AnalysisError> {
        let sets = PointSets { space, metric: self.metric(), sample };
        let (draws, resamples, seed) = (options.draws, options.resamples, options.seed);
        let sizes = learning_curve::sizes(sample.subjects.len()).len();
        let counted = Counted::new(watch, sample.count() + draws + resamples + sizes * DRAWS);
        let general = generalisation(sample, scale, &sets, count, &counted)?;
        let special = specificity(sample, &sample.spread(count), scale, &sets, (draws, seed), &counted)?;
        let stable = stability(sample, count, (resamples, seed), &counted)?;
        let errors = |m: usize| Errors {
            generalisation: general.points[m],
            generalisation_to_set: general.sets.as_ref().map(|sets| sets[m]),
            specificity: special.points[m],
            specificity_to_set: special.sets.as_ref().map(|sets| sets[m]),
        };
        let mode = |i: usize| ModeReport {
            component: i + 1,
            variance: stable.variances[i],
            explained: stable.explained[i],
            compactness: stable.cumulative[i],
            angle_deg: stable.modes[i],
            span_angle_deg: stable.spans[i],
            errors: errors(i + 1),
        };
        let measurements = options.measurements.iter();
        let measurements =
            measurements.map(|wanted| self.measurement(space, shapes, sample, scale, wanted, count));
        Ok(ReportCard {
            shapes: sample.count(),
            subjects: sample.subjects.len(),
            mean_only: errors(0),
            modes: (0..count).map(mode).collect(),
            learning_curve: learning_curve(sample, scale, count, seed, &counted)?,
            measurements: measurements.collect::<Result<_, _>>()?,
            warnings: warnings(sample, options, count),
        })
    }

    fn measurement(
        &self,
        space: &ShapeSpace,
        shapes: &TrainingShapes,
        sample: &Sample,
        scale: &Scale,
        Measurement { name, measure: quantity, values }: &Measurement,
        count: usize,
    ) -> Result<MeasurementReport, AnalysisError> {
        let no_value = || AnalysisError::Parameter {
            field: "measurements",
            detail: format!("'{name}' has no value or no derivative at the mean shape: choose other places"),
        };
        let spread = sample.spread(count);
        let deviation = |i: usize| spread.covariance[(i, i)].max(0.0).sqrt();
        let length = self.metric().len();
        let at_mean_size = |mut whitened: Vec<f64>| {
            self.metric().unwhiten(&mut whitened);
            whitened.iter_mut().for_each(|value| *value *= scale.mean);
            whitened
        };
        let mut centre = vec![0.0; sample.values.len()];
        centre[..count].copy_from_slice(&spread.mean);
        let mean = at_mean_size(sample.whitened(&centre));
        let mode = |i: usize| {
            let column = sample.basis.column(i);
            at_mean_size(column.iter().map(|q| deviation(i) * q).collect())
        };
        let modes: Vec<Vec<f64>> = (0..count).map(mode).collect();
        let functional = Functional::new(space, *quantity, &mean, &modes).ok_or_else(no_value)?;
        let (of_mean, gradient) = functional.at(&vec![0.0; count]).ok_or_else(no_value)?;
        let each = shapes.control_points.chunks_exact(length).enumerate();
        let known: Vec<(usize, f64)> =
            each.filter_map(|(k, shape)| Some((k, value(space, quantity, shape)?))).collect();
        if known.is_empty() {
            return Err(no_value());
        }
        let of: Vec<f64> = known.iter().map(|(_, value)| *value).collect();
        let (average, spread_of_values) = moments(&of);
        let correlated = |i: usize| {
            let scores: Vec<f64> = known.iter().map(|(k, _)| sample.shape(*k)[i]).collect();
            correlation(&scores, &of)
        };
        let modes_of = (0..count).map(|i| MeasuredMode {
            component: i + 1,
            change: gradient[i],
            correlation: correlated(i),
        });
        let wanted = values.iter().map(|&value| {
            let scores = functional.with_value(value);
            let shape = scores.as_ref().map(|z| {
                let mut shape = mean.clone();
                for (z, mode) in z.iter().zip(&modes) {
                    shape.iter_mut().zip(mode).for_each(|(x, q)| *x += z * q);
                }
                rows_of(&shape, self.metric().dimension())
            });
            WantedShape { value, distance: scores.as_ref().map(|z| norm(z)), scores, control_points: shape }
        });
        Ok(MeasurementReport {
            name: name.clone(),
            unit: unit_of(quantity.dimension(), self.content.length_unit.as_deref()),
            of_mean,
            mean: average,
            deviation: spread_of_values,
            shapes: known.len(),
            modes: modes_of.collect(),
            wanted: wanted.collect(),
        })
    }

    /// The shapes that the dictionary was learnt from: without those that a robust mean leaves out.
    fn retained(&self, shapes: TrainingShapes) -> Result<TrainingShapes, AnalysisError> {
        if self.content.robust.is_none() {
            return Ok(shapes);
        }
        let recipe = Recipe::of(&self.content);
        let setting = recipe.setting()?;
        let source = setting.shapes(shapes.control_points.clone(), shapes.weights.clone())?;
        let found = mean_by(
            recipe.estimator,
            &source,
            &setting.metric,
            &setting.method,
            recipe.frame,
            &setting.matching,
        )?;
        let Some(factors) = found.robust else { return Ok(shapes) };
        let length = self.metric().len();
        let mut kept =
            TrainingShapes { control_points: Vec::new(), weights: Vec::new(), subjects: Vec::new() };
        for (k, factor) in factors.factors.iter().enumerate().filter(|(_, factor)| **factor > 0.0) {
            kept.control_points.extend_from_slice(&shapes.control_points[k * length..(k + 1) * length]);
            kept.weights.push(shapes.weights[k] * factor);
            kept.subjects.push(shapes.subjects[k]);
        }
        kept.subjects = strata(kept.subjects);
        Ok(kept)
    }
}

/// Fewest subjects of a report: of two others, one component at most is known.
const MIN_SUBJECTS: usize = 3;

/// Relative difference of eigenvalues that numbers read back from a record may have.
const SAME: f64 = 1e-6;

fn unit_of(dimension: Dimension, unit: Option<&str>) -> Option<String> {
    match dimension {
        Dimension::Angle => Some("deg".into()),
        Dimension::Length => unit.map(str::to_owned),
        Dimension::Area => unit.map(|unit| format!("{unit}²")),
    }
}

fn correlation(a: &[f64], b: &[f64]) -> Option<f64> {
    let away = |x: &[f64]| -> Vec<f64> {
        let (mean, _) = moments(x);
        x.iter().map(|x| x - mean).collect()
    };
    let (a, b) = (away(a), away(b));
    let found = dot(&a, &b) / (norm(&a) * norm(&b));
    found.is_finite().then_some(found)
}

fn warnings(sample: &Sample, options: &ReportOptions, count: usize) -> Vec<String> {
    let mut warnings = Vec::new();
    let subjects = sample.subjects.len();
    if count < options.modes {
        warnings.push(format!("the dictionary has {count} modes"));
    }
    if subjects < FEW_SUBJECTS {
        warnings.push(format!("{subjects} subjects: intervals from so few are too narrow"));
    }
    if sample.weights.iter().any(|weight| *weight != sample.weights[0]) {
        warnings.push("means over subjects do not weigh shapes; components do".into());
    }
    warnings
}

/// Number of subjects below which a report says so.
const FEW_SUBJECTS: usize = 20;
