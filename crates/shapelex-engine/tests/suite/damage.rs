//! Damaged parts and stores that misbehave: refused, never a result.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt};
use shapelex_analysis::accumulate::PART;
use shapelex_engine::EngineError;
use shapelex_engine::cohort::maintenance::check;
use shapelex_engine::cohort::manifest::Manifest;
use shapelex_engine::cohort::part_path;
use shapelex_engine::cohort::revision::Revision;
use shapelex_engine::cohort::writer::Writer;
use shapelex_engine::objects::Objects;

use crate::passes::{by, engine, runtime};
use crate::stores::{Fault, Misbehaving};
use crate::support::{description, in_memory, objects, triangle, write};

const SHAPES: usize = 2 * PART + 30;

/// Digest of three sums by the engine.
fn digest(objects: &Objects) -> Result<String, EngineError> {
    let revision = Arc::new(runtime().block_on(Revision::open(objects.clone(), "coh_triangles", 2))?);
    Ok(by(&engine(2, 64 << 20), &revision)?.0)
}

/// Two revisions, and the digest of the second one.
fn written() -> (Arc<InMemory>, Objects, String) {
    let (store, objects) = in_memory();
    let runtime = runtime();
    runtime.block_on(async {
        write(&objects, 1, 1..SHAPES + 1).await.unwrap();
        write(&objects, 2, 0..SHAPES).await.unwrap();
    });
    let digest = digest(&objects).unwrap();
    (store, objects, digest)
}

/// Paths of the parts of a revision.
async fn paths(objects: &Objects, revision: u64) -> Vec<Path> {
    let (manifest, _) = Manifest::read(objects, "coh_triangles", revision).await.unwrap();
    manifest.parts.iter().map(|part| part_path("coh_triangles", &part.digest).unwrap()).collect()
}

#[test]
fn a_part_that_is_truncated_swapped_changed_or_of_another_revision_is_refused() {
    let (store, objects, whole) = written();
    let runtime = runtime();
    let (mine, other) = runtime.block_on(async { (paths(&objects, 2).await, paths(&objects, 1).await) });
    let read =
        |path: &Path| runtime.block_on(async { store.get(path).await.unwrap().bytes().await.unwrap() });
    let good: Vec<_> = mine.iter().map(read).collect();
    let mut turned = good[1].to_vec();
    turned[good[1].len() / 3] ^= 4;
    for (name, k, content, expected) in [
        ("truncated", 1, good[1].slice(..good[1].len() - 9), "bytes, got"),
        ("empty", 1, good[1].slice(..0), "bytes, got 0 bytes"),
        ("swapped", 0, good[1].clone(), "bytes, got"),
        ("of another revision", 0, read(&other[0]), "expected"),
        ("changed", 1, turned.into(), "expected digest"),
        ("last", 2, good[2].slice(1..), "bytes, got"),
    ] {
        runtime.block_on(async { store.put(&mine[k], content.into()).await.unwrap() });
        let error = digest(&objects).unwrap_err();
        assert!(matches!(error, EngineError::Damaged { .. }), "{name}: {error:?}");
        let error = error.to_string();
        assert!(error.starts_with(&format!("{} is damaged", mine[k])), "{name}: {error}");
        assert!(error.contains(expected), "{name}: {error}");
        let checked = runtime.block_on(check(&objects)).unwrap();
        assert_eq!(checked.faults, [error], "{name}");
        runtime.block_on(async { store.put(&mine[k], good[k].clone().into()).await.unwrap() });
    }
    runtime.block_on(async { store.delete(&mine[1]).await.unwrap() });
    let error = digest(&objects).unwrap_err().to_string();
    assert!(error.starts_with(&format!("{}: Object at location", mine[1])), "{error}");
    // Written again, it is there, and the result is what it was.
    let again = runtime.block_on(write(&objects, 2, 0..SHAPES)).unwrap();
    assert_eq!((again.parts, again.kept), (3, 2), "{again:?}");
    assert_eq!(digest(&objects).unwrap(), whole);
}

#[test]
fn damage_of_the_same_length_is_repaired_by_writing_all_again() {
    let (store, objects, whole) = written();
    let runtime = runtime();
    runtime.block_on(async {
        let path = &paths(&objects, 2).await[0];
        let mut bytes = store.get(path).await.unwrap().bytes().await.unwrap().to_vec();
        bytes[1000] ^= 1;
        store.put(path, bytes.into()).await.unwrap();
        let again = write(&objects, 2, 0..SHAPES).await.unwrap();
        assert_eq!(again.kept, 3, "the length tells nothing");
        assert_eq!(check(&objects).await.unwrap().faults.len(), 1);
        let mut writer = Writer::begin(objects.clone(), description(2, SHAPES), true).await.unwrap();
        for k in 0..SHAPES {
            writer.add(triangle(k)).await.unwrap();
        }
        assert_eq!(writer.finish().await.unwrap().kept, 0);
        assert_eq!(check(&objects).await.unwrap().faults, [""; 0]);
    });
    assert_eq!(digest(&objects).unwrap(), whole);
}

#[test]
fn a_manifest_that_is_changed_or_of_another_revision_is_refused() {
    let (store, objects, _) = written();
    let runtime = runtime();
    let path = |revision: u64| Path::from(format!("coh_triangles/revisions/{revision:020}.json"));
    let text = |revision| {
        runtime.block_on(async { store.get(&path(revision)).await.unwrap().bytes().await.unwrap() })
    };
    let good = String::from_utf8(text(2).to_vec()).unwrap();
    for (content, expected) in [
        (good.replacen("\"mm\"", "\"cm\"", 1), "is damaged: expected digest"),
        (good[..100].to_string(), "is damaged: expected a manifest, got EOF"),
        (
            String::from_utf8(text(1).to_vec()).unwrap(),
            "expected revision 2 of 'coh_triangles', got revision 1",
        ),
        (String::new(), "is damaged: expected a manifest"),
    ] {
        runtime.block_on(async { store.put(&path(2), content.into()).await.unwrap() });
        let error = digest(&objects).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    let sealed = |change: fn(&mut Manifest)| {
        let (mut manifest, _) = runtime.block_on(Manifest::read(&objects, "coh_triangles", 1)).unwrap();
        manifest.cohort.revision = 2;
        change(&mut manifest);
        let (content, _) = manifest.seal().unwrap();
        runtime.block_on(async { store.put(&path(2), content.into()).await.unwrap() });
        digest(&objects).unwrap_err().to_string()
    };
    let error = sealed(|manifest| manifest.format = 2);
    assert!(error.ends_with("is damaged: expected format 1, got format 2"), "{error}");
    let error = sealed(|manifest| manifest.parts.swap(0, 2));
    assert!(error.ends_with("is damaged: expected 8192 shapes in part 0, got 30"), "{error}");
    let error = sealed(|manifest| manifest.parts[0] = manifest.parts[1].clone());
    assert!(
        error.contains("expected part 0 from shape 0, 8192 shapes, got part 1 from shape 8192"),
        "{error}"
    );
    let error = sealed(|manifest| manifest.cohort.shape_count += 1);
    assert!(error.ends_with("is damaged: expected 16415 shapes, got 16414"), "{error}");
    let error = sealed(|manifest| manifest.parts[0].size_bytes = u64::MAX);
    assert!(error.contains("expected at most 4294967296 bytes in part 0"), "{error}");
}

#[test]
fn a_store_that_is_unavailable_for_a_while_changes_nothing() {
    let (store, _, whole) = written();
    for fault in [Fault::Unavailable(2), Fault::Late(20), Fault::BreaksOff] {
        let misbehaving = Misbehaving::new(store.clone(), fault);
        assert_eq!(digest(&objects(misbehaving.clone())).unwrap(), whole, "{fault:?}");
        assert!(misbehaving.reads.load(Ordering::Relaxed) >= 9, "three passes over three parts");
    }
}

#[test]
fn a_store_that_does_not_do_as_it_says_is_refused() {
    let (store, _, _) = written();
    for (fault, expected) in [
        (Fault::Unavailable(usize::MAX), "503 Service Unavailable"),
        (Fault::Late(10_000), "expected an answer within 0.3 s, got none in 3 attempts"),
        (Fault::SendsLess(8), "is damaged: expected"),
        (Fault::SendsMore(8), "bytes, got more than that"),
        (Fault::AnnouncesMore(1), "is damaged: expected"),
        (Fault::TurnsABit, "is damaged: expected digest"),
    ] {
        let error = digest(&objects(Misbehaving::new(store.clone(), fault))).unwrap_err().to_string();
        assert!(error.contains(expected), "{fault:?}: {error}");
    }
}

#[tokio::test]
async fn a_full_disk_leaves_no_manifest() {
    let store = Arc::new(InMemory::new());
    let full = objects(Misbehaving::new(store.clone(), Fault::Full));
    let error = write(&full, 1, 0..10).await.unwrap_err().to_string();
    assert!(error.contains("No space left on device"), "{error}");
    assert!(store.list_with_delimiter(None).await.unwrap().common_prefixes.is_empty());
}
