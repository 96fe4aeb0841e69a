//! Access: who asks, found out from what a request shows.
//!
//! ```text
//! shown            open service                 closed service
//! nothing          admin of the default tenant  refused
//! shk_…            the key's tenant and role    the same
//! another token    refused                      that of the identity provider, when there is one
//! ```
//!
//! A service is open as long as it listens on a loopback address, has no key and knows no identity provider. What is shown
//! and wrong is refused in both: clients hear one sentence, the log says which check failed, and of which key.
//!
//! * [`keys`] — keys of programs: create, list, revoke, check;
//! * [`tokens`] — bearer tokens of an identity provider; `provider` — its public keys.

pub mod keys;
mod provider;
pub mod tokens;

use std::net::SocketAddr;
use std::sync::Arc;

use crate::domain::access::Principal;
use crate::domain::key;
use crate::service::access::keys::KeyCache;
use crate::service::access::provider::Provider;
use crate::service::access::tokens::Verifier;
use crate::service::app::{App, ServiceError};

/// Who is let in without asking, and which identity provider is trusted.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct AccessSettings {
    /// Whether nobody but this machine's users can reach the service.
    pub loopback: bool,
    /// Whether the metrics are shown to everyone.
    pub metrics_open: bool,
    /// The identity provider.
    pub tokens: Option<tokens::TokenSettings>,
}

/// What is needed to find out who asks.
#[derive(Debug)]
pub struct Access {
    loopback: bool,
    metrics_open: bool,
    keys: KeyCache,
    tokens: Option<Verifier>,
}

impl Default for Access {
    /// That of a service which only this machine's users reach.
    fn default() -> Self {
        Self { loopback: true, metrics_open: false, keys: KeyCache::default(), tokens: None }
    }
}

impl Access {
    /// As set; the keys of the identity provider are fetched when they are needed.
    ///
    /// # Errors
    /// Settings that make no sense, in one sentence.
    pub fn new(settings: AccessSettings) -> Result<Self, String> {
        let AccessSettings { loopback, metrics_open, tokens } = settings;
        let verifier = |settings: tokens::TokenSettings| {
            let provider = Provider::new(&settings.issuer, settings.jwks_url.as_deref())?;
            Ok::<_, String>(Verifier::new(settings, provider))
        };
        let tokens = tokens.map(verifier).transpose()?;
        Ok(Self { loopback, metrics_open, keys: KeyCache::default(), tokens })
    }
}

/// What a request shows of who sends it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shown<'a> {
    /// Nothing.
    Nothing,
    /// A bearer token: a key, or one of the identity provider.
    Bearer(&'a str),
    /// Something else, or more than one thing.
    Unreadable,
}

/// Why something shown was refused.
#[derive(Debug)]
enum Refusal {
    /// A check failed: of this key, when it is known, at this check.
    Check(Option<String>, &'static str),
    /// It is known who asks, and that they may do nothing here.
    Nobody(&'static str),
    /// It cannot be said now.
    Later(ServiceError),
}

impl From<&'static str> for Refusal {
    fn from(check: &'static str) -> Self {
        Self::Check(None, check)
    }
}

/// Who sends a request. `quiet`: the log has what is refused only at level debug, as there was much
/// from the same address.
///
/// # Errors
/// [`ServiceError::Unauthenticated`] for everything that is not a valid key or token; [`ServiceError::Forbidden`] for
/// tokens without a role; [`ServiceError::Unavailable`] when the store or the identity provider is away.
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
                tracing::debug!(check = lack, "a token opens nothing here");
            } else {
                tracing::warn!(check = lack, "a token opens nothing here");
            }
            ServiceError::Forbidden(lack.into())
        }
        Refusal::Later(error) => error,
    })
}

/// Whether whoever reaches the service is let in.
///
/// # Errors
/// A failure of the store.
pub async fn is_open(app: &App) -> Result<bool, ServiceError> {
    Ok(app.access().loopback && app.access().tokens.is_none() && !keys::exist(app).await?)
}

/// Refuses to serve strangers: without keys and identity provider, only this machine's users may reach the service.
///
/// # Errors
/// Why it must not start on `address`, and what to do, in one sentence.
pub async fn check_start(app: &App, address: SocketAddr) -> Result<(), String> {
    if app.access().loopback || app.access().tokens.is_some() {
        return Ok(());
    }
    if keys::exist(app).await.map_err(|error| error.to_string())? {
        return Ok(());
    }
    Err(format!(
        "refusing to listen on {address}: there is no key, and anyone could read and delete everything; create one by \
         `shapelex key create --name admin --role admin` with the same data folder or database, set an identity \
         provider (oidc_issuer), or listen on a loopback address"
    ))
}

impl App {
    /// The same service with this access; before it takes requests.
    #[must_use]
    pub fn with_access(self, access: Access) -> Self {
        self.put_state(access);
        self
    }

    fn access(&self) -> Arc<Access> {
        self.state()
    }

    /// Whether the metrics are shown to everyone.
    pub fn metrics_are_open(&self) -> bool {
        self.access().metrics_open
    }
}
