//! Control meshes of subdivision surfaces: named meshes and lists of faces.

use std::fmt;
use std::str::FromStr;

use super::{MeshSize, Scheme};
use crate::mesh::{Connectivity, MeshError, TriangleMesh};
use crate::vector::norm;

/// Control mesh, by name or as a list of faces.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "serde", serde(untagged))]
pub enum ControlMesh {
    /// A starting mesh: `tetrahedron`, `octahedron`, `icosahedron`, `sphere_grid` (14 vertices) or `pole_grid` (36 vertices,
    /// periodic in both directions), optionally followed by a slash and the number of splits: `octahedron/2` has 66
    /// vertices.
    #[cfg_attr(feature = "schema", schema(value_type = String, example = "octahedron/2"))]
    Named(StartMesh),
    /// Triangles by the indices of their corners among the control points, counter-clockwise as seen from outside.
    Faces(Vec<[u32; 3]>),
}

impl ControlMesh {
    /// Number of vertices, edges and faces. The number of vertices of a list of faces follows from its largest corner. Cost: for a
    /// list, sorting its edges.
    pub fn size(&self) -> MeshSize {
        match self {
            Self::Named(start) => start.size(),
            Self::Faces(faces) => MeshSize::of(vertices_of(faces), faces),
        }
    }

    /// Connectivity of the mesh, which must be closed.
    ///
    /// # Errors
    /// The first reason why the faces do not form a closed connected surface.
    pub fn connectivity(&self) -> Result<Connectivity, MeshError> {
        match self {
            Self::Named(start) => start.mesh().connectivity(),
            Self::Faces(faces) => Connectivity::new(vertices_of(faces), faces.clone()),
        }
    }

    /// Connectivity of the mesh for a scheme: with a boundary only where the scheme has rules for it.
    ///
    /// # Errors
    /// The first reason why the faces do not form such a connected surface.
    pub fn connectivity_of(&self, scheme: Scheme) -> Result<Connectivity, MeshError> {
        match self {
            Self::Named(start) => start.mesh().connectivity(),
            Self::Faces(faces) => scheme.connectivity(vertices_of(faces), faces.clone()),
        }
    }

    /// Positions on the unit sphere, for meshes named after an inscribed body.
    pub fn sphere(&self) -> Option<TriangleMesh> {
        match self {
            Self::Named(start) if start.body != Body::PoleGrid => Some(start.mesh()),
            _ => None,
        }
    }
}

/// Number of vertices of a list of faces: one more than its largest corner.
fn vertices_of(faces: &[[u32; 3]]) -> usize {
    faces.iter().flatten().max().map_or(0, |most| *most as usize + 1)
}

/// Body from which a starting mesh is split.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Body {
    /// 4 vertices of valence 3.
    Tetrahedron,
    /// 6 vertices of valence 4.
    Octahedron,
    /// 12 vertices of valence 5.
    Icosahedron,
    /// 14 vertices, six of valence 4 and eight of valence 6: the grid of step π/3 of a sphere with its poles.
    SphereGrid,
    /// 36 vertices of valence 6: the grid of step π/3 of a sphere from pole to pole and back, periodic in both directions. It
    /// is a torus that covers the sphere twice, once inside out.
    PoleGrid,
}

impl Body {
    /// All bodies.
    pub const ALL: [Self; 5] =
        [Self::Tetrahedron, Self::Octahedron, Self::Icosahedron, Self::SphereGrid, Self::PoleGrid];

    /// Name in requests and responses.
    pub fn name(self) -> &'static str {
        match self {
            Self::Tetrahedron => "tetrahedron",
            Self::Octahedron => "octahedron",
            Self::Icosahedron => "icosahedron",
            Self::SphereGrid => "sphere_grid",
            Self::PoleGrid => "pole_grid",
        }
    }

    fn size(self) -> MeshSize {
        let [vertices, faces] = match self {
            Self::Tetrahedron => [4, 4],
            Self::Octahedron => [6, 8],
            Self::Icosahedron => [12, 20],
            Self::SphereGrid => [14, 24],
            Self::PoleGrid => [36, 72],
        };
        MeshSize::closed(vertices, faces)
    }

    /// The mesh on the unit sphere, with faces counter-clockwise as seen from outside.
    fn mesh(self) -> TriangleMesh {
        let (vertices, faces) = match self {
            Self::Tetrahedron => tetrahedron(),
            Self::Octahedron => octahedron(),
            Self::Icosahedron => icosahedron(),
            Self::SphereGrid => sphere_grid(),
            Self::PoleGrid => pole_grid(),
        };
        TriangleMesh { vertices, normals: None, faces }
    }
}

type Solid = (Vec<[f64; 3]>, Vec<[u32; 3]>);

fn tetrahedron() -> Solid {
    let corners = [[1.0, 1.0, 1.0], [-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, -1.0, -1.0]];
    (corners.map(on_sphere).to_vec(), vec![[0, 1, 3], [0, 3, 2], [0, 2, 1], [1, 2, 3]])
}

fn octahedron() -> Solid {
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let vertices = axes.iter().flat_map(|axis| [*axis, axis.map(|x| 0.0 - x)]).collect();
    let north = [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4]];
    let south = [[2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    (vertices, [north, south].concat())
}

/// The corners of three golden rectangles.
fn icosahedron() -> Solid {
    let golden = 0.5 * (1.0 + 5.0_f64.sqrt());
    let signs = [[-1.0, 1.0], [1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]];
    let turned = |turns: usize, [a, b]: [f64; 2]| {
        let mut point = [a, b * golden, 0.0];
        point.rotate_right(turns);
        on_sphere(point)
    };
    let vertices = (0..3).flat_map(|turns| signs.map(|sign| turned(turns, sign))).collect();
    let faces = [
        [0, 11, 5],
        [0, 5, 1],
        [0, 1, 7],
        [0, 7, 10],
        [0, 10, 11],
        [1, 5, 9],
        [5, 11, 4],
        [11, 10, 2],
        [10, 7, 6],
        [7, 1, 8],
        [3, 9, 4],
        [3, 4, 2],
        [3, 2, 6],
        [3, 6, 8],
        [3, 8, 9],
        [4, 9, 5],
        [2, 4, 11],
        [6, 2, 10],
        [8, 6, 7],
        [9, 8, 1],
    ];
    (vertices, faces.to_vec())
}

/// Grid steps of the meshes with poles: `s_i = −π/2 + iπ/3` along the meridians and on over the pole, `t_j = jπ/3` around.
const STEPS: u32 = 6;

/// The point `(s_i, t_j)` of the unit sphere.
fn on_grid(i: u32, j: u32) -> [f64; 3] {
    let angle = |i: u32| f64::from(i) * std::f64::consts::FRAC_PI_3;
    let ((z, across), (sine, cosine)) =
        ((angle(i) - std::f64::consts::FRAC_PI_2).sin_cos(), angle(j).sin_cos());
    [across * cosine, across * sine, z]
}

/// The rows 0 to 3 of the grid, from the south pole to the north pole, each pole one vertex. The diagonals between the rows 1
/// and 2 alternate: then vertices have four or six neighbours, for which BLOB has rules. With parallel diagonals they have five.
fn sphere_grid() -> Solid {
    let (south, north) = (0, 2 * STEPS + 1);
    let rows = (1..3).flat_map(|i| (0..STEPS).map(move |j| on_grid(i, j)));
    let poles = [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]];
    let vertices = [poles[0]].into_iter().chain(rows).chain([poles[1]]).collect();
    let at = |i: u32, j: u32| 1 + STEPS * (i - 1) + j % STEPS;
    let column = |j: u32| {
        let [here, along, around, across] = [at(1, j), at(2, j), at(1, j + 1), at(2, j + 1)];
        let [one, other] = if j.is_multiple_of(2) {
            [[here, around, across], [here, across, along]]
        } else {
            [[here, around, along], [around, across, along]]
        };
        [[south, around, here], one, other, [north, along, across]]
    };
    (vertices, (0..STEPS).flat_map(column).collect())
}

/// The doubly periodic grid with step π/3. Its rows 0 to 3, with the first column repeated at the end, are the 28 points of the
/// sphere grid; diagonals run in the direction (1, 1). Faces point outwards where the rows run north.
fn pole_grid() -> Solid {
    let vertices = (0..STEPS).flat_map(|i| (0..STEPS).map(move |j| on_grid(i, j))).collect();
    let at = |i: u32, j: u32| STEPS * (i % STEPS) + j % STEPS;
    let cell = |i: u32, j: u32| {
        let [here, along, around, across] = [at(i, j), at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)];
        [[here, across, along], [here, around, across]]
    };
    (vertices, (0..STEPS).flat_map(|i| (0..STEPS).flat_map(move |j| cell(i, j))).collect())
}

fn on_sphere(point: [f64; 3]) -> [f64; 3] {
    let length = norm(point);
    point.map(|x| x / length)
}

/// A starting mesh: a body with a number of splits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(try_from = "String", into = "String"))]
pub struct StartMesh {
    /// The body.
    pub body: Body,
    /// Number of splits, at most [`MAX_SPLITS`].
    pub splits: usize,
}

/// Maximum number of splits: more than any memory holds is rejected with the name.
pub const MAX_SPLITS: usize = 15;

impl StartMesh {
    /// The starting mesh that covers the sphere once: the sphere grid in place of the pole grid.
    pub fn covering_once(self) -> Self {
        match self.body {
            Body::PoleGrid => Self { body: Body::SphereGrid, ..self },
            _ => self,
        }
    }

    /// Number of vertices and faces.
    pub fn size(self) -> MeshSize {
        self.body.size().split(self.splits)
    }

    /// The mesh with vertices on the unit sphere; for the pole grid, vertices added by splits are midpoints of edges.
    pub fn mesh(self) -> TriangleMesh {
        let mut mesh = self.body.mesh();
        for _ in 0..self.splits {
            mesh = split_on_sphere(&mesh, self.body != Body::PoleGrid);
        }
        mesh
    }
}

/// The mesh with a new vertex in the middle of every edge, projected to the unit sphere if `lifted`.
fn split_on_sphere(mesh: &TriangleMesh, lifted: bool) -> TriangleMesh {
    let connectivity = mesh.connectivity().expect("the starting meshes are closed");
    let middle = |&[a, b]: &[u32; 2]| {
        let [a, b] = [a, b].map(|vertex| mesh.vertices[vertex as usize]);
        let middle = [0, 1, 2].map(|c| 0.5 * (a[c] + b[c]));
        if lifted { on_sphere(middle) } else { middle }
    };
    let vertices = mesh.vertices.iter().copied().chain(connectivity.edges().iter().map(middle)).collect();
    TriangleMesh { vertices, normals: None, faces: connectivity.split_faces() }
}

impl fmt::Display for StartMesh {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.body.name())?;
        if self.splits > 0 { write!(f, "/{}", self.splits) } else { Ok(()) }
    }
}

impl FromStr for StartMesh {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, splits) = text.split_once('/').unwrap_or((text, "0"));
        let body = Body::ALL.into_iter().find(|body| body.name() == name);
        let splits = splits.parse().ok().filter(|splits| *splits <= MAX_SPLITS);
        body.zip(splits).map(|(body, splits)| Self { body, splits }).ok_or_else(|| {
            let names = Body::ALL.map(|body| format!("\"{}\"", body.name())).join(", ");
            format!(
                "expected one of {names}, with up to {MAX_SPLITS} splits after a slash (such as \
                 \"octahedron/2\"), got \"{text}\""
            )
        })
    }
}

impl TryFrom<String> for StartMesh {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<StartMesh> for String {
    fn from(start: StartMesh) -> Self {
        start.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vector::{dot, minus};

    #[test]
    fn starting_meshes_are_closed_and_seen_from_outside() {
        for (text, vertices, genus) in [
            ("tetrahedron", 4, 0),
            ("octahedron", 6, 0),
            ("octahedron/1", 18, 0),
            ("octahedron/2", 66, 0),
            ("octahedron/3", 258, 0),
            ("icosahedron/2", 162, 0),
            ("sphere_grid", 14, 0),
            ("sphere_grid/2", 194, 0),
            ("pole_grid", 36, 1),
        ] {
            let start: StartMesh = text.parse().unwrap();
            let mesh = start.mesh();
            assert_eq!((mesh.vertices.len(), mesh.faces.len()), (vertices, start.size().faces), "{text}");
            assert_eq!(mesh.connectivity().unwrap().genus(), genus, "{text}");
            assert!(mesh.vertices.iter().all(|vertex| (norm(*vertex) - 1.0).abs() < 1e-15), "{text}");
            assert_eq!(start.to_string(), text);
            if genus == 0 {
                for (face, normal) in mesh.faces.iter().zip(mesh.face_normals()) {
                    assert!(dot(normal, mesh.vertices[face[0] as usize]) > 0.0, "{text}");
                }
            }
        }
    }

    #[test]
    fn the_sphere_grid_suits_every_scheme() {
        let mesh = Body::SphereGrid.mesh();
        let connectivity = mesh.connectivity().unwrap();
        let valences: Vec<usize> = (0..14).map(|vertex| connectivity.valence(vertex)).collect();
        assert_eq!(valences, [6, 6, 4, 6, 4, 6, 4, 4, 6, 4, 6, 4, 6, 6]);
        let once: StartMesh = "pole_grid/1".parse().unwrap();
        assert_eq!(once.covering_once().to_string(), "sphere_grid/1");
    }

    #[test]
    fn edges_of_bodies_are_all_alike() {
        for body in [Body::Tetrahedron, Body::Octahedron, Body::Icosahedron] {
            let mesh = body.mesh();
            let lengths = mesh.faces.iter().flat_map(|&[a, b, c]| {
                [[a, b], [b, c], [c, a]]
                    .map(|[a, b]| norm(minus(mesh.vertices[a as usize], mesh.vertices[b as usize])))
            });
            let lengths: Vec<f64> = lengths.collect();
            assert!(lengths.iter().all(|length| (length - lengths[0]).abs() < 1e-15), "{body:?}");
        }
    }

    #[test]
    fn names_that_are_none_are_refused() {
        for text in ["cube", "octahedron/", "octahedron/16", "octahedron/-1", "", "octahedron/2/3"] {
            assert!(text.parse::<StartMesh>().is_err(), "{text}");
        }
    }
}
