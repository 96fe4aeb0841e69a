//! Shapes of a model at some places.

use crate::metric::dot;
use shapelex_numeric::dense::Matrix;

/// Shapes of a model at some places: `m_i + D_i z`, and the variance of the residual there.
#[derive(Debug, Clone)]
pub struct AtPlaces {
    /// `d`.
    pub(crate) dimension: usize,
    /// `m`: `d·M` coordinate-major numbers.
    pub(super) mean: Vec<f64>,
    /// `Dᵀ`, `J × d·M`: a column for each coordinate of each place.
    pub(crate) modes: Matrix,
    /// Variance of the residual of each place, for each coordinate.
    pub(super) noise: Vec<f64>,
}

impl AtPlaces {
    /// From the points of the mean and of each mode (`d·M` coordinate-major numbers each).
    pub(crate) fn new(dimension: usize, mean: Vec<f64>, modes: &[Vec<f64>], noise: Vec<f64>) -> Self {
        let modes = Matrix::from_fn(modes.len(), mean.len(), |j, i| modes[j][i]);
        Self { dimension, mean, modes, noise }
    }

    /// Number of places, `M`.
    pub fn count(&self) -> usize {
        self.noise.len()
    }

    /// Number of scores, `J`.
    pub fn scores(&self) -> usize {
        self.modes.nrows()
    }

    /// `Dᵀ` of a coordinate of a place: `J` numbers.
    pub(super) fn row(&self, place: usize, coordinate: usize) -> &[f64] {
        let (j, column) = (self.scores(), coordinate * self.count() + place);
        &self.modes.as_slice()[column * j..(column + 1) * j]
    }

    /// Points of the shape with the scores `z`, coordinate-major. Cost `O(J d M)`.
    pub fn points(&self, z: &[f64]) -> Vec<f64> {
        let columns = self.modes.as_slice().chunks_exact(self.scores().max(1));
        match z.is_empty() {
            true => self.mean.clone(),
            false => self.mean.iter().zip(columns).map(|(m, column)| m + dot(column, z)).collect(),
        }
    }

    /// Some of the places, in this order.
    #[must_use]
    pub fn select(&self, places: &[usize]) -> Self {
        let count = self.count();
        let columns: Vec<usize> =
            (0..self.dimension).flat_map(|c| places.iter().map(move |&i| c * count + i)).collect();
        Self {
            dimension: self.dimension,
            mean: columns.iter().map(|&i| self.mean[i]).collect(),
            modes: Matrix::from_fn(self.scores(), columns.len(), |j, i| self.modes[(j, columns[i])]),
            noise: places.iter().map(|&i| self.noise[i]).collect(),
        }
    }

    /// These places and further ones.
    #[must_use]
    pub(super) fn and(self, other: &Self) -> Self {
        let (n, m) = (self.count(), other.count());
        let total = n + m;
        let from = |i: usize| (i / total, i % total);
        let mean = (0..self.dimension * total).map(|i| match from(i) {
            (c, place) if place < n => self.mean[c * n + place],
            (c, place) => other.mean[c * m + place - n],
        });
        let mean = mean.collect();
        let modes = Matrix::from_fn(self.scores(), self.dimension * total, |j, i| match from(i) {
            (c, place) if place < n => self.modes[(j, c * n + place)],
            (c, place) => other.modes[(j, c * m + place - n)],
        });
        let noise = self.noise.iter().chain(&other.noise).copied().collect();
        Self { dimension: self.dimension, mean, modes, noise }
    }
}

/// Some of the points of a shape, `d·M` coordinate-major numbers.
pub(crate) fn selected(points: &[f64], dimension: usize, places: &[usize]) -> Vec<f64> {
    let count = points.len() / dimension;
    (0..dimension).flat_map(|c| places.iter().map(move |&i| points[c * count + i])).collect()
}
