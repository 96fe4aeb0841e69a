//! Texture coordinates of meshes: a place on a picture for every corner of a face.
//!
//! The place of a point of a tensor-product surface is its pair of parameters `(u, v)`. Where a direction closes, one vertex has two
//! places, `u = 0` and `u = 1`; a pole has one for every triangle that ends there, in the middle of the triangle's base. A picture
//! whose columns are meridians and whose rows are parallels, the first pole on top, is therefore wrapped without a seam.

use crate::mesh::TriangleMesh;
use crate::surface::Topology;
use crate::surface::basis::Extent;

/// Texture coordinates of a mesh.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Texture {
    /// Places `(u, v)` on the picture; `v = 0` is its upper edge.
    pub places: Vec<[f64; 2]>,
    /// Places of the corners of every face, in the order of the faces of the mesh.
    pub faces: Vec<[u32; 3]>,
}

/// A mesh, with texture coordinates if it has parameters.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TexturedMesh {
    /// The mesh.
    pub mesh: TriangleMesh,
    /// Its texture coordinates.
    pub texture: Option<Texture>,
}

impl From<TriangleMesh> for TexturedMesh {
    fn from(mesh: TriangleMesh) -> Self {
        Self { mesh, texture: None }
    }
}

impl Texture {
    /// The mesh with one vertex per place, for formats in which a vertex has one place only. Every place belongs to one vertex of
    /// `mesh`. Cost: linear.
    pub fn split(&self, mesh: &TriangleMesh) -> TriangleMesh {
        let mut vertex_of = vec![0; self.places.len()];
        for (places, corners) in self.faces.iter().zip(&mesh.faces) {
            (0..3).for_each(|i| vertex_of[places[i] as usize] = corners[i] as usize);
        }
        let by_place = |list: &Vec<[f64; 3]>| vertex_of.iter().map(|vertex| list[*vertex]).collect();
        TriangleMesh {
            vertices: by_place(&mesh.vertices),
            normals: mesh.normals.as_ref().map(by_place),
            faces: self.faces.clone(),
        }
    }
}

impl Extent {
    /// Texture coordinates of the mesh over a grid of `count` parameters along `u` and `v`:
    /// see [`Surface::tessellate`](crate::surface::Surface::tessellate). Cost: linear.
    pub fn texture(self, [count_u, count_v]: [usize; 2]) -> Texture {
        let (sphere, closed) = (self.topology == Topology::Sphere, self.topology.closed());
        let cells = [count_u - usize::from(!closed[0]), count_v - usize::from(!closed[1])];
        let place = |i: usize, j: usize| [i as f64 / cells[0] as f64, j as f64 / cells[1] as f64];
        // The rows of a sphere between its poles.
        let rows = if sphere { 1..cells[1] } else { 0..cells[1] + 1 };
        let columns = rows.len();
        let mut places: Vec<[f64; 2]> =
            (0..=cells[0]).flat_map(|i| rows.clone().map(move |j| place(i, j))).collect();
        let at = |i: usize, j: usize| (i * columns + j) as u32;
        let outward = self.topology.orientation() > 0.0;
        let mut faces = Vec::new();
        let mut add = |[a, b, c]: [u32; 3]| faces.push(if outward { [a, b, c] } else { [a, c, b] });
        for i in 0..cells[0] {
            for j in 0..columns - 1 {
                let corners = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                add([corners[0], corners[1], corners[2]]);
                add([corners[0], corners[2], corners[3]]);
            }
            if sphere {
                let middle = (i as f64 + 0.5) / cells[0] as f64;
                let pole = places.len() as u32;
                places.extend([[middle, 0.0], [middle, 1.0]]);
                add([pole, at(i + 1, 0), at(i, 0)]);
                add([pole + 1, at(i, columns - 1), at(i + 1, columns - 1)]);
            }
        }
        Texture { places, faces }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::GeneratorKind;
    use crate::representation::{Representation, ShapeSpace};
    use crate::surface::seam::Seam;
    use crate::vector::{minus, norm};
    use shapelex_numeric::dense::Matrix;

    /// Every corner of the mesh is the surface at its place, on every topology and seam.
    #[test]
    fn corners_have_the_parameters_of_their_places() {
        let (sphere, torus, straight) = (Topology::Sphere, Topology::Torus, Seam::Straight);
        for (topology, seam, grid) in [
            (sphere, straight, [7, 6]),
            (torus, straight, [5, 4]),
            (torus, Seam::Reflected, [5, 4]),
            (torus, Seam::HalfTurn, [5, 4]),
            (Topology::Cylinder, straight, [5, 3]),
            (Topology::Plane, straight, [4, 3]),
        ] {
            let representation = Representation::Surface {
                topology,
                seam,
                control_points: [8, 6],
                generators: [GeneratorKind::Trigonometric {}, GeneratorKind::Trigonometric {}],
            };
            let space = ShapeSpace::new(&representation).unwrap();
            let Some(basis) = space.surface() else { panic!("a surface") };
            let mut state = 1_u64;
            let mut number = || {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 40) as f64 / (1 << 24) as f64
            };
            let rows = Matrix::from_fn(representation.size(), 3, |_, _| number());
            let surface = basis.surface(&rows);
            let (mesh, texture) = (surface.tessellate(grid), basis.extent().texture(grid));
            let split = texture.split(&mesh);
            assert_eq!(texture.faces.len(), mesh.faces.len(), "{topology:?}");
            for (place, vertex) in texture.places.iter().zip(&split.vertices) {
                let [u, v] = *place;
                // A pole has no parameter `u`; the far side of a seam is the near side of it, glued.
                let point = match u {
                    1.0 if seam != straight => continue,
                    _ => surface.points(&[u], &[v])[0],
                };
                assert!(norm(minus(point, *vertex)) < 1e-12, "{topology:?} {seam:?} {place:?}");
            }
            assert_eq!(split.faces, texture.faces);
        }
    }
}
