//! Conversion between bytes or text and shapes; no network, no storage.
//!
//! * [`shape`] — shapes as JSON, one object or one line of NDJSON;
//! * [`fault`] — faults of an input;
//! * [`json`] — text to values; [`bounds`] — memory bounds of documents while they are read;
//! * [`checked`] — JSON values that keep their own error, so that a request reports all of them;
//! * [`tree`] — JSON in memory, from which small records are read; [`trail`] — places of errors;
//! * [`ndjson`] — lines of a byte stream;
//! * [`record`] — shapes of files as posted shapes, and stored shapes as those of files;
//! * [`representation`] — representations as JSON;
//! * [`merge_patch`] — changes of a JSON object; [`time`] — times as text;
//! * [`summary`] — the content of a file beside its shapes;
//! * [`matrix`] — square matrices as JSON, CSV, NPY, Arrow and Parquet;
//! * [`table`] — tables as JSON, CSV, NDJSON, Arrow and Parquet; [`batches`] — the latter two;
//! * [`formulas`] — CSV in which no text is a formula to a spreadsheet;
//! * [`columns`] — answers of JSON as tables of numbers, texts and lists: CSV, Arrow, Parquet, NPY and NPZ;
//! * [`mesh`] — triangle meshes as OBJ, PLY, STL and glTF; [`gltf`] — also with displacements;
//! * [`picture`] — drawings as SVG and PNG; of a crate: [`image`] — images and volumes, [`files`] — shapes of other programs,
//!   [`words`] — messages of parsers as clients read them.

pub mod batches;
pub mod bounds;
pub mod checked;
pub mod columns;
pub mod fault;
pub mod formulas;
pub mod gltf;
pub mod json;
pub mod key;
pub mod lengths;
pub mod matrix;
pub mod merge_patch;
pub mod mesh;
pub mod ndjson;
pub mod observed;
pub mod partial;
pub mod picture;
pub mod record;
pub mod representation;
pub mod shape;
pub mod summary;
pub mod table;
pub mod time;
pub mod trail;
pub mod tree;

pub use shapelex_formats::{dicom, image, shape as files, unit, words};
