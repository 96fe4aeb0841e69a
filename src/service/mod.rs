//! What the product does: one function per use case, values in, values or a [`ServiceError`] out.
//!
//! * [`App`] — store, limits, the pool where arithmetic leaves the async threads;
//! * [`input`] — posted shapes to control points of a representation;
//! * [`compute`] — the stateless statistics: project, mean, align, PCA;
//! * [`curves`], [`fitting`], [`morph`] — the stateless use cases of single curves: evaluate, measure, resample; fit,
//!   refine, idealise; paths between two;
//! * [`cohorts`], [`ingest`] — cohorts and their shapes;
//! * [`live_mean`] — the mean of a stored cohort, streamed;
//! * [`distances`], [`neighbours`] — all distances of a set of shapes; the nearest shapes of a cohort, and
//!   [`prepared`], cohorts kept ready for that;
//! * [`comparisons`], [`regressions`] — tests of stored shapes by permutation; [`members`] — the shapes they look at;
//! * [`generators`] — one generator with all that is known of it;
//! * [`example`] — the example cohort of an empty store;
//! * [`jobs`] — long work beside the requests; [`learning`] — what it is;
//! * [`drift`] — new shapes beside those a dictionary was learnt from;
//! * [`membership`] — classes and subjects of a cohort; [`classify`] — classifiers in use;
//! * [`problem`] — what was refused, as a document.

pub mod classify;
pub mod coding;
pub mod cohorts;
pub mod comparisons;
pub mod compute;
pub mod curves;
pub mod dictionaries;
pub mod dictionary_file;
pub mod distances;
pub mod drift;
pub mod error;
pub mod estimate;
pub mod example;
pub mod fitting;
pub mod generators;
pub mod ingest;
pub mod input;
pub mod jobs;
pub mod learning;
pub mod live_mean;
pub mod members;
pub mod membership;
pub mod models;
pub mod modes;
pub mod morph;
pub mod neighbours;
pub mod planned;
pub mod pool;
pub mod prepared;
pub mod problem;
pub mod regressions;
mod stored;
mod validation;

use std::sync::Arc;

use tokio_util::sync::CancellationToken;

use crate::analysis::metric::Metric;
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::store::Store;
pub use error::ServiceError;
use pool::Pool;

/// Sizes that are checked before memory is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Control points of a representation.
    pub control_points: usize,
    /// Points of a posted contour.
    pub points: usize,
    /// Shapes of a request that is answered from memory.
    pub shapes: usize,
    /// Samples that an evaluation answers, over all shapes.
    pub samples: usize,
    /// Bytes of a request body, after decompression.
    pub body_bytes: usize,
    /// Bytes of a line of an NDJSON stream.
    pub line_bytes: usize,
    /// Atoms or components of a dictionary.
    pub atoms: usize,
    /// Bytes of memory that a job may be predicted to take.
    pub job_bytes: usize,
    /// Bytes of a distance matrix.
    pub matrix_bytes: usize,
    /// Multiply-adds that a distance matrix may be predicted to take to be answered at once; more become a job.
    pub matrix_operations: usize,
    /// Multiply-adds that a search may be predicted to take.
    pub search_operations: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            control_points: 2048,
            points: 100_000,
            shapes: 100_000,
            samples: 2_000_000,
            body_bytes: 64 << 20,
            line_bytes: 8 << 20,
            atoms: 1024,
            job_bytes: 4 << 30,
            matrix_bytes: 128 << 20,
            matrix_operations: 5_000_000_000,
            search_operations: 100_000_000_000,
        }
    }
}

/// Everything a use case needs; cheap to clone.
#[derive(Debug, Clone)]
pub struct App {
    /// Where cohorts live.
    pub store: Store,
    /// Sizes that are accepted.
    pub limits: Limits,
    /// Where arithmetic runs.
    pub pool: Pool,
    /// Jobs that run or are watched.
    jobs: Arc<jobs::registry::Registry>,
    draining: CancellationToken,
    means: Arc<live_mean::MeanCache>,
    models: Arc<models::ReadyCache>,
    prepared: Arc<prepared::PreparedCache>,
}

impl App {
    /// From an open store; `threads` compute threads (0: one per core).
    pub fn new(store: Store, limits: Limits, threads: usize) -> Self {
        Self {
            store,
            limits,
            pool: Pool::new(threads),
            jobs: Arc::default(),
            draining: CancellationToken::new(),
            means: Arc::default(),
            models: Arc::default(),
            prepared: Arc::default(),
        }
    }

    /// From now on the service reports that it is going away, and what waits for news of a job ends.
    pub fn drain(&self) {
        self.draining.cancel();
    }

    /// Waits until the service is asked to stop.
    pub async fn stopping(&self) {
        self.draining.cancelled().await;
    }

    /// Whether requests can be served: the store accepts a write and nobody asked to stop.
    ///
    /// # Errors
    /// [`ServiceError::Unavailable`] with the reason.
    pub async fn ready(&self) -> Result<(), ServiceError> {
        if self.draining.is_cancelled() {
            return Err(ServiceError::Unavailable("the service is stopping".into()));
        }
        self.store.ready().await.map_err(|error| {
            tracing::error!(%error, "the store does not accept writes");
            ServiceError::Unavailable("the store does not accept writes".into())
        })
    }

    /// The prepared space and metric of `representation`.
    ///
    /// # Errors
    /// [`ServiceError::Invalid`] below `pointer` when its sizes are out of bounds.
    pub fn space(
        &self,
        representation: &Representation,
        pointer: &str,
    ) -> Result<(ShapeSpace, Metric), ServiceError> {
        input::check_representation(representation, &self.limits)
            .map_err(|errors| ServiceError::below(errors, pointer))?;
        let space = ShapeSpace::new(representation)
            .map_err(|error| ServiceError::invalid(format!("{pointer}/generator"), error.to_string()))?;
        let metric = Metric::of(&space);
        Ok((space, metric))
    }
}

/// Milliseconds since 1970 UTC.
pub fn now_ms() -> i64 {
    jiff::Timestamp::now().as_millisecond()
}
