//! Converts a file of shapes: `convert FILE [FORMAT [OPTIONS]]`, by default to NDJSON. The summary goes to standard error.
//!
//! `OPTIONS` is a JSON object: the options of reading, and as `write` those of writing.

use std::fs::File;
use std::path::Path;
use std::process::ExitCode;

use shapelex_formats::shape::{
    self, FaultKind, FileError, Limits, ReadOptions, Source, Summary, WriteOptions,
};

#[allow(clippy::print_stderr, reason = "a program of the command line")]
fn main() -> ExitCode {
    match convert(&std::env::args().skip(1).collect::<Vec<_>>()) {
        Ok(summary) => {
            eprintln!("{}", serde_json::to_string(&summary).unwrap_or_default());
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("convert: {error}");
            ExitCode::FAILURE
        }
    }
}

fn convert(arguments: &[String]) -> Result<Summary, FileError> {
    let fault = |detail: &str| FileError::new(FaultKind::Option, detail);
    let path = arguments.first().ok_or_else(|| fault("expected a file, got no argument"))?;
    let target = arguments.get(1).map_or("ndjson", String::as_str);
    let target = shape::find(target).ok_or_else(|| fault("expected a known format"))?;
    let (options, written) = match arguments.get(2) {
        Some(text) => options(text).map_err(|error| fault(&error.to_string()))?,
        None => Default::default(),
    };
    let mut source = Source::new(File::open(path)?, Limits::default())?;
    let name = Path::new(path).file_name().map(|name| name.to_string_lossy());
    let format = shape::detect(source.head(), name.as_deref())?;
    let mut writer = target.writer(std::io::stdout(), &written)?;
    let summary = shape::read(format, &mut source, &options, &mut |record| writer.push(&record))?;
    writer.finish()?;
    Ok(summary)
}

fn options(text: &str) -> serde_json::Result<(ReadOptions, WriteOptions)> {
    let mut given: serde_json::Map<String, serde_json::Value> = serde_json::from_str(text)?;
    let written = given.remove("write").map(serde_json::from_value).transpose()?;
    Ok((serde_json::from_value(given.into())?, written.unwrap_or_default()))
}
