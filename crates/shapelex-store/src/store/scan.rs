//! Bulk reading of a cohort's control points at a fixed revision.

use std::collections::HashMap;
use std::ops::Range;

use super::answer::Answer;
use super::blob::{self, Chunk};
use super::engine::to_sql;
use super::engine::{Row, Transaction, sql};
use super::error::StoreError;
use super::filter::{Revisions, Selection};
use super::handle::{Store, blocking};
use super::order::Cursor;
use super::places::Places;
use crate::domain::filter::ShapeFilter;

/// Maximum size of the control points in a batch, and of the chunks in memory at once, unless a single one is larger.
const BYTES_PER_BATCH: i64 = 4 << 20;
/// Maximum number of bytes read for one batch: when few shapes pass a filter, most of the bytes read are discarded.
const READ_BYTES_PER_BATCH: i64 = 64 << 20;
const BYTES_PER_NUMBER: i64 = size_of::<f64>() as i64;
/// Maximum number of shapes in a batch assembled from single rows.
const ROWS_PER_BATCH: usize = 4096;
/// Maximum number of chunks in a batch: shapes added one by one have a chunk each.
const CHUNKS_PER_BATCH: i64 = 1024;
/// Maximum number of chunks in a batch of shapes at given places, and in a page of such places.
const CHUNKS_WITH_PLACES: usize = 64;

/// Whether a scan reads ids, which costs more than the control points.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Ids {
    /// Leave [`ScanBatch::ids`] empty.
    Skip,
    /// Read the id, external id and label of every shape.
    Include,
}

/// Batch of shapes in storage order.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanBatch {
    /// Position at which the next batch starts.
    pub position: Cursor,
    /// Ids, if requested.
    pub ids: Vec<String>,
    /// External ids, if ids are requested.
    pub external_ids: Vec<Option<String>>,
    /// Labels, if ids are requested.
    pub labels: Vec<Option<String>>,
    /// Places of the shapes in storage.
    pub places: Places,
    /// One weight per shape.
    pub weights: Vec<f64>,
    /// Control points, one shape after the other, each coordinate-major.
    pub control_points: Vec<f64>,
}

impl Store {
    /// Reads the next batch of shapes between the revisions; `None` if there are no more.
    ///
    /// `after` is the position of the previous batch, from a scan with the same arguments. Batches are the same whenever they
    /// are read, take a few megabytes each, and are fully verified.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`], even if it is deleted during the scan; [`StoreError::Corrupt`].
    pub fn scan<'a>(
        &'a self,
        cohort_id: &'a str,
        revisions: Revisions,
        filter: &'a ShapeFilter,
        after: Option<Cursor>,
        ids: Ids,
    ) -> Answer<'a, Option<ScanBatch>> {
        Box::pin(async move {
            let mut after = after.map_or((0, -1), |c| (c.chunk, c.position));
            loop {
                let mut read = self.begin_read().await?;
                let selection =
                    Selection { cohort: self.number(&mut read, cohort_id).await?, revisions, filter, after };
                let plan = if ids == Ids::Skip && filter.is_everything() {
                    plan_chunks(&mut read, &selection).await?
                } else {
                    plan_rows(&mut read, &selection).await?
                };
                let Some(plan) = plan else { return Ok(None) };
                let batch = plan.read(&mut read, ids).await?;
                if !batch.weights.is_empty() {
                    return Ok(Some(batch));
                }
                after = (batch.position.chunk, batch.position.position);
            }
        })
    }
}

impl Store {
    /// Places of the shapes between the revisions that pass the filter, in storage order. Reads no control points.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`].
    pub fn places<'a>(
        &'a self,
        cohort_id: &'a str,
        revisions: Revisions,
        filter: &'a ShapeFilter,
    ) -> Answer<'a, Places> {
        Box::pin(async move {
            let (mut places, mut after) = (Places::default(), (0, -1));
            let mut read = self.begin_read().await?;
            let cohort = self.number(&mut read, cohort_id).await?;
            loop {
                let selection = Selection { cohort, revisions, filter, after };
                let page = if filter.is_everything() {
                    page_of_chunks(&mut read, &selection).await?
                } else {
                    page_of_rows(&mut read, &selection).await?
                };
                let Some((found, end)) = page else { return Ok(places) };
                places.append(&found);
                after = (end.chunk, end.position);
            }
        })
    }
}

impl Store {
    /// Reads the shapes at `places`, those of [`Store::places`] at the revision `until`, from the position `first` on: as many as a batch
    /// holds, without ids, and the position behind them; `None` behind the last one. Shapes that were erased since are left out.
    ///
    /// Each chunk with such shapes is read once, and no descriptions are.
    ///
    /// # Errors
    /// As [`Store::scan`].
    pub fn scan_places<'a>(
        &'a self,
        cohort_id: &'a str,
        until: u64,
        places: &'a Places,
        first: usize,
    ) -> Answer<'a, Option<(ScanBatch, usize)>> {
        Box::pin(async move {
            let mut read = self.begin_read().await?;
            let everything = ShapeFilter::default();
            let selection = Selection {
                cohort: self.number(&mut read, cohort_id).await?,
                revisions: Revisions::until(until),
                filter: &everything,
                after: (0, -1),
            };
            let Some((plan, count)) = plan_places(&mut read, &selection, places, first).await? else {
                return Ok(None);
            };
            Ok(Some((plan.read(&mut read, Ids::Skip).await?, first + count)))
        })
    }
}

/// Places in the next chunks, and the end of the last one; reads only the rows of deleted shapes.
async fn page_of_chunks(
    read: &mut Transaction,
    selection: &Selection<'_>,
) -> Result<Option<(Places, Cursor)>, StoreError> {
    let chunks = next_chunks(read, selection).await?;
    let (Some(first), Some(last)) = (chunks.first(), chunks.last()) else { return Ok(None) };
    let deleted = list_deleted(read, selection, first.chunk, last.chunk).await?;
    let (mut places, mut gaps) = (Places::default(), deleted.as_slice());
    for size in &chunks {
        let here = take_gaps(&mut gaps, size.chunk);
        let rows = usize::try_from(size.rows).unwrap_or_default();
        runs_between(here, rows).for_each(|run| places.push(size.chunk, &run));
    }
    Ok(Some((places, Cursor { chunk: last.chunk, position: i64::MAX })))
}

/// Places of the next shapes that pass the filter, in whole chunks, and the end of the last one.
async fn page_of_rows(
    read: &mut Transaction,
    selection: &Selection<'_>,
) -> Result<Option<(Places, Cursor)>, StoreError> {
    let (mut places, mut end) = (Places::default(), None);
    for row in selection.places(read, CHUNKS_WITH_PLACES).all().await? {
        let (chunk, listed): (i64, &str) = (row.get("chunk_id")?, row.get("positions")?);
        let positions: Result<Vec<usize>, _> = listed.split(',').map(str::parse).collect();
        let mut positions = positions.map_err(|_| StoreError::Corrupt { chunk })?;
        positions.sort_unstable();
        positions.iter().for_each(|&position| places.push(chunk, &(position..position + 1)));
        end = Some(Cursor { chunk, position: i64::MAX });
    }
    Ok(end.map(|end| (places, end)))
}

/// Splits the deleted shapes of a chunk off the front of those of this and later chunks.
fn take_gaps<'a>(deleted: &mut &'a [Cursor], chunk: i64) -> &'a [Cursor] {
    let (gaps, rest) = deleted.split_at(deleted.partition_point(|gap| gap.chunk <= chunk));
    *deleted = rest;
    gaps
}

/// Runs of rows between the deleted ones of a chunk of `rows` shapes.
fn runs_between(gaps: &[Cursor], rows: usize) -> impl Iterator<Item = Range<usize>> {
    let starts = std::iter::once(0).chain(gaps.iter().map(|gap| row_of(gap) + 1));
    let ends = gaps.iter().map(row_of).chain([rows]);
    starts.zip(ends).map(|(start, end)| start..end)
}

/// Plan of the reads for one batch.
#[derive(Default)]
struct Plan {
    groups: Vec<Group>,
    /// Bytes of the chunks of the last group, of all chunks, and of the shapes taken.
    group_bytes: i64,
    read_bytes: i64,
    taken_bytes: i64,
    end: Option<Cursor>,
}

/// Chunks that are in memory together.
#[derive(Default)]
struct Group {
    /// Chunks in ascending order.
    chunks: Vec<i64>,
    choice: Choice,
}

enum Choice {
    /// All shapes except these deleted ones, in storage order.
    AllBut(Vec<Cursor>),
    /// Only these shapes, with their names, in storage order.
    Only(Vec<(Cursor, Names)>),
    /// Runs of rows, in storage order.
    Runs(Vec<(i64, Range<usize>)>),
}

/// Plans the shapes at places from a position on, and counts them; reads only the rows of deleted shapes.
async fn plan_places(
    read: &mut Transaction,
    selection: &Selection<'_>,
    places: &Places,
    first: usize,
) -> Result<Option<(Plan, usize)>, StoreError> {
    const SIZES: &str = "SELECT c.id AS chunk_id, c.rows, c.width FROM json_each($1) AS asked
        CROSS JOIN chunk AS c ON c.id = CAST(asked.value AS BIGINT)";
    let mut chunks: Vec<i64> = Vec::new();
    for (chunk, _) in places.runs_from(first) {
        match chunks.last() {
            Some(&last) if last == chunk => {}
            _ if chunks.len() == CHUNKS_WITH_PLACES => break,
            _ => chunks.push(chunk),
        }
    }
    let (Some(&first_chunk), Some(&last_chunk)) = (chunks.first(), chunks.last()) else { return Ok(None) };
    let asked = serde_json::Value::from(chunks).to_string();
    let mut sizes: HashMap<i64, ChunkSize> = HashMap::new();
    for row in sql(&mut *read, SIZES).bind(asked).all().await? {
        let size = ChunkSize::read(&row)?;
        sizes.insert(size.chunk, size);
    }
    let erased = list_deleted(read, selection, first_chunk, last_chunk).await?;
    let (mut plan, mut count) = (Plan::default(), 0);
    for (chunk, rows) in places.runs_from(first) {
        let size = match sizes.get(&chunk) {
            Some(size) => *size,
            None if chunk > last_chunk => break,
            None => return Err(StoreError::Corrupt { chunk }),
        };
        if !plan.admit(size, rows.len() as i64 * size.width * BYTES_PER_NUMBER) {
            break;
        }
        plan.choose_run(chunk, &rows, &erased);
        count += rows.len();
    }
    Ok(Some((plan, count)))
}

/// Id, external id and label of a shape.
struct Names {
    id: String,
    external_id: Option<String>,
    label: Option<String>,
}

impl Names {
    fn read(row: &Row) -> Result<Self, StoreError> {
        let (id, external_id) = (row.get("id")?, row.get("external_id")?);
        Ok(Self { id, external_id, label: row.get("label")? })
    }
}

impl Default for Choice {
    fn default() -> Self {
        Self::Only(Vec::new())
    }
}

/// Plans whole chunks; reads only the rows of deleted shapes.
async fn plan_chunks(
    connection: &mut Transaction,
    selection: &Selection<'_>,
) -> Result<Option<Plan>, StoreError> {
    let mut plan = Plan::default();
    for size in next_chunks(connection, selection).await? {
        if !plan.admit(size, size.bytes()) {
            break;
        }
        plan.end = Some(Cursor { chunk: size.chunk, position: i64::MAX });
    }
    // All of every chunk is taken, so the plan has a single group.
    let Some(group) = plan.groups.last_mut() else {
        return Ok(None);
    };
    let (first, last) = (group.chunks[0], group.chunks[group.chunks.len() - 1]);
    group.choice = Choice::AllBut(list_deleted(connection, selection, first, last).await?);
    Ok(Some(plan))
}

/// The next chunks between the revisions, in storage order.
async fn next_chunks(
    connection: &mut Transaction,
    selection: &Selection<'_>,
) -> Result<Vec<ChunkSize>, StoreError> {
    const NEXT: &str = "SELECT id AS chunk_id, rows, width FROM chunk
        WHERE cohort = $1 AND id > $2 AND revision > $3 AND revision <= $4 ORDER BY id LIMIT $5";
    let rows = sql(connection, NEXT)
        .bind(selection.cohort)
        .bind(selection.after.0)
        .bind(to_sql(selection.revisions.after))
        .bind(to_sql(selection.revisions.until))
        .bind(CHUNKS_PER_BATCH)
        .all()
        .await?;
    rows.iter().map(ChunkSize::read).collect()
}

/// Shapes in the chunks from `first` to `last` that were deleted up to the revision.
async fn list_deleted(
    connection: &mut Transaction,
    selection: &Selection<'_>,
    first: i64,
    last: i64,
) -> Result<Vec<Cursor>, StoreError> {
    const DELETED: &str = "SELECT chunk_id, position FROM shape
        WHERE cohort = $1 AND chunk_id BETWEEN $2 AND $3 AND deleted_revision <= $4
        ORDER BY chunk_id, position";
    let rows = sql(connection, DELETED)
        .bind(selection.cohort)
        .bind(first)
        .bind(last)
        .bind(to_sql(selection.revisions.until))
        .all()
        .await?;
    rows.iter().map(place).collect()
}

/// Plans single shapes that pass the filter, with their ids.
async fn plan_rows(
    connection: &mut Transaction,
    selection: &Selection<'_>,
) -> Result<Option<Plan>, StoreError> {
    const COLUMNS: &str = "s.chunk_id, s.position, s.id, s.external_id, s.label, c.rows, c.width";
    let rows = selection.page(connection, COLUMNS, ROWS_PER_BATCH).all().await?;
    let mut plan = Plan::default();
    for row in &rows {
        let (size, place) = (ChunkSize::read(row)?, place(row)?);
        if !plan.admit(size, size.width * BYTES_PER_NUMBER) {
            break;
        }
        plan.choose(place, Names::read(row)?);
    }
    Ok(plan.end.is_some().then_some(plan))
}

fn place(row: &Row) -> Result<Cursor, StoreError> {
    Ok(Cursor { chunk: row.get("chunk_id")?, position: row.get("position")? })
}

/// Size of a chunk.
#[derive(Clone, Copy)]
struct ChunkSize {
    chunk: i64,
    rows: i64,
    width: i64,
}

impl ChunkSize {
    fn read(row: &Row) -> Result<Self, StoreError> {
        Ok(Self { chunk: row.get("chunk_id")?, rows: row.get("rows")?, width: row.get("width")? })
    }

    fn bytes(self) -> i64 {
        self.rows * self.width * BYTES_PER_NUMBER
    }
}

impl Plan {
    /// Reserves `taken` bytes of a chunk; `false` if the batch is full. The first chunk always fits.
    fn admit(&mut self, size: ChunkSize, taken: i64) -> bool {
        let last = self.groups.last().and_then(|group| group.chunks.last());
        let more = if last == Some(&size.chunk) { 0 } else { size.bytes() };
        let is_full =
            self.taken_bytes + taken > BYTES_PER_BATCH || self.read_bytes + more > READ_BYTES_PER_BATCH;
        if is_full && !self.groups.is_empty() {
            return false;
        }
        if last != Some(&size.chunk) {
            self.push_chunk(size);
        }
        self.taken_bytes += taken;
        true
    }

    fn push_chunk(&mut self, size: ChunkSize) {
        if self.groups.is_empty() || self.group_bytes + size.bytes() > BYTES_PER_BATCH {
            self.groups.push(Group::default());
            self.group_bytes = 0;
        }
        self.group_bytes += size.bytes();
        self.read_bytes += size.bytes();
        if let Some(group) = self.groups.last_mut() {
            group.chunks.push(size.chunk);
        }
    }

    /// Adds a shape of the last admitted chunk.
    fn choose(&mut self, place: Cursor, names: Names) {
        self.end = Some(place);
        if let Some(Choice::Only(chosen)) = self.groups.last_mut().map(|group| &mut group.choice) {
            chosen.push((place, names));
        }
    }

    /// Adds rows of the last admitted chunk, without the erased ones.
    fn choose_run(&mut self, chunk: i64, rows: &Range<usize>, erased: &[Cursor]) {
        let until = |row: usize| erased.partition_point(|gap| (gap.chunk, row_of(gap)) < (chunk, row));
        let gaps = &erased[until(rows.start)..until(rows.end)];
        let Some(Group { choice, .. }) = self.groups.last_mut() else { return };
        if !matches!(choice, Choice::Runs(_)) {
            *choice = Choice::Runs(Vec::new());
        }
        if let Choice::Runs(runs) = choice {
            let starts = std::iter::once(rows.start).chain(gaps.iter().map(|gap| row_of(gap) + 1));
            let ends = gaps.iter().map(row_of).chain([rows.end]);
            runs.extend(starts.zip(ends).map(|(start, end)| (chunk, start..end)));
        }
    }

    /// Reads one group after the other.
    async fn read(self, connection: &mut Transaction, ids: Ids) -> Result<ScanBatch, StoreError> {
        let end = self.end.unwrap_or(Cursor { chunk: i64::MAX, position: i64::MAX });
        let mut batch = ScanBatch::empty(end);
        for group in self.groups {
            let rows = blob::load(connection, &group.chunks).await?;
            batch = blocking(move || group.append_to(batch, &rows, ids)).await?;
        }
        Ok(batch)
    }
}

impl Group {
    /// Verifies the chunks and appends the chosen shapes.
    fn append_to(self, mut batch: ScanBatch, rows: &[Row], ids: Ids) -> Result<ScanBatch, StoreError> {
        let chunks: Result<Vec<_>, _> = rows.iter().map(Chunk::verified).collect();
        let mut chunks = chunks?;
        chunks.sort_by_key(|chunk| chunk.id);
        if let Some(&chunk) = missing(&self.chunks, &chunks) {
            return Err(StoreError::Corrupt { chunk });
        }
        match self.choice {
            Choice::AllBut(deleted) => batch.take_all_but(&chunks, &deleted)?,
            Choice::Only(chosen) => batch.take_only(&chunks, chosen, ids)?,
            Choice::Runs(runs) => batch.take_runs(&chunks, runs)?,
        }
        Ok(batch)
    }
}

/// First planned chunk that was not found.
fn missing<'a>(planned: &'a [i64], found: &[Chunk<'_>]) -> Option<&'a i64> {
    planned
        .iter()
        .enumerate()
        .find(|(i, id)| found.get(*i).is_none_or(|chunk| chunk.id != **id))
        .map(|(_, id)| id)
}

impl ScanBatch {
    fn empty(position: Cursor) -> Self {
        Self {
            position,
            ids: Vec::new(),
            external_ids: Vec::new(),
            labels: Vec::new(),
            places: Places::default(),
            weights: Vec::new(),
            control_points: Vec::new(),
        }
    }

    fn take(&mut self, chunk: &Chunk<'_>, rows: Range<usize>) -> Result<(), StoreError> {
        self.places.push(chunk.id, &rows);
        chunk.append_to(rows, &mut self.weights, &mut self.control_points)
    }

    /// Appends the runs between deleted shapes.
    fn take_all_but(&mut self, chunks: &[Chunk<'_>], mut deleted: &[Cursor]) -> Result<(), StoreError> {
        self.control_points.reserve(chunks.iter().map(Chunk::numbers).sum());
        for chunk in chunks {
            let gaps = take_gaps(&mut deleted, chunk.id);
            runs_between(gaps, chunk.rows()).try_for_each(|run| self.take(chunk, run))?;
        }
        Ok(())
    }

    /// Appends runs of rows.
    fn take_runs(&mut self, chunks: &[Chunk<'_>], runs: Vec<(i64, Range<usize>)>) -> Result<(), StoreError> {
        for (chunk, rows) in runs {
            let found = chunks.binary_search_by_key(&chunk, |found| found.id);
            let found = found.map_err(|_| StoreError::Corrupt { chunk })?;
            self.take(&chunks[found], rows)?;
        }
        Ok(())
    }

    fn take_only(
        &mut self,
        chunks: &[Chunk<'_>],
        chosen: Vec<(Cursor, Names)>,
        ids: Ids,
    ) -> Result<(), StoreError> {
        let mut chunks = chunks.iter();
        let mut current = chunks.next();
        for (place, names) in chosen {
            while current.is_some_and(|chunk| chunk.id < place.chunk) {
                current = chunks.next();
            }
            let corrupt = StoreError::Corrupt { chunk: place.chunk };
            let row = row_of(&place);
            self.take(current.ok_or(corrupt)?, row..row + 1)?;
            if ids == Ids::Include {
                self.ids.push(names.id);
                self.external_ids.push(names.external_id);
                self.labels.push(names.label);
            }
        }
        Ok(())
    }
}

/// Row within its chunk; never negative in the schema, and detected as damage if out of range.
fn row_of(place: &Cursor) -> usize {
    usize::try_from(place.position).unwrap_or_default()
}
