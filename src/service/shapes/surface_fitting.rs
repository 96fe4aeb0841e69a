//! Fits of surfaces to grids, point clouds with parameters and triangle meshes. The functions are synchronous and run
//! on the pool.
//!
//! Parameters are given or, for closed meshes without handles, computed. A fit that is folded is refused.

use crate::formats::fault::Fault;
use std::borrow::Borrow;

use super::curves::{below_points, each_of, each_shape};
use super::read;
use super::request::Posted;
use super::surfaces::outside;
use crate::formats::checked::{Checked, LARGE, document, take_given};
use crate::formats::shape::{PointList, ShapeInput};
use crate::geometry::GeometryError;
use crate::geometry::mesh::{MeshError, TriangleMesh};
use crate::geometry::surface::Topology;
use crate::geometry::surface::fit::{SurfaceSample, fit, mesh_samples, spherical_parameters};
use crate::geometry::surface::parameterisation::spherical_until;
use crate::geometry::vector::{dot, norm};
use crate::numeric::bounded::Stop;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, Limits, ServiceError, warnings};

document! {
    /// A triangle mesh to which a surface is fitted.
    pub struct MeshInput {
        /// Positions of the vertices.
        #[schema(value_type = Vec<[f64; 3]>, required = true)]
        vertices: PointList, required;
        /// Triangles as indices of their vertices, counter-clockwise as seen from outside.
        #[schema(value_type = Vec<[u32; 3]>, required = true)]
        faces: Checked<Vec<[u32; 3]>, LARGE>, required;
        /// Parameters `u` and `v` of every vertex.
        #[schema(value_type = Option<Vec<[f64; 2]>>)]
        parameters: PointList;
        /// Spherical parameterisation as an alternative to `parameters`: the position of every vertex on a sphere about
        /// the origin, with the north in direction z.
        #[schema(value_type = Option<Vec<[f64; 3]>>)]
        sphere: PointList;
        /// Indices of the vertices at the north and the south pole, used when parameters are computed. Default: those
        /// at the ends of the longest principal axis.
        #[schema(value_type = Option<[u32; 2]>)]
        poles: Checked<[u32; 2]>;
    }
}

/// A fitted surface.
#[derive(Debug, Clone)]
pub struct FittedSurface {
    /// Control points of the surface.
    pub control_points: Matrix,
    /// Root of the weighted mean squared distance at the parameters.
    pub residual: f64,
    /// Largest distance at the parameters.
    pub largest: f64,
    /// Parameters of the vertices of a mesh.
    pub parameters: Option<Vec<[f64; 2]>>,
    /// Fraction of the area of a mesh over which the surface is folded.
    pub folded: Option<f64>,
    /// Warnings about the mesh.
    pub warnings: Vec<String>,
}

/// Maximum fraction of the area over which a fit may be folded; beyond it, the result is not a valid surface.
const MAX_FOLDED: f64 = 0.05;

/// Maximum number of multiply-adds for the normal equations of a request: a minute of work.
const MAX_OPERATIONS: f64 = 1e11;

/// Checks the total work of `count` fits, of `N³/3` multiply-adds each.
fn check_work(posted: &Posted, count: usize, pointer: &str) -> Result<(), ServiceError> {
    let operations = count as f64 * (posted.metric.size() as f64).powi(3) / 3.0;
    if operations <= MAX_OPERATIONS {
        return Ok(());
    }
    let detail = format!(
        "expected at most {MAX_OPERATIONS:.0e} multiply-adds for all fits, got {operations:.0e} ({count} \
         entries): send fewer entries, or use fewer control points"
    );
    Err(ServiceError::invalid(pointer, detail))
}

/// Fits surfaces to points: of a grid of any size at its equally spaced parameters, or of a list at `parameters`.
///
/// # Errors
/// Faults of the shapes; points that leave gaps.
pub fn fit_points(
    app: &App,
    posted: &Posted,
    parameters: Option<&[Vec<[f64; 2]>]>,
    shapes: Vec<ShapeInput>,
) -> Result<Vec<FittedSurface>, ServiceError> {
    if shapes.is_empty() {
        return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
    }
    check_work(posted, shapes.len(), "/shapes")?;
    if let Some(lists) = parameters {
        if lists.len() != shapes.len() {
            let detail = format!("expected one list per shape ({1}), got {0}", lists.len(), shapes.len());
            return Err(ServiceError::invalid("/parameters", detail));
        }
        let wild = lists.iter().enumerate();
        let faults = wild.flat_map(|(i, list)| outside(&posted.space, list, &format!("/parameters/{i}")));
        ServiceError::unless_empty(faults.collect())?;
    }
    each_shape(&app.pool.context(), shapes, |index, shape| {
        let list = read::given(&shape.points).cloned();
        read::attributes(shape)?;
        let list = list.ok_or_else(|| vec![Fault::new("", "expected points, got none")])?;
        let coordinates = list.checked(3).map_err(below_points)?;
        let refused = |detail: String| Err(vec![Fault::new("/points", detail)]);
        if list.len() > app.limits.points {
            return refused(format!("expected at most {1} points, got {0}", list.len(), app.limits.points));
        }
        let places = match (parameters.map(|lists| &lists[index]), list.grid()) {
            (Some(places), _) if places.len() != list.len() => {
                return refused(format!(
                    "expected one point per entry of the parameters ({1}), got {0}",
                    list.len(),
                    places.len()
                ));
            }
            (Some(places), _) => places.clone(),
            (None, Some(grid)) => {
                let surface = posted.surface(&Matrix::zeros(posted.metric.size(), 3));
                let [u, v] = [0, 1].map(|i| surface.parameters(i, grid[i]));
                u.iter().flat_map(|&u| v.iter().map(move |&v| [u, v])).collect()
            }
            (None, None) => {
                return refused(
                    "expected a grid [u][v], a list of points with their parameters, or a mesh".into(),
                );
            }
        };
        let sample = |(point, parameters): (&[f64], [f64; 2])| SurfaceSample {
            parameters,
            point: [point[0], point[1], point[2]],
            weight: 1.0,
        };
        let samples: Vec<SurfaceSample> = coordinates.chunks_exact(3).zip(places).map(sample).collect();
        let found =
            fit(posted.basis(), &samples).map_err(|error| vec![Fault::new("/points", error.to_string())])?;
        Ok(FittedSurface {
            control_points: found.rows,
            residual: found.residual,
            largest: found.largest,
            parameters: None,
            folded: None,
            warnings: Vec::new(),
        })
    })
}

/// Fits surfaces to triangle meshes, using their faces and not only their vertices.
///
/// Parameters are given, derived from given positions on a sphere, or, for a closed mesh without handles, computed: see
/// [`spherical_until`].
///
/// # Errors
/// Faults of the meshes, at `/meshes/{index}…`; vertices that leave gaps; fits that are folded.
pub fn fit_meshes(
    app: &App,
    posted: &Posted,
    meshes: Vec<MeshInput>,
) -> Result<Vec<FittedSurface>, ServiceError> {
    if meshes.is_empty() {
        return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
    }
    check_work(posted, meshes.len(), "/meshes")?;
    let context = app.pool.context();
    let stop = || context.is_cancelled();
    each_of(&context, "meshes", meshes, |_, mesh| PostedMesh::read(mesh, &app.limits)?.fit(posted, &stop))
}

/// A validated mesh.
pub(crate) struct PostedMesh {
    pub(crate) mesh: TriangleMesh,
    pub(crate) source: ParameterSource,
}

/// Source of the parameters of a mesh.
pub(crate) enum ParameterSource {
    Given(Vec<[f64; 2]>),
    Sphere(Vec<[f64; 3]>),
    Computed { poles: Option<[u32; 2]> },
}

impl PostedMesh {
    pub(crate) fn read(input: MeshInput, limits: &Limits) -> Result<Self, Vec<Fault>> {
        let mut errors = input.faults;
        let vertices = take_points(&input.vertices, "/vertices", &mut errors);
        let faces = take_given(input.faces, "/faces", &mut errors);
        let parameters = take_points(&input.parameters, "/parameters", &mut errors);
        let sphere = take_points(&input.sphere, "/sphere", &mut errors);
        let poles = take_given(input.poles, "/poles", &mut errors);
        // A field that is present but null has not been reported as missing.
        if vertices.is_none() && errors.is_empty() {
            errors.push(Fault::new("/vertices", "required field is missing"));
        }
        let (Some(vertices), Some(faces), true) = (vertices, faces, errors.is_empty()) else {
            return Err(errors);
        };
        let mut error = |pointer: &str, detail: String| errors.push(Fault::new(pointer, detail));
        let count = vertices.len();
        if count > limits.points || faces.len() > 4 * limits.points {
            error(
                "",
                format!(
                    "expected at most {1} vertices and {2} faces, got {count} and {0}",
                    faces.len(),
                    limits.points,
                    4 * limits.points
                ),
            );
        }
        let lengths =
            [(parameters.as_ref().map(Vec::len), "/parameters"), (sphere.as_ref().map(Vec::len), "/sphere")];
        for (length, pointer) in lengths {
            if let Some(length) = length.filter(|length| *length != count) {
                error(pointer, format!("expected {count} entries, one per vertex, got {length}"));
            }
        }
        if let Some(index) =
            sphere.as_ref().and_then(|list| list.iter().position(|point| norm(*point) == 0.0))
        {
            error(
                &format!("/sphere/{index}"),
                "expected a point other than the origin, which has no direction".into(),
            );
        }
        let mesh = TriangleMesh { vertices, normals: None, faces };
        if let Err(fault) = mesh.check_faces() {
            error(&mesh_pointer(&fault), fault.to_string());
        }
        let source = match (parameters, sphere, poles) {
            (Some(parameters), None, None) => ParameterSource::Given(parameters),
            (None, Some(sphere), None) => ParameterSource::Sphere(sphere),
            (None, None, poles) => ParameterSource::Computed { poles },
            _ => {
                error("", "expected only one of parameters, sphere and poles".into());
                ParameterSource::Computed { poles: None }
            }
        };
        if errors.is_empty() { Ok(Self { mesh, source }) } else { Err(errors) }
    }

    fn fit(self, posted: &Posted, stop: Stop<'_>) -> Result<FittedSurface, Vec<Fault>> {
        let one = |pointer: &str, detail: String| vec![Fault::new(pointer, detail)];
        let topology = posted.basis().extent().topology;
        let parameters = match self.source {
            ParameterSource::Given(parameters) => {
                let faults = outside(&posted.space, &parameters, "/parameters");
                if !faults.is_empty() {
                    return Err(faults
                        .into_iter()
                        .map(|fault| Fault::new(fault.pointer, fault.detail))
                        .collect());
                }
                parameters
            }
            _ if topology != Topology::Sphere => {
                let detail = format!(
                    "required for a {}: parameters are computed for the topology sphere only",
                    topology.name()
                );
                return Err(one("/parameters", detail));
            }
            ParameterSource::Sphere(points) => points.into_iter().map(spherical_parameters).collect(),
            ParameterSource::Computed { poles } => {
                spherical_until(&self.mesh, poles, stop).map_err(|error| {
                    let pointer = match &error {
                        GeometryError::Mesh(fault) => mesh_pointer(fault),
                        GeometryError::Poles { .. } if poles.is_some() => "/poles".into(),
                        GeometryError::NotASphere { .. } => "/faces".into(),
                        _ => "/vertices".into(),
                    };
                    one(&pointer, error.to_string())
                })?
            }
        };
        let (faces, samples): (Vec<usize>, Vec<SurfaceSample>) =
            mesh_samples(posted.basis(), &self.mesh, &parameters).into_iter().unzip();
        let found = fit(posted.basis(), &samples).map_err(|error| one("/vertices", error.to_string()))?;
        let surface = posted.surface(&found.rows);
        let normals = self.mesh.face_normals();
        let (mut area, mut folded, mut first) = (0.0, 0.0, None);
        for (face, SurfaceSample { parameters: [u, v], weight, .. }) in faces.iter().zip(&samples) {
            let normal = surface.frame(*v, &surface.jet(*u, *v)).normal;
            area += weight;
            if normal.is_none_or(|normal| dot(normal, normals[*face]) < 0.0) && surface.is_orientable() {
                folded += weight;
                first = first.or(Some(*face));
            }
        }
        let folded = folded / area;
        if let Some(face) = first.filter(|_| folded > MAX_FOLDED) {
            let detail = format!(
                "the fitted surface folds: over {:.1} % of the area its normal points against that of the mesh, \
                 first at face {face}. Turn the faces if they are clockwise seen from outside. Otherwise use \
                 other parameters or poles, or other numbers of control points",
                100.0 * folded
            );
            return Err(one("", detail));
        }
        Ok(FittedSurface {
            control_points: found.rows,
            residual: found.residual,
            largest: found.largest,
            parameters: Some(parameters),
            folded: Some(folded),
            warnings: warnings::of_posted_mesh(&self.mesh, stop),
        })
    }
}

/// Reads a list of points with `D` coordinates each.
pub(crate) fn take_points<const D: usize>(
    list: &Option<impl Borrow<PointList>>,
    pointer: &str,
    errors: &mut Vec<Fault>,
) -> Option<Vec<[f64; D]>> {
    let list = read::given(list)?;
    match list.checked(D) {
        Ok(coordinates) if list.grid().is_none() => Some(coordinates.as_chunks().0.to_vec()),
        Ok(_) => {
            errors.push(Fault::new(pointer, "expected a list of points, got a grid"));
            None
        }
        Err(found) => {
            errors.extend(found.into_iter().map(|error| error.below(pointer)));
            None
        }
    }
}

pub(crate) fn mesh_pointer(fault: &MeshError) -> String {
    match fault.face() {
        Some(face) => format!("/faces/{face}"),
        None => "/vertices".into(),
    }
}
