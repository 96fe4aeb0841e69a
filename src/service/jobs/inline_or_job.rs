//! Tests of stored shapes: answered at once when they are small, by a job when they are not.

use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::runtime::Handle;

use super::Outcome;
use crate::domain::job::{Job, JobKind};
use crate::service::app::progress::JobContext;
use crate::service::app::{App, ServiceError};
use crate::service::jobs;

/// Tests of at most this predicted time are answered at once; longer ones become jobs.
const AT_ONCE_SECONDS: f64 = 3.0;

/// A test whose parameters were checked and whose shapes are known.
pub trait PlannedTest: Sized + Send + 'static {
    /// What the answer depends on, as it is stored with a job.
    type Plan: Serialize + DeserializeOwned;
    /// What is answered.
    type Answer: Serialize + DeserializeOwned + Send;
    /// The job that answers.
    const KIND: JobKind;

    /// The plan.
    fn plan(&self) -> &Self::Plan;

    /// The test of a stored plan.
    ///
    /// # Errors
    /// A cohort that was deleted meanwhile.
    fn of_plan(app: &App, handle: &Handle, plan: Self::Plan) -> Result<Self, ServiceError>;

    /// Predicted time.
    fn seconds(&self) -> f64;

    /// Does it, on a compute thread; `handle` is for what has to be awaited.
    ///
    /// # Errors
    /// Degenerate shapes; [`ServiceError::Cancelled`].
    fn answer(&self, app: &App, handle: &Handle, context: &JobContext) -> Result<Self::Answer, ServiceError>;

    /// A picture of the answer.
    fn draw(&self, answer: &Self::Answer) -> String;

    /// Whether it is answered at once.
    fn is_quick(&self) -> bool {
        self.seconds() <= AT_ONCE_SECONDS
    }
}

/// Stores the job that answers a test.
///
/// # Errors
/// [`ServiceError::Unavailable`] when too many jobs wait.
pub async fn submit<T: PlannedTest>(app: &App, test: &T) -> Result<Job, ServiceError> {
    let parameters = serde_json::to_value(test.plan())
        .map_err(|error| ServiceError::Internal(format!("a plan is not JSON: {error}")))?;
    jobs::submit(app, T::KIND, parameters, test.seconds()).await
}

/// Runs the job of a test.
///
/// # Errors
/// What keeps it from being answered; [`ServiceError::Cancelled`].
pub(crate) fn run<T: PlannedTest>(
    app: &App,
    handle: &Handle,
    job: &Job,
    context: &JobContext,
) -> Result<Outcome, ServiceError> {
    let plan = serde_json::from_value(job.parameters.clone())
        .map_err(|error| ServiceError::Internal(format!("the parameters of a job: {error}")))?;
    let answer = T::of_plan(app, handle, plan)?.answer(app, handle, context)?;
    let result = serde_json::to_value(&answer)
        .map_err(|error| ServiceError::Internal(format!("an answer is not JSON: {error}")))?;
    Ok(Outcome { result, dictionary: None, output: None })
}
