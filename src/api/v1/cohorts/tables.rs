//! A cohort as a table, and summaries of its attributes.

use axum::body::Bytes;
use axum::http::{HeaderMap, HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::stream;
use serde::Serialize;
use serde_json::Value;

use crate::api::extract::{Caller, JsonBody, Path, Query, accepted, preferred};
use crate::api::negotiation::covers;
use crate::api::problem::{Problem, ProblemKind};
use crate::api::respond::{json, streamed};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::entity_tags::{tag_of, unless_known};
use crate::api::v1::requests::shape_query::{Parameters, take_filter};
use crate::domain::filter::ShapeFilter;
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::catalogue::revision_tag;
use crate::service::dictionaries::answers::UsedDictionary;
use crate::service::tables::summary::{
    self, AttributeSummary, Distribution, PROBABILITIES, SummaryQuery, ValueType,
};
use crate::service::tables::table::{self, CohortTable, TableQuery};
use crate::wire::checked::{Checked, Many, document, take_many};
use crate::wire::json;
use crate::wire::table::TableFormat;
use crate::wire::time::rfc3339;

/// Default and maximum number of values of an attribute.
const VALUES: (usize, usize) = (100, 10_000);
/// Default and maximum number of bins.
const BINS: (usize, usize) = (32, 1000);

/// Query parameters of summaries, beside the filter.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document; `Parameters` reads them")]
pub(in crate::api::v1) struct AttributesQuery {
    /// Maximum number of values listed of each attribute, the most frequent ones. Default: 100.
    #[param(minimum = 0, maximum = 10_000)]
    values: Option<usize>,
    /// Number of bins of histograms. Default: 32.
    #[param(minimum = 1, maximum = 1000)]
    bins: Option<usize>,
}

/// A value of an attribute and its frequency.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct ValueCount {
    /// The value, as filters compare it.
    value: String,
    /// Number of shapes that have it.
    count: usize,
}

/// Histogram with bins of equal width.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct Histogram {
    /// Edges of the bins, one more than there are bins.
    edges: Vec<f64>,
    /// Number of shapes in each bin, which contains its lower edge; the last one contains both.
    counts: Vec<usize>,
}

/// Quantile of an attribute.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct Quantile {
    /// Probability.
    probability: f64,
    /// Value, interpolated linearly between order statistics.
    value: f64,
}

/// Summary of an attribute.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct AttributeOutput {
    /// Name: `label`, `subject`, `external_id`, `created_at`, `labels.<attribute>` or `measures.<measure>`.
    name: String,
    /// Type of its values; `text` if they are of several types.
    #[serde(rename = "type")]
    value_type: ValueType,
    /// Number of shapes without it.
    missing: usize,
    /// Number of different values.
    distinct: usize,
    /// The most frequent values; empty for times.
    values: Vec<ValueCount>,
    /// Smallest value, of numbers.
    #[serde(skip_serializing_if = "Option::is_none")]
    min: Option<f64>,
    /// Largest value, of numbers.
    #[serde(skip_serializing_if = "Option::is_none")]
    max: Option<f64>,
    /// Mean, of numbers.
    #[serde(skip_serializing_if = "Option::is_none")]
    mean: Option<f64>,
    /// Quantiles, of numbers.
    #[serde(skip_serializing_if = "Option::is_none")]
    quantiles: Option<Vec<Quantile>>,
    /// Histogram, of numbers, and of times in milliseconds since 1970 UTC.
    #[serde(skip_serializing_if = "Option::is_none")]
    histogram: Option<Histogram>,
    /// First time, RFC 3339.
    #[serde(skip_serializing_if = "Option::is_none")]
    earliest: Option<String>,
    /// Last time, RFC 3339.
    #[serde(skip_serializing_if = "Option::is_none")]
    latest: Option<String>,
}

impl AttributeOutput {
    fn new(summary: AttributeSummary) -> Self {
        let AttributeSummary { attribute, value_type, missing, distinct, values, distribution } = summary;
        let values = values.into_iter().map(|(value, count)| ValueCount { value, count }).collect();
        let output = Self {
            name: attribute.to_string(),
            value_type,
            missing,
            distinct,
            values,
            min: None,
            max: None,
            mean: None,
            quantiles: None,
            histogram: None,
            earliest: None,
            latest: None,
        };
        match distribution {
            None => output,
            Some(distribution) => output.with(distribution),
        }
    }

    fn with(self, distribution: Distribution) -> Self {
        let Distribution { range: [low, high], mean, quantiles, edges, counts } = distribution;
        let histogram = Some(Histogram { edges, counts });
        if self.value_type == ValueType::Time {
            let [earliest, latest] = [low, high].map(|ms| Some(rfc3339(ms as i64)));
            return Self { histogram, earliest, latest, ..self };
        }
        let quantile = |(probability, value)| Quantile { probability, value };
        let quantiles = PROBABILITIES.into_iter().zip(quantiles).map(quantile).collect();
        let (min, max, mean) = (Some(low), Some(high), Some(mean));
        Self { min, max, mean, quantiles: Some(quantiles), histogram, ..self }
    }
}

/// Attributes of the shapes of a cohort.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct AttributesAnswer {
    /// Revision of the cohort.
    revision: u64,
    /// Number of shapes that pass the filter.
    shape_count: usize,
    /// One entry per attribute that a shape of the cohort has.
    items: Vec<AttributeOutput>,
    /// Warnings, such as the number of attributes that are not listed.
    warnings: Vec<String>,
}

/// Sums up the attributes and measures of the shapes of a cohort: types, values with their frequencies, distributions.
#[utoipa::path(get, path = "/v1/cohorts/{cohort}/attributes", tag = "cohorts",
    params(("cohort" = String, Path, description = "Id or name"), AttributesQuery, FilterQuery),
    responses(
        (status = 200, description = "One entry per attribute", body = AttributesAnswer),
        (status = 304, description = "Unchanged since the version in If-None-Match"),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn list_attributes(
    Caller(app): Caller,
    Path(key): Path<String>,
    Query(pairs): Query<Vec<(String, String)>>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let query = take_summary(pairs)?;
    let what = format!("{query:?}");
    let found = summary::summarise(&app, &key, query).await?;
    let tag = tag_of(&format!("{}{what}", revision_tag(&found.cohort)));
    let answer = async {
        let work = Work::numbers(summary::numbers_in(&found) as f64);
        let write = move || {
            let items = found.attributes.iter().cloned().map(AttributeOutput::new).collect();
            let (revision, warnings) = (found.cohort.revision, found.warnings.clone());
            let answer = AttributesAnswer { revision, shape_count: found.shapes, items, warnings };
            json(StatusCode::OK, &answer)
        };
        let pool = app.pool.weighing(work);
        Ok(if work.is_instant() { write()? } else { pool.run(write).await? })
    };
    unless_known(&headers, &tag, answer).await
}

fn take_summary(pairs: Vec<(String, String)>) -> Result<SummaryQuery, Problem> {
    let mut parameters = Parameters::read(pairs)?;
    let mut count = |name: &str, least: usize, (usual, most): (usize, usize)| {
        let count = parameters.take_count(name)?.unwrap_or(usual);
        let wrong = || format!("expected a number between {least} and {most}, got {count}");
        (least..=most).contains(&count).then_some(count).ok_or_else(|| Problem::of_parameter(name, wrong()))
    };
    let (values, bins) = (count("values", 0, VALUES)?, count("bins", 1, BINS)?);
    let filter = parameters.take_filter();
    parameters.refuse_rest()?;
    Ok(SummaryQuery { filter, values, bins })
}

document! {
    /// Columns and shapes of a table.
    #[schema(example = json!({"columns": ["external_id", "label", "measures.area"], "filter": {"measures": {"area": {"gte": 0}}}}))]
    pub(in crate::api::v1) struct TableRequest {
        /// Names of the columns, as for the table by GET. Default: id, all attributes and measures.
        #[schema(value_type = Option<Vec<String>>)]
        columns: Many<String>;
        /// Filter that selects shapes. Default: all shapes.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
    }
}

/// Query parameters of tables, beside the filter.
#[derive(utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document; `Parameters` reads them")]
pub(in crate::api::v1) struct TableParameters {
    /// Names of the columns, separated by commas; a column whose name has a comma takes a separate parameter. Default:
    /// id, all attributes and measures.
    #[param(example = "external_id,labels.treatment,measures.area")]
    columns: Option<Vec<String>>,
    /// Format: `json`, `csv`, `ndjson`, `arrow` or `parquet`. Default: as the header `Accept` asks, else `json`.
    format: Option<String>,
}

/// Column of a table.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[allow(dead_code, reason = "only for the document; `Table` writes it")]
pub(in crate::api::v1) struct TableColumn {
    /// Name, as it was asked for.
    name: String,
    /// Type of its values.
    #[serde(rename = "type")]
    value_type: ValueType,
    /// One value per row; null if it is missing.
    #[schema(value_type = Vec<described::TableValue>)]
    values: Vec<Value>,
}

#[cfg(feature = "schema")]
mod described {
    use utoipa::openapi::RefOr;
    use utoipa::openapi::schema::{ObjectBuilder, Schema, SchemaType, Type};
    use utoipa::{PartialSchema, ToSchema};

    /// Value of a table, for the document.
    pub(in crate::api::v1) struct TableValue;

    impl PartialSchema for TableValue {
        fn schema() -> RefOr<Schema> {
            let types = [Type::String, Type::Number, Type::Boolean, Type::Null];
            ObjectBuilder::new().schema_type(SchemaType::from_iter(types)).into()
        }
    }

    impl ToSchema for TableValue {}
}

/// Table by columns.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[allow(dead_code, reason = "only for the document; `Table` writes it")]
pub(in crate::api::v1) struct TableAnswer {
    /// Id of the cohort.
    cohort: String,
    /// Revision of the cohort.
    revision: u64,
    /// Dictionaries of the columns, in the order of their first columns.
    dictionaries: Vec<UsedDictionary>,
    /// Number of rows.
    rows: usize,
    /// The columns.
    columns: Vec<TableColumn>,
}

/// Revision of the cohort that a table was made from.
const REVISION: HeaderName = HeaderName::from_static("shapelex-revision");
/// Dictionaries that a table was made from.
const DICTIONARIES: HeaderName = HeaderName::from_static("shapelex-dictionaries");

/// Returns shapes of a cohort as a table, one row per shape.
///
/// Columns: `id`, `external_id`, `label`, `subject`, `created_at`, `labels.<attribute>`, `measures.<measure>`; for a dictionary by
/// its id, `name@version`, `name@alias` or name also `<dictionary>.score.1`, … (components, or coefficients of atoms), `.t_squared`,
/// `.residual`, `.relative_error`, `.outlier` (at the quantile 0.99), `.class` and `.confidence`. A shape that a dictionary cannot
/// encode has missing values there. The headers `shapelex-revision` and `shapelex-dictionaries` name the revision and
/// the versions that the table was made from; so do the fields of JSON and the metadata of the Arrow schema.
#[utoipa::path(get, path = "/v1/cohorts/{cohort}/table", tag = "cohorts",
    params(("cohort" = String, Path, description = "Id or name"), TableParameters, FilterQuery),
    responses(
        (status = 200, description = "The table", content((TableAnswer = "application/json"), (String = "text/csv"), (String = "application/x-ndjson"), (Binary = "application/vnd.apache.arrow.stream"), (Binary = "application/vnd.apache.parquet"))),
        (status = 304, description = "Unchanged since the version in If-None-Match"),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn find_table(
    Caller(app): Caller,
    Path(key): Path<String>,
    Query(pairs): Query<Vec<(String, String)>>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let (columns, pairs): (Vec<_>, Vec<_>) = pairs.into_iter().partition(|(name, _)| name == "columns");
    let mut parameters = Parameters::read(pairs)?;
    let format = table_format(parameters.take("format").as_deref(), &headers)?;
    let names = match columns.as_slice() {
        [] => None,
        [(_, names)] => Some(names.split(',').map(|name| name.trim().to_owned()).collect()),
        several => Some(several.iter().map(|(_, name)| name.clone()).collect()),
    };
    let query = TableQuery { columns: names, filter: parameters.take_filter(), in_query: true };
    parameters.refuse_rest()?;
    answer_table(&app, &key, query, format, &headers).await
}

/// Returns shapes of a cohort as a table, with columns and filter in the body.
#[utoipa::path(post, path = "/v1/cohorts/{cohort}/table", tag = "cohorts", request_body = TableRequest,
    params(("cohort" = String, Path, description = "Id or name"),
        ("format" = Option<String>, Query, description = "Format: `json`, `csv`, `ndjson`, `arrow` or `parquet`. Default: as the header `Accept` asks, else `json`")),
    responses(
        (status = 200, description = "The table", content((TableAnswer = "application/json"), (String = "text/csv"), (String = "application/x-ndjson"), (Binary = "application/vnd.apache.arrow.stream"), (Binary = "application/vnd.apache.parquet"))),
        (status = 404, description = "No such cohort"),
        (status = "4XX", description = "The input was refused")
    ))]
pub(in crate::api::v1) async fn compute_table(
    Caller(app): Caller,
    Path(key): Path<String>,
    Query(pairs): Query<Vec<(String, String)>>,
    headers: HeaderMap,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let mut parameters = Parameters::read(pairs)?;
    let format = table_format(parameters.take("format").as_deref(), &headers)?;
    parameters.refuse_rest()?;
    let query = read_table(&app, body).await?;
    // A client that has an answer learns so by GET alone: 304 is not an answer to POST (RFC 9110, 13.1.2).
    answer_table(&app, &key, query, format, &HeaderMap::new()).await
}

async fn read_table(app: &App, body: Bytes) -> Result<TableQuery, ServiceError> {
    let TableRequest { columns, filter, faults: mut errors } = app.read(body).await?;
    let columns = take_many(columns, "/columns", &mut errors);
    let filter = take_filter(filter, "/filter", &mut errors).unwrap_or_default();
    ServiceError::unless_empty(errors)?;
    Ok(TableQuery { columns, filter, in_query: false })
}

/// Format of a table by its name, else by the header `Accept`.
fn table_format(name: Option<&str>, headers: &HeaderMap) -> Result<TableFormat, Problem> {
    let offered = || TableFormat::ALL.into_iter();
    if let Some(name) = name {
        let found = offered().find(|format| format.name() == name);
        let wanted = || format!("expected 'json', 'csv', 'ndjson', 'arrow' or 'parquet', got '{name}'");
        return found.ok_or_else(|| Problem::of_parameter("format", wanted()));
    }
    let accept = accepted(headers);
    let of_range = |range: &str| offered().find(|format| covers(range, format.media_type()));
    preferred(&accept, of_range).ok_or_else(|| {
        let types: Vec<&str> = offered().map(TableFormat::media_type).collect();
        let detail = format!("expected one of {} to be accepted, got '{accept}'", types.join(", "));
        Problem::new(ProblemKind::NotAcceptable, detail)
    })
}

async fn answer_table(
    app: &App,
    key: &str,
    query: TableQuery,
    format: TableFormat,
    headers: &HeaderMap,
) -> Result<Response, Problem> {
    let what = format!("{query:?}{format:?}");
    let made = table::table(app, key, query).await?;
    let used: Vec<UsedDictionary> =
        made.dictionaries.iter().map(|ready| UsedDictionary::new(ready)).collect();
    let named: Vec<String> = used.iter().map(UsedDictionary::reference).collect();
    let tag = tag_of(&format!("{}{named:?}{what}", revision_tag(&made.cohort)));
    let answer = async {
        let revision = made.cohort.revision;
        let mut response = table_file(made, &used, format)?;
        response.headers_mut().insert(REVISION, revision.into());
        if let Ok(value) = HeaderValue::from_str(&named.join(", ")) {
            response.headers_mut().insert(DICTIONARIES, value);
        }
        Ok(response)
    };
    unless_known(headers, &tag, answer).await
}

/// The file of a table, written while it is sent, which holds its memory until then.
fn table_file(
    made: CohortTable,
    used: &[UsedDictionary],
    format: TableFormat,
) -> Result<Response, ServiceError> {
    let CohortTable { cohort, mut table, memory: held, .. } = made;
    let dictionaries = json::to_value(&used).map_err(|error| ServiceError::Internal(error.to_string()))?;
    let fields = [
        ("cohort", Value::from(cohort.id)),
        ("revision", cohort.revision.into()),
        ("dictionaries", dictionaries),
    ];
    table.fields = fields.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
    let pieces = table.pieces(format).map_err(|error| ServiceError::Internal(error.to_string()))?;
    let pieces = pieces.inspect(move |_| {
        let _held = &held;
    });
    let body = streamed(stream::iter(pieces));
    Ok(([(header::CONTENT_TYPE, format.media_type())], body).into_response())
}
