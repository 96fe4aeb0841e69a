//! Digest of a shape's content: equal exactly if everything except the id is equal, numbers by their values.

use blake3::Hasher;
use serde_json::{Number, Value};

use super::super::blob;
use crate::domain::attribute::LARGEST_WHOLE;
use crate::domain::shape::ShapeAttributes;

/// Digests of a shape.
#[derive(Debug)]
pub(super) struct Digests {
    /// The digest that is stored.
    pub(super) content: [u8; 32],
    /// Digests that earlier versions stored for the same content, if it has numbers: those versions told 61 from 61.0, and files
    /// gave all attributes as decimals.
    earlier: Option<[[u8; 32]; 2]>,
}

impl Digests {
    /// Whether a stored digest is one of the same content.
    pub(super) fn contain(&self, stored: &[u8]) -> bool {
        self.content == stored || self.earlier.iter().flatten().any(|earlier| earlier == stored)
    }
}

/// How whole numbers are written.
#[derive(Clone, Copy)]
enum Wholes {
    Digits,
    AsSent,
    Decimals,
}

/// BLAKE3 of control points, as stored, and attributes. Every part is preceded by its kind or length, so that different
/// contents never give the same bytes. Numbers are compared by value: 61.0 is 61.
pub(super) fn of(attributes: &ShapeAttributes, points: &[u8]) -> Digests {
    let mut hasher = Hasher::new();
    put_length(&mut hasher, points.len() / blob::BYTES_PER_NUMBER);
    hasher.update(points);
    hasher.update(&attributes.weight.to_le_bytes());
    put_text(&mut hasher, attributes.external_id.as_deref());
    put_text(&mut hasher, attributes.subject.as_deref());
    put_text(&mut hasher, attributes.label.as_deref());
    let metadata = attributes.metadata.as_deref().map(value_of);
    let with = |labels: Wholes, of_metadata: Wholes| {
        let mut hasher = hasher.clone();
        put_object(&mut hasher, attributes.labels.iter().collect(), labels);
        match &metadata {
            None => put_text(&mut hasher, None),
            Some(value) => put_value(&mut hasher, value, of_metadata),
        }
        *hasher.finalize().as_bytes()
    };
    let has_numbers = metadata.is_some() || attributes.labels.values().any(Value::is_number);
    Digests {
        content: with(Wholes::Digits, Wholes::Digits),
        earlier: has_numbers
            .then(|| [with(Wholes::AsSent, Wholes::AsSent), with(Wholes::Decimals, Wholes::AsSent)]),
    }
}

/// A number as text.
fn number_text(number: &Number, wholes: Wholes) -> String {
    let value = number.as_f64().filter(|value| value.fract() == 0.0 && value.abs() <= LARGEST_WHOLE as f64);
    match (wholes, value) {
        (Wholes::Digits, Some(value)) => (value as i64).to_string(),
        (Wholes::Decimals, Some(value)) => {
            Number::from_f64(value).map_or_else(String::new, |number| number.to_string())
        }
        _ => number.to_string(),
    }
}

/// Parses stored JSON; invalid JSON, which is never stored, counts as a string.
fn value_of(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|_| Value::from(text))
}

fn put_length(hasher: &mut Hasher, length: usize) {
    hasher.update(&(length as u64).to_le_bytes());
}

fn put_text(hasher: &mut Hasher, text: Option<&str>) {
    let Some(text) = text else {
        hasher.update(b"-");
        return;
    };
    hasher.update(b"s");
    put_length(hasher, text.len());
    hasher.update(text.as_bytes());
}

fn put_value(hasher: &mut Hasher, value: &Value, wholes: Wholes) {
    match value {
        Value::Null => {
            hasher.update(b"n");
        }
        Value::Bool(truth) => {
            hasher.update(if *truth { b"t" } else { b"f" });
        }
        Value::Number(number) => {
            hasher.update(b"#");
            put_text(hasher, Some(&number_text(number, wholes)));
        }
        Value::String(text) => put_text(hasher, Some(text)),
        Value::Array(items) => {
            hasher.update(b"[");
            put_length(hasher, items.len());
            items.iter().for_each(|item| put_value(hasher, item, wholes));
        }
        Value::Object(members) => put_object(hasher, members.iter().collect(), wholes),
    }
}

/// Hashes members in the order of their keys, whatever order the map keeps.
fn put_object(hasher: &mut Hasher, mut members: Vec<(&String, &Value)>, wholes: Wholes) {
    members.sort_by_key(|(key, _)| *key);
    hasher.update(b"{");
    put_length(hasher, members.len());
    for (key, value) in members {
        put_text(hasher, Some(key));
        put_value(hasher, value, wholes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn digests(labels: &Value) -> Digests {
        let labels =
            labels.as_object().into_iter().flatten().map(|(name, value)| (name.clone(), value.clone()));
        let attributes =
            ShapeAttributes { weight: 1.0, labels: labels.collect(), ..ShapeAttributes::default() };
        of(&attributes, &[0; 8])
    }

    #[test]
    fn numbers_are_compared_by_value() {
        let whole = digests(&json!({"n": 61}));
        assert_eq!(whole.content, digests(&json!({"n": 61.0})).content);
        assert_ne!(whole.content, digests(&json!({"n": "61"})).content);
        assert_ne!(whole.content, digests(&json!({"n": 61.5})).content);
    }

    #[test]
    fn digests_of_earlier_versions_are_those_of_the_same_content() {
        let whole = digests(&json!({"n": 61, "t": "a"}));
        for (sent, same) in [(json!({"n": 61.0, "t": "a"}), true), (json!({"n": 62.0, "t": "a"}), false)] {
            let [as_sent, decimals] = digests(&sent).earlier.expect("it has a number");
            assert_eq!((whole.contain(&as_sent), whole.contain(&decimals)), (same, same), "{sent}");
        }
        assert!(digests(&json!({"t": "a"})).earlier.is_none());
    }
}
