//! Settings of the running service, for administrators.

use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use crate::api::extract::NoQuery;
use crate::api::problem::Problem;
use crate::api::respond::json;
use crate::service::access::is_open;
use crate::service::app::{App, Limits};

/// Settings of the running service.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct SettingsOutput {
    /// Who is let in.
    access: AccessOutput,
    /// Limits on requests, data, jobs, memory and rates.
    limits: Vec<LimitInForce>,
}

/// Who is let in.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct AccessOutput {
    /// Whether requests need no credential, as on a loopback address without keys and identity provider.
    open: bool,
    /// Issuer of the tokens that are accepted; null without an identity provider.
    token_issuer: Option<String>,
    /// Whether people can log in on the page by the identity provider.
    page_login: bool,
    /// Origins whose pages may read answers in a browser.
    allowed_origins: Vec<String>,
    /// Whether the metrics are readable without a credential.
    metrics_open: bool,
}

/// A limit in force.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct LimitInForce {
    /// Name of the setting, as in a configuration file; the flag is the same with `--` and hyphens.
    #[schema(example = "max_body_bytes")]
    name: &'static str,
    /// Value in force: where the setting is 0 for a part of the memory, that part. Null if there is no limit.
    value: Option<u64>,
    /// Unit of the value.
    unit: LimitUnit,
}

/// Unit of a limit.
#[derive(Debug, Clone, Copy, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
enum LimitUnit {
    /// Bytes.
    Bytes,
    /// Seconds.
    Seconds,
    /// A number of things.
    Count,
}

/// Returns the settings of the running service.
#[utoipa::path(get, path = "/v1/settings", tag = "operation", responses(
    (status = 200, description = "Settings of the running service", body = SettingsOutput),
    (status = 400, description = "An unknown parameter"),
    (status = 503, description = "The store cannot be read")
))]
pub(in crate::api::v1) async fn find_settings(
    State(app): State<App>,
    _: NoQuery,
) -> Result<Response, Problem> {
    let access = AccessOutput {
        open: is_open(&app).await?,
        token_issuer: app.token_issuer(),
        page_login: app.login().is_some(),
        allowed_origins: app.allowed_origins(),
        metrics_open: app.metrics_are_open(),
    };
    let settings = SettingsOutput { access, limits: in_force(&app.limits) };
    Ok(json(StatusCode::OK, &settings)?)
}

/// The limits that can be set, in the order of the configuration.
fn in_force(limits: &Limits) -> Vec<LimitInForce> {
    let number = |count: usize| u64::try_from(count).ok();
    let bytes = |name, size: usize| LimitInForce { name, value: number(size), unit: LimitUnit::Bytes };
    let count = |name, count: usize| LimitInForce { name, value: number(count), unit: LimitUnit::Count };
    let seconds = |name, time: std::time::Duration| LimitInForce {
        name,
        value: Some(time.as_secs()),
        unit: LimitUnit::Seconds,
    };
    // Of these 0 means that there is none.
    let rate = |name, rate: u32| LimitInForce {
        name,
        value: (rate > 0).then_some(u64::from(rate)),
        unit: LimitUnit::Count,
    };
    let burst = match limits.rate_burst {
        0 => limits.rate_per_second.saturating_mul(2),
        given => given,
    };
    vec![
        bytes("max_body_bytes", limits.body_bytes),
        bytes("max_image_bytes", limits.image_bytes),
        count("max_voxels", limits.voxels),
        bytes("max_line_bytes", limits.line_bytes),
        count("max_json_values", limits.json_values),
        count("max_compression_ratio", limits.compression_ratio),
        bytes("max_metadata_bytes", limits.metadata_bytes),
        count("max_shapes", limits.shapes),
        count("max_points", limits.points),
        count("max_mesh_vertices", limits.vertices),
        count("max_control_points", limits.control_points),
        count("max_atoms", limits.atoms),
        bytes("max_job_bytes", limits.job_bytes),
        bytes("max_matrix_bytes", limits.matrix_bytes),
        count("max_matrix_operations", limits.matrix_operations),
        count("max_search_operations", limits.search_operations),
        seconds("max_request_seconds", limits.request_work),
        seconds("light_seconds", limits.light_time),
        seconds("compute_seconds", limits.compute_time),
        seconds("max_job_seconds", limits.job_time),
        count("max_queued_jobs", limits.queued_jobs as usize),
        seconds("max_queued_seconds", limits.queued_work),
        seconds("cache_seconds", limits.cache_time),
        bytes("max_buffered_bytes", limits.buffered_bytes),
        bytes("max_answer_bytes", limits.answer_bytes),
        rate("rate_per_second", limits.rate_per_second),
        rate("rate_burst", burst),
        rate("refusals_per_minute", limits.refusals_per_minute),
    ]
}
