//! A lane: a fixed number of compute threads and a bounded queue of tasks that take turns on them.

use std::num::NonZeroUsize;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::{Notify, oneshot};

use super::priority;
use super::task::{AnyOutcome, Outcome, Task, boxed};
use super::turns::{Entry, Turns, Who};
use super::{HEAVY, LIGHT};
use crate::service::app::error::ServiceError;
use crate::service::app::memory::Memory;
use crate::service::app::metrics;
use crate::service::app::work::Work;

/// Maximum wait for a place in a full queue: short bursts are served, and refused clients learn of it soon.
const PATIENCE: Duration = Duration::from_secs(1);

/// A fixed number of compute threads with a bounded queue of tasks.
#[derive(Debug, Clone)]
pub struct Lane(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    name: &'static str,
    threads: Threads,
    /// Number of tasks that run at the same time; equals the number of threads.
    slots: usize,
    /// Maximum number of tasks that wait or run.
    places: usize,
    /// Memory of the process: while half of it is in use, tasks run one at a time.
    memory: Option<Memory>,
    state: Mutex<State>,
    /// Signals that a place is free.
    freed: Notify,
}

#[derive(Debug)]
struct State {
    turns: Turns<Waiting>,
    running: Vec<Running>,
    last_id: u64,
}

/// A running task.
#[derive(Debug)]
struct Running {
    id: u64,
    since: Instant,
    /// Expected maximum duration.
    time: Option<Duration>,
}

/// A task that waits for its turn.
struct Waiting {
    task: Queueing,
    time: Option<Duration>,
}

impl std::fmt::Debug for Waiting {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Waiting").field("time", &self.time).finish_non_exhaustive()
    }
}

/// Instruction to a task that leaves the queue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Call {
    /// Run on this thread.
    Begin,
    /// Give up the place in the queue.
    GiveWay,
}

/// Consumes the call and returns the delivery of the outcome, which happens after the place is free.
type Queueing = Box<dyn FnOnce(Call) -> Deliver + Send>;
type Deliver = Box<dyn FnOnce() + Send>;

/// A unit of work for a thread.
type Job = Box<dyn FnOnce() + Send>;

/// End of a queued task.
enum Fate {
    Done(std::thread::Result<AnyOutcome>),
    GaveWay(Task),
}

/// Owner of a task and the known facts about it.
#[derive(Debug, Clone)]
pub(super) struct Ticket {
    pub(super) who: Who,
    pub(super) work: Work,
    /// Whether the request has begun before: it is then queued even if all places are taken.
    pub(super) admitted: bool,
    /// Expected maximum duration of the task.
    pub(super) time: Option<Duration>,
}

impl Ticket {
    /// Of a task of the service itself.
    pub(super) fn of_service() -> Self {
        Self { who: Who::service(), work: Work::UNKNOWN, admitted: false, time: None }
    }
}

/// Distribution of work over the threads of a lane.
#[derive(Debug)]
enum Threads {
    /// All threads share the loops of every task.
    Together(rayon::ThreadPool),
    /// Each thread takes a task for itself. Idle threads sleep; those of a thread pool would poll for work and yield,
    /// and the operating system makes yielding threads wait longest.
    Apart(Sender<Job>),
}

impl Threads {
    fn together(name: &'static str, count: usize) -> Self {
        let threads = rayon::ThreadPoolBuilder::new()
            .num_threads(count)
            .thread_name(move |i| format!("{name}-{i}"))
            .start_handler(move |_| priority::give_way(niceness(name)))
            .build()
            .expect("the system can start threads");
        Self::Together(threads)
    }

    fn apart(name: &'static str, count: usize) -> Self {
        let (sender, tasks) = channel::<Job>();
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
            // The threads end only when the sender is gone.
            Self::Apart(tasks) => tasks.send(Box::new(task)).expect("the threads wait for tasks"),
        }
    }
}

/// Runs tasks until the channel is closed.
fn serve(name: &str, tasks: &Mutex<Receiver<Job>>) {
    priority::give_way(niceness(name));
    // Runs loops of a task sequentially; otherwise they would be distributed over threads on all cores.
    let _alone = rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build();
    loop {
        let task = locked(tasks).recv();
        match task {
            Ok(task) => task(),
            Err(_) => return,
        }
    }
}

impl Lane {
    /// Threads called `name` that share the loops of every task (0: one per core), with a maximum of `tasks_each`
    /// waiting or running tasks per thread.
    pub fn new(name: &'static str, threads: usize, tasks_each: usize) -> Self {
        let threads = thread_count(threads);
        Self::with(name, Threads::together(name, threads), threads, threads * tasks_each, None)
    }

    /// Threads that share the loops of every task; their tasks run one at a time while memory is scarce.
    pub(super) fn together(name: &'static str, threads: usize, places: usize, memory: &Memory) -> Self {
        Self::with(name, Threads::together(name, threads), threads, places, Some(memory.clone()))
    }

    /// Threads that each run a task alone.
    pub(super) fn apart(name: &'static str, threads: usize, places: usize) -> Self {
        Self::with(name, Threads::apart(name, threads), threads, places, None)
    }

    fn with(
        name: &'static str,
        threads: Threads,
        slots: usize,
        places: usize,
        memory: Option<Memory>,
    ) -> Self {
        let state = State { turns: Turns::new(slots), running: Vec::new(), last_id: 0 };
        let (state, freed) = (Mutex::new(state), Notify::new());
        Self(Arc::new(Inner { name, threads, slots, places, memory, state, freed }))
    }

    /// Runs `task` for the service itself and waits without blocking an async thread.
    ///
    /// # Errors
    /// [`ServiceError::Overloaded`] if too many tasks wait; [`ServiceError::Internal`] if the task panicked (a bug: the
    /// panic stays in the task).
    pub fn run<T: Send + 'static>(
        &self,
        task: impl FnOnce() -> Result<T, ServiceError> + Send + 'static,
    ) -> Outcome<'_, T> {
        Outcome::of(self.run_for(Ticket::of_service(), boxed(task)))
    }

    /// Runs `task` for the owner of the ticket when its turn comes. If the caller stops waiting before that, the task
    /// is dropped.
    ///
    /// If all places are taken, a task of a caller with more places is evicted; otherwise the task waits for a place
    /// for at most [`PATIENCE`]. Tasks of `admitted` requests are queued in any case.
    ///
    /// # Errors
    /// Those of [`Lane::run`].
    pub(super) async fn run_for(&self, ticket: Ticket, task: Task) -> AnyOutcome {
        let (until, mut task) = (tokio::time::Instant::now() + PATIENCE, task);
        loop {
            let mut freed = std::pin::pin!(self.0.freed.notified());
            freed.as_mut().enable();
            match self.0.enter(&ticket, task) {
                Ok(queued) => match queued.fate().await {
                    Some(Fate::Done(Ok(outcome))) => return outcome,
                    Some(Fate::Done(Err(_))) => {
                        return Err(ServiceError::Internal("a compute task panicked".into()));
                    }
                    Some(Fate::GaveWay(again)) => task = again,
                    None => return Err(ServiceError::Internal("a compute task was dropped".into())),
                },
                Err(again) => task = again,
            }
            if tokio::time::timeout_at(until, freed).await.is_err() {
                metrics::compute_refused(self.0.name);
                return Err(ServiceError::Overloaded("too many computations are waiting".into()));
            }
        }
    }

    /// Whether every thread has exceeded the expected duration of its task by more than `margin`.
    pub(super) fn is_stuck(&self, margin: Duration) -> bool {
        let state = locked(&self.0.state);
        let late =
            |running: &&Running| running.time.is_some_and(|time| running.since.elapsed() > time + margin);
        state.running.iter().filter(late).count() == self.0.slots
    }

    /// Name of the lane.
    pub(super) fn name(&self) -> &'static str {
        self.0.name
    }

    #[cfg(test)]
    pub(super) fn held(&self) -> usize {
        locked(&self.0.state).turns.held()
    }
}

/// A task in the queue of a lane; dropping it removes the task.
struct Queued {
    lane: Arc<Inner>,
    who: Who,
    id: u64,
    fate: oneshot::Receiver<Fate>,
}

impl Queued {
    async fn fate(mut self) -> Option<Fate> {
        (&mut self.fate).await.ok()
    }
}

impl Drop for Queued {
    fn drop(&mut self) {
        let gone = locked(&self.lane.state).turns.remove(&self.who, self.id);
        if gone.is_some() {
            self.lane.freed.notify_one();
        }
    }
}

impl Inner {
    /// Queues a task if there is a place for it.
    fn enter(self: &Arc<Self>, ticket: &Ticket, task: Task) -> Result<Queued, Task> {
        let mut state = locked(&self.state);
        let mut evicted = None;
        if !ticket.admitted && state.turns.held() >= self.places {
            evicted = state.turns.evict_for(&ticket.who);
            if evicted.is_none() {
                return Err(task);
            }
        }
        state.last_id += 1;
        let (id, who) = (state.last_id, ticket.who.clone());
        let (answer, fate) = oneshot::channel();
        let entry = Entry {
            id,
            who: who.clone(),
            seconds: ticket.work.seconds(),
            evictable: !ticket.admitted,
            task: Waiting { task: self.queueing(task, answer), time: ticket.time },
        };
        state.turns.push(entry, Instant::now());
        self.begin(&mut state);
        drop(state);
        if let Some(evicted) = evicted {
            (evicted.task.task)(Call::GiveWay)();
        }
        Ok(Queued { lane: Arc::clone(self), who, id, fate })
    }

    fn queueing(&self, task: Task, answer: oneshot::Sender<Fate>) -> Queueing {
        let waiting = metrics::compute_waits(self.name);
        Box::new(move |call| {
            let fate = match call {
                Call::GiveWay => Fate::GaveWay(task),
                Call::Begin => {
                    let _working = waiting.begin();
                    Fate::Done(std::panic::catch_unwind(std::panic::AssertUnwindSafe(task)))
                }
            };
            // The receiver is gone if the client has disconnected.
            Box::new(move || drop(answer.send(fate)))
        })
    }

    /// Number of tasks that may run now. With one task at a time, the next begins when it has ended.
    fn free_slots(&self) -> usize {
        if self.memory.as_ref().is_some_and(Memory::is_scarce) { 1 } else { self.slots }
    }

    /// Starts the next tasks on free threads.
    fn begin(self: &Arc<Self>, state: &mut State) {
        while state.running.len() < self.free_slots() {
            let now = Instant::now();
            let Some(entry) = state.turns.next(now) else { return };
            state.running.push(Running { id: entry.id, since: now, time: entry.task.time });
            let lane = Arc::clone(self);
            self.threads.spawn(move || lane.work(entry));
        }
    }

    /// Runs a task on a thread of the lane.
    fn work(self: Arc<Self>, entry: Entry<Waiting>) {
        let Entry { id, who, seconds, task, .. } = entry;
        let begun = Instant::now();
        let deliver = (task.task)(Call::Begin);
        let taken = begun.elapsed().as_secs_f64();
        metrics::compute_ended(self.name, seconds, taken);
        let mut state = locked(&self.state);
        state.turns.end(&who, seconds, taken);
        state.running.retain(|running| running.id != id);
        self.begin(&mut state);
        drop(state);
        // Before delivery: the receiver of the outcome may request the place at once.
        self.freed.notify_one();
        deliver();
    }
}

/// Number of threads; 0 means one per core.
pub fn thread_count(threads: usize) -> usize {
    let cores = || std::thread::available_parallelism().map_or(1, NonZeroUsize::get);
    if threads == 0 { cores() } else { threads }
}

/// Niceness of the threads of a lane.
fn niceness(lane: &str) -> i32 {
    match lane {
        LIGHT => priority::LIGHT,
        HEAVY => priority::HEAVY,
        _ => priority::JOB,
    }
}

/// Locks a mutex, ignoring poison: no critical section leaves a partial change.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
