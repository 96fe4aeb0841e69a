//! Versions that names of dictionaries mean, kept while nothing is written.
//!
//! Requests that name a dictionary ask for its version first, and the database answers on another thread. The process that owns the
//! folder of an embedded database sees every change but those of commands beside it, which are noticed within [`TERM`].

use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Time for which a name is believed.
const TERM: Duration = Duration::from_secs(1);
/// Number of names that are kept.
const MOST: usize = 1024;

/// Number of transactions that have changed something.
#[derive(Debug, Clone, Default)]
pub(super) struct Writes(Arc<AtomicU64>);

impl Writes {
    /// Counts a transaction, after it was committed.
    pub(super) fn count(&self) {
        self.0.fetch_add(1, Ordering::AcqRel);
    }

    /// The number so far.
    pub(super) fn now(&self) -> u64 {
        self.0.load(Ordering::Acquire)
    }
}

/// Ids by tenant and key.
#[derive(Debug, Default)]
pub(super) struct KnownNames(Mutex<HashMap<(String, String), Known>>);

#[derive(Debug)]
struct Known {
    id: String,
    /// Number of writes before it was read.
    writes: u64,
    read: Instant,
}

impl KnownNames {
    fn locked(&self) -> MutexGuard<'_, HashMap<(String, String), Known>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The id that a key means, if it was read after the last of so many `writes`.
    pub(super) fn find(&self, tenant: &str, key: &str, writes: u64) -> Option<String> {
        let known = self.locked();
        let known = known.get(&(tenant.to_owned(), key.to_owned()))?;
        (known.writes == writes && known.read.elapsed() < TERM).then(|| known.id.clone())
    }

    /// Keeps the id that a key means, read after so many `writes`.
    pub(super) fn keep(&self, tenant: &str, key: &str, writes: u64, id: &str) {
        let mut known = self.locked();
        if known.len() >= MOST {
            known.clear();
        }
        let entry = Known { id: id.to_owned(), writes, read: Instant::now() };
        known.insert((tenant.to_owned(), key.to_owned()), entry);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_known_until_something_is_written() {
        let (names, writes) = (KnownNames::default(), Writes::default());
        let before = writes.now();
        names.keep("a", "cells", before, "dic_1");
        assert_eq!(names.find("a", "cells", writes.now()).as_deref(), Some("dic_1"));
        assert_eq!(names.find("b", "cells", writes.now()), None);
        writes.count();
        assert_eq!(names.find("a", "cells", writes.now()), None);
        // Values read before a write are not believed after it.
        names.keep("a", "cells", before, "dic_1");
        assert_eq!(names.find("a", "cells", writes.now()), None);
        (0..=MOST).for_each(|k| names.keep("a", &k.to_string(), 1, "dic_2"));
        assert!(names.locked().len() <= MOST);
    }
}
