//! Spaces, random shapes and comparisons that several files of tests share.

use shapelex_geometry::GeometryError;
use shapelex_geometry::curve::Curve;
use shapelex_geometry::generator::{Family, GeneratorKind, PoleList};
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_numeric::dense::Matrix;

use crate::vectors::assert_close;

/// Closed curves of `control_points`.
pub(crate) fn closed(
    generator: &GeneratorKind,
    control_points: usize,
    dimension: usize,
) -> Result<ShapeSpace, GeometryError> {
    let generator = generator.clone();
    ShapeSpace::new(&Representation::ClosedCurve { dimension, control_points, generator })
}

/// Open curves of `intervals`.
pub(crate) fn open(
    generator: &GeneratorKind,
    intervals: usize,
    dimension: usize,
) -> Result<ShapeSpace, GeometryError> {
    let generator = generator.clone();
    ShapeSpace::new(&Representation::OpenCurve { dimension, intervals, generator })
}

/// The interpolator of `family` with the shortest support.
pub(crate) fn interpolator(family: Family, poles: PoleList) -> GeneratorKind {
    GeneratorKind::Interpolator { family, poles, support: None, weights: Vec::new() }
}

/// Deterministic pseudo-random numbers in [−1, 1].
pub(crate) struct Noise(pub(crate) u64);

impl Noise {
    pub(crate) fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 / (1u64 << 53) as f64) * 2.0 - 1.0
    }

    pub(crate) fn matrix(&mut self, rows: usize, columns: usize) -> Matrix {
        Matrix::from_fn(rows, columns, |_, _| self.next())
    }
}

/// A curve of `space` with random control points.
pub(crate) fn random_curve(space: &ShapeSpace, seed: u64) -> (Matrix, Curve) {
    let representation = space.representation();
    let points = Noise(seed).matrix(representation.size(), representation.dimension());
    let curve = Curve::of(space, &points).unwrap();
    (points, curve)
}

/// The curve at every parameter, point by point.
pub(crate) fn trace(curve: &Curve, parameters: &[f64]) -> Vec<f64> {
    parameters.iter().flat_map(|&u| curve.evaluate(u, 0)).collect()
}

/// `count + 1` parameters from 0 to 1.
pub(crate) fn grid(count: usize) -> Vec<f64> {
    (0..=count).map(|i| i as f64 / count as f64).collect()
}

/// `found` against `wanted`, relative to `wanted`.
#[track_caller]
pub(crate) fn assert_relative(what: &str, found: f64, wanted: f64, tolerance: f64) {
    assert_close(what, &[found / wanted.abs()], &[wanted.signum()], tolerance);
}
