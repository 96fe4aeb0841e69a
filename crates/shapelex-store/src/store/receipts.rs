//! Receipts: stored outcomes of idempotent requests. They are kept when shapes are erased, so that a repeated request does not store these
//! again, but lose their facts about them.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::{Value, json};

use super::answer::Answer;
use super::engine::{self, Row, Transaction, sql};
use super::error::StoreError;
use super::handle::Store;
use crate::domain::id;
use crate::domain::retry::{Receipt, RetryKey, hidden_key};

/// Receipts read at once while shapes are erased: each may list 100 000 shapes.
const PAGE: i64 = 4;
/// Length of the id of a shape.
const ID_CHARS: usize = id::SHAPE.len() + 33;

/// Retention period of receipts in milliseconds.
pub const KEPT_MS: i64 = 7 * 24 * 3_600_000;

impl Store {
    /// Outcome of the request with this key.
    ///
    /// # Errors
    /// [`StoreError::Damaged`].
    pub fn find_receipt<'a>(&'a self, key: &'a str) -> Answer<'a, Option<Receipt>> {
        Box::pin(async move {
            const FIND: &str =
                "SELECT fingerprint, outcome FROM receipt WHERE tenant = $1 AND key IN ($2, $3)";
            let query = sql(self.reader(), FIND).bind(self.tenant()).bind(key).bind(hidden_key(key));
            let row = query.optional().await?;
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

/// Facts about erased shapes that receipts must forget.
#[derive(Debug)]
pub(super) struct Forgotten<'a> {
    /// Ids of the shapes.
    pub(super) ids: BTreeSet<&'a str>,
    /// Their external ids, and the subject, which a key may hold.
    pub(super) names: BTreeSet<&'a str>,
    /// Those stored by the uploads of a time, in milliseconds since 1970 UTC.
    pub(super) added: BTreeMap<i64, BTreeSet<&'a str>>,
}

/// Removes from the receipts of a tenant their facts about erased shapes.
pub(super) async fn forget(
    write: &mut Transaction,
    tenant: &str,
    forgotten: &Forgotten<'_>,
) -> Result<(), StoreError> {
    const RECEIPTS: &str = "SELECT key, outcome, created_at_ms FROM receipt
        WHERE tenant = $1 AND key > $2 AND created_at_ms >= $3 ORDER BY key LIMIT $4";
    let Some(first) = forgotten.added.keys().next() else { return Ok(()) };
    let mut after = String::new();
    loop {
        let page = sql(&mut *write, RECEIPTS).bind(tenant).bind(&after).bind(*first).bind(PAGE);
        let rows = page.all().await?;
        let Some(last) = rows.last() else { return Ok(()) };
        after = last.get("key")?;
        for row in &rows {
            forget_in(write, tenant, row, forgotten).await?;
        }
    }
}

async fn forget_in(
    write: &mut Transaction,
    tenant: &str,
    row: &Row,
    forgotten: &Forgotten<'_>,
) -> Result<(), StoreError> {
    const WRITE: &str = "UPDATE receipt SET key = $3, outcome = $4 WHERE tenant = $1 AND key = $2";
    let (key, text): (&str, &str) = (row.get("key")?, row.get("outcome")?);
    let added = forgotten.added.get(&row.get("created_at_ms")?);
    let named = named_in(text, forgotten);
    let is_concerned = added.is_some() || !named.is_empty();
    if !is_concerned && !forgotten.names.iter().any(|name| key.contains(name)) {
        return Ok(());
    }
    let outcome = match serde_json::from_str(text) {
        Ok(outcome) if is_concerned => {
            let count = added.map_or(0, |added| match named.len() {
                0 => added.len(),
                _ => added.intersection(&named).count(),
            });
            without(outcome, forgotten, count as u64).to_string()
        }
        _ => text.to_owned(),
    };
    let query = sql(write, WRITE).bind(tenant).bind(key).bind(hidden_key(key)).bind(outcome);
    query.execute().await?;
    Ok(())
}

/// Ids of the shapes that a text names.
fn named_in<'a>(text: &str, forgotten: &Forgotten<'a>) -> BTreeSet<&'a str> {
    let ids = text.match_indices(id::SHAPE).filter_map(|(at, _)| text.get(at..at + ID_CHARS));
    ids.filter_map(|id| forgotten.ids.get(id).copied()).collect()
}

/// The outcome of an upload without the shapes, `count` of which it had added. One that has shapes beside those of the upload, such as
/// objects that were segmented, is not kept at all.
fn without(outcome: Value, forgotten: &Forgotten<'_>, count: u64) -> Value {
    let Value::Object(mut stored) = outcome else { return outcome };
    let Some(added) = stored.get("added").and_then(Value::as_u64) else { return Value::Object(stored) };
    let is_kept = |id: &Value| id.as_str().is_some_and(|id| !forgotten.ids.contains(id));
    if let Some(note) = stored.remove("note")
        && (note.get("results").is_some() || note.get("shapes").is_some())
    {
        return Value::Null;
    }
    stored.insert("added".into(), json!(added.saturating_sub(count)));
    // Shapes that were refused may be of the subject too.
    if let Some(Value::Array(results)) = stored.get_mut("results") {
        results.retain(|result| is_kept(&result["id"]));
    }
    if let Some(Value::Array(ids)) = stored.get_mut("ids") {
        ids.iter_mut().filter(|id| !is_kept(id)).for_each(|id| *id = Value::Null);
    }
    Value::Object(stored)
}
