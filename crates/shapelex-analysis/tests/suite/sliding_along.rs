//! Points that slide along curves.

use std::f64::consts::TAU;
use std::path::Path;

use serde_json::Value;
use shapelex_analysis::matching::Placement;
use shapelex_analysis::sliding::SlidingCriterion;
use shapelex_analysis::sliding::along::{BOUNDS, SlidCurves, slide_along};
use shapelex_analysis::sliding::error::SlidingError;
use shapelex_analysis::watch::{Unwatched, Watch};
use shapelex_geometry::arc_parameter::ArcParameter;
use shapelex_geometry::curve::Curve;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_geometry::resample::Contour;
use shapelex_numeric::dense::Matrix;

const STEPS: usize = 50;

fn space(closed: bool, dimension: usize, count: usize) -> ShapeSpace {
    let generator = GeneratorKind::Bspline { degree: 3 };
    let representation = if closed {
        Representation::ClosedCurve { dimension, control_points: count, generator }
    } else {
        Representation::OpenCurve { dimension, intervals: count, generator }
    };
    ShapeSpace::new(&representation).unwrap()
}

/// Curves with a lobe that wanders along them, turned and scaled.
fn curves(closed: bool, dimension: usize, count: usize) -> Vec<Curve> {
    let space = space(closed, dimension, 40);
    let size = space.representation().size();
    let place = |k: usize, i: usize, c: usize| {
        let part = k as f64 / count as f64 - 0.5;
        let (x, y) = if closed {
            let t = TAU * i as f64 / size as f64;
            let radius = 1.0
                + 0.35 * (-(8.0 * ((t - 2.0 - 0.5 * part) / 2.0).sin().powi(2))).exp()
                + 0.15 * (2.0 * t).cos();
            (1.5 * radius * t.cos(), radius * t.sin())
        } else {
            let t = 2.0 * i as f64 / size as f64;
            (2.0 * t, (3.0 * t).sin() * 0.4 + 0.8 * (-12.0 * (t - 1.0 - 0.2 * part).powi(2)).exp())
        };
        let (sin, cos) = (0.7 * k as f64).sin_cos();
        (1.0 + 0.1 * k as f64) * [cos * x - sin * y, sin * x + cos * y, 0.2 * (3.0 * x).cos()][c]
    };
    (0..count)
        .map(|k| Curve::of(&space, &Matrix::from_fn(size, dimension, |i, c| place(k, i, c))).unwrap())
        .collect()
}

fn slid(curves: &[Curve], criterion: SlidingCriterion) -> SlidCurves {
    let placements = vec![Placement::default(); curves.len()];
    slide_along(curves, &placements, (STEPS, criterion), &Unwatched).unwrap()
}

/// Sum over the curves of squared distances from their consensus at unit size, of their points at some places.
fn variance(curves: &[Curve], places: &[Vec<f64>]) -> f64 {
    let rows = |(curve, places): (&Curve, &Vec<f64>)| {
        let arc = ArcParameter::of(curve);
        let count = places.len() - usize::from(curve.is_closed());
        let at = |t: f64| if curve.is_closed() { t.rem_euclid(1.0) } else { t.clamp(0.0, 1.0) };
        let points: Vec<Vec<f64>> =
            places[..count].iter().map(|t| curve.evaluate(arc.at(at(*t)), 0)).collect();
        let mut rows = Matrix::from_fn(count, curve.dimension(), |i, c| points[i][c]);
        for mut column in rows.column_iter_mut() {
            let mean = column.mean();
            column.add_scalar_mut(-mean);
        }
        let size = rows.norm();
        rows / size
    };
    let shapes: Vec<Matrix> = curves.iter().zip(places).map(rows).collect();
    let mut consensus = shapes[0].clone();
    let mut turned = shapes.clone();
    for _ in 0..50 {
        for (turned, shape) in turned.iter_mut().zip(&shapes) {
            let found = (shape.transpose() * &consensus).svd(true, true);
            *turned = shape * (found.u.unwrap() * found.v_t.unwrap());
        }
        let zero = Matrix::zeros(consensus.nrows(), consensus.ncols());
        consensus = turned.iter().fold(zero, |sum, one| sum + one);
        consensus /= consensus.norm();
    }
    turned.iter().map(|one| (one - &consensus).norm_squared()).sum()
}

/// Places at equal lengths, for each curve.
fn equal(count: usize) -> Vec<Vec<f64>> {
    vec![(0..=STEPS).map(|i| i as f64 / STEPS as f64).collect(); count]
}

#[test]
fn sliding_lowers_the_variance_and_keeps_order_mean_and_ends() {
    for (closed, dimension) in [(true, 2), (false, 2), (true, 3), (false, 3)] {
        let curves = curves(closed, dimension, 7);
        let found = slid(&curves, SlidingCriterion::Procrustes);
        assert!(found.converged, "{closed} {dimension}: {} rounds", found.rounds);
        let (before, after) = (variance(&curves, &equal(7)), variance(&curves, &found.places));
        assert!(after < 0.8 * before, "{closed} {dimension}: {before} {after}");
        for places in &found.places {
            let mut steps = places.windows(2).map(|two| (two[1] - two[0]) * STEPS as f64);
            assert!(steps.all(|step| step > BOUNDS[0] - 1e-9 && step < BOUNDS[1] + 1e-9));
            assert!((places[STEPS] - places[0] - 1.0).abs() < 1e-12);
            assert!(closed || places[0] == 0.0);
        }
        if found.bounded == 0 {
            for j in 0..=STEPS {
                let mean = found.places.iter().map(|places| places[j]).sum::<f64>() / 7.0;
                assert!((mean - j as f64 / STEPS as f64).abs() < 1e-7, "{mean} {j}");
            }
        }
    }
}

#[test]
fn the_order_of_curves_and_threads_do_not_matter_and_backwards_curves_are_followed() {
    let curves = curves(true, 2, 6);
    let found = slid(&curves, SlidingCriterion::Procrustes);
    let backwards: Vec<Curve> = curves.iter().rev().cloned().collect();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let other = pool.install(|| slid(&backwards, SlidingCriterion::Procrustes));
    assert!(found.places.iter().eq(other.places.iter().rev()));
    // The same curve traversed backwards, whose given first point is its row 7: reversed it begins at row 40 − 7.
    let space = space(true, 2, 40);
    let points = curves[2].sample(40);
    let matrix = space.interpolate(Matrix::from_fn(40, 2, |i, c| points[(40 + 7 - i) % 40][c])).unwrap();
    let mut mixed = curves.clone();
    mixed[2] = Curve::of(&space, &matrix).unwrap();
    let mut placements = vec![Placement::default(); 6];
    placements[2] = Placement { shift: 40 - 7, reversed: true, mirrored: false };
    let how = (STEPS, SlidingCriterion::Procrustes);
    let turned = slide_along(&mixed, &placements, how, &Unwatched).unwrap();
    assert!(turned.places[2][1] < turned.places[2][0]);
    let (arc, own) = (ArcParameter::of(&mixed[2]), ArcParameter::of(&curves[2]));
    for (a, b) in turned.places[2].iter().zip(&found.places[2]) {
        let a = mixed[2].evaluate(arc.at(a.rem_euclid(1.0)), 0);
        let b = curves[2].evaluate(own.at(b.rem_euclid(1.0)), 0);
        assert!((a[0] - b[0]).abs() + (a[1] - b[1]).abs() < 1e-5, "{a:?} {b:?}");
    }
}

struct Stopped;

impl Watch for Stopped {
    fn stop(&self) -> bool {
        true
    }
}

#[test]
fn what_cannot_slide_is_refused() {
    let mut all = curves(true, 2, 3);
    let placements = vec![Placement::default(); 3];
    let how = (STEPS, SlidingCriterion::Procrustes);
    assert_eq!(slide_along(&all, &placements, how, &Stopped).unwrap_err(), SlidingError::Cancelled);
    all[1] = Curve::of(&space(true, 2, 40), &Matrix::from_element(40, 2, 1.0)).unwrap();
    let error = slide_along(&all, &placements, how, &Unwatched).unwrap_err();
    assert!(matches!(
        error,
        SlidingError::NoDirection { shape: 1, .. } | SlidingError::NoExtent { shape: 1 }
    ));
}

#[test]
fn hearts_become_compact() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data/curves-hearts/curves.ndjson");
    let Ok(text) = std::fs::read_to_string(path) else {
        println!("SKIPPED: curves-hearts is not beside the project");
        return;
    };
    let space = space(true, 2, 60);
    let curve = |line: &str| {
        let value: Value = serde_json::from_str(line).unwrap();
        let rows: Vec<Vec<f64>> = serde_json::from_value(value["points"].clone()).unwrap();
        let points = Matrix::from_fn(rows.len(), 2, |i, c| rows[i][c]);
        let contour = Contour::closed(points).unwrap();
        Curve::of(&space, &space.interpolate(contour.sample(60, 0.0)).unwrap()).unwrap()
    };
    let curves: Vec<Curve> = text.lines().take(40).map(curve).collect();
    let found = slid(&curves, SlidingCriterion::Procrustes);
    let (before, after) = (variance(&curves, &equal(curves.len())), variance(&curves, &found.places));
    assert!(after < 0.7 * before, "{before} {after}: {} rounds, {} bounded", found.rounds, found.bounded);
}
