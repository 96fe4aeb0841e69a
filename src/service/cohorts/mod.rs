//! Cohorts and their stored shapes.
//!
//! * [`catalogue`] — create, list, find and delete cohorts and shapes; [`trash`] — deleted objects that can be
//!   restored; [`changes`] — the feed;
//! * `rules` — correspondence, direction and mirror images changed;
//! * [`corrections`] — attributes of shapes changed, shapes deleted by a filter, subjects erased;
//! * [`bulk`] — attributes of many shapes changed at once;
//! * [`subjects`] — holdings of a subject;
//! * [`upload`] — streams of shapes into a cohort; [`upload_file`] — files of other programs; `placer` — their records as shapes;
//!   `arriving` — shapes on their way; [`fits`] — residuals of fits to meshes; [`preview`] — uploads told without storing;
//! * [`lengths`] — the unit of a cohort, and that of a file;
//! * [`pseudonyms`] — subjects of persons whom files identify;
//! * [`example`] — the example cohort of an empty store;
//! * [`source`] — shapes of a cohort at one revision, as a source for statistics; [`at_engine`] — passes over them, computed by a separate
//!   program;
//! * [`selection`] — control points of selected shapes, in the order of their descriptions;
//! * `measures` — measures of shapes that arrive; `directed` — which way stored curves run; `caveats` — warnings of everything that is computed
//!   of a selection;
//! * [`attributes`] — labels of shapes, addressed by their names in requests; `attribute_names` — how many names there may be;
//! * [`matching`] — which correspondence lies nearer;
//! * [`live_mean`] — mean of a cohort at its current revision; `placements` — where its search begins.

mod arriving;
pub mod at_engine;
mod attribute_names;
pub mod attributes;
pub mod bulk;
pub mod catalogue;
pub(crate) mod caveats;
pub mod changes;
pub mod corrections;
pub(crate) mod directed;
pub mod example;
pub mod fits;
pub mod lengths;
pub mod live_mean;
pub mod matching;
pub(crate) mod measures;
pub(crate) mod placements;
mod placer;
pub mod preview;
pub mod pseudonyms;
mod rules;
pub mod selection;
pub mod source;
pub mod subjects;
pub mod trash;
pub mod upload;
pub mod upload_file;
