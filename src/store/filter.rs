//! Conditions on shapes as SQL.

use sqlx::{QueryBuilder, Sqlite};

use super::to_sql;
use crate::domain::shape::ShapeFilter;

/// Whether every shape passes.
pub(super) fn is_empty(filter: &ShapeFilter) -> bool {
    filter.label.is_none() && filter.subject.is_none() && filter.labels.is_empty()
}

/// Shapes that were added after one revision of a cohort, as they were at another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Revisions {
    /// Shapes of this revision are left out.
    pub after: u64,
    /// Changes after this one are not seen.
    pub until: u64,
}

impl Revisions {
    /// All shapes of a revision.
    pub fn until(until: u64) -> Self {
        Self { after: 0, until }
    }

    /// The current revision, whichever it is.
    pub(super) fn latest() -> Self {
        Self::until(u64::MAX)
    }
}

/// Which shapes, in storage order.
#[derive(Debug, Clone, Copy)]
pub(super) struct Selection<'a> {
    /// Number of the cohort.
    pub(super) cohort: i64,
    pub(super) revisions: Revisions,
    pub(super) filter: &'a ShapeFilter,
    /// Chunk and position of the shape before the first.
    pub(super) after: (i64, i64),
}

impl Selection<'_> {
    /// `SELECT columns` of the shapes (`s`) and their chunks (`c`), without an order.
    pub(super) fn select(&self, columns: &str) -> QueryBuilder<Sqlite> {
        let mut query = QueryBuilder::new("SELECT ");
        // CROSS JOIN fixes the order of the loops: an index on an attribute brings the shapes in
        // storage order, without one the chunks of the cohort do.
        query.push(columns).push(if self.is_indexed() {
            " FROM shape AS s CROSS JOIN chunk AS c ON c.id = s.chunk_id WHERE s.cohort = "
        } else {
            " FROM chunk AS c CROSS JOIN shape AS s ON s.chunk_id = c.id WHERE c.cohort = "
        });
        query.push_bind(self.cohort);
        self.push_visibility(&mut query);
        self.push_filter(&mut query);
        query
    }

    /// The same in storage order, at most `limit`.
    pub(super) fn page(&self, columns: &str, limit: usize) -> QueryBuilder<Sqlite> {
        let mut query = self.select(columns);
        query.push(if self.is_indexed() {
            " ORDER BY s.chunk_id, s.position LIMIT "
        } else {
            " ORDER BY c.id, s.position LIMIT "
        });
        query.push_bind(to_sql(limit as u64));
        query
    }

    fn is_indexed(&self) -> bool {
        self.filter.label.is_some() || self.filter.subject.is_some()
    }

    fn push_visibility(&self, query: &mut QueryBuilder<Sqlite>) {
        let (chunk, position) = self.after;
        let revision = to_sql(self.revisions.until);
        query.push(" AND c.revision > ").push_bind(to_sql(self.revisions.after));
        query.push(" AND c.revision <= ").push_bind(revision);
        query.push(" AND (s.deleted_revision IS NULL OR s.deleted_revision > ").push_bind(revision);
        query.push(") AND c.id >= ").push_bind(chunk);
        query.push(" AND (s.chunk_id, s.position) > (");
        query.push_bind(chunk).push(", ").push_bind(position);
        query.push(")");
    }

    fn push_filter(&self, query: &mut QueryBuilder<Sqlite>) {
        if let Some(label) = &self.filter.label {
            query.push(" AND s.label = ").push_bind(label);
        }
        if let Some(subject) = &self.filter.subject {
            query.push(" AND s.subject = ").push_bind(subject);
        }
        for (key, value) in &self.filter.labels {
            let path = attribute_path(key);
            query.push(" AND CASE json_type(s.labels, ");
            query.push_bind(path.clone());
            query.push(") WHEN 'text' THEN json_extract(s.labels, ");
            query.push_bind(path.clone());
            // The JSON text of anything else: true, 1.5.
            query.push(") ELSE s.labels -> ").push_bind(path);
            query.push(" END = ").push_bind(value);
        }
    }
}

/// Path of an attribute in a JSON object, quoted by the writer of the stored object itself.
fn attribute_path(key: &str) -> String {
    format!("$.{}", serde_json::Value::from(key))
}
