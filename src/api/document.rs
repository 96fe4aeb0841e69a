//! The OpenAPI document, generated from the handlers and their types, with the feature `schema`.
//!
//! Responses and headers common to all resources are added here; [`access`] adds who may call an operation, [`answers`] tables and
//! files. [`variants`] names the variants of tagged enums.

mod access;
mod answers;
mod variants;

use std::collections::BTreeSet;

use utoipa::openapi::path::Operation;
use utoipa::openapi::{ContentBuilder, HeaderBuilder, ObjectBuilder, OpenApi, Ref, RefOr, Response, Type};

use super::describe::{PROBLEM, operations_of, problem, refusal};
use super::operation::{self, Needs};
use super::problem;
use super::v1::Paths;
use crate::wire::picture::PictureFormat;

#[derive(utoipa::OpenApi)]
#[openapi(
    info(
        title = "Shapelex",
        description = "Shape statistics as a service: post contours, get template-free alignment, mean shapes and \
                       functional PCA. Errors are problem documents (RFC 9457) with a stable `code`, the JSON pointer of \
                       every bad field and the index of the bad shape.",
        license(name = "Apache-2.0 OR MIT", identifier = "Apache-2.0 OR MIT")
    ),
    components(schemas(problem::ProblemDocument)),
    tags(
        (name = "catalogue", description = "Generators and transformation classes"),
        (name = "statistics", description = "Stateless: everything in the request, nothing stored"),
        (name = "curves", description = "Curves and surfaces: evaluation, measures, fits, paths, deformation"),
        (name = "cohorts", description = "Named sets of shapes and their mean"),
        (name = "images", description = "Shapes from images and volumes"),
        (name = "files", description = "Files of other programs: described, translated, written"),
        (name = "retrieval", description = "Nearest shapes, and distances of all pairs"),
        (name = "jobs", description = "Long-running work: progress, events, cancellation"),
        (name = "dictionaries", description = "Components and sparse atoms learnt from cohorts, and their use"),
        (name = "inference", description = "Permutation tests: comparison of groups, regression, and linear models"),
        (name = "changes", description = "The change feed and the trash"),
        (name = "operation", description = "Version, metrics and the audit trail"),
        (name = "access", description = "Keys (for administrators)"),
        (name = "health", description = "Probes")
    )
)]
struct Document;

/// OpenAPI document of the service.
pub(super) fn openapi() -> OpenApi {
    let mut document = <Document as utoipa::OpenApi>::openapi();
    document.merge(<Paths as utoipa::OpenApi>::openapi());
    complete(&mut document);
    access::describe(&mut document);
    document
}

/// Status codes of limits that apply to every resource except the probes, added where an operation does not describe them itself.
const LIMITS: [(&str, &str); 2] =
    [("429", "Rate limit exceeded"), ("503", "Overloaded, stopping, or over the time limit")];

/// Adds the common parts to all operations: problem documents to all refusals, the limits to all but the probes, and to
/// those under `/v1` the refusals that every operation has. Names the variants of tagged enums. Offers drawings as PNG,
/// answers with numbers as tables, and files in every format.
fn complete(document: &mut OpenApi) {
    variants::name(document);
    for (path, item) in &mut document.paths.paths {
        for (method, operation) in operations_of(item) {
            if path.starts_with("/v1/") {
                add_refusal(operation);
            }
            let row = operation::find(method, path);
            if row.is_some_and(|row| row.needs != Needs::Nothing) {
                add_limits(operation);
            }
            offer_png(operation);
            if media_types(operation).len() == 1 {
                let refused = || refusal("The media type of the answer is not accepted").build().into();
                operation.responses.responses.entry("406".to_owned()).or_insert_with(refused);
            }
            if let Some(table) = row.and_then(|row| row.table) {
                answers::describe_tables(operation, table);
            }
            answers::describe_files(operation);
            if row.is_some_and(operation::Operation::may_be_csv) {
                answers::describe_formulas(operation);
            }
            describe_refusals(operation);
        }
    }
}

/// Media types of the successful answers of an operation.
fn media_types(operation: &Operation) -> BTreeSet<&str> {
    let responses = operation.responses.responses.iter().filter(|(status, _)| status.starts_with('2'));
    let contents = responses.filter_map(|(_, response)| match response {
        RefOr::T(response) => Some(response.content.keys().map(String::as_str)),
        RefOr::Ref(_) => None,
    });
    contents.flatten().collect()
}

/// Gives the problem document to the refusals of an operation.
fn describe_refusals(operation: &mut Operation) {
    let responses = operation.responses.responses.iter_mut();
    let refusals = responses.filter(|(status, _)| status.starts_with(['4', '5']));
    for response in refusals.filter_map(|(_, response)| inline_response(response)) {
        response.content.entry(PROBLEM.into()).or_insert_with(|| problem().into());
    }
}

fn inline_response(response: &mut RefOr<Response>) -> Option<&mut Response> {
    match response {
        RefOr::T(response) => Some(response),
        RefOr::Ref(_) => None,
    }
}

/// Offers as PNG whatever is offered as SVG.
fn offer_png(operation: &mut Operation) {
    for response in operation.responses.responses.values_mut().filter_map(inline_response) {
        if response.content.contains_key(PictureFormat::Svg.media_type()) {
            let file = ContentBuilder::new().schema(Some(Ref::from_schema_name("Binary"))).build();
            response.content.insert(PictureFormat::Png.media_type().into(), file.into());
        }
    }
}

/// Describes the refusal of the request, unless the operation does.
fn add_refusal(operation: &mut Operation) {
    let responses = &mut operation.responses.responses;
    if responses.contains_key("400") || responses.contains_key("4XX") {
        return;
    }
    let refused = if operation.request_body.is_some() { "input" } else { "request" };
    responses.insert("4XX".into(), refusal(format!("The {refused} was refused")).build().into());
}

fn add_limits(operation: &mut Operation) {
    for (status, description) in LIMITS {
        let retry_after = HeaderBuilder::new()
            .schema(Some(ObjectBuilder::new().schema_type(Type::Integer)))
            .description(Some("Seconds"))
            .build();
        let response = refusal(description).header("Retry-After", retry_after).build();
        operation.responses.responses.entry(status.to_owned()).or_insert(response.into());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::interface;
    use crate::api::operation::{ANY_FILE, OPERATIONS};
    use crate::api::v1::files::written_media_types;
    use crate::wire::columns::ColumnsFormat;

    #[test]
    fn the_committed_document_is_the_present_one() {
        let present = interface::document().unwrap();
        assert!(
            present == interface::committed().unwrap(),
            "openapi/openapi.json is old: run `cargo run --features schema -- openapi > openapi/openapi.json`"
        );
    }

    #[test]
    fn the_rows_of_the_operations_are_those_of_the_document() {
        let mut document = openapi();
        let mut described = 0;
        for (path, item) in &mut document.paths.paths {
            for (method, found) in operations_of(item) {
                described += 1;
                let row =
                    operation::find(method, path).unwrap_or_else(|| panic!("{method} {path} has no row"));
                assert_eq!(found.operation_id.as_deref(), Some(row.id), "{method} {path}");
                let mut offered: BTreeSet<&str> = row.answers.iter().copied().collect();
                if offered.contains(ANY_FILE) {
                    offered.extend(written_media_types());
                }
                if row.table.is_some() {
                    offered.extend(ColumnsFormat::ALL.map(ColumnsFormat::media_type));
                }
                assert_eq!(media_types(found), offered, "{method} {path}");
            }
        }
        assert_eq!(described, OPERATIONS.len());
    }
}
