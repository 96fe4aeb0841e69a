//! How two bodies overlap: Jaccard and Dice of the cells inside of both, distances of their surfaces. A plain function, to be run
//! on the pool.

use super::input::face_pointer;
use super::surface_fitting::take_points;
use super::{App, Limits, ServiceError};
use crate::formats::InputError;
use crate::formats::checked::{Checked, LARGE, document, take_given};
use crate::formats::shape::{MAX_COORDINATE, PointList};
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::raster::{self, Grid, Mask, Overlap, bounds};

document! {
    /// A body: one of `contour`, `vertices` with `faces`, and `mask`.
    pub struct BodyInput {
        /// A closed contour in the plane.
        #[schema(value_type = Option<Vec<[f64; 2]>>)]
        contour: PointList;
        /// Vertices of a closed triangle mesh.
        #[schema(value_type = Option<Vec<[f64; 3]>>)]
        vertices: PointList;
        /// Its triangles.
        #[schema(value_type = Option<Vec<[u32; 3]>>)]
        faces: Checked<Vec<[u32; 3]>, LARGE>;
        /// A mask.
        #[schema(value_type = Option<MaskInput>)]
        mask: Checked<MaskInput, LARGE>;
    }
}

/// Cells of a regular grid, inside or outside.
#[derive(Debug, Clone, serde::Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct MaskInput {
    /// Number of cells along the 2 or 3 axes.
    pub size: Vec<usize>,
    /// Distances of their centres along the axes.
    pub spacing: Vec<f64>,
    /// Where the centre of the first cell is.
    pub first: Vec<f64>,
    /// Lengths of runs of cells in order, the last axis fastest: outside, inside, outside, and so on; the first may be 0.
    pub runs: Vec<usize>,
}

/// Cells of a grid at the most: some seconds.
const MOST_CELLS: usize = 1 << 24;
/// Cells along the longest side unless a spacing is given.
const USUAL_CELLS: usize = 128;

/// A body that can be put on a grid.
enum Body {
    Contour(Vec<[f64; 2]>),
    Mesh(TriangleMesh),
    Mask(Mask),
}

impl Body {
    fn read(input: BodyInput, limits: &Limits) -> Result<Self, Vec<InputError>> {
        let mut errors = input.faults;
        let contour = take_points::<2>(&input.contour, "/contour", &mut errors);
        let vertices = take_points::<3>(&input.vertices, "/vertices", &mut errors);
        let faces = take_given(input.faces, "/faces", &mut errors);
        let mask = take_given(input.mask, "/mask", &mut errors);
        if !errors.is_empty() {
            return Err(errors);
        }
        let one = |pointer: &str, detail: String| Err(vec![InputError::new(pointer, detail)]);
        match (contour, vertices, faces, mask) {
            (Some(points), None, None, None) => match points.len() {
                3.. if points.len() <= limits.points => Ok(Self::Contour(points)),
                found => {
                    one("/contour", format!("has {found} points, must have between 3 and {}", limits.points))
                }
            },
            (None, Some(vertices), Some(faces), None) => {
                if vertices.len() > limits.vertices || faces.len() > 2 * limits.vertices {
                    let detail =
                        format!("has {} vertices, at most {} are accepted", vertices.len(), limits.vertices);
                    return one("/vertices", detail);
                }
                let mesh = TriangleMesh { vertices, normals: None, faces };
                match mesh.connectivity() {
                    Ok(_) => Ok(Self::Mesh(mesh)),
                    Err(fault) => one(&format!("/faces{}", face_pointer(&fault)), fault.to_string()),
                }
            }
            (None, None, None, Some(mask)) => read_mask(mask).map(Self::Mask),
            _ => one("", "must have a contour, or vertices and faces, or a mask: one of them".into()),
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

    fn on(self, grid: &Grid) -> Mask {
        match self {
            Self::Contour(points) => raster::of_contours(&[points], grid),
            Self::Mesh(mesh) => raster::of_mesh(&mesh, grid),
            Self::Mask(mask) => mask,
        }
    }
}

fn read_mask(input: MaskInput) -> Result<Mask, Vec<InputError>> {
    let mut errors = Vec::new();
    let mut error =
        |pointer: &str, detail: String| errors.push(InputError::new(format!("/mask{pointer}"), detail));
    let dimension = input.size.len();
    if !(2..=3).contains(&dimension) {
        error("/size", format!("has {dimension} entries, must have 2 or 3"));
    }
    for (list, pointer) in [(&input.spacing, "/spacing"), (&input.first, "/first")] {
        if list.len() != dimension {
            error(pointer, format!("has {} entries for {dimension} axes", list.len()));
        } else if !list.iter().all(|value| value.abs() <= MAX_COORDINATE) {
            error(pointer, format!("has numbers beyond ±{MAX_COORDINATE:e}"));
        }
    }
    if !input.spacing.iter().all(|spacing| *spacing > 0.0) {
        error("/spacing", "must be positive".into());
    }
    let cells = input.size.iter().fold(1_usize, |product, size| product.saturating_mul(*size));
    if !(1..=MOST_CELLS).contains(&cells) {
        error("/size", format!("makes {cells} cells, must make between 1 and {MOST_CELLS}"));
    }
    let covered = input.runs.iter().fold(0_usize, |sum, run| sum.saturating_add(*run));
    if covered != cells {
        error("/runs", format!("cover {covered} cells, the grid has {cells}"));
    }
    if !errors.is_empty() {
        return Err(errors);
    }
    // A mask of the plane has one layer.
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

/// How two bodies overlap, and on which grid that was counted.
#[derive(Debug)]
pub struct Overlapping {
    /// The grid.
    pub grid: Grid,
    /// 2 or 3.
    pub dimension: usize,
    /// The counts and distances.
    pub overlap: Overlap,
}

/// Two bodies and the grid on which their cells are counted.
pub struct Bodies {
    both: [Body; 2],
    grid: Grid,
    dimension: usize,
}

impl Bodies {
    /// Cells of the grid.
    pub fn cells(&self) -> usize {
        self.grid.size.iter().product()
    }

    /// How they overlap.
    pub fn overlap(self) -> Overlapping {
        let Self { both: [first, second], grid, dimension } = self;
        let overlap = raster::overlap(&first.on(&grid), &second.on(&grid));
        Overlapping { grid, dimension, overlap }
    }
}

/// Two bodies on the grid of a mask, or on one with cells of `spacing` around both; 128 along the longest side
/// unless given.
///
/// # Errors
/// Faults of the bodies at `/first…` and `/second…`; a plane body and one of space; masks on different grids; too many cells.
pub fn read(
    app: &App,
    [first, second]: [BodyInput; 2],
    spacing: Option<f64>,
) -> Result<Bodies, ServiceError> {
    let mut faults = Vec::new();
    let mut read = |body, pointer: &str| match Body::read(body, &app.limits) {
        Ok(body) => Some(body),
        Err(errors) => {
            faults.extend(errors.into_iter().map(|error| error.below(pointer).into()));
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
        let detail = format!("has dimension {}, the first body has {dimension}", second.dimension());
        return refused("/second", detail);
    }
    let grid = match (&first, &second) {
        (Body::Mask(one), Body::Mask(other)) if one.grid != other.grid => {
            return refused(
                "/second/mask",
                "has another grid than the first: masks are compared cell by cell".into(),
            );
        }
        (Body::Mask(mask), _) | (_, Body::Mask(mask)) if spacing.is_none() => mask.grid,
        (Body::Mask(_), _) | (_, Body::Mask(_)) => {
            return refused("/spacing", "is that of the mask: leave it out".into());
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
    let extent = (0..dimension).map(|c| high[c] - low[c]).fold(0.0, f64::max);
    let spacing = spacing.unwrap_or(extent / USUAL_CELLS as f64);
    if !(spacing > 0.0 && spacing <= MAX_COORDINATE) {
        let detail = format!("is {spacing}, must be positive");
        return Err(ServiceError::invalid("/spacing", detail));
    }
    // In the numbers of cells along the axes, before any of them is made.
    let cells: f64 = (0..dimension).map(|c| (high[c] - low[c]) / spacing + 3.0).product();
    if !(cells <= MOST_CELLS as f64) {
        let detail = format!("is {spacing}, which makes {cells:.1e} cells, at most {MOST_CELLS} are counted");
        return Err(ServiceError::invalid("/spacing", detail));
    }
    Ok(match dimension {
        2 => Grid::around([flat(low), flat(high)], [spacing; 2]),
        _ => Grid::around([low, high], [spacing; 3]),
    })
}
