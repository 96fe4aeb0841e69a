//! Commands that write, list, check and remove revisions.

use std::io::{BufRead, BufReader, Write};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use clap::Subcommand;
use serde::Serialize;
use shapelex_engine::EngineError;
use shapelex_engine::cohort::maintenance;
use shapelex_engine::cohort::writer::Writer;
use shapelex_engine::ingest;
use shapelex_engine::objects::Objects;

#[derive(Debug, Subcommand)]
pub(crate) enum Maintenance {
    /// Writes a revision of a cohort.
    Ingest {
        /// The cohort, as GET /v1/cohorts/{cohort} answers it.
        #[arg(long)]
        cohort: PathBuf,
        /// Its shapes, one JSON object per line, as GET /v1/cohorts/{cohort}/shapes lists them; '-' for standard input.
        #[arg(long)]
        shapes: PathBuf,
        /// The shapes are a stream of Arrow with the columns id, weight and control_points.
        #[arg(long)]
        arrow: bool,
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
        /// Removes the parts that no other revision names: not while another revision of the cohort is written.
        #[arg(long)]
        with_parts: bool,
    },
}

pub(crate) async fn maintain(objects: Objects, command: Maintenance) -> Result<ExitCode, EngineError> {
    match command {
        Maintenance::Ingest { cohort, shapes, arrow, rewrite } => {
            let cohort = ingest::read_description(&std::fs::read(cohort)?)?;
            let writer = Writer::begin(objects, cohort, rewrite).await?;
            let lines: Box<dyn BufRead> = if shapes.as_os_str() == "-" {
                Box::new(BufReader::new(std::io::stdin()))
            } else {
                Box::new(BufReader::with_capacity(1 << 20, std::fs::File::open(shapes)?))
            };
            let written = match arrow {
                true => ingest::ingest_arrow(lines, writer).await?,
                false => ingest::ingest(lines, writer).await?,
            };
            print(&written)?;
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
        Maintenance::Forget { cohort, revision, with_parts } => {
            maintenance::forget(&objects, &cohort, revision, with_parts).await?;
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// Writes an answer to standard output.
fn print(value: &impl Serialize) -> Result<(), EngineError> {
    let mut out = std::io::stdout().lock();
    serde_json::to_writer_pretty(&mut out, value).map_err(std::io::Error::from)?;
    writeln!(out)?;
    Ok(())
}
