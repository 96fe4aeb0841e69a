//! Answers with numbers as tables: CSV, Arrow, Parquet, NPY and NPZ instead of JSON.
//!
//! A handler gives its answer once, as JSON. Where `?format=` or the `Accept` header asks for a table, this layer asks the
//! handler for JSON and makes the table of it (`wire::columns`): which list of the answer is the table is a column of
//! [`operation::OPERATIONS`], and `?table=` names another one. Refusals and jobs stay as they are.

use axum::body::{Body, to_bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::extract::{ANYTHING, accepted, preferred};
use super::formulas::with_query;
use super::observe;
use super::operation;
use super::problem::{Problem, ProblemKind};

use crate::service::app::memory::Purpose;
use crate::service::app::{App, ServiceError, Work};
use crate::wire::columns::{Columns, ColumnsError, ColumnsFormat};

/// Parameters that this layer reads.
const PARAMETERS: [&str; 3] = ["format", "table", "column"];
/// Names the table of an answer that is in the file.
const TABLE: HeaderName = HeaderName::from_static("shapelex-table");
/// Memory of an answer that is parsed, for each of its bytes: a number of three digits takes 32.
const PARSED: usize = 12;
/// Time of making a table, for each byte of its answer.
const SECONDS: f64 = 4e-8;

/// Format and table that a request asks for.
pub(super) struct Wanted {
    format: ColumnsFormat,
    table: String,
    column: Option<String>,
}

impl Wanted {
    /// The table that a request asks for, if it asks for one that its operation has.
    pub(super) fn of(request: &Request) -> Option<Self> {
        if is_plain(request) {
            return None;
        }
        let route = observe::route(request).unwrap_or_default();
        let usual = operation::find(request.method().as_str(), route)?.table?;
        let query = axum::extract::Query::<Vec<(String, String)>>::try_from_uri(request.uri()).ok()?;
        let value = |name: &str| query.0.iter().find(|(key, _)| key == name).map(|(_, value)| value.clone());
        let format = match value("format") {
            Some(name) => ColumnsFormat::ALL.into_iter().find(|format| format.name() == name)?,
            None => preferred(&accepted(request.headers()), table_or_other).flatten()?,
        };
        Some(Self { format, table: value("table").unwrap_or_else(|| usual.into()), column: value("column") })
    }

    /// Suffix that distinguishes the entity tag of this file from that of the answer.
    fn suffix(&self) -> String {
        let column = self.column.as_deref().unwrap_or_default();
        let text = format!("-{}-{}-{column}", self.format.name(), self.table);
        text.chars().map(|c| if c.is_ascii_alphanumeric() || "-.".contains(c) { c } else { '_' }).collect()
    }
}

/// Whether a request says nothing of a format, as most do: no parameter, and no media type but JSON or any.
fn is_plain(request: &Request) -> bool {
    let mut types = request.headers().get_all(header::ACCEPT).iter();
    let any = |value: &HeaderValue| matches!(value.as_bytes(), b"*/*" | b"application/json");
    types.all(any) && request.uri().query().is_none_or(|query| !query.contains("format"))
}

/// The format of tables that a media range names; `Some(None)` for ranges that answers of other kinds satisfy.
fn table_or_other(range: &str) -> Option<Option<ColumnsFormat>> {
    match range {
        "" | ANYTHING | "application/*" => Some(None),
        "text/*" => Some(Some(ColumnsFormat::Csv)),
        range => {
            let table = ColumnsFormat::ALL.into_iter().find(|format| format.media_type() == range);
            let other = range == "application/json" || range == "application/x-ndjson" || is_drawn(range);
            table.map(Some).or_else(|| other.then_some(None))
        }
    }
}

/// Media types of pictures and meshes, which handlers write.
fn is_drawn(range: &str) -> bool {
    range.starts_with("image/") || range.starts_with("model/") || range == "application/ply"
}

/// Middleware that makes the table.
pub(super) async fn answer(request: Request, next: Next) -> Response {
    let (Some(wanted), Some(app)) = (Wanted::of(&request), request.extensions().get::<App>().cloned()) else {
        return next.run(request).await;
    };
    let is_head = request.method() == Method::HEAD;
    let mut response = next.run(as_json(request, &wanted)).await;
    let status = response.status();
    if matches!(status, StatusCode::OK | StatusCode::NOT_MODIFIED) {
        retag(response.headers_mut(), &wanted.suffix());
    }
    let is_answer = matches!(status, StatusCode::OK | StatusCode::CREATED);
    let is_json = response.headers().get(header::CONTENT_TYPE).is_some_and(|kind| kind == "application/json");
    if !(is_answer && is_json) {
        return response;
    }
    if is_head {
        describe_file(response.headers_mut(), &wanted);
        return response;
    }
    match convert(app, response, wanted).await {
        Ok(response) => response,
        Err(problem) => problem.into_response(),
    }
}

/// The request to the handler: for JSON, without the parameters of this layer.
fn as_json(mut request: Request, wanted: &Wanted) -> Request {
    let is_other = |parameter: &&str| !PARAMETERS.contains(&parameter.split('=').next().unwrap_or_default());
    let query = request.uri().query().unwrap_or_default().split('&');
    let query: Vec<&str> = query.filter(is_other).collect();
    let uri = with_query(request.uri(), &query.join("&"));
    *request.uri_mut() = uri;
    let headers = request.headers_mut();
    headers.insert(header::ACCEPT, HeaderValue::from_static("application/json"));
    // Tags of other files of this address are not known to the handler.
    let suffix = format!("{}\"", wanted.suffix());
    let known = headers.get_all(header::IF_NONE_MATCH).iter().filter_map(|tags| tags.to_str().ok());
    let known = known.flat_map(|tags| tags.split(',').map(str::trim));
    let known = known.filter_map(|tag| match tag {
        "*" => Some(tag.to_owned()),
        tag => tag.strip_suffix(&suffix).map(|tag| format!("{tag}\"")),
    });
    let known = known.collect::<Vec<_>>().join(", ");
    headers.remove(header::IF_NONE_MATCH);
    if let Some(Ok(tags)) = (!known.is_empty()).then(|| known.parse()) {
        headers.insert(header::IF_NONE_MATCH, tags);
    }
    request
}

/// Gives the answer the entity tag of its file.
fn retag(headers: &mut HeaderMap, suffix: &str) {
    let tag = headers.get(header::ETAG).and_then(|tag| tag.to_str().ok());
    let tag = tag.and_then(|tag| tag.strip_suffix('"')).map(|tag| format!("{tag}{suffix}\"").parse());
    if let Some(Ok(tag)) = tag {
        headers.insert(header::ETAG, tag);
    }
}

fn describe_file(headers: &mut HeaderMap, wanted: &Wanted) {
    headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(wanted.format.media_type()));
    headers.remove(header::CONTENT_LENGTH);
    if let Ok(table) = HeaderValue::from_str(&wanted.table) {
        headers.insert(TABLE, table);
    }
}

/// The file of an answer of JSON.
async fn convert(app: App, response: Response, wanted: Wanted) -> Result<Response, Problem> {
    let (mut parts, body) = response.into_parts();
    let size = http_body::Body::size_hint(&body).upper().and_then(|size| usize::try_from(size).ok());
    let size =
        size.ok_or_else(|| Problem::new(ProblemKind::Internal, "an answer with a table has no known size"))?;
    let held = app.memory.hold(Purpose::Answers, size.saturating_mul(PARSED))?;
    let bytes = to_bytes(body, size).await;
    let bytes = bytes.map_err(|error| Problem::new(ProblemKind::Internal, error.to_string()))?;
    describe_file(&mut parts.headers, &wanted);
    let file = move || {
        let _held = held;
        let answer =
            serde_json::from_slice(&bytes).map_err(|error| ServiceError::Internal(error.to_string()))?;
        drop(bytes);
        let table = Columns::of(&answer, &wanted.table);
        let file = table.and_then(|table| table.write(wanted.format, wanted.column.as_deref()));
        file.map_err(|error| match error {
            ColumnsError::Sparse { .. } => ServiceError::parameter("format", error.to_string()),
            ColumnsError::Table { .. } => ServiceError::parameter("table", error.to_string()),
            ColumnsError::Column { .. } => ServiceError::parameter("column", error.to_string()),
            ColumnsError::Unwritten(error) => ServiceError::Internal(error),
        })
    };
    let work = Work::from_seconds(SECONDS * size as f64);
    let file = app.pool.weighing(work).run(file).await?;
    Ok(Response::from_parts(parts, Body::from(file)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_choose_between_tables_and_answers() {
        let chosen = |accept: &str| preferred(accept, table_or_other);
        assert_eq!(chosen("text/csv, */*;q=0.1"), Some(Some(ColumnsFormat::Csv)));
        assert_eq!(chosen("application/vnd.apache.parquet"), Some(Some(ColumnsFormat::Parquet)));
        assert_eq!(chosen("image/png, text/csv;q=0.5"), Some(None));
        assert_eq!(chosen("*/*"), Some(None));
        assert_eq!(chosen("audio/ogg"), None);
    }
}
