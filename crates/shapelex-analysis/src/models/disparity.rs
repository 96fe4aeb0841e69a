//! Disparity of groups: how much their shapes scatter.
//!
//! ```text
//! d_k = ‖e_k‖²,   V_g = Σ_{k ∈ g} w_k d_k/Σ_{k ∈ g} w_k            unbiased: over Σ_{k ∈ g} (1 − h_kk)
//! partial, about the mean of all: V_g n_g/(n − 1)                  the parts add up to the variance of all
//! ```
//!
//! `e` are differences from the means of the groups, from the mean of all, or residuals of the model: three questions with three answers.
//! Squares are exchanged between the groups, and `|V_a − V_b|` is compared.
//!
//! Sources: Foote 1993; Zelditch, Swiderski and Sheets 2012.

use super::anova::{Model, Testing};
use super::error::ModelError;
use super::exchange::{Draw, ExchangeKind, Exchanges};
use super::groups::Groups;
use super::pairs::every_two;
use super::resample::{ExchangeRecord, ExchangedStatistic, Lists};
use crate::watch::Watch;

/// Centre about which the shapes of a group scatter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum About {
    /// The means of the groups.
    #[default]
    Groups,
    /// The mean of all shapes.
    Mean,
    /// What the whole model predicts.
    Model,
}

/// Disparity that is asked for.
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct DisparityOptions {
    /// Factors of the formula whose combinations are the groups, at most 50 of them.
    pub groups: Vec<String>,
    /// Centre about which the shapes scatter: `groups`, `mean` or `model`. Default: `groups`.
    #[cfg_attr(feature = "serde", serde(default))]
    pub about: About,
    /// Whether the parts of the groups of the variance of all are returned, about the `mean`. Default: false.
    #[cfg_attr(feature = "serde", serde(default))]
    pub partial: bool,
    /// Whether squares are divided by the degrees of freedom of each group rather than by its number of shapes. Default: false.
    #[cfg_attr(feature = "serde", serde(default))]
    pub unbiased: bool,
}

/// Disparity of groups.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct DisparityRecord {
    /// Centre about which the shapes scatter.
    pub about: About,
    /// The same as a formula.
    pub formula: String,
    /// Whether the parts of the variance of all are given.
    pub partial: bool,
    /// Whether squares are divided by degrees of freedom.
    pub unbiased: bool,
    /// Exchanges of the tests: squares of shapes.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub made: ExchangeRecord,
    /// The groups.
    pub groups: Vec<GroupVariance>,
    /// Every two of them.
    pub pairs: Vec<VariancePair>,
}

/// Scatter of a group.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct GroupVariance {
    /// Levels of the factors, with colons between.
    pub name: String,
    /// Number of shapes.
    #[cfg_attr(feature = "serde", serde(rename = "shape_count"))]
    pub shapes: usize,
    /// Procrustes variance, in the squared norm of the shapes.
    pub variance: f64,
}

/// Difference of the scatters of two groups.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct VariancePair {
    /// Name of the first group.
    pub first: String,
    /// Name of the second group.
    pub second: String,
    /// Absolute difference of the variances.
    pub difference: ExchangedStatistic,
}

/// Squares of the shapes, and what each adds to the divisor.
struct Squares {
    squares: Vec<f64>,
    parts: Vec<f64>,
    /// Divisor of all groups, for partial disparity.
    whole: Option<f64>,
}

impl Squares {
    fn variances(&self, of_shapes: &[usize], count: usize) -> Vec<f64> {
        let mut sums = vec![(0.0, 0.0); count];
        for ((square, part), &group) in self.squares.iter().zip(&self.parts).zip(of_shapes) {
            sums[group].0 += square;
            sums[group].1 += part;
        }
        let over = |(sum, divisor): (f64, f64)| {
            let divisor = self.whole.unwrap_or(divisor);
            if divisor > 0.0 { sum / divisor } else { 0.0 }
        };
        sums.into_iter().map(over).collect()
    }
}

impl Model {
    /// Disparity of groups.
    ///
    /// # Errors
    /// Groups that do not fit the model; partial disparity about anything else than the mean; an end of the time.
    pub fn disparity(
        &self,
        options: &DisparityOptions,
        testing: &Testing<'_>,
        watch: &dyn Watch,
    ) -> Result<DisparityRecord, ModelError> {
        let refused =
            |detail: &str| Err(ModelError::Setting { field: "disparity/partial", detail: detail.into() });
        if options.partial && options.about != About::Mean {
            return refused(
                "expected false unless the shapes scatter about the `mean`, whose variance the parts add up to, got true",
            );
        }
        if options.partial && options.unbiased {
            return refused("expected false with `unbiased`, got true: the parts have one divisor");
        }
        let groups = self.groups(&options.groups, "disparity/groups")?;
        let (squares, formula) = self.squares_about(options, &groups)?;
        let count = groups.count();
        let two = every_two(count);
        let differences = |of_shapes: &[usize]| -> Vec<f64> {
            let variances = squares.variances(of_shapes, count);
            two.iter().map(|&(a, b)| (variances[a] - variances[b]).abs()).collect()
        };
        let exchanges = self.group_exchanges(&groups, testing);
        let of = |index: usize| {
            let mut to = groups.of_shapes.clone();
            exchanges.cells(index, &groups.of_shapes, &mut to);
            differences(&to)
        };
        let observed = differences(&groups.of_shapes);
        let kind = if testing.blocks.is_some() { ExchangeKind::Within } else { ExchangeKind::Free };
        let lists = Lists::new((&exchanges, kind), observed, testing, &of, watch)?;
        let (mut tests, made) = lists.tests(testing.transform);
        ExchangedStatistic::correct(tests.iter_mut());
        let variances = squares.variances(&groups.of_shapes, count);
        let group = |(g, name): (usize, &String)| GroupVariance {
            name: name.clone(),
            shapes: groups.sizes()[g],
            variance: variances[g],
        };
        let pair = |(&(a, b), difference): (&(usize, usize), ExchangedStatistic)| VariancePair {
            first: groups.names[a].clone(),
            second: groups.names[b].clone(),
            difference,
        };
        Ok(DisparityRecord {
            about: options.about,
            formula,
            partial: options.partial,
            unbiased: options.unbiased,
            made,
            groups: groups.names.iter().enumerate().map(group).collect(),
            pairs: two.iter().zip(tests).map(pair).collect(),
        })
    }

    /// Exchanges of squares between the groups: within strata and blocks.
    fn group_exchanges(&self, groups: &Groups, testing: &Testing<'_>) -> Exchanges {
        if let Some(given) = testing.given {
            return Exchanges::Given(given.to_vec());
        }
        let none = vec![0; groups.of_shapes.len()];
        let draw = Draw {
            strata: testing.strata.unwrap_or(&none),
            blocks: testing.blocks,
            kind: if testing.blocks.is_some() { ExchangeKind::Within } else { ExchangeKind::Free },
            permutations: testing.permutations,
            seed: testing.seed,
        };
        // Only whole blocks may be unequal.
        Exchanges::new(&groups.of_shapes, draw).unwrap_or(Exchanges::Given(Vec::new()))
    }

    fn squares_about(
        &self,
        options: &DisparityOptions,
        groups: &Groups,
    ) -> Result<(Squares, String), ModelError> {
        let weights = self.weights();
        let one = vec![0; weights.len()];
        let (squares, leverages, formula) = match options.about {
            About::Model => {
                self.check_fixed("disparity/about")?;
                (self.fitted.squares(), self.space.leverages(), self.design.formula.to_string())
            }
            About::Groups => self.about_means(&groups.of_shapes, groups.formula(&self.design.formula)),
            About::Mean => self.about_means(&one, "~ 1".into()),
        };
        let total: f64 = weights.iter().sum();
        let count = weights.len() as f64;
        let parts = match options.unbiased {
            true => leverages.iter().map(|leverage| total / count * (1.0 - leverage)).collect(),
            false => weights.to_vec(),
        };
        let whole = options.partial.then(|| total * (count - 1.0) / count);
        Ok((Squares { squares, parts, whole }, formula))
    }

    /// Weighted squared distances of the shapes from the means of groups, and the leverages of the shapes in them.
    fn about_means(&self, of_shapes: &[usize], formula: String) -> (Vec<f64>, Vec<f64>, String) {
        let count = of_shapes.iter().max().map_or(0, |last| last + 1);
        let mut totals = vec![0.0; count];
        of_shapes.iter().zip(self.weights()).for_each(|(&group, weight)| totals[group] += weight);
        let means = self.group_means(of_shapes, &totals);
        let of = |(k, &group): (usize, &usize)| {
            let difference = self.vectors.column(k) - means.column(group);
            (self.weights()[k] * difference.norm_squared(), self.weights()[k] / totals[group])
        };
        let (squares, leverages) = of_shapes.iter().enumerate().map(of).unzip();
        (squares, leverages, formula)
    }
}
