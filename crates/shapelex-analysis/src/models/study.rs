//! A model of aligned shapes, from its formula to the record: table, coefficients, predictions.

use std::collections::{BTreeMap, BTreeSet};

use super::anova::{Model, Testing};
use super::design::{Cell, Contrasts, Design, Factor, Prepared, Table, Values};
use super::error::ModelError;
use super::formula::{Formula, Function};
use super::records::{CoefficientRecord, ModelRecord, PredictionRecord};
use super::subspaces::Space;
use crate::inference::aligned::{AlignedShapes, mean_warnings};
use crate::inference::compare::UNEQUAL_SPREADS;
use crate::mean_record::MeanRecord;
use crate::metric::{Metric, norm};
use crate::quantile::quantile;
use crate::watch::Watch;
use shapelex_numeric::dense::{self, Matrix};

/// Name of the natural logarithm of the centroid size among the attributes.
pub const LOG_CENTROID_SIZE: &str = "log_centroid_size";
/// Maximum number of predictions.
pub const MAX_PREDICTIONS: usize = 100;
/// Quantiles of a number at which shapes are predicted where nothing is asked for.
const QUANTILES: [f64; 3] = [0.05, 0.5, 0.95];
/// Levels of a factor for which shapes are predicted where nothing is asked for.
const USUAL_LEVELS: usize = 12;
/// Fewest shapes of a group whose scatter is compared.
const FEWEST: usize = 5;

/// A value of an attribute at which a shape is predicted.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(untagged))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum At {
    /// A number.
    Number(f64),
    /// A level.
    Level(String),
}

/// What is modelled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Response<'a> {
    /// The shapes.
    Shape,
    /// A number for each shape.
    Numbers(&'a [f64]),
}

/// What is asked of a model.
#[derive(Debug)]
pub struct ModelQuestion<'a> {
    /// The formula.
    pub formula: &'a Formula,
    /// Attributes of the shapes.
    pub table: &'a Table,
    /// Coding of factors.
    pub contrasts: Contrasts,
    /// What is modelled.
    pub response: Response<'a>,
    /// Tests.
    pub testing: Testing<'a>,
    /// Values of attributes at which shapes are predicted. Default: at the levels, or at quantiles, of the first variable.
    pub at: Option<&'a [BTreeMap<String, At>]>,
}

/// The model of aligned shapes.
///
/// Predictions are those of the whole model. Numeric attributes that are not given have their weighted mean; over factors that are not
/// given the shapes are averaged as they occur.
///
/// Cost: that of [`Fitted::permuted`](super::permuted::Fitted::permuted) for every kind of exchange.
///
/// # Errors
/// Errors of the formula, the design and the tests; predictions at unknown levels.
pub fn model(
    shapes: &AlignedShapes<'_>,
    question: &ModelQuestion<'_>,
    watch: &dyn Watch,
) -> Result<ModelRecord, ModelError> {
    let vectors = match question.response {
        Response::Shape => shapes.aligned.clone(),
        Response::Numbers(numbers) => Matrix::from_row_slice(1, numbers.len(), numbers),
    };
    let metric = matches!(question.response, Response::Shape).then_some(shapes.space.metric);
    let mut record = of_vectors(vectors, shapes.weights.clone(), metric, question, watch)?;
    record.pooled = metric.map(|metric| MeanRecord::of(&shapes.mean, metric.dimension()));
    record.anova.warnings.splice(0..0, mean_warnings(&shapes.mean));
    Ok(record)
}

/// The model of vectors in columns; with a metric they are whitened shapes.
fn of_vectors(
    vectors: Matrix,
    weights: Vec<f64>,
    metric: Option<&Metric>,
    question: &ModelQuestion<'_>,
    watch: &dyn Watch,
) -> Result<ModelRecord, ModelError> {
    let ModelQuestion { formula, table, contrasts, testing, at, .. } = question;
    let found = Model::new(formula, table, *contrasts, vectors, weights)?;
    let mut anova = found.anova(testing, watch)?;
    anova.warnings.extend(scatter_warning(&found));
    let coefficients = Coefficients::new(&found);
    let usual;
    let at = match at {
        Some(at) => *at,
        None => {
            usual = usual_places(&found.design, table);
            usual.as_slice()
        }
    };
    let predictor = Predictor { model: &found, table, coefficients: &coefficients, metric };
    let predictions =
        at.iter().enumerate().map(|(k, at)| predictor.predict(k, at)).collect::<Result<Vec<_>, _>>()?;
    let records = coefficients.records(&found.design, &found.space, metric);
    Ok(ModelRecord { anova, pooled: None, coefficients: records, predictions })
}

/// Coefficients of the columns that are kept, with `C⁻ᵀ` for leverages.
struct Coefficients {
    /// One row for each kept column.
    rows: Matrix,
    kept: Vec<usize>,
    /// Inverse of `Cᵀ` of the kept columns; `None` only for a basis that lost all digits.
    inverse: Option<Matrix>,
}

impl Coefficients {
    fn new(model: &Model) -> Self {
        let space = &model.space;
        let kept: Vec<usize> = (0..space.kept.len()).filter(|j| space.kept[*j]).collect();
        let coordinates = Matrix::from_fn(space.rank(), kept.len(), |i, j| space.coordinates[(i, kept[j])]);
        // About the mean, which is the intercept's: coordinates keep the digits of the differences.
        let mean = if model.design.formula.intercept { model.mean() } else { vec![0.0; model.length()] };
        let mut centred = model.scaled_about(&mean);
        centred = dense::multiply(&centred, &space.basis);
        let mut rows = coordinates
            .clone()
            .lu()
            .solve(&centred.transpose())
            .unwrap_or_else(|| Matrix::zeros(kept.len(), mean.len()));
        if model.design.formula.intercept {
            rows.row_mut(0).iter_mut().zip(&mean).for_each(|(value, mean)| *value += mean);
        }
        Self { rows, kept, inverse: coordinates.transpose().try_inverse() }
    }

    fn records(&self, design: &Design, space: &Space, metric: Option<&Metric>) -> Vec<CoefficientRecord> {
        let of = |(j, column): (usize, &String)| {
            let own = self.kept.iter().position(|kept| *kept == j).filter(|_| space.kept[j]);
            let values: Option<Vec<f64>> = own.map(|row| self.rows.row(row).iter().copied().collect());
            CoefficientRecord {
                column: column.clone(),
                norm: values.as_deref().map(norm),
                value: values.as_ref().filter(|_| metric.is_none()).map(|values| values[0]),
                shape: values.as_ref().and_then(|values| metric.map(|metric| metric.rows(values))),
            }
        };
        design.columns.iter().enumerate().map(of).collect()
    }

    /// `x_0 (XᵀWX)⁻¹ x_0ᵀ` of a row of the kept columns.
    fn leverage(&self, row: &[f64]) -> f64 {
        let row = Matrix::from_column_slice(row.len(), 1, row);
        self.inverse.as_ref().map_or(f64::NAN, |inverse| (inverse * row).norm_squared())
    }
}

struct Predictor<'a> {
    model: &'a Model,
    table: &'a Table,
    coefficients: &'a Coefficients,
    metric: Option<&'a Metric>,
}

impl Predictor<'_> {
    fn predict(&self, k: usize, at: &BTreeMap<String, At>) -> Result<PredictionRecord, ModelError> {
        let design = &self.model.design;
        for name in at.keys() {
            if !design.formula.variables.iter().any(|variable| variable.name == *name) {
                return Err(ModelError::UnknownPlace {
                    place: k,
                    name: name.clone(),
                    detail: "an attribute of the formula".into(),
                });
            }
        }
        let mut extrapolated = false;
        let mut fixed = Vec::with_capacity(design.variables.len());
        for (v, variable) in design.variables.iter().enumerate() {
            fixed.push(self.fixed(k, v, variable, at, &mut extrapolated)?);
        }
        let row = self.row(&fixed);
        let kept: Vec<f64> = self.coefficients.kept.iter().map(|&j| row[j]).collect();
        let values: Vec<f64> = (0..self.coefficients.rows.ncols())
            .map(|c| kept.iter().zip(self.coefficients.rows.column(c).iter()).map(|(x, b)| x * b).sum())
            .collect();
        Ok(PredictionRecord {
            at: at.clone(),
            value: self.metric.is_none().then(|| values[0]),
            shape: self.metric.map(|metric| metric.rows(&values)),
            leverage: self.coefficients.leverage(&kept),
            extrapolated,
        })
    }

    /// The value of a variable for all shapes of a prediction, if it has one.
    fn fixed(
        &self,
        k: usize,
        v: usize,
        variable: &Prepared,
        at: &BTreeMap<String, At>,
        extrapolated: &mut bool,
    ) -> Result<Option<Cell>, ModelError> {
        let name = &self.model.design.formula.variables[v].name;
        let wrong = |detail: String| Err(ModelError::UnknownPlace { place: k, name: name.clone(), detail });
        match (variable, at.get(name)) {
            (Prepared::Factor(_), None) => Ok(None),
            (Prepared::Factor(factor), Some(given)) => {
                let text = match given {
                    At::Level(level) => level.clone(),
                    At::Number(number) => number.to_string(),
                };
                match factor.levels.iter().position(|level| *level == text) {
                    Some(level) => Ok(Some(Cell::Level(level))),
                    None => wrong(format!("one of the levels {}", some_of(&factor.levels))),
                }
            }
            (_, Some(At::Level(_))) => wrong("a number".into()),
            (_, given) => {
                let Some(Values::Numbers(numbers)) = self.table.attributes.get(name) else {
                    return wrong("a number".into());
                };
                let x = match given {
                    Some(At::Number(x)) => {
                        let (least, most) = bounds(numbers);
                        *extrapolated |= !(least..=most).contains(x);
                        *x
                    }
                    _ => self.model.average(numbers),
                };
                let value = match variable {
                    Prepared::Numbers { function, .. } => applied(*function, x),
                    _ => x,
                };
                match value.is_finite() && value.abs() <= super::MAX_VALUE {
                    true => Ok(Some(Cell::Number(value))),
                    false => {
                        wrong(format!("a number whose {} is one", self.model.design.formula.variables[v]))
                    }
                }
            }
        }
    }

    /// The row of the design, averaged over the shapes where factors are not given.
    fn row(&self, fixed: &[Option<Cell>]) -> Vec<f64> {
        let design = &self.model.design;
        let of = |k: usize| design.row(&|v| fixed[v].unwrap_or_else(|| design.cell(v, k)));
        if fixed.iter().all(Option::is_some) {
            return of(0);
        }
        let weights = self.model.weights();
        let total: f64 = weights.iter().sum();
        let mut row = vec![0.0; design.columns.len()];
        for (k, weight) in weights.iter().enumerate() {
            row.iter_mut().zip(of(k)).for_each(|(sum, value)| *sum += weight / total * value);
        }
        row
    }
}

fn applied(function: Function, x: f64) -> f64 {
    match function {
        Function::Log => x.ln(),
        Function::Sqrt => x.sqrt(),
        Function::Power(degree) => x.powi(degree.cast_signed()),
        Function::Identity | Function::Factor | Function::Poly(_) => x,
    }
}

fn bounds(numbers: &[f64]) -> (f64, f64) {
    let least = numbers.iter().copied().fold(f64::MAX, f64::min);
    (least, numbers.iter().copied().fold(f64::MIN, f64::max))
}

fn some_of(levels: &[String]) -> String {
    let first: Vec<String> = levels.iter().take(10).map(|level| format!("'{level}'")).collect();
    let more = if levels.len() > 10 { format!(" and {} more", levels.len() - 10) } else { String::new() };
    first.join(", ") + &more
}

/// Where shapes are predicted if nothing is asked for: at the levels of the first variable, or at its quantiles.
fn usual_places(design: &Design, table: &Table) -> Vec<BTreeMap<String, At>> {
    let Some(&first) = design.formula.terms.first().and_then(|term| term.0.first()) else {
        return Vec::new();
    };
    let name = &design.formula.variables[first].name;
    let at = |at: At| BTreeMap::from([(name.clone(), at)]);
    match (&design.variables[first], table.attributes.get(name)) {
        (Prepared::Factor(Factor { levels, .. }), _) => {
            levels.iter().take(USUAL_LEVELS).map(|level| at(At::Level(level.clone()))).collect()
        }
        (_, Some(Values::Numbers(numbers))) => {
            let mut sorted = numbers.clone();
            sorted.sort_by(f64::total_cmp);
            QUANTILES.iter().map(|q| at(At::Number(quantile(&sorted, *q)))).collect()
        }
        _ => Vec::new(),
    }
}

/// Warning about groups, the combinations of all factors of the formula, whose residuals scatter unequally: permutations of residuals
/// assume that they do not.
fn scatter_warning(model: &Model) -> Option<String> {
    let design = &model.design;
    let used: BTreeSet<usize> = design.formula.terms.iter().flat_map(|term| term.0.iter().copied()).collect();
    let factors: Vec<usize> = design.factors().map(|(k, _)| k).filter(|k| used.contains(k)).collect();
    if factors.is_empty() {
        return None;
    }
    let groups = design.cells_of(&super::formula::Term(factors.clone()));
    let (squares, leverages) = (model.fitted.squares(), model.space.leverages());
    let count = groups.iter().max().map_or(0, |last| last + 1);
    let mut sums = vec![(0.0, 0.0, 0_usize, usize::MAX); count];
    for (k, &group) in groups.iter().enumerate() {
        let (square, free, number, first) = &mut sums[group];
        *square += squares[k];
        *free += 1.0 - leverages[k];
        *number += 1;
        *first = (*first).min(k);
    }
    if count < 2 || sums.iter().any(|(_, free, number, _)| *number < FEWEST || *free <= 0.0) {
        return None;
    }
    let spread = |(square, free, _, _): &(f64, f64, usize, usize)| (square / free).sqrt();
    let wide = sums.iter().max_by(|a, b| spread(a).total_cmp(&spread(b)))?;
    let narrow = sums.iter().min_by(|a, b| spread(a).total_cmp(&spread(b)))?;
    if spread(wide) <= UNEQUAL_SPREADS * spread(narrow) {
        return None;
    }
    let name = |k: usize| {
        let level = |&v: &usize| match (&design.variables[v], design.cell(v, k)) {
            (Prepared::Factor(factor), Cell::Level(level)) => factor.levels[level].clone(),
            _ => String::new(),
        };
        factors.iter().map(level).collect::<Vec<_>>().join(":")
    };
    let ratio = match spread(narrow) > 0.0 {
        true => format!("{:.2} times as much as", spread(wide) / spread(narrow)),
        false => "unlike".into(),
    };
    let sizes: BTreeSet<usize> = sums.iter().map(|(_, _, number, _)| *number).collect();
    let meaning = match sizes.len() {
        1 => "groups of equal size bear this well",
        _ => "with groups of unequal size the tests find differences too often, or too rarely",
    };
    Some(format!(
        "shapes of '{}' scatter {ratio} those of '{}' about the model, and the tests assume equal scatter: {meaning}",
        name(wide.3),
        name(narrow.3)
    ))
}
