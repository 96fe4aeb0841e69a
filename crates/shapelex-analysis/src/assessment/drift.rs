//! Drift: differences between new shapes and the training shapes of a dictionary.
//!
//! Compared are the distributions of both distance measures, the scores, the mean shape and the frequencies of classes.

use super::Assessor;
use crate::AnalysisError;
use crate::accumulate::{ShapeSource, Shapes, ShapesInMemory};
use crate::alignment::{MIN_SHAPES, mean_shape};
use crate::classification::Observations;
use crate::classifier_record::ClassRecord;
use crate::dictionary::model::{Model, described};
use crate::dictionary::score::{Known, rank, value_at};
use crate::mean_angle::{self, MIN_TO_HALVE};
use crate::metric::norm;
use crate::preparation::Preparation;
use crate::watch::Watch;

/// Distribution of a measure over the new shapes, compared with the training shapes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct MeasureDrift {
    /// Quantiles of the training shapes: 10 %, 50 %, 90 %, 99 %.
    pub training: [f64; 4],
    /// The same quantiles of the new shapes.
    pub new: [f64; 4],
    /// Largest difference between the two distribution functions (Kolmogorov–Smirnov statistic).
    pub largest_difference: f64,
}

/// Drift of the scores of one component.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ScoreDrift {
    /// Number of the component, counted from 1.
    pub component: usize,
    /// Mean score of the new shapes minus that of the training shapes, in standard deviations of the training scores.
    pub shift: f64,
    /// Standard deviation of the new scores divided by that of the training scores.
    pub spread: f64,
}

/// Drift of the mean shape: the mean of the new shapes compared with the mean of the dictionary.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct MeanDrift {
    /// Angle between the two means under the class, in degrees. For closed curves whose start points are searched, the
    /// minimum over all starts, including those between control points.
    pub angle_deg: f64,
    /// Root mean square of the angle expected without any change, in degrees, from the two numbers of shapes and the
    /// spread of the training shapes. If start points, directions or mirror images are searched, it is estimated from
    /// the means of halves of the training shapes, each with its own search. Null for sparse dictionaries without a
    /// search.
    pub expected_deg: Option<f64>,
}

/// Frequency of a class among training and new shapes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ClassDrift {
    /// Name of the class.
    pub label: String,
    /// Fraction of the training shapes that belong to the class.
    pub training: f64,
    /// Fraction of the new shapes that are assigned to the class.
    pub new: f64,
}

/// Differences between new shapes and the training shapes of a dictionary. The default is that of no new shapes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Drift {
    /// Number of new shapes.
    pub shapes: usize,
    /// Number of new shapes beyond the training quantile.
    pub outliers: usize,
    /// Squared Mahalanobis distances; `None` for sparse dictionaries or without new shapes.
    pub t_squared: Option<MeasureDrift>,
    /// Squared prediction errors; `None` without new shapes.
    pub residuals: Option<MeasureDrift>,
    /// Scores; `None` for sparse dictionaries or with fewer than two new shapes.
    pub scores: Option<Vec<ScoreDrift>>,
    /// Mean shape; `None` with fewer than two new shapes.
    pub mean: Option<MeanDrift>,
    /// Classes; `None` without a classifier or without new shapes.
    pub classes: Option<Vec<ClassDrift>>,
}

/// Reads a [sample](ShapesInMemory::sample) of at most the given number of the training shapes, whitened as those of a source.
pub type ReadTraining<'a> = dyn Fn(usize) -> Result<ShapesInMemory, AnalysisError> + 'a;

/// Maximum number of training shapes that are halved: the spread of their means does not depend on their number.
const MAX_HALVED: usize = 400;

/// Sums over the new shapes.
#[derive(Default)]
struct Sums {
    residuals: Vec<f64>,
    distances: Vec<f64>,
    outliers: usize,
    first: Vec<f64>,
    second: Vec<f64>,
    classes: Vec<usize>,
}

impl Assessor {
    /// Compares the training shapes with the shapes of `source`; those beyond the training quantile `quantile` (from
    /// 0.5 to below 1) are outliers. `training` is called if the expected angle between means depends on a search.
    ///
    /// Cost: encoding the new shapes, their mean, and with a search sixteen means of halves of 400 training shapes.
    ///
    /// # Errors
    /// Errors of the source and of `training`; degenerate shapes; [`AnalysisError::Interrupted`].
    pub fn drift(
        &self,
        source: &dyn ShapeSource,
        training: &ReadTraining<'_>,
        quantile: f64,
        watch: &dyn Watch,
    ) -> Result<Drift, AnalysisError> {
        let mut sums = Sums::default();
        let passed = source.for_each_batch(&mut |batch| self.add(&mut sums, batch, quantile));
        passed.map_err(|error| source.located(error))?;
        let shapes = sums.residuals.len();
        if shapes == 0 {
            return Ok(Drift::default());
        }
        let mean = (shapes >= MIN_SHAPES).then(|| self.mean_drift(source, training, watch)).transpose()?;
        let known = Known::of(&self.dictionary.content.statistics);
        let t_squared = Some(known.t_squared).filter(|_| !sums.distances.is_empty());
        Ok(Drift {
            shapes,
            outliers: sums.outliers,
            scores: self.score_drift(&sums).filter(|_| shapes >= MIN_SHAPES),
            classes: self.class_drift(&sums),
            t_squared: t_squared.map(|trained| MeasureDrift::new(trained, sums.distances)),
            residuals: Some(MeasureDrift::new(known.residuals, sums.residuals)),
            mean,
        })
    }

    fn add(&self, sums: &mut Sums, batch: Shapes<'_>, quantile: f64) -> Result<(), AnalysisError> {
        let (preparation, model) = (&self.dictionary.preparation, &self.dictionary.model);
        let shapes = ShapesInMemory::prepared(batch.whitened.to_vec(), batch.weights.to_vec());
        let described = described(preparation, model, &shapes).map_err(|error| error.after(batch.first))?;
        let (prepared, codes) = described;
        for (y, code) in prepared.chunks_exact(preparation.metric.len()).zip(&codes) {
            let score = self.dictionary.score_of(y, code, quantile);
            sums.outliers += usize::from(score.outlier);
            sums.residuals.push(score.residual);
            sums.distances.extend(score.t_squared);
            if let Model::Components { spread, .. } = model {
                sums.first.resize(code.values.len(), 0.0);
                sums.second.resize(code.values.len(), 0.0);
                for (i, value) in code.values.iter().enumerate() {
                    sums.first[i] += value - spread.mean[i];
                    sums.second[i] += (value - spread.mean[i]).powi(2);
                }
            }
        }
        if let Some((classifier, record)) = self.classifier() {
            let observations = Observations { shapes: batch.whitened, prepared: &prepared, codes: &codes };
            let evidence = classifier.evidence(self.description(record), observations);
            sums.classes.resize(record.classes.len(), 0);
            for evidence in evidence.map_err(|error| error.after(batch.first))? {
                sums.classes[evidence.best()] += 1;
            }
        }
        Ok(())
    }

    fn score_drift(&self, sums: &Sums) -> Option<Vec<ScoreDrift>> {
        let Model::Components { spread, .. } = &self.dictionary.model else { return None };
        let n = sums.residuals.len() as f64;
        let of_component = |i: usize| {
            let deviation = spread.covariance[(i, i)].sqrt();
            let mean = sums.first[i] / n;
            let variance = (sums.second[i] - n * mean * mean).max(0.0) / (n - 1.0).max(1.0);
            // Scores without variation cannot serve as a unit.
            let over = |value: f64| if deviation > 0.0 { value / deviation } else { 0.0 };
            ScoreDrift { component: i + 1, shift: over(mean), spread: over(variance.sqrt()) }
        };
        Some((0..spread.mean.len()).map(of_component).collect())
    }

    /// Angle between the mean of the new shapes and the mean of the dictionary.
    fn mean_drift(
        &self,
        source: &dyn ShapeSource,
        training: &ReadTraining<'_>,
        watch: &dyn Watch,
    ) -> Result<MeanDrift, AnalysisError> {
        let Preparation { metric, method, matching, .. } = &self.dictionary.preparation;
        let mean = mean_shape(source, metric, method, self.dictionary.content.frame, matching);
        let mean = mean.map_err(|error| source.located(error))?;
        let angle_deg = mean_angle::angle(&self.dictionary.preparation, &mean.whitened)?.to_degrees();
        let counts = [source.count(), self.dictionary.content.statistics.shapes];
        let by_search = match matching.searches() {
            true => self.expected_by_halves(&training(MAX_HALVED)?, counts, watch)?,
            false => None,
        };
        Ok(MeanDrift { angle_deg, expected_deg: by_search.or_else(|| self.expected_by_spread(counts)) })
    }

    /// Expected angle between means that each search their own start points; `None` if there are too few training
    /// shapes.
    fn expected_by_halves(
        &self,
        some: &ShapesInMemory,
        counts: [usize; 2],
        watch: &dyn Watch,
    ) -> Result<Option<f64>, AnalysisError> {
        if some.count() < MIN_TO_HALVE {
            return Ok(None);
        }
        let stop = || watch.stop();
        match mean_angle::expected(
            &self.dictionary.preparation,
            self.dictionary.content.frame,
            some,
            counts,
            &stop,
        ) {
            Err(AnalysisError::Interrupted) => Err(AnalysisError::Interrupted),
            // A half can be degenerate although the whole is not: no angle is reported then.
            other => Ok(other.ok().map(f64::to_degrees)),
        }
    }

    /// Expected angle from the spread of the training shapes about their mean; valid if nothing is searched.
    fn expected_by_spread(&self, counts: [usize; 2]) -> Option<f64> {
        let statistics = &self.dictionary.content.statistics;
        let Model::Components { pca, .. } = &self.dictionary.model else { return None };
        let size = norm(&pca.mean).powi(2);
        let about_mean = if pca.centred { 0.0 } else { size };
        let variance = (statistics.total? / statistics.weight - about_mean).max(0.0) / size;
        let numbers: f64 = counts.iter().map(|&count| 1.0 / count.max(1) as f64).sum();
        Some((variance * numbers).sqrt().atan().to_degrees())
    }

    fn class_drift(&self, sums: &Sums) -> Option<Vec<ClassDrift>> {
        let record = self.dictionary.content.classifier.as_ref()?;
        let all: usize = record.classes.iter().map(|class| class.shapes).sum();
        let new: usize = sums.classes.iter().sum();
        let part = |count: usize, all: usize| count as f64 / all.max(1) as f64;
        let drift = |(class, &count): (&ClassRecord, &usize)| ClassDrift {
            label: class.label.clone(),
            training: part(class.shapes, all),
            new: part(count, new),
        };
        Some(record.classes.iter().zip(&sums.classes).map(drift).collect())
    }
}

impl MeasureDrift {
    fn new(training: &[f64], mut new: Vec<f64>) -> Self {
        new.sort_by(f64::total_cmp);
        let quantiles = |values: &[f64]| [0.1, 0.5, 0.9, 0.99].map(|quantile| value_at(values, quantile));
        let difference = |value: &f64| (rank(training, *value) - rank(&new, *value)).abs();
        let largest_difference = training.iter().chain(&new).map(difference).fold(0.0, f64::max);
        Self { training: quantiles(training), new: quantiles(&new), largest_difference }
    }
}
