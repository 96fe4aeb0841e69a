//! Errors of use cases. They carry no status codes; [`problem`](super::problem) translates them.

use super::faults::Faults;
use crate::analysis::dictionary::procedure::ParameterFault;
use crate::analysis::{AnalysisError, SourceError};
use crate::geometry::field_fault::FieldFault;
use crate::store::StoreError;
use crate::wire::fault::Fault;
use crate::wire::files::{FaultKind, FileError};

/// A page of entries and the cursor of the next page.
pub type Page<T> = (Vec<T>, Option<String>);

/// Reason why a use case failed.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    /// The input breaks a rule.
    #[error("invalid input: {}", faults_text(.0.listed()))]
    Invalid(Faults),
    /// The input is not JSON, or not UTF-8.
    #[error("malformed input: {}", faults_text(.0))]
    Malformed(Vec<Fault>),
    /// Shapes that have no subspace under the class.
    #[error("degenerate shapes: {}", faults_text(.0))]
    DegenerateShape(Vec<Fault>),
    /// Too few shapes for statistics.
    #[error("too few shapes: expected at least {needed}, got {found}")]
    TooFewShapes {
        /// Number of shapes given.
        found: usize,
        /// Number of shapes needed.
        needed: usize,
    },
    /// A header or the text of a request breaks a rule.
    #[error("{0}")]
    Query(String),
    /// Parameters of the query or the path break a rule.
    #[error("invalid parameters: {}", faults_text(.0))]
    Parameters(Vec<Fault>),
    /// Nothing has this name or id.
    #[error("{kind} '{key}' not found")]
    NotFound {
        /// Kind of object: `cohort`, `shape`, `job`.
        kind: &'static str,
        /// Requested name or id.
        key: String,
    },
    /// Nothing has the name or id at a place in the body.
    #[error("{}: {}", .0.pointer, .0.detail)]
    NamesNothing(Box<Fault>),
    /// An object was deleted while the request was at work on it.
    #[error("the {kind} was deleted in the meantime")]
    Deleted {
        /// Kind of object.
        kind: &'static str,
    },
    /// A cohort has this name already.
    #[error("a cohort named '{name}' already exists")]
    NameTaken {
        /// Requested name.
        name: String,
    },
    /// Another shape has this external id.
    #[error("{}: {}", .0.pointer, .0.detail)]
    ExternalIdConflict(Box<Fault>),
    /// A line or body exceeds its maximum length.
    #[error("{}", .0.detail)]
    TooLarge(Box<Fault>),
    /// The body ended early or stalled.
    #[error("{0}")]
    Interrupted(String),
    /// A job that is finished cannot be cancelled.
    #[error("the job '{id}' has already {status}")]
    JobFinished {
        /// Id of the job.
        id: String,
        /// Final status of the job.
        status: &'static str,
    },
    /// A version of a dictionary that aliases name cannot be deleted.
    #[error("expected a version that no alias names, got '{id}' of {}: move or delete the alias first",
        .aliases.join(", "))]
    VersionInUse {
        /// Id of the version.
        id: String,
        /// Its aliases, as `name@alias`.
        aliases: Vec<String>,
    },
    /// The work was asked to stop before it was done.
    #[error("the work was cancelled before it finished")]
    Cancelled,
    /// It is not known who asks.
    #[error("authentication required: send a valid key or token in the header 'Authorization: Bearer …'")]
    Unauthenticated,
    /// The caller is authenticated but not authorised.
    #[error("{0}")]
    Forbidden(String),
    /// Temporarily impossible; the request can be retried later.
    #[error("{0}")]
    Unavailable(String),
    /// The key of a request that may be sent again belongs to another request.
    #[error("the Idempotency-Key was used for another request: choose a new key")]
    KeyReused,
    /// The object has changed since the client read it.
    #[error("{0}")]
    Changed(String),
    /// Changes of that age are no longer kept.
    #[error(
        "changes before number {first} are no longer available: read everything again, then continue from the \
         last change"
    )]
    ChangesGone {
        /// Number of the first change that is kept.
        first: u64,
    },
    /// No storage space is left; reads continue.
    #[error("{0}")]
    NoSpace(String),
    /// More is asked for than can be done at once.
    #[error("{0}: try again in a moment")]
    Overloaded(String),
    /// The work took longer than any may.
    #[error("the work was stopped at the time limit of {seconds} s: ask for less at a time")]
    TookTooLong {
        /// That time.
        seconds: u64,
    },
    /// The predicted work exceeds the maximum for a request.
    #[error(
        "predicted compute time {seconds:.1} s, limit {most} s: ask for fewer or smaller shapes at a time, or \
         for less of each"
    )]
    TooCostly {
        /// Predicted compute time.
        seconds: f64,
        /// Maximum compute time.
        most: f64,
    },
    /// A bug or a hardware failure; the cause goes to the log only.
    #[error("internal error: {0}")]
    Internal(String),
}

/// A fault of a parameter, at its place in the request.
pub fn parameter_fault(fault: ParameterFault) -> Fault {
    Fault::new(pointer_of(fault.field), fault.detail)
}

/// Pointer of a parameter with this path, such as `method.codes`; that of the whole request for an empty one.
fn pointer_of(path: &str) -> String {
    path.split('.').filter(|name| !name.is_empty()).map(|name| format!("/{name}")).collect()
}

fn faults_text(faults: &[Fault]) -> String {
    faults.first().map_or_else(String::new, |fault| format!("{}: {}", fault.pointer, fault.detail))
}

impl ServiceError {
    /// Text for the log: the cause if something is broken, and never data sent by a client.
    pub fn cause(&self) -> &str {
        match self {
            Self::Unavailable(cause) | Self::NoSpace(cause) | Self::Internal(cause) => cause,
            Self::NotFound { kind, .. } | Self::Deleted { kind } => kind,
            Self::Cancelled => "cancelled",
            _ => "refused",
        }
    }

    /// This error, where the name or id that nothing has stands in the body at `pointer`.
    pub fn named_at(self, pointer: &str) -> Self {
        match self {
            Self::NotFound { .. } => Self::NamesNothing(Fault::new(pointer, self.to_string()).into()),
            other => other,
        }
    }

    /// An error with a single fault.
    pub fn invalid(pointer: impl Into<String>, detail: impl Into<String>) -> Self {
        Self::Invalid(vec![Fault::new(pointer, detail)].into())
    }

    /// The fault of a parameter of the query or the path.
    pub fn parameter(name: impl Into<String>, detail: impl Into<String>) -> Self {
        Self::Parameters(vec![Fault::of_parameter(name, detail)])
    }

    /// The fault of a cursor that another list, or none, has given.
    pub fn foreign_cursor() -> Self {
        Self::parameter("cursor", "expected a cursor of this list, got another text")
    }

    /// Faults of the entry at `index` of the list `list` of a request.
    pub fn of_entry(list: &str, index: usize, faults: Vec<Fault>) -> Self {
        let prefix = format!("/{list}/{index}");
        Self::Invalid(faults.into_iter().map(|fault| fault.below(&prefix).at_shape(index)).collect())
    }

    /// Input errors, located below a pointer.
    pub fn below(errors: Vec<Fault>, pointer: &str) -> Self {
        Self::Invalid(errors.into_iter().map(|error| error.below(pointer)).collect())
    }

    /// Succeeds if there are no faults; otherwise fails with all of them.
    ///
    /// # Errors
    /// [`ServiceError::Invalid`].
    pub fn unless_empty(faults: Vec<Fault>) -> Result<(), Self> {
        Faults::from(faults).unless_any()
    }

    /// The same error for a single shape that is not part of a list.
    pub fn without_index(mut self) -> Self {
        if let Self::DegenerateShape(faults) = &mut self {
            faults.iter_mut().for_each(|fault| fault.index = None);
        }
        self
    }

    /// Converts an analysis error of a request whose shapes are at `/shapes/{index}`.
    pub fn from_request(error: AnalysisError) -> Self {
        Self::from_analysis(error, |index| format!("/shapes/{index}"))
    }

    /// Converts an analysis error; `pointer` locates a shape by its index.
    pub fn from_analysis(error: AnalysisError, pointer: impl Fn(usize) -> String) -> Self {
        match error {
            AnalysisError::Degenerate { index, .. } | AnalysisError::NoExtent { index, .. } => {
                let fault = Fault::new(pointer(index), error.to_string()).at_shape(index);
                Self::DegenerateShape(vec![fault])
            }
            AnalysisError::Unsuitable { index, detail } => {
                Self::Invalid(vec![Fault::new(pointer(index), detail).at_shape(index)].into())
            }
            AnalysisError::TooFewShapes { found, needed } => Self::TooFewShapes { found, needed },
            AnalysisError::NotAProperClass(detail) => Self::invalid("/transformation", detail),
            AnalysisError::NoCanonicalFrame { .. } => Self::invalid("/frame", error.to_string()),
            AnalysisError::Antipodal { .. } => Self::invalid("", error.to_string()),
            AnalysisError::SingularCovariance { .. } => Self::invalid("/classifier", error.to_string()),
            AnalysisError::Parameter { field, detail } => Self::invalid(pointer_of(field), detail),
            AnalysisError::Interrupted => Self::Cancelled,
            AnalysisError::Source(error) => {
                error.take().unwrap_or_else(|error| Self::Internal(error.to_string()))
            }
            AnalysisError::NotAnAccumulator
            | AnalysisError::NoConvergence { .. }
            | AnalysisError::Numeric(_) => Self::Internal(error.to_string()),
        }
    }
}

impl From<AnalysisError> for ServiceError {
    fn from(error: AnalysisError) -> Self {
        Self::from_request(error)
    }
}

/// The way through a statistic of an error of the source of its shapes; the other direction takes it out again.
impl From<ServiceError> for AnalysisError {
    fn from(error: ServiceError) -> Self {
        SourceError::new(error).into()
    }
}

impl From<FieldFault> for ServiceError {
    fn from(fault: FieldFault) -> Self {
        Self::Invalid(vec![fault.into()].into())
    }
}

impl From<FileError> for ServiceError {
    fn from(error: FileError) -> Self {
        let fault = Fault::of_file(&error);
        match error.kind {
            FaultKind::TooLarge => Self::TooLarge(fault.into()),
            FaultKind::Option => {
                let name = error.place.tag.unwrap_or_else(|| "format".into());
                Self::parameter(name, error.detail)
            }
            FaultKind::Unknown | FaultKind::Malformed | FaultKind::Truncated | FaultKind::Unsupported => {
                Self::Invalid(vec![fault].into())
            }
            FaultKind::Io => Self::Malformed(vec![fault]),
            FaultKind::Stopped => Self::Cancelled,
            FaultKind::Memory => Self::Overloaded(error.detail),
        }
    }
}

impl From<StoreError> for ServiceError {
    fn from(error: StoreError) -> Self {
        match error {
            StoreError::NameTaken { name } => Self::NameTaken { name },
            StoreError::CohortGone => Self::Deleted { kind: "cohort" },
            StoreError::TooManyJobs { .. }
            | StoreError::TooMuchWork { .. }
            | StoreError::TooManyBytes { .. } => Self::Unavailable(error.to_string()),
            StoreError::JobLost => Self::Cancelled,
            StoreError::ExternalIdPending { .. } => Self::Unavailable(
                "an unfinished upload uses one of the external ids: try again when it has ended".into(),
            ),
            StoreError::UploadLost | StoreError::Busy | StoreError::ReadOnly => {
                Self::Unavailable(error.to_string())
            }
            StoreError::Aliased { id, aliases } => Self::VersionInUse { id, aliases },
            StoreError::AlreadyDone => {
                Self::Unavailable("the same request has just been answered: send it again".into())
            }
            StoreError::Changed => {
                Self::Changed("the resource has changed since it was read: read it again".into())
            }
            StoreError::ChangesGone { first } => Self::ChangesGone { first },
            StoreError::TooManyNames { .. } => Self::invalid("", error.to_string()),
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
