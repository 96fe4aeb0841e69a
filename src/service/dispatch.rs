//! Dispatch of jobs: calls the use case that belongs to the kind of a job.

use tokio::runtime::Handle;

use crate::domain::job::{Job, JobKind};
use crate::service::app::progress::JobContext;
use crate::service::app::{App, ServiceError};
use crate::service::correspondence;
use crate::service::dictionaries::report::PlannedReport;
use crate::service::dictionaries::{assessments, learning};
use crate::service::inference::blocks::BlocksOfShapes;
use crate::service::inference::comparisons::ComparedShapes;
use crate::service::inference::models::ModelledShapes;
use crate::service::inference::modularity::ModularShapes;
use crate::service::inference::regressions::RegressedShapes;
use crate::service::inference::repeatability::RepeatedShapes;
use crate::service::inference::study::Study;
use crate::service::inference::symmetry::SymmetricShapes;
use crate::service::jobs::{Outcome, inline_or_job};
use crate::service::search::distances;
use crate::service::segmentation;

/// Runs a job on a compute thread; `handle` runs its async parts.
///
/// A job may run more than once: only its outcome may have lasting effects. Long loops call [`JobContext::check`].
///
/// # Errors
/// The reason why the job failed: [`ServiceError::Unavailable`] is retried, all others are final.
pub fn run(app: &App, handle: &Handle, job: &Job, context: &JobContext) -> Result<Outcome, ServiceError> {
    match job.kind {
        JobKind::LearnDictionary => learning::run(app, handle, job, context),
        JobKind::Distances => distances::run(app, handle, job, context),
        JobKind::Compare => inline_or_job::run::<Study<ComparedShapes>>(app, handle, job, context),
        JobKind::Regress => inline_or_job::run::<Study<RegressedShapes>>(app, handle, job, context),
        JobKind::Model => inline_or_job::run::<Study<ModelledShapes>>(app, handle, job, context),
        JobKind::Repeatability => inline_or_job::run::<Study<RepeatedShapes>>(app, handle, job, context),
        JobKind::TwoBlocks => inline_or_job::run::<Study<BlocksOfShapes>>(app, handle, job, context),
        JobKind::Modularity => inline_or_job::run::<Study<ModularShapes>>(app, handle, job, context),
        JobKind::Symmetry => inline_or_job::run::<Study<SymmetricShapes>>(app, handle, job, context),
        JobKind::Assess => assessments::run(app, handle, job, context),
        JobKind::Report => inline_or_job::run::<PlannedReport>(app, handle, job, context),
        JobKind::Correspond => correspondence::run(app, handle, job, context),
        JobKind::Segment => segmentation::job::run(app, handle, job, context),
    }
}
