//! Rates of writing and reading in bulk, beside bounds of the same run: `table_rates [SHAPES [POINTS]]`, by default 1 000 000 shapes
//! of 50 points, which are written to nowhere and, a tenth of them, read from memory.
//!
//! Bounds: the numbers copied once (`copy`), one flat column of them in Parquet without lists and nulls (`flat Parquet`), and lines of
//! JSON whose numbers are parsed one after the other and dropped (`JSON`). A second of a rate is one of a core: the processor time of
//! all threads, which other programs on the machine change little, or where the system does not tell it the time that passes.

use std::hint::black_box;
use std::sync::Arc;
use std::time::Instant;

use arrow_array::{Float64Array, RecordBatch};
use arrow_schema::{DataType, Field, Schema};
use parquet::arrow::ArrowWriter;
use parquet::file::properties::WriterProperties;
use serde::Deserialize;
use shapelex_formats::shape::{
    self, FileError, Format, Geometry, Limits, Place, Points, ReadOptions, Record, Source, WriteOptions,
};

/// Number of records that are made; more shapes repeat them.
const RECORDS: usize = 1000;
/// Number of numbers of a batch of the flat column.
const BATCH: usize = 1 << 20;

#[allow(clippy::print_stdout, reason = "a program of the command line")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1).map(|text| text.parse::<usize>());
    let mut argument = |usual: usize| arguments.next().and_then(Result::ok).unwrap_or(usual);
    let (shapes, points) = (argument(1_000_000), argument(50));
    let records = records(points);
    let numbers = 2 * points * shapes;
    println!("copy: {:.2} million shapes of {points} points a second", rate(shapes, &mut || copy(numbers)));
    println!("flat Parquet: {:.2}", rate(shapes, &mut || flat(numbers).unwrap_or_default()));
    for id in ["parquet", "arrow", "npz", "ndjson"] {
        let Some(format) = shape::find(id) else { continue };
        // An array is compressed, and numbers as text are long: a tenth is enough to see a rate.
        let shapes = if matches!(id, "npz" | "ndjson") { shapes / 10 } else { shapes };
        let out = rate(shapes, &mut || write(format, std::io::sink(), &records, shapes).unwrap_or_default());
        let mut bytes = Vec::new();
        write(format, &mut bytes, &records, shapes / 10)?;
        let back = rate(shapes / 10, &mut || read(format, &bytes).unwrap_or_default());
        let megabytes = bytes.len() as f64 / (shapes / 10) as f64;
        println!("{id}: out {out:.2}, in {back:.2} ({:.0} MB/s in)", back * megabytes);
        if id == "ndjson" {
            let parsed = rate(shapes / 10, &mut || parse(&bytes));
            println!("JSON: in {parsed:.2} ({:.0} MB/s)", parsed * megabytes);
        }
    }
    Ok(())
}

/// Million shapes a second: the best of three times.
fn rate(shapes: usize, work: &mut dyn FnMut() -> usize) -> f64 {
    let start = Instant::now();
    let clock = || processor_seconds().unwrap_or_else(|| start.elapsed().as_secs_f64());
    let seconds = |_| {
        let begin = clock();
        black_box(work());
        clock() - begin
    };
    shapes as f64 / (0..3).map(seconds).fold(f64::INFINITY, f64::min) / 1e6
}

/// Processor time of this process, of user and system, as Linux tells it.
fn processor_seconds() -> Option<f64> {
    const TICKS_A_SECOND: f64 = 100.0;
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    // Behind the name, which may have any characters, field 3 comes first; the times are 14 and 15.
    let fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11).take(2);
    let ticks = fields.map(|field| field.parse::<f64>().ok()).sum::<Option<f64>>()?;
    Some(ticks / TICKS_A_SECOND)
}

/// Copies numbers in blocks, as a writer does.
fn copy(numbers: usize) -> usize {
    let block: Vec<f64> = (0..BATCH).map(|k| k as f64).collect();
    (0..numbers.div_ceil(BATCH)).map(|_| black_box(block.clone()).len()).sum()
}

/// Writes numbers as one column without lists and nulls.
fn flat(numbers: usize) -> Result<usize, Box<dyn std::error::Error>> {
    let schema = Arc::new(Schema::new(vec![Field::new("x", DataType::Float64, false)]));
    let settings = WriterProperties::builder()
        .set_dictionary_enabled(false)
        .set_statistics_enabled(parquet::file::properties::EnabledStatistics::None);
    let mut writer = ArrowWriter::try_new(std::io::sink(), Arc::clone(&schema), Some(settings.build()))?;
    let block: Vec<f64> = (0..BATCH).map(|k| k as f64).collect();
    for _ in 0..numbers.div_ceil(BATCH) {
        let column = Arc::new(Float64Array::from(block.clone()));
        writer.write(&RecordBatch::try_new(Arc::clone(&schema), vec![column])?)?;
    }
    writer.close()?;
    Ok(numbers)
}

/// Parses the points of all lines.
fn parse(bytes: &[u8]) -> usize {
    #[derive(Deserialize)]
    struct Line {
        points: Vec<[f64; 2]>,
    }
    let lines = bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty());
    lines.filter_map(|line| serde_json::from_slice::<Line>(line).ok()).map(|line| line.points.len()).sum()
}

fn write(
    format: &'static Format,
    output: impl std::io::Write + Send,
    records: &[Record],
    shapes: usize,
) -> Result<usize, FileError> {
    let mut writer = format.writer(output, &WriteOptions::default())?;
    for k in 0..shapes {
        writer.push(&records[k % records.len()])?;
    }
    writer.finish()?;
    Ok(shapes)
}

fn read(format: &'static Format, bytes: &[u8]) -> Result<usize, FileError> {
    let mut source = Source::new(bytes, Limits::default())?;
    let read = shape::read(format, &mut source, &ReadOptions::default(), &mut |record| {
        black_box(record);
        Ok(())
    })?;
    Ok(usize::try_from(read.records).unwrap_or_default())
}

fn records(points: usize) -> Vec<Record> {
    let record = |k: usize| {
        let coordinates =
            (0..2 * points).map(|j| ((k * 7919 + j * 104_729) % 100_003) as f64 / 97.0).collect();
        let points = Points::from_rows(2, coordinates);
        let mut record = Record::new(Geometry::Curve { points, closed: true }, Place::default());
        record.name = Some(format!("shape-{k}"));
        record.label = Some(["a", "b", "c"][k % 3].into());
        record
    };
    (0..RECORDS).map(record).collect()
}
