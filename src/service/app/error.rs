//! What a use case can refuse. No status codes: [`problem`](super::problem) translates.

use serde::{Deserialize, Serialize};

use crate::analysis::AnalysisError;
use crate::formats::{InputError, brief, brief_pointer};
use crate::store::StoreError;

/// One thing wrong with an input.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fault {
    /// JSON pointer into the body; for a stream, into its line.
    pub pointer: String,
    /// What is wrong and what to do.
    pub detail: String,
    /// Position of the shape in the batch or stream.
    pub index: Option<usize>,
    /// Line of a stream, from 1.
    pub line: Option<u64>,
}

impl Fault {
    /// A fault of the request as a whole, which repeats in short what the client has sent.
    pub fn new(pointer: impl Into<String>, detail: impl Into<String>) -> Self {
        let (pointer, detail) = (brief_pointer(pointer.into()), brief(detail.into()));
        Self { pointer, detail, index: None, line: None }
    }
}

impl From<InputError> for Fault {
    fn from(error: InputError) -> Self {
        Self::new(error.pointer, error.detail)
    }
}

/// A page of entries and the cursor of the next one.
pub type Page<T> = (Vec<T>, Option<String>);

/// Most faults in one answer: a broken export of a million shapes breaks every one of them.
pub const MAX_FAULTS: usize = 100;

/// Why a use case did not happen.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    /// The input breaks a rule.
    #[error("invalid input: {}", faults_text(.0))]
    Invalid(Vec<Fault>),
    /// The input breaks rules in more places than are named.
    #[error("invalid input: {}", faults_text(.faults))]
    InvalidOften {
        /// The first of them.
        faults: Vec<Fault>,
        /// How many there are.
        found: usize,
    },
    /// The text is not JSON, or not UTF-8.
    #[error("malformed input: {}", faults_text(.0))]
    Malformed(Vec<Fault>),
    /// Shapes have no subspace under the class.
    #[error("degenerate shapes: {}", faults_text(.0))]
    DegenerateShape(Vec<Fault>),
    /// Too few shapes for statistics.
    #[error("{found} shapes, at least {needed} are needed")]
    TooFewShapes {
        /// Shapes there are.
        found: usize,
        /// Shapes needed.
        needed: usize,
    },
    /// A query parameter breaks a rule.
    #[error("{0}")]
    Query(String),
    /// Nothing has this name or id.
    #[error("there is no {kind} '{key}'")]
    NotFound {
        /// `cohort`, `shape`, `job`.
        kind: &'static str,
        /// What was asked for.
        key: String,
    },
    /// A cohort has this name already.
    #[error("a cohort named '{name}' exists already")]
    NameTaken {
        /// The name.
        name: String,
    },
    /// Another shape has this external id.
    #[error("{} {}", .0.pointer, .0.detail)]
    ExternalIdConflict(Fault),
    /// A line or body is longer than allowed.
    #[error("{}", .0.detail)]
    TooLarge(Fault),
    /// The body ended early or stalled.
    #[error("{0}")]
    Interrupted(String),
    /// A job that is finished cannot be cancelled.
    #[error("the job '{id}' has {status} already")]
    JobFinished {
        /// Its id.
        id: String,
        /// How it ended.
        status: &'static str,
    },
    /// The work was asked to stop before it was done.
    #[error("the work was cancelled before it was done")]
    Cancelled,
    /// It is not known who asks.
    #[error("a valid key or token is needed, in the header 'Authorization: Bearer …'")]
    Unauthenticated,
    /// It is known who asks, and that they may not.
    #[error("{0}")]
    Forbidden(String),
    /// Try again later.
    #[error("{0}")]
    Unavailable(String),
    /// The key of a request that may be sent again belongs to another request.
    #[error("the Idempotency-Key was given to another request before; take a new one")]
    KeyReused,
    /// It is not as it was when the client looked.
    #[error("{0}")]
    Changed(String),
    /// Changes that old are not kept any more.
    #[error(
        "changes before number {first} are not kept any more: read everything again, then go on from the last"
    )]
    ChangesGone {
        /// The first that is kept.
        first: u64,
    },
    /// There is no room to store anything; reading goes on.
    #[error("{0}")]
    NoSpace(String),
    /// More is asked for than can be done at once.
    #[error("{0}; try again in a moment")]
    Overloaded(String),
    /// The work took longer than any may.
    #[error(
        "the work was ended after {seconds} s, which is longer than any may take: ask for less at a time"
    )]
    TookTooLong {
        /// After how many.
        seconds: u64,
    },
    /// The work that is asked for is predicted to take longer than a request may.
    #[error(
        "this is predicted to take {seconds:.1} s of compute time, at most {most} s are given: ask for fewer or smaller \
         shapes at a time, or for less of each"
    )]
    TooCostly {
        /// Predicted.
        seconds: f64,
        /// Allowed.
        most: f64,
    },
    /// A bug or a broken machine; the cause is for the log only.
    #[error("internal error: {0}")]
    Internal(String),
}

fn faults_text(faults: &[Fault]) -> String {
    faults.first().map_or_else(String::new, |fault| format!("{} {}", fault.pointer, fault.detail))
}

impl ServiceError {
    /// What the log says of it: the cause where something broke, and nothing that a client has sent.
    pub fn cause(&self) -> &str {
        match self {
            Self::Unavailable(cause) | Self::NoSpace(cause) | Self::Internal(cause) => cause,
            Self::NotFound { kind, .. } => kind,
            Self::Cancelled => "cancelled",
            _ => "refused",
        }
    }

    /// One fault.
    pub fn invalid(pointer: impl Into<String>, detail: impl Into<String>) -> Self {
        Self::Invalid(vec![Fault::new(pointer, detail)])
    }

    /// Input errors below a pointer.
    pub fn below(errors: Vec<InputError>, pointer: &str) -> Self {
        Self::Invalid(errors.into_iter().map(|error| error.below(pointer).into()).collect())
    }

    /// Nothing, or all faults (at most [`MAX_FAULTS`]).
    ///
    /// # Errors
    /// [`ServiceError::Invalid`] when there are faults.
    pub fn unless_empty(faults: Vec<Fault>) -> Result<(), Self> {
        let found = faults.len();
        if found == 0 { Ok(()) } else { Err(Self::of_faults(faults, found)) }
    }

    /// The first faults (at most [`MAX_FAULTS`]) of those that were `found`.
    pub fn of_faults(mut faults: Vec<Fault>, found: usize) -> Self {
        faults.truncate(MAX_FAULTS);
        if found > faults.len() { Self::InvalidOften { faults, found } } else { Self::Invalid(faults) }
    }

    /// The same error about a single shape that is not part of a list.
    pub fn without_index(mut self) -> Self {
        if let Self::DegenerateShape(faults) = &mut self {
            faults.iter_mut().for_each(|fault| fault.index = None);
        }
        self
    }

    /// An analysis error of a request whose shapes stand at `/shapes/{index}`.
    pub fn of_request(error: AnalysisError) -> Self {
        Self::of_analysis(error, |index| format!("/shapes/{index}"))
    }

    /// An analysis error, with the pointer to a shape.
    pub fn of_analysis(error: AnalysisError, pointer: impl Fn(usize) -> String) -> Self {
        match error {
            AnalysisError::Degenerate { index, .. } | AnalysisError::NoExtent { index, .. } => {
                let fault = Fault { index: Some(index), ..Fault::new(pointer(index), error.to_string()) };
                Self::DegenerateShape(vec![fault])
            }
            AnalysisError::TooFewShapes { found, needed } => Self::TooFewShapes { found, needed },
            AnalysisError::NotAProperClass(detail) => Self::invalid("/transformation", detail),
            AnalysisError::NoCanonicalFrame { .. } => Self::invalid("/frame", error.to_string()),
            AnalysisError::Antipodal { .. } => Self::invalid("", error.to_string()),
            AnalysisError::SingularCovariance { .. } => Self::invalid("/classifier", error.to_string()),
            AnalysisError::Interrupted => Self::Cancelled,
            AnalysisError::NotAnAccumulator
            | AnalysisError::NoConvergence { .. }
            | AnalysisError::Numeric(_) => Self::Internal(error.to_string()),
        }
    }
}

impl From<AnalysisError> for ServiceError {
    fn from(error: AnalysisError) -> Self {
        Self::of_request(error)
    }
}

impl From<StoreError> for ServiceError {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::NameTaken { name } => Self::NameTaken { name },
            StoreError::CohortGone => Self::NotFound { kind: "cohort", key: "deleted meanwhile".into() },
            StoreError::TooManyJobs { .. } | StoreError::TooMuchWork { .. } => {
                Self::Unavailable(error.to_string())
            }
            StoreError::ExternalIdPending { .. } => {
                Self::Unavailable("another unfinished upload holds one of the external ids".into())
            }
            StoreError::UploadLost | StoreError::Busy | StoreError::ReadOnly => {
                Self::Unavailable(error.to_string())
            }
            StoreError::AlreadyDone => {
                Self::Unavailable("the same request was answered at this moment, send it again".into())
            }
            StoreError::Changed => Self::Changed("it was changed meanwhile, look again".into()),
            StoreError::ChangesGone { first } => Self::ChangesGone { first },
            StoreError::Full => Self::NoSpace(error.to_string()),
            StoreError::Text => Self::Query(error.to_string()),
            // The message for clients carries no cause; the log does.
            other => Self::Internal(match std::error::Error::source(&other) {
                Some(source) => format!("{other}: {source}"),
                None => other.to_string(),
            }),
        }
    }
}
