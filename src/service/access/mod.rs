//! Access control: identifies the caller of a request from its credentials.
//!
//! ```text
//! credential       open service                 closed service
//! none             admin of the default tenant  refused
//! shk_…            the key's tenant and role    the same
//! another token    refused                      per identity provider, if one is configured
//! ```
//!
//! A service is open while it listens on a loopback address, has no key and no identity provider. Invalid credentials
//! are refused in both cases: clients get one fixed sentence; the log says which check failed, and for which key.
//!
//! * [`keys`] — keys of programs: create, list, revoke, check;
//! * [`tokens`] — bearer tokens of an identity provider; `provider` — its public keys;
//! * [`login`] — values that the page needs to send people there.

pub mod keys;
pub mod login;
mod provider;
pub mod tokens;

use std::net::SocketAddr;
use std::sync::Arc;

use crate::domain::access::Principal;
use crate::domain::key;
use crate::service::access::keys::KeyCache;
use crate::service::access::login::{Login, LoginSettings};
use crate::service::access::provider::Provider;
use crate::service::access::tokens::Verifier;
use crate::service::app::{App, ServiceError, now_ms};

/// Settings of access control.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct AccessSettings {
    /// Whether only users of this machine can reach the service.
    pub loopback: bool,
    /// Whether the metrics are readable without credentials.
    pub metrics_open: bool,
    /// Origins whose pages may read answers in a browser.
    pub origins: Vec<String>,
    /// The identity provider, if one is trusted.
    pub tokens: Option<tokens::TokenSettings>,
    /// Login by the identity provider on the page, if there is one.
    pub login: Option<LoginSettings>,
}

/// State of access control.
#[derive(Debug)]
pub struct Access {
    loopback: bool,
    metrics_open: bool,
    origins: Vec<String>,
    keys: KeyCache,
    tokens: Option<Verifier>,
    login: Option<Login>,
}

impl Default for Access {
    /// Access control of a service on a loopback address.
    fn default() -> Self {
        let (keys, origins) = (KeyCache::default(), Vec::new());
        Self { loopback: true, metrics_open: false, origins, keys, tokens: None, login: None }
    }
}

impl Access {
    /// Access control with these settings; the keys of the identity provider are fetched on demand.
    ///
    /// # Errors
    /// Invalid settings, described in one sentence.
    pub fn new(settings: AccessSettings) -> Result<Self, String> {
        let AccessSettings { loopback, metrics_open, origins, tokens, login } = settings;
        let verifier = |settings: tokens::TokenSettings| {
            let provider = Provider::new(&settings.issuer, settings.jwks_url.as_deref())?;
            Ok::<_, String>(Verifier::new(settings, provider))
        };
        let tokens = tokens.map(verifier).transpose()?;
        let login = login.map(Login::new).transpose()?;
        Ok(Self { loopback, metrics_open, origins, keys: KeyCache::default(), tokens, login })
    }
}

/// Credential of a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shown<'a> {
    /// No credential.
    Nothing,
    /// A bearer token: a key, or a token of the identity provider.
    Bearer(&'a str),
    /// Another credential, or more than one.
    Unreadable,
}

/// Reason for refusing a credential.
#[derive(Debug)]
enum Refusal {
    /// A check failed: the id of the key, if known, and the name of the check.
    Check(Option<String>, &'static str),
    /// The caller is authenticated but has no role or tenant here.
    Nobody(&'static str),
    /// The credential cannot be checked at the moment.
    Later(ServiceError),
}

impl From<&'static str> for Refusal {
    fn from(check: &'static str) -> Self {
        Self::Check(None, check)
    }
}

/// Identifies the caller of a request. `quiet`: refusals are logged at level debug only, because the same address has
/// caused many.
///
/// # Errors
/// [`ServiceError::Unauthenticated`] for everything that is not a valid key or token; [`ServiceError::Forbidden`] for
/// tokens without a role or tenant; [`ServiceError::Unavailable`] if the store or the identity provider cannot be
/// reached.
pub async fn identify(app: &App, shown: Shown<'_>, quiet: bool) -> Result<Principal, ServiceError> {
    let found = match shown {
        Shown::Nothing if is_open(app).await? => return Ok(Principal::local()),
        Shown::Nothing => return Err(ServiceError::Unauthenticated),
        Shown::Unreadable => Err("no bearer token in the header".into()),
        Shown::Bearer(text) if text.starts_with(key::MARK) => keys::check(app, text).await,
        Shown::Bearer(text) => match &app.access().tokens {
            Some(verifier) => verifier.check(text).await,
            None => Err("a token, but no identity provider is set".into()),
        },
    };
    found.map_err(|refusal| match refusal {
        Refusal::Check(key, check) => {
            if quiet {
                tracing::debug!(key, check, "a credential was refused");
            } else {
                tracing::warn!(key, check, "a credential was refused");
            }
            ServiceError::Unauthenticated
        }
        Refusal::Nobody(lack) => {
            if quiet {
                tracing::debug!(check = lack, "a token gives no access here");
            } else {
                tracing::warn!(check = lack, "a token gives no access here");
            }
            ServiceError::Forbidden(lack.into())
        }
        Refusal::Later(error) => error,
    })
}

/// Whether the service accepts requests without credentials.
///
/// # Errors
/// A failure of the store.
pub async fn is_open(app: &App) -> Result<bool, ServiceError> {
    Ok(app.access().loopback && app.access().tokens.is_none() && !keys::exist(app).await?)
}

/// Whether the caller of a request that lasts would be let in again: its key is neither revoked nor expired, or the service is
/// still open. Nothing is known of a token after it was presented.
///
/// # Errors
/// A failure of the store.
pub async fn still_admits(app: &App) -> Result<bool, ServiceError> {
    let id = &app.principal.key;
    if app.principal.is_local() {
        return is_open(app).await;
    }
    if !key::is_id(id) {
        return Ok(true);
    }
    let found = keys::known(app, id).await?;
    let lives = |key: &key::Key| key.expires_at_ms.is_none_or(|end| end > now_ms());
    Ok(found.is_some_and(|key| key.revoked_at_ms.is_none() && lives(&key)))
}

/// Checks that the service is not open to the network: without keys and identity provider, it may only listen on a
/// loopback address.
///
/// # Errors
/// The reason why it must not start on `address`, and the remedy, in one sentence.
pub async fn check_start(app: &App, address: SocketAddr) -> Result<(), String> {
    if app.access().loopback || app.access().tokens.is_some() {
        return Ok(());
    }
    if keys::exist(app).await.map_err(|error| error.to_string())? {
        return Ok(());
    }
    Err(format!(
        "refusing to listen on {address} without a key, because anyone could read and delete everything: create \
         one with `shapelex key create --name admin --role admin` and the same data folder or database, set an \
         identity provider (oidc_issuer), or listen on a loopback address"
    ))
}

impl App {
    /// Replaces the access control; called before the service takes requests.
    #[must_use]
    pub fn with_access(self, access: Access) -> Self {
        self.put_state(access);
        self
    }

    fn access(&self) -> Arc<Access> {
        self.state()
    }

    /// Origins whose pages may read answers in a browser.
    pub fn allowed_origins(&self) -> Vec<String> {
        self.access().origins.clone()
    }

    /// Whether a page of this origin may read answers in a browser.
    pub fn allows_origin(&self, origin: &str) -> bool {
        self.access().origins.iter().any(|allowed| allowed == origin)
    }

    /// Login by the identity provider on the page, if there is one.
    pub fn login(&self) -> Option<Login> {
        self.access().login.clone()
    }

    /// Issuer of the tokens that are accepted, if an identity provider is trusted.
    pub fn token_issuer(&self) -> Option<String> {
        self.access().tokens.as_ref().map(|verifier| verifier.issuer().to_owned())
    }

    /// Whether the metrics are readable without credentials.
    pub fn metrics_are_open(&self) -> bool {
        self.access().metrics_open
    }
}
