//! Formats of files: which there are, and how each of them is named and read.

use axum::Json;
use serde::Serialize;
use utoipa::ToSchema;

use crate::api::extract::NoQuery;
use crate::service::files::FileFormat;
use crate::wire::files::EVERY;

/// A format of files.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::api::v1) struct FormatEntry {
    /// Word in the parameters `format` and `to`.
    #[schema(example = "geojson")]
    id: &'static str,
    /// Name for people.
    #[schema(example = "GeoJSON")]
    name: &'static str,
    /// Media types of requests and responses; the first one is written.
    #[schema(example = json!(["application/geo+json", "application/geo+json-seq"]))]
    media_types: &'static [&'static str],
    /// Endings of file names, lower case, without the first dot; the first one is written.
    #[schema(example = json!(["geojson", "geojsonl", "geojsons"]))]
    extensions: &'static [&'static str],
    /// Whether files of the format are read.
    read: bool,
    /// Whether files of the format are written.
    written: bool,
    /// Kinds of its shapes: `curve`, `landmarks`, `mesh` and `fourier`.
    #[schema(example = json!(["curve", "landmarks"]))]
    kinds: Vec<&'static str>,
    /// Options of reading, which are parameters by their names. `*` of archives: those of the files within.
    #[schema(example = json!(["holes", "names", "nuclei", "select", "attributes"]))]
    options: Vec<&'static str>,
}

impl From<FileFormat> for FormatEntry {
    fn from(format: FileFormat) -> Self {
        Self {
            id: format.id(),
            name: format.name(),
            media_types: format.media_types(),
            extensions: format.extensions(),
            read: format.is_read(),
            written: format.is_written(),
            kinds: format.kinds().iter().map(|kind| kind.name()).collect(),
            options: if format.is_read() { options(format) } else { Vec::new() },
        }
    }
}

/// Options of a format and those of every format.
fn options(format: FileFormat) -> Vec<&'static str> {
    let own = format.options();
    own.iter().copied().chain(EVERY.into_iter().filter(|name| !own.contains(name))).collect()
}

/// The formats of files.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::api::v1) struct FileFormats {
    /// All formats: those of shapes, then those of label images.
    items: Vec<FormatEntry>,
}

/// Lists the formats of files.
///
/// Those that uploads, `POST /v1/inspect` and `POST /v1/convert` read, and those that `POST /v1/convert`,
/// `GET /v1/cohorts/{cohort}/shapes` and `GET /v1/cohorts/{cohort}/export` write. Of label images, every connected component of a label is a shape.
#[utoipa::path(get, path = "/v1/formats", tag = "files",
    responses((status = 200, description = "The formats", body = FileFormats), (status = 400, description = "An unknown parameter")))]
pub(in crate::api::v1) async fn list_formats(_: NoQuery) -> Json<FileFormats> {
    Json(FileFormats { items: FileFormat::all().map(FormatEntry::from).collect() })
}
