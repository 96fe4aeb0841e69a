//! Distances of surfaces.

use super::*;

/// All pairs of surface cells, in both directions.
fn brute_distances(a: &Mask, b: &Mask) -> [Vec<f64>; 2] {
    let surface = |mask: &Mask| -> Vec<[f64; 3]> {
        let [_, columns, length] = mask.grid.size;
        let cell = |at: usize| [at / length / columns, at / length % columns, at % length];
        (0..mask.grid.count())
            .filter(|at| mask.is_surface(cell(*at)))
            .map(|at| centre(&mask.grid, at))
            .collect()
    };
    let to_nearest = |from: &[[f64; 3]], to: &[[f64; 3]]| -> Vec<f64> {
        let nearest = |p: &[f64; 3]| to.iter().map(|q| norm(minus(*p, *q))).fold(f64::INFINITY, f64::min);
        from.iter().map(nearest).collect()
    };
    let (of_a, of_b) = (surface(a), surface(b));
    [to_nearest(&of_a, &of_b), to_nearest(&of_b, &of_a)]
}

#[test]
fn surface_distances_are_those_of_all_pairs() {
    let mut state = 11;
    for trial in 0..60 {
        let density = [0.02, 0.3, 0.9][trial % 3];
        let layers = if trial % 4 == 0 { 1 } else { 6 };
        let grid = Grid { first: [0.5, -1.0, 0.0], spacing: [0.7, 0.2, 1.9], size: [9, 12, layers] };
        let [a, b] = [0, 1].map(|_| Mask {
            grid,
            inside: (0..grid.count()).map(|_| uniform(&mut state) < density).collect(),
        });
        let found = overlap(&a, &b);
        if found.cells.contains(&0) {
            assert_eq!(found.hausdorff, None);
            continue;
        }
        let directed = brute_distances(&a, &b).map(|mut distances| {
            distances.sort_by(f64::total_cmp);
            distances
        });
        let mut expected = directed.concat();
        let mean = expected.iter().sum::<f64>() / expected.len() as f64;
        expected.sort_by(f64::total_cmp);
        let [percentile, other] = directed.map(|sorted| {
            let position = 0.95 * (sorted.len() - 1) as f64;
            let (below, above) = (sorted[position.floor() as usize], sorted[position.ceil() as usize]);
            below + (above - below) * position.fract()
        });
        let percentile = percentile.max(other);
        let close = |found: Option<f64>, expected: f64| (found.unwrap() - expected).abs() < 1e-12;
        assert!(close(found.hausdorff, expected[expected.len() - 1]), "{found:?} in trial {trial}");
        assert!(close(found.hausdorff_95, percentile), "{found:?} for {percentile} in trial {trial}");
        assert!(close(found.mean_surface_distance, mean), "{found:?} for {mean} in trial {trial}");
        assert_eq!(overlap(&b, &a).hausdorff, found.hausdorff);
    }
}

#[test]
fn shifted_boxes_are_their_shift_apart() {
    let grid = Grid { first: [0.0; 3], spacing: [0.5, 0.25, 2.0], size: [20, 30, 10] };
    let block = |[i, j, k]: [usize; 3]| {
        let holds = |at: usize| {
            let (x, y, z) = (at / 300, at / 10 % 30, at % 10);
            (i..i + 8).contains(&x) && (j..j + 10).contains(&y) && (k..k + 5).contains(&z)
        };
        Mask { grid, inside: (0..grid.count()).map(holds).collect() }
    };
    let found = overlap(&block([2, 3, 1]), &block([5, 3, 3]));
    // 3 cells of 0.5 and 2 of 2.
    assert!((found.hausdorff.unwrap() - 1.5_f64.hypot(4.0)).abs() < 1e-14, "{found:?}");
    assert_eq!((found.cells, found.intersection), ([400, 400], 5 * 10 * 3));
    assert!(found.hausdorff_95 <= found.hausdorff && found.mean_surface_distance < found.hausdorff_95);
    let same = overlap(&block([2, 3, 1]), &block([2, 3, 1]));
    assert_eq!((same.jaccard, same.dice, same.hausdorff_95), (1.0, 1.0, Some(0.0)));
}

#[test]
fn empty_masks_are_equal_and_have_no_surface() {
    let grid = Grid { first: [0.0; 3], spacing: [1.0; 3], size: [3; 3] };
    let [empty, full] = [false, true].map(|inside| Mask { grid, inside: vec![inside; 27] });
    let both = overlap(&empty, &empty);
    assert_eq!((both.jaccard, both.dice, both.union, both.hausdorff), (1.0, 1.0, 0, None));
    let one = overlap(&empty, &full);
    assert_eq!((one.jaccard, one.dice, one.cells, one.union), (0.0, 0.0, [0, 27], 27));
    assert_eq!((one.hausdorff, one.hausdorff_95, one.mean_surface_distance), (None, None, None));
}
