//! Dictionaries: learnt from a revision, and the codes of its shapes.

use std::io::Write;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use clap::Args;
use serde::Serialize;
use serde_json::json;
use shapelex_analysis::accumulate::KEPT_BYTES;
use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::dictionary::method::Method;
use shapelex_analysis::dictionary::recipe::Recipe;
use shapelex_analysis::factors::Estimator;
use shapelex_analysis::frame::Frame;
use shapelex_analysis::transformation::Transformation;
use shapelex_analysis::watch::{Phase, Watch};
use shapelex_engine::EngineError;
use shapelex_engine::cohort::codes::Codes;
use shapelex_engine::cohort::revision::{Revision, Setting};
use shapelex_engine::dictionary::{self, File, Named};
use shapelex_engine::objects::Objects;
use shapelex_engine::pass::engine::Took;
use shapelex_engine::pass::source::AtRest;
use shapelex_engine::pass::work::Work;
use tokio::runtime::Handle;

use super::machines::Machines;
use super::selection::Selection;
use super::{json_word, transformation};

#[derive(Debug, Args)]
pub(crate) struct Learn {
    #[command(flatten)]
    selection: Selection,
    /// Name under which the service imports the dictionary.
    #[arg(long)]
    name: String,
    /// Class of transformations that is removed: a name, or a JSON object with matrices.
    #[arg(long, value_parser = transformation)]
    transformation: Transformation,
    /// projection, procrustes or partial_procrustes. Default: what suits the class.
    #[arg(long, value_parser = json_word::<Alignment>)]
    alignment: Option<Alignment>,
    /// training or canonical.
    #[arg(long, default_value = "training", value_parser = json_word::<Frame>)]
    frame: Frame,
    /// Learning method, as in POST /v1/dictionaries: a JSON object.
    #[arg(long, default_value = r#"{"kind": "functional_pca", "components": 20}"#, value_parser = method)]
    method: Method,
    /// Writes lines of JSON to standard error: the phase, and what is done of it.
    #[arg(long)]
    progress: bool,
    #[command(flatten)]
    pub(crate) machines: Machines,
}

fn method(text: &str) -> Result<Method, String> {
    serde_json::from_str(text).map_err(|error| error.to_string())
}

/// Writes phases and fractions to standard error, if it is asked to.
struct Progress(bool);

impl Progress {
    fn say(&self, line: &serde_json::Value) {
        if self.0 {
            // Whoever does not read the progress still gets the dictionary.
            let _ = writeln!(std::io::stderr(), "{line}");
        }
    }
}

impl Watch for Progress {
    fn phase(&self, phase: Phase, fraction: f64) {
        self.say(&json!({"phase": phase.name(), "fraction": fraction}));
    }

    fn epoch(&self, epochs: usize, objective: f64) {
        self.say(&json!({"epochs": epochs, "objective": objective}));
    }
}

impl Learn {
    pub(crate) fn answer(
        self,
        objects: Objects,
        runtime: &Handle,
        threads: NonZeroUsize,
    ) -> Result<File, EngineError> {
        let revision = runtime.block_on(self.selection.open(objects))?;
        let setting = Setting::new(revision.manifest(), &self.transformation, self.alignment)?;
        let cohort = &revision.manifest().cohort;
        let recipe = Recipe {
            representation: cohort.representation.clone(),
            correspondence: cohort.correspondence,
            direction: cohort.direction,
            mirror: cohort.mirror,
            length_unit: cohort.length_unit.clone(),
            transformation: self.transformation,
            alignment: setting.chosen,
            frame: self.frame,
            method: self.method,
            estimator: Estimator::Plain,
            held_out_seed: 0,
        };
        let runners = self.machines.runners(threads)?;
        let source = AtRest::new(revision.clone(), Arc::new(setting), runtime, runners.chosen());
        dictionary::learn(&source, &recipe, &Progress(self.progress), self.name, KEPT_BYTES)
    }
}

#[derive(Debug, Args)]
pub(crate) struct Code {
    #[command(flatten)]
    selection: Selection,
    /// Dictionary file, as `learn` writes it and GET /v1/dictionaries/{dictionary}/export answers it.
    #[arg(long)]
    dictionary: PathBuf,
    #[command(flatten)]
    pub(crate) machines: Machines,
}

/// What was written.
#[derive(Debug, Serialize)]
pub(crate) struct Written {
    cohort: String,
    revision: u64,
    dictionary: String,
    /// Folder of the files, below the store.
    folder: String,
    shapes: u64,
    size_bytes: u64,
    digest: String,
    seconds: f64,
    passes: Vec<Took>,
}

/// The dictionary of a file, for the shapes of a revision, and what these are measured by.
pub(crate) fn named(
    revision: &Arc<Revision>,
    file: &Path,
) -> Result<(Arc<Named>, Arc<Setting>), EngineError> {
    let (named, setting) = Named::new(revision, dictionary::read(&std::fs::read(file)?)?)?;
    Ok((Arc::new(named), Arc::new(setting)))
}

/// Writes the codes of all shapes, and their manifest; returns it with its digest.
pub(crate) fn code(
    source: &AtRest<'_>,
    objects: &Objects,
    named: &Arc<Named>,
    setting: &Arc<Setting>,
    runtime: &Handle,
) -> Result<(Codes, String), EngineError> {
    let work = Work::Code(named.digest.clone());
    let state = source.run(Some(named.clone()), setting.clone(), &work)?;
    let codes = Codes::new(source.revision(), &named.digest, &state)?;
    let digest = runtime.block_on(codes.write(objects))?;
    Ok((codes, digest))
}

impl Code {
    pub(crate) fn answer(
        self,
        objects: Objects,
        runtime: &Handle,
        threads: NonZeroUsize,
    ) -> Result<Written, EngineError> {
        let began = Instant::now();
        let revision = runtime.block_on(self.selection.open(objects.clone()))?;
        let cohort = revision.manifest().cohort.clone();
        let (named, setting) = named(&revision, &self.dictionary)?;
        runtime.block_on(named.keep(&objects, &cohort.id))?;
        let runners = self.machines.runners(threads)?;
        let source = AtRest::new(revision.clone(), setting.clone(), runtime, runners.chosen());
        let (codes, digest) = code(&source, &objects, &named, &setting, runtime)?;
        Ok(Written {
            folder: format!("{}/codes/{}", cohort.id, named.digest),
            cohort: cohort.id,
            revision: cohort.revision,
            dictionary: named.digest.clone(),
            shapes: codes.shapes(),
            size_bytes: codes.size_bytes(),
            digest,
            seconds: began.elapsed().as_secs_f64(),
            passes: source.took(),
        })
    }
}
