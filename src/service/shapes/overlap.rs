//! Overlap of two bodies: Jaccard and Dice coefficients of their interior cells, and distances of their surfaces.
//!
//! Contours, closed meshes and masks are compared on one common grid. The functions are synchronous and run on the
//! pool.

use super::read_mesh::face_pointer;
use super::read_points::take_points;
use crate::formats::checked::{Checked, LARGE, document, take_given};
use crate::formats::fault::Fault;
use crate::formats::shape::{MAX_COORDINATE, PointList};
use crate::geometry::capability::measure::mesh_warnings;
use crate::geometry::intersection::polygon_self_intersects;
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::raster::{self, Grid, Mask, Overlap, bounds};
use crate::numeric::bounded::Stop;
use crate::service::app::progress::JobContext;
use crate::service::app::{App, Limits, ServiceError};

document! {
    /// A body, given by exactly one of `contour`, `vertices` with `faces`, and `mask`.
    pub struct BodyInput {
        /// Points of a closed contour in the plane.
        #[schema(value_type = Option<Vec<[f64; 2]>>)]
        contour: PointList;
        /// Vertices of a closed triangle mesh.
        #[schema(value_type = Option<Vec<[f64; 3]>>)]
        vertices: PointList;
        /// Triangles of the mesh, as indices of their vertices.
        #[schema(value_type = Option<Vec<[u32; 3]>>)]
        faces: Checked<Vec<[u32; 3]>, LARGE>;
        /// Mask on a regular grid.
        #[schema(value_type = Option<MaskInput>)]
        mask: Checked<MaskInput, LARGE>;
    }
}

/// Mask on a regular grid whose cells lie inside or outside of the body.
#[derive(Debug, Clone, serde::Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MaskInput {
    /// Number of cells along the 2 or 3 axes.
    pub size: Vec<usize>,
    /// Distance between cell centres along each axis, in the unit of the coordinates.
    pub spacing: Vec<f64>,
    /// Position of the centre of the first cell.
    pub first: Vec<f64>,
    /// Run lengths of cells, the last axis varying fastest: outside, inside, outside, and so on; the first may be 0.
    pub runs: Vec<usize>,
}

/// Maximum number of cells of a grid: some seconds of work.
const MAX_CELLS: usize = 1 << 24;
/// Default number of cells along the longest side of the bounding box of both bodies.
const USUAL_CELLS: usize = 128;
/// Minimum number of cells along the longest side of the smaller body: even a thin body then has about a hundred cells
/// inside.
const MIN_CELLS: usize = 32;
/// Number of interior cells below which ratios have only one significant digit.
const FEW_CELLS: usize = 100;
/// Relative area below which a contour counts as a line or a point: area of the triangles from its first point, divided
/// by its squared extent.
const NO_AREA: f64 = 1e-12;

/// A body that can be rasterised.
enum Body {
    Contour(Vec<[f64; 2]>),
    Mesh(TriangleMesh),
    Mask(Mask),
}

impl Body {
    fn read(input: BodyInput, limits: &Limits) -> Result<Self, Vec<Fault>> {
        let mut errors = input.faults;
        let contour = take_points::<2>(&input.contour, "/contour", &mut errors);
        let vertices = take_points::<3>(&input.vertices, "/vertices", &mut errors);
        let faces = take_given(input.faces, "/faces", &mut errors);
        let mask = take_given(input.mask, "/mask", &mut errors);
        if !errors.is_empty() {
            return Err(errors);
        }
        let one = |pointer: &str, detail: String| Err(vec![Fault::new(pointer, detail)]);
        match (contour, vertices, faces, mask) {
            (Some(points), None, None, None) => match points.len() {
                3.. if points.len() <= limits.points => match enclosing(&points) {
                    Ok(()) => Ok(Self::Contour(points)),
                    Err(detail) => one("/contour", detail),
                },
                found => {
                    one("/contour", format!("expected between 3 and {} points, got {found}", limits.points))
                }
            },
            (None, Some(vertices), Some(faces), None) => {
                if vertices.len() > limits.vertices || faces.len() > 2 * limits.vertices {
                    let detail = format!(
                        "expected at most {1} vertices (and twice as many faces), got {0}",
                        vertices.len(),
                        limits.vertices
                    );
                    return one("/vertices", detail);
                }
                let mesh = TriangleMesh { vertices, normals: None, faces };
                match mesh.connectivity() {
                    Ok(_) => Ok(Self::Mesh(mesh)),
                    Err(fault) => one(&format!("/faces{}", face_pointer(&fault)), fault.to_string()),
                }
            }
            (None, None, None, Some(mask)) => read_mask(mask).map(Self::Mask),
            _ => one("", "expected one of a contour, vertices and faces, or a mask".into()),
        }
    }

    fn dimension(&self) -> usize {
        match self {
            Self::Contour(_) => 2,
            Self::Mesh(_) => 3,
            Self::Mask(mask) => {
                if mask.grid.is_planar() {
                    2
                } else {
                    3
                }
            }
        }
    }

    fn bounds(&self) -> Option<[[f64; 3]; 2]> {
        match self {
            Self::Contour(points) => bounds(points.iter().map(|[x, y]| [*x, *y, 0.0])),
            Self::Mesh(mesh) => bounds(mesh.vertices.iter().copied()),
            Self::Mask(_) => None,
        }
    }

    /// Longest side of its bounding box; `None` for a mask.
    fn extent(&self) -> Option<f64> {
        let [low, high] = self.bounds()?;
        Some((0..3).map(|c| high[c] - low[c]).fold(0.0, f64::max))
    }

    /// Caveats about its cells.
    fn warnings(&self, stop: Stop<'_>) -> Vec<String> {
        match self {
            Self::Contour(points) if polygon_self_intersects(points) => {
                vec![
                    "the contour crosses or touches itself: areas that it encloses twice count as outside"
                        .into(),
                ]
            }
            Self::Mesh(mesh) => mesh_warnings(mesh, stop),
            Self::Contour(_) | Self::Mask(_) => Vec::new(),
        }
    }

    fn on(self, grid: &Grid) -> Mask {
        match self {
            Self::Contour(points) => raster::from_contours(&[points], grid),
            Self::Mesh(mesh) => raster::from_mesh(&mesh, grid),
            Self::Mask(mask) => mask,
        }
    }
}

/// Checks that a contour encloses an area.
fn enclosing(points: &[[f64; 2]]) -> Result<(), String> {
    let [low, high] = bounds(points.iter().map(|[x, y]| [*x, *y, 0.0])).unwrap_or_default();
    let extent = (0..2).map(|c| high[c] - low[c]).fold(0.0, f64::max);
    let arm = |p: &[f64; 2]| [0, 1].map(|c| (p[c] - points[0][c]) / extent);
    let triangles = points.windows(2).map(|pair| (arm(&pair[0]), arm(&pair[1])));
    let area: f64 = triangles.map(|(p, q)| 0.5 * (p[0] * q[1] - p[1] * q[0]).abs()).sum();
    if extent > 0.0 && area > NO_AREA {
        return Ok(());
    }
    let what = if extent > 0.0 { "all of its points lie on a line" } else { "all of its points coincide" };
    Err(format!("expected a contour that encloses an area: {what}"))
}

fn read_mask(input: MaskInput) -> Result<Mask, Vec<Fault>> {
    let mut errors = Vec::new();
    let mut error =
        |pointer: &str, detail: String| errors.push(Fault::new(format!("/mask{pointer}"), detail));
    let dimension = input.size.len();
    if !(2..=3).contains(&dimension) {
        error("/size", format!("expected 2 or 3 entries, got {dimension}"));
    }
    for (list, pointer) in [(&input.spacing, "/spacing"), (&input.first, "/first")] {
        if list.len() != dimension {
            error(pointer, format!("expected {dimension} entries, one per axis, got {}", list.len()));
        } else if !list.iter().all(|value| value.abs() <= MAX_COORDINATE) {
            error(pointer, format!("expected numbers within ±{MAX_COORDINATE:e}"));
        }
    }
    if !input.spacing.iter().all(|spacing| *spacing > 0.0) {
        error("/spacing", "expected positive numbers".into());
    }
    let cells = input.size.iter().fold(1_usize, |product, size| product.saturating_mul(*size));
    if !(1..=MAX_CELLS).contains(&cells) {
        error("/size", format!("expected between 1 and {MAX_CELLS} cells, got {cells}"));
    }
    let covered = input.runs.iter().fold(0_usize, |sum, run| sum.saturating_add(*run));
    if covered != cells {
        error("/runs", format!("expected runs over all {cells} cells of the grid, got {covered}"));
    }
    if !errors.is_empty() {
        return Err(errors);
    }
    // A mask in the plane has one layer.
    let axis = |list: &[f64], usual: f64| [0, 1, 2].map(|i| list.get(i).copied().unwrap_or(usual));
    let grid = Grid {
        first: axis(&input.first, 0.0),
        spacing: axis(&input.spacing, 1.0),
        size: [0, 1, 2].map(|i| input.size.get(i).copied().unwrap_or(1)),
    };
    let runs = input.runs.iter().enumerate();
    let inside = runs.flat_map(|(i, run)| std::iter::repeat_n(i % 2 == 1, *run)).collect();
    Ok(Mask { grid, inside })
}

/// Overlap of two bodies, and the grid on which it was counted.
#[derive(Debug)]
pub struct Overlapping {
    /// The grid.
    pub grid: Grid,
    /// Dimension of the bodies: 2 or 3.
    pub dimension: usize,
    /// Counts and distances.
    pub overlap: Overlap,
    /// Caveats about the numbers, with the pointer to the body.
    pub warnings: Vec<String>,
}

/// Two bodies and the grid on which their cells are counted.
pub struct Bodies {
    both: [Body; 2],
    grid: Grid,
    dimension: usize,
}

impl Bodies {
    /// Number of cells of the grid.
    pub fn cells(&self) -> usize {
        self.grid.size.iter().product()
    }

    /// Computes the overlap.
    ///
    /// # Errors
    /// [`ServiceError::Cancelled`].
    pub fn overlap(self, context: &JobContext) -> Result<Overlapping, ServiceError> {
        let Self { both: [first, second], grid, dimension } = self;
        let stop = || context.is_cancelled();
        let [mut found, of_second] = [first.warnings(&stop), second.warnings(&stop)];
        context.check()?;
        let masks = [first.on(&grid), second.on(&grid)];
        let overlap = raster::overlap_unless_stopped(&masks[0], &masks[1], &stop);
        let overlap = overlap.ok_or(ServiceError::Cancelled)?;
        found.iter_mut().for_each(|warning| *warning = format!("/first: {warning}"));
        found.extend(of_second.into_iter().map(|warning| format!("/second: {warning}")));
        for (body, cells) in ["first", "second"].iter().zip(overlap.cells) {
            if cells < FEW_CELLS {
                found.push(format!(
                    "/{body}: only {cells} cells inside, too few to compare: use a smaller /spacing"
                ));
            }
        }
        Ok(Overlapping { grid, dimension, overlap, warnings: found })
    }
}

/// Reads two bodies and chooses their grid: that of a mask, or one around both bodies with cells of `spacing`. Default:
/// 128 cells along the longest side of both, and at least 32 along that of the smaller body, within the limit on cells.
///
/// # Errors
/// Faults of the bodies at `/first…` and `/second…`; a planar and a spatial body; masks on different grids; too many
/// cells.
pub fn read(
    app: &App,
    [first, second]: [BodyInput; 2],
    spacing: Option<f64>,
) -> Result<Bodies, ServiceError> {
    let mut faults = Vec::new();
    let mut read = |body, pointer: &str| match Body::read(body, &app.limits) {
        Ok(body) => Some(body),
        Err(errors) => {
            faults.extend(errors.into_iter().map(|error| error.below(pointer)));
            None
        }
    };
    let bodies = (read(first, "/first"), read(second, "/second"));
    ServiceError::unless_empty(faults)?;
    let (Some(first), Some(second)) = bodies else {
        return Err(ServiceError::Internal("a body that is neither read nor refused".into()));
    };
    let dimension = first.dimension();
    let refused = |pointer: &str, detail: String| Err(ServiceError::invalid(pointer, detail));
    if second.dimension() != dimension {
        let detail =
            format!("expected dimension {dimension}, as in the first body, got {}", second.dimension());
        return refused("/second", detail);
    }
    let grid = match (&first, &second) {
        (Body::Mask(one), Body::Mask(other)) if one.grid != other.grid => {
            return refused(
                "/second/mask",
                "expected the grid of the first mask: masks are compared cell by cell".into(),
            );
        }
        (Body::Mask(mask), _) | (_, Body::Mask(mask)) if spacing.is_none() => mask.grid,
        (Body::Mask(_), _) | (_, Body::Mask(_)) => {
            return refused("/spacing", "expected no spacing: it is that of the mask".into());
        }
        _ => grid_around([&first, &second], dimension, spacing)?,
    };
    Ok(Bodies { both: [first, second], grid, dimension })
}

fn grid_around(bodies: [&Body; 2], dimension: usize, spacing: Option<f64>) -> Result<Grid, ServiceError> {
    let corners = bodies.into_iter().filter_map(Body::bounds).flatten();
    let Some([low, high]) = bounds(corners) else {
        return Err(ServiceError::Internal("bodies without points".into()));
    };
    let flat = |point: [f64; 3]| [point[0], point[1]];
    // Number of cells, computed before any of them is allocated.
    let cells = |spacing: f64| (0..dimension).map(|c| (high[c] - low[c]) / spacing + 3.0).product::<f64>();
    let spacing = match spacing {
        Some(spacing) => given_spacing(spacing, cells(spacing))?,
        None => usual_spacing(bodies, cells)?,
    };
    Ok(match dimension {
        2 => Grid::around([flat(low), flat(high)], [spacing; 2]),
        _ => Grid::around([low, high], [spacing; 3]),
    })
}

fn given_spacing(spacing: f64, cells: f64) -> Result<f64, ServiceError> {
    if !(spacing > 0.0 && spacing <= MAX_COORDINATE) {
        return Err(ServiceError::invalid("/spacing", format!("expected a positive number, got {spacing}")));
    }
    if !(cells <= MAX_CELLS as f64) {
        let detail = format!(
            "expected a spacing that makes at most {MAX_CELLS} cells, got {spacing}, which makes {cells:.1e}"
        );
        return Err(ServiceError::invalid("/spacing", detail));
    }
    Ok(spacing)
}

/// The finer of the spacings that both bodies require, within the limit on cells.
fn usual_spacing(bodies: [&Body; 2], cells: impl Fn(f64) -> f64) -> Result<f64, ServiceError> {
    /// Factor by which the spacing grows until the number of cells is within the limit.
    const COARSER: f64 = 1.02;
    let extents = bodies.map(|body| body.extent().unwrap_or(0.0));
    if let Some(body) = extents.iter().position(|extent| !(*extent > 0.0)) {
        let detail = "all vertices coincide: the body encloses nothing";
        return Err(ServiceError::invalid(["/first", "/second"][body], detail));
    }
    let both = bounds(bodies.into_iter().filter_map(Body::bounds).flatten()).unwrap_or_default();
    let longest = (0..3).map(|c| both[1][c] - both[0][c]).fold(0.0, f64::max);
    let usual = longest / USUAL_CELLS as f64;
    let mut spacing = usual.min(extents[0].min(extents[1]) / MIN_CELLS as f64);
    while spacing < usual && !(cells(spacing) <= MAX_CELLS as f64) {
        // Even a flat box has enough cells at a millionth of its length, so that fewer than 500 steps remain.
        spacing = (spacing * COARSER).max(1e-6 * longest);
    }
    Ok(spacing.min(usual))
}
