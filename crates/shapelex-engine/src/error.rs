//! Errors of the engine.

use datafusion_common::DataFusionError;
use shapelex_analysis::{AnalysisError, SourceError};
use shapelex_geometry::GeometryError;

/// An error of the engine.
#[derive(Debug, thiserror::Error)]
pub enum EngineError {
    /// The object store refused, or could not be reached.
    #[error("{object}: {source}")]
    Store {
        /// Path of the object.
        object: String,
        /// Error of the store.
        source: object_store::Error,
    },
    /// The object store did not answer in time.
    #[error("{object}: expected an answer within {seconds} s, got none in {attempts} attempts")]
    Slow {
        /// Path of the object.
        object: String,
        /// Duration of an attempt.
        seconds: f64,
        /// Number of attempts.
        attempts: u32,
    },
    /// An object differs from the written one.
    #[error("{object} is damaged: expected {expected}, got {got}")]
    Damaged {
        /// Path of the object.
        object: String,
        /// Expected content.
        expected: String,
        /// Actual content.
        got: String,
    },
    /// Input that does not suit.
    #[error("{place}: {detail}")]
    Refused {
        /// The place of the input: a line, a field, an object.
        place: String,
        /// The expected and the actual value.
        detail: String,
    },
    /// An error of a part, on another machine.
    #[error("{0}")]
    Remote(String),
    /// A file, the standard input or the standard output.
    #[error("input or output failed: {0}")]
    Io(#[from] std::io::Error),
    /// An error of a statistic.
    #[error(transparent)]
    Analysis(AnalysisError),
    /// A space that cannot be prepared.
    #[error(transparent)]
    Geometry(#[from] GeometryError),
    /// An error of DataFusion: memory, temporary files.
    #[error(transparent)]
    DataFusion(#[from] DataFusionError),
}

impl EngineError {
    /// Input at `place` that does not suit.
    pub(crate) fn refused(place: impl Into<String>, detail: impl Into<String>) -> Self {
        Self::Refused { place: place.into(), detail: detail.into() }
    }

    /// An object that differs from the written one.
    pub(crate) fn damaged(
        object: impl ToString,
        expected: impl Into<String>,
        got: impl Into<String>,
    ) -> Self {
        Self::Damaged { object: object.to_string(), expected: expected.into(), got: got.into() }
    }
}

/// An error of the source of shapes comes out of a statistic as it went in.
impl From<AnalysisError> for EngineError {
    fn from(error: AnalysisError) -> Self {
        match error {
            AnalysisError::Source(error) => error.take().unwrap_or_else(|error| Self::Analysis(error.into())),
            error => Self::Analysis(error),
        }
    }
}

impl From<EngineError> for AnalysisError {
    fn from(error: EngineError) -> Self {
        match error {
            EngineError::Analysis(error) => error,
            error => SourceError::new(error).into(),
        }
    }
}
