//! The audit trail, for administrators.

use std::collections::BTreeMap;

use axum::body::Body;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use bytes::Bytes;
use futures_util::stream::{self, Stream};
use serde::{Deserialize, Serialize};

use super::settings::{Page, PageQuery, time};
use crate::api::extract::{Caller, Query};
use crate::api::problem::{Problem, ProblemDocument, ProblemKind};
use crate::api::respond::json;
use crate::domain::audit::{AuditFilter, Recorded};
use crate::service::app::{App, ServiceError};
use crate::service::audit::trail;

/// Entries that an export reads at a time.
const PIECE: usize = 1000;

/// An entry of the audit trail.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct AuditEntry {
    /// Its place in the trail of the tenant, from 1 without gaps.
    #[schema(example = 17)]
    sequence: u64,
    /// When the request was answered, RFC 3339 UTC.
    at: String,
    /// The tenant.
    tenant: String,
    /// Id of the key; `oidc` for a bearer token of the identity provider, `local` without access control, null for nobody.
    key: Option<String>,
    /// Who stood behind a bearer token.
    subject: Option<String>,
    /// Id of the operation in this document; null when the request asked for none.
    #[schema(example = "find_cohort")]
    operation: Option<String>,
    /// HTTP method.
    #[schema(example = "GET")]
    method: String,
    /// Template of the path; null when nothing is there.
    #[schema(example = "/v1/cohorts/{cohort}")]
    route: Option<String>,
    /// The objects that the path names, as the caller named them, and the ids of the cohorts, dictionaries and shapes that
    /// were used (`cohort_id`, `dictionary_id`, `shape_id`) and of what was `created`.
    #[schema(example = json!({"cohort": "cells", "cohort_id": "coh_0198c0ffee00700080000000000000aa"}))]
    objects: BTreeMap<String, String>,
    /// Status of the answer; null when the client went away before there was one.
    #[schema(example = 200)]
    status: Option<u16>,
    /// Id of the request, as in the log.
    request_id: String,
    /// Address of the client.
    remote: Option<String>,
    /// BLAKE3 of the digest of the entry before and of this entry, in hexadecimal.
    digest: String,
}

impl From<Recorded> for AuditEntry {
    fn from(recorded: Recorded) -> Self {
        let Recorded { sequence, entry, digest } = recorded;
        Self {
            sequence,
            at: time(entry.at_ms),
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

/// How the entries are written.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
enum AuditFormat {
    /// A page.
    #[default]
    Json,
    /// All entries that match, one a line.
    Ndjson,
}

/// Which entries are listed.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct AuditQuery {
    /// Not before this time, RFC 3339.
    since: Option<String>,
    /// Before this time, RFC 3339.
    until: Option<String>,
    /// Only of this key.
    key: Option<String>,
    /// Only this operation, by its id in this document.
    operation: Option<String>,
    /// Only requests that used this object, by its id or by what the path called it, or that created it.
    object: Option<String>,
    /// Only with this status.
    status: Option<u16>,
    /// Cursor from the page before; an export begins behind it.
    cursor: Option<String>,
    /// Entries per page, 1 to 1000; 100 unless given. An export has all of them.
    limit: Option<usize>,
    /// `json` for a page, `ndjson` for all entries, one a line; `json` unless given.
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

fn milliseconds(name: &str, text: &str) -> Result<i64, Problem> {
    let time = text.parse::<jiff::Timestamp>().map_err(|_| {
        let detail = format!("{name} must be a time such as 2026-01-31T12:00:00Z");
        Problem::new(ProblemKind::InvalidQuery, detail)
    })?;
    Ok(time.as_millisecond())
}

/// Lists the audit trail: who asked for what, and what came of it.
///
/// Every request of the tenant under `/v1` in the order in which they were answered, also those that only read and those
/// that were refused. Entries are chained by their digests and never change; they are removed from the beginning alone, for their age or by an administrator.
#[utoipa::path(get, path = "/audit", tag = "operation", params(AuditQuery),
    responses(
        (status = 200, description = "A page of entries, or all of them one a line", content((Page<AuditEntry> = "application/json"), (String = "application/x-ndjson"))),
        (status = 400, description = "The query was refused", body = ProblemDocument, content_type = "application/problem+json"),
        (status = 503, description = "The store cannot be read", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn list_audit(
    Caller(app): Caller,
    Query(query): Query<AuditQuery>,
) -> Result<Response, Problem> {
    let filter = query.filter()?;
    let page = PageQuery { cursor: query.cursor, limit: query.limit };
    let limit = page.limit()?;
    if query.format == Some(AuditFormat::Ndjson) {
        let after = trail::place(page.cursor.as_deref())?;
        let body = Body::from_stream(lines(app, filter, after));
        return Ok(([(header::CONTENT_TYPE, "application/x-ndjson")], body).into_response());
    }
    let (items, next) = trail::list(&app, &filter, page.cursor.as_deref(), limit).await?;
    let items: Vec<AuditEntry> = items.into_iter().map(Into::into).collect();
    Ok(json(StatusCode::OK, &Page { items, next })?)
}

/// Which entries are removed.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct AuditRemoval {
    /// Entries before this time go, RFC 3339; at least 24 hours ago.
    #[param(example = "2026-01-31T12:00:00Z")]
    before: String,
}

/// Where the audit trail begins after entries were removed.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct AuditBeginning {
    /// Entries that were removed now.
    #[schema(example = 1200)]
    removed: u64,
    /// Place of the last entry that was ever removed, 0 when none was: the trail begins with the next.
    #[schema(example = 1200)]
    sequence: u64,
    /// Digest of that entry, in hexadecimal: what the digest of the next one covers.
    digest: String,
}

/// Removes old entries of the audit trail.
///
/// From the beginning of the trail of the tenant, those before a time that is at least 24 hours ago; all others stay. The trail can
/// be followed from the digest that is answered, which the entry of this request keeps as `removed_digest`.
#[utoipa::path(delete, path = "/audit", tag = "operation", params(AuditRemoval),
    responses(
        (status = 200, description = "The entries are gone", body = AuditBeginning),
        (status = 400, description = "The query was refused", body = ProblemDocument, content_type = "application/problem+json"),
        (status = 503, description = "The store cannot be written", body = ProblemDocument, content_type = "application/problem+json"),
        (status = 507, description = "The disk of the store is full", body = ProblemDocument, content_type = "application/problem+json")
    ))]
pub(super) async fn prune_audit(
    Caller(app): Caller,
    Query(query): Query<AuditRemoval>,
) -> Result<Response, Problem> {
    let before = milliseconds("before", &query.before)?;
    let trail::Beginning { removed, sequence, digest } = trail::remove(&app, before).await?;
    Ok(json(StatusCode::OK, &AuditBeginning { removed, sequence, digest })?)
}

/// All entries behind a place, read piece by piece.
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
