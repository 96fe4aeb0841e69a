//! Regression of the shapes of a cohort on an attribute.
//!
//! * this file — the kind of study; `values` — the values of attribute and covariates.

mod values;

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use self::values::{LOG_CENTROID_SIZE, complete, variables};
use super::sample::subject_warning;
use super::study::{Plan, Study, StudyKind, StudyRequest, refused, within_memory};
use crate::analysis::drawing::studies::draw_regression;
use crate::analysis::estimate::{Estimate, TestWork};
use crate::analysis::inference::aligned::AlignedShapes;
use crate::analysis::inference::regress::regress;
use crate::analysis::inference::variables::Variables;
use crate::analysis::watch::Watch;
use crate::domain::attribute::Attribute;
use crate::domain::cohort::Cohort;
use crate::domain::filter::ShapeFilter;
use crate::domain::job::JobKind;
use crate::domain::shape::ShapeDescription;
use crate::domain::study::{RegressionScore, ShapeRegression};
use crate::geometry::drawing::scene::Drawing;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::attributes::{self, KnownAttributes};
use crate::service::cohorts::selection::Selection;
use crate::service::statistics::Setup;
use crate::wire::fault::Fault;

/// Maximum number of covariates.
const MAX_COVARIATES: usize = 20;

/// Treatment of shapes without a value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Missing {
    /// The request is refused, and these shapes are named.
    #[default]
    Refuse,
    /// These shapes are left out.
    Skip,
}

/// Options of a regression.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// Filter that selects the shapes.
    pub filter: ShapeFilter,
    /// `labels.<attribute>` with numeric values, or `log_centroid_size`.
    pub attribute: String,
    /// Attributes whose effect is removed first.
    pub covariates: Vec<String>,
    /// Treatment of shapes without a value.
    pub missing: Missing,
}

impl Options {
    /// Names of covariates and attribute, with their pointers.
    fn names(&self) -> impl Iterator<Item = (&str, String)> {
        let covariates = self.covariates.iter().enumerate();
        let covariates = covariates.map(|(i, name)| (name.as_str(), format!("/covariates/{i}")));
        covariates.chain([(self.attribute.as_str(), "/attribute".to_owned())])
    }
}

/// Shapes of a regression, with their values.
#[derive(Debug)]
pub struct RegressedShapes {
    shapes: Vec<ShapeDescription>,
    filter: [ShapeFilter; 1],
    variables: Variables,
    strata: Vec<usize>,
    left_out: usize,
}

impl StudyKind for RegressedShapes {
    type Options = Options;
    type Record = ShapeRegression;
    const KIND: JobKind = JobKind::Regress;
    const PHASE: &'static str = "regress";

    fn faults(_: &App, request: &StudyRequest<Options>) -> Vec<Fault> {
        let Options { attribute, covariates, .. } = &request.options;
        let mut faults = Vec::new();
        if attribute != LOG_CENTROID_SIZE
            && !matches!(Attribute::parse(attribute), Some(Attribute::Labels(_) | Attribute::Measure(_)))
        {
            let detail = format!(
                "expected 'labels.<attribute>', 'measures.<measure>' or '{LOG_CENTROID_SIZE}', got '{attribute}'"
            );
            faults.push(Fault::new("/attribute", detail));
        }
        faults.extend(covariate_faults(attribute, covariates));
        faults.extend(request.permutations_fault());
        faults.extend(request.strata_faults());
        faults
    }

    fn complete(_: &mut Options, _: &Cohort) {}

    async fn select(app: &App, cohort: &Cohort, plan: &Plan<Options>) -> Result<Self, ServiceError> {
        let options = &plan.options;
        let described = attributes::describe(app, cohort, &options.filter, "/filter").await?;
        let all = described.len();
        if all == 0 {
            let known = KnownAttributes::of(app, cohort).await?;
            return Err(ServiceError::invalid("/filter", format!("the filter selects no shapes: {known}")));
        }
        let shapes = complete(app, cohort, options, described).await?;
        let variables = variables(options, &shapes)?;
        let pointer = if options.covariates.is_empty() { "/attribute" } else { "/covariates" };
        variables.check_count(shapes.len()).map_err(|error| refused(error, pointer))?;
        let strata = super::sample::strata(&plan.strata, &shapes)?;
        if plan.permutations > 0 && !plan.strata.is_empty() {
            let distinct = strata.iter().collect::<BTreeSet<_>>().len();
            if distinct == shapes.len() {
                let detail = "no two shapes share a stratum: nothing can be exchanged";
                return Err(ServiceError::invalid("/strata", detail));
            }
        }
        let (filter, left_out) = ([options.filter.clone()], all - shapes.len());
        Ok(Self { shapes, filter, variables, strata, left_out })
    }

    fn selection(&self) -> Selection<'_> {
        Selection { shapes: &self.shapes, filters: &self.filter }
    }

    fn estimate(&self, app: &App, plan: &Plan<Options>, setup: &Setup) -> Result<Estimate, ServiceError> {
        let shapes = self.shapes.len();
        let work = TestWork {
            shapes,
            samples: 0,
            permutations: plan.permutations,
            columns: 1 + self.variables.columns(),
            pairs: 0,
            pair_shapes: 0,
        };
        let estimate = within_memory(app, setup, &work, "/filter")?;
        // Refuse a singular design before reading the shapes, if all values are already known.
        if !self.variables.need_sizes() {
            let design = self.variables.design(None, &vec![1.0; shapes]);
            design.map_err(|error| refused(error, "/covariates"))?;
        }
        Ok(estimate)
    }

    fn result(
        study: &Study<Self>,
        shapes: &AlignedShapes<'_>,
        watch: &dyn Watch,
    ) -> Result<ShapeRegression, ServiceError> {
        let Study { plan, cohort, sample, .. } = study;
        let found = regress(shapes, &sample.variables, plan.draws(&sample.strata), watch);
        let found = found.map_err(|error| refused(error, "/attribute"))?;
        let scores = found.values.iter().zip(&found.scores).zip(&sample.shapes);
        let scores = scores.map(|((&attribute, &score), shape)| RegressionScore {
            id: shape.id.clone(),
            external_id: shape.external_id.clone(),
            attribute,
            score,
        });
        let mut warnings = [study.caveats(), found.warnings].concat();
        warnings.extend(subject_warning(&sample.shapes, &plan.strata));
        if sample.left_out > 0 {
            warnings.push(format!("{} shapes lack a value and are left out", sample.left_out));
        }
        Ok(ShapeRegression {
            cohort: cohort.id.clone(),
            cohort_revision: plan.revision,
            header: plan.header(sample.shapes.len(), sample.left_out),
            scores: scores.collect(),
            found: found.record,
            warnings,
        })
    }

    fn draw(study: &Study<Self>, regression: &ShapeRegression) -> Drawing {
        let (setup, spec) = (&study.setup, &study.cohort.spec);
        let cohort = (spec.name.as_str(), spec.shown_unit());
        draw_regression((&setup.space, &setup.method), cohort, regression.header.shapes, &regression.found)
    }
}

fn covariate_faults(attribute: &str, covariates: &[String]) -> Vec<Fault> {
    let mut faults = Vec::new();
    if covariates.len() > MAX_COVARIATES {
        let detail = format!("expected at most {MAX_COVARIATES} entries, got {}", covariates.len());
        faults.push(Fault::new("/covariates", detail));
    }
    for (i, name) in covariates.iter().enumerate().take(MAX_COVARIATES) {
        let pointer = format!("/covariates/{i}");
        if name != LOG_CENTROID_SIZE && Attribute::parse(name).is_none() {
            let detail = format!("{}, or '{LOG_CENTROID_SIZE}', got '{name}'", Attribute::WANTED);
            faults.push(Fault::new(pointer, detail));
        } else if name == attribute || covariates[..i].contains(name) {
            faults.push(Fault::new(pointer, format!("'{name}' is given twice")));
        }
    }
    faults
}
