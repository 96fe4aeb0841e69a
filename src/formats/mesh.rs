//! Triangle mesh files for other programs.
//!
//! | format | what | numbers |
//! |---|---|---|
//! | OBJ | text of Wavefront, with normals | all digits |
//! | PLY | binary, little-endian, with normals | double precision |
//! | STL | binary, without shared vertices | single precision |
//! | glTF | one binary file (GLB 2.0) with one mesh, with normals | single precision |
//!
//! Single precision is inaccurate far from the origin: use STL and glTF for display, OBJ and PLY for data.

use std::fmt::Write;

use super::gltf::{self, single};
use crate::geometry::mesh::TriangleMesh;
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
    pub fn write(self, mesh: &TriangleMesh) -> Vec<u8> {
        match self {
            Self::Obj => obj(mesh).into_bytes(),
            Self::Ply => ply(mesh),
            Self::Stl => stl(mesh),
            Self::Gltf => gltf::write(mesh, &[]),
        }
    }
}

fn obj(mesh: &TriangleMesh) -> String {
    let mut text = String::with_capacity(60 * mesh.vertices.len() + 30 * mesh.faces.len());
    let mut line =
        |args: std::fmt::Arguments<'_>| text.write_fmt(args).expect("texts take all that is written");
    for [x, y, z] in &mesh.vertices {
        line(format_args!("v {x} {y} {z}\n"));
    }
    for [x, y, z] in mesh.normals.iter().flatten() {
        line(format_args!("vn {x} {y} {z}\n"));
    }
    for face in &mesh.faces {
        let [a, b, c] = face.map(|vertex| vertex + 1);
        if mesh.normals.is_some() {
            line(format_args!("f {a}//{a} {b}//{b} {c}//{c}\n"));
        } else {
            line(format_args!("f {a} {b} {c}\n"));
        }
    }
    text
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
        let mesh = TriangleMesh { vertices: vec![[0.1, 1e-7, 3.0]; 3], normals: None, ..triangle() };
        assert_eq!(obj(&mesh), "v 0.1 0.0000001 3\nv 0.1 0.0000001 3\nv 0.1 0.0000001 3\nf 1 2 3\n");
        assert!(obj(&triangle()).ends_with("vn 0 0 1\nf 1//1 2//2 3//3\n"));
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
