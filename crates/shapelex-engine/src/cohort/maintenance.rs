//! Cohorts that exist, their check, and parts that no manifest names.

use std::collections::HashSet;
use std::time::{Duration, SystemTime};

use futures_util::StreamExt;
use object_store::ObjectMeta;
use serde::Serialize;

use super::manifest::{Manifest, revisions};
use super::part::{Expected, IDS};
use super::{folder, learning_folder, manifest_path, part_path};
use crate::EngineError;
use crate::objects::Objects;

/// Parts that are read at the same time by a check.
const AT_ONCE: usize = 4;

/// A revision that exists.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Listed {
    /// Id of the cohort.
    pub cohort: String,
    /// Name of the cohort.
    pub name: String,
    /// Revision.
    pub revision: u64,
    /// Digest of the revision.
    pub digest: String,
    /// Number of shapes.
    pub shapes: u64,
    /// Number of parts.
    pub parts: usize,
    /// Size of its parts in bytes.
    pub size_bytes: u64,
}

/// All revisions, by cohort.
///
/// # Errors
/// [`EngineError::Damaged`] manifests; errors of the store.
pub async fn list(objects: &Objects) -> Result<Vec<Listed>, EngineError> {
    let mut listed = Vec::new();
    for id in objects.folders().await? {
        for revision in revisions(objects, &id).await? {
            let (manifest, digest) = Manifest::read(objects, &id, revision).await?;
            listed.push(Listed {
                cohort: id.clone(),
                name: manifest.cohort.name,
                revision,
                digest,
                shapes: manifest.cohort.shape_count,
                parts: manifest.parts.len(),
                size_bytes: manifest.parts.iter().map(|part| part.size_bytes).sum(),
            });
        }
    }
    Ok(listed)
}

/// Result of a check.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Checked {
    /// Number of revisions.
    pub revisions: usize,
    /// Number of parts that were read; those that revisions share are read once.
    pub parts: usize,
    /// Bytes of these parts.
    pub bytes: u64,
    /// Number of parts that no revision names.
    pub unnamed: usize,
    /// Faults, in the order of cohorts, revisions and parts.
    pub faults: Vec<String>,
}

/// Reads every manifest and every part, and compares lengths, digests, numbers and counts. Faults are collected, not returned as an
/// error.
///
/// # Errors
/// A store that cannot be listed.
pub async fn check(objects: &Objects) -> Result<Checked, EngineError> {
    let mut checked = Checked::default();
    for id in objects.folders().await? {
        check_cohort(objects, &id, &mut checked).await?;
    }
    Ok(checked)
}

async fn check_cohort(objects: &Objects, id: &str, checked: &mut Checked) -> Result<(), EngineError> {
    let mut seen = HashSet::new();
    for revision in revisions(objects, id).await? {
        checked.revisions += 1;
        let manifest = match Manifest::read(objects, id, revision).await {
            Ok((manifest, _)) => manifest,
            Err(error) => {
                checked.faults.push(error.to_string());
                continue;
            }
        };
        let new = manifest.parts.iter().enumerate();
        // A digest that stands at two places is damage, so places count too.
        let new: Vec<usize> =
            new.filter(|(k, part)| seen.insert((*k, part.digest.clone()))).map(|(k, _)| k).collect();
        let read = |k: usize| {
            let manifest = &manifest;
            async move { read_numbers(objects, manifest, k).await.map(|()| manifest.parts[k].size_bytes) }
        };
        let read: Vec<Result<u64, EngineError>> =
            futures_util::stream::iter(new).map(read).buffered(AT_ONCE).collect().await;
        for outcome in read {
            checked.parts += 1;
            match outcome {
                Ok(bytes) => checked.bytes += bytes,
                Err(error) => checked.faults.push(error.to_string()),
            }
        }
    }
    let named: HashSet<String> = seen.into_iter().map(|(_, digest)| format!("{digest}.parquet")).collect();
    let parts = objects.list(&folder(id)?.join("parts")).await?;
    checked.unnamed += parts.iter().filter(|part| !is_named(part, &named)).count();
    Ok(())
}

async fn read_numbers(objects: &Objects, manifest: &Manifest, k: usize) -> Result<(), EngineError> {
    let part = &manifest.parts[k];
    let bytes = manifest.read_part(objects, k).await?;
    let expected = Expected { number: k, shapes: part.shapes as usize, width: manifest.cohort.width()? };
    let object = part_path(&manifest.cohort.id, &part.digest)?.to_string();
    let decoded = tokio::task::spawn_blocking(move || expected.decode(&object, bytes, &[IDS]).map(|_| ()));
    decoded.await.map_err(|error| EngineError::refused("check", error.to_string()))?
}

fn is_named(object: &ObjectMeta, named: &HashSet<String>) -> bool {
    object.location.filename().is_some_and(|name| named.contains(name))
}

/// Result of a collection.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize)]
pub struct Collected {
    /// Number of parts that a revision names.
    pub named: usize,
    /// Number of parts that were removed, or would be in a dry run.
    pub removed: usize,
    /// Their size in bytes.
    pub removed_bytes: u64,
    /// Number of parts that no revision names, but that are younger than the minimum age.
    pub young: usize,
}

/// Removes parts that no manifest names and that are at least `age` old: a writer may be about to name younger ones.
///
/// # Errors
/// A damaged manifest: nothing of its cohort is removed. Errors of the store.
pub async fn collect(objects: &Objects, age: Duration, dry_run: bool) -> Result<Collected, EngineError> {
    let mut collected = Collected::default();
    let until = SystemTime::now().checked_sub(age).unwrap_or(SystemTime::UNIX_EPOCH);
    for id in objects.folders().await? {
        // Parts first: parts that a writer names after that are not in the list.
        let parts = objects.list(&folder(&id)?.join("parts")).await?;
        let mut named = HashSet::new();
        for revision in revisions(objects, &id).await? {
            let (manifest, _) = Manifest::read(objects, &id, revision).await?;
            named.extend(manifest.parts.into_iter().map(|part| format!("{}.parquet", part.digest)));
        }
        // Codes of dictionaries whose learning has ended otherwise than it should.
        let learning = objects.list(&folder(&id)?.join("learning")).await?;
        let mut going = Vec::new();
        for part in parts.into_iter().chain(learning) {
            if is_named(&part, &named) {
                collected.named += 1;
            } else if SystemTime::from(part.last_modified) > until {
                collected.young += 1;
            } else {
                collected.removed += 1;
                collected.removed_bytes += part.size;
                going.push(part.location);
            }
        }
        if !dry_run {
            objects.remove_each(going).await?;
        }
    }
    Ok(collected)
}

/// Forgets a revision. Its parts stay until they are collected, or, with `parts`, those go that no other revision names, as do codes of
/// learning from it, and with the last revision all that is kept of the cohort: not for one of which another revision is being written,
/// which may rely on them.
///
/// # Errors
/// [`EngineError::Refused`] for a revision that does not exist; damaged manifests with `parts`; errors of the store.
pub async fn forget(objects: &Objects, id: &str, revision: u64, parts: bool) -> Result<(), EngineError> {
    let path = manifest_path(id, revision)?;
    let known = revisions(objects, id).await?;
    if !known.contains(&revision) {
        let detail = format!("expected one of {known:?}, got {revision}");
        return Err(EngineError::refused(format!("revision of '{id}'"), detail));
    }
    let going = if parts { own_objects(objects, id, revision, &known).await? } else { Vec::new() };
    objects.remove(&path).await?;
    objects.remove_each(going).await
}

/// Parts that this revision names and no other one of `known`, and codes of learning from it; all objects of the cohort if there is no
/// other.
async fn own_objects(
    objects: &Objects,
    id: &str,
    revision: u64,
    known: &[u64],
) -> Result<Vec<object_store::path::Path>, EngineError> {
    if known == [revision] {
        let all = objects.list(&folder(id)?).await?;
        return Ok(all.into_iter().map(|object| object.location).collect());
    }
    let (manifest, _) = Manifest::read(objects, id, revision).await?;
    let mut own: HashSet<String> = manifest.parts.into_iter().map(|part| part.digest).collect();
    for other in known.iter().filter(|other| **other != revision) {
        let (manifest, _) = Manifest::read(objects, id, *other).await?;
        manifest.parts.iter().for_each(|part| {
            own.remove(&part.digest);
        });
    }
    let learning = objects.list(&learning_folder(id, revision)?).await?;
    let learning = learning.into_iter().map(|object| Ok(object.location));
    own.iter().map(|digest| part_path(id, digest)).chain(learning).collect()
}
