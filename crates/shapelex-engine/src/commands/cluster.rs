//! The commands of a cluster.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Args;
use shapelex_engine::EngineError;
use shapelex_engine::cluster::client::Client;
use shapelex_engine::cluster::executor::Executor;
use shapelex_engine::cluster::network::{Address, Network};
use shapelex_engine::cluster::scheduler::Scheduler;
use shapelex_engine::objects::Objects;
use shapelex_engine::pass::division::MIN_GROUPS;

/// Certificates of a process, in PEM. Needed wherever an address is not of this machine.
#[derive(Debug, Args)]
struct Certificates {
    /// Certificate of this process, for its host name and for both sides of a connection.
    #[arg(long, env = "SHAPELEX_ENGINE_CERTIFICATE", requires_all = ["key", "authority"])]
    certificate: Option<PathBuf>,
    /// Its private key.
    #[arg(long, env = "SHAPELEX_ENGINE_KEY", requires = "certificate")]
    key: Option<PathBuf>,
    /// Certificate of the authority that signed those of all processes.
    #[arg(long, env = "SHAPELEX_ENGINE_AUTHORITY", requires = "certificate")]
    authority: Option<PathBuf>,
}

impl Certificates {
    fn network(&self) -> Result<Network, EngineError> {
        match (&self.certificate, &self.key, &self.authority) {
            (Some(certificate), Some(key), Some(authority)) => {
                Network::with_certificates(certificate, key, authority)
            }
            _ => Ok(Network::local()),
        }
    }
}

/// The cluster that computes a pass.
#[derive(Debug, Args)]
pub(crate) struct ClusterOptions {
    /// Scheduler of a cluster, as host:port. Default: this process computes.
    #[arg(long, env = "SHAPELEX_ENGINE_SCHEDULER")]
    scheduler: Option<Address>,
    /// Seconds after which a job of the cluster is cancelled and submitted again.
    #[arg(long, default_value_t = 1800, value_parser = clap::value_parser!(u32).range(1..))]
    patience_seconds: u32,
    #[command(flatten)]
    certificates: Certificates,
}

impl ClusterOptions {
    pub(crate) fn client(&self) -> Result<Option<Client>, EngineError> {
        let Some(scheduler) = self.scheduler.clone() else { return Ok(None) };
        let network = self.certificates.network()?;
        let patience = Duration::from_secs(self.patience_seconds.into());
        let (min_groups, submitted, notice) = (MIN_GROUPS, (|_| {}) as fn(&str), say);
        Ok(Some(Client { scheduler, network, patience, attempts: 12, min_groups, submitted, notice }))
    }
}

#[derive(Debug, Args)]
pub(crate) struct SchedulerCommand {
    /// Where the scheduler listens, as host:port.
    #[arg(long, default_value = "127.0.0.1:50050")]
    listen: Address,
    /// Where GET /metrics is answered in the format of Prometheus, as host:port, without certificates. Default: nowhere.
    #[arg(long, env = "SHAPELEX_ENGINE_METRICS")]
    metrics: Option<Address>,
    #[command(flatten)]
    certificates: Certificates,
}

impl SchedulerCommand {
    pub(crate) async fn run(self) -> Result<ExitCode, EngineError> {
        start_log();
        let network = self.certificates.network()?;
        let ready = |address| say(&format!("the scheduler listens on {address}"));
        Scheduler { listen: self.listen, metrics: self.metrics }.serve(&network, ready).await?;
        Ok(ExitCode::SUCCESS)
    }
}

#[derive(Debug, Args)]
pub(crate) struct ExecutorCommand {
    /// The scheduler, as host:port.
    #[arg(long, env = "SHAPELEX_ENGINE_SCHEDULER", default_value = "127.0.0.1:50050")]
    scheduler: Address,
    /// Where clients fetch results, as host:port; clients must reach it by this name.
    #[arg(long, default_value = "127.0.0.1:50051")]
    listen: Address,
    /// Number of tasks at a time.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub(crate) tasks: u16,
    /// Memory of the operators of DataFusion, in MiB.
    #[arg(long, default_value_t = 512, value_parser = clap::value_parser!(u32).range(1..))]
    memory_mib: u32,
    /// Folder of results until they are fetched. Default: a temporary one.
    #[arg(long)]
    folder: Option<PathBuf>,
    /// Where GET /metrics is answered in the format of Prometheus, as host:port, without certificates. Default: nowhere.
    #[arg(long, env = "SHAPELEX_ENGINE_METRICS")]
    metrics: Option<Address>,
    #[command(flatten)]
    certificates: Certificates,
}

impl ExecutorCommand {
    pub(crate) async fn run(self, objects: Objects) -> Result<ExitCode, EngineError> {
        start_log();
        let network = self.certificates.network()?;
        let own = std::env::temp_dir().join(format!("shapelex-executor-{}", std::process::id()));
        let folder = self.folder.unwrap_or(own);
        std::fs::create_dir_all(&folder)?;
        let executor = Executor {
            scheduler: self.scheduler,
            listen: self.listen,
            tasks: self.tasks.into(),
            memory_bytes: (self.memory_mib as usize) << 20,
            folder,
            metrics: self.metrics,
        };
        executor.work(objects, &network).await?;
        Ok(ExitCode::SUCCESS)
    }
}

/// Writes the log of Ballista to standard error, a line each.
struct Lines;

impl log::Log for Lines {
    fn enabled(&self, metadata: &log::Metadata) -> bool {
        metadata.level() <= log::max_level()
    }

    fn log(&self, record: &log::Record) {
        if self.enabled(record.metadata()) {
            say(&format!("{} {}: {}", record.level(), record.target(), record.args()));
        }
    }

    fn flush(&self) {}
}

/// Starts the log; `SHAPELEX_ENGINE_LOG` is the lowest level, such as `info`. Default: `warn`.
fn start_log() {
    let level = std::env::var("SHAPELEX_ENGINE_LOG").ok().and_then(|level| level.parse().ok());
    log::set_max_level(level.unwrap_or(log::LevelFilter::Warn));
    // There is no other log in this program.
    let _ = log::set_logger(&Lines);
}

fn say(text: &str) {
    // Nothing is left to do if even this cannot be written.
    let _ = writeln!(std::io::stderr(), "shapelex-engine: {text}");
}
