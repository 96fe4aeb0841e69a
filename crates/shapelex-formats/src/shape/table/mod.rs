//! Tables of shapes: Arrow IPC, Parquet, and the arrays of NumPy.
//!
//! A row of an Arrow or Parquet table is a shape:
//!
//! | column | type | value |
//! |---|---|---|
//! | `external_id`, `subject`, `label` | text | as in [`Record`](super::Record); null if unknown |
//! | `weight` | double | weight in means |
//! | `closed` | Boolean | curves only; null for landmarks and meshes |
//! | `dimension` | 32-bit integer | number of coordinates of a point |
//! | `points` | list of doubles | curves and landmarks, row-major; a missing point is null in every coordinate |
//! | `vertices` | list of doubles | meshes, row-major |
//! | `faces` | list of 32-bit integers | indices of vertices, one face after the other |
//! | `face_sizes` | list of 32-bit integers | number of corners of every face; null if all are triangles |
//! | `ring_object`, `ring_part`, `ring_hole` | 64-bit integers, Boolean | place among the rings of an object |
//! | `labels.NAME` | Boolean, double or text | attributes of the first rows, each of one type |
//! | `more_labels` | text | all other attributes, a JSON object |
//! | `fields.NAME` | list of doubles | arrays of values of meshes, row-major; null where there is no value |
//! | `metadata` | text | all further facts, a JSON object |
//!
//! The metadata of the file have `shapelex.schema` (`shapes/1`), `shapelex.unit` and other facts of the writer, and
//! `shapelex.fields`: a JSON object that names the carrier of each field, and the number of components of its values.

#[cfg(test)]
mod array_tests;
mod array_zip;
mod arrays;
pub(super) mod arrow;
mod checks;
mod columns;
#[cfg(test)]
mod cost_tests;
mod decoded;
mod dictionaries;
mod layout;
mod list_pages;
mod npy;
mod npy_file;
mod npz;
mod pages;
mod parquet;
mod read_rows;
mod rows;
mod structures;
#[cfg(test)]
mod tests;
mod thrift;

pub use array_zip::ArrayZip;
pub use npy::header_bytes as npy_header;

pub(super) use arrow::FORMAT as ARROW;
pub(super) use npy_file::FORMAT as NPY;
pub(super) use npz::FORMAT as NPZ;
pub(super) use parquet::FORMAT as PARQUET;
