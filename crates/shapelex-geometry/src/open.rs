//! The basis of an open curve: phantom control points beyond its ends, banded inner products.
//!
//! ```text
//! r(u) = Σ_{k=−K}^{M+K} c[k] φ(M u − k),   u ∈ [0, 1],   K = ⌈N/2⌉ − 1
//! ```
//!
//! A generator that is shifted by half an interval has no influence from `k = M + K`, so that there is one control point less.
//!
//! The `2K` phantoms lie outside `[0, M]`. If they are not given, they follow from the annihilation rule
//! `Σ_i d_i c[k − i] = 0`, which is exact for every function that the generator reproduces.

use super::generator::{Generator, Poles, phantoms};
use shapelex_numeric::NumericError;
use shapelex_numeric::banded::{Band, Banded};
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::operator::SymmetricOperator;

/// `∫₀¹ φ_k^(d) φ_l^(d) du = M^{2d−1} ∫₀^M φ^(d)(t − k) φ^(d)(t − l) dt` for `k, l = −K … M + K`.
///
/// Interior entries are those of an infinite line; rows near the ends integrate part of their generators. Cost `O(M N²)`.
pub fn open_gram(generator: &Generator, intervals: usize, derivative: usize) -> Band {
    let (support, zero) = (generator.support(), generator.pieces_before());
    let [before, after] = generator.beyond();
    let first = before as isize;
    let size = intervals + 1 + before + after;
    let scale = (intervals as f64).powi(2 * derivative as i32 - 1);
    // ∫ of piece p times piece p − 2m, for all p and m ≥ 0
    let product = |p: usize, m: usize| generator.piece_product(derivative, p, derivative, p - 2 * m);
    let table: Vec<Vec<f64>> = (0..2 * support)
        .map(|p| (0..=p.saturating_sub(zero) / 2).map(|m| scale * product(p, m)).collect())
        .collect();
    let mut gram = Band::zeros(size, support - 1);
    for half in 0..2 * intervals {
        for (k, p) in covering(generator, half) {
            // The control point m knots further on has piece p − 2m.
            for (m, value) in table[p].iter().enumerate() {
                let (row, column) = ((k + first) as usize, (k + first) as usize + m);
                gram.add(row, column, *value);
            }
        }
    }
    gram
}

/// Control points `k` with an influence on a half-segment, with the piece of their generator there.
pub(super) fn covering(generator: &Generator, half: usize) -> impl Iterator<Item = (isize, usize)> + use<> {
    let (n, i, q) = (generator.support() as isize, (half / 2) as isize, (half % 2) as isize);
    // z ≤ N + 2(i − k) + q < 2N, where z pieces are before the support
    let first = i - (n - 1 - q).div_euclid(2);
    let last = i + (n + q - generator.pieces_before() as isize).div_euclid(2);
    (first..=last).map(move |k| (k, (n + 2 * (i - k) + q) as usize))
}

/// Conversion of points at the knots `u = k/M` to control points.
#[derive(Debug, Clone)]
pub(super) enum OpenInterpolation {
    /// The control points are the points; phantoms follow by annihilation.
    Annihilation {
        /// `d_0 … d_n`.
        annihilator: Vec<f64>,
        /// `K`.
        phantoms: usize,
    },
    /// Interpolation at the knots, with annihilation at the ends (not-a-knot for B-splines).
    NotAKnot(Box<NotAKnot>),
    /// The mean of two such curves: one condition more at the start, and one more at the end. Shifted generators have an odd number of
    /// conditions; the mean does not depend on the direction.
    EitherEnd(Box<[NotAKnot; 2]>),
}

impl OpenInterpolation {
    /// Prepares interpolation for a generator of `poles` with `intervals ≥ |α| − 1`.
    ///
    /// # Errors
    /// [`NumericError::NotPositiveDefinite`] if the system is singular to working precision.
    pub(super) fn new(
        generator: &Generator,
        poles: &Poles,
        intervals: usize,
        interpolating: bool,
    ) -> Result<Self, NumericError> {
        let annihilator = poles.annihilator();
        let phantoms = phantoms(generator.support());
        if interpolating {
            return Ok(Self::Annihilation { annihilator, phantoms });
        }
        let system = |windows| NotAKnot::new(generator, &annihilator, intervals, windows);
        if generator.is_shifted() {
            let [more, less] = generator.beyond();
            return Ok(Self::EitherEnd(Box::new([system([more, less])?, system([less, more])?])));
        }
        Ok(Self::NotAKnot(Box::new(system([phantoms; 2])?)))
    }

    /// All control points of the curve through `M + 1` points.
    pub(super) fn interpolate(&self, points: &Matrix) -> Matrix {
        match self {
            Self::Annihilation { annihilator, phantoms } => extend(points, annihilator, *phantoms),
            Self::NotAKnot(system) => system.solve(points),
            Self::EitherEnd(systems) => (systems[0].solve(points) + systems[1].solve(points)) * 0.5,
        }
    }
}

/// Adds `phantoms` rows before and after `points`: `Σ_{i=0}^{n} d_i c[k − i] = 0` for every window that contains one.
fn extend(points: &Matrix, d: &[f64], phantoms: usize) -> Matrix {
    let (rows, dimension) = points.shape();
    let order = d.len() - 1;
    let mut c = Matrix::zeros(rows + 2 * phantoms, dimension);
    c.rows_mut(phantoms, rows).copy_from(points);
    for column in 0..dimension {
        for k in (0..phantoms).rev() {
            let inner: f64 = (0..order).map(|i| d[i] * c[(k + order - i, column)]).sum();
            c[(k, column)] = -inner / d[order];
        }
        for k in phantoms + rows..rows + 2 * phantoms {
            let inner: f64 = (1..=order).map(|i| d[i] * c[(k - i, column)]).sum();
            c[(k, column)] = -inner / d[0];
        }
    }
    c
}

/// The square banded system `S c = (0, p, 0)`: annihilation windows at both ends, samples at the knots in between.
#[derive(Debug, Clone)]
pub(super) struct NotAKnot {
    /// First column and entries of each row.
    rows: Vec<(usize, Vec<f64>)>,
    /// Number of windows at the start.
    windows: usize,
    normal: Banded,
}

/// Rounds of iterative refinement: the normal equations square the condition number (up to 10⁴), one round restores it.
const REFINEMENTS: usize = 2;

impl NotAKnot {
    fn new(
        generator: &Generator,
        annihilator: &[f64],
        intervals: usize,
        [start, end]: [usize; 2],
    ) -> Result<Self, NumericError> {
        let [before, after] = generator.beyond();
        let size = intervals + 1 + before + after;
        let largest = annihilator.iter().fold(0.0, |m: f64, d| m.max(d.abs()));
        let window: Vec<f64> = annihilator.iter().rev().map(|d| d / largest).collect();
        let samples: Vec<f64> =
            (0..=before + after).map(|k| generator.evaluate(before as f64 - k as f64, 0)).collect();
        let mut rows: Vec<(usize, Vec<f64>)> = (0..start).map(|first| (first, window.clone())).collect();
        rows.extend((0..=intervals).map(|k| (k, samples.clone())));
        let last = size + 1 - window.len();
        rows.extend((last - end..last).map(|first| (first, window.clone())));
        let width = window.len().max(samples.len()) - 1;
        let mut normal = Band::zeros(size, width);
        for (first, entries) in &rows {
            for (i, a) in entries.iter().enumerate() {
                for (j, b) in entries.iter().enumerate().skip(i) {
                    normal.add(first + i, first + j, a * b);
                }
            }
        }
        Ok(Self { rows, windows: start, normal: Banded::new(normal)? })
    }

    fn solve(&self, points: &Matrix) -> Matrix {
        let size = self.rows.len();
        let mut control_points = Matrix::zeros(size, points.ncols());
        for (column, mut c) in points.column_iter().zip(control_points.column_iter_mut()) {
            for _ in 0..=REFINEMENTS {
                let mut step = vec![0.0; size];
                for (row, (first, entries)) in self.rows.iter().enumerate() {
                    let value: f64 = entries.iter().enumerate().map(|(i, a)| a * c[first + i]).sum();
                    let wanted = row.checked_sub(self.windows).and_then(|k| column.get(k)).unwrap_or(&0.0);
                    entries.iter().enumerate().for_each(|(i, a)| step[first + i] += a * (wanted - value));
                }
                self.normal.solve(&mut step);
                c.iter_mut().zip(&step).for_each(|(c, s)| *c += s);
            }
        }
        control_points
    }
}
