//! Shares of callers: how much of a thing that lasts each of them has at once.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::domain::access::Caller;

/// Number of places that each caller holds.
#[derive(Debug, Default)]
pub struct Shares(Mutex<HashMap<Caller, usize>>);

impl Shares {
    /// A place for the caller; `None` if it holds `most`.
    pub fn take(self: &Arc<Self>, caller: Caller, most: usize) -> Option<Share> {
        let mut held = self.locked();
        let count = held.get(&caller).copied().unwrap_or_default();
        if count >= most {
            return None;
        }
        held.insert(caller.clone(), count + 1);
        drop(held);
        Some(Share { shares: Arc::clone(self), caller })
    }

    fn locked(&self) -> MutexGuard<'_, HashMap<Caller, usize>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A place of a caller, free again when it is dropped.
#[derive(Debug)]
pub struct Share {
    shares: Arc<Shares>,
    caller: Caller,
}

impl Drop for Share {
    fn drop(&mut self) {
        let mut held = self.shares.locked();
        if let Some(count) = held.get_mut(&self.caller) {
            *count -= 1;
            if *count == 0 {
                held.remove(&self.caller);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_counted_for_its_caller_until_it_is_dropped() {
        let shares = Arc::new(Shares::default());
        let caller = |name: &str| Caller { tenant: "a".into(), name: name.into() };
        let held = [shares.take(caller("x"), 2).unwrap(), shares.take(caller("x"), 2).unwrap()];
        assert!(shares.take(caller("x"), 2).is_none());
        let other = shares.take(caller("y"), 2).unwrap();
        drop(held);
        assert!(shares.take(caller("x"), 2).is_some());
        drop(other);
        assert!(shares.locked().is_empty(), "callers without a place are forgotten");
    }
}
