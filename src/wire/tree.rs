//! JSON in memory, from which all small records are read: with one deserializer, each record is compiled once. Its errors know
//! their place in the document.
//!
//! * [`Tree`] — a value; texts stay parts of the source;
//! * [`Reader`] — reads records from a tree;
//! * [`TreeError`] — a fault, and its place.
//!
//! Messages are those of `serde_json::Value`, and members are in order of their names. A name that is given twice is a fault of its
//! member: neither value takes precedence.

use std::borrow::Cow;
use std::fmt;

use serde::Deserialize;
use serde::de::value::{BorrowedStrDeserializer, MapDeserializer};
use serde::de::{
    DeserializeSeed, Deserializer, EnumAccess, Error, Expected, MapAccess, SeqAccess, Unexpected,
    VariantAccess, Visitor,
};
use serde_json::Value;

use super::fault::{Fault, pointer_of};
use super::trail;
use super::words::plain;

/// A value of JSON.
#[derive(Debug, Clone, PartialEq)]
pub enum Tree<'a> {
    /// `null`.
    Null,
    /// `true` or `false`.
    Boolean(bool),
    /// A whole number from 0.
    Whole(u64),
    /// A negative whole number.
    Negative(i64),
    /// Another number.
    Number(f64),
    /// A text.
    Text(Cow<'a, str>),
    /// A list.
    List(Vec<Tree<'a>>),
    /// An object: members in order of their names.
    Object(Vec<(Cow<'a, str>, Tree<'a>)>),
    /// A member whose name is given twice, in place of its values.
    Twice,
}

/// The fault of [`Tree::Twice`].
const TWICE: &str = "the field is given twice";

impl<'a> Tree<'a> {
    /// The value of a text.
    ///
    /// # Errors
    /// Text that is not JSON.
    pub fn parse(text: &'a str) -> Result<Self, serde_json::Error> {
        serde_json::from_str(text).inspect_err(|_| trail::forget())
    }

    /// The same value.
    pub fn of(value: &'a Value) -> Self {
        match value {
            Value::Null => Self::Null,
            Value::Bool(value) => Self::Boolean(*value),
            Value::Number(number) => match (number.as_u64(), number.as_i64(), number.as_f64()) {
                (Some(whole), ..) => Self::Whole(whole),
                (_, Some(negative), _) => Self::Negative(negative),
                (.., number) => Self::Number(number.unwrap_or_default()),
            },
            Value::String(text) => Self::Text(Cow::Borrowed(text)),
            Value::Array(list) => Self::List(list.iter().map(Self::of).collect()),
            Value::Object(map) => Self::Object(
                map.iter().map(|(name, value)| (Cow::Borrowed(name.as_str()), Self::of(value))).collect(),
            ),
        }
    }

    /// The same value, without borrows.
    ///
    /// # Errors
    /// A member whose name is given twice.
    pub fn into_value(self) -> Result<Value, TreeError> {
        Value::deserialize(Reader::of(&self))
    }

    /// The member or entry at a step of a JSON pointer, without its escapes.
    fn child(&self, step: &str) -> Option<&Self> {
        match self {
            Self::List(list) => list.get(step.parse::<usize>().ok()?),
            Self::Object(members) => members.iter().find(|(name, _)| name == step).map(|(_, value)| value),
            _ => None,
        }
    }

    /// The value at the steps of a path.
    pub fn at(&self, path: &[String]) -> Option<&Self> {
        path.iter().try_fold(self, |tree, step| tree.child(step))
    }

    fn unexpected(&self) -> Unexpected<'_> {
        match self {
            Self::Null => Unexpected::Unit,
            Self::Boolean(value) => Unexpected::Bool(*value),
            Self::Whole(value) => Unexpected::Unsigned(*value),
            Self::Negative(value) => Unexpected::Signed(*value),
            Self::Number(value) => Unexpected::Float(*value),
            Self::Text(text) => Unexpected::Str(text),
            Self::List(_) => Unexpected::Seq,
            Self::Object(_) => Unexpected::Map,
            Self::Twice => Unexpected::Other(TWICE),
        }
    }
}

impl<'de> Deserialize<'de> for Tree<'de> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(TreeVisitor)
    }
}

struct TreeVisitor;

impl<'de> Visitor<'de> for TreeVisitor {
    type Value = Tree<'de>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("any value")
    }

    fn visit_unit<E>(self) -> Result<Tree<'de>, E> {
        Ok(Tree::Null)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Tree<'de>, E> {
        Ok(Tree::Boolean(value))
    }

    fn visit_u64<E>(self, value: u64) -> Result<Tree<'de>, E> {
        Ok(Tree::Whole(value))
    }

    fn visit_i64<E>(self, value: i64) -> Result<Tree<'de>, E> {
        Ok(u64::try_from(value).map_or(Tree::Negative(value), Tree::Whole))
    }

    fn visit_f64<E>(self, value: f64) -> Result<Tree<'de>, E> {
        Ok(Tree::Number(value))
    }

    fn visit_borrowed_str<E>(self, text: &'de str) -> Result<Tree<'de>, E> {
        Ok(Tree::Text(Cow::Borrowed(text)))
    }

    fn visit_str<E>(self, text: &str) -> Result<Tree<'de>, E> {
        Ok(Tree::Text(Cow::Owned(text.to_owned())))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut entries: A) -> Result<Tree<'de>, A::Error> {
        let mut list = Vec::new();
        while let Some(entry) = trail::next_entry(&mut entries, list.len())? {
            list.push(entry);
        }
        Ok(Tree::List(list))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Tree<'de>, A::Error> {
        let mut members: Vec<(Cow<'de, str>, Tree<'de>)> = Vec::new();
        while let Some(super::key::Key(name)) = entries.next_key()? {
            let value = trail::value_of(&mut entries, &name)?;
            members.push((name, value));
        }
        members.sort_by(|(one, _), (other, _)| one.cmp(other));
        members.dedup_by(|(later, _), (first, value)| {
            let is_same = later == first;
            if is_same {
                *value = Tree::Twice;
            }
            is_same
        });
        Ok(Tree::Object(members))
    }
}

/// A fault of a record, and its place.
#[derive(Debug)]
pub struct TreeError(Box<Content>);

#[derive(Debug)]
struct Content {
    /// The error of the parser.
    error: serde_json::Error,
    /// Steps of the path, the last one first.
    steps: Vec<String>,
}

impl TreeError {
    fn within(mut self, step: impl ToString) -> Self {
        self.0.steps.push(step.to_string());
        self
    }

    /// The message of the parser.
    pub fn said(&self) -> String {
        self.0.error.to_string()
    }

    /// Names and indices that lead to the place.
    pub fn into_path(self) -> Vec<String> {
        let mut steps = self.0.steps;
        steps.reverse();
        steps
    }

    /// The same in words that clients know.
    pub fn plain(&self) -> String {
        plain(&self.0.error)
    }

    /// The fault as clients read it.
    pub fn into_fault(self) -> Fault {
        let detail = self.plain();
        Fault::new(pointer_of(&self.into_path()), detail)
    }
}

impl fmt::Display for TreeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.error.fmt(f)
    }
}

impl std::error::Error for TreeError {}

impl From<serde_json::Error> for TreeError {
    #[cold]
    fn from(error: serde_json::Error) -> Self {
        Self(Box::new(Content { error, steps: Vec::new() }))
    }
}

impl Error for TreeError {
    #[cold]
    fn custom<T: fmt::Display>(said: T) -> Self {
        serde_json::Error::custom(said).into()
    }

    #[cold]
    fn invalid_type(found: Unexpected<'_>, expected: &dyn Expected) -> Self {
        serde_json::Error::invalid_type(found, expected).into()
    }

    #[cold]
    fn invalid_value(found: Unexpected<'_>, expected: &dyn Expected) -> Self {
        serde_json::Error::invalid_value(found, expected).into()
    }
}

/// Reads a record from a tree.
#[derive(Debug, Clone, Copy)]
pub struct Reader<'t> {
    tree: &'t Tree<'t>,
    /// A member or entry that is left out, to see whether it is the cause of a fault.
    without: Option<&'t Tree<'t>>,
}

impl<'t> Reader<'t> {
    /// Reads from this tree.
    pub fn of(tree: &'t Tree<'t>) -> Self {
        Self { tree, without: None }
    }

    /// Reads as if a part of the tree were not there.
    pub fn without(self, part: &'t Tree<'t>) -> Self {
        Self { without: Some(part), ..self }
    }

    fn part(self, tree: &'t Tree<'t>) -> Self {
        Self { tree, ..self }
    }

    fn is_there(&self, part: &Tree<'t>) -> bool {
        self.without.is_none_or(|without| !std::ptr::eq(without, part))
    }

    fn invalid<T>(self, expected: &dyn Expected) -> Result<T, TreeError> {
        match self.tree {
            Tree::Twice => Err(TreeError::custom(TWICE)),
            other => Err(TreeError::invalid_type(other.unexpected(), expected)),
        }
    }

    fn number<V: Visitor<'t>>(self, visitor: V) -> Result<V::Value, TreeError> {
        match self.tree {
            Tree::Whole(value) => visitor.visit_u64(*value),
            Tree::Negative(value) => visitor.visit_i64(*value),
            Tree::Number(value) => visitor.visit_f64(*value),
            _ => self.invalid(&visitor),
        }
    }

    fn text<V: Visitor<'t>>(self, visitor: V) -> Result<V::Value, TreeError> {
        match self.tree {
            Tree::Text(text) => visitor.visit_borrowed_str(text),
            _ => self.invalid(&visitor),
        }
    }

    fn list<V: Visitor<'t>>(self, list: &'t [Tree<'t>], visitor: V) -> Result<V::Value, TreeError> {
        let mut entries = Entries { list, next: 0, reader: self };
        let value = visitor.visit_seq(&mut entries)?;
        if entries.is_at_end() { Ok(value) } else { Err(too_long(list.len(), "fewer elements in array")) }
    }

    fn object<V: Visitor<'t>>(
        self,
        members: &'t [(Cow<'t, str>, Tree<'t>)],
        visitor: V,
    ) -> Result<V::Value, TreeError> {
        let mut rest = Members { members, reader: self };
        let value = visitor.visit_map(&mut rest)?;
        if rest.is_at_end() { Ok(value) } else { Err(too_long(members.len(), "fewer elements in map")) }
    }

    /// Name and content of a variant.
    fn variant(self) -> Result<Variant<'t>, TreeError> {
        match self.tree {
            Tree::Text(name) => Ok(Variant { name, content: None }),
            Tree::Object(members) => {
                let mut there = members.iter().filter(|(_, value)| self.is_there(value));
                match (there.next(), there.next()) {
                    (Some((name, value)), None) => Ok(Variant { name, content: Some(self.part(value)) }),
                    _ => Err(TreeError::invalid_value(Unexpected::Map, &"map with a single key")),
                }
            }
            _ => self.invalid(&"string or map"),
        }
    }
}

#[cold]
fn too_long(length: usize, expected: &str) -> TreeError {
    TreeError::invalid_length(length, &expected)
}

/// Name under which `serde_json` asks for the text of a value.
const RAW: &str = "$serde_json::private::RawValue";

macro_rules! read_as {
    ($how:ident: $($name:ident)*) => {
        $(fn $name<V: Visitor<'t>>(self, visitor: V) -> Result<V::Value, TreeError> { self.$how(visitor) })*
    };
}

impl<'t> Deserializer<'t> for Reader<'t> {
    type Error = TreeError;

    read_as!(number: deserialize_i8 deserialize_i16 deserialize_i32 deserialize_i64 deserialize_u8 deserialize_u16
        deserialize_u32 deserialize_u64 deserialize_f32 deserialize_f64);
    read_as!(text: deserialize_char deserialize_str deserialize_string deserialize_identifier);
    read_as!(deserialize_seq: deserialize_bytes deserialize_byte_buf);

    fn deserialize_any<V: Visitor<'t>>(self, visitor: V) -> Result<V::Value, TreeError> {
        match self.tree {
            Tree::Null => visitor.visit_unit(),
            Tree::Boolean(value) => visitor.visit_bool(*value),
            Tree::Whole(_) | Tree::Negative(_) | Tree::Number(_) => self.number(visitor),
            Tree::Text(text) => visitor.visit_borrowed_str(text),
            Tree::List(list) => self.list(list, visitor),
            Tree::Object(members) => self.object(members, visitor),
            Tree::Twice => self.invalid(&visitor),
        }
    }

    fn deserialize_bool<V: Visitor<'t>>(self, visitor: V) -> Result<V::Value, TreeError> {
        match self.tree {
            Tree::Boolean(value) => visitor.visit_bool(*value),
            _ => self.invalid(&visitor),
        }
    }

    fn deserialize_option<V: Visitor<'t>>(self, visitor: V) -> Result<V::Value, TreeError> {
        match self.tree {
            Tree::Null => visitor.visit_none(),
            _ => visitor.visit_some(self),
        }
    }

    fn deserialize_unit<V: Visitor<'t>>(self, visitor: V) -> Result<V::Value, TreeError> {
        match self.tree {
            Tree::Null => visitor.visit_unit(),
            _ => self.invalid(&visitor),
        }
    }

    fn deserialize_unit_struct<V: Visitor<'t>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, TreeError> {
        self.deserialize_unit(visitor)
    }

    fn deserialize_newtype_struct<V: Visitor<'t>>(
        self,
        name: &'static str,
        visitor: V,
    ) -> Result<V::Value, TreeError> {
        if name == RAW {
            let text = Value::deserialize(self)?.to_string();
            return visitor.visit_map(MapDeserializer::new(std::iter::once((RAW, text))));
        }
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'t>>(self, visitor: V) -> Result<V::Value, TreeError> {
        match self.tree {
            Tree::List(list) => self.list(list, visitor),
            _ => self.invalid(&visitor),
        }
    }

    fn deserialize_tuple<V: Visitor<'t>>(self, _: usize, visitor: V) -> Result<V::Value, TreeError> {
        self.deserialize_seq(visitor)
    }

    fn deserialize_tuple_struct<V: Visitor<'t>>(
        self,
        _: &'static str,
        _: usize,
        visitor: V,
    ) -> Result<V::Value, TreeError> {
        self.deserialize_seq(visitor)
    }

    fn deserialize_map<V: Visitor<'t>>(self, visitor: V) -> Result<V::Value, TreeError> {
        match self.tree {
            Tree::Object(members) => self.object(members, visitor),
            _ => self.invalid(&visitor),
        }
    }

    fn deserialize_struct<V: Visitor<'t>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, TreeError> {
        match self.tree {
            Tree::List(list) => self.list(list, visitor),
            Tree::Object(members) => self.object(members, visitor),
            _ => self.invalid(&visitor),
        }
    }

    fn deserialize_enum<V: Visitor<'t>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, TreeError> {
        visitor.visit_enum(self.variant()?)
    }

    fn deserialize_ignored_any<V: Visitor<'t>>(self, visitor: V) -> Result<V::Value, TreeError> {
        visitor.visit_unit()
    }
}

/// Entries of a list that are not read yet.
struct Entries<'t> {
    list: &'t [Tree<'t>],
    next: usize,
    reader: Reader<'t>,
}

impl Entries<'_> {
    /// Passes over ignored values.
    fn is_at_end(&mut self) -> bool {
        if self.list.get(self.next).is_some_and(|entry| !self.reader.is_there(entry)) {
            self.next += 1;
        }
        self.next == self.list.len()
    }
}

impl<'t> SeqAccess<'t> for &mut Entries<'t> {
    type Error = TreeError;

    fn next_element_seed<T: DeserializeSeed<'t>>(&mut self, seed: T) -> Result<Option<T::Value>, TreeError> {
        if self.is_at_end() {
            return Ok(None);
        }
        let position = self.next;
        self.next += 1;
        match seed.deserialize(self.reader.part(&self.list[position])) {
            Ok(value) => Ok(Some(value)),
            Err(error) => Err(error.within(position)),
        }
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.list.len() - self.next)
    }
}

/// Members of an object that are not read yet.
struct Members<'t> {
    members: &'t [(Cow<'t, str>, Tree<'t>)],
    reader: Reader<'t>,
}

impl Members<'_> {
    /// Passes over ignored values.
    fn is_at_end(&mut self) -> bool {
        if self.members.first().is_some_and(|(_, value)| !self.reader.is_there(value)) {
            self.members = &self.members[1..];
        }
        self.members.is_empty()
    }
}

impl<'t> MapAccess<'t> for &mut Members<'t> {
    type Error = TreeError;

    fn next_key_seed<K: DeserializeSeed<'t>>(&mut self, seed: K) -> Result<Option<K::Value>, TreeError> {
        if self.is_at_end() {
            return Ok(None);
        }
        let name = &self.members[0].0;
        let key = seed.deserialize(BorrowedStrDeserializer::<TreeError>::new(name));
        key.map(Some).map_err(|error| error.within(name))
    }

    fn next_value_seed<T: DeserializeSeed<'t>>(&mut self, seed: T) -> Result<T::Value, TreeError> {
        let Some(((name, value), rest)) = self.members.split_first() else {
            return Err(TreeError::custom("value is missing"));
        };
        self.members = rest;
        seed.deserialize(self.reader.part(value)).map_err(|error| error.within(name))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.members.len())
    }
}

/// A variant of an enum, with its content if it has one.
struct Variant<'t> {
    name: &'t str,
    content: Option<Reader<'t>>,
}

impl Variant<'_> {
    #[cold]
    fn without_content<T>(expected: &str) -> Result<T, TreeError> {
        Err(TreeError::invalid_type(Unexpected::UnitVariant, &expected))
    }
}

impl<'t> EnumAccess<'t> for Variant<'t> {
    type Error = TreeError;
    type Variant = Self;

    fn variant_seed<V: DeserializeSeed<'t>>(self, seed: V) -> Result<(V::Value, Self), TreeError> {
        let name = seed.deserialize(BorrowedStrDeserializer::<TreeError>::new(self.name))?;
        Ok((name, self))
    }
}

impl<'t> VariantAccess<'t> for Variant<'t> {
    type Error = TreeError;

    fn unit_variant(self) -> Result<(), TreeError> {
        self.content.map_or(Ok(()), <()>::deserialize)
    }

    fn newtype_variant_seed<T: DeserializeSeed<'t>>(self, seed: T) -> Result<T::Value, TreeError> {
        match self.content {
            Some(content) => seed.deserialize(content),
            None => Self::without_content("newtype variant"),
        }
    }

    fn tuple_variant<V: Visitor<'t>>(self, _: usize, visitor: V) -> Result<V::Value, TreeError> {
        match self.content {
            Some(Reader { tree: Tree::List(list), .. }) if list.is_empty() => visitor.visit_unit(),
            Some(content @ Reader { tree: Tree::List(list), .. }) => content.list(list, visitor),
            Some(other) => other.invalid(&"tuple variant"),
            None => Self::without_content("tuple variant"),
        }
    }

    fn struct_variant<V: Visitor<'t>>(
        self,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, TreeError> {
        match self.content {
            Some(content @ Reader { tree: Tree::Object(members), .. }) => content.object(members, visitor),
            Some(other) => other.invalid(&"struct variant"),
            None => Self::without_content("struct variant"),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::{BTreeMap, HashMap};

    use serde::de::DeserializeOwned;

    use super::*;
    use crate::wire::fault::json_pointer;

    #[derive(Debug, Deserialize, PartialEq)]
    #[serde(deny_unknown_fields)]
    struct Record {
        count: usize,
        #[serde(default)]
        list: Vec<Option<[f64; 2]>>,
        kind: Option<Kind>,
        tagged: Option<Tagged>,
        either: Option<Either>,
        texts: Option<BTreeMap<String, (i8, bool)>>,
        unit: Option<Unit>,
        any: Option<Value>,
    }

    #[derive(Debug, Deserialize, PartialEq)]
    #[serde(rename_all = "snake_case")]
    enum Kind {
        Plain,
        One(f64),
        Two(u8, u8),
        Named { a: u32, b: Option<String> },
    }

    #[derive(Debug, Deserialize, PartialEq)]
    #[serde(tag = "kind", rename_all = "snake_case")]
    enum Tagged {
        Small { value: u8 },
        Text { value: String },
    }

    #[derive(Debug, Deserialize, PartialEq)]
    #[serde(untagged)]
    enum Either {
        Number(f64),
        Word(char),
    }

    #[derive(Debug, Deserialize, PartialEq)]
    struct Unit(u16);

    #[derive(Debug, Deserialize, PartialEq)]
    struct Flat {
        name: String,
        #[serde(flatten)]
        rest: HashMap<String, f64>,
    }

    /// Checks that a tree is read as `Value` is; texts with a name given twice are left out.
    fn check<T: DeserializeOwned + PartialEq + fmt::Debug>(text: &str) -> bool {
        let Ok(value) = serde_json::from_str::<Value>(text) else { return false };
        let tree = Tree::parse(text).unwrap();
        let Ok(same) = tree.clone().into_value() else { return false };
        assert_eq!((&Tree::of(&value), &same), (&tree, &value), "{text}");
        let wanted: Result<T, _> = serde_path_to_error::deserialize(value);
        let wanted = wanted.map_err(|error| (json_pointer(error.path()), error.inner().to_string()));
        let found = T::deserialize(Reader::of(&tree)).map_err(|error| {
            let said = error.said();
            (error.into_fault().pointer, said)
        });
        assert_eq!(found, wanted, "{text}");
        found.is_err()
    }

    #[test]
    fn records_and_faults_are_those_of_values() {
        let texts = [
            r#"{"count": 3, "list": [null, [1, 2.5]], "kind": "plain", "unit": 7, "any": {"b": [1], "a": -1}}"#,
            r#"{"count": 3, "kind": {"one": 1}, "tagged": {"kind": "small", "value": 3}, "either": "x"}"#,
            r#"{"count": 3, "kind": {"two": [1, 2]}, "tagged": {"value": "3", "kind": "text"}, "either": 2}"#,
            r#"{"count": 3, "kind": {"named": {"a": 1, "b": "c"}}, "texts": {"x/y": [1, true], "z": [-2, false]}}"#,
            r#"[3, [], null, null, null, null, null, null]"#,
            r#"{"name": "x", "a": 1, "b": 2.5}"#,
        ];
        let puts = [
            "",
            "null",
            "300",
            "-1",
            "1.5",
            "true",
            "[]",
            "[1,2,3]",
            "{}",
            "{\"a\":1}",
            "\"plain\"",
            "\"count\"",
        ];
        let mut faulty = 0;
        for text in texts {
            assert!(!check::<Record>(text) || !check::<Flat>(text), "{text}");
            for from in 0..text.len() {
                for to in from..text.len().min(from + 12) {
                    for put in puts {
                        let text = format!("{}{put}{}", &text[..from], &text[to..]);
                        faulty += usize::from(check::<Record>(&text)) + usize::from(check::<Flat>(&text));
                    }
                }
            }
        }
        assert!(faulty > 1000, "{faulty}");
    }

    #[test]
    fn a_name_that_is_given_twice_is_a_fault_of_its_member() {
        let fault = |text: &str| {
            let tree = Tree::parse(text).unwrap();
            let faults = [
                Value::deserialize(Reader::of(&tree)).unwrap_err(),
                BTreeMap::<String, Option<BTreeMap<String, f64>>>::deserialize(Reader::of(&tree))
                    .unwrap_err(),
            ];
            faults.map(TreeError::into_fault)
        };
        for (text, pointer) in [
            (r#"{"b": {"c": 1}, "a": null, "b": {"c": 1}}"#, "/b"),
            (r#"{"a": {"n": 1, "n": 2, "n": 3}, "b": null}"#, "/a/n"),
        ] {
            for fault in fault(text) {
                assert_eq!((fault.pointer.as_str(), fault.detail.as_str()), (pointer, TWICE), "{text}");
            }
        }
    }

    #[test]
    fn a_part_can_be_left_out() {
        let tree = Tree::parse(r#"{"b": 3, "a": 2, "c": [4, 5]}"#).unwrap();
        let read = |reader| Value::deserialize(reader).unwrap().to_string();
        assert_eq!(read(Reader::of(&tree)), r#"{"a":2,"b":3,"c":[4,5]}"#);
        for (path, left) in [
            (&["c"][..], r#"{"a":2,"b":3}"#),
            (&["a"], r#"{"b":3,"c":[4,5]}"#),
            (&["c", "1"], r#"{"a":2,"b":3,"c":[4]}"#),
        ] {
            let path: Vec<String> = path.iter().map(ToString::to_string).collect();
            assert_eq!(read(Reader::of(&tree).without(tree.at(&path).unwrap())), left);
        }
    }
}
