//! Faults of files, with their places.

use std::fmt;

/// Where in a file something is. Empty for the file as a whole.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(default)]
pub struct Place {
    /// Name of the file within an archive.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub entry: Option<String>,
    /// Line, from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub line: Option<u64>,
    /// Offset in bytes, from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub byte: Option<u64>,
    /// Tag, element, field or column, as the format writes it: `(3006,0050)`, `properties/name`, `LM=`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tag: Option<String>,
    /// Position of the feature, specimen, region or row, from 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub item: Option<u64>,
}

impl Place {
    /// A line, from 1.
    pub fn line(line: u64) -> Self {
        Self { line: Some(line), ..Self::default() }
    }

    /// An offset in bytes, from 0.
    pub fn byte(byte: u64) -> Self {
        Self { byte: Some(byte), ..Self::default() }
    }

    /// A tag, element, field or column.
    pub fn tag(tag: impl Into<String>) -> Self {
        Self { tag: Some(tag.into()), ..Self::default() }
    }

    /// A feature, specimen, region or row, from 0.
    pub fn item(item: u64) -> Self {
        Self { item: Some(item), ..Self::default() }
    }

    /// The parts of `self`, and those of `outer` that `self` does not have.
    #[must_use]
    pub fn within(self, outer: &Self) -> Self {
        Self {
            entry: self.entry.or_else(|| outer.entry.clone()),
            line: self.line.or(outer.line),
            byte: self.byte.or(outer.byte),
            tag: self.tag.or_else(|| outer.tag.clone()),
            item: self.item.or(outer.item),
        }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { entry, line, byte, tag, item } = self;
        let parts = [
            entry.as_ref().map(|entry| format!("file '{entry}'")),
            item.map(|item| format!("item {item}")),
            tag.clone(),
            line.map(|line| format!("line {line}")),
            byte.map(|byte| format!("byte {byte}")),
        ];
        f.write_str(&parts.into_iter().flatten().collect::<Vec<_>>().join(", "))
    }
}

/// Kind of fault of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FaultKind {
    /// The bytes are of no known format, or of several.
    Unknown,
    /// The bytes contradict the format.
    Malformed,
    /// The file ends too early.
    Truncated,
    /// A valid file with a feature that is not read, or a record that a format cannot hold.
    Unsupported,
    /// More than a limit allows.
    TooLarge,
    /// An option that the format does not have, or that does not fit the file.
    Option,
    /// The bytes cannot be read or written.
    Io,
    /// The receiver wants no more; its own error says why.
    Stopped,
    /// Others hold the memory that is needed.
    Memory,
}

/// Why a file cannot be read or written: *expected …, got …*, and where.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{}{detail}", prefix(place))]
pub struct FileError {
    /// Kind of fault.
    pub kind: FaultKind,
    /// Where it is.
    pub place: Box<Place>,
    /// The expected and the actual content.
    pub detail: String,
}

fn prefix(place: &Place) -> String {
    if *place == Place::default() { String::new() } else { format!("{place}: ") }
}

impl FileError {
    /// A fault of the file as a whole.
    pub fn new(kind: FaultKind, detail: impl Into<String>) -> Self {
        Self { kind, place: Box::default(), detail: detail.into() }
    }

    /// Bytes that contradict the format.
    pub fn malformed(place: Place, detail: impl Into<String>) -> Self {
        Self { kind: FaultKind::Malformed, place: Box::new(place), detail: detail.into() }
    }

    /// A feature that is not read.
    pub fn unsupported(place: Place, detail: impl Into<String>) -> Self {
        Self { kind: FaultKind::Unsupported, place: Box::new(place), detail: detail.into() }
    }

    /// A file that ends too early.
    pub fn truncated(place: Place, detail: impl Into<String>) -> Self {
        Self { kind: FaultKind::Truncated, place: Box::new(place), detail: detail.into() }
    }

    /// A size beyond a limit.
    pub fn too_large(place: Place, detail: impl Into<String>) -> Self {
        Self { kind: FaultKind::TooLarge, place: Box::new(place), detail: detail.into() }
    }

    /// An error of a library, or of reading and writing, at a place.
    pub fn of(kind: FaultKind, place: Place, error: impl fmt::Display) -> Self {
        Self { kind, place: Box::new(place), detail: error.to_string() }
    }

    /// The same fault, whose place is completed by that of its container.
    #[must_use]
    pub fn at(mut self, outer: Place) -> Self {
        *self.place = std::mem::take(&mut *self.place).within(&outer);
        self
    }
}

impl From<std::io::Error> for FileError {
    fn from(error: std::io::Error) -> Self {
        let kind = match error.kind() {
            std::io::ErrorKind::UnexpectedEof => FaultKind::Truncated,
            std::io::ErrorKind::InvalidData => FaultKind::Malformed,
            std::io::ErrorKind::FileTooLarge => FaultKind::TooLarge,
            _ => FaultKind::Io,
        };
        Self::new(kind, error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_begin_with_the_place() {
        let inner = FileError::malformed(Place::line(7), "expected a number, got 'x'");
        assert_eq!(inner.to_string(), "line 7: expected a number, got 'x'");
        let place = Place { entry: Some("a.tps".into()), ..Place::item(2) };
        assert_eq!(inner.at(place).to_string(), "file 'a.tps', item 2, line 7: expected a number, got 'x'");
        assert_eq!(FileError::new(FaultKind::Unknown, "expected a file").to_string(), "expected a file");
    }
}
