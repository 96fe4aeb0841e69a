//! Access control in the OpenAPI document.

use utoipa::openapi::OpenApi;
use utoipa::openapi::extensions::Extensions;
use utoipa::openapi::header::Header;
use utoipa::openapi::path::Operation;
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityRequirement, SecurityScheme};

use crate::api::access::needed;
use crate::api::describe::{operations_of, refusal};
use crate::api::operation::Needs;

/// Name of the security scheme.
const SCHEME: &str = "bearer";

/// Adds access control to the OpenAPI document: the scheme, the role of every operation (`x-role`), and the responses to
/// unauthorised requests.
pub(super) fn describe(document: &mut OpenApi) {
    let scheme = HttpBuilder::new().scheme(HttpAuthScheme::Bearer).description(Some(
        "A key (`shk_…`) or a token of the identity provider. Not required on a loopback address without keys \
         and identity provider.",
    ));
    let components = document.components.get_or_insert_default();
    components.security_schemes.insert(SCHEME.into(), SecurityScheme::Http(scheme.build()).into());
    for (path, item) in &mut document.paths.paths {
        for (method, operation) in operations_of(item) {
            describe_operation(operation, needed(method, path));
        }
    }
}

fn describe_operation(operation: &mut Operation, needs: Needs) {
    let word = match needs {
        Needs::Nothing => "none",
        Needs::Role(role) => role.as_str(),
    };
    let role = Extensions::from_iter([("x-role", word)]);
    operation.extensions.get_or_insert_default().merge(role);
    let Needs::Role(role) = needs else {
        operation.security = Some(Vec::new());
        return;
    };
    operation.security = Some(vec![SecurityRequirement::new::<_, [&str; 0], _>(SCHEME, [])]);
    let unknown = refusal("No valid key or token");
    let unknown = unknown.header("WWW-Authenticate", Header::default());
    let forbidden =
        refusal(format!("The caller lacks the role {}, or its key does not cover this", role.as_str()));
    let responses = &mut operation.responses.responses;
    responses.entry("401".into()).or_insert_with(|| unknown.build().into());
    responses.entry("403".into()).or_insert_with(|| forbidden.build().into());
}
