//! Identifiers: a prefix that names the kind, then a time-ordered random number.

/// A new identifier such as `coh_0198c0…`: sortable by creation, unguessable, opaque to clients.
pub fn new_id(prefix: &str) -> String {
    format!("{prefix}_{}", uuid::Uuid::now_v7().simple())
}

/// Prefix of cohort identifiers.
pub const COHORT: &str = "coh";
/// Prefix of shape identifiers.
pub const SHAPE: &str = "shp";
