//! Shape filters and orders as SQL.

use super::engine::to_sql;
use super::engine::{Bindable, Query, Transaction, sql};
use super::order::{ListCursor, Order, SortKey};
use crate::domain::attribute::{Attribute, Measure};
use crate::domain::filter::{Condition, ShapeFilter, number_of};

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
    pub fn latest() -> Self {
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
        let query = sql(read, "SELECT ").persistent(false);
        self.select_from(query, columns)
    }

    /// The same of a query that has begun with `SELECT` and perhaps further columns.
    fn select_from<'c>(&self, mut query: Query<'c>, columns: &str) -> Query<'c> {
        // CROSS JOIN fixes the order of the loops: storage order comes from an index on an attribute, or without one from
        // the chunks of the cohort.
        query.push(columns).push(if self.is_indexed() {
            " FROM shape AS s CROSS JOIN chunk AS c ON c.id = s.chunk_id WHERE s.cohort = "
        } else {
            " FROM chunk AS c CROSS JOIN shape AS s ON s.chunk_id = c.id WHERE c.cohort = "
        });
        query.push_bind(self.cohort);
        self.push_visibility(&mut query);
        push_filter(&mut query, self.filter);
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

    /// Chunks with selected shapes, in order, at most `limit`: `chunk_id`, and `positions` in it, separated by commas, in any order.
    pub(super) fn places<'c>(&self, read: &'c mut Transaction, limit: usize) -> Query<'c> {
        let chunk = if self.is_indexed() { "s.chunk_id" } else { "c.id" };
        let mut query = sql(read, "SELECT ").persistent(false);
        query.push(chunk);
        let positions = if query.is_postgres() {
            " AS chunk_id, string_agg(s.position::text, ',') AS positions"
        } else {
            " AS chunk_id, group_concat(s.position) AS positions"
        };
        let mut query = self.select_from(query, positions);
        query.push(" GROUP BY ").push(chunk).push(" ORDER BY ").push(chunk).push(" LIMIT ");
        query.push_bind(to_sql(limit as u64));
        query
    }

    /// Chunks with selected shapes, in order, at most `limit`: `chunk_id`, and `held`, a list of the position of each shape and the values of
    /// its attributes as JSON, in any order.
    pub(super) fn values<'c>(
        &self,
        read: &'c mut Transaction,
        attributes: &[Attribute],
        limit: usize,
    ) -> Query<'c> {
        let chunk = if self.is_indexed() { "s.chunk_id" } else { "c.id" };
        let mut query = sql(read, "SELECT ").persistent(false);
        query.push(chunk).push(" AS chunk_id, ");
        let (list, end) = match query.is_postgres() {
            true => ("json_agg(json_build_array(s.position", "))::text AS held"),
            false => ("json_group_array(json_array(s.position", ")) AS held"),
        };
        query.push(list);
        for attribute in attributes {
            query.push(", ");
            push_json(&mut query, attribute);
        }
        let mut query = self.select_from(query, end);
        query.push(" GROUP BY ").push(chunk).push(" ORDER BY ").push(chunk).push(" LIMIT ");
        query.push_bind(to_sql(limit as u64));
        query
    }

    /// The same in the order of an attribute, after a position in it, with the columns `order_number` and `order_text`.
    pub(super) fn ordered<'c>(
        &self,
        read: &'c mut Transaction,
        columns: &str,
        order: &Order,
        after: Option<&ListCursor>,
        limit: usize,
    ) -> Query<'c> {
        let mut query = sql(read, "SELECT ").persistent(false);
        push_order_number(&mut query, &order.attribute);
        query.push(" AS order_number, ");
        push_order_text(&mut query, &order.attribute);
        query.push(" AS order_text, ");
        let mut query = self.select_from(query, columns);
        if let Some(after) = after {
            push_after(&mut query, order, after);
        }
        query.push(if order.descending {
            " ORDER BY order_number DESC NULLS LAST, order_text DESC NULLS LAST"
        } else {
            " ORDER BY order_number NULLS LAST, order_text NULLS LAST"
        });
        query.push(", s.chunk_id, s.position LIMIT ").push_bind(to_sql(limit as u64));
        query
    }

    /// `SELECT DISTINCT name`: the further attributes that the selected shapes have, at most `limit`. Cost: one pass over their
    /// attributes.
    pub(super) fn attribute_names<'c>(&self, read: &'c mut Transaction, limit: usize) -> Query<'c> {
        const NAMES: &str =
            "SELECT DISTINCT k.key AS name FROM chunk AS c CROSS JOIN shape AS s ON s.chunk_id = c.id, ";
        let mut query = sql(read, NAMES).persistent(false);
        let is_postgres = query.is_postgres();
        query.push(if is_postgres {
            "json_object_keys(s.labels::json) AS k (key) WHERE c.cohort = "
        } else {
            "json_each(s.labels) AS k WHERE c.cohort = "
        });
        query.push_bind(self.cohort);
        self.push_visibility(&mut query);
        query.push(" LIMIT ").push_bind(to_sql(limit as u64));
        query
    }

    /// Whether an index on an attribute gives the shapes in storage order.
    fn is_indexed(&self) -> bool {
        let is_one = |condition: &Option<Condition>| condition.as_ref().is_some_and(|c| c.one_of.len() == 1);
        is_one(&self.filter.label) || is_one(&self.filter.subject)
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
}

/// Appends the conditions of a filter on the shapes (`s`) and their chunks (`c`).
pub(super) fn push_filter(query: &mut Query<'_>, filter: &ShapeFilter) {
    for (attribute, condition) in filter.conditions() {
        push_condition(query, &attribute, condition);
    }
    for attribute in &filter.has {
        query.push(" AND ");
        push_presence(query, attribute);
    }
}

fn push_condition(query: &mut Query<'_>, attribute: &Attribute, condition: &Condition) {
    if !condition.one_of.is_empty() {
        query.push(" AND ");
        push_membership(query, attribute, &condition.one_of);
    }
    if !condition.none_of.is_empty() {
        // A missing attribute has no value, hence none of these.
        query.push(" AND (");
        push_membership(query, attribute, &condition.none_of);
        query.push(") IS NOT TRUE");
    }
    for (operator, bound) in condition.bounds() {
        query.push(" AND ");
        let number = number_of(attribute, bound);
        // Numbers among further attributes are compared with numbers, texts with texts.
        if attribute.is_numeric() || matches!(attribute, Attribute::Labels(_)) && number.is_some() {
            push_number(query, attribute);
            query.push(operator).push_bind(number);
        } else {
            push_string(query, attribute);
            query.push(operator).push_bind(bound);
        }
    }
}

/// Whether the value is one of these, which are compared as texts, and as numbers where both are numbers.
fn push_membership(query: &mut Query<'_>, attribute: &Attribute, values: &[String]) {
    let numbers: Vec<f64> = values.iter().filter_map(|value| number_of(attribute, value)).collect();
    let has_numbers =
        attribute.is_numeric() || matches!(attribute, Attribute::Labels(_)) && !numbers.is_empty();
    if has_numbers && numbers.is_empty() {
        query.push("1 = 0");
        return;
    }
    query.push("(");
    if has_numbers {
        push_number(query, attribute);
        push_list(query, &numbers);
    }
    if !attribute.is_numeric() {
        query.push(if has_numbers { " OR " } else { "" });
        push_text(query, attribute);
        push_list(query, values);
    }
    query.push(")");
}

fn push_list<'q>(query: &mut Query<'_>, values: &'q [impl Bindable<'q> + Clone]) {
    query.push(" IN (");
    for (index, value) in values.iter().enumerate() {
        query.push(if index == 0 { "" } else { ", " }).push_bind(value.clone());
    }
    query.push(")");
}

/// Column of an attribute that has one.
fn column(attribute: &Attribute) -> &'static str {
    match attribute {
        Attribute::ExternalId => "s.external_id",
        Attribute::Subject => "s.subject",
        Attribute::Label => "s.label",
        Attribute::CreatedAt => "coalesce(s.first_stored_ms, c.created_at_ms)",
        Attribute::Measure(Measure::Points) => "s.points",
        Attribute::Measure(Measure::CentroidSize) => "s.centroid_size",
        Attribute::Measure(Measure::Length) => "s.length",
        Attribute::Measure(Measure::Area) => "s.area",
        Attribute::Measure(Measure::Volume) => "s.volume",
        Attribute::Measure(Measure::SelfIntersecting) => "s.self_intersecting",
        Attribute::Measure(Measure::Clockwise) => "s.clockwise",
        Attribute::Measure(Measure::FitMean) => "s.fit_mean",
        Attribute::Measure(Measure::FitLargest) => "s.fit_largest",
        Attribute::Measure(Measure::FitArea) => "s.fit_area",
        Attribute::Labels(_) => "s.labels",
    }
}

fn push_presence(query: &mut Query<'_>, attribute: &Attribute) {
    let Attribute::Labels(name) = attribute else {
        query.push(column(attribute)).push(" IS NOT NULL");
        return;
    };
    if query.is_postgres() {
        query.push("json_typeof(s.labels::json -> ").push_bind(name.as_str()).push(") <> 'null'");
    } else {
        query.push("json_type(s.labels, ").push_bind(path(name)).push(") <> 'null'");
    }
}

/// Value as text: strings as they are, other values as JSON (true, 1.5).
fn push_text(query: &mut Query<'_>, attribute: &Attribute) {
    let Attribute::Labels(name) = attribute else {
        match attribute {
            Attribute::Measure(measure) if measure.is_flag() => query
                .push("CASE ")
                .push(column(attribute))
                .push(" WHEN 1 THEN 'true' WHEN 0 THEN 'false' END"),
            other => query.push(column(other)),
        };
        return;
    };
    if query.is_postgres() {
        query.push("CASE json_typeof(s.labels::json -> ").push_bind(name.as_str());
        query.push(") WHEN 'string' THEN s.labels::json ->> ").push_bind(name.as_str());
        query.push(" ELSE (s.labels::json -> ").push_bind(name.as_str()).push(")::text END");
    } else {
        query.push("CASE json_type(s.labels, ").push_bind(path(name));
        query.push(") WHEN 'text' THEN json_extract(s.labels, ").push_bind(path(name));
        query.push(") ELSE s.labels -> ").push_bind(path(name)).push(" END");
    }
}

/// Value as JSON; sizes as texts that read back to the same number.
fn push_json(query: &mut Query<'_>, attribute: &Attribute) {
    match attribute {
        Attribute::Labels(name) if query.is_postgres() => {
            query.push("s.labels::json -> ").push_bind(name.as_str());
        }
        Attribute::Labels(name) => {
            query.push("s.labels -> ").push_bind(path(name));
        }
        Attribute::Measure(measure) if measure.is_flag() => push_text(query, attribute),
        Attribute::Measure(Measure::Points) => {
            query.push(column(attribute));
        }
        Attribute::Measure(_) if query.is_postgres() => {
            query.push("CAST(").push(column(attribute)).push(" AS TEXT)");
        }
        Attribute::Measure(_) => {
            let column = column(attribute);
            query.push("CASE WHEN ").push(column).push(" IS NOT NULL THEN printf('%!.17g', ");
            query.push(column).push(") END");
        }
        other => {
            query.push(column(other));
        }
    }
}

/// Value, if it is a string, ordered by its bytes.
fn push_string(query: &mut Query<'_>, attribute: &Attribute) {
    let Attribute::Labels(name) = attribute else {
        push_text(query, attribute);
        return;
    };
    if query.is_postgres() {
        query.push("(CASE json_typeof(s.labels::json -> ").push_bind(name.as_str());
        query.push(") WHEN 'string' THEN s.labels::json ->> ").push_bind(name.as_str());
        query.push(" END COLLATE \"C\")");
    } else {
        query.push("CASE json_type(s.labels, ").push_bind(path(name));
        query.push(") WHEN 'text' THEN json_extract(s.labels, ").push_bind(path(name)).push(") END");
    }
}

/// Value, if it is a number.
fn push_number(query: &mut Query<'_>, attribute: &Attribute) {
    let Attribute::Labels(name) = attribute else {
        query.push("CAST(").push(column(attribute)).push(" AS DOUBLE PRECISION)");
        return;
    };
    if query.is_postgres() {
        query.push("CASE json_typeof(s.labels::json -> ").push_bind(name.as_str());
        query.push(") WHEN 'number' THEN (s.labels::json ->> ").push_bind(name.as_str());
        query.push(")::double precision END");
    } else {
        query.push("CASE WHEN json_type(s.labels, ").push_bind(path(name));
        query.push(") IN ('integer', 'real') THEN CAST(json_extract(s.labels, ").push_bind(path(name));
        query.push(") AS DOUBLE PRECISION) END");
    }
}

fn push_order_number(query: &mut Query<'_>, attribute: &Attribute) {
    if attribute.is_numeric() || matches!(attribute, Attribute::Labels(_)) {
        push_number(query, attribute);
    } else {
        query.push("CAST(NULL AS DOUBLE PRECISION)");
    }
}

fn push_order_text(query: &mut Query<'_>, attribute: &Attribute) {
    if attribute.is_numeric() {
        query.push("CAST(NULL AS TEXT)");
    } else {
        push_string(query, attribute);
    }
}

/// Shapes after a position in an order.
fn push_after(query: &mut Query<'_>, order: &Order, after: &ListCursor) {
    let (attribute, comes_later) = (&order.attribute, if order.descending { " < " } else { " > " });
    let push_place = |query: &mut Query<'_>| {
        query.push("(s.chunk_id, s.position) > (").push_bind(after.place.chunk);
        query.push(", ").push_bind(after.place.position).push(")");
    };
    query.push(" AND ");
    match &after.key {
        Some(SortKey::Number(number)) => {
            query.push("(");
            push_order_number(query, attribute);
            query.push(comes_later).push_bind(*number).push(" OR (");
            push_order_number(query, attribute);
            query.push(" = ").push_bind(*number).push(" AND ");
            push_place(query);
            query.push(") OR ");
            push_order_number(query, attribute);
            query.push(" IS NULL)");
        }
        Some(SortKey::Text(text)) => {
            push_order_number(query, attribute);
            query.push(" IS NULL AND (");
            push_order_text(query, attribute);
            query.push(comes_later).push_bind(text.as_str()).push(" OR (");
            push_order_text(query, attribute);
            query.push(" = ").push_bind(text.as_str()).push(" AND ");
            push_place(query);
            query.push(") OR ");
            push_order_text(query, attribute);
            query.push(" IS NULL)");
        }
        Some(SortKey::Missing) | None => {
            push_order_number(query, attribute);
            query.push(" IS NULL AND ");
            push_order_text(query, attribute);
            query.push(" IS NULL AND ");
            push_place(query);
        }
    }
}

/// Path of an attribute in a JSON object, quoted by the writer of the stored object itself.
fn path(key: &str) -> String {
    format!("$.{}", serde_json::Value::from(key))
}
