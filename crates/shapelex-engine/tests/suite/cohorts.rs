//! Revisions are written once, share their parts, and lose nothing.

use std::time::Duration;

use futures_util::TryStreamExt;
use object_store::path::Path;
use object_store::{ObjectStore, ObjectStoreExt};
use shapelex_analysis::accumulate::PART;
use shapelex_engine::cohort::maintenance::{check, collect, forget, list};
use shapelex_engine::cohort::manifest::{Manifest, revisions};
use shapelex_engine::cohort::revision::Revision;
use shapelex_engine::cohort::writer::Writer;

use crate::support::{WIDTH, description, in_memory, triangle, write};

#[tokio::test]
async fn a_revision_comes_back_as_it_was_written() {
    let (_, objects) = in_memory();
    let count = PART + 5;
    let written = write(&objects, 3, 0..count).await.unwrap();
    assert_eq!((written.shapes, written.parts, written.kept), (count as u64, 2, 0));
    let revision = Revision::open(objects.clone(), "coh_triangles", 3).await.unwrap();
    assert_eq!(revision.digest(), written.digest);
    assert_eq!(revision.manifest().cohort, description(3, count));
    for (k, range) in [(0, 0..PART), (1, PART..count)] {
        let numbers = revision.read(k, &[]).await.unwrap();
        for (i, position) in range.enumerate() {
            let expected = triangle(position);
            assert_eq!(numbers.control_points[i * WIDTH..(i + 1) * WIDTH], expected.control_points);
            assert_eq!(numbers.weights[i], expected.weight);
        }
    }
    let listed = list(&objects).await.unwrap();
    let found: Vec<_> =
        listed.iter().map(|one| (&*one.cohort, one.revision, one.shapes, one.parts)).collect();
    assert_eq!(found, [("coh_triangles", 3, count as u64, 2)]);
}

#[tokio::test]
async fn revisions_share_the_parts_that_they_have_in_common() {
    let (store, objects) = in_memory();
    let first = write(&objects, 1, 0..2 * PART + 10).await.unwrap();
    let second = write(&objects, 2, 0..2 * PART + 20).await.unwrap();
    assert_eq!((second.parts, second.kept), (3, 2), "appended shapes change the last part");
    assert!(second.written_bytes < first.written_bytes / 100, "{second:?}");
    // Without the first shape, all others move.
    let third = write(&objects, 3, 1..2 * PART + 20).await.unwrap();
    assert_eq!((third.parts, third.kept), (3, 0));
    let objects_in_all: Vec<_> = store.list(None).try_collect().await.unwrap();
    assert_eq!(objects_in_all.len(), 3 + 1 + 3 + 3, "seven parts and three manifests");

    let again = write(&objects, 2, 0..2 * PART + 20).await.unwrap();
    assert_eq!((again.digest, again.kept, again.written_bytes), (second.digest, 3, 0));
    let other = write(&objects, 2, 0..2 * PART + 21).await.unwrap_err().to_string();
    assert!(other.starts_with("revision 2 of 'coh_triangles': expected the content that exists"), "{other}");
    assert_eq!(revisions(&objects, "coh_triangles").await.unwrap(), [1, 2, 3]);
}

#[tokio::test]
async fn equal_shapes_have_equal_digests_and_one_bit_makes_another() {
    let (_, objects) = in_memory();
    let digest = |objects, change: usize| async move {
        let mut writer = Writer::begin(objects, description(change as u64, 20), false).await.unwrap();
        for k in 0..20 {
            let mut shape = triangle(k);
            match change {
                2 if k == 7 => {
                    shape.control_points[3] = f64::from_bits(shape.control_points[3].to_bits() ^ 1)
                }
                3 if k == 7 => shape.weight += 1.0,
                4 if k == 7 => shape.metadata = Some("1".into()),
                5 if k == 7 => shape.measures.self_intersecting = Some(false),
                _ => {}
            }
            writer.add(shape).await.unwrap();
        }
        writer.finish().await.unwrap()
    };
    let mut parts = Vec::new();
    for change in 0..6 {
        digest(objects.clone(), change).await;
        let (manifest, _) = Manifest::read(&objects, "coh_triangles", change as u64).await.unwrap();
        parts.push(manifest.parts[0].digest.clone());
    }
    assert_eq!(parts[0], parts[1]);
    for change in 2..6 {
        assert!(!parts[..change].contains(&parts[change]), "change {change}");
    }
}

#[tokio::test]
async fn what_no_manifest_names_is_collected_once_it_is_old() {
    let (store, objects) = in_memory();
    write(&objects, 1, 0..PART + 10).await.unwrap();
    write(&objects, 2, 0..PART + 20).await.unwrap();
    let orphan = Path::from("coh_triangles/parts/abc.parquet");
    store.put(&orphan, "left by a writer".into()).await.unwrap();
    assert_eq!(check(&objects).await.unwrap().unnamed, 1);

    let day = Duration::from_secs(24 * 3600);
    let young = collect(&objects, day, false).await.unwrap();
    assert_eq!((young.named, young.removed, young.young), (3, 0, 1), "a writer may name it");
    forget(&objects, "coh_triangles", 1, false).await.unwrap();
    let dry = collect(&objects, Duration::ZERO, true).await.unwrap();
    assert_eq!((dry.named, dry.removed), (2, 2), "the part with 10 shapes goes too");
    assert!(store.head(&orphan).await.is_ok(), "a dry run removes nothing");
    assert_eq!(collect(&objects, Duration::ZERO, false).await.unwrap(), dry);
    assert!(store.head(&orphan).await.is_err());

    let checked = check(&objects).await.unwrap();
    assert_eq!((checked.revisions, checked.parts, checked.unnamed), (1, 2, 0));
    assert_eq!(checked.faults, [""; 0]);
    let missing = forget(&objects, "coh_triangles", 1, false).await.unwrap_err().to_string();
    assert_eq!(missing, "revision of 'coh_triangles': expected one of [2], got 1");
}

#[tokio::test]
async fn a_revision_goes_with_its_own_parts() {
    let (store, objects) = in_memory();
    write(&objects, 1, 0..PART + 10).await.unwrap();
    write(&objects, 2, 0..PART + 20).await.unwrap();
    forget(&objects, "coh_triangles", 1, true).await.unwrap();
    let checked = check(&objects).await.unwrap();
    assert_eq!((checked.revisions, checked.parts, checked.unnamed), (1, 2, 0), "the shared part stays");
    forget(&objects, "coh_triangles", 2, true).await.unwrap();
    let left: Vec<_> = store.list(None).try_collect().await.unwrap();
    assert!(left.is_empty(), "{left:?}");
}

#[tokio::test]
async fn what_is_not_collected_while_a_manifest_cannot_be_read() {
    let (store, objects) = in_memory();
    write(&objects, 1, 0..10).await.unwrap();
    let manifest = Path::from("coh_triangles/revisions/00000000000000000001.json");
    let text = store.get(&manifest).await.unwrap().bytes().await.unwrap();
    store.put(&manifest, text.slice(..text.len() - 1).into()).await.unwrap();
    let error = collect(&objects, Duration::ZERO, false).await.unwrap_err().to_string();
    assert!(error.contains("is damaged: expected a manifest"), "{error}");
    let parts: Vec<_> = store.list(Some(&Path::from("coh_triangles/parts"))).try_collect().await.unwrap();
    assert_eq!(parts.len(), 1);
}

#[tokio::test]
async fn cohorts_that_do_not_suit_are_refused() {
    let (store, objects) = in_memory();
    let begin = |change: fn(&mut shapelex_engine::cohort::Description)| {
        let mut cohort = description(1, 2);
        change(&mut cohort);
        let objects = objects.clone();
        async move { Writer::begin(objects, cohort, false).await.map(drop).unwrap_err().to_string() }
    };
    for id in ["", "..", "a/b", "ä", &"x".repeat(101)] {
        let mut cohort = description(1, 2);
        cohort.id = id.into();
        let error = Writer::begin(objects.clone(), cohort, false).await.map(drop).unwrap_err().to_string();
        assert!(error.starts_with("id: expected 1 to 100 letters"), "{error}");
    }
    let large = |cohort: &mut shapelex_engine::cohort::Description| {
        cohort.representation =
            shapelex_geometry::representation::Representation::Landmarks { dimension: 3, points: 20_000 };
    };
    let error = begin(large).await;
    assert_eq!(error, "representation: expected at most 32767 coordinates, got 60000");
    let huge = |cohort: &mut shapelex_engine::cohort::Description| {
        cohort.representation =
            shapelex_geometry::representation::Representation::Landmarks { dimension: 2, points: usize::MAX };
    };
    assert!(begin(huge).await.starts_with("representation/points: expected"), "{}", begin(huge).await);
    let cyclic = |cohort: &mut shapelex_engine::cohort::Description| {
        cohort.correspondence = shapelex_analysis::correspondence::Correspondence::Cyclic;
    };
    assert!(begin(cyclic).await.starts_with("correspondence: "), "{}", begin(cyclic).await);

    let mut writer = Writer::begin(objects.clone(), description(1, 3), false).await.unwrap();
    let mut shape = triangle(0);
    shape.control_points.pop();
    let error = writer.add(shape).await.unwrap_err().to_string();
    assert_eq!(error, "shape 'shp_00000000': expected 6 numbers, got 5");
    writer.add(triangle(0)).await.unwrap();
    let error = writer.finish().await.unwrap_err().to_string();
    assert_eq!(error, "number of shapes: expected 3 (shape_count of the cohort), got 1");
    let left: Vec<_> = store.list(Some(&Path::from("coh_triangles/revisions"))).try_collect().await.unwrap();
    assert_eq!(left, [], "no manifest names what is incomplete");
}
