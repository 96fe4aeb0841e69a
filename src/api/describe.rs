//! Parts of the OpenAPI document that several of its descriptions use.

use utoipa::openapi::path::{Operation, Parameter, ParameterBuilder, ParameterIn, PathItem};
use utoipa::openapi::{Content, ContentBuilder, ObjectBuilder, Ref, Required, ResponseBuilder, Type};

/// Media type of problem documents.
pub(super) const PROBLEM: &str = "application/problem+json";

/// A response with a problem document.
pub(super) fn refusal(description: impl Into<String>) -> ResponseBuilder {
    ResponseBuilder::new().description(description).content(PROBLEM, problem())
}

/// A query parameter that is a text and may be absent.
pub(super) fn text_parameter(name: &str, description: impl Into<String>) -> Parameter {
    ParameterBuilder::new()
        .name(name)
        .parameter_in(ParameterIn::Query)
        .required(Required::False)
        .description(Some(description))
        .schema(Some(ObjectBuilder::new().schema_type(Type::String)))
        .build()
}

/// Content that is a problem document.
pub(super) fn problem() -> Content {
    ContentBuilder::new().schema(Some(Ref::from_schema_name("ProblemDocument"))).build()
}

/// Operations of a path, with their methods.
pub(super) fn operations_of(item: &mut PathItem) -> impl Iterator<Item = (&'static str, &mut Operation)> {
    let methods = [
        ("GET", item.get.as_mut()),
        ("POST", item.post.as_mut()),
        ("PUT", item.put.as_mut()),
        ("PATCH", item.patch.as_mut()),
        ("DELETE", item.delete.as_mut()),
    ];
    methods.into_iter().filter_map(|(method, operation)| Some((method, operation?)))
}
