//! Subjects of persons whom files identify: keyed digests, which tell a reader without the key nothing.
//!
//! ```text
//! subject = sub_ + base32(HMAC-SHA256(secret of the tenant, Issuer of Patient ID + U+001F + Patient ID))[..26]
//! ```
//!
//! The same person is the same subject in all files of a tenant. The secret stays in the database.

use aws_lc_rs::hmac;
use rand::TryRng;
use rand::rngs::SysRng;
use serde::{Deserialize, Serialize};

use crate::service::app::{App, ServiceError};

/// Number of bytes of a secret.
const SECRET_BYTES: usize = 32;
/// Number of letters after the prefix: 130 bits.
const LETTERS: usize = 26;
const ALPHABET: &[u8; 32] = b"abcdefghijklmnopqrstuvwxyz234567";

/// Entry of a file that names the subject of its shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
pub enum SubjectFrom {
    /// Patient ID and its issuer, of DICOM.
    #[serde(rename = "PatientID")]
    PatientId,
}

/// The keyed digest of a tenant.
pub(super) struct Pseudonyms(hmac::Key);

impl Pseudonyms {
    /// That of the tenant of the request, whose secret is made on first use.
    ///
    /// # Errors
    /// A failure of the store, or of the random numbers of the system.
    pub(super) async fn of(app: &App) -> Result<Self, ServiceError> {
        let secret = app.store.subject_secret(&fresh()?).await?;
        Ok(Self(hmac::Key::new(hmac::HMAC_SHA256, &secret)))
    }

    /// The same, without making a secret: where there is none, no stored subject is a digest.
    ///
    /// # Errors
    /// A failure of the store, or of the random numbers of the system.
    pub(super) async fn of_preview(app: &App) -> Result<Self, ServiceError> {
        let secret = match app.store.find_subject_secret().await? {
            Some(secret) => secret,
            None => fresh()?.to_vec(),
        };
        Ok(Self(hmac::Key::new(hmac::HMAC_SHA256, &secret)))
    }

    /// The subject of a person.
    pub(super) fn subject(&self, person: &str) -> String {
        let tag = hmac::sign(&self.0, person.as_bytes());
        let letter = |k: usize| {
            let bit = |at: usize| usize::from(tag.as_ref()[at / 8] >> (7 - at % 8) & 1);
            let value = (5 * k..5 * k + 5).fold(0, |value, at| value << 1 | bit(at));
            char::from(ALPHABET[value])
        };
        std::iter::once("sub_".to_owned()).chain((0..LETTERS).map(|k| letter(k).into())).collect()
    }
}

/// A new secret.
fn fresh() -> Result<[u8; SECRET_BYTES], ServiceError> {
    let mut secret = [0; SECRET_BYTES];
    let failed = |error| ServiceError::Internal(format!("the system has no random numbers: {error}"));
    SysRng.try_fill_bytes(&mut secret).map_err(failed)?;
    Ok(secret)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The second test case of RFC 4231, in base32.
    #[test]
    fn a_subject_is_the_keyed_digest() {
        let pseudonyms = Pseudonyms(hmac::Key::new(hmac::HMAC_SHA256, b"Jefe"));
        let subject = pseudonyms.subject("what do ya want for nothing?");
        assert_eq!(subject, "sub_lpomcrv7mb2u42qeeqtarflvy5");
    }
}
