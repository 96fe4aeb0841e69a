//! Predictions of linear models that are kept.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::http::StatusCode;
use axum::response::Response;

use crate::analysis::models::records::At;
use crate::analysis::models::study::MAX_PREDICTIONS;
use crate::api::extract::{BesideFormat, Caller, Format, JsonBody, OnlyFormat, Path};
use crate::api::problem::Problem;
use crate::api::respond::{compute_unwaiting, json, picture};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::shape_query::Parameters;
use crate::service::app::{App, ServiceError};
#[cfg(feature = "schema")]
use crate::service::inference::models::kept::ModelPredictions;
use crate::service::inference::models::kept::{self, Given, ReadyModel};
use crate::wire::checked::{Checked, document, take_given};
use crate::wire::fault::Fault;

/// Prefix of the names of attributes in a query.
const AT: &str = "at";

/// Values at which a model is asked in a query, for the OpenAPI document.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document; `Place` reads them")]
pub(in crate::api::v1) struct PlaceParameters {
    /// Values of attributes of the formula: `at[age]=60`, also written `at.age=60`. Numbers that are not given are at their mean, and shapes
    /// are averaged over other factors as they occur.
    #[param(style = DeepObject, explode, value_type = Option<BTreeMap<String, String>>, example = json!({}))]
    at: Option<BTreeMap<String, String>>,
    /// Level of bands, such as 0.95. Default: no bands.
    #[param(exclusive_minimum = 0.0, exclusive_maximum = 1.0)]
    bands: Option<f64>,
}

document! {
    /// Values at which a kept model is asked.
    #[schema(example = json!({"at": [{"log_centroid_size": 4.5}, {"log_centroid_size": 5.0}], "bands": 0.95}))]
    pub(in crate::api::v1) struct PredictionsRequest {
        /// Values of attributes of the formula, at most 100 of them. Numbers that are not given are at their mean, and shapes are averaged
        /// over other factors as they occur.
        #[schema(value_type = Vec<BTreeMap<String, At>>, required = true, min_items = 1, max_items = 100)]
        at: Checked<Vec<BTreeMap<String, At>>>, required;
        /// Level of bands, such as 0.95. Default: no bands.
        #[schema(value_type = Option<f64>, exclusive_minimum = 0.0, exclusive_maximum = 1.0)]
        bands: Checked<f64>;
    }
}

/// Predicts the shape of a kept model at values of its attributes.
///
/// The model is that of a job of `POST /v1/models` with `keep`. The answer takes milliseconds: it needs none of the shapes. As SVG: the
/// predicted shape, in the plane with its bands.
#[utoipa::path(get, path = "/v1/models/{job}/predictions", tag = "inference",
    params(
        ("job" = String, Path, description = "Id of the job that has fitted the model"), PlaceParameters,
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery
    ),
    responses(
        (status = 200, description = "The prediction", content((ModelPredictions = "application/json"), (String = "image/svg+xml"))),
        (status = 404, description = "No such job, or it has kept no model (not yet, never, or no longer)"),
        (status = "4XX", description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn find_prediction(
    Caller(app): Caller,
    Path(job): Path<String>,
    format: Format,
    BesideFormat(pairs): BesideFormat<Vec<(String, String)>>,
) -> Result<Response, Problem> {
    let (texts, level) = place_of(pairs)?;
    let ready = kept::find(&app, &job).await?;
    let at = vec![ready.read(texts)];
    answer(app, ready, (at, level), Given::Query, format).await
}

/// Predicts shapes of a kept model at values of its attributes.
///
/// As `GET` of the same address, for up to 100 predictions. As SVG: the predicted shapes side by side.
#[utoipa::path(post, path = "/v1/models/{job}/predictions", tag = "inference", request_body = PredictionsRequest,
    params(
        ("job" = String, Path, description = "Id of the job that has fitted the model"),
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery
    ),
    responses(
        (status = 200, description = "The predictions", content((ModelPredictions = "application/json"), (String = "image/svg+xml"))),
        (status = 404, description = "No such job, or it has kept no model (not yet, never, or no longer)"),
        (status = "4XX", description = "The input was refused")
    ))]
pub(in crate::api::v1) async fn predict(
    Caller(app): Caller,
    Path(job): Path<String>,
    OnlyFormat(format): OnlyFormat,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let app = app.with_body(&body);
    let asked = app.parse::<PredictionsRequest>(&body)?.asked()?;
    let ready = kept::find(&app, &job).await?;
    answer(app, ready, asked, Given::Body, format).await
}

/// Values of predictions, and the level of their bands.
type Asked = (Vec<BTreeMap<String, At>>, Option<f64>);

async fn answer(
    app: App,
    ready: Arc<ReadyModel>,
    (at, level): Asked,
    given: Given,
    format: Format,
) -> Result<Response, Problem> {
    let work = ready.work(at.len(), level.is_some()) + format.work();
    work.check(app.limits.compute_time.as_secs_f64())?;
    compute_unwaiting(app.weighing(work), move |_| {
        let found = ready.predict(&at, level, given)?;
        match format {
            Format::Json => json(StatusCode::OK, &found),
            Format::Picture(file) => picture(&ready.draw(&found), &file),
        }
    })
    .await
}

/// Values of attributes as texts, and the level of bands, of a query.
fn place_of(pairs: Vec<(String, String)>) -> Result<(BTreeMap<String, String>, Option<f64>), Problem> {
    let (own, others): (Vec<_>, Vec<_>) = pairs
        .into_iter()
        .map(|(name, value)| (attribute_of(&name), name, value))
        .partition(|(own, ..)| own.is_some());
    let mut texts = BTreeMap::new();
    for (attribute, name, value) in own {
        if texts.insert(attribute.unwrap_or_default(), value).is_some() {
            return Err(Problem::of_parameter(name, crate::api::extract::TWICE));
        }
    }
    let mut parameters =
        Parameters::read(others.into_iter().map(|(_, name, value)| (name, value)).collect())?;
    let level = match parameters.take("bands") {
        None => None,
        Some(text) => Some(text.parse().map_err(|_| {
            Problem::of_parameter("bands", format!("expected a number between 0 and 1, got '{text}'"))
        })?),
    };
    parameters.refuse_rest()?;
    if let Some(detail) = level_fault(level) {
        return Err(Problem::of_parameter("bands", detail));
    }
    Ok((texts, level))
}

/// The attribute of a parameter `at.age` or `at[age]`.
fn attribute_of(name: &str) -> Option<String> {
    let rest = name.strip_prefix(AT)?;
    let bracketed = || rest.strip_prefix('[')?.strip_suffix(']');
    rest.strip_prefix('.').or_else(bracketed).map(str::to_owned)
}

fn level_fault(level: Option<f64>) -> Option<String> {
    let level = level.filter(|level| !(*level > 0.0 && *level < 1.0))?;
    Some(format!("expected a number between 0 and 1, both excluded, got {level}"))
}

impl PredictionsRequest {
    fn asked(self) -> Result<Asked, ServiceError> {
        let mut errors = self.faults;
        let at = take_given(self.at, "/at", &mut errors);
        let bands = take_given(self.bands, "/bands", &mut errors);
        let count = at.as_ref().map_or(0, Vec::len);
        if at.is_some() && !(1..=MAX_PREDICTIONS).contains(&count) {
            errors.push(Fault::new("/at", format!("expected 1 to {MAX_PREDICTIONS} entries, got {count}")));
        }
        errors.extend(level_fault(bands).map(|detail| Fault::new("/bands", detail)));
        ServiceError::unless_empty(errors)?;
        at.map(|at| (at, bands)).ok_or_else(|| ServiceError::invalid("/at", "required field is missing"))
    }
}
