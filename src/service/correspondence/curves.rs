//! Elastic correspondence of curves.

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::{CohortCorrespondence, CorrespondingShape, Made, Task};
use crate::analysis::AnalysisError;
use crate::analysis::alignment::{Alignment, MeanShape};
use crate::analysis::correspondence::{Correspondence, Direction};
use crate::analysis::elastic::curve::{ElasticCurve, FEWEST};
use crate::analysis::elastic::refit::ElasticRefit;
use crate::analysis::elastic::settings::ElasticSettings;
use crate::analysis::elastic::space::{ElasticMatch, ElasticSpace};
use crate::analysis::elastic::template::medoids;
use crate::analysis::estimate::Estimate;
use crate::analysis::factors::Estimator;
use crate::analysis::frame::Frame;
use crate::analysis::robust::align_all_by;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::domain::cohort::Cohort;
use crate::geometry::representation::Representation;
use crate::numeric::parallel;
use crate::service::app::progress::{Meter, Part};
use crate::service::app::{App, ServiceError};
use crate::service::shapes::read;
use crate::service::statistics::{Settings, Setup};
use crate::wire::fault::Fault;

/// Most starts of a mean.
const MOST_STARTS: usize = 20;
/// Rounds of a mean after which its progress stands still; most end earlier.
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

    /// Representation of the new curves.
    fn representation(&self, app: &App, cohort: &Cohort) -> Result<Representation, ServiceError> {
        let own = &cohort.spec.representation;
        let Some(count) = self.control_points else { return Ok(own.clone()) };
        let refused = |detail: String| ServiceError::invalid("/control_points", detail);
        if count < FEWEST {
            return Err(refused(format!("expected at least {FEWEST}, got {count}")));
        }
        let wanted = own.with_count(count);
        let admitted = read::admit_linear(wanted.clone(), &app.limits);
        admitted.map_err(|faults| refused(faults[0].detail.clone())).map(|_| wanted)
    }
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
    let size = options.representation(app, cohort)?.size();
    Ok(Estimate::for_elastic(&space, shapes, options.starts, size))
}

/// Brings the curves of a job into correspondence.
pub(super) fn correspond(task: &Task<'_>, options: &ElasticOptions) -> Result<Made, ServiceError> {
    let (app, source) = (task.app, task.source);
    let own = &source.spec.representation;
    let representation = options.representation(app, source)?;
    let space = space_of(app, source, options)?;
    let length = own.size() * own.dimension();
    let (control_points, weights) = task.read(length)?;
    let (before, mean) = variance(task, own, true, control_points.clone(), &weights)?;
    let named = |error: AnalysisError| task.selection.named(error.into(), &source.spec.name);
    let curves = space.prepare(&control_points).map_err(|error| of_curve(task, error))?;
    let starts = starts(task, &space, &mean, &curves, options)?;
    let estimate = Estimate::for_elastic(&space, curves.len(), options.starts, representation.size());
    let part = Part { work: estimate.multiply_adds, count: (ROUNDS * starts.len()) as f64 };
    let meter = Meter::new(task.context, vec![part], 0.0);
    meter.enter(0, "correspond");
    let go_on = |round: usize| {
        meter.worked(usize::from(round < ROUNDS));
        !task.context.is_cancelled()
    };
    let found = space.mean(&curves, &starts, &go_on).map_err(named)?;
    drop(curves);
    let target = app.space_of(&representation)?;
    let refits: Vec<ElasticRefit> = parallel::try_map(found.matches.len(), &|k| {
        space.refit(&control_points[k * length..(k + 1) * length], &found.matches[k], &target)
    })
    .map_err(named)?;
    let rows: Vec<Vec<f64>> =
        refits.iter().map(|refit| refit.curve.control_points.as_slice().to_vec()).collect();
    let (after, _) = variance(task, &representation, false, rows.concat(), &weights)?;
    let of = |(shape, (matched, refit)): (_, (&ElasticMatch, &ElasticRefit))| CorrespondingShape {
        residual: refit.curve.residual,
        relative_residual: refit.curve.relative_residual,
        distance: Some(matched.distance),
        largest_residual: Some(refit.curve.largest),
        start: Some(matched.places[0]),
        reversed: Some(matched.reversed),
        mirrored: Some(matched.mirrored),
        slopes: Some(refit.slopes),
        ..CorrespondingShape::of(shape)
    };
    let made = found.matches.iter().zip(&refits);
    let shapes: Vec<CorrespondingShape> = task.selection.shapes.iter().zip(made).map(of).collect();
    let answer = CohortCorrespondence {
        rounds: found.history.len(),
        variance: [before, after],
        elasticity: Some(options.elastic.elasticity),
        points: Some(options.elastic.points),
        starts: Some(starts.len()),
        objective: Some(found.objective),
        warnings: warnings_of(&shapes, [before, after]),
        shapes,
        ..CohortCorrespondence::default()
    };
    let origins = found.matches.iter().map(origin_of).collect();
    Ok(Made { answer, representation, rows, weights, origins })
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
) -> Result<(f64, MeanShape), ServiceError> {
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
    let found =
        align_all_by(setup.estimator, setup.measured(), setup.frame, control_points, weights.to_vec(), &stop);
    let (mean, aligned) = found.map_err(|error| task.selection.named(error.into(), &spec.name))?;
    let norm: f64 = mean.whitened.iter().map(|x| x * x).sum();
    let left: f64 = aligned.iter().zip(weights).map(|(shape, w)| w * shape.residual.powi(2)).sum();
    Ok((left / (weights.iter().sum::<f64>() * norm), mean))
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

fn warnings_of(shapes: &[CorrespondingShape], [before, after]: [f64; 2]) -> Vec<String> {
    let mut warnings = Vec::new();
    let all = shapes.len();
    if after > before {
        warnings.push(format!(
            "positions vary more than with searched starts ({after:.2e} after {before:.2e}): elastic matches compare directions, not \
             positions, and suit features and retrieval rather than few components"
        ));
    }
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
