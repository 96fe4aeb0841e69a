//! Images and volumes as grids of values, x fastest.

use rayon::prelude::*;

use crate::SegmentationError;

/// A number type of images: arithmetic is done in double precision, values are kept in this type.
pub trait Value: Copy + Send + Sync + PartialOrd {
    /// The value in double precision.
    fn to_f64(self) -> f64;
    /// The nearest value of this type.
    fn from_f64(value: f64) -> Self;
}

impl Value for f64 {
    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }

    fn from_f64(value: f64) -> Self {
        value
    }
}

impl Value for f32 {
    #[inline(always)]
    fn to_f64(self) -> f64 {
        f64::from(self)
    }

    fn from_f64(value: f64) -> Self {
        value as f32
    }
}

/// An image (`size[2] == 1`) or a volume: the value of cell `(i, j, k)` is at `(k · size[1] + j) · size[0] + i`.
#[derive(Debug, Clone, PartialEq)]
pub struct Image<T = f64> {
    size: [usize; 3],
    values: Vec<T>,
}

impl<T: Value> Image<T> {
    /// An image from its values, x fastest.
    ///
    /// # Errors
    /// [`SegmentationError::Empty`], [`SegmentationError::Values`], [`SegmentationError::NotFinite`].
    pub fn new(size: [usize; 3], values: Vec<T>) -> Result<Self, SegmentationError> {
        if size.contains(&0) {
            return Err(SegmentationError::Empty { size });
        }
        if size.iter().try_fold(1_usize, |count, size| count.checked_mul(*size)) != Some(values.len()) {
            return Err(SegmentationError::Values { size, count: values.len() });
        }
        match values.iter().position(|value| !value.to_f64().is_finite()) {
            Some(index) => Err(SegmentationError::NotFinite { index, value: values[index].to_f64() }),
            None => Ok(Self { size, values }),
        }
    }

    /// Number of cells along x, y, z; 1 along z for an image in the plane.
    pub fn size(&self) -> [usize; 3] {
        self.size
    }

    /// Whether the image has one layer.
    pub fn is_planar(&self) -> bool {
        self.size[2] == 1
    }

    /// The values, x fastest.
    pub fn values(&self) -> &[T] {
        &self.values
    }

    /// The values, x fastest, without the image.
    pub(crate) fn into_values(self) -> Vec<T> {
        self.values
    }

    /// The value of a cell.
    ///
    /// # Panics
    /// Outside of the grid.
    pub fn at(&self, [i, j, k]: [usize; 3]) -> f64 {
        self.values[(k * self.size[1] + j) * self.size[0] + i].to_f64()
    }

    /// The image with `change` applied to every value.
    pub fn map<U: Value>(&self, change: impl Fn(f64) -> f64 + Sync) -> Image<U> {
        let values = self.values.par_iter().map(|value| U::from_f64(change(value.to_f64()))).collect();
        Image { size: self.size, values }
    }

    /// `clamp(f/level, 0, 1)`, the saturated image of the threshold energy; `level > 0`.
    pub fn saturate(&self, level: f64) -> Self {
        self.map(|value| (value / level).clamp(0.0, 1.0))
    }

    /// A value for every row of cells along x, made in parallel: `fill(j, k, row)`. The same bits on any number of threads.
    pub(crate) fn from_rows(size: [usize; 3], fill: impl Fn(usize, usize, &mut [T]) + Sync) -> Self {
        let mut values = vec![T::from_f64(0.0); size.iter().product()];
        let rows = values.par_chunks_mut(size[0]).enumerate();
        rows.for_each(|(row, values)| fill(row % size[1], row / size[1], values));
        Self { size, values }
    }

    /// Sets the value of a cell by its position, x fastest.
    pub(crate) fn set(&mut self, cell: usize, value: f64) {
        self.values[cell] = T::from_f64(value);
    }

    /// The row of cells along x at `(j, k)`.
    pub(crate) fn row(&self, j: usize, k: usize) -> &[T] {
        let start = (k * self.size[1] + j) * self.size[0];
        &self.values[start..start + self.size[0]]
    }

    /// Mean of the values.
    pub fn mean(&self) -> f64 {
        self.values.iter().map(|value| value.to_f64()).sum::<f64>() / self.values.len() as f64
    }

    /// Mean square deviation of the values from their mean.
    pub fn variance(&self) -> f64 {
        let mean = self.mean();
        let squares = self.values.iter().map(|value| (value.to_f64() - mean).powi(2));
        squares.sum::<f64>() / self.values.len() as f64
    }

    /// Percentile of the values: see [`percentile`].
    pub fn percentile(&self, percent: f64) -> f64 {
        percentile_of(self.values.iter().map(|value| value.to_f64()), percent).unwrap_or(0.0)
    }
}

/// Value below which `percent` of the values lie, with linear interpolation between the two nearest order statistics:
/// position `percent/100 · (n − 1)`. `None` without values. Expected cost `O(n)`.
pub fn percentile(values: Vec<f64>, percent: f64) -> Option<f64> {
    percentile_of(values.iter().copied(), percent)
}

/// Bits of a number by which values are counted at once: of the first ones, sign, exponent and four digits.
const COUNTED: u32 = 16;

/// Number of values up to which they are ordered at once.
const FEW: usize = 1 << 13;

/// [`percentile`], by counts of values of the same leading bits: only those around the percentile are ordered.
fn percentile_of(values: impl ExactSizeIterator<Item = f64> + Clone, percent: f64) -> Option<f64> {
    let position = percent.clamp(0.0, 100.0) / 100.0 * values.len().checked_sub(1)? as f64;
    let (below, part) = (position.floor() as usize, position.fract());
    let all = Near { below, beyond: f64::INFINITY, values: Vec::new() };
    let mut near = match values.len() <= FEW {
        true => Near { values: values.collect(), ..all },
        false => all.narrowed(values, u64::BITS - COUNTED)?,
    };
    for shift in [2 * COUNTED, COUNTED, 0] {
        if near.values.len() <= FEW || near.values.iter().all(|value| *value == near.values[0]) {
            break;
        }
        let values = std::mem::take(&mut near.values);
        near = near.narrowed(values.iter().copied(), shift)?;
    }
    let Near { below, beyond, mut values } = near;
    let (_, low, above) = values.select_nth_unstable_by(below, f64::total_cmp);
    let low = *low;
    let high = if part > 0.0 { above.iter().copied().fold(beyond, f64::min) } else { low };
    Some(low + part * (high - low))
}

/// Values around a percentile.
struct Near {
    /// Number of them below it.
    below: usize,
    /// The smallest of the values that are larger than these, as far as it matters.
    beyond: f64,
    values: Vec<f64>,
}

impl Near {
    /// Those of `values`, which agree in all bits before the ones counted, that agree in these with the value at the percentile.
    fn narrowed(self, values: impl Iterator<Item = f64> + Clone, shift: u32) -> Option<Self> {
        let counted = |value: f64| (order(value) >> shift) as usize & ((1 << COUNTED) - 1);
        let mut counts = vec![0_u32; 1 << COUNTED];
        values.clone().for_each(|value| counts[counted(value)] += 1);
        let mut before = 0;
        let found = counts.iter().position(|&count| {
            before += count as usize;
            before > self.below
        })?;
        let below = self.below - (before - counts[found] as usize);
        let is_last = below + 1 == counts[found] as usize;
        let next = counts[found + 1..].iter().position(|&count| count > 0).filter(|_| is_last);
        let beyond = next.map(|after| {
            let after = values.clone().filter(|value| counted(*value) == found + 1 + after);
            after.fold(f64::INFINITY, f64::min)
        });
        let values = values.filter(|value| counted(*value) == found).collect();
        Some(Self { below, beyond: beyond.unwrap_or(self.beyond), values })
    }
}

/// A number that is in the order of [`f64::total_cmp`].
fn order(value: f64) -> u64 {
    let bits = value.to_bits();
    if value.is_sign_negative() { !bits } else { bits | 1 << 63 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_interpolate_between_order_statistics() {
        let values = vec![7.0, 1.0, 4.0, 2.0];
        for (percent, expected) in [(0.0, 1.0), (50.0, 3.0), (100.0, 7.0), (90.0, 6.1)] {
            let found = percentile(values.clone(), percent).unwrap();
            assert!((found - expected).abs() < 1e-12, "{found} for {expected} at {percent} %");
        }
        assert_eq!(percentile(Vec::new(), 50.0), None);
        assert_eq!(percentile(vec![3.0], 99.0), Some(3.0));
    }

    #[test]
    fn percentiles_of_many_values_are_those_of_sorted_ones() {
        type Draw = fn(usize) -> f64;
        let draws: [Draw; 4] = [
            |k| (k as f64 * 0.7).sin() * ((k % 61) as f64 - 30.0).exp2(),
            |k| ((k * 7919) % 256) as f64,
            |k| if k.is_multiple_of(3) { 0.0 } else { -0.0 },
            |k| if k < 9000 { 1.0 } else { 1e9 },
        ];
        for draw in draws {
            let values: Vec<f64> = (0..20_000).map(draw).collect();
            let mut sorted = values.clone();
            sorted.sort_by(f64::total_cmp);
            for percent in [0.0, 0.003, 1.0, 44.998, 45.0, 50.0, 99.0, 99.5, 100.0] {
                let position = percent / 100.0 * (values.len() - 1) as f64;
                let (below, part) = (position.floor() as usize, position.fract());
                let (low, high) = (sorted[below], sorted[(below + 1).min(values.len() - 1)]);
                let expected = low + part * (if part > 0.0 { high } else { low } - low);
                assert_eq!(percentile(values.clone(), percent), Some(expected), "{percent} %");
            }
        }
    }

    #[test]
    fn images_are_checked() {
        assert_eq!(
            Image::new([2, 2, 1], vec![0.0; 3]),
            Err(SegmentationError::Values { size: [2, 2, 1], count: 3 })
        );
        assert_eq!(Image::<f64>::new([2, 0, 1], vec![]), Err(SegmentationError::Empty { size: [2, 0, 1] }));
        assert!(matches!(
            Image::new([1, 2, 1], vec![0.0, f64::NAN]),
            Err(SegmentationError::NotFinite { index: 1, .. })
        ));
        let image = Image::new([2, 3, 1], vec![0.0_f32, 1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
        assert_eq!((image.at([1, 2, 0]), image.mean()), (5.0, 2.5));
        assert!((image.variance() - 35.0 / 12.0).abs() < 1e-12);
    }
}
