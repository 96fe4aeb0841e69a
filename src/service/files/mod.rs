//! Files of other programs: their format, their content, and conversion to other formats.
//!
//! Shapes are read by the registry of [`files`](crate::wire::files), label images by their contours: both give records.
//!
//! * [`translate`](mod@translate) — files described and translated; [`export`](mod@export) — cohorts as files;
//! * [`proposal`](mod@proposal) — numbers of control points for the shapes of a file;
//! * `format` — formats of shapes and of label images; `writing` — files within the memory for answers.

pub mod export;
mod format;
pub mod proposal;
pub mod translate;
mod writing;

pub use format::{FileFormat, file_limits, unknown_format};
