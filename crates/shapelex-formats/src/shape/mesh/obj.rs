//! Wavefront OBJ: vertices, polygons and lines as text. Each `o` with faces or lines is a shape; in a file without them,
//! each `o` with points.
//!
//! Corners have their own texture coordinates and normals. Where all corners of a vertex agree they become a field of the
//! vertices, else one of the faces with the values of all corners of a face (`…_of_corners`), if all faces have as many corners.
//! Groups and materials are fields of the faces: positions in the lists `groups` and `materials` of the metadata.

mod parse;
mod write;

use super::super::format::Format;
use super::super::record::Kind;
use super::super::{options::ReadOptions, record::Sink, source::Source};
use super::scan::Scan;
use crate::error::FileError;
use crate::summary::Summary;

/// Wavefront OBJ.
pub(in super::super) static FORMAT: Format = Format {
    id: "obj",
    name: "Wavefront OBJ",
    media_types: &["model/obj"],
    extensions: &["obj"],
    recognise: |_| false,
    kinds: &[Kind::Mesh, Kind::Landmarks, Kind::Curve],
    options: &[],
    read: Some(read),
    open: Some(write::open),
};

/// Name of the field of normals that differ between the corners of a vertex.
const NORMALS_OF_CORNERS: &str = "normals_of_corners";

fn read(source: &mut Source<'_>, _: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let bytes = source.bytes()?;
    let mut scan = Scan::new(&bytes);
    let mut file = parse::File::new(limits);
    let mut joined = Vec::new();
    while let Some(line) = scan.line() {
        let place = scan.place();
        // A line that ends with a backslash goes on in the next one.
        if let Some(start) = line.trim_ascii_end().strip_suffix(b"\\") {
            joined.extend_from_slice(start);
            joined.push(b' ');
            continue;
        }
        if joined.is_empty() {
            file.line(line, &place)?;
        } else {
            joined.extend_from_slice(line);
            file.line(&joined, &place)?;
            joined.clear();
        }
    }
    file.line(&joined, &scan.place())?;
    file.send(sink)
}

#[cfg(test)]
mod tests;
