//! Cohorts: create, find, list, delete.

use super::answer::Answer;
use super::engine::{self, Query, Row, Transaction, sql};
use super::engine::{from_sql, to_sql};
use super::error::StoreError;
use super::handle::{PURGE_ORPHANS, Store, begin_task};
use super::shapes::from_json;
use super::text::{from_text, to_text};
use super::{changes, receipts};
use crate::domain::change::{ChangeKind, NewChange};
use crate::domain::cohort::{Cohort, CohortSpec};
use crate::domain::retry::Receipt;

impl Store {
    /// Stores a new cohort.
    ///
    /// # Errors
    /// [`StoreError::NameTaken`], [`StoreError::AlreadyDone`].
    pub fn create_cohort<'a>(&'a self, cohort: &'a Cohort, receipt: Option<&'a Receipt>) -> Answer<'a, ()> {
        Box::pin(async move {
            const CREATE: &str = "INSERT INTO cohort (id, name, description, representation, correspondence,
                direction, mirror, length_unit, revision, shapes, created_at_ms, updated_at_ms, tenant, handle)
                VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14)";
            let handle = self.handle(&cohort.spec.name);
            let mut write = self.begin_write(&handle).await?;
            receipts::keep(&mut write, self.tenant(), receipt, cohort.created_at_ms).await?;
            let created = sql(&mut write, CREATE)
                .bind(&cohort.id)
                .bind(&cohort.spec.name)
                .bind(&cohort.spec.description)
                .bind(to_text(&cohort.spec.representation))
                .bind(to_text(&cohort.spec.correspondence))
                .bind(to_text(&cohort.spec.direction))
                .bind(to_text(&cohort.spec.mirror))
                .bind(&cohort.spec.length_unit)
                .bind(to_sql(cohort.revision))
                .bind(to_sql(cohort.shapes))
                .bind(cohort.created_at_ms)
                .bind(cohort.updated_at_ms)
                .bind(self.tenant())
                .bind(handle)
                .execute()
                .await;
            created.map_err(|error| name_taken(error, &cohort.spec.name))?;
            let change = NewChange::for_cohort(ChangeKind::CohortCreated, &cohort.id, cohort.revision);
            changes::record(&mut write, self.tenant(), &change, cohort.created_at_ms).await?;
            Ok(write.commit().await?)
        })
    }

    /// Updates name, description and unit as the next revision, if the cohort is still at `cohort.revision`.
    ///
    /// # Errors
    /// [`StoreError::NameTaken`], [`StoreError::Changed`], [`StoreError::CohortGone`].
    pub fn update_cohort<'a>(&'a self, cohort: &'a Cohort, now_ms: i64) -> Answer<'a, ()> {
        Box::pin(async move {
            const UPDATE: &str =
                "UPDATE cohort SET name = $2, handle = $3, description = $4, length_unit = $5,
                revision = revision + 1, updated_at_ms = $6 WHERE number = $1";
            let mut write = self.begin_write(&cohort.id).await?;
            let number = self.number_at(&mut write, &cohort.id, Some(cohort.revision)).await?;
            let updated = sql(&mut write, UPDATE)
                .bind(number)
                .bind(&cohort.spec.name)
                .bind(self.handle(&cohort.spec.name))
                .bind(&cohort.spec.description)
                .bind(&cohort.spec.length_unit)
                .bind(now_ms)
                .execute()
                .await;
            updated.map_err(|error| name_taken(error, &cohort.spec.name))?;
            let change = NewChange::for_cohort(ChangeKind::CohortUpdated, &cohort.id, cohort.revision + 1);
            changes::record(&mut write, self.tenant(), &change, now_ms).await?;
            Ok(write.commit().await?)
        })
    }

    /// Finds the cohort with this id or name.
    ///
    /// # Errors
    /// Database errors, as for the other readers.
    pub fn find_cohort<'a>(&'a self, key: &'a str) -> Answer<'a, Option<Cohort>> {
        Box::pin(async move {
            const FIND: &str = "SELECT * FROM cohort
                WHERE (id = $1 OR handle = $2) AND tenant = $3 AND deleted_at_ms IS NULL";
            let query = sql(self.reader(), FIND).bind(key).bind(self.handle(key)).bind(self.tenant());
            let found = query.optional().await?.as_ref().map(read_cohort).transpose()?;
            Ok(found.filter(|cohort| self.principal.may_use(&cohort.id)))
        })
    }

    /// At most `limit` cohorts in id order, starting after the id `after`.
    ///
    /// # Errors
    /// Database errors.
    pub fn list_cohorts<'a>(&'a self, after: Option<&'a str>, limit: usize) -> Answer<'a, Vec<Cohort>> {
        Box::pin(async move {
            const LIST: &str = "SELECT * FROM cohort WHERE deleted_at_ms IS NULL AND tenant = ";
            let mut query = sql(self.reader(), LIST);
            query.push_bind(self.tenant());
            self.push_scope(&mut query, "id");
            query.push(" AND id > ").push_bind(after.unwrap_or_default());
            query.push(" ORDER BY id LIMIT ").push_bind(to_sql(limit as u64));
            let rows = query.all().await?;
            rows.iter().map(read_cohort).collect()
        })
    }

    /// Permanently removes the cohort with this id and all its shapes; `false` if there is none.
    ///
    /// The cohort disappears at once. Its chunks are then removed in steps, so that others can write in between; chunks that a crash
    /// leaves behind are removed at the next start.
    ///
    /// # Errors
    /// Database errors.
    pub fn remove_cohort<'a>(&'a self, id: &'a str) -> Answer<'a, bool> {
        Box::pin(async move {
            const DELETE: &str = "DELETE FROM cohort WHERE id = $1 AND tenant = $2";
            let deleted = sql(self.writer(), DELETE).bind(id).bind(self.tenant()).execute().await?;
            if deleted == 0 {
                return Ok(false);
            }
            let store = self.clone();
            // A separate task continues if the caller stops waiting.
            let purge = begin_task(Box::pin(async move {
                // The cohort is gone in any case; a failed removal is retried at the next start.
                let _ = store.purge(PURGE_ORPHANS, None).await;
            }));
            let _ = purge.await;
            Ok(true)
        })
    }
}

impl Store {
    /// Appends the condition that the caller may access the cohort in `column`.
    pub(super) fn push_scope(&self, query: &mut Query<'_>, column: &str) {
        let Some(cohorts) = &self.principal.cohorts else { return };
        query.push(" AND ").push(column).push(" IN (NULL");
        for cohort in cohorts {
            query.push(", ").push_bind(cohort.as_str());
        }
        query.push(")");
    }

    /// Internal number of a cohort that must be at the `expected` revision.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`], [`StoreError::Changed`].
    pub(super) async fn number_at(
        &self,
        write: &mut Transaction,
        id: &str,
        revision: Option<u64>,
    ) -> Result<i64, StoreError> {
        let number = self.number(write, id).await?;
        let Some(expected) = revision else { return Ok(number) };
        let present: i64 =
            sql(write, "SELECT revision FROM cohort WHERE number = $1").bind(number).scalar().await?;
        if from_sql(present) != expected {
            return Err(StoreError::Changed);
        }
        Ok(number)
    }

    /// Internal number of the cohort with this id.
    ///
    /// # Errors
    /// [`StoreError::CohortGone`].
    pub(super) async fn number(&self, connection: &mut Transaction, id: &str) -> Result<i64, StoreError> {
        const NUMBER: &str =
            "SELECT number FROM cohort WHERE id = $1 AND tenant = $2 AND deleted_at_ms IS NULL";
        let number = sql(connection, NUMBER).bind(id).bind(self.tenant()).optional_scalar().await?;
        number.ok_or(StoreError::CohortGone)
    }
}

/// Maps the error of a statement that sets a name.
pub(super) fn name_taken(error: sqlx::Error, name: &str) -> StoreError {
    if engine::is_duplicate(&error, "cohort", "handle") {
        return StoreError::NameTaken { name: name.into() };
    }
    error.into()
}

pub(super) fn read_cohort(row: &Row) -> Result<Cohort, StoreError> {
    Ok(Cohort {
        id: row.get("id")?,
        spec: CohortSpec {
            name: row.get("name")?,
            description: row.get("description")?,
            representation: from_text(row.get("representation")?)?,
            correspondence: from_text(row.get("correspondence")?)?,
            direction: from_text(row.get("direction")?)?,
            mirror: from_text(row.get("mirror")?)?,
            length_unit: row.get("length_unit")?,
        },
        revision: from_sql(row.get("revision")?),
        shapes: from_sql(row.get("shapes")?),
        created_at_ms: row.get("created_at_ms")?,
        updated_at_ms: row.get("updated_at_ms")?,
        former_rules: from_json(row.get("former_rules")?)?.unwrap_or_default(),
    })
}
