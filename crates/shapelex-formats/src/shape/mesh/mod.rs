//! Meshes of other programs.
//!
//! | part | content |
//! |---|---|
//! | [`obj`], [`ply`], [`stl`], [`off`], [`vtk`], [`vtp`], [`gifti`], [`particles`] | readers |
//! | [`obj`], [`ply`], [`stl`], [`gltf`], [`vtk`], [`particles`] | writers |
//! | [`scan`] | lines, words and blocks of bytes, with their places |
//! | [`scalar`] | numbers in binary and as text |
//! | [`cells`] | cells of VTK, of which polygons are kept |
//! | [`xml`], [`encoded`] | XML as a tree, with arrays in base64 |
//! | [`draft`] | parts of a shape, on their way to a record |
//! | [`part`] | parts of a record for writers |
//!
//! The readers are our own. `tobj` splits at groups and materials and names no line of a fault, `stl_io` ends with the first solid
//! and takes every file that begins with `solid ` for a text, `ply-rs` holds a map by name for each vertex, and `vtkio` is a
//! release candidate.
//!
//! # Names of fields
//! `normals`, `colours` and `texture_coordinates` are those of vertices, or with `face_` in front those of faces where vertices
//! have such a field too. All others have the name in the file. Values are those of the file: colours are 0 to 255 or 0 to 1.

mod cells;
mod draft;
mod encoded;
pub(super) mod gifti;
pub(super) mod gltf;
pub(super) mod obj;
pub(super) mod off;
mod part;
pub(super) mod particles;
pub(super) mod ply;
mod scalar;
mod scan;
pub(super) mod stl;
pub(super) mod vtk;
pub(super) mod vtp;
mod xml;

#[cfg(test)]
mod testing;

/// Name of the field of normals.
pub const NORMALS: &str = "normals";
/// Name of the field of texture coordinates that differ between the corners of a vertex.
pub const TEXTURE_OF_CORNERS: &str = "texture_coordinates_of_corners";
/// Name of the field of colours: red, green, blue and perhaps opacity.
const COLOURS: &str = "colours";
/// Name of the field of texture coordinates: `u` to the right, `v` upwards.
const TEXTURE: &str = "texture_coordinates";
