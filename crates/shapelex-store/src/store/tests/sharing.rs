//! One store shared by several tenants, callers and processes.

use super::*;
use crate::domain::change::ChangeKind;
use crate::domain::job::{Job, JobFilter, JobKind, JobStatus};
use crate::domain::retry::{Receipt, RetryKey};

fn for_tenant(store: &Store, tenant: &str) -> Store {
    store.of(Arc::new(Principal::system(tenant)))
}

/// The same tenant through a key restricted to some cohorts.
fn scoped(store: &Store, cohorts: &[&str]) -> Store {
    let cohorts = Some(cohorts.iter().map(ToString::to_string).collect());
    store.of(Arc::new(Principal { cohorts, ..Principal::system(store.tenant()) }))
}

fn receipt(key: &str, fingerprint: u8) -> Receipt {
    Receipt { request: RetryKey { key: key.into(), fingerprint: [fingerprint; 32] }, outcome: json!("x") }
}

fn job_of(cohort: &Cohort) -> Job {
    Job::new(JobKind::LearnDictionary, json!({"cohort": cohort.id}), 1)
}

#[tokio::test]
async fn tenants_do_not_see_each_other() {
    let (_folder, ours, cohort) = with_cohort().await;
    let theirs = for_tenant(&ours, "north");
    store_all(&ours, &cohort, vec![named(1, "a")]).await;
    let job = job_of(&cohort);
    ours.create_job(&job, None).await.unwrap();
    for key in [&cohort.id, &cohort.spec.name] {
        assert_eq!(theirs.find_cohort(key).await.unwrap(), None);
    }
    assert_eq!(theirs.list_cohorts(None, 9).await.unwrap(), []);
    assert_eq!(theirs.find_job(&job.id).await.unwrap(), None);
    assert_eq!(theirs.list_jobs(&JobFilter::default(), None, 9).await.unwrap(), []);
    assert_eq!(theirs.cancel_job(&job.id, 2).await.unwrap(), None);
    assert_eq!(theirs.list_changes(0, 9).await.unwrap(), []);
    assert!(!theirs.trash_cohort(&cohort.id, None, 2).await.unwrap());
    assert!(!theirs.remove_cohort(&cohort.id).await.unwrap());
    let error = theirs.begin_upload(&cohort).add(vec![shape(1)]).await.unwrap_err();
    assert!(matches!(error, StoreError::CohortGone), "{error:?}");
    let error = theirs.list_shapes(&cohort.id, &Listing::first(&EVERYTHING, 9)).await.unwrap_err();
    assert!(matches!(error, StoreError::CohortGone), "{error:?}");

    // Each tenant has its own names, request keys and change numbers.
    theirs.create_cohort(&self::cohort("hands"), Some(&receipt("k", 1))).await.unwrap();
    ours.create_cohort(&self::cohort("feet"), Some(&receipt("k", 2))).await.unwrap();
    assert_eq!(theirs.list_changes(0, 9).await.unwrap()[0].sequence, 1);
    // A worker serves all tenants.
    let claimed = theirs.claim_job(5, 10, f64::INFINITY, &json!({})).await.unwrap().claim.unwrap();
    assert_eq!((claimed.job.id.as_str(), claimed.tenant.as_str()), (job.id.as_str(), "default"));
}

#[tokio::test]
async fn a_key_for_one_cohort_sees_nothing_of_another() {
    let (_folder, store, hands) = with_cohort().await;
    let feet = cohort("feet");
    store.create_cohort(&feet, None).await.unwrap();
    let jobs = [job_of(&hands), job_of(&feet)];
    for job in &jobs {
        store.create_job(job, None).await.unwrap();
    }
    let narrow = scoped(&store, &[&hands.id]);
    assert_eq!(narrow.list_cohorts(None, 9).await.unwrap(), std::slice::from_ref(&hands));
    assert_eq!(narrow.find_cohort("hands").await.unwrap().as_ref(), Some(&hands));
    assert_eq!(narrow.find_cohort("feet").await.unwrap(), None);
    let seen: Vec<String> =
        narrow.list_jobs(&JobFilter::default(), None, 9).await.unwrap().into_iter().map(|j| j.id).collect();
    assert_eq!(seen, [jobs[0].id.clone()]);
    assert_eq!(narrow.find_job(&jobs[1].id).await.unwrap(), None);
    assert_eq!(narrow.cancel_job(&jobs[1].id, 2).await.unwrap(), None);
    assert_eq!(store.find_job(&jobs[1].id).await.unwrap().unwrap().status, JobStatus::Queued);
    let changes = narrow.list_changes(0, 9).await.unwrap();
    assert!(changes.iter().all(|change| change.cohort.as_deref() == Some(&hands.id)), "{changes:?}");
    assert!(store.trash_cohort(&feet.id, None, 3).await.unwrap());
    assert_eq!(narrow.list_trash(None, 9).await.unwrap(), []);
    assert_eq!(narrow.restore(&feet.id, 4).await.unwrap(), None);
    assert!(!narrow.remove_trashed(&feet.id).await.unwrap());
    assert_eq!(scoped(&store, &[]).list_cohorts(None, 9).await.unwrap(), []);
}

#[tokio::test]
async fn a_request_is_done_once_or_not_at_all() {
    let (_folder, store) = fresh().await;
    let (first, second) = (cohort("hands"), cohort("feet"));
    let receipt = receipt("k", 7);
    store.create_cohort(&first, Some(&receipt)).await.unwrap();
    let error = store.create_cohort(&second, Some(&receipt)).await.unwrap_err();
    assert!(matches!(error, StoreError::AlreadyDone), "{error:?}");
    assert_eq!(store.find_cohort("feet").await.unwrap(), None, "nothing stays of the second");
    assert_eq!(store.find_receipt("k").await.unwrap(), Some(receipt.clone()));
    assert_eq!(store.list_changes(0, 9).await.unwrap().len(), 1);

    let mut upload = store.begin_upload(&first);
    upload.add(vec![shape(1)]).await.unwrap();
    let error = upload.commit_once(9, None, None, |_| Some(receipt)).await.unwrap_err();
    assert!(matches!(error, StoreError::AlreadyDone), "{error:?}");
    wait_until_empty(&store, "chunk").await;
    assert_eq!(store.find_cohort("hands").await.unwrap().unwrap().revision, 0);
    store.prune_receipts(12 + receipts::KEPT_MS).await.unwrap();
    assert_eq!(store.find_receipt("k").await.unwrap(), None);
}

#[tokio::test]
async fn changes_are_numbered_without_gaps_in_the_order_of_their_commits() {
    let (_folder, store) = fresh().await;
    let tasks: Vec<_> = (0..8)
        .map(|task| {
            let store = store.clone();
            tokio::spawn(async move {
                let cohort = cohort(&format!("c{task}"));
                store.create_cohort(&cohort, None).await.unwrap();
                for number in 0..3 {
                    store_all(&store, &cohort, vec![shape(number)]).await;
                }
            })
        })
        .collect();
    // A reader that continues from the last change seen sees every change once.
    let mut seen = Vec::new();
    let mut last = 0;
    while seen.len() < 32 {
        for change in store.list_changes(last, 5).await.unwrap() {
            assert_eq!(change.sequence, last + 1);
            last = change.sequence;
            seen.push(change);
        }
    }
    for task in tasks {
        task.await.unwrap();
    }
    let created = seen.iter().filter(|change| change.kind == ChangeKind::CohortCreated).count();
    assert_eq!((created, store.last_change().await.unwrap()), (8, 32));
}

#[tokio::test]
async fn what_a_process_that_is_gone_left_behind_is_removed_and_its_jobs_are_taken_over() {
    let Ok(url) = std::env::var(DATABASE_URL) else {
        return println!("SKIPPED: several processes need PostgreSQL");
    };
    let url = fresh_schema(&url).await;
    let (gone, other) = (Store::connect(&url, 2).await.unwrap(), Store::connect(&url, 2).await.unwrap());
    let cohort = cohort("hands");
    gone.create_cohort(&cohort, None).await.unwrap();
    let mut upload = gone.begin_upload(&cohort);
    upload.add(vec![named(1, "a")]).await.unwrap();
    let job = job_of(&cohort);
    gone.create_job(&job, None).await.unwrap();
    let stale = gone.claim_job(5, i64::MAX, f64::INFINITY, &json!({})).await.unwrap().claim.unwrap();
    other.tidy_behind_the_dead().await.unwrap();
    assert_eq!(rows(&other, "shape").await, 1, "the other process lives");
    // Simulates a crash: the connections end without clean-up.
    std::mem::forget(upload);
    gone.close().await;
    for _ in 0..100 {
        other.tidy_behind_the_dead().await.unwrap();
        if rows(&other, "chunk").await == 0 {
            break;
        }
        tokio::time::sleep(std::time::Duration::from_millis(100)).await;
    }
    assert_eq!(rows(&other, "shape").await, 0);
    store_all(&other, &cohort, vec![named(2, "a")]).await;
    let taken = other.claim_job(6, 100, f64::INFINITY, &json!({})).await.unwrap().claim.unwrap();
    assert_eq!((taken.job.id, taken.job.attempt), (stale.job.id, 2));
}
