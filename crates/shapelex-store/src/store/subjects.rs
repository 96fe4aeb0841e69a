//! Holdings of a subject.

use super::answer::Answer;
use super::engine::{Query, from_sql, sql, to_sql};
use super::handle::Store;

/// Subjects read at once.
const PAGE: i64 = 1000;

/// A cohort that holds shapes of a subject.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Holding {
    /// Id of the cohort.
    pub id: String,
    /// Its name.
    pub name: String,
    /// Its revision.
    pub revision: u64,
    /// Number of shapes, those included that only earlier revisions show as the subject's.
    pub shapes: u64,
    /// Whether the cohort is in the trash.
    pub trashed: bool,
}

/// A shape of a subject.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HeldShape {
    /// Id of the shape.
    pub id: String,
    /// Identifier assigned by the client.
    pub external_id: Option<String>,
    /// Id of its cohort.
    pub cohort: String,
    /// Whether the cohort shows it as the subject's now: it was not deleted, nor given to another subject.
    pub is_current: bool,
}

impl Store {
    /// Cohorts of the tenant, those in the trash included, that hold shapes of the subject at some revision, in id order.
    ///
    /// # Errors
    /// Database errors, as for all functions here.
    pub fn list_holdings<'a>(&'a self, subject: &'a str) -> Answer<'a, Vec<Holding>> {
        Box::pin(async move {
            let mut query = self.held(
                "SELECT h.id, h.name, h.revision, h.deleted_at_ms, count(DISTINCT s.id) AS shapes",
                subject,
            );
            query.push(" GROUP BY h.id, h.name, h.revision, h.deleted_at_ms ORDER BY h.id");
            let rows = query.all().await?;
            let holdings = rows.iter().map(|row| {
                Ok(Holding {
                    id: row.get("id")?,
                    name: row.get("name")?,
                    revision: from_sql(row.get("revision")?),
                    shapes: from_sql(row.get("shapes")?),
                    trashed: row.get::<Option<i64>>("deleted_at_ms")?.is_some(),
                })
            });
            holdings.collect()
        })
    }

    /// At most `limit` of these shapes in id order, after the id `after`.
    ///
    /// # Errors
    /// Database errors.
    pub fn list_held_shapes<'a>(
        &'a self,
        subject: &'a str,
        after: Option<&'a str>,
        limit: usize,
    ) -> Answer<'a, Vec<HeldShape>> {
        Box::pin(async move {
            let mut query = self.held(
                "SELECT s.id, h.id AS cohort, max(s.external_id) AS external_id,
                max(CASE WHEN s.deleted_revision IS NULL THEN 1 ELSE 0 END) = 1 AS is_current",
                subject,
            );
            query.push(" AND s.id > ").push_bind(after.unwrap_or_default());
            query.push(" GROUP BY s.id, h.id ORDER BY s.id LIMIT ").push_bind(to_sql(limit as u64));
            let rows = query.all().await?;
            let shapes = rows.iter().map(|row| {
                Ok(HeldShape {
                    id: row.get("id")?,
                    external_id: row.get("external_id")?,
                    cohort: row.get("cohort")?,
                    is_current: row.get("is_current")?,
                })
            });
            shapes.collect()
        })
    }

    /// Subjects of all tenants, with their tenants, after the last one of the page before.
    ///
    /// # Errors
    /// Database errors.
    pub fn list_subjects<'a>(
        &'a self,
        after: Option<&'a (String, String)>,
    ) -> Answer<'a, Vec<(String, String)>> {
        Box::pin(async move {
            let mut query = sql(
                self.reader(),
                "SELECT DISTINCT h.tenant, s.subject FROM cohort AS h CROSS JOIN shape AS s ON s.cohort = h.number
                WHERE s.subject IS NOT NULL AND (h.tenant, s.subject) > (",
            );
            query.push_bind(after.map_or("", |(tenant, _)| tenant.as_str())).push(", ");
            query.push_bind(after.map_or("", |(_, subject)| subject.as_str()));
            query.push(") ORDER BY h.tenant, s.subject LIMIT ").push_bind(PAGE);
            let rows = query.all().await?;
            let subjects = rows.iter().map(|row| Ok((row.get("tenant")?, row.get("subject")?)));
            subjects.collect()
        })
    }

    /// A selection from the rows `s` that name a subject and are not erased, and their cohorts `h`.
    fn held(&self, columns: &'static str, subject: &str) -> Query<'_> {
        let mut query = sql(self.reader(), columns);
        query.push(
            " FROM cohort AS h CROSS JOIN shape AS s ON s.cohort = h.number AND s.subject = $1
            CROSS JOIN chunk AS c ON c.id = s.chunk_id WHERE c.revision IS NOT NULL
            AND (s.deleted_revision IS NULL OR s.deleted_revision > c.revision) AND h.tenant = $2",
        );
        let mut query = query.bind(subject).bind(self.tenant());
        self.push_scope(&mut query, "h.id");
        query
    }
}
