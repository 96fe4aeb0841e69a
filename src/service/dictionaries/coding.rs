//! Use of dictionaries: codes, reconstructions, scores, priors, samples. The functions are synchronous and run on the
//! pool.
//!
//! They read and limit the shapes; the arithmetic is in [`analysis::dictionary`](crate::analysis::dictionary).

use super::part;
use super::ready::Ready;
use crate::analysis::conversion::Conversion;
use crate::analysis::correspondence::Correspondence;
use crate::analysis::dictionary::coding::{AnswerPose, CodedShape, Reconstruction};
use crate::analysis::dictionary::modes::Sample;
use crate::analysis::dictionary::posted_code::PostedCode;
use crate::analysis::dictionary::posterior::missing::PartialShape;
use crate::analysis::dictionary::prior::{Energy, Reference};
use crate::analysis::dictionary::score::Score;
use crate::analysis::rows::columns_of;
use crate::domain::cohort::Cohort;
use crate::domain::shape::Shape;
use crate::geometry::field_fault::FieldFault;
use crate::geometry::resample::RepeatedPoints;
use crate::geometry::size::runs_clockwise;
use crate::numeric::MAX_NUMBER;
use crate::service::app::{App, Limits, ServiceError, Work};
use crate::service::cohorts::{catalogue, source};
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::directions::{Ways, drawn_clockwise, have_direction};
use crate::service::shapes::names::InputNames;
use crate::service::shapes::outcome::{OnError, Outcomes, of_shape};
use crate::service::shapes::read::{self, Reading};
use crate::wire::fault::Fault;
use crate::wire::shape::ShapeInput;

/// A shape to which a dictionary is applied.
#[derive(Debug)]
pub(super) enum Given {
    /// All of it: its control points.
    Whole(Vec<f64>),
    /// The part that is seen.
    Part(Box<PartialShape>),
}

/// Shapes to which a dictionary is applied.
#[derive(Debug)]
pub struct Asked {
    /// Names of the shapes, in order.
    pub names: Vec<InputNames>,
    /// Treatment of shapes that have no answer.
    pub on_error: OnError,
    shapes: AskedShapes,
}

#[derive(Debug)]
enum AskedShapes {
    /// Posted shapes.
    Posted(Vec<ShapeInput>),
    /// Control points of stored shapes.
    Stored(Outcomes<Vec<f64>>),
}

impl Asked {
    /// Posted shapes.
    pub fn posted(shapes: Vec<ShapeInput>, on_error: OnError) -> Self {
        Self { names: InputNames::of_posted(&shapes), on_error, shapes: AskedShapes::Posted(shapes) }
    }

    /// Stored shapes with these ids or external ids, of a cohort with another correspondence if they may have `other_parameters`.
    ///
    /// # Errors
    /// A cohort that does not exist, or that has another representation or correspondence; under [`OnError::Abort`]
    /// shapes that do not exist.
    pub async fn stored(
        app: &App,
        ready: &Ready,
        (cohort, ids): (&str, &[String]),
        (on_error, other_parameters): (OnError, bool),
    ) -> Result<Self, ServiceError> {
        let cohort = catalogue::find(app, cohort).await.map_err(|error| error.named_at("/cohort"))?;
        let alike = cohort.spec.representation == ready.dictionary().content.representation;
        if let Some(detail) = misfit(ready, &cohort).filter(|_| !(other_parameters && alike)) {
            return Err(ServiceError::invalid("/cohort", detail));
        }
        let found = source::find_each(app, &cohort, ids).await?.checked(on_error)?.into_vec();
        let mut names = Vec::with_capacity(found.len());
        let named = |shape: Result<Shape, ServiceError>| {
            names.push(shape.as_ref().map(InputNames::of_stored).unwrap_or_default());
            shape.map(|shape| shape.control_points)
        };
        let shapes = AskedShapes::Stored(Outcomes::new(found.into_iter().map(named).collect()));
        Ok(Self { names, on_error, shapes })
    }

    /// Stored shapes with these control points, each of which has its own answer or error.
    pub(super) fn read(names: Vec<InputNames>, shapes: Vec<Vec<f64>>) -> Self {
        let shapes = Outcomes::new(shapes.into_iter().map(Ok).collect());
        Self { names, on_error: OnError::Skip, shapes: AskedShapes::Stored(shapes) }
    }

    /// Predicted work of encoding the shapes and answering `numbers` numbers for each.
    pub fn work(&self, ready: &Ready, numbers: usize, limits: &Limits) -> Work {
        let parts = match &self.shapes {
            AskedShapes::Posted(shapes) => shapes.iter().filter(|shape| shape.has_missing_parts()).count(),
            AskedShapes::Stored(_) => 0,
        };
        ready.work(self.names.len(), numbers, limits)
            + ready.work_of_parts(parts, parts * ready.setup.metric.size())
    }

    /// A warning of closed planar curves that run against the mean of the dictionary, where that matters.
    pub fn directions(&self, ready: &Ready) -> Option<String> {
        let (space, rule) = (&ready.setup.space, ready.setup.rule());
        if !have_direction(space.representation()) || !rule.counts() {
            return None;
        }
        let mean =
            columns_of(&ready.dictionary().content.mean.control_points, space.representation().dimension());
        let mut ways = Ways::default();
        match &self.shapes {
            AskedShapes::Posted(shapes) => shapes.iter().for_each(|shape| ways.note(drawn_clockwise(shape))),
            AskedShapes::Stored(shapes) => {
                shapes.values().for_each(|points| ways.note(runs_clockwise(space, points)));
            }
        }
        rule.warning_of_model(ways, runs_clockwise(space, &mean)?)
    }

    /// Control points of the shapes, or of the parts of them that are seen.
    pub(super) fn given(self, app: &App, ready: &Ready) -> Result<Outcomes<Given>, ServiceError> {
        let given = match self.shapes {
            AskedShapes::Stored(control_points) => control_points.map(|_, shape| Ok(Given::Whole(shape))),
            AskedShapes::Posted(shapes) => {
                let reading = reading(app, ready, ready.dictionary().content.correspondence);
                let read = read::read_each_by(&reading, shapes, |shape| part::read_given(&reading, shape));
                read?.checked(self.on_error)?
            }
        };
        if given.is_empty() {
            return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
        }
        Ok(given)
    }

    /// Control points of the shapes, read under `correspondence`.
    pub(super) fn control_points(
        self,
        app: &App,
        ready: &Ready,
        correspondence: Correspondence,
    ) -> Result<Outcomes<Vec<f64>>, ServiceError> {
        let control_points = match self.shapes {
            AskedShapes::Stored(control_points) => control_points,
            AskedShapes::Posted(shapes) => {
                let reading = reading(app, ready, correspondence);
                let read = read::read_each(&reading, shapes)?.checked(self.on_error)?;
                read.map(|_, (control_points, _)| Ok(control_points))
            }
        };
        if control_points.is_empty() {
            return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
        }
        Ok(control_points)
    }
}

/// Reader of posted shapes under `correspondence`.
fn reading<'a>(app: &'a App, ready: &'a Ready, correspondence: Correspondence) -> Reading<'a> {
    let (space, direction) = (&ready.setup.space, ready.dictionary().content.direction);
    let conversion = Conversion { space, correspondence, direction, repeated_points: RepeatedPoints::Drop };
    Reading { conversion, limits: &app.limits }
}

/// Why the dictionary cannot be applied to shapes of the cohort, if so.
pub(crate) fn misfit(ready: &Ready, cohort: &Cohort) -> Option<String> {
    let (content, spec) = (&ready.dictionary().content, &cohort.spec);
    let fits = spec.representation == content.representation && spec.correspondence == content.correspondence;
    (!fits).then(|| {
        format!(
            "expected a cohort with the representation and correspondence of the dictionary, those of '{}' \
             differ",
            spec.name
        )
    })
}

impl Ready {
    /// Predicted work of encoding `shapes` shapes, and of answering `numbers` numbers for each in addition to its code.
    pub fn work(&self, shapes: usize, numbers: usize, limits: &Limits) -> Work {
        let (length, model) = (self.setup.metric.len(), &self.dictionary().model);
        let counts = Counts::for_space(&self.setup.space, shapes, limits);
        let numbers = numbers.min(limits.samples) as f64 + length as f64 + model.len() as f64;
        requests::encode(counts, model.work(length), numbers, self.setup.matching.searches())
    }
}

/// Encodes shapes.
///
/// # Errors
/// [`ServiceError::Cancelled`]; under [`OnError::Abort`] faults of the shapes, degenerate shapes.
pub fn encode(app: &App, ready: &Ready, asked: Asked) -> Result<Outcomes<CodedShape>, ServiceError> {
    let (on_error, context) = (asked.on_error, app.pool.context());
    let shapes = asked.control_points(app, ready, ready.dictionary().content.correspondence)?;
    let encode = |shapes: &[Vec<f64>]| ready.dictionary().encode(&shapes.concat(), &context);
    Ok(shapes.together(on_error, encode)?.map(|_, (_, coded)| Ok(coded)))
}

/// Reconstructs shapes from their codes, with the distances at `samples` parameters.
///
/// # Errors
/// As [`encode`]; too many samples.
pub fn reconstruct_shapes(
    app: &App,
    ready: &Ready,
    asked: Asked,
    pose: AnswerPose,
    samples: usize,
) -> Result<Outcomes<Reconstruction>, ServiceError> {
    let coded = encode(app, ready, asked)?;
    check_samples(app, samples, coded.len())?;
    let (dictionary, space) = (ready.dictionary(), &ready.setup.space);
    coded.each(&app.pool.context(), |index, coded| {
        dictionary.reconstruct(space, &coded, pose, samples).map_err(|error| of_shape(index, error))
    })
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
/// No codes; under [`OnError::Abort`] all faults of the codes, at `/codes/{index}…`.
pub fn reconstruct_codes(
    app: &App,
    ready: &Ready,
    codes: &[PostedCode],
    on_error: OnError,
) -> Result<Outcomes<Reconstruction>, ServiceError> {
    if codes.is_empty() {
        let detail = format!("expected between 1 and {} codes, got 0", app.limits.shapes);
        return Err(ServiceError::invalid("/codes", detail));
    }
    let fitting = |code| {
        let found = ready.dictionary().fitting(code);
        found.map_err(|faults: Vec<FieldFault>| faults.into_iter().map(Fault::from).collect())
    };
    let fitting = Outcomes::of_list("codes", codes.iter().map(fitting).collect()).checked(on_error)?;
    fitting.each(&app.pool.context(), |_, code| Ok(code.reconstruct()))
}

/// Scores shapes. Among shapes like those of the training, the fraction `1 − quantile` counts as outliers.
///
/// # Errors
/// As [`encode`]; a quantile out of range.
pub fn score(app: &App, ready: &Ready, asked: Asked, quantile: f64) -> Result<Outcomes<Score>, ServiceError> {
    check_quantile(quantile)?;
    let coded = encode(app, ready, asked)?;
    Ok(coded.map(|_, coded| Ok(ready.dictionary().score(&coded, quantile))))
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
fn outlier_warnings(ready: &Ready) -> Vec<String> {
    match ready.dictionary().content.statistics.held_out {
        Some(_) => Vec::new(),
        None => vec![IN_SAMPLE.into()],
    }
}

/// Caveats about the outliers that a dictionary reports, and about the shapes that it was learnt from.
pub fn warnings(ready: &Ready) -> Vec<String> {
    [outlier_warnings(ready), ready.listed.provenance.warnings.clone()].concat()
}

const IN_SAMPLE: &str = "this dictionary has no measures of held-out shapes: outliers and ranks are relative to \
                         the shapes it was learnt from, which it describes better than new shapes, so that more \
                         new shapes are called outliers than the quantile says. Learn it again";

/// Energy and gradient of the shape prior. Points correspond as given: no start point is searched.
///
/// # Errors
/// A fault of `gamma`; a dictionary whose class is not linear; under [`OnError::Abort`] faults of the shapes.
pub fn prior(
    app: &App,
    ready: &Ready,
    asked: Asked,
    reference: Reference,
    gamma: f64,
) -> Result<Outcomes<Energy>, ServiceError> {
    if !(gamma > 0.0 && gamma <= MAX_NUMBER) {
        return Err(ServiceError::invalid(
            "/gamma",
            format!("expected a positive number up to 1e100, got {gamma}"),
        ));
    }
    let prior = ready.dictionary().prior(reference, gamma)?;
    let shapes = asked.control_points(app, ready, Correspondence::Landmarks)?;
    shapes.each(&app.pool.context(), |_, shape| Ok(prior.energy(&shape)))
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
    let Some(mut sampler) = ready.dictionary().sampler(seed, sigma) else {
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
