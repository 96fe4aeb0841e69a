//! Triangle meshes with vertices `V = S p`.
//!
//! ```text
//! ∭_Ω F = Σ_T n_x (G_a + G_b + G_c)/3,   n_x = ½ [(y_b − y_a)(z_c − z_a) − (z_b − z_a)(y_c − y_a)]
//! Vol = Σ_T V_a·(V_b × V_c)/6
//! ```
//!
//! On a closed mesh, a function of `(y, z)` added to `G` changes nothing. The rule needs edges of about one cell.

use rayon::prelude::*;

use shapelex_geometry::vector::{cross, dot, minus, norm};
use shapelex_numeric::sparse::SparseRows;

use super::{Boundary, Differential, Samples, relative_variance};
use crate::field::Integrated;
use crate::frame::Frame;

/// Minimum number of vertices in a parallel task: some 30 µs of look-ups.
const TASK: usize = 256;

/// A closed mesh whose vertices depend linearly on free points.
#[derive(Debug, Clone)]
pub struct MeshBoundary {
    /// `S` and its transpose.
    maps: [SparseRows; 2],
    faces: Vec<[u32; 3]>,
    sign: f64,
    frame: Frame<3>,
}

impl MeshBoundary {
    /// The meshes with vertices `operator · p`, oriented so that `rows` enclose a positive volume.
    pub fn new(operator: SparseRows, faces: Vec<[u32; 3]>, rows: &[[f64; 3]], frame: Frame<3>) -> Self {
        let transpose = operator.transpose();
        let mut boundary = Self { maps: [operator, transpose], faces, sign: 1.0, frame };
        if boundary.volume(&boundary.sample(rows)).value < 0.0 {
            boundary.sign = -1.0;
        }
        boundary
    }

    /// The faces, by indices of vertices.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    fn gather(&self, value: f64, slopes: &[[f64; 3]]) -> Differential<3> {
        Differential { value, gradient: self.maps[1].apply(slopes) }
    }

    fn corners(&self, samples: &Samples<3>, face: [u32; 3]) -> [[f64; 3]; 3] {
        face.map(|vertex| samples.vertices[vertex as usize])
    }

    /// `e = b − a`, `f = c − a` and `e × f` in the frame, for a face.
    fn edges(&self, samples: &Samples<3>, face: [u32; 3]) -> [[f64; 3]; 3] {
        let [a, b, c] = self.corners(samples, face);
        let [e, f] = [minus(b, a), minus(c, a)].map(|edge| self.frame.turn(edge));
        [e, f, cross(e, f)]
    }

    /// Adds the slopes in the corners, of those in the two edges in the frame.
    fn add_edges(&self, slopes: &mut [[f64; 3]], face: [u32; 3], of_edges: [[f64; 3]; 2]) {
        let [e, f] = of_edges.map(|slope| self.frame.turn_back(slope));
        for c in 0..3 {
            slopes[face[0] as usize][c] -= e[c] + f[c];
            slopes[face[1] as usize][c] += e[c];
            slopes[face[2] as usize][c] += f[c];
        }
    }
}

impl Boundary<3> for MeshBoundary {
    fn rows(&self) -> usize {
        self.maps[0].columns()
    }

    fn sample(&self, rows: &[[f64; 3]]) -> Samples<3> {
        Samples { vertices: self.maps[0].apply(rows), ..Samples::default() }
    }

    fn integral(&self, samples: &Samples<3>, field: &Integrated<3>) -> Differential<3> {
        let factor = self.sign * self.frame.determinant().abs();
        let at: Vec<(f64, [f64; 3])> =
            samples.vertices.par_iter().with_min_len(TASK).map(|vertex| field.at(*vertex)).collect();
        // A third of the sum of n_x over the faces at a vertex.
        let mut shares = vec![0.0; at.len()];
        let mut slopes = vec![[0.0; 3]; at.len()];
        let mut value = 0.0;
        for face in &self.faces {
            let [a, b, c] = self.corners(samples, *face);
            let normal = 0.5 * ((b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1]));
            let mean = factor * face.iter().map(|vertex| at[*vertex as usize].0).sum::<f64>() / 3.0;
            value += normal * mean;
            // n_x = ½ Σ (y_p z_q − z_p y_q) over the edges pq.
            for (vertex, before, after) in [(0, c, b), (1, a, c), (2, b, a)] {
                let slope = &mut slopes[face[vertex] as usize];
                slope[1] += 0.5 * mean * (after[2] - before[2]);
                slope[2] -= 0.5 * mean * (after[1] - before[1]);
                shares[face[vertex] as usize] += factor * normal / 3.0;
            }
        }
        for ((slope, share), (_, gradient)) in slopes.iter_mut().zip(shares).zip(&at) {
            (0..3).for_each(|c| slope[c] += share * gradient[c]);
        }
        self.gather(value, &slopes)
    }

    fn volume(&self, samples: &Samples<3>) -> Differential<3> {
        let factor = self.sign * self.frame.determinant().abs() / 6.0;
        let mut slopes = vec![[0.0; 3]; samples.vertices.len()];
        let mut value = 0.0;
        for face in &self.faces {
            let [a, b, c] = self.corners(samples, *face);
            value += factor * dot(a, cross(b, c));
            for (vertex, p, q) in [(0, b, c), (1, c, a), (2, a, b)] {
                let normal = cross(p, q);
                (0..3).for_each(|c| slopes[face[vertex] as usize][c] += factor * normal[c]);
            }
        }
        self.gather(value, &slopes)
    }

    fn measure(&self, samples: &Samples<3>) -> Differential<3> {
        let mut slopes = vec![[0.0; 3]; samples.vertices.len()];
        let mut area = 0.0;
        for face in &self.faces {
            let [e, f, normal] = self.edges(samples, *face);
            let length = norm(normal);
            area += 0.5 * length;
            if length > 0.0 {
                let unit = normal.map(|x| 0.5 * x / length);
                self.add_edges(&mut slopes, *face, [cross(f, unit), cross(unit, e)]);
            }
        }
        self.gather(area, &slopes)
    }

    fn mean(
        &self,
        samples: &Samples<3>,
        function: &dyn Fn(usize, [f64; 3]) -> (f64, [f64; 3]),
    ) -> Differential<3> {
        let share = 1.0 / samples.vertices.len() as f64;
        let found: Vec<(f64, [f64; 3])> =
            samples.vertices.iter().enumerate().map(|(s, vertex)| function(s, *vertex)).collect();
        let slopes: Vec<[f64; 3]> = found.iter().map(|(_, slope)| slope.map(|x| share * x)).collect();
        self.gather(found.iter().map(|(value, _)| share * value).sum(), &slopes)
    }

    /// `mean(a²)/mean(a)² − 1` over the faces, `a = |(V_b − V_a) × (V_c − V_a)|²`.
    fn spacing(&self, samples: &Samples<3>) -> Differential<3> {
        let edges: Vec<[[f64; 3]; 3]> = self.faces.iter().map(|face| self.edges(samples, *face)).collect();
        let squares: Vec<f64> = edges.iter().map(|[_, _, normal]| dot(*normal, *normal)).collect();
        let share = 1.0 / squares.len() as f64;
        let (value, factors) = relative_variance(&squares, |_| share);
        let mut slopes = vec![[0.0; 3]; samples.vertices.len()];
        for ((face, [e, f, normal]), factor) in self.faces.iter().zip(&edges).zip(factors) {
            let twice = normal.map(|x| 2.0 * factor * x);
            self.add_edges(&mut slopes, *face, [cross(*f, twice), cross(twice, *e)]);
        }
        self.gather(value, &slopes)
    }
}
