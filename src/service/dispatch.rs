//! What each kind of job does.

use tokio::runtime::Handle;

use crate::domain::job::{Job, JobKind};
use crate::service::app::progress::JobContext;
use crate::service::app::{App, ServiceError};
use crate::service::dictionaries::learning;
use crate::service::inference::{comparisons, regressions};
use crate::service::jobs::{Outcome, inline_or_job};
use crate::service::search::distances;

/// Does what the job is for, on a compute thread; `handle` is for what has to be awaited.
///
/// May be called twice for a job: nothing but the outcome must stay. Long loops call [`JobContext::check`].
///
/// # Errors
/// What keeps it from succeeding: [`ServiceError::Unavailable`] is tried again, everything else is final.
pub fn run(app: &App, handle: &Handle, job: &Job, context: &JobContext) -> Result<Outcome, ServiceError> {
    match job.kind {
        JobKind::LearnDictionary => learning::run(app, handle, job, context),
        JobKind::Distances => distances::run(app, handle, job, context),
        JobKind::Compare => inline_or_job::run::<comparisons::Prepared>(app, handle, job, context),
        JobKind::Regress => inline_or_job::run::<regressions::Prepared>(app, handle, job, context),
    }
}
