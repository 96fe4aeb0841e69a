//! The bounded pool where arithmetic leaves the async threads.
//!
//! It has two lanes with threads of their own: what takes a moment never waits behind what takes seconds. Each lane takes
//! a bounded number of tasks, those that wait included, and turns the rest away at once. On Linux the threads of the other
//! lanes have a lower priority: when cores are scarce, what takes a moment goes first.

use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};

use bytes::Bytes;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

use super::ServiceError;
use super::jobs::JobContext;
use super::metrics;

/// Name of the lane for what takes a moment.
const LIGHT: &str = "light";
/// Name of the lane for everything else that requests compute.
const HEAVY: &str = "compute";
/// Name of the lane of a place where jobs run.
pub const JOB: &str = "job";
/// All lanes.
pub(super) const LANES: [&str; 3] = [LIGHT, HEAVY, JOB];
/// Tasks of the light lane that may wait or run at once.
const LIGHT_QUEUE: usize = 256;
/// Tasks of the heavy lane that may wait or run at once, for each thread.
const HEAVY_QUEUE: usize = 4;
/// Most shapes that are a matter of a moment.
const FEW_SHAPES: usize = 16;
/// Most bytes of a body that are.
const FEW_BYTES: usize = 512 << 10;
/// Most bytes of a body that is read where it arrives: some 0.1 ms, on a busy machine less than the way to another thread and
/// back.
const TINY_BYTES: usize = 16 << 10;

/// A fixed number of compute threads that take a bounded number of tasks.
#[derive(Debug, Clone)]
pub struct Lane {
    threads: Threads,
    places: Arc<Semaphore>,
    name: &'static str,
}

/// What a thread does.
type Task = Box<dyn FnOnce() + Send>;

/// How the threads of a lane share the work.
#[derive(Debug, Clone)]
enum Threads {
    /// They share the loops of every task.
    Together(Arc<rayon::ThreadPool>),
    /// Each takes a task for itself. Between tasks they sleep: the threads of a pool look for work first and yield, and the
    /// system lets those that yield wait longest.
    Apart(Sender<Task>),
}

impl Threads {
    fn together(name: &'static str, count: usize) -> Self {
        let threads = rayon::ThreadPoolBuilder::new()
            .num_threads(count)
            .thread_name(move |i| format!("{name}-{i}"))
            .start_handler(move |_| give_way(niceness(name)))
            .build()
            .expect("the system can start threads");
        Self::Together(Arc::new(threads))
    }

    fn apart(name: &'static str, count: usize) -> Self {
        let (sender, tasks) = channel::<Task>();
        let tasks = Arc::new(Mutex::new(tasks));
        for i in 0..count {
            let tasks = Arc::clone(&tasks);
            let thread = std::thread::Builder::new().name(format!("{name}-{i}"));
            thread.spawn(move || serve(name, &tasks)).expect("the system can start threads");
        }
        Self::Apart(sender)
    }

    fn spawn(&self, task: impl FnOnce() + Send + 'static) {
        match self {
            Self::Together(threads) => threads.spawn(task),
            // The threads end when nobody can send any more, not before.
            Self::Apart(tasks) => tasks.send(Box::new(task)).expect("the threads wait for tasks"),
        }
    }
}

/// Does tasks until there can be no more.
fn serve(name: &str, tasks: &Mutex<Receiver<Task>>) {
    give_way(niceness(name));
    // Loops of a task would else be shared out to threads of all cores: here they run one after the other.
    let _alone = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build();
    loop {
        let task = tasks.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).recv();
        match task {
            Ok(task) => task(),
            Err(_) => return,
        }
    }
}

impl Lane {
    /// Threads called `name` that share the loops of every task, 0 meaning one per core, and how many tasks for each may wait
    /// or run.
    pub fn new(name: &'static str, threads: usize, tasks_each: usize) -> Self {
        let threads = thread_count(threads);
        Self::with_places(name, Threads::together(name, threads), threads * tasks_each)
    }

    fn with_places(name: &'static str, threads: Threads, places: usize) -> Self {
        Self { threads, places: Arc::new(Semaphore::new(places)), name }
    }

    /// Runs `task` and waits without blocking an async thread.
    ///
    /// # Errors
    /// [`ServiceError::Overloaded`] when too many tasks wait; [`ServiceError::Internal`] when the task panicked (a bug: the
    /// panic stays in the task).
    pub async fn run<T: Send + 'static>(
        &self,
        task: impl FnOnce() -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let place = self.place()?;
        self.run_in(place, task).await
    }

    fn place(&self) -> Result<OwnedSemaphorePermit, ServiceError> {
        let place = Arc::clone(&self.places).try_acquire_owned();
        place.map_err(|_| {
            metrics::compute_refused(self.name);
            ServiceError::Overloaded("too many requests wait to be computed".into())
        })
    }

    async fn run_in<T: Send + 'static>(
        &self,
        place: OwnedSemaphorePermit,
        task: impl FnOnce() -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let (answer, result) = oneshot::channel();
        let waiting = metrics::compute_waits(self.name);
        self.threads.spawn(move || {
            let working = waiting.begin();
            let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(task));
            // Before the answer: whoever has it may ask for the place at once.
            drop((place, working));
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

/// `threads`, 0 meaning one per core.
pub fn thread_count(threads: usize) -> usize {
    let cores = || std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
    if threads == 0 { cores() } else { threads }
}

/// How much the threads of a lane give way to others (`nice`): jobs to all requests, and all to those of a moment.
fn niceness(lane: &str) -> i32 {
    match lane {
        LIGHT => 0,
        HEAVY => 5,
        _ => 10,
    }
}

/// Lowers the priority of this thread. Elsewhere than on Linux the priority would be that of the process.
#[cfg(target_os = "linux")]
fn give_way(niceness: i32) {
    if let Err(error) = rustix::process::nice(niceness) {
        tracing::debug!(%error, "the priority of a compute thread stays as it is");
    }
}

#[cfg(not(target_os = "linux"))]
fn give_way(_: i32) {}

/// How much there is to compute.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Weight {
    /// Milliseconds.
    Light,
    /// Anything.
    Heavy,
}

impl Weight {
    /// Of work that is done for each of so many shapes.
    pub fn of_shapes(count: usize) -> Self {
        if count <= FEW_SHAPES { Self::Light } else { Self::Heavy }
    }

    /// Of reading a body of so many bytes, or work that its length bounds.
    pub fn of_bytes(count: usize) -> Self {
        if count <= FEW_BYTES { Self::Light } else { Self::Heavy }
    }
}

/// The two lanes, as one request sees them.
#[derive(Debug, Clone)]
pub struct Pool {
    light: Lane,
    heavy: Lane,
    weight: Weight,
    /// The request, unless it is the service itself that computes.
    request: Option<Arc<Request>>,
}

/// What is known of a request that computes.
#[derive(Debug, Default)]
struct Request {
    /// Whether it had a place once: what has begun is not turned away.
    admitted: AtomicBool,
    context: JobContext,
}

impl Pool {
    /// Lanes of `threads` threads each, 0 meaning one per core; `heavy_tasks` of the heavy lane may wait or run, 0 meaning
    /// four per thread.
    pub fn new(threads: usize, heavy_tasks: usize) -> Self {
        let threads = thread_count(threads);
        let heavy_tasks = if heavy_tasks == 0 { threads * HEAVY_QUEUE } else { heavy_tasks };
        let heavy = Lane::with_places(HEAVY, Threads::together(HEAVY, threads), heavy_tasks);
        let light = Lane::with_places(LIGHT, Threads::apart(LIGHT, threads), LIGHT_QUEUE);
        Self { light, heavy, weight: Weight::Heavy, request: None }
    }

    /// The same lanes for a new request.
    pub(super) fn of_request(&self) -> Self {
        Self { request: Some(Arc::default()), weight: Weight::Heavy, ..self.clone() }
    }

    /// The lane for work of this weight.
    pub fn weighing(&self, weight: Weight) -> Self {
        Self { weight, ..self.clone() }
    }

    /// Says when the work of the request shall stop, because nobody waits for it any more.
    pub fn context(&self) -> JobContext {
        self.request.as_ref().map_or_else(JobContext::default, |request| request.context.clone())
    }

    /// Reads a body: at once when it is tiny, else on the lane for its length.
    ///
    /// # Errors
    /// Those of `read`, and of [`Pool::run`].
    pub async fn read<T: Send + 'static>(
        &self,
        body: Bytes,
        read: impl FnOnce(&[u8]) -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        if body.len() <= TINY_BYTES {
            return read(&body);
        }
        self.weighing(Weight::of_bytes(body.len())).run(move || read(&body)).await
    }

    /// Runs `task` and waits without blocking an async thread. When the wait is given up, the request is: a task that
    /// has not begun is skipped, and one that runs hears of it by [`Pool::context`].
    ///
    /// # Errors
    /// [`ServiceError::Overloaded`] when too many tasks wait; [`ServiceError::Internal`] when the task panicked (a bug: the
    /// panic stays in the task).
    pub async fn run<T: Send + 'static>(
        &self,
        task: impl FnOnce() -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        let lane = match self.weight {
            Weight::Light => &self.light,
            Weight::Heavy => &self.heavy,
        };
        let Some(request) = &self.request else { return lane.run(task).await };
        let waiting = Waiting(Some(&request.context));
        let place = if request.admitted.load(Ordering::Relaxed) {
            let place = Arc::clone(&lane.places).acquire_owned().await;
            place.map_err(|_| ServiceError::Unavailable("the service is stopping".into()))
        } else {
            lane.place()
        };
        let outcome = match place {
            Ok(place) => {
                request.admitted.store(true, Ordering::Relaxed);
                let context = request.context.clone();
                lane.run_in(place, move || context.check().and_then(|()| task())).await
            }
            Err(error) => Err(error),
        };
        waiting.ended();
        outcome
    }
}

/// Somebody waits for an outcome; when this is dropped before, nobody does any more.
struct Waiting<'a>(Option<&'a JobContext>);

impl Waiting<'_> {
    fn ended(mut self) {
        self.0 = None;
    }
}

impl Drop for Waiting<'_> {
    fn drop(&mut self) {
        if let Some(context) = self.0 {
            context.interrupt();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    const SOON: Duration = Duration::from_secs(20);

    /// A task of the heavy lane that runs until what is returned is dropped; it runs when this returns.
    async fn occupied(pool: &Pool) -> std::sync::mpsc::Sender<()> {
        let (release, released) = channel::<()>();
        let (begun, begins) = oneshot::channel();
        let pool = pool.of_request();
        tokio::spawn(async move {
            pool.run(move || {
                let _ = begun.send(());
                let _ = released.recv();
                Ok(())
            })
            .await
        });
        begins.await.unwrap();
        release
    }

    #[tokio::test]
    async fn light_work_does_not_wait_behind_heavy_work_and_a_full_lane_says_so() {
        let pool = Pool::new(1, 2);
        let _running = occupied(&pool).await;
        let waiting = tokio::spawn({
            let pool = pool.of_request();
            async move { pool.run(|| Ok(())).await }
        });
        while pool.heavy.places.available_permits() > 0 {
            tokio::task::yield_now().await;
        }
        let refused = pool.of_request().run(|| Ok(())).await;
        assert!(matches!(refused, Err(ServiceError::Overloaded(_))), "{refused:?}");
        let light = pool.of_request().weighing(Weight::Light);
        let answer = tokio::time::timeout(SOON, light.run(|| Ok(7))).await;
        assert_eq!(answer.unwrap().unwrap(), 7);
        assert!(!waiting.is_finished());
    }

    #[tokio::test]
    async fn a_request_that_has_begun_waits_instead_of_being_turned_away() {
        let pool = Pool::new(1, 1);
        let request = pool.of_request();
        request.run(|| Ok(())).await.unwrap();
        while pool.heavy.places.available_permits() == 0 {
            tokio::task::yield_now().await;
        }
        let running = occupied(&pool).await;
        let next = tokio::spawn(async move { request.run(|| Ok(7)).await });
        tokio::time::sleep(Duration::from_millis(20)).await;
        assert!(!next.is_finished());
        drop(running);
        assert_eq!(tokio::time::timeout(SOON, next).await.unwrap().unwrap().unwrap(), 7);
    }

    #[tokio::test]
    async fn a_place_is_free_when_the_answer_is_there() {
        let lane = Lane::new(JOB, 1, 1);
        for round in 0..2000 {
            assert_eq!(lane.run(move || Ok(round)).await.unwrap(), round);
        }
    }

    #[tokio::test]
    async fn loops_of_light_work_stay_on_its_thread() {
        use rayon::prelude::*;
        let light = Pool::new(2, 1).of_request().weighing(Weight::Light);
        let task = || {
            let names = (0..64).into_par_iter().map(|_| std::thread::current().name().map(str::to_owned));
            Ok(names.collect::<Vec<_>>())
        };
        let names = light.run(task).await.unwrap();
        assert!(names.iter().all(|name| *name == names[0]), "{names:?}");
        assert!(names[0].as_ref().is_some_and(|name| name.starts_with(LIGHT)), "{names:?}");
    }

    #[tokio::test]
    async fn work_that_nobody_waits_for_is_skipped_or_hears_of_it() {
        let pool = Pool::new(1, 2);
        let running = occupied(&pool).await;
        let (skipped, context) = (pool.of_request(), pool.of_request().context());
        let (did, done) = channel();
        let given_up = tokio::time::timeout(
            Duration::from_millis(20),
            skipped.run(move || {
                let _ = did.send(());
                Ok(())
            }),
        );
        assert!(given_up.await.is_err());
        assert!(skipped.context().is_cancelled() && !context.is_cancelled());
        drop(running);
        assert!(done.recv_timeout(SOON).is_err(), "the sender was dropped unused");
        let other = pool.of_request();
        let context = other.context();
        let (stopped, stops) = channel();
        let looping = other.run(move || {
            while !context.is_cancelled() {
                std::thread::yield_now();
            }
            let _ = stopped.send(());
            Ok(())
        });
        assert!(tokio::time::timeout(Duration::from_millis(20), looping).await.is_err());
        stops.recv_timeout(SOON).unwrap();
    }
}
