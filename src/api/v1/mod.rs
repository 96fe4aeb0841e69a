//! Version 1 of the HTTP interface: one file per resource.

mod aliases;
mod assessments;
mod audit;
mod batches;
mod bulk;
mod catalogue;
mod changes;
mod classify;
mod coding;
mod cohorts;
mod comparisons;
mod complete;
mod contours;
mod corrections;
mod correspond;
mod curves;
mod deform;
#[cfg(feature = "schema")]
mod described;
mod dictionaries;
mod drift;
mod entity_tags;
mod events;
mod exports;
mod file_parameters;
pub(super) mod files;
mod fitting;
mod formats;
mod hooks;
mod incomplete;
pub mod jobs;
mod keys;
mod matching;
mod morph;
mod overlap;
mod pictures;
mod planned;
mod previews;
mod prior;
mod refine;
mod regressions;
mod report;
mod request_macros;
mod retrieval;
mod segment;
mod series;
mod settings;
mod shape_query;
mod shapes;
mod sheet;
mod sheets;
mod statistics;
mod subdivision;
mod subjects;
mod tables;
mod version;

use axum::Router;
use axum::routing::{MethodFilter, on};

use super::operation::{every_operation, pattern};
use super::{health, metrics};
use crate::service::app::App;

/// Makes the routes of each group, and what describes them all.
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
