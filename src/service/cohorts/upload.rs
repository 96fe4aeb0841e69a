//! Upload of shapes into a cohort, from one body or a stream: all or nothing, or only the valid ones.
//!
//! The pool parses shapes and makes rows of them, each in one step, while a task writes the previous ones to the store. All
//! shapes of an upload become visible together.

use crate::formats::fault::Fault;
use crate::service::app::faults::Faults;
use bytes::Bytes;
use futures_util::{Stream, StreamExt};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::time::Duration;
use tokio::sync::mpsc;

use super::catalogue::{Expected, revision_tag};
use crate::analysis::conversion::Conversion;
use crate::domain::cohort::{Cohort, CohortSpec};
use crate::domain::id;
use crate::domain::shape::NewShape;
use crate::formats::bounds::Census;
use crate::formats::ndjson::{Line, LineTooLong, Lines};
use crate::formats::shape::ShapeInput;
use crate::geometry::representation::ShapeSpace;
use crate::geometry::resample::{RepeatedPoints, check_extent};
use crate::service::app::idempotency::Retry;
use crate::service::app::memory::Purpose;
use crate::service::app::{App, ServiceError, Work, idempotency, now_ms};
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::read::{ReadShape, Reading, parse, read_shape};
use crate::store::{Added, ShapeRow, StoreError, Upload};

/// Number of shapes written to the store at once.
const CHUNK_SHAPES: usize = 4096;
/// Bytes of lines parsed at once.
const CHUNK_BYTES: usize = 8 << 20;
/// Maximum pause of a stream.
const PAUSE: Duration = Duration::from_secs(30);
/// Time for which streams may continue when the service is stopping.
const STOPPING: Duration = Duration::from_secs(5);
/// Maximum number of ids in a response; those of longer streams can be listed afterwards.
const MAX_IDS: usize = 100_000;

/// Treatment of invalid shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnError {
    /// Nothing is stored if any shape is invalid.
    #[default]
    Abort,
    /// Valid shapes are stored, invalid ones are reported.
    Skip,
}

/// Result of an upload.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Stored {
    /// Number of new shapes.
    pub added: usize,
    /// Revision of the cohort after the upload.
    pub revision: u64,
    /// Ids in input order, including those of shapes that already existed; at most 100 000.
    pub ids: Vec<String>,
    /// Number of invalid shapes, which were not stored, under [`OnError::Skip`].
    pub skipped: usize,
    /// Faults of the invalid shapes, at most 100 entries.
    pub faults: Vec<Fault>,
    /// Number of points of the valid shapes that were dropped because they are equal to their predecessor.
    #[serde(default)]
    pub repeated_points: usize,
}

/// How the shapes of an upload are treated.
#[derive(Debug, Clone, Copy, Default)]
pub struct Treatment {
    /// Invalid shapes.
    pub on_error: OnError,
    /// Points equal to their predecessor, where contours are resampled.
    pub repeated_points: RepeatedPoints,
}

/// A shape as received.
enum Incoming {
    Line(Line),
    Parsed(Box<ShapeInput>),
}

/// A shape on its way to the store, with its line.
struct Arrived {
    line: Option<u64>,
    row: ShapeRow,
    /// Number of repeated points that were dropped.
    repeated_points: usize,
}

/// Adds the shapes of one body.
///
/// # Errors
/// Under [`OnError::Abort`] the faults of all invalid shapes; conflicts of external ids.
pub async fn add(
    app: &App,
    cohort: Cohort,
    shapes: Vec<ShapeInput>,
    treatment: Treatment,
    expected: Option<Expected>,
) -> Result<Stored, ServiceError> {
    if shapes.is_empty() {
        return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
    }
    if let Some(stored) = app.done_before().await? {
        return Ok(stored);
    }
    let mut writer = Writer::new(app, &cohort, treatment, "/shapes/", expected).await?;
    let incoming = shapes.into_iter().map(|shape| Incoming::Parsed(Box::new(shape))).collect();
    let taken = writer.take(app, incoming).await;
    writer.end(app, taken).await
}

/// Adds the shapes of an NDJSON stream; memory does not depend on its length.
///
/// # Errors
/// As [`add`], with line numbers; a line that is too long; a stream that breaks off or stalls.
pub async fn add_stream(
    app: &App,
    cohort: Cohort,
    stream: impl Stream<Item = Result<Bytes, ServiceError>>,
    treatment: Treatment,
    expected: Option<Expected>,
) -> Result<Stored, ServiceError> {
    let mut writer = Writer::new(app, &cohort, treatment, "", expected).await?;
    let taken = tokio::select! {
        taken = take_stream(app, &mut writer, stream) => taken,
        () = stopped(app) => Err(ServiceError::Unavailable(
            "the service is stopping: nothing of the stream is stored, send it again".into(),
        )),
    };
    writer.end(app, taken).await
}

/// Completes when the service is stopping and the grace period of streams is over.
async fn stopped(app: &App) {
    app.stopping().await;
    tokio::time::sleep(STOPPING).await;
}

async fn take_stream(
    app: &App,
    writer: &mut Writer,
    stream: impl Stream<Item = Result<Bytes, ServiceError>>,
) -> Result<(), ServiceError> {
    let mut lines = Lines::new(app.limits.line_bytes);
    let mut pending: Vec<Line> = Vec::new();
    let mut pending_bytes = 0;
    let mut census = Census::default();
    let mut room = app.memory.hold(Purpose::Bodies, 0)?;
    let mut stream = std::pin::pin!(stream);
    loop {
        let chunk = tokio::time::timeout(PAUSE, stream.next())
            .await
            .map_err(|_| ServiceError::Interrupted(format!("no data for {} s", PAUSE.as_secs())))?;
        let Some(chunk) = chunk.transpose()? else { break };
        census = census.and(Census::of(&chunk));
        room.resize(census.memory(CHUNK_SHAPES))?;
        let keep = |line: Line| {
            pending_bytes += line.text.len();
            pending.push(line);
        };
        lines.push(chunk, keep).map_err(too_long)?;
        if pending.len() >= CHUNK_SHAPES || pending_bytes >= CHUNK_BYTES {
            pending_bytes = 0;
            writer.take_lines(app, std::mem::take(&mut pending)).await?;
            // A partial line remains.
            census = Census { bytes: lines.pending(), ..Census::default() };
            room.resize(census.memory(CHUNK_SHAPES))?;
        }
    }
    lines.finish(|line| pending.push(line)).map_err(too_long)?;
    writer.take_lines(app, pending).await?;
    if writer.position == 0 {
        return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
    }
    Ok(())
}

fn too_long(error: LineTooLong) -> ServiceError {
    ServiceError::TooLarge(Fault { line: Some(error.number), ..Fault::new("", error.to_string()) })
}

/// Parses shapes on the pool while a task writes the previous ones to the store.
struct Writer {
    space: ShapeSpace,
    cohort: Cohort,
    treatment: Treatment,
    prefix: &'static str,
    position: usize,
    expected: Option<Expected>,
    /// The request as far as it has been read, if it has an idempotency key.
    retry: Option<Retry>,
    chunks: mpsc::Sender<Vec<Arrived>>,
    task: tokio::task::JoinHandle<Result<(Upload, Stored), ServiceError>>,
    skipped: usize,
    repeated_points: usize,
    faults: Faults,
}

impl Writer {
    async fn new(
        app: &App,
        cohort: &Cohort,
        treatment: Treatment,
        prefix: &'static str,
        expected: Option<Expected>,
    ) -> Result<Self, ServiceError> {
        if let Some(expected) = &expected {
            expected.check(&revision_tag(cohort))?;
        }
        let space = app.space_of(&cohort.spec.representation)?;
        let upload = app.store.begin_upload(cohort);
        let (chunks, received) = mpsc::channel(1);
        let task = tokio::spawn(write(upload, received, prefix));
        let cohort = cohort.clone();
        Ok(Self {
            space,
            cohort,
            treatment,
            prefix,
            position: 0,
            expected,
            retry: app.retry.clone(),
            chunks,
            task,
            skipped: 0,
            repeated_points: 0,
            faults: Faults::default(),
        })
    }

    async fn take_lines(&mut self, app: &App, lines: Vec<Line>) -> Result<(), ServiceError> {
        if let Some(retry) = &mut self.retry {
            for line in &lines {
                retry.update(&line.text);
                retry.update(b"\n");
            }
        }
        self.take(app, lines.into_iter().map(Incoming::Line).collect()).await
    }

    /// Takes shapes in groups, because parsed shapes need more memory than their text.
    async fn take(&mut self, app: &App, mut incoming: Vec<Incoming>) -> Result<(), ServiceError> {
        while !incoming.is_empty() {
            let rest = incoming.split_off(incoming.len().min(CHUNK_SHAPES));
            self.take_some(app, std::mem::replace(&mut incoming, rest)).await?;
        }
        if self.refuses() {
            return Err(ServiceError::Invalid(std::mem::take(&mut self.faults)));
        }
        Ok(())
    }

    /// Whether nothing will be stored.
    fn refuses(&self) -> bool {
        self.treatment.on_error == OnError::Abort && self.skipped > 0
    }

    async fn take_some(&mut self, app: &App, incoming: Vec<Incoming>) -> Result<(), ServiceError> {
        let first = self.position;
        self.position += incoming.len();
        let (space, cohort, limits, prefix) =
            (self.space.clone(), self.cohort.clone(), app.limits, self.prefix);
        let repeated_points = self.treatment.repeated_points;
        let bytes = incoming.iter().map(Incoming::bytes).sum();
        let counts = Counts::for_space(&space, incoming.len(), &limits);
        let work = Work::reading(bytes) + requests::store(counts, cohort.spec.correspondence);
        let results: Vec<Result<Arrived, Vec<Fault>>> = app
            .pool
            .weighing(work)
            .run(move || {
                let CohortSpec { correspondence, direction, .. } = cohort.spec;
                let conversion = Conversion { space: &space, correspondence, direction, repeated_points };
                let reading = Reading { conversion, limits: &limits };
                let read = |(offset, shape)| read(&reading, shape, first + offset, prefix);
                Ok(incoming.into_par_iter().enumerate().map(read).collect())
            })
            .await?;
        let mut good = Vec::with_capacity(results.len());
        for result in results {
            match result {
                Ok(shape) => {
                    self.repeated_points += shape.repeated_points;
                    good.push(shape);
                }
                Err(faults) => {
                    self.skipped += 1;
                    self.faults.extend(faults);
                }
            }
        }
        if self.refuses() {
            return Ok(());
        }
        while !good.is_empty() {
            let rest = good.split_off(good.len().min(CHUNK_SHAPES));
            if self.chunks.send(good).await.is_err() {
                // The task ended with an error, which `end` reports.
                return Ok(());
            }
            good = rest;
        }
        Ok(())
    }

    /// Makes the shapes visible if all were accepted. Otherwise nothing of them remains when this function returns, so
    /// that a client that corrects its input and resends the same external ids at once does not conflict with its own
    /// first attempt.
    async fn end(self, app: &App, taken: Result<(), ServiceError>) -> Result<Stored, ServiceError> {
        let Self { chunks, task, skipped, faults, repeated_points, retry, cohort, expected, .. } = self;
        drop(chunks);
        let written =
            task.await.map_err(|error| ServiceError::Internal(format!("the writing task: {error}")))?;
        // Errors of the task come first: after it has ended, the writer silently drops further shapes.
        let (upload, stored) = written?;
        if let Err(error) = taken {
            upload.abort().await?;
            return Err(error);
        }
        if let Some(retry) = &retry
            && let Some(stored) = idempotency::done_before(app, retry).await?
        {
            // The same stream was stored before: discard this one.
            upload.abort().await?;
            return Ok(stored);
        }
        let mut stored = Stored { skipped, faults: faults.into_listed(), repeated_points, ..stored };
        let receipt = |revision| {
            stored.revision = revision;
            retry.as_ref().map(|retry| idempotency::receipt(retry, &stored))
        };
        let expected = expected.map(|_| cohort.revision);
        stored.revision = upload.commit_once(now_ms(), expected, receipt).await?;
        Ok(stored)
    }
}

async fn write(
    mut upload: Upload,
    mut chunks: mpsc::Receiver<Vec<Arrived>>,
    prefix: &'static str,
) -> Result<(Upload, Stored), ServiceError> {
    let mut stored = Stored::default();
    let mut first = 0;
    while let Some(chunk) = chunks.recv().await {
        let (lines, rows): (Vec<Option<u64>>, Vec<ShapeRow>) =
            chunk.into_iter().map(|arrived| (arrived.line, arrived.row)).unzip();
        let added = match upload.add(rows).await {
            Ok(added) => added,
            Err(error) => {
                upload.abort().await?;
                return Err(located(error, first, &lines, prefix));
            }
        };
        first += lines.len();
        for added in added {
            let id = match added {
                Added::New { id } => {
                    stored.added += 1;
                    id
                }
                Added::Existing { id } => id,
            };
            if stored.ids.len() < MAX_IDS {
                stored.ids.push(id);
            }
        }
    }
    Ok((upload, stored))
}

/// Locates a conflict in the input; `lines` are those of the chunk that begins at shape `first`.
fn located(error: StoreError, first: usize, lines: &[Option<u64>], prefix: &str) -> ServiceError {
    let StoreError::ExternalIdConflict { position, external_id } = error else { return error.into() };
    let index = usize::try_from(position).unwrap_or(usize::MAX);
    let line = index.checked_sub(first).and_then(|offset| lines.get(offset).copied().flatten());
    let pointer =
        if prefix.is_empty() { "/external_id".into() } else { format!("{prefix}{index}/external_id") };
    let detail =
        format!("the external id '{external_id}' belongs to another shape of the cohort, with other content");
    ServiceError::ExternalIdConflict(Fault { index: Some(index), line, ..Fault::new(pointer, detail) })
}

impl Incoming {
    /// Bytes to be parsed.
    fn bytes(&self) -> usize {
        match self {
            Self::Line(line) => line.text.len(),
            Self::Parsed(_) => 0,
        }
    }
}

/// Parses the shape at `index` of the upload and makes a row of it. Its text and what is parsed of it end here.
fn read(
    reading: &Reading<'_>,
    incoming: Incoming,
    index: usize,
    prefix: &str,
) -> Result<Arrived, Vec<Fault>> {
    let (line, shape) = match incoming {
        Incoming::Line(Line { number, text }) => (Some(number), parse(reading.limits, text.trim_ascii_end())),
        Incoming::Parsed(shape) => (None, Ok(*shape)),
    };
    // Each line is a document of its own; in a body, pointers include the position of the shape.
    let prefix = if prefix.is_empty() { String::new() } else { format!("{prefix}{index}") };
    let placed = |fault: Fault| Fault {
        pointer: format!("{prefix}{}", fault.pointer),
        index: Some(index),
        line,
        ..fault
    };
    let shape = shape.map_err(|error| match error {
        ServiceError::Malformed(faults) => faults.into_iter().map(placed).collect::<Vec<_>>(),
        other => vec![placed(Fault::new("", other.to_string()))],
    })?;
    let shape = read_shape(reading, shape).and_then(|shape| {
        // Once stored, a shape without extent would break every mean of the cohort.
        check_extent(&shape.control_points, reading.conversion.space.representation().size())
            .map_err(|error| vec![Fault::new("", error.to_string())])?;
        Ok(shape)
    });
    match shape {
        Ok(ReadShape { control_points, attributes, repeated_points }) => {
            let shape = NewShape { id: id::new_id(id::SHAPE), attributes, control_points };
            Ok(Arrived { line, row: shape.into(), repeated_points })
        }
        Err(errors) => Err(errors.into_iter().map(placed).collect()),
    }
}
