//! Drift: differences between shapes added since a dictionary was learnt and its training shapes.
//!
//! Compared are the distributions of both distance measures, the scores, the mean shape and the frequencies of classes.

use tokio::runtime::Handle;

use super::coding::{Known, rank, score_of, value_at};
use super::ready::Ready;
use crate::analysis::AnalysisError;
use crate::analysis::accumulate::{ShapeSource, Shapes, ShapesInMemory};
use crate::analysis::alignment::{MIN_SHAPES, mean_shape};
use crate::analysis::classification::{Description, Observations, described};
use crate::analysis::dictionary::model::Model;
use crate::analysis::dictionary::preparation::Preparation;
use crate::analysis::mean_angle::{self, MIN_TO_HALVE};
use crate::analysis::metric::norm;
use crate::domain::cohort::Cohort;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::source::StoredShapes;
use crate::store::Revisions;

/// Start of the new shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Since {
    /// The revision from which the dictionary was learnt.
    Training,
    /// Shapes added after this revision of the cohort.
    Revision(u64),
    /// Shapes added after this time, in milliseconds since 1970 UTC.
    Time(i64),
}

/// Distribution of a measure over the new shapes, compared with the training shapes.
#[derive(Debug, Clone, PartialEq, serde::Serialize, utoipa::ToSchema)]
pub struct MeasureDrift {
    /// Quantiles of the training shapes: 10 %, 50 %, 90 %, 99 %.
    pub training: [f64; 4],
    /// The same quantiles of the new shapes.
    pub new: [f64; 4],
    /// Largest difference between the two distribution functions (Kolmogorov–Smirnov statistic).
    pub largest_difference: f64,
}

/// Drift of the scores of one component.
#[derive(Debug, Clone, PartialEq, serde::Serialize, utoipa::ToSchema)]
pub struct ScoreDrift {
    /// Number of the component, counted from 1.
    pub component: usize,
    /// Mean score of the new shapes minus that of the training shapes, in standard deviations of the training scores.
    pub shift: f64,
    /// Standard deviation of the new scores divided by that of the training scores.
    pub spread: f64,
}

/// Drift of the mean shape: the mean of the new shapes compared with the mean of the dictionary.
#[derive(Debug, Clone, PartialEq, serde::Serialize, utoipa::ToSchema)]
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
#[derive(Debug, Clone, PartialEq, serde::Serialize, utoipa::ToSchema)]
pub struct ClassDrift {
    /// Name of the class.
    pub label: String,
    /// Fraction of the training shapes that belong to the class.
    pub training: f64,
    /// Fraction of the new shapes that are assigned to the class.
    pub new: f64,
}

/// Drift since a dictionary was learnt.
#[derive(Debug, Clone, PartialEq)]
pub struct Drift {
    /// Id of the cohort.
    pub cohort: String,
    /// Shapes added after this revision are new; for a time, the revision before it.
    pub since: u64,
    /// Last revision considered.
    pub until: u64,
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

/// Compares the training shapes of a dictionary with shapes of its cohort that were added since then and pass its
/// filter. Cost: encoding the new shapes, and computing their mean.
///
/// # Errors
/// A cohort that was deleted; a future revision; degenerate shapes, by name.
pub async fn drift(
    app: &App,
    ready: std::sync::Arc<Ready>,
    since: Since,
    quantile: f64,
) -> Result<Drift, ServiceError> {
    super::coding::check_quantile(quantile).map_err(|_| {
        ServiceError::Query(format!(
            "quantile: expected a number of at least 0.5 and below 1, got {quantile}"
        ))
    })?;
    let provenance = &ready.dictionary.provenance;
    let cohort = app.store.find_cohort(&provenance.cohort).await?;
    let gone = || ServiceError::NotFound { kind: "cohort", key: provenance.cohort_name.clone() };
    let cohort = cohort.ok_or_else(gone)?;
    app.touched.note("cohort_id", &cohort.id);
    let since = match since {
        Since::Training => provenance.cohort_revision,
        Since::Revision(revision) if revision <= cohort.revision => revision,
        Since::Revision(revision) => {
            let detail = format!(
                "since: expected at most {}, the revision of the cohort, got {revision}",
                cohort.revision
            );
            return Err(ServiceError::Query(detail));
        }
        Since::Time(ms) => app.store.revision_before(&cohort.id, ms).await?,
    };
    let revisions = Revisions { after: since, until: cohort.revision };
    let count = app.store.count(&cohort.id, revisions, &provenance.filter).await?;
    if count == 0 {
        let (cohort, until) = (cohort.id, cohort.revision);
        let (t_squared, residuals, scores, mean, classes) = (None, None, None, None, None);
        return Ok(Drift {
            cohort,
            since,
            until,
            shapes: 0,
            outliers: 0,
            t_squared,
            residuals,
            scores,
            mean,
            classes,
        });
    }
    let (task_app, handle, task_ready) = (app.clone(), Handle::current(), ready.clone());
    let work = ready.work(usize::try_from(count).unwrap_or(usize::MAX), 0, &app.limits);
    app.pool
        .weighing(work)
        .run(move || compared(&task_app, &handle, &task_ready, &cohort, since, quantile))
        .await
}

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

fn compared(
    app: &App,
    handle: &Handle,
    ready: &Ready,
    cohort: &Cohort,
    since: u64,
    quantile: f64,
) -> Result<Drift, ServiceError> {
    let filter = &ready.dictionary.provenance.filter;
    let context = app.pool.context();
    let stop = || context.is_cancelled();
    let source = StoredShapes::new(app, handle, cohort, filter, since, &ready.setup, &stop)?;
    let mut sums = Sums::default();
    let passed = source.for_each_batch(&mut |batch| add(&mut sums, ready, batch, quantile));
    passed.map_err(|error| source.named(error))?;
    let statistics = &ready.dictionary.content.statistics;
    let shapes = sums.residuals.len();
    let training = KnownShapes { app, handle, cohort };
    let mean = (shapes >= MIN_SHAPES).then(|| mean_drift(&training, ready, &source)).transpose()?;
    let known = Known::of(statistics);
    let t_squared = Some(known.t_squared).filter(|_| !sums.distances.is_empty());
    Ok(Drift {
        cohort: cohort.id.clone(),
        since,
        until: cohort.revision,
        shapes,
        outliers: sums.outliers,
        t_squared: t_squared.map(|trained| MeasureDrift::new(trained, sums.distances.clone())),
        residuals: Some(MeasureDrift::new(known.residuals, sums.residuals.clone())),
        scores: score_drift(ready, &sums).filter(|_| shapes >= MIN_SHAPES),
        mean,
        classes: class_drift(ready, &sums),
    })
}

fn add(sums: &mut Sums, ready: &Ready, batch: Shapes<'_>, quantile: f64) -> Result<(), ServiceError> {
    let (preparation, model) = (&ready.preparation, &ready.model);
    let shapes = ShapesInMemory::prepared(batch.whitened.to_vec(), batch.weights.to_vec());
    let described = described(preparation, model, &shapes).map_err(|error| error.after(batch.first))?;
    let (prepared, codes) = described;
    for (y, code) in prepared.chunks_exact(preparation.metric.len()).zip(&codes) {
        let score = score_of(ready, y, code, quantile);
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
    if let (Some(classifier), Some(record)) = (&ready.classifier, &ready.dictionary.content.classifier) {
        let observations = Observations { shapes: batch.whitened, prepared: &prepared, codes: &codes };
        let description = Description { preparation, model, size: record.settings.sees_size() };
        let evidence = classifier.evidence(description, observations);
        sums.classes.resize(record.classes.len(), 0);
        for evidence in evidence.map_err(|error| error.after(batch.first))? {
            sums.classes[evidence.best()] += 1;
        }
    }
    Ok(())
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

fn score_drift(ready: &Ready, sums: &Sums) -> Option<Vec<ScoreDrift>> {
    let Model::Components { spread, .. } = &ready.model else { return None };
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
    known: &KnownShapes<'_>,
    ready: &Ready,
    source: &StoredShapes<'_>,
) -> Result<MeanDrift, ServiceError> {
    let Preparation { metric, method, matching, .. } = &ready.preparation;
    let mean = mean_shape(source, metric, method, ready.setup.frame, matching);
    let mean = mean.map_err(|error| source.named(error))?;
    let angle_deg = mean_angle::angle(&ready.preparation, &mean.whitened)?.to_degrees();
    let counts = [source.count(), ready.dictionary.content.statistics.shapes];
    let by_search = match matching.searches() {
        true => known.expected_by_halves(ready, counts)?,
        false => None,
    };
    Ok(MeanDrift { angle_deg, expected_deg: by_search.or_else(|| expected_by_spread(ready, counts)) })
}

/// Expected angle from the spread of the training shapes about their mean; valid if nothing is searched.
fn expected_by_spread(ready: &Ready, counts: [usize; 2]) -> Option<f64> {
    let statistics = &ready.dictionary.content.statistics;
    let Model::Components { pca, .. } = &ready.model else { return None };
    let size = norm(&pca.mean).powi(2);
    let about_mean = if pca.centred { 0.0 } else { size };
    let variance = (statistics.total? / statistics.weight - about_mean).max(0.0) / size;
    let numbers: f64 = counts.iter().map(|&count| 1.0 / count.max(1) as f64).sum();
    Some((variance * numbers).sqrt().atan().to_degrees())
}

/// Maximum number of training shapes that are halved: the spread of their means does not depend on their number.
const MAX_HALVED: usize = 400;

/// Training shapes of a dictionary, as far as they still exist.
struct KnownShapes<'a> {
    app: &'a App,
    handle: &'a Handle,
    cohort: &'a Cohort,
}

impl KnownShapes<'_> {
    /// Expected angle between means that each search their own start points; `None` if too few training shapes are
    /// left.
    fn expected_by_halves(&self, ready: &Ready, counts: [usize; 2]) -> Result<Option<f64>, ServiceError> {
        let context = self.app.pool.context();
        let stop = || context.is_cancelled();
        let provenance = &ready.dictionary.provenance;
        let cohort = Cohort { revision: provenance.cohort_revision, ..self.cohort.clone() };
        let shapes =
            StoredShapes::new(self.app, self.handle, &cohort, &provenance.filter, 0, &ready.setup, &stop)?;
        let some = shapes.spread_out(MAX_HALVED)?;
        if some.count() < MIN_TO_HALVE {
            return Ok(None);
        }
        let angle = mean_angle::expected(&ready.preparation, ready.setup.frame, &some, counts, &stop);
        match angle {
            Err(AnalysisError::Interrupted) => Err(ServiceError::Cancelled),
            // A half can be degenerate although the whole is not: no angle is reported then.
            other => Ok(other.ok().map(f64::to_degrees)),
        }
    }
}

fn class_drift(ready: &Ready, sums: &Sums) -> Option<Vec<ClassDrift>> {
    let record = ready.dictionary.content.classifier.as_ref()?;
    let all: usize = record.classes.iter().map(|class| class.shapes).sum();
    let new: usize = sums.classes.iter().sum();
    let part = |count: usize, all: usize| count as f64 / all.max(1) as f64;
    let drift = |(class, &count): (&crate::analysis::classification::record::ClassRecord, &usize)| {
        ClassDrift { label: class.label.clone(), training: part(class.shapes, all), new: part(count, new) }
    };
    Some(record.classes.iter().zip(&sums.classes).map(drift).collect())
}
