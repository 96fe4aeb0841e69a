//! Upload of shapes into a cohort, from one body or a stream: all or nothing, or only the valid ones.
//!
//! The pool parses shapes and makes rows of them, each in one step, while a task writes the previous ones to the store. All
//! shapes of an upload become visible together.

use crate::service::app::faults::Faults;
use crate::service::app::parallel;
use crate::wire::fault::Fault;
use bytes::Bytes;
use futures_util::{Stream, StreamExt};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;

use super::arriving::{Arrived, BroughtNames, Incoming, Origin, Taken, read};
use super::attribute_names;
use super::catalogue::{Expected, revision_tag};
use super::fits::{MeshFits, MeshResidual};
use super::lengths::Lengths;
use super::measures::Measuring;
use super::placer::Placer;
use super::preview::{Notes, Preview};
use crate::analysis::conversion::Conversion;
use crate::domain::cohort::{Cohort, CohortSpec};
use crate::domain::filter::ShapeFilter;
use crate::domain::job::Job;
use crate::geometry::capability::domain::Domain;
use crate::geometry::representation::ShapeSpace;
use crate::geometry::resample::RepeatedPoints;
use crate::service::app::idempotency::Retry;
use crate::service::app::incoming::stopped;
use crate::service::app::memory::{Held, Purpose};
use crate::service::app::{App, Limits, ServiceError, Work, idempotency, now_ms};
use crate::service::cost::requests::{self, Counts, FitCounts};
use crate::service::shapes::directions::{Rule, Ways};
use crate::service::shapes::outcome::OnError;
use crate::service::shapes::read::Reading;
use crate::store::{Added, Listing, Revisions, ShapeRow, StoreError, Upload};
use crate::wire::bounds::Census;
use crate::wire::json;
use crate::wire::ndjson::{Line, LineTooLong, Lines};
use crate::wire::record::Placing;
use crate::wire::shape::ShapeInput;

/// Number of shapes written to the store at once.
const CHUNK_SHAPES: usize = 4096;
/// Predicted time for measuring the shapes of a group.
const GROUP_SECONDS: f64 = 1.0;
/// Bytes of lines parsed at once.
const CHUNK_BYTES: usize = 8 << 20;
/// Maximum pause of a stream.
const PAUSE: Duration = Duration::from_secs(30);
/// Number of inputs that a response names one by one; shapes of longer streams can be listed afterwards.
const MAX_NAMED: usize = 100_000;
/// Maximum number of invalid shapes of an upload: a response names all of them.
const MAX_REFUSED: usize = 100_000;
/// Maximum number of different warnings in a response.
const MAX_WARNINGS: usize = 20;
/// Maximum number of faults of an invalid shape in a response.
const MAX_FAULTS: usize = 5;

/// Account of the inputs in the response to an upload. Invalid ones are always named.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Returned {
    /// One entry for each.
    #[default]
    Results,
    /// Their ids.
    Ids,
    /// Nothing of the valid ones.
    None,
}

impl Returned {
    /// Answer about `count` inputs: results, and ids on their own.
    fn of(
        self,
        results: Vec<UploadResult>,
        ids: Vec<String>,
        count: usize,
    ) -> (Vec<UploadResult>, Vec<Option<String>>) {
        match self {
            Self::Results => (with_ids(results, ids), Vec::new()),
            Self::Ids => {
                let ids = aligned(ids, &results, count);
                (results, ids)
            }
            Self::None => (results, Vec::new()),
        }
    }
}

/// Outcome of an input.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct UploadResult {
    /// Position in the body or stream, from 0.
    pub index: usize,
    /// Identifier assigned by the client.
    pub external_id: Option<String>,
    /// Id of the stored shape, new or not; `None` for an invalid input.
    pub id: Option<String>,
    /// Faults of an invalid input, at most `MAX_FAULTS`.
    pub faults: Vec<Fault>,
    /// Residual of the fit to a mesh.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fit: Option<MeshResidual>,
}

/// Result of an upload.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Stored {
    /// Number of new shapes.
    pub added: usize,
    /// Revision of the cohort after the upload.
    pub revision: u64,
    /// Under [`Returned::Ids`] the ids of the first `MAX_NAMED` inputs; `None` for an invalid one.
    #[serde(default)]
    pub ids: Vec<Option<String>>,
    /// Number of shapes that the cohort has already, with the same external ids and control points.
    #[serde(default)]
    pub unchanged: usize,
    /// Number of shapes that were not stored under [`OnError::Skip`]: invalid ones, and those whose external id belongs to another.
    pub skipped: usize,
    /// Outcomes of the inputs: of the first `MAX_NAMED` under [`Returned::Results`], and of all invalid ones.
    #[serde(default)]
    pub results: Vec<UploadResult>,
    /// Number of valid inputs beyond the first `MAX_NAMED`.
    #[serde(default)]
    pub left_out: usize,
    /// Number of points of the valid shapes that were dropped because they are equal to their predecessor.
    #[serde(default)]
    pub repeated_points: usize,
    /// Number of the valid shapes that intersect themselves.
    #[serde(default)]
    pub self_intersecting: usize,
    /// Warnings about the shapes as a whole.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<String>,
    /// A further answer, kept with the receipt of an idempotent request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<serde_json::Value>,
}

/// How the shapes of an upload are treated.
#[derive(Debug, Clone, Copy, Default)]
pub struct Treatment {
    /// Invalid shapes.
    pub on_error: OnError,
    /// Shapes whose external id belongs to a shape with other points.
    pub conflicts: OnError,
    /// Content of the response about the inputs.
    pub returned: Returned,
    /// Points equal to their predecessor, where contours are resampled.
    pub repeated_points: RepeatedPoints,
}

/// Occasion on which shapes are added.
#[derive(Debug, Clone, Default)]
pub struct Occasion {
    /// A further answer, which a repeated request gets too.
    pub note: Option<serde_json::Value>,
    /// The job that adds them, as it was claimed: nothing is stored unless it is still held.
    pub job: Option<Job>,
    /// Units of shapes that were converted.
    pub lengths: Lengths,
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
    add_as(app, cohort, shapes, treatment, expected, Occasion::default()).await
}

/// As [`add`], on an occasion.
///
/// # Errors
/// As [`add`]; [`ServiceError::Cancelled`] if the job is no longer held.
pub async fn add_as(
    app: &App,
    cohort: Cohort,
    shapes: Vec<ShapeInput>,
    treatment: Treatment,
    expected: Option<Expected>,
    occasion: Occasion,
) -> Result<Stored, ServiceError> {
    if shapes.is_empty() {
        return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
    }
    if let Some(stored) = app.done_before().await? {
        return Ok(stored);
    }
    let mut writer = Writer::new(app, &cohort, treatment, "/shapes/", expected).await?;
    writer.lengths = occasion.lengths.clone();
    writer.occasion = occasion;
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
    ServiceError::TooLarge(Fault { line: Some(error.number), ..Fault::new("", error.to_string()) }.into())
}

/// Written part of an upload.
struct Written {
    upload: Upload,
    /// Number of new shapes.
    new: usize,
    /// Number of shapes that the cohort has already, and of those among them with other attributes.
    unchanged: usize,
    differing: usize,
    /// Ids of the first shapes.
    ids: Vec<String>,
    /// Shapes that were left out because their external id belongs to another one.
    conflicts: Vec<UploadResult>,
}

/// Parses shapes on the pool while a task writes the previous ones to the store.
pub(super) struct Writer {
    space: ShapeSpace,
    measuring: Arc<Measuring>,
    /// Number of shapes that are read and measured at once.
    group: usize,
    cohort: Cohort,
    treatment: Treatment,
    prefix: &'static str,
    pub(super) position: usize,
    expected: Option<Expected>,
    /// The request as far as it has been read, if it has an idempotency key.
    pub(super) retry: Option<Retry>,
    chunks: mpsc::Sender<Vec<Arrived>>,
    task: tokio::task::JoinHandle<Result<Written, ServiceError>>,
    skipped: usize,
    left_out: usize,
    repeated_points: usize,
    self_intersecting: usize,
    /// Directions of the curves.
    ways: Ways,
    /// Residuals of the fits to meshes.
    fits: MeshFits,
    results: Vec<UploadResult>,
    pub(super) occasion: Occasion,
    pub(super) faults: Faults,
    /// How records of files become shapes.
    pub(super) placing: Arc<Placing>,
    /// Units of the shapes.
    pub(super) lengths: Lengths,
    /// Names of the further attributes of the shapes.
    names: BTreeSet<String>,
    /// Warnings of the shapes: their text with the number of shapes that have it.
    pub(super) warnings: BTreeMap<String, usize>,
    /// Notes where nothing is stored.
    pub(super) preview: Option<Notes>,
}

impl Writer {
    pub(super) async fn new(
        app: &App,
        cohort: &Cohort,
        treatment: Treatment,
        prefix: &'static str,
        expected: Option<Expected>,
    ) -> Result<Self, ServiceError> {
        if let Some(expected) = &expected {
            expected.check(&revision_tag(cohort))?;
        }
        let mut upload = app.store.begin_upload(cohort);
        if treatment.conflicts == OnError::Skip {
            upload.skip_conflicts();
        }
        let writer = Self::onto(app, cohort, treatment, prefix, upload)?;
        Ok(Self { expected, retry: app.retry.clone(), ..writer })
    }

    /// A writer that stores nothing, and notes the findings of one that does.
    pub(super) fn of_preview(app: &App, cohort: &Cohort, treatment: Treatment) -> Result<Self, ServiceError> {
        let treatment = Treatment { returned: Returned::None, ..treatment };
        let writer = Self::onto(app, cohort, treatment, "", app.store.preview_upload(cohort))?;
        Ok(Self { preview: Some(Notes::new(treatment.on_error)), ..writer })
    }

    /// A writer to an upload of the store.
    fn onto(
        app: &App,
        cohort: &Cohort,
        treatment: Treatment,
        prefix: &'static str,
        upload: Upload,
    ) -> Result<Self, ServiceError> {
        let space = app.space_of(&cohort.spec.representation)?;
        let (chunks, received) = mpsc::channel(1);
        let ids = if treatment.returned == Returned::None { 0 } else { MAX_NAMED };
        let room = app.memory.hold(Purpose::Bodies, 0)?;
        let task = tokio::spawn(write(upload, room, received, prefix, ids));
        let cohort = cohort.clone();
        Ok(Self {
            measuring: Arc::new(Measuring::new(space.clone())),
            group: group_of(&space, &app.limits),
            space,
            cohort,
            treatment,
            prefix,
            position: 0,
            expected: None,
            retry: None,
            chunks,
            task,
            skipped: 0,
            left_out: 0,
            repeated_points: 0,
            self_intersecting: 0,
            ways: Ways::default(),
            fits: MeshFits::default(),
            results: Vec::new(),
            occasion: Occasion::default(),
            faults: Faults::default(),
            placing: Arc::default(),
            lengths: Lengths::default(),
            names: BTreeSet::new(),
            warnings: BTreeMap::new(),
            preview: None,
        })
    }

    /// Domain of the shapes of the cohort.
    pub(super) fn domain(&self) -> Domain {
        self.space.domain()
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
    pub(super) async fn take(&mut self, app: &App, mut incoming: Vec<Incoming>) -> Result<(), ServiceError> {
        while !incoming.is_empty() {
            let group = self.group.min(self.group_of_fits(&incoming, &app.limits));
            let rest = incoming.split_off(incoming.len().min(group));
            self.take_some(app, std::mem::replace(&mut incoming, rest)).await?;
        }
        if let Some(notes) = &mut self.preview {
            notes.pass();
        }
        if self.refuses() {
            return Err(ServiceError::Invalid(std::mem::take(&mut self.faults)));
        }
        if self.skipped > MAX_REFUSED {
            return Err(too_many_refused());
        }
        Ok(())
    }

    /// Notes a warning of a shape.
    fn warn(&mut self, warning: &str) {
        if let Some(count) = self.warnings.get_mut(warning) {
            *count += 1;
        } else if self.warnings.len() < MAX_WARNINGS {
            self.warnings.insert(warning.into(), 1);
        }
    }

    /// Predicted work of shapes once they are parsed.
    fn work(&self, incoming: &[Incoming], limits: &Limits) -> Work {
        let counts = Counts::for_space(&self.space, incoming.len(), limits);
        requests::store(counts, self.cohort.spec.correspondence)
            + requests::measure_stored(self.space.representation(), counts, limits)
            + self.fits(incoming, limits)
    }

    /// Predicted work of fits to the meshes among these shapes.
    fn fits(&self, incoming: &[Incoming], limits: &Limits) -> Work {
        let sizes = incoming.iter().filter_map(Incoming::mesh_vertices);
        let (meshes, points) = sizes.fold((0, 0.0), |(count, sum), size| (count + 1, sum + size as f64));
        if meshes == 0 || !self.space.domain().is_sheet() {
            return Work::from_seconds(0.0);
        }
        let counts = Counts::for_space(&self.space, meshes, limits);
        let fit = FitCounts { points, meshes: true, tolerance: false, turns: 0 };
        requests::fit(self.space.representation(), counts, fit, limits)
    }

    /// Number of the first shapes whose fits take [`GROUP_SECONDS`], at least one.
    fn group_of_fits(&self, incoming: &[Incoming], limits: &Limits) -> usize {
        let mut seconds = 0.0;
        let mut take = |shape: &Incoming| {
            seconds += self.fits(std::slice::from_ref(shape), limits).seconds();
            seconds <= GROUP_SECONDS
        };
        incoming.iter().take_while(|shape| take(shape)).count().max(1)
    }

    /// Notes the outcome of an input; the id of a valid one follows.
    fn record(
        &mut self,
        index: usize,
        external_id: Option<String>,
        mut faults: Vec<Fault>,
        fit: Option<MeshResidual>,
    ) {
        let (valid, named) = (faults.is_empty(), index < MAX_NAMED);
        if valid && !named {
            self.left_out += 1;
        } else if !valid || self.treatment.returned == Returned::Results {
            faults.truncate(MAX_FAULTS);
            self.results.push(UploadResult { index, external_id, id: None, faults, fit });
        }
    }

    /// Notes the properties of a valid shape.
    fn note(&mut self, shape: &Arrived) {
        self.repeated_points += shape.repeated_points;
        self.self_intersecting += usize::from(shape.measures.self_intersecting == Some(true));
        self.ways.note(shape.measures.clockwise);
        self.fits.note(&shape.measures);
        for warning in &shape.warnings {
            self.warn(warning);
        }
    }

    /// Warnings about the shapes as a whole, and beside those that the cohort has.
    async fn said(&self, app: &App) -> Result<Vec<String>, ServiceError> {
        let rule = Rule::of(&self.cohort.spec, self.cohort.spec.mirror);
        let mixed = match rule.warning(self.ways) {
            Some(warning) => Some(warning),
            None if rule.counts() && self.ways != Ways::default() => {
                let (revisions, filter) = (Revisions::until(self.cohort.revision), &ShapeFilter::default());
                let wanted =
                    Listing { revisions, filter, order: None, after: None, limit: 1, geometry: false };
                let first = app.store.list_shapes(&self.cohort.id, &wanted).await?.shapes;
                let first = first.first().and_then(|shape| shape.measures.clockwise);
                first.and_then(|clockwise| rule.warning_beside(self.ways, clockwise))
            }
            None => None,
        };
        Ok(mixed.into_iter().chain(self.fits.warning()).collect())
    }

    /// Pointer to the list of the shapes.
    fn list(&self) -> &'static str {
        self.prefix.trim_end_matches('/')
    }

    /// Whether the upload ends, and nothing of it is stored.
    fn refuses(&self) -> bool {
        self.preview.is_none() && self.treatment.on_error == OnError::Abort && self.skipped > 0
    }

    /// Reads shapes on the pool, and notes the names of their attributes.
    async fn read_some(&mut self, app: &App, incoming: Vec<Incoming>) -> Result<Vec<Taken>, ServiceError> {
        let first = self.position;
        self.position += incoming.len();
        let (space, cohort, limits, prefix) =
            (self.space.clone(), self.cohort.clone(), app.limits, self.prefix);
        let measuring = Arc::clone(&self.measuring);
        let repeated_points = self.treatment.repeated_points;
        let bytes = incoming.iter().map(Incoming::bytes).sum();
        let work = Work::reading(bytes) + self.work(&incoming, &limits);
        let placing = Arc::clone(&self.placing);
        let read = move || {
            let CohortSpec { correspondence, direction, .. } = cohort.spec;
            let conversion = Conversion { space: &space, correspondence, direction, repeated_points };
            let reading = Reading { conversion, limits: &limits };
            let placer = Placer::new(reading, &placing);
            let names = BroughtNames::default();
            let read = |offset, shape| read(&placer, &measuring, &names, shape, first + offset, prefix);
            let results = parallel::map(incoming, read);
            Ok((results, names.into_set()))
        };
        let (results, names) = app.pool.weighing(work).run(read).await?;
        self.names.extend(names);
        attribute_names::check(self.names.len(), self.list())?;
        Ok(results)
    }

    /// Notes the units of records, and in which they are stored.
    fn meet_units(&mut self, incoming: &[Incoming]) -> Result<(), ServiceError> {
        let mut units: Vec<_> = incoming.iter().filter_map(|incoming| incoming.unit(&self.placing)).collect();
        units.dedup();
        for unit in units {
            let stored = Some(self.lengths.meet(unit)?);
            if self.placing.stored_unit != stored {
                Arc::make_mut(&mut self.placing).stored_unit = stored;
            }
        }
        Ok(())
    }

    async fn take_some(&mut self, app: &App, incoming: Vec<Incoming>) -> Result<(), ServiceError> {
        let first = self.position;
        self.meet_units(&incoming)?;
        let results = self.read_some(app, incoming).await?;
        let mut good = Vec::with_capacity(results.len());
        for (index, (external_id, result)) in (first..).zip(results) {
            match result {
                Ok(shape) => {
                    self.record(index, external_id, Vec::new(), shape.measures.fit.map(MeshResidual::from));
                    self.note(&shape);
                    good.push(shape);
                }
                Err(faults) => {
                    self.skipped += 1;
                    if let Some(notes) = &mut self.preview {
                        notes.refuse(first, &faults);
                    }
                    if self.refuses() {
                        self.faults.extend(faults);
                    } else {
                        self.record(index, external_id, faults, None);
                    }
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
    pub(super) async fn end(
        mut self,
        app: &App,
        taken: Result<(), ServiceError>,
    ) -> Result<Stored, ServiceError> {
        let (retry, job) = (self.retry.take(), self.occasion.job.take());
        let expected = self.expected.as_ref().map(|_| self.cohort.revision);
        let Settled { upload, mut stored, brought, .. } = self.settle(app, taken).await?;
        if let Some(retry) = &retry
            && let Some(stored) = idempotency::done_before(app, retry).await?
        {
            // The same stream was stored before: discard this one.
            upload.abort().await?;
            return Ok(stored);
        }
        let upload = brought.describe(app, upload).await?;
        let receipt = |revision| {
            stored.revision = revision;
            retry.as_ref().map(|retry| idempotency::receipt(retry, &stored))
        };
        stored.revision = upload.commit_once(now_ms(), expected, job.as_ref(), receipt).await?;
        Ok(stored)
    }

    /// Tells the effect of the upload. Refusals of its shapes come before refusals of the rest of it.
    ///
    /// # Errors
    /// The refusal of the upload as a whole.
    pub(super) async fn end_preview(
        self,
        app: &App,
        taken: Result<(), ServiceError>,
    ) -> Result<Preview, ServiceError> {
        let (fits, revision) = (self.fits.any(), self.cohort.revision);
        let Settled { upload, mut stored, brought, conflicts, refusal, notes } =
            self.settle(app, taken).await?;
        let checked = match brought.describe(app, upload).await {
            Ok(upload) => upload.preview().await.map_err(ServiceError::from),
            Err(error) => Err(error),
        };
        if let Err(error) = checked {
            return Err(refusal.unwrap_or(error));
        }
        stored.revision = revision;
        let file = stored.note.take().and_then(|note| json::from_value(&note).ok()).unwrap_or_default();
        let Notes { faults, found, .. } = notes.unwrap_or_else(|| Notes::new(OnError::Abort));
        Ok(Preview { stored, file, found, conflicts, faults, fits, refusal })
    }

    /// Waits for the task that writes, and tells the outcome of the shapes. After an error nothing of them remains.
    async fn settle(self, app: &App, taken: Result<(), ServiceError>) -> Result<Settled, ServiceError> {
        let list = self.list();
        let warnings = if taken.is_ok() { self.said(app).await } else { Ok(Vec::new()) };
        let Self { chunks, task, position, treatment, skipped, left_out, results, occasion, .. } = self;
        let Self { repeated_points, self_intersecting, cohort, names, lengths, preview: notes, .. } = self;
        drop(chunks);
        let written =
            task.await.map_err(|error| ServiceError::Internal(format!("the writing task: {error}")))?;
        // Errors of the task come first: after it has ended, the writer silently drops further shapes.
        let Written { upload, new: added, unchanged, differing, ids, conflicts } = written?;
        let refusal = notes.as_ref().and_then(|notes| notes.refusal(&conflicts));
        let mut warnings = match taken.and(warnings) {
            Ok(warnings) => warnings,
            Err(error) => {
                upload.abort().await?;
                return Err(refusal.unwrap_or(error));
            }
        };
        warnings.extend(stay(differing));
        let conflicting = conflicts.len();
        let skipped = skipped + conflicting;
        let (results, left_out) = with_conflicts(results, conflicts, left_out);
        let (results, ids) = treatment.returned.of(results, ids, position);
        let stored = Stored {
            added,
            revision: 0,
            ids,
            unchanged,
            skipped,
            results,
            left_out,
            repeated_points,
            self_intersecting,
            warnings,
            note: occasion.note,
        };
        let brought = Brought { cohort, names, list, lengths };
        Ok(Settled { upload, stored, brought, conflicts: conflicting, refusal, notes })
    }
}

/// Outcome of the shapes of an upload that is not visible yet.
struct Settled {
    upload: Upload,
    /// The answer, but for the revision.
    stored: Stored,
    brought: Brought,
    /// Number of shapes whose external id belongs to another one.
    conflicts: usize,
    /// Refusal of an upload that is only looked at, and notes on it.
    refusal: Option<ServiceError>,
    notes: Option<Notes>,
}

/// Additions of shapes to their cohort beside themselves.
struct Brought {
    cohort: Cohort,
    /// Names of further attributes.
    names: BTreeSet<String>,
    /// Pointer to the list of the shapes.
    list: &'static str,
    lengths: Lengths,
}

impl Brought {
    /// Tells an upload the names of attributes that are new in the cohort, and the unit that the cohort takes. A refused upload ends.
    async fn describe(self, app: &App, mut upload: Upload) -> Result<Upload, ServiceError> {
        let Self { cohort, names, list, lengths } = self;
        match attribute_names::admit(app, &cohort, names, list).await {
            Ok(names) => upload.name_attributes(names),
            Err(error) => {
                upload.abort().await?;
                return Err(error);
            }
        }
        upload.keep_unit(lengths.at_commit());
        Ok(upload)
    }
}

fn too_many_refused() -> ServiceError {
    let detail =
        format!("expected at most {MAX_REFUSED} shapes that cannot be stored, got more: nothing is stored");
    ServiceError::invalid("", detail)
}

/// Number of shapes that take [`GROUP_SECONDS`] to measure, at most [`CHUNK_SHAPES`]: surfaces take milliseconds each.
fn group_of(space: &ShapeSpace, limits: &Limits) -> usize {
    let one = requests::measure_stored(space.representation(), Counts::for_space(space, 1, limits), limits);
    ((GROUP_SECONDS / one.seconds().max(f64::MIN_POSITIVE)) as usize).clamp(1, CHUNK_SHAPES)
}

/// The results with the ids of the valid inputs, which are in order.
fn with_ids(mut results: Vec<UploadResult>, ids: Vec<String>) -> Vec<UploadResult> {
    let valid = results.iter_mut().filter(|result| result.faults.is_empty());
    valid.zip(ids).for_each(|(result, id)| result.id = Some(id));
    results
}

/// The ids of the first inputs out of `count`, with `None` for those that were `refused`; both are in order.
fn aligned(ids: Vec<String>, refused: &[UploadResult], count: usize) -> Vec<Option<String>> {
    let (mut ids, mut refused) = (ids.into_iter(), refused.iter().peekable());
    let id = |index| match refused.next_if(|refused| refused.index == index) {
        Some(_) => None,
        None => ids.next(),
    };
    (0..count.min(MAX_NAMED)).map(id).collect()
}

/// The warning that shapes of the cohort have other attributes than those that arrived.
fn stay(differing: usize) -> Option<String> {
    let warning = "shapes stand in the cohort with the same points and other attributes or metadata, which stay as they are";
    (differing > 0).then(|| format!("{differing} {warning}"))
}

/// The results with shapes that were left out after they were noted as valid, and the number of valid ones that have none. Both lists are
/// in order.
fn with_conflicts(
    mut results: Vec<UploadResult>,
    conflicts: Vec<UploadResult>,
    left_out: usize,
) -> (Vec<UploadResult>, usize) {
    let unlisted = conflicts.iter().filter(|conflict| conflict.index >= MAX_NAMED).count();
    let mut replaced = conflicts.iter().map(|conflict| conflict.index).peekable();
    results.retain(|result| {
        while replaced.next_if(|index| *index < result.index).is_some() {}
        replaced.peek() != Some(&result.index)
    });
    results.extend(conflicts);
    results.sort_by_key(|result| result.index);
    (results, left_out.saturating_sub(unlisted))
}

/// Writes shapes to the store; keeps the ids of the first `most`. The part that a preview keeps of them takes `room`.
async fn write(
    upload: Upload,
    mut room: Held,
    mut chunks: mpsc::Receiver<Vec<Arrived>>,
    prefix: &'static str,
    most: usize,
) -> Result<Written, ServiceError> {
    let (ids, conflicts) = (Vec::new(), Vec::new());
    let mut written = Written { upload, new: 0, unchanged: 0, differing: 0, ids, conflicts };
    let mut first = 0;
    while let Some(chunk) = chunks.recv().await {
        let (origins, rows): (Vec<Origin>, Vec<ShapeRow>) =
            chunk.into_iter().map(|arrived| (arrived.origin, arrived.row)).unzip();
        let added = match written.upload.add(rows).await {
            Ok(added) => added,
            Err(error) => {
                written.upload.abort().await?;
                return Err(located(error, first, &origins, prefix));
            }
        };
        if let Err(error) = room.grow_to(written.upload.kept_bytes()) {
            written.upload.abort().await?;
            return Err(error);
        }
        first += origins.len();
        for (added, origin) in added.into_iter().zip(&origins) {
            let id = match added {
                Added::New { id } => {
                    written.new += 1;
                    id
                }
                Added::Existing { id, differs } => {
                    written.unchanged += 1;
                    written.differing += usize::from(differs);
                    id
                }
                Added::Conflict if written.conflicts.len() < MAX_REFUSED => {
                    written.conflicts.push(origin.refused(prefix));
                    continue;
                }
                Added::Conflict => {
                    written.upload.abort().await?;
                    return Err(too_many_refused());
                }
            };
            if written.ids.len() < most {
                written.ids.push(id);
            }
        }
    }
    Ok(written)
}

/// Locates a conflict in the input; `origins` are those of the chunk that begins at the valid shape `first`.
fn located(error: StoreError, first: usize, origins: &[Origin], prefix: &str) -> ServiceError {
    let StoreError::ExternalIdConflict { position, external_id } = error else { return error.into() };
    let offset = usize::try_from(position).ok().and_then(|position| position.checked_sub(first));
    ServiceError::ExternalIdConflict(Box::new(match offset.and_then(|offset| origins.get(offset)) {
        Some(origin) => origin.conflict(&external_id, prefix),
        None => {
            Fault::new("/external_id", format!("the external id '{external_id}' belongs to another shape"))
        }
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_are_matched_to_the_inputs() {
        let refused =
            |index| UploadResult { index, faults: vec![Fault::new("", "bad")], ..UploadResult::default() };
        let valid = |index| UploadResult { index, ..UploadResult::default() };
        let ids = || vec!["a".to_owned(), "b".to_owned()];
        let results = with_ids(vec![refused(0), valid(1), refused(2), valid(3)], ids());
        let found: Vec<_> = results.iter().map(|result| result.id.as_deref()).collect();
        assert_eq!(found, [None, Some("a"), None, Some("b")]);
        let found = aligned(ids(), &[refused(0), refused(2)], 4);
        assert_eq!(found, [None, Some("a".to_owned()), None, Some("b".to_owned())]);
        assert_eq!(aligned(ids(), &[], 2), [Some("a".to_owned()), Some("b".to_owned())]);
    }

    #[test]
    fn conflicts_take_the_place_of_valid_inputs() {
        let result = |index, faults: usize| {
            let faults = vec![Fault::new("", "bad"); faults];
            UploadResult { index, faults, ..UploadResult::default() }
        };
        let conflicts = vec![result(1, 2), result(3, 2), result(MAX_NAMED + 5, 2)];
        let noted = vec![result(0, 0), result(1, 0), result(2, 1), result(3, 0)];
        let (all, left_out) = with_conflicts(noted, conflicts.clone(), 9);
        let found: Vec<_> = all.iter().map(|result| (result.index, result.faults.len())).collect();
        assert_eq!((found, left_out), (vec![(0, 0), (1, 2), (2, 1), (3, 2), (MAX_NAMED + 5, 2)], 8));
        let (only, _) = with_conflicts(vec![result(2, 1)], conflicts, 9);
        assert_eq!(only.iter().map(|result| result.index).collect::<Vec<_>>(), [1, 2, 3, MAX_NAMED + 5]);
    }

    #[test]
    fn receipts_of_earlier_versions_are_read() {
        let text = r#"{"added": 2, "revision": 3, "ids": ["a", "b"], "skipped": 0, "faults": []}"#;
        let stored: Stored = serde_json::from_str(text).unwrap();
        assert_eq!(stored.ids, [Some("a".to_owned()), Some("b".to_owned())]);
        assert_eq!((stored.added, stored.results.len()), (2, 0));
    }
}
