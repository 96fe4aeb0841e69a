//! Loops over short contiguous slices, for which a library call costs more than the work.
//!
//! Sums run in a fixed number of lanes: the compiler vectorises them, and their order never changes. Long slices use the
//! widest vectors of the machine. Products and sums are not fused, so that the bits are the same on all machines.

use realfft::num_complex::Complex64;

use super::dense::Matrix;
use super::lanes::vectorised;

/// Number of partial sums of a dot product: enough to hide the latency of additions on vectors of two to eight numbers.
const LANES: usize = 16;

/// Length from which the widest vectors pay for the call that selects them.
const LONG: usize = 48;

/// Runs a loop over slices of `length` numbers; `work` must be `#[inline(always)]`.
#[inline(always)]
fn widest<R>(length: usize, work: impl FnOnce() -> R) -> R {
    if length < LONG { work() } else { vectorised(work) }
}

/// Dot product, `Σ aᵢ bᵢ`.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    widest(
        a.len(),
        #[inline(always)]
        || {
            let ((a, a_tail), (b, b_tail)) = (a.as_chunks::<LANES>(), b.as_chunks::<LANES>());
            let tail = a_tail.iter().zip(b_tail).map(|(x, y)| x * y).sum::<f64>();
            let mut sums = [0.0; LANES];
            for (x, y) in a.iter().zip(b) {
                for k in 0..LANES {
                    sums[k] += x[k] * y[k];
                }
            }
            sums.iter().sum::<f64>() + tail
        },
    )
}

/// Number of partial sums of [`dot_single`].
pub const SINGLE_LANES: usize = 32;

/// Dot product in single precision.
pub fn dot_single(a: &[f32], b: &[f32]) -> f32 {
    widest(
        a.len(),
        #[inline(always)]
        || {
            let ((a, a_tail), (b, b_tail)) = (a.as_chunks::<SINGLE_LANES>(), b.as_chunks::<SINGLE_LANES>());
            let tail = a_tail.iter().zip(b_tail).map(|(x, y)| x * y).sum::<f32>();
            let mut sums = [0.0; SINGLE_LANES];
            for (x, y) in a.iter().zip(b) {
                for k in 0..SINGLE_LANES {
                    sums[k] += x[k] * y[k];
                }
            }
            sums.iter().sum::<f32>() + tail
        },
    )
}

/// `maxᵢ aᵢ`; `−∞` of an empty slice.
pub fn largest(a: &[f64]) -> f64 {
    widest(
        a.len(),
        #[inline(always)]
        || {
            let (lanes, tail) = a.as_chunks::<LANES>();
            let larger = |most: f64, value: f64| if value > most { value } else { most };
            let mut most = [f64::NEG_INFINITY; LANES];
            for values in lanes {
                for k in 0..LANES {
                    most[k] = larger(most[k], values[k]);
                }
            }
            most.iter().chain(tail).fold(f64::NEG_INFINITY, |most, value| larger(most, *value))
        },
    )
}

/// `maxᵢ |aᵢ|`; zero of an empty slice.
pub fn largest_magnitude(a: &[f64]) -> f64 {
    widest(
        a.len(),
        #[inline(always)]
        || {
            let (lanes, tail) = a.as_chunks::<LANES>();
            let larger = |most: f64, value: f64| if value.abs() > most { value.abs() } else { most };
            let mut most = [0.0; LANES];
            for values in lanes {
                for k in 0..LANES {
                    most[k] = larger(most[k], values[k]);
                }
            }
            most.iter().chain(tail).fold(0.0, |most, value| larger(most, *value))
        },
    )
}

/// `Σ |aᵢ|`.
pub fn sum_of_magnitudes(a: &[f64]) -> f64 {
    widest(
        a.len(),
        #[inline(always)]
        || {
            let (lanes, tail) = a.as_chunks::<LANES>();
            let mut sums = [0.0; LANES];
            for values in lanes {
                for k in 0..LANES {
                    sums[k] += values[k].abs();
                }
            }
            sums.iter().sum::<f64>() + tail.iter().map(|value| value.abs()).sum::<f64>()
        },
    )
}

/// `outᵢ ← conj(aᵢ) bᵢ`.
pub fn multiply_conjugates(out: &mut [Complex64], a: &[Complex64], b: &[Complex64]) {
    widest(
        out.len(),
        #[inline(always)]
        || {
            for (out, (a, b)) in out.iter_mut().zip(a.iter().zip(b)) {
                *out = Complex64::new(a.re * b.re + a.im * b.im, a.re * b.im - a.im * b.re);
            }
        },
    );
}

/// `outᵢ ← aₖ bᵢ` with `k = −i` modulo the length: the spectrum of the products of `conj(z)` with shifts of `w`, from the
/// spectra of `z*` and `w`.
pub fn multiply_mirrored(out: &mut [Complex64], a: &[Complex64], b: &[Complex64]) {
    let (Some(first), Some(after)) = (a.first(), a.get(1..)) else { return };
    widest(
        out.len(),
        #[inline(always)]
        || {
            let mirrored = std::iter::once(first).chain(after.iter().rev());
            for (out, (a, b)) in out.iter_mut().zip(mirrored.zip(b)) {
                *out = Complex64::new(a.re * b.re - a.im * b.im, a.re * b.im + a.im * b.re);
            }
        },
    );
}

/// `outᵢ ← |zᵢ|²`.
pub fn squared_norms(out: &mut [f64], z: &[Complex64]) {
    widest(
        out.len(),
        #[inline(always)]
        || out.iter_mut().zip(z).for_each(|(out, z)| *out = z.re * z.re + z.im * z.im),
    );
}

/// `outᵢ ← outᵢ + |zᵢ|²`.
pub fn add_squared_norms(out: &mut [f64], z: &[Complex64]) {
    widest(
        out.len(),
        #[inline(always)]
        || out.iter_mut().zip(z).for_each(|(out, z)| *out += z.re * z.re + z.im * z.im),
    );
}

/// `out ← out + factor x`.
pub fn add_scaled(out: &mut [f64], factor: f64, x: &[f64]) {
    widest(
        out.len(),
        #[inline(always)]
        || out.iter_mut().zip(x).for_each(|(out, x)| *out += factor * x),
    );
}

/// `out ← root y` and `sum ← sum + weight y` with `y = x − origin`.
pub fn shift(out: &mut [f64], sum: &mut [f64], x: &[f64], origin: &[f64], weight: f64, root: f64) {
    widest(
        out.len(),
        #[inline(always)]
        || {
            for (((out, sum), x), origin) in out.iter_mut().zip(sum).zip(x).zip(origin) {
                let y = x - origin;
                *out = root * y;
                *sum += weight * y;
            }
        },
    );
}

/// `out ← out + Σᵢ factorsᵢ M_{:,columnsᵢ}`, with four columns per pass over `out`; `matrix` holds `M` column by column.
pub fn add_columns(out: &mut [f64], matrix: &[f64], columns: &[usize], factors: &[f64]) {
    widest(
        out.len(),
        #[inline(always)]
        || {
            let rows = out.len();
            let column = |index: usize| &matrix[index * rows..(index + 1) * rows];
            let ((fours, rest), (four_factors, rest_factors)) =
                (columns.as_chunks::<4>(), factors.as_chunks::<4>());
            for (four, [a, b, c, d]) in fours.iter().zip(four_factors) {
                let [p, q, r, s] = four.map(column);
                for ((((out, p), q), r), s) in out.iter_mut().zip(p).zip(q).zip(r).zip(s) {
                    *out += (a * p + b * q) + (c * r + d * s);
                }
            }
            for (&index, factor) in rest.iter().zip(rest_factors) {
                out.iter_mut().zip(column(index)).for_each(|(out, x)| *out += factor * x);
            }
        },
    );
}

/// `sum ← sum + Σ rows_k` over the listed rows.
pub fn add_listed<const W: usize>(sum: &mut [f64; W], rows: &[[f64; W]], list: &[u32]) {
    vectorised(
        #[inline(always)]
        || {
            let mut own = *sum;
            for &k in list {
                own.iter_mut().zip(&rows[k as usize]).for_each(|(sum, x)| *sum += x);
            }
            *sum = own;
        },
    );
}

/// `sums_a ← sums_a + Σ_k factors_{a, to_k} rows_k` for two sums, whose factors lie side by side.
pub fn add_two_products<const W: usize>(
    sums: &mut [[f64; W]; 2],
    factors: &[[f64; 2]],
    rows: &[[f64; W]],
    to: &[usize],
) {
    vectorised(
        #[inline(always)]
        || {
            let [mut first, mut second] = *sums;
            for (row, &to) in rows.iter().zip(to) {
                let [p, q] = factors[to];
                first.iter_mut().zip(row).for_each(|(sum, x)| *sum += p * x);
                second.iter_mut().zip(row).for_each(|(sum, x)| *sum += q * x);
            }
            *sums = [first, second];
        },
    );
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
        let single = |a: &[f64]| a.iter().map(|x| *x as f32).collect::<Vec<f32>>();
        assert_eq!(f64::from(dot_single(&single(a), &single(b))), dot(a, b));
        assert_eq!(dot(a, b), a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>());
        assert_eq!((largest(a), largest(&a[..11]), largest(&[-1.0])), (96.0, 56.0, -1.0));
        assert_eq!((largest_magnitude(&[2.0, -3.0]), largest_magnitude(a)), (3.0, 96.0));
        let signed: Vec<f64> = a.iter().map(|x| if x % 2.0 == 0.0 { -x } else { *x }).collect();
        assert_eq!((largest_magnitude(&signed), sum_of_magnitudes(&signed)), (96.0, a.iter().sum()));
        let z: Vec<Complex64> = a.iter().zip(b).map(|(&x, &y)| Complex64::new(x, -y)).collect();
        let w: Vec<Complex64> = z.iter().map(|z| Complex64::new(2.0 * z.im, 3.0 - z.re)).collect();
        let (mut products, mut norms) = (vec![Complex64::ZERO; 19], vec![0.0; 19]);
        multiply_conjugates(&mut products, &z, &w);
        squared_norms(&mut norms, &z);
        assert!((0..19).all(|i| products[i] == z[i].conj() * w[i] && norms[i] == a[i] * a[i] + b[i] * b[i]));
        multiply_mirrored(&mut products, &z, &w);
        add_squared_norms(&mut norms, &z);
        let twice = |i: usize| 2.0 * (a[i] * a[i] + b[i] * b[i]);
        assert!((0..19).all(|i| products[i] == z[(19 - i) % 19] * w[i] && norms[i] == twice(i)));
        let (columns, factors) = ([6, 0, 1, 4, 2], [1.0, -2.0, 3.0, 0.5, -1.0]);
        let mut out = vec![1.0; 19];
        add_columns(&mut out, matrix.as_slice(), &columns, &factors);
        for (i, value) in out.iter().enumerate() {
            let wanted: f64 = columns.iter().zip(&factors).map(|(&j, f)| f * matrix[(i, j)]).sum();
            assert_eq!(*value, 1.0 + wanted);
        }
    }
}
