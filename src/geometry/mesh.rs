//! Triangle meshes: what they are made of, whether they close, what they enclose.

use std::collections::HashMap;

use super::vector::{cross, dot, minus, norm};

/// Vertices, and triangles between them that are seen counter-clockwise from outside.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TriangleMesh {
    /// Positions.
    pub vertices: Vec<[f64; 3]>,
    /// Unit normals of the vertices, outwards; zero where there is none. None when the surface has one side only.
    pub normals: Option<Vec<[f64; 3]>>,
    /// Positions of the vertices in their list.
    pub faces: Vec<[u32; 3]>,
}

/// Why a mesh is not a closed surface with an outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum MeshError {
    /// A corner of a face is no vertex.
    #[error("face {face} has vertex {vertex}, of {count}")]
    NoVertex {
        /// Position of the face.
        face: usize,
        /// What it asks for.
        vertex: u32,
        /// Vertices that there are.
        count: usize,
    },
    /// A face has a vertex twice.
    #[error("face {face} has vertex {vertex} twice")]
    Degenerate {
        /// Position of the face.
        face: usize,
        /// The vertex.
        vertex: u32,
    },
    /// Two faces run along an edge in the same direction.
    #[error(
        "faces {first} and {second} both run from vertex {} to vertex {}: one of them is flipped, or a third one meets them there",
        edge[0], edge[1]
    )]
    Twice {
        /// The one.
        first: usize,
        /// The other.
        second: usize,
        /// From where to where.
        edge: [u32; 2],
    },
    /// An edge has a face on one side only.
    #[error("the edge of face {face} from vertex {} to vertex {} has no face on its other side", edge[0], edge[1])]
    Open {
        /// The face.
        face: usize,
        /// From where to where.
        edge: [u32; 2],
    },
    /// No face has the vertex.
    #[error("vertex {vertex} belongs to no face")]
    Unused {
        /// Position of the vertex.
        vertex: u32,
    },
    /// The faces round a vertex are several fans.
    #[error("the faces round vertex {vertex} meet there only: it is several vertices in one place")]
    Pinched {
        /// Position of the vertex.
        vertex: u32,
    },
    /// Several surfaces in one mesh.
    #[error("the mesh falls apart: {reached} of {count} vertices hang together with the first")]
    Apart {
        /// Vertices that hang together.
        reached: usize,
        /// All vertices.
        count: usize,
    },
}

impl MeshError {
    /// The face that is wrong, when it is one.
    pub fn face(&self) -> Option<usize> {
        match self {
            Self::NoVertex { face, .. } | Self::Degenerate { face, .. } | Self::Open { face, .. } => {
                Some(*face)
            }
            Self::Twice { second, .. } => Some(*second),
            Self::Unused { .. } | Self::Pinched { .. } | Self::Apart { .. } => None,
        }
    }
}

/// Which vertices are neighbours in a closed mesh.
#[derive(Debug, Clone)]
pub struct Connectivity {
    /// Neighbours of every vertex, counter-clockwise seen from outside.
    rings: Vec<Vec<u32>>,
    faces: usize,
}

impl TriangleMesh {
    /// Checks that the corners of every face are three vertices.
    ///
    /// # Errors
    /// [`MeshError::NoVertex`], [`MeshError::Degenerate`].
    pub fn check_faces(&self) -> Result<(), MeshError> {
        let count = self.vertices.len();
        for (face, &[a, b, c]) in self.faces.iter().enumerate() {
            for (vertex, next) in [(a, b), (b, c), (c, a)] {
                if vertex as usize >= count {
                    return Err(MeshError::NoVertex { face, vertex, count });
                }
                if vertex == next {
                    return Err(MeshError::Degenerate { face, vertex });
                }
            }
        }
        Ok(())
    }

    /// `(b − a) × (c − a)` of the faces: outwards, twice as long as their areas.
    pub fn face_normals(&self) -> Vec<[f64; 3]> {
        let normal = |face: &[u32; 3]| {
            let [a, b, c] = face.map(|vertex| self.vertices[vertex as usize]);
            cross(minus(b, a), minus(c, a))
        };
        self.faces.iter().map(normal).collect()
    }

    /// The neighbours of the vertices of a closed mesh in one piece. Cost `O(faces)`.
    ///
    /// # Errors
    /// The first reason why it is not one.
    pub fn connectivity(&self) -> Result<Connectivity, MeshError> {
        self.check_faces()?;
        let count = self.vertices.len();
        let mut face_of: HashMap<[u32; 2], usize> = HashMap::with_capacity(3 * self.faces.len());
        // Round a vertex, seen from outside, the neighbour after each.
        let mut after: HashMap<[u32; 2], u32> = HashMap::with_capacity(3 * self.faces.len());
        let mut some: Vec<Option<u32>> = vec![None; count];
        let mut degree = vec![0_usize; count];
        for (face, &[a, b, c]) in self.faces.iter().enumerate() {
            for (from, to, third) in [(a, b, c), (b, c, a), (c, a, b)] {
                if let Some(first) = face_of.insert([from, to], face) {
                    return Err(MeshError::Twice { first, second: face, edge: [from, to] });
                }
                after.insert([from, to], third);
                some[from as usize] = Some(to);
                degree[from as usize] += 1;
            }
        }
        // In the order of the faces, so that the same mesh always gets the same answer.
        for (face, &[a, b, c]) in self.faces.iter().enumerate() {
            for [from, to] in [[a, b], [b, c], [c, a]] {
                if !face_of.contains_key(&[to, from]) {
                    return Err(MeshError::Open { face, edge: [from, to] });
                }
            }
        }
        let mut rings = Vec::with_capacity(count);
        for (vertex, first) in some.iter().enumerate() {
            let vertex = vertex as u32;
            let first = first.ok_or(MeshError::Unused { vertex })?;
            let mut ring = vec![first];
            while let Some(&next) = after.get(&[vertex, ring[ring.len() - 1]]) {
                if next == first {
                    break;
                }
                ring.push(next);
            }
            if ring.len() != degree[vertex as usize] {
                return Err(MeshError::Pinched { vertex });
            }
            rings.push(ring);
        }
        let connectivity = Connectivity { rings, faces: self.faces.len() };
        let reached = connectivity.distances(0).iter().flatten().count();
        if reached < count {
            return Err(MeshError::Apart { reached, count });
        }
        Ok(connectivity)
    }

    /// Volume within a closed mesh, positive when its faces are seen counter-clockwise from outside: `⅙ Σ det(a, b, c)` about
    /// its first vertex. Cost: one pass over the faces.
    pub fn signed_volume(&self) -> f64 {
        let Some(origin) = self.vertices.first() else { return 0.0 };
        let six_fold = |face: &[u32; 3]| {
            let [a, b, c] = face.map(|vertex| minus(self.vertices[vertex as usize], *origin));
            dot(a, cross(b, c))
        };
        self.faces.iter().map(six_fold).sum::<f64>() / 6.0
    }

    /// Areas of the faces.
    pub fn face_areas(&self) -> Vec<f64> {
        self.face_normals().into_iter().map(|normal| 0.5 * norm(normal)).collect()
    }
}

impl Connectivity {
    /// Neighbours of a vertex, counter-clockwise seen from outside.
    pub fn ring(&self, vertex: u32) -> &[u32] {
        &self.rings[vertex as usize]
    }

    /// Number of handles: 0 for a sphere, 1 for a torus.
    pub fn genus(&self) -> usize {
        // V − E + F = 2 − 2g, and E = 3F/2.
        (2 + self.faces / 2).saturating_sub(self.rings.len()) / 2
    }

    /// Edges from `start` to every vertex; none for those that cannot be reached.
    pub fn distances(&self, start: u32) -> Vec<Option<u32>> {
        let mut distances = vec![None; self.rings.len()];
        let mut front = Vec::new();
        if let Some(first) = distances.get_mut(start as usize) {
            *first = Some(0);
            front.push(start);
        }
        let mut steps = 0;
        while !front.is_empty() {
            steps += 1;
            let mut next = Vec::new();
            for neighbour in front.iter().flat_map(|vertex| self.ring(*vertex)) {
                let distance = &mut distances[*neighbour as usize];
                if distance.is_none() {
                    *distance = Some(steps);
                    next.push(*neighbour);
                }
            }
            front = next;
        }
        distances
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A tetrahedron of volume 1/6.
    fn tetrahedron() -> TriangleMesh {
        TriangleMesh {
            vertices: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            normals: None,
            faces: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
        }
    }

    #[test]
    fn a_tetrahedron_is_a_sphere() {
        let mesh = tetrahedron();
        let connectivity = mesh.connectivity().unwrap();
        assert_eq!(connectivity.genus(), 0);
        let mut ring = connectivity.ring(3).to_vec();
        let least = ring.iter().position(|vertex| *vertex == 0).unwrap();
        ring.rotate_left(least);
        assert_eq!(ring, [0, 1, 2]);
        assert!((mesh.signed_volume() - 1.0 / 6.0).abs() < 1e-15);
        assert!((mesh.face_areas().iter().sum::<f64>() - 1.5 - 0.75_f64.sqrt()).abs() < 1e-15);
    }

    #[test]
    fn what_is_no_closed_surface_is_named() {
        let broken = |change: &dyn Fn(&mut TriangleMesh)| {
            let mut mesh = tetrahedron();
            change(&mut mesh);
            mesh.connectivity().unwrap_err()
        };
        let flipped = broken(&|mesh| mesh.faces[2] = [2, 1, 3]);
        assert_eq!(flipped, MeshError::Twice { first: 0, second: 2, edge: [2, 1] });
        assert_eq!(broken(&|mesh| mesh.faces.truncate(3)), MeshError::Open { face: 0, edge: [0, 2] });
        let beyond = broken(&|mesh| mesh.faces[1][2] = 9);
        assert_eq!(beyond, MeshError::NoVertex { face: 1, vertex: 9, count: 4 });
        assert_eq!(broken(&|mesh| mesh.faces[3] = [0, 0, 3]), MeshError::Degenerate { face: 3, vertex: 0 });
        assert_eq!(broken(&|mesh| mesh.vertices.push([9.0; 3])), MeshError::Unused { vertex: 4 });
        let second = |mesh: &mut TriangleMesh, shift: u32| {
            let other: Vec<[u32; 3]> = mesh.faces.iter().map(|face| face.map(|v| v + shift)).collect();
            mesh.faces.extend(other);
            mesh.vertices.extend(vec![[5.0; 3]; shift as usize]);
        };
        assert_eq!(broken(&|mesh| second(mesh, 4)), MeshError::Apart { reached: 4, count: 8 });
        assert_eq!(broken(&|mesh| second(mesh, 3)), MeshError::Pinched { vertex: 3 });
    }
}
