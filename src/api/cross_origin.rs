//! Pages of other origins that may read answers in a browser (CORS): those that the operator lists, and no others.

use std::time::Duration;

use axum::http::{HeaderName, HeaderValue, Method, header};
use tower_http::cors::{AllowOrigin, CorsLayer};

use crate::service::app::App;

/// Time for which browsers may remember a preflight.
const REMEMBERED: Duration = Duration::from_secs(600);
const METHODS: [Method; 5] = [Method::GET, Method::HEAD, Method::POST, Method::PATCH, Method::DELETE];
/// Headers that the service reads.
const READ: [HeaderName; 9] = [
    header::ACCEPT,
    header::AUTHORIZATION,
    header::CONTENT_TYPE,
    header::IF_MATCH,
    header::IF_NONE_MATCH,
    HeaderName::from_static("idempotency-key"),
    HeaderName::from_static("last-event-id"),
    HeaderName::from_static("prefer"),
    HeaderName::from_static("x-request-id"),
];
/// Headers of answers that pages may read.
const SHOWN: [HeaderName; 8] = [
    header::ETAG,
    header::LINK,
    header::LOCATION,
    header::RETRY_AFTER,
    HeaderName::from_static("idempotency-replayed"),
    HeaderName::from_static("shapelex-dictionaries"),
    HeaderName::from_static("shapelex-revision"),
    HeaderName::from_static("x-request-id"),
];

/// The layer that admits the listed origins; `None` if there are none.
pub(super) fn layer(app: &App) -> Option<CorsLayer> {
    let origins: Vec<HeaderValue> =
        app.allowed_origins().iter().filter_map(|origin| origin.parse().ok()).collect();
    let layer = || {
        CorsLayer::new()
            .allow_origin(AllowOrigin::list(origins.iter().cloned()))
            .allow_methods(METHODS)
            .allow_headers(READ)
            .expose_headers(SHOWN)
            .max_age(REMEMBERED)
    };
    (!origins.is_empty()).then(layer)
}
