//! Regression by sums over parts of the shapes, for more shapes than fit into memory.
//!
//! ```text
//! x_k = (1, z_k, a_k)                               intercept, covariates, attribute, scaled to −1 … 1
//! G = Σ w x xᵀ = L Lᵀ,   C = Σ w (y − m) xᵀ,   T = Σ w ‖y − m‖²        the sums, about the mean m
//! q_k = √w_k L⁻¹ x_k,   U = C L⁻ᵀ = Σ √w (y − m) qᵀ
//! S_a = ‖U_a‖²,   S_reduced = T − Σ_{j ≠ a} ‖U_j‖²,   b = U_a/L_aa
//! ```
//!
//! These `q` are the orthonormal columns of [`regression`](super::regression), and the statistics are the same. Residuals are
//! exchanged within parts: the test of Freedman and Lane with the parts as strata, whose sums over parts add up as well. Parts
//! are as exchangeable as all shapes are, so the test keeps its level; of a single part it is that of
//! [`regression`](super::regression), draw by draw.

use super::limits::MIN_DEVIATION;
use super::permutation::Tally;
use super::reaches;
use super::records::AttributeSummary;
use super::regression::{COLLINEAR, COLUMNS, Collinear, Regression, part};
use crate::AnalysisError;
use crate::accumulate::{ShapeSource, read_numbers, write_numbers};
use crate::metric::dot;
use crate::preparation::{Posed, Preparation};
use crate::random::{shuffle, stream};
use crate::tangent::to_tangent;
use nalgebra::Cholesky;
use shapelex_numeric::dense::{self, Matrix};
use shapelex_numeric::parallel;

/// Square of the relative length below which a column is a combination of those before it: the least that sums of squares can tell
/// from rounding.
const DEPENDENT: f64 = 1e-12;

/// Bits of the number of a random stream that count draws; those above count parts.
const DRAW_BITS: u32 = 32;

/// Middle and half the range of a column of a design, by which it is scaled to −1 … 1.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Scale {
    middle: f64,
    spread: f64,
}

impl Scale {
    /// The scale of values from `smallest` to `largest`; `None` if these are equal up to rounding.
    pub fn of(smallest: f64, largest: f64) -> Option<Self> {
        let (middle, spread) = (smallest * 0.5 + largest * 0.5, largest * 0.5 - smallest * 0.5);
        (spread > COLLINEAR * largest.abs().max(smallest.abs())).then_some(Self { middle, spread })
    }

    fn scaled(self, value: f64) -> f64 {
        (value - self.middle) / self.spread
    }
}

/// Shapes of a part with their values.
#[derive(Debug, Clone)]
pub struct Observed {
    /// `y − m`, one column per shape.
    deviations: Matrix,
    /// `x`, one row per shape.
    design: Matrix,
    weights: Vec<f64>,
}

impl Observed {
    /// The shapes of `source`, aligned to the mean and in its tangent space if `tangent`, as far as they have values: `values` holds
    /// those of covariates and attribute for each shape, `None` if one is missing. `scales` holds the scale of each column.
    ///
    /// # Errors
    /// Degenerate shapes.
    pub fn new(
        source: &dyn ShapeSource,
        (preparation, tangent): (&Preparation, bool),
        scales: &[Scale],
        values: &[Option<Vec<f64>>],
    ) -> Result<Self, AnalysisError> {
        let (mean, length) = (&preparation.mean, preparation.metric.len());
        let complete = values.iter().filter(|values| values.is_some()).count();
        let (mut deviations, mut weights) =
            (Vec::with_capacity(complete * length), Vec::with_capacity(complete));
        Posed { source, preparation }.for_each_batch(&mut |batch| {
            for (k, shape, weight) in batch.iter().filter(|(k, ..)| values[*k].is_some()) {
                let first = deviations.len();
                deviations.extend_from_slice(shape);
                if tangent {
                    to_tangent(mean, &mut deviations[first..]).map_err(|error| error.at(k))?;
                }
                deviations[first..].iter_mut().zip(mean).for_each(|(y, m)| *y -= m);
                weights.push(weight);
            }
            Ok(())
        })?;
        let rows: Vec<&Vec<f64>> = values.iter().flatten().collect();
        let design = Matrix::from_fn(complete, scales.len() + 1, |k, j| match j.checked_sub(1) {
            None => 1.0,
            Some(column) => scales[column].scaled(rows[k][column]),
        });
        Ok(Self { deviations: Matrix::from_vec(length, complete, deviations), design, weights })
    }
}

/// The sums of a regression; those of several parts are added.
#[derive(Debug, Clone, PartialEq)]
pub struct RegressionSums {
    shapes: usize,
    /// `G`.
    products: Matrix,
    /// `C`.
    cross: Matrix,
    /// `T`.
    squares: f64,
}

impl RegressionSums {
    /// The sums of no shapes of `length` numbers, for `columns` columns beside the intercept.
    pub fn new(length: usize, columns: usize) -> Self {
        let size = columns + 1;
        Self {
            shapes: 0,
            products: Matrix::zeros(size, size),
            cross: Matrix::zeros(length, size),
            squares: 0.0,
        }
    }

    /// The sums of the shapes of a part. Cost `n (m + p)(p + 2)` multiply-adds for `n` shapes of `m` numbers and `p` columns.
    pub fn of(Observed { deviations, design, weights }: &Observed) -> Self {
        let mut weighted = design.clone();
        for (mut row, &weight) in weighted.row_iter_mut().zip(weights) {
            row.scale_mut(weight);
        }
        let squares = deviations.as_slice().chunks_exact(deviations.nrows());
        Self {
            shapes: weights.len(),
            products: dense::transpose_multiply(design, &weighted),
            cross: dense::multiply(deviations, &weighted),
            squares: squares.zip(weights).map(|(y, weight)| weight * dot(y, y)).sum(),
        }
    }

    /// Number of shapes.
    pub fn shapes(&self) -> usize {
        self.shapes
    }

    /// Adds the sums of other shapes. The order of additions affects the last bits.
    pub fn add(&mut self, other: &Self) {
        self.shapes += other.shapes;
        self.products += &other.products;
        self.cross += &other.cross;
        self.squares += other.squares;
    }

    /// Writes the sums: equal bytes for equal sums.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        write_numbers(&mut bytes, &[self.shapes as f64, self.squares]);
        write_numbers(&mut bytes, self.products.as_slice());
        write_numbers(&mut bytes, self.cross.as_slice());
        bytes
    }

    /// Reads the output of [`to_bytes`](Self::to_bytes), of sums of this size.
    ///
    /// # Errors
    /// [`AnalysisError::NotAnAccumulator`] for other bytes.
    pub fn restore(&mut self, mut bytes: &[u8]) -> Result<(), AnalysisError> {
        let single = read_numbers(&mut bytes)?;
        let (products, cross) = (read_numbers(&mut bytes)?, read_numbers(&mut bytes)?);
        let fit = products.len() == self.products.len() && cross.len() == self.cross.len();
        let ([shapes, squares], true, true) = (single.as_slice(), fit, bytes.is_empty()) else {
            return Err(AnalysisError::NotAnAccumulator);
        };
        (self.shapes, self.squares) = (*shapes as usize, *squares);
        self.products.copy_from_slice(&products);
        self.cross.copy_from_slice(&cross);
        Ok(())
    }

    /// The regression on the last column, which is scaled by `scale`. `m` is the mean that the sums are about.
    ///
    /// # Errors
    /// The first column that is constant or depends linearly on those before it.
    pub fn solve(&self, m: &[f64], scale: Scale) -> Result<Solved, Collinear> {
        let factor = self.factor()?;
        let last = factor.nrows() - 1;
        // `U = C L⁻ᵀ`, so `L Uᵀ = Cᵀ`.
        let coordinates = factor.solve_lower_triangular_unchecked(&self.cross.transpose()).transpose();
        let squares: Vec<f64> = coordinates.column_iter().map(|column| column.norm_squared()).collect();
        let total = (self.squares - squares[0]).max(0.0);
        let own = squares[last];
        let reduced = (self.squares - squares[..last].iter().sum::<f64>()).max(own);
        let per_unit = factor[(last, last)] * scale.spread;
        let weight = self.products[(0, 0)];
        let shift = self.products[(last, 0)] / weight;
        let (n, squared) = (self.shapes as f64, self.products[(last, last)] / weight - shift * shift);
        let identity = Matrix::identity(last + 1, last + 1);
        Ok(Solved {
            slope: coordinates.column(last).iter().map(|u| u / per_unit).collect(),
            average: m.iter().zip(self.cross.column(0).iter()).map(|(m, c)| m + c / weight).collect(),
            mean: scale.middle + scale.spread * shift,
            deviation: scale.spread * (squared.max(0.0) * n / (n - 1.0)).sqrt(),
            degrees: self.shapes.saturating_sub(last + 1),
            sums: [own, reduced, total],
            reduced: Reduced {
                inverse: factor.solve_lower_triangular_unchecked(&identity).as_slice().to_vec(),
                coordinates: coordinates.as_slice()[..self.cross.nrows() * last].to_vec(),
            },
        })
    }

    /// `L`, if every pivot is large enough.
    fn factor(&self) -> Result<Matrix, Collinear> {
        let collinear = |j: usize| match j.checked_sub(1) {
            Some(covariate) if j + 1 < self.products.nrows() => Collinear::Covariate(covariate),
            _ => Collinear::Attribute,
        };
        let independent = |size: usize| {
            let leading = self.products.view((0, 0), (size, size)).into_owned();
            let factor = Cholesky::new(leading)?.unpack();
            let large = |j: usize| factor[(j, j)].powi(2) > DEPENDENT * self.products[(j, j)];
            (0..size).all(large).then_some(factor)
        };
        let size = self.products.nrows();
        independent(size)
            .ok_or_else(|| collinear((1..size).find(|&size| independent(size).is_none()).unwrap_or(size) - 1))
    }
}

/// A regression from sums.
#[derive(Debug, Clone, PartialEq)]
pub struct Solved {
    /// `b`: change per unit of the attribute.
    slope: Vec<f64>,
    /// Mean of the aligned shapes.
    pub average: Vec<f64>,
    mean: f64,
    deviation: f64,
    degrees: usize,
    /// `S_a`, `S_reduced`, the total.
    sums: [f64; 3],
    /// Reduced model of the residuals.
    pub reduced: Reduced,
}

impl Solved {
    /// The regression with its test: `permuted` holds the sums of [`Reduced::permuted`] over all parts, of `draws` draws.
    pub fn regression(&self, permuted: &[f64], draws: usize) -> Regression {
        let [own, reduced, _] = self.sums;
        let columns = permuted.len() / draws.max(1);
        let reaching = permuted.chunks_exact(columns.max(1)).filter(|products| {
            let squares: Vec<f64> = products.chunks_exact(self.slope.len()).map(|u| dot(u, u)).collect();
            let last = squares.len() - 1;
            let left = (reduced - squares[..last].iter().sum::<f64>()).max(squares[last]);
            reaches(part(squares[last], left), part(own, reduced))
        });
        let tally = Tally { exceeding: reaching.count(), permutations: draws, exact: false };
        Regression::of(self.slope.clone(), self.sums, self.degrees, tally)
    }

    /// Summary of the attribute, whose values go from `smallest` to `largest`; `None` if they vary too little for a change per unit.
    pub fn summary(&self, name: String, [smallest, largest]: [f64; 2]) -> Option<AttributeSummary> {
        let Self { mean, deviation, .. } = *self;
        (deviation >= MIN_DEVIATION).then_some(AttributeSummary { name, mean, deviation, smallest, largest })
    }
}

/// The regression on the covariates alone, from which residuals are made.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Reduced {
    /// `L⁻¹`, column after column.
    inverse: Vec<f64>,
    /// `U` without the attribute, column after column.
    coordinates: Vec<f64>,
}

impl Reduced {
    /// Whether these are numbers for shapes of `length` numbers and `columns` columns beside the intercept.
    pub fn suits(&self, length: usize, columns: usize) -> bool {
        let size = columns + 1;
        self.inverse.len() == size * size && self.coordinates.len() == length * columns
    }

    /// For each draw the sums `R π[q_j]` over the shapes of the part with number `number`, for intercept, covariates and attribute:
    /// `m` numbers each. The sums of parts are added.
    ///
    /// Cost `n m (p + 1)` multiply-adds a draw; memory `8 m (p + 1)` bytes a draw.
    pub fn permuted(&self, observed: &Observed, number: usize, seed: u64, draws: usize) -> Vec<f64> {
        let Observed { deviations, design, weights } = observed;
        let (n, length, size) = (weights.len(), deviations.nrows(), design.ncols());
        let inverse = Matrix::from_column_slice(size, size, &self.inverse);
        // One column per shape.
        let mut q = dense::multiply(&inverse, &design.transpose());
        let mut residuals = deviations.clone();
        for ((mut q, mut residual), weight) in
            q.column_iter_mut().zip(residuals.column_iter_mut()).zip(weights)
        {
            q.scale_mut(weight.sqrt());
            residual.scale_mut(weight.sqrt());
        }
        let fitted = Matrix::from_column_slice(length, size - 1, &self.coordinates);
        residuals -= dense::multiply(&fitted, &q.rows(0, size - 1).into_owned());
        let members: Vec<usize> = (0..n).collect();
        let together = (COLUMNS / size).max(1);
        let batches = parallel::map(draws.div_ceil(together), &|batch| {
            let last = draws.min((batch + 1) * together);
            let mut permuted = Matrix::zeros(n, (last - batch * together) * size);
            for (b, draw) in (batch * together..last).enumerate() {
                let mut order = members.clone();
                let mut random = stream(seed, (number << DRAW_BITS) | draw);
                shuffle(&mut random, &members, &mut order);
                for (k, &from) in order.iter().enumerate() {
                    for j in 0..size {
                        permuted[(from, b * size + j)] = q[(j, k)];
                    }
                }
            }
            dense::multiply(&residuals, &permuted).as_slice().to_vec()
        });
        batches.concat()
    }
}

#[cfg(test)]
mod tests {
    use rand::RngExt;

    use super::*;
    use crate::inference::permutation::Draws;
    use crate::inference::regression::Design;
    use crate::watch::Unwatched;

    const SHAPES: usize = 90;
    const LENGTH: usize = 5;
    const DRAWS: usize = 199;

    fn noise(i: usize, k: usize) -> f64 {
        stream(23, 1000 * i + k).random_range(-0.5..0.5)
    }

    /// Covariates far from zero, an attribute that depends on them, shapes that depend on all of them.
    struct Sample {
        mean: Vec<f64>,
        shapes: Matrix,
        columns: Vec<Vec<f64>>,
        weights: Vec<f64>,
    }

    impl Sample {
        fn new(effect: f64) -> Self {
            let column = |j: usize| (0..SHAPES).map(|k| 1e4 + 30.0 * noise(j, k)).collect::<Vec<f64>>();
            let mut columns = vec![column(7), column(8), column(9)];
            for k in 0..SHAPES {
                columns[2][k] += 0.5 * columns[0][k];
            }
            let of = |i: usize, k: usize| {
                let a = columns[2][k] - 1.5e4;
                3.0 + noise(i, k) + 0.01 * i as f64 * (columns[0][k] - 1e4) + effect * a * (i as f64 - 1.0)
            };
            let shapes = Matrix::from_fn(LENGTH, SHAPES, of);
            let weights = (0..SHAPES).map(|k| 1.0 + (k % 3) as f64).collect();
            Self { mean: vec![3.1; LENGTH], shapes, columns, weights }
        }

        fn scales(&self) -> Vec<Scale> {
            let of = |column: &Vec<f64>| {
                let smallest = column.iter().copied().fold(f64::MAX, f64::min);
                Scale::of(smallest, column.iter().copied().fold(f64::MIN, f64::max)).unwrap()
            };
            self.columns.iter().map(of).collect()
        }

        fn observed(&self, members: std::ops::Range<usize>) -> Observed {
            let scales = self.scales();
            let design = Matrix::from_fn(members.len(), 4, |k, j| match j.checked_sub(1) {
                None => 1.0,
                Some(j) => scales[j].scaled(self.columns[j][members.start + k]),
            });
            let deviations = Matrix::from_fn(LENGTH, members.len(), |i, k| {
                self.shapes[(i, members.start + k)] - self.mean[i]
            });
            Observed { deviations, design, weights: self.weights[members].to_vec() }
        }

        /// The regression by sums over the shapes between each two of these positions.
        fn solved(&self, borders: &[usize]) -> Result<Solved, Collinear> {
            let mut sums = RegressionSums::new(LENGTH, 3);
            for part in borders.windows(2) {
                let mut read = RegressionSums::new(LENGTH, 3);
                read.restore(&RegressionSums::of(&self.observed(part[0]..part[1])).to_bytes()).unwrap();
                sums.add(&read);
            }
            sums.solve(&self.mean, self.scales()[2])
        }

        fn direct(&self) -> Regression {
            let design = Design::new(&self.columns[..2], &self.columns[2], &self.weights).unwrap();
            let strata = vec![0; SHAPES];
            let draws = Draws { strata: &strata, seed: 5, permutations: DRAWS };
            design.regress(&self.shapes, &self.weights, draws, &Unwatched).unwrap()
        }
    }

    fn near(a: f64, b: f64) -> bool {
        (a - b).abs() <= 1e-10 * a.abs().max(1.0)
    }

    #[test]
    fn sums_of_parts_give_the_regression_of_all_shapes_and_one_part_its_test() {
        for effect in [0.0, 0.004, 0.1] {
            let sample = Sample::new(effect);
            let expected = sample.direct();
            for borders in [&[0, SHAPES][..], &[0, 31, 32, SHAPES]] {
                let solved = sample.solved(borders).unwrap();
                let found = solved.regression(&[], 0);
                assert!(near(found.r_squared, expected.r_squared));
                assert!(near(found.partial_r_squared, expected.partial_r_squared));
                assert!(near(found.model_r_squared, expected.model_r_squared));
                assert!(near(found.pseudo_f.unwrap(), expected.pseudo_f.unwrap()));
                assert_eq!((found.degrees, found.tally.p()), (expected.degrees, None));
                assert!(found.slope.iter().zip(&expected.slope).all(|(a, b)| near(*a, *b)));
            }
            let solved = sample.solved(&[0, SHAPES]).unwrap();
            let permuted = solved.reduced.permuted(&sample.observed(0..SHAPES), 0, 5, DRAWS);
            assert_eq!(solved.regression(&permuted, DRAWS).tally, expected.tally, "{effect}");
        }
    }

    #[test]
    fn averages_and_deviations_are_those_of_the_shapes() {
        let sample = Sample::new(0.1);
        let solved = sample.solved(&[0, 40, SHAPES]).unwrap();
        let total: f64 = sample.weights.iter().sum();
        for i in 0..LENGTH {
            let row = sample.shapes.row(i);
            let mean = row.iter().zip(&sample.weights).map(|(y, w)| y * w).sum::<f64>() / total;
            assert!(near(solved.average[i], mean));
        }
        let (mean, deviation) =
            super::super::aligned::mean_and_deviation(&sample.columns[2], &sample.weights);
        let summary = solved.summary("a".into(), [0.0, 1.0]).unwrap();
        assert!(near(summary.mean, mean) && near(summary.deviation, deviation));
    }

    #[test]
    fn draws_within_parts_find_an_effect_and_agree_where_there_is_none() {
        let borders = [0, 30, 60, SHAPES];
        let sample = Sample::new(0.0);
        let solved = sample.solved(&borders).unwrap();
        let test = |seed: u64, solved: &Solved, sample: &Sample| {
            let mut sums = vec![0.0; DRAWS * LENGTH * 4];
            for (number, part) in borders.windows(2).enumerate() {
                let own = solved.reduced.permuted(&sample.observed(part[0]..part[1]), number, seed, DRAWS);
                sums.iter_mut().zip(own).for_each(|(sum, own)| *sum += own);
            }
            solved.regression(&sums, DRAWS).tally.p().unwrap()
        };
        let direct = sample.direct().tally.p().unwrap();
        let found = test(5, &solved, &sample);
        // Two estimates of one p value from 199 draws each differ by at most four standard errors.
        assert!((found - direct).abs() < 4.0 * (2.0 * direct * (1.0 - direct) / DRAWS as f64).sqrt() + 0.01);
        let effect = Sample::new(0.1);
        let solved = effect.solved(&borders).unwrap();
        assert_eq!(test(5, &solved, &effect), 1.0 / (1 + DRAWS) as f64);
    }

    #[test]
    fn columns_that_say_nothing_are_named() {
        assert_eq!(Scale::of(3.0, 3.0), None);
        assert_eq!(Scale::of(1e12, 1e12 + 1e-3), None);
        let mut sample = Sample::new(0.0);
        sample.columns[1] = sample.columns[0].iter().map(|x| 7.0 - 2.0 * x).collect();
        assert_eq!(sample.solved(&[0, SHAPES]).unwrap_err(), Collinear::Covariate(1));
        let mut sample = Sample::new(0.0);
        sample.columns[2] = (0..SHAPES).map(|k| sample.columns[0][k] + sample.columns[1][k]).collect();
        assert_eq!(sample.solved(&[0, SHAPES]).unwrap_err(), Collinear::Attribute);
    }
}
