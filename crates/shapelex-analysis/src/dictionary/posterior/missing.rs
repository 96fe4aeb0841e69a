//! A shape with missing parts, and its seen part.

use super::conditioning::{Imposed, Seen};
use super::feature::ShapeFeature;
use super::model::PosteriorModel;
use super::places::{AtPlaces, selected};
use crate::AnalysisError;
use crate::rows::{Row, rows_of};
use shapelex_geometry::capability::place::Place;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_geometry::sampling::Places;
use shapelex_numeric::dense::Matrix;

/// A shape of which a part is known.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PartialShape {
    /// Known control points: position, and `d` numbers.
    pub control_points: Vec<(usize, Vec<f64>)>,
    /// A whole shape of which some arcs are known: its control points, `d·N` coordinate-major numbers, and the first and last
    /// parameter of each arc, forwards.
    pub arcs: Option<(Vec<f64>, Vec<[f64; 2]>)>,
    /// Known points, each with its place and the standard deviation of its measurement.
    pub points: Vec<SeenPoint>,
    /// Standard deviation of the measurement of control points and of arcs.
    pub deviation: f64,
    /// Imposed values.
    pub conditions: Vec<Condition>,
}

/// A known point.
#[derive(Debug, Clone, PartialEq)]
pub struct SeenPoint {
    /// Its place.
    pub at: Place,
    /// Its coordinates.
    pub point: Vec<f64>,
    /// Standard deviation of its measurement, for each coordinate.
    pub deviation: f64,
}

/// A value that a shape is to have.
#[derive(Debug, Clone, PartialEq)]
pub struct Condition {
    /// Feature that has the value.
    pub measure: ShapeFeature,
    /// The value.
    pub value: f64,
    /// Its standard deviation; zero imposes it exactly.
    pub deviation: f64,
}

/// Whether a parameter is on an arc of a curve.
pub(crate) fn is_on_arcs(u: f64, arcs: &[[f64; 2]], closed: bool) -> bool {
    arcs.iter().any(|&[from, to]| match closed {
        // Forwards from the first parameter.
        true => (u - from).rem_euclid(1.0) <= (to - from).rem_euclid(1.0) + GRID,
        false => (from - GRID..=to + GRID).contains(&u),
    })
}

/// Places of a shape along which an arc is seen: those of the grid of `count` places.
fn on_arcs(places: &Places, count: usize, arcs: &[[f64; 2]], closed: bool) -> Vec<usize> {
    (0..count).filter(|&i| is_on_arcs(places.parameter(i), arcs, closed)).collect()
}

/// Control points of a curve whose knots are on arcs; those beyond an end count as at the end.
fn controls_on_arcs(space: &ShapeSpace, arcs: &[[f64; 2]]) -> Vec<usize> {
    let representation = space.representation();
    let (n, knots) = (representation.size(), representation.point_count());
    let closed = representation.is_closed();
    let beyond = (n - knots) as f64 / 2.0;
    let intervals = if closed { n } else { knots - 1 } as f64;
    let parameter = |i: usize| ((i as f64 - beyond) / intervals).clamp(0.0, 1.0);
    (0..n).filter(|&i| is_on_arcs(parameter(i), arcs, closed)).collect()
}

/// Difference of parameters that are the same.
const GRID: f64 = 1e-12;

impl PartialShape {
    /// Positions of the seen part: control points, or with arcs those of as many places along the curve.
    pub(super) fn seen(&self, space: &ShapeSpace) -> Vec<usize> {
        match &self.arcs {
            Some((_, arcs)) => {
                let places = Places::along(space, space.representation().size());
                on_arcs(&places, places.count(), arcs, space.representation().is_closed())
            }
            None => self.control_points.iter().map(|(position, _)| *position).collect(),
        }
    }

    /// Puts the seen control points into a shape, `d·N` coordinate-major numbers.
    pub(super) fn fill(&self, space: &ShapeSpace, shape: &mut [f64]) {
        let n = space.representation().size();
        for (i, point) in &self.control_points {
            point.iter().enumerate().for_each(|(c, x)| shape[c * n + i] = *x);
        }
        if let Some((whole, arcs)) = &self.arcs {
            for i in controls_on_arcs(space, arcs) {
                (i..shape.len()).step_by(n).for_each(|k| shape[k] = whole[k]);
            }
        }
    }
}

impl PosteriorModel {
    /// The seen part of a shape.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] at `points` or `conditions` for places that the shapes do not have, at `observed` for arcs on
    /// which nothing is.
    pub fn seen(&self, space: &ShapeSpace, shape: &PartialShape) -> Result<Seen, AnalysisError> {
        let d = self.dimension();
        let positions: Vec<usize> = shape.control_points.iter().map(|(position, _)| *position).collect();
        let mut at = self.controls.select(&positions);
        let rows: Vec<&[f64]> = shape.control_points.iter().map(|(_, point)| point.as_slice()).collect();
        let mut points = columns(&rows, d);
        let mut variances = vec![shape.deviation.powi(2); positions.len()];
        if let Some((whole, arcs)) = &shape.arcs {
            let places = Places::along(space, self.size());
            let closed = space.representation().is_closed();
            let on = on_arcs(&places, self.grid.count(), arcs, closed);
            let all = places.points(space, &Matrix::from_column_slice(self.size(), d, whole));
            points = joined(&points, &selected(&all, d, &on), d);
            at = at.and(&self.grid.select(&on));
            variances.resize(variances.len() + on.len(), shape.deviation.powi(2));
        }
        if !shape.points.is_empty() {
            let named: Vec<Place> = shape.points.iter().map(|point| point.at).collect();
            let further = self.at(space, &named).ok_or_else(|| nowhere("points"))?;
            let rows: Vec<&[f64]> = shape.points.iter().map(|point| point.point.as_slice()).collect();
            points = joined(&points, &columns(&rows, d), d);
            at = at.and(&further);
            variances.extend(shape.points.iter().map(|point| point.deviation.powi(2)));
        }
        let imposed = shape.conditions.iter().map(|condition| {
            let Condition { measure: feature, value, deviation } = condition.clone();
            let at = feature.places(self, space).ok_or_else(|| nowhere("conditions"))?;
            Ok(Imposed { feature, at, value, deviation })
        });
        Ok(Seen { at, points, variances, imposed: imposed.collect::<Result<_, AnalysisError>>()? })
    }

    /// Which of some places along shapes are seen: those within an arc, and those nearest to a seen point or control point.
    pub fn seen_at(&self, space: &ShapeSpace, shape: &PartialShape, places: &Places) -> Vec<bool> {
        let count = places.count();
        let closed = space.representation().is_closed();
        let mut seen = vec![false; count];
        for (position, _) in &shape.control_points {
            // Control points are along shapes in the order of the places.
            seen[position * count / self.size()] = true;
        }
        if let Some((_, arcs)) = &shape.arcs {
            on_arcs(places, count, arcs, closed).into_iter().for_each(|i| seen[i] = true);
        }
        for point in &shape.points {
            let around = |away: f64| if closed { away.min((1.0 - away).abs()) } else { away };
            let away = |i: usize| match (point.at, places.surface_parameters(i)) {
                (Place::Two([u, v]), Some([a, b])) => (a - u).abs() + (b - v).abs(),
                (place, _) => around((places.parameter(i) - place.first()).abs()),
            };
            let nearest = (0..count).min_by(|&a, &b| away(a).total_cmp(&away(b)));
            nearest.into_iter().for_each(|i| seen[i] = true);
        }
        seen
    }
}

/// Coordinate-major numbers of points.
fn columns(rows: &[&[f64]], d: usize) -> Vec<f64> {
    (0..d).flat_map(|c| rows.iter().map(move |row| row[c])).collect()
}

/// Points and further ones, coordinate-major.
fn joined(a: &[f64], b: &[f64], d: usize) -> Vec<f64> {
    let (n, m) = (a.len() / d, b.len() / d);
    (0..d).flat_map(|c| a[c * n..(c + 1) * n].iter().chain(&b[c * m..(c + 1) * m])).copied().collect()
}

fn nowhere(field: &'static str) -> AnalysisError {
    AnalysisError::Parameter { field, detail: "expected places that the shapes have".into() }
}

/// Shapes of a model at seen places, given as they are.
impl Seen {
    /// Points at some of the places at which shapes are known, in any pose.
    pub(crate) fn of(at: AtPlaces, points: Vec<f64>) -> Self {
        let variances = vec![0.0; at.count()];
        Self { at, points, variances, imposed: Vec::new() }
    }

    /// The seen points, a row each.
    pub fn points(&self) -> Vec<Row> {
        rows_of(&self.points, self.at.dimension)
    }
}
