//! Corrections of stored shapes: attributes changed, shapes deleted by a filter, all shapes of a subject erased.

use std::collections::BTreeMap;

use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::api::extract::{Caller, IfMatch, JsonBody, NoQuery, Path, Query};
use crate::api::problem::Problem;
use crate::api::respond::json;
use crate::api::v1::cohorts::shapes::StoredShape;
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::entity_tags::{not_stored, tagged};
use crate::api::v1::requests::shape_query::Parameters;
use crate::domain::job::JobKind;
use crate::service::cohorts::catalogue::revision_tag;
use crate::service::cohorts::corrections::{self, Deletion, Erased};
use crate::store::{Deleted, SubjectCohort, SubjectDictionary, SubjectJob};

/// Changes to a shape: absent fields keep their values, null removes, and the members of `labels` and `metadata` are changed one
/// by one (merge patch, RFC 7396).
#[derive(Debug, utoipa::ToSchema)]
#[allow(dead_code, reason = "only for the document; the service reads the patch")]
#[schema(example = json!({"label": "control", "labels": {"site": "zrh", "reader": null}}))]
pub(in crate::api::v1) struct ShapePatch {
    /// New class label; null to remove it.
    label: Option<String>,
    /// Changes to the attributes; null removes one, or all.
    #[schema(value_type = Option<Attributes>)]
    labels: Option<BTreeMap<String, Value>>,
    /// New subject; null to remove it.
    subject: Option<String>,
    /// Changes to the metadata; null removes a member, or all.
    #[schema(value_type = serde_json::Value, required = false)]
    metadata: Option<Value>,
    /// New weight; null for 1.
    #[schema(minimum = 1e-100, maximum = 1e100)]
    weight: Option<f64>,
}

/// Changes label, labels, subject, metadata or weight of a shape.
///
/// The body is a merge patch (RFC 7396), sent as `application/merge-patch+json` or `application/json`. Points and identifiers
/// stay. The shape is stored again as the next revision of the cohort, at the end of its order; earlier revisions keep it as it
/// was. A patch that changes nothing makes no revision. The ETag is that of the cohort.
#[utoipa::path(patch, path = "/v1/cohorts/{cohort}/shapes/{shape}", tag = "cohorts", request_body = ShapePatch,
    params(
        ("cohort" = String, Path, description = "Id or name"),
        ("shape" = String, Path, description = "Id or external id"),
        IfMatchHeader
    ),
    responses(
        (status = 200, description = "The shape after the change", body = StoredShape),
        (status = 404, description = "No such cohort or shape"),
        (status = 412, description = "The cohort has changed meanwhile")
    ))]
pub(in crate::api::v1) async fn update_shape(
    Caller(app): Caller,
    _: NoQuery,
    Path((key, shape)): Path<(String, String)>,
    IfMatch(expected): IfMatch,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let patch = app.read(body).await?;
    let (cohort, shape) = corrections::correct(&app, &key, &shape, patch, expected).await?;
    let tag = revision_tag(&cohort);
    Ok(not_stored(tagged(json(StatusCode::OK, &StoredShape::new(&cohort, shape))?, &tag)))
}

/// Result of deleting shapes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct DeletedAnswer {
    /// Number of shapes that were deleted, or would be.
    deleted: u64,
    /// Revision of the cohort after the request; absent for a dry run.
    #[serde(skip_serializing_if = "Option::is_none")]
    revision: Option<u64>,
    /// Present and true if nothing was deleted because only the number was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    dry_run: Option<bool>,
}

/// Deletes all shapes that pass a filter, as one revision of the cohort.
///
/// Earlier revisions keep them.
#[utoipa::path(delete, path = "/v1/cohorts/{cohort}/shapes", tag = "cohorts",
    params(
        ("cohort" = String, Path, description = "Id or name"),
        FilterQuery,
        ("all" = Option<bool>, Query, description = "Whether all shapes are deleted, in place of a filter. Default: false"),
        ("dry_run" = Option<bool>, Query, description = "Whether the shapes are only counted. Default: false"),
        IfMatchHeader
    ),
    responses(
        (status = 200, description = "Number of shapes deleted", body = DeletedAnswer),
        (status = 404, description = "No such cohort"),
        (status = 412, description = "The cohort has changed meanwhile"),
        (status = "4XX", description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn delete_shapes(
    Caller(app): Caller,
    Path(key): Path<String>,
    Query(pairs): Query<Vec<(String, String)>>,
    IfMatch(expected): IfMatch,
) -> Result<Response, Problem> {
    let mut parameters = Parameters::read(pairs)?;
    let (all, dry_run) = (parameters.take_flag("all")?, parameters.take_flag("dry_run")?);
    let filter = parameters.take_filter();
    parameters.refuse_rest()?;
    let deletion = Deletion { filter, all, dry_run };
    let Deleted { shapes, revision } = corrections::delete(&app, &key, deletion, expected).await?;
    let answer = DeletedAnswer {
        deleted: shapes,
        revision: (!dry_run).then_some(revision),
        dry_run: dry_run.then_some(true),
    };
    Ok(json(StatusCode::OK, &answer)?)
}

/// Whether an erasure is only tried.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(in crate::api::v1) struct EraseQuery {
    /// Whether nothing is erased, and the answer names everything that would be. Default: false.
    #[serde(default)]
    dry_run: bool,
}

/// Shapes of a subject that were erased, or would be, and everything that depends on them.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct ErasureAnswer {
    /// Number of shapes, those included that were deleted before.
    #[serde(rename = "shape_count")]
    shapes: u64,
    /// Cohorts that had some of them, those in the trash included.
    cohorts: Vec<ErasedCohort>,
    /// Versions of dictionaries that were learnt from some of them, those in the trash included. They are not changed.
    dictionaries: Vec<AffectedDictionary>,
    /// Jobs on these cohorts that were removed or begun again.
    jobs: Vec<AffectedJob>,
    /// Whether the files of the store hold nothing of the shapes any more either; absent for a dry run.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(required = false)]
    files: Option<FilesState>,
    /// Present and true if nothing was erased.
    #[serde(skip_serializing_if = "Option::is_none")]
    dry_run: Option<bool>,
}

/// State of the files of the store after an erasure.
#[derive(Debug, Clone, Copy, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(in crate::api::v1) enum FilesState {
    /// They are written anew, and hold nothing of the shapes.
    Done,
    /// Parts that the database does not use may hold copies of attributes until the files are written anew; a repeated request tells.
    Pending,
}

/// A cohort from which shapes were erased.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct ErasedCohort {
    /// Id of the cohort.
    id: String,
    /// Its name.
    name: String,
    /// Its revision after that.
    revision: u64,
    /// Number of shapes erased.
    #[serde(rename = "shape_count")]
    shapes: u64,
    /// Whether it is in the trash.
    trashed: bool,
}

/// A version of a dictionary that was learnt from erased shapes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct AffectedDictionary {
    /// Id of the version.
    id: String,
    /// Name of the dictionary.
    name: String,
    /// Version number.
    version: u64,
    /// BLAKE3 digest of its content.
    digest: String,
    /// Id of the cohort that it was learnt from.
    cohort: String,
    /// Whether it is in the trash.
    trashed: bool,
}

/// A job that may have named erased shapes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct AffectedJob {
    /// Id of the job.
    id: String,
    /// Kind of work.
    kind: JobKind,
    /// Effect of the erasure on the job.
    outcome: JobOutcome,
}

/// Effect of an erasure on a job.
#[derive(Debug, Clone, Copy, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(in crate::api::v1) enum JobOutcome {
    /// It is removed, with its result and its output.
    Removed,
    /// It was running, and begins again without the erased shapes.
    Restarted,
}

impl ErasureAnswer {
    fn new(Erased { cohorts, is_done }: Erased) -> Self {
        let files = is_done.map(|is_done| if is_done { FilesState::Done } else { FilesState::Pending });
        let mut answer = Self {
            shapes: cohorts.iter().map(|cohort| cohort.shapes).sum(),
            cohorts: Vec::new(),
            dictionaries: Vec::new(),
            jobs: Vec::new(),
            files,
            dry_run: is_done.is_none().then_some(true),
        };
        for cohort in cohorts {
            let SubjectCohort { id, name, revision, shapes, trashed, dictionaries, jobs, .. } = cohort;
            let dictionaries = dictionaries.into_iter().map(|version| AffectedDictionary::new(version, &id));
            answer.dictionaries.extend(dictionaries);
            answer.jobs.extend(jobs.into_iter().map(AffectedJob::from));
            answer.cohorts.push(ErasedCohort { id, name, revision, shapes, trashed });
        }
        answer
    }
}

impl AffectedDictionary {
    fn new(version: SubjectDictionary, cohort: &str) -> Self {
        let SubjectDictionary { id, name, version, digest, trashed } = version;
        Self { id, name, version, digest, cohort: cohort.into(), trashed }
    }
}

impl From<SubjectJob> for AffectedJob {
    fn from(SubjectJob { id, kind, removed }: SubjectJob) -> Self {
        Self { id, kind, outcome: if removed { JobOutcome::Removed } else { JobOutcome::Restarted } }
    }
}

/// Erases all shapes of a subject, in all cohorts of the tenant and at all revisions. This cannot be undone.
///
/// Attributes are emptied and control points overwritten in the store, also of shapes that were deleted or corrected before and
/// of cohorts in the trash. Jobs on these cohorts that have ended since the first of the shapes was stored are removed, because
/// their results may name shapes. Dictionaries that were learnt from the shapes are named and not changed. A subject that has no
/// shapes and was never erased is not found; a repetition erases the shapes that have arrived since. The files of the
/// store are then written anew (`files`), if that takes some seconds.
#[utoipa::path(delete, path = "/v1/subjects/{subject}", tag = "cohorts",
    params(("subject" = String, Path, description = "The subject, percent-encoded"), EraseQuery),
    responses(
        (status = 200, description = "Result of the erasure", body = ErasureAnswer),
        (status = 404, description = "No such subject"),
        (status = "4XX", description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn erase_subject(
    Caller(app): Caller,
    Path(subject): Path<String>,
    Query(EraseQuery { dry_run }): Query<EraseQuery>,
) -> Result<Response, Problem> {
    let erased = corrections::erase(&app, &subject, dry_run).await?;
    Ok(json(StatusCode::OK, &ErasureAnswer::new(erased))?)
}
