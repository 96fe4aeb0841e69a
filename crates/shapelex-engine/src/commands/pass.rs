//! One pass over a revision, for programs that compute the rest themselves, such as the service.

use std::io::Write;
use std::num::NonZeroUsize;
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
use shapelex_engine::pass::source::Subject;
use shapelex_engine::pass::work::Work;
use tokio::runtime::Handle;

use super::machines::Machines;

/// Interval of reports of progress.
const REPORT: Duration = Duration::from_millis(500);

#[derive(Debug, Args)]
pub(crate) struct Pass {
    #[command(flatten)]
    pub(crate) machines: Machines,
}

/// What standard input says.
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
    Learn(Box<Learn>),
}

impl Pass {
    /// Reads a request from standard input, and writes the result, serialised, to standard output. Standard error has a line of JSON
    /// for each report of progress, and with the id of each job of a cluster.
    pub(crate) fn run(
        self,
        objects: Objects,
        runtime: &Handle,
        threads: NonZeroUsize,
    ) -> Result<(), EngineError> {
        let refused = |error: serde_json::Error| EngineError::Refused {
            place: "request".into(),
            detail: format!("expected a request for a pass, got {error}"),
        };
        let Request { cohort, revision: number, transformation, alignment, work } =
            serde_json::from_reader(std::io::stdin().lock()).map_err(refused)?;
        let runners = self.machines.runners(threads)?.telling(|job| say(&json!({"job": job})));
        let state = runtime.block_on(async {
            let revision = Arc::new(Revision::open(objects.clone(), &cohort, number).await?);
            let (dictionary, setting, work) = match work {
                Asked::Sum(sum) => {
                    let setting = Setting::new(revision.manifest(), &transformation, Some(alignment))?;
                    (None, setting, Work::Sum(*sum))
                }
                Asked::Certify(content) => {
                    let (named, setting) = Named::new(&revision, *content)?;
                    named.keep(&objects, &cohort).await?;
                    let work = Work::Certify(named.digest.clone());
                    (Some(Arc::new(named)), setting, work)
                }
                Asked::Learn(learn) => {
                    let setting = Setting::new(revision.manifest(), &transformation, Some(alignment))?;
                    learn.remove_old(&objects, &learning_folder(&cohort, number)?).await?;
                    (None, setting, Work::Learn(learn))
                }
            };
            let units = work.units(revision.parts());
            let done = Arc::new(AtomicUsize::new(0));
            let reports = tokio::spawn(report(done.clone(), units));
            let subject = Subject { revision, setting: Arc::new(setting), dictionary, done };
            let outcome = runners.or_threads().run(subject, &work).await;
            reports.abort();
            outcome.map(|(state, _)| state)
        })?;
        Ok(std::io::stdout().write_all(&state)?)
    }
}

async fn report(done: Arc<AtomicUsize>, parts: usize) {
    loop {
        tokio::time::sleep(REPORT).await;
        say(&json!({"parts_done": done.load(Ordering::Relaxed), "parts": parts}));
    }
}

fn say(line: &serde_json::Value) {
    // Whoever does not read the reports still gets the result.
    let _ = writeln!(std::io::stderr(), "{line}");
}
