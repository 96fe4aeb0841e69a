//! Thin-plate splines: the maps of plane or space that move landmarks to given places and bend least.
//!
//! ```text
//! f(x) = a₀ + A x + Σ w_i U(|x − x_i|),   U(r) = r² log r² (d = 2),  −r (d = 3)
//! [K P; Pᵀ 0] [w; a] = [Y; 0],   K_ij = U(|x_i − x_j|),  P = [1 X]
//! B = Q₂ (Q₂ᵀ K Q₂)⁻¹ Q₂ᵀ,   Q₂: orthonormal, Q₂ᵀP = 0;   bending energy tr(YᵀBY)
//! ```
//!
//! With these signs `Q₂ᵀKQ₂` is positive definite. Landmarks are centred and scaled to unit size first, since the condition grows with
//! the unit of length; results are those of the landmarks as given. Other programs take `r² log r` and `r`: half of the energy, or
//! minus it.
//!
//! [`ThinPlate`] — the system of the reference landmarks; [`warp`] — its maps; [`lattice`] — grids to deform.
//!
//! Source: Bookstein, *Principal warps*, IEEE TPAMI 1989.

pub mod error;
pub mod lattice;
pub mod warp;

use crate::fit::{Fit, Scaling, transform};
use crate::unit_size::{self, Placed};
use error::{COINCIDENT, FLAT, ThinPlateError};
use shapelex_numeric::dense::{Definite, Matrix, multiply, svd, symmetric_eigen, transpose_multiply};

/// Points (one per row) without their position and size, and these.
fn unit(points: &Matrix) -> (Matrix, Placed) {
    let (count, dimension) = points.shape();
    let (moved, placed) = unit_size::unit(points.as_slice(), dimension);
    (Matrix::from_vec(count, dimension, moved), placed)
}

/// `U` of a squared distance.
fn kernel(dimension: usize, squared: f64) -> f64 {
    match dimension {
        _ if squared == 0.0 => 0.0,
        2 => squared * squared.ln(),
        _ => -squared.sqrt(),
    }
}

/// `g` of a squared distance, where `∇U = g (x − x_i)`; zero at the landmark itself.
fn slope(dimension: usize, squared: f64) -> f64 {
    match dimension {
        _ if squared == 0.0 => 0.0,
        2 => 2.0 * (squared.ln() + 1.0),
        _ => -squared.sqrt().recip(),
    }
}

fn squared_distance(points: &Matrix, i: usize, j: usize) -> f64 {
    points.column_iter().map(|column| (column[i] - column[j]).powi(2)).sum()
}

/// The first pair of landmarks at one place, if any.
fn coincident(unit: &Matrix) -> Option<(usize, usize)> {
    let same = |i: usize, j: usize| squared_distance(unit, i, j) < COINCIDENT * COINCIDENT;
    (0..unit.nrows()).find_map(|j| (0..j).find(|&i| same(i, j)).map(|i| (i, j)))
}

/// `points` moved, turned and scaled onto `reference`, by least squares; without an extent they are only moved.
pub fn superimposed(points: &Matrix, reference: &Matrix) -> Matrix {
    let d = points.ncols();
    let ((x, _), (mean, onto)) = (unit(points), unit(reference));
    let fit = Fit { dimension: d, rotates: true, scaling: Scaling::Full };
    let placed = transform(&fit.matrix(x.as_slice(), mean.as_slice()), x.as_slice());
    let finite = placed.iter().all(|value| value.is_finite());
    let placed = if finite { Matrix::from_vec(points.nrows(), d, placed) } else { x };
    Matrix::from_fn(points.nrows(), d, |k, c| onto.centre[c] + onto.size * placed[(k, c)])
}

/// Partial warps: how a target bends in each of the principal warps.
#[derive(Debug, Clone)]
pub struct PartialWarps {
    /// Positive eigenvalues of `B`, ascending: the first bend at the largest scale.
    pub eigenvalues: Vec<f64>,
    /// Principal warps, one per column, `p × (p − d − 1)`; the largest entry of each is positive.
    pub warps: Matrix,
}

/// The system of reference landmarks in the plane or in space.
#[derive(Debug)]
pub struct ThinPlate {
    placed: Placed,
    /// Landmarks at unit size, `p × d`.
    points: Matrix,
    /// `Qᵀ`, `p × p`: the first `d + 1` rows span the affine functions.
    rotation: Matrix,
    /// `R` of `P = QR`.
    affine: Matrix,
    /// `Q₁ᵀKQ₂` and `Q₂ᵀKQ₂`.
    mixed: Matrix,
    energy: Matrix,
    /// Factor of `Q₂ᵀKQ₂ + λI`; none where an affine map is all there is.
    factor: Option<Definite>,
}

impl ThinPlate {
    /// Prepares `p` landmarks (`p × d`). `smoothing`: λ of `K + λI` at unit size; with 0, maps meet their targets exactly.
    /// Cost: `p³/3`, and some `p²`.
    ///
    /// # Errors
    /// Too few landmarks; two at one place; all on a line or plane.
    pub fn new(points: &Matrix, smoothing: f64) -> Result<Self, ThinPlateError> {
        let (p, d) = points.shape();
        if p < d + 1 {
            return Err(ThinPlateError::TooFew { found: p, needed: d + 1 });
        }
        let (unit, placed) = unit(points);
        let extents = svd(unit.clone(), false, false).map(|found| found.singular_values);
        let extent = extents.map_or(0.0, |found| if found[0] > 0.0 { found[d - 1] / found[0] } else { 0.0 });
        if !(extent >= FLAT) {
            return Err(ThinPlateError::Flat { dimension: d, extent });
        }
        if let Some((first, second)) = coincident(&unit) {
            return Err(ThinPlateError::Coincident { first, second });
        }
        let qr = Matrix::from_fn(p, d + 1, |i, j| if j == 0 { 1.0 } else { unit[(i, j - 1)] }).qr();
        let mut turned = Matrix::from_fn(p, p, |i, j| kernel(d, squared_distance(&unit, i, j)));
        for _ in 0..2 {
            qr.q_tr_mul(&mut turned);
            turned.transpose_mut();
        }
        let (k, n) = (d + 1, p - d - 1);
        let mut rotation = Matrix::identity(p, p);
        qr.q_tr_mul(&mut rotation);
        let energy = turned.view((k, k), (n, n)).into_owned();
        let mut ridged = energy.clone();
        (0..n).for_each(|i| ridged[(i, i)] += smoothing);
        let factor = if n > 0 { Some(Definite::new(&ridged)?) } else { None };
        let mixed = turned.view((0, k), (k, n)).into_owned();
        Ok(Self { placed, points: unit, rotation, affine: qr.r(), mixed, energy, factor })
    }

    /// `d`.
    pub fn dimension(&self) -> usize {
        self.points.ncols()
    }

    /// Number of landmarks.
    pub fn len(&self) -> usize {
        self.points.nrows()
    }

    /// Whether there are no landmarks, which is never so.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Factor of energies at unit size for those of the landmarks as given.
    fn unit_energy(&self) -> f64 {
        self.placed.size.powi(self.dimension() as i32 - 4)
    }

    /// `Q₂ᵀ`.
    fn complement(&self) -> Matrix {
        self.rotation.rows(self.dimension() + 1, self.energy.nrows()).into_owned()
    }

    /// The bending energy matrix `B`, `p × p`, without smoothing. Cost: `2p³`.
    pub fn bending_matrix(&self) -> Matrix {
        let complement = self.complement();
        let Some(factor) = &self.factor else { return Matrix::zeros(self.len(), self.len()) };
        transpose_multiply(&complement, &factor.solve(&complement)) * self.unit_energy()
    }

    /// Principal warps: eigenvectors of `B` with their eigenvalues. Cost: some `10p³`.
    pub fn partial_warps(&self) -> PartialWarps {
        let n = self.energy.nrows();
        if n == 0 {
            return PartialWarps { eigenvalues: Vec::new(), warps: Matrix::zeros(self.len(), 0) };
        }
        let pairs = symmetric_eigen(&self.energy);
        let mut order: Vec<usize> = (0..n).collect();
        // Large eigenvalues of the kernel are small ones of its inverse.
        order.sort_by(|&a, &b| pairs.eigenvalues[b].total_cmp(&pairs.eigenvalues[a]));
        let sorted = Matrix::from_fn(n, n, |i, j| pairs.eigenvectors[(i, order[j])]);
        let mut warps = transpose_multiply(&self.complement(), &sorted);
        for mut warp in warps.column_iter_mut() {
            if warp[warp.icamax()] < 0.0 {
                warp.neg_mut();
            }
        }
        let unit = self.unit_energy();
        let eigenvalues = order.iter().map(|&k| unit / pairs.eigenvalues[k]).collect();
        PartialWarps { eigenvalues, warps }
    }

    /// Coefficients at unit size of the map to targets at unit size: `w`, and the affine part with its constant first.
    fn coefficients(&self, target: &Matrix) -> [Matrix; 2] {
        let k = self.dimension() + 1;
        let turned = multiply(&self.rotation, target);
        let (mut top, bottom) =
            (turned.rows(0, k).into_owned(), turned.rows(k, self.energy.nrows()).into_owned());
        let weights = match &self.factor {
            None => Matrix::zeros(self.len(), self.dimension()),
            Some(factor) => {
                let reduced = factor.solve(&bottom);
                top -= multiply(&self.mixed, &reduced);
                transpose_multiply(&self.complement(), &reduced)
            }
        };
        // Landmarks that are not flat have independent columns.
        let affine = self.affine.solve_upper_triangular(&top).unwrap_or(top);
        [weights, affine]
    }
}
