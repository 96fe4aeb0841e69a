//! Jobs over HTTP, with the service in this process: no route starts jobs of our own making.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use shapelex_server::api;
use shapelex_server::service::app::{App, ServiceError};
use shapelex_server::service::dispatch;
use shapelex_server::service::jobs::Outcome;
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

use crate::worker::{app, submit, until, worker};

/// The service on a port of its own.
struct Service {
    app: App,
    address: String,
    client: reqwest::Client,
    stop: oneshot::Sender<()>,
    ended: JoinHandle<()>,
    _folder: TempDir,
}

impl Service {
    async fn start() -> Self {
        let (folder, app) = app().await;
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = format!("http://{}", listener.local_addr().unwrap());
        let (stop, stopped) = oneshot::channel();
        let (router, stopping) = (api::router(app.clone()), app.clone());
        let ended = tokio::spawn(async move {
            let server = axum::serve(listener, router).with_graceful_shutdown(async move {
                // A test that fails drops the sender: that is a stop, too.
                let _ = stopped.await;
                stopping.drain();
            });
            server.await.unwrap();
        });
        let client = reqwest::Client::builder().no_proxy().timeout(Duration::from_secs(60)).build().unwrap();
        Self { app, address, client, stop, ended, _folder: folder }
    }

    async fn get(&self, path: &str) -> (u16, Value) {
        answer(self.client.get(format!("{}{path}", self.address))).await
    }

    async fn cancel(&self, id: &str) -> (u16, Value) {
        answer(self.client.post(format!("{}/v1/jobs/{id}/cancel", self.address))).await
    }

    /// The head of a stream of events, and what comes.
    async fn events(&self, id: &str, last: Option<&str>) -> (u16, Events) {
        let mut request = self.client.get(format!("{}/v1/jobs/{id}/events", self.address));
        if let Some(last) = last {
            request = request.header("last-event-id", last);
        }
        let response = request.send().await.unwrap();
        let status = response.status().as_u16();
        if status == 200 {
            assert_eq!(response.headers()["content-type"], "text/event-stream");
        }
        (status, Events { response, text: String::new() })
    }
}

async fn answer(request: reqwest::RequestBuilder) -> (u16, Value) {
    let response = request.send().await.unwrap();
    (response.status().as_u16(), response.json().await.unwrap())
}

struct Events {
    response: reqwest::Response,
    text: String,
}

/// An event: name, id, data.
#[derive(Debug, Clone, PartialEq)]
struct Event {
    name: String,
    id: String,
    job: Value,
}

impl Events {
    /// The next event; none at the end of the stream.
    async fn next(&mut self) -> Option<Event> {
        loop {
            if let Some(end) = self.text.find("\n\n") {
                let block = self.text.drain(..end + 2).collect::<String>();
                // A comment keeps the connection alive.
                if let Some(event) = read_event(&block) {
                    return Some(event);
                }
                continue;
            }
            let bytes = self.response.chunk().await.unwrap()?;
            self.text.push_str(std::str::from_utf8(&bytes).unwrap());
        }
    }

    async fn rest(mut self) -> Vec<Event> {
        let mut events = Vec::new();
        while let Some(event) = self.next().await {
            events.push(event);
        }
        events
    }
}

fn read_event(block: &str) -> Option<Event> {
    let field = |name: &str| block.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(": "));
    let job = serde_json::from_str(field("data")?).unwrap();
    Some(Event { name: field("event")?.into(), id: field("id")?.into(), job })
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_is_read_with_all_its_fields() {
    let service = Service::start().await;
    let job = submit(&service.app, json!({"secret": 1})).await;
    let (status, found) = service.get(&format!("/v1/jobs/{}", job.id)).await;
    assert_eq!(status, 200);
    let created_at = found["created_at"].clone();
    assert!(created_at.as_str().unwrap().ends_with('Z'), "{found}");
    let wanted = json!({"id": job.id, "kind": "learn_dictionary", "status": "queued", "progress": 0.0,
        "seconds_left": null, "phase": null, "objective": null, "attempt": 0, "created_at": created_at, "started_at": null,
        "finished_at": null, "result": null, "problem": null});
    assert_eq!(found, wanted);

    let _worker = worker(&service.app, 1, |_, _, _, _| Err(ServiceError::invalid("/atoms", "is wrong")));
    let path = format!("/v1/jobs/{}", job.id);
    until("the failure", async || service.get(&path).await.1["status"] == "failed").await;
    let failed = service.get(&path).await.1;
    let problem = json!({"type": "urn:shapelex:problem:invalid-input", "title": "Invalid input", "status": 422,
        "code": "invalid-input", "detail": "/atoms: is wrong",
        "errors": [{"pointer": "/atoms", "detail": "is wrong"}], "request_id": null});
    assert_eq!(failed["problem"], problem);
    assert!(failed["started_at"].is_string() && failed["finished_at"].is_string(), "{failed}");
}

#[tokio::test(flavor = "multi_thread")]
async fn unknown_jobs_are_not_found() {
    let service = Service::start().await;
    for path in ["/v1/jobs/job_none", "/v1/jobs/job_none/events"] {
        let (status, problem) = service.get(path).await;
        assert_eq!((status, &problem["code"]), (404, &json!("not-found")), "{path}");
        assert_eq!(problem["detail"], "job 'job_none' not found");
    }
    assert_eq!(service.cancel("job_none").await.0, 404);
    for path in ["/v1/jobs/job_none?a=1", "/v1/jobs/job_none/events?a=1"] {
        assert_eq!(service.get(path).await.0, 400, "{path}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn jobs_are_listed_newest_first_without_results() {
    let service = Service::start().await;
    let mut ids = Vec::new();
    for k in 0..5 {
        ids.push(submit(&service.app, json!(k)).await.id);
    }
    ids.reverse();
    assert_eq!(service.cancel(&ids[1]).await.0, 200);
    let list = async |query: &str| {
        let (status, page) = service.get(&format!("/v1/jobs{query}")).await;
        assert_eq!(status, 200, "{query}: {page}");
        let items = page["items"].as_array().unwrap().iter();
        (items.map(|job| job["id"].as_str().unwrap().to_owned()).collect::<Vec<_>>(), page["next"].clone())
    };
    assert_eq!(list("").await, (ids.clone(), Value::Null));
    assert_eq!(list("?limit=2").await, (ids[..2].to_vec(), json!(ids[1])));
    assert_eq!(list(&format!("?limit=2&cursor={}", ids[1])).await, (ids[2..4].to_vec(), json!(ids[3])));
    assert_eq!(list(&format!("?limit=2&cursor={}", ids[3])).await, (ids[4..].to_vec(), Value::Null));
    assert_eq!(list("?status=cancelled").await, (ids[1..2].to_vec(), Value::Null));
    let queued = vec![ids[0].clone(), ids[2].clone()];
    assert_eq!(list("?status=queued&limit=2").await, (queued, json!(ids[2])));
    assert_eq!(list("?status=running").await, (vec![], Value::Null));
    assert_eq!(list("?kind=learn_dictionary").await, (ids.clone(), Value::Null));
    assert_eq!(list("?kind=distances&since=2020-01-01T00:00:00Z").await, (vec![], Value::Null));
    assert_eq!(list("?since=2000-01-01T00:00:00Z").await.0, ids);
    assert_eq!(list("?since=2100-01-01T00:00:00Z").await.0, [""; 0]);
    let (_, page) = service.get("/v1/jobs").await;
    assert!(page["items"].as_array().unwrap().iter().all(|job| job.get("result").is_none()), "{page}");
    assert_eq!(service.get("/v1/jobs?cohort=none").await.0, 404);
    for query in
        ["status=idle", "limit=0", "limit=1001", "cursor=coh_1", "colour=red", "kind=sing", "since=now"]
    {
        let (status, problem) = service.get(&format!("/v1/jobs?{query}")).await;
        assert_eq!((status, &problem["code"]), (400, &json!("invalid-query")), "{query}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn what_runs_is_cancelled_and_what_is_finished_is_not() {
    let service = Service::start().await;
    let _worker = worker(&service.app, 1, |_, _, job, context| {
        let spins = job.parameters == "spin";
        loop {
            context.check()?;
            if !spins {
                return Ok(Outcome { result: json!({"done": true}), dictionary: None, output: None });
            }
        }
    });
    let done = submit(&service.app, json!("short")).await;
    let path = format!("/v1/jobs/{}", done.id);
    until("the success", async || service.get(&path).await.1["status"] == "succeeded").await;
    let (status, problem) = service.cancel(&done.id).await;
    assert_eq!((status, &problem["code"]), (409, &json!("job-finished")));
    assert_eq!(problem["detail"], format!("the job '{}' has already succeeded", done.id));
    assert_eq!(service.get(&path).await.1["result"], json!({"done": true}));

    let long = submit(&service.app, json!("spin")).await;
    let path = format!("/v1/jobs/{}", long.id);
    until("the start", async || service.get(&path).await.1["status"] == "running").await;
    let (status, cancelled) = service.cancel(&long.id).await;
    assert_eq!((status, &cancelled["status"]), (200, &json!("cancelled")));
    assert_eq!(service.get(&path).await.1, cancelled);
    assert_eq!(service.cancel(&long.id).await, (200, cancelled));
}

#[tokio::test(flavor = "multi_thread")]
async fn events_tell_the_progress_and_end_with_the_outcome() {
    let service = Service::start().await;
    let job = submit(&service.app, json!(null)).await;
    let (status, mut events) = service.events(&job.id, None).await;
    assert_eq!(status, 200);
    let first = events.next().await.unwrap();
    assert_eq!((first.name.as_str(), &first.job["status"]), ("progress", &json!("queued")));
    assert_eq!(first.job, service.get(&format!("/v1/jobs/{}", job.id)).await.1);
    let start = Instant::now();
    let _worker = worker(&service.app, 1, |_, _, _, context| {
        for k in 0..1000 {
            context.report("counting", f64::from(k) / 1000.0, Some(f64::from(k)));
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(Outcome { result: json!({"dictionary": "dic_1"}), dictionary: None, output: None })
    });
    let rest = events.rest().await;
    let elapsed = start.elapsed();
    let (last, progress) = rest.split_last().unwrap();
    assert_eq!((last.name.as_str(), &last.job["status"]), ("succeeded", &json!("succeeded")));
    assert_eq!(last.job["result"], json!({"dictionary": "dic_1"}));
    assert!(progress.iter().all(|event| event.name == "progress" && event.job["status"] == "running"));
    let fractions: Vec<f64> = progress.iter().map(|event| event.job["progress"].as_f64().unwrap()).collect();
    assert!(fractions.is_sorted() && fractions.len() >= 3, "{fractions:?}");
    // Two at the start, when the status changes and the work begins, then five a second.
    let most = elapsed.as_millis() / 200 + 3;
    assert!(fractions.len() as u128 <= most, "{} events in {elapsed:?}", fractions.len());
    let mut ids: Vec<&str> = rest.iter().map(|event| event.id.as_str()).collect();
    ids.sort_unstable();
    ids.dedup();
    assert_eq!(ids.len(), rest.len(), "every state is told once");

    // Who comes late is told the outcome at once; who knows it has nothing to hear.
    let (_, late) = service.events(&job.id, None).await;
    assert_eq!(late.rest().await, std::slice::from_ref(last));
    let (_, stale) = service.events(&job.id, Some(&first.id)).await;
    assert_eq!(stale.rest().await, std::slice::from_ref(last));
    assert_eq!(service.events(&job.id, Some(&last.id)).await.0, 204);
    for other in ["-1", "7", "0123456789ABCDEF"] {
        assert_eq!(service.events(&job.id, Some(other)).await.0, 400, "{other}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_running_job_is_reported_every_second_with_the_time_left() {
    let service = Service::start().await;
    let _worker = worker(&service.app, 1, |_, _, _, context| {
        context.report("thinking", 0.25, None);
        std::thread::sleep(Duration::from_millis(3500));
        Ok(Outcome { result: json!(null), dictionary: None, output: None })
    });
    let job = submit(&service.app, json!({})).await;
    let (_, events) = service.events(&job.id, None).await;
    let events = events.rest().await;
    let thinking: Vec<&Event> = events.iter().filter(|event| event.job["phase"] == "thinking").collect();
    let running = thinking.iter().filter(|event| event.job["status"] == "running");
    let left: Vec<f64> = running.map(|event| event.job["seconds_left"].as_f64().unwrap()).collect();
    assert!(left.len() >= 3 && left.iter().all(|seconds| *seconds >= 0.0), "{left:?}");
    let last = events.last().unwrap();
    assert_eq!((last.name.as_str(), &last.job["seconds_left"]), ("succeeded", &Value::Null));
}

/// Outlines of many forms that start anywhere: the search for start points takes several rounds.
fn outlines(count: usize) -> Value {
    let shape = |k: usize| {
        let phase = k as f64;
        let point = move |i: usize| {
            let angle = std::f64::consts::TAU * (i + k % 13) as f64 / 48.0;
            let wave = |order: f64, shift: f64| (order * angle + shift).cos();
            let (second, third) = (wave(2.0, 1.3 * phase.sin()), wave(3.0, 2.1 * (1.7 * phase).sin()));
            let r = 2.0 + 0.4 * second + 0.3 * third + 0.2 * wave(5.0, phase);
            json!([r * angle.cos(), 0.7 * r * angle.sin()])
        };
        json!({"points": (0..48).map(point).collect::<Vec<_>>()})
    };
    json!({"shapes": (0..count).map(shape).collect::<Vec<_>>()})
}

#[tokio::test(flavor = "multi_thread")]
async fn the_progress_of_learning_counts_its_work() {
    let service = Service::start().await;
    let post = async |path: &str, body: &Value| {
        answer(service.client.post(format!("{}{path}", service.address)).json(body)).await
    };
    let cohort = json!({"name": "anywhere", "correspondence": "cyclic", "representation": {"kind": "closed_curve",
        "dimension": 2, "control_points": 32, "generator": {"name": "trigonometric"}}});
    assert_eq!(post("/v1/cohorts", &cohort).await.0, 201);
    let (status, added) = post("/v1/cohorts/anywhere/shapes", &outlines(3000)).await;
    assert_eq!(status, 201, "{added}");
    let seen: Arc<Mutex<Vec<(&str, f64)>>> = Arc::default();
    let sampled = Arc::clone(&seen);
    let _worker = worker(&service.app, 1, move |app, handle, job, context| {
        let ended = AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while !ended.load(Ordering::SeqCst) {
                    let progress = context.progress();
                    let phase = progress.phase.map(|phase| (phase, progress.fraction));
                    sampled.lock().unwrap().extend(phase);
                    std::thread::sleep(Duration::from_micros(100));
                }
            });
            let outcome = dispatch::run(app, handle, job, context);
            ended.store(true, Ordering::SeqCst);
            outcome
        })
    });
    // The thread that looks may get no core while a mean of milliseconds is computed: then another job is looked at.
    let mut looked = Vec::new();
    for name in ["one", "two", "three", "four", "five", "six"] {
        let learn = json!({"name": name, "cohort": "anywhere", "transformation": "similarity",
            "method": {"kind": "functional_pca", "components": 4}});
        let (status, job) = post("/v1/dictionaries", &learn).await;
        assert_eq!(status, 202, "{job}");
        let id = job["id"].as_str().unwrap();
        let done =
            shapelex_server::service::jobs::wait(&service.app, id, Duration::from_secs(120)).await.unwrap();
        assert_eq!((done.status.as_str(), done.progress), ("succeeded", 1.0), "{done:?}");
        looked.push(places_of_the_mean(&std::mem::take(&mut *seen.lock().unwrap())));
        if looked.last().is_some_and(|mean| is_counted(mean)) {
            break;
        }
    }
    assert!(looked.last().is_some_and(|mean| is_counted(mean)), "{looked:?}");
}

/// Whether the passes of a mean were counted while they went on. The thread that looks may begin late, so the first
/// place that it saw is compared with the last one.
fn is_counted(mean: &[f64]) -> bool {
    mean.len() >= 6 && mean[0] < mean[mean.len() - 1] / 2.0 && mean[mean.len() - 1] > 0.1
}

/// Places of a job in its mean, of what was seen of it, which never falls, in the order of its phases.
fn places_of_the_mean(seen: &[(&str, f64)]) -> Vec<f64> {
    assert!(seen.is_sorted_by(|a, b| a.1 <= b.1), "progress falls");
    assert!(seen.iter().all(|(_, at)| *at < 1.0), "{:?}", seen.last());
    let mut phases: Vec<&str> = seen.iter().map(|(phase, _)| *phase).collect();
    phases.dedup();
    let order = ["mean", "align", "learn", "certify", "hold_out"];
    assert!(phases.is_sorted_by_key(|phase| order.iter().position(|one| one == phase)), "{phases:?}");
    let mut mean: Vec<f64> = seen.iter().filter(|(phase, _)| *phase == "mean").map(|(_, at)| *at).collect();
    mean.dedup();
    mean
}

#[tokio::test(flavor = "multi_thread")]
async fn what_the_client_knows_is_not_told_again() {
    let service = Service::start().await;
    let job = submit(&service.app, json!(null)).await;
    let known = service.events(&job.id, None).await.1.next().await.unwrap();
    let (status, events) = service.events(&job.id, Some(&known.id)).await;
    assert_eq!(status, 200);
    service.cancel(&job.id).await;
    let told = events.rest().await;
    assert_eq!(told.len(), 1, "{told:?}");
    assert_eq!(told[0].name, "cancelled");
}

#[tokio::test(flavor = "multi_thread")]
async fn streams_of_events_do_not_hold_up_a_stop() {
    let service = Service::start().await;
    let released = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&released);
    let running = worker(&service.app, 1, move |_, _, _, context| {
        context.report("spinning", 0.5, None);
        while !context.is_cancelled() {
            std::hint::spin_loop();
        }
        flag.store(true, Ordering::SeqCst);
        context.check()?;
        Ok(Outcome { result: json!(null), dictionary: None, output: None })
    });
    let job = submit(&service.app, json!(null)).await;
    let (_, mut events) = service.events(&job.id, None).await;
    while events.next().await.unwrap().job["phase"] != "spinning" {}
    let start = Instant::now();
    service.stop.send(()).unwrap();
    let rest = events.rest().await;
    assert!(rest.iter().all(|event| event.name == "progress"), "{rest:?}");
    running.stop().await;
    assert!(released.load(Ordering::SeqCst));
    drop(service.client);
    service.ended.await.unwrap();
    assert!(start.elapsed() < Duration::from_secs(5), "{:?}", start.elapsed());
    let after = shapelex_server::service::jobs::find(&service.app, &job.id).await.unwrap();
    assert_eq!(after, job, "put back as if nobody had touched it");
}
