//! API keys: create, find, list, revoke.

use super::answer::Answer;
use super::engine::to_sql;
use super::engine::{Row, sql};
use super::error::StoreError;
use super::handle::Store;
use super::text::{from_text, to_text};
use crate::domain::key::Key;

impl Store {
    /// Stores a new key.
    ///
    /// # Errors
    /// Database errors, as for all functions here.
    pub fn create_key<'a>(&'a self, key: &'a Key) -> Answer<'a, ()> {
        Box::pin(async move {
            const CREATE: &str =
                "INSERT INTO api_key (id, tenant, name, role, cohorts, digest, created_at_ms, expires_at_ms)
                VALUES ($1, $2, $3, $4, $5, $6, $7, $8)";
            sql(self.writer(), CREATE)
                .bind(key.id.as_str())
                .bind(key.tenant.as_str())
                .bind(key.name.as_str())
                .bind(key.role.as_str())
                .bind(key.cohorts.as_ref().map(to_text))
                .bind(key.digest.as_bytes().as_slice())
                .bind(key.created_at_ms)
                .bind(key.expires_at_ms)
                .execute()
                .await?;
            Ok(())
        })
    }

    /// Finds the key with this id, of any tenant.
    ///
    /// # Errors
    /// [`StoreError::Damaged`].
    pub fn find_key<'a>(&'a self, id: &'a str) -> Answer<'a, Option<Key>> {
        Box::pin(async move {
            const FIND: &str = "SELECT * FROM api_key WHERE id = $1";
            let row = sql(self.reader(), FIND).bind(id).optional().await?;
            row.as_ref().map(read_key).transpose()
        })
    }

    /// At most `limit` keys of a tenant, or of all, in id order, starting after the id `after`.
    ///
    /// # Errors
    /// [`StoreError::Damaged`].
    pub fn list_keys<'a>(
        &'a self,
        tenant: Option<&'a str>,
        after: Option<&'a str>,
        limit: usize,
    ) -> Answer<'a, Vec<Key>> {
        Box::pin(async move {
            let mut query = sql(self.reader(), "SELECT * FROM api_key WHERE id > ");
            query.push_bind(after.unwrap_or_default());
            if let Some(tenant) = tenant {
                query.push(" AND tenant = ").push_bind(tenant);
            }
            query.push(" ORDER BY id LIMIT ").push_bind(to_sql(limit as u64));
            query.all().await?.iter().map(read_key).collect()
        })
    }

    /// Whether there is any key, of any tenant and in any state.
    ///
    /// # Errors
    /// Database errors.
    pub fn has_keys(&self) -> Answer<'_, bool> {
        Box::pin(async move {
            const ANY: &str = "SELECT COUNT(*) FROM (SELECT id FROM api_key LIMIT 1) AS first_key";
            let count: i64 = sql(self.reader(), ANY).scalar().await?;
            Ok(count > 0)
        })
    }

    /// Revokes the key with this id, unless it was revoked before.
    ///
    /// # Errors
    /// Database errors.
    pub fn revoke_key<'a>(&'a self, id: &'a str, now_ms: i64) -> Answer<'a, ()> {
        Box::pin(async move {
            const REVOKE: &str =
                "UPDATE api_key SET revoked_at_ms = $2 WHERE id = $1 AND revoked_at_ms IS NULL";
            sql(self.writer(), REVOKE).bind(id).bind(now_ms).execute().await?;
            Ok(())
        })
    }

    /// Records the use of the key with this id.
    ///
    /// # Errors
    /// Database errors.
    pub fn note_key_use<'a>(&'a self, id: &'a str, now_ms: i64) -> Answer<'a, ()> {
        Box::pin(async move {
            const NOTE: &str = "UPDATE api_key SET used_at_ms = $2 WHERE id = $1";
            sql(self.writer(), NOTE).bind(id).bind(now_ms).execute().await?;
            Ok(())
        })
    }
}

fn read_key(row: &Row) -> Result<Key, StoreError> {
    let digest: &[u8] = row.get("digest")?;
    let damaged = |_| StoreError::Damaged { detail: "the digest of a key has another length".into() };
    let cohorts: Option<&str> = row.get("cohorts")?;
    Ok(Key {
        id: row.get("id")?,
        tenant: row.get("tenant")?,
        name: row.get("name")?,
        role: from_text(row.get("role")?)?,
        cohorts: cohorts.map(from_text).transpose()?,
        digest: blake3::Hash::from_bytes(digest.try_into().map_err(damaged)?),
        created_at_ms: row.get("created_at_ms")?,
        expires_at_ms: row.get("expires_at_ms")?,
        revoked_at_ms: row.get("revoked_at_ms")?,
        used_at_ms: row.get("used_at_ms")?,
    })
}
