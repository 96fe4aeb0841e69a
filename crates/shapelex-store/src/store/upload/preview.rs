//! An upload that writes nothing, and tells the findings of one that writes.
//!
//! The pending rows of an upload tell it which external ids it has stored itself. A preview has none: it keeps two digests of each
//! shape with an external id instead.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use super::super::answer::Answer;
use super::super::handle::Store;
use super::super::order::Cursor;
use super::{Batch, Held, Upload};
use crate::domain::cohort::Cohort;

/// Memory of a shape beside its external id: digests, the head of the text, and the room of a table that has just grown.
const PER_SHAPE: usize = 256;

/// Shapes with external ids that would be pending.
#[derive(Debug, Default)]
pub(super) struct Met {
    shapes: HashMap<String, Digests>,
    bytes: usize,
}

/// Digests of a shape.
#[derive(Debug)]
struct Digests {
    content: Vec<u8>,
    points: blake3::Hash,
}

impl Met {
    /// Notes the shapes of a batch that would be stored.
    pub(super) fn note(&mut self, batch: &Batch, fresh: &[usize]) {
        for row in fresh.iter().map(|&index| &batch.rows[index]) {
            let (Some(key), Some(content)) = (&row.external_id, row.digest_bytes()) else { continue };
            let digests = Digests { content: content.to_vec(), points: row.points_digest() };
            if self.shapes.insert(key.clone(), digests).is_none() {
                self.bytes += PER_SHAPE + key.len();
            }
        }
    }

    /// Adds those whose external ids a batch has to the `held` ones, as if they had been read.
    pub(super) fn add_to(&self, held: &mut HashMap<String, Held>, batch: &Batch) {
        for key in batch.rows.iter().filter_map(|row| row.external_id.as_deref()) {
            let Some(met) = self.shapes.get(key) else { continue };
            if let Entry::Vacant(place) = held.entry(key.to_owned()) {
                let (digest, points) = (Some(met.content.clone()), Some(met.points));
                let nowhere = Cursor { chunk: 0, position: 0 };
                place.insert(Held { id: String::new(), digest, place: nowhere, points });
            }
        }
    }
}

impl Store {
    /// Starts an upload to a cohort that writes nothing. Its shapes are compared with those of the cohort and with each other; those
    /// whose external id belongs to another one are left out.
    pub fn preview_upload(&self, cohort: &Cohort) -> Upload {
        let mut upload = self.begin_upload(cohort);
        upload.skip_conflicts();
        upload.met = Some(Met::default());
        upload
    }
}

impl Upload {
    /// Bytes that a preview keeps of its shapes.
    pub fn kept_bytes(&self) -> usize {
        self.met.as_ref().map_or(0, |met| met.bytes)
    }

    /// Checks as [`Upload::commit_once`] does, and stores nothing.
    ///
    /// # Errors
    /// As [`Upload::commit_once`].
    pub fn preview(self) -> Answer<'static, ()> {
        Box::pin(async move {
            let upload = self;
            let mut read = upload.store.begin_read().await?;
            let cohort = upload.store.number(&mut read, &upload.cohort_id).await?;
            upload.check_rule(&mut read, cohort).await?;
            if let Some(names) = &upload.names {
                names.check(&mut read, cohort).await?;
            }
            upload.check_unit(&mut read, cohort, false).await?;
            Ok(read.commit().await?)
        })
    }
}
