//! Audit trail, for administrators: list, export and prune.

use std::collections::BTreeMap;

use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures_util::stream::{self, Stream};
use serde::{Deserialize, Serialize};

use crate::api::extract::{Caller, PrefersLines, Query};
use crate::api::problem::Problem;
use crate::api::respond::{json, streamed};
use crate::api::v1::requests::request_macros::{PageQuery, milliseconds, page};
use crate::domain::audit::{AuditFilter, Recorded};
use crate::service::app::{App, ServiceError};
use crate::service::audit::trail;
use crate::wire::time::rfc3339;

/// Number of entries that an export reads at a time.
const PIECE: usize = 1000;

/// Entry of the audit trail.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct AuditEntry {
    /// Position in the tenant's audit trail, from 1 without gaps.
    #[schema(example = 17)]
    sequence: u64,
    /// Time at which the request was answered, RFC 3339 in UTC.
    at: String,
    /// Name of the tenant.
    tenant: String,
    /// Id of the key; `oidc` for a bearer token of the identity provider, `local` without access control, null for an
    /// unauthenticated request.
    key: Option<String>,
    /// Subject of the bearer token.
    subject: Option<String>,
    /// Operation id in this document; null if the request matched no operation.
    #[schema(example = "find_cohort")]
    operation: Option<String>,
    /// HTTP method.
    #[schema(example = "GET")]
    method: String,
    /// Path template of the route; null if none matched.
    #[schema(example = "/v1/cohorts/{cohort}")]
    route: Option<String>,
    /// Objects named in the path, as the caller named them, the ids of the cohorts, dictionaries and shapes used
    /// (`cohort_id`, `dictionary_id`, `shape_id`), and the id of the object `created`.
    #[schema(example = json!({"cohort": "cells", "cohort_id": "coh_0198c0ffee00700080000000000000aa"}))]
    objects: BTreeMap<String, String>,
    /// Status code of the response; null if the client disconnected before it was sent.
    #[schema(example = 200)]
    status: Option<u16>,
    /// Request id, as in the log.
    request_id: String,
    /// Address of the client.
    remote: Option<String>,
    /// BLAKE3 digest, in hexadecimal, of the previous entry's digest and this entry.
    digest: String,
}

page! {
    /// One page of the audit trail.
    PageOfAuditEntries of AuditEntry
}

impl From<Recorded> for AuditEntry {
    fn from(recorded: Recorded) -> Self {
        let Recorded { sequence, entry, digest } = recorded;
        Self {
            sequence,
            at: rfc3339(entry.at_ms),
            tenant: entry.tenant,
            key: entry.key,
            subject: entry.subject,
            operation: entry.operation,
            method: entry.method,
            route: entry.route,
            objects: entry.objects,
            status: entry.status,
            request_id: entry.request_id,
            remote: entry.remote,
            digest: blake3::Hash::from_bytes(digest).to_hex().to_string(),
        }
    }
}

/// Format of the entries.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
enum AuditFormat {
    /// One page.
    #[default]
    Json,
    /// All matching entries, one per line.
    Ndjson,
}

/// Filter and page of the audit trail.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(in crate::api::v1) struct AuditQuery {
    /// Entries at or after this time, RFC 3339.
    since: Option<String>,
    /// Entries before this time, RFC 3339.
    until: Option<String>,
    /// Entries of this key only.
    key: Option<String>,
    /// Entries of this operation only, by operation id.
    operation: Option<String>,
    /// Entries of requests that used or created this object, given by id or as named in the path.
    object: Option<String>,
    /// Entries with this status code only.
    status: Option<u16>,
    /// Cursor from the previous page; an export starts after it.
    cursor: Option<String>,
    /// Entries per page, 1 to 1000. Default: 100. An export contains all entries.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<usize>,
    /// Response format: `json` for one page, `ndjson` for all entries, one per line. Default: as the `Accept` header prefers.
    #[param(inline)]
    format: Option<AuditFormat>,
}

impl AuditQuery {
    fn filter(&self) -> Result<AuditFilter, Problem> {
        Ok(AuditFilter {
            since_ms: self.since.as_deref().map(|text| milliseconds("since", text)).transpose()?,
            until_ms: self.until.as_deref().map(|text| milliseconds("until", text)).transpose()?,
            key: self.key.clone(),
            operation: self.operation.clone(),
            object: self.object.clone(),
            status: self.status,
        })
    }
}

/// Lists the audit trail: requests with their callers and outcomes.
///
/// Contains every request of the tenant under `/v1` in the order in which they were answered, including reads and refused
/// requests. Entries are chained by their digests and never change. They are only removed from the beginning, by age or by
/// an administrator.
#[utoipa::path(get, path = "/v1/audit", tag = "operation", params(AuditQuery),
    responses(
        (status = 200, description = "A page of entries, or all entries as one line each", content((PageOfAuditEntries = "application/json"), (String = "application/x-ndjson"))),
        (status = 400, description = "The query was refused"),
        (status = 406, description = "None of the media types is accepted"),
        (status = 503, description = "The store cannot be read")
    ))]
pub(in crate::api::v1) async fn list_audit(
    Caller(app): Caller,
    Query(query): Query<AuditQuery>,
    prefers: Result<PrefersLines, Problem>,
) -> Result<Response, Problem> {
    let is_lines = match query.format {
        Some(format) => format == AuditFormat::Ndjson,
        None => prefers?.0,
    };
    let filter = query.filter()?;
    let page = PageQuery { cursor: query.cursor, limit: query.limit };
    let limit = page.limit()?;
    if is_lines {
        let after = trail::place(page.cursor.as_deref())?;
        let body = streamed(lines(app, filter, after));
        return Ok(([(header::CONTENT_TYPE, "application/x-ndjson")], body).into_response());
    }
    let (items, next) = trail::list(&app, &filter, page.cursor.as_deref(), limit).await?;
    let items: Vec<AuditEntry> = items.into_iter().map(Into::into).collect();
    Ok(json(StatusCode::OK, &PageOfAuditEntries { items, next })?)
}

/// Entries to remove.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(in crate::api::v1) struct AuditRemoval {
    /// Entries before this time are removed, RFC 3339; at least 24 hours ago.
    #[param(example = "2026-01-31T12:00:00Z")]
    before: String,
}

/// Beginning of the audit trail after the removal.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct AuditBeginning {
    /// Number of entries removed by this request.
    #[schema(example = 1200)]
    removed: u64,
    /// Position of the last entry ever removed, 0 if none: the trail begins with the next one.
    #[schema(example = 1200)]
    sequence: u64,
    /// Digest of that entry, in hexadecimal; it is covered by the digest of the next entry.
    digest: String,
}

/// Removes old entries of the audit trail.
///
/// Removes the tenant's entries before a given time, which must be at least 24 hours ago; later entries stay. The returned
/// digest lets the trail still be verified from there; the entry of this request records it as `removed_digest`.
#[utoipa::path(delete, path = "/v1/audit", tag = "operation", params(AuditRemoval),
    responses(
        (status = 200, description = "Entries removed", body = AuditBeginning),
        (status = 400, description = "The query was refused"),
        (status = 503, description = "The store cannot be written"),
        (status = 507, description = "The disk of the store is full")
    ))]
pub(in crate::api::v1) async fn prune_audit(
    Caller(app): Caller,
    Query(query): Query<AuditRemoval>,
) -> Result<Response, Problem> {
    let before = milliseconds("before", &query.before)?;
    let trail::Beginning { removed, sequence, digest } = trail::remove(&app, before).await?;
    Ok(json(StatusCode::OK, &AuditBeginning { removed, sequence, digest })?)
}

/// All entries after a position, read in pieces.
fn lines(app: App, filter: AuditFilter, after: u64) -> impl Stream<Item = Result<Bytes, ServiceError>> {
    stream::try_unfold(Some(after), move |after| {
        let (app, filter) = (app.clone(), filter.clone());
        async move {
            let Some(after) = after else { return Ok(None) };
            let entries = trail::list_after(&app, &filter, after, PIECE).await?;
            let Some(last) = entries.last().map(|entry| entry.sequence) else { return Ok(None) };
            let next = (entries.len() == PIECE).then_some(last);
            let mut text = Vec::new();
            for entry in entries {
                serde_json::to_writer(&mut text, &AuditEntry::from(entry))
                    .map_err(|error| ServiceError::Internal(error.to_string()))?;
                text.push(b'\n');
            }
            Ok(Some((Bytes::from(text), next)))
        }
    })
}
