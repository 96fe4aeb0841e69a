//! The antiderivative of an image along x.
//!
//! ```text
//! F(x, y) = Σ f[j, i] β²(x − i) β²(y − j)
//! G(x, y) = ∫_{−∞}^x F(τ, y) dτ = Σ C[j, i] β³(x − i − 1/2) β²(y − j),   C[j, i] = Σ_{m ≤ i} f[j, m]
//! ∬_Ω F dA = ∮ G dy,   ∭_Ω F dV = ∯ G dy ∧ dz
//! ```
//!
//! The image is zero outside of its grid. `F` is the image blurred with a variance of 1/4 per axis. Quadratic splines are used
//! because the gradient of a discrete boundary integral contains the sampling error of `∂G/∂y`, which is about thirty times as
//! large for linear interpolation.

use super::image::{Image, Value};

/// Columns of zeros to the left, and of the total of the row to the right.
const COLUMNS_BEYOND: usize = 4;
/// Rows, and slices in space, of zeros on either side.
const ROWS_BEYOND: usize = 3;
/// Distance from the grid at which coordinates are clamped: from 3/2 on, `G` depends no longer on them.
const CLAMP: f64 = 2.0;

/// The antiderivative of an image (`D = 2`) or a volume (`D = 3`) along x, with its gradient.
#[derive(Debug, Clone)]
pub struct Integrated<const D: usize> {
    size: [usize; 3],
    /// Number of sums in a padded row, and of padded rows in a slice.
    padded: [usize; 2],
    sums: Vec<f64>,
}

impl<const D: usize> Integrated<D> {
    /// Sums the rows of an image. `D` is 2 for an image of one layer, which a volume of one slice is as well.
    ///
    /// Memory: 8 bytes per cell. The same bits on any number of threads.
    pub fn new<T: Value>(image: &Image<T>) -> Self {
        const { assert!(D == 2 || D == 3) };
        let size = image.size();
        let slices_beyond = if D == 3 { ROWS_BEYOND } else { 0 };
        let padded = [size[0] + 2 * COLUMNS_BEYOND, size[1] + 2 * ROWS_BEYOND, size[2] + 2 * slices_beyond];
        let sums = Image::from_rows(padded, |j, k, out: &mut [f64]| {
            let (j, k) = (j.wrapping_sub(ROWS_BEYOND), k.wrapping_sub(slices_beyond));
            if j < size[1] && k < size[2] {
                let mut sum = 0.0;
                for (i, out) in out.iter_mut().enumerate().skip(COLUMNS_BEYOND) {
                    sum += image.row(j, k).get(i - COLUMNS_BEYOND).map_or(0.0, |value| value.to_f64());
                    *out = sum;
                }
            }
        });
        Self { size, padded: [padded[0], padded[1]], sums: sums.values().to_vec() }
    }

    /// Number of cells of the image along x, y, z.
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// First padded index and the weights along x: `β³(x − i − 1/2)` and its derivative.
    fn along_x(&self, x: f64) -> (usize, [f64; 4], [f64; 4]) {
        let x = x.clamp(-CLAMP, self.size[0] as f64 - 1.0 + CLAMP) - 0.5;
        let cell = x.floor();
        let (t, u) = (x - cell, 1.0 - (x - cell));
        let values = [
            u * u * u / 6.0,
            (4.0 - 3.0 * t * t * (2.0 - t)) / 6.0,
            (4.0 - 3.0 * u * u * (2.0 - u)) / 6.0,
            t * t * t / 6.0,
        ];
        let slopes = [-0.5 * u * u, t * (1.5 * t - 2.0), u * (2.0 - 1.5 * u), 0.5 * t * t];
        ((cell as isize - 1 + COLUMNS_BEYOND as isize) as usize, values, slopes)
    }

    /// First padded index and the weights along y or z: `β²(y − j)` and its derivative.
    fn across(&self, axis: usize, y: f64) -> (usize, [f64; 3], [f64; 3]) {
        let y = y.clamp(-CLAMP, self.size[axis] as f64 - 1.0 + CLAMP);
        let cell = (y + 0.5).floor();
        let t = y - cell;
        let (below, above) = (0.5 - t, 0.5 + t);
        let values = [0.5 * below * below, 0.75 - t * t, 0.5 * above * above];
        ((cell as isize - 1 + ROWS_BEYOND as isize) as usize, values, [-below, -2.0 * t, above])
    }

    /// Value and slope along x of three rows, weighted along y, and the value weighted with the slopes along y.
    fn three_rows(
        &self,
        (first, values, slopes): &(usize, [f64; 4], [f64; 4]),
        (row, across, across_slopes): &(usize, [f64; 3], [f64; 3]),
        slice: usize,
    ) -> [f64; 3] {
        let mut sums = [0.0; 3];
        for j in 0..3 {
            let start = (slice * self.padded[1] + row + j) * self.padded[0] + first;
            let taps = &self.sums[start..start + 4];
            let value = taps[0] * values[0] + taps[1] * values[1] + taps[2] * values[2] + taps[3] * values[3];
            let slope = taps[0] * slopes[0] + taps[1] * slopes[1] + taps[2] * slopes[2] + taps[3] * slopes[3];
            sums[0] += across[j] * value;
            sums[1] += across[j] * slope;
            sums[2] += across_slopes[j] * value;
        }
        sums
    }
}

impl Integrated<2> {
    /// `G` and its gradient at a point, by 12 sums. `∂G/∂x` is `F`.
    #[inline]
    pub fn at(&self, [x, y]: [f64; 2]) -> (f64, [f64; 2]) {
        let [value, slope_x, slope_y] = self.three_rows(&self.along_x(x), &self.across(1, y), 0);
        (value, [slope_x, slope_y])
    }
}

impl Integrated<3> {
    /// `G` and its gradient at a point, by 36 sums. `∂G/∂x` is `F`.
    #[inline]
    pub fn at(&self, [x, y, z]: [f64; 3]) -> (f64, [f64; 3]) {
        let (along, across) = (self.along_x(x), self.across(1, y));
        let (slice, values, slopes) = self.across(2, z);
        let (mut sum, mut gradient) = (0.0, [0.0; 3]);
        for k in 0..3 {
            let [value, slope_x, slope_y] = self.three_rows(&along, &across, slice + k);
            sum += values[k] * value;
            gradient[0] += values[k] * slope_x;
            gradient[1] += values[k] * slope_y;
            gradient[2] += slopes[k] * value;
        }
        (sum, gradient)
    }
}
