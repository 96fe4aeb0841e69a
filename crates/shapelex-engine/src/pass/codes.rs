//! The codes of the shapes of a part as Parquet.
//!
//! | column | type | content |
//! |---|---|---|
//! | `id` | string | of the shape |
//! | `score_1`, `score_2`, … | double | scores of the components |
//! | `atoms`, `values` | lists | sparse codes: numbers of the atoms from 0 on, and their coefficients, as many for each atom as the class has parameters |
//! | `residual` | double | `‖y − ŷ‖²` of the prepared shape `y`, in the square of the unit of length, or of shapes of unit norm |
//! | `t_squared` | double | `T²` of the scores |
//!
//! The metadata of the file say `shapelex.dictionary`, the digest of the dictionary.

use std::sync::Arc;

use arrow_array::builder::{Float64Builder, ListBuilder, UInt32Builder};
use arrow_array::{Array, ArrayRef, Float64Array, RecordBatch, StringArray};
use arrow_schema::{Field, Schema};
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::{EnabledStatistics, WriterProperties};
use shapelex_analysis::accumulate::{ShapeSource, ShapesInMemory};
use shapelex_analysis::dictionary::in_use::Dictionary;
use shapelex_analysis::dictionary::model::Model;
use shapelex_analysis::preparation::Posed;
use shapelex_analysis::sparse::SparseCode;

use crate::EngineError;

/// Shapes that are coded at once.
const STEP: usize = 512;

/// Codes by column, while they are collected.
struct Columns {
    /// One list for each component; none for sparse codes.
    scores: Vec<Vec<f64>>,
    atoms: ListBuilder<UInt32Builder>,
    values: ListBuilder<Float64Builder>,
    residuals: Vec<f64>,
    distances: Vec<f64>,
}

/// The codes of shapes in a dictionary, as Parquet. Equal shapes give equal bytes.
///
/// # Errors
/// A shape that cannot be coded, with its position.
pub(crate) fn encode(
    dictionary: &Dictionary,
    digest: &str,
    shapes: &ShapesInMemory,
    ids: StringArray,
) -> Result<Vec<u8>, EngineError> {
    let (model, length) = (&dictionary.model, dictionary.metric().len());
    let components = if matches!(model, Model::Components { .. }) { model.len() } else { 0 };
    let mut columns = Columns {
        scores: vec![Vec::with_capacity(ids.len()); components],
        atoms: ListBuilder::new(UInt32Builder::new()),
        values: ListBuilder::new(Float64Builder::new()),
        residuals: Vec::with_capacity(ids.len()),
        distances: Vec::new(),
    };
    Posed { source: shapes, preparation: &dictionary.preparation }.for_each_batch(&mut |batch| {
        for (i, some) in batch.whitened.chunks(STEP * length).enumerate() {
            let codes = model.codes(some, length).map_err(|error| error.after(batch.first + i * STEP))?;
            columns.add(model, some.chunks_exact(length), codes);
        }
        Ok(())
    })?;
    columns.write(digest, ids).map_err(|error| EngineError::refused("codes", error.to_string()))
}

impl Columns {
    fn add<'a>(&mut self, model: &Model, shapes: impl Iterator<Item = &'a [f64]>, codes: Vec<SparseCode>) {
        for (y, code) in shapes.zip(codes) {
            let residual = match model {
                // The objective of components is half of it.
                Model::Components { .. } => 2.0 * code.objective,
                Model::Sparse { .. } => {
                    y.iter().zip(model.reconstruct(&code)).map(|(y, z)| (y - z).powi(2)).sum()
                }
            };
            self.residuals.push(residual);
            self.distances.extend(model.distance(&code));
            if self.scores.is_empty() {
                self.atoms.append_value(code.indices.iter().map(|atom| Some(*atom as u32)));
                self.values.append_value(code.values.iter().map(|value| Some(*value)));
            } else {
                self.scores.iter_mut().zip(&code.values).for_each(|(column, value)| column.push(*value));
            }
        }
    }

    fn write(mut self, digest: &str, ids: StringArray) -> Result<Vec<u8>, parquet::errors::ParquetError> {
        let numbers = |values: Vec<f64>| -> ArrayRef { Arc::new(Float64Array::from(values)) };
        let mut columns: Vec<(String, ArrayRef)> = vec![("id".into(), Arc::new(ids))];
        if self.scores.is_empty() {
            columns.push(("atoms".into(), Arc::new(self.atoms.finish())));
            columns.push(("values".into(), Arc::new(self.values.finish())));
        }
        let scores = self.scores.into_iter().enumerate();
        columns.extend(scores.map(|(i, scores)| (format!("score_{}", i + 1), numbers(scores))));
        columns.push(("residual".into(), numbers(self.residuals)));
        if !self.distances.is_empty() {
            columns.push(("t_squared".into(), numbers(self.distances)));
        }
        let field = |(name, column): &(String, ArrayRef)| Field::new(name, column.data_type().clone(), false);
        let schema = Arc::new(Schema::new(columns.iter().map(field).collect::<Vec<_>>()));
        let properties = WriterProperties::builder()
            .set_created_by("shapelex-engine".into())
            .set_compression(Compression::UNCOMPRESSED)
            .set_dictionary_enabled(false)
            .set_statistics_enabled(EnabledStatistics::None)
            .set_key_value_metadata(Some(vec![KeyValue::new(
                "shapelex.dictionary".into(),
                digest.to_string(),
            )]))
            .build();
        let columns = columns.into_iter().map(|(_, column)| column).collect();
        let mut writer = ArrowWriter::try_new(Vec::new(), schema.clone(), Some(properties))?;
        writer.write(&RecordBatch::try_new(schema, columns)?)?;
        writer.into_inner()
    }
}
