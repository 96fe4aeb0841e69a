//! Real numbers in two precisions, and small dense systems over them.
//!
//! A few constructions need more than `f64`: their intermediate results cancel by a known factor. They are carried out
//! in double-double arithmetic (32 digits) once, and rounded at the end.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// A real number: `f64` or double-double.
pub trait Real:
    Copy
    + From<f64>
    + Into<f64>
    + Neg<Output = Self>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
{
    /// Unit roundoff.
    const ROUNDING: f64;
    /// A sum to full precision, for terms that cancel by few digits.
    fn accurate_sum(terms: impl Iterator<Item = Self>) -> Self;
    /// `cos x` for `|x| ≤ 4`.
    fn cosine(self) -> Self;
    /// `eˣ` for `|x| ≤ 16`.
    fn exponential(self) -> Self;
}

impl Real for f64 {
    const ROUNDING: f64 = f64::EPSILON;

    /// Accumulates the error of every addition (Knuth's two-sum).
    fn accurate_sum(terms: impl Iterator<Item = Self>) -> Self {
        let (sum, lost) = terms.fold((0.0, 0.0), |(sum, lost), term| {
            let (next, error) = two_sum(sum, term);
            (next, lost + error)
        });
        sum + lost
    }

    fn cosine(self) -> Self {
        self.cos()
    }

    fn exponential(self) -> Self {
        self.exp()
    }
}

/// The sum of two doubles, of which the second is at most half an ulp of the first: 32 digits.
///
/// Relative errors are a few `10⁻³²`. Source of the operations: Joldes, Muller, Popescu, *Tight and rigorous error bounds
/// for basic building blocks of double-word arithmetic*, 2017, algorithms 6 and 10; the quotient is by long division.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DoubleDouble {
    high: f64,
    low: f64,
}

// Generic code of other crates calls these operations.

/// `a + b` and its rounding error (Knuth).
#[inline]
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let seen = sum - a;
    (sum, (a - (sum - seen)) + (b - seen))
}

/// `a b` and its rounding error (Dekker). Without a fused instruction in the target, this is faster than requesting one.
#[inline]
fn two_product(a: f64, b: f64) -> (f64, f64) {
    let halves = |x: f64| {
        let shifted = 134_217_729.0 * x; // 2²⁷ + 1
        let high = shifted - (shifted - x);
        (high, x - high)
    };
    let product = a * b;
    let ((ah, al), (bh, bl)) = (halves(a), halves(b));
    (product, ((ah * bh - product) + ah * bl + al * bh) + al * bl)
}

impl DoubleDouble {
    #[inline]
    fn normalised(a: f64, b: f64) -> Self {
        let (high, low) = two_sum(a, b);
        Self { high, low }
    }
}

impl From<f64> for DoubleDouble {
    #[inline]
    fn from(value: f64) -> Self {
        Self { high: value, low: 0.0 }
    }
}

impl From<DoubleDouble> for f64 {
    #[inline]
    fn from(value: DoubleDouble) -> Self {
        value.high
    }
}

impl Neg for DoubleDouble {
    type Output = Self;

    #[inline]
    fn neg(self) -> Self {
        Self { high: -self.high, low: -self.low }
    }
}

impl Add for DoubleDouble {
    type Output = Self;

    #[inline]
    fn add(self, other: Self) -> Self {
        let (high, lost) = two_sum(self.high, other.high);
        let (low, lost_low) = two_sum(self.low, other.low);
        let Self { high, low } = Self::normalised(high, lost + low);
        Self::normalised(high, lost_low + low)
    }
}

impl Sub for DoubleDouble {
    type Output = Self;

    #[inline]
    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for DoubleDouble {
    type Output = Self;

    #[inline]
    fn mul(self, other: Self) -> Self {
        let (product, lost) = two_product(self.high, other.high);
        let cross = self.high * other.low + (self.low * other.high + self.low * other.low);
        Self::normalised(product, lost + cross)
    }
}

impl Div for DoubleDouble {
    type Output = Self;

    fn div(self, other: Self) -> Self {
        let first = self.high / other.high;
        let rest = self - other * Self::from(first);
        let second = rest.high / other.high;
        let third = (rest - other * Self::from(second)).high / other.high;
        Self::normalised(first, second) + Self::from(third)
    }
}

impl Real for DoubleDouble {
    const ROUNDING: f64 = f64::EPSILON * f64::EPSILON;

    /// A plain sum, which suffices because 20 of the 32 digits are needed.
    fn accurate_sum(terms: impl Iterator<Item = Self>) -> Self {
        terms.fold(Self::from(0.0), |sum, term| sum + term)
    }

    fn cosine(self) -> Self {
        const HALVINGS: i32 = 4;
        let y = self / Self::from(2.0_f64.powi(HALVINGS));
        // 13 terms leave 10⁻⁴¹ at |y| ≤ 1/4
        let series = series(-(y * y), 13, |n| (2 * n - 1) * (2 * n));
        (0..HALVINGS).fold(series, |c, _| Self::from(2.0) * c * c - Self::from(1.0))
    }

    fn exponential(self) -> Self {
        const HALVINGS: i32 = 6;
        let y = self / Self::from(2.0_f64.powi(HALVINGS));
        // 22 terms leave 10⁻³⁵ at |y| ≤ 1/4
        (0..HALVINGS).fold(series(y, 22, |n| n), |e, _| e * e)
    }
}

/// `Σ_n Π_{k≤n} x/ratio(k)`, by Horner's rule.
fn series(x: DoubleDouble, terms: usize, ratio: impl Fn(usize) -> usize) -> DoubleDouble {
    let one = DoubleDouble::from(1.0);
    (1..terms).rev().fold(one, |sum, n| one + x / DoubleDouble::from(ratio(n) as f64) * sum)
}

/// Solves `A x = b` by elimination with partial pivoting; `None` if a pivot is rounding relative to the largest entry of its
/// column. `rows` are the rows of `A`, each followed by its entry of `b`.
pub fn solve_small<T: Real>(mut rows: Vec<Vec<T>>) -> Option<Vec<T>> {
    let n = rows.len();
    let size = |value: T| -> f64 { value.into().abs() };
    for column in 0..n {
        let scale = rows.iter().map(|row| size(row[column])).fold(0.0, f64::max);
        let pivot = (column..n).max_by(|&a, &b| size(rows[a][column]).total_cmp(&size(rows[b][column])))?;
        if !(size(rows[pivot][column]) > 1e4 * T::ROUNDING * scale) {
            return None;
        }
        rows.swap(column, pivot);
        for row in column + 1..n {
            let factor = rows[row][column] / rows[column][column];
            for k in column..=n {
                rows[row][k] = rows[row][k] - factor * rows[column][k];
            }
        }
    }
    let mut x = vec![T::from(0.0); n];
    for row in (0..n).rev() {
        let known = (row + 1..n).fold(rows[row][n], |rest, k| rest - rows[row][k] * x[k]);
        x[row] = known / rows[row][row];
    }
    Some(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Fails unless `found` is `high + low` to 30 digits.
    fn check(found: DoubleDouble, high: f64, low: f64) {
        let wanted = DoubleDouble { high, low };
        let error = f64::from(found - wanted) / high;
        assert!(error.abs() < 1e-30, "{found:?} for {wanted:?}: {error:e}");
    }

    /// Reference values of 50 digits, as the nearest double and the remainder.
    #[test]
    #[allow(clippy::excessive_precision)] // the digits as they were computed
    fn operations_keep_their_digits() {
        let one = DoubleDouble::from(1.0);
        let seventh = one / DoubleDouble::from(7.0);
        check(seventh, 1.42857142857142849e-01, 7.93016446160826056e-18);
        check(seventh * seventh, 2.04081632653061208e-02, 1.62851591622312510e-18);
        check(seventh + seventh * seventh, 1.63265306122448967e-01, 1.30281273297850008e-17);
        check(one - seventh * seventh, 9.79591836734693855e-01, 2.26576127474521748e-17);
        check(seventh / (seventh * seventh), 7.0, 0.0);
    }

    #[test]
    fn elementary_functions_keep_their_digits() {
        check(DoubleDouble::from(0.25).cosine(), 0.9689124217106447, 5.071436662403936e-17);
        check(DoubleDouble::from(2.5).cosine(), -0.8011436155469337, -1.8674742705085553e-17);
        check(DoubleDouble::from(3.3).exponential(), 27.112638920657883, -2.243840361146525e-16);
    }

    #[test]
    fn small_systems_are_solved_or_refused() {
        let rows = vec![vec![0.0, 2.0, 1.0, 7.0], vec![1.0, 0.0, -1.0, -2.0], vec![3.0, 1.0, 0.0, 5.0]];
        assert_eq!(solve_small(rows).unwrap(), [1.0, 2.0, 3.0]);
        assert!(solve_small(vec![vec![1.0, 2.0, 1.0], vec![2.0, 4.0, 2.0]]).is_none());
    }
}
