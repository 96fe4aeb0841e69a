//! The dashboard and the reference of the interface: pages and their assets, which are part of the program. They are public, hold no
//! data, and ask the API for everything with the key of their user. Their source is in `dashboard/`, their build in `dashboard/dist`.

use std::sync::LazyLock;

use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use axum::{Json, Router};
use serde::Serialize;

use super::caching::NO_STORE;
use super::problem::{Problem, ProblemKind};
use crate::service::access::login::Login;
use crate::service::app::App;

/// The page, whose address the script reads.
const PAGE: &str = "index.html";

/// The page that shows `/openapi.json`.
const REFERENCE: &str = "docs.html";

/// Paths below `/`, and contents.
const FILES: &[(&str, &[u8])] = &include!(concat!(env!("OUT_DIR"), "/dashboard.rs"));

/// The entity tags of the files, in their order.
static TAGS: LazyLock<Vec<String>> = LazyLock::new(|| {
    FILES.iter().map(|(_, bytes)| format!("\"{}\"", &blake3::hash(bytes).to_hex()[..32])).collect()
});

/// Whether the dashboard is at this address.
pub(super) fn is_view(path: &str) -> bool {
    matches!(path, "/" | "/app") || path.starts_with("/app/")
}

/// Whether the reference is at this address.
pub(super) fn is_reference(path: &str) -> bool {
    matches!(path, "/docs" | "/docs/")
}

/// Routes of the pages and their assets.
pub(super) fn routes() -> Router<App> {
    Router::new()
        .route("/", get(page))
        .route("/app", get(page))
        .route("/app/login.json", get(login))
        .route("/app/{*view}", get(page))
        .route("/docs", get(reference))
        .route("/docs/", get(reference))
        .route("/assets/{file}", get(asset))
}

async fn page(headers: HeaderMap) -> Result<Response, Problem> {
    answer(PAGE, "no-cache", &headers)
}

async fn reference(headers: HeaderMap) -> Result<Response, Problem> {
    answer(REFERENCE, "no-cache", &headers)
}

/// How people log in on the page.
#[derive(Debug, Serialize)]
struct LoginOutput {
    /// The identity provider that sends them back with a token; null if there is none, or the page is not known to it.
    provider: Option<Login>,
}

/// Browsers ask for it before they have a key, as for the page.
async fn login(State(app): State<App>) -> impl IntoResponse {
    ([(header::CACHE_CONTROL, NO_STORE)], Json(LoginOutput { provider: app.login() }))
}

/// Names of assets contain a digest of their content.
async fn asset(Path(file): Path<String>, headers: HeaderMap) -> Result<Response, Problem> {
    answer(&format!("assets/{file}"), "public, max-age=31536000, immutable", &headers)
}

fn answer(path: &str, caching: &'static str, headers: &HeaderMap) -> Result<Response, Problem> {
    let index = FILES
        .iter()
        .position(|(name, _)| *name == path)
        .ok_or_else(|| Problem::new(ProblemKind::RouteNotFound, format!("no route at /{path}")))?;
    let tag = TAGS[index].as_str();
    let about = [(header::ETAG, tag), (header::CACHE_CONTROL, caching)];
    let known = headers.get_all(header::IF_NONE_MATCH).iter().filter_map(|value| value.to_str().ok());
    if known.flat_map(|value| value.split(',')).any(|known| known.trim().trim_start_matches("W/") == tag) {
        return Ok((StatusCode::NOT_MODIFIED, about).into_response());
    }
    Ok((about, [(header::CONTENT_TYPE, media_type(path))], FILES[index].1).into_response())
}

fn media_type(path: &str) -> &'static str {
    match path.rsplit('.').next() {
        Some("html") => "text/html; charset=utf-8",
        Some("js") => "text/javascript; charset=utf-8",
        Some("css") => "text/css; charset=utf-8",
        Some("svg") => "image/svg+xml",
        _ => "text/plain; charset=utf-8",
    }
}
