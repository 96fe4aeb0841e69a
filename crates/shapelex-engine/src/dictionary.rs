//! Dictionaries of cohorts at rest: kept beside a revision, used in passes over it.

use bytes::Bytes;
use object_store::PutMode;
use serde_json::value::RawValue;
use shapelex_analysis::dictionary::content::Content;
use shapelex_analysis::dictionary::in_use::Dictionary;

use crate::EngineError;
use crate::cohort::dictionary_path;
use crate::cohort::revision::{Revision, Setting};
use crate::objects::{Length, Objects};

/// Maximum size of a dictionary in bytes.
const MAX_BYTES: u64 = 256 << 20;

/// A dictionary in use, with the digest of its content.
#[derive(Debug)]
pub struct Named {
    /// blake3 digest of the content as compact JSON, hexadecimal.
    pub digest: String,
    /// The dictionary.
    pub dictionary: Dictionary,
}

fn refused(error: &dyn std::fmt::Display) -> EngineError {
    EngineError::refused("dictionary", error.to_string())
}

/// The content as the text that its digest is of.
fn text(content: &Content) -> Result<(Box<RawValue>, String), EngineError> {
    let text = serde_json::value::to_raw_value(content).map_err(|error| refused(&error))?;
    let digest = blake3::hash(text.get().as_bytes()).to_hex().to_string();
    Ok((text, digest))
}

impl Named {
    /// Prepares a content for a cohort.
    ///
    /// # Errors
    /// A dictionary of other shapes.
    pub fn new(revision: &Revision, content: Content) -> Result<(Self, Setting), EngineError> {
        let cohort = &revision.manifest().cohort;
        let same = content.representation == cohort.representation
            && content.correspondence == cohort.correspondence
            && content.direction == cohort.direction
            && content.mirror == cohort.mirror;
        if !same {
            let detail = format!(
                "expected one for shapes of '{}': their representation, correspondence, direction and mirror, got others",
                cohort.id
            );
            return Err(refused(&detail));
        }
        let setting = Setting::new(revision.manifest(), &content.transformation, Some(content.alignment))?;
        let (_, digest) = text(&content)?;
        let dictionary = Dictionary::new(content, setting.measured())?;
        Ok((Self { digest, dictionary }, setting))
    }

    /// Writes the content beside the cohort, so that passes on other machines find it.
    ///
    /// # Errors
    /// Errors of the store.
    pub async fn keep(&self, objects: &Objects, cohort: &str) -> Result<(), EngineError> {
        let (text, digest) = text(&self.dictionary.content)?;
        let content = Bytes::from(text.get().as_bytes().to_vec());
        objects.write(&dictionary_path(cohort, &digest)?, content, PutMode::Overwrite).await.map(drop)
    }

    /// Reads the record that [`keep`](Self::keep) wrote.
    ///
    /// # Errors
    /// [`EngineError::Damaged`] for a content of another digest; as [`new`](Self::new); errors of the store.
    pub(crate) async fn open(
        objects: &Objects,
        revision: &Revision,
        digest: &str,
    ) -> Result<(Self, Setting), EngineError> {
        let path = dictionary_path(&revision.manifest().cohort.id, digest)?;
        let bytes = objects.read(&path, Length::UpTo(MAX_BYTES)).await?;
        let found = blake3::hash(&bytes).to_hex();
        if found.as_str() != digest {
            return Err(EngineError::damaged(path, format!("digest {digest}"), format!("digest {found}")));
        }
        let content = serde_json::from_slice(&bytes).map_err(|error| refused(&error))?;
        Self::new(revision, content)
    }
}
