//! Fits of subdivision surfaces to triangle meshes and point clouds. The functions are synchronous and run on the pool.
//!
//! A fit alternates between the nearest places of its targets and the control vertices, for a given number of rounds. A
//! surface that diverges from its points is refused.

use crate::formats::fault::Fault;
use std::f64::consts::{PI, TAU};

use super::curves::{below_points, each_of, each_shape};
use super::read;
use super::request::Posted;
use super::surface_fitting::{MeshInput, ParameterSource, PostedMesh, mesh_pointer};
use crate::formats::shape::ShapeInput;
use crate::geometry::GeometryError;
use crate::geometry::subdivision::Subdivision;
use crate::geometry::subdivision::fit::{Fitting, SubdivisionFit, Target, mesh_targets, overshoot};
use crate::geometry::surface::parameterisation::spherical_until;
use crate::geometry::vector::{far_origin, minus, norm};
use crate::numeric::bounded::Stop;
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError, warnings};

/// Search for control vertices.
#[derive(Debug)]
pub struct Search {
    /// Number of rounds, which alternate between nearest places and control vertices.
    pub turns: usize,
    /// Initial control points of all fits.
    pub start: Option<ShapeInput>,
}

/// Default number of rounds.
pub const USUAL_TURNS: usize = 20;
/// Maximum number of rounds.
pub const MAX_TURNS: usize = 200;

/// Maximum number of multiply-adds of a request: a minute of work.
const MAX_OPERATIONS: f64 = 1e11;
/// Approximate multiply-adds per round for the targets of a mesh.
const PER_FIT: f64 = 5e7;

/// Maximum distance of the surface's vertices from the bounding box of its points, relative to the diagonal. Beyond it,
/// the fit has diverged.
const MAX_OVERSHOOT: f64 = 0.25;

/// A fitted surface.
#[derive(Debug, Clone)]
pub struct FittedMesh {
    /// Control vertices and residuals.
    pub fit: SubdivisionFit,
    /// Warnings about the mesh to which it was fitted.
    pub warnings: Vec<String>,
}

/// Fits of one request.
struct Fits<'a> {
    fitting: Fitting<'a>,
    posted: &'a Posted,
    start: Option<Matrix>,
    turns: usize,
}

impl<'a> Fits<'a> {
    fn new(
        app: &App,
        posted: &'a Posted,
        subdivision: &Subdivision,
        search: Search,
        count: usize,
        list: &str,
    ) -> Result<Self, ServiceError> {
        if count == 0 {
            return Err(ServiceError::TooFewShapes { found: 0, needed: 1 });
        }
        let cube = (posted.metric.size() as f64).powi(3) / 3.0;
        let operations = count as f64 * (search.turns + 1) as f64 * (cube + PER_FIT);
        if operations > MAX_OPERATIONS {
            let detail = format!(
                "expected at most {MAX_OPERATIONS:.0e} multiply-adds for all fits, got {operations:.0e} \
                 ({count} entries): send fewer entries, or use fewer turns or control points"
            );
            return Err(ServiceError::invalid(list, detail));
        }
        let start = search.start.map(|shape| posted.read_one(app, shape, "/start")).transpose()?;
        let fitting = Fitting::new(posted.steps(), &subdivision.connectivity, subdivision.level);
        if start.is_none() && !fitting.has_start() {
            let detail =
                "required field is missing: only control meshes named after a body have a start of their own";
            return Err(ServiceError::invalid("/start", detail));
        }
        Ok(Self { fitting, posted, start, turns: search.turns })
    }

    /// Start given in the request; otherwise the start on the ellipsoid of the targets, or at their directions if these
    /// are known.
    fn start(&self, targets: &[Target], directions: &[[f64; 3]]) -> Result<Matrix, GeometryError> {
        if let Some(start) = &self.start {
            return Ok(start.clone());
        }
        let found = if directions.is_empty() {
            self.fitting.ellipsoid(targets)?
        } else {
            self.fitting.at_directions(targets, directions)?
        };
        // A mesh without a start of its own was refused before.
        found.ok_or(GeometryError::TooFewPoints { found: targets.len(), needed: self.posted.metric.size() })
    }

    /// Fits around a point near the targets if these are far from the origin, to preserve the precision of their
    /// coordinates.
    fn fit(
        &self,
        targets: &[Target],
        directions: &[[f64; 3]],
        stop: Stop<'_>,
    ) -> Result<SubdivisionFit, Vec<Fault>> {
        let points: Vec<[f64; 3]> = targets.iter().map(|target| target.point).collect();
        let Some(origin) = far_origin(points.iter()) else {
            return self.fit_near(targets, directions, [0.0; 3], stop);
        };
        let about = |target: &Target| Target { point: minus(target.point, origin), ..*target };
        let targets: Vec<Target> = targets.iter().map(about).collect();
        let mut found = self.fit_near(&targets, directions, origin, stop)?;
        found.rows.column_iter_mut().zip(origin).for_each(|(mut column, x)| column.add_scalar_mut(x));
        Ok(found)
    }

    fn fit_near(
        &self,
        targets: &[Target],
        directions: &[[f64; 3]],
        origin: [f64; 3],
        stop: Stop<'_>,
    ) -> Result<SubdivisionFit, Vec<Fault>> {
        let one = |error: GeometryError| vec![Fault::new("", error.to_string())];
        let mut start = self.start(targets, directions).map_err(one)?;
        if self.start.is_some() {
            start.column_iter_mut().zip(origin).for_each(|(mut column, x)| column.add_scalar_mut(-x));
        }
        let found = self.fitting.fit_until(targets, start, self.turns, stop).map_err(one)?;
        // A stopped fit is discarded.
        let beyond = overshoot(&self.posted.steps().points(&found.rows), targets);
        if !(beyond <= MAX_OVERSHOOT) {
            let detail = format!(
                "the points do not constrain the surface: it runs {:.0} % of the extent beyond them. Use fewer \
                 control points or turns, or another start",
                100.0 * beyond
            );
            return Err(vec![Fault::new("", detail)]);
        }
        Ok(found)
    }
}

/// Fits surfaces to point clouds, starting from the ellipsoid of their moments or from the given start.
///
/// # Errors
/// Faults of the shapes and of the start; clouds that do not determine a surface.
pub fn fit_clouds(
    app: &App,
    posted: &Posted,
    subdivision: &Subdivision,
    search: Search,
    shapes: Vec<ShapeInput>,
) -> Result<Vec<FittedMesh>, ServiceError> {
    let fits = Fits::new(app, posted, subdivision, search, shapes.len(), "/shapes")?;
    let context = app.pool.context();
    let stop = || context.is_cancelled();
    each_shape(&context, shapes, |_, shape| {
        let list = read::given(&shape.points).cloned();
        read::attributes(shape)?;
        let list = list.ok_or_else(|| vec![Fault::new("", "expected points, got none")])?;
        let coordinates = list.checked(3).map_err(below_points)?;
        let (count, fewest) = (list.len(), posted.metric.size());
        if !(fewest..=app.limits.points).contains(&count) {
            let detail = format!(
                "expected between {fewest} and {} points (at least as many as control points), got {count}",
                app.limits.points
            );
            return Err(vec![Fault::new("/points", detail)]);
        }
        let targets: Vec<Target> =
            coordinates.as_chunks().0.iter().map(|&point| Target { point, weight: 1.0 }).collect();
        let fit = fits.fit(&targets, &[], &stop).map_err(below_points)?;
        Ok(FittedMesh { fit, warnings: Vec::new() })
    })
}

/// Fits surfaces to the faces of triangle meshes, starting from a spherical parameterisation or from the given start.
///
/// # Errors
/// Faults of the meshes and of the start; meshes that do not determine a surface.
pub fn fit_meshes(
    app: &App,
    posted: &Posted,
    subdivision: &Subdivision,
    search: Search,
    meshes: Vec<MeshInput>,
) -> Result<Vec<FittedMesh>, ServiceError> {
    let fits = Fits::new(app, posted, subdivision, search, meshes.len(), "/meshes")?;
    let context = app.pool.context();
    let stop = || context.is_cancelled();
    each_of(&context, "meshes", meshes, |_, mesh| {
        let PostedMesh { mesh, source } = PostedMesh::read(mesh, &app.limits)?;
        if !(mesh.face_areas().iter().sum::<f64>() > 0.0) {
            return Err(vec![Fault::new("/faces", "expected faces with an area")]);
        }
        let directions = match source {
            _ if fits.start.is_some() => None,
            ParameterSource::Given(parameters) => {
                Some(parameters.into_iter().map(direction).collect::<Vec<_>>())
            }
            ParameterSource::Sphere(points) => Some(points.into_iter().map(unit).collect()),
            ParameterSource::Computed { poles } => {
                let parameters = spherical_until(&mesh, poles, &stop).map_err(|error| {
                    let pointer = match &error {
                        GeometryError::Mesh(fault) => mesh_pointer(fault),
                        GeometryError::Poles { .. } if poles.is_some() => "/poles".into(),
                        _ => "/vertices".into(),
                    };
                    vec![Fault::new(pointer, error.to_string())]
                })?;
                Some(parameters.into_iter().map(direction).collect())
            }
        };
        let (targets, directions) = mesh_targets(&mesh, directions.as_deref());
        let fit = fits.fit(&targets, &directions, &stop)?;
        Ok(FittedMesh { fit, warnings: warnings::of_posted_mesh(&mesh, &stop) })
    })
}

/// Point of the unit sphere with a longitude in whole turns and a colatitude in half turns.
fn direction([u, v]: [f64; 2]) -> [f64; 3] {
    let ((su, cu), (sv, cv)) = ((TAU * u).sin_cos(), (PI * v).sin_cos());
    [sv * cu, sv * su, cv]
}

fn unit(point: [f64; 3]) -> [f64; 3] {
    let length = norm(point);
    point.map(|x| x / length)
}
