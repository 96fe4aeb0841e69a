//! Responses of the detector, with normals of sheets.

use rayon::prelude::*;

use shapelex_geometry::vector::dot;
use shapelex_numeric::bounded::Stop;

use super::hessian::{Hessians, smallest_eigenpair};
use crate::SegmentationError;
use crate::energy::Polarity;
use crate::field::{Image, Value};
use crate::frame::Frame;

/// Factor of the second derivative along the normal in the best kernel `Δg − 5 g_vv`.
const ACROSS: f64 = 5.0;
/// Least blur in cells along an axis: with less, second derivatives of sampled Gaussians are wrong by more than a third.
const LEAST_BLUR: f64 = 0.5;
/// Bits of a number that one pass of [`order_statistic`] finds.
const DIGIT: u32 = 16;

/// Responses and normals of all cells of a volume. `T`: type in which they are kept.
#[derive(Debug, Clone, PartialEq)]
pub struct Sheets<T = f64> {
    response: Image<T>,
    normal: [Image<T>; 3],
    frame: Frame<3>,
}

impl<T: Value> Sheets<T> {
    /// Detects sheets in a volume blurred with `sigma` units of length, isotropic in the frame. `None` if the caller wants to
    /// stop.
    ///
    /// Memory: the result, four values of `T` per cell; three slices in double precision per thread. Cost: 15 passes with
    /// `8σ + 1` products per cell. The same bits on any number of threads.
    ///
    /// # Errors
    /// [`SegmentationError::Blur`] below half a cell; [`SegmentationError::NotFinite`] if responses exceed the range of `T`.
    pub fn new<U: Value>(
        image: &Image<U>,
        frame: &Frame<3>,
        sigma: f64,
        polarity: Polarity,
        stop: Stop<'_>,
    ) -> Result<Option<Self>, SegmentationError> {
        let cells = frame.sigma_in_cells(sigma);
        let smallest = cells.into_iter().fold(f64::INFINITY, f64::min);
        if !(smallest >= LEAST_BLUR && sigma.is_finite()) {
            return Err(SegmentationError::Blur { least: LEAST_BLUR, sigma: smallest });
        }
        let size = image.size();
        let hessians = Hessians::new(image, cells);
        let zeros = || vec![T::from_f64(0.0); size.iter().product()];
        let (mut response, mut normal) = (zeros(), [zeros(), zeros(), zeros()]);
        let [x, y, z] = normal.each_mut().map(|part| part.par_chunks_mut(size[0] * size[1]));
        let slices = response.par_chunks_mut(size[0] * size[1]).zip(x).zip(y).zip(z).enumerate();
        slices.for_each(|(k, (((response, x), y), z))| {
            if stop() {
                return;
            }
            hessians.slice(k, |j, rows| {
                for i in 0..size[0] {
                    let matrix = in_frame(rows.each_ref().map(|row| polarity.sign() * row[i]), frame);
                    let (lowest, direction) = smallest_eigenpair(matrix);
                    let at = j * size[0] + i;
                    response[at] = T::from_f64(matrix[0] + matrix[1] + matrix[2] - ACROSS * lowest);
                    [x[at], y[at], z[at]] = direction.map(T::from_f64);
                }
            });
        });
        if stop() {
            return Ok(None);
        }
        let [x, y, z] = normal.map(|part| Image::new(size, part));
        Ok(Some(Self { response: Image::new(size, response)?, normal: [x?, y?, z?], frame: *frame }))
    }

    /// The responses, in units of the image per squared length.
    pub fn response(&self) -> &Image<T> {
        &self.response
    }

    /// Position in the world and indices along x, y, z are related by this frame.
    pub fn frame(&self) -> &Frame<3> {
        &self.frame
    }

    /// Unit normal in the world of the sheet at a cell, with an arbitrary sign; zero where the Hessian has no direction.
    ///
    /// # Panics
    /// Outside of the grid.
    pub fn normal(&self, cell: usize) -> [f64; 3] {
        self.normal.each_ref().map(|part| part.values()[cell].to_f64())
    }

    /// `fraction` times a percentile of the positive responses; 0 if there are none. Usual: `threshold(0.3, 99)`. Percentiles
    /// interpolate as in [`percentile`](crate::field::image::percentile).
    ///
    /// Cost: at most eight passes over the responses, without a copy of them.
    pub fn threshold(&self, fraction: f64, percent: f64) -> f64 {
        let values = self.response.values();
        let count = values.par_iter().filter(|value| value.to_f64() > 0.0).count();
        let Some(last) = count.checked_sub(1) else { return 0.0 };
        let position = percent.clamp(0.0, 100.0) / 100.0 * last as f64;
        let (below, part) = (position.floor() as usize, position.fract());
        let low = order_statistic(values, below);
        let high = if part > 0.0 { order_statistic(values, below + 1) } else { low };
        fraction * (low + part * (high - low))
    }

    /// Cells on the crests of sheets, in ascending order: those with `r > 0`, `r ≥ least`, and `r` not below the responses at
    /// one step to either side along the normal, by trilinear interpolation. `None` if the caller wants to stop.
    ///
    /// The line along the normal of the world is stepped in indices, by one cell: `d = A⁻¹v/|A⁻¹v|`. Cells on the faces of the
    /// volume lack a neighbour and are left out. The same cells on any number of threads.
    pub fn crests(&self, least: f64, stop: Stop<'_>) -> Option<Vec<usize>> {
        let [columns, rows, slices] = self.response.size();
        let inner = |count: usize| 1..count.saturating_sub(1).max(1);
        let of_slice = |k: usize| {
            let rows = if stop() { 1..1 } else { inner(rows) };
            rows.flat_map(move |j| inner(columns).map(move |i| [i, j, k]))
                .filter(|at| self.is_crest(*at, least))
                .map(|[i, j, k]| (k * self.response.size()[1] + j) * columns + i)
        };
        let cells: Vec<usize> = inner(slices).into_par_iter().flat_map_iter(of_slice).collect();
        (!stop()).then_some(cells)
    }

    /// Whether an inner cell is on a crest.
    fn is_crest(&self, at: [usize; 3], least: f64) -> bool {
        let response = self.response.at(at);
        if !(response > 0.0 && response >= least) {
            return false;
        }
        let size = self.response.size();
        let normal = self.normal((at[2] * size[1] + at[1]) * size[0] + at[0]);
        let line = self.frame.turn_to_index(normal);
        let length = dot(line, line).sqrt();
        let beside = |step: f64| self.interpolated(std::array::from_fn(|c| at[c] as f64 + step * line[c]));
        length > 0.0 && response >= beside(1.0 / length) && response >= beside(-1.0 / length)
    }

    /// Trilinear interpolation of the responses at a point between centres, with at least two cells along every axis.
    fn interpolated(&self, point: [f64; 3]) -> f64 {
        let size = self.response.size();
        let first: [usize; 3] =
            std::array::from_fn(|c| (point[c].max(0.0).floor() as usize).min(size[c] - 2));
        let part: [f64; 3] = std::array::from_fn(|c| point[c] - first[c] as f64);
        let between = |t: f64, [a, b]: [f64; 2]| (1.0 - t) * a + t * b;
        let along_x = |j: usize, k: usize| {
            between(part[0], [0, 1].map(|i| self.response.at([first[0] + i, first[1] + j, first[2] + k])))
        };
        between(part[2], [0, 1].map(|k| between(part[1], [along_x(0, k), along_x(1, k)])))
    }
}

/// The Hessian `A⁻ᵀ H A⁻¹` in the world, of that in indices; entries `[xx, yy, zz, xy, xz, yz]`.
fn in_frame([xx, yy, zz, xy, xz, yz]: [f64; 6], frame: &Frame<3>) -> [f64; 6] {
    let rows = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]].map(|row| frame.gradient_to_world(row));
    let [x, y, z] = [0, 1, 2].map(|c| frame.gradient_to_world(rows.map(|row| row[c])));
    [x[0], y[1], z[2], x[1], x[2], y[2]]
}

/// The positive value with `rank` smaller ones: its bits in order from the highest, since positive numbers have the order of
/// their bits.
fn order_statistic<T: Value>(values: &[T], mut rank: usize) -> f64 {
    let mut bits = 0_u64;
    for shift in [3 * DIGIT, 2 * DIGIT, DIGIT, 0] {
        let known = |bits: u64| bits.checked_shr(shift + DIGIT).unwrap_or(0);
        let mut counts = vec![0_usize; 1 << DIGIT];
        for value in values.iter().map(|value| value.to_f64()).filter(|value| *value > 0.0) {
            if known(value.to_bits()) == known(bits) {
                counts[(value.to_bits() >> shift) as usize & ((1 << DIGIT) - 1)] += 1;
            }
        }
        let larger = |(_, count): &(usize, usize)| {
            let found = rank < *count;
            rank -= if found { 0 } else { *count };
            found
        };
        let digit = counts.into_iter().enumerate().find(larger).map_or(0, |(digit, _)| digit);
        bits |= (digit as u64) << shift;
    }
    f64::from_bits(bits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn order_statistics_are_those_of_the_sorted_positive_values() {
        let values: Vec<f64> = (0..500_u32)
            .map(|i| f64::from(i.wrapping_mul(2_654_435_761) % 1000) - 300.0)
            .chain([1e-300, 1e300, 0.0, 5.0, 5.0, 5.0 + 1e-15])
            .collect();
        let mut sorted: Vec<f64> = values.iter().copied().filter(|value| *value > 0.0).collect();
        sorted.sort_by(f64::total_cmp);
        for (rank, expected) in sorted.iter().enumerate() {
            assert_eq!(order_statistic(&values, rank), *expected, "rank {rank}");
        }
        let single = Image::new([2, 1, 1], values[..2].to_vec()).unwrap().map::<f32>(|value| value + 300.5);
        assert_eq!(order_statistic(single.values(), 0), 0.5);
    }
}
