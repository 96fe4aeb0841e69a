//! How new shapes differ from those that a dictionary was learnt from.

use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Serialize};

use crate::api::extract::{Caller, Path, Query};
use crate::api::problem::{Problem, ProblemDocument, ProblemKind};
use crate::api::respond::json;
use crate::service::dictionaries::coding::outlier_warnings;
use crate::service::dictionaries::drift::{ClassDrift, Drift, MeanDrift, MeasureDrift, ScoreDrift, Since};
use crate::service::dictionaries::{drift, ready};

/// Which shapes are new, and which are outliers.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct DriftQuery {
    /// A revision of the cohort or a time (RFC 3339) after which shapes are new; the revision that the dictionary was
    /// learnt from unless given.
    since: Option<String>,
    /// Part of shapes like the training shapes that shall not be called outliers, from 0.5; 0.99 unless given.
    quantile: Option<f64>,
}

/// Outliers among the new shapes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct OutlierRate {
    /// How many there are.
    count: usize,
    /// Part of the new shapes; null without new shapes.
    rate: Option<f64>,
    /// The quantile.
    quantile: f64,
}

/// What has changed since a dictionary was learnt.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct DriftAnswer {
    /// Id of the dictionary.
    dictionary: String,
    /// Id of its cohort.
    cohort: String,
    /// Shapes that came after this revision are new.
    since_revision: u64,
    /// Revision up to which they were looked at.
    cohort_revision: u64,
    /// New shapes that pass the filter of the dictionary.
    shapes: usize,
    /// Those beyond the limit that the quantile sets for `T²` and squared prediction error together.
    outliers: OutlierRate,
    /// Squared Mahalanobis distances of the scores; null for sparse dictionaries.
    t_squared: Option<MeasureDrift>,
    /// Squared prediction errors.
    squared_prediction_error: Option<MeasureDrift>,
    /// Scores, component by component; null for sparse dictionaries.
    scores: Option<Vec<ScoreDrift>>,
    /// The mean shape; null with fewer than two new shapes.
    mean: Option<MeanDrift>,
    /// Classes, as the classifier sees the new shapes; null without one.
    classes: Option<Vec<ClassDrift>>,
    /// What to know about outliers; absent when there is nothing.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    warnings: Vec<String>,
}

/// Compares the shapes that were added since with those that the dictionary was learnt from.
///
/// The training shapes are taken as they looked when they were held out, so that the figures of new shapes like them are
/// alike; dictionaries from before there was such a record take them as they were learnt from, and say so in `warnings`.
#[utoipa::path(get, path = "/dictionaries/{dictionary}/drift", tag = "dictionaries",
    params(("dictionary" = String, Path, description = "Id, `name@version` or name"), DriftQuery),
    responses(
        (status = 200, description = "What has changed", body = DriftAnswer),
        (status = 404, description = "No such dictionary, or its cohort was deleted", body = ProblemDocument, content_type = "application/problem+json"),
        (status = "4XX", description = "The query was refused", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn dictionary_drift(
    Caller(app): Caller,
    Path(key): Path<String>,
    Query(query): Query<DriftQuery>,
) -> Result<Response, Problem> {
    let since = match &query.since {
        None => Since::Training,
        Some(text) => since_of(text)?,
    };
    let ready = ready::find(&app, &key).await?;
    let quantile = query.quantile.unwrap_or(0.99);
    let (dictionary, warnings) = (ready.dictionary.id.clone(), outlier_warnings(&ready));
    let found = drift::drift(&app, ready, since, quantile).await?;
    let Drift { cohort, since, until, shapes, outliers, t_squared, residuals, scores, mean, classes } = found;
    let rate = (shapes > 0).then(|| outliers as f64 / shapes as f64);
    let answer = DriftAnswer {
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
    };
    Ok(json(StatusCode::OK, &answer)?)
}

fn since_of(text: &str) -> Result<Since, Problem> {
    if let Ok(revision) = text.parse() {
        return Ok(Since::Revision(revision));
    }
    let time: Result<jiff::Timestamp, _> = text.parse();
    time.map(|time| Since::Time(time.as_millisecond())).map_err(|_| {
        let detail = format!("since is '{text}', must be a revision or a time such as 2026-01-31T12:00:00Z");
        Problem::new(ProblemKind::InvalidQuery, detail)
    })
}
