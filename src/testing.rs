//! Test servers: the service inside another program, for the integration tests of its clients.
//!
//! ```
//! use shapelex_server::testing::TestServer;
//!
//! let server = TestServer::start(&[])?;
//! let mean = format!("{}/v1/cohorts/example-cells/mean?transformation=similarity", server.url());
//! # assert!(mean.starts_with("http://127.0.0.1:"));
//! // … ask it, by any client.
//! # Ok::<(), String>(())
//! ```

use std::ffi::OsString;
use std::sync::mpsc;
use std::thread::JoinHandle;

use clap::builder::Resettable;
use clap::{Args, FromArgMatches};
use tempfile::TempDir;
use tokio_util::sync::CancellationToken;

use crate::cli::runtime;
use crate::config::{ServeArgs, ServeConfig};
use crate::server;

/// Service on a free port of this machine, with a temporary embedded store. Dropped, it finishes its requests and deletes the store.
///
/// Access is open, and the store holds the example cohort `example-cells`, as after `shapelex serve` on an empty folder. Several may run in
/// one process; they share its metrics. Nothing is logged unless the process has a subscriber of `tracing`.
#[derive(Debug)]
pub struct TestServer {
    url: String,
    stop: CancellationToken,
    running: Option<JoinHandle<Result<(), String>>>,
    folder: TempDir,
}

impl TestServer {
    /// Starts a service with flags of `shapelex serve`, such as `["--no-example"]`, and returns when it accepts connections.
    ///
    /// Variables of the environment, which are settings of the program, have no effect. Takes tenths of a second.
    ///
    /// # Errors
    /// Unknown flags and values, in the words of the program; why the service cannot start.
    pub fn start(flags: &[&str]) -> Result<Self, String> {
        let folder = tempfile::tempdir().map_err(|error| format!("a temporary folder: {error}"))?;
        let config = config(&folder, flags)?;
        let stop = CancellationToken::new();
        let (announce, announced) = mpsc::channel();
        let stopped = stop.clone();
        let running = std::thread::spawn(move || {
            runtime()?.block_on(server::run(
                config,
                || Ok(stopped.cancelled_owned()),
                |service| drop(announce.send(service.address.clone())),
            ))
        });
        match announced.recv() {
            Ok(url) => Ok(Self { url, stop, running: Some(running), folder }),
            // The service ended, and its side of the channel with it.
            Err(_) => Err(ended(running).err().unwrap_or_else(|| "the service ended".into())),
        }
    }

    /// Address of the service, without a slash at its end.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Folder that is deleted with the service, whose store is in `data`.
    pub fn folder(&self) -> &std::path::Path {
        self.folder.path()
    }

    /// Finishes the requests that run, and deletes the store.
    ///
    /// # Errors
    /// The fault of the service while it ran.
    pub fn stop(mut self) -> Result<(), String> {
        self.finish()
    }

    fn finish(&mut self) -> Result<(), String> {
        self.stop.cancel();
        self.running.take().map_or(Ok(()), ended)
    }
}

impl Drop for TestServer {
    fn drop(&mut self) {
        // A test that wants to know asks `stop`.
        let _ = self.finish();
    }
}

fn ended(running: JoinHandle<Result<(), String>>) -> Result<(), String> {
    running.join().unwrap_or_else(|_| Err("the service panicked".into()))
}

/// Settings by flags alone: a variable of a shell must not lead a test to the data of a service.
fn config(folder: &TempDir, flags: &[&str]) -> Result<ServeConfig, String> {
    let listen = ["shapelex", "--listen", "127.0.0.1:0", "--data-dir"].map(OsString::from);
    let given = flags.iter().map(OsString::from);
    let command = ServeArgs::augment_args(clap::Command::new("shapelex"))
        .args_override_self(true)
        .mut_args(|argument| argument.env(Resettable::Reset));
    let matches = command
        .try_get_matches_from(
            listen.into_iter().chain([folder.path().join("data").into_os_string()]).chain(given),
        )
        .map_err(|error| error.to_string())?;
    let args = ServeArgs::from_arg_matches(&matches).map_err(|error| error.to_string())?;
    ServeConfig::load(args)
}
