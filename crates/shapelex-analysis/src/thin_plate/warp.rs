//! Maps of thin-plate splines.

use super::{ThinPlate, kernel, slope, unit};
use crate::unit_size::Placed;
use shapelex_numeric::dense::{Matrix, multiply};
use shapelex_numeric::parallel;

/// Points that one task maps.
const POINTS: usize = 256;

/// The map that takes the reference landmarks to a target, and bends least.
#[derive(Debug)]
pub struct Warp<'a> {
    plate: &'a ThinPlate,
    target: Placed,
    /// `w` at unit sizes, `p × d`.
    weights: Matrix,
    /// Affine part at unit sizes, the constant first, `(d + 1) × d`.
    affine: Matrix,
}

impl ThinPlate {
    /// The map to `target` (`p × d`). Cost: some `p²`.
    pub fn warp(&self, target: &Matrix) -> Warp<'_> {
        let (unit, target) = unit(target);
        let [weights, affine] = self.coefficients(&unit);
        Warp { plate: self, target, weights, affine }
    }
}

impl Warp<'_> {
    /// A point in the frame of the reference.
    fn unit(&self, point: &[f64]) -> [f64; 3] {
        let placed = &self.plate.placed;
        let mut unit = [0.0; 3];
        for (c, value) in unit.iter_mut().enumerate().take(point.len()) {
            *value = (point[c] - placed.centre[c]) / placed.size;
        }
        unit
    }

    /// Vector from landmark `k` to a point, and its squared length.
    fn offset_from(&self, k: usize, point: &[f64; 3]) -> ([f64; 3], f64) {
        let d = self.plate.dimension();
        let mut vector = [0.0; 3];
        for (c, value) in vector.iter_mut().enumerate().take(d) {
            *value = point[c] - self.plate.points[(k, c)];
        }
        (vector, vector.iter().map(|x| x * x).sum())
    }

    /// The image of a point of `d` coordinates; further entries are zero.
    pub fn at(&self, point: &[f64]) -> [f64; 3] {
        let (d, unit) = (self.plate.dimension(), self.unit(point));
        let mut image = [0.0; 3];
        for (c, value) in image.iter_mut().enumerate().take(d) {
            *value = self.affine[(0, c)] + (0..d).map(|e| unit[e] * self.affine[(e + 1, c)]).sum::<f64>();
        }
        for k in 0..self.plate.len() {
            let bent = kernel(d, self.offset_from(k, &unit).1);
            (0..d).for_each(|c| image[c] += self.weights[(k, c)] * bent);
        }
        (0..d).for_each(|c| image[c] = self.target.centre[c] + self.target.size * image[c]);
        image
    }

    /// Determinant of the derivative at a point: the factor of areas or volumes; not positive where the map folds.
    pub fn determinant(&self, point: &[f64]) -> f64 {
        let (d, unit) = (self.plate.dimension(), self.unit(point));
        let mut jacobian = Matrix::from_fn(d, d, |e, c| self.affine[(e + 1, c)]);
        for k in 0..self.plate.len() {
            let (vector, squared) = self.offset_from(k, &unit);
            let steep = slope(d, squared);
            for c in 0..d {
                (0..d).for_each(|e| jacobian[(e, c)] += self.weights[(k, c)] * steep * vector[e]);
            }
        }
        jacobian.determinant() * (self.target.size / self.plate.placed.size).powi(d as i32)
    }

    /// Images of points, one per row. Cost: `p` kernels per point, in parallel.
    pub fn warped(&self, points: &Matrix) -> Matrix {
        let (n, d) = points.shape();
        let images = self.of_each(points, &|point| self.at(point));
        Matrix::from_fn(n, d, |k, c| images[k][c])
    }

    /// Determinants at points, one per row.
    pub fn determinants(&self, points: &Matrix) -> Vec<f64> {
        self.of_each(points, &|point| self.determinant(point))
    }

    fn of_each<T: Send>(&self, points: &Matrix, of: &(dyn Fn(&[f64]) -> T + Sync)) -> Vec<T> {
        let n = points.nrows();
        let row = |k: usize| -> Vec<f64> { points.row(k).iter().copied().collect() };
        let chunk = |i: usize| (POINTS * i..n.min(POINTS * (i + 1))).map(|k| of(&row(k))).collect::<Vec<T>>();
        parallel::map(n.div_ceil(POINTS), &chunk).into_iter().flatten().collect()
    }

    /// Bending energy `tr(YᵀBY)`; with smoothing, that of the map, which is smaller.
    pub fn bending_energy(&self) -> f64 {
        let plate = self.plate;
        let reduced = multiply(&plate.complement(), &self.weights);
        let energy = reduced.dot(&multiply(&plate.energy, &reduced));
        // Targets are at unit size, too.
        energy.max(0.0) * plate.unit_energy() * self.target.size.powi(2)
    }

    /// Affine part for coordinates as given, `(d + 1) × d`: the constant, then a row for each coordinate.
    pub fn affine(&self) -> Matrix {
        let (plate, d) = (self.plate, self.plate.dimension());
        let mut affine = Matrix::zeros(d + 1, d);
        let ratio = self.target.size / plate.placed.size;
        for c in 0..d {
            (0..d).for_each(|e| affine[(e + 1, c)] = ratio * self.affine[(e + 1, c)]);
            let moved: f64 = (0..d).map(|e| plate.placed.centre[e] * affine[(e + 1, c)]).sum();
            affine[(0, c)] = self.target.centre[c]
                + self.target.size * (self.affine[(0, c)] + self.unit_constant(c))
                - moved;
        }
        affine
    }

    /// Gain of the constant where the kernel is that of distances as given: `r²` of weights that annihilate affine functions is a
    /// constant.
    fn unit_constant(&self, c: usize) -> f64 {
        if self.plate.dimension() == 3 {
            return 0.0;
        }
        let square = |k: usize| self.plate.points.row(k).norm_squared();
        let squares: f64 = (0..self.plate.len()).map(|k| self.weights[(k, c)] * square(k)).sum();
        -2.0 * self.plate.placed.size.ln() * squares
    }
}
