//! JSON text to values.

use serde::de::DeserializeOwned;

use super::bounds::{self, Bounds};
use super::fault::{Fault, json_pointer};

/// Parses `T` from JSON text. The types of this layer collect their own faults and keep no more data than `bounds` allow.
///
/// # Errors
/// Text that is not JSON, with a pointer to the place.
pub fn parse<T: DeserializeOwned>(bounds: Bounds, text: &[u8]) -> Result<T, Fault> {
    bounds::within(bounds, || {
        // Tracking the path costs time: only failed text is parsed again with it.
        serde_json::from_slice(text).or_else(|_| parse_tracked(text))
    })
}

fn parse_tracked<T: DeserializeOwned>(text: &[u8]) -> Result<T, Fault> {
    let mut deserializer = serde_json::Deserializer::from_slice(text);
    let value: T = serde_path_to_error::deserialize(&mut deserializer).map_err(|error| {
        let pointer = json_pointer(error.path());
        let index = pointer.strip_prefix("/shapes/").and_then(|rest| rest.split('/').next()?.parse().ok());
        let detail = format!("not valid JSON: {}", error.inner());
        Fault { index, ..Fault::new(pointer, detail) }
    })?;
    deserializer.end().map_err(|error| Fault::new("", format!("not valid JSON: {error}")))?;
    Ok(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_place_of_bad_text_is_named() {
        let read = |text: &str| parse::<Vec<Vec<u8>>>(Bounds::default(), text.as_bytes());
        assert_eq!(read("[[1], [2]]").unwrap(), [[1], [2]]);
        assert_eq!(read("[[1], [2, 300]]").unwrap_err().pointer, "/1/1");
        let fault = read("[[1]] [2]").unwrap_err();
        assert!(
            fault.pointer.is_empty() && fault.detail.starts_with("not valid JSON: trailing"),
            "{fault:?}"
        );
    }
}
