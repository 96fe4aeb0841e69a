//! Sums of outer products.

use super::source::{BLOCK, PART, Shapes};
use super::sum::{Accumulator, read_numbers, write_numbers};
use crate::AnalysisError;
use crate::metric::dot;
use crate::subspace::quarter_turn;
use shapelex_numeric::dense::{self, Eigenpairs, Matrix, PANEL};
use shapelex_numeric::kernels::{add_scaled, shift};
use shapelex_numeric::parallel;

/// `S = Σ x xᵀ` of vectors `x ∈ R^n`, with its leading eigenpairs by the smaller of two routes.
///
/// Up to about `n/2` vectors are kept as they are (dual route, Theorem 2: the symmetric matrix `XᵀX`); beyond that,
/// they are folded into the `n × n` matrix (primal route), a panel of [`PANEL`] vectors at a time. The sum depends on the
/// vectors and their order alone, whatever the calls that add them.
#[derive(Debug, Clone, PartialEq)]
pub struct OuterProductSum {
    n: usize,
    /// Vectors that are not yet part of the matrix.
    columns: Vec<f64>,
    /// Lower triangle.
    matrix: Option<Matrix>,
}

/// Size up to which threads sum different shapes; above it, they share the matrix.
const SMALL: usize = 256;

/// Points of planar shapes from which means take products with the shapes instead of with a matrix.
pub(crate) const MATRIX_FREE: usize = 512;

/// About the number of products with four vectors that an eigenpair takes.
const MATRIX_FREE_STEPS: usize = 8;

/// Shapes per sum of small size. Changing it changes last bits.
const SMALL_UNIT: usize = 16 * BLOCK;

/// Approximate number of bytes of the columns that are made before they are multiplied: they stay in the cache.
const GROUP_BYTES: usize = 1 << 20;

/// Shapes per sum of vectors of `n` numbers.
pub(crate) fn unit(n: usize) -> usize {
    if n <= SMALL { SMALL_UNIT } else { PART }
}

/// Calls `visit` with groups of consecutive shapes of `n` numbers, and a buffer of `numbers` numbers for each shape.
pub(crate) fn for_each_group(
    mut shapes: Shapes<'_>,
    n: usize,
    numbers: usize,
    mut visit: impl FnMut(Shapes<'_>, &mut [f64]) -> Result<(), AnalysisError>,
) -> Result<(), AnalysisError> {
    let size = if n <= SMALL { BLOCK } else { (GROUP_BYTES / (8 * numbers)).next_multiple_of(BLOCK) };
    let mut buffer = vec![0.0; size.min(shapes.weights.len()) * numbers];
    while !shapes.weights.is_empty() {
        let (group, rest) = shapes.split_at(size.min(shapes.weights.len()));
        visit(group, &mut buffer[..group.weights.len() * numbers])?;
        shapes = rest;
    }
    Ok(())
}

/// [`dense::add_outer_products`], of large matrices in parallel: strips in pairs of equal work, the first with the last.
fn add_outer_products(s: &mut Matrix, columns: &[f64], factor: f64) {
    if s.nrows() <= SMALL {
        return dense::add_outer_products(s, columns, factor);
    }
    let mut strips = dense::strips(s);
    let mut pairs = Vec::with_capacity(strips.len().div_ceil(2));
    while let Some(first) = strips.next() {
        pairs.push([Some(first), strips.next_back()]);
    }
    parallel::map_each(&mut pairs, &|pair| {
        pair.iter_mut().flatten().for_each(|strip| strip.add_outer_products(columns, factor));
    });
}

impl OuterProductSum {
    /// The empty sum in `R^n`.
    pub fn new(n: usize) -> Self {
        Self { n, columns: Vec::new(), matrix: None }
    }

    /// Size of the vectors, `n`.
    pub(crate) fn size(&self) -> usize {
        self.n
    }

    /// Adds the vectors stored one after the other.
    pub fn add(&mut self, mut columns: &[f64]) {
        let panel = self.n * PANEL;
        if self.matrix.is_none() {
            if self.columns.len() + columns.len() < panel.max(self.n * (self.n / 2)) {
                self.columns.extend_from_slice(columns);
                return;
            }
            self.matrix = Some(Matrix::zeros(self.n, self.n));
        }
        if !self.columns.is_empty() {
            let missing = (panel - self.columns.len() % panel) % panel;
            let (completing, rest) = columns.split_at(missing.min(columns.len()));
            self.columns.extend_from_slice(completing);
            if completing.len() < missing {
                return;
            }
            self.fold();
            columns = rest;
        }
        let (whole, rest) = columns.split_at(columns.len() / panel * panel);
        self.columns.extend_from_slice(rest);
        if let (Some(matrix), false) = (&mut self.matrix, whole.is_empty()) {
            add_outer_products(matrix, whole, 1.0);
        }
    }

    /// Adds all vectors kept to the matrix.
    fn fold(&mut self) {
        let matrix = self.matrix.get_or_insert_with(|| Matrix::zeros(self.n, self.n));
        add_outer_products(matrix, &self.columns, 1.0);
        self.columns.clear();
    }

    /// Adds another sum.
    pub fn merge(&mut self, other: Self) {
        if let Some(matrix) = other.matrix {
            match &mut self.matrix {
                Some(own) => *own += matrix,
                None => self.matrix = Some(matrix),
            }
        }
        self.add(&other.columns);
    }

    /// Subtracts the vectors `leaving` and adds `arriving`. Returns `false`, doing nothing, while vectors are kept.
    pub(crate) fn exchange(&mut self, leaving: &[f64], arriving: &[f64]) -> bool {
        let Some(matrix) = &mut self.matrix else { return false };
        add_outer_products(matrix, leaving, -1.0);
        add_outer_products(matrix, arriving, 1.0);
        true
    }

    /// Extends the sum over `x` to a sum over `x` and `J x`, where `J` is the quarter turn of planar shapes:
    /// `S + J S Jᵀ = [[A + C, ·], [B − Bᵀ, A + C]]` for `S = [[A, ·], [B, C]]`.
    fn close_under_quarter_turn(&mut self) {
        let turned: Vec<f64> = self.columns.chunks_exact(self.n).flat_map(|x| quarter_turn(x, 1.0)).collect();
        self.columns.extend(turned);
        if let Some(s) = &mut self.matrix {
            let half = self.n / 2;
            dense::fill_upper(s);
            let sum = s.view((0, 0), (half, half)) + s.view((half, half), (half, half));
            let cross = s.view((half, 0), (half, half)).into_owned();
            s.view_mut((0, 0), (half, half)).copy_from(&sum);
            s.view_mut((half, half), (half, half)).copy_from(&sum);
            s.view_mut((half, 0), (half, half)).copy_from(&(&cross - cross.transpose()));
        }
    }

    /// Orthonormal basis of the leading invariant subspace, iterated from the columns of `near`: of `S`, or of `S + J S Jᵀ` if
    /// `turned`, whose products take one with `S` and no separate matrix. `None` if the iteration does not converge quickly.
    pub(crate) fn leading_subspace(&mut self, near: &Matrix, turned: bool) -> Option<Matrix> {
        if self.matrix.is_none() && self.columns.len() < self.n * self.n {
            let x = Matrix::from_column_slice(self.n, self.columns.len() / self.n, &self.columns);
            let product = |v: &Matrix| dense::multiply(&x, &dense::transpose_multiply(&x, v));
            return iterate(product, near, turned);
        }
        self.fold();
        let s = self.matrix.as_mut().expect("folded");
        dense::fill_upper(s);
        iterate(|v| dense::multiply(s, v), near, turned)
    }

    /// Trace of the sum, `tr S`.
    pub fn trace(&self) -> f64 {
        dot(&self.columns, &self.columns) + self.matrix.as_ref().map_or(0.0, Matrix::trace)
    }

    /// `S`.
    pub(crate) fn into_matrix(mut self) -> Matrix {
        self.fold();
        let mut matrix = self.matrix.unwrap_or_else(|| Matrix::zeros(self.n, self.n));
        dense::fill_upper(&mut matrix);
        matrix
    }

    /// The `count` leading eigenpairs of `S`; fewer if its rank is smaller (dual route).
    ///
    /// # Errors
    /// [`NumericError::NoConvergence`](shapelex_numeric::NumericError::NoConvergence) if the eigenproblem fails.
    pub fn leading(mut self, count: usize) -> Result<Eigenpairs, AnalysisError> {
        if self.matrix.is_none() && self.columns.len() < self.n * self.n {
            return dual_eigenpairs(&self.columns, self.n, count);
        }
        self.fold();
        let matrix = self.matrix.expect("folded");
        Ok(dense::leading_eigenpairs(&matrix, count)?)
    }

    /// The `count` leading eigenpairs of `S + J S Jᵀ`, where `J` is the quarter turn of planar shapes. While the vectors are kept, are
    /// long and are many, the iteration takes products with them instead of with the matrix of their products, which would cost more
    /// than the iteration itself.
    ///
    /// # Errors
    /// As [`leading`](Self::leading).
    pub(crate) fn leading_turned(mut self, count: usize) -> Result<Eigenpairs, AnalysisError> {
        let vectors = self.columns.len() / self.n;
        if self.matrix.is_none() && self.n >= 2 * MATRIX_FREE && vectors >= 2 * MATRIX_FREE_STEPS * count {
            let size = dot(&self.columns, &self.columns);
            let product = |v: &Matrix| on_both_sides(&|sides| self.product(sides), v);
            if let Some(pairs) = dense::leading_eigenpairs_of(self.n, size, product, count) {
                let rank = rank(&pairs.values);
                let vectors = pairs.vectors.columns(0, rank).into_owned();
                return Ok(Eigenpairs { values: pairs.values[..rank].to_vec(), vectors });
            }
        }
        self.close_under_quarter_turn();
        self.leading(count)
    }

    /// `X Xᵀ v` of the vectors kept, a panel after the other.
    fn product(&self, v: &Matrix) -> Matrix {
        let panels: Vec<&[f64]> = self.columns.chunks(self.n * PANEL).collect();
        let products = parallel::map(panels.len(), &|k| {
            let mut product = Matrix::zeros(v.nrows(), v.ncols());
            let inside = dense::transpose_multiply_columns(v, panels[k]).transpose();
            dense::add_product(&mut product, panels[k], &inside);
            product
        });
        products.into_iter().fold(Matrix::zeros(v.nrows(), v.ncols()), |sum, product| sum + product)
    }

    pub(crate) fn write(&self, bytes: &mut Vec<u8>) {
        write_numbers(bytes, &self.columns);
        write_numbers(bytes, self.matrix.as_ref().map_or(&[], |m| m.as_slice()));
    }

    pub(crate) fn read(&mut self, bytes: &mut &[u8]) -> Result<(), AnalysisError> {
        let columns = read_numbers(bytes)?;
        let matrix = read_numbers(bytes)?;
        if columns.len() % self.n != 0 || !(matrix.is_empty() || matrix.len() == self.n * self.n) {
            return Err(AnalysisError::NotAnAccumulator);
        }
        self.columns = columns;
        self.matrix = (!matrix.is_empty()).then(|| Matrix::from_vec(self.n, self.n, matrix));
        Ok(())
    }
}

/// [`dense::iterate_subspace`] of an operator `S`, or of `S + J S Jᵀ`.
fn iterate(product: impl Fn(&Matrix) -> Matrix, near: &Matrix, turned: bool) -> Option<Matrix> {
    if !turned {
        return dense::iterate_subspace(product, near);
    }
    dense::iterate_subspace(|v| on_both_sides(&product, v), near)
}

/// `(S + J S Jᵀ) v` by one product with `S`.
fn on_both_sides(product: &dyn Fn(&Matrix) -> Matrix, v: &Matrix) -> Matrix {
    let turn = |columns: &[f64], n: usize, sign: f64| -> Vec<f64> {
        columns.chunks_exact(n).flat_map(|x| quarter_turn(x, sign)).collect()
    };
    let (n, count) = v.shape();
    let mut sides = v.as_slice().to_vec();
    sides.extend(turn(v.as_slice(), n, -1.0));
    let image = product(&Matrix::from_vec(n, 2 * count, sides));
    let (mut sum, back) = (image.columns(0, count).into_owned(), image.columns(count, count).into_owned());
    sum += Matrix::from_vec(n, count, turn(back.as_slice(), n, 1.0));
    sum
}

/// Relative eigenvalue of `XᵀX` below which a direction is rounding error.
const RANK: f64 = 1e-14;

/// Number of leading eigenvalues that are not rounding errors.
fn rank(values: &[f64]) -> usize {
    let largest = values.first().copied().unwrap_or(0.0);
    values.iter().take_while(|&&value| value > RANK * largest).count()
}

/// Eigenpairs of `X Xᵀ` from those of `XᵀX`: `f_i = X v_i / √λ_i`.
///
/// Division by a small `√λ` costs orthogonality, so the vectors are orthonormalised again in the order of their
/// eigenvalues.
fn dual_eigenpairs(columns: &[f64], n: usize, count: usize) -> Result<Eigenpairs, AnalysisError> {
    let x = Matrix::from_column_slice(n, columns.len() / n, columns);
    let pairs = dense::leading_eigenpairs(&dense::gram(columns, n), count)?;
    let rank = rank(&pairs.values);
    let mut vectors = dense::multiply(&x, &pairs.vectors.columns(0, rank).into_owned());
    for j in 0..rank {
        for i in 0..j {
            let product = vectors.column(i).dot(&vectors.column(j));
            let earlier = vectors.column(i).into_owned();
            vectors.column_mut(j).axpy(-product, &earlier, 1.0);
        }
        let length = vectors.column(j).norm();
        vectors.column_mut(j).scale_mut(1.0 / length);
    }
    Ok(Eigenpairs { values: pairs.values[..rank].to_vec(), vectors })
}

/// A weighted sum of outer products: scatter matrix, sum of vectors and of weights.
#[derive(Debug, Clone, PartialEq)]
pub struct ScatterSum {
    origin: Vec<f64>,
    outer: OuterProductSum,
    /// `√w` of the vectors, while they are kept as they are.
    roots: Vec<f64>,
    sum: Vec<f64>,
    weight: f64,
}

impl ScatterSum {
    /// The empty sum in `R^n`.
    pub fn new(n: usize) -> Self {
        Self::about(vec![0.0; n])
    }

    /// The empty sum of vectors from which `origin` is subtracted first.
    pub fn about(origin: Vec<f64>) -> Self {
        let n = origin.len();
        Self { origin, outer: OuterProductSum::new(n), roots: Vec::new(), sum: vec![0.0; n], weight: 0.0 }
    }

    /// Total weight, `Σ w`.
    pub fn weight(&self) -> f64 {
        self.weight
    }

    /// Weighted mean, `Σ w x / Σ w`.
    pub fn mean(&self) -> Vec<f64> {
        self.sum.iter().map(|value| value / self.weight).collect()
    }

    /// `tr S` and the leading eigenpairs of `S = Σ w x xᵀ`, or of `Σ w (x − x̄)(x − x̄)ᵀ`.
    ///
    /// Centring happens at the end. To avoid cancellation, subtract a fixed reference from every vector beforehand.
    ///
    /// # Errors
    /// As [`OuterProductSum::leading`].
    pub fn leading(mut self, centre: bool, count: usize) -> Result<(f64, Eigenpairs), AnalysisError> {
        if centre && !self.centre_vectors() {
            self.centre_matrix();
        }
        Ok((self.outer.trace(), self.outer.leading(count)?))
    }

    /// Subtracts the mean from every vector. Returns `false`, doing nothing, if they are not kept.
    fn centre_vectors(&mut self) -> bool {
        let (n, mean) = (self.sum.len(), self.mean());
        if self.outer.matrix.is_some() || self.outer.columns.len() != n * self.roots.len() {
            return false;
        }
        for (column, root) in self.outer.columns.chunks_exact_mut(n.max(1)).zip(&self.roots) {
            add_scaled(column, -root, &mean);
        }
        true
    }

    /// Subtracts `W x̄ x̄ᵀ` from the matrix.
    fn centre_matrix(&mut self) {
        self.outer.fold();
        let mean = self.mean();
        let matrix = self.outer.matrix.as_mut().expect("folded");
        for j in 0..mean.len() {
            for i in j..mean.len() {
                matrix[(i, j)] -= self.weight * mean[i] * mean[j];
            }
        }
    }

    /// Keeps the roots of the weights only as long as the vectors.
    fn extend_roots(&mut self, roots: impl Iterator<Item = f64>) {
        if self.outer.matrix.is_none() {
            self.roots.extend(roots);
        } else {
            self.roots.clear();
        }
    }
}

impl Accumulator for ScatterSum {
    fn unit(&self) -> usize {
        unit(self.sum.len())
    }

    fn update(&mut self, shapes: Shapes<'_>) -> Result<(), AnalysisError> {
        let (n, origin) = (self.sum.len(), self.origin.clone());
        for_each_group(shapes, n, n, |group, columns| {
            let sums = parallel::map_chunks(columns, BLOCK * n, &|k, columns| {
                let mut sum = vec![0.0; n];
                for (column, (_, x, weight)) in columns.chunks_exact_mut(n).zip(group.block(k, BLOCK).iter())
                {
                    shift(column, &mut sum, x, &origin, weight, weight.sqrt());
                }
                sum
            });
            for sum in &sums {
                self.sum.iter_mut().zip(sum).for_each(|(total, sum)| *total += sum);
            }
            group.weights.iter().for_each(|weight| self.weight += weight);
            self.outer.add(columns);
            self.extend_roots(group.weights.iter().map(|weight| weight.sqrt()));
            Ok(())
        })
    }

    fn merge(&mut self, other: Self) {
        self.outer.merge(other.outer);
        self.extend_roots(other.roots.into_iter());
        self.sum.iter_mut().zip(&other.sum).for_each(|(a, b)| *a += b);
        self.weight += other.weight;
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        write_numbers(&mut bytes, &[self.weight]);
        write_numbers(&mut bytes, &self.sum);
        self.outer.write(&mut bytes);
        write_numbers(&mut bytes, &self.roots);
        bytes
    }

    fn restore(&mut self, mut bytes: &[u8]) -> Result<(), AnalysisError> {
        let weight = read_numbers(&mut bytes)?;
        let sum = read_numbers(&mut bytes)?;
        if weight.len() != 1 || sum.len() != self.sum.len() {
            return Err(AnalysisError::NotAnAccumulator);
        }
        (self.weight, self.sum) = (weight[0], sum);
        self.outer.read(&mut bytes)?;
        // Version 0.1.0 did not write the roots: its vectors are centred in the matrix.
        self.roots = if bytes.is_empty() { Vec::new() } else { read_numbers(&mut bytes)? };
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::stream;
    use rand_distr::{Distribution, StandardNormal};

    /// Vectors about one shape, with deviations that decrease from number to number.
    fn vectors(n: usize, count: usize) -> Vec<f64> {
        let vector = |k: usize| {
            let mut random = stream(7, k);
            (0..n).map(move |i| {
                let drawn: f64 = StandardNormal.sample(&mut random);
                (0.01 * i as f64).sin() + 3.0 * drawn / (1.0 + (i % (n / 2)) as f64)
            })
        };
        (0..count).flat_map(vector).collect()
    }

    #[test]
    fn products_with_vectors_give_the_eigenpairs_of_the_matrix() {
        let (n, count) = (2 * MATRIX_FREE, 3);
        let mut sum = OuterProductSum::new(n);
        sum.add(&vectors(n, 2 * MATRIX_FREE_STEPS * count + 7));
        let mut closed = sum.clone();
        closed.close_under_quarter_turn();
        let expected = closed.leading(count).unwrap();
        let free = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| sum.clone().leading_turned(count)).unwrap()
        };
        let found = free(1);
        for (found, expected) in found.values.iter().zip(&expected.values) {
            assert!((found / expected - 1.0).abs() < 1e-12, "{found} for {expected}");
        }
        // Eigenvalues are double: the first two vectors span one space.
        let projector = |pairs: &Eigenpairs| {
            let first = pairs.vectors.columns(0, 2).into_owned();
            dense::multiply(&first, &first.transpose())
        };
        let apart = (projector(&found) - projector(&expected)).norm();
        assert!(apart < 1e-12, "{apart:e}");
        let others = free(3);
        assert_eq!((others.values, others.vectors), (found.values, found.vectors));
    }

    #[test]
    fn equal_vectors_have_the_rank_of_one() {
        let (n, count) = (2 * MATRIX_FREE, 2);
        let mut sum = OuterProductSum::new(n);
        let one = vectors(n, 1);
        (0..4 * MATRIX_FREE_STEPS).for_each(|_| sum.add(&one));
        let found = sum.leading_turned(count + 1).unwrap();
        assert_eq!(found.values.len(), count, "{:?}", found.values);
    }
}
