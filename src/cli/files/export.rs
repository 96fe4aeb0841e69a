//! `shapelex export FILE --cohort NAME`: writes the shapes of a cohort as a file.

use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use futures_util::StreamExt;

use super::content::is_standard;
use super::target::{Target, TargetArgs, refusal};
use super::{Complete, Writing, note};
use crate::cli::at::{At, Outcome};
use crate::domain::attribute::Attribute;
use crate::domain::filter::ShapeFilter;
use crate::service::app::App;
use crate::service::app::outgoing::BodyWriter;
use crate::service::cohorts::catalogue;
use crate::service::files::export::{ExportContent, ShapeFile, USUAL_POINTS, export};
use crate::service::files::unknown_format;
use crate::wire::files::{self, FileError, Format, Limits, ReadOptions, Source, WriteOptions};
use crate::wire::formulas::Escaped;
use crate::wire::summary::left_out;

/// How a cohort is written.
#[derive(Debug, Clone, Args)]
pub(in crate::cli) struct ExportArgs {
    /// Cohort whose shapes are written, by id or name. Without it, the whole store is
    #[arg(long)]
    pub(in crate::cli) cohort: Option<String>,
    #[command(flatten)]
    target: TargetArgs,
    /// Format to write, as an id, a media type or an ending. Default: by the name of the file, else ndjson
    #[arg(long, requires = "cohort", value_name = "FORMAT")]
    to: Option<String>,
    /// Write control points in place of points on curves and meshes of surfaces
    #[arg(long, requires = "cohort")]
    control_points: bool,
    /// Write Fourier coefficients of closed curves, as many as control points tell apart or as `--write harmonics=N` says
    #[arg(long, requires = "cohort", conflicts_with = "control_points")]
    fourier: bool,
    /// Number of points on a curve
    #[arg(long, requires = "cohort", value_name = "N", default_value_t = USUAL_POINTS as u16, value_parser = clap::value_parser!(u16).range(3..=10_000))]
    points: u16,
    /// Only shapes with this label; may be repeated
    #[arg(long = "label", requires = "cohort", value_name = "LABEL")]
    labels: Vec<String>,
    #[command(flatten)]
    writing: Writing,
}

impl ExportArgs {
    /// Written content of each shape.
    fn content(&self, format: &Format) -> ExportContent {
        match (self.control_points, self.fourier) {
            (true, _) => ExportContent::ControlPoints,
            (_, true) => ExportContent::Fourier,
            _ => ExportContent::usual(format),
        }
    }

    /// Refuses options of files of shapes for the export of a whole store.
    ///
    /// # Errors
    /// An option that needs a cohort.
    pub(in crate::cli) fn check_store(&self) -> Result<(), String> {
        self.target.check_without_cohort()?;
        match self.writing.is_usual() {
            true => Ok(()),
            false => Err("expected --cohort beside --write, --series and --formulas, got none".into()),
        }
    }
}

/// Writes the file.
///
/// # Errors
/// Reason for the failure, in one sentence.
pub(in crate::cli) async fn run(file: &Path, args: ExportArgs, at: At) -> Result<Outcome, String> {
    let format = target(file, args.to.as_deref())?;
    let target = args.target.clone().open(at).await?;
    let bytes = if is_standard(file) {
        write(&target, &args, format, &mut std::io::stdout()).await?
    } else {
        let (complete, mut output) = Complete::new(file)?;
        let written = write(&target, &args, format, &mut output).await;
        let synced = written.and_then(|bytes| {
            output.sync_all().map(|()| bytes).map_err(|error| format!("{}: {error}", file.display()))
        });
        complete.end(synced)?
    };
    if let Target::Store(app) = &target {
        app.store.close().await;
    }
    note(&format!("{bytes} bytes of {}", format.name));
    Ok(Outcome::Done)
}

/// The format of the file.
fn target(file: &Path, stated: Option<&str>) -> Result<&'static Format, String> {
    let name = file.file_name().map(PathBuf::from).unwrap_or_default();
    let format = match stated {
        Some(word) => files::find(word).ok_or_else(|| unknown_format(word)),
        None if is_standard(file) => files::find("ndjson").ok_or_else(|| unknown_format("ndjson")),
        None => files::detect_written(&name.to_string_lossy()),
    };
    let format = format.map_err(|error| error.to_string())?;
    match format.is_written() {
        true => Ok(format),
        false => {
            Err(format!("expected a format that can be written, got {}, which is only read", format.name))
        }
    }
}

/// Writes the shapes. Returns the number of bytes.
async fn write(
    target: &Target,
    args: &ExportArgs,
    format: &'static Format,
    output: &mut (dyn Write + Send),
) -> Result<u64, String> {
    let mut output = Escaped::new(output, args.writing.escapes(format)?);
    write_shapes(target, args, format, &mut output).await?;
    output.end().map_err(|error| error.to_string())
}

async fn write_shapes(
    target: &Target,
    args: &ExportArgs,
    format: &'static Format,
    output: &mut (dyn Write + Send),
) -> Result<(), String> {
    let cohort = args.cohort.as_deref().unwrap_or_default();
    let options = args.writing.options()?;
    let content = args.content(format);
    let service = match target {
        Target::Store(app) => {
            let mut filter = ShapeFilter::default();
            for label in &args.labels {
                let added = filter.condition(Attribute::Label).add("eq", label.clone());
                added.map_err(str::to_owned)?;
            }
            if let Some(detail) = filter.excess() {
                return Err(detail);
            }
            let file = ShapeFile { format, options, content, points: usize::from(args.points) };
            return from_store(app, cohort, filter, file, output).await;
        }
        Target::Service(service) => service,
    };
    let pair = |name: &str, value: &str| (name.to_owned(), value.to_owned());
    // Values that identify a patient stay here: the shapes come as lines, and become a structure set on this machine.
    let here = !options.series.is_empty();
    let asked = if here { "ndjson" } else { format.id };
    let mut query = vec![pair("format", asked), pair("points", &args.points.to_string())];
    match content {
        ExportContent::Points => {}
        ExportContent::ControlPoints => query.push(pair("content", "control_points")),
        ExportContent::Fourier => query.push(pair("content", "fourier")),
    }
    query.extend(args.labels.iter().map(|label| pair("label", label)));
    if !here {
        let writing = args.writing.pairs()?;
        query.extend(writing.iter().map(|(name, value)| (format!("write_{name}"), (*value).to_owned())));
    }
    let request = service.request(reqwest::Method::GET, &["v1", "cohorts", cohort, "export"], &query)?;
    let response = request.send().await.map_err(|error| format!("the service does not answer: {error}"))?;
    if !response.status().is_success() {
        return Err(refusal(response).await);
    }
    if here {
        let lines = response.bytes().await.map_err(|error| format!("the file breaks off: {error}"))?;
        return written_here(&lines, format, &options, output).map_err(|error| error.to_string());
    }
    let mut stream = response.bytes_stream();
    while let Some(piece) = stream.next().await {
        let piece = piece.map_err(|error| format!("the file breaks off: {error}"))?;
        output.write_all(&piece).map_err(|error| error.to_string())?;
    }
    Ok(())
}

/// Writes shapes that came as lines.
fn written_here(
    lines: &[u8],
    format: &'static Format,
    options: &WriteOptions,
    output: &mut (dyn Write + Send),
) -> Result<(), FileError> {
    let lines_format = files::find("ndjson")
        .ok_or_else(|| FileError::new(files::FaultKind::Unknown, "expected the format ndjson, got none"))?;
    let mut file = Vec::new();
    let mut writer = format.writer(&mut file, options)?;
    let mut source = Source::new(lines, Limits::default())?;
    files::read(lines_format, &mut source, &ReadOptions::default(), &mut |record| writer.push(&record))?;
    writer.finish()?;
    output.write_all(&file)?;
    Ok(())
}

async fn from_store(
    app: &App,
    cohort: &str,
    filter: ShapeFilter,
    file: ShapeFile,
    output: &mut (dyn Write + Send),
) -> Result<(), String> {
    let cohort = catalogue::find(app, cohort).await.map_err(|error| error.to_string())?;
    let (writer, mut pieces) = BodyWriter::new();
    let writing =
        async { export(app, &cohort, filter, file, writer).await.map_err(|error| error.to_string()) };
    let taking = async {
        while let Some(piece) = pieces.recv().await {
            output.write_all(&piece).map_err(|error| error.to_string())?;
        }
        Ok(())
    };
    let (summary, ()) = tokio::try_join!(writing, taking)?;
    left_out(&summary).for_each(|line| note(&line));
    Ok(())
}
