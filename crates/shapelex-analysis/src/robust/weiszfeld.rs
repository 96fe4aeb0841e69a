//! A step towards the median of subspaces.

use crate::AnalysisError;
use crate::accumulate::{Accumulator, BLOCK, ShapeSource, Shapes, accumulate, read_numbers, write_numbers};
use crate::mean::MeanSpace;
use crate::metric::dot;
use crate::subspace::{Subspace, turn};
use crate::transformation::Structure;
use shapelex_numeric::dense::Matrix;
use shapelex_numeric::kernels::add_scaled;

/// Distance to the mean, as a fraction of its norm, below which shapes count as equally near.
pub(super) const NEAREST: f64 = 1e-3;

/// `Σ_k (w_k/max(d_k, ε)) P_k S̄` for every block of a mean space `S̄`, where `d_k² = I − tr(P_S̄ P_k)`.
struct NearSum<'a> {
    space: &'a MeanSpace<'a>,
    sums: Vec<Matrix>,
    /// `q` and `J q` of one shape, for complex classes.
    own: Vec<f64>,
}

/// One step of Weiszfeld: the mean space of `Σ_k (w_k/d_k) P_k`, as far as one power iteration from `space` finds it. Its
/// eigenvalues lie apart: the rest of the spectrum is the variation of the shapes.
///
/// Cost: a basis for each shape, `O(dN I²)`; no matrix of size `dN`.
///
/// # Errors
/// Degenerate shapes; errors of the source.
pub(super) fn step<'a>(
    source: &dyn ShapeSource,
    space: MeanSpace<'a>,
) -> Result<MeanSpace<'a>, AnalysisError> {
    let both = if space.class.structure == Structure::Complex { 2 * space.bases[0].nrows() } else { 0 };
    let empty = || {
        let sums = space.bases.iter().map(|b| b * 0.0).collect();
        NearSum { space: &space, sums, own: vec![0.0; both] }
    };
    let sums = accumulate(source, empty)?.sums;
    let bases: Option<Vec<Matrix>> = sums.into_iter().map(orthonormal).collect();
    // Shapes orthogonal to the space in one of its directions leave it as it is.
    Ok(match bases {
        Some(bases) => MeanSpace { bases, ..space },
        None => space,
    })
}

/// Orthonormal columns with the same span, by Gram and Schmidt, twice; `None` if they are dependent.
fn orthonormal(mut columns: Matrix) -> Option<Matrix> {
    for j in 0..columns.ncols() {
        let before = columns.column(j).norm();
        for _ in 0..2 {
            for i in 0..j {
                let product = columns.column(i).dot(&columns.column(j));
                let earlier = columns.column(i).into_owned();
                columns.column_mut(j).axpy(-product, &earlier, 1.0);
            }
        }
        let length = columns.column(j).norm();
        if !(length > 1e-12 * before) {
            return None;
        }
        columns.column_mut(j).scale_mut(1.0 / length);
    }
    Some(columns)
}

impl NearSum<'_> {
    /// Adds one shape of weight `weight`.
    fn add(&mut self, x: &[f64], weight: f64) -> Result<(), AnalysisError> {
        let class = self.space.class;
        if class.structure == Structure::Complex {
            return self.add_complex(x, weight);
        }
        let blocks: Vec<Matrix> = Subspace::new(class, x)?.blocks.into_iter().map(|block| block.q).collect();
        let cosines: Vec<Matrix> =
            blocks.iter().zip(&self.space.bases).map(|(q, base)| q.tr_mul(base)).collect();
        let shared: f64 = cosines.iter().map(Matrix::norm_squared).sum();
        let rank: usize = self.space.bases.iter().map(Matrix::ncols).sum();
        let multiplicity =
            if class.structure == Structure::PerCoordinate { class.dimension() as f64 } else { 1.0 };
        let distance = (multiplicity * (rank as f64 - shared)).max(0.0).sqrt();
        let factor = weight / distance.max(NEAREST);
        for ((sum, q), cosines) in self.sums.iter_mut().zip(&blocks).zip(&cosines) {
            sum.gemm(factor, q, cosines, 1.0);
        }
        Ok(())
    }

    /// The same for the span of `q` and `J q`, without matrices of one shape.
    fn add_complex(&mut self, x: &[f64], weight: f64) -> Result<(), AnalysisError> {
        let length = x.len();
        let (q, turned) = self.own.split_at_mut(length);
        Subspace::write_basis(self.space.class, x, 1.0, q)?;
        turn(q, turned);
        let base = &self.space.bases[0];
        let products: Vec<[f64; 2]> =
            base.column_iter().map(|f| [dot(q, f.as_slice()), dot(turned, f.as_slice())]).collect();
        let shared: f64 = products.iter().flatten().map(|product| product * product).sum();
        let distance = (base.ncols() as f64 - shared).max(0.0).sqrt();
        let factor = weight / distance.max(NEAREST);
        for (sum, [a, b]) in self.sums[0].as_mut_slice().chunks_exact_mut(length).zip(products) {
            add_scaled(sum, factor * a, q);
            add_scaled(sum, factor * b, turned);
        }
        Ok(())
    }
}

impl Accumulator for NearSum<'_> {
    fn unit(&self) -> usize {
        BLOCK
    }

    fn update(&mut self, shapes: Shapes<'_>) -> Result<(), AnalysisError> {
        shapes.iter().try_for_each(|(k, x, weight)| self.add(x, weight).map_err(|error| error.at(k)))
    }

    fn merge(&mut self, other: Self) {
        self.sums.iter_mut().zip(other.sums).for_each(|(sum, other)| *sum += other);
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.sums.iter().for_each(|sum| write_numbers(&mut bytes, sum.as_slice()));
        bytes
    }

    fn restore(&mut self, mut bytes: &[u8]) -> Result<(), AnalysisError> {
        for sum in &mut self.sums {
            let numbers = read_numbers(&mut bytes)?;
            if numbers.len() != sum.len() {
                return Err(AnalysisError::NotAnAccumulator);
            }
            sum.copy_from_slice(&numbers);
        }
        Ok(())
    }
}
