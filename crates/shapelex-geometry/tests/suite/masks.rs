//! Masks of curves, grids given by the caller, and the order of axes.

use std::f64::consts::TAU;

use shapelex_geometry::curve::Curve;
use shapelex_geometry::field_fault::FieldFault;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::mesh::TriangleMesh;
use shapelex_geometry::overlap::{Bodies, Body, GridInput, MaskInput};
use shapelex_geometry::raster::{Grid, Mask, from_contours, from_curves, overlap};
use shapelex_numeric::bounded::never;
use shapelex_numeric::dense::Matrix;

use crate::spaces::{closed, open};

/// Cells of any grid.
const MANY: usize = 1 << 22;

/// The closed curve through `f(2πk/n)`, with the generator that has ellipses exactly.
fn closed_through(n: usize, f: impl Fn(f64) -> [f64; 2]) -> Curve {
    let space = closed(&GeneratorKind::Trigonometric {}, n, 2).unwrap();
    let points = Matrix::from_fn(n, 2, |k, c| f(TAU * k as f64 / n as f64)[c]);
    Curve::of(&space, &space.interpolate(points).unwrap()).unwrap()
}

fn circle(radius: f64, centre: [f64; 2]) -> Curve {
    closed_through(4, |t| [centre[0] + radius * t.cos(), centre[1] + radius * t.sin()])
}

/// A circle of 500 cells: no cell is on the wrong side of the curve, while the polygon of 64 points per segment that brackets the
/// crossings loses the cells between its chords and the curve.
fn on_grid(bodies: [Body; 2], grid: &GridInput) -> Result<Bodies, Vec<FieldFault>> {
    Bodies::on_grid(bodies, grid.grid(MANY).unwrap(), grid.size.len())
}

#[test]
fn cells_of_curves_are_those_inside_of_the_curve() {
    let (radius, centre) = (500.3, [510.1, 505.7]);
    let grid = Grid { first: [0.0; 3], spacing: [1.0; 3], size: [1021, 1011, 1] };
    let curve = circle(radius, centre);
    let mask = from_curves(std::slice::from_ref(&curve), &grid, &never).unwrap();
    for (at, inside) in mask.inside.iter().enumerate() {
        let [i, j] = [at / 1011, at % 1011].map(|index| index as f64);
        let depth = radius - (i - centre[0]).hypot(j - centre[1]);
        // Coordinates of 10³ are rounded to 10⁻¹³, and the interpolation to some more.
        assert!(*inside == (depth > 0.0) || depth.abs() < 1e-9, "({i}, {j}), {depth:e} inside");
    }
    let polygon: Vec<[f64; 2]> = curve.sample(256).iter().map(|point| [point[0], point[1]]).collect();
    let lost = mask.count() - from_contours(&[polygon], &grid).count();
    // The segments between 256 chords and the circle: π R² · (2π/256)²/6 = 79 cells.
    assert!((60..100).contains(&lost), "{lost}");
    assert_eq!(from_curves(&[curve], &grid, &|| true), None);
}

/// A curve that crosses itself is filled by its winding number: both lobes of an eight, and the inner loop of a limaçon too.
#[test]
fn curves_that_cross_themselves_are_filled_by_their_winding_number() {
    let eight = closed_through(12, |t| [20.0 * t.sin(), 8.0 * (2.0 * t).sin()]);
    let limacon = closed_through(12, |t| {
        let r = 6.0 + 12.0 * t.cos();
        [r * t.cos(), r * t.sin()]
    });
    let grid = Grid { first: [-24.73, -24.71, 0.0], spacing: [0.5, 0.5, 1.0], size: [100, 100, 1] };
    for curve in [eight, limacon] {
        let points: Vec<[f64; 2]> = curve.sample(100_000).iter().map(|point| [point[0], point[1]]).collect();
        let expected = from_contours(&[points], &grid);
        let found = from_curves(&[curve], &grid, &never).unwrap();
        assert_eq!(found, expected);
        assert!(found.count() > 1000);
    }
}

fn cube(corner: [f64; 3], side: f64) -> TriangleMesh {
    let vertex = |v: usize| [0, 1, 2].map(|axis| corner[axis] + if v >> axis & 1 == 0 { 0.0 } else { side });
    let sides = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    let faces = sides.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    TriangleMesh { vertices: (0..8).map(vertex).collect(), normals: None, faces }
}

/// Curves and meshes are compared with masks on the grid of an image, with another number of cells along each axis.
#[test]
fn bodies_are_counted_on_a_given_grid() {
    let plane = GridInput { size: vec![12, 7], spacing: vec![0.5, 2.0], first: vec![0.25, 1.0] };
    // Six cells along x, three along y.
    let cells = (0..12 * 7).map(|at| at / 7 < 6 && (1..4).contains(&(at % 7)));
    let mask = Mask { grid: plane.grid(MANY).unwrap(), inside: cells.collect() };
    let rectangle = vec![[0.0, 2.0], [3.0, 2.0], [3.0, 8.0], [0.0, 8.0]];
    let bodies = [Body::from_contour(rectangle).unwrap(), Body::from_mask(mask)];
    let found = on_grid(bodies, &plane).unwrap().overlap(&never).unwrap();
    assert_eq!((found.overlap.cells, found.overlap.jaccard), ([18, 18], 1.0));
    assert_eq!((found.grid.size, found.dimension), ([12, 7, 1], 2));

    let ellipse = closed_through(5, |t| [3.0 + 2.4 * t.cos(), 7.0 + 5.0 * t.sin()]);
    let bodies = [Body::from_curve(ellipse.clone()).unwrap(), Body::from_curve(ellipse).unwrap()];
    let fine = GridInput { size: vec![600, 70], spacing: vec![0.01, 0.2], first: vec![0.0, 0.1] };
    let found = on_grid(bodies, &fine).unwrap().overlap(&never).unwrap();
    let area = found.overlap.cells[0] as f64 * 0.01 * 0.2;
    // The sum over rows of 0.2 errs by 0.03 at the two ends, where the width is a square root.
    assert!((area - TAU / 2.0 * 2.4 * 5.0).abs() < 0.1, "{area}");
    assert_eq!(found.overlap.hausdorff, Some(0.0));

    let space = GridInput { size: vec![8, 6, 5], spacing: vec![1.0, 1.0, 2.0], first: vec![0.5, 0.5, 1.0] };
    let bodies = [[1.0, 1.0, 2.0], [5.0, 1.0, 2.0]].map(|corner| Body::from_mesh(cube(corner, 4.0)).unwrap());
    let found = on_grid(bodies, &space).unwrap().overlap(&never).unwrap();
    // The second cube leaves the grid at x = 8.
    assert_eq!(found.overlap.cells, [4 * 4 * 2, 3 * 4 * 2]);
    assert_eq!(found.warnings[0], "/second: parts of it beyond the grid are left out");
}

#[test]
fn grids_and_bodies_that_do_not_fit_are_refused() {
    let square = || Body::from_contour(vec![[0.0, 0.0], [3.0, 0.0], [3.0, 3.0], [0.0, 3.0]]).unwrap();
    let refused = |grid: GridInput, second: Body| -> Vec<String> {
        let faults = match grid.grid(1000) {
            Ok(_) => on_grid([square(), second], &grid).unwrap_err(),
            Err(faults) => faults,
        };
        faults.into_iter().map(|fault| fault.field).collect()
    };
    let grid = |size: &[usize], spacing: &[f64]| GridInput {
        size: size.to_vec(),
        spacing: spacing.to_vec(),
        first: vec![0.0; size.len()],
    };
    assert_eq!(refused(grid(&[40, 30], &[1.0; 2]), square()), ["size"]);
    assert_eq!(refused(grid(&[4, 3], &[1.0, f64::NAN]), square()), ["spacing", "spacing"]);
    assert_eq!(refused(grid(&[4, 3, 2], &[1.0; 3]), square()), ["first", "second"]);
    let own = MaskInput { size: vec![4, 3], spacing: vec![1.0; 2], first: vec![0.5; 2], runs: vec![4, 8] };
    let own = Body::from_mask(own.mask(1000).unwrap());
    assert_eq!(refused(grid(&[4, 3], &[1.0; 2]), own), ["second/mask"]);
    let space = open(&GeneratorKind::Trigonometric {}, 6, 2).unwrap();
    let points = Matrix::from_fn(7, 2, |k, c| if c == 0 { k as f64 } else { (k * k) as f64 });
    let arc = Curve::of(&space, &space.interpolate(points).unwrap()).unwrap();
    assert!(Body::from_curve(arc).unwrap_err().starts_with("expected a closed curve of dimension 2"));
}

/// A picture of 5 × 3 pixels, whose rows are along x: the letter L.
#[test]
fn pictures_with_x_fastest_are_turned_to_masks_with_the_last_axis_fastest() {
    let picture = ["#....", "#....", "###.."];
    let pixels: Vec<bool> = picture.iter().flat_map(|row| row.chars().map(|c| c == '#')).collect();
    let grid = Grid { first: [0.0; 3], spacing: [1.0; 3], size: [5, 3, 1] };
    let mask = Mask::from_x_fastest(grid, &pixels).unwrap();
    let expected = [true, true, true, false, false, true, false, false, true];
    assert_eq!((&mask.inside[..9], mask.count()), (&expected[..], 5));
    assert_eq!(mask.x_fastest().collect::<Vec<bool>>(), pixels);
    // The same cells as runs, and as an outline in the order x, y.
    let runs = MaskInput {
        size: vec![5, 3],
        spacing: vec![1.0; 2],
        first: vec![0.0; 2],
        runs: vec![0, 3, 2, 1, 2, 1, 6],
    };
    assert_eq!(runs.mask(MANY).unwrap(), mask);
    let outline = vec![[-0.5, -0.5], [0.5, -0.5], [0.5, 1.5], [2.5, 1.5], [2.5, 2.5], [-0.5, 2.5]];
    assert_eq!(from_contours(&[outline], &grid), mask);
    assert_eq!(Mask::from_x_fastest(grid, &pixels[1..]), None);
    let volume = Grid { size: [2, 3, 4], ..grid };
    let cells: Vec<bool> = (0..24).map(|at| at % 2 == 1 && at / 2 % 3 == 2 && at / 6 == 3).collect();
    let last = Mask::from_x_fastest(volume, &cells).unwrap();
    assert_eq!(last.inside.iter().position(|inside| *inside), Some(23));
    let cells: Vec<bool> = (0..24).map(|at| at == 1).collect();
    let second = Mask::from_x_fastest(volume, &cells).unwrap();
    assert_eq!(second.inside.iter().position(|inside| *inside), Some(12));
}

/// One direction has larger distances than the other: 19 of 20 columns agree, and one cell of the second mask is far away. The 95th
/// percentile is the larger one of the two directions, with the spacing of each axis.
#[test]
fn the_percentile_is_the_larger_one_of_both_directions() {
    let grid = Grid { first: [0.0; 3], spacing: [2.0, 0.5, 1.0], size: [40, 9, 1] };
    let mask = |inside: &dyn Fn(usize, usize) -> bool| Mask {
        grid,
        inside: (0..360).map(|at| inside(at / 9, at % 9)).collect(),
    };
    let long = mask(&|_, j| j == 4);
    let short = mask(&|i, j| j == 4 && i < 20);
    let found = overlap(&long, &short);
    // From the short line all distances are 0; from the long one they are 0 twenty times, then 2, 4, … 40: position 0.95 · 39 is
    // 37.05, between 36 and 38.
    assert_eq!((found.hausdorff, found.jaccard), (Some(40.0), 0.5));
    let percentile = found.hausdorff_95.unwrap();
    assert!((percentile - (36.0 + 0.05 * 2.0)).abs() < 1e-12, "{percentile}");
    assert_eq!(overlap(&short, &long).hausdorff_95, found.hausdorff_95);
    let shifted = overlap(&long, &mask(&|_, j| j == 7));
    assert_eq!((shifted.hausdorff, shifted.mean_surface_distance), (Some(1.5), Some(1.5)));
}
