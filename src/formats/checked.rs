//! JSON that keeps its own errors: one bad field does not hide the others.
//!
//! * [`Checked`] — a small value, or what is wrong with it;
//! * [`List`] — a list, or what is there instead;
//! * `document!` — objects that note every field that is missing, unknown or given twice.
//!
//! Reading such a document fails for text that is not JSON, and for nothing else.

use std::fmt;

use serde::Deserialize;
use serde::de::{DeserializeOwned, Deserializer, SeqAccess, Visitor};

use super::{InputError, json_pointer};

/// A value, or what is wrong with it.
///
/// For small values only: they pass through [`serde_json::Value`].
#[derive(Debug, Clone)]
pub struct Checked<T>(Result<T, InputError>);

impl<T> Checked<T> {
    /// The value, unless it is wrong.
    pub fn get(&self) -> Option<&T> {
        self.0.as_ref().ok()
    }

    /// The value; an error goes to `errors` below `pointer`.
    pub fn take(self, pointer: &str, errors: &mut Vec<InputError>) -> Option<T> {
        match self.0 {
            Ok(value) => Some(value),
            Err(error) => {
                errors.push(error.below(pointer));
                None
            }
        }
    }
}

impl<'de, T: DeserializeOwned> Deserialize<'de> for Checked<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = serde_json::Value::deserialize(deserializer)?;
        let parsed = serde_path_to_error::deserialize(value);
        Ok(Self(parsed.map_err(|error| InputError::new(json_pointer(error.path()), plain(error.inner())))))
    }
}

/// The sentence of an error without the names of types that only the program knows.
fn plain(error: &serde_json::Error) -> String {
    let text = error.to_string();
    let text = ["usize", "u64", "u32", "u16", "u8"]
        .iter()
        .fold(text, |text, name| text.replace(name, "a whole number"));
    let text = text.replace("expected f64", "expected a number");
    let text = text.replace("struct CustomClass", "a class name or {\"matrices\": …}");
    let text = without_type(&text, "internally tagged enum ", "an object with a name");
    format!("is wrong: {}", without_type(&text, "struct ", "an object"))
}

/// The text with the first name of a type, after `what`, replaced by something that clients know.
fn without_type(text: &str, what: &str, known: &str) -> String {
    let Some((before, rest)) = text.split_once(what) else { return text.to_owned() };
    let name = rest.find(|c: char| !c.is_alphanumeric()).unwrap_or(rest.len());
    format!("{before}{known}{}", &rest[name..])
}

/// The value of an optional field: what is not given is the default.
pub fn take_or_default<T: Default>(
    field: Option<Checked<T>>,
    pointer: &str,
    errors: &mut Vec<InputError>,
) -> Option<T> {
    match field {
        Some(checked) => checked.take(pointer, errors),
        None => Some(T::default()),
    }
}

/// A value whose type was not known when it was read.
pub fn take_value<T: DeserializeOwned>(
    value: serde_json::Value,
    pointer: &str,
    errors: &mut Vec<InputError>,
) -> Option<T> {
    let checked: Checked<T> = serde_json::from_value(value).ok()?;
    checked.take(pointer, errors)
}

/// The value of an optional field, or nothing when it is not given or wrong.
pub fn take_given<T>(field: Option<Checked<T>>, pointer: &str, errors: &mut Vec<InputError>) -> Option<T> {
    field.and_then(|checked| checked.take(pointer, errors))
}

/// Implements the visits of everything that is not wanted: `$keep(self, "a text")` makes the value.
macro_rules! visit_others {
    (@visit $keep:path, $value:ty, $($name:ident: $type:ty, $what:literal;)*) => {
        $(fn $name<E>(self, _: $type) -> Result<$value, E> { Ok($keep(self, $what)) })*
    };
    (@seq $keep:path, $value:ty) => {
        fn visit_seq<A: serde::de::SeqAccess<'de>>(self, mut list: A) -> Result<$value, A::Error> {
            while list.next_element::<serde::de::IgnoredAny>()?.is_some() {}
            Ok($keep(self, "a list"))
        }
    };
    (@map $keep:path, $value:ty) => {
        fn visit_map<A: serde::de::MapAccess<'de>>(self, mut map: A) -> Result<$value, A::Error> {
            while map.next_entry::<serde::de::IgnoredAny, serde::de::IgnoredAny>()?.is_some() {}
            Ok($keep(self, "an object"))
        }
    };
    (@text $keep:path, $value:ty) => {
        $crate::formats::checked::visit_others!(@visit $keep, $value,
            visit_bool: bool, "a truth value"; visit_str: &str, "a text";);
    };
    (@null $keep:path, $value:ty) => {
        fn visit_unit<E>(self) -> Result<$value, E> { Ok($keep(self, "null")) }
    };
    (@number $keep:path, $value:ty) => {
        $crate::formats::checked::visit_others!(@visit $keep, $value,
            visit_i64: i64, "a number"; visit_u64: u64, "a number"; visit_f64: f64, "a number";);
    };
}
pub(crate) use visit_others;

/// A list, or what is there instead.
#[derive(Debug, Clone)]
pub struct List<T> {
    items: Vec<T>,
    fault: Option<&'static str>,
}

impl<T> Default for List<T> {
    fn default() -> Self {
        Self { items: Vec::new(), fault: None }
    }
}

impl<T> List<T> {
    /// The items; an error goes to `errors` at `pointer`.
    pub fn take(self, pointer: &str, errors: &mut Vec<InputError>) -> Vec<T> {
        if let Some(what) = self.fault {
            errors.push(InputError::new(pointer, format!("is {what}, not a list")));
        }
        self.items
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for List<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct ListVisitor<T>(std::marker::PhantomData<T>);
        fn other<T>(_: ListVisitor<T>, what: &'static str) -> List<T> {
            List { items: Vec::new(), fault: Some(what) }
        }
        impl<'de, T: Deserialize<'de>> Visitor<'de> for ListVisitor<T> {
            type Value = List<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<List<T>, A::Error> {
                let mut items = Vec::new();
                while let Some(item) = list.next_element()? {
                    items.push(item);
                }
                Ok(List { items, fault: None })
            }

            visit_others!(@text other, List<T>);
            visit_others!(@null other, List<T>);
            visit_others!(@number other, List<T>);
            visit_others!(@map other, List<T>);
        }
        deserializer.deserialize_any(ListVisitor(std::marker::PhantomData))
    }
}

/// Declares an object whose fields keep their own errors.
///
/// Every field becomes an `Option`; its type must read any JSON. `required` fields that are missing, unknown
/// fields, and fields given twice are noted in `faults`, with pointers relative to the object.
macro_rules! document {
    ($(#[$meta:meta])* $vis:vis struct $name:ident {
        $($(#[$field_meta:meta])* $field:ident $(or $alias:literal)?: $type:ty $(, $required:ident)?;)*
    }) => {
        #[derive(Debug, Clone, Default, utoipa::ToSchema)]
        $(#[$meta])*
        $vis struct $name {
            $($(#[$field_meta])* $vis $field: Option<$type>,)*
            /// What is wrong with the object itself.
            #[schema(ignore)]
            $vis faults: Vec<$crate::formats::InputError>,
        }

        impl<'de> serde::Deserialize<'de> for $name {
            fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                struct DocumentVisitor;

                fn other(_: DocumentVisitor, what: &'static str) -> $name {
                    let fault = $crate::formats::InputError::new("", format!("is {what}, not an object"));
                    $name { faults: vec![fault], ..$name::default() }
                }

                impl<'de> serde::de::Visitor<'de> for DocumentVisitor {
                    type Value = $name;

                    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                        f.write_str("an object")
                    }

                    fn visit_map<A: serde::de::MapAccess<'de>>(self, mut map: A) -> Result<$name, A::Error> {
                        let mut document = $name::default();
                        while let Some(key) = map.next_key::<std::borrow::Cow<'_, str>>()? {
                            match key.as_ref() {
                                $(stringify!($field) $(| $alias)? => {
                                    if document.$field.is_some() {
                                        document.fault(&key, "is given twice");
                                    }
                                    document.$field = Some(map.next_value()?);
                                })*
                                unknown => {
                                    let known = [$(stringify!($field)),*].join(", ");
                                    document.fault(unknown, &format!("is not a field; the fields are {known}"));
                                    map.next_value::<serde::de::IgnoredAny>()?;
                                }
                            }
                        }
                        $($(
                            debug_assert_eq!(stringify!($required), "required");
                            if document.$field.is_none() {
                                document.fault(stringify!($field), "is missing");
                            }
                        )?)*
                        Ok(document)
                    }

                    $crate::formats::checked::visit_others!(@text other, $name);
                    $crate::formats::checked::visit_others!(@null other, $name);
                    $crate::formats::checked::visit_others!(@number other, $name);
                    $crate::formats::checked::visit_others!(@seq other, $name);
                }

                deserializer.deserialize_any(DocumentVisitor)
            }
        }

        impl $name {
            fn fault(&mut self, key: &str, detail: &str) {
                if self.faults.len() < $crate::formats::checked::MAX_FAULTS {
                    let pointer = format!("/{}", key.replace('~', "~0").replace('/', "~1"));
                    self.faults.push($crate::formats::InputError::new(pointer, detail));
                }
            }
        }
    };
}
pub(crate) use document;

/// Faults noted per object or list.
pub const MAX_FAULTS: usize = 20;
