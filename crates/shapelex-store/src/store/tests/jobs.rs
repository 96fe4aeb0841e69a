//! Queue: order, leases, fencing, restarts, retention.

use super::*;
use crate::domain::job::{Job, JobFilter, JobKind, JobOutput, JobStatus, OutputParts, Priority, Progress};
use crate::store::jobs::{MAX_ATTEMPTS, MAX_FINISHED, MAX_QUEUED, Quota};

/// Lease of the claims in these tests.
const LEASE: i64 = 100;

async fn submitted(store: &Store, now: i64) -> Job {
    let job = Job::new(JobKind::LearnDictionary, json!({"cohort": "hands", "atoms": now}), now);
    store.create_job(&job, None).await.unwrap();
    job
}

async fn looked(store: &Store, now: i64) -> Claimed {
    store.claim_job(now, now + LEASE, f64::INFINITY, &json!({"code": "internal"})).await.unwrap()
}

async fn claimed(store: &Store, now: i64) -> Claim {
    looked(store, now).await.claim.expect("a job waits")
}

async fn found(store: &Store, id: &str) -> Job {
    store.find_job(id).await.unwrap().expect("the job is there")
}

/// Inserts jobs directly into the table: a thousand transactions would take seconds.
async fn insert_many(store: &Store, count: u32, status: &'static str, finished_at_ms: Option<i64>) {
    const INSERT: &str = "WITH RECURSIVE n (i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < $1)
        INSERT INTO job (id, kind, parameters, status, progress, attempt, run_at_ms, created_at_ms, finished_at_ms,
        tenant) SELECT 'job_' || $2 || '_' || (1000000 + i), 'learn_dictionary', '{}', $2, 0, 1, 5, 5, $3 + i,
        'default' FROM n";
    let query = sql(store.writer(), INSERT).bind(i64::from(count)).bind(status).bind(finished_at_ms);
    query.execute().await.unwrap();
}

#[tokio::test]
async fn jobs_come_back_as_they_were() {
    let (_folder, store) = fresh().await;
    let job = submitted(&store, 7).await;
    assert_eq!(found(&store, &job.id).await, job);
    assert_eq!(store.find_job("job_none").await.unwrap(), None);
    let claim = claimed(&store, 9).await;
    let running = Job { status: JobStatus::Running, attempt: 1, started_at_ms: Some(9), ..job.clone() };
    assert_eq!(claim.job, running);
    let progress = Progress { fraction: 0.25, phase: Some("codes"), objective: Some(1.5) };
    assert!(store.renew_job(&claim, &progress, 500).await.unwrap());
    let running = running.with_progress(&progress);
    assert_eq!(found(&store, &job.id).await, running);
    assert!(store.succeed_job(&claim, &json!({"dictionary": "dic_1"}), None, None, 11).await.unwrap());
    let result = Some(json!({"dictionary": "dic_1"}));
    let done =
        Job { status: JobStatus::Succeeded, progress: 1.0, finished_at_ms: Some(11), result, ..running };
    assert_eq!(found(&store, &job.id).await, done);
}

#[tokio::test]
async fn the_job_that_waits_longest_is_claimed_first() {
    let (_folder, store) = fresh().await;
    let (late, early, same) =
        (submitted(&store, 30).await, submitted(&store, 10).await, submitted(&store, 10).await);
    assert!(looked(&store, 9).await.claim.is_none(), "before its time");
    let first = claimed(&store, 40).await;
    assert_eq!(first.job.id, early.id);
    // Requeued for another attempt, behind the others.
    assert!(store.release_job(&first, Release::RetryAt(35)).await.unwrap());
    let mut order = Vec::new();
    while let Some(claim) = looked(&store, 41).await.claim {
        order.push((claim.job.id, claim.job.attempt));
    }
    assert_eq!(order, [(same.id, 1), (late.id, 1), (early.id, 2)]);
}

#[tokio::test]
async fn a_lease_that_ends_gives_the_job_to_the_next() {
    let (_folder, store) = fresh().await;
    let job = submitted(&store, 1).await;
    let first = claimed(&store, 10).await;
    assert!(looked(&store, 10 + LEASE).await.claim.is_none(), "the lease holds");
    assert!(store.renew_job(&first, &Progress::default(), 1000).await.unwrap());
    assert!(looked(&store, 1000).await.claim.is_none(), "the renewed lease holds");
    let second = claimed(&store, 1001).await;
    assert_eq!((&second.job.id, second.job.attempt), (&job.id, 2));
}

/// Tries every write of a claimant; returns whether any of them applied.
async fn write_everything(store: &Store, claim: &Claim) -> bool {
    let problem = json!({"code": "internal"});
    store.renew_job(claim, &Progress { fraction: 0.9, ..Progress::default() }, 5000).await.unwrap()
        || store.succeed_job(claim, &json!(1), None, None, 50).await.unwrap()
        || store.fail_job(claim, &problem, 50).await.unwrap()
        || store.release_job(claim, Release::Uncounted).await.unwrap()
        || store.release_job(claim, Release::RetryAt(60)).await.unwrap()
}

#[tokio::test]
async fn a_stale_claim_writes_nothing() {
    let (_folder, store) = fresh().await;
    let job = submitted(&store, 1).await;
    let overtaken = claimed(&store, 10).await;
    let present = claimed(&store, 11 + LEASE).await;
    let before = found(&store, &job.id).await;
    assert!(!write_everything(&store, &overtaken).await, "overtaken");
    assert_eq!(found(&store, &job.id).await, before);

    // After an uncounted release, the next claim has the same attempt number but is a different claim.
    assert!(store.release_job(&present, Release::Uncounted).await.unwrap());
    assert!(!write_everything(&store, &present).await, "released");
    let again = claimed(&store, 12 + LEASE).await;
    assert_eq!(again.job.attempt, present.job.attempt);
    assert!(!write_everything(&store, &present).await, "released and claimed by another one");
    assert!(store.succeed_job(&again, &json!(2), None, None, 400).await.unwrap());
    let done = found(&store, &job.id).await;
    assert!(!write_everything(&store, &again).await, "finished");
    assert_eq!(found(&store, &job.id).await, done);
}

#[tokio::test]
async fn a_restart_puts_running_jobs_back_at_once() {
    let (folder, store) = embedded().await;
    let (running, waiting) = (submitted(&store, 1).await, submitted(&store, 2).await);
    let stale = claimed(&store, 10).await;
    let progress = Progress { fraction: 0.5, phase: Some("codes"), objective: Some(1.0) };
    assert!(store.renew_job(&stale, &progress, i64::MAX).await.unwrap());
    store.close().await;
    let store = Store::open(folder.path()).await.unwrap();
    // Unchanged except for the attempt.
    assert_eq!(found(&store, &running.id).await, Job { attempt: 1, ..running.clone() });
    assert!(!write_everything(&store, &stale).await);
    let claim = claimed(&store, 11).await;
    assert_eq!((&claim.job.id, claim.job.attempt), (&running.id, 2), "at its old place");
    assert_eq!(claimed(&store, 11).await.job.id, waiting.id);
}

#[tokio::test]
async fn a_job_that_is_interrupted_every_time_is_given_up() {
    let (_folder, store) = fresh().await;
    let (poison, other) = (submitted(&store, 1).await, submitted(&store, 2).await);
    for attempt in 1..=MAX_ATTEMPTS {
        let claim = claimed(&store, 10).await;
        assert_eq!((&claim.job.id, claim.job.attempt), (&poison.id, attempt));
        store.requeue_interrupted_jobs().await.unwrap();
    }
    let next = looked(&store, 20).await;
    assert_eq!(next.abandoned, std::slice::from_ref(&poison.id));
    assert_eq!(next.claim.map(|claim| claim.job.id), Some(other.id));
    let given_up = found(&store, &poison.id).await;
    assert_eq!((given_up.status, given_up.attempt), (JobStatus::Failed, MAX_ATTEMPTS));
    assert_eq!((given_up.finished_at_ms, given_up.problem), (Some(20), Some(json!({"code": "internal"}))));
}

#[tokio::test]
async fn ended_leases_count_towards_the_attempts_and_stops_do_not() {
    let (_folder, store) = fresh().await;
    let job = submitted(&store, 1).await;
    for _ in 0..3 * MAX_ATTEMPTS {
        let claim = claimed(&store, 10).await;
        assert!(store.release_job(&claim, Release::Uncounted).await.unwrap());
    }
    assert_eq!(found(&store, &job.id).await, job);
    let mut now = 10;
    for _ in 0..MAX_ATTEMPTS {
        claimed(&store, now).await;
        now += LEASE + 1;
    }
    let next = looked(&store, now).await;
    assert_eq!((next.claim.is_none(), next.abandoned), (true, vec![job.id]));
}

#[tokio::test]
async fn jobs_of_every_status_are_cancelled_or_left_as_they_are() {
    let (_folder, store) = fresh().await;
    assert_eq!(store.cancel_job("job_none", 1).await.unwrap(), None);

    let queued = submitted(&store, 1).await;
    let cancelled = Job { status: JobStatus::Cancelled, finished_at_ms: Some(9), ..queued.clone() };
    for now in [9, 10] {
        // Cancelling again changes nothing.
        assert_eq!(store.cancel_job(&queued.id, now).await.unwrap().as_ref(), Some(&cancelled));
    }
    assert!(looked(&store, 10).await.claim.is_none(), "a cancelled job is not claimed");

    submitted(&store, 2).await;
    let claim = claimed(&store, 20).await;
    let stopped = store.cancel_job(&claim.job.id, 21).await.unwrap().unwrap();
    assert_eq!((stopped.status, stopped.started_at_ms), (JobStatus::Cancelled, Some(20)));
    assert!(!write_everything(&store, &claim).await);
    assert_eq!(found(&store, &claim.job.id).await, stopped);

    for succeeds in [true, false] {
        submitted(&store, 3).await;
        let claim = claimed(&store, 30).await;
        let applied = match succeeds {
            true => store.succeed_job(&claim, &json!({}), None, None, 31).await,
            false => store.fail_job(&claim, &json!({}), 31).await,
        };
        assert!(applied.unwrap());
        let finished = found(&store, &claim.job.id).await;
        assert_eq!(store.cancel_job(&claim.job.id, 40).await.unwrap(), Some(finished));
    }
}

#[tokio::test]
async fn the_queue_is_bounded() {
    let (_folder, store) = fresh().await;
    insert_many(&store, MAX_QUEUED - 1, "queued", None).await;
    submitted(&store, 10).await;
    let more = Job::new(JobKind::LearnDictionary, Value::Null, 11);
    let error = store.create_job(&more, None).await.unwrap_err();
    assert!(matches!(error, StoreError::TooManyJobs { limit: MAX_QUEUED }), "{error:?}");
    assert_eq!(store.find_job(&more.id).await.unwrap(), None);
    claimed(&store, 10).await;
    store.create_job(&more, None).await.unwrap();
}

#[tokio::test]
async fn the_newest_finished_jobs_are_kept_and_all_others() {
    let (_folder, store) = fresh().await;
    insert_many(&store, MAX_FINISHED, "failed", Some(1000)).await;
    let (oldest, second) = ("job_failed_1000001", "job_failed_1000002");
    let (first, running, queued) =
        (submitted(&store, 1).await, submitted(&store, 2).await, submitted(&store, 3).await);
    let claim = claimed(&store, 10).await;
    claimed(&store, 10).await;
    assert!(store.succeed_job(&claim, &json!({}), None, None, 1_000_000).await.unwrap());
    assert_eq!(store.find_job(oldest).await.unwrap(), None);
    for id in [second, &first.id, &running.id, &queued.id] {
        assert!(store.find_job(id).await.unwrap().is_some(), "{id}");
    }
    assert_eq!(rows(&store, "job").await, i64::from(MAX_FINISHED) + 2);
    store.cancel_job(&queued.id, 1_000_001).await.unwrap();
    assert_eq!(store.find_job(second).await.unwrap(), None);
}

#[tokio::test]
async fn jobs_are_listed_newest_first_by_status_kind_cohort_and_time() {
    let (_folder, store) = fresh().await;
    let mut ids = Vec::new();
    for now in 1..=5 {
        ids.push(submitted(&store, now).await.id);
    }
    let running = claimed(&store, 10).await.job.id;
    assert_eq!(running, ids[0]);
    ids.reverse();
    let list = async |filter: JobFilter, before: Option<&str>, limit| -> Vec<String> {
        let jobs = store.list_jobs(&filter, before, limit).await.unwrap();
        jobs.into_iter().map(|job| job.id).collect()
    };
    let all = JobFilter::default();
    let with = |status| JobFilter { status: Some(status), ..JobFilter::default() };
    assert_eq!(list(all.clone(), None, 10).await, ids);
    assert_eq!(list(all.clone(), Some(&ids[1]), 2).await, ids[2..4]);
    assert_eq!(list(with(JobStatus::Queued), None, 10).await, ids[..4]);
    assert_eq!(list(with(JobStatus::Queued), Some(&ids[2]), 10).await, ids[3..4]);
    assert_eq!(list(with(JobStatus::Running), None, 10).await, ids[4..]);
    assert_eq!(list(with(JobStatus::Failed), None, 10).await, [""; 0]);
    assert_eq!(list(JobFilter { since_ms: Some(4), ..all.clone() }, None, 10).await, ids[..2]);
    let kind = |kind| JobFilter { kind: Some(kind), ..JobFilter::default() };
    assert_eq!(list(kind(JobKind::LearnDictionary), None, 10).await, ids);
    assert_eq!(list(kind(JobKind::Distances), None, 10).await, [""; 0]);
    let of_cohort = Job::new(JobKind::Distances, json!({"cohort": "coh_1"}), 9);
    store.create_job(&of_cohort, None).await.unwrap();
    let cohort = |cohort: &str| JobFilter { cohort: Some(cohort.into()), ..JobFilter::default() };
    assert_eq!(list(cohort("coh_1"), None, 10).await, [of_cohort.id]);
    assert_eq!(list(cohort("coh_2"), None, 10).await, [""; 0]);
}

/// A job that succeeded with an output of `bytes` bytes.
async fn with_output(store: &Store, bytes: usize) -> (String, JobOutput) {
    submitted(store, 1).await;
    let claim = claimed(store, 10).await;
    let data = (0..bytes).map(|k| k as u8).collect();
    let output = JobOutput { head: json!({"ids": ["a", "b"], "bytes": bytes}), data };
    assert!(store.succeed_job(&claim, &json!({}), None, Some(&output), 20).await.unwrap());
    (claim.job.id, output)
}

#[tokio::test]
async fn outputs_come_back_as_they_were_and_end_with_their_job() {
    let (_folder, store) = fresh().await;
    let (id, output) = with_output(&store, 1000).await;
    let bytes = output.head.to_string().len() + output.data.len();
    assert_eq!(store.size_of_output(&id).await.unwrap(), Some(bytes as u64));
    assert_eq!(store.read_job_output(&id).await.unwrap(), Some(output));
    assert_eq!(store.size_of_output("job_none").await.unwrap(), None);
    assert_eq!(store.read_job_output("job_none").await.unwrap(), None);
    meddle(&store, "UPDATE job_output SET data = checksum").await;
    let error = store.read_job_output(&id).await.unwrap_err();
    assert!(matches!(error, StoreError::Damaged { .. }), "{error:?}");
    // The claim is lost, so nothing is written.
    submitted(&store, 1).await;
    let claim = claimed(&store, 30).await;
    store.cancel_job(&claim.job.id, 31).await.unwrap();
    let output = JobOutput { head: json!({}), data: vec![1] };
    assert!(!store.succeed_job(&claim, &json!({}), None, Some(&output), 32).await.unwrap());
    assert_eq!(rows(&store, "job_output").await, 1);
    meddle(&store, "DELETE FROM job").await;
    assert_eq!(rows(&store, "job_output").await, 0);
}

#[tokio::test]
async fn the_newest_outputs_are_kept_as_far_as_there_is_room() {
    let (_folder, store) = fresh().await;
    let mut ids = Vec::new();
    for bytes in [400, 300, 200] {
        ids.push(with_output(&store, bytes).await.0);
    }
    let job = submitted(&store, 1).await;
    let insert = async |most: u64, bytes: usize| {
        let mut write = store.begin_write("output").await.unwrap();
        sql(&mut write, "DELETE FROM job_output WHERE job = $1").bind(&job.id).execute().await.unwrap();
        let output = JobOutput { head: json!(null), data: vec![7; bytes] };
        crate::store::outputs::insert(&mut write, &job.id, &output, most).await.unwrap();
        write.commit().await.unwrap();
    };
    let kept = async || {
        let mut kept = Vec::new();
        for id in ids.iter().chain([&job.id]) {
            kept.push(store.read_job_output(id).await.unwrap().is_some());
        }
        kept
    };
    insert(1000, 100).await;
    assert_eq!(kept().await, [true, true, true, true]);
    insert(999, 100).await;
    assert_eq!(kept().await, [false, true, true, true]);
    insert(300, 200).await;
    assert_eq!(kept().await, [false, false, false, true]);
    // The last output is kept whatever its size.
    insert(300, 5000).await;
    assert_eq!(kept().await, [false, false, false, true]);
}

/// Claims and settles jobs one after the other; returns their tenants.
async fn served(store: &Store, count: usize) -> String {
    let mut order = String::new();
    for k in 0..count as i64 {
        let now = 1000 + 10 * k;
        let claim = store.claim_job(now, now + 5, f64::INFINITY, &json!({})).await.unwrap().claim.unwrap();
        order.push_str(&claim.tenant);
        assert!(store.fail_job(&claim, &json!({}), now + 1).await.unwrap());
    }
    order
}

#[tokio::test]
async fn tenants_take_turns() {
    let (_folder, store) = fresh().await;
    let of = |tenant: &str| store.of(std::sync::Arc::new(crate::domain::access::Principal::system(tenant)));
    for k in 0..6 {
        of("a").create_job(&Job::new(JobKind::Compare, json!({}), k), None).await.unwrap();
    }
    for k in 10..13 {
        of("b").create_job(&Job::new(JobKind::Compare, json!({}), k), None).await.unwrap();
    }
    assert_eq!(served(&store, 9).await, "abababaaa");
    // While a job of one tenant runs, the next one comes from the other.
    for k in 0..3 {
        of("a").create_job(&Job::new(JobKind::Compare, json!({}), k), None).await.unwrap();
        of("b").create_job(&Job::new(JobKind::Compare, json!({}), 100 + k), None).await.unwrap();
    }
    let mut running = String::new();
    for _ in 0..4 {
        running +=
            &store.claim_job(2000, 9000, f64::INFINITY, &json!({})).await.unwrap().claim.unwrap().tenant;
    }
    assert_eq!(running, "baba", "a was served last");
}

#[tokio::test]
async fn urgent_jobs_of_a_tenant_come_first() {
    let (_folder, store) = fresh().await;
    let mut wanted = Vec::new();
    for (k, priority) in
        [Priority::Low, Priority::Normal, Priority::High, Priority::High].into_iter().enumerate()
    {
        let job = Job::new(JobKind::Compare, json!({}), k as i64).weighing(1.0, priority);
        store.create_job(&job, None).await.unwrap();
        wanted.push(job.id);
    }
    for k in [2, 3, 1, 0] {
        let claim = store.claim_job(50, 90, f64::INFINITY, &json!({})).await.unwrap().claim.unwrap();
        assert_eq!(claim.job.id, wanted[k]);
    }
}

#[tokio::test]
async fn a_tenant_has_its_part_of_the_queue() {
    let (_folder, store) = fresh().await;
    let of = |tenant: &str| store.of(std::sync::Arc::new(crate::domain::access::Principal::system(tenant)));
    let quota = Quota { jobs: 3, seconds: 100.0 };
    let job = |seconds: f64| Job::new(JobKind::Compare, json!({}), 1).weighing(seconds, Priority::Normal);
    of("a").create_job_within(quota, &job(60.0), None).await.unwrap();
    let error = of("a").create_job_within(quota, &job(50.5), None).await.unwrap_err();
    assert!(matches!(error, StoreError::TooMuchWork { waiting: 60.0, limit: 100.0 }), "{error:?}");
    of("b").create_job_within(quota, &job(50.5), None).await.unwrap();
    of("a").create_job_within(quota, &job(1.0), None).await.unwrap();
    of("a").create_job_within(quota, &job(1.0), None).await.unwrap();
    let error = of("a").create_job_within(quota, &job(1.0), None).await.unwrap_err();
    assert!(matches!(error, StoreError::TooManyJobs { limit: 3 }), "{error:?}");
}

#[tokio::test]
async fn parts_of_an_output_are_those_of_the_attempt_that_holds_the_job() {
    let (_folder, store) = fresh().await;
    submitted(&store, 1).await;
    let lost = claimed(&store, 10).await;
    assert!(store.add_output_part(&lost.job, 0, b"lost").await.unwrap());
    // The lease ends, and another worker takes the job.
    let claim = claimed(&store, 11 + LEASE).await;
    assert_eq!(claim.job.id, lost.job.id);
    assert!(!store.add_output_part(&lost.job, 1, b"late").await.unwrap());
    // The same attempt, begun again at another time.
    let earlier = Job { started_at_ms: Some(1), ..claim.job.clone() };
    assert!(!store.add_output_part(&earlier, 0, b"erased").await.unwrap());
    store.clear_output_parts(&claim.job.id).await.unwrap();
    assert_eq!(rows(&store, "job_output_part").await, 0);
    for (part, text) in [&b"one\n"[..], b"two\n"].into_iter().enumerate() {
        assert!(store.add_output_part(&claim.job, part as u64, text).await.unwrap());
    }
    let parts = OutputParts { attempt: claim.job.attempt, count: 2, bytes: 8 };
    let output = JobOutput::in_parts(parts);
    assert!(store.succeed_job(&claim, &json!({}), None, Some(&output), 300).await.unwrap());
    let id = claim.job.id.as_str();
    assert_eq!(store.read_job_output(id).await.unwrap().unwrap().parts(), Some(parts));
    let read = async |part| store.read_output_part(id, parts.attempt, part).await;
    assert_eq!(read(0).await.unwrap().as_deref(), Some(&b"one\n"[..]));
    assert_eq!(read(1).await.unwrap().as_deref(), Some(&b"two\n"[..]));
    assert_eq!(read(2).await.unwrap(), None);
    let findings = async || {
        let mut found = Vec::new();
        store.check(&mut |line: &str| found.push(line.to_owned())).await.unwrap();
        found
    };
    assert_eq!(findings().await, [""; 0]);
    meddle(&store, "UPDATE job_output_part SET data = checksum WHERE part = 1").await;
    assert!(matches!(read(1).await, Err(StoreError::Damaged { .. })));
    assert_eq!(findings().await, [format!("the output of job {id} does not match its checksum")]);
    meddle(&store, "DELETE FROM job_output_part WHERE part = 1").await;
    assert_eq!(findings().await.len(), 1);
    // They end with their job.
    meddle(&store, "DELETE FROM job").await;
    assert_eq!(rows(&store, "job_output_part").await, 0);
}

#[tokio::test]
async fn jobs_without_an_outcome_leave_no_parts_of_an_output() {
    let (_folder, store) = fresh().await;
    let ends = async |end: &str| {
        submitted(&store, 1).await;
        let claim = claimed(&store, 10).await;
        assert!(store.add_output_part(&claim.job, 0, b"line\n").await.unwrap());
        match end {
            "cancelled" => drop(store.cancel_job(&claim.job.id, 20).await.unwrap()),
            _ => assert!(store.fail_job(&claim, &json!({}), 20).await.unwrap()),
        }
        assert!(!store.add_output_part(&claim.job, 1, b"line\n").await.unwrap());
        assert_eq!(rows(&store, "job_output_part").await, 0, "{end}");
    };
    ends("cancelled").await;
    ends("failed").await;
    // Those of an output that is no longer kept go with it.
    submitted(&store, 1).await;
    let claim = claimed(&store, 10).await;
    assert!(store.add_output_part(&claim.job, 0, b"line\n").await.unwrap());
    let output = JobOutput::in_parts(OutputParts { attempt: 1, count: 1, bytes: 5 });
    assert!(store.succeed_job(&claim, &json!({}), None, Some(&output), 20).await.unwrap());
    assert_eq!(rows(&store, "job_output_part").await, 1);
    let (id, _) = with_output(&store, 10).await;
    let mut write = store.begin_write("output").await.unwrap();
    sql(&mut write, "DELETE FROM job_output WHERE job = $1").bind(&id).execute().await.unwrap();
    let other = JobOutput { head: json!(null), data: vec![7; 10] };
    crate::store::outputs::insert(&mut write, &id, &other, 12).await.unwrap();
    write.commit().await.unwrap();
    assert_eq!(rows(&store, "job_output_part").await, 0);
    assert_eq!(store.read_job_output(&claim.job.id).await.unwrap(), None);
}

#[tokio::test]
async fn files_of_a_job_go_when_it_ends() {
    let (_folder, store) = fresh().await;
    let image: Vec<u8> = (0..(5 << 20) + 7).map(|k: u32| (k % 251) as u8).collect();
    let files: [(&str, &[u8]); 3] = [("parameters", b"{}"), ("image", &image), ("mask", b"")];
    let quota = Quota::default();
    let create = async |now_ms: i64| {
        let job = Job::new(JobKind::Segment, json!({}), now_ms);
        store.create_job_with(quota, &job, None, &files).await.map(|()| job)
    };
    for end in ["succeeded", "failed", "cancelled", "pruned"] {
        create(1).await.unwrap();
        let claim = claimed(&store, 10).await;
        let read = store.read_job_files(&claim.job).await.unwrap();
        let read: Vec<(&str, &[u8])> = read.iter().map(|(name, file)| (name.as_str(), &file[..])).collect();
        assert_eq!(read, [("image", &image[..]), ("mask", b""), ("parameters", b"{}")]);
        let other = store.of(std::sync::Arc::new(crate::domain::access::Principal::system("other")));
        assert!(other.read_job_files(&claim.job).await.unwrap().is_empty());
        match end {
            "succeeded" => assert!(store.succeed_job(&claim, &json!({}), None, None, 20).await.unwrap()),
            "failed" => assert!(store.fail_job(&claim, &json!({}), 20).await.unwrap()),
            "cancelled" => drop(store.cancel_job(&claim.job.id, 20).await.unwrap()),
            _ => meddle(&store, "DELETE FROM job").await,
        }
        assert_eq!(rows(&store, "job_file").await, 0, "{end}");
    }
    // A job that is released keeps them.
    create(1).await.unwrap();
    let claim = claimed(&store, 10).await;
    assert!(store.release_job(&claim, Release::Uncounted).await.unwrap());
    let claim = claimed(&store, 20).await;
    assert_eq!(store.read_job_files(&claim.job).await.unwrap().len(), 3);
    let findings = async || {
        let mut found = Vec::new();
        store.check(&mut |line: &str| found.push(line.to_owned())).await.unwrap();
        found
    };
    assert_eq!(findings().await, [""; 0]);
    meddle(&store, "UPDATE job_file SET data = checksum WHERE name = 'image' AND piece = 3").await;
    assert!(matches!(store.read_job_files(&claim.job).await, Err(StoreError::Damaged { .. })));
    let id = claim.job.id.as_str();
    assert_eq!(findings().await, [format!("a file of job {id} does not match its checksum")]);
    meddle(&store, "DELETE FROM job_file WHERE name = 'image' AND piece = 3").await;
    assert!(matches!(store.read_job_files(&claim.job).await, Err(StoreError::Damaged { .. })));
    meddle(&store, "UPDATE job SET finished_at_ms = 30, status = 'failed'").await;
    assert_eq!(findings().await, [format!("there are files of job {id}, which has ended or does not exist")]);
}

#[tokio::test]
async fn files_of_waiting_jobs_are_bounded_together() {
    let (_folder, store) = fresh().await;
    let mut write = store.begin_write("files").await.unwrap();
    for (id, bytes) in [("job_1", 8), ("job_2", 4)] {
        let create = "INSERT INTO job (id, kind, parameters, status, progress, attempt, run_at_ms, created_at_ms, tenant)
            VALUES ($1, 'segment', '{}', 'queued', 0, 0, 1, 1, 'default')";
        sql(&mut write, create).bind(id).execute().await.unwrap();
        let file = vec![7; bytes];
        // One alone may be larger than all together.
        let tenant = crate::domain::access::DEFAULT_TENANT;
        let found = crate::store::files::insert(&mut write, tenant, id, &[("image", &file)], 6).await;
        match id {
            "job_1" => found.unwrap(),
            _ => {
                assert!(matches!(found, Err(StoreError::TooManyBytes { waiting: 8, limit: 6 })), "{found:?}")
            }
        }
    }
}
