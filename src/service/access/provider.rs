//! Public keys of an identity provider: fetched on demand, and kept while the provider cannot be reached.
//!
//! * An unknown key id triggers a request to the provider, at most once per [`MISS_PAUSE`]: new keys are found at once,
//!   and invented ids do not flood the provider.
//! * Keys older than [`OLD`] are refreshed in the background, so that withdrawn keys are forgotten.
//! * If a refresh fails, the last valid set stays.

use std::collections::HashMap;
use std::sync::{Arc, RwLock};
use std::time::{Duration, Instant};

use jsonwebtoken::jwk::{Jwk, PublicKeyUse};
use jsonwebtoken::{Algorithm, DecodingKey};
use reqwest::{Client, Url};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

/// Minimum time between two requests caused by unknown key ids.
const MISS_PAUSE: Duration = Duration::from_secs(60);
/// Minimum time between two requests while no set of keys is known.
const FIRST_PAUSE: Duration = Duration::from_secs(5);
/// Age at which the keys are refreshed.
const OLD: Duration = Duration::from_secs(900);
/// Timeout of a request to the provider.
const TIMEOUT: Duration = Duration::from_secs(5);
/// Maximum size of a response of the provider.
const MAX_BYTES: usize = 1 << 20;
/// Maximum number of keys in a set.
const MAX_KEYS: usize = 256;

/// A public key and, if the provider declares it, its algorithm.
#[derive(Debug)]
pub(super) struct ProviderKey {
    pub(super) key: DecodingKey,
    pub(super) algorithm: Option<Algorithm>,
}

type Keys = HashMap<String, Arc<ProviderKey>>;

/// The identity provider. Clones share its keys.
#[derive(Debug, Clone)]
pub(super) struct Provider(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    client: Client,
    issuer: String,
    /// Address of the keys, if configured; otherwise it is discovered.
    jwks_url: Option<Url>,
    known: RwLock<Known>,
    /// Held during a request to the provider.
    asking: tokio::sync::Mutex<Asked>,
}

#[derive(Debug, Default)]
struct Known {
    keys: Keys,
    since: Option<Instant>,
}

#[derive(Debug, Default)]
struct Asked {
    /// Time of the last request.
    last: Option<Instant>,
    /// Time of the last request caused by an unknown key id.
    miss: Option<Instant>,
}

/// No keys are known: the provider has not answered since the start.
#[derive(Debug)]
pub(super) struct Away;

/// Fields of the OpenID Connect discovery document that are used.
#[derive(Debug, Deserialize)]
struct Discovery {
    issuer: String,
    jwks_uri: String,
}

#[derive(Debug, Deserialize)]
struct KeySet {
    keys: Vec<Value>,
}

impl Provider {
    /// An identity provider; sends no request yet.
    ///
    /// # Errors
    /// Addresses that are not valid URLs, or that use unencrypted HTTP to another machine.
    pub(super) fn new(issuer: &str, jwks_url: Option<&str>) -> Result<Self, String> {
        address(issuer)?;
        let jwks_url = jwks_url.map(address).transpose()?;
        let client =
            Client::builder()
                .timeout(TIMEOUT)
                .redirect(reqwest::redirect::Policy::none())
                .build()
                .map_err(|error| format!("the client of the identity provider does not start: {error}"))?;
        let (known, asking) = (RwLock::default(), tokio::sync::Mutex::default());
        Ok(Self(Arc::new(Inner { client, issuer: issuer.into(), jwks_url, known, asking })))
    }

    /// Finds the key with this id.
    ///
    /// # Errors
    /// [`Away`] if no keys are known.
    pub(super) async fn find(&self, id: &str) -> Result<Option<Arc<ProviderKey>>, Away> {
        let (key, since) = self.known(id);
        if key.is_none() {
            self.ask_for(id).await;
            let (key, since) = self.known(id);
            return if since.is_some() { Ok(key) } else { Err(Away) };
        }
        if since.is_some_and(|since| since.elapsed() > OLD) {
            let provider = self.clone();
            tokio::spawn(async move { provider.renew().await });
        }
        Ok(key)
    }

    fn known(&self, id: &str) -> (Option<Arc<ProviderKey>>, Option<Instant>) {
        let known = self.0.known.read().unwrap_or_else(|poisoned| poisoned.into_inner());
        (known.keys.get(id).cloned(), known.since)
    }

    /// Fetches the keys because of an unknown key id, unless they were requested recently.
    async fn ask_for(&self, id: &str) {
        let mut asked = self.0.asking.lock().await;
        // A task that waited for the lock may find the key now.
        let (key, since) = self.known(id);
        if key.is_some() {
            return;
        }
        let (last, pause) =
            if since.is_some() { (&mut asked.miss, MISS_PAUSE) } else { (&mut asked.last, FIRST_PAUSE) };
        if last.is_some_and(|last| last.elapsed() < pause) {
            return;
        }
        *last = Some(Instant::now());
        asked.last = Some(Instant::now());
        self.fetch().await;
    }

    /// Refreshes old keys, unless they were requested recently.
    async fn renew(&self) {
        let Ok(mut asked) = self.0.asking.try_lock() else { return };
        if asked.last.is_some_and(|last| last.elapsed() < MISS_PAUSE) {
            return;
        }
        asked.last = Some(Instant::now());
        self.fetch().await;
    }

    /// Replaces the keys with those of the provider; if the request fails, the known keys stay.
    async fn fetch(&self) {
        match self.fetched().await {
            Ok(keys) => {
                tracing::info!(keys = keys.len(), "the keys of the identity provider were read");
                let mut known = self.0.known.write().unwrap_or_else(|poisoned| poisoned.into_inner());
                *known = Known { keys, since: Some(Instant::now()) };
            }
            Err(error) => tracing::warn!(error, "the keys of the identity provider could not be read"),
        }
    }

    async fn fetched(&self) -> Result<Keys, String> {
        let url = match &self.0.jwks_url {
            Some(url) => url.clone(),
            None => self.discovered().await?,
        };
        let set: KeySet = self.get(url).await?;
        let keys: Keys = set.keys.into_iter().take(MAX_KEYS).filter_map(usable).collect();
        if keys.is_empty() { Err("no key of its set can be used".into()) } else { Ok(keys) }
    }

    /// Address of the keys according to the discovery document.
    async fn discovered(&self) -> Result<Url, String> {
        let issuer = &self.0.issuer;
        let url = format!("{}/.well-known/openid-configuration", issuer.trim_end_matches('/'));
        let discovery: Discovery = self.get(address(&url)?).await?;
        if discovery.issuer != *issuer {
            return Err("its discovery document names a different issuer than configured".into());
        }
        address(&discovery.jwks_uri)
    }

    async fn get<T: DeserializeOwned>(&self, url: Url) -> Result<T, String> {
        let failed = |error: reqwest::Error| format!("{}: {error}", kind_of(&error));
        let mut response = self.0.client.get(url).send().await.map_err(failed)?;
        if !response.status().is_success() {
            return Err(format!("it answers {}", response.status()));
        }
        let mut body = Vec::new();
        while let Some(part) = response.chunk().await.map_err(failed)? {
            body.extend_from_slice(&part);
            if body.len() > MAX_BYTES {
                return Err(format!("its answer is longer than {MAX_BYTES} bytes"));
            }
        }
        serde_json::from_slice(&body).map_err(|error| format!("its answer cannot be parsed: {error}"))
    }
}

fn kind_of(error: &reqwest::Error) -> &'static str {
    match error {
        error if error.is_timeout() => "it does not answer in time",
        error if error.is_connect() => "it cannot be reached",
        _ => "the request failed",
    }
}

/// Parses an address whose responses cannot be forged on the network: HTTPS, or a loopback address.
fn address(text: &str) -> Result<Url, String> {
    let url = Url::parse(text).map_err(|error| format!("expected a URL, got '{text}': {error}"))?;
    let host = url.host_str().unwrap_or_default();
    match url.scheme() {
        "https" => Ok(url),
        "http" if crate::domain::access::is_loopback(host) => Ok(url),
        _ => Err(format!(
            "expected a URL that begins with https:// (http:// only for this machine), got '{text}'"
        )),
    }
}

/// A key of the set with its id, if it verifies signatures with a supported algorithm.
fn usable(value: Value) -> Option<(String, Arc<ProviderKey>)> {
    let jwk: Jwk = serde_json::from_value(value).ok()?;
    if jwk.common.public_key_use.as_ref().is_some_and(|purpose| *purpose != PublicKeyUse::Signature) {
        return None;
    }
    let algorithm = match jwk.common.key_algorithm {
        Some(algorithm) => Some(Algorithm::try_from(algorithm).ok()?),
        None => None,
    };
    let key = DecodingKey::from_jwk(&jwk).ok()?;
    Some((jwk.common.key_id?, Arc::new(ProviderKey { key, algorithm })))
}
