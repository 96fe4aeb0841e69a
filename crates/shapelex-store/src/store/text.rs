//! Small values as text columns.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::error::StoreError;

/// JSON, or the bare word when it is one.
pub(super) fn to_text(value: &impl Serialize) -> String {
    match serde_json::to_value(value).expect("plain enums are JSON") {
        Value::String(word) => word,
        value => value.to_string(),
    }
}

/// The value that [`to_text`] wrote.
///
/// # Errors
/// [`StoreError::Damaged`].
pub(super) fn from_text<T: DeserializeOwned>(text: &str) -> Result<T, StoreError> {
    serde_json::from_str(text)
        .or_else(|_| serde_json::from_value(Value::from(text)))
        .map_err(|e| StoreError::Damaged { detail: format!("unreadable {text:?}: {e}") })
}
