//! What has changed: an entry for every change of what a tenant has, so that a pipeline can go on where it stopped.

use serde::{Deserialize, Serialize};

/// What happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ChangeKind {
    /// A cohort was created.
    CohortCreated,
    /// The name, description or unit of a cohort was changed.
    CohortUpdated,
    /// A cohort was moved to the trash.
    CohortDeleted,
    /// A cohort came back from the trash.
    CohortRestored,
    /// Shapes were added; `revision` is the one they came with.
    ShapesAdded,
    /// A shape was deleted.
    ShapeDeleted,
    /// A version of a dictionary was learnt or imported.
    DictionaryAdded,
    /// A version of a dictionary was moved to the trash.
    DictionaryDeleted,
    /// A version of a dictionary came back from the trash.
    DictionaryRestored,
}

/// A change that is to be recorded.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewChange<'a> {
    /// What happened.
    pub kind: ChangeKind,
    /// Id of what it happened to.
    pub object: &'a str,
    /// Id of its cohort.
    pub cohort: Option<&'a str>,
    /// Revision of the cohort that it brought about.
    pub revision: Option<u64>,
    /// Shapes that were added.
    pub shapes: Option<u64>,
}

impl<'a> NewChange<'a> {
    /// A change of a cohort itself.
    pub fn of_cohort(kind: ChangeKind, cohort: &'a str, revision: u64) -> Self {
        Self { kind, object: cohort, cohort: Some(cohort), revision: Some(revision), shapes: None }
    }

    /// A change of a dictionary, which was learnt from the cohort.
    pub fn of_dictionary(kind: ChangeKind, dictionary: &'a str, cohort: &'a str) -> Self {
        Self { kind, object: dictionary, cohort: Some(cohort), revision: None, shapes: None }
    }
}

/// A recorded change.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Change {
    /// Its number, from 1; changes of a tenant are numbered in their order.
    pub sequence: u64,
    /// When, milliseconds since 1970 UTC.
    pub at_ms: i64,
    /// What happened.
    pub kind: ChangeKind,
    /// Id of what it happened to.
    pub object: String,
    /// Id of its cohort.
    pub cohort: Option<String>,
    /// Revision of the cohort that it brought about.
    pub revision: Option<u64>,
    /// Shapes that were added.
    pub shapes: Option<u64>,
}
