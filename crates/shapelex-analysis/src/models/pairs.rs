//! Pairs of groups: least-squares means and slopes beside each other.
//!
//! ```text
//! distance ‖a − b‖,   angle arccos ⟨a, b⟩/(‖a‖ ‖b‖),   difference of lengths |‖a‖ − ‖b‖|
//! ```
//!
//! Residuals of the null model are exchanged: the model without the terms of most variables that involve the groups, for slopes without
//! the interactions of the covariate and the groups. Angles between means depend on the origin and tell nothing: they are offered for
//! slopes and for differences from a reference.
//!
//! An interval of a distance holds where the true difference lies in a ball about the estimated one; the radius is a quantile of the
//! changes of the difference for residuals that are drawn anew within the groups.
//!
//! Sources: Collyer, Sekora and Adams 2015; Collyer and Adams 2018.

use super::anova::{Model, Testing};
use super::compare::Nested;
use super::design::Table;
use super::error::ModelError;
use super::exchange::pairs as numbered_pairs;
use super::formula::{Formula, Term, TermOrder};
use super::groups::{GroupWeights, Groups};
use super::resample::{ExchangeRecord, ExchangedStatistic, Functions, Tested};
use crate::metric::{Metric, dot, norm};
use crate::quantile::quantile;
use crate::watch::Watch;
use shapelex_numeric::dense::Matrix;

/// Properties that are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum PairsOf {
    /// Least-squares means.
    #[default]
    Means,
    /// Slopes on a covariate.
    Slopes,
}

/// Statistic of a pair of groups.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum PairStatistic {
    /// Length of the difference.
    Distance,
    /// Angle between the two.
    Angle,
    /// Difference of their lengths.
    LengthDifference,
}

/// Pairs of groups that are asked for.
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct PairsOptions {
    /// Factors of the formula whose combinations are the groups, at most 50 of them.
    pub groups: Vec<String>,
    /// Properties that are compared. Default: `means`.
    #[cfg_attr(feature = "serde", serde(default))]
    pub of: PairsOf,
    /// Numeric variable of the formula on which slopes are taken.
    #[cfg_attr(feature = "serde", serde(default))]
    pub covariate: Option<String>,
    /// Group from whose mean the differences of the others are compared, as in `control` or `f:control`.
    #[cfg_attr(feature = "serde", serde(default))]
    pub reference: Option<String>,
    /// Statistics. Default: `distance`.
    #[cfg_attr(feature = "serde", serde(default))]
    pub statistics: Option<Vec<PairStatistic>>,
    /// Formula of the null model. Default: the model without the terms of most variables that involve the groups; for slopes, without the
    /// interactions of the covariate and the groups.
    #[cfg_attr(feature = "serde", serde(default))]
    pub null: Option<String>,
    /// Averages over other factors: `observed` as they occur in each group, or `equal`. Default: `observed`.
    #[cfg_attr(feature = "serde", serde(default))]
    pub weights: GroupWeights,
    /// Level of the intervals of distances. Default: 0.95.
    #[cfg_attr(feature = "serde", serde(default))]
    #[cfg_attr(feature = "schema", schema(exclusive_minimum = 0.0, exclusive_maximum = 1.0))]
    pub confidence: Option<f64>,
}

/// Pairs of groups.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct PairsRecord {
    /// Properties that were compared.
    pub of: PairsOf,
    /// Numeric variable of the slopes.
    pub covariate: Option<String>,
    /// Group from whose mean differences were taken.
    pub reference: Option<String>,
    /// Averages over other factors.
    pub weights: GroupWeights,
    /// Formula of the null model.
    pub null: String,
    /// Exchanges of the tests.
    #[cfg_attr(feature = "serde", serde(flatten))]
    pub made: ExchangeRecord,
    /// Level of the intervals.
    pub confidence: f64,
    /// The groups.
    pub groups: Vec<ModelGroup>,
    /// Every two of them.
    pub pairs: Vec<ModelPair>,
}

/// A group of shapes in a model.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ModelGroup {
    /// Levels of the factors, with colons between.
    pub name: String,
    /// Number of shapes.
    #[cfg_attr(feature = "serde", serde(rename = "shape_count"))]
    pub shapes: usize,
    /// Length of the slope, or of the difference from the reference; null for means, whose length depends on the origin.
    pub norm: Option<f64>,
    /// Mean, slope or difference of a modelled number.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub value: Option<f64>,
    /// Control points of the mean; displacements for one unit of the covariate, or from the reference, in the frame of the pooled mean.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub shape: Option<Vec<Vec<f64>>>,
}

/// A pair of groups in a model.
#[derive(Debug, Clone, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ModelPair {
    /// Name of the first group.
    pub first: String,
    /// Name of the second group.
    pub second: String,
    /// Length of the difference.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub distance: Option<ExchangedStatistic>,
    /// Angle between the two, in radians; 0 if one of them has no length.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub angle: Option<ExchangedStatistic>,
    /// Difference of the lengths.
    #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "Option::is_none"))]
    pub length_difference: Option<ExchangedStatistic>,
    /// Interval of the true distance; null without permutations, and with blocks, whose shapes are not independent.
    pub interval: Option<IntervalRecord>,
}

/// Confidence interval of a distance.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct IntervalRecord {
    /// The distance less the radius, or 0.
    pub low: f64,
    /// The distance and the radius.
    pub high: f64,
    /// Radius of the ball about the estimated difference that holds the true one.
    pub radius: f64,
}

/// `statistic` of two columns.
fn of_columns(statistic: PairStatistic, a: &[f64], b: &[f64]) -> f64 {
    match statistic {
        PairStatistic::Distance => a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt(),
        PairStatistic::Angle => {
            let lengths = norm(a) * norm(b);
            if lengths > 0.0 { (dot(a, b) / lengths).clamp(-1.0, 1.0).acos() } else { 0.0 }
        }
        PairStatistic::LengthDifference => (norm(a) - norm(b)).abs(),
    }
}

/// Every two of `count` groups.
pub(super) fn every_two(count: usize) -> Vec<(usize, usize)> {
    (0..count).flat_map(|a| (a + 1..count).map(move |b| (a, b))).collect()
}

impl PairsOptions {
    /// Statistics that are asked for.
    pub fn statistics(&self) -> &[PairStatistic] {
        self.statistics.as_deref().unwrap_or(&[PairStatistic::Distance])
    }

    /// Checks what does not depend on the shapes.
    ///
    /// # Errors
    /// [`ModelError::Setting`].
    pub fn check(&self) -> Result<(), ModelError> {
        let refused =
            |field: &'static str, detail: &str| Err(ModelError::Setting { field, detail: detail.into() });
        let of_means = self.of == PairsOf::Means;
        let angles = self.statistics().contains(&PairStatistic::Angle);
        match (&self.covariate, &self.reference) {
            (None, _) if !of_means => {
                refused("pairs/covariate", "expected a numeric variable for slopes, got none")
            }
            (Some(_), _) if of_means => refused("pairs/covariate", "expected none for means, got one"),
            (_, Some(_)) if !of_means => refused("pairs/reference", "expected none for slopes, got one"),
            (_, None) if of_means && angles => refused(
                "pairs/statistics",
                "expected angles of slopes, or of differences from a `reference`, got angles of means, which depend on the origin",
            ),
            _ if (1..self.statistics().len())
                .any(|i| self.statistics()[..i].contains(&self.statistics()[i])) =>
            {
                refused("pairs/statistics", "expected each once, got one again")
            }
            _ if self.statistics().is_empty() => {
                refused("pairs/statistics", "expected at least one, got none")
            }
            _ if self.confidence.is_some_and(|level| !(level > 0.0 && level < 1.0)) => {
                refused("pairs/confidence", "expected a number between 0 and 1, both excluded")
            }
            _ => Ok(()),
        }
    }
}

/// Tests of statistics for all pairs of vectors: for each statistic, one for each pair. Vectors are taken about the mean of all, which keeps
/// the digits of differences, or about zero, on which their angles and lengths depend.
///
/// # Errors
/// Blocks without equals; [`AnalysisError::Interrupted`](crate::AnalysisError::Interrupted) once `watch` stops.
pub fn test_pairs(
    model: &Model,
    (functions, null): (&Functions, &Nested),
    (statistics, about_mean): (&[PairStatistic], bool),
    testing: &Testing<'_>,
    watch: &dyn Watch,
) -> Result<(Vec<Vec<ExchangedStatistic>>, ExchangeRecord), ModelError> {
    let pairs = every_two(functions.names.len());
    let of = |vectors: &Matrix| -> Vec<f64> {
        let column = |g: usize| vectors.column(g).iter().copied().collect::<Vec<f64>>();
        let columns: Vec<Vec<f64>> = (0..vectors.ncols()).map(column).collect();
        let pair = |statistic: PairStatistic, (a, b): &(usize, usize)| {
            of_columns(statistic, &columns[*a], &columns[*b])
        };
        statistics.iter().flat_map(|statistic| pairs.iter().map(|two| pair(*statistic, two))).collect()
    };
    let tested = Tested { functions, null, about_mean, statistics: &of };
    let (found, made) = model.exchanged(&tested, testing, watch)?.tests(testing.transform);
    let mut found = found.into_iter();
    let mut of_statistics: Vec<Vec<ExchangedStatistic>> =
        statistics.iter().map(|_| found.by_ref().take(pairs.len()).collect()).collect();
    of_statistics.iter_mut().for_each(|tests| ExchangedStatistic::correct(tests.iter_mut()));
    Ok((of_statistics, made))
}

impl Model {
    /// Pairs of groups.
    ///
    /// # Errors
    /// Settings that do not fit the model; random parts; errors of the tests.
    pub fn pairs(
        &self,
        options: &PairsOptions,
        table: &Table,
        metric: Option<&Metric>,
        testing: &Testing<'_>,
        watch: &dyn Watch,
    ) -> Result<PairsRecord, ModelError> {
        options.check()?;
        self.check_fixed("pairs")?;
        let groups = self.groups(&options.groups, "pairs/groups")?;
        let covariate = match &options.covariate {
            Some(name) => Some(self.covariate(name, "pairs/covariate")?),
            None => None,
        };
        let functions = self.functions_of(options, &groups, covariate, table)?;
        let null = self.null_of(options, &groups, covariate, table)?;
        // Angles and lengths of means are those from the reference.
        let statistics = options.statistics();
        let (tests, made) = test_pairs(self, (&functions, &null), (statistics, true), testing, watch)?;
        let two = every_two(functions.names.len());
        let named = |&(a, b): &(usize, usize)| ModelPair {
            first: functions.names[a].clone(),
            second: functions.names[b].clone(),
            ..ModelPair::default()
        };
        let mut pairs: Vec<ModelPair> = two.iter().map(named).collect();
        for (statistic, tests) in statistics.iter().zip(tests) {
            for (pair, test) in pairs.iter_mut().zip(tests) {
                match statistic {
                    PairStatistic::Distance => pair.distance = Some(test),
                    PairStatistic::Angle => pair.angle = Some(test),
                    PairStatistic::LengthDifference => pair.length_difference = Some(test),
                }
            }
        }
        let confidence = options.confidence.unwrap_or(0.95);
        self.fill_intervals(&mut pairs, (&functions, &groups), confidence, testing, watch)?;
        Ok(PairsRecord {
            of: options.of,
            covariate: covariate.map(|v| self.design.formula.variables[v].to_string()),
            reference: options.reference.clone(),
            weights: options.weights,
            null: null.formula,
            made,
            confidence,
            groups: self.group_records(options, (&functions, &groups), metric),
            pairs,
        })
    }

    /// Rows of means, slopes, or differences from a reference.
    fn functions_of(
        &self,
        options: &PairsOptions,
        groups: &Groups,
        covariate: Option<usize>,
        table: &Table,
    ) -> Result<Functions, ModelError> {
        let mut names = groups.names.clone();
        let mut rows = match covariate {
            Some(covariate) => self.slope_rows(groups, covariate, "pairs/covariate")?,
            None => self.mean_rows(groups, table, options.weights),
        };
        if let Some(reference) = &options.reference {
            let Some(at) = names.iter().position(|name| name == reference) else {
                let detail = format!("expected one of the groups {}, got '{reference}'", names.join(", "));
                return Err(ModelError::Setting { field: "pairs/reference", detail });
            };
            let (from, _) = (rows.remove(at), names.remove(at));
            rows.iter_mut().for_each(|row| row.iter_mut().zip(&from).for_each(|(x, from)| *x -= from));
        }
        Functions::new(self, names, &rows, "pairs/groups")
    }

    /// The null model of pairs.
    fn null_of(
        &self,
        options: &PairsOptions,
        groups: &Groups,
        covariate: Option<usize>,
        table: &Table,
    ) -> Result<Nested, ModelError> {
        if let Some(null) = &options.null {
            return self.given_null(null, table, "pairs/null");
        }
        let involves = |term: &Term| term.0.iter().any(|v| groups.is_of(*v));
        let terms = || self.design.formula.terms.iter().filter(|term| involves(term));
        let most = terms().map(Term::degree).max().unwrap_or(0);
        match covariate {
            Some(covariate) => {
                let is_out = |term: &Term| involves(term) && term.0.contains(&covariate);
                if !terms().any(is_out) {
                    let detail = "expected an interaction of the covariate and the groups in the formula, without which all slopes \
                                  are equal, got none";
                    return Err(ModelError::Setting { field: "pairs/covariate", detail: detail.into() });
                }
                self.without(is_out, "pairs/null")
            }
            None => self.without(|term| involves(term) && term.degree() == most, "pairs/null"),
        }
    }

    /// A null model by its formula.
    pub(super) fn given_null(
        &self,
        text: &str,
        table: &Table,
        field: &'static str,
    ) -> Result<Nested, ModelError> {
        let refused = |detail: String| ModelError::Setting { field, detail };
        let formula =
            Formula::parse(text, TermOrder::ByDegree).map_err(|error| refused(error.to_string()))?;
        self.nested(&formula, table, field)
    }

    fn fill_intervals(
        &self,
        pairs: &mut [ModelPair],
        (functions, groups): (&Functions, &Groups),
        level: f64,
        testing: &Testing<'_>,
        watch: &dyn Watch,
    ) -> Result<(), ModelError> {
        let wanted = pairs.iter().any(|pair| pair.distance.is_some());
        if !wanted || testing.permutations == 0 || testing.blocks.is_some() {
            return Ok(());
        }
        let strata = match testing.strata {
            Some(strata) => numbered_pairs(&groups.of_shapes, strata),
            None => groups.of_shapes.clone(),
        };
        let residuals = self.drawn_residuals(&strata);
        let two = every_two(functions.names.len());
        let of = |changes: Matrix| -> Vec<f64> {
            two.iter().map(|&(a, b)| (changes.column(a) - changes.column(b)).norm()).collect()
        };
        let drawn = self.redrawn((functions, &residuals), &strata, testing, &of, watch)?;
        for (i, pair) in pairs.iter_mut().enumerate() {
            let mut radii: Vec<f64> = drawn.iter().map(|radii| radii[i]).collect();
            radii.sort_by(f64::total_cmp);
            let radius = quantile(&radii, level);
            let interval = |distance: f64| IntervalRecord {
                low: (distance - radius).max(0.0),
                high: distance + radius,
                radius,
            };
            pair.interval = pair.distance.as_ref().map(|test| interval(test.value));
        }
        Ok(())
    }

    fn group_records(
        &self,
        options: &PairsOptions,
        (functions, groups): (&Functions, &Groups),
        metric: Option<&Metric>,
    ) -> Vec<ModelGroup> {
        let (vectors, sizes) = (functions.vectors(self), groups.sizes());
        let is_difference = options.of == PairsOf::Slopes || options.reference.is_some();
        let of = |(g, name): (usize, &String)| {
            let values: Vec<f64> = vectors.column(g).iter().copied().collect();
            let at = groups.names.iter().position(|other| other == name);
            ModelGroup {
                name: name.clone(),
                shapes: at.map_or(0, |at| sizes[at]),
                norm: is_difference.then(|| norm(&values)),
                value: metric.is_none().then(|| values[0]),
                shape: metric.map(|metric| metric.rows(&values)),
            }
        };
        functions.names.iter().enumerate().map(of).collect()
    }
}
