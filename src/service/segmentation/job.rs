//! Segmentations that take long: jobs with the files of their request.
//!
//! The files are stored with the job, because it survives a restart and runs on any replica, and are removed by the transaction that
//! ends it. Attracting shapes of the store are kept with them as they were when the request was made. Objects for a cohort are added under a
//! receipt of the job, by a transaction that requires that the job is still held: once, however often it runs, and never after it
//! was cancelled.

use bytes::Bytes;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use tokio::runtime::Handle;

use super::membership::{self, Digests, Membership, Origin, Repeated};
use super::parts::{FILES, PARAMETERS, Parts};
use super::posted::{CohortSegmentRequest, SegmentRequest, Storing};
use super::reference::Stored;
use super::shown::Shown;
use crate::domain::access::Role;
use crate::domain::cohort::Cohort;
use crate::domain::job::{Job, JobKind, JobOutput};
use crate::service::app::progress::JobContext;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::catalogue::{self, Expected, revision_tag};
use crate::service::cohorts::lengths::Lengths;
use crate::service::cohorts::upload::Stored as Uploaded;
use crate::service::jobs::inline_or_job::AT_ONCE_SECONDS;
use crate::service::jobs::{self, Outcome};
use crate::wire::json;

/// Name of the attracting shapes among the files of a job.
const ATTRACTING: &str = "attracting";

/// Plan of a job, beside its files.
#[derive(Debug, Serialize, Deserialize)]
struct Plan {
    /// Id of the cohort that the objects go into.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    cohort: Option<String>,
    /// Revision that the cohort must have.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    revision: Option<u64>,
    /// How the objects are shown.
    shown: Shown,
    /// Digests of the parts.
    digests: Digests,
    /// External ids and subjects of the objects: an erasure looks for them here.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    names: Vec<String>,
    /// Bytes of all files.
    bytes: usize,
}

/// Whether a segmentation of so many predicted seconds becomes a job: if it takes long, or if the caller `prefers` one. Readers store
/// nothing, jobs neither.
pub fn is_due(app: &App, seconds: f64, prefers: bool) -> bool {
    app.principal.role >= Role::Writer && (prefers || seconds > AT_ONCE_SECONDS)
}

/// As [`is_due`], for a job of no cohort, which a caller that is limited to cohorts would not see.
pub fn is_due_without_cohort(app: &App, seconds: f64, prefers: bool) -> bool {
    app.principal.cohorts.is_none() && is_due(app, seconds, prefers)
}

/// A job to be submitted.
#[derive(Debug)]
pub struct Submission<'a> {
    /// The parts of the request.
    pub parts: &'a Parts,
    /// Attracting shapes of the store.
    pub attracting: Option<&'a Stored>,
    /// How the objects are shown.
    pub shown: Shown,
    /// Predicted memory in bytes.
    pub memory_bytes: usize,
    /// Predicted seconds.
    pub seconds: f64,
}

impl Submission<'_> {
    /// Submits the job; a repetition of the same request returns the job that it created.
    ///
    /// # Errors
    /// A fault at `/image` if it needs too much memory; those of [`jobs::submit`].
    pub async fn submit(self, app: &App) -> Result<Job, ServiceError> {
        let digests = Digests::of(app, self.parts.clone()).await?;
        let app = app.clone().with_body(digests.text().as_bytes());
        if let Some(id) = app.done_before::<String>().await? {
            return jobs::find(&app, &id).await;
        }
        let plan =
            Plan { cohort: None, revision: None, shown: self.shown, digests, names: Vec::new(), bytes: 0 };
        self.create(&app, plan, |id| app.receipt(id)).await
    }

    /// Submits the job that adds the objects to a cohort. The `app` has the digests of the parts as its body.
    ///
    /// # Errors
    /// As [`Self::submit`].
    pub async fn submit_members(
        self,
        app: &App,
        membership: &Membership,
        names: Vec<String>,
    ) -> Result<Job, ServiceError> {
        let plan = Plan {
            cohort: Some(membership.cohort.id.clone()),
            revision: membership.expected.as_ref().map(|_| membership.cohort.revision),
            shown: self.shown,
            digests: membership.digests.clone(),
            names,
            bytes: 0,
        };
        // A request that adds the objects at once under the same key understands this receipt.
        let receipt = |id: &str| {
            app.receipt(Uploaded { note: Some(membership::note_of_job(id)), ..Uploaded::default() })
        };
        self.create(app, plan, receipt).await
    }

    async fn create(
        self,
        app: &App,
        plan: Plan,
        receipt: impl FnOnce(&str) -> Option<crate::domain::retry::Receipt>,
    ) -> Result<Job, ServiceError> {
        let attracting = self.attracting.map(to_json).transpose()?.map(|value| value.to_string());
        let named = self.parts.named();
        let mut files: Vec<(&str, &[u8])> = named.iter().map(|(name, part)| (*name, &part[..])).collect();
        files.extend(attracting.as_ref().map(|text| (ATTRACTING, text.as_bytes())));
        let bytes: usize = files.iter().map(|(_, file)| file.len()).sum();
        let (needed, most) = (self.memory_bytes.saturating_add(bytes), app.limits.job_bytes);
        if needed > most {
            let detail = format!("expected at most {most} bytes of memory, got {needed}");
            return Err(ServiceError::invalid("/image", detail));
        }
        let parameters = to_json(&Plan { bytes, ..plan })?;
        jobs::create(app, (JobKind::Segment, parameters, self.seconds), &files, receipt).await
    }
}

/// Runs the job.
///
/// # Errors
/// The refusals of a request; a cohort that was deleted or has changed meanwhile; [`ServiceError::Cancelled`].
pub fn run(app: &App, handle: &Handle, job: &Job, context: &JobContext) -> Result<Outcome, ServiceError> {
    let plan: Plan = json::from_value(&job.parameters)
        .map_err(|error| ServiceError::Internal(format!("the parameters of a job: {error}")))?;
    let app = app.of_job(job, context);
    let outcome = match plan.cohort.clone() {
        None => plan.segmented(&app, handle, job),
        Some(cohort) => plan.added(&app, handle, job, &cohort),
    };
    outcome.map_err(|error| match error {
        // Memory that others hold is free later.
        ServiceError::Overloaded(detail) => ServiceError::Unavailable(detail),
        error => error,
    })
}

impl Plan {
    /// Objects that are answered.
    fn segmented(&self, app: &App, handle: &Handle, job: &Job) -> Result<Outcome, ServiceError> {
        let (parts, attracting) = self.files(app, handle, job)?;
        let asked: SegmentRequest = app.parse(&parts.parameters)?;
        let mut prepared = parts.prepared_here(app, asked, attracting)?;
        prepared.wanted.answered.outlines = self.shown != Shown::Numbers;
        let found = prepared.ready(app)?.segment_in_job(app)?;
        let output = found.file(self.shown)?.map(|file| JobOutput::of_file(file.media_type, file.bytes));
        Ok(Outcome { result: to_json(&found.answer)?, dictionary: None, output: output.map(Box::new) })
    }

    /// Objects that go into a cohort.
    fn added(&self, app: &App, handle: &Handle, job: &Job, cohort: &str) -> Result<Outcome, ServiceError> {
        let outcome = |result| Outcome { result, dictionary: None, output: None };
        // An attempt that was interrupted after it had added them.
        if let Some(Repeated::Answer(answer)) = handle.block_on(membership::done_before(app))? {
            return Ok(outcome(answer));
        }
        let cohort = handle.block_on(catalogue::find(app, cohort))?;
        let (parts, attracting) = self.files(app, handle, job)?;
        let asked: CohortSegmentRequest = app.parse(&parts.parameters)?;
        let (asked, Storing { objects, store_failed, unit }) = asked.split(&cohort)?;
        let mut membership = Membership {
            expected: self.revision.map(|revision| expected(&cohort, revision)),
            cohort,
            objects,
            store_failed,
            digests: self.digests.clone(),
            job: Some(job.clone()),
            unit,
            lengths: Lengths::default(),
            origin: Origin::of(&parts.image, &app.limits),
        };
        let mut prepared = parts.prepared_here(app, asked, attracting)?;
        let attributes = membership.look(&mut prepared)?;
        let ready = prepared.ready(app)?;
        membership.meet(ready.unit())?;
        let found = ready.segment_in_job(app)?;
        let arriving = membership.arriving(found.answer, attributes)?;
        let (answer, _) = handle.block_on(membership.store(app, arriving))?;
        Ok(outcome(answer))
    }

    /// The files of the job: the parts of the request, and the attracting shapes.
    fn files(&self, app: &App, handle: &Handle, job: &Job) -> Result<(Parts, Option<Stored>), ServiceError> {
        app.pool.context().report("read", 0.0, None);
        let files = handle.block_on(app.store.read_job_files(job))?;
        if files.iter().map(|(_, file)| file.len()).sum::<usize>() != self.bytes {
            return Err(ServiceError::Internal("some of the files of a job are missing".into()));
        }
        let (mut parts, mut attracting) = (Parts::default(), None);
        for (name, file) in files {
            match name.as_str() {
                ATTRACTING => {
                    let read = serde_json::from_slice(&file);
                    let read =
                        read.map_err(|error| ServiceError::Internal(format!("what attracts: {error}")))?;
                    attracting = Some(read);
                }
                PARAMETERS => parts.parameters = Bytes::from(file),
                name if name == FILES[0] => parts.image = Bytes::from(file),
                name if name == FILES[1] => parts.truth = Some(Bytes::from(file)),
                name if name == FILES[2] => parts.mask = Some(Bytes::from(file)),
                _ => return Err(ServiceError::Internal("a file of a job that it does not know".into())),
            }
        }
        Ok((parts, attracting))
    }
}

/// The version of a cohort at a revision.
fn expected(cohort: &Cohort, revision: u64) -> Expected {
    Expected(vec![revision_tag(&Cohort { revision, ..cohort.clone() })])
}

fn to_json(value: &impl Serialize) -> Result<Value, ServiceError> {
    json::to_value(value).map_err(|error| ServiceError::Internal(format!("not JSON: {error}")))
}
