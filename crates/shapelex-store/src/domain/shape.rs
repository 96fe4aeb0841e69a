//! Shapes of a cohort.

use std::collections::BTreeMap;

use shapelex_analysis::conversion::Beginning;

/// Maximum number of names of further attributes in a cohort: every name is a column of its tables.
pub const MAX_NAMES: usize = 4096;

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

/// Measures of a shape, computed when it arrives, in the unit of its points; `None` where shapes of its kind have none.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ShapeMeasures {
    /// Number of points as received, those included that were dropped as repeated.
    pub points: Option<u64>,
    /// Centroid size: of landmarks the root of the sum of squared distances from their mean, of curves and surfaces the
    /// root of the integral.
    pub centroid_size: Option<f64>,
    /// Length of a curve.
    pub length: Option<f64>,
    /// Enclosed area of a closed planar curve, unsigned; area of a surface.
    pub area: Option<f64>,
    /// Volume that a surface encloses, unsigned.
    pub volume: Option<f64>,
    /// Whether a planar curve intersects itself.
    pub self_intersecting: Option<bool>,
    /// Whether a closed planar curve runs clockwise.
    pub clockwise: Option<bool>,
    /// Residual of the fit to a mesh whose parameters were computed.
    pub fit: Option<FitResidual>,
    /// How a contour ran as it was given, where its start or its direction was changed; `None` also of contours of earlier versions.
    pub beginning: Option<Beginning>,
}

/// Residual of the fit of a surface to its uploaded mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitResidual {
    /// Mean distance of the points of the mesh from their places on the surface, over its area.
    pub mean: f64,
    /// Largest such distance.
    pub largest: f64,
    /// Area of the surface, relative to that of the mesh, minus one.
    pub area: f64,
}

/// A shape about to be stored.
#[derive(Debug, Clone, PartialEq)]
pub struct NewShape {
    /// Identifier, `shp_…`.
    pub id: String,
    /// Attributes besides the geometry.
    pub attributes: ShapeAttributes,
    /// Measures of the geometry.
    pub measures: ShapeMeasures,
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
    /// Measures of the geometry.
    pub measures: ShapeMeasures,
    /// Control points, coordinate-major, `N·d` numbers.
    pub control_points: Vec<f64>,
    /// Creation time, milliseconds since 1970 UTC.
    pub created_at_ms: i64,
}

impl Shape {
    /// Control points and weight of a stored shape of which nothing else is known.
    pub fn of_numbers(control_points: Vec<f64>, weight: f64) -> Self {
        let attributes = ShapeAttributes { weight, ..ShapeAttributes::default() };
        let measures = ShapeMeasures::default();
        Self { id: String::new(), attributes, measures, control_points, created_at_ms: 0 }
    }
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
    /// Measures of the geometry.
    pub measures: ShapeMeasures,
    /// Creation time, milliseconds since 1970 UTC.
    pub created_at_ms: i64,
}
