//! Faults of an input, and texts that repeat parts of it.

use serde::ser::SerializeMap;
use serde::{Deserialize, Serialize, Serializer};

use super::files::{FileError, Place};
use crate::geometry::field_fault::FieldFault;

/// A single fault of an input.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
pub struct Fault {
    /// JSON pointer into the body, or into the line of a stream; absent for a parameter.
    #[serde(default)]
    pub pointer: String,
    /// Name of a parameter of the query or the path; absent for a fault of the body.
    #[serde(default)]
    pub parameter: Option<String>,
    /// Description of the fault, with the offending numbers.
    pub detail: String,
    /// Position of the shape in the batch or stream, counted from 0.
    #[serde(default)]
    pub index: Option<usize>,
    /// Line of the stream or file, counted from 1.
    #[serde(default)]
    pub line: Option<u64>,
    /// Place in a file of another program.
    #[serde(default)]
    pub place: Option<Box<Place>>,
    /// Equal faults of a file, of which this is the first one.
    #[serde(flatten)]
    pub alike: Option<Box<Alike>>,
}

/// Equal faults.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
pub struct Alike {
    /// Number of them, the first one included.
    pub count: usize,
    /// Places of the first of the other ones.
    #[serde(default)]
    pub more: Vec<Place>,
}

/// A single fault of an input.
#[cfg(feature = "schema")]
#[derive(utoipa::ToSchema)]
#[allow(dead_code, reason = "only for the document")]
struct FaultDocument {
    /// JSON pointer into the body, or into the line of a stream; absent for a parameter.
    #[schema(example = "/shapes/17", required = false)]
    pointer: String,
    /// Name of a parameter of the query or the path; absent for a fault of the body.
    parameter: Option<String>,
    /// Description of the fault, with the offending numbers.
    detail: String,
    /// Position of the shape in the batch or stream, counted from 0.
    #[schema(example = 17)]
    index: Option<usize>,
    /// Line of the stream or file, counted from 1.
    line: Option<u64>,
    /// Place in a file of another program.
    #[schema(value_type = Option<FilePlace>)]
    place: Option<Box<Place>>,
    /// Number of equal faults of a file, of which this is the first one; absent if there is no other.
    #[schema(example = 177)]
    count: Option<usize>,
    /// Places of the first of the other ones.
    #[schema(value_type = Vec<FilePlace>, required = false)]
    more: Vec<Place>,
}

#[cfg(feature = "schema")]
impl utoipa::PartialSchema for Fault {
    fn schema() -> utoipa::openapi::RefOr<utoipa::openapi::schema::Schema> {
        FaultDocument::schema()
    }
}

#[cfg(feature = "schema")]
impl utoipa::ToSchema for Fault {
    fn name() -> std::borrow::Cow<'static, str> {
        FaultDocument::name()
    }

    fn schemas(schemas: &mut Vec<(String, utoipa::openapi::RefOr<utoipa::openapi::schema::Schema>)>) {
        FaultDocument::schemas(schemas);
    }
}

/// Place in a file: as much of it as is known.
#[derive(utoipa::ToSchema)]
#[allow(dead_code, reason = "only for the document")]
struct FilePlace {
    /// Name of the file within an archive.
    entry: Option<String>,
    /// Line, counted from 1.
    line: Option<u64>,
    /// Offset in bytes, counted from 0.
    byte: Option<u64>,
    /// Tag, element, field or column, as the format writes it.
    #[schema(example = "(3006,0050)")]
    tag: Option<String>,
    /// Position of the feature, specimen, region or row, counted from 0.
    item: Option<u64>,
}

/// Number of places of equal faults that are told beside that of the first one.
const MOST_PLACES: usize = 4;

impl Fault {
    /// A fault at a pointer (RFC 6901); client input repeated in it is shortened.
    pub fn new(pointer: impl Into<String>, detail: impl Into<String>) -> Self {
        let (pointer, detail) = (brief_pointer(pointer.into()), brief(detail.into()));
        Self { pointer, parameter: None, detail, index: None, line: None, place: None, alike: None }
    }

    /// A fault of a parameter of the query or the path.
    pub fn of_parameter(name: impl Into<String>, detail: impl Into<String>) -> Self {
        Self { parameter: Some(brief(name.into())), ..Self::new("", detail) }
    }

    /// A fault of a file of another program.
    pub fn of_file(error: &FileError) -> Self {
        Self { line: error.place.line, ..Self::new("", error.detail.clone()) }.at_place(&error.place)
    }

    /// The same fault, at a place in a file.
    pub fn at_place(self, place: &Place) -> Self {
        let brief_text = |text: &Option<String>| text.clone().map(brief);
        let place = Place { entry: brief_text(&place.entry), tag: brief_text(&place.tag), ..place.clone() };
        let line = self.line.or(place.line);
        Self { line, place: (place != Place::default()).then(|| Box::new(place)), ..self }
    }

    /// Counts another fault instead of it, if that says the same of another place.
    pub fn joins(&mut self, other: &Self) -> bool {
        let says_same =
            self.detail == other.detail && self.pointer == other.pointer && self.parameter == other.parameter;
        if says_same {
            let alike = self.alike.get_or_insert_with(|| Box::new(Alike { count: 1, more: Vec::new() }));
            alike.count += 1;
            if alike.more.len() < MOST_PLACES {
                alike.more.extend(other.place.as_deref().cloned());
            }
        }
        says_same
    }

    /// The same fault with `prefix` before its pointer.
    pub fn below(mut self, prefix: &str) -> Self {
        self.pointer.insert_str(0, prefix);
        self
    }

    /// The same fault with texts of bounded length: prefixes may have lengthened its pointer.
    pub fn shortened(self) -> Self {
        Self { pointer: brief_pointer(self.pointer), detail: brief(self.detail), ..self }
    }

    /// The same fault, of the shape at a position of the batch or stream.
    pub fn at_shape(self, index: usize) -> Self {
        Self { index: Some(index), ..self }
    }
}

impl Serialize for Fault {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(None)?;
        match &self.parameter {
            Some(name) => map.serialize_entry("parameter", name)?,
            None => map.serialize_entry("pointer", &self.pointer)?,
        }
        map.serialize_entry("detail", &self.detail)?;
        if let Some(index) = self.index {
            map.serialize_entry("index", &index)?;
        }
        if let Some(line) = self.line {
            map.serialize_entry("line", &line)?;
        }
        if let Some(place) = &self.place {
            map.serialize_entry("place", place)?;
        }
        if let Some(alike) = &self.alike {
            map.serialize_entry("count", &alike.count)?;
            map.serialize_entry("more", &alike.more)?;
        }
        map.end()
    }
}

impl From<FieldFault> for Fault {
    fn from(FieldFault { field, detail }: FieldFault) -> Self {
        let pointer = if field.is_empty() { field } else { format!("/{field}") };
        Self::new(pointer, detail)
    }
}

/// JSON pointer (RFC 6901) of a path.
pub fn pointer_of(path: &[String]) -> String {
    path.iter().map(|step| format!("/{}", step.replace('~', "~0").replace('/', "~1"))).collect()
}

/// Maximum length of a sentence; the longest of our own lists the fields of an object.
const LONGEST: usize = 600;
/// Maximum length of a word; none of our own is as long.
const LONGEST_WORD: usize = 80;
/// Number of characters kept of a longer word.
const WORD_KEPT: usize = 60;
/// Numbers with more digits are written with an exponent.
const LONGEST_NUMBER: usize = 30;

/// Shortens a sentence that repeats client input: long words are cut, numbers with many digits get an exponent, and the
/// middle of a sentence that is still too long is removed.
pub fn brief(text: String) -> String {
    if text.len() <= LONGEST_NUMBER {
        return text;
    }
    // Text that will be cut anyway is not examined.
    let text = cut_middle(text, 4 * LONGEST);
    let longest = text.split(' ').map(str::len).max().unwrap_or(0);
    if longest <= LONGEST_NUMBER {
        return cut_middle(text, LONGEST);
    }
    let words: Vec<String> = text.split(' ').map(brief_word).collect();
    cut_middle(words.join(" "), LONGEST)
}

fn brief_word(word: &str) -> String {
    let numeric = |c: char| c.is_ascii_digit() || matches!(c, '-' | '.');
    let bare = word.trim_matches(|c: char| !c.is_ascii_digit() && c != '-');
    if bare.len() > LONGEST_NUMBER
        && bare.chars().all(numeric)
        && let Ok(value) = bare.parse::<f64>()
    {
        return word.replace(bare, &format!("{value:e}"));
    }
    if word.chars().count() <= LONGEST_WORD {
        return word.to_owned();
    }
    let kept: String = word.chars().take(WORD_KEPT).collect();
    format!("{kept}…")
}

/// Maximum length of a pointer: it may contain field names chosen by the client.
const LONGEST_POINTER: usize = 200;

/// The pointer, truncated if it is long.
fn brief_pointer(mut pointer: String) -> String {
    if pointer.len() > LONGEST_POINTER {
        pointer.truncate(pointer.floor_char_boundary(LONGEST_POINTER));
        pointer.push('…');
    }
    pointer
}

/// Beginning and end of a text that is longer than `most` characters.
fn cut_middle(text: String, most: usize) -> String {
    if text.len() <= most {
        return text;
    }
    let end = most / 4;
    let head = text.floor_char_boundary(most - end);
    let tail = text.ceil_char_boundary(text.len() - end);
    format!("{} … {}", &text[..head], &text[tail..])
}

/// JSON pointer of a path tracked by `serde_path_to_error`, with which tests compare.
#[cfg(test)]
pub fn json_pointer(path: &serde_path_to_error::Path) -> String {
    use serde_path_to_error::Segment;
    let escape = |key: &str| key.replace('~', "~0").replace('/', "~1");
    path.iter()
        .filter_map(|segment| match segment {
            Segment::Seq { index } => Some(format!("/{index}")),
            Segment::Map { key } => Some(format!("/{}", escape(key))),
            Segment::Enum { .. } | Segment::Unknown => None,
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sentences_stay_and_what_they_repeat_is_cut() {
        let own = "expected one of the fields representation, correspondence, shapes".to_owned();
        assert_eq!(brief(own.clone()), own);
        assert!(brief(format!("is \"{}\", must be 2", "a".repeat(1 << 20))).len() < 200);
        let word = brief(format!("is \"{}\", must be 2", "ä".repeat(300)));
        assert_eq!(word, format!("is \"{}… must be 2", "ä".repeat(59)));
        assert_eq!(
            brief(format!("is {}, must be below 1", f64::MAX)),
            "is 1.7976931348623157e308, must be below 1"
        );
        assert_eq!(brief(format!("is {}", -1e-300)), "is -1e-300");
        assert!(brief("a b ".repeat(1 << 18)).chars().count() <= LONGEST + 3);
    }
}
