//! JSON values that keep their own error.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer};

use super::{InputError, json_pointer};

/// A value, or what is wrong with it: one bad field does not hide the others.
///
/// For small values only: they pass through [`serde_json::Value`].
#[derive(Debug, Clone)]
pub struct Checked<T>(Result<T, InputError>);

impl<T> Checked<T> {
    /// The value; an error goes to `errors` below `pointer`.
    pub fn take(self, pointer: &str, errors: &mut Vec<InputError>) -> Option<T> {
        match self.0 {
            Ok(value) => Some(value),
            Err(error) => {
                errors.push(error.below(pointer));
                None
            }
        }
    }
}

impl<T: Default> Default for Checked<T> {
    fn default() -> Self {
        Self(Ok(T::default()))
    }
}

impl<'de, T: DeserializeOwned> Deserialize<'de> for Checked<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = serde_json::Value::deserialize(deserializer)?;
        let parsed = serde_path_to_error::deserialize(value);
        Ok(Self(
            parsed.map_err(|error| InputError::new(json_pointer(error.path()), error.inner().to_string())),
        ))
    }
}
