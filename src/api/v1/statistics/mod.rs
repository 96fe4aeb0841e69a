//! Statistics of posted shapes: projection onto a class, mean shape, alignment, functional PCA. Nothing is stored.

pub(in crate::api) mod matched;
pub(in crate::api) mod retrieval;
pub(in crate::api) mod sliding;

use axum::body::Bytes;
use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Serialize};

use crate::analysis::alignment::{AlignedShape, Alignment, Onto, Projection, unwhitened};
use crate::analysis::defaults::COMPONENTS;
use crate::analysis::factors::Estimator;
use crate::analysis::pca::{Components, UNCENTRED};
use crate::api::extract::{BesideFormat, Caller, Format, JsonBody, OnlyFormat, OnlyShapeFormat, ShapeFormat};
use crate::api::problem::Problem;
use crate::api::respond::{compute_planned, json, mesh, picture, planned};
use crate::api::v1::requests::batches::{Batch, PlannedResults, answer_batch, results};
#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::api::v1::requests::request_macros::{
    Caveats, MeanOutput, ShapeOutput, checked, rows, settings_request,
};
use crate::numeric::dense::Matrix;
use crate::service::app::{App, Limits, ServiceError};
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::draw::MAX_DRAWN;
use crate::service::shapes::names::InputNames;
use crate::service::shapes::outcome::OnError;
use crate::service::statistics::{self, CheckedSettings, Projected, Settings, Setup, Statistics};
use crate::wire::checked::{Checked, LARGE, take_given, take_or_default};
use crate::wire::fault::Fault;
use crate::wire::observed::Observed;
#[cfg(feature = "schema")]
use crate::wire::observed::ObservedEntry;
use crate::wire::picture::PictureFile;
use crate::wire::shape::{Points, ShapeInput};

settings_request! {
    /// Shapes to project.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 6, "generator": {"name": "trigonometric"}},
        "transformation": "similarity",
        "reference": {"points": [[2, 0], [1, 1], [-1, 1], [-2, 0], [-1, -1], [1, -1]]},
        "shapes": [{"points": [[5, 9], [3, 7], [3, 3], [5, 1], [7, 3], [7, 6]]}]
    }))]
    ProjectRequest {
        /// Shape that the others are compared with.
        #[schema(value_type = ShapeInput, required = true)]
        reference: ShapeInput, required;
        /// Class to project onto: that of the reference, or that of each shape. Default: `reference`.
        #[schema(value_type = Option<Onto>)]
        onto: Checked<Onto>;
    }
}

settings_request! {
    /// Shapes to average.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 6, "generator": {"name": "trigonometric"}},
        "transformation": "similarity",
        "shapes": [{"points": [[2, 0], [1, 1], [-1, 1], [-2, 0], [-1, -1], [1, -1]]}, {"points": [[5, 9], [3, 7], [3, 3], [5, 1], [7, 3], [7, 6]]}]
    }))]
    StatisticsRequest {
        /// Whether shapes unlike the majority count less or not at all: another organ, a mirrored or leaked one. At least five shapes.
        /// Default: false.
        #[schema(value_type = Option<bool>)]
        robust: Checked<bool>;
        /// The part of the shapes on which they are aligned: arcs `[from, to]` of curves; true or false for each landmark, knot of a surface or
        /// vertex. Shapes are compared as wholes in the poses that it gives, and their mean is the average of them. Points correspond as
        /// given, and not with `robust`. Default: the whole shape.
        #[schema(value_type = Option<Vec<ObservedEntry>>)]
        region: Checked<Option<Observed>, LARGE>;
        /// Whether to answer a basis of the mean space too. Default: false.
        #[schema(value_type = Option<bool>)]
        basis: Checked<bool>;
    }
}

settings_request! {
    /// Shapes to analyse.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 6, "generator": {"name": "trigonometric"}},
        "transformation": "similarity",
        "components": 2, "centre": true,
        "shapes": [{"points": [[2, 0], [1, 1], [-1, 1], [-2, 0], [-1, -1], [1, -1]]}, {"points": [[5, 9], [3, 7], [3, 3], [5, 1], [7, 3], [7, 6]]}, {"points": [[2, 1], [1, 2], [-1, 2], [-2, 1], [-1, -2], [1, -1]]}]
    }))]
    PcaRequest {
        /// Number of components. Default: 10.
        #[schema(value_type = Option<usize>, minimum = 1)]
        components: Checked<usize>;
        /// Whether shapes unlike the majority count less or not at all: another organ, a mirrored or leaked one. At least five shapes.
        /// Default: false.
        #[schema(value_type = Option<bool>)]
        robust: Checked<bool>;
        /// The part of the shapes on which they are aligned: arcs `[from, to]` of curves; true or false for each landmark, knot of a surface or
        /// vertex. Shapes are compared as wholes in the poses that it gives, and their mean is the average of them. Points correspond as
        /// given, and not with `robust`. Default: the whole shape.
        #[schema(value_type = Option<Vec<ObservedEntry>>)]
        region: Checked<Option<Observed>, LARGE>;
        /// Whether to subtract the arithmetic mean of the aligned shapes. Default: true. Without it the first component is the mean, as in
        /// the thesis.
        #[schema(value_type = Option<bool>)]
        centre: Checked<bool>;
        /// Whether aligned shapes are moved, at unit size, into the tangent space at their mean before components are computed. Default:
        /// true where the class removes size, unless `alignment` or `region` is given. Without `alignment` it is the projection, or
        /// `partial_procrustes` for `similarity` in three dimensions.
        #[schema(value_type = Option<bool>)]
        tangent: Checked<bool>;
        /// Whether to return the aligned shapes too. Default: true.
        #[schema(value_type = Option<bool>)]
        aligned: Checked<bool>;
    }
}

/// Projection of one shape.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct ProjectionOutput {
    /// Nearest member of the class.
    control_points: Points,
    /// Matrix `A`, row by row.
    matrix: Vec<Vec<f64>>,
    /// Offset `b`: the nearest member is `A r + b`.
    offset: Vec<f64>,
    /// Squared `L₂` distance to the nearest member.
    squared_distance: f64,
    /// Cosine between the two, about their mean positions if the class includes translations.
    correlation: f64,
}

impl ProjectionOutput {
    fn new(projection: Projection, dimension: usize) -> Self {
        Self {
            matrix: rows(&projection.matrix),
            control_points: Points::from_columns(projection.control_points, dimension),
            offset: projection.offset,
            squared_distance: projection.squared_distance,
            correlation: projection.correlation,
        }
    }
}

results! {
    /// Projections.
    ProjectAnswer with Caveats of ProjectResult: ProjectedShape with ProjectionOutput
}

/// Projects shapes onto the class of a reference, or the reference onto the classes of the shapes.
///
/// Exact, in closed form: the nearest member in the `L₂` sense over the whole curve.
///
/// Lines of NDJSON are shapes; the other fields of the request are parameters then.
#[utoipa::path(post, path = "/v1/project", tag = "statistics", params(BatchQuery),
    request_body(content((ProjectRequest = "application/json"), (ShapeInput = "application/x-ndjson"), (Binary = "application/octet-stream"))),
    responses(
        (status = 200, description = "One projection per shape, in order", content((ProjectAnswer = "application/json"), (ProjectResult = "application/x-ndjson")))
    ))]
pub(super) async fn project(Caller(app): Caller, batch: Batch) -> Result<Response, Problem> {
    answer_batch::<_, ProjectAnswer>(app, batch, ProjectRequest::plan).await
}

impl ProjectRequest {
    fn plan(mut self, app: &App, on_error: OnError) -> Result<PlannedResults<ProjectAnswer>, ServiceError> {
        let mut errors = Vec::new();
        let (settings, shapes) = self.take_settings(&mut errors);
        let onto = take_or_default(self.onto, "/onto", &mut errors);
        let whole = settings.zip(onto).zip(self.reference);
        let (((settings, onto), reference), shapes) = checked(whole, errors, shapes)?;
        let settings = settings.checked(&app.limits)?;
        let work = requests::project(Counts::new(&settings.representation, shapes.len() + 1, &app.limits));
        let names = InputNames::of_posted(&shapes);
        let find = move |app: &App| {
            let found = statistics::project(app, settings, onto, reference, (shapes, on_error))?;
            let Projected { setup, projections, mixed } = found;
            let dimension = setup.metric.dimension();
            let projections =
                projections.map(|_, projection| Ok(ProjectionOutput::new(projection, dimension)));
            Ok((projections, Caveats::from(mixed)))
        };
        Ok((work, names, Box::new(find)))
    }
}

/// Computes the mean shape.
///
/// The estimate is unbiased and needs no template: it is the mean of the subspaces of the shapes under the class. As
/// SVG: the mean in front of the aligned shapes. As OBJ, PLY, STL or glTF: the mesh of a mean surface.
#[utoipa::path(post, path = "/v1/mean", tag = "statistics", request_body = StatisticsRequest,
    params(ShapeFormatQuery, DrawingQuery),
    responses(
        (status = 200, description = "The mean", content((MeanOutput = "application/json"), (String = "image/svg+xml"), (Binary = "model/obj"), (Binary = "application/ply"), (Binary = "model/stl"), (Binary = "model/gltf-binary")))
    ))]
pub(super) async fn mean(
    Caller(app): Caller,
    OnlyShapeFormat(format): OnlyShapeFormat,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let write = |statistics: &Statistics, basis: bool| json(StatusCode::OK, &mean_output(statistics, basis));
    match format {
        ShapeFormat::Plain(format) => answer(app, format, body, write).await,
        ShapeFormat::Mesh(format, grid) => {
            let mesh = move |Statistics { setup, mean, .. }: &Statistics, _: bool| {
                mesh(&setup.space, &mean.control_points, format, grid)
            };
            answer(app, Format::Json, body, mesh).await
        }
    }
}

/// Aligns the shapes of a request and returns a drawing, or the response that `write` makes, with or without a basis of the mean
/// space.
async fn answer(
    app: App,
    format: Format,
    body: Bytes,
    write: impl Fn(&Statistics, bool) -> Result<Response, ServiceError> + Send + 'static,
) -> Result<Response, Problem> {
    compute_planned(app, body, move |app, body| {
        let (mut request, mut errors) = (app.parse::<StatisticsRequest>(body)?, Vec::new());
        let (settings, shapes) = request.take_settings(&mut errors);
        let robust = take_or_default(request.robust, "/robust", &mut errors);
        let basis = take_or_default(request.basis, "/basis", &mut errors).unwrap_or_default();
        let region = take_given(request.region, "/region", &mut errors).flatten();
        let (settings, shapes) = checked(by(settings, robust), errors, shapes)?;
        let settings = settings.checked(&app.limits)?;
        let counts = Counts::new(&settings.representation, shapes.len(), &app.limits);
        let drawn = if matches!(format, Format::Picture(_)) { shapes.len().min(MAX_DRAWN) } else { 0 };
        let work = requests::align_on(&settings, counts, region.is_some());
        let work = work + requests::draw(counts, drawn) + format.work();
        planned(work, move |app| {
            let statistics = statistics::align(app, settings, region.as_ref(), shapes)?;
            match format {
                Format::Picture(file) => draw(&statistics, &file),
                Format::Json => write(&statistics, basis),
            }
        })
    })
    .await
}

/// Settings with the estimator that is asked for.
fn by(settings: Option<Settings>, robust: Option<bool>) -> Option<Settings> {
    let (settings, robust) = settings.zip(robust)?;
    Some(Settings { estimator: Estimator::robust(robust), ..settings })
}

fn mean_output(statistics: &Statistics, basis: bool) -> MeanOutput {
    let Statistics { setup, mean, .. } = statistics;
    let basis = mean.basis.as_ref().filter(|_| basis).map(|basis| elements(setup, basis));
    let mut output = MeanOutput::new(mean, setup.metric.dimension());
    output.warnings.extend(statistics.mixed.clone());
    MeanOutput { basis, ..output }
}

/// Shapes in the columns of a whitened matrix.
fn elements(setup: &Setup, whitened: &Matrix) -> Vec<ShapeOutput> {
    let element = |column: &[f64]| ShapeOutput {
        control_points: Points::from_columns(unwhitened(&setup.metric, column), setup.metric.dimension()),
    };
    whitened.as_slice().chunks_exact(setup.metric.len()).map(element).collect()
}

fn draw(statistics: &Statistics, file: &PictureFile) -> Result<Response, ServiceError> {
    let title = format!("mean of {} shapes", statistics.mean.shapes);
    let Statistics { setup, mean, aligned, .. } = statistics;
    picture(&statistics::draw_mean(setup, &title, mean, aligned, None), file)
}

/// A shape aligned to the mean.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct AlignedOutput {
    /// Control points of the aligned shape.
    control_points: Points,
    /// Matrix `A`, row by row.
    matrix: Vec<Vec<f64>>,
    /// Offset `b`: the aligned shape is `A r + b`, where `r` is the shape as read, started at `shift`.
    offset: Vec<f64>,
    /// `L₂` distance to the mean.
    residual: f64,
    /// Cosine between the aligned shape and the mean.
    correlation: f64,
    /// Whether the match is a mirror image: the determinant of `A` is negative.
    reflected: bool,
    /// Index of the control point at which the aligned shape starts; under `cyclic` counted from the canonical start. 0 for surfaces.
    shift: u32,
    /// Motion of the parameters of a surface under `cyclic`; absent otherwise.
    #[serde(skip_serializing_if = "Option::is_none")]
    motion: Option<MotionOutput>,
    /// Whether the aligned shape is traversed in reverse.
    reversed: bool,
    /// `L₂` norm of the posted shape, about its mean position if the class includes translations.
    size: f64,
    /// Factor of the weight of the shape in the robust mean; absent without `robust`.
    #[serde(skip_serializing_if = "Option::is_none")]
    weight: Option<f64>,
    /// Where the shape is like the others: a number between 0 and 1 for each control point, small where it is damaged. Absent
    /// without `robust`.
    #[serde(skip_serializing_if = "Option::is_none")]
    point_weights: Option<Vec<f64>>,
}

impl AlignedOutput {
    fn new(setup: &Setup, aligned: &AlignedShape, size: f64) -> Self {
        let control_points = unwhitened(&setup.metric, &aligned.whitened);
        Self {
            control_points: Points::from_columns(control_points, setup.metric.dimension()),
            matrix: rows(&aligned.matrix),
            offset: aligned.offset.clone(),
            residual: aligned.residual,
            correlation: aligned.correlation,
            reflected: aligned.reflected(),
            shift: if aligned.moved.is_some() { 0 } else { aligned.placement.shift },
            motion: aligned.moved.map(|(motion, change)| MotionOutput { turns: motion.turns(), change }),
            reversed: aligned.placement.reversed,
            size,
            weight: None,
            point_weights: None,
        }
    }
}

/// How the parameters of a surface were moved to match the mean.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct MotionOutput {
    /// In turns: the rotation vector of the parameter sphere, in the axes of the direction with longitude `u` and colatitude `v`; the
    /// shifts of a cylinder (`u`) and of a torus (`u`, `v`), with ±½ as the third number if both directions are reversed.
    turns: [f64; 3],
    /// Relative change of the surface, which its space represents only nearly with moved parameters: root mean square distance
    /// halfway between knots, divided by that of the surface from its centroid.
    change: f64,
}

/// Mean and aligned shapes.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct AlignAnswer {
    #[serde(flatten)]
    mean: MeanOutput,
    /// One entry per shape, in request order.
    aligned: Vec<AlignedOutput>,
}

fn aligned_output(app: &App, statistics: &Statistics) -> Result<Vec<AlignedOutput>, ServiceError> {
    let shapes = statistics.aligned.iter().zip(&statistics.sizes);
    let mut shapes: Vec<AlignedOutput> =
        shapes.map(|(aligned, &size)| AlignedOutput::new(&statistics.setup, aligned, size)).collect();
    let robust = statistics.mean.robust.as_ref().zip(statistics.point_weights(app)?);
    if let Some((robust, points)) = robust {
        for ((shape, weight), points) in shapes.iter_mut().zip(&robust.factors).zip(points) {
            (shape.weight, shape.point_weights) = (Some(*weight), Some(points));
        }
    }
    Ok(shapes)
}

/// Aligns shapes to their mean.
#[utoipa::path(post, path = "/v1/align", tag = "statistics", request_body = StatisticsRequest,
    params(("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery),
    responses(
        (status = 200, description = "Mean and aligned shapes", content((AlignAnswer = "application/json"), (String = "image/svg+xml")))
    ))]
pub(super) async fn align(
    Caller(app): Caller,
    OnlyFormat(format): OnlyFormat,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let aligner = app.clone();
    answer(app, format, body, move |statistics, basis| {
        let aligned = aligned_output(&aligner, statistics)?;
        let answer = AlignAnswer { mean: mean_output(statistics, basis), aligned };
        json(StatusCode::OK, &answer)
    })
    .await
}

/// Functional principal components.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct PcaOutput {
    /// Arithmetic mean of the aligned shapes.
    mean: ShapeOutput,
    /// Eigenvalues `λ_i`, descending: sums of squared scores over the shapes.
    eigenvalues: Vec<f64>,
    /// Explained fractions `λ_i / Σ λ`, where the sum is over all components.
    explained: Vec<f64>,
    /// Eigenshapes, orthonormal in `L₂`; the control coordinate of largest magnitude is positive.
    eigenshapes: Vec<ShapeOutput>,
    /// Scores: one list per shape, one number per component.
    scores: Vec<Vec<f64>>,
    /// `‖r − r̂‖²/(‖r‖‖r̂‖)` for every aligned shape and its reconstruction from these components.
    reconstruction_errors: Vec<f64>,
    /// Whether the arithmetic mean was subtracted.
    centre: bool,
    /// Alignment method.
    alignment: Alignment,
    /// Whether aligned shapes were moved, at unit size, into the tangent space at their mean; `aligned` lists them before that.
    tangent: bool,
}

/// Mean shape and principal components.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(super) struct PcaAnswer {
    #[serde(flatten)]
    mean: MeanOutput,
    /// Functional principal components.
    pca: PcaOutput,
    /// One entry per shape, in request order; absent if `aligned` is false.
    #[serde(skip_serializing_if = "Option::is_none")]
    aligned: Option<Vec<AlignedOutput>>,
}

impl PcaAnswer {
    fn new(statistics: &Statistics, pca: Components, aligned: Option<Vec<AlignedOutput>>) -> Self {
        let mut mean = mean_output(statistics, false);
        if !pca.pca.centred {
            mean.warnings.push(UNCENTRED.to_owned());
        }
        Self { mean, pca: PcaOutput::new(statistics, pca), aligned }
    }
}

impl PcaOutput {
    fn new(statistics: &Statistics, components: Components) -> Self {
        let metric = &statistics.setup.metric;
        let shape = |whitened: &[f64]| ShapeOutput {
            control_points: Points::from_columns(unwhitened(metric, whitened), metric.dimension()),
        };
        let (alignment, tangent) = (statistics.setup.alignment(), statistics.tangent);
        let Components { pca, scores, errors, .. } = components;
        Self {
            alignment,
            tangent,
            mean: shape(&pca.mean),
            eigenshapes: pca.eigenshapes.column_iter().map(|xi| shape(xi.as_slice())).collect(),
            eigenvalues: pca.eigenvalues,
            explained: pca.explained,
            scores,
            reconstruction_errors: errors,
            centre: pca.centred,
        }
    }
}

/// Selects the mode to draw.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
#[serde(deny_unknown_fields)]
pub(super) struct ModeQuery {
    /// Component to draw, from 1. Default: 1.
    #[param(minimum = 1)]
    component: Option<usize>,
    /// Number of standard deviations to draw, at most 10. Default: 2.
    #[param(minimum = 0, maximum = 10)]
    sigma: Option<f64>,
}

/// Aligns shapes and computes functional principal components.
///
/// As SVG: one mode, drawn as the mean plus and minus `sigma` standard deviations of the scores.
#[utoipa::path(post, path = "/v1/pca", tag = "statistics", request_body = PcaRequest,
    params(ModeQuery, ("format" = Option<String>, Query, description = "`json`, `svg` or `png`"), DrawingQuery),
    responses(
        (status = 200, description = "Mean and components", content((PcaAnswer = "application/json"), (String = "image/svg+xml")))
    ))]
pub(super) async fn pca(
    Caller(app): Caller,
    format: Format,
    BesideFormat(mode): BesideFormat<ModeQuery>,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute_planned(app, body, move |app, body| {
        let (of, sigma) = (mode.component.unwrap_or(1), mode.sigma()?);
        let PcaInput { settings, tangent, region, shapes, components, centre, aligned } =
            app.parse::<PcaRequest>(body)?.take(&app.limits)?;
        let counts = Counts::new(&settings.representation, shapes.len(), &app.limits);
        let work = requests::align_on(&settings, counts, region.is_some())
            + requests::components(counts, components);
        planned(work + format.work(), move |app| {
            let statistics = statistics::align(app, settings, region.as_ref(), shapes)?.moved(tangent);
            let pca = statistics::pca(app, &statistics, components, centre)?;
            if let Format::Picture(file) = format {
                return picture(&statistics::draw_mode(&statistics, &pca, of, sigma)?, &file);
            }
            let aligned = aligned.then(|| aligned_output(app, &statistics)).transpose()?;
            json(StatusCode::OK, &PcaAnswer::new(&statistics, pca, aligned))
        })
    })
    .await
}

/// The checked parts of a [`PcaRequest`].
struct PcaInput {
    settings: CheckedSettings,
    tangent: bool,
    region: Option<Observed>,
    shapes: Vec<ShapeInput>,
    components: usize,
    centre: bool,
    aligned: bool,
}

impl PcaRequest {
    fn take(mut self, limits: &Limits) -> Result<PcaInput, ServiceError> {
        let mut errors = Vec::new();
        let by_name = self.alignment.is_some();
        let (settings, shapes) = self.take_settings(&mut errors);
        let tangent = take_given(self.tangent, "/tangent", &mut errors);
        let components = take_given(self.components, "/components", &mut errors).unwrap_or(COMPONENTS);
        let centre = take_given(self.centre, "/centre", &mut errors).unwrap_or(true);
        let aligned = take_given(self.aligned, "/aligned", &mut errors).unwrap_or(true);
        if components == 0 {
            errors.push(Fault::new("/components", "expected at least 1, got 0"));
        }
        let robust = take_or_default(self.robust, "/robust", &mut errors);
        let region = take_given(self.region, "/region", &mut errors).flatten();
        let (mut settings, shapes) = checked(by(settings, robust), errors, shapes)?;
        let tangent = match &region {
            // Shapes that are aligned on a part have no common size.
            Some(_) => tangent.unwrap_or_default(),
            None => settings.align_for_components(by_name, tangent)?,
        };
        if region.is_some() && tangent {
            return Err(ServiceError::invalid("/tangent", "expected false beside a region, got true"));
        }
        let settings = settings.checked(limits)?;
        Ok(PcaInput { settings, tangent, region, shapes, components, centre, aligned })
    }
}

impl ModeQuery {
    fn sigma(&self) -> Result<f64, ServiceError> {
        let sigma = self.sigma.unwrap_or(2.0);
        if (0.0..=10.0).contains(&sigma) {
            return Ok(sigma);
        }
        Err(ServiceError::parameter("sigma", format!("expected a number between 0 and 10, got {sigma}")))
    }
}
