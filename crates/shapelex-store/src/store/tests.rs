//! Tests of the store through its public interface, each on a fresh folder.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use serde_json::{Value, json};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_geometry::representation::Representation;
use tempfile::TempDir;

use super::engine::*;
use super::folder::*;
use super::handle::*;
use super::*;
use crate::domain::access::Principal;
use crate::domain::attribute::{Attribute, Measure};
use crate::domain::cohort::{Cohort, CohortSpec, FormerRule};
use crate::domain::filter::ShapeFilter;
use crate::domain::id;
use crate::domain::shape::{NewShape, Shape, ShapeAttributes, ShapeMeasures};

mod audit;
mod corrections;
mod hooks;
mod jobs;
mod keys;
mod opening;
mod previews;
mod sharing;
mod units;

/// Number of coordinates of a shape of [`cohort`].
const WIDTH: usize = 6;

/// Address of PostgreSQL for the tests; without it they run on the embedded database.
pub(super) const DATABASE_URL: &str = "SHAPELEX_TEST_DATABASE_URL";

pub(super) async fn fresh() -> (TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let store = match std::env::var(DATABASE_URL) {
        Ok(url) => Store::connect(&fresh_schema(&url).await, 4).await.unwrap(),
        Err(_) => Store::open(folder.path()).await.unwrap(),
    };
    (folder, store)
}

/// A store that is always embedded.
pub(super) async fn embedded() -> (TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(folder.path()).await.unwrap();
    (folder, store)
}

/// Address of a new schema, which acts as a separate database.
pub(super) async fn fresh_schema(url: &str) -> String {
    let schema = format!("test_{}", uuid::Uuid::now_v7().simple());
    let pool = sqlx::PgPool::connect(url).await.unwrap();
    let create = sqlx::AssertSqlSafe(format!("CREATE SCHEMA {schema}"));
    sqlx::query(create).execute(&pool).await.unwrap();
    pool.close().await;
    format!("{url}?options=-csearch_path%3D{schema}")
}

pub(super) fn cohort(name: &str) -> Cohort {
    Cohort {
        id: id::new_id(id::COHORT),
        spec: CohortSpec {
            name: name.into(),
            description: Some("left hands".into()),
            representation: Representation::Landmarks { dimension: 2, points: WIDTH / 2 },
            correspondence: Correspondence::ArcLength,
            direction: Direction::Either,
            mirror: Mirror::Allow,
            length_unit: Some("mm".into()),
        },
        revision: 0,
        shapes: 0,
        created_at_ms: 11,
        former_rules: Vec::new(),
        updated_at_ms: 12,
    }
}

pub(super) fn shape(number: usize) -> NewShape {
    NewShape {
        id: id::new_id(id::SHAPE),
        attributes: ShapeAttributes { weight: 1.0, ..ShapeAttributes::default() },
        measures: ShapeMeasures::default(),
        control_points: (0..WIDTH).map(|k| (number * 10 + k) as f64).collect(),
    }
}

pub(super) fn named(number: usize, external_id: &str) -> NewShape {
    let mut shape = shape(number);
    shape.attributes.external_id = Some(external_id.into());
    shape
}

async fn with_cohort() -> (TempDir, Store, Cohort) {
    let (folder, store) = fresh().await;
    let cohort = cohort("hands");
    store.create_cohort(&cohort, None).await.unwrap();
    (folder, store, cohort)
}

async fn embedded_with_cohort() -> (TempDir, Store, Cohort) {
    let (folder, store) = embedded().await;
    let cohort = cohort("hands");
    store.create_cohort(&cohort, None).await.unwrap();
    (folder, store, cohort)
}

pub(super) async fn store_all(store: &Store, cohort: &Cohort, shapes: Vec<NewShape>) -> u64 {
    let mut upload = store.begin_upload(cohort);
    upload.add(shapes).await.unwrap();
    upload.commit(20).await.unwrap()
}

async fn list_all(store: &Store, cohort: &Cohort, filter: &ShapeFilter) -> Vec<Shape> {
    let page = store.list_shapes(&cohort.id, &Listing::first(filter, 1000)).await;
    page.unwrap().shapes
}

/// Control points and weights of the shapes at the places of a filter.
async fn scan_places(
    store: &Store,
    cohort: &Cohort,
    revision: u64,
    filter: &ShapeFilter,
) -> (Vec<f64>, Vec<f64>) {
    let places = store.places(&cohort.id, Revisions::until(revision), filter).await.unwrap();
    let (mut points, mut weights, mut first) = (Vec::new(), Vec::new(), 0);
    while let Some((batch, next)) = store.scan_places(&cohort.id, revision, &places, first).await.unwrap() {
        assert_eq!(batch.places.iter().next(), places.get(first));
        assert_eq!(next - first, batch.weights.len());
        points.extend(batch.control_points);
        weights.extend(batch.weights);
        first = next;
    }
    assert_eq!(first, places.count());
    (points, weights)
}

/// Control points of a scan, and the ids if requested; a scan of the places finds the same.
async fn scan_all(
    store: &Store,
    cohort: &Cohort,
    revision: u64,
    filter: &ShapeFilter,
    ids: Ids,
) -> (Vec<f64>, Vec<String>) {
    let (mut points, mut found, mut after) = (Vec::new(), Vec::new(), None);
    while let Some(batch) =
        store.scan(&cohort.id, Revisions::until(revision), filter, after, ids).await.unwrap()
    {
        assert_eq!(batch.control_points.len(), batch.weights.len() * WIDTH);
        points.extend(batch.control_points);
        found.extend(batch.ids);
        after = Some(batch.position);
    }
    assert_eq!(scan_places(store, cohort, revision, filter).await.0, points);
    (points, found)
}

pub(super) async fn rows(store: &Store, table: &'static str) -> i64 {
    let mut query = sql(store.reader(), "SELECT count(*) FROM ");
    query.push(table);
    query.scalar().await.unwrap()
}

/// Runs a statement that the store itself never runs.
pub(super) async fn meddle(store: &Store, statement: &'static str) {
    store.meddle(statement).await;
}

/// Waits for rows to be removed in the background.
async fn wait_until_empty(store: &Store, table: &'static str) {
    for _ in 0..200 {
        if rows(store, table).await == 0 {
            return;
        }
        tokio::time::sleep(std::time::Duration::from_millis(10)).await;
    }
    panic!("{table} still has {} rows", rows(store, table).await);
}

static EVERYTHING: ShapeFilter = ShapeFilter::everything();

#[tokio::test]
async fn cohorts_come_back_as_they_were() {
    let (_folder, store, first) = with_cohort().await;
    let mut second = cohort("feet");
    (second.spec.description, second.spec.length_unit) = (None, None);
    second.revision = 7;
    store.create_cohort(&second, None).await.unwrap();
    for (key, expected) in [(&first.id, &first), (&second.spec.name, &second)] {
        let found = store.find_cohort(key).await.unwrap();
        assert_eq!(found.as_ref(), Some(expected));
    }
    assert_eq!(store.find_cohort("toes").await.unwrap(), None);
}

#[tokio::test]
async fn a_name_is_given_once() {
    let (_folder, store, first) = with_cohort().await;
    let error = store.create_cohort(&cohort("hands"), None).await.unwrap_err();
    assert!(matches!(&error, StoreError::NameTaken { name } if name == "hands"));
    assert_eq!(error.to_string(), "the name is already in use");
    assert_eq!(store.list_cohorts(None, 9).await.unwrap(), [first]);
}

#[tokio::test]
async fn cohorts_are_listed_in_pages() {
    let (_folder, store) = fresh().await;
    let mut ids = Vec::new();
    for number in 0..5 {
        let cohort = cohort(&format!("c{number}"));
        store.create_cohort(&cohort, None).await.unwrap();
        ids.push(cohort.id);
    }
    ids.sort();
    let first = store.list_cohorts(None, 3).await.unwrap();
    let rest = store.list_cohorts(Some(&first[2].id), 3).await.unwrap();
    let listed: Vec<String> = first.into_iter().chain(rest).map(|c| c.id).collect();
    assert_eq!(listed, ids);
}

#[tokio::test]
async fn shapes_come_back_bit_for_bit() {
    let (_folder, store, cohort) = with_cohort().await;
    let mut full = named(1, "é\"x'\ty");
    full.control_points = vec![0.1, -0.0, f64::MIN_POSITIVE / 2.0, 1e308, 1.0 / 3.0, -7.5];
    full.attributes.subject = Some("s1".into());
    full.attributes.label = Some("left".into());
    full.attributes.weight = 0.1 + 0.2;
    full.attributes.labels =
        BTreeMap::from([("a".into(), json!("text")), ("b".into(), json!(1.5)), ("c".into(), json!(true))]);
    full.attributes.metadata = Some(json!({"z": [1, 0.1, null], "a": "\u{0}"}).to_string());
    let mut nulled = shape(2);
    nulled.attributes.metadata = Some("null".into());
    let given = vec![full.clone(), nulled, shape(3)];
    store_all(&store, &cohort, given.clone()).await;

    let listed = list_all(&store, &cohort, &EVERYTHING).await;
    for (shape, given) in listed.iter().zip(&given) {
        assert_eq!(shape.id, given.id);
        assert_eq!(shape.attributes, given.attributes);
        assert_eq!(shape.created_at_ms, 20);
        let bits = |numbers: &[f64]| numbers.iter().map(|n| n.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&shape.control_points), bits(&given.control_points));
    }
    assert_eq!(listed.len(), 3);
    for key in [&full.id, "é\"x'\ty"] {
        let found = store.find_shape(&cohort.id, key).await.unwrap();
        assert_eq!(found.as_ref(), Some(&listed[0]));
    }
    assert_eq!(store.find_shape(&cohort.id, "nobody").await.unwrap(), None);
    assert_eq!(store.find_shape("coh_x", &full.id).await.unwrap(), None);
}

#[tokio::test]
async fn an_upload_is_seen_when_it_is_complete() {
    let (_folder, store, cohort) = with_cohort().await;
    let mut upload = store.begin_upload(&cohort);
    for call in 0..3 {
        let shapes = vec![named(call, &format!("e{call}")), shape(call)];
        upload.add(shapes).await.unwrap();
    }
    assert_eq!(store.find_shape(&cohort.id, "e0").await.unwrap(), None);
    assert!(list_all(&store, &cohort, &EVERYTHING).await.is_empty());
    assert_eq!(store.count(&cohort.id, Revisions::until(9), &EVERYTHING).await.unwrap(), 0);
    let (points, _) = scan_all(&store, &cohort, 9, &EVERYTHING, Ids::Skip).await;
    assert!(points.is_empty());

    assert_eq!(upload.commit(33).await.unwrap(), 1);
    assert_eq!(list_all(&store, &cohort, &EVERYTHING).await.len(), 6);
    let found = store.find_cohort("hands").await.unwrap().unwrap();
    assert_eq!((found.revision, found.shapes, found.updated_at_ms), (1, 6, 33));
}

#[tokio::test]
async fn an_abandoned_upload_leaves_nothing() {
    let (_folder, store, cohort) = with_cohort().await;
    let mut upload = store.begin_upload(&cohort);
    upload.add(vec![named(1, "e")]).await.unwrap();
    assert_eq!(rows(&store, "shape").await, 1);
    upload.abort().await.unwrap();
    assert_eq!(rows(&store, "shape").await, 0);

    let mut upload = store.begin_upload(&cohort);
    upload.add(vec![named(2, "e")]).await.unwrap();
    drop(upload);
    for table in ["shape", "chunk_data", "chunk"] {
        wait_until_empty(&store, table).await;
    }
    assert_eq!(store_all(&store, &cohort, vec![named(3, "e")]).await, 1);
}

#[tokio::test]
async fn a_restart_removes_unfinished_uploads() {
    let (folder, store, cohort) = embedded_with_cohort().await;
    store_all(&store, &cohort, vec![shape(1)]).await;
    let mut upload = store.begin_upload(&cohort);
    upload.add(vec![shape(2)]).await.unwrap();
    // Simulates a crash: no clean-up.
    std::mem::forget(upload);
    store.close().await;

    let store = Store::open(folder.path()).await.unwrap();
    assert_eq!(rows(&store, "shape").await, 1);
    assert_eq!(rows(&store, "chunk_data").await, 1);
    let found = store.find_cohort(&cohort.id).await.unwrap().unwrap();
    assert_eq!((found.revision, found.shapes), (1, 1));
}

#[tokio::test]
async fn the_same_content_again_is_a_retry() {
    let (_folder, store, cohort) = with_cohort().await;
    let mut first = named(1, "a");
    first.attributes.metadata = Some(json!({"x": 1, "y": 2}).to_string());
    let revision = store_all(&store, &cohort, vec![first.clone(), shape(5)]).await;

    let mut again = first.clone();
    again.id = id::new_id(id::SHAPE);
    let (new, twin) = (named(2, "b"), named(2, "b"));
    let existing = |id: &str| Added::Existing { id: id.into(), differs: false };
    let mut upload = store.begin_upload(&cohort);
    let added = upload.add(vec![again.clone(), new.clone(), twin.clone()]);
    let expected = [existing(&first.id), Added::New { id: new.id.clone() }, existing(&new.id)];
    assert_eq!(added.await.unwrap(), expected);
    assert_eq!(upload.add(vec![twin]).await.unwrap(), [existing(&new.id)]);
    assert_eq!(upload.commit(1).await.unwrap(), revision + 1);
    assert_eq!(list_all(&store, &cohort, &EVERYTHING).await.len(), 3);

    // Nothing new, so nothing changes.
    let mut upload = store.begin_upload(&cohort);
    upload.add(vec![again]).await.unwrap();
    assert_eq!(upload.commit(99).await.unwrap(), revision + 1);
    let found = store.find_cohort(&cohort.id).await.unwrap().unwrap();
    assert_eq!(found.updated_at_ms, 1);
}

#[tokio::test]
async fn other_content_under_an_external_id_is_a_conflict() {
    let (_folder, store, cohort) = with_cohort().await;
    store_all(&store, &cohort, vec![named(1, "a")]).await;
    let conflict_at = |result: Result<Vec<Added>, StoreError>, expected: u64, key: &str| {
        let error = result.unwrap_err();
        assert!(
            matches!(&error, StoreError::ExternalIdConflict { position, external_id }
                if *position == expected && external_id == key),
            "{error:?}"
        );
    };
    let mut upload = store.begin_upload(&cohort);
    conflict_at(upload.add(vec![shape(0), named(2, "a")]).await, 1, "a");
    upload.add(vec![shape(0), named(3, "b")]).await.unwrap();
    // Within the upload itself: across calls, and in one call.
    conflict_at(upload.add(vec![named(4, "b")]).await, 2, "b");
    let twins = vec![named(5, "c"), named(6, "c")];
    conflict_at(upload.add(twins).await, 3, "c");
    // Attributes are not a reason: those that are stored stay.
    let mut heavier = named(1, "a");
    heavier.attributes.weight = 2.0;
    let added = upload.add(vec![heavier]).await.unwrap();
    assert!(matches!(&added[..], [Added::Existing { differs: true, .. }]), "{added:?}");
    // Where conflicts are skipped, the others are stored.
    let mut skipping = store.begin_upload(&cohort);
    skipping.skip_conflicts();
    let added = skipping.add(vec![named(2, "a"), named(7, "d"), named(8, "d")]).await.unwrap();
    assert!(matches!(&added[..], [Added::Conflict, Added::New { .. }, Added::Conflict]), "{added:?}");
    skipping.abort().await.unwrap();
    // Uncommitted shapes of another upload may vanish, so even the same content does not count as existing.
    let mut other = store.begin_upload(&cohort);
    let error = other.add(vec![named(3, "b")]).await.unwrap_err();
    assert!(matches!(&error, StoreError::ExternalIdPending { position: 0, .. }), "{error:?}");
    upload.commit(1).await.unwrap();
    assert_eq!(other.add(vec![named(3, "b")]).await.unwrap().len(), 1);
}

#[tokio::test]
async fn a_shape_of_another_size_is_refused() {
    let (_folder, store, cohort) = with_cohort().await;
    let mut long = shape(1);
    long.control_points.push(0.0);
    let result = store.begin_upload(&cohort).add(vec![shape(0), long]).await;
    let error = result.unwrap_err().to_string();
    assert_eq!(error, "shape 1 has 7 numbers, expected 6");
}

#[tokio::test]
async fn a_deleted_shape_stays_in_earlier_revisions() {
    let (_folder, store, cohort) = with_cohort().await;
    let shapes: Vec<NewShape> = (0..5).map(|i| named(i, &format!("e{i}"))).collect();
    let before = store_all(&store, &cohort, shapes.clone()).await;
    for index in [0, 2] {
        let deleted = store.delete_shape(&cohort.id, &shapes[index].id, 50).await;
        assert!(deleted.unwrap() > Some(before));
        let again = store.delete_shape(&cohort.id, &shapes[index].id, 51).await;
        assert_eq!(again.unwrap(), None);
    }
    let found = store.find_cohort(&cohort.id).await.unwrap().unwrap();
    assert_eq!((found.revision, found.shapes, found.updated_at_ms), (3, 3, 50));
    assert_eq!(store.find_shape(&cohort.id, "e2").await.unwrap(), None);

    for (revision, kept) in [(0, &[][..]), (1, &[0, 1, 2, 3, 4][..]), (2, &[1, 2, 3, 4]), (3, &[1, 3, 4])] {
        let points: Vec<f64> = kept.iter().flat_map(|&i| shapes[i].control_points.clone()).collect();
        let ids: Vec<String> = kept.iter().map(|&i| shapes[i].id.clone()).collect();
        let fast = scan_all(&store, &cohort, revision, &EVERYTHING, Ids::Skip).await;
        assert_eq!(fast, (points.clone(), Vec::new()), "revision {revision}");
        let slow = scan_all(&store, &cohort, revision, &EVERYTHING, Ids::Include).await;
        assert_eq!(slow, (points, ids), "revision {revision}");
        let count = store.count(&cohort.id, Revisions::until(revision), &EVERYTHING).await;
        assert_eq!(count.unwrap(), kept.len() as u64, "revision {revision}");
    }
    // Its external id is free again.
    assert_eq!(store_all(&store, &cohort, vec![named(9, "e2")]).await, 4);
}

#[tokio::test]
async fn a_scan_skips_chunks_without_shapes() {
    let (_folder, store, cohort) = with_cohort().await;
    let (first, second) = (shape(1), shape(2));
    store_all(&store, &cohort, vec![first.clone()]).await;
    store_all(&store, &cohort, vec![second.clone()]).await;
    store.delete_shape(&cohort.id, &first.id, 1).await.unwrap();
    for ids in [Ids::Skip, Ids::Include] {
        let (points, _) = scan_all(&store, &cohort, 3, &EVERYTHING, ids).await;
        assert_eq!(points, second.control_points);
    }
}

#[tokio::test]
async fn many_chunks_are_scanned_in_batches() {
    let (_folder, store) = fresh().await;
    let (points, count) = (20_000, 31);
    let mut wide = cohort("wide");
    wide.spec.representation = Representation::Landmarks { dimension: 2, points };
    store.create_cohort(&wide, None).await.unwrap();
    let shapes: Vec<NewShape> = (0..count)
        .map(|number| {
            let mut shape = shape(number);
            shape.attributes.label = (number % 3 == 0).then(|| "third".into());
            shape.attributes.weight = 1.0 + (number % 2) as f64;
            shape.control_points = vec![number as f64; 2 * points];
            shape
        })
        .collect();
    let revision = store_all(&store, &wide, shapes).await;
    let third = ShapeFilter { label: Some("third".into()), ..ShapeFilter::default() };
    for (filter, ids, step) in
        [(&EVERYTHING, Ids::Skip, 1), (&EVERYTHING, Ids::Include, 1), (&third, Ids::Skip, 3)]
    {
        let (mut after, mut seen, mut batches) = (None, Vec::new(), 0);
        while let Some(batch) =
            store.scan(&wide.id, Revisions::until(revision), filter, after, ids).await.unwrap()
        {
            assert!(batch.control_points.len() <= (4 << 20) / 8);
            let firsts = batch.control_points.iter().step_by(2 * points);
            seen.extend(firsts.copied().zip(batch.weights));
            (after, batches) = (Some(batch.position), batches + 1);
        }
        let expected: Vec<(f64, f64)> =
            (0..count).step_by(step).map(|number| (number as f64, 1.0 + (number % 2) as f64)).collect();
        assert_eq!(seen, expected);
        assert!(step == 3 || batches > 1, "{batches} batches");
        let (numbers, weights) = scan_places(&store, &wide, revision, filter).await;
        let firsts = numbers.into_iter().step_by(2 * points);
        assert_eq!(firsts.zip(weights).collect::<Vec<_>>(), expected);
    }
}

#[tokio::test]
async fn shapes_are_listed_in_pages() {
    let (_folder, store, cohort) = with_cohort().await;
    let mut expected = Vec::new();
    for _ in 0..3 {
        let shapes: Vec<NewShape> = (0..4).map(shape).collect();
        expected.extend(shapes.iter().map(|s| s.id.clone()));
        store_all(&store, &cohort, shapes).await;
    }
    let (mut after, mut listed) = (None, Vec::new());
    loop {
        let page = store.list_shapes(&cohort.id, &Listing { after, ..Listing::first(&EVERYTHING, 5) }).await;
        let page = page.unwrap();
        listed.extend(page.shapes.into_iter().map(|s| s.id));
        let Some(next) = page.next else { break };
        after = Some(next.to_string().parse().unwrap());
    }
    assert_eq!(listed, expected);
    // At an earlier revision, whatever was added and deleted since.
    let revision = store.find_cohort(&cohort.id).await.unwrap().unwrap().revision - 1;
    store.delete_shape(&cohort.id, &expected[1], 1).await.unwrap();
    let then = Listing { revisions: Revisions::until(revision), ..Listing::first(&EVERYTHING, 20) };
    let then = store.list_shapes(&cohort.id, &then).await.unwrap().shapes;
    assert_eq!(then.into_iter().map(|s| s.id).collect::<Vec<_>>(), expected[..8]);
    for wrong in ["", "1", "-1-2", "1-+2", "1-g", "1-2-3", "ffffffffffffffffff-1"] {
        assert_eq!(wrong.parse::<Cursor>(), Err(CursorError), "{wrong}");
    }
}

#[tokio::test]
async fn descriptions_are_those_of_a_revision() {
    let (_folder, store, cohort) = with_cohort().await;
    let labelled = |number: usize, label: &str| {
        let mut shape = named(number, &number.to_string());
        shape.attributes.label = Some(label.into());
        shape.attributes.labels = BTreeMap::from([("age".to_owned(), json!(number))]);
        shape
    };
    let shapes: Vec<NewShape> = (0..6).map(|k| labelled(k, if k % 2 == 0 { "a" } else { "b" })).collect();
    let first = store_all(&store, &cohort, shapes).await;
    let second = store_all(&store, &cohort, vec![labelled(6, "a")]).await;
    let describe = async |revision: u64, filter: &ShapeFilter, limit: usize| {
        let revisions = Revisions::until(revision);
        let found = store.describe_shapes(&cohort.id, revisions, filter, limit).await.unwrap();
        found.into_iter().map(|shape| (shape.id, shape.labels["age"].clone())).collect::<Vec<_>>()
    };
    let (all, a) =
        (ShapeFilter::default(), ShapeFilter { label: Some("a".into()), ..ShapeFilter::default() });
    let before = describe(first, &all, 100).await;
    assert_eq!(
        before.iter().map(|(_, age)| age.clone()).collect::<Vec<_>>(),
        (0..6).map(|k| json!(k)).collect::<Vec<_>>()
    );
    assert_eq!(describe(second, &a, 100).await.len(), 4);
    assert_eq!(describe(second, &all, 3).await, before[..3]);
    store.delete_shape(&cohort.id, &before[0].0, 30).await.unwrap();
    assert_eq!(describe(first, &all, 100).await, before, "what was deleted later is seen");
    assert_eq!(describe(second + 1, &a, 100).await.len(), 3);
}

/// Values read by themselves are those of descriptions, numbers to the last bit, for any attributes, filter and revision.
#[tokio::test]
async fn values_are_those_of_descriptions() {
    let (_folder, store, cohort) = with_cohort().await;
    let names = ["age", "a.b\"c", "none"];
    let values =
        [json!(0.1), json!(1.0), json!("x"), json!(true), json!(null), json!(1e300), json!("1.0"), json!(7)];
    let shape = |k: usize| {
        let mut shape = named(k, &format!("s{k}"));
        shape.attributes.subject = (!k.is_multiple_of(3)).then(|| format!("p {}", k % 5));
        shape.attributes.label = k.is_multiple_of(2).then(|| "a".into());
        let of = |(i, name): (usize, &&str)| ((*name).to_owned(), values[(k + 3 * i) % values.len()].clone());
        shape.attributes.labels =
            names[..2].iter().enumerate().filter(|(i, _)| k % 7 != *i).map(of).collect();
        shape.measures = ShapeMeasures {
            points: (!k.is_multiple_of(4)).then_some(k as u64),
            centroid_size: Some(1.0 / (3 + k) as f64),
            length: (!k.is_multiple_of(3)).then(|| 1e-3 * (k as f64).sqrt()),
            self_intersecting: Some(k.is_multiple_of(2)),
            ..ShapeMeasures::default()
        };
        shape
    };
    let mut revision = 0;
    for first in (0..90).step_by(15) {
        revision = store_all(&store, &cohort, (first..first + 15).map(shape).collect()).await;
    }
    let described =
        store.describe_shapes(&cohort.id, Revisions::latest(), &ShapeFilter::default(), 100).await;
    store.delete_shape(&cohort.id, &described.unwrap()[20].id, 30).await.unwrap();
    let mut attributes: Vec<Attribute> = names.iter().map(|name| Attribute::Labels((*name).into())).collect();
    attributes.extend([Attribute::Subject, Attribute::Label, Attribute::ExternalId, Attribute::CreatedAt]);
    attributes.extend(Measure::ALL.map(Attribute::Measure));
    let with_age = ShapeFilter { has: [Attribute::Labels("age".into())].into(), ..ShapeFilter::default() };
    let of_label = ShapeFilter { label: Some("a".into()), ..ShapeFilter::default() };
    for filter in [&ShapeFilter::default(), &with_age, &of_label] {
        for revisions in [Revisions::until(revision), Revisions::latest()] {
            let described = store.describe_shapes(&cohort.id, revisions, filter, 100).await.unwrap();
            let (mut found, mut after) = (Vec::new(), None);
            while let Some(page) =
                store.values(&cohort.id, revisions, filter, &attributes, after).await.unwrap()
            {
                after = page.places.last().copied();
                assert!(page.places.is_sorted());
                found.extend(page.values);
            }
            assert_eq!(found.len(), described.len());
            for (values, shape) in found.iter().zip(&described) {
                for (attribute, value) in attributes.iter().zip(values) {
                    assert_eq!(attribute.text_of(value), attribute.text(shape), "{attribute}");
                    let [own, wanted] = [attribute.number_of(value), attribute.number(shape)];
                    assert_eq!(own.map(f64::to_bits), wanted.map(f64::to_bits), "{attribute}");
                }
            }
        }
    }
}

#[tokio::test]
async fn filters_compare_attributes_as_text() {
    let (_folder, store, cohort) = with_cohort().await;
    let attributes = [
        ("plain", json!("left")),
        ("plain", json!("Left")),
        ("flag", json!(true)),
        ("flag", json!("false")),
        ("size", json!(1.5)),
        ("size", json!(2)),
        ("big", json!(1e21)),
        ("a.b", json!("dot")),
        ("a\"b", json!("quote")),
        ("a\\b", json!("backslash")),
        ("größe 尺", json!("naïve")),
        ("$[0]", json!("path")),
        ("' OR 1=1 --", json!("inject")),
        ("", json!("empty")),
        ("tab\t", json!("tab")),
    ];
    let shapes = attributes.iter().enumerate().map(|(number, (key, value))| {
        let mut shape = shape(number);
        shape.attributes.labels = BTreeMap::from([((*key).to_owned(), value.clone())]);
        shape
    });
    let revision = store_all(&store, &cohort, shapes.collect()).await;
    for (number, (key, value)) in attributes.iter().enumerate() {
        let text = value.as_str().map_or(value.to_string(), str::to_owned);
        let filter = ShapeFilter {
            labels: BTreeMap::from([((*key).to_owned(), text.into())]),
            ..ShapeFilter::default()
        };
        let (points, _) = scan_all(&store, &cohort, revision, &filter, Ids::Skip).await;
        assert_eq!(points, shape(number).control_points, "{key:?}");
        let count = store.count(&cohort.id, Revisions::until(revision), &filter).await.unwrap();
        assert_eq!(count, 1, "{key:?}");
    }
    for (key, value) in [("flag", "1"), ("size", "2.5"), ("a", "dot"), ("none", "x")] {
        let filter = ShapeFilter {
            labels: BTreeMap::from([(key.to_owned(), value.into())]),
            ..ShapeFilter::default()
        };
        assert!(list_all(&store, &cohort, &filter).await.is_empty(), "{key}");
    }
}

#[tokio::test]
async fn shapes_of_earlier_versions_are_measured_once() {
    let (_folder, store, cohort) = with_cohort().await;
    store_all(&store, &cohort, (0..3).map(shape).collect()).await;
    let unmeasured = store.unmeasured(&cohort.id).await.unwrap();
    assert_eq!(unmeasured.len(), 3);
    assert_eq!(unmeasured[1].control_points, shape(1).control_points);
    let measures =
        ShapeMeasures { centroid_size: Some(2.5), self_intersecting: Some(true), ..ShapeMeasures::default() };
    store.keep_measures(&[(unmeasured[0].place, measures), (unmeasured[2].place, measures)]).await.unwrap();
    let left = store.unmeasured(&cohort.id).await.unwrap();
    assert_eq!(left, [unmeasured[1].clone()]);
    let other = ShapeMeasures { centroid_size: Some(9.0), ..measures };
    store.keep_measures(&[(unmeasured[0].place, other)]).await.unwrap();
    let listed = list_all(&store, &cohort, &EVERYTHING).await;
    assert_eq!((listed[0].measures, listed[1].measures), (measures, ShapeMeasures::default()));
}

#[tokio::test]
async fn directions_of_earlier_versions_are_kept_once_and_counted() {
    let (_folder, store, cohort) = with_cohort().await;
    store_all(&store, &cohort, (0..5).map(shape).collect()).await;
    let all = Revisions::latest();
    let undirected = store.undirected(&cohort.id, None).await.unwrap();
    assert_eq!(undirected.len(), 5);
    assert_eq!(undirected[3].control_points, shape(3).control_points);
    let later = store.undirected(&cohort.id, Some(undirected[1].place)).await.unwrap();
    assert_eq!(later, undirected[2..]);
    let directions: Vec<(Cursor, bool)> =
        undirected[..4].iter().enumerate().map(|(k, shape)| (shape.place, k == 2)).collect();
    store.keep_directions(&directions).await.unwrap();
    store.keep_directions(&[(undirected[0].place, true)]).await.unwrap();
    assert_eq!(store.undirected(&cohort.id, None).await.unwrap(), undirected[4..]);
    let found = store.tally(&cohort.id, all, &EVERYTHING).await.unwrap();
    assert_eq!(found, Tally { shapes: 5, clockwise: 1, counter_clockwise: 3, fitted: 0 });
    let mut filter = ShapeFilter::default();
    filter.condition(Attribute::Measure(Measure::Clockwise)).add("eq", "true".into()).unwrap();
    assert_eq!(list_all(&store, &cohort, &filter).await.len(), 1);
}

#[tokio::test]
async fn a_rule_changes_with_a_revision_and_all_shapes() {
    let (_folder, store, cohort) = with_cohort().await;
    store_all(&store, &cohort, (0..3).map(shape).collect()).await;
    let cohort = store.find_cohort(&cohort.id).await.unwrap().unwrap();
    let late = store.begin_upload(&cohort);
    let listed = list_all(&store, &cohort, &EVERYTHING).await;
    let again = |shape: &Shape| {
        let control_points = shape.control_points.iter().map(|x| 2.0 * x).collect();
        let new = NewShape {
            id: shape.id.clone(),
            attributes: shape.attributes.clone(),
            measures: shape.measures,
            control_points,
        };
        (ShapeRow::from(new), shape.created_at_ms)
    };
    let former = FormerRule {
        until: cohort.revision,
        correspondence: cohort.spec.correspondence,
        direction: cohort.spec.direction,
        mirror: cohort.spec.mirror,
    };
    let spec = CohortSpec { direction: Direction::Given, ..cohort.spec.clone() };
    let changed = Cohort { spec, former_rules: vec![former], ..cohort.clone() };
    store.change_rule(&changed, Some(listed.iter().map(again).collect()), 99).await.unwrap();
    let found = store.find_cohort(&cohort.id).await.unwrap().unwrap();
    assert_eq!((found.revision, found.shapes), (cohort.revision + 1, 3));
    assert_eq!((found.spec.direction, &found.former_rules), (Direction::Given, &changed.former_rules));
    assert_eq!(found.clone().at(cohort.revision).spec, cohort.spec);
    assert_eq!(found.clone().at(found.revision).spec, found.spec);
    let relisted = list_all(&store, &cohort, &EVERYTHING).await;
    for (new, old) in relisted.iter().zip(&listed) {
        assert_eq!(
            (&new.id, new.created_at_ms, &new.attributes),
            (&old.id, old.created_at_ms, &old.attributes)
        );
        assert_eq!(new.control_points[0], 2.0 * old.control_points[0]);
    }
    let before =
        store.scan(&cohort.id, Revisions::until(cohort.revision), &EVERYTHING, None, Ids::Skip).await;
    assert_eq!(before.unwrap().unwrap().control_points[..WIDTH], listed[0].control_points[..]);
    // A shape converted by the former rule does not come in later, nor does a change of another revision.
    assert!(matches!(committed(late, shape(7)).await, Err(StoreError::Changed)));
    let stale = store.change_rule(&changed, Some(Vec::new()), 100).await;
    assert!(matches!(stale, Err(StoreError::Changed)), "{stale:?}");
}

/// Adds a shape to an upload that has begun.
async fn committed(mut upload: Upload, shape: NewShape) -> Result<u64, StoreError> {
    upload.add(vec![shape]).await?;
    upload.commit_once(1, None, None, |_| None).await
}

#[tokio::test]
async fn filters_combine() {
    let (_folder, store, cohort) = with_cohort().await;
    let shapes: Vec<NewShape> = (0..24)
        .map(|number| {
            let mut shape = shape(number);
            shape.attributes.label = Some(format!("l{}", number % 2));
            shape.attributes.subject = Some(format!("s{}", number % 3));
            shape.attributes.labels = BTreeMap::from([("q".into(), json!(number % 4))]);
            shape
        })
        .collect();
    let revision = store_all(&store, &cohort, shapes.clone()).await;
    let mut filter = ShapeFilter { label: Some("l1".into()), ..ShapeFilter::default() };
    assert_eq!(list_all(&store, &cohort, &filter).await.len(), 12);
    filter.subject = Some("s1".into());
    assert_eq!(list_all(&store, &cohort, &filter).await.len(), 4);
    filter.labels = BTreeMap::from([("q".into(), "3".into())]);
    let (_, ids) = scan_all(&store, &cohort, revision, &filter, Ids::Include).await;
    assert_eq!(ids, [shapes[7].id.clone(), shapes[19].id.clone()]);
}

#[tokio::test]
async fn a_deleted_cohort_is_gone_with_its_shapes() {
    let (_folder, store, cohort) = with_cohort().await;
    store_all(&store, &cohort, vec![named(1, "a")]).await;
    let mut upload = store.begin_upload(&cohort);
    upload.add(vec![shape(2)]).await.unwrap();

    assert!(store.remove_cohort(&cohort.id).await.unwrap());
    assert!(!store.remove_cohort(&cohort.id).await.unwrap());
    for table in ["cohort", "chunk", "chunk_data", "shape"] {
        assert_eq!(rows(&store, table).await, 0, "{table}");
    }
    let gone = |error: StoreError| assert!(matches!(error, StoreError::CohortGone), "{error:?}");
    gone(upload.add(vec![shape(3)]).await.unwrap_err());
    gone(upload.commit(1).await.unwrap_err());
    let scan = store.scan(&cohort.id, Revisions::until(1), &EVERYTHING, None, Ids::Skip);
    gone(scan.await.unwrap_err());
    gone(store.count(&cohort.id, Revisions::until(1), &EVERYTHING).await.unwrap_err());
    assert_eq!(store.find_shape(&cohort.id, "a").await.unwrap(), None);
    // The name is free again.
    store.create_cohort(&self::cohort("hands"), None).await.unwrap();
}

#[tokio::test]
async fn damaged_control_points_are_noticed() {
    let (_folder, store, cohort) = with_cohort().await;
    let stored = shape(1);
    let revision = store_all(&store, &cohort, vec![stored.clone()]).await;
    meddle(&store, "UPDATE chunk_data SET checksum = points").await;
    let corrupt = |error: StoreError| {
        assert!(matches!(error, StoreError::Corrupt { chunk: 1 }), "{error:?}");
    };
    for ids in [Ids::Skip, Ids::Include] {
        let scan = store.scan(&cohort.id, Revisions::until(revision), &EVERYTHING, None, ids);
        corrupt(scan.await.unwrap_err());
    }
    corrupt(store.find_shape(&cohort.id, &stored.id).await.unwrap_err());
    let listing = Listing::first(&EVERYTHING, 5);
    corrupt(store.list_shapes(&cohort.id, &listing).await.unwrap_err());
    meddle(&store, "DELETE FROM chunk_data").await;
    corrupt(store.find_shape(&cohort.id, &stored.id).await.unwrap_err());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn uploads_run_side_by_side() {
    let (_folder, store, cohort) = with_cohort().await;
    let tasks: Vec<_> = (0..4)
        .map(|task| {
            let (store, cohort) = (store.clone(), cohort.clone());
            tokio::spawn(async move {
                let mut upload = store.begin_upload(&cohort);
                for call in 0..5 {
                    let shapes = (0..100).map(|i| named(i, &format!("{task}-{call}-{i}")));
                    upload.add(shapes.collect()).await.unwrap();
                }
                upload.commit(task).await.unwrap()
            })
        })
        .collect();
    let mut revisions = Vec::new();
    for task in tasks {
        revisions.push(task.await.unwrap());
    }
    revisions.sort_unstable();
    assert_eq!(revisions, [1, 2, 3, 4]);
    for revision in 0..=4 {
        let count = store.count(&cohort.id, Revisions::until(revision), &EVERYTHING).await;
        assert_eq!(count.unwrap(), revision * 500);
    }
    let (points, _) = scan_all(&store, &cohort, 4, &EVERYTHING, Ids::Skip).await;
    assert_eq!(points.len(), 2000 * WIDTH);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn one_of_many_gets_an_external_id() {
    let (_folder, store, cohort) = with_cohort().await;
    let tasks: Vec<_> = (0..4)
        .map(|task| {
            let mut upload = store.begin_upload(&cohort);
            tokio::spawn(async move {
                let added = upload.add(vec![named(task, "same")]).await;
                (upload, added)
            })
        })
        .collect();
    let (mut won, mut uploads) = (0, Vec::new());
    for task in tasks {
        let (upload, added) = task.await.unwrap();
        match added {
            Ok(_) => won += 1,
            Err(StoreError::ExternalIdPending { position: 0, .. }) => {}
            Err(other) => panic!("{other:?}"),
        }
        uploads.push(upload);
    }
    assert_eq!(won, 1);
}
