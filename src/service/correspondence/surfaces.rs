//! Groupwise correspondence of surfaces.

use serde_json::{Value, json};

use super::{CohortCorrespondence, CorrespondingShape, Made, Task};
use crate::analysis::AnalysisError;
use crate::analysis::estimate::Estimate;
use crate::analysis::groupwise::{
    self, Corresponding, GroupwiseOptions, MAX_DEGREE, MAX_ROUNDS, STIFFNESS_RANGE,
};
use crate::domain::cohort::Cohort;
use crate::geometry::reparametrisation::Spherical;
use crate::numeric::dense::Matrix;
use crate::service::app::progress::{Meter, Part};
use crate::service::app::{App, ServiceError};
use crate::wire::fault::Fault;

/// Folded part of the area, and relative residual, beyond which a warning says so.
const FOLDED: f64 = 0.01;
const RESIDUAL: f64 = 0.05;

/// Faults of the choices.
pub(crate) fn option_faults(options: &GroupwiseOptions) -> Vec<Fault> {
    let mut faults = Vec::new();
    if options.degree > MAX_DEGREE {
        let detail = format!("expected a number between 0 and {MAX_DEGREE}, got {}", options.degree);
        faults.push(Fault::new("/degree", detail));
    }
    if !(1..=MAX_ROUNDS).contains(&options.rounds) {
        let detail = format!("expected a number between 1 and {MAX_ROUNDS}, got {}", options.rounds);
        faults.push(Fault::new("/rounds", detail));
    }
    let [least, most] = STIFFNESS_RANGE;
    if !(least..=most).contains(&options.stiffness) {
        let detail = format!("expected a number between {least:e} and {most:e}, got {}", options.stiffness);
        faults.push(Fault::new("/stiffness", detail));
    }
    faults
}

/// The shapes of a cohort as functions on a sphere.
fn spherical_of(app: &App, cohort: &Cohort) -> Result<Spherical, ServiceError> {
    let space = app.space_of(&cohort.spec.representation)?;
    space.spherical().ok_or_else(|| {
        let detail = format!(
            "expected a cohort of surfaces with the topology sphere, those of '{}' have no parameters on a sphere",
            cohort.spec.name
        );
        ServiceError::parameter("cohort", detail)
    })
}

/// Predicted cost of the correspondence of some shapes.
pub(super) fn estimate(
    app: &App,
    cohort: &Cohort,
    shapes: usize,
    options: &GroupwiseOptions,
) -> Result<Estimate, ServiceError> {
    Ok(Estimate::for_correspondence(&spherical_of(app, cohort)?, shapes, options))
}

/// Brings the surfaces of a job into correspondence.
pub(super) fn correspond(task: &Task<'_>, options: &GroupwiseOptions) -> Result<Made, ServiceError> {
    let spherical = spherical_of(task.app, task.source)?;
    let shapes = task.selection.shapes;
    let work = Estimate::for_correspondence(&spherical, shapes.len(), options).multiply_adds;
    let count = (shapes.len() * groupwise::rounds(options)) as f64;
    let meter = Meter::new(task.context, vec![Part { work, count }], 0.0);
    meter.enter(0, "correspond");
    let length = 3 * spherical.size();
    let (control_points, weights) = task.read(length)?;
    let rows: Vec<Matrix> =
        control_points.chunks_exact(length).map(|x| Matrix::from_column_slice(length / 3, 3, x)).collect();
    let found = groupwise::correspond(&spherical, &rows, options, &meter);
    let found = found.map_err(|error| match error {
        AnalysisError::Interrupted => ServiceError::Cancelled,
        other => task.selection.named(other.into(), &task.source.spec.name),
    })?;
    let of = |(shape, member): (_, &Corresponding)| CorrespondingShape {
        residual: member.refit.residual,
        relative_residual: member.refit.relative_residual,
        folded: Some(member.refit.folded),
        least_jacobian: Some(member.least_jacobian),
        displacement: Some(member.map.displacement()),
        ..CorrespondingShape::of(shape)
    };
    let list: Vec<CorrespondingShape> = shapes.iter().zip(&found.members).map(of).collect();
    let answer = CohortCorrespondence {
        degree: Some(options.degree),
        rounds: options.rounds,
        sizes: Some(options.sizes),
        stiffness: Some(options.stiffness),
        entropy: Some(found.entropy),
        variance: found.variance,
        warnings: warnings_of(&list),
        shapes: list,
        ..CohortCorrespondence::default()
    };
    let origins = found.members.iter().map(origin_of).collect();
    let rows = found.members.iter().map(|member| member.refit.rows.as_slice().to_vec()).collect();
    Ok(Made { answer, representation: task.source.spec.representation.clone(), rows, weights, origins })
}

/// What the metadata of a stored shape say about its parameters.
fn origin_of(member: &Corresponding) -> Value {
    let map = &member.map;
    json!({
        "folded": member.refit.folded,
        "outer_rotation": map.outer.0,
        "inner_rotation": map.inner.0,
        "degree": map.degree(),
        "coefficients": map.coefficients(),
    })
}

fn warnings_of(shapes: &[CorrespondingShape]) -> Vec<String> {
    let mut warnings = Vec::new();
    let folded = shapes.iter().filter(|shape| shape.folded.is_some_and(|part| part > FOLDED)).count();
    if folded > 0 {
        warnings.push(format!(
            "{folded} of {} surfaces fold over more than {:.0} % of their area: choose a larger stiffness or a \
             smaller degree",
            shapes.len(),
            100.0 * FOLDED
        ));
    }
    let far = shapes.iter().filter(|shape| shape.relative_residual > RESIDUAL).count();
    if far > 0 {
        warnings.push(format!(
            "{far} of {} surfaces are represented with an error of more than {:.0} % of their extent: choose more \
             control points",
            shapes.len(),
            100.0 * RESIDUAL
        ));
    }
    warnings
}
