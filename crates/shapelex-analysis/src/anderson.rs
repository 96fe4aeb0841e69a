//! Anderson's acceleration of a fixed-point iteration `x ← F(x)` of many numbers.
//!
//! ```text
//! f_j = F(x_j) − x_j,   γ = argmin ‖f_k − Σ_j γ_j (f_{j+1} − f_j)‖,   x_{k+1} = x_k + f_k − Σ_j γ_j (x_{j+1} − x_j + f_{j+1} − f_j)
//! ```
//!
//! The fixed points are those of `F`. Where steps grow, the memory is emptied, and the next step is a plain one.
//!
//! Source: Walker, Ni, *Anderson acceleration for fixed-point iterations*, SIAM J. Numer. Anal. 2011.

use crate::metric::{dot, norm};
use shapelex_numeric::dense::{Definite, Matrix};

/// Most differences that are kept: more do not help where steps are not linear.
const DEPTH: usize = 5;
/// Growth of steps at which the memory is emptied.
const GROWTH: f64 = 2.0;
/// Longest accelerated step, divided by the plain one: further ones are guesses, as in directions that shrink by less than a twentieth a round.
const LONGEST: f64 = 20.0;
/// Part of the squares of the differences that is added to the diagonal, so that differences which are nearly the same do not cancel.
const RIDGE: f64 = 1e-10;

/// Past iterates and their steps.
#[derive(Debug, Default)]
pub(crate) struct Anderson {
    /// `x_j` and `f_j`, the latest last.
    past: Vec<[Vec<f64>; 2]>,
}

impl Anderson {
    /// The next iterate after `x`, whose plain step is `step`. Cost: products of the last few differences.
    pub(crate) fn next(&mut self, x: &[f64], step: &[f64]) -> Vec<f64> {
        if self.past.last().is_some_and(|[_, last]| norm(step) > GROWTH * norm(last)) {
            self.past.clear();
        }
        self.past.push([x.to_vec(), step.to_vec()]);
        if self.past.len() > DEPTH + 1 {
            self.past.remove(0);
        }
        let added = self.accelerated(step).filter(|found| norm(found) <= LONGEST * norm(step));
        if added.is_none() {
            self.past.drain(..self.past.len() - 1);
        }
        let added = added.unwrap_or_else(|| step.to_vec());
        x.iter().zip(added).map(|(x, by)| x + by).collect()
    }

    /// The accelerated step; `None` if the differences do not determine it.
    fn accelerated(&self, step: &[f64]) -> Option<Vec<f64>> {
        let differences = |which: usize| -> Vec<Vec<f64>> {
            let difference = |pair: &[[Vec<f64>; 2]]| {
                pair[1][which].iter().zip(&pair[0][which]).map(|(new, old)| new - old).collect()
            };
            self.past.windows(2).map(difference).collect()
        };
        let (moves, changes) = (differences(0), differences(1));
        let count = changes.len();
        if count == 0 {
            return Some(step.to_vec());
        }
        let ridge = |i: usize, j: usize| if i == j { 1.0 + RIDGE } else { 1.0 };
        let products = Matrix::from_fn(count, count, |i, j| ridge(i, j) * dot(&changes[i], &changes[j]));
        let right = Matrix::from_fn(count, 1, |i, _| dot(&changes[i], step));
        let weights = Definite::new(&products).ok()?.solve(&right);
        let mut found = step.to_vec();
        for (weight, (by, change)) in weights.iter().zip(moves.iter().zip(&changes)) {
            for (value, (by, change)) in found.iter_mut().zip(by.iter().zip(change)) {
                *value -= weight * (by + change);
            }
        }
        found.iter().all(|value| value.is_finite()).then_some(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rounds(accelerated: bool, map: impl Fn(&[f64]) -> Vec<f64>, start: Vec<f64>) -> (usize, Vec<f64>) {
        let (mut x, mut anderson) = (start, Anderson::default());
        for round in 1..=2000 {
            let step: Vec<f64> = map(&x).iter().zip(&x).map(|(image, x)| image - x).collect();
            if norm(&step) < 1e-10 {
                return (round, x);
            }
            x = match accelerated {
                true => anderson.next(&x, &step),
                false => x.iter().zip(step).map(|(x, by)| x + by).collect(),
            };
        }
        panic!("no convergence");
    }

    /// A linear contraction with slow directions and one that is not linear come to their fixed points, much sooner.
    #[test]
    fn slow_iterations_become_fast() {
        let rates = [0.94, 0.9, 0.5, -0.3];
        let linear =
            |x: &[f64]| x.iter().zip(rates).map(|(x, rate)| rate * (x - 1.0) + 1.0).collect::<Vec<f64>>();
        let cosine = |x: &[f64]| vec![(0.9 * x[0] + 0.3 * x[1]).cos(), 0.9 * x[1] + 0.02 * x[0].sin()];
        let (plain, fixed) = rounds(false, linear, vec![3.0, -2.0, 4.0, 9.0]);
        let (fast, found) = rounds(true, linear, vec![3.0, -2.0, 4.0, 9.0]);
        assert!(plain > 300 && fast < 15, "{plain} {fast}");
        assert!(found.iter().zip(&fixed).all(|(a, b)| (a - b).abs() < 1e-7), "{found:?}");
        let (plain, fixed) = rounds(false, cosine, vec![0.2, 0.9]);
        let (fast, found) = rounds(true, cosine, vec![0.2, 0.9]);
        assert!(fast * 4 < plain, "{plain} {fast}");
        assert!(found.iter().zip(&fixed).all(|(a, b)| (a - b).abs() < 1e-7), "{found:?} {fixed:?}");
    }
}
