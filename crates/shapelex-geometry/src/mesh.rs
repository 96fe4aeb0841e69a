//! Triangle meshes: vertices and faces, connectivity of closed meshes and of those with a boundary, volume and area.

use super::vector::{cross, dot, minus, norm};

/// A triangle mesh; faces are counter-clockwise as seen from outside.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct TriangleMesh {
    /// Positions of the vertices.
    pub vertices: Vec<[f64; 3]>,
    /// Outward unit normals of the vertices; zero where a normal is undefined. `None` for a one-sided surface.
    pub normals: Option<Vec<[f64; 3]>>,
    /// Indices of the three vertices of every face.
    pub faces: Vec<[u32; 3]>,
}

/// Reason why a mesh is not a closed surface with an outside.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MeshError {
    /// The mesh has no faces.
    #[error("the mesh has no faces")]
    Empty,
    /// A corner of a face is not a vertex.
    #[error("expected vertices below {count}, face {face} has vertex {vertex}")]
    NoVertex {
        /// Position of the face.
        face: usize,
        /// The index of the corner.
        vertex: u32,
        /// Number of vertices.
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
    /// Two faces traverse an edge in the same direction.
    #[error(
        "faces {first} and {second} both run from vertex {} to vertex {}: one of them is flipped, or more than \
         two faces meet at this edge",
        edge[0], edge[1]
    )]
    Twice {
        /// The first face.
        first: usize,
        /// The second face.
        second: usize,
        /// Start and end of the edge.
        edge: [u32; 2],
    },
    /// An edge has a face on one side only.
    #[error("the edge of face {face} from vertex {} to vertex {} has no face on its other side", edge[0], edge[1])]
    Open {
        /// The face.
        face: usize,
        /// Start and end of the edge.
        edge: [u32; 2],
    },
    /// A vertex belongs to no face.
    #[error("vertex {vertex} belongs to no face")]
    Unused {
        /// Position of the vertex.
        vertex: u32,
    },
    /// The faces around a vertex form several fans.
    #[error("the faces around vertex {vertex} meet only there: several vertices share one place")]
    Pinched {
        /// Position of the vertex.
        vertex: u32,
    },
    /// The mesh is not connected.
    #[error("the mesh is not connected: only {reached} of {count} vertices can be reached from vertex 0")]
    Apart {
        /// Number of vertices connected to the first.
        reached: usize,
        /// Number of all vertices.
        count: usize,
    },
}

impl MeshError {
    /// The faulty face, if the fault is that of a face.
    pub fn face(&self) -> Option<usize> {
        match self {
            Self::NoVertex { face, .. } | Self::Degenerate { face, .. } | Self::Open { face, .. } => {
                Some(*face)
            }
            Self::Twice { second, .. } => Some(*second),
            Self::Empty | Self::Unused { .. } | Self::Pinched { .. } | Self::Apart { .. } => None,
        }
    }
}

/// Edges of a connected mesh, closed or with a boundary, with the faces and vertices that meet there.
///
/// Half-edge `3f + i` runs from corner `i` of face `f` to the next corner. Edges are pairs `(least, greatest)` of vertices,
/// numbered in lexicographic order. An edge of the boundary has one half-edge only. The faces around a vertex of the boundary form one
/// fan, which begins and ends there.
#[derive(Debug, Clone)]
pub struct Connectivity {
    faces: Vec<[u32; 3]>,
    edges: Vec<[u32; 2]>,
    /// For every half-edge, the opposite one; [`NONE`] on the boundary.
    twins: Vec<u32>,
    /// For every half-edge, its edge.
    edge_of: Vec<u32>,
    /// For every vertex, a half-edge that starts there; on the boundary, the one without a face to its right.
    first: Vec<u32>,
    /// Number of half-edges without an opposite one.
    open: usize,
}

impl TriangleMesh {
    /// Checks that the corners of every face are three different vertices.
    ///
    /// # Errors
    /// [`MeshError::NoVertex`], [`MeshError::Degenerate`].
    pub fn check_faces(&self) -> Result<(), MeshError> {
        check_faces(self.vertices.len(), &self.faces)
    }

    /// `(b − a) × (c − a)` for every face: an outward normal of twice the area as length.
    pub fn face_normals(&self) -> Vec<[f64; 3]> {
        let normal = |face: &[u32; 3]| {
            let [a, b, c] = face.map(|vertex| self.vertices[vertex as usize]);
            cross(minus(b, a), minus(c, a))
        };
        self.faces.iter().map(normal).collect()
    }

    /// Connectivity of a closed connected mesh: see [`Connectivity::new`].
    ///
    /// # Errors
    /// The first reason why the mesh is not closed and connected.
    pub fn connectivity(&self) -> Result<Connectivity, MeshError> {
        Connectivity::new(self.vertices.len(), self.faces.clone())
    }

    /// Volume enclosed by a closed mesh: `⅙ Σ det(a, b, c)` about its first vertex. Positive if its faces are counter-clockwise
    /// as seen from outside. Cost: one pass over the faces.
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

fn check_faces(count: usize, faces: &[[u32; 3]]) -> Result<(), MeshError> {
    for (face, &[a, b, c]) in faces.iter().enumerate() {
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

/// No half-edge.
const NONE: u32 = u32::MAX;

/// Marks a half-edge that is read from its end. Meshes have fewer half-edges than this.
const BACKWARDS: u32 = 1 << 31;

/// Start and end of a half-edge.
fn ends(faces: &[[u32; 3]], half_edge: usize) -> [u32; 2] {
    let (face, corner) = (faces[half_edge / 3], half_edge % 3);
    [face[corner], face[(corner + 1) % 3]]
}

/// Half-edges of every edge as `greatest << 32 | half-edge`, grouped by their least vertex and sorted within a group, with
/// the starts of the groups.
fn by_edge(count: usize, faces: &[[u32; 3]]) -> (Vec<u64>, Vec<usize>) {
    let mut starts = vec![0; count + 1];
    let half_edges = 0..3 * faces.len();
    let least_and_greatest = |half_edge: usize| {
        let [from, to] = ends(faces, half_edge);
        (from.min(to) as usize, u64::from(from.max(to)))
    };
    half_edges.clone().for_each(|h| starts[least_and_greatest(h).0 + 1] += 1);
    (0..count).for_each(|vertex| starts[vertex + 1] += starts[vertex]);
    let (mut sorted, mut next) = (vec![0; 3 * faces.len()], starts.clone());
    for half_edge in half_edges {
        let (least, greatest) = least_and_greatest(half_edge);
        sorted[next[least]] = greatest << 32 | half_edge as u64;
        next[least] += 1;
    }
    for vertex in 0..count {
        sorted[starts[vertex]..starts[vertex + 1]].sort_unstable();
    }
    (sorted, starts)
}

impl Connectivity {
    /// Connectivity of `count` vertices and `faces`, which must form a connected surface, with or without a boundary. Cost
    /// `O(faces)`.
    ///
    /// # Errors
    /// The first reason why they do not, in the order of [`MeshError`] and of the faces.
    pub fn with_boundary(count: usize, faces: Vec<[u32; 3]>) -> Result<Self, MeshError> {
        let connectivity = Self::joined_faces(count, faces)?;
        connectivity.check_vertices()?;
        Ok(connectivity)
    }

    /// As [`Self::with_boundary`], for a surface that must be closed.
    ///
    /// # Errors
    /// As for [`Self::with_boundary`], and the first edge with a face on one side only.
    pub fn new(count: usize, faces: Vec<[u32; 3]>) -> Result<Self, MeshError> {
        let connectivity = Self::joined_faces(count, faces)?;
        if let Some(half_edge) = connectivity.twins.iter().position(|twin| *twin == NONE) {
            return Err(MeshError::Open { face: half_edge / 3, edge: ends(&connectivity.faces, half_edge) });
        }
        connectivity.check_vertices()?;
        Ok(connectivity)
    }

    fn joined_faces(count: usize, faces: Vec<[u32; 3]>) -> Result<Self, MeshError> {
        check_faces(count, &faces)?;
        if faces.is_empty() {
            return Err(MeshError::Empty);
        }
        Self::joined(count, faces)
    }

    /// Pairs the half-edges of faces whose corners are vertices.
    fn joined(count: usize, faces: Vec<[u32; 3]>) -> Result<Self, MeshError> {
        let (sorted, starts) = by_edge(count, &faces);
        let (mut twins, mut edge_of) = (vec![NONE; sorted.len()], vec![0; sorted.len()]);
        let mut edges = Vec::with_capacity(sorted.len() / 2);
        let half_edge = |key: u64| (key & u64::from(u32::MAX)) as usize;
        let (mut twice, mut open): (Option<[usize; 2]>, usize) = (None, 0);
        for least in 0..count {
            for edge in sorted[starts[least]..starts[least + 1]].chunk_by(|a, b| a >> 32 == b >> 32) {
                let greatest = (edge[0] >> 32) as u32;
                let runs_up = |half_edge: &usize| faces[half_edge / 3][half_edge % 3] == least as u32;
                if let &[one, other] = edge {
                    let [one, other] = [one, other].map(half_edge);
                    if runs_up(&one) != runs_up(&other) {
                        (twins[one], twins[other]) = (other as u32, one as u32);
                        (edge_of[one], edge_of[other]) = (edges.len() as u32, edges.len() as u32);
                        edges.push([least as u32, greatest]);
                        continue;
                    }
                }
                let (up, down): (Vec<usize>, Vec<usize>) =
                    edge.iter().copied().map(half_edge).partition(runs_up);
                // The first pair in the order of the faces, so that the error is deterministic.
                for same in [&up, &down] {
                    if let [first, second, ..] = same[..] {
                        twice = Some(twice.map_or([second, first], |found| found.min([second, first])));
                    }
                }
                if let ([one], []) | ([], [one]) = (&up[..], &down[..]) {
                    edge_of[*one] = edges.len() as u32;
                    edges.push([least as u32, greatest]);
                    open += 1;
                }
            }
        }
        if let Some([second, first]) = twice {
            let edge = ends(&faces, second);
            return Err(MeshError::Twice { first: first / 3, second: second / 3, edge });
        }
        let mut first = vec![NONE; count];
        for (face, corners) in faces.iter().enumerate() {
            for corner in 0..3 {
                let (half_edge, start) = (3 * face + corner, &mut first[corners[corner] as usize]);
                if *start == NONE || open == 0 || twins[*start as usize] != NONE {
                    *start = half_edge as u32;
                }
            }
        }
        Ok(Self { faces, edges, twins, edge_of, first, open })
    }

    /// Checks that every vertex has a single fan of faces, and that the mesh is connected.
    fn check_vertices(&self) -> Result<(), MeshError> {
        let count = self.vertices();
        let mut degree = vec![0_usize; count];
        self.faces.iter().flatten().for_each(|corner| degree[*corner as usize] += 1);
        if let Some(vertex) = degree.iter().position(|degree| *degree == 0) {
            return Err(MeshError::Unused { vertex: vertex as u32 });
        }
        if let Some(vertex) = (0..count).find(|&v| self.around(v as u32).count() != degree[v]) {
            return Err(MeshError::Pinched { vertex: vertex as u32 });
        }
        let reached = self.distances(0).iter().flatten().count();
        if reached < count { Err(MeshError::Apart { reached, count }) } else { Ok(()) }
    }

    /// Number of vertices.
    pub fn vertices(&self) -> usize {
        self.first.len()
    }

    /// The faces.
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// The edges, in lexicographic order.
    pub fn edges(&self) -> &[[u32; 2]] {
        &self.edges
    }

    /// The half-edges that start at a vertex, counter-clockwise as seen from outside.
    pub fn around(&self, vertex: u32) -> impl Iterator<Item = u32> + '_ {
        self.around_from(self.first[vertex as usize])
    }

    fn around_from(&self, half_edge: u32) -> impl Iterator<Item = u32> + '_ {
        let after =
            move |h: &u32| Some(self.twin(before(*h))).filter(|next| *next != half_edge && *next != NONE);
        std::iter::successors(Some(half_edge), after)
    }

    /// The neighbours of a vertex, counter-clockwise as seen from outside; on the boundary, from one of its edges to the other.
    pub fn ring(&self, vertex: u32) -> impl Iterator<Item = u32> + '_ {
        self.ring_from(self.first[vertex as usize])
    }

    /// The neighbours of the vertex where a half-edge starts, beginning with its other end. At a vertex of the boundary, these
    /// are all of them for its first half-edge only.
    pub fn ring_from(&self, half_edge: u32) -> impl Iterator<Item = u32> + '_ {
        let mut next = Some(half_edge);
        std::iter::from_fn(move || {
            let here = next?;
            if here & BACKWARDS != 0 {
                next = None;
                return Some(ends(&self.faces, (here & !BACKWARDS) as usize)[0]);
            }
            let incoming = before(here);
            next = match self.twin(incoming) {
                NONE => Some(incoming | BACKWARDS),
                after => Some(after).filter(|after| *after != half_edge),
            };
            Some(self.end(here))
        })
    }

    /// Whether no edge is on a boundary.
    pub fn is_closed(&self) -> bool {
        self.open == 0
    }

    /// Whether a vertex is on the boundary.
    pub fn is_on_boundary(&self, vertex: u32) -> bool {
        self.twin(self.first[vertex as usize]) == NONE
    }

    /// The corner of the face of a half-edge that is on neither of its ends.
    pub fn opposite(&self, half_edge: u32) -> u32 {
        ends(&self.faces, before(half_edge) as usize)[0]
    }

    /// The opposite half-edge; `u32::MAX` on the boundary.
    pub fn twin(&self, half_edge: u32) -> u32 {
        self.twins[half_edge as usize]
    }

    /// The vertex where a half-edge ends.
    pub fn end(&self, half_edge: u32) -> u32 {
        ends(&self.faces, half_edge as usize)[1]
    }

    /// Number of neighbours of a vertex.
    pub fn valence(&self, vertex: u32) -> usize {
        self.ring(vertex).count()
    }

    /// The half-edges of an edge; the one from its least vertex comes first. On the boundary, the only one twice.
    pub fn sides(&self, edge: usize) -> [u32; 2] {
        let [least, greatest] = self.edges[edge];
        let from = |start: u32, end: u32| self.around(start).find(|half_edge| self.end(*half_edge) == end);
        match (from(least, greatest), from(greatest, least)) {
            (Some(forth), Some(back)) => [forth, back],
            (forth, back) => [forth.or(back).unwrap_or_default(); 2],
        }
    }

    /// The half-edges of all edges: see [`Self::sides`].
    pub fn half_edges(&self) -> Vec<[u32; 2]> {
        let mut pairs = vec![[NONE; 2]; self.edges.len()];
        for (half_edge, edge) in self.edge_of.iter().enumerate() {
            let (backwards, pair) =
                (ends(&self.faces, half_edge)[0] != self.edges[*edge as usize][0], *edge as usize);
            pairs[pair][usize::from(backwards)] = half_edge as u32;
            if self.twins[half_edge] == NONE {
                pairs[pair] = [half_edge as u32; 2];
            }
        }
        pairs
    }

    /// The faces after a split with a new vertex on every edge. In a mesh of `n` vertices, edge `e` gets vertex `n + e`, and face
    /// `(a, b, c)` becomes `(a, ab, ca)`, `(ab, b, bc)`, `(ca, bc, c)`, `(ab, bc, ca)`.
    pub fn split_faces(&self) -> Vec<[u32; 3]> {
        let mut faces = Vec::with_capacity(4 * self.faces.len());
        for (face, &[a, b, c]) in self.faces.iter().enumerate() {
            let [ab, bc, ca] = [0, 1, 2].map(|i| self.vertices() as u32 + self.edge_of[3 * face + i]);
            faces.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        faces
    }

    /// The mesh with a new vertex on every edge: see [`Self::split_faces`].
    pub fn split(&self) -> Self {
        Self::joined(self.vertices() + self.edges.len(), self.split_faces())
            .expect("the parts of the faces of a surface join as the faces do")
    }

    /// Genus, the number of handles: 0 for a sphere and a disc, 1 for a torus.
    pub fn genus(&self) -> usize {
        // V − E + F = 2 − 2g − b.
        let handles_twice = (2 + self.edges.len()).saturating_sub(self.vertices() + self.faces.len());
        handles_twice.saturating_sub(self.boundaries()) / 2
    }

    /// Number of closed loops of edges that the boundary consists of. Cost `O(faces)`.
    pub fn boundaries(&self) -> usize {
        let mut seen = vec![false; self.vertices()];
        let mut loops = 0;
        for start in (0..self.twins.len() as u32).filter(|half_edge| self.twin(*half_edge) == NONE) {
            let mut half_edge = start;
            loops += usize::from(!seen[ends(&self.faces, start as usize)[0] as usize]);
            while !std::mem::replace(&mut seen[ends(&self.faces, half_edge as usize)[0] as usize], true) {
                half_edge = self.first[self.end(half_edge) as usize];
            }
        }
        loops
    }

    /// Number of edges from `start` to every vertex; `None` for vertices that cannot be reached.
    pub fn distances(&self, start: u32) -> Vec<Option<u32>> {
        let mut distances = vec![None; self.vertices()];
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
                let distance = &mut distances[neighbour as usize];
                if distance.is_none() {
                    *distance = Some(steps);
                    next.push(neighbour);
                }
            }
            front = next;
        }
        distances
    }
}

/// The previous half-edge of the same face.
fn before(half_edge: u32) -> u32 {
    if half_edge.is_multiple_of(3) { half_edge + 2 } else { half_edge - 1 }
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
        let mut ring: Vec<u32> = connectivity.ring(3).collect();
        let least = ring.iter().position(|vertex| *vertex == 0).unwrap();
        ring.rotate_left(least);
        assert_eq!(ring, [0, 1, 2]);
        assert!((mesh.signed_volume() - 1.0 / 6.0).abs() < 1e-15);
        assert!((mesh.face_areas().iter().sum::<f64>() - 1.5 - 0.75_f64.sqrt()).abs() < 1e-15);
    }

    #[test]
    fn surfaces_with_a_boundary_have_fans_at_it() {
        // A fan of four faces about vertex 0: its rim is open, its centre is not.
        let fan: Vec<[u32; 3]> = vec![[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]];
        assert_eq!(Connectivity::new(5, fan.clone()).unwrap_err(), MeshError::Open { face: 0, edge: [1, 2] });
        let disc = Connectivity::with_boundary(5, fan.clone()).unwrap();
        assert!(!disc.is_closed() && !disc.is_on_boundary(0) && (1..5).all(|v| disc.is_on_boundary(v)));
        assert_eq!((disc.edges().len(), disc.genus(), disc.boundaries()), (8, 0, 1));
        // From one edge of the boundary to the other, counter-clockwise.
        assert_eq!(disc.ring(2).collect::<Vec<_>>(), [3, 0, 1]);
        assert_eq!((disc.valence(2), disc.around(2).count(), disc.valence(0)), (3, 2, 4));
        for (edge, pair) in disc.half_edges().into_iter().enumerate() {
            assert_eq!(disc.sides(edge), pair, "{edge}");
            assert_eq!(pair[0] == pair[1], !disc.edges()[edge].contains(&0), "{edge}");
        }
        let finer = disc.split();
        assert_eq!((finer.vertices(), finer.edges().len(), finer.faces().len()), (13, 28, 16));
        assert_eq!((finer.genus(), finer.boundaries()), (0, 1));
        // A band of four faces is a ring with two boundaries; one face is a disc.
        let band = vec![[0, 1, 3], [1, 4, 3], [1, 2, 4], [2, 5, 4], [2, 0, 5], [0, 3, 5]];
        let band = Connectivity::with_boundary(6, band).unwrap();
        assert_eq!((band.genus(), band.boundaries()), (0, 2));
        let one = Connectivity::with_boundary(3, vec![[0, 1, 2]]).unwrap();
        assert_eq!((one.genus(), one.boundaries(), one.valence(1)), (0, 1, 2));
        // Two faces that share a vertex only, and three at an edge.
        let bow = Connectivity::with_boundary(5, vec![[0, 1, 2], [0, 3, 4]]);
        assert_eq!(bow.unwrap_err(), MeshError::Pinched { vertex: 0 });
        let three = Connectivity::with_boundary(5, vec![[0, 1, 2], [1, 0, 3], [0, 1, 4]]);
        assert_eq!(three.unwrap_err(), MeshError::Twice { first: 0, second: 2, edge: [0, 1] });
        let turned = Connectivity::with_boundary(4, vec![[0, 1, 2], [0, 1, 3]]);
        assert_eq!(turned.unwrap_err(), MeshError::Twice { first: 0, second: 1, edge: [0, 1] });
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
        assert_eq!(TriangleMesh::default().connectivity().unwrap_err(), MeshError::Empty);
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
