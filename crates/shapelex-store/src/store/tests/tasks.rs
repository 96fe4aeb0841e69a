//! Parts of jobs: their starts, their claims, and when these end.

use super::*;
use crate::domain::job::{Job, JobKind};
use crate::store::{PartClaim, PartEnd, Release};

/// Arithmetic of this process.
const HERE: &str = "here";

async fn running(store: &Store) -> Claim {
    let job = Job::new(JobKind::LearnDictionary, json!({}), 1);
    store.create_job(&job, None).await.unwrap();
    store.claim_job(10, 1000, f64::INFINITY, &json!({})).await.unwrap().claim.expect("a job waits")
}

async fn begun(store: &Store, claim: &Claim, parts: usize) -> i64 {
    let starts: Vec<Start> = (0..parts).map(|part| Start { chunk: 5 + part as i64, skip: part }).collect();
    let of = (claim.job.id.as_str(), claim.job.attempt);
    store.begin_pass(of, HERE, "what is to be done", &starts).await.unwrap().expect("the claim holds")
}

async fn taken(store: &Store, now: i64) -> Option<PartClaim> {
    store.claim_any_part(now, now + 100, HERE).await.unwrap().map(|(part, _)| part)
}

#[tokio::test]
async fn parts_are_the_shapes_one_after_the_other() {
    let (_folder, store, cohort) = with_cohort().await;
    for (from, to) in [(0, 5), (5, 6), (6, 19), (19, 22)] {
        let shapes = (from..to).map(|k| {
            let mut shape = named(k, &k.to_string());
            shape.attributes.label = Some(if k % 3 == 0 { "odd" } else { "even" }.into());
            shape
        });
        store_all(&store, &cohort, shapes.collect()).await;
    }
    for key in ["0", "5", "7", "8", "18"] {
        let shape = store.find_shapes(&cohort.id, &[key.into()]).await.unwrap().swap_remove(0);
        store.delete_shape(&cohort.id, &shape.expect("it was stored").id, 30).await.unwrap();
    }
    let until = store.find_cohort(&cohort.id).await.unwrap().expect("it is there").revision;
    let even = ShapeFilter { label: Some("even".into()), ..ShapeFilter::default() };
    for filter in [&ShapeFilter::default(), &even] {
        for (after, until) in [(0, until), (0, 3), (1, until), (2, until - 1)] {
            let revisions = Revisions { after, until };
            for size in [1, 3, 4, 100] {
                assert_parts(&store, &cohort, revisions, filter, size).await;
            }
        }
    }
}

/// Reads every part from its start.
async fn assert_parts(
    store: &Store,
    cohort: &Cohort,
    revisions: Revisions,
    filter: &ShapeFilter,
    size: usize,
) {
    let read = async |mut after: Option<Cursor>| {
        let mut points = Vec::new();
        while let Some(batch) = store.scan(&cohort.id, revisions, filter, after, Ids::Skip).await.unwrap() {
            points.extend(batch.control_points);
            after = Some(batch.position);
        }
        points
    };
    let all = read(None).await;
    let starts = store.part_starts(&cohort.id, revisions, filter, size).await.unwrap();
    assert_eq!(starts.len(), (all.len() / WIDTH).div_ceil(size), "{revisions:?} {filter:?} {size}");
    for (part, start) in starts.iter().enumerate() {
        let rest = read(Some(start.before())).await;
        let found = &rest[start.skip * WIDTH..];
        assert_eq!(found, &all[part * size * WIDTH..], "part {part} of {revisions:?} {filter:?} {size}");
    }
}

#[tokio::test]
async fn a_part_belongs_to_one_claim_at_a_time() {
    let (_folder, store) = fresh().await;
    let job = running(&store).await;
    let pass = begun(&store, &job, 3).await;
    assert!(store.claim_any_part(20, 120, "elsewhere").await.unwrap().is_none(), "other arithmetic");
    let (first, of) = store.claim_any_part(20, 120, HERE).await.unwrap().expect("a part is free");
    assert_eq!(
        (of.job, of.tenant, of.description.as_str()),
        (job.job.id, "default".into(), "what is to be done")
    );
    let second = store.claim_own_part(pass, 3, 20).await.unwrap().expect("a part is free");
    let third = taken(&store, 20).await.expect("a part is free");
    assert_eq!([first.part, second.part, third.part], [0, 1, 2]);
    assert_eq!(third.start, Start { chunk: 7, skip: 2 });
    assert!(taken(&store, 120).await.is_none(), "all have their owners");

    // The lease of the first part ends, not that of the owner of the pass.
    assert!(store.renew_part(&third, 500).await.unwrap());
    let again = taken(&store, 121).await.expect("its lease has ended");
    assert_eq!(again.part, 0);
    assert!(!store.renew_part(&first, 500).await.unwrap());
    assert!(!store.settle_part(&first, PartEnd::Done(Some(b"late"))).await.unwrap());
    assert_eq!(store.read_part(pass, 0).await.unwrap(), None);
    assert!(store.settle_part(&again, PartEnd::Done(Some(b"result"))).await.unwrap());
    assert_eq!(store.read_part(pass, 0).await.unwrap().as_deref(), Some(&b"result"[..]));

    // Refused parts are left to the owner of the pass.
    assert!(store.settle_part(&third, PartEnd::Refused).await.unwrap());
    assert!(taken(&store, 1000).await.is_none());
    assert!(store.claim_own_part(pass, 2, 20).await.unwrap().is_none(), "only before the end");
    let refused = store.claim_own_part(pass, 3, 20).await.unwrap().expect("the refused one");
    assert_eq!(refused.part, 2);
    assert!(store.settle_part(&refused, PartEnd::Open).await.unwrap());
    assert_eq!(taken(&store, 20).await.map(|claim| claim.part), Some(2));
    assert!(store.settle_part(&second, PartEnd::Done(None)).await.unwrap());
    assert_eq!(store.read_part(pass, 1).await.unwrap(), None, "the owner has used it");
}

#[tokio::test]
async fn parts_of_the_dead_are_free_at_once() {
    let (_folder, store) = fresh().await;
    let job = running(&store).await;
    begun(&store, &job, 1).await;
    let dead = taken(&store, 20).await.expect("a part is free");
    const OWNER: &str = "SELECT lease_owner FROM task WHERE lease_owner IS NOT NULL";
    let owner: String = sql(store.reader(), OWNER).scalar().await.unwrap();
    store.release_part_of("somebody else").await.unwrap();
    assert!(taken(&store, 21).await.is_none());
    store.release_part_of(&owner).await.unwrap();
    assert!(taken(&store, 21).await.is_some());
    assert!(!store.settle_part(&dead, PartEnd::Done(Some(b"late"))).await.unwrap());
}

#[tokio::test]
async fn a_pass_lasts_as_long_as_the_claim_on_its_job() {
    let (_folder, store) = fresh().await;
    let first = running(&store).await;
    let of = (first.job.id.as_str(), first.job.attempt);
    let old = begun(&store, &first, 2).await;
    let part = taken(&store, 20).await.expect("a part is free");
    assert!(store.release_job(&first, Release::RetryAt(0)).await.unwrap());
    assert!(taken(&store, 20).await.is_none(), "the job waits");
    assert!(!store.renew_part(&part, 900).await.unwrap());

    let second =
        store.claim_job(30, 1000, f64::INFINITY, &json!({})).await.unwrap().claim.expect("the job waits");
    assert!(taken(&store, 30).await.is_none(), "the pass is that of the first claim");
    assert!(store.claim_own_part(old, 2, 30).await.unwrap().is_none());
    let start = [Start { chunk: 1, skip: 0 }];
    let pass = begun(&store, &second, 1).await;
    assert!(store.begin_pass(of, HERE, "", &start).await.unwrap().is_none(), "the claim is lost");
    assert!(!store.settle_part(&part, PartEnd::Done(Some(b"late"))).await.unwrap());
    let part = taken(&store, 30).await.expect("the pass of the second claim is as it was");
    assert_ne!(pass, old);

    store.cancel_job(&second.job.id, 40).await.unwrap();
    assert!(!store.renew_part(&part, 900).await.unwrap());
    const LEFT: &str = "SELECT (SELECT count(*) FROM pass) + (SELECT count(*) FROM task)";
    assert_eq!(sql(store.reader(), LEFT).scalar::<i64>().await.unwrap(), 0);
}
