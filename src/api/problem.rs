//! Problem documents (RFC 9457): the body of every refusal, with the status and the request id.
//!
//! The types are those of [`service::app::problem`](crate::service::app::problem).

use axum::Json;
use axum::extract::Request;
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use tower_http::request_id::RequestId;

use crate::domain::job::Job;
pub use crate::service::app::problem::{Problem, ProblemKind};
use crate::wire::fault::Fault;

/// Status code of the response to a refused request.
fn status(kind: ProblemKind) -> StatusCode {
    match kind {
        ProblemKind::MalformedBody | ProblemKind::InvalidQuery => StatusCode::BAD_REQUEST,
        ProblemKind::InterruptedBody => StatusCode::REQUEST_TIMEOUT,
        ProblemKind::Unauthenticated => StatusCode::UNAUTHORIZED,
        ProblemKind::Forbidden => StatusCode::FORBIDDEN,
        ProblemKind::RouteNotFound | ProblemKind::NotFound => StatusCode::NOT_FOUND,
        ProblemKind::MethodNotAllowed => StatusCode::METHOD_NOT_ALLOWED,
        ProblemKind::NotAcceptable => StatusCode::NOT_ACCEPTABLE,
        ProblemKind::NameTaken
        | ProblemKind::ExternalIdConflict
        | ProblemKind::JobFinished
        | ProblemKind::VersionInUse => StatusCode::CONFLICT,
        ProblemKind::PayloadTooLarge => StatusCode::PAYLOAD_TOO_LARGE,
        ProblemKind::UnsupportedMediaType => StatusCode::UNSUPPORTED_MEDIA_TYPE,
        ProblemKind::InvalidInput
        | ProblemKind::DegenerateShape
        | ProblemKind::TooFewShapes
        | ProblemKind::TooCostly
        | ProblemKind::IdempotencyKeyReused => StatusCode::UNPROCESSABLE_ENTITY,
        ProblemKind::TooManyRequests => StatusCode::TOO_MANY_REQUESTS,
        ProblemKind::Internal => StatusCode::INTERNAL_SERVER_ERROR,
        ProblemKind::Unavailable | ProblemKind::Overloaded | ProblemKind::TookTooLong => {
            StatusCode::SERVICE_UNAVAILABLE
        }
        ProblemKind::PreconditionFailed => StatusCode::PRECONDITION_FAILED,
        ProblemKind::ChangesGone => StatusCode::GONE,
        ProblemKind::InsufficientStorage => StatusCode::INSUFFICIENT_STORAGE,
    }
}

/// A problem document.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub struct ProblemDocument {
    /// Stable URI of the problem type.
    #[serde(rename = "type")]
    #[schema(example = "urn:shapelex:problem:degenerate-shape")]
    kind: String,
    /// Title of the type.
    #[schema(example = "Degenerate shape")]
    title: &'static str,
    /// Status code of the response.
    #[schema(example = 422)]
    status: u16,
    /// Short name: the last part of `type`.
    #[schema(example = "degenerate-shape")]
    code: &'static str,
    /// Description of this occurrence and its remedy.
    detail: String,
    /// All faults of the input, at most 100 entries.
    errors: Vec<Fault>,
    /// Id of the request, as in the `x-request-id` header.
    request_id: Option<String>,
}

impl ProblemDocument {
    /// Document with the id of the refused request.
    fn new(problem: Problem, request_id: Option<String>) -> Self {
        let (kind, detail) = (problem.kind(), problem.detail().to_owned());
        Self {
            kind: format!("urn:shapelex:problem:{}", kind.code()),
            title: kind.title(),
            status: status(kind).as_u16(),
            code: kind.code(),
            detail,
            errors: problem.into_errors(),
            request_id,
        }
    }

    /// Document of a job, if it has failed.
    pub fn from_failed(job: &Job) -> Option<Self> {
        job.problem.as_ref().map(|_| Self::new(Problem::from_failed(job), None))
    }
}

impl IntoResponse for Problem {
    /// Sets the status; [`render`], which knows the request id, writes the body.
    fn into_response(self) -> Response {
        let mut response = status(self.kind()).into_response();
        let headers = response.headers_mut();
        if status(self.kind()) == StatusCode::SERVICE_UNAVAILABLE {
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
    let mut rendered = (status, Json(ProblemDocument::new(problem, request_id))).into_response();
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
        .find(|kind| self::status(*kind) == status)
        .unwrap_or(if status.is_server_error() { ProblemKind::Internal } else { ProblemKind::InvalidQuery })
}

/// Response to a request whose handler panicked.
pub fn from_panic(_: Box<dyn std::any::Any + Send>) -> Response {
    tracing::error!("a request handler panicked");
    Problem::new(ProblemKind::Internal, "internal error: see the log under the request id").into_response()
}
