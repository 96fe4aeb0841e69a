//! Headers and query strings: media types, wanted formats, preferences, versions that are known, cursors.
//!
//! The first line is the query, each further one a header with its value.

#![no_main]

use axum::body::Body;
use axum::extract::FromRequestParts;
use axum::http::{HeaderName, HeaderValue, Request, StatusCode, Uri};
use libfuzzer_sys::fuzz_target;
use shapelex_server::api::extract::Prefer;
use shapelex_fuzz::{Service, content_type};

/// Lists with cursors, a route with two formats, one with a filter, one with many parameters.
const ROUTES: [&str; 7] = [
    "/v1/cohorts",
    "/v1/jobs",
    "/v1/dictionaries",
    "/v1/generators/bspline",
    "/v1/cohorts/none/shapes",
    "/v1/cohorts/none/mean",
    "/v1/dictionaries/none/modes",
];

fuzz_target!(|data: &[u8]| {
    let mut lines = data.split(|&byte| byte == b'\n');
    let Ok(query) = std::str::from_utf8(lines.next().unwrap_or_default()) else { return };
    let headers: Vec<(HeaderName, HeaderValue)> = lines.filter_map(header).collect();
    for route in ROUTES {
        let Ok(uri) = format!("{route}?{query}").parse::<Uri>() else { return };
        let mut request = Request::get(uri).body(Body::empty()).expect("a request");
        request.headers_mut().extend(headers.iter().cloned());
        let (mut parts, body) = request.into_parts();
        let Ok(preferred) = Service::get().run(Prefer::from_request_parts(&mut parts, &()));
        assert!(preferred.wait.is_none_or(|wait| wait.as_secs() <= 60), "{preferred:?}");
        let (status, headers, body) = Service::get().send(Request::from_parts(parts, body));
        assert!(status < StatusCode::INTERNAL_SERVER_ERROR, "{route}: {status} {body:?}");
        let is_problem = content_type(&headers) == "application/problem+json";
        assert_eq!(status.is_client_error(), is_problem, "{route}: {status} {headers:?}");
    }
});

fn header(line: &[u8]) -> Option<(HeaderName, HeaderValue)> {
    let colon = line.iter().position(|&byte| byte == b':')?;
    let (name, value) = (&line[..colon], line[colon + 1..].trim_ascii());
    Some((HeaderName::from_bytes(name).ok()?, HeaderValue::from_bytes(value).ok()?))
}
