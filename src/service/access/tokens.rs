//! Bearer tokens of an identity provider: JSON Web Tokens (RFC 7519) used as access tokens (RFC 9068).
//!
//! Checks, in this order: form, algorithm (one of a fixed list of asymmetric algorithms), signing key, signature,
//! issuer, audience, time, and the claims for role and tenant.

use std::collections::BTreeMap;

use jsonwebtoken::errors::ErrorKind;
use jsonwebtoken::{Algorithm, Header, Validation, decode, decode_header};
use serde_json::{Map, Value};

use super::Refusal;
use super::provider::{Away, Provider};
use crate::domain::access::{DEFAULT_TENANT, Principal, Role, tenant_problem};
use crate::service::app::{ServiceError, now_ms};

/// Accepted algorithms; those with a shared secret and `none` are never accepted.
const ALGORITHMS: [Algorithm; 6] = [
    Algorithm::RS256,
    Algorithm::RS384,
    Algorithm::RS512,
    Algorithm::ES256,
    Algorithm::ES384,
    Algorithm::EdDSA,
];
/// Maximum length of a subject in logs and in the audit trail.
const MAX_SUBJECT_CHARS: usize = 255;
/// Key id that stands for all bearers of tokens.
const KEY: &str = "oidc";

/// The identity provider and the meaning of its tokens.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TokenSettings {
    /// Issuer: the expected claim `iss`.
    pub issuer: String,
    /// Audience: the claim `aud`, or one of its values.
    pub audience: String,
    /// Address of its keys; `None` to discover it.
    pub jwks_url: Option<String>,
    /// Claim with the role; dots address fields of nested objects.
    pub role_claim: String,
    /// Groups of the provider in that claim that stand for roles, beside the words for roles.
    pub roles: BTreeMap<String, Role>,
    /// Claim with the tenant; `None` to assign the default tenant to all tokens.
    pub tenant_claim: Option<String>,
    /// Tolerated clock difference in seconds.
    pub leeway_s: u64,
    /// Whether tokens must declare themselves as access tokens (`at+jwt`). ID tokens, which are meant for the client
    /// alone, do not.
    pub access_only: bool,
}

/// Verifies tokens.
#[derive(Debug)]
pub(super) struct Verifier {
    settings: TokenSettings,
    provider: Provider,
}

impl Verifier {
    pub(super) fn new(settings: TokenSettings, provider: Provider) -> Self {
        Self { settings, provider }
    }

    /// The expected claim `iss`.
    pub(super) fn issuer(&self) -> &str {
        &self.settings.issuer
    }

    /// Authenticates the bearer of the token.
    pub(super) async fn check(&self, token: &str) -> Result<Principal, Refusal> {
        let header = decode_header(token).map_err(|error| failed_check(error.kind()))?;
        let key_id = known_form(&header)?;
        if self.settings.access_only && !header.typ.as_deref().is_some_and(is_access_type) {
            return Err("a token that is not of the type at+jwt".into());
        }
        let key = match self.provider.find(key_id).await {
            Ok(key) => key.ok_or("unknown key id of a token")?,
            Err(Away) => {
                let detail = "tokens cannot be checked now: the identity provider does not answer";
                return Err(Refusal::Later(ServiceError::Unavailable(detail.into())));
            }
        };
        if key.algorithm.is_some_and(|algorithm| algorithm != header.alg) {
            return Err("another algorithm of a token than that of its key".into());
        }
        let data = decode::<Map<String, Value>>(token, &key.key, &self.validation(header.alg));
        let claims = data.map_err(|error| failed_check(error.kind()))?.claims;
        // The library accepts a list that holds the issuer, and an empty subject.
        if !claims.get("iss").is_some_and(Value::is_string) {
            return Err("wrong issuer of a token".into());
        }
        if claims.get("sub").and_then(Value::as_str).is_none_or(|subject| subject.trim().is_empty()) {
            return Err("a token without exp, iss, aud or sub".into());
        }
        if is_from_the_future(&claims, now_ms(), self.settings.leeway_s) {
            return Err("a token that was issued in the future".into());
        }
        self.principal(&claims)
    }

    fn validation(&self, algorithm: Algorithm) -> Validation {
        let mut validation = Validation::new(algorithm);
        validation.leeway = self.settings.leeway_s;
        validation.validate_nbf = true;
        validation.set_issuer(&[&self.settings.issuer]);
        validation.set_audience(&[&self.settings.audience]);
        validation.set_required_spec_claims(&["exp", "iss", "aud", "sub"]);
        validation
    }

    /// Principal described by the claims.
    fn principal(&self, claims: &Map<String, Value>) -> Result<Principal, Refusal> {
        let role = claim(claims, &self.settings.role_claim);
        let role = role.and_then(|value| highest_role(value, &self.settings.roles));
        let role = role.ok_or(Refusal::Nobody("the token has none of the roles reader, writer, admin"))?;
        let tenant = match &self.settings.tenant_claim {
            Some(name) => only_tenant(claim(claims, name)).map_err(Refusal::Nobody)?,
            None => DEFAULT_TENANT,
        };
        let subject = claims.get("sub").and_then(Value::as_str).unwrap_or_default();
        Ok(Principal {
            tenant: tenant.into(),
            key: KEY.into(),
            subject: Some(subject.chars().take(MAX_SUBJECT_CHARS).collect()),
            role,
            cohorts: None,
        })
    }
}

/// Key id of a token with an accepted header.
fn known_form(header: &Header) -> Result<&str, &'static str> {
    if !ALGORITHMS.contains(&header.alg) {
        return Err("algorithm of a token that is not accepted");
    }
    if header.crit.is_some() {
        return Err("a token with conditions that are not known here");
    }
    header.kid.as_deref().ok_or("a token without key id")
}

/// Whether a type names access tokens (RFC 9068): the media type, with or without the prefix `application/`.
fn is_access_type(text: &str) -> bool {
    let text = text.to_ascii_lowercase();
    text.strip_prefix("application/").unwrap_or(&text) == "at+jwt"
}

/// Whether the token claims to be issued in the future, which means that one of the two clocks is wrong. A claim that
/// is not a number is treated the same way, because it proves nothing.
fn is_from_the_future(claims: &Map<String, Value>, now_ms: i64, leeway_s: u64) -> bool {
    let Some(issued) = claims.get("iat") else { return false };
    issued.as_f64().is_none_or(|issued_s| issued_s > now_ms as f64 / 1000.0 + leeway_s as f64)
}

/// Name of the failed check for the log; messages of the library may repeat parts of the token.
fn failed_check(error: &ErrorKind) -> Refusal {
    let check = match error {
        ErrorKind::InvalidSignature => "bad signature of a token",
        ErrorKind::ExpiredSignature => "expired token",
        ErrorKind::ImmatureSignature => "a token that is not valid yet",
        ErrorKind::InvalidIssuer => "wrong issuer of a token",
        ErrorKind::InvalidAudience => "wrong audience of a token",
        ErrorKind::MissingRequiredClaim(_) => "a token without exp, iss, aud or sub",
        ErrorKind::InvalidAlgorithm | ErrorKind::UnsupportedAlgorithm => "wrong algorithm of a token",
        _ => "not the form of a token",
    };
    check.into()
}

/// The claim with this name; if there is none, the value at `name` read as a path with dots.
fn claim<'a>(claims: &'a Map<String, Value>, name: &str) -> Option<&'a Value> {
    claims.get(name).or_else(|| {
        let (first, rest) = name.split_once('.')?;
        claim(claims.get(first)?.as_object()?, rest)
    })
}

/// The tenant of a claim: a text, or a list of it alone, as providers write attributes of people.
///
/// # Errors
/// No tenant, several of them, or a text that is the name of none.
fn only_tenant(claim: Option<&Value>) -> Result<&str, &'static str> {
    let none = "the token names no tenant";
    let found = match claim {
        Some(Value::Array(values)) => {
            let (first, others) = values.split_first().ok_or(none)?;
            if others.iter().any(|other| other != first) {
                return Err("the token names several tenants, expected one");
            }
            first
        }
        found => found.ok_or(none)?,
    };
    let tenant = found.as_str().ok_or(none)?;
    match tenant_problem(tenant) {
        None => Ok(tenant),
        Some(_) => Err("the token names a tenant in a form that no tenant has"),
    }
}

/// Highest role in a list, or in a string with spaces, where `groups` stand for roles too; their names may have spaces.
fn highest_role(value: &Value, groups: &BTreeMap<String, Role>) -> Option<Role> {
    let role = |text: &str| Role::from_word(text).or_else(|| groups.get(text).copied());
    match value {
        Value::String(text) => text.split_whitespace().chain([text.as_str()]).filter_map(role).max(),
        Value::Array(texts) => texts.iter().filter_map(|text| role(text.as_str()?)).max(),
        _ => None,
    }
}

/// Roles of groups, from `group=role; group=role`. A group may have commas and equals signs, as names of directories have.
///
/// # Errors
/// The part that is none.
pub fn roles_of_groups(text: &str) -> Result<BTreeMap<String, Role>, String> {
    let parts = text.split(';').map(str::trim).filter(|part| !part.is_empty());
    let pair = |part: &str| {
        let (group, word) = part.rsplit_once('=')?;
        let group = group.trim();
        Role::from_word(word.trim()).filter(|_| !group.is_empty()).map(|role| (group.to_owned(), role))
    };
    let refused = |part: &str| {
        format!(
            "expected groups with their roles, such as /clinic/staff=reader; /clinic/admins=admin, got '{part}'"
        )
    };
    parts.map(|part| pair(part).ok_or_else(|| refused(part))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn the_type_of_access_tokens_has_two_forms() {
        for (text, is_one) in
            [("at+jwt", true), ("AT+JWT", true), ("application/at+jwt", true), ("JWT", false), ("", false)]
        {
            assert_eq!(is_access_type(text), is_one, "{text}");
        }
    }

    #[test]
    fn what_was_issued_later_than_now_is_from_the_future() {
        let is_future = |issued: Value| {
            let claims = json!({ "iat": issued });
            is_from_the_future(claims.as_object().unwrap(), 1_000_000, 30)
        };
        assert!(!is_future(json!(1000)) && !is_future(json!(1030)) && !is_future(json!(999.5)));
        assert!(is_future(json!(1031)) && is_future(json!("1000")) && is_future(json!(1e300)));
        assert!(!is_from_the_future(&Map::new(), 0, 0));
    }

    #[test]
    fn groups_stand_for_roles() {
        let groups =
            roles_of_groups("/radiology/Writer = writer; CN=Shape Readers,OU=Clinic=reader;").unwrap();
        let role = |value: Value| highest_role(&value, &groups);
        assert_eq!(role(json!(["/radiology/Writer", "/x"])), Some(Role::Writer));
        assert_eq!(role(json!("/radiology/Writer admin")), Some(Role::Admin));
        assert_eq!(role(json!("CN=Shape Readers,OU=Clinic")), Some(Role::Reader));
        assert_eq!([role(json!("/radiology")), role(json!(["/radiology/writer"]))], [None, None]);
        assert_eq!(roles_of_groups(""), Ok(BTreeMap::new()));
        for wrong in ["staff", "staff=root", "=admin", "a=reader;b"] {
            assert!(
                roles_of_groups(wrong).unwrap_err().contains("expected groups with their roles"),
                "{wrong}"
            );
        }
    }

    #[test]
    fn a_tenant_is_a_text_or_the_only_one_of_a_list() {
        let tenant = |value: Value| only_tenant(Some(&value)).map(str::to_owned);
        for one in [json!("clinic"), json!(["clinic"]), json!(["clinic", "clinic"])] {
            assert_eq!(tenant(one), Ok("clinic".into()));
        }
        for (wrong, said) in [
            (json!(["clinic", "other"]), "several tenants"),
            (json!(["clinic", 3]), "several tenants"),
            (json!([]), "no tenant"),
            (json!([["clinic"]]), "no tenant"),
            (json!({"clinic": true}), "no tenant"),
            (Value::Null, "no tenant"),
            (json!(["a\nb"]), "form"),
            (json!(""), "form"),
        ] {
            assert!(tenant(wrong.clone()).unwrap_err().contains(said), "{wrong}");
        }
        assert!(only_tenant(None).is_err());
    }

    #[test]
    fn roles_are_read_from_texts_lists_and_paths() {
        let claims = json!({"roles": ["reader", "admin", 3], "scope": "openid writer reader", "none": ["root"],
            "realm_access": {"roles": ["writer"]}, "a.b": "reader", "a": {"b": "admin"}});
        let claims = claims.as_object().unwrap();
        let role = |name: &str| claim(claims, name).and_then(|value| highest_role(value, &BTreeMap::new()));
        assert_eq!(role("roles"), Some(Role::Admin));
        assert_eq!(role("scope"), Some(Role::Writer));
        assert_eq!(role("realm_access.roles"), Some(Role::Writer));
        assert_eq!(role("a.b"), Some(Role::Reader));
        assert_eq!([role("none"), role("absent"), role("realm_access"), role("roles.x")], [None; 4]);
    }
}
