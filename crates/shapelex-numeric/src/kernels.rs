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

/// Numbers of which [`exponentials`] are taken at once.
pub const GROUP: usize = 8;

/// Exponent below which [`exponentials`] are those of this one, about 10⁻³⁰⁷.
const LEAST_EXPONENT: f64 = -708.0;

/// `e^x` of numbers up to 700, with a relative error of 3·10⁻¹⁶; numbers below −708 count as −708. Within
/// [`vectorised`], all at once.
///
/// ```text
/// x = k ln 2 + r,   |r| ≤ (ln 2)/2,   e^x = 2^k Σ_{i ≤ 13} r^i/i!
/// ```
#[inline(always)]
pub fn exponentials(x: [f64; GROUP]) -> [f64; GROUP] {
    /// Adding it rounds to a whole number, which is then in the last bits.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    /// `ln 2` in two parts, of which the first has few digits: its products with `k` are exact.
    const LN_2: [f64; 2] = [0.693_145_751_953_125, 1.428_606_820_309_417_2e-6];
    let mut power = [0.0; GROUP];
    let mut rest = [0.0; GROUP];
    for i in 0..GROUP {
        let x = if x[i] > LEAST_EXPONENT { x[i] } else { LEAST_EXPONENT };
        let rounded = x * std::f64::consts::LOG2_E + ROUND;
        let k = rounded - ROUND;
        rest[i] = (x - k * LN_2[0]) - k * LN_2[1];
        power[i] = f64::from_bits((rounded.to_bits() << 52).wrapping_add(1023 << 52));
    }
    let mut sum = [1.0 / FACTORIALS[12]; GROUP];
    for factorial in FACTORIALS[..12].iter().rev().chain(&[1.0]) {
        for i in 0..GROUP {
            sum[i] = sum[i] * rest[i] + 1.0 / factorial;
        }
    }
    std::array::from_fn(|i| power[i] * sum[i])
}

/// `1!` to `13!`.
const FACTORIALS: [f64; 13] = [
    1.0,
    2.0,
    6.0,
    24.0,
    120.0,
    720.0,
    5040.0,
    40_320.0,
    362_880.0,
    3_628_800.0,
    39_916_800.0,
    479_001_600.0,
    6_227_020_800.0,
];

/// `⟨z, v⟩ = Σ conj(zᵢ) vᵢ`, its real and its imaginary part, of complex numbers given as all real parts, then all imaginary parts.
pub fn split_product(z: &[f64], v: &[f64]) -> [f64; 2] {
    let ((z_re, z_im), (v_re, v_im)) = (z.split_at(z.len() / 2), v.split_at(v.len() / 2));
    widest(
        z.len(),
        #[inline(always)]
        || {
            let (z_re, z_re_tail) = z_re.as_chunks::<LANES>();
            let (z_im, z_im_tail) = z_im.as_chunks::<LANES>();
            let (v_re, v_re_tail) = v_re.as_chunks::<LANES>();
            let (v_im, v_im_tail) = v_im.as_chunks::<LANES>();
            let (mut re, mut im) = ([0.0; LANES], [0.0; LANES]);
            for ((a, b), (x, y)) in z_re.iter().zip(z_im).zip(v_re.iter().zip(v_im)) {
                for k in 0..LANES {
                    re[k] += a[k] * x[k] + b[k] * y[k];
                    im[k] += a[k] * y[k] - b[k] * x[k];
                }
            }
            let (mut re, mut im) = (re.iter().sum::<f64>(), im.iter().sum::<f64>());
            for ((a, b), (x, y)) in z_re_tail.iter().zip(z_im_tail).zip(v_re_tail.iter().zip(v_im_tail)) {
                re += a * x + b * y;
                im += a * y - b * x;
            }
            [re, im]
        },
    )
}

/// `out ← out + c z` for the complex number `c`; lists of complex numbers as in [`split_product`].
pub fn add_split_multiple(out: &mut [f64], [re, im]: [f64; 2], z: &[f64]) {
    let n = z.len() / 2;
    let ((out_re, out_im), (z_re, z_im)) = (out.split_at_mut(n), z.split_at(n));
    widest(
        z.len(),
        #[inline(always)]
        || {
            for ((x, y), (a, b)) in out_re.iter_mut().zip(out_im).zip(z_re.iter().zip(z_im)) {
                *x += re * a - im * b;
                *y += re * b + im * a;
            }
        },
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
    fn exponentials_are_those_of_the_library() {
        for k in 0..20_000 {
            let x: [f64; GROUP] = std::array::from_fn(|i| 5.0 - 0.035 * k as f64 - 0.0041 * i as f64);
            let (found, inside) = (
                exponentials(x),
                vectorised(
                    #[inline(always)]
                    || exponentials(x),
                ),
            );
            for ((x, found), inside) in x.into_iter().zip(found).zip(inside) {
                let expected = x.max(LEAST_EXPONENT).exp();
                assert!((found / expected - 1.0).abs() < 4e-16, "{found:e} for {expected:e}");
                assert_eq!(found, inside);
            }
        }
    }

    #[test]
    fn split_complex_numbers_are_multiplied_as_complex_ones() {
        for n in [1, 7, 16, 33, 100] {
            let list =
                |phase: f64| -> Vec<f64> { (0..2 * n).map(|i| (1.7 * i as f64 + phase).sin()).collect() };
            let (z, v) = (list(0.3), list(1.1));
            let complex = |list: &[f64], i: usize| Complex64::new(list[i], list[n + i]);
            let expected: Complex64 = (0..n).map(|i| complex(&z, i).conj() * complex(&v, i)).sum();
            let found = split_product(&z, &v);
            assert!((found[0] - expected.re).abs() < 1e-13 && (found[1] - expected.im).abs() < 1e-13);
            let mut sum = v.clone();
            add_split_multiple(&mut sum, found, &z);
            for i in 0..n {
                let expected = complex(&v, i) + Complex64::new(found[0], found[1]) * complex(&z, i);
                assert!((complex(&sum, i) - expected).norm() < 1e-13);
            }
        }
    }

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
