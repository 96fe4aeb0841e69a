//! Masks of polygons.

use std::f64::consts::PI;

use super::*;

/// A star with a hole, compared with crossings on rays along the other axis.
#[test]
fn contours_are_filled_as_a_point_in_polygon_test_does() {
    let mut state = 3;
    let ring = |count: u32, radius: f64, state: &mut u64| -> Vec<[f64; 2]> {
        let point = |i: u32| {
            let (angle, r) = (2.0 * PI * f64::from(i) / f64::from(count), radius * (0.5 + uniform(state)));
            [2.0 * r * angle.cos(), r * angle.sin()]
        };
        (0..count).map(point).collect()
    };
    let mut polygons = [ring(41, 1.0, &mut state), ring(9, 0.3, &mut state)];
    // A hole, whose direction is opposite.
    polygons[1].reverse();
    let grid = Grid::with_cells(bounds(polygons.iter().flatten().copied()).unwrap(), 150);
    let mask = from_contours(&polygons, &grid);
    for at in 0..grid.count() {
        let [x, y, _] = centre(&grid, at);
        let crossed = |a: &[f64; 2], b: &[f64; 2]| {
            (a[1] > y) != (b[1] > y) && x < (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1]) + a[0]
        };
        let crossings = |polygon: &Vec<[f64; 2]>| {
            (0..polygon.len()).filter(|i| crossed(&polygon[*i], &polygon[(i + 1) % polygon.len()])).count()
        };
        assert_eq!(mask.inside[at], polygons.iter().map(crossings).sum::<usize>() % 2 == 1, "{x} {y}");
    }
    let area = |polygon: &Vec<[f64; 2]>| {
        let cross = |i: usize| {
            let (a, b) = (polygon[i], polygon[(i + 1) % polygon.len()]);
            0.5 * (a[0] * b[1] - a[1] * b[0])
        };
        (0..polygon.len()).map(cross).sum::<f64>()
    };
    let exact = area(&polygons[0]) + area(&polygons[1]);
    assert!((mask.measure() - exact).abs() < 0.01 * exact, "{} for {exact}", mask.measure());
    assert_eq!(from_contours(&[vec![], vec![[0.0; 2]]], &grid).count(), 0);
}

#[test]
fn squares_that_tile_share_out_the_centres() {
    let grid = Grid { first: [0.0; 3], spacing: [0.5, 0.25, 1.0], size: [6, 9, 1] };
    let square = |x: f64, y: f64| vec![vec![[x, y], [x + 1.0, y], [x + 1.0, y + 1.0], [x, y + 1.0]]];
    let masks = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)].map(|(x, y)| from_contours(&square(x, y), &grid));
    assert_eq!(masks.each_ref().map(Mask::count), [8; 3]);
    assert_eq!(overlap(&masks[0], &masks[1]).intersection, 0);
    assert_eq!(overlap(&masks[0], &masks[2]).intersection, 0);
    assert_eq!(masks[0].measure(), 1.0);
    // In the plane, the inner cells of a 2 × 4 block of pixels are on its border too; those of a 4 × 4 block are not.
    let block = Mask { grid, inside: (0..54).map(|at| at / 9 < 4 && at % 9 < 4).collect() };
    let border = (0..54).filter(|at| block.is_surface([at / 9, at % 9, 0])).count();
    assert_eq!(border, 12);
}

#[test]
fn contours_that_cross_themselves_are_filled_by_their_winding_number() {
    let grid = Grid { first: [0.5, 0.5, 0.0], spacing: [1.0; 3], size: [12, 10, 1] };
    let square =
        |[x, y]: [f64; 2], side: f64| vec![[x, y], [x + side, y], [x + side, y + side], [x, y + side]];
    let backwards = |mut polygon: Vec<[f64; 2]>| {
        polygon.reverse();
        polygon
    };
    let count = |polygons: &[Vec<[f64; 2]>]| from_contours(polygons, &grid).count();
    let outer = square([1.0, 1.0], 8.0);
    let inner = square([1.0, 1.0], 4.0);
    let once = from_contours(std::slice::from_ref(&outer), &grid);
    assert_eq!(once.count(), 64);
    // Walked twice, and twice with a part walked a third time, it is itself; there and back again it is nothing.
    assert_eq!(from_contours(&[[outer.clone(), outer.clone()].concat()], &grid), once);
    assert_eq!(from_contours(&[[outer.clone(), inner.clone()].concat()], &grid), once);
    assert_eq!(count(&[[outer.clone(), backwards(outer.clone())].concat()]), 0);
    // A part that is walked backwards cancels.
    let hollow = [outer.clone(), vec![[1.0, 1.0]], backwards(inner.clone())].concat();
    assert_eq!(count(&[hollow]), 64 - 16);
    // Both lobes of an eight count.
    assert_eq!(
        count(&[vec![
            [0.0, 0.0],
            [4.0, 0.0],
            [4.0, 4.0],
            [8.0, 4.0],
            [8.0, 8.0],
            [4.0, 8.0],
            [4.0, 4.0],
            [0.0, 4.0]
        ]]),
        32
    );
    // Outlines in one direction are united; a hole runs in the opposite one.
    assert_eq!(count(&[outer.clone(), inner.clone()]), 64);
    assert_eq!(count(&[square([1.0, 1.0], 4.0), square([3.0, 3.0], 4.0)]), 16 + 16 - 4);
    assert_eq!(count(&[outer.clone(), backwards(inner.clone())]), 64 - 16);
    assert_eq!(count(&[backwards(outer), inner]), 64 - 16);
}
