//! The command line of the engine.

use std::io::{BufRead, BufReader, Write};
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use clap::{Args, Parser, Subcommand};
use serde::Serialize;
use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::frame::Frame;
use shapelex_analysis::transformation::Transformation;
use shapelex_engine::EngineError;
use shapelex_engine::cohort::maintenance;
use shapelex_engine::cohort::manifest::revisions;
use shapelex_engine::cohort::writer::Writer;
use shapelex_engine::ingest;
use shapelex_engine::objects::{Objects, Patience};
use shapelex_engine::pass::engine::{Engine, Took};
use shapelex_engine::pass::revision::{Revision, Setting};
use shapelex_engine::pass::source::AtRest;
use shapelex_engine::statistics::{Report, Request, Statistics};

/// Cohorts at rest, and statistics of cohorts larger than memory.
#[derive(Debug, Parser)]
#[command(version)]
struct Cli {
    /// Folder of the cohorts.
    #[arg(long, env = "SHAPELEX_ENGINE_STORE")]
    store: String,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    #[command(flatten)]
    Maintenance(Maintenance),
    /// Mean and principal components of a revision.
    Run(Run),
}

#[derive(Debug, Subcommand)]
enum Maintenance {
    /// Writes a revision of a cohort.
    Ingest {
        /// The cohort, as GET /v1/cohorts/{cohort} answers it.
        #[arg(long)]
        cohort: PathBuf,
        /// Its shapes, one JSON object per line, as GET /v1/cohorts/{cohort}/shapes lists them; '-' for standard input.
        #[arg(long)]
        shapes: PathBuf,
        /// Writes parts again that exist, which repairs damaged ones.
        #[arg(long)]
        rewrite: bool,
    },
    /// Lists all revisions.
    List,
    /// Reads everything and compares it with its digests. Fails if anything is wrong.
    Check,
    /// Removes parts that no revision names.
    Collect {
        /// Minimum age of such parts in hours: a writer may be about to name younger ones.
        #[arg(long, default_value_t = 24)]
        min_age_hours: u64,
        /// Only counts them.
        #[arg(long)]
        dry_run: bool,
    },
    /// Forgets a revision. Its parts stay until they are collected.
    Forget {
        /// Id of the cohort.
        #[arg(long)]
        cohort: String,
        /// Revision.
        #[arg(long)]
        revision: u64,
    },
}

#[derive(Debug, Args)]
struct Run {
    /// Id of the cohort.
    #[arg(long)]
    cohort: String,
    /// Revision. Default: the latest.
    #[arg(long)]
    revision: Option<u64>,
    /// Class of transformations that is removed: a name, or a JSON object with matrices.
    #[arg(long, default_value = "similarity", value_parser = transformation)]
    transformation: Transformation,
    /// projection, procrustes or partial_procrustes. Default: what suits the class.
    #[arg(long, value_parser = json_word::<Alignment>)]
    alignment: Option<Alignment>,
    /// training or canonical.
    #[arg(long, default_value = "training", value_parser = json_word::<Frame>)]
    frame: Frame,
    /// Number of components; 0 for the mean alone.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u16).range(..=32_767))]
    components: u16,
    /// Does not subtract the mean from aligned shapes.
    #[arg(long)]
    uncentred: bool,
    /// Divides aligned shapes by their norms.
    #[arg(long)]
    normalise: bool,
    /// Threads. Default: those of the machine.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Memory of sums that wait for their group, in MiB; beyond it they are written to temporary files.
    #[arg(long, default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..))]
    memory_mib: u32,
    /// Folder of temporary files. Default: that of the system.
    #[arg(long)]
    spill: Option<PathBuf>,
    /// Computes without the engine, part after part: the same digest.
    #[arg(long)]
    direct: bool,
}

/// What a run answers.
#[derive(Debug, Serialize)]
struct Answer {
    cohort: String,
    revision: u64,
    revision_digest: String,
    seconds: f64,
    passes: Vec<Took>,
    #[serde(flatten)]
    report: Report,
}

fn json_word<T: serde::de::DeserializeOwned>(word: &str) -> Result<T, String> {
    serde_json::from_value(word.into()).map_err(|error| error.to_string())
}

fn transformation(text: &str) -> Result<Transformation, String> {
    if text.trim_start().starts_with('{') {
        return serde_json::from_str(text).map_err(|error| error.to_string());
    }
    json_word(text)
}

fn main() -> ExitCode {
    match run(Cli::parse()) {
        Ok(code) => code,
        Err(error) => {
            // Nothing is left to do if even this cannot be written.
            let _ = writeln!(std::io::stderr(), "shapelex-engine: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(Cli { store, command }: Cli) -> Result<ExitCode, EngineError> {
    let threads = match &command {
        Command::Run(run) => run.threads.and_then(|threads| NonZeroUsize::new(threads.into())),
        Command::Maintenance(_) => None,
    };
    let threads = threads.or_else(|| std::thread::available_parallelism().ok()).unwrap_or(NonZeroUsize::MIN);
    // Sums use the threads of rayon, reading and merging those of tokio.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.get()).build_global();
    pool.map_err(|error| EngineError::Refused { place: "threads".into(), detail: error.to_string() })?;
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(threads.get()).enable_all().build()?;
    let objects = Objects::new(shapelex_engine::location::open(&store)?, Patience::default());
    match command {
        Command::Run(request) => {
            let handle = runtime.handle().clone();
            print(&request.answer(objects, &handle, threads)?)?;
            Ok(ExitCode::SUCCESS)
        }
        Command::Maintenance(command) => runtime.block_on(maintain(objects, command)),
    }
}

async fn maintain(objects: Objects, command: Maintenance) -> Result<ExitCode, EngineError> {
    match command {
        Maintenance::Ingest { cohort, shapes, rewrite } => {
            let cohort = ingest::read_description(&std::fs::read(cohort)?)?;
            let writer = Writer::begin(objects, cohort, rewrite).await?;
            let lines: Box<dyn BufRead> = if shapes.as_os_str() == "-" {
                Box::new(BufReader::new(std::io::stdin()))
            } else {
                Box::new(BufReader::with_capacity(1 << 20, std::fs::File::open(shapes)?))
            };
            print(&ingest::ingest(lines, writer).await?)?;
        }
        Maintenance::List => print(&maintenance::list(&objects).await?)?,
        Maintenance::Check => {
            let checked = maintenance::check(&objects).await?;
            print(&checked)?;
            if !checked.faults.is_empty() {
                return Ok(ExitCode::FAILURE);
            }
        }
        Maintenance::Collect { min_age_hours, dry_run } => {
            let age = Duration::from_secs(min_age_hours.saturating_mul(3600));
            print(&maintenance::collect(&objects, age, dry_run).await?)?;
        }
        Maintenance::Forget { cohort, revision } => maintenance::forget(&objects, &cohort, revision).await?,
    }
    Ok(ExitCode::SUCCESS)
}

impl Run {
    fn answer(
        self,
        objects: Objects,
        runtime: &tokio::runtime::Handle,
        threads: NonZeroUsize,
    ) -> Result<Answer, EngineError> {
        let began = Instant::now();
        let revision = runtime.block_on(self.open(objects))?;
        let setting = Arc::new(Setting::new(revision.manifest(), &self.transformation, self.alignment)?);
        let engine =
            Engine { threads, memory_bytes: (self.memory_mib as usize) << 20, spill: self.spill.clone() };
        let engine = (!self.direct).then_some(&engine);
        let source = AtRest::new(revision.clone(), setting.clone(), runtime, engine);
        let request = Request {
            frame: self.frame,
            components: self.components.into(),
            centred: !self.uncentred,
            normalise: self.normalise,
        };
        let statistics = Statistics::of(&source, &setting, request)?;
        Ok(Answer {
            cohort: self.cohort,
            revision: revision.manifest().cohort.revision,
            revision_digest: revision.digest().into(),
            seconds: began.elapsed().as_secs_f64(),
            passes: source.took(),
            report: statistics.report(&setting),
        })
    }

    async fn open(&self, objects: Objects) -> Result<Arc<Revision>, EngineError> {
        let revision = match self.revision {
            Some(revision) => revision,
            None => revisions(&objects, &self.cohort).await?.pop().ok_or_else(|| EngineError::Refused {
                place: "cohort".into(),
                detail: format!("expected a cohort with a revision, got '{}'", self.cohort),
            })?,
        };
        Ok(Arc::new(Revision::open(objects, &self.cohort, revision).await?))
    }
}

fn print(value: &impl Serialize) -> Result<(), EngineError> {
    let mut out = std::io::stdout().lock();
    serde_json::to_writer_pretty(&mut out, value).map_err(std::io::Error::from)?;
    writeln!(out)?;
    Ok(())
}
