//! Errors of the crate.

use shapelex_analysis::AnalysisError;
use shapelex_analysis::inference::error::StudyError;
use shapelex_analysis::models::error::ModelError;
use shapelex_formats::shape::FileError;

/// Why a request cannot be answered.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A shape that does not fit.
    #[error("shape {index}: {detail}")]
    Shape {
        /// Position of the shape, from 0.
        index: usize,
        /// The expected and the given property of the shape.
        detail: String,
    },
    /// A setting that does not fit the shapes.
    #[error("{field}: {detail}")]
    Setting {
        /// Name of the setting.
        field: &'static str,
        /// The expected and the given value.
        detail: String,
    },
    /// A file that cannot be opened.
    #[error("{path}: {source}")]
    Open {
        /// The path.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// A file that cannot be read, with the place of the fault.
    #[error(transparent)]
    File(#[from] FileError),
    /// Shapes that cannot be computed with.
    #[error(transparent)]
    Analysis(#[from] AnalysisError),
    /// Groups or attributes that cannot be compared.
    #[error(transparent)]
    Study(#[from] StudyError),
    /// A linear model that cannot be fitted.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// A result of the crate.
pub type Result<T> = std::result::Result<T, Error>;
