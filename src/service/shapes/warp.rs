//! Thin-plate splines between two sets of landmarks. The functions are synchronous and run on the pool.

use serde::Deserialize;

use crate::analysis::drawing::warps::{PARTS, WarpFigure, WarpView, draw_warp};
use crate::analysis::thin_plate::error::ThinPlateError;
use crate::analysis::thin_plate::lattice::Lattice;
use crate::analysis::thin_plate::{PartialWarps, ThinPlate, superimposed};
use crate::geometry::drawing::scene::Drawing;
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::mesh_tree::NearestTriangles;
use crate::numeric::dense::{Matrix, transpose_multiply};
use crate::numeric::parallel;
use crate::service::app::memory::{Held, Purpose};
use crate::service::app::{App, Limits, ServiceError};
use crate::service::shapes::read_mesh::face_pointer;
use crate::service::shapes::read_points::take_points;
use crate::wire::checked::{Checked, LARGE, document, take_given};
use crate::wire::fault::Fault;
use crate::wire::shape::PointList;

/// Maximum number of landmarks: the system has their square.
pub const MAX_LANDMARKS: usize = 2000;
/// Matrices of that size at the same time.
const MATRICES: usize = 6;
/// Numbers of a place at the same time: places, images and determinants, in the arithmetic and in the answer.
const NUMBERS: usize = 12;
/// Maximum number of landmarks of partial warps, which are the eigenvectors of that system.
const MAX_PARTIAL: usize = 500;
/// Maximum number of nodes of a grid.
const MAX_NODES: usize = 200_000;
/// Maximum number of cells along a side of a drawn grid.
const MAX_DRAWN: usize = 200;
/// Cells along the longest side of a grid in the plane and in space.
const USUAL_CELLS: [usize; 2] = [20, 10];
/// Part of the bounding box by which a grid is larger on each side.
const USUAL_MARGIN: f64 = 0.1;
/// Largest magnification of a change.
const MOST_MAGNIFIED: f64 = 1000.0;

document! {
    /// The surface of a target, a triangle mesh.
    pub struct WarpSurfaceInput {
        /// Positions of the vertices.
        #[schema(value_type = Vec<[f64; 3]>, required = true)]
        vertices: PointList, required;
        /// Triangles as indices of their vertices.
        #[schema(value_type = Vec<[u32; 3]>, required = true)]
        faces: Checked<Vec<[u32; 3]>, LARGE>, required;
    }
}

/// The grid that a warp deforms.
#[derive(Debug, Clone, Copy, Default, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct WarpGridInput {
    /// Number of cells along the longest side. Default: 20 in the plane, 10 in space.
    #[schema(minimum = 1)]
    cells: Option<usize>,
    /// Part of the bounding box of the reference by which the grid is larger on each side, 0 to 10. Default: 0.1.
    #[schema(minimum = 0, maximum = 10)]
    margin: Option<f64>,
}

impl WarpGridInput {
    /// The grid around a reference.
    fn lattice(self, reference: &Matrix) -> Result<Lattice, Fault> {
        let usual = USUAL_CELLS[usize::from(reference.ncols() == 3)];
        let (cells, margin) = (self.cells.unwrap_or(usual), self.margin.unwrap_or(USUAL_MARGIN));
        if !(0.0..=10.0).contains(&margin) {
            return Err(Fault::new(
                "/grid/margin",
                format!("expected a number between 0 and 10, got {margin}"),
            ));
        }
        if !(1..=MAX_NODES).contains(&cells) {
            return Err(Fault::new("/grid/cells", format!("expected a number of at least 1, got {cells}")));
        }
        let lattice = Lattice::around(reference, cells, margin);
        if lattice.len() > MAX_NODES {
            let detail =
                format!("expected at most {MAX_NODES} nodes, got {}: ask for fewer cells", lattice.len());
            return Err(Fault::new("/grid/cells", detail));
        }
        Ok(lattice)
    }
}

/// Options of a warp besides its landmarks.
#[derive(Debug, Clone, Default)]
pub struct WarpOptions {
    /// The grid.
    pub grid: WarpGridInput,
    /// Whether the target is moved, turned and scaled onto the reference first.
    pub superimpose: bool,
    /// Factor of the change.
    pub magnify: f64,
    /// λ at unit size.
    pub smoothing: f64,
    /// Whether partial warps are wanted.
    pub partial_warps: bool,
    /// Pairs of landmarks between which lines are drawn.
    pub links: Vec<[usize; 2]>,
}

/// Landmarks of a warp that fit together.
#[derive(Debug)]
pub struct WarpTask {
    reference: Matrix,
    target: Matrix,
    points: Option<Matrix>,
    surface: Option<TriangleMesh>,
    lattice: Lattice,
    options: WarpOptions,
}

/// Positions that a warp leads to.
#[derive(Debug)]
pub struct WarpFound {
    /// `tr(YᵀBY)`.
    pub bending_energy: f64,
    /// Affine part, the constant first.
    pub affine: Matrix,
    /// Largest distance of a warped landmark from its target.
    pub residual: f64,
    /// Warped points.
    pub points: Option<Matrix>,
    /// Distances to the surface onto which points were projected.
    pub distances: Option<Vec<f64>>,
    /// The lattice with its images and the determinants there.
    pub lattice: Lattice,
    /// Images of the nodes.
    pub nodes: Matrix,
    /// Determinants at the nodes.
    pub determinants: Vec<f64>,
    /// Number of nodes with a determinant that is not positive.
    pub folds: usize,
    /// Principal warps, and the scores of the target in each.
    pub partial_warps: Option<(PartialWarps, Matrix)>,
    /// Warnings.
    pub warnings: Vec<String>,
}

/// Points of a list, one per row.
fn listed(list: Option<&PointList>, dimension: usize, most: usize) -> Result<Matrix, Vec<Fault>> {
    let Some(list) = list.filter(|list| !list.is_null()) else {
        return Err(vec![Fault::new("", "expected a list of points, got none")]);
    };
    if list.grid().is_some() {
        return Err(vec![Fault::new("", "expected a list of points, got a grid")]);
    }
    if list.len() > most {
        return Err(vec![Fault::new("", format!("expected at most {most} points, got {}", list.len()))]);
    }
    Ok(Matrix::from_row_slice(list.len(), dimension, list.checked(dimension)?))
}

fn surface(input: WarpSurfaceInput, limits: &Limits) -> Result<TriangleMesh, Vec<Fault>> {
    let mut errors = input.faults;
    let vertices = take_points::<3>(&input.vertices, "/vertices", &mut errors);
    let faces = take_given(input.faces, "/faces", &mut errors);
    let (Some(vertices), Some(faces)) = (vertices, faces) else {
        errors.push(Fault::new("", "expected vertices and faces"));
        return Err(errors);
    };
    if vertices.len() > limits.vertices || faces.len() > 2 * limits.vertices {
        let detail = format!("expected at most {} vertices and twice as many faces", limits.vertices);
        errors.push(Fault::new("", format!("{detail}, got {} and {}", vertices.len(), faces.len())));
    }
    if faces.is_empty() {
        errors.push(Fault::new("/faces", "expected at least one triangle, got none"));
    }
    let mesh = TriangleMesh { vertices, normals: None, faces };
    if let Err(fault) = mesh.check_faces() {
        errors.push(Fault::new(format!("/faces{}", face_pointer(&fault)), fault.to_string()));
    }
    if errors.is_empty() { Ok(mesh) } else { Err(errors) }
}

/// The parts of a request.
#[derive(Debug)]
pub struct WarpParts {
    /// Landmarks before.
    pub reference: Option<PointList>,
    /// Landmarks after.
    pub target: Option<PointList>,
    /// Points to warp.
    pub points: Option<PointList>,
    /// Surface onto which warped points are projected.
    pub onto: Option<WarpSurfaceInput>,
    /// The rest.
    pub options: WarpOptions,
}

impl WarpTask {
    /// Reads the parts of a request.
    ///
    /// # Errors
    /// Faults of the parts, at their places.
    pub fn new(app: &App, parts: WarpParts) -> Result<Self, ServiceError> {
        let WarpParts { reference, target, points, onto, options } = parts;
        let dimension = reference.as_ref().map_or(2, |list| list.width().clamp(2, 3));
        let mut faults = Vec::new();
        let mut read =
            |list: Option<&PointList>, most: usize, pointer: &str| match listed(list, dimension, most) {
                Ok(points) => Some(points),
                Err(found) => {
                    faults.extend(found.into_iter().map(|fault| fault.below(pointer)));
                    None
                }
            };
        let landmarks = read(reference.as_ref(), MAX_LANDMARKS, "/reference").zip(read(
            target.as_ref(),
            MAX_LANDMARKS,
            "/target",
        ));
        let points = points.as_ref().and_then(|list| read(Some(list), app.limits.points, "/points"));
        let surface = onto.and_then(|onto| match surface(onto, &app.limits) {
            Ok(mesh) => Some(mesh),
            Err(found) => {
                faults.extend(found.into_iter().map(|fault| fault.below("/onto")));
                None
            }
        });
        if surface.is_some() && (dimension != 3 || points.is_none()) {
            faults.push(Fault::new("/onto", "expected with points in space only"));
        }
        let Some((reference, target)) = landmarks else { return Err(ServiceError::below(faults, "")) };
        faults.extend(options.faults(&reference, &target));
        ServiceError::unless_empty(faults)?;
        let lattice =
            options.grid.lattice(&reference).map_err(|fault| ServiceError::below(vec![fault], ""))?;
        Ok(Self { reference, target, points, surface, lattice, options })
    }

    /// Numbers of landmarks and of places where the map is evaluated: points, nodes, and points of a drawn grid.
    pub fn counts(&self, draws: bool) -> [usize; 2] {
        let size = &self.lattice.size;
        let planes: usize = size[1..].iter().map(|other| 2 * PARTS * size[0] * other).sum();
        let drawn = if draws { planes } else { 0 };
        [
            self.reference.nrows(),
            self.points.as_ref().map_or(0, Matrix::nrows) + 2 * self.lattice.len() + drawn,
        ]
    }

    /// Checks that the grid can be drawn.
    ///
    /// # Errors
    /// Too many cells, at `/grid/cells`.
    pub fn check_drawn(&self) -> Result<(), ServiceError> {
        let found = self.lattice.size.iter().max().map_or(0, |nodes| nodes - 1);
        if found <= MAX_DRAWN {
            return Ok(());
        }
        let detail = format!("expected at most {MAX_DRAWN} cells in a drawing, got {found}");
        Err(ServiceError::invalid("/grid/cells", detail))
    }

    /// Whether partial warps are wanted.
    pub fn has_partial_warps(&self) -> bool {
        self.options.partial_warps
    }

    /// Number of projected points.
    pub fn projected(&self) -> usize {
        self.surface.as_ref().and(self.points.as_ref()).map_or(0, Matrix::nrows)
    }

    /// The target that is warped to.
    fn wanted(&self) -> Matrix {
        let options = &self.options;
        let target = if options.superimpose {
            superimposed(&self.target, &self.reference)
        } else {
            self.target.clone()
        };
        if options.magnify == 1.0 {
            target
        } else {
            &self.reference + (target - &self.reference) * options.magnify
        }
    }

    /// The system of the landmarks, and room for its matrices and for the places where the map is evaluated.
    fn plate(&self, app: &App) -> Result<(ThinPlate, Held), ServiceError> {
        let entries = self.reference.nrows() * self.reference.nrows();
        let numbers = MATRICES * entries + NUMBERS * self.counts(true)[1];
        let room = app.memory.hold(Purpose::Bodies, size_of::<f64>() * numbers)?;
        Ok((ThinPlate::new(&self.reference, self.options.smoothing).map_err(refused)?, room))
    }

    /// Computes the warp.
    ///
    /// # Errors
    /// Landmarks without a spline, at `/reference`; [`ServiceError::Cancelled`].
    pub fn found(&self, app: &App) -> Result<WarpFound, ServiceError> {
        let (plate, _room) = self.plate(app)?;
        app.pool.context().check()?;
        let target = self.wanted();
        let warp = plate.warp(&target);
        let partial_warps = self.options.partial_warps.then(|| {
            let warps = plate.partial_warps();
            let scores = transpose_multiply(&warps.warps, &target);
            (warps, scores)
        });
        app.pool.context().check()?;
        let mut points = self.points.as_ref().map(|points| warp.warped(points));
        let distances =
            self.surface.as_ref().zip(points.as_mut()).map(|(mesh, points)| project(mesh, points));
        let nodes = self.lattice.nodes();
        let determinants = warp.determinants(&nodes);
        let folds = determinants.iter().filter(|determinant| !(**determinant > 0.0)).count();
        Ok(WarpFound {
            bending_energy: warp.bending_energy(),
            affine: warp.affine(),
            residual: largest_distance(&warp.warped(&self.reference), &target),
            warnings: self.warnings(folds, nodes.nrows()),
            points,
            distances,
            lattice: self.lattice.clone(),
            nodes: warp.warped(&nodes),
            determinants,
            folds,
            partial_warps,
        })
    }

    /// Draws the warp.
    ///
    /// # Errors
    /// As [`found`](Self::found).
    pub fn drawing(&self, app: &App, view: WarpView, numbers: bool) -> Result<Drawing, ServiceError> {
        let (plate, _room) = self.plate(app)?;
        let target = self.wanted();
        let warp = plate.warp(&target);
        let figure = WarpFigure {
            warp: &warp,
            reference: &self.reference,
            target: &target,
            lattice: &self.lattice,
            links: &self.options.links,
            numbers,
        };
        let determinants = warp.determinants(&self.lattice.nodes());
        let folds = determinants.iter().filter(|determinant| !(**determinant > 0.0)).count();
        Ok(draw_warp(view, &figure, folds))
    }

    fn warnings(&self, folds: usize, nodes: usize) -> Vec<String> {
        let mut warnings = Vec::new();
        if folds > 0 {
            warnings.push(format!(
                "the map folds: its determinant is not positive at {folds} of {nodes} nodes of the grid around the reference"
            ));
        }
        let outside = self.points.as_ref().map_or(0, |points| self.lattice.outside(points));
        if outside > 0 {
            warnings.push(format!(
                "{outside} points lie beyond the grid around the reference, where the map is extrapolated"
            ));
        }
        warnings
    }
}

impl WarpOptions {
    fn faults(&self, reference: &Matrix, target: &Matrix) -> Vec<Fault> {
        let mut faults = Vec::new();
        let mut unless = |holds: bool, pointer: &str, detail: String| {
            if !holds {
                faults.push(Fault::new(pointer, detail));
            }
        };
        let p = reference.nrows();
        let needed = reference.ncols() + 1;
        unless(p >= needed, "/reference", format!("expected at least {needed} landmarks, got {p}"));
        let found = target.nrows();
        unless(found == p, "/target", format!("expected {p} landmarks as in the reference, got {found}"));
        let magnified = self.magnify;
        let detail = format!("expected a number within ±{MOST_MAGNIFIED}, got {magnified}");
        unless(magnified.abs() <= MOST_MAGNIFIED, "/magnify", detail);
        let smoothing = self.smoothing;
        let detail = format!("expected a number between 0 and 1e6, got {smoothing}");
        unless((0.0..=1e6).contains(&smoothing), "/smoothing", detail);
        let detail = format!("expected at most {MAX_PARTIAL} landmarks with partial warps, got {p}");
        unless(!self.partial_warps || p <= MAX_PARTIAL, "/partial_warps", detail);
        let most = 4 * MAX_LANDMARKS;
        let links = self.links.len();
        unless(links <= most, "/links", format!("expected at most {most} pairs, got {links}"));
        if let Some(k) = self.links.iter().position(|[a, b]| a == b || *a.max(b) >= p) {
            let [a, b] = self.links[k];
            unless(
                false,
                &format!("/links/{k}"),
                format!("expected two landmarks below {p}, got [{a}, {b}]"),
            );
        }
        faults
    }
}

/// Moves points (in space) onto a mesh; returns how far.
fn project(mesh: &TriangleMesh, points: &mut Matrix) -> Vec<f64> {
    let tree = NearestTriangles::new(&mesh.vertices, &mesh.faces);
    let at = |k: usize| [0, 1, 2].map(|c| points[(k, c)]);
    let feet = parallel::map(points.nrows(), &|k| tree.nearest(at(k)));
    let mut distances = vec![0.0; feet.len()];
    for (k, foot) in feet.into_iter().enumerate() {
        if let Some(foot) = foot {
            distances[k] = foot.distance;
            (0..3).for_each(|c| points[(k, c)] = foot.point[c]);
        }
    }
    distances
}

fn largest_distance(a: &Matrix, b: &Matrix) -> f64 {
    (a - b).row_iter().map(|row| row.norm()).fold(0.0, f64::max)
}

/// Refusal of landmarks without a spline.
fn refused(error: ThinPlateError) -> ServiceError {
    let pointer = match error {
        ThinPlateError::Coincident { second, .. } => format!("/reference/{second}"),
        _ => "/reference".into(),
    };
    ServiceError::invalid(&pointer, error.to_string())
}
