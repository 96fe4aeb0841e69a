//! VTK legacy files, text and binary: `POLYDATA`, and the polygons of `UNSTRUCTURED_GRID`.
//!
//! Lines are curves if there are no polygons. Data of points and cells are fields of a mesh; those of cells that are not polygons, and
//! all data if there are no polygons, are left out.

mod read;
mod write;

use super::super::format::Format;
use super::super::record::Kind;

/// VTK legacy files.
pub(in super::super) static FORMAT: Format = Format {
    id: "vtk",
    name: "VTK legacy",
    media_types: &["application/x-vtk", "model/x-vtk"],
    extensions: &["vtk"],
    recognise: |head| head.starts_with(b"# vtk DataFile"),
    kinds: &[Kind::Mesh, Kind::Curve, Kind::Landmarks],
    options: &[],
    read: Some(read::read),
    open: Some(write::open),
};

#[cfg(test)]
mod tests;
