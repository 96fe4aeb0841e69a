//! The command line.

use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::api;
use crate::config::{ServeArgs, ServeConfig};
use crate::server;
use crate::telemetry;

/// Shape statistics as a service.
#[derive(Debug, Parser)]
#[command(name = "shapelex", version, about)]
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
}

/// Runs the program; errors go to standard error in one sentence.
pub fn run() -> ExitCode {
    let outcome = match Cli::parse().command {
        Command::Serve(args) => serve(*args),
        Command::Openapi => openapi(),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(message) => {
            #[allow(clippy::print_stderr, reason = "the last word of a program that cannot go on")]
            {
                eprintln!("shapelex: {message}");
            }
            ExitCode::FAILURE
        }
    }
}

fn serve(args: ServeArgs) -> Result<(), String> {
    let config = ServeConfig::load(args)?;
    telemetry::start(&config.log, config.log_format)?;
    runtime()?.block_on(server::serve(config))
}

fn runtime() -> Result<tokio::runtime::Runtime, String> {
    tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .map_err(|error| format!("the async runtime does not start: {error}"))
}

fn openapi() -> Result<(), String> {
    let document = api::openapi().to_pretty_json().map_err(|error| error.to_string())?;
    #[allow(clippy::print_stdout, reason = "the document is what was asked for")]
    {
        println!("{document}");
    }
    Ok(())
}
