//! The rows that flow between the operators: `(group, part, state)`.

use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::UInt64Type;
use arrow_array::{BinaryArray, RecordBatch, UInt64Array};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use datafusion_common::{DataFusionError, Result, internal_datafusion_err};
use shapelex_analysis::accumulate::FAN_IN;

/// Position of the column of groups.
pub(crate) const GROUP: usize = 0;

/// Position of the column of parts.
pub(crate) const PART: usize = 1;

/// Schema of the rows.
pub(crate) fn schema() -> SchemaRef {
    let field = |name: &str, kind: DataType| Field::new(name, kind, false);
    let number = DataType::UInt64;
    Arc::new(Schema::new(vec![
        field("group", number.clone()),
        field("part", number),
        field("state", DataType::Binary),
    ]))
}

/// One row: the sum of a part, or of a group that is a part of the next level.
pub(crate) fn row(part: usize, state: &[u8]) -> Result<RecordBatch> {
    // A value beyond this would need offsets of 64 bits.
    if state.len() > i32::MAX as usize {
        return Err(DataFusionError::ResourcesExhausted(format!(
            "expected a sum of less than 2 GiB, got {} bytes",
            state.len()
        )));
    }
    let number = |value: usize| Arc::new(UInt64Array::from(vec![value as u64]));
    let state = Arc::new(BinaryArray::from_iter_values([state]));
    Ok(RecordBatch::try_new(schema(), vec![number(part / FAN_IN), number(part), state])?)
}

/// Parts and states of a batch.
pub(crate) fn read(batch: &RecordBatch) -> Result<impl Iterator<Item = (usize, &[u8])>> {
    let parts = batch.column(PART).as_primitive_opt::<UInt64Type>();
    let states = batch.column(PART + 1).as_binary_opt::<i32>();
    match (parts, states) {
        (Some(parts), Some(states)) => {
            Ok((0..batch.num_rows()).map(|i| (parts.value(i) as usize, states.value(i))))
        }
        _ => Err(internal_datafusion_err!("the rows of a pass have other columns: {}", batch.schema())),
    }
}
