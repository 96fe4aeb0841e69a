//! The catalogue: generators and transformation classes with their properties.

use axum::Json;
use serde::Serialize;

use super::settings::{class_names, rows};
use crate::analysis::transformation::{ClassName, TransformationClass};
use crate::api::extract::NoQuery;
use crate::api::problem::ProblemDocument;
use crate::geometry::generator::{GeneratorKind, GeneratorProperties};

/// A generator of the catalogue.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct GeneratorEntry {
    /// How it stands in a representation.
    generator: GeneratorKind,
    #[serde(flatten)]
    properties: GeneratorProperties,
}

/// The generators.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Generators {
    /// All of them.
    items: Vec<GeneratorEntry>,
}

/// Lists the generators.
#[utoipa::path(get, path = "/generators", tag = "catalogue",
    responses((status = 200, description = "The generators with their properties", body = Generators), (status = 400, description = "An unknown parameter", body = ProblemDocument, content_type = "application/problem+json")))]
pub(super) async fn list_generators(_: NoQuery) -> Json<Generators> {
    let entry = |generator: GeneratorKind| GeneratorEntry { properties: generator.properties(), generator };
    Json(Generators { items: GeneratorKind::catalogue().into_iter().map(entry).collect() })
}

/// A transformation class of the catalogue.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct TransformationEntry {
    /// Its name.
    name: ClassName,
    /// Whether translations belong to it.
    translation: bool,
    /// Dimensions in which it can be projected on.
    #[schema(example = json!([2, 3]))]
    projection_dimensions: Vec<usize>,
    /// Whether Procrustes alignment is offered.
    procrustes: bool,
    /// Its basis in the plane, where it has one.
    planar_basis: Option<Vec<Vec<Vec<f64>>>>,
}

/// The transformation classes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct Transformations {
    /// All of them.
    items: Vec<TransformationEntry>,
}

/// Lists the transformation classes.
#[utoipa::path(get, path = "/transformations", tag = "catalogue",
    responses((status = 200, description = "The classes with their properties", body = Transformations), (status = 400, description = "An unknown parameter", body = ProblemDocument, content_type = "application/problem+json")))]
pub(super) async fn list_transformations(_: NoQuery) -> Json<Transformations> {
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
