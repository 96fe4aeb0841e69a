//! Idempotent requests: the outcome of a request is stored under the key that the client gave.

use serde_json::Value;

/// Idempotency key of a request, with the request's fingerprint.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RetryKey {
    /// Value of `Idempotency-Key`.
    pub key: String,
    /// Digest of the request; the same key with a different request is an error.
    pub fingerprint: [u8; 32],
}

/// Stored outcome of a request.
#[derive(Debug, Clone, PartialEq)]
pub struct Receipt {
    /// Key and fingerprint of the request.
    pub request: RetryKey,
    /// Data needed to repeat the response.
    pub outcome: Value,
}

impl Receipt {
    /// Whether the outcome was of shapes that were erased since, and is not kept any more.
    pub fn is_forgotten(&self) -> bool {
        self.outcome.is_null()
    }
}

/// Maximum length of a key in characters.
pub const MAX_KEY_CHARS: usize = 255;

/// Key of the writes of the job with this id. No client has it: it begins with a character that is not printable.
pub fn job_key(id: &str) -> String {
    format!("{JOB_MARK}{id}")
}

/// First character of the keys of jobs.
pub const JOB_MARK: char = '\u{1}';
/// First character of the stored form of a key once it may name shapes that were erased.
const HIDDEN_MARK: char = '\u{2}';

/// Stored form of a key once it may name shapes that were erased: a digest.
pub fn hidden_key(key: &str) -> String {
    if key.starts_with(HIDDEN_MARK) {
        return key.into();
    }
    format!("{HIDDEN_MARK}{}", blake3::hash(key.as_bytes()).to_hex())
}

/// Whether `key` is valid: 1 to [`MAX_KEY_CHARS`] printable ASCII characters.
pub fn is_key(key: &str) -> bool {
    (1..=MAX_KEY_CHARS).contains(&key.len())
        && key.bytes().all(|byte| byte.is_ascii_graphic() || byte == b' ')
}
