//! Cohorts ready to be compared, kept while they are searched again and again: reading and preparing a small cohort takes
//! longer than comparing a shape with it.

use crate::analysis::distance::{DistanceSpace, PreparedShapes};
use crate::service::app::cache::Cached;

/// Bytes of one of them; larger ones are read anew by every search.
const MOST_BYTES_OF_ONE: usize = 64 << 20;

/// Bytes of an id in its list.
const ID_BYTES: usize = 64;

/// Shapes of a cohort ready to be compared, in the order of the cohort.
#[derive(Debug, Default)]
pub(crate) struct PreparedCohort {
    pub(crate) ids: Vec<String>,
    /// None when there are no shapes.
    pub(crate) shapes: Option<PreparedShapes>,
    bytes: usize,
}

impl PreparedCohort {
    /// An empty one for `count` shapes, unless they are too many to be kept.
    pub(crate) fn for_count(space: &DistanceSpace, count: usize) -> Option<Self> {
        let bytes = count.saturating_mul(space.bytes() + ID_BYTES);
        (bytes <= MOST_BYTES_OF_ONE).then(|| Self { bytes, ..Self::default() })
    }

    /// Adds the next shapes.
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
