//! Graphs of near neighbours over the scores of a group of shapes, by which a search looks at some hundreds of shapes instead of all.
//!
//! The graph is a hierarchical navigable small world, made by one thread in the order of the shapes; the generator of their levels
//! begins the same each time, so equal scores give equal bytes. Scores are divided by their largest standard deviation.
//!
//! Cost: `O(log n)` distances of scores for each shape that is added or searched; memory and file: the scores in single precision, and
//! some 150 bytes a shape.
//!
//! Source: Malkov and Yashunin 2020, *Efficient and robust approximate nearest neighbor search using hierarchical navigable small world
//! graphs*.

use arrow_array::cast::AsArray;
use arrow_array::types::Float64Type;
use bytes::Bytes;
use parquet::arrow::ProjectionMask;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use shapelex_analysis::accumulate::PART;
use shapelex_analysis::dictionary::in_use::Dictionary;
use shapelex_analysis::dictionary::model::Model;
use usearch::{IndexOptions, MetricKind, ScalarKind};

use crate::EngineError;

/// Scores of shapes in a dictionary of components.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Scores {
    dimensions: usize,
    /// What scores are divided by, so that their squares are single-precision numbers whatever the unit of length is.
    unit: f64,
    values: Vec<f32>,
}

impl Scores {
    /// No scores yet.
    ///
    /// # Errors
    /// [`EngineError::Refused`] for a dictionary that is none of components.
    pub(crate) fn new(dictionary: &Dictionary) -> Result<Self, EngineError> {
        let Model::Components { spread, .. } = &dictionary.model else {
            let detail = "expected a dictionary of components, got one of atoms with sparse codes";
            return Err(EngineError::refused("dictionary", detail));
        };
        let largest = spread.covariance.diagonal().max().sqrt();
        let unit = if largest > 0.0 { largest } else { 1.0 };
        Ok(Self { dimensions: spread.mean.len(), unit, values: Vec::new() })
    }

    /// Number of scores of a shape.
    pub(crate) fn dimensions(&self) -> usize {
        self.dimensions
    }

    /// Number of shapes.
    pub(crate) fn len(&self) -> usize {
        self.values.len() / self.dimensions
    }

    /// Adds the scores of one shape after the other.
    pub(crate) fn extend(&mut self, scores: impl IntoIterator<Item = f64>) {
        self.values.extend(scores.into_iter().map(|score| (score / self.unit) as f32));
    }

    /// Adds the scores of the shapes of a part, from a file of codes.
    ///
    /// # Errors
    /// [`EngineError::Damaged`] for a file without these scores.
    pub(crate) fn add_codes(&mut self, file: Bytes) -> Result<(), EngineError> {
        let columns = columns(file, self.dimensions)?;
        let shapes = columns.first().map_or(0, Vec::len);
        self.extend((0..shapes).flat_map(|shape| columns.iter().map(move |column| column[shape])));
        Ok(())
    }

    /// Scores of each shape.
    pub(crate) fn each(&self) -> impl Iterator<Item = &[f32]> {
        self.values.chunks_exact(self.dimensions)
    }
}

/// The columns of scores of a file of codes.
///
/// # Errors
/// [`EngineError::Damaged`] for a file without them.
fn columns(file: Bytes, components: usize) -> Result<Vec<Vec<f64>>, EngineError> {
    let not =
        |error: &dyn std::fmt::Display| EngineError::damaged("codes", "a file of scores", error.to_string());
    let builder = ParquetRecordBatchReaderBuilder::try_new(file).map_err(|error| not(&error))?;
    let names = (1..=components).map(|k| format!("score_{k}"));
    let mask: Vec<usize> = names
        .map(|name| builder.schema().index_of(&name))
        .collect::<Result<_, _>>()
        .map_err(|error| not(&error))?;
    let mask = ProjectionMask::roots(builder.parquet_schema(), mask);
    let mut columns = vec![Vec::new(); components];
    for batch in builder.with_projection(mask).with_batch_size(PART).build().map_err(|error| not(&error))? {
        let batch = batch.map_err(|error| not(&error))?;
        for (column, scores) in columns.iter_mut().zip(batch.columns()) {
            let scores = scores.as_primitive_opt::<Float64Type>().ok_or_else(|| not(&scores.data_type()))?;
            column.extend_from_slice(scores.values());
        }
    }
    Ok(columns)
}

/// Number of near shapes that a shape leads to, twice as many at the lowest level.
const LINKS: usize = 16;

/// Number of near shapes from which these are chosen.
const CHOSEN_FROM: usize = 64;

/// A graph with the scores of its shapes.
pub(crate) struct Graph(usearch::Index);

fn failed(error: impl std::fmt::Display) -> EngineError {
    EngineError::refused("index", error.to_string())
}

impl Graph {
    fn empty(dimensions: usize) -> Result<Self, EngineError> {
        let options = IndexOptions {
            dimensions,
            metric: MetricKind::L2sq,
            quantization: ScalarKind::F32,
            connectivity: LINKS,
            expansion_add: CHOSEN_FROM,
            ..IndexOptions::default()
        };
        usearch::Index::new(&options).map(Self).map_err(failed)
    }

    /// Makes the graph of some shapes.
    ///
    /// # Errors
    /// Memory that does not suffice.
    pub(crate) fn new(scores: &Scores) -> Result<Self, EngineError> {
        let graph = Self::empty(scores.dimensions)?;
        // The levels of shapes are drawn by thread.
        graph.0.reserve_capacity_and_threads(scores.len(), 1).map_err(failed)?;
        for (k, score) in scores.each().enumerate() {
            graph.0.add(k as u64, score).map_err(failed)?;
        }
        Ok(graph)
    }

    /// The content of a file.
    ///
    /// # Errors
    /// None that is known.
    pub(crate) fn to_bytes(&self) -> Result<Vec<u8>, EngineError> {
        let mut bytes = vec![0; self.0.serialized_length()];
        self.0.save_to_buffer(&mut bytes).map_err(failed)?;
        Ok(bytes)
    }

    /// Reads a file of so many shapes, whose digest has been checked.
    ///
    /// # Errors
    /// [`EngineError::Refused`] for a graph of other shapes.
    pub(crate) fn read(dimensions: usize, shapes: usize, bytes: &[u8]) -> Result<Self, EngineError> {
        let graph = Self::empty(dimensions)?;
        graph.0.load_from_buffer(bytes).map_err(failed)?;
        if (graph.0.size(), graph.0.dimensions()) != (shapes, dimensions) {
            let detail = format!("expected the graph of {shapes} shapes, got one of {}", graph.0.size());
            return Err(EngineError::refused("index", detail));
        }
        Ok(graph)
    }

    /// Positions of near shapes and their squared distances, the nearest first.
    ///
    /// # Errors
    /// Scores of another dictionary; a graph that names shapes beyond its own.
    pub(crate) fn nearest(&self, scores: &[f32], count: usize) -> Result<Vec<(usize, f32)>, EngineError> {
        self.0.change_expansion_search(count.max(CHOSEN_FROM));
        let found = self.0.search(scores, count).map_err(failed)?;
        let shapes = self.0.size() as u64;
        if let Some(key) = found.keys.iter().find(|key| **key >= shapes) {
            return Err(failed(format!("expected a shape below {shapes}, got {key}")));
        }
        Ok(found.keys.iter().map(|key| *key as usize).zip(found.distances).collect())
    }
}

/// The graph of a group as a file.
///
/// # Errors
/// [`EngineError::Refused`] for a dictionary that is none of components; files without scores.
pub(crate) fn encode(dictionary: &Dictionary, files: Vec<Bytes>) -> Result<(Bytes, u64), EngineError> {
    let mut scores = Scores::new(dictionary)?;
    files.into_iter().try_for_each(|file| scores.add_codes(file))?;
    let shapes = scores.len() as u64;
    Ok((Graph::new(&scores)?.to_bytes()?.into(), shapes))
}
