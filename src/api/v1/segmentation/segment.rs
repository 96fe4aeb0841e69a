//! Segmentation of objects in images and volumes.

use axum::body::{Body, Bytes};
use axum::extract::Request;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};

use crate::api::extract::{BesideFormat, Caller, Format, IfMatch, ImageFormat, Path, Prefer, Query};
use crate::api::form;
use crate::api::problem::Problem;
use crate::api::respond::{Binary, compute_planned, json, planned};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::planned::{Waited, waited};
use crate::api::v1::requests::request_macros::priority_of;
use crate::domain::job::Job;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::catalogue;
use crate::service::cohorts::lengths::Lengths;
use crate::service::jobs;
use crate::service::segmentation::answer::SegmentAnswer;
use crate::service::segmentation::cost::SegmentEstimate;
use crate::service::segmentation::job::{self, Submission};
use crate::service::segmentation::membership::{self, Digests, MembersAnswer, Membership, Origin, Repeated};
use crate::service::segmentation::parts::{self, Parts, Prepared, Ready};
use crate::service::segmentation::posted::{CohortSegmentRequest, SegmentRequest, Storing};
use crate::service::segmentation::reference::Stored;
use crate::service::segmentation::shown::{LabelFormat, Segmented, Shown, ShownFile};
use crate::wire::picture::PictureFormat;
use crate::wire::shape::ShapeInput;

/// Form with an image, and labels of the truth.
#[derive(Debug, utoipa::ToSchema)]
#[allow(dead_code, reason = "only for the document")]
pub(in crate::api::v1) struct SegmentForm {
    /// Parameters of the request; the first part.
    parameters: SegmentRequest,
    /// Image: PNG, TIFF, NIfTI-1, NRRD or DICOM segmentation. Colours are read as luma.
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
pub(in crate::api::v1) struct SegmentQuery {
    /// Whether only memory and time are predicted: nothing but the components of a mask is computed. Default: false.
    #[serde(default)]
    #[param(required = false)]
    dry_run: bool,
}

/// Predicted cost of a segmentation.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct SegmentEstimateAnswer {
    /// Predicted cost.
    estimate: SegmentEstimate,
}

/// Segmented objects, or their predicted cost.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[serde(untagged)]
#[allow(dead_code, reason = "only for the document")]
pub(in crate::api::v1) enum SegmentOrEstimate {
    /// Objects.
    Found(SegmentAnswer),
    /// Cost.
    Estimated(SegmentEstimateAnswer),
}

fn estimated(estimate: SegmentEstimate) -> Result<Response, ServiceError> {
    json(StatusCode::OK, &SegmentEstimateAnswer { estimate })
}

/// Segments objects in an image or a volume.
///
/// Each object is a shape that minimises an energy of the image inside it, from its initial shape on, by L-BFGS with exact gradients,
/// in stages from coarse to fine. The shape is checked after every stage: one that folds, collapses or leaves the image is answered
/// with `stop` and a warning, as it was before. Shapes are those of the representation, and can be posted to a cohort.
///
/// A request whose predicted time is at most three seconds is answered at once (200). A longer one becomes a job (202),
/// which keeps the parts of the form until it ends; its result is this answer, and in another format than JSON its
/// output at `/v1/jobs/{job}/output` is the file. With `Prefer: wait=N` the answer comes if it is ready within `N`
/// seconds, at most 60; `Prefer: respond-async` asks for a job in any case. Readers, and keys that are limited to
/// cohorts, are answered at once or not at all.
#[utoipa::path(post, path = "/v1/segment", tag = "images",
    params(SegmentQuery, ("format" = Option<String>, Query, description = "`json`; `svg` or `png`, the image in grey below initial shapes and results; `nifti`, a volume of labels, and with `mask` also `png`: 1 for the cells of the first result"), DrawingQuery, PreferHeader, RetryHeader),
    request_body(content = SegmentForm, content_type = "multipart/form-data"),
    responses(
        (status = 200, description = "One shape for each initial shape, in order; or the predicted cost (dry run)", content((SegmentOrEstimate = "application/json"), (String = "image/svg+xml"), (Binary = "application/x-nifti"))),
        (status = 202, description = "The job that segments the objects", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such cohort or dictionary"),
        (status = 503, description = "Too many jobs are waiting, or too many bytes of their files")
    ))]
pub(in crate::api::v1) async fn segment(
    Caller(app): Caller,
    format: ImageFormat,
    BesideFormat(SegmentQuery { dry_run }): BesideFormat<SegmentQuery>,
    prefer: Prefer,
    request: Request,
) -> Result<Response, Problem> {
    let parts = read(&app, request).await?;
    let mut asked = app.read::<SegmentRequest>(parts.parameters.clone()).await?;
    let app = app.with_priority(priority_of(asked.priority.take())?);
    let (posted, shown) = Posted::shown(&app, parts, asked, format).await?;
    let work = posted.ready.work();
    if dry_run {
        return Ok(estimated(posted.ready.estimate())?);
    }
    if job::is_due_without_cohort(&app, work.seconds(), prefer.respond_async) {
        return posted.by_job(&app, shown, prefer).await;
    }
    compute_planned(app, Bytes::new(), move |_, _| {
        planned(work + format.work(), move |app: &App| answered(&posted.ready.segment(app)?, shown))
    })
    .await
}

/// A form that was read and checked.
struct Posted {
    parts: Parts,
    attracting: Option<Stored>,
    ready: Ready,
}

impl Posted {
    /// Checks the request, has a `look` at the prepared parts, reads the headers of the files and predicts the cost.
    async fn new<T>(
        app: &App,
        parts: Parts,
        asked: SegmentRequest,
        look: impl FnOnce(&mut Prepared) -> Result<T, Problem>,
    ) -> Result<(Self, T), Problem> {
        let attracting = parts::attracting(app, &asked).await?;
        let mut prepared = parts.clone().prepared(app, asked, attracting.clone()).await?;
        let seen = look(&mut prepared)?;
        let (reader, document) = (app.clone(), parts.parameters.clone());
        let ready = app.pool.read(document, move |_| prepared.ready(&reader)).await?;
        Ok((Self { parts, attracting, ready }, seen))
    }

    /// As [`Self::new`], with the data needed to show the objects in a format.
    async fn shown(
        app: &App,
        parts: Parts,
        asked: SegmentRequest,
        format: ImageFormat,
    ) -> Result<(Self, Shown), Problem> {
        let look = |prepared: &mut Prepared| {
            let shown = shown(format, prepared.wanted.answered.mask)?;
            prepared.wanted.answered.outlines = shown != Shown::Numbers;
            Ok(shown)
        };
        Self::new(app, parts, asked, look).await
    }

    fn submission(&self, shown: Shown) -> Submission<'_> {
        let (parts, attracting, seconds) =
            (&self.parts, self.attracting.as_ref(), self.ready.work().seconds());
        let memory_bytes = self.ready.estimate().memory_bytes();
        Submission { parts, attracting, shown, memory_bytes, seconds }
    }

    /// The answer of a job, if it comes while the client waits, else the job.
    async fn by_job(self, app: &App, shown: Shown, prefer: Prefer) -> Result<Response, Problem> {
        let job = self.submission(shown).submit(app).await?;
        match waited(app, job, prefer).await? {
            Waited::Succeeded(job) => Ok(succeeded(app, *job, shown).await?),
            Waited::Else(response) => Ok(response),
        }
    }
}

fn answered(found: &Segmented, shown: Shown) -> Result<Response, ServiceError> {
    match found.file(shown)? {
        Some(ShownFile { media_type, bytes }) => Ok(file(media_type.to_owned(), bytes)),
        None => json(StatusCode::OK, &found.answer),
    }
}

/// The answer of a job that has succeeded.
async fn succeeded(app: &App, job: Job, shown: Shown) -> Result<Response, ServiceError> {
    if shown == Shown::Numbers {
        return json(StatusCode::OK, &job.result);
    }
    let (output, _room) = jobs::output(app, &job.id).await?;
    let lost = || ServiceError::Internal("a job of a file without a file".into());
    Ok(file(output.media_type().ok_or_else(lost)?.to_owned(), output.data))
}

/// A file as a response.
pub(in crate::api::v1) fn file(media_type: String, bytes: Vec<u8>) -> Response {
    ([(header::CONTENT_TYPE, media_type)], Body::from(bytes)).into_response()
}

/// How objects are answered in a format; `mask`: whether cells are asked for.
fn shown(format: ImageFormat, mask: bool) -> Result<Shown, Problem> {
    match format {
        ImageFormat::Plain(Format::Json) => Ok(Shown::Numbers),
        ImageFormat::Plain(Format::Picture(file)) if !mask => Ok(Shown::Drawn(file)),
        ImageFormat::Plain(Format::Picture(file)) => match file.format {
            PictureFormat::Png => Ok(Shown::Labels(LabelFormat::Png)),
            PictureFormat::Svg => {
                let detail = "expected 'json', 'png' or 'nifti' with \"mask\": true, got 'svg'";
                Err(Problem::of_parameter("format", detail))
            }
        },
        ImageFormat::Nifti => Ok(Shown::Labels(LabelFormat::Nifti)),
    }
}

/// Form with an image whose objects go into a cohort.
#[derive(Debug, utoipa::ToSchema)]
#[allow(dead_code, reason = "only for the document")]
pub(in crate::api::v1) struct CohortSegmentForm {
    /// Parameters of the request; the first part.
    parameters: CohortSegmentRequest,
    /// Image: PNG, TIFF, NIfTI-1, NRRD or DICOM segmentation. Colours are read as luma.
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
///
/// A long computation becomes a job (202), as there. It adds the objects as if the request had come when it runs; its
/// result is this answer.
#[utoipa::path(post, path = "/v1/cohorts/{cohort}/segment", tag = "images",
    params(("cohort" = String, Path, description = "Id or name"), SegmentQuery, PreferHeader, RetryHeader, IfMatchHeader),
    request_body(content = CohortSegmentForm, content_type = "multipart/form-data"),
    responses(
        (status = 201, description = "One entry for each initial shape, in order; at least one object is stored", body = MembersAnswer),
        (status = 200, description = "Nothing is stored: all objects have failed, or it is a dry run", body = MembersOrEstimate),
        (status = 202, description = "The job that segments the objects and adds them", body = JobOutput, headers(("Location" = String))),
        (status = 404, description = "No such cohort or dictionary"),
        (status = 412, description = "The cohort has changed meanwhile"),
        (status = 409, description = "An external id belongs to another shape"),
        (status = 503, description = "Too many jobs are waiting, or too many bytes of their files")
    ))]
pub(in crate::api::v1) async fn segment_into_cohort(
    Caller(app): Caller,
    Path(key): Path<String>,
    Query(SegmentQuery { dry_run }): Query<SegmentQuery>,
    IfMatch(expected): IfMatch,
    prefer: Prefer,
    request: Request,
) -> Result<Response, Problem> {
    let cohort = catalogue::find(&app, &key).await?;
    let parts = read(&app, request).await?;
    let digests = Digests::of(&app, parts.clone()).await?;
    let app = app.with_body(digests.text().as_bytes());
    if let Some(response) = repeated(&app, prefer).await? {
        return Ok(response);
    }
    let asked = app.read::<CohortSegmentRequest>(parts.parameters.clone()).await?;
    let (mut asked, Storing { objects, store_failed, unit }) = asked.split(&cohort)?;
    let app = app.with_priority(priority_of(asked.priority.take())?);
    let (lengths, origin) = (Lengths::default(), Origin::of_parts(&app, &parts).await?);
    let membership =
        Membership { cohort, expected, objects, store_failed, digests, job: None, unit, lengths, origin };
    let look = |prepared: &mut Prepared| Ok(membership.look(prepared)?);
    let (posted, attributes) = Posted::new(&app, parts, asked, look).await?;
    added(&app, posted, (membership, attributes), prefer, dry_run).await
}

/// The answer to a request that was executed before.
async fn repeated(app: &App, prefer: Prefer) -> Result<Option<Response>, Problem> {
    match membership::done_before(app).await? {
        Some(Repeated::Answer(answer)) => Ok(Some(json(StatusCode::CREATED, &answer)?)),
        Some(Repeated::Job(id)) => of_job(app, jobs::find(app, &id).await?, prefer).await.map(Some),
        None => Ok(None),
    }
}

/// Segments the objects of a form and adds them to a cohort, or makes a job of that; a dry run predicts the cost.
async fn added(
    app: &App,
    posted: Posted,
    (mut membership, attributes): (Membership, Vec<ShapeInput>),
    prefer: Prefer,
    dry_run: bool,
) -> Result<Response, Problem> {
    membership.meet(posted.ready.unit())?;
    if dry_run {
        return Ok(estimated(posted.ready.estimate())?);
    }
    let work = posted.ready.work();
    if job::is_due(app, work.seconds(), prefer.respond_async) {
        let (submission, names) = (posted.submission(Shown::Numbers), membership::names(&attributes));
        let job = submission.submit_members(app, &membership, names).await?;
        return of_job(app, job, prefer).await;
    }
    let (worker, of_answer) = (app.clone(), membership.clone());
    let segment = move || of_answer.arriving(posted.ready.segment(&worker)?.answer, attributes);
    let arriving = app.pool.run_planned(Bytes::new(), move |_| Ok((work, segment))).await?;
    let (answer, is_stored) = membership.store(app, arriving).await?;
    Ok(json(if is_stored { StatusCode::CREATED } else { StatusCode::OK }, &answer)?)
}

/// The answer of a job that adds objects to a cohort, if it comes while the client waits, else the job.
async fn of_job(app: &App, job: Job, prefer: Prefer) -> Result<Response, Problem> {
    match waited(app, job, prefer).await? {
        Waited::Succeeded(job) => {
            let answer = job.result.unwrap_or_default();
            let is_stored = membership::is_stored(&answer);
            Ok(json(if is_stored { StatusCode::CREATED } else { StatusCode::OK }, &answer)?)
        }
        Waited::Else(response) => Ok(response),
    }
}

/// Members, or their predicted cost.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[serde(untagged)]
#[allow(dead_code, reason = "only for the document")]
pub(in crate::api::v1) enum MembersOrEstimate {
    /// Objects.
    Found(MembersAnswer),
    /// Cost.
    Estimated(SegmentEstimateAnswer),
}

/// Reads the parts of a form.
async fn read(app: &App, request: Request) -> Result<Parts, Problem> {
    let form = form::read(app, request, &parts::FILES).await?;
    let image = form.required("image")?;
    let (truth, mask) = (form.file("truth"), form.file("mask"));
    Ok(Parts { parameters: form.parameters, image, truth, mask })
}
