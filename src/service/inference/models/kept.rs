//! Predictions of kept models: what a job has kept of its model, prepared for use and cached.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::super::comparisons::MAX_EFFECT_POINTS;
use super::{Options, Plan, refused_at};
use crate::analysis::drawing::models::draw_predictions;
use crate::analysis::models::error::ModelError;
use crate::analysis::models::kept::{KeptHead, KeptModel};
use crate::analysis::models::outcome::PredictionRecord;
use crate::analysis::models::records::At;
use crate::domain::cohort::Cohort;
use crate::domain::job::JobOutput;
use crate::domain::study::ShapeModel;
use crate::geometry::drawing::scene::Drawing;
use crate::service::app::cache::Cached;
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::catalogue;
use crate::service::cost::requests;
use crate::service::jobs;
use crate::service::statistics::Setup;
use crate::wire::json;

/// Multiply-adds with numbers that come from memory take so many times as long as those of dense products.
const FROM_MEMORY: f64 = 4.0;

/// Description of the output of a job that has kept its model; its data are numbers.
#[derive(Debug, Serialize, Deserialize)]
struct Head {
    model: Described,
}

#[derive(Debug, Serialize, Deserialize)]
struct Described {
    formula: String,
    response: String,
    shapes: usize,
    kept: KeptHead,
}

/// The output of the job that has fitted a model, which then tells where its predictions are; `None` if the model is not kept.
///
/// # Errors
/// A head that is not JSON (a bug).
pub(super) fn output(answer: &mut ShapeModel, job: &str) -> Result<Option<JobOutput>, ServiceError> {
    let Some(kept) = answer.found.kept.take() else { return Ok(None) };
    let (kept, data) = kept.to_parts();
    answer.kept_at = Some(format!("/v1/models/{job}/predictions"));
    let described = Described {
        formula: answer.found.anova.formula.clone(),
        response: answer.response.clone(),
        shapes: answer.header.shapes,
        kept,
    };
    let head = json::to_value(&Head { model: described })
        .map_err(|error| ServiceError::Internal(format!("a kept model is not JSON: {error}")))?;
    Ok(Some(JobOutput { head, data }))
}

/// A kept model, prepared for use.
#[derive(Debug)]
pub struct ReadyModel {
    job: String,
    cohort: String,
    revision: u64,
    formula: String,
    response: String,
    shapes: usize,
    model: KeptModel,
    setup: Setup,
    name: String,
    unit: Option<String>,
    is_of_shapes: bool,
}

impl Cached for ReadyModel {
    const NAME: &'static str = "models";

    fn bytes(&self) -> usize {
        self.model.bytes() + 16 * self.setup.metric.len() + self.setup.space.bytes()
    }
}

/// Predictions of a kept model.
#[derive(Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct ModelPredictions {
    /// Id of the job that has fitted the model.
    pub model: String,
    /// Id of the cohort.
    pub cohort: String,
    /// Revision of the cohort that was analysed.
    pub cohort_revision: u64,
    /// Formula of the model, normalised.
    pub formula: String,
    /// Response of the model: `shape`, or an attribute.
    pub response: String,
    /// Number of shapes.
    #[serde(rename = "shape_count")]
    pub shapes: usize,
    /// Number of draws of the residuals behind simultaneous bands; 0 if the model has none.
    pub draws: usize,
    /// Predicted shapes, or numbers, one for each entry of `at`.
    pub predictions: Vec<PredictionRecord>,
}

/// Place of the values of a prediction in a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Given {
    /// In the body, by JSON pointers.
    Body,
    /// In the query, by the names of parameters.
    Query,
}

/// The model that the job with this id has kept.
///
/// # Errors
/// [`ServiceError::NotFound`] for the job, its model or its cohort: not yet, never, or no longer.
pub async fn find(app: &App, job: &str) -> Result<Arc<ReadyModel>, ServiceError> {
    if let Some(mark) = app.store.find_output_mark(job).await?
        && let Some(ready) = app.cache.find::<ReadyModel>(job, &mark)
    {
        catalogue::find(app, &ready.cohort).await?;
        return Ok(ready);
    }
    let found = jobs::find(app, job).await?;
    let missing = || ServiceError::NotFound { kind: "kept model of the job", key: job.into() };
    let mark = app.store.find_output_mark(job).await?.ok_or_else(missing)?;
    let (output, _room) = jobs::output(app, job).await?;
    if !output.is_model() {
        return Err(missing());
    }
    let plan: Plan<Options> = json::from_value(&found.parameters)
        .map_err(|error| ServiceError::Internal(format!("the parameters of a job: {error}")))?;
    let cohort = catalogue::find(app, &plan.cohort).await?;
    let work = requests::space(&cohort.spec.representation, &app.limits) + Work::reading(output.data.len());
    let (task_app, id) = (app.clone(), job.to_owned());
    let prepare = move || ReadyModel::new(&task_app, id, &plan, &cohort, output).map(Arc::new);
    let ready = app.pool.weighing(work).run(prepare).await?;
    app.cache.keep(job, &mark, &ready);
    Ok(ready)
}

impl ReadyModel {
    fn new(
        app: &App,
        job: String,
        plan: &Plan<Options>,
        cohort: &Cohort,
        output: JobOutput,
    ) -> Result<Self, ServiceError> {
        let damaged = |detail: &str| ServiceError::Internal(format!("the kept model of {job}: {detail}"));
        let head: Head = json::from_value(&output.head).map_err(|error| damaged(&error.to_string()))?;
        let Described { formula, response, shapes, kept } = head.model;
        let model = KeptModel::of_parts(kept, &output.data).ok_or_else(|| damaged("its size differs"))?;
        Ok(Self {
            cohort: plan.cohort.clone(),
            revision: plan.revision,
            formula,
            response,
            shapes,
            model,
            setup: Setup::of(app, plan.settings(cohort))?,
            name: cohort.spec.name.clone(),
            unit: cohort.spec.shown_unit().map(str::to_owned),
            is_of_shapes: plan.options.is_of_shapes(),
            job,
        })
    }

    /// Values that are written as text, as numbers or levels.
    pub fn read(&self, texts: BTreeMap<String, String>) -> BTreeMap<String, At> {
        let attributes = self.model.attributes();
        texts.into_iter().map(|(name, text)| (name.clone(), attributes.read(&name, &text))).collect()
    }

    /// Predicted work of so many predictions.
    pub fn work(&self, predictions: usize, with_bands: bool) -> Work {
        let numbers = if with_bands { 16 * self.setup.metric.len() } else { self.setup.metric.len() };
        Work::from_multiply_adds(FROM_MEMORY * self.model.cost(predictions, with_bands))
            + Work::numbers((predictions * numbers) as f64)
    }

    /// Predictions at values of attributes, with bands at `level`.
    ///
    /// # Errors
    /// Unknown attributes and levels; values that the shapes do not determine; bands of a model that has none.
    pub fn predict(
        &self,
        at: &[BTreeMap<String, At>],
        level: Option<f64>,
        given: Given,
    ) -> Result<ModelPredictions, ServiceError> {
        let places = at.len() * if level.is_some() { self.model.places() } else { 0 };
        if places > MAX_EFFECT_POINTS {
            let detail = format!(
                "expected at most {MAX_EFFECT_POINTS} places over all predictions, got {places} for {}",
                at.len()
            );
            return Err(ServiceError::invalid("/at", detail));
        }
        let metric = self.is_of_shapes.then_some(&self.setup.metric);
        let predictions = self.model.predictions(at, level, metric).map_err(|error| refused(error, given))?;
        Ok(ModelPredictions {
            model: self.job.clone(),
            cohort: self.cohort.clone(),
            cohort_revision: self.revision,
            formula: self.formula.clone(),
            response: self.response.clone(),
            shapes: self.shapes,
            draws: self.model.draws(),
            predictions,
        })
    }

    /// Drawing of predictions, side by side.
    pub fn draw(&self, found: &ModelPredictions) -> Drawing {
        let title = format!("{} of {} shapes of {}", self.formula, self.shapes, self.name);
        let space = (&self.setup.space, &self.setup.method);
        self.setup
            .in_scale(draw_predictions(space, &title, &found.predictions, Vec::new()), self.unit.as_deref())
    }
}

fn refused(error: ModelError, given: Given) -> ServiceError {
    match (given, error) {
        (Given::Query, ref error @ ModelError::UnknownPlace { ref name, .. }) => {
            ServiceError::parameter(format!("at.{name}"), error.to_string())
        }
        (Given::Query, error @ ModelError::Undetermined { .. }) => {
            ServiceError::parameter("at", error.to_string())
        }
        (Given::Query, ModelError::Setting { field, detail }) => ServiceError::parameter(field, detail),
        (_, error) => refused_at(error, &[], "/at"),
    }
}
