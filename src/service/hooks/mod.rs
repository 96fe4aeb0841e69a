//! Hooks: deliveries of changes to addresses of clients, signed, in order, at least once.
//!
//! * this file — operations for clients: create, find, list, delete, pause, resume, deliver again;
//! * `address` — which addresses may be delivered to;
//! * [`deliver`] — the deliveries.

mod address;
pub mod deliver;

use std::sync::Arc;

use rand::TryRng;
use rand::rngs::SysRng;

pub use self::address::Network;
use crate::domain::change::ChangeFilter;
use crate::domain::hook::{Hook, HookFailure, HookStatus, SECRET_BYTES, SigningSecret};
use crate::domain::id;
use crate::domain::key::is_deceptive;
use crate::service::app::{App, Page, ServiceError, now_ms};
use crate::service::cohorts::{catalogue, changes};
use crate::store::hooks::{MAX_FAILURES, MAX_HOOKS};
use crate::wire::fault::Fault;

/// Maximum length of a description.
const MAX_DESCRIPTION_CHARS: usize = 200;

/// Settings of deliveries.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct HookSettings {
    /// Whether plain HTTP, and private, loopback and link-local addresses are allowed.
    pub allow_private: bool,
    /// Networks whose addresses are allowed besides public ones.
    pub networks: Arc<[Network]>,
    /// Days after which a delivery that fails is given up; 0 gives up after the first attempt.
    pub days: u32,
}

impl Default for HookSettings {
    fn default() -> Self {
        Self { allow_private: false, networks: Arc::default(), days: 3 }
    }
}

impl App {
    /// The same service with these settings of hooks; called before it takes requests.
    #[must_use]
    pub fn with_hooks(self, settings: HookSettings) -> Self {
        self.put_state(settings);
        self
    }

    fn hook_settings(&self) -> Arc<HookSettings> {
        self.state()
    }
}

/// A hook to create.
#[derive(Debug, Clone)]
pub struct NewHook {
    /// Address.
    pub url: String,
    /// Purpose, for people.
    pub description: String,
    /// Changes to deliver; the cohort by id or name.
    pub filter: ChangeFilter,
}

/// Creates a hook, which delivers changes from now on.
///
/// # Errors
/// All invalid fields; a cohort that does not exist; too many hooks.
pub async fn create(app: &App, new: NewHook) -> Result<Hook, ServiceError> {
    app.check_unlimited("creating a hook")?;
    let mut faults = Vec::new();
    let settings = app.hook_settings();
    if let Err(detail) = address::checked(&new.url, settings.allow_private, &settings.networks) {
        faults.push(Fault::new("/url", detail));
    }
    let length = new.description.chars().count();
    if length > MAX_DESCRIPTION_CHARS || new.description.chars().any(is_deceptive) {
        let detail = format!(
            "expected at most {MAX_DESCRIPTION_CHARS} characters, none of them invisible, got {length} characters"
        );
        faults.push(Fault::new("/description", detail));
    }
    if new.filter.kinds.as_ref().is_some_and(Vec::is_empty) {
        faults.push(Fault::new("/kinds", "expected at least one kind, or no value for all kinds, got none"));
    }
    ServiceError::unless_empty(faults)?;
    let cohort = match &new.filter.cohort {
        Some(key) => Some(catalogue::find(app, key).await.map_err(|error| error.named_at("/cohort"))?.id),
        None => None,
    };
    let now = now_ms();
    let hook = Hook {
        id: id::new_id(id::HOOK),
        tenant: app.principal.tenant.clone(),
        url: new.url,
        description: new.description,
        filter: ChangeFilter { cohort, ..new.filter },
        secret: secret()?,
        status: HookStatus::Active,
        reason: None,
        position: app.store.last_change().await?,
        attempts: 0,
        failing_since_ms: None,
        due_ms: now,
        delivered_at_ms: None,
        created_at_ms: now,
    };
    if app.store.create_hook(&hook).await? {
        app.touched.note("hook_id", &hook.id);
        return Ok(hook);
    }
    Err(ServiceError::invalid("", format!("expected at most {MAX_HOOKS} hooks of a tenant, got one more")))
}

fn secret() -> Result<SigningSecret, ServiceError> {
    let mut random = vec![0; SECRET_BYTES];
    let failed = |error| ServiceError::Internal(format!("the system has no random numbers: {error}"));
    SysRng.try_fill_bytes(&mut random).map_err(failed)?;
    Ok(SigningSecret::new(random))
}

fn not_found(id: &str) -> ServiceError {
    ServiceError::NotFound { kind: "hook", key: id.into() }
}

/// Finds the hook with this id.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub async fn find(app: &App, id: &str) -> Result<Hook, ServiceError> {
    app.store.find_hook(id).await?.ok_or_else(|| not_found(id))
}

/// Hooks in order of creation, after `cursor` (the id of the last hook of the previous page).
///
/// # Errors
/// An invalid cursor.
pub async fn list(app: &App, cursor: Option<&str>, limit: usize) -> Result<Page<Hook>, ServiceError> {
    if cursor.is_some_and(|cursor| !cursor.starts_with(&format!("{}_", id::HOOK))) {
        return Err(ServiceError::foreign_cursor());
    }
    let mut items = app.store.list_hooks(cursor, limit + 1).await?;
    let next = (items.len() > limit).then(|| items[limit - 1].id.clone());
    items.truncate(limit);
    Ok((items, next))
}

/// Deletes a hook; a delivery under way may still arrive.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub async fn delete(app: &App, id: &str) -> Result<(), ServiceError> {
    if app.store.delete_hook(id).await? { Ok(()) } else { Err(not_found(id)) }
}

/// Pauses a hook. It keeps its position.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub async fn pause(app: &App, id: &str) -> Result<Hook, ServiceError> {
    let paused = app.store.set_hook_status(id, HookStatus::Paused, now_ms()).await?;
    paused.ok_or_else(|| not_found(id))
}

/// Resumes a paused or failed hook at its position; the next attempt is made at once.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub async fn resume(app: &App, id: &str) -> Result<Hook, ServiceError> {
    let resumed = app.store.set_hook_status(id, HookStatus::Active, now_ms()).await?;
    resumed.ok_or_else(|| not_found(id))
}

/// Delivers again all changes after number `since`, and resumes the hook. A number beyond the position skips changes.
///
/// # Errors
/// [`ServiceError::NotFound`]; a number that no change has; [`ServiceError::ChangesGone`].
pub async fn redeliver(app: &App, id: &str, since: u64) -> Result<Hook, ServiceError> {
    let last = app.store.last_change().await?;
    if since > last {
        let detail = format!("expected the number of a change, at most {last}, got {since}");
        return Err(ServiceError::invalid("/since", detail));
    }
    changes::list(app, since, 1).await?;
    app.store.move_hook(id, since, now_ms()).await?.ok_or_else(|| not_found(id))
}

/// The newest failed attempts at deliveries to a hook, the newest first.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub async fn failures(app: &App, id: &str) -> Result<Vec<HookFailure>, ServiceError> {
    find(app, id).await?;
    Ok(app.store.list_hook_failures(id, MAX_FAILURES as usize).await?)
}
