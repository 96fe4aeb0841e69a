//! JSON text to values.

use serde::de::DeserializeOwned;

use super::bounds::{self, Bounds};
use super::checked::plain;
use super::fault::{Fault, json_pointer};

/// Parses `T` from JSON text. The types of this layer collect their own faults and keep no more data than `bounds` allow.
///
/// # Errors
/// Text that is not JSON, with a pointer to the place, and its line and column.
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
        Fault { index, ..Fault::new(pointer, sentence(error.inner())) }
    })?;
    deserializer.end().map_err(|error| Fault::new("", sentence(&error)))?;
    Ok(value)
}

fn sentence(error: &serde_json::Error) -> String {
    format!("not valid JSON (line {}, column {}): {}", error.line(), error.column(), plain(error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_sentence_of_the_parser_is_translated() {
        let texts = [
            "",
            "[",
            "{",
            "\"",
            "{\"a\"",
            "{\"a\" 1}",
            "[1 2]",
            "{\"a\": 1 \"b\"}",
            "nul",
            "[1,]",
            "{\"a\": 1,}",
            "{1: 2}",
            "x",
            "\"\\x\"",
            "\"\\u12\"",
            "\"\\ud800\"",
            "\"\\uD800\\u0041\"",
            "\"\n\"",
            "01",
            "1.",
            "-",
            "1e",
            "1e999",
            "1 2",
            "{\"a\": nope}",
            "\"\\u00",
        ];
        let deep = "[".repeat(200);
        for text in texts.into_iter().chain([deep.as_str()]) {
            let fault = parse::<serde_json::Value>(Bounds::default(), text.as_bytes()).unwrap_err();
            let said = fault.detail;
            assert!(said.starts_with("not valid JSON (line "), "{said}");
            let (_, words) = said.split_once("): expected ").unwrap_or_else(|| panic!("{text}: {said}"));
            assert!(!words.contains('`') && !words.contains("while parsing"), "{text}: {said}");
        }
        let not_text = parse::<serde_json::Value>(Bounds::default(), b"\"\xff\"").unwrap_err();
        assert!(
            not_text.detail.ends_with("): expected text in UTF-8, got other bytes"),
            "{}",
            not_text.detail
        );
    }

    #[test]
    fn the_place_of_bad_text_is_named() {
        let read = |text: &str| parse::<Vec<Vec<u8>>>(Bounds::default(), text.as_bytes());
        assert_eq!(read("[[1], [2]]").unwrap(), [[1], [2]]);
        assert_eq!(read("[[1], [2, 300]]").unwrap_err().pointer, "/1/1");
        let fault = read("[[1]] [2]").unwrap_err();
        assert!(
            fault.pointer.is_empty()
                && fault.detail
                    == "not valid JSON (line 1, column 7): expected the end of the text, got more",
            "{fault:?}"
        );
    }
}
