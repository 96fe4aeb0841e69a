//! Place of an error in a document that is being read: while the error returns, each level adds its step. A record is so compiled
//! for one deserializer, without one that tracks places, and a text without errors costs nothing.
//!
//! The steps are thread-local, because the error belongs to the deserializer. The place of an error in a value of derived types, which
//! add no steps, follows from its line and column ([`path_in`]).

use std::cell::RefCell;
use std::marker::PhantomData;

use serde::de::{Deserialize, DeserializeSeed, Deserializer, MapAccess, SeqAccess};

use super::fault::pointer_of;

thread_local! {
    /// Steps of the error that returns, the last one first.
    static STEPS: RefCell<Vec<String>> = const { RefCell::new(Vec::new()) };
}

/// Step from a list or an object to one of its parts.
#[derive(Debug, Clone, Copy)]
enum Step<'s> {
    Index(usize),
    Name(&'s str),
}

#[cold]
fn note(step: Step<'_>) {
    let step = match step {
        Step::Index(index) => index.to_string(),
        Step::Name(name) => name.to_owned(),
    };
    STEPS.with_borrow_mut(|steps| steps.push(step));
}

/// Reads the parts of a list or an object. Errors between its parts are errors of the whole, and get no step.
struct Part<'s, S> {
    seed: S,
    step: Step<'s>,
}

impl<'de, S: DeserializeSeed<'de>> DeserializeSeed<'de> for Part<'_, S> {
    type Value = S::Value;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<S::Value, D::Error> {
        let Self { seed, step } = self;
        seed.deserialize(deserializer).inspect_err(|_| note(step))
    }
}

/// Next entry of a list, at `index`.
///
/// # Errors
/// Those of the entry, with their place, and of the list.
pub fn next_entry<'de, T: Deserialize<'de>, A: SeqAccess<'de>>(
    list: &mut A,
    index: usize,
) -> Result<Option<T>, A::Error> {
    next_entry_by(list, index, PhantomData)
}

/// Next entry of a list, at `index`, read by `seed`.
///
/// # Errors
/// As [`next_entry`].
pub fn next_entry_by<'de, S: DeserializeSeed<'de>, A: SeqAccess<'de>>(
    list: &mut A,
    index: usize,
    seed: S,
) -> Result<Option<S::Value>, A::Error> {
    list.next_element_seed(Part { seed, step: Step::Index(index) })
}

/// Value of the member of an object whose name has been read.
///
/// # Errors
/// Those of the value, with their place, and of the object.
pub fn value_of<'de, T: Deserialize<'de>, A: MapAccess<'de>>(
    object: &mut A,
    name: &str,
) -> Result<T, A::Error> {
    object.next_value_seed(Part { seed: PhantomData, step: Step::Name(name) })
}

/// JSON pointer to the place of the error that has returned. Forgets it.
#[cold]
pub fn taken() -> String {
    let mut steps = STEPS.take();
    steps.reverse();
    pointer_of(&steps)
}

/// Forgets the place of an error that goes no further.
pub fn forget() {
    STEPS.with_borrow_mut(Vec::clear);
}

/// A list or an object that is open at some place of a text.
enum Open {
    List { index: usize, has_begun: bool },
    Object { name: Option<String> },
}

/// Path to the value in which reading `text` has failed. The text itself is JSON, apart from its numbers and strings. Variants that are
/// written as objects count as members.
pub fn path_in(text: &str, error: &serde_json::Error) -> Vec<String> {
    let (mut path, name) = path_at(text, offset_of(text, error), error.is_data());
    let said = error.to_string();
    // Said of the first entry that a fixed list does not have.
    if error.is_syntax() && said.starts_with("trailing characters") {
        path.pop();
    }
    // The name of a variant is not a member.
    path.extend(name.filter(|_| error.is_data() && !said.starts_with("unknown variant")));
    path
}

/// Number of bytes before the place of an error.
fn offset_of(text: &str, error: &serde_json::Error) -> usize {
    let lines = text.split_inclusive('\n').take(error.line().saturating_sub(1));
    (lines.map(str::len).sum::<usize>() + error.column()).min(text.len())
}

/// Path to the value read after `offset` bytes, and the name read there. With `waits`, an entry of a list is read before its first
/// character.
fn path_at(text: &str, offset: usize, waits: bool) -> (Vec<String>, Option<String>) {
    let bytes = &text.as_bytes()[..offset];
    let (mut open, mut at, mut last_text) = (Vec::new(), 0, None);
    while let Some(byte) = bytes.get(at) {
        if let Some(Open::List { has_begun, .. }) = open.last_mut() {
            *has_begun |= !(byte.is_ascii_whitespace() || matches!(byte, b',' | b']'));
        }
        match byte {
            b'"' => {
                let end = end_of_string(bytes, at);
                last_text = text.get(at..end);
                at = end;
                continue;
            }
            b'[' => open.push(Open::List { index: 0, has_begun: false }),
            b'{' => {
                open.push(Open::Object { name: None });
                last_text = None;
            }
            b']' | b'}' => drop(open.pop()),
            b':' => {
                if let Some(Open::Object { name }) = open.last_mut() {
                    *name = last_text.and_then(unescaped);
                }
            }
            b',' => match open.last_mut() {
                Some(Open::List { index, has_begun }) => (*index, *has_begun) = (*index + 1, false),
                Some(Open::Object { name }) => (*name, last_text) = (None, None),
                None => {}
            },
            _ => {}
        }
        at += 1;
    }
    let step = |open| match open {
        Open::List { index, has_begun } => (has_begun || waits).then(|| index.to_string()),
        Open::Object { name } => name,
    };
    // A name is read before its colon.
    let is_name = matches!(open.last(), Some(Open::Object { name: None }));
    let name = last_text.filter(|_| is_name).and_then(unescaped);
    (open.into_iter().filter_map(step).collect(), name)
}

fn unescaped(text: &str) -> Option<String> {
    serde_json::from_str(text).ok()
}

/// Place after the string that begins at `start`.
fn end_of_string(bytes: &[u8], start: usize) -> usize {
    let mut at = start + 1;
    while let Some(byte) = bytes.get(at) {
        match byte {
            b'"' => return at + 1,
            b'\\' => at += 2,
            _ => at += 1,
        }
    }
    bytes.len()
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;
    use serde::de::DeserializeOwned;

    use super::*;
    use crate::wire::fault::json_pointer;

    #[derive(Debug, Deserialize)]
    #[serde(deny_unknown_fields)]
    #[allow(dead_code, reason = "only read")]
    struct Record {
        count: u8,
        list: Vec<Option<[f64; 2]>>,
        kind: Vec<Kind>,
        tagged: Option<Tagged>,
        inner: Option<Box<Record>>,
    }

    #[derive(Debug, Deserialize)]
    #[serde(rename_all = "snake_case")]
    #[allow(dead_code, reason = "only read")]
    enum Kind {
        Plain,
    }

    #[derive(Debug, Deserialize)]
    #[serde(tag = "kind", rename_all = "snake_case")]
    #[allow(dead_code, reason = "only read")]
    enum Tagged {
        Small { value: u8 },
    }

    /// Checks the place of an error against a reader that tracks it.
    fn check<T: DeserializeOwned>(text: &str) -> bool {
        let Err(error) = serde_json::from_slice::<T>(text.as_bytes()) else { return false };
        if serde_json::from_str::<&serde_json::value::RawValue>(text).is_err() {
            return false;
        }
        let tracked: Result<T, _> =
            serde_path_to_error::deserialize(&mut serde_json::Deserializer::from_str(text));
        let tracked = tracked.err().map(|error| json_pointer(error.path()));
        assert_eq!(Some(pointer_of(&path_in(text, &error))), tracked, "{text}: {error}");
        true
    }

    #[test]
    fn the_place_of_an_error_follows_from_its_line_and_column() {
        let texts = [
            "[[0, 1, 2],\n [3, 4, 5],\n[6,7,8]]",
            r#"{"count": 3, "list": [[0, 1.5], null,
                [2, 3e1]], "kind": ["plain", "plain"], "tagged": {"kind": "small", "value": 7}, "inner":
                {"count": 4, "list": [ ], "kind": ["plain" , "plain"]}}"#,
        ];
        let puts = [
            "",
            "null",
            "300",
            "-1.5",
            "true",
            "[",
            "]",
            "[]",
            "[1,2,3]",
            "{",
            "}",
            "{}",
            "{\"a\":1}",
            "\"x\"",
            ",",
            "1e999",
        ];
        let mut faulty = 0;
        for text in texts {
            assert!(!check::<Vec<[u32; 3]>>(text) || !check::<Record>(text));
            for from in 0..text.len() {
                for to in from..text.len().min(from + 16) {
                    for put in puts {
                        let text = format!("{}{put}{}", &text[..from], &text[to..]);
                        faulty +=
                            usize::from(check::<Record>(&text)) + usize::from(check::<Vec<[u32; 3]>>(&text));
                    }
                }
            }
        }
        assert!(faulty > 3000, "{faulty}");
    }
}
