//! Answers that are tables or files, in the OpenAPI document.

use utoipa::openapi::path::{Operation, ParameterBuilder};
use utoipa::openapi::{ContentBuilder, ObjectBuilder, Ref, RefOr, Type};

use crate::api::describe::text_parameter;
use crate::api::formulas::{FORMULAS, VALUES};
use crate::api::operation::ANY_FILE;
use crate::api::v1::files::written_media_types;
use crate::wire::columns::ColumnsFormat;

/// Describes the tables of an operation.
pub(super) fn describe_tables(operation: &mut Operation, table: &str) {
    for (status, response) in &mut operation.responses.responses {
        let RefOr::T(response) = response else { continue };
        if !matches!(status.as_str(), "200" | "201") || !response.content.contains_key("application/json") {
            continue;
        }
        for format in ColumnsFormat::ALL {
            let content = match format {
                ColumnsFormat::Csv => {
                    ContentBuilder::new().schema(Some(ObjectBuilder::new().schema_type(Type::String)))
                }
                _ => ContentBuilder::new().schema(Some(Ref::from_schema_name("Binary"))),
            };
            response.content.entry(format.media_type().into()).or_insert_with(|| content.build().into());
        }
    }
    let names = "`csv`, `arrow`, `parquet`, `npy` or `npz` of a table";
    let parameters = operation.parameters.get_or_insert_default();
    let known = parameters.iter_mut().find_map(|parameter| match parameter {
        RefOr::T(parameter) if parameter.name == "format" => Some(parameter),
        _ => None,
    });
    if let Some(format) = known {
        let said = format.description.take().unwrap_or_default();
        format.description = Some(format!("{}; {names}", said.trim_end_matches('.')));
    } else {
        let said = format!("`json`; {names}. Default: as the header `Accept` asks, else `json`");
        parameters.push(RefOr::T(text_parameter("format", said)));
    }
    let said = format!(
        "With a format of tables: the list of the answer that is the table, by its path; `answer` for the answer as one row. \
         Default: `{table}`"
    );
    parameters.push(RefOr::T(text_parameter("table", said)));
    parameters.push(RefOr::T(text_parameter("column", "With `npy`: the column that is the array")));
}

/// Describes the treatment of formulas in CSV.
pub(super) fn describe_formulas(operation: &mut Operation) {
    let said = "With CSV: `escape` puts an apostrophe before texts that spreadsheets would run as formulas. Default: `keep`";
    let parameter = ParameterBuilder::from(text_parameter(FORMULAS, said));
    let words = ObjectBuilder::new().schema_type(Type::String).enum_values(Some(VALUES));
    let parameter = parameter.schema(Some(words)).build();
    operation.parameters.get_or_insert_default().push(RefOr::T(parameter));
}

/// Describes the answers of an operation that writes files: in the media type of any format.
pub(super) fn describe_files(operation: &mut Operation) {
    let media_types: Vec<&str> = written_media_types().collect();
    for response in operation.responses.responses.values_mut() {
        let RefOr::T(response) = response else { continue };
        let Some(file) = response.content.get(ANY_FILE).cloned() else { continue };
        for media_type in &media_types {
            response.content.entry((*media_type).into()).or_insert_with(|| file.clone());
        }
    }
}
