//! Triangle mesh files for other programs.
//!
//! | format | content | numbers |
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
//! OBJ, PLY and STL are written by the registry of [`files`]; glTF with displacements by [`gltf`].
//!
//! Single precision is inaccurate far from the origin: use STL and glTF for display, OBJ and PLY for data.

use std::collections::BTreeMap;

use super::files::{
    self, Domain, FaultKind, Field, FileError, Mesh, NORMALS, Place, Points, Record, TEXTURE_OF_CORNERS,
    WriteOptions, Writer,
};
use super::gltf::{self, Play};
use crate::geometry::mesh::TriangleMesh;
use crate::geometry::texture::{Texture, TexturedMesh};

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
    ///
    /// # Errors
    /// Coordinates beyond single precision, in STL and glTF.
    pub fn write(self, textured: TexturedMesh) -> Result<Vec<u8>, FileError> {
        let TexturedMesh { mesh, texture } = textured;
        match self {
            Self::Obj => file(self, &record(None, mesh, texture.as_ref())),
            Self::Ply | Self::Stl => file(self, &record(None, mesh, None)),
            Self::Gltf => gltf::write(&TexturedMesh { mesh, texture }, [], Play::Each),
        }
    }
}

/// An OBJ file of several meshes with the same faces and texture coordinates, which are objects with names. They are asked for one
/// after the other; `bytes` of the file are expected.
///
/// # Errors
/// Those of the meshes.
pub fn objects<E: From<FileError>>(
    meshes: impl IntoIterator<Item = Result<(String, TriangleMesh), E>>,
    texture: Option<&Texture>,
    bytes: usize,
) -> Result<Vec<u8>, E> {
    let mut file = Vec::with_capacity(bytes);
    let mut writer = writer(MeshFormat::Obj, &mut file)?;
    for mesh in meshes {
        let (name, mesh) = mesh?;
        writer.push(&record(Some(name), mesh, texture))?;
    }
    writer.finish()?;
    Ok(file)
}

/// A file of one mesh.
fn file(format: MeshFormat, record: &Record) -> Result<Vec<u8>, FileError> {
    let mut bytes = Vec::new();
    let mut writer = writer(format, &mut bytes)?;
    writer.push(record)?;
    writer.finish()?;
    Ok(bytes)
}

/// The writer of the registry.
fn writer(format: MeshFormat, bytes: &mut Vec<u8>) -> Result<Box<dyn Writer + '_>, FileError> {
    let name = format.name();
    let found = files::find(name).ok_or_else(|| {
        FileError::new(FaultKind::Unknown, format!("expected a format that is written, got {name}"))
    })?;
    found.writer(bytes, &WriteOptions::default())
}

/// A mesh as a record. Texture coordinates are those of corners: a vertex may have several.
fn record(name: Option<String>, mesh: TriangleMesh, texture: Option<&Texture>) -> Record {
    let mut fields = BTreeMap::new();
    if let Some(normals) = mesh.normals {
        let field = Field { domain: Domain::Vertices, width: 3, values: normals.into_flattened() };
        fields.insert(NORMALS.to_owned(), field);
    }
    if let Some(texture) = texture {
        // A picture of files begins with its lower row.
        let place = |place: &u32| {
            let [u, v] = texture.places[*place as usize];
            [u, 1.0 - v]
        };
        let values = texture.faces.as_flattened().iter().flat_map(place).collect();
        fields.insert(TEXTURE_OF_CORNERS.to_owned(), Field { domain: Domain::Faces, width: 6, values });
    }
    let mut found =
        Mesh { vertices: Points::from_rows(3, mesh.vertices.into_flattened()), fields, ..Mesh::default() };
    mesh.faces.into_iter().for_each(|face| found.faces.push(face));
    Record { name, ..Record::new(found, Place::default()) }
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

    fn written(format: MeshFormat, mesh: TriangleMesh) -> Vec<u8> {
        format.write(mesh.into()).expect("a mesh that the format holds")
    }

    #[test]
    fn text_has_every_digit_and_counts_from_one() {
        let obj = |mesh: TriangleMesh| String::from_utf8(written(MeshFormat::Obj, mesh)).unwrap();
        let mesh = TriangleMesh { vertices: vec![[0.1, 1e-7, 3.0]; 3], normals: None, ..triangle() };
        assert_eq!(obj(mesh), "v 0.1 0.0000001 3\nv 0.1 0.0000001 3\nv 0.1 0.0000001 3\nf 1 2 3\n");
        assert!(obj(triangle()).ends_with("vn 0 0 1\nf 1//1 2//2 3//3\n"));
    }

    #[test]
    fn corners_have_places_and_objects_count_on() {
        let texture = Texture {
            places: vec![[0.0, 0.0], [1.0, 0.0], [0.5, 0.75], [0.25, 1.0]],
            faces: vec![[3, 1, 2], [3, 2, 0]],
        };
        let twice = |mesh: TriangleMesh| TriangleMesh { faces: vec![[0, 1, 2]; 2], ..mesh };
        let bare = || TriangleMesh { normals: None, ..triangle() };
        let meshes = [("a".to_owned(), twice(triangle())), ("b".to_owned(), twice(bare()))];
        let text =
            String::from_utf8(objects::<FileError>(meshes.map(Ok), Some(&texture), 0).unwrap()).unwrap();
        // Each place once, in the order in which corners have them.
        assert!(text.contains("vt 0.25 0\nvt 1 1\nvt 0.5 0.25\nvt 0 1\nvn 0 0 1\n"), "{text}");
        let faces: Vec<&str> =
            text.lines().filter(|line| line.starts_with("f ") || line.starts_with("o ")).collect();
        let wanted =
            ["o a", "f 1/1/1 2/2/2 3/3/3", "f 1/1/1 2/3/2 3/4/3", "o b", "f 4/5 5/6 6/7", "f 4/5 5/7 6/8"];
        assert_eq!(faces, wanted);
    }

    #[test]
    fn binary_files_have_the_length_that_they_state() {
        let ply = written(MeshFormat::Ply, triangle());
        let head = ply.windows(11).position(|bytes| bytes == b"end_header\n").unwrap() + 11;
        assert_eq!(ply.len() - head, 3 * 6 * 8 + 13);
        assert_eq!(written(MeshFormat::Stl, triangle()).len(), 84 + 50);
    }

    #[test]
    fn coordinates_beyond_single_precision_are_refused() {
        let far = || TriangleMesh { vertices: vec![[1e39, 0.0, 0.0]; 3], ..triangle() };
        for format in [MeshFormat::Stl, MeshFormat::Gltf] {
            let error = format.write(far().into()).unwrap_err().to_string();
            assert!(error.contains("single precision"), "{error}");
        }
        assert!(String::from_utf8_lossy(&written(MeshFormat::Obj, far())).starts_with("v 1000000"));
    }
}
