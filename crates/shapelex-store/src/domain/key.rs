//! API keys: the text that a program presents, and its stored form.
//!
//! ```text
//! shk_<32 hexadecimal digits of the id>_<64 of the secret>
//! ```
//!
//! Only the digest of the whole text is stored. 256 random bits cannot be guessed, so the digest need not be slow.

use std::fmt;

use super::access::{Principal, Role};
use super::id;

/// Prefix of the text of every key.
pub const MARK: &str = "shk_";
/// Number of hexadecimal digits of an id without its prefix.
const ID_DIGITS: usize = 32;
/// Number of hexadecimal digits of the secret part.
const SECRET_DIGITS: usize = 64;

/// A key without its secret.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Key {
    /// Identifier, `key_…`.
    pub id: String,
    /// Tenant that the key gives access to.
    pub tenant: String,
    /// Display name; need not be unique.
    pub name: String,
    /// Role, which determines the rights of the bearer.
    pub role: Role,
    /// Ids of the only cohorts the key gives access to; `None` for all of the tenant.
    pub cohorts: Option<Vec<String>>,
    /// BLAKE3 digest of the text of the key; compared in constant time.
    pub digest: blake3::Hash,
    /// Creation time, milliseconds since 1970 UTC.
    pub created_at_ms: i64,
    /// Time of expiry, milliseconds since 1970 UTC, if it expires.
    pub expires_at_ms: Option<i64>,
    /// Time of revocation, milliseconds since 1970 UTC.
    pub revoked_at_ms: Option<i64>,
    /// Time of last use, to the minute, milliseconds since 1970 UTC.
    pub used_at_ms: Option<i64>,
}

impl Key {
    /// Reason for the log why `text` is not accepted for this key at this time; `None` if it is accepted.
    pub fn refusal(&self, text: &str, now_ms: i64) -> Option<&'static str> {
        if self.digest != digest_of(text) {
            return Some("wrong secret");
        }
        if self.revoked_at_ms.is_some() {
            return Some("revoked key");
        }
        self.expires_at_ms.is_some_and(|end| end <= now_ms).then_some("expired key")
    }

    /// Caller that the key authenticates.
    pub fn principal(&self) -> Principal {
        Principal {
            tenant: self.tenant.clone(),
            key: self.id.clone(),
            subject: None,
            role: self.role,
            cohorts: self.cohorts.clone(),
        }
    }
}

/// Full text of a key. It is shown once; the `Debug` form hides it.
#[derive(Clone)]
pub struct Secret(String);

impl Secret {
    /// Text of the key with this id.
    pub fn new(id: &str, random: [u8; SECRET_DIGITS / 2]) -> Self {
        let digits = blake3::Hash::from_bytes(random).to_hex();
        let id = id.trim_start_matches(id::KEY).trim_start_matches('_');
        Self(format!("{MARK}{id}_{digits}"))
    }

    /// Text generated elsewhere, with the id of its key; `None` if it is not in the form of a key.
    pub fn given(text: &str) -> Option<(String, Self)> {
        Some((claimed_id(text)?, Self(text.to_owned())))
    }

    /// The text itself, to be shown once.
    pub fn reveal(&self) -> &str {
        &self.0
    }

    /// Digest to store.
    pub fn digest(&self) -> blake3::Hash {
        digest_of(&self.0)
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(…)")
    }
}

fn digest_of(text: &str) -> blake3::Hash {
    blake3::hash(text.as_bytes())
}

/// Id of the key that `text` claims to be; `None` if it is not in the form of a key.
pub fn claimed_id(text: &str) -> Option<String> {
    let (id, secret) = text.strip_prefix(MARK)?.split_once('_')?;
    (has_digits(id, ID_DIGITS) && has_digits(secret, SECRET_DIGITS)).then(|| format!("{}_{id}", id::KEY))
}

/// Whether the character is invisible or changes how its surroundings are displayed: controls (C0, C1), marks and
/// overrides of the writing direction, line and paragraph separators, and zero-width characters. With it, a name can look
/// like another name.
pub fn is_deceptive(c: char) -> bool {
    let is_format = matches!(c,
        '\u{61c}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}');
    c.is_control() || is_format
}

/// Whether `text` is in the form of a key id.
pub fn is_id(text: &str) -> bool {
    text.split_once('_').is_some_and(|(prefix, id)| prefix == id::KEY && has_digits(id, ID_DIGITS))
}

fn has_digits(text: &str, count: usize) -> bool {
    text.len() == count && text.bytes().all(|byte| byte.is_ascii_hexdigit())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(secret: &Secret, id: &str) -> Key {
        Key {
            id: id.into(),
            tenant: "a".into(),
            name: "pipeline".into(),
            role: Role::Writer,
            cohorts: None,
            digest: secret.digest(),
            created_at_ms: 0,
            expires_at_ms: Some(100),
            revoked_at_ms: None,
            used_at_ms: None,
        }
    }

    #[test]
    fn characters_that_deceive_are_known() {
        for c in [
            '\0', '\n', '\u{7f}', '\u{85}', '\u{200e}', '\u{202e}', '\u{2066}', '\u{2069}', '\u{feff}',
            '\u{2028}',
        ] {
            assert!(is_deceptive(c), "{c:?}");
        }
        assert!(!"Łódź pipeline – 第一 (א)".chars().any(is_deceptive));
    }

    #[test]
    fn a_text_names_its_key_and_opens_it_alone() {
        let id = id::new_id(id::KEY);
        let secret = Secret::new(&id, [7; 32]);
        assert_eq!(claimed_id(secret.reveal()), Some(id.clone()));
        assert!(is_id(&id) && !is_id(&id[1..]) && !is_id(&id.replace("key_", "coh_")) && !is_id("key_\0"));
        let key = key(&secret, &id);
        assert_eq!(key.refusal(secret.reveal(), 99), None);
        let other = Secret::new(&id, [8; 32]);
        assert_eq!(key.refusal(other.reveal(), 99), Some("wrong secret"));
        assert_eq!(key.refusal(secret.reveal(), 100), Some("expired key"));
        let revoked = Key { revoked_at_ms: Some(1), ..key };
        assert_eq!(revoked.refusal(secret.reveal(), 99), Some("revoked key"));
    }

    #[test]
    fn what_is_not_a_key_claims_nothing() {
        let secret = Secret::new(&id::new_id(id::KEY), [0xab; 32]);
        let text = secret.reveal();
        for wrong in ["", "shk_", "shk__", &text[1..], &text[..text.len() - 1], &format!("{text}0")] {
            assert_eq!(claimed_id(wrong), None, "{wrong}");
        }
        assert_eq!(claimed_id(&text.replace("shk_", "shq_")), None);
        assert_eq!(claimed_id(&text.replace("ab", "xy")), None);
        assert_eq!(format!("{secret:?}"), "Secret(…)");
    }
}
