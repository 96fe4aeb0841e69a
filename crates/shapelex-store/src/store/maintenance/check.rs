//! Integrity check of a whole store, a few megabytes at a time, even while the service uses it: every part reads
//! a consistent snapshot.

use serde_json::Value;

use super::super::answer::Answer;
use super::super::blob::Chunk;
use super::super::cohorts::read_cohort;
use super::super::engine::from_sql;
use super::super::engine::{Row, Transaction, sql};
use super::super::error::StoreError;
use super::super::handle::{Store, blocking};
use super::super::{dictionaries, jobs, outputs};
use crate::domain::job::{JobOutput, OutputParts};

/// Maximum number of objects named per rule.
const MAX_NAMED: i64 = 100;
/// Number of chunks, and of small rows, read at once.
const CHUNKS: i64 = 4;
const ROWS: i64 = 512;

/// Numbers of objects checked, and of findings.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Checked {
    /// Cohorts, including those in the trash.
    pub cohorts: u64,
    /// Chunks of control points.
    pub chunks: u64,
    /// Shapes in them, including deleted ones.
    pub shapes: u64,
    /// Versions of dictionaries.
    pub dictionaries: u64,
    /// Jobs.
    pub jobs: u64,
    /// Outputs of jobs.
    pub outputs: u64,
    /// Receipts.
    pub receipts: u64,
    /// Entries of the audit trail.
    pub audit: u64,
    /// Findings.
    pub findings: u64,
}

/// Rules: a sentence about `{}`, and the statement that lists its violations.
const RULES: &[(&str, &str)] = &[
    (
        "shape {} belongs to no chunk",
        "SELECT s.id FROM shape AS s LEFT JOIN chunk AS c ON c.id = s.chunk_id WHERE c.id IS NULL",
    ),
    (
        "shape {} is recorded under another cohort than its chunk",
        "SELECT s.id FROM shape AS s JOIN chunk AS c ON c.id = s.chunk_id WHERE s.cohort <> c.cohort",
    ),
    (
        "shape {} was deleted by an impossible revision",
        "SELECT s.id FROM shape AS s JOIN chunk AS c ON c.id = s.chunk_id JOIN cohort AS h ON h.number = c.cohort
        WHERE s.deleted_revision < c.revision OR s.deleted_revision > h.revision
            OR (s.deleted_revision IS NOT NULL AND c.revision IS NULL)",
    ),
    (
        // Only erased shapes are deleted by the revision that added them. A subject marks those to be overwritten.
        "shape {} was erased, but is still described",
        "SELECT s.id FROM shape AS s JOIN chunk AS c ON c.id = s.chunk_id WHERE s.deleted_revision = c.revision
        AND (s.digest IS NOT NULL OR coalesce(s.external_id, s.label, s.labels, s.metadata) IS NOT NULL)",
    ),
    (
        "chunk {} belongs to a cohort that does not exist",
        "SELECT CAST(c.id AS TEXT) FROM chunk AS c LEFT JOIN cohort AS h ON h.number = c.cohort
        WHERE c.cohort IS NOT NULL AND h.number IS NULL",
    ),
    (
        "chunk {} has a revision that its cohort never had",
        "SELECT CAST(c.id AS TEXT) FROM chunk AS c JOIN cohort AS h ON h.number = c.cohort
        WHERE c.revision < 1 OR c.revision > h.revision",
    ),
    (
        "the points of chunk {} belong to no chunk",
        "SELECT CAST(d.chunk_id AS TEXT) FROM chunk_data AS d LEFT JOIN chunk AS c ON c.id = d.chunk_id
        WHERE c.id IS NULL",
    ),
    (
        "cohort {} does not have the number of shapes that it states",
        "SELECT h.id FROM cohort AS h WHERE h.shapes <>
            (SELECT coalesce(sum(c.rows), 0) FROM chunk AS c WHERE c.cohort = h.number AND c.revision IS NOT NULL)
            - (SELECT count(*) FROM shape AS s WHERE s.cohort = h.number AND s.deleted_revision IS NOT NULL)",
    ),
    (
        "cohort {} cannot be found by its name",
        "SELECT id FROM cohort
        WHERE handle <> CASE WHEN deleted_at_ms IS NULL THEN tenant || '/' || name ELSE id END",
    ),
    (
        "dictionary {} cannot be found by its name",
        "SELECT id FROM dictionary WHERE handle <> tenant || '/' || name",
    ),
    (
        "dictionary {} has a version that its name never had",
        "SELECT d.id FROM dictionary AS d LEFT JOIN dictionary_name AS n ON n.handle = d.handle
        WHERE n.handle IS NULL OR d.version < 1 OR d.version > n.versions",
    ),
    (
        "dictionary {} has no content",
        "SELECT d.id FROM dictionary AS d LEFT JOIN dictionary_data AS t ON t.dictionary = d.id
        WHERE t.dictionary IS NULL",
    ),
    (
        "the content of dictionary {} belongs to no dictionary",
        "SELECT t.dictionary FROM dictionary_data AS t LEFT JOIN dictionary AS d ON d.id = t.dictionary
        WHERE d.id IS NULL",
    ),
    (
        "alias {} names a version that does not exist, or one of another name",
        "SELECT a.handle || '@' || a.alias FROM dictionary_alias AS a
        LEFT JOIN dictionary AS d ON d.id = a.dictionary
        WHERE d.id IS NULL OR d.handle <> a.handle OR d.tenant <> a.tenant",
    ),
    (
        "an assessment is of the shape {}, which its cohort never had",
        "SELECT a.shape FROM assessment AS a
        LEFT JOIN (SELECT DISTINCT cohort, id FROM shape) AS s ON s.cohort = a.cohort AND s.id = a.shape
        WHERE s.id IS NULL",
    ),
    (
        "the output of job {} belongs to no job",
        "SELECT o.job FROM job_output AS o LEFT JOIN job AS j ON j.id = o.job WHERE j.id IS NULL",
    ),
    (
        "there are files of job {}, which has ended or does not exist",
        "SELECT DISTINCT f.job FROM job_file AS f LEFT JOIN job AS j ON j.id = f.job
        WHERE j.id IS NULL OR j.finished_at_ms IS NOT NULL",
    ),
    (
        "the feed of tenant {} has a gap, or does not end at its last number",
        "SELECT f.tenant FROM (SELECT tenant, count(*) AS n, min(sequence) AS first, max(sequence) AS last
            FROM change GROUP BY tenant) AS f
        LEFT JOIN change_sequence AS q ON q.tenant = f.tenant
        WHERE f.n <> f.last - f.first + 1 OR q.last IS NULL OR q.last <> f.last",
    ),
    (
        "the feed of tenant {} is empty, although numbers were assigned",
        "SELECT q.tenant FROM change_sequence AS q
        WHERE q.last > 0 AND NOT EXISTS (SELECT 1 FROM change AS c WHERE c.tenant = q.tenant)",
    ),
    (
        "hook {} has delivered changes that never happened",
        "SELECT h.id FROM hook AS h LEFT JOIN change_sequence AS q ON q.tenant = h.tenant
        WHERE h.position > coalesce(q.last, 0)",
    ),
];

impl Store {
    /// Checks everything, reports every finding in one sentence, and returns the numbers of objects checked.
    ///
    /// Unfinished uploads, and cohorts being removed, are not findings.
    ///
    /// # Errors
    /// Database errors, except damage, which is a finding.
    pub fn check<'a>(&'a self, report: &'a mut (dyn FnMut(&str) + Send)) -> Answer<'a, Checked> {
        Box::pin(async move {
            let mut check = Check { store: self, report, seen: Checked::default() };
            let file = check.file().await;
            check.settle(file)?;
            for (sentence, statement) in RULES {
                let rule = check.rule(sentence, statement).await;
                check.settle(rule)?;
            }
            let cohorts = check.cohorts().await;
            check.settle(cohorts)?;
            let chunks = check.chunks().await;
            check.settle(chunks)?;
            let shapes = check.shapes().await;
            check.settle(shapes)?;
            let dictionaries = check.dictionaries().await;
            check.settle(dictionaries)?;
            let jobs = check.jobs().await;
            check.settle(jobs)?;
            let outputs = check.outputs().await;
            check.settle(outputs)?;
            let files = check.files().await;
            check.settle(files)?;
            let receipts = check.receipts().await;
            check.settle(receipts)?;
            let audit = check.audit().await;
            check.settle(audit)?;
            Ok(check.seen)
        })
    }
}

struct Check<'a> {
    store: &'a Store,
    report: &'a mut (dyn FnMut(&str) + Send),
    seen: Checked,
}

impl Check<'_> {
    fn find(&mut self, finding: &str) {
        self.seen.findings += 1;
        (self.report)(finding);
    }

    /// Turns damage that stopped a part of the check into a finding.
    fn settle(&mut self, part: Result<(), StoreError>) -> Result<(), StoreError> {
        match part {
            Err(StoreError::Damaged { detail }) => self.find(&detail),
            Err(StoreError::Database(error @ sqlx::Error::ColumnDecode { .. })) => {
                self.find(&format!("a value cannot be read: {error}"));
            }
            other => return other,
        }
        Ok(())
    }

    /// Checks the file of the embedded database, page by page.
    async fn file(&mut self) -> Result<(), StoreError> {
        if !self.store.is_embedded() {
            return Ok(());
        }
        for row in sql(self.store.reader(), "PRAGMA integrity_check(100)").all().await? {
            let verdict: &str = row.get("integrity_check")?;
            if verdict != "ok" {
                self.find(verdict);
            }
        }
        Ok(())
    }

    async fn rule(&mut self, sentence: &str, statement: &'static str) -> Result<(), StoreError> {
        let mut query = sql(self.store.reader(), statement).persistent(false);
        query.push(" LIMIT ").push_bind(MAX_NAMED);
        for row in query.all().await? {
            let name: &str = row.at(0)?;
            self.find(&sentence.replace("{}", name));
        }
        Ok(())
    }

    async fn cohorts(&mut self) -> Result<(), StoreError> {
        const PAGE: &str = "SELECT * FROM cohort WHERE number > $1 ORDER BY number LIMIT $2";
        const OTHER_WIDTH: &str = "SELECT count(*) FROM chunk WHERE cohort = $1 AND width <> $2";
        let (mut read, mut last) = (self.store.begin_read().await?, 0_i64);
        loop {
            let rows = sql(&mut read, PAGE).bind(last).bind(ROWS).all().await?;
            let Some(end) = rows.last() else { return Ok(()) };
            last = end.get("number")?;
            for row in &rows {
                self.seen.cohorts += 1;
                let (id, number): (&str, i64) = (row.get("id")?, row.get("number")?);
                let width = match read_cohort(row) {
                    Ok(cohort) => cohort.spec.representation.size() * cohort.spec.representation.dimension(),
                    Err(error) => {
                        self.find(&unreadable(&format!("cohort {id}"), &error));
                        continue;
                    }
                };
                let others = sql(&mut read, OTHER_WIDTH).bind(number).bind(width as i64);
                if others.scalar::<i64>().await? > 0 {
                    self.find(&format!("cohort {id} has chunks of another representation"));
                }
            }
        }
    }

    async fn chunks(&mut self) -> Result<(), StoreError> {
        // A chunk without a cohort is about to be removed.
        const PAGE: &str = "SELECT c.id, c.rows, c.width, d.checksum, d.weights, d.points,
            (SELECT count(*) FROM shape AS s WHERE s.chunk_id = c.id) AS described,
            (SELECT coalesce(max(s.position), -1) FROM shape AS s WHERE s.chunk_id = c.id) AS last
            FROM chunk AS c LEFT JOIN chunk_data AS d ON d.chunk_id = c.id
            WHERE c.cohort IS NOT NULL AND c.id > $1 ORDER BY c.id LIMIT $2";
        let (mut read, mut last) = (self.store.begin_read().await?, 0_i64);
        loop {
            let rows = sql(&mut read, PAGE).bind(last).bind(CHUNKS).all().await?;
            let Some(end) = rows.last() else { return Ok(()) };
            last = end.get("id")?;
            self.seen.chunks += rows.len() as u64;
            let found = blocking(move || rows.iter().map(look_at_chunk).collect::<Result<Vec<_>, _>>());
            for (shapes, finding) in found.await? {
                self.seen.shapes += shapes;
                if let Some(finding) = finding {
                    self.find(&finding);
                }
            }
        }
    }

    /// Checks the JSON attributes of shapes.
    async fn shapes(&mut self) -> Result<(), StoreError> {
        const PAGE: &str = "SELECT chunk_id, position, id, labels, metadata FROM shape
            WHERE (chunk_id, position) > ($1, $2) AND (labels IS NOT NULL OR metadata IS NOT NULL)
            ORDER BY chunk_id, position LIMIT $3";
        let (mut read, mut last) = (self.store.begin_read().await?, (0_i64, -1_i64));
        loop {
            let rows = sql(&mut read, PAGE).bind(last.0).bind(last.1).bind(ROWS).all().await?;
            let Some(end) = rows.last() else { return Ok(()) };
            last = (end.get("chunk_id")?, end.get("position")?);
            for row in &rows {
                let (labels, metadata): (Option<&str>, Option<&str>) =
                    (row.get("labels")?, row.get("metadata")?);
                if [labels, metadata].into_iter().flatten().any(|text| !is_json(text)) {
                    let id: &str = row.get("id")?;
                    self.find(&format!("the attributes of shape {id} cannot be read"));
                }
            }
        }
    }

    async fn dictionaries(&mut self) -> Result<(), StoreError> {
        const NEXT: &str = "SELECT d.id, d.digest, t.content, t.state, t.state_checksum
            FROM dictionary AS d JOIN dictionary_data AS t ON t.dictionary = d.id
            WHERE d.id > $1 ORDER BY d.id LIMIT 1";
        let (mut read, mut last) = (self.store.begin_read().await?, String::new());
        while let Some(row) = sql(&mut read, NEXT).bind(&last).optional().await? {
            last = row.get("id")?;
            self.seen.dictionaries += 1;
            if let Some(part) = blocking(move || damaged_part(&row)).await? {
                self.find(&format!("the {part} of dictionary {last} does not match its checksum"));
            }
        }
        Ok(())
    }

    async fn jobs(&mut self) -> Result<(), StoreError> {
        const PAGE: &str = "SELECT * FROM job WHERE id > $1 ORDER BY id LIMIT $2";
        let (mut read, mut last) = (self.store.begin_read().await?, String::new());
        loop {
            let rows = sql(&mut read, PAGE).bind(&last).bind(CHUNKS).all().await?;
            let Some(end) = rows.last() else { return Ok(()) };
            last = end.get("id")?;
            for row in &rows {
                self.seen.jobs += 1;
                if let Err(error) = jobs::read_job(row) {
                    let id: &str = row.get("id")?;
                    self.find(&unreadable(&format!("job {id}"), &error));
                }
            }
        }
    }

    async fn outputs(&mut self) -> Result<(), StoreError> {
        const NEXT: &str = "SELECT number, job, bytes, checksum, head, data FROM job_output
            WHERE number > $1 ORDER BY number LIMIT 1";
        let (mut read, mut last) = (self.store.begin_read().await?, 0_i64);
        while let Some(row) = sql(&mut read, NEXT).bind(last).optional().await? {
            last = row.get("number")?;
            self.seen.outputs += 1;
            let job: String = row.get("job")?;
            let parts = output_parts(row.get("head")?);
            let mut is_whole = blocking(move || is_output_whole(&row)).await?;
            if let Some(parts) = parts.filter(|_| is_whole) {
                is_whole = are_parts_whole(&mut read, &job, parts).await?;
            }
            if !is_whole {
                self.find(&format!("the output of job {job} does not match its checksum"));
            }
        }
        Ok(())
    }

    /// Checks the files that jobs work on.
    async fn files(&mut self) -> Result<(), StoreError> {
        const NEXT: &str = "SELECT job, name, piece, checksum, data FROM job_file
            WHERE (job, name, piece) > ($1, $2, $3) ORDER BY job, name, piece LIMIT 1";
        let (mut read, mut last) = (self.store.begin_read().await?, (String::new(), String::new(), 0_i64));
        let next = async |read: &mut Transaction, last: &(String, String, i64)| {
            sql(read, NEXT).bind(&last.0).bind(&last.1).bind(last.2).optional().await
        };
        while let Some(row) = next(&mut read, &last).await? {
            last = (row.get("job")?, row.get("name")?, row.get("piece")?);
            if blocking(move || outputs::whole_part(&row)).await?.is_none() {
                self.find(&format!("a file of job {} does not match its checksum", last.0));
            }
        }
        Ok(())
    }

    async fn receipts(&mut self) -> Result<(), StoreError> {
        const PAGE: &str = "SELECT tenant, key, fingerprint, outcome FROM receipt
            WHERE (tenant, key) > ($1, $2) ORDER BY tenant, key LIMIT $3";
        let (mut read, mut last) = (self.store.begin_read().await?, (String::new(), String::new()));
        loop {
            let rows = sql(&mut read, PAGE).bind(&last.0).bind(&last.1).bind(CHUNKS).all().await?;
            let Some(end) = rows.last() else { return Ok(()) };
            last = (end.get("tenant")?, end.get("key")?);
            for row in &rows {
                self.seen.receipts += 1;
                let (fingerprint, outcome): (&[u8], &str) = (row.get("fingerprint")?, row.get("outcome")?);
                if fingerprint.len() != blake3::OUT_LEN || !is_json(outcome) {
                    let tenant: &str = row.get("tenant")?;
                    self.find(&format!("a receipt of tenant {tenant} cannot be read"));
                }
            }
        }
    }

    async fn audit(&mut self) -> Result<(), StoreError> {
        let found = match self.store.check_audit().await {
            // Entries may have expired in the meantime; a broken link is found again.
            Err(StoreError::Damaged { .. }) => self.store.check_audit().await,
            found => found,
        };
        self.seen.audit = found?.entries;
        Ok(())
    }
}

/// Number of shapes in a chunk, and its fault, if any.
fn look_at_chunk(row: &Row) -> Result<(u64, Option<String>), StoreError> {
    let (id, rows): (i64, i64) = (row.get("id")?, row.get("rows")?);
    let (described, last): (i64, i64) = (row.get("described")?, row.get("last")?);
    let finding = if row.get::<Option<&[u8]>>("points")?.is_none() {
        Some(format!("chunk {id} has no points"))
    } else if (described, last) != (rows, rows - 1) {
        Some(format!("chunk {id} has {rows} shapes, but descriptions of {described}"))
    } else if Chunk::verified(row).is_err() {
        Some(format!("the points of chunk {id} do not match their checksum"))
    } else {
        None
    };
    Ok((from_sql(rows), finding))
}

/// Part of a dictionary that does not match its checksum.
fn damaged_part(row: &Row) -> Result<Option<&'static str>, StoreError> {
    let (content, digest): (&[u8], &str) = (row.get("content")?, row.get("digest")?);
    let (state, checksum): (Option<&[u8]>, Option<&[u8]>) = (row.get("state")?, row.get("state_checksum")?);
    if blake3::hash(content).to_hex().as_str() != digest {
        return Ok(Some("content"));
    }
    let is_whole = state.map(dictionaries::checksum_of).as_deref() == checksum;
    Ok((!is_whole).then_some("state"))
}

/// Parts that the head of an output describes.
fn output_parts(head: &str) -> Option<OutputParts> {
    JobOutput::parts_in(&serde_json::from_str(head).ok()?)
}

/// Whether all parts of an output are there, with their checksums and their total size.
async fn are_parts_whole(read: &mut Transaction, job: &str, parts: OutputParts) -> Result<bool, StoreError> {
    let mut bytes = 0;
    for part in 0..parts.count {
        let row = outputs::select_part(&mut *read, job, parts.attempt, part).optional().await?;
        let Some(row) = row else { return Ok(false) };
        let Some(data) = blocking(move || outputs::whole_part(&row)).await? else { return Ok(false) };
        bytes += data.len() as u64;
    }
    Ok(bytes == parts.bytes)
}

fn is_output_whole(row: &Row) -> Result<bool, StoreError> {
    let (checksum, head, data): (&[u8], &str, &[u8]) =
        (row.get("checksum")?, row.get("head")?, row.get("data")?);
    let bytes: i64 = row.get("bytes")?;
    let in_parts = output_parts(head).map_or(0, |parts| parts.bytes);
    Ok(from_sql(bytes) == data.len() as u64 + in_parts
        && is_json(head)
        && outputs::checksum_of(head, data).as_slice() == checksum)
}

fn is_json(text: &str) -> bool {
    serde_json::from_str::<Value>(text).is_ok()
}

fn unreadable(what: &str, error: &StoreError) -> String {
    match error {
        StoreError::Damaged { detail } => format!("{what} cannot be read: {detail}"),
        error => format!("{what} cannot be read: {error}"),
    }
}
