//! JSON values that keep their own errors, so that one bad field does not hide the others.
//!
//! * [`Checked`] — a value, or its fault; [`Raw`] — a value whose type depends on other fields;
//! * [`List`] — a list, or the value found in its place; [`Many`] — a list of small entries;
//! * [`Ignored`] — a field that is accepted and not read;
//! * `document!` — objects that record every field that is missing, unknown or repeated.
//!
//! Reading such a document fails only for text that is not JSON.

use crate::wire::fault::{Fault, pointer_of};
use std::fmt;

use serde::de::{DeserializeOwned, Deserializer, Error, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;

use super::bounds;
use super::key::Key;
use super::trail::{self, next_entry, value_of};
use super::tree::{Reader, Tree, TreeError};
use super::words::plain;

/// Maximum length of a small value in bytes, such as a name, a filter or a class; in memory it takes some tens of times that.
pub const SMALL: usize = 256 << 10;
/// For lists of numbers or strings, which only the limit of the body bounds.
pub const LARGE: usize = usize::MAX;

/// A value, or its fault; texts longer than `MOST` bytes are refused.
///
/// The text is skipped first, and then read as a small tree. With [`LARGE`] it is read directly as `T`, without an intermediate
/// value in memory.
#[derive(Debug, Clone)]
pub struct Checked<T, const MOST: usize = SMALL>(Result<T, Box<Fault>>);

impl<T, const MOST: usize> Checked<T, MOST> {
    /// A value that was not read from JSON.
    pub fn of(value: T) -> Self {
        Self(Ok(value))
    }

    /// The value, unless it is faulty.
    pub fn get(&self) -> Option<&T> {
        self.0.as_ref().ok()
    }

    /// Takes the value; a fault goes to `errors` below `pointer`.
    pub fn take(self, pointer: &str, errors: &mut Vec<Fault>) -> Option<T> {
        match self.0 {
            Ok(value) => Some(value),
            Err(error) => {
                errors.push(error.below(pointer));
                None
            }
        }
    }
}

// Two implementations and no choice in one: each type is compiled only for its own way of reading.
impl<'de, T: DeserializeOwned> Deserialize<'de> for Checked<T, SMALL> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = <&RawValue>::deserialize(deserializer)?.get();
        read_text(text, SMALL).map(|read| Self(read.map_err(Box::new))).map_err(not_json)
    }
}

impl<'de, T: DeserializeOwned> Deserialize<'de> for Checked<T, LARGE> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = <&RawValue>::deserialize(deserializer)?.get();
        read_large(text).map(|read| Self(read.map_err(Box::new))).map_err(not_json)
    }
}

#[cold]
fn not_json<E: Error>(error: serde_json::Error) -> E {
    E::custom(plain(&error))
}

/// Reads `T` from the text of a value within a document; the inner result is the value or its fault.
///
/// # Errors
/// Numbers and strings that are not valid JSON, which are only detected here.
fn read_text<T: DeserializeOwned>(text: &str, most: usize) -> Result<Result<T, Fault>, serde_json::Error> {
    if text.len() > most {
        return Ok(Err(too_long(text, most)));
    }
    let tree = Tree::parse(text)?;
    let read = T::deserialize(Reader::of(&tree));
    Ok(read.map_err(|error| located(error, text, &tree, &|reader| T::deserialize(reader).err())))
}

#[cold]
pub(super) fn too_long(text: &str, most: usize) -> Fault {
    Fault::new("", format!("expected at most {most} bytes, got {}", text.len()))
}

/// As [`read_text`], of a text of any length, directly from the text.
fn read_large<T: DeserializeOwned>(text: &str) -> Result<Result<T, Fault>, serde_json::Error> {
    // As bytes: documents are read from bytes, and no type is compiled for both.
    match serde_json::from_slice(text.as_bytes()) {
        Ok(value) => Ok(Ok(value)),
        // Small texts are read again as a tree, whose errors are more specific.
        Err(_) if text.len() <= SMALL => read_text(text, SMALL),
        Err(error) => Ok(Err(fault_in(text, &error))),
    }
}

/// Fault of a text that was read directly.
#[cold]
pub(super) fn fault_in(text: &str, error: &serde_json::Error) -> Fault {
    trail::forget();
    Fault::new(pointer_of(&trail::path_in(text, error)), plain(error))
}

/// Names of the fields that tell the variants of a type apart; a type with a `kind` may have a name besides.
const TAGS: [&str; 2] = ["name", "kind"];
/// Maximum number of members that are searched for a cause, and length of the text in which they are.
const SEARCHED: (usize, usize) = (32, 8 << 10);
/// Maximum depth of a cause below the fault.
const DEPTH: usize = 4;

/// Sentences of the parser about one member. Other sentences, about lengths and by types themselves, are about all of them.
const OF_ONE_MEMBER: [&str; 4] = ["invalid type: ", "invalid value: ", "unknown variant ", "unknown field "];

/// Fault of a value, at the member that causes it. Types with a tag are read in a second step, in which the path is lost; a
/// member is the cause if the sentence changes without it.
fn located(
    error: TreeError,
    text: &str,
    tree: &Tree<'_>,
    faulty: &dyn Fn(Reader<'_>) -> Option<TreeError>,
) -> Fault {
    trail::forget();
    let original = error.said();
    let detail = error.plain();
    let mut path = error.into_path();
    let of_one_member = OF_ONE_MEMBER.iter().any(|beginning| original.starts_with(beginning));
    let is_short = || {
        let value: Result<serde_json::Value, _> = serde_json::from_str(text);
        value.is_ok_and(|value| value.to_string().len() <= SEARCHED.1)
    };
    if of_one_member && is_short() {
        let causes = |part: &Tree<'_>| {
            faulty(Reader::of(tree).without(part)).is_none_or(|error| error.said() != original)
        };
        for _ in 0..DEPTH {
            let Some(members) = tree.at(&path).and_then(members) else { break };
            let Some((cause, _)) = members.into_iter().find(|(_, part)| causes(part)) else { break };
            path.push(cause);
        }
        trail::forget();
    }
    Fault::new(pointer_of(&path), detail)
}

/// Members of a small object or list by name or index; those that tell variants apart come last.
fn members<'t>(tree: &'t Tree<'t>) -> Option<Vec<(String, &'t Tree<'t>)>> {
    let members: Vec<(String, &Tree<'_>)> = match tree {
        Tree::Object(members) => {
            let mut members: Vec<_> = members.iter().map(|(name, part)| (name.to_string(), part)).collect();
            members.sort_by_key(|(name, _)| TAGS.iter().position(|tag| tag == name));
            members
        }
        Tree::List(list) => list.iter().enumerate().map(|(index, part)| (index.to_string(), part)).collect(),
        _ => return None,
    };
    (members.len() <= SEARCHED.0).then_some(members)
}

/// A value whose type depends on other fields, kept as text.
#[derive(Debug, Clone)]
pub struct Raw(Box<RawValue>);

impl Raw {
    /// A value that was not read from JSON; `None` if JSON has none for it.
    pub fn of(value: &impl Serialize) -> Option<Self> {
        serde_json::value::to_raw_value(value).ok().map(Self)
    }

    /// Length of its text in bytes.
    pub fn len(&self) -> usize {
        self.0.get().len()
    }

    /// Whether its text is empty, which no value's is.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Whether it is a text.
    pub fn is_text(&self) -> bool {
        self.0.get().starts_with('"')
    }

    /// Whether it is `null`.
    pub fn is_null(&self) -> bool {
        self.0.get() == "null"
    }

    /// A whole number in it that no integer of 64 bits holds, so that reading it would change it.
    pub fn too_long(&self) -> Option<&str> {
        let ends = |c: char| !(c.is_ascii_digit() || "+-.eE".contains(c));
        // Texts are every other part between quotes, when escaped quotes do not count.
        let mut rest = self.0.get();
        loop {
            let end = rest.find('"').unwrap_or(rest.len());
            let is_long = |token: &&str| {
                let digits = token.strip_prefix('-').unwrap_or(token);
                digits.len() > 18
                    && digits.bytes().all(|byte| byte.is_ascii_digit())
                    && digits.parse::<u64>().is_err()
            };
            if let Some(token) = rest[..end].split(ends).find(is_long) {
                return Some(token);
            }
            rest = after_text(rest.get(end + 1..)?)?;
        }
    }

    /// Reads the value as `T` if its text has at most `most` bytes; a fault goes to `errors` below `pointer`.
    pub fn read<T: DeserializeOwned>(
        &self,
        most: usize,
        pointer: &str,
        errors: &mut Vec<Fault>,
    ) -> Option<T> {
        kept(read_text(self.0.get(), most), pointer, errors)
    }

    /// Reads the entries of a list of any length; a fault goes to `errors` below `pointer`.
    pub fn read_many<T: DeserializeOwned>(&self, pointer: &str, errors: &mut Vec<Fault>) -> Option<Vec<T>> {
        kept(read_large(self.0.get()).map(|read| read.map(|Limited(items)| items)), pointer, errors)
    }

    /// Reads the value as a `T` of any length; a fault goes to `errors` below `pointer`.
    pub fn read_large<T: DeserializeOwned>(&self, pointer: &str, errors: &mut Vec<Fault>) -> Option<T> {
        kept(read_large(self.0.get()), pointer, errors)
    }
}

/// The rest of JSON after a string; `text` begins behind the opening quote of the string.
fn after_text(text: &str) -> Option<&str> {
    let mut escaped = false;
    let end = text.bytes().position(|byte| {
        let ends = byte == b'"' && !escaped;
        escaped = byte == b'\\' && !escaped;
        ends
    })?;
    text.get(end + 1..)
}

/// The value that was read; a fault goes to `errors` below `pointer`.
fn kept<T>(
    read: Result<Result<T, Fault>, serde_json::Error>,
    pointer: &str,
    errors: &mut Vec<Fault>,
) -> Option<T> {
    let read = read.unwrap_or_else(|error| Err(Fault::new("", plain(&error))));
    read.map_err(|error| errors.push(error.below(pointer))).ok()
}

impl<'de> Deserialize<'de> for Raw {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Box::<RawValue>::deserialize(deserializer).map(Self)
    }
}

/// Arbitrary client data, kept as text unless it exceeds the metadata limit of a shape.
#[derive(Debug, Clone)]
pub struct Metadata(Result<Raw, Box<Fault>>);

impl Metadata {
    /// Data that the service has made or completed, of any length.
    pub fn of(value: &serde_json::Value) -> Self {
        let text = RawValue::from_string(value.to_string());
        Self(text.map(Raw).map_err(|error| Box::new(Fault::new("", plain(&error)))))
    }

    /// Data of a file, at most `most` bytes of text.
    pub fn within(value: &serde_json::Value, most: usize) -> Self {
        let text = value.to_string();
        let found = text.len();
        match RawValue::from_string(text) {
            Ok(text) if found <= most => Self(Ok(Raw(text))),
            _ => Self(Err(Box::new(Fault::new("", format!("expected at most {most} bytes, got {found}"))))),
        }
    }

    /// Takes the value; a fault goes to `errors` below `pointer`.
    pub fn take(self, pointer: &str, errors: &mut Vec<Fault>) -> Option<serde_json::Value> {
        match self.0 {
            // As a tree, which refuses names that are given twice.
            Ok(text) => text.read(usize::MAX, pointer, errors),
            Err(error) => {
                errors.push(error.below(pointer));
                None
            }
        }
    }
}

impl<'de> Deserialize<'de> for Metadata {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = <&RawValue>::deserialize(deserializer)?;
        let (found, most) = (text.get().len(), bounds::current().metadata_bytes);
        if found > most {
            let detail = format!("expected at most {most} bytes, got {found}");
            return Ok(Self(Err(Box::new(Fault::new("", detail)))));
        }
        Ok(Self(Ok(Raw(text.to_owned()))))
    }
}

/// A field that is accepted and not read.
#[derive(Debug, Clone, Copy)]
pub struct Ignored;

impl<'de> Deserialize<'de> for Ignored {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        IgnoredAny::deserialize(deserializer).map(|_| Self)
    }
}

/// A list of small entries, refused as soon as it exceeds the limit of a request.
#[derive(Debug, Clone, PartialEq)]
struct Limited<T>(Vec<T>);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Limited<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct LimitedVisitor<T>(std::marker::PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for LimitedVisitor<T> {
            type Value = Limited<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Limited<T>, A::Error> {
                let (mut items, most) = (Vec::new(), bounds::current().items);
                while let Some(item) = list.next_element()? {
                    if items.len() == most {
                        return Err(A::Error::custom(format!("expected at most {most} entries, got more")));
                    }
                    items.push(item);
                }
                Ok(Limited(items))
            }
        }
        deserializer.deserialize_seq(LimitedVisitor(std::marker::PhantomData))
    }
}

/// A list of strings or small objects, or its fault. Its entries are read one by one, each as a small tree; those longer than `MOST`
/// bytes are refused. With [`LARGE`] they are read directly as `T`, without an intermediate value in memory.
#[derive(Debug, Clone)]
pub struct Many<T, const MOST: usize = SMALL>(Result<Vec<T>, Box<Fault>>);

impl<T, const MOST: usize> Many<T, MOST> {
    /// The values, if they were read.
    pub fn get(&self) -> Option<&[T]> {
        self.0.as_deref().ok()
    }
}

impl<'de, T: DeserializeOwned> Deserialize<'de> for Many<T, SMALL> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = <&RawValue>::deserialize(deserializer)?.get();
        read_many(text).map(|read| Self(read.map_err(Box::new))).map_err(not_json)
    }
}

impl<'de, T: DeserializeOwned> Deserialize<'de> for Many<T, LARGE> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = <&RawValue>::deserialize(deserializer)?.get();
        let read = read_large(text).map_err(not_json)?;
        Ok(Self(read.map(|Limited(items)| items).map_err(Box::new)))
    }
}

/// Reads the small entries of a list, as many as a request may have.
fn read_many<T: DeserializeOwned>(text: &str) -> Result<Result<Vec<T>, Fault>, serde_json::Error> {
    let mut items = Vec::new();
    let read = read_entries(text, &mut |tree| {
        items.push(T::deserialize(Reader::of(tree))?);
        Ok(())
    });
    match read {
        Ok(()) => Ok(Ok(items)),
        // Small texts are read again as a whole, to find the cause of the fault.
        Err(_) if text.len() <= SMALL => Ok(read_text(text, SMALL)?.map(|Limited(items)| items)),
        Err(fault) => Ok(Err(fault)),
    }
}

/// Passes the entries of a list to `read`, one by one.
fn read_entries(text: &str, read: &mut dyn FnMut(&Tree<'_>) -> Result<(), TreeError>) -> Result<(), Fault> {
    let (mut fault, mut count) = (None, 0);
    let mut entry = |text: &str| {
        let pointer = format!("/{count}");
        if count == bounds::current().items {
            fault = Some(Fault::new("", format!("expected at most {count} entries, got more")));
            return false;
        }
        count += 1;
        let found = if text.len() > SMALL {
            Err(too_long(text, SMALL))
        } else {
            match Tree::parse(text) {
                Ok(tree) => read(&tree).map_err(TreeError::into_fault),
                Err(error) => Err(fault_in(text, &error)),
            }
        };
        fault = found.err().map(|found| found.below(&pointer));
        fault.is_none()
    };
    let outcome =
        serde_json::Deserializer::from_slice(text.as_bytes()).deserialize_seq(EntryVisitor(&mut entry));
    trail::forget();
    outcome.map_err(|error| fault.unwrap_or_else(|| fault_in(text, &error)))
}

/// Passes texts of entries on, until it is told to stop.
struct EntryVisitor<'f>(&'f mut dyn FnMut(&str) -> bool);

impl<'de> Visitor<'de> for EntryVisitor<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<(), A::Error> {
        while let Some(entry) = list.next_element::<&RawValue>()? {
            if !(self.0)(entry.get()) {
                return Err(A::Error::custom("a fault that is known"));
            }
        }
        Ok(())
    }
}

/// Value of an optional field, or its default if absent.
pub fn take_or_default<T: Default, const MOST: usize>(
    field: Option<Checked<T, MOST>>,
    pointer: &str,
    errors: &mut Vec<Fault>,
) -> Option<T> {
    match field {
        Some(checked) => checked.take(pointer, errors),
        None => Some(T::default()),
    }
}

/// Reads the value of a small field; a fault goes to `errors` below `pointer`.
pub fn take_value<T: DeserializeOwned>(
    value: &serde_json::Value,
    pointer: &str,
    errors: &mut Vec<Fault>,
) -> Option<T> {
    let read = T::deserialize(Reader::of(&Tree::of(value)));
    read.map_err(|error| {
        trail::forget();
        errors.push(error.into_fault().below(pointer));
    })
    .ok()
}

/// Value of an optional field; `None` if absent or faulty.
pub fn take_given<T, const MOST: usize>(
    field: Option<Checked<T, MOST>>,
    pointer: &str,
    errors: &mut Vec<Fault>,
) -> Option<T> {
    field.and_then(|checked| checked.take(pointer, errors))
}

/// Entries of an optional list.
pub fn take_many<T, const MOST: usize>(
    field: Option<Many<T, MOST>>,
    pointer: &str,
    errors: &mut Vec<Fault>,
) -> Option<Vec<T>> {
    field.and_then(|Many(read)| read.map_err(|error| errors.push(error.below(pointer))).ok())
}

/// Passes over the entries of a list.
///
/// # Errors
/// Text that is not JSON.
pub fn skip_list<'de, A: SeqAccess<'de>>(list: &mut A) -> Result<(), A::Error> {
    let mut index = 0;
    while next_entry::<IgnoredAny, _>(list, index)?.is_some() {
        index += 1;
    }
    Ok(())
}

/// Passes over the members of an object.
///
/// # Errors
/// Text that is not JSON.
pub fn skip_object<'de, A: MapAccess<'de>>(map: &mut A) -> Result<(), A::Error> {
    while let Some(key) = map.next_key::<Key<'_>>()? {
        value_of::<IgnoredAny, _>(map, key.text())?;
    }
    Ok(())
}

/// Implements the visitor methods for unexpected types: `$keep(self, "a text")` makes the value.
macro_rules! visit_others {
    (@visit $keep:path, $value:ty, $($name:ident: $type:ty, $what:literal;)*) => {
        $(fn $name<E>(self, _: $type) -> Result<$value, E> { Ok($keep(self, $what)) })*
    };
    (@seq $keep:path, $value:ty) => {
        fn visit_seq<A: serde::de::SeqAccess<'de>>(self, mut list: A) -> Result<$value, A::Error> {
            $crate::wire::checked::skip_list(&mut list)?;
            Ok($keep(self, "a list"))
        }
    };
    (@map $keep:path, $value:ty) => {
        fn visit_map<A: serde::de::MapAccess<'de>>(self, mut map: A) -> Result<$value, A::Error> {
            $crate::wire::checked::skip_object(&mut map)?;
            Ok($keep(self, "an object"))
        }
    };
    (@text $keep:path, $value:ty) => {
        $crate::wire::checked::visit_others!(@visit $keep, $value,
            visit_bool: bool, "a boolean"; visit_str: &str, "a string";);
    };
    (@null $keep:path, $value:ty) => {
        fn visit_unit<E>(self) -> Result<$value, E> { Ok($keep(self, "null")) }
    };
    (@number $keep:path, $value:ty) => {
        $crate::wire::checked::visit_others!(@visit $keep, $value,
            visit_i64: i64, "a number"; visit_u64: u64, "a number"; visit_f64: f64, "a number";);
    };
}
pub(crate) use visit_others;

/// A list, or the value found in its place. Entries beyond the limit of a request are counted, not kept.
#[derive(Debug, Clone)]
pub struct List<T> {
    items: Vec<T>,
    /// Number of entries in the document.
    count: usize,
    fault: Option<&'static str>,
}

impl<T> Default for List<T> {
    fn default() -> Self {
        Self { items: Vec::new(), count: 0, fault: None }
    }
}

impl<T> List<T> {
    /// The first items of a list of `count` entries.
    pub fn of(items: Vec<T>, count: usize) -> Self {
        Self { items, count, fault: None }
    }

    /// Takes the items; a fault goes to `errors` at `pointer`. Returns no items if there are too many.
    pub fn take(self, pointer: &str, errors: &mut Vec<Fault>) -> Vec<T> {
        if let Some(what) = self.fault {
            errors.push(Fault::new(pointer, format!("expected a list, got {what}")));
        }
        let (found, kept) = (self.count, self.items.len());
        if found > kept {
            let what = pointer.rsplit('/').next().unwrap_or("entries");
            errors.push(Fault::new(pointer, format!("expected at most {kept} {what}, got {found}")));
            return Vec::new();
        }
        self.items
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for List<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ListVisitor<T>(std::marker::PhantomData<T>);
        fn other<T>(_: ListVisitor<T>, what: &'static str) -> List<T> {
            List { fault: Some(what), ..List::default() }
        }
        impl<'de, T: Deserialize<'de>> Visitor<'de> for ListVisitor<T> {
            type Value = List<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<List<T>, A::Error> {
                let (mut items, most) = (Vec::new(), bounds::current().items);
                while items.len() < most {
                    let Some(item) = next_entry(&mut list, items.len())? else { break };
                    items.push(item);
                }
                let mut count = items.len();
                while count >= most && next_entry::<IgnoredAny, _>(&mut list, count)?.is_some() {
                    count += 1;
                }
                Ok(List { items, count, fault: None })
            }

            visit_others!(@text other, List<T>);
            visit_others!(@null other, List<T>);
            visit_others!(@number other, List<T>);
            visit_others!(@map other, List<T>);
        }
        deserializer.deserialize_any(ListVisitor(std::marker::PhantomData))
    }
}

/// Reads the value of a field; for optional fields `null` counts as absent.
macro_rules! field_value {
    ($map:ident, $key:ident, required) => {
        Some($crate::wire::trail::value_of(&mut $map, $key.text())?)
    };
    ($map:ident, $key:ident, ) => {
        $crate::wire::trail::value_of::<Option<_>, _>(&mut $map, $key.text())?
    };
}
pub(crate) use field_value;

/// Declares an object whose fields keep their own errors.
///
/// Every field becomes an `Option`; its type must accept any JSON. Missing `required` fields, unknown fields and
/// repeated fields are recorded in `faults`, with pointers relative to the object.
macro_rules! document {
    ($(#[$meta:meta])* $vis:vis struct $name:ident {
        $($(#[$field_meta:meta])* $field:ident: $type:ty $(, $required:ident)?;)*
    }) => {
        #[derive(Debug, Clone, Default, utoipa::ToSchema)]
        $(#[$meta])*
        $vis struct $name {
            $($(#[$field_meta])* $vis $field: Option<$type>,)*
            /// Faults of the object itself.
            #[schema(ignore)]
            $vis faults: Vec<$crate::wire::fault::Fault>,
        }

        impl<'de> serde::Deserialize<'de> for $name {
            fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                struct DocumentVisitor;

                fn other(_: DocumentVisitor, what: &'static str) -> $name {
                    let mut document = $name::default();
                    $crate::wire::checked::keep_fault(&mut document.faults, || {
                        $crate::wire::fault::Fault::new("", format!("expected an object, got {what}"))
                    });
                    document
                }

                impl<'de> serde::de::Visitor<'de> for DocumentVisitor {
                    type Value = $name;

                    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                        f.write_str("an object")
                    }

                    fn visit_map<A: serde::de::MapAccess<'de>>(self, mut map: A) -> Result<$name, A::Error> {
                        let mut document = $name::default();
                        while let Some(key) = map.next_key::<$crate::wire::key::Key<'_>>()? {
                            match $crate::wire::checked::as_field(key.text()) {
                                $(stringify!($field) => {
                                    if document.$field.is_some() {
                                        document.fault(key.text(), "the field is given twice");
                                    }
                                    document.$field =
                                        $crate::wire::checked::field_value!(map, key, $($required)?);
                                })*
                                unknown => {
                                    let known = [$(stringify!($field)),*].join(", ").replace("r#", "");
                                    let detail = format!("expected one of the fields {known}, got \"{unknown}\"");
                                    document.fault(unknown, &detail);
                                    $crate::wire::trail::value_of::<serde::de::IgnoredAny, _>(&mut map, unknown)?;
                                }
                            }
                        }
                        $($(
                            debug_assert_eq!(stringify!($required), "required");
                            if document.$field.is_none() {
                                document.fault(stringify!($field).trim_start_matches("r#"), "required field is missing");
                            }
                        )?)*
                        Ok(document)
                    }

                    $crate::wire::checked::visit_others!(@text other, $name);
                    $crate::wire::checked::visit_others!(@null other, $name);
                    $crate::wire::checked::visit_others!(@number other, $name);
                    $crate::wire::checked::visit_others!(@seq other, $name);
                }

                deserializer.deserialize_any(DocumentVisitor)
            }
        }

        impl $name {
            fn fault(&mut self, key: &str, detail: &str) {
                $crate::wire::checked::keep_fault(&mut self.faults, || {
                    let pointer = format!("/{}", key.replace('~', "~0").replace('/', "~1"));
                    $crate::wire::fault::Fault::new(pointer, detail)
                });
            }
        }
    };
}
pub(crate) use document;

/// The name of a field in the sources: `type` is a word of the language.
pub fn as_field(name: &str) -> &str {
    if name == "type" { "r#type" } else { name }
}

/// Maximum number of faults recorded per object or list.
pub const MAX_FAULTS: usize = 20;

/// Adds a fault to those of an object.
pub fn keep_fault(faults: &mut Vec<Fault>, fault: impl FnOnce() -> Fault) {
    bounds::keep_fault(faults, MAX_FAULTS, fault);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, serde::Deserialize)]
    #[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
    #[allow(dead_code, reason = "only read")]
    enum Tagged {
        One { count: usize, centre: bool, places: Vec<[f64; 2]> },
        Other { name: String },
    }

    #[test]
    fn entries_of_a_list_are_small_unless_they_are_read_directly() {
        let text = format!("[[1], [{}1]]", "1, ".repeat(SMALL / 3));
        let mut errors = Vec::new();
        let small: Many<Vec<u8>> = serde_json::from_str(&text).unwrap();
        assert!(take_many(Some(small), "/lists", &mut errors).is_none());
        let fault = errors.remove(0);
        let said = format!("expected at most {SMALL} bytes, got {}", text.len() - 7);
        assert_eq!((fault.pointer.as_str(), fault.detail), ("/lists/1", said));
        let large: Many<Vec<u8>, LARGE> = serde_json::from_str(&text).unwrap();
        assert_eq!(take_many(Some(large), "/lists", &mut errors).unwrap()[1].len(), SMALL / 3 + 1);
        let raw: Raw = serde_json::from_str(&text.replacen("1]]", "-1]]", 1)).unwrap();
        assert!(raw.read_many::<Vec<u8>>("/lists", &mut errors).is_none());
        assert_eq!(errors[0].pointer, format!("/lists/1/{}", SMALL / 3));
    }

    #[test]
    fn faults_of_types_with_a_tag_are_at_their_members() {
        let pointer = |text: &str| {
            let read: Checked<Tagged> = serde_json::from_str(text).unwrap();
            let mut errors = Vec::new();
            assert!(read.take("/method", &mut errors).is_none(), "{text}");
            errors.remove(0).pointer
        };
        for (text, wanted) in [
            (r#"{"kind": "one", "count": -3, "centre": true, "places": []}"#, "/method/count"),
            (r#"{"kind": "one", "count": 3, "centre": 1, "places": []}"#, "/method/centre"),
            (
                r#"{"kind": "one", "count": 3, "centre": true, "places": [[0, 1], [2, "x"]]}"#,
                "/method/places/1/1",
            ),
            (r#"{"kind": "one", "count": 3, "centre": true, "places": [[0, 1], [2]]}"#, "/method"),
            (r#"{"kind": "one", "count": 3, "centre": true, "places": [], "a/b": 1}"#, "/method/a~1b"),
            (r#"{"kind": "two", "count": 3}"#, "/method/kind"),
            (r#"{"kind": "other", "name": 7}"#, "/method/name"),
            (r#"{"kind": "other"}"#, "/method"),
            ("[]", "/method"),
        ] {
            assert_eq!(pointer(text), wanted, "{text}");
        }
    }
}
