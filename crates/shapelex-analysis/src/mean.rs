//! The mean of a set of shapes modulo a class: the mean of their subspaces.
//!
//! ```text
//! S̄ = argmax_{dim = I} tr(P_S̄ Σ_k w_k P_k)
//! ```
//!
//! Every subspace is a point of a Grassmannian, and `S̄` is the chordal mean: unbiased and free of templates.
//! The top eigenvector of `Σ P_k` alone, as printed in (4.1), is not a shape for classes with repeated
//! eigenvalues (for `affine` it is a straight segment).
//!
//! | class | mean space |
//! |---|---|
//! | `linear`, `affine` | `span(f_1 … f_d) ⊗ R^d`, the top `d` eigenvectors of the `N × N` matrix `Σ w_k P'_k` |
//! | non-uniform scaling | the top eigenvector of every axis |
//! | all others | the top `I` eigenvectors of `Σ w_k P_k` |

use std::borrow::Cow;

use super::AnalysisError;
use super::accumulate::{
    Accumulator, BLOCK, OuterProductSum, ShapeSource, Shapes, accumulate, accumulate_spread, for_each_group,
    read_numbers, unit, write_numbers,
};
use super::metric::dot;
use super::pass::Sum;
use super::subspace::{Subspace, quarter_turn};
use super::transformation::{Structure, TransformationClass};
use shapelex_numeric::dense::{Eigenpairs, Matrix};
use shapelex_numeric::parallel;

/// Relative eigenvalue gap, as a fraction of the total weight, below which a mean is not unique.
pub const UNIQUE_GAP: f64 = 1e-6;

/// A shape that has moved since it was added to a sum.
#[derive(Debug, Clone)]
pub struct Exchange {
    /// Whitened shape as it was added.
    pub leaving: Vec<f64>,
    /// Whitened shape as it is now.
    pub arriving: Vec<f64>,
    /// Its weight.
    pub weight: f64,
}

/// `Σ_k w_k P_k`, block by block.
#[derive(Debug, Clone)]
pub struct ProjectorSum<'a> {
    class: &'a TransformationClass,
    /// Numbers of a shape, `d·N`.
    length: usize,
    blocks: Vec<OuterProductSum>,
    weight: f64,
    shapes: usize,
}

impl<'a> ProjectorSum<'a> {
    /// An empty sum for shapes of `length = d·N` numbers.
    pub fn new(class: &'a TransformationClass, length: usize) -> Self {
        let n = length / class.dimension();
        let blocks = match class.structure {
            Structure::PerCoordinate => vec![OuterProductSum::new(n)],
            Structure::PerAxis => vec![OuterProductSum::new(n); class.dimension()],
            Structure::Complex | Structure::General => vec![OuterProductSum::new(length)],
        };
        Self { class, length, blocks, weight: 0.0, shapes: 0 }
    }

    /// Replaces shapes in the sum, for searches that move a few shapes of many. Rounding errors accumulate, so a search
    /// recomputes its final sum. Returns `false`, doing nothing, for sums so small that recomputing them is as cheap.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`].
    pub fn exchange(&mut self, shapes: &[Exchange]) -> Result<bool, AnalysisError> {
        let numbers = Subspace::numbers(self.class, self.length);
        let bases = |pick: fn(&Exchange) -> &Vec<f64>| {
            let mut bases = vec![0.0; numbers * shapes.len()];
            for (basis, shape) in bases.chunks_exact_mut(numbers).zip(shapes) {
                Subspace::write_basis(self.class, pick(shape), shape.weight.sqrt(), basis)?;
            }
            Ok::<_, AnalysisError>(bases)
        };
        let (leaving, arriving) = (bases(|shape| &shape.leaving)?, bases(|shape| &shape.arriving)?);
        let count = self.blocks.len();
        let mut blocks = self.blocks.iter_mut().enumerate();
        Ok(blocks.all(|(b, block)| {
            let own = |bases| columns_of_block(bases, numbers / count, b, count);
            block.exchange(&own(&leaving), &own(&arriving))
        }))
    }

    /// Sum over all shapes of `source`.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] for the first degenerate shape; errors of the source.
    pub fn of(
        source: &dyn ShapeSource,
        class: &'a TransformationClass,
        length: usize,
    ) -> Result<Self, AnalysisError> {
        let empty = || Self::new(class, length);
        let here = || accumulate(source, empty);
        accumulate_spread(source, Sum::Projectors, empty, here)
    }
}

/// The columns of block `b` of `count` in bases one after the other, each with `numbers` numbers for every block.
fn columns_of_block(bases: &[f64], numbers: usize, b: usize, count: usize) -> Cow<'_, [f64]> {
    if count == 1 {
        return bases.into();
    }
    bases.chunks_exact(numbers).skip(b).step_by(count).flatten().copied().collect()
}

impl Accumulator for ProjectorSum<'_> {
    fn unit(&self) -> usize {
        unit(self.blocks[0].size())
    }

    fn update(&mut self, shapes: Shapes<'_>) -> Result<(), AnalysisError> {
        let class = self.class;
        let numbers = Subspace::numbers(class, self.length);
        for_each_group(shapes, self.blocks[0].size(), numbers, |group, columns| {
            parallel::try_for_each_chunk(columns, BLOCK * numbers, &|k, columns| {
                let mut rows = columns.chunks_exact_mut(numbers).zip(group.block(k, BLOCK).iter());
                rows.try_for_each(|(column, (position, x, weight))| {
                    Subspace::write_basis(class, x, weight.sqrt(), column).map_err(|error| error.at(position))
                })
            })?;
            group.weights.iter().for_each(|weight| self.weight += weight);
            self.shapes += group.weights.len();
            let count = self.blocks.len();
            for (b, block) in self.blocks.iter_mut().enumerate() {
                block.add(&columns_of_block(columns, numbers / count, b, count));
            }
            Ok(())
        })
    }

    fn merge(&mut self, other: Self) {
        self.blocks.iter_mut().zip(other.blocks).for_each(|(sum, other)| sum.merge(other));
        self.weight += other.weight;
        self.shapes += other.shapes;
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        write_numbers(&mut bytes, &[self.weight, self.shapes as f64]);
        self.blocks.iter().for_each(|block| block.write(&mut bytes));
        bytes
    }

    fn restore(&mut self, mut bytes: &[u8]) -> Result<(), AnalysisError> {
        let head = read_numbers(&mut bytes)?;
        let &[weight, shapes] = head.as_slice() else {
            return Err(AnalysisError::NotAnAccumulator);
        };
        (self.weight, self.shapes) = (weight, shapes as usize);
        self.blocks.iter_mut().try_for_each(|block| block.read(&mut bytes))
    }
}

/// The mean of the subspaces, with its certificate.
#[derive(Debug, Clone)]
pub struct MeanSpace<'a> {
    pub(super) class: &'a TransformationClass,
    /// Orthonormal basis of every block, whitened.
    pub(super) bases: Vec<Matrix>,
    /// Leading eigenvalues of `Σ w_k P_k` with multiplicity, in descending order. Divided by the total weight, they
    /// are mean squared cosines.
    pub eigenvalues: Vec<f64>,
    /// Smallest difference between a kept eigenvalue and the next one of the same block.
    pub gap: f64,
    /// `tr(P_S̄ Σ w_k P_k)`, the quantity that the mean maximises.
    pub objective: f64,
    /// Total weight, `Σ w_k`.
    pub weight: f64,
    /// Number of shapes.
    pub shapes: usize,
}

impl<'a> MeanSpace<'a> {
    /// The mean space of a sum, with at least `report` eigenvalues if there are that many.
    ///
    /// # Errors
    /// A failure of the eigenproblem.
    pub fn new(sum: ProjectorSum<'a>, report: usize) -> Result<Self, AnalysisError> {
        let class = sum.class;
        let (rank, multiplicity) = match class.structure {
            Structure::PerCoordinate => (class.dimension(), class.dimension()),
            Structure::PerAxis => (1, 1),
            Structure::Complex | Structure::General => (class.matrices().len(), 1),
        };
        let count = (rank + 1).max(report.div_ceil(multiplicity));
        // Sums of complex classes hold one vector of two.
        let leading = |block: OuterProductSum| match class.structure {
            Structure::Complex => block.leading_turned(count),
            _ => block.leading(count),
        };
        let pairs: Vec<Eigenpairs> = sum.blocks.into_iter().map(leading).collect::<Result<_, _>>()?;
        let value = |pairs: &Eigenpairs, i: usize| pairs.values.get(i).copied().unwrap_or(0.0).max(0.0);
        let gap = pairs.iter().map(|p| value(p, rank - 1) - value(p, rank)).fold(f64::MAX, f64::min);
        let kept: f64 = pairs.iter().map(|p| (0..rank).map(|i| value(p, i)).sum::<f64>()).sum();
        let mut eigenvalues: Vec<f64> = pairs
            .iter()
            .flat_map(|p| (0..p.values.len()).map(|i| value(p, i)))
            .flat_map(|value| std::iter::repeat_n(value, multiplicity))
            .collect();
        eigenvalues.sort_by(|a, b| b.total_cmp(a));
        eigenvalues.truncate(report.max(1));
        let bases = pairs.iter().map(|p| p.vectors.columns(0, rank).into_owned()).collect();
        let objective = kept * multiplicity as f64;
        Ok(Self { class, bases, eigenvalues, gap, objective, weight: sum.weight, shapes: sum.shapes })
    }

    /// The mean space of a sum, iterated from a mean space close to it. It has no certificate (no eigenvalues). The sum may go on.
    ///
    /// # Errors
    /// A failure of the eigenproblem.
    pub fn near(sum: &mut ProjectorSum<'a>, previous: &Self) -> Result<Self, AnalysisError> {
        let turned = sum.class.structure == Structure::Complex;
        let bases = sum.blocks.iter_mut().zip(&previous.bases);
        let bases: Option<Vec<Matrix>> =
            bases.map(|(block, near)| block.leading_subspace(near, turned)).collect();
        match bases {
            Some(bases) => Ok(Self { bases, eigenvalues: Vec::new(), ..previous.clone() }),
            None => Self::new(sum.clone(), 0),
        }
    }

    /// The subspace of one shape as a mean space.
    ///
    /// # Errors
    /// [`AnalysisError::Degenerate`] with index 0.
    pub fn from_shape(class: &'a TransformationClass, x: &[f64]) -> Result<Self, AnalysisError> {
        let mut bases: Vec<Matrix> =
            Subspace::new(class, x)?.blocks.into_iter().map(|block| block.q).collect();
        if class.structure == Structure::Complex {
            let turned = Matrix::from_vec(x.len(), 1, quarter_turn(bases[0].as_slice(), 1.0));
            bases[0] = Matrix::from_columns(&[bases[0].column(0), turned.column(0)]);
        }
        let objective = class.matrices().len() as f64;
        Ok(Self { class, bases, eigenvalues: Vec::new(), gap: 1.0, objective, weight: 1.0, shapes: 1 })
    }

    /// Whether the mean is unique: the gap is at least `10⁻⁶` of the total weight.
    pub fn is_unique(&self) -> bool {
        self.gap >= UNIQUE_GAP * self.weight
    }

    /// Orthonormal basis of the mean space as whitened shapes: `dN × I`.
    pub fn elements(&self) -> Matrix {
        let d = self.class.dimension();
        match self.class.structure {
            Structure::Complex | Structure::General => self.bases[0].clone(),
            Structure::PerCoordinate => {
                let (n, rank) = self.bases[0].shape();
                let mut elements = Matrix::zeros(d * n, d * rank);
                for c in 0..d {
                    elements.view_mut((c * n, c * rank), (n, rank)).copy_from(&self.bases[0]);
                }
                elements
            }
            Structure::PerAxis => {
                let n = self.bases[0].nrows();
                let mut elements = Matrix::zeros(d * n, d);
                for (c, base) in self.bases.iter().enumerate() {
                    elements.view_mut((c * n, c), (n, 1)).copy_from(base);
                }
                elements
            }
        }
    }

    /// Whitened coordinates of the member of the mean space nearest to the whitened shape `x`.
    pub fn project(&self, x: &[f64]) -> Vec<f64> {
        let elements = self.elements();
        let mut nearest = vec![0.0; x.len()];
        for element in elements.column_iter() {
            let product = dot(element.as_slice(), x);
            nearest.iter_mut().zip(element.iter()).for_each(|(sum, e)| *sum += product * e);
        }
        nearest
    }
}
