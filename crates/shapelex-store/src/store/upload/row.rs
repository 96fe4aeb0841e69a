//! A shape in the form in which it is stored.

use super::super::blob::{self, Encoded};
use super::digest::{self, Digests};
use crate::domain::shape::{NewShape, Shape, ShapeMeasures};

/// A shape as it is stored: attributes as text, control points as bytes, and the digest of both.
#[derive(Debug)]
pub struct ShapeRow {
    pub(super) id: String,
    pub(super) external_id: Option<String>,
    pub(super) subject: Option<String>,
    pub(super) label: Option<String>,
    /// Digests of the content of a shape that has an external id.
    pub(super) digests: Option<Digests>,
    pub(super) labels: Option<String>,
    pub(super) metadata: Option<String>,
    pub(super) measures: ShapeMeasures,
    /// Time of creation of a shape that is stored again, which its chunk does not tell.
    pub(super) first_stored_ms: Option<i64>,
    pub(super) weight: f64,
    /// Control points, as stored.
    pub(super) points: Vec<u8>,
}

impl ShapeRow {
    /// Number of coordinates.
    pub(super) fn width(&self) -> usize {
        self.points.len() / blob::BYTES_PER_NUMBER
    }

    /// The shape as a separate chunk.
    pub(in crate::store) fn alone(&self) -> Encoded {
        Encoded::new(std::iter::once((self.weight, self.points.as_slice())))
    }

    /// Whether a stored digest is one of the same content.
    pub(super) fn is_stored_as(&self, stored: Option<&[u8]>) -> bool {
        stored.zip(self.digests.as_ref()).is_some_and(|(stored, digests)| digests.contain(stored))
    }

    /// Digest of the control points alone.
    pub(super) fn points_digest(&self) -> blake3::Hash {
        blake3::hash(&self.points)
    }

    pub(super) fn digest_bytes(&self) -> Option<&[u8]> {
        self.digests.as_ref().map(|digests| digests.content.as_slice())
    }
}

/// A shape that is stored again, under its id and with its time of creation.
impl From<Shape> for ShapeRow {
    fn from(shape: Shape) -> Self {
        let Shape { id, attributes, measures, control_points, created_at_ms } = shape;
        let row = Self::from(NewShape { id, attributes, measures, control_points });
        Self { first_stored_ms: Some(created_at_ms), ..row }
    }
}

/// Cost: one pass over the control points, and BLAKE3 of them if the shape has an external id.
impl From<NewShape> for ShapeRow {
    fn from(shape: NewShape) -> Self {
        let NewShape { id, attributes, measures, control_points } = shape;
        let points = blob::bytes_of(&control_points);
        let digests = attributes.external_id.is_some().then(|| digest::of(&attributes, &points));
        let labels = (!attributes.labels.is_empty()).then_some(&attributes.labels);
        let labels = labels.map(|labels| serde_json::to_string(labels).expect("a map of JSON is JSON"));
        Self {
            id,
            external_id: attributes.external_id,
            subject: attributes.subject,
            label: attributes.label,
            digests,
            labels,
            metadata: attributes.metadata,
            measures,
            first_stored_ms: None,
            weight: attributes.weight,
            points,
        }
    }
}
