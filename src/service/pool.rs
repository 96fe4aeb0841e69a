//! The one bounded pool where arithmetic leaves the async threads.

use std::sync::Arc;

use tokio::sync::{Semaphore, oneshot};

use super::ServiceError;

/// Compute tasks that may wait or run at once; more are turned away.
const QUEUE: usize = 256;

/// A fixed number of compute threads with a bounded queue.
#[derive(Debug, Clone)]
pub struct Pool {
    threads: Arc<rayon::ThreadPool>,
    places: Arc<Semaphore>,
}

impl Pool {
    /// A pool of `threads` threads; 0 means one per core.
    pub fn new(threads: usize) -> Self {
        let threads = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|i| format!("compute-{i}"))
            .build()
            .expect("the system can start threads");
        Self { threads: Arc::new(threads), places: Arc::new(Semaphore::new(QUEUE)) }
    }

    /// Runs `task` on the pool and waits without blocking an async thread.
    ///
    /// # Errors
    /// [`ServiceError::Unavailable`] when the queue is full; [`ServiceError::Internal`] when the task panicked
    /// (a bug: the panic stays in the task).
    pub async fn run<T: Send + 'static>(
        &self,
        task: impl FnOnce() -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let Ok(place) = self.places.clone().try_acquire_owned() else {
            return Err(ServiceError::Unavailable("the compute queue is full".into()));
        };
        let (answer, result) = oneshot::channel();
        self.threads.spawn(move || {
            let _place = place;
            let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(task));
            // The receiver is gone when the client went away: nobody waits for the answer.
            let _ = answer.send(outcome);
        });
        match result.await {
            Ok(Ok(outcome)) => outcome,
            Ok(Err(_)) => Err(ServiceError::Internal("a compute task panicked".into())),
            Err(_) => Err(ServiceError::Internal("a compute task was dropped".into())),
        }
    }
}
