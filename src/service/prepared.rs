//! Cohorts ready to be compared, kept while they are searched again and again: reading and preparing a small cohort takes
//! longer than comparing a shape with it.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::distances::Comparison;
use crate::analysis::distance::{DistanceSpace, PreparedShapes};
use crate::domain::shape::ShapeFilter;

/// Bytes of all cohorts that are kept ready.
const MOST_BYTES: usize = 256 << 20;

/// Bytes of one of them; larger ones are read anew by every search.
const MOST_BYTES_OF_ONE: usize = 64 << 20;

/// Bytes of an id in its list.
const ID_BYTES: usize = 64;

/// Which shapes, and how they are compared.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Key {
    pub(super) cohort: String,
    pub(super) revision: u64,
    pub(super) filter: ShapeFilter,
    pub(super) comparison: Comparison,
}

/// Shapes of a cohort ready to be compared, in the order of the cohort.
#[derive(Debug, Default)]
pub(super) struct PreparedCohort {
    pub(super) ids: Vec<String>,
    /// None when there are no shapes.
    pub(super) shapes: Option<PreparedShapes>,
    bytes: usize,
}

impl PreparedCohort {
    /// An empty one for `count` shapes, unless they are too many to be kept.
    pub(super) fn for_count(space: &DistanceSpace, count: usize) -> Option<Self> {
        let bytes = count.saturating_mul(space.bytes() + ID_BYTES);
        (bytes <= MOST_BYTES_OF_ONE).then(|| Self { bytes, ..Self::default() })
    }

    /// Adds the next shapes.
    pub(super) fn append(&mut self, ids: &[String], more: PreparedShapes) {
        self.ids.extend_from_slice(ids);
        match &mut self.shapes {
            Some(shapes) => shapes.append(more),
            None => self.shapes = Some(more),
        }
    }
}

/// Cohorts that were searched lately, as far as there is room.
#[derive(Debug, Default)]
pub struct PreparedCache {
    entries: Mutex<VecDeque<(Key, Arc<PreparedCohort>)>>,
}

impl PreparedCache {
    fn locked(&self) -> MutexGuard<'_, VecDeque<(Key, Arc<PreparedCohort>)>> {
        self.entries.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn find(&self, key: &Key) -> Option<Arc<PreparedCohort>> {
        let mut entries = self.locked();
        let position = entries.iter().position(|(known, _)| known == key)?;
        let entry = entries.remove(position)?;
        let found = entry.1.clone();
        entries.push_back(entry);
        Some(found)
    }

    /// Keeps a cohort in place of its other revisions, and of those that were not searched for longest.
    pub(super) fn keep(&self, key: Key, cohort: PreparedCohort) {
        let mut entries = self.locked();
        let is_older = |known: &Key| known.cohort == key.cohort && known.revision < key.revision;
        entries.retain(|(known, _)| *known != key && !is_older(known));
        entries.push_back((key, Arc::new(cohort)));
        while entries.iter().map(|(_, cohort)| cohort.bytes).sum::<usize>() > MOST_BYTES {
            entries.pop_front();
        }
    }

    /// Forgets a cohort that was deleted.
    pub(super) fn forget(&self, cohort: &str) {
        self.locked().retain(|(known, _)| known.cohort != cohort);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analysis::alignment::Alignment;
    use crate::analysis::transformation::{ClassName, Transformation};

    fn key(cohort: &str, revision: u64) -> Key {
        let transformation = Transformation::Named(ClassName::Similarity);
        let comparison = Comparison { transformation, alignment: Alignment::Projection, mirror: None };
        Key { cohort: cohort.into(), revision, filter: ShapeFilter::default(), comparison }
    }

    fn of_bytes(bytes: usize) -> PreparedCohort {
        PreparedCohort { bytes, ..PreparedCohort::default() }
    }

    #[test]
    fn what_was_searched_last_is_kept_as_far_as_there_is_room() {
        let cache = PreparedCache::default();
        let has = |cohort: &str, revision| cache.find(&key(cohort, revision)).is_some();
        for cohort in ["a", "b", "c", "d"] {
            cache.keep(key(cohort, 1), of_bytes(MOST_BYTES / 4));
        }
        assert!(has("a", 1) && has("c", 1) && has("d", 1));
        cache.keep(key("e", 1), of_bytes(1));
        assert!(!has("b", 1) && has("a", 1) && has("e", 1));
        cache.keep(key("a", 2), of_bytes(1));
        assert!(!has("a", 1) && has("a", 2));
        let filtered =
            Key { filter: ShapeFilter { label: Some("x".into()), ..Default::default() }, ..key("a", 2) };
        assert!(cache.find(&filtered).is_none());
        cache.forget("a");
        assert!(!has("a", 2) && has("e", 1));
    }
}
