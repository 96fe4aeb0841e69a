//! Assessments of stored shapes: results of a version of a dictionary.
//!
//! There is one for each shape and version, the latest. Those of a shape that is deleted are kept and not listed; they go when
//! its subject is erased, and with the cohort and the dictionary.

use super::answer::Answer;
use super::engine::{Row, Transaction, from_sql, rows_of_inserts, sql, to_sql};
use super::error::StoreError;
use super::filter::push_filter;
use super::handle::Store;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::Job;

/// Shapes that are assessed together.
#[derive(Debug, Clone, Copy)]
pub struct AssessmentRun<'a> {
    /// Id of the cohort.
    pub cohort: &'a str,
    /// Id of the version of the dictionary.
    pub dictionary: &'a str,
    /// Revision of the cohort.
    pub revision: u64,
    /// The job that assesses them, as it was claimed.
    pub job: Option<&'a Job>,
}

/// An assessment to be stored.
#[derive(Debug, Clone, PartialEq)]
pub struct NewAssessment {
    /// Id of the shape.
    pub shape: String,
    /// The class that was accepted.
    pub class: Option<String>,
    /// Whether the shape is an outlier.
    pub is_outlier: bool,
    /// The assessment as JSON.
    pub body: String,
}

/// A stored assessment of a shape.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredAssessment {
    /// Id of the shape.
    pub shape: String,
    /// Identifier of the shape assigned by the client.
    pub external_id: Option<String>,
    /// Id of the version of the dictionary.
    pub dictionary: String,
    /// Revision of the cohort.
    pub revision: u64,
    /// Time of the assessment, milliseconds since 1970 UTC.
    pub at_ms: i64,
    /// The assessment as JSON.
    pub body: String,
}

/// Selection of a list of assessments, in the order of the ids of dictionaries and shapes.
#[derive(Debug, Clone)]
pub struct AssessmentListing<'a> {
    /// Filter that the shapes pass.
    pub filter: &'a ShapeFilter,
    /// Id of the version of the dictionary; `None` for all.
    pub dictionary: Option<&'a str>,
    /// Accepted class; `None` for all.
    pub class: Option<&'a str>,
    /// Whether the shapes are outliers; `None` for all.
    pub is_outlier: Option<bool>,
    /// Ids of the dictionary and the shape before the first assessment.
    pub after: Option<(&'a str, &'a str)>,
    /// Maximum number of assessments.
    pub limit: usize,
}

impl Store {
    /// Stores assessments of shapes that still live, and returns their number; `None` if the dictionary has gone, or if the job
    /// has lost its claim.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`].
    pub fn store_assessments<'a>(
        &'a self,
        run: &'a AssessmentRun<'a>,
        assessments: &'a [NewAssessment],
        now_ms: i64,
    ) -> Answer<'a, Option<u64>> {
        Box::pin(async move {
            // Locked until the end of the transaction, so that the version is not removed within it.
            const DICTIONARY: &str = "SELECT id FROM dictionary WHERE id = $1 AND tenant = $2";
            let mut write = self.begin_write(run.cohort).await?;
            let cohort = self.number(&mut write, run.cohort).await?;
            let lock = if write.is_postgres() { " FOR SHARE" } else { "" };
            let mut dictionary = sql(&mut write, DICTIONARY).bind(run.dictionary).bind(self.tenant());
            dictionary.push(lock);
            if dictionary.optional_scalar::<String>().await?.is_none() {
                return Ok(None);
            }
            if let Some(job) = run.job
                && !self.holds(&mut write, job).await?
            {
                return Ok(None);
            }
            let mut count = 0;
            for rows in rows_of_inserts(assessments) {
                count += insert(&mut write, cohort, run, rows, now_ms).await?;
            }
            write.commit().await?;
            Ok(Some(count))
        })
    }

    /// A page of assessments of shapes that live.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`].
    pub fn list_assessments<'a>(
        &'a self,
        cohort_id: &'a str,
        listing: &'a AssessmentListing<'a>,
    ) -> Answer<'a, Vec<StoredAssessment>> {
        Box::pin(async move {
            const LIST: &str =
                "SELECT a.shape, s.external_id, a.dictionary, a.revision, a.assessed_at_ms, a.body
                FROM assessment AS a CROSS JOIN shape AS s ON s.id = a.shape AND s.deleted_revision IS NULL
                CROSS JOIN chunk AS c ON c.id = s.chunk_id WHERE c.revision IS NOT NULL AND a.cohort = ";
            let mut read = self.begin_read().await?;
            let cohort = self.number(&mut read, cohort_id).await?;
            let mut query = sql(&mut read, LIST).persistent(false);
            query.push_bind(cohort);
            if let Some(dictionary) = listing.dictionary {
                query.push(" AND a.dictionary = ").push_bind(dictionary);
            }
            if let Some(class) = listing.class {
                query.push(" AND a.class = ").push_bind(class);
            }
            if let Some(is_outlier) = listing.is_outlier {
                query.push(" AND a.is_outlier = ").push_bind(i64::from(is_outlier));
            }
            if let Some((dictionary, shape)) = listing.after {
                query.push(" AND (a.dictionary, a.shape) > (").push_bind(dictionary);
                query.push(", ").push_bind(shape).push(")");
            }
            push_filter(&mut query, listing.filter);
            query.push(" ORDER BY a.dictionary, a.shape LIMIT ").push_bind(to_sql(listing.limit as u64));
            let read = |row: &Row| {
                Ok(StoredAssessment {
                    shape: row.get("shape")?,
                    external_id: row.get("external_id")?,
                    dictionary: row.get("dictionary")?,
                    revision: from_sql(row.get("revision")?),
                    at_ms: row.get("assessed_at_ms")?,
                    body: row.get("body")?,
                })
            };
            query.all().await?.iter().map(read).collect()
        })
    }
}

/// Inserts the assessments of shapes that live, each in place of the one before; returns their number.
async fn insert(
    write: &mut Transaction,
    cohort: i64,
    run: &AssessmentRun<'_>,
    rows: &[NewAssessment],
    now_ms: i64,
) -> Result<u64, StoreError> {
    const INSERT: &str = ") INSERT INTO assessment
        (shape, class, is_outlier, body, cohort, dictionary, revision, assessed_at_ms)
        SELECT n.shape, n.class, n.is_outlier, n.body, ";
    const LIVING: &str = " FROM new AS n CROSS JOIN shape AS s ON s.id = n.shape
        WHERE s.deleted_revision IS NULL AND s.cohort = ";
    const REPLACE: &str = " ON CONFLICT (cohort, dictionary, shape) DO UPDATE SET
        revision = excluded.revision, assessed_at_ms = excluded.assessed_at_ms,
        class = excluded.class, is_outlier = excluded.is_outlier, body = excluded.body";
    let mut query = sql(write, "WITH new (shape, class, is_outlier, body) AS (VALUES ");
    for (i, NewAssessment { shape, class, is_outlier, body }) in rows.iter().enumerate() {
        query.push(if i == 0 { "(" } else { ", (" }).push_bind(shape.as_str());
        query.push(", ").push_bind(class.as_deref()).push(", ").push_bind(i64::from(*is_outlier));
        query.push(", ").push_bind(body.as_str()).push(")");
    }
    query.push(INSERT).push_bind(cohort).push(", ").push_bind(run.dictionary);
    query.push(", ").push_bind(to_sql(run.revision)).push(", ").push_bind(now_ms);
    query.push(LIVING).push_bind(cohort).push(REPLACE);
    Ok(query.execute().await?)
}

/// Removes the assessments of shapes of a cohort.
pub(super) async fn forget<'t>(
    write: &mut Transaction,
    cohort: i64,
    shapes: impl Iterator<Item = &'t str>,
) -> Result<(), StoreError> {
    let mut query = sql(write, "DELETE FROM assessment WHERE cohort = ");
    query.push_bind(cohort).push(" AND shape IN ").push_texts(shapes);
    query.execute().await?;
    Ok(())
}
