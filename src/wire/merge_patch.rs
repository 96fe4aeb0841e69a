//! Merge patches (RFC 7396): changes of a JSON object, in which null removes a member.

use serde::de::{Deserializer, MapAccess, Visitor};
use serde_json::value::RawValue;
use serde_json::{Map, Value};

use super::bounds;
use super::checked::{SMALL, fault_in, keep_fault, too_long, visit_others};
use super::fault::Fault;
use super::key::Key;
use super::trail::value_of;
use super::tree::{Tree, TreeError};

/// A merge patch of an object.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct MergePatch {
    /// Members that are set, merged or, if null, removed.
    pub members: Map<String, Value>,
    /// Faults of the patch itself: no object, or a member that is given twice, at any depth.
    pub faults: Vec<Fault>,
}

impl MergePatch {
    fn other(_: PatchVisitor, what: &'static str) -> Self {
        let fault = Fault::new("", format!("expected an object, got {what}"));
        Self { members: Map::new(), faults: vec![fault] }
    }
}

struct PatchVisitor;

impl<'de> Visitor<'de> for PatchVisitor {
    type Value = MergePatch;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<MergePatch, A::Error> {
        let mut patch = MergePatch::default();
        while let Some(key) = map.next_key::<Key<'_>>()? {
            let text: &RawValue = value_of(&mut map, key.text())?;
            let pointer = || format!("/{}", key.text().replace('~', "~0").replace('/', "~1"));
            match value_in(text.get()) {
                Ok(value) => {
                    if patch.members.insert(key.text().to_owned(), value).is_some() {
                        keep_fault(&mut patch.faults, || Fault::new(pointer(), "the field is given twice"));
                    }
                }
                Err(fault) => keep_fault(&mut patch.faults, || fault.below(&pointer())),
            }
        }
        Ok(patch)
    }

    visit_others!(@text MergePatch::other, MergePatch);
    visit_others!(@null MergePatch::other, MergePatch);
    visit_others!(@number MergePatch::other, MergePatch);
    visit_others!(@seq MergePatch::other, MergePatch);
}

impl<'de> serde::Deserialize<'de> for MergePatch {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(PatchVisitor)
    }
}

/// The value of a member: no member of a shape is longer than its metadata may be, or a small value.
fn value_in(text: &str) -> Result<Value, Fault> {
    let most = bounds::current().metadata_bytes.max(SMALL);
    if text.len() > most {
        return Err(too_long(text, most));
    }
    let tree = Tree::parse(text).map_err(|error| fault_in(text, &error))?;
    tree.into_value().map_err(TreeError::into_fault)
}

/// A merge patch as text, for lists of many: maps take ten times as much.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PatchText {
    text: Box<str>,
    faults: Vec<Fault>,
}

impl PatchText {
    /// The patch.
    pub fn read(&self) -> MergePatch {
        // The text was written from a map.
        let members = serde_json::from_str(&self.text).unwrap_or_default();
        MergePatch { members, faults: self.faults.clone() }
    }
}

impl From<MergePatch> for PatchText {
    fn from(MergePatch { members, faults }: MergePatch) -> Self {
        Self { text: Value::Object(members).to_string().into(), faults }
    }
}

/// Applies a patch: objects are merged member by member, null removes, and everything else replaces. The depth is that of the
/// patch, which its parser has bounded.
pub fn merge(target: &mut Value, patch: Value) {
    let Value::Object(members) = patch else {
        *target = patch;
        return;
    };
    if !target.is_object() {
        *target = Value::Object(Map::new());
    }
    let Value::Object(object) = target else { return };
    for (name, value) in members {
        if value.is_null() {
            object.remove(&name);
        } else {
            merge(object.entry(name).or_insert(Value::Null), value);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_examples_of_the_standard_hold() {
        for (target, patch, wanted) in [
            (r#"{"a":"b"}"#, r#"{"a":"c"}"#, r#"{"a":"c"}"#),
            (r#"{"a":"b"}"#, r#"{"b":"c"}"#, r#"{"a":"b","b":"c"}"#),
            (r#"{"a":"b"}"#, r#"{"a":null}"#, "{}"),
            (r#"{"a":"b","b":"c"}"#, r#"{"a":null}"#, r#"{"b":"c"}"#),
            (r#"{"a":["b"]}"#, r#"{"a":"c"}"#, r#"{"a":"c"}"#),
            (r#"{"a":"c"}"#, r#"{"a":["b"]}"#, r#"{"a":["b"]}"#),
            (r#"{"a":{"b":"c"}}"#, r#"{"a":{"b":"d","c":null}}"#, r#"{"a":{"b":"d"}}"#),
            (r#"{"a":[{"b":"c"}]}"#, r#"{"a":[1]}"#, r#"{"a":[1]}"#),
            (r#"["a","b"]"#, r#"["c","d"]"#, r#"["c","d"]"#),
            (r#"{"a":"b"}"#, r#"["c"]"#, r#"["c"]"#),
            (r#"{"a":"foo"}"#, "null", "null"),
            (r#"{"a":"foo"}"#, r#""bar""#, r#""bar""#),
            (r#"{"e":null}"#, r#"{"a":1}"#, r#"{"e":null,"a":1}"#),
            ("[1,2]", r#"{"a":"b","c":null}"#, r#"{"a":"b"}"#),
            ("{}", r#"{"a":{"bb":{"ccc":null}}}"#, r#"{"a":{"bb":{}}}"#),
        ] {
            let read = |text: &str| serde_json::from_str::<Value>(text).unwrap();
            let mut found = read(target);
            merge(&mut found, read(patch));
            assert_eq!(found, read(wanted), "{target} with {patch}");
        }
    }

    #[test]
    fn the_text_of_a_patch_is_the_patch() {
        for text in [
            "{}",
            r#"{"labels": {"dose": 0.1, "n": 9223372036854775807, "x": -1e-308, "t": "\u00e9\"\n"}, "weight": null}"#,
        ] {
            let patch: MergePatch = serde_json::from_str(text).unwrap();
            assert_eq!(PatchText::from(patch.clone()).read(), patch);
        }
        let twice: MergePatch = serde_json::from_str(r#"{"a": 1, "a": 2}"#).unwrap();
        assert_eq!(PatchText::from(twice.clone()).read().faults, twice.faults);
    }

    #[test]
    fn a_patch_keeps_its_faults() {
        let read = |text: &str| serde_json::from_str::<MergePatch>(text).unwrap();
        let patch = read(r#"{"a": 1, "b/c": null, "a": 2, "b/c": 3}"#);
        let pointers: Vec<&str> = patch.faults.iter().map(|fault| fault.pointer.as_str()).collect();
        assert_eq!(pointers, ["/a", "/b~1c"]);
        let patch = read(
            r#"{"labels": {"n": 1, "m": [{"k": 1, "k": 1}], "n": 2}, "metadata": [{"k/": 1, "k/": 2}]}"#,
        );
        let pointers: Vec<&str> = patch.faults.iter().map(|fault| fault.pointer.as_str()).collect();
        assert_eq!(pointers, ["/labels/m/0/k", "/metadata/0/k~1"]);
        for (text, what) in [("[1]", "a list"), ("7", "a number"), ("null", "null"), ("\"a\"", "a string")] {
            assert_eq!(read(text).faults[0].detail, format!("expected an object, got {what}"));
        }
    }
}
