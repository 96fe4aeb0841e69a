//! Cohorts in prepared form, cached for repeated searches: reading and preparing a small cohort takes longer than
//! comparing a shape with it.

use crate::analysis::distance::{DistanceSpace, PreparedShapes};
use crate::service::app::cache::Cached;

/// Maximum size of a cached cohort; larger ones are read again by every search.
const MAX_BYTES_OF_ONE: usize = 64 << 20;

/// Estimated size of an id in its list.
const ID_BYTES: usize = 64;

/// Prepared shapes of a cohort, in the order of the cohort.
#[derive(Debug, Default)]
pub(crate) struct PreparedCohort {
    pub(crate) ids: Vec<String>,
    /// `None` if there are no shapes.
    pub(crate) shapes: Option<PreparedShapes>,
    bytes: usize,
}

impl PreparedCohort {
    /// An empty value for `count` shapes; `None` if they are too many to be cached.
    pub(crate) fn for_count(space: &DistanceSpace, count: usize) -> Option<Self> {
        let bytes = count.saturating_mul(space.bytes() + ID_BYTES);
        (bytes <= MAX_BYTES_OF_ONE).then(|| Self { bytes, ..Self::default() })
    }

    /// Appends further shapes.
    pub(crate) fn append(&mut self, ids: &[String], more: PreparedShapes) {
        self.ids.extend_from_slice(ids);
        match &mut self.shapes {
            Some(shapes) => shapes.append(more),
            None => self.shapes = Some(more),
        }
    }
}

impl Cached for PreparedCohort {
    const NAME: &'static str = "cohorts";

    fn bytes(&self) -> usize {
        self.bytes
    }
}
