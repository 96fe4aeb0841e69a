//! Random effects of groups in models of shapes.
//!
//! ```text
//! Y_i = X_i B + Z_i U_i + E_i,   vec U_i ~ N(0, Γ),   rows of E ~ N(0, Σ_e)
//! ```
//!
//! * this file — one random part of a model: what is estimated, and when it can be; [`sums`] — per-group sums, and the likelihood;
//!   `optimum` — its largest value; [`em`] — free covariances; `conditional` — shapes of the groups; [`records`].
//!
//! Three structures. `scalar`: one ratio of variances for all coordinates, from the traces. `by_score`: own variances for each principal
//! score. `full`: free covariances of the first scores, for intercepts. A singular `Γ` is a result.
//!
//! Sources: Laird and Ware 1982; Bates et al. 2015.

pub mod conditional;
pub mod em;
pub mod optimum;
pub mod records;
pub mod sums;

use self::conditional::{Estimates, conditional};
use self::em::free;
use self::optimum::optimum;
use self::records::{RandomRecord, ScoreRecord, VarianceRecord};
use self::sums::GroupSums;
use super::anova::Model;
use super::coefficients::Coefficients;
use super::error::ModelError;
use super::exchange::pairs;
use super::formula::{Formula, RandomPart, Term};
use crate::AnalysisError;
use crate::inference::span::Span;
use crate::metric::Metric;
use crate::watch::Watch;
use shapelex_numeric::dense::{self, Matrix};
use shapelex_numeric::parallel;

/// Part of the scatter that the scores hold where their number is not given.
const USUAL_PART: f64 = 0.95;
/// Most scores.
pub const MAX_SCORES: usize = 20;
/// Evaluations of a likelihood.
const EVALUATIONS: f64 = 200.0;
/// Ratio of variances below which the variance of a group is zero.
const FLAT: f64 = 1e-6;

/// Criterion that is maximised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum Criterion {
    /// The likelihood of what the fixed part leaves: variances are not too small by its degrees of freedom.
    #[default]
    Reml,
    /// The likelihood.
    Ml,
}

/// How the variances of coordinates belong together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum Structure {
    /// One ratio of variances for all coordinates.
    Scalar,
    /// Own variances for each principal score.
    ByScore,
    /// Free covariances of the first principal scores.
    Full,
}

/// What is asked of a random part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct RandomQuestion {
    /// The structure. Default: scalar for intercepts, by score for slopes.
    pub structure: Option<Structure>,
    /// Criterion that is maximised.
    pub criterion: Criterion,
    /// Number of scores. Default: those of 95 % of the scatter.
    pub scores: Option<usize>,
    /// Whether the shapes of the groups are wanted.
    pub subjects: bool,
}

/// A random part with the groups and columns of its effects.
struct Part {
    name: String,
    group: Term,
    groups: Vec<usize>,
    count: usize,
    /// Names of the effects, and their columns, scaled by the roots of the weights.
    effects: Vec<String>,
    columns: Matrix,
    has_intercept: bool,
}

/// Coordinates in which a model is estimated: the vectors, or scores along `directions`, `P × m`.
struct Coordinates {
    /// Scaled by the roots of the weights, about the mean, one column a shape.
    scaled: Matrix,
    directions: Option<Matrix>,
    explained: f64,
}

/// Estimates of the one random part of a model, whose vectors are whitened shapes if there is a metric.
///
/// # Errors
/// [`ModelError::Unidentified`] for parts that the shapes do not determine, or that the structure has not; [`AnalysisError::Interrupted`]
/// once `watch` stops.
pub fn estimate(
    model: &Model,
    question: &RandomQuestion,
    metric: Option<&Metric>,
    watch: &dyn Watch,
) -> Result<RandomRecord, ModelError> {
    let part = Part::of(model)?;
    let usual = if part.effects.len() == 1 { Structure::Scalar } else { Structure::ByScore };
    let structure = question.structure.unwrap_or(usual);
    if part.effects.len() > 1 && structure != Structure::ByScore {
        return Err(unidentified(format!(
            "expected the structure by_score for {} effects of {}, got another: scalar and full have one",
            part.effects.len(),
            part.name
        )));
    }
    let coordinates = match structure {
        Structure::Scalar => Coordinates::all(model),
        _ => Coordinates::scores(model, question.scores, part.count)?,
    };
    let residuals = model.space.residuals(&coordinates.scaled);
    let sums = GroupSums::new(model, &residuals, &part.columns, &part.groups, part.has_intercept)?;
    let mut record = RandomRecord::new(&part.name, &part.effects, structure, question.criterion, part.count);
    let mut estimates = match structure {
        Structure::Full => of_all(&sums, &residuals, question.criterion, &mut record, watch)?,
        _ => of_each(&sums, structure, question.criterion, &mut record, watch)?,
    };
    if let Some(directions) = &coordinates.directions {
        record.components = Some(directions.ncols());
        record.explained = Some(coordinates.explained);
        estimates = estimates.along(directions);
    }
    let mut coefficients = Coefficients::new(model);
    // What is outside of the scores keeps its least squares.
    if let Some(change) = model.space.solve(&estimates.change) {
        coefficients.rows += change;
    }
    record.coefficients = coefficients.records(&model.design, &model.space, metric);
    if question.subjects {
        record.subjects = conditional(model, &part, &coefficients, &estimates, metric);
    }
    Ok(record)
}

/// Multiply-adds and bytes of estimates for shapes of `length` numbers in groups, and a design of so many columns: an optimum takes some
/// two hundred evaluations of the likelihood.
pub fn cost((shapes, groups): (usize, usize), columns: usize, length: usize) -> (f64, f64) {
    let [n, s, p, rows] = [shapes, groups, columns, length].map(|count| count as f64);
    let scores = rows.min(MAX_SCORES as f64);
    let free = EVALUATIONS * (scores.powi(3) + scores * s * p * p);
    let work = EVALUATIONS * s * p * (p + rows) + free + 3.0 * n * rows * (p + n.min(rows));
    (work, 8.0 * (3.0 * n * rows + 3.0 * s * (p + rows) + n.min(rows).powi(2)))
}

/// Part of the scatter in the first scores.
fn explained(span: &Span, count: usize) -> f64 {
    span.eigenvalues[..count].iter().sum::<f64>() / span.total()
}

/// Number of scores that hold 95 % of the scatter, at most `bound` and [`MAX_SCORES`], and the part in them.
pub(super) fn usual_scores(span: &Span, bound: usize) -> (usize, f64) {
    let bound = bound.min(MAX_SCORES);
    let count = (1..=bound).find(|&count| explained(span, count) >= USUAL_PART).unwrap_or(bound);
    (count, explained(span, count))
}

fn unidentified(detail: String) -> ModelError {
    ModelError::Unidentified { detail }
}

/// Free covariances.
fn of_all(
    sums: &GroupSums,
    residuals: &Matrix,
    criterion: Criterion,
    record: &mut RandomRecord,
    watch: &dyn Watch,
) -> Result<Estimates, ModelError> {
    let gram = dense::multiply(residuals, &residuals.transpose());
    let found = free(sums, &gram, criterion, watch)?.ok_or_else(|| {
        unidentified("expected residuals of full rank in all scores, got fewer dimensions".into())
    })?;
    let scale = sums.triangle[(0, 0)].powi(2);
    let between = &found.covariances.between / scale;
    record.variance =
        VarianceRecord { between: vec![vec![between.trace()]], within: found.covariances.within.trace() };
    record.icc = Some(between.trace() / (between.trace() + found.covariances.within.trace()));
    record.boundary = found.boundary;
    record.converged = found.converged;
    record.log_likelihood = found.log_likelihood;
    record.between = Some(rows_of(&between));
    record.within = Some(rows_of(&found.covariances.within));
    let root = sums.triangle[(0, 0)];
    let of_group = |i: usize| found.effects.rows(i, 1).into_owned() / root;
    let effects = (0..sums.zz.len()).map(of_group).collect();
    let posterior =
        found.posterior.iter().map(|variance| Matrix::from_element(1, 1, variance / scale)).collect();
    Ok(Estimates { change: found.change, effects, posterior })
}

/// One optimum of all coordinates, or one of each.
fn of_each(
    sums: &GroupSums,
    structure: Structure,
    criterion: Criterion,
    record: &mut RandomRecord,
    watch: &dyn Watch,
) -> Result<Estimates, ModelError> {
    let length = sums.squares.len();
    let step = if structure == Structure::Scalar { length.max(1) } else { 1 };
    let found = parallel::try_map(length.div_ceil(step), &|k| {
        watch.check()?;
        Ok::<_, AnalysisError>(optimum(sums, k * step..(k + 1) * step, criterion, watch))
    })?;
    let mut estimates = Estimates::none(sums);
    let (mut between, mut within) = (Matrix::zeros(sums.effects(), sums.effects()), 0.0);
    let rest = sums.degrees(criterion) * (1.0 + std::f64::consts::TAU.ln()) - sums.log_weights;
    for (k, found) in found.into_iter().enumerate() {
        let none =
            || unidentified("expected groups whose shapes differ, got equal shapes in all groups".into());
        let found = found.ok_or_else(none)?;
        estimates.take(sums, k * step, &found).ok_or_else(none)?;
        let covariance = sums.named(&(&found.relative * found.profile.variance)).ok_or_else(none)?;
        between += &covariance;
        within += found.profile.variance;
        let log_likelihood = found.profile.value - 0.5 * step as f64 * rest;
        record.log_likelihood += log_likelihood;
        record.boundary |= found.boundary;
        if structure == Structure::ByScore {
            record.scores.push(ScoreRecord {
                between: rows_of(&covariance),
                within: found.profile.variance,
                boundary: found.boundary,
                log_likelihood,
            });
        }
    }
    record.icc = (sums.effects() == 1).then(|| between[(0, 0)] / (between[(0, 0)] + within));
    record.variance = VarianceRecord { between: rows_of(&between), within };
    Ok(estimates)
}

fn rows_of(matrix: &Matrix) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

impl Coordinates {
    fn all(model: &Model) -> Self {
        Self { scaled: model.centred(), directions: None, explained: 1.0 }
    }

    /// The first principal scores: so many, or those of the usual part of the scatter.
    fn scores(model: &Model, wanted: Option<usize>, groups: usize) -> Result<Self, ModelError> {
        let centred = model.centred();
        let span = Span::of_scaled(&centred)?;
        let most = span.eigenvalues.len();
        let free = model.degrees().saturating_sub(groups) / 3;
        let bound = MAX_SCORES.min(free).max(1).min(most);
        if wanted.is_some_and(|wanted| wanted > bound) || bound == 0 {
            return Err(unidentified(format!(
                "expected at most {bound} scores, a third of the degrees of freedom within the groups, got {}",
                wanted.unwrap_or(0)
            )));
        }
        let count = wanted.unwrap_or_else(|| usual_scores(&span, bound).0);
        let scaled = span.scores.rows(0, count).into_owned();
        let mut directions = dense::multiply(&centred, &scaled.transpose());
        directions
            .column_iter_mut()
            .zip(&span.eigenvalues)
            .for_each(|(mut own, value)| own.unscale_mut(*value));
        Ok(Self { scaled, directions: Some(directions), explained: explained(&span, count) })
    }
}

impl Part {
    fn of(model: &Model) -> Result<Self, ModelError> {
        let formula = &model.design.formula;
        let [part] = formula.random.as_slice() else {
            let names =
                formula.random.iter().map(|part| formula.part_name(part)).collect::<Vec<_>>().join(", ");
            return Err(unidentified(format!("expected one random part for estimates, got {names}")));
        };
        let all: Vec<usize> = (0..model.design.shapes()).collect();
        let RandomPart { intercept, terms, group } = part.clone();
        let own = Formula { intercept, terms, random: Vec::new(), ..formula.clone() };
        let design = model.design.restricted(own, &all)?;
        let groups = model.design.cells_of(&group);
        let count = groups.iter().max().map_or(0, |last| last + 1);
        let mut columns = design.matrix;
        for (mut row, root) in columns.row_iter_mut().zip(model.space.roots()) {
            row.scale_mut(*root);
        }
        let (name, effects) = (formula.part_name(part), design.columns);
        let part = Self { name, group, groups, count, effects, columns, has_intercept: intercept };
        if part.effects.is_empty() {
            return Err(unidentified(format!("expected a random part with an effect, got {}", part.name)));
        }
        part.check(model)?;
        Ok(part)
    }

    /// Checks that the shapes determine the variances.
    fn check(&self, model: &Model) -> Result<(), ModelError> {
        let (groups, count, q) = (&self.groups, self.count, self.effects.len());
        let mut sizes = vec![0; count];
        groups.iter().for_each(|&group| sizes[group] += 1);
        let repeated = sizes.iter().filter(|size| **size > 1).count();
        let name = &self.name;
        if repeated < 2 {
            return Err(unidentified(format!(
                "expected at least two groups of {name} with two shapes each, got {repeated} of {count} groups"
            )));
        }
        let roots = model.space.roots();
        let rows = |k: usize| -> Vec<u64> {
            self.columns.row(k).iter().map(|value| (value / roots[k]).to_bits()).collect()
        };
        let values = pairs(groups, &crate::strata::strata((0..groups.len()).map(rows)));
        let mut distinct = vec![std::collections::BTreeSet::new(); count];
        values.iter().zip(groups).for_each(|(value, &group)| {
            distinct[group].insert(*value);
        });
        let most = distinct.iter().map(std::collections::BTreeSet::len).max().unwrap_or(0);
        if q > 1 && (count <= q || most <= q) {
            return Err(unidentified(format!(
                "expected more than {q} groups of {name}, one of them with more than {q} distinct values, got {count} groups with at \
                 most {most}"
            )));
        }
        let space = &model.space;
        let is_constant = |j: &usize| {
            let value = |k: usize| model.design.matrix[(k, *j)];
            let mut firsts = vec![None; count];
            (0..groups.len()).all(|k| *firsts[groups[k]].get_or_insert(value(k)) == value(k))
        };
        let constant = (0..space.kept.len()).filter(|j| space.kept[*j]).filter(is_constant).count();
        if constant >= count {
            return Err(unidentified(format!(
                "expected more groups of {name} than columns that are constant in them, got {count} groups and {constant} columns"
            )));
        }
        Ok(())
    }
}
