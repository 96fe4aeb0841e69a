//! Storing any number of shapes, all or none, in bounded memory.
//!
//! An [`Upload`] writes pending chunks, invisible to readers, in one short transaction per call, and assigns them a revision
//! at the end. A slow client therefore does not block others.

use std::collections::HashMap;
use std::sync::Arc;

use super::answer::Answer;
use super::attributes::NewNames;
use super::blob::{self, Encoded};
use super::engine::{self, Transaction, sql};
use super::engine::{from_sql, to_sql};
use super::error::StoreError;
use super::handle::{PURGE_UPLOAD, Store, blocking};
use super::order::Cursor;
use super::shapes;
use super::text::to_text;
use super::{changes, receipts};
use crate::domain::change::{ChangeKind, NewChange};
use crate::domain::cohort::Cohort;
use crate::domain::job::Job;
use crate::domain::retry::Receipt;

mod digest;
mod preview;
mod row;

pub use row::ShapeRow;

/// Number of retries when another upload stores the same external id at the same time.
const ATTEMPTS: usize = 3;

/// Outcome for one shape.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Added {
    /// It was stored.
    New {
        /// Id of the new shape.
        id: String,
    },
    /// It already exists, with the same external id and the same control points, bit for bit.
    Existing {
        /// Id of the existing shape.
        id: String,
        /// Whether its attributes are others, as after a correction. They stay.
        differs: bool,
    },
    /// Its external id belongs to a shape with other control points: it is left out.
    Conflict,
}

/// Shapes being added to a cohort. Dropped without [`Upload::commit`], it leaves nothing behind.
#[derive(Debug)]
pub struct Upload {
    store: Store,
    cohort_id: String,
    width: usize,
    id: String,
    /// Number of shapes received so far.
    received: u64,
    /// Number of shapes in pending chunks.
    stored: i64,
    /// Whether there may be pending rows.
    dirty: bool,
    /// Whether shapes whose external id belongs to another one are left out.
    skips_conflicts: bool,
    /// Names of the attributes of the shapes.
    names: Option<NewNames>,
    /// Correspondence and direction by which the shapes were converted.
    rule: [String; 2],
    /// Unit of the shapes, where one is known.
    unit: Option<UnitOfShapes>,
    /// Shapes of a preview, which writes none.
    met: Option<preview::Met>,
}

/// The unit in which shapes are stored, and the unit of the cohort when they were converted to it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnitOfShapes {
    /// Text of the cohort.
    pub former: Option<String>,
    /// Unit of the shapes.
    pub unit: String,
    /// Whether the cohort takes it, if it still has no shapes.
    pub adopt: bool,
}

impl Store {
    /// Starts an upload to a cohort. Does not access the database yet.
    pub fn begin_upload(&self, cohort: &Cohort) -> Upload {
        let representation = &cohort.spec.representation;
        Upload {
            store: self.clone(),
            cohort_id: cohort.id.clone(),
            width: representation.size() * representation.dimension(),
            id: self.inner.replica.owned_id(),
            received: 0,
            stored: 0,
            dirty: false,
            skips_conflicts: false,
            names: None,
            rule: [to_text(&cohort.spec.correspondence), to_text(&cohort.spec.direction)],
            unit: None,
            met: None,
        }
    }
}

/// Makes the receipt of an upload from the revision that it made.
type ReceiptOf<'a> = Box<dyn FnOnce(u64) -> Option<Receipt> + Send + 'a>;

impl Upload {
    /// Stores a batch of shapes, not yet visible; returns their outcomes in order.
    ///
    /// A call is one transaction and holds its shapes in memory twice: pass some thousands. After an error the upload is as it
    /// was before the call. Making rows of shapes is left to the caller, who can do it in parallel.
    ///
    /// # Errors
    /// [`StoreError::ExternalIdConflict`] if a shape with other control points has the external id and conflicts are not skipped,
    /// [`StoreError::ExternalIdPending`] if another unfinished upload has it, [`StoreError::WrongWidth`],
    /// [`StoreError::CohortGone`].
    pub fn add(&mut self, shapes: Vec<impl Into<ShapeRow>>) -> Answer<'_, Vec<Added>> {
        self.add_rows(shapes.into_iter().map(Into::into).collect())
    }

    fn add_rows(&mut self, rows: Vec<ShapeRow>) -> Answer<'_, Vec<Added>> {
        Box::pin(async move {
            if rows.is_empty() {
                return Ok(Vec::new());
            }
            let batch = Arc::new(Batch::new(rows, self.received, self.width)?);
            let mut attempt = 1;
            let added = loop {
                match self.try_add(&batch).await {
                    // Another upload stored the id after the lookup; the next lookup will find it.
                    Err(StoreError::Database(e)) if is_race(&e) && attempt < ATTEMPTS => attempt += 1,
                    // The process that owned the other upload may have died; reclaim its rows.
                    Err(StoreError::ExternalIdPending { .. }) if attempt < ATTEMPTS => {
                        self.store.tidy_behind_the_dead().await?;
                        attempt += 1;
                    }
                    done => break done?,
                }
            };
            self.received += batch.rows.len() as u64;
            Ok(added)
        })
    }

    /// Leaves out shapes whose external id belongs to a shape with other control points, instead of refusing all.
    pub fn skip_conflicts(&mut self) {
        self.skips_conflicts = true;
    }

    /// Names the attributes of the shapes, which the cohort must have room for when they become visible.
    pub fn name_attributes(&mut self, names: Option<NewNames>) {
        self.names = names;
    }

    /// Says the unit of the shapes, which the cohort must still have, or takes, when they become visible.
    pub fn keep_unit(&mut self, unit: Option<UnitOfShapes>) {
        self.unit = unit;
    }

    /// Makes all shapes visible at once; returns the new revision of the cohort, or the current one if nothing was new.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`] if the cohort was deleted in the meantime, [`StoreError::UploadLost`].
    pub fn commit(self, now_ms: i64) -> Answer<'static, u64> {
        self.commit_once(now_ms, None, None, |_| None)
    }

    /// Like [`Upload::commit`] for a cohort that must be at the `expected` revision, by a `job`, as it was claimed, that must still
    /// be held, with a receipt for the new revision.
    ///
    /// # Errors
    /// Also [`StoreError::Changed`], [`StoreError::JobLost`], [`StoreError::TooManyNames`] and [`StoreError::AlreadyDone`]; nothing
    /// is stored then.
    pub fn commit_once<'a>(
        self,
        now_ms: i64,
        expected: Option<u64>,
        job: Option<&'a Job>,
        receipt: impl FnOnce(u64) -> Option<Receipt> + Send + 'a,
    ) -> Answer<'a, u64> {
        self.commit_with(now_ms, expected, job, Box::new(receipt))
    }

    fn commit_with<'a>(
        self,
        now_ms: i64,
        expected: Option<u64>,
        job: Option<&'a Job>,
        receipt: ReceiptOf<'a>,
    ) -> Answer<'a, u64> {
        Box::pin(async move {
            const COUNT: &str = "SELECT CAST(coalesce(sum(rows), 0) AS BIGINT) FROM chunk
                WHERE upload = $1 AND revision IS NULL";
            // Whole: fields that are captured one by one would be copies, and the rest be dropped before the work begins.
            let mut upload = self;
            let mut write = upload.store.begin_write(&upload.cohort_id).await?;
            let cohort = upload.store.number_at(&mut write, &upload.cohort_id, expected).await?;
            if let Some(job) = job
                && !upload.store.holds(&mut write, job).await?
            {
                return Err(StoreError::JobLost);
            }
            upload.check_rule(&mut write, cohort).await?;
            if let Some(names) = &upload.names {
                names.check(&mut write, cohort).await?;
            }
            let count = sql(&mut write, COUNT).bind(&upload.id);
            let count: i64 = count.scalar().await?;
            if count != upload.stored {
                return Err(StoreError::UploadLost);
            }
            upload.check_unit(&mut write, cohort, count > 0).await?;
            let revision = if count == 0 {
                let current = sql(&mut write, "SELECT revision FROM cohort WHERE number = $1");
                current.bind(cohort).scalar().await?
            } else {
                upload.publish(&mut write, cohort, count, now_ms).await?
            };
            let tenant = upload.store.tenant();
            receipts::keep(&mut write, tenant, receipt(from_sql(revision)).as_ref(), now_ms).await?;
            if count > 0 {
                let change = NewChange {
                    shapes: Some(from_sql(count)),
                    ..NewChange::for_cohort(ChangeKind::ShapesAdded, &upload.cohort_id, from_sql(revision))
                };
                changes::record(&mut write, tenant, &change, now_ms).await?;
            }
            write.commit().await?;
            upload.dirty = false;
            Ok(from_sql(revision))
        })
    }

    /// Removes the shapes stored so far.
    ///
    /// # Errors
    /// Database errors; the rest is then removed at the next start.
    pub fn abort(self) -> Answer<'static, ()> {
        Box::pin(async move {
            let mut upload = self;
            if upload.dirty {
                upload.store.purge(PURGE_UPLOAD, Some(&upload.id)).await?;
                upload.dirty = false;
            }
            Ok(())
        })
    }

    /// Checks that the cohort still has the rule by which the shapes were converted.
    async fn check_rule(&self, write: &mut Transaction, cohort: i64) -> Result<(), StoreError> {
        const RULE: &str = "SELECT correspondence, direction FROM cohort WHERE number = $1";
        let row = sql(write, RULE).bind(cohort).optional().await?.ok_or(StoreError::CohortGone)?;
        let present: [String; 2] = [row.get("correspondence")?, row.get("direction")?];
        if present == self.rule { Ok(()) } else { Err(StoreError::Changed) }
    }

    /// Checks that the cohort has the unit to which the shapes were converted, or gives it to an empty one.
    async fn check_unit(&self, write: &mut Transaction, cohort: i64, is_new: bool) -> Result<(), StoreError> {
        const UNIT: &str = "SELECT length_unit, shapes FROM cohort WHERE number = $1";
        const ADOPT: &str = "UPDATE cohort SET length_unit = $2 WHERE number = $1";
        let Some(UnitOfShapes { former, unit, adopt }) = &self.unit else { return Ok(()) };
        let row = sql(&mut *write, UNIT).bind(cohort).optional().await?.ok_or(StoreError::CohortGone)?;
        let present: Option<String> = row.get("length_unit")?;
        if present.as_ref() == Some(unit) {
            return Ok(());
        }
        if present != *former || *adopt && row.get::<i64>("shapes")? > 0 {
            return Err(StoreError::Changed);
        }
        if *adopt && is_new {
            sql(write, ADOPT).bind(cohort).bind(unit).execute().await?;
        }
        Ok(())
    }

    /// Assigns the next revision to the pending chunks.
    async fn publish(
        &self,
        write: &mut Transaction,
        cohort: i64,
        count: i64,
        now_ms: i64,
    ) -> Result<i64, StoreError> {
        const GROW: &str = "UPDATE cohort
            SET revision = revision + 1, shapes = shapes + $2, updated_at_ms = $3
            WHERE number = $1 RETURNING revision";
        const SHOW: &str = "UPDATE chunk SET revision = $2, created_at_ms = $3
            WHERE upload = $1 AND revision IS NULL RETURNING rows";
        let revision: i64 = sql(&mut *write, GROW).bind(cohort).bind(count).bind(now_ms).scalar().await?;
        let shown = sql(&mut *write, SHOW).bind(&self.id).bind(revision).bind(now_ms).all().await?;
        let rows = shown.iter().map(|chunk| chunk.get::<i64>("rows")).sum::<Result<i64, _>>()?;
        // A replica that considers this one dead may remove chunks after they were counted.
        if rows != count {
            return Err(StoreError::UploadLost);
        }
        Ok(revision)
    }

    /// Looks up external ids, then writes. The lookup needs no write lock: the unique index decides in the end.
    async fn try_add(&mut self, batch: &Arc<Batch>) -> Result<Vec<Added>, StoreError> {
        let mut read = self.store.begin_read().await?;
        let cohort = self.store.number(&mut read, &self.cohort_id).await?;
        let mut held = find_held(&mut read, cohort, &self.id, batch).await?;
        digest_points(&mut read, &mut held, batch).await?;
        read.commit().await?;
        if let Some(met) = &self.met {
            met.add_to(&mut held, batch);
        }
        let (added, fresh) = batch.sort_out(&held, self.skips_conflicts)?;
        if let Some(met) = &mut self.met {
            met.note(batch, &fresh);
            return Ok(added);
        }
        if fresh.is_empty() {
            return Ok(added);
        }
        let (shared, width) = (Arc::clone(batch), self.width);
        let stored = fresh.len() as i64;
        let chunks = blocking(move || shared.encode(&fresh, width)).await;
        // Set before the write, which may succeed even if its confirmation is lost.
        self.dirty = true;
        self.write(cohort, batch, &chunks).await?;
        self.stored += stored;
        Ok(added)
    }

    async fn write(&self, cohort: i64, batch: &Batch, chunks: &[NewChunk]) -> Result<(), StoreError> {
        let mut write = self.store.begin_write(&self.id).await?;
        let mut places = Vec::new();
        for chunk in chunks {
            let (rows, width) = (chunk.rows.len(), self.width);
            let number = insert_chunk(&mut write, cohort, &self.id, (rows, width), &chunk.data).await?;
            let rows = chunk.rows.iter().map(|&index| &batch.rows[index]);
            places.extend((0..).zip(rows).map(|(position, row)| Place { chunk: number, position, row }));
        }
        // Statements of all chunks together.
        for rows in engine::rows_of_inserts(&places) {
            insert_rows(&mut write, cohort, rows).await?;
        }
        Ok(write.commit().await?)
    }
}

impl Drop for Upload {
    fn drop(&mut self) {
        // Without a runtime the process is about to end; the next start cleans up.
        let Ok(runtime) = tokio::runtime::Handle::try_current() else {
            return;
        };
        if self.dirty {
            let (store, id) = (self.store.clone(), std::mem::take(&mut self.id));
            runtime.spawn(async move {
                // A failure leaves rows that no reader sees, until the next start.
                let _ = store.purge(PURGE_UPLOAD, Some(&id)).await;
            });
        }
    }
}

fn is_race(error: &sqlx::Error) -> bool {
    engine::is_duplicate(error, "shape", "external_id")
}

/// Stores a chunk of `rows` shapes of `width` coordinates, not yet visible; returns its number.
async fn insert_chunk(
    write: &mut Transaction,
    cohort: i64,
    upload: &str,
    (rows, width): (usize, usize),
    data: &Encoded,
) -> Result<i64, StoreError> {
    const CHUNK: &str = "INSERT INTO chunk (cohort, upload, rows, width)
        VALUES ($1, $2, $3, $4) RETURNING id";
    const DATA: &str = "INSERT INTO chunk_data (chunk_id, checksum, weights, points)
        VALUES ($1, $2, $3, $4)";
    let inserted =
        sql(&mut *write, CHUNK).bind(cohort).bind(upload).bind(rows as i64).bind(width as i64).scalar().await;
    let number: i64 = match inserted {
        Err(e) if engine::is_missing_reference(&e) => return Err(StoreError::CohortGone),
        other => other?,
    };
    sql(write, DATA)
        .bind(number)
        .bind(data.checksum.as_slice())
        .bind(data.weights.as_deref())
        .bind(data.points.as_slice())
        .execute()
        .await?;
    Ok(number)
}

/// Stores a shape in a separate chunk, not yet visible; returns the number of the chunk.
pub(super) async fn insert_alone(
    write: &mut Transaction,
    cohort: i64,
    upload: &str,
    row: &ShapeRow,
    data: &Encoded,
) -> Result<i64, StoreError> {
    let chunk = insert_chunk(&mut *write, cohort, upload, (1, row.width()), data).await?;
    insert_rows(write, cohort, &[Place { chunk, position: 0, row }]).await?;
    Ok(chunk)
}

async fn insert_rows(write: &mut Transaction, cohort: i64, places: &[Place<'_>]) -> Result<(), StoreError> {
    const INSERT: &str = "INSERT INTO shape (chunk_id, position, cohort, id, external_id, subject,
        label, digest, labels, metadata, points, centroid_size, length, area, volume, self_intersecting, clockwise,
        fit_mean, fit_largest, fit_area, given_start, given_reversed, first_stored_ms) ";
    let mut query = sql(write, INSERT);
    for (index, Place { chunk, position, row }) in places.iter().enumerate() {
        query.push(if index == 0 { "VALUES (" } else { ", (" });
        query.push_bind(*chunk).push(", ").push_bind(*position).push(", ").push_bind(cohort);
        query.push(", ").push_bind(row.id.as_str());
        for text in [&row.external_id, &row.subject, &row.label] {
            query.push(", ").push_bind(text.as_deref());
        }
        query.push(", ").push_bind(row.digest_bytes());
        query.push(", ").push_bind(row.labels.as_deref());
        query.push(", ").push_bind(row.metadata.as_deref());
        let measures = &row.measures;
        query.push(", ").push_bind(measures.points.map(to_sql));
        for number in [measures.centroid_size, measures.length, measures.area, measures.volume] {
            query.push(", ").push_bind(number);
        }
        for flag in [measures.self_intersecting, measures.clockwise] {
            query.push(", ").push_bind(flag.map(i64::from));
        }
        let fit = measures.fit;
        for number in [fit.map(|fit| fit.mean), fit.map(|fit| fit.largest), fit.map(|fit| fit.area)] {
            query.push(", ").push_bind(number);
        }
        query.push(", ").push_bind(measures.beginning.map(|beginning| beginning.start));
        query.push(", ").push_bind(measures.beginning.map(|beginning| i64::from(beginning.reversed)));
        query.push(", ").push_bind(row.first_stored_ms);
        query.push(")");
    }
    query.execute().await?;
    Ok(())
}

/// A row and its place in a stored chunk.
#[derive(Debug)]
struct Place<'a> {
    chunk: i64,
    position: i64,
    row: &'a ShapeRow,
}

/// Shapes of one call.
#[derive(Debug)]
struct Batch {
    rows: Vec<ShapeRow>,
    /// Position of the first shape in the upload.
    first: u64,
}

/// An existing shape with the same external id.
#[derive(Debug, Clone)]
struct Held {
    id: String,
    /// `None` if an unfinished upload holds it, which may still be rolled back.
    digest: Option<Vec<u8>>,
    place: Cursor,
    /// Digest of its control points, where that of its content is another one.
    points: Option<blake3::Hash>,
}

impl Held {
    /// The outcome of a row with its external id.
    fn beside(&self, row: &ShapeRow) -> Added {
        if row.is_stored_as(self.digest.as_deref()) {
            Added::Existing { id: self.id.clone(), differs: false }
        } else if self.points == Some(row.points_digest()) {
            Added::Existing { id: self.id.clone(), differs: true }
        } else {
            Added::Conflict
        }
    }
}

/// The outcome of a row with the external id of an earlier one.
fn beside(first: &ShapeRow, row: &ShapeRow) -> Added {
    if first.points == row.points {
        Added::Existing { id: first.id.clone(), differs: !row.is_stored_as(first.digest_bytes()) }
    } else {
        Added::Conflict
    }
}

/// A chunk to be stored.
#[derive(Debug)]
struct NewChunk {
    data: Encoded,
    /// Indices of its rows in the batch.
    rows: Vec<usize>,
}

impl Batch {
    fn new(rows: Vec<ShapeRow>, first: u64, expected: usize) -> Result<Self, StoreError> {
        for (position, row) in (first..).zip(&rows) {
            let found = row.width();
            if found != expected {
                return Err(StoreError::WrongWidth { position, found, expected });
            }
        }
        Ok(Self { rows, first })
    }

    /// Determines the outcomes, and the shapes to be stored.
    fn sort_out(
        &self,
        held: &HashMap<String, Held>,
        skips_conflicts: bool,
    ) -> Result<(Vec<Added>, Vec<usize>), StoreError> {
        let mut seen: HashMap<&str, &ShapeRow> = HashMap::new();
        let (mut added, mut fresh) = (Vec::with_capacity(self.rows.len()), Vec::new());
        for (index, row) in self.rows.iter().enumerate() {
            let key = row.external_id.as_deref();
            let outcome = match (key.and_then(|key| seen.get(key)), key.and_then(|key| held.get(key))) {
                (Some(first), _) => beside(first, row),
                (None, Some(held)) if held.digest.is_none() => return Err(self.pending(index)),
                (None, Some(held)) => held.beside(row),
                (None, None) => {
                    fresh.push(index);
                    seen.extend(key.map(|key| (key, row)));
                    Added::New { id: row.id.clone() }
                }
            };
            if outcome == Added::Conflict && !skips_conflicts {
                return Err(self.conflict(index));
            }
            added.push(outcome);
        }
        Ok((added, fresh))
    }

    fn conflict(&self, index: usize) -> StoreError {
        let (position, external_id) = self.name(index);
        StoreError::ExternalIdConflict { position, external_id }
    }

    fn pending(&self, index: usize) -> StoreError {
        let (position, external_id) = self.name(index);
        StoreError::ExternalIdPending { position, external_id }
    }

    /// Position in the whole upload and external id of a shape of the batch.
    fn name(&self, index: usize) -> (u64, String) {
        let external_id = self.rows[index].external_id.clone();
        (self.first + index as u64, external_id.unwrap_or_default())
    }

    fn encode(&self, fresh: &[usize], width: usize) -> Vec<NewChunk> {
        let chunk = |indices: &[usize]| {
            let rows = indices.iter().map(|&index| &self.rows[index]);
            let data = Encoded::new(rows.map(|row| (row.weight, row.points.as_slice())));
            NewChunk { data, rows: indices.to_vec() }
        };
        fresh.chunks(blob::rows_per_chunk(width)).map(chunk).collect()
    }
}

/// Shapes of a cohort, perhaps all of them, to be stored again.
#[derive(Debug)]
pub(super) struct WholeCohort {
    batch: Batch,
    chunks: Vec<NewChunk>,
    width: usize,
}

impl WholeCohort {
    /// Encodes the shapes of `width` coordinates each.
    ///
    /// # Errors
    /// [`StoreError::WrongWidth`].
    pub(super) fn new(rows: Vec<ShapeRow>, width: usize) -> Result<Self, StoreError> {
        let all: Vec<usize> = (0..rows.len()).collect();
        let batch = Batch::new(rows, 0, width)?;
        let chunks = batch.encode(&all, width);
        Ok(Self { batch, chunks, width })
    }

    /// Stores them, not yet visible; returns the chunk and position of each, in order.
    pub(super) async fn insert(
        &self,
        write: &mut Transaction,
        cohort: i64,
        upload: &str,
    ) -> Result<Vec<(i64, i64)>, StoreError> {
        let mut places = Vec::new();
        for chunk in &self.chunks {
            let size = (chunk.rows.len(), self.width);
            let number = insert_chunk(&mut *write, cohort, upload, size, &chunk.data).await?;
            let rows = chunk.rows.iter().map(|&index| &self.batch.rows[index]);
            places.extend((0..).zip(rows).map(|(position, row)| Place { chunk: number, position, row }));
        }
        for rows in engine::rows_of_inserts(&places) {
            insert_rows(&mut *write, cohort, rows).await?;
        }
        Ok(places.iter().map(|place| (place.chunk, place.position)).collect())
    }
}

/// Shapes of the cohort that have one of the batch's external ids.
async fn find_held(
    read: &mut Transaction,
    cohort: i64,
    upload: &str,
    batch: &Batch,
) -> Result<HashMap<String, Held>, StoreError> {
    const HELD: &str = "SELECT s.external_id, s.id, s.digest, s.chunk_id, s.position,
        c.revision IS NOT NULL AS visible, c.upload
        FROM json_each($2) AS asked
        CROSS JOIN shape AS s ON s.cohort = $1 AND s.external_id = asked.value
        CROSS JOIN chunk AS c ON c.id = s.chunk_id
        WHERE s.deleted_revision IS NULL";
    let keys: Vec<&str> = batch.rows.iter().filter_map(|row| row.external_id.as_deref()).collect();
    let mut held = HashMap::new();
    if keys.is_empty() {
        return Ok(held);
    }
    let asked = serde_json::Value::from(keys).to_string();
    for row in sql(read, HELD).bind(cohort).bind(asked).all().await? {
        let is_ours = row.get::<&str>("upload")? == upload;
        let digest: Option<Vec<u8>> = row.get("digest")?;
        let counts = is_ours || row.get::<bool>("visible")?;
        let place = Cursor { chunk: row.get("chunk_id")?, position: row.get("position")? };
        let found = Held { id: row.get("id")?, digest: digest.filter(|_| counts), place, points: None };
        held.insert(row.get("external_id")?, found);
    }
    Ok(held)
}

/// Digests the control points of the shapes whose content is not that of the batch's shape with their external id. Cost: their chunks are
/// read, one after the other.
async fn digest_points(
    read: &mut Transaction,
    held: &mut HashMap<String, Held>,
    batch: &Batch,
) -> Result<(), StoreError> {
    let mut asked: Vec<(Cursor, &str)> = Vec::new();
    for row in &batch.rows {
        let Some(key) = row.external_id.as_deref() else { continue };
        let Some(found) = held.get(key).filter(|found| found.digest.is_some()) else { continue };
        if !row.is_stored_as(found.digest.as_deref()) {
            asked.push((found.place, key));
        }
    }
    asked.sort_unstable();
    for chunk in asked.chunk_by(|(a, _), (b, _)| a.chunk == b.chunk) {
        let places: Vec<Cursor> = chunk.iter().map(|(place, _)| *place).collect();
        for ((_, key), digest) in chunk.iter().zip(shapes::points_digests(read, places).await?) {
            if let Some(found) = held.get_mut(*key) {
                found.points = Some(digest);
            }
        }
    }
    Ok(())
}
