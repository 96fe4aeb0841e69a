//! How a model is tested.

use super::design::Contrasts;
use super::effect_size::{Transform, drop_observed};
use super::subspaces::SumType;

/// The statistic whose permutations are counted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum Statistic {
    /// The ratio of mean squares.
    #[default]
    F,
    /// The sum of squares.
    SumOfSquares,
}

/// Choice of the units of exchange for each term.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum ExchangeRule {
    /// With blocks, within them for terms that vary inside, whole blocks for others; without, all residuals.
    #[default]
    Auto,
    /// All residuals.
    Free,
    /// Residuals within blocks.
    Within,
    /// Whole blocks.
    Whole,
}

/// How a model is tested.
#[derive(Debug, Clone)]
pub struct Testing<'a> {
    /// Type of the sums of squares.
    pub kind: SumType,
    /// Contrasts of type III. Sums are those of the effects about the mean of all levels.
    pub contrasts_of_three: Contrasts,
    /// The statistic of p and Z.
    pub statistic: Statistic,
    /// Transformation of Z.
    pub transform: Transform,
    /// Number of permutations.
    pub permutations: usize,
    /// Seed.
    pub seed: u64,
    /// Stratum of each shape: nothing is exchanged between strata.
    pub strata: Option<&'a [usize]>,
    /// Block of each shape.
    pub blocks: Option<&'a [usize]>,
    /// Choice of the residuals that are exchanged.
    pub exchange: ExchangeRule,
    /// Terms that are tested against others, by their names.
    pub error_terms: &'a [(String, String)],
    /// Whether terms with an error term of the model also have the ratio of permuted mean squares of RRPP.
    pub rrpp: bool,
    /// Given exchanges, in place of drawn ones.
    pub given: Option<&'a [Vec<usize>]>,
}

impl Default for Testing<'_> {
    fn default() -> Self {
        Self {
            kind: SumType::default(),
            contrasts_of_three: Contrasts::Sum,
            statistic: Statistic::default(),
            transform: Transform::default(),
            permutations: 999,
            seed: 0,
            strata: None,
            blocks: None,
            exchange: ExchangeRule::default(),
            error_terms: &[],
            rrpp: false,
            given: None,
        }
    }
}

/// Takes the observed exchange out of all of them, which follow the observed value.
pub(super) fn without_observed(values: &mut Vec<f64>, are_all: bool) {
    if are_all && values.len() > 1 {
        drop_observed(values);
    }
}
