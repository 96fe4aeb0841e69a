//! Dictionaries: versions under a name, each written once.

use serde::de::DeserializeOwned;
use sqlx::sqlite::SqliteRow;
use sqlx::{QueryBuilder, Row, Sqlite, SqliteConnection};

use super::{Store, StoreError, from_sql, to_sql};
use crate::domain::dictionary::{Dictionary, Listed, NewDictionary};

/// Which versions a list shows: all conditions must hold.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct DictionaryFilter {
    /// Versions of this name.
    pub name: Option<String>,
    /// Learnt from the cohort with this id.
    pub cohort: Option<String>,
}

/// Columns of a list.
const LISTED: &str = "id, name, version, summary, provenance, digest, created_at_ms";

impl Store {
    /// Stores a dictionary as the next version of its name, and answers the number of the version.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn add_dictionary(&self, new: &NewDictionary) -> Result<u64, StoreError> {
        let mut write = self.begin_write().await?;
        let version = insert(&mut write, new).await?;
        write.commit().await?;
        Ok(version)
    }

    /// Id of the version with this id, of this `name@version`, or of the latest version of this name.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn find_dictionary_id(&self, key: &str) -> Result<Option<String>, StoreError> {
        const BY_VERSION: &str = "SELECT id FROM dictionary WHERE name = $1 AND version = $2";
        const BY_KEY: &str = "SELECT id FROM dictionary WHERE id = $1
            UNION ALL SELECT * FROM (SELECT id FROM dictionary WHERE name = $1 ORDER BY version DESC LIMIT 1)
            LIMIT 1";
        let query = match key.rsplit_once('@') {
            Some((name, version)) => {
                let Ok(version) = version.parse::<i64>() else { return Ok(None) };
                sqlx::query_scalar(BY_VERSION).bind(name).bind(version)
            }
            None => sqlx::query_scalar(BY_KEY).bind(key),
        };
        Ok(query.fetch_optional(self.reader()).await?)
    }

    /// The version with this id; its content is verified against its digest.
    ///
    /// # Errors
    /// [`StoreError::Damaged`].
    pub async fn read_dictionary(&self, id: &str) -> Result<Option<Dictionary>, StoreError> {
        const READ: &str = "SELECT d.id, d.name, d.version, d.summary, d.provenance, d.digest,
            d.created_at_ms, t.content
            FROM dictionary AS d JOIN dictionary_data AS t ON t.dictionary = d.id WHERE d.id = $1";
        let row = sqlx::query(READ).bind(id).fetch_optional(self.reader()).await?;
        let Some(row) = row else { return Ok(None) };
        let Listed { id, name, version, provenance, digest, created_at_ms, .. } = read_listed(&row)?;
        let bytes: &[u8] = row.try_get("content")?;
        if blake3::hash(bytes).to_hex().as_str() != digest {
            return Err(StoreError::Damaged { detail: format!("dictionary {id} does not have its digest") });
        }
        let content = from_json(bytes)?;
        Ok(Some(Dictionary { id, name, version, content, provenance, digest, created_at_ms }))
    }

    /// The sums that learning can go on from, when the version has them.
    ///
    /// # Errors
    /// [`StoreError::Damaged`].
    pub async fn read_dictionary_state(&self, id: &str) -> Result<Option<Vec<u8>>, StoreError> {
        const READ: &str = "SELECT state, state_checksum FROM dictionary_data WHERE dictionary = $1";
        let row = sqlx::query(READ).bind(id).fetch_optional(self.reader()).await?;
        let Some(row) = row else { return Ok(None) };
        let (state, checksum): (Option<Vec<u8>>, Option<Vec<u8>>) =
            (row.try_get("state")?, row.try_get("state_checksum")?);
        if state.as_deref().map(checksum_of) == checksum {
            return Ok(state);
        }
        Err(StoreError::Damaged { detail: format!("the state of dictionary {id} is not what was written") })
    }

    /// At most `limit` versions in the order of their ids, from the one after the id `after`.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn list_dictionaries(
        &self,
        filter: &DictionaryFilter,
        after: Option<&str>,
        limit: usize,
    ) -> Result<Vec<Listed>, StoreError> {
        let mut query = QueryBuilder::<Sqlite>::new("SELECT ");
        query.push(LISTED).push(" FROM dictionary WHERE id > ").push_bind(after.unwrap_or_default());
        if let Some(name) = &filter.name {
            query.push(" AND name = ").push_bind(name);
        }
        if let Some(cohort) = &filter.cohort {
            query.push(" AND cohort = ").push_bind(cohort);
        }
        query.push(" ORDER BY id LIMIT ").push_bind(to_sql(limit as u64));
        let rows = query.build().fetch_all(self.reader()).await?;
        rows.iter().map(read_listed).collect()
    }

    /// Deletes the version with this id; false when there is none.
    ///
    /// # Errors
    /// Those of the database.
    pub async fn delete_dictionary(&self, id: &str) -> Result<bool, StoreError> {
        let deleted = sqlx::query("DELETE FROM dictionary WHERE id = $1").bind(id).execute(&self.0.writer);
        Ok(deleted.await?.rows_affected() > 0)
    }
}

/// Inserts a dictionary as the next version of its name, as part of a transaction.
pub(super) async fn insert(write: &mut SqliteConnection, new: &NewDictionary) -> Result<u64, StoreError> {
    const NUMBER: &str = "INSERT INTO dictionary_name (name, versions) VALUES ($1, 1)
        ON CONFLICT (name) DO UPDATE SET versions = versions + 1 RETURNING versions";
    const INSERT: &str = "INSERT INTO dictionary
        (id, name, version, cohort, summary, provenance, digest, created_at_ms)
        VALUES ($1, $2, $3, $4, $5, $6, $7, $8)";
    const DATA: &str = "INSERT INTO dictionary_data (dictionary, content, state, state_checksum)
        VALUES ($1, $2, $3, $4)";
    let version: i64 = sqlx::query_scalar(NUMBER).bind(&new.name).fetch_one(&mut *write).await?;
    sqlx::query(INSERT)
        .bind(&new.id)
        .bind(&new.name)
        .bind(version)
        .bind(&new.provenance.cohort)
        .bind(to_json(&new.summary))
        .bind(to_json(&new.provenance))
        .bind(&new.digest)
        .bind(new.created_at_ms)
        .execute(&mut *write)
        .await?;
    sqlx::query(DATA)
        .bind(&new.id)
        .bind(&new.content)
        .bind(&new.state)
        .bind(new.state.as_deref().map(checksum_of))
        .execute(&mut *write)
        .await?;
    Ok(from_sql(version))
}

fn checksum_of(bytes: &[u8]) -> Vec<u8> {
    blake3::hash(bytes).as_bytes().to_vec()
}

fn to_json(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value).expect("plain structures are JSON")
}

fn from_json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, StoreError> {
    serde_json::from_slice(bytes)
        .map_err(|e| StoreError::Damaged { detail: format!("unreadable dictionary: {e}") })
}

fn read_listed(row: &SqliteRow) -> Result<Listed, StoreError> {
    let json = |column: &str| -> Result<&[u8], StoreError> { Ok(row.try_get::<&str, _>(column)?.as_bytes()) };
    Ok(Listed {
        id: row.try_get("id")?,
        name: row.try_get("name")?,
        version: from_sql(row.try_get("version")?),
        summary: from_json(json("summary")?)?,
        provenance: from_json(json("provenance")?)?,
        digest: row.try_get("digest")?,
        created_at_ms: row.try_get("created_at_ms")?,
    })
}
