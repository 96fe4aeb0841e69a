//! Rows of a design: shapes with equal values of all attributes share one.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use crate::models::anova::FEWEST_EXCHANGES;
use crate::models::design::{Table, Values};
use crate::models::error::ModelError;
use crate::models::formula::{Formula, Function};

/// Rows are shared if there are at most a quarter as many as shapes.
const SHARED: usize = 4;

/// Row of each shape.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rows {
    shapes: usize,
    /// Empty if each shape has its own row.
    of_shapes: Vec<u32>,
    /// First shape of each row; empty as well.
    firsts: Vec<u32>,
}

impl Rows {
    /// The rows of the attributes of some formulas. Polynomials are made of the values of all shapes, so each has its own row.
    pub(super) fn new(formulas: &[&Formula], table: &Table, shapes: usize) -> Self {
        let own = Self { shapes, of_shapes: Vec::new(), firsts: Vec::new() };
        let is_polynomial = |function: &Function| matches!(function, Function::Poly(_));
        let variables = || formulas.iter().flat_map(|formula| &formula.variables);
        if variables().any(|variable| is_polynomial(&variable.function)) {
            return own;
        }
        let names: BTreeSet<&str> = variables().map(|variable| variable.name.as_str()).collect();
        let columns: Vec<Vec<u64>> =
            names.into_iter().filter_map(|name| table.attributes.get(name)).map(bits).collect();
        if columns.iter().any(|column| column.len() != shapes) {
            return own;
        }
        let mut numbers: HashMap<Vec<u64>, u32> = HashMap::new();
        let (mut of_shapes, mut firsts) = (Vec::with_capacity(shapes), Vec::new());
        let mut key = vec![0; columns.len()];
        for k in 0..shapes {
            key.iter_mut().zip(&columns).for_each(|(bits, column)| *bits = column[k]);
            let row = match numbers.get(&key) {
                Some(row) => *row,
                None => {
                    let next = firsts.len() as u32;
                    numbers.insert(key.clone(), next);
                    firsts.push(k as u32);
                    next
                }
            };
            if firsts.len() > shapes / SHARED {
                return own;
            }
            of_shapes.push(row);
        }
        Self { shapes, of_shapes, firsts }
    }

    /// Number of rows.
    pub(super) fn count(&self) -> usize {
        if self.of_shapes.is_empty() { self.shapes } else { self.firsts.len() }
    }

    /// Number of shapes.
    pub(super) fn shapes(&self) -> usize {
        self.shapes
    }

    /// Row of a shape.
    pub(super) fn of(&self, shape: usize) -> usize {
        self.of_shapes.get(shape).map_or(shape, |row| *row as usize)
    }

    /// First shape of a row.
    fn first(&self, row: usize) -> usize {
        self.firsts.get(row).map_or(row, |first| *first as usize)
    }

    /// The table with one entry for each row.
    pub(super) fn table(&self, table: &Table) -> Table {
        if self.of_shapes.is_empty() {
            return table.clone();
        }
        let firsts = || self.firsts.iter().map(|first| *first as usize);
        let of = |values: &Values| match values {
            Values::Numbers(numbers) => Values::Numbers(firsts().map(|k| numbers[k]).collect()),
            Values::Texts(texts) => Values::Texts(firsts().map(|k| texts[k].clone()).collect()),
            Values::Levels { names, of_shapes } => {
                Values::Levels { names: names.clone(), of_shapes: firsts().map(|k| of_shapes[k]).collect() }
            }
        };
        let attributes = table.attributes.iter().map(|(name, values)| (name.clone(), of(values))).collect();
        Table { attributes, levels: table.levels.clone() }
    }

    /// Sums of numbers of the shapes of each row.
    pub(super) fn sums(&self, numbers: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut sums = vec![0.0; self.count()];
        numbers.enumerate().for_each(|(k, number)| sums[self.of(k)] += number);
        sums
    }

    /// Number of different lists of the rows that exchanges within strata make; infinite beyond the range of numbers, and where each
    /// shape has its own row, so that equal ones are not counted.
    pub(super) fn distinct(&self, strata: Option<&[u32]>) -> f64 {
        let stratum = |k: usize| strata.map_or(0, |strata| strata[k]);
        let mut sizes: BTreeMap<u32, usize> = BTreeMap::new();
        (0..self.shapes).for_each(|k| *sizes.entry(stratum(k)).or_insert(0) += 1);
        let mut counts: HashMap<(u32, usize), usize> = HashMap::new();
        if !self.of_shapes.is_empty() {
            (0..self.shapes).for_each(|k| *counts.entry((stratum(k), self.of(k))).or_insert(0) += 1);
        }
        // `n!` over the factorials of the numbers of equal rows, as a sum of logarithms.
        let of_sizes: f64 = sizes.values().map(|size| log_factorial(*size)).sum();
        let mut equal: Vec<usize> = counts.into_values().collect();
        equal.sort_unstable();
        let of_equal: f64 = equal.into_iter().map(log_factorial).sum();
        let all = (of_sizes - of_equal).exp();
        // Of rows of single shapes it is an upper bound, which tells only where there are too few.
        if self.of_shapes.is_empty() && all > FEWEST_EXCHANGES {
            return f64::INFINITY;
        }
        // Small numbers are whole.
        if all < 1e9 { all.round() } else { all }
    }

    /// The error with the shape in place of its row.
    pub(super) fn located(&self, error: ModelError) -> ModelError {
        match error {
            ModelError::Domain { name, expected, value, shape } => {
                ModelError::Domain { name, expected, value, shape: self.first(shape) }
            }
            ModelError::UnknownLevel { name, level, shape } => {
                ModelError::UnknownLevel { name, level, shape: self.first(shape) }
            }
            error => error,
        }
    }
}

/// Numbers that differ where values do.
fn bits(values: &Values) -> Vec<u64> {
    match values {
        Values::Numbers(numbers) => numbers.iter().map(|number| number.to_bits()).collect(),
        Values::Levels { of_shapes, .. } => of_shapes.iter().map(|level| u64::from(*level)).collect(),
        Values::Texts(texts) => {
            let mut known: HashMap<&str, u64> = HashMap::new();
            let mut numbers = Vec::with_capacity(texts.len());
            for text in texts {
                let next = known.len() as u64;
                numbers.push(*known.entry(text.as_str()).or_insert(next));
            }
            numbers
        }
    }
}

fn log_factorial(n: usize) -> f64 {
    (2..=n).map(|i| (i as f64).ln()).sum()
}
