//! Change feed: an entry for every change of a tenant's objects, so that a pipeline can resume where it stopped.

use serde::{Deserialize, Serialize};

/// Kind of change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ChangeKind {
    /// A cohort was created.
    CohortCreated,
    /// The name, description or unit of a cohort was changed.
    CohortUpdated,
    /// A cohort was moved to the trash.
    CohortDeleted,
    /// A cohort was restored from the trash.
    CohortRestored,
    /// Shapes were added; `revision` is the resulting revision.
    ShapesAdded,
    /// A shape was deleted.
    ShapeDeleted,
    /// A version of a dictionary was learnt or imported.
    DictionaryAdded,
    /// A version of a dictionary was moved to the trash.
    DictionaryDeleted,
    /// A version of a dictionary was restored from the trash.
    DictionaryRestored,
}

/// A change to be recorded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewChange<'a> {
    /// Kind of change.
    pub kind: ChangeKind,
    /// Id of the changed object.
    pub object: &'a str,
    /// Id of the cohort it belongs to.
    pub cohort: Option<&'a str>,
    /// Revision of the cohort after the change.
    pub revision: Option<u64>,
    /// Number of shapes added.
    pub shapes: Option<u64>,
}

impl<'a> NewChange<'a> {
    /// A change of a cohort itself.
    pub fn for_cohort(kind: ChangeKind, cohort: &'a str, revision: u64) -> Self {
        Self { kind, object: cohort, cohort: Some(cohort), revision: Some(revision), shapes: None }
    }

    /// A change of a dictionary that was learnt from the cohort.
    pub fn for_dictionary(kind: ChangeKind, dictionary: &'a str, cohort: &'a str) -> Self {
        Self { kind, object: dictionary, cohort: Some(cohort), revision: None, shapes: None }
    }
}

/// A recorded change.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Change {
    /// Number of the change, from 1; changes of a tenant are numbered in order.
    pub sequence: u64,
    /// Time of the change, milliseconds since 1970 UTC.
    pub at_ms: i64,
    /// Kind of change.
    pub kind: ChangeKind,
    /// Id of the changed object.
    pub object: String,
    /// Id of the cohort it belongs to.
    pub cohort: Option<String>,
    /// Revision of the cohort after the change.
    pub revision: Option<u64>,
    /// Number of shapes added.
    pub shapes: Option<u64>,
}
