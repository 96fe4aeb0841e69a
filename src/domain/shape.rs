//! A shape of a cohort.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// What is known about a shape besides its geometry.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ShapeAttributes {
    /// The client's own identifier, unique in the cohort.
    pub external_id: Option<String>,
    /// Opaque identifier of the subject it belongs to.
    pub subject: Option<String>,
    /// Class.
    pub label: Option<String>,
    /// Further attributes, each a string, a number or a truth value.
    pub labels: BTreeMap<String, serde_json::Value>,
    /// Positive weight in means; 1 unless given.
    pub weight: f64,
    /// Anything the client wants to find again, as compact JSON with the names of fields in order.
    pub metadata: Option<String>,
}

/// A shape that is about to be stored.
#[derive(Debug, Clone, PartialEq)]
pub struct NewShape {
    /// `shp_…`.
    pub id: String,
    /// Attributes.
    pub attributes: ShapeAttributes,
    /// Control points, coordinate-major, `N·d` numbers.
    pub control_points: Vec<f64>,
}

/// A stored shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// `shp_…`.
    pub id: String,
    /// Attributes.
    pub attributes: ShapeAttributes,
    /// Control points, coordinate-major, `N·d` numbers.
    pub control_points: Vec<f64>,
    /// Creation time, milliseconds since 1970 UTC.
    pub created_at_ms: i64,
}

/// What is known about a stored shape, without its geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapeDescription {
    /// `shp_…`.
    pub id: String,
    /// The client's own identifier.
    pub external_id: Option<String>,
    /// Opaque identifier of the subject it belongs to.
    pub subject: Option<String>,
    /// Class.
    pub label: Option<String>,
    /// Further attributes, each a string, a number or a truth value.
    pub labels: BTreeMap<String, serde_json::Value>,
}

/// Which shapes of a cohort are meant: all conditions must hold.
#[derive(Debug, Clone, PartialEq, Eq, Default, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ShapeFilter {
    /// Shapes with this label.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label: Option<String>,
    /// Shapes of this subject.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub subject: Option<String>,
    /// Shapes whose attribute has this value, written as text.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub labels: BTreeMap<String, String>,
}
