//! Opening of a folder, and faults of its disk.

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
    // The last page belongs to an index or a recently written table.
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
    let store = Store::new(pools, None, None, None);
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
    assert_eq!(error.to_string(), "the store is read-only at the moment");
    meddle(&store, query_only(false)).await;
    store.ready().await.unwrap();
}

#[tokio::test]
async fn readiness_fails_while_only_pages_in_use_can_be_written() {
    let (_folder, store) = embedded().await;
    for _ in 0..2 {
        // As many as there are. A connection that found no room is replaced by one without the limit.
        meddle(&store, "PRAGMA max_page_count = 1").await;
        let error = store.probe().await.unwrap_err();
        assert!(matches!(error, StoreError::Full), "{error:?}");
    }
    meddle(&store, "PRAGMA max_page_count = 1000000").await;
    store.ready().await.unwrap();
    assert_eq!(store.clock_notes().await.unwrap().candidate_ms, None, "nothing of the probe is left");
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

#[cfg(unix)]
fn mode(path: &Path) -> u32 {
    use std::os::unix::fs::PermissionsExt as _;
    std::fs::metadata(path).unwrap().permissions().mode() & 0o777
}

#[cfg(unix)]
#[tokio::test]
async fn the_folder_and_its_files_are_for_their_owner_alone() {
    use std::os::unix::fs::PermissionsExt as _;
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("data");
    let store = Store::open(&folder).await.unwrap();
    store.create_cohort(&cohort("hands"), None).await.unwrap();
    assert_eq!(mode(&folder), 0o700);
    let files = ["shapelex.db", "shapelex.db-wal", "shapelex.db-shm", "shapelex.lock", "shapelex.mark"];
    for name in files {
        assert_eq!(mode(&folder.join(name)), 0o600, "{name}");
    }
    store.close().await;
    // A file created by an older program.
    std::fs::set_permissions(folder.join(DATABASE_FILE), std::fs::Permissions::from_mode(0o644)).unwrap();
    let store = Store::open(&folder).await.unwrap();
    assert_eq!(mode(&folder.join(DATABASE_FILE)), 0o600);
    store.create_cohort(&cohort("feet"), None).await.unwrap();
    assert_eq!(mode(&folder.join("shapelex.db-wal")), 0o600);
}

#[cfg(unix)]
#[tokio::test]
async fn without_the_file_of_the_lock_the_folder_still_belongs_to_one_store() {
    let (folder, store) = embedded().await;
    std::fs::remove_file(folder.path().join("shapelex.lock")).unwrap();
    let error = Store::open(folder.path()).await.unwrap_err();
    assert!(matches!(error, StoreError::Locked { .. }), "{error:?}");
    store.close().await;
    Store::open(folder.path()).await.unwrap();
}

/// A store as `kill -9` leaves it: acknowledged changes are in its log.
async fn killed() -> TempDir {
    let (folder, store) = embedded().await;
    for k in 0..5 {
        store.create_cohort(&cohort(&format!("c{k}")), None).await.unwrap();
        let entry = crate::domain::audit::Entry { tenant: "a".into(), ..Default::default() };
        store.append_audit(&[entry]).await.unwrap();
    }
    let copy = tempfile::tempdir().unwrap();
    for name in ["shapelex.db", "shapelex.db-wal", "shapelex.mark"] {
        std::fs::copy(folder.path().join(name), copy.path().join(name)).unwrap();
    }
    copy
}

async fn missing(folder: &Path) -> Option<u64> {
    match Store::open(folder).await {
        Ok(store) => {
            store.close().await;
            None
        }
        Err(StoreError::Older { missing }) => Some(missing),
        Err(error) => panic!("{error:?}"),
    }
}

#[tokio::test]
async fn a_killed_store_is_as_new_as_its_mark() {
    let folder = killed().await;
    assert_eq!(missing(folder.path()).await, None);
}

#[tokio::test]
async fn a_store_without_its_log_is_refused_until_the_loss_is_accepted() {
    let folder = killed().await;
    std::fs::remove_file(folder.path().join("shapelex.db-wal")).unwrap();
    assert_eq!(missing(folder.path()).await, Some(5));
    assert!(matches!(Store::attach(folder.path()).await, Err(StoreError::Older { missing: 5 })));
    let site = maintenance::Site::Folder(folder.path().to_path_buf());
    assert!(Store::inspect(&site).await.unwrap_err().to_string().contains("last 5 audit entries"));
    let store = Store::open_accepting_loss(folder.path()).await.unwrap();
    store.close().await;
    assert_eq!(missing(folder.path()).await, None);
}

#[tokio::test]
async fn a_damaged_or_cut_log_is_refused_and_left_as_it_is() {
    for cut in [false, true] {
        let folder = killed().await;
        let log = folder.path().join("shapelex.db-wal");
        let mut bytes = std::fs::read(&log).unwrap();
        let half = bytes.len() / 2;
        if cut {
            bytes.truncate(half);
        } else {
            bytes[half..half + 64].fill(0xa5);
        }
        std::fs::write(&log, &bytes).unwrap();
        let lost = missing(folder.path()).await.unwrap();
        assert!((1..=5).contains(&lost), "{lost}");
        assert_eq!(std::fs::read(&log).unwrap(), bytes, "cut: {cut}");
        assert_eq!(missing(folder.path()).await, Some(lost), "asked again, cut: {cut}");
    }
}

#[tokio::test]
async fn an_older_backup_that_was_put_into_the_folder_is_refused() {
    let (folder, store) = embedded().await;
    let parent = tempfile::tempdir().unwrap();
    let backup = parent.path().join("backup");
    store.back_up(&backup).await.unwrap();
    store.append_audit(&[crate::domain::audit::Entry::default()]).await.unwrap();
    store.close().await;
    std::fs::copy(&backup, folder.path().join(DATABASE_FILE)).unwrap();
    assert_eq!(missing(folder.path()).await, Some(1));
    Store::open_accepting_loss(folder.path()).await.unwrap();
}

#[tokio::test]
async fn after_a_clean_stop_everything_is_in_the_file() {
    let (folder, store, cohort) = embedded_with_cohort().await;
    store_all(&store, &cohort, (0..400).map(shape).collect()).await;
    store.close().await;
    let log = folder.path().join("shapelex.db-wal");
    assert!(std::fs::metadata(&log).map_or(0, |about| about.len()) == 0);
    let copy = tempfile::tempdir().unwrap();
    std::fs::copy(folder.path().join(DATABASE_FILE), copy.path().join(DATABASE_FILE)).unwrap();
    let store = Store::open(copy.path()).await.unwrap();
    assert_eq!(store.count(&cohort.id, Revisions::until(1), &EVERYTHING).await.unwrap(), 400);
}
