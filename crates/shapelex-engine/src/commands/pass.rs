//! One pass over a revision, for programs that compute the rest themselves, such as the service.

use std::io::Write;
use std::num::NonZeroUsize;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use clap::Args;
use serde::Deserialize;
use serde_json::json;
use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::dictionary::content::Content;
use shapelex_analysis::pass::Pass as Sum;
use shapelex_analysis::transformation::Transformation;
use shapelex_engine::EngineError;
use shapelex_engine::cohort::learning_folder;
use shapelex_engine::cohort::revision::{Revision, Setting};
use shapelex_engine::dictionary::Named;
use shapelex_engine::objects::Objects;
use shapelex_engine::pass::learn::Learn;
use shapelex_engine::pass::regress::Regress;
use shapelex_engine::pass::subject::Subject;
use shapelex_engine::pass::work::{Work, read_files};

use super::machines::Machines;

/// Interval of reports of progress.
const REPORT: Duration = Duration::from_millis(500);

#[derive(Debug, Args)]
pub(crate) struct Pass {
    #[command(flatten)]
    pub(crate) machines: Machines,
}

/// The content of standard input.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Request {
    cohort: String,
    revision: u64,
    transformation: Transformation,
    alignment: Alignment,
    work: Asked,
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum Asked {
    Sum(Box<Sum>),
    Certify(Box<Content>),
    Code(Box<Content>),
    Learn(Box<Learn>),
    Regress(Box<Regress>),
}

fn refused(place: &str, detail: impl ToString) -> EngineError {
    EngineError::Refused { place: place.into(), detail: detail.to_string() }
}

impl Pass {
    /// Reads a request from standard input, and writes the result, serialised, to standard output. Standard error has a line of JSON
    /// for each report of progress, and with the id of each job of a cluster.
    pub(crate) async fn run(self, objects: Objects, threads: NonZeroUsize) -> Result<ExitCode, EngineError> {
        let request: Request = serde_json::from_reader(std::io::stdin().lock())
            .map_err(|error| refused("request", format!("expected a request for a pass, got {error}")))?;
        let runners = self.machines.runners(threads)?.telling(|job| say(&json!({"job": job})));
        let (subject, work) = request.open(&objects).await?;
        let reports = tokio::spawn(report(subject.done.clone(), work.units(subject.revision.parts())));
        let outcome = runners.chosen().run(subject, &work).await;
        reports.abort();
        std::io::stdout().write_all(&answer(&work, outcome?.0)?)?;
        Ok(ExitCode::SUCCESS)
    }
}

impl Request {
    /// The shapes of the pass, and its work. A dictionary is kept beside the revision, where other machines find it.
    async fn open(self, objects: &Objects) -> Result<(Subject, Work), EngineError> {
        let Self { cohort, revision: number, transformation, alignment, work } = self;
        let revision = Revision::open(objects.clone(), &cohort, number).await?;
        let setting = || Setting::new(revision.manifest(), &transformation, Some(alignment));
        let named = |content: Box<Content>| Named::new(&revision, *content);
        let (dictionary, setting, work) = match work {
            Asked::Certify(content) => {
                let (named, setting) = named(content)?;
                let work = Work::Certify(named.digest.clone());
                (Some(named), setting, work)
            }
            Asked::Code(content) => {
                if let Some(fault) = content.faults().first() {
                    return Err(refused("dictionary", format!("{}: {}", fault.field, fault.detail)));
                }
                let (named, setting) = named(content)?;
                let work = Work::Code(named.digest.clone());
                (Some(named), setting, work)
            }
            Asked::Sum(sum) => (None, setting()?, Work::Sum(*sum)),
            Asked::Learn(learn) => (None, setting()?, Work::Learn(learn)),
            Asked::Regress(regress) => {
                let setting = setting()?;
                regress.check(setting.metric.len())?;
                (None, setting, Work::Regress(regress))
            }
        };
        if let Some(named) = &dictionary {
            named.keep(objects, &cohort).await?;
        }
        if let Work::Learn(learn) = &work {
            learn.remove_old(objects, &learning_folder(&cohort, number)?).await?;
        }
        Ok((Subject::new(Arc::new(revision), Arc::new(setting), dictionary.map(Arc::new)), work))
    }
}

async fn report(done: Arc<AtomicUsize>, parts: usize) {
    loop {
        tokio::time::sleep(REPORT).await;
        say(&json!({"parts_done": done.load(Ordering::Relaxed), "parts": parts}));
    }
}

/// The result of a pass as it is written: of codes a document with the list of the files, else the bytes.
fn answer(work: &Work, state: Vec<u8>) -> Result<Vec<u8>, EngineError> {
    let Work::Code(dictionary) = work else { return Ok(state) };
    let digest = blake3::hash(&state).to_hex().to_string();
    let answer = json!({"dictionary": dictionary, "files": read_files(&state)?, "digest": digest});
    Ok(answer.to_string().into_bytes())
}

fn say(line: &serde_json::Value) {
    // Whoever does not read the reports still gets the result.
    let _ = writeln!(std::io::stderr(), "{line}");
}
