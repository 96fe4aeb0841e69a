//! Triangle mesh files for other programs.
//!
//! | format | what | numbers |
//! |---|---|---|
//! | OBJ | text of Wavefront, with normals and texture coordinates | all digits |
//! | PLY | binary, little-endian, with normals | double precision |
//! | STL | binary, without shared vertices | single precision |
//! | glTF | one binary file (GLB 2.0) with one mesh, with normals and texture coordinates | single precision |
//!
//! Texture coordinates are those of surfaces with two parameters, see [`texture`](crate::geometry::texture): `u` to the right, `v` down.
//! OBJ has a place for every corner of a face, glTF one for every vertex: there, the vertices of a closed direction and of poles are
//! repeated. Several meshes of an OBJ are objects with names.
//!
//! Single precision is inaccurate far from the origin: use STL and glTF for display, OBJ and PLY for data.

use std::fmt::Write;

use super::gltf::{self, Play, single};
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::texture::{Texture, TexturedMesh};
use crate::geometry::vector::{cross, minus, norm};

/// File format of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MeshFormat {
    /// Wavefront OBJ.
    Obj,
    /// Stanford PLY.
    Ply,
    /// Stereolithography (STL).
    Stl,
    /// Binary glTF 2.0 in one file.
    Gltf,
}

impl MeshFormat {
    /// All formats.
    pub const ALL: [Self; 4] = [Self::Obj, Self::Ply, Self::Stl, Self::Gltf];

    /// Name used in queries.
    pub fn name(self) -> &'static str {
        match self {
            Self::Obj => "obj",
            Self::Ply => "ply",
            Self::Stl => "stl",
            Self::Gltf => "gltf",
        }
    }

    /// Media type of the file.
    pub fn media_type(self) -> &'static str {
        match self {
            Self::Obj => "model/obj",
            Self::Ply => "application/ply",
            Self::Stl => "model/stl",
            Self::Gltf => "model/gltf-binary",
        }
    }

    /// Writes the mesh as a file.
    pub fn write(self, textured: &TexturedMesh) -> Vec<u8> {
        match self {
            Self::Obj => Objects::of(textured).text.into_bytes(),
            Self::Ply => ply(&textured.mesh),
            Self::Stl => stl(&textured.mesh),
            Self::Gltf => gltf::write(textured, &[], Play::Each),
        }
    }
}

/// An OBJ file of several meshes with the same faces.
#[derive(Debug, Default)]
pub struct Objects {
    text: String,
    /// Numbers of vertices, texture coordinates and normals so far.
    before: [usize; 3],
}

impl Objects {
    fn of(textured: &TexturedMesh) -> Self {
        let mut objects = Self::default();
        objects.add(&textured.mesh, textured.texture.as_ref());
        objects
    }

    /// Adds a mesh as the object `name`, which has no spaces.
    pub fn push(&mut self, name: &str, mesh: &TriangleMesh, texture: Option<&Texture>) {
        self.line(format_args!("o {name}\n"));
        self.add(mesh, texture);
    }

    /// The bytes of the file.
    pub fn into_bytes(self) -> Vec<u8> {
        self.text.into_bytes()
    }

    fn line(&mut self, args: std::fmt::Arguments<'_>) {
        self.text.write_fmt(args).expect("texts take all that is written");
    }

    fn add(&mut self, mesh: &TriangleMesh, texture: Option<&Texture>) {
        self.text.reserve(60 * mesh.vertices.len() + 30 * mesh.faces.len());
        for [x, y, z] in &mesh.vertices {
            self.line(format_args!("v {x} {y} {z}\n"));
        }
        // A picture of this format begins with its lower row.
        for [u, v] in texture.iter().flat_map(|texture| &texture.places) {
            self.line(format_args!("vt {u} {}\n", 1.0 - v));
        }
        for [x, y, z] in mesh.normals.iter().flatten() {
            self.line(format_args!("vn {x} {y} {z}\n"));
        }
        let [first, place, normal] = self.before.map(|count| count + 1);
        for (k, face) in mesh.faces.iter().enumerate() {
            let corner = |i: usize| {
                let vertex = face[i] as usize;
                let place = texture.map(|texture| place + texture.faces[k][i] as usize);
                (first + vertex, place, mesh.normals.is_some().then_some(normal + vertex))
            };
            self.text.push('f');
            for (vertex, place, normal) in (0..3).map(corner) {
                match (place, normal) {
                    (None, None) => self.line(format_args!(" {vertex}")),
                    (None, Some(normal)) => self.line(format_args!(" {vertex}//{normal}")),
                    (Some(place), None) => self.line(format_args!(" {vertex}/{place}")),
                    (Some(place), Some(normal)) => self.line(format_args!(" {vertex}/{place}/{normal}")),
                }
            }
            self.text.push('\n');
        }
        let counts = [
            mesh.vertices.len(),
            texture.map_or(0, |texture| texture.places.len()),
            mesh.normals.as_ref().map_or(0, Vec::len),
        ];
        self.before.iter_mut().zip(counts).for_each(|(before, count)| *before += count);
    }
}

fn ply(mesh: &TriangleMesh) -> Vec<u8> {
    let properties = |names: [&str; 3]| names.map(|name| format!("property double {name}\n")).concat();
    let normals = if mesh.normals.is_some() { properties(["nx", "ny", "nz"]) } else { String::new() };
    let head = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\n{}{normals}element face {}\n\
         property list uchar int vertex_indices\nend_header\n",
        mesh.vertices.len(),
        properties(["x", "y", "z"]),
        mesh.faces.len()
    );
    let mut bytes = head.into_bytes();
    for (i, vertex) in mesh.vertices.iter().enumerate() {
        let normal = mesh.normals.as_ref().map(|normals| normals[i]);
        for value in vertex.iter().chain(normal.iter().flatten()) {
            bytes.extend(value.to_le_bytes());
        }
    }
    for face in &mesh.faces {
        bytes.push(3);
        face.iter().for_each(|vertex| bytes.extend(vertex.to_le_bytes()));
    }
    bytes
}

fn stl(mesh: &TriangleMesh) -> Vec<u8> {
    let mut bytes = vec![0; 80];
    bytes.extend((mesh.faces.len() as u32).to_le_bytes());
    for face in &mesh.faces {
        let corners = face.map(|vertex| mesh.vertices[vertex as usize]);
        for point in [normal(corners)].iter().chain(&corners) {
            bytes.extend(single(*point));
        }
        bytes.extend([0; 2]);
    }
    bytes
}

/// Unit normal of a triangle; zero if it has no area.
fn normal([a, b, c]: [[f64; 3]; 3]) -> [f64; 3] {
    let n = cross(minus(b, a), minus(c, a));
    let length = norm(n);
    if length > 0.0 { n.map(|value| value / length) } else { [0.0; 3] }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle() -> TriangleMesh {
        TriangleMesh {
            vertices: vec![[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.5]],
            normals: Some(vec![[0.0, 0.0, 1.0]; 3]),
            faces: vec![[0, 1, 2]],
        }
    }

    #[test]
    fn text_has_every_digit_and_counts_from_one() {
        let obj = |mesh: TriangleMesh| Objects::of(&mesh.into()).text;
        let mesh = TriangleMesh { vertices: vec![[0.1, 1e-7, 3.0]; 3], normals: None, ..triangle() };
        assert_eq!(obj(mesh), "v 0.1 0.0000001 3\nv 0.1 0.0000001 3\nv 0.1 0.0000001 3\nf 1 2 3\n");
        assert!(obj(triangle()).ends_with("vn 0 0 1\nf 1//1 2//2 3//3\n"));
    }

    #[test]
    fn corners_have_places_and_objects_count_on() {
        let texture = Texture {
            places: vec![[0.0, 0.0], [1.0, 0.0], [0.5, 0.75], [0.25, 1.0]],
            faces: vec![[3, 1, 2]],
        };
        let mut objects = Objects::default();
        let bare = TriangleMesh { normals: None, ..triangle() };
        objects.push("a", &triangle(), Some(&texture));
        objects.push("b", &bare, Some(&texture));
        objects.push("c", &bare, None);
        let text = String::from_utf8(objects.into_bytes()).unwrap();
        assert!(text.contains("vt 0 1\nvt 1 1\nvt 0.5 0.25\nvt 0.25 0\nvn 0 0 1\n"), "{text}");
        let faces: Vec<&str> =
            text.lines().filter(|line| line.starts_with("f ") || line.starts_with("o ")).collect();
        assert_eq!(faces, ["o a", "f 1/4/1 2/2/2 3/3/3", "o b", "f 4/8 5/6 6/7", "o c", "f 7 8 9"]);
    }

    #[test]
    fn binary_files_have_the_length_that_they_state() {
        let mesh = triangle();
        let ply = ply(&mesh);
        let head = ply.windows(11).position(|bytes| bytes == b"end_header\n").unwrap() + 11;
        assert_eq!(ply.len() - head, 3 * 6 * 8 + 13);
        assert_eq!(stl(&mesh).len(), 84 + 50);
    }

    #[test]
    fn a_triangle_without_area_has_no_normal() {
        assert_eq!(normal([[1.0; 3]; 3]), [0.0; 3]);
    }
}
