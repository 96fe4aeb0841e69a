//! Passes over whole cohorts on the engine: a separate program that keeps revisions of cohorts as files and computes on one machine or on
//! a cluster, with the bits of this process. `docs/scale.md` describes the program. Jobs that learn and stored means use it.
//!
//! The revision is written as files before the first pass, and forgotten at the end: shapes that are erased here must not live on
//! there. If the program fails, this process computes the pass, and names the faults of the shapes. Codes of an epoch start from those
//! of the epoch before, which the engine keeps; so if it fails to code, learning begins again in this process.

use std::io::{BufRead, BufReader, Read, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use arrow_array::{ArrayRef, FixedSizeListArray, Float64Array, RecordBatch, StringArray};
use arrow_ipc::writer::StreamWriter;
use arrow_schema::{ArrowError, DataType, Field, Schema};
use serde_json::{Value, json};

use super::source::{Distribute, StoredShapes, Work};
use crate::analysis::accumulate::{MergePart, PART, ShapeSource};
use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::Mirror;
use crate::analysis::dictionary::learning::{MAX_GROUPS, Schedule};
use crate::analysis::dictionary::method::Method;
use crate::analysis::pass::{CodeGroup, Group};
use crate::analysis::transformation::Transformation;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::service::app::{App, ServiceError, memory};

/// Interval at which a running program is looked at.
const LOOK: Duration = Duration::from_millis(100);

/// Lines of a failing program that are kept for the log.
const KEPT_LINES: usize = 5;

/// Maximum number of coordinates of a shape that the engine takes.
const MAX_NUMBERS: usize = 32_767;

/// Prefixes of the variables that the program gets: nothing else of this process is its business.
const VARIABLES: [&str; 5] = ["PATH", "HOME", "TMPDIR", "AWS_", "SHAPELEX_ENGINE_"];

/// The engine that this process may start.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct EngineSettings {
    /// Path of the program; empty for none.
    pub program: PathBuf,
    /// Its store: a folder, or a bucket.
    pub store: String,
    /// Scheduler of a cluster, host:port; empty if the program computes itself.
    pub scheduler: String,
    /// Number of shapes from which on it computes.
    pub min_shapes: usize,
}

impl App {
    /// The same context, with an engine.
    pub fn with_engine(self, settings: EngineSettings) -> Self {
        self.put_state(settings);
        self
    }
}

/// The passes that the engine may compute.
pub(crate) struct Passes<'a> {
    /// The cohort at the revision of its shapes, with mirror images as they are treated.
    pub(crate) cohort: &'a Cohort,
    /// Filter of the shapes: there are files of whole cohorts alone.
    pub(crate) filter: &'a ShapeFilter,
    /// Class of transformations that is removed.
    pub(crate) transformation: &'a Transformation,
    /// Alignment of the shapes.
    pub(crate) alignment: Alignment,
    /// Result that the passes are part of.
    pub(crate) purpose: Purpose<'a>,
}

/// The computation that wants passes.
pub(crate) enum Purpose<'a> {
    /// A stored mean.
    Mean,
    /// A job that learns a dictionary.
    Learning {
        /// Id of the job.
        job: &'a str,
        /// Number of the attempt.
        attempt: u32,
        /// The method, which says how shapes are coded.
        method: &'a Method,
    },
}

impl Passes<'_> {
    /// Id of the cohort at rest. Means and jobs have copies that the others do not remove.
    fn id(&self) -> String {
        let mirrored = if self.cohort.spec.mirror == Mirror::Allow { "-mirrored" } else { "" };
        let mean = if matches!(self.purpose, Purpose::Mean) { "-mean" } else { "" };
        format!("{}{mirrored}{mean}", self.cohort.id)
    }

    /// The name in the log: the id of the job.
    fn name(&self) -> &str {
        match self.purpose {
            Purpose::Mean => "mean",
            Purpose::Learning { job, .. } => job,
        }
    }
}

/// The engine, for one computation.
pub(crate) struct AtEngine<'a> {
    settings: Arc<EngineSettings>,
    passes: Passes<'a>,
    /// Id of the cohort at rest.
    id: String,
    has_begun: AtomicBool,
    is_written: AtomicBool,
    has_failed: AtomicBool,
    has_failed_to_code: AtomicBool,
}

impl<'a> AtEngine<'a> {
    /// The engine for passes, if there is one and they are over all shapes of a large cohort, which are so many.
    pub(crate) fn of(app: &App, passes: Passes<'a>, shapes: usize) -> Option<Self> {
        let settings = app.state::<EngineSettings>();
        let representation = &passes.cohort.spec.representation;
        let suits = !settings.program.as_os_str().is_empty()
            && shapes >= settings.min_shapes
            && *passes.filter == ShapeFilter::default()
            && representation.size() * representation.dimension() <= MAX_NUMBERS;
        let (id, none) = (passes.id(), || AtomicBool::new(false));
        let (has_begun, is_written, has_failed, has_failed_to_code) = (none(), none(), none(), none());
        suits.then_some(Self { settings, passes, id, has_begun, is_written, has_failed, has_failed_to_code })
    }

    /// The result of a pass over the revision, which is written before the first one.
    fn compute(&self, shapes: &StoredShapes<'_>, work: &Value) -> Result<Answer, Failure> {
        if !self.is_written.load(Ordering::Relaxed) {
            self.has_begun.store(true, Ordering::Relaxed);
            self.write(shapes)?;
            self.is_written.store(true, Ordering::Relaxed);
        }
        let Passes { cohort, transformation, alignment, .. } = &self.passes;
        let request = json!({"cohort": self.id, "revision": cohort.revision,
            "transformation": transformation, "alignment": alignment, "work": work});
        let mut arguments = vec!["pass"];
        if !self.settings.scheduler.is_empty() {
            arguments.extend(["--scheduler", &self.settings.scheduler]);
        }
        let program = Program::start(&self.settings, &arguments, self.passes.name())?;
        program.run(shapes, |mut input| Ok(input.write_all(request.to_string().as_bytes())?))
    }

    /// Whether the engine has these shapes: it has a whole revision, and computes nothing any more once it has failed.
    fn has(&self, shapes: &StoredShapes<'_>) -> bool {
        shapes.revisions().after == 0 && !shapes.is_empty() && !self.has_failed.load(Ordering::Relaxed)
    }

    /// The sums of a group of shapes that is coded with the same atoms; `run` names the learnt model.
    fn code(
        &self,
        shapes: &StoredShapes<'_>,
        (method, run): (&Method, &str),
        group: Group<'_>,
    ) -> Result<Vec<u8>, ServiceError> {
        let Group { epoch, first, end, atoms, mean } = group;
        let work = json!({"learn": {"method": method, "mean": mean, "atoms": atoms, "first": first,
            "end": end, "epoch": epoch, "run": run}});
        match self.compute(&shapes.clone().uncounted(), &work) {
            Ok(Answer { bytes, .. }) => {
                tracing::debug!(cohort = self.passes.cohort.id, epoch, first, "the engine coded a group");
                Ok(bytes)
            }
            Err(Failure::Service(error)) => Err(error),
            Err(Failure::Program(reason)) => {
                self.failed(&reason);
                self.has_failed_to_code.store(true, Ordering::Relaxed);
                Err(ServiceError::Unavailable("the engine failed to code shapes".into()))
            }
        }
    }

    /// Whether a group could not be coded: learning must begin again, and this process codes from then on.
    pub(crate) fn has_failed_to_code(&self) -> bool {
        self.has_failed_to_code.load(Ordering::Relaxed)
    }

    fn failed(&self, reason: &str) {
        self.has_failed.store(true, Ordering::Relaxed);
        tracing::warn!(cohort = self.passes.cohort.id, reason, "the engine failed; this process computes");
    }

    /// Writes the revision as files.
    fn write(&self, shapes: &StoredShapes<'_>) -> Result<(), Failure> {
        let description = self.description(shapes.len());
        let folder = description_file(&description)?;
        let path = folder.path.to_string_lossy().into_owned();
        let arguments = ["ingest", "--arrow", "--cohort", &path, "--shapes", "-"];
        let program = Program::start(&self.settings, &arguments, self.passes.name())?;
        program.run(shapes, |input| send(shapes, input)).map(drop)
    }

    fn description(&self, shapes: usize) -> Value {
        let Cohort { spec, revision, .. } = self.passes.cohort;
        json!({"id": self.id, "name": spec.name, "representation": spec.representation,
            "correspondence": spec.correspondence, "direction": spec.direction, "mirror": spec.mirror,
            "length_unit": spec.shown_unit(), "revision": revision, "shape_count": shapes})
    }
}

impl Distribute for AtEngine<'_> {
    fn run(
        &self,
        shapes: &StoredShapes<'_>,
        work: &dyn Fn() -> Work,
        merge: &mut MergePart<'_>,
    ) -> Result<bool, ServiceError> {
        // A pass over new shapes alone is computed here.
        if !self.has(shapes) {
            return Ok(false);
        }
        let work = match work() {
            Work::Sum(pass) => json!({"sum": pass}),
            Work::Codes(content) => json!({"certify": content}),
        };
        match self.compute(shapes, &work) {
            Ok(Answer { bytes: state, counted }) => {
                merge(&state)?;
                shapes.worked(shapes.len().saturating_sub(counted));
                tracing::info!(
                    cohort = self.passes.cohort.id,
                    bytes = state.len(),
                    "the engine computed a pass"
                );
                Ok(true)
            }
            Err(Failure::Service(error)) => Err(error),
            Err(Failure::Program(reason)) => {
                self.failed(&reason);
                Ok(false)
            }
        }
    }

    fn coders<'s>(&'s self, shapes: &'s StoredShapes<'_>) -> Option<CodeGroup<'s>> {
        let Purpose::Learning { job, attempt, method } = self.passes.purpose else { return None };
        let Method::Sparse { schedule, .. } = *method else { return None };
        // Each group is a program that is started: it must be worth one.
        let pays = schedule == Schedule::Batch || shapes.len() >= MAX_GROUPS * PART;
        let run = format!("{job}-{attempt}");
        let code = move |group: Group<'_>| Ok(self.code(shapes, (method, &run), group)?);
        (pays && self.has(shapes)).then(|| Box::new(code) as _)
    }
}

impl Drop for AtEngine<'_> {
    /// Removes the revision with its files. Of one that was not written to its end there are files that nothing names; should another
    /// job write at this moment, it loses its files too, and computes in its own process.
    fn drop(&mut self) {
        if !self.has_begun.load(Ordering::Relaxed) {
            return;
        }
        let revision = self.passes.cohort.revision.to_string();
        let forget = ["forget", "--cohort", &self.id, "--revision", &revision, "--with-parts"];
        let is_written = self.is_written.load(Ordering::Relaxed);
        let arguments = if is_written { &forget[..] } else { &["collect", "--min-age-hours", "0"] };
        let ended = command(&self.settings, arguments).stdout(Stdio::null()).stderr(Stdio::null()).status();
        if !ended.is_ok_and(|status| status.success()) {
            tracing::warn!(cohort = self.id, revision, "the engine could not forget a revision");
        }
    }
}

/// Why a program has no result.
enum Failure {
    /// This process cannot go on: its store failed, or the job was cancelled.
    Service(ServiceError),
    /// The program failed.
    Program(String),
}

impl From<ServiceError> for Failure {
    fn from(error: ServiceError) -> Self {
        Self::Service(error)
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Self {
        Self::Program(error.to_string())
    }
}

impl From<ArrowError> for Failure {
    fn from(error: ArrowError) -> Self {
        Self::Program(error.to_string())
    }
}

/// The engine starts with large pages allowed: a child inherits the setting of the service, which has small pages while it is small.
fn command(settings: &EngineSettings, arguments: &[&str]) -> Command {
    memory::use_large_pages(true);
    let kept = |name: &str| VARIABLES.iter().any(|prefix| name.starts_with(prefix));
    let mut command = Command::new(&settings.program);
    command.env_clear().envs(std::env::vars_os().filter(|(name, _)| name.to_str().is_some_and(kept)));
    command.arg("--store").arg(&settings.store).args(arguments);
    command
}

/// A file that is removed with this value.
struct Removed {
    path: PathBuf,
}

impl Drop for Removed {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path);
    }
}

fn description_file(description: &Value) -> Result<Removed, Failure> {
    let name = format!("shapelex-engine-{}.json", uuid::Uuid::now_v7());
    let removed = Removed { path: std::env::temp_dir().join(name) };
    std::fs::write(&removed.path, description.to_string())?;
    Ok(removed)
}

/// Answer of a program.
struct Answer {
    bytes: Vec<u8>,
    /// Number of shapes that it has reported, and that are counted.
    counted: usize,
}

/// A running program, killed if it is not waited for.
struct Program {
    child: Child,
    /// Name of the computation that it is for: the id of a job.
    job: String,
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Program {
    fn start(settings: &EngineSettings, arguments: &[&str], job: &str) -> Result<Self, Failure> {
        let mut command = command(settings, arguments);
        let piped = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        Ok(Self { child: piped.spawn()?, job: job.into() })
    }

    /// Writes the input, and waits for the output; counts the shapes whose parts are reported as done. Ends the program when the job is
    /// cancelled.
    fn run(
        mut self,
        shapes: &StoredShapes<'_>,
        write: impl FnOnce(ChildStdin) -> Result<(), Failure>,
    ) -> Result<Answer, Failure> {
        let none = || Failure::Program("a pipe is missing".into());
        let input = self.child.stdin.take().ok_or_else(none)?;
        let output = self.child.stdout.take().ok_or_else(none)?;
        let said = self.child.stderr.take().ok_or_else(none)?;
        let heard = Arc::new(Heard::default());
        let (hearing, job) = (Arc::clone(&heard), std::mem::take(&mut self.job));
        let reading = std::thread::spawn(move || {
            let mut bytes = Vec::new();
            BufReader::new(output).read_to_end(&mut bytes).map(|_| bytes)
        });
        let listening = std::thread::spawn(move || hearing.listen(said, &job));
        let (written, mut counted) = (write(input), 0);
        let status = loop {
            shapes.check()?;
            let done = heard.parts.load(Ordering::Relaxed).saturating_mul(PART).min(shapes.len());
            shapes.worked(done.saturating_sub(counted));
            counted = counted.max(done);
            match self.child.try_wait()? {
                Some(status) => break status,
                None => std::thread::sleep(LOOK),
            }
        };
        // Both ends of the pipes are closed now, so that the threads end.
        let ended = (reading.join(), listening.join());
        let text = heard.lines.lock().unwrap_or_else(PoisonError::into_inner).join("; ");
        match (status.success(), ended.0) {
            (true, Ok(bytes)) => {
                let bytes = written.and(Ok(bytes?))?;
                // Every command answers something.
                if bytes.is_empty() {
                    Err(Failure::Program("no answer".into()))
                } else {
                    Ok(Answer { bytes, counted })
                }
            }
            // The words of the program are more telling than a pipe that it closed.
            _ => match written {
                Err(Failure::Service(error)) => Err(error.into()),
                _ => Err(Failure::Program(format!("{status}: {text}"))),
            },
        }
    }
}

/// Words of a program on standard error.
#[derive(Debug, Default)]
struct Heard {
    /// Number of parts that are done.
    parts: AtomicUsize,
    /// The last lines that are not reports of progress.
    lines: Mutex<Vec<String>>,
}

/// Reports of a program.
#[derive(serde::Deserialize)]
#[serde(untagged)]
enum Report {
    Progress {
        parts_done: usize,
    },
    /// Id of a job of the cluster.
    Submitted {
        job: String,
    },
}

impl Heard {
    fn listen(&self, said: impl Read, job: &str) {
        for line in BufReader::new(said).lines().map_while(Result::ok) {
            match serde_json::from_str(&line) {
                Ok(Report::Progress { parts_done }) => self.parts.store(parts_done, Ordering::Relaxed),
                Ok(Report::Submitted { job: at_cluster }) => {
                    tracing::info!(job, at_cluster, "a job of the cluster was submitted");
                }
                Err(_) => self.keep(line),
            }
        }
    }

    fn keep(&self, line: String) {
        let mut lines = self.lines.lock().unwrap_or_else(PoisonError::into_inner);
        if lines.len() == KEPT_LINES {
            lines.remove(0);
        }
        lines.push(line);
    }
}

/// Sends all shapes as a stream of Arrow.
fn send(shapes: &StoredShapes<'_>, input: ChildStdin) -> Result<(), Failure> {
    let width = shapes.width();
    let element = Arc::new(Field::new("element", DataType::Float64, false));
    let points = DataType::FixedSizeList(Arc::clone(&element), width as i32);
    let schema = Arc::new(Schema::new(vec![
        Field::new("id", DataType::Utf8, false),
        Field::new("weight", DataType::Float64, false),
        Field::new("control_points", points, false),
    ]));
    let mut writer = StreamWriter::try_new_buffered(input, &schema)?;
    let mut failure = None;
    shapes
        .for_each_named(&mut |batch| {
            let numbers: ArrayRef = Arc::new(Float64Array::from(batch.control_points.clone()));
            let write = || {
                let points = FixedSizeListArray::try_new(Arc::clone(&element), width as i32, numbers, None)?;
                let columns: Vec<ArrayRef> = vec![
                    Arc::new(StringArray::from_iter_values(&batch.ids)),
                    Arc::new(Float64Array::from(batch.weights.clone())),
                    Arc::new(points),
                ];
                writer.write(&RecordBatch::try_new(Arc::clone(&schema), columns)?)
            };
            write().map_err(|error| {
                failure = Some(error);
                ServiceError::Cancelled
            })
        })
        .map_err(|error| failure.take().map_or_else(|| error.into(), Failure::from))?;
    Ok(writer.finish()?)
}
