//! Conversion between bytes or text and shapes; no network, no storage.
//!
//! * [`shape`] — shapes as JSON, one object or one line of NDJSON;
//! * [`fault`] — faults of an input;
//! * [`json`] — text to values; [`bounds`] — memory bounds of documents while they are read;
//! * [`checked`] — JSON values that keep their own error, so that a request reports all of them;
//! * [`ndjson`] — lines of a byte stream;
//! * [`representation`] — representations as JSON;
//! * [`matrix`] — square matrices as JSON, CSV and NPY;
//! * [`mesh`] — triangle meshes as OBJ, PLY, STL and glTF.

pub mod bounds;
pub mod checked;
pub mod fault;
pub mod json;
pub mod matrix;
pub mod mesh;
pub mod ndjson;
pub mod representation;
pub mod shape;
