//! Hooks: addresses to which changes are delivered, at least once and in order, each signed.
//!
//! ```text
//! webhook-id:        evt_<id of the store>_<digits of the hook's id>_<number of the change>
//! webhook-timestamp: seconds since 1970
//! webhook-signature: v1,<base64 of HMAC-SHA256(secret, "id.timestamp.body")>
//! ```
//!
//! The form is that of the Standard Webhooks specification, so that its libraries verify a delivery.

use std::fmt;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use serde::{Deserialize, Serialize};

use super::change::ChangeFilter;
use super::id;

/// Prefix of the text of every secret.
const MARK: &str = "whsec_";
/// Number of random bytes of a secret.
pub const SECRET_BYTES: usize = 32;

/// Status of a hook.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum HookStatus {
    /// Changes are delivered.
    Active,
    /// Nothing is delivered until the hook is resumed.
    Paused,
    /// Deliveries were given up, for the `reason`.
    Failed,
}

/// Secret that signs deliveries. The `Debug` form hides it.
#[derive(Clone, PartialEq, Eq)]
pub struct SigningSecret(Vec<u8>);

impl SigningSecret {
    /// A secret of these bytes.
    pub fn new(bytes: Vec<u8>) -> Self {
        Self(bytes)
    }

    /// Bytes that sign.
    pub fn bytes(&self) -> &[u8] {
        &self.0
    }

    /// Text that is shown once.
    pub fn reveal(&self) -> String {
        format!("{MARK}{}", BASE64.encode(&self.0))
    }
}

impl fmt::Debug for SigningSecret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("SigningSecret(…)")
    }
}

/// Address to which changes are delivered.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Hook {
    /// Identifier, `hok_…`.
    pub id: String,
    /// Tenant whose changes are delivered.
    pub tenant: String,
    /// Address. It may contain a secret, so it is not logged.
    pub url: String,
    /// Purpose, for people.
    pub description: String,
    /// Changes that are delivered.
    pub filter: ChangeFilter,
    /// Secret that signs deliveries.
    pub secret: SigningSecret,
    /// Status of the hook.
    pub status: HookStatus,
    /// Why deliveries were given up, or paused by a command.
    pub reason: Option<String>,
    /// Number of the last change that was delivered or needed no delivery.
    pub position: u64,
    /// Failed attempts at the next delivery.
    pub attempts: u32,
    /// Time of the first of them, milliseconds since 1970 UTC.
    pub failing_since_ms: Option<i64>,
    /// Earliest time of the next attempt, milliseconds since 1970 UTC.
    pub due_ms: i64,
    /// Time of the last delivery, milliseconds since 1970 UTC.
    pub delivered_at_ms: Option<i64>,
    /// Creation time, milliseconds since 1970 UTC.
    pub created_at_ms: i64,
}

impl Hook {
    /// Id of the delivery of a change by a store, the same for every attempt. Copies of a store have other ids: their changes with the
    /// same numbers are other changes.
    pub fn delivery_id(&self, store: &str, sequence: u64) -> String {
        let digits = self.id.trim_start_matches(id::HOOK).trim_start_matches('_');
        format!("evt_{store}_{digits}_{sequence}")
    }
}

/// An attempt at a delivery that failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HookFailure {
    /// Time of the attempt, milliseconds since 1970 UTC.
    pub at_ms: i64,
    /// Number of the change.
    pub sequence: u64,
    /// Number of the attempt, from 1.
    pub attempt: u32,
    /// Status code of the answer, if there was one.
    pub status: Option<u16>,
    /// The failure.
    pub detail: String,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_secret_is_shown_on_request_only() {
        let secret = SigningSecret::new(vec![0; SECRET_BYTES]);
        assert_eq!(format!("{secret:?}"), "SigningSecret(…)");
        assert_eq!(secret.reveal(), format!("whsec_{}=", "A".repeat(43)));
    }
}
