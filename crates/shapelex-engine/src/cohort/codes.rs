//! The manifest of the codes of a revision.

use bytes::Bytes;
use object_store::PutMode;
use serde::{Deserialize, Serialize};

use super::files::{CodedPart, read_files};
use super::revision::Revision;
use super::{codes_manifest_path, codes_path};
use crate::EngineError;
use crate::objects::{Length, Objects};

/// Maximum size of a manifest of codes or of an index, as of a revision.
pub(super) const MAX_BYTES: u64 = 512 << 20;

/// The codes of a revision in a dictionary: a file for each part, in order.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Codes {
    /// Id of the cohort.
    pub cohort: String,
    /// Revision.
    pub revision: u64,
    /// Digest of the revision.
    pub revision_digest: String,
    /// Digest of the dictionary.
    pub dictionary: String,
    /// The files.
    pub parts: Vec<CodedPart>,
}

impl Codes {
    /// From the result of a pass that coded all shapes.
    ///
    /// # Errors
    /// [`EngineError::Damaged`] unless there is one file for each part of the revision, in order.
    pub fn new(revision: &Revision, dictionary: &str, state: &[u8]) -> Result<Self, EngineError> {
        let (parts, manifest) = (read_files(state)?, revision.manifest());
        let codes = Self {
            cohort: manifest.cohort.id.clone(),
            revision: manifest.cohort.revision,
            revision_digest: revision.digest().into(),
            dictionary: dictionary.into(),
            parts,
        };
        codes.check("codes", revision)?;
        Ok(codes)
    }

    /// Whether there is one file for each part of the revision, in order.
    fn check(&self, object: &str, revision: &Revision) -> Result<(), EngineError> {
        let parts = &revision.manifest().parts;
        let found = self.parts.iter().map(|coded| (&coded.part, coded.shapes));
        if self.revision_digest == revision.digest()
            && found.eq(parts.iter().map(|part| (&part.digest, part.shapes)))
        {
            return Ok(());
        }
        let expected = format!("a file for each of {} parts", parts.len());
        Err(EngineError::damaged(object, expected, format!("{} others", self.parts.len())))
    }

    /// The codes of a revision in a dictionary, if they were written.
    ///
    /// # Errors
    /// [`EngineError::Damaged`] for those of other parts; errors of the store.
    pub async fn find(revision: &Revision, dictionary: &str) -> Result<Option<Self>, EngineError> {
        let (objects, cohort) = (revision.objects(), &revision.manifest().cohort);
        let path = codes_manifest_path(&cohort.id, dictionary, cohort.revision)?;
        if objects.size(&path).await?.is_none() {
            return Ok(None);
        }
        let text = objects.read(&path, Length::UpTo(MAX_BYTES)).await?;
        let object = path.to_string();
        let codes: Self = serde_json::from_slice(&text)
            .map_err(|error| EngineError::damaged(&*object, "a manifest of codes", error.to_string()))?;
        codes.check(&object, revision)?;
        Ok(Some(codes))
    }

    /// The file of the part `k`.
    ///
    /// # Errors
    /// [`EngineError::Damaged`] for other bytes; errors of the store.
    pub(crate) async fn read(&self, objects: &Objects, k: usize) -> Result<Bytes, EngineError> {
        let CodedPart { part, digest, size_bytes, .. } = &self.parts[k];
        objects.read_digested(&codes_path(&self.cohort, &self.dictionary, part)?, *size_bytes, digest).await
    }

    /// Number of shapes.
    pub fn shapes(&self) -> u64 {
        self.parts.iter().map(|part| part.shapes).sum()
    }

    /// Size of all files in bytes.
    pub fn size_bytes(&self) -> u64 {
        self.parts.iter().map(|part| part.size_bytes).sum()
    }

    /// Writes the manifest; returns its digest: equal digests are equal codes.
    ///
    /// # Errors
    /// Errors of the store.
    pub async fn write(&self, objects: &Objects) -> Result<String, EngineError> {
        let text =
            serde_json::to_vec(self).map_err(|error| EngineError::refused("codes", error.to_string()))?;
        let digest = blake3::hash(&text).to_hex().to_string();
        let path = codes_manifest_path(&self.cohort, &self.dictionary, self.revision)?;
        objects.write(&path, Bytes::from(text), PutMode::Overwrite).await?;
        Ok(digest)
    }
}
