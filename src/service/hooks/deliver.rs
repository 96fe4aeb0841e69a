//! Deliveries: every process claims hooks with undelivered changes, and delivers to each in order.
//!
//! The position of a hook moves only after an answer of 2xx, so that no change is lost when a process ends; a delivery that was
//! answered just before may be repeated, under the same id. After a failure the hook waits, twice as long every time, and then
//! tries the same change again.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use aws_lc_rs::hmac;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use reqwest::header::CONTENT_TYPE;
use reqwest::{Client, Response};
use serde::Serialize;
use tokio::task::{AbortHandle, JoinHandle, JoinSet};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use super::{HookSettings, address};
use crate::domain::access::Principal;
use crate::domain::change::{Change, ChangeKind};
use crate::domain::hook::{Hook, HookFailure};
use crate::service::app::{App, ServiceError, metrics, now_ms};
use crate::service::cohorts::changes::{self, ChangeOutput};
use crate::store::HookClaim;
use crate::wire::time::rfc3339;

/// Hooks that one process delivers to at a time.
const AT_ONCE: usize = 8;
/// Hooks of one tenant among them, while others have hooks: a receiver may take 10 s for each delivery.
const OF_A_TENANT: usize = AT_ONCE / 2;
/// Polling interval for undelivered changes.
const POLL: Duration = Duration::from_millis(400);
/// Duration of a lease without a delivery, in milliseconds: longer than a delivery can take.
const LEASE_MS: i64 = 60_000;
/// Time limit of a delivery, and of its connection.
const TIMEOUT: Duration = Duration::from_secs(10);
const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);
/// Bytes of an answer that are read, so that its connection can be used again; they are ignored.
const MAX_ANSWER: usize = 4096;
/// Changes read at once.
const PAGE: usize = 64;
/// Longest turn of a hook while others wait.
const TURN: Duration = Duration::from_secs(10);
/// Longest time for deliveries under way to end.
const STOP: Duration = Duration::from_secs(5);
/// Delays between attempts: the first, and the longest.
const FIRST_DELAY_MS: i64 = 1000;
const LONGEST_DELAY_MS: i64 = 3_600_000;
const DAY_MS: i64 = 86_400_000;

/// Deliveries of this process, until they are stopped.
#[derive(Debug)]
pub struct Deliveries {
    stop: CancellationToken,
    task: JoinHandle<()>,
}

impl Deliveries {
    /// Starts to deliver. Must be called on an async runtime.
    pub fn start(app: &App) -> Self {
        let (stop, settings) = (CancellationToken::new(), app.hook_settings());
        let client = client(&settings);
        if let Err(error) = &client {
            tracing::warn!(error, "hooks cannot be delivered to");
        }
        let courier = Courier { app: app.clone(), client: client.ok(), settings, stop: stop.clone() };
        Self { stop, task: tokio::spawn(Arc::new(courier).serve()) }
    }

    /// Ends the deliveries under way, which are made again later.
    pub async fn stop(self) {
        self.stop.cancel();
        if tokio::time::timeout(STOP, self.task).await.is_err() {
            tracing::warn!("a delivery did not stop in {} s", STOP.as_secs());
        }
    }
}

fn client(settings: &HookSettings) -> Result<Client, String> {
    let client = Client::builder()
        .user_agent(concat!("shapelex/", env!("CARGO_PKG_VERSION")))
        .no_proxy()
        .referer(false)
        .redirect(reqwest::redirect::Policy::none())
        .connect_timeout(CONNECT_TIMEOUT)
        .timeout(TIMEOUT)
        .https_only(!settings.allow_private);
    let reachable = address::Reachable(Arc::clone(&settings.networks));
    let client = if settings.allow_private { client } else { client.dns_resolver(reachable) };
    client.build().map_err(|error| error.to_string())
}

/// Delivers to the hooks that it claims.
#[derive(Debug)]
struct Courier {
    app: App,
    /// `None` if it could not be made, for example without certificates of authorities.
    client: Option<Client>,
    settings: Arc<HookSettings>,
    stop: CancellationToken,
}

/// Why a delivery failed.
#[derive(Debug, PartialEq, Eq)]
struct Failed {
    status: Option<u16>,
    detail: String,
}

impl Failed {
    fn new(detail: &str) -> Self {
        Self { status: None, detail: detail.into() }
    }
}

impl Courier {
    async fn serve(self: Arc<Self>) {
        let (mut running, mut tenants) = (JoinSet::new(), Vec::new());
        while !self.stop.is_cancelled() {
            while running.len() < AT_ONCE {
                tenants.retain(|(_, task): &(String, AbortHandle)| !task.is_finished());
                let now = now_ms();
                let claimed = {
                    let crowding = crowding(&tenants);
                    self.app.store.claim_hook(now, now + LEASE_MS, &crowding).await
                };
                match claimed {
                    Ok(Some(claim)) => {
                        let tenant = claim.hook.tenant.clone();
                        tenants.push((tenant, running.spawn(Arc::clone(&self).work(claim))));
                    }
                    Ok(None) => break,
                    Err(error) => {
                        tracing::warn!(%error, "the hooks cannot be read");
                        break;
                    }
                }
            }
            tokio::select! {
                () = self.stop.cancelled() => {}
                () = tokio::time::sleep(POLL) => {}
                Some(_) = running.join_next() => {}
            }
        }
        while running.join_next().await.is_some() {}
    }

    /// Delivers to a claimed hook until nothing is left, a delivery fails, or its turn is over.
    async fn work(self: Arc<Self>, claim: HookClaim) {
        let hook = claim.hook.id.clone();
        let ended = match self.deliver_all(&claim).await {
            Err(ServiceError::ChangesGone { first }) => {
                let reason =
                    format!("changes before number {first} are no longer kept: they were not delivered");
                tracing::warn!(hook, "a hook has fallen behind the feed of changes and is given up");
                self.app.store.give_up_hook(&claim, &reason).await.map(drop).map_err(Into::into)
            }
            other => other,
        };
        if let Err(error) = ended {
            // The claim ends with its lease.
            tracing::warn!(hook, error = error.cause(), "deliveries to a hook break off");
        }
    }

    async fn deliver_all(&self, claim: &HookClaim) -> Result<(), ServiceError> {
        let (hook, end) = (&claim.hook, Instant::now() + TURN);
        let app = self.app.of(Arc::new(Principal::system(&hook.tenant)));
        let (mut position, mut attempts) = (hook.position, hook.attempts);
        let store = app.store.identity().await?;
        loop {
            let page = changes::list(&app, position, PAGE).await?;
            for change in page.changes.iter().filter(|change| hook.filter.admits(change)) {
                let sent = tokio::select! {
                    sent = self.send(hook, &store, change) => sent,
                    () = self.stop.cancelled() => return Ok(self.app.store.release_hook(claim, now_ms()).await?),
                };
                metrics::hook_delivery(sent.is_ok());
                if let Err(failed) = sent {
                    return self.failed(claim, change.sequence, attempts + 1, failed).await;
                }
                (position, attempts) = (change.sequence, 0);
                let now = now_ms();
                if !self.app.store.advance_hook(claim, position, Some(now), now + LEASE_MS).await? {
                    return Ok(());
                }
                if Instant::now() >= end {
                    return Ok(self.app.store.release_hook(claim, now).await?);
                }
            }
            if page.last > position {
                position = page.last;
                if !self.app.store.advance_hook(claim, position, None, now_ms() + LEASE_MS).await? {
                    return Ok(());
                }
            }
            if page.done {
                return Ok(self.app.store.release_hook(claim, now_ms()).await?);
            }
        }
    }

    /// Records a failed attempt, after which the hook waits or is given up.
    async fn failed(
        &self,
        claim: &HookClaim,
        sequence: u64,
        attempt: u32,
        Failed { status, detail }: Failed,
    ) -> Result<(), ServiceError> {
        let (now, hook, days) = (now_ms(), &claim.hook, self.settings.days);
        let since = hook.failing_since_ms.filter(|_| attempt > 1).unwrap_or(now);
        let reason = (now - since >= i64::from(days) * DAY_MS)
            .then(|| format!("the delivery of change {sequence} has failed for {days} days: {detail}"));
        tracing::info!(hook = hook.id, sequence, attempt, detail, "a delivery has failed");
        if reason.is_some() {
            tracing::warn!(hook = hook.id, sequence, "the deliveries of a hook are given up");
        }
        let failure = HookFailure { at_ms: now, sequence, attempt, status, detail };
        let due = now + delay_ms(&hook.id, attempt);
        self.app.store.fail_hook(claim, &failure, due, reason.as_deref()).await?;
        Ok(())
    }

    /// Makes one attempt at a delivery.
    async fn send(&self, hook: &Hook, store: &str, change: &Change) -> Result<(), Failed> {
        let client =
            self.client.as_ref().ok_or_else(|| Failed::new("the service has no client: see its log"))?;
        let settings = &self.settings;
        let url = address::checked(&hook.url, settings.allow_private, &settings.networks).map_err(|_| {
            Failed::new("the address is not allowed any more: it is private, or without https")
        })?;
        let body = serde_json::to_string(&Delivery::new(change))
            .map_err(|_| Failed::new("the change cannot be written as JSON: see the log of the service"))?;
        let id = hook.delivery_id(store, change.sequence);
        let timestamp = (now_ms() / 1000).to_string();
        let signature = signature(hook.secret.bytes(), &id, &timestamp, &body);
        let request = client
            .post(url)
            .header(CONTENT_TYPE, "application/json")
            .header("webhook-id", id)
            .header("webhook-timestamp", timestamp)
            .header("webhook-signature", signature)
            .body(body);
        let answer = request.send().await.map_err(|error| Failed::new(kind_of(&error)))?;
        let status = answer.status();
        ignore(answer).await;
        if status.is_success() {
            return Ok(());
        }
        let detail = format!("expected a status of 2xx, got {}", status.as_u16());
        Err(Failed { status: Some(status.as_u16()), detail })
    }
}

/// Tenants that have all places of a tenant.
fn crowding(tenants: &[(String, AbortHandle)]) -> Vec<&str> {
    let mut counts = BTreeMap::new();
    for (tenant, _) in tenants {
        *counts.entry(tenant.as_str()).or_insert(0) += 1;
    }
    counts.into_iter().filter(|(_, count)| *count >= OF_A_TENANT).map(|(tenant, _)| tenant).collect()
}

/// Kind of a failure, without details of the client's network.
fn kind_of(error: &reqwest::Error) -> &'static str {
    match error {
        error if address::was_not_public(error) => "the host has a private, loopback or reserved address",
        error if error.is_timeout() => "no answer within 10 s",
        error if error.is_connect() => "the connection failed",
        _ => "the request failed",
    }
}

/// Reads the beginning of an answer.
async fn ignore(mut answer: Response) {
    let mut read = 0;
    while let Ok(Some(part)) = answer.chunk().await {
        read += part.len();
        if read > MAX_ANSWER {
            return;
        }
    }
}

/// Body of a delivery, with the change as the feed lists it.
#[derive(Serialize)]
struct Delivery {
    #[serde(rename = "type")]
    kind: ChangeKind,
    timestamp: String,
    data: ChangeOutput,
}

impl Delivery {
    fn new(change: &Change) -> Self {
        Self { kind: change.kind, timestamp: rfc3339(change.at_ms), data: change.clone().into() }
    }
}

/// `v1,` and HMAC-SHA256 of `id.timestamp.body` in base64.
fn signature(secret: &[u8], id: &str, timestamp: &str, body: &str) -> String {
    let key = hmac::Key::new(hmac::HMAC_SHA256, secret);
    let tag = hmac::sign(&key, format!("{id}.{timestamp}.{body}").as_bytes());
    format!("v1,{}", BASE64.encode(tag))
}

/// Delay before the attempt that follows `attempt`: doubled every time, up to an hour, of which a half to all, by hook and
/// attempt, so that hooks that failed together do not try again together.
fn delay_ms(hook: &str, attempt: u32) -> i64 {
    let whole = FIRST_DELAY_MS.saturating_mul(1 << (attempt.max(1) - 1).min(20)).min(LONGEST_DELAY_MS);
    let digest = blake3::hash(format!("{hook} {attempt}").as_bytes());
    whole / 2 + whole / 2 * i64::from(digest.as_bytes()[0]) / 255
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    /// The example of the Standard Webhooks specification.
    #[test]
    fn a_signature_is_that_of_the_specification() {
        let secret = BASE64.decode("MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw").unwrap();
        let found =
            signature(&secret, "msg_p5jXN8AQM9LWM0D4loKWxJek", "1614265330", r#"{"test": 2432232314}"#);
        assert_eq!(found, "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE=");
    }

    #[test]
    fn delays_double_up_to_an_hour_and_differ_between_hooks() {
        for attempt in 1..40 {
            let whole = FIRST_DELAY_MS.saturating_mul(1 << (attempt - 1).min(20)).min(LONGEST_DELAY_MS);
            let found = delay_ms("hok_1", attempt);
            assert!((whole / 2..=whole).contains(&found), "{attempt}: {found}");
        }
        assert_eq!(delay_ms("hok_1", 3), delay_ms("hok_1", 3));
        assert!((0..20).any(|k| delay_ms(&format!("hok_{k}"), 5) != delay_ms("hok_1", 5)));
    }

    #[test]
    fn a_delivery_says_what_the_feed_says() {
        let change = Change {
            sequence: 7,
            at_ms: 0,
            kind: ChangeKind::ShapesAdded,
            object: "coh_1".into(),
            cohort: Some("coh_1".into()),
            revision: Some(2),
            shapes: Some(3),
            shape_ids: None,
        };
        let found: serde_json::Value = serde_json::to_value(Delivery::new(&change)).unwrap();
        let at = "1970-01-01T00:00:00Z";
        let data = json!({"sequence": 7, "at": at, "kind": "shapes_added", "object": "coh_1", "cohort": "coh_1",
            "revision": 2, "shape_count": 3});
        assert_eq!(found, json!({"type": "shapes_added", "timestamp": at, "data": data}));
    }
}
