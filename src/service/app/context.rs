//! Context of a use case: store, limits, threads, memory accounts and cache.
//!
//! One context lives as long as the process. Every request works on a clone of it that carries its caller, its
//! idempotency key and its predicted work.

use std::sync::Arc;
use std::time::Instant;

use tokio_util::sync::CancellationToken;

use super::cache::Cache;
use super::error::ServiceError;
use super::idempotency::Retry;
use super::limits::Limits;
use super::memory::Memory;
use super::pool::Pool;
use super::progress::JobContext;
use super::state::State;
use super::touched::Touched;
use super::work::Work;
use crate::domain::access::{DEFAULT_TENANT, Principal};
use crate::domain::job::{Job, Priority};
use crate::store::Store;

/// Everything a use case needs; cheap to clone.
#[derive(Debug, Clone)]
pub struct App {
    /// The store.
    pub store: Store,
    /// Limits on sizes and times.
    pub limits: Limits,
    /// Threads for computations.
    pub pool: Pool,
    /// The caller.
    pub principal: Arc<Principal>,
    /// Idempotency key of the request, if it has one.
    pub(in crate::service) retry: Option<Retry>,
    /// Priority of the jobs that the request creates.
    pub(in crate::service) priority: Priority,
    /// Ids of the objects that the request concerns, for the audit trail.
    pub touched: Touched,
    pub(super) draining: CancellationToken,
    /// Memory accounts of requests and responses.
    pub memory: Memory,
    /// Cache of expensive results.
    pub cache: Arc<Cache>,
    pub(super) state: State,
}

impl App {
    /// A context with an open store and `threads` compute threads (0: one per core).
    pub fn new(store: Store, limits: Limits, threads: usize) -> Self {
        let memory = Memory::new(limits.quota());
        Self {
            store,
            limits,
            pool: Pool::new(threads, &limits, &memory),
            principal: Arc::new(Principal::system(DEFAULT_TENANT)),
            retry: None,
            priority: Priority::default(),
            touched: Touched::default(),
            draining: CancellationToken::new(),
            memory,
            cache: Arc::new(Cache::new(limits.memory, limits.cache_time)),
            state: State::default(),
        }
    }

    /// The context of one request of `principal`: its work stops when the client stops waiting.
    pub fn of(&self, principal: Arc<Principal>) -> Self {
        let store = self.store.of(Arc::clone(&principal));
        let pool = self.pool.for_request(&principal);
        Self { store, principal, pool, ..self.clone() }
    }

    /// The same request with a prediction of its work.
    pub fn weighing(&self, work: Work) -> Self {
        Self { pool: self.pool.weighing(work), ..self.clone() }
    }

    /// The same request with a `deadline` for its work.
    #[must_use]
    pub fn until(&self, deadline: Instant) -> Self {
        Self { pool: self.pool.until(deadline), ..self.clone() }
    }

    /// The context of a job: its work stops with it. Writes under its receipt are stored once, however often it runs.
    pub(in crate::service) fn of_job(&self, job: &Job, context: &JobContext) -> Self {
        Self { pool: self.pool.of_job(context), retry: Some(Retry::of_job(&job.id)), ..self.clone() }
    }

    /// The same request with this priority for its jobs.
    #[must_use]
    pub fn with_priority(self, priority: Priority) -> Self {
        Self { priority, ..self }
    }

    /// The same context, recording the objects that the request concerns.
    pub fn noting(self, touched: Touched) -> Self {
        Self { touched, ..self }
    }

    /// State of type `T` kept for the life of the process and shared by all requests; created by default on first use.
    pub(in crate::service) fn state<T: Default + Send + Sync + 'static>(&self) -> Arc<T> {
        self.state.get()
    }

    /// Replaces the state of type `T`; called before the service takes requests.
    pub(in crate::service) fn put_state<T: Send + Sync + 'static>(&self, value: T) {
        self.state.put(value);
    }

    /// Refuses a caller whose key is limited to certain cohorts.
    ///
    /// # Errors
    /// [`ServiceError::Forbidden`].
    pub fn check_unlimited(&self, what: &str) -> Result<(), ServiceError> {
        match self.principal.cohorts {
            None => Ok(()),
            Some(_) => {
                Err(ServiceError::Forbidden(format!("{what} requires a key that is not limited to cohorts")))
            }
        }
    }

    /// Begins the shutdown: the service reports that it is stopping, and requests that wait for news of a job end.
    pub fn drain(&self) {
        self.draining.cancel();
    }

    /// Waits until the service is asked to stop.
    pub async fn stopping(&self) {
        self.draining.cancelled().await;
    }

    /// Whether the service was asked to stop.
    pub fn is_stopping(&self) -> bool {
        self.draining.is_cancelled()
    }

    /// Checks that requests can be served: the service is not stopping, no lane is stuck, and the store accepts a
    /// write.
    ///
    /// # Errors
    /// [`ServiceError::Unavailable`] with the reason.
    pub async fn ready(&self) -> Result<(), ServiceError> {
        if self.draining.is_cancelled() {
            return Err(ServiceError::Unavailable("the service is stopping".into()));
        }
        if let Some(lane) = self.pool.stuck_lane() {
            let detail = format!(
                "all threads of the lane '{lane}' have been busy with one computation past its time limit"
            );
            tracing::error!(lane, "all threads of a lane are stuck");
            return Err(ServiceError::Unavailable(detail));
        }
        self.store.ready().await.map_err(|error| {
            tracing::error!(%error, "the store does not accept writes");
            ServiceError::Unavailable(format!("the store does not accept writes: {error}"))
        })
    }
}
