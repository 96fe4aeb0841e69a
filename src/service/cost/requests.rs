//! Predicted cost of requests in seconds on one core, computed before they start from the counts of the request and
//! measured constants.
//!
//! Predictions decide the lane of a request, the turns of its tenant, and whether it is executed at all. They are
//! accurate to a factor of three of the CPU time of the release build on a core of 2023 (`benches/load/costs.py`
//! compares them, request by request). The actual time of a search, an iteration or a neighbourhood of curves is known
//! only afterwards; it then corrects the account of the tenant. Counts are used as stated in the request, up to the
//! limits: anything larger is refused before it costs anything.

use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::Correspondence;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::domain::cohort::Cohort;
use crate::geometry::capability::domain::{Admitted, Domain};
use crate::geometry::capability::sample::Parameters;
use crate::geometry::quality::MAX_FACES;
use crate::geometry::representation::{Representation, ShapeSpace};
use crate::geometry::subdivision::refinement::Depth;
use crate::geometry::surface::basis::Extent;
use crate::geometry::surface::field::VectorField;
use crate::geometry::surface::measures::flux_nodes;
use crate::service::app::Limits;
use crate::service::app::work::{NUMBER, REQUEST, Work};
use crate::service::shapes::fit::{SIZES_TRIED, most_within_tolerance};
use crate::service::shapes::read_mesh::MeshInput;
use crate::service::shapes::read_points::given;
use crate::service::statistics::CheckedSettings;
use crate::wire::picture::{MAX_PIXELS, PictureFile, PictureFormat};
use crate::wire::shape::ShapeInput;

/// Sizes of the shapes of a request: their number, control points and dimension.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Counts {
    /// `K`.
    shapes: f64,
    /// `N`.
    points: f64,
    /// `d`.
    dimension: f64,
}

impl Counts {
    /// Counts of the shapes of a cohort.
    pub fn for_cohort(cohort: &Cohort, limits: &Limits) -> Self {
        Self { shapes: cohort.shapes as f64, ..Self::for_stored(&cohort.spec.representation, 0, limits) }
    }

    /// Counts of `shapes` shapes of the representation of a request, within the limits.
    pub fn new(representation: &Admitted, shapes: usize, limits: &Limits) -> Self {
        Self::for_stored(representation, shapes, limits)
    }

    /// Counts of `shapes` shapes of a prepared space, within the limits.
    pub fn for_space(space: &ShapeSpace, shapes: usize, limits: &Limits) -> Self {
        Self::for_stored(space.representation(), shapes, limits)
    }

    /// Counts of `shapes` shapes of a stored representation. It was within the limits when it was stored; they may have been
    /// lowered since, and bound the counts.
    pub fn for_stored(representation: &Representation, shapes: usize, limits: &Limits) -> Self {
        Self {
            shapes: shapes.min(limits.shapes) as f64,
            points: representation.size().min(limits.control_points) as f64,
            dimension: representation.dimension().clamp(2, 3) as f64,
        }
    }

    /// `N`, within the limits.
    pub fn points(self) -> usize {
        self.points as usize
    }

    /// The same counts with a different number of shapes.
    pub fn with_shapes(self, shapes: usize) -> Self {
        Self { shapes: shapes as f64, ..self }
    }

    /// The same counts with a different number of control points.
    pub fn with_points(self, points: usize) -> Self {
        Self { points: points as f64, ..self }
    }

    /// `d·N`.
    fn length(self) -> f64 {
        self.points * self.dimension
    }

    /// Number of coordinates of all shapes.
    fn values(self) -> f64 {
        self.shapes * self.length()
    }
}

/// Number of points of all posted shapes.
pub fn posted_points(shapes: &[ShapeInput]) -> f64 {
    let count = |shape: &ShapeInput| given(&shape.points).map_or(0, |points| points.len());
    shapes.iter().map(count).sum::<usize>() as f64
}

/// Number of vertices of all posted meshes.
pub fn posted_vertices(meshes: &[MeshInput]) -> f64 {
    let count = |mesh: &MeshInput| given(&mesh.vertices).map_or(0, |points| points.len());
    meshes.iter().map(count).sum::<usize>() as f64
}

/// Preparing the space of a representation that is not cached.
pub fn space(representation: &Representation, limits: &Limits) -> Work {
    /// Per control point: a row of the interpolation and of the Gram operator.
    const ROW: f64 = 5e-7;
    /// Per vertex of the level of a subdivision surface: a row of its refinement steps.
    const VERTEX: f64 = 2e-6;
    let one = Counts::for_stored(representation, 1, limits);
    Work(one.points * ROW + vertices(representation, one, limits) * VERTEX)
}

/// Projections of shapes on a reference, in either direction.
pub fn project(counts: Counts) -> Work {
    /// Per coordinate: reading, whitening, two thin bases and the response.
    const COORDINATE: f64 = 8e-8;
    Work(REQUEST + counts.values() * COORDINATE)
}

/// Number of columns that a shape contributes to the mean operator, and number of its rows: see the table of
/// `analysis::mean`.
fn operator(settings: &CheckedSettings, counts: Counts) -> (f64, f64) {
    let d = counts.dimension;
    match &settings.transformation {
        Transformation::Named(ClassName::Affine | ClassName::Linear) => (d, counts.points),
        Transformation::Named(_) if d < 3.0 => (1.0, counts.length()),
        _ => (d, counts.length()),
    }
}

/// Sum of `columns` outer products of `rows` numbers by the cheaper of the two methods, with its leading eigenpairs.
fn scatter(columns: f64, rows: f64) -> Work {
    /// Multiply-adds of the leading eigenpairs, divided by the cube of the smaller side: only a few are needed.
    const EIGENPAIRS: f64 = 0.5;
    let (less, more) = (columns.min(rows), columns.max(rows));
    Work::from_multiply_adds(0.5 * more * less * less + EIGENPAIRS * less.powi(3))
}

/// Aligning shapes as wholes or on a region, which has up to four places for each control point.
pub fn align_on(settings: &CheckedSettings, counts: Counts, on_region: bool) -> Work {
    if on_region { 5.0 * align(settings, counts) } else { align(settings, counts) }
}

/// Mean of shapes and their alignment to it.
pub fn align(settings: &CheckedSettings, counts: Counts) -> Work {
    /// Per coordinate: reading, whitening, the basis of the subspace, its projection and the response.
    const COORDINATE: f64 = 1e-7;
    /// Per coordinate and factor of two of `N`: the rounds of a search for start points, with one spectrum each.
    const SEARCH: f64 = 5e-8;
    /// Per coordinate and dimension: one iteration of Procrustes fits.
    const FIT: f64 = 3e-9;
    /// Iterations sufficient for most sets of shapes.
    const ITERATIONS: f64 = 12.0;
    let values = counts.values();
    let each = Work(REQUEST + values * COORDINATE);
    /// Per coordinate: the rounds of a search for motions of the parameters of a surface, each with some hundred moved surfaces. A round
    /// takes 3e-5 s (hippocampi of 8 × 6 and 16 × 9); 55 to 89 rounds are usual for similarities, and they end at 100.
    const MOTIONS: f64 = 2.4e-3;
    let searching = match settings.correspondence {
        Correspondence::Cyclic if settings.representation.domain().is_sheet() => Work(values * MOTIONS),
        Correspondence::Cyclic => Work(values * SEARCH * counts.points.max(2.0).log2()),
        _ => Work(0.0),
    };
    let mean = match settings.alignment {
        Alignment::Procrustes | Alignment::PartialProcrustes => {
            Work(ITERATIONS * values * counts.dimension * FIT)
        }
        Alignment::Projection => {
            let (columns, rows) = operator(settings, counts);
            scatter(columns * counts.shapes, rows)
        }
    };
    let robust = if settings.estimator.is_robust() { robust_mean(settings, counts) } else { Work(0.0) };
    each + searching + mean + robust
}

/// Work of a robust mean beyond a plain one, with the weights of control points.
fn robust_mean(settings: &CheckedSettings, counts: Counts) -> Work {
    /// Per coordinate: bases and alignments of six passes, and four fits of a model.
    const COORDINATE: f64 = 8e-7;
    /// Multiply-adds for two shapes, of which the nearest ones are searched, and maximum number of those.
    const PAIR: f64 = 12.0;
    const CANDIDATES: f64 = 2048.0;
    /// Rounds in which placements and weights alternate, if there are placements.
    const ROUNDS: f64 = 3.0;
    let rounds = if settings.correspondence == Correspondence::Cyclic { ROUNDS } else { 1.0 };
    let (columns, rows) = operator(settings, counts);
    let sums = 2.0 * scatter(columns * counts.shapes, rows) + scatter(counts.shapes, counts.length());
    let near = Work::from_multiply_adds(PAIR * counts.shapes * counts.shapes.min(CANDIDATES));
    rounds * (Work(counts.values() * COORDINATE) + sums) + near
}

/// Principal components of aligned shapes, and their scores.
pub fn components(counts: Counts, components: usize) -> Work {
    let kept = (components as f64).min(counts.shapes).min(counts.length());
    scatter(counts.shapes, counts.length())
        + Work::from_multiply_adds(2.0 * counts.values() * kept)
        + Work::numbers(kept * (counts.shapes + counts.length()))
}

/// Number of vertices of all refined meshes.
fn vertices(representation: &Representation, counts: Counts, limits: &Limits) -> f64 {
    counts.shapes * representation.refined_vertices().min(limits.vertices) as f64
}

/// Measures of shapes, and their distances to a reference.
pub fn measure(representation: &Representation, counts: Counts, reference: bool, limits: &Limits) -> Work {
    match representation.domain() {
        Domain::Vertices => measure_meshes(representation, counts, limits),
        Domain::Sheet { extent, .. } => measure_sheets(extent, counts),
        Domain::Line { .. } | Domain::Points => measure_lines(counts, reference),
    }
}

/// Measures of curves, and their distances to a reference.
fn measure_lines(counts: Counts, reference: bool) -> Work {
    /// Per dimension: quadratures and self-intersections of an interval between knots.
    const INTERVAL: f64 = 3e-6;
    /// Nearest points of an interval, in both directions, and intervals of the other curve that cost as much again; most of it is
    /// out of question. Curves for which it is not, such as a circle and its centre, are charged for their measured time.
    const NEAREST: f64 = 1.2e-4;
    const OTHERS: f64 = 1000.0;
    let searched = if reference { counts.values() * (1.0 + counts.points / OTHERS) } else { 0.0 };
    Work(REQUEST + counts.values() * INTERVAL + searched * NEAREST)
}

/// Measures of surfaces with parameters.
fn measure_sheets(extent: Extent, counts: Counts) -> Work {
    /// Quadrature over a cell between knots.
    const CELL: f64 = 3.5e-5;
    Work(REQUEST + counts.shapes * cells(extent, counts) * CELL)
}

/// Cells of a surface between knots.
fn cells(extent: Extent, counts: Counts) -> f64 {
    match extent.intervals.map(|count| count as f64) {
        [u, v] if counts.points > 0.0 => u * v,
        _ => counts.points,
    }
}

/// Flux of a field through surfaces.
pub fn flux(
    representation: &Representation,
    counts: Counts,
    field: Option<&VectorField>,
    limits: &Limits,
) -> Work {
    /// A place of the quadrature, and a term of the field there.
    const PLACE: f64 = 6e-8;
    const TERM: f64 = 4e-9;
    let Some(field) = field else { return Work(0.0) };
    let place = PLACE + field.terms() as f64 * TERM;
    let square = |nodes: usize| (nodes * nodes) as f64;
    match representation.domain() {
        Domain::Vertices => {
            let faces = 2.0 * vertices(representation, counts, limits);
            Work(faces * square(field.degree().div_ceil(2) + 1) * place)
        }
        Domain::Sheet { extent, .. } => {
            let cells: f64 = extent.intervals.iter().map(|count| 2.0 * *count as f64).product();
            Work(counts.shapes * cells * square(flux_nodes(field.degree())) * place)
        }
        Domain::Line { .. } | Domain::Points => Work(0.0),
    }
}

/// Measures of refined meshes.
fn measure_meshes(representation: &Representation, counts: Counts, limits: &Limits) -> Work {
    /// Per vertex of the level: refining and measuring.
    const VERTEX: f64 = 2e-7;
    let one = vertices(representation, counts.with_shapes(1), limits);
    Work(REQUEST) + counts.shapes * (Work(one * VERTEX) + checks(one))
}

/// Test of a mesh of `vertices` vertices for self-intersections. Meshes with more faces than [`MAX_FACES`] are not tested.
fn checks(vertices: f64) -> Work {
    /// Per vertex: the pairs of its two faces.
    const VERTEX: f64 = 1.5e-6;
    Work(if 2.0 * vertices <= MAX_FACES as f64 { vertices * VERTEX } else { 0.0 })
}

/// Values at `parameters`, or at the vertices of refined meshes, with derivatives up to `order` and frames.
pub fn values(
    representation: &Representation,
    counts: Counts,
    parameters: Option<&Parameters>,
    (order, frames): (usize, bool),
    limits: &Limits,
) -> Work {
    /// Cost of a frame, as a multiple of the coordinates of a point.
    const FRAME: usize = 5;
    let Some(parameters) = parameters else { return evaluate_meshes(representation, counts, limits) };
    let numbers = parameters.derivatives(order).len() + if frames { FRAME } else { 0 };
    evaluate(counts, parameters.count(), numbers, limits)
}

/// Values of curves or surfaces at `places` places of each, with derivatives and frames: `numbers` per place.
fn evaluate(counts: Counts, places: usize, numbers: usize, limits: &Limits) -> Work {
    let places = places.saturating_mul(numbers).min(limits.samples) as f64;
    // Preparing a curve processes its coefficients once more.
    Work::numbers(counts.shapes * places * counts.dimension) + Work(counts.values() * NUMBER)
}

/// Refined meshes of subdivision surfaces, with frames.
fn evaluate_meshes(representation: &Representation, counts: Counts, limits: &Limits) -> Work {
    /// Per vertex of the level: refining and writing.
    const VERTEX: f64 = 4e-7;
    Work(REQUEST + vertices(representation, counts, limits) * VERTEX)
}

/// A drawing of `shapes` shapes.
pub fn draw(counts: Counts, shapes: usize) -> Work {
    /// Samples of a drawn curve, or of the lines of a surface.
    const SAMPLES: f64 = 800.0;
    /// Evaluating and writing one sample.
    const SAMPLE: f64 = 2.2e-7;
    Work(REQUEST + shapes as f64 * SAMPLES.max(4.0 * counts.points) * SAMPLE)
}

/// Writing a drawing as a picture file, about as high as wide.
pub fn picture(file: &PictureFile) -> Work {
    painting(file.format, f64::from(file.style.width).powi(2))
}

/// Writing a drawing as a picture file of so many pixels: an SVG is written as the drawing is made, a PNG is painted and
/// compressed.
pub fn painting(format: PictureFormat, pixels: f64) -> Work {
    /// Per pixel: painting a few lines over it, and compressing it.
    const PIXEL: f64 = 1.5e-7;
    match format {
        PictureFormat::Svg => Work(0.0),
        PictureFormat::Png => Work(REQUEST + pixels.min(MAX_PIXELS as f64) * PIXEL),
    }
}

/// A mesh of a surface at `grid`.
pub fn mesh(grid: [usize; 2]) -> Work {
    /// Per vertex: its normal and its faces.
    const VERTEX: f64 = 5e-7;
    /// Maximum number of vertices.
    const MOST: f64 = 250_000.0;
    Work(REQUEST + (grid[0] as f64 * grid[1] as f64).min(MOST) * VERTEX)
}

/// Contours resampled to `count` points each.
pub fn resample(shapes: &[ShapeInput], count: usize, limits: &Limits) -> Work {
    let answered = shapes.len().saturating_mul(count).min(limits.samples) as f64;
    Work::numbers(2.0 * answered + posted_points(shapes))
}

/// Sizes of the targets of fits.
#[derive(Debug, Clone, Copy)]
pub struct FitCounts {
    /// Number of points, or of vertices of meshes, in total.
    pub points: f64,
    /// Whether they are the vertices of meshes.
    pub meshes: bool,
    /// Whether sizes are chosen for a tolerance.
    pub tolerance: bool,
    /// Number of rounds for refined meshes.
    pub turns: usize,
}

/// Shapes fitted to points or meshes.
pub fn fit(representation: &Representation, counts: Counts, fit: FitCounts, limits: &Limits) -> Work {
    match representation.domain() {
        Domain::Vertices => fit_meshes(representation, counts, fit, limits),
        Domain::Sheet { .. } if fit.tolerance => {
            // The size is not known: at most one control point for each point.
            let each = (fit.points / counts.shapes.max(1.0)).max(counts.points);
            let most = each.min(most_within_tolerance(counts.shapes as usize) as f64);
            let sizes = Counts { points: most, ..counts };
            SIZES_TRIED * fit_sheets(sizes, fit.points, fit.meshes)
        }
        Domain::Sheet { .. } => fit_sheets(counts, fit.points, fit.meshes),
        Domain::Line { .. } | Domain::Points => fit_lines(counts, fit.points, fit.tolerance),
    }
}

/// Curves fitted to contours of `points` points in total; a `tolerance` requires several sizes.
pub fn fit_lines(counts: Counts, points: f64, tolerance: bool) -> Work {
    /// Per point: its part of the normal equations of one size.
    const POINT: f64 = 1e-7;
    /// Number of sizes tried for a tolerance.
    const SIZES: f64 = 15.0;
    let sizes = if tolerance { SIZES } else { 1.0 };
    Work::numbers(counts.values()) + Work(sizes * points * POINT)
}

/// Surfaces with parameters fitted to `points` points, or to meshes with as many vertices, in total.
fn fit_sheets(counts: Counts, points: f64, meshes: bool) -> Work {
    /// Per point, or per vertex: the parameters of a mesh are harmonic functions on it, and its faces are samples.
    const POINT: f64 = 1e-6;
    const VERTEX: f64 = 4.5e-5;
    let each = if meshes { VERTEX } else { POINT };
    let solving = Work::from_multiply_adds(counts.shapes * counts.points.powi(3) / 3.0);
    Work::numbers(counts.values()) + Work(points * each) + solving
}

/// Refined meshes fitted to points or meshes, in alternating rounds.
fn fit_meshes(
    representation: &Representation,
    counts: Counts,
    FitCounts { points, meshes, turns, .. }: FitCounts,
    limits: &Limits,
) -> Work {
    /// Per point: its nearest place, and its rows in the normal equations.
    const POINT: f64 = 8e-7;
    /// Per vertex of the level, with its bounding box.
    const VERTEX: f64 = 1e-6;
    let solving = Work::from_multiply_adds(counts.shapes * counts.points.powi(3) / 3.0);
    // A surface is fitted to the faces of a mesh, two per vertex, and starts from a fitted spline surface.
    let (targets, start) =
        if meshes { (2.0 * points, fit_sheets(counts, points, true)) } else { (points, Work(0.0)) };
    let turn = Work(targets * POINT + vertices(representation, counts, limits) * VERTEX) + solving;
    start + Work(REQUEST) + (turns as f64 + 1.0) * turn
}

/// Shapes on a finer grid with `size` control points.
pub fn refine(counts: Counts, size: usize, limits: &Limits) -> Work {
    let finer = size.min(limits.control_points) as f64;
    Work::numbers(counts.shapes * counts.dimension * (finer + counts.points))
}

/// Spaces of `grids` grids of blocks, and shapes brought to the finest of them, whose counts are `finest`; nothing for none.
pub fn grids(finest: Counts, grids: usize) -> Work {
    /// Per control point: the operators of a space, most of it the factors of a surface with poles.
    const PREPARED: f64 = 2e-6;
    /// Per coordinate of a shape and grid: the taps of the filters.
    const FILTERED: f64 = 1e-7;
    let grids = grids as f64;
    Work(grids * (finest.points * PREPARED + finest.values() * FILTERED))
}

/// The control points of a region of a finer grid, whose counts are `finest`: their weights at every half-interval.
pub fn region(finest: Counts) -> Work {
    /// Per control point: the weights at four places.
    const WEIGHTS: f64 = 4e-6;
    Work(finest.points * WEIGHTS)
}

/// Surfaces of `from` intervals on a grid of `to`, and the distances to the originals.
pub fn resize(counts: Counts, from: [usize; 2], to: [usize; 2], limits: &Limits) -> Work {
    /// Per node of the quadrature: a point of either surface.
    const NODE: f64 = 1.6e-8;
    /// Nodes of a piece along a direction.
    const NODES: f64 = 10.0;
    let nodes = |direction: usize| {
        let (less, more) = (from[direction], to[direction]);
        let breaks = if less > 0 && more % less == 0 { more } else { less + more };
        2.0 * breaks as f64 * NODES
    };
    let size = to[0].saturating_mul(to[1]);
    // Refused for its size.
    if size > limits.control_points {
        return Work(REQUEST);
    }
    refine(counts, size, limits) + Work(counts.shapes * nodes(0) * nodes(1) * NODE)
}

/// Shapes at `positions` positions of a path, as numbers or as a drawing.
pub fn morph(counts: Counts, positions: usize, drawn: bool, limits: &Limits) -> Work {
    let positions = positions.min(limits.samples);
    if drawn { draw(counts, positions) } else { Work::numbers(positions as f64 * counts.length()) }
}

/// A shape deformed by `handles` handles.
pub fn deform(counts: Counts, handles: usize) -> Work {
    /// Per control point: the Gram operator of the shape applied to the row of a handle.
    const ROW: f64 = 2e-8;
    let handles = (handles as f64).min(500.0);
    Work::numbers(counts.length())
        + Work(handles * counts.points * ROW)
        + Work::from_multiply_adds(handles.powi(3))
}

/// Moved points and normals of a shape of `representation`, refined before and after.
pub fn deform_oriented(representation: &Representation, limits: &Limits) -> Work {
    let depth = Depth::Level(representation.splits());
    let once = || subdivide(representation.size(), 4.0, &depth, false, limits);
    once() + once()
}

/// A mesh or polyline whose number of vertices grows by `factor` with every level.
pub fn subdivide(vertices: usize, factor: f64, depth: &Depth, limit: bool, limits: &Limits) -> Work {
    /// Per vertex of the finest level, including all previous levels and the response.
    const VERTEX: f64 = 6e-7;
    let found = match depth {
        Depth::Level(level) => vertices as f64 * factor.powi((*level).min(30) as i32),
        Depth::Tolerance(_) => f64::MAX,
    };
    let parts = if limit { 2.0 } else { 1.0 };
    Work(REQUEST + parts * found.min(limits.vertices as f64) * VERTEX) + checks(found)
}

/// Overlap of two bodies on a grid of `cells` cells.
pub fn overlap(cells: usize) -> Work {
    /// Per cell of two bodies: the inside test and its distances to the surfaces.
    const CELL: f64 = 5e-8;
    Work(REQUEST + cells as f64 * CELL)
}

/// A thin-plate spline of `landmarks` landmarks at `places` places, some of them projected onto a mesh.
pub fn warp(landmarks: usize, places: usize, projected: usize, partial_warps: bool) -> Work {
    /// Per landmark and place: a logarithm or a root, and its products.
    const KERNEL: f64 = 2e-8;
    /// Per point: the nearest triangle of a mesh.
    const FOOT: f64 = 1e-5;
    let p = landmarks as f64;
    let eigen = if partial_warps { 12.0 } else { 0.0 };
    Work::numbers((landmarks + places) as f64)
        + Work(p * (p + places as f64) * KERNEL + projected as f64 * FOOT)
        + Work::from_multiply_adds((2.0 + eigen) * p.powi(3))
}

/// Sliding of `count` shapes of `size` points in so many directions, by bending energy or by distances.
pub fn slide([count, size, directions]: [usize; 3], bends: bool) -> Work {
    /// Per number and round: superimposition.
    const PLACED: f64 = 5e-8;
    let [count, size, directions] = [count, size, directions].map(|x| x as f64);
    // With acceleration, 7 to 32 rounds by bending energy and 20 to 57 by distances were measured.
    let rounds = if bends { 30.0 } else { 60.0 };
    let shape = if bends {
        directions.powi(3) / 3.0 + directions * directions + 3.0 * size * size
    } else {
        directions
    };
    let common = if bends { 4.0 * size.powi(3) } else { 0.0 };
    Work::numbers(6.0 * count * size)
        + Work(rounds * count * size * 3.0 * PLACED)
        + Work::from_multiply_adds(rounds * (count * shape + common))
}

/// Storing posted shapes of a cohort that have been parsed.
pub fn store(counts: Counts, correspondence: Correspondence) -> Work {
    /// Per coordinate: control points by the arc length of a contour.
    const COORDINATE: f64 = 1e-7;
    /// Per coordinate: its canonical start.
    const START: f64 = 3e-7;
    let start = if correspondence == Correspondence::Cyclic { START } else { 0.0 };
    Work(REQUEST + counts.values() * (COORDINATE + start))
}

/// Measuring shapes of a cohort when they arrive.
pub fn measure_stored(representation: &Representation, counts: Counts, limits: &Limits) -> Work {
    /// Per coordinate of a curve: length, area, self-intersection and centroid size.
    const COORDINATE: f64 = 2e-7;
    /// Per cell of a surface between knots: area and volume; rough surfaces take up to ten times as much.
    const CELL: f64 = 2e-6;
    match representation.domain() {
        Domain::Line { .. } | Domain::Points => Work(counts.values() * COORDINATE),
        Domain::Sheet { extent, .. } => Work(counts.shapes * cells(extent, counts) * CELL),
        Domain::Vertices => measure(representation, counts, false, limits),
    }
}

/// A matrix of `shapes²` distances whose pairs take `multiply_adds` in total.
pub fn distances(counts: Counts, multiply_adds: f64) -> Work {
    /// Per coordinate: preparing a shape for comparison.
    const COORDINATE: f64 = 6e-8;
    /// Writing a distance.
    const DISTANCE: f64 = 2e-8;
    Work(REQUEST + counts.values() * COORDINATE + counts.shapes * counts.shapes * DISTANCE)
        + Work::from_multiply_adds(multiply_adds)
}

/// Preparing curves for elastic distances, divided into `points` segments each.
pub fn elastic_curves(curves: usize, points: usize) -> Work {
    /// Per segment: the parameter at a fraction of the length, at two resolutions.
    const SEGMENT: f64 = 1.5e-6;
    Work(curves as f64 * points as f64 * SEGMENT)
}

/// Comparing shapes with those of a cohort; `counts` is given if the cohort must be read.
pub fn search(counts: Option<Counts>, multiply_adds: f64) -> Work {
    let reading = counts.map_or(Work(0.0), |counts| 2.0 * project(counts));
    Work(REQUEST) + reading + Work::from_multiply_adds(multiply_adds)
}

/// Codes of shapes in a dictionary, at `multiply_adds` per code, and responses of `numbers` numbers each.
pub fn encode(counts: Counts, multiply_adds: f64, numbers: f64, searches: bool) -> Work {
    /// Per coordinate: aligning a shape to the mean.
    const COORDINATE: f64 = 2e-7;
    /// Per coordinate and factor of two of `N`: the spectrum of a search for the start point.
    const SEARCH: f64 = 2e-8;
    let spectrum = if searches { SEARCH * counts.points.max(2.0).log2() } else { 0.0 };
    Work(counts.values() * (COORDINATE + spectrum))
        + Work::from_multiply_adds(counts.shapes * multiply_adds)
        + Work::numbers(counts.shapes * numbers)
}
