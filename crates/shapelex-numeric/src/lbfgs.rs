//! Minimisation by L-BFGS with a bound on the displacement of a step.
//!
//! ```text
//! d = −H g,   H from the last m pairs (s, y) by two loops,   H₀ = sᵀy/yᵀy
//! ```
//!
//! A pair is kept if `sᵀy > 10⁻¹⁰ |s| |y|`. If no step along `d` is found, the pairs are dropped and the steepest descent is
//! tried once.

use std::collections::VecDeque;

use super::bounded::Stop;
pub use super::descent::{Ending, Minimum, Objective, Rules};
use super::descent::{Point, Steps, descend, difference, search, steepest};
use super::kernels::{add_scaled, dot};

/// A pair whose cosine is smaller carries rounding rather than curvature.
const LEAST_CURVATURE: f64 = 1e-10;

/// Minimises `objective` from `x`, which becomes the point of the smallest value found.
///
/// At most `20` evaluations per iteration and as many for a restart. Cost without them: `4 m n` per iteration.
pub fn minimise(objective: &mut impl Objective, x: &mut Vec<f64>, rules: &Rules, stop: Stop<'_>) -> Minimum {
    descend(objective, x, rules, stop, &mut Pairs { kept: VecDeque::new(), most: rules.memory })
}

impl<O: Objective> Steps<O> for Pairs {
    /// Along the quasi-Newton direction, or else, without pairs, along the steepest descent.
    fn next(
        &mut self,
        objective: &mut O,
        at: &Point,
        rules: &Rules,
        evaluations: &mut usize,
    ) -> Option<Point> {
        let mut next = None;
        if !self.kept.is_empty() {
            next = search(objective, at, &self.direction(&at.gradient), rules, evaluations);
        }
        if next.is_none() {
            self.kept.clear();
            next = steepest(objective, at, rules, evaluations);
        }
        let next = next?;
        self.push(difference(&next.x, &at.x), difference(&next.gradient, &at.gradient));
        Some(next)
    }
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
            add_scaled(&mut direction, -share, &pair.change);
            shares.push(share);
        }
        if let Some(last) = self.kept.back() {
            let scale = 1.0 / (last.weight * dot(&last.change, &last.change));
            direction.iter_mut().for_each(|d| *d *= scale);
        }
        for (pair, share) in self.kept.iter().zip(shares.into_iter().rev()) {
            let correction = share - pair.weight * dot(&pair.change, &direction);
            add_scaled(&mut direction, correction, &pair.step);
        }
        direction
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bounded::never;
    use crate::descent::functions::{EXACT, QUADRATIC, Rosenbrock, Scales};

    struct Function<F>(F);

    impl<F: FnMut(&[f64], &mut [f64]) -> f64> Objective for Function<F> {
        fn evaluate(&mut self, x: &[f64], gradient: &mut [f64]) -> f64 {
            (self.0)(x, gradient)
        }

        fn displacement(&self, direction: &[f64]) -> f64 {
            direction.iter().fold(0.0, |most, d| d.abs().max(most))
        }
    }

    #[test]
    fn the_valley_of_rosenbrock_is_followed_to_its_end() {
        let mut objective = Rosenbrock::default();
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
        let mut x = vec![0.0; QUADRATIC];
        let found = minimise(&mut Scales {}, &mut x, &EXACT, &never);
        assert_eq!(found.ending, Ending::Converged, "{found:?}");
        Scales::assert_minimum(&x, 1e-4);
    }

    #[test]
    fn endings_are_told_apart() {
        let start = || vec![-1.2, 1.0];
        let rules = Rules { iterations: 3, ..EXACT };
        let found = minimise(&mut Rosenbrock::default(), &mut start(), &rules, &never);
        assert_eq!((found.ending, found.iterations), (Ending::Limit, 3));
        // A gradient of the wrong sign: no direction helps.
        let uphill = |x: &[f64], gradient: &mut [f64]| {
            let value = Rosenbrock::default().evaluate(x, gradient);
            gradient.iter_mut().for_each(|slope| *slope = -*slope);
            value
        };
        let mut x = start();
        let found = minimise(&mut Function(uphill), &mut x, &EXACT, &never);
        assert_eq!((found.ending, found.iterations, x), (Ending::LineSearch, 0, start()));
        let found = minimise(&mut Rosenbrock::default(), &mut start(), &EXACT, &|| true);
        assert_eq!((found.ending, found.evaluations), (Ending::Stopped, 1));
        let found = minimise(&mut Rosenbrock::default(), &mut vec![1.0, 1.0], &EXACT, &never);
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
        let found = minimise(&mut Function(walled), &mut x, &rules, &never);
        assert!(x[0] <= 1.0 && x[0] > 0.9, "{x:?} {found:?}");
    }
}
