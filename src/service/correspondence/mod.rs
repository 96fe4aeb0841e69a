//! Groupwise correspondence of the surfaces of a cohort: a job whose result is a new cohort.
//!
//! The job reads the shapes as they were at the revision of the request, brings them into correspondence, and stores them in a new
//! cohort in one revision. The cohort is created when everything else is done, and the shapes are added under a receipt of the job
//! by a transaction that requires that the job is still held: once, however often it runs.

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio::runtime::Handle;

use crate::analysis::AnalysisError;
use crate::analysis::correspondence::{Correspondence, Direction};
use crate::analysis::estimate::Estimate;
use crate::analysis::groupwise::{
    self, Groupwise, GroupwiseOptions, MAX_DEGREE, MAX_ROUNDS, STIFFNESS_RANGE,
};
use crate::analysis::rows::rows_of;
use crate::domain::cohort::{Cohort, CohortSpec};
use crate::domain::filter::ShapeFilter;
use crate::domain::job::{Job, JobKind};
use crate::domain::shape::ShapeDescription;
use crate::geometry::reparametrisation::Spherical;
use crate::numeric::dense::Matrix;
use crate::service::app::progress::{JobContext, Meter, Part};
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::selection::Selection;
use crate::service::cohorts::upload::{self, Occasion, Stored, Treatment};
use crate::service::cohorts::{attributes, catalogue};
use crate::service::jobs::{self, Outcome};
use crate::wire::fault::Fault;
use crate::wire::json;
use crate::wire::shape::ShapeInput;
use crate::wire::unit::Unit;

/// Name of the origin of a shape in its metadata.
const ORIGIN: &str = "correspondence";
/// Characters of the digest of the control points.
const DIGEST_CHARS: usize = 32;

/// Checked request, as stored with a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Id of the cohort.
    pub cohort: String,
    /// Revision of the cohort.
    pub revision: u64,
    /// Name of the new cohort.
    pub name: String,
    /// Filter that selects shapes.
    pub filter: ShapeFilter,
    /// Choices of the correspondence.
    pub options: GroupwiseOptions,
}

/// A request for a groupwise correspondence.
#[derive(Debug, Clone)]
pub struct CorrespondRequest {
    /// Name of the new cohort.
    pub name: String,
    /// Filter that selects shapes.
    pub filter: ShapeFilter,
    /// Choices of the correspondence.
    pub options: GroupwiseOptions,
}

/// Result of a groupwise correspondence for one shape.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CorrespondingShape {
    /// Id of the shape in the source cohort.
    pub source: String,
    /// Identifier assigned by the client, the same in both cohorts.
    pub external_id: Option<String>,
    /// Id of the shape in the new cohort.
    pub id: Option<String>,
    /// Root mean square distance between the reparametrised shape and the stored one, over the parameters.
    pub residual: f64,
    /// The same divided by the root mean square distance of the shape from its mean position.
    pub relative_residual: f64,
    /// Fraction of the area of the stored surface whose normal points against that of the given one.
    pub folded: f64,
    /// Smallest ratio of an area on the parameter sphere after the map to that before it; negative where the map folds.
    pub least_jacobian: f64,
    /// Root mean square displacement of the parameters besides the rotation, in radians.
    pub displacement: f64,
}

/// Result of a groupwise correspondence.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct CohortCorrespondence {
    /// Id of the new cohort.
    pub cohort: String,
    /// Its name.
    pub name: String,
    /// Its revision.
    pub revision: u64,
    /// Id of the source cohort.
    pub source: String,
    /// Revision of the source cohort.
    pub source_revision: u64,
    /// Highest degree of the fields.
    pub degree: usize,
    /// Steps of every shape for each degree.
    pub rounds: usize,
    /// Whether sizes were compared.
    pub sizes: bool,
    /// Weight of the deformations.
    pub stiffness: f64,
    /// Digest of the control points of the new cohort, in its order.
    pub digest: String,
    /// Number of shapes.
    pub shape_count: usize,
    /// `Σ log(1 + λ/δ)` of the shapes with rotations of their parameters only, and at the end, both at the last noise `δ`.
    pub entropy: [f64; 2],
    /// Total variance over the area of the parameter sphere, with rotations only, and at the end.
    pub variance: [f64; 2],
    /// Result for each shape, in the order of the source.
    pub shapes: Vec<CorrespondingShape>,
    /// Warnings about the result.
    pub warnings: Vec<String>,
}

/// Folded part of the area, and relative residual, beyond which a warning says so.
const FOLDED: f64 = 0.01;
const RESIDUAL: f64 = 0.05;

/// Checks a request and submits its job.
///
/// # Errors
/// All faults of the request; a cohort whose shapes have no parameters on a sphere; too few shapes; a name that is taken; too much
/// memory; those of [`jobs::submit`].
pub async fn submit(app: &App, key: &str, request: CorrespondRequest) -> Result<Job, ServiceError> {
    app.check_unlimited("creating a cohort")?;
    let mut faults = catalogue::text_faults(Some(&request.name), None, None);
    faults.extend(option_faults(&request.options));
    ServiceError::unless_empty(faults)?;
    if let Some(id) = app.done_before::<String>().await? {
        return jobs::find(app, &id).await;
    }
    let cohort = catalogue::find(app, key).await?;
    let spherical = spherical_of(app, &cohort)?;
    let shapes = attributes::describe(app, &cohort, &request.filter, "/filter").await?;
    if shapes.len() < 2 {
        return Err(ServiceError::TooFewShapes { found: shapes.len(), needed: 2 });
    }
    if app.store.find_cohort(&request.name).await?.is_some() {
        return Err(ServiceError::NameTaken { name: request.name });
    }
    let estimate = Estimate::for_correspondence(&spherical, shapes.len(), &request.options);
    let (bytes, most) = (estimate.memory_bytes, app.limits.job_bytes as f64);
    if bytes > most {
        let detail = format!(
            "expected a job that takes at most {most:.1e} bytes of memory, got {bytes:.1e} for {} shapes: choose \
             fewer shapes",
            shapes.len()
        );
        return Err(ServiceError::invalid("/filter", detail));
    }
    let CorrespondRequest { name, filter, options } = request;
    let plan = Plan { cohort: cohort.id.clone(), revision: cohort.revision, name, filter, options };
    jobs::submit(app, JobKind::Correspond, to_json(&plan)?, estimate.seconds).await
}

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

/// Runs the job.
///
/// # Errors
/// A cohort that was deleted; shapes without extent; a name that was taken meanwhile; [`ServiceError::Cancelled`].
pub fn run(app: &App, handle: &Handle, job: &Job, context: &JobContext) -> Result<Outcome, ServiceError> {
    let plan: Plan = json::from_value(&job.parameters)
        .map_err(|error| ServiceError::Internal(format!("the parameters of a job: {error}")))?;
    let app = app.of_job(job, context);
    let outcome = |result| Outcome { result, dictionary: None, output: None };
    // An attempt that was interrupted after it had added the shapes.
    if let Some(stored) = handle.block_on(app.done_before::<Stored>())? {
        return Ok(outcome(completed(stored)?));
    }
    let source = handle.block_on(catalogue::find(&app, &plan.cohort))?;
    let source = source.at(plan.revision);
    let spherical = spherical_of(&app, &source)?;
    let shapes = handle.block_on(attributes::describe(&app, &source, &plan.filter, "/filter"))?;
    let estimate = Estimate::for_correspondence(&spherical, shapes.len(), &plan.options);
    let count = (shapes.len() * groupwise::rounds(&plan.options)) as f64;
    let meter = Meter::new(context, vec![Part { work: estimate.multiply_adds, count }], 0.0);
    meter.enter(0, "correspond");
    let filters = [plan.filter.clone()];
    let selection = Selection { shapes: &shapes, filters: &filters };
    let (length, stop) = (3 * spherical.size(), || context.is_cancelled());
    let (control_points, weights) = selection.read(&app, handle, &source, length, &stop)?;
    let rows: Vec<Matrix> =
        control_points.chunks_exact(length).map(|x| Matrix::from_column_slice(length / 3, 3, x)).collect();
    let found = groupwise::correspond(&spherical, &rows, &plan.options, &meter);
    let found = found.map_err(|error| match error {
        AnalysisError::Interrupted => ServiceError::Cancelled,
        other => selection.named(other.into(), &source.spec.name),
    })?;
    context.report("store", 1.0, None);
    let answer = answer_of(&plan, &shapes, &found);
    let inputs: Vec<ShapeInput> = (0..shapes.len())
        .map(|k| input_of(&job.id, &source, (&shapes[k], weights[k]), &found, k))
        .collect::<Result<_, _>>()?;
    let note = to_json(&answer)?;
    let stored = handle.block_on(store(&app, job, &source, &plan, inputs, note))?;
    Ok(outcome(completed(stored)?))
}

/// Creates the cohort and adds the shapes; the cohort is removed again if they cannot be added.
async fn store(
    app: &App,
    job: &Job,
    source: &Cohort,
    plan: &Plan,
    inputs: Vec<ShapeInput>,
    mut note: Value,
) -> Result<Stored, ServiceError> {
    let description = format!(
        "Shapes of '{}' ({}) at revision {} in groupwise correspondence, by {}",
        source.spec.name, source.id, source.revision, job.id
    );
    let spec = CohortSpec {
        name: plan.name.clone(),
        description: Some(description.clone()),
        correspondence: Correspondence::Landmarks,
        direction: Direction::Given,
        length_unit: source.spec.length_unit.clone().filter(|unit| Unit::find(unit).is_some()),
        ..source.spec.clone()
    };
    let existing = app.store.find_cohort(&plan.name).await?;
    let cohort = match existing {
        // Of an attempt that was interrupted before it had added the shapes.
        Some(cohort) if cohort.revision == 0 && cohort.spec.description.as_ref() == Some(&description) => {
            cohort
        }
        _ => catalogue::create(&app.clone().with_retry(None), spec).await?,
    };
    note["cohort"] = json!(cohort.id);
    let occasion = Occasion { note: Some(note), job: Some(job.clone()), ..Occasion::default() };
    let id = cohort.id.clone();
    let added = upload::add_as(app, cohort, inputs, Treatment::default(), None, occasion).await;
    if added.is_err() {
        // The reason why the shapes could not be added counts.
        let _ = catalogue::delete(&app.clone().with_retry(None), &id, None).await;
    }
    added
}

/// The answer, with the ids and the revision of the stored shapes.
fn completed(stored: Stored) -> Result<Value, ServiceError> {
    let lost = || ServiceError::Internal("a receipt without its answer".into());
    let mut answer = stored.note.ok_or_else(lost)?;
    answer["revision"] = json!(stored.revision);
    let shapes = answer.get_mut("shapes").and_then(Value::as_array_mut).ok_or_else(lost)?;
    for (shape, result) in shapes.iter_mut().zip(stored.results) {
        shape["id"] = json!(result.id);
    }
    Ok(answer)
}

fn answer_of(plan: &Plan, shapes: &[ShapeDescription], found: &Groupwise) -> CohortCorrespondence {
    let mut digest = blake3::Hasher::new();
    for member in &found.members {
        member.refit.rows.as_slice().iter().for_each(|x| {
            digest.update(&x.to_le_bytes());
        });
    }
    let members = shapes.iter().zip(&found.members);
    let of = |(shape, member): (&ShapeDescription, &groupwise::Corresponding)| CorrespondingShape {
        source: shape.id.clone(),
        external_id: shape.external_id.clone(),
        id: None,
        residual: member.refit.residual,
        relative_residual: member.refit.relative_residual,
        folded: member.refit.folded,
        least_jacobian: member.least_jacobian,
        displacement: member.map.displacement(),
    };
    let list: Vec<CorrespondingShape> = members.map(of).collect();
    CohortCorrespondence {
        cohort: String::new(),
        name: plan.name.clone(),
        revision: 0,
        source: plan.cohort.clone(),
        source_revision: plan.revision,
        degree: plan.options.degree,
        rounds: plan.options.rounds,
        sizes: plan.options.sizes,
        stiffness: plan.options.stiffness,
        digest: digest.finalize().to_hex().as_str()[..DIGEST_CHARS].to_owned(),
        shape_count: list.len(),
        entropy: found.entropy,
        variance: found.variance,
        warnings: warnings_of(&list),
        shapes: list,
    }
}

fn warnings_of(shapes: &[CorrespondingShape]) -> Vec<String> {
    let mut warnings = Vec::new();
    let folded = shapes.iter().filter(|shape| shape.folded > FOLDED).count();
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

/// A shape of the new cohort, as if it were posted by its control points.
fn input_of(
    job: &str,
    source: &Cohort,
    (shape, weight): (&ShapeDescription, f64),
    found: &Groupwise,
    k: usize,
) -> Result<ShapeInput, ServiceError> {
    let member = &found.members[k];
    let map = &member.map;
    let origin = json!({
        "job": job,
        "cohort": source.id,
        "revision": source.revision,
        "shape": shape.id,
        "residual": member.refit.residual,
        "folded": member.refit.folded,
        "outer_rotation": map.outer.0,
        "inner_rotation": map.inner.0,
        "degree": map.degree(),
        "coefficients": map.coefficients(),
    });
    let body = json!({
        "control_points": rows_of(member.refit.rows.as_slice(), 3),
        "external_id": shape.external_id,
        "subject": shape.subject,
        "label": shape.label,
        "labels": shape.labels,
        "weight": weight,
        "metadata": {ORIGIN: origin},
    });
    let text = serde_json::to_vec(&body).map_err(|error| ServiceError::Internal(error.to_string()))?;
    serde_json::from_slice(&text)
        .map_err(|error| ServiceError::Internal(format!("a corresponding shape: {error}")))
}

fn to_json(value: &impl Serialize) -> Result<Value, ServiceError> {
    json::to_value(value).map_err(|error| ServiceError::Internal(format!("not JSON: {error}")))
}
