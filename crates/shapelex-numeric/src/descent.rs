//! Descent with bounded steps: the common part of the methods of minimisation.
//!
//! ```text
//! E(x + t d) ≤ E(x) + 10⁻⁴ t gᵀd,   t ≤ clip / displacement(d)
//! ```
//!
//! A method gives a direction `d`, and this module searches along it by quadratic interpolation: [`lbfgs`](super::lbfgs),
//! [`newton`](super::newton), [`coordinates`](super::coordinates). With noise in the objective, the end by
//! [`Ending::LineSearch`] after progress is normal.

use super::bounded::Stop;
use super::kernels::dot;

/// Decrease that a step must achieve, as a fraction of that predicted by the gradient.
const ARMIJO: f64 = 1e-4;
/// Range of a shortened step relative to the previous one.
const SHORTENING: [f64; 2] = [0.1, 0.5];
/// Maximum number of trials of a line search.
const MAX_TRIALS: usize = 20;
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
    /// Number of pairs that L-BFGS keeps, `m`.
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

/// A method of minimisation: how to get from a point to the next.
pub(crate) trait Steps<O: Objective> {
    /// The next point, of a smaller value. `None` if none is found.
    fn next(
        &mut self,
        objective: &mut O,
        at: &Point,
        rules: &Rules,
        evaluations: &mut usize,
    ) -> Option<Point>;
}

/// Minimises `objective` from `x`, which becomes the point of the smallest value found.
pub(crate) fn descend<O: Objective>(
    objective: &mut O,
    x: &mut Vec<f64>,
    rules: &Rules,
    stop: Stop<'_>,
    steps: &mut impl Steps<O>,
) -> Minimum {
    let mut gradient = vec![0.0; x.len()];
    let value = objective.evaluate(x, &mut gradient);
    let mut at = Point { x: std::mem::take(x), gradient, value };
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
        let Some(next) = steps.next(objective, &at, rules, &mut report.evaluations) else {
            report.ending = Ending::LineSearch;
            break;
        };
        let displacement = objective.displacement(&difference(&next.x, &at.x));
        let change = (next.value - at.value).abs();
        let is_small = displacement < rules.tolerance && change < rules.relative * next.value.abs();
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
#[derive(Debug, Clone)]
pub(crate) struct Point {
    pub(crate) x: Vec<f64>,
    pub(crate) gradient: Vec<f64>,
    pub(crate) value: f64,
}

/// The next point along the steepest descent, at most `rules.first` away.
pub(crate) fn steepest(
    objective: &mut impl Objective,
    at: &Point,
    rules: &Rules,
    evaluations: &mut usize,
) -> Option<Point> {
    let largest = objective.displacement(&at.gradient);
    if !(largest > 0.0) {
        return None;
    }
    let direction: Vec<f64> = at.gradient.iter().map(|slope| -slope * (rules.first / largest)).collect();
    search(objective, at, &direction, rules, evaluations)
}

/// Line search by quadratic interpolation. `None` if no trial decreases the value enough.
pub(crate) fn search(
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

pub(crate) fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

/// Functions that every method is tested with.
#[cfg(test)]
pub(crate) mod functions {
    use super::{Objective, Rules};

    /// Rules for a minimum to many digits.
    pub(crate) const EXACT: Rules =
        Rules { memory: 10, iterations: 500, first: 0.1, clip: 0.5, tolerance: 1e-9, relative: 1e-9 };
    /// Number of unknowns of [`Scales`].
    pub(crate) const QUADRATIC: usize = 40;

    fn largest(direction: &[f64]) -> f64 {
        direction.iter().fold(0.0, |most, d| d.abs().max(most))
    }

    /// The valley `(1 − x)² + 100 (y − x²)²`; remembers the largest step between two evaluations.
    #[derive(Default)]
    pub(crate) struct Rosenbrock {
        last: Vec<f64>,
        pub(crate) longest: f64,
    }

    impl Objective for Rosenbrock {
        fn evaluate(&mut self, x: &[f64], gradient: &mut [f64]) -> f64 {
            if !self.last.is_empty() {
                self.longest = self.longest.max(largest(&super::difference(x, &self.last)));
            }
            self.last = x.to_vec();
            let (a, b) = (1.0 - x[0], x[1] - x[0] * x[0]);
            gradient.copy_from_slice(&[-2.0 * a - 400.0 * x[0] * b, 200.0 * b]);
            a * a + 100.0 * b * b
        }

        fn displacement(&self, direction: &[f64]) -> f64 {
            largest(direction)
        }
    }

    /// `1 + Σ s_i (x_i − i/10)²/2` with scales `s_i = 1 + i²`.
    pub(crate) struct Scales {}

    impl Scales {
        pub(crate) fn scale(i: usize) -> f64 {
            1.0 + (i * i) as f64
        }

        pub(crate) fn assert_minimum(x: &[f64], tolerance: f64) {
            for (i, x) in x.iter().enumerate() {
                assert!((x - i as f64 / 10.0).abs() < tolerance, "{x} for {}", i as f64 / 10.0);
            }
        }
    }

    impl Objective for Scales {
        fn evaluate(&mut self, x: &[f64], gradient: &mut [f64]) -> f64 {
            let mut value = 1.0;
            for (i, (x, slope)) in x.iter().zip(gradient).enumerate() {
                let off = x - i as f64 / 10.0;
                *slope = Self::scale(i) * off;
                value += 0.5 * Self::scale(i) * off * off;
            }
            value
        }

        fn displacement(&self, direction: &[f64]) -> f64 {
            largest(direction)
        }
    }
}
