//! Properties of a generator asked for in a query.

use crate::geometry::capability::generator::GeneratorDetails;
use crate::geometry::field_fault::FieldFault;
use crate::geometry::generator::GeneratorKind;
use crate::service::app::ServiceError;
use crate::wire::fault::Fault;

/// The fault of a parameter at a place such as `poles/0`; a fault of the whole generator belongs to its name.
pub fn parameter_fault(place: &str, detail: String) -> Fault {
    match place.split_once('/') {
        Some((name, rest)) => Fault::of_parameter(name, format!("at /{rest}: {detail}")),
        None if place.is_empty() => Fault::of_parameter("name", detail),
        None => Fault::of_parameter(place, detail),
    }
}

/// Builds and describes a generator.
///
/// # Errors
/// [`ServiceError::Parameters`] with all faults of the parameters.
pub fn describe(kind: GeneratorKind, count: Option<usize>) -> Result<GeneratorDetails, ServiceError> {
    let fault = |FieldFault { field, detail }| parameter_fault(&field, detail);
    GeneratorDetails::new(kind, count)
        .map_err(|faults| ServiceError::Parameters(faults.into_iter().map(fault).collect()))
}
