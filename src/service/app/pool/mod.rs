//! Bounded pool of threads for computations. Only those that take less time than a round trip to another thread run on
//! the async thread that has read the request.
//!
//! The pool has two lanes with separate threads, so that light requests never wait behind heavy ones. In each lane,
//! tenants take turns by the work done for them, and so do the keys within a tenant. Each lane holds a bounded number
//! of tasks, including those that wait; when it is full, the caller with most tasks loses one. On Linux the threads of
//! the other lanes have a lower priority: when cores are scarce, light requests run first. While memory is scarce, heavy
//! requests run one at a time, so that their working memory does not add up.
//!
//! * [`Pool`] — the lanes as seen by one request;
//! * `lane` — threads and the tasks that wait for them; `task` — tasks of any outcome; `turns` — order of tasks; `readers` — threads for long bodies;
//!   `places` — who has one of them for a file;
//!   `priority` — priorities of threads;
//! * [`work`](crate::service::cost::requests) — predicted cost of a request.

mod lane;
mod places;
mod priority;
mod readers;
mod task;
mod turns;

use std::any::Any;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use bytes::Bytes;

use self::lane::Ticket;
pub use self::lane::{Lane, thread_count};
use self::readers::Readers;
use self::task::{AnyOutcome, Outcome, Planning, Reading, Task, any, boxed};
use self::turns::Who;
use super::error::ServiceError;
use super::limits::Limits;
use super::memory::Memory;
use super::metrics;
use super::progress::JobContext;
use super::work::Work;
use crate::domain::access::Principal;

/// Name of the lane for light requests.
const LIGHT: &str = "light";
/// Name of the lane for heavy requests.
const HEAVY: &str = "compute";
/// Name of the lanes of job workers.
pub const JOB: &str = "job";
pub(crate) const LANES: [&str; 3] = [LIGHT, HEAVY, JOB];
/// Lanes of requests.
pub(crate) const REQUEST_LANES: [&str; 2] = [LIGHT, HEAVY];
/// Maximum number of waiting or running tasks in the light lane.
const LIGHT_QUEUE: usize = 256;
/// Maximum number of waiting or running tasks in the heavy lane, per thread.
const HEAVY_QUEUE: usize = 4;
/// Maximum size of a body that is parsed on the async thread: about 0.1 ms, on a busy machine less than a round trip to
/// another thread.
const TINY_BYTES: usize = 16 << 10;
/// Time by which a task may exceed its duration before its thread counts as stuck: a task checks the time only between
/// two steps.
const STUCK_MARGIN: Duration = Duration::from_secs(10);

/// The two lanes as seen by one request.
#[derive(Debug, Clone)]
pub struct Pool {
    light: Lane,
    heavy: Lane,
    readers: Readers,
    who: Who,
    work: Work,
    /// Maximum predicted seconds of a request.
    most: f64,
    /// Maximum time of a request that computes.
    time: Duration,
    /// The request; `None` if the service itself computes.
    request: Option<Arc<Request>>,
}

/// State of a request that computes.
#[derive(Debug, Default)]
struct Request {
    /// Whether the request has had a place in the light lane; its further light tasks are not refused.
    read: AtomicBool,
    /// Whether the request has had a place in the heavy lane; none of its further tasks is refused.
    admitted: AtomicBool,
    context: JobContext,
}

/// Next step of a request after reading its body.
enum Step {
    Done(Box<dyn Any + Send>),
    Next(Work, Task),
}

impl Pool {
    /// Lanes of `threads` threads each; 0 means one per core.
    pub fn new(threads: usize, limits: &Limits, memory: &Memory) -> Self {
        let threads = thread_count(threads);
        let places = if limits.heavy_requests == 0 { threads * HEAVY_QUEUE } else { limits.heavy_requests };
        Self {
            light: Lane::apart(LIGHT, threads, LIGHT_QUEUE),
            heavy: Lane::together(HEAVY, threads, places, memory),
            readers: Readers::new(threads),
            who: Who::service(),
            work: Work::UNKNOWN,
            most: limits.request_work.as_secs_f64(),
            time: limits.compute_time,
            request: None,
        }
    }

    /// The same lanes for a new request of `principal`.
    pub(crate) fn for_request(&self, principal: &Principal) -> Self {
        Self { who: Who::of(principal), request: Some(Arc::default()), work: Work::UNKNOWN, ..self.clone() }
    }

    /// The same request with a `deadline` for its work.
    #[must_use]
    pub fn until(&self, deadline: Instant) -> Self {
        let context = self.context().until(deadline);
        let request = self.request.as_ref().map(|_| Arc::new(Request { context, ..Request::default() }));
        Self { request, ..self.clone() }
    }

    /// The same lanes for a job: its work stops with it, and none of its tasks is refused.
    pub(crate) fn of_job(&self, context: &JobContext) -> Self {
        let (read, admitted) = (AtomicBool::new(true), AtomicBool::new(true));
        let request = Request { read, admitted, context: context.clone() };
        Self { request: Some(Arc::new(request)), ..self.clone() }
    }

    /// The same request with a prediction of its work.
    pub fn weighing(&self, work: Work) -> Self {
        Self { work, ..self.clone() }
    }

    /// Checks that a request may take so much work in all.
    ///
    /// # Errors
    /// [`ServiceError::TooCostly`].
    pub fn check(&self, work: Work) -> Result<(), ServiceError> {
        work.check(self.most)
    }

    /// Signals the work of the request to stop when the client stops waiting or its time is over.
    pub fn context(&self) -> JobContext {
        self.request.as_ref().map_or_else(JobContext::default, |request| request.context.clone())
    }

    /// Name of a lane in which all threads have been at one task for too long, if there is one.
    pub fn stuck_lane(&self) -> Option<&'static str> {
        let stuck = [&self.light, &self.heavy].into_iter().find(|lane| lane.is_stuck(STUCK_MARGIN));
        stuck.map(Lane::name)
    }

    /// Runs `read`, which reads a long body, on threads of lower priority. A request that ends early cancels it.
    ///
    /// # Errors
    /// [`ServiceError::Cancelled`] if the process ends.
    pub async fn read_body<T: Send + 'static>(
        &self,
        read: impl Future<Output = T> + Send + 'static,
    ) -> Result<T, ServiceError> {
        self.readers.run(read).await
    }

    /// Runs `read`, which may wait for a client, on a separate thread with lower priority.
    ///
    /// # Errors
    /// Those of `read`; [`ServiceError::Overloaded`] if too many files are being read.
    pub async fn read_blocking<T: Send + 'static>(
        &self,
        read: impl FnOnce() -> Result<T, ServiceError> + Send + 'static,
    ) -> Result<T, ServiceError> {
        self.readers.run_blocking(&self.who, read).await
    }

    /// Parses a body: at once if it is tiny, otherwise in the lane for its length.
    ///
    /// # Errors
    /// Those of `read`, and of [`Pool::run`].
    pub fn read<T: Send + 'static>(
        &self,
        body: Bytes,
        read: impl FnOnce(&[u8]) -> Result<T, ServiceError> + Send + 'static,
    ) -> Outcome<'_, T> {
        Outcome::of(self.read_any(body, Box::new(move |body| read(body).map(any))))
    }

    async fn read_any(&self, body: Bytes, read: Reading) -> AnyOutcome {
        if body.len() <= TINY_BYTES {
            return read(&body);
        }
        self.weighing(Work::reading(body.len())).run_any(Box::new(move || read(&body))).await
    }

    /// Parses a body and executes the request in it: `plan` predicts its work and thereby chooses the lane, or for an instant
    /// this thread. The task must not wait for anything, since it may run on an async thread.
    ///
    /// # Errors
    /// Those of `plan`, of the planned task and of [`Pool::run`]; [`ServiceError::TooCostly`] if the predicted work
    /// exceeds the maximum for a request.
    pub fn run_planned<T: Send + 'static, F>(
        &self,
        body: Bytes,
        plan: impl FnOnce(&[u8]) -> Result<(Work, F), ServiceError> + Send + 'static,
    ) -> Outcome<'_, T>
    where
        F: FnOnce() -> Result<T, ServiceError> + Send + 'static,
    {
        let plan = move |body: &[u8]| plan(body).map(|(work, task)| (work, boxed(task)));
        Outcome::of(self.run_any_planned(body, Box::new(plan)))
    }

    async fn run_any_planned(&self, body: Bytes, plan: Planning) -> AnyOutcome {
        let most = self.most;
        if body.len() <= TINY_BYTES {
            let (work, task) = plan(&body)?;
            work.check(most)?;
            if work.is_instant() {
                self.context().check()?;
                return here(work, task);
            }
            return self.weighing(work).run_any(holding(body, task)).await;
        }
        let reading = Work::reading(body.len());
        let lane = self.weighing(reading);
        let step = lane.run(move || {
            let (work, task) = plan(&body)?;
            work.check(most)?;
            let task = holding(body, task);
            // The task belongs to the lane that has parsed the body: run it here.
            if work.is_moment() || !reading.is_moment() {
                metrics::compute_planned(if reading.is_moment() { LIGHT } else { HEAVY }, work.seconds());
                task().map(Step::Done)
            } else {
                Ok(Step::Next(work, task))
            }
        });
        match step.await? {
            Step::Done(outcome) => Ok(outcome),
            Step::Next(work, task) => self.weighing(work).run_any(task).await,
        }
    }

    /// Runs `task` and waits without blocking an async thread. If the caller stops waiting, the request is cancelled: a
    /// queued task is removed, and a running one is notified through [`Pool::context`].
    ///
    /// # Errors
    /// [`ServiceError::Overloaded`] if too many tasks wait; [`ServiceError::Internal`] if the task panicked (a bug: the
    /// panic stays in the task).
    pub fn run<T: Send + 'static>(
        &self,
        task: impl FnOnce() -> Result<T, ServiceError> + Send + 'static,
    ) -> Outcome<'_, T> {
        Outcome::of(self.run_any(boxed(task)))
    }

    /// As [`Pool::run`]; short work is done on this thread, so that `task` must not wait for anything.
    ///
    /// # Errors
    /// As [`Pool::run`].
    pub fn run_unwaiting<T: Send + 'static>(
        &self,
        task: impl FnOnce() -> Result<T, ServiceError> + Send + 'static,
    ) -> Outcome<'_, T> {
        Outcome::of(self.run_any_unwaiting(boxed(task)))
    }

    async fn run_any_unwaiting(&self, task: Task) -> AnyOutcome {
        if !self.work.is_instant() {
            return self.run_any(task).await;
        }
        self.context().check()?;
        here(self.work, task)
    }

    async fn run_any(&self, task: Task) -> AnyOutcome {
        let light = self.work.is_moment();
        let lane = if light { &self.light } else { &self.heavy };
        let Some(request) = &self.request else { return lane.run_for(Ticket::of_service(), task).await };
        let waiting = Waiting(Some(&request.context));
        let had = |flag: &AtomicBool| flag.load(Ordering::Relaxed);
        let admitted = had(&request.admitted) || (light && had(&request.read));
        let ticket = Ticket { who: self.who.clone(), work: self.work, admitted, time: Some(self.time) };
        let begun = Arc::clone(request);
        let task = move || {
            let begins = if light { &begun.read } else { &begun.admitted };
            begins.store(true, Ordering::Relaxed);
            begun.context.check().and_then(|()| task())
        };
        let outcome = lane.run_for(ticket, Box::new(task)).await;
        waiting.ended();
        outcome
    }
}

/// Runs `task` on this thread.
fn here(work: Work, task: Task) -> AnyOutcome {
    let begun = Instant::now();
    let outcome = task();
    metrics::compute_ended(LIGHT, work.seconds(), begun.elapsed().as_secs_f64());
    outcome
}

/// A task that holds the memory reserved for a body, and for data parsed from it, until it ends.
fn holding(body: Bytes, task: Task) -> Task {
    Box::new(move || {
        let outcome = task();
        drop(body);
        outcome
    })
}

/// A caller that waits for an outcome; dropping it early interrupts the work.
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
    use std::sync::mpsc::channel;

    use tokio::sync::oneshot;

    use super::*;
    use crate::service::app::memory::Purpose;

    const SOON: Duration = Duration::from_secs(20);

    fn pool(threads: usize, heavy_requests: usize) -> Pool {
        let limits = Limits { heavy_requests, ..Limits::default() };
        Pool::new(threads, &limits, &Memory::new(limits.quota()))
    }

    fn of(pool: &Pool, tenant: &str) -> Pool {
        pool.for_request(&Principal::system(tenant))
    }

    /// A task of the heavy lane that runs until the returned value is dropped; it runs when this function returns.
    async fn occupied(pool: &Pool) -> std::sync::mpsc::Sender<()> {
        let (release, released) = channel::<()>();
        let (begun, begins) = oneshot::channel();
        let pool = of(pool, "a");
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
        let pool = self::pool(1, 2);
        let _running = occupied(&pool).await;
        let waiting = tokio::spawn({
            let pool = of(&pool, "a");
            async move { pool.run(|| Ok(())).await }
        });
        while pool.heavy.held() < 2 {
            tokio::task::yield_now().await;
        }
        let refused = of(&pool, "a").run(|| Ok(())).await;
        assert!(matches!(refused, Err(ServiceError::Overloaded(_))), "{refused:?}");
        let light = of(&pool, "a").weighing(Work::MOMENT);
        let answer = tokio::time::timeout(SOON, light.run(|| Ok(7))).await;
        assert_eq!(answer.unwrap().unwrap(), 7);
        assert!(!waiting.is_finished());
    }

    #[tokio::test]
    async fn heavy_tasks_run_one_at_a_time_while_memory_is_scarce() {
        let limits = Limits { memory: 1 << 30, ..Limits::default() };
        let memory = Memory::new(limits.quota());
        let pool = Pool::new(2, &limits, &memory);
        let room = memory.hold(Purpose::Bodies, 600 << 20).unwrap();
        let first = occupied(&pool).await;
        let next = tokio::spawn({
            let pool = of(&pool, "a");
            async move { pool.run(|| Ok(7)).await }
        });
        tokio::time::sleep(Duration::from_millis(20)).await;
        assert!(!next.is_finished(), "it waits for the first");
        drop(first);
        assert_eq!(tokio::time::timeout(SOON, next).await.unwrap().unwrap().unwrap(), 7);
        drop(room);
        let _first = occupied(&pool).await;
        tokio::time::timeout(SOON, of(&pool, "a").run(|| Ok(()))).await.unwrap().unwrap();
    }

    #[tokio::test]
    async fn a_request_that_has_begun_waits_instead_of_being_turned_away() {
        let pool = self::pool(1, 1);
        let request = of(&pool, "a");
        request.run(|| Ok(())).await.unwrap();
        while pool.heavy.held() > 0 {
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
        let light = of(&pool(2, 1), "a").weighing(Work::MOMENT);
        let task = || {
            let names = (0..64).into_par_iter().map(|_| std::thread::current().name().map(str::to_owned));
            Ok(names.collect::<Vec<_>>())
        };
        let names = light.run(task).await.unwrap();
        assert!(names.iter().all(|name| *name == names[0]), "{names:?}");
        assert!(names[0].as_ref().is_some_and(|name| name.starts_with(LIGHT)), "{names:?}");
    }

    #[tokio::test]
    async fn abandoned_work_is_skipped_or_interrupted() {
        let pool = self::pool(1, 2);
        let running = occupied(&pool).await;
        let (skipped, context) = (of(&pool, "a"), of(&pool, "a").context());
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
        let other = of(&pool, "a");
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

    /// Sends a task that reports its name when it runs.
    fn send(
        pool: &Pool,
        tenant: &'static str,
        said: &std::sync::mpsc::Sender<&'static str>,
    ) -> tokio::task::JoinHandle<Result<(), ServiceError>> {
        let (pool, said) = (of(pool, tenant), said.clone());
        tokio::spawn(async move {
            pool.run(move || {
                let _ = said.send(tenant);
                Ok(())
            })
            .await
        })
    }

    /// Waits until the given number of tasks of the heavy lane wait or run.
    async fn held(pool: &Pool, count: usize) {
        while pool.heavy.held() != count {
            tokio::task::yield_now().await;
        }
    }

    #[tokio::test]
    async fn the_queue_of_one_tenant_is_not_before_another() {
        let pool = self::pool(1, 64);
        let running = occupied(&pool).await;
        let (said, heard) = channel();
        let mut tasks: Vec<_> = (0..40).map(|_| send(&pool, "a", &said)).collect();
        held(&pool, 41).await;
        tasks.extend((0..3).map(|_| send(&pool, "b", &said)));
        held(&pool, 44).await;
        drop(running);
        for task in tasks {
            tokio::time::timeout(SOON, task).await.unwrap().unwrap().unwrap();
        }
        let order: Vec<&str> = heard.try_iter().collect();
        let last = order.iter().rposition(|name| *name == "b").unwrap();
        assert!(last < 8, "the tasks of b were done when {last} others were: {order:?}");
    }

    #[tokio::test]
    async fn who_fills_all_places_gives_some_to_others_and_waits_for_them() {
        let pool = self::pool(1, 8);
        let running = occupied(&pool).await;
        let (said, heard) = channel();
        let many: Vec<_> = (0..64).map(|_| send(&pool, "a", &said)).collect();
        held(&pool, 8).await;
        let few: Vec<_> = (0..4).map(|_| send(&pool, "b", &said)).collect();
        tokio::task::yield_now().await;
        tokio::time::sleep(Duration::from_millis(20)).await;
        drop(running);
        for task in few {
            let outcome = tokio::time::timeout(SOON, task).await.unwrap().unwrap();
            assert!(outcome.is_ok(), "{outcome:?}");
        }
        // Tasks of caller a that found no place waited for one.
        for task in many {
            assert!(tokio::time::timeout(SOON, task).await.unwrap().unwrap().is_ok());
        }
        assert_eq!(heard.try_iter().filter(|name| *name == "a").count(), 64);
    }

    #[tokio::test]
    async fn the_time_of_a_request_ends_its_work() {
        let pool = of(&self::pool(1, 2), "a").until(Instant::now() + Duration::from_millis(50));
        let context = pool.context();
        let looping = pool.run(move || {
            while !context.is_cancelled() {
                std::thread::yield_now();
            }
            context.check()
        });
        let ended = tokio::time::timeout(SOON, looping).await.unwrap();
        assert!(matches!(ended, Err(ServiceError::Cancelled)), "{ended:?}");
    }

    #[tokio::test]
    async fn a_lane_is_stuck_when_all_its_threads_are_beyond_their_time() {
        let mut pool = self::pool(2, 8);
        pool.time = Duration::from_millis(1);
        let first = occupied(&pool).await;
        std::thread::sleep(Duration::from_millis(20));
        assert!(!pool.heavy.is_stuck(Duration::ZERO), "one of two threads is free");
        let second = occupied(&pool).await;
        std::thread::sleep(Duration::from_millis(20));
        assert!(pool.heavy.is_stuck(Duration::ZERO) && !pool.light.is_stuck(Duration::ZERO));
        assert_eq!(pool.stuck_lane(), None, "not before the margin is over");
        drop((first, second));
        held(&pool, 0).await;
        assert!(!pool.heavy.is_stuck(Duration::ZERO));
    }

    #[tokio::test]
    async fn plans_go_where_their_work_belongs_and_too_much_is_refused() {
        let pool = self::pool(1, 2);
        let lane = |work: Work, body: usize| {
            let plan = move |_: &[u8]| Ok((work, || Ok(std::thread::current().name().map(str::to_owned))));
            let pool = of(&pool, "a");
            async move { pool.run_planned(Bytes::from(vec![b' '; body]), plan).await }
        };
        for (work, body, thread) in [
            (Work::MOMENT, 10, LIGHT),
            (Work::UNKNOWN, 10, HEAVY),
            (Work::MOMENT, 100_000, LIGHT),
            (Work::UNKNOWN, 100_000, HEAVY),
            (Work::MOMENT, 10_000_000, HEAVY),
        ] {
            let found = lane(work, body).await.unwrap().unwrap();
            assert!(found.starts_with(thread), "{work:?} in {body} bytes ran on {found}");
        }
        let here = lane(Work::from_seconds(2e-4), 10).await.unwrap();
        assert_eq!(here.as_deref(), std::thread::current().name(), "an instant");
        let refused = lane(Work::from_seconds(35.0), 10).await;
        assert!(matches!(refused, Err(ServiceError::TooCostly { .. })), "{refused:?}");
    }
}
