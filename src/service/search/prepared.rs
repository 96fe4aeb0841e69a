//! Cohorts in prepared form, cached for repeated searches: reading and preparing a cohort takes longer than comparing a
//! shape with it.

use crate::analysis::distance::{DistanceSpace, PreparedShapes};
use crate::service::app::cache::Cached;
use crate::store::Places;

/// Prepared shapes of a cohort, in the order of the cohort.
#[derive(Debug, Default)]
pub(crate) struct PreparedCohort {
    pub(crate) places: Places,
    /// `None` if there are no shapes.
    pub(crate) shapes: Option<PreparedShapes>,
    bytes: usize,
    count: usize,
}

impl PreparedCohort {
    /// Memory of the prepared shapes in bytes.
    pub(crate) fn bytes_for(space: &DistanceSpace, count: usize) -> usize {
        count.saturating_mul(space.bytes())
    }

    /// An empty value for `count` shapes.
    pub(crate) fn for_count(space: &DistanceSpace, count: usize) -> Self {
        Self { bytes: Self::bytes_for(space, count), count, ..Self::default() }
    }

    /// Appends further shapes.
    pub(crate) fn append(&mut self, places: &Places, mut more: PreparedShapes) {
        self.places.append(places);
        match &mut self.shapes {
            Some(shapes) => shapes.append(more),
            None => {
                more.reserve(self.count.saturating_sub(more.count()));
                self.shapes = Some(more);
            }
        }
    }
}

impl Cached for PreparedCohort {
    const NAME: &'static str = "cohorts";

    fn bytes(&self) -> usize {
        self.bytes
    }
}
