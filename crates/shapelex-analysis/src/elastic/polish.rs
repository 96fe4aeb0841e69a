//! Close pairs, matched by the tangents of their splines instead of those of chords.
//!
//! ```text
//! F = Σ_i √(Δt_i / M) Σ_g ω_g w(s_ig, t_ig),   t linear within a strip, three Gauss nodes g
//! ```
//!
//! All places and the rotation are improved together by L-BFGS. Distances are `√(2 (1 − F))`, so that chords of smooth curves, whose
//! tangents are right to the curvature times a hundredth of the length, leave some thousandths between copies; this leaves `10⁻⁵`.

use shapelex_geometry::curve::Curve;
use shapelex_geometry::representation::ShapeSpace;
use shapelex_numeric::bounded::never;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::lbfgs::{Objective, Rules, minimise};

use super::candidates::product;
use super::curve::{ElasticCurve, Spline};
use super::pairing::{Found, Way};
use super::settings::ElasticSettings;
use super::{IDENTITY, Rotation};

/// Nodes of the Gauss rule on [0, 1], and weights.
const NODES: [f64; 3] = [0.112_701_665_379_258_3, 0.5, 0.887_298_334_620_741_7];
const WEIGHTS: [f64; 3] = [5.0 / 18.0, 4.0 / 9.0, 5.0 / 18.0];

/// Share of equal steps that is mixed into the path at the beginning: roots of vanishing steps have no slope.
const RAISED: f64 = 0.02;

/// Steps of the minimisation; most end earlier.
const ITERATIONS: usize = 60;

/// Step of the numerical derivative of a rotation.
const TURN: f64 = 1e-5;

/// Radians of a unit of the variables of the rotation, whose curvature is then like that of the others.
const SCALE: f64 = 5.0;

/// Tangents of a spline at fractions of its length, from a table of its parameters.
struct Tangents {
    curve: Curve,
    /// Signs of the coordinates of tangents.
    signs: [f64; 3],
    /// Parameters at equal fractions, and their slopes.
    parameters: Vec<f64>,
    slopes: Vec<f64>,
}

impl Tangents {
    /// Of a prepared curve that is laid in some way.
    fn new(space: &ShapeSpace, prepared: &ElasticCurve, way: Way) -> Option<Self> {
        let Spline { control_points, parameters, length } = prepared.spline.as_ref()?;
        let d = space.representation().dimension();
        let matrix = Matrix::from_column_slice(control_points.len() / d, d, control_points);
        let curve = Curve::of(space, &matrix)?;
        let curve = curve.scaled(Curve::unit(&[&curve]).recip());
        let mut parameters = parameters.clone();
        if way.reversed {
            parameters.reverse();
        }
        let count = parameters.len() - 1;
        // Its parameters fall where the curve is traversed backwards.
        let backwards = parameters[count] < parameters[0];
        let direction = if backwards { -1.0 } else { 1.0 };
        let slope = |i: usize| {
            let speed = curve.evaluate(parameters[i], 1).iter().map(|x| x * x).sum::<f64>().sqrt();
            // Three times the least step beside it keeps a cubic monotone.
            let beside = [i.saturating_sub(1), i.min(count - 1)];
            let step = beside.map(|k| (parameters[k + 1] - parameters[k]).abs());
            direction * (length / (count as f64 * speed)).min(3.0 * step[0].min(step[1]))
        };
        let slopes: Vec<f64> = (0..=count).map(slope).collect();
        let sign = |c: usize| if (way.mirrored && c == 0) != backwards { -1.0 } else { 1.0 };
        Some(Self { curve, signs: [0, 1, 2].map(sign), parameters, slopes })
    }

    /// Unit tangent at the fraction `t`, and its derivative; `None` where the curve stands still.
    fn at(&self, t: f64) -> Option<([f64; 3], [f64; 3])> {
        let count = self.parameters.len() - 1;
        let turns = if self.curve.is_closed() { t.floor() } else { 0.0 };
        let place = (t - turns) * count as f64;
        let k = (place.max(0.0) as usize).min(count - 1);
        let x = place - k as f64;
        let (a, b) = (self.parameters[k], self.parameters[k + 1]);
        let (p, q) = (self.slopes[k], self.slopes[k + 1]);
        let step = b - a;
        // The cubic with these ends and slopes.
        let (c2, c3) = (3.0 * step - 2.0 * p - q, p + q - 2.0 * step);
        let u = a + x * (p + x * (c2 + x * c3));
        let slope = count as f64 * (p + x * (2.0 * c2 + 3.0 * x * c3));
        let (half, s) = self.curve.locate(u);
        let segments = self.curve.segments() as f64;
        let (mut first, mut second, mut square, mut across) = ([0.0; 3], [0.0; 3], 0.0, 0.0);
        for c in 0..self.curve.dimension() {
            first[c] = segments * self.curve.derivative_at(half, c, s, 1);
            second[c] = segments * segments * self.curve.derivative_at(half, c, s, 2);
            square += first[c] * first[c];
            across += first[c] * second[c];
        }
        if !(square > 0.0) {
            return None;
        }
        let length = square.sqrt();
        let (mut tangent, mut turning) = ([0.0; 3], [0.0; 3]);
        for c in 0..self.curve.dimension() {
            let sign = self.signs[c] / length;
            tangent[c] = sign * first[c];
            turning[c] = sign * (second[c] - across / square * first[c]) * slope;
        }
        Some((tangent, turning))
    }
}

/// `1 − F` as a function of the places and the rotation.
struct Mismatch<'a> {
    second: &'a Tangents,
    /// Tangents of the first curve at the nodes.
    first: Vec<[f64; 3]>,
    count: usize,
    closed: bool,
    elasticity: f64,
    rotation: Rotation,
    /// Number of angles of the rotation: 0, 1 or 3.
    angles: usize,
}

impl Mismatch<'_> {
    /// Places of all ends of strips.
    ///
    /// ```text
    /// t_i = t_0 + Z_i + (i/M) (1 − Z_M),   Z_i = Σ_{j<i} z_j
    /// ```
    ///
    /// The curvature with respect to steps `z` is about the same for all of them; that with respect to places is ten thousand times
    /// larger for some changes than for others.
    fn places(&self, x: &[f64]) -> Vec<f64> {
        let (start, steps) = self.steps(x);
        let mut sums = vec![0.0; self.count + 1];
        (0..self.count).for_each(|i| sums[i + 1] = sums[i] + steps[i]);
        let rest = (1.0 - sums[self.count]) / self.count as f64;
        sums.iter().enumerate().map(|(i, sum)| start + sum + i as f64 * rest).collect()
    }

    /// The first place, which is free of closed curves, and the steps.
    fn steps<'x>(&self, x: &'x [f64]) -> (f64, &'x [f64]) {
        if self.closed { (x[0], &x[1..]) } else { (0.0, x) }
    }

    /// The slopes of the variables that make the places from those of the places.
    fn set_gradient(&self, slopes: &[f64], gradient: &mut [f64]) {
        let own = if self.closed { &mut gradient[1..] } else { &mut *gradient };
        let all: f64 = slopes.iter().enumerate().map(|(i, slope)| i as f64 * slope).sum();
        let mut after = 0.0;
        for i in (0..self.count).rev() {
            after += slopes[i + 1];
            own[i] = all / self.count as f64 - after;
        }
        if self.closed {
            gradient[0] = -slopes.iter().sum::<f64>();
        }
    }

    /// The rotation with these angles.
    fn turned(&self, angles: &[f64]) -> Rotation {
        let vector = match angles {
            [] => return self.rotation,
            [angle] => [0.0, 0.0, SCALE * angle],
            more => [SCALE * more[0], SCALE * more[1], SCALE * more[2]],
        };
        product(&self.rotation, &exponential(vector))
    }
}

/// The rotation about `vector` by its length.
fn exponential(vector: [f64; 3]) -> Rotation {
    let angle = vector.iter().map(|x| x * x).sum::<f64>().sqrt();
    let (sine, versine) =
        if angle > 1e-6 { (angle.sin() / angle, (1.0 - angle.cos()) / (angle * angle)) } else { (1.0, 0.5) };
    let [x, y, z] = vector;
    let skew = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]];
    let square = product(&skew, &skew);
    let mut rotation = IDENTITY;
    for r in 0..3 {
        for c in 0..3 {
            rotation[r][c] += sine * skew[r][c] + versine * square[r][c];
        }
    }
    rotation
}

impl Objective for Mismatch<'_> {
    fn evaluate(&mut self, x: &[f64], gradient: &mut [f64]) -> f64 {
        let (places, free) = (self.places(x), x.len() - self.angles);
        let rotation = self.turned(&x[free..]);
        let (mut value, mut outer) = (0.0, [[0.0; 3]; 3]);
        let mut slopes = vec![0.0; self.count + 1];
        for i in 0..self.count {
            let step = places[i + 1] - places[i];
            if !(step > 0.0) {
                return f64::NAN;
            }
            let root = (step / self.count as f64).sqrt();
            let (mut mean, mut early, mut late) = (0.0, 0.0, 0.0);
            for g in 0..NODES.len() {
                let own = &self.first[i * NODES.len() + g];
                let Some((tangent, turning)) = self.second.at(places[i] + NODES[g] * step) else {
                    return f64::NAN;
                };
                let (mut w, mut slope) = (1.0 - self.elasticity, 0.0);
                for r in 0..3 {
                    let weighted = WEIGHTS[g] * root * own[r];
                    for c in 0..3 {
                        let factor = self.elasticity * own[r] * rotation[r][c];
                        w += factor * tangent[c];
                        slope += factor * turning[c];
                        outer[r][c] += weighted * tangent[c];
                    }
                }
                mean += WEIGHTS[g] * w;
                early += WEIGHTS[g] * slope * (1.0 - NODES[g]);
                late += WEIGHTS[g] * slope * NODES[g];
            }
            value += root * mean;
            let stretch = 0.5 * root * mean / step;
            slopes[i] += root * early - stretch;
            slopes[i + 1] += root * late + stretch;
        }
        self.set_gradient(&slopes, gradient);
        for k in 0..self.angles {
            let mut ends = [x[free..].to_vec(), x[free..].to_vec()];
            (ends[0][k], ends[1][k]) = (ends[0][k] - TURN, ends[1][k] + TURN);
            let [low, high] = ends.map(|angles| self.turned(&angles));
            let sum: f64 =
                (0..9).map(|j| (high[j / 3][j % 3] - low[j / 3][j % 3]) * outer[j / 3][j % 3]).sum();
            gradient[free + k] = -self.elasticity * sum / (2.0 * TURN);
        }
        1.0 - value
    }

    fn displacement(&self, direction: &[f64]) -> f64 {
        direction.iter().fold(0.0, |most, d| d.abs().max(most))
    }
}

/// A match that is improved by the tangents of the splines, with its value; `None` where they are not known.
///
/// Cost: 40 iterations of 3 M tangents.
pub(super) fn polished(
    space: &ShapeSpace,
    [first, second]: [&ElasticCurve; 2],
    settings: &ElasticSettings,
    found: &Found,
) -> Option<(Found, f64)> {
    let own = Tangents::new(space, first, found.way)?;
    let second = Tangents::new(space, second, Way::default())?;
    let count = found.path.len() - 1;
    let node = |k: usize| (k / NODES.len()) as f64 + NODES[k % NODES.len()];
    let tangents =
        (0..count * NODES.len()).map(|k| own.at(node(k) / count as f64).map(|(tangent, _)| tangent));
    let (d, closed) = (space.representation().dimension(), space.representation().is_closed());
    let angles = if !settings.rotation {
        0
    } else if d == 2 {
        1
    } else {
        3
    };
    let mut mismatch = Mismatch {
        second: &second,
        first: tangents.collect::<Option<_>>()?,
        count,
        closed,
        elasticity: settings.elasticity,
        rotation: found.rotation,
        angles,
    };
    // Of the sum of the steps, only the differences count.
    let step = |i: usize| (1.0 - RAISED) * (found.path[i + 1] - found.path[i]);
    let start = closed.then_some(found.path[0]);
    let steps = (0..count).map(step).chain(std::iter::repeat_n(0.0, angles));
    let mut x: Vec<f64> = start.into_iter().chain(steps).collect();
    let unit = (count as f64).recip();
    let rules = Rules {
        memory: 10,
        iterations: ITERATIONS,
        first: 0.05 * unit,
        clip: unit,
        tolerance: 1e-5 * unit,
        relative: 1e-9,
    };
    let minimum = minimise(&mut mismatch, &mut x, &rules, &never);
    let value = 1.0 - minimum.history.last().copied().filter(|value| value.is_finite())?;
    let mut path = mismatch.places(&x);
    if closed {
        let turns = path[0].floor();
        path.iter_mut().for_each(|t| *t -= turns);
    }
    let rotation = mismatch.turned(&x[x.len() - angles..]);
    Some((Found { way: found.way, rotation, path, value }, value))
}
