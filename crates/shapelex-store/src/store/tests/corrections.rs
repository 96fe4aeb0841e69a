//! Corrections, deletions by filter and erasures: the content of every revision before and after.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use super::super::blob::BYTES_PER_NUMBER;
use super::*;
use crate::domain::change::ChangeKind;
use crate::domain::shape::MAX_NAMES;

async fn find(store: &Store, cohort: &Cohort, key: &str) -> (Cursor, Shape) {
    store.find_placed(&cohort.id, key).await.unwrap().unwrap()
}

async fn correct(
    store: &Store,
    cohort: &Cohort,
    key: &str,
    change: impl FnOnce(&mut ShapeAttributes),
) -> u64 {
    let (place, mut shape) = find(store, cohort, key).await;
    change(&mut shape.attributes);
    store.correct_shape(&cohort.id, None, place, (&shape, None), 90).await.unwrap().unwrap()
}

async fn erase(store: &Store, subject: &str) -> Vec<SubjectCohort> {
    let mut erased = Vec::new();
    for cohort in store.find_subject(subject).await.unwrap() {
        erased.extend(store.erase_subject(cohort, subject, 91).await.unwrap());
    }
    store.finish_erasures(Some(subject), 99).await.unwrap();
    store.begin_rewriting().await.unwrap();
    erased
}

async fn assert_sound(store: &Store) {
    let mut findings = Vec::new();
    store.check(&mut |line: &str| findings.push(line.to_owned())).await.unwrap();
    assert_eq!(findings, [""; 0]);
}

fn labelled(number: usize, label: &str, subject: &str) -> NewShape {
    let mut shape = named(number, &format!("e{number}"));
    shape.attributes.label = Some(label.into());
    shape.attributes.subject = Some(subject.into());
    shape.attributes.weight = 1.0 + (number % 3) as f64;
    shape
}

#[tokio::test]
async fn names_that_others_brought_meanwhile_count() {
    let (_folder, store, cohort) = with_cohort().await;
    let names = |range: std::ops::Range<usize>| range.map(|k| format!("n{k:05}"));
    let shape_with = |number: usize, range: std::ops::Range<usize>| {
        let mut shape = named(number, &format!("e{number}"));
        shape.attributes.labels = names(range).map(|name| (name, json!(1))).collect();
        shape
    };
    let upload = async |number: usize, range: std::ops::Range<usize>| {
        let mut upload = store.begin_upload(&cohort);
        let brought = names(range.clone()).collect();
        upload.add(vec![shape_with(number, range)]).await.unwrap();
        // The known names are of the empty cohort.
        upload.name_attributes(Some(NewNames { known: Arc::default(), until: 0, brought }));
        upload.commit(20).await
    };
    assert_eq!(upload(0, 0..MAX_NAMES).await.unwrap(), 1);
    let refused = upload(1, MAX_NAMES..MAX_NAMES + 1).await.unwrap_err();
    assert!(matches!(refused, StoreError::TooManyNames { found } if found == MAX_NAMES + 1), "{refused:?}");
    assert_eq!(upload(2, 7..9).await.unwrap(), 2);
    let (place, mut shape) = find(&store, &cohort, "e2").await;
    shape.attributes.labels = [("another".to_owned(), json!(1))].into();
    let names = NewNames { known: Arc::default(), until: 0, brought: ["another".to_owned()].into() };
    let refused = store.correct_shape(&cohort.id, None, place, (&shape, Some(&names)), 90).await.unwrap_err();
    assert!(matches!(refused, StoreError::TooManyNames { .. }), "{refused:?}");
    let found = store.further_names(&cohort.id, Revisions::latest(), 10).await.unwrap();
    assert_eq!((found.len(), find(&store, &cohort, "e2").await.0), (10, place));
}

#[tokio::test]
async fn a_corrected_shape_keeps_its_id_and_earlier_revisions_keep_it_as_it_was() {
    let (_folder, store, cohort) = with_cohort().await;
    store_all(&store, &cohort, (0..3).map(|k| labelled(k, "a", "s")).collect()).await;
    let (place, before) = find(&store, &cohort, "e1").await;
    let second = correct(&store, &cohort, "e1", |attributes| {
        attributes.label = Some("b".into());
        attributes.weight = 7.0;
        attributes.metadata = Some(json!({"why": "mislabelled"}).to_string());
    });
    let second = second.await;
    let (_, after) = find(&store, &cohort, &before.id).await;
    assert_eq!((second, &after.id, after.created_at_ms), (2, &before.id, before.created_at_ms));
    assert_eq!((&after.control_points, after.measures), (&before.control_points, before.measures));
    assert_eq!((after.attributes.label.as_deref(), after.attributes.weight), (Some("b"), 7.0));
    let found = store.find_cohort(&cohort.id).await.unwrap().unwrap();
    assert_eq!((found.revision, found.shapes, found.updated_at_ms), (2, 3, 90));
    let (a, b) = (label_filter("a"), label_filter("b"));
    for (revision, in_a, in_b) in [(1, 3, 0), (2, 2, 1)] {
        let count = async |filter| store.count(&cohort.id, Revisions::until(revision), filter).await.unwrap();
        assert_eq!((count(&EVERYTHING).await, count(&a).await, count(&b).await), (3, in_a, in_b));
    }
    let revisions = Revisions { after: 1, until: 2 };
    assert_eq!(store.count_deleted(&cohort.id, revisions, &EVERYTHING).await.unwrap(), 1);
    // The place is not that of the shape any more; nothing is stored.
    let late = store.correct_shape(&cohort.id, None, place, (&before, None), 92).await.unwrap();
    assert_eq!(late, None);
    let changed = store.correct_shape(&cohort.id, Some(1), place, (&before, None), 92).await;
    assert!(matches!(changed, Err(StoreError::Changed)));
    // Uploads compare control points: attributes that were corrected stay.
    let mut upload = store.begin_upload(&cohort);
    let stored = |differs| Added::Existing { id: before.id.clone(), differs };
    let posted = labelled(1, "a", "s");
    assert_eq!(posted.control_points, before.control_points);
    assert_eq!(upload.add(vec![posted]).await.unwrap(), [stored(true)]);
    let mut moved = labelled(1, "a", "s");
    moved.control_points[0] += 1.0;
    let error = upload.add(vec![moved]).await.unwrap_err();
    assert!(matches!(error, StoreError::ExternalIdConflict { .. }), "{error:?}");
    let again = NewShape {
        id: id::new_id(id::SHAPE),
        attributes: after.attributes.clone(),
        measures: after.measures,
        control_points: after.control_points.clone(),
    };
    assert_eq!(upload.add(vec![again]).await.unwrap(), [stored(false)]);
    let kinds: Vec<ChangeKind> =
        store.list_changes(0, 9).await.unwrap().iter().map(|change| change.kind).collect();
    assert_eq!(kinds, [ChangeKind::CohortCreated, ChangeKind::ShapesAdded, ChangeKind::ShapeUpdated]);
    assert_sound(&store).await;
}

fn label_filter(label: &str) -> ShapeFilter {
    ShapeFilter { label: Some(label.into()), ..ShapeFilter::default() }
}

#[tokio::test]
async fn shapes_are_deleted_together() {
    let (_folder, store, cohort) = with_cohort().await;
    let shapes = (0..7).map(|k| labelled(k, if k % 2 == 0 { "a" } else { "b" }, "s")).collect();
    store_all(&store, &cohort, shapes).await;
    let delete =
        async |filter: &ShapeFilter, expected| store.delete_shapes(&cohort.id, filter, expected, 50).await;
    assert!(matches!(delete(&label_filter("a"), Some(9)).await, Err(StoreError::Changed)));
    assert_eq!(delete(&label_filter("c"), None).await.unwrap(), Deleted { shapes: 0, revision: 1 });
    assert_eq!(delete(&label_filter("a"), Some(1)).await.unwrap(), Deleted { shapes: 4, revision: 2 });
    assert_eq!(delete(&EVERYTHING, None).await.unwrap(), Deleted { shapes: 3, revision: 3 });
    for (revision, count) in [(1, 7), (2, 3), (3, 0)] {
        let (points, _) = scan_all(&store, &cohort, revision, &EVERYTHING, Ids::Skip).await;
        assert_eq!(points.len(), count * WIDTH, "revision {revision}");
    }
    assert_eq!(store.find_cohort(&cohort.id).await.unwrap().unwrap().shapes, 0);
    let change = store.list_changes(2, 9).await.unwrap().remove(0);
    assert_eq!(
        (change.kind, change.object, change.shapes),
        (ChangeKind::ShapesDeleted, cohort.id.clone(), Some(4))
    );
    assert_sound(&store).await;
}

/// All bytes of the files of an embedded store.
fn file_bytes(folder: &Path) -> Vec<u8> {
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let files = files.filter(|path| path.to_string_lossy().contains("shapelex.db"));
    files.flat_map(|path| std::fs::read(path).unwrap()).collect()
}

fn holds(bytes: &[u8], wanted: &[u8]) -> bool {
    bytes.windows(wanted.len()).any(|window| window == wanted)
}

#[tokio::test]
async fn nothing_of_an_erased_subject_is_left_in_the_files() {
    let (folder, store, cohort) = embedded_with_cohort().await;
    let secret = |number: usize| {
        let mut shape = labelled(number, "label-of-anna", "subject-anna");
        shape.attributes.external_id = Some(format!("external-anna-{number}"));
        shape.attributes.labels = BTreeMap::from([("site".to_owned(), json!("site-of-anna"))]);
        shape.attributes.metadata = Some(json!({"note": "metadata-of-anna"}).to_string());
        shape.control_points[0] = 1_234.567_891;
        shape.control_points[1] = 9.876_543_21;
        shape
    };
    let mut shapes: Vec<NewShape> = (0..40).map(|k| labelled(k, "other", "subject-berta")).collect();
    shapes.splice(7..7, (100..103).map(secret));
    store_all(&store, &cohort, shapes).await;
    store_all(&store, &cohort, vec![secret(103)]).await;
    correct(&store, &cohort, "external-anna-100", |attributes| {
        attributes.label = Some("new-label-of-anna".into());
    })
    .await;
    let (_, deleted) = find(&store, &cohort, "external-anna-101").await;
    store.delete_shape(&cohort.id, &deleted.id, 60).await.unwrap();
    let number = 1_234.567_891_f64.to_le_bytes();
    let point: Vec<u8> = [number, 9.876_543_21_f64.to_le_bytes()].concat();
    let texts = ["anna", "1234.567891"];
    assert!(holds(&file_bytes(folder.path()), &point) && holds(&file_bytes(folder.path()), b"anna"));
    let erased = erase(&store, "subject-anna").await;
    assert_eq!((erased.len(), erased[0].shapes, erased[0].revision), (1, 4, 5));
    let left = file_bytes(folder.path());
    assert!(!holds(&left, &number), "a coordinate is left");
    for text in texts {
        assert!(!holds(&left, text.as_bytes()), "{text} is left");
    }
    assert!(holds(&left, b"subject-berta"));
    for revision in 0..=5 {
        let expected = if revision == 0 { 0 } else { 40 };
        let count = store.count(&cohort.id, Revisions::until(revision), &EVERYTHING).await.unwrap();
        assert_eq!(count, expected, "revision {revision}");
        let (points, _) = scan_all(&store, &cohort, revision, &EVERYTHING, Ids::Skip).await;
        assert_eq!(points.len(), expected as usize * WIDTH);
        assert!(!points.contains(&1_234.567_891));
    }
    assert_eq!(store.find_cohort(&cohort.id).await.unwrap().unwrap().shapes, 40);
    assert!(erase(&store, "subject-anna").await.is_empty());
    assert_eq!(BYTES_PER_NUMBER, number.len());
    assert_sound(&store).await;
}

#[tokio::test]
async fn shapes_that_are_erased_after_their_places_were_found_are_not_read() {
    let (_folder, store, cohort) = with_cohort().await;
    let shapes: Vec<NewShape> = (0..5).map(|k| labelled(k, "a", &format!("s{k}"))).collect();
    let expected: Vec<f64> =
        [0, 1, 3, 4].into_iter().flat_map(|k: usize| shapes[k].control_points.clone()).collect();
    store_all(&store, &cohort, shapes).await;
    let places = store.places(&cohort.id, Revisions::until(1), &EVERYTHING).await.unwrap();
    assert_eq!(erase(&store, "s2").await.len(), 1);
    let (batch, next) = store.scan_places(&cohort.id, 1, &places, 0).await.unwrap().unwrap();
    assert_eq!((batch.control_points, next), (expected, 5));
    assert_eq!(store.scan_places(&cohort.id, 1, &places, 5).await.unwrap(), None);
}

#[tokio::test]
async fn an_interrupted_erasure_is_finished_later() {
    let (_folder, store, cohort) = with_cohort().await;
    store_all(&store, &cohort, (0..3).map(|k| labelled(k, "a", &format!("s{k}"))).collect()).await;
    let found = store.find_subject("s1").await.unwrap().remove(0);
    store.erase_subject(found, "s1", 70).await.unwrap().unwrap();
    assert_sound(&store).await;
    assert_eq!(store.find_subject("s1").await.unwrap(), []);
    let count = async |key: &str| store.finish_erasures(Some(key), 99).await.unwrap();
    assert_eq!((count("s0").await, count("s1").await, count("s1").await), (0, 1, 0));
    let found = store.find_subject("s2").await.unwrap().remove(0);
    store.erase_subject(found, "s2", 71).await.unwrap().unwrap();
    assert_eq!(store.finish_erasures(None, 99).await.unwrap(), 1);
    let (_, left) = find(&store, &cohort, "e0").await;
    assert_eq!(left.control_points, shape(0).control_points);
    assert_eq!(left.attributes.weight, 1.0);
    assert_sound(&store).await;
}

#[tokio::test]
async fn a_subject_is_erased_where_it_was_the_last_one() {
    let (_folder, store, cohort) = with_cohort().await;
    store_all(&store, &cohort, (0..4).map(|k| labelled(k, "a", "first")).collect()).await;
    correct(&store, &cohort, "e0", |attributes| attributes.subject = Some("second".into())).await;
    correct(&store, &cohort, "e1", |attributes| attributes.subject = None).await;
    // The earlier row of e0 holds the same shape; e1 has no subject.
    assert_eq!(erase(&store, "second").await[0].shapes, 1);
    let ids = async |revision| scan_all(&store, &cohort, revision, &EVERYTHING, Ids::Include).await.1.len();
    assert_eq!((ids(1).await, ids(2).await, ids(4).await), (3, 3, 3));
    assert_eq!(erase(&store, "first").await[0].shapes, 3);
    assert_eq!((ids(1).await, ids(3).await, ids(5).await), (0, 1, 1));
    let (_, left) = find(&store, &cohort, "e1").await;
    assert_eq!(left.control_points, shape(1).control_points);
    assert_sound(&store).await;
}

#[tokio::test]
async fn trashed_cohorts_are_erased_too_and_other_tenants_are_not() {
    let (_folder, store, cohort) = with_cohort().await;
    store_all(&store, &cohort, vec![labelled(1, "a", "s"), labelled(2, "a", "t")]).await;
    store.trash_cohort(&cohort.id, None, 40).await.unwrap();
    let elsewhere = store.of(Arc::new(Principal::system("elsewhere")));
    let other = self::cohort("hands");
    elsewhere.create_cohort(&other, None).await.unwrap();
    store_all(&elsewhere, &other, vec![labelled(1, "a", "s")]).await;
    let erased = erase(&store, "s").await;
    assert_eq!((erased.len(), erased[0].trashed, erased[0].shapes), (1, true, 1));
    assert!(store.list_changes(0, 99).await.unwrap().iter().all(|c| c.kind != ChangeKind::SubjectErased));
    store.restore(&cohort.id, 41).await.unwrap();
    let found = store.find_cohort(&cohort.id).await.unwrap().unwrap();
    assert_eq!((found.shapes, found.revision), (1, 4));
    assert_eq!(list_all(&elsewhere, &other, &EVERYTHING).await.len(), 1);
    assert_sound(&store).await;
}

/// Pseudo-random numbers.
struct Random(u64);

impl Random {
    fn below(&mut self, most: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) % most as u64) as usize
    }
}

/// A row as the model knows it: number, shape, label, subject, first coordinate, weight.
#[derive(Debug, Clone, PartialEq)]
struct Known {
    row: usize,
    id: String,
    label: String,
    subject: String,
    first: f64,
    weight: f64,
}

/// Expected content of every revision of a cohort.
#[derive(Default)]
struct Model {
    states: Vec<Vec<Known>>,
    last_subject: HashMap<String, String>,
    rows: usize,
}

impl Model {
    fn now(&self) -> Vec<Known> {
        self.states.last().unwrap().clone()
    }

    fn row(&mut self, known: Known) -> Known {
        self.rows += 1;
        self.last_subject.insert(known.id.clone(), known.subject.clone());
        Known { row: self.rows, ..known }
    }

    fn erase(&mut self, subject: &str) {
        for state in &mut self.states {
            state.retain(|known| known.subject != subject && self.last_subject[&known.id] != subject);
        }
        self.states.push(self.now());
    }
}

/// Random values of label and subject.
fn any_names(random: &mut Random) -> (String, String) {
    (format!("l{}", random.below(3)), format!("s{}", random.below(4)))
}

async fn add_some(store: &Store, cohort: &Cohort, model: &mut Model, random: &mut Random, step: usize) {
    let shape = |k: usize, (label, subject): (String, String)| labelled(step * 10 + k, &label, &subject);
    let shapes: Vec<NewShape> = (0..1 + random.below(5)).map(|k| shape(k, any_names(random))).collect();
    let mut state = model.now();
    for shape in &shapes {
        state.push(model.row(Known {
            row: 0,
            id: shape.id.clone(),
            label: shape.attributes.label.clone().unwrap(),
            subject: shape.attributes.subject.clone().unwrap(),
            first: shape.control_points[0],
            weight: shape.attributes.weight,
        }));
    }
    model.states.push(state);
    store_all(store, cohort, shapes).await;
}

async fn correct_one(store: &Store, cohort: &Cohort, model: &mut Model, random: &mut Random) {
    let mut state = model.now();
    let known = state.remove(random.below(state.len()));
    let (label, subject) = any_names(random);
    let weight = known.weight + 1.0;
    correct(store, cohort, &known.id, |attributes| {
        (attributes.label, attributes.subject) = (Some(label.clone()), Some(subject.clone()));
        attributes.weight = weight;
    })
    .await;
    state.push(model.row(Known { label, subject, weight, ..known }));
    model.states.push(state);
}

async fn delete_some(store: &Store, cohort: &Cohort, model: &mut Model, random: &mut Random) {
    let (label, _) = any_names(random);
    let deleted = store.delete_shapes(&cohort.id, &label_filter(&label), None, 51).await.unwrap();
    let mut state = model.now();
    let before = state.len();
    state.retain(|other| other.label != label);
    assert_eq!(deleted.shapes, (before - state.len()) as u64);
    if deleted.shapes > 0 {
        model.states.push(state);
    }
}

/// One random change, of the store and of the model.
async fn change(store: &Store, cohort: &Cohort, model: &mut Model, random: &mut Random, step: usize) {
    let mut state = model.now();
    match random.below(10) {
        4..=6 if !state.is_empty() => correct_one(store, cohort, model, random).await,
        7 if !state.is_empty() => {
            let known = state.remove(random.below(state.len()));
            store.delete_shape(&cohort.id, &known.id, 50).await.unwrap().unwrap();
            model.states.push(state);
        }
        8 => delete_some(store, cohort, model, random).await,
        9 => {
            let (_, subject) = any_names(random);
            if step.is_multiple_of(3) && !erase(store, &subject).await.is_empty() {
                model.erase(&subject);
            }
        }
        _ => add_some(store, cohort, model, random, step).await,
    }
}

async fn compare(store: &Store, cohort: &Cohort, model: &Model) {
    for (revision, state) in model.states.iter().enumerate() {
        let until = Revisions::until(revision as u64);
        let (points, ids) = scan_all(store, cohort, revision as u64, &EVERYTHING, Ids::Include).await;
        let (fast, _) = scan_all(store, cohort, revision as u64, &EVERYTHING, Ids::Skip).await;
        assert_eq!(points, fast, "revision {revision}");
        let firsts: Vec<f64> = points.iter().step_by(WIDTH).copied().collect();
        assert_eq!(firsts, state.iter().map(|known| known.first).collect::<Vec<_>>(), "revision {revision}");
        assert_eq!(ids, state.iter().map(|known| known.id.clone()).collect::<Vec<_>>());
        let count = store.count(&cohort.id, until, &EVERYTHING).await.unwrap();
        assert_eq!(count, state.len() as u64, "revision {revision}");
        assert_eq!(store.places(&cohort.id, until, &EVERYTHING).await.unwrap().count(), state.len());
        let l1 = store.count(&cohort.id, until, &label_filter("l1")).await.unwrap();
        assert_eq!(l1, state.iter().filter(|known| known.label == "l1").count() as u64);
        let described = store.describe_shapes(&cohort.id, until, &EVERYTHING, 999).await.unwrap();
        let labels: Vec<String> = described.into_iter().map(|shape| shape.label.unwrap()).collect();
        assert_eq!(labels, state.iter().map(|known| known.label.clone()).collect::<Vec<_>>());
        let rows: BTreeSet<usize> = model.now().iter().map(|known| known.row).collect();
        let gone = state.iter().filter(|known| !rows.contains(&known.row)).count() as u64;
        let revisions = Revisions { after: revision as u64, until: model.states.len() as u64 - 1 };
        assert_eq!(store.count_deleted(&cohort.id, revisions, &EVERYTHING).await.unwrap(), gone);
    }
    let listed = list_all(store, cohort, &EVERYTHING).await;
    let listed: Vec<(String, f64)> =
        listed.into_iter().map(|shape| (shape.id, shape.attributes.weight)).collect();
    let known = model.now().into_iter().map(|known| (known.id, known.weight)).collect::<Vec<_>>();
    assert_eq!(listed, known);
    let found = store.find_cohort(&cohort.id).await.unwrap().unwrap();
    assert_eq!((found.revision, found.shapes), (model.states.len() as u64 - 1, known.len() as u64));
}

#[tokio::test]
async fn every_revision_agrees_with_a_model_after_random_changes() {
    for seed in 1..=4 {
        let (_folder, store, cohort) = with_cohort().await;
        let (mut model, mut random) = (Model::default(), Random(seed));
        model.states.push(Vec::new());
        for step in 0..50 {
            change(&store, &cohort, &mut model, &mut random, step).await;
        }
        compare(&store, &cohort, &model).await;
        assert_sound(&store).await;
        let (_folder, copy) = fresh().await;
        let mut export = Vec::new();
        store.export(&mut export).await.unwrap();
        copy.import(&mut export.as_slice(), false).await.unwrap();
        compare(&copy, &cohort, &model).await;
    }
}
