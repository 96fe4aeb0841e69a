//! The polynomials of a curve in columns: the same coefficient of several half-segments is contiguous, so that whatever is done
//! with every half-segment is done with [`LANES`] of them at once.
//!
//! ```text
//! p_h[m] = Σ_k c[k] C_{N+2(i−k)+q}[m],   h = 2i + q        for the segments i = 8g … 8g + 7 of a group g
//! ```

use super::curve::{Curve, unit_of};
use super::generator::Generator;
use super::open::covering;
use shapelex_numeric::lanes::vectorised;

/// Segments of a group.
pub(crate) const LANES: usize = 8;

/// One number for every segment of a group.
pub(crate) type Lanes = [f64; LANES];

/// The coefficients of a curve, group by group.
#[derive(Debug)]
pub(crate) struct Columns {
    segments: usize,
    closed: bool,
    dimension: usize,
    terms: usize,
    /// `[group][half of the segment][coordinate][term]`. Lanes beyond the last segment have no meaning.
    coefficients: Vec<Lanes>,
}

impl Columns {
    /// The curve with these control points (`dimension · N` coordinate-major numbers), divided by a power of two that brings
    /// coordinates near 1, and this power: see [`Curve::unit`]. Cost `O(M d N n)`, as of [`Curve::closed`].
    pub(crate) fn near_one(
        generator: &Generator,
        closed: bool,
        dimension: usize,
        control_points: &[f64],
    ) -> (Self, f64) {
        let count = control_points.len() / dimension;
        let unit = unit_of(control_points.chunks_exact(count));
        let line = Extended::new(generator, closed, count);
        let segments = line.segments;
        let terms = generator.terms();
        let groups = segments.div_ceil(LANES);
        let mut coefficients = vec![[0.0; LANES]; groups * 2 * dimension * terms];
        let pieces = [0, 1].map(|half| line.pieces(generator, half));
        for (c, coordinate) in control_points.chunks_exact(count).enumerate() {
            let extended = line.of(coordinate, unit.recip());
            let columns = coefficients.chunks_exact_mut(terms).skip(c).step_by(dimension);
            vectorised(
                #[inline(always)]
                || fill(columns, &pieces, &extended),
            );
        }
        (Self { segments, closed, dimension, terms, coefficients }, unit)
    }

    /// The polynomials of `curve`.
    pub(crate) fn of(curve: &Curve) -> Self {
        let (segments, dimension) = (curve.segments(), curve.dimension());
        let terms = curve.polynomial(0, 0).len();
        let mut coefficients = vec![[0.0; LANES]; segments.div_ceil(LANES) * 2 * dimension * terms];
        for half in 0..curve.halves() {
            let (block, lane) = place(half);
            for c in 0..dimension {
                let first = (block * dimension + c) * terms;
                let columns = &mut coefficients[first..first + terms];
                for (column, value) in columns.iter_mut().zip(curve.polynomial(half, c)) {
                    column[lane] = *value;
                }
            }
        }
        Self { segments, closed: curve.is_closed(), dimension, terms, coefficients }
    }

    /// Dimension of the points.
    pub(crate) fn dimension(&self) -> usize {
        self.dimension
    }

    /// Whether the curve is closed.
    pub(crate) fn is_closed(&self) -> bool {
        self.closed
    }

    /// Number of half-segments.
    pub(crate) fn halves(&self) -> usize {
        2 * self.segments
    }

    /// Number of coefficients of a polynomial.
    pub(crate) fn terms(&self) -> usize {
        self.terms
    }

    /// The coefficients of every block, coordinate by coordinate; a block is the first or the second halves of the segments of a
    /// group.
    pub(crate) fn blocks(&self) -> std::slice::ChunksExact<'_, Lanes> {
        self.coefficients.chunks_exact(self.dimension * self.terms)
    }

    /// Coefficients of one coordinate on a half-segment.
    pub(crate) fn taylor(
        &self,
        half: usize,
        coordinate: usize,
    ) -> impl DoubleEndedIterator<Item = f64> + ExactSizeIterator {
        let (block, lane) = place(half);
        let first = (block * self.dimension + coordinate) * self.terms;
        self.coefficients[first..first + self.terms].iter().map(move |column| column[lane])
    }
}

/// Block and lane of a half-segment.
pub(crate) fn place(half: usize) -> (usize, usize) {
    let segment = half / 2;
    (2 * (segment / LANES) + half % 2, segment % LANES)
}

/// Control points of a line with those before its first and after its last segment.
struct Extended {
    segments: usize,
    count: usize,
    closed: bool,
    /// Number of control points before that of segment 0.
    before: usize,
    len: usize,
}

impl Extended {
    fn new(generator: &Generator, closed: bool, count: usize) -> Self {
        let [first, after] = generator.beyond();
        let (segments, before) =
            if closed { (count, generator.support() / 2) } else { (count - 1 - first - after, first) };
        // Up to the end of the last group, and as far beyond as the support reaches.
        let len = segments.next_multiple_of(LANES) + generator.support() + 1;
        Self { segments, count, closed, before, len }
    }

    /// The control points near the first or the second half of segment 0.
    fn pieces<'a>(&self, generator: &'a Generator, half: usize) -> Vec<Piece<'a>> {
        let near = covering(generator, half);
        near.map(|(k, p)| ((k + self.before as isize) as usize, generator.piece(p))).collect()
    }

    /// One coordinate times `factor`; zeros beyond the reach of the last segment.
    fn of(&self, coordinate: &[f64], factor: f64) -> Vec<f64> {
        let mut extended = vec![0.0; self.len];
        if self.closed {
            let mut k = (self.count - self.before % self.count) % self.count;
            let reached = self.len.min(self.segments + 2 * self.before + 2);
            for value in &mut extended[..reached] {
                *value = factor * coordinate[k];
                k = if k + 1 == self.count { 0 } else { k + 1 };
            }
        } else {
            extended.iter_mut().zip(coordinate).for_each(|(value, given)| *value = factor * given);
        }
        extended
    }
}

/// A control point near a segment, counted from the first one of the extended line, and its piece of the generator.
type Piece<'a> = (usize, &'a [f64]);

/// Writes the polynomials of one coordinate to its `columns`, block by block, from the `pieces` of both halves of a segment.
#[inline(always)]
fn fill<'a>(columns: impl Iterator<Item = &'a mut [Lanes]>, pieces: &[Vec<Piece<'_>>; 2], extended: &[f64]) {
    for (block, columns) in columns.enumerate() {
        let first = block / 2 * LANES;
        for (term, column) in columns.iter_mut().enumerate() {
            let mut sum = [0.0; LANES];
            for (shift, piece) in &pieces[block % 2] {
                let points = extended[first + shift..].first_chunk::<LANES>();
                let (points, weight) = (points.expect("the line reaches beyond the last group"), piece[term]);
                for lane in 0..LANES {
                    sum[lane] += points[lane] * weight;
                }
            }
            *column = sum;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::GeneratorKind;
    use shapelex_numeric::dense::Matrix;

    /// Fewer control points than the support, and groups that are full or not.
    #[test]
    fn columns_have_the_bits_of_the_curve() {
        for kind in GeneratorKind::catalogue() {
            for (count, closed) in (3..20).flat_map(|count| [(count, true), (count, false)]) {
                let built = kind.build(count).unwrap();
                let generator = &built.generator;
                let [before, after] = generator.beyond();
                let rows = if closed { count } else { count + 1 + before + after };
                let points = Matrix::from_fn(rows, 2, |k, c| (7.0 * (3 * k + c) as f64).sin() * 1e5);
                let curve = if closed { Curve::closed } else { Curve::open }(generator, &points);
                let (columns, unit) = Columns::near_one(generator, closed, 2, points.as_slice());
                assert!((5e4..5e5).contains(&unit), "{unit}");
                assert_eq!((columns.halves(), columns.is_closed()), (2 * count, closed));
                let scaled = curve.scaled(unit.recip());
                let copied = Columns::of(&scaled);
                for (half, c) in (0..2 * count).flat_map(|half| [(half, 0), (half, 1)]) {
                    let expected = scaled.polynomial(half, c);
                    for columns in [&columns, &copied] {
                        let found: Vec<f64> = columns.taylor(half, c).collect();
                        assert_eq!(found, expected, "{kind:?}, {count}, closed: {closed}, half {half}");
                    }
                }
            }
        }
    }
}
