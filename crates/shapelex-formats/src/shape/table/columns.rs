//! Names of columns and of metadata, and checks that all tables share.

use super::super::limits::Bound;
use super::super::text::name_fits;
use crate::error::{FaultKind, FileError, Place};

/// Cells of a file: the values of all its columns, those within lists too. Columns of nulls, flags and constants take next to no
/// bytes for them, but as much work as others.
pub(super) const CELLS: Bound =
    Bound { what: "cells (with those within lists)", free: 1 << 23, per_byte: 64 };

/// Version of the columns, in the metadata of a file.
pub(super) const SCHEMA: &str = "shapes/1";
/// Prefix of the metadata of a file that concern the shapes.
pub(super) const PREFIX: &str = "shapelex.";
/// Prefix of the columns of attributes.
pub(super) const LABELS: &str = "labels.";
/// Prefix of the columns of values at vertices or faces.
pub(super) const FIELDS: &str = "fields.";

/// A field of meshes, in the metadata of a file.
#[derive(serde::Serialize, serde::Deserialize, Clone, PartialEq)]
pub(super) struct FieldNote {
    /// `vertices` or `faces`.
    pub(super) on: String,
    /// Number of components of a value.
    pub(super) width: usize,
}

/// An error of the output or of the library that writes.
pub(super) fn unwritten(error: impl std::fmt::Display) -> FileError {
    FileError::of(FaultKind::Io, Place::default(), error)
}

/// Refuses a long name of a column, which every batch and every record repeat.
pub(super) fn check_name(name: &str) -> Result<(), FileError> {
    name_fits(name).map_err(|detail| FileError::malformed(Place::tag("names of columns"), detail))
}

/// Whether a decoder gives just so many bytes: those of libraries give all that there are.
pub(super) fn gives(content: impl std::io::Read, expected: u64) -> bool {
    let mut content = content.take(expected.saturating_add(1));
    std::io::copy(&mut content, &mut std::io::sink()).is_ok_and(|found| found == expected)
}
