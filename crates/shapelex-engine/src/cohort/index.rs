//! The manifest of the index of a revision: graphs of near neighbours over the codes of its shapes, and what they miss.

use bytes::Bytes;
use object_store::PutMode;
use serde::{Deserialize, Serialize};
use shapelex_analysis::accumulate::{FAN_IN, PART};

use super::codes::MAX_BYTES;
use super::files::{IndexedGroup, read_files};
use super::revision::Revision;
use super::{graph_path, index_manifest_path};
use crate::EngineError;
use crate::objects::{Length, Objects};

/// Number of shapes of a group of parts.
pub(crate) const GROUP: usize = FAN_IN * PART;

/// The index of a revision: a graph for each group of 64 parts, in order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Index {
    /// Id of the cohort.
    pub cohort: String,
    /// Revision.
    pub revision: u64,
    /// Digest of the revision.
    pub revision_digest: String,
    /// Digest of the dictionary whose scores the graphs are over.
    pub dictionary: String,
    /// The graphs.
    pub groups: Vec<IndexedGroup>,
    /// What a search finds, if it was measured.
    pub recall: Option<Recall>,
}

/// What a search by an index finds of the true neighbours of shapes of the revision itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recall {
    /// Number of shapes that were searched for, evenly spaced in the revision.
    pub queries: usize,
    /// Number of neighbours of each, the shape itself not counted.
    pub neighbours: usize,
    /// Number of candidates of each that were compared.
    pub candidates: usize,
    /// Mean fraction of the true neighbours that were found.
    pub mean: f64,
    /// The lowest fraction.
    pub lowest: f64,
}

impl Index {
    /// From the result of a pass that made all graphs.
    ///
    /// # Errors
    /// [`EngineError::Damaged`] unless there is one graph for each group of parts, in order.
    pub fn new(revision: &Revision, dictionary: &str, state: &[u8]) -> Result<Self, EngineError> {
        let cohort = &revision.manifest().cohort;
        let index = Self {
            cohort: cohort.id.clone(),
            revision: cohort.revision,
            revision_digest: revision.digest().into(),
            dictionary: dictionary.into(),
            groups: read_files(state)?,
            recall: None,
        };
        index.check("index", revision)?;
        Ok(index)
    }

    /// Whether there is one graph for each group of parts of the revision, in order.
    fn check(&self, object: &str, revision: &Revision) -> Result<(), EngineError> {
        let expected: Vec<u64> = revision
            .manifest()
            .parts
            .chunks(FAN_IN)
            .map(|group| group.iter().map(|part| part.shapes).sum())
            .collect();
        if self.revision_digest == revision.digest()
            && self.groups.iter().map(|group| group.shapes).eq(expected.iter().copied())
        {
            return Ok(());
        }
        let expected = format!("a graph for each of {} groups of parts", expected.len());
        Err(EngineError::damaged(object, expected, format!("{} others", self.groups.len())))
    }

    /// The index of a revision over the scores of a dictionary.
    ///
    /// # Errors
    /// [`EngineError::Refused`] if there is none; [`EngineError::Damaged`] for that of other parts; errors of the store.
    pub async fn read(revision: &Revision, dictionary: &str) -> Result<Self, EngineError> {
        let (objects, cohort) = (revision.objects(), &revision.manifest().cohort);
        let path = index_manifest_path(&cohort.id, dictionary, cohort.revision)?;
        let object = path.to_string();
        if objects.size(&path).await?.is_none() {
            let detail =
                "expected an index of this revision over this dictionary, got none: make it by `index`";
            return Err(EngineError::refused(object, detail));
        }
        let text = objects.read(&path, Length::UpTo(MAX_BYTES)).await?;
        let index: Self = serde_json::from_slice(&text)
            .map_err(|error| EngineError::damaged(&*object, "a manifest of an index", error.to_string()))?;
        index.check(&object, revision)?;
        Ok(index)
    }

    /// The file of the group `k`.
    ///
    /// # Errors
    /// [`EngineError::Damaged`] for other bytes; errors of the store.
    pub(crate) async fn graph(&self, objects: &Objects, k: usize) -> Result<Bytes, EngineError> {
        let IndexedGroup { digest, size_bytes, .. } = &self.groups[k];
        objects.read_digested(&graph_path(&self.cohort, &self.dictionary, digest)?, *size_bytes, digest).await
    }

    /// Size of all files in bytes.
    pub fn size_bytes(&self) -> u64 {
        self.groups.iter().map(|group| group.size_bytes).sum()
    }

    /// Writes the manifest.
    ///
    /// # Errors
    /// Errors of the store.
    pub async fn write(&self, objects: &Objects) -> Result<(), EngineError> {
        let text =
            serde_json::to_vec(self).map_err(|error| EngineError::refused("index", error.to_string()))?;
        let path = index_manifest_path(&self.cohort, &self.dictionary, self.revision)?;
        objects.write(&path, Bytes::from(text), PutMode::Overwrite).await.map(drop)
    }
}
