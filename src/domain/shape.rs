//! Shapes of a cohort.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Attributes of a shape besides its geometry.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ShapeAttributes {
    /// Identifier assigned by the client, unique in the cohort.
    pub external_id: Option<String>,
    /// Opaque identifier of the subject it belongs to.
    pub subject: Option<String>,
    /// Class label.
    pub label: Option<String>,
    /// Additional attributes, each a string, a number or a Boolean.
    pub labels: BTreeMap<String, serde_json::Value>,
    /// Positive weight in means. Default: 1.
    pub weight: f64,
    /// Arbitrary client data, as compact JSON with sorted field names.
    pub metadata: Option<String>,
}

/// A shape about to be stored.
#[derive(Debug, Clone, PartialEq)]
pub struct NewShape {
    /// Identifier, `shp_…`.
    pub id: String,
    /// Attributes besides the geometry.
    pub attributes: ShapeAttributes,
    /// Control points, coordinate-major, `N·d` numbers.
    pub control_points: Vec<f64>,
}

/// A stored shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// Identifier, `shp_…`.
    pub id: String,
    /// Attributes besides the geometry.
    pub attributes: ShapeAttributes,
    /// Control points, coordinate-major, `N·d` numbers.
    pub control_points: Vec<f64>,
    /// Creation time, milliseconds since 1970 UTC.
    pub created_at_ms: i64,
}

/// Attributes of a stored shape, without its geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapeDescription {
    /// Identifier, `shp_…`.
    pub id: String,
    /// Identifier assigned by the client.
    pub external_id: Option<String>,
    /// Opaque identifier of the subject it belongs to.
    pub subject: Option<String>,
    /// Class label.
    pub label: Option<String>,
    /// Additional attributes, each a string, a number or a Boolean.
    pub labels: BTreeMap<String, serde_json::Value>,
}

/// Filter that selects shapes of a cohort; all conditions must hold.
#[derive(Debug, Clone, PartialEq, Eq, Default, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ShapeFilter {
    /// Shapes with this label.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<String>,
    /// Shapes of this subject.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub subject: Option<String>,
    /// Shapes whose attributes have these values, compared as text.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub labels: BTreeMap<String, String>,
}
