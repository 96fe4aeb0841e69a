//! Rates of writing and reading tables: `table_rates [SHAPES [POINTS]]`, by default 1 000 000 shapes of 50 points, which are
//! written to nowhere and, a tenth of them, read from memory.

use std::time::Instant;

use shapelex_formats::shape::{
    self, FileError, Geometry, Limits, Place, Points, ReadOptions, Record, Source, WriteOptions,
};

#[allow(clippy::print_stdout, reason = "a program of the command line")]
fn main() -> Result<(), FileError> {
    let mut arguments = std::env::args().skip(1).map(|text| text.parse::<usize>());
    let mut argument = |usual: usize| arguments.next().and_then(Result::ok).unwrap_or(usual);
    let (shapes, points) = (argument(1_000_000), argument(50));
    let records = records(1000, points);
    for id in ["parquet", "arrow", "npz"] {
        let Some(format) = shape::find(id) else { continue };
        // An array is compressed: a tenth is enough to see its rate.
        let shapes = if id == "npz" { shapes / 10 } else { shapes };
        let begin = Instant::now();
        let mut writer = format.writer(std::io::sink(), &WriteOptions::default())?;
        for k in 0..shapes {
            writer.push(&records[k % records.len()])?;
        }
        writer.finish()?;
        let out = rate(shapes, begin);
        let mut bytes = Vec::new();
        let mut writer = format.writer(&mut bytes, &WriteOptions::default())?;
        for k in 0..shapes / 10 {
            writer.push(&records[k % records.len()])?;
        }
        writer.finish()?;
        let begin = Instant::now();
        let mut source = Source::new(bytes.as_slice(), Limits::default())?;
        let read = shape::read(format, &mut source, &ReadOptions::default(), &mut |_| Ok(()))?;
        let back = rate(usize::try_from(read.records).unwrap_or_default(), begin);
        println!("{id}: out {out:.2} million shapes of {points} points a second, in {back:.2}");
    }
    Ok(())
}

/// Million shapes a second.
fn rate(shapes: usize, begin: Instant) -> f64 {
    shapes as f64 / begin.elapsed().as_secs_f64() / 1e6
}

fn records(count: usize, points: usize) -> Vec<Record> {
    let record = |k: usize| {
        let coordinates =
            (0..2 * points).map(|j| ((k * 7919 + j * 104_729) % 100_003) as f64 / 97.0).collect();
        let points = Points::from_rows(2, coordinates);
        let mut record = Record::new(Geometry::Curve { points, closed: true }, Place::default());
        record.name = Some(format!("shape-{k}"));
        record.label = Some(["a", "b", "c"][k % 3].into());
        record
    };
    (0..count).map(record).collect()
}
