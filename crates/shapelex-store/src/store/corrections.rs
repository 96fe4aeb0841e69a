//! Corrections: shapes stored again with other attributes, and shapes deleted together.
//!
//! Rows are only ever ended, never changed, so that earlier revisions stay as they were: a correction ends the row of a shape
//! and stores the shape again, under its id, as a separate chunk.

use super::answer::Answer;
use super::attributes::NewNames;
use super::changes;
use super::engine::{Transaction, sql};
use super::engine::{from_sql, to_sql};
use super::error::StoreError;
use super::filter::{Revisions, Selection};
use super::handle::{Store, blocking};
use super::order::Cursor;
use super::upload::{ShapeRow, WholeCohort, insert_alone};
use crate::domain::change::{ChangeKind, NewChange};
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::shape::Shape;

/// Outcome of deleting shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Deleted {
    /// Number of shapes.
    pub shapes: u64,
    /// Revision of the cohort after that.
    pub revision: u64,
}

impl Store {
    /// Stores the shape at `place` again, with the attributes of `shape`, as the next revision of its cohort, which must be at
    /// the `expected` one; returns the new revision, or `None` if the shape is no longer at that place. `names` are those of the
    /// attributes, unless the shape had them all.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`], [`StoreError::Changed`], [`StoreError::TooManyNames`].
    pub fn correct_shape<'a>(
        &'a self,
        cohort_id: &'a str,
        expected: Option<u64>,
        place: Cursor,
        (shape, names): (&'a Shape, Option<&'a NewNames>),
        now_ms: i64,
    ) -> Answer<'a, Option<u64>> {
        Box::pin(async move {
            const GROW: &str = "UPDATE cohort SET revision = $2, updated_at_ms = $3 WHERE number = $1";
            const SHOW: &str = "UPDATE chunk SET revision = $2, created_at_ms = $3 WHERE id = $1";
            let new = shape.clone();
            let encode = move || {
                let row = ShapeRow::from(new);
                let data = row.alone();
                (row, data)
            };
            let (row, data) = blocking(encode).await;
            let mut write = self.begin_write(cohort_id).await?;
            let cohort = self.number_at(&mut write, cohort_id, expected).await?;
            if let Some(names) = names {
                names.check(&mut write, cohort).await?;
            }
            let Some(revision) = end(&mut write, cohort, place).await? else { return Ok(None) };
            let upload = self.inner.replica.owned_id();
            let chunk = insert_alone(&mut write, cohort, &upload, &row, &data).await?;
            sql(&mut write, SHOW).bind(chunk).bind(revision).bind(now_ms).execute().await?;
            sql(&mut write, GROW).bind(cohort).bind(revision).bind(now_ms).execute().await?;
            let change =
                NewChange::for_shape(ChangeKind::ShapeUpdated, &shape.id, cohort_id, from_sql(revision));
            changes::record(&mut write, self.tenant(), &change, now_ms).await?;
            write.commit().await?;
            Ok(Some(from_sql(revision)))
        })
    }

    /// Stores shapes again with other attributes, all as the next revision of their cohort, which must be at `revision`, that at which they
    /// were read; returns the new revision. `names` are those of the attributes, unless the shapes had them all. Memory: a copy of the
    /// shapes.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`], [`StoreError::Changed`], [`StoreError::TooManyNames`].
    pub fn correct_shapes<'a>(
        &'a self,
        cohort: &'a Cohort,
        shapes: Vec<Shape>,
        names: Option<&'a NewNames>,
        now_ms: i64,
    ) -> Answer<'a, u64> {
        Box::pin(async move {
            const SHOW: &str = "UPDATE chunk SET revision = $2, created_at_ms = $3
                WHERE upload = $1 AND revision IS NULL";
            const GROW: &str = "UPDATE cohort SET revision = $2, updated_at_ms = $3 WHERE number = $1";
            let width = cohort.spec.representation.size() * cohort.spec.representation.dimension();
            let ids: Vec<String> = shapes.iter().map(|shape| shape.id.clone()).collect();
            let encode = move || WholeCohort::new(shapes.into_iter().map(ShapeRow::from).collect(), width);
            let whole = blocking(encode).await?;
            let revision = to_sql(cohort.revision + 1);
            let mut write = self.begin_write(&cohort.id).await?;
            let number = self.number_at(&mut write, &cohort.id, Some(cohort.revision)).await?;
            if let Some(names) = names {
                names.check(&mut write, number).await?;
            }
            let mut end = sql(&mut write, "UPDATE shape SET deleted_revision = ");
            end.push_bind(revision).push(" WHERE deleted_revision IS NULL AND cohort = ").push_bind(number);
            end.push(" AND id IN ").push_texts(ids.iter().map(String::as_str));
            if end.execute().await? != ids.len() as u64 {
                return Err(StoreError::Changed);
            }
            let upload = self.inner.replica.owned_id();
            whole.insert(&mut write, number, &upload).await?;
            sql(&mut write, SHOW).bind(&upload).bind(revision).bind(now_ms).execute().await?;
            sql(&mut write, GROW).bind(number).bind(revision).bind(now_ms).execute().await?;
            let change = NewChange {
                shapes: Some(ids.len() as u64),
                ..NewChange::for_cohort(ChangeKind::ShapesUpdated, &cohort.id, from_sql(revision))
            };
            changes::record(&mut write, self.tenant(), &change, now_ms).await?;
            write.commit().await?;
            Ok(from_sql(revision))
        })
    }

    /// Deletes all shapes that pass the filter, as one revision of the cohort, which must be at the `expected` one. Without such
    /// shapes the revision stays.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`], [`StoreError::Changed`].
    pub fn delete_shapes<'a>(
        &'a self,
        cohort_id: &'a str,
        filter: &'a ShapeFilter,
        expected: Option<u64>,
        now_ms: i64,
    ) -> Answer<'a, Deleted> {
        Box::pin(async move {
            const NOW: &str = "SELECT revision FROM cohort WHERE number = $1";
            const GROW: &str = "UPDATE cohort SET revision = $2, shapes = shapes - $3, updated_at_ms = $4
                WHERE number = $1";
            let mut write = self.begin_write(cohort_id).await?;
            let cohort = self.number_at(&mut write, cohort_id, expected).await?;
            let present: i64 = sql(&mut write, NOW).bind(cohort).scalar().await?;
            let revision = present + 1;
            let mark = format!(
                "UPDATE shape SET deleted_revision = {revision} WHERE deleted_revision IS NULL
                AND (chunk_id, position) IN ("
            );
            let selection = Selection { cohort, revisions: Revisions::latest(), filter, after: (0, -1) };
            let chosen = selection.select(&mut write, "s.chunk_id, s.position");
            let shapes = chosen.within(&mark, ")").execute().await?;
            if shapes == 0 {
                return Ok(Deleted { shapes, revision: from_sql(present) });
            }
            let grow = sql(&mut write, GROW).bind(cohort).bind(revision).bind(to_sql(shapes)).bind(now_ms);
            grow.execute().await?;
            let change = NewChange {
                shapes: Some(shapes),
                ..NewChange::for_cohort(ChangeKind::ShapesDeleted, cohort_id, from_sql(revision))
            };
            changes::record(&mut write, self.tenant(), &change, now_ms).await?;
            write.commit().await?;
            Ok(Deleted { shapes, revision: from_sql(revision) })
        })
    }
}

/// Ends the living row at a place with the next revision of the cohort, and returns that revision.
async fn end(write: &mut Transaction, cohort: i64, place: Cursor) -> Result<Option<i64>, StoreError> {
    const END: &str = "UPDATE shape
        SET deleted_revision = (SELECT revision + 1 FROM cohort WHERE number = $1)
        WHERE chunk_id = $2 AND position = $3 AND cohort = $1 AND deleted_revision IS NULL
        RETURNING deleted_revision";
    let ended = sql(write, END).bind(cohort).bind(place.chunk).bind(place.position);
    Ok(ended.optional_scalar().await?)
}
