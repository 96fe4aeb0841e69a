//! Conditions in the OpenAPI document.

use utoipa::openapi::schema::{AnyOfBuilder, ArrayBuilder, ObjectBuilder, Schema, SchemaType, Type};
use utoipa::openapi::{Ref, RefOr};
use utoipa::{PartialSchema, ToSchema};

use super::Condition;

/// A value of a filter in the OpenAPI document.
fn value_schema() -> ObjectBuilder {
    ObjectBuilder::new().schema_type(SchemaType::from_iter([Type::String, Type::Number, Type::Boolean]))
}

/// Name of the schema of operators with their values.
const OPERATORS_SCHEMA: &str = "ConditionOperators";

fn operators_schema() -> RefOr<Schema> {
    let described = [
        ("eq", "The attribute has this value, or one of a list."),
        ("ne", "The attribute has another value than this or those of a list, or is missing."),
        ("gte", "The attribute is at least this: a number, a text or a time."),
        ("gt", "The attribute is above this."),
        ("lte", "The attribute is at most this."),
        ("lt", "The attribute is below this."),
    ];
    let object =
        ObjectBuilder::new().title(Some("Operators")).description(Some("Operators with their values."));
    let object = described.into_iter().fold(object, |object, (name, what)| match name {
        "eq" | "ne" => {
            let list = ArrayBuilder::new().items(value_schema());
            object.property(name, AnyOfBuilder::new().item(value_schema()).item(list).description(Some(what)))
        }
        _ => object.property(name, value_schema().description(Some(what))),
    });
    object.into()
}

impl PartialSchema for Condition {
    fn schema() -> RefOr<Schema> {
        let what =
            "Condition on an attribute: a value, a list of which it has one, or operators with values.";
        AnyOfBuilder::new()
            .item(value_schema().title(Some("Value")))
            .item(ArrayBuilder::new().items(value_schema()).title(Some("Values")))
            .item(Ref::from_schema_name(OPERATORS_SCHEMA))
            .description(Some(what))
            .into()
    }
}

impl ToSchema for Condition {
    fn schemas(schemas: &mut Vec<(String, RefOr<Schema>)>) {
        schemas.push((OPERATORS_SCHEMA.into(), operators_schema()));
    }
}
