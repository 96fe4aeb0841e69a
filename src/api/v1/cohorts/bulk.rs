//! Corrections of many shapes: the same changes of all that a filter or a list names, or a table of attributes by id.

use axum::body::Bytes;
use axum::extract::Request;
use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};

use crate::api::body;
use crate::api::extract::{Caller, IfMatch, JsonBody, Path, Query};
use crate::api::media_type::{is_json, media_type};
use crate::api::problem::{Problem, ProblemKind};
use crate::api::respond::json;
#[cfg(feature = "schema")]
use crate::api::v1::cohorts::corrections::ShapePatch;
use crate::api::v1::requests::batches::{FailedShape, InputShape};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::shape_query::take_filter;
use crate::domain::filter::ShapeFilter;
use crate::service::app::memory::Purpose;
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::bulk::{self, Bulk, Corrected, Edit, Edits, Failed};
use crate::service::shapes::outcome::OnError;
use crate::wire::checked::{Checked, List, document, take_or_default};
use crate::wire::fault::Fault;
use crate::wire::files::{AttributeRow, attribute_rows};
use crate::wire::json as values;
use crate::wire::merge_patch::{MergePatch, PatchText};

/// Bytes of memory for a field of a table of attributes.
const FIELD_BYTES: usize = 192;
/// Predicted time of reading a byte of a table.
const SECONDS: f64 = 2e-8;

document! {
    /// The same changes of several shapes: `changes`, and one of `filter`, `ids` and `all`.
    #[schema(example = json!({"ids": ["scan-17", "scan-18"], "changes": {"label": "treated", "labels": {"dose": 3}}}))]
    pub(in crate::api::v1) struct ShapesPatch {
        /// Filter that the shapes pass.
        #[schema(value_type = Option<ShapeFilter>)]
        filter: Checked<ShapeFilter>;
        /// Ids or external ids of the shapes.
        #[schema(value_type = Option<Vec<String>>)]
        ids: List<Checked<String>>;
        /// Whether all shapes of the cohort are changed. Default: false.
        #[schema(value_type = Option<bool>)]
        all: Checked<bool>;
        /// Changes: absent fields keep their values, null removes.
        #[schema(value_type = ShapePatch, required = true)]
        changes: MergePatch, required;
    }
}

document! {
    /// Attributes of shapes by their ids.
    #[schema(example = json!({"shapes": [{"external_id": "scan-17", "subject": "p-17", "label": "treated", "labels": {"dose": 3}}]}))]
    pub(in crate::api::v1) struct AttributesRequest {
        /// For each shape its `id` or `external_id`, and its changes: `subject`, `label`, `labels`, `weight`, `metadata`.
        #[schema(value_type = Vec<std::collections::BTreeMap<String, serde_json::Value>>, required = true)]
        shapes: List<EditInput>, required;
    }
}

/// An entry of a list of attributes: the id that it names, if it is one text, and its changes.
#[derive(Debug, Clone)]
pub(in crate::api::v1) struct EditInput {
    key: Option<String>,
    patch: PatchText,
}

impl<'de> Deserialize<'de> for EditInput {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut patch = MergePatch::deserialize(deserializer)?;
        let names = ["id", "external_id"].map(|name| patch.members.remove(name));
        let key = match names {
            [Some(Value::String(key)), None] | [None, Some(Value::String(key))] => Some(key),
            _ => None,
        };
        Ok(Self { key, patch: patch.into() })
    }
}

/// How many edits are made.
#[derive(Debug, Default, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields, default)]
pub(in crate::api::v1) struct BulkQuery {
    /// Whether nothing is stored, and the answer counts the shapes that would change. Default: false.
    #[param(required = false)]
    dry_run: bool,
    /// Handling of shapes that do not exist and of changes that are not valid: `abort` changes nothing, `skip` makes the others.
    /// Default: `abort`.
    #[param(inline, required = false)]
    on_error: OnError,
}

/// Result of many edits.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct BulkAnswer {
    /// Number of shapes that were changed, or would be.
    updated: usize,
    /// Number of shapes that are as the changes ask for already.
    unchanged: usize,
    /// Number of edits that were not made, under `on_error=skip`.
    skipped: usize,
    /// An entry for each of them, in order.
    results: Vec<FailedShape>,
    /// Revision of the cohort after the request; absent for a dry run.
    #[serde(skip_serializing_if = "Option::is_none")]
    revision: Option<u64>,
    /// Present and true if nothing was stored because only the numbers were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    dry_run: Option<bool>,
}

impl BulkAnswer {
    fn new(corrected: Corrected, dry_run: bool) -> Self {
        let Corrected { updated, unchanged, failed, revision } = corrected;
        let entry = |Failed { index, key, faults }: Failed| FailedShape {
            shape: InputShape { index, id: None, external_id: Some(key) },
            error: ServiceError::Invalid(faults.into()).into(),
        };
        Self {
            updated,
            unchanged,
            skipped: failed.len(),
            results: failed.into_iter().map(entry).collect(),
            revision: (!dry_run).then_some(revision),
            dry_run: dry_run.then_some(true),
        }
    }
}

/// Changes label, labels, subject, metadata or weight of several shapes in the same way.
///
/// The shapes are those that pass a filter, those of a list of ids, or all. They become one revision of the cohort, and one entry
/// `shapes_updated` of the change feed; earlier revisions keep them as they were. Changes that change nothing make no revision.
#[utoipa::path(patch, path = "/v1/cohorts/{cohort}/shapes", tag = "cohorts", request_body = ShapesPatch,
    params(("cohort" = String, Path, description = "Id or name"), BulkQuery, IfMatchHeader),
    responses(
        (status = 200, description = "Result of the edits", body = BulkAnswer),
        (status = 404, description = "No such cohort"),
        (status = 412, description = "The cohort has changed meanwhile"),
        (status = "4XX", description = "The input was refused")
    ))]
pub(in crate::api::v1) async fn update_shapes(
    Caller(app): Caller,
    Path(key): Path<String>,
    Query(BulkQuery { dry_run, on_error }): Query<BulkQuery>,
    IfMatch(expected): IfMatch,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let request: ShapesPatch = app.read(body).await?;
    let bulk = Bulk { edits: request.edits()?, on_error, dry_run };
    let corrected = bulk::correct_all(&app, &key, bulk, expected).await?;
    Ok(json(StatusCode::OK, &BulkAnswer::new(corrected, dry_run))?)
}

/// Sets attributes of shapes by their ids, from a table (`text/csv`) or a list (`application/json`).
///
/// The first row of a table names its columns: `id` or `external_id`, and perhaps `subject`, `label` and `weight`; every other column is a
/// further attribute. Empty fields and `NA` change nothing. In a list, each entry is a merge patch with an `id` or `external_id`, and null
/// removes. All shapes become one revision of the cohort, and one entry `shapes_updated` of the change feed.
#[utoipa::path(post, path = "/v1/cohorts/{cohort}/attributes", tag = "cohorts",
    params(("cohort" = String, Path, description = "Id or name"), BulkQuery, IfMatchHeader),
    request_body(content((AttributesRequest = "application/json"), (String = "text/csv", example = json!("external_id,subject,label,dose\nscan-17,p-17,treated,3\n")))),
    responses(
        (status = 200, description = "Result of the edits", body = BulkAnswer),
        (status = 404, description = "No such cohort"),
        (status = 412, description = "The cohort has changed meanwhile"),
        (status = "4XX", description = "The input was refused")
    ))]
pub(in crate::api::v1) async fn set_attributes(
    Caller(app): Caller,
    Path(key): Path<String>,
    Query(BulkQuery { dry_run, on_error }): Query<BulkQuery>,
    IfMatch(expected): IfMatch,
    request: Request,
) -> Result<Response, Problem> {
    let found = media_type(request.headers());
    let is_table = found == "text/csv" || found == "text/tab-separated-values";
    if !is_table && !is_json(&found) {
        let detail = format!("expected text/csv or application/json, got '{found}'");
        return Err(Problem::new(ProblemKind::UnsupportedMediaType, detail));
    }
    let body = body::read(&app, request.into_body()).await?;
    let edits = if is_table { table(&app, body).await? } else { listed(&app, body).await? };
    let bulk = Bulk { edits: Edits::Each(edits), on_error, dry_run };
    let corrected = bulk::correct_all(&app, &key, bulk, expected).await?;
    Ok(json(StatusCode::OK, &BulkAnswer::new(corrected, dry_run))?)
}

impl ShapesPatch {
    fn edits(self) -> Result<Edits, ServiceError> {
        let mut errors = self.faults;
        let filter = self.filter.and_then(|filter| take_filter(Some(filter), "/filter", &mut errors));
        let all = take_or_default(self.all, "/all", &mut errors).unwrap_or_default();
        let ids = self.ids.map(|ids| {
            let ids = ids.take("/ids", &mut errors).into_iter().enumerate();
            ids.filter_map(|(k, id)| id.take(&format!("/ids/{k}"), &mut errors)).collect::<Vec<_>>()
        });
        let changes = self.changes.unwrap_or_default();
        let edits = match (filter, ids, all) {
            (Some(filter), None, false) if filter != ShapeFilter::default() => {
                Edits::Filter(Box::new(filter), changes)
            }
            (None, Some(ids), false) => Edits::Ids(ids, changes),
            (None, None, true) => Edits::Filter(Box::default(), changes),
            _ => {
                let detail = "expected one of a filter with conditions, ids and all=true";
                errors.push(Fault::new("", detail));
                return Err(ServiceError::Invalid(errors.into()));
            }
        };
        ServiceError::unless_empty(errors)?;
        Ok(edits)
    }
}

/// The edits of a table.
async fn table(app: &App, body: Bytes) -> Result<Vec<Edit>, ServiceError> {
    let fields = body.iter().filter(|byte| matches!(byte, b',' | b';' | b'\t' | b'\n')).count() + 1;
    let _room = app.memory.hold(Purpose::Bodies, fields.saturating_mul(FIELD_BYTES))?;
    let work = Work::from_seconds(body.len() as f64 * SECONDS);
    let most = app.limits.shapes;
    let read = move || {
        let rows = attribute_rows(&body)?;
        if rows.len() > most {
            return Err(ServiceError::invalid(
                "",
                format!("expected at most {most} rows, got {}", rows.len()),
            ));
        }
        Ok(rows.into_iter().map(edit_of).collect())
    };
    app.pool.weighing(work).run(read).await
}

fn edit_of(row: AttributeRow) -> Edit {
    let AttributeRow { line, name, subject, label, weight, labels } = row;
    let mut members = Map::new();
    members.extend(subject.map(|subject| ("subject".to_owned(), Value::from(subject))));
    members.extend(label.map(|label| ("label".to_owned(), Value::from(label))));
    members.extend(weight.map(|weight| ("weight".to_owned(), Value::from(weight))));
    if !labels.is_empty() {
        members.insert("labels".into(), values::to_value(&labels).unwrap_or_default());
    }
    Edit { key: name, patch: MergePatch { members, faults: Vec::new() }.into(), line: Some(line) }
}

/// The edits of a list.
async fn listed(app: &App, body: Bytes) -> Result<Vec<Edit>, ServiceError> {
    let AttributesRequest { shapes, faults: mut errors } = app.read(body).await?;
    let shapes = shapes.unwrap_or_default().take("/shapes", &mut errors);
    let mut edits = Vec::with_capacity(shapes.len());
    for (k, EditInput { key, patch }) in shapes.into_iter().enumerate() {
        match key {
            Some(key) => edits.push(Edit { key, patch, line: None }),
            None => {
                let detail = "expected an id or an external_id, a text, got none, both or another value";
                errors.push(Fault::new(format!("/shapes/{k}"), detail));
            }
        }
    }
    ServiceError::unless_empty(errors)?;
    Ok(edits)
}
