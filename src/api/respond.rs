//! Responses, computed and serialised on the thread pool so that a large body never blocks an async thread.

use axum::BoxError;
use axum::body::{Body, Bytes};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use futures_util::stream::{self, Stream, StreamExt};
use serde::Serialize;

use super::problem::Problem;
use crate::geometry::drawing::scene::Drawing;
use crate::geometry::representation::ShapeSpace;
use crate::geometry::texture::TexturedMesh;
use crate::service::app::memory::Purpose;
use crate::service::app::{App, ServiceError, Work};
use crate::service::shapes::mesh::mesh_of;
use crate::wire::matrix::{MatrixFormat, NamedMatrix};
use crate::wire::mesh::MeshFormat;
use crate::wire::picture::{PictureError, PictureFile};

/// The bytes of a file.
#[derive(Debug, utoipa::ToSchema)]
#[schema(value_type = String, format = Binary)]
#[allow(dead_code, reason = "only for the document")]
pub struct Binary(Vec<u8>);

/// Does work and writes the response.
type Answering = Box<dyn FnOnce(&App) -> Result<Response, ServiceError> + Send>;

/// Parses a body and plans the work of the request.
type Planning = Box<dyn FnOnce(&App, &[u8]) -> Result<Planned, ServiceError> + Send>;

/// Runs `work` on the pool and returns its response.
///
/// # Errors
/// The problem of the use case.
pub fn compute(
    app: App,
    work: impl FnOnce(&App) -> Result<Response, ServiceError> + Send + 'static,
) -> impl Future<Output = Result<Response, Problem>> + Send {
    compute_any(app, Box::new(work))
}

/// As [`compute`], for `work` that waits for nothing: short work is answered on this thread.
pub fn compute_unwaiting(
    app: App,
    work: impl FnOnce(&App) -> Result<Response, ServiceError> + Send + 'static,
) -> impl Future<Output = Result<Response, Problem>> + Send {
    compute_any_unwaiting(app, Box::new(work))
}

async fn compute_any_unwaiting(app: App, work: Answering) -> Result<Response, Problem> {
    let pool = app.pool.clone();
    Ok(pool.run_unwaiting(move || work(&app)).await?)
}

async fn compute_any(app: App, work: Answering) -> Result<Response, Problem> {
    let pool = app.pool.clone();
    Ok(pool.run(move || work(&app)).await?)
}

/// Planned work of a request, and the function that does it and writes the response.
pub type Planned = (Work, Answering);

/// Pairs `work` with the function `answer` that does it.
///
/// # Errors
/// None: it is the last step of a plan.
pub fn planned(
    work: Work,
    answer: impl FnOnce(&App) -> Result<Response, ServiceError> + Send + 'static,
) -> Result<Planned, ServiceError> {
    Ok((work, Box::new(answer)))
}

/// Parses `body` with `plan`, then computes the response on the lane that suits the planned work.
///
/// # Errors
/// The problem of the use case; work beyond the limit for a request.
pub fn compute_planned(
    app: App,
    body: Bytes,
    plan: impl FnOnce(&App, &[u8]) -> Result<Planned, ServiceError> + Send + 'static,
) -> impl Future<Output = Result<Response, Problem>> + Send {
    compute_any_planned(app, body, Box::new(plan))
}

async fn compute_any_planned(app: App, body: Bytes, plan: Planning) -> Result<Response, Problem> {
    let (pool, reader) = (app.pool.clone(), app.clone());
    let plan = move |body: &[u8]| {
        let (work, answer) = plan(&reader, body)?;
        Ok((work, move || answer(&app)))
    };
    Ok(pool.run_planned(body, plan).await?)
}

/// JSON response.
///
/// # Errors
/// [`ServiceError::Internal`] if a value cannot be serialised (a bug).
pub fn json(status: StatusCode, value: &impl Serialize) -> Result<Response, ServiceError> {
    let body = serde_json::to_vec(value).map_err(|error| ServiceError::Internal(error.to_string()))?;
    Ok((status, [(header::CONTENT_TYPE, "application/json")], body).into_response())
}

/// Picture of a drawing as a response.
///
/// # Errors
/// A picture of too many pixels.
pub fn picture(drawing: &Drawing, file: &PictureFile) -> Result<Response, ServiceError> {
    let bytes = file.write(drawing).map_err(|error| match error {
        PictureError::TooLarge { .. } => ServiceError::parameter("width", error.to_string()),
        PictureError::Render(_) => ServiceError::Internal(error.to_string()),
    })?;
    Ok(([(header::CONTENT_TYPE, file.format.media_type())], Body::from(bytes)).into_response())
}

/// Mesh of a shape; see [`mesh_of`].
///
/// # Errors
/// Shapes that are not surfaces, grids that form no mesh; as [`mesh_file`].
pub fn mesh(
    space: &ShapeSpace,
    control_points: &[f64],
    format: MeshFormat,
    grid: Option<[usize; 2]>,
) -> Result<Response, ServiceError> {
    mesh_file(format, mesh_of(space, control_points, grid)?)
}

/// Mesh file as a response.
///
/// # Errors
/// Coordinates beyond single precision, where the format has it.
pub fn mesh_file(format: MeshFormat, mesh: TexturedMesh) -> Result<Response, ServiceError> {
    Ok(file_of(format, format.write(mesh)?))
}

/// The bytes of a mesh file as a response.
pub fn file_of(format: MeshFormat, bytes: Vec<u8>) -> Response {
    ([(header::CONTENT_TYPE, format.media_type())], Body::from(bytes)).into_response()
}

/// Matrix, written while it is sent, which holds its memory until then.
///
/// # Errors
/// [`ServiceError::Overloaded`] if too many responses are still unread.
pub fn matrix(app: &App, matrix: NamedMatrix, format: MatrixFormat) -> Result<Response, ServiceError> {
    let held = app.memory.hold(Purpose::Answers, size_of_val(matrix.values.as_slice()))?;
    let pieces = matrix.pieces(format).map_err(|error| ServiceError::Internal(error.to_string()))?;
    let pieces = pieces.inspect(move |_| {
        let _held = &held;
    });
    Ok(([(header::CONTENT_TYPE, format.media_type())], streamed(stream::iter(pieces))).into_response())
}

/// A body that is sent as it comes. The encoder asks once more after its end, which not every stream allows.
pub fn streamed<P: Into<Bytes> + 'static, E: Into<BoxError> + 'static>(
    pieces: impl Stream<Item = Result<P, E>> + Send + 'static,
) -> Body {
    Body::from_stream(pieces.fuse())
}
