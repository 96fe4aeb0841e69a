//! Trash: deleted objects that can be restored until they are permanently removed.

use super::answer::Answer;
use super::engine::to_sql;
use super::engine::{Row, Transaction, sql};
use super::error::StoreError;
use super::handle::Store;
use super::{aliases, changes, engine};
use crate::domain::change::{ChangeKind, NewChange};
use crate::domain::trash::{Trashed, TrashedKind};

/// Maximum number of objects removed between two checks of the clock.
const PURGED_AT_ONCE: i64 = 100;

impl Store {
    /// Moves the cohort with this id to the trash, if it is at the `expected` revision; `false` if there is none. Its name can
    /// be reused at once.
    ///
    /// # Errors
    /// [`StoreError::Changed`].
    pub fn trash_cohort<'a>(&'a self, id: &'a str, expected: Option<u64>, now_ms: i64) -> Answer<'a, bool> {
        Box::pin(async move {
            const TRASH: &str = "UPDATE cohort SET deleted_at_ms = $2, handle = id, revision = revision + 1
                WHERE number = $1 RETURNING revision";
            let mut write = self.begin_write(id).await?;
            let number = match self.number_at(&mut write, id, expected).await {
                Err(StoreError::CohortGone) => return Ok(false),
                number => number?,
            };
            let revision: i64 = sql(&mut write, TRASH).bind(number).bind(now_ms).scalar().await?;
            let change = NewChange::for_cohort(ChangeKind::CohortDeleted, id, engine::from_sql(revision));
            changes::record(&mut write, self.tenant(), &change, now_ms).await?;
            write.commit().await?;
            Ok(true)
        })
    }

    /// Moves the dictionary version with this id to the trash; `false` if there is none.
    ///
    /// # Errors
    /// [`StoreError::Aliased`].
    pub fn trash_dictionary<'a>(&'a self, id: &'a str, now_ms: i64) -> Answer<'a, bool> {
        Box::pin(async move {
            const TRASH: &str = "UPDATE dictionary SET deleted_at_ms = $3
                WHERE id = $1 AND tenant = $2 AND deleted_at_ms IS NULL RETURNING cohort";
            let mut write = self.begin_write(id).await?;
            let query = sql(&mut write, TRASH).bind(id).bind(self.tenant()).bind(now_ms);
            let Some(cohort) = query.optional_scalar::<String>().await? else { return Ok(false) };
            // After the statement that locks the version: an alias cannot come to name it meanwhile.
            aliases::refuse_named(&mut write, id).await?;
            let change = NewChange::for_dictionary(ChangeKind::DictionaryDeleted, id, &cohort);
            changes::record(&mut write, self.tenant(), &change, now_ms).await?;
            write.commit().await?;
            Ok(true)
        })
    }

    /// At most `limit` objects in the trash in id order, starting after the id `after`.
    ///
    /// # Errors
    /// Database errors.
    pub fn list_trash<'a>(&'a self, after: Option<&'a str>, limit: usize) -> Answer<'a, Vec<Trashed>> {
        Box::pin(async move {
            let mut query = sql(
                self.reader(),
                "SELECT * FROM (SELECT 'cohort' AS kind, id, name, 0 AS version,
                deleted_at_ms FROM cohort WHERE deleted_at_ms IS NOT NULL AND tenant = ",
            );
            query.push_bind(self.tenant());
            self.push_scope(&mut query, "id");
            query.push(
                " UNION ALL SELECT 'dictionary', id, name, version, deleted_at_ms FROM dictionary
                WHERE deleted_at_ms IS NOT NULL AND tenant = ",
            );
            query.push_bind(self.tenant());
            self.push_scope(&mut query, "cohort");
            query.push(") AS trash WHERE id > ").push_bind(after.unwrap_or_default());
            query.push(" ORDER BY id LIMIT ").push_bind(to_sql(limit as u64));
            query.all().await?.iter().map(read_trashed).collect()
        })
    }

    /// Restores the object with this id from the trash; `None` if it is not there.
    ///
    /// # Errors
    /// [`StoreError::NameTaken`] if another cohort has taken its name in the meantime.
    pub fn restore<'a>(&'a self, id: &'a str, now_ms: i64) -> Answer<'a, Option<TrashedKind>> {
        Box::pin(async move {
            let mut write = self.begin_write(id).await?;
            let kind = if self.restore_cohort(&mut write, id, now_ms).await? {
                TrashedKind::Cohort
            } else if self.restore_dictionary(&mut write, id, now_ms).await? {
                TrashedKind::Dictionary
            } else {
                return Ok(None);
            };
            write.commit().await?;
            Ok(Some(kind))
        })
    }

    async fn restore_cohort(
        &self,
        write: &mut Transaction,
        id: &str,
        now_ms: i64,
    ) -> Result<bool, StoreError> {
        const NAME: &str =
            "SELECT name FROM cohort WHERE id = $1 AND tenant = $2 AND deleted_at_ms IS NOT NULL";
        const RESTORE: &str = "UPDATE cohort SET deleted_at_ms = NULL, handle = $2, revision = revision + 1
            WHERE id = $1 RETURNING revision";
        if !self.principal.may_use(id) {
            return Ok(false);
        }
        let query = sql(&mut *write, NAME).bind(id).bind(self.tenant());
        let Some(name) = query.optional_scalar::<String>().await? else { return Ok(false) };
        let restored = sql(&mut *write, RESTORE).bind(id).bind(self.handle(&name)).scalar::<i64>().await;
        let revision = match restored {
            Err(error) if engine::is_duplicate(&error, "cohort", "handle") => {
                return Err(StoreError::NameTaken { name });
            }
            revision => engine::from_sql(revision?),
        };
        let change = NewChange::for_cohort(ChangeKind::CohortRestored, id, revision);
        changes::record(write, self.tenant(), &change, now_ms).await?;
        Ok(true)
    }

    async fn restore_dictionary(
        &self,
        write: &mut Transaction,
        id: &str,
        now_ms: i64,
    ) -> Result<bool, StoreError> {
        let mut query = sql(&mut *write, "UPDATE dictionary SET deleted_at_ms = NULL WHERE id = ");
        query.push_bind(id).push(" AND deleted_at_ms IS NOT NULL AND tenant = ").push_bind(self.tenant());
        self.push_scope(&mut query, "cohort");
        query.push(" RETURNING cohort");
        let Some(cohort) = query.optional_scalar::<String>().await? else { return Ok(false) };
        let change = NewChange::for_dictionary(ChangeKind::DictionaryRestored, id, &cohort);
        changes::record(write, self.tenant(), &change, now_ms).await?;
        Ok(true)
    }

    /// Permanently removes the object with this id from the trash; `false` if it is not there.
    ///
    /// # Errors
    /// Database errors.
    pub fn remove_trashed<'a>(&'a self, id: &'a str) -> Answer<'a, bool> {
        Box::pin(async move {
            let mut query =
                sql(self.writer(), "DELETE FROM dictionary WHERE deleted_at_ms IS NOT NULL AND tenant = ");
            query.push_bind(self.tenant()).push(" AND id = ").push_bind(id);
            self.push_scope(&mut query, "cohort");
            if query.execute().await? > 0 {
                return Ok(true);
            }
            const IS_TRASHED: &str =
                "SELECT count(*) FROM cohort WHERE id = $1 AND tenant = $2 AND deleted_at_ms IS NOT NULL";
            let trashed: i64 = sql(self.reader(), IS_TRASHED).bind(id).bind(self.tenant()).scalar().await?;
            Ok(trashed > 0 && self.principal.may_use(id) && self.remove_cohort(id).await?)
        })
    }

    /// Permanently removes objects that any tenant moved to the trash before a time; returns the number of objects.
    ///
    /// # Errors
    /// Database errors.
    pub fn purge_trash(&self, before_ms: i64) -> Answer<'_, u64> {
        Box::pin(async move {
            const COHORTS: &str = "DELETE FROM cohort WHERE id IN
                (SELECT id FROM cohort WHERE deleted_at_ms < $1 LIMIT $2)";
            const DICTIONARIES: &str = "DELETE FROM dictionary WHERE id IN
                (SELECT id FROM dictionary WHERE deleted_at_ms < $1 LIMIT $2)";
            let mut removed = 0;
            for statement in [COHORTS, DICTIONARIES] {
                removed +=
                    sql(self.writer(), statement).bind(before_ms).bind(PURGED_AT_ONCE).execute().await?;
            }
            self.purge(super::handle::PURGE_ORPHANS, None).await?;
            Ok(removed)
        })
    }
}

fn read_trashed(row: &Row) -> Result<Trashed, StoreError> {
    let version: i64 = row.get("version")?;
    Ok(Trashed {
        kind: if row.get::<&str>("kind")? == "cohort" {
            TrashedKind::Cohort
        } else {
            TrashedKind::Dictionary
        },
        id: row.get("id")?,
        name: row.get("name")?,
        version: (version > 0).then(|| engine::from_sql(version)),
        deleted_at_ms: row.get("deleted_at_ms")?,
    })
}
