//! Minimisation along one group of unknowns after the other, as in Powell's method.
//!
//! ```text
//! sweep:   for every group b:  d = −g_b,  a step along d
//!          then a step along x − x₀, the sum of the steps of the sweep
//! ```
//!
//! A group has the unknowns of one point. It is the search that papers on parametric snakes use; it takes ten to forty times
//! as many evaluations as [`lbfgs`](super::lbfgs) for the same minimum.

use super::bounded::Stop;
use super::descent::{Minimum, Objective, Point, Rules, Steps, descend, difference, search};

/// Factor on the length of the next step of a group after a step.
const GROWTH: f64 = 2.0;
/// Least length of a step of a group relative to the tolerance: shorter ones are small in every sense.
const LEAST: f64 = 0.1;

/// Minimises `objective` from `x`, which becomes the point of the smallest value found. An iteration is a sweep over the groups
/// of `group` consecutive unknowns.
///
/// At most 20 evaluations per group and 20 more per iteration.
///
/// # Panics
/// If `group` is zero.
pub fn minimise(
    objective: &mut impl Objective,
    x: &mut Vec<f64>,
    group: usize,
    rules: &Rules,
    stop: Stop<'_>,
) -> Minimum {
    let lengths = vec![rules.first; x.len().div_ceil(group)];
    descend(objective, x, rules, stop, &mut Sweeps { group, lengths })
}

/// The groups, with the displacement of the next step of each.
struct Sweeps {
    group: usize,
    lengths: Vec<f64>,
}

impl Sweeps {
    /// A step along the steepest descent of one group.
    fn step(
        &mut self,
        index: usize,
        objective: &mut impl Objective,
        at: &Point,
        rules: &Rules,
        evaluations: &mut usize,
    ) -> Option<Point> {
        let start = index * self.group;
        let mut direction = vec![0.0; at.x.len()];
        let end = (start + self.group).min(direction.len());
        direction[start..end].iter_mut().zip(&at.gradient[start..end]).for_each(|(d, slope)| *d = -slope);
        let largest = objective.displacement(&direction);
        if !(largest > 0.0) {
            return None;
        }
        let length = &mut self.lengths[index];
        direction.iter_mut().for_each(|d| *d *= *length / largest);
        let next = search(objective, at, &direction, rules, evaluations);
        let taken = next.as_ref().map_or(0.0, |next| objective.displacement(&difference(&next.x, &at.x)));
        *length = (GROWTH * taken).clamp(LEAST * rules.tolerance, rules.clip);
        next
    }
}

impl<O: Objective> Steps<O> for Sweeps {
    /// The end of a sweep. `None` if no group has a step.
    fn next(
        &mut self,
        objective: &mut O,
        at: &Point,
        rules: &Rules,
        evaluations: &mut usize,
    ) -> Option<Point> {
        let mut reached: Option<Point> = None;
        for index in 0..self.lengths.len() {
            let from = reached.as_ref().unwrap_or(at);
            reached = self.step(index, objective, from, rules, evaluations).or(reached);
        }
        let reached = reached?;
        let whole = difference(&reached.x, &at.x);
        Some(search(objective, &reached, &whole, rules, evaluations).unwrap_or(reached))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bounded::never;
    use crate::descent::Ending;
    use crate::descent::functions::{EXACT, QUADRATIC, Rosenbrock, Scales};

    #[test]
    fn separable_functions_converge_in_any_grouping() {
        for group in [1, 3, QUADRATIC] {
            let mut x = vec![0.0; QUADRATIC];
            // Near the minimum, values differ by rounding for displacements of `√ε`.
            let rules = Rules { iterations: 20_000, tolerance: 1e-6, ..EXACT };
            let found = minimise(&mut Scales {}, &mut x, group, &rules, &never);
            assert_ne!(found.ending, Ending::Limit, "{} sweeps of {group}", found.iterations);
            Scales::assert_minimum(&x, 1e-3);
        }
    }

    /// The valley is at an angle to both unknowns: progress is slow, and never upwards.
    #[test]
    fn the_valley_of_rosenbrock_is_descended() {
        let mut x = vec![-1.2, 1.0];
        let rules = Rules { iterations: 5000, ..EXACT };
        let found = minimise(&mut Rosenbrock::default(), &mut x, 1, &rules, &never);
        assert!((x[0] - 1.0).abs() < 1e-2, "{x:?} after {} sweeps", found.iterations);
        assert!(found.history.is_sorted_by(|a, b| a >= b));
    }

    #[test]
    fn a_stop_is_obeyed_and_limits_end() {
        let found = minimise(&mut Rosenbrock::default(), &mut vec![-1.2, 1.0], 1, &EXACT, &|| true);
        assert_eq!((found.ending, found.evaluations), (Ending::Stopped, 1));
        let rules = Rules { iterations: 2, ..EXACT };
        let found = minimise(&mut Rosenbrock::default(), &mut vec![-1.2, 1.0], 2, &rules, &never);
        assert_eq!((found.ending, found.iterations), (Ending::Limit, 2));
    }
}
