//! Metrics of schedulers and executors, in the text format of Prometheus.

use std::fmt::{self, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use axum::Router;
use axum::http::header::CONTENT_TYPE;
use axum::routing::get;
use ballista_core::JobId;
use ballista_core::error::Result as BallistaResult;
use ballista_scheduler::cluster::ClusterState;
use ballista_scheduler::metrics::SchedulerMetricsCollector;

use super::network::{Address, BUILD};
use crate::EngineError;
use crate::objects::Counters;

/// Ticks of a second in the times that Linux tells of a process.
const TICKS: f64 = 100.0;

/// Counts of the work of a scheduler.
#[derive(Debug, Default)]
pub(crate) struct Jobs {
    submitted: AtomicU64,
    completed: AtomicU64,
    failed: AtomicU64,
    cancelled: AtomicU64,
    waiting: AtomicU64,
}

fn count(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}

impl SchedulerMetricsCollector for Jobs {
    fn record_submitted(&self, _: &JobId, _: u64, _: u64) {
        count(&self.submitted);
    }

    fn record_completed(&self, _: &JobId, _: u64, _: u64) {
        count(&self.completed);
    }

    fn record_failed(&self, _: &JobId, _: u64, _: u64) {
        count(&self.failed);
    }

    fn record_cancelled(&self, _: &JobId) {
        count(&self.cancelled);
    }

    fn set_pending_tasks_queue_size(&self, value: u64) {
        self.waiting.store(value, Ordering::Relaxed);
    }

    fn gather_metrics(&self) -> BallistaResult<Option<(Vec<u8>, String)>> {
        Ok(None)
    }
}

/// The process whose metrics are answered.
#[derive(Clone)]
pub(crate) enum Process {
    /// A scheduler: its jobs, and its executors.
    Scheduler(Arc<Jobs>, Arc<dyn ClusterState>),
    /// An executor: counts of its store.
    Executor(Arc<Counters>),
}

/// Metrics, a line for each value.
#[derive(Default)]
struct Text(String);

impl Text {
    fn add(&mut self, name: &str, kind: &str, help: &str, value: impl fmt::Display) {
        // A string takes all that is written.
        let _ = writeln!(self.0, "# HELP {name} {help}\n# TYPE {name} {kind}\n{name} {value}");
    }

    fn counter(&mut self, name: &str, help: &str, value: &AtomicU64) {
        self.add(&format!("shapelex_engine_{name}_total"), "counter", help, value.load(Ordering::Relaxed));
    }
}

impl Process {
    async fn text(self) -> String {
        let mut text = Text::default();
        let role = match &self {
            Self::Scheduler(..) => "scheduler",
            Self::Executor(..) => "executor",
        };
        let _ = writeln!(
            text.0,
            "# HELP shapelex_engine_info Build of the process.\n# TYPE shapelex_engine_info gauge\n\
             shapelex_engine_info{{build=\"{BUILD}\",role=\"{role}\"}} 1"
        );
        match self {
            Self::Scheduler(jobs, cluster) => {
                let executors = cluster.registered_executor_metadata().await.len();
                text.add(
                    "shapelex_engine_executors",
                    "gauge",
                    "Executors that give signs of life.",
                    executors,
                );
                let waiting = jobs.waiting.load(Ordering::Relaxed);
                text.add(
                    "shapelex_engine_tasks_waiting",
                    "gauge",
                    "Tasks that wait for an executor.",
                    waiting,
                );
                text.counter("jobs_submitted", "Jobs that clients submitted.", &jobs.submitted);
                text.counter("jobs_completed", "Jobs whose results are there.", &jobs.completed);
                text.counter("jobs_failed", "Jobs that failed.", &jobs.failed);
                text.counter("jobs_cancelled", "Jobs that clients cancelled.", &jobs.cancelled);
            }
            Self::Executor(counters) => {
                text.counter("units", "Parts, or groups of them, that were computed.", &counters.units);
                text.counter(
                    "failures",
                    "Parts, or groups of them, that could not be computed.",
                    &counters.failures,
                );
                text.counter("read_bytes", "Bytes that were read from the store.", &counters.read_bytes);
                text.counter(
                    "written_bytes",
                    "Bytes that were written to the store.",
                    &counters.written_bytes,
                );
                text.counter("store_retries", "Requests to the store that were repeated.", &counters.retries);
            }
        }
        add_process(&mut text);
        text.0
    }
}

/// Memory and processor time of this process, where the system tells them.
fn add_process(text: &mut Text) {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let resident = status
        .lines()
        .find_map(|line| line.strip_prefix("VmRSS:")?.trim().strip_suffix(" kB")?.parse::<u64>().ok());
    if let Some(kilobytes) = resident {
        text.add("process_resident_memory_bytes", "gauge", "Memory of the process.", 1024 * kilobytes);
    }
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The fields after the name of the program, which may have spaces.
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |k: usize| fields.get(k)?.parse::<f64>().ok();
    if let (Some(user), Some(system)) = (ticks(11), ticks(12)) {
        let seconds = (user + system) / TICKS;
        text.add("process_cpu_seconds_total", "counter", "Processor time of the process.", seconds);
    }
}

/// Answers `GET /metrics` until the process ends.
///
/// # Errors
/// An address that is taken or is none of this machine.
pub(crate) async fn serve(process: Process, address: &Address) -> Result<(), EngineError> {
    let listener =
        tokio::net::TcpListener::bind((address.host.trim_matches(['[', ']']), address.port)).await?;
    let answer = move || async move { ([(CONTENT_TYPE, "text/plain; version=0.0.4")], process.text().await) };
    let routes = Router::new().route("/metrics", get(answer));
    tokio::spawn(async move { axum::serve(listener, routes).await });
    Ok(())
}
