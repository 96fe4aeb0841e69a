//! HTTP interface: translates requests to use cases and their outcomes to responses.
//!
//! * [`v1`] — the resources;
//! * [`problem`] — every refusal as a problem document (RFC 9457);
//! * `gate` — checks of every request, in order; [`access`] — callers and permissions; [`origin`] — cross-site requests;
//!   [`headers`] — browser security headers;
//! * [`overload`] — time limits of requests, and rate limits of callers;
//! * `coding` — compressed bodies, decoded; [`body`] — request memory; [`answers`] — response memory; [`drain`] — draining of refused bodies;
//!   [`inspected_body`] — bodies that report their traffic;
//! * [`observe`], [`audit`] — metrics, log and audit trail of every request; [`metrics`] — the metrics endpoint;
//! * [`interface`] — the OpenAPI document;
//! * `negotiation` — media types of answers; `tabular` — tables of answers, `formulas` — CSV without formulas; `cross_origin` — pages of other origins that may read answers;
//! * [`operation`] — the operations, a row for each;
//! * [`extract`] — bodies, queries and formats, with problem documents as rejections;
//! * [`respond`] — responses computed and serialised on the thread pool;
//! * [`health`] — liveness and readiness;
//! * `dashboard` — the page for people, the reference of this interface, and their assets.

pub mod access;
pub mod answers;
pub mod audit;
pub mod body;
mod caching;
mod coding;
mod cross_origin;
mod dashboard;
#[cfg(feature = "schema")]
mod describe;
#[cfg(feature = "schema")]
mod document;
pub mod drain;
pub mod extract;
pub mod form;
mod formulas;
mod gate;
pub mod headers;
pub mod health;
pub mod inspected_body;
pub mod interface;
pub mod media_type;
pub mod metrics;
mod negotiation;
pub mod observe;
pub mod operation;
pub mod origin;
pub mod overload;
pub mod problem;
pub mod respond;
mod tabular;
pub mod v1;

use std::sync::Arc;

use axum::extract::Request;
use axum::http::HeaderName;
use axum::middleware::{from_fn, from_fn_with_state};
use axum::{Extension, Router};
use tower::ServiceBuilder;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::request_id::{MakeRequestUuid, PropagateRequestIdLayer, SetRequestIdLayer};

use crate::service::app::App;
use problem::{Problem, ProblemKind};

fn routes() -> Router<App> {
    let light = v1::light().layer(from_fn(overload::light));
    let computing = v1::computing().layer(from_fn(overload::computing));
    // Streamed routes have no time limit: an upload watches its own pauses, and events end with their place.
    light
        .merge(computing)
        .merge(v1::streamed())
        .layer(from_fn(tabular::answer))
        .layer(from_fn(formulas::answer))
        .layer(from_fn(gate::pass))
        // Probes are not rate-limited, and need no key.
        .merge(v1::probes().layer(from_fn(overload::light)))
}

/// Adds the context to the extensions of a request. A layer is cloned for every request by each layer outside of it, and the
/// context is large: the layer holds a pointer.
fn adding(app: &App) -> impl Fn(Request) -> Request + Clone + use<> {
    let app = Arc::new(app.clone());
    move |mut request| {
        request.extensions_mut().insert(App::clone(&app));
        request
    }
}

/// The complete service as a router.
pub fn router(app: App) -> Router {
    let recorder = audit::Recorder::new(app.trail());
    let memory = app.memory.clone();
    let request_id = HeaderName::from_static(observe::REQUEST_ID);
    let middleware = ServiceBuilder::new()
        .layer(from_fn_with_state(headers::PagePolicy::new(&app), headers::secure))
        .map_request(observe::plain_request_id)
        .layer(SetRequestIdLayer::new(request_id.clone(), MakeRequestUuid))
        .layer(from_fn(observe::observe))
        .layer(PropagateRequestIdLayer::new(request_id))
        .layer(from_fn(drain::drain))
        .map_request(extract::settle_encoding)
        .layer(CompressionLayer::new().gzip(true))
        .layer(from_fn(problem::render))
        .layer(from_fn_with_state(recorder, audit::record))
        .layer(CatchPanicLayer::custom(problem::from_panic))
        .map_response(move |response| answers::hold(&memory, response))
        .layer(Extension(overload::Edge::new(&app.limits)))
        .layer(from_fn(body::bound))
        .map_request(adding(&app))
        .layer(from_fn(coding::decode));
    let router = routes()
        .merge(dashboard::routes())
        .merge(interface::routes())
        .fallback(|uri: axum::http::Uri| async move {
            Problem::new(ProblemKind::RouteNotFound, format!("no route at {}", uri.path()))
        })
        .method_not_allowed_fallback(|method: axum::http::Method| async move {
            Problem::new(
                ProblemKind::MethodNotAllowed,
                format!("the method {method} is not available here: see the Allow header"),
            )
        })
        .layer(tower::util::option_layer(cross_origin::layer(&app)))
        .layer(middleware);
    router.with_state(app)
}
