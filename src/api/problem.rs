//! Problem documents (RFC 9457) in HTTP: the body of every refusal, with the request id.
//!
//! The types and their documents are those of [`service::problem`](crate::service::app::problem).

use axum::Json;
use axum::extract::Request;
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use tower_http::request_id::RequestId;

pub use crate::service::app::problem::{Problem, ProblemDocument, ProblemKind};

impl IntoResponse for Problem {
    /// Sets the status; [`render`], which knows the request id, writes the body.
    fn into_response(self) -> Response {
        let mut response = self.kind().status().into_response();
        let headers = response.headers_mut();
        if self.kind().status() == StatusCode::SERVICE_UNAVAILABLE {
            headers.insert(header::RETRY_AFTER, HeaderValue::from_static("2"));
        }
        if self.kind() == ProblemKind::Unauthenticated {
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer"));
        }
        response.extensions_mut().insert(self);
        response
    }
}

/// Middleware that writes the problem document of every refusal, including those of other middleware without a body.
pub async fn render(request: Request, next: Next) -> Response {
    let request_id = request
        .extensions()
        .get::<RequestId>()
        .and_then(|id| id.header_value().to_str().ok())
        .map(str::to_owned);
    let mut response = next.run(request).await;
    let status = response.status();
    let problem = match response.extensions_mut().remove::<Problem>() {
        Some(problem) => problem,
        None if status.is_client_error() || status.is_server_error() => {
            Problem::new(kind_of_status(status), status.canonical_reason().unwrap_or("refused"))
        }
        None => return response,
    };
    let (parts, _) = response.into_parts();
    let mut rendered = (status, Json(problem.document(request_id))).into_response();
    for (name, value) in &parts.headers {
        if name != header::CONTENT_TYPE && name != header::CONTENT_LENGTH {
            rendered.headers_mut().insert(name, value.clone());
        }
    }
    rendered.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("application/problem+json"));
    rendered
}

fn kind_of_status(status: StatusCode) -> ProblemKind {
    ProblemKind::ALL
        .iter()
        .copied()
        .find(|kind| kind.status() == status)
        .unwrap_or(if status.is_server_error() { ProblemKind::Internal } else { ProblemKind::InvalidQuery })
}

/// Response to a request whose handler panicked.
pub fn of_panic(_: Box<dyn std::any::Any + Send>) -> Response {
    tracing::error!("a request handler panicked");
    Problem::new(ProblemKind::Internal, "internal error: see the log under the request id").into_response()
}
