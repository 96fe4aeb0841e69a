//! Least-squares fits of shapes to points and meshes.
//!
//! Curves are fitted at the parameters of the points, or at arc length; surfaces at parameters that are given or, on a
//! closed mesh without handles, computed; refined meshes at the places nearest to the points, in alternating rounds. A fit
//! that folds, or that runs away from its points, is refused.

use super::domain::Domain;
use super::measure::mesh_warnings;
use crate::GeometryError;
use crate::field_fault::FieldFault;
use crate::fit::{Fit, Samples};
use crate::mesh::{MeshError, TriangleMesh};
use crate::representation::{Representation, ShapeSpace};
use crate::resample::{Contour, RepeatedPoints};
use crate::subdivision::fit::{Fitting, SubdivisionFit, Target, mesh_targets, overshoot};
use crate::surface::basis::SurfaceBasis;
use crate::surface::fit::{
    SurfaceFit, SurfaceSample, fit, mesh_samples, spherical_direction, spherical_parameters,
};
use crate::surface::parameterisation::spherical_until;
use crate::vector::{dot, far_origin, minus, norm};
use shapelex_numeric::bounded::Stop;
use shapelex_numeric::dense::Matrix;

/// Points or a mesh to which a shape is fitted.
#[derive(Debug, Clone)]
pub enum FitTarget {
    /// Points, `P × d`.
    Points {
        /// Positions, one row per point.
        points: Matrix,
        /// PointPlaces of the points on the shape.
        places: PointPlaces,
    },
    /// A triangle mesh with valid faces.
    Mesh {
        /// The mesh.
        mesh: TriangleMesh,
        /// Source of the parameters of its vertices.
        source: ParameterSource,
    },
}

/// PointPlaces of points on the shape that is fitted to them.
#[derive(Debug, Clone, PartialEq)]
pub enum PointPlaces {
    /// Not given: arc length along a contour, the nearest places on a refined mesh.
    Free,
    /// Parameters `u`, strictly increasing.
    Line(Vec<f64>),
    /// Pairs of parameters `u` and `v`.
    Pairs(Vec<[f64; 2]>),
    /// Equally spaced on a grid with these numbers of places along `u` and `v`; `v` varies fastest.
    Grid([usize; 2]),
}

/// Source of the parameters of the vertices of a mesh.
#[derive(Debug, Clone, PartialEq)]
pub enum ParameterSource {
    /// Given pairs of `u` and `v`.
    Given(Vec<[f64; 2]>),
    /// Positions on a sphere about the origin, none of them at the origin.
    Sphere(Vec<[f64; 3]>),
    /// Computed on a closed mesh without handles.
    Computed {
        /// Vertices at the north and the south pole. Default: those at the ends of the longest principal axis.
        poles: Option<[u32; 2]>,
    },
}

/// A fitted shape.
#[derive(Debug, Clone)]
pub struct Fitted {
    /// Representation of the shape.
    pub representation: Representation,
    /// Its control points.
    pub control_points: Matrix,
    /// Root of the weighted mean squared distance of the points from their places.
    pub residual: f64,
    /// Largest such distance.
    pub largest: f64,
    /// Weighted mean of these distances, of surfaces with two parameters.
    pub mean: Option<f64>,
    /// Parameters of the vertices of a mesh, for surfaces with parameters.
    pub parameters: Option<Vec<[f64; 2]>>,
    /// Fraction of the area of a mesh over which a surface with parameters is folded.
    pub folded: Option<f64>,
    /// Defects of the mesh.
    pub warnings: Vec<String>,
}

/// Choices of a fit.
#[derive(Debug, Clone, Default)]
pub struct FitSettings {
    /// Largest residual of a curve or a surface with parameters, whose number of control points is then chosen. Default: the size of the
    /// space.
    pub tolerance: Option<f64>,
    /// Maximum number of control points under a tolerance.
    pub max_control_points: usize,
    /// Number of rounds for a refined mesh.
    pub turns: usize,
    /// Initial control points of a refined mesh. Default: a start of the control mesh.
    pub start: Option<Matrix>,
}

/// Number of control points along each direction from which a search for a tolerance begins; the minimum of the representation is more.
const SMALLEST_WIDTH: usize = 2;

/// Maximum fraction of the area over which a fit may be folded; beyond it, the result is not a valid surface.
const MAX_FOLDED: f64 = 0.05;

/// Maximum distance of the surface's vertices from the bounding box of its points, relative to the diagonal. Beyond it,
/// the fit has diverged.
const MAX_OVERSHOOT: f64 = 0.25;

/// Approximate multiply-adds per round for the targets of a refined mesh.
const PER_ROUND: f64 = 5e7;

impl ShapeSpace {
    /// Multiply-adds of the normal equations of `count` fits with `turns` rounds; `None` for curves, whose equations are
    /// banded.
    pub fn fit_operations(&self, count: usize, turns: usize) -> Option<f64> {
        let cube = (self.gram().size() as f64).powi(3);
        match self.domain() {
            Domain::Points | Domain::Line { .. } => None,
            Domain::Sheet { .. } => Some(count as f64 * cube / 3.0),
            Domain::Vertices => Some(count as f64 * (turns + 1) as f64 * (cube / 3.0 + PER_ROUND)),
        }
    }
}

impl Domain {
    /// Faults of the parameters of the points of one fit: `u` that do not increase, pairs outside of the domain.
    pub fn place_faults(self, places: &PointPlaces) -> Vec<FieldFault> {
        match places {
            PointPlaces::Free | PointPlaces::Grid(_) => Vec::new(),
            PointPlaces::Pairs(list) => self.pair_faults(list),
            PointPlaces::Line(list) => {
                let most = if self == (Self::Line { closed: true }) { 1.0_f64.next_down() } else { 1.0 };
                let wrong = |j: usize| !(0.0..=most).contains(&list[j]) || (j > 0 && list[j] <= list[j - 1]);
                let fault = |index: usize| {
                    let error = GeometryError::Parameter { index, value: list[index] };
                    FieldFault::new(index.to_string(), error.to_string())
                };
                (0..list.len()).find(|&j| wrong(j)).map(fault).into_iter().collect()
            }
        }
    }
}

/// Contour through points; a repeated point that is refused is named by its index.
///
/// # Errors
/// The fault of the list of points.
pub fn contour(points: Matrix, closed: bool, repeated: RepeatedPoints) -> Result<Contour, FieldFault> {
    Contour::new(points, closed, repeated).map_err(|error| {
        let field = match error {
            GeometryError::RepeatedPoint { second, .. } => second.to_string(),
            _ => String::new(),
        };
        FieldFault::new(field, error.to_string())
    })
}

/// Prepared fits of shapes of one space.
#[derive(Debug)]
pub struct Fitter<'a> {
    space: &'a ShapeSpace,
    settings: FitSettings,
    method: Method<'a>,
}

#[derive(Debug)]
enum Method<'a> {
    Curve { closed: bool },
    Surface(&'a SurfaceBasis),
    Refined(Fitting<'a>),
}

impl<'a> Fitter<'a> {
    /// Prepares fits. Cost: for refined meshes, that of [`Fitting::new`].
    ///
    /// # Errors
    /// [`GeometryError::NotACurve`] for landmarks.
    pub fn new(space: &'a ShapeSpace, settings: FitSettings) -> Result<Self, GeometryError> {
        let refined = space.subdivision().zip(space.representation().subdivision());
        let method = match (space.domain(), space.surface(), refined) {
            (Domain::Line { closed }, _, _) => Method::Curve { closed },
            (_, Some(basis), _) => Method::Surface(basis),
            (_, _, Some((basis, subdivision))) => {
                Method::Refined(Fitting::new(basis, &subdivision.connectivity, subdivision.level))
            }
            _ => return Err(GeometryError::NotACurve),
        };
        Ok(Self { space, settings, method })
    }

    /// Whether a start is needed and not given.
    pub fn lacks_start(&self) -> bool {
        match &self.method {
            Method::Refined(fitting) => self.settings.start.is_none() && !fitting.has_start(),
            Method::Curve { .. } | Method::Surface(_) => false,
        }
    }

    /// Fits one shape. Once `stop` returns true, the result is unfinished and of no use.
    ///
    /// # Errors
    /// Faults of the points at `points…`; of a mesh at `vertices`, `faces…`, `parameters…`, `poles`; of the fit itself at the
    /// points, or at the mesh as a whole.
    pub fn fit(&self, target: FitTarget, stop: Stop<'_>) -> Result<Fitted, Vec<FieldFault>> {
        match (&self.method, target) {
            (Method::Curve { closed }, FitTarget::Points { points, places }) => {
                self.fit_curve(points, places, *closed, stop)
            }
            (Method::Surface(basis), FitTarget::Points { points, places }) => {
                self.within(basis, "points", stop, &|basis| self.fit_surface(basis, &points, places.clone()))
            }
            (Method::Surface(basis), FitTarget::Mesh { mesh, source }) => {
                let parameters = self.surface_parameters(basis, &mesh, source, stop)?;
                self.within(basis, "vertices", stop, &|basis| {
                    self.fit_surface_to_mesh(basis, &mesh, &parameters, stop)
                })
            }
            (Method::Refined(fitting), FitTarget::Points { points, .. }) => {
                let target = |row: usize| Target { point: point(&points, row), weight: 1.0 };
                let targets: Vec<Target> = (0..points.nrows()).map(target).collect();
                let found = self.fit_refined(fitting, &targets, &[], stop);
                found.map_err(|detail| vec![FieldFault::new("points", detail)])
            }
            (Method::Refined(fitting), FitTarget::Mesh { mesh, source }) => {
                self.fit_refined_to_mesh(fitting, &mesh, source, stop)
            }
            (Method::Curve { .. }, FitTarget::Mesh { .. }) => {
                Err(vec![FieldFault::new("", "expected points: curves have no mesh")])
            }
        }
    }

    fn fit_curve(
        &self,
        points: Matrix,
        places: PointPlaces,
        closed: bool,
        stop: Stop<'_>,
    ) -> Result<Fitted, Vec<FieldFault>> {
        let refused = |error: GeometryError| vec![FieldFault::new("points", error.to_string())];
        let samples = match places {
            PointPlaces::Line(parameters) if parameters.len() != points.nrows() => {
                let detail = format!(
                    "expected one point per parameter ({1}), got {0}",
                    points.nrows(),
                    parameters.len()
                );
                return Err(vec![FieldFault::new("points", detail)]);
            }
            PointPlaces::Line(parameters) => Samples::new(points, parameters, closed),
            _ => {
                let contour = contour(points, closed, RepeatedPoints::Drop)
                    .map_err(|fault| vec![below_points(fault)])?;
                Samples::new(contour.points().clone(), contour.parameters(), closed)
            }
        };
        let (samples, settings) = (samples.map_err(refused)?, &self.settings);
        let representation = self.space.representation();
        let found = match settings.tolerance {
            None => samples.fit(self.space),
            Some(tolerance) => {
                samples.fit_within_until(representation, tolerance, settings.max_control_points, stop)
            }
        };
        let Fit { representation, control_points, residual, largest } = found.map_err(refused)?;
        Ok(Fitted { representation, ..self.fitted(control_points, residual, largest) })
    }

    /// The `fit` on `basis`, or under a tolerance the one with the fewest control points that meets it, with as many along `u` as along
    /// `v`. The search is by doubling and bisection; fits of different sizes are not nested, so a smaller one may exist by
    /// chance. Sizes that cannot be fitted, and those that fold, count as failed.
    fn within(
        &self,
        basis: &SurfaceBasis,
        field: &str,
        stop: Stop<'_>,
        fit: &dyn Fn(&SurfaceBasis) -> Result<Fitted, Vec<FieldFault>>,
    ) -> Result<Fitted, Vec<FieldFault>> {
        let Some(tolerance) = self.settings.tolerance else { return fit(basis) };
        let refused = |error: GeometryError| vec![FieldFault::new(field, error.to_string())];
        let of_width = |width: usize| self.space.representation().of_width(width);
        let attempt = |width: usize| {
            let space = ShapeSpace::new(&of_width(width)).map_err(refused)?;
            let basis = space.surface().ok_or_else(|| refused(GeometryError::NotACurve))?;
            Ok::<_, Vec<FieldFault>>(Fitted { representation: space.representation().clone(), ..fit(basis)? })
        };
        let fits = |width: usize| of_width(width).size() <= self.settings.max_control_points;
        let (mut best, mut last_fault): (Option<Fitted>, _) = (None, Vec::new());
        let (mut failed, mut width) = (0, SMALLEST_WIDTH);
        let mut found = loop {
            match attempt(width) {
                Ok(fitted) if fitted.residual <= tolerance || stop() => break fitted,
                Ok(fitted) if best.as_ref().is_none_or(|best| fitted.residual < best.residual) => {
                    best = Some(fitted);
                }
                Ok(_) => {}
                Err(faults) => last_fault = faults,
            }
            failed = width;
            let next = (width + 1..=2 * width).rev().find(|&next| fits(next));
            let Some(next) = next.filter(|_| !stop()) else {
                let Fitted { residual, representation, .. } = best.ok_or(last_fault)?;
                let (count, most) = (representation.size(), of_width(width).size());
                return Err(refused(GeometryError::Tolerance { tolerance, residual, count, most }));
            };
            width = next;
        };
        while width > failed + 1 && !stop() {
            let middle = failed.midpoint(width);
            match attempt(middle) {
                Ok(fitted) if fitted.residual <= tolerance => (found, width) = (fitted, middle),
                _ => failed = middle,
            }
        }
        Ok(found)
    }

    fn fit_surface(
        &self,
        basis: &SurfaceBasis,
        points: &Matrix,
        places: PointPlaces,
    ) -> Result<Fitted, Vec<FieldFault>> {
        let refused = |detail: String| vec![FieldFault::new("points", detail)];
        let pairs = match places {
            PointPlaces::Pairs(pairs) if pairs.len() != points.nrows() => {
                return Err(refused(format!(
                    "expected one point per entry of the parameters ({1}), got {0}",
                    points.nrows(),
                    pairs.len()
                )));
            }
            PointPlaces::Pairs(pairs) => pairs,
            PointPlaces::Grid(grid) => {
                let surface = basis.surface(&Matrix::zeros(basis.gram().size(), 3));
                let [u, v] = [0, 1].map(|i| surface.parameters(i, grid[i]));
                u.iter().flat_map(|&u| v.iter().map(move |&v| [u, v])).collect()
            }
            PointPlaces::Free | PointPlaces::Line(_) => {
                let detail = "expected a grid [u][v], a list of points with their parameters, or a mesh";
                return Err(refused(detail.into()));
            }
        };
        let sample = |(row, parameters): (usize, [f64; 2])| SurfaceSample {
            parameters,
            point: point(points, row),
            weight: 1.0,
        };
        let samples: Vec<SurfaceSample> = pairs.into_iter().enumerate().map(sample).collect();
        let SurfaceFit { rows, residual, mean, largest } =
            fit(basis, &samples).map_err(|error| refused(error.to_string()))?;
        Ok(Fitted { mean: Some(mean), ..self.fitted(rows, residual, largest) })
    }

    /// Fits a surface to the faces of a mesh, and not only to its vertices.
    fn fit_surface_to_mesh(
        &self,
        basis: &SurfaceBasis,
        mesh: &TriangleMesh,
        parameters: &[[f64; 2]],
        stop: Stop<'_>,
    ) -> Result<Fitted, Vec<FieldFault>> {
        let (faces, samples): (Vec<usize>, Vec<SurfaceSample>) =
            mesh_samples(basis, mesh, parameters).into_iter().unzip();
        let SurfaceFit { rows, residual, mean, largest } =
            fit(basis, &samples).map_err(|error| vec![FieldFault::new("vertices", error.to_string())])?;
        let folded = folded(basis, &rows, mesh, &faces, &samples).map_err(|fault| vec![fault])?;
        Ok(Fitted {
            mean: Some(mean),
            parameters: Some(parameters.to_vec()),
            folded: Some(folded),
            warnings: mesh_warnings(mesh, stop),
            ..self.fitted(rows, residual, largest)
        })
    }

    /// Parameters of the vertices of a mesh on a surface.
    fn surface_parameters(
        &self,
        basis: &SurfaceBasis,
        mesh: &TriangleMesh,
        source: ParameterSource,
        stop: Stop<'_>,
    ) -> Result<Vec<[f64; 2]>, Vec<FieldFault>> {
        let topology = basis.extent().topology;
        match source {
            ParameterSource::Given(parameters) => {
                let faults = self.space.domain().pair_faults(&parameters);
                if faults.is_empty() {
                    return Ok(parameters);
                }
                let below =
                    |fault: FieldFault| FieldFault { field: format!("parameters/{}", fault.field), ..fault };
                Err(faults.into_iter().map(below).collect())
            }
            _ if !topology.has_poles() => {
                let detail =
                    format!("required for a {}: parameters are computed for spheres only", topology.name());
                Err(vec![FieldFault::new("parameters", detail)])
            }
            ParameterSource::Sphere(points) => Ok(points.into_iter().map(spherical_parameters).collect()),
            ParameterSource::Computed { poles } => {
                spherical_until(mesh, poles, stop).map_err(|error| vec![sphere_fault(&error, poles, "faces")])
            }
        }
    }

    /// Fits a refined mesh to the faces of a mesh.
    fn fit_refined_to_mesh(
        &self,
        fitting: &Fitting<'_>,
        mesh: &TriangleMesh,
        source: ParameterSource,
        stop: Stop<'_>,
    ) -> Result<Fitted, Vec<FieldFault>> {
        if !(mesh.face_areas().iter().sum::<f64>() > 0.0) {
            return Err(vec![FieldFault::new("faces", "expected faces with an area")]);
        }
        let round = |list: Vec<[f64; 2]>| list.into_iter().map(spherical_direction).collect();
        let directions: Option<Vec<[f64; 3]>> = match source {
            _ if self.settings.start.is_some() => None,
            ParameterSource::Given(parameters) => Some(round(parameters)),
            ParameterSource::Sphere(points) => Some(points.into_iter().map(unit).collect()),
            ParameterSource::Computed { poles } => {
                let found = spherical_until(mesh, poles, stop);
                Some(round(found.map_err(|error| vec![sphere_fault(&error, poles, "vertices")])?))
            }
        };
        let (targets, directions) = mesh_targets(mesh, directions.as_deref());
        let found = self.fit_refined(fitting, &targets, &directions, stop);
        let found = found.map_err(|detail| vec![FieldFault::new("", detail)])?;
        Ok(Fitted { warnings: mesh_warnings(mesh, stop), ..found })
    }

    /// Fits around a point near the targets if these are far from the origin, to preserve the precision of their
    /// coordinates.
    fn fit_refined(
        &self,
        fitting: &Fitting<'_>,
        targets: &[Target],
        directions: &[[f64; 3]],
        stop: Stop<'_>,
    ) -> Result<Fitted, String> {
        let points: Vec<[f64; 3]> = targets.iter().map(|target| target.point).collect();
        let found = match far_origin(points.iter()) {
            None => self.fit_near(fitting, targets, directions, [0.0; 3], stop)?,
            Some(origin) => {
                let about = |target: &Target| Target { point: minus(target.point, origin), ..*target };
                let targets: Vec<Target> = targets.iter().map(about).collect();
                let mut found = self.fit_near(fitting, &targets, directions, origin, stop)?;
                found.rows.column_iter_mut().zip(origin).for_each(|(mut column, x)| column.add_scalar_mut(x));
                found
            }
        };
        Ok(self.fitted(found.rows, found.residual, found.largest))
    }

    fn fit_near(
        &self,
        fitting: &Fitting<'_>,
        targets: &[Target],
        directions: &[[f64; 3]],
        origin: [f64; 3],
        stop: Stop<'_>,
    ) -> Result<SubdivisionFit, String> {
        let text = |error: GeometryError| error.to_string();
        let mut start = self.start(fitting, targets, directions).map_err(text)?;
        if self.settings.start.is_some() {
            start.column_iter_mut().zip(origin).for_each(|(mut column, x)| column.add_scalar_mut(-x));
        }
        let found = fitting.fit_until(targets, start, self.settings.turns, stop).map_err(text)?;
        // A stopped fit is discarded.
        let beyond = overshoot(&fitting.points(&found.rows), targets);
        if beyond <= MAX_OVERSHOOT {
            return Ok(found);
        }
        Err(format!(
            "the points do not constrain the surface: it runs {:.0} % of the extent beyond them. Use fewer \
             control points or turns, or another start",
            100.0 * beyond
        ))
    }

    /// The given start; otherwise the start on the ellipsoid of the targets, or at their directions if these are known.
    fn start(
        &self,
        fitting: &Fitting<'_>,
        targets: &[Target],
        directions: &[[f64; 3]],
    ) -> Result<Matrix, GeometryError> {
        if let Some(start) = &self.settings.start {
            return Ok(start.clone());
        }
        let found = if directions.is_empty() {
            fitting.ellipsoid(targets)?
        } else {
            fitting.at_directions(targets, directions)?
        };
        let needed = self.space.gram().size();
        found.ok_or(GeometryError::TooFewPoints { found: targets.len(), needed })
    }

    fn fitted(&self, control_points: Matrix, residual: f64, largest: f64) -> Fitted {
        Fitted {
            representation: self.space.representation().clone(),
            control_points,
            residual,
            largest,
            mean: None,
            parameters: None,
            folded: None,
            warnings: Vec::new(),
        }
    }
}

/// Fraction of the area of a mesh over which the normal of the surface points against that of the mesh.
fn folded(
    basis: &SurfaceBasis,
    rows: &Matrix,
    mesh: &TriangleMesh,
    faces: &[usize],
    samples: &[SurfaceSample],
) -> Result<f64, FieldFault> {
    let (surface, normals) = (basis.surface(rows), mesh.face_normals());
    let (mut area, mut folded, mut first) = (0.0, 0.0, None);
    for (face, SurfaceSample { parameters: [u, v], weight, .. }) in faces.iter().zip(samples) {
        let normal = surface.frame(*v, &surface.jet(*u, *v)).normal;
        area += weight;
        if normal.is_none_or(|normal| dot(normal, normals[*face]) < 0.0) && surface.is_orientable() {
            folded += weight;
            first = first.or(Some(*face));
        }
    }
    let folded = folded / area;
    let Some(face) = first.filter(|_| folded > MAX_FOLDED) else { return Ok(folded) };
    let detail = format!(
        "the fitted surface folds: over {:.1} % of the area its normal points against that of the mesh, \
         first at face {face}. Turn the faces if they are clockwise seen from outside. Otherwise use \
         other parameters or poles, or other numbers of control points",
        100.0 * folded
    );
    Err(FieldFault::new("", detail))
}

/// Locates an error of computed parameters; a positive genus is a fault of `genus_field`.
fn sphere_fault(error: &GeometryError, poles: Option<[u32; 2]>, genus_field: &str) -> FieldFault {
    let field = match error {
        GeometryError::Mesh(fault) => mesh_field(fault),
        GeometryError::Poles { .. } if poles.is_some() => "poles".into(),
        GeometryError::NotASphere { .. } => genus_field.into(),
        _ => "vertices".into(),
    };
    FieldFault::new(field, error.to_string())
}

/// Path of the face of a mesh with a fault, or of all vertices.
pub fn mesh_field(fault: &MeshError) -> String {
    fault.face().map_or_else(|| "vertices".into(), |face| format!("faces/{face}"))
}

fn below_points(fault: FieldFault) -> FieldFault {
    let place = if fault.field.is_empty() { String::new() } else { format!("/{}", fault.field) };
    FieldFault { field: format!("points{place}"), ..fault }
}

fn point(points: &Matrix, row: usize) -> [f64; 3] {
    [0, 1, 2].map(|c| points[(row, c)])
}

fn unit(point: [f64; 3]) -> [f64; 3] {
    let length = norm(point);
    point.map(|x| x / length)
}
