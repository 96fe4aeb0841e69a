//! Regression on an attribute.

use std::num::NonZeroUsize;
use std::sync::Arc;
use std::time::Instant;

use clap::{Args, ValueEnum};
use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::tangent::LinearAlignment;
use shapelex_analysis::transformation::Transformation;
use shapelex_engine::EngineError;
use shapelex_engine::cohort::revision::Setting;
use shapelex_engine::objects::Objects;
use shapelex_engine::pass::source::AtRest;
use shapelex_engine::pass::variables::Variable;
use shapelex_engine::regression::{Regressed, Request, regress};
use tokio::runtime::Handle;

use super::machines::Machines;
use super::selection::Selection;
use super::{Answer, json_word, transformation};

#[derive(Debug, Args)]
pub(crate) struct RegressCommand {
    #[command(flatten)]
    selection: Selection,
    /// Attribute to regress on: labels.<attribute> or measures.<measure> with numbers, or log_centroid_size.
    #[arg(long, value_parser = variable)]
    attribute: Variable,
    /// Covariate, removed first: also subject and label; may be given 20 times. A category takes a column for each value but the first.
    #[arg(long = "covariate", value_parser = variable)]
    covariates: Vec<Variable>,
    /// Treatment of shapes that lack a value.
    #[arg(long, value_enum, default_value_t = Missing::Refuse)]
    missing: Missing,
    /// Number of permutations of residuals, within parts of 8192 shapes.
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(..=100_000))]
    permutations: u32,
    /// Seed of the permutations.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Class of transformations that is removed: a name, or a JSON object with matrices.
    #[arg(long, default_value = "similarity", value_parser = transformation)]
    transformation: Transformation,
    /// projection, procrustes or partial_procrustes. Default: what suits the class, in the tangent space at the mean.
    #[arg(long, value_parser = json_word::<Alignment>)]
    alignment: Option<Alignment>,
    /// Whether aligned shapes are moved, at unit size, into the tangent space at their mean. Default: as for POST /v1/regressions.
    #[arg(long)]
    tangent: Option<bool>,
    #[command(flatten)]
    pub(crate) machines: Machines,
}

/// Treatment of shapes that lack a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Missing {
    /// The regression is refused.
    Refuse,
    /// They are left out; the mean is that of all shapes.
    Skip,
}

/// Maximum number of covariates, as in the service.
const MAX_COVARIATES: usize = 20;

fn variable(name: &str) -> Result<Variable, String> {
    Variable::try_from(name.to_string())
}

impl RegressCommand {
    pub(crate) fn answer(
        self,
        objects: Objects,
        runtime: &Handle,
        threads: NonZeroUsize,
    ) -> Result<Answer<Regressed>, EngineError> {
        let began = Instant::now();
        check(&self.attribute, &self.covariates)?;
        let revision = runtime.block_on(self.selection.open(objects))?;
        let dimension = revision.manifest().cohort.representation.dimension();
        let LinearAlignment { alignment, tangent } =
            LinearAlignment::of_test(&self.transformation, dimension, self.alignment, self.tangent)?;
        let setting = Arc::new(Setting::new(revision.manifest(), &self.transformation, Some(alignment))?);
        let runners = self.machines.runners(threads)?;
        let source = AtRest::new(revision, setting.clone(), runtime, runners.chosen());
        let request = Request {
            covariates: self.covariates,
            attribute: self.attribute,
            tangent,
            skip_missing: self.missing == Missing::Skip,
            permutations: self.permutations as usize,
            seed: self.seed,
        };
        let found = regress(&source, &setting, request)?;
        Ok(Answer::new(&source, began, found))
    }
}

/// Checks the names of the variables.
fn check(attribute: &Variable, covariates: &[Variable]) -> Result<(), EngineError> {
    let refused = |detail: String| Err(EngineError::Refused { place: "covariates".into(), detail });
    if covariates.len() > MAX_COVARIATES {
        return refused(format!("expected at most {MAX_COVARIATES}, got {}", covariates.len()));
    }
    let twice =
        covariates.iter().enumerate().find(|(k, own)| *own == attribute || covariates[..*k].contains(own));
    match twice {
        Some((_, variable)) => {
            refused(format!("expected each variable once, got '{}' twice", String::from(variable.clone())))
        }
        None => Ok(()),
    }
}
