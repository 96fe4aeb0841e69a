//! Sums of a design over a stream of shapes.
//!
//! ```text
//! q_k     row k of Q, the orthonormal basis of the design, scaled by √w_k       y_k = √w_k (r_k − m)
//! U = Σ_k y_k q_kᵀ,  T = Σ_k ‖y_k‖²,  S = Σ_k y_k y_kᵀ                           as observed
//! U_b = Σ_k y_k q_{π_b(k)}ᵀ,  X_b = Σ_k q_k q_{π_b(k)}ᵀ                          of draw b, whose residual of shape k goes to π_b(k)
//! ```
//!
//! `U` and `T` are kept for each group of shapes. Cost for `n` shapes of `P` numbers, `q` columns and `B` draws: `n q (P + q)(1 + B)`
//! multiply-adds, `n P²/2` for `S`; memory `8 q (P + q) B` bytes and `8 G q P` for `G` groups, for each level of the tree of parts.

use super::keyed::KeyedExchange;
use super::rows::Rows;
use crate::AnalysisError;
use crate::accumulate::{Accumulator, BLOCK, OuterProductSum, PART, Shapes, read_numbers, write_numbers};
use crate::metric::dot;
use shapelex_numeric::dense::{self, Matrix};
use shapelex_numeric::kernels::add_scaled;
use shapelex_numeric::parallel;

/// Shapes whose numbers are scaled before they are multiplied. Changing it changes last bits.
const TOGETHER: usize = 16 * BLOCK;

/// Columns of the products of draws that are summed together. Changing it may change last bits.
const COLUMNS: usize = 128;

/// Numbers of a sum up to which several are made at once.
const SMALL: usize = 1 << 15;

/// The basis of a design: a row for each shape.
#[derive(Debug, Clone)]
pub(super) struct Basis {
    /// Row of each shape, and number of columns.
    pub(super) rows: Rows,
    pub(super) rank: usize,
    /// Rows one after the other, without the root of the weight.
    pub(super) numbers: Vec<f64>,
    /// Root of the weight of each shape; empty if all are 1.
    pub(super) roots: Vec<f64>,
    /// Group of each row, and number of groups.
    pub(super) groups: Vec<u32>,
    pub(super) count: usize,
}

impl Basis {
    fn root(&self, shape: usize) -> f64 {
        self.roots.get(shape).copied().unwrap_or(1.0)
    }

    fn row(&self, shape: usize) -> &[f64] {
        let first = self.rows.of(shape) * self.rank;
        &self.numbers[first..first + self.rank]
    }

    fn group(&self, shape: usize) -> usize {
        self.groups[self.rows.of(shape)] as usize
    }
}

/// What is summed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Summed<'a> {
    pub(super) basis: &'a Basis,
    /// `m`.
    pub(super) origin: &'a [f64],
    /// Draws.
    pub(super) exchange: Option<&'a KeyedExchange>,
    /// Whether `S` is wanted.
    pub(super) scatter: bool,
}

impl Summed<'_> {
    fn draws(&self) -> usize {
        self.exchange.map_or(0, KeyedExchange::draws)
    }

    /// Draws whose products are summed together.
    fn at_once(&self) -> usize {
        (COLUMNS / self.basis.rank.max(1)).max(1)
    }

    fn numbers(&self) -> usize {
        let (length, rank) = (self.origin.len(), self.basis.rank);
        length * rank * self.basis.count + self.draws() * rank * (length + rank)
    }
}

/// The sums.
#[derive(Debug, Clone)]
pub(super) struct DesignSums<'a> {
    summed: Summed<'a>,
    shapes: usize,
    /// `T` of each group.
    pub(super) squares: Vec<f64>,
    /// `U` of each group, for each column of the basis.
    cross: Vec<f64>,
    /// `S`.
    scatter: Option<OuterProductSum>,
    /// `U_b` and `X_b` of consecutive draws side by side.
    drawn: Vec<[Matrix; 2]>,
}

impl<'a> DesignSums<'a> {
    pub(super) fn new(summed: Summed<'a>) -> Self {
        let Summed { basis, origin, scatter, .. } = summed;
        let (length, rank, at_once, draws) = (origin.len(), basis.rank, summed.at_once(), summed.draws());
        let empty = |first: usize| {
            let columns = rank * at_once.min(draws - first);
            [Matrix::zeros(length, columns), Matrix::zeros(rank, columns)]
        };
        Self {
            summed,
            shapes: 0,
            squares: vec![0.0; basis.count],
            cross: vec![0.0; rank * basis.count * length],
            scatter: scatter.then(|| OuterProductSum::new(length)),
            drawn: (0..draws).step_by(at_once).map(empty).collect(),
        }
    }

    /// Number of shapes.
    pub(super) fn shapes(&self) -> usize {
        self.shapes
    }

    /// `U` of a group, a column for each of the basis.
    pub(super) fn cross_of(&self, group: usize) -> Matrix {
        let (length, groups) = (self.summed.origin.len(), self.summed.basis.count);
        Matrix::from_fn(length, self.summed.basis.rank, |i, j| self.cross[(j * groups + group) * length + i])
    }

    /// `U` of all groups.
    pub(super) fn cross(&self) -> Matrix {
        let zero = Matrix::zeros(self.summed.origin.len(), self.summed.basis.rank);
        (0..self.squares.len()).fold(zero, |sum, group| sum + self.cross_of(group))
    }

    /// `S`, if it was wanted.
    pub(super) fn scatter(&mut self) -> Option<Matrix> {
        self.scatter.take().map(OuterProductSum::into_matrix)
    }

    /// `U_b` and `X_b`.
    pub(super) fn drawn(&self, draw: usize) -> [Matrix; 2] {
        let (at_once, rank) = (self.summed.at_once(), self.summed.basis.rank);
        let first = draw % at_once * rank;
        self.drawn[draw / at_once].each_ref().map(|sums| sums.columns(first, rank).into_owned())
    }

    /// Adds shapes, at most [`TOGETHER`].
    fn add(&mut self, shapes: Shapes<'_>) {
        let Summed { basis, origin, .. } = self.summed;
        let (length, rank, count) = (origin.len(), basis.rank, shapes.weights.len());
        let mut scaled = vec![0.0; count * (length + rank)];
        let (columns, rows) = scaled.split_at_mut(count * length);
        let squares = parallel::map_chunks(columns, BLOCK * length, &|block, columns| {
            let own = shapes.block(block, BLOCK);
            let scale = |(column, (k, x, _)): (&mut [f64], (usize, &[f64], f64))| {
                let root = basis.root(k);
                column.iter_mut().zip(x).zip(origin).for_each(|((y, x), m)| *y = root * (x - m));
                dot(column, column)
            };
            columns.chunks_exact_mut(length).zip(own.iter()).map(scale).collect::<Vec<f64>>()
        });
        for (k, square) in (shapes.first..).zip(squares.into_iter().flatten()) {
            self.squares[basis.group(k)] += square;
        }
        for (k, row) in (shapes.first..).zip(rows.chunks_exact_mut(rank.max(1))) {
            row.iter_mut().zip(basis.row(k)).for_each(|(q, z)| *q = basis.root(k) * z);
        }
        let (columns, rows): (&[f64], &[f64]) = (columns, rows);
        parallel::for_each_chunk(&mut self.cross, basis.count * length, &|j, sums| {
            for (i, column) in columns.chunks_exact(length).enumerate() {
                let first = basis.group(shapes.first + i) * length;
                add_scaled(&mut sums[first..first + length], rows[i * rank + j], column);
            }
        });
        if let Some(scatter) = &mut self.scatter {
            scatter.add(columns);
        }
        self.add_drawn(shapes.first, columns, rows);
        self.shapes += count;
    }

    fn add_drawn(&mut self, first: usize, columns: &[f64], rows: &[f64]) {
        let Summed { basis, exchange: Some(exchange), origin, .. } = self.summed else { return };
        let (length, rank, at_once) = (origin.len(), basis.rank, self.summed.at_once());
        if rank == 0 {
            return;
        }
        let mut sums: Vec<(usize, &mut [Matrix; 2])> = self.drawn.iter_mut().enumerate().collect();
        parallel::map_each(&mut sums, &|(chunk, sums)| {
            let blocks = columns.chunks(BLOCK * length).zip(rows.chunks(BLOCK * rank));
            for (block, (columns, rows)) in blocks.enumerate() {
                let count = columns.len() / length;
                let mut factors = Matrix::zeros(count, sums[0].ncols());
                for (d, own) in factors.as_mut_slice().chunks_exact_mut(count * rank).enumerate() {
                    for i in 0..count {
                        let to = exchange.target(*chunk * at_once + d, first + block * BLOCK + i);
                        let root = basis.root(to);
                        for (j, z) in basis.row(to).iter().enumerate() {
                            own[j * count + i] = root * z;
                        }
                    }
                }
                dense::add_product(&mut sums[0], columns, &factors);
                dense::add_product(&mut sums[1], rows, &factors);
            }
        });
    }
}

impl Accumulator for DesignSums<'_> {
    fn unit(&self) -> usize {
        let is_small = self.summed.numbers() <= SMALL && self.summed.origin.len() <= 256;
        if is_small { TOGETHER } else { PART }
    }

    fn update(&mut self, mut shapes: Shapes<'_>) -> Result<(), AnalysisError> {
        while !shapes.weights.is_empty() {
            let (some, rest) = shapes.split_at(TOGETHER.min(shapes.weights.len()));
            self.add(some);
            shapes = rest;
        }
        Ok(())
    }

    fn merge(&mut self, other: Self) {
        self.shapes += other.shapes;
        let add = |own: &mut [f64], other: &[f64]| own.iter_mut().zip(other).for_each(|(a, b)| *a += b);
        add(&mut self.squares, &other.squares);
        add(&mut self.cross, &other.cross);
        if let (Some(own), Some(other)) = (&mut self.scatter, other.scatter) {
            own.merge(other);
        }
        for (own, other) in self.drawn.iter_mut().zip(&other.drawn) {
            own.iter_mut().zip(other).for_each(|(own, other)| *own += other);
        }
    }

    fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        write_numbers(&mut bytes, &[self.shapes as f64]);
        write_numbers(&mut bytes, &self.squares);
        write_numbers(&mut bytes, &self.cross);
        self.drawn.iter().flatten().for_each(|sums| write_numbers(&mut bytes, sums.as_slice()));
        self.scatter.iter().for_each(|scatter| scatter.write(&mut bytes));
        bytes
    }

    fn restore(&mut self, mut bytes: &[u8]) -> Result<(), AnalysisError> {
        let read = |bytes: &mut &[u8], own: &mut [f64]| {
            let numbers = read_numbers(bytes)?;
            if numbers.len() != own.len() {
                return Err(AnalysisError::NotAnAccumulator);
            }
            own.copy_from_slice(&numbers);
            Ok(())
        };
        let mut shapes = [0.0];
        read(&mut bytes, &mut shapes)?;
        self.shapes = shapes[0] as usize;
        read(&mut bytes, &mut self.squares)?;
        read(&mut bytes, &mut self.cross)?;
        for sums in self.drawn.iter_mut().flatten() {
            read(&mut bytes, sums.as_mut_slice())?;
        }
        self.scatter.as_mut().map_or(Ok(()), |scatter| scatter.read(&mut bytes))?;
        if bytes.is_empty() { Ok(()) } else { Err(AnalysisError::NotAnAccumulator) }
    }
}
