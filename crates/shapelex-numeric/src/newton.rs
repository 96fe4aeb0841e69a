//! Minimisation by damped Newton steps with a bound on their displacement.
//!
//! ```text
//! d = −(H + μ h I)⁻¹ g,   h = mean of the diagonal of H
//! ```
//!
//! `H` is the curvature of the objective or a positive part of it. `μ` is divided by four after a full step and grows tenfold
//! when `H + μ h I` is not definite or no step along `d` is found; then the steepest descent is tried.

use super::bounded::Stop;
use super::dense::{Definite, Matrix};
use super::descent::{Minimum, Objective, Point, Rules, Steps, descend, difference, search, steepest};

/// `μ` of the first step.
const FIRST_DAMPING: f64 = 1e-3;
/// Least `μ`: curvatures are known to no more digits.
const LEAST_DAMPING: f64 = 1e-8;
/// Factor on `μ` after a full step.
const EASING: f64 = 0.25;
/// Factor on `μ` when there is no step.
const STIFFENING: f64 = 10.0;
/// Maximum number of tries of a step: from the first `μ` to a direction that is that of the steepest descent.
const MAX_TRIES: usize = 8;
/// Part of a direction from which a step counts as full.
const FULL: f64 = 0.99;

/// A differentiable function with a curvature.
pub trait Curved: Objective {
    /// The second derivatives at `x`, or a symmetric matrix near them; the lower triangle is read.
    fn curvature(&mut self, x: &[f64]) -> Matrix;
}

/// Minimises `objective` from `x`, which becomes the point of the smallest value found.
///
/// At most 8 factorisations and `9 · 20` evaluations per iteration. Cost without evaluations: `n³/3` per factorisation.
pub fn minimise(objective: &mut impl Curved, x: &mut Vec<f64>, rules: &Rules, stop: Stop<'_>) -> Minimum {
    descend(objective, x, rules, stop, &mut Damped { damping: FIRST_DAMPING })
}

/// The damping `μ` of the next step.
struct Damped {
    damping: f64,
}

impl<O: Curved> Steps<O> for Damped {
    fn next(
        &mut self,
        objective: &mut O,
        at: &Point,
        rules: &Rules,
        evaluations: &mut usize,
    ) -> Option<Point> {
        let curvature = objective.curvature(&at.x);
        let mean = curvature.trace() / at.x.len() as f64;
        for _ in 0..MAX_TRIES {
            if let Some(direction) = solve(&curvature, self.damping * mean, &at.gradient)
                && let Some(next) = search(objective, at, &direction, rules, evaluations)
            {
                let taken = objective.displacement(&difference(&next.x, &at.x));
                if taken >= FULL * objective.displacement(&direction) {
                    self.damping = (EASING * self.damping).max(LEAST_DAMPING);
                }
                return Some(next);
            }
            self.damping *= STIFFENING;
        }
        self.damping = FIRST_DAMPING;
        steepest(objective, at, rules, evaluations)
    }
}

/// `−(H + s I)⁻¹ g`; `None` if the matrix is not positive definite.
fn solve(curvature: &Matrix, shift: f64, gradient: &[f64]) -> Option<Vec<f64>> {
    let n = gradient.len();
    let factor = Definite::new(&(curvature + Matrix::identity(n, n) * shift)).ok()?;
    Some(factor.solve(&Matrix::from_fn(n, 1, |i, _| -gradient[i])).as_slice().to_vec())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bounded::never;
    use crate::descent::Ending;
    use crate::descent::functions::{EXACT, QUADRATIC, Rosenbrock, Scales};

    impl Curved for Rosenbrock {
        fn curvature(&mut self, x: &[f64]) -> Matrix {
            let across = -400.0 * x[0];
            let along = 2.0 - 400.0 * (x[1] - 3.0 * x[0] * x[0]);
            Matrix::from_row_slice(2, 2, &[along, across, across, 200.0])
        }
    }

    impl Curved for Scales {
        fn curvature(&mut self, x: &[f64]) -> Matrix {
            Matrix::from_fn(x.len(), x.len(), |i, j| if i == j { Self::scale(i) } else { 0.0 })
        }
    }

    #[test]
    fn the_valley_of_rosenbrock_is_followed_to_its_end() {
        let mut x = vec![-1.2, 1.0];
        let found = minimise(&mut Rosenbrock::default(), &mut x, &EXACT, &never);
        assert!((x[0] - 1.0).abs() < 1e-7 && (x[1] - 1.0).abs() < 1e-7, "{x:?} {found:?}");
        assert!(found.iterations < 40 && found.history.is_sorted_by(|a, b| a >= b), "{found:?}");
    }

    /// With steps that are not clipped, a quadratic function needs a few steps until the damping is small.
    #[test]
    fn quadratic_functions_converge_in_a_few_steps() {
        let mut x = vec![0.0; QUADRATIC];
        let rules = Rules { clip: 100.0, ..EXACT };
        let found = minimise(&mut Scales {}, &mut x, &rules, &never);
        assert_eq!(found.ending, Ending::Converged, "{found:?}");
        assert!(found.iterations <= 12 && found.evaluations <= 14, "{found:?}");
        Scales::assert_minimum(&x, 1e-6);
    }

    /// Where the curvature is negative, the damping grows until the direction descends.
    #[test]
    fn saddles_are_left() {
        let mut x = vec![0.0, 1.0];
        let found = minimise(&mut Rosenbrock::default(), &mut x, &EXACT, &never);
        assert!((x[0] - 1.0).abs() < 1e-6, "{x:?} {found:?}");
    }
}
