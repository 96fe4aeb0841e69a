//! Predicted cost of a model of a stream.

use super::design::{MOST_GROUPS, MOST_OF_GROUPS, MOST_OF_SCATTER};
use crate::dictionary::work::{EIGENPROBLEM, PRODUCT};
use crate::estimate::{Estimate, READING, mean_cost};
use crate::partial_sums::Measured;

/// Multiply-adds in whose time it is found where a draw takes a residual.
const TARGET: f64 = 16.0;
/// Sums that are held at the same time: open ones of a part, of the levels of the tree of parts, and one that is merged.
const COPIES: f64 = 6.0;
/// Numbers of a design in memory at the same time, for each row and column: columns, scaled ones, their basis, and copies.
const DESIGNS: f64 = 6.0;

/// Size of a model of a stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StreamWork {
    /// Number of shapes.
    pub shapes: usize,
    /// Most different rows of the design.
    pub rows: usize,
    /// Number of its columns.
    pub columns: usize,
    /// Number of attributes, those of strata among them.
    pub attributes: usize,
    /// Number of numbers of a response.
    pub length: usize,
    /// Number of terms.
    pub terms: usize,
    /// Number of permutations.
    pub permutations: usize,
    /// Whether shapes are modelled, and not numbers.
    pub of_shapes: bool,
}

impl Estimate {
    /// Cost of a model of a stream of shapes: the passes of their mean, and one more.
    pub fn for_stream(measured: Measured<'_>, work: &StreamWork) -> Self {
        let [shapes, rows, columns, attributes, length, terms, draws] = [
            work.shapes,
            work.rows,
            work.columns,
            work.attributes,
            work.length,
            work.terms,
            work.permutations,
        ]
        .map(|count| count as f64);
        let numbers = measured.metric.len() as f64;
        let (mean, of_mean) = if work.of_shapes { mean_cost(measured, work.shapes) } else { (0.0, 0.0) };
        let scatter = if work.length <= MOST_OF_SCATTER { length } else { 0.0 };
        let reading = READING * shapes * numbers;
        let sums = PRODUCT * shapes * (columns * (length + columns) * (1.0 + draws) + scatter * scatter);
        let solving = draws * terms * length * columns * columns + terms * EIGENPROBLEM * scatter.powi(3);
        let design = 4.0 * rows * columns * columns + shapes * 20.0 * attributes;
        let multiply_adds = mean + reading + sums + solving + design + TARGET * shapes * draws;
        let of_sums = draws * columns * (length + columns)
            + (length * columns * rows.min(MOST_GROUPS as f64)).min(MOST_OF_GROUPS as f64)
            + scatter * scatter;
        let of_shapes = shapes * (4.0 + 4.0 * attributes) + DESIGNS * rows * columns;
        let memory = of_mean + COPIES * of_sums + of_shapes + draws * (8.0 + 6.0 * terms);
        Self::of(work.shapes as u64, multiply_adds, 8.0 * memory)
    }
}
