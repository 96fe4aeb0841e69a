//! Assessments of the shapes of a cohort that pass a filter, as lines of JSON: at once if they are few, otherwise by a job.
//!
//! Shapes are read in batches and assessed in blocks of `BLOCK_SHAPES`; a job stores its lines in parts of `PART_BYTES` as it
//! goes. Memory holds two batches, a block and a part, however many shapes there are. On request the assessments are stored
//! beside the shapes too.

use std::sync::Arc;

use serde::{Deserialize, Serialize};
use tokio::runtime::Handle;

use super::answers::{AssessmentOutput, ByDictionary, UsedDictionary};
use super::classify;
use super::coding::{self, Asked};
use super::ready::{self, Ready};
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::{Job, JobKind, JobOutput, OutputParts};
use crate::service::app::progress::JobContext;
use crate::service::app::{App, ServiceError, Work, now_ms};
use crate::service::cohorts::attributes::{FilterPlace, refuse_unknown};
use crate::service::cohorts::source::StoredShapes;
use crate::service::cohorts::{catalogue, measures};
use crate::service::jobs::inline_or_job::AT_ONCE_SECONDS;
use crate::service::jobs::{self, Outcome};
use crate::service::shapes::names::InputNames;
use crate::service::shapes::outcome::{ShapeError, of_shape};
use crate::store::{AssessmentRun, NewAssessment, Revisions, ScanBatch};
use crate::wire::fault::Fault;
use crate::wire::json;

/// Shapes assessed between two looks at cancellation.
const BLOCK_SHAPES: usize = 256;
/// Size from which lines are stored as a part: a fraction of a second to store, small beside a batch.
const PART_BYTES: usize = 1 << 20;
/// Predicted size of the lines that are answered at once; more become a job.
const AT_ONCE_BYTES: usize = 8 << 20;
/// Size of a line without its numbers, and of a number, as text.
const LINE_BYTES: usize = 800;
const NUMBER_BYTES: usize = 20;

/// Shapes to assess, and how.
#[derive(Debug, Clone)]
pub struct AssessCohort {
    /// Id or name of the cohort.
    pub cohort: String,
    /// Filter that the shapes pass.
    pub filter: ShapeFilter,
    /// Training quantile beyond which a shape is an outlier or of no class.
    pub quantile: f64,
    /// Number of parameters at which the residual is returned.
    pub samples: usize,
    /// Whether the assessments are stored beside the shapes.
    pub store: bool,
}

/// Checked request, as stored with a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Plan {
    /// Id of the cohort.
    cohort: String,
    /// Revision of the cohort.
    revision: u64,
    filter: ShapeFilter,
    /// Id of the version of the dictionary.
    dictionary: String,
    quantile: f64,
    samples: usize,
    /// Jobs of earlier versions stored none.
    #[serde(default)]
    store: bool,
}

/// A checked request and its objects.
#[derive(Debug)]
pub struct Planned {
    plan: Plan,
    ready: Arc<Ready>,
    cohort: Cohort,
    shapes: usize,
    work: Work,
}

/// Lines of a request that was answered at once.
#[derive(Debug)]
pub struct Lines {
    /// One line per shape, in the order of the cohort.
    pub text: Vec<u8>,
    /// Revision of the cohort.
    pub revision: u64,
}

/// Result of a job that assesses the shapes of a cohort; the lines are stored beside it.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct AssessedCohort {
    /// Id of the cohort.
    cohort: String,
    /// Revision of the cohort.
    cohort_revision: u64,
    /// The dictionary, at the version that was used.
    dictionary: UsedDictionary,
    /// Number of shapes, each of which has a line.
    shape_count: usize,
    /// Number of outliers among them.
    outlier_count: usize,
    /// Number of shapes without an assessment.
    error_count: usize,
    /// Number of assessments stored beside the shapes.
    stored_count: u64,
    /// Path of the lines.
    output: String,
}

/// A stored shape with its assessment.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct AssessedStored {
    /// Id of the shape.
    id: String,
    /// Identifier assigned by the client, if the shape has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    external_id: Option<String>,
    #[serde(flatten)]
    assessment: AssessmentOutput,
    #[serde(flatten)]
    common: ByDictionary,
}

/// A stored shape without an assessment.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct FailedStored {
    /// Id of the shape.
    id: String,
    /// Identifier assigned by the client, if the shape has one.
    #[serde(skip_serializing_if = "Option::is_none")]
    external_id: Option<String>,
    /// Reason.
    error: ShapeError,
    #[serde(flatten)]
    common: ByDictionary,
}

/// Line of a shape of a cohort: its assessment, or the reason why there is none.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[serde(untagged)]
pub enum CohortAssessment {
    /// With an assessment.
    Assessed(Box<AssessedStored>),
    /// Without an assessment.
    Failed(Box<FailedStored>),
}

/// Lines as they are written, and their part that is stored beside the shapes.
#[derive(Debug, Default)]
struct Piece {
    text: Vec<u8>,
    kept: Vec<NewAssessment>,
}

/// An assessment as it is stored beside a shape.
#[derive(Serialize)]
struct Body<'a> {
    #[serde(flatten)]
    assessment: &'a AssessmentOutput,
    #[serde(flatten)]
    common: &'a ByDictionary,
}

/// Counts of assessed shapes.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    shapes: usize,
    outliers: usize,
    errors: usize,
}

/// Checks a request, and predicts its work.
///
/// # Errors
/// A dictionary or cohort that does not exist, or that do not fit each other; a quantile or number of samples out of bounds; a
/// filter that selects no shapes.
pub async fn plan(app: &App, key: &str, asked: AssessCohort) -> Result<Planned, ServiceError> {
    let ready = ready::find(app, key).await?;
    let cohort = catalogue::find(app, &asked.cohort).await.map_err(|error| error.named_at("/cohort"))?;
    let mut faults = Vec::new();
    if let Some(detail) = coding::misfit(&ready, &cohort) {
        faults.push(Fault::new("/cohort", detail));
    }
    if !(0.5..1.0).contains(&asked.quantile) {
        let detail = format!("expected a number of at least 0.5 and below 1, got {}", asked.quantile);
        faults.push(Fault::new("/quantile", detail));
    }
    let most = app.limits.samples / BLOCK_SHAPES;
    if asked.samples > most {
        let detail = format!("expected at most {most} distances for each shape, got {}", asked.samples);
        faults.push(Fault::new("/samples", detail));
    }
    ServiceError::unless_empty(faults)?;
    let shapes = count(app, &cohort, &asked.filter).await?;
    let work = ready.work(shapes, asked.samples, &app.limits);
    let AssessCohort { filter, quantile, samples, store, .. } = asked;
    let (id, revision, dictionary) = (cohort.id.clone(), cohort.revision, ready.listed.id.clone());
    let plan = Plan { cohort: id, revision, filter, dictionary, quantile, samples, store };
    Ok(Planned { plan, ready, cohort, shapes, work })
}

/// Number of shapes that pass the filter.
async fn count(app: &App, cohort: &Cohort, filter: &ShapeFilter) -> Result<usize, ServiceError> {
    measures::complete_for(app, cohort, filter).await?;
    let count = app.store.count(&cohort.id, Revisions::until(cohort.revision), filter).await?;
    if count == 0 {
        refuse_unknown(app, cohort, filter, FilterPlace::Body("/filter")).await?;
        if *filter == ShapeFilter::default() {
            return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
        }
        let detail = "expected a filter that selects at least one shape, got one that selects none";
        return Err(ServiceError::invalid("/filter", detail));
    }
    Ok(usize::try_from(count).unwrap_or(usize::MAX))
}

impl Planned {
    /// Whether it is answered at once.
    pub fn is_quick(&self) -> bool {
        let numbers = self.plan.samples + self.ready.dictionary().model.len();
        let bytes = self.shapes.saturating_mul(LINE_BYTES + NUMBER_BYTES * numbers);
        self.work.seconds() <= AT_ONCE_SECONDS && bytes <= AT_ONCE_BYTES
    }

    /// Computes the lines at once.
    ///
    /// # Errors
    /// [`ServiceError::Cancelled`]; a cohort or dictionary that was deleted meanwhile, if assessments are stored.
    pub async fn lines(self, app: &App) -> Result<Lines, ServiceError> {
        let (task_app, handle) = (app.clone(), Handle::current());
        let (plan, work) = (self.plan.clone(), self.work);
        let compute = move || {
            let mut all = Piece::default();
            let mut keep = |piece: &mut Piece| {
                all.text.append(&mut piece.text);
                all.kept.append(&mut piece.kept);
                Ok(())
            };
            self.write(&task_app, &handle, &task_app.pool.context(), &mut keep)?;
            Ok(all)
        };
        let Piece { text, kept } = app.pool.weighing(work).run(compute).await?;
        if plan.store && app.store.store_assessments(&plan.run(None), &kept, now_ms()).await?.is_none() {
            return Err(ServiceError::NotFound { kind: "dictionary", key: plan.dictionary });
        }
        Ok(Lines { text, revision: plan.revision })
    }

    /// Submits the job that stores the lines as its output.
    ///
    /// # Errors
    /// [`ServiceError::Unavailable`] if too many jobs wait.
    pub async fn submit(&self, app: &App) -> Result<Job, ServiceError> {
        let parameters = json::to_value(&self.plan)
            .map_err(|error| ServiceError::Internal(format!("a plan is not JSON: {error}")))?;
        jobs::submit(app, JobKind::Assess, parameters, self.work.seconds()).await
    }

    /// Passes the lines of all shapes to `keep`, which empties them, part by part.
    fn write(
        &self,
        app: &App,
        handle: &Handle,
        context: &JobContext,
        keep: &mut dyn FnMut(&mut Piece) -> Result<(), ServiceError>,
    ) -> Result<Tally, ServiceError> {
        let Self { plan, ready, cohort, .. } = self;
        let stop = || context.is_cancelled();
        let setup = &ready.setup;
        let stored = StoredShapes::new(app, handle, cohort, &plan.filter, 0, setup, &stop)?;
        let common = ByDictionary::with_warnings(ready);
        let (mut tally, mut piece) = (Tally::default(), Piece::default());
        stored.for_each_named(&mut |batch| {
            for first in (0..batch.ids.len()).step_by(BLOCK_SHAPES) {
                context.check()?;
                let asked = block(batch, first, setup.metric.len());
                self.write_block(app, asked, &common, &mut piece, &mut tally)?;
                context.report("assess", tally.shapes as f64 / self.shapes.max(1) as f64, None);
                if piece.text.len() >= PART_BYTES {
                    keep(&mut piece)?;
                }
            }
            Ok(())
        })?;
        if !piece.text.is_empty() {
            keep(&mut piece)?;
        }
        Ok(tally)
    }

    /// Writes the lines of a block.
    fn write_block(
        &self,
        app: &App,
        asked: Asked,
        common: &ByDictionary,
        piece: &mut Piece,
        tally: &mut Tally,
    ) -> Result<(), ServiceError> {
        let (plan, ready) = (&self.plan, &self.ready);
        let names = asked.names.clone();
        let assessed = classify::assess(app, ready, asked, (plan.quantile, plan.samples), None)?;
        let assessed = assessed.map(|index, assessment| {
            AssessmentOutput::new(ready, assessment).map_err(|error| of_shape(index, error))
        });
        for (names, outcome) in names.into_iter().zip(assessed.into_vec()) {
            let (id, external_id, common) = (names.id.unwrap_or_default(), names.external_id, common.clone());
            tally.shapes += 1;
            let line = match outcome {
                Ok(assessment) => {
                    tally.outliers += usize::from(assessment.is_outlier());
                    if plan.store {
                        piece.kept.push(kept(&id, &assessment, &common)?);
                    }
                    CohortAssessment::Assessed(Box::new(AssessedStored {
                        id,
                        external_id,
                        assessment,
                        common,
                    }))
                }
                Err(ServiceError::Cancelled) => return Err(ServiceError::Cancelled),
                Err(error) => {
                    tally.errors += 1;
                    let error = alone(error).into();
                    CohortAssessment::Failed(Box::new(FailedStored { id, external_id, error, common }))
                }
            };
            serde_json::to_writer(&mut piece.text, &line)
                .map_err(|error| ServiceError::Internal(format!("a line is not JSON: {error}")))?;
            piece.text.push(b'\n');
        }
        Ok(())
    }
}

impl Plan {
    /// The shapes to assess, for the store.
    fn run<'a>(&'a self, job: Option<&'a Job>) -> AssessmentRun<'a> {
        AssessmentRun { cohort: &self.cohort, dictionary: &self.dictionary, revision: self.revision, job }
    }
}

/// An assessment to be stored beside its shape.
fn kept(
    shape: &str,
    assessment: &AssessmentOutput,
    common: &ByDictionary,
) -> Result<NewAssessment, ServiceError> {
    let body = serde_json::to_string(&Body { assessment, common })
        .map_err(|error| ServiceError::Internal(format!("an assessment is not JSON: {error}")))?;
    let (class, is_outlier) = (assessment.accepted_class().map(Into::into), assessment.is_outlier());
    Ok(NewAssessment { shape: shape.to_owned(), class, is_outlier, body })
}

/// Shapes of a batch from `first` on, as far as a block goes.
fn block(batch: &ScanBatch, first: usize, width: usize) -> Asked {
    let end = batch.ids.len().min(first + BLOCK_SHAPES);
    let name =
        |k: usize| InputNames { id: Some(batch.ids[k].clone()), external_id: batch.external_ids[k].clone() };
    let points = &batch.control_points[first * width..end * width];
    Asked::read((first..end).map(name).collect(), points.chunks_exact(width).map(<[f64]>::to_vec).collect())
}

/// The error of a shape that is not an entry of a list.
fn alone(error: ServiceError) -> ServiceError {
    let place = |fault: Fault| {
        let prefix = fault.index.map(|index| format!("/shapes/{index}")).unwrap_or_default();
        let pointer = fault.pointer.strip_prefix(&prefix).unwrap_or(&fault.pointer).to_owned();
        Fault { pointer, index: None, ..fault }
    };
    match error {
        ServiceError::Invalid(faults) => ServiceError::Invalid(faults.map(place)),
        ServiceError::DegenerateShape(faults) => {
            ServiceError::DegenerateShape(faults.into_iter().map(place).collect())
        }
        other => other,
    }
}

/// Runs the job.
///
/// # Errors
/// A cohort or dictionary that was deleted meanwhile; [`ServiceError::Cancelled`], also if the job was taken over.
pub fn run(app: &App, handle: &Handle, job: &Job, context: &JobContext) -> Result<Outcome, ServiceError> {
    let plan: Plan = json::from_value(&job.parameters)
        .map_err(|error| ServiceError::Internal(format!("the parameters of a job: {error}")))?;
    let planned = handle.block_on(restored(app, plan))?;
    handle.block_on(app.store.clear_output_parts(&job.id))?;
    let (mut parts, mut stored) = (OutputParts { attempt: job.attempt, count: 0, bytes: 0 }, 0);
    let shapes = planned.plan.run(Some(job));
    let mut keep = |piece: &mut Piece| {
        let Piece { text, kept } = std::mem::take(piece);
        if !handle.block_on(app.store.add_output_part(job, parts.count, &text))? {
            return Err(ServiceError::Cancelled);
        }
        (parts.count, parts.bytes) = (parts.count + 1, parts.bytes + text.len() as u64);
        let added = handle.block_on(app.store.store_assessments(&shapes, &kept, now_ms()))?;
        stored += added.ok_or(ServiceError::Cancelled)?;
        Ok(())
    };
    let tally = planned.write(app, handle, context, &mut keep)?;
    let result = AssessedCohort {
        cohort: planned.plan.cohort.clone(),
        cohort_revision: planned.plan.revision,
        dictionary: UsedDictionary::new(&planned.ready),
        shape_count: tally.shapes,
        outlier_count: tally.outliers,
        error_count: tally.errors,
        stored_count: stored,
        output: format!("/v1/jobs/{}/output", job.id),
    };
    let result = json::to_value(&result)
        .map_err(|error| ServiceError::Internal(format!("a result is not JSON: {error}")))?;
    Ok(Outcome { result, dictionary: None, output: Some(Box::new(JobOutput::in_parts(parts))) })
}

/// The request of a stored plan.
async fn restored(app: &App, plan: Plan) -> Result<Planned, ServiceError> {
    let cohort = catalogue::find(app, &plan.cohort).await?;
    let cohort = cohort.at(plan.revision);
    let ready = ready::find(app, &plan.dictionary).await?;
    let shapes = app.store.count(&cohort.id, Revisions::until(plan.revision), &plan.filter).await?;
    let shapes = usize::try_from(shapes).unwrap_or(usize::MAX);
    let work = ready.work(shapes, plan.samples, &app.limits);
    Ok(Planned { plan, ready, cohort, shapes, work })
}
