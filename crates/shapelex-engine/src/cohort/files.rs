//! Files that passes write beside the parts of a cohort, as lists.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::EngineError;

/// The codes of a part, as a file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CodedPart {
    /// Digest of the part.
    pub part: String,
    /// Number of shapes.
    pub shapes: u64,
    /// blake3 digest of the file, hexadecimal.
    pub digest: String,
    /// Its size in bytes.
    pub size_bytes: u64,
}

/// The graph of a group of parts, as a file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IndexedGroup {
    /// Number of shapes.
    pub shapes: u64,
    /// blake3 digest of the file, hexadecimal.
    pub digest: String,
    /// Its size in bytes.
    pub size_bytes: u64,
}

/// A list of files as bytes.
pub(crate) fn write_files<T: Serialize>(files: &[T]) -> Result<Vec<u8>, EngineError> {
    serde_json::to_vec(files).map_err(|error| EngineError::refused("files", error.to_string()))
}

/// The list of files that [`write_files`] wrote.
pub(crate) fn read_files<T: DeserializeOwned>(bytes: &[u8]) -> Result<Vec<T>, EngineError> {
    serde_json::from_slice(bytes).map_err(|error| EngineError::refused("files", error.to_string()))
}

/// A list of files from lists of them.
pub(crate) fn join<T: Serialize + DeserializeOwned>(lists: &[&[u8]]) -> Result<Vec<u8>, EngineError> {
    let lists: Vec<Vec<T>> = lists.iter().map(|list| read_files(list)).collect::<Result<_, _>>()?;
    write_files(&lists.into_iter().flatten().collect::<Vec<T>>())
}
