//! Posteriors of shapes of which a part is known: completion with calibrated bands, assessment of the seen part.
//!
//! The factors of the bands are learnt from the training shapes when they are first needed, and kept in the cache of this process: the
//! stored dictionary has no need of them, those learnt before have them too, and a request is answered from memory. Without the training
//! shapes (a deleted cohort, erased shapes) there are none, and the answer says so.

use std::sync::Arc;

use tokio::runtime::Handle;

use super::ready::Ready;
use super::report::Training;
use crate::analysis::AnalysisError;
use crate::analysis::dictionary::posterior::assessed::{PartAssessment, PartScore};
use crate::analysis::dictionary::posterior::calibration::{Calibration, normal_factor};
use crate::analysis::dictionary::posterior::conditioning::Posterior;
use crate::analysis::dictionary::posterior::missing::PartialShape;
use crate::analysis::dictionary::posterior::model::PosteriorModel;
use crate::analysis::dictionary::posterior::predicted::Predicted;
use crate::analysis::drawing::View;
use crate::analysis::drawing::completed::{Completed as Drawn, draw_completed};
use crate::analysis::estimate::Estimate;
use crate::geometry::drawing::scene::Drawing;
use crate::geometry::sampling::Places;
use crate::numeric::MAX_NUMBER;
use crate::service::app::cache::Cached;
use crate::service::app::{App, ServiceError, Work};
use crate::wire::fault::Fault;

/// Seed of the hidden parts of training shapes.
const SEED: u64 = 0;
/// Longest predicted calibration, in seconds on one core: it delays the first request.
const LONGEST: f64 = 20.0;
/// Maximum number of shapes in a drawing.
pub const MAX_DRAWN: usize = 12;

impl Cached for PosteriorModel {
    const NAME: &'static str = "posterior_models";

    fn bytes(&self) -> usize {
        Self::bytes(self)
    }
}

impl Cached for Calibration {
    const NAME: &'static str = "calibrations";

    fn bytes(&self) -> usize {
        Self::bytes(self)
    }
}

/// A dictionary prepared for posteriors.
#[derive(Debug, Clone)]
pub struct Prepared {
    /// The model of shapes.
    pub model: Arc<PosteriorModel>,
    /// Factors of bands, or why there are none.
    pub calibration: Result<Arc<Calibration>, String>,
}

/// Request about shapes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Asking {
    /// Fraction of shapes that a band is to cover.
    pub level: f64,
    /// Quantile of held-out shapes beyond which a part is an outlier.
    pub quantile: f64,
    /// Number of places of bands on curves.
    pub samples: usize,
    /// Whether shapes are in the pose of the dictionary.
    pub posed: bool,
}

/// Factors of bands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Factors {
    /// Of each place alone.
    pub pointwise: f64,
    /// Of all hidden places together.
    pub simultaneous: f64,
}

/// A completed shape.
#[derive(Debug)]
pub struct Completion {
    /// Scores and pose.
    pub posterior: Posterior,
    /// Control points, `d·N` coordinate-major numbers, in the pose in which the shape is seen.
    pub control_points: Vec<f64>,
    /// Scores of the dictionary.
    pub scores: Vec<f64>,
    /// Their standard deviations.
    pub deviations: Vec<f64>,
    /// Points along the shape with their covariances.
    pub predicted: Predicted,
    /// Which places of the model's grid are seen.
    pub observed: Vec<bool>,
    /// Points that were seen.
    pub seen: Vec<Vec<f64>>,
}

/// Prepares a dictionary for posteriors; factors of bands if `calibrated`.
///
/// # Errors
/// A sparse dictionary, one of equal shapes; a failure of the store.
pub async fn prepare(app: &App, ready: &Arc<Ready>, calibrated: bool) -> Result<Prepared, ServiceError> {
    let id = ready.listed.id.clone();
    let model = match app.cache.find::<PosteriorModel>(&id, &()) {
        Some(model) => model,
        None => {
            let (length, modes) = (ready.setup.metric.len() as f64, ready.dictionary().model.len() as f64);
            let work = Work::from_multiply_adds(length * length + 100.0 * length * modes);
            let ready = Arc::clone(ready);
            let pool = app.pool.weighing(work);
            let found = pool.run(move || {
                let model = ready.dictionary().posterior_model(&ready.setup.space);
                Ok(Arc::new(model.map_err(of_dictionary)?))
            });
            let model = found.await?;
            app.cache.keep(&id, &(), &model);
            model
        }
    };
    if !calibrated {
        return Ok(Prepared { model, calibration: Err(NOT_WANTED.into()) });
    }
    let calibration = match app.cache.find::<Calibration>(&id, &()) {
        Some(known) => Ok(known),
        None => calibrate(app, ready, &model).await?,
    };
    Ok(Prepared { model, calibration })
}

const NOT_WANTED: &str = "\"calibrated\" is false";

/// Learns the factors of bands from the training shapes, or says why this is not possible.
async fn calibrate(
    app: &App,
    ready: &Arc<Ready>,
    model: &Arc<PosteriorModel>,
) -> Result<Result<Arc<Calibration>, String>, ServiceError> {
    let because = |why: &str| Err(why.to_owned());
    let training = match Training::of(app, ready).await {
        Ok(training) => training,
        Err(ServiceError::NotFound { .. }) => return Ok(because("the cohort of the dictionary was deleted")),
        Err(ServiceError::Parameters(_) | ServiceError::Invalid(_)) => {
            return Ok(because("the training shapes have changed since, or are too many"));
        }
        Err(other) => return Err(other),
    };
    let subjects = training.subjects.iter().max().map_or(0, |last| last + 1);
    let (measured, unknowns) = (ready.setup.measured(), model.score_count() + model.freedom().count());
    let estimate = Estimate::for_calibration(measured, training.shapes.len(), subjects, unknowns);
    if estimate.seconds > LONGEST || estimate.memory_bytes > app.limits.job_bytes as f64 {
        let why = format!(
            "learning their factors would take {:.0} s and {:.1e} bytes, the most are {LONGEST} s and {:.1e} bytes",
            estimate.seconds, estimate.memory_bytes, app.limits.job_bytes as f64
        );
        return Ok(because(&why));
    }
    let (task_app, handle) = (app.clone(), Handle::current());
    let (task_ready, task_model) = (Arc::clone(ready), Arc::clone(model));
    let pool = app.pool.weighing(Work::from_seconds(estimate.seconds));
    let found = pool.run(move || {
        let context = task_app.pool.context();
        let stop = || context.is_cancelled();
        let shapes = training.read(&task_app, &handle, &task_ready, &stop)?;
        let (dictionary, space) = (task_ready.dictionary(), &task_ready.setup.space);
        match dictionary.calibrate(space, &task_model, shapes, SEED, &context) {
            Ok(calibration) => Ok(Ok(Arc::new(calibration))),
            Err(AnalysisError::Interrupted) => Err(ServiceError::Cancelled),
            Err(error) => Ok(Err(error.to_string())),
        }
    });
    match found.await? {
        Ok(calibration) => {
            app.cache.keep(&ready.listed.id, &(), &calibration);
            Ok(Ok(calibration))
        }
        Err(why) => Ok(because(&why)),
    }
}

fn of_dictionary(error: AnalysisError) -> ServiceError {
    match error {
        AnalysisError::Parameter { field: "dictionary", detail } => {
            ServiceError::parameter("dictionary", detail)
        }
        other => other.into(),
    }
}

impl Prepared {
    /// Comparison of the seen part of a shape, of which the fraction `hidden` is missing, with parts of held-out training shapes; with whole
    /// ones if there is no calibration.
    pub fn score(&self, ready: &Ready, posterior: &Posterior, hidden: f64, quantile: f64) -> PartScore {
        match &self.calibration {
            Ok(calibration) => calibration.score(posterior.measures(), hidden, quantile),
            Err(_) => ready.dictionary().score_part(posterior.measures(), self.model.score_count(), quantile),
        }
    }

    /// Why parts are not compared with parts of held-out training shapes, if so.
    pub fn novelty_warning(&self) -> Option<String> {
        let why = self.calibration.as_ref().err()?;
        Some(format!(
            "parts of shapes are compared with whole held-out shapes, not with parts of them: {why}"
        ))
    }

    /// Factors of bands that cover the fraction `level`, with their limitation.
    pub fn factors(&self, level: f64, dimension: usize, hidden: usize) -> (Factors, Option<String>) {
        match &self.calibration {
            Ok(calibration) => {
                let (simultaneous, enough) = calibration.simultaneous(level);
                let few = || {
                    format!(
                        "{} subjects are few for simultaneous bands at the level {level}: the factor rests on a lognormal distribution of the \
                         largest deviations",
                        calibration.subjects
                    )
                };
                (Factors { pointwise: calibration.pointwise(level), simultaneous }, (!enough).then(few))
            }
            Err(why) => {
                // Bonferroni's inequality over the hidden places.
                let each = 1.0 - (1.0 - level) / hidden.max(1) as f64;
                let factors = Factors {
                    pointwise: normal_factor(level, dimension),
                    simultaneous: normal_factor(each, dimension),
                };
                (factors, Some(format!("bands are not calibrated, and too narrow: {why}")))
            }
        }
    }
}

impl Ready {
    /// Predicted work of the posteriors of shapes, of which `places` places are seen or asked for altogether.
    pub fn work_of_parts(&self, shapes: usize, places: usize) -> Work {
        /// A step of a posterior in multiply-adds for each place, coordinate and pair of unknowns; about eight steps are taken.
        const STEP: f64 = 12.0;
        /// Unknowns of a pose in space.
        const POSE: usize = 12;
        let unknowns = (self.dictionary().model.len() + POSE) as f64;
        let steps = STEP * (self.setup.metric.dimension() * places) as f64 * unknowns * unknowns;
        Work::from_multiply_adds(steps) + shapes as f64 * Work::from_seconds(1e-4)
    }
}

/// Completes a shape.
///
/// # Errors
/// Faults of the shape, at their places in it: nothing seen, contradictory conditions, a pose that is not determined.
pub fn complete(
    ready: &Ready,
    prepared: &Prepared,
    shape: &PartialShape,
    asking: Asking,
) -> Result<Completion, Vec<Fault>> {
    let space = &ready.setup.space;
    let posed;
    let model = match asking.posed {
        true => {
            posed = prepared.model.in_pose(true);
            &posed
        }
        false => &*prepared.model,
    };
    let seen = model.seen(space, shape).map_err(|error| faults_of(&error))?;
    let posterior = Posterior::new(&seen, model.freedom()).map_err(|error| faults_of(&error))?;
    let places = Places::along(space, asking.samples);
    let predicted = match asking.samples == model.size() {
        true => posterior.at(model.grid()),
        false => posterior.at(&model.along(space, &places)),
    };
    let control_points = posterior.back.apply(&model.controls().points(&posterior.scores));
    let completion = Completion {
        scores: model.scores(&posterior.scores),
        deviations: model.score_deviations(&posterior.covariance),
        observed: model.seen_at(space, shape, &places),
        seen: seen.points(),
        control_points,
        predicted,
        posterior,
    };
    let numbers =
        completion.control_points.iter().chain(&completion.predicted.points).chain(&completion.scores);
    check_numbers(numbers)?;
    Ok(completion)
}

/// Assesses the part of a shape that is seen: residual, scores and novelty. `samples`: 0 for no residual.
///
/// # Errors
/// Faults of the shape, at their places in it: nothing seen, a pose that is not determined.
pub fn assess(
    ready: &Ready,
    prepared: &Prepared,
    shape: &PartialShape,
    (quantile, samples): (f64, usize),
) -> Result<(PartAssessment, PartScore), Vec<Fault>> {
    let mut part = prepared.model.assess(&ready.setup.space, shape).map_err(|error| faults_of(&error))?;
    if samples == 0 {
        part.residual.clear();
    }
    let numbers =
        part.completed.iter().chain(&part.scores).chain([&part.squared_error, &part.relative_error]);
    check_numbers(numbers)?;
    let hidden = 1.0 - part.seen.len() as f64 / ready.setup.metric.size() as f64;
    let score = prepared.score(ready, &part.posterior, hidden, quantile);
    Ok((part, score))
}

/// Faults of a shape whose pose is so far from that of the model that its numbers are too large.
fn check_numbers<'a>(numbers: impl IntoIterator<Item = &'a f64>) -> Result<(), Vec<Fault>> {
    if numbers.into_iter().all(|x| x.abs() <= MAX_NUMBER) {
        return Ok(());
    }
    let detail =
        format!("expected a shape whose completion has numbers up to {MAX_NUMBER:.0e}, got larger ones");
    Err(vec![Fault::new("", detail)])
}

/// Faults of a partial shape at their places in it.
fn faults_of(error: &AnalysisError) -> Vec<Fault> {
    let fault = match error {
        AnalysisError::Parameter { field: "conditions", detail } => {
            let (position, text) = detail.split_once(": ").unwrap_or(("", detail));
            match position.parse::<usize>() {
                Ok(position) => Fault::new(format!("/conditions/{position}"), text),
                Err(_) => Fault::new("/conditions", detail),
            }
        }
        AnalysisError::Parameter { field: "points", detail } => Fault::new("/points", detail),
        AnalysisError::Parameter { detail, .. } => Fault::new("", detail),
        other => Fault::new("", other.to_string()),
    };
    vec![fault]
}

/// Drawing of the first completed shapes, in the poses in which they are seen.
pub fn draw(ready: &Ready, shapes: &[Completion], factors: Factors) -> Drawing {
    let drawn = |(index, shape): (usize, &Completion)| {
        let seen = shape.observed.iter().filter(|seen| **seen).count();
        let part = 100.0 * seen as f64 / shape.observed.len().max(1) as f64;
        Drawn {
            caption: format!("{}: {part:.0} % seen", index + 1),
            control_points: shape.control_points.clone(),
            seen: shape.seen.clone(),
            predicted: shape.predicted.clone(),
            factors: [factors.pointwise, factors.simultaneous],
            observed: shape.observed.clone(),
        }
    };
    let drawn: Vec<Drawn> = shapes.iter().take(MAX_DRAWN).enumerate().map(drawn).collect();
    let (name, version) = (&ready.listed.name, ready.listed.version);
    let title = format!("shapes completed by {name} version {version}");
    let unit = ready.dictionary().content.length_unit.as_deref();
    draw_completed(&View::as_given(&ready.setup.space), &title, &drawn, unit).to_scale(unit)
}
