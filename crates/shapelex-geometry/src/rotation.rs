//! Rotations of space.

use crate::vector::{cross, dot, norm};

/// A rotation by a unit quaternion, real part first.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rotation(pub [f64; 4]);

impl Rotation {
    /// No rotation.
    pub const NONE: Self = Self([1.0, 0.0, 0.0, 0.0]);

    /// The rotation about `vector` by its length in radians.
    pub fn about(vector: [f64; 3]) -> Self {
        let angle = norm(vector);
        if !(angle > 0.0) {
            return Self::NONE;
        }
        let (sine, cosine) = (0.5 * angle).sin_cos();
        Self([cosine, sine * vector[0] / angle, sine * vector[1] / angle, sine * vector[2] / angle])
    }

    /// The rotation that takes the coordinate axes to the right-handed frame of these unit vectors.
    pub fn onto(frame: [[f64; 3]; 3]) -> Self {
        let m = |row: usize, column: usize| frame[column][row];
        let squares = [
            1.0 + m(0, 0) + m(1, 1) + m(2, 2),
            1.0 + m(0, 0) - m(1, 1) - m(2, 2),
            1.0 - m(0, 0) + m(1, 1) - m(2, 2),
            1.0 - m(0, 0) - m(1, 1) + m(2, 2),
        ];
        let largest = (1..4).fold(0, |best, i| if squares[i] > squares[best] { i } else { best });
        let square = squares[largest];
        let (a, b, c) = (m(2, 1) - m(1, 2), m(0, 2) - m(2, 0), m(1, 0) - m(0, 1));
        let (d, e, f) = (m(0, 1) + m(1, 0), m(0, 2) + m(2, 0), m(1, 2) + m(2, 1));
        let q = match largest {
            0 => [square, a, b, c],
            1 => [a, square, d, e],
            2 => [b, d, square, f],
            _ => [c, e, f, square],
        };
        let length = q.iter().map(|part| part * part).sum::<f64>().sqrt();
        Self(q.map(|part| part / length))
    }

    /// First `first`, then this rotation.
    #[must_use]
    pub fn after(self, first: Self) -> Self {
        let (p, q) = (self.0, first.0);
        let [pv, qv] = [[p[1], p[2], p[3]], [q[1], q[2], q[3]]];
        let across = cross(pv, qv);
        let vector = [0, 1, 2].map(|i| p[0] * qv[i] + q[0] * pv[i] + across[i]);
        let product = [p[0] * q[0] - dot(pv, qv), vector[0], vector[1], vector[2]];
        let length = product.iter().map(|part| part * part).sum::<f64>().sqrt();
        Self(product.map(|part| part / length))
    }

    /// The rotation back.
    #[must_use]
    pub fn inverse(self) -> Self {
        let [w, x, y, z] = self.0;
        Self([w, -x, -y, -z])
    }

    /// `R p`.
    pub fn apply(self, p: [f64; 3]) -> [f64; 3] {
        let [w, x, y, z] = self.0;
        let v = [x, y, z];
        let once = cross(v, p);
        let twice = cross(v, once);
        [0, 1, 2].map(|i| p[i] + 2.0 * (w * once[i] + twice[i]))
    }
}
