//! Files of other programs into a cohort: all or nothing, or only the valid shapes.
//!
//! A separate thread reads records while the body arrives, and passes them on in batches; from there they go the way of the
//! lines of a stream.

use std::sync::Arc;

use bytes::Bytes;
use futures_util::Stream;
use tokio::sync::mpsc;

use super::arriving::Incoming;
use super::catalogue::Expected;
use super::lengths::Lengths;
use super::preview::Preview;
use super::pseudonyms::{Pseudonyms, SubjectFrom};
use super::upload::{Stored, Treatment, Writer};
use crate::domain::cohort::Cohort;
use crate::service::app::faults::Faults;
use crate::service::app::incoming::read_incoming;
use crate::service::app::{App, ServiceError};
use crate::wire::fault::Fault;
use crate::wire::files::{
    FaultKind, FileError, Filed, Inspection, Limits as FileLimits, Record, Sink, Source, Summary,
};
use crate::wire::json;
use crate::wire::record::{Placing, count_unstored};
use crate::wire::summary::FileSummary;

/// Number of records passed on at once.
const BATCH: usize = 2048;
/// Number of bytes passed on at once, about.
const BATCH_BYTES: usize = 2 << 20;

/// Reads the records of a file until `stop` says that the client has gone.
pub type ReadFile = Box<
    dyn FnOnce(&mut Source<'_>, &(dyn Fn() -> bool + Sync), Sink<'_>) -> Result<FileSummary, FileError>
        + Send,
>;

/// A file to come.
pub struct FileToAdd {
    /// Most that is read of it.
    pub limits: FileLimits,
    /// How its records become shapes.
    pub placing: Placing,
    /// Part of it that identifies the person of its shapes, if any does.
    pub subject_from: Option<SubjectFrom>,
    /// Reads it.
    pub read: ReadFile,
}

impl std::fmt::Debug for FileToAdd {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FileToAdd").field("placing", &self.placing).finish_non_exhaustive()
    }
}

/// Adds the shapes of a file.
///
/// # Errors
/// Faults of the file, at their places; faults of its shapes as for [`add`](super::upload::add); a body that breaks off or
/// stalls.
pub async fn add_file(
    app: &App,
    cohort: Cohort,
    stream: impl Stream<Item = Result<Bytes, ServiceError>>,
    file: FileToAdd,
    treatment: Treatment,
    expected: Option<Expected>,
) -> Result<Stored, ServiceError> {
    let mut writer = Writer::new(app, &cohort, treatment, "", expected).await?;
    let taken = take_file(app, &mut writer, &cohort, stream, file).await;
    writer.end(app, taken).await
}

/// Tells the effect of [`add_file`] on a file, and stores nothing. Memory: that of the upload, and two digests of each shape with a
/// name.
///
/// # Errors
/// The refusal of the file as a whole, as for [`add_file`]. Refusals because of single shapes are told beside the others.
pub async fn preview_file(
    app: &App,
    cohort: Cohort,
    stream: impl Stream<Item = Result<Bytes, ServiceError>>,
    file: FileToAdd,
    treatment: Treatment,
) -> Result<Preview, ServiceError> {
    let mut writer = Writer::of_preview(app, &cohort, treatment)?;
    let taken = take_file(app, &mut writer, &cohort, stream, file).await;
    writer.end_preview(app, taken).await
}

async fn take_file(
    app: &App,
    writer: &mut Writer,
    cohort: &Cohort,
    stream: impl Stream<Item = Result<Bytes, ServiceError>>,
    file: FileToAdd,
) -> Result<(), ServiceError> {
    let FileToAdd { limits, placing, subject_from, read } = file;
    let previews = writer.preview.is_some();
    let pseudonyms = pseudonyms(app, subject_from, previews).await?;
    let mut filed = Filed::new(placing.name.as_deref(), placing.prefix.as_deref());
    writer.placing = Arc::new(placing);
    writer.lengths = Lengths::of(cohort);
    writer.faults = Faults::of_file();
    let (mut retry, domain) = (writer.retry.take(), writer.domain());
    let (sender, mut batches) = mpsc::channel(1);
    let reading = read_incoming(app, stream, limits, &mut retry, move |mut source, stop| {
        let mut batch = Batch { sender, records: Vec::new(), bytes: 0 };
        let (mut unstored, mut unknown, mut found) = (Summary::default(), 0, Inspection::default());
        let mut give = |mut record: Record| {
            let person = record.person.take();
            if let Some(pseudonyms) = &pseudonyms {
                record.subject = record.subject.or_else(|| person.map(|person| pseudonyms.subject(&person)));
                unknown += usize::from(record.subject.is_none());
            }
            if previews {
                found.add(&record);
            }
            batch.push(record)
        };
        let mut summary = read(&mut source, &|| stop.is_set(), &mut |record| {
            count_unstored(&record, Some(domain), &mut unstored);
            filed.push(record, &mut give)
        })?;
        filed.finish(summary.has_broken(), &mut give)?;
        batch.pass()?;
        if unknown > 0 {
            summary.warnings.push(format!("{unknown} shapes are of no patient whom the file identifies"));
        }
        Ok((summary.without(unstored), found))
    });
    let taking = async {
        while let Some(batch) = batches.recv().await {
            writer.take(app, batch).await?;
        }
        Ok(())
    };
    let ((summary, found), ()) = tokio::try_join!(reading, taking)?;
    if let Some(notes) = &mut writer.preview {
        notes.found = found;
    }
    writer.retry = retry;
    if writer.position == 0 {
        return Err(without_shapes(&summary));
    }
    tell(writer, summary);
    Ok(())
}

/// The digest that makes subjects of persons, if they are asked for.
async fn pseudonyms(
    app: &App,
    subject_from: Option<SubjectFrom>,
    previews: bool,
) -> Result<Option<Pseudonyms>, ServiceError> {
    Ok(match subject_from {
        Some(SubjectFrom::PatientId) if previews => Some(Pseudonyms::of_preview(app).await?),
        Some(SubjectFrom::PatientId) => Some(Pseudonyms::of(app).await?),
        None => None,
    })
}

/// Adds the summary of the reader to the answer, and the common properties of the shapes.
fn tell(writer: &mut Writer, mut summary: FileSummary) {
    let counted = |(text, count): (&String, &usize)| format!("{count} shapes: {text}");
    summary.warnings.extend(writer.warnings.iter().map(counted));
    summary.warnings.extend(writer.lengths.warning());
    summary.units = writer.lengths.told();
    writer.occasion.note = json::to_value(&summary).ok();
}

/// The refusal of a file that holds no shape: with the words of its reader, where it has any.
pub(in crate::service) fn without_shapes(summary: &FileSummary) -> ServiceError {
    let said = summary.without_shapes();
    if said.is_empty() {
        return ServiceError::TooFewShapes { found: 0, needed: 1 };
    }
    let fault = |said| Fault::new("", format!("expected at least one shape, got none: {said}"));
    ServiceError::Invalid(said.into_iter().map(fault).collect())
}

/// Records on their way from the reader.
struct Batch {
    sender: mpsc::Sender<Vec<Incoming>>,
    records: Vec<Incoming>,
    bytes: usize,
}

impl Batch {
    fn push(&mut self, record: Record) -> Result<(), FileError> {
        self.bytes += record.bytes();
        self.records.push(Incoming::Record(Box::new(record)));
        if self.records.len() >= BATCH || self.bytes >= BATCH_BYTES { self.pass() } else { Ok(()) }
    }

    fn pass(&mut self) -> Result<(), FileError> {
        self.bytes = 0;
        let records = std::mem::take(&mut self.records);
        let stopped = |_| FileError::new(FaultKind::Stopped, "the shapes before were refused");
        if records.is_empty() { Ok(()) } else { self.sender.blocking_send(records).map_err(stopped) }
    }
}
