//! Minimisation by L-BFGS with a bound on the displacement of a step.
//!
//! ```text
//! d = −H g,   H from the last m pairs (s, y) by two loops,   H₀ = sᵀy/yᵀy
//! E(x + t d) ≤ E(x) + 10⁻⁴ t gᵀd,   t ≤ clip / displacement(d)
//! ```
//!
//! A pair is kept if `sᵀy > 10⁻¹⁰ |s| |y|`. If no step along `d` is found, the pairs are dropped and the steepest descent is
//! tried once. With noise in the objective, the end by [`Ending::LineSearch`] after progress is normal.

use std::collections::VecDeque;

use super::bounded::Stop;
use super::kernels::dot;

/// Decrease that a step must achieve, as a fraction of that predicted by the gradient.
const ARMIJO: f64 = 1e-4;
/// Range of a shortened step relative to the previous one.
const SHORTENING: [f64; 2] = [0.1, 0.5];
/// Maximum number of trials of a line search.
const MAX_TRIALS: usize = 20;
/// A pair whose cosine is smaller carries rounding rather than curvature.
const LEAST_CURVATURE: f64 = 1e-10;
/// Number of consecutive small steps that end the iteration: one may be small by the clip or by chance.
const SMALL_STEPS: usize = 2;

/// A differentiable function.
pub trait Objective {
    /// The value at `x`; writes the gradient. A value that is not finite marks `x` as forbidden.
    fn evaluate(&mut self, x: &[f64], gradient: &mut [f64]) -> f64;

    /// Size of a change of `x` that the clip and the tolerance refer to. Proportional to the length of `direction`; for
    /// instance, the largest displacement of a point.
    fn displacement(&self, direction: &[f64]) -> f64;
}

/// Rules of a minimisation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rules {
    /// Number of pairs that are kept, `m`.
    pub memory: usize,
    /// Maximum number of iterations.
    pub iterations: usize,
    /// Displacement of the first step and of steps along the steepest descent.
    pub first: f64,
    /// Maximum displacement of a step.
    pub clip: f64,
    /// Steps with a smaller displacement are small.
    pub tolerance: f64,
    /// Steps that change the value by less, relative to the value, are small.
    pub relative: f64,
}

impl Default for Rules {
    fn default() -> Self {
        Self { memory: 10, iterations: 150, first: 1.0, clip: 2.0, tolerance: 0.005, relative: 1e-7 }
    }
}

/// Reason for which a minimisation ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// Two consecutive steps were small, or the gradient is zero.
    Converged,
    /// The maximum number of iterations.
    Limit,
    /// No step decreases the value.
    LineSearch,
    /// The caller wanted to stop.
    Stopped,
}

/// Result of a minimisation.
#[derive(Debug, Clone, PartialEq)]
pub struct Minimum {
    /// The reason for the end.
    pub ending: Ending,
    /// Number of iterations.
    pub iterations: usize,
    /// Number of evaluations of the value and the gradient.
    pub evaluations: usize,
    /// Value at the start and after every iteration; decreases.
    pub history: Vec<f64>,
}

/// Minimises `objective` from `x`, which becomes the point of the smallest value found.
///
/// At most `20` evaluations per iteration and as many for a restart. Cost without them: `4 m n` per iteration.
pub fn minimise(objective: &mut impl Objective, x: &mut Vec<f64>, rules: &Rules, stop: Stop<'_>) -> Minimum {
    let mut gradient = vec![0.0; x.len()];
    let value = objective.evaluate(x, &mut gradient);
    let mut at = Point { x: std::mem::take(x), gradient, value };
    let mut pairs = Pairs { kept: VecDeque::new(), most: rules.memory };
    let mut report =
        Minimum { ending: Ending::Limit, iterations: 0, evaluations: 1, history: vec![at.value] };
    let mut small = 0;
    while report.iterations < rules.iterations {
        if stop() {
            report.ending = Ending::Stopped;
            break;
        }
        if at.gradient.iter().all(|slope| *slope == 0.0) {
            report.ending = Ending::Converged;
            break;
        }
        let Some(next) = step(objective, &at, &mut pairs, rules, &mut report.evaluations) else {
            report.ending = Ending::LineSearch;
            break;
        };
        let moved = difference(&next.x, &at.x);
        let change = (next.value - at.value).abs();
        let is_small =
            objective.displacement(&moved) < rules.tolerance && change < rules.relative * next.value.abs();
        pairs.push(moved, difference(&next.gradient, &at.gradient));
        at = next;
        report.iterations += 1;
        report.history.push(at.value);
        small = if is_small { small + 1 } else { 0 };
        if small == SMALL_STEPS {
            report.ending = Ending::Converged;
            break;
        }
    }
    *x = at.x;
    report
}

/// A point with the value and the gradient there.
struct Point {
    x: Vec<f64>,
    gradient: Vec<f64>,
    value: f64,
}

/// The next point: along the quasi-Newton direction, or else, without pairs, along the steepest descent.
fn step(
    objective: &mut impl Objective,
    at: &Point,
    pairs: &mut Pairs,
    rules: &Rules,
    evaluations: &mut usize,
) -> Option<Point> {
    if !pairs.kept.is_empty() {
        let direction = pairs.direction(&at.gradient);
        if let Some(next) = search(objective, at, &direction, rules, evaluations) {
            return Some(next);
        }
        pairs.kept.clear();
    }
    let largest = objective.displacement(&at.gradient);
    if !(largest > 0.0) {
        return None;
    }
    let direction: Vec<f64> = at.gradient.iter().map(|slope| -slope * (rules.first / largest)).collect();
    search(objective, at, &direction, rules, evaluations)
}

/// Line search by quadratic interpolation. `None` if no trial decreases the value enough.
fn search(
    objective: &mut impl Objective,
    at: &Point,
    direction: &[f64],
    rules: &Rules,
    evaluations: &mut usize,
) -> Option<Point> {
    let slope = dot(&at.gradient, direction);
    let largest = objective.displacement(direction);
    if !(slope < 0.0 && largest > 0.0 && largest.is_finite()) {
        return None;
    }
    let mut t = (rules.clip / largest).min(1.0);
    let mut gradient = vec![0.0; direction.len()];
    for _ in 0..MAX_TRIALS {
        let x: Vec<f64> = at.x.iter().zip(direction).map(|(x, d)| x + t * d).collect();
        let value = objective.evaluate(&x, &mut gradient);
        *evaluations += 1;
        if value <= at.value + ARMIJO * t * slope {
            return Some(Point { x, gradient, value });
        }
        // Minimum of the parabola through both values with the slope at the start.
        let parabola = -0.5 * slope * t * t / (value - at.value - t * slope);
        let [least, most] = SHORTENING.map(|factor| factor * t);
        t = if parabola.is_finite() { parabola.clamp(least, most) } else { most };
    }
    None
}

fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

/// A step `s` with the change `y` of the gradient.
struct Pair {
    step: Vec<f64>,
    change: Vec<f64>,
    /// `1/sᵀy`.
    weight: f64,
}

/// The last pairs, oldest first.
struct Pairs {
    kept: VecDeque<Pair>,
    most: usize,
}

impl Pairs {
    fn push(&mut self, step: Vec<f64>, change: Vec<f64>) {
        let product = dot(&step, &change);
        let lengths = (dot(&step, &step) * dot(&change, &change)).sqrt();
        if product > LEAST_CURVATURE * lengths && self.most > 0 {
            if self.kept.len() == self.most {
                self.kept.pop_front();
            }
            self.kept.push_back(Pair { step, change, weight: product.recip() });
        }
    }

    /// `−H g` by two loops.
    fn direction(&self, gradient: &[f64]) -> Vec<f64> {
        let mut direction: Vec<f64> = gradient.iter().map(|slope| -slope).collect();
        let mut shares = Vec::with_capacity(self.kept.len());
        for pair in self.kept.iter().rev() {
            let share = pair.weight * dot(&pair.step, &direction);
            add_scaled(&mut direction, &pair.change, -share);
            shares.push(share);
        }
        if let Some(last) = self.kept.back() {
            let scale = 1.0 / (last.weight * dot(&last.change, &last.change));
            direction.iter_mut().for_each(|d| *d *= scale);
        }
        for (pair, share) in self.kept.iter().zip(shares.into_iter().rev()) {
            let correction = share - pair.weight * dot(&pair.change, &direction);
            add_scaled(&mut direction, &pair.step, correction);
        }
        direction
    }
}

fn add_scaled(sum: &mut [f64], vector: &[f64], factor: f64) {
    sum.iter_mut().zip(vector).for_each(|(sum, value)| *sum += factor * value);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bounded::never;

    /// A function with its gradient; remembers the largest step between two evaluations.
    struct Function<F> {
        function: F,
        last: Vec<f64>,
        longest: f64,
    }

    impl<F: FnMut(&[f64], &mut [f64]) -> f64> Objective for Function<F> {
        fn evaluate(&mut self, x: &[f64], gradient: &mut [f64]) -> f64 {
            if !self.last.is_empty() {
                self.longest = self.longest.max(self.displacement(&difference(x, &self.last)));
            }
            self.last = x.to_vec();
            (self.function)(x, gradient)
        }

        fn displacement(&self, direction: &[f64]) -> f64 {
            direction.iter().fold(0.0, |most, d| d.abs().max(most))
        }
    }

    fn function<F: FnMut(&[f64], &mut [f64]) -> f64>(function: F) -> Function<F> {
        Function { function, last: Vec::new(), longest: 0.0 }
    }

    fn rosenbrock(x: &[f64], gradient: &mut [f64]) -> f64 {
        let (a, b) = (1.0 - x[0], x[1] - x[0] * x[0]);
        gradient.copy_from_slice(&[-2.0 * a - 400.0 * x[0] * b, 200.0 * b]);
        a * a + 100.0 * b * b
    }

    const EXACT: Rules =
        Rules { memory: 10, iterations: 500, first: 0.1, clip: 0.5, tolerance: 1e-9, relative: 1e-9 };

    #[test]
    fn the_valley_of_rosenbrock_is_followed_to_its_end() {
        let mut objective = function(rosenbrock);
        let mut x = vec![-1.2, 1.0];
        let found = minimise(&mut objective, &mut x, &EXACT, &never);
        assert!((x[0] - 1.0).abs() < 1e-5 && (x[1] - 1.0).abs() < 1e-5, "{x:?} {found:?}");
        assert!(found.iterations < 80 && found.evaluations < 160, "{found:?}");
        assert!(found.history.is_sorted_by(|a, b| a >= b));
        // The first trial of a search is within the clip of its start, and later ones are nearer.
        assert!(objective.longest <= 2.0 * EXACT.clip, "{}", objective.longest);
    }

    #[test]
    fn quadratic_functions_of_many_scales_converge() {
        let n = 40;
        let mut objective = function(|x: &[f64], gradient: &mut [f64]| {
            let mut value = 1.0;
            for (i, (x, slope)) in x.iter().zip(gradient).enumerate() {
                let (scale, off) = (1.0 + i as f64 * i as f64, x - i as f64 / 10.0);
                *slope = scale * off;
                value += 0.5 * scale * off * off;
            }
            value
        });
        let mut x = vec![0.0; n];
        let found = minimise(&mut objective, &mut x, &EXACT, &never);
        assert_eq!(found.ending, Ending::Converged, "{found:?}");
        for (i, x) in x.iter().enumerate() {
            assert!((x - i as f64 / 10.0).abs() < 1e-4, "{x} for {}", i as f64 / 10.0);
        }
    }

    #[test]
    fn endings_are_told_apart() {
        let start = || vec![-1.2, 1.0];
        let rules = Rules { iterations: 3, ..EXACT };
        let found = minimise(&mut function(rosenbrock), &mut start(), &rules, &never);
        assert_eq!((found.ending, found.iterations), (Ending::Limit, 3));
        // A gradient of the wrong sign: no direction helps.
        let uphill = |x: &[f64], gradient: &mut [f64]| {
            let value = rosenbrock(x, gradient);
            gradient.iter_mut().for_each(|slope| *slope = -*slope);
            value
        };
        let mut x = start();
        let found = minimise(&mut function(uphill), &mut x, &EXACT, &never);
        assert_eq!((found.ending, found.iterations, x), (Ending::LineSearch, 0, start()));
        let found = minimise(&mut function(rosenbrock), &mut start(), &EXACT, &|| true);
        assert_eq!((found.ending, found.evaluations), (Ending::Stopped, 1));
        let found = minimise(&mut function(rosenbrock), &mut vec![1.0, 1.0], &EXACT, &never);
        assert_eq!((found.ending, found.iterations), (Ending::Converged, 0));
    }

    #[test]
    fn forbidden_points_are_avoided() {
        let walled = |x: &[f64], gradient: &mut [f64]| {
            gradient[0] = 2.0 * (x[0] - 2.0);
            if x[0] > 1.0 { f64::NAN } else { (x[0] - 2.0) * (x[0] - 2.0) }
        };
        let mut x = vec![0.0];
        let rules = Rules { first: 10.0, clip: 10.0, ..EXACT };
        let found = minimise(&mut function(walled), &mut x, &rules, &never);
        assert!(x[0] <= 1.0 && x[0] > 0.9, "{x:?} {found:?}");
    }
}
