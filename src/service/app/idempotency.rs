//! Requests that are sent again: done once, answered as often as asked.
//!
//! What a request with an `Idempotency-Key` brings about is written together with a receipt, in one transaction. The same
//! request again finds the receipt and is answered from it; another request with the same key is refused. There is no
//! moment at which a process that ends leaves one without the other.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::context::App;
use super::error::ServiceError;
use crate::domain::retry::{MAX_KEY_CHARS, Receipt, RetryKey, is_key};

/// A request that may be sent again, as far as it has been read.
#[derive(Debug, Clone)]
pub struct Retry {
    key: String,
    /// Digest of the target and of what has been read of the body.
    read: blake3::Hasher,
}

impl Retry {
    /// A request to `target` (method and address) that the client calls `key`.
    ///
    /// # Errors
    /// [`ServiceError::Query`] when `key` cannot be one.
    pub fn new(key: &str, target: &str) -> Result<Self, ServiceError> {
        if !is_key(key) {
            let detail = format!("Idempotency-Key must have 1 to {MAX_KEY_CHARS} printable ASCII characters");
            return Err(ServiceError::Query(detail));
        }
        let mut read = blake3::Hasher::new();
        read.update(target.as_bytes()).update(b"\n");
        Ok(Self { key: key.into(), read })
    }

    /// Reads on.
    pub(crate) fn update(&mut self, body: &[u8]) {
        self.read.update(body);
    }

    pub(crate) fn key(&self) -> RetryKey {
        RetryKey { key: self.key.clone(), fingerprint: *self.read.finalize().as_bytes() }
    }
}

impl App {
    /// The same service for a request that may be sent again.
    pub fn with_retry(self, retry: Option<Retry>) -> Self {
        Self { retry, ..self }
    }

    /// The same service for a request with this body.
    pub fn with_body(mut self, body: &[u8]) -> Self {
        if let Some(retry) = &mut self.retry {
            retry.update(body);
        }
        self
    }

    /// The receipt of the present request, if it may be sent again.
    pub(crate) fn receipt(&self, outcome: impl Serialize) -> Option<Receipt> {
        self.retry.as_ref().map(|retry| receipt(retry, outcome))
    }

    /// What the present request has brought about already.
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

/// The receipt of a request that has been read.
pub(crate) fn receipt(retry: &Retry, outcome: impl Serialize) -> Receipt {
    let outcome = serde_json::to_value(outcome).unwrap_or(Value::Null);
    Receipt { request: retry.key(), outcome }
}

/// What a request that has been read has brought about already.
///
/// # Errors
/// [`ServiceError::KeyReused`].
pub(crate) async fn done_before<T: DeserializeOwned>(
    app: &App,
    retry: &Retry,
) -> Result<Option<T>, ServiceError> {
    let key = retry.key();
    let Some(found) = app.store.find_receipt(&key.key).await? else { return Ok(None) };
    if found.request != key {
        return Err(ServiceError::KeyReused);
    }
    let outcome = serde_json::from_value(found.outcome);
    outcome.map(Some).map_err(|error| ServiceError::Internal(format!("an unreadable receipt: {error}")))
}
