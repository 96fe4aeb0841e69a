//! Responses and headers common to all resources, added to the OpenAPI document in one place.

use utoipa::openapi::path::Operation;
use utoipa::openapi::{ContentBuilder, HeaderBuilder, ObjectBuilder, OpenApi, Ref, ResponseBuilder, Type};

/// Status codes of limits that apply to every resource, added where an operation does not describe them itself.
const LIMITS: [(&str, &str); 2] =
    [("429", "Rate limit exceeded"), ("503", "Overloaded, stopping, or over the time limit")];

/// Adds the common parts to all operations under `/v1`.
pub(super) fn complete(document: &mut OpenApi) {
    let resources = document.paths.paths.iter_mut().filter(|(path, _)| path.starts_with("/v1/"));
    for (_, item) in resources {
        let methods = [&mut item.get, &mut item.post, &mut item.put, &mut item.patch, &mut item.delete];
        methods.into_iter().flatten().for_each(add_limits);
    }
}

fn add_limits(operation: &mut Operation) {
    for (status, description) in LIMITS {
        let retry_after = HeaderBuilder::new()
            .schema(Some(ObjectBuilder::new().schema_type(Type::Integer)))
            .description(Some("Seconds"))
            .build();
        let problem = ContentBuilder::new().schema(Some(Ref::from_schema_name("ProblemDocument"))).build();
        let response = ResponseBuilder::new()
            .description(description)
            .header("Retry-After", retry_after)
            .content("application/problem+json", problem)
            .build();
        operation.responses.responses.entry(status.to_owned()).or_insert(response.into());
    }
}
