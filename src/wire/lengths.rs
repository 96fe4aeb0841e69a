//! Units of coordinates in requests and answers.

use serde::{Deserialize, Serialize};

use super::fault::brief;
use super::unit::{Ratio, Unit};

/// The unit that a text names.
///
/// # Errors
/// The fault of another text.
pub fn unit_of(text: &str) -> Result<Unit, String> {
    Unit::find(text).ok_or_else(|| format!("expected one of {}, got '{}'", Unit::words(), brief(text.into())))
}

/// Units of a file and of the cohort or dictionary that takes its shapes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct FileUnits {
    /// Unit that the file states, or that the request gives it.
    #[schema(example = "mm")]
    file: String,
    /// Unit of the shapes as they are stored, or asked about.
    #[schema(example = "cm")]
    stored: String,
    /// Number by which coordinates were multiplied. Powers of ten are divisions where it is below 1, so that 1 mm is 0.1 cm.
    factor: f64,
    /// Whether the cohort had neither a unit nor shapes, and has taken the unit of the file.
    adopted: bool,
}

impl FileUnits {
    /// Units of shapes that were converted.
    pub fn new(file: Unit, stored: Unit, adopted: bool) -> Self {
        let factor = file.to(stored).unwrap_or(Ratio::ONE).value();
        Self { file: file.word().into(), stored: stored.word().into(), factor, adopted }
    }

    /// One line about them, if there is anything to say.
    pub fn sentence(&self) -> Option<String> {
        let Self { file, stored, factor, adopted } = self;
        match (*adopted, *factor == 1.0) {
            (true, _) => Some(format!("the cohort takes the unit of the file, {stored}")),
            (false, false) => Some(format!("converted from {file} to {stored}")),
            (false, true) => None,
        }
    }
}
