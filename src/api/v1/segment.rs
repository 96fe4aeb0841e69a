//! Segmentation of objects in images and volumes.

use axum::body::{Body, Bytes};
use axum::extract::Request;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};

use super::request_macros::{IfMatchHeader, RetryHeader};
use super::segment_request::{Checks, CohortSegmentRequest, SegmentRequest, ShapePrior, Storing};
use crate::api::extract::{BesideFormat, Caller, DrawingQuery, Format, IfMatch, ImageFormat, Path, Query};
use crate::api::form::{self, Form};
use crate::api::problem::Problem;
use crate::api::respond::{Binary, Planned, compute_planned, json, picture, planned};
use crate::formats::picture::{PictureFile, PictureFormat};
use crate::service::app::{App, ServiceError, Work};
use crate::service::cohorts::catalogue;
use crate::service::segmentation::answer::SegmentAnswer;
use crate::service::segmentation::cost::SegmentEstimate;
use crate::service::segmentation::image::Part;
use crate::service::segmentation::membership::{self, Arriving, Digests, MembersAnswer, Membership};
use crate::service::segmentation::segment::{self, Files};
use crate::service::segmentation::shown::{LabelFormat, Segmented};
use crate::service::segmentation::wanted::Wanted;
use crate::service::segmentation::{reference, starts};

/// Form with an image, and labels of the truth.
#[derive(Debug, utoipa::ToSchema)]
#[allow(dead_code, reason = "only for the document")]
pub(super) struct SegmentForm {
    /// What is wanted; the first part.
    parameters: SegmentRequest,
    /// Image: PNG, TIFF or NIfTI. Colours are read as luma.
    image: Binary,
    /// Label image of the same size, with which the results are compared.
    truth: Option<Binary>,
    /// Label image of the same size whose components begin objects: in the plane by their outer contours, in space by the boxes
    /// around them.
    mask: Option<Binary>,
}

/// Query parameters of a segmentation.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct SegmentQuery {
    /// Whether only memory and time are predicted: nothing but the components of a mask is computed. Default: false.
    #[serde(default)]
    #[param(required = false)]
    dry_run: bool,
}

/// Predicted cost of a segmentation.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct SegmentEstimateAnswer {
    /// Predicted cost.
    estimate: SegmentEstimate,
}

/// Segmented objects, or their predicted cost.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[serde(untagged)]
#[allow(dead_code, reason = "only for the document")]
pub(super) enum SegmentOrEstimate {
    /// Objects.
    Found(SegmentAnswer),
    /// Cost.
    Estimated(SegmentEstimateAnswer),
}

fn estimated(estimate: SegmentEstimate) -> Result<Planned, ServiceError> {
    planned(Work::from_seconds(0.0), move |_: &App| json(StatusCode::OK, &SegmentEstimateAnswer { estimate }))
}

/// Segments objects in an image or a volume.
///
/// Each object is a shape that minimises an energy of the image inside it, from its initial shape on, by L-BFGS with exact gradients,
/// in stages from coarse to fine. The shape is checked after every stage: one that folds, collapses or leaves the image is answered
/// with `stop` and a warning, as it was before. Shapes are those of the representation, and can be posted to a cohort.
#[utoipa::path(post, path = "/segment", tag = "images",
    params(SegmentQuery, ("format" = Option<String>, Query, description = "`json`; `svg` or `png`, the image in grey below initial shapes and results; `nifti`, a volume of labels, and with `mask` also `png`: 1 for the cells of the first result"), DrawingQuery),
    request_body(content = SegmentForm, content_type = "multipart/form-data"),
    responses(
        (status = 200, description = "One shape for each initial shape, in order; or the predicted cost (dry run)", content((SegmentOrEstimate = "application/json"), (String = "image/svg+xml"), (Binary = "application/x-nifti"))),
        (status = 404, description = "No such cohort or dictionary")
    ))]
pub(super) async fn segment(
    Caller(app): Caller,
    format: ImageFormat,
    BesideFormat(SegmentQuery { dry_run }): BesideFormat<SegmentQuery>,
    request: Request,
) -> Result<Response, Problem> {
    let form = form::read(&app, request, &PARTS).await?;
    let asked = app.read::<SegmentRequest>(form.parameters.clone()).await?;
    let (files, mut wanted) = prepare(&app, &form, asked).await?;
    let shown = Shown::new(format, wanted.answered.mask)?;
    wanted.answered.outlines = shown != Shown::Numbers;
    // The parameters are read already; their length tells where the plan is made.
    compute_planned(app, form.parameters, move |app, _| {
        let found = segment::Planned::new(app, files.parts(), wanted)?;
        if dry_run {
            return estimated(found.estimate());
        }
        planned(found.work() + format.work(), move |app: &App| {
            shown.answer(&found.segment(app, files.parts())?)
        })
    })
    .await
}

/// How segmented objects are answered.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shown {
    /// As JSON.
    Numbers,
    /// As a drawing.
    Drawn(PictureFile),
    /// As a label image.
    Labels(LabelFormat),
}

impl Shown {
    /// The answer in a format; `mask`: whether cells are asked for.
    fn new(format: ImageFormat, mask: bool) -> Result<Self, Problem> {
        match format {
            ImageFormat::Plain(Format::Json) => Ok(Self::Numbers),
            ImageFormat::Plain(Format::Picture(file)) if !mask => Ok(Self::Drawn(file)),
            ImageFormat::Plain(Format::Picture(file)) => match file.format {
                PictureFormat::Png => Ok(Self::Labels(LabelFormat::Png)),
                PictureFormat::Svg => {
                    let detail = "expected 'json', 'png' or 'nifti' with \"mask\": true, got 'svg'";
                    Err(Problem::of_parameter("format", detail))
                }
            },
            ImageFormat::Nifti => Ok(Self::Labels(LabelFormat::Nifti)),
        }
    }

    fn answer(self, found: &Segmented) -> Result<Response, ServiceError> {
        match self {
            Self::Numbers => json(StatusCode::OK, &found.answer),
            Self::Drawn(file) => picture(&found.drawing()?, &file),
            Self::Labels(format) => {
                let file = found.label_file(format)?;
                Ok(([(header::CONTENT_TYPE, format.media_type())], Body::from(file)).into_response())
            }
        }
    }
}

/// Form with an image whose objects go into a cohort.
#[derive(Debug, utoipa::ToSchema)]
#[allow(dead_code, reason = "only for the document")]
pub(super) struct CohortSegmentForm {
    /// What is wanted; the first part.
    parameters: CohortSegmentRequest,
    /// Image: PNG, TIFF or NIfTI. Colours are read as luma.
    image: Binary,
    /// Label image of the same size, with which the results are compared.
    truth: Option<Binary>,
    /// Label image of the same size whose components begin objects.
    mask: Option<Binary>,
}

/// Segments objects in an image or a volume, and adds them to a cohort.
///
/// As `POST /v1/segment`, with the representation of the cohort. The objects become shapes of the cohort in one revision, as posted
/// ones do. Objects that fold, collapse or leave the image are answered, but stored only with `store_failed`. The metadata of a
/// stored object names the BLAKE3 digests of the image and of the other parts under `segmentation`; the image itself is not kept.
#[utoipa::path(post, path = "/cohorts/{cohort}/segment", tag = "images",
    params(("cohort" = String, Path, description = "Id or name"), SegmentQuery, RetryHeader, IfMatchHeader),
    request_body(content = CohortSegmentForm, content_type = "multipart/form-data"),
    responses(
        (status = 201, description = "One entry for each initial shape, in order; at least one object is stored", body = MembersAnswer),
        (status = 200, description = "Nothing is stored: all objects have failed, or it is a dry run", body = MembersOrEstimate),
        (status = 404, description = "No such cohort or dictionary"),
        (status = 412, description = "The cohort has changed meanwhile"),
        (status = 409, description = "An external id belongs to another shape")
    ))]
pub(super) async fn segment_into_cohort(
    Caller(app): Caller,
    Path(key): Path<String>,
    Query(SegmentQuery { dry_run }): Query<SegmentQuery>,
    IfMatch(expected): IfMatch,
    request: Request,
) -> Result<Response, Problem> {
    let cohort = catalogue::find(&app, &key).await?;
    let form = form::read(&app, request, &PARTS).await?;
    let digests = Digests::of(&app, form.parts()).await?;
    let app = app.with_body(digests.text().as_bytes());
    if let Some(answer) = membership::done_before(&app).await? {
        return Ok(json(StatusCode::CREATED, &answer)?);
    }
    let asked = app.read::<CohortSegmentRequest>(form.parameters.clone()).await?;
    let (asked, Storing { objects, store_failed }) = asked.split(&cohort)?;
    let membership = Membership { cohort, expected, objects, store_failed, digests };
    if dry_run {
        return dry(app, &form, membership, asked).await;
    }
    let arriving = arriving(&app, &form, membership.clone(), asked).await?;
    let (answer, is_stored) = membership.store(&app, arriving).await?;
    Ok(json(if is_stored { StatusCode::CREATED } else { StatusCode::OK }, &answer)?)
}

/// Members, or their predicted cost.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[serde(untagged)]
#[allow(dead_code, reason = "only for the document")]
pub(super) enum MembersOrEstimate {
    /// Objects.
    Found(MembersAnswer),
    /// Cost.
    Estimated(SegmentEstimateAnswer),
}

/// Predicts what the segmentation of a form for a cohort costs.
async fn dry(
    app: App,
    form: &Form,
    membership: Membership,
    asked: SegmentRequest,
) -> Result<Response, Problem> {
    let (files, wanted) = prepare(&app, form, asked).await?;
    compute_planned(app, form.parameters.clone(), move |app, _| {
        membership.attributes(&wanted.starts)?;
        estimated(segment::Planned::new(app, files.parts(), wanted)?.estimate())
    })
    .await
}

/// Segments the objects of a form for a cohort.
async fn arriving(
    app: &App,
    form: &Form,
    membership: Membership,
    asked: SegmentRequest,
) -> Result<Arriving, ServiceError> {
    let (files, wanted) = prepare(app, form, asked).await?;
    let worker = app.clone();
    let plan = move |_: &[u8]| {
        let attributes = membership.attributes(&wanted.starts)?;
        let found = segment::Planned::new(&worker, files.parts(), wanted)?;
        let work = found.work();
        Ok((work, move || membership.arriving(found.segment(&worker, files.parts())?.answer, attributes)))
    };
    app.pool.run_planned(form.parameters.clone(), plan).await
}

/// Parts of the form beside the parameters.
const PARTS: [&str; 3] = ["image", "truth", "mask"];

/// The files of a form.
struct Posted {
    image: Bytes,
    truth: Option<Bytes>,
    slice: Option<usize>,
}

impl Posted {
    fn parts(&self) -> Files<'_> {
        let part = |name, bytes| Part { name, bytes, slice: self.slice };
        let truth = self.truth.as_deref().map(|bytes| part("truth", bytes));
        Files { image: part("image", &self.image), truth }
    }
}

/// The files of a form and what is wanted of them: looks up what is stored, and finds the components of a mask.
async fn prepare(app: &App, form: &Form, asked: SegmentRequest) -> Result<(Posted, Wanted), ServiceError> {
    let (image, truth, mask) = (form.required("image")?, form.file("truth"), form.file("mask"));
    let stored = match asked.prior.as_ref().and_then(ShapePrior::stored) {
        Some((source, transformation, alignment)) => {
            Some(reference::find(app, source, transformation, alignment).await?)
        }
        None => None,
    };
    let (reader, has_mask) = (app.clone(), mask.is_some());
    let check = move |_: &[u8]| asked.wanted(&reader, stored, has_mask);
    let Checks { mut wanted, of_mask, slice } = app.pool.read(form.parameters.clone(), check).await?;
    if let Some(mask) = mask {
        wanted.starts = starts::of_mask(app, image.clone(), mask, slice, of_mask).await?;
    }
    Ok((Posted { image, truth, slice }, wanted))
}
