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

use std::fmt;
use std::sync::{Arc, OnceLock};

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
    sums: Sums,
}

/// Makes the values of a row of an image.
type MakeRow = dyn Fn(usize) -> Vec<f64> + Send + Sync;

/// Sums of padded rows.
#[derive(Clone)]
enum Sums {
    /// Of all rows, one after the other.
    All(Vec<f64>),
    /// Of the rows of an image in the plane that were asked for. One object lies in few of them.
    Asked { rows: Vec<OnceLock<Box<[f64]>>>, make: Arc<MakeRow> },
}

impl fmt::Debug for Sums {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All(sums) => formatter.debug_tuple("All").field(sums).finish(),
            Self::Asked { rows, .. } => {
                formatter.debug_struct("Asked").field("rows", rows).finish_non_exhaustive()
            }
        }
    }
}

/// Writes the sums of a row, padded.
fn sum_row(row: impl Fn(usize) -> Option<f64>, out: &mut [f64]) {
    let mut sum = 0.0;
    for (i, out) in out.iter_mut().enumerate().skip(COLUMNS_BEYOND) {
        sum += row(i - COLUMNS_BEYOND).unwrap_or(0.0);
        *out = sum;
    }
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
                sum_row(|i| image.row(j, k).get(i).map(|value| value.to_f64()), out);
            }
        });
        Self { size, padded: [padded[0], padded[1]], sums: Sums::All(sums.into_values()) }
    }

    /// Number of cells of the image along x, y, z.
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// The sums of a padded row, made by the first caller that asks for them.
    #[inline]
    fn row(&self, row: usize) -> &[f64] {
        match &self.sums {
            Sums::All(sums) => &sums[row * self.padded[0]..(row + 1) * self.padded[0]],
            Sums::Asked { rows, make } => rows[row].get_or_init(|| {
                let mut sums = vec![0.0; self.padded[0]];
                if let Some(j) = row.checked_sub(ROWS_BEYOND).filter(|j| *j < self.size[1]) {
                    let values = make(j);
                    sum_row(|i| values.get(i).copied(), &mut sums);
                }
                sums.into()
            }),
        }
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
            let taps = &self.row(slice * self.padded[1] + row + j)[*first..*first + 4];
            let value = taps[0] * values[0] + taps[1] * values[1] + taps[2] * values[2] + taps[3] * values[3];
            let slope = taps[0] * slopes[0] + taps[1] * slopes[1] + taps[2] * slopes[2] + taps[3] * slopes[3];
            sums[0] += across[j] * value;
            sums[1] += across[j] * slope;
            sums[2] += across_slopes[j] * value;
        }
        sums
    }
}

impl<const D: usize> Integrated<D> {
    /// The field of an image in the plane whose rows `make` gives, each of them when it is asked for first. The bits are those of
    /// [`Integrated::new`]. `D` is 2.
    pub(crate) fn of_rows(size: [usize; 3], make: Arc<MakeRow>) -> Self {
        debug_assert!(D == 2 && size[2] == 1, "rows of {size:?}");
        let padded = [size[0] + 2 * COLUMNS_BEYOND, size[1] + 2 * ROWS_BEYOND];
        Self { size, padded, sums: Sums::Asked { rows: vec![OnceLock::new(); padded[1]], make } }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_that_are_asked_for_are_those_made_in_advance() {
        let value = |at: usize| (0.37 * at as f64).sin();
        let image = Image::new([9, 7, 1], (0..63).map(value).collect()).unwrap();
        let all = Integrated::<2>::new(&image);
        let asked = Integrated::<2>::of_rows(image.size(), Arc::new(move |j| image.row(j, 0).to_vec()));
        for k in 0..500 {
            let at = [-3.0 + 0.031 * k as f64, 9.0 - 0.027 * k as f64];
            assert_eq!(all.at(at), asked.at(at), "{at:?}");
        }
        let few = asked.clone();
        let Sums::Asked { rows, make } = few.sums else { panic!("rows are made when asked for") };
        assert!(rows.iter().any(|row| row.get().is_some()) && make(0).len() == 9);
    }
}
