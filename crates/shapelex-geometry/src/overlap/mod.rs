//! Overlap of two bodies (contours, closed curves and meshes, or masks), counted on one common grid.
//!
//! Bodies without a grid get one around both, fine enough for the smaller one.

use crate::capability::measure::mesh_warnings;
use crate::curve::Curve;
use crate::field_fault::FieldFault;
use crate::intersection::{polygon_self_intersects, self_intersects};
use crate::mesh::{MeshError, TriangleMesh};
use crate::quality::{coarse_rounding, rounding_warning};
use crate::raster::{Grid, Mask, Overlap, from_contours, from_curves, from_mesh, overlap_unless_stopped};
use crate::vector::bounds;
use shapelex_numeric::MAX_NUMBER;
use shapelex_numeric::bounded::Stop;

mod input;

pub use input::{GridInput, MaskInput};

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

/// Number of points per segment that bound a curve: of a circle with three segments, they miss 10⁻⁴ of the radius.
const CURVE_SAMPLES: usize = 64;

/// Warning about a contour that crosses itself.
const CROSSES: &str =
    "the contour crosses or touches itself: areas with the winding number zero count as outside";

/// A box by its lower and upper corners.
type Corners = [[f64; 3]; 2];

/// A body that can be rasterised.
#[derive(Debug, Clone)]
pub struct Body {
    kind: Kind,
    /// Bounding box; for a mask, that of the centres of its grid.
    corners: Corners,
}

#[derive(Debug, Clone)]
enum Kind {
    Contour(Vec<[f64; 2]>),
    Curve(Curve),
    Mesh(TriangleMesh),
    Mask(Mask),
}

impl Body {
    /// The interior of a closed contour in the plane.
    ///
    /// # Errors
    /// Points on a line, in words.
    pub fn from_contour(points: Vec<[f64; 2]>) -> Result<Self, String> {
        let corners = bounds(points.iter().map(|[x, y]| [*x, *y, 0.0])).unwrap_or_default();
        check_area(&points, longest_side(corners))?;
        Ok(Self { kind: Kind::Contour(points), corners })
    }

    /// The interior of a closed spline curve in the plane. Its cells are found from the curve itself, not from chords.
    ///
    /// # Errors
    /// An open curve, one in space, or one without an area, in words.
    pub fn from_curve(curve: Curve) -> Result<Self, String> {
        if !curve.is_closed() || curve.dimension() != 2 {
            let what = if curve.is_closed() { "a closed" } else { "an open" };
            return Err(format!(
                "expected a closed curve of dimension 2, got {what} one of dimension {}",
                curve.dimension()
            ));
        }
        let points: Vec<[f64; 2]> =
            curve.sample(CURVE_SAMPLES * curve.segments()).iter().map(|point| [point[0], point[1]]).collect();
        let corners = bounds(points.iter().map(|[x, y]| [*x, *y, 0.0])).unwrap_or_default();
        check_area(&points, longest_side(corners))?;
        Ok(Self { kind: Kind::Curve(curve), corners })
    }

    /// The interior of a closed mesh: where its winding number is not zero.
    ///
    /// # Errors
    /// Faces that do not form a closed surface.
    pub fn from_mesh(mesh: TriangleMesh) -> Result<Self, MeshError> {
        mesh.connectivity()?;
        let corners = bounds(mesh.vertices.iter().copied()).unwrap_or_default();
        Ok(Self { kind: Kind::Mesh(mesh), corners })
    }

    /// The cells of a mask.
    pub fn from_mask(mask: Mask) -> Self {
        let Grid { first, spacing, size } = mask.grid;
        let last = [0, 1, 2].map(|c| first[c] + spacing[c] * size[c].saturating_sub(1) as f64);
        Self { kind: Kind::Mask(mask), corners: [first, last] }
    }

    fn dimension(&self) -> usize {
        match &self.kind {
            Kind::Contour(_) | Kind::Curve(_) => 2,
            Kind::Mask(mask) if mask.grid.is_planar() => 2,
            Kind::Mesh(_) | Kind::Mask(_) => 3,
        }
    }

    fn grid(&self) -> Option<Grid> {
        match &self.kind {
            Kind::Mask(mask) => Some(mask.grid),
            Kind::Contour(_) | Kind::Curve(_) | Kind::Mesh(_) => None,
        }
    }

    /// Caveats about its cells.
    fn warnings(&self, stop: Stop<'_>) -> Vec<String> {
        match &self.kind {
            Kind::Contour(points) => self.planar_warnings(polygon_self_intersects(points)),
            Kind::Curve(curve) => self.planar_warnings(self_intersects(curve)),
            Kind::Mesh(mesh) => mesh_warnings(mesh, stop),
            Kind::Mask(_) => Vec::new(),
        }
    }

    fn planar_warnings(&self, crosses: bool) -> Vec<String> {
        let largest = self.corners.as_flattened().iter().fold(0.0_f64, |most, value| most.max(value.abs()));
        let rounding = coarse_rounding(longest_side(self.corners), largest).map(rounding_warning);
        crosses.then(|| CROSSES.to_owned()).into_iter().chain(rounding).collect()
    }

    /// Its cells on a grid; `None` once `stop` returns true.
    fn on(self, grid: &Grid, stop: Stop<'_>) -> Option<Mask> {
        match self.kind {
            Kind::Contour(points) => Some(from_contours(&[points], grid)),
            Kind::Curve(curve) => from_curves(&[curve], grid, stop),
            Kind::Mesh(mesh) => Some(from_mesh(&mesh, grid)),
            Kind::Mask(mask) => Some(mask),
        }
    }

    /// Whether a part of it is more than half a cell beyond the outermost centres of a grid.
    fn leaves(&self, grid: &Grid) -> bool {
        let [low, high] = self.corners;
        (0..self.dimension()).any(|c| {
            let last = grid.first[c] + grid.spacing[c] * grid.size[c].saturating_sub(1) as f64;
            low[c] < grid.first[c] - 0.5 * grid.spacing[c] || high[c] > last + 0.5 * grid.spacing[c]
        })
    }
}

fn longest_side([low, high]: Corners) -> f64 {
    (0..3).map(|c| high[c] - low[c]).fold(0.0, f64::max)
}

/// Checks that a contour whose longest side is `extent` encloses an area.
fn check_area(points: &[[f64; 2]], extent: f64) -> Result<(), String> {
    let arm = |p: &[f64; 2]| [0, 1].map(|c| (p[c] - points[0][c]) / extent);
    let triangles = points.windows(2).map(|pair| (arm(&pair[0]), arm(&pair[1])));
    let area: f64 = triangles.map(|(p, q)| 0.5 * (p[0] * q[1] - p[1] * q[0]).abs()).sum();
    if extent > 0.0 && area > NO_AREA {
        return Ok(());
    }
    let what = if extent > 0.0 { "all of its points lie on a line" } else { "all of its points coincide" };
    Err(format!("expected a contour that encloses an area: {what}"))
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
#[derive(Debug, Clone)]
pub struct Bodies {
    both: [Body; 2],
    grid: Grid,
    dimension: usize,
}

impl Bodies {
    /// Chooses the grid of two bodies, of at most `most_cells` cells: that of a mask, or one around both with cells of
    /// `spacing`. Default: 128 cells along the longest side of both, and at least 32 along that of the smaller body, as far
    /// as `most_cells` allows.
    ///
    /// # Errors
    /// A planar and a spatial body; masks on different grids; a spacing beside a mask, out of range, or too fine.
    pub fn new(
        [first, second]: [Body; 2],
        spacing: Option<f64>,
        most_cells: usize,
    ) -> Result<Self, FieldFault> {
        let dimension = first.dimension();
        if second.dimension() != dimension {
            let detail =
                format!("expected dimension {dimension}, as in the first body, got {}", second.dimension());
            return Err(FieldFault::new("second", detail));
        }
        let grid = match (first.grid(), second.grid()) {
            (Some(one), Some(other)) if one != other => {
                let detail = "expected the grid of the first mask: masks are compared cell by cell";
                return Err(FieldFault::new("second/mask", detail));
            }
            (Some(grid), _) | (_, Some(grid)) if spacing.is_none() => grid,
            (Some(_), _) | (_, Some(_)) => {
                return Err(FieldFault::new("spacing", "expected no spacing: it is that of the mask"));
            }
            (None, None) => grid_around([&first, &second], dimension, spacing, most_cells as f64)?,
        };
        Ok(Self { both: [first, second], grid, dimension })
    }

    /// Counts two bodies on a given grid of a dimension. Parts of bodies beyond it are left out, with a warning.
    ///
    /// # Errors
    /// Bodies of another dimension; a mask on another grid.
    pub fn on_grid(
        [first, second]: [Body; 2],
        grid: Grid,
        dimension: usize,
    ) -> Result<Self, Vec<FieldFault>> {
        let mut faults = Vec::new();
        for (body, name) in [(&first, "first"), (&second, "second")] {
            if body.dimension() != dimension {
                let detail = format!("expected dimension {dimension}, as the grid, got {}", body.dimension());
                faults.push(FieldFault::new(name, detail));
            } else if body.grid().is_some_and(|own| own != grid) {
                let detail = "expected the given grid: masks are compared cell by cell, got another one";
                faults.push(FieldFault::new(format!("{name}/mask"), detail));
            }
        }
        if faults.is_empty() { Ok(Self { both: [first, second], grid, dimension }) } else { Err(faults) }
    }

    /// Number of cells of the grid.
    pub fn cells(&self) -> usize {
        self.grid.size.iter().product()
    }

    /// Computes the overlap; `None` once `stop` returns true.
    pub fn overlap(self, stop: Stop<'_>) -> Option<Overlapping> {
        let Self { both: [first, second], grid, dimension } = self;
        let [mut found, of_second] = [&first, &second].map(|body| {
            let beyond = body.leaves(&grid).then(|| "parts of it beyond the grid are left out".to_owned());
            body.warnings(stop).into_iter().chain(beyond).collect::<Vec<String>>()
        });
        if stop() {
            return None;
        }
        let masks = [first.on(&grid, stop)?, second.on(&grid, stop)?];
        let overlap = overlap_unless_stopped(&masks[0], &masks[1], stop)?;
        found.iter_mut().for_each(|warning| *warning = format!("/first: {warning}"));
        found.extend(of_second.into_iter().map(|warning| format!("/second: {warning}")));
        for (body, cells) in ["first", "second"].iter().zip(overlap.cells) {
            if cells < FEW_CELLS {
                found.push(format!(
                    "/{body}: only {cells} cells inside, too few to compare: use a smaller /spacing"
                ));
            }
        }
        Some(Overlapping { grid, dimension, overlap, warnings: found })
    }
}

/// The grid around bodies that bring none.
fn grid_around(
    bodies: [&Body; 2],
    dimension: usize,
    spacing: Option<f64>,
    most_cells: f64,
) -> Result<Grid, FieldFault> {
    let [low, high] = both_corners(bodies);
    let flat = |point: [f64; 3]| [point[0], point[1]];
    // Number of cells, computed before any of them is allocated.
    let cells = |spacing: f64| (0..dimension).map(|c| (high[c] - low[c]) / spacing + 3.0).product::<f64>();
    let spacing = match spacing {
        Some(spacing) => given_spacing(spacing, cells(spacing), most_cells)?,
        None => usual_spacing(bodies, cells, most_cells)?,
    };
    Ok(match dimension {
        2 => Grid::around([flat(low), flat(high)], [spacing; 2]),
        _ => Grid::around([low, high], [spacing; 3]),
    })
}

fn both_corners(bodies: [&Body; 2]) -> Corners {
    bounds(bodies.into_iter().flat_map(|body| body.corners)).unwrap_or_default()
}

fn given_spacing(spacing: f64, cells: f64, most_cells: f64) -> Result<f64, FieldFault> {
    if !(spacing > 0.0 && spacing <= MAX_NUMBER) {
        return Err(FieldFault::new("spacing", format!("expected a positive number, got {spacing}")));
    }
    if !(cells <= most_cells) {
        let detail = format!(
            "expected a spacing that makes at most {most_cells} cells, got {spacing}, which makes {cells:.1e}"
        );
        return Err(FieldFault::new("spacing", detail));
    }
    Ok(spacing)
}

/// The finer of the spacings that both bodies require, within the limit on cells.
fn usual_spacing(bodies: [&Body; 2], cells: impl Fn(f64) -> f64, most_cells: f64) -> Result<f64, FieldFault> {
    /// Factor by which the spacing grows until the number of cells is within the limit.
    const COARSER: f64 = 1.02;
    let extents = bodies.map(|body| longest_side(body.corners));
    if let Some(body) = extents.iter().position(|extent| !(*extent > 0.0)) {
        let detail = "all vertices coincide: the body encloses nothing";
        return Err(FieldFault::new(["first", "second"][body], detail));
    }
    let longest = longest_side(both_corners(bodies));
    let usual = longest / USUAL_CELLS as f64;
    let mut spacing = usual.min(extents[0].min(extents[1]) / MIN_CELLS as f64);
    while spacing < usual && !(cells(spacing) <= most_cells) {
        // Even a flat box has enough cells at a millionth of its length, so that fewer than 500 steps remain.
        spacing = (spacing * COARSER).max(1e-6 * longest);
    }
    Ok(spacing.min(usual))
}

#[cfg(test)]
mod tests {
    use super::*;
    use shapelex_numeric::bounded::never;

    const MOST: usize = 1 << 20;

    fn square(side: f64, corner: f64) -> Body {
        let [low, high] = [corner, corner + side];
        Body::from_contour(vec![[low, low], [high, low], [high, high], [low, high]]).unwrap()
    }

    #[test]
    fn squares_that_share_a_quarter_overlap_by_a_seventh() {
        let bodies = Bodies::new([square(4.0, 0.0), square(4.0, 2.0)], Some(0.02), MOST).unwrap();
        let found = bodies.overlap(&never).unwrap();
        assert!((found.overlap.jaccard - 1.0 / 7.0).abs() < 2e-3, "{}", found.overlap.jaccard);
        assert_eq!((found.dimension, found.warnings.len()), (2, 0));
    }

    #[test]
    fn a_contour_walked_twice_is_itself() {
        let corners = [[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]];
        let bodies = [corners.repeat(2), corners.to_vec()].map(|points| Body::from_contour(points).unwrap());
        let found = Bodies::new(bodies, None, MOST).unwrap().overlap(&never).unwrap();
        assert_eq!((found.overlap.jaccard, found.overlap.hausdorff), (1.0, Some(0.0)));
    }

    #[test]
    fn contours_without_an_area_are_refused() {
        for points in [vec![[1.0, 1.0]; 3], vec![[0.0, 0.0], [1.0, 2.0], [3.0, 6.0]]] {
            let detail = Body::from_contour(points).unwrap_err();
            assert!(detail.starts_with("expected a contour that encloses an area"), "{detail}");
        }
    }

    #[test]
    fn a_small_body_gets_cells_of_its_own_size_within_the_limit() {
        let fine = Bodies::new([square(100.0, 0.0), square(1.0, 0.0)], None, MOST << 6).unwrap();
        assert_eq!(fine.grid.spacing[0], 1.0 / 32.0);
        let coarse = Bodies::new([square(100.0, 0.0), square(1.0, 0.0)], None, MOST).unwrap();
        assert!(coarse.cells() <= MOST && coarse.grid.spacing[0] > 1.0 / 32.0, "{}", coarse.cells());
    }

    #[test]
    fn a_mask_brings_its_grid_and_its_faults_are_named() {
        let mask =
            MaskInput { size: vec![2, 2], spacing: vec![1.0; 2], first: vec![0.0; 2], runs: vec![1, 3] };
        let body = || Body::from_mask(mask.mask(MOST).unwrap());
        let refused = Bodies::new([body(), square(1.0, 0.0)], Some(0.1), MOST).unwrap_err();
        assert_eq!(refused.field, "spacing");
        let found = Bodies::new([body(), body()], None, MOST).unwrap().overlap(&never).unwrap();
        assert_eq!((found.overlap.cells, found.overlap.intersection), ([3, 3], 3));
        let wrong = MaskInput { spacing: vec![-1.0, 1e101], runs: vec![9], ..mask };
        let fields: Vec<String> = wrong.mask(3).unwrap_err().into_iter().map(|fault| fault.field).collect();
        assert_eq!(fields, ["spacing", "spacing", "size", "runs"]);
    }
}
