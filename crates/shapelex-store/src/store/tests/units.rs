//! The unit of a cohort, which its first shapes may bring.

use super::*;

fn in_unit(former: Option<&str>, unit: &str, adopt: bool) -> Option<UnitOfShapes> {
    Some(UnitOfShapes { former: former.map(str::to_owned), unit: unit.into(), adopt })
}

/// Stores a shape in a unit.
async fn add(
    store: &Store,
    cohort: &Cohort,
    number: usize,
    unit: Option<UnitOfShapes>,
) -> Result<u64, StoreError> {
    let mut upload = store.begin_upload(cohort);
    upload.add(vec![named(number, &format!("s{number}"))]).await.unwrap();
    upload.keep_unit(unit);
    upload.commit(20).await
}

async fn found(store: &Store, cohort: &Cohort) -> Cohort {
    store.find_cohort(&cohort.id).await.unwrap().unwrap()
}

#[tokio::test]
async fn an_empty_cohort_takes_the_unit_of_its_shapes_with_them() {
    let (_folder, store) = fresh().await;
    // A text of an earlier release that names no unit counts as none.
    for former in [None, Some("furlong")] {
        let mut cohort = cohort(former.unwrap_or("hands"));
        cohort.spec.length_unit = former.map(str::to_owned);
        store.create_cohort(&cohort, None).await.unwrap();
        let mut aborted = store.begin_upload(&cohort);
        aborted.add(vec![shape(7)]).await.unwrap();
        aborted.keep_unit(in_unit(former, "cm", true));
        aborted.abort().await.unwrap();
        assert_eq!(found(&store, &cohort).await, cohort);
        assert_eq!(add(&store, &cohort, 0, in_unit(former, "mm", true)).await.unwrap(), 1);
        let taken = found(&store, &cohort).await;
        assert_eq!((taken.spec.length_unit.as_deref(), taken.revision), (Some("mm"), 1));
        // Of two that began at once, the second is told unless it brings the same unit.
        assert_eq!(add(&store, &cohort, 1, in_unit(former, "mm", true)).await.unwrap(), 2);
        let late = add(&store, &cohort, 2, in_unit(former, "um", true)).await;
        assert!(matches!(late, Err(StoreError::Changed)), "{late:?}");
        assert_eq!(found(&store, &cohort).await.shapes, 2);
    }
}

#[tokio::test]
async fn shapes_are_in_the_unit_that_the_cohort_has_when_they_become_visible() {
    let (_folder, store, mut cohort) = with_cohort().await;
    assert_eq!(add(&store, &cohort, 0, in_unit(Some("mm"), "mm", false)).await.unwrap(), 1);
    cohort = found(&store, &cohort).await;
    cohort.spec.length_unit = Some("cm".into());
    store.update_cohort(&cohort, 21).await.unwrap();
    let late = add(&store, &cohort, 1, in_unit(Some("mm"), "mm", false)).await;
    assert!(matches!(late, Err(StoreError::Changed)), "{late:?}");
    cohort = found(&store, &cohort).await;
    cohort.spec.length_unit = None;
    store.update_cohort(&cohort, 22).await.unwrap();
    // It has shapes: their unit is not known.
    assert_eq!(add(&store, &cohort, 2, in_unit(None, "mm", false)).await.unwrap(), 4);
    assert_eq!(found(&store, &cohort).await.spec.length_unit, None);
    let late = add(&store, &cohort, 3, in_unit(None, "mm", true)).await;
    assert!(matches!(late, Err(StoreError::Changed)), "{late:?}");
}
