//! Shapes as they come into a cohort.

use serde::Deserialize;

/// Measures of a shape.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Measures {
    /// Number of points as received.
    pub points: Option<i64>,
    /// Centroid size.
    pub centroid_size: Option<f64>,
    /// Length of a curve.
    pub length: Option<f64>,
    /// Area.
    pub area: Option<f64>,
    /// Volume of a surface.
    pub volume: Option<f64>,
    /// Whether a planar curve intersects itself.
    pub self_intersecting: Option<bool>,
    /// Whether a closed planar curve runs clockwise.
    pub clockwise: Option<bool>,
    /// Mean distance of a mesh from the surface fitted to it.
    pub fit_mean: Option<f64>,
    /// Largest such distance.
    pub fit_largest: Option<f64>,
    /// Area of the surface, relative to that of the mesh, minus one.
    pub fit_area: Option<f64>,
}

/// A shape of a cohort.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Record {
    /// Identifier.
    pub id: String,
    /// Identifier assigned by the client.
    pub external_id: Option<String>,
    /// Identifier of the subject.
    pub subject: Option<String>,
    /// Class label.
    pub label: Option<String>,
    /// Further attributes, a JSON object with sorted names; `None` if there are none.
    pub attributes: Option<String>,
    /// Data of the client, JSON.
    pub metadata: Option<String>,
    /// Positive weight in means.
    pub weight: f64,
    /// Measures.
    pub measures: Measures,
    /// Control points, coordinate-major.
    pub control_points: Vec<f64>,
    /// Time of creation, RFC 3339.
    pub created_at: Option<String>,
}
