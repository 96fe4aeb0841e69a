//! Jobs as the worker runs them, with functions of the tests in place of the real one.

use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use shapelex_server::domain::job::{Job, JobFilter, JobKind, JobStatus};
use shapelex_server::service::app::progress::JobContext;
use shapelex_server::service::app::{App, Limits, ServiceError};
use shapelex_server::service::jobs;
use shapelex_server::service::jobs::Outcome;
use shapelex_server::store::Store;
use shapelex_server::worker::{Places, Worker};
use tempfile::TempDir;
use tokio::runtime::Handle;

/// Long enough for a slow machine, short enough for a test that hangs.
const PATIENCE: Duration = Duration::from_secs(120);

/// A service without doors on a new folder.
pub(crate) async fn app() -> (TempDir, App) {
    let folder = tempfile::tempdir().unwrap();
    let app = reopened(&folder).await;
    (folder, app)
}

async fn reopened(folder: &TempDir) -> App {
    App::new(Store::open(folder.path()).await.unwrap(), Limits::default(), 1)
}

/// A worker of `jobs` places, of one thread each.
pub(crate) fn worker(
    app: &App,
    jobs: usize,
    run: impl Fn(&App, &Handle, &Job, &JobContext) -> Result<Outcome, ServiceError> + Send + Sync + 'static,
) -> Worker {
    worker_with_short(app, jobs, 0.0, run)
}

/// The same with a place for jobs of at most `short_seconds`.
fn worker_with_short(
    app: &App,
    jobs: usize,
    short_seconds: f64,
    run: impl Fn(&App, &Handle, &Job, &JobContext) -> Result<Outcome, ServiceError> + Send + Sync + 'static,
) -> Worker {
    Worker::start(app, Places { jobs: NonZeroUsize::new(jobs).unwrap(), threads: jobs, short_seconds }, run)
}

pub(crate) async fn submit(app: &App, parameters: Value) -> Job {
    jobs::submit(app, JobKind::LearnDictionary, parameters, 1.0).await.unwrap()
}

async fn finished(app: &App, id: &str) -> Job {
    let job = jobs::wait(app, id, PATIENCE).await.unwrap();
    assert!(job.status.is_finished(), "{job:?}");
    job
}

/// Waits until `condition` holds.
pub(crate) async fn until(what: &str, mut condition: impl AsyncFnMut() -> bool) {
    let start = Instant::now();
    while !condition().await {
        assert!(start.elapsed() < PATIENCE, "{what} did not happen");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

/// Waits until the job is inside [`spin`].
async fn until_spinning(app: &App, id: &str) {
    let spins = async || jobs::find(app, id).await.unwrap().phase.as_deref() == Some("spinning");
    until("the start of the job", spins).await;
}

/// Computes until it is asked to stop.
fn spin(context: &JobContext) -> Result<Outcome, ServiceError> {
    context.report("spinning", 0.5, None);
    loop {
        context.check()?;
        std::hint::spin_loop();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_runs_and_its_result_is_kept() {
    let (folder, app) = app().await;
    let running = worker(&app, 1, |app, handle, job, context| {
        context.report("reading", 0.5, Some(2.0));
        // What has to be awaited is awaited from the compute thread.
        let found = handle.block_on(app.store.find_job(&job.id))?;
        assert_eq!(found.unwrap().status, JobStatus::Running);
        Ok(Outcome {
            result: json!({"sum": job.parameters["a"].as_i64().unwrap() + 1}),
            dictionary: None,
            output: None,
        })
    });
    let job = submit(&app, json!({"a": 41})).await;
    assert_eq!((job.status, job.attempt), (JobStatus::Queued, 0));
    let done = finished(&app, &job.id).await;
    assert_eq!((done.status, done.progress, done.attempt), (JobStatus::Succeeded, 1.0, 1));
    assert_eq!(done.result, Some(json!({"sum": 42})));
    assert_eq!(done.problem, None);
    assert!(done.created_at_ms <= done.started_at_ms.unwrap() && done.started_at_ms <= done.finished_at_ms);
    running.stop().await;
    app.store.close().await;
    drop(app);
    assert_eq!(jobs::find(&reopened(&folder).await, &job.id).await.unwrap(), done);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_short_job_does_not_wait_for_a_long_one() {
    let (_folder, app) = app().await;
    let _worker =
        worker_with_short(&app, 1, 10.0, |_, _, job, context| match job.parameters["kind"].as_str() {
            Some("long") => spin(context),
            _ => Ok(Outcome { result: json!(null), dictionary: None, output: None }),
        });
    let submit = async |kind: &str, seconds: f64| {
        jobs::submit(&app, JobKind::LearnDictionary, json!({"kind": kind}), seconds).await.unwrap()
    };
    let long = submit("long", 3600.0).await;
    until_spinning(&app, &long.id).await;
    let (waiting, short) = (submit("medium", 11.0).await, submit("short", 10.0).await);
    assert_eq!(finished(&app, &short.id).await.status, JobStatus::Succeeded);
    assert_eq!(
        jobs::find(&app, &waiting.id).await.unwrap().status,
        JobStatus::Queued,
        "too long for the slot of short jobs"
    );
    jobs::cancel(&app, &long.id).await.unwrap();
    assert_eq!(finished(&app, &waiting.id).await.status, JobStatus::Succeeded);
}

#[tokio::test(flavor = "multi_thread")]
async fn failures_are_kept_as_problems_and_the_worker_goes_on() {
    let (_folder, app) = app().await;
    let _worker = worker(&app, 1, |_, _, job, _| match job.parameters.as_str() {
        Some("invalid") => Err(ServiceError::invalid("/atoms", "expected at least 1, got 0")),
        Some("internal") => Err(ServiceError::Internal("the secret cause".into())),
        Some("panic") => panic!("the secret cause"),
        _ => Ok(Outcome { result: json!(null), dictionary: None, output: None }),
    });
    let detail = "internal error: see the log under the id of the job";
    for (parameters, code, detail, errors) in [
        (
            "invalid",
            "invalid-input",
            "/atoms: expected at least 1, got 0",
            json!([{"pointer": "/atoms", "detail": "expected at least 1, got 0"}]),
        ),
        ("internal", "internal", detail, json!([])),
        ("panic", "internal", detail, json!([])),
    ] {
        let job = submit(&app, json!(parameters)).await;
        let failed = finished(&app, &job.id).await;
        assert_eq!((failed.status, failed.attempt), (JobStatus::Failed, 1), "{parameters}");
        let stored = json!({"code": code, "detail": detail, "errors": errors});
        assert_eq!(failed.problem, Some(stored), "{parameters}");
        assert_eq!(failed.result, None);
    }
    let job = submit(&app, json!("good")).await;
    assert_eq!(finished(&app, &job.id).await.status, JobStatus::Succeeded);
}

#[tokio::test(flavor = "multi_thread")]
async fn errors_of_the_machinery_are_tried_again() {
    let (_folder, app) = app().await;
    let _worker = worker(&app, 1, |_, _, job, _| match job.attempt {
        1 | 2 => Err(ServiceError::Unavailable("the store is busy".into())),
        _ => Ok(Outcome { result: json!(job.attempt), dictionary: None, output: None }),
    });
    let start = Instant::now();
    let job = submit(&app, json!(null)).await;
    let done = finished(&app, &job.id).await;
    assert_eq!((done.status, done.attempt), (JobStatus::Succeeded, 3));
    assert_eq!(done.result, Some(json!(3)));
    assert!(start.elapsed() >= Duration::from_secs(1), "the third attempt waits: {:?}", start.elapsed());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cancelled_job_is_cancelled_at_once_and_its_thread_stops() {
    let (_folder, app) = app().await;
    let stopped = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stopped);
    let _worker = worker(&app, 1, move |_, _, _, context| {
        let outcome = spin(context);
        flag.store(context.is_cancelled(), Ordering::SeqCst);
        outcome
    });
    let mut times = Vec::new();
    // The fastest of some: other tests have the processor at the same time.
    while times.iter().all(|time| *time >= Duration::from_millis(200)) {
        assert!(times.len() < 5, "{times:?}");
        stopped.store(false, Ordering::SeqCst);
        let job = submit(&app, json!(null)).await;
        until_spinning(&app, &job.id).await;
        let start = Instant::now();
        let cancelled = jobs::cancel(&app, &job.id).await.unwrap();
        assert_eq!(cancelled.status, JobStatus::Cancelled);
        until("the end of the thread", async || stopped.load(Ordering::SeqCst)).await;
        times.push(start.elapsed());
        // The worker is free for the next one, and what the first one returned has changed nothing.
        let next = submit(&app, json!(null)).await;
        until_spinning(&app, &next.id).await;
        assert_eq!(jobs::find(&app, &job.id).await.unwrap(), cancelled);
        assert_eq!(jobs::cancel(&app, &job.id).await.unwrap(), cancelled, "again");
        jobs::cancel(&app, &next.id).await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_cancellation_is_heard_whenever_it_comes() {
    let (_folder, app) = app().await;
    let _worker = worker(&app, 1, |_, _, _, context| spin(context));
    for k in 0..40 {
        let job = submit(&app, json!(k)).await;
        // From before the claim until after the start: also between the two.
        tokio::time::sleep(Duration::from_micros(250 * k)).await;
        jobs::cancel(&app, &job.id).await.unwrap();
    }
    // The only place is free again at once, not when a lease ends.
    let start = Instant::now();
    let last = submit(&app, json!("last")).await;
    until_spinning(&app, &last.id).await;
    assert!(start.elapsed() < Duration::from_secs(8), "{:?}", start.elapsed());
    jobs::cancel(&app, &last.id).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_that_is_cancelled_while_it_waits_never_runs() {
    let (_folder, app) = app().await;
    let first = submit(&app, json!("first")).await;
    let second = submit(&app, json!("second")).await;
    jobs::cancel(&app, &first.id).await.unwrap();
    let ran = Arc::new(Mutex::new(Vec::new()));
    let list = Arc::clone(&ran);
    let _worker = worker(&app, 1, move |_, _, job, _| {
        list.lock().unwrap().push(job.parameters.clone());
        Ok(Outcome { result: json!(null), dictionary: None, output: None })
    });
    finished(&app, &second.id).await;
    assert_eq!(*ran.lock().unwrap(), [json!("second")]);
    let error = jobs::cancel(&app, &second.id).await.unwrap_err();
    assert!(matches!(&error, ServiceError::JobFinished { status: "succeeded", .. }), "{error:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_puts_running_jobs_back_and_the_next_start_runs_them() {
    let (folder, app) = app().await;
    let running = worker(&app, 2, |_, _, _, context| spin(context));
    let mut jobs_of_it = Vec::new();
    for k in 0..3 {
        jobs_of_it.push(submit(&app, json!(k)).await);
    }
    for job in &jobs_of_it[..2] {
        until_spinning(&app, &job.id).await;
    }
    let start = Instant::now();
    running.stop().await;
    assert!(start.elapsed() < Duration::from_secs(4), "{:?}", start.elapsed());
    for job in &jobs_of_it {
        // As if nobody had touched it: the attempt does not count.
        assert_eq!(&jobs::find(&app, &job.id).await.unwrap(), job);
    }
    app.store.close().await;
    drop(app);
    let app = reopened(&folder).await;
    let _worker = worker(&app, 1, |_, _, job, _| {
        Ok(Outcome { result: job.parameters.clone(), dictionary: None, output: None })
    });
    for (k, job) in jobs_of_it.iter().enumerate() {
        let done = finished(&app, &job.id).await;
        assert_eq!((done.attempt, done.result), (1, Some(json!(k))));
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_worker_that_is_dropped_leaves_no_thread_at_work() {
    let (_folder, app) = app().await;
    let stopped = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stopped);
    let running = worker(&app, 1, move |_, _, _, context| {
        let outcome = spin(context);
        flag.store(true, Ordering::SeqCst);
        outcome
    });
    let job = submit(&app, json!(null)).await;
    until_spinning(&app, &job.id).await;
    drop(running);
    until("the end of the thread", async || stopped.load(Ordering::SeqCst)).await;
    // As after the end of the process: only the lease or the next start brings it back.
    assert_eq!(jobs::find(&app, &job.id).await.unwrap().status, JobStatus::Running);
}

#[tokio::test(flavor = "multi_thread")]
async fn no_more_jobs_run_at_once_than_there_are_places() {
    let (_folder, app) = app().await;
    let (now, most, all) =
        (Arc::new(AtomicUsize::new(0)), Arc::new(AtomicUsize::new(0)), Arc::new(AtomicU32::new(0)));
    let (counter, highest, total) = (Arc::clone(&now), Arc::clone(&most), Arc::clone(&all));
    let mut submitted = Vec::new();
    for k in 0..12 {
        submitted.push(submit(&app, json!(k)).await);
    }
    let _worker = worker(&app, 3, move |_, _, _, _| {
        highest.fetch_max(counter.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
        std::thread::sleep(Duration::from_millis(60));
        counter.fetch_sub(1, Ordering::SeqCst);
        total.fetch_add(1, Ordering::SeqCst);
        Ok(Outcome { result: json!(null), dictionary: None, output: None })
    });
    for job in &submitted {
        assert_eq!(finished(&app, &job.id).await.status, JobStatus::Succeeded);
    }
    assert_eq!((now.load(Ordering::SeqCst), all.load(Ordering::SeqCst)), (0, 12));
    assert_eq!(most.load(Ordering::SeqCst), 3, "all places are used, and no more");
}

#[tokio::test(flavor = "multi_thread")]
async fn waiting_ends_with_the_job_with_the_time_and_with_the_service() {
    let (_folder, app) = app().await;
    let running = worker(&app, 1, |_, _, _, context| spin(context));
    let job = submit(&app, json!(null)).await;
    let start = Instant::now();
    let seen = jobs::wait(&app, &job.id, Duration::from_millis(100)).await.unwrap();
    assert!(!seen.status.is_finished() && start.elapsed() >= Duration::from_millis(100));

    let waiting = tokio::spawn({
        let (app, id) = (app.clone(), job.id.clone());
        async move { jobs::wait(&app, &id, PATIENCE).await }
    });
    tokio::time::sleep(Duration::from_millis(30)).await;
    jobs::cancel(&app, &job.id).await.unwrap();
    assert_eq!(waiting.await.unwrap().unwrap().status, JobStatus::Cancelled);

    let job = submit(&app, json!(null)).await;
    let waiting = tokio::spawn({
        let (app, id) = (app.clone(), job.id.clone());
        async move { jobs::wait(&app, &id, PATIENCE).await }
    });
    tokio::time::sleep(Duration::from_millis(30)).await;
    app.drain();
    assert!(!waiting.await.unwrap().unwrap().status.is_finished());
    running.stop().await;
    let error = jobs::wait(&app, "job_none", PATIENCE).await.unwrap_err();
    assert!(matches!(error, ServiceError::NotFound { kind: "job", .. }), "{error:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn progress_is_seen_at_once_and_stored_soon() {
    let (_folder, app) = app().await;
    let go = Arc::new(AtomicBool::new(false));
    let gate = Arc::clone(&go);
    let _worker = worker(&app, 1, move |_, _, _, context| {
        while !gate.load(Ordering::SeqCst) {
            context.check()?;
        }
        context.report("codes", 0.75, Some(12.5));
        loop {
            context.check()?;
        }
    });
    let job = submit(&app, json!(null)).await;
    go.store(true, Ordering::SeqCst);
    until("live progress", async || jobs::find(&app, &job.id).await.unwrap().progress == 0.75).await;
    let running = JobFilter { status: Some(JobStatus::Running), ..JobFilter::default() };
    let listed = jobs::list(&app, &running, None, 10).await.unwrap().0;
    assert_eq!((listed[0].phase.as_deref(), listed[0].objective), (Some("codes"), Some(12.5)));
    until("stored progress", async || {
        app.store.find_job(&job.id).await.unwrap().unwrap().objective == Some(12.5)
    })
    .await;
    jobs::cancel(&app, &job.id).await.unwrap();
}
