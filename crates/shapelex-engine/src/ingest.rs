//! Shapes as lines of JSON, one shape per line, as `GET /v1/cohorts/{cohort}/shapes` lists them, or as a stream of Arrow.

use std::collections::BTreeMap;
use std::io::{BufRead, Read};

use arrow_array::cast::AsArray;
use arrow_array::types::Float64Type;
use arrow_array::{Array, RecordBatch};
use arrow_ipc::reader::StreamReader;
use serde::Deserialize;
use serde_json::value::RawValue;

use crate::EngineError;
use crate::cohort::Description;
use crate::cohort::record::{Measures, Record};
use crate::cohort::writer::{Writer, Written};

/// Maximum length of a line in bytes: 32 767 numbers of 25 characters, and as much for texts.
const MAX_LINE_BYTES: u64 = 2 << 20;

/// Maximum length of the description of a cohort in bytes.
const MAX_DESCRIPTION_BYTES: usize = 16 << 20;

/// A line, as the service writes it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Line {
    id: String,
    #[serde(default)]
    external_id: Option<String>,
    #[serde(default)]
    subject: Option<String>,
    #[serde(default)]
    label: Option<String>,
    #[serde(default)]
    labels: BTreeMap<String, serde_json::Value>,
    #[serde(default)]
    metadata: Option<Box<RawValue>>,
    #[serde(default = "one")]
    weight: f64,
    #[serde(default)]
    measures: Measures,
    control_points: Vec<Vec<f64>>,
    #[serde(default)]
    created_at: Option<String>,
}

fn one() -> f64 {
    1.0
}

/// Reads the description of a cohort.
///
/// # Errors
/// [`EngineError::Refused`] for a text that is not one.
pub fn read_description(text: &[u8]) -> Result<Description, EngineError> {
    if text.len() > MAX_DESCRIPTION_BYTES {
        let detail = format!("expected at most {MAX_DESCRIPTION_BYTES} bytes, got {}", text.len());
        return Err(EngineError::refused("cohort", detail));
    }
    let description: Description = serde_json::from_slice(text)
        .map_err(|error| EngineError::refused("cohort", format!("expected a cohort, got {error}")))?;
    description.width()?;
    Ok(description)
}

/// Reads one line: a shape of `points` control points in dimension `dimension`.
fn read_line(text: &[u8], [points, dimension]: [usize; 2]) -> Result<Record, String> {
    let line: Line =
        serde_json::from_slice(text).map_err(|error| format!("expected a shape, got {error}"))?;
    let rows = &line.control_points;
    if rows.len() != points {
        return Err(format!("expected {points} control points, got {}", rows.len()));
    }
    if let Some(row) = rows.iter().find(|row| row.len() != dimension) {
        return Err(format!("expected {dimension} coordinates of a control point, got {}", row.len()));
    }
    if !(line.weight > 0.0) {
        return Err(format!("expected a positive weight, got {}", line.weight));
    }
    let control_points = (0..dimension).flat_map(|c| rows.iter().map(move |row| row[c])).collect();
    let attributes = (!line.labels.is_empty()).then(|| serde_json::to_string(&line.labels));
    Ok(Record {
        id: line.id,
        external_id: line.external_id,
        subject: line.subject,
        label: line.label,
        attributes: attributes.transpose().map_err(|error| error.to_string())?,
        metadata: line.metadata.map(|value| value.get().to_string()),
        weight: line.weight,
        measures: line.measures,
        control_points,
        created_at: line.created_at,
    })
}

/// Writes a revision from lines of JSON. Empty lines are skipped.
///
/// Memory: one part. Nothing names the parts until the last line has been read.
///
/// # Errors
/// [`EngineError::Refused`] with the number of the first line that is not a shape of the cohort, and if there are not as many shapes
/// as the cohort has; errors of the store.
pub async fn ingest(lines: impl BufRead, mut writer: Writer) -> Result<Written, EngineError> {
    let mut lines = Lines { lines, number: 0, text: Vec::new(), size: writer.size() };
    while let Some(record) = lines.next()? {
        writer.add(record).await?;
    }
    writer.finish().await
}

/// Shapes of a size, one JSON object per line; empty lines are skipped.
struct Lines<L> {
    lines: L,
    number: u64,
    text: Vec<u8>,
    size: [usize; 2],
}

impl<L: BufRead> Lines<L> {
    fn next(&mut self) -> Result<Option<Record>, EngineError> {
        loop {
            self.text.clear();
            let read = (&mut self.lines).take(MAX_LINE_BYTES + 1).read_until(b'\n', &mut self.text)?;
            if read == 0 {
                return Ok(None);
            }
            self.number += 1;
            let refused = |detail: String| EngineError::refused(format!("line {}", self.number), detail);
            if read as u64 > MAX_LINE_BYTES {
                return Err(refused(format!("expected at most {MAX_LINE_BYTES} bytes, got more")));
            }
            if !self.text.iter().all(u8::is_ascii_whitespace) {
                return read_line(&self.text, self.size).map(Some).map_err(refused);
            }
        }
    }
}

/// Writes a revision from a stream of Arrow with the columns `id` (string), `weight` (double) and `control_points` (fixed-size list of
/// doubles, coordinate-major: all `x`, then all `y`, …); others are ignored.
///
/// Memory: one part and one batch.
///
/// # Errors
/// As [`ingest`], with the number of the shape, counted from 0.
pub async fn ingest_arrow(stream: impl Read, mut writer: Writer) -> Result<Written, EngineError> {
    let refused = |detail: String| EngineError::refused("shapes", detail);
    let expected =
        |error: arrow_schema::ArrowError| refused(format!("expected a stream of Arrow, got {error}"));
    let width: usize = writer.size().iter().product();
    let mut first = 0;
    for batch in StreamReader::try_new(stream, None).map_err(expected)? {
        let batch = batch.map_err(expected)?;
        let records = read_batch(&batch, width).map_err(refused)?;
        for (i, record) in records.enumerate() {
            let record =
                record.map_err(|detail| EngineError::refused(format!("shape {}", first + i), detail))?;
            writer.add(record).await?;
        }
        first += batch.num_rows();
    }
    writer.finish().await
}

fn read_batch(
    batch: &RecordBatch,
    width: usize,
) -> Result<impl Iterator<Item = Result<Record, String>>, String> {
    let column = |name: &str| {
        let column = batch.column_by_name(name).filter(|column| column.null_count() == 0);
        column.cloned().ok_or_else(|| format!("expected a column '{name}' without nulls, got none"))
    };
    let (ids, weights, points) = (column("id")?, column("weight")?, column("control_points")?);
    let ids = ids.as_string_opt::<i32>().cloned().ok_or("expected strings in 'id', got others")?;
    let weights = weights.as_primitive_opt::<Float64Type>().cloned();
    let weights = weights.ok_or("expected doubles in 'weight', got others")?;
    let points =
        points.as_fixed_size_list_opt().filter(|list| list.value_length() as usize == width).cloned();
    let points =
        points.ok_or_else(|| format!("expected lists of {width} in 'control_points', got others"))?;
    let numbers =
        points.values().as_primitive_opt::<Float64Type>().filter(|numbers| numbers.null_count() == 0);
    let numbers = numbers.cloned().ok_or("expected doubles in 'control_points', got others")?;
    Ok((0..batch.num_rows()).map(move |i| {
        let (weight, first) = (weights.value(i), points.value_offset(i) as usize);
        let control_points = numbers.values()[first..first + width].to_vec();
        if !(weight > 0.0 && weight.is_finite()) {
            return Err(format!("expected a positive weight, got {weight}"));
        }
        if !control_points.iter().all(|value| value.is_finite()) {
            return Err("expected finite control points, got others".into());
        }
        Ok(Record { id: ids.value(i).into(), weight, control_points, ..Record::default() })
    }))
}
