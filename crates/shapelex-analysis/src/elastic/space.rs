//! Pairs of curves, and matrices of distances.

use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

use shapelex_geometry::arc_parameter::ArcParameter;
use shapelex_geometry::capability::domain::Domain;
use shapelex_geometry::curve::Curve;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::parallel;

use super::IDENTITY;
use super::curve::{ElasticCurve, FEWEST};
use super::pairing::{Found, Way};
use super::polish::polished;
use super::program::Work;
use super::search::search;
use super::settings::{Effort, ElasticSettings};
use crate::AnalysisError;
use crate::correspondence::{Direction, Mirror};

/// Distance below which a pair is matched again by the tangents of its splines: the chords of a hundred segments leave up to 0.016
/// between copies.
const NEAR: f64 = 0.1;

/// Rows and columns of a tile of a matrix.
const TILE: usize = 16;

/// What curves are compared, and how.
#[derive(Debug, Clone)]
pub struct ElasticSpace {
    /// `None` of polygons.
    space: Option<ShapeSpace>,
    dimension: usize,
    closed: bool,
    /// Whether clockwise curves are turned.
    orients: bool,
    settings: ElasticSettings,
    ways: Vec<Way>,
}

/// The match of two curves. Places are fractions of the length, from where a curve begins, in the direction in which it is given.
#[derive(Debug, Clone, PartialEq)]
pub struct ElasticMatch {
    /// `arccos F`, 0 to `π/2`.
    pub distance: f64,
    /// The rotation of the second curve to the first one, after its first coordinate was negated if it is mirrored; `d × d`, row by row.
    pub rotation: Vec<f64>,
    /// Whether the mirror image of the second curve is matched.
    pub mirrored: bool,
    /// Whether the second curve is traversed backwards: the places decrease.
    pub reversed: bool,
    /// Places on the second curve of the places `i/M` of the first one, `i = 0 … M`; of closed curves they go on beyond 0 and 1.
    pub places: Vec<f64>,
}

impl ElasticSpace {
    /// The curves of `space`. `direction`: as for other comparisons; `mirror`: whether mirror images are matched, closed planar ones
    /// backwards.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] of the settings, and of a `representation` that is no curve of [`FEWEST`] control points.
    pub fn new(
        space: &ShapeSpace,
        direction: Direction,
        mirror: Mirror,
        settings: ElasticSettings,
    ) -> Result<Self, AnalysisError> {
        let representation = space.representation();
        let refused = |detail: String| Err(AnalysisError::Parameter { field: "representation", detail });
        let Domain::Line { closed } = representation.domain() else {
            return refused(format!(
                "expected closed or open curves for an elastic distance, got {}",
                kind(space)
            ));
        };
        if representation.count() < FEWEST {
            let what = if closed { "control points" } else { "intervals" };
            return refused(format!("expected at least {FEWEST} {what}, got {}", representation.count()));
        }
        let mut new = Self::of_polygons(representation.dimension(), closed, (direction, mirror), settings)?;
        new.space = Some(space.clone());
        Ok(new)
    }

    /// Polygons in `dimension` dimensions.
    ///
    /// # Errors
    /// [`AnalysisError::Parameter`] of the settings.
    pub fn of_polygons(
        dimension: usize,
        closed: bool,
        (direction, mirror): (Direction, Mirror),
        settings: ElasticSettings,
    ) -> Result<Self, AnalysisError> {
        let settings = settings.checked()?;
        let orients = direction == Direction::Either && closed && dimension == 2;
        let backwards: &[bool] =
            if direction == Direction::Either && !orients { &[false, true] } else { &[false] };
        let mirrors: &[bool] = if mirror == Mirror::Allow { &[false, true] } else { &[false] };
        let ways = mirrors.iter().flat_map(|&mirrored| {
            // Closed planar curves keep their direction.
            let turns = mirrored && closed && dimension == 2;
            backwards.iter().map(move |&reversed| Way { mirrored, reversed: reversed != turns })
        });
        Ok(Self { space: None, dimension, closed, orients, settings, ways: ways.collect() })
    }

    /// The space of the curves; `None` of polygons.
    pub(super) fn space(&self) -> Option<&ShapeSpace> {
        self.space.as_ref()
    }

    pub(super) fn dimension(&self) -> usize {
        self.dimension
    }

    pub(super) fn is_closed(&self) -> bool {
        self.closed
    }

    /// Ways to lay the first curve of a pair.
    pub(super) fn ways(&self) -> &[Way] {
        &self.ways
    }

    /// The settings.
    pub fn settings(&self) -> &ElasticSettings {
        &self.settings
    }

    /// Predicted seconds of a pair on one thread.
    pub fn seconds(&self) -> f64 {
        self.settings.seconds(self.ways.len())
    }

    /// Bytes of a prepared curve.
    pub fn bytes(&self) -> usize {
        let size = self.space.as_ref().map_or(0, |space| space.representation().size());
        ElasticCurve::bytes(size, self.dimension, self.settings.points)
    }

    /// Whether clockwise curves are turned.
    pub(super) fn orients(&self) -> bool {
        self.orients
    }

    /// Prepares curves of these control points, `d·N` coordinate-major numbers each.
    ///
    /// # Errors
    /// [`AnalysisError::Unsuitable`] with the position of the first curve without length, or with a stretch without.
    pub fn prepare(&self, control_points: &[f64]) -> Result<Vec<ElasticCurve>, AnalysisError> {
        let Some(space) = &self.space else { return Ok(Vec::new()) };
        let size = space.representation().size();
        let length = size * self.dimension;
        parallel::try_map(control_points.len() / length, &|index| {
            let own = &control_points[index * length..(index + 1) * length];
            let matrix = Matrix::from_column_slice(size, self.dimension, own);
            let curve = Curve::of(space, &matrix).ok_or_else(|| "expected a curve".to_owned());
            let prepared = curve
                .and_then(|curve| ElasticCurve::of_spline(&curve, own, self.settings.points, self.orients));
            prepared.map_err(|detail| AnalysisError::Unsuitable { index, detail })
        })
    }

    /// The polygon through `points`, `n × d`.
    ///
    /// # Errors
    /// [`AnalysisError::Unsuitable`] without length, or with too few points.
    pub fn prepare_polygon(&self, points: Matrix) -> Result<ElasticCurve, AnalysisError> {
        ElasticCurve::of_polygon(points, self.closed, self.settings.points, self.orients)
    }

    /// The match of two curves. Exchanged curves have the same distance, bit for bit. Cost: [`Self::seconds`].
    pub fn compare(&self, a: &ElasticCurve, b: &ElasticCurve) -> ElasticMatch {
        let mut work = Work::default();
        let (found, exchanged, distance) = self.matched(a, b, &mut work);
        let found = if exchanged { found.swapped(self.closed) } else { found };
        self.as_given(found.laid(self.closed), distance, [a.turned, b.turned])
    }

    /// Points of two curves (control points as they are prepared) at matched places: `M` of closed curves, `M + 1` of open ones, row by
    /// row as given. `None` of polygons.
    pub fn matched_points(&self, shapes: [&[f64]; 2], found: &ElasticMatch) -> Option<[Matrix; 2]> {
        let space = self.space.as_ref()?;
        let last = found.places.len() - 1;
        let count = if self.closed { last } else { last + 1 };
        let at = |shape: &[f64], place: &dyn Fn(usize) -> f64| {
            let control_points =
                Matrix::from_column_slice(shape.len() / self.dimension, self.dimension, shape);
            let curve = Curve::of(space, &control_points)?;
            let arc = ArcParameter::of(&curve);
            let turn = |t: f64| if self.closed { t.rem_euclid(1.0) } else { t.clamp(0.0, 1.0) };
            let rows: Vec<Vec<f64>> = (0..count).map(|i| curve.evaluate(arc.at(turn(place(i))), 0)).collect();
            Some(Matrix::from_fn(count, self.dimension, |i, c| rows[i][c]))
        };
        let [a, b] = shapes;
        Some([at(a, &|i| i as f64 / last as f64)?, at(b, &|i| found.places[i])?])
    }

    /// The matrix of all distances, row by row, with zeros on the diagonal. `go_on` receives the completed fraction and returns whether
    /// to continue.
    ///
    /// Every pair is compared once, and its distance does not depend on the others.
    ///
    /// # Errors
    /// [`AnalysisError::Interrupted`] once `go_on` returns false.
    pub fn matrix(
        &self,
        curves: &[ElasticCurve],
        go_on: &(dyn Fn(f64) -> bool + Sync),
    ) -> Result<Vec<f64>, AnalysisError> {
        let count = curves.len();
        let tiles = count.div_ceil(TILE);
        let pairs: Vec<[usize; 2]> = (0..tiles).flat_map(|i| (i..tiles).map(move |j| [i, j])).collect();
        let (done, all) = (AtomicUsize::new(0), pairs.len().max(1));
        let found: Vec<Vec<f64>> = pairs
            .par_iter()
            .map_init(Work::default, |work, &tile| {
                if !go_on(done.fetch_add(1, Ordering::Relaxed) as f64 / all as f64) {
                    return Err(AnalysisError::Interrupted);
                }
                let distance = |[i, j]: [usize; 2]| self.matched(&curves[i], &curves[j], work).2;
                Ok(of_tile(tile, count).map(distance).collect())
            })
            .collect::<Result<_, _>>()?;
        let mut matrix = vec![0.0; count * count];
        for (&tile, found) in pairs.iter().zip(found) {
            for ([i, j], distance) in of_tile(tile, count).zip(found) {
                matrix[i * count + j] = distance;
                matrix[j * count + i] = distance;
            }
        }
        Ok(matrix)
    }

    /// The match of the curves in the order of what they hold, whether that is the other order, and the distance.
    fn matched(&self, a: &ElasticCurve, b: &ElasticCurve, work: &mut Work) -> (Found, bool, f64) {
        let order = a.order(b);
        if order.is_eq() {
            let count = a.finest().count;
            let path = (0..=count).map(|i| i as f64 / count as f64).collect();
            return (Found { way: Way::default(), rotation: IDENTITY, path, value: 1.0 }, false, 0.0);
        }
        let exchanged = order.is_gt();
        let [first, second] = if exchanged { [b, a] } else { [a, b] };
        let how = (self.closed, &self.ways[..]);
        let mut found = search([first, second], &self.settings, how, work);
        if self.settings.effort == Effort::Thorough {
            let other = search([second, first], &self.settings, how, work);
            if other.value > found.value {
                found = other.swapped(self.closed);
            }
        }
        let mut distance = found.value.clamp(0.0, 1.0).acos();
        if distance < NEAR
            && let Some(space) = &self.space
            && let Some((close, value)) = polished(space, [first, second], &self.settings, &found)
        {
            let exact = value.clamp(0.0, 1.0).acos();
            if exact < distance {
                (found, distance) = (close, exact);
            }
        }
        (found, exchanged, distance)
    }

    /// A match of the curves as prepared, from the first one to the second one laid, as one of the curves as given.
    pub(super) fn as_given(&self, found: Found, distance: f64, turned: [bool; 2]) -> ElasticMatch {
        let reversed = found.way.reversed != (turned[0] != turned[1]);
        let mut places = found.path;
        if found.way.reversed != turned[1] {
            places.iter_mut().for_each(|t| *t = 1.0 - *t);
        }
        if turned[0] {
            places.reverse();
        }
        if self.closed {
            let turns = places[0].floor();
            places.iter_mut().for_each(|t| *t -= turns);
        }
        let d = self.dimension;
        let rotation = (0..d * d).map(|k| found.rotation[k / d][k % d]).collect();
        ElasticMatch { distance, rotation, mirrored: found.way.mirrored, reversed, places }
    }
}

/// Pairs of a tile above the diagonal.
fn of_tile([i, j]: [usize; 2], count: usize) -> impl Iterator<Item = [usize; 2]> {
    let span = move |k: usize| k * TILE..((k + 1) * TILE).min(count);
    span(i).flat_map(move |row| span(j).map(move |column| [row, column])).filter(|[row, column]| row < column)
}

/// The kind of shapes that are no curves.
fn kind(space: &ShapeSpace) -> &'static str {
    match space.domain() {
        Domain::Points => "landmarks, which have no order",
        Domain::Sheet { .. } => "surfaces",
        Domain::Vertices => "meshes",
        Domain::Line { .. } => "curves",
    }
}
