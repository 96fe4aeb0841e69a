//! Refinement of posted meshes and polylines by a subdivision scheme. The functions are synchronous and run on the pool.

use super::read_mesh::face_pointer;
use super::read_points::{given, take_points};
use crate::geometry::GeometryError;
use crate::geometry::capability::refine::RefinedMesh;
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::subdivision::Scheme;
use crate::geometry::subdivision::control::StartMesh;
use crate::geometry::subdivision::normal_based::{Oriented, circle_normals, inconsistent, sphere_normals};
use crate::geometry::subdivision::oriented::corner_warning;
use crate::geometry::subdivision::refinement::{Depth, Polyline, Refined, refine_curve};
use crate::service::app::{App, Limits, ServiceError};
use crate::wire::checked::{Checked, LARGE, document, take_given};
use crate::wire::fault::Fault;
use crate::wire::shape::PointList;

document! {
    /// A triangle mesh to be refined; closed, or for the schemes `loop` and `normal_based` with a boundary.
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
        /// Binormals of the edges, vectors in space of any length, for edges whose normals define none: those of half a circle are
        /// along it. `[0, 0, 0]` where none is needed. An edge with the direction `u` and the binormal `f` bends to the side of
        /// `f × u`: in the plane, `[0, 0, -1]` bends to the right. Two points with binormals make a closed curve.
        #[schema(value_type = Option<Vec<[f64; 3]>>)]
        binormals: PointList;
    }
}

impl ControlMeshInput {
    /// Number of vertices given.
    pub fn vertex_count(&self) -> usize {
        given(&self.vertices).map_or(0, |points| points.len())
    }
}

impl PolylineInput {
    /// Number of points given.
    pub fn point_count(&self) -> usize {
        given(&self.points).map_or(0, |points| points.len())
    }
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

/// Refines a starting mesh that covers the unit sphere once.
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
    let named = start;
    let start = start.covering_once();
    let (vertices, most) = (start.size().vertices, app.limits.points);
    if vertices > most {
        let detail =
            format!("expected a start with at most {most} vertices, got \"{start}\" with {vertices}");
        return Err(ServiceError::invalid("/start", detail));
    }
    let mesh = start.mesh();
    let normals = matches!(scheme, Scheme::NormalBased { .. }).then(|| mesh.vertices.clone());
    let renamed = (named != start).then(|| {
        format!(
            "\"{named}\" was read as \"{start}\", which covers the sphere once; as connectivity of a representation \"{named}\" \
             covers it twice"
        )
    });
    let corrections = renamed.into_iter().collect();
    refine(app, scheme, (TriangleMesh { normals, ..mesh }, "/start"), depth, wanted_limit, corrections)
}

fn refine(
    app: &App,
    scheme: Scheme,
    (mesh, pointer): (TriangleMesh, &str),
    depth: Depth,
    wanted_limit: bool,
    corrections: Vec<String>,
) -> Result<RefinedMesh, ServiceError> {
    let context = app.pool.context();
    let (most, stop) = (app.limits.vertices, || context.is_cancelled());
    let mut refined = RefinedMesh::new(scheme, mesh, depth, most, wanted_limit, &stop)
        .map_err(|error| refused(&error, pointer))?;
    context.check()?;
    refined.warnings.splice(0..0, corrections);
    Ok(refined)
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
    let oriented = Oriented::from_given(mesh.vertices.clone(), normals, |_| sphere_normals(&mesh));
    let (shape, caveat) = oriented.map_err(|fault| vec![Fault::from(fault)])?;
    let mesh = TriangleMesh { vertices: shape.points, normals: Some(shape.normals), faces: mesh.faces };
    Ok((mesh, caveat.into_iter().collect()))
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
    let (polyline, dimension, mut warnings) =
        read_polyline(polyline, &app.limits).map_err(|errors| ServiceError::below(errors, "/polyline"))?;
    let ends: Vec<[usize; 2]> = polyline.ends().collect();
    warnings.extend(corner_warning(&polyline.shape, &ends, balance.get()));
    let context = app.pool.context();
    let stop = || context.is_cancelled();
    let refined = refine_curve(polyline, balance.get(), depth, app.limits.vertices, &stop);
    context.check()?;
    let refined = refined.map_err(|error| refused(&error, "/polyline"))?;
    Ok(RefinedCurve { refined, dimension, warnings })
}

/// A polyline, its dimension, and warnings.
type ReadPolyline = (Polyline, usize, Vec<String>);

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
    let binormals = take_points::<3>(&input.binormals, "/binormals", &mut errors);
    if points.is_none() && errors.is_empty() {
        errors.push(Fault::new("/points", "required field is missing"));
    }
    let (Some(points), Some(closed), true) = (points, closed, errors.is_empty()) else { return Err(errors) };
    // Two points close to a curve if their edges differ, which only binormals tell.
    let (count, fewest) = (points.len(), if closed && binormals.is_none() { 3 } else { 2 });
    if !(fewest..=limits.points).contains(&count) {
        let detail = format!("expected between {fewest} and {} points, got {count}", limits.points);
        return Err(vec![Fault::new("/points", detail)]);
    }
    if normals.is_none() && dimension == 3 {
        let detail = "required field is missing: neighbouring points define normals in the plane only";
        return Err(vec![Fault::new("/normals", detail)]);
    }
    let edges = if closed { count } else { count - 1 };
    let binormals = binormals.unwrap_or_default();
    check_binormals(&binormals, edges, dimension)?;
    let oriented = Oriented::from_given(points, normals, |points| circle_normals(points, closed));
    let (shape, caveat) = oriented.map_err(|fault| vec![Fault::from(fault)])?;
    let mut warnings: Vec<String> = caveat.into_iter().collect();
    if dimension == 2
        && let Some(vertex) = inconsistent(&shape.points, &shape.normals, closed)
    {
        warnings.push(format!(
            "the normal of point {vertex} lies on the other side of one of its edges than the others do: the curve has a cusp there"
        ));
    }
    Ok((Polyline { shape, closed, binormals }, dimension, warnings))
}

/// Checks binormals of a polyline with `edges` edges; none are fine.
fn check_binormals(binormals: &[[f64; 3]], edges: usize, dimension: usize) -> Result<(), Vec<Fault>> {
    if !binormals.is_empty() && binormals.len() != edges {
        let detail = format!("expected {edges} entries, one per edge, got {}", binormals.len());
        return Err(vec![Fault::new("/binormals", detail)]);
    }
    let leaves = |[x, y, _]: &[f64; 3]| dimension == 2 && (*x != 0.0 || *y != 0.0);
    let faults =
        binormals.iter().enumerate().filter(|(_, binormal)| leaves(binormal)).map(|(i, binormal)| {
            let detail = format!(
                "expected a multiple of [0, 0, 1], orthogonal to the plane of the points, got [{}, {}, {}]",
                binormal[0], binormal[1], binormal[2]
            );
            Fault::new(format!("/binormals/{i}"), detail)
        });
    let faults: Vec<Fault> = faults.collect();
    if faults.is_empty() { Ok(()) } else { Err(faults) }
}
