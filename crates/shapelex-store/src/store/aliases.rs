//! Aliases of dictionaries: names for versions, which can be moved.
//!
//! A move is one row, replaced in one transaction: a request that resolves `name@alias` gets the version before or after it. An alias
//! names a version that is not in the trash, since each of the two transactions first locks the row of the version.

use super::answer::Answer;
use super::changes;
use super::engine::{Row, Transaction, from_sql, sql, to_sql};
use super::error::StoreError;
use super::handle::Store;
use crate::domain::change::{ChangeKind, NewChange};
use crate::domain::dictionary::Alias;

/// Maximum number of aliases of a name.
pub const MAX_ALIASES: u32 = 100;

/// A version that an alias is to name.
#[derive(Debug, Clone)]
pub struct AliasMove<'a> {
    /// Name of the dictionary.
    pub name: &'a str,
    /// The alias.
    pub alias: &'a str,
    /// Id of the version.
    pub id: &'a str,
    /// Number of moves that the alias must have made, if it matters.
    pub expected: Option<u64>,
}

/// Outcome of a move of an alias.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AliasMoved {
    /// It is new.
    Created,
    /// It names another version than before, or the same.
    Moved,
    /// The version is not there any more; nothing has changed.
    NoVersion,
    /// The name has [`MAX_ALIASES`]; nothing has changed.
    TooMany,
}

impl Store {
    /// The alias of a name.
    ///
    /// # Errors
    /// Database errors.
    pub fn find_alias<'a>(&'a self, name: &'a str, alias: &'a str) -> Answer<'a, Option<Alias>> {
        Box::pin(async move { Ok(self.list_aliases(name, Some(alias)).await?.pop()) })
    }

    /// Aliases of a name, or only `alias`, in alphabetic order.
    ///
    /// # Errors
    /// Database errors.
    pub fn list_aliases<'a>(&'a self, name: &'a str, alias: Option<&'a str>) -> Answer<'a, Vec<Alias>> {
        Box::pin(async move {
            const LIST: &str = "SELECT a.alias, a.moves, a.moved_at_ms, d.id, d.name, d.version, d.digest
                FROM dictionary_alias AS a JOIN dictionary AS d ON d.id = a.dictionary
                WHERE d.deleted_at_ms IS NULL AND a.tenant = ";
            let mut query = sql(self.reader(), LIST);
            query.push_bind(self.tenant()).push(" AND a.handle = ").push_bind(self.handle(name));
            self.push_scope(&mut query, "d.cohort");
            if let Some(alias) = alias {
                query.push(" AND a.alias = ").push_bind(alias);
            }
            query.push(" ORDER BY a.alias");
            query.all().await?.iter().map(read_alias).collect()
        })
    }

    /// Makes an alias name a version, at once for all who use it.
    ///
    /// # Errors
    /// [`StoreError::Changed`].
    pub fn set_alias<'a>(&'a self, wanted: &'a AliasMove<'a>, now_ms: i64) -> Answer<'a, AliasMoved> {
        Box::pin(async move {
            // Changes nothing, and keeps the version from the trash until the end of the transaction.
            const LOCK: &str = "UPDATE dictionary SET deleted_at_ms = NULL
                WHERE id = $1 AND tenant = $2 AND deleted_at_ms IS NULL RETURNING cohort";
            const FIND: &str =
                "SELECT dictionary, moves FROM dictionary_alias WHERE handle = $1 AND alias = $2";
            const COUNT: &str = "SELECT count(*) FROM dictionary_alias WHERE handle = $1";
            const SET: &str =
                "INSERT INTO dictionary_alias (handle, alias, tenant, dictionary, moves, moved_at_ms)
                VALUES ($1, $2, $3, $4, 1, $5) ON CONFLICT (handle, alias) DO UPDATE
                SET dictionary = excluded.dictionary, moves = dictionary_alias.moves + 1,
                    moved_at_ms = excluded.moved_at_ms";
            let handle = self.handle(wanted.name);
            let mut write = self.begin_write(&handle).await?;
            let version = sql(&mut write, LOCK).bind(wanted.id).bind(self.tenant());
            let Some(cohort) = version.optional_scalar::<String>().await? else {
                return Ok(AliasMoved::NoVersion);
            };
            let present = sql(&mut write, FIND).bind(&handle).bind(wanted.alias).optional().await?;
            let moves = present.as_ref().map(|row| row.get::<i64>("moves")).transpose()?;
            if wanted.expected.is_some_and(|expected| moves != Some(to_sql(expected))) {
                return Err(StoreError::Changed);
            }
            match &present {
                Some(row) if row.get::<&str>("dictionary")? == wanted.id => return Ok(AliasMoved::Moved),
                Some(_) => {}
                None => {
                    let count: i64 = sql(&mut write, COUNT).bind(&handle).scalar().await?;
                    if count >= i64::from(MAX_ALIASES) {
                        return Ok(AliasMoved::TooMany);
                    }
                }
            }
            let set = sql(&mut write, SET).bind(&handle).bind(wanted.alias).bind(self.tenant());
            set.bind(wanted.id).bind(now_ms).execute().await?;
            let change = NewChange::for_dictionary(ChangeKind::DictionaryAliasMoved, wanted.id, &cohort);
            changes::record(&mut write, self.tenant(), &change, now_ms).await?;
            write.commit().await?;
            Ok(if present.is_some() { AliasMoved::Moved } else { AliasMoved::Created })
        })
    }

    /// Removes an alias, if it has made the `expected` number of moves; `false` if there is none.
    ///
    /// # Errors
    /// [`StoreError::Changed`].
    pub fn remove_alias<'a>(
        &'a self,
        name: &'a str,
        alias: &'a str,
        expected: Option<u64>,
        now_ms: i64,
    ) -> Answer<'a, bool> {
        Box::pin(async move {
            const REMOVE: &str =
                "DELETE FROM dictionary_alias WHERE handle = $1 AND alias = $2 RETURNING dictionary, moves";
            const COHORT: &str = "SELECT cohort FROM dictionary WHERE id = $1";
            let handle = self.handle(name);
            let mut write = self.begin_write(&handle).await?;
            let removed = sql(&mut write, REMOVE).bind(&handle).bind(alias).optional().await?;
            let Some(removed) = removed else { return Ok(false) };
            let id: String = removed.get("dictionary")?;
            if expected.is_some_and(|expected| removed.get::<i64>("moves").ok() != Some(to_sql(expected))) {
                return Err(StoreError::Changed);
            }
            let cohort: String = sql(&mut write, COHORT).bind(&id).scalar().await?;
            let change = NewChange::for_dictionary(ChangeKind::DictionaryAliasRemoved, &id, &cohort);
            changes::record(&mut write, self.tenant(), &change, now_ms).await?;
            write.commit().await?;
            Ok(true)
        })
    }
}

/// Refuses a change to a version that aliases name.
///
/// # Errors
/// [`StoreError::Aliased`].
pub(super) async fn refuse_named(write: &mut Transaction, id: &str) -> Result<(), StoreError> {
    const NAMES: &str = "SELECT d.name || '@' || a.alias AS alias FROM dictionary_alias AS a
        JOIN dictionary AS d ON d.id = a.dictionary WHERE a.dictionary = $1 ORDER BY a.alias";
    let rows = sql(write, NAMES).bind(id).all().await?;
    let aliases = rows.iter().map(|row| row.get("alias")).collect::<Result<Vec<String>, _>>()?;
    if aliases.is_empty() {
        return Ok(());
    }
    Err(StoreError::Aliased { id: id.to_owned(), aliases })
}

fn read_alias(row: &Row) -> Result<Alias, StoreError> {
    Ok(Alias {
        alias: row.get("alias")?,
        id: row.get("id")?,
        name: row.get("name")?,
        version: from_sql(row.get("version")?),
        digest: row.get("digest")?,
        moves: from_sql(row.get("moves")?),
        moved_at_ms: row.get("moved_at_ms")?,
    })
}
