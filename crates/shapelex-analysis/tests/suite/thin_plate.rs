//! Thin-plate splines: the vectors of `elastic/tps.json`, whose landmarks are copyleft and are read beside the project; laws.

use std::path::Path;

use serde_json::Value;
use shapelex_analysis::thin_plate::error::ThinPlateError;
use shapelex_analysis::thin_plate::lattice::Lattice;
use shapelex_analysis::thin_plate::{ThinPlate, superimposed};
use shapelex_numeric::dense::Matrix;

fn matrix(value: &Value) -> Matrix {
    let rows: Vec<Vec<f64>> = serde_json::from_value(value.clone()).unwrap();
    Matrix::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
}

#[track_caller]
fn near(found: &Matrix, wanted: &Matrix, tolerance: f64, what: &str) {
    assert_eq!(found.shape(), wanted.shape(), "{what}");
    let error = (found - wanted).amax() / wanted.amax();
    assert!(error < tolerance, "{what}: {error:e} of {tolerance:e}");
}

/// Landmarks in the plane or in space without a pattern.
fn marks(count: usize, dimension: usize, shift: f64) -> Matrix {
    Matrix::from_fn(count, dimension, |i, c| {
        let k = (7 * i * i + 13 * i * c + 5 * c + 3) as f64;
        10.0 * k.sin() + shift * (2.0 * k).cos() + 40.0
    })
}

#[test]
fn warps_are_those_of_the_vectors() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/math/vectors/elastic/tps.json");
    let Ok(text) = std::fs::read(path) else {
        println!("SKIPPED: vectors/elastic/tps.json is not beside the project");
        return;
    };
    let vectors: Value = serde_json::from_slice(&text).unwrap();
    for case in vectors["cases"].as_array().unwrap() {
        let plate = ThinPlate::new(&matrix(&case["reference_points"]), 0.0).unwrap();
        let target = matrix(&case["target_points"]);
        let warp = plate.warp(&target);
        near(&warp.warped(&matrix(&case["probes"])), &matrix(&case["warped"]), 1e-9, "warped");
        near(&warp.affine(), &matrix(&case["affine"]), 1e-9, "affine");
        let energy = case["bending_energy"].as_f64().unwrap();
        assert!((warp.bending_energy() - energy).abs() < 1e-9 * energy, "{}", warp.bending_energy());
        let wanted: Vec<f64> = serde_json::from_value(case["bending_eigenvalues"].clone()).unwrap();
        let partial = plate.partial_warps();
        let column = |values: &[f64]| Matrix::from_vec(values.len(), 1, values.to_vec());
        near(&column(&partial.eigenvalues), &column(&wanted), 1e-9, "eigenvalues");
        let scores = partial.warps.transpose() * &target;
        let sum: f64 =
            scores.row_iter().zip(&partial.eigenvalues).map(|(row, value)| value * row.norm_squared()).sum();
        assert!((sum - energy).abs() < 1e-9 * energy, "partial warps {sum} of {energy}");
    }
}

#[test]
fn bending_energy_is_none_of_affine_maps_and_that_of_its_matrix() {
    for d in [2, 3] {
        let (reference, target) = (marks(9, d, 0.0), marks(9, d, 2.0));
        let plate = ThinPlate::new(&reference, 0.0).unwrap();
        let bending = plate.bending_matrix();
        let warp = plate.warp(&target);
        let energy = (target.transpose() * &bending * &target).trace();
        assert!((energy - warp.bending_energy()).abs() < 1e-10 * energy, "{energy}");
        let affine = Matrix::from_fn(d, d, |i, j| 1.0 + (i * 2 + j) as f64 * 0.3);
        let sheared = &reference * affine;
        assert!((&bending * &sheared).amax() < 1e-10 * bending.amax() * sheared.amax());
        assert!(plate.warp(&sheared).bending_energy() < 1e-12 * energy);
        near(&warp.warped(&reference), &target, 1e-12, "targets are met");
        // Smoother maps bend less, and miss.
        let smooth = ThinPlate::new(&reference, 0.1).unwrap();
        let smooth = smooth.warp(&target);
        assert!(smooth.bending_energy() < warp.bending_energy());
        assert!((smooth.warped(&reference) - &target).amax() > 1e-3);
    }
}

#[test]
fn determinants_are_those_of_differences() {
    for d in [2, 3] {
        let plate = ThinPlate::new(&marks(8, d, 0.0), 0.0).unwrap();
        let target = marks(8, d, 1.5);
        let warp = plate.warp(&target);
        for k in 0..5 {
            let place: Vec<f64> = (0..d).map(|c| 38.0 + 1.7 * (k + 2 * c) as f64).collect();
            let step = 1e-5;
            let jacobian = Matrix::from_fn(d, d, |c, e| {
                let at = |sign: f64| {
                    let mut moved = place.clone();
                    moved[e] += sign * step;
                    warp.at(&moved)[c]
                };
                (at(1.0) - at(-1.0)) / (2.0 * step)
            });
            let (found, wanted) = (warp.determinant(&place), jacobian.determinant());
            assert!((found - wanted).abs() < 1e-6 * (1.0 + wanted.abs()), "{found} {wanted}");
        }
    }
}

#[test]
fn landmarks_without_a_spline_are_refused() {
    let of = |rows: &[[f64; 2]]| {
        ThinPlate::new(&Matrix::from_fn(rows.len(), 2, |i, c| rows[i][c]), 0.0).unwrap_err()
    };
    assert_eq!(of(&[[0.0, 0.0], [1.0, 0.0]]), ThinPlateError::TooFew { found: 2, needed: 3 });
    assert!(matches!(
        of(&[[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [5.0, 5.0]]),
        ThinPlateError::Flat { dimension: 2, .. }
    ));
    let twins = of(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 0.0]]);
    assert_eq!(twins, ThinPlateError::Coincident { first: 1, second: 3 });
    assert!(matches!(of(&[[1.0, 1.0]; 4]), ThinPlateError::Flat { .. }));
    // An affine map needs no more than three.
    let three = Matrix::from_row_slice(3, 2, &[0.0, 0.0, 4.0, 0.0, 0.0, 3.0]);
    let plate = ThinPlate::new(&three, 0.0).unwrap();
    let target = Matrix::from_row_slice(3, 2, &[1.0, 1.0, 5.0, 2.0, 1.0, 4.0]);
    let warp = plate.warp(&target);
    assert_eq!(warp.bending_energy(), 0.0);
    near(&warp.warped(&three), &target, 1e-14, "three landmarks");
    assert!(plate.partial_warps().eigenvalues.is_empty());
}

#[test]
fn a_lattice_surrounds_its_points() {
    let points = Matrix::from_row_slice(3, 2, &[0.0, 0.0, 10.0, 0.0, 0.0, 4.0]);
    let lattice = Lattice::around(&points, 12, 0.1);
    assert_eq!((lattice.size.as_slice(), lattice.spacing), (&[13, 6][..], 1.0));
    let nodes = lattice.nodes();
    assert_eq!((nodes[(0, 0)], nodes[(77, 0)]), (-1.0, 11.0));
    assert!((nodes[(0, 1)] + 0.5).abs() < 1e-12 && (nodes[(77, 1)] - 4.5).abs() < 1e-12);
    assert_eq!(lattice.outside(&points), 0);
    assert_eq!(lattice.outside(&Matrix::from_row_slice(2, 2, &[12.0, 0.0, 5.0, 5.0])), 2);
    assert_eq!(lattice.lines([0, 1], &[0.0, 0.0], 2).iter().map(Matrix::nrows).max(), Some(25));
}

#[test]
fn superimposed_points_lie_on_their_reference() {
    for d in [2, 3] {
        let reference = marks(6, d, 0.0);
        let turn = match d {
            2 => Matrix::from_row_slice(2, 2, &[0.6, 0.8, -0.8, 0.6]),
            _ => Matrix::from_row_slice(3, 3, &[0.6, 0.8, 0.0, -0.8, 0.6, 0.0, 0.0, 0.0, 1.0]),
        };
        let moved = (&reference * turn * 3.0).add_scalar(7.0);
        near(&superimposed(&moved, &reference), &reference, 1e-12, "superimposed");
    }
}
