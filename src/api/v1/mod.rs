//! Version 1 of the interface: one file per resource.

mod catalogue;
mod cohorts;
mod curves;
mod fitting;
mod morph;
mod settings;
mod shapes;
mod statistics;

use axum::response::Redirect;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::service::App;

/// Everything that answers within the request timeout.
pub(super) fn routes() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(catalogue::list_generators))
        .routes(routes!(catalogue::find_generator))
        .routes(routes!(catalogue::list_transformations))
        .routes(routes!(statistics::project))
        .routes(routes!(statistics::mean))
        .routes(routes!(statistics::align))
        .routes(routes!(statistics::pca))
        .routes(routes!(curves::evaluate))
        .routes(routes!(curves::measure))
        .routes(routes!(curves::resample))
        .routes(routes!(fitting::fit))
        .routes(routes!(fitting::refine))
        .routes(routes!(fitting::list_idealised, fitting::idealise))
        .routes(routes!(morph::morph))
        .routes(routes!(cohorts::list_cohorts, cohorts::create_cohort))
        .routes(routes!(cohorts::find_cohort, cohorts::delete_cohort))
        .routes(routes!(cohorts::cohort_mean))
        .routes(routes!(shapes::find_shape, shapes::delete_shape))
}

/// Uploads: they last as long as their stream flows.
pub(super) fn streamed_routes() -> OpenApiRouter<App> {
    OpenApiRouter::new().routes(routes!(shapes::list_shapes, shapes::add_shapes))
}

/// The root leads to the reference.
pub(super) async fn index() -> Redirect {
    Redirect::temporary("/docs/")
}
