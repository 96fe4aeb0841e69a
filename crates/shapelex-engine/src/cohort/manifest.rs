//! The manifest of a revision.

use bytes::Bytes;
use object_store::PutMode;
use serde::{Deserialize, Serialize};
use serde_json::value::RawValue;
use shapelex_analysis::accumulate::PART;

use super::{Description, manifest_path, part_path};
use crate::EngineError;
use crate::objects::{Length, Objects};

/// Version of the layout. A manifest of another version is refused.
pub const FORMAT: u32 = 1;

/// Maximum size of a manifest: enough for two million parts, 2·10¹⁰ shapes.
const MAX_BYTES: u64 = 256 << 20;

/// Maximum size of a part: its numbers and texts are below 2 GiB each.
pub const MAX_PART_BYTES: u64 = 4 << 30;

/// A part of a revision.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Part {
    /// blake3 digest of its bytes, hexadecimal.
    pub digest: String,
    /// Its size in bytes.
    pub size_bytes: u64,
    /// Number of shapes.
    pub shapes: u64,
}

/// A revision: cohort and parts in order. All parts but the last have [`PART`] shapes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: u32,
    /// The cohort.
    pub cohort: Description,
    /// Its parts.
    pub parts: Vec<Part>,
}

/// Written form: the text of a manifest and its digest.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Sealed {
    digest: String,
    manifest: Box<RawValue>,
}

impl Manifest {
    /// Content of the object, and the digest of the revision: two revisions with the same digest are the same shapes.
    ///
    /// # Errors
    /// A manifest that is not JSON, which no manifest is.
    pub fn seal(&self) -> Result<(Bytes, String), EngineError> {
        let failed = |error: serde_json::Error| EngineError::refused("manifest", error.to_string());
        let manifest = serde_json::value::to_raw_value(self).map_err(failed)?;
        let digest = blake3::hash(manifest.get().as_bytes()).to_hex().to_string();
        let content = serde_json::to_vec(&Sealed { digest: digest.clone(), manifest }).map_err(failed)?;
        Ok((content.into(), digest))
    }

    /// Reads the text that [`seal`](Self::seal) wrote.
    fn open(object: &str, content: &[u8]) -> Result<(Self, String), EngineError> {
        let not = |error: serde_json::Error| EngineError::damaged(object, "a manifest", error.to_string());
        let Sealed { digest, manifest } = serde_json::from_slice(content).map_err(not)?;
        let found = blake3::hash(manifest.get().as_bytes()).to_hex().to_string();
        if found != digest {
            return Err(EngineError::damaged(object, format!("digest {digest}"), format!("digest {found}")));
        }
        Ok((serde_json::from_str(manifest.get()).map_err(not)?, digest))
    }

    /// The manifest of a revision, with its digest.
    ///
    /// # Errors
    /// [`EngineError::Damaged`] if it differs from the written one, or is that of another revision; errors of the store.
    pub async fn read(objects: &Objects, id: &str, revision: u64) -> Result<(Self, String), EngineError> {
        let path = manifest_path(id, revision)?;
        let content = objects.read(&path, Length::UpTo(MAX_BYTES)).await?;
        let object = path.to_string();
        let (manifest, digest) = Self::open(&object, &content)?;
        if (manifest.cohort.id.as_str(), manifest.cohort.revision) != (id, revision) {
            let found = format!("revision {} of '{}'", manifest.cohort.revision, manifest.cohort.id);
            return Err(EngineError::damaged(object, format!("revision {revision} of '{id}'"), found));
        }
        manifest.check(&object)?;
        Ok((manifest, digest))
    }

    /// Whether counts agree.
    fn check(&self, object: &str) -> Result<(), EngineError> {
        let wrong =
            |expected: String, got: String| Err(EngineError::damaged(object.to_string(), expected, got));
        if self.format != FORMAT {
            return wrong(format!("format {FORMAT}"), format!("format {}", self.format));
        }
        self.cohort.width()?;
        for (k, part) in self.parts.iter().enumerate() {
            let last = k + 1 == self.parts.len();
            if part.shapes > PART as u64 || part.shapes == 0 || (!last && part.shapes != PART as u64) {
                return wrong(format!("{PART} shapes in part {k}"), part.shapes.to_string());
            }
            if part.size_bytes > MAX_PART_BYTES {
                return wrong(
                    format!("at most {MAX_PART_BYTES} bytes in part {k}"),
                    part.size_bytes.to_string(),
                );
            }
        }
        let count: u64 = self.parts.iter().map(|part| part.shapes).sum();
        if count != self.cohort.shape_count {
            return wrong(format!("{} shapes", self.cohort.shape_count), count.to_string());
        }
        Ok(())
    }

    /// Writes the manifest, unless the same one exists. Returns the digest of the revision.
    ///
    /// # Errors
    /// [`EngineError::Refused`] if the revision exists with other content: revisions do not change. Errors of the store.
    pub async fn write(&self, objects: &Objects) -> Result<String, EngineError> {
        let (content, digest) = self.seal()?;
        let (id, revision) = (&self.cohort.id, self.cohort.revision);
        if objects.write(&manifest_path(id, revision)?, content, PutMode::Create).await? {
            return Ok(digest);
        }
        let (_, existing) = Self::read(objects, id, revision).await?;
        if existing != digest {
            let detail = format!("expected the content that exists, digest {existing}, got digest {digest}");
            return Err(EngineError::refused(format!("revision {revision} of '{id}'"), detail));
        }
        Ok(digest)
    }

    /// Bytes of a part, whose length and digest are those of the manifest.
    ///
    /// # Errors
    /// [`EngineError::Damaged`] for other bytes; errors of the store.
    pub async fn read_part(&self, objects: &Objects, k: usize) -> Result<Bytes, EngineError> {
        let part = &self.parts[k];
        objects.read_digested(&part_path(&self.cohort.id, &part.digest)?, part.size_bytes, &part.digest).await
    }
}

/// Revisions of a cohort, ascending.
///
/// # Errors
/// Errors of the store.
pub async fn revisions(objects: &Objects, id: &str) -> Result<Vec<u64>, EngineError> {
    let found = objects.list(&super::folder(id)?.join("revisions")).await?;
    let number = |name: &str| name.strip_suffix(".json")?.parse::<u64>().ok();
    let mut numbers: Vec<u64> =
        found.iter().filter_map(|object| number(object.location.filename()?)).collect();
    numbers.sort_unstable();
    Ok(numbers)
}
