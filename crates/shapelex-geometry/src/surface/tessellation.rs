//! Triangle meshes of surfaces without cracks: glued edges share their vertices, and a pole is a single vertex.

use super::{Surface, Topology};
use crate::mesh::TriangleMesh;
use crate::vector::{cross, norm};

impl Surface {
    /// Triangle mesh over a grid of `count` parameters along `u` and `v`: `i/count` along closed directions, `i/(count − 1)` along
    /// open ones. Two triangles per cell, one at the poles. Positions are exact, and normals are those of the surface.
    ///
    /// `count` must be at least 3 along closed directions, 2 along open ones, and 3 from pole to pole on spheres; a half-turn
    /// seam needs an even number along `v`. Cost: one jet per vertex.
    pub fn tessellate(&self, count: [usize; 2]) -> TriangleMesh {
        let (u, v) = (self.parameters(0, count[0]), self.parameters(1, count[1]));
        let sphere = self.topology.has_poles();
        let inner = if sphere { &v[1..count[1] - 1] } else { &v[..] };
        let poles: &[f64] = if sphere { &[0.0, 1.0] } else { &[] };
        let mut mesh = TriangleMesh::default();
        let mut normals = Vec::new();
        let mut add = |u: &[f64], v: &[f64]| {
            for (i, jet) in self.jets(u, v).iter().enumerate() {
                mesh.vertices.push(jet[0]);
                normals.push(self.frame(v[i % v.len()], jet).normal.unwrap_or_default());
            }
        };
        add(&u, inner);
        poles.iter().for_each(|pole| add(&[0.0], &[*pole]));
        if self.topology == Topology::SharpSphere {
            let first = normals.len() - poles.len();
            poles.iter().enumerate().for_each(|(i, pole)| normals[first + i] = self.mean_normal(&u, *pole));
        }
        mesh.normals = self.is_orientable().then_some(normals);
        mesh.faces = self.triangles(count);
        mesh
    }

    /// Direction of the vector area `½ ∮ τ × τ' du` of the tangents `τ` at a pole, for meshes: that of the normal at a smooth pole, of
    /// the axis at the point of a cone; 0 if it vanishes.
    fn mean_normal(&self, u: &[f64], pole: f64) -> [f64; 3] {
        let mut area = [0.0; 3];
        for [_, _, dv, _, duv, _] in self.jets(u, &[pole]) {
            let part = cross(duv, dv);
            (0..3).for_each(|c| area[c] += part[c]);
        }
        let sign = if pole > 0.5 { -self.topology.orientation() } else { self.topology.orientation() };
        let length = norm(area);
        if length > 0.0 { area.map(|value| sign * value / length) } else { [0.0; 3] }
    }

    fn triangles(&self, [count_u, count_v]: [usize; 2]) -> Vec<[u32; 3]> {
        let (sphere, closed) = (self.topology.has_poles(), self.topology.closed());
        let columns = if sphere { count_v - 2 } else { count_v };
        let vertex = |i: usize, j: usize| {
            let j = if i >= count_u { self.seam.across(j % columns, columns) } else { j % columns };
            (i % count_u * columns + j) as u32
        };
        let cells =
            [if closed[0] { count_u } else { count_u - 1 }, if closed[1] { columns } else { columns - 1 }];
        let outward = self.topology.orientation() > 0.0;
        let mut faces = Vec::new();
        let mut add = |[a, b, c]: [u32; 3]| faces.push(if outward { [a, b, c] } else { [a, c, b] });
        for i in 0..cells[0] {
            for j in 0..cells[1] {
                let corners = [vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)];
                add([corners[0], corners[1], corners[2]]);
                add([corners[0], corners[2], corners[3]]);
            }
            if sphere {
                let north = (count_u * columns) as u32;
                add([north, vertex(i + 1, 0), vertex(i, 0)]);
                add([north + 1, vertex(i, columns - 1), vertex(i + 1, columns - 1)]);
            }
        }
        faces
    }
}
