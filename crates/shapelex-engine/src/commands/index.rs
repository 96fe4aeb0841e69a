//! The index of a revision over the scores of a dictionary.

use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use clap::Args;
use serde::Serialize;
use shapelex_engine::EngineError;
use shapelex_engine::cohort::codes::Codes;
use shapelex_engine::cohort::index::{self, Recall};
use shapelex_engine::cohort::revision::{Revision, Setting};
use shapelex_engine::dictionary::Named;
use shapelex_engine::nearest::Indexed;
use shapelex_engine::objects::Objects;
use shapelex_engine::pass::engine::Took;
use shapelex_engine::pass::source::AtRest;
use shapelex_engine::pass::work::Work;
use tokio::runtime::Handle;

use super::dictionary::{code, named};
use super::machines::Machines;
use super::selection::Selection;

#[derive(Debug, Args)]
pub(crate) struct Index {
    #[command(flatten)]
    selection: Selection,
    /// Dictionary file of components. Codes of all shapes are written first unless they exist.
    #[arg(long)]
    dictionary: PathBuf,
    /// Number of shapes for which an exact search tells what the index misses; 0 not to measure it.
    #[arg(long, default_value_t = 32, value_parser = clap::value_parser!(u16).range(0..=256))]
    recall_queries: u16,
    /// Number of neighbours of each of them.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u16).range(1..=1000))]
    neighbours: u16,
    /// Number of candidates of each of them.
    #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u16).range(1..=shapelex_engine::nearest::MAX_CANDIDATES as i64))]
    candidates: u16,
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
    groups: usize,
    size_bytes: u64,
    recall: Option<Recall>,
    seconds: f64,
    passes: Vec<Took>,
}

impl Index {
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
        if runtime.block_on(Codes::find(&revision, &named.digest))?.is_none() {
            code(&source, &objects, &named, &setting, runtime)?;
        }
        let state = source.run(Some(named.clone()), setting.clone(), &Work::Index(named.digest.clone()))?;
        let mut index = index::Index::new(&revision, &named.digest, &state)?;
        if self.recall_queries > 0 {
            let indexed =
                Indexed { revision: &revision, setting: &setting, named: &named, index: &index, threads };
            let [queries, neighbours, candidates] =
                [self.recall_queries, self.neighbours, self.candidates].map(usize::from);
            let recall = indexed.recall(runners.or_threads(), queries, neighbours, candidates);
            index.recall = Some(runtime.block_on(recall)?);
        }
        runtime.block_on(index.write(&objects))?;
        Ok(Written {
            folder: format!("{}/indexes/{}", cohort.id, named.digest),
            cohort: cohort.id,
            revision: cohort.revision,
            dictionary: named.digest.clone(),
            groups: index.groups.len(),
            size_bytes: index.size_bytes(),
            recall: index.recall,
            seconds: began.elapsed().as_secs_f64(),
            passes: source.took(),
        })
    }
}

/// An index that exists, with its dictionary.
pub(crate) struct Opened {
    pub(crate) index: index::Index,
    named: Arc<Named>,
    setting: Arc<Setting>,
}

impl Opened {
    pub(crate) fn new(
        revision: &Arc<Revision>,
        dictionary: &Path,
        runtime: &Handle,
    ) -> Result<Self, EngineError> {
        let (named, setting) = named(revision, dictionary)?;
        let index = runtime.block_on(index::Index::read(revision, &named.digest))?;
        Ok(Self { index, named, setting })
    }

    pub(crate) fn indexed<'a>(&'a self, revision: &'a Arc<Revision>, threads: NonZeroUsize) -> Indexed<'a> {
        let Self { index, named, setting } = self;
        Indexed { revision, setting, named, index, threads }
    }
}
