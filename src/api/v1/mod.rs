//! Version 1 of the HTTP interface: one file per resource.

mod aliases;
mod assessments;
mod audit;
mod batches;
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
mod morph;
mod overlap;
mod pictures;
mod planned;
mod prior;
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
mod tables;
mod version;

use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

use crate::service::app::App;

/// Routes that read or change stored objects and answer quickly.
pub(super) fn light_routes() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(audit::list_audit, audit::prune_audit))
        .routes(routes!(version::find_version))
        .routes(routes!(settings::find_settings))
        .routes(routes!(catalogue::list_generators))
        .routes(routes!(catalogue::find_generator))
        .routes(routes!(catalogue::list_transformations))
        .routes(routes!(formats::list_formats))
        .routes(routes!(cohorts::list_cohorts, cohorts::create_cohort))
        .routes(routes!(cohorts::find_cohort, cohorts::update_cohort, cohorts::delete_cohort))
        .routes(routes!(changes::list_changes))
        .routes(routes!(hooks::list_hooks, hooks::create_hook))
        .routes(routes!(hooks::find_hook, hooks::delete_hook))
        .routes(routes!(hooks::pause_hook))
        .routes(routes!(hooks::resume_hook))
        .routes(routes!(hooks::redeliver_hook))
        .routes(routes!(hooks::list_hook_failures))
        .routes(routes!(changes::list_trash))
        .routes(routes!(changes::restore_trashed))
        .routes(routes!(changes::remove_trashed))
        .routes(routes!(shapes::find_shape, corrections::update_shape, shapes::delete_shape))
        .routes(routes!(sheet::cohort_sheet))
        .routes(routes!(dictionaries::find_dictionary, dictionaries::delete_dictionary))
        .routes(routes!(aliases::list_aliases))
        .routes(routes!(aliases::find_alias, aliases::set_alias, aliases::delete_alias))
        .routes(routes!(dictionaries::dictionary_atoms))
        .routes(routes!(dictionaries::dictionary_mode))
        .routes(routes!(jobs::list_jobs))
        .routes(routes!(jobs::find_job))
        .routes(routes!(jobs::cancel_job))
}

/// Routes that compute, or that may wait for a job.
pub(super) fn computing_routes() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(statistics::project))
        .routes(routes!(statistics::mean))
        .routes(routes!(statistics::align))
        .routes(routes!(statistics::pca))
        .routes(routes!(incomplete::incomplete_pca))
        .routes(routes!(curves::evaluate))
        .routes(routes!(curves::measure))
        .routes(routes!(curves::resample))
        .routes(routes!(fitting::fit))
        .routes(routes!(fitting::refine))
        .routes(routes!(fitting::list_idealised, fitting::idealise))
        .routes(routes!(morph::morph))
        .routes(routes!(deform::deform))
        .routes(routes!(subdivision::subdivide))
        .routes(routes!(overlap::overlap))
        .routes(routes!(contours::contours))
        .routes(routes!(prior::prior_of_reference))
        .routes(routes!(segment::segment))
        .routes(routes!(segment::segment_into_cohort))
        .routes(routes!(sheets::detect_sheets))
        .routes(routes!(cohorts::cohort_mean))
        .routes(routes!(corrections::erase_subject))
        .routes(routes!(retrieval::search_cohort))
        .routes(routes!(retrieval::compute_distances))
        .routes(routes!(dictionaries::list_dictionaries, dictionaries::learn_dictionary))
        .routes(routes!(drift::dictionary_drift))
        .routes(routes!(dictionaries::export_dictionary))
        .routes(routes!(dictionaries::import_dictionary))
        .routes(routes!(classify::classify))
        .routes(routes!(classify::assess))
        .routes(routes!(assessments::assess_cohort))
        .routes(routes!(assessments::list_assessments))
        .routes(routes!(coding::encode))
        .routes(routes!(coding::reconstruct))
        .routes(routes!(coding::score))
        .routes(routes!(correspond::correspond_cohort))
        .routes(routes!(correspond::correspond_shapes))
        .routes(routes!(coding::prior))
        .routes(routes!(coding::sample))
        .routes(routes!(report::dictionary_report))
        .routes(routes!(complete::complete))
        .routes(routes!(comparisons::compare))
        .routes(routes!(regressions::regress))
        .routes(routes!(retrieval::job_output))
        .routes(routes!(tables::list_attributes))
        .routes(routes!(tables::find_table, tables::compute_table))
        .routes(routes!(keys::list_keys, keys::create_key))
        .routes(routes!(keys::find_key, keys::revoke_key))
}

/// Routes that last as long as their stream: uploads, files and events.
pub(super) fn streamed_routes() -> OpenApiRouter<App> {
    OpenApiRouter::new()
        .routes(routes!(shapes::list_shapes, shapes::add_shapes, corrections::delete_shapes))
        .routes(routes!(files::inspect_file))
        .routes(routes!(files::convert_file))
        .routes(routes!(exports::export_cohort))
        .routes(routes!(jobs::job_events))
        .routes(routes!(events::list_events))
}
