//! Gaussian blur and derivatives by separable kernels.
//!
//! ```text
//! ∂^n f_σ (x) = Σ_m κ_n[m] f(x − m),   |m| ≤ ⌊4σ + 1/2⌋,   w[m] ∝ e^{−m²/2σ²},   Σ w = 1
//! κ_0 = w,   κ_1 = −m/σ² w,   κ_2 = (m²/σ⁴ − 1/σ²) w
//! ```
//!
//! Beyond its edges the image is continued by its outermost cells. `σ` is in cells along each axis: a blur of `σ` in units of
//! length has `σ/spacing`.

use std::borrow::Cow;

use super::image::{Image, Value};

/// Radius of a kernel in units of `σ`: the Gaussian has fallen to 3·10⁻⁴.
const REACH: f64 = 4.0;

/// The kernel `κ_order`, from `m = −r` to `r`. `σ = 0` gives the identity for order 0. `order ≤ 2`.
pub fn gaussian_kernel(sigma: f64, order: usize) -> Vec<f64> {
    debug_assert!(order <= 2 && (sigma > 0.0 || order == 0), "order {order} of {sigma}");
    let radius = (REACH * sigma + 0.5).floor() as i64;
    if radius == 0 && order == 0 {
        return vec![1.0];
    }
    let variance = sigma * sigma;
    let weight = |m: i64| (-0.5 * (m * m) as f64 / variance).exp();
    let sum: f64 = (-radius..=radius).map(weight).sum();
    let factor = |m: f64| match order {
        0 => 1.0,
        1 => -m / variance,
        _ => (m * m / variance - 1.0) / variance,
    };
    (-radius..=radius).map(|m| factor(m as f64) * weight(m) / sum).collect()
}

/// Blur with `σ` cells along each axis.
pub fn blur<T: Value>(image: &Image<T>, sigma: [f64; 3]) -> Image<T> {
    derivative(image, sigma, [0; 3])
}

/// Derivative of `order[axis] ≤ 2` along each axis of the image blurred with `sigma[axis]` cells. A derivative along an axis
/// needs a positive `σ` there.
///
/// Cost: `8σ + 1` products per cell and axis.
pub fn derivative<T: Value>(image: &Image<T>, sigma: [f64; 3], order: [usize; 3]) -> Image<T> {
    if image.is_planar() && order[2] == 0 {
        let rows = DerivativeRows::new(image.size(), sigma, order);
        return Image::from_rows(image.size(), |j, _, out| out.copy_from_slice(&rows.row(image, j)));
    }
    let mut filtered: Option<Image<T>> = None;
    for axis in [2, 1, 0] {
        if image.size()[axis] > 1 || order[axis] > 0 {
            let kernel = gaussian_kernel(sigma[axis], order[axis]);
            if kernel.len() > 1 {
                filtered = Some(correlate(filtered.as_ref().unwrap_or(image), axis, &kernel));
            }
        }
    }
    filtered.unwrap_or_else(|| image.clone())
}

/// Laplacian of a metric, of the blurred image: `Σ_ab M_ab ∂_a ∂_b f_σ`.
///
/// For voxels of positions `w = A i + b`, `M = (AᵀA)⁻¹` gives the Laplacian in `w`. For an image in the plane, the third row
/// and column of `M` are not used. Cost: at most 12 passes, 7 if `M` is diagonal.
pub fn laplacian<T: Value>(image: &Image<T>, sigma: [f64; 3], metric: [[f64; 3]; 3]) -> Image<T> {
    if image.is_planar() {
        let rows = LaplacianRows::new(image.size(), sigma, metric);
        return Image::from_rows(image.size(), |j, _, out| out.copy_from_slice(&rows.row(image, j)));
    }
    let mut orders: [Option<Image<T>>; 3] = [None, None, None];
    for (a, b) in [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)] {
        let weight = if a == b { metric[a][a] } else { metric[a][b] + metric[b][a] };
        if weight == 0.0 {
            continue;
        }
        let mut order = [0; 3];
        order[a] += 1;
        order[b] += 1;
        // The pass along x is common to all terms of the same order in x.
        let along_x = std::mem::take(&mut order[0]);
        let term = derivative(image, [0.0, sigma[1], sigma[2]], order);
        orders[along_x] = Some(match orders[along_x].take() {
            None => term.map(|value| weight * value),
            Some(sum) => combine(&sum, &term, weight),
        });
    }
    let passes = orders.iter().enumerate().filter_map(|(order, sum)| {
        sum.as_ref().map(|sum| correlate(sum, 0, &gaussian_kernel(sigma[0], order)))
    });
    passes.reduce(|sum, pass| combine(&sum, &pass, 1.0)).unwrap_or_else(|| image.map(|_| 0.0))
}

/// Length of the gradient of the blurred image in a metric, `√(Σ_ab M_ab ∂_a f_σ ∂_b f_σ)`.
pub fn gradient_length<T: Value>(image: &Image<T>, sigma: [f64; 3], metric: [[f64; 3]; 3]) -> Image<T> {
    if image.is_planar() {
        let slopes = [[1, 0, 0], [0, 1, 0]].map(|order| DerivativeRows::new(image.size(), sigma, order));
        return Image::from_rows(image.size(), |j, _, out| {
            let [along_x, along_y] = slopes.each_ref().map(|slope| slope.row(image, j));
            for ((out, x), y) in out.iter_mut().zip(&along_x).zip(&along_y) {
                let (x, y) = (x.to_f64(), y.to_f64());
                let of_x = metric[0][0] * x * x + metric[0][1] * x * y;
                let square = of_x + metric[1][0] * y * x + metric[1][1] * y * y;
                *out = T::from_f64(square.max(0.0).sqrt());
            }
        });
    }
    let axes = 3;
    let slopes: Vec<Image<T>> = (0..axes)
        .map(|axis| {
            let mut order = [0; 3];
            order[axis] = 1;
            derivative(image, sigma, order)
        })
        .collect();
    Image::from_rows(image.size(), |j, k, out| {
        for (i, out) in out.iter_mut().enumerate() {
            let slope = |axis: usize| slopes[axis].row(j, k)[i].to_f64();
            let pairs = (0..axes).flat_map(|a| (0..axes).map(move |b| (a, b)));
            let square: f64 = pairs.map(|(a, b)| metric[a][b] * slope(a) * slope(b)).sum();
            *out = T::from_f64(square.max(0.0).sqrt());
        }
    })
}

/// Row after row of a [`derivative`] of a planar image, whatever the other rows: requested rows are made, and stay in the cache
/// between the passes.
pub(crate) struct DerivativeRows {
    along_x: Vec<f64>,
    along_y: Vec<f64>,
}

impl DerivativeRows {
    /// The rows of images of a size, without a derivative along z.
    pub(crate) fn new(size: [usize; 3], sigma: [f64; 3], order: [usize; 3]) -> Self {
        let [along_x, along_y] = [0, 1].map(|axis| match size[axis] > 1 || order[axis] > 0 {
            true => gaussian_kernel(sigma[axis], order[axis]),
            false => vec![1.0],
        });
        Self { along_x, along_y }
    }

    /// Row `j`.
    pub(crate) fn row<T: Value>(&self, image: &Image<T>, j: usize) -> Vec<T> {
        let across = across(image, &self.along_y, j);
        match self.along_x.len() > 1 {
            true => along_row(&across, &self.along_x).into_iter().map(T::from_f64).collect(),
            false => across.into_owned(),
        }
    }
}

/// Row `j` of a planar image, filtered along y.
fn across<'a, T: Value>(image: &'a Image<T>, kernel: &[f64], j: usize) -> Cow<'a, [T]> {
    if kernel.len() == 1 {
        return Cow::Borrowed(image.row(j, 0));
    }
    let sums = across_rows(|y| image.row(y, 0), j, image.size()[1], kernel);
    Cow::Owned(sums.into_iter().map(T::from_f64).collect())
}

/// Row after row of the [`laplacian`] of a planar image.
pub(crate) struct LaplacianRows {
    /// Order in x, weight, and kernel along y of each term.
    terms: Vec<(usize, f64, Vec<f64>)>,
    /// Kernels along x by their order.
    along_x: [Vec<f64>; 3],
}

impl LaplacianRows {
    /// The rows of images of a size.
    pub(crate) fn new(size: [usize; 3], sigma: [f64; 3], metric: [[f64; 3]; 3]) -> Self {
        let term = |(a, b): (usize, usize)| {
            let weight = if a == b { metric[a][a] } else { metric[a][b] + metric[b][a] };
            let along_x = usize::from(a == 0) + usize::from(b == 0);
            let along_y = DerivativeRows::new(size, [0.0, sigma[1], 0.0], [0, 2 - along_x, 0]).along_y;
            (weight != 0.0).then_some((along_x, weight, along_y))
        };
        let terms = [(0, 0), (1, 1), (0, 1)].into_iter().filter_map(term).collect();
        Self { terms, along_x: [0, 1, 2].map(|order| gaussian_kernel(sigma[0], order)) }
    }

    /// Row `j`. The pass along x is common to all terms of the same order in x.
    pub(crate) fn row<T: Value>(&self, image: &Image<T>, j: usize) -> Vec<T> {
        let mut orders: [Option<Vec<T>>; 3] = [None, None, None];
        for (order, weight, kernel) in &self.terms {
            let term = across(image, kernel, j);
            orders[*order] = Some(match orders[*order].take() {
                None => term.iter().map(|value| T::from_f64(weight * value.to_f64())).collect(),
                Some(sum) => added(&sum, &term, *weight),
            });
        }
        let passes = orders.iter().zip(&self.along_x).filter_map(|(sum, kernel)| {
            let pass = along_row(sum.as_ref()?, kernel);
            Some(pass.into_iter().map(T::from_f64).collect::<Vec<T>>())
        });
        let sum = passes.reduce(|sum, pass| added(&sum, &pass, 1.0));
        sum.unwrap_or_else(|| vec![T::from_f64(0.0); image.size()[0]])
    }
}

/// `a + factor · b` of two rows.
fn added<T: Value>(a: &[T], b: &[T], factor: f64) -> Vec<T> {
    a.iter().zip(b).map(|(a, b)| T::from_f64(a.to_f64() + factor * b.to_f64())).collect()
}

/// `a + factor · b`.
fn combine<T: Value>(a: &Image<T>, b: &Image<T>, factor: f64) -> Image<T> {
    Image::from_rows(a.size(), |j, k, out| {
        for ((out, a), b) in out.iter_mut().zip(a.row(j, k)).zip(b.row(j, k)) {
            *out = T::from_f64(a.to_f64() + factor * b.to_f64());
        }
    })
}

/// `Σ_m κ[m] f(x − m)` along an axis, for an even or odd kernel. Sums are in double precision, from the middle outwards.
fn correlate<T: Value>(image: &Image<T>, axis: usize, kernel: &[f64]) -> Image<T> {
    let size = image.size();
    Image::from_rows(size, |j, k, out| {
        let sums = match axis {
            0 => along_row(image.row(j, k), kernel),
            1 => across_rows(|y| image.row(y, k), j, size[1], kernel),
            _ => across_rows(|z| image.row(j, z), k, size[2], kernel),
        };
        for (out, sum) in out.iter_mut().zip(sums) {
            *out = T::from_f64(sum);
        }
    })
}

/// `Σ_m κ[m] f(x − m)` along a row, continued by its ends.
pub(crate) fn along_row<T: Value>(row: &[T], kernel: &[f64]) -> Vec<f64> {
    let (count, radius) = (row.len(), kernel.len() / 2);
    let mut continued = vec![row[0].to_f64(); count + 2 * radius];
    for (out, value) in continued[radius..].iter_mut().zip(row) {
        *out = value.to_f64();
    }
    continued[radius + count..].fill(row[count - 1].to_f64());
    let before = |m: usize| &continued[radius - m..][..count];
    let after = |m: usize| &continued[radius + m..][..count];
    sums_of_pairs(kernel, before, after)
}

/// `Σ_m κ[m] f(y − m)` for the row at `y` of `count` rows, continued by the outermost ones.
pub(crate) fn across_rows<'a, T: Value + 'a>(
    row: impl Fn(usize) -> &'a [T],
    y: usize,
    count: usize,
    kernel: &[f64],
) -> Vec<f64> {
    sums_of_pairs(kernel, |m| row(y.saturating_sub(m)), |m| row((y + m).min(count - 1)))
}

/// Two rows at the same distance from the middle, and the weight of their sum or difference.
type Pair<'a, T> = (f64, &'a [T], &'a [T]);

/// `κ[0] f(x) + Σ_{m>0} κ[m] (f(x − m) ± f(x + m))` for the rows `before(m)` and `after(m)`: their sum for an even kernel, their
/// difference for an odd one.
fn sums_of_pairs<'a, T: Value + 'a>(
    kernel: &[f64],
    before: impl Fn(usize) -> &'a [T],
    after: impl Fn(usize) -> &'a [T],
) -> Vec<f64> {
    let weights = &kernel[kernel.len() / 2..];
    let pairs = weights.iter().enumerate().skip(1).map(|(m, weight)| (*weight, before(m), after(m)));
    let (middle, pairs): (&[T], Vec<Pair<'a, T>>) = (before(0), pairs.collect());
    let is_even = kernel[0] == kernel[kernel.len() - 1];
    let sums = vec![0.0; middle.len()];
    // Uses the widest vectors of the machine. Products and sums are not fused, so that the bits are the same on all machines. The loop
    // takes the sums: a function that can be called again is called from one for narrow vectors.
    pulp::Arch::new().dispatch(
        #[inline(always)]
        move || {
            let mut sums = sums;
            match is_even {
                true => add_pairs(&mut sums, weights[0], middle, &pairs, |a, b| a + b),
                false => add_pairs(&mut sums, weights[0], middle, &pairs, |a, b| a - b),
            }
            sums
        },
    )
}

/// Adds the weighted middle row, then the weighted pairs in their order, to each of the sums. Two pairs take one pass over the sums.
#[inline(always)]
fn add_pairs<T: Value>(
    sums: &mut [f64],
    weight: f64,
    middle: &[T],
    pairs: &[Pair<'_, T>],
    both: impl Fn(f64, f64) -> f64,
) {
    for (sum, value) in sums.iter_mut().zip(middle) {
        *sum += weight * value.to_f64();
    }
    let (twos, rest) = pairs.as_chunks::<2>();
    for [(w, a, b), (v, c, d)] in twos {
        for ((((sum, a), b), c), d) in sums.iter_mut().zip(*a).zip(*b).zip(*c).zip(*d) {
            let inner = *sum + w * both(a.to_f64(), b.to_f64());
            *sum = inner + v * both(c.to_f64(), d.to_f64());
        }
    }
    for (w, a, b) in rest {
        for ((sum, a), b) in sums.iter_mut().zip(*a).zip(*b) {
            *sum += w * both(a.to_f64(), b.to_f64());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(size: [usize; 3], value: impl Fn(f64, f64, f64) -> f64) -> Image {
        let cells = (0..size.iter().product::<usize>()).map(|at| {
            let [i, j, k] = [at % size[0], at / size[0] % size[1], at / size[0] / size[1]];
            value(i as f64, j as f64, k as f64)
        });
        Image::new(size, cells.collect()).unwrap()
    }

    #[test]
    fn kernels_have_the_moments_of_derivatives() {
        for sigma in [1.0, 2.0, 3.5] {
            let moment = |order: usize, power: i32| -> f64 {
                let kernel = gaussian_kernel(sigma, order);
                let radius = (kernel.len() / 2) as i32;
                kernel.iter().enumerate().map(|(i, w)| w * f64::from(i as i32 - radius).powi(power)).sum()
            };
            // The kernel is cut at 4σ.
            let cut = 2e-3;
            assert!((moment(0, 0) - 1.0).abs() < 1e-14 && moment(1, 0).abs() < 1e-14);
            assert!((moment(1, 1) + 1.0).abs() < cut && moment(2, 0).abs() < cut, "{sigma}");
            assert!((moment(2, 2) - 2.0).abs() < 20.0 * cut, "{}", moment(2, 2));
        }
        assert_eq!(gaussian_kernel(2.0, 0).len(), 17);
        assert_eq!(gaussian_kernel(0.0, 0), [1.0]);
    }

    #[test]
    fn derivatives_of_polynomials_are_exact_away_from_the_edges() {
        let f = image([25, 22, 24], |x, y, z| 0.5 * x * x + x * y - 2.0 * y * z + 3.0 * z);
        let sigma = [1.0, 1.5, 1.2];
        let middle = [12, 10, 11];
        for (order, expected) in [
            ([1, 0, 0], 12.0 + 10.0),
            ([0, 1, 0], 12.0 - 22.0),
            ([0, 0, 1], -20.0 + 3.0),
            ([1, 1, 0], 1.0),
            ([0, 1, 1], -2.0),
        ] {
            let found = derivative(&f, sigma, order).at(middle);
            assert!((found - expected).abs() < 2e-3 * expected.abs(), "{found} for {expected}");
        }
        let metric = [[2.0, 0.5, 0.25], [0.5, 3.0, -0.75], [0.25, -0.75, 1.0]];
        let found = laplacian(&f, sigma, metric).at(middle);
        let expected = 2.0 + 2.0 * 0.5 + 2.0 * 0.75 * 2.0;
        // The second derivative of a constant is not zero where the kernel is cut: 200 is the size of `f` there.
        assert!((found - expected).abs() < 2e-3 * 200.0, "{found} for {expected}");
        let slopes = [22.0, -10.0, -17.0];
        let square: f64 =
            (0..9).map(|ab| metric[ab / 3][ab % 3] * slopes[ab / 3] * slopes[ab % 3]).sum::<f64>();
        let found = gradient_length(&f, sigma, metric).at(middle);
        assert!((found - square.sqrt()).abs() < 0.1, "{found} for {}", square.sqrt());
    }

    /// A planar image is filtered row by row; a volume of equal slices, slice by slice, with the same sums.
    #[test]
    fn rows_of_planar_images_are_those_of_volumes() {
        let value = |x: f64, y: f64| (1.3 * x + 0.1).sin() * (0.7 * y + 0.2 * x).cos();
        let metric = [[2.0, 0.5, 0.0], [0.5, 3.0, 0.0], [0.0; 3]];
        let sigma = [0.9, 1.4, 0.0];
        for [columns, rows] in [[37, 20], [16, 5], [1, 9], [9, 1]] {
            let flat = image([columns, rows, 1], |x, y, _| value(x, y));
            let deep = image([columns, rows, 2], |x, y, _| value(x, y));
            let slice = |volume: Image| volume.values()[..columns * rows].to_vec();
            for order in [[0, 0, 0], [1, 0, 0], [0, 1, 0], [2, 0, 0], [1, 1, 0]] {
                let expected = slice(derivative(&deep, sigma, order));
                assert_eq!(
                    derivative(&flat, sigma, order).values(),
                    expected,
                    "{columns} × {rows}, {order:?}"
                );
            }
            assert_eq!(laplacian(&flat, sigma, metric).values(), slice(laplacian(&deep, sigma, metric)));
            let lengths = gradient_length(&flat, sigma, metric);
            let slopes = [[1, 0, 0], [0, 1, 0]].map(|order| derivative(&flat, sigma, order));
            for (at, found) in lengths.values().iter().enumerate() {
                let [x, y] = [slopes[0].values()[at], slopes[1].values()[at]];
                let expected = (2.0 * x * x + 0.5 * x * y + 0.5 * y * x + 3.0 * y * y).max(0.0).sqrt();
                assert_eq!(*found, expected);
            }
        }
    }

    /// The Laplacian by one pass along x for each order is the sum of the derivatives.
    #[test]
    fn the_laplacian_is_the_sum_of_its_terms() {
        let f = image([9, 8, 7], |x, y, z| (1.3 * x + 0.1).sin() * (0.7 * y * z + x).cos());
        let metric = [[2.0, 0.5, 0.25], [0.5, 3.0, -0.75], [0.25, -0.75, 1.0]];
        let sigma = [0.9, 1.1, 1.4];
        let found = laplacian(&f, sigma, metric);
        let mut expected = f.map::<f64>(|_| 0.0);
        for a in 0..3 {
            for b in 0..3 {
                let mut order = [0; 3];
                order[a] += 1;
                order[b] += 1;
                expected = combine(&expected, &derivative(&f, sigma, order), metric[a][b]);
            }
        }
        for (found, expected) in found.values().iter().zip(expected.values()) {
            assert!((found - expected).abs() < 1e-12, "{found} for {expected}");
        }
    }

    #[test]
    fn blurring_keeps_constants_and_moves_with_the_image() {
        let constant = image([6, 5, 1], |_, _, _| 3.0);
        assert!(blur(&constant, [2.0; 3]).values().iter().all(|value| (value - 3.0).abs() < 1e-14));
        let at = |x0: f64| image([40, 30, 1], move |x, y, _| if x == x0 && y == 15.0 { 1.0 } else { 0.0 });
        let [a, b] = [at(18.0), at(20.0)].map(|f| blur(&f, [2.0, 1.0, 0.0]));
        assert_eq!(a.at([17, 14, 0]), b.at([19, 14, 0]));
        assert!(a.at([18, 15, 0]) > a.at([19, 15, 0]) && a.at([19, 15, 0]) > a.at([18, 17, 0]));
    }
}
