//! Requests that a client may send again: what they have brought about is kept under the key that the client gives.

use serde_json::Value;

/// What a client calls a request that it may send again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RetryKey {
    /// `Idempotency-Key`.
    pub key: String,
    /// Digest of the request: the same key for another one is a mistake.
    pub fingerprint: [u8; 32],
}

/// What a request has brought about.
#[derive(Debug, Clone, PartialEq)]
pub struct Receipt {
    /// The request.
    pub request: RetryKey,
    /// What is needed to answer it again.
    pub outcome: Value,
}

/// Longest key.
pub const MAX_KEY_CHARS: usize = 255;

/// Whether `key` can be one: 1 to [`MAX_KEY_CHARS`] printable ASCII characters.
pub fn is_key(key: &str) -> bool {
    (1..=MAX_KEY_CHARS).contains(&key.len())
        && key.bytes().all(|byte| byte.is_ascii_graphic() || byte == b' ')
}
