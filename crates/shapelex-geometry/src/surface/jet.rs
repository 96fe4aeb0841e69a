//! Jets of a surface: value, derivatives, normal and curvatures at a point.
//!
//! ```text
//! n = ± σ_u × σ_v / |…|, outwards     E, F, G = ⟨σ_u, σ_u⟩, ⟨σ_u, σ_v⟩, ⟨σ_v, σ_v⟩     L, M, N = ⟨n, σ_uu⟩, ⟨n, σ_uv⟩, ⟨n, σ_vv⟩
//! K = (LN − M²)/(EG − F²)     H = (EN − 2FM + GL)/(2(EG − F²))     κ₁,₂ = H ± √(H² − K)
//! ```

use super::{Surface, Topology, combine};
use crate::knot_line::Line;
use crate::vector::{cross, dot, norm};

/// Orders of the evaluated derivatives along `u` and `v`.
pub const ORDERS: [[usize; 2]; 6] = [[0, 0], [1, 0], [0, 1], [2, 0], [1, 1], [0, 2]];

/// Value and derivatives at one point, in the order of [`ORDERS`].
pub type Jet = [[f64; 3]; 6];

/// Normal and curvatures at one point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceFrame {
    /// Outward unit normal; `None` where the surface is pinched or folded, and at sharp poles.
    pub normal: Option<[f64; 3]>,
    /// Principal curvatures `κ₁ ≥ κ₂` in 1/length, negative where the surface bends away from the normal, as a sphere does
    /// everywhere. `None` without a normal, and at the poles of a sphere, where second derivatives have no limit.
    pub curvatures: Option<[f64; 2]>,
}

/// Ratio of `|σ_u × σ_v|` to `|σ_u|·|σ_v|` below which the tangent plane is undetermined.
const NO_PLANE: f64 = 1e-10;

/// The basis functions of one direction at some parameters.
struct Samples {
    /// For every parameter, the first control point and the weights of every derivative up to the second.
    places: Vec<(usize, [Vec<f64>; 3])>,
}

impl Samples {
    fn new(line: &Line, parameters: &[f64]) -> Self {
        let place = |&u: &f64| {
            let (half, s) = line.locate(u);
            let of = |derivative| line.weights(half, s, derivative).1.collect();
            (line.weights(half, s, 0).0, [of(0), of(1), of(2)])
        };
        Self { places: parameters.iter().map(place).collect() }
    }
}

impl Surface {
    /// Jets on a grid of parameters, `[u][v]`, which are reduced modulo 1 along closed directions (`u ∈ [0, 1)` if twisted) and
    /// clamped to `[0, 1]` along open ones; right limits where derivatives jump. Cost per point: the supports of both generators.
    pub fn jets(&self, u: &[f64], v: &[f64]) -> Vec<Jet> {
        let (along_u, along_v) = (Samples::new(&self.lines[0], u), Samples::new(&self.lines[1], v));
        let mut jets = Vec::with_capacity(u.len() * v.len());
        for (first, weights) in &along_u.places {
            let row = |derivative: usize| self.combine_rows(*first, &weights[derivative], 0..self.size[1]);
            let rows = [row(0), row(1), row(2)];
            jets.extend(along_v.places.iter().map(|place| jet(&rows, place)));
        }
        jets
    }

    /// Points on a grid of parameters, `[u][v]`.
    pub fn points(&self, u: &[f64], v: &[f64]) -> Vec<[f64; 3]> {
        let (along_u, along_v) = (Samples::new(&self.lines[0], u), Samples::new(&self.lines[1], v));
        let mut points = Vec::with_capacity(u.len() * v.len());
        for (first, weights) in &along_u.places {
            let row = self.combine_rows(*first, &weights[0], 0..self.size[1]);
            points.extend(along_v.places.iter().map(|(first, weights)| combine(&row[*first..], &weights[0])));
        }
        points
    }

    /// The point at `(u, v)`, as [`Self::points`] has it.
    pub fn point(&self, u: f64, v: f64) -> [f64; 3] {
        let [(first, along_u), (column, along_v)] = [(0, u), (1, v)].map(|(i, parameter)| {
            let (half, s) = self.lines[i].locate(parameter);
            let (first, weights) = self.lines[i].weights(half, s, 0);
            (first, weights.collect::<Vec<f64>>())
        });
        let mut point = [0.0; 3];
        for (k, a) in along_u.iter().enumerate() {
            let row = combine(&self.control_points[(first + k) * self.size[1] + column..], &along_v);
            (0..3).for_each(|c| point[c] += a * row[c]);
        }
        point
    }

    /// Value and first derivatives along `u` and `v` at one point.
    pub(crate) fn first_jet(&self, u: f64, v: f64) -> [[f64; 3]; 3] {
        let [along_u, along_v] = [(0, u), (1, v)].map(|(i, parameter)| {
            let (half, s) = self.lines[i].locate(parameter);
            let (first, weights) = self.lines[i].weights(half, s, 0);
            let slopes = self.lines[i].weights(half, s, 1).1;
            (first, weights.zip(slopes).collect::<Vec<(f64, f64)>>())
        });
        let mut jet = [[0.0; 3]; 3];
        for (k, (weight, slope)) in along_u.1.iter().enumerate() {
            let row = &self.control_points[(along_u.0 + k) * self.size[1] + along_v.0..];
            let (mut value, mut by_v) = ([0.0; 3], [0.0; 3]);
            for (point, (weight, slope)) in row.iter().zip(&along_v.1) {
                for c in 0..3 {
                    value[c] += weight * point[c];
                    by_v[c] += slope * point[c];
                }
            }
            for c in 0..3 {
                jet[0][c] += weight * value[c];
                jet[1][c] += slope * value[c];
                jet[2][c] += weight * by_v[c];
            }
        }
        jet
    }

    /// The jet at one point.
    pub fn jet(&self, u: f64, v: f64) -> Jet {
        self.jets(&[u], &[v])[0]
    }

    /// Equally spaced parameters along a direction: `i/count` if closed, `i/(count − 1)` if open.
    pub fn parameters(&self, direction: usize, count: usize) -> Vec<f64> {
        let steps = if self.topology.closed()[direction] { count } else { count.saturating_sub(1).max(1) };
        (0..count).map(|i| i as f64 / steps as f64).collect()
    }

    /// Normal and curvatures from the jet at `(u, v)`.
    pub fn frame(&self, v: f64, jet: &Jet) -> SurfaceFrame {
        let [_, du, dv, duu, duv, dvv] = *jet;
        // At a pole, σ_u vanishes like σ_uv times the distance to the pole.
        if self.topology == Topology::SharpSphere && !(v > 0.0 && v < 1.0) {
            return SurfaceFrame { normal: None, curvatures: None };
        }
        let pole = match self.topology {
            Topology::Sphere if v <= 0.0 => Some(duv),
            Topology::Sphere if v >= 1.0 => Some(duv.map(|value| -value)),
            _ => None,
        };
        let across = pole.unwrap_or(du);
        let area = cross(across, dv);
        let length = norm(area);
        if !(length > NO_PLANE * norm(across) * norm(dv)) {
            return SurfaceFrame { normal: None, curvatures: None };
        }
        let normal = area.map(|value| self.topology.orientation() * value / length);
        let curvatures = pole.is_none().then(|| {
            let (e, f, g) = (dot(du, du), dot(du, dv), dot(dv, dv));
            let (l, m, n) = (dot(normal, duu), dot(normal, duv), dot(normal, dvv));
            let mean = 0.5 * (e * n - 2.0 * f * m + g * l) / length / length;
            let gauss = (l * n - m * m) / length / length;
            let spread = (mean * mean - gauss).max(0.0).sqrt();
            [mean + spread, mean - spread]
        });
        SurfaceFrame { normal: Some(normal), curvatures }
    }
}

fn jet(rows: &[Vec<[f64; 3]>; 3], (first, weights): &(usize, [Vec<f64>; 3])) -> Jet {
    ORDERS.map(|[du, dv]| combine(&rows[du][*first..], &weights[dv]))
}
