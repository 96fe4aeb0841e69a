//! What a request will cost, before it starts: seconds on one core, from the counts of the request and constants that were
//! measured.
//!
//! Predictions decide the lane of a request, the turns of its tenant, and whether it is done at all. They are good to a factor
//! of three of the CPU time of the release build on a core of 2023 (`benches/load/costs.py` compares them, request by request);
//! what a search, an iteration or a neighbourhood of curves really takes is known only afterwards, and corrects the account of
//! the tenant. Counts are taken as the request states them, up to the limits: what lies beyond is refused before it costs
//! anything.

use crate::analysis::alignment::Alignment;
use crate::analysis::correspondence::Correspondence;
use crate::analysis::transformation::{ClassName, Transformation};
use crate::domain::cohort::Cohort;
use crate::formats::shape::ShapeInput;
use crate::geometry::representation::Representation;
use crate::geometry::subdivision::refinement::Depth;
use crate::service::app::Limits;
use crate::service::app::work::{NUMBER, REQUEST, Work};
use crate::service::shapes::read::check_representation;
use crate::service::shapes::surface_fitting::MeshInput;
use crate::service::statistics::Settings;

/// The shapes of a request: how many, of how many control points and coordinates each.
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
    /// Of the shapes of a cohort.
    pub fn of_cohort(cohort: &Cohort, limits: &Limits) -> Self {
        Self { shapes: cohort.shapes as f64, ..Self::new(&cohort.representation, 0, limits) }
    }

    /// Of so many shapes of a representation, within the limits: one that is refused for its sizes costs nothing.
    pub fn new(representation: &Representation, shapes: usize, limits: &Limits) -> Self {
        // The control mesh of a subdivision surface is looked at when it is refined, its size alone here.
        let refused =
            representation.subdivision().is_none() && check_representation(representation, limits).is_err();
        let points = if refused { 0 } else { representation.size().min(limits.control_points) };
        Self {
            shapes: shapes.min(limits.shapes) as f64,
            points: points as f64,
            dimension: representation.dimension().clamp(2, 3) as f64,
        }
    }

    /// `N`, as far as it is accepted.
    pub fn points(self) -> usize {
        self.points as usize
    }

    /// The same with another number of shapes.
    pub fn with_shapes(self, shapes: usize) -> Self {
        Self { shapes: shapes as f64, ..self }
    }

    /// `d·N`.
    fn length(self) -> f64 {
        self.points * self.dimension
    }

    /// All coordinates of all shapes.
    fn values(self) -> f64 {
        self.shapes * self.length()
    }
}

/// Points of all shapes as they were posted.
pub fn posted_points(shapes: &[ShapeInput]) -> f64 {
    let count = |shape: &ShapeInput| {
        crate::service::shapes::read::given(&shape.points).map_or(0, |points| points.len())
    };
    shapes.iter().map(count).sum::<usize>() as f64
}

/// Vertices of all meshes as they were posted.
pub fn posted_vertices(meshes: &[MeshInput]) -> f64 {
    let count = |mesh: &MeshInput| {
        crate::service::shapes::read::given(&mesh.vertices).map_or(0, |points| points.len())
    };
    meshes.iter().map(count).sum::<usize>() as f64
}

/// Preparing the space of a representation, where it is not kept.
pub fn space(representation: &Representation, limits: &Limits) -> Work {
    /// A control point: a row of the interpolation and of the Gram operator.
    const ROW: f64 = 5e-7;
    /// A vertex of the level of a subdivision surface: a row of its steps.
    const VERTEX: f64 = 2e-6;
    let one = Counts::new(representation, 1, limits);
    Work(one.points * ROW + vertices(representation, one, limits) * VERTEX)
}

/// Projections of shapes on a reference, one way or the other.
pub fn project(counts: Counts) -> Work {
    /// Reading, whitening, two thin bases and the answer, per coordinate.
    const COORDINATE: f64 = 8e-8;
    Work(REQUEST + counts.values() * COORDINATE)
}

/// Columns that a shape brings to the mean operator, and rows of it: see the table of `analysis::mean`.
fn operator(settings: &Settings, counts: Counts) -> (f64, f64) {
    let d = counts.dimension;
    match &settings.transformation {
        Transformation::Named(ClassName::Affine | ClassName::Linear) => (d, counts.points),
        Transformation::Named(_) if d < 3.0 => (1.0, counts.length()),
        _ => (d, counts.length()),
    }
}

/// Sums of `columns` outer products of `rows` numbers by the smaller of the two routes, and their leading eigenpairs.
fn scatter(columns: f64, rows: f64) -> Work {
    /// Multiply-adds of the leading eigenpairs, over the cube of the smaller side: few of them are asked for.
    const EIGENPAIRS: f64 = 0.5;
    let (less, more) = (columns.min(rows), columns.max(rows));
    Work::of_multiply_adds(0.5 * more * less * less + EIGENPAIRS * less.powi(3))
}

/// The mean of shapes and their alignment to it.
pub fn align(settings: &Settings, counts: Counts) -> Work {
    /// Reading, whitening, the basis of its subspace, its projection and the answer, per coordinate.
    const COORDINATE: f64 = 1e-7;
    /// The rounds of a search for start points, per coordinate and factor of two of `N`: a spectrum a round.
    const SEARCH: f64 = 5e-8;
    /// An iteration of Procrustes fits, per coordinate and dimension.
    const FIT: f64 = 3e-9;
    /// Iterations that most sets of shapes need.
    const ITERATIONS: f64 = 12.0;
    let values = counts.values();
    let each = Work(REQUEST + values * COORDINATE);
    let searching = match settings.correspondence {
        Correspondence::Cyclic => Work(values * SEARCH * counts.points.max(2.0).log2()),
        _ => Work(0.0),
    };
    let mean = match settings.alignment {
        Alignment::Procrustes => Work(ITERATIONS * values * counts.dimension * FIT),
        Alignment::Projection => {
            let (columns, rows) = operator(settings, counts);
            scatter(columns * counts.shapes, rows)
        }
    };
    each + searching + mean
}

/// Components of aligned shapes, and their scores.
pub fn components(counts: Counts, components: usize) -> Work {
    let kept = (components as f64).min(counts.shapes).min(counts.length());
    scatter(counts.shapes, counts.length())
        + Work::of_multiply_adds(2.0 * counts.values() * kept)
        + Work::numbers(kept * (counts.shapes + counts.length()))
}

/// Measures of curves, and their distances to a reference.
pub fn measure_curves(counts: Counts, reference: bool) -> Work {
    /// Quadratures and self-intersections of an interval between knots, per dimension.
    const INTERVAL: f64 = 3e-6;
    /// Nearest points of two intervals, both ways.
    const PAIR: f64 = 3e-6;
    let pairs = if reference { counts.shapes * counts.points * counts.points } else { 0.0 };
    Work(REQUEST + counts.values() * INTERVAL + pairs * PAIR)
}

/// Measures of tensor-product surfaces.
pub fn measure_surfaces(representation: &Representation, counts: Counts) -> Work {
    /// Quadrature over a cell between knots.
    const CELL: f64 = 3.5e-5;
    let cells = match representation.extent() {
        Some(extent) if counts.points > 0.0 => extent.intervals.iter().map(|&count| count as f64).product(),
        _ => counts.points,
    };
    Work(REQUEST + counts.shapes * cells * CELL)
}

/// Vertices of all meshes of the level of subdivision surfaces.
fn vertices(representation: &Representation, counts: Counts, limits: &Limits) -> f64 {
    let each = representation.subdivision().map_or(0, |subdivision| subdivision.size().vertices);
    counts.shapes * each.min(limits.vertices) as f64
}

/// Measures of subdivision surfaces.
pub fn measure_subdivision(representation: &Representation, counts: Counts, limits: &Limits) -> Work {
    /// Refining and measuring, per vertex of the level.
    const VERTEX: f64 = 2e-7;
    Work(REQUEST + vertices(representation, counts, limits) * VERTEX)
}

/// Values of curves or surfaces at so many places of each, with their derivatives and frames: `numbers` an answered place.
pub fn evaluate(counts: Counts, places: usize, numbers: usize, limits: &Limits) -> Work {
    let places = places.saturating_mul(numbers).min(limits.samples) as f64;
    // Preparing a curve: its coefficients once more.
    Work::numbers(counts.shapes * places * counts.dimension) + Work(counts.values() * NUMBER)
}

/// Meshes of the level of subdivision surfaces, with frames.
pub fn evaluate_meshes(representation: &Representation, counts: Counts, limits: &Limits) -> Work {
    /// Refining and writing, per vertex of the level.
    const VERTEX: f64 = 4e-7;
    Work(REQUEST + vertices(representation, counts, limits) * VERTEX)
}

/// A picture of so many shapes.
pub fn draw(counts: Counts, shapes: usize) -> Work {
    /// Samples of a drawn curve, or lines of a surface.
    const SAMPLES: f64 = 800.0;
    /// Evaluating and writing one.
    const SAMPLE: f64 = 2.2e-7;
    Work(REQUEST + shapes as f64 * SAMPLES.max(4.0 * counts.points) * SAMPLE)
}

/// A mesh of a surface at `grid`.
pub fn mesh(grid: [usize; 2]) -> Work {
    /// A vertex with its normal, and its faces.
    const VERTEX: f64 = 5e-7;
    /// Vertices at the most.
    const MOST: f64 = 250_000.0;
    Work(REQUEST + (grid[0] as f64 * grid[1] as f64).min(MOST) * VERTEX)
}

/// Contours resampled to `count` points each.
pub fn resample(shapes: &[ShapeInput], count: usize, limits: &Limits) -> Work {
    let answered = shapes.len().saturating_mul(count).min(limits.samples) as f64;
    Work::numbers(2.0 * answered + posted_points(shapes))
}

/// Curves fitted to contours of so many points in all; for a `tolerance` at many sizes.
pub fn fit_curves(counts: Counts, points: f64, tolerance: bool) -> Work {
    /// A point in the normal equations of one size.
    const POINT: f64 = 1e-7;
    /// Sizes that are tried for a tolerance.
    const SIZES: f64 = 15.0;
    let sizes = if tolerance { SIZES } else { 1.0 };
    Work::numbers(counts.values()) + Work(sizes * points * POINT)
}

/// Tensor-product surfaces fitted to so many points, or meshes of so many vertices, in all.
pub fn fit_surfaces(counts: Counts, points: f64, meshes: bool) -> Work {
    /// A point, or a vertex: parameters of a mesh are harmonic functions on it, and its faces are samples.
    const POINT: f64 = 1e-6;
    const VERTEX: f64 = 4.5e-5;
    let each = if meshes { VERTEX } else { POINT };
    let solving = Work::of_multiply_adds(counts.shapes * counts.points.powi(3) / 3.0);
    Work::numbers(counts.values()) + Work(points * each) + solving
}

/// Subdivision surfaces fitted to so many points in all, in turns.
pub fn fit_subdivision(
    representation: &Representation,
    counts: Counts,
    (points, meshes): (f64, bool),
    turns: usize,
    limits: &Limits,
) -> Work {
    /// The nearest place of a point, and its rows in the normal equations.
    const POINT: f64 = 8e-7;
    /// A vertex of the level and its box.
    const VERTEX: f64 = 1e-6;
    let solving = Work::of_multiply_adds(counts.shapes * counts.points.powi(3) / 3.0);
    // Faces of a mesh, two for every vertex, are what its surface is fitted to, and it begins as one of splines does.
    let (targets, start) =
        if meshes { (2.0 * points, fit_surfaces(counts, points, true)) } else { (points, Work(0.0)) };
    let turn = Work(targets * POINT + vertices(representation, counts, limits) * VERTEX) + solving;
    start + Work(REQUEST) + (turns as f64 + 1.0) * turn
}

/// Shapes on a grid with so many control points.
pub fn refine(counts: Counts, size: usize, limits: &Limits) -> Work {
    let finer = size.min(limits.control_points) as f64;
    Work::numbers(counts.shapes * counts.dimension * (finer + counts.points))
}

/// Shapes at so many positions of a path, as numbers or as a picture.
pub fn morph(counts: Counts, positions: usize, drawn: bool, limits: &Limits) -> Work {
    let positions = positions.min(limits.samples);
    if drawn { draw(counts, positions) } else { Work::numbers(positions as f64 * counts.length()) }
}

/// A shape pulled at so many handles.
pub fn deform(counts: Counts, handles: usize) -> Work {
    /// The Gram operator of the shape applied to the row of a handle, per control point.
    const ROW: f64 = 2e-8;
    let handles = (handles as f64).min(500.0);
    Work::numbers(counts.length())
        + Work(handles * counts.points * ROW)
        + Work::of_multiply_adds(handles.powi(3))
}

/// A mesh or polyline with so many vertices, of which every level has `factor` times as many.
pub fn subdivide(vertices: usize, factor: f64, depth: &Depth, limit: bool, limits: &Limits) -> Work {
    /// A vertex of the finest level, of all levels before it, and in the answer.
    const VERTEX: f64 = 6e-7;
    let found = match depth {
        Depth::Level(level) => vertices as f64 * factor.powi((*level).min(30) as i32),
        Depth::Tolerance(_) => f64::MAX,
    };
    let parts = if limit { 2.0 } else { 1.0 };
    Work(REQUEST + parts * found.min(limits.vertices as f64) * VERTEX)
}

/// Two bodies on a grid with so many cells.
pub fn overlap(cells: usize) -> Work {
    /// A cell of two bodies: inside or not, and its distances to the surfaces.
    const CELL: f64 = 5e-8;
    Work(REQUEST + cells as f64 * CELL)
}

/// Posted shapes of a cohort, which have been read, as they are stored.
pub fn store(counts: Counts, correspondence: Correspondence) -> Work {
    /// Control points by the arc length of a contour, per coordinate.
    const COORDINATE: f64 = 1e-7;
    /// Of its canonical start.
    const START: f64 = 3e-7;
    let start = if correspondence == Correspondence::Cyclic { START } else { 0.0 };
    Work(REQUEST + counts.values() * (COORDINATE + start))
}

/// A matrix of `shapes²` distances whose pairs take so many multiply-adds together.
pub fn distances(counts: Counts, multiply_adds: f64) -> Work {
    /// Preparing a shape to be compared, per coordinate.
    const COORDINATE: f64 = 8e-8;
    /// Writing a distance.
    const DISTANCE: f64 = 2e-8;
    Work(REQUEST + counts.values() * COORDINATE + counts.shapes * counts.shapes * DISTANCE)
        + Work::of_multiply_adds(multiply_adds)
}

/// Shapes compared with those of a cohort, which are `counts` when they have to be read.
pub fn search(counts: Option<Counts>, multiply_adds: f64) -> Work {
    let reading = counts.map_or(Work(0.0), |counts| 2.0 * project(counts));
    Work(REQUEST) + reading + Work::of_multiply_adds(multiply_adds)
}

/// Codes of shapes in a dictionary of `atoms` atoms whose codes cost `multiply_adds` each, and answers of `numbers` numbers each.
pub fn encode(counts: Counts, multiply_adds: f64, numbers: f64, searches: bool) -> Work {
    /// Aligning a shape to the mean, per coordinate.
    const COORDINATE: f64 = 2e-7;
    /// Of a start point that is searched for: a spectrum, per coordinate and factor of two of `N`.
    const SEARCH: f64 = 2e-8;
    let spectrum = if searches { SEARCH * counts.points.max(2.0).log2() } else { 0.0 };
    Work(counts.values() * (COORDINATE + spectrum))
        + Work::of_multiply_adds(counts.shapes * multiply_adds)
        + Work::numbers(counts.shapes * numbers)
}
