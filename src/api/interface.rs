//! The OpenAPI document, as it is committed in `openapi`; the build compresses it once.

use std::io::{self, Read};

use axum::Router;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use flate2::read::GzDecoder;

use super::problem::{Problem, ProblemKind};
use crate::service::app::App;

const COMPRESSED: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/openapi.json.gz"));

pub(super) fn routes() -> Router<App> {
    Router::new().route("/openapi.json", get(read))
}

async fn read(headers: HeaderMap) -> Result<Response, Problem> {
    let kind = (header::CONTENT_TYPE, "application/json");
    if headers.get(header::ACCEPT_ENCODING).is_some_and(|coding| coding == "gzip") {
        let coding = [(header::CONTENT_ENCODING, "gzip"), (header::VARY, "accept-encoding")];
        return Ok(([kind], coding, COMPRESSED).into_response());
    }
    let text = committed().map_err(|error| Problem::new(ProblemKind::Internal, error.to_string()))?;
    Ok(([kind], text).into_response())
}

/// The committed document.
///
/// # Errors
/// None, unless the build is broken.
pub(super) fn committed() -> io::Result<String> {
    let mut text = String::new();
    GzDecoder::new(COMPRESSED).read_to_string(&mut text)?;
    Ok(text)
}

/// The OpenAPI document: with the feature `schema` the one of these sources, else the committed one, which is the same.
///
/// # Errors
/// None, unless the build is broken.
pub fn document() -> io::Result<String> {
    #[cfg(feature = "schema")]
    {
        Ok(super::document::openapi().to_pretty_json()? + "\n")
    }
    #[cfg(not(feature = "schema"))]
    {
        committed()
    }
}
