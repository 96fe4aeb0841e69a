//! Shape filters as SQL.

use super::engine::to_sql;
use super::engine::{Query, Transaction, sql};
use crate::domain::shape::ShapeFilter;

/// Whether the filter accepts every shape.
pub(super) fn is_empty(filter: &ShapeFilter) -> bool {
    filter.label.is_none() && filter.subject.is_none() && filter.labels.is_empty()
}

/// Range of revisions: shapes added after one revision, as they were at another.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Revisions {
    /// Shapes up to this revision are excluded.
    pub after: u64,
    /// Changes after this revision are ignored.
    pub until: u64,
}

impl Revisions {
    /// All shapes at a revision.
    pub fn until(until: u64) -> Self {
        Self { after: 0, until }
    }

    /// All shapes at the current revision.
    pub(super) fn latest() -> Self {
        Self::until(u64::MAX)
    }
}

/// Selection of shapes, in storage order.
#[derive(Debug, Clone, Copy)]
pub(super) struct Selection<'a> {
    /// Internal number of the cohort.
    pub(super) cohort: i64,
    pub(super) revisions: Revisions,
    pub(super) filter: &'a ShapeFilter,
    /// Chunk and position of the shape before the first one.
    pub(super) after: (i64, i64),
}

impl Selection<'_> {
    /// `SELECT columns` from the shapes (`s`) and their chunks (`c`), unordered.
    pub(super) fn select<'c>(&self, read: &'c mut Transaction, columns: &str) -> Query<'c> {
        let is_postgres = read.is_postgres();
        let mut query = sql(read, "SELECT ").persistent(false);
        // CROSS JOIN fixes the order of the loops: storage order comes from an index on an attribute, or without one from
        // the chunks of the cohort.
        query.push(columns).push(if self.is_indexed() {
            " FROM shape AS s CROSS JOIN chunk AS c ON c.id = s.chunk_id WHERE s.cohort = "
        } else {
            " FROM chunk AS c CROSS JOIN shape AS s ON s.chunk_id = c.id WHERE c.cohort = "
        });
        query.push_bind(self.cohort);
        self.push_visibility(&mut query);
        self.push_filter(&mut query, is_postgres);
        query
    }

    /// The same in storage order, limited to `limit` rows.
    pub(super) fn page<'c>(&self, read: &'c mut Transaction, columns: &str, limit: usize) -> Query<'c> {
        let mut query = self.select(read, columns);
        query.push(if self.is_indexed() {
            " ORDER BY s.chunk_id, s.position LIMIT "
        } else {
            " ORDER BY c.id, s.position LIMIT "
        });
        query.push_bind(to_sql(limit as u64));
        query
    }

    /// `SELECT DISTINCT name`: the further attributes that the selected shapes have. Cost: one pass over their attributes.
    pub(super) fn attribute_names<'c>(&self, read: &'c mut Transaction) -> Query<'c> {
        const NAMES: &str =
            "SELECT DISTINCT k.key AS name FROM chunk AS c CROSS JOIN shape AS s ON s.chunk_id = c.id, ";
        let is_postgres = read.is_postgres();
        let mut query = sql(read, NAMES).persistent(false);
        query.push(if is_postgres {
            "json_object_keys(s.labels::json) AS k (key) WHERE c.cohort = "
        } else {
            "json_each(s.labels) AS k WHERE c.cohort = "
        });
        query.push_bind(self.cohort);
        self.push_visibility(&mut query);
        query
    }

    fn is_indexed(&self) -> bool {
        self.filter.label.is_some() || self.filter.subject.is_some()
    }

    fn push_visibility(&self, query: &mut Query<'_>) {
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

    fn push_filter(&self, query: &mut Query<'_>, is_postgres: bool) {
        if let Some(label) = &self.filter.label {
            query.push(" AND s.label = ").push_bind(label.as_str());
        }
        if let Some(subject) = &self.filter.subject {
            query.push(" AND s.subject = ").push_bind(subject.as_str());
        }
        for (key, value) in &self.filter.labels {
            if is_postgres {
                push_attribute_postgres(query, key);
            } else {
                push_attribute_sqlite(query, &attribute_path(key));
            }
            query.push(" = ").push_bind(value.as_str());
        }
    }
}

/// Attribute as text: strings as they are, other values as JSON (true, 1.5).
fn push_attribute_sqlite(query: &mut Query<'_>, path: &str) {
    query.push(" AND CASE json_type(s.labels, ").push_bind(path);
    query.push(") WHEN 'text' THEN json_extract(s.labels, ").push_bind(path);
    query.push(") ELSE s.labels -> ").push_bind(path).push(" END");
}

/// The same for PostgreSQL.
fn push_attribute_postgres(query: &mut Query<'_>, key: &str) {
    query.push(" AND CASE json_typeof(s.labels::json -> ").push_bind(key);
    query.push(") WHEN 'string' THEN s.labels::json ->> ").push_bind(key);
    query.push(" ELSE (s.labels::json -> ").push_bind(key).push(")::text END");
}

/// Path of an attribute in a JSON object, quoted by the writer of the stored object itself.
fn attribute_path(key: &str) -> String {
    format!("$.{}", serde_json::Value::from(key))
}
