//! Places for work that lasts as long as its client likes: files that are read while they arrive, or written while they are taken.
//!
//! Tenants take places in turn, by the time for which they have held some; none takes more than half of them, so that those of others
//! do not depend on how slow its clients are.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use super::turns::{Entry, Turns, Who};
use crate::service::app::error::ServiceError;

/// Number of places: each is a thread, which mostly waits for its client.
pub(super) const PLACES: usize = 64;
/// Number of callers that wait for a place.
const WAITING: usize = 256;
/// Time for which a caller waits for a place.
const PATIENCE: Duration = Duration::from_secs(30);

/// The places. Clones share them.
#[derive(Debug, Clone)]
pub(super) struct Places(Arc<Mutex<State>>);

#[derive(Debug)]
struct State {
    turns: Turns<oneshot::Sender<Place>>,
    /// Number of places that are taken.
    taken: usize,
    /// Number of the last caller.
    last: u64,
}

/// A place, which is free again when it is dropped.
#[derive(Debug)]
pub(super) struct Place {
    places: Places,
    who: Who,
    begun: Instant,
}

/// A caller that waits, which leaves the queue when it waits no more.
struct Leaving<'a> {
    places: &'a Places,
    who: &'a Who,
    id: u64,
}

impl Drop for Leaving<'_> {
    fn drop(&mut self) {
        self.places.state().turns.remove(self.who, self.id);
    }
}

impl Places {
    pub(super) fn new() -> Self {
        Self(Arc::new(Mutex::new(State { turns: Turns::lasting(PLACES), taken: 0, last: 0 })))
    }

    /// Waits for a place.
    ///
    /// # Errors
    /// [`ServiceError::Overloaded`] if none becomes free in time, or too many callers wait.
    pub(super) async fn take(&self, who: &Who) -> Result<Place, ServiceError> {
        self.take_within(PATIENCE, who).await
    }

    async fn take_within(&self, patience: Duration, who: &Who) -> Result<Place, ServiceError> {
        let full = || ServiceError::Overloaded(format!("{PLACES} files are being read or written"));
        let (task, given) = oneshot::channel();
        let id = {
            let mut state = self.state();
            if state.turns.held() - state.taken >= WAITING && state.turns.evict_for(who).is_none() {
                return Err(full());
            }
            state.last += 1;
            let id = state.last;
            state
                .turns
                .push(Entry { id, who: who.clone(), seconds: 0.0, evictable: true, task }, Instant::now());
            id
        };
        let _leaving = Leaving { places: self, who, id };
        self.give();
        let given = tokio::time::timeout(patience, given).await;
        given.ok().and_then(Result::ok).ok_or_else(full)
    }

    /// Gives free places to those whose turn it is. A caller that has gone gives its place back at once.
    fn give(&self) {
        loop {
            let entry = {
                let mut state = self.state();
                if state.taken == PLACES {
                    return;
                }
                let Some(entry) = state.turns.next(Instant::now()) else { return };
                state.taken += 1;
                entry
            };
            let place = Place { places: self.clone(), who: entry.who, begun: Instant::now() };
            drop(entry.task.send(place));
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        {
            let mut state = self.places.state();
            state.turns.end(&self.who, 0.0, self.begun.elapsed().as_secs_f64());
            state.taken -= 1;
        }
        self.places.give();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As many places as there are for a caller now.
    async fn all(places: &Places, who: &Who) -> Vec<Place> {
        let mut held = Vec::new();
        while let Ok(place) = tokio::time::timeout(Duration::from_millis(50), places.take(who)).await {
            held.push(place.unwrap());
        }
        held
    }

    #[tokio::test]
    async fn a_tenant_leaves_half_of_the_places_to_others() {
        let (places, north, south) = (Places::new(), Who::named("north", "a"), Who::named("south", "b"));
        let held = all(&places, &north).await;
        assert_eq!(held.len(), PLACES / 2);
        let other = all(&places, &south).await;
        assert_eq!(other.len(), PLACES / 2);
        drop(held);
        assert_eq!(all(&places, &Who::named("north", "b")).await.len(), PLACES / 2, "they are free again");
    }

    #[tokio::test]
    async fn those_who_wait_get_the_next_place_in_turn() {
        let (places, north, south, west) =
            (Places::new(), Who::named("north", "a"), Who::named("south", "b"), Who::named("west", "c"));
        let (mut held, _other) = (all(&places, &north).await, all(&places, &south).await);
        let mut waiting = std::pin::pin!(places.take(&west));
        let mut own = std::pin::pin!(places.take_within(Duration::from_millis(300), &north));
        let moment = Duration::from_millis(50);
        assert!(tokio::time::timeout(moment, &mut own).await.is_err());
        assert!(tokio::time::timeout(moment, &mut waiting).await.is_err());
        held.pop();
        // The tenant that came later has held none so far.
        let first = waiting.await.unwrap();
        assert_eq!(first.who, west);
        let error = own.await.unwrap_err();
        assert!(matches!(error, ServiceError::Overloaded(_)), "{error}");
        let state = places.state();
        assert_eq!((state.taken, state.turns.held()), (PLACES, PLACES));
    }
}
