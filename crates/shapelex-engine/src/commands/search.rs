//! The nearest shapes of a revision.

use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use clap::Args;
use serde::Serialize;
use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::transformation::Transformation;
use shapelex_engine::EngineError;
use shapelex_engine::cohort::revision::{Revision, Setting};
use shapelex_engine::ingest::read_shapes;
use shapelex_engine::objects::Objects;
use shapelex_engine::pass::engine::Took;
use shapelex_engine::pass::search::{self, Near};
use shapelex_engine::pass::source::Subject;
use shapelex_engine::pass::work::Work;
use tokio::runtime::Handle;

use super::machines::Machines;
use super::selection::Selection;
use super::{json_word, transformation};

/// Maximum number of queries: they travel with every task.
const MAX_QUERIES: usize = 256;

#[derive(Debug, Args)]
pub(crate) struct Search {
    #[command(flatten)]
    selection: Selection,
    /// Queries, one JSON object per line with id and control_points, as GET /v1/cohorts/{cohort}/shapes lists shapes.
    #[arg(long)]
    queries: PathBuf,
    /// Number of neighbours of each query.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u16).range(1..=1000))]
    neighbours: u16,
    /// Class of transformations that is removed: a name, or a JSON object with matrices.
    #[arg(long, default_value = "similarity", value_parser = transformation)]
    transformation: Transformation,
    /// projection, procrustes or partial_procrustes. Default: what suits the class.
    #[arg(long, value_parser = json_word::<Alignment>)]
    alignment: Option<Alignment>,
    #[cfg(feature = "approximate")]
    #[command(flatten)]
    by_index: ByIndex,
    #[command(flatten)]
    pub(crate) machines: Machines,
}

/// A search that compares candidates alone.
#[cfg(feature = "approximate")]
#[derive(Debug, Args)]
struct ByIndex {
    /// Dictionary file whose index finds candidates: a neighbour that is none of them is missed. Distances are those of the class and
    /// the alignment of the dictionary.
    #[arg(long, conflicts_with_all = ["transformation", "alignment"])]
    approximate: Option<PathBuf>,
    /// Number of candidates of each query.
    #[arg(long, default_value_t = 50, requires = "approximate", value_parser = clap::value_parser!(u16).range(1..=shapelex_engine::nearest::MAX_CANDIDATES as i64))]
    candidates: u16,
}

/// What was found.
#[derive(Debug, Serialize)]
pub(crate) struct Found {
    cohort: String,
    revision: u64,
    queries: Vec<Query>,
    /// Of an approximate search: number of candidates of each query, and what was measured when the index was made.
    #[cfg(feature = "approximate")]
    #[serde(skip_serializing_if = "Option::is_none")]
    approximate: Option<Approximate>,
    seconds: f64,
    passes: Vec<Took>,
}

#[cfg(feature = "approximate")]
#[derive(Debug, Serialize)]
struct Approximate {
    candidates: usize,
    recall: Option<shapelex_engine::cohort::index::Recall>,
}

#[derive(Debug, Serialize)]
struct Query {
    id: String,
    neighbours: Vec<Near>,
}

impl Search {
    pub(crate) fn answer(
        self,
        objects: Objects,
        runtime: &Handle,
        threads: NonZeroUsize,
    ) -> Result<Found, EngineError> {
        let began = Instant::now();
        let revision = runtime.block_on(self.selection.open(objects))?;
        let cohort = revision.manifest().cohort.clone();
        let size = [cohort.width()? / cohort.representation.dimension(), cohort.representation.dimension()];
        let queries = std::io::BufReader::new(std::fs::File::open(&self.queries)?);
        let (ids, queries): (Vec<_>, Vec<_>) = read_shapes(queries, size, MAX_QUERIES)?
            .into_iter()
            .map(|shape| (shape.id, shape.control_points))
            .unzip();
        let search = search::Search { queries, neighbours: self.neighbours.into() };
        let mut found = Found {
            cohort: cohort.id,
            revision: cohort.revision,
            queries: Vec::new(),
            #[cfg(feature = "approximate")]
            approximate: None,
            seconds: 0.0,
            passes: Vec::new(),
        };
        #[cfg(feature = "approximate")]
        let near = match &self.by_index.approximate {
            Some(dictionary) => {
                let candidates = usize::from(self.by_index.candidates).max(search.neighbours);
                let index = super::index::Opened::new(&revision, dictionary, runtime)?;
                found.approximate = Some(Approximate { candidates, recall: index.index.recall.clone() });
                runtime.block_on(index.indexed(&revision, threads).search(&search, candidates))?
            }
            None => self.exact(revision, search, runtime, threads, &mut found)?,
        };
        #[cfg(not(feature = "approximate"))]
        let near = self.exact(revision, search, runtime, threads, &mut found)?;
        let queries = ids.into_iter().zip(near);
        found.queries = queries.map(|(id, neighbours)| Query { id, neighbours }).collect();
        found.seconds = began.elapsed().as_secs_f64();
        Ok(found)
    }

    /// Compares the queries with all shapes.
    fn exact(
        &self,
        revision: Arc<Revision>,
        search: search::Search,
        runtime: &Handle,
        threads: NonZeroUsize,
        found: &mut Found,
    ) -> Result<Vec<Vec<Near>>, EngineError> {
        let setting = Setting::new(revision.manifest(), &self.transformation, self.alignment)?;
        let runners = self.machines.runners(threads)?;
        let subject = Subject::new(revision, Arc::new(setting), None);
        let (state, took) = runtime.block_on(runners.or_threads().run(subject, &Work::Search(search)))?;
        found.passes.push(took);
        search::read(&state)
    }
}
