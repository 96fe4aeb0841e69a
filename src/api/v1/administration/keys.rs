//! API keys of programs, for administrators: create, list, read, revoke.

use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use crate::api::extract::{Caller, JsonBody, NoQuery, Path, Query};
use crate::api::problem::Problem;
use crate::api::respond::json;
use crate::api::v1::requests::request_macros::{PageQuery, page};
use crate::domain::access::Role;
use crate::domain::key::Key;
use crate::service::access::keys::{self, NewKey, faults};
use crate::service::app::ServiceError;
use crate::wire::checked::{Checked, document, take_given};
use crate::wire::time::rfc3339;

document! {
    /// A key to create.
    #[schema(example = json!({"name": "segmentation pipeline", "role": "writer", "expires_in_days": 365}))]
    pub(in crate::api::v1) struct KeyRequest {
        /// Display name, at most 100 characters.
        #[schema(value_type = String, required = true)]
        name: Checked<String>, required;
        /// Role, which determines the rights of the bearer.
        #[schema(value_type = Role, required = true)]
        role: Checked<Role>, required;
        /// Ids or names of the only cohorts the key gives access to, at most 100. Default: all cohorts of the tenant. Not for
        /// admins.
        #[schema(value_type = Option<Vec<String>>, min_items = 1, max_items = 100)]
        cohorts: Checked<Option<Vec<String>>>;
        /// Days until the key expires, 1 to 3653. Default: it never expires.
        #[schema(value_type = Option<u32>, minimum = 1, maximum = 3653)]
        expires_in_days: Checked<Option<u32>>;
    }
}

/// A key, without its secret.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct KeyOutput {
    /// Identifier, as used in the log and the audit trail.
    #[schema(example = "key_0198c0ffee00700080000000000000aa")]
    id: String,
    /// Display name.
    name: String,
    /// Role, which determines the rights of the bearer.
    role: Role,
    /// Ids of the only cohorts the key gives access to; null for all.
    cohorts: Option<Vec<String>>,
    /// Time of creation, RFC 3339 in UTC.
    created_at: String,
    /// Time of expiry, RFC 3339 in UTC; null if the key never expires.
    expires_at: Option<String>,
    /// Time of revocation, RFC 3339 in UTC; null if the key is not revoked.
    revoked_at: Option<String>,
    /// Time of last use, to the minute, RFC 3339 in UTC.
    last_used_at: Option<String>,
}

page! {
    /// One page of keys.
    PageOfKeys of KeyOutput
}

impl From<Key> for KeyOutput {
    fn from(key: Key) -> Self {
        Self {
            id: key.id,
            name: key.name,
            role: key.role,
            cohorts: key.cohorts,
            created_at: rfc3339(key.created_at_ms),
            expires_at: key.expires_at_ms.map(rfc3339),
            revoked_at: key.revoked_at_ms.map(rfc3339),
            last_used_at: key.used_at_ms.map(rfc3339),
        }
    }
}

/// A new key, with its secret.
#[derive(Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct IssuedOutput {
    #[serde(flatten)]
    key: KeyOutput,
    /// Secret to send with every request as `Authorization: Bearer …`. It is shown only once.
    #[schema(example = "shk_0198c0ffee00700080000000000000aa_<64 hexadecimal digits>")]
    secret: String,
}

/// Creates a key for the caller's tenant.
///
/// This response is the only place where the secret appears: only a digest is stored. Once a service without keys gets its
/// first one, requests without a key are refused.
#[utoipa::path(post, path = "/v1/keys", tag = "access", request_body = KeyRequest,
    responses(
        (status = 201, description = "Created", body = IssuedOutput, headers(("Location" = String)))
    ))]
pub(in crate::api::v1) async fn create_key(
    Caller(app): Caller,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let issued = keys::create(&app, new_key(app.parse(&body)?)?).await?;
    let location = format!("/v1/keys/{}", issued.key.id);
    let output = IssuedOutput { key: issued.key.into(), secret: issued.secret.reveal().to_owned() };
    let response = json(StatusCode::CREATED, &output)?;
    let headers = [(header::LOCATION, location), (header::CACHE_CONTROL, "no-store".into())];
    Ok((headers, response).into_response())
}

fn new_key(request: KeyRequest) -> Result<NewKey, ServiceError> {
    let mut errors = request.faults;
    let name = take_given(request.name, "/name", &mut errors);
    let role = take_given(request.role, "/role", &mut errors);
    let cohorts = take_given(request.cohorts, "/cohorts", &mut errors).flatten();
    let expires_in_days = take_given(request.expires_in_days, "/expires_in_days", &mut errors).flatten();
    match (name, role) {
        (Some(name), Some(role)) => {
            let new = NewKey { name, role, cohorts, expires_in_days };
            errors.extend(faults(&new));
            ServiceError::unless_empty(errors)?;
            Ok(new)
        }
        _ => Err(ServiceError::Invalid(errors.into())),
    }
}

/// Lists the keys of the caller's tenant in order of creation, including expired and revoked ones.
#[utoipa::path(get, path = "/v1/keys", tag = "access", params(PageQuery),
    responses(
        (status = 200, description = "A page of keys", body = PageOfKeys),
        (status = 400, description = "The query was refused")
    ))]
pub(in crate::api::v1) async fn list_keys(
    Caller(app): Caller,
    Query(page): Query<PageQuery>,
) -> Result<Response, Problem> {
    let (items, next) = keys::list(&app, page.cursor.as_deref(), page.limit()?).await?;
    let items: Vec<KeyOutput> = items.into_iter().map(Into::into).collect();
    Ok(json(StatusCode::OK, &PageOfKeys { items, next })?)
}

/// Returns a key.
#[utoipa::path(get, path = "/v1/keys/{key}", tag = "access", params(("key" = String, Path, description = "Id")),
    responses(
        (status = 200, description = "The key", body = KeyOutput),
        (status = 404, description = "No such key")
    ))]
pub(in crate::api::v1) async fn find_key(
    Caller(app): Caller,
    _: NoQuery,
    Path(id): Path<String>,
) -> Result<Response, Problem> {
    Ok(json(StatusCode::OK, &KeyOutput::from(keys::find(&app, &id).await?))?)
}

/// Revokes a key permanently.
///
/// The revocation takes effect at once on the replica that answers, and within five seconds on all others. The key stays in
/// the list. Revoking a revoked key gives the same response.
#[utoipa::path(delete, path = "/v1/keys/{key}", tag = "access", params(("key" = String, Path, description = "Id")),
    responses(
        (status = 204, description = "Revoked"),
        (status = 404, description = "No such key")
    ))]
pub(in crate::api::v1) async fn revoke_key(
    Caller(app): Caller,
    _: NoQuery,
    Path(id): Path<String>,
) -> Result<StatusCode, Problem> {
    keys::revoke(&app, &id).await?;
    Ok(StatusCode::NO_CONTENT)
}
