//! Aliases of dictionaries: names for versions, which can be moved.

use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use crate::api::extract::{Caller, IfMatch, JsonBody, NoQuery, Path};
use crate::api::problem::Problem;
use crate::api::respond::json;
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::entity_tags::{tagged, unless_known};
use crate::domain::dictionary::Alias;
use crate::service::app::ServiceError;
use crate::service::dictionaries::aliases::{self, alias_tag};
use crate::service::dictionaries::answers::UsedDictionary;
use crate::wire::checked::{Checked, document, take_given};
use crate::wire::time::rfc3339;

document! {
    /// The version that an alias is to name.
    #[schema(example = json!({"version": 1}))]
    pub(in crate::api::v1) struct AliasRequest {
        /// Number of a version of the dictionary.
        #[schema(value_type = u64, required = true, minimum = 1)]
        version: Checked<u64>, required;
    }
}

/// An alias, and the version that it names.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct AliasOutput {
    /// The alias; the version is addressed as `name@alias`.
    #[schema(example = "production")]
    alias: String,
    /// The version that it names.
    dictionary: UsedDictionary,
    /// Since when it names the version, RFC 3339 in UTC.
    moved_at: String,
}

impl From<Alias> for AliasOutput {
    fn from(alias: Alias) -> Self {
        let Alias { alias, id, name, version, digest, moves: _, moved_at_ms } = alias;
        let dictionary = UsedDictionary { id, name, version, digest, warnings: Vec::new() };
        Self { alias, dictionary, moved_at: rfc3339(moved_at_ms) }
    }
}

/// Aliases of a dictionary.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct AliasesAnswer {
    /// All aliases, at most 100, in alphabetic order.
    items: Vec<AliasOutput>,
}

/// Lists the aliases of a dictionary, and the versions that they name.
#[utoipa::path(get, path = "/v1/dictionaries/{dictionary}/aliases", tag = "dictionaries",
    params(("dictionary" = String, Path, description = "Name, or any other key of a version")),
    responses(
        (status = 200, description = "The aliases", body = AliasesAnswer),
        (status = 404, description = "No such dictionary")
    ))]
pub(in crate::api::v1) async fn list_aliases(
    Caller(app): Caller,
    _: NoQuery,
    Path(key): Path<String>,
) -> Result<Response, Problem> {
    let items = aliases::list(&app, &key).await?.into_iter().map(Into::into).collect();
    Ok(json(StatusCode::OK, &AliasesAnswer { items })?)
}

/// Returns an alias, and the version that it names.
#[utoipa::path(get, path = "/v1/dictionaries/{dictionary}/aliases/{alias}", tag = "dictionaries",
    params(
        ("dictionary" = String, Path, description = "Name, or any other key of a version"),
        ("alias" = String, Path, description = "The alias")
    ),
    responses(
        (status = 200, description = "The alias; its ETag changes with every move", body = AliasOutput),
        (status = 304, description = "Not moved since the ETag in If-None-Match"),
        (status = 404, description = "No such dictionary or alias")
    ))]
pub(in crate::api::v1) async fn find_alias(
    Caller(app): Caller,
    _: NoQuery,
    Path((key, alias)): Path<(String, String)>,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let found = aliases::find(&app, &key, &alias).await?;
    let tag = alias_tag(&found);
    let answer = async { Ok(json(StatusCode::OK, &AliasOutput::from(found))?) };
    unless_known(&headers, &tag, answer).await
}

/// Makes an alias name a version of a dictionary: creates it, or moves it.
///
/// From this answer on, every request that names the dictionary as `name@alias` uses the version; requests that are being
/// answered and jobs that were submitted go on with the one before. An alias begins with a letter, followed by letters, digits,
/// '.', '_' and '-', at most 100 characters; `latest` is none, since the name alone means the latest version. A version that an
/// alias names cannot be deleted.
#[utoipa::path(put, path = "/v1/dictionaries/{dictionary}/aliases/{alias}", tag = "dictionaries", request_body = AliasRequest,
    params(
        ("dictionary" = String, Path, description = "Name, or any other key of a version"),
        ("alias" = String, Path, description = "The alias"),
        IfMatchHeader
    ),
    responses(
        (status = 200, description = "The alias, which existed", body = AliasOutput),
        (status = 201, description = "The new alias", body = AliasOutput, headers(("Location" = String))),
        (status = 404, description = "No such dictionary"),
        (status = 412, description = "The alias has been moved meanwhile"),
        (status = "4XX", description = "The alias or the version was refused")
    ))]
pub(in crate::api::v1) async fn set_alias(
    Caller(app): Caller,
    _: NoQuery,
    Path((key, alias)): Path<(String, String)>,
    IfMatch(expected): IfMatch,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let version = version_of(app.parse(&body)?)?;
    let (alias, created) = aliases::set(&app, &key, &alias, version, expected).await?;
    let tag = alias_tag(&alias);
    let location = format!("/v1/dictionaries/{}/aliases/{}", alias.name, alias.alias);
    let output = AliasOutput::from(alias);
    let response = match created {
        true => ([(header::LOCATION, location)], json(StatusCode::CREATED, &output)?).into_response(),
        false => json(StatusCode::OK, &output)?,
    };
    Ok(tagged(response, &tag))
}

fn version_of(request: AliasRequest) -> Result<u64, ServiceError> {
    let mut errors = request.faults;
    match take_given(request.version, "/version", &mut errors) {
        Some(version) if errors.is_empty() => Ok(version),
        _ => Err(ServiceError::Invalid(errors.into())),
    }
}

/// Deletes an alias; the version that it names stays.
#[utoipa::path(delete, path = "/v1/dictionaries/{dictionary}/aliases/{alias}", tag = "dictionaries",
    params(
        ("dictionary" = String, Path, description = "Name, or any other key of a version"),
        ("alias" = String, Path, description = "The alias"),
        IfMatchHeader
    ),
    responses(
        (status = 204, description = "Deleted"),
        (status = 404, description = "No such dictionary or alias"),
        (status = 412, description = "The alias has been moved meanwhile")
    ))]
pub(in crate::api::v1) async fn delete_alias(
    Caller(app): Caller,
    _: NoQuery,
    Path((key, alias)): Path<(String, String)>,
    IfMatch(expected): IfMatch,
) -> Result<StatusCode, Problem> {
    aliases::remove(&app, &key, &alias, expected).await?;
    Ok(StatusCode::NO_CONTENT)
}
