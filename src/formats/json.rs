//! JSON text to values.

use serde::de::DeserializeOwned;

use super::bounds::{self, Bounds};
use super::fault::{Fault, json_pointer};
use super::words::plain;

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

/// Values of the lines of a text.
#[derive(Debug)]
pub struct Lines<T> {
    /// Values, or faults of lines that are not JSON, as many as the bounds allow.
    pub items: Vec<Result<T, Fault>>,
    /// Numbers of their lines, from 1.
    pub numbers: Vec<u64>,
    /// Number of all lines that are not blank.
    pub count: usize,
}

/// Parses a `T` from every line of a text; blank lines are skipped. The bounds are those of the whole text.
pub fn parse_lines<T: DeserializeOwned>(bounds: Bounds, text: &[u8]) -> Lines<T> {
    let mut lines = Lines { items: Vec::new(), numbers: Vec::new(), count: 0 };
    bounds::within(bounds, || {
        for (line, number) in text.split(|byte| *byte == b'\n').zip(1..) {
            if line.iter().all(u8::is_ascii_whitespace) {
                continue;
            }
            lines.count += 1;
            if lines.items.len() < bounds.items {
                let item = serde_json::from_slice(line).or_else(|_| parse_tracked(line));
                // The fault is that of the whole line, of which nothing is known then.
                lines.items.push(item.map_err(|fault| Fault { pointer: String::new(), ..fault }));
                lines.numbers.push(number);
            }
        }
    });
    lines
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
    fn each_line_is_a_text_of_its_own() {
        let bounds = Bounds { items: 3, ..Bounds::default() };
        let lines: Lines<u8> = parse_lines(bounds, b"1\r\n\n2 3\n  \n4\n5\n6");
        assert_eq!((lines.numbers, lines.count), (vec![1, 3, 5], 5));
        let faulty: Vec<_> = lines.items.iter().map(|item| item.as_ref().err().map(|f| &f.detail)).collect();
        let said = "not valid JSON (line 1, column 3): expected the end of the text, got more".to_owned();
        assert_eq!(faulty, [None, Some(&said), None]);
        assert_eq!(parse_lines::<u8>(bounds, b" \n").count, 0);
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
