//! Correspondence of the shapes of a cohort: a job whose result is a new cohort. Surfaces move on the sphere of their parameters, curves
//! along their length.
//!
//! The job reads the shapes as they were at the revision of the request, brings them into correspondence, and stores them in a new
//! cohort in one revision. The cohort is created when everything else is done, and the shapes are added under a receipt of the job
//! by a transaction that requires that the job is still held: once, however often it runs.

mod curves;
mod surfaces;

pub(crate) use curves::elastic_faults;
pub use curves::{ElasticOptions, SlidingOptions};
pub(crate) use surfaces::option_faults;

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio::runtime::Handle;

use crate::analysis::correspondence::{Correspondence, Direction};
use crate::analysis::estimate::Estimate;
use crate::analysis::groupwise::GroupwiseOptions;
use crate::analysis::rows::rows_of;
use crate::analysis::sliding::SlidingCriterion;
use crate::domain::cohort::{Cohort, CohortSpec};
use crate::domain::filter::ShapeFilter;
use crate::domain::job::{Job, JobKind};
use crate::domain::shape::ShapeDescription;
use crate::geometry::representation::Representation;
use crate::service::app::progress::JobContext;
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

/// How shapes are brought into correspondence.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum CorrespondMethod {
    /// Surfaces with the topology `sphere`, whose parameters move on the sphere.
    Groupwise,
    /// Curves, whose parameters follow the elastic mean.
    Elastic,
    /// Curves, along which points slide to the positions of the mean: few components describe them.
    Sliding,
}

/// Choices of a method.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
enum Options {
    Groupwise(GroupwiseOptions),
    Elastic(ElasticOptions),
    Sliding(SlidingOptions),
}

/// Checked request, as stored with a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Id of the cohort.
    cohort: String,
    /// Revision of the cohort.
    revision: u64,
    /// Name of the new cohort.
    name: String,
    /// Filter that selects shapes.
    filter: ShapeFilter,
    /// Choices of the correspondence.
    options: Options,
}

/// A request for a correspondence.
#[derive(Debug, Clone)]
pub struct CorrespondRequest {
    /// Name of the new cohort.
    pub name: String,
    /// Filter that selects shapes.
    pub filter: ShapeFilter,
    /// The method, unless it is that of the kind of shapes.
    pub method: Option<CorrespondMethod>,
    /// Fields that belong to one method, of those that are given.
    pub given: Vec<(&'static str, &'static [CorrespondMethod])>,
    /// Choices for surfaces.
    pub groupwise: GroupwiseOptions,
    /// Choices for curves.
    pub elastic: ElasticOptions,
    /// Criterion of points that slide, whose other choices are those for curves.
    pub criterion: SlidingCriterion,
}

/// Result of a correspondence for one shape.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
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
    /// `groupwise`: fraction of the area of the stored surface whose normal points against that of the given one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub folded: Option<f64>,
    /// `groupwise`: smallest ratio of an area on the parameter sphere after the map to that before it; negative where the map folds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub least_jacobian: Option<f64>,
    /// `groupwise`: root mean square displacement of the parameters besides the rotation, in radians.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub displacement: Option<f64>,
    /// `elastic`: distance from the elastic mean, 0 to π/2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub distance: Option<f64>,
    /// Curves: largest distance between the reparametrised curve and the stored one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub largest_residual: Option<f64>,
    /// Curves: place of the given curve, as a fraction of its length, at which the stored one begins.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<f64>,
    /// Curves: whether the stored curve is traversed in the other direction.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reversed: Option<bool>,
    /// Curves: whether the mirror image of the curve is matched; the stored curve is not mirrored.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mirrored: Option<bool>,
    /// Curves: smallest and largest slope of the fraction of the length by the new parameter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slopes: Option<[f64; 2]>,
}

/// Result of a correspondence.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
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
    /// `groupwise`: highest degree of the fields.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub degree: Option<usize>,
    /// `groupwise`: steps of every shape for each degree; `elastic`: rounds of the mean; `sliding`: rounds.
    pub rounds: usize,
    /// `groupwise`: whether sizes were compared.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sizes: Option<bool>,
    /// `groupwise`: weight of the deformations.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness: Option<f64>,
    /// Digest of the control points of the new cohort, in its order.
    pub digest: String,
    /// Number of shapes.
    pub shape_count: usize,
    /// `groupwise`: `Σ log(1 + λ/δ)` of the shapes with rotations of their parameters only, and at the end, both at the last noise `δ`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub entropy: Option<[f64; 2]>,
    /// Total variance before, and at the end. `groupwise`: over the area of the parameter sphere, with rotations only before. Curves:
    /// after similarities, relative to the mean, with searched starts before.
    pub variance: [f64; 2],
    /// `elastic`: weight of bending against stretching.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub elasticity: Option<f64>,
    /// Curves: number of segments into which they were divided.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub points: Option<usize>,
    /// `elastic`: number of starts of the mean.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub starts: Option<usize>,
    /// `elastic`: mean cosine of the distances from the elastic mean, which is a local maximum of it: 1 if all curves are copies.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub objective: Option<f64>,
    /// `sliding`: the criterion.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub criterion: Option<SlidingCriterion>,
    /// `sliding`: whether the last round left the points as they were.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub converged: Option<bool>,
    /// Result for each shape, in the order of the source.
    pub shapes: Vec<CorrespondingShape>,
    /// Warnings about the result.
    pub warnings: Vec<String>,
}

/// Shapes that a job brings into correspondence.
struct Task<'a> {
    app: &'a App,
    handle: &'a Handle,
    context: &'a JobContext,
    source: &'a Cohort,
    selection: Selection<'a>,
}

/// What a method makes of them.
struct Made {
    /// The answer, without what is the same for all methods.
    answer: CohortCorrespondence,
    /// Representation of the new shapes.
    representation: Representation,
    /// Control points of the new shapes, coordinate-major.
    rows: Vec<Vec<f64>>,
    weights: Vec<f64>,
    /// What their metadata say about their parameters.
    origins: Vec<Value>,
}

impl Task<'_> {
    /// Control points, `length` numbers a shape, and weights.
    fn read(&self, length: usize) -> Result<(Vec<f64>, Vec<f64>), ServiceError> {
        let stop = || self.context.is_cancelled();
        self.selection.read(self.app, self.handle, self.source, length, &stop)
    }
}

impl CorrespondingShape {
    /// The entry of a shape, without results.
    fn of(shape: &ShapeDescription) -> Self {
        Self { source: shape.id.clone(), external_id: shape.external_id.clone(), ..Self::default() }
    }
}

impl CorrespondMethod {
    /// Name in requests.
    fn name(self) -> &'static str {
        match self {
            Self::Groupwise => "groupwise",
            Self::Elastic => "elastic",
            Self::Sliding => "sliding",
        }
    }
}

impl Options {
    fn method(&self) -> CorrespondMethod {
        match self {
            Self::Groupwise(_) => CorrespondMethod::Groupwise,
            Self::Elastic(_) => CorrespondMethod::Elastic,
            Self::Sliding(_) => CorrespondMethod::Sliding,
        }
    }

    /// Predicted cost for some shapes of a cohort.
    fn estimate(&self, app: &App, cohort: &Cohort, shapes: usize) -> Result<Estimate, ServiceError> {
        match self {
            Self::Groupwise(options) => surfaces::estimate(app, cohort, shapes, options),
            Self::Elastic(options) => curves::estimate(app, cohort, shapes, options),
            Self::Sliding(options) => curves::sliding_estimate(app, cohort, shapes, options),
        }
    }

    fn correspond(&self, task: &Task<'_>) -> Result<Made, ServiceError> {
        match self {
            Self::Groupwise(options) => surfaces::correspond(task, options),
            Self::Elastic(options) => curves::correspond(task, options),
            Self::Sliding(options) => curves::slide(task, options),
        }
    }
}

/// Checks a request and submits its job.
///
/// # Errors
/// All faults of the request; a cohort whose shapes the method does not know; too few shapes; a name that is taken; too much memory;
/// those of [`jobs::submit`].
pub async fn submit(app: &App, key: &str, request: CorrespondRequest) -> Result<Job, ServiceError> {
    app.check_unlimited("creating a cohort")?;
    let mut faults = catalogue::text_faults(Some(&request.name), None, None);
    faults.extend(option_faults(&request.groupwise));
    faults.extend(request.elastic.faults());
    ServiceError::unless_empty(faults)?;
    if let Some(id) = app.done_before::<String>().await? {
        return jobs::find(app, &id).await;
    }
    let cohort = catalogue::find(app, key).await?;
    let options = request.options(&cohort)?;
    // Shapes that the method does not know are refused before they are counted.
    options.estimate(app, &cohort, 2)?;
    let shapes = attributes::describe(app, &cohort, &request.filter, "/filter").await?;
    if shapes.len() < 2 {
        return Err(ServiceError::TooFewShapes { found: shapes.len(), needed: 2 });
    }
    if app.store.find_cohort(&request.name).await?.is_some() {
        return Err(ServiceError::NameTaken { name: request.name });
    }
    let estimate = options.estimate(app, &cohort, shapes.len())?;
    let (bytes, most) = (estimate.memory_bytes, app.limits.job_bytes as f64);
    if bytes > most {
        let detail = format!(
            "expected a job that takes at most {most:.1e} bytes of memory, got {bytes:.1e} for {} shapes: choose \
             fewer shapes",
            shapes.len()
        );
        return Err(ServiceError::invalid("/filter", detail));
    }
    let CorrespondRequest { name, filter, .. } = request;
    let plan = Plan { cohort: cohort.id.clone(), revision: cohort.revision, name, filter, options };
    jobs::submit(app, JobKind::Correspond, to_json(&plan)?, estimate.seconds).await
}

impl CorrespondRequest {
    /// The choices of the method, which is that of the kind of shapes unless one is given.
    ///
    /// # Errors
    /// Fields of the other method.
    fn options(&self, cohort: &Cohort) -> Result<Options, ServiceError> {
        let usual = match cohort.spec.representation.domain().is_line() {
            true => CorrespondMethod::Elastic,
            false => CorrespondMethod::Groupwise,
        };
        let method = self.method.unwrap_or(usual);
        let misplaced = self.given.iter().filter(|(_, of)| !of.contains(&method));
        let fault = |(field, _): &(&'static str, _)| {
            let name = method.name();
            Fault::new(*field, format!("expected no value with the method \"{name}\", got one"))
        };
        ServiceError::unless_empty(misplaced.map(fault).collect())?;
        Ok(match method {
            CorrespondMethod::Groupwise => Options::Groupwise(self.groupwise),
            CorrespondMethod::Elastic => Options::Elastic(self.elastic),
            CorrespondMethod::Sliding => Options::Sliding(SlidingOptions {
                criterion: self.criterion,
                points: self.elastic.elastic.points,
                control_points: self.elastic.control_points,
            }),
        })
    }
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
    let shapes = handle.block_on(attributes::describe(&app, &source, &plan.filter, "/filter"))?;
    let filters = [plan.filter.clone()];
    let selection = Selection { shapes: &shapes, filters: &filters };
    let task = Task { app: &app, handle, context, source: &source, selection };
    let made = plan.options.correspond(&task)?;
    context.report("store", 1.0, None);
    let inputs: Vec<ShapeInput> = (0..shapes.len())
        .map(|k| input_of(&job.id, &source, &shapes[k], &made, k))
        .collect::<Result<_, _>>()?;
    let Made { answer, representation, rows, .. } = made;
    let note = to_json(&answer_of(&plan, answer, &rows))?;
    let stored = handle.block_on(store(&app, job, &source, &plan, (representation, inputs), note))?;
    Ok(outcome(completed(stored)?))
}

/// Creates the cohort and adds the shapes; the cohort is removed again if they cannot be added.
async fn store(
    app: &App,
    job: &Job,
    source: &Cohort,
    plan: &Plan,
    (representation, inputs): (Representation, Vec<ShapeInput>),
    mut note: Value,
) -> Result<Stored, ServiceError> {
    let description = format!(
        "Shapes of '{}' ({}) at revision {} in {} correspondence, by {}",
        source.spec.name,
        source.id,
        source.revision,
        plan.options.method().name(),
        job.id
    );
    let spec = CohortSpec {
        name: plan.name.clone(),
        representation,
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

/// The answer with what is the same for all methods.
fn answer_of(plan: &Plan, answer: CohortCorrespondence, rows: &[Vec<f64>]) -> CohortCorrespondence {
    let mut digest = blake3::Hasher::new();
    rows.iter().flatten().for_each(|x| {
        digest.update(&x.to_le_bytes());
    });
    CohortCorrespondence {
        name: plan.name.clone(),
        source: plan.cohort.clone(),
        source_revision: plan.revision,
        digest: digest.finalize().to_hex().as_str()[..DIGEST_CHARS].to_owned(),
        shape_count: answer.shapes.len(),
        ..answer
    }
}

/// A shape of the new cohort, as if it were posted by its control points.
fn input_of(
    job: &str,
    source: &Cohort,
    shape: &ShapeDescription,
    made: &Made,
    k: usize,
) -> Result<ShapeInput, ServiceError> {
    let mut origin = made.origins[k].clone();
    origin["job"] = json!(job);
    origin["cohort"] = json!(source.id);
    origin["revision"] = json!(source.revision);
    origin["shape"] = json!(shape.id);
    origin["residual"] = json!(made.answer.shapes[k].residual);
    let body = json!({
        "control_points": rows_of(&made.rows[k], made.representation.dimension()),
        "external_id": shape.external_id,
        "subject": shape.subject,
        "label": shape.label,
        "labels": shape.labels,
        "weight": made.weights[k],
        "metadata": {ORIGIN: origin},
    });
    let text = serde_json::to_vec(&body).map_err(|error| ServiceError::Internal(error.to_string()))?;
    serde_json::from_slice(&text)
        .map_err(|error| ServiceError::Internal(format!("a corresponding shape: {error}")))
}

fn to_json(value: &impl Serialize) -> Result<Value, ServiceError> {
    json::to_value(value).map_err(|error| ServiceError::Internal(format!("not JSON: {error}")))
}
