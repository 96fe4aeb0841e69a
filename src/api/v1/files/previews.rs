//! A file looked at against a cohort: the effect of an upload.

use axum::extract::Request;
use serde::Serialize;
use utoipa::{IntoParams, ToSchema};

use crate::api::body;
use crate::api::media_type::media_type;
use crate::api::problem::Problem;
use crate::api::v1::cohorts::shapes::{AddQuery, failed};
use crate::api::v1::requests::batches::FailedShape;
use crate::api::v1::requests::file_parameters::FileParameters;
use crate::service::app::App;
use crate::service::cohorts::catalogue::{self, revision_tag};
use crate::service::cohorts::fits::MeshFits;
use crate::service::cohorts::preview::Preview;
use crate::service::cohorts::upload::Stored;
use crate::service::cohorts::upload_file::preview_file;
use crate::service::shapes::outcome::ShapeError;
use crate::wire::fault::Fault;
use crate::wire::files::Inspection;
use crate::wire::summary::FileSummary;

/// Cohort against which a file is looked at.
#[derive(IntoParams)]
#[into_params(parameter_in = Query)]
#[allow(dead_code, reason = "only for the document; the handler reads it")]
pub(in crate::api::v1) struct PreviewQuery {
    /// Cohort, by id or name, against which the file is looked at. Default: none, the file is looked at by itself.
    cohort: Option<String>,
}

/// Effect that an upload of a file to a cohort would have.
#[derive(Debug, Serialize, ToSchema)]
pub(in crate::api::v1) struct CohortPreview {
    /// Id of the cohort.
    #[schema(example = "coh_0190c7e0c8f97b4d8d2a3d7c1e5f6a7b")]
    id: String,
    /// Revision of the cohort when the look began.
    revision: u64,
    /// Entity tag of that revision. An upload with it as `If-Match` has the effect that is told here, or is refused
    /// because the cohort has changed.
    #[schema(example = "\"coh_0190c7e0c8f97b4d8d2a3d7c1e5f6a7b-3\"")]
    etag: String,
    /// Whether an upload with the same parameters would store shapes or find them stored; otherwise `refusal` says why not.
    accepted: bool,
    /// Number of new shapes. This and the next numbers leave out the refused shapes, also under `on_error=abort`, where one of them
    /// refuses the file.
    added: usize,
    /// Number of shapes that stand in the cohort already, under the same external ids and with the same points.
    unchanged: usize,
    /// Number of shapes that would not be stored: invalid ones, and `conflicts`.
    skipped: usize,
    /// Number of shapes whose external id belongs to a shape with other points.
    conflicts: usize,
    /// Number of points that would be dropped because they are equal to their predecessor.
    repeated_points: usize,
    /// Number of shapes that intersect themselves.
    self_intersecting: usize,
    /// Residuals of the fits to meshes; absent without meshes that are fitted.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(required = false)]
    fits: Option<MeshFits>,
    /// Warnings about the shapes as a whole, in the words of the upload.
    warnings: Vec<String>,
    /// Faults of the invalid shapes by kind: the first of those that say the same, with their number.
    faults: Vec<Fault>,
    /// Shapes that would not be stored, each with its faults.
    results: Vec<FailedShape>,
    /// Problem with which the upload would be refused; absent if it would be accepted.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(required = false)]
    refusal: Option<ShapeError>,
}

impl CohortPreview {
    /// Effect that an upload of a file would have, and the cohort at that time.
    fn new(id: String, etag: String, preview: Preview) -> (FileSummary, Inspection, Self) {
        let Preview { stored, file, found, conflicts, faults, fits, refusal } = preview;
        let Stored { added, unchanged, skipped, repeated_points, self_intersecting, .. } = stored;
        let Stored { revision, warnings, results, .. } = stored;
        let results = results.into_iter().map(|one| failed(one.index, one.external_id, one.faults));
        let cohort = Self {
            id,
            revision,
            etag,
            accepted: refusal.is_none(),
            added,
            unchanged,
            skipped,
            conflicts,
            repeated_points,
            self_intersecting,
            fits,
            warnings,
            faults: faults.into_listed(),
            results: results.collect(),
            refusal: refusal.map(ShapeError::from),
        };
        (file, found, cohort)
    }
}

/// Looks at the file of a request against a cohort, with the parameters of an upload.
pub(in crate::api::v1) async fn preview(
    app: &App,
    key: &str,
    parameters: FileParameters,
    pairs: &[(String, String)],
    request: Request,
) -> Result<(FileSummary, Inspection, CohortPreview), Problem> {
    let treatment = AddQuery::read(pairs)?.treatment();
    let file = parameters.into_file(&media_type(request.headers()), treatment.on_error, &app.limits)?;
    let cohort = catalogue::find(app, key).await?;
    let (id, etag) = (cohort.id.clone(), revision_tag(&cohort));
    let stream = body::pieces(request.into_body());
    Ok(CohortPreview::new(id, etag, preview_file(app, cohort, stream, file, treatment).await?))
}
