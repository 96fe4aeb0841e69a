//! Sufficient statistics of codes for dictionary learning.
//!
//! ```text
//! X_k ≈ Σ_j D_j B_jkᵀ     A_jl = Σ_k w_k B_jkᵀ B_lk     F_j = Σ_k w_k X_k B_jk     E = Σ_k w_k ‖X_k‖²
//! Σ_k w_k ½‖X_k − Σ_j D_j B_jkᵀ‖² = ½E − ⟨D, F⟩ + ½⟨D, D A⟩
//! ```
//!
//! `X_k` is `m × c`, `D = [D_1 … D_J]` is `m × cJ`, `A` is `cJ × cJ`, `F` is `m × cJ`; for plain coefficients (`c = 1`)
//! these are the `A = Σ ααᵀ` and `B = Σ xαᵀ` of Mairal et al. 2009. Sums merge by addition.

use crate::AnalysisError;
use crate::accumulate::{Shapes, read_numbers, write_numbers};
use crate::algebra::Algebra;
use crate::metric::dot;
use crate::sparse::SparseCode;
use shapelex_numeric::dense::{Matrix, add_product, multiply, symmetric_eigen};
use shapelex_numeric::kernels::add_scaled;

/// Sufficient statistics of codes.
#[derive(Debug, Clone, PartialEq)]
pub struct Statistics {
    size: usize,
    /// `A`.
    second: Matrix,
    /// `F`.
    cross: Matrix,
    /// `E`.
    energy: f64,
    /// `Σ_k w_k ‖D_j B_jkᵀ‖` of every atom; an upper bound once an atom was rescaled.
    magnitudes: Vec<f64>,
    /// `Σ w_k`.
    weight: f64,
}

/// Number of atoms whose steps are propagated to the others in one product.
const RUN: usize = 16;

impl Statistics {
    /// An empty sum for shapes of `length = m·c` numbers and `atoms` atoms.
    pub fn new(length: usize, size: usize, atoms: usize) -> Self {
        let columns = size * atoms;
        Self {
            size,
            second: Matrix::zeros(columns, columns),
            cross: Matrix::zeros(length / size, columns),
            energy: 0.0,
            magnitudes: vec![0.0; atoms],
            weight: 0.0,
        }
    }

    /// An empty sum of the same sizes.
    pub fn emptied(&self) -> Self {
        Self::new(self.cross.nrows() * self.size, self.size, self.magnitudes.len())
    }

    /// Size in bytes.
    pub fn bytes(&self) -> usize {
        8 * (self.second.len() + self.cross.len() + self.magnitudes.len() + 2)
    }

    /// Total weight, `Σ w_k`.
    pub fn weight(&self) -> f64 {
        self.weight
    }

    /// Adds shapes with their codes. Cost: a product `O(K n c J)` for `K` shapes, and `O(k² c³)` for each shape with `k` atoms
    /// in use.
    pub fn add(&mut self, algebra: &Algebra, shapes: Shapes<'_>, codes: &[SparseCode]) {
        let (c, rows) = (self.size, self.second.nrows());
        // `w_k B_jk`: one row of blocks per shape.
        let mut weighted = Matrix::zeros(c * codes.len(), rows);
        for ((row, (_, x, weight)), code) in (0..).step_by(c).zip(shapes.iter()).zip(codes) {
            self.weight += weight;
            self.energy += weight * dot(x, x);
            let entries = algebra.entries(&code.values);
            let columns = || code.indices.iter().zip(entries.chunks_exact(c * c));
            for ((&j, values), a) in columns().zip(code.values.chunks_exact(algebra.parameters())) {
                self.magnitudes[j] += weight * dot(a, a).sqrt();
                for (column, part) in values.chunks_exact(c).enumerate() {
                    let target = weighted.view_mut((row, j * c + column), (c, 1));
                    target.into_iter().zip(part).for_each(|(target, value)| *target = weight * value);
                }
            }
            for (&l, right) in columns() {
                for (s, right) in right.chunks_exact(c).enumerate() {
                    let target = &mut self.second.as_mut_slice()[(l * c + s) * rows..][..rows];
                    for (&j, left) in columns() {
                        for (r, left) in left.chunks_exact(c).enumerate() {
                            target[j * c + r] += weight * short_dot(left, right);
                        }
                    }
                }
            }
        }
        // The columns of a shape are its coordinates, so the columns of all shapes form one matrix.
        add_product(&mut self.cross, shapes.whitened, &weighted);
    }

    /// Adds another sum.
    pub fn merge(&mut self, other: &Self) {
        self.second += &other.second;
        self.cross += &other.cross;
        self.energy += other.energy;
        self.weight += other.weight;
        self.magnitudes.iter_mut().zip(&other.magnitudes).for_each(|(a, b)| *a += b);
    }

    /// Subtracts a sum that was added before.
    pub fn remove(&mut self, other: &Self) {
        self.second -= &other.second;
        self.cross -= &other.cross;
        self.energy -= other.energy;
        self.weight -= other.weight;
        self.magnitudes.iter_mut().zip(&other.magnitudes).for_each(|(a, b)| *a -= b);
    }

    /// Objective of the codes in the atoms `D`, divided by the weight: the fit, and `lambda` times the magnitudes.
    pub fn objective(&self, atoms: &Matrix, lambda: f64) -> f64 {
        let image = multiply(atoms, &self.second);
        let fit = 0.5 * self.energy - atoms.dot(&self.cross) + 0.5 * atoms.dot(&image);
        (fit + lambda * self.magnitudes.iter().sum::<f64>()) / self.weight
    }

    /// `λ_max(A_jj)`: the weighted sum of squared coefficients of an atom.
    pub fn use_of(&self, j: usize) -> f64 {
        let c = self.size;
        match c {
            1 => self.second[(j, j)],
            _ => symmetric_eigen(&self.second.view((j * c, j * c), (c, c)).into_owned()).eigenvalues.max(),
        }
    }

    /// One sweep of block coordinate descent over the atoms `D`, `m × cJ`. Each atom takes the step `(F_j − D A_j)/λ_max(A_jj)`
    /// and is projected back into its ball, which is the minimiser if `A_jj` is a number. Atoms with a curvature of at most
    /// `unused` stay. Cost: one product `O(m (cJ)²)`, because the steps of a run of atoms are propagated in one product.
    pub fn sweep(&self, algebra: &Algebra, atoms: &mut Matrix, unused: f64) {
        let (c, m, total) = (self.size, atoms.nrows(), atoms.ncols());
        let mut image = multiply(atoms, &self.second);
        for first in (0..total).step_by(RUN * c) {
            let run = (RUN * c).min(total - first);
            let mut steps = Matrix::zeros(m, run);
            for j in first / c..(first + run) / c {
                let curvature = self.use_of(j);
                if curvature <= unused {
                    continue;
                }
                let here = j * c * m..(j + 1) * c * m;
                let (force, old) = (&self.cross.as_slice()[here.clone()], &atoms.as_slice()[here.clone()]);
                let pull = &image.as_slice()[here.clone()];
                let forces = force.iter().zip(pull).map(|(force, pull)| force - pull);
                let mut new: Vec<f64> = old.iter().zip(forces).map(|(old, f)| old + f / curvature).collect();
                algebra.to_ball(&mut new);
                let step = &mut steps.as_mut_slice()[(j * c - first) * m..][..c * m];
                step.iter_mut().zip(new.iter().zip(old)).for_each(|(step, (new, old))| *step = new - old);
                for column in (j + 1) * c..first + run {
                    for (r, part) in step.chunks_exact(m).enumerate() {
                        let weight = self.second[(j * c + r, column)];
                        add_scaled(image.column_mut(column).as_mut_slice(), weight, part);
                    }
                }
                atoms.as_mut_slice()[here].copy_from_slice(&new);
            }
            let rest = total - first - run;
            if rest > 0 {
                let weights = self.second.view((first, first + run), (run, rest)).into_owned();
                let mut later = image.columns_mut(first + run, rest);
                later += multiply(&steps, &weights);
            }
        }
    }

    /// Substitutes `D_j'` for atom `D_j = D_j' R`: its matrices become `B_jk Rᵀ`.
    pub fn substitute(&mut self, j: usize, r: &Matrix) {
        let (c, first) = (self.size, j * self.size);
        let columns = self.cross.columns(first, c) * r.transpose();
        self.cross.columns_mut(first, c).copy_from(&columns);
        let columns = self.second.columns(first, c) * r.transpose();
        self.second.columns_mut(first, c).copy_from(&columns);
        let rows = r * self.second.rows(first, c);
        self.second.rows_mut(first, c).copy_from(&rows);
        self.magnitudes[j] *= r.singular_values().max();
    }

    /// Serialises the sum: little-endian, self-delimiting.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        write_numbers(&mut bytes, &[self.energy, self.weight]);
        write_numbers(&mut bytes, &self.magnitudes);
        write_numbers(&mut bytes, self.second.as_slice());
        write_numbers(&mut bytes, self.cross.as_slice());
        bytes
    }

    /// Replaces this sum by a serialised one of the same sizes.
    ///
    /// # Errors
    /// [`AnalysisError::NotAnAccumulator`] for any other bytes.
    pub fn restore(&mut self, mut bytes: &[u8]) -> Result<(), AnalysisError> {
        let (head, magnitudes) = (read_numbers(&mut bytes)?, read_numbers(&mut bytes)?);
        let (second, cross) = (read_numbers(&mut bytes)?, read_numbers(&mut bytes)?);
        let fits = magnitudes.len() == self.magnitudes.len()
            && second.len() == self.second.len()
            && cross.len() == self.cross.len();
        let &[energy, weight] = head.as_slice() else { return Err(AnalysisError::NotAnAccumulator) };
        if !fits {
            return Err(AnalysisError::NotAnAccumulator);
        }
        (self.energy, self.weight, self.magnitudes) = (energy, weight, magnitudes);
        self.second.as_mut_slice().copy_from_slice(&second);
        self.cross.as_mut_slice().copy_from_slice(&cross);
        Ok(())
    }
}

/// The dot product of two columns of a matrix `B_jk`: for plain coefficients one product, without a call.
fn short_dot(a: &[f64], b: &[f64]) -> f64 {
    match (a, b) {
        (&[a], &[b]) => a * b,
        _ => dot(a, b),
    }
}
