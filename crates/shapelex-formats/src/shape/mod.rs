//! Shapes in files of other programs, to and from [`Record`]s.
//!
//! * [`read`] takes a file of any format of [`FORMATS`] and gives one record after the other to a function;
//! * [`Format::writer`] makes a [`Writer`] that takes one record after the other;
//! * [`detect`] finds the format of a file by its media type, its name or its first bytes.
//!
//! # Adding a format
//! A file of this folder with a `pub(super) static FORMAT: Format`, its line in [`FORMATS`], a page
//! `docs/formats/{id}.md`, seeds in `fuzz/corpus/shape_files`, and a comparison with an independent reader in `tests/interop`.
//!
//! # Rules of readers
//! * Sizes are checked against [`Limits`] before memory is taken; counts of a header are claims, not facts.
//! * Nothing is merged, repaired or left out silently: omitted content is counted in [`Summary::dropped`].
//! * A fault names its [`Place`]: line, byte, tag or item.
//! * Coordinates are those of the file, in its unit and orientation; the summary says which. They are finite, or the point is
//!   missing.
//! * The order of records is that of the file, whatever the number of threads.

mod account;
mod archive;
#[cfg(feature = "morphometrics")]
mod chc;
#[cfg(feature = "microscopy")]
mod coco;
mod csv;
mod format;
mod geojson;
#[cfg(any(feature = "morphometrics", feature = "tables"))]
mod guarded;
#[cfg(feature = "microscopy")]
mod imagej;
mod inspection;
mod json;
mod limits;
#[cfg(feature = "meshes")]
mod mesh;
#[cfg(feature = "morphometrics")]
mod morphologika;
mod naming;
mod ndjson;
#[cfg(feature = "morphometrics")]
mod nef;
#[cfg(feature = "morphometrics")]
mod nts;
mod objects;
mod options;
#[cfg(feature = "morphometrics")]
mod project;
mod record;
mod registry;
#[cfg(feature = "dicom")]
mod rtstruct;
#[cfg(feature = "morphometrics")]
mod scalismo;
#[cfg(feature = "morphometrics")]
mod slicer;
mod source;
#[cfg(feature = "tables")]
mod table;
#[cfg(test)]
mod testing;
mod text;
#[cfg(feature = "morphometrics")]
mod tps;
mod unzip;
#[cfg(feature = "microscopy")]
mod wkt;
mod write;

pub use crate::error::{FaultKind, FileError, Place};
pub use crate::summary::{BROKEN, Dropped, Summary};
pub use crate::value::Value;
pub use archive::Images;
pub use csv::{AttributeRow, attribute_rows};
pub use format::Format;
pub use inspection::{Group, Inspected, Inspection};
pub use limits::{Limits, MAX_COORDINATE};
#[cfg(feature = "meshes")]
pub use mesh::{NORMALS, TEXTURE_OF_CORNERS};
pub use naming::{FILE, Filed, Scope, stem};
pub use options::{
    Columns, Contours, Curves, Decimal, EVERY, Encoding, Holes, Layout, MAX_HARMONICS, Names, Nuclei,
    Photograph, ProjectFiles, ReadOptions, Scale, Storing, WriteOptions,
};
#[cfg(feature = "morphometrics")]
pub use project::{named_files, pack_project};
pub use record::{Domain, Faces, Field, Fourier, Geometry, Kind, Mesh, Points, Record, Ring, Sink};
pub use registry::{FORMATS, detect, detect_written, find, read, read_beside};
pub use source::{Asked, Source};
#[cfg(feature = "tables")]
pub use table::{ArrayZip, npy_header};
pub use write::Writer;
