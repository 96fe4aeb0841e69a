//! The content of a file beside its shapes, as it is answered.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::fault::brief;
use super::files::{BROKEN, Dropped, Summary};
use super::lengths::FileUnits;

/// Maximum number of warnings, and of names of items left out.
const MOST: usize = 20;

/// Account of a file by its reader.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct FileSummary {
    /// Id of the format.
    #[schema(example = "ndjson")]
    pub format: String,
    /// Number of shapes.
    pub records: u64,
    /// Facts of the file: unit, frame of reference, size of the image.
    pub properties: BTreeMap<String, serde_json::Value>,
    /// Units of the file and of the cohort or dictionary that takes its shapes; absent where there is none, or no unit of the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(required = false)]
    pub units: Option<FileUnits>,
    /// Items that were read and are not shapes.
    pub left_out: Vec<LeftOut>,
    /// Warnings.
    pub warnings: Vec<String>,
}

/// Something of a file that becomes no shape.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct LeftOut {
    /// Kind of the items.
    #[schema(example = "holes")]
    pub what: String,
    /// Number of them.
    pub count: u64,
    /// Names of the first ones.
    pub names: Vec<String>,
    /// Place of the first one.
    pub first: String,
}

impl FileSummary {
    /// The summary of a file of a format.
    pub fn new(format: &str, summary: Summary) -> Self {
        let Summary { records, properties, dropped, warnings } = summary;
        let left_out = dropped.into_iter().map(LeftOut::from).collect();
        let warnings = warnings.into_iter().take(MOST).map(brief).collect();
        Self { format: format.into(), records, properties, units: None, left_out, warnings }
    }

    /// Whether broken records were left out.
    pub fn has_broken(&self) -> bool {
        self.left_out.iter().any(|left_out| left_out.what == BROKEN)
    }

    /// Why the file may hold no shape, as far as its reader says.
    pub fn without_shapes(&self) -> Vec<String> {
        self.warnings.iter().cloned().chain(self.left_out.iter().map(LeftOut::reason)).collect()
    }

    /// The same, with the parts of records that are left out afterwards.
    #[must_use]
    pub fn without(mut self, unstored: Summary) -> Self {
        self.left_out.extend(unstored.dropped.into_iter().map(LeftOut::from));
        self
    }
}

impl LeftOut {
    /// Number and kind; of broken shapes also the place and the fault of the first one.
    fn reason(&self) -> String {
        let Self { what, count, names, first } = self;
        match names.first().filter(|_| what == BROKEN) {
            Some(fault) => format!("{count} {what}, the first at {first}: {fault}"),
            None => format!("{count} {what}"),
        }
    }
}

impl From<Dropped> for LeftOut {
    fn from(Dropped { what, count, names, first }: Dropped) -> Self {
        let names = names.into_iter().take(MOST).map(brief).collect();
        Self { what, count, names, first: brief(first.to_string()) }
    }
}

/// Items that do not become shapes, and warnings: a line each.
pub fn left_out(summary: &Summary) -> impl Iterator<Item = String> {
    let dropped = summary.dropped.iter().map(|dropped| {
        let place = dropped.first.to_string();
        let place = if place.is_empty() { place } else { format!(", the first at {place}") };
        format!("  left out: {} {}{place}", dropped.count, dropped.what)
    });
    dropped.chain(summary.warnings.iter().map(|warning| format!("  warning: {warning}")))
}
