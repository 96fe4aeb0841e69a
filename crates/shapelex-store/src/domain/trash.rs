//! Trash: deleted objects that can still be restored.

use serde::Serialize;

/// Kind of object in the trash.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum TrashedKind {
    /// A cohort with its shapes.
    Cohort,
    /// A version of a dictionary.
    Dictionary,
}

/// An object in the trash.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Trashed {
    /// Kind of object.
    pub kind: TrashedKind,
    /// Id of the object.
    pub id: String,
    /// Name of the object, which another object may be using by now.
    pub name: String,
    /// Version, for a dictionary.
    pub version: Option<u64>,
    /// Time of deletion, milliseconds since 1970 UTC.
    pub deleted_at_ms: i64,
}
