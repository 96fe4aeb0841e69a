//! Design matrices of formulas.
//!
//! A numeric variable has one column, a polynomial one for each degree, a factor one for each of its contrasts or levels: within a
//! term `t`, a factor `v` is coded by contrasts if the model holds `t` without `v` (the empty product is the intercept), otherwise by
//! indicators of all its levels. The columns of a term are all products, the first variable running fastest.
//!
//! Source: Chambers and Hastie 1992, chapter 2.

use super::error::ModelError;
use super::formula::{Formula, Term};
use super::variables::prepared;
use crate::strata::strata;
use shapelex_numeric::dense::Matrix;

pub use super::variables::{Cell, Factor, MAX_LEVELS, Polynomial, Prepared, Table, Values};

/// Maximum number of columns of a design.
pub const MAX_COLUMNS: usize = 1000;

/// Coding of factors. It changes coefficients and sums of squares of type III, never those of type I and II or fitted shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub enum Contrasts {
    /// Each level beside the reference.
    #[default]
    Treatment,
    /// Each level but the last beside the mean of all.
    Sum,
    /// Each level beside the mean of those before it.
    Helmert,
}

/// How a factor is coded within a term.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
enum Coding {
    Contrasts,
    Indicators,
}

/// A design: the columns of the terms of a formula, for all shapes.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Design {
    /// The formula.
    pub formula: Formula,
    /// Its variables.
    pub variables: Vec<Prepared>,
    /// Coding of factors.
    pub contrasts: Contrasts,
    /// Names of the columns.
    pub columns: Vec<String>,
    /// Number of the term of each column, counted from 1; 0 is the intercept.
    pub term_of_column: Vec<usize>,
    /// One row for each shape; none of a design that is only [named](Self::named).
    #[cfg_attr(feature = "serde", serde(skip, default = "no_numbers"))]
    pub matrix: Matrix,
    shapes: usize,
    /// Warnings about levels that do not occur.
    pub warnings: Vec<String>,
    coding: Vec<Vec<Coding>>,
}

impl Design {
    /// Columns of `formula` for the shapes of `table`.
    ///
    /// # Errors
    /// A variable that the table has not; numbers where texts are expected, and the reverse; a factor of one level, a number without
    /// variation, a degree that the values do not allow; too many columns.
    pub fn new(formula: &Formula, table: &Table, contrasts: Contrasts) -> Result<Self, ModelError> {
        Self::named(formula, table, contrasts).map(Self::filled)
    }

    /// The design without the numbers of its columns, which may be many.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn named(formula: &Formula, table: &Table, contrasts: Contrasts) -> Result<Self, ModelError> {
        let mut warnings = Vec::new();
        let slopes = formula.random.iter().flat_map(|part| &part.terms);
        let used = formula.terms.iter().chain(slopes).fold(0, |set, term| set | term.set());
        let mut variables = Vec::new();
        let expected = table.attributes.values().next().map_or(0, Values::len);
        if let Some((name, values)) = table.attributes.iter().find(|(_, values)| values.len() != expected) {
            return Err(ModelError::Lengths { name: name.clone(), found: values.len(), expected });
        }
        for (k, variable) in formula.variables.iter().enumerate() {
            let values = table
                .attributes
                .get(&variable.name)
                .ok_or_else(|| ModelError::UnknownVariable { name: variable.name.clone() })?;
            let levels = table.levels.get(&variable.name);
            let is_factor = used & 1 << k == 0 || levels.is_some();
            let name = variable.to_string();
            variables.push(prepared(&name, values, variable.function, is_factor, levels, &mut warnings)?);
        }
        let coding = formula.terms.iter().map(|term| coding_of(formula, term)).collect();
        let mut design = Self {
            formula: formula.clone(),
            variables,
            contrasts,
            columns: Vec::new(),
            term_of_column: Vec::new(),
            matrix: no_numbers(),
            shapes: table.attributes.values().next().map_or(0, Values::len),
            warnings,
            coding,
        };
        design.check_variation(used)?;
        design.name_columns()?;
        Ok(design)
    }

    /// The design with the numbers of its columns.
    #[must_use]
    pub fn filled(mut self) -> Self {
        self.matrix = self.rows();
        self
    }

    /// The same design with other contrasts.
    #[must_use]
    pub fn with_contrasts(&self, contrasts: Contrasts) -> Self {
        let mut design = Self { contrasts, columns: Vec::new(), term_of_column: Vec::new(), ..self.clone() };
        // The number of columns does not depend on the contrasts.
        let _ = design.name_columns();
        design.filled()
    }

    /// The design of other terms of the same variables, for these shapes.
    ///
    /// # Errors
    /// Too many columns.
    pub(super) fn restricted(&self, formula: Formula, shapes: &[usize]) -> Result<Self, ModelError> {
        self.chosen(formula, shapes).map(Self::filled)
    }

    /// As [`Self::restricted`], without the numbers of its columns.
    ///
    /// # Errors
    /// Too many columns.
    pub(super) fn chosen(&self, formula: Formula, shapes: &[usize]) -> Result<Self, ModelError> {
        let chosen = |values: &[f64]| shapes.iter().map(|&k| values[k]).collect();
        let variable = |variable: &Prepared| match variable {
            Prepared::Numbers { values, function } => {
                Prepared::Numbers { values: chosen(values), function: *function }
            }
            Prepared::Polynomial(polynomial) => {
                Prepared::Polynomial(polynomial.with_values(chosen(&polynomial.values)))
            }
            Prepared::Factor(factor) => Prepared::Factor(Factor {
                levels: factor.levels.clone(),
                of_shapes: shapes.iter().map(|&k| factor.of_shapes[k]).collect(),
            }),
        };
        let coding = formula.terms.iter().map(|term| coding_of(&formula, term)).collect();
        let variables = self.variables.iter().map(variable).collect();
        let mut design = Self {
            formula,
            variables,
            contrasts: self.contrasts,
            columns: Vec::new(),
            term_of_column: Vec::new(),
            matrix: no_numbers(),
            shapes: shapes.len(),
            warnings: self.warnings.clone(),
            coding,
        };
        design.name_columns()?;
        Ok(design)
    }

    /// Number of shapes.
    pub fn shapes(&self) -> usize {
        self.shapes
    }

    /// Value of a variable for shape `k`.
    pub fn cell(&self, variable: usize, k: usize) -> Cell {
        match &self.variables[variable] {
            Prepared::Numbers { values, .. } => Cell::Number(values[k]),
            Prepared::Polynomial(polynomial) => Cell::Number(polynomial.values[k]),
            Prepared::Factor(factor) => Cell::Level(factor.of_shapes[k]),
        }
    }

    /// The row of the columns for these values of the variables.
    pub fn row(&self, cell: &dyn Fn(usize) -> Cell) -> Vec<f64> {
        let mut row = Vec::with_capacity(self.columns.len());
        if self.formula.intercept {
            row.push(1.0);
        }
        for (term, coding) in self.formula.terms.iter().zip(&self.coding) {
            let mut products = vec![1.0];
            for (&variable, &coding) in term.0.iter().zip(coding) {
                let values = self.values(variable, coding, cell(variable));
                products =
                    values.iter().flat_map(|value| products.iter().map(move |own| own * value)).collect();
            }
            row.extend(products);
        }
        row
    }

    /// The factors of the formula by their positions.
    pub fn factors(&self) -> impl Iterator<Item = (usize, &Factor)> {
        self.variables.iter().enumerate().filter_map(|(k, variable)| match variable {
            Prepared::Factor(factor) => Some((k, factor)),
            _ => None,
        })
    }

    /// Combinations of levels of the factors of a term, for each shape; shapes of one combination have one number, counted in the order
    /// of their first shape.
    pub fn cells_of(&self, term: &Term) -> Vec<usize> {
        let key = |k: usize| -> Vec<u64> {
            let bits = |&variable: &usize| match self.cell(variable, k) {
                Cell::Number(number) => number.to_bits(),
                Cell::Level(level) => level as u64,
                Cell::Every => u64::MAX,
            };
            term.0.iter().map(bits).collect()
        };
        strata((0..self.shapes).map(key))
    }

    /// Levels of some variables for shape `k`, as one name; numbers have none.
    pub fn levels_at(&self, variables: &[usize], k: usize) -> String {
        let level = |&v: &usize| match (&self.variables[v], self.cell(v, k)) {
            (Prepared::Factor(factor), Cell::Level(level)) => factor.levels[level].clone(),
            _ => String::new(),
        };
        variables.iter().map(level).collect::<Vec<_>>().join(":")
    }

    /// Number of combinations of a term that occur.
    pub fn count(&self, term: &Term) -> usize {
        self.cells_of(term).iter().max().map_or(0, |last| last + 1)
    }

    fn rows(&self) -> Matrix {
        let mut matrix = Matrix::zeros(self.shapes, self.columns.len());
        for k in 0..self.shapes {
            let row = self.row(&|variable| self.cell(variable, k));
            row.into_iter().enumerate().for_each(|(j, value)| matrix[(k, j)] = value);
        }
        matrix
    }

    /// Checks that the variables of terms vary.
    fn check_variation(&self, used: u64) -> Result<(), ModelError> {
        for (k, variable) in self.variables.iter().enumerate().filter(|(k, _)| used & 1 << k != 0) {
            let name = || self.formula.variables[k].to_string();
            match variable {
                Prepared::Factor(factor) if factor.levels.len() < 2 => {
                    let level = factor.levels.first().cloned().unwrap_or_default();
                    return Err(ModelError::OneLevel { name: name(), level });
                }
                Prepared::Numbers { values, .. } if values.iter().all(|value| *value == values[0]) => {
                    let value = values.first().copied().unwrap_or_default();
                    return Err(ModelError::Constant { name: name(), value });
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn name_columns(&mut self) -> Result<(), ModelError> {
        let mut columns = Vec::new();
        let mut owners = Vec::new();
        if self.formula.intercept {
            columns.push("(Intercept)".to_owned());
            owners.push(0);
        }
        for (t, (term, coding)) in self.formula.terms.iter().zip(&self.coding).enumerate() {
            let mut names = vec![String::new()];
            for (&variable, &coding) in term.0.iter().zip(coding) {
                let own = self.labels(variable, coding);
                if own.len().saturating_mul(names.len()) > MAX_COLUMNS {
                    return Err(ModelError::ManyColumns { found: own.len().saturating_mul(names.len()) });
                }
                let join = |before: &String, name: &String| {
                    if before.is_empty() { name.clone() } else { format!("{before}:{name}") }
                };
                names =
                    own.iter().flat_map(|name| names.iter().map(move |before| join(before, name))).collect();
            }
            owners.extend(std::iter::repeat_n(t + 1, names.len()));
            columns.extend(names);
            if columns.len() > MAX_COLUMNS {
                return Err(ModelError::ManyColumns { found: columns.len() });
            }
        }
        (self.columns, self.term_of_column) = (columns, owners);
        Ok(())
    }

    /// Names of the columns of a variable.
    fn labels(&self, variable: usize, coding: Coding) -> Vec<String> {
        let name = self.formula.variables[variable].to_string();
        match &self.variables[variable] {
            Prepared::Numbers { .. } => vec![name],
            Prepared::Polynomial(polynomial) => {
                (1..=polynomial.degree()).map(|degree| format!("{name}{degree}")).collect()
            }
            Prepared::Factor(factor) => match (coding, self.contrasts) {
                (Coding::Indicators, _) => {
                    factor.levels.iter().map(|level| format!("{name}{level}")).collect()
                }
                (Coding::Contrasts, Contrasts::Treatment) => {
                    factor.levels[1..].iter().map(|level| format!("{name}{level}")).collect()
                }
                (Coding::Contrasts, Contrasts::Sum | Contrasts::Helmert) => {
                    (1..factor.levels.len()).map(|k| format!("{name}{k}")).collect()
                }
            },
        }
    }

    /// Values of the columns of a variable.
    fn values(&self, variable: usize, coding: Coding, cell: Cell) -> Vec<f64> {
        match (&self.variables[variable], cell) {
            (Prepared::Polynomial(polynomial), Cell::Number(x)) => polynomial.at(x),
            (Prepared::Factor(factor), Cell::Level(level)) => {
                let count = factor.levels.len();
                match coding {
                    Coding::Indicators => (0..count).map(|k| f64::from(u8::from(k == level))).collect(),
                    Coding::Contrasts => {
                        (0..count - 1).map(|k| contrast(self.contrasts, level, k, count)).collect()
                    }
                }
            }
            (Prepared::Factor(factor), Cell::Every) => {
                let count = factor.levels.len();
                let of = |level| self.values(variable, coding, Cell::Level(level));
                let sums = (0..count).map(of).reduce(|a, b| a.iter().zip(b).map(|(a, b)| a + b).collect());
                sums.unwrap_or_default().into_iter().map(|sum| sum / count as f64).collect()
            }
            (_, Cell::Number(x)) => vec![x],
            (_, Cell::Level(_) | Cell::Every) => vec![0.0],
        }
    }
}

/// The matrix of a design that is only named.
fn no_numbers() -> Matrix {
    Matrix::zeros(0, 0)
}

/// Value of contrast `k` of a factor of `count` levels at a level.
fn contrast(contrasts: Contrasts, level: usize, k: usize, count: usize) -> f64 {
    match contrasts {
        Contrasts::Treatment => f64::from(u8::from(level == k + 1)),
        Contrasts::Sum if level == count - 1 => -1.0,
        Contrasts::Sum => f64::from(u8::from(level == k)),
        Contrasts::Helmert if level <= k => -1.0,
        Contrasts::Helmert if level == k + 1 => (k + 1) as f64,
        Contrasts::Helmert => 0.0,
    }
}

fn coding_of(formula: &Formula, term: &Term) -> Vec<Coding> {
    let of = |variable: &usize| match formula.holds(term.set() & !(1 << variable)) {
        true => Coding::Contrasts,
        false => Coding::Indicators,
    };
    term.0.iter().map(of).collect()
}
