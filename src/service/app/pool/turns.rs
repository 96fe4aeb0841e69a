//! Whose turn it is: tenants take turns by the work that was done for them, and inside a tenant its keys do.
//!
//! Start-time fair queueing. A share that waits has a virtual start `v`; the next task is that of the smallest one, and
//!
//! ```text
//! v ← v + predicted seconds     when a task begins
//! v ← v + taken − predicted     when it has ended
//! v ← max(v, clock)             when a share that had nothing comes back; the clock is the v of the task that began last
//! ```
//!
//! so a tenant that comes back has no credit for the time in which it asked for nothing, and one that sends long tasks waits
//! as many turns longer.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crate::domain::access::Principal;

/// How long a tenant counts as one that asks, after its last task came: a client that works on the answer before it asks again
/// is still there.
const ASKS: Duration = Duration::from_secs(10);

/// Who waits: a tenant, and one of its keys.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Who {
    tenant: Arc<str>,
    key: Arc<str>,
}

impl Who {
    /// Who stands behind a principal: all tokens of an identity provider have one key, so that their subject counts.
    pub(super) fn of(principal: &Principal) -> Self {
        let key = principal.subject.as_ref().unwrap_or(&principal.key);
        Self { tenant: principal.tenant.as_str().into(), key: key.as_str().into() }
    }

    /// The service itself.
    pub(super) fn service() -> Self {
        Self { tenant: "".into(), key: "".into() }
    }
}

/// A task that waits.
#[derive(Debug)]
pub(super) struct Entry<T> {
    pub(super) id: u64,
    pub(super) who: Who,
    /// Predicted seconds.
    pub(super) seconds: f64,
    /// Whether it may be sent away for others.
    pub(super) evictable: bool,
    pub(super) task: T,
}

/// One of those that share: a tenant, or a key of one.
#[derive(Debug)]
struct Share<Q> {
    start: f64,
    waiting: usize,
    running: usize,
    /// When its last task came.
    asked: Instant,
    queue: Q,
}

impl<Q> Share<Q> {
    fn held(&self) -> usize {
        self.waiting + self.running
    }
}

/// Those that share.
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
    /// A task comes.
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

    /// The share with a task that waits whose start is smallest, of those that `may` begin.
    fn next(&self, may: impl Fn(&Share<Q>) -> bool) -> Option<Arc<str>> {
        let waiting = self.shares.iter().filter(|(_, share)| share.waiting > 0 && may(share));
        let first = waiting.min_by(|(_, a), (_, b)| a.start.total_cmp(&b.start));
        first.map(|(name, _)| Arc::clone(name))
    }

    /// The share with most tasks, of those that `can` give one, when it has more than `own` would have with another one.
    fn largest(&self, own: &str, can: impl Fn(&Q) -> bool) -> Option<Arc<str>> {
        let held = self.shares.get(own).map_or(0, Share::held);
        let giving = self.shares.iter().filter(|(_, share)| can(&share.queue));
        let (name, most) = giving.max_by_key(|(_, share)| share.held())?;
        (most.held() > held + 1).then(|| Arc::clone(name))
    }

    /// A task that waited begins.
    fn begin(&mut self, name: &str, seconds: f64) {
        let Some(share) = self.shares.get_mut(name) else { return };
        self.clock = share.start;
        share.start += seconds;
        share.waiting -= 1;
        share.running += 1;
    }

    /// A task that ran has ended, `more` seconds later than predicted.
    fn end(&mut self, name: &str, more: f64) {
        let Some(share) = self.shares.get_mut(name) else { return };
        share.start += more;
        share.running -= 1;
        self.forget();
    }

    /// A task that waited goes.
    fn leave(&mut self, name: &str) {
        if let Some(share) = self.shares.get_mut(name) {
            share.waiting -= 1;
        }
        self.forget();
    }

    /// Drops those with nothing to do whom it makes no difference, and the account with the last task.
    fn forget(&mut self) {
        if self.shares.values().all(|share| share.held() == 0) {
            // Sums that only grow would lose their digits in the end.
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

/// All tasks of a lane that wait, and how many run for whom.
#[derive(Debug)]
pub(super) struct Turns<T> {
    tenants: Level<Keys<T>>,
    /// Threads that the tasks take turns on.
    slots: usize,
}

impl<T> Turns<T> {
    /// Turns on so many threads.
    pub(super) fn new(slots: usize) -> Self {
        Self { tenants: Level::default(), slots }
    }

    /// Tasks that wait or run.
    pub(super) fn held(&self) -> usize {
        self.tenants.shares.values().map(Share::held).sum()
    }

    /// A task waits from now on.
    pub(super) fn push(&mut self, entry: Entry<T>, now: Instant) {
        let Who { tenant, key } = entry.who.clone();
        self.tenants.enter(&tenant, now).enter(&key, now).push_back(entry);
    }

    /// The task whose turn it is: it runs from now on, until [`Turns::end`].
    ///
    /// While others ask, a tenant runs on at most half of the threads: their next task finds a free one.
    pub(super) fn next(&mut self, now: Instant) -> Option<Entry<T>> {
        let half = self.slots.div_ceil(2);
        let asking =
            self.tenants.shares.values().filter(|share| now.duration_since(share.asked) < ASKS).count();
        let tenant = self.tenants.next(|share| share.running < half || asking < 2)?;
        let keys = &mut self.tenants.shares.get_mut(&tenant)?.queue;
        let key = keys.next(|_| true)?;
        let entry = keys.shares.get_mut(&key)?.queue.pop_front()?;
        keys.begin(&key, entry.seconds);
        self.tenants.begin(&tenant, entry.seconds);
        Some(entry)
    }

    /// A task that ran for `who` has taken so long.
    pub(super) fn end(&mut self, who: &Who, predicted: f64, taken: f64) {
        if let Some(share) = self.tenants.shares.get_mut(&who.tenant) {
            share.queue.end(&who.key, taken - predicted);
        }
        self.tenants.end(&who.tenant, taken - predicted);
    }

    /// Takes out the newest task of the tenant that has most, when that is more than `who` has with another one; else, of
    /// the keys of its own tenant.
    pub(super) fn evict_for(&mut self, who: &Who) -> Option<Entry<T>> {
        let tenant = self
            .tenants
            .largest(&who.tenant, |keys| keys.shares.values().any(|share| evictable(&share.queue)));
        let tenant = tenant.unwrap_or_else(|| Arc::clone(&who.tenant));
        let keys = &self.tenants.shares.get(&tenant)?.queue;
        // A key of another tenant has none here: any that has two tasks may give one.
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

    /// Takes out a task that waits.
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
mod tests {
    use super::*;

    fn who(tenant: &str, key: &str) -> Who {
        Who { tenant: tenant.into(), key: key.into() }
    }

    fn push(turns: &mut Turns<&'static str>, id: u64, who: Who, seconds: f64, task: &'static str) {
        turns.push(Entry { id, who, seconds, evictable: true, task }, Instant::now());
    }

    /// Runs the next task for as long as was predicted.
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
        // Nobody else has asked for a while.
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
