//! Cylinders closed by caps.
//!
//! The lateral surface is a tensor product, open along `v`. Its flux alone depends on the axis along which fields are
//! integrated, so the cylinder is closed: by rings `(1 − j/n) rim + (j/n) centroid`, as fans of long triangles are too coarse.
//! Integrals and the volume are those of the closed mesh; the area and the spacing are those of the lateral surface.

use shapelex_geometry::knot_line::Line;
use shapelex_numeric::sparse::SparseRows;

use super::mesh::MeshBoundary;
use super::tensor::Sheet;
use super::{Boundary, Differential, Rule, Samples};
use crate::field::Integrated;
use crate::frame::Frame;

/// Samples per span of the lateral surface for its area and spacing: these vary with the control points, not with the image.
const LATERAL: [usize; 2] = [6, 4];

/// Numbers of vertices of a cylinder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CylinderMesh {
    /// Vertices around the axis, and intervals along it.
    pub counts: [usize; 2],
    /// Rings of a cap from the rim to the centroid; at least 1.
    pub rings: usize,
}

/// A cylinder closed by two caps.
#[derive(Debug, Clone)]
pub struct CylinderBoundary {
    lateral: Sheet,
    closed: MeshBoundary,
    frame: Frame<3>,
}

impl CylinderBoundary {
    /// The cylinders of two lines, with free points `[k][l]`, `l = 0 … M_v`, oriented so that `rows` enclose a positive volume.
    pub fn new(lines: &[Line; 2], mesh: CylinderMesh, rows: &[[f64; 3]], frame: Frame<3>) -> Self {
        let net = extension(lines);
        let operator = vertices(lines, &net, mesh);
        let faces = faces(mesh);
        let closed = MeshBoundary::new(operator, faces, rows, frame);
        let rules = [0, 1].map(|i| Rule::sampled(&lines[i], LATERAL[i]));
        Self { lateral: Sheet::new(lines, net, rules), closed, frame }
    }

    /// The closed mesh.
    pub fn closed(&self) -> &MeshBoundary {
        &self.closed
    }
}

/// From free points to control points `[k][l]`, beyond the ends by linear extrapolation: `c[−j] = (1 + j) c[0] − j c[1]`. It
/// keeps the exact cylinder for any number of points along the axis.
pub fn extension(lines: &[Line; 2]) -> SparseRows {
    let [around, last] = [0, 1].map(|i| lines[i].intervals());
    let [beyond, _] = lines[1].beyond();
    let mut net =
        SparseRows::new(around * (last + 1), around * (last + 1 + 2 * beyond), 2 * around * (last + 1));
    for k in 0..around {
        let at = |l: usize| (k * (last + 1) + l) as u32;
        let outside = |distance: usize, [end, inner]: [usize; 2]| {
            let distance = distance as f64;
            [(at(end), 1.0 + distance), (at(inner), -distance)]
        };
        (1..=beyond).rev().for_each(|j| net.push(&outside(j, [0, 1])));
        (0..=last).for_each(|l| net.push(&[(at(l), 1.0)]));
        (1..=beyond).for_each(|j| net.push(&outside(j, [last, last - 1])));
    }
    net
}

/// From free points to the vertices: `[i][j]` of the lateral surface, then for each end the rings from the rim on, each in the
/// order of `i`, and the centroid.
fn vertices(lines: &[Line; 2], net: &SparseRows, mesh: CylinderMesh) -> SparseRows {
    let [count, along] = mesh.counts;
    let parameters = |n: usize, last: usize, line: &Line| -> Vec<f64> {
        (0..last).map(|i| i as f64 * line.intervals() as f64 / n as f64).collect()
    };
    let [of_u, _] = lines[0].taps(&parameters(count, count, &lines[0]));
    let [of_v, _] = lines[1].taps(&parameters(along, along + 1, &lines[1]));
    let length = of_v.columns() as u32;
    let mut operator = SparseRows::new(net.rows(), count * (along + 1), 16 * count * (along + 1));
    let product = |i: usize, j: usize| -> Vec<(u32, f64)> {
        let pairs = of_u.row(i).iter().flat_map(|a| of_v.row(j).iter().map(move |b| (a, b)));
        pairs.map(|((k, a), (l, b))| (k * length + l, a * b)).collect()
    };
    for i in 0..count {
        (0..=along).for_each(|j| operator.push(&product(i, j)));
    }
    for end in [0, along] {
        let scaled = |row: Vec<(u32, f64)>, factor: f64| {
            row.into_iter().map(move |(column, value)| (column, factor * value))
        };
        let mut centroid = SparseRows::new(net.rows(), 1, 0);
        centroid
            .push(&(0..count).flat_map(|i| scaled(product(i, end), 1.0 / count as f64)).collect::<Vec<_>>());
        for ring in 1..mesh.rings {
            let inwards = ring as f64 / mesh.rings as f64;
            for i in 0..count {
                let rim = scaled(product(i, end), 1.0 - inwards);
                operator.push(&rim.chain(scaled(centroid.row(0).to_vec(), inwards)).collect::<Vec<_>>());
            }
        }
        operator.push(centroid.row(0));
    }
    operator.multiply(net)
}

/// Faces of the closed mesh, consistently oriented.
fn faces(mesh: CylinderMesh) -> Vec<[u32; 3]> {
    let [count, along] = mesh.counts;
    let mut faces = Vec::with_capacity(2 * count * (along + 2 * mesh.rings));
    for i in 0..count {
        let next = (i + 1) % count;
        for j in 0..along {
            let [a, b] = [i, next].map(|i| (i * (along + 1) + j) as u32);
            faces.extend([[a, b, b + 1], [a, b + 1, a + 1]]);
        }
    }
    let cap = count * (mesh.rings - 1) + 1;
    for (end, row) in [0, along].into_iter().enumerate() {
        let first = count * (along + 1) + end * cap;
        // The vertex i of a ring; the last ring is the centroid.
        let at = |ring: usize, i: usize| match ring {
            0 => (i * (along + 1) + row) as u32,
            _ if ring == mesh.rings => (first + cap - 1) as u32,
            _ => (first + (ring - 1) * count + i) as u32,
        };
        let mut push = |[a, b, c]: [u32; 3]| faces.push(if end == 0 { [a, b, c] } else { [a, c, b] });
        for ring in 0..mesh.rings {
            for i in 0..count {
                let next = (i + 1) % count;
                let [a, b, inner_a, inner_b] =
                    [at(ring, i), at(ring, next), at(ring + 1, i), at(ring + 1, next)];
                push([inner_a, b, a]);
                if inner_a != inner_b {
                    push([inner_a, inner_b, b]);
                }
            }
        }
    }
    faces
}

impl Boundary<3> for CylinderBoundary {
    fn rows(&self) -> usize {
        self.closed.rows()
    }

    fn sample(&self, rows: &[[f64; 3]]) -> Samples<3> {
        Samples { vertices: self.closed.sample(rows).vertices, ..self.lateral.sample(rows) }
    }

    fn integral(&self, samples: &Samples<3>, field: &Integrated<3>) -> Differential<3> {
        self.closed.integral(samples, field)
    }

    fn volume(&self, samples: &Samples<3>) -> Differential<3> {
        self.closed.volume(samples)
    }

    fn measure(&self, samples: &Samples<3>) -> Differential<3> {
        self.lateral.area(samples, &self.frame)
    }

    fn mean(
        &self,
        samples: &Samples<3>,
        function: &dyn Fn(usize, [f64; 3]) -> (f64, [f64; 3]),
    ) -> Differential<3> {
        self.closed.mean(samples, function)
    }

    fn spacing(&self, samples: &Samples<3>) -> Differential<3> {
        self.lateral.unevenness(samples, &self.frame)
    }
}
