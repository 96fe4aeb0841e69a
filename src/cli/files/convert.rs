//! `shapelex convert`: translates a file of shapes.

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;

use super::content::{Opened, is_standard, shown};
use super::{Complete, Reading, Writing, note, own_limits};
use crate::cli::at::Outcome;
use crate::service::files::unknown_format;
use crate::wire::files::{self, FileError, Format, Place, Summary};
use crate::wire::formulas::Escaped;
use crate::wire::summary::{FileSummary, left_out};

/// Number of bytes written at once.
const BUFFER: usize = 1 << 20;

#[derive(Debug, Args)]
pub(in crate::cli) struct ConvertArgs {
    /// File to read; `-` is standard input
    file: PathBuf,
    /// Format to write, as an id, a media type or an ending. Default: by the name of the output, else ndjson
    #[arg(long, value_name = "FORMAT")]
    to: Option<String>,
    /// File to write, which must not exist; `-` is standard output, as without it
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    reading: Reading,
    #[command(flatten)]
    writing: Writing,
    /// Describe the files on standard error as JSON
    #[arg(long)]
    json: bool,
}

/// Result of a conversion.
#[derive(Debug, Serialize)]
struct Converted {
    from: &'static str,
    to: &'static str,
    /// Summary by the reader.
    #[serde(flatten)]
    read: Summary,
    /// Summary by the writer.
    written: Summary,
}

/// Translates the file.
pub(super) fn run(args: &ConvertArgs) -> Result<Outcome, String> {
    let target = target(args)?;
    let (options, stated) = (args.reading.options()?, args.reading.format()?);
    let (writing, escapes) = (args.writing.options()?, args.writing.escapes(target)?);
    let failed = |error: FileError| format!("{}: {error}", shown(&args.file));
    let opened = Opened::new(&args.file, stated, &options).map_err(failed)?;
    let convert = |output: &mut (dyn Write + Send)| {
        let mut opened = opened;
        let mut output = Escaped::new(output, escapes);
        let mut writer = target.writer(&mut output, &writing)?;
        let mut push = |record| writer.push(&record);
        let format = opened.format;
        let read = format.read(&mut opened.source, &options, &own_limits(), &|| false, &mut push)?;
        let written = writer.finish()?;
        output.end()?;
        if written.records == 0 {
            let said = FileSummary::new(format.id(), read).without_shapes();
            let said = if said.is_empty() { String::new() } else { format!(": {}", said.join("; ")) };
            return Err(FileError::malformed(
                Place::default(),
                format!("expected at least one shape, got none{said}"),
            ));
        }
        Ok(Converted { from: format.id(), to: target.id, read, written })
    };
    let converted = match args.output.as_deref().filter(|path| !is_standard(path)) {
        None => {
            let mut output = BufWriter::with_capacity(BUFFER, std::io::stdout());
            let converted = convert(&mut output).map_err(failed)?;
            output.flush().map_err(|error| format!("standard output: {error}"))?;
            converted
        }
        Some(path) => {
            let (complete, file) = Complete::new(path)?;
            let mut output = BufWriter::with_capacity(BUFFER, file);
            let converted = convert(&mut output).map_err(failed);
            let flushed = |converted| {
                output.flush().map(|()| converted).map_err(|error| format!("{}: {error}", path.display()))
            };
            complete.end(converted.and_then(flushed))?
        }
    };
    match args.json {
        true => note(&serde_json::to_string(&converted).map_err(|error| error.to_string())?),
        false => tell(&converted),
    }
    Ok(Outcome::Done)
}

/// The format that is written.
fn target(args: &ConvertArgs) -> Result<&'static Format, String> {
    let file = args.output.as_deref().filter(|path| !is_standard(path));
    let name = file.and_then(Path::file_name).map(|name| name.to_string_lossy());
    let format = match (&args.to, name) {
        (Some(word), _) => files::find(word).ok_or_else(|| unknown_format(word)),
        (None, Some(name)) => files::detect_written(&name),
        (None, None) => files::find("ndjson").ok_or_else(|| unknown_format("ndjson")),
    };
    let format = format.map_err(|error| error.to_string())?;
    match format.is_written() {
        true => Ok(format),
        false => {
            Err(format!("expected a format that can be written, got {}, which is only read", format.name))
        }
    }
}

/// Lists the content that was left out.
fn tell(converted: &Converted) {
    let Converted { from, to, read, written } = converted;
    note(&format!("{} shapes from {from} to {to}", written.records));
    left_out(read).chain(left_out(written)).for_each(|line| note(&line));
}
