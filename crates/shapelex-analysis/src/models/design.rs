//! Design matrices of formulas.
//!
//! A numeric variable has one column, a polynomial one for each degree, a factor one for each of its contrasts or levels: within a
//! term `t`, a factor `v` is coded by contrasts if the model holds `t` without `v` (the empty product is the intercept), otherwise by
//! indicators of all its levels. The columns of a term are all products, the first variable running fastest.
//!
//! Source: Chambers and Hastie 1992, chapter 2.

use std::collections::BTreeMap;

use super::error::ModelError;
use super::formula::{Formula, Function, Term};
use crate::strata::strata;
use shapelex_numeric::dense::Matrix;

/// Maximum number of columns of a design.
pub const MAX_COLUMNS: usize = 1000;
/// Maximum number of levels of a factor.
pub const MAX_LEVELS: usize = 1000;

/// Values of an attribute, one for each shape.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Numbers.
    Numbers(Vec<f64>),
    /// Texts; a Boolean is one.
    Texts(Vec<String>),
}

impl Values {
    /// Number of values.
    pub fn len(&self) -> usize {
        match self {
            Self::Numbers(numbers) => numbers.len(),
            Self::Texts(texts) => texts.len(),
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Attributes of the shapes by their names, and levels that are given for factors.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Table {
    /// Values of each attribute.
    pub attributes: BTreeMap<String, Values>,
    /// Levels of factors in their order, the first of which is the reference. Default: those that occur, sorted.
    pub levels: BTreeMap<String, Vec<String>>,
}

impl Table {
    /// The table with numbers, one for each shape.
    #[must_use]
    pub fn with_numbers(mut self, name: &str, numbers: impl IntoIterator<Item = f64>) -> Self {
        self.attributes.insert(name.into(), Values::Numbers(numbers.into_iter().collect()));
        self
    }

    /// The table with a factor, one level for each shape.
    #[must_use]
    pub fn with_factor<T: Into<String>>(mut self, name: &str, levels: impl IntoIterator<Item = T>) -> Self {
        self.attributes.insert(name.into(), Values::Texts(levels.into_iter().map(Into::into).collect()));
        self
    }
}

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

/// Levels of a factor that occur, in their order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Factor {
    /// The levels.
    pub levels: Vec<String>,
    /// Level of each shape.
    pub of_shapes: Vec<usize>,
}

/// A value of a variable for one shape: what its columns are made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cell {
    /// A number.
    Number(f64),
    /// The position of a level.
    Level(usize),
}

/// A variable of a formula with its values.
#[derive(Debug, Clone, PartialEq)]
pub enum Prepared {
    /// A number for each shape.
    Numbers {
        /// Transformed values.
        values: Vec<f64>,
        /// The function, which is applied to values of predictions too.
        function: Function,
    },
    /// A level for each shape.
    Factor(Factor),
    /// Values of a polynomial's argument, and its recurrence.
    Polynomial(Polynomial),
}

/// Polynomials that are orthonormal over the values of an attribute: `p_{k+1} = (x − a_k) p_k − b_k p_{k−1}`, each over its norm.
#[derive(Debug, Clone, PartialEq)]
pub struct Polynomial {
    values: Vec<f64>,
    centres: Vec<f64>,
    /// Squared norms of the polynomials of degree 0, 1, …, before they are normalised.
    squares: Vec<f64>,
}

impl Polynomial {
    fn new(values: Vec<f64>, degree: u32) -> Option<Self> {
        let sum = |row: &[f64]| row.iter().sum::<f64>();
        let mut polynomial = Self { centres: Vec::new(), squares: vec![values.len() as f64], values };
        let (mut before, mut own) = (vec![0.0; polynomial.values.len()], vec![1.0; polynomial.values.len()]);
        for k in 0..degree as usize {
            let x = &polynomial.values;
            let square = polynomial.squares[k];
            let weighted: Vec<f64> = own.iter().zip(x).map(|(p, x)| p * p * x).collect();
            let centre = sum(&weighted) / square;
            let ratio = if k == 0 { 0.0 } else { square / polynomial.squares[k - 1] };
            let next: Vec<f64> = x
                .iter()
                .zip(own.iter().zip(&before))
                .map(|(x, (p, b))| (x - centre) * p - ratio * b)
                .collect();
            let found = sum(&next.iter().map(|p| p * p).collect::<Vec<_>>());
            // The whole of what this degree adds is rounding.
            let largest = own.iter().zip(x).map(|(p, x)| ((x - centre) * p).powi(2)).sum::<f64>();
            if !(found > 1e-20 * largest) {
                return None;
            }
            polynomial.centres.push(centre);
            polynomial.squares.push(found);
            before = std::mem::replace(&mut own, next);
        }
        Some(polynomial)
    }

    /// Values of the polynomials of degree 1, 2, … at `x`.
    pub fn at(&self, x: f64) -> Vec<f64> {
        let (mut before, mut own, mut found) = (0.0, 1.0, Vec::with_capacity(self.centres.len()));
        for (k, centre) in self.centres.iter().enumerate() {
            let ratio = if k == 0 { 0.0 } else { self.squares[k] / self.squares[k - 1] };
            let next = (x - centre) * own - ratio * before;
            (before, own) = (own, next);
            found.push(next / self.squares[k + 1].sqrt());
        }
        found
    }
}

/// How a factor is coded within a term.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Coding {
    Contrasts,
    Indicators,
}

/// A design: the columns of the terms of a formula, for all shapes.
#[derive(Debug, Clone)]
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
        let used = formula.terms.iter().fold(0, |set, term| set | term.set());
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
            matrix: Matrix::zeros(0, 0),
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
        let chosen = |values: &[f64]| shapes.iter().map(|&k| values[k]).collect();
        let variable = |variable: &Prepared| match variable {
            Prepared::Numbers { values, function } => {
                Prepared::Numbers { values: chosen(values), function: *function }
            }
            Prepared::Polynomial(polynomial) => {
                Prepared::Polynomial(Polynomial { values: chosen(&polynomial.values), ..polynomial.clone() })
            }
            Prepared::Factor(factor) => Prepared::Factor(Factor {
                levels: factor.levels.clone(),
                of_shapes: shapes.iter().map(|&k| factor.of_shapes[k]).collect(),
            }),
        };
        let coding = formula.terms.iter().map(|term| coding_of(&formula, term)).collect();
        let variables = self.variables.iter().map(variable).collect();
        let matrix = Matrix::zeros(0, 0);
        let mut design = Self { formula, variables, coding, matrix, shapes: shapes.len(), ..self.clone() };
        design.name_columns()?;
        Ok(design.filled())
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
            };
            term.0.iter().map(bits).collect()
        };
        strata((0..self.shapes).map(key))
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
                (1..=polynomial.centres.len()).map(|degree| format!("{name}{degree}")).collect()
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
            (_, Cell::Number(x)) => vec![x],
            (_, Cell::Level(_)) => vec![0.0],
        }
    }
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

fn prepared(
    name: &str,
    values: &Values,
    function: Function,
    is_factor: bool,
    levels: Option<&Vec<String>>,
    warnings: &mut Vec<String>,
) -> Result<Prepared, ModelError> {
    if function == Function::Factor
        || (function == Function::Identity && (is_factor || matches!(values, Values::Texts(_))))
    {
        return factor(name, values, levels, warnings).map(Prepared::Factor);
    }
    let Values::Numbers(numbers) = values else {
        return Err(ModelError::NotNumeric { name: name.into() });
    };
    let refuse = |k: usize, expected: &'static str| {
        Err(ModelError::Domain { name: name.into(), expected, value: numbers[k], shape: k })
    };
    if let Some(k) = numbers.iter().position(|x| !(x.abs() <= super::MAX_VALUE)) {
        return refuse(k, "a number within ±1e100");
    }
    let map = |function: fn(f64) -> f64| numbers.iter().map(|x| function(*x)).collect();
    let values = match function {
        Function::Log => match numbers.iter().position(|x| *x <= 0.0) {
            Some(k) => return refuse(k, "a positive number"),
            None => map(f64::ln),
        },
        Function::Sqrt => match numbers.iter().position(|x| *x < 0.0) {
            Some(k) => return refuse(k, "a number of at least 0"),
            None => map(f64::sqrt),
        },
        Function::Power(degree) => {
            let values: Vec<f64> = numbers.iter().map(|x| x.powi(degree.cast_signed())).collect();
            match values.iter().position(|x| !(x.abs() <= super::MAX_VALUE)) {
                Some(k) => return refuse(k, "a power within ±1e100"),
                None => values,
            }
        }
        Function::Poly(degree) => {
            let mut distinct = numbers.clone();
            distinct.sort_by(f64::total_cmp);
            distinct.dedup();
            let found = if distinct.len() > degree as usize {
                Polynomial::new(numbers.clone(), degree)
            } else {
                None
            };
            return found.map(Prepared::Polynomial).ok_or(ModelError::FewValues {
                name: name.into(),
                degree,
                found: distinct.len(),
            });
        }
        Function::Identity | Function::Factor => numbers.clone(),
    };
    Ok(Prepared::Numbers { values, function })
}

fn factor(
    name: &str,
    values: &Values,
    levels: Option<&Vec<String>>,
    warnings: &mut Vec<String>,
) -> Result<Factor, ModelError> {
    let texts: Vec<String> = match values {
        Values::Texts(texts) => texts.clone(),
        Values::Numbers(numbers) => numbers.iter().map(f64::to_string).collect(),
    };
    let occurring: Vec<String> = match levels {
        Some(levels) => {
            let unknown = texts.iter().position(|text| !levels.contains(text));
            if let Some(k) = unknown {
                return Err(ModelError::UnknownLevel {
                    name: name.into(),
                    level: texts[k].clone(),
                    shape: k,
                });
            }
            let (occurring, unused): (Vec<_>, Vec<_>) =
                levels.iter().cloned().partition(|level| texts.contains(level));
            if !unused.is_empty() {
                warnings.push(format!("no shape has {name} = {}: left out", unused.join(", ")));
            }
            occurring
        }
        None => sorted_levels(&texts),
    };
    if occurring.len() > MAX_LEVELS {
        return Err(ModelError::ManyLevels { name: name.into(), found: occurring.len() });
    }
    let position: BTreeMap<&str, usize> =
        occurring.iter().enumerate().map(|(k, level)| (level.as_str(), k)).collect();
    let of_shapes = texts.iter().map(|text| position[text.as_str()]).collect();
    Ok(Factor { levels: occurring, of_shapes })
}

/// Different texts in order: by value if all are numbers, otherwise by code points.
fn sorted_levels(texts: &[String]) -> Vec<String> {
    let mut levels: Vec<String> = texts.to_vec();
    levels.sort_unstable();
    levels.dedup();
    let numbers: Option<Vec<f64>> =
        levels.iter().map(|level| level.parse().ok().filter(|number: &f64| number.is_finite())).collect();
    if let Some(numbers) = numbers {
        let mut order: Vec<usize> = (0..levels.len()).collect();
        order.sort_by(|&a, &b| numbers[a].total_cmp(&numbers[b]));
        return order.into_iter().map(|k| levels[k].clone()).collect();
    }
    levels
}
