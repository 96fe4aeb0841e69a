//! Results of blocks and modules as records.

use std::collections::BTreeMap;

use super::modularity::CovarianceRatio;
use crate::inference::reaches;
use crate::models::effect_size::{EffectSize, Transform, drop_observed, effect_size};

/// A statistic with its permutation test.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct TestedStatistic {
    /// The observed value.
    pub value: f64,
    /// Mean of the permuted values, which the number of shapes and of coordinates raises; null without permutations.
    pub permuted_mean: Option<f64>,
    /// Effect size, as in linear models; null without permutations.
    pub z: Option<f64>,
    /// Numerator of `z`: effects of two samples compare by `(d_1 − d_2)/√(σ_1² + σ_2²)`.
    pub difference: Option<f64>,
    /// Denominator of `z`, `σ`.
    pub deviation: Option<f64>,
    /// p value `(1 + exceeding)/(1 + permutations)`; null without permutations.
    pub p: Option<f64>,
    /// Number of exchanges, without the observed one, whose statistic is as extreme as the observed one.
    pub exceeding: usize,
    /// Number of exchanges, without the observed one.
    pub permutations: usize,
    /// Whether all distinct exchanges were made, so that p is exact.
    pub exact: bool,
}

/// Which permuted values count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Tail {
    /// Values at least as large as the observed one.
    Upper,
    /// Values at most as large as the observed one.
    Lower,
}

impl TestedStatistic {
    /// The test of `value` by the values of exchanges; `exact` if these are all, the observed one among them.
    pub(super) fn of(value: f64, drawn: &[f64], exact: bool, transform: Transform, tail: Tail) -> Self {
        let mut values = [&[value], drawn].concat();
        if exact {
            drop_observed(&mut values);
        }
        let others = &values[1..];
        let counts = |other: &&f64| match tail {
            Tail::Upper => reaches(**other, value),
            Tail::Lower => reaches(value, **other),
        };
        let (permutations, exceeding) = (others.len(), others.iter().filter(counts).count());
        let size = effect_size(&values, transform);
        let some = permutations > 0;
        Self {
            value,
            permuted_mean: some.then(|| others.iter().sum::<f64>() / permutations as f64),
            z: size.map(|size| size.z),
            difference: size.map(|size| size.difference),
            deviation: size.map(|size| size.deviation),
            p: some.then(|| (1 + exceeding) as f64 / (1 + permutations) as f64),
            exceeding,
            permutations,
            exact: exact && some,
        }
    }

    /// The effect size; `None` without permutations.
    pub fn effect(&self) -> Option<EffectSize> {
        let (z, difference, deviation) = (self.z?, self.difference?, self.deviation?);
        Some(EffectSize { z, lambda: f64::NAN, difference, deviation })
    }
}

/// How blocks vary together.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct BlocksRecord {
    /// The blocks.
    pub blocks: Vec<BlockRecord>,
    /// Every two blocks.
    pub pairs: Vec<BlockPairRecord>,
    /// Mean of the correlations of all pairs; null for two blocks.
    pub overall: Option<TestedStatistic>,
    /// Warnings about the result.
    pub warnings: Vec<String>,
}

/// A block.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct BlockRecord {
    /// Name of the block.
    pub name: String,
    /// Numbers of a subject.
    pub numbers: usize,
    /// Average of the aligned control points; null for labels.
    pub average: Option<Vec<Vec<f64>>>,
}

/// How two blocks vary together.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct BlockPairRecord {
    /// Name of the first block.
    pub first: String,
    /// Name of the second block.
    pub second: String,
    /// Correlation of the scores of the first pair of singular shapes.
    pub r: TestedStatistic,
    /// `‖S_12‖²/(‖S_11‖ ‖S_22‖)`.
    pub rv: TestedStatistic,
    /// Pairs of singular shapes, at most ten.
    pub components: Vec<BlockComponentRecord>,
}

/// A pair of singular shapes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct BlockComponentRecord {
    /// Covariance of the scores, `σ_i`.
    pub singular_value: f64,
    /// `σ_i²/Σσ²`.
    pub share: f64,
    /// Correlation of the scores; null where one of them does not vary.
    pub correlation: Option<f64>,
    /// Direction in the first block: its largest coordinate is positive.
    pub first: LoadingRecord,
    /// Direction in the second block.
    pub second: LoadingRecord,
}

/// A direction in a block.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct LoadingRecord {
    /// Displacements of the control points for a score of 1; absent for labels.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub shape: Option<Vec<Vec<f64>>>,
    /// Coefficients of the standardised labels; absent for shapes.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub labels: Option<BTreeMap<String, f64>>,
    /// Standard deviation of the scores.
    pub deviation: f64,
}

/// Whether parts of a shape are modules.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ModularityRecord {
    /// Form of the covariance ratio.
    pub cr: CovarianceRatio,
    /// Mean of the covariance ratios of all pairs of modules. Modular shapes have a small one: p counts exchanges whose ratio is at most
    /// the observed one, and Z is negative.
    pub ratio: TestedStatistic,
    /// Covariance ratio of every two modules.
    pub pairs: Vec<ModulePairRecord>,
    /// The modules.
    pub modules: Vec<ModuleRecord>,
    /// Units of exchange: `points` between modules, or `shifts` of the modules along a closed curve; null without
    /// permutations.
    pub exchanged: Option<String>,
    /// Control points of the average of the aligned shapes.
    pub average: Vec<Vec<f64>>,
    /// Warnings about the result.
    pub warnings: Vec<String>,
}

/// A module.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ModuleRecord {
    /// Name of the module.
    pub name: String,
    /// Control points of the module.
    pub points: Vec<usize>,
}

/// Covariance ratio of two modules.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ModulePairRecord {
    /// Name of the first module.
    pub first: String,
    /// Name of the second module.
    pub second: String,
    /// The ratio.
    pub value: f64,
}
