//! Loops over short contiguous slices, for which a library call costs more than the work.
//!
//! Sums run in a fixed number of lanes: the compiler vectorises them, and their order never changes.

use super::dense::Matrix;

/// Number of partial sums of a dot product: enough to hide the latency of additions on vectors of two to eight numbers.
const LANES: usize = 8;

/// Dot product, `Σ aᵢ bᵢ`.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a_lanes, b_lanes) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let tail = a_lanes.remainder().iter().zip(b_lanes.remainder()).map(|(x, y)| x * y).sum::<f64>();
    let mut sums = [0.0; LANES];
    for (x, y) in a_lanes.zip(b_lanes) {
        for (sum, (x, y)) in sums.iter_mut().zip(x.iter().zip(y)) {
            *sum += x * y;
        }
    }
    sums.iter().sum::<f64>() + tail
}

/// `maxᵢ aᵢ`, but at least zero.
pub fn largest(a: &[f64]) -> f64 {
    let (lanes, tail) = a.as_chunks::<LANES>();
    let larger = |most: f64, value: f64| if value > most { value } else { most };
    let mut most = [0.0; LANES];
    for values in lanes {
        for (most, value) in most.iter_mut().zip(values) {
            *most = larger(*most, *value);
        }
    }
    most.iter().chain(tail).fold(0.0, |most, value| larger(most, *value))
}

/// `out ← out + factor x`.
pub fn add_scaled(out: &mut [f64], factor: f64, x: &[f64]) {
    out.iter_mut().zip(x).for_each(|(out, x)| *out += factor * x);
}

/// `out ← out + Σᵢ factorsᵢ M_{:,columnsᵢ}`, with four columns per pass over `out`; `matrix` holds `M` column by column.
pub fn add_columns(out: &mut [f64], matrix: &[f64], columns: &[usize], factors: &[f64]) {
    let rows = out.len();
    let column = |index: usize| &matrix[index * rows..(index + 1) * rows];
    let (fours, four_factors) = (columns.chunks_exact(4), factors.chunks_exact(4));
    let rest = fours.remainder().iter().zip(four_factors.remainder());
    for (four, factors) in fours.zip(four_factors) {
        let [p, q, r, s] = [0, 1, 2, 3].map(|i| column(four[i]));
        let [a, b, c, d] = [0, 1, 2, 3].map(|i| factors[i]);
        for ((((out, p), q), r), s) in out.iter_mut().zip(p).zip(q).zip(r).zip(s) {
            *out += (a * p + b * q) + (c * r + d * s);
        }
    }
    for (&index, &factor) in rest {
        add_scaled(out, factor, column(index));
    }
}

/// The entries of a column.
pub fn column(matrix: &Matrix, index: usize) -> &[f64] {
    let rows = matrix.nrows();
    &matrix.as_slice()[index * rows..(index + 1) * rows]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lanes_and_tails_make_the_whole_sum() {
        let matrix = Matrix::from_fn(19, 7, |i, j| (i * 5 + j * 3) as f64);
        let (a, b) = (column(&matrix, 2), column(&matrix, 5));
        assert_eq!(dot(a, b), a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>());
        assert_eq!((largest(a), largest(&a[..11]), largest(&[-1.0])), (96.0, 56.0, 0.0));
        let (columns, factors) = ([6, 0, 1, 4, 2], [1.0, -2.0, 3.0, 0.5, -1.0]);
        let mut out = vec![1.0; 19];
        add_columns(&mut out, matrix.as_slice(), &columns, &factors);
        for (i, value) in out.iter().enumerate() {
            let wanted: f64 = columns.iter().zip(&factors).map(|(&j, f)| f * matrix[(i, j)]).sum();
            assert_eq!(*value, 1.0 + wanted);
        }
    }
}
