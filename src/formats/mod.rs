//! Bytes and text to shapes and pictures, and back: no network, no storage.
//!
//! * [`shape`] — a shape as JSON, one object or one line of NDJSON;
//! * [`checked`] — JSON values that keep their own error, so that a request reports all of them;
//! * [`ndjson`] — lines out of a byte stream;
//! * [`representation`] — a representation as JSON;
//! * [`matrix`] — square matrices as JSON, CSV and NPY;
//! * [`mesh`] — triangle meshes as OBJ, PLY, STL and glTF;
//! * [`svg`] — drawings and animations of curves and landmarks;
//! * [`effect`] — drawings of shapes with an effect along one of them;
//! * [`plot`] — graphs of functions.

pub mod checked;
pub mod effect;
pub mod matrix;
pub mod mesh;
pub mod ndjson;
pub mod plot;
pub mod representation;
pub mod shape;
pub mod svg;

/// One thing wrong with an input: where, and what to do.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InputError {
    /// JSON pointer (RFC 6901) into the document.
    pub pointer: String,
    /// What is wrong, with the numbers, and what is expected.
    pub detail: String,
}

impl InputError {
    /// From a pointer and a sentence.
    pub fn new(pointer: impl Into<String>, detail: impl Into<String>) -> Self {
        Self { pointer: pointer.into(), detail: detail.into() }
    }

    /// The same error below `prefix`.
    pub fn below(mut self, prefix: &str) -> Self {
        self.pointer.insert_str(0, prefix);
        self
    }
}

/// The JSON pointer of a path that serde tracked.
pub fn json_pointer(path: &serde_path_to_error::Path) -> String {
    use serde_path_to_error::Segment;
    let escape = |key: &str| key.replace('~', "~0").replace('/', "~1");
    path.iter()
        .filter_map(|segment| match segment {
            Segment::Seq { index } => Some(format!("/{index}")),
            Segment::Map { key } => Some(format!("/{}", escape(key))),
            Segment::Enum { .. } | Segment::Unknown => None,
        })
        .collect()
}
