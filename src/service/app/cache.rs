//! A single cache for expensive results of any type: bounded in bytes, evicts the least recently used, and drops values that
//! nobody has used for a while.

use std::any::{Any, TypeId};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use hashlink::LinkedHashMap;
use serde::Serialize;

use super::metrics;

/// Maximum capacity of the cache in bytes.
const MAX_BYTES: usize = 768 << 20;

/// A type whose values are cached.
pub trait Cached: Send + Sync + 'static {
    /// Label of the type in the metrics.
    const NAME: &'static str;

    /// Estimated memory of the value in bytes.
    fn bytes(&self) -> usize;
}

/// Identifies a value: its type, the id of the stored object it was computed from (empty if there is none), and a
/// digest of everything else it depends on.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
struct Key {
    kind: TypeId,
    object: String,
    digest: [u8; 32],
}

impl Key {
    fn new<T: Cached>(object: &str, settings: &impl Serialize) -> Option<Self> {
        let mut digest = blake3::Hasher::new();
        serde_json::to_writer(&mut digest, settings).ok()?;
        Some(Self { kind: TypeId::of::<T>(), object: object.into(), digest: *digest.finalize().as_bytes() })
    }
}

#[derive(Debug)]
struct Entry {
    value: Arc<dyn Any + Send + Sync>,
    bytes: usize,
    /// Time of the last use.
    used: Instant,
}

#[derive(Debug, Default)]
struct Entries {
    /// Ordered from the least to the most recently used.
    list: LinkedHashMap<Key, Entry>,
    /// Total size of the list.
    bytes: usize,
    /// Total size of the reservations.
    reserved: usize,
}

impl Entries {
    /// Evicts the least recently used values until the others fit beside the reservations.
    fn evict(&mut self, capacity: usize) {
        while self.bytes + self.reserved > capacity && self.evict_first() {}
    }

    /// Evicts the values whose last use was before `time`.
    fn evict_before(&mut self, time: Instant) {
        while self.list.front().is_some_and(|(_, entry)| entry.used < time) {
            self.evict_first();
        }
    }

    /// Evicts the least recently used value; returns whether there was one.
    fn evict_first(&mut self) -> bool {
        let evicted = self.list.pop_front();
        self.bytes -= evicted.as_ref().map_or(0, |(_, entry)| entry.bytes);
        evicted.is_some()
    }
}

/// Space for a value that is being computed; released when dropped.
#[derive(Debug)]
pub struct Reserved<'a> {
    cache: &'a Cache,
    bytes: usize,
}

impl Reserved<'_> {
    /// Raises the reservation to `bytes`, and evicts the least recently used values until it fits; returns whether it does.
    pub fn grow_to(&mut self, bytes: usize) -> bool {
        let Some(more) = bytes.checked_sub(self.bytes).filter(|more| *more > 0) else { return true };
        let Some(mut further) = self.cache.reserve(more) else { return false };
        self.bytes += std::mem::take(&mut further.bytes);
        true
    }
}

impl Drop for Reserved<'_> {
    fn drop(&mut self) {
        self.cache.locked().reserved -= self.bytes;
    }
}

/// Values of any type, shared by all requests.
#[derive(Debug)]
pub struct Cache {
    entries: Mutex<Entries>,
    capacity: usize,
    /// Time after its last use for which a value is kept.
    term: Duration,
}

impl Cache {
    /// A cache of at most a quarter of `memory` bytes, and at most 768 MiB, of values that were used within `term`.
    pub(in crate::service) fn new(memory: usize, term: Duration) -> Self {
        Self { entries: Mutex::default(), capacity: MAX_BYTES.min(memory / 4), term }
    }

    fn locked(&self) -> MutexGuard<'_, Entries> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The value computed from `object` with `settings`, counted as a hit or a miss.
    pub fn find<T: Cached>(&self, object: &str, settings: &impl Serialize) -> Option<Arc<T>> {
        metrics::looked_up(T::NAME, self.look(object, settings))
    }

    fn look<T: Cached>(&self, object: &str, settings: &impl Serialize) -> Option<Arc<T>> {
        let key = Key::new::<T>(object, settings)?;
        let mut entries = self.locked();
        let entry = entries.list.to_back(&key)?;
        entry.used = Instant::now();
        Arc::clone(&entry.value).downcast().ok()
    }

    /// Reserves space for a value that is being computed, and evicts the least recently used ones until it fits. `None` if it
    /// cannot fit beside other reservations: it should then not be collected in memory.
    pub fn reserve(&self, bytes: usize) -> Option<Reserved<'_>> {
        let mut entries = self.locked();
        let reserved = entries.reserved.checked_add(bytes).filter(|reserved| *reserved <= self.capacity)?;
        entries.reserved = reserved;
        entries.evict(self.capacity);
        Some(Reserved { cache: self, bytes })
    }

    /// Whether a value is cached; does not affect the metrics.
    pub fn has<T: Cached>(&self, object: &str, settings: &impl Serialize) -> bool {
        Key::new::<T>(object, settings).is_some_and(|key| self.locked().list.contains_key(&key))
    }

    /// Caches a value and evicts the least recently used ones until it fits.
    pub fn keep<T: Cached>(&self, object: &str, settings: &impl Serialize, value: &Arc<T>) {
        let bytes = value.bytes();
        let Some(key) = Key::new::<T>(object, settings).filter(|_| bytes <= self.capacity) else { return };
        let entry = Entry { value: value.clone(), bytes, used: Instant::now() };
        let mut entries = self.locked();
        let replaced = entries.list.insert(key, entry);
        entries.bytes = entries.bytes + bytes - replaced.map_or(0, |entry| entry.bytes);
        entries.evict(self.capacity);
    }

    /// Evicts the values that nobody has used for the term of the cache.
    pub(super) fn drop_unused(&self) {
        if let Some(time) = Instant::now().checked_sub(self.term) {
            self.locked().evict_before(time);
        }
    }

    /// Evicts the least recently used values until half of the bytes are left.
    pub(super) fn halve(&self) {
        let mut entries = self.locked();
        let half = entries.bytes / 2 + entries.reserved;
        entries.evict(half);
    }

    /// Evicts all values computed from a deleted object.
    pub fn forget(&self, object: &str) {
        let mut entries = self.locked();
        entries.list.retain(|key, _| key.object != object);
        entries.bytes = entries.list.values().map(|entry| entry.bytes).sum();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TERM: Duration = Duration::from_secs(600);

    #[derive(Debug, PartialEq)]
    struct Text(usize);

    impl Cached for Text {
        const NAME: &'static str = "texts";

        fn bytes(&self) -> usize {
            self.0
        }
    }

    #[derive(Debug, PartialEq)]
    struct Number;

    impl Cached for Number {
        const NAME: &'static str = "numbers";

        fn bytes(&self) -> usize {
            1
        }
    }

    #[test]
    fn values_that_are_computed_have_their_space_reserved() {
        let cache = Cache::new(400, TERM);
        cache.keep("a", &1, &Arc::new(Text(60)));
        let first = cache.reserve(70).unwrap();
        assert!(!cache.has::<Text>("a", &1), "evicted for the reservation");
        assert!(cache.reserve(40).is_none(), "beyond the capacity of 100 beside the first");
        cache.keep("b", &1, &Arc::new(Text(40)));
        assert!(!cache.has::<Text>("b", &1), "no space beside the reservation");
        let mut first = first;
        assert!(first.grow_to(50) && first.grow_to(90) && !first.grow_to(101));
        drop(first);
        assert_eq!(cache.locked().reserved, 0);
        cache.keep("c", &1, &Arc::new(Text(70)));
        assert!(cache.has::<Text>("c", &1));
        assert!(cache.reserve(usize::MAX).is_none());
    }

    #[test]
    fn the_least_recently_used_value_is_evicted_first() {
        let cache = Cache::new(400, TERM);
        let has = |object: &str, revision: u64| cache.find::<Text>(object, &revision).is_some();
        for object in ["a", "b", "c", "d"] {
            cache.keep(object, &1_u64, &Arc::new(Text(25)));
        }
        assert!(has("a", 1) && has("c", 1) && has("d", 1));
        cache.keep("e", &1_u64, &Arc::new(Text(1)));
        assert!(!has("b", 1) && has("a", 1) && has("e", 1));
        assert!(!has("a", 2), "settings are a part of the key");
        assert!(cache.find::<Number>("a", &1_u64).is_none(), "so is the type");
        cache.keep("a", &1_u64, &Arc::new(Text(2)));
        cache.keep("f", &1_u64, &Arc::new(Text(101)));
        assert!(!has("f", 1) && has("c", 1) && has("d", 1), "too large for the cache");
        assert_eq!(cache.locked().bytes, 25 + 25 + 1 + 2);
        cache.forget("c");
        assert!(!has("c", 1) && has("e", 1));
        assert_eq!(cache.locked().bytes, 25 + 1 + 2);
        cache.halve();
        assert!(!has("a", 1) && !has("d", 1) && has("e", 1), "the last one used is left");
        cache.halve();
        assert_eq!(cache.locked().bytes, 0);
    }

    #[test]
    fn values_that_nobody_uses_are_dropped() {
        let cache = Cache::new(400, Duration::from_millis(200));
        for object in ["a", "b"] {
            cache.keep(object, &1, &Arc::new(Text(25)));
        }
        cache.drop_unused();
        assert_eq!(cache.locked().bytes, 50, "the term has not passed");
        std::thread::sleep(Duration::from_millis(300));
        assert!(cache.find::<Text>("a", &1).is_some());
        cache.drop_unused();
        assert!(cache.has::<Text>("a", &1) && !cache.has::<Text>("b", &1));
        assert_eq!(cache.locked().bytes, 25);
    }
}
