//! JSON text to values.

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::bounds::{self, Bounds};
use super::fault::Fault;
use super::trail;
use super::tree::{Reader, Tree, TreeError};
use super::words::plain;

/// Parses `T` from JSON text. The types of this layer collect their own faults, keep no more data than `bounds` allow, and leave
/// a trail to the place of an error.
///
/// # Errors
/// Text that is not JSON, with a pointer to the place, and its line and column.
pub fn parse<T: DeserializeOwned>(bounds: Bounds, text: &[u8]) -> Result<T, Fault> {
    bounds::within(bounds, || read(text))
}

/// Reads a record from a value.
///
/// # Errors
/// A value of another form.
pub fn from_value<T: DeserializeOwned>(value: &Value) -> Result<T, TreeError> {
    T::deserialize(Reader::of(&Tree::of(value)))
}

/// Reads a small record from JSON text.
///
/// # Errors
/// Text that is not JSON, or of another form.
pub fn from_text<T: DeserializeOwned>(text: &str) -> Result<T, TreeError> {
    T::deserialize(Reader::of(&Tree::parse(text)?))
}

/// A record as a value. It is written as text and read again, so that records are compiled for one serializer.
///
/// # Errors
/// A map whose keys are not texts.
pub fn to_value(value: &impl Serialize) -> Result<Value, serde_json::Error> {
    serde_json::from_slice(&serde_json::to_vec(value)?)
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
                // The fault is that of the whole line, of which nothing is known then.
                let whole = |fault| Fault { pointer: String::new(), ..fault };
                lines.items.push(read(line).map_err(whole));
                lines.numbers.push(number);
            }
        }
    });
    lines
}

/// Reads a text whose errors leave a trail. Steps of an earlier error that went no further would stand before those of this one.
fn read<T: DeserializeOwned>(text: &[u8]) -> Result<T, Fault> {
    trail::forget();
    serde_json::from_slice(without_mark(text)).map_err(fault)
}

/// A text without the byte order mark of UTF-8 that some programs put before it.
fn without_mark(text: &[u8]) -> &[u8] {
    text.strip_prefix("\u{feff}".as_bytes()).unwrap_or(text)
}

/// The fault of an error that has returned.
#[cold]
fn fault(error: serde_json::Error) -> Fault {
    let pointer = trail::taken();
    let index = pointer.strip_prefix("/shapes/").and_then(|rest| rest.split('/').next()?.parse().ok());
    Fault { index, ..Fault::new(pointer, sentence(&error)) }
}

fn sentence(error: &serde_json::Error) -> String {
    format!("not valid JSON (line {}, column {}): {}", error.line(), error.column(), plain(error))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::checked::{List, document};
    use crate::wire::fault::json_pointer;
    use crate::wire::merge_patch::MergePatch;
    use crate::wire::shape::{PointList, ShapeInput};

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
    fn steps_of_an_earlier_error_are_not_those_of_the_next() {
        let leave_steps = || {
            let text = br#"{"shapes": [{"points": [1, x]}]}"#;
            serde_json::from_slice::<crate::wire::tree::Tree<'_>>(text).unwrap_err();
        };
        leave_steps();
        let fault = parse::<MergePatch>(Bounds::default(), b"{\"a\": nope}").unwrap_err();
        assert_eq!((fault.pointer.as_str(), fault.index), ("/a", None));
        leave_steps();
        let lines: Lines<ShapeInput> = parse_lines(Bounds::default(), b"{\"points\": [1, x]}");
        let fault = lines.items[0].as_ref().unwrap_err();
        assert_eq!((fault.pointer.as_str(), fault.index), ("", None));
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

    document! {
        /// A document with lists and objects of all kinds.
        struct Document {
            /// Shapes.
            #[schema(ignore)]
            shapes: List<ShapeInput>, required;
            /// A shape.
            #[schema(ignore)]
            shape: ShapeInput;
            /// Points.
            #[schema(ignore)]
            grid: PointList;
            /// Values.
            #[schema(ignore)]
            patch: MergePatch;
        }
    }

    /// Path and message of a deserializer that tracks its path.
    fn tracked(text: &[u8]) -> Option<(String, String)> {
        let mut deserializer = serde_json::Deserializer::from_slice(text);
        let read = serde_path_to_error::deserialize::<_, Document>(&mut deserializer);
        trail::forget();
        if let Err(error) = read {
            return Some((json_pointer(error.path()), sentence(error.inner())));
        }
        deserializer.end().err().map(|error| (String::new(), sentence(&error)))
    }

    #[test]
    fn the_place_of_bad_text_is_the_one_of_a_reader_that_tracks_it() {
        let text = r#"{"shapes": [{"points": [[0, 1.5], [2, 3e1]], "label": "x"}, {"points": 7, "labels": {"a": [1]}}, 3],
            "shape": {"control_points": [[[0, 1], [2, "3"]], [[true, 5], {"a": 1}]], "weight": -1, "metadata": {"b/c": [1]}},
            "grid": [[1, [2, 3]], [[1], 2], null, {"k~": 1, "l": [2]}, "z"],
            "patch": {"a": {"b": [1, {"c": null}]}, "d": "e"}, "other": [1, 2]}"#;
        let read = |text: &[u8]| {
            let read = parse::<Document>(Bounds::default(), text);
            read.err().map(|fault| (fault.pointer, fault.detail))
        };
        assert_eq!(read(text.as_bytes()), None);
        let mut faulty = 0;
        for place in 0..text.len() {
            for put in [&b""[..], b"x", b"]", b"}", b"[", b"{", b",", b":", b"\"", b"\xff", b"1e999"] {
                let mut text = text.as_bytes().to_vec();
                text.splice(place..=place, put.iter().copied());
                let wanted = tracked(&text);
                faulty += usize::from(wanted.is_some());
                assert_eq!(read(&text), wanted, "{}", String::from_utf8_lossy(&text));
            }
            assert_eq!(read(&text.as_bytes()[..place]), tracked(&text.as_bytes()[..place]));
        }
        assert!(faulty > 3000, "{faulty}");
    }
}
