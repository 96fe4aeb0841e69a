//! Identifiers: a prefix for the kind, then a time-ordered random number.

use std::time::{SystemTime, UNIX_EPOCH};

use uuid::{NoContext, Timestamp, Uuid};

/// A new identifier such as `coh_0198c0…`: sortable by creation, unguessable, opaque to clients.
pub fn new_id(prefix: &str) -> String {
    format!("{prefix}_{}", unique())
}

/// 32 unique hexadecimal digits, ordered by time. A clock that shows a time before 1970, which cannot be encoded, counts
/// as 1970.
pub fn unique() -> String {
    let after_1970 = SystemTime::now().duration_since(UNIX_EPOCH).is_ok();
    let id = if after_1970 { Uuid::now_v7() } else { Uuid::new_v7(Timestamp::from_unix(NoContext, 0, 0)) };
    id.simple().to_string()
}

/// Prefix of cohort identifiers.
pub const COHORT: &str = "coh";
/// Prefix of shape identifiers.
pub const SHAPE: &str = "shp";
/// Prefix of job identifiers.
pub const JOB: &str = "job";
/// Prefix of dictionary identifiers.
pub const DICTIONARY: &str = "dic";
/// Prefix of hook identifiers.
pub const HOOK: &str = "hok";
/// Prefix of key identifiers.
pub const KEY: &str = "key";
