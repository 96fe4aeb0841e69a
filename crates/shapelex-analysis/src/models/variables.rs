//! Variables of formulas with the values of the shapes: numbers, factors, polynomials.

use std::collections::BTreeMap;

use super::error::ModelError;
use super::formula::Function;

/// Maximum number of levels of a factor.
pub const MAX_LEVELS: usize = 1000;

/// Values of an attribute, one for each shape.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Numbers.
    Numbers(Vec<f64>),
    /// Texts; a Boolean is one.
    Texts(Vec<String>),
    /// Texts of which many are equal: different ones, each of which occurs, and the position of that of each shape.
    Levels {
        /// The texts.
        names: Vec<String>,
        /// Position of each text.
        of_shapes: Vec<u32>,
    },
}

impl Values {
    /// Number of values.
    pub fn len(&self) -> usize {
        match self {
            Self::Numbers(numbers) => numbers.len(),
            Self::Texts(texts) => texts.len(),
            Self::Levels { of_shapes, .. } => of_shapes.len(),
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

/// Levels of a factor that occur, in their order.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
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
    /// All levels alike.
    Every,
}

/// A variable of a formula with its values.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
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
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Polynomial {
    /// Values of the argument, one for each shape.
    pub values: Vec<f64>,
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

    /// The same polynomials with values for other shapes.
    #[must_use]
    pub fn with_values(&self, values: Vec<f64>) -> Self {
        Self { values, ..self.clone() }
    }

    /// Highest degree.
    pub fn degree(&self) -> usize {
        self.centres.len()
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

/// A variable of a formula with its values, which its function takes; warnings about levels that do not occur.
///
/// # Errors
/// Values that the function does not take, with the first of them; too few different ones for a polynomial; unknown and too many levels.
pub(super) fn prepared(
    name: &str,
    values: &Values,
    function: Function,
    is_factor: bool,
    levels: Option<&Vec<String>>,
    warnings: &mut Vec<String>,
) -> Result<Prepared, ModelError> {
    if function == Function::Factor
        || (function == Function::Identity && (is_factor || !matches!(values, Values::Numbers(_))))
    {
        return factor(name, values, levels, warnings).map(Prepared::Factor);
    }
    let Values::Numbers(numbers) = values else {
        return Err(ModelError::NotNumeric { name: name.into() });
    };
    let first = |is_wrong: &dyn Fn(f64) -> bool, expected: &'static str| {
        numbers.iter().position(|x| is_wrong(*x)).map(|shape| (shape, expected))
    };
    let wrong =
        first(&|x| !(x.abs() <= super::MAX_VALUE), "a number within ±1e100").or_else(|| match function {
            Function::Log => first(&|x| x <= 0.0, "a positive number"),
            Function::Sqrt => first(&|x| x < 0.0, "a number of at least 0"),
            Function::Power(_) => {
                first(&|x| !(applied(function, x).abs() <= super::MAX_VALUE), "a power within ±1e100")
            }
            Function::Identity | Function::Factor | Function::Poly(_) => None,
        });
    if let Some((shape, expected)) = wrong {
        return Err(ModelError::Domain { name: name.into(), expected, value: numbers[shape], shape });
    }
    if let Function::Poly(degree) = function {
        return polynomial(name, numbers, degree).map(Prepared::Polynomial);
    }
    let values = numbers.iter().map(|x| applied(function, *x)).collect();
    Ok(Prepared::Numbers { values, function })
}

fn polynomial(name: &str, numbers: &[f64], degree: u32) -> Result<Polynomial, ModelError> {
    let mut distinct = numbers.to_vec();
    distinct.sort_by(f64::total_cmp);
    distinct.dedup();
    let found =
        (distinct.len() > degree as usize).then(|| Polynomial::new(numbers.to_vec(), degree)).flatten();
    found.ok_or(ModelError::FewValues { name: name.into(), degree, found: distinct.len() })
}

fn factor(
    name: &str,
    values: &Values,
    levels: Option<&Vec<String>>,
    warnings: &mut Vec<String>,
) -> Result<Factor, ModelError> {
    let (names, of_shapes) = match values {
        Values::Texts(texts) => numbered(texts.iter().cloned()),
        Values::Numbers(numbers) => numbered(numbers.iter().map(f64::to_string)),
        Values::Levels { names, of_shapes } => {
            (names.clone(), of_shapes.iter().map(|level| *level as usize).collect())
        }
    };
    let occurring: Vec<String> = match levels {
        Some(levels) => {
            let known: Vec<bool> = names.iter().map(|name| levels.contains(name)).collect();
            if let Some(k) = of_shapes.iter().position(|name| !known[*name]) {
                return Err(ModelError::UnknownLevel {
                    name: name.into(),
                    level: names[of_shapes[k]].clone(),
                    shape: k,
                });
            }
            let (occurring, unused): (Vec<_>, Vec<_>) =
                levels.iter().cloned().partition(|level| names.contains(level));
            if !unused.is_empty() {
                warnings.push(format!("no shape has {name} = {}: left out", unused.join(", ")));
            }
            occurring
        }
        None => sorted_levels(&names),
    };
    if occurring.len() > MAX_LEVELS {
        return Err(ModelError::ManyLevels { name: name.into(), found: occurring.len() });
    }
    let position: BTreeMap<&str, usize> =
        occurring.iter().enumerate().map(|(k, level)| (level.as_str(), k)).collect();
    let levels: Vec<usize> = names.iter().map(|name| position[name.as_str()]).collect();
    Ok(Factor { of_shapes: of_shapes.into_iter().map(|name| levels[name]).collect(), levels: occurring })
}

/// Different texts in the order in which they occur, and the position of each.
fn numbered(texts: impl Iterator<Item = String>) -> (Vec<String>, Vec<usize>) {
    let (mut names, mut positions) = (Vec::new(), BTreeMap::new());
    let of = |text: String| {
        let next = names.len();
        *positions.entry(text).or_insert_with_key(|text| {
            names.push(text.clone());
            next
        })
    };
    let of_shapes = texts.map(of).collect();
    (names, of_shapes)
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

/// Value of a function of an attribute.
pub(super) fn applied(function: Function, x: f64) -> f64 {
    match function {
        Function::Log => x.ln(),
        Function::Sqrt => x.sqrt(),
        Function::Power(degree) => x.powi(degree.cast_signed()),
        Function::Identity | Function::Factor | Function::Poly(_) => x,
    }
}
