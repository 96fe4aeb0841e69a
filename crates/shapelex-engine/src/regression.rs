//! Regression of all shapes of a revision on an attribute.
//!
//! Passes: the values of the variables; the mean; the sums; the sums of permuted residuals. The statistics are those of
//! `POST /v1/regressions` up to rounding; the draws exchange residuals within parts.

use std::sync::Arc;

use serde::Serialize;
use shapelex_analysis::alignment::{MeanShape, mean_shape};
use shapelex_analysis::inference::aligned::{check_weight_range, frame_for, mean_warnings};
use shapelex_analysis::inference::error::StudyError;
use shapelex_analysis::inference::records::RegressionRecord;
use shapelex_analysis::inference::regress::Outcome;
use shapelex_analysis::inference::regression::Collinear;
use shapelex_analysis::inference::regression_sums::{RegressionSums, Scale, Solved};

use crate::EngineError;
use crate::cohort::revision::Setting;
use crate::pass::regress::{Design, Regress, Step, read_numbers};
use crate::pass::source::AtRest;
use crate::pass::variables::{Columns, Known, Summary, Variable};
use crate::pass::work::Work;

/// Maximum number of columns of a design.
const MAX_COLUMNS: usize = 256;

/// Maximum size of the sums of permuted residuals of a part.
const MAX_PERMUTED_BYTES: usize = 16 << 20;

/// What is regressed.
#[derive(Debug, Clone)]
pub struct Request {
    /// Variables whose effect is removed first.
    pub covariates: Vec<Variable>,
    /// The attribute: numbers.
    pub attribute: Variable,
    /// Whether aligned shapes are moved, at unit size, into the tangent space at their mean.
    pub tangent: bool,
    /// Whether shapes that lack a value are left out; the mean is that of all shapes.
    pub skip_missing: bool,
    /// Number of permutations.
    pub permutations: usize,
    /// Their seed.
    pub seed: u64,
}

/// A regression.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Regressed {
    /// Number of shapes.
    pub shape_count: usize,
    /// Number of shapes that lack a value.
    pub left_out: u64,
    /// Seed of the permutations.
    pub seed: u64,
    /// The result, as the service answers it.
    #[serde(flatten)]
    pub record: RegressionRecord,
    /// Warnings about the result.
    pub warnings: Vec<String>,
}

/// Regresses the shapes of `source` on an attribute.
///
/// Cost: a pass for the values, those of a mean, one for the sums, one for the permutations: `2 n m (p + 2)` operations each for `n`
/// shapes of `m` numbers and `p` covariate columns. Memory beside that of a mean: 8 bytes a shape for the values of the attribute,
/// and for each part in work `8 m (p + 2)` bytes a permutation.
///
/// # Errors
/// Shapes without values, variables that vary too little, depend on each other or are too large, more permutations than fit into
/// 16 MiB; degenerate shapes; errors of the store.
pub fn regress(
    source: &AtRest<'_>,
    setting: &Arc<Setting>,
    request: Request,
) -> Result<Regressed, EngineError> {
    let steps = Steps { source, setting, request: &request, variables: request.variables() };
    let summary = steps.summary()?;
    let columns = steps.columns(&summary)?;
    let Setting { metric, method, matching, transformation, .. } = &**setting;
    let mean = mean_shape(source, metric, method, frame_for(transformation), matching)?;
    let solved =
        steps.solve(&summary, Design { mean: mean.whitened.clone(), tangent: request.tangent, columns })?;
    steps.result(summary, &mean, solved)
}

impl Request {
    fn variables(&self) -> Vec<Variable> {
        self.covariates.iter().chain([&self.attribute]).cloned().collect()
    }
}

/// The steps of a regression.
struct Steps<'a> {
    source: &'a AtRest<'a>,
    setting: &'a Arc<Setting>,
    request: &'a Request,
    variables: Vec<Variable>,
}

/// The regression, and what its record is made from beside it.
struct Fitted {
    design: Design,
    solved: Solved,
    permuted: Vec<f64>,
}

impl Steps<'_> {
    fn run(&self, step: Step) -> Result<Vec<u8>, EngineError> {
        let work = Work::Regress(Box::new(Regress { variables: self.variables.clone(), step }));
        self.source.run(None, self.setting.clone(), &work)
    }

    fn refused(&self, variable: usize, error: &StudyError) -> EngineError {
        let name = String::from(self.variables[variable].clone());
        EngineError::refused(name, error.to_string())
    }

    /// What is known of the values, if no shape lacks one or those may be left out.
    fn summary(&self) -> Result<Summary, EngineError> {
        let summary = Summary::from_bytes(&self.run(Step::Summarise)?)?;
        if let (Some(first), false) = (summary.first_missing, self.request.skip_missing) {
            let attribute = String::from(self.request.attribute.clone());
            let detail = format!(
                "expected a value of every variable, and a number of '{attribute}', got none for {} shapes, the first at [{first}]: \
                 --missing skip leaves them out",
                summary.missing
            );
            return Err(EngineError::refused("shapes", detail));
        }
        Ok(summary)
    }

    fn columns(&self, summary: &Summary) -> Result<Vec<Columns>, EngineError> {
        let of = |(variable, known): (usize, &Known)| {
            let columns = known.columns().map_err(|error| self.refused(variable, &error))?;
            columns.ok_or_else(|| self.refused(variable, &self.dependent(variable)))
        };
        let found = summary.values.len();
        if found == 0 {
            return Err(EngineError::refused("shapes", "expected some that have all values, got none"));
        }
        let columns: Vec<Columns> = summary.known.iter().enumerate().map(of).collect::<Result<_, _>>()?;
        let width: usize = columns.iter().map(|columns| columns.scales().len()).sum();
        if width > MAX_COLUMNS {
            let detail = format!("expected at most {MAX_COLUMNS} columns of covariates, got {}", width - 1);
            return Err(EngineError::refused("covariates", detail));
        }
        let error = match found < 2 + width {
            true => Some(StudyError::FewShapes { found, needed: 2 + width }),
            false => check_weight_range(summary.weights[0], summary.weights[1]).err(),
        };
        match error {
            Some(error) => Err(EngineError::refused("shapes", error.to_string())),
            None => self.check_permutations(width).map(|()| columns),
        }
    }

    fn check_permutations(&self, width: usize) -> Result<(), EngineError> {
        let most = MAX_PERMUTED_BYTES / (8 * self.setting.metric.len() * (width + 1));
        if self.request.permutations <= most {
            return Ok(());
        }
        let detail = format!(
            "expected at most {most} for shapes of this size and so many columns, got {}",
            self.request.permutations
        );
        Err(EngineError::refused("permutations", detail))
    }

    fn dependent(&self, variable: usize) -> StudyError {
        if variable == self.request.covariates.len() {
            StudyError::CollinearAttribute
        } else {
            StudyError::CollinearCovariate { covariate: variable }
        }
    }

    /// The variable that a column belongs to.
    fn owner(columns: &[Columns], column: usize) -> usize {
        let mut owners =
            columns.iter().enumerate().flat_map(|(k, own)| std::iter::repeat_n(k, own.scales().len()));
        owners.nth(column).unwrap_or(columns.len() - 1)
    }

    fn solve(&self, summary: &Summary, design: Design) -> Result<Fitted, EngineError> {
        let scales: Vec<Scale> = design.columns.iter().flat_map(Columns::scales).collect();
        // The attribute is a number, so it has the last column.
        let scale = scales[scales.len() - 1];
        let mut sums = RegressionSums::new(self.setting.metric.len(), scales.len());
        sums.restore(&self.run(Step::Sum(design.clone()))?)?;
        if sums.shapes() != summary.values.len() {
            let detail = format!("expected sums of {} shapes, got {}", summary.values.len(), sums.shapes());
            return Err(EngineError::refused("pass", detail));
        }
        let solved = sums.solve(&design.mean, scale).map_err(|collinear| {
            let variable = match collinear {
                Collinear::Covariate(column) => Self::owner(&design.columns, column),
                Collinear::Attribute => self.request.covariates.len(),
            };
            self.refused(variable, &self.dependent(variable))
        })?;
        let permuted = match self.request.permutations {
            0 => Vec::new(),
            draws => {
                let (reduced, seed) = (solved.reduced.clone(), self.request.seed);
                read_numbers(&self.run(Step::Permute { design: design.clone(), reduced, seed, draws })?)?
            }
        };
        Ok(Fitted { design, solved, permuted })
    }

    fn result(&self, summary: Summary, mean: &MeanShape, fitted: Fitted) -> Result<Regressed, EngineError> {
        let Fitted { design, solved, permuted } = fitted;
        let Request { covariates, attribute, permutations, seed, .. } = self.request;
        let last = covariates.len();
        let attribute = solved.summary(attribute.clone().into(), summary.known[last].range());
        let attribute = attribute.ok_or_else(|| self.refused(last, &StudyError::SmallDeviation))?;
        let records = covariates.iter().zip(&design.columns);
        let mut sorted = summary.values;
        sorted.sort_by(f64::total_cmp);
        let outcome = Outcome {
            metric: &self.setting.metric,
            mean,
            covariates: records.map(|(variable, columns)| columns.record(variable.clone())).collect(),
            attribute,
            sorted: &sorted,
            average: &solved.average,
            found: solved.regression(&permuted, *permutations),
        };
        let mut warnings = mean_warnings(mean);
        if summary.missing > 0 {
            warnings.push(format!(
                "{} shapes lack a value and are left out; the mean is that of all",
                summary.missing
            ));
        }
        Ok(Regressed {
            shape_count: sorted.len(),
            left_out: summary.missing,
            seed: *seed,
            record: outcome.record(),
            warnings,
        })
    }
}
