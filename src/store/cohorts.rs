//! Cohorts: create, find, list, delete.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;
use sqlx::sqlite::SqliteRow;
use sqlx::{Row, SqliteConnection};

use super::{PURGE_ORPHANS, Store, StoreError, from_sql, sqlite, to_sql};
use crate::domain::cohort::Cohort;

impl Store {
    /// Stores a new cohort as it is.
    ///
    /// # Errors
    /// [`StoreError::NameTaken`].
    pub async fn create_cohort(&self, cohort: &Cohort) -> Result<(), StoreError> {
        const CREATE: &str = "INSERT INTO cohort (id, name, description, representation,
            correspondence, direction, mirror, length_unit, revision, shapes, created_at_ms, updated_at_ms)
            VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12)";
        let created = sqlx::query(CREATE)
            .bind(&cohort.id)
            .bind(&cohort.name)
            .bind(&cohort.description)
            .bind(to_text(&cohort.representation))
            .bind(to_text(&cohort.correspondence))
            .bind(to_text(&cohort.direction))
            .bind(to_text(&cohort.mirror))
            .bind(&cohort.length_unit)
            .bind(to_sql(cohort.revision))
            .bind(to_sql(cohort.shapes))
            .bind(cohort.created_at_ms)
            .bind(cohort.updated_at_ms)
            .execute(&self.0.writer)
            .await;
        match created {
            Ok(_) => Ok(()),
            Err(e) if sqlite::is_duplicate(&e, "cohort.name") => {
                Err(StoreError::NameTaken { name: cohort.name.clone() })
            }
            Err(e) => Err(e.into()),
        }
    }

    /// The cohort with this id or name.
    ///
    /// # Errors
    /// None of its own, only those of the database; the same holds for the other readers.
    pub async fn find_cohort(&self, key: &str) -> Result<Option<Cohort>, StoreError> {
        const FIND: &str = "SELECT * FROM cohort WHERE id = $1 OR name = $1";
        let row = sqlx::query(FIND).bind(key).fetch_optional(self.reader()).await?;
        row.as_ref().map(read_cohort).transpose()
    }

    /// At most `limit` cohorts in the order of their ids, from the one after the id `after`.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn list_cohorts(&self, after: Option<&str>, limit: usize) -> Result<Vec<Cohort>, StoreError> {
        const LIST: &str = "SELECT * FROM cohort WHERE id > $1 ORDER BY id LIMIT $2";
        let rows = sqlx::query(LIST)
            .bind(after.unwrap_or_default())
            .bind(to_sql(limit as u64))
            .fetch_all(self.reader())
            .await?;
        rows.iter().map(read_cohort).collect()
    }

    /// Deletes the cohort with this id and all its shapes; false when there is none.
    ///
    /// The cohort vanishes at once. Its chunks are then removed in steps, so that others can write
    /// meanwhile; what a crash leaves is removed at the next start.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn delete_cohort(&self, id: &str) -> Result<bool, StoreError> {
        const DELETE: &str = "DELETE FROM cohort WHERE id = $1";
        let deleted = sqlx::query(DELETE).bind(id).execute(&self.0.writer).await?;
        if deleted.rows_affected() == 0 {
            return Ok(false);
        }
        let store = self.clone();
        // A task of its own: it goes on when the caller stops waiting.
        let purge = tokio::spawn(async move { store.purge(PURGE_ORPHANS, None).await });
        // The cohort is gone in any case; what could not be removed is tried again at the next start.
        let _ = purge.await;
        Ok(true)
    }
}

/// Number of the cohort with this id.
///
/// # Errors
/// [`StoreError::CohortGone`].
pub(super) async fn number(connection: &mut SqliteConnection, id: &str) -> Result<i64, StoreError> {
    sqlx::query_scalar("SELECT number FROM cohort WHERE id = $1")
        .bind(id)
        .fetch_optional(connection)
        .await?
        .ok_or(StoreError::CohortGone)
}

fn read_cohort(row: &SqliteRow) -> Result<Cohort, StoreError> {
    Ok(Cohort {
        id: row.try_get("id")?,
        name: row.try_get("name")?,
        description: row.try_get("description")?,
        representation: from_text(row.try_get("representation")?)?,
        correspondence: from_text(row.try_get("correspondence")?)?,
        direction: from_text(row.try_get("direction")?)?,
        mirror: from_text(row.try_get("mirror")?)?,
        length_unit: row.try_get("length_unit")?,
        revision: from_sql(row.try_get("revision")?),
        shapes: from_sql(row.try_get("shapes")?),
        created_at_ms: row.try_get("created_at_ms")?,
        updated_at_ms: row.try_get("updated_at_ms")?,
    })
}

/// JSON, or the bare word when it is one.
pub(super) fn to_text(value: &impl Serialize) -> String {
    match serde_json::to_value(value).expect("plain enums are JSON") {
        Value::String(word) => word,
        value => value.to_string(),
    }
}

/// What [`to_text`] wrote.
///
/// # Errors
/// [`StoreError::Damaged`].
pub(super) fn from_text<T: DeserializeOwned>(text: &str) -> Result<T, StoreError> {
    serde_json::from_str(text)
        .or_else(|_| serde_json::from_value(Value::from(text)))
        .map_err(|e| StoreError::Damaged { detail: format!("unreadable {text:?}: {e}") })
}
