//! Stateless use cases of single surfaces: evaluation, measures, meshes, resizing, idealised surfaces.
//!
//! The request carries all data, and nothing is stored. The functions are synchronous and run on the pool.

use super::curves::each;
use super::request::Posted;
use super::subdivisions;
use crate::formats::fault::Fault;
use crate::formats::shape::ShapeInput;
use crate::geometry::curve::MAX_DERIVATIVE;
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::quality::MeshQuality;
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::geometry::surface::basis::Extent;
use crate::geometry::surface::ideal::IdealSurface;
use crate::geometry::surface::jet::{Jet, ORDERS, SurfaceFrame};
use crate::geometry::surface::measures::{AffineField, SurfaceMeasures, flux, l2};
use crate::geometry::surface::seam::Seam;
use crate::geometry::surface::{Surface, Topology};
use crate::geometry::vector::{minus, norm};
use crate::numeric::dense::Matrix;
use crate::service::app::{App, ServiceError, warnings};

/// Parameters at which surfaces are evaluated.
#[derive(Debug, Clone)]
pub enum SurfaceParameters {
    /// A grid of equally spaced parameters: at `i/count` along closed directions, at `i/(count − 1)` along open ones.
    Grid([usize; 2]),
    /// The given pairs of `u` and `v`.
    At(Vec<[f64; 2]>),
}

impl SurfaceParameters {
    /// Number of places.
    pub fn count(&self) -> usize {
        match self {
            Self::Grid([u, v]) => u.saturating_mul(*v),
            Self::At(list) => list.len(),
        }
    }
}

/// Values of one surface.
#[derive(Debug, Clone)]
pub struct SurfaceEvaluation {
    /// Number of places along `v` if they form a grid; `v` varies fastest.
    pub columns: Option<usize>,
    /// Value and requested derivatives, coordinate-major, in the order of [`ORDERS`].
    pub derivatives: Vec<Vec<f64>>,
    /// Normals and curvatures, if requested.
    pub frames: Option<Vec<SurfaceFrame>>,
}

/// Evaluates surfaces, their derivatives up to `order`, and their frames.
///
/// # Errors
/// Too many places, parameters out of range.
pub fn evaluate(
    app: &App,
    posted: &Posted,
    shapes: &[Matrix],
    parameters: &SurfaceParameters,
    order: usize,
    frames: bool,
) -> Result<Vec<SurfaceEvaluation>, ServiceError> {
    let mut faults = Vec::new();
    if order > MAX_DERIVATIVE {
        faults.push(Fault::new("/derivatives", format!("expected 0, 1 or {MAX_DERIVATIVE}, got {order}")));
    }
    let orders = [1, 3, 6][order.min(MAX_DERIVATIVE)];
    let (places, pointer) = match parameters {
        SurfaceParameters::Grid([u, v]) => (u.saturating_mul(*v), "/grid"),
        SurfaceParameters::At(list) => (list.len(), "/parameters"),
    };
    // Points and derivatives; a normal and two curvatures.
    let values = 3 * orders + if frames { 5 } else { 0 };
    let (total, most) =
        (places.saturating_mul(shapes.len()).saturating_mul(values), app.limits.answer_numbers);
    if places == 0 || total > most {
        let detail = format!("expected a request for between 1 and {most} numbers, got {total}");
        faults.push(Fault::new(pointer, detail));
    }
    if let SurfaceParameters::At(list) = parameters {
        faults.extend(outside(&posted.space, list, "/parameters"));
    }
    ServiceError::unless_empty(faults)?;
    // Reserved before the computation, so that no work is done for a response that does not fit in memory.
    let _room = app.memory.foresee(total)?;
    let evaluated = |shape: &Matrix| {
        let surface = posted.surface(shape);
        match parameters {
            SurfaceParameters::Grid(count) => {
                let [u, v] = [0, 1].map(|i| surface.parameters(i, count[i]));
                if orders == 1 && !frames {
                    let derivatives = vec![columns(&surface.points(&u, &v), |point| *point)];
                    return SurfaceEvaluation { columns: Some(count[1]), derivatives, frames: None };
                }
                let jets = surface.jets(&u, &v);
                let at = |i: usize| v[i % v.len()];
                of_jets(&surface, &jets, at, orders, frames, Some(count[1]))
            }
            SurfaceParameters::At(list) => {
                let jets: Vec<Jet> = list.iter().map(|[u, v]| surface.jet(*u, *v)).collect();
                of_jets(&surface, &jets, |i| list[i][1], orders, frames, None)
            }
        }
    };
    each(&app.pool.context(), shapes, evaluated)
}

fn of_jets(
    surface: &Surface,
    jets: &[Jet],
    v: impl Fn(usize) -> f64,
    orders: usize,
    frames: bool,
    count_v: Option<usize>,
) -> SurfaceEvaluation {
    debug_assert!(orders <= ORDERS.len());
    SurfaceEvaluation {
        columns: count_v,
        derivatives: (0..orders).map(|order| columns(jets, |jet| jet[order])).collect(),
        frames: frames.then(|| jets.iter().enumerate().map(|(i, jet)| surface.frame(v(i), jet)).collect()),
    }
}

/// Points as coordinate-major numbers.
fn columns<T>(items: &[T], point: impl Fn(&T) -> [f64; 3]) -> Vec<f64> {
    let point = &point;
    (0..3).flat_map(|c| items.iter().map(move |item| point(item)[c])).collect()
}

/// Faults of parameters outside of the domain of the surfaces of a space.
pub(crate) fn outside(space: &ShapeSpace, list: &[[f64; 2]], pointer: &str) -> Vec<Fault> {
    let Some(basis) = space.surface() else { return Vec::new() };
    let (closed, straight) = (basis.extent().topology.closed(), basis.seam().is_straight());
    let wrong = |i: usize, value: f64| match (closed[i], i == 0 && !straight) {
        (true, false) => false,
        (true, true) => !(0.0..1.0).contains(&value),
        (false, _) => !(0.0..=1.0).contains(&value),
    };
    let faults = list.iter().enumerate().filter_map(|(k, parameters)| {
        let i = (0..2).find(|&i| wrong(i, parameters[i]))?;
        let detail = format!("expected a number between 0 and 1, got {}", parameters[i]);
        Some(Fault::new(format!("{pointer}/{k}/{i}"), detail))
    });
    faults.collect()
}

/// Measures of one surface.
#[derive(Debug, Clone)]
pub struct MeasuredSurface {
    /// Volume, area, centroids, bounding box.
    pub measures: SurfaceMeasures,
    /// Flux of the field, if one is given and the result is finite.
    pub flux: Option<f64>,
    /// `(∬ |σ − σ_ref|² du dv)^½`, if a reference is given.
    pub l2: Option<f64>,
    /// Quality of its mesh.
    pub quality: MeshQuality,
    /// The same, as text.
    pub warnings: Vec<String>,
}

/// Maximum number of cells between knots measured in one request: a minute of work.
const MAX_CELLS: usize = 2_000_000;

/// Measures surfaces.
///
/// # Errors
/// Faults of the shapes, and of the reference at `/reference…`; too many cells.
pub fn measure(
    app: &App,
    posted: &Posted,
    shapes: Vec<ShapeInput>,
    reference: Option<ShapeInput>,
    field: Option<AffineField>,
) -> Result<Vec<MeasuredSurface>, ServiceError> {
    let (shapes, reference) = posted.read_with_reference(app, shapes, reference)?;
    let cells = posted.space.representation().knots().iter().map(|knots| knots.count).product::<usize>();
    let total = cells.saturating_mul(shapes.len());
    if total > MAX_CELLS {
        let detail = format!("expected at most {MAX_CELLS} cells between knots in one request, got {total}");
        return Err(ServiceError::invalid("/shapes", detail));
    }
    let distance = |shape: &Matrix, reference: &Matrix| {
        let difference = shape - reference;
        posted.metric.inner(difference.as_slice(), difference.as_slice()).max(0.0).sqrt()
    };
    let context = app.pool.context();
    let measured = |shape: &Matrix| {
        let surface = posted.surface(shape);
        let measures = SurfaceMeasures::of(&surface);
        let quality = warnings::of_surface(&surface, &measures, &|| context.is_cancelled());
        MeasuredSurface {
            measures,
            flux: field.as_ref().map(|field| flux(&surface, field)).filter(|flux| flux.is_finite()),
            l2: reference.as_ref().map(|reference| distance(shape, reference)),
            quality,
            warnings: quality.warnings(),
        }
    };
    each(&context, &shapes, measured)
}

/// Minimum and maximum number of places along a direction of a default grid.
const USUAL_CELLS: [usize; 2] = [24, 256];

/// Default number of places along `u` and `v`: two for every interval between knots, at least 24 and at most 256.
pub fn usual_grid(Extent { topology, intervals }: Extent) -> [usize; 2] {
    let closed = topology.closed();
    [0, 1].map(|i| {
        intervals[i].saturating_mul(2).clamp(USUAL_CELLS[0], USUAL_CELLS[1]) + usize::from(!closed[i])
    })
}

/// Maximum number of vertices of a mesh: a tenth of a second.
const MAX_VERTICES: usize = 250_000;

/// Triangle mesh of a shape at `grid` places along `u` and `v`. Default: two for every interval between knots, within
/// bounds. A subdivision surface has the mesh of its level.
///
/// # Errors
/// [`ServiceError::Query`] for shapes that are not surfaces and for invalid grids.
pub fn mesh(
    space: &ShapeSpace,
    control_points: &[f64],
    grid: Option<[usize; 2]>,
) -> Result<TriangleMesh, ServiceError> {
    let refused = |detail: String| Err(ServiceError::Query(detail));
    if let Some(basis) = space.subdivision() {
        if grid.is_some() {
            return refused(
                "grid belongs to tensor-product surfaces: a subdivision surface has a level".into(),
            );
        }
        let mesh = basis.mesh(&Matrix::from_column_slice(basis.control().vertices(), 3, control_points));
        return Ok(subdivisions::with_normals(mesh));
    }
    let Some(basis) = space.surface() else {
        return refused("only surfaces are written as meshes: ask for 'json' or 'svg'".into());
    };
    let topology = basis.extent().topology;
    let closed = topology.closed();
    let grid = grid.unwrap_or_else(|| usual_grid(basis.extent()));
    let fewest = [0, 1].map(|i| if closed[i] || topology == Topology::Sphere { 3 } else { 2 });
    if grid[0] < fewest[0] || grid[1] < fewest[1] {
        return refused(format!(
            "grid: expected at least {2},{3}, got {0},{1}",
            grid[0], grid[1], fewest[0], fewest[1]
        ));
    }
    let vertices = grid[0].saturating_mul(grid[1]);
    if vertices > MAX_VERTICES {
        return refused(format!("grid: expected at most {MAX_VERTICES} vertices, got {vertices}"));
    }
    if basis.seam() == Seam::HalfTurn && grid[1] % 2 == 1 {
        return refused(format!("grid: expected an even number along v behind a half turn, got {}", grid[1]));
    }
    let rows = Matrix::from_column_slice(basis.gram().size(), 3, control_points);
    Ok(basis.surface(&rows).tessellate(grid))
}

/// Surfaces with other numbers of control points.
#[derive(Debug)]
pub struct Resized {
    /// Representation of the new surfaces.
    pub representation: Representation,
    /// Control points, and the `L₂` distance to the original surface.
    pub shapes: Vec<(Matrix, f64)>,
    /// Whether all distances are within rounding.
    pub exact: bool,
}

/// Distance relative to the extent below which it counts as rounding.
const ROUNDING: f64 = 1e-12;

/// Interpolates `shapes` at the knots of another grid, keeping their tangents at the poles.
///
/// # Errors
/// Sizes that do not fit, at `pointer`; too many control points.
pub fn resize(
    app: &App,
    posted: &Posted,
    control_points: [usize; 2],
    pointer: &str,
    shapes: &[Matrix],
) -> Result<Resized, ServiceError> {
    let mut representation = posted.space.representation().clone();
    if let Representation::Surface { control_points: counts, .. } = &mut representation {
        *counts = control_points;
    }
    let (space, _) = app.space(&representation, "").map_err(|error| match error {
        ServiceError::Invalid(faults) => {
            ServiceError::Invalid(faults.map(|fault| Fault { pointer: pointer.into(), ..fault }))
        }
        other => other,
    })?;
    let size = representation.size();
    if size.saturating_mul(shapes.len()) > app.limits.samples {
        let detail = format!("expected at most {} control points over all shapes", app.limits.samples);
        return Err(ServiceError::invalid(pointer, detail));
    }
    let (from, to) = (posted.basis(), space.surface().expect("a surface of another size is a surface"));
    let counts = to.extent().grid();
    let resized = |shape: &Matrix| {
        let before = from.surface(shape);
        let [u, v] = [0, 1].map(|i| before.parameters(i, counts[i]));
        let points = before.points(&u, &v);
        let points = Matrix::from_vec(points.len(), 3, columns(&points, |point| *point));
        let rows = to.interpolate(&points, &from.tangents_of(shape));
        let after = to.surface(&rows);
        let change = l2(&before, &after);
        let extent = points.column_iter().map(|column| column.max() - column.min()).fold(0.0, f64::max);
        ((rows, change), change <= ROUNDING * extent)
    };
    let resized = each(&app.pool.context(), shapes, resized)?;
    let (shapes, exact): (Vec<_>, Vec<bool>) = resized.into_iter().unzip();
    Ok(Resized { representation, shapes, exact: exact.into_iter().all(|exact| exact) })
}

/// An idealised surface with its position.
#[derive(Debug, Clone, Copy)]
pub struct PlacedSurface {
    /// The surface.
    pub surface: IdealSurface,
    /// Position of its centre.
    pub centre: [f64; 3],
    /// Angle of a rotation about the z axis, applied before the translation.
    pub angle: f64,
}

impl PlacedSurface {
    fn at(&self, u: f64, v: f64) -> [f64; 3] {
        let ([x, y, z], (sine, cosine)) = (self.surface.at(u, v), self.angle.sin_cos());
        let turned = [cosine * x - sine * y, sine * x + cosine * y, z];
        [0, 1, 2].map(|c| self.centre[c] + turned[c])
    }
}

/// Maximum relative distance at which an idealised surface counts as contained in the space.
const CONTAINED: f64 = 1e-9;

/// Exact control points of an idealised surface.
///
/// # Errors
/// Parameters or a topology that do not fit, or generators that do not reproduce it.
pub fn idealise(posted: &Posted, placed: &PlacedSurface) -> Result<Matrix, String> {
    let surface = &placed.surface;
    if let Some(fault) = surface.fault() {
        return Err(fault.into());
    }
    let ((topology, seam), basis) = (surface.topology(), posted.basis());
    if (topology, seam) != (basis.extent().topology, basis.seam()) {
        let seam = serde_json::to_string(&seam).unwrap_or_default();
        return Err(format!(
            "expected a surface with the topology and seam of the representation, got a {} with the seam {seam}",
            topology.name()
        ));
    }
    let rows = basis.interpolate_function(|u, v| placed.at(u, v));
    let made = basis.surface(&rows);
    let count = basis.extent().intervals.map(|count| 2 * count + 1);
    let [u, v] = count.map(|count| (0..count).map(|i| (i as f64 + 0.5) / count as f64).collect::<Vec<_>>());
    let points = made.points(&u, &v);
    let wanted = u.iter().flat_map(|&u| v.iter().map(move |&v| placed.at(u, v)));
    let worst = points.iter().zip(wanted).map(|(a, b)| norm(minus(*a, b))).fold(0.0, f64::max);
    let extent = points.iter().flatten().fold(0.0_f64, |most, value| most.max(value.abs()));
    if worst <= CONTAINED * extent {
        return Ok(rows);
    }
    let kinds = serde_json::to_string(&surface.generators()).unwrap_or_default();
    let [least_u, least_v] = surface.fewest_intervals();
    Err(format!(
        "the generators do not reproduce this surface (the nearest is {worst:.1e} away): use {kinds} with at \
         least {least_u} × {least_v} control points"
    ))
}
