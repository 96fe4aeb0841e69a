//! A fixed number of connection slots. When all are in use, a new connection evicts the one that has been idle longest,
//! waiting for its client to send a request, send the rest of one, or read a response. If every connection is being
//! served, the new one is refused.

use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

/// Longest interval between checks of a connection.
const MAX_CHECK_INTERVAL: Duration = Duration::from_secs(5);

/// Timeouts of connections.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Timeouts {
    /// From the connection to the end of its first request head.
    pub(super) first: Duration,
    /// From a response to the end of the next request head.
    pub(super) idle: Duration,
    /// While response bytes are ready that the client does not take, nor sends more of a request.
    pub(super) reader: Duration,
}

/// All connection slots.
#[derive(Debug)]
pub(super) struct Slots {
    most: usize,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    taken: usize,
    /// Sequence number of the last connection that became idle.
    next: u64,
    /// Idle connections, longest idle first.
    idle: BTreeMap<u64, CancellationToken>,
}

impl Slots {
    pub(super) fn new(most: usize) -> Arc<Self> {
        Arc::new(Self { most, state: Mutex::default() })
    }

    /// Takes a slot, evicting the longest idle connection if necessary; `None` if all connections are being served.
    pub(super) fn enter(self: &Arc<Self>) -> Option<Arc<Slot>> {
        let mut state = locked(&self.state);
        if state.taken >= self.most && !state.close_longest_idle() {
            return None;
        }
        state.taken += 1;
        let closing = CancellationToken::new();
        let idle = Some(state.rest(&closing));
        drop(state);
        let usage = Usage {
            since: Instant::now(),
            served: false,
            requests: 0,
            working: 0,
            idle,
            next: 0,
            unread: HashMap::new(),
            moved: 0,
        };
        Some(Arc::new(Slot { slots: Arc::clone(self), closing, usage: Mutex::new(usage) }))
    }

    /// Evicts the longest idle connection.
    pub(super) fn close_one(&self) {
        locked(&self.state).close_longest_idle();
    }
}

impl State {
    fn close_longest_idle(&mut self) -> bool {
        self.idle.pop_first().map(|(_, closing)| closing.cancel()).is_some()
    }

    fn rest(&mut self, closing: &CancellationToken) -> u64 {
        self.next += 1;
        self.idle.insert(self.next, closing.clone());
        self.next
    }
}

/// Slot of one connection.
#[derive(Debug)]
pub(super) struct Slot {
    slots: Arc<Slots>,
    closing: CancellationToken,
    usage: Mutex<Usage>,
}

#[derive(Debug)]
struct Usage {
    /// Time since which there has been no request.
    since: Instant,
    /// Whether there has been a request.
    served: bool,
    requests: usize,
    /// Number of requests minus those waiting for the client.
    working: isize,
    /// Sequence number among the idle connections, if idle.
    idle: Option<u64>,
    next: u64,
    /// Bodies waiting for the client to read, with the start of the wait.
    unread: HashMap<u64, Instant>,
    /// Number of bytes written, and of request bodies taken, since then.
    moved: usize,
}

/// Number of the connection itself in `unread`; bodies count from one.
const WIRE: u64 = 0;
/// Number of bytes that a client must take, or send of a body, within the timeout; a ping does not count as reading.
const LEAST: usize = 16 << 10;

/// How to close a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum CloseReason {
    /// Gracefully: it is idle.
    Idle,
    /// Immediately: its client does not read, or another connection needs the slot.
    AtOnce,
}

impl Usage {
    fn unread(&mut self, number: u64, waits: bool) {
        if !waits {
            self.unread.remove(&number);
            return;
        }
        if self.unread.is_empty() {
            self.moved = 0;
        }
        self.unread.entry(number).or_insert_with(Instant::now);
    }

    /// Marks the connection as idle or busy, as its requests require.
    fn settle(&mut self, place: &Slot) {
        match (self.working > 0, self.idle) {
            (true, Some(number)) => {
                locked(&place.slots.state).idle.remove(&number);
                self.idle = None;
            }
            (false, None) => self.idle = Some(locked(&place.slots.state).rest(&place.closing)),
            _ => {}
        }
    }
}

impl Slot {
    /// Registers a request, which ends when the returned value is dropped.
    pub(super) fn begin(self: &Arc<Self>) -> Arc<Request> {
        let mut usage = locked(&self.usage);
        usage.requests += 1;
        usage.working += 1;
        usage.served = true;
        usage.settle(self);
        Arc::new(Request { place: Arc::clone(self) })
    }

    /// Records whether bytes wait to be written on the connection.
    pub(super) fn waits(&self, waits: bool) {
        locked(&self.usage).unread(WIRE, waits);
    }

    /// Records that `bytes` were written.
    pub(super) fn wrote(&self, bytes: usize) {
        let mut usage = locked(&self.usage);
        usage.moved = usage.moved.saturating_add(bytes);
        if usage.moved >= LEAST {
            usage.moved = 0;
            usage.unread.values_mut().for_each(|since| *since = Instant::now());
        }
    }

    /// Waits until the connection must be closed.
    pub(super) async fn end(&self, patience: &Timeouts) -> CloseReason {
        let overdue = async {
            loop {
                match self.look(patience) {
                    Ok(next) => tokio::time::sleep_until(next).await,
                    Err(end) => return end,
                }
            }
        };
        tokio::select! {
            () = self.closing.cancelled() => CloseReason::AtOnce,
            end = overdue => end,
        }
    }

    /// Time of the next check, or how the connection must be closed now.
    fn look(&self, patience: &Timeouts) -> Result<Instant, CloseReason> {
        let (usage, now) = (locked(&self.usage), Instant::now());
        let soon = now + MAX_CHECK_INTERVAL.min(patience.idle).min(patience.reader);
        let (end, due) = match (usage.unread.values().min(), usage.requests) {
            (Some(since), _) => (CloseReason::AtOnce, *since + patience.reader),
            (None, 0) if usage.served => (CloseReason::Idle, usage.since + patience.idle),
            (None, 0) => (CloseReason::Idle, usage.since + patience.first),
            (None, _) => return Ok(soon),
        };
        if due <= now { Err(end) } else { Ok(due.min(soon)) }
    }
}

impl Drop for Slot {
    fn drop(&mut self) {
        let mut state = locked(&self.slots.state);
        state.taken -= 1;
        if let Some(number) = locked(&self.usage).idle {
            state.idle.remove(&number);
        }
    }
}

/// A request on a connection, until its response is written.
#[derive(Debug)]
pub(super) struct Request {
    place: Arc<Slot>,
}

impl Request {
    /// Registers a body of the request, which may have to wait for the client; `bounded` applies the reader timeout to it.
    pub(super) fn part(self: &Arc<Self>, bounded: bool) -> Part {
        let mut usage = locked(&self.place.usage);
        usage.next += 1;
        Part { request: Arc::clone(self), number: usage.next, bounded, waits: false }
    }
}

impl Drop for Request {
    fn drop(&mut self) {
        let mut usage = locked(&self.place.usage);
        usage.requests -= 1;
        usage.working -= 1;
        if usage.requests == 0 {
            usage.since = Instant::now();
        }
        usage.settle(&self.place);
    }
}

/// A body that is sent or read at the client's pace.
#[derive(Debug)]
pub(super) struct Part {
    request: Arc<Request>,
    number: u64,
    bounded: bool,
    waits: bool,
}

impl Part {
    /// Records whether the body is waiting for the client.
    pub(super) fn waits(&mut self, waits: bool) {
        if self.waits == waits {
            return;
        }
        self.waits = waits;
        let place = &self.request.place;
        let mut usage = locked(&place.usage);
        usage.working += if waits { -1 } else { 1 };
        if self.bounded {
            usage.unread(self.number, waits);
        }
        usage.settle(place);
    }

    /// Records that `bytes` of the body were taken from the client.
    pub(super) fn took(&self, bytes: usize) {
        self.request.place.wrote(bytes);
    }
}

impl Drop for Part {
    fn drop(&mut self) {
        self.waits(false);
    }
}

/// A poisoned lock is safe to use: no update is left half done.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATIENCE: Timeouts = Timeouts {
        first: Duration::from_millis(60),
        idle: Duration::from_millis(120),
        reader: Duration::from_millis(200),
    };

    #[test]
    fn who_waits_for_its_client_gives_its_place_and_who_is_at_work_never_does() {
        let slots = Slots::new(2);
        let (first, second) = (slots.enter().unwrap(), slots.enter().unwrap());
        let answering = first.begin();
        let third = slots.enter().unwrap();
        assert!(!first.closing.is_cancelled() && second.closing.is_cancelled());
        drop(second);
        let busy = third.begin();
        assert!(slots.enter().is_none(), "both are being answered");
        drop(answering);
        assert!(slots.enter().is_some());
        assert!(first.closing.is_cancelled() && !third.closing.is_cancelled());
        drop((busy, first, third));
        let slow = slots.enter().unwrap();
        let (_request, mut body) = {
            let request = slow.begin();
            (Arc::clone(&request), request.part(false))
        };
        let _other = slots.enter().unwrap().begin();
        assert!(slots.enter().is_none(), "both are at work");
        body.waits(true);
        drop(slots.enter().unwrap());
        assert!(slow.closing.is_cancelled(), "a client that does not send gives its place");
        drop((body, _request, slow, _other));
        let state = locked(&slots.state);
        assert_eq!((state.taken, state.idle.len()), (0, 0), "nothing is left of closed connections");
    }

    #[tokio::test]
    async fn a_connection_goes_when_it_is_idle_or_not_read_and_not_while_it_is_answered() {
        let slots = Slots::new(1);
        let place = slots.enter().unwrap();
        let begin = Instant::now();
        assert_eq!(place.end(&PATIENCE).await, CloseReason::Idle);
        assert!(
            (60..120).contains(&begin.elapsed().as_millis()),
            "before the first request: {:?}",
            begin.elapsed()
        );
        let request = place.begin();
        let long = tokio::time::timeout(Duration::from_millis(300), place.end(&PATIENCE)).await;
        assert!(long.is_err(), "an answer takes as long as it takes");
        let mut answer = request.part(true);
        answer.waits(true);
        let begin = Instant::now();
        tokio::time::sleep(Duration::from_millis(100)).await;
        place.wrote(LEAST);
        assert_eq!(place.end(&PATIENCE).await, CloseReason::AtOnce);
        assert!(begin.elapsed() >= Duration::from_millis(299), "what was read counts: {:?}", begin.elapsed());
        answer.waits(false);
        answer.waits(true);
        let (begin, body) = (Instant::now(), request.part(false));
        for _ in 0..3 {
            tokio::time::sleep(Duration::from_millis(100)).await;
            body.took(LEAST);
        }
        assert_eq!(place.end(&PATIENCE).await, CloseReason::AtOnce);
        assert!(begin.elapsed() >= Duration::from_millis(499), "what was sent counts: {:?}", begin.elapsed());
        answer.waits(false);
        drop(body);
        drop((answer, request));
        let begin = Instant::now();
        assert_eq!(place.end(&PATIENCE).await, CloseReason::Idle);
        assert!(begin.elapsed() >= Duration::from_millis(119), "after a request: {:?}", begin.elapsed());
    }
}
