//! Erasures of subjects: who was erased is kept as a digest, so that nothing of the name is left.
//!
//! ```text
//! digest = BLAKE3 of (tenant, U+0000, subject), in a mode of derivation with the context of this file
//! ```
//!
//! It has no key: the same subject has the same digest in a backup, however old, and an erasure can be repeated there. Who holds the list can
//! therefore test whether a subject that they know was erased.

use serde::{Deserialize, Serialize};

/// Context of the digests; another one would make other digests.
const CONTEXT: &str = "shapelex 2026-11-29 subjects that were erased";

/// Digest of a subject of a tenant.
pub fn subject_digest(tenant: &str, subject: &str) -> [u8; 32] {
    let mut digest = blake3::Hasher::new_derive_key(CONTEXT);
    digest.update(tenant.as_bytes()).update(&[0]).update(subject.as_bytes());
    *digest.finalize().as_bytes()
}

/// How far an erasure has come.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ErasureState {
    /// No revision shows the shapes any more; their control points are being overwritten.
    Erasing,
    /// The store holds nothing of them; parts of its files that it does not use may.
    Pending,
    /// Its files neither.
    Done,
}

/// The last erasure of a subject.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Erasure {
    /// Tenant of the subject.
    pub tenant: String,
    /// Digest of the subject.
    pub subject: [u8; 32],
    /// Time of the erasure, milliseconds since 1970 UTC.
    pub erased_at_ms: i64,
    /// How far it has come.
    pub state: ErasureState,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digests_tell_tenants_and_subjects_apart_and_do_not_change() {
        assert_ne!(subject_digest("a", "b"), subject_digest("a", "c"));
        assert_ne!(subject_digest("a", "b"), subject_digest("b", "b"));
        assert_ne!(subject_digest("a", "bc"), subject_digest("ab", "c"));
        let text = blake3::Hash::from_bytes(subject_digest("default", "patient-1")).to_hex();
        assert_eq!(text.as_str(), "e825033d1f5663eac952493e2c2218a5ce0e630bb78fa3819093c56ea4f1fe6e");
    }
}
