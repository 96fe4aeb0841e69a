//! Opening a folder, and what the disk can do to it.

use super::*;

#[tokio::test]
async fn a_folder_belongs_to_one_store() {
    let (folder, store) = embedded().await;
    let error = Store::open(folder.path()).await.unwrap_err();
    assert!(matches!(&error, StoreError::Locked { path } if path == folder.path()));
    store.close().await;
    Store::open(folder.path()).await.unwrap();
}

#[tokio::test]
async fn a_file_that_is_no_database_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join(DATABASE_FILE), "x".repeat(9000)).unwrap();
    let error = Store::open(folder.path()).await.unwrap_err();
    assert!(matches!(error, StoreError::Damaged { .. }), "{error:?}");
}

#[tokio::test]
async fn a_damaged_page_is_noticed_at_start() {
    let (folder, store, cohort) = embedded_with_cohort().await;
    let shapes = (0..400).map(|i| named(i, &format!("e{i}"))).collect();
    store_all(&store, &cohort, shapes).await;
    store.close().await;
    let file = folder.path().join(DATABASE_FILE);
    let mut bytes = std::fs::read(&file).unwrap();
    // The last page belongs to an index or a table that has just been written.
    let page = bytes.len() - 4096;
    bytes[page..page + 64].fill(0xa5);
    std::fs::write(&file, bytes).unwrap();
    let error = Store::open(folder.path()).await.unwrap_err();
    assert!(matches!(error, StoreError::Damaged { .. }), "{error:?}");
}

#[tokio::test]
async fn damage_of_a_large_file_is_found_beside_the_service() {
    let (folder, store, cohort) = embedded_with_cohort().await;
    for batch in 0..10 {
        let shapes = (0..400).map(|i| named(i, &format!("e{batch}-{i}"))).collect();
        store_all(&store, &cohort, shapes).await;
    }
    store.close().await;
    let file = folder.path().join(DATABASE_FILE);
    let mut bytes = std::fs::read(&file).unwrap();
    let page = bytes.len() - 4096;
    bytes[page..page + 64].fill(0xa5);
    std::fs::write(&file, bytes).unwrap();
    let pools = sqlite::open(&file, false).await.unwrap();
    let store = Store::new(pools, None, None);
    store.ready().await.unwrap();
    store.check_beside();
    for _ in 0..100 {
        if let Err(error) = store.ready().await {
            return assert!(matches!(error, StoreError::Damaged { .. }), "{error:?}");
        }
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    }
    panic!("the damage was not noticed");
}

#[tokio::test]
async fn readiness_means_writing_works() {
    let (_folder, store) = embedded().await;
    store.ready().await.unwrap();
    store.ready().await.unwrap();
    let query_only = |on: bool| {
        if on { "PRAGMA query_only = 1" } else { "PRAGMA query_only = 0" }
    };
    meddle(&store, query_only(true)).await;
    let error = store.ready().await.unwrap_err();
    assert_eq!(error.to_string(), "the store can only be read now");
    meddle(&store, query_only(false)).await;
    store.ready().await.unwrap();
}

#[tokio::test]
async fn the_store_recovers_from_a_full_disk() {
    let (_folder, store, cohort) = embedded_with_cohort().await;
    let limit = "PRAGMA max_page_count = 60";
    meddle(&store, limit).await;
    let shapes = |from: usize| (from..from + 4000).map(shape).collect::<Vec<_>>();
    let mut upload = store.begin_upload(&cohort);
    let error = upload.add(shapes(0)).await.unwrap_err();
    assert!(matches!(error, StoreError::Full), "{error:?}");
    drop(upload);

    let limit = "PRAGMA max_page_count = 1000000";
    meddle(&store, limit).await;
    assert_eq!(store_all(&store, &cohort, shapes(0)).await, 1);
    assert_eq!(store.count(&cohort.id, Revisions::until(1), &EVERYTHING).await.unwrap(), 4000);
}
