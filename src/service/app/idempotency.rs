//! Idempotent requests: executed once, answered as often as they are sent.
//!
//! The effect of a request with an `Idempotency-Key` and its receipt are written in one transaction. A repetition of
//! the request finds the receipt and is answered from it; a different request with the same key is refused. A crash
//! never leaves the effect without its receipt, nor the receipt without the effect.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::context::App;
use super::error::ServiceError;
use crate::domain::retry::{MAX_KEY_CHARS, Receipt, RetryKey, is_key, job_key};
use crate::wire::json;

/// An idempotent request, as far as it has been read.
#[derive(Debug, Clone)]
pub struct Retry {
    key: String,
    /// Digest of the target and the part of the body read so far.
    read: blake3::Hasher,
}

impl Retry {
    /// A request to `target` (method and address) with the idempotency key `key`.
    ///
    /// # Errors
    /// [`ServiceError::Query`] if `key` is not a valid key.
    pub fn new(key: &str, target: &str) -> Result<Self, ServiceError> {
        if !is_key(key) {
            let detail = format!("Idempotency-Key: expected 1 to {MAX_KEY_CHARS} printable ASCII characters");
            return Err(ServiceError::Query(detail));
        }
        let mut read = blake3::Hasher::new();
        read.update(target.as_bytes()).update(b"\n");
        Ok(Self { key: key.into(), read })
    }

    /// Writes of the job with this id, which several attempts may compute.
    pub(crate) fn of_job(id: &str) -> Self {
        Self { key: job_key(id), read: blake3::Hasher::new() }
    }

    /// Adds a part of the body to the digest.
    pub(crate) fn update(&mut self, body: &[u8]) {
        self.read.update(body);
    }

    pub(crate) fn key(&self) -> RetryKey {
        RetryKey { key: self.key.clone(), fingerprint: *self.read.finalize().as_bytes() }
    }
}

impl App {
    /// The same context for a request with an idempotency key.
    pub fn with_retry(self, retry: Option<Retry>) -> Self {
        Self { retry, ..self }
    }

    /// The same context after reading this body.
    pub fn with_body(mut self, body: &[u8]) -> Self {
        if let Some(retry) = &mut self.retry {
            retry.update(body);
        }
        self
    }

    /// Receipt of the current request, if it has an idempotency key.
    pub(crate) fn receipt(&self, outcome: impl Serialize) -> Option<Receipt> {
        self.retry.as_ref().map(|retry| receipt(retry, outcome))
    }

    /// Stored outcome of the current request, if it was executed before.
    ///
    /// # Errors
    /// [`ServiceError::KeyReused`].
    pub(crate) async fn done_before<T: DeserializeOwned>(&self) -> Result<Option<T>, ServiceError> {
        match &self.retry {
            Some(retry) => done_before(self, retry).await,
            None => Ok(None),
        }
    }
}

/// Receipt of a request that has been read completely.
pub(crate) fn receipt(retry: &Retry, outcome: impl Serialize) -> Receipt {
    let outcome = json::to_value(&outcome).unwrap_or(Value::Null);
    Receipt { request: retry.key(), outcome }
}

/// Stored outcome of a request that has been read completely, if it was executed before.
///
/// # Errors
/// [`ServiceError::KeyReused`]; [`ServiceError::Deleted`] if the outcome is not kept any more.
pub(crate) async fn done_before<T: DeserializeOwned>(
    app: &App,
    retry: &Retry,
) -> Result<Option<T>, ServiceError> {
    let key = retry.key();
    let Some(found) = app.store.find_receipt(&key.key).await? else { return Ok(None) };
    if found.request != key {
        return Err(ServiceError::KeyReused);
    }
    if found.is_forgotten() {
        return Err(ServiceError::Deleted {
            kind: "answer to this request, which was carried out and named shapes that were erased since,",
        });
    }
    app.touched.note_repeat();
    let outcome = json::from_value(&found.outcome);
    outcome
        .map(Some)
        .map_err(|error| ServiceError::Internal(format!("unreadable idempotency record: {error}")))
}
