//! Variants of tagged enums, by name, in the OpenAPI document.
//!
//! The derived schema of a tagged enum is a `oneOf` of schemas without a name; a variant that holds a struct is an `allOf` of
//! that struct and of an object with the tag. Generators of clients invent names for the former (`RepresentationType0`).
//! Where the struct is a choice itself, they give up on the latter, and with it on every operation that uses the enum.
//!
//! [`name`] makes each variant a separate schema: one object with all of its fields, named after the enum and the value of
//! the tag (`RepresentationClosedCurve`). The enum refers to these schemas, with a discriminator; the tag of each is a `const`.
//! Structs that only variants held are dropped.

use std::collections::{BTreeMap, BTreeSet};

use serde_json::Value;
use utoipa::openapi::extensions::Extensions;
use utoipa::openapi::schema::{Components, Discriminator, Object, OneOf};
use utoipa::openapi::{OpenApi, Ref, RefOr, Schema};

type Schemas = BTreeMap<String, RefOr<Schema>>;

/// Names the variants of all tagged enums of a document.
pub(super) fn name(document: &mut OpenApi) {
    let Some(Components { schemas, .. }) = &mut document.components else { return };
    let mut held = BTreeSet::new();
    let found: Vec<(String, Tagged)> = schemas
        .iter()
        .filter_map(|(name, schema)| Some((name.clone(), Tagged::of(schema, schemas, &mut held)?)))
        .collect();
    for (name, tagged) in found {
        tagged.replace(&name, schemas);
    }
    let used = references(document);
    let Some(Components { schemas, .. }) = &mut document.components else { return };
    schemas.retain(|name, _| !held.contains(name) || used.contains(name));
}

/// A tagged enum.
struct Tagged {
    /// Property whose value tells the variants apart.
    tag: String,
    /// Value of the tag and fields of every variant.
    variants: Vec<(String, Object)>,
}

impl Tagged {
    /// The tagged enum that a schema describes, if it does; names of schemas that its variants hold go to `held`.
    fn of(schema: &RefOr<Schema>, schemas: &Schemas, held: &mut BTreeSet<String>) -> Option<Self> {
        let RefOr::T(Schema::OneOf(choice)) = schema else { return None };
        let mut parts = BTreeSet::new();
        let inline = |item: &RefOr<Schema>| matches!(item, RefOr::T(_));
        let objects = choice.items.iter().filter(|item| inline(item));
        let objects: Vec<Object> = objects.filter_map(|item| flat(item, schemas, &mut parts)).collect();
        let tag = tag(&objects).filter(|_| objects.len() == choice.items.len())?;
        held.append(&mut parts);
        let value = |object: &Object| constant(object, &tag).map(str::to_owned);
        let variants = objects.into_iter().filter_map(|object| Some((value(&object)?, object))).collect();
        Some(Self { tag, variants })
    }

    /// Makes each variant a separate schema, and `name` the choice between them.
    fn replace(self, name: &str, schemas: &mut Schemas) {
        let Some(RefOr::T(Schema::OneOf(choice))) = schemas.get_mut(name) else { return };
        let named: Vec<(String, String, Object)> = self
            .variants
            .into_iter()
            .map(|(value, object)| (format!("{name}{}", pascal(&value)), value, object))
            .collect();
        let location = |own: &str| Ref::from_schema_name(own).ref_location;
        let mapping = named.iter().map(|(own, value, _)| (value.clone(), location(own)));
        *choice = OneOf {
            discriminator: Some(Discriminator::with_mapping(&self.tag, mapping)),
            items: named.iter().map(|(own, ..)| Ref::from_schema_name(own).into()).collect(),
            ..std::mem::take(choice)
        };
        for (own, value, object) in named {
            let mut object = with_constant(object, &self.tag, &value);
            object.title = Some(own.clone());
            let previous = schemas.insert(own, Schema::Object(object).into());
            debug_assert!(previous.is_none(), "a type has the name of the variant {value} of {name}");
        }
    }
}

/// Property that has one constant in every object, and another one in each.
fn tag(objects: &[Object]) -> Option<String> {
    let tells_apart = |name: &&String| {
        let values: BTreeSet<&str> = objects.iter().filter_map(|object| constant(object, name)).collect();
        values.len() == objects.len()
    };
    objects.first()?.properties.keys().find(tells_apart).cloned()
}

/// The only value that a property may have, if there is one.
fn constant<'a>(object: &'a Object, property: &str) -> Option<&'a str> {
    match object.properties.get(property)? {
        RefOr::T(Schema::Object(Object { enum_values: Some(values), .. })) => match &values[..] {
            [Value::String(value)] => Some(value),
            _ => None,
        },
        _ => None,
    }
}

/// The object with its tag as the first property, written as `const`, which the builders of utoipa do not know.
fn with_constant(mut object: Object, tag: &str, value: &str) -> Object {
    let mut property = Object::default();
    property.extensions = Some(Extensions::from_iter([("const", value)]));
    property.schema_type = utoipa::openapi::Type::String.into();
    object.properties.shift_remove(tag);
    object.properties.shift_insert(0, tag.to_owned(), Schema::Object(property).into());
    object.required.retain(|name| name != tag);
    object.required.insert(0, tag.to_owned());
    object
}

/// The object that a schema describes, with all of its fields in one place; none where it describes no object. An `allOf`
/// has the fields of all of its parts. A `oneOf` has those of all of its choices, and requires those that all of them require.
/// Names of schemas that were followed go to `held`.
fn flat(schema: &RefOr<Schema>, schemas: &Schemas, held: &mut BTreeSet<String>) -> Option<Object> {
    match schema {
        RefOr::Ref(reference) => {
            let name = schema_name(&reference.ref_location)?;
            held.insert(name.to_owned());
            flat(schemas.get(name)?, schemas, held)
        }
        RefOr::T(Schema::Object(object)) if !object.properties.is_empty() => Some(object.clone()),
        RefOr::T(Schema::AllOf(all)) => {
            let parts: Option<Vec<Object>> = all.items.iter().map(|part| flat(part, schemas, held)).collect();
            let mut object = joined(parts?, |one, other| one.extend(other));
            object.description = all.description.clone();
            Some(object)
        }
        RefOr::T(Schema::OneOf(choice)) => {
            let parts: Option<Vec<Object>> =
                choice.items.iter().map(|part| flat(part, schemas, held)).collect();
            Some(joined(parts?, |one, other| one.retain(|name| other.contains(name))))
        }
        RefOr::T(_) => None,
    }
}

/// One object with the fields of all `parts`; `require` joins the names of those that are required.
fn joined(parts: Vec<Object>, require: impl Fn(&mut Vec<String>, Vec<String>)) -> Object {
    let mut parts = parts.into_iter();
    let first = parts.next().unwrap_or_default();
    let mut object = Object::default();
    (object.schema_type, object.required, object.properties) =
        (first.schema_type, first.required, first.properties);
    for part in parts {
        require(&mut object.required, part.required);
        object.properties.extend(part.properties);
    }
    object
}

/// Name of the schema at a location in the document.
fn schema_name(location: &str) -> Option<&str> {
    location.strip_prefix("#/components/schemas/")
}

/// Names of the schemas that something refers to: an operation, or a schema that is referred to itself.
fn references(document: &OpenApi) -> BTreeSet<String> {
    let text = serde_json::to_value(document).unwrap_or_default();
    let (mut found, mut next) = (BTreeSet::new(), BTreeSet::new());
    collect(&text["paths"], &mut next);
    while let Some(name) = next.pop_first() {
        let mut further = BTreeSet::new();
        collect(&text["components"]["schemas"][name], &mut further);
        found.insert(name.to_owned());
        next.extend(further.into_iter().filter(|name| !found.contains(*name)));
    }
    found
}

/// Adds the names of the schemas that a part of a document refers to.
fn collect<'a>(part: &'a Value, found: &mut BTreeSet<&'a str>) {
    match part {
        Value::Object(fields) => {
            let reference = fields.get("$ref").and_then(Value::as_str);
            found.extend(reference.and_then(schema_name));
            fields.values().for_each(|part| collect(part, found));
        }
        Value::Array(items) => items.iter().for_each(|part| collect(part, found)),
        _ => {}
    }
}

/// `closed_curve` as `ClosedCurve`.
fn pascal(word: &str) -> String {
    let capital = |part: &str| {
        let mut letters = part.chars();
        letters.next().map(|first| first.to_ascii_uppercase().to_string() + letters.as_str())
    };
    word.split('_').filter_map(capital).collect()
}

#[cfg(test)]
mod tests {
    use serde_json::json;
    use utoipa::{PartialSchema, ToSchema};

    use super::*;

    /// Extent of something.
    #[derive(ToSchema)]
    #[serde(rename_all = "snake_case")]
    #[allow(dead_code, reason = "only its schema is read")]
    enum Extent {
        /// Radius.
        Radius(f64),
        /// Diameter.
        Diameter(f64),
    }

    /// Figure, by its kind.
    #[derive(ToSchema)]
    #[serde(tag = "kind", rename_all = "snake_case")]
    #[allow(dead_code, reason = "only its schema is read")]
    enum Figure {
        /// Round.
        FullCircle {
            /// Name.
            name: Option<String>,
            #[serde(flatten)]
            extent: Extent,
        },
        /// Cornered.
        Square(Square),
    }

    /// Side of a square.
    #[derive(ToSchema)]
    #[allow(dead_code, reason = "only its schema is read")]
    struct Square {
        side: f64,
    }

    /// A number, or the name of one.
    #[derive(ToSchema)]
    #[serde(untagged)]
    #[allow(dead_code, reason = "only its schema is read")]
    enum Number {
        /// By value.
        Value(f64),
        /// By name.
        Named { name: String },
    }

    /// A document with these schemas, to all of which but `Extent` and `Square` something refers.
    fn schemas() -> Value {
        let schema = |name: &str, schema: RefOr<Schema>| (name.to_owned(), schema);
        let mut components = Components::new();
        components.schemas = BTreeMap::from([
            schema("Figure", Figure::schema()),
            schema("Extent", Extent::schema()),
            schema("Square", Square::schema()),
            schema("Number", Number::schema()),
        ]);
        let mut document = OpenApi::default();
        document.components = Some(components);
        name(&mut document);
        serde_json::to_value(document).unwrap()["components"]["schemas"].take()
    }

    #[test]
    fn variants_are_schemas_of_their_own_with_a_discriminator() {
        let schemas = schemas();
        let figure = json!({
            "description": "Figure, by its kind.",
            "oneOf": [
                {"$ref": "#/components/schemas/FigureFullCircle"},
                {"$ref": "#/components/schemas/FigureSquare"},
            ],
            "discriminator": {"propertyName": "kind", "mapping": {
                "full_circle": "#/components/schemas/FigureFullCircle",
                "square": "#/components/schemas/FigureSquare",
            }},
        });
        assert_eq!(schemas["Figure"], figure);
        let square = json!({
            "title": "FigureSquare", "description": "Cornered.", "type": "object",
            "required": ["kind", "side"],
            "properties": {
                "kind": {"type": "string", "const": "square"},
                "side": {"type": "number", "format": "double"},
            },
        });
        assert_eq!(schemas["FigureSquare"], square);
    }

    #[test]
    fn a_choice_within_a_variant_becomes_fields_of_which_none_is_required() {
        let circle = &schemas()["FigureFullCircle"];
        assert_eq!(circle["required"], json!(["kind"]));
        let fields: Vec<&String> = circle["properties"].as_object().unwrap().keys().collect();
        assert_eq!(fields, ["diameter", "kind", "name", "radius"]);
        assert_eq!(circle["description"], "Round.");
    }

    #[test]
    fn structs_that_only_variants_held_are_dropped_and_nothing_else() {
        let schemas = schemas();
        let names: Vec<&String> = schemas.as_object().unwrap().keys().collect();
        assert_eq!(names, ["Figure", "FigureFullCircle", "FigureSquare", "Number"]);
        let number: Value = serde_json::to_value(Number::schema()).unwrap();
        assert_eq!(schemas["Number"], number, "an enum without a tag stays as it is");
    }

    #[test]
    fn what_an_operation_refers_to_stays() {
        let square = json!({"description": "A square.", "content": {"application/json": {
            "schema": {"$ref": "#/components/schemas/Square"}}}});
        let document = json!({
            "openapi": "3.1.0", "info": {"title": "", "version": ""},
            "paths": {"/square": {"get": {"responses": {"200": square}}}},
            "components": {"schemas": {"Figure": Figure::schema(), "Square": Square::schema(),
                "Extent": Extent::schema()}},
        });
        let mut document: OpenApi = serde_json::from_value(document).unwrap();
        name(&mut document);
        let names: Vec<&String> = document.components.as_ref().unwrap().schemas.keys().collect();
        assert_eq!(names, ["Figure", "FigureFullCircle", "FigureSquare", "Square"]);
    }

    #[test]
    fn words_of_tags_become_names() {
        assert_eq!(pascal("closed_curve"), "ClosedCurve");
        assert_eq!(pascal("landmarks"), "Landmarks");
        assert_eq!(pascal("figure_eight_2"), "FigureEight2");
    }
}
