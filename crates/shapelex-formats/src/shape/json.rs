//! Memory of JSON: of texts once they are parsed, which may be eighty times their length and is estimated before; and of values.

use std::fmt;

use serde::de::{DeserializeSeed, Deserializer, Error, MapAccess, SeqAccess, Visitor};
use serde_json::value::RawValue;
use serde_json::{Map, Value as Json};

use super::limits::MAX_ATTRIBUTES;
use crate::error::{FileError, Place};

/// Length of texts that are parsed as they are: `{},`, which has most weight for its length, is less than [`MAX_ATTRIBUTES`].
const SHORT: usize = MAX_ATTRIBUTES / 256;

/// Bytes that the parts of a text take in memory beside its own.
#[derive(Debug, Clone, Copy)]
pub(super) struct Weights {
    /// An object.
    pub(super) object: usize,
    /// A list.
    pub(super) list: usize,
    /// A further member or element.
    pub(super) item: usize,
}

/// Those of any values. The first node of a map has room for eleven members; a list grows to twice its length.
pub(super) const VALUES: Weights = Weights { object: 640, list: 64, item: 128 };

impl Weights {
    /// At least the number of bytes that a text takes once it is parsed. Brackets and commas of its strings count as well.
    pub(super) fn bytes(&self, text: impl AsRef<[u8]>) -> usize {
        let text = text.as_ref();
        let weight = |byte: &u8| match byte {
            b'{' => self.object,
            b'[' => self.list,
            b',' => self.item,
            _ => 0,
        };
        text.len() + text.iter().map(weight).sum::<usize>()
    }

    /// Refuses a text that takes more than `most` bytes.
    ///
    /// # Errors
    /// [`FaultKind::TooLarge`](super::FaultKind::TooLarge) at `place`.
    pub(super) fn check(
        &self,
        text: impl AsRef<[u8]>,
        most: usize,
        place: impl FnOnce() -> Place,
    ) -> Result<(), FileError> {
        refuse_more(self.bytes(text), most, place)
    }
}

/// Refuses attributes or metadata that take more than those of a shape may.
///
/// # Errors
/// [`FaultKind::TooLarge`](super::FaultKind::TooLarge) at `place`.
pub(super) fn check_attributes(text: &str, place: impl FnOnce() -> Place) -> Result<(), FileError> {
    if text.len() <= SHORT { Ok(()) } else { VALUES.check(text, MAX_ATTRIBUTES, place) }
}

fn refuse_more(bytes: usize, most: usize, place: impl FnOnce() -> Place) -> Result<(), FileError> {
    if bytes <= most {
        return Ok(());
    }
    let detail = format!("expected JSON that takes at most {most} bytes in memory, got {bytes}");
    Err(FileError::too_large(place(), detail))
}

/// About the number of bytes that the members of an object take.
pub(super) fn map_bytes(map: &Map<String, Json>) -> usize {
    let member = |(name, value): (&String, &Json)| size_of::<String>() + name.len() + value_bytes(value);
    if map.is_empty() { 0 } else { VALUES.object + map.iter().map(member).sum::<usize>() }
}

fn value_bytes(value: &Json) -> usize {
    let content = match value {
        Json::String(text) => text.len(),
        Json::Array(values) => values.iter().map(value_bytes).sum(),
        Json::Object(map) => map_bytes(map),
        Json::Null | Json::Bool(_) | Json::Number(_) => 0,
    };
    size_of::<Json>() + content
}

/// Number of characters that stand for a number, a Boolean or null, with the comma behind it. A number may be written in up to 24, and
/// read from two bytes, which allow 32: less is counted, so that a fact that a file states once is never refused.
pub(super) const SCALAR: usize = 8;

/// About the number of characters of names and values in a JSON text that is written.
pub(super) fn map_characters(map: &Map<String, Json>) -> usize {
    map.iter().map(|(name, value)| text_characters(name) + value_characters(value)).sum()
}

fn value_characters(value: &Json) -> usize {
    /// Of brackets or quotation marks.
    const AROUND: usize = 2;
    match value {
        Json::String(text) => AROUND + text_characters(text),
        Json::Array(values) => AROUND + values.iter().map(value_characters).sum::<usize>(),
        Json::Object(map) => AROUND + map_characters(map),
        Json::Null | Json::Bool(_) | Json::Number(_) => SCALAR,
    }
}

/// Number of characters of a text in JSON: a control character takes six, `\u0001`.
pub(super) fn text_characters(text: &str) -> usize {
    text.len() + 5 * text.bytes().filter(|byte| *byte < b' ').count()
}

/// Members of an object beside those that become attributes and metadata.
pub(super) struct Beside {
    /// Members whose lists are read otherwise, or not at all.
    pub(super) lists: &'static [&'static str],
    /// Members that are objects, or lists of objects, of such members.
    pub(super) objects: &'static [(&'static str, &'static Beside)],
}

impl Beside {
    /// Refuses an object whose other members take more than attributes and metadata may.
    ///
    /// # Errors
    /// Those of the text; otherwise the refusal, at `place`.
    pub(super) fn check(
        &'static self,
        text: &[u8],
        place: impl FnOnce() -> Place,
    ) -> Result<Result<(), FileError>, serde_json::Error> {
        if text.len() <= SHORT {
            return Ok(Ok(()));
        }
        let mut parser = serde_json::Deserializer::from_slice(text);
        self.deserialize(&mut parser).map(|bytes| refuse_more(bytes, MAX_ATTRIBUTES, place))
    }
}

impl<'de> DeserializeSeed<'de> for &'static Beside {
    type Value = usize;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<usize, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for &'static Beside {
    type Value = usize;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<usize, A::Error> {
        let mut bytes = VALUES.object;
        while let Some(key) = map.next_key::<String>()? {
            if let Some((_, inner)) = self.objects.iter().find(|(name, _)| *name == key) {
                bytes += map.next_value_seed(*inner)?;
                continue;
            }
            let text = map.next_value::<&RawValue>()?.get();
            if !(self.lists.contains(&key.as_str()) && text.starts_with('[')) {
                bytes += key.len() + VALUES.item + VALUES.bytes(text);
            }
        }
        Ok(bytes)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<usize, A::Error> {
        let mut bytes = VALUES.list;
        while let Some(more) = list.next_element_seed(self)? {
            bytes += more;
        }
        Ok(bytes)
    }

    fn visit_unit<E: Error>(self) -> Result<usize, E> {
        Ok(0)
    }

    fn visit_bool<E: Error>(self, _: bool) -> Result<usize, E> {
        Ok(0)
    }

    fn visit_i64<E: Error>(self, _: i64) -> Result<usize, E> {
        Ok(0)
    }

    fn visit_u64<E: Error>(self, _: u64) -> Result<usize, E> {
        Ok(0)
    }

    fn visit_f64<E: Error>(self, _: f64) -> Result<usize, E> {
        Ok(0)
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<usize, E> {
        Ok(text.len())
    }
}

#[cfg(test)]
mod tests {
    use super::super::FaultKind;
    use super::*;

    static OBJECT: Beside = Beside { lists: &["coordinates"], objects: &[("inner", &OBJECT)] };

    fn refused(text: &str) -> Option<String> {
        let checked = OBJECT.check(text.as_bytes(), || Place::item(3)).expect("JSON");
        checked.err().map(|error| {
            assert_eq!(error.kind, FaultKind::TooLarge);
            error.to_string()
        })
    }

    #[test]
    fn parts_of_a_text_have_a_weight() {
        let weights = Weights { object: 100, list: 10, item: 1 };
        assert_eq!(weights.bytes(r#"{"a":[{},0,""]}"#), 15 + 200 + 10 + 2);
        let error = weights.check("[[]]", 23, || Place::tag("images")).expect_err("24 bytes");
        assert_eq!(error.to_string(), "images: expected JSON that takes at most 23 bytes in memory, got 24");
        assert!(weights.check("[[]]", 24, Place::default).is_ok());
    }

    #[test]
    fn values_take_no_more_than_their_weights() {
        /// Bytes beside the value itself: a list has grown to twice its length, a map has nodes of eleven members, half of them
        /// free, and a text is a separate piece of memory.
        fn taken(value: &Json) -> usize {
            match value {
                Json::Array(values) => 2 * size_of_val(&values[..]) + values.iter().map(taken).sum::<usize>(),
                Json::Object(map) => {
                    let node = 11 * size_of::<(String, Json)>() + 16;
                    let members = map.iter().map(|(name, value)| name.len() + 16 + taken(value));
                    map.len().div_ceil(5) * node + members.sum::<usize>()
                }
                Json::String(text) => text.len() + 16,
                Json::Null | Json::Bool(_) | Json::Number(_) => 0,
            }
        }
        for text in [
            "0",
            "[0,0,0,0,0]",
            "[{\"a\":0},{\"a\":0}]",
            "[[],[],[]]",
            r#"{"a":1,"b":2,"c":[],"d":{},"e":"","f":0}"#,
        ] {
            let value = serde_json::from_str(text).expect("JSON");
            let (taken, weight) = (taken(&value), VALUES.bytes(text));
            assert!(taken <= weight, "{text}: {taken} of {weight}");
            assert!(value_bytes(&value) <= weight + size_of_val(&value), "{text}");
        }
    }

    #[test]
    fn characters_are_about_those_that_are_written() {
        let object = serde_json::json!({"a": [0, -0.125, null], "bc": {"d": true}, "e": "f\u{1}\n"});
        let Json::Object(map) = object else { panic!("no object") };
        // Names, three and one scalars, three pairs of brackets and quotation marks, a letter and two control characters.
        assert_eq!(map_characters(&map), 5 + 4 * 8 + 3 * 2 + 1 + 2 * 6);
    }

    #[test]
    fn lists_of_coordinates_have_no_weight() {
        let numbers = "0,".repeat(MAX_ATTRIBUTES / 100);
        for text in [
            format!(r#"{{"coordinates":[{numbers}0]}}"#),
            format!(r#"{{"inner":{{"coordinates":[{numbers}0]}}}}"#),
            format!(r#"{{"inner":[{{"coordinates":[{numbers}0]}},null,1,-1,0.5,true,"text"]}}"#),
        ] {
            assert_eq!(refused(&text), None);
        }
        for text in [
            format!(r#"{{"others":[{numbers}0]}}"#),
            format!(r#"{{"others":{{"coordinates":[{numbers}0]}}}}"#),
            format!(r#"{{"coordinates":{{"a":[{numbers}0]}}}}"#),
            format!(r#"{{"inner":[{}{{}}]}}"#, "{},".repeat(MAX_ATTRIBUTES / 300)),
        ] {
            let refused = refused(&text).expect("too much");
            assert!(
                refused.starts_with("item 3: expected JSON that takes at most 16777216 bytes"),
                "{refused}"
            );
        }
        assert!(OBJECT.check(format!("{{\"a\":{numbers}").as_bytes(), Place::default).is_err(), "no JSON");
    }
}
