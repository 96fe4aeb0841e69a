//! Placements that a search for start points, directions and mirror images has found for the shapes of a cohort. The search
//! at a later revision may begin with them: few shapes are new, and the others hardly move.
//!
//! From the placements of the leading shapes the result is that of a search without them, as long as these shapes stay the first
//! ones. From the placements of all it may be another optimum.

use std::sync::Arc;

use serde::Serialize;

use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::{Correspondence, Direction, Mirror};
use crate::analysis::matching::Placement;
use crate::analysis::transformation::Transformation;
use crate::domain::filter::ShapeFilter;
use crate::service::app::App;
use crate::service::app::cache::Cached;
use crate::store::Places;

/// Settings on which a search depends besides the shapes of the cohort.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(crate) struct SearchSettings {
    pub(crate) transformation: Transformation,
    pub(crate) alignment: Alignment,
    pub(crate) correspondence: Correspondence,
    pub(crate) direction: Direction,
    pub(crate) mirror: Mirror,
    pub(crate) filter: ShapeFilter,
    pub(crate) robust: bool,
}

/// Placements of the shapes of a cohort at a revision.
#[derive(Debug)]
pub(crate) struct KnownPlacements {
    pub(crate) revision: u64,
    /// Revision of the placements with which the search began; `None` if it began with the shapes as given.
    pub(crate) started_from: Option<u64>,
    pub(crate) places: Places,
    pub(crate) placements: Vec<Placement>,
    /// Those of the leading shapes.
    pub(crate) leading: Vec<Placement>,
}

/// Which placements of an earlier search a search begins with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Which {
    /// Those of all shapes.
    All,
    /// Those of the leading shapes.
    Leading,
}

impl Cached for KnownPlacements {
    const NAME: &'static str = "placements";

    fn bytes(&self) -> usize {
        self.places.bytes() + size_of_val(self.placements.as_slice()) + size_of_val(self.leading.as_slice())
    }
}

impl KnownPlacements {
    /// The placements of the last search with these settings.
    pub(crate) fn find(app: &App, cohort: &str, settings: &SearchSettings) -> Option<Arc<Self>> {
        app.cache.find(cohort, settings)
    }

    /// Keeps the placements for later searches with these settings.
    pub(crate) fn keep(self, app: &App, cohort: &str, settings: &SearchSettings) {
        app.cache.keep(cohort, settings, &Arc::new(self));
    }

    /// Placements with which a search of the shapes at `places` begins. `None` if there are none that leave its result as it is.
    pub(crate) fn start(&self, which: Which, places: &Places) -> Option<Vec<Placement>> {
        match which {
            Which::All => Some(self.at(places)),
            Which::Leading => {
                let count = self.leading.len();
                // Without others, they would count as the placements of all.
                let is_part = count > 0 && places.count() > count;
                let stay = is_part && places.iter().take(count).eq(self.places.iter().take(count));
                stay.then(|| self.leading.clone())
            }
        }
    }

    /// Placements of the shapes at `places`; a shape that the search did not see stands as given.
    fn at(&self, places: &Places) -> Vec<Placement> {
        let mut known = self.places.iter().zip(&self.placements).peekable();
        let placement = |place| {
            while known.next_if(|(earlier, _)| *earlier < place).is_some() {}
            known.next_if(|(same, _)| *same == place).map_or_else(Placement::default, |(_, found)| *found)
        };
        places.iter().map(placement).collect()
    }
}
