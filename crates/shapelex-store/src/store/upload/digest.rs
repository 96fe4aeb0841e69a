//! Digest of a shape's content: equal exactly if everything except the id is equal.

use blake3::Hasher;
use serde_json::Value;

use super::super::blob;
use crate::domain::shape::ShapeAttributes;

/// BLAKE3 of control points, as stored, and attributes. Every part is preceded by its kind or length, so that different
/// contents never give the same bytes.
pub(super) fn of(attributes: &ShapeAttributes, points: &[u8]) -> [u8; 32] {
    let mut hasher = Hasher::new();
    put_length(&mut hasher, points.len() / blob::BYTES_PER_NUMBER);
    hasher.update(points);
    hasher.update(&attributes.weight.to_le_bytes());
    put_text(&mut hasher, attributes.external_id.as_deref());
    put_text(&mut hasher, attributes.subject.as_deref());
    put_text(&mut hasher, attributes.label.as_deref());
    put_object(&mut hasher, attributes.labels.iter().collect());
    match &attributes.metadata {
        None => put_text(&mut hasher, None),
        Some(text) => put_value(&mut hasher, &value_of(text)),
    }
    *hasher.finalize().as_bytes()
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

fn put_value(hasher: &mut Hasher, value: &Value) {
    match value {
        Value::Null => {
            hasher.update(b"n");
        }
        Value::Bool(truth) => {
            hasher.update(if *truth { b"t" } else { b"f" });
        }
        Value::Number(number) => {
            hasher.update(b"#");
            put_text(hasher, Some(&number.to_string()));
        }
        Value::String(text) => put_text(hasher, Some(text)),
        Value::Array(items) => {
            hasher.update(b"[");
            put_length(hasher, items.len());
            items.iter().for_each(|item| put_value(hasher, item));
        }
        Value::Object(members) => put_object(hasher, members.iter().collect()),
    }
}

/// Hashes members in the order of their keys, whatever order the map keeps.
fn put_object(hasher: &mut Hasher, mut members: Vec<(&String, &Value)>) {
    members.sort_by_key(|(key, _)| *key);
    hasher.update(b"{");
    put_length(hasher, members.len());
    for (key, value) in members {
        put_text(hasher, Some(key));
        put_value(hasher, value);
    }
}
