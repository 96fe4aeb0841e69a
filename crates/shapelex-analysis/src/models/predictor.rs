//! Predictions of a model at values of its attributes.
//!
//! ```text
//! ŷ_0 = x_0 B̂,   h_0 = x_0 (XᵀWX)⁻¹ x_0ᵀ            x_0: the row of the design at the values
//! ```
//!
//! Numeric attributes that are not given have their weighted mean; over factors that are not given the rows are averaged as their
//! combinations of levels occur. Of the shapes themselves nothing is needed: a model is kept without them.

use std::collections::BTreeMap;

use super::anova::{Model, average};
use super::coefficients::Coefficients;
use super::design::{Cell, Design, Prepared, Table, Values};
use super::error::ModelError;
use super::formula::{Term, Variable};
use super::outcome::PredictionRecord;
use super::records::At;
use super::variables::applied;
use crate::metric::Metric;

/// Names of levels in the text of a refusal.
const MOST_NAMES: usize = 10;

/// A numeric attribute, as it occurs.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Occurring {
    mean: f64,
    least: f64,
    most: f64,
}

/// Attributes of the shapes of a model: the combinations of levels and the ranges of numbers that occur.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Attributes {
    /// The design of one shape of each combination of levels, without its numbers.
    design: Design,
    /// Part of each combination in the sum of the weights.
    parts: Vec<f64>,
    /// Of each variable; none of factors.
    numbers: Vec<Option<Occurring>>,
}

impl Attributes {
    /// Attributes of the shapes of a model, whose values are those of the table.
    ///
    /// # Errors
    /// None but for a design that is no design.
    pub(super) fn new(model: &Model, table: &Table) -> Result<Self, ModelError> {
        Self::of(&model.design, model.weights(), table)
    }

    /// Attributes of rows of a design with these weights.
    pub(super) fn of(design: &Design, weights: &[f64], table: &Table) -> Result<Self, ModelError> {
        let used = design.formula.terms.iter().fold(0, |set, term| set | term.set());
        let factors = design.factors().map(|(k, _)| k).filter(|k| used & 1 << k != 0).collect();
        let (mut firsts, mut parts) = (Vec::new(), Vec::new());
        let total: f64 = weights.iter().sum();
        for (k, (cell, weight)) in design.cells_of(&Term(factors)).into_iter().zip(weights).enumerate() {
            if cell == firsts.len() {
                firsts.push(k);
                parts.push(0.0);
            }
            parts[cell] += weight / total;
        }
        let occurring = |name: &str| match table.attributes.get(name) {
            Some(Values::Numbers(numbers)) => Some(Occurring {
                mean: average(numbers, weights),
                least: numbers.iter().copied().fold(f64::MAX, f64::min),
                most: numbers.iter().copied().fold(f64::MIN, f64::max),
            }),
            _ => None,
        };
        let of = |(variable, prepared): (&Variable, &Prepared)| match prepared {
            Prepared::Factor(_) => None,
            _ => occurring(&variable.name),
        };
        let numbers = design.formula.variables.iter().zip(&design.variables).map(of).collect();
        Ok(Self { design: design.chosen(design.formula.clone(), &firsts)?, parts, numbers })
    }

    /// The design of the combinations of levels.
    pub(super) fn design(&self) -> &Design {
        &self.design
    }

    /// A value that is written as text: a level of a factor, or a number.
    pub fn read(&self, name: &str, text: &str) -> At {
        let mut own = self.design.formula.variables.iter().zip(&self.design.variables);
        let is_factor =
            own.any(|(variable, own)| variable.name == name && matches!(own, Prepared::Factor(_)));
        match text.parse() {
            Ok(number) if !is_factor => At::Number(number),
            _ => At::Level(text.to_owned()),
        }
    }

    /// The row of the design at some values, and whether a number is outside of those of the shapes. `k` is the position of the
    /// prediction.
    fn row(&self, k: usize, at: &BTreeMap<String, At>) -> Result<(Vec<f64>, bool), ModelError> {
        let variables = &self.design.formula.variables;
        if let Some(name) = at.keys().find(|name| variables.iter().all(|variable| variable.name != **name)) {
            let detail = "an attribute of the formula".into();
            return Err(ModelError::UnknownPlace { place: k, name: name.clone(), detail });
        }
        let mut extrapolated = false;
        let fixed = (0..variables.len()).map(|v| self.fixed(k, v, at, &mut extrapolated));
        let fixed = fixed.collect::<Result<Vec<Option<Cell>>, _>>()?;
        let of = |cell: usize| self.design.row(&|v| fixed[v].unwrap_or_else(|| self.design.cell(v, cell)));
        if fixed.iter().all(Option::is_some) {
            return Ok((of(0), extrapolated));
        }
        let mut row = vec![0.0; self.design.columns.len()];
        for (cell, part) in self.parts.iter().enumerate() {
            row.iter_mut().zip(of(cell)).for_each(|(sum, value)| *sum += part * value);
        }
        Ok((row, extrapolated))
    }

    /// The value of a variable for all combinations of levels, if it has one.
    fn fixed(
        &self,
        k: usize,
        v: usize,
        at: &BTreeMap<String, At>,
        extrapolated: &mut bool,
    ) -> Result<Option<Cell>, ModelError> {
        let variable = &self.design.formula.variables[v];
        let name = &variable.name;
        let wrong = |detail: String| Err(ModelError::UnknownPlace { place: k, name: name.clone(), detail });
        match (&self.design.variables[v], at.get(name)) {
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
            (prepared, given) => {
                let Some(occurring) = &self.numbers[v] else { return wrong("a number".into()) };
                let x = match given {
                    Some(At::Number(x)) => {
                        *extrapolated |= !(occurring.least..=occurring.most).contains(x);
                        *x
                    }
                    _ => occurring.mean,
                };
                let value = match prepared {
                    Prepared::Numbers { function, .. } => applied(*function, x),
                    _ => x,
                };
                match value.is_finite() && value.abs() <= super::MAX_VALUE {
                    true => Ok(Some(Cell::Number(value))),
                    false => wrong(format!("a number whose {variable} is one")),
                }
            }
        }
    }
}

/// Attributes, coefficients and metric of a model.
pub(super) struct Predictor<'a> {
    pub(super) attributes: &'a Attributes,
    pub(super) coefficients: &'a Coefficients,
    /// None if numbers are modelled.
    pub(super) metric: Option<&'a Metric>,
}

impl Predictor<'_> {
    /// The row of the design, and the prediction at some values. `k` is its position.
    ///
    /// # Errors
    /// Unknown attributes and levels; [`ModelError::Undetermined`].
    pub(super) fn predict(
        &self,
        k: usize,
        at: &BTreeMap<String, At>,
    ) -> Result<(Vec<f64>, PredictionRecord), ModelError> {
        let (row, extrapolated) = self.attributes.row(k, at)?;
        if let Some(column) = self.coefficients.undetermined(&row) {
            let column = self.attributes.design.columns[column].clone();
            return Err(ModelError::Undetermined { place: k, column });
        }
        let kept = self.coefficients.of_kept(&row);
        let values = self.coefficients.values(&kept);
        let record = PredictionRecord {
            at: at.clone(),
            value: self.metric.is_none().then(|| values[0]),
            shape: self.metric.map(|metric| metric.rows(&values)),
            leverage: self.coefficients.leverage(&kept),
            extrapolated,
            band: None,
        };
        Ok((row, record))
    }

    /// Rows of the design, and predictions, at places that were asked for.
    ///
    /// # Errors
    /// Those of [`Self::predict`].
    pub(super) fn predict_all(&self, places: &[BTreeMap<String, At>]) -> Result<Predicted, ModelError> {
        let predicted = places.iter().enumerate().map(|(k, at)| self.predict(k, at));
        Ok(predicted.collect::<Result<Vec<_>, _>>()?.into_iter().unzip())
    }

    /// As [`Self::predict_all`] at the usual places, which the model chooses where a request names none: a place that the shapes do not
    /// determine is left out with a warning.
    pub(super) fn usual(&self, places: &[BTreeMap<String, At>], warnings: &mut Vec<String>) -> Predicted {
        let predicted = places.iter().enumerate().filter_map(|(k, at)| self.predict(k, at).ok());
        let found: Predicted = predicted.unzip();
        let left_out = places.len() - found.0.len();
        if left_out > 0 {
            warnings.push(format!(
                "{left_out} of {} usual predictions are left out: the shapes do not determine them, since combinations of levels \
                 have no shapes; give values of more attributes in 'at'",
                places.len()
            ));
        }
        found
    }
}

/// Rows of a design, and the predictions there.
type Predicted = (Vec<Vec<f64>>, Vec<PredictionRecord>);

fn some_of(levels: &[String]) -> String {
    let first: Vec<String> = levels.iter().take(MOST_NAMES).map(|level| format!("'{level}'")).collect();
    let more = levels.len().saturating_sub(MOST_NAMES);
    first.join(", ") + &(if more > 0 { format!(" and {more} more") } else { String::new() })
}
