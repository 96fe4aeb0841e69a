//! Shapes with missing parts as JSON.
//!
//! ```json
//! {"control_points": [[0, 0], null, [2, 1]], "points": [{"at": 0.25, "point": [1, 2]}]}
//! ```

use serde::Deserialize;
use utoipa::ToSchema;

use super::fault::Fault;
use super::observed::Observed;
#[cfg(feature = "schema")]
use super::observed::ObservedEntry;
use super::shape::MAX_COORDINATE;
use crate::analysis::dictionary::posterior::feature::ShapeFeature;
use crate::analysis::dictionary::posterior::missing::{Condition, PartialShape, SeenPoint};
use crate::geometry::capability::place::Place;
use crate::geometry::representation::ShapeSpace;

/// Maximum number of conditions of a shape.
const MAX_CONDITIONS: usize = 50;

/// A shape of which a part is known.
#[derive(Debug, Clone, Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PartialInput {
    /// Control points or landmarks in the representation of the dictionary: a list of coordinates each, or null where one is missing.
    #[serde(default)]
    control_points: Option<Vec<Option<Vec<f64>>>>,
    /// Which part of `control_points` counts: true or false for each of them, or arcs `[from, to]` of a curve, forwards in its parameter.
    /// Default: all that are not null.
    #[serde(default)]
    #[schema(value_type = Option<Vec<ObservedEntry>>)]
    observed: Option<Observed>,
    /// Known points at places: parameters of a curve, pairs of a surface, indices of landmarks.
    #[serde(default)]
    points: Vec<PointInput>,
    /// Standard deviation of the measurement of control points, for each coordinate, in the unit of the shape.
    /// Default: 0. The residual of the modes counts as noise besides.
    #[serde(default)]
    deviation: f64,
    /// Values that the shape is to have, at most 50.
    #[serde(default)]
    #[schema(max_items = 50)]
    conditions: Vec<ConditionInput>,
}

/// A known point.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PointInput {
    /// Its place: the parameter of a curve, the pair of a surface, the index of a landmark.
    at: Place,
    /// Its coordinates.
    point: Vec<f64>,
    /// Standard deviation of its measurement, for each coordinate. Default: 0.
    #[serde(default)]
    deviation: f64,
}

/// A value that a shape is to have.
#[derive(Debug, Clone, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ConditionInput {
    /// Measured quantity that has the value.
    measure: ShapeFeature,
    /// The value, in the unit of the shape or in degrees.
    value: f64,
    /// Its standard deviation. Default: 0, which imposes it exactly.
    #[serde(default)]
    deviation: f64,
}

impl PartialInput {
    /// Control points, `None` where one is missing, of which a part counts.
    pub fn of(control_points: Vec<Option<Vec<f64>>>, observed: Option<Observed>) -> Self {
        Self { control_points: Some(control_points), observed, ..Self::default() }
    }

    /// Number of points that are given.
    pub fn len(&self) -> usize {
        self.control_points.as_ref().map_or(0, Vec::len) + self.points.len()
    }

    /// Whether no points are given.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The shape, if it is one of `space` with at most `most` points.
    ///
    /// # Errors
    /// All faults, with pointers relative to the shape.
    pub fn checked(self, space: &ShapeSpace, most: usize) -> Result<PartialShape, Vec<Fault>> {
        let mut faults = Vec::new();
        let d = space.representation().dimension();
        let deviation = |deviation: f64, pointer: String, faults: &mut Vec<Fault>| {
            if !(0.0..=MAX_COORDINATE).contains(&deviation) {
                let detail = format!("expected a number between 0 and {MAX_COORDINATE:.0e}, got {deviation}");
                faults.push(Fault::new(pointer, detail));
            }
        };
        if self.points.len() > most {
            let detail = format!("expected at most {most} points, got {}", self.points.len());
            return Err(vec![Fault::new("/points", detail)]);
        }
        if self.conditions.len() > MAX_CONDITIONS {
            let detail =
                format!("expected at most {MAX_CONDITIONS} conditions, got {}", self.conditions.len());
            return Err(vec![Fault::new("/conditions", detail)]);
        }
        deviation(self.deviation, "/deviation".into(), &mut faults);
        let (control_points, arcs) = self.control_points(space, &mut faults);
        let places: Vec<Place> = self.points.iter().map(|point| point.at).collect();
        let nowhere = space.place_faults(&places).into_iter();
        faults.extend(nowhere.map(|fault| Fault::new(format!("/points/{}/at", fault.field), fault.detail)));
        for (i, point) in self.points.iter().enumerate() {
            if let Some(detail) = coordinates_fault(&point.point, d) {
                faults.push(Fault::new(format!("/points/{i}/point"), detail));
            }
            deviation(point.deviation, format!("/points/{i}/deviation"), &mut faults);
        }
        for (i, condition) in self.conditions.iter().enumerate() {
            let pointer = format!("/conditions/{i}");
            let wrong = condition.measure.faults(space).into_iter();
            faults.extend(wrong.map(|fault| Fault::from(fault).below(&format!("{pointer}/measure"))));
            deviation(condition.deviation, format!("{pointer}/deviation"), &mut faults);
            if !(condition.value.abs() <= MAX_COORDINATE) {
                let detail =
                    format!("expected a number within ±{MAX_COORDINATE:.0e}, got {}", condition.value);
                faults.push(Fault::new(format!("{pointer}/value"), detail));
            }
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let known =
            |point: PointInput| SeenPoint { at: point.at, point: point.point, deviation: point.deviation };
        let imposed = |ConditionInput { measure, value, deviation }| Condition { measure, value, deviation };
        Ok(PartialShape {
            control_points,
            arcs,
            points: self.points.into_iter().map(known).collect(),
            deviation: self.deviation,
            conditions: self.conditions.into_iter().map(imposed).collect(),
        })
    }

    /// The control points that count: one by one, or the whole shape with arcs.
    #[expect(clippy::type_complexity, reason = "the two fields of a partial shape")]
    fn control_points(
        &self,
        space: &ShapeSpace,
        faults: &mut Vec<Fault>,
    ) -> (Vec<(usize, Vec<f64>)>, Option<(Vec<f64>, Vec<[f64; 2]>)>) {
        let (n, d) = (space.representation().size(), space.representation().dimension());
        let Some(rows) = &self.control_points else {
            if self.observed.is_some() {
                faults.push(Fault::new("/observed", "expected control_points beside it, got none"));
            }
            return (Vec::new(), None);
        };
        if rows.len() != n {
            let detail = format!(
                "expected {n} control points or nulls, as many as the representation has, got {}",
                rows.len()
            );
            faults.push(Fault::new("/control_points", detail));
            return (Vec::new(), None);
        }
        for (i, row) in rows.iter().enumerate() {
            if let Some(detail) = row.as_ref().and_then(|row| coordinates_fault(row, d)) {
                faults.push(Fault::new(format!("/control_points/{i}"), detail));
            }
        }
        let given = |i: usize| rows[i].clone().map(|row| (i, row));
        let Some(observed) = &self.observed else {
            return ((0..n).filter_map(given).collect(), None);
        };
        let Observed { mask, arcs } = observed;
        if arcs.is_empty() {
            if mask.len() != n {
                let detail = format!("expected {n} entries, one for each control point, got {}", mask.len());
                faults.push(Fault::new("/observed", detail));
                return (Vec::new(), None);
            }
            return ((0..n).filter(|&i| mask[i]).filter_map(given).collect(), None);
        }
        if !mask.is_empty() {
            faults.push(Fault::new("/observed", "expected either true and false, or arcs, got both"));
        }
        faults.extend(observed.arc_faults(space).into_iter().map(|fault| fault.below("/observed")));
        if let Some(i) = rows.iter().position(Option::is_none) {
            let detail = "expected a control point, got null: beside arcs all of them are needed";
            faults.push(Fault::new(format!("/control_points/{i}"), detail));
        }
        if !faults.is_empty() {
            return (Vec::new(), None);
        }
        let whole = (0..d).flat_map(|c| rows.iter().flatten().map(move |row| row[c])).collect();
        (Vec::new(), Some((whole, arcs.clone())))
    }
}

/// Why a list is not a point of `d` coordinates.
fn coordinates_fault(point: &[f64], d: usize) -> Option<String> {
    if point.len() != d {
        return Some(format!("expected {d} coordinates, got {}", point.len()));
    }
    let large = point.iter().find(|x| !(x.abs() <= MAX_COORDINATE))?;
    Some(format!("expected numbers within ±{MAX_COORDINATE:.0e}, got {large}"))
}
