//! Exponential B-splines `β_α` of a symmetric, real-closed list of poles `α`.
//!
//! ```text
//! L(s) = Π (s − α_n),   Δ(z) = Π (1 − e^{α_n} z⁻¹) = Σ d_k z^{−k},   β⁺ = Σ_k d_k ρ(t − k),   L(D) ρ = δ
//! ```
//!
//! On each interval between knots, `β` solves `L(D)β = 0`; at knot `k` its `(N−1)`-th derivative jumps by `d_k`. The Taylor
//! vector at a left end is continued by the differential equation, shifted to the midpoint and to the right end, and so on
//! from piece to piece; the second half is the mirror image.
//!
//! Source: Schmitter, *Spline Shape Processing*, §6.2 (definitions); the propagation is ours.

use super::piecewise::{Generator, HALF_PIECE, Pieces};
use super::poles::Poles;
use crate::GeometryError;
use shapelex_numeric::double_double::Real;

/// The centred B-spline `β_α`, not normalised: `∫ β_α` is [`Poles::integral`].
///
/// Accuracy: `2·10⁻¹⁵` of the maximum in value, first and second derivative. Cost `O(N n²)`, where `N` is the order and
/// `n ≈ 7–27` the number of terms per piece.
///
/// # Errors
/// [`GeometryError::Pole`] if a pole is outside the admissible domain; [`GeometryError::TooFewPoints`] for an empty
/// list.
pub fn exponential_bspline(poles: &Poles) -> Result<Generator, GeometryError> {
    poles.check()?;
    if poles.order() == 0 {
        return Err(GeometryError::TooFewPoints { found: 0, needed: 1 });
    }
    Ok(pieces::<f64>(poles).into())
}

/// The pieces of `β_α` in the precision `T`, for any non-empty list, even outside the admissible domain.
pub(super) fn pieces<T: Real>(poles: &Poles) -> Pieces<T> {
    let order = poles.order();
    let d = poles.annihilator::<T>();
    let terms = terms_needed(order, poles.radius(), 1e-6 * T::ROUNDING);
    let recursion = TaylorRecursion::new(&poles.characteristic_polynomial::<T>(), terms + 4);

    let jump = T::from(HALF_PIECE.powi(order as i32 - 1)) / T::from(factorial(order - 1));
    let mut coefficients = vec![T::from(0.0); 2 * order * terms];
    let mut state = vec![T::from(0.0); order];
    for p in 0..order {
        if p % 2 == 0 {
            state[order - 1] = state[order - 1] + d[p / 2] * jump;
        }
        let middle = recursion.extend(&recursion.shift(&recursion.extend(&state)));
        state = recursion.shift(&middle);
        let mirrored = 2 * order - 1 - p;
        for m in 0..terms {
            coefficients[p * terms + m] = middle[m];
            coefficients[mirrored * terms + m] = if m % 2 == 0 { middle[m] } else { -middle[m] };
        }
    }
    Pieces { support: order, terms, smoothness: order.saturating_sub(2), coefficients }
}

/// `b_α = β_α / ∫β_α`: a partition of unity if 0 is a pole.
///
/// # Errors
/// As for [`exponential_bspline`].
pub fn normalised_bspline(poles: &Poles) -> Result<Generator, GeometryError> {
    Ok(exponential_bspline(poles)?.scaled(1.0 / poles.integral()))
}

/// Continues scaled derivatives `x[m] = f^(m) H^m / m!`, `m < N`, by `L(D) f = 0`.
struct TaylorRecursion<T> {
    order: usize,
    /// `−a_i H^{N−i} (m+i)!/(m+N)!` at `m·N + i`.
    factors: Vec<T>,
    /// `C(k, m)` at `m·terms + k`.
    binomials: Vec<T>,
    terms: usize,
}

impl<T: Real> TaylorRecursion<T> {
    fn new(characteristic: &[T], terms: usize) -> Self {
        let order = characteristic.len() - 1;
        let mut factors = vec![T::from(0.0); (terms - order) * order];
        for m in 0..terms - order {
            let mut ratio = T::from(1.0);
            for i in (0..order).rev() {
                ratio = ratio * T::from(HALF_PIECE) / T::from((m + i + 1) as f64);
                factors[m * order + i] = -(characteristic[i] * ratio);
            }
        }
        let mut binomials = vec![T::from(0.0); order * terms];
        for m in 0..order {
            let mut binomial = 1.0;
            for k in m..terms {
                if k > m {
                    binomial = (binomial * k as f64 / (k - m) as f64).round();
                }
                binomials[m * terms + k] = T::from(binomial);
            }
        }
        Self { order, factors, binomials, terms }
    }

    /// `c[m+N] = −Σ_{i<N} a_i H^{N−i} c[m+i] (m+i)!/(m+N)!`.
    fn extend(&self, state: &[T]) -> Vec<T> {
        let mut c = Vec::with_capacity(self.terms);
        c.extend_from_slice(state);
        for (m, factors) in self.factors.chunks_exact(self.order).enumerate() {
            let next = factors.iter().zip(&c[m..]).fold(T::from(0.0), |sum, (&f, &x)| sum + f * x);
            c.push(next);
        }
        c
    }

    /// The first `N` scaled derivatives at `s = 1`: `Σ_{k≥m} C(k, m) c[k]`.
    fn shift(&self, c: &[T]) -> Vec<T> {
        let derivative = |(m, binomials): (usize, &[T])| {
            T::accurate_sum(binomials[m..].iter().zip(&c[m..]).map(|(&b, &x)| b * x))
        };
        self.binomials.chunks_exact(self.terms).enumerate().map(derivative).collect()
    }
}

fn factorial(n: usize) -> f64 {
    (1..=n).map(|k| k as f64).product()
}

/// Maximum number of terms: larger factorials overflow. Admissible poles need fewer than 60.
const MAX_TERMS: usize = 170;

/// Number of Taylor terms for a truncation error of `tolerance` in the second derivative.
fn terms_needed(order: usize, radius: f64, tolerance: f64) -> usize {
    let ratio = (radius * HALF_PIECE).max(1e-6);
    let mut terms = order + 1;
    loop {
        let remainder = ratio.powi((terms - order + 1) as i32) * factorial(order - 1) / factorial(terms);
        if remainder * (terms as f64 / HALF_PIECE).powi(2) <= tolerance || terms >= MAX_TERMS {
            return terms + 1;
        }
        terms += 1;
    }
}
