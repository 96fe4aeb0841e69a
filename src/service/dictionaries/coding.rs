//! Use of dictionaries: codes, reconstructions, scores, priors, samples. The functions are synchronous and run on the
//! pool.
//!
//! They read and limit the shapes; the arithmetic is in [`analysis::dictionary`](crate::analysis::dictionary).

use super::ready::Ready;
use crate::analysis::conversion::Conversion;
use crate::analysis::correspondence::Correspondence;
use crate::analysis::dictionary::coding::{AnswerPose, CodedShape, Reconstruction};
use crate::analysis::dictionary::modes::Sample;
use crate::analysis::dictionary::posted_code::PostedCode;
use crate::analysis::dictionary::prior::{Energy, Reference};
use crate::analysis::dictionary::score::Score;
use crate::formats::fault::Fault;
use crate::formats::shape::ShapeInput;
use crate::geometry::capability::FieldFault;
use crate::geometry::resample::RepeatedPoints;
use crate::numeric::MAX_NUMBER;
use crate::service::app::{App, Limits, ServiceError, Work};
use crate::service::cohorts::catalogue;
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::read::{self, Reading};

/// Shapes to which a dictionary is applied.
#[derive(Debug)]
pub enum Asked {
    /// Posted shapes.
    Posted(Vec<ShapeInput>),
    /// Control points of stored shapes.
    Stored(Vec<f64>),
}

impl Asked {
    /// Predicted work of encoding the shapes and answering `numbers` numbers for each.
    pub fn work(&self, ready: &Ready, numbers: usize, limits: &Limits) -> Work {
        let count = match self {
            Self::Posted(shapes) => shapes.len(),
            Self::Stored(control_points) => control_points.len() / ready.setup.metric.len(),
        };
        ready.work(count, numbers, limits)
    }
}

/// Control points of stored shapes with these ids or external ids.
///
/// # Errors
/// A cohort that does not exist, or that has another representation or correspondence; shapes that do not exist.
pub async fn stored(app: &App, ready: &Ready, cohort: &str, ids: &[String]) -> Result<Asked, ServiceError> {
    let cohort = catalogue::find(app, cohort).await?;
    let content = &ready.dictionary.content;
    if cohort.spec.representation != content.representation
        || cohort.spec.correspondence != content.correspondence
    {
        let detail = format!(
            "expected a cohort with the representation and correspondence of the dictionary, those of '{}' \
             differ",
            cohort.spec.name
        );
        return Err(ServiceError::invalid("/cohort", detail));
    }
    let shapes = crate::service::cohorts::source::find_all(app, &cohort, ids).await?;
    Ok(Asked::Stored(shapes.into_iter().flat_map(|shape| shape.control_points).collect()))
}

impl Asked {
    /// Control points, one shape after the other, read under `correspondence`.
    fn control_points(
        self,
        app: &App,
        ready: &Ready,
        correspondence: Correspondence,
    ) -> Result<Vec<f64>, ServiceError> {
        let control_points = match self {
            Self::Stored(control_points) => control_points,
            Self::Posted(shapes) => {
                let (space, direction) = (&ready.setup.space, ready.dictionary.content.direction);
                let repeated_points = RepeatedPoints::Drop;
                let conversion = Conversion { space, correspondence, direction, repeated_points };
                let reading = Reading { conversion, limits: &app.limits };
                read::read_batch(&reading, shapes)?.control_points
            }
        };
        if control_points.is_empty() {
            return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
        }
        Ok(control_points)
    }
}

impl Ready {
    /// Predicted work of encoding `shapes` shapes, and of answering `numbers` numbers for each in addition to its code.
    pub fn work(&self, shapes: usize, numbers: usize, limits: &Limits) -> Work {
        let (length, model) = (self.setup.metric.len(), &self.dictionary.model);
        let counts = Counts::for_space(&self.setup.space, shapes, limits);
        let numbers = numbers.min(limits.samples) as f64 + length as f64 + model.len() as f64;
        requests::encode(counts, model.work(length), numbers, self.setup.matching.searches())
    }
}

/// Encodes shapes.
///
/// # Errors
/// Faults of the shapes; degenerate shapes; [`ServiceError::Cancelled`].
pub fn encode(app: &App, ready: &Ready, asked: Asked) -> Result<Vec<CodedShape>, ServiceError> {
    let control_points = asked.control_points(app, ready, ready.dictionary.content.correspondence)?;
    Ok(ready.dictionary.encode(&control_points, &app.pool.context())?)
}

/// Reconstructs shapes from their codes, with the distances at `samples` parameters.
///
/// # Errors
/// Faults of the shapes; degenerate shapes, including those that the alignment makes degenerate.
pub fn reconstruct_shapes(
    app: &App,
    ready: &Ready,
    asked: Asked,
    pose: AnswerPose,
    samples: usize,
) -> Result<Vec<Reconstruction>, ServiceError> {
    let coded = encode(app, ready, asked)?;
    check_samples(app, samples, coded.len())?;
    let (dictionary, space) = (&ready.dictionary, &ready.setup.space);
    let reconstruct = |(index, coded): (usize, &CodedShape)| {
        let reconstruction = dictionary.reconstruct(space, coded, pose, samples);
        Ok(reconstruction.map_err(|error| error.at(index))?)
    };
    coded.iter().enumerate().map(reconstruct).collect()
}

/// Checks the total number of requested distances.
pub(crate) fn check_samples(app: &App, samples: usize, shapes: usize) -> Result<(), ServiceError> {
    let (total, most) = (samples.saturating_mul(shapes), app.limits.samples);
    if total > most {
        let detail = format!("expected at most {most} distances over all shapes, got {total}");
        return Err(ServiceError::invalid("/samples", detail));
    }
    Ok(())
}

/// Reconstructs shapes from posted codes: in the pose of the dictionary, or as given by matrices and offset.
///
/// # Errors
/// All faults of the codes, at `/codes/{index}…`.
pub fn reconstruct_codes(
    app: &App,
    ready: &Ready,
    codes: &[PostedCode],
) -> Result<Vec<Reconstruction>, ServiceError> {
    if codes.is_empty() {
        let detail = format!("expected between 1 and {} codes, got 0", app.limits.shapes);
        return Err(ServiceError::invalid("/codes", detail));
    }
    let (mut fitting, mut faults) = (Vec::with_capacity(codes.len()), Vec::new());
    for (index, code) in codes.iter().enumerate() {
        let placed = |fault: FieldFault| Fault::from(fault).below(&format!("/codes/{index}")).at_shape(index);
        match ready.dictionary.fitting(code) {
            Ok(code) => fitting.push(code),
            Err(found) => faults.extend(found.into_iter().map(placed)),
        }
    }
    ServiceError::unless_empty(faults)?;
    let context = app.pool.context();
    fitting.iter().map(|code| context.check().map(|()| code.reconstruct())).collect()
}

/// Scores shapes. Among shapes like those of the training, the fraction `1 − quantile` counts as outliers.
///
/// # Errors
/// Faults of the shapes or of the quantile; degenerate shapes.
pub fn score(app: &App, ready: &Ready, asked: Asked, quantile: f64) -> Result<Vec<Score>, ServiceError> {
    check_quantile(quantile)?;
    let coded = encode(app, ready, asked)?;
    Ok(coded.iter().map(|coded| ready.dictionary.score(coded, quantile)).collect())
}

/// Checks the range of a training quantile.
pub(crate) fn check_quantile(quantile: f64) -> Result<(), ServiceError> {
    if (0.5..1.0).contains(&quantile) {
        return Ok(());
    }
    Err(ServiceError::invalid(
        "/quantile",
        format!("expected a number of at least 0.5 and below 1, got {quantile}"),
    ))
}

/// Caveats about the outliers that a dictionary reports.
pub fn outlier_warnings(ready: &Ready) -> Vec<String> {
    match ready.dictionary.content.statistics.held_out {
        Some(_) => Vec::new(),
        None => vec![IN_SAMPLE.into()],
    }
}

const IN_SAMPLE: &str = "this dictionary has no measures of held-out shapes: outliers and ranks are relative to \
                         the shapes it was learnt from, which it describes better than new shapes, so that more \
                         new shapes are called outliers than the quantile says. Learn it again";

/// Energy and gradient of the shape prior. Points correspond as given: no start point is searched.
///
/// # Errors
/// Faults of the shapes and of `gamma`; a dictionary whose class is not linear.
pub fn prior(
    app: &App,
    ready: &Ready,
    asked: Asked,
    reference: Reference,
    gamma: f64,
) -> Result<Vec<Energy>, ServiceError> {
    if !(gamma > 0.0 && gamma <= MAX_NUMBER) {
        return Err(ServiceError::invalid(
            "/gamma",
            format!("expected a positive number up to 1e100, got {gamma}"),
        ));
    }
    let prior = ready.dictionary.prior(reference, gamma)?;
    let control_points = asked.control_points(app, ready, Correspondence::Landmarks)?;
    let (context, shapes) = (app.pool.context(), control_points.chunks_exact(ready.setup.metric.len()));
    shapes.map(|shape| context.check().map(|()| prior.energy(shape))).collect()
}

/// Draws shapes from the normal distribution of the training scores, scaled by `sigma`; the same seed gives the same
/// shapes.
///
/// # Errors
/// A sparse dictionary; a count or sigma out of bounds.
pub fn sample(
    app: &App,
    ready: &Ready,
    count: usize,
    seed: u64,
    sigma: f64,
) -> Result<Vec<Sample>, ServiceError> {
    let Some(mut sampler) = ready.dictionary.sampler(seed, sigma) else {
        let detail = "is sparse: only functional_pca describes how shapes spread";
        return Err(ServiceError::invalid("", format!("the dictionary {detail}")));
    };
    let mut faults = Vec::new();
    let total = count.saturating_mul(ready.setup.metric.size());
    if count == 0 || total > app.limits.samples {
        let most = app.limits.samples / ready.setup.metric.size().max(1);
        faults.push(Fault::new("/count", format!("expected a number between 1 and {most}, got {count}")));
    }
    if !(0.0..=MAX_SIGMA).contains(&sigma) {
        faults
            .push(Fault::new("/sigma", format!("expected a number between 0 and {MAX_SIGMA}, got {sigma}")));
    }
    ServiceError::unless_empty(faults)?;
    let context = app.pool.context();
    (0..count).map(|_| context.check().map(|()| sampler.draw())).collect()
}

/// Maximum `sigma`.
const MAX_SIGMA: f64 = 1e6;
