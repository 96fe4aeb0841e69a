//! Shapes and numbers for the tests of the scheme.

use super::{Oriented, direction};
use crate::mesh::TriangleMesh;
use crate::vector::{minus, norm, plus, scaled};

pub(super) const EX: [f64; 3] = [1.0, 0.0, 0.0];
pub(super) const EY: [f64; 3] = [0.0, 1.0, 0.0];
pub(super) const EZ: [f64; 3] = [0.0, 0.0, 1.0];

/// Deterministic numbers in `(−1, 1)`.
pub(super) struct Random(pub(super) u64);

impl Random {
    pub(super) fn number(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
    }

    pub(super) fn vector(&mut self) -> [f64; 3] {
        [self.number(), self.number(), self.number()]
    }

    pub(super) fn unit(&mut self) -> [f64; 3] {
        unit(self.vector())
    }
}

pub(super) fn unit(v: [f64; 3]) -> [f64; 3] {
    direction(v, 0.0).unwrap()
}

pub(super) fn negated(v: [f64; 3]) -> [f64; 3] {
    v.map(|x| -x)
}

/// Unit vector in the plane at an angle to the `x` axis.
pub(super) fn at_angle(angle: f64) -> [f64; 3] {
    [angle.cos(), angle.sin(), 0.0]
}

pub(super) fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    norm(minus(a, b))
}

pub(super) fn close(found: [f64; 3], wanted: [f64; 3], tolerance: f64) {
    assert!(distance(found, wanted) <= tolerance, "{found:?}, wanted {wanted:?} to {tolerance:e}");
}

/// Largest distances of points from the unit sphere, and of normals from the radial ones.
pub(super) fn off_sphere(shape: &Oriented) -> (f64, f64) {
    let position = shape.points.iter().map(|p| (norm(*p) - 1.0).abs()).fold(0.0, f64::max);
    let pairs = shape.points.iter().zip(&shape.normals);
    (position, pairs.map(|(p, n)| distance(unit(*p), *n)).fold(0.0, f64::max))
}

/// Points of the unit sphere with radial normals.
pub(super) fn radial(points: Vec<[f64; 3]>) -> Oriented {
    Oriented::new(points.clone(), &points).unwrap()
}

pub(super) fn octahedron() -> TriangleMesh {
    let faces = vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    let vertices = vec![EX, negated(EX), EY, negated(EY), EZ, negated(EZ)];
    TriangleMesh { vertices, normals: None, faces }
}

/// A perturbed octahedron with normals that are not quite radial.
pub(super) fn irregular(random: &mut Random) -> Oriented {
    let vary = |p: [f64; 3], random: &mut Random| plus(p, scaled(0.3, random.vector()));
    let points: Vec<[f64; 3]> = octahedron().vertices.iter().map(|p| vary(*p, random)).collect();
    let normals: Vec<[f64; 3]> = points.iter().map(|p| vary(*p, random)).collect();
    Oriented::new(points, &normals).unwrap()
}
