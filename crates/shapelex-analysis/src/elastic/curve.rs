//! Curves as the unit tangents of polygons of equal lengths, at several resolutions.

use shapelex_geometry::arc_parameter::ArcParameter;
use shapelex_geometry::curve::Curve;
use shapelex_geometry::resample::{Contour, RepeatedPoints, polygon_area};
use shapelex_numeric::dense::Matrix;

use crate::AnalysisError;

/// Segments of the coarsest polygon.
const COARSEST: usize = 50;
/// Most segments of the polygon on which the wide bands are searched.
const MIDDLE: usize = 150;
/// Segments beyond half a turn on both sides of the polygon, which bands of paths may touch.
const BEYOND: usize = 32;
/// Parts of a segment whose middle one has the direction of an edge of a polygon.
const PARTS: usize = 21;
/// Length of a curve, relative to its extent, below which it is rounding error.
const SHORTEST: f64 = 1e-12;

/// Fewest control points, intervals or points of a curve that is compared.
pub const FEWEST: usize = 8;

/// A curve that is prepared for comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct ElasticCurve {
    /// From coarse to fine.
    pub(super) levels: Vec<Level>,
    /// `None` of polygons.
    pub(super) spline: Option<Spline>,
    /// Whether the curve is traversed backwards, to be counter-clockwise.
    pub(super) turned: bool,
}

/// A spline that was divided.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Spline {
    /// Coordinate-major.
    pub(super) control_points: Vec<f64>,
    /// Parameters of the `M + 1` ends of segments.
    pub(super) parameters: Vec<f64>,
    /// Length of the curve, scaled to coordinates near 1.
    pub(super) length: f64,
}

/// Unit tangents of the segments of a polygon. A closed polygon is continued on both sides.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Level {
    /// Number of segments, `M`.
    pub(super) count: usize,
    /// Number of segments before the first one.
    pub(super) pad: usize,
    /// `d` columns.
    columns: Vec<f32>,
    /// The segments without those beyond, one after the other, as square-root velocities: the tangent, with a third coordinate of 0 in the
    /// plane, and 1.
    pub(super) rows: Vec<[f32; 4]>,
}

/// Numbers of segments of the levels for `points` segments of the finest one: the coarse one, and `points` halved until wide bands can be
/// searched, with all levels between.
pub(super) fn level_counts(points: usize) -> Vec<usize> {
    let halved = |count: &usize| (*count > MIDDLE).then(|| count.div_ceil(2));
    let mut counts: Vec<usize> = std::iter::successors(Some(points), halved).collect();
    counts.push(points.min(COARSEST));
    counts.reverse();
    counts
}

impl Level {
    /// The segments in these directions, `d` coordinates each.
    fn new(steps: &[Vec<f64>], closed: bool) -> Self {
        let (count, d) = (steps.len(), steps[0].len());
        let mut rows = vec![[0.0, 0.0, 0.0, 1.0]; count];
        for (row, step) in rows.iter_mut().zip(steps) {
            let length = step.iter().map(|x| x * x).sum::<f64>().sqrt();
            if length > 0.0 {
                (0..d).for_each(|c| row[c] = (step[c] / length) as f32);
            }
        }
        Self::of_rows(rows, d, closed)
    }

    /// Segments with these square-root velocities in `d` dimensions.
    pub(super) fn of_rows(rows: Vec<[f32; 4]>, d: usize, closed: bool) -> Self {
        let count = rows.len();
        let pad = count / 2 + BEYOND;
        let stride = count + 2 * pad;
        let mut columns = vec![0.0; d * stride];
        for (c, column) in columns.chunks_exact_mut(stride).enumerate() {
            for (k, value) in column.iter_mut().enumerate() {
                let own = (pad..pad + count).contains(&k);
                if closed || own {
                    *value = rows[(k + pad * (count - 1)) % count][c];
                }
            }
        }
        Self { count, pad, columns, rows }
    }

    fn stride(&self) -> usize {
        self.count + 2 * self.pad
    }

    pub(super) fn dimension(&self) -> usize {
        self.columns.len() / self.stride()
    }

    /// Coordinate `c` of all segments, with those beyond.
    pub(super) fn column(&self, c: usize) -> &[f32] {
        let stride = self.stride();
        &self.columns[c * stride..(c + 1) * stride]
    }

    /// Bytes of the tangents of `count` segments in `d` dimensions.
    fn bytes(count: usize, d: usize) -> usize {
        4 * (d * (count + 2 * (count / 2 + BEYOND)) + 4 * count)
    }
}

impl ElasticCurve {
    /// The curve of `control_points` (coordinate-major as they are given), divided into `points` segments; backwards if it is clockwise
    /// and `orients`.
    ///
    /// Cost: 40 speeds for each segment.
    ///
    /// # Errors
    /// The length that is expected and the one that is found, of a curve without length or with a stretch without.
    pub(super) fn of_spline(
        curve: &Curve,
        control_points: &[f64],
        points: usize,
        orients: bool,
    ) -> Result<Self, String> {
        let unit = Curve::unit(&[curve]);
        let curve = curve.scaled(unit.recip());
        let arc = ArcParameter::of(&curve);
        let least = SHORTEST * arc.length().max(1.0);
        // Shorter curves are rounding errors of their coordinates.
        let largest = control_points.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
        let share = arc.length() * unit / largest.max(f64::MIN_POSITIVE);
        if !(arc.length() > SHORTEST && share > SHORTEST) {
            return Err(format!(
                "expected a length of at least {SHORTEST:.0e} of the largest coordinate, got {share:.1e}"
            ));
        }
        if !(arc.shortest() > least / curve.halves() as f64) {
            let share = arc.shortest() / arc.length();
            return Err(format!("expected no stretch without length, got one of {share:.1e} of the length"));
        }
        let along =
            |count: usize| -> Vec<f64> { (0..=count).map(|i| arc.at(i as f64 / count as f64)).collect() };
        let mut parameters = along(points);
        let turned = orients && polygon_area(&matrix(&places(&curve, &parameters))) < 0.0;
        let level = |count: usize| {
            let steps = if curve.smoothness() == 0 && has_few_corners(curve.segments(), count) {
                let middle = |i: usize| arc.at((i as f64 + 0.5) / count as f64);
                (0..count).map(|i| curve.evaluate(middle(i), 1)).collect()
            } else {
                steps(&places(&curve, &along(count)))
            };
            Level::new(&laid(steps, turned), curve.is_closed())
        };
        let levels = level_counts(points).into_iter().map(level).collect();
        if turned {
            parameters.reverse();
        }
        let spline = Spline { control_points: control_points.to_vec(), parameters, length: arc.length() };
        Ok(Self { levels, spline: Some(spline), turned })
    }

    /// The polygon through `points` (`n × d`), divided into as many segments as `segments` says; backwards if it is clockwise and
    /// `orients`.
    ///
    /// # Errors
    /// [`AnalysisError::Unsuitable`] of fewer than 2 or 3 points, or without length.
    pub fn of_polygon(
        points: Matrix,
        closed: bool,
        segments: usize,
        orients: bool,
    ) -> Result<Self, AnalysisError> {
        let contour = Contour::new(points, closed, RepeatedPoints::Drop);
        let contour =
            contour.map_err(|error| AnalysisError::Unsuitable { index: 0, detail: error.to_string() })?;
        let turned = orients && closed && polygon_area(contour.points()) < 0.0;
        let level = |count: usize| {
            let parts = if has_few_corners(contour.points().nrows(), count) { PARTS } else { 1 };
            let sampled = contour.sample(parts * count + usize::from(!closed), 0.0);
            let place = |k: usize| -> Vec<f64> { sampled.row(k % sampled.nrows()).iter().copied().collect() };
            let [from, to] = [(parts - 1) / 2, parts / 2 + 1];
            let step = |i: usize| steps(&[place(parts * i + from), place(parts * i + to)]);
            Level::new(&laid((0..count).flat_map(step).collect(), turned), closed)
        };
        let levels = level_counts(segments).into_iter().map(level).collect();
        Ok(Self { levels, spline: None, turned })
    }

    /// The finest level.
    pub(super) fn finest(&self) -> &Level {
        &self.levels[self.levels.len() - 1]
    }

    /// Bytes of a curve of `size` control points in `d` dimensions with `points` segments.
    pub(super) fn bytes(size: usize, d: usize, points: usize) -> usize {
        let levels: usize = level_counts(points).into_iter().map(|count| Level::bytes(count, d)).sum();
        size_of::<Self>() + levels + 8 * (d * size + points + 1)
    }

    /// An order of curves by what they hold: tangents, then control points.
    pub(super) fn order(&self, other: &Self) -> std::cmp::Ordering {
        let (one, two) = (self.finest().rows.as_flattened(), other.finest().rows.as_flattened());
        let tangents = one.iter().zip(two).map(|(a, b)| a.total_cmp(b)).find(|order| order.is_ne());
        let points = |curve: &Self| curve.spline.as_ref().map(|spline| spline.control_points.clone());
        tangents.unwrap_or_else(|| {
            let (one, two) = (points(self).unwrap_or_default(), points(other).unwrap_or_default());
            let order = one.iter().zip(&two).map(|(a, b)| a.total_cmp(b)).find(|order| order.is_ne());
            order.unwrap_or(one.len().cmp(&two.len()))
        })
    }
}

/// Whether a polygon has so few corners that its segments have the directions of its edges: a chord across a corner has that of neither.
fn has_few_corners(corners: usize, segments: usize) -> bool {
    2 * corners <= segments
}

/// Differences of consecutive places.
fn steps(places: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let step = |ends: &[Vec<f64>]| ends[1].iter().zip(&ends[0]).map(|(to, from)| to - from).collect();
    places.windows(2).map(step).collect()
}

/// The steps of a curve, or of the same curve traversed backwards.
fn laid(mut steps: Vec<Vec<f64>>, backwards: bool) -> Vec<Vec<f64>> {
    if backwards {
        steps.reverse();
        steps.iter_mut().flatten().for_each(|x| *x = -*x);
    }
    steps
}

/// Places of the curve at some parameters.
fn places(curve: &Curve, parameters: &[f64]) -> Vec<Vec<f64>> {
    parameters.iter().map(|&u| curve.evaluate(u, 0)).collect()
}

fn matrix(rows: &[Vec<f64>]) -> Matrix {
    Matrix::from_fn(rows.len(), rows[0].len(), |i, c| rows[i][c])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_double_from_the_middle_one() {
        assert_eq!(level_counts(16), [16, 16]);
        assert_eq!(level_counts(100), [50, 100]);
        assert_eq!(level_counts(1000), [50, 125, 250, 500, 1000]);
    }

    #[test]
    fn closed_polygons_go_on_and_clockwise_ones_are_turned() {
        let square = |order: [usize; 4]| {
            let corners = [[0., 0.], [4., 0.], [4., 4.], [0., 4.]];
            Matrix::from_fn(4, 2, |k, c| corners[order[k]][c])
        };
        let one = ElasticCurve::of_polygon(square([0, 1, 2, 3]), true, 16, true).unwrap();
        let level = one.finest();
        assert!((0..16).all(|k| level.rows[k][0] == [1.0, 0.0, -1.0, 0.0][k / 4]), "{:?}", level.rows);
        assert!(level.rows.iter().all(|row| row[3] == 1.0));
        for k in 0..level.column(0).len() {
            let wrapped = (k + 16 * level.pad - level.pad) % 16;
            assert_eq!(level.column(1)[k], level.rows[wrapped][1]);
        }
        let turned = ElasticCurve::of_polygon(square([0, 3, 2, 1]), true, 16, true).unwrap();
        assert!(turned.turned && turned.levels == one.levels);
    }
}
