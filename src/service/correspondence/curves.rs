//! Correspondence of curves: elastic, or by points that slide along them.

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::{CohortCorrespondence, CorrespondingShape, Made, Task};
use crate::analysis::AnalysisError;
use crate::analysis::alignment::{Alignment, MeanShape};
use crate::analysis::correspondence::{Correspondence, Direction};
use crate::analysis::elastic::curve::{ElasticCurve, FEWEST};
use crate::analysis::elastic::settings::ElasticSettings;
use crate::analysis::elastic::space::{ElasticMatch, ElasticSpace};
use crate::analysis::elastic::template::medoids;
use crate::analysis::estimate::Estimate;
use crate::analysis::factors::Estimator;
use crate::analysis::frame::Frame;
use crate::analysis::sliding::SlidingCriterion;
use crate::analysis::sliding::along::{BOUNDS, slide_along};
use crate::analysis::sliding::error::SlidingError;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::domain::cohort::Cohort;
use crate::domain::shape::ShapeDescription;
use crate::geometry::curve::Curve;
use crate::geometry::reparametrisation::LineRefit;
use crate::geometry::representation::Representation;
use crate::numeric::dense::Matrix;
use crate::numeric::parallel;
use crate::service::app::progress::{Meter, Part};
use crate::service::app::{App, ServiceError};
use crate::service::shapes::read;
use crate::service::statistics::{Settings, Setup};
use crate::wire::fault::Fault;

/// Most starts of a mean.
const MOST_STARTS: usize = 20;
/// Rounds that a mean, and sliding, usually take at most.
const ROUNDS: usize = 60;
/// Relative residual, and slopes, beyond which a warning says so.
const RESIDUAL: f64 = 0.01;
const SLOPES: [f64; 2] = [0.05, 20.0];

/// Choices of an elastic correspondence.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ElasticOptions {
    /// Weights and thoroughness of the matches.
    pub elastic: ElasticSettings,
    /// Number of starts of the mean: the mean with searched starts, then curves that stand for the others.
    pub starts: usize,
    /// Number of control points or intervals of the new curves. Default: as many as those of the cohort.
    pub control_points: Option<usize>,
}

impl ElasticOptions {
    /// Faults of the choices.
    pub(super) fn faults(&self) -> Vec<Fault> {
        let mut faults = Vec::new();
        faults.extend(elastic_faults(&self.elastic));
        if !(1..=MOST_STARTS).contains(&self.starts) {
            let detail = format!("expected a number between 1 and {MOST_STARTS}, got {}", self.starts);
            faults.push(Fault::new("/starts", detail));
        }
        faults
    }
}

/// Choices of a correspondence by sliding.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SlidingOptions {
    /// Criterion that sliding minimises.
    pub criterion: SlidingCriterion,
    /// Number of steps between points along a curve.
    pub points: usize,
    /// Number of control points or intervals of the new curves. Default: as many as those of the cohort.
    pub control_points: Option<usize>,
}

/// Representation of the new curves.
fn representation(app: &App, cohort: &Cohort, count: Option<usize>) -> Result<Representation, ServiceError> {
    let own = &cohort.spec.representation;
    let Some(count) = count else { return Ok(own.clone()) };
    let refused = |detail: String| ServiceError::invalid("/control_points", detail);
    if count < FEWEST {
        return Err(refused(format!("expected at least {FEWEST}, got {count}")));
    }
    let wanted = own.with_count(count);
    let admitted = read::admit_linear(wanted.clone(), &app.limits);
    admitted.map_err(|faults| refused(faults[0].detail.clone())).map(|_| wanted)
}

/// Faults of the settings of elastic matches.
pub(crate) fn elastic_faults(settings: &ElasticSettings) -> Option<Fault> {
    match settings.checked() {
        Err(AnalysisError::Parameter { field, detail }) => Some(Fault::new(format!("/{field}"), detail)),
        _ => None,
    }
}

/// Curves of a cohort as they are compared.
fn space_of(app: &App, cohort: &Cohort, options: &ElasticOptions) -> Result<ElasticSpace, ServiceError> {
    let space = app.space_of(&cohort.spec.representation)?;
    let (direction, mirror) = (cohort.spec.direction, cohort.spec.mirror);
    ElasticSpace::new(&space, direction, mirror, options.elastic).map_err(|error| match error {
        AnalysisError::Parameter { field: "representation", detail } => {
            ServiceError::parameter("cohort", detail)
        }
        other => other.into(),
    })
}

/// Predicted cost of the correspondence of some shapes.
pub(super) fn estimate(
    app: &App,
    cohort: &Cohort,
    shapes: usize,
    options: &ElasticOptions,
) -> Result<Estimate, ServiceError> {
    let space = space_of(app, cohort, options)?;
    let size = representation(app, cohort, options.control_points)?.size();
    Ok(Estimate::for_elastic(&space, shapes, options.starts, size))
}

/// Predicted cost of the sliding of some shapes.
pub(super) fn sliding_estimate(
    app: &App,
    cohort: &Cohort,
    shapes: usize,
    options: &SlidingOptions,
) -> Result<Estimate, ServiceError> {
    let space = app.space_of(&cohort.spec.representation)?;
    if !space.domain().is_line() {
        let detail = format!(
            "expected a cohort of curves with the method \"sliding\", those of '{}' are none",
            cohort.spec.name
        );
        return Err(ServiceError::parameter("cohort", detail));
    }
    let size = representation(app, cohort, options.control_points)?.size();
    Ok(Estimate::for_sliding(shapes, (options.points, options.criterion), size))
}

/// Curves of a job as they are given.
struct Given {
    control_points: Vec<f64>,
    weights: Vec<f64>,
    /// Variance with searched starts, and the mean.
    variance: f64,
    mean: MeanShape,
}

impl Given {
    fn read(task: &Task<'_>) -> Result<Self, ServiceError> {
        let own = &task.source.spec.representation;
        let (control_points, weights) = task.read(own.size() * own.dimension())?;
        let (mean, variance) = variance(task, own, true, control_points.clone(), &weights)?;
        Ok(Self { control_points, weights, variance, mean })
    }

    /// The curves.
    fn curves(&self, task: &Task<'_>) -> Result<Vec<Curve>, ServiceError> {
        let own = &task.source.spec.representation;
        let space = task.app.space_of(own)?;
        let curve =
            |shape: &[f64]| Curve::of(&space, &Matrix::from_column_slice(own.size(), own.dimension(), shape));
        let curves = self.control_points.chunks_exact(own.size() * own.dimension()).map(curve);
        curves.collect::<Option<_>>().ok_or_else(|| ServiceError::Internal("curves without a curve".into()))
    }
}

/// Curves at the places of their points, as shapes of the new cohort.
struct Followed {
    representation: Representation,
    refits: Vec<(LineRefit, [f64; 2])>,
    rows: Vec<Vec<f64>>,
    variance: f64,
}

impl Followed {
    fn new(
        task: &Task<'_>,
        given: &Given,
        representation: Representation,
        (curves, places): (&[Curve], &[&[f64]]),
    ) -> Result<Self, ServiceError> {
        let target = task.app.space_of(&representation)?;
        let refits: Vec<(LineRefit, [f64; 2])> = parallel::try_map(places.len(), &|k| {
            task.context.check()?;
            let found = LineRefit::along(&curves[k], places[k], &target);
            found.map_err(|error| ServiceError::Internal(format!("a curve at new places: {error}")))
        })?;
        let rows: Vec<Vec<f64>> =
            refits.iter().map(|(refit, _)| refit.control_points.as_slice().to_vec()).collect();
        let (_, variance) = variance(task, &representation, false, rows.concat(), &given.weights)?;
        Ok(Self { representation, refits, rows, variance })
    }

    /// The answer for each shape, without what one method alone finds.
    fn shapes(&self, task: &Task<'_>, places: &[&[f64]]) -> Vec<CorrespondingShape> {
        let closed = self.representation.is_closed();
        let of = |(k, shape): (usize, &ShapeDescription)| {
            let (refit, slopes) = &self.refits[k];
            CorrespondingShape {
                residual: refit.residual,
                relative_residual: refit.relative_residual,
                largest_residual: Some(refit.largest),
                start: Some(if closed { places[k][0].rem_euclid(1.0) } else { places[k][0] }),
                reversed: Some(places[k][1] < places[k][0]),
                slopes: Some(*slopes),
                ..CorrespondingShape::of(shape)
            }
        };
        task.selection.shapes.iter().enumerate().map(of).collect()
    }
}

/// Brings the curves of a job into elastic correspondence.
pub(super) fn correspond(task: &Task<'_>, options: &ElasticOptions) -> Result<Made, ServiceError> {
    let (app, source) = (task.app, task.source);
    let representation = representation(app, source, options.control_points)?;
    let space = space_of(app, source, options)?;
    let given = Given::read(task)?;
    let named = |error: AnalysisError| task.selection.named(error.into(), &source.spec.name);
    let curves = space.prepare(&given.control_points).map_err(|error| of_curve(task, error))?;
    let starts = starts(task, &space, &given.mean, &curves, options)?;
    let estimate = Estimate::for_elastic(&space, curves.len(), options.starts, representation.size());
    let part = Part { work: estimate.multiply_adds, count: (ROUNDS * starts.len()) as f64 };
    let meter = Meter::new(task.context, vec![part], 0.0);
    meter.enter(0, "correspond");
    let go_on = |_: usize| {
        meter.worked(1);
        !task.context.is_cancelled()
    };
    let found = space.mean(&curves, &starts, &go_on).map_err(named)?;
    drop(curves);
    let places: Vec<&[f64]> = found.matches.iter().map(|one| one.places.as_slice()).collect();
    let followed = Followed::new(task, &given, representation, (&given.curves(task)?, &places))?;
    let mut shapes = followed.shapes(task, &places);
    for (shape, one) in shapes.iter_mut().zip(&found.matches) {
        (shape.distance, shape.mirrored) = (Some(one.distance), Some(one.mirrored));
    }
    let variance = [given.variance, followed.variance];
    let mut warnings = warnings_of(&shapes);
    if variance[1] > variance[0] {
        warnings.insert(0, format!(
            "positions vary more than with searched starts ({:.2e} after {:.2e}): elastic matches compare directions, not positions, and \
             suit features and retrieval rather than few components",
            variance[1], variance[0]
        ));
    }
    let answer = CohortCorrespondence {
        rounds: found.history.len(),
        variance,
        elasticity: Some(options.elastic.elasticity),
        points: Some(options.elastic.points),
        starts: Some(starts.len()),
        objective: Some(found.objective),
        warnings,
        shapes,
        ..CohortCorrespondence::default()
    };
    let origins = found.matches.iter().map(origin_of).collect();
    let Followed { representation, rows, .. } = followed;
    Ok(Made { answer, representation, rows, weights: given.weights, origins })
}

/// Slides points along the curves of a job.
pub(super) fn slide(task: &Task<'_>, options: &SlidingOptions) -> Result<Made, ServiceError> {
    let representation = representation(task.app, task.source, options.control_points)?;
    let given = Given::read(task)?;
    let curves = given.curves(task)?;
    let estimate =
        Estimate::for_sliding(curves.len(), (options.points, options.criterion), representation.size());
    let part = Part { work: estimate.multiply_adds, count: ROUNDS as f64 };
    let meter = Meter::new(task.context, vec![part], 0.0);
    meter.enter(0, "correspond");
    let placements = &given.mean.placements;
    let found = slide_along(&curves, placements, (options.points, options.criterion), &meter);
    let found = found.map_err(|error| of_sliding(task, error))?;
    let places: Vec<&[f64]> = found.places.iter().map(Vec::as_slice).collect();
    let followed = Followed::new(task, &given, representation, (&curves, &places))?;
    let mut shapes = followed.shapes(task, &places);
    for (shape, placement) in shapes.iter_mut().zip(placements) {
        shape.mirrored = Some(placement.mirrored);
    }
    let mut warnings = warnings_of(&shapes);
    if !found.converged {
        warnings.push(format!("the points still slid after {} rounds", found.rounds));
    }
    if found.bounded > 0 {
        let [least, most] = BOUNDS;
        warnings.push(format!(
            "points of {} of {} curves would pass each other or leave gaps: their steps are kept between {least} and {most} of equal \
             ones",
            found.bounded,
            shapes.len()
        ));
    }
    let answer = CohortCorrespondence {
        rounds: found.rounds,
        variance: [given.variance, followed.variance],
        points: Some(options.points),
        criterion: Some(options.criterion),
        converged: Some(found.converged),
        warnings,
        shapes,
        ..CohortCorrespondence::default()
    };
    let single = |places: &Vec<f64>| places.iter().map(|t| *t as f32).collect::<Vec<f32>>();
    let origins = found.places.iter().map(|places| json!({ "places": single(places) })).collect();
    let Followed { representation, rows, .. } = followed;
    Ok(Made { answer, representation, rows, weights: given.weights, origins })
}

/// A fault of sliding curves, by the name of the shape.
fn of_sliding(task: &Task<'_>, error: SlidingError) -> ServiceError {
    let shape = match error {
        SlidingError::Cancelled => return ServiceError::Cancelled,
        SlidingError::NoExtent { shape }
        | SlidingError::NoDirection { shape, .. }
        | SlidingError::Free { shape } => shape,
        _ => return ServiceError::invalid("/filter", error.to_string()),
    };
    let fault = Fault::new("", error.to_string()).at_shape(shape);
    task.selection.named(ServiceError::DegenerateShape(vec![fault]), &task.source.spec.name)
}

/// A fault of a curve, by the name of its shape.
fn of_curve(task: &Task<'_>, error: AnalysisError) -> ServiceError {
    let AnalysisError::Unsuitable { index, detail } = error else { return error.into() };
    let fault = Fault::new("", detail).at_shape(index);
    task.selection.named(ServiceError::DegenerateShape(vec![fault]), &task.source.spec.name)
}

/// The mean with searched starts, and curves that stand for the others.
fn starts(
    task: &Task<'_>,
    space: &ElasticSpace,
    mean: &MeanShape,
    curves: &[ElasticCurve],
    options: &ElasticOptions,
) -> Result<Vec<ElasticCurve>, ServiceError> {
    let mut starts = space.prepare(&mean.control_points).map_err(|_| {
        let detail =
            "expected curves whose mean has a length, got a mean without: choose shapes that are alike";
        ServiceError::invalid("/filter", detail)
    })?;
    if options.starts > 1 {
        let go_on = |part: f64| {
            task.context.report("compare", part, None);
            !task.context.is_cancelled()
        };
        let matrix = space.matrix(curves, &go_on)?;
        starts.extend(medoids(&matrix, options.starts - 1).into_iter().map(|k| curves[k].clone()));
    }
    Ok(starts)
}

/// Variance of some curves after similarities, relative to their mean, and the mean; `given`: as the cohort holds them, with searched
/// starts of closed curves.
fn variance(
    task: &Task<'_>,
    representation: &Representation,
    given: bool,
    control_points: Vec<f64>,
    weights: &[f64],
) -> Result<(MeanShape, f64), ServiceError> {
    let spec = &task.source.spec;
    let transformation = Transformation::Named(ClassName::Similarity);
    let alignment = Alignment::usual(&transformation, representation.dimension());
    let correspondence = match given {
        true if representation.is_closed() => Correspondence::Cyclic,
        true => spec.correspondence,
        false => Correspondence::Landmarks,
    };
    let settings = Settings {
        representation: representation.clone(),
        correspondence,
        direction: if given { spec.direction } else { Direction::Given },
        mirror: spec.mirror,
        transformation,
        alignment,
        frame: Frame::default(),
        estimator: Estimator::Plain,
    };
    let setup = Setup::of(task.app, settings)?;
    let stop = || task.context.is_cancelled();
    let found = setup.mean_and_variance(control_points, weights, &stop);
    found.map_err(|error| task.selection.named(error, &spec.name))
}

/// What the metadata of a stored shape say about its parameters.
fn origin_of(found: &ElasticMatch) -> Value {
    let places: Vec<f32> = found.places.iter().map(|t| *t as f32).collect();
    json!({
        "distance": found.distance,
        "mirrored": found.mirrored,
        "reversed": found.reversed,
        "rotation": found.rotation,
        "places": places,
    })
}

fn warnings_of(shapes: &[CorrespondingShape]) -> Vec<String> {
    let mut warnings = Vec::new();
    let all = shapes.len();
    let far = shapes.iter().filter(|shape| shape.relative_residual > RESIDUAL).count();
    if far > 0 {
        warnings.push(format!(
            "{far} of {all} curves are represented with an error of more than {:.0} % of their extent: choose more control points",
            100.0 * RESIDUAL
        ));
    }
    let [least, most] = SLOPES;
    let steep =
        |shape: &&CorrespondingShape| shape.slopes.is_some_and(|[low, high]| low < least || high > most);
    let steep = shapes.iter().filter(steep).count();
    if steep > 0 {
        warnings.push(format!(
            "{steep} of {all} curves are stretched or compressed more than twentyfold somewhere: choose a smaller elasticity"
        ));
    }
    warnings
}
