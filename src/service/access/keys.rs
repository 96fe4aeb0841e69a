//! API keys of programs: create, list, revoke and check them.
//!
//! A looked-up key is cached for `FRESH` and then read again, so that a revocation reaches every replica. On the
//! replica that revokes a key, the revocation takes effect at once.

use crate::wire::fault::Fault;
use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

use hashlink::LruCache;
use rand::TryRng;
use rand::rngs::SysRng;

use super::Refusal;
use crate::domain::access::{Principal, Role};
use crate::domain::id;
use crate::domain::key::{Key, Secret, claimed_id, is_deceptive, is_id};
use crate::service::app::{App, Page, ServiceError, now_ms};
use crate::service::cohorts::catalogue;

/// Time for which a key read from the store is cached.
const FRESH: Duration = Duration::from_secs(2);
/// Capacity of each key cache.
const REMEMBERED: usize = 4096;
/// Minimum time between two updates of a key's last use.
const NOTED_EVERY_MS: i64 = 60_000;
/// Maximum length of a key's name.
const MAX_NAME_CHARS: usize = 100;
/// Maximum number of cohorts to which a key can be limited.
const MAX_COHORTS: usize = 100;
/// Maximum lifetime of an expiring key: ten years.
const MAX_DAYS: u32 = 3653;
const DAY_MS: i64 = 86_400_000;

/// Settings of a new key.
#[derive(Debug, Clone)]
pub struct NewKey {
    /// Display name.
    pub name: String,
    /// Role of its bearer.
    pub role: Role,
    /// Ids or names of the cohorts to which the key is limited; `None` for all cohorts.
    pub cohorts: Option<Vec<String>>,
    /// Days until the key expires; `None` if it never does.
    pub expires_in_days: Option<u32>,
}

/// A new key together with its text.
#[derive(Debug)]
pub struct Issued {
    /// The stored record.
    pub key: Key,
    /// The text, shown only once.
    pub secret: Secret,
}

/// Faults of a new key that can be found without looking up cohorts.
pub fn faults(new: &NewKey) -> Vec<Fault> {
    let mut faults = Vec::new();
    let mut check = |ok: bool, pointer: &str, detail: String| {
        if !ok {
            faults.push(Fault::new(pointer, detail));
        }
    };
    let readable = (1..=MAX_NAME_CHARS).contains(&new.name.chars().count())
        && !new.name.chars().any(is_deceptive)
        && new.name.trim() == new.name;
    let detail = format!(
        "expected 1 to {MAX_NAME_CHARS} characters, without spaces around them, and without characters that are \
         invisible or change the direction of writing"
    );
    check(readable, "/name", detail);
    if let Some(cohorts) = &new.cohorts {
        let count = (1..=MAX_COHORTS).contains(&cohorts.len());
        check(count, "/cohorts", format!("expected 1 to {MAX_COHORTS} cohorts, or no value for all cohorts"));
        let detail = "an admin key cannot be limited to cohorts, because it creates keys: ask for a reader or a writer";
        check(new.role < Role::Admin, "/cohorts", detail.into());
    }
    let days = new.expires_in_days.is_none_or(|days| (1..=MAX_DAYS).contains(&days));
    check(
        days,
        "/expires_in_days",
        format!("expected a number between 1 and {MAX_DAYS}, or no value for a key without end"),
    );
    faults
}

/// Creates a key of the caller's tenant with a random text.
///
/// # Errors
/// All invalid fields; cohorts that do not exist.
pub async fn create(app: &App, new: NewKey) -> Result<Issued, ServiceError> {
    let mut random = [0; 32];
    let failed = |error| ServiceError::Internal(format!("the system has no random numbers: {error}"));
    SysRng.try_fill_bytes(&mut random).map_err(failed)?;
    let id = id::new_id(id::KEY);
    let secret = Secret::new(&id, random);
    create_with(app, new, id, secret).await
}

/// Creates a key of the caller's tenant with a given text. If a key with this text exists, it is returned unchanged.
///
/// # Errors
/// A text that does not have the form of a key; those of [`create`].
pub async fn create_given(app: &App, new: NewKey, text: &str) -> Result<Key, ServiceError> {
    let (id, secret) = Secret::given(text).ok_or_else(|| {
        let form = "shk_, 32 lower-case hexadecimal digits, _ and 64 more";
        ServiceError::Query(format!("expected the text of a key ({form}), got something else"))
    })?;
    match app.store.find_key(&id).await? {
        Some(key) if key.digest == secret.digest() => Ok(key),
        Some(_) => Err(ServiceError::Query(format!(
            "the key {id} already exists with another text: use other digits"
        ))),
        None => Ok(create_with(app, new, id, secret).await?.key),
    }
}

async fn create_with(app: &App, new: NewKey, id: String, secret: Secret) -> Result<Issued, ServiceError> {
    app.check_unlimited("creating a key")?;
    ServiceError::unless_empty(faults(&new))?;
    let cohorts = match &new.cohorts {
        Some(keys) => Some(cohort_ids(app, keys).await?),
        None => None,
    };
    let now = now_ms();
    let key = Key {
        id,
        tenant: app.principal.tenant.clone(),
        name: new.name,
        role: new.role,
        cohorts,
        digest: secret.digest(),
        created_at_ms: now,
        expires_at_ms: new.expires_in_days.map(|days| now + i64::from(days) * DAY_MS),
        revoked_at_ms: None,
        used_at_ms: None,
    };
    app.store.create_key(&key).await?;
    app.access().keys.there_are_some();
    tracing::info!(key = key.id, role = key.role.as_str(), by = app.principal.key, "a key was created");
    Ok(Issued { key, secret })
}

async fn cohort_ids(app: &App, keys: &[String]) -> Result<Vec<String>, ServiceError> {
    let (mut ids, mut faults) = (Vec::new(), Vec::new());
    for (i, key) in keys.iter().enumerate() {
        match catalogue::find(app, key).await {
            Ok(cohort) => ids.push(cohort.id),
            Err(error @ ServiceError::NotFound { .. }) => {
                faults.push(Fault::new(format!("/cohorts/{i}"), error.to_string()));
            }
            Err(error) => return Err(error),
        }
    }
    ServiceError::unless_empty(faults)?;
    ids.sort();
    ids.dedup();
    Ok(ids)
}

/// Keys of the caller's tenant in order of creation, after `cursor` (the id of the last key of the previous page),
/// including expired and revoked ones.
///
/// # Errors
/// An invalid cursor.
pub async fn list(app: &App, cursor: Option<&str>, limit: usize) -> Result<Page<Key>, ServiceError> {
    if cursor.is_some_and(|cursor| !is_id(cursor)) {
        return Err(ServiceError::foreign_cursor());
    }
    let mut items = app.store.list_keys(Some(&app.principal.tenant), cursor, limit + 1).await?;
    let next = (items.len() > limit).then(|| items[limit - 1].id.clone());
    items.truncate(limit);
    Ok((items, next))
}

/// The key of the caller's tenant with this id.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub async fn find(app: &App, id: &str) -> Result<Key, ServiceError> {
    let found = if is_id(id) { app.store.find_key(id).await? } else { None };
    let own = found.filter(|key| key.tenant == app.principal.tenant);
    own.ok_or_else(|| ServiceError::NotFound { kind: "key", key: id.into() })
}

/// Revokes a key permanently; a key that is already revoked stays so.
///
/// # Errors
/// [`ServiceError::NotFound`].
pub async fn revoke(app: &App, id: &str) -> Result<(), ServiceError> {
    let key = find(app, id).await?;
    let now = now_ms();
    if key.revoked_at_ms.is_none() {
        app.store.revoke_key(&key.id, now).await?;
        tracing::info!(key = key.id, by = app.principal.key, "a key was revoked");
    }
    app.access().keys.remember(Key { revoked_at_ms: Some(key.revoked_at_ms.unwrap_or(now)), ..key });
    Ok(())
}

/// Whether any tenant has a key. Expired and revoked keys count, so that revoking the last key does not open the
/// service.
pub(super) async fn exist(app: &App) -> Result<bool, ServiceError> {
    if let Some(known) = app.access().keys.are_there() {
        return Ok(known);
    }
    let found = app.store.has_keys().await?;
    if found {
        app.access().keys.there_are_some();
    } else {
        app.access().keys.there_are_none();
    }
    Ok(found)
}

/// The key with this id, as it was in the store a moment ago.
pub(super) async fn known(app: &App, id: &str) -> Result<Option<Key>, ServiceError> {
    let access = app.access();
    if let Some(key) = access.keys.recall(id) {
        return Ok(Some(key));
    }
    if access.keys.is_unknown(id) {
        return Ok(None);
    }
    let found = app.store.find_key(id).await?;
    if found.is_none() {
        access.keys.there_is_none(id);
    }
    Ok(found.map(|key| access.keys.remember(key)))
}

/// Authenticates the bearer of the key `text`.
pub(super) async fn check(app: &App, text: &str) -> Result<Principal, Refusal> {
    let id = claimed_id(text).ok_or("not the form of a key")?;
    let found = known(app, &id).await.map_err(Refusal::Later)?;
    let Some(key) = found else { return Err(Refusal::Check(Some(id), "unknown key")) };
    let now = now_ms();
    if let Some(check) = key.refusal(text, now) {
        return Err(Refusal::Check(Some(key.id), check));
    }
    note_use(app, &key, now);
    Ok(key.principal())
}

/// Records the use of the key in the background, at most once a minute.
fn note_use(app: &App, key: &Key, now: i64) {
    if key.used_at_ms.is_some_and(|used| now - used < NOTED_EVERY_MS) {
        return;
    }
    app.access().keys.used(&key.id, now);
    let (store, id) = (app.store.clone(), key.id.clone());
    tokio::spawn(async move {
        if let Err(error) = store.note_key_use(&id, now).await {
            tracing::warn!(
                key = id,
                error = ServiceError::from(error).cause(),
                "the use of a key could not be recorded"
            );
        }
    });
}

/// Cache of recently looked-up keys.
#[derive(Debug)]
pub(super) struct KeyCache {
    found: Mutex<LruCache<String, (Key, Instant)>>,
    /// Ids that no key has, with the time of the lookup: repeated requests with an unknown id do not reach the store.
    unknown: Mutex<LruCache<String, Instant>>,
    /// Whether any key exists, with the time of the lookup; `true` never expires.
    any: Mutex<Option<(bool, Instant)>>,
}

impl Default for KeyCache {
    fn default() -> Self {
        let unknown = Mutex::new(LruCache::new(REMEMBERED));
        Self { found: Mutex::new(LruCache::new(REMEMBERED)), unknown, any: Mutex::default() }
    }
}

impl KeyCache {
    fn recall(&self, id: &str) -> Option<Key> {
        let mut found = locked(&self.found);
        let (key, since) = found.get(id)?;
        (since.elapsed() < FRESH).then(|| key.clone())
    }

    /// Caches a key read from the store and returns the merged record: a revocation made by this replica persists even
    /// if an older record is read afterwards.
    fn remember(&self, mut key: Key) -> Key {
        let mut found = locked(&self.found);
        if let Some((known, _)) = found.peek(&key.id) {
            key.revoked_at_ms = key.revoked_at_ms.or(known.revoked_at_ms);
            key.used_at_ms = key.used_at_ms.max(known.used_at_ms);
        }
        found.insert(key.id.clone(), (key.clone(), Instant::now()));
        key
    }

    fn is_unknown(&self, id: &str) -> bool {
        locked(&self.unknown).get(id).is_some_and(|since| since.elapsed() < FRESH)
    }

    fn there_is_none(&self, id: &str) {
        locked(&self.unknown).insert(id.to_owned(), Instant::now());
    }

    /// Records the use of a cached key; the age of the cache entry does not change.
    fn used(&self, id: &str, now: i64) {
        if let Some((key, _)) = locked(&self.found).get_mut(id) {
            key.used_at_ms = Some(now);
        }
    }

    fn are_there(&self) -> Option<bool> {
        let any = *locked(&self.any);
        any.filter(|(any, since)| *any || since.elapsed() < FRESH).map(|(any, _)| any)
    }

    fn there_are_some(&self) {
        *locked(&self.any) = Some((true, Instant::now()));
    }

    fn there_are_none(&self) {
        let mut any = locked(&self.any);
        // A key created in the meantime takes precedence.
        if !matches!(*any, Some((true, _))) {
            *any = Some((false, Instant::now()));
        }
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(revoked_at_ms: Option<i64>) -> Key {
        let id = String::from("key_1");
        let digest = Secret::new(&id, [0; 32]).digest();
        Key {
            id,
            tenant: "a".into(),
            name: "pipeline".into(),
            role: Role::Reader,
            cohorts: None,
            digest,
            created_at_ms: 0,
            expires_at_ms: None,
            revoked_at_ms,
            used_at_ms: None,
        }
    }

    #[test]
    fn a_revocation_outlives_what_was_read_before_it() {
        let cache = KeyCache::default();
        assert_eq!(cache.recall("key_1"), None);
        cache.remember(key(None));
        cache.remember(key(Some(5)));
        let known = cache.remember(key(None));
        assert_eq!((known.revoked_at_ms, cache.recall("key_1").unwrap().revoked_at_ms), (Some(5), Some(5)));
        cache.used("key_1", 70);
        assert_eq!(cache.remember(key(None)).used_at_ms, Some(70));
    }

    #[test]
    fn ids_that_no_key_has_are_remembered_for_a_moment() {
        let cache = KeyCache::default();
        assert!(!cache.is_unknown("key_1"));
        cache.there_is_none("key_1");
        assert!(cache.is_unknown("key_1") && !cache.is_unknown("key_2"));
        // Other ids evict it: memory is bounded.
        (0..REMEMBERED).for_each(|k| cache.there_is_none(&k.to_string()));
        assert!(!cache.is_unknown("key_1"));
    }

    #[test]
    fn that_there_are_keys_is_never_forgotten() {
        let cache = KeyCache::default();
        assert_eq!(cache.are_there(), None);
        cache.there_are_none();
        assert_eq!(cache.are_there(), Some(false));
        cache.there_are_some();
        cache.there_are_none();
        assert_eq!(cache.are_there(), Some(true));
    }

    #[test]
    fn new_keys_are_checked_as_a_whole() {
        let bad = NewKey {
            name: " x".into(),
            role: Role::Admin,
            cohorts: Some(Vec::new()),
            expires_in_days: Some(0),
        };
        let pointers: Vec<String> = faults(&bad).into_iter().map(|fault| fault.pointer).collect();
        assert_eq!(pointers, ["/name", "/cohorts", "/cohorts", "/expires_in_days"]);
        let hidden =
            NewKey { name: "adm\u{202e}in".into(), role: Role::Reader, cohorts: None, expires_in_days: None };
        assert_eq!(faults(&hidden).len(), 1);
        let good = NewKey {
            name: "a pipeline".into(),
            role: Role::Writer,
            cohorts: Some(vec!["c".into()]),
            expires_in_days: Some(1),
        };
        assert_eq!(faults(&good), []);
    }
}
