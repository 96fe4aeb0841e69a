//! Functions of a shape that may be imposed: coordinates, the centroid, distances along a direction, and the named measurements of report
//! cards.
//!
//! ```text
//! coordinate   p_c             along     nᵀ(q − p), |n| = 1
//! centroid     (∫ r)_c         and distance, angle, area, width as in the report card
//! ```

use super::model::PosteriorModel;
use super::places::AtPlaces;
use crate::dictionary::report::measurement::{Quantity, quantity_faults};
use crate::metric::norm;
use shapelex_geometry::capability::place::Place;
use shapelex_geometry::field_fault::FieldFault;
use shapelex_geometry::representation::ShapeSpace;

/// A function of a shape, in the unit of the shape or in degrees.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields))]
pub enum ShapeFeature {
    /// A coordinate of a place.
    Coordinate {
        /// The place.
        at: Place,
        /// The coordinate: 0, 1 or 2.
        axis: usize,
    },
    /// A coordinate of the centroid.
    Centroid {
        /// The coordinate: 0, 1 or 2.
        axis: usize,
    },
    /// Distance from the first to the second place along a direction; negative against it.
    Along {
        /// The places.
        between: [Place; 2],
        /// The direction, of any length.
        direction: Vec<f64>,
    },
    /// Distance of two places.
    Distance {
        /// The places.
        between: [Place; 2],
    },
    /// Angle at the second of three places, in degrees.
    Angle {
        /// The places.
        at: [Place; 3],
    },
    /// Area between a planar curve, from the first to the second parameter, and the chord; positive where the curve runs
    /// counter-clockwise.
    Area {
        /// The parameters.
        between: [Place; 2],
    },
    /// Extent of a planar curve across the line through two places.
    Width {
        /// The places.
        along: [Place; 2],
    },
}

/// A value with its derivatives by the coordinates of each point.
pub(super) type Gradient = (f64, Vec<Vec<f64>>);

impl ShapeFeature {
    fn quantity(&self) -> Option<Quantity> {
        match *self {
            Self::Distance { between } => Some(Quantity::Distance { between }),
            Self::Angle { at } => Some(Quantity::Angle { at }),
            Self::Area { between } => Some(Quantity::Area { between }),
            Self::Width { along } => Some(Quantity::Width { along }),
            Self::Coordinate { .. } | Self::Centroid { .. } | Self::Along { .. } => None,
        }
    }

    /// Faults of a function of shapes of `space`, by field.
    pub fn faults(&self, space: &ShapeSpace) -> Vec<FieldFault> {
        if let Some(quantity) = self.quantity() {
            return quantity_faults(space, &quantity);
        }
        let d = space.representation().dimension();
        let axis_fault = |axis: usize| {
            let detail = || format!("expected a coordinate between 0 and {}, got {axis}", d - 1);
            (axis >= d).then(|| FieldFault::new("axis", detail()))
        };
        match self {
            Self::Coordinate { at, axis } => {
                let places = space.place_faults(&[*at]).into_iter();
                places.map(|fault| FieldFault::new("at", fault.detail)).chain(axis_fault(*axis)).collect()
            }
            Self::Centroid { axis } => axis_fault(*axis).into_iter().collect(),
            Self::Along { between, direction } => {
                let places = space.place_faults(between).into_iter().map(|fault| fault.below("between"));
                let length = norm(direction);
                let proper = direction.len() == d && length.is_finite() && length > 0.0;
                let detail = || format!("expected {d} numbers, not all zero, got {direction:?}");
                places.chain((!proper).then(|| FieldFault::new("direction", detail()))).collect()
            }
            _ => Vec::new(),
        }
    }

    /// The places of which it is a function; `None` if shapes of `space` have no such places.
    pub(super) fn places(&self, model: &PosteriorModel, space: &ShapeSpace) -> Option<AtPlaces> {
        match self {
            Self::Centroid { .. } => Some(model.centroid()),
            Self::Coordinate { at, .. } => model.at(space, &[*at]),
            Self::Along { between, .. } => model.at(space, between),
            _ => model.at(space, &self.quantity()?.all_places(space.representation().is_closed())),
        }
    }

    /// Value at points, with its gradient; `None` where it has none.
    pub(super) fn of(&self, points: &[Vec<f64>]) -> Option<Gradient> {
        let unit = |axis: usize, d: usize| (0..d).map(|c| f64::from(u8::from(c == axis))).collect();
        match self {
            Self::Coordinate { axis, .. } | Self::Centroid { axis } => {
                Some((points[0][*axis], vec![unit(*axis, points[0].len())]))
            }
            Self::Along { direction, .. } => {
                let length = norm(direction);
                let n: Vec<f64> = direction.iter().map(|x| x / length).collect();
                let value = points[1].iter().zip(&points[0]).zip(&n).map(|((q, p), n)| n * (q - p)).sum();
                Some((value, vec![n.iter().map(|n| -n).collect(), n]))
            }
            _ => self.quantity()?.of(points),
        }
    }
}
