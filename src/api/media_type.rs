//! Media types of bodies.

use axum::http::{HeaderMap, header};

/// Media type of a body in lower case, without parameters.
pub fn media_type(headers: &HeaderMap) -> String {
    let value = headers.get(header::CONTENT_TYPE).and_then(|value| value.to_str().ok()).unwrap_or_default();
    value.split(';').next().unwrap_or_default().trim().to_ascii_lowercase()
}

/// Whether `media_type` is that of a JSON body. Types such as `application/geo+json` are JSON of another structure.
pub fn is_json(media_type: &str) -> bool {
    media_type == "application/json"
}

/// Whether a body is a form.
pub fn is_form(media_type: &str) -> bool {
    media_type == "multipart/form-data"
}
