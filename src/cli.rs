//! Command line: the service, its OpenAPI document, a health check, API keys, files of shapes, maintenance of the store, and
//! pages about all of it.

mod at;
mod environment;
mod files;
mod keys;
mod maintenance;
mod manual;
mod runtime;

use std::collections::BTreeSet;
use std::ffi::OsString;
use std::io::{ErrorKind, Write};
use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};

pub(crate) use self::runtime::runtime;
use crate::config::{ServeArgs, ServeConfig};
use crate::service::app::build;
use crate::{api, health, server, telemetry};

/// Shape statistics as a network service.
#[derive(Debug, Parser)]
#[command(name = "shapelex", version = build::LINE, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Start the service.
    Serve(Box<ServeArgs>),
    /// Print the OpenAPI document.
    Openapi,
    /// Check the health of a running service; exits with 0 if it is healthy.
    Health {
        /// Address that must return a success status
        #[arg(long, default_value = "http://127.0.0.1:8080/readyz")]
        url: String,
    },
    /// Create, list and revoke API keys, even while the service runs.
    Key {
        #[command(subcommand)]
        command: keys::KeyCommand,
    },
    #[command(flatten)]
    Files(files::FileCommand),
    /// Print the completions of a shell
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
    /// Write the man pages into a folder, or print the first one
    Man {
        /// Folder, created if missing
        folder: Option<std::path::PathBuf>,
    },
    #[command(flatten)]
    Maintenance(maintenance::Maintenance),
}

/// Runs the program; errors are written to standard error in one sentence.
pub fn run() -> ExitCode {
    let command = Cli::parse().command;
    if let Err(message) = check_environment(&command) {
        complain(&message);
        return ExitCode::from(2);
    }
    let outcome = match command {
        Command::Serve(args) => serve(*args),
        Command::Openapi => openapi(),
        Command::Health { url } => runtime().and_then(|runtime| runtime.block_on(health::ask(&url))),
        Command::Key { command } => key(command),
        Command::Files(command) => return code(files::run(command)),
        Command::Completions { shell } => {
            manual::completions(shell, &mut Cli::command()).and_then(|text| say(&text))
        }
        Command::Man { folder } => {
            manual::pages(&Cli::command(), folder.as_deref()).and_then(|text| say(&text))
        }
        Command::Maintenance(command) => {
            return code(runtime().and_then(|runtime| runtime.block_on(maintenance::run(command))));
        }
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            complain(&message);
            ExitCode::FAILURE
        }
    }
}

/// Refuses misspelt variables where they would be settings.
fn check_environment(command: &Command) -> Result<(), String> {
    match command {
        Command::Openapi | Command::Health { .. } | Command::Completions { .. } | Command::Man { .. } => {
            Ok(())
        }
        Command::Serve(_) | Command::Key { .. } | Command::Files(_) | Command::Maintenance(_) => {
            let texts = |(name, value): (OsString, OsString)| {
                Some((name.into_string().ok()?, value.to_string_lossy().into_owned()))
            };
            environment::check(std::env::vars_os().filter_map(texts), &variables_of(&Cli::command()))
        }
    }
}

/// Variables of a command and of those below it.
fn variables_of(command: &clap::Command) -> BTreeSet<String> {
    let own = command.get_arguments().filter_map(|argument| argument.get_env()?.to_str().map(str::to_owned));
    own.chain(command.get_subcommands().flat_map(variables_of)).collect()
}

/// Prints why the program cannot continue.
fn complain(message: &str) {
    #[allow(clippy::print_stderr, reason = "the last word of a program that cannot go on")]
    {
        eprintln!("shapelex: {message}");
    }
}

/// Exit code 0 if done, 1 if done with findings, 2 if it failed.
fn code(outcome: Result<at::Outcome, String>) -> ExitCode {
    match outcome {
        Ok(at::Outcome::Done) => ExitCode::SUCCESS,
        Ok(at::Outcome::Findings) => ExitCode::from(1),
        Err(message) => {
            complain(&message);
            ExitCode::from(2)
        }
    }
}

fn serve(args: ServeArgs) -> Result<(), String> {
    let config = ServeConfig::load(args)?;
    let runtime = runtime()?;
    let telemetry = telemetry::start(&config.log, config.log_format, runtime.handle())?;
    let outcome = runtime.block_on(server::serve(config));
    telemetry.stop();
    outcome
}

fn key(command: keys::KeyCommand) -> Result<(), String> {
    say(&runtime()?.block_on(keys::run(command))?)
}

fn openapi() -> Result<(), String> {
    say(&api::interface::document().map_err(|error| error.to_string())?)
}

/// Writes output to standard output; a closed pipe is not an error.
fn say(text: &str) -> Result<(), String> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(format!("standard output: {error}")),
        _ => Ok(()),
    }
}
