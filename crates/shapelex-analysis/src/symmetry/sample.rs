//! The table of individuals and sides.
//!
//! Type I in the order individual, side, individual × side. Individuals and sides are tested on the averages of the replicates of each
//! individual and side, whose residuals are individual × side: individuals by exchanges within the sides, sides by exchanges within the
//! individuals, the `2^I` flips of the signs of the differences. The interaction is tested against the replicates. The ratio of two
//! mean squares permuted apart has no level.

use std::collections::BTreeMap;

use super::error::{MIN_INDIVIDUALS, SymmetryError};
use super::records::{SymmetryTable, SymmetryTerm};
use crate::models::anova::{ExchangeRule, Model, Testing};
use crate::models::design::{Contrasts, Table, Values};
use crate::models::effect_size::Transform;
use crate::models::error::ModelError;
use crate::models::formula::{Formula, TermOrder};
use crate::models::records::{TermRecord, share};
use crate::models::subspaces::SumType;
use crate::watch::Watch;
use shapelex_numeric::dense::Matrix;

/// Name of the interaction, the error of individuals and sides.
const INTERACTION: &str = "individual:side";

/// Individual and side of each vector.
#[derive(Debug, Clone, Copy)]
pub struct Sides<'a> {
    /// Names of the individuals.
    pub names: &'a [String],
    /// Individual of each vector.
    pub individual: &'a [usize],
    /// Side of each vector: 0 left, 1 mirrored right.
    pub side: &'a [usize],
    /// Vectors that were measured together, such as a shape and its own image: they are exchanged as one. `None`: each alone.
    pub measured: Option<&'a [usize]>,
}

/// How the table is tested.
#[derive(Debug, Clone, Copy, Default)]
pub struct SymmetryTesting<'a> {
    /// Number of permutations.
    pub permutations: usize,
    /// Seed.
    pub seed: u64,
    /// Transformation of Z.
    pub transform: Transform,
    /// Given exchanges of the vectors, for the interaction.
    pub given: Option<&'a [Vec<usize>]>,
    /// Given exchanges of the averages, individual by individual with left before right, for the individuals.
    pub given_averages: Option<&'a [Vec<usize>]>,
}

/// Averages of the replicates, individual by individual with left before right.
#[derive(Debug, Clone)]
pub struct Averages {
    /// The averages, one a column.
    pub vectors: Matrix,
    /// Sums of the weights.
    pub weights: Vec<f64>,
    /// Whether there are replicates.
    pub has_replicates: bool,
}

impl Averages {
    /// Averages of `vectors`, one a column.
    ///
    /// # Errors
    /// Too few individuals, or one without one of the sides.
    pub fn new(vectors: &Matrix, weights: &[f64], sides: &Sides<'_>) -> Result<Self, SymmetryError> {
        let count = sides.names.len();
        if count < MIN_INDIVIDUALS {
            return Err(SymmetryError::FewIndividuals { found: count });
        }
        let cells: Vec<usize> =
            sides.individual.iter().zip(sides.side).map(|(i, side)| 2 * i + side).collect();
        let mut firsts = vec![usize::MAX; 2 * count];
        let mut sums = vec![0.0; 2 * count];
        for (k, &cell) in cells.iter().enumerate() {
            firsts[cell] = firsts[cell].min(k);
            sums[cell] += weights[k];
        }
        if let Some(cell) = firsts.iter().position(|first| *first == usize::MAX) {
            return Err(SymmetryError::OneSided { name: sides.names[cell / 2].clone() });
        }
        // About the first of each, so that equal vectors average to themselves.
        let mut averages = Matrix::from_fn(vectors.nrows(), 2 * count, |i, cell| vectors[(i, firsts[cell])]);
        for (k, &cell) in cells.iter().enumerate().filter(|(k, cell)| firsts[**cell] != *k) {
            let change = (vectors.column(k) - vectors.column(firsts[cell])) * (weights[k] / sums[cell]);
            let mut average = averages.column_mut(cell);
            average += change;
        }
        Ok(Self { vectors: averages, weights: sums, has_replicates: cells.len() > 2 * count })
    }

    /// `a_i`: left minus mirrored right of each individual, one a column.
    pub fn differences(&self) -> Matrix {
        let of = |i: usize, k: usize| self.vectors[(i, 2 * k)] - self.vectors[(i, 2 * k + 1)];
        Matrix::from_fn(self.vectors.nrows(), self.weights.len() / 2, of)
    }
}

/// The table of `vectors`, one a column, with positive weights. `watch` receives the fraction of the permutations that are done.
///
/// Cost: that of a linear model with as many columns as individuals and sides.
///
/// # Errors
/// Those of the models; [`AnalysisError::Interrupted`](crate::AnalysisError::Interrupted) once `watch` stops.
pub fn symmetry_table(
    vectors: &Matrix,
    weights: &[f64],
    sides: &Sides<'_>,
    averages: &Averages,
    testing: &SymmetryTesting<'_>,
    watch: &dyn Watch,
) -> Result<SymmetryTable, SymmetryError> {
    let count = sides.names.len();
    let individual: Vec<usize> = (0..2 * count).map(|cell| cell / 2).collect();
    let side: Vec<usize> = (0..2 * count).map(|cell| cell % 2).collect();
    let of_averages = Sides { individual: &individual, side: &side, ..*sides };
    let cells =
        model("~ individual + side", &of_averages, averages.vectors.clone(), averages.weights.clone())?;
    let common = Testing {
        kind: SumType::I,
        transform: testing.transform,
        permutations: testing.permutations,
        seed: testing.seed,
        ..Testing::default()
    };
    let within = Testing { strata: Some(&side), given: testing.given_averages, ..common.clone() };
    let of_individuals = cells.anova(&within, &Share { watch, part: 0 })?;
    let flips = Testing { strata: Some(&individual), ..common.clone() };
    let of_sides = cells.anova(&flips, &Share { watch, part: 1 })?;
    let collapsed = |row: &TermRecord| TermRecord {
        error_term: Some(INTERACTION.into()),
        collapsed: averages.has_replicates,
        ..row.clone()
    };
    let mut rows = vec![collapsed(&of_individuals.terms[0]), collapsed(&of_sides.terms[1])];
    let (mut residual, mut total) = (None, of_sides.total.clone());
    if averages.has_replicates {
        let full = model("~ individual + side + individual:side", sides, vectors.clone(), weights.to_vec())?;
        let exchange = if sides.measured.is_some() { ExchangeRule::Whole } else { ExchangeRule::Free };
        let free = Testing { blocks: sides.measured, exchange, given: testing.given, ..common };
        let mut found = full.anova(&free, &Share { watch, part: 2 })?;
        rows.extend(found.terms.pop());
        (residual, total) = (Some(found.residual), found.total);
    } else {
        let error = of_sides.residual;
        rows.push(TermRecord {
            term: INTERACTION.into(),
            degrees: error.degrees,
            sum_of_squares: error.sum_of_squares,
            mean_square: Some(error.mean_square),
            ..TermRecord::default()
        });
    }
    for row in &mut rows {
        let (own, rest) = (row.sum_of_squares, residual.as_ref().map_or(0.0, |rest| rest.sum_of_squares));
        row.r_squared = share(own, total.sum_of_squares);
        row.partial_eta_squared = share(own, own + rest);
    }
    let terms = rows.into_iter().map(|row| SymmetryTerm { row, df_shape: None }).collect();
    Ok(SymmetryTable { terms, residual, residual_df_shape: None, total })
}

/// A model of individuals and sides.
fn model(formula: &str, sides: &Sides<'_>, vectors: Matrix, weights: Vec<f64>) -> Result<Model, ModelError> {
    let individuals = sides.individual.iter().map(|&i| sides.names[i].clone()).collect();
    let names = sides.side.iter().map(|side| ["left", "right"][usize::from(*side > 0)].to_owned()).collect();
    let attributes = BTreeMap::from([
        ("individual".to_owned(), Values::Texts(individuals)),
        ("side".to_owned(), Values::Texts(names)),
    ]);
    let table = Table { attributes, levels: BTreeMap::new() };
    let formula = Formula::parse(formula, TermOrder::ByDegree)?;
    Model::new(&formula, &table, Contrasts::Treatment, vectors, weights)
}

/// A third of a computation.
struct Share<'a> {
    watch: &'a dyn Watch,
    part: u8,
}

impl Watch for Share<'_> {
    fn stop(&self) -> bool {
        self.watch.stop()
    }

    fn progress(&self, fraction: f64) {
        self.watch.progress((f64::from(self.part) + fraction) / 3.0);
    }
}
