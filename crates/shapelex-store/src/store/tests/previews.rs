//! Uploads that write nothing.

use super::*;

async fn found(store: &Store, cohort: &Cohort) -> Cohort {
    store.find_cohort(&cohort.id).await.unwrap().unwrap()
}

fn outcomes(added: &[Added]) -> Vec<&'static str> {
    let word = |one: &Added| match one {
        Added::New { .. } => "new",
        Added::Existing { differs: false, .. } => "equal",
        Added::Existing { differs: true, .. } => "differs",
        Added::Conflict => "conflict",
    };
    added.iter().map(word).collect()
}

/// Batches of shapes, some of which are equal to stored ones, to others of their batch, or to those of the batch before.
fn batches() -> [Vec<NewShape>; 3] {
    let heavier = |number, name: &str| {
        let mut shape = named(number, name);
        shape.attributes.weight = 2.0;
        shape
    };
    [
        vec![named(1, "a"), heavier(1, "a"), named(2, "a"), named(3, "b"), shape(9)],
        vec![named(3, "b"), heavier(3, "b"), named(4, "b"), named(5, "c"), named(5, "c"), shape(9)],
        vec![named(6, "c"), named(7, "d"), heavier(7, "d")],
    ]
}

#[tokio::test]
async fn a_preview_finds_what_an_upload_finds_and_stores_nothing() {
    let (_folder, store, cohort) = with_cohort().await;
    assert_eq!(store_all(&store, &cohort, vec![named(1, "a")]).await, 1);
    let mut preview = store.preview_upload(&cohort);
    let mut before = Vec::new();
    for batch in batches() {
        before.push(outcomes(&preview.add(batch).await.unwrap()));
    }
    assert!(preview.kept_bytes() > 3, "{}", preview.kept_bytes());
    preview.preview().await.unwrap();
    assert_eq!(found(&store, &cohort).await.revision, 1);
    assert_eq!(list_all(&store, &cohort, &ShapeFilter::default()).await.len(), 1);
    let mut upload = store.begin_upload(&cohort);
    assert_eq!(upload.kept_bytes(), 0);
    upload.skip_conflicts();
    let mut after = Vec::new();
    for batch in batches() {
        after.push(outcomes(&upload.add(batch).await.unwrap()));
    }
    assert_eq!(before, after);
    assert_eq!(after[1], ["equal", "differs", "conflict", "new", "equal", "new"]);
    assert_eq!(upload.commit(20).await.unwrap(), 2);
}

#[tokio::test]
async fn a_preview_is_refused_as_an_upload_is() {
    let (_folder, store, cohort) = with_cohort().await;
    let mut open = store.begin_upload(&cohort);
    open.add(vec![named(1, "a")]).await.unwrap();
    // An upload that has not ended may still leave the name free.
    let pending = store.preview_upload(&cohort).add(vec![named(1, "a")]).await;
    assert!(matches!(pending, Err(StoreError::ExternalIdPending { .. })), "{pending:?}");
    open.abort().await.unwrap();
    // The cohort gets another unit between the conversion and the end.
    let mut preview = store.preview_upload(&cohort);
    preview.add(vec![named(1, "a")]).await.unwrap();
    preview.keep_unit(Some(UnitOfShapes { former: Some("cm".into()), unit: "cm".into(), adopt: false }));
    assert!(matches!(preview.preview().await, Err(StoreError::Changed)));
    // A cohort without a unit takes none from a preview.
    let mut empty = super::cohort("feet");
    empty.spec.length_unit = None;
    store.create_cohort(&empty, None).await.unwrap();
    let mut preview = store.preview_upload(&empty);
    preview.add(vec![named(1, "a")]).await.unwrap();
    preview.keep_unit(Some(UnitOfShapes { former: None, unit: "cm".into(), adopt: true }));
    preview.preview().await.unwrap();
    assert_eq!(found(&store, &empty).await, empty);
}

#[tokio::test]
async fn a_secret_is_found_once_it_is_made() {
    let (_folder, store) = fresh().await;
    assert_eq!(store.find_subject_secret().await.unwrap(), None);
    assert_eq!(store.subject_secret(&[7; 4]).await.unwrap(), [7; 4]);
    assert_eq!(store.find_subject_secret().await.unwrap(), Some(vec![7; 4]));
}
