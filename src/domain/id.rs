//! Identifiers: a prefix that names the kind, then a time-ordered random number.

/// A new identifier such as `coh_0198c0…`: sortable by creation, unguessable, opaque to clients.
pub fn new_id(prefix: &str) -> String {
    format!("{prefix}_{}", uuid::Uuid::now_v7().simple())
}

/// Prefix of cohort identifiers.
pub const COHORT: &str = "coh";
/// Prefix of shape identifiers.
pub const SHAPE: &str = "shp";
/// Prefix of job identifiers.
pub const JOB: &str = "job";
/// Prefix of dictionary identifiers.
pub const DICTIONARY: &str = "dic";
/// Prefix of key identifiers.
pub const KEY: &str = "key";
