//! Interpolators `φ(k) = δ_k` built from exponential B-splines, in two families.
//!
//! ```text
//! integer shifts        φ(t) = λ_N β_{α_N}(t) + Σ_{n=n₀}^{N−1} λ_n [β_{α_n}(t + (N−n)/2) + β_{α_n}(t − (N−n)/2)],
//!                       α_n = α ∪ (0)^{n−n₀}
//! half-integer shifts   φ(t) = λ[0] β_α(t) + Σ_{n=1}^{n₀−2} λ[n] [β_α(t − n/2) + β_α(t + n/2)],   N = 2(n₀ − 1)
//! ```
//!
//! Here `β` is centred and `n₀ = |α| ≥ 3`. Both families are `C^{n₀−2}`, reproduce the null space of `L_α` from samples, and
//! sum to one if and only if `0 ∈ α`. The first has `⌊N/2⌋ − n₀ + 1` free weights, those of the lowest orders; with the
//! default support, its system is square, `N = 2(n₀ − 1)`. The second is refinable and better conditioned.
//!
//! The weights grow with the order and cancel in the sum: up to 870 at `n₀ = 6`. If their system has a large condition
//! number, the construction is carried out in double-double arithmetic and rounded once.
//!
//! Source: Schmitter, *Spline Shape Processing*, §6.2 and §6.3, with the counts of equations corrected.

use super::bspline::pieces;
use super::piecewise::{Generator, Pieces};
use super::poles::Poles;
use crate::GeometryError;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::double_double::{DoubleDouble, Real, solve_small};

/// Minimum number of poles of an interpolator: with fewer it is not `C¹`.
pub const MIN_POLES: usize = 3;

/// Maximum of `|φ(k) − δ_k|` after rounding. The weights of a system without a stable solution leave far more.
const RESIDUAL: f64 = 1e-11;

/// An interpolator with the results of its construction.
#[derive(Debug, Clone)]
pub(super) struct Interpolator {
    /// The generator.
    pub(super) generator: Generator,
    /// `λ_{n₀} … λ_N`, or `λ[0] … λ[n₀ − 2]`.
    pub(super) weights: Vec<f64>,
    /// Condition number (1-norm) of the system for the weights.
    pub(super) condition: f64,
}

/// Number of free weights with `order` poles on a support of `support`; `None` if there are too many equations.
pub fn free_weights(order: usize, support: usize) -> Option<usize> {
    (support / 2 + 1).checked_sub(order)
}

/// The interpolator of integer shifts on `support`, with the given weights of the lowest orders (default: 0).
///
/// # Errors
/// [`GeometryError::Pole`] outside the admissible domain; [`GeometryError::Unsolvable`] with the pole nearest to its
/// border.
pub(super) fn integer_shifts(
    poles: &Poles,
    support: usize,
    given: &[f64],
) -> Result<Interpolator, GeometryError> {
    poles.check()?;
    let found = accurate(solve_integer_shifts::<f64>(poles, support, given), || {
        solve_integer_shifts::<DoubleDouble>(poles, support, given)
    });
    certified(found, poles)
}

/// The interpolator of half-integer shifts.
///
/// # Errors
/// As for [`integer_shifts`].
pub(super) fn half_integer_shifts(poles: &Poles) -> Result<Interpolator, GeometryError> {
    poles.check()?;
    let found = accurate(solve_half_integer_shifts::<f64>(poles), || {
        solve_half_integer_shifts::<DoubleDouble>(poles)
    });
    certified(found, poles)
}

/// Condition number beyond which the weights lose too many digits by cancellation; errors are `2·10⁻¹⁴` below it.
const CANCELLING: f64 = 3e4;

/// The result in double precision, or in double-double precision if the weights cancel.
fn accurate(
    found: Option<Interpolator>,
    wider: impl FnOnce() -> Option<Interpolator>,
) -> Option<Interpolator> {
    found.filter(|found| found.condition <= CANCELLING).or_else(wider)
}

fn certified(found: Option<Interpolator>, poles: &Poles) -> Result<Interpolator, GeometryError> {
    let (re, im) = poles.outermost();
    let residual = |generator: &Generator| {
        let reach = generator.support().div_ceil(2) as isize;
        let at = |k: isize| generator.evaluate(k as f64, 0) - if k == 0 { 1.0 } else { 0.0 };
        (-reach..=reach).map(|k| at(k).abs()).fold(0.0, f64::max)
    };
    match found {
        Some(found) if residual(&found.generator) <= RESIDUAL => Ok(found),
        _ => Err(GeometryError::Unsolvable { re, im }),
    }
}

fn solve_integer_shifts<T: Real>(poles: &Poles, support: usize, given: &[f64]) -> Option<Interpolator> {
    let order = poles.order();
    // Each spline has one more zero than the previous one: it is the moving average.
    let splines: Vec<Pieces<T>> =
        std::iter::successors(Some(pieces(poles)), |spline| Some(spline.smoothed()))
            .take(support + 1 - order)
            .collect();
    // The basis of λ_n: β_N itself; for the others, two shifts by (N − n)/2.
    let shifts = |j: usize| shifted_pair((support - order - j) as isize);
    let value = |j: usize, k: usize| evaluate_shifts(&splines[j], &shifts(j), k);
    let free = free_weights(order, support)?;
    let fixed: Vec<T> = (0..free).map(|j| T::from(given.get(j).copied().unwrap_or(0.0))).collect();
    let rows = system(
        splines.len() - free,
        |k, column| value(free + column, k),
        |k| fixed.iter().enumerate().fold(T::from(0.0), |sum, (j, &weight)| sum + weight * value(j, k)),
    );
    let condition = condition(&rows);
    let weights: Vec<T> = fixed.into_iter().chain(solve_small(rows)?).collect();
    let parts: Vec<(T, isize, &Pieces<T>)> = weights
        .iter()
        .enumerate()
        .flat_map(|(j, &weight)| shifts(j).into_iter().map(move |shift| (j, weight, shift)))
        .map(|(j, weight, shift)| (weight, shift, &splines[j]))
        .collect();
    Some(finish(support, &weights, &parts, condition))
}

fn solve_half_integer_shifts<T: Real>(poles: &Poles) -> Option<Interpolator> {
    let order = poles.order();
    let spline = pieces::<T>(poles);
    let rows = system(
        order - 1,
        |k, column| evaluate_shifts(&spline, &shifted_pair(column as isize), k),
        |_| T::from(0.0),
    );
    let condition = condition(&rows);
    let weights = solve_small(rows)?;
    let parts: Vec<(T, isize, &Pieces<T>)> = weights
        .iter()
        .enumerate()
        .flat_map(|(n, &weight)| shifted_pair(n as isize).into_iter().map(move |shift| (weight, shift)))
        .map(|(weight, shift)| (weight, shift, &spline))
        .collect();
    Some(finish(2 * (order - 1), &weights, &parts, condition))
}

/// Shifts in half-integers: 0 once, others in both directions.
fn shifted_pair(halves: isize) -> Vec<isize> {
    if halves == 0 { vec![0] } else { vec![-halves, halves] }
}

/// `Σ_h β(k − h/2)`.
fn evaluate_shifts<T: Real>(spline: &Pieces<T>, halves: &[isize], k: usize) -> T {
    halves.iter().fold(T::from(0.0), |sum, h| sum + spline.at_half(2 * k as isize - h))
}

/// Rows `k = 0 … size − 1` of `Σ_column A λ = δ_k − known(k)`.
fn system<T: Real>(
    size: usize,
    entry: impl Fn(usize, usize) -> T,
    known: impl Fn(usize) -> T,
) -> Vec<Vec<T>> {
    let wanted = |k: usize| T::from(if k == 0 { 1.0 } else { 0.0 });
    (0..size)
        .map(|k| (0..size).map(|column| entry(k, column)).chain([wanted(k) - known(k)]).collect())
        .collect()
}

/// `‖A‖₁ ‖A⁻¹‖₁`; infinite for a singular matrix.
fn condition<T: Real>(rows: &[Vec<T>]) -> f64 {
    let a = Matrix::from_fn(rows.len(), rows.len(), |i, j| rows[i][j].into());
    let norm = |m: &Matrix| m.column_iter().map(|c| c.iter().map(|v| v.abs()).sum()).fold(0.0, f64::max);
    a.clone().try_inverse().map_or(f64::INFINITY, |inverse| norm(&a) * norm(&inverse))
}

fn finish<T: Real>(
    support: usize,
    weights: &[T],
    parts: &[(T, isize, &Pieces<T>)],
    condition: f64,
) -> Interpolator {
    Interpolator {
        generator: Pieces::combine(support, parts).into(),
        weights: weights.iter().map(|&weight| weight.into()).collect(),
        condition,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `tan x = x` at `ω* = 2x`: the list satisfies the Riesz condition, but no interpolator exists.
    const SINGULAR: f64 = 8.986818915818128;

    #[test]
    fn the_known_singular_lists_have_no_interpolator() {
        let first = Poles::trigonometric(1, SINGULAR);
        let second = Poles::trigonometric(2, SINGULAR);
        let conditions = |poles: &Poles| {
            let square = |family: Option<Interpolator>| family.map_or(f64::INFINITY, |f| f.condition);
            let support = 2 * (poles.order() - 1);
            (
                square(solve_integer_shifts::<f64>(poles, support, &[])),
                square(solve_half_integer_shifts::<f64>(poles)),
            )
        };
        assert!(conditions(&first).0 > 1e13, "{:?}", conditions(&first));
        assert!(conditions(&second).1 > 1e13, "{:?}", conditions(&second));
        // Nearby lists do have one.
        assert!(conditions(&Poles::trigonometric(1, SINGULAR + 0.1)).0 < 1e4);
        for poles in [first, second] {
            let error = integer_shifts(&poles, 2 * (poles.order() - 1), &[]).unwrap_err();
            assert_eq!(error, GeometryError::Pole { re: 0.0, im: SINGULAR });
            assert!(error.to_string().contains("8.98681891"), "{error}");
        }
    }
}
