//! Properties of a generator asked for in a query.

use crate::geometry::capability::FieldFault;
use crate::geometry::generator::GeneratorKind;
use crate::geometry::generator::details::GeneratorDetails;
use crate::service::app::ServiceError;

/// Builds and describes a generator.
///
/// # Errors
/// [`ServiceError::Query`] with all faults of the parameters.
pub fn describe(kind: GeneratorKind, count: Option<usize>) -> Result<GeneratorDetails, ServiceError> {
    let text = |FieldFault { field, detail }: FieldFault| match field.as_str() {
        "" => detail,
        field => format!("{field}: {detail}"),
    };
    GeneratorDetails::new(kind, count)
        .map_err(|faults| ServiceError::Query(faults.into_iter().map(text).collect::<Vec<_>>().join("; ")))
}
