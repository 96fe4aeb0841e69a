//! Two-block partial least squares: the directions of two blocks whose scores covary most.
//!
//! ```text
//! S_12 = XᵀY/(n − 1) = U Σ Vᵀ,   r = cor(X u_1, Y v_1),   RV = ‖S_12‖²/(‖S_11‖ ‖S_22‖)      (columns of X and Y about their means)
//! ```
//!
//! The subjects of one block are exchanged, within strata. With weights `w`, means, covariances and correlations are weighted; weights of
//! mean 1 leave `n − 1` as it is.
//!
//! Sources: Rohlf and Corti 2000; Escoufier 1973.

use std::collections::BTreeMap;

use super::error::BlocksError;
use super::records::{
    BlockComponentRecord, BlockPairRecord, BlockRecord, BlocksRecord, LoadingRecord, Tail, TestedStatistic,
};
use crate::AnalysisError;
use crate::inference::permutation::Relabellings;
use crate::inference::span::{Span, centre_rows};
use crate::metric::{Metric, norm};
use crate::models::effect_size::Transform;
use crate::random::{shuffle, stream};
use crate::rows::rows_of;
use crate::watch::{Counted, Watch};
use shapelex_numeric::dense::{self, Matrix};
use shapelex_numeric::parallel;

/// Fewest subjects.
pub const MIN_SUBJECTS: usize = 4;
/// Pairs of singular shapes that are told.
const COMPONENTS: usize = 10;
/// Singular value over the first below which a pair is rounding error.
const RANK: f64 = 1e-7;

/// Meaning of the numbers of a block.
#[derive(Debug, Clone)]
pub enum Form<'a> {
    /// Whitened shapes.
    Shape(&'a Metric),
    /// Control points of this dimension, coordinate-major.
    Points(usize),
    /// Numbers with names.
    Numbers(Vec<String>),
}

/// Vectors of the subjects, one a column.
#[derive(Debug, Clone)]
pub struct Block<'a> {
    /// Name of the block.
    pub name: String,
    /// The vectors, in a Euclidean metric.
    pub vectors: Matrix,
    /// Their meaning.
    pub form: Form<'a>,
}

/// How subjects are exchanged.
#[derive(Debug, Clone, Copy)]
pub struct Sampling<'a> {
    /// Stratum of each subject: nothing is exchanged between strata.
    pub strata: &'a [usize],
    /// Number of permutations.
    pub permutations: usize,
    /// Seed.
    pub seed: u64,
    /// Transformation of Z.
    pub transform: Transform,
    /// Given orders of the first block, in place of drawn ones.
    pub given: Option<&'a [Vec<usize>]>,
}

/// Results, with the scores of the first pair of singular shapes of the first two blocks.
#[derive(Debug, Clone, PartialEq)]
pub struct BlocksFound {
    /// The record.
    pub record: BlocksRecord,
    /// Scores of each subject in the first and the second block.
    pub scores: Vec<[f64; 2]>,
}

impl<'a> Block<'a> {
    /// The block of attributes of the subjects, each standardised.
    ///
    /// # Errors
    /// An attribute that does not vary; `block`: position of the block.
    pub fn of_numbers(
        block: usize,
        numbers: &[(String, Vec<f64>)],
        weights: &[f64],
    ) -> Result<Self, BlocksError> {
        let mut vectors = Matrix::from_fn(numbers.len(), weights.len(), |i, k| numbers[i].1[k]);
        centre_rows(&mut vectors, weights);
        let total: f64 = weights.iter().sum();
        for (mut row, (name, values)) in vectors.row_iter_mut().zip(numbers) {
            let squares: f64 = row.iter().zip(weights).map(|(x, w)| w * x * x).sum();
            let deviation = (squares / total).sqrt();
            let largest = values.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
            if !(deviation > 1e-12 * largest) {
                return Err(BlocksError::Constant { block, name: name.clone() });
            }
            row.unscale_mut(deviation);
        }
        let names: Vec<String> = numbers.iter().map(|(name, _)| name.clone()).collect();
        Ok(Self { name: names.join(", "), vectors, form: Form::Numbers(names) })
    }

    fn record(&self, weights: &[f64]) -> BlockRecord {
        let total: f64 = weights.iter().sum();
        let mean = || -> Vec<f64> {
            let of = |row: &mut dyn Iterator<Item = &f64>| {
                row.zip(weights).map(|(x, w)| w * x).sum::<f64>() / total
            };
            self.vectors.row_iter().map(|row| of(&mut row.iter())).collect()
        };
        let average = match &self.form {
            Form::Numbers(_) => None,
            _ => self.rows(&mean()),
        };
        BlockRecord { name: self.name.clone(), numbers: self.vectors.nrows(), average }
    }

    /// Control points of a vector.
    fn rows(&self, vector: &[f64]) -> Option<Vec<Vec<f64>>> {
        match &self.form {
            Form::Shape(metric) => Some(metric.rows(vector)),
            Form::Points(dimension) => Some(rows_of(vector, *dimension)),
            Form::Numbers(_) => None,
        }
    }

    fn loading(&self, direction: &[f64], deviation: f64) -> LoadingRecord {
        let labels = match &self.form {
            Form::Numbers(names) => {
                Some(names.iter().cloned().zip(direction.iter().copied()).collect::<BTreeMap<_, _>>())
            }
            _ => None,
        };
        LoadingRecord { shape: self.rows(direction), labels, deviation }
    }
}

/// How blocks of the same subjects vary together. More than two blocks are told pair by pair, and by the mean of the correlations; then
/// all blocks but the last are exchanged, each by separate draws.
///
/// Cost: an eigenproblem of the smaller of subjects and numbers for each block; for each permutation and pair `n k_1 k_2` multiply-adds
/// and the leading eigenpair of the smaller of `k_1` and `k_2`, where `k < n` numbers span a block.
///
/// # Errors
/// Too few subjects; a block without variation; [`AnalysisError::Interrupted`] once `watch` stops.
pub fn two_blocks(
    blocks: &[Block<'_>],
    weights: &[f64],
    sampling: &Sampling<'_>,
    watch: &dyn Watch,
) -> Result<BlocksFound, BlocksError> {
    if weights.len() < MIN_SUBJECTS {
        return Err(BlocksError::FewSubjects { found: weights.len(), needed: MIN_SUBJECTS });
    }
    let mean = weights.iter().sum::<f64>() / weights.len() as f64;
    let weights: Vec<f64> = weights.iter().map(|weight| weight / mean).collect();
    let sides = blocks.iter().enumerate().map(|(k, block)| Side::new(k, block, &weights));
    let sides = sides.collect::<Result<Vec<Side>, _>>()?;
    let pairs: Vec<[usize; 2]> =
        (0..blocks.len()).flat_map(|a| (a + 1..blocks.len()).map(move |b| [a, b])).collect();
    let orders = Orders::new(sampling, blocks.len(), weights.len());
    let identity: Vec<Vec<usize>> = vec![(0..weights.len()).collect(); blocks.len()];
    let observed = statistics(&sides, &pairs, &weights, &identity)?;
    let counted = Counted::new(watch, orders.count());
    let drawn = parallel::try_map(orders.count(), &|index| {
        counted.check()?;
        let found = statistics(&sides, &pairs, &weights, &orders.of(index));
        counted.worked(1);
        found
    })?;
    let exact = orders.are_all();
    let tested = |value: f64, of: &dyn Fn(&Vec<[f64; 2]>) -> f64| {
        let values: Vec<f64> = drawn.iter().map(of).collect();
        TestedStatistic::of(value, &values, exact, sampling.transform, Tail::Upper)
    };
    let mut scores = Vec::new();
    let mut records = Vec::with_capacity(pairs.len());
    for (i, &[a, b]) in pairs.iter().enumerate() {
        let pair =
            Pair { blocks: [&blocks[a], &blocks[b]], sides: [&sides[a], &sides[b]], weights: &weights };
        let components = pair.components(if i == 0 { Some(&mut scores) } else { None })?;
        records.push(BlockPairRecord {
            first: blocks[a].name.clone(),
            second: blocks[b].name.clone(),
            r: tested(observed[i][0], &|of| of[i][0]),
            rv: tested(observed[i][1], &|of| of[i][1]),
            components,
        });
    }
    let average = |of: &Vec<[f64; 2]>| of.iter().map(|[r, _]| r).sum::<f64>() / of.len() as f64;
    let record = BlocksRecord {
        blocks: blocks.iter().map(|block| block.record(&weights)).collect(),
        pairs: records,
        overall: (pairs.len() > 1).then(|| tested(average(&observed), &average)),
        warnings: Vec::new(),
    };
    Ok(BlocksFound { record, scores })
}

/// A block in coordinates of its span, about its mean.
struct Side {
    coordinates: Matrix,
    /// `‖S_11‖ (n − 1)`.
    norm: f64,
    is_weighted: bool,
}

impl Side {
    fn new(k: usize, block: &Block<'_>, weights: &[f64]) -> Result<Self, BlocksError> {
        let span = Span::new(&block.vectors, weights)?;
        let largest = span.eigenvalues.first().copied().unwrap_or(0.0);
        if !(largest > 1e-24 * block.vectors.norm_squared()) {
            return Err(BlocksError::Constant { block: k, name: block.name.clone() });
        }
        let is_weighted = weights.iter().any(|weight| *weight != weights[0]);
        Ok(Self { coordinates: span.scores, norm: norm(&span.eigenvalues), is_weighted })
    }

    /// Coordinates of the subjects in another order, and the norm of their covariances.
    fn ordered(&self, order: &[usize], weights: &[f64]) -> (Matrix, f64) {
        let own = &self.coordinates;
        let mut moved = Matrix::from_fn(own.nrows(), own.ncols(), |i, k| own[(i, order[k])]);
        if !self.is_weighted {
            return (moved, self.norm);
        }
        centre_rows(&mut moved, weights);
        let scaled = scaled(&moved, weights);
        let norm = dense::multiply(&scaled, &moved.transpose()).norm();
        (moved, norm)
    }
}

/// Columns times weights.
fn scaled(columns: &Matrix, weights: &[f64]) -> Matrix {
    let mut scaled = columns.clone();
    scaled.column_iter_mut().zip(weights).for_each(|(mut column, weight)| column.scale_mut(*weight));
    scaled
}

/// `r` and `RV` of each pair, with the subjects of each block in an order.
fn statistics(
    sides: &[Side],
    pairs: &[[usize; 2]],
    weights: &[f64],
    orders: &[Vec<usize>],
) -> Result<Vec<[f64; 2]>, AnalysisError> {
    let moved: Vec<(Matrix, f64)> =
        sides.iter().zip(orders).map(|(side, order)| side.ordered(order, weights)).collect();
    let of = |&[a, b]: &[usize; 2]| {
        let ((x, of_x), (y, of_y)) = (&moved[a], &moved[b]);
        let cross = dense::multiply(x, &scaled(y, weights).transpose());
        let first = singular_pairs(&cross, 1)?;
        let r = first.first().and_then(|pair| correlation(&pair.scores(x, y), weights));
        Ok([r.unwrap_or(0.0), cross.norm_squared() / (of_x * of_y)])
    };
    pairs.iter().map(of).collect()
}

/// A singular value with its vectors.
struct Singular {
    value: f64,
    u: Vec<f64>,
    v: Vec<f64>,
}

impl Singular {
    fn scores(&self, x: &Matrix, y: &Matrix) -> [Vec<f64>; 2] {
        let along =
            |columns: &Matrix, direction: &[f64]| dense::transpose_multiply_columns(columns, direction);
        [along(x, &self.u), along(y, &self.v)].map(|scores| scores.as_slice().to_vec())
    }
}

/// Leading singular values of `s` with their vectors, from the eigenpairs of the smaller of its products.
fn singular_pairs(s: &Matrix, count: usize) -> Result<Vec<Singular>, AnalysisError> {
    let is_wide = s.nrows() <= s.ncols();
    let narrow = if is_wide { s.transpose() } else { s.clone() };
    let pairs = dense::leading_eigenpairs(&dense::transpose_multiply(&narrow, &narrow), count)?;
    let largest = pairs.values.first().copied().unwrap_or(0.0).max(0.0).sqrt();
    let of = |i: usize| {
        let own = pairs.vectors.column(i).as_slice().to_vec();
        let image = dense::multiply(&narrow, &Matrix::from_column_slice(own.len(), 1, &own));
        let value = image.norm();
        let other: Vec<f64> = image.iter().map(|x| x / value).collect();
        let [u, v] = if is_wide { [own, other] } else { [other, own] };
        (value > 0.0 && value > RANK * largest).then_some(Singular { value, u, v })
    };
    Ok((0..pairs.values.len()).map_while(of).collect())
}

/// Weighted correlation; `None` where one of the lists does not vary.
fn correlation([a, b]: &[Vec<f64>; 2], weights: &[f64]) -> Option<f64> {
    let mut rows = Matrix::from_fn(2, a.len(), |i, k| if i == 0 { a[k] } else { b[k] });
    centre_rows(&mut rows, weights);
    let product = |i: usize, j: usize| {
        weights.iter().enumerate().map(|(k, w)| w * rows[(i, k)] * rows[(j, k)]).sum::<f64>()
    };
    let sizes = (product(0, 0) * product(1, 1)).sqrt();
    (sizes > 0.0).then(|| (product(0, 1) / sizes).clamp(-1.0, 1.0))
}

/// Two blocks.
struct Pair<'a> {
    blocks: [&'a Block<'a>; 2],
    sides: [&'a Side; 2],
    weights: &'a [f64],
}

impl Pair<'_> {
    /// Pairs of singular shapes; the scores of the first go to `keep`.
    fn components(
        &self,
        mut keep: Option<&mut Vec<[f64; 2]>>,
    ) -> Result<Vec<BlockComponentRecord>, AnalysisError> {
        let [x, y] = self.sides.map(|side| &side.coordinates);
        let cross = dense::multiply(x, &scaled(y, self.weights).transpose());
        let (all, free) = (cross.norm_squared(), self.weights.len() as f64 - 1.0);
        let of = |singular: Singular| {
            let [mut a, mut b] = singular.scores(x, y);
            // u ∝ X v-scores: from the vectors themselves, of which the coordinates are an isometric image.
            let mut directions = [self.direction(0, &b), self.direction(1, &a)];
            let largest =
                directions[0].iter().fold(0.0, |most: f64, x| if x.abs() > most.abs() { *x } else { most });
            if largest < 0.0 {
                let negate = |list: &mut Vec<f64>| list.iter_mut().for_each(|x| *x = -*x);
                directions.iter_mut().chain([&mut a, &mut b]).for_each(negate);
            }
            let deviation = |scores: &[f64]| {
                (scores.iter().zip(self.weights).map(|(x, w)| w * x * x).sum::<f64>() / free).sqrt()
            };
            let record = BlockComponentRecord {
                singular_value: singular.value / free,
                share: singular.value.powi(2) / all,
                first: self.blocks[0].loading(&directions[0], deviation(&a)),
                second: self.blocks[1].loading(&directions[1], deviation(&b)),
                correlation: correlation(&[a.clone(), b.clone()], self.weights),
            };
            if let Some(scores) = keep.take() {
                *scores = a.into_iter().zip(b).map(|(a, b)| [a, b]).collect();
            }
            record
        };
        Ok(singular_pairs(&cross, COMPONENTS)?.into_iter().map(of).collect())
    }

    /// Unit vector along `Σ_k w_k s_k (x_k − x̄)` of a block, for scores `s` of the other one, whose mean is zero.
    fn direction(&self, block: usize, scores: &[f64]) -> Vec<f64> {
        let vectors = &self.blocks[block].vectors;
        let mut sum = vec![0.0; vectors.nrows()];
        let first = vectors.column(0);
        for (k, (score, weight)) in scores.iter().zip(self.weights).enumerate() {
            let own = vectors.column(k);
            let change = own.iter().zip(first.iter()).map(|(x, first)| x - first);
            sum.iter_mut().zip(change).for_each(|(sum, x)| *sum += weight * score * x);
        }
        let size = norm(&sum);
        sum.into_iter().map(|x| x / size).collect()
    }
}

/// Orders of the subjects of the blocks.
struct Orders<'a> {
    sampling: &'a Sampling<'a>,
    blocks: usize,
    subjects: usize,
    /// Orders of the second of two blocks, drawn or all of them; `None` of more blocks.
    one: Option<Relabellings>,
    members: Vec<Vec<usize>>,
}

impl<'a> Orders<'a> {
    fn new(sampling: &'a Sampling<'a>, blocks: usize, subjects: usize) -> Self {
        let Sampling { strata, permutations, seed, .. } = *sampling;
        let mut members = vec![Vec::new(); strata.iter().max().map_or(0, |last| last + 1)];
        strata.iter().enumerate().for_each(|(k, &stratum)| members[stratum].push(k));
        let one = (blocks == 2)
            .then(|| Relabellings::new((0..subjects).collect(), subjects, strata, seed, permutations));
        Self { sampling, blocks, subjects, one, members }
    }

    fn count(&self) -> usize {
        let drawn = self.one.as_ref().map_or(self.sampling.permutations, Relabellings::draws);
        self.sampling.given.map_or(drawn, <[_]>::len)
    }

    fn are_all(&self) -> bool {
        self.sampling.given.is_none() && self.one.as_ref().is_some_and(Relabellings::hold_observed)
    }

    /// Orders of all blocks in exchange `index`; the last block stays.
    fn of(&self, index: usize) -> Vec<Vec<usize>> {
        let mut orders = vec![(0..self.subjects).collect::<Vec<usize>>(); self.blocks];
        match (self.sampling.given, &self.one) {
            (Some(given), _) => orders[0].clone_from(&given[index]),
            (None, Some(one)) => one.relabel(index, &mut orders[0]),
            (None, None) => {
                for (block, order) in orders.iter_mut().enumerate().take(self.blocks - 1) {
                    let mut random = stream(self.sampling.seed.wrapping_add(block as u64), index);
                    self.members.iter().for_each(|members| shuffle(&mut random, members, order));
                }
            }
        }
        orders
    }
}
