//! Drift: comparison of newly added shapes with those that a dictionary was learnt from.

use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Serialize};

use crate::analysis::assessment::drift::{ClassDrift, Drift, MeanDrift, MeasureDrift, ScoreDrift};
use crate::analysis::defaults::OUTLIER_QUANTILE;
use crate::api::extract::{BesideFormat, Caller, Format, Path};
use crate::api::problem::Problem;
use crate::api::respond::{compute, json, picture};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::entity_tags::Asked;
use crate::service::app::Work;
use crate::service::dictionaries::answers::UsedDictionary;
use crate::service::dictionaries::coding::warnings;
use crate::service::dictionaries::drift::{CohortDrift, Since};
use crate::service::dictionaries::pictures::drifted;
use crate::service::dictionaries::{drift, ready};

/// Selects new shapes and sets the outlier quantile.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(in crate::api::v1) struct DriftQuery {
    /// A revision of the cohort or a time (RFC 3339); shapes added after it are new. Default: the revision that the dictionary
    /// was learnt from.
    since: Option<String>,
    /// Fraction of shapes like the training shapes that should not count as outliers, at least 0.5. Default: 0.99.
    #[param(minimum = 0.5, exclusive_maximum = 1)]
    quantile: Option<f64>,
}

/// Outliers among the new shapes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct OutlierRate {
    /// Number of outliers.
    count: usize,
    /// Fraction of the new shapes; null without new shapes.
    rate: Option<f64>,
    /// Quantile that defines the outliers.
    quantile: f64,
}

/// Differences between new shapes and the training shapes of a dictionary.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct DriftAnswer {
    /// The dictionary.
    dictionary: UsedDictionary,
    /// Id of the cohort.
    cohort: String,
    /// Shapes added after this revision are new.
    since_revision: u64,
    /// Revision up to which new shapes were examined.
    cohort_revision: u64,
    /// Number of new shapes that pass the filter of the dictionary.
    #[serde(rename = "shape_count")]
    shapes: usize,
    /// New shapes beyond the limit that the quantile sets for `T²` and squared prediction error together.
    outliers: OutlierRate,
    /// Squared Mahalanobis distances (`T²`) of the scores; null for sparse dictionaries.
    t_squared: Option<MeasureDrift>,
    /// Squared prediction errors.
    squared_prediction_error: Option<MeasureDrift>,
    /// Scores, component by component; null for sparse dictionaries.
    scores: Option<Vec<ScoreDrift>>,
    /// Drift of the mean shape; null with fewer than two new shapes.
    mean: Option<MeanDrift>,
    /// Predicted classes of the new shapes; null without a classifier.
    classes: Option<Vec<ClassDrift>>,
    /// Warnings about outlier detection, and those of the dictionary; absent if there are none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    warnings: Vec<String>,
}

/// Compares newly added shapes with those that a dictionary was learnt from.
///
/// Reference figures are those of the training shapes when they were held out, so that similar new shapes have similar
/// figures. Older dictionaries without such a record use the figures of the shapes they were learnt from, and say so in
/// `warnings`. As SVG: the scores of the new shapes against those of the training, and the changes in words.
#[utoipa::path(get, path = "/v1/dictionaries/{dictionary}/drift", tag = "dictionaries",
    params(("dictionary" = String, Path, description = "Id, `name@version`, `name@alias` or name"), DriftQuery,
        ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery),
    responses(
        (status = 200, description = "Changes of the cohort since training", content((DriftAnswer = "application/json"), (String = "image/svg+xml"))),
        (status = 304, description = "Unchanged since the version in If-None-Match"),
        (status = 404, description = "No such dictionary, or its cohort was deleted"),
        (status = "4XX", description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn dictionary_drift(
    Caller(app): Caller,
    Path(key): Path<String>,
    format: Format,
    BesideFormat(query): BesideFormat<DriftQuery>,
    asked: Asked,
) -> Result<Response, Problem> {
    let since = match &query.since {
        None => Since::Training,
        Some(text) => since_of(text)?,
    };
    let ready = ready::find(&app, &key).await?;
    let quantile = query.quantile.unwrap_or(OUTLIER_QUANTILE);
    let found = drift::drift(&app, ready.clone(), since, quantile).await?;
    let state = format!("{} {} {}", ready.listed.id, found.cohort, found.until);
    let answer = compute(app.weighing(Work::MOMENT + format.work()), move |_| match format {
        Format::Picture(file) => picture(&drifted(&ready, &found, quantile), &file),
        Format::Json => {
            let (dictionary, warnings) = (UsedDictionary::new(&ready), warnings(&ready));
            json(StatusCode::OK, &DriftAnswer::new(dictionary, found, quantile, warnings))
        }
    });
    asked.unless_known(&state, format, answer).await
}

impl DriftAnswer {
    fn new(dictionary: UsedDictionary, found: CohortDrift, quantile: f64, warnings: Vec<String>) -> Self {
        let CohortDrift { cohort, since, until, drift } = found;
        let Drift { shapes, outliers, t_squared, residuals, scores, mean, classes } = drift;
        let rate = (shapes > 0).then(|| outliers as f64 / shapes as f64);
        Self {
            dictionary,
            cohort,
            since_revision: since,
            cohort_revision: until,
            shapes,
            outliers: OutlierRate { count: outliers, rate, quantile },
            t_squared,
            squared_prediction_error: residuals,
            scores,
            mean,
            classes,
            warnings,
        }
    }
}

fn since_of(text: &str) -> Result<Since, Problem> {
    if let Ok(revision) = text.parse() {
        return Ok(Since::Revision(revision));
    }
    let time: Result<jiff::Timestamp, _> = text.parse();
    time.map(|time| Since::Time(time.as_millisecond())).map_err(|_| {
        let detail = format!("expected a revision or a time such as 2026-01-31T12:00:00Z, got '{text}'");
        Problem::of_parameter("since", detail)
    })
}
