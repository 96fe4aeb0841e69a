//! Requests without a known caller, refused or answered, counted by address and minute.
//!
//! A client without a key can send thousands of requests a second. For each address (for IPv6, each /64 network), the
//! first request of a minute has its own audit entry, and one further entry summarises all of them at the end of the
//! minute. Disk and log therefore grow with the number of addresses, not with the number of requests.

use std::collections::{BTreeMap, HashMap};
use std::net::IpAddr;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use crate::domain::access::network_text;
use crate::domain::audit::Entry;
use crate::wire::time::rfc3339;

/// Time covered by one summary entry.
const WINDOW: Duration = Duration::from_secs(60);
/// Number of requests per address and minute that are logged individually.
const LOUD: u64 = 5;
/// Maximum number of addresses counted separately in a minute; requests of further addresses are counted together. At
/// two entries of about 300 bytes this is 0.9 GB a day for an attacker with that many networks.
const MAX_NETWORKS: usize = 1024;
/// Method in entries that summarise many requests.
pub const MANY: &str = "*";
/// Address in entries for networks that are not counted separately.
const OTHERS: &str = "others";

/// Counts of the current minute.
#[derive(Debug, Default)]
pub struct Refusals {
    windows: Mutex<HashMap<Option<IpAddr>, Window>>,
}

/// Counts of one network.
#[derive(Debug)]
struct Window {
    begun: Instant,
    first_ms: i64,
    last_ms: i64,
    count: u64,
    reasons: BTreeMap<&'static str, u64>,
    request_id: String,
    /// Whether the first request has its own entry.
    has_entry: bool,
}

impl Refusals {
    /// Counts a request from `network` refused for `reason`; returns whether it is the first of a minute. `has_entry`:
    /// the request gets its own entry in that case.
    pub fn count(
        &self,
        network: Option<IpAddr>,
        reason: &'static str,
        request_id: &str,
        has_entry: bool,
        now_ms: i64,
    ) -> bool {
        let mut windows = self.windows();
        let place = network.filter(|_| windows.len() < MAX_NETWORKS || windows.contains_key(&network));
        let window = windows.entry(place).or_insert_with(|| Window::begin(request_id, has_entry, now_ms));
        window.last_ms = window.last_ms.max(now_ms);
        window.count += 1;
        *window.reasons.entry(reason).or_default() += 1;
        window.count == 1
    }

    /// Whether `network` has sent so many requests in this minute that further ones are not logged individually.
    pub fn is_loud(&self, network: Option<IpAddr>) -> bool {
        let windows = self.windows();
        let window = windows.get(&network).or_else(|| windows.get(&None));
        window.is_some_and(|window| window.count >= LOUD)
    }

    /// Summary entries of the minutes that are over.
    pub fn due(&self) -> Vec<Entry> {
        self.take(|window| window.begun.elapsed() >= WINDOW)
    }

    /// Summary entries of everything counted so far.
    pub fn all(&self) -> Vec<Entry> {
        self.take(|_| true)
    }

    fn take(&self, is_over: impl Fn(&Window) -> bool) -> Vec<Entry> {
        let over: Vec<_> = self.windows().extract_if(|_, window| is_over(window)).collect();
        let alone = |window: &Window| window.count == 1 && window.has_entry;
        let many = over.into_iter().filter(|(_, window)| !alone(window));
        many.map(|(network, window)| window.entry(network)).collect()
    }

    fn windows(&self) -> MutexGuard<'_, HashMap<Option<IpAddr>, Window>> {
        self.windows.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Window {
    fn begin(request_id: &str, has_entry: bool, now_ms: i64) -> Self {
        Self {
            begun: Instant::now(),
            first_ms: now_ms,
            last_ms: now_ms,
            count: 0,
            reasons: BTreeMap::new(),
            request_id: request_id.to_owned(),
            has_entry,
        }
    }

    fn entry(self, network: Option<IpAddr>) -> Entry {
        let from = network.map_or_else(|| OTHERS.to_owned(), network_text);
        if self.count > LOUD {
            let (count, reasons) = (self.count, &self.reasons);
            tracing::warn!(
                from,
                count,
                ?reasons,
                "requests from unknown callers, most of them without a line of their own"
            );
        }
        let reasons = self.reasons.iter().map(|(reason, count)| (format!("reason.{reason}"), *count));
        Entry {
            at_ms: self.last_ms,
            method: MANY.to_owned(),
            objects: counted(self.count, self.first_ms, self.last_ms, reasons),
            request_id: self.request_id,
            remote: Some(from),
            ..Entry::default()
        }
    }
}

/// Objects of an entry that summarises many requests.
pub fn counted(
    count: u64,
    first_ms: i64,
    last_ms: i64,
    parts: impl IntoIterator<Item = (String, u64)>,
) -> BTreeMap<String, String> {
    let parts = parts.into_iter().map(|(name, count)| (name, count.to_string()));
    let all = [("count", count.to_string()), ("first", rfc3339(first_ms)), ("last", rfc3339(last_ms))];
    parts.chain(all.map(|(name, value)| (name.to_owned(), value))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn network(number: u32) -> Option<IpAddr> {
        Some(std::net::Ipv4Addr::from_bits(number).into())
    }

    #[test]
    fn one_entry_stands_for_all_of_an_address() {
        let refusals = Refusals::default();
        for k in 0..1000 {
            assert_eq!(refusals.is_loud(network(1)), k >= 5, "{k}");
            let reason = if k % 4 == 0 { "route-not-found" } else { "unauthenticated" };
            assert_eq!(refusals.count(network(1), reason, &format!("r{k}"), true, 1_000 + k), k == 0);
        }
        assert!(refusals.count(network(2), "gone", "other", false, 9));
        assert!(refusals.count(network(3), "gone", "has an entry", true, 9), "which is enough");
        assert_eq!(refusals.due(), [], "the minute is not over");
        let mut entries = refusals.all();
        entries.sort_by_key(|entry| entry.at_ms);
        let [other, many] = entries.as_slice() else { panic!("{entries:?}") };
        assert_eq!((other.objects["count"].as_str(), other.remote.as_deref()), ("1", Some("0.0.0.2")));
        let objects = [
            ("count", "1000"),
            ("first", "1970-01-01T00:00:01Z"),
            ("last", "1970-01-01T00:00:01.999Z"),
            ("reason.route-not-found", "250"),
            ("reason.unauthenticated", "750"),
        ];
        let objects: BTreeMap<_, _> =
            objects.into_iter().map(|(k, v)| (k.to_owned(), v.to_owned())).collect();
        assert_eq!((many.at_ms, many.request_id.as_str(), many.method.as_str()), (1_999, "r0", "*"));
        assert_eq!((&many.objects, many.tenant.as_str(), many.status), (&objects, "", None));
        assert_eq!(refusals.all(), [], "taken once");
        assert!(!refusals.is_loud(network(1)), "a new minute");
    }

    #[test]
    fn many_addresses_take_no_more_than_so_many_entries() {
        let refusals = Refusals::default();
        for k in 0..10 * MAX_NETWORKS as u32 {
            refusals.count(network(k), "unauthenticated", "r", false, 0);
        }
        assert!(refusals.is_loud(network(u32::MAX)), "those who are not told apart are one");
        refusals.count(network(0), "unauthenticated", "r", false, 0);
        let entries = refusals.all();
        assert_eq!(entries.len(), MAX_NETWORKS + 1);
        let counts: u64 = entries.iter().map(|entry| entry.objects["count"].parse::<u64>().unwrap()).sum();
        assert_eq!(counts, 10 * MAX_NETWORKS as u64 + 1);
    }
}
