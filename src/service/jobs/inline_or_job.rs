//! Tests of stored shapes ([`PlannedTest`]): answered at once if they are small, otherwise by a job.

use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::runtime::Handle;

use super::Outcome;
use crate::domain::job::{Job, JobKind, JobOutput};
use crate::geometry::drawing::scene::Drawing;
use crate::service::app::progress::JobContext;
use crate::service::app::{App, ServiceError};
use crate::service::jobs;
use crate::wire::json;

/// Maximum predicted time of requests that are answered at once; longer ones become jobs.
pub(crate) const AT_ONCE_SECONDS: f64 = 3.0;

/// A test with checked parameters and known shapes.
pub trait PlannedTest: Sized + Send + 'static {
    /// Parameters that determine the answer, as stored with a job.
    type Plan: Serialize + DeserializeOwned;
    /// Answer of the test.
    type Answer: Serialize + DeserializeOwned + Send;
    /// Kind of the job that answers it.
    const KIND: JobKind;

    /// The plan.
    fn plan(&self) -> &Self::Plan;

    /// Restores a test from a stored plan.
    ///
    /// # Errors
    /// A cohort that was deleted in the meantime.
    fn from_plan(app: &App, handle: &Handle, plan: Self::Plan) -> Result<Self, ServiceError>;

    /// Predicted time in seconds.
    fn seconds(&self) -> f64;

    /// Computes the answer on a compute thread; `handle` runs async parts.
    ///
    /// # Errors
    /// Degenerate shapes; [`ServiceError::Cancelled`].
    fn answer(&self, app: &App, handle: &Handle, context: &JobContext) -> Result<Self::Answer, ServiceError>;

    /// What is kept beside the answer of a job. Default: nothing.
    ///
    /// # Errors
    /// What cannot be stored (a bug).
    fn kept(_answer: &mut Self::Answer, _job: &str) -> Result<Option<JobOutput>, ServiceError> {
        Ok(None)
    }

    /// Drawing of the answer.
    fn draw(&self, answer: &Self::Answer) -> Drawing;

    /// Whether it is answered at once.
    fn is_quick(&self) -> bool {
        self.seconds() <= AT_ONCE_SECONDS
    }
}

/// Submits the job that answers a test.
///
/// # Errors
/// [`ServiceError::Unavailable`] if too many jobs wait.
pub async fn submit<T: PlannedTest>(app: &App, test: &T) -> Result<Job, ServiceError> {
    let parameters = json::to_value(test.plan())
        .map_err(|error| ServiceError::Internal(format!("a plan is not JSON: {error}")))?;
    jobs::submit(app, T::KIND, parameters, test.seconds()).await
}

/// Runs the job of a test.
///
/// # Errors
/// The reason why it cannot be answered; [`ServiceError::Cancelled`].
pub(crate) fn run<T: PlannedTest>(
    app: &App,
    handle: &Handle,
    job: &Job,
    context: &JobContext,
) -> Result<Outcome, ServiceError> {
    let plan = json::from_value(&job.parameters)
        .map_err(|error| ServiceError::Internal(format!("the parameters of a job: {error}")))?;
    let mut answer = T::from_plan(app, handle, plan)?.answer(app, handle, context)?;
    let output = T::kept(&mut answer, &job.id)?.map(Box::new);
    let result = json::to_value(&answer)
        .map_err(|error| ServiceError::Internal(format!("an answer is not JSON: {error}")))?;
    Ok(Outcome { result, dictionary: None, output })
}
