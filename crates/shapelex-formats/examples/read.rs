//! Reads a file of shapes and says what is in it and how fast it was read: `read FILE [OPTIONS]`.

use std::fs::File;
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use shapelex_formats::shape::{self, FaultKind, FileError, Geometry, Limits, ReadOptions, Source};

#[allow(clippy::print_stderr, clippy::print_stdout, reason = "a program of the command line")]
fn main() -> ExitCode {
    match read(&std::env::args().skip(1).collect::<Vec<_>>()) {
        Ok(line) => {
            println!("{line}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("read: {error}");
            ExitCode::FAILURE
        }
    }
}

fn read(arguments: &[String]) -> Result<String, FileError> {
    let fault = |detail: &str| FileError::new(FaultKind::Option, detail);
    let path = arguments.first().ok_or_else(|| fault("expected a file, got no argument"))?;
    let options: ReadOptions = match arguments.get(1) {
        Some(text) => serde_json::from_str(text).map_err(|error| fault(&error.to_string()))?,
        None => ReadOptions::default(),
    };
    let mut source = Source::new(File::open(path)?, Limits::default())?;
    let name = Path::new(path).file_name().map(|name| name.to_string_lossy());
    let format = shape::detect(source.head(), name.as_deref())?;
    let (mut points, start) = (0, Instant::now());
    let summary = shape::read(format, &mut source, &options, &mut |record| {
        points += match &record.geometry {
            Geometry::Curve { points, .. } | Geometry::Landmarks(points) => points.len(),
            Geometry::Mesh(mesh) => mesh.vertices.len(),
            Geometry::Fourier(fourier) => fourier.harmonics(),
        };
        Ok(())
    })?;
    let seconds = start.elapsed().as_secs_f64();
    let rate = source.offset() as f64 / 1e6 / seconds;
    Ok(format!(
        "{}: {} records of {points} points, {seconds:.2} s, {rate:.0} MB/s",
        format.name, summary.records
    ))
}
