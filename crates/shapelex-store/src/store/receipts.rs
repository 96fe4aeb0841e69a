//! Receipts: stored outcomes of idempotent requests.

use super::answer::Answer;
use super::engine::{self, Transaction, sql};
use super::error::StoreError;
use super::handle::Store;
use crate::domain::retry::{Receipt, RetryKey};

/// Retention period of receipts in milliseconds.
pub const KEPT_MS: i64 = 7 * 24 * 3_600_000;

impl Store {
    /// Outcome of the request with this key.
    ///
    /// # Errors
    /// [`StoreError::Damaged`].
    pub fn find_receipt<'a>(&'a self, key: &'a str) -> Answer<'a, Option<Receipt>> {
        Box::pin(async move {
            const FIND: &str = "SELECT fingerprint, outcome FROM receipt WHERE tenant = $1 AND key = $2";
            let row = sql(self.reader(), FIND).bind(self.tenant()).bind(key).optional().await?;
            let Some(row) = row else { return Ok(None) };
            let damaged = || StoreError::Damaged { detail: "an unreadable receipt".into() };
            let fingerprint: &[u8] = row.get("fingerprint")?;
            let fingerprint = fingerprint.try_into().map_err(|_| damaged())?;
            let outcome = serde_json::from_str(row.get("outcome")?).map_err(|_| damaged())?;
            Ok(Some(Receipt { request: RetryKey { key: key.into(), fingerprint }, outcome }))
        })
    }

    /// Removes receipts older than [`KEPT_MS`].
    ///
    /// # Errors
    /// Database errors.
    pub fn prune_receipts(&self, now_ms: i64) -> Answer<'_, u64> {
        Box::pin(async move {
            const PRUNE: &str = "DELETE FROM receipt WHERE created_at_ms < $1";
            Ok(sql(self.writer(), PRUNE).bind(now_ms - KEPT_MS).execute().await?)
        })
    }
}

/// Stores a receipt, if there is one, within the transaction that executes the request.
///
/// # Errors
/// [`StoreError::AlreadyDone`] if a request with this key was already done: the transaction must not be committed.
pub(super) async fn keep(
    write: &mut Transaction,
    tenant: &str,
    receipt: Option<&Receipt>,
    now_ms: i64,
) -> Result<(), StoreError> {
    const KEEP: &str = "INSERT INTO receipt (tenant, key, fingerprint, outcome, created_at_ms)
        VALUES ($1, $2, $3, $4, $5)";
    let Some(receipt) = receipt else { return Ok(()) };
    let kept = sql(write, KEEP)
        .bind(tenant)
        .bind(receipt.request.key.as_str())
        .bind(receipt.request.fingerprint.as_slice())
        .bind(receipt.outcome.to_string())
        .bind(now_ms)
        .execute()
        .await;
    match kept {
        Ok(_) => Ok(()),
        Err(error) if engine::is_duplicate(&error, "receipt", "") => Err(StoreError::AlreadyDone),
        Err(error) => Err(error.into()),
    }
}
