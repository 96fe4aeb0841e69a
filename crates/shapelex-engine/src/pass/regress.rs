//! The passes of a regression: values of the variables, sums over shapes and values, sums of permuted residuals.

use serde::{Deserialize, Serialize};
use shapelex_analysis::AnalysisError;
use shapelex_analysis::accumulate::{FAN_IN, PART};
use shapelex_analysis::inference::regression_sums::{Observed, Reduced, RegressionSums};

use super::variables::{Columns, Summary, Variable, entries, read};
use crate::EngineError;
use crate::cohort::part::Numbers;
use crate::cohort::revision::Setting;

/// Maximum size of the sums of permuted residuals of a part.
const MAX_PERMUTED_BYTES: usize = 16 << 20;

/// Maximum number of columns of a design.
const MAX_COLUMNS: usize = 256;

/// A pass of a regression.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Regress {
    /// Covariates, and last the attribute.
    pub variables: Vec<Variable>,
    /// Step of the regression.
    pub step: Step,
}

/// Step of a regression over the shapes that have all values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Step {
    /// Summary of the values.
    Summarise,
    /// The sums of a regression.
    Sum(Design),
    /// Sums of permuted residuals.
    Permute {
        /// The design.
        design: Design,
        /// Reduced model of the residuals.
        reduced: Reduced,
        /// Seed of the permutations.
        seed: u64,
        /// Their number.
        draws: usize,
    },
}

/// Shapes and columns of a regression.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Design {
    /// Whitened mean that shapes are aligned to.
    pub mean: Vec<f64>,
    /// Whether aligned shapes are moved, at unit size, into the tangent space at the mean.
    pub tangent: bool,
    /// Columns of each variable.
    pub columns: Vec<Columns>,
}

impl Design {
    /// Number of columns beside the intercept.
    fn width(&self) -> usize {
        self.columns.iter().map(|columns| columns.scales().len()).sum()
    }

    /// Refuses columns of another number of variables, and a mean of another length.
    fn check(&self, variables: usize, length: usize) -> Result<(), EngineError> {
        let empty = self.columns.iter().any(|columns| columns.scales().is_empty());
        if empty || self.columns.len() != variables || self.width() > MAX_COLUMNS {
            let detail =
                format!("expected columns of {variables} variables, at most {MAX_COLUMNS}, got others");
            return Err(EngineError::refused("columns", detail));
        }
        if self.mean.len() != length {
            return Err(EngineError::refused(
                "mean",
                format!("expected {length} numbers, got {}", self.mean.len()),
            ));
        }
        Ok(())
    }

    fn observe(
        &self,
        setting: &Setting,
        variables: &[Variable],
        numbers: Numbers,
    ) -> Result<Observed, EngineError> {
        let values = entries(&self.columns, read(variables, &numbers)?);
        let scales: Vec<_> = self.columns.iter().flat_map(Columns::scales).collect();
        let preparation = setting.aligned_to(&self.mean, false);
        Ok(Observed::new(&setting.shapes(numbers)?, (&preparation, self.tangent), &scales, &values)?)
    }
}

impl Regress {
    /// Refuses steps that do not suit shapes of `length` numbers, such as columns of other variables.
    ///
    /// # Errors
    /// [`EngineError::Refused`].
    pub fn check(&self, length: usize) -> Result<(), EngineError> {
        if self.variables.is_empty() {
            return Err(EngineError::refused("variables", "expected an attribute, got none"));
        }
        match &self.step {
            Step::Summarise => Ok(()),
            Step::Sum(design) => design.check(self.variables.len(), length),
            Step::Permute { design, reduced, draws, .. } => {
                design.check(self.variables.len(), length)?;
                if !reduced.suits(length, design.width()) {
                    let detail = format!("expected numbers for {} columns, got others", design.width());
                    return Err(EngineError::refused("reduced", detail));
                }
                let most = MAX_PERMUTED_BYTES / (8 * length * (design.width() + 1));
                if (1..=most).contains(draws) {
                    return Ok(());
                }
                let detail =
                    format!("expected 1 to {most} for shapes of this size and so many columns, got {draws}");
                Err(EngineError::refused("draws", detail))
            }
        }
    }

    /// Names of the lists that hold the values.
    pub(crate) fn lists(&self) -> Vec<&'static str> {
        let mut lists: Vec<&'static str> = self.variables.iter().map(Variable::list).collect();
        lists.sort_unstable();
        lists.dedup();
        lists
    }

    /// About the size of the sorted states, for shapes of `length` numbers.
    pub(crate) fn state_bytes(&self, length: usize) -> usize {
        match &self.step {
            Step::Summarise => 8 * PART * FAN_IN,
            Step::Sum(design) => 8 * (design.width() + 1) * (length + design.width() + 1),
            Step::Permute { design, draws, .. } => 8 * length * (design.width() + 1) * draws,
        }
    }

    /// The result of the part `k`.
    ///
    /// # Errors
    /// A degenerate shape, with its position in the part.
    pub(crate) fn of(&self, setting: &Setting, k: usize, numbers: Numbers) -> Result<Vec<u8>, EngineError> {
        let variables = &self.variables;
        match &self.step {
            Step::Summarise => {
                let rows = read(variables, &numbers)?;
                Summary::of(variables.len(), k * PART, &rows, &numbers.weights).to_bytes()
            }
            Step::Sum(design) => {
                Ok(RegressionSums::of(&design.observe(setting, variables, numbers)?).to_bytes())
            }
            Step::Permute { design, reduced, seed, draws } => {
                let observed = design.observe(setting, variables, numbers)?;
                Ok(write_numbers(&reduced.permuted(&observed, k, *seed, *draws)))
            }
        }
    }

    /// The result of consecutive parts from theirs, in this order.
    ///
    /// # Errors
    /// Bytes that are not a result of this pass.
    pub(crate) fn merge(&self, states: &[&[u8]], length: usize) -> Result<Vec<u8>, EngineError> {
        match &self.step {
            Step::Summarise => {
                let mut all = Summary::new(self.variables.len());
                states
                    .iter()
                    .try_for_each(|state| Summary::from_bytes(state).map(|other| all.append(other)))?;
                all.to_bytes()
            }
            Step::Sum(design) => {
                let empty = RegressionSums::new(length, design.width());
                let mut sums = empty.clone();
                for state in states {
                    let mut other = empty.clone();
                    other.restore(state)?;
                    sums.add(&other);
                }
                Ok(sums.to_bytes())
            }
            Step::Permute { .. } => {
                let mut sums: Vec<f64> = Vec::new();
                for state in states {
                    let other = read_numbers(state)?;
                    if sums.is_empty() {
                        sums = other;
                    } else if sums.len() == other.len() {
                        sums.iter_mut().zip(other).for_each(|(sum, other)| *sum += other);
                    } else {
                        return Err(AnalysisError::NotAnAccumulator.into());
                    }
                }
                Ok(write_numbers(&sums))
            }
        }
    }
}

fn write_numbers(numbers: &[f64]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

/// Reads the sums of permuted residuals.
fn read_numbers(bytes: &[u8]) -> Result<Vec<f64>, EngineError> {
    match bytes.as_chunks::<8>() {
        (numbers, []) => Ok(numbers.iter().map(|number| f64::from_le_bytes(*number)).collect()),
        _ => Err(AnalysisError::NotAnAccumulator.into()),
    }
}
