//! Audit trail: who did what to which object, when, and the outcome.
//!
//! The entries of a tenant form a hash chain: each digest covers the previous one, so that changing, removing or inserting
//! an entry changes all later digests.
//!
//! ```text
//! digest₀ = 32 zero bytes,   digestₙ = blake3(digestₙ₋₁ ‖ textₙ)
//! ```

use std::collections::BTreeMap;

use serde_json::json;

/// Length of a digest in bytes.
pub const DIGEST_BYTES: usize = 32;

/// Digest that links an entry to those before it.
pub type Digest = [u8; DIGEST_BYTES];

/// Link before the first entry of a tenant.
pub const FIRST_LINK: Digest = [0; DIGEST_BYTES];

/// One request.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Entry {
    /// Time at which it was answered, milliseconds since 1970 UTC.
    pub at_ms: i64,
    /// Tenant whose objects it concerned; empty if the caller is unknown.
    pub tenant: String,
    /// Id of the key.
    pub key: Option<String>,
    /// Subject of the bearer token.
    pub subject: Option<String>,
    /// Operation id in the OpenAPI document.
    pub operation: Option<String>,
    /// HTTP method.
    pub method: String,
    /// Path template of the route; `None` if none matched.
    pub route: Option<String>,
    /// Objects by path parameter, as the caller named them, and the ids of the objects it used and created.
    pub objects: BTreeMap<String, String>,
    /// Status code of the response; `None` if the caller disconnected before it was sent.
    pub status: Option<u16>,
    /// Request id, as in the log.
    pub request_id: String,
    /// Address of the caller.
    pub remote: Option<String>,
}

/// An entry with its position in the trail.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recorded {
    /// Position, from 1.
    pub sequence: u64,
    /// The recorded request.
    pub entry: Entry,
    /// Digest of the entry, which links it to the previous one.
    pub digest: Digest,
}

impl Recorded {
    /// Appends `entry` after the entry with the given position and digest.
    pub fn after(sequence: u64, link: &Digest, entry: Entry) -> Self {
        let mut recorded = Self { sequence: sequence + 1, entry, digest: FIRST_LINK };
        recorded.digest = recorded.expected_digest(link);
        recorded
    }

    /// Digest the entry should have after the entry with digest `link`; it differs if the entry was altered.
    pub fn expected_digest(&self, link: &Digest) -> Digest {
        *blake3::Hasher::new().update(link).update(self.text().as_bytes()).finalize().as_bytes()
    }

    /// Text covered by the digest: a JSON array without spaces.
    fn text(&self) -> String {
        let Entry {
            at_ms,
            tenant,
            key,
            subject,
            operation,
            method,
            route,
            objects,
            status,
            request_id,
            remote,
        } = &self.entry;
        json!([
            self.sequence,
            at_ms,
            tenant,
            key,
            subject,
            operation,
            method,
            route,
            objects,
            status,
            request_id,
            remote
        ])
        .to_string()
    }
}

/// Filter of the audit trail.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct AuditFilter {
    /// Entries at or after this time, milliseconds since 1970 UTC.
    pub since_ms: Option<i64>,
    /// Entries before this time, milliseconds since 1970 UTC.
    pub until_ms: Option<i64>,
    /// Id of the key used.
    pub key: Option<String>,
    /// Operation id.
    pub operation: Option<String>,
    /// Id of an object, or its name in the path.
    pub object: Option<String>,
    /// Status code of the response.
    pub status: Option<u16>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_field_and_every_place_has_a_digest_of_its_own() {
        let entry = Entry { at_ms: 1, tenant: "a".into(), method: "GET".into(), ..Entry::default() };
        let some = |text: &str| Some(text.to_owned());
        let objects = BTreeMap::from([("cohort".to_owned(), "coh_1".to_owned())]);
        let others = [
            entry.clone(),
            Entry { at_ms: 2, ..entry.clone() },
            Entry { tenant: "b".into(), ..entry.clone() },
            Entry { key: some("k"), ..entry.clone() },
            Entry { subject: some("k"), ..entry.clone() },
            Entry { operation: some("k"), ..entry.clone() },
            Entry { method: "k".into(), ..entry.clone() },
            Entry { route: some("k"), ..entry.clone() },
            Entry { objects, ..entry.clone() },
            Entry { status: Some(200), ..entry.clone() },
            Entry { request_id: "k".into(), ..entry.clone() },
            Entry { remote: some("k"), ..entry.clone() },
        ];
        let mut digests: Vec<Digest> =
            others.into_iter().map(|entry| Recorded::after(0, &FIRST_LINK, entry).digest).collect();
        digests.push(Recorded::after(1, &FIRST_LINK, entry.clone()).digest);
        digests.push(Recorded::after(0, &[1; DIGEST_BYTES], entry).digest);
        let count = digests.len();
        digests.sort_unstable();
        digests.dedup();
        assert_eq!(digests.len(), count);
    }

    #[test]
    fn the_digest_is_that_of_the_documented_text() {
        let entry = Entry {
            at_ms: 5,
            tenant: "a".into(),
            method: "GET".into(),
            status: Some(200),
            ..Entry::default()
        };
        let text = r#"[1,5,"a",null,null,null,"GET",null,{},200,"",null]"#;
        let wanted = blake3::hash(&[&FIRST_LINK[..], text.as_bytes()].concat());
        assert_eq!(Recorded::after(0, &FIRST_LINK, entry).digest, *wanted.as_bytes());
    }
}
