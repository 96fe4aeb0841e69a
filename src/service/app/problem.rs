//! Problems: every refusal has a stable type, a sentence with the remedy, the pointer of every invalid field, and the
//! index of the affected shape.
//!
//! Requests are answered with one, and failed jobs store one.

use serde::Deserialize;
use serde_json::{Value, json};

use super::error::ServiceError;
use crate::domain::job::Job;
use crate::wire::fault::{Fault, brief};

/// Defines the problem types with their codes and titles: one table, documented in `docs/problems.md`.
macro_rules! problem_kinds {
    ($($(#[$doc:meta])* $name:ident, $code:literal, $title:literal;)*) => {
        /// A problem type.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum ProblemKind {
            $($(#[$doc])* $name,)*
        }

        impl ProblemKind {
            /// All types.
            pub const ALL: &[Self] = &[$(Self::$name),*];

            /// Stable short name.
            pub fn code(self) -> &'static str {
                match self { $(Self::$name => $code,)* }
            }

            /// Short title, the same for every occurrence.
            pub fn title(self) -> &'static str {
                match self { $(Self::$name => $title,)* }
            }
        }
    };
}

problem_kinds! {
    /// Not JSON, not UTF-8, a broken encoding.
    MalformedBody, "malformed-body", "Malformed body";
    /// A query parameter or path segment breaks a rule.
    InvalidQuery, "invalid-query", "Invalid query parameter";
    /// The body ended early or stalled.
    InterruptedBody, "interrupted-body", "Incomplete body";
    /// No key or token, or one that is wrong, has ended or was revoked.
    Unauthenticated, "unauthenticated", "Authentication required";
    /// The key or token is not for this.
    Forbidden, "forbidden", "Access denied";
    /// Nothing at this path.
    RouteNotFound, "route-not-found", "Route not found";
    /// No such cohort, shape or job.
    NotFound, "not-found", "Not found";
    /// The path exists for other methods.
    MethodNotAllowed, "method-not-allowed", "Method not allowed";
    /// The answer does not exist in the wanted format.
    NotAcceptable, "not-acceptable", "Format not available";
    /// A cohort has this name.
    NameTaken, "name-taken", "Name already in use";
    /// Another shape has this external id.
    ExternalIdConflict, "external-id-conflict", "External id already in use";
    /// A finished job cannot be cancelled.
    JobFinished, "job-finished", "Job already finished";
    /// An alias names the version of a dictionary.
    VersionInUse, "version-in-use", "Version in use";
    /// Body or line over the limit.
    PayloadTooLarge, "payload-too-large", "Body too large";
    /// The body is of a type that is not read here.
    UnsupportedMediaType, "unsupported-media-type", "Unsupported media type";
    /// A field is missing, unknown or out of bounds.
    InvalidInput, "invalid-input", "Invalid input";
    /// A shape without a subspace under the class.
    DegenerateShape, "degenerate-shape", "Degenerate shape";
    /// Statistics of too few shapes.
    TooFewShapes, "too-few-shapes", "Too few shapes";
    /// More work than a request or a job may be predicted to take.
    TooCostly, "too-costly", "Predicted time too long";
    /// The caller asks more often than it may.
    TooManyRequests, "too-many-requests", "Too many requests";
    /// A bug or a broken machine.
    Internal, "internal", "Internal error";
    /// Too many jobs wait, the service stops, or there is no storage.
    Unavailable, "unavailable", "Service temporarily unavailable";
    /// The Idempotency-Key belongs to another request.
    IdempotencyKeyReused, "idempotency-key-reused", "Idempotency key already in use";
    /// It is not as it was when the client looked.
    PreconditionFailed, "precondition-failed", "Precondition failed";
    /// Changes that old are not kept.
    ChangesGone, "changes-gone", "Changes no longer available";
    /// The disk is full.
    InsufficientStorage, "insufficient-storage", "Insufficient storage";
    /// More requests than can be computed at once.
    Overloaded, "overloaded", "Service overloaded";
    /// The answer took longer than requests may.
    TookTooLong, "took-too-long", "Request took too long";
}

/// A refusal.
#[derive(Debug, Clone)]
pub struct Problem {
    kind: ProblemKind,
    detail: String,
    errors: Vec<Fault>,
}

impl Problem {
    /// A problem with a sentence for the client; input quoted in it is shortened.
    pub fn new(kind: ProblemKind, detail: impl Into<String>) -> Self {
        Self { kind, detail: brief(detail.into()), errors: Vec::new() }
    }

    /// The refusal of a parameter of the query or the path.
    pub fn of_parameter(name: impl Into<String>, detail: impl Into<String>) -> Self {
        Self::with(ProblemKind::InvalidQuery, vec![Fault::of_parameter(name, detail)])
    }

    fn with(kind: ProblemKind, errors: Vec<Fault>) -> Self {
        let found = errors.len();
        Self::from_first(kind, errors, found)
    }

    /// A problem with the first faults out of `found`.
    fn from_first(kind: ProblemKind, errors: Vec<Fault>, found: usize) -> Self {
        let detail = match errors.as_slice() {
            [] => kind.title().into(),
            [one] => {
                let times =
                    one.alike.as_ref().map(|alike| format!(" ({} times)", alike.count)).unwrap_or_default();
                match place(one) {
                    "" => format!("{}{times}", one.detail),
                    place => format!("{place}: {}{times}", one.detail),
                }
            }
            [first, ..] => format!("{found} errors, the first at '{}': {}", place(first), first.detail),
        };
        Self { kind, detail: brief(detail), errors }
    }

    /// Type of the problem.
    pub fn kind(&self) -> ProblemKind {
        self.kind
    }

    /// Problem of a failed job.
    pub fn from_job(error: ServiceError, job: &str) -> Self {
        match error {
            ServiceError::Internal(cause) => {
                tracing::error!(job, error = cause, "internal error");
                Self::new(ProblemKind::Internal, "internal error: see the log under the id of the job")
            }
            error => error.into(),
        }
    }

    /// Problem that a failed job has stored; that of a failed job without one is internal.
    pub fn from_failed(job: &Job) -> Self {
        let problem = job.problem.as_ref();
        let text = |field: &str| problem.and_then(|problem| problem[field].as_str()).unwrap_or_default();
        let kind = ProblemKind::ALL.iter().copied().find(|kind| kind.code() == text("code"));
        let errors = problem.and_then(|problem| problem["errors"].as_array()).into_iter().flatten();
        Self {
            kind: kind.unwrap_or(ProblemKind::Internal),
            detail: text("detail").to_owned(),
            errors: errors.filter_map(|error| Fault::deserialize(error).ok()).collect(),
        }
    }

    /// The form in which failed jobs store it, read by [`Problem::from_failed`].
    pub fn to_stored(&self) -> Value {
        json!({"code": self.kind.code(), "detail": self.detail, "errors": self.errors})
    }

    /// Description of this occurrence and its remedy.
    pub fn detail(&self) -> &str {
        &self.detail
    }

    /// All faults of the input, in bounded length.
    pub fn into_errors(self) -> Vec<Fault> {
        self.errors.into_iter().map(Fault::shortened).collect()
    }
}

/// Where a fault is, for a sentence.
fn place(fault: &Fault) -> &str {
    fault.parameter.as_deref().unwrap_or(&fault.pointer)
}

impl From<ServiceError> for Problem {
    fn from(error: ServiceError) -> Self {
        let detail = error.to_string();
        match error {
            ServiceError::Invalid(faults) => {
                let found = faults.count();
                Self::from_first(ProblemKind::InvalidInput, faults.into_listed(), found)
            }
            ServiceError::Malformed(errors) => Self::with(ProblemKind::MalformedBody, errors),
            ServiceError::DegenerateShape(errors) => Self::with(ProblemKind::DegenerateShape, errors),
            ServiceError::TooFewShapes { .. } => Self::new(ProblemKind::TooFewShapes, detail),
            ServiceError::NotFound { .. } | ServiceError::Deleted { .. } => {
                Self::new(ProblemKind::NotFound, detail)
            }
            ServiceError::NameTaken { .. } => {
                Self::with(ProblemKind::NameTaken, vec![Fault::new("/name", detail)])
            }
            ServiceError::NamesNothing(fault) => Self::with(ProblemKind::NotFound, vec![*fault]),
            ServiceError::ExternalIdConflict(fault) => {
                Self::with(ProblemKind::ExternalIdConflict, vec![*fault])
            }
            ServiceError::JobFinished { .. } => Self::new(ProblemKind::JobFinished, detail),
            ServiceError::VersionInUse { .. } => Self::new(ProblemKind::VersionInUse, detail),
            ServiceError::Unauthenticated => Self::new(ProblemKind::Unauthenticated, detail),
            ServiceError::Forbidden(_) => Self::new(ProblemKind::Forbidden, detail),
            ServiceError::TooLarge(fault) => Self::with(ProblemKind::PayloadTooLarge, vec![*fault]),
            ServiceError::Query(_) => Self::new(ProblemKind::InvalidQuery, detail),
            ServiceError::Parameters(faults) => Self::with(ProblemKind::InvalidQuery, faults),
            ServiceError::Interrupted(_) => Self::new(ProblemKind::InterruptedBody, detail),
            ServiceError::Unavailable(_) | ServiceError::Cancelled => {
                Self::new(ProblemKind::Unavailable, detail)
            }
            ServiceError::KeyReused => Self::new(ProblemKind::IdempotencyKeyReused, detail),
            ServiceError::Changed(_) => Self::new(ProblemKind::PreconditionFailed, detail),
            ServiceError::ChangesGone { .. } => Self::new(ProblemKind::ChangesGone, detail),
            ServiceError::NoSpace(_) => Self::new(ProblemKind::InsufficientStorage, detail),
            ServiceError::Overloaded(_) => Self::new(ProblemKind::Overloaded, detail),
            ServiceError::TookTooLong { .. } => Self::new(ProblemKind::TookTooLong, detail),
            ServiceError::TooCostly { .. } => Self::new(ProblemKind::TooCostly, detail),
            ServiceError::Internal(_) => {
                tracing::error!(error = %detail, "internal error");
                Self::new(ProblemKind::Internal, "internal error: see the log under the request id")
            }
        }
    }
}
