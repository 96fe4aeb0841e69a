//! Cohorts at rest: revisions that do not change, written once.
//!
//! ```text
//! {cohort id}/parts/{digest}.parquet       one row: a part of at most 8192 shapes
//! {cohort id}/revisions/{revision}.json    the manifest: cohort, and its parts in order
//! {cohort id}/dictionaries/{digest}.json   the content of a dictionary, for passes that use it
//! {cohort id}/codes/{dictionary}/{part}.parquet       codes of the shapes of a part
//! {cohort id}/learning/{revision}/{run}/{epoch}/{first}.codes   codes of two epochs, while a sparse dictionary is learnt
//! ```
//!
//! A part is named by the blake3 digest of its bytes. Revisions share the parts they have in common: a revision that only appends
//! shapes writes the last part and those that follow. A shape that is deleted moves all that follow it, so the parts from there on
//! are new.
//!
//! Parts are written before the manifest that names them. A writer that dies leaves parts that no manifest names, which
//! [`collect`](maintenance::collect) removes.

pub mod maintenance;
pub mod manifest;
pub mod part;
pub mod record;
pub mod revision;
pub mod writer;

use object_store::path::Path;
use serde::{Deserialize, Serialize};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_geometry::capability::domain::{Admitted, SizeBounds};
use shapelex_geometry::representation::Representation;

use crate::EngineError;

/// Maximum number of coordinates of a shape: the numbers of a part must stay below 2 GiB, the limit of a binary value.
pub const MAX_NUMBERS: usize = 32_767;

/// Maximum length of the id of a cohort in characters.
const MAX_ID_CHARS: usize = 100;

/// A cohort at one revision, as `GET /v1/cohorts/{cohort}` answers it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Description {
    /// Identifier: the name of its folder.
    pub id: String,
    /// Name.
    pub name: String,
    /// Free-text description.
    #[serde(default)]
    pub description: Option<String>,
    /// Representation of the shapes.
    pub representation: Representation,
    /// Correspondence of points between shapes.
    pub correspondence: Correspondence,
    /// Treatment of contour direction.
    pub direction: Direction,
    /// Treatment of mirror images.
    pub mirror: Mirror,
    /// Unit of the coordinates.
    #[serde(default)]
    pub length_unit: Option<String>,
    /// Revision.
    pub revision: u64,
    /// Number of shapes.
    pub shape_count: u64,
    /// Time of creation, RFC 3339.
    #[serde(default)]
    pub created_at: Option<String>,
    /// Time of the last change, RFC 3339.
    #[serde(default)]
    pub updated_at: Option<String>,
}

impl Description {
    /// Number of coordinates of a shape, `d·N`, once the description has been checked.
    ///
    /// # Errors
    /// [`EngineError::Refused`] for an id that is not a name of a folder, sizes out of bounds, and fields that do not fit together.
    pub fn width(&self) -> Result<usize, EngineError> {
        folder(&self.id)?;
        let bounds = SizeBounds { control_points: MAX_NUMBERS, vertices: MAX_NUMBERS };
        let admitted = Admitted::new(self.representation.clone(), bounds).map_err(|faults| {
            let fault = &faults[0];
            EngineError::refused(format!("representation/{}", fault.field), &*fault.detail)
        })?;
        if let Some(fault) = self.correspondence.fault(admitted.domain()) {
            return Err(EngineError::refused("correspondence", fault));
        }
        let width = admitted.size() * admitted.dimension();
        if width > MAX_NUMBERS {
            let detail = format!("expected at most {MAX_NUMBERS} coordinates, got {width}");
            return Err(EngineError::refused("representation", detail));
        }
        Ok(width)
    }
}

/// Folder of a cohort.
///
/// # Errors
/// [`EngineError::Refused`] for an id that is not a name of a folder.
pub fn folder(id: &str) -> Result<Path, EngineError> {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '_' | '-');
    if id.is_empty() || id.len() > MAX_ID_CHARS || id.starts_with('.') || !id.chars().all(allowed) {
        let detail = format!(
            "expected 1 to {MAX_ID_CHARS} letters, digits, '.', '_' and '-', without '.' at the start, got '{}'",
            id.chars().take(MAX_ID_CHARS).collect::<String>()
        );
        return Err(EngineError::refused("id", detail));
    }
    Ok(Path::from(id))
}

/// Path of a part.
///
/// # Errors
/// As [`folder`].
pub fn part_path(id: &str, digest: &str) -> Result<Path, EngineError> {
    Ok(folder(id)?.join("parts").join(format!("{digest}.parquet")))
}

/// Path of a manifest.
///
/// # Errors
/// As [`folder`].
pub fn manifest_path(id: &str, revision: u64) -> Result<Path, EngineError> {
    // As many digits as the largest revision has: listed in order.
    Ok(folder(id)?.join("revisions").join(format!("{revision:020}.json")))
}

/// Path of the content of a dictionary.
///
/// # Errors
/// As [`folder`].
pub fn dictionary_path(id: &str, digest: &str) -> Result<Path, EngineError> {
    Ok(folder(id)?.join("dictionaries").join(format!("{digest}.json")))
}

/// Path of the codes of a part in a dictionary.
///
/// # Errors
/// As [`folder`].
pub fn codes_path(id: &str, dictionary: &str, part: &str) -> Result<Path, EngineError> {
    Ok(folder(id)?.join("codes").join(dictionary).join(format!("{part}.parquet")))
}

/// Folder of the codes of all dictionaries that are being learnt from a revision.
///
/// # Errors
/// As [`folder`].
pub fn learning_folder(id: &str, revision: u64) -> Result<Path, EngineError> {
    Ok(folder(id)?.join("learning").join(format!("{revision:020}")))
}
