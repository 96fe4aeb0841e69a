//! Least-squares fits of curves and surfaces to raw contours, grids and meshes; exact control points of idealised shapes.

#[cfg(feature = "schema")]
use crate::api::v1::requests::described::*;
use crate::wire::fault::Fault;
use axum::http::StatusCode;
use axum::response::Response;
use serde::Serialize;

use crate::analysis::correspondence::Correspondence;
use crate::api::extract::{Caller, JsonBody, NoQuery};
use crate::api::problem::Problem;
use crate::api::respond::{Planned, compute, compute_planned, json, planned};
#[cfg(feature = "schema")]
use crate::api::v1::geometry::curves::ParameterList;
use crate::api::v1::requests::batches::{Batch, ManyShapes, PlannedResults, answer_batch, results};
use crate::api::v1::requests::request_macros::{ShapeOutput, checked};
use crate::geometry::capability::domain::Domain;
use crate::geometry::capability::fit::{Fitted, PointPlaces};
use crate::geometry::capability::idealise::{Placed, PlacedCurve, PlacedSurface};
use crate::geometry::generator::GeneratorKind;
use crate::geometry::ideal::{IdealCurve, Position};
use crate::geometry::representation::Representation;
use crate::geometry::surface::Topology;
use crate::geometry::surface::ideal::IdealSurface;
use crate::geometry::surface::seam::Seam;
use crate::service::app::{App, Limits, ServiceError, Work};
use crate::service::cost::requests::{self, Counts, FitCounts};
use crate::service::shapes::fit::{FitInputs, FitTask, MAX_TURNS, USUAL_TURNS};
use crate::service::shapes::idealise;
use crate::service::shapes::names::InputNames;
use crate::service::shapes::outcome::OnError;
use crate::service::shapes::read_mesh::MeshInput;
use crate::service::shapes::request::Posted;
use crate::wire::checked::{Checked, List, Raw, document, take_given, take_or_default};
use crate::wire::representation::{FitTarget, Read};
use crate::wire::shape::ShapeInput;

document! {
    /// Contours, points of surfaces or meshes to fit.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "tolerance": 0.1, "generator": {"name": "cubic"}},
        "shapes": [{"points": [[2, 0], [1.7, 0.5], [1, 0.87], [0, 1], [-1, 0.87], [-1.7, 0.5], [-2, 0], [-1.7, -0.5], [-1, -0.87], [0, -1], [1, -0.87], [1.7, -0.5]]}]
    }))]
    pub(in crate::api::v1) struct FitRequest {
        /// Representation to fit: closed or open curves, or surfaces. It has `control_points` or `intervals`, or in their place
        /// `tolerance`, a bound on the root mean square distance `residual` (in the unit of the points), for which their number
        /// is chosen, of surfaces as many along `u` as along `v`. Single points may be farther away.
        #[schema(value_type = FitRepresentation, required = true)]
        representation: Read<FitTarget>, required;
        /// Parameters of the points, one list per shape. Curves: `u`, strictly increasing from 0 to 1. Default: arc length of
        /// the polygon. Surfaces: pairs `[u, v]`. Default: equal spacing, for a grid of points.
        #[schema(value_type = Option<Vec<ParameterList>>)]
        parameters: Raw;
        /// Contours, grids or lists of points, each with at least as many points as control points.
        #[schema(value_type = Option<Vec<ShapeInput>>)]
        shapes: List<ShapeInput>;
        /// Triangle meshes in place of `shapes`, for surfaces.
        #[schema(value_type = Option<Vec<MeshInput>>)]
        meshes: List<MeshInput>;
        /// Subdivision surfaces: number of alternations between finding the nearest places to the points and solving for the
        /// control points. Default: 20.
        #[schema(value_type = Option<usize>, maximum = 200)]
        turns: Checked<usize>;
        /// Subdivision surfaces: initial shape of all fits. Default, on control meshes named after a body: a spherical
        /// parameterisation of a mesh, or the ellipsoid of the moments of a point cloud.
        #[schema(value_type = Option<ShapeInput>)]
        start: ShapeInput;
    }
}

/// Representation to fit: with a number of control points, or for curves with a bound on the residual.
#[derive(utoipa::ToSchema)]
#[serde(untagged)]
#[allow(dead_code, reason = "only for the document")]
enum FitRepresentation {
    /// With a number of control points.
    Sized(Representation),
    /// Curves with a bound on the residual.
    Tolerant(TolerantCurve),
    /// Surfaces with a bound on the residual.
    TolerantSurface(TolerantSurface),
}

/// Surfaces with as many control points as a bound on the residual requires.
#[derive(utoipa::ToSchema)]
#[allow(dead_code, reason = "only for the document")]
struct TolerantSurface {
    /// Surfaces.
    kind: SurfaceKind,
    /// Topology of the surface.
    topology: Topology,
    /// How a torus is glued along `u`. Default: `straight`.
    seam: Option<Seam>,
    /// Generators along `u` and `v`. Default: those of the topology.
    #[schema(min_items = 2, max_items = 2)]
    generators: Option<Vec<GeneratorKind>>,
    /// Largest root mean square distance, in the unit of the points.
    #[schema(exclusive_minimum = 0.0)]
    tolerance: f64,
}

/// Kind of surfaces.
#[derive(utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[allow(dead_code, reason = "only for the document")]
enum SurfaceKind {
    /// Tensor-product surfaces.
    Surface,
}

/// Curves with as many control points as a bound on the residual requires.
#[derive(utoipa::ToSchema)]
#[allow(dead_code, reason = "only for the document")]
struct TolerantCurve {
    /// Closed or open curves.
    kind: CurveKind,
    /// Dimension of the points: 2 or 3.
    #[schema(minimum = 2, maximum = 3)]
    dimension: usize,
    /// The generator of the curves.
    generator: GeneratorKind,
    /// Largest root mean square distance, in the unit of the points.
    #[schema(exclusive_minimum = 0.0)]
    tolerance: f64,
}

/// Kind of curves.
#[derive(utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
#[allow(dead_code, reason = "only for the document")]
enum CurveKind {
    /// Closed spline curves.
    ClosedCurve,
    /// Open spline curves.
    OpenCurve,
}

/// A fitted curve or surface.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct FitOutput {
    /// Representation of the fitted shape.
    representation: Representation,
    #[serde(flatten)]
    shape: ShapeOutput,
    /// Root mean square distance of the points from the shape at their parameters: the `L₂` residual, which `tolerance`
    /// bounds. For a mesh it is taken over places on its faces, weighted by area, not over its vertices.
    residual: f64,
    /// Largest such distance; `tolerance` does not bound it.
    largest_residual: f64,
    /// Parameters `[u, v]` of the vertices of a mesh; they can be reused for another mesh with the same vertices.
    #[serde(skip_serializing_if = "Option::is_none")]
    parameters: Option<Vec<[f64; 2]>>,
    /// Fraction of the area of a mesh where the normal of the surface points against that of the mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    folded: Option<f64>,
    /// Defects of a fitted mesh.
    warnings: Vec<String>,
}

results! {
    /// Fitted shapes: one entry per contour, grid, list or mesh.
    FitAnswer of FitResult: FittedShape with FitOutput
}

/// Fits curves or surfaces by least squares in `L₂`.
///
/// Points sampled from a shape of the representation, at their parameters, give back its control points. Spherical meshes
/// need no parameters: on a closed mesh without handles, longitude and colatitude are computed as harmonic functions between
/// two poles, with the colatitude adjusted so that every ring holds its share of the area.
///
/// Subdivision surfaces are fitted to the places nearest to the points; residuals are distances at those places.
///
/// Lines of NDJSON are shapes; the other fields of the request are parameters then.
#[utoipa::path(post, path = "/v1/fit", tag = "curves", params(BatchQuery),
    request_body(content((FitRequest = "application/json"), (ShapeInput = "application/x-ndjson"), (Binary = "application/octet-stream"))),
    responses(
        (status = 200, description = "One entry per contour, grid, list or mesh, in order", content((FitAnswer = "application/json"), (FitResult = "application/x-ndjson")))
    ))]
pub(in crate::api::v1) async fn fit(Caller(app): Caller, batch: Batch) -> Result<Response, Problem> {
    answer_batch::<_, FitAnswer>(app, batch, FitRequest::plan).await
}

impl ManyShapes for FitRequest {
    fn put_shapes(&mut self, shapes: List<ShapeInput>) {
        self.shapes = Some(shapes);
    }
}

impl FitRequest {
    fn plan(mut self, app: &App, on_error: OnError) -> Result<PlannedResults<FitAnswer>, ServiceError> {
        let mut errors = std::mem::take(&mut self.faults);
        let target = self.representation.take().and_then(|field| field.take("/representation", &mut errors));
        let domain = target.as_ref().map(|target| target.representation.domain());
        let turns = self.take_turns(domain, &mut errors);
        let places = self.take_places(domain, &mut errors);
        self.check_inputs(domain, places != Some(None), &mut errors);
        let meshes = self.meshes.map(|meshes| meshes.take("/meshes", &mut errors));
        let shapes = self.shapes.unwrap_or_default().take("/shapes", &mut errors);
        let ((target, places), shapes) = checked(target.zip(places), errors, shapes)?;
        let FitTarget { representation, tolerance } = target;
        let representation = app.admit(representation)?;
        let names = match &meshes {
            Some(meshes) => vec![InputNames::default(); meshes.len()],
            None => InputNames::of_posted(&shapes),
        };
        let inputs = meshes.map_or(FitInputs::Shapes(shapes), FitInputs::Meshes);
        let task = FitTask { representation, tolerance, places, turns, start: self.start, on_error };
        let work = fit_work(&task, &inputs, &app.limits);
        let find = move |app: &App| {
            let fits = task.fit(app, inputs)?;
            Ok((fits.map(|_, fitted| Ok(FitOutput::from(fitted))), ()))
        };
        Ok((work, names, Box::new(find)))
    }

    /// Takes the number of rounds, and checks that it and a start are given for refined meshes only.
    fn take_turns(&mut self, domain: Option<Domain>, errors: &mut Vec<Fault>) -> usize {
        let turns = take_given(self.turns.take(), "/turns", errors);
        if domain.is_some_and(|domain| !domain.is_mesh()) {
            let given = [(turns.is_some(), "/turns"), (self.start.is_some(), "/start")];
            let given = given.into_iter().filter(|(given, _)| *given);
            errors.extend(
                given.map(|(_, pointer)| Fault::new(pointer, "this field belongs to subdivision surfaces")),
            );
        }
        let turns = turns.unwrap_or(USUAL_TURNS);
        if turns > MAX_TURNS {
            errors.push(Fault::new("/turns", format!("expected at most {MAX_TURNS}, got {turns}")));
        }
        turns
    }

    /// Takes the parameters of the points, one list per shape; `None` for refused ones.
    fn take_places(
        &mut self,
        domain: Option<Domain>,
        errors: &mut Vec<Fault>,
    ) -> Option<Option<Vec<PointPlaces>>> {
        let Some(list) = self.parameters.take() else { return Some(None) };
        if domain.is_some_and(Domain::is_mesh) {
            errors.push(Fault::new(
                "/parameters",
                "this field belongs to splines: a subdivision surface has no parameters, use start",
            ));
        }
        let places = if domain.is_some_and(Domain::is_sheet) {
            let lists: Vec<Vec<[f64; 2]>> = list.read_many("/parameters", errors)?;
            lists.into_iter().map(PointPlaces::Pairs).collect()
        } else {
            let lists: Vec<Vec<f64>> = list.read_many("/parameters", errors)?;
            lists.into_iter().map(PointPlaces::Line).collect()
        };
        Some(Some(places))
    }

    /// Checks that shapes or meshes are given, whichever apply to the domain; meshes without parameters beside them.
    fn check_inputs(&self, domain: Option<Domain>, has_places: bool, errors: &mut Vec<Fault>) {
        let surfaces = domain.is_none_or(Domain::is_surface);
        let fault = match (&self.shapes, &self.meshes) {
            (Some(_), Some(_)) => Some(("/meshes", "expected either meshes or shapes, got both")),
            (None, Some(_)) if !surfaces => {
                Some(("/meshes", "this field belongs to surfaces: curves are fitted to shapes"))
            }
            (None, None) => Some(("/shapes", "required field is missing")),
            _ => None,
        };
        errors.extend(fault.map(|(pointer, detail)| Fault::new(pointer, detail)));
        if self.meshes.is_some() && has_places {
            let detail = "this field belongs to shapes: a mesh has its own parameters";
            errors.push(Fault::new("/parameters", detail));
        }
    }
}

impl From<Fitted> for FitOutput {
    fn from(fitted: Fitted) -> Self {
        Self {
            shape: ShapeOutput::of(&fitted.control_points),
            representation: fitted.representation,
            residual: fitted.residual,
            largest_residual: fitted.largest,
            parameters: fitted.parameters,
            folded: fitted.folded,
            warnings: fitted.warnings,
        }
    }
}

/// Predicted work of fitting shapes or meshes.
fn fit_work(task: &FitTask, inputs: &FitInputs, limits: &Limits) -> Work {
    let (count, points, meshes) = match inputs {
        FitInputs::Shapes(shapes) => (shapes.len(), requests::posted_points(shapes), false),
        FitInputs::Meshes(meshes) => (meshes.len(), requests::posted_vertices(meshes), true),
    };
    let counts = Counts::new(&task.representation, count, limits);
    let fit = FitCounts { points, meshes, tolerance: task.tolerance.is_some(), turns: task.turns };
    requests::fit(&task.representation, counts, fit, limits)
}

/// Idealised curve of the catalogue.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct IdealEntry {
    /// The curve, as written in a request.
    curve: IdealCurve,
    /// Whether a closed curve can represent it.
    closed: bool,
    /// `domain_poles` that a generator needs to represent the curve about the origin.
    domain_poles: Vec<[f64; 2]>,
}

/// Idealised surface of the catalogue.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct IdealSurfaceEntry {
    /// The surface, as written in a request.
    surface: IdealSurface,
    /// Smallest representation that contains the surface.
    representation: Representation,
    /// Control points of the surface in that representation.
    #[serde(flatten)]
    shape: ShapeOutput,
}

/// Idealised curves and surfaces.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct IdealShapes {
    /// One curve of each kind.
    items: Vec<IdealEntry>,
    /// One surface of each kind.
    surfaces: Vec<IdealSurfaceEntry>,
}

/// Lists the idealised curves and surfaces.
#[utoipa::path(get, path = "/v1/idealised", tag = "catalogue",
    responses((status = 200, description = "The curves with the poles that they need, the surfaces with their control points", body = IdealShapes), (status = 400, description = "An unknown parameter")))]
pub(in crate::api::v1) async fn list_idealised(Caller(app): Caller, _: NoQuery) -> Result<Response, Problem> {
    compute(app.weighing(Work::MOMENT), |_| {
        let surfaces = IdealSurface::catalogue().into_iter().map(surface_entry).collect::<Result<_, _>>()?;
        let items = IdealCurve::catalogue().into_iter().map(curve_entry).collect();
        json(StatusCode::OK, &IdealShapes { items, surfaces })
    })
    .await
}

fn curve_entry(curve: IdealCurve) -> IdealEntry {
    let domain_poles = curve.domain_poles(&Position::default());
    IdealEntry { closed: curve.is_closed(), domain_poles, curve }
}

fn surface_entry(surface: IdealSurface) -> Result<IdealSurfaceEntry, ServiceError> {
    let basis = surface
        .basis(surface.fewest_intervals())
        .map_err(|error| ServiceError::Internal(error.to_string()))?;
    let shape = ShapeOutput::of(&surface.rows(&basis));
    Ok(IdealSurfaceEntry { representation: surface.representation(), surface, shape })
}

document! {
    /// An idealised curve or surface with its position.
    pub(in crate::api::v1) struct IdealInput {
        /// Curve about the origin.
        #[schema(value_type = Option<IdealCurve>)]
        curve: Checked<IdealCurve>;
        /// Surface about the origin.
        #[schema(value_type = Option<IdealSurface>)]
        surface: Checked<IdealSurface>;
        /// Position of the shape's origin. Default: the origin.
        #[schema(value_type = Option<Vec<f64>>)]
        centre: Checked<Vec<f64>>;
        /// Angle in radians by which the shape is first rotated about the origin, counter-clockwise; surfaces rotate about the
        /// z axis.
        #[schema(value_type = Option<f64>)]
        angle: Checked<f64>;
    }
}

document! {
    /// Idealised shapes to represent.
    #[schema(example = json!({
        "representation": {"kind": "closed_curve", "dimension": 2, "control_points": 5, "generator": {"name": "trigonometric"}},
        "curves": [{"curve": {"name": "ellipse", "semi_axes": [2, 1]}, "centre": [3, 1], "angle": 0.5}]
    }))]
    pub(in crate::api::v1) struct IdealRequest {
        /// Representation of the shapes: curves or surfaces.
        #[schema(value_type = Representation, required = true)]
        representation: Read<Representation>, required;
        /// Curves to represent.
        #[schema(value_type = Option<Vec<IdealInput>>)]
        curves: List<IdealInput>;
        /// Surfaces to represent.
        #[schema(value_type = Option<Vec<IdealInput>>)]
        surfaces: List<IdealInput>;
    }
}

/// Exact control points, in request order.
#[derive(Debug, Serialize, utoipa::ToSchema)]
pub(in crate::api::v1) struct IdealAnswer {
    /// One entry per curve or surface.
    shapes: Vec<ShapeOutput>,
}

/// Returns exact control points of idealised curves or surfaces.
///
/// If the generator does not contain a shape, the request is refused and the missing poles are named.
#[utoipa::path(post, path = "/v1/idealised", tag = "curves", request_body = IdealRequest,
    responses(
        (status = 200, description = "Control points", body = IdealAnswer)
    ))]
pub(in crate::api::v1) async fn idealise(
    Caller(app): Caller,
    _: NoQuery,
    JsonBody(body): JsonBody,
) -> Result<Response, Problem> {
    compute_planned(app, body, |app, body| app.parse::<IdealRequest>(body)?.plan(app)).await
}

impl IdealRequest {
    fn plan(self, app: &App) -> Result<Planned, ServiceError> {
        let mut errors = self.faults;
        let representation = self.representation.and_then(|field| field.take("/representation", &mut errors));
        let surfaces = representation.as_ref().map(|representation| representation.domain().is_sheet());
        let (field, list, other) = match surfaces {
            Some(true) => ("surfaces", self.surfaces, self.curves.is_some()),
            _ => ("curves", self.curves, self.surfaces.is_some()),
        };
        if other && surfaces.is_some() {
            let detail = format!("expected {field} only, as in the representation");
            errors.push(Fault::new("", detail));
        } else if list.is_none() && surfaces.is_some() {
            errors.push(Fault::new(format!("/{field}"), "required field is missing"));
        }
        let mut wanted = Vec::new();
        let list = list.unwrap_or_default().take(&format!("/{field}"), &mut errors);
        for (index, input) in list.into_iter().enumerate() {
            wanted.extend(take_ideal(input, surfaces, &format!("/{field}/{index}"), &mut errors));
        }
        let (representation, _) = checked(representation, errors, Vec::new())?;
        let representation = app.admit(representation)?;
        let counts = Counts::new(&representation, wanted.len(), &app.limits);
        planned(requests::fit_lines(counts, 0.0, false), move |app| {
            let posted = Posted::from_splines(app, &representation, Correspondence::Landmarks)?;
            let shapes = idealise::idealise(app, &posted, &wanted)?.iter().map(ShapeOutput::of).collect();
            json(StatusCode::OK, &IdealAnswer { shapes })
        })
    }
}

/// Takes an idealised surface, or else a curve, with its position.
fn take_ideal(
    input: IdealInput,
    surfaces: Option<bool>,
    pointer: &str,
    errors: &mut Vec<Fault>,
) -> Option<Placed> {
    let below = |name: &str| format!("{pointer}{name}");
    errors.extend(input.faults.iter().cloned().map(|fault| fault.below(pointer)));
    let (name, missing, other) = match surfaces? {
        true => ("/surface", input.surface.is_none(), input.curve.is_some()),
        false => ("/curve", input.curve.is_none(), input.surface.is_some()),
    };
    if input.faults.is_empty() && (missing || other) {
        let detail = if missing {
            "required field is missing"
        } else {
            "expected this field only, as in the representation"
        };
        errors.push(Fault::new(below(name), detail));
    }
    let curve = take_given(input.curve, &below("/curve"), errors);
    let surface = take_given(input.surface, &below("/surface"), errors);
    let centre = take_given(input.centre, &below("/centre"), errors);
    let angle = take_or_default(input.angle, &below("/angle"), errors)?;
    let mut centre_of = |dimension: usize| {
        let centre = centre.clone().unwrap_or_else(|| vec![0.0; dimension]);
        if centre.len() != dimension {
            let detail = format!("expected {dimension} coordinates, got {}", centre.len());
            errors.push(Fault::new(below("/centre"), detail));
        }
        centre
    };
    if surfaces? {
        let centre = centre_of(3).try_into().ok()?;
        return Some(Placed::Surface(PlacedSurface { surface: surface?, centre, angle }));
    }
    let centre = centre_of(2).try_into().ok()?;
    Some(Placed::Curve(PlacedCurve { curve: curve?, position: Position { centre, angle } }))
}
