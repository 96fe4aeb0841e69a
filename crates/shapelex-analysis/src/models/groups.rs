//! Groups of shapes by factors of a formula, and rows of the design for their averages and slopes.
//!
//! ```text
//! mean of g:   L = Σ_{k ∈ g} w_k x_k°/Σ_{k ∈ g} w_k                        x° with numbers at their weighted mean over all shapes
//! slope of g:  L = Σ_{k ∈ g} w_k (t_k − t̄_g) x_k/Σ_{k ∈ g} w_k (t_k − t̄_g)²
//! ```
//!
//! The slope is that of the regression of the fitted vectors on the covariate `t` within the group.

use std::collections::BTreeMap;

use super::anova::Model;
use super::design::{Cell, Prepared, Table, Values};
use super::error::ModelError;
use super::formula::{Formula, Term};
use super::variables::applied;

/// Maximum number of groups of pairs.
pub const MAX_GROUPS: usize = 50;

/// Treatment of the factors that are not among the groups.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum GroupWeights {
    /// Averages over the shapes of each group, as they occur.
    #[default]
    Observed,
    /// All levels count alike.
    Equal,
}

/// Groups of shapes: the combinations of levels that occur, in the order of the levels, the first factor slowest.
#[derive(Debug, Clone, PartialEq)]
pub struct Groups {
    /// Factors by their positions among the variables.
    variables: Vec<usize>,
    /// Levels of each group.
    levels: Vec<Vec<usize>>,
    /// Names of the groups: their levels, with colons between.
    pub names: Vec<String>,
    /// Group of each shape.
    pub of_shapes: Vec<usize>,
}

impl Groups {
    /// Number of groups.
    pub fn count(&self) -> usize {
        self.names.len()
    }

    /// Whether a variable is one of the factors.
    pub(super) fn is_of(&self, variable: usize) -> bool {
        self.variables.contains(&variable)
    }

    /// The model of the means of the groups.
    pub(super) fn formula(&self, of: &Formula) -> String {
        format!("~ {}", of.name(&Term(self.variables.clone())))
    }

    /// Number of shapes of each group.
    pub fn sizes(&self) -> Vec<usize> {
        let mut sizes = vec![0; self.count()];
        self.of_shapes.iter().for_each(|&group| sizes[group] += 1);
        sizes
    }
}

impl Model {
    /// Groups by the names of factors of the formula.
    ///
    /// # Errors
    /// [`ModelError::Setting`] at `field` for other names, fewer than two groups or more than 50, and a group of one shape.
    pub fn groups(&self, names: &[String], field: &'static str) -> Result<Groups, ModelError> {
        let refused = |detail: String| Err(ModelError::Setting { field, detail });
        let known: Vec<(usize, String)> = self.factors_of_terms();
        let mut variables = Vec::new();
        for name in names {
            let found = known
                .iter()
                .find(|(v, full)| full == name || self.design.formula.variables[*v].name == *name);
            match found {
                Some((v, _)) if !variables.contains(v) => variables.push(*v),
                Some(_) => return refused(format!("expected each factor once, got '{name}' again")),
                None => {
                    let all: Vec<&str> = known.iter().map(|(_, name)| name.as_str()).collect();
                    return refused(format!(
                        "expected factors of the formula, {}, got '{name}'",
                        if all.is_empty() { "which has none".into() } else { all.join(", ") }
                    ));
                }
            }
        }
        if variables.is_empty() {
            return refused("expected at least one factor of the formula, got none".into());
        }
        let groups = self.grouped(variables);
        let sizes = groups.sizes();
        if !(2..=MAX_GROUPS).contains(&groups.count()) {
            return refused(format!("expected 2 to {MAX_GROUPS} groups, got {}", groups.count()));
        }
        if let Some(group) = sizes.iter().position(|size| *size < 2) {
            let name = &groups.names[group];
            return refused(format!("expected groups of at least two shapes, got one in '{name}'"));
        }
        Ok(groups)
    }

    /// Factors of the fixed terms with their names.
    fn factors_of_terms(&self) -> Vec<(usize, String)> {
        let formula = &self.design.formula;
        let used = formula.terms.iter().fold(0, |set, term| set | term.set());
        let factors = self.design.factors().map(|(v, _)| v).filter(|v| used & 1 << v != 0);
        factors.map(|v| (v, formula.variables[v].to_string())).collect()
    }

    fn grouped(&self, variables: Vec<usize>) -> Groups {
        let level = |k: usize, v: usize| match self.design.cell(v, k) {
            Cell::Level(level) => level,
            _ => 0,
        };
        let keys: Vec<Vec<usize>> =
            (0..self.design.shapes()).map(|k| variables.iter().map(|&v| level(k, v)).collect()).collect();
        let mut numbers: BTreeMap<&Vec<usize>, usize> = keys.iter().map(|key| (key, 0)).collect();
        numbers.values_mut().enumerate().for_each(|(number, own)| *own = number);
        let name = |key: &Vec<usize>| {
            let of = |(&v, &level): (&usize, &usize)| match &self.design.variables[v] {
                Prepared::Factor(factor) => factor.levels[level].clone(),
                _ => String::new(),
            };
            variables.iter().zip(key).map(of).collect::<Vec<_>>().join(":")
        };
        let of_shapes = keys.iter().map(|key| numbers[key]).collect();
        let names = numbers.keys().map(|key| name(key)).collect();
        let levels = numbers.keys().map(|key| (*key).clone()).collect();
        Groups { variables, levels, names, of_shapes }
    }

    /// Rows of the design for the means of groups.
    pub fn mean_rows(&self, groups: &Groups, table: &Table, weights: GroupWeights) -> Vec<Vec<f64>> {
        let fixed: Vec<Option<Cell>> =
            (0..self.design.variables.len()).map(|v| self.central(v, table)).collect();
        let cell = |v: usize, k: usize, group: usize| {
            let own = groups.variables.iter().position(|variable| *variable == v);
            match (own, fixed[v]) {
                (Some(i), _) => Cell::Level(groups.levels[group][i]),
                (None, Some(number)) => number,
                (None, None) => self.design.cell(v, k),
            }
        };
        if weights == GroupWeights::Equal {
            let every = |v: usize, group: usize| match cell(v, 0, group) {
                Cell::Level(_) if !groups.variables.contains(&v) => Cell::Every,
                cell => cell,
            };
            return (0..groups.count()).map(|group| self.design.row(&|v| every(v, group))).collect();
        }
        let totals = self.totals(groups);
        let mut rows = vec![vec![0.0; self.design.columns.len()]; groups.count()];
        for (k, &group) in groups.of_shapes.iter().enumerate() {
            let own = self.design.row(&|v| cell(v, k, group));
            let weight = self.weights[k] / totals[group];
            rows[group].iter_mut().zip(own).for_each(|(sum, value)| *sum += weight * value);
        }
        rows
    }

    /// The mean of a numeric variable, with its function; `None` for factors.
    fn central(&self, v: usize, table: &Table) -> Option<Cell> {
        let variable = &self.design.formula.variables[v];
        if matches!(self.design.variables[v], Prepared::Factor(_)) {
            return None;
        }
        match (table.attributes.get(&variable.name), &self.design.variables[v]) {
            (Some(Values::Numbers(numbers)), Prepared::Numbers { function, .. }) => {
                Some(Cell::Number(applied(*function, self.average(numbers))))
            }
            (Some(Values::Numbers(numbers)), _) => Some(Cell::Number(self.average(numbers))),
            _ => None,
        }
    }

    fn totals(&self, groups: &Groups) -> Vec<f64> {
        let mut totals = vec![0.0; groups.count()];
        groups.of_shapes.iter().zip(&self.weights).for_each(|(&group, weight)| totals[group] += weight);
        totals
    }

    /// The numeric variable of a name.
    ///
    /// # Errors
    /// [`ModelError::Setting`] at `field` for another name.
    pub fn covariate(&self, name: &str, field: &'static str) -> Result<usize, ModelError> {
        let formula = &self.design.formula;
        let is_number = |v: &usize| !matches!(self.design.variables[*v], Prepared::Factor(_));
        let numbers: Vec<usize> = (0..formula.variables.len()).filter(is_number).collect();
        let full = |v: &&usize| formula.variables[**v].to_string() == name;
        let plain = |v: &&usize| formula.variables[**v].name == name;
        let found = numbers.iter().find(full).or_else(|| numbers.iter().find(plain));
        found.copied().ok_or_else(|| {
            let known: Vec<String> = numbers.iter().map(|&v| formula.variables[v].to_string()).collect();
            let known = if known.is_empty() { "which has none".into() } else { known.join(", ") };
            let detail = format!("expected a numeric variable of the formula, {known}, got '{name}'");
            ModelError::Setting { field, detail }
        })
    }

    /// Rows of the design for the slopes of groups on a numeric variable.
    ///
    /// # Errors
    /// [`ModelError::Setting`] at `field` for a group in which it does not vary.
    pub fn slope_rows(
        &self,
        groups: &Groups,
        covariate: usize,
        field: &'static str,
    ) -> Result<Vec<Vec<f64>>, ModelError> {
        let value = |k: usize| match self.design.cell(covariate, k) {
            Cell::Number(number) => number,
            _ => 0.0,
        };
        let (totals, mut means, mut squares) =
            (self.totals(groups), vec![0.0; groups.count()], vec![0.0; groups.count()]);
        let all = || groups.of_shapes.iter().copied().enumerate();
        all().for_each(|(k, group)| means[group] += self.weights[k] / totals[group] * value(k));
        all().for_each(|(k, group)| squares[group] += self.weights[k] * (value(k) - means[group]).powi(2));
        let mut rows = vec![vec![0.0; self.design.columns.len()]; groups.count()];
        for (group, square) in squares.iter().enumerate() {
            if !(*square > 1e-20 * totals[group] * means[group].powi(2)) {
                let (name, of) = (&groups.names[group], &self.design.formula.variables[covariate]);
                let detail =
                    format!("expected numbers that vary in each group, got one value of {of} in '{name}'");
                return Err(ModelError::Setting { field, detail });
            }
        }
        for (k, group) in all() {
            let factor = self.weights[k] * (value(k) - means[group]) / squares[group];
            let own = self.design.matrix.row(k);
            rows[group].iter_mut().zip(own.iter()).for_each(|(sum, x)| *sum += factor * x);
        }
        if self.design.formula.intercept {
            // The deviations sum to nothing: what is left in the intercept is rounding.
            rows.iter_mut().for_each(|row| row[0] = 0.0);
        }
        Ok(rows)
    }
}
