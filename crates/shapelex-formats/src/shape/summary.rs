//! What a file holds beside its records.

use std::collections::BTreeMap;

use serde::Serialize;

use super::error::Place;

/// What a reader or writer says of a whole file.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Number of records given on or written.
    pub records: u64,
    /// Facts of the file: unit, frame of reference, size of the image, orientation of axes.
    pub properties: BTreeMap<String, serde_json::Value>,
    /// What was read and not given on.
    pub dropped: Vec<Dropped>,
    /// What a reader of the result should know.
    pub warnings: Vec<String>,
}

/// Something of a file that does not become a record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Dropped {
    /// What it is, in the plural: `holes`, `points that repeat their predecessor`, `identifying elements`.
    pub what: String,
    /// Number of them.
    pub count: u64,
    /// Names of the first ones.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub names: Vec<String>,
    /// Place of the first one.
    pub first: Place,
}

/// Number of names kept.
const NAMES: usize = 100;
/// Number of bytes kept of a name.
const LENGTH: usize = 1024;

/// A name as it is kept: the first 1024 bytes of a longer one.
pub(super) fn shortened(name: &str) -> String {
    name[..name.floor_char_boundary(LENGTH)].into()
}

impl Summary {
    /// Counts something that is not given on.
    pub fn drop(&mut self, what: &str, name: Option<&str>, place: impl FnOnce() -> Place) {
        let found = self.dropped.iter().position(|dropped| dropped.what == what);
        let at = found.unwrap_or_else(|| {
            self.dropped.push(Dropped { what: what.into(), count: 0, names: Vec::new(), first: place() });
            self.dropped.len() - 1
        });
        let dropped = &mut self.dropped[at];
        dropped.count += 1;
        if let Some(name) = name.filter(|_| dropped.names.len() < NAMES) {
            dropped.names.push(shortened(name));
        }
    }

    /// Says a fact of the file.
    pub fn set(&mut self, name: &str, value: impl Into<serde_json::Value>) {
        self.properties.insert(name.into(), value.into());
    }
}
