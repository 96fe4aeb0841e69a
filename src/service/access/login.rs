//! Login on the page by the identity provider: the authorisation code flow with PKCE (RFC 7636) of a public client, which the page
//! itself follows. The service only says where, and verifies the tokens that come of it as all others.

use reqwest::Url;
use serde::Serialize;

/// Login by the identity provider on the page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LoginSettings {
    /// Address of the provider: the claim `iss`.
    pub issuer: String,
    /// Id of the page at the provider.
    pub client_id: String,
    /// Scopes that the page asks for, separated by spaces.
    pub scope: String,
}

/// Values that the page needs to send people to the provider; they are not secret.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Login {
    issuer: String,
    client_id: String,
    scope: String,
    /// Origin of the issuer: the only one, beside its own, that the page may call.
    #[serde(skip)]
    origin: String,
}

impl Login {
    /// # Errors
    /// An issuer that is not a URL.
    pub(super) fn new(settings: LoginSettings) -> Result<Self, String> {
        let LoginSettings { issuer, client_id, scope } = settings;
        let url = Url::parse(&issuer).map_err(|error| format!("expected a URL, got '{issuer}': {error}"))?;
        let origin = url.origin().ascii_serialization();
        Ok(Self { issuer, client_id, scope, origin })
    }

    /// Origin of the issuer.
    pub fn origin(&self) -> &str {
        &self.origin
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_may_call_the_origin_of_the_issuer_and_no_path_of_it_matters() {
        let settings = |issuer: &str| LoginSettings {
            issuer: issuer.into(),
            client_id: "page".into(),
            scope: "openid".into(),
        };
        for (issuer, origin) in [
            ("https://id.example/realms/clinic", "https://id.example"),
            ("https://id.example:8443/", "https://id.example:8443"),
            ("http://127.0.0.1:9000", "http://127.0.0.1:9000"),
        ] {
            assert_eq!(Login::new(settings(issuer)).unwrap().origin(), origin);
        }
        assert!(Login::new(settings("id.example")).unwrap_err().contains("expected a URL"));
    }
}
