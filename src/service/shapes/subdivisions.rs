//! Stateless use cases of subdivision surfaces: refine, evaluate, measure, morph. The functions are synchronous and run
//! on the pool.

use crate::formats::fault::Fault;
use crate::service::app::faults::Faults;
use rayon::prelude::*;

use super::curves::{each, each_shape};
use super::morph::Positions;
use super::read::{self, check_subdivision, face_pointer, given};
use super::request::Posted;
use super::surface_fitting::take_points;
use super::surfaces::MeasuredSurface;
use crate::analysis::correspondence::Correspondence;
use crate::formats::checked::{Checked, LARGE, document, take_given};
use crate::formats::shape::{PointList, ShapeInput};
use crate::geometry::GeometryError;
use crate::geometry::drawing::svg::MAX_FACES;
use crate::geometry::mesh::{Connectivity, TriangleMesh};
use crate::geometry::quality::{MeshQuality, collapsed_edges};
use crate::geometry::representation::Representation;
use crate::geometry::subdivision::control::StartMesh;
use crate::geometry::subdivision::limit::Limit;
use crate::geometry::subdivision::measures::{VertexFrame, frames, measure};
use crate::geometry::subdivision::normal_based::{Oriented, circle_normals, inconsistent, sphere_normals};
use crate::geometry::subdivision::refinement::{
    Depth, Refined, refine_curve, refine_mesh, refine_mesh_until,
};
use crate::geometry::subdivision::{Scheme, Subdivision};
use crate::geometry::surface::measures::{AffineField, SurfaceMeasures};
use crate::geometry::vector::{dot, far_origin, minus, norm, plus};
use crate::numeric::dense::Matrix;
use crate::service::app::progress::JobContext;
use crate::service::app::{App, Limits, ServiceError, warnings};

document! {
    /// A closed triangle mesh to be refined.
    pub struct ControlMeshInput {
        /// Positions of the vertices.
        #[schema(value_type = Vec<[f64; 3]>, required = true)]
        vertices: PointList, required;
        /// Triangles as indices of their vertices, counter-clockwise as seen from outside.
        #[schema(value_type = Vec<[u32; 3]>, required = true)]
        faces: Checked<Vec<[u32; 3]>, LARGE>, required;
        /// Normals at the vertices, of any length, for the scheme `normal_based`. Default: the normals of a sphere
        /// through the neighbours.
        #[schema(value_type = Option<Vec<[f64; 3]>>)]
        normals: PointList;
    }
}

document! {
    /// A polyline in the plane or in space, to be refined by the scheme `normal_based`.
    pub struct PolylineInput {
        /// Points of the polyline.
        #[schema(value_type = Vec<Vec<f64>>, required = true)]
        points: PointList, required;
        /// Normals at the points, of any length. Default in the plane: those of the circle through the neighbours,
        /// outward if the polyline runs counter-clockwise. Required in space.
        #[schema(value_type = Option<Vec<Vec<f64>>>)]
        normals: PointList;
        /// Whether the last point is connected to the first. Default: true.
        #[schema(value_type = Option<bool>)]
        closed: Checked<bool>;
    }
}

impl ControlMeshInput {
    /// Number of vertices given.
    pub fn vertex_count(&self) -> usize {
        read::given(&self.vertices).map_or(0, |points| points.len())
    }
}

impl PolylineInput {
    /// Number of points given.
    pub fn point_count(&self) -> usize {
        read::given(&self.points).map_or(0, |points| points.len())
    }
}

/// A refined mesh.
#[derive(Debug)]
pub struct RefinedMesh {
    /// The mesh, its level, and the displacement of its vertices by the last step.
    pub refined: Refined<TriangleMesh>,
    /// Limit positions of its vertices, if requested.
    pub limit: Option<Limit>,
    /// Volume and area.
    pub measures: SurfaceMeasures,
    /// Quality of the mesh.
    pub quality: MeshQuality,
    /// Corrections made to the input, and defects of the mesh.
    pub warnings: Vec<String>,
}

/// Refines a posted mesh.
///
/// # Errors
/// Faults of the mesh, at `/mesh…`; sizes and tolerances that are not reached.
pub fn subdivide(
    app: &App,
    scheme: Scheme,
    mesh: ControlMeshInput,
    depth: Depth,
    wanted_limit: bool,
) -> Result<RefinedMesh, ServiceError> {
    let (mesh, warnings) =
        read_mesh(mesh, scheme, &app.limits).map_err(|errors| ServiceError::below(errors, "/mesh"))?;
    refine(app, scheme, (mesh, "/mesh"), depth, wanted_limit, warnings)
}

/// Refines a starting mesh, whose vertices all lie on the unit sphere.
///
/// # Errors
/// Sizes and tolerances that are not reached; vertices without subdivision rules.
pub fn subdivide_named(
    app: &App,
    scheme: Scheme,
    start: StartMesh,
    depth: Depth,
    wanted_limit: bool,
) -> Result<RefinedMesh, ServiceError> {
    let (vertices, most) = (start.size().vertices, app.limits.points);
    if vertices > most {
        let detail =
            format!("expected a start with at most {most} vertices, got \"{start}\" with {vertices}");
        return Err(ServiceError::invalid("/start", detail));
    }
    let mesh = start.mesh();
    let normals = matches!(scheme, Scheme::NormalBased { .. }).then(|| mesh.vertices.clone());
    refine(app, scheme, (TriangleMesh { normals, ..mesh }, "/start"), depth, wanted_limit, Vec::new())
}

fn refine(
    app: &App,
    scheme: Scheme,
    (mesh, pointer): (TriangleMesh, &str),
    depth: Depth,
    wanted_limit: bool,
    mut warnings: Vec<String>,
) -> Result<RefinedMesh, ServiceError> {
    let context = app.pool.context();
    let origin = far_origin(mesh.vertices.iter()).unwrap_or_default();
    let is_far = origin != [0.0; 3];
    let mesh = if is_far { moved(mesh, origin.map(|x| -x)) } else { mesh };
    let most = app.limits.vertices;
    let stop = || context.is_cancelled();
    let collapsed = collapsed_edges(&mesh, norm(origin));
    let (mut refined, mut limit) = refine_mesh_until(scheme, mesh, depth, most, wanted_limit, &stop)
        .map_err(|error| refused(&error, pointer))?;
    context.check()?;
    let mut measures = measure(&refined.shape, refined.level > 0);
    if is_far {
        measures = measures.moved(origin);
        refined.shape = moved(refined.shape, origin);
        if let Some(limit) = &mut limit {
            limit.points.iter_mut().for_each(|point| *point = plus(*point, origin));
        }
    }
    let quality = warnings::of_split_mesh(&refined.shape, refined.level, &measures, &stop);
    if collapsed > 0 && quality.collapsed_edges == 0 {
        warnings.push(format!("{collapsed} edges of the mesh have no length: vertices coincide"));
    }
    warnings.extend(quality.warnings());
    Ok(RefinedMesh { refined, limit, measures, quality, warnings })
}

/// The same mesh, translated.
fn moved(mesh: TriangleMesh, by: [f64; 3]) -> TriangleMesh {
    let vertices = mesh.vertices.into_iter().map(|vertex| plus(vertex, by)).collect();
    TriangleMesh { vertices, ..mesh }
}

/// Locates an error of a refinement in the request.
fn refused(error: &GeometryError, shape: &str) -> ServiceError {
    let pointer = match error {
        GeometryError::Mesh(fault) => format!("{shape}/faces{}", face_pointer(fault)),
        GeometryError::Valence { .. } if shape == "/mesh" => format!("{shape}/faces"),
        GeometryError::TooFine { .. } => "/level".into(),
        GeometryError::Coarse { .. } => "/tolerance".into(),
        _ => shape.into(),
    };
    ServiceError::invalid(pointer, error.to_string())
}

fn read_mesh(
    input: ControlMeshInput,
    scheme: Scheme,
    limits: &Limits,
) -> Result<(TriangleMesh, Vec<String>), Vec<Fault>> {
    let mut errors = input.faults;
    let vertices = take_points::<3>(&input.vertices, "/vertices", &mut errors);
    let faces = take_given(input.faces, "/faces", &mut errors);
    let normals = take_points::<3>(&input.normals, "/normals", &mut errors);
    if vertices.is_none() && errors.is_empty() {
        errors.push(Fault::new("/vertices", "required field is missing"));
    }
    let oriented = matches!(scheme, Scheme::NormalBased { .. });
    if normals.is_some() && !oriented {
        errors.push(Fault::new("/normals", "expected no normals: they belong to the scheme normal_based"));
    }
    let (Some(vertices), Some(faces), true) = (vertices, faces, errors.is_empty()) else {
        return Err(errors);
    };
    let (count, most) = (vertices.len(), limits.points);
    if count > most || faces.len() > 2 * most {
        let detail = format!(
            "expected at most {most} vertices and {1} faces, got {count} and {0}",
            faces.len(),
            2 * most
        );
        return Err(vec![Fault::new("", detail)]);
    }
    let mesh = TriangleMesh { vertices, normals: None, faces };
    if !oriented {
        return Ok((mesh, Vec::new()));
    }
    mesh.check_faces()
        .map_err(|fault| vec![Fault::new(format!("/faces{}", face_pointer(&fault)), fault.to_string())])?;
    let (shape, warnings) = orient(mesh.vertices.clone(), normals, || sphere_normals(&mesh))?;
    Ok((TriangleMesh { vertices: shape.points, normals: Some(shape.normals), faces: mesh.faces }, warnings))
}

/// Maximum deviation from 1 of the length of a normal that counts as a unit normal, written with few digits.
const UNIT: f64 = 1e-6;

/// Points with unit normals. Default of the normals: those of `usual`.
fn orient(
    points: Vec<[f64; 3]>,
    normals: Option<Vec<[f64; 3]>>,
    usual: impl FnOnce() -> Vec<[f64; 3]>,
) -> Result<(Oriented, Vec<String>), Vec<Fault>> {
    let (given, count) = (normals.is_some(), points.len());
    let normals = normals.unwrap_or_else(usual);
    if normals.len() != count {
        let detail = format!("expected {count} entries, one per point, got {}", normals.len());
        return Err(vec![Fault::new("/normals", detail)]);
    }
    let off = normals.iter().filter(|normal| (norm(**normal) - 1.0).abs() > UNIT).count();
    let shape = Oriented::new(points, &normals).map_err(|index| {
        let detail = if given {
            "expected a normal with a direction, got zero"
        } else {
            "required normal is missing: the neighbouring points define none"
        };
        vec![Fault::new(format!("/normals/{index}"), detail)]
    })?;
    let warning = format!("{off} of {count} normals were not of unit length and were normalised");
    Ok((shape, if given && off > 0 { vec![warning] } else { Vec::new() }))
}

/// A refined polyline.
#[derive(Debug)]
pub struct RefinedCurve {
    /// Points and normals, the level, and their displacement by the last step.
    pub refined: Refined<Oriented>,
    /// Dimension: 2 or 3.
    pub dimension: usize,
    /// Corrections made to the input, and suspicious features.
    pub warnings: Vec<String>,
}

/// Refines a posted polyline.
///
/// # Errors
/// Faults of the polyline, at `/polyline…`; schemes for meshes; sizes and tolerances that are not reached.
pub fn subdivide_polyline(
    app: &App,
    scheme: Scheme,
    polyline: PolylineInput,
    depth: Depth,
) -> Result<RefinedCurve, ServiceError> {
    let Scheme::NormalBased { balance } = scheme else {
        let detail = "polylines are refined by normal_based only: the other schemes are for meshes";
        return Err(ServiceError::invalid("/polyline", detail));
    };
    let (shape, closed, dimension, warnings) =
        read_polyline(polyline, &app.limits).map_err(|errors| ServiceError::below(errors, "/polyline"))?;
    let context = app.pool.context();
    let stop = || context.is_cancelled();
    let refined = refine_curve(shape, closed, balance.get(), depth, app.limits.vertices, &stop);
    context.check()?;
    let refined = refined.map_err(|error| refused(&error, "/polyline"))?;
    Ok(RefinedCurve { refined, dimension, warnings })
}

/// Points with normals, whether they close, their dimension, and warnings.
type ReadPolyline = (Oriented, bool, usize, Vec<String>);

fn read_polyline(input: PolylineInput, limits: &Limits) -> Result<ReadPolyline, Vec<Fault>> {
    let mut errors = input.faults;
    let closed = input.closed.map_or(Some(true), |field| field.take("/closed", &mut errors));
    let width = given(&input.points).map(PointList::width).filter(|width| [2, 3].contains(width));
    let dimension = width.unwrap_or(2);
    let mut take = |list: &Option<PointList>, pointer: &str| match dimension {
        2 => {
            let flat = take_points::<2>(list, pointer, &mut errors);
            flat.map(|points| points.into_iter().map(|[x, y]| [x, y, 0.0]).collect::<Vec<_>>())
        }
        _ => take_points::<3>(list, pointer, &mut errors),
    };
    let (points, normals) = (take(&input.points, "/points"), take(&input.normals, "/normals"));
    if points.is_none() && errors.is_empty() {
        errors.push(Fault::new("/points", "required field is missing"));
    }
    let (Some(points), Some(closed), true) = (points, closed, errors.is_empty()) else { return Err(errors) };
    let (count, fewest) = (points.len(), if closed { 3 } else { 2 });
    if !(fewest..=limits.points).contains(&count) {
        let detail = format!("expected between {fewest} and {} points, got {count}", limits.points);
        return Err(vec![Fault::new("/points", detail)]);
    }
    if normals.is_none() && dimension == 3 {
        let detail = "required field is missing: neighbouring points define normals in the plane only";
        return Err(vec![Fault::new("/normals", detail)]);
    }
    let (shape, mut warnings) = orient(points.clone(), normals, || circle_normals(&points, closed))?;
    if dimension == 2
        && let Some(vertex) = inconsistent(&shape.points, &shape.normals, closed)
    {
        warnings.push(format!(
            "the normal of point {vertex} lies on the other side of one of its edges than the others do: the curve has a cusp there"
        ));
    }
    Ok((shape, closed, dimension, warnings))
}

/// The same mesh with vertex normals, for programs that shade it.
pub fn with_normals(mesh: TriangleMesh) -> TriangleMesh {
    let normals = mesh.normals.clone();
    let of_faces = || frames(&mesh).iter().map(|frame| frame.normal.unwrap_or_default()).collect();
    TriangleMesh { normals: Some(normals.unwrap_or_else(of_faces)), ..mesh }
}

/// Requested mesh of a shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wanted {
    /// The mesh of its level.
    Whole,
    /// A mesh with few faces, for drawings.
    Drawn,
}

/// Refined meshes of posted shapes, in order; those of the normal-based scheme have normals.
///
/// # Errors
/// Faults of the representation and of the shapes; too many vertices in total.
pub fn meshes(
    app: &App,
    representation: &Representation,
    correspondence: Correspondence,
    shapes: Vec<ShapeInput>,
    wanted: Wanted,
) -> Result<Vec<TriangleMesh>, ServiceError> {
    let Some(subdivision) = representation.subdivision() else {
        return Err(ServiceError::Internal("only subdivision surfaces have meshes of a level".into()));
    };
    check_subdivision(subdivision, &app.limits)
        .map_err(|errors| ServiceError::below(errors, "/representation"))?;
    let vertices = subdivision.size().vertices.saturating_mul(shapes.len());
    if vertices > app.limits.samples {
        let detail =
            format!("expected at most {} vertices over all shapes, got {vertices}", app.limits.samples);
        return Err(ServiceError::invalid("/shapes", detail));
    }
    if let Some(refinery) = OrientedMeshes::new(subdivision)? {
        read::check_correspondence(representation, correspondence)?;
        let context = app.pool.context();
        let shapes = refinery.read_all(&context, shapes)?;
        let refined: Vec<Result<TriangleMesh, GeometryError>> =
            each(&context, &shapes, |shape| refinery.refine(shape, wanted))?;
        let refused = |index: usize, error: GeometryError| {
            let fault = Fault::new(format!("/shapes/{index}"), error.to_string());
            ServiceError::Invalid(vec![fault.of_shape(index)].into())
        };
        let numbered = refined.into_iter().enumerate();
        return numbered.map(|(index, mesh)| mesh.map_err(|error| refused(index, error))).collect();
    }
    let posted = Posted::new(app, representation, correspondence)?;
    let shapes = posted.read(app, shapes)?;
    let basis = posted.steps();
    let near = |rows: &Matrix| match wanted {
        Wanted::Whole => basis.mesh(rows),
        Wanted::Drawn => basis.drawn(rows, basis.level_with(MAX_FACES)),
    };
    let mesh = |rows: &Matrix| {
        let points: Vec<[f64; 3]> = (0..rows.nrows()).map(|i| [0, 1, 2].map(|c| rows[(i, c)])).collect();
        let Some(origin) = far_origin(points.iter()) else { return near(rows) };
        let about = Matrix::from_fn(points.len(), 3, |i, c| points[i][c] - origin[c]);
        moved(near(&about), origin)
    };
    each(&app.pool.context(), &shapes, mesh)
}

/// Reader of shapes with points and normals on one control mesh.
struct OrientedMeshes<'a> {
    subdivision: &'a Subdivision,
    control: Connectivity,
}

impl<'a> OrientedMeshes<'a> {
    /// Succeeds for the normal-based scheme; `None` for all others.
    fn new(subdivision: &'a Subdivision) -> Result<Option<Self>, ServiceError> {
        let Scheme::NormalBased { .. } = subdivision.scheme else { return Ok(None) };
        let control = subdivision
            .connectivity
            .connectivity()
            .map_err(|error| ServiceError::invalid("/representation/connectivity", error.to_string()))?;
        Ok(Some(Self { subdivision, control }))
    }

    fn read_all(&self, context: &JobContext, shapes: Vec<ShapeInput>) -> Result<Vec<Oriented>, ServiceError> {
        if shapes.is_empty() {
            return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
        }
        each_shape(context, shapes, |_, shape| self.read(shape))
    }

    /// Points (which are control points, because the scheme interpolates) and normals, with defaults.
    fn read(&self, shape: ShapeInput) -> Result<Oriented, Vec<Fault>> {
        let (points, normals) = match (&shape.points, &shape.control_points) {
            (Some(_), Some(_)) => {
                return Err(vec![Fault::new("", "expected either points or control_points, got both")]);
            }
            (None, Some(_)) => (shape.control_points.as_deref().cloned(), shape.normals.as_deref().cloned()),
            _ => (shape.points.clone(), shape.normals.as_deref().cloned()),
        };
        if shape.poles.is_some() {
            return Err(vec![Fault::new(
                "/poles",
                "expected no poles: they belong to the points of a sphere",
            )]);
        }
        let pointer = if shape.control_points.is_some() { "/control_points" } else { "/points" };
        read::attributes(shape)?;
        let mut errors = Vec::new();
        let points = take_points::<3>(&points, pointer, &mut errors);
        let normals = take_points::<3>(&normals, "/normals", &mut errors);
        let (Some(points), true) = (points, errors.is_empty()) else {
            if errors.is_empty() {
                errors.push(Fault::new("", "expected either points or control_points, got neither"));
            }
            return Err(errors);
        };
        let count = self.control.vertices();
        if points.len() != count {
            let detail =
                format!("expected {count} control points for this representation, got {}", points.len());
            return Err(vec![Fault::new(pointer, detail)]);
        }
        let mesh =
            TriangleMesh { vertices: points.clone(), normals: None, faces: self.control.faces().to_vec() };
        orient(points, normals, || sphere_normals(&mesh)).map(|(shape, _)| shape)
    }

    fn refine(&self, shape: &Oriented, wanted: Wanted) -> Result<TriangleMesh, GeometryError> {
        let mesh = TriangleMesh {
            vertices: shape.points.clone(),
            normals: Some(shape.normals.clone()),
            faces: self.control.faces().to_vec(),
        };
        let size = self.subdivision.connectivity.size();
        let drawn = (0..=self.subdivision.level).rev().find(|level| size.split(*level).faces <= MAX_FACES);
        let level = if wanted == Wanted::Drawn { drawn.unwrap_or(0) } else { self.subdivision.level };
        let refined = refine_mesh(self.subdivision.scheme, mesh, Depth::Level(level), usize::MAX, false);
        refined.map(|(refined, _)| refined.shape)
    }
}

/// Measures of refined meshes of posted shapes, with the `L₂` distance to a reference.
///
/// # Errors
/// Those of [`meshes`]; a reference for shapes without `L₂` distance.
pub fn measure_all(
    app: &App,
    representation: &Representation,
    correspondence: Correspondence,
    shapes: Vec<ShapeInput>,
    reference: Option<ShapeInput>,
    field: Option<AffineField>,
) -> Result<Vec<MeasuredSurface>, ServiceError> {
    let linear = representation
        .subdivision()
        .is_some_and(|subdivision| !matches!(subdivision.scheme, Scheme::NormalBased { .. }));
    let distances = match reference {
        None => vec![None; shapes.len()],
        Some(_) if !linear => {
            let detail = format!(
                "expected no reference, because these shapes have no distance: {}",
                GeometryError::NotLinear
            );
            return Err(ServiceError::invalid("/reference", detail));
        }
        Some(reference) => {
            let posted = Posted::new(app, representation, correspondence)?;
            let (shapes, reference) = posted.read_with_reference(app, shapes.clone(), Some(reference))?;
            let distance = |shape: &Matrix| {
                reference.as_ref().map(|reference| {
                    let difference = shape - reference;
                    posted.metric.inner(difference.as_slice(), difference.as_slice()).max(0.0).sqrt()
                })
            };
            shapes.iter().map(distance).collect()
        }
    };
    let splits = representation.subdivision().map_or(0, |subdivision| subdivision.level);
    let meshes = meshes(app, representation, correspondence, shapes, Wanted::Whole)?;
    let context = app.pool.context();
    let measured = |(mesh, l2): (&TriangleMesh, &Option<f64>)| {
        context.check()?;
        let measures = measure(mesh, splits > 0);
        let quality = warnings::of_split_mesh(mesh, splits, &measures, &|| context.is_cancelled());
        let flux = field.as_ref().map(|field| flux(mesh, field)).filter(|flux| flux.is_finite());
        Ok(MeasuredSurface { measures, flux, l2: *l2, quality, warnings: quality.warnings() })
    };
    meshes.par_iter().zip(&distances).map(measured).collect()
}

/// Flux `Σ_f ⟨F(centroid), S_f⟩`: exact for affine fields.
fn flux(mesh: &TriangleMesh, field: &AffineField) -> f64 {
    let through = |(face, normal): (&[u32; 3], [f64; 3])| {
        let corners = face.map(|vertex| mesh.vertices[vertex as usize]);
        let centre = [0, 1, 2].map(|c| corners.iter().map(|corner| corner[c]).sum::<f64>() / 3.0);
        let value = [0, 1, 2].map(|i| field.offset[i] + dot(field.matrix[i], centre));
        0.5 * dot(value, normal)
    };
    mesh.faces.iter().zip(mesh.face_normals()).map(through).sum()
}

/// Normals and principal curvatures of refined meshes; normals are those of the scheme if it defines them.
pub fn vertex_frames(mesh: &TriangleMesh) -> Vec<VertexFrame> {
    let mut frames = frames(mesh);
    for (frame, normal) in frames.iter_mut().zip(mesh.normals.iter().flatten()) {
        frame.normal = Some(*normal);
    }
    frames
}

/// A path between two shapes with points and normals.
#[derive(Debug)]
pub struct OrientedMorph {
    /// Position `τ`, points and unit normals of every frame.
    pub frames: Vec<(f64, Oriented)>,
    /// Meshes of the frames, for drawings.
    pub meshes: Vec<TriangleMesh>,
}

/// Shapes on the straight line between two shapes of the normal-based scheme; their normals rotate along great circles.
/// Other representations are internal errors.
///
/// # Errors
/// Faults of the representation, of the shapes at `/from…` and `/to…`, and of the positions; opposite normals.
pub fn morph(
    app: &App,
    representation: &Representation,
    positions: &Positions,
    [from, to]: [ShapeInput; 2],
    drawn: bool,
) -> Result<OrientedMorph, ServiceError> {
    let Some(subdivision) = representation.subdivision() else {
        return Err(ServiceError::Internal("only subdivision surfaces have normals".into()));
    };
    check_subdivision(subdivision, &app.limits)
        .map_err(|errors| ServiceError::below(errors, "/representation"))?;
    let Some(shapes) = OrientedMeshes::new(subdivision)? else {
        return Err(ServiceError::Internal("only the normal-based scheme has normals".into()));
    };
    let positions = positions.list(subdivision.connectivity.size().vertices, &app.limits);
    let mut faults = Faults::default();
    let read = |shape, pointer| shapes.read(shape).map_err(|errors| ServiceError::below(errors, pointer));
    let positions = faults.keep(positions)?;
    let from = faults.keep(read(from, "/from"))?;
    let to = faults.keep(read(to, "/to"))?;
    let (Some(positions), Some(from), Some(to)) = (positions, from, to) else {
        return Err(ServiceError::Invalid(faults));
    };
    let mut frames = Vec::with_capacity(positions.len());
    let context = app.pool.context();
    for tau in positions {
        context.check()?;
        frames.push((tau, between(&from, &to, tau)?));
    }
    let mesh = |(_, shape): &(f64, Oriented)| {
        context.check()?;
        let refined = shapes.refine(shape, Wanted::Drawn);
        refined.map_err(|error| ServiceError::invalid("/positions", error.to_string()))
    };
    let meshes = if drawn { frames.iter().map(mesh).collect::<Result<_, _>>()? } else { Vec::new() };
    Ok(OrientedMorph { frames, meshes })
}

/// Distance in radians from opposite directions below which two unit normals define no great circle.
const OPPOSITE: f64 = 1e-9;

fn between(from: &Oriented, to: &Oriented, tau: f64) -> Result<Oriented, ServiceError> {
    let mix = |a: [f64; 3], b: [f64; 3], [p, q]: [f64; 2]| [0, 1, 2].map(|c| p * a[c] + q * b[c]);
    let places = from.points.iter().zip(&to.points);
    let points = places.map(|(a, b)| mix(*a, *b, [1.0 - tau, tau])).collect();
    let mut normals = Vec::with_capacity(from.normals.len());
    for (vertex, (a, b)) in from.normals.iter().zip(&to.normals).enumerate() {
        let angle = norm(minus(*a, *b)).atan2(norm(mix(*a, *b, [1.0, 1.0]))) * 2.0;
        if std::f64::consts::PI - angle < OPPOSITE {
            let detail = "expected a normal that is not opposite to that of the other shape: no shortest path \
                          between opposite normals is unique";
            return Err(ServiceError::invalid(format!("/to/normals/{vertex}"), detail));
        }
        let sine = angle.sin();
        let shares = if sine > 0.0 {
            [((1.0 - tau) * angle).sin() / sine, (tau * angle).sin() / sine]
        } else {
            [1.0 - tau, tau]
        };
        normals.push(mix(*a, *b, shares));
    }
    Oriented::new(points, &normals).map_err(|vertex| {
        ServiceError::invalid(format!("/to/normals/{vertex}"), "the interpolated normal has no direction")
    })
}
