//! Threads that read long bodies. On the threads that serve connections, decompressing and copying them would keep small
//! requests waiting; these threads have the lower priority of heavy requests.

use std::future::Future;
use std::sync::Arc;

use tokio::runtime::{Builder, Runtime};
use tokio_util::task::AbortOnDropHandle;

use super::places::{PLACES, Places};
use super::priority;
use super::turns::Who;
use crate::service::app::error::ServiceError;

/// Separate threads. Clones share them.
#[derive(Debug, Clone)]
pub(super) struct Readers {
    threads: Arc<Threads>,
    files: Places,
}

#[derive(Debug)]
struct Threads(Option<Runtime>);

impl Drop for Threads {
    /// The last clone may go on a thread that must not wait.
    fn drop(&mut self) {
        if let Some(runtime) = self.0.take() {
            runtime.shutdown_background();
        }
    }
}

impl Readers {
    /// So many threads.
    pub(super) fn new(threads: usize) -> Self {
        let runtime = Builder::new_multi_thread()
            .worker_threads(threads)
            .thread_name("reader")
            .max_blocking_threads(PLACES)
            .on_thread_start(|| priority::give_way(priority::HEAVY))
            .enable_all()
            .build()
            .expect("the system can start threads");
        Self { threads: Arc::new(Threads(Some(runtime))), files: Places::new() }
    }

    /// Runs `read` on these threads. A caller that stops waiting cancels it.
    ///
    /// # Errors
    /// [`ServiceError::Cancelled`] if the process ends.
    pub(super) async fn run<T: Send + 'static>(
        &self,
        read: impl Future<Output = T> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let Some(runtime) = &self.threads.0 else { return Err(ServiceError::Cancelled) };
        let reading = AbortOnDropHandle::new(runtime.spawn(read));
        reading.await.map_err(|error| match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(_) => ServiceError::Cancelled,
        })
    }

    /// Runs `read` of `who`, which may wait for a client, on a separate thread. A caller that stops waiting does not end it.
    ///
    /// # Errors
    /// Those of `read`; [`ServiceError::Overloaded`] if too many files are being read; [`ServiceError::Cancelled`] if the
    /// process ends.
    pub(super) async fn run_blocking<T: Send + 'static>(
        &self,
        who: &Who,
        read: impl FnOnce() -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let place = self.files.take(who).await?;
        let Some(runtime) = &self.threads.0 else { return Err(ServiceError::Cancelled) };
        let reading = runtime.spawn_blocking(move || {
            let _place = place;
            read()
        });
        reading.await.map_err(|error| match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            Err(_) => ServiceError::Cancelled,
        })?
    }
}
