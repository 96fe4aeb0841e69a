//! Events of a tenant as one stream: changes that can be resumed, and the progress of jobs.

use std::time::{Duration, Instant};

use reqwest::Method;
use serde_json::{Value, json};

use crate::http_access::create_key;
use crate::server::{Server, Setting, wait};

/// Within this time an event arrives on a slow machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// An event: name, number, data.
#[derive(Debug, Clone, PartialEq)]
struct Event {
    name: String,
    id: Option<u64>,
    data: Value,
}

/// An open stream of events.
struct Stream {
    response: reqwest::Response,
    text: String,
    /// Number that the stream has named last.
    last: Option<u64>,
}

impl Stream {
    fn open(server: &Server, query: &str, last: Option<u64>, secret: Option<&str>) -> Self {
        let mut request = server.request(Method::GET, &format!("/v1/events{query}"));
        if let Some(last) = last {
            request = request.header("last-event-id", last.to_string());
        }
        if let Some(secret) = secret {
            request = request.bearer_auth(secret);
        }
        let response = wait(async { request.send().await }).unwrap();
        assert_eq!(response.status(), 200);
        assert_eq!(response.headers()["content-type"], "text/event-stream");
        let mut stream = Self { response, text: String::new(), last: None };
        // The opening names the position.
        while stream.last.is_none() {
            assert_eq!(stream.block(), None);
        }
        stream
    }

    /// The next block of the stream, if it is an event; comments and positions are not.
    fn block(&mut self) -> Option<Event> {
        let end = loop {
            match self.text.find("\n\n") {
                Some(end) => break end,
                None => {
                    let chunk = wait(async { tokio::time::timeout(PATIENCE, self.response.chunk()).await });
                    let bytes = chunk.expect("an event in time").unwrap().expect("the stream goes on");
                    self.text.push_str(std::str::from_utf8(&bytes).unwrap());
                }
            }
        };
        let block: String = self.text.drain(..end + 2).collect();
        let field = |name: &str| block.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(": "));
        let id = field("id").map(|id| id.parse().unwrap());
        self.last = id.or(self.last);
        let data = serde_json::from_str(field("data")?).unwrap();
        Some(Event { name: field("event").unwrap().into(), id, data })
    }

    fn next(&mut self) -> Event {
        loop {
            if let Some(event) = self.block() {
                return event;
            }
        }
    }

    /// The next `count` changes: progress of jobs is left out.
    fn changes(&mut self, count: usize) -> Vec<Event> {
        std::iter::repeat_with(|| self.next()).filter(|event| event.id.is_some()).take(count).collect()
    }
}

fn names(events: &[Event]) -> Vec<&str> {
    events.iter().map(|event| event.name.as_str()).collect()
}

fn cohort(name: &str) -> Value {
    json!({"name": name, "representation": {"kind": "landmarks", "dimension": 2, "points": 3}})
}

fn triangles(count: usize) -> Value {
    let shape = |k: usize| json!({"points": [[0, 0], [2.0 + k as f64, 0], [0, 1.0 + (k % 3) as f64]]});
    json!({"shapes": (0..count).map(shape).collect::<Vec<_>>()})
}

#[test]
fn changes_arrive_in_order_and_a_stream_is_resumed_without_a_gap() {
    let server = Server::fresh();
    let mut stream = Stream::open(&server, "", None, None);
    assert_eq!(stream.last, Some(0));
    let id = server.post("/v1/cohorts", &cohort("feet")).expect(201)["id"].clone();
    server.post("/v1/cohorts/feet/shapes", &triangles(5)).expect(201);
    let events = stream.changes(2);
    assert_eq!(names(&events), ["cohort_created", "shapes_added"]);
    assert_eq!((events[0].id, events[1].id), (Some(1), Some(2)));
    assert_eq!((&events[1].data["cohort"], &events[1].data["shape_count"]), (&id, &json!(5)));
    // An event says what the feed says.
    assert_eq!(events[1].data, server.get("/v1/changes?since=1").expect(200)["items"][0]);
    drop(stream);

    let learn = json!({"name": "mean-feet", "cohort": "feet", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 2}});
    let job = server.post("/v1/dictionaries", &learn).expect(202)["id"].clone();
    let mut resumed = Stream::open(&server, "", Some(1), None);
    let events = resumed.changes(4);
    assert_eq!(names(&events), ["shapes_added", "job_queued", "dictionary_added", "job_succeeded"]);
    assert_eq!(events.iter().map(|event| event.id.unwrap()).collect::<Vec<_>>(), [2, 3, 4, 5]);
    assert_eq!((&events[3].data["object"], &events[3].data["cohort"]), (&job, &id));
    let mut since = Stream::open(&server, "?since=4", None, None);
    assert_eq!(since.changes(1), events[3..]);

    let wrong = server.request(Method::GET, "/v1/events").header("last-event-id", "job_1");
    server.send(wrong).expect_problem(400, "invalid-query", &[]);
    server.get("/v1/events?kind=shapes_added,sung").expect_problem(400, "invalid-query", &[]);
    server.get("/v1/events?cohort=none").expect_problem(404, "not-found", &[]);
    server.get("/v1/events?colour=red").expect_problem(400, "invalid-query", &[]);
}

#[test]
fn a_stream_is_narrowed_to_kinds_and_a_cohort() {
    let server = Server::fresh();
    for name in ["feet", "hands"] {
        server.post("/v1/cohorts", &cohort(name)).expect(201);
        server.post(&format!("/v1/cohorts/{name}/shapes"), &triangles(3)).expect(201);
    }
    let mut added = Stream::open(&server, "?kind=shapes_added", Some(0), None);
    assert_eq!(added.changes(2).iter().map(|event| event.id.unwrap()).collect::<Vec<_>>(), [2, 4]);
    let mut hands = Stream::open(&server, "?cohort=hands", Some(0), None);
    assert_eq!(names(&hands.changes(2)), ["cohort_created", "shapes_added"]);
    let mut last = Stream::open(&server, "?cohort=hands&kind=shapes_added,job_failed", Some(0), None);
    assert_eq!(last.changes(1)[0].id, Some(4));
}

#[test]
fn the_progress_of_running_jobs_is_told_every_second() {
    let server = Setting::fresh().with_example().start();
    let learn = json!({"name": "slow", "cohort": "example-cells", "transformation": "similarity", "method":
        {"kind": "sparse", "atoms": 30, "lambda": 0.02, "max_epochs": 10_000, "tolerance": 0.0},
        "classifier": {"kind": "discriminant", "attribute": "labels.treatment", "repeats": 20}});
    let mut stream = Stream::open(&server, "?kind=job_progress", None, None);
    let job = server.post("/v1/dictionaries", &learn).expect(202)["id"].clone();
    let mut times = Vec::new();
    while times.len() < 4 {
        let event = stream.next();
        assert_eq!((event.name.as_str(), event.id, &event.data["id"]), ("job_progress", None, &job));
        assert_eq!(event.data["status"], "running", "{}", event.data);
        assert!(event.data["seconds_left"].as_f64().unwrap() >= 0.0 && event.data["result"].is_null());
        times.push(Instant::now());
    }
    let cancel = format!("/v1/jobs/{}/cancel", job.as_str().unwrap());
    server.send(server.request(Method::POST, &cancel)).expect(200);
    let mut changes = Stream::open(&server, "?kind=job_cancelled", Some(0), None);
    assert_eq!(changes.next().data["object"], job);
}

#[test]
fn a_caller_sees_the_cohorts_of_its_key_while_the_key_is_valid() {
    let server = Server::fresh();
    for name in ["feet", "hands"] {
        server.post("/v1/cohorts", &cohort(name)).expect(201);
    }
    let admin = create_key(&server, &["--role", "admin"]);
    let narrow = create_key(&server, &["--role", "reader", "--cohort", "hands"]);
    let post = |name: &str| {
        let path = format!("/v1/cohorts/{name}/shapes");
        server.send(server.request(Method::POST, &path).bearer_auth(&admin).json(&triangles(2))).expect(201);
    };
    let mut stream = Stream::open(&server, "", Some(0), Some(&narrow));
    post("feet");
    post("hands");
    let seen = stream.changes(2);
    assert_eq!(names(&seen), ["cohort_created", "shapes_added"]);
    assert_eq!((seen[0].id, seen[1].id), (Some(2), Some(4)));
    let feet = server.request(Method::GET, "/v1/events?cohort=feet").bearer_auth(&narrow);
    server.send(feet).expect_problem(404, "not-found", &[]);
    // The first key closes the service within two seconds.
    let start = Instant::now();
    while server.get("/v1/events").status != 401 {
        assert!(start.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(100));
    }

    let id = format!("/v1/keys/key_{}", narrow.split('_').nth(1).unwrap());
    assert_eq!(server.send(server.request(Method::DELETE, &id).bearer_auth(&admin)).status, 204);
    let ended = wait(async {
        tokio::time::timeout(PATIENCE, async { while stream.response.chunk().await.unwrap().is_some() {} })
            .await
    });
    ended.expect("the stream of a revoked key ends");
}

#[test]
fn streams_of_a_caller_are_limited_and_end_with_the_service() {
    let server = Server::fresh();
    let mut streams: Vec<Stream> = (0..16).map(|_| Stream::open(&server, "", None, None)).collect();
    server.get("/v1/events").expect_problem(503, "overloaded", &[]);
    server.post("/v1/cohorts", &cohort("feet")).expect(201);
    server.post("/v1/cohorts/feet/shapes", &triangles(5)).expect(201);
    let learn = json!({"name": "mean-feet", "cohort": "feet", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 2}});
    let job = server.post("/v1/dictionaries", &learn).expect(202)["id"].as_str().unwrap().to_owned();
    // Streams of jobs have the same places.
    let of_job = format!("/v1/jobs/{job}/events");
    server.get(&of_job).expect_problem(503, "overloaded", &[]);
    streams.pop();
    let start = Instant::now();
    let mut again = loop {
        // The place is free when the server has noticed.
        let response = wait(async { server.request(Method::GET, "/v1/events").send().await }).unwrap();
        if response.status() == 200 {
            break response;
        }
        assert!(start.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(50));
    };
    let stopping = std::thread::spawn(move || server.terminate());
    wait(async { while again.chunk().await.unwrap().is_some() {} });
    stopping.join().unwrap();
}

/// A mirror downstream follows every kind that the page names.
#[test]
fn the_page_names_every_kind_of_change() {
    let page = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/events.md");
    let page = std::fs::read_to_string(page).unwrap();
    for kind in shapelex_server::domain::change::ChangeKind::ALL {
        assert!(page.contains(&format!("`{}`", kind.as_str())), "docs/events.md lacks {}", kind.as_str());
    }
}
