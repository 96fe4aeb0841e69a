//! Writing a revision.

use std::collections::HashSet;

use object_store::PutMode;
use shapelex_analysis::accumulate::PART;

use super::manifest::{FORMAT, MAX_PART_BYTES, Manifest, Part, revisions};
use super::part::Rows;
use super::{Description, part_path};
use crate::EngineError;
use crate::cohort::record::Record;
use crate::objects::Objects;

/// Writes the shapes of a revision in their order.
#[derive(Debug)]
pub struct Writer {
    objects: Objects,
    cohort: Description,
    size: [usize; 2],
    /// Digests of parts that an earlier revision names.
    known: HashSet<String>,
    rows: Rows,
    parts: Vec<Part>,
    kept: usize,
    written_bytes: u64,
}

/// Result of writing.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Written {
    /// Digest of the revision.
    pub digest: String,
    /// Number of shapes.
    pub shapes: u64,
    /// Number of parts.
    pub parts: usize,
    /// Number of parts that an earlier revision had already.
    pub kept: usize,
    /// Bytes of the parts that were written.
    pub written_bytes: u64,
}

impl Writer {
    /// Begins a revision. Parts are kept that the latest earlier revision, or this one, has already; with `rewrite` all are written
    /// again, which repairs damaged ones.
    ///
    /// # Errors
    /// [`EngineError::Refused`] for a cohort that does not suit; [`EngineError::Damaged`] manifests; errors of the store.
    pub async fn begin(objects: Objects, cohort: Description, rewrite: bool) -> Result<Self, EngineError> {
        let width = cohort.width()?;
        let dimension = cohort.representation.dimension();
        let mut known = HashSet::new();
        if !rewrite {
            let earlier = revisions(&objects, &cohort.id).await?;
            // The latest one that is not later.
            if let Some(revision) = earlier.into_iter().rfind(|revision| *revision <= cohort.revision) {
                let (manifest, _) = Manifest::read(&objects, &cohort.id, revision).await?;
                known.extend(manifest.parts.into_iter().map(|part| part.digest));
            }
        }
        Ok(Self {
            objects,
            cohort,
            size: [width / dimension, dimension],
            known,
            rows: Rows::default(),
            parts: Vec::new(),
            kept: 0,
            written_bytes: 0,
        })
    }

    /// Number of control points and dimension of the shapes.
    pub fn size(&self) -> [usize; 2] {
        self.size
    }

    /// Adds a shape, whose control points are as many as those of the cohort.
    ///
    /// # Errors
    /// [`EngineError::Refused`] for another number of control points; errors of the store.
    pub async fn add(&mut self, shape: Record) -> Result<(), EngineError> {
        let width = self.size[0] * self.size[1];
        if shape.control_points.len() != width {
            let detail = format!("expected {width} numbers, got {}", shape.control_points.len());
            return Err(EngineError::refused(format!("shape '{}'", shape.id), detail));
        }
        self.rows.push(shape)?;
        if self.rows.len() == PART { self.write_part().await } else { Ok(()) }
    }

    async fn write_part(&mut self) -> Result<(), EngineError> {
        let shapes = self.rows.len() as u64;
        let content = self.rows.encode(self.parts.len(), self.size)?;
        let digest = blake3::hash(&content).to_hex().to_string();
        let size_bytes = content.len() as u64;
        if size_bytes > MAX_PART_BYTES {
            let detail = format!("expected at most {MAX_PART_BYTES} bytes in a part, got {size_bytes}");
            return Err(EngineError::refused("shapes", detail));
        }
        let path = part_path(&self.cohort.id, &digest)?;
        // Parts that no manifest names may be collected at any time, so only parts that one names are kept. They are asked for, because
        // a folder may have lost parts written before a loss of power.
        let kept = self.known.contains(&digest) && self.objects.size(&path).await? == Some(size_bytes);
        if kept {
            self.kept += 1;
        } else {
            self.objects.write(&path, content.into(), PutMode::Overwrite).await?;
            self.written_bytes += size_bytes;
        }
        self.parts.push(Part { digest, size_bytes, shapes });
        Ok(())
    }

    /// Writes the last part and the manifest.
    ///
    /// # Errors
    /// [`EngineError::Refused`] if the shapes are not as many as those of the cohort, or if the revision exists with other content;
    /// errors of the store.
    pub async fn finish(mut self) -> Result<Written, EngineError> {
        if !self.rows.is_empty() {
            self.write_part().await?;
        }
        let shapes: u64 = self.parts.iter().map(|part| part.shapes).sum();
        if shapes != self.cohort.shape_count {
            let detail =
                format!("expected {} (shape_count of the cohort), got {shapes}", self.cohort.shape_count);
            return Err(EngineError::refused("number of shapes", detail));
        }
        let manifest = Manifest { format: FORMAT, cohort: self.cohort, parts: self.parts };
        let digest = manifest.write(&self.objects).await?;
        let (kept, written_bytes) = (self.kept, self.written_bytes);
        Ok(Written { digest, shapes, parts: manifest.parts.len(), kept, written_bytes })
    }
}
