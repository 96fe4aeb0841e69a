//! Catalogue of generators and transformation classes with their properties.

#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::wire::fault::Fault;
use axum::Json;
use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;
use serde_json::{Map, Value};

use crate::analysis::transformation::{ClassName, TransformationClass};
use crate::api::extract::{BesideFormat, Caller, Format, NoQuery, Path, TWICE};
use crate::api::problem::Problem;
use crate::api::respond::{compute, json, picture};
use crate::api::v1::requests::request_macros::{class_names, rows};
use crate::geometry::capability::generator::GeneratorDetails;
use crate::geometry::generator::{GeneratorKind, GeneratorProperties};
use crate::service::app::{ServiceError, Work};
use crate::service::shapes::generators;
use crate::wire::representation::read_generator;

/// Generator of the catalogue.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct GeneratorEntry {
    /// The generator, as written in a representation.
    generator: GeneratorKind,
    #[serde(flatten)]
    properties: GeneratorProperties,
}

/// The generators of the catalogue.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct Generators {
    /// All generators.
    items: Vec<GeneratorEntry>,
}

/// Lists the generators.
#[utoipa::path(get, path = "/v1/generators", tag = "catalogue",
    responses((status = 200, description = "The generators with their properties", body = Generators), (status = 400, description = "An unknown parameter")))]
pub(in crate::api::v1) async fn list_generators(_: NoQuery) -> Json<Generators> {
    let entry = |generator: GeneratorKind| GeneratorEntry { properties: generator.properties(), generator };
    Json(Generators { items: GeneratorKind::catalogue().into_iter().map(entry).collect() })
}

/// A generator, instantiated for a number of control points.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct GeneratorPage {
    #[serde(flatten)]
    entry: GeneratorEntry,
    /// Number of control points of a closed curve, or of intervals of an open one, that the generator is instantiated for.
    control_points: usize,
    /// Poles of the functions it reproduces, `[re, im]` on the integer grid of the knots.
    poles: Vec<[f64; 2]>,
    /// Riesz bounds of its integer shifts.
    riesz_bounds: RieszBounds,
    /// Weights of an interpolator: of its B-splines in increasing order, or of the half-integer shifts 0, 1, ….
    weights: Option<Vec<f64>>,
    /// Condition number (1-norm) of the system that determines the weights.
    condition: Option<f64>,
    /// Warnings about the generator.
    warnings: Vec<String>,
}

/// Riesz bounds: `A² Σ|c|² ≤ ‖Σ c[k] φ(· − k)‖² ≤ B² Σ|c|²`, the extremes of `Σ_k |φ̂(ω + 2πk)|²`.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct RieszBounds {
    /// Lower bound `A²`.
    lower_squared: f64,
    /// Upper bound `B²`.
    upper_squared: f64,
}

/// Describes a generator for a number of control points: support, smoothness, reproduced functions, Riesz bounds.
///
/// Query parameters are those of the generator in a representation, with lists written as JSON. As SVG: the generator and
/// its derivative.
#[utoipa::path(get, path = "/v1/generators/{name}", tag = "catalogue",
    params(
        ("name" = String, Path, description = "`trigonometric`, `cubic`, `bspline`, `exponential`, `shifted_exponential` or `interpolator`"),
        ("control_points" = Option<usize>, Query, description = "Control points (closed) or intervals (open). \
                                                                 Default: 8, or the fewest if these are more"),
        ("degree" = Option<u8>, Query, description = "Degree of `bspline`", minimum = 1, maximum = 5),
        ("family" = Option<String>, Query, description = "Family of `interpolator`: `integer_shifts` or \
                                                          `half_integer_shifts`"),
        ("poles" = Option<String>, Query, description = "Poles such as `[[0,0],[0,0.5],[0,-0.5]]`", example = "[[0,0],[0,0.5],[0,-0.5]]"),
        ("domain_poles" = Option<String>, Query, description = "Poles of the domain, instead of `poles`"),
        ("support" = Option<usize>, Query, description = "Support of `interpolator`"),
        ("weights" = Option<String>, Query, description = "Weights of `interpolator`, such as `[-0.5]`"),
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery
    ),
    responses(
        (status = 200, description = "The generator", content((GeneratorPage = "application/json"), (String = "image/svg+xml"))),
        (status = "4XX", description = "The parameters were refused")
    ))]
pub(in crate::api::v1) async fn find_generator(
    Caller(app): Caller,
    Path(name): Path<String>,
    format: Format,
    BesideFormat(parameters): BesideFormat<Vec<(String, String)>>,
) -> Result<Response, Problem> {
    let details = read_query(name, parameters).and_then(|(kind, count)| generators::describe(kind, count))?;
    if let Format::Picture(file) = format {
        return compute(app.weighing(Work::MOMENT + format.work()), move |_| picture(&details.draw(), &file))
            .await;
    }
    Ok(json(StatusCode::OK, &GeneratorPage::from(details))?)
}

/// Reads a generator and a number of control points from a query; each value is JSON or plain text.
fn read_query(
    name: String,
    parameters: Vec<(String, String)>,
) -> Result<(GeneratorKind, Option<usize>), ServiceError> {
    let (mut fields, mut count) = (Map::new(), None);
    for (key, text) in parameters {
        if key == "control_points" {
            let parsed = text.parse::<usize>();
            let number = parsed.map_err(|_| {
                let detail = format!("expected a non-negative whole number, got '{text}'");
                ServiceError::parameter("control_points", detail)
            })?;
            if count.replace(number).is_some() {
                return Err(ServiceError::parameter("control_points", TWICE));
            }
            continue;
        }
        let value = serde_json::from_str(&text).unwrap_or(Value::String(text));
        if key == "name" || fields.insert(key.clone(), value).is_some() {
            return Err(ServiceError::parameter(key, TWICE));
        }
    }
    let known =
        ["trigonometric", "cubic", "keys", "bspline", "exponential", "shifted_exponential", "interpolator"];
    if !known.contains(&name.as_str()) {
        return Err(ServiceError::NotFound { kind: "generator", key: name });
    }
    fields.insert("name".into(), Value::String(name));
    let as_parameter =
        |error: Fault| generators::parameter_fault(error.pointer.trim_start_matches('/'), error.detail);
    let as_query =
        |errors: Vec<Fault>| ServiceError::Parameters(errors.into_iter().map(as_parameter).collect());
    read_generator(Value::Object(fields)).map(|kind| (kind, count)).map_err(as_query)
}

impl From<GeneratorDetails> for GeneratorPage {
    fn from(details: GeneratorDetails) -> Self {
        let GeneratorDetails { kind, count, built, riesz_squared: (lower, upper), warnings } = details;
        Self {
            entry: GeneratorEntry { properties: kind.properties(), generator: kind },
            control_points: count,
            poles: built.poles.list(),
            riesz_bounds: RieszBounds { lower_squared: lower, upper_squared: upper },
            weights: built.weights.clone(),
            condition: built.condition,
            warnings,
        }
    }
}

/// Transformation class of the catalogue.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct TransformationEntry {
    /// Name of the class.
    name: ClassName,
    /// Whether the class includes translations.
    translation: bool,
    /// Dimensions in which shapes can be projected onto the class.
    #[schema(example = json!([2, 3]))]
    projection_dimensions: Vec<usize>,
    /// Whether Procrustes alignment is available.
    procrustes: bool,
    /// Basis of the class in the plane; null if it has none.
    planar_basis: Option<Vec<Vec<Vec<f64>>>>,
}

/// The transformation classes of the catalogue.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct Transformations {
    /// All transformation classes.
    items: Vec<TransformationEntry>,
}

/// Lists the transformation classes.
#[utoipa::path(get, path = "/v1/transformations", tag = "catalogue",
    responses((status = 200, description = "The classes with their properties", body = Transformations), (status = 400, description = "An unknown parameter")))]
pub(in crate::api::v1) async fn list_transformations(_: NoQuery) -> Json<Transformations> {
    let entry = |name: ClassName| TransformationEntry {
        name,
        translation: name.translates(),
        projection_dimensions: name.projection_dimensions().to_vec(),
        procrustes: name.procrustes(),
        planar_basis: TransformationClass::named(name, 2)
            .ok()
            .map(|c| c.matrices().iter().map(rows).collect()),
    };
    Json(Transformations { items: class_names().map(entry).collect() })
}
