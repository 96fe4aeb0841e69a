//! Unknowns of a stage: all free points, an affine map of them, or their distances from the centre.
//!
//! ```text
//! affine   p = U q,   U = orthonormal columns of [p₀ | 1], times √n,   q: (d + 1) × d
//! radial   p_i = p₀_i + h_i d_i,   d_i = (p₀_i − c̄)/|p₀_i − c̄|,   h_i > −|p₀_i − c̄|
//! ```

use shapelex_numeric::dense::{Matrix, multiply, svd, transpose_multiply};

/// Free part of a shape in a stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Free {
    /// An affine map of the shape at the start of the stage.
    Affine,
    /// The distances of the points from the centre: for star-shaped objects.
    Radial,
    /// All points.
    #[default]
    All,
}

/// Relative singular value below which a shape has no extent in a direction.
const FLAT: f64 = 1e-9;

/// Unknowns `x` and the free points that they give.
#[derive(Debug, Clone)]
pub struct Reparametrisation<const D: usize> {
    start: Vec<[f64; D]>,
    kind: Kind<D>,
}

#[derive(Debug, Clone)]
enum Kind<const D: usize> {
    /// `U`, by rows.
    Affine(Vec<Vec<f64>>),
    /// Directions and distances from the centre.
    Radial(Vec<[f64; D]>, Vec<f64>),
    All,
}

impl<const D: usize> Reparametrisation<D> {
    /// The unknowns of a stage that starts with `rows`. `centre`: weights of the rows in the centre. `None` for an affine
    /// stage of a shape that is flat.
    pub fn new(free: Free, rows: &[[f64; D]], centre: &[f64]) -> Option<Self> {
        let kind = match free {
            Free::All => Kind::All,
            Free::Radial => {
                let weighted = |c: usize| centre.iter().zip(rows).map(|(w, p)| w * p[c]).sum::<f64>();
                let middle: [f64; D] = std::array::from_fn(weighted);
                let (directions, distances) = rows.iter().map(|p| away(p, &middle)).unzip();
                Kind::Radial(directions, distances)
            }
            Free::Affine => Kind::Affine(orthonormal(rows)?),
        };
        Some(Self { start: rows.to_vec(), kind })
    }

    /// The unknowns at the start.
    pub fn start(&self) -> Vec<f64> {
        match &self.kind {
            Kind::All => self.start.concat(),
            Kind::Radial(..) => vec![0.0; self.start.len()],
            Kind::Affine(basis) => {
                let n = self.start.len() as f64;
                self.pull_affine(basis, &self.start).iter().map(|q| q / n).collect()
            }
        }
    }

    /// The free points for unknowns; `None` if a point has crossed the centre.
    pub fn rows(&self, x: &[f64]) -> Option<Vec<[f64; D]>> {
        match &self.kind {
            Kind::All | Kind::Affine(_) => Some(self.moved(x)),
            Kind::Radial(directions, distances) => {
                let crossed = x.iter().zip(distances).any(|(h, distance)| *distance > 0.0 && *h <= -distance);
                let moved = self.start.iter().zip(directions).zip(x);
                let rows = moved.map(|((p, d), h)| std::array::from_fn(|c| p[c] + h * d[c]));
                (!crossed).then(|| rows.collect())
            }
        }
    }

    /// The gradient in the unknowns, of that in the free points.
    pub fn pull(&self, gradient: &[[f64; D]]) -> Vec<f64> {
        match &self.kind {
            Kind::All => gradient.concat(),
            Kind::Radial(directions, _) => {
                let along = |(d, g): (&[f64; D], &[f64; D])| (0..D).map(|c| d[c] * g[c]).sum();
                directions.iter().zip(gradient).map(along).collect()
            }
            Kind::Affine(basis) => self.pull_affine(basis, gradient),
        }
    }

    /// Second derivatives in the unknowns, `JᵀHJ` for those in the free points and `J = ∂p/∂x`.
    pub fn pull_twice(&self, curvature: &Matrix) -> Matrix {
        let unit = |unknowns: usize, column: usize| -> Vec<f64> {
            (0..unknowns).map(|row| f64::from(u8::from(row == column))).collect()
        };
        let columns: Vec<f64> = match &self.kind {
            Kind::All => return curvature.clone(),
            Kind::Affine(_) => {
                let unknowns = (D + 1) * D;
                (0..unknowns).flat_map(|column| self.moved(&unit(unknowns, column)).concat()).collect()
            }
            Kind::Radial(directions, _) => {
                let n = directions.len();
                let column =
                    |k: usize| unit(n, k).into_iter().zip(directions).flat_map(|(u, d)| d.map(|d| u * d));
                (0..n).flat_map(column).collect()
            }
        };
        let rows = curvature.nrows();
        let jacobian = Matrix::from_column_slice(rows, columns.len() / rows, &columns);
        transpose_multiply(&jacobian, &multiply(curvature, &jacobian))
    }

    /// Number of unknowns that move one point.
    pub fn group(&self) -> usize {
        if matches!(self.kind, Kind::Radial(..)) { 1 } else { D }
    }

    /// Largest displacement of a free point, in cells, for a change of the unknowns.
    pub fn displacement(&self, direction: &[f64]) -> f64 {
        let length = |v: [f64; D]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        match &self.kind {
            Kind::Radial(..) => direction.iter().fold(0.0, |most, h| h.abs().max(most)),
            Kind::All | Kind::Affine(_) => self.moved(direction).into_iter().map(length).fold(0.0, f64::max),
        }
    }

    /// The linear map of all or affine unknowns to points.
    fn moved(&self, x: &[f64]) -> Vec<[f64; D]> {
        match &self.kind {
            Kind::Affine(basis) => {
                let one = |row: &Vec<f64>| {
                    std::array::from_fn(|c| row.iter().enumerate().map(|(m, u)| u * x[m * D + c]).sum())
                };
                basis.iter().map(one).collect()
            }
            _ => x.chunks_exact(D).map(|row| std::array::from_fn(|c| row[c])).collect(),
        }
    }

    /// `Uᵀ g`.
    fn pull_affine(&self, basis: &[Vec<f64>], gradient: &[[f64; D]]) -> Vec<f64> {
        let mut pulled = vec![0.0; (D + 1) * D];
        for (row, slope) in basis.iter().zip(gradient) {
            for (m, u) in row.iter().enumerate() {
                (0..D).for_each(|c| pulled[m * D + c] += u * slope[c]);
            }
        }
        pulled
    }
}

/// Unit vector from `middle` to `point`, and the distance; zero if they coincide.
fn away<const D: usize>(point: &[f64; D], middle: &[f64; D]) -> ([f64; D], f64) {
    let apart: [f64; D] = std::array::from_fn(|c| point[c] - middle[c]);
    let distance = apart.iter().map(|x| x * x).sum::<f64>().sqrt();
    if distance > 0.0 { (apart.map(|x| x / distance), distance) } else { ([0.0; D], 0.0) }
}

/// Rows of the orthonormal columns of `[p₀ | 1]`, times `√n`; the last column is 1.
fn orthonormal<const D: usize>(rows: &[[f64; D]]) -> Option<Vec<Vec<f64>>> {
    let n = rows.len();
    let mean: [f64; D] = std::array::from_fn(|c| rows.iter().map(|p| p[c]).sum::<f64>() / n as f64);
    let decomposed = svd(Matrix::from_fn(n, D, |i, c| rows[i][c] - mean[c]), true, false)?;
    let values = &decomposed.singular_values;
    if !(values.min() > FLAT * values.max()) {
        return None;
    }
    let columns = decomposed.u?;
    let scale = (n as f64).sqrt();
    Some((0..n).map(|i| (0..D).map(|m| scale * columns[(i, m)]).chain([1.0]).collect()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROWS: [[f64; 2]; 5] = [[4.0, 1.0], [2.0, 5.0], [-1.0, 4.0], [-2.0, 0.5], [1.5, -2.0]];

    #[test]
    fn every_stage_starts_at_its_shape() {
        for free in [Free::Affine, Free::Radial, Free::All] {
            let map = Reparametrisation::new(free, &ROWS, &[0.2; 5]).unwrap();
            let rows = map.rows(&map.start()).unwrap();
            for (found, expected) in rows.concat().iter().zip(ROWS.concat()) {
                assert!((found - expected).abs() < 1e-12, "{free:?}: {found} for {expected}");
            }
        }
        assert!(Reparametrisation::new(Free::Affine, &[[0.0, 0.0], [1.0, 2.0], [2.0, 4.0]], &[]).is_none());
    }

    /// `⟨g, dp⟩ = ⟨pull(g), dx⟩` for the change `dp` of the points by a change `dx` of the unknowns.
    #[test]
    fn gradients_are_pulled_back_by_the_transpose() {
        let gradient: Vec<[f64; 2]> = (0..5).map(|i| [(i as f64).sin(), 1.0 - i as f64]).collect();
        for free in [Free::Affine, Free::Radial, Free::All] {
            let map = Reparametrisation::new(free, &ROWS, &[0.2; 5]).unwrap();
            let start = map.start();
            let change: Vec<f64> = (0..start.len()).map(|i| 0.1 * (2.0 * i as f64).cos()).collect();
            let moved: Vec<f64> = start.iter().zip(&change).map(|(x, d)| x + d).collect();
            let rows = map.rows(&moved).unwrap().concat();
            let work = |(after, before): (&f64, f64)| after - before;
            let apart: Vec<f64> = rows.iter().zip(ROWS.concat()).map(work).collect();
            let along: f64 = apart.iter().zip(gradient.concat()).map(|(d, g)| d * g).sum();
            let pulled: f64 = change.iter().zip(map.pull(&gradient)).map(|(d, g)| d * g).sum();
            assert!((along - pulled).abs() < 1e-12, "{free:?}: {along} for {pulled}");
            let largest = apart.chunks(2).map(|d| d[0].hypot(d[1])).fold(0.0, f64::max);
            assert!((map.displacement(&change) - largest).abs() < 1e-12, "{free:?}");
        }
    }

    #[test]
    fn points_do_not_cross_the_centre() {
        let map = Reparametrisation::new(Free::Radial, &ROWS, &[0.2; 5]).unwrap();
        assert!(map.rows(&[-10.0, 0.0, 0.0, 0.0, 0.0]).is_none());
    }
}
