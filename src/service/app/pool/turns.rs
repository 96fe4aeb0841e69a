//! Order of tasks: tenants take turns by the work done for them, and so do the keys within a tenant.
//!
//! Start-time fair queueing. A waiting share has a virtual start `v`; the next task is that of the share with the
//! smallest start, and
//!
//! ```text
//! v ← v + predicted seconds     when a task begins
//! v ← v + taken − predicted     when it has ended
//! v ← max(v, clock)             when an idle share returns; the clock is the v of the task that began last
//! ```
//!
//! A returning tenant therefore has no credit for its idle time, and a tenant with long tasks waits correspondingly
//! longer between them.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::domain::access::Principal;

/// Time for which a tenant counts as active after its last task arrived: a client that processes the answer before its
/// next request is still active.
const ASKS: Duration = Duration::from_secs(10);

/// Owner of a task: a tenant and one of its keys.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Who {
    tenant: Arc<str>,
    key: Arc<str>,
}

impl Who {
    /// Owner of the tasks of a principal. All tokens of an identity provider have one key, so their subject counts
    /// instead.
    pub(super) fn of(principal: &Principal) -> Self {
        let key = principal.subject.as_ref().unwrap_or(&principal.key);
        Self { tenant: principal.tenant.as_str().into(), key: key.as_str().into() }
    }

    /// The service itself.
    pub(super) fn service() -> Self {
        Self { tenant: "".into(), key: "".into() }
    }
}

/// A waiting task.
#[derive(Debug)]
pub(super) struct Entry<T> {
    pub(super) id: u64,
    pub(super) who: Who,
    /// Predicted seconds.
    pub(super) seconds: f64,
    /// Whether it may be evicted for other tasks.
    pub(super) evictable: bool,
    pub(super) task: T,
}

/// Share of a tenant, or of a key within a tenant.
#[derive(Debug)]
struct Share<Q> {
    start: f64,
    waiting: usize,
    running: usize,
    /// Arrival time of its last task.
    asked: Instant,
    queue: Q,
}

impl<Q> Share<Q> {
    fn held(&self) -> usize {
        self.waiting + self.running
    }
}

/// Shares of one level: all tenants, or all keys of a tenant.
#[derive(Debug)]
struct Level<Q> {
    clock: f64,
    shares: BTreeMap<Arc<str>, Share<Q>>,
}

impl<Q> Default for Level<Q> {
    fn default() -> Self {
        Self { clock: 0.0, shares: BTreeMap::new() }
    }
}

impl<Q: Default> Level<Q> {
    /// Registers an arriving task.
    fn enter(&mut self, name: &Arc<str>, now: Instant) -> &mut Q {
        let clock = self.clock;
        let fresh = || Share { start: clock, waiting: 0, running: 0, asked: now, queue: Q::default() };
        let share = self.shares.entry(Arc::clone(name)).or_insert_with(fresh);
        if share.held() == 0 {
            share.start = share.start.max(clock);
        }
        share.waiting += 1;
        share.asked = now;
        &mut share.queue
    }

    /// The share with the smallest start among those with a waiting task that `may` begin.
    fn next(&self, may: impl Fn(&Share<Q>) -> bool) -> Option<Arc<str>> {
        let waiting = self.shares.iter().filter(|(_, share)| share.waiting > 0 && may(share));
        let first = waiting.min_by(|(_, a), (_, b)| a.start.total_cmp(&b.start));
        first.map(|(name, _)| Arc::clone(name))
    }

    /// The share with most tasks among those that `can` lose one, if it has more tasks than `own` would have with one
    /// more.
    fn largest(&self, own: &str, can: impl Fn(&Q) -> bool) -> Option<Arc<str>> {
        let held = self.shares.get(own).map_or(0, Share::held);
        let giving = self.shares.iter().filter(|(_, share)| can(&share.queue));
        let (name, most) = giving.max_by_key(|(_, share)| share.held())?;
        (most.held() > held + 1).then(|| Arc::clone(name))
    }

    /// Registers that a waiting task begins.
    fn begin(&mut self, name: &str, seconds: f64) {
        let Some(share) = self.shares.get_mut(name) else { return };
        self.clock = share.start;
        share.start += seconds;
        share.waiting -= 1;
        share.running += 1;
    }

    /// Registers that a running task has ended; `more`: actual minus predicted seconds.
    fn end(&mut self, name: &str, more: f64) {
        let Some(share) = self.shares.get_mut(name) else { return };
        share.start += more;
        share.running -= 1;
        self.forget();
    }

    /// Registers that a waiting task leaves.
    fn leave(&mut self, name: &str) {
        if let Some(share) = self.shares.get_mut(name) {
            share.waiting -= 1;
        }
        self.forget();
    }

    /// Drops idle shares that no longer affect the order; resets the accounts when no task is left.
    fn forget(&mut self) {
        if self.shares.values().all(|share| share.held() == 0) {
            // Sums that only grow would lose precision in the end.
            self.shares.values_mut().for_each(|share| share.start = 0.0);
            self.clock = 0.0;
        }
        let clock = self.clock;
        self.shares
            .retain(|_, share| share.held() > 0 || share.start > clock || share.asked.elapsed() < ASKS);
    }
}

type Keys<T> = Level<VecDeque<Entry<T>>>;

fn evictable<T>(queue: &VecDeque<Entry<T>>) -> bool {
    queue.iter().any(|entry| entry.evictable)
}

/// All waiting tasks of a lane, and the number of running tasks per owner.
#[derive(Debug)]
pub(super) struct Turns<T> {
    tenants: Level<Keys<T>>,
    /// Number of threads.
    slots: usize,
    /// Whether a tenant may run on more than half of them while no other one is active.
    lends: bool,
}

impl<T> Turns<T> {
    /// An empty queue for this number of threads.
    pub(super) fn new(slots: usize) -> Self {
        Self { tenants: Level::default(), slots, lends: true }
    }

    /// An empty queue for tasks that may last as long as their client likes: half of the threads is always kept for others.
    pub(super) fn lasting(slots: usize) -> Self {
        Self { lends: false, ..Self::new(slots) }
    }

    /// Number of tasks that wait or run.
    pub(super) fn held(&self) -> usize {
        self.tenants.shares.values().map(Share::held).sum()
    }

    /// Adds a waiting task.
    pub(super) fn push(&mut self, entry: Entry<T>, now: Instant) {
        let Who { tenant, key } = entry.who.clone();
        self.tenants.enter(&tenant, now).enter(&key, now).push_back(entry);
    }

    /// Next task in order; it counts as running until [`Turns::end`].
    ///
    /// While other tenants are active, a tenant runs on at most half of the threads, so that their next task finds a
    /// free one.
    pub(super) fn next(&mut self, now: Instant) -> Option<Entry<T>> {
        let half = self.slots.div_ceil(2);
        let asking =
            self.tenants.shares.values().filter(|share| now.duration_since(share.asked) < ASKS).count();
        let tenant = self.tenants.next(|share| share.running < half || (self.lends && asking < 2))?;
        let keys = &mut self.tenants.shares.get_mut(&tenant)?.queue;
        let key = keys.next(|_| true)?;
        let entry = keys.shares.get_mut(&key)?.queue.pop_front()?;
        keys.begin(&key, entry.seconds);
        self.tenants.begin(&tenant, entry.seconds);
        Some(entry)
    }

    /// Registers the end of a task of `who`, with predicted and actual seconds.
    pub(super) fn end(&mut self, who: &Who, predicted: f64, taken: f64) {
        if let Some(share) = self.tenants.shares.get_mut(&who.tenant) {
            share.queue.end(&who.key, taken - predicted);
        }
        self.tenants.end(&who.tenant, taken - predicted);
    }

    /// Removes the newest task of the tenant with most tasks, if it has more than the tenant of `who` would have with
    /// one more; otherwise, by the same rule, that of a key of the tenant of `who`.
    pub(super) fn evict_for(&mut self, who: &Who) -> Option<Entry<T>> {
        let tenant = self
            .tenants
            .largest(&who.tenant, |keys| keys.shares.values().any(|share| evictable(&share.queue)));
        let tenant = tenant.unwrap_or_else(|| Arc::clone(&who.tenant));
        let keys = &self.tenants.shares.get(&tenant)?.queue;
        // The owner has no key in another tenant, where any key with two tasks may lose one.
        let own: &str = if tenant == who.tenant { &who.key } else { "" };
        let key = match keys.largest(own, evictable) {
            Some(key) => key,
            None if tenant != who.tenant => {
                keys.shares.iter().find(|(_, share)| evictable(&share.queue))?.0.clone()
            }
            None => return None,
        };
        let newest = keys.shares.get(&key)?.queue.iter().rev().find(|entry| entry.evictable)?.id;
        self.remove(&Who { tenant, key }, newest)
    }

    /// Removes a waiting task.
    pub(super) fn remove(&mut self, who: &Who, id: u64) -> Option<Entry<T>> {
        let keys = &mut self.tenants.shares.get_mut(&who.tenant)?.queue;
        let queue = &mut keys.shares.get_mut(&who.key)?.queue;
        let place = queue.iter().position(|entry| entry.id == id)?;
        let entry = queue.remove(place);
        keys.leave(&who.key);
        self.tenants.leave(&who.tenant);
        entry
    }
}

#[cfg(test)]
impl Who {
    pub(super) fn named(tenant: &str, key: &str) -> Self {
        Self { tenant: tenant.into(), key: key.into() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn who(tenant: &str, key: &str) -> Who {
        Who::named(tenant, key)
    }

    fn push(turns: &mut Turns<&'static str>, id: u64, who: Who, seconds: f64, task: &'static str) {
        turns.push(Entry { id, who, seconds, evictable: true, task }, Instant::now());
    }

    /// Runs the next task for exactly its predicted time.
    fn run(turns: &mut Turns<&'static str>) -> Option<&'static str> {
        let entry = turns.next(Instant::now())?;
        turns.end(&entry.who, entry.seconds, entry.seconds);
        Some(entry.task)
    }

    #[test]
    fn tenants_take_turns_by_work_and_not_by_number() {
        let mut turns = Turns::new(1);
        for id in 0..10 {
            push(&mut turns, id, who("a", "1"), 4.0, "a");
        }
        assert_eq!(run(&mut turns), Some("a"));
        for id in 10..20 {
            push(&mut turns, id, who("b", "1"), 1.0, "b");
        }
        let order: String = (0..12).filter_map(|_| run(&mut turns)).collect();
        // Four seconds of one for every four of the other.
        assert_eq!(order, "bbbbabbbbabb");
    }

    #[test]
    fn who_waited_for_nothing_has_no_credit() {
        let mut turns = Turns::new(1);
        for id in 0..4 {
            push(&mut turns, id, who("a", "1"), 1.0, "a");
            push(&mut turns, 10 + id, who("b", "1"), 1.0, "b");
        }
        let order: String = (0..8).filter_map(|_| run(&mut turns)).collect();
        assert_eq!(order, "abababab");
        for id in 20..40 {
            push(&mut turns, id, who("a", "1"), 1.0, "a");
        }
        (0..15).for_each(|_| assert_eq!(run(&mut turns), Some("a")));
        for id in 40..44 {
            push(&mut turns, id, who("b", "1"), 1.0, "b");
        }
        let order: String = (0..4).filter_map(|_| run(&mut turns)).collect();
        assert!(["baba", "abab"].contains(&order.as_str()), "{order}");
    }

    #[test]
    fn keys_of_a_tenant_take_turns() {
        let mut turns = Turns::new(1);
        for id in 0..6 {
            push(&mut turns, id, who("a", "1"), 1.0, "1");
        }
        for id in 6..9 {
            push(&mut turns, id, who("a", "2"), 1.0, "2");
        }
        let order: String = (0..9).filter_map(|_| run(&mut turns)).collect();
        assert_eq!(order, "121212111");
    }

    #[test]
    fn what_takes_longer_than_predicted_counts() {
        let mut turns = Turns::new(1);
        for id in 0..10 {
            push(&mut turns, id, who("a", "1"), 1.0, "a");
            push(&mut turns, 10 + id, who("b", "1"), 1.0, "b");
        }
        let first = turns.next(Instant::now()).unwrap();
        turns.end(&first.who, 1.0, 5.0);
        assert_eq!(first.task, "a");
        let order: String = (0..7).filter_map(|_| run(&mut turns)).collect();
        assert_eq!(order, "bbbbbab");
    }

    #[test]
    fn while_others_ask_a_tenant_has_half_of_the_threads() {
        let mut turns = Turns::new(4);
        for id in 0..8 {
            push(&mut turns, id, who("a", "1"), 1.0, "a");
        }
        push(&mut turns, 10, who("b", "1"), 1.0, "b");
        let now = Instant::now();
        let begun: String = std::iter::from_fn(|| turns.next(now)).map(|entry| entry.task).collect();
        assert_eq!(begun, "aba");
        // No other tenant has been active for a while.
        let later: String =
            std::iter::from_fn(|| turns.next(now + 2 * ASKS)).map(|entry| entry.task).collect();
        assert_eq!(later, "aaaaaa", "the lane itself counts its threads");
    }

    #[test]
    fn who_has_most_places_gives_the_newest() {
        let mut turns = Turns::new(1);
        for id in 0..5 {
            push(&mut turns, id, who("a", "1"), 1.0, "a");
        }
        push(&mut turns, 5, who("a", "2"), 1.0, "a");
        assert_eq!(turns.evict_for(&who("b", "1")).map(|entry| entry.id), Some(4));
        assert_eq!(turns.evict_for(&who("a", "2")).map(|entry| entry.id), Some(3), "of the other key of a");
        for id in 6..9 {
            push(&mut turns, id, who("b", "1"), 1.0, "b");
        }
        assert_eq!(turns.held(), 7);
        assert!(turns.evict_for(&who("b", "1")).is_none(), "both would have four");
        assert_eq!(turns.evict_for(&who("c", "1")).map(|entry| entry.id), Some(2));
        assert_eq!(turns.evict_for(&who("b", "2")).map(|entry| entry.id), Some(8), "of the other key of b");
    }

    #[test]
    fn what_is_taken_out_leaves_no_trace() {
        let mut turns = Turns::new(1);
        for id in 0..3 {
            push(&mut turns, id, who("a", "1"), 1.0, "a");
        }
        assert_eq!(turns.remove(&who("a", "1"), 1).map(|entry| entry.id), Some(1));
        assert!(turns.remove(&who("a", "1"), 1).is_none());
        assert!(turns.remove(&who("b", "1"), 2).is_none());
        assert_eq!(
            (turns.held(), run(&mut turns), run(&mut turns), run(&mut turns)),
            (2, Some("a"), Some("a"), None)
        );
    }
}
