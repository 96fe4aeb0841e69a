//! Evaluation, measures and resampling of posted curves and surfaces. Evaluation returns points, derivatives and frames at
//! given parameters; measures are lengths, areas, volumes, energies and distances; resampling spaces the points of raw
//! contours equally. Nothing is stored.

#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::wire::fault::Fault;
use axum::http::StatusCode;
use axum::response::Response;
use serde::{Deserialize, Serialize};

use crate::api::extract::{Caller, Format, JsonBody, NoQuery, OnlyShapeFormat, ShapeFormat};
use crate::api::problem::Problem;
use crate::api::respond::{Planned, compute_planned, json, mesh_file, picture, planned};
use crate::api::v1::requests::batches::{
    Batch, Entry, FailedShape, InputShape, PlannedResults, answer_batch, result_list,
};
use crate::api::v1::requests::request_macros::{checked, shapes_request};
use crate::geometry::capability::domain::Domain;
use crate::geometry::capability::measure::{Measures, ReferenceDistances, SetDistances};
use crate::geometry::capability::sample::{Derivative, Evaluation, Frames, Parameters};
use crate::geometry::measures::{CurveMeasures, Orientation};
use crate::geometry::surface::field::{AffineField, FieldTerm, PolynomialField, VectorField};
use crate::geometry::surface::measures::SurfaceMeasures;
use crate::service::app::{App, Limits, ServiceError, Work};
use crate::service::cohorts::catalogue::{text_faults, word_of_unit};
use crate::service::cost::requests::{self, Counts};
use crate::service::shapes::blocks::{Layers, pointed};
use crate::service::shapes::draw::MAX_DRAWN;
use crate::service::shapes::evaluate::{EvaluateTask, Evaluated};
use crate::service::shapes::measure::MeasureTask;
use crate::service::shapes::names::InputNames;
use crate::service::shapes::outcome::OnError;
use crate::service::shapes::resample::{self, Resampled, Start};
use crate::wire::checked::{Checked, List, Raw, document, take_given, take_or_default};
use crate::wire::shape::{Points, ShapeInput};

shapes_request! {
    /// Curves or surfaces to evaluate.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 4, "generator": {"name": "trigonometric"}},
        "shapes": [{"points": [[2, 0], [0, 1], [-2, 0], [0, -1]]}], "samples": 8, "derivatives": 1
    }))]
    EvaluateRequest {
        /// Number of equally spaced parameters of curves, from `u = 0`; on open curves up to `u = 1`. Default: 100, unless
        /// `parameters` is given.
        #[schema(value_type = Option<usize>, minimum = 1)]
        samples: Checked<usize>;
        /// Numbers of equally spaced parameters of surfaces along `u` and `v`, from 0; along open directions up to 1. Default:
        /// two per interval between knots.
        #[schema(value_type = Option<[usize; 2]>, min_items = 2, max_items = 2)]
        grid: Checked<[usize; 2]>;
        /// Explicit parameters in place of `samples` or `grid`: values `u` for curves, pairs `[u, v]` for surfaces. Closed
        /// directions take them modulo 1, open ones from 0 to 1.
        #[schema(value_type = Option<ParameterList>)]
        parameters: Raw;
        /// Highest order of derivatives to return, 0 to 2. Default: 0.
        #[schema(value_type = Option<usize>, maximum = 2)]
        derivatives: Checked<usize>;
        /// Whether to return tangents, normals and curvatures. Default: false.
        #[schema(value_type = Option<bool>)]
        frames: Checked<bool>;
    }
}

/// Parameters at which curves or surfaces are evaluated.
#[derive(utoipa::ToSchema)]
#[serde(untagged)]
#[allow(dead_code, reason = "only for the document")]
pub(in crate::api::v1) enum ParameterList {
    /// Values `u` on curves.
    Curve(Vec<f64>),
    /// Pairs `[u, v]` on surfaces.
    Surface(Vec<[f64; 2]>),
}

/// Values of one curve or surface.
#[derive(Debug, Default, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct EvaluationOutput {
    /// Points on the shape; for surfaces on a grid, nested lists `[u][v]` of points.
    #[schema(value_type = PointsOrGrid)]
    points: Option<Points>,
    /// `dr/du`; present if `derivatives` is at least 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    first: Option<Points>,
    /// `d²r/du²`; present if `derivatives` is 2. At knots the right limit, at the end of an open curve the left one.
    #[serde(skip_serializing_if = "Option::is_none")]
    second: Option<Points>,
    /// `∂σ/∂u` of a surface; present if `derivatives` is at least 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<PointsOrGrid>)]
    u: Option<Points>,
    /// `∂σ/∂v` of a surface; present if `derivatives` is at least 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<PointsOrGrid>)]
    v: Option<Points>,
    /// `∂²σ/∂u²` of a surface; present if `derivatives` is 2.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<PointsOrGrid>)]
    uu: Option<Points>,
    /// `∂²σ/∂u∂v` of a surface; present if `derivatives` is 2.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<PointsOrGrid>)]
    uv: Option<Points>,
    /// `∂²σ/∂v²` of a surface; present if `derivatives` is 2.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<PointsOrGrid>)]
    vv: Option<Points>,
    /// Unit tangents of curves, if `frames` is set; null where the curve has no direction.
    #[serde(skip_serializing_if = "Option::is_none")]
    tangents: Option<Vec<Option<Vec<f64>>>>,
    /// Unit normals, if `frames` is set. Planar curves: to the left of the tangent. Curves in space: towards the centre of
    /// curvature, null where the curve is straight. Surfaces: outwards, in the order of the points with `v` fastest; null
    /// where there is no tangent plane.
    #[serde(skip_serializing_if = "Option::is_none")]
    normals: Option<Vec<Option<Vec<f64>>>>,
    /// Curvatures in 1/length: positive for left turns in the plane, never negative in space.
    #[serde(skip_serializing_if = "Option::is_none")]
    curvatures: Option<Vec<Option<f64>>>,
    /// Principal curvatures of surfaces in 1/length, the larger one first; negative where the surface bends away from its
    /// normal; null at poles and where there is no tangent plane.
    #[serde(skip_serializing_if = "Option::is_none")]
    principal_curvatures: Option<Vec<Option<[f64; 2]>>>,
}

impl From<Evaluation> for EvaluationOutput {
    fn from(Evaluation { dimension, columns, derivatives, frames }: Evaluation) -> Self {
        let mut output = Self::default();
        for (derivative, values) in derivatives {
            let points = Points::from_columns(values, dimension).in_grid(columns);
            *output.field(derivative) = Some(points);
        }
        if let Some(Frames { tangents, normals, curvatures, principal_curvatures }) = frames {
            let normals = Some(normals);
            return Self { tangents, normals, curvatures, principal_curvatures, ..output };
        }
        output
    }
}

impl EvaluationOutput {
    fn field(&mut self, derivative: Derivative) -> &mut Option<Points> {
        match derivative {
            Derivative::Value => &mut self.points,
            Derivative::First => &mut self.first,
            Derivative::Second => &mut self.second,
            Derivative::U => &mut self.u,
            Derivative::V => &mut self.v,
            Derivative::Uu => &mut self.uu,
            Derivative::Uv => &mut self.uv,
            Derivative::Vv => &mut self.vv,
        }
    }
}

/// Evaluations, one entry per shape, in request order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct EvaluateAnswer {
    /// One entry per curve or surface.
    evaluations: Vec<EvaluationOutput>,
    /// Triangles between the points of subdivision surfaces, the same for all of them.
    #[serde(skip_serializing_if = "Option::is_none")]
    faces: Option<Vec<[u32; 3]>>,
}

/// Evaluates curves or surfaces and their derivatives; for subdivision surfaces, the mesh at their level.
///
/// As SVG: a drawing of the shapes. As OBJ, PLY, STL or glTF: the mesh of one surface at its `grid` or level.
#[utoipa::path(post, path = "/v1/evaluate", tag = "curves", request_body = EvaluateRequest,
    params(ShapeFormatQuery, DrawingQuery),
    responses(
        (status = 200, description = "Points and derivatives", content((EvaluateAnswer = "application/json"), (String = "image/svg+xml"), (Binary = "model/obj"), (Binary = "application/ply"), (Binary = "model/stl"), (Binary = "model/gltf-binary")))
    ))]
pub(in crate::api::v1) async fn evaluate(
    Caller(app): Caller,
    OnlyShapeFormat(format): OnlyShapeFormat,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    let plan = move |app: &App, body: &[u8]| app.parse::<EvaluateRequest>(body)?.plan(app, format);
    compute_planned(app, body, plan).await
}

impl EvaluateRequest {
    fn plan(mut self, app: &App, format: ShapeFormat) -> Result<Planned, ServiceError> {
        let mut errors = Vec::new();
        let (settings, shapes) = self.take_shapes(&mut errors);
        let domain = settings.as_ref().map(|(representation, _)| representation.domain());
        let samples = take_given(self.samples, "/samples", &mut errors);
        let grid = take_given(self.grid, "/grid", &mut errors);
        let parameters = take_parameters(domain, samples, grid, self.parameters, &mut errors);
        let order = take_or_default(self.derivatives, "/derivatives", &mut errors);
        let frames = take_or_default(self.frames, "/frames", &mut errors);
        let wanted = settings.zip(parameters).zip(order.zip(frames));
        let ((((representation, correspondence), parameters), (order, frames)), shapes) =
            checked(wanted, errors, shapes)?;
        let representation = app.admit(representation)?;
        let layers = Layers::of_shapes(app, representation, &shapes)?;
        let task = EvaluateTask { layers, correspondence, parameters, order, frames };
        let work = evaluate_work(&task, shapes.len(), format, &app.limits) + format.work();
        planned(work, move |app| match format {
            ShapeFormat::Plain(Format::Picture(file)) => picture(&task.drawing(app, shapes)?, &file),
            ShapeFormat::Mesh(format, grid) => mesh_file(format, task.mesh(app, shapes, grid)?),
            ShapeFormat::Plain(Format::Json) => {
                let Evaluated { evaluations, faces } = task.values(app, shapes)?;
                let evaluations = evaluations.into_iter().map(EvaluationOutput::from).collect();
                json(StatusCode::OK, &EvaluateAnswer { evaluations, faces })
            }
        })
    }
}

/// Predicted work of evaluating `shapes` shapes.
fn evaluate_work(task: &EvaluateTask, shapes: usize, format: ShapeFormat, limits: &Limits) -> Work {
    let EvaluateTask { layers, parameters, order, frames, .. } = task;
    let (representation, counts) = (layers.coarse(), Counts::new(layers.finest(), shapes, limits));
    let prepared = requests::grids(counts, layers.count());
    let values = match (parameters, format) {
        (Some(_), ShapeFormat::Plain(Format::Picture(_))) => requests::draw(counts, shapes.min(MAX_DRAWN)),
        (Some(_), ShapeFormat::Mesh(_, grid)) => requests::mesh(grid.unwrap_or([500, 500])),
        _ => requests::values(representation, counts, parameters.as_ref(), (*order, *frames), limits),
    };
    prepared + values
}

/// Default number of places on a curve.
const USUAL_SAMPLES: usize = 100;

/// Takes `samples`, `grid` and `parameters`, whichever apply to the domain; `Some(None)` for the vertices of refined
/// meshes, `None` for refused fields.
fn take_parameters(
    domain: Option<Domain>,
    samples: Option<usize>,
    grid: Option<[usize; 2]>,
    parameters: Option<Raw>,
    errors: &mut Vec<Fault>,
) -> Option<Option<Parameters>> {
    let given = [samples.is_some(), grid.is_some(), parameters.is_some()];
    if domain == Some(Domain::Vertices) {
        let fields = ["/samples", "/grid", "/parameters"].into_iter().zip(given).filter(|(_, given)| *given);
        errors.extend(fields.map(|(pointer, _)| {
            Fault::new(
                pointer,
                "this field belongs to shapes with parameters: a subdivision surface has the vertices of its \
                 level",
            )
        }));
        return Some(None);
    }
    let extent = match domain {
        Some(Domain::Sheet { extent, .. }) => Some(extent),
        _ => None,
    };
    let refused = match (extent.is_some(), given) {
        (true, [true, ..]) => Some(("/samples", "this field belongs to curves: surfaces have a grid")),
        (false, [_, true, _]) => Some(("/grid", "this field belongs to surfaces: curves have samples")),
        (_, [true, _, true]) => Some(("/parameters", "expected either parameters or samples, got both")),
        (_, [_, true, true]) => Some(("/parameters", "expected either parameters or grid, got both")),
        _ => None,
    };
    if let Some((pointer, detail)) = refused {
        errors.push(Fault::new(pointer, detail));
        return None;
    }
    let found = match (extent, parameters) {
        (None, None) => Parameters::Equidistant(samples.unwrap_or(USUAL_SAMPLES)),
        (Some(extent), None) => Parameters::Grid(grid.unwrap_or_else(|| extent.usual_grid())),
        (None, Some(value)) => Parameters::At(value.read_large("/parameters", errors)?),
        (Some(_), Some(value)) => Parameters::Pairs(value.read_large("/parameters", errors)?),
    };
    Some(Some(found))
}

shapes_request! {
    /// Curves or surfaces to measure.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 4, "generator": {"name": "trigonometric"}},
        "length_unit": "mm",
        "reference": {"points": [[1, 0], [0, 1], [-1, 0], [0, -1]]},
        "shapes": [{"points": [[2, 0], [0, 1], [-2, 0], [0, -1]]}]
    }))]
    MeasureRequest {
        /// Unit of the coordinates, one of those of cohorts, copied to the response.
        #[schema(value_type = Option<String>)]
        length_unit: Checked<Option<String>>;
        /// Shape in the same representation to which distances are measured.
        #[schema(value_type = Option<ShapeInput>)]
        reference: ShapeInput;
        /// Field whose flux through surfaces is measured: affine, `F(r) = A r + b`, or a polynomial of degree 8 or less.
        #[schema(value_type = Option<FlowField>)]
        field: Checked<FieldInput>;
    }
}

/// Field whose flux is measured.
#[derive(utoipa::ToSchema)]
#[serde(untagged)]
#[allow(dead_code, reason = "only for the document")]
pub(in crate::api::v1) enum FlowField {
    /// `F(r) = A r + b`.
    Affine(AffineField),
    /// `F(r) = Σ f x^i y^j z^k`.
    Polynomial(PolynomialFlow),
}

/// Polynomial vector field.
#[derive(utoipa::ToSchema)]
#[allow(dead_code, reason = "only for the document")]
pub(in crate::api::v1) struct PolynomialFlow {
    /// Terms of the sum.
    #[schema(max_items = 165)]
    terms: Vec<FieldTerm>,
}

/// A field as posted: `matrix` and `offset`, or `terms`.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::api::v1) struct FieldInput {
    matrix: Option<[[f64; 3]; 3]>,
    offset: Option<[f64; 3]>,
    terms: Option<Vec<FieldTerm>>,
}

impl FieldInput {
    /// The field; faults go to `errors` below `/field`.
    fn take(self, errors: &mut Vec<Fault>) -> Option<VectorField> {
        match (self.matrix, self.offset, self.terms) {
            (Some(matrix), Some(offset), None) => Some(AffineField { matrix, offset }.into()),
            (None, None, Some(terms)) => match PolynomialField::new(terms) {
                Ok(field) => Some(VectorField::Polynomial(field)),
                Err(faults) => {
                    let faults = faults.into_iter().map(|fault| fault.below("/field/terms"));
                    errors.extend(faults.map(|fault| Fault::new(fault.field, fault.detail)));
                    None
                }
            },
            (None, None, None) => {
                errors.push(Fault::new("/field", "expected matrix and offset, or terms, got neither"));
                None
            }
            (_, _, Some(_)) => {
                errors.push(Fault::new(
                    "/field/terms",
                    "expected either matrix and offset, or terms, got both",
                ));
                None
            }
            (matrix, _, None) => {
                let missing = if matrix.is_none() { "matrix" } else { "offset" };
                errors.push(Fault::new(format!("/field/{missing}"), "required field is missing"));
                None
            }
        }
    }
}

/// Axis-aligned bounding box.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct BoundingBox {
    /// Smallest coordinates, one per axis.
    min: Vec<f64>,
    /// Largest coordinates, one per axis.
    max: Vec<f64>,
}

/// Measures of one shape.
#[derive(Debug)]
pub(in crate::api::v1) enum MeasureOutput {
    /// Measures of a curve.
    Curve(Box<CurveMeasureOutput>),
    /// Measures of a surface.
    Surface(Box<SurfaceMeasureOutput>),
}

/// Measures of one surface. Fields that need an enclosed volume are null on sheets and on one-sided surfaces.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct SurfaceMeasureOutput {
    /// Enclosed volume, exact: of spheres, tori, and cylinders with flat lids.
    volume: Option<f64>,
    /// Enclosed volume, positive when the normals point outwards.
    signed_volume: Option<f64>,
    /// Surface area, without lids.
    area: f64,
    /// Estimated error of the area; for subdivision surfaces, the difference from the area of the limit surface.
    area_error: f64,
    /// Centroid of the enclosed volume; for sheets, of the area.
    centroid: [f64; 3],
    /// Centroid of the surface area.
    sheet_centroid: [f64; 3],
    /// Mean position over the parameters.
    mean_position: [f64; 3],
    /// Bounding box of the points at the knots and the quadrature nodes.
    bounding_box: BoundingBox,
    /// `36πV²/A³`, with the area of the whole boundary (cylinders: including lids). 1 for a ball, less for any other body;
    /// null without volume.
    sphericity: Option<f64>,
    /// Whether the surface intersects or overlaps itself. Checked on a mesh with one cell per interval between knots, at
    /// least 8 and at most 48 along each direction, or on the finest level with at most 20 000 faces. Null if undecided.
    self_intersecting: Option<bool>,
    /// `∯ ⟨F, n⟩ dA`, the flux of `field` through the surface, if a field is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    flux: Option<f64>,
    /// Distance to the reference, if one is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    distances: Option<SurfaceDistancesOutput>,
    /// Limitations of the measures.
    warnings: Vec<String>,
}

/// Distance between two surfaces, in the unit of their points.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct SurfaceDistancesOutput {
    /// `(∬ |σ − σ_ref|² du dv)^½`, exact: the distance as functions of the parameters.
    l2: f64,
}

impl SurfaceMeasureOutput {
    fn new(measures: SurfaceMeasures, others: &Measures) -> Self {
        let signed_volume = measures.enclosed.map(|enclosed| enclosed.signed_volume);
        let [min, max] = measures.bounding_box.map(Vec::from);
        Self {
            volume: signed_volume.map(f64::abs),
            signed_volume,
            area: measures.area,
            area_error: measures.area_error,
            centroid: measures
                .enclosed
                .and_then(|enclosed| enclosed.centroid)
                .unwrap_or(measures.sheet_centroid),
            sheet_centroid: measures.sheet_centroid,
            mean_position: measures.mean_position,
            bounding_box: BoundingBox { min, max },
            sphericity: measures.sphericity(),
            self_intersecting: others.self_intersecting,
            flux: others.flux,
            distances: others.distances.map(|distances| SurfaceDistancesOutput { l2: distances.l2 }),
            warnings: others.warnings.clone(),
        }
    }
}

/// Measures of one curve. Fields that need a closed planar curve, or a smooth one, are null on others.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct CurveMeasureOutput {
    /// Enclosed area of a closed planar curve, exact.
    area: Option<f64>,
    /// Enclosed area, positive for counter-clockwise curves (y up).
    signed_area: Option<f64>,
    /// Centroid of the enclosed area; null if the curve encloses none.
    centroid: Option<[f64; 2]>,
    /// Second moments of the enclosed area about its centroid, `∬ (x − x̄)(x − x̄)ᵀ dA`.
    second_moments: Option<[[f64; 2]; 2]>,
    /// Mean position along the parameter.
    mean_position: Vec<f64>,
    /// Length of the curve, with a relative error of 1e-10.
    length: f64,
    /// Length of a closed curve; null for open ones.
    perimeter: Option<f64>,
    /// Bounding box of the curve, not of its control points.
    bounding_box: BoundingBox,
    /// Orientation of a closed planar curve.
    orientation: Option<Orientation>,
    /// Whether a planar curve crosses or touches itself.
    self_intersecting: Option<bool>,
    /// `∫ |r'|² du`, exact.
    stretching_energy: f64,
    /// `∫ |r''|² du`, exact; null for curves with corners.
    bending_energy: Option<f64>,
    /// `∫ |κ| dl` in radians; null for curves with corners or with points without direction.
    total_curvature: Option<f64>,
    /// `∫ κ dl` in radians, counter-clockwise positive; planar curves only.
    turning: Option<f64>,
    /// Distances to the reference, if one is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    distances: Option<DistancesOutput>,
    /// Limitations of the measures.
    warnings: Vec<String>,
}

/// Distances between two curves, in the unit of their points.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct DistancesOutput {
    /// `(∫ |r − s|² du)^½`, exact: the distance as functions of the parameter.
    l2: f64,
    /// Root mean square distance to the nearest point of the other curve, over both curves.
    symmetric_l2: f64,
    /// Largest distance to the nearest point of the other curve, over both curves.
    hausdorff: f64,
}

impl DistancesOutput {
    fn new(ReferenceDistances { l2, as_sets }: ReferenceDistances) -> Option<Self> {
        let SetDistances { symmetric, hausdorff } = as_sets?;
        Some(Self { l2, symmetric_l2: symmetric, hausdorff })
    }
}

/// Measured curve.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct MeasuredCurve {
    #[serde(flatten)]
    shape: InputShape,
    #[serde(flatten)]
    measures: CurveMeasureOutput,
}

/// Measured surface.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct MeasuredSurface {
    #[serde(flatten)]
    shape: InputShape,
    #[serde(flatten)]
    measures: SurfaceMeasureOutput,
}

/// Entry of an input shape: its measures, or the reason why there are none.
#[derive(Debug, Serialize, utoipa::ToSchema)]
#[serde(untagged)]
pub(in crate::api::v1) enum MeasureResult {
    /// Measures of a curve.
    Curve(Box<MeasuredCurve>),
    /// Measures of a surface.
    Surface(Box<MeasuredSurface>),
    /// Without measures.
    Failed(FailedShape),
}

impl From<Entry<MeasureOutput>> for MeasureResult {
    fn from(entry: Entry<MeasureOutput>) -> Self {
        match entry {
            Ok((shape, MeasureOutput::Curve(measures))) => {
                Self::Curve(Box::new(MeasuredCurve { shape, measures: *measures }))
            }
            Ok((shape, MeasureOutput::Surface(measures))) => {
                Self::Surface(Box::new(MeasuredSurface { shape, measures: *measures }))
            }
            Err(failed) => Self::Failed(failed),
        }
    }
}

/// Unit of measures.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct MeasureUnit {
    /// Unit of lengths; areas are in its square.
    length_unit: Option<String>,
}

result_list! {
    /// Measures.
    MeasureAnswer with MeasureUnit of MeasureResult for MeasureOutput
}

impl MeasureOutput {
    /// Measures of a curve or a surface; `None` for points, which have none.
    fn new(mut measures: Measures) -> Option<Self> {
        match (measures.line.take(), measures.sheet.take()) {
            (Some(line), _) => Some(Self::Curve(Box::new(CurveMeasureOutput::new(line, &measures)))),
            (_, Some(sheet)) => Some(Self::Surface(Box::new(SurfaceMeasureOutput::new(sheet, &measures)))),
            (None, None) => None,
        }
    }
}

impl CurveMeasureOutput {
    fn new(measures: CurveMeasures, others: &Measures) -> Self {
        let (min, max) = measures.bounding_box;
        let enclosed = measures.enclosed.as_ref();
        Self {
            area: enclosed.map(|enclosed| enclosed.signed_area.abs()),
            signed_area: enclosed.map(|enclosed| enclosed.signed_area),
            centroid: enclosed.and_then(|enclosed| enclosed.centroid),
            second_moments: enclosed.and_then(|enclosed| enclosed.second_moments),
            mean_position: measures.mean_position,
            length: measures.length,
            perimeter: measures.closed.then_some(measures.length),
            bounding_box: BoundingBox { min, max },
            orientation: enclosed.map(|enclosed| enclosed.orientation),
            self_intersecting: others.self_intersecting,
            stretching_energy: measures.stretching_energy,
            bending_energy: measures.bending_energy,
            total_curvature: measures.total_curvature,
            turning: measures.turning,
            distances: others.distances.and_then(DistancesOutput::new),
            warnings: others.warnings.clone(),
        }
    }
}

/// Measures curves or surfaces.
///
/// Curves: area, moments, length, curvature, energies, bounding box, orientation, self-intersection, and the distances to a
/// reference. Surfaces: volume, area, centroids, bounding box, the flux of a field, and the distance to a reference.
///
/// Lines of NDJSON are shapes; the other fields of the request are parameters then.
#[utoipa::path(post, path = "/v1/measure", tag = "curves", params(BatchQuery),
    request_body(content((MeasureRequest = "application/json"), (ShapeInput = "application/x-ndjson"), (Binary = "application/octet-stream"))),
    responses(
        (status = 200, description = "Measures of each shape, in order", content((MeasureAnswer = "application/json"), (MeasureResult = "application/x-ndjson")))
    ))]
pub(in crate::api::v1) async fn measure(Caller(app): Caller, batch: Batch) -> Result<Response, Problem> {
    answer_batch::<_, MeasureAnswer>(app, batch, MeasureRequest::plan).await
}

impl MeasureRequest {
    fn plan(mut self, app: &App, on_error: OnError) -> Result<PlannedResults<MeasureAnswer>, ServiceError> {
        let mut errors = Vec::new();
        let (settings, shapes) = self.take_shapes(&mut errors);
        let length_unit = take_given(self.length_unit, "/length_unit", &mut errors).flatten();
        let unit_faults = text_faults(None, None, length_unit.as_deref());
        errors.extend(unit_faults.into_iter().map(|fault| Fault::new(fault.pointer, fault.detail)));
        let length_unit = word_of_unit(length_unit);
        let field = take_given(self.field, "/field", &mut errors);
        let field = field.and_then(|field| field.take(&mut errors));
        if let (Some(_), Some((representation, _))) = (&field, &settings)
            && !representation.domain().is_surface()
        {
            errors.push(Fault::new("/field", "flow is computed for surfaces only"));
        }
        let ((representation, correspondence), shapes) = checked(settings, errors, shapes)?;
        let representation = app.admit(representation)?;
        let reference = self.reference.iter().map(|shape| ("/reference".to_owned(), shape));
        let layers = Layers::new(app, representation, pointed(&shapes).chain(reference), None)?;
        let (finest, counts) = (layers.finest(), Counts::new(layers.finest(), shapes.len(), &app.limits));
        let work = requests::measure(finest, counts, self.reference.is_some(), &app.limits)
            + requests::flux(finest, counts, field.as_ref(), &app.limits)
            + requests::grids(counts, layers.count());
        let task = MeasureTask { layers, correspondence, reference: self.reference, field, on_error };
        let names = InputNames::of_posted(&shapes);
        let find = move |app: &App| {
            let points = || ServiceError::Internal("measures of points".into());
            let measures = task.measure(app, shapes)?;
            let measures = measures.map(|_, measures| MeasureOutput::new(measures).ok_or_else(points));
            Ok((measures, MeasureUnit { length_unit }))
        };
        Ok((work, names, Box::new(find)))
    }
}

document! {
    /// Contours to resample.
    #[schema(example = json!({"count": 6, "start": "canonical", "shapes": [{"points": [[0, 0], [4, 0], [4, 1], [0, 1]]}]}))]
    pub(in crate::api::v1) struct ResampleRequest {
        /// Number of points, at least 3 for closed contours and 2 for open ones.
        #[schema(value_type = usize, required = true, minimum = 2)]
        count: Checked<usize>, required;
        /// Start point of the resampled contour. Default: `first`.
        #[schema(value_type = Option<Start>)]
        start: Checked<Start>;
        /// Whether the contours are closed. Default: true.
        #[schema(value_type = Option<bool>)]
        closed: Checked<bool>;
        /// Contours to resample.
        #[schema(value_type = Vec<ShapeInput>, required = true)]
        shapes: List<ShapeInput>, required;
    }
}

/// One resampled contour.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct ResampledOutput {
    /// Points at equal distances along the polygon.
    points: Points,
    /// Length of the posted polygon.
    polygon_length: f64,
}

/// Resampled contours, in request order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct ResampleAnswer {
    /// One entry per contour.
    shapes: Vec<ResampledOutput>,
}

/// Resamples contours to points at equal arc length; open contours keep both ends.
#[utoipa::path(post, path = "/v1/resample", tag = "curves", request_body = ResampleRequest,
    responses(
        (status = 200, description = "The contours", body = ResampleAnswer)
    ))]
pub(in crate::api::v1) async fn resample(
    Caller(app): Caller,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute_planned(app, body, |app, body| app.parse::<ResampleRequest>(body)?.plan(app)).await
}

impl ResampleRequest {
    fn plan(self, app: &App) -> Result<Planned, ServiceError> {
        let mut errors = self.faults;
        let count = take_given(self.count, "/count", &mut errors);
        let start = take_or_default(self.start, "/start", &mut errors);
        let closed = self.closed.map_or(Some(true), |field| field.take("/closed", &mut errors));
        let shapes = self.shapes.unwrap_or_default().take("/shapes", &mut errors);
        let (((count, start), closed), shapes) = checked(count.zip(start).zip(closed), errors, shapes)?;
        planned(requests::resample(&shapes, count, &app.limits), move |app| {
            let output = |resampled: Resampled| ResampledOutput {
                points: Points::from_columns(resampled.points, resampled.dimension),
                polygon_length: resampled.length,
            };
            let shapes = resample::resample(app, count, start, closed, shapes)?.into_iter().map(output);
            json(StatusCode::OK, &ResampleAnswer { shapes: shapes.collect() })
        })
    }
}
