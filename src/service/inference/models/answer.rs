//! The question of a request to a model, and the record of what is found.

use std::ops::Range;

use super::extras::{self, Compatibility};
use super::refusals::refused;
use super::{Collinear, ModelledShapes, Options, SHAPE, names};
use crate::analysis::models::anova::Testing;
use crate::analysis::models::design::{Contrasts, Table, Values};
use crate::analysis::models::error::ModelError;
use crate::analysis::models::mixed::RandomQuestion;
use crate::analysis::models::outcome::ModelRecord;
use crate::analysis::models::study::{ModelQuestion, Response};
use crate::domain::study::ShapeModel;
use crate::service::app::ServiceError;
use crate::service::inference::sample::subject_warning;
use crate::service::inference::study::{Plan, Study};

/// What is modelled.
fn response_of<'a>(
    name: &str,
    scores: Option<&'a Range<usize>>,
    table: &'a Table,
) -> Result<Response<'a>, ServiceError> {
    if let Some(scores) = scores {
        return Ok(Response::Scores(scores));
    }
    match (name, table.attributes.get(name)) {
        (SHAPE, _) => Ok(Response::Shape),
        (_, Some(Values::Numbers(numbers))) => Ok(Response::Numbers(numbers)),
        _ => Err(ServiceError::invalid("/response", format!("expected numbers, got texts for '{name}'"))),
    }
}

/// All that should be known of a model beside what was found.
fn warnings_of(study: &Study<ModelledShapes>, mut found: Vec<String>) -> Vec<String> {
    let Study { plan, sample, .. } = study;
    let mut warnings = match &sample.large {
        Some(large) => large.caveats.clone(),
        None => study.caveats(),
    };
    warnings.append(&mut found);
    if let Some(large) = &sample.large {
        warnings.extend(large.dependence.clone());
    } else if plan.options.blocks.iter().all(|name| name != "subject")
        && !names(&sample.formulas.own, "subject")
    {
        warnings.extend(subject_warning(&sample.shapes, &plan.strata));
    }
    if sample.left_out > 0 {
        warnings.push(format!("{} shapes lack a value and are left out", sample.left_out));
    }
    warnings
}

impl ModelledShapes {
    /// How the terms are tested.
    fn testing<'a>(&'a self, plan: &Plan<Options>, error_terms: &'a [(String, String)]) -> Testing<'a> {
        let options = &plan.options;
        Testing {
            kind: options.kind,
            contrasts_of_three: options.contrasts.unwrap_or(Contrasts::Sum),
            statistic: options.statistic,
            transform: options.z,
            permutations: plan.permutations,
            seed: plan.seed,
            strata: self.strata.as_deref(),
            blocks: self.blocks.as_deref(),
            exchange: options.exchange,
            error_terms,
            rrpp: options.compatibility == Some(Compatibility::Rrpp),
            given: None,
        }
    }

    /// The record of what is found of the question of a study.
    pub(super) fn record(
        &self,
        study: &Study<Self>,
        table: &Table,
        fit: impl FnOnce(&ModelQuestion<'_>) -> Result<ModelRecord, ModelError>,
    ) -> Result<ShapeModel, ServiceError> {
        let Study { plan, cohort, .. } = study;
        let options = &plan.options;
        let error_terms: Vec<(String, String)> =
            options.error_terms.iter().map(|(term, error)| (term.clone(), error.clone())).collect();
        let scores = extras::scores(&options.response);
        let question = ModelQuestion {
            formula: &self.formulas.own,
            table,
            contrasts: options.coding(),
            response: response_of(&options.response, scores.as_ref(), table)?,
            testing: self.testing(plan, &error_terms),
            at: options.at.as_deref(),
            further: options
                .further
                .question(self.formulas.reduced(), study.setup.space.representation().comparison_places()),
            random: options.random.as_ref().map(RandomQuestion::from),
            manova: options.manova.as_ref().map(|manova| manova.components),
            covariance: self.factor.get(),
        };
        let place = self.formulas.place;
        let refused = |error| refused(error, place, &self.shapes);
        let mut found = fit(&question).map_err(refused)?;
        let dropped = &found.anova.design.dropped;
        if options.collinear == Collinear::Refuse && !dropped.is_empty() {
            return Err(refused(ModelError::Collinear { columns: dropped.join(", ") }));
        }
        found.anova.warnings = warnings_of(study, std::mem::take(&mut found.anova.warnings));
        Ok(ShapeModel {
            cohort: cohort.id.clone(),
            cohort_revision: plan.revision,
            header: plan.header(self.count(), self.left_out),
            kind: options.kind,
            response: options.response.clone(),
            blocks: options.blocks.clone(),
            text: found.anova.printed(),
            found,
            streamed: self.large.is_some(),
            kept_at: None,
        })
    }
}
