//! Approximate search: candidates by an index, compared as an exact search compares all shapes.
//!
//! ```text
//! query ─► scores ─► near scores in the graph of each group ─► candidates ─► distances, as `search` measures them ─► the nearest
//! ```
//!
//! Distances are exact; what may be missed is a neighbour that is no candidate, because its scores are further off than those of others
//! (what the components do not describe, or an alignment to the mean instead of to the query), or because the graph did not lead to it.
//! [`Recall`] says how many.

use std::num::NonZeroUsize;
use std::sync::Arc;

use futures_util::{StreamExt, TryStreamExt};
use shapelex_analysis::accumulate::{PART, prepare};
use shapelex_analysis::distance::DistanceSpace;
use shapelex_analysis::neighbours::NeighbourSearch;

use crate::EngineError;
use crate::cohort::index::{GROUP, Index, Recall};
use crate::cohort::part::IDS;
use crate::cohort::revision::{Revision, Setting};
use crate::named::Named;
use crate::pass::graph::{Graph, Scores};
use crate::pass::search::{Near, Search, read};
use crate::pass::source::{Runner, Subject};
use crate::pass::work::Work;

/// Parts that are read ahead.
const AHEAD: usize = 4;

/// Maximum number of candidates of a query.
pub const MAX_CANDIDATES: usize = 10_000;

/// A revision with an index.
#[derive(Debug)]
pub struct Indexed<'a> {
    /// The revision.
    pub revision: &'a Arc<Revision>,
    /// What its shapes are measured by.
    pub setting: &'a Arc<Setting>,
    /// The dictionary that the index is over.
    pub named: &'a Arc<Named>,
    /// The index.
    pub index: &'a Index,
    /// Number of graphs that are in memory at the same time.
    pub threads: NonZeroUsize,
}

/// Positions of some shapes in the revision.
type Positions = Vec<usize>;

impl Indexed<'_> {
    /// The nearest of `candidates` shapes to each query, in ascending order of distance; of equally distant ones the earlier first.
    ///
    /// Cost: one read of the index, and of every part with a candidate; some hundreds of distances of scores in each graph, and
    /// `candidates` distances of shapes for each query. Memory: `threads` graphs, five parts.
    ///
    /// # Errors
    /// Degenerate queries; damaged files; errors of the store.
    pub async fn search(&self, search: &Search, candidates: usize) -> Result<Vec<Vec<Near>>, EngineError> {
        let positions = self.candidates(&search.queries, candidates.max(search.neighbours)).await?;
        self.compare(search, positions).await
    }

    /// Positions of the candidates of all queries, ascending.
    async fn candidates(&self, queries: &[Vec<f64>], candidates: usize) -> Result<Positions, EngineError> {
        let scores = Arc::new(self.scores(queries)?);
        let objects = self.revision.objects();
        let search = |group: usize| {
            let scores = scores.clone();
            async move {
                let file = self.index.graph(objects, group).await?;
                let shapes = self.index.groups[group].shapes as usize;
                let nearest = move || -> Result<Vec<Vec<(usize, f32)>>, EngineError> {
                    let graph = Graph::read(scores.dimensions(), shapes, &file)?;
                    scores.each().map(|scores| graph.nearest(scores, candidates)).collect()
                };
                let found = tokio::task::spawn_blocking(nearest).await;
                let found = found.map_err(|error| EngineError::refused("runtime", error.to_string()))??;
                Ok::<_, EngineError>((group, found))
            }
        };
        let groups = futures_util::stream::iter(0..self.index.groups.len()).map(search);
        let mut groups = groups.buffered(self.threads.get());
        let mut near: Vec<Vec<(usize, f32)>> = vec![Vec::new(); queries.len()];
        while let Some((group, found)) = groups.try_next().await? {
            for (near, found) in near.iter_mut().zip(found) {
                near.extend(found.into_iter().map(|(k, distance)| (group * GROUP + k, distance)));
                near.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
                near.truncate(candidates);
            }
        }
        let mut positions: Positions = near.into_iter().flatten().map(|(position, _)| position).collect();
        positions.sort_unstable();
        positions.dedup();
        Ok(positions)
    }

    /// Scores of the queries.
    fn scores(&self, queries: &[Vec<f64>]) -> Result<Scores, EngineError> {
        let dictionary = &self.named.dictionary;
        let prepared = dictionary.preparation.prepare(&queries.concat());
        let prepared = prepared.map_err(|error| EngineError::refused("queries", error.to_string()))?;
        let whitened: Vec<f64> = prepared.into_iter().flat_map(|prepared| prepared.whitened).collect();
        let mut scores = Scores::new(dictionary)?;
        for code in dictionary.model.codes(&whitened, dictionary.metric().len())? {
            scores.extend(code.values);
        }
        Ok(scores)
    }

    /// The nearest of the shapes at these positions, ascending ones.
    async fn compare(&self, search: &Search, positions: Positions) -> Result<Vec<Vec<Near>>, EngineError> {
        let Setting { metric, method, matching, .. } = &**self.setting;
        let space = DistanceSpace::new(method, matching)?;
        let prepared = |mut points: Vec<f64>| {
            prepare(metric, method.translates(), 0, &mut points)?;
            space.prepare(&points)
        };
        let queries = prepared(search.queries.concat())
            .map_err(|error| EngineError::refused("queries", error.to_string()))?;
        let mut nearest = NeighbourSearch::new(&space, queries, search.neighbours);
        let in_parts: Vec<&[usize]> = positions.chunk_by(|a, b| a / PART == b / PART).collect();
        let read = |positions: &'_ [usize]| {
            let positions = positions.to_vec();
            async move {
                let numbers = self.revision.read(positions[0] / PART, &[IDS]).await?;
                Ok::<_, EngineError>((positions, numbers))
            }
        };
        let mut parts = futures_util::stream::iter(in_parts).map(read).buffered(AHEAD);
        let (mut ids, width) = (Vec::with_capacity(positions.len()), self.revision.width());
        while let Some((positions, numbers)) = parts.try_next().await? {
            let names = numbers.ids()?;
            ids.extend(positions.iter().map(|position| names.value(position % PART).to_string()));
            let shape = |position: &usize| &numbers.control_points[position % PART * width..][..width];
            let points = positions.iter().flat_map(shape).copied().collect();
            // Shapes that have codes are not degenerate: there is no position to tell.
            nearest.offer(&prepared(points)?, &|| false)?;
        }
        let near = |found: shapelex_analysis::neighbours::Neighbour| Near {
            id: ids[found.position].clone(),
            position: positions[found.position],
            distance: found.found.distance,
        };
        let found = nearest.into_sorted().into_iter();
        Ok(found.map(|found| found.into_iter().map(near).collect()).collect())
    }

    /// What a search finds of the true neighbours of shapes of the revision, evenly spaced; these are searched by `runner`.
    ///
    /// Cost: an exact search for as many queries, and the same by the index.
    ///
    /// # Errors
    /// As [`search`](Self::search) and [`Runner::run`]; [`EngineError::Refused`] for a revision of one shape.
    pub async fn recall(
        &self,
        runner: &dyn Runner,
        queries: usize,
        neighbours: usize,
        candidates: usize,
    ) -> Result<Recall, EngineError> {
        let shapes = self.revision.shapes();
        let (queries, neighbours) = (queries.min(shapes), neighbours.min(shapes.saturating_sub(1)));
        if queries == 0 || neighbours == 0 {
            return Err(EngineError::refused(
                "recall",
                format!("expected two shapes and a query, got {shapes} shapes"),
            ));
        }
        let positions: Positions = (0..queries).map(|k| (2 * k + 1) * shapes / (2 * queries)).collect();
        // A shape is its own neighbour.
        let candidates = candidates.max(neighbours + 1);
        let search = Search { queries: self.points(&positions).await?, neighbours: neighbours + 1 };
        let subject = Subject::new(self.revision.clone(), self.setting.clone(), None);
        let (state, _) = runner.run(subject, &Work::Search(search.clone())).await?;
        let (exact, found) = (read(&state)?, self.search(&search, candidates).await?);
        let fractions = positions.iter().zip(exact.iter().zip(&found)).map(|(own, (exact, found))| {
            let others = |near: &[Near]| {
                near.iter().filter(|near| near.position != *own).take(neighbours).cloned().collect()
            };
            let (exact, found): (Vec<Near>, Vec<Near>) = (others(exact), others(found));
            // Of equally distant ones, any will do.
            let furthest = exact.last().map_or(0.0, |near| near.distance);
            found.iter().filter(|near| near.distance <= furthest).count() as f64 / exact.len() as f64
        });
        let fractions: Vec<f64> = fractions.collect();
        Ok(Recall {
            queries,
            neighbours,
            candidates,
            mean: fractions.iter().sum::<f64>() / fractions.len() as f64,
            lowest: fractions.iter().copied().fold(1.0, f64::min),
        })
    }

    /// Control points of the shapes at some positions.
    async fn points(&self, positions: &[usize]) -> Result<Vec<Vec<f64>>, EngineError> {
        let (mut points, width) = (Vec::new(), self.revision.width());
        for in_part in positions.chunk_by(|a, b| a / PART == b / PART) {
            let numbers = self.revision.read(in_part[0] / PART, &[]).await?;
            let shape =
                |position: &usize| numbers.control_points[position % PART * width..][..width].to_vec();
            points.extend(in_part.iter().map(shape));
        }
        Ok(points)
    }
}
