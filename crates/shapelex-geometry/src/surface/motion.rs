//! Motions of the parameters of a surface: rotations of the parameter sphere, shifts and reversals of closed directions.
//!
//! ```text
//! (T_γ σ)(k/M_u, l/M_v) = σ(γ(k/M_u, l/M_v))     the surface that interpolates σ∘γ at the knots, with its tangents at the poles
//! sphere: γ rotates the direction of (u, v)        cylinder: u + a, or (a − u, 1 − v)        torus: (u + a, v + b), or (a − u, b − v)
//! ```
//!
//! A motion does not change which points belong to a surface, but which points of two surfaces correspond. A moved surface is a
//! surface of the same space only nearly: [`Motions::change`] says how nearly.
//!
//! Source for the first-order ellipsoid as the canonical position: Brechbühler, Gerig and Kübler 1995.

use std::f64::consts::{PI, TAU};

use super::basis::{SurfaceBasis, Tangents};
use super::fit::{spherical_direction, spherical_parameters};
use super::{Surface, Topology};
use crate::rotation::Rotation;
use crate::vector::{cross, dot, minus, norm};
use shapelex_numeric::dense::{Matrix, svd};

/// Steps of a coordinate of a motion in a whole turn.
const STEPS: i32 = 1024;
/// Bits of a coordinate in a code.
const BITS: u32 = 10;

/// A motion of the parameters, in steps of 1/1024 turn: the rotation vector of a sphere; the shifts of a cylinder (`u`) and of a
/// torus (`u`, `v`), with half a turn as the third coordinate if both directions are reversed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Motion([i32; 3]);

/// The motions of the parameters of one space of surfaces.
#[derive(Debug, Clone)]
pub struct Motions {
    basis: SurfaceBasis,
    topology: Topology,
    /// Reversals of cylinders and tori are motions too.
    reverses: bool,
}

/// Unit quaternion, real part first.
type Quaternion = [f64; 4];

impl Motion {
    /// The motion with this [`Self::code`].
    pub fn from_code(code: u32) -> Self {
        let part = |i: u32| ((code >> (BITS * i)) as i32) << (32 - BITS) >> (32 - BITS);
        Self([part(0), part(1), part(2)])
    }

    /// A number below 2³⁰; 0 for no motion.
    pub fn code(self) -> u32 {
        let part = |i: usize| (self.0[i] as u32 & ((1 << BITS) - 1)) << (BITS * i as u32);
        part(0) | part(1) | part(2)
    }

    /// Its coordinates, in turns.
    pub fn turns(self) -> [f64; 3] {
        self.0.map(|part| f64::from(part) / f64::from(STEPS))
    }

    /// The nearest motion to coordinates in turns.
    fn nearest(turns: [f64; 3]) -> Self {
        let half = STEPS / 2;
        Self(turns.map(|turn| ((turn * f64::from(STEPS)).round() as i32 + half).rem_euclid(STEPS) - half))
    }

    fn quaternion(self) -> Quaternion {
        let w = self.turns().map(|turn| TAU * turn);
        let angle = norm(w);
        if angle == 0.0 {
            return [1.0, 0.0, 0.0, 0.0];
        }
        let (sine, cosine) = (0.5 * angle).sin_cos();
        [cosine, sine * w[0] / angle, sine * w[1] / angle, sine * w[2] / angle]
    }

    /// The nearest motion to a rotation.
    fn rotation([w, x, y, z]: Quaternion) -> Self {
        let sign = if w < 0.0 { -1.0 } else { 1.0 };
        let length = norm([x, y, z]);
        if length == 0.0 {
            return Self::default();
        }
        let turns = sign * 2.0 * length.atan2(sign * w) / (TAU * length);
        Self::nearest([x, y, z].map(|part| part * turns))
    }

    fn reversed(self) -> bool {
        self.0[2] != 0
    }
}

/// `p q`: first the rotation `q`, then `p`.
fn after(p: Quaternion, q: Quaternion) -> Quaternion {
    let [pv, qv] = [[p[1], p[2], p[3]], [q[1], q[2], q[3]]];
    let across = cross(pv, qv);
    let vector = [0, 1, 2].map(|i| p[0] * qv[i] + q[0] * pv[i] + across[i]);
    [p[0] * q[0] - dot(pv, qv), vector[0], vector[1], vector[2]]
}

/// The 60 rotations of the icosahedron: every rotation is within 45 degrees of one of them.
pub(crate) fn icosahedral() -> Vec<Quaternion> {
    let golden = (1.0 + 5.0_f64.sqrt()) / 2.0;
    let mut found: Vec<Quaternion> = Vec::new();
    // Of the 120 unit icosians, q and −q are one rotation: the one whose first part that is not 0 is positive.
    let mut keep = |q: Quaternion| {
        let first = q.iter().copied().find(|part| part.abs() > 1e-9).unwrap_or(0.0);
        if first > 0.0 {
            found.push(q);
        }
    };
    for i in 0..4 {
        keep([0, 1, 2, 3].map(|j| f64::from(u8::from(i == j))));
    }
    for signs in 0..16 {
        keep([0, 1, 2, 3].map(|i| if signs >> i & 1 == 0 { 0.5 } else { -0.5 }));
    }
    let parts = [golden / 2.0, 0.5, 0.5 / golden, 0.0];
    for places in even_permutations() {
        for signs in 0..8 {
            let mut q = [0.0; 4];
            for (i, &place) in places.iter().enumerate() {
                q[place] = if i < 3 && signs >> i & 1 == 1 { -parts[i] } else { parts[i] };
            }
            keep(q);
        }
    }
    found
}

fn even_permutations() -> Vec<[usize; 4]> {
    let mut found = Vec::new();
    for code in 0..256_usize {
        let places = [code & 3, code >> 2 & 3, code >> 4 & 3, code >> 6];
        let pairs = (0..4).flat_map(|i| (i + 1..4).map(move |j| (i, j)));
        let swaps = pairs.clone().filter(|&(i, j)| places[i] > places[j]).count();
        if pairs.clone().all(|(i, j)| places[i] != places[j]) && swaps % 2 == 0 {
            found.push(places);
        }
    }
    found
}

/// Step of the differences of tangents at the poles, in `v`.
const DIFFERENCE: f64 = 1e-4;

impl Motions {
    /// The motions of surfaces of `basis`, of spheres with sharp poles those of cylinders; `reverses` if a cylinder or torus may be
    /// traversed the other way round. `None` for planes and twisted tori, which have none.
    pub fn new(basis: &SurfaceBasis, reverses: bool) -> Option<Self> {
        let topology = match basis.extent().topology {
            // Sharp poles are places of the shape.
            Topology::SharpSphere => Topology::Cylinder,
            topology => topology,
        };
        let moves = topology != Topology::Plane && basis.seam().is_straight();
        moves.then(|| Self { basis: basis.clone(), topology, reverses })
    }

    /// Motions of which one is within reach of a local search, whatever the best one is: 60 for a sphere, 16 for a cylinder, 64 for
    /// a torus, twice as many with reversals.
    pub fn spread_out(&self) -> Vec<Motion> {
        let shifts = |counts: [i32; 2]| -> Vec<Motion> {
            let reversals = if self.reverses { &[0, -STEPS / 2][..] } else { &[0] };
            let grid = (0..counts[0]).flat_map(|a| (0..counts[1]).map(move |b| [a, b]));
            let place = |k: i32, count: i32| (k * STEPS / count + STEPS / 2).rem_euclid(STEPS) - STEPS / 2;
            grid.flat_map(|[a, b]| {
                reversals.iter().map(move |&r| Motion([place(a, counts[0]), place(b, counts[1]), r]))
            })
            .collect()
        };
        match self.topology {
            Topology::Sphere => icosahedral().into_iter().map(Motion::rotation).collect(),
            Topology::Cylinder => shifts([16, 1]),
            Topology::Torus => shifts([8, 8]),
            Topology::SharpSphere | Topology::Plane => Vec::new(),
        }
    }

    /// `motion` after `first`, as motions of the same surface: `T σ = σ ∘ first ∘ motion`.
    pub fn then(&self, first: Motion, motion: Motion) -> Motion {
        if self.topology == Topology::Sphere {
            return Motion::rotation(after(first.quaternion(), motion.quaternion()));
        }
        let sign = if first.reversed() { -1 } else { 1 };
        let half = STEPS / 2;
        let wrap = |part: i32| (part + half).rem_euclid(STEPS) - half;
        let reversed = first.reversed() != motion.reversed();
        let shift = |i: usize| wrap(first.0[i] + sign * motion.0[i]);
        Motion([shift(0), shift(1), if reversed { -half } else { 0 }])
    }

    /// The motions that differ from `motion` by `steps` of 1/1024 turn about one axis or along one direction.
    pub fn near(&self, motion: Motion, steps: u16) -> Vec<Motion> {
        let axes = match self.topology {
            Topology::Sphere => 3,
            Topology::Torus => 2,
            Topology::Cylinder => 1,
            Topology::SharpSphere | Topology::Plane => 0,
        };
        let single = |axis: usize, steps: i32| {
            let mut by = [0; 3];
            by[axis] = steps;
            self.then(motion, Motion(by))
        };
        (0..axes).flat_map(|axis| [single(axis, i32::from(steps)), single(axis, -i32::from(steps))]).collect()
    }

    /// Where `motion` takes `(u, v)`.
    fn moved(&self, motion: Motion, [u, v]: [f64; 2]) -> [f64; 2] {
        let turns = motion.turns();
        let round = |t: f64| t.rem_euclid(1.0).min(1.0_f64.next_down());
        match self.topology {
            Topology::Sphere => {
                spherical_parameters(Rotation(motion.quaternion()).apply(spherical_direction([u, v])))
            }
            Topology::Cylinder if motion.reversed() => [round(turns[0] - u), 1.0 - v],
            Topology::Cylinder => [round(turns[0] + u), v],
            _ if motion.reversed() => [round(turns[0] - u), round(turns[1] - v)],
            _ => [round(turns[0] + u), round(turns[1] + v)],
        }
    }

    /// Rows of the surface with these `rows` (`N × 3`), its parameters moved. Cost: a point of the surface for every row.
    pub fn apply(&self, rows: &Matrix, motion: Motion) -> Matrix {
        if motion == Motion::default() {
            return rows.clone();
        }
        self.interpolated(&self.basis.surface(rows), motion)
    }

    fn interpolated(&self, surface: &Surface, motion: Motion) -> Matrix {
        let at = |u: f64, v: f64| {
            let [u, v] = self.moved(motion, [u, v]);
            surface.point(u, v)
        };
        let tangents = match self.topology {
            Topology::Sphere => {
                // The meridians u and u + ½ continue each other across a pole.
                let across = |v: f64, u: f64| {
                    let (a, b) = (at(u, v), at(u + 0.5, v));
                    [0, 1, 2].map(|c| (a[c] - b[c]) / (2.0 * DIFFERENCE))
                };
                let north = [0.0, 0.25].map(|u| across(DIFFERENCE, u));
                let south = [0.0, 0.25].map(|u| across(1.0 - DIFFERENCE, u).map(|value| -value));
                Tangents { north: Some(north), south: Some(south) }
            }
            _ => Tangents::default(),
        };
        self.basis.interpolate_function_with(at, &tangents)
    }

    /// Root mean square distance between the surface of `rows` at the moved parameters and the moved surface, halfway between
    /// knots, divided by the root mean square distance of its points from their centroid.
    pub fn change(&self, rows: &Matrix, motion: Motion) -> f64 {
        let surface = self.basis.surface(rows);
        let moved = self.basis.surface(&self.apply(rows, motion));
        let intervals = self.basis.extent().intervals;
        let halfway = |i: usize| (0..intervals[i]).map(move |k| (k as f64 + 0.5) / intervals[i] as f64);
        let places: Vec<[f64; 2]> = halfway(0).flat_map(|u| halfway(1).map(move |v| [u, v])).collect();
        let point = |surface: &Surface, [u, v]: [f64; 2]| surface.point(u, v);
        let points: Vec<[f64; 3]> =
            places.iter().map(|place| point(&surface, self.moved(motion, *place))).collect();
        let count = points.len() as f64;
        let centroid = [0, 1, 2].map(|c| points.iter().map(|point| point[c]).sum::<f64>() / count);
        let apart: f64 =
            places.iter().zip(&points).map(|(place, p)| norm(minus(point(&moved, *place), *p)).powi(2)).sum();
        let extent: f64 = points.iter().map(|point| norm(minus(*point, centroid)).powi(2)).sum();
        if extent > 0.0 { (apart / extent).sqrt() } else { 0.0 }
    }

    /// The motion to a position that depends on the surface alone, not on its parameters or its pose: on a sphere, the long axis of
    /// its first-order ellipsoid goes through the poles, and the middle one through `u = ¼`, each towards the side that reaches out
    /// farther. No motion for cylinders and tori.
    pub fn canonical(&self, rows: &Matrix) -> Motion {
        if self.topology != Topology::Sphere {
            return Motion::default();
        }
        let surface = self.basis.surface(rows);
        let [count_u, count_v] = self.basis.extent().intervals.map(|count| 2 * count);
        let parameters: Vec<[f64; 2]> = (0..count_u)
            .flat_map(|k| {
                (0..count_v).map(move |l| [k as f64 / count_u as f64, (l as f64 + 0.5) / count_v as f64])
            })
            .collect();
        let weights: Vec<f64> = parameters.iter().map(|[_, v]| (PI * v).sin()).collect();
        let total: f64 = weights.iter().sum();
        let points: Vec<[f64; 3]> = parameters.iter().map(|[u, v]| surface.point(*u, *v)).collect();
        let mean =
            |of: &dyn Fn(usize) -> f64| (0..points.len()).map(|i| weights[i] * of(i)).sum::<f64>() / total;
        let centroid = [0, 1, 2].map(|c| mean(&|i| points[i][c]));
        let directions: Vec<[f64; 3]> = parameters.iter().map(|place| spherical_direction(*place)).collect();
        let first = Matrix::from_fn(3, 3, |c, e| mean(&|i| (points[i][c] - centroid[c]) * directions[i][e]));
        let Some(found) = svd(first, true, true) else { return Motion::default() };
        let (Some(left), Some(right)) = (found.u, found.v_t) else { return Motion::default() };
        let mut order = [0, 1, 2];
        order.sort_by(|&i, &j| found.singular_values[j].total_cmp(&found.singular_values[i]));
        // The axis on the parameter sphere, towards the side on which the surface reaches out farther along it.
        let axis = |i: usize| {
            let along = |k: usize| (0..3).map(|c| left[(c, i)] * (points[k][c] - centroid[c])).sum::<f64>();
            let sign = if mean(&|k| along(k).powi(3)) < 0.0 { -1.0 } else { 1.0 };
            [0, 1, 2].map(|c| sign * right[(i, c)])
        };
        let (z, y) = (axis(order[0]), axis(order[1]));
        Motion::rotation(Rotation::onto([cross(y, z), y, z]).0)
    }
}

/// `R p`.
#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::GeneratorKind;
    use crate::surface::basis::Extent;
    use crate::surface::seam::Seam;

    fn basis(topology: Topology, intervals: [usize; 2]) -> SurfaceBasis {
        let cubic = GeneratorKind::Cubic {};
        let kinds = match topology {
            Topology::Sphere => topology.usual_generators(),
            _ => [cubic.clone(), cubic],
        };
        SurfaceBasis::new(Extent { topology, intervals }, Seam::Straight, &kinds).unwrap()
    }

    /// A bean without symmetry.
    fn bean(direction: [f64; 3]) -> [f64; 3] {
        let [x, y, z] = direction;
        [x * (1.0 + 0.2 * z), 1.4 * y + 0.2 * z * z, 2.5 * z + 0.6 * z * z]
    }

    fn of(basis: &SurfaceBasis, turn: Quaternion) -> Matrix {
        basis.interpolate_function(|u, v| bean(Rotation(turn).apply(spherical_direction([u, v]))))
    }

    fn turn(degrees: f64, axis: [f64; 3]) -> Quaternion {
        let (sine, cosine) = (0.5 * degrees.to_radians()).sin_cos();
        let length = norm(axis);
        [cosine, sine * axis[0] / length, sine * axis[1] / length, sine * axis[2] / length]
    }

    #[test]
    fn codes_and_rotations_come_back() {
        for motion in [Motion([0, 0, 0]), Motion([511, -512, 3]), Motion([-1, 7, -200])] {
            assert_eq!(Motion::from_code(motion.code()), motion);
        }
        assert_eq!(Motion::default().code(), 0);
        for axis in [[1.0, 0.0, 0.0], [1.0, -2.0, 0.5]] {
            for degrees in [0.0, 30.0, 170.0] {
                let q = Motion::rotation(turn(degrees, axis)).quaternion();
                let cosine = dot4(q, turn(degrees, axis)).abs().min(1.0);
                // Half a step along each of three axes.
                assert!(2.0 * cosine.acos().to_degrees() < 0.5 * 360.0 / 1024.0 * 3.0_f64.sqrt() + 1e-6);
            }
        }
    }

    fn dot4(a: Quaternion, b: Quaternion) -> f64 {
        a.iter().zip(b).map(|(a, b)| a * b).sum()
    }

    #[test]
    fn icosahedral_rotations_are_sixty_and_near_every_rotation() {
        let all = icosahedral();
        assert_eq!(all.len(), 60);
        for (i, a) in all.iter().enumerate() {
            assert!((dot4(*a, *a) - 1.0).abs() < 1e-12);
            assert!(all[..i].iter().all(|b| dot4(*a, *b).abs() < 0.99));
        }
        for k in 0..200 {
            let t = f64::from(k);
            let q = turn(1.8 * t, [(1.3 * t).sin(), (0.7 * t).cos(), (2.1 * t).sin()]);
            let nearest = all.iter().map(|a| dot4(*a, q).abs()).fold(0.0, f64::max).min(1.0);
            assert!(2.0 * nearest.acos().to_degrees() < 45.0);
        }
    }

    #[test]
    fn a_moved_sphere_is_the_sphere_with_turned_parameters() {
        let basis = basis(Topology::Sphere, [16, 16]);
        let motions = Motions::new(&basis, false).unwrap();
        let motion = Motion([100, -60, 220]);
        let moved = motions.apply(&of(&basis, turn(0.0, [0.0, 0.0, 1.0])), motion);
        let expected = of(&basis, motion.quaternion());
        let apart = (&moved - &expected).norm() / expected.norm();
        assert!(apart < 2e-3, "{apart}");
        let change = motions.change(&expected, motion);
        assert!(change < 2e-3, "{change}");
        assert_eq!(motions.apply(&expected, Motion::default()), expected);
    }

    #[test]
    fn the_canonical_motion_undoes_any_turn_of_the_parameters() {
        let basis = basis(Topology::Sphere, [16, 16]);
        let motions = Motions::new(&basis, false).unwrap();
        let place = |rows: &Matrix| motions.apply(rows, motions.canonical(rows));
        let first = place(&of(&basis, turn(0.0, [0.0, 0.0, 1.0])));
        for q in [turn(50.0, [1.0, 2.0, -1.0]), turn(140.0, [0.3, -1.0, 0.2]), turn(90.0, [0.0, 0.0, 1.0])] {
            let apart = (place(&of(&basis, q)) - &first).norm() / first.norm();
            assert!(apart < 2e-2, "{apart}");
        }
    }

    #[test]
    fn cylinders_and_tori_are_shifted_and_reversed() {
        for (topology, at) in [(Topology::Cylinder, [0.3, 0.4]), (Topology::Torus, [0.3, 0.6])] {
            let basis = basis(topology, [16, 12]);
            let motions = Motions::new(&basis, true).unwrap();
            let rows = basis.interpolate_function(|u, v| {
                let (around, along) = (TAU * u, TAU * v);
                let r = 3.0 + along.cos() + 0.2 * around.sin();
                [r * around.cos(), r * around.sin(), along.sin() + 0.1 * (around + along).cos()]
            });
            for motion in [Motion([128, 0, 0]), Motion([128, 0, -512])] {
                let moved = basis.surface(&motions.apply(&rows, motion)).points(&[at[0]], &[at[1]])[0];
                let [u, v] = motions.moved(motion, at);
                let given = basis.surface(&rows).points(&[u], &[v])[0];
                assert!(norm(minus(moved, given)) < 1e-2, "{topology:?} {motion:?}");
                let back = if motion.reversed() { motion } else { Motion([-128, 0, 0]) };
                assert_eq!(motions.then(motion, back), Motion::default());
            }
        }
    }
}
