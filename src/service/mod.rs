//! What the product does: one function per use case, values in, values or a [`ServiceError`] out.
//!
//! * [`App`] — store, limits, the pool where arithmetic leaves the async threads;
//! * [`access`] — who asks: keys, tokens of an identity provider;
//! * [`input`] — posted shapes to control points of a representation;
//! * [`compute`] — the stateless statistics: project, mean, align, PCA;
//! * [`posted`] — the curves and surfaces of a request;
//! * [`curves`], [`fitting`] — the stateless use cases of single curves: evaluate, measure, resample; fit, refine, idealise;
//! * [`surfaces`], [`surface_fitting`] — those of surfaces, and their meshes;
//! * [`subdivisions`], [`subdivision_fitting`] — those of subdivision surfaces; [`spaces`] — their spaces, kept prepared;
//! * [`overlap`] — how two bodies or masks overlap;
//! * [`morph`], [`deform`] — paths between two shapes; handles that pull at one;
//! * [`clock`] — whether the clock can be believed;
//! * [`audit`] — the trail of all requests; [`metrics`] — what is counted; [`build`] — what the program was made from;
//! * [`cohorts`], [`ingest`] — cohorts and their shapes;
//! * [`live_mean`] — the mean of a stored cohort, streamed;
//! * [`distances`], [`neighbours`] — all distances of a set of shapes; the nearest shapes of a cohort, and
//!   [`prepared`], cohorts kept ready for that;
//! * [`comparisons`], [`regressions`] — tests of stored shapes by permutation; [`members`] — the shapes they look at;
//! * [`generators`] — one generator with all that is known of it;
//! * [`example`] — the example cohort of an empty store;
//! * [`jobs`] — long work beside the requests; [`learning`] — what it is; [`spreading`] — how several processes share it;
//! * [`drift`] — new shapes beside those a dictionary was learnt from;
//! * [`retries`] — requests that are sent again; [`changes`] — the feed; [`trash`] — what can come back;
//! * [`memory`] — what the process may take, and who holds it;
//! * [`membership`] — classes and subjects of a cohort; [`classify`] — classifiers in use;
//! * [`pool`] — the threads where all of it is computed, in turns; [`work`] — what it will cost;
//! * [`problem`] — what was refused, as a document; [`refusals`] — requests of nobody, counted.

pub mod access;
pub mod audit;
pub mod build;
pub mod changes;
pub mod classify;
pub mod clock;
pub mod coding;
pub mod cohorts;
pub mod comparisons;
pub mod compute;
pub mod curves;
pub mod deform;
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
pub mod memory;
pub mod metrics;
pub mod models;
pub mod modes;
pub mod morph;
pub mod neighbours;
pub mod overlap;
pub mod planned;
pub mod pool;
pub mod posted;
pub mod prepared;
pub mod problem;
pub mod refusals;
pub mod regressions;
pub mod retries;
pub mod spaces;
pub mod spreading;
mod stored;
pub mod subdivision_fitting;
pub mod subdivisions;
pub mod surface_fitting;
pub mod surfaces;
pub mod trash;
mod validation;
pub mod warnings;
pub mod work;

use std::sync::Arc;
use std::time::{Duration, Instant};

use tokio_util::sync::CancellationToken;

use crate::analysis::metric::Metric;
use crate::domain::access::{DEFAULT_TENANT, Principal};
use crate::domain::job::Priority;
use crate::formats::bounds::Bounds;
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::store::Store;
pub use error::ServiceError;
use pool::Pool;
use work::Work;

/// Sizes that are checked before memory is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Control points of a representation.
    pub control_points: usize,
    /// Points of a posted contour.
    pub points: usize,
    /// Shapes of a request that is answered from memory.
    pub shapes: usize,
    /// Numbers of the control points of all shapes of a request that is answered from memory.
    pub coordinates: usize,
    /// Vertices of a refined mesh.
    pub vertices: usize,
    /// Points that are answered, over all shapes.
    pub samples: usize,
    /// Numbers that an evaluation answers, over all shapes; each takes some 20 bytes of text.
    pub answer_numbers: usize,
    /// Bytes of a request body, after decompression.
    pub body_bytes: usize,
    /// Bytes of a line of an NDJSON stream.
    pub line_bytes: usize,
    /// Values of a JSON body, counted by its commas and brackets.
    pub json_values: usize,
    /// How many times as long as on the wire a body may become, beyond its first MiB.
    pub compression_ratio: usize,
    /// Bytes of the metadata of a shape, as JSON.
    pub metadata_bytes: usize,
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
    /// Heavy requests that compute or wait for it; 0 means four per compute thread.
    pub heavy_requests: usize,
    /// Time that a job may be predicted to take; one that takes three times as long is ended.
    pub job_time: Duration,
    /// Jobs of a tenant that may wait.
    pub queued_jobs: u32,
    /// Time that the jobs of a tenant that wait may be predicted to take together.
    pub queued_work: Duration,
    /// Compute time that a request may be predicted to take.
    pub request_work: Duration,
    /// Resident bytes of the process, beyond which what is large is refused.
    pub memory: usize,
    /// Bytes of request bodies in memory and of what is read from them, of all requests together.
    pub buffered_bytes: usize,
    /// Bytes of answers in memory, of all requests together.
    pub answer_bytes: usize,
    /// Requests of a caller in a second, on average; 0 does not count them.
    pub rate_per_second: u32,
    /// Requests of a caller at once; 0 means twice those of a second.
    pub rate_burst: u32,
    /// Requests from an address in a minute that access control refuses with 401 before it refuses with 429; 0 does not count
    /// them.
    pub refusals_per_minute: u32,
    /// Time for a request that only reads what is stored.
    pub light_time: Duration,
    /// Time for a request that computes.
    pub compute_time: Duration,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            control_points: 2048,
            points: 100_000,
            shapes: 100_000,
            coordinates: 8 << 20,
            vertices: 300_000,
            samples: 2_000_000,
            answer_numbers: 1 << 20,
            body_bytes: 64 << 20,
            line_bytes: 8 << 20,
            json_values: 32 << 20,
            compression_ratio: 100,
            metadata_bytes: 64 << 10,
            atoms: 1024,
            job_bytes: 4 << 30,
            matrix_bytes: 128 << 20,
            matrix_operations: 5_000_000_000,
            search_operations: 100_000_000_000,
            heavy_requests: 0,
            job_time: Duration::from_secs(6 * 3600),
            queued_jobs: 100,
            queued_work: Duration::from_secs(24 * 3600),
            request_work: Duration::from_secs(10),
            memory: usize::MAX,
            buffered_bytes: 768 << 20,
            answer_bytes: 160 << 20,
            rate_per_second: 0,
            rate_burst: 0,
            // Whoever is let in is never counted: this only tells those who are not to slow down. A client with a wrong key that
            // tries five times a second still hears what is wrong.
            refusals_per_minute: 300,
            light_time: Duration::from_secs(30),
            compute_time: Duration::from_secs(120),
        }
    }
}

impl Limits {
    /// How much memory there is for what.
    pub fn quota(&self) -> memory::Quota {
        memory::Quota { process: self.memory, bodies: self.buffered_bytes, answers: self.answer_bytes }
    }

    /// How much of a document is kept while it is read.
    pub fn bounds(&self) -> Bounds {
        // Vertices of a posted mesh are points too.
        let points = self.points.max(self.vertices);
        Bounds { items: self.shapes, points, metadata_bytes: self.metadata_bytes }
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
    /// Who asks.
    pub principal: Arc<Principal>,
    access: Arc<access::Access>,
    /// The request, when it may be sent again.
    retry: Option<retries::Retry>,
    /// How urgent the jobs of the request are.
    priority: Priority,
    /// What the request turns out to be about.
    pub touched: audit::Touched,
    /// Where requests are recorded.
    pub trail: Arc<audit::Trail>,
    /// What is known of the machine's clock.
    clock: Arc<clock::Clock>,
    /// Jobs that run or are watched.
    jobs: Arc<jobs::registry::Registry>,
    draining: CancellationToken,
    /// Who holds how much memory.
    pub memory: memory::Memory,
    means: Arc<live_mean::MeanCache>,
    models: Arc<models::ReadyCache>,
    prepared: Arc<prepared::PreparedCache>,
    spaces: Arc<spaces::SpaceCache>,
}

impl App {
    /// From an open store; `threads` compute threads (0: one per core).
    pub fn new(store: Store, limits: Limits, threads: usize) -> Self {
        Self {
            store,
            limits,
            pool: Pool::new(threads, &limits),
            principal: Arc::new(Principal::system(DEFAULT_TENANT)),
            access: Arc::default(),
            retry: None,
            priority: Priority::default(),
            touched: audit::Touched::default(),
            trail: Arc::default(),
            clock: Arc::default(),
            jobs: Arc::default(),
            draining: CancellationToken::new(),
            memory: memory::Memory::new(limits.quota()),
            means: Arc::default(),
            models: Arc::default(),
            prepared: Arc::default(),
            spaces: Arc::default(),
        }
    }

    /// The same service as `principal` sees it, for one request: its work stops when nobody waits for it any more.
    pub fn of(&self, principal: Arc<Principal>) -> Self {
        let store = self.store.of(Arc::clone(&principal));
        let pool = self.pool.of_request(&principal);
        Self { store, principal, pool, ..self.clone() }
    }

    /// The same request, at something that is predicted to take so much.
    pub fn weighing(&self, work: Work) -> Self {
        Self { pool: self.pool.weighing(work), ..self.clone() }
    }

    /// The same request, whose work shall have ended at `deadline`.
    #[must_use]
    pub fn until(&self, deadline: Instant) -> Self {
        Self { pool: self.pool.until(deadline), ..self.clone() }
    }

    /// The same request, whose jobs are so urgent.
    #[must_use]
    pub fn with_priority(self, priority: Priority) -> Self {
        Self { priority, ..self }
    }

    /// The same service, noting what it is asked about.
    pub fn noting(self, touched: audit::Touched) -> Self {
        Self { touched, ..self }
    }

    /// From now on the service reports that it is going away, and what waits for news of a job ends.
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

    /// Whether requests can be served: nobody asked to stop, the threads of the lanes take turns, and the store accepts a
    /// write.
    ///
    /// # Errors
    /// [`ServiceError::Unavailable`] with the reason.
    pub async fn ready(&self) -> Result<(), ServiceError> {
        if self.draining.is_cancelled() {
            return Err(ServiceError::Unavailable("the service is stopping".into()));
        }
        if let Some(lane) = self.pool.stuck_lane() {
            let detail =
                format!("all threads of the lane '{lane}' have been at one computation beyond its time");
            tracing::error!(lane, "all threads of a lane are stuck");
            return Err(ServiceError::Unavailable(detail));
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
        let field = match representation {
            Representation::Subdivision(_) => "level",
            Representation::Surface { .. } => "generators",
            _ => "generator",
        };
        let space = self
            .spaces
            .find_or_make(representation)
            .map_err(|error| ServiceError::invalid(format!("{pointer}/{field}"), error.to_string()))?;
        let metric = Metric::of(&space);
        Ok((space, metric))
    }
}

/// Milliseconds since 1970 UTC.
pub fn now_ms() -> i64 {
    jiff::Timestamp::now().as_millisecond()
}
