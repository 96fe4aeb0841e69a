//! The machines that compute a pass.

use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::Args;
use shapelex_engine::EngineError;
use shapelex_engine::pass::engine::Engine;
use shapelex_engine::pass::subject::Runner;

#[derive(Debug, Args)]
pub(crate) struct Machines {
    /// Threads. Default: those of the machine.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Memory of sums that wait for their group, in MiB; beyond it they are written to temporary files.
    #[arg(long, default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..))]
    memory_mib: u32,
    /// Folder of temporary files. Default: that of the system.
    #[arg(long)]
    spill: Option<PathBuf>,
    #[cfg(feature = "cluster")]
    #[command(flatten)]
    cluster: super::cluster::ClusterOptions,
}

/// The runners of a pass.
pub(crate) struct Runners {
    engine: Engine,
    #[cfg(feature = "cluster")]
    client: Option<shapelex_engine::cluster::client::Client>,
}

impl Machines {
    /// Number of threads that was asked for.
    pub(crate) fn threads(&self) -> Option<NonZeroUsize> {
        self.threads.and_then(|threads| NonZeroUsize::new(threads.into()))
    }

    pub(crate) fn runners(&self, threads: NonZeroUsize) -> Result<Runners, EngineError> {
        Ok(Runners {
            engine: Engine {
                threads,
                memory_bytes: (self.memory_mib as usize) << 20,
                spill: self.spill.clone(),
            },
            #[cfg(feature = "cluster")]
            client: self.cluster.client()?,
        })
    }
}

impl Runners {
    /// The same runners; a cluster tells the id of each of its jobs to `submitted`.
    #[cfg(feature = "cluster")]
    pub(crate) fn telling(mut self, submitted: fn(&str)) -> Self {
        self.client.iter_mut().for_each(|client| client.submitted = submitted);
        self
    }

    /// The same runners: without a cluster there are no jobs to tell of.
    #[cfg(not(feature = "cluster"))]
    pub(crate) fn telling(self, _: fn(&str)) -> Self {
        self
    }

    /// The cluster if there is one, else the engine of this process.
    pub(crate) fn chosen(&self) -> &dyn Runner {
        #[cfg(feature = "cluster")]
        if let Some(client) = &self.client {
            return client;
        }
        &self.engine
    }
}
