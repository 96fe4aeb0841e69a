//! The command line of the engine.

mod commands;

use std::io::Write;
use std::num::NonZeroUsize;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use shapelex_engine::EngineError;
use shapelex_engine::objects::{Objects, Patience};

use commands::maintenance::{Maintenance, maintain};
use commands::pass;

/// Cohorts at rest, and passes over cohorts that are larger than memory.
#[derive(Debug, Parser)]
#[command(version)]
struct Cli {
    /// Folder of the cohorts, or s3://bucket/folder in a build with the feature s3. A scheduler needs none.
    #[arg(long, env = "SHAPELEX_ENGINE_STORE")]
    store: Option<String>,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    #[command(flatten)]
    Maintenance(Maintenance),
    /// One pass over a revision: a request on standard input, its result on standard output. Used by the service.
    Pass(pass::Pass),
    /// Hands out the tasks of a cluster.
    #[cfg(feature = "cluster")]
    Scheduler(commands::cluster::SchedulerCommand),
    /// Reads parts and computes on them, for clients of a cluster.
    #[cfg(feature = "cluster")]
    Executor(commands::cluster::ExecutorCommand),
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

impl Command {
    /// Number of threads that was asked for.
    fn threads(&self) -> Option<NonZeroUsize> {
        match self {
            Self::Pass(pass) => pass.machines.threads(),
            #[cfg(feature = "cluster")]
            Self::Executor(executor) => NonZeroUsize::new(executor.tasks.into()),
            _ => None,
        }
    }
}

/// The store that was named.
fn objects(store: Option<&str>) -> Result<Objects, EngineError> {
    let store = store.ok_or_else(|| EngineError::Refused {
        place: "store".into(),
        detail: "expected a folder, by --store or SHAPELEX_ENGINE_STORE".into(),
    })?;
    Ok(Objects::new(shapelex_engine::location::open(store)?, Patience::default()))
}

fn run(Cli { store, command }: Cli) -> Result<ExitCode, EngineError> {
    let threads = command.threads().or_else(|| std::thread::available_parallelism().ok());
    let threads = threads.unwrap_or(NonZeroUsize::MIN);
    // Sums use the threads of rayon, reading and merging those of tokio.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.get()).build_global();
    pool.map_err(|error| EngineError::Refused { place: "threads".into(), detail: error.to_string() })?;
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(threads.get()).enable_all().build()?;
    let store = store.as_deref();
    match command {
        Command::Maintenance(command) => runtime.block_on(maintain(objects(store)?, command)),
        Command::Pass(command) => runtime.block_on(command.run(objects(store)?, threads)),
        #[cfg(feature = "cluster")]
        Command::Scheduler(command) => runtime.block_on(command.run()),
        #[cfg(feature = "cluster")]
        Command::Executor(command) => runtime.block_on(command.run(objects(store)?)),
    }
}
