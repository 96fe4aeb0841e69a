//! Erasure: everything that is kept of the shapes of a subject, in all cohorts of a tenant and at all revisions.
//!
//! For each cohort a transaction hides the rows at every revision (they are deleted by the revision that added them), empties
//! their columns and removes findings of jobs about them. The subject stays in the rows until the control points in the
//! chunks are overwritten, in further transactions: a crash in between leaves a mark from which [`Store::finish_erasures`] goes
//! on. Receipts lose their facts about the shapes. In the end the files are written anew (`erasures`).

use std::collections::{BTreeMap, BTreeSet, HashMap};

use serde_json::Value;

use super::answer::Answer;
use super::assessments;
use super::blob::{self, ROWS_PER_CHUNK};
use super::changes;
use super::engine::{Query, Row, Transaction, sql};
use super::engine::{from_sql, to_sql};
use super::erasures;
use super::error::StoreError;
use super::filter::{Revisions, Selection};
use super::handle::{CHUNKS_PER_PURGE, PURGE_ORPHANS, Store, blocking};
use super::order::Cursor;
use super::receipts::{self, Forgotten};
use super::text::from_text;
use crate::domain::change::{ChangeKind, MAX_NAMED, NewChange};
use crate::domain::dictionary::Provenance;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::{JobKind, JobStatus};

/// A place is one number: the chunk times this, plus the row.
const PLACES: i64 = 1 << 20;
const _: () = assert!(ROWS_PER_CHUNK <= PLACES as usize);

/// A cohort with shapes of a subject.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SubjectCohort {
    /// Id of the cohort.
    pub id: String,
    /// Its name.
    pub name: String,
    /// Its revision.
    pub revision: u64,
    /// Whether it is in the trash.
    pub trashed: bool,
    /// Number of shapes of the subject, those included that are deleted.
    pub shapes: u64,
    /// Versions of dictionaries that were learnt from some of them, those included that are in the trash.
    pub dictionaries: Vec<SubjectDictionary>,
    /// Jobs that may name some of them.
    pub jobs: Vec<SubjectJob>,
    /// Versions that have been looked at.
    examined: BTreeSet<String>,
}

/// A version of a dictionary that was learnt from shapes of a subject.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SubjectDictionary {
    /// Id of the version.
    pub id: String,
    /// Name of the dictionary.
    pub name: String,
    /// Version number.
    pub version: u64,
    /// BLAKE3 digest of its content.
    pub digest: String,
    /// Whether it is in the trash.
    pub trashed: bool,
}

/// A job that may name shapes of a subject.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SubjectJob {
    /// Id of the job.
    pub id: String,
    /// Kind of work.
    pub kind: JobKind,
    /// Whether it is removed, with its result and its output; otherwise it runs again from its beginning.
    pub removed: bool,
}

/// A stored row of a shape of the subject.
#[derive(Debug)]
struct Held {
    place: Cursor,
    id: String,
    external_id: Option<String>,
    is_living: bool,
    stored_ms: i64,
}

impl Held {
    fn place(&self) -> i64 {
        self.place.chunk * PLACES + self.place.position
    }
}

impl Store {
    /// Cohorts of the tenant, those in the trash included, that have shapes of the subject, in id order.
    ///
    /// # Errors
    /// [`StoreError::Damaged`].
    pub fn find_subject<'a>(&'a self, subject: &'a str) -> Answer<'a, Vec<SubjectCohort>> {
        Box::pin(async move {
            const COHORTS: &str = "SELECT DISTINCT h.number, h.id, h.name, h.revision, h.deleted_at_ms
                FROM cohort AS h CROSS JOIN shape AS s ON s.cohort = h.number AND s.subject = $2
                WHERE h.tenant = $1 ORDER BY h.id";
            let mut read = self.begin_read().await?;
            let mut found = Vec::new();
            for row in sql(&mut read, COHORTS).bind(self.tenant()).bind(subject).all().await? {
                let number: i64 = row.get("number")?;
                let rows = held(&mut read, number, subject).await?;
                if rows.is_empty() || !self.principal.may_use(row.get("id")?) {
                    continue;
                }
                let mut cohort = SubjectCohort {
                    id: row.get("id")?,
                    name: row.get("name")?,
                    revision: from_sql(row.get("revision")?),
                    trashed: row.get::<Option<i64>>("deleted_at_ms")?.is_some(),
                    shapes: shapes_of(&rows),
                    dictionaries: Vec::new(),
                    jobs: self.jobs_about(&mut read, row.get("id")?, subject, (rows.as_slice(), "")).await?,
                    examined: BTreeSet::new(),
                };
                self.examine_dictionaries(&mut read, &mut cohort, number, &rows).await?;
                found.push(cohort);
            }
            Ok(found)
        })
    }

    /// Erases the shapes of the subject in a cohort, except their control points, which [`Store::finish_erasures`] overwrites.
    /// Returns the cohort after that, with the shapes that were erased; `None` if there are none any more.
    ///
    /// # Errors
    /// [`StoreError::Damaged`].
    pub fn erase_subject<'a>(
        &'a self,
        mut cohort: SubjectCohort,
        subject: &'a str,
        now_ms: i64,
    ) -> Answer<'a, Option<SubjectCohort>> {
        Box::pin(async move {
            const NUMBER: &str = "SELECT number, deleted_at_ms FROM cohort WHERE id = $1 AND tenant = $2";
            const GROW: &str =
                "UPDATE cohort SET revision = revision + 1, shapes = shapes - $2, updated_at_ms = $3
                WHERE number = $1 RETURNING revision";
            let mut write = self.begin_write(&cohort.id).await?;
            let found = sql(&mut write, NUMBER).bind(&cohort.id).bind(self.tenant()).optional().await?;
            let Some(found) = found else { return Ok(None) };
            let number: i64 = found.get("number")?;
            let rows = held(&mut write, number, subject).await?;
            if rows.is_empty() {
                return Ok(None);
            }
            // Versions that were learnt since the cohort was looked at.
            self.examine_dictionaries(&mut write, &mut cohort, number, &rows).await?;
            // A job that ends at this moment does so before, or finds that it has lost its claim.
            let lock = if write.is_postgres() { " FOR UPDATE" } else { "" };
            cohort.jobs = self.jobs_about(&mut write, &cohort.id, subject, (rows.as_slice(), lock)).await?;
            end_jobs(&mut write, &cohort.jobs).await?;
            empty(&mut write, subject, &rows).await?;
            assessments::forget(&mut write, number, rows.iter().map(|row| row.id.as_str())).await?;
            receipts::forget(&mut write, self.tenant(), &forgotten(&rows, subject)).await?;
            erasures::record(&mut write, self.tenant(), subject, now_ms).await?;
            let living = rows.iter().filter(|row| row.is_living).count() as u64;
            let revision: i64 =
                sql(&mut write, GROW).bind(number).bind(to_sql(living)).bind(now_ms).scalar().await?;
            cohort.revision = from_sql(revision);
            cohort.shapes = shapes_of(&rows);
            cohort.trashed = found.get::<Option<i64>>("deleted_at_ms")?.is_some();
            if !cohort.trashed {
                self.announce(&mut write, &cohort, &rows, now_ms).await?;
            }
            write.commit().await?;
            Ok(Some(cohort))
        })
    }

    /// Records the change of a cohort, in parts that name the shapes.
    async fn announce(
        &self,
        write: &mut Transaction,
        cohort: &SubjectCohort,
        rows: &[Held],
        now_ms: i64,
    ) -> Result<(), StoreError> {
        let ids: Vec<&str> = ids_of(rows).into_iter().collect();
        for ids in ids.chunks(MAX_NAMED) {
            let change = NewChange {
                shapes: Some(ids.len() as u64),
                shape_ids: Some(ids),
                ..NewChange::for_cohort(ChangeKind::SubjectErased, &cohort.id, cohort.revision)
            };
            changes::record(write, self.tenant(), &change, now_ms).await?;
        }
        Ok(())
    }

    /// Overwrites the control points and weights of the erased shapes of a subject of the tenant, or of all; returns their number.
    ///
    /// # Errors
    /// Database errors; the rest is overwritten by the next call.
    pub fn finish_erasures<'a>(&'a self, subject: Option<&'a str>, now_ms: i64) -> Answer<'a, u64> {
        Box::pin(async move {
            const MARKED: &str = "SELECT DISTINCT h.id, s.cohort, s.subject
                FROM cohort AS h CROSS JOIN shape AS s ON s.cohort = h.number
                CROSS JOIN chunk AS c ON c.id = s.chunk_id
                WHERE s.deleted_revision IS NOT NULL AND s.deleted_revision = c.revision
                AND coalesce(s.subject, '') <> ''";
            // Chunks that a permanently removed cohort has left may be of the subject too.
            self.purge(PURGE_ORPHANS, None).await?;
            let mut marked = sql(self.reader(), MARKED);
            if let Some(subject) = subject {
                marked.push(" AND s.subject = ").push_bind(subject);
                marked.push(" AND h.tenant = ").push_bind(self.tenant());
            }
            let mut count = 0;
            for row in marked.all().await? {
                let (id, number, subject): (&str, i64, &str) =
                    (row.get("id")?, row.get("cohort")?, row.get("subject")?);
                count += self.overwrite(id, number, subject).await?;
            }
            self.note_overwritten(subject, now_ms).await?;
            Ok(count)
        })
    }

    /// Overwrites the erased shapes of a subject in a cohort, some chunks at a time.
    async fn overwrite(&self, cohort: &str, number: i64, subject: &str) -> Result<u64, StoreError> {
        const MARKED: &str = "SELECT s.chunk_id, s.position
            FROM shape AS s CROSS JOIN chunk AS c ON c.id = s.chunk_id
            WHERE s.cohort = $1 AND s.subject = $2 AND s.deleted_revision = c.revision
            ORDER BY s.chunk_id, s.position LIMIT $3";
        const MOST: i64 = CHUNKS_PER_PURGE * ROWS_PER_CHUNK as i64;
        let mut count = 0;
        loop {
            // Two erasures may concern the same chunk.
            let mut write = self.begin_write(cohort).await?;
            let rows = sql(&mut write, MARKED).bind(number).bind(subject).bind(MOST).all().await?;
            let mut chunks: BTreeMap<i64, Vec<i64>> = BTreeMap::new();
            for row in &rows {
                chunks.entry(row.get("chunk_id")?).or_default().push(row.get("position")?);
            }
            if chunks.is_empty() {
                return Ok(count);
            }
            for (chunk, positions) in chunks.into_iter().take(CHUNKS_PER_PURGE as usize) {
                count += positions.len() as u64;
                overwrite_in_chunk(&mut write, chunk, positions).await?;
            }
            write.commit().await?;
        }
    }

    /// Adds the versions that were learnt from some of the rows, of those that have not been looked at.
    async fn examine_dictionaries(
        &self,
        read: &mut Transaction,
        cohort: &mut SubjectCohort,
        number: i64,
        rows: &[Held],
    ) -> Result<(), StoreError> {
        const LEARNT: &str = "SELECT id, name, version, digest, provenance, deleted_at_ms FROM dictionary
            WHERE tenant = $1 AND cohort = $2 ORDER BY id";
        let mut known: HashMap<(u64, ShapeFilter), bool> = HashMap::new();
        for row in sql(&mut *read, LEARNT).bind(self.tenant()).bind(&cohort.id).all().await? {
            let id: String = row.get("id")?;
            if !cohort.examined.insert(id.clone()) {
                continue;
            }
            let Provenance { cohort_revision, filter, .. } = from_text(row.get("provenance")?)?;
            let key = (cohort_revision, filter);
            let learnt = match known.get(&key) {
                Some(learnt) => *learnt,
                None => selects_any(&mut *read, number, &key, rows).await?,
            };
            known.insert(key, learnt);
            if learnt {
                cohort.dictionaries.push(SubjectDictionary {
                    id,
                    name: row.get("name")?,
                    version: from_sql(row.get("version")?),
                    digest: row.get("digest")?,
                    trashed: row.get::<Option<i64>>("deleted_at_ms")?.is_some(),
                });
            }
        }
        Ok(())
    }

    /// Jobs on the cohort that may name some of the rows: those that have ended since the first of them was stored, and others
    /// whose parameters do. Running ones are listed too, because they have read some of the rows. Their rows are read with a
    /// `lock`.
    async fn jobs_about(
        &self,
        read: &mut Transaction,
        cohort: &str,
        subject: &str,
        (rows, lock): (&[Held], &str),
    ) -> Result<Vec<SubjectJob>, StoreError> {
        const SINCE: &str = "SELECT id, kind, status, parameters FROM job
            WHERE tenant = $1 AND cohort = $2 AND created_at_ms >= $3 ORDER BY id";
        let first = rows.iter().map(|row| row.stored_ms).min().unwrap_or(i64::MAX);
        let names = rows.iter().flat_map(|row| [Some(row.id.as_str()), row.external_id.as_deref()]);
        let names: BTreeSet<&str> = names.flatten().chain([subject]).collect();
        let mut found = Vec::new();
        let mut since = sql(read, SINCE).bind(self.tenant()).bind(cohort).bind(first);
        since.push(lock);
        for row in since.all().await? {
            let status: JobStatus = from_text(row.get("status")?)?;
            let removed = status.is_finished() || has_text(&from_text(row.get("parameters")?)?, &names);
            if removed || status == JobStatus::Running {
                found.push(SubjectJob { id: row.get("id")?, kind: from_text(row.get("kind")?)?, removed });
            }
        }
        Ok(found)
    }
}

/// Rows of the shapes of a subject that are not erased yet, in storage order: all rows of shapes that belong to the subject
/// now, or when they were deleted, and earlier rows of other shapes that named the subject before a correction.
async fn held(read: &mut Transaction, cohort: i64, subject: &str) -> Result<Vec<Held>, StoreError> {
    const NAMED: &str = "SELECT DISTINCT s.id FROM shape AS s CROSS JOIN chunk AS c ON c.id = s.chunk_id
        WHERE s.cohort = $1 AND s.subject = $2 AND c.revision IS NOT NULL
        AND (s.deleted_revision IS NULL OR s.deleted_revision > c.revision)";
    const ROWS: &str = "SELECT s.chunk_id, s.position, s.id, s.external_id, s.subject, s.deleted_revision,
        coalesce(s.first_stored_ms, c.created_at_ms) AS stored_ms
        FROM shape AS s CROSS JOIN chunk AS c ON c.id = s.chunk_id
        WHERE c.revision IS NOT NULL AND s.cohort = $1";
    let named = sql(&mut *read, NAMED).bind(cohort).bind(subject).all().await?;
    let ids = named.iter().map(|row| row.get("id")).collect::<Result<Vec<&str>, _>>()?;
    let mut rows = Vec::new();
    // Ids have an index among living rows, deleted rows one without ids.
    for condition in ["s.deleted_revision IS NULL", "s.deleted_revision > c.revision"] {
        let mut query = sql(&mut *read, ROWS).bind(cohort);
        query.push(" AND ").push(condition).push(" AND s.id IN ").push_texts(ids.iter().copied());
        rows.extend(query.all().await?);
    }
    let mut last: HashMap<&str, (i64, bool)> = HashMap::new();
    for row in &rows {
        let found = (row.get("chunk_id")?, is_of(row, subject)?);
        let known = last.entry(row.get("id")?).or_insert(found);
        *known = found.max(*known);
    }
    let mut kept = Vec::new();
    for row in &rows {
        if is_of(row, subject)? || last.get(row.get::<&str>("id")?).is_some_and(|(_, is_last)| *is_last) {
            kept.push(read_held(row)?);
        }
    }
    kept.sort_by_key(|row| row.place);
    Ok(kept)
}

fn is_of(row: &Row, subject: &str) -> Result<bool, StoreError> {
    Ok(row.get::<Option<&str>>("subject")? == Some(subject))
}

fn read_held(row: &Row) -> Result<Held, StoreError> {
    Ok(Held {
        place: Cursor { chunk: row.get("chunk_id")?, position: row.get("position")? },
        id: row.get("id")?,
        external_id: row.get("external_id")?,
        is_living: row.get::<Option<i64>>("deleted_revision")?.is_none(),
        stored_ms: row.get("stored_ms")?,
    })
}

/// Ids of the shapes that the rows belong to.
fn ids_of(rows: &[Held]) -> BTreeSet<&str> {
    rows.iter().map(|row| row.id.as_str()).collect()
}

/// Number of shapes that the rows belong to.
fn shapes_of(rows: &[Held]) -> u64 {
    ids_of(rows).len() as u64
}

/// Facts that receipts must forget.
fn forgotten<'a>(rows: &'a [Held], subject: &'a str) -> Forgotten<'a> {
    let mut added: BTreeMap<i64, BTreeSet<&str>> = BTreeMap::new();
    for row in rows {
        added.entry(row.stored_ms).or_default().insert(&row.id);
    }
    let names = rows.iter().filter_map(|row| row.external_id.as_deref()).chain([subject]).collect();
    Forgotten { ids: ids_of(rows), names, added }
}

/// Appends the condition that a row of `table` is one of these.
fn push_places(query: &mut Query<'_>, table: &str, rows: &[Held]) {
    let chunks: BTreeSet<i64> = rows.iter().map(|row| row.place.chunk).collect();
    query.push(table).push("chunk_id IN ").push_numbers(chunks.into_iter());
    query.push(" AND ").push(table).push("chunk_id * 1048576 + ").push(table).push("position IN ");
    query.push_numbers(rows.iter().map(Held::place));
}

/// Whether some of the rows pass a filter at a revision.
async fn selects_any(
    read: &mut Transaction,
    cohort: i64,
    (revision, filter): &(u64, ShapeFilter),
    rows: &[Held],
) -> Result<bool, StoreError> {
    let selection = Selection { cohort, revisions: Revisions::until(*revision), filter, after: (0, -1) };
    let mut query = selection.select(read, "count(*)");
    query.push(" AND ");
    push_places(&mut query, "s.", rows);
    Ok(query.scalar::<i64>().await? > 0)
}

/// Hides the rows at every revision and empties their columns, except the subject, which marks them.
async fn empty(write: &mut Transaction, subject: &str, rows: &[Held]) -> Result<(), StoreError> {
    const EMPTY: &str = "UPDATE shape SET
        deleted_revision = (SELECT revision FROM chunk WHERE chunk.id = shape.chunk_id),
        external_id = NULL, label = NULL, labels = NULL, metadata = NULL, digest = NULL,
        first_stored_ms = NULL, points = NULL, centroid_size = NULL, length = NULL, area = NULL,
        volume = NULL, self_intersecting = NULL, clockwise = NULL, fit_mean = NULL, fit_largest = NULL,
        fit_area = NULL, given_start = NULL, given_reversed = NULL, subject = ";
    let mut query = sql(write, EMPTY);
    query.push_bind(subject).push(" WHERE ");
    push_places(&mut query, "", rows);
    query.execute().await?;
    Ok(())
}

/// Overwrites shapes of a chunk and removes the mark of their rows.
async fn overwrite_in_chunk(
    write: &mut Transaction,
    chunk: i64,
    positions: Vec<i64>,
) -> Result<(), StoreError> {
    const WRITE: &str = "UPDATE chunk_data SET checksum = $2, weights = $3, points = $4 WHERE chunk_id = $1";
    const UNMARK: &str = "UPDATE shape SET subject = NULL WHERE chunk_id = $1 AND position IN ";
    let mut unmark = sql(&mut *write, UNMARK).bind(chunk);
    unmark.push_numbers(positions.iter().copied());
    unmark.execute().await?;
    // A chunk without points is damaged, and has nothing to overwrite.
    let Some(row) = blob::load(&mut *write, &[chunk]).await?.pop() else { return Ok(()) };
    let data = blocking(move || blob::without(&row, &positions)).await?;
    sql(write, WRITE)
        .bind(chunk)
        .bind(data.checksum)
        .bind(data.weights.as_deref())
        .bind(data.points)
        .execute()
        .await?;
    Ok(())
}

/// Removes jobs, and returns running ones to the queue: their claims no longer hold.
async fn end_jobs(write: &mut Transaction, jobs: &[SubjectJob]) -> Result<(), StoreError> {
    const REMOVE: &str = "DELETE FROM job WHERE id IN ";
    const UNWRITE: &str = "DELETE FROM job_output_part WHERE job IN ";
    const AGAIN: &str = "UPDATE job SET status = 'queued', lease_owner = NULL, lease_until_ms = NULL,
        attempt = attempt - 1, started_at_ms = NULL, progress = 0, phase = NULL, objective = NULL
        WHERE status = 'running' AND id IN ";
    let (removed, returned): (Vec<_>, Vec<_>) = jobs.iter().partition(|job| job.removed);
    for (statement, concerned) in [(UNWRITE, &returned), (REMOVE, &removed), (AGAIN, &returned)] {
        let mut query = sql(&mut *write, statement);
        query.push_texts(concerned.iter().map(|job| job.id.as_str()));
        query.execute().await?;
    }
    Ok(())
}

/// Whether a text in the value is one of `names`.
fn has_text(value: &Value, names: &BTreeSet<&str>) -> bool {
    match value {
        Value::String(text) => names.contains(text.as_str()),
        Value::Array(items) => items.iter().any(|item| has_text(item, names)),
        Value::Object(members) => {
            members.iter().any(|(name, value)| names.contains(name.as_str()) || has_text(value, names))
        }
        _ => false,
    }
}
