//! Version 1 of the HTTP interface: a folder for each kind of resource.

pub mod administration;
pub(super) mod cohorts;
pub(super) mod dictionaries;
pub(super) mod files;
pub(super) mod geometry;
pub(super) mod inference;
pub(super) mod requests;
pub(super) mod segmentation;
pub(super) mod statistics;

use axum::Router;
use axum::routing::{MethodFilter, on};

use super::operation::{every_operation, pattern};
use super::{health, metrics};
use crate::service::app::App;
use administration::{audit, events, hooks, jobs, keys, settings, version};
use cohorts::{
    bulk, changes, corrections, correspond, exports, incomplete, matching, shapes, sheet, subjects, tables,
};
use dictionaries::{aliases, assessments, classify, coding, complete, drift, report, scatter};
use files::formats;
use geometry::{catalogue, curves, deform, fitting, morph, overlap, refine, subdivision, warp};
use inference::{
    blocks, comparisons, model_comparisons, models, predictions, regressions, repeatability, symmetry,
};
use segmentation::{contours, prior, segment, sheets};
use statistics::{matched, retrieval, sliding};

/// Makes the routes of each group, and the descriptions of them all.
macro_rules! routes {
    ($($group:ident {
        $($method:ident $path:literal $module:ident :: $handler:ident $row:tt;)*
    })*) => {
        $(pub(super) fn $group() -> Router<App> {
            Router::new()$(.route(pattern($path), on(MethodFilter::$method, $module::$handler)))*
        })*

        #[cfg(feature = "schema")]
        #[derive(utoipa::OpenApi)]
        #[openapi(paths($($($module::$handler),*),*))]
        pub(super) struct Paths;
    };
}
every_operation!(routes);
