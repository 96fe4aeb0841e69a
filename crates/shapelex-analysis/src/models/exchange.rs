//! Exchanges of residuals: which shapes take whose, for each permutation.
//!
//! A statistic depends on an exchange only through the row of the design that each residual meets. Shapes with equal rows form a
//! *cell*, and an exchange is the list of the cells that the residuals go to: different lists are the distinct exchanges, which are
//! gone through one by one if there are no more of them than asked for.
//!
//! Sources: Anderson and ter Braak 2003; Winkler et al. 2014, 2015.

use std::collections::BTreeMap;

use crate::inference::permutation::Relabellings;
use crate::strata::strata as numbered;

/// Units of exchange.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum ExchangeKind {
    /// All residuals.
    #[default]
    Free,
    /// Residuals of shapes with equal values of the strata.
    Within,
    /// Whole blocks of equal size; each shape keeps its place in its block.
    Whole,
    /// Signs of the coefficients of whole groups.
    Signs,
}

/// The exchanges of the residuals of `n` shapes.
#[derive(Debug, Clone)]
pub enum Exchanges {
    /// Single residuals change places, within strata.
    Single(Relabellings),
    /// Whole blocks change places.
    Blocks(Blocks),
    /// Given lists: the shape whose residual each shape takes.
    Given(Vec<Vec<usize>>),
}

/// Exchanges of whole blocks.
#[derive(Debug, Clone)]
pub struct Blocks {
    /// Shapes of each block, in order.
    members: Vec<Vec<usize>>,
    /// Different lists of the cells of a block.
    patterns: Vec<Vec<usize>>,
    relabellings: Relabellings,
}

/// What is drawn.
#[derive(Debug, Clone, Copy)]
pub struct Draw<'a> {
    /// Stratum of each shape: nothing is exchanged between strata.
    pub strata: &'a [usize],
    /// Block of each shape.
    pub blocks: Option<&'a [usize]>,
    /// Kind of exchange.
    pub kind: ExchangeKind,
    /// Number of exchanges beside the observed one.
    pub permutations: usize,
    /// Seed.
    pub seed: u64,
}

impl Exchanges {
    /// Exchanges of shapes with these cells.
    ///
    /// # Errors
    /// The sizes of the blocks, if they are to be exchanged and no two are of one size.
    pub fn new(cells: &[usize], draw: Draw<'_>) -> Result<Self, Vec<usize>> {
        let count = cells.iter().max().map_or(0, |cell| cell + 1);
        let Draw { strata, blocks, kind, permutations, seed } = draw;
        match (kind, blocks) {
            (ExchangeKind::Whole, Some(blocks)) => {
                Blocks::new(cells, blocks, strata, permutations, seed).map(Self::Blocks)
            }
            (ExchangeKind::Within, Some(blocks)) => {
                // Finer than both: within equal values of strata and blocks.
                let strata = pairs(strata, blocks);
                Ok(Self::Single(Relabellings::new(cells.to_vec(), count, &strata, seed, permutations)))
            }
            _ => Ok(Self::Single(Relabellings::new(cells.to_vec(), count, strata, seed, permutations))),
        }
    }

    /// Number of exchanges that are made; if these are all, the observed one is among them.
    pub fn count(&self) -> usize {
        match self {
            Self::Single(relabellings) | Self::Blocks(Blocks { relabellings, .. }) => relabellings.draws(),
            Self::Given(orders) => orders.len(),
        }
    }

    /// Whether all distinct exchanges are made, the observed one among them.
    pub fn are_all(&self) -> bool {
        match self {
            Self::Single(relabellings) | Self::Blocks(Blocks { relabellings, .. }) => {
                relabellings.hold_observed()
            }
            Self::Given(_) => false,
        }
    }

    /// Number of distinct exchanges; infinite beyond the range of numbers.
    pub fn distinct(&self) -> f64 {
        match self {
            Self::Single(relabellings) | Self::Blocks(Blocks { relabellings, .. }) => relabellings.distinct(),
            Self::Given(orders) => orders.len() as f64,
        }
    }

    /// Writes the cell that each residual goes to in exchange `index`.
    pub fn cells(&self, index: usize, observed: &[usize], cells: &mut [usize]) {
        match self {
            Self::Single(relabellings) => relabellings.relabel(index, cells),
            Self::Blocks(blocks) => blocks.cells(index, cells),
            Self::Given(orders) => {
                for (row, &from) in orders[index].iter().enumerate() {
                    cells[from] = observed[row];
                }
            }
        }
    }
}

impl Blocks {
    fn new(
        cells: &[usize],
        blocks: &[usize],
        strata: &[usize],
        permutations: usize,
        seed: u64,
    ) -> Result<Self, Vec<usize>> {
        let mut members = vec![Vec::new(); blocks.iter().max().map_or(0, |block| block + 1)];
        blocks.iter().enumerate().for_each(|(k, &block)| members[block].push(k));
        let sizes: Vec<usize> = members.iter().map(Vec::len).collect();
        let alone = |size: &usize| sizes.iter().filter(|other| *other == size).count() < 2;
        if sizes.iter().all(alone) {
            return Err(sizes);
        }
        let mut numbers: BTreeMap<Vec<usize>, usize> = BTreeMap::new();
        let mut observed = Vec::with_capacity(members.len());
        for block in &members {
            let pattern: Vec<usize> = block.iter().map(|&k| cells[k]).collect();
            let next = numbers.len();
            observed.push(*numbers.entry(pattern).or_insert(next));
        }
        let mut patterns = vec![Vec::new(); numbers.len()];
        numbers.into_iter().for_each(|(pattern, number)| patterns[number] = pattern);
        // Blocks of one size whose shapes have the same strata form a class.
        let of_blocks =
            numbered(members.iter().map(|block| block.iter().map(|&k| strata[k]).collect::<Vec<_>>()));
        let relabellings = Relabellings::new(observed, patterns.len(), &of_blocks, seed, permutations);
        Ok(Self { members, patterns, relabellings })
    }

    fn cells(&self, index: usize, cells: &mut [usize]) {
        let mut labels = vec![0; self.members.len()];
        self.relabellings.relabel(index, &mut labels);
        for (block, &label) in self.members.iter().zip(&labels) {
            block.iter().zip(&self.patterns[label]).for_each(|(&k, &cell)| cells[k] = cell);
        }
    }
}

/// Numbers of the pairs of two labels, in the order in which they occur.
pub(super) fn pairs(a: &[usize], b: &[usize]) -> Vec<usize> {
    numbered(a.iter().zip(b))
}
