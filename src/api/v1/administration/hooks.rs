//! Hooks for administrators: addresses to which changes are delivered.

use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use crate::api::extract::{Caller, JsonBody, NoQuery, Path, Query};
use crate::api::problem::Problem;
use crate::api::respond::json;
use crate::api::v1::requests::request_macros::{PageQuery, page};
use crate::domain::change::{ChangeFilter, ChangeKind};
use crate::domain::hook::{Hook, HookFailure, HookStatus};
use crate::service::app::ServiceError;
use crate::service::hooks::{self, NewHook};
use crate::wire::checked::{Checked, document, take_given};
use crate::wire::time::rfc3339;

document! {
    /// A hook to create.
    #[schema(example = json!({"url": "https://pipeline.example/shapes", "kinds": ["shapes_added", "job_succeeded"]}))]
    pub(in crate::api::v1) struct HookRequest {
        /// Address that receives the deliveries: `https`, with a public host.
        #[schema(value_type = String, required = true)]
        url: Checked<String>, required;
        /// Purpose, at most 200 characters.
        #[schema(value_type = Option<String>)]
        description: Checked<Option<String>>;
        /// Kinds of changes to deliver. Default: all.
        #[schema(value_type = Option<Vec<ChangeKind>>, min_items = 1)]
        kinds: Checked<Option<Vec<ChangeKind>>>;
        /// Id or name of the only cohort whose changes are delivered. Default: all cohorts.
        #[schema(value_type = Option<String>)]
        cohort: Checked<Option<String>>;
    }
}

document! {
    /// Where a hook continues.
    #[schema(example = json!({"since": 0}))]
    pub(in crate::api::v1) struct RedeliverRequest {
        /// Number of the change after which deliveries continue.
        #[schema(value_type = u64, required = true)]
        since: Checked<u64>, required;
    }
}

/// A hook, without its secret.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct HookOutput {
    /// Identifier.
    #[schema(example = "hok_0198c0ffee00700080000000000000aa")]
    id: String,
    /// Address that receives the deliveries.
    url: String,
    /// Purpose.
    description: String,
    /// Kinds of changes that are delivered; null for all.
    kinds: Option<Vec<ChangeKind>>,
    /// Id of the only cohort whose changes are delivered; null for all.
    cohort: Option<String>,
    /// Status of the hook.
    status: HookStatus,
    /// Why deliveries were given up; null unless the status is `failed`.
    reason: Option<String>,
    /// Number of the last change that was delivered or needed no delivery.
    position: u64,
    /// Number of failed attempts at the next delivery.
    attempts: u32,
    /// Time of the first of these attempts, RFC 3339 in UTC.
    failing_since: Option<String>,
    /// Earliest time of the next attempt, RFC 3339 in UTC; null if the last delivery did not fail.
    next_attempt_at: Option<String>,
    /// Time of the last delivery, RFC 3339 in UTC.
    delivered_at: Option<String>,
    /// Time of creation, RFC 3339 in UTC.
    created_at: String,
}

page! {
    /// One page of hooks.
    PageOfHooks of HookOutput
}

impl From<Hook> for HookOutput {
    fn from(hook: Hook) -> Self {
        let is_waiting = hook.attempts > 0 && hook.status == HookStatus::Active;
        Self {
            id: hook.id,
            url: hook.url,
            description: hook.description,
            kinds: hook.filter.kinds,
            cohort: hook.filter.cohort,
            status: hook.status,
            reason: hook.reason,
            position: hook.position,
            attempts: hook.attempts,
            failing_since: hook.failing_since_ms.map(rfc3339),
            next_attempt_at: is_waiting.then(|| rfc3339(hook.due_ms)),
            delivered_at: hook.delivered_at_ms.map(rfc3339),
            created_at: rfc3339(hook.created_at_ms),
        }
    }
}

/// A new hook, with its secret.
#[derive(Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct CreatedHook {
    #[serde(flatten)]
    hook: HookOutput,
    /// Secret that signs the deliveries. It is shown only once.
    #[schema(example = "whsec_<44 characters of base64>")]
    secret: String,
}

/// A failed attempt at a delivery.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct HookFailureOutput {
    /// Time of the attempt, RFC 3339 in UTC.
    at: String,
    /// Number of the change.
    sequence: u64,
    /// Number of the attempt, from 1.
    attempt: u32,
    /// Status code of the answer; null if there was none.
    status: Option<u16>,
    /// Reason of the failure.
    #[schema(example = "expected a status of 2xx, got 503")]
    detail: String,
}

/// Failed attempts at the deliveries of a hook.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct HookFailures {
    /// The newest 100, the newest first.
    items: Vec<HookFailureOutput>,
}

impl From<HookFailure> for HookFailureOutput {
    fn from(HookFailure { at_ms, sequence, attempt, status, detail }: HookFailure) -> Self {
        Self { at: rfc3339(at_ms), sequence, attempt, status, detail }
    }
}

/// Creates a hook: an address to which the changes of the tenant are delivered from now on.
///
/// Every change is delivered at least once and in order, as a POST of JSON signed with the secret in the form of the Standard
/// Webhooks specification (`webhook-id`, `webhook-timestamp`, `webhook-signature`). Any answer of 2xx within ten seconds
/// confirms it; otherwise the same delivery is repeated after a second, then ever more rarely, for three days. This response
/// is the only place where the secret appears.
#[utoipa::path(post, path = "/v1/hooks", tag = "changes", request_body = HookRequest,
    responses(
        (status = 201, description = "Created", body = CreatedHook, headers(("Location" = String))),
        (status = 404, description = "No such cohort")
    ))]
pub(in crate::api::v1) async fn create_hook(
    Caller(app): Caller,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let hook = hooks::create(&app, new_hook(app.parse(&body)?)?).await?;
    let location = format!("/v1/hooks/{}", hook.id);
    let secret = hook.secret.reveal();
    let response = json(StatusCode::CREATED, &CreatedHook { hook: hook.into(), secret })?;
    let headers = [(header::LOCATION, location), (header::CACHE_CONTROL, "no-store".into())];
    Ok((headers, response).into_response())
}

fn new_hook(request: HookRequest) -> Result<NewHook, ServiceError> {
    let mut errors = request.faults;
    let url = take_given(request.url, "/url", &mut errors);
    let description = take_given(request.description, "/description", &mut errors).flatten();
    let kinds = take_given(request.kinds, "/kinds", &mut errors).flatten();
    let cohort = take_given(request.cohort, "/cohort", &mut errors).flatten();
    match url {
        Some(url) if errors.is_empty() => {
            let filter = ChangeFilter { kinds, cohort };
            Ok(NewHook { url, description: description.unwrap_or_default(), filter })
        }
        _ => Err(ServiceError::Invalid(errors.into())),
    }
}

/// Lists the hooks of the caller's tenant in order of creation.
#[utoipa::path(get, path = "/v1/hooks", tag = "changes", params(PageQuery),
    responses(
        (status = 200, description = "A page of hooks", body = PageOfHooks),
        (status = 400, description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn list_hooks(
    Caller(app): Caller,
    Query(page): Query<PageQuery>,
) -> Result<Response, Problem> {
    let (items, next) = hooks::list(&app, page.cursor.as_deref(), page.limit()?).await?;
    let items: Vec<HookOutput> = items.into_iter().map(Into::into).collect();
    Ok(json(StatusCode::OK, &PageOfHooks { items, next })?)
}

/// Returns a hook.
#[utoipa::path(get, path = "/v1/hooks/{hook}", tag = "changes", params(("hook" = String, Path, description = "Id")),
    responses(
        (status = 200, description = "The hook", body = HookOutput),
        (status = 404, description = "No such hook")
    ))]
pub(in crate::api::v1) async fn find_hook(
    Caller(app): Caller,
    _: NoQuery,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    answer(hooks::find(&app, &id).await?)
}

fn answer(hook: Hook) -> Result<Response, Problem> {
    Ok(json(StatusCode::OK, &HookOutput::from(hook))?)
}

/// Deletes a hook.
#[utoipa::path(delete, path = "/v1/hooks/{hook}", tag = "changes", params(("hook" = String, Path, description = "Id")),
    responses(
        (status = 204, description = "Deleted"),
        (status = 404, description = "No such hook")
    ))]
pub(in crate::api::v1) async fn delete_hook(
    Caller(app): Caller,
    _: NoQuery,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    hooks::delete(&app, &id).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Pauses a hook.
///
/// It keeps its position in the change feed. A hook that stays paused until the changes after it are no longer kept fails when
/// it is resumed.
#[utoipa::path(post, path = "/v1/hooks/{hook}/pause", tag = "changes",
    params(("hook" = String, Path, description = "Id")),
    responses(
        (status = 200, description = "The paused hook", body = HookOutput),
        (status = 404, description = "No such hook")
    ))]
pub(in crate::api::v1) async fn pause_hook(
    Caller(app): Caller,
    _: NoQuery,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    answer(hooks::pause(&app, &id).await?)
}

/// Resumes a paused or failed hook at its position, with the next attempt at once.
#[utoipa::path(post, path = "/v1/hooks/{hook}/resume", tag = "changes",
    params(("hook" = String, Path, description = "Id")),
    responses(
        (status = 200, description = "The resumed hook", body = HookOutput),
        (status = 404, description = "No such hook")
    ))]
pub(in crate::api::v1) async fn resume_hook(
    Caller(app): Caller,
    _: NoQuery,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    answer(hooks::resume(&app, &id).await?)
}

/// Delivers again all changes after a number, and resumes the hook.
///
/// Deliveries keep their `webhook-id`. A number beyond the position of the hook skips changes, such as one that the receiver
/// can never accept.
#[utoipa::path(post, path = "/v1/hooks/{hook}/redeliver", tag = "changes", request_body = RedeliverRequest,
    params(("hook" = String, Path, description = "Id")),
    responses(
        (status = 200, description = "The hook", body = HookOutput),
        (status = 404, description = "No such hook"),
        (status = 410, description = "Changes that old are no longer available")
    ))]
pub(in crate::api::v1) async fn redeliver_hook(
    Caller(app): Caller,
    _: NoQuery,
    Path(id): Path<String>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let request: RedeliverRequest = app.parse(&body)?;
    let mut errors = request.faults;
    let since = take_given(request.since, "/since", &mut errors);
    match since {
        Some(since) if errors.is_empty() => answer(hooks::redeliver(&app, &id, since).await?),
        _ => Err(ServiceError::Invalid(errors.into()).into()),
    }
}

/// Lists failed attempts at the deliveries of a hook, the newest first.
#[utoipa::path(get, path = "/v1/hooks/{hook}/failures", tag = "changes",
    params(("hook" = String, Path, description = "Id")),
    responses(
        (status = 200, description = "The failed attempts", body = HookFailures),
        (status = 404, description = "No such hook")
    ))]
pub(in crate::api::v1) async fn list_hook_failures(
    Caller(app): Caller,
    _: NoQuery,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    let items = hooks::failures(&app, &id).await?.into_iter().map(Into::into).collect();
    Ok(json(StatusCode::OK, &HookFailures { items })?)
}
