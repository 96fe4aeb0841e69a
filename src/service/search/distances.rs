//! Matrix of all pairwise distances of a set of shapes: at once if there are few, as a job if there are many.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use tokio::runtime::Handle;

use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::Mirror;
use crate::analysis::elastic::settings::ElasticSettings;
use crate::analysis::factors::Estimator;
use crate::analysis::frame::Frame;
use crate::analysis::transformation::Transformation;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::{Job, JobKind, JobOutput};
use crate::domain::shape::Shape;
use crate::service::app::progress::JobContext;
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::attributes::{FilterPlace, refuse_unknown};
use crate::service::cohorts::caveats;
use crate::service::cohorts::directed;
use crate::service::cohorts::measures;
use crate::service::cohorts::source::StoredShapes;
use crate::service::cohorts::{catalogue, source};
use crate::service::cost::requests::{self, Counts};
use crate::service::jobs::{self, Outcome};
use crate::service::search::pairs::{Compared, GoOn};
use crate::service::shapes::directions::Ways;
use crate::service::shapes::read;
use crate::service::statistics::{CheckedSettings, Settings, Setup};
use crate::store::Revisions;
use crate::wire::fault::Fault;
use crate::wire::json;
use crate::wire::matrix::NamedMatrix;
use crate::wire::shape::ShapeInput;

/// Settings for comparing shapes of a cohort.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Transformations removed before comparison.
    pub transformation: Transformation,
    /// Projection on the class, or Procrustes fits. Default: [`Alignment::usual`].
    pub alignment: Option<Alignment>,
    /// Whether mirror images may be matched. Default: the rule of the cohort.
    pub mirror: Option<Mirror>,
    /// Elastic distances, in place of those modulo the class.
    #[serde(default)]
    pub elastic: Option<ElasticSettings>,
}

impl Comparison {
    /// Complete settings for the shapes of `cohort`.
    pub(crate) fn settings(&self, cohort: &Cohort) -> Settings {
        let usual = Alignment::usual(&self.transformation, cohort.spec.representation.dimension());
        Settings {
            representation: cohort.spec.representation.clone(),
            correspondence: cohort.spec.correspondence,
            direction: cohort.spec.direction,
            mirror: self.mirror.unwrap_or(cohort.spec.mirror),
            transformation: self.transformation.clone(),
            alignment: self.alignment.unwrap_or(usual),
            frame: Frame::default(),
            estimator: Estimator::Plain,
        }
    }
}

/// Selection of shapes of a cohort.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Chosen {
    /// Shapes that pass a filter, in the order of the cohort.
    Filter(Box<ShapeFilter>),
    /// Shapes with these ids or external ids, in this order.
    Ids(Vec<String>),
}

/// Checked request for the matrix of a cohort.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Id of the cohort.
    cohort: String,
    /// Revision of the cohort.
    revision: u64,
    /// Selected shapes.
    chosen: Chosen,
    /// Settings of the comparison.
    comparison: Comparison,
}

/// Answer to a request for the matrix of a cohort.
#[derive(Debug)]
pub enum Answer {
    /// The matrix.
    Matrix(NamedMatrix),
    /// The job that computes it.
    Job(Box<Job>),
}

/// Shapes with the names of their rows.
struct Named {
    ids: Vec<String>,
    labels: Vec<Option<String>>,
    control_points: Vec<f64>,
    /// Field of the request that contains them.
    field: &'static str,
}

/// Distances of posted shapes; rows are named by external ids, or by positions where there are none.
///
/// # Errors
/// Faults of the input; degenerate shapes; more work than a request may take.
pub async fn for_posted(
    app: &App,
    settings: Settings,
    elastic: Option<ElasticSettings>,
    shapes: Vec<ShapeInput>,
) -> Result<NamedMatrix, ServiceError> {
    let settings = settings.checked(&app.limits)?;
    let counts = Counts::new(&settings.representation, shapes.len(), &app.limits);
    let preparing = app.pool.weighing(requests::space(&settings.representation, &app.limits));
    let (task_app, count) = (app.clone(), shapes.len());
    let compared = preparing.run(move || checked_space(&task_app, settings, elastic, count)).await?;
    let work = compared.work(counts, count);
    work.check(app.limits.request_work.as_secs_f64())?;
    let task_app = app.clone();
    app.pool.weighing(work).run(move || matrix_of_posted(&task_app, &compared, shapes)).await
}

/// Space in which posted shapes are compared, provided that they are few enough to be answered at once.
fn checked_space(
    app: &App,
    settings: CheckedSettings,
    elastic: Option<ElasticSettings>,
    count: usize,
) -> Result<Compared, ServiceError> {
    let compared = Compared::new(Setup::new(app, settings)?, elastic)?;
    check_size(app, &compared, count, "/shapes")?;
    let (found, most) = (compared.pairs(count), Compared::most(app));
    if found > most {
        let [found, most] = [found, most].map(Work::seconds);
        let detail = format!(
            "expected at most {most:.1} s of work for all distances, got about {found:.1} s ({count} entries): store the \
             shapes in a cohort, whose distances are computed as a job"
        );
        return Err(ServiceError::invalid("/shapes", detail));
    }
    Ok(compared)
}

fn matrix_of_posted(
    app: &App,
    compared: &Compared,
    shapes: Vec<ShapeInput>,
) -> Result<NamedMatrix, ServiceError> {
    let _room = compared.room(app, shapes.len())?;
    let (ids, labels) = shapes.iter().enumerate().map(posted_names).unzip();
    let control_points = read::read_batch(&compared.setup.reading(&app.limits), shapes)?.control_points;
    let Setup { space, .. } = &compared.setup;
    let mixed = compared.setup.rule().warning(Ways::of_points(space, &control_points));
    let context = app.pool.context();
    let go_on = |_: f64| !context.is_cancelled();
    let mut matrix = matrix_of(compared, Named { ids, labels, control_points, field: "shapes" }, &go_on)?;
    matrix.fields.insert("warnings".into(), mixed.into_iter().collect());
    Ok(matrix)
}

fn posted_names((position, shape): (usize, &ShapeInput)) -> (String, Option<String>) {
    let external_id = shape.external_id.as_ref().and_then(|text| text.get().cloned().flatten());
    let label = shape.label.as_ref().and_then(|text| text.get().cloned().flatten());
    (external_id.unwrap_or_else(|| position.to_string()), label)
}

/// Distances of shapes of the cohort with this key, at its current revision.
///
/// # Errors
/// A cohort or shapes that do not exist; a filter that selects nothing; degenerate shapes; a matrix that is too large;
/// [`ServiceError::Unavailable`] if too many jobs wait.
pub async fn for_cohort(
    app: &App,
    key: &str,
    chosen: Chosen,
    comparison: Comparison,
) -> Result<Answer, ServiceError> {
    let cohort = catalogue::find(app, key).await.map_err(|error| error.named_at("/cohort"))?;
    let count = count(app, &cohort, &chosen).await?;
    let (task_app, settings, field) = (app.clone(), comparison.settings(&cohort), chosen.field());
    let elastic = comparison.elastic;
    let preparing = app.pool.weighing(requests::space(&cohort.spec.representation, &app.limits));
    let compared = preparing
        .run(move || {
            let compared = Compared::new(Setup::of(&task_app, settings)?, elastic).map_err(of_cohort)?;
            check_size(&task_app, &compared, count, field)?;
            Ok(compared)
        })
        .await?;
    if let Chosen::Ids(keys) = &chosen {
        source::find_all(app, &cohort, keys).await?;
    }
    let plan = Plan { cohort: cohort.id.clone(), revision: cohort.revision, chosen, comparison };
    let work = compared.work(Counts::for_cohort(&cohort, &app.limits).with_shapes(count), count);
    if compared.pairs(count) > Compared::most(app) {
        let seconds = work.seconds();
        let parameters = json::to_value(&plan)
            .map_err(|error| ServiceError::Internal(format!("a plan is not JSON: {error}")))?;
        return Ok(Answer::Job(Box::new(jobs::submit(app, JobKind::Distances, parameters, seconds).await?)));
    }
    let (task_app, handle) = (app.clone(), Handle::current());
    let compute = move || {
        let _room = compared.room(&task_app, count)?;
        plan.matrix(&task_app, &handle, (&cohort, &compared), &task_app.pool.context())
    };
    Ok(Answer::Matrix(app.pool.weighing(work).run(compute).await?))
}

impl Chosen {
    fn field(&self) -> &'static str {
        match self {
            Self::Filter(filter) if filter.is_everything() => "/cohort",
            Self::Filter(_) => "/filter",
            Self::Ids(_) => "/ids",
        }
    }
}

/// Number of selected shapes.
async fn count(app: &App, cohort: &Cohort, chosen: &Chosen) -> Result<usize, ServiceError> {
    let count = match chosen {
        Chosen::Ids(ids) => {
            source::refuse_repeated(ids)?;
            return Ok(ids.len());
        }
        Chosen::Filter(filter) => {
            measures::complete_for(app, cohort, filter).await?;
            let count = app.store.count(&cohort.id, Revisions::until(cohort.revision), filter).await?;
            if count == 0 {
                refuse_unknown(app, cohort, filter, FilterPlace::Body("/filter")).await?;
            }
            count
        }
    };
    if count == 0 && chosen.field() == "/filter" {
        return Err(ServiceError::invalid("/filter", "the filter selects no shapes"));
    }
    Ok(usize::try_from(count).unwrap_or(usize::MAX))
}

/// Checks the memory of the matrix and the prepared shapes before it is allocated.
fn check_size(app: &App, compared: &Compared, count: usize, field: &str) -> Result<(), ServiceError> {
    if count == 0 {
        return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
    }
    let bytes = count.saturating_mul(count).saturating_mul(8);
    if bytes > app.limits.matrix_bytes {
        let most = app.limits.matrix_bytes;
        let detail = format!("expected a matrix of at most {most} bytes, got {bytes} for {count} shapes");
        return Err(ServiceError::invalid(field, detail));
    }
    let (needed, most) = (bytes.saturating_add(count.saturating_mul(compared.bytes())), app.limits.job_bytes);
    if needed > most {
        let detail = format!("expected at most {most} bytes of memory, got {needed} for {count} shapes");
        return Err(ServiceError::invalid(field, detail));
    }
    Ok(())
}

/// Result of a job that computes distances; the matrix is stored beside it.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct StoredMatrix {
    /// Id of the cohort.
    pub cohort: String,
    /// Revision of the cohort.
    pub cohort_revision: u64,
    /// Number of rows and columns.
    #[serde(rename = "shape_count")]
    pub shapes: usize,
    /// Path of the matrix.
    pub output: String,
}

/// Runs the job.
///
/// # Errors
/// The reason why the matrix cannot be computed; [`ServiceError::Cancelled`].
pub fn run(app: &App, handle: &Handle, job: &Job, context: &JobContext) -> Result<Outcome, ServiceError> {
    let plan: Plan = json::from_value(&job.parameters)
        .map_err(|error| ServiceError::Internal(format!("the parameters of a job: {error}")))?;
    let cohort = handle.block_on(app.store.find_cohort(&plan.cohort))?;
    let cohort = cohort.ok_or_else(|| ServiceError::NotFound { kind: "cohort", key: plan.cohort.clone() })?;
    let cohort = cohort.at(plan.revision);
    context.report("read", 0.0, None);
    let setup = Setup::of(app, plan.comparison.settings(&cohort))?;
    let compared = Compared::new(setup, plan.comparison.elastic).map_err(of_cohort)?;
    let matrix = plan.matrix(app, handle, (&cohort, &compared), context)?;
    let result = StoredMatrix {
        cohort: cohort.id,
        cohort_revision: plan.revision,
        shapes: matrix.ids.len(),
        output: format!("/v1/jobs/{}/output", job.id),
    };
    let result = json::to_value(&result)
        .map_err(|error| ServiceError::Internal(format!("a result is not JSON: {error}")))?;
    Ok(Outcome { result, dictionary: None, output: Some(Box::new(to_output(matrix)?)) })
}

impl Plan {
    /// Matrix of the cohort at the revision of the plan.
    fn matrix(
        &self,
        app: &App,
        handle: &Handle,
        (cohort, compared): (&Cohort, &Compared),
        context: &JobContext,
    ) -> Result<NamedMatrix, ServiceError> {
        let go_on = |part: f64| {
            context.report("compare", part, None);
            !context.is_cancelled()
        };
        let mut matrix = match &self.chosen {
            Chosen::Ids(keys) => {
                let shapes = handle.block_on(source::find_all(app, cohort, keys))?;
                matrix_of(compared, named(shapes), &go_on)?
            }
            Chosen::Filter(filter) => {
                let stop = || context.is_cancelled();
                let shapes = StoredShapes::new(app, handle, cohort, filter, 0, &compared.setup, &stop)?;
                matrix_of_stored(compared, &shapes, cohort, &go_on)?
            }
        };
        matrix.fields.insert("warnings".into(), Value::from(self.warnings(app, handle, cohort)?));
        matrix.fields.insert("cohort".into(), Value::from(cohort.id.clone()));
        matrix.fields.insert("cohort_revision".into(), Value::from(self.revision));
        Ok(matrix)
    }

    /// Warnings about the shapes.
    fn warnings(&self, app: &App, handle: &Handle, cohort: &Cohort) -> Result<Vec<String>, ServiceError> {
        let mirror = self.comparison.mirror.unwrap_or(cohort.spec.mirror);
        match &self.chosen {
            Chosen::Filter(filter) => handle.block_on(caveats::of_selection(app, cohort, filter, mirror)),
            Chosen::Ids(keys) => {
                handle.block_on(directed::complete(app, cohort))?;
                let shapes = handle.block_on(source::find_all(app, cohort, keys))?;
                Ok(caveats::of_measures(cohort, shapes.iter().map(|shape| &shape.measures), mirror))
            }
        }
    }
}

fn matrix_of_stored(
    compared: &Compared,
    shapes: &StoredShapes<'_>,
    cohort: &Cohort,
    go_on: &GoOn<'_>,
) -> Result<NamedMatrix, ServiceError> {
    let (ids, labels, prepared) = compared.prepare_stored(shapes, cohort)?;
    let prepared = prepared.ok_or(ServiceError::TooFewShapes { found: 0, needed: 1 })?;
    Ok(NamedMatrix { fields: Map::new(), ids, labels, values: compared.matrix(&prepared, go_on)? })
}

fn matrix_of(compared: &Compared, shapes: Named, go_on: &GoOn<'_>) -> Result<NamedMatrix, ServiceError> {
    let Named { ids, labels, control_points, field } = shapes;
    let at = |index: usize| format!("/{field}/{index}");
    let prepared = compared.prepare_given(control_points);
    let prepared = prepared.map_err(|error| ServiceError::from_analysis(error, at))?;
    Ok(NamedMatrix { fields: Map::new(), ids, labels, values: compared.matrix(&prepared, go_on)? })
}

/// The same fault, of the representation of a cohort that the request names.
pub(super) fn of_cohort(error: ServiceError) -> ServiceError {
    match error {
        ServiceError::Invalid(faults) => ServiceError::Invalid(faults.map(|fault| {
            let moves = fault.pointer.starts_with("/representation");
            if moves { Fault { pointer: "/cohort".into(), ..fault } } else { fault }
        })),
        error => error,
    }
}

fn named(shapes: Vec<Shape>) -> Named {
    let mut named = Named { ids: Vec::new(), labels: Vec::new(), control_points: Vec::new(), field: "ids" };
    for shape in shapes {
        named.ids.push(shape.attributes.external_id.unwrap_or(shape.id));
        named.labels.push(shape.attributes.label);
        named.control_points.extend(shape.control_points);
    }
    named
}

/// Names of the rows of a matrix, as stored with a job.
#[derive(Debug, Serialize, Deserialize)]
struct Head {
    fields: Map<String, Value>,
    ids: Vec<String>,
    labels: Vec<Option<String>>,
}

fn to_output(matrix: NamedMatrix) -> Result<JobOutput, ServiceError> {
    let NamedMatrix { fields, ids, labels, values } = matrix;
    let head = json::to_value(&Head { fields, ids, labels })
        .map_err(|error| ServiceError::Internal(format!("a list of names is not JSON: {error}")))?;
    Ok(JobOutput { head, data: values.iter().flat_map(|value| value.to_le_bytes()).collect() })
}

/// Matrix computed by the job with this id.
///
/// # Errors
/// [`ServiceError::NotFound`] if there is no such job, or if it has no matrix.
pub async fn output(app: &App, id: &str) -> Result<NamedMatrix, ServiceError> {
    let (output, _room) = jobs::output(app, id).await?;
    read_output(app, output).await
}

/// Matrix in the output of a job.
///
/// # Errors
/// An output of another kind.
pub async fn read_output(app: &App, output: JobOutput) -> Result<NamedMatrix, ServiceError> {
    app.pool.weighing(Work::reading(output.data.len())).run(move || from_output(output)).await
}

fn from_output(JobOutput { head, data }: JobOutput) -> Result<NamedMatrix, ServiceError> {
    let Head { fields, ids, labels } = json::from_value(&head)
        .map_err(|error| ServiceError::Internal(format!("the output of a job: {error}")))?;
    let (numbers, _) = data.as_chunks();
    let values: Vec<f64> = numbers.iter().map(|number| f64::from_le_bytes(*number)).collect();
    if values.len() != ids.len() * ids.len() {
        return Err(ServiceError::Internal("the output of a job is no square".into()));
    }
    Ok(NamedMatrix { fields, ids, labels, values })
}
