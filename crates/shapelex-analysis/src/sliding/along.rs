//! Points that slide along the splines of curves, in their parameters, until they correspond.
//!
//! ```text
//! x_j = r(t_j + T_j),   T_j ← T_j + ⟨r'/|r'|, target_j − x_j⟩ / ℓ,   Σ_k T_kj = 0
//! ```
//!
//! Places are fractions `t` of the length, so that points never leave the curve. A round takes one Gauss–Newton step of the criterion
//! from where the points are, subtracts the mean over the curves, and superimposes: nothing else would anchor the common parameter, since
//! all curves can slide together with their mean. Steps between neighbours stay within [`BOUNDS`] of equal ones: points keep their order.
//! Ends of open curves stay. The result is the same in any order of the curves.
//!
//! Source: Bookstein, *Landmark methods for forms without landmarks* (1997), for sliding; steps in the parameter and the mean displacement 0 are
//! ours.

use super::centred::by_content;
use super::directions::{Direction, SlidingCriterion, bending, displacements};
use super::error::SlidingError;
use super::superimposed::{Superimposed, distance, superimpose};
use super::table::Sliders;
use crate::anderson::Anderson;
use crate::fit::transform;
use crate::metric::norm;
use crate::placement::Placement;
use crate::unit_size::{Placed, unit};
use crate::watch::Watch;
use shapelex_geometry::arc_parameter::ArcParameter;
use shapelex_geometry::curve::Curve;
use shapelex_numeric::parallel;

/// Smallest and largest step between neighbours, relative to equal steps.
pub const BOUNDS: [f64; 2] = [0.25, 4.0];
/// Most rounds.
pub const ROUNDS: usize = 500;
/// Move of the consensus, at unit size, at which it has converged.
const STILL: f64 = 1e-9;
/// Length of a curve, relative to its coordinates, below which it has no extent.
const SHORTEST: f64 = 1e-12;
/// Root of the mean square of what a round changes in the places of a curve, at the same time.
const SAME: f64 = 1e-8;

/// Curves whose points have slid.
#[derive(Debug, Clone)]
pub struct SlidCurves {
    /// Places of the points of each curve, as fractions of its length from where it begins: `M + 1`, those of closed curves go on beyond 0
    /// and 1; they decrease where a curve is traversed backwards.
    pub places: Vec<Vec<f64>>,
    /// Number of rounds.
    pub rounds: usize,
    /// Whether the last round left the result as it was.
    pub converged: bool,
    /// Number of curves with a step between neighbours at its bound.
    pub bounded: usize,
}

/// A curve that is tracked.
struct Tracked<'a> {
    curve: &'a Curve,
    arc: ArcParameter<'a>,
    placement: Placement,
    /// Place of the first point.
    start: f64,
}

/// Points of a curve at some places, at unit size, with their directions.
struct Points {
    unit: Vec<f64>,
    place: Placed,
    directions: Vec<Direction>,
}

struct State<'a> {
    curves: Vec<Tracked<'a>>,
    sliders: Sliders,
    dimension: usize,
    closed: bool,
    /// Number of steps, `M`.
    steps: usize,
    criterion: SlidingCriterion,
}

/// Slides `steps` points (open curves: one more, with the ends) along curves, which begin as `placements` say, one for each. All curves
/// are closed, or all open.
///
/// Cost of a round: some 50 speeds for each point; by bending energy also `M³`, and `M³/3` for each curve.
///
/// # Errors
/// Curves without extent; points that stand still; [`SlidingError::Cancelled`].
pub fn slide_along(
    curves: &[Curve],
    placements: &[Placement],
    (steps, criterion): (usize, SlidingCriterion),
    watch: &dyn Watch,
) -> Result<SlidCurves, SlidingError> {
    let closed = curves.first().is_some_and(Curve::is_closed);
    let tracked = parallel::try_map(curves.len(), &|k| {
        Tracked::new(&curves[k], placements[k]).ok_or(SlidingError::NoExtent { shape: k })
    })?;
    let mut order: Vec<usize> = (0..curves.len()).collect();
    let contents: Vec<Vec<f64>> = tracked.iter().map(Tracked::content).collect();
    order.sort_by(|&a, &b| by_content(&contents[a], &contents[b]));
    let mut places = vec![0; order.len()];
    order.iter().enumerate().for_each(|(place, &k)| places[k] = place);
    let mut tracked: Vec<Option<Tracked<'_>>> = tracked.into_iter().map(Some).collect();
    let curves: Vec<Tracked<'_>> = order.iter().filter_map(|&k| tracked[k].take()).collect();
    let dimension = curves.first().map_or(2, |one| one.curve.dimension());
    let sliders = Sliders { curves: rows(steps, closed), surface: Vec::new() };
    let state = State { curves, sliders, dimension, closed, steps, criterion };
    let mut found = state.run(watch).map_err(|error| error.numbered(&order))?;
    found.places = places.into_iter().map(|place| std::mem::take(&mut found.places[place])).collect();
    Ok(found)
}

/// Rows *before, slide, after* of points along a curve.
fn rows(steps: usize, closed: bool) -> Vec<[usize; 3]> {
    if closed {
        return (0..steps).map(|j| [(j + steps - 1) % steps, j, (j + 1) % steps]).collect();
    }
    (1..steps).map(|j| [j - 1, j, j + 1]).collect()
}

impl<'a> Tracked<'a> {
    /// `None` of a curve without length.
    fn new(curve: &'a Curve, placement: Placement) -> Option<Self> {
        let arc = ArcParameter::of(curve);
        // Shorter curves are rounding errors of their coordinates.
        let coefficients = (0..curve.halves())
            .flat_map(|half| (0..curve.dimension()).map(move |c| curve.polynomial(half, c)[0].abs()));
        if !(arc.length() > SHORTEST * coefficients.fold(0.0, f64::max)) {
            return None;
        }
        let shift = f64::from(placement.shift) / curve.segments() as f64;
        let start = match (curve.is_closed(), placement.reversed) {
            (true, false) => arc.fraction(shift),
            (true, true) => arc.fraction((-shift).rem_euclid(1.0)),
            (false, reversed) => f64::from(u8::from(reversed)),
        };
        Some(Self { curve, arc, placement, start })
    }

    /// Numbers by which curves are ordered.
    fn content(&self) -> Vec<f64> {
        (0..self.curve.halves())
            .flat_map(|half| (0..self.curve.dimension()).map(move |c| (half, c)))
            .flat_map(|(half, c)| self.curve.polynomial(half, c).to_vec())
            .collect()
    }

    fn sign(&self) -> f64 {
        if self.placement.reversed { -1.0 } else { 1.0 }
    }
}

impl State<'_> {
    /// Places of curve `k` after it has slid by `by`.
    fn places(&self, k: usize, by: &[f64]) -> Vec<f64> {
        let one = &self.curves[k];
        let first = usize::from(!self.closed);
        let at = |j: usize| {
            let slid = j.checked_sub(first).and_then(|i| by.get(i)).copied().unwrap_or(0.0);
            j as f64 / self.steps as f64 + slid
        };
        let mut forwards: Vec<f64> = (0..self.steps).map(at).collect();
        forwards.push(if self.closed { forwards[0] + 1.0 } else { 1.0 });
        forwards.into_iter().map(|t| one.start + one.sign() * t).collect()
    }

    /// Points of curve `k` after it has slid by `by`.
    fn points(&self, k: usize, by: &[f64]) -> Result<Points, SlidingError> {
        let (one, d) = (&self.curves[k], self.dimension);
        let places = self.places(k, by);
        let count = if self.closed { self.steps } else { self.steps + 1 };
        let mut flat = vec![0.0; d * count];
        let mut along = vec![[0.0; 3]; count];
        for (j, t) in places[..count].iter().enumerate() {
            let u = one.arc.at(if self.closed { t.rem_euclid(1.0) } else { t.clamp(0.0, 1.0) });
            let (point, speed) = (one.curve.evaluate(u, 0), one.curve.evaluate(u, 1));
            let length = norm(&speed);
            if !(length > 0.0) {
                return Err(SlidingError::NoDirection { shape: k, point: j });
            }
            for c in 0..d {
                let mirror = if one.placement.mirrored && c == 0 { -1.0 } else { 1.0 };
                flat[c * count + j] = mirror * point[c];
                along[j][c] = mirror * one.sign() * speed[c] / length;
            }
        }
        let (unit, place) = unit(&flat, d);
        if !(place.size > 0.0) {
            return Err(SlidingError::NoExtent { shape: k });
        }
        let slides = self.sliders.curves.iter().map(|row| row[1]);
        let directions = slides.map(|point| Direction { point, along: along[point] }).collect();
        Ok(Points { unit, place, directions })
    }

    fn all(&self, slid: &[f64]) -> Result<Vec<Points>, SlidingError> {
        let m = self.sliders.directions();
        parallel::try_map(self.curves.len(), &|k| self.points(k, &slid[k * m..(k + 1) * m]))
    }

    /// Places that the criterion asks for, with the mean 0.
    fn wanted(
        &self,
        slid: &[f64],
        points: &[Points],
        placed: &Superimposed,
    ) -> Result<Vec<f64>, SlidingError> {
        let (d, m, count) = (self.dimension, self.sliders.directions(), self.curves.len());
        let bending = match self.criterion {
            SlidingCriterion::BendingEnergy => Some(bending(&placed.consensus, d, &self.sliders)?),
            SlidingCriterion::Procrustes => None,
        };
        let found = parallel::try_map(count, &|shape| {
            let one = &points[shape];
            let target = transform(&placed.rotations[shape].transpose(), &placed.consensus);
            let by = displacements(&one.unit, &target, &one.directions, (d, bending.as_ref()));
            let by = by.ok_or(SlidingError::Free { shape })?;
            let unit = one.place.size / self.curves[shape].arc.length();
            let own = &slid[shape * m..(shape + 1) * m];
            Ok(own.iter().zip(by).map(|(slid, t)| slid - unit * t).collect::<Vec<f64>>())
        })?;
        let mut found = found.concat();
        for j in 0..m {
            let mean = (0..count).map(|k| found[k * m + j]).sum::<f64>() / count as f64;
            (0..count).for_each(|k| found[k * m + j] -= mean);
        }
        Ok(found)
    }

    /// Shortens what curves have slid, each as a whole, until steps between neighbours are within their bounds. Returns the number of
    /// curves that were changed.
    fn bound(&self, slid: &mut [f64]) -> usize {
        let m = self.sliders.directions();
        let equal = 1.0 / self.steps as f64;
        let mut changed = 0;
        for own in slid.chunks_exact_mut(m) {
            let step = |j: usize| match (self.closed, j) {
                (true, j) => own[(j + 1) % m] - own[j],
                (false, 0) => own[0],
                (false, j) if j == m => -own[m - 1],
                (false, j) => own[j] - own[j - 1],
            };
            let factor = |change: f64| {
                let room = if change < 0.0 { 1.0 - BOUNDS[0] } else { BOUNDS[1] - 1.0 };
                if change.abs() > room * equal { room * equal / change.abs() } else { 1.0 }
            };
            let least = (0..self.steps).map(|j| factor(step(j))).fold(1.0, f64::min);
            if least < 1.0 {
                own.iter_mut().for_each(|slid| *slid *= least);
                changed += 1;
            }
        }
        changed
    }

    fn run(&self, watch: &dyn Watch) -> Result<SlidCurves, SlidingError> {
        let m = self.sliders.directions();
        let mut slid = vec![0.0; self.curves.len() * m];
        let mut points = self.all(&slid)?;
        let mut consensus = points.first().map(|one| one.unit.clone()).unwrap_or_default();
        let mut anderson = Anderson::default();
        let (mut rounds, mut converged, mut last_move, mut bounded) = (0, false, f64::INFINITY, 0);
        for round in 1..=ROUNDS {
            if watch.stop() {
                return Err(SlidingError::Cancelled);
            }
            watch.worked(1);
            rounds = round;
            let units: Vec<Vec<f64>> = points.iter().map(|one| one.unit.clone()).collect();
            let placed = superimpose(&units, &consensus, self.dimension);
            last_move = if round == 1 { last_move } else { distance(&placed.consensus, &consensus) };
            let mut wanted = self.wanted(&slid, &points, &placed)?;
            bounded = self.bound(&mut wanted);
            let step: Vec<f64> = wanted.iter().zip(&slid).map(|(new, old)| new - old).collect();
            let change = norm(&step) / (self.curves.len() as f64).sqrt();
            converged = change < SAME && last_move < STILL;
            let mut next = anderson.next(&slid, &step);
            self.bound(&mut next);
            slid = if converged { wanted } else { next };
            consensus = placed.consensus;
            if converged {
                break;
            }
            points = self.all(&slid)?;
        }
        let places = (0..self.curves.len()).map(|k| self.places(k, &slid[k * m..(k + 1) * m])).collect();
        Ok(SlidCurves { places, rounds, converged, bounded })
    }
}
