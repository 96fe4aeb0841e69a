//! The nearest shapes of a revision: those of each part, and the nearest of these.

use serde::{Deserialize, Serialize};
use shapelex_analysis::accumulate::{PART, prepare};
use shapelex_analysis::distance::{DistanceSpace, PreparedShapes};
use shapelex_analysis::neighbours::NeighbourSearch;

use crate::EngineError;
use crate::cohort::part::Numbers;
use crate::cohort::revision::Setting;

/// A search for the nearest shapes to each of several queries.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Search {
    /// Control points of the queries, coordinate-major.
    pub queries: Vec<Vec<f64>>,
    /// Number of neighbours of each.
    pub neighbours: usize,
}

/// A shape that is near.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Near {
    /// Id of the shape.
    pub id: String,
    /// Its position in the revision.
    pub position: usize,
    /// Its distance, as `POST /v1/cohorts/{cohort}/search` measures it.
    pub distance: f64,
}

impl Search {
    /// The nearest shapes of the part `k`, for each query in ascending order of distance; of equally distant ones the earlier first.
    ///
    /// Cost: at most a comparison of every query with every shape.
    ///
    /// # Errors
    /// Degenerate shapes and queries.
    pub(crate) fn of(&self, setting: &Setting, k: usize, numbers: Numbers) -> Result<Vec<u8>, EngineError> {
        let space = DistanceSpace::new(&setting.method, &setting.matching)?;
        let prepared = |mut points: Vec<f64>| -> Result<PreparedShapes, EngineError> {
            prepare(&setting.metric, setting.method.translates(), 0, &mut points)?;
            Ok(space.prepare(&points)?)
        };
        let queries = prepared(self.queries.concat())
            .map_err(|error| EngineError::refused("queries", error.to_string()))?;
        let ids = numbers.ids()?;
        let shapes = prepared(numbers.control_points).map_err(|error| match error {
            EngineError::Analysis(error) => error.after(k * PART).into(),
            other => other,
        })?;
        let mut search = NeighbourSearch::new(&space, queries, self.neighbours);
        search.offer(&shapes, &|| false)?;
        let near = search.into_sorted().into_iter().map(|found| {
            let near = found.into_iter().map(|neighbour| Near {
                id: ids.value(neighbour.position).into(),
                position: k * PART + neighbour.position,
                distance: neighbour.found.distance,
            });
            near.collect()
        });
        write(&near.collect::<Vec<Vec<Near>>>())
    }

    /// The nearest of the shapes of several parts.
    pub(crate) fn merge(&self, states: &[&[u8]]) -> Result<Vec<u8>, EngineError> {
        let mut nearest: Vec<Vec<Near>> = vec![Vec::new(); self.queries.len()];
        for state in states {
            let found = read(state)?;
            if found.len() != nearest.len() {
                let detail = format!("expected results of {} queries, got {}", nearest.len(), found.len());
                return Err(EngineError::refused("search", detail));
            }
            nearest.iter_mut().zip(found).for_each(|(nearest, found)| nearest.extend(found));
        }
        for near in &mut nearest {
            near.sort_by(|a, b| a.distance.total_cmp(&b.distance).then(a.position.cmp(&b.position)));
            near.truncate(self.neighbours);
        }
        write(&nearest)
    }
}

fn write(near: &[Vec<Near>]) -> Result<Vec<u8>, EngineError> {
    serde_json::to_vec(near).map_err(|error| EngineError::refused("search", error.to_string()))
}

/// The nearest shapes of each query, from the result of a search.
///
/// # Errors
/// Bytes that are no such result.
pub fn read(state: &[u8]) -> Result<Vec<Vec<Near>>, EngineError> {
    serde_json::from_slice(state).map_err(|error| EngineError::refused("search", error.to_string()))
}
