//! Files described and translated, without storing anything.

use bytes::Bytes;
use futures_util::Stream;

use super::format::{FileFormat, file_limits};
use super::proposal::FirstShapes;
use super::writing::write;
use crate::service::app::incoming::{Stop, read_incoming};
use crate::service::app::outgoing::BodyWriter;
use crate::service::app::{App, Limits, ServiceError};
use crate::service::cohorts::lengths::Lengths;
use crate::service::cohorts::pseudonyms::SubjectFrom;
use crate::service::cohorts::upload_file::{FileToAdd, ReadFile, without_shapes};
use crate::service::shapes::outcome::OnError;
use crate::wire::files::{
    FaultKind, FileError, Filed, Format, Inspection, Place, ReadOptions, Record, Sink, Source, Storing,
    Summary, WriteOptions, find,
};
use crate::wire::record::{Placing, count_unstored};
use crate::wire::summary::FileSummary;
use crate::wire::unit::Unit;

/// How a file is read.
#[derive(Debug, Clone, Default)]
pub struct FileReading {
    /// Its format. Default: by its first bytes, else by its name.
    pub format: Option<FileFormat>,
    /// Its name.
    pub name: Option<String>,
    /// Options of its format.
    pub options: ReadOptions,
}

impl FileReading {
    /// The format of a file that begins with `head`.
    ///
    /// # Errors
    /// An unknown file.
    pub fn format_of(&self, head: &[u8]) -> Result<FileFormat, crate::wire::files::FileError> {
        self.format.map_or_else(|| FileFormat::detect(head, self.name.as_deref()), Ok)
    }
}

/// Formats of files that identify persons, or hold files that do.
const OF_PERSONS: [&str; 3] = ["rtstruct", "segmentation", "zip"];

/// A file that is added to a cohort.
pub fn to_add(
    reading: FileReading,
    placing: Placing,
    (on_error, subject_from): (OnError, Option<SubjectFrom>),
    limits: &Limits,
) -> FileToAdd {
    let (FileReading { mut options, .. }, service) = (reading.clone(), *limits);
    options.storing =
        Some(Storing { skips_broken: on_error == OnError::Skip, persons: subject_from.is_some() });
    let read: ReadFile = Box::new(move |source, stop, sink| {
        let format = reading.format_of(source.head())?;
        if subject_from.is_some() && !OF_PERSONS.contains(&format.id()) {
            let detail =
                format!("expected a file of DICOM, which identifies a patient, got {}", format.name());
            return Err(FileError {
                place: Box::new(Place::tag("subject_from")),
                ..FileError::new(FaultKind::Option, detail)
            });
        }
        let summary = format.read(source, &options, &service, stop, sink)?;
        Ok(FileSummary::new(format.id(), summary))
    });
    FileToAdd { limits: file_limits(limits), placing, subject_from, read }
}

/// Tells the content of a file, with its first shapes of each kind.
///
/// # Errors
/// Faults of the file; a body that breaks off or stalls.
pub async fn inspect(
    app: &App,
    stream: impl Stream<Item = Result<Bytes, ServiceError>>,
    reading: FileReading,
) -> Result<(FileSummary, Inspection, FirstShapes), ServiceError> {
    let limits = app.limits;
    read_incoming(app, stream, file_limits(&limits), &mut None, move |source, stop| {
        let (mut found, mut unstored) = (Inspection::default(), Summary::default());
        let mut first = FirstShapes::default();
        let summary = read(source, &stop, &reading, &limits, &mut |record| {
            found.add(&record);
            first.offer(&record, &limits);
            count_unstored(&record, None, &mut unstored);
            Ok(())
        })?;
        Ok((summary.without(unstored), found, first))
    })
    .await
}

/// Translates a file, and gives its summary by the reader.
///
/// # Errors
/// As [`inspect`]; a file without a shape that is read; shapes that the other format cannot hold.
pub async fn translate(
    app: &App,
    stream: impl Stream<Item = Result<Bytes, ServiceError>>,
    reading: FileReading,
    to: &'static Format,
    options: WriteOptions,
    output: BodyWriter,
) -> Result<FileSummary, ServiceError> {
    translate_through(app, stream, reading, (to, options), output, None).await
}

/// How the shapes of a file become those of a request: under the names and in the unit that they would be stored with.
#[derive(Debug)]
pub struct Asking {
    /// Unit of the coordinates, whatever the file states.
    pub unit: Option<Unit>,
    /// Text before the names. Default: that of an upload.
    pub prefix: Option<String>,
    /// Treatment of broken shapes.
    pub on_error: OnError,
    /// Units of the file and of the dictionary that is asked.
    pub lengths: Lengths,
}

/// Translates a file to lines of shapes as requests take them, which do not know objects of several rings.
///
/// # Errors
/// As [`translate`]; lengths where the dictionary has none, and the other way round.
pub async fn shape_lines(
    app: &App,
    stream: impl Stream<Item = Result<Bytes, ServiceError>>,
    mut reading: FileReading,
    asking: Asking,
    output: BodyWriter,
) -> Result<FileSummary, ServiceError> {
    let to = find("ndjson").ok_or_else(|| ServiceError::Internal("no format of lines".into()))?;
    reading.options.storing =
        Some(Storing { skips_broken: asking.on_error == OnError::Skip, persons: false });
    let filed = Filed::new(reading.name.as_deref(), asking.prefix.as_deref());
    let way = Some((filed, asking));
    translate_through(app, stream, reading, (to, WriteOptions::default()), output, way).await
}

async fn translate_through(
    app: &App,
    stream: impl Stream<Item = Result<Bytes, ServiceError>>,
    reading: FileReading,
    (to, options): (&'static Format, WriteOptions),
    output: BodyWriter,
    mut way: Option<(Filed, Asking)>,
) -> Result<FileSummary, ServiceError> {
    let (limits, memory) = (app.limits, app.memory.clone());
    read_incoming(app, stream, file_limits(&limits), &mut None, move |source, stop| {
        let fill = |push: &mut dyn FnMut(&Record) -> Result<(), FileError>| {
            let mut count = 0_u64;
            let mut summary = read(source, &stop, &reading, &limits, &mut |record| {
                count += 1;
                let Some((filed, asking)) = &mut way else { return push(&record) };
                let record = asking.lengths.convert(Record { ring: None, ..record }, asking.unit)?;
                filed.push(record, &mut |record| push(&record))
            })?;
            if let Some((filed, asking)) = &mut way {
                filed.finish(summary.has_broken(), &mut |record| push(&record))?;
                summary.units = asking.lengths.told();
                summary.warnings.extend(asking.lengths.warning());
            }
            if count > 0 { Ok(summary) } else { Err(without_shapes(&summary)) }
        };
        let (summary, unwritten) = write(&memory, to, output, &options, fill)?;
        Ok(summary.without(unwritten))
    })
    .await
}

fn read(
    mut source: Source<'_>,
    stop: &Stop,
    reading: &FileReading,
    limits: &Limits,
    sink: Sink<'_>,
) -> Result<FileSummary, ServiceError> {
    let format = reading.format_of(source.head())?;
    let summary = format.read(&mut source, &reading.options, limits, &|| stop.is_set(), sink)?;
    Ok(FileSummary::new(format.id(), summary))
}
