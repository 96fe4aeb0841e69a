//! The subspace of a shape under a class, and the projector onto it (Theorem 1).
//!
//! ```text
//! C = [vec(B_i r)],   C = Q R (thin QR in the whitened metric),   P = Q Qᵀ,   P m = Σ a_i B_i r,  a = R⁻¹ Qᵀ m
//! ```
//!
//! The `dN × dN` matrix is never formed. For `linear` and `affine`, `Q` is `N × d` and shared by all coordinates; for
//! non-uniform scaling, every axis has its own unit vector.

use super::metric::{dot, norm};
use super::transformation::{Structure, TransformationClass};
use super::{AnalysisError, DEGENERATE};
use shapelex_numeric::dense::{Matrix, svd};

/// Ratio of diagonal entries of `R` above which the singular values need not be computed: for at most 9 columns, the
/// smallest singular value is at least `10⁻³` of the smallest diagonal entry.
const WELL_CONDITIONED: f64 = 1e-6;

/// Norm after centring, as a fraction of the norm before, below which a shape is rounding error.
const NO_EXTENT: f64 = 1e-13;

/// Norm below which products of two norms are no longer exact.
const SMALLEST_NORM: f64 = 1e-100;

/// Orthonormal basis of one block of a subspace: `C = Q R`, where `Q` is `n × r`.
#[derive(Debug, Clone)]
pub(super) struct Block {
    pub(super) q: Matrix,
    r: Matrix,
}

/// The subspace of one shape under a class, in whitened coordinates.
#[derive(Debug, Clone)]
pub struct Subspace<'a> {
    class: &'a TransformationClass,
    pub(super) blocks: Vec<Block>,
}

/// The nearest member of a subspace to a given shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Projected {
    /// Its whitened coordinates, `d·N`.
    pub whitened: Vec<f64>,
    /// `A`, `d × d`: the member is `A r` for the (centred) shape `r`.
    pub matrix: Matrix,
}

/// Checks that a shape has an extent, from its norm before centring (`control_norm`) and after (`centred_norm`).
///
/// # Errors
/// [`AnalysisError::NoExtent`] with index 0 if it has none.
pub fn check_extent(centred_norm: f64, control_norm: f64) -> Result<(), AnalysisError> {
    if centred_norm > SMALLEST_NORM && centred_norm > NO_EXTENT * control_norm {
        return Ok(());
    }
    Err(AnalysisError::NoExtent { index: 0, norm: centred_norm, size: control_norm })
}

/// Relative rounding error that reading, resampling and interpolation leave in the points.
const ROUNDING: f64 = 4.0 * f64::EPSILON;

/// Removes rounding noise from a centred shape (`d·N`) that lay far from the origin: along directions in which the shape is
/// thinner than the rounding of its original coordinates (of norm `control_norm`), it becomes flat. A straight line is then
/// straight at any distance from the origin. Nothing changes if the noise is too small to count as extent.
pub fn flatten(centred: &mut [f64], dimension: usize, control_norm: f64) {
    let noise = ROUNDING * control_norm;
    if noise <= DEGENERATE * norm(centred) {
        return;
    }
    let n = centred.len() / dimension;
    let Some(axes) = svd(Matrix::from_column_slice(n, dimension, centred), false, true) else { return };
    let Some(directions) = axes.v_t else { return };
    let thin = |k: &usize| axes.singular_values[*k] <= noise;
    for direction in (0..axes.singular_values.len()).filter(thin).map(|k| directions.row(k)) {
        for row in 0..n {
            let along: f64 = (0..dimension).map(|c| centred[c * n + row] * direction[c]).sum();
            (0..dimension).for_each(|c| centred[c * n + row] -= along * direction[c]);
        }
    }
}

impl<'a> Subspace<'a> {
    /// Subspace of the whitened shape `x` (`d·N`, centred when the class translates).
    ///
    /// Cost `O(dN I²)`.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] with index 0 if the relative singular value of the basis is below `10⁻¹⁰`,
    /// [`AnalysisError::NoExtent`] if the shape vanishes.
    pub fn new(class: &'a TransformationClass, x: &[f64]) -> Result<Self, AnalysisError> {
        let n = x.len() / class.dimension();
        let size = norm(x);
        check_extent(size, size)?;
        let blocks: Vec<Block> = match class.structure {
            Structure::PerCoordinate => vec![Block::new(Matrix::from_column_slice(n, class.dimension(), x))],
            Structure::PerAxis => {
                x.chunks_exact(n).map(|axis| Block::new(Matrix::from_column_slice(n, 1, axis))).collect()
            }
            Structure::General => vec![Block::new(transformed(class, x, n, class.matrices().len()))],
            Structure::Complex => vec![Block::new(transformed(class, x, n, 1))],
        };
        let sigma = relative_singular_value(&blocks);
        if !(sigma >= DEGENERATE) {
            return Err(AnalysisError::Degenerate { index: 0, class: class.label().into(), sigma });
        }
        Ok(Self { class, blocks })
    }

    /// Numbers of the orthonormal bases of all blocks, as far as [`Self::write_basis`] writes them, of a shape of `length`.
    pub(super) fn numbers(class: &TransformationClass, length: usize) -> usize {
        match class.structure {
            Structure::PerCoordinate | Structure::PerAxis | Structure::Complex => length,
            Structure::General => length * class.matrices().len(),
        }
    }

    /// Writes `factor Q` of every block, one after the other, of the subspace of `x`.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub(super) fn write_basis(
        class: &TransformationClass,
        x: &[f64],
        factor: f64,
        out: &mut [f64],
    ) -> Result<(), AnalysisError> {
        if class.structure == Structure::Complex {
            let size = norm(x);
            check_extent(size, size)?;
            // The first matrix is diagonal.
            for (c, (out, x)) in
                out.chunks_exact_mut(x.len() / 2).zip(x.chunks_exact(x.len() / 2)).enumerate()
            {
                let factor = factor / size * class.matrices()[0][(c, c)];
                out.iter_mut().zip(x).for_each(|(out, x)| *out = factor * x);
            }
            return Ok(());
        }
        let blocks = Subspace::new(class, x)?.blocks;
        let columns = blocks.iter().flat_map(|block| block.q.as_slice());
        out.iter_mut().zip(columns).for_each(|(out, q)| *out = factor * q);
        Ok(())
    }

    /// Replaces the whitened shape `x` by the member `P m` of its subspace nearest to `m`: the bits are those of [`Self::project`].
    ///
    /// # Errors
    /// As [`Self::new`].
    pub(super) fn bring(class: &TransformationClass, x: &mut [f64], m: &[f64]) -> Result<(), AnalysisError> {
        if class.structure != Structure::Complex {
            x.copy_from_slice(&Subspace::new(class, x)?.project(m).whitened);
            return Ok(());
        }
        let size = norm(x);
        check_extent(size, size)?;
        let n = x.len() / 2;
        // The first matrix is diagonal, and the column is one of unit length.
        for (c, x) in x.chunks_exact_mut(n).enumerate() {
            let factor = class.matrices()[0][(c, c)];
            x.iter_mut().for_each(|x| *x *= factor);
        }
        let scale = 1.0 / norm(x);
        x.iter_mut().for_each(|x| *x *= scale);
        let a = dot(x, m);
        let b = dot(x, &quarter_turn(m, -1.0));
        let (first, second) = x.split_at_mut(n);
        for (x, y) in first.iter_mut().zip(second) {
            (*x, *y) = (a * *x - b * *y, a * *y + b * *x);
        }
        Ok(())
    }

    /// `P m`, and the transformation that maps the shape to it.
    pub fn project(&self, m: &[f64]) -> Projected {
        let d = self.class.dimension();
        let n = m.len() / d;
        let mut whitened = vec![0.0; m.len()];
        let mut matrix = Matrix::zeros(d, d);
        match self.class.structure {
            Structure::PerCoordinate => {
                for c in 0..d {
                    let part = c * n..(c + 1) * n;
                    let a = self.blocks[0].project(&m[part.clone()], &mut whitened[part]);
                    matrix.row_mut(c).copy_from_slice(&a);
                }
            }
            Structure::PerAxis => {
                for (c, block) in self.blocks.iter().enumerate() {
                    let part = c * n..(c + 1) * n;
                    matrix[(c, c)] = block.project(&m[part.clone()], &mut whitened[part])[0];
                }
            }
            Structure::Complex => {
                // ⟨Jq, m⟩ = ⟨q, Jᵀm⟩ and J q q ᵀ Jᵀ m = J (q ⟨q, Jᵀm⟩)
                let size = self.blocks[0].r[(0, 0)];
                let back = quarter_turn(m, -1.0);
                let mut turned = vec![0.0; m.len()];
                let a = dot(self.blocks[0].q.as_slice(), m);
                let b = dot(self.blocks[0].q.as_slice(), &back);
                for (k, q) in self.blocks[0].q.iter().enumerate() {
                    whitened[k] = a * q;
                    turned[k] = b * q;
                }
                whitened.iter_mut().zip(quarter_turn(&turned, 1.0)).for_each(|(sum, v)| *sum += v);
                matrix = (&self.class.matrices()[0] * a + &self.class.matrices()[1] * b) / size;
            }
            Structure::General => {
                let a = self.blocks[0].project(m, &mut whitened);
                for (a, b) in a.iter().zip(self.class.matrices()) {
                    matrix += b * *a;
                }
            }
        }
        Projected { whitened, matrix }
    }
}

/// `±J y` of a planar shape: `(x, y) → ±(−y, x)`.
pub(super) fn quarter_turn(shape: &[f64], sign: f64) -> Vec<f64> {
    let (x, y) = shape.split_at(shape.len() / 2);
    y.iter().map(|value| -sign * value).chain(x.iter().map(|value| sign * value)).collect()
}

/// Writes `J y` of a planar shape into `out`.
pub(super) fn turn(y: &[f64], out: &mut [f64]) {
    let (first, second) = out.split_at_mut(y.len() / 2);
    first.iter_mut().zip(&y[y.len() / 2..]).for_each(|(out, y)| *out = -y);
    second.copy_from_slice(&y[..y.len() / 2]);
}

/// `[vec(B_i x)]` for the first `count` matrices: `dN × count`.
fn transformed(class: &TransformationClass, x: &[f64], n: usize, count: usize) -> Matrix {
    let d = class.dimension();
    let mut columns = Matrix::zeros(x.len(), count);
    for (i, b) in class.matrices().iter().take(count).enumerate() {
        let mut column = columns.column_mut(i);
        let column = column.as_mut_slice();
        for c in 0..d {
            for e in 0..d {
                let factor = b[(c, e)];
                if factor != 0.0 {
                    for k in 0..n {
                        column[c * n + k] += factor * x[e * n + k];
                    }
                }
            }
        }
    }
    columns
}

impl Block {
    /// Modified Gram–Schmidt, applied twice: orthonormal to rounding for every non-degenerate basis.
    fn new(mut q: Matrix) -> Self {
        let columns = q.ncols();
        let mut r = Matrix::zeros(columns, columns);
        for j in 0..columns {
            for _ in 0..2 {
                for i in 0..j {
                    let (earlier, current) = two_columns(&mut q, i, j);
                    let product = dot(earlier, current);
                    r[(i, j)] += product;
                    current.iter_mut().zip(earlier).for_each(|(x, e)| *x -= product * e);
                }
            }
            let length = norm(q.column(j).as_slice());
            r[(j, j)] = length;
            if length > 0.0 {
                q.column_mut(j).scale_mut(1.0 / length);
            }
        }
        Self { q, r }
    }

    /// Writes `Q Qᵀ m` and returns `R⁻¹ Qᵀ m`.
    fn project(&self, m: &[f64], out: &mut [f64]) -> Vec<f64> {
        let mut a: Vec<f64> = self.q.column_iter().map(|q| dot(q.as_slice(), m)).collect();
        for (g, q) in a.iter().zip(self.q.column_iter()) {
            out.iter_mut().zip(q.iter()).for_each(|(sum, q)| *sum += g * q);
        }
        for i in (0..a.len()).rev() {
            for j in i + 1..a.len() {
                a[i] -= self.r[(i, j)] * a[j];
            }
            a[i] /= self.r[(i, i)];
        }
        a
    }
}

fn two_columns(q: &mut Matrix, i: usize, j: usize) -> (&[f64], &mut [f64]) {
    let n = q.nrows();
    let (left, right) = q.as_mut_slice().split_at_mut(j * n);
    (&left[i * n..(i + 1) * n], &mut right[..n])
}

/// Smallest over largest singular value of the whole basis.
fn relative_singular_value(blocks: &[Block]) -> f64 {
    let diagonal = |f: fn(f64, f64) -> f64, start| {
        blocks.iter().flat_map(|b| b.r.diagonal().iter().copied().collect::<Vec<_>>()).fold(start, f)
    };
    let ratio = diagonal(f64::min, f64::MAX) / diagonal(f64::max, 0.0);
    if ratio >= WELL_CONDITIONED || blocks.len() > 1 {
        return ratio;
    }
    let singular = blocks[0].r.singular_values();
    singular.min() / singular.max()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::transformation::ClassName;

    #[test]
    fn a_shape_brought_in_place_has_the_bits_of_its_projection() {
        let shape = |phase: f64| -> Vec<f64> { (0..34).map(|i| (0.9 * i as f64 + phase).sin()).collect() };
        for name in [
            ClassName::ScaledRotation,
            ClassName::ReflectedSimilarity,
            ClassName::Affine,
            ClassName::NonUniformScaling,
        ] {
            let class = TransformationClass::named(name, 2).unwrap();
            for k in 0..20 {
                let (x, m) = (shape(0.37 * f64::from(k)), shape(1.9));
                let expected = Subspace::new(&class, &x).unwrap().project(&m).whitened;
                let mut found = x;
                Subspace::bring(&class, &mut found, &m).unwrap();
                assert_eq!(found, expected, "{name:?}");
            }
            assert!(Subspace::bring(&class, &mut [0.0; 34], &shape(1.9)).is_err());
        }
    }
}
