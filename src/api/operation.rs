//! The operations of the interface: one row for each, from which its route, the access that it requires, its tables, the
//! formats offered to `Accept` and its name in the audit trail follow. A test compares the rows with the OpenAPI document.

use std::collections::HashMap;
use std::sync::LazyLock;

use crate::domain::access::Role;
use crate::wire::columns::ANSWER;

/// Access that an operation requires.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Needs {
    /// None: open to everyone.
    Nothing,
    /// At least this role.
    Role(Role),
}

/// An operation of the interface.
#[derive(Debug)]
pub struct Operation {
    /// Method; `HEAD` is answered by the handler of `GET`.
    pub method: &'static str,
    /// Template of its route.
    pub path: &'static str,
    /// Name: that of its handler.
    pub id: &'static str,
    /// Access that it requires.
    pub needs: Needs,
    /// Media types of its successful answers, without those of tables; [`ANY_FILE`] stands for every format that is written.
    pub answers: &'static [&'static str],
    /// If its answers are also tables: the list that is the table unless the query names another one.
    pub table: Option<&'static str>,
}

impl Operation {
    /// The media type of its successful answers, if there is a single one besides those of tables.
    pub fn only_answer(&self) -> Option<&'static str> {
        match self.answers {
            [only] if *only != ANY_FILE => Some(only),
            _ => None,
        }
    }

    /// Whether its answers may be CSV.
    pub fn may_be_csv(&self) -> bool {
        self.table.is_some() || self.answers.iter().any(|answer| [CSV, ANY_FILE].contains(answer))
    }
}

/// Media type that says nothing of a file.
pub const ANY_FILE: &str = "application/octet-stream";
const ARROW: &str = "application/vnd.apache.arrow.stream";
const CSV: &str = "text/csv";
const JSON: &str = "application/json";
const NDJSON: &str = "application/x-ndjson";
const NIFTI: &str = "application/x-nifti";
const NPY: &str = "application/x-npy";
const PARQUET: &str = "application/vnd.apache.parquet";
const PNG: &str = "image/png";
const SVG: &str = "image/svg+xml";

// Media types that several operations offer.
const EMPTY: &[&str] = &[];
const EVENTS: &[&str] = &["text/event-stream"];
const FILE: &[&str] = &[ANY_FILE];
const PLAIN: &[&str] = &[JSON];
/// Of results one by one.
const LINES: &[&str] = &[JSON, NDJSON];
/// Of answers that can be drawn.
const DRAWN: &[&str] = &[JSON, SVG, PNG];
/// Of answers that can be drawn, and are surfaces.
const MODEL: &[&str] = &[JSON, SVG, PNG, "model/obj", "application/ply", "model/stl", "model/gltf-binary"];
const METRICS: &[&str] = &["text/plain; version=0.0.4"];
/// Of answers that are tables in the first place.
const TABLE: &[&str] = &[JSON, NDJSON, CSV, ARROW, PARQUET];
/// Of a job: whatever it made.
const OUTPUT: &[&str] = &[JSON, NDJSON, SVG, PNG, CSV, ARROW, PARQUET, NPY, NIFTI];

const OPEN: Needs = Needs::Nothing;
/// Reads, or computes without storing, perhaps by a job, which the caller may cancel.
const READER: Needs = Needs::Role(Role::Reader);
/// Stores, and cancels jobs of others.
const WRITER: Needs = Needs::Role(Role::Writer);
/// Manages keys and hooks, or makes changes that cannot be undone.
const ADMIN: Needs = Needs::Role(Role::Admin);

/// Passes the rows to a macro: method, route, handler, then in parentheses the access, the media types and perhaps the table. The
/// groups differ in their layers.
macro_rules! every_operation {
    ($then:ident) => {
        $then! {
            // Reads or changes stored objects and answers quickly.
            light {
                GET "/metrics" metrics::read_metrics (READER, METRICS);
                GET "/v1/audit" audit::list_audit (ADMIN, LINES);
                DELETE "/v1/audit" audit::prune_audit (ADMIN, PLAIN);
                GET "/v1/version" version::find_version (READER, PLAIN);
                GET "/v1/settings" settings::find_settings (ADMIN, PLAIN);
                GET "/v1/generators" catalogue::list_generators (READER, PLAIN);
                GET "/v1/generators/{name}" catalogue::find_generator (READER, DRAWN, ANSWER);
                GET "/v1/transformations" catalogue::list_transformations (READER, PLAIN);
                GET "/v1/formats" formats::list_formats (READER, PLAIN);
                GET "/v1/cohorts" cohorts::list_cohorts (READER, PLAIN);
                POST "/v1/cohorts" cohorts::create_cohort (WRITER, PLAIN);
                GET "/v1/cohorts/{cohort}" cohorts::find_cohort (READER, PLAIN);
                PATCH "/v1/cohorts/{cohort}" cohorts::update_cohort (WRITER, PLAIN);
                DELETE "/v1/cohorts/{cohort}" cohorts::delete_cohort (WRITER, EMPTY);
                GET "/v1/changes" changes::list_changes (READER, PLAIN);
                GET "/v1/hooks" hooks::list_hooks (ADMIN, PLAIN);
                POST "/v1/hooks" hooks::create_hook (ADMIN, PLAIN);
                GET "/v1/hooks/{hook}" hooks::find_hook (ADMIN, PLAIN);
                DELETE "/v1/hooks/{hook}" hooks::delete_hook (ADMIN, EMPTY);
                POST "/v1/hooks/{hook}/pause" hooks::pause_hook (ADMIN, PLAIN);
                POST "/v1/hooks/{hook}/resume" hooks::resume_hook (ADMIN, PLAIN);
                POST "/v1/hooks/{hook}/redeliver" hooks::redeliver_hook (ADMIN, PLAIN);
                GET "/v1/hooks/{hook}/failures" hooks::list_hook_failures (ADMIN, PLAIN);
                GET "/v1/trash" changes::list_trash (READER, PLAIN);
                POST "/v1/trash/{id}/restore" changes::restore_trashed (WRITER, EMPTY);
                DELETE "/v1/trash/{id}" changes::remove_trashed (ADMIN, EMPTY);
                GET "/v1/cohorts/{cohort}/shapes/{shape}" shapes::find_shape (READER, MODEL, ANSWER);
                PATCH "/v1/cohorts/{cohort}/shapes/{shape}" corrections::update_shape (WRITER, PLAIN);
                DELETE "/v1/cohorts/{cohort}/shapes/{shape}" shapes::delete_shape (WRITER, EMPTY);
                GET "/v1/cohorts/{cohort}/sheet" sheet::cohort_sheet (READER, &[SVG, PNG]);
                GET "/v1/dictionaries/{dictionary}" dictionaries::find_dictionary (READER, PLAIN, ANSWER);
                DELETE "/v1/dictionaries/{dictionary}" dictionaries::delete_dictionary (WRITER, EMPTY);
                GET "/v1/dictionaries/{dictionary}/aliases" aliases::list_aliases (READER, PLAIN);
                GET "/v1/dictionaries/{dictionary}/aliases/{alias}" aliases::find_alias (READER, PLAIN);
                PUT "/v1/dictionaries/{dictionary}/aliases/{alias}" aliases::set_alias (WRITER, PLAIN);
                DELETE "/v1/dictionaries/{dictionary}/aliases/{alias}" aliases::delete_alias (WRITER, EMPTY);
                GET "/v1/dictionaries/{dictionary}/atoms" dictionaries::dictionary_atoms (READER, DRAWN, "atoms");
                GET "/v1/dictionaries/{dictionary}/modes" dictionaries::dictionary_mode (READER, MODEL, ANSWER);
                GET "/v1/jobs" jobs::list_jobs (READER, PLAIN);
                GET "/v1/jobs/{job}" jobs::find_job (READER, PLAIN);
                POST "/v1/jobs/{job}/cancel" jobs::cancel_job (READER, PLAIN);
            }
            // Computes, or may wait for a job.
            computing {
                POST "/v1/project" statistics::project (READER, LINES, "results");
                POST "/v1/mean" statistics::mean (READER, MODEL, ANSWER);
                POST "/v1/align" statistics::align (READER, DRAWN, "aligned");
                POST "/v1/pca" statistics::pca (READER, DRAWN, "pca.scores");
                POST "/v1/slide" sliding::slide (READER, PLAIN, "shapes");
                POST "/v1/pca/incomplete" incomplete::incomplete_pca (READER, PLAIN, "pca.scores");
                POST "/v1/evaluate" curves::evaluate (READER, MODEL, "evaluations");
                POST "/v1/measure" curves::measure (READER, LINES, "results");
                POST "/v1/resample" curves::resample (READER, PLAIN, "shapes");
                POST "/v1/fit" fitting::fit (READER, LINES, "results");
                POST "/v1/refine" refine::refine (READER, PLAIN, "shapes");
                GET "/v1/idealised" fitting::list_idealised (READER, PLAIN);
                POST "/v1/idealised" fitting::idealise (READER, PLAIN, "shapes");
                POST "/v1/morph" morph::morph (READER, MODEL, "frames");
                POST "/v1/deform" deform::deform (READER, PLAIN, ANSWER);
                POST "/v1/subdivide" subdivision::subdivide (READER, MODEL, ANSWER);
                POST "/v1/overlap" overlap::overlap (READER, PLAIN, ANSWER);
                POST "/v1/warp" warp::warp (READER, DRAWN, ANSWER);
                POST "/v1/contours" contours::contours (READER, PLAIN, "results");
                POST "/v1/prior" prior::prior_of_reference (READER, LINES, "results");
                POST "/v1/segment" segment::segment (READER, &[JSON, SVG, PNG, NIFTI], "results");
                POST "/v1/cohorts/{cohort}/segment" segment::segment_into_cohort (WRITER, PLAIN, "results");
                POST "/v1/sheets" sheets::detect_sheets (READER, &[PNG, NIFTI]);
                GET "/v1/cohorts/{cohort}/mean" cohorts::cohort_mean (READER, MODEL, ANSWER);
                GET "/v1/subjects/{subject}" subjects::find_subject (READER, PLAIN, "items");
                DELETE "/v1/subjects/{subject}" corrections::erase_subject (ADMIN, PLAIN);
                POST "/v1/cohorts/{cohort}/search" retrieval::search_cohort (READER, DRAWN, "results.neighbours");
                POST "/v1/distances" retrieval::compute_distances (READER, &[JSON, CSV, ARROW, PARQUET, NPY]);
                POST "/v1/match" matched::match_curves (READER, DRAWN, ANSWER);
                GET "/v1/dictionaries" dictionaries::list_dictionaries (READER, PLAIN);
                POST "/v1/dictionaries" dictionaries::learn_dictionary (WRITER, PLAIN);
                GET "/v1/dictionaries/{dictionary}/drift" drift::dictionary_drift (READER, DRAWN, "scores");
                GET "/v1/dictionaries/{dictionary}/export" dictionaries::export_dictionary (READER, PLAIN);
                POST "/v1/dictionaries/import" dictionaries::import_dictionary (WRITER, PLAIN);
                POST "/v1/dictionaries/{dictionary}/classify" classify::classify (READER, LINES, "results");
                POST "/v1/dictionaries/{dictionary}/assess" classify::assess (READER, &[JSON, NDJSON, SVG, PNG], "results");
                POST "/v1/dictionaries/{dictionary}/assessments" assessments::assess_cohort (WRITER, LINES);
                GET "/v1/cohorts/{cohort}/assessments" assessments::list_assessments (READER, PLAIN, "items");
                POST "/v1/dictionaries/{dictionary}/encode" coding::encode (READER, LINES, "results");
                POST "/v1/dictionaries/{dictionary}/reconstruct" coding::reconstruct (READER, &[JSON, NDJSON, SVG, PNG], "results");
                POST "/v1/dictionaries/{dictionary}/score" coding::score (READER, LINES, "results");
                POST "/v1/cohorts/{cohort}/matching" matching::match_cohort (READER, PLAIN, "matchings");
                POST "/v1/cohorts/{cohort}/correspond" correspond::correspond_cohort (WRITER, PLAIN, "shapes");
                POST "/v1/dictionaries/{dictionary}/correspond" correspond::correspond_shapes (READER, LINES, "results");
                POST "/v1/dictionaries/{dictionary}/prior" coding::prior (READER, LINES, "results");
                POST "/v1/dictionaries/{dictionary}/sample" coding::sample (READER, PLAIN, "shapes");
                POST "/v1/dictionaries/{dictionary}/report" report::dictionary_report (READER, DRAWN, "modes");
                POST "/v1/dictionaries/{dictionary}/complete" complete::complete (READER, DRAWN, "results");
                POST "/v1/comparisons" comparisons::compare (READER, DRAWN, "pairs");
                POST "/v1/regressions" regressions::regress (READER, DRAWN, "scores");
                POST "/v1/models" models::model (READER, DRAWN, "terms");
                POST "/v1/models/compare" model_comparisons::compare_models (READER, DRAWN, "terms");
                GET "/v1/models/{job}/predictions" predictions::find_prediction (READER, DRAWN, "predictions");
                POST "/v1/models/{job}/predictions" predictions::predict (READER, DRAWN, "predictions");
                POST "/v1/repeatability" repeatability::repeatability (READER, DRAWN, "map");
                POST "/v1/two-blocks" blocks::two_blocks (READER, DRAWN, "scores");
                POST "/v1/modularity" blocks::modularity (READER, DRAWN, "pairs");
                POST "/v1/symmetry" symmetry::symmetry (READER, DRAWN, "individuals");
                GET "/v1/jobs/{job}/output" retrieval::job_output (READER, OUTPUT);
                GET "/v1/cohorts/{cohort}/attributes" tables::list_attributes (READER, PLAIN, "items");
                GET "/v1/dictionaries/{dictionary}/scatter" scatter::dictionary_scatter (READER, &[SVG, PNG]);
                GET "/v1/cohorts/{cohort}/table" tables::find_table (READER, TABLE);
                POST "/v1/cohorts/{cohort}/table" tables::compute_table (READER, TABLE);
                GET "/v1/keys" keys::list_keys (ADMIN, PLAIN);
                POST "/v1/keys" keys::create_key (ADMIN, PLAIN);
                GET "/v1/keys/{key}" keys::find_key (ADMIN, PLAIN);
                DELETE "/v1/keys/{key}" keys::revoke_key (ADMIN, EMPTY);
            }
            // Lasts as long as its stream: uploads, files and events.
            streamed {
                GET "/v1/cohorts/{cohort}/shapes" shapes::list_shapes (READER, &[JSON, ANY_FILE]);
                POST "/v1/cohorts/{cohort}/shapes" shapes::add_shapes (WRITER, PLAIN);
                PATCH "/v1/cohorts/{cohort}/shapes" bulk::update_shapes (WRITER, PLAIN);
                DELETE "/v1/cohorts/{cohort}/shapes" corrections::delete_shapes (WRITER, PLAIN);
                POST "/v1/cohorts/{cohort}/attributes" bulk::set_attributes (WRITER, PLAIN);
                POST "/v1/inspect" files::inspect_file (READER, PLAIN);
                POST "/v1/convert" files::convert_file (READER, FILE);
                GET "/v1/cohorts/{cohort}/export" exports::export_cohort (READER, FILE);
                GET "/v1/jobs/{job}/events" jobs::job_events (READER, EVENTS);
                GET "/v1/events" events::list_events (READER, EVENTS);
            }
            // Is open to everyone and has no rate limit.
            probes {
                GET "/livez" health::live (OPEN, EMPTY);
                GET "/readyz" health::ready (OPEN, EMPTY);
            }
        }
    };
}
pub(super) use every_operation;

macro_rules! table {
    () => {
        None
    };
    ($table:expr) => {
        Some($table)
    };
}

macro_rules! records {
    ($($group:ident {
        $($method:ident $path:literal $module:ident :: $handler:ident
            ($needs:ident, $answers:expr $(, $table:expr)?);)*
    })*) => {
        /// All operations.
        pub static OPERATIONS: &[Operation] = &[$($(Operation {
            method: stringify!($method),
            path: $path,
            id: stringify!($handler),
            needs: $needs,
            answers: $answers,
            table: table!($($table)?),
        },)*)*];
    };
}
every_operation!(records);

/// Route of a shape, and how it is matched: its id is all that follows, slashes included, since ids of shapes from files have some. There is
/// no route below that of a shape.
const SHAPE: &str = "/v1/cohorts/{cohort}/shapes/{shape}";
const SHAPE_MATCHED: &str = "/v1/cohorts/{cohort}/shapes/{*shape}";

/// The pattern by which requests are matched to a route.
pub fn pattern(route: &'static str) -> &'static str {
    if route == SHAPE { SHAPE_MATCHED } else { route }
}

/// The route whose pattern was matched.
pub fn route_of(pattern: &str) -> &str {
    if pattern == SHAPE_MATCHED { SHAPE } else { pattern }
}

static BY_ROUTE: LazyLock<HashMap<(&str, &str), &Operation>> = LazyLock::new(|| {
    OPERATIONS.iter().map(|operation| ((operation.method, operation.path), operation)).collect()
});

/// The operation of a method on a route template.
pub fn find(method: &str, route: &str) -> Option<&'static Operation> {
    let method = if method == "HEAD" { "GET" } else { method };
    BY_ROUTE.get(&(method, route)).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_operation_is_listed_once() {
        assert_eq!(BY_ROUTE.len(), OPERATIONS.len());
        let id = |method, route| find(method, route).map(|operation| operation.id);
        assert_eq!(id("GET", "/v1/cohorts/{cohort}"), Some("find_cohort"));
        assert_eq!(id("HEAD", "/v1/cohorts/{cohort}"), Some("find_cohort"));
        assert_eq!(id("DELETE", "/v1/cohorts/{cohort}"), Some("delete_cohort"));
        assert_eq!(id("PUT", "/v1/cohorts/{cohort}"), None);
    }

    #[test]
    fn operations_offer_the_media_type_of_their_answers() {
        let offered = |method, route| find(method, route).and_then(Operation::only_answer);
        assert_eq!(offered("GET", "/v1/cohorts"), Some("application/json"));
        assert_eq!(offered("GET", "/v1/cohorts/{cohort}/shapes"), None, "several");
        assert_eq!(offered("GET", "/v1/cohorts/{cohort}/export"), None, "any file");
        assert_eq!(offered("GET", "/metrics"), Some("text/plain; version=0.0.4"));
        assert_eq!(offered("DELETE", "/v1/cohorts/{cohort}"), None, "no answer");
        assert_eq!(offered("GET", "/v1/cohorts/{cohort}/mean"), None, "several");
    }
}
