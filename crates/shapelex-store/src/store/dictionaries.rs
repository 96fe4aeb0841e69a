//! Dictionaries: versions under a name, each written once.

use serde::de::DeserializeOwned;

use super::answer::Answer;
use super::engine::{Row, Transaction, sql};
use super::engine::{from_sql, to_sql};
use super::error::StoreError;
use super::handle::{Store, handle};
use super::{changes, receipts};
use crate::domain::change::{ChangeKind, NewChange};
use crate::domain::dictionary::{Dictionary, Listed, NewDictionary};
use crate::domain::retry::Receipt;

/// Filter for lists of versions; all conditions must hold.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct DictionaryFilter {
    /// Versions of this name.
    pub name: Option<String>,
    /// Versions learnt from the cohort with this id.
    pub cohort: Option<String>,
}

/// Columns read for a list.
const LISTED: &str = "id, name, version, summary, provenance, digest, created_at_ms";

impl Store {
    /// Stores a dictionary as the next version of its name; returns the version number.
    ///
    /// # Errors
    /// [`StoreError::AlreadyDone`].
    pub fn add_dictionary<'a>(
        &'a self,
        new: &'a NewDictionary,
        receipt: Option<&'a Receipt>,
    ) -> Answer<'a, u64> {
        Box::pin(async move {
            let mut write = self.begin_write(&self.handle(&new.name)).await?;
            receipts::keep(&mut write, self.tenant(), receipt, new.created_at_ms).await?;
            let version = insert(&mut write, self.tenant(), new, new.created_at_ms).await?;
            write.commit().await?;
            Ok(version)
        })
    }

    /// Id of the version with this id, this `name@version`, this `name@alias`, or the latest version of this name.
    ///
    /// # Errors
    /// Database errors.
    pub fn find_dictionary_id<'a>(&'a self, key: &'a str) -> Answer<'a, Option<String>> {
        Box::pin(async move {
            // Another process may change the content of a shared database; a key may be restricted to some cohorts.
            if self.inner.lock.is_none() || self.principal.cohorts.is_some() {
                return self.find_version("SELECT id", key).await;
            }
            let (names, writes) = (&self.inner.names, self.inner.writes.now());
            if let Some(id) = names.find(self.tenant(), key, writes) {
                return Ok(Some(id));
            }
            let found = self.find_version("SELECT id", key).await?;
            if let Some(id) = &found {
                names.keep(self.tenant(), key, writes, id);
            }
            Ok(found)
        })
    }

    /// Name of the dictionary that `key` means, as [`Store::find_dictionary_id`] reads it.
    ///
    /// # Errors
    /// Database errors.
    pub fn find_dictionary_name<'a>(&'a self, key: &'a str) -> Answer<'a, Option<String>> {
        Box::pin(async move { self.find_version("SELECT name", key).await })
    }

    /// Text selected of the version with this key.
    async fn find_version(&self, select: &'static str, key: &str) -> Result<Option<String>, StoreError> {
        let mut query = sql(self.reader(), select);
        query.push(" FROM dictionary WHERE deleted_at_ms IS NULL AND tenant = ").push_bind(self.tenant());
        self.push_scope(&mut query, "cohort");
        match key.rsplit_once('@') {
            Some((name, text)) => {
                let handle = self.handle(name);
                query.push(" AND handle = ").push_bind(handle.clone());
                // An alias begins with a letter.
                if let Ok(version) = text.parse::<i64>() {
                    query.push(" AND version = ").push_bind(version);
                } else {
                    query.push(" AND id = (SELECT dictionary FROM dictionary_alias WHERE handle = ");
                    query.push_bind(handle).push(" AND alias = ").push_bind(text).push(")");
                }
            }
            None => {
                query.push(" AND (id = ").push_bind(key).push(" OR handle = ").push_bind(self.handle(key));
                // Names never have the form of an id, so at most one of the conditions matches.
                query.push(") ORDER BY version DESC LIMIT 1");
            }
        }
        Ok(query.optional_scalar().await?)
    }

    /// Reads the version with this id and verifies its content against its digest.
    ///
    /// # Errors
    /// [`StoreError::Damaged`].
    pub fn read_dictionary<'a>(&'a self, id: &'a str) -> Answer<'a, Option<Dictionary>> {
        Box::pin(async move {
            const READ: &str = "SELECT d.id, d.name, d.version, d.summary, d.provenance, d.digest,
                d.created_at_ms, t.content
                FROM dictionary AS d JOIN dictionary_data AS t ON t.dictionary = d.id
                WHERE d.id = $1 AND d.tenant = $2 AND d.deleted_at_ms IS NULL";
            let row = sql(self.reader(), READ).bind(id).bind(self.tenant()).optional().await?;
            let Some(row) = row else { return Ok(None) };
            let Listed { id, name, version, provenance, digest, created_at_ms, .. } = read_listed(&row)?;
            let bytes: &[u8] = row.get("content")?;
            if blake3::hash(bytes).to_hex().as_str() != digest {
                return Err(StoreError::Damaged {
                    detail: format!("dictionary {id} does not have its digest"),
                });
            }
            let content = from_json(bytes)?;
            Ok(Some(Dictionary { id, name, version, content, provenance, digest, created_at_ms }))
        })
    }

    /// Accumulated sums from which learning can continue, if the version has them.
    ///
    /// # Errors
    /// [`StoreError::Damaged`].
    pub fn read_dictionary_state<'a>(&'a self, id: &'a str) -> Answer<'a, Option<Vec<u8>>> {
        Box::pin(async move {
            const READ: &str = "SELECT state, state_checksum FROM dictionary_data WHERE dictionary = $1";
            let row = sql(self.reader(), READ).bind(id).optional().await?;
            let Some(row) = row else { return Ok(None) };
            let (state, checksum): (Option<Vec<u8>>, Option<Vec<u8>>) =
                (row.get("state")?, row.get("state_checksum")?);
            if state.as_deref().map(checksum_of) == checksum {
                return Ok(state);
            }
            Err(StoreError::Damaged {
                detail: format!("the state of dictionary {id} does not match its checksum"),
            })
        })
    }

    /// At most `limit` versions in id order, starting after the id `after`.
    ///
    /// # Errors
    /// Database errors.
    pub fn list_dictionaries<'a>(
        &'a self,
        filter: &'a DictionaryFilter,
        after: Option<&'a str>,
        limit: usize,
    ) -> Answer<'a, Vec<Listed>> {
        Box::pin(async move {
            let mut query = sql(self.reader(), "SELECT ");
            query.push(LISTED).push(" FROM dictionary WHERE deleted_at_ms IS NULL AND tenant = ");
            query.push_bind(self.tenant()).push(" AND id > ").push_bind(after.unwrap_or_default());
            self.push_scope(&mut query, "cohort");
            if let Some(name) = &filter.name {
                query.push(" AND handle = ").push_bind(self.handle(name));
            }
            if let Some(cohort) = &filter.cohort {
                query.push(" AND cohort = ").push_bind(cohort.as_str());
            }
            query.push(" ORDER BY id LIMIT ").push_bind(to_sql(limit as u64));
            let rows = query.all().await?;
            rows.iter().map(read_listed).collect()
        })
    }
}

/// Inserts a dictionary as the next version of its name, as the last part of a transaction.
pub(super) async fn insert(
    write: &mut Transaction,
    tenant: &str,
    new: &NewDictionary,
    now_ms: i64,
) -> Result<u64, StoreError> {
    const NUMBER: &str = "INSERT INTO dictionary_name (handle, versions) VALUES ($1, 1)
        ON CONFLICT (handle) DO UPDATE SET versions = dictionary_name.versions + 1 RETURNING versions";
    const INSERT: &str = "INSERT INTO dictionary
        (id, name, version, cohort, summary, provenance, digest, created_at_ms, tenant, handle)
        VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10)";
    const DATA: &str = "INSERT INTO dictionary_data (dictionary, content, state, state_checksum)
        VALUES ($1, $2, $3, $4)";
    let version: i64 = sql(&mut *write, NUMBER).bind(handle(tenant, &new.name)).scalar().await?;
    sql(&mut *write, INSERT)
        .bind(&new.id)
        .bind(&new.name)
        .bind(version)
        .bind(&new.provenance.cohort)
        .bind(to_json(&new.summary))
        .bind(to_json(&new.provenance))
        .bind(&new.digest)
        .bind(new.created_at_ms)
        .bind(tenant)
        .bind(handle(tenant, &new.name))
        .execute()
        .await?;
    sql(&mut *write, DATA)
        .bind(&new.id)
        .bind(&new.content)
        .bind(&new.state)
        .bind(new.state.as_deref().map(checksum_of))
        .execute()
        .await?;
    let change = NewChange::for_dictionary(ChangeKind::DictionaryAdded, &new.id, &new.provenance.cohort);
    changes::record(write, tenant, &change, now_ms).await?;
    Ok(from_sql(version))
}

/// Checksum stored with the state of a dictionary.
pub(super) fn checksum_of(bytes: &[u8]) -> Vec<u8> {
    blake3::hash(bytes).as_bytes().to_vec()
}

fn to_json(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value).expect("plain structures are JSON")
}

fn from_json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, StoreError> {
    serde_json::from_slice(bytes)
        .map_err(|e| StoreError::Damaged { detail: format!("unreadable dictionary: {e}") })
}

fn read_listed(row: &Row) -> Result<Listed, StoreError> {
    let json = |column: &str| -> Result<&[u8], StoreError> { Ok(row.get::<&str>(column)?.as_bytes()) };
    Ok(Listed {
        id: row.get("id")?,
        name: row.get("name")?,
        version: from_sql(row.get("version")?),
        summary: from_json(json("summary")?)?,
        provenance: from_json(json("provenance")?)?,
        digest: row.get("digest")?,
        created_at_ms: row.get("created_at_ms")?,
    })
}
