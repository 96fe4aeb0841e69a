//! Sums of squares of the terms of a model, as observed and for exchanged residuals.
//!
//! With `U = QᵀY`, `E = Y − QU` and the reduced model `M_j = B_r B_rᵀ` of term `j`, the residuals of the reduced model are
//! `R_j = E + Q (I − M_j) U`. An exchange `π` makes the pseudo-data `Ŷ_j + R_j[π]`, of which
//!
//! ```text
//! A_j = QᵀR_j[π] = QᵀE[π] + (QᵀQ[π]) (I − M_j) U,   SS_j = ‖B_jᵀ A_j‖²,   RSS_j = ‖R_j‖² − ‖A_j‖²
//! ```
//!
//! so that all terms share the product `QᵀE[π]`. Where many shapes have one row of the design, it is made of the sums of `E` over the
//! shapes that go to each row.
//!
//! Sources: Freedman and Lane 1983; Anderson and ter Braak 2003; Collyer and Adams 2018.

use std::collections::BTreeMap;
use std::ops::Range;

use super::exchange::Exchanges;
use super::subspaces::{Hypothesis, Space};
use crate::AnalysisError;
use crate::watch::Watch;
use shapelex_numeric::dense::{self, Matrix};
use shapelex_numeric::kernels;
use shapelex_numeric::parallel;

/// Numbers of the residuals of a shape that are worked on together: with ten thousand shapes they stay in the cache.
const STRIP: usize = 16;
/// Exchanges of a batch, which share the strips.
const BATCH: usize = 32;
/// Most different rows of a design for which sums over them are made first.
const MOST_CELLS: usize = 128;

type Row = [f64; STRIP];

/// A response in the space of a design: residuals, and coordinates in the basis.
#[derive(Debug, Clone)]
pub struct Fitted {
    /// Different rows of the basis, one a column.
    rows: Matrix,
    /// Row of each shape.
    pub cells: Vec<usize>,
    /// `E` in strips of columns, each with a row for each shape.
    strips: Vec<Vec<Row>>,
    /// Sums of the rows of each strip, which no exchange changes.
    totals: Vec<Row>,
    /// Pairs of rows of `rows`, side by side for each of its columns; the last one is filled up with zeros.
    pairs: Vec<Vec<[f64; 2]>>,
    /// `U`, without the part of the intercept.
    coordinates: Matrix,
    /// `‖E‖²`.
    pub residual: f64,
    /// Sum of squares about the mean, or about zero without an intercept.
    pub total: f64,
}

/// Sums of squares of a term: its own, and that of the residuals.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sums {
    /// `SS_j`.
    pub own: f64,
    /// `RSS_j`.
    pub residual: f64,
}

impl Fitted {
    /// The response with the vectors of the shapes as columns, whose weights are those of the space. With an intercept, the response is
    /// taken about its mean.
    ///
    /// Cost: `n q P` multiply-adds for `n` vectors of length `P` and a design of rank `q`; with more numbers than shapes an
    /// eigenproblem of size `n` besides.
    ///
    /// # Errors
    /// A failure of the eigenproblem.
    pub fn new(space: &Space, vectors: &Matrix, has_intercept: bool) -> Result<Self, AnalysisError> {
        let mut scaled = vectors.clone();
        if has_intercept {
            let weights: Vec<f64> = space.roots().iter().map(|root| root * root).collect();
            crate::inference::span::centre_rows(&mut scaled, &weights);
        }
        space.scale(&mut scaled);
        let scaled = space.about_mean(scaled, has_intercept);
        let total = scaled.norm_squared();
        let transposed = dense::multiply(&scaled, &space.basis);
        let residuals = scaled - dense::multiply(&transposed, &space.basis.transpose());
        let residual = residuals.norm_squared();
        let (residuals, coordinates) = reduced(residuals, transposed)?;
        let (rows, cells) = different_rows(&space.basis);
        let strips = strips(&residuals);
        let total_of = |strip: &Vec<Row>| {
            let mut sum = [0.0; STRIP];
            strip.iter().for_each(|row| add(&mut sum, 1.0, row));
            sum
        };
        let totals = strips.iter().map(total_of).collect();
        let entry = |a: usize, cell: usize| if a < rows.nrows() { rows[(a, cell)] } else { 0.0 };
        let pair = |a: usize| (0..rows.ncols()).map(|cell| [entry(a, cell), entry(a + 1, cell)]).collect();
        let pairs = (0..rows.nrows()).step_by(2).map(pair).collect();
        Ok(Self { rows, cells, strips, totals, pairs, coordinates: coordinates.transpose(), residual, total })
    }

    /// Different rows of the basis, one a column for each cell.
    pub(super) fn rows_of_cells(&self) -> &Matrix {
        &self.rows
    }

    /// Squared length of the residual of each shape.
    pub fn squares(&self) -> Vec<f64> {
        let of = |k: usize| {
            self.strips.iter().map(|strip| strip[k].iter().map(|value| value * value).sum::<f64>()).sum()
        };
        (0..self.cells.len()).map(of).collect()
    }

    /// Sums of squares of each hypothesis, as observed.
    pub fn observed(&self, hypotheses: &[Hypothesis]) -> Vec<Sums> {
        let exchanges = Exchanges::Given(vec![(0..self.cells.len()).collect()]);
        let plans = self.plans(hypotheses);
        self.batch(&plans, &exchanges, 0..1).pop().unwrap_or_default()
    }

    /// Sums of squares of each hypothesis for each exchange. `watch` is asked before every batch, and counts the exchanges.
    ///
    /// Cost: `n P` additions an exchange where shapes share rows of the design, else `n q P` multiply-adds.
    ///
    /// # Errors
    /// [`AnalysisError::Interrupted`] once `watch` stops.
    pub fn permuted(
        &self,
        hypotheses: &[Hypothesis],
        exchanges: &Exchanges,
        watch: &dyn Watch,
    ) -> Result<Vec<Vec<Sums>>, AnalysisError> {
        let plans = self.plans(hypotheses);
        let count = exchanges.count();
        let batches = parallel::try_map(count.div_ceil(BATCH), &|batch| {
            watch.check()?;
            let range = batch * BATCH..count.min((batch + 1) * BATCH);
            let found = self.batch(&plans, exchanges, range);
            watch.worked(found.len());
            Ok::<_, AnalysisError>(found)
        })?;
        Ok(batches.into_iter().flatten().collect())
    }

    fn plans(&self, hypotheses: &[Hypothesis]) -> Vec<Plan> {
        let of = |hypothesis: &Hypothesis| {
            let fitted = dense::transpose_multiply(&hypothesis.reduced, &self.coordinates);
            let beyond = &self.coordinates - dense::multiply(&hypothesis.reduced, &fitted);
            let whole = self.residual + beyond.norm_squared();
            Plan { own: hypothesis.own.transpose(), beyond: strips(&beyond.transpose()), whole }
        };
        hypotheses.iter().map(of).collect()
    }

    fn batch(&self, plans: &[Plan], exchanges: &Exchanges, range: Range<usize>) -> Vec<Vec<Sums>> {
        let orders: Vec<Order> = range.map(|index| self.order(exchanges, index)).collect();
        let mut sums = vec![vec![Sums { own: 0.0, residual: 0.0 }; plans.len()]; orders.len()];
        for s in 0..self.strips.len() {
            for (order, sums) in orders.iter().zip(&mut sums) {
                let product = self.product(order, s);
                for (plan, sums) in plans.iter().zip(sums) {
                    let [own, all] = plan.squares(&product, &order.cross, s);
                    sums.own += own;
                    sums.residual += all;
                }
            }
        }
        for sums in &mut sums {
            for (plan, sums) in plans.iter().zip(sums) {
                sums.residual = (plan.whole - sums.residual).max(0.0);
            }
        }
        sums
    }

    /// Exchange `index`, with `QᵀQ[π]`.
    fn order(&self, exchanges: &Exchanges, index: usize) -> Order {
        let mut to = vec![0; self.cells.len()];
        exchanges.cells(index, &self.cells, &mut to);
        let (rank, count) = self.rows.shape();
        let shares = count <= MOST_CELLS && 2 * count <= to.len();
        if !shares {
            let mut cross = Matrix::zeros(rank, rank);
            for (&to, &from) in to.iter().zip(&self.cells) {
                for b in 0..rank {
                    let own = self.rows[(b, from)];
                    (0..rank).for_each(|a| cross[(a, b)] += self.rows[(a, to)] * own);
                }
            }
            return Order { to: To::Rows(to), cross };
        }
        // An exchange keeps the number of shapes of each row.
        let mut sizes = vec![0; count];
        self.cells.iter().for_each(|&cell| sizes[cell] += 1);
        let mut lists: Vec<Vec<u32>> = sizes.into_iter().map(Vec::with_capacity).collect();
        let mut counts = Matrix::zeros(count, count);
        for (k, (&to, &from)) in to.iter().zip(&self.cells).enumerate() {
            lists[to].push(k as u32);
            counts[(to, from)] += 1.0;
        }
        let cross = dense::multiply(&dense::multiply(&self.rows, &counts), &self.rows.transpose());
        let largest = (0..count).max_by_key(|cell| lists[*cell].len()).unwrap_or(0);
        Order { to: To::Cells { lists, largest }, cross }
    }

    /// `QᵀE[π]` for strip `s` of the columns of `E`, a row for each basis vector.
    fn product(&self, order: &Order, s: usize) -> Vec<Row> {
        let (rank, strip) = (self.rows.nrows(), &self.strips[s]);
        let mut product = vec![[0.0; STRIP]; rank];
        match &order.to {
            To::Rows(to) => {
                for (pair, two) in self.pairs.iter().zip(product.chunks_mut(2)) {
                    let mut sums = [[0.0; STRIP]; 2];
                    kernels::add_two_products(&mut sums, pair, strip, to);
                    two.copy_from_slice(&sums[..two.len()]);
                }
            }
            To::Cells { lists, largest } => {
                // What goes to the largest cell is the rest.
                let mut rest = self.totals[s];
                for (cell, list) in lists.iter().enumerate().filter(|(cell, _)| cell != largest) {
                    let mut of_cell = [0.0; STRIP];
                    kernels::add_listed(&mut of_cell, strip, list);
                    add(&mut rest, -1.0, &of_cell);
                    product
                        .iter_mut()
                        .enumerate()
                        .for_each(|(a, sum)| add(sum, self.rows[(a, cell)], &of_cell));
                }
                product.iter_mut().enumerate().for_each(|(a, sum)| add(sum, self.rows[(a, *largest)], &rest));
            }
        }
        product
    }
}

/// A hypothesis with what all exchanges share.
struct Plan {
    /// `B_jᵀ`.
    own: Matrix,
    /// `(I − M_j) U` in strips of columns.
    beyond: Vec<Vec<Row>>,
    /// `‖R_j‖²`.
    whole: f64,
}

impl Plan {
    /// `‖B_jᵀ A_j‖²` and `‖A_j‖²` of a strip, from `QᵀE[π]` and `QᵀQ[π]`.
    fn squares(&self, product: &[Row], cross: &Matrix, s: usize) -> [f64; 2] {
        let mut all = product.to_vec();
        for (b, beyond) in self.beyond[s].iter().enumerate() {
            for (a, sum) in all.iter_mut().enumerate() {
                add(sum, cross[(a, b)], beyond);
            }
        }
        let square = |row: &Row| row.iter().map(|value| value * value).sum::<f64>();
        let own = |i: usize| {
            let mut sum = [0.0; STRIP];
            all.iter().enumerate().for_each(|(a, row)| add(&mut sum, self.own[(i, a)], row));
            square(&sum)
        };
        [(0..self.own.nrows()).map(own).sum(), all.iter().map(square).sum()]
    }
}

/// Where residuals go.
enum To {
    /// Row of the design for each shape.
    Rows(Vec<usize>),
    /// Shapes for each row of the design, and the one with most.
    Cells { lists: Vec<Vec<u32>>, largest: usize },
}

struct Order {
    to: To,
    /// `QᵀQ[π]`.
    cross: Matrix,
}

fn add(sum: &mut Row, factor: f64, row: &Row) {
    sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += factor * value);
}

/// Columns of vectors of shapes, in strips of as many numbers: each has one row for each shape, filled up with zeros.
fn strips(vectors: &Matrix) -> Vec<Vec<Row>> {
    let of = |first: usize| {
        let row = |k: usize| {
            let mut row = [0.0; STRIP];
            row.iter_mut().zip(vectors.column(k).iter().skip(first)).for_each(|(own, value)| *own = *value);
            row
        };
        (0..vectors.ncols()).map(row).collect()
    };
    (0..vectors.nrows()).step_by(STRIP).map(of).collect()
}

/// Residuals and coordinates, both with a column of numbers for each shape or basis vector, in the fewest numbers that keep all their
/// products: those of their span, if it has fewer dimensions than the vectors have numbers.
pub(super) fn reduced(residuals: Matrix, coordinates: Matrix) -> Result<(Matrix, Matrix), AnalysisError> {
    let (length, shapes, rank) = (residuals.nrows(), residuals.ncols(), coordinates.ncols());
    let count = shapes + rank;
    if length <= count {
        return Ok((residuals, coordinates));
    }
    let mut all = Matrix::zeros(length, count);
    all.columns_mut(0, shapes).copy_from(&residuals);
    all.columns_mut(shapes, rank).copy_from(&coordinates);
    let gram = dense::gram(all.as_slice(), length);
    let pairs = dense::leading_eigenpairs(&gram, count)?;
    let largest = pairs.values.first().copied().unwrap_or(0.0);
    let kept = pairs.values.iter().take_while(|value| **value > 1e-15 * largest).count().max(1);
    let scores = Matrix::from_fn(kept, count, |i, k| pairs.values[i].max(0.0).sqrt() * pairs.vectors[(k, i)]);
    Ok((scores.columns(0, shapes).into_owned(), scores.columns(shapes, rank).into_owned()))
}

/// Different rows of a matrix, as columns, and the number of that of each row.
fn different_rows(matrix: &Matrix) -> (Matrix, Vec<usize>) {
    let mut numbers = BTreeMap::new();
    let mut firsts = Vec::new();
    let of = |k: usize| {
        let bits: Vec<u64> = matrix.row(k).iter().map(|value| value.to_bits()).collect();
        let next = numbers.len();
        *numbers.entry(bits).or_insert_with(|| {
            firsts.push(k);
            next
        })
    };
    let cells: Vec<usize> = (0..matrix.nrows()).map(of).collect();
    (Matrix::from_fn(matrix.ncols(), firsts.len(), |i, j| matrix[(firsts[j], i)]), cells)
}
