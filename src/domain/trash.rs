//! What was deleted and can still come back.

use serde::Serialize;

/// What it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum TrashedKind {
    /// A cohort with its shapes.
    Cohort,
    /// A version of a dictionary.
    Dictionary,
}

/// A thing in the trash.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Trashed {
    /// What it is.
    pub kind: TrashedKind,
    /// Its id.
    pub id: String,
    /// Its name, which may belong to another one by now.
    pub name: String,
    /// Version of a dictionary.
    pub version: Option<u64>,
    /// When it was deleted, milliseconds since 1970 UTC.
    pub deleted_at_ms: i64,
}
