//! Refusals of models, at the places in a request that are meant.

use crate::analysis::models::error::ModelError;
use crate::domain::shape::ShapeDescription;
use crate::service::app::ServiceError;
use crate::service::cohorts::attributes;

/// Refusal for an error of a model, which names shapes by their ids; `formula` is the place of its formula.
pub(super) fn refused(error: ModelError, formula: &'static str, shapes: &[ShapeDescription]) -> ServiceError {
    match error {
        error @ ModelError::Unidentified { .. } => ServiceError::invalid("/random", error.to_string()),
        error => refused_at(error, shapes, formula),
    }
}

/// As [`refused`], with the place of errors that do not name it themselves.
pub(in super::super) fn refused_at(
    error: ModelError,
    shapes: &[ShapeDescription],
    other: &str,
) -> ServiceError {
    // Shapes of a stream have no descriptions.
    let place = |shape: usize| {
        shapes.get(shape).map_or_else(|| shape.to_string(), |shape| attributes::name_of(shape).to_owned())
    };
    let (pointer, detail) = match error {
        ModelError::Analysis(error) => return error.into(),
        ModelError::Domain { name, expected, value, shape } => (
            other.to_owned(),
            format!("expected {expected} for '{name}', got {value:e} on the shape '{}'", place(shape)),
        ),
        ModelError::UnknownLevel { name, level, shape } => {
            let detail = format!(
                "expected one of the levels of '{name}', got '{level}' on the shape '{}'",
                place(shape)
            );
            (format!("/levels/{}", name.replace('~', "~0").replace('/', "~1")), detail)
        }
        error @ ModelError::StrataInside { .. } => ("/strata".into(), error.to_string()),
        error @ ModelError::UnequalBlocks { .. } => ("/blocks".into(), error.to_string()),
        error @ ModelError::Covariance { .. } => ("/covariance".into(), error.to_string()),
        error @ ModelError::Multivariate { .. } => ("/manova".into(), error.to_string()),
        error @ ModelError::FewScores { .. } => ("/response".into(), error.to_string()),
        error @ ModelError::NoErrorTerm { .. } => ("/error_terms".into(), error.to_string()),
        error @ (ModelError::EmptyCells { .. } | ModelError::FarFromZero { .. }) => {
            ("/type".into(), error.to_string())
        }
        error @ ModelError::FewShapes { .. } => ("/filter".into(), error.to_string()),
        ref error @ ModelError::UnknownPlace { place, ref name, .. } => {
            (format!("/at/{place}/{}", name.replace('~', "~0").replace('/', "~1")), error.to_string())
        }
        ref error @ ModelError::Undetermined { place, .. } => (format!("/at/{place}"), error.to_string()),
        ModelError::Setting { field, detail } => (format!("/{field}"), detail),
        error => (other.to_owned(), error.to_string()),
    };
    ServiceError::invalid(pointer, detail)
}
