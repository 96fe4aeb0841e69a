//! Content of a file beside its records.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::error::Place;
use crate::words::MAX_NAME;

/// Summary of a whole file by a reader or writer.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Number of records given on or written.
    pub records: u64,
    /// Facts of the file: unit, frame of reference, size of the image, orientation of axes.
    pub properties: BTreeMap<String, serde_json::Value>,
    /// Items that were read and not given on.
    pub dropped: Vec<Dropped>,
    /// Warnings for a reader of the result.
    pub warnings: Vec<String>,
}

/// Something of a file that does not become a record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Dropped {
    /// Its kind, in the plural: `holes`, `points that repeat their predecessor`, `identifying elements`.
    pub what: String,
    /// Number of them.
    pub count: u64,
    /// Names of the first ones.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub names: Vec<String>,
    /// Place of the first one.
    pub first: Place,
}

/// Name, in summaries, of broken records that are left out.
pub const BROKEN: &str = "broken shapes";

/// Number of names kept.
const NAMES: usize = 100;

/// A name as it is kept: the first bytes of one that is longer than names that shapes repeat.
pub(crate) fn shortened(name: &str) -> String {
    name[..name.floor_char_boundary(MAX_NAME)].into()
}

impl Summary {
    /// Whether broken records were left out.
    pub fn has_broken(&self) -> bool {
        self.dropped.iter().any(|dropped| dropped.what == BROKEN)
    }

    /// Counts something that is not given on.
    pub fn drop(&mut self, what: &str, name: Option<&str>, place: impl FnOnce() -> Place) {
        self.drop_many(what, 1, name, place);
    }

    /// Counts `count` items that are not given on, all with one name. Cost: that of the names that are kept.
    pub fn drop_many(&mut self, what: &str, count: u64, name: Option<&str>, place: impl FnOnce() -> Place) {
        if count == 0 {
            return;
        }
        let found = self.dropped.iter().position(|dropped| dropped.what == what);
        let at = found.unwrap_or_else(|| {
            self.dropped.push(Dropped { what: what.into(), count: 0, names: Vec::new(), first: place() });
            self.dropped.len() - 1
        });
        let dropped = &mut self.dropped[at];
        dropped.count += count;
        let room = NAMES.saturating_sub(dropped.names.len());
        let kept = usize::try_from(count).unwrap_or(room).min(room);
        dropped.names.extend(name.into_iter().flat_map(|name| std::iter::repeat_n(shortened(name), kept)));
    }

    /// Says a fact of the file.
    pub fn set(&mut self, name: &str, value: impl Into<serde_json::Value>) {
        self.properties.insert(name.into(), value.into());
    }
}
