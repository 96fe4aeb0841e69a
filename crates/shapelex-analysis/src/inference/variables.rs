//! Variables of a regression, and the design that they make.

use std::collections::BTreeSet;

use super::aligned::mean_and_deviation;
use super::error::StudyError;
use super::limits::{MAX_LEVELS, MAX_VALUE, MIN_DEVIATION};
use super::records::{AttributeSummary, CovariateRecord};
use super::regression::{Collinear, Design};

/// A variable with one value per shape.
#[derive(Debug, Clone, PartialEq)]
pub struct Variable {
    /// Name of the variable.
    pub name: String,
    /// Values of the shapes.
    pub values: Values,
}

/// Values of a variable.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Natural logarithm of the centroid size, which is computed from the shapes; a regression on it measures allometry.
    LogCentroidSize,
    /// Numbers.
    Numbers(Vec<f64>),
    /// A category.
    Levels {
        /// Different values, ascending.
        levels: Vec<String>,
        /// Level of each shape: a position in `levels`.
        of_shapes: Vec<usize>,
    },
}

impl Values {
    /// A category with the given value of each shape.
    pub fn category(texts: &[String]) -> Self {
        let levels: Vec<String> = texts.iter().cloned().collect::<BTreeSet<_>>().into_iter().collect();
        let of_shapes = texts.iter().map(|text| levels.partition_point(|level| level < text)).collect();
        Self::Levels { levels, of_shapes }
    }

    /// Checks size of the values and number of the levels.
    ///
    /// # Errors
    /// [`StudyError::LargeValues`], [`StudyError::ManyLevels`].
    pub fn check(&self) -> Result<(), StudyError> {
        match self {
            Self::Numbers(numbers) if numbers.iter().any(|x| x.abs() > MAX_VALUE) => {
                Err(StudyError::LargeValues)
            }
            Self::Levels { levels, .. } if levels.len() > MAX_LEVELS => {
                Err(StudyError::ManyLevels { found: levels.len() })
            }
            _ => Ok(()),
        }
    }

    /// Number of columns in the design.
    fn columns(&self) -> usize {
        match self {
            Self::Levels { levels, .. } => levels.len().saturating_sub(1).max(1),
            _ => 1,
        }
    }

    /// Columns of the design; those of sizes only if these are given.
    fn design(&self, sizes: Option<&[f64]>) -> Vec<Vec<f64>> {
        match self {
            Self::LogCentroidSize => sizes.map(<[f64]>::to_vec).into_iter().collect(),
            Self::Numbers(numbers) => vec![numbers.clone()],
            Self::Levels { levels, of_shapes } => {
                // A category with a single value is a constant column, and is refused as such.
                let first = usize::from(levels.len() > 1);
                let indicator =
                    |level: usize| of_shapes.iter().map(move |&own| f64::from(u8::from(own == level)));
                (first..levels.len()).map(|level| indicator(level).collect()).collect()
            }
        }
    }
}

/// Variables of a regression.
#[derive(Debug, Clone, PartialEq)]
pub struct Variables {
    /// Variables whose effect is removed first.
    pub covariates: Vec<Variable>,
    /// The attribute to regress on: sizes or numbers.
    pub attribute: Variable,
}

impl Variables {
    /// Number of columns of the design, without the intercept.
    pub fn columns(&self) -> usize {
        self.all().map(|variable| variable.values.columns()).sum()
    }

    /// Whether a variable is the size of the shapes.
    pub fn need_sizes(&self) -> bool {
        self.all().any(|variable| variable.values == Values::LogCentroidSize)
    }

    /// Checks that `shapes` shapes leave a degree of freedom.
    ///
    /// # Errors
    /// [`StudyError::FewShapes`].
    pub fn check_count(&self, shapes: usize) -> Result<(), StudyError> {
        let needed = 2 + self.columns();
        if shapes < needed { Err(StudyError::FewShapes { found: shapes, needed }) } else { Ok(()) }
    }

    /// The design of the variables, given the logarithms of the centroid sizes if [`Self::need_sizes`].
    ///
    /// # Errors
    /// [`StudyError::CollinearCovariate`], [`StudyError::CollinearAttribute`].
    pub fn design(&self, sizes: Option<&[f64]>, weights: &[f64]) -> Result<Design, StudyError> {
        let (mut columns, mut owners) = (Vec::new(), Vec::new());
        for (covariate, variable) in self.covariates.iter().enumerate() {
            let own = variable.values.design(sizes);
            owners.extend(std::iter::repeat_n(covariate, own.len()));
            columns.extend(own);
        }
        Design::new(&columns, &self.attribute_values(sizes), weights).map_err(|collinear| match collinear {
            Collinear::Covariate(column) => StudyError::CollinearCovariate { covariate: owners[column] },
            Collinear::Attribute => StudyError::CollinearAttribute,
        })
    }

    /// Value of the attribute of each shape.
    pub(super) fn attribute_values(&self, sizes: Option<&[f64]>) -> Vec<f64> {
        self.attribute.values.design(sizes).pop().unwrap_or_default()
    }

    /// Summary of the values of the attribute.
    ///
    /// # Errors
    /// [`StudyError::SmallDeviation`].
    pub(super) fn summary(&self, values: &[f64], weights: &[f64]) -> Result<AttributeSummary, StudyError> {
        let (mean, deviation) = mean_and_deviation(values, weights);
        if deviation < MIN_DEVIATION {
            return Err(StudyError::SmallDeviation);
        }
        let smallest = values.iter().copied().fold(f64::MAX, f64::min);
        let largest = values.iter().copied().fold(f64::MIN, f64::max);
        Ok(AttributeSummary { name: self.attribute.name.clone(), mean, deviation, smallest, largest })
    }

    /// Records of the covariates.
    pub(super) fn covariate_records(&self) -> Vec<CovariateRecord> {
        let record = |variable: &Variable| CovariateRecord {
            name: variable.name.clone(),
            levels: match &variable.values {
                Values::Levels { levels, .. } => Some(levels.clone()),
                _ => None,
            },
        };
        self.covariates.iter().map(record).collect()
    }

    fn all(&self) -> impl Iterator<Item = &Variable> {
        self.covariates.iter().chain([&self.attribute])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn variable(name: &str, values: Values) -> Variable {
        Variable { name: name.into(), values }
    }

    #[test]
    fn a_category_takes_a_column_for_every_value_but_the_first() {
        let texts = ["b", "a", "c", "a", "b", "c"].map(String::from);
        let variables = Variables {
            covariates: vec![
                variable("kind", Values::category(&texts)),
                variable("size", Values::LogCentroidSize),
            ],
            attribute: variable("age", Values::Numbers(vec![1.0, 3.0, 2.0, 7.0, 4.0, 9.0])),
        };
        assert_eq!((variables.columns(), variables.need_sizes()), (4, true));
        assert_eq!(variables.check_count(5), Err(StudyError::FewShapes { found: 5, needed: 6 }));
        let levels = Some(["a", "b", "c"].map(String::from).to_vec());
        assert_eq!(variables.covariate_records()[0].levels, levels);
        let sizes = [0.1, 0.9, 0.3, 0.2, 0.8, 0.4];
        assert_eq!(variables.design(Some(&sizes), &[1.0; 6]).unwrap().degrees(), 1);
    }

    #[test]
    fn a_column_that_says_nothing_names_its_variable() {
        let one_value = ["a", "a", "a", "a"].map(String::from);
        let number = Values::Numbers(vec![1.0, 2.0, 4.0, 8.0]);
        let mut variables = Variables {
            covariates: vec![variable("x", number.clone()), variable("kind", Values::category(&one_value))],
            attribute: variable("y", Values::Numbers(vec![0.0, 1.0, 0.0, 3.0])),
        };
        let error = |variables: &Variables| variables.design(None, &[1.0; 4]).unwrap_err();
        assert_eq!(error(&variables), StudyError::CollinearCovariate { covariate: 1 });
        variables.covariates.pop();
        variables.attribute.values = number;
        assert_eq!(error(&variables), StudyError::CollinearAttribute);
    }
}
