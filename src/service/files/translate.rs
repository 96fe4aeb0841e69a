//! Files described and translated, without storing anything.

use bytes::Bytes;
use futures_util::Stream;

use super::format::{FileFormat, file_limits};
use super::writing::write;
use crate::formats::files::{FileError, Format, Inspection, ReadOptions, Record, Summary, WriteOptions};
use crate::formats::record::count_unstored;
use crate::formats::summary::FileSummary;
use crate::service::app::incoming::{BodyReader, read_incoming};
use crate::service::app::outgoing::BodyWriter;
use crate::service::app::{App, Limits, ServiceError};

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
    pub fn format_of(&self, head: &[u8]) -> Result<FileFormat, crate::formats::files::FileError> {
        self.format.map_or_else(|| FileFormat::detect(head, self.name.as_deref()), Ok)
    }
}

/// Tells what is in a file.
///
/// # Errors
/// Faults of the file; a body that breaks off or stalls.
pub async fn inspect(
    app: &App,
    stream: impl Stream<Item = Result<Bytes, ServiceError>>,
    reading: FileReading,
) -> Result<(FileSummary, Inspection), ServiceError> {
    let (limits, held) = (app.limits, file_limits(&app.limits).held);
    read_incoming(app, stream, held, &mut None, move |body| {
        let (mut found, mut unstored) = (Inspection::default(), Summary::default());
        let summary = read(body, &reading, &limits, &mut |record| {
            found.add(&record);
            count_unstored(&record, None, &mut unstored);
            Ok(())
        })?;
        Ok((summary.without(unstored), found))
    })
    .await
}

/// Translates a file.
///
/// # Errors
/// As [`inspect`]; shapes that the other format cannot hold.
pub async fn translate(
    app: &App,
    stream: impl Stream<Item = Result<Bytes, ServiceError>>,
    reading: FileReading,
    to: &'static Format,
    options: WriteOptions,
    output: BodyWriter,
) -> Result<(), ServiceError> {
    let (limits, held, memory) = (app.limits, file_limits(&app.limits).held, app.memory.clone());
    read_incoming(app, stream, held, &mut None, move |body| {
        let fill = |push: &mut dyn FnMut(&Record) -> Result<(), FileError>| {
            read(body, &reading, &limits, &mut |record| push(&record))
        };
        write(&memory, to, output, &options, fill).map(drop)
    })
    .await
}

fn read(
    body: BodyReader,
    reading: &FileReading,
    limits: &Limits,
    sink: crate::formats::files::Sink<'_>,
) -> Result<FileSummary, ServiceError> {
    let stop = body.stop();
    let mut source = body.source(file_limits(limits))?;
    let format = reading.format_of(source.head())?;
    let summary = format.read(&mut source, &reading.options, limits, &|| stop.is_set(), sink)?;
    Ok(FileSummary::new(format.id(), summary))
}
