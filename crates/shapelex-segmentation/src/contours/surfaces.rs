//! Outer surfaces and cavities of components in space.
//!
//! Cubes of eight neighbouring centres, one beyond the edges of the volume too, give the triangles (`cases`). A vertex is on each
//! face of a cell that is not shared by two cells of the component, and in the middle of loops that are not fans.

use rayon::prelude::*;
use shapelex_geometry::mesh::TriangleMesh;
use shapelex_numeric::bounded::Stop;

use super::cases::{CASES, EDGES, edge_ends};
use super::components::{Component, Components, NONE};
use super::level::Level;
use super::sets::Sets;
use super::{blur_in_cells, check_vertices, starts};
use crate::SegmentationError;
use crate::frame::Frame;

/// A closed connected surface.
#[derive(Debug, Clone, PartialEq)]
pub struct Surface {
    /// Its mesh, in world coordinates. Every edge has two faces, and the faces around a vertex form one fan.
    pub mesh: TriangleMesh,
    /// Euler number `V − E + F = 2 − 2 g`, with the genus `g`.
    pub euler: i64,
}

impl Surface {
    /// Number of handles.
    pub fn genus(&self) -> usize {
        usize::try_from(1 - self.euler / 2).unwrap_or(0)
    }
}

/// A component in space as closed surfaces. Faces are counter-clockwise as seen from outside of the component.
#[derive(Debug, Clone, PartialEq)]
pub struct Solid {
    /// The component.
    pub component: Component,
    /// The outer surface.
    pub outer: Surface,
    /// The surfaces of the cavities, in the order of their first vertices. Their normals point into the cavities, so their signed
    /// volumes are negative, and the volume of the component is the sum of all.
    pub cavities: Vec<Surface>,
}

/// Predicted size of all surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SurfaceCounts {
    /// Number of vertices.
    pub vertices: usize,
    /// Number of triangles.
    pub triangles: usize,
}

/// The cubes that the surface of a component meets: position of the cube, and its corners inside in the lowest eight bits.
struct Cubes {
    /// Starts of the components in the list.
    starts: Vec<usize>,
    list: Vec<u64>,
}

impl Components<3> {
    /// Number of vertices and triangles of all surfaces. `None` once `stop` returns true. Cost: one pass over the cells.
    pub fn surface_counts(&self, stop: Stop<'_>) -> Option<SurfaceCounts> {
        let mut counts = SurfaceCounts::default();
        self.each_cube(stop, |_, _, inside| {
            counts.vertices += CASES[inside as usize].centres.len();
            counts.triangles += CASES[inside as usize].triangles.len();
        })?;
        counts.vertices += self.list().iter().map(|component| component.faces).sum::<usize>();
        Some(counts)
    }

    /// The surfaces of all components, in world coordinates, from the mask blurred by `blur` units of length, 0 for none. `None`
    /// once `stop` returns true. The same bits on any number of threads.
    ///
    /// Cost: three passes over the cells, and `O(log n)` for each of `n` vertices. Memory: about 100 bytes per vertex; with a
    /// blur also 12 bytes per cell of the box of one component.
    ///
    /// # Errors
    /// [`SegmentationError::Vertices`] for more than `most_vertices` or 2³², [`SegmentationError::BlurOfMask`].
    pub fn solids(
        &self,
        frame: &Frame<3>,
        blur: f64,
        most_vertices: usize,
        stop: Stop<'_>,
    ) -> Result<Option<Vec<Solid>>, SegmentationError> {
        let sigma = blur_in_cells(frame, blur)?;
        let Some(counts) = self.surface_counts(stop) else { return Ok(None) };
        check_vertices(counts.vertices, most_vertices.min(u32::MAX as usize))?;
        let Some(cubes) = self.cubes(stop) else { return Ok(None) };
        let solid = |id: usize| {
            let level = Level::new(self, id as u32, sigma);
            let cubes = &cubes.list[cubes.starts[id]..cubes.starts[id + 1]];
            solid(self.list()[id], &Mesher { level, size: self.size, cubes }, frame, stop)
        };
        let all = 0..self.list().len();
        // Filters are parallel themselves; one box at a time bounds their memory.
        Ok(match blur > 0.0 {
            true => all.map(solid).collect(),
            false => all.into_par_iter().map(solid).collect(),
        })
    }

    /// The cubes of every component.
    fn cubes(&self, stop: Stop<'_>) -> Option<Cubes> {
        let mut counts = vec![0; self.list().len()];
        self.each_cube(stop, |id, _, _| counts[id as usize] += 1)?;
        let starts = starts(counts.into_iter());
        let (mut next, mut list) = (starts.clone(), vec![0; starts[starts.len() - 1]]);
        self.each_cube(stop, |id, at, inside| {
            list[next[id as usize]] = (at as u64) << 8 | u64::from(inside);
            next[id as usize] += 1;
        })?;
        Some(Cubes { starts, list })
    }

    /// Gives every component that has some but not all corners of a cube, with the position of the cube, and the corners. Cube
    /// `(i, j, k)` lies between the centres `(i − 1, j − 1, k − 1)` and `(i, j, k)`; x is the fastest axis of positions.
    fn each_cube(&self, stop: Stop<'_>, mut give: impl FnMut(u32, usize, u8)) -> Option<()> {
        let [columns, rows, slices] = self.size;
        let mut at = 0;
        for (k, j) in (0..=slices).flat_map(|k| (0..=rows).map(move |j| (k, j))) {
            if stop() {
                return None;
            }
            let along = [0, 1, 2, 3].map(|row| [j + (row & 1), k + (row >> 1)].map(|at| at as isize - 1));
            let column = |i: usize| along.map(|[j, k]| self.id([i as isize - 1, j, k]));
            let mut before = column(0);
            for i in 0..=columns {
                let after = column(i + 1);
                if before == after && before == [before[0]; 4] {
                    at += 1;
                    continue;
                }
                let corners: [u32; 8] =
                    std::array::from_fn(|corner| if corner & 1 == 0 { before } else { after }[corner >> 1]);
                for (first, id) in corners.into_iter().enumerate() {
                    let known = id == NONE || corners[..first].contains(&id);
                    if !known {
                        let inside = (0..8).filter(|corner| corners[*corner] == id).map(|corner| 1 << corner);
                        give(id, at, inside.sum());
                    }
                }
                (before, at) = (after, at + 1);
            }
        }
        Some(())
    }
}

/// The surfaces of a component. The first vertex is below the lowest layer of its cells, where no cavity is.
fn solid(component: Component, mesher: &Mesher<'_>, frame: &Frame<3>, stop: Stop<'_>) -> Option<Solid> {
    let mut mesh = mesher.mesh(component.faces, stop)?;
    for vertex in &mut mesh.vertices {
        *vertex = frame.to_world(*vertex);
    }
    if frame.determinant() < 0.0 {
        mesh.faces.iter_mut().for_each(|face| face.swap(1, 2));
    }
    let mut surfaces = apart(mesh).into_iter();
    let outer = surfaces.next()?;
    Some(Solid { component, outer, cavities: surfaces.collect() })
}

/// Makes the mesh of a component.
struct Mesher<'a> {
    level: Level<'a, 3>,
    size: [usize; 3],
    /// The cubes of the component, in increasing order.
    cubes: &'a [u64],
}

impl Mesher<'_> {
    /// The mesh, in index coordinates, with `faces` vertices between cells. `None` once `stop` returns true.
    fn mesh(&self, faces: usize, stop: Stop<'_>) -> Option<TriangleMesh> {
        /// Number of cubes between two questions whether to stop.
        const LOOK: usize = 4096;
        let keys = self.keys(faces);
        let mut vertices: Vec<[f64; 3]> = keys.iter().map(|key| self.point(*key)).collect();
        let mut triangles = Vec::new();
        for (step, cube) in self.cubes.iter().enumerate() {
            if step.is_multiple_of(LOOK) && stop() {
                return None;
            }
            let case = &CASES[(cube & 0xff) as usize];
            let centres = vertices.len() as u32;
            for ring in &case.centres {
                let points: Vec<[f64; 3]> =
                    ring.iter().map(|edge| vertices[self.vertex(&keys, *cube, *edge) as usize]).collect();
                let mean =
                    |axis: usize| points.iter().map(|point| point[axis]).sum::<f64>() / points.len() as f64;
                vertices.push(std::array::from_fn(mean));
            }
            triangles.extend(case.triangles.iter().map(|triangle| {
                triangle.map(|corner| match corner.checked_sub(EDGES) {
                    Some(centre) => centres + u32::from(centre),
                    None => self.vertex(&keys, *cube, corner),
                })
            }));
        }
        Some(TriangleMesh { vertices, normals: None, faces: triangles })
    }

    /// Crossed edges as `3 · cube + axis` with the cube of which they leave corner 0, in increasing order.
    fn keys(&self, faces: usize) -> Vec<u64> {
        let mut keys = Vec::with_capacity(faces);
        for cube in self.cubes {
            let inside = |corner: usize| cube >> corner & 1;
            let crossed = (0..3).filter(|axis| inside(0) != inside(1 << axis));
            keys.extend(crossed.map(|axis| 3 * (cube >> 8) + axis));
        }
        keys
    }

    /// The vertex on an edge of a cube. It is there because a cube beside an edge with one end inside is in the list.
    fn vertex(&self, keys: &[u64], cube: u64, edge: u8) -> u32 {
        let (axis, lower) = edge_ends(edge);
        let [columns, rows, _] = self.size.map(|size| size as u64 + 1);
        let [x, y, z] = [0, 1, 2].map(|axis| u64::from(lower >> axis & 1));
        let owner = (cube >> 8) + (z * rows + y) * columns + x;
        keys.partition_point(|key| *key < 3 * owner + axis as u64) as u32
    }

    /// Position of a vertex.
    fn point(&self, key: u64) -> [f64; 3] {
        let (cube, axis) = ((key / 3) as usize, (key % 3) as usize);
        let [columns, rows, _] = self.size.map(|size| size + 1);
        let lower =
            [cube % columns, cube / columns % rows, cube / columns / rows].map(|index| index as isize - 1);
        let mut upper = lower;
        upper[axis] += 1;
        let (inside, outside) = if self.level.holds(lower) { (lower, upper) } else { (upper, lower) };
        let part = self.level.part(inside, outside);
        std::array::from_fn(|c| inside[c] as f64 + part * (outside[c] - inside[c]) as f64)
    }
}

/// The connected surfaces of a mesh, in the order of their first vertices.
fn apart(mesh: TriangleMesh) -> Vec<Surface> {
    let surface_of = parts(&mesh);
    let count = surface_of.iter().max().map_or(0, |last| *last as usize + 1);
    let empty = || TriangleMesh { vertices: Vec::new(), normals: None, faces: Vec::new() };
    let mut meshes: Vec<TriangleMesh> = std::iter::repeat_with(empty).take(count).collect();
    let mut renamed = Vec::with_capacity(mesh.vertices.len());
    for (vertex, surface) in mesh.vertices.iter().zip(&surface_of) {
        let vertices = &mut meshes[*surface as usize].vertices;
        renamed.push(vertices.len() as u32);
        vertices.push(*vertex);
    }
    for face in mesh.faces {
        let surface = surface_of[face[0] as usize] as usize;
        meshes[surface].faces.push(face.map(|corner| renamed[corner as usize]));
    }
    meshes.into_iter().map(surface).collect()
}

/// Every edge of a closed mesh has two of the three sides of its faces.
fn surface(mesh: TriangleMesh) -> Surface {
    let euler = mesh.vertices.len() as i64 - (mesh.faces.len() / 2) as i64;
    Surface { mesh, euler }
}

/// For every vertex its surface, numbered in the order of their first vertices.
fn parts(mesh: &TriangleMesh) -> Vec<u32> {
    let mut sets = Sets::of_each(mesh.vertices.len() as u32);
    for [a, b, c] in &mesh.faces {
        sets.join(*a, *b);
        sets.join(*b, *c);
    }
    let (mut surfaces, mut count) = (vec![0; sets.len()], 0);
    for vertex in 0..sets.len() {
        let least = sets.least(vertex as u32) as usize;
        if least == vertex {
            surfaces[vertex] = count;
            count += 1;
        } else {
            surfaces[vertex] = surfaces[least];
        }
    }
    surfaces
}
