//! Points that cover the sphere evenly, and that the 60 rotations of the icosahedron permute.

use std::collections::BTreeMap;

use crate::rotation::Rotation;
use crate::surface::motion::icosahedral;
use crate::vector::{cross, dot, minus, norm};

/// Vertices of an icosahedron whose faces are divided into four, some times over.
#[derive(Debug, Clone)]
pub struct Nodes {
    /// The points.
    pub points: Vec<[f64; 3]>,
    /// Their shares of the area; the sum is 1.
    pub weights: Vec<f64>,
    /// Triangles between them, counter-clockwise seen from outside.
    pub faces: Vec<[u32; 3]>,
}

/// A rotation that maps nodes to nodes.
#[derive(Debug, Clone)]
pub struct Symmetry {
    /// The rotation `R`.
    pub rotation: Rotation,
    /// Index of the node `R x_q` for every node `x_q`.
    pub image: Vec<u32>,
}

impl Nodes {
    /// `10 · 4^divisions + 2` nodes.
    pub fn new(divisions: usize) -> Self {
        let (mut points, mut faces) = icosahedron();
        for _ in 0..divisions {
            (points, faces) = divided(points, &faces);
        }
        let mut weights = vec![0.0; points.len()];
        for face in &faces {
            let [a, b, c] = face.map(|vertex| points[vertex as usize]);
            let area = norm(cross(minus(b, a), minus(c, a)));
            face.iter().for_each(|vertex| weights[*vertex as usize] += area);
        }
        let total: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|weight| *weight /= total);
        Self { points, weights, faces }
    }

    /// The rotations of the icosahedron.
    pub fn symmetries(&self) -> Vec<Symmetry> {
        let nearest = |p: [f64; 3]| {
            let most = |best: (usize, f64), (i, x): (usize, &[f64; 3])| {
                let cosine = dot(*x, p);
                if cosine > best.1 { (i, cosine) } else { best }
            };
            self.points.iter().enumerate().fold((0, -2.0), most).0 as u32
        };
        let symmetry = |q: [f64; 4]| {
            let rotation = Rotation(q);
            Symmetry { rotation, image: self.points.iter().map(|x| nearest(rotation.apply(*x))).collect() }
        };
        icosahedral().into_iter().map(symmetry).collect()
    }

    /// Smallest ratio of the area of a triangle under a map of the nodes to its own area; negative where the map folds.
    pub fn least_jacobian(&self, images: &[[f64; 3]]) -> f64 {
        let volume = |points: &[[f64; 3]], face: &[u32; 3]| {
            let [a, b, c] = face.map(|vertex| points[vertex as usize]);
            dot(a, cross(b, c))
        };
        let ratio = |face: &[u32; 3]| volume(images, face) / volume(&self.points, face);
        self.faces.iter().map(ratio).fold(f64::INFINITY, f64::min)
    }
}

fn icosahedron() -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let golden = (1.0 + 5.0_f64.sqrt()) / 2.0;
    let length = golden.hypot(1.0);
    let mut points = Vec::with_capacity(12);
    for c in 0..3 {
        for signs in 0..4 {
            let part = |bit: i32| if signs >> bit & 1 == 0 { length.recip() } else { -length.recip() };
            let mut point = [0.0; 3];
            (point[(c + 1) % 3], point[(c + 2) % 3]) = (golden * part(0), part(1));
            points.push(point);
        }
    }
    // Neighbours are nearer to each other than any other two vertices.
    let near = |a: usize, b: usize| dot(points[a], points[b]) > 0.4;
    let mut faces = Vec::with_capacity(20);
    for a in 0..12 {
        for b in a + 1..12 {
            for c in b + 1..12 {
                if near(a, b) && near(b, c) && near(a, c) {
                    let outward = dot(points[a], cross(points[b], points[c])) > 0.0;
                    let (b, c) = if outward { (b, c) } else { (c, b) };
                    faces.push([a as u32, b as u32, c as u32]);
                }
            }
        }
    }
    (points, faces)
}

/// Divides every face into four at the middles of its edges.
fn divided(mut points: Vec<[f64; 3]>, faces: &[[u32; 3]]) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let mut middles: BTreeMap<[u32; 2], u32> = BTreeMap::new();
    let mut finer = Vec::with_capacity(4 * faces.len());
    for &[a, b, c] in faces {
        let [ab, bc, ca] = [[a, b], [b, c], [c, a]].map(|[p, q]| {
            *middles.entry([p.min(q), p.max(q)]).or_insert_with(|| {
                let [p, q] = [points[p as usize], points[q as usize]];
                let sum = [0, 1, 2].map(|i| p[i] + q[i]);
                let length = norm(sum);
                points.push(sum.map(|part| part / length));
                (points.len() - 1) as u32
            })
        });
        finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    (points, finer)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rotations_of_the_icosahedron_permute_the_nodes() {
        let nodes = Nodes::new(2);
        assert_eq!((nodes.points.len(), nodes.faces.len()), (162, 320));
        for symmetry in nodes.symmetries() {
            let mut seen = vec![false; nodes.points.len()];
            for (x, &image) in nodes.points.iter().zip(&symmetry.image) {
                let apart = norm(minus(symmetry.rotation.apply(*x), nodes.points[image as usize]));
                assert!(apart < 1e-12, "{apart}");
                seen[image as usize] = true;
            }
            assert!(seen.into_iter().all(|seen| seen));
        }
    }

    #[test]
    fn a_map_that_turns_a_triangle_over_folds() {
        let nodes = Nodes::new(1);
        assert!((nodes.least_jacobian(&nodes.points) - 1.0).abs() < 1e-12);
        let mirrored: Vec<[f64; 3]> = nodes.points.iter().map(|[x, y, z]| [-x, *y, *z]).collect();
        assert!(nodes.least_jacobian(&mirrored) < 0.0);
    }
}
