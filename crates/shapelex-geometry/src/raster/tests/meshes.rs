//! Grids, and masks of meshes.

use std::f64::consts::PI;

use super::*;

#[test]
fn grids_have_the_middle_of_the_box_and_a_margin_of_one_cell() {
    let grid = Grid::around([[0.0, -1.0, 2.0], [1.0, 1.0, 2.5]], [0.25, 0.5, 1.0]);
    assert_eq!(grid.size, [6, 6, 3]);
    assert_eq!(grid.first, [-0.125, -1.25, 1.25]);
    assert_eq!((grid.count(), grid.cell_measure(), grid.is_planar()), (108, 0.125, false));
    for cells in 1..200 {
        let grid = Grid::with_cells([[0.1, 0.2], [0.8, 0.3]], cells);
        assert_eq!(grid.size[0], cells + 2);
        assert!(grid.is_planar() && (grid.cell_measure() * (cells * cells) as f64 - 0.49).abs() < 1e-12);
    }
    assert_eq!(Grid::with_cells([[3.0; 3]; 2], 50).size, [3; 3]);
    assert_eq!(Grid::around([[-1e100; 3], [1e100; 3]], [1e-100; 3]).count(), usize::MAX);
    assert_eq!(bounds([[1.0, 5.0], [2.0, -3.0]]), Some([[1.0, -3.0], [2.0, 5.0]]));
    assert_eq!(bounds::<3>([]), None);
}

#[test]
fn shifted_cubes_have_their_exact_jaccard_index_at_aligned_spacings() {
    for cells in [4, 8, 20] {
        let spacing = 1.0 / f64::from(cells);
        let grid = Grid::around([[0.0; 3], [1.25; 3]], [spacing; 3]);
        let a = from_mesh(&cuboid([0.0; 3], [1.0; 3], false), &grid);
        let b = from_mesh(&cuboid([0.25; 3], [1.25; 3], true), &grid);
        let found = overlap(&a, &b);
        let common = 0.75_f64.powi(3);
        assert!((found.jaccard - common / (2.0 - common)).abs() < 1e-15, "{found:?}");
        assert!((found.dice - common).abs() < 1e-15, "{found:?}");
        assert!((a.measure() - 1.0).abs() < 1e-12 && found.cells == [(cells as usize).pow(3); 2]);
        // The corner cells are the farthest.
        assert!((found.hausdorff.unwrap() - 0.25 * 3.0_f64.sqrt()).abs() < 1e-12, "{found:?}");
    }
}

/// Lens of two balls: π (4R + d)(2R − d)² / 12.
#[test]
fn spheres_have_nearly_the_jaccard_index_of_their_lens() {
    let (radius, distance) = (0.45, 0.2);
    let [a, b] = [[0.0; 3], [distance, 0.0, 0.0]].map(|centre| sphere(120, radius, centre));
    let ball = 4.0 / 3.0 * PI * radius.powi(3);
    let lens = PI * (4.0 * radius + distance) * (2.0 * radius - distance).powi(2) / 12.0;
    let exact = lens / (2.0 * ball - lens);
    for (cells, tolerance) in [(32_u32, 1e-3), (64, 5e-4)] {
        let spacing = 1.0 / f64::from(cells);
        // The centre of the first sphere is a corner of cells.
        let size = [cells as usize * 2; 3];
        let grid = Grid { first: [0.5 * spacing - 1.0; 3], spacing: [spacing; 3], size };
        let found = overlap(&from_mesh(&a, &grid), &from_mesh(&b, &grid));
        assert!((found.jaccard - exact).abs() < tolerance, "{} for {exact}", found.jaccard);
        assert!((found.hausdorff.unwrap() - distance).abs() < 2.0 * spacing, "{found:?}");
    }
}

/// The sum of the solid angles says where a mesh winds about a centre: a torus that does not cross itself, and one whose section is a
/// limaçon, whose inner loop is enclosed twice; both also turned inside out.
#[test]
fn cells_are_inside_where_the_winding_number_is_not_zero() {
    for (simple, loops) in [(1.0, 0.0), (0.0, 1.0)] {
        let mut wavy = torus(40, 24, |s, t| {
            let tube = 0.4 + 0.1 * (3.0 * s).sin() + 0.05 * (2.0 * t + s).cos();
            let tube = simple * tube + loops * (0.2 + 0.55 * t.cos());
            let ring = 1.0 + tube * t.cos();
            [ring * s.cos(), 0.8 * ring * s.sin() + 0.1, tube * t.sin() + 0.3 * (2.0 * s).cos()]
        });
        assert_eq!(wavy.connectivity().unwrap().genus(), 1);
        let grid = Grid { first: [-1.6, -1.31, -0.8], spacing: [0.161, 0.139, 0.0813], size: [20, 20, 20] };
        let mask = from_mesh(&wavy, &grid);
        let mut enclosed_twice = 0;
        for (at, &inside) in mask.inside.iter().enumerate() {
            let turns = winding(&wavy, centre(&grid, at)).abs();
            assert_eq!(inside, turns > 0.5, "{turns} at {:?}", centre(&grid, at));
            enclosed_twice += usize::from(turns > 1.5);
        }
        assert!(mask.count() > 500 && (enclosed_twice > 20) == (loops > 0.0), "{enclosed_twice}");
        wavy.faces.iter_mut().for_each(|face| face.swap(0, 1));
        assert_eq!(from_mesh(&wavy, &grid), mask);
    }
}

/// Boxes with corners, edges and sides on cell centres, cut differently.
#[test]
fn boxes_that_tile_share_out_the_centres() {
    let grid = Grid { first: [-1.0; 3], spacing: [0.5; 3], size: [9, 8, 7] };
    let boxes = [
        cuboid([0.0; 3], [1.0; 3], false),
        cuboid([1.0, 0.0, 0.0], [2.0, 1.0, 1.0], true),
        cuboid([0.0, 1.0, 0.0], [2.0, 1.5, 1.0], false),
        cuboid([0.0, 0.0, 1.0], [2.0, 1.5, 1.5], true),
    ];
    let masks = boxes.map(|cuboid| from_mesh(&cuboid, &grid));
    assert_eq!(masks.each_ref().map(Mask::count), [8, 8, 8, 12]);
    assert_eq!(overlap(&masks[0], &masks[1]).intersection, 0);
    let whole = from_mesh(&cuboid([0.0; 3], [2.0, 1.5, 1.5], false), &grid);
    for at in 0..grid.count() {
        let owners = masks.iter().filter(|mask| mask.inside[at]).count();
        assert_eq!(owners, usize::from(whole.inside[at]), "{:?}", centre(&grid, at));
    }
}

/// The six tetrahedra along the diagonal of a cube, straight and with moved corners.
#[test]
fn tetrahedra_that_tile_share_out_the_centres() {
    let mut state = 7;
    for trial in 0..20 {
        let shift: [[f64; 3]; 8] = std::array::from_fn(|_| [0; 3].map(|_| 0.3 * uniform(&mut state)));
        let scale = if trial == 0 { 0.0 } else { 1.0 };
        let mut solid = cuboid([0.0; 3], [1.0; 3], false);
        let moved = |(vertex, shift): ([f64; 3], [f64; 3])| [0, 1, 2].map(|c| vertex[c] + scale * shift[c]);
        solid.vertices = solid.vertices.iter().copied().zip(shift).map(moved).collect();
        let orders = [[1, 2, 4], [1, 4, 2], [2, 1, 4], [2, 4, 1], [4, 1, 2], [4, 2, 1]];
        let grid = Grid { first: [-0.25; 3], spacing: [0.125; 3], size: [14; 3] };
        let masks = orders.map(|[first, second, _]| {
            let [a, b, c, d] = [0, first, first + second, 7];
            let faces = vec![[a, b, c], [d, b, a], [a, c, d], [c, b, d]];
            from_mesh(&mesh(solid.vertices.clone(), faces), &grid)
        });
        // Hull faces that match the tetrahedra: the diagonals from the smallest to the largest corner, seen from outside.
        let outward = |x: u32, y: u32| [[0, x + y, x], [7, x, x + y]];
        let sides = |[x, y, _]: &[u32; 3]| match [[1, 2], [2, 4], [4, 1]].contains(&[*x, *y]) {
            true => outward(*x, *y),
            false => outward(*x, *y).map(|[a, b, c]| [a, c, b]),
        };
        let hull = orders.iter().flat_map(sides).collect();
        let whole = from_mesh(&mesh(solid.vertices, hull), &grid);
        assert!(trial > 0 || whole.count() == 512);
        for at in 0..grid.count() {
            let owners = masks.iter().filter(|mask| mask.inside[at]).count();
            assert_eq!(owners, usize::from(whole.inside[at]), "{:?} of trial {trial}", centre(&grid, at));
        }
    }
}

#[test]
fn what_is_enclosed_twice_is_inside() {
    let [mut twice, other] = [[0.0; 3], [0.5; 3]].map(|lower| cuboid(lower, lower.map(|x| x + 1.0), false));
    twice.faces.extend(other.faces.iter().map(|face| face.map(|vertex| vertex + 8)));
    twice.vertices.extend(other.vertices);
    let grid = Grid::around([[0.0; 3], [1.5; 3]], [0.25; 3]);
    assert_eq!(from_mesh(&twice, &grid).count(), 2 * 64 - 8);
}

#[test]
fn huge_coordinates_and_tiny_spacings_do_no_harm() {
    let grid = Grid { first: [0.1; 3], spacing: [1e-90, 1e-9, 0.25], size: [4, 5, 6] };
    let huge = from_mesh(&cuboid([-1e100; 3], [1e100; 3], false), &grid);
    assert_eq!(huge.count(), grid.count());
    assert_eq!(from_mesh(&cuboid([-1e100; 3], [-9e99; 3], true), &grid).count(), 0);
    assert_eq!(from_mesh(&cuboid([9e99; 3], [1e100; 3], true), &grid).count(), 0);
    assert_eq!(overlap(&huge, &huge).hausdorff, Some(0.0));
    let one = |at: usize| Mask { grid, inside: (0..grid.count()).map(|i| i == at).collect() };
    let far = overlap(&one(0), &one(grid.count() - 1)).hausdorff.unwrap();
    assert!((far - 1.25).abs() < 1e-12, "{far}");
    let nowhere = mesh(vec![[f64::NAN; 3], [f64::INFINITY; 3], [0.0; 3]], vec![[0, 1, 2], [2, 1, 0]]);
    assert_eq!(from_mesh(&nowhere, &grid).inside.len(), grid.count());
    let none = Grid { size: [0, 3, 0], ..grid };
    assert_eq!(from_mesh(&cuboid([0.0; 3], [1.0; 3], false), &none).count(), 0);
}
