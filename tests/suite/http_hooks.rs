//! Hooks: signed deliveries of changes, in order, at least once, also over `kill -9`.

use std::collections::{BTreeMap, BTreeSet};
use std::net::SocketAddr;
use std::sync::atomic::{AtomicU16, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use aws_lc_rs::hmac;
use axum::Router;
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD as BASE64;
use reqwest::Method;
use serde_json::{Value, json};
use tokio::net::TcpListener;

use crate::http_access::create_key;
use crate::server::{Server, Setting, wait};

/// Within this time a delivery arrives on a slow machine.
const PATIENCE: Duration = Duration::from_secs(60);

/// A delivery as it was received.
#[derive(Debug, Clone)]
struct Delivery {
    id: String,
    timestamp: String,
    signature: String,
    text: String,
    /// Status with which it was answered.
    status: u16,
}

impl Delivery {
    fn body(&self) -> Value {
        serde_json::from_str(&self.text).unwrap()
    }

    fn sequence(&self) -> u64 {
        self.body()["data"]["sequence"].as_u64().unwrap()
    }

    fn is_signed_by(&self, secret: &str) -> bool {
        let bytes = BASE64.decode(secret.strip_prefix("whsec_").unwrap()).unwrap();
        let key = hmac::Key::new(hmac::HMAC_SHA256, &bytes);
        let signed = format!("{}.{}.{}", self.id, self.timestamp, self.text);
        let tag = BASE64.decode(self.signature.strip_prefix("v1,").unwrap()).unwrap();
        hmac::verify(&key, signed.as_bytes(), &tag).is_ok()
    }
}

/// A receiver of deliveries on a port of its own.
struct Receiver {
    address: SocketAddr,
    inbox: Arc<Inbox>,
}

struct Inbox {
    received: Mutex<Vec<Delivery>>,
    status: AtomicU16,
    /// Time until an answer.
    delay: Duration,
}

async fn receive(State(inbox): State<Arc<Inbox>>, headers: HeaderMap, body: Bytes) -> Response {
    let text = |name: &str| headers[name].to_str().unwrap().to_owned();
    assert_eq!(text("content-type"), "application/json");
    let status = inbox.status.load(Ordering::SeqCst);
    inbox.received.lock().unwrap().push(Delivery {
        id: text("webhook-id"),
        timestamp: text("webhook-timestamp"),
        signature: text("webhook-signature"),
        text: String::from_utf8(body.to_vec()).unwrap(),
        status,
    });
    tokio::time::sleep(inbox.delay).await;
    // Where redirects lead is never asked.
    let status = StatusCode::from_u16(status).unwrap();
    (status, [(header::LOCATION, "/elsewhere")], "x".repeat(100_000)).into_response()
}

impl Receiver {
    fn start() -> Self {
        Self::answering_after(Duration::ZERO)
    }

    fn answering_after(delay: Duration) -> Self {
        let inbox = Arc::new(Inbox { received: Mutex::default(), status: AtomicU16::new(204), delay });
        let address = wait(async {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            let address = listener.local_addr().unwrap();
            let router = Router::new().fallback(receive).with_state(Arc::clone(&inbox));
            tokio::spawn(async move { axum::serve(listener, router).await });
            address
        });
        Self { address, inbox }
    }

    fn url(&self) -> String {
        format!("http://{}/in?token=a-secret-in-the-address", self.address)
    }

    /// Status of the answers from now on.
    fn answer(&self, status: u16) {
        self.inbox.status.store(status, Ordering::SeqCst);
    }

    fn received(&self) -> Vec<Delivery> {
        self.inbox.received.lock().unwrap().clone()
    }

    /// Numbers of the changes that were confirmed, in the order in which they arrived.
    fn confirmed(&self) -> Vec<u64> {
        self.received().iter().filter(|one| one.status < 300).map(Delivery::sequence).collect()
    }
}

#[track_caller]
fn until(what: &str, mut condition: impl FnMut() -> bool) {
    let start = Instant::now();
    while !condition() {
        assert!(start.elapsed() < PATIENCE, "{what} did not happen");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn server(flags: &[&str]) -> Server {
    Setting::fresh().flags(&["--allow-private-hooks", "true"]).flags(flags).start()
}

fn hook(server: &Server, body: &Value) -> Value {
    server.post("/v1/hooks", body).expect(201)
}

fn found(server: &Server, hook: &Value) -> Value {
    server.get(&format!("/v1/hooks/{}", hook["id"].as_str().unwrap())).expect(200)
}

/// Waits until the store has the receiver's answer to this change: what happens to the hook before repeats the delivery.
#[track_caller]
fn until_stored(server: &Server, hook: &Value, position: u64) {
    until("the position", || found(server, hook)["position"] == position);
}

fn path(hook: &Value, action: &str) -> String {
    format!("/v1/hooks/{}/{action}", hook["id"].as_str().unwrap())
}

fn act(server: &Server, hook: &Value, action: &str) -> Value {
    server.send(server.request(Method::POST, &path(hook, action))).expect(200)
}

fn failures(server: &Server, hook: &Value) -> Vec<Value> {
    server.get(&path(hook, "failures")).expect(200)["items"].as_array().unwrap().clone()
}

fn make_cohort(server: &Server, name: &str) -> Value {
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 3});
    server.post("/v1/cohorts", &json!({"name": name, "representation": representation})).expect(201)
}

fn shape(k: usize) -> Value {
    json!({"external_id": format!("s{k}"), "points": [[0, 0], [2.0 + k as f64, 0], [0, 1]]})
}

fn add(server: &Server, cohort: &str, k: usize) {
    server.post(&format!("/v1/cohorts/{cohort}/shapes"), &json!({"shapes": [shape(k)]})).expect(201);
}

#[test]
fn changes_are_delivered_in_order_and_signed() {
    let (server, receiver) = (server(&[]), Receiver::start());
    make_cohort(&server, "before");
    let created = hook(&server, &json!({"url": receiver.url(), "description": "all"}));
    let secret = created["secret"].as_str().unwrap();
    assert_eq!((&created["status"], &created["position"]), (&json!("active"), &json!(1)));
    make_cohort(&server, "feet");
    (0..5).for_each(|k| add(&server, "feet", k));
    until("the deliveries", || receiver.confirmed().len() == 6);
    assert_eq!(receiver.confirmed(), [2, 3, 4, 5, 6, 7]);
    let feed = server.get("/v1/changes?since=1").expect(200);
    for (delivery, change) in receiver.received().iter().zip(feed["items"].as_array().unwrap()) {
        let wanted = json!({"type": change["kind"], "timestamp": change["at"], "data": change});
        assert_eq!(delivery.body(), wanted);
        assert!(delivery.is_signed_by(secret), "{delivery:?}");
        assert!(!delivery.is_signed_by(&format!("whsec_{}", BASE64.encode([7; 32]))));
        let digits = created["id"].as_str().unwrap().trim_start_matches("hok_");
        let (store, rest) = delivery.id.strip_prefix("evt_").unwrap().split_once('_').unwrap();
        assert!(store.len() == 16 && store.bytes().all(|byte| byte.is_ascii_hexdigit()), "{}", delivery.id);
        assert_eq!(rest, format!("{digits}_{}", delivery.sequence()));
    }
    until_stored(&server, &created, 7);
    let shown = found(&server, &created);
    assert!(shown.get("secret").is_none() && shown["delivered_at"].is_string(), "{shown}");
    assert_eq!(server.get("/v1/hooks").expect(200)["items"], json!([shown]));
    let metrics = server.get("/metrics");
    assert!(metrics.text().contains("shapelex_hook_deliveries_total{outcome=\"delivered\"} 6"));
    assert!(metrics.text().contains("shapelex_hook_lag_changes 0"), "{}", metrics.text());
    // Neither the secret nor the address is in the log.
    let log = server.log();
    assert!(!log.contains(secret) && !log.contains("a-secret-in-the-address"));
    assert_eq!(server.delete(&format!("/v1/hooks/{}", created["id"].as_str().unwrap())).status, 204);
    add(&server, "feet", 9);
    std::thread::sleep(Duration::from_millis(1500));
    assert_eq!(receiver.received().len(), 6, "a deleted hook is quiet");
    server.get(&path(&created, "failures")).expect_problem(404, "not-found", &[]);
}

#[test]
fn a_hook_is_narrowed_to_kinds_and_a_cohort() {
    let (server, receiver) = (server(&[]), Receiver::start());
    let feet = make_cohort(&server, "feet");
    make_cohort(&server, "hands");
    let body = json!({"url": receiver.url(), "kinds": ["shapes_added"], "cohort": "feet"});
    let created = hook(&server, &body);
    assert_eq!((&created["cohort"], &created["kinds"]), (&feet["id"], &json!(["shapes_added"])));
    add(&server, "hands", 1);
    add(&server, "feet", 2);
    make_cohort(&server, "more");
    until("the delivery", || receiver.confirmed() == [4]);
    until_stored(&server, &created, 5);

    server.post("/v1/hooks", &json!({"url": receiver.url(), "cohort": "none"})).expect_problem(
        404,
        "not-found",
        &["/cohort"],
    );
    let bad = json!({"url": 3, "kinds": ["sung"], "colour": "red", "description": "x"});
    server.post("/v1/hooks", &bad).expect_problem(422, "invalid-input", &["/colour", "/url", "/kinds/0"]);
    let bad = json!({"url": "hooks.example", "kinds": [], "description": "x".repeat(201)});
    server.post("/v1/hooks", &bad).expect_problem(422, "invalid-input", &["/url", "/kinds", "/description"]);
    server.post("/v1/hooks", &json!({})).expect_problem(422, "invalid-input", &["/url"]);
    server.get("/v1/hooks?cursor=coh_1").expect_problem(400, "invalid-query", &[]);
}

#[test]
fn a_failing_delivery_is_repeated_under_its_id_before_any_other() {
    let (server, receiver) = (server(&[]), Receiver::start());
    let created = hook(&server, &json!({"url": receiver.url()}));
    // A redirect is no confirmation, and is not followed.
    receiver.answer(302);
    make_cohort(&server, "feet");
    add(&server, "feet", 1);
    until("a failure", || !failures(&server, &created).is_empty());
    receiver.answer(500);
    until("another failure", || failures(&server, &created).len() >= 2);
    let waiting = found(&server, &created);
    assert_eq!((&waiting["status"], &waiting["position"]), (&json!("active"), &json!(0)));
    assert!(
        waiting["attempts"].as_u64().unwrap() >= 2 && waiting["next_attempt_at"].is_string(),
        "{waiting}"
    );
    let listed = failures(&server, &created);
    assert!(listed.iter().all(|failure| failure["sequence"] == 1), "{listed:?}");
    let first = listed.last().unwrap();
    assert_eq!((&first["attempt"], &first["status"]), (&json!(1), &json!(302)));
    assert_eq!(first["detail"], "expected a status of 2xx, got 302");
    receiver.answer(200);
    until("the deliveries", || receiver.confirmed() == [1, 2]);
    let received = receiver.received();
    let of_first: BTreeSet<&str> =
        received.iter().filter(|one| one.sequence() == 1).map(|one| one.id.as_str()).collect();
    assert_eq!(of_first.len(), 1, "one id for all attempts");
    assert!(received.iter().all(|one| one.is_signed_by(created["secret"].as_str().unwrap())));
    until_stored(&server, &created, 2);
    let healthy = found(&server, &created);
    assert_eq!((&healthy["attempts"], &healthy["failing_since"]), (&json!(0), &Value::Null));
}

#[test]
fn a_hook_is_given_up_resumed_paused_and_set_back() {
    let (server, receiver) = (server(&["--hook-days", "0"]), Receiver::start());
    let created = hook(&server, &json!({"url": receiver.url()}));
    receiver.answer(503);
    make_cohort(&server, "feet");
    until("the end", || found(&server, &created)["status"] == "failed");
    let reason = found(&server, &created)["reason"].as_str().unwrap().to_owned();
    assert_eq!(reason, "the delivery of change 1 has failed for 0 days: expected a status of 2xx, got 503");
    assert!(server.get("/metrics").text().contains("shapelex_hooks_failed 1"));
    receiver.answer(200);
    add(&server, "feet", 1);
    let resumed = act(&server, &created, "resume");
    assert_eq!((&resumed["status"], &resumed["reason"]), (&json!("active"), &Value::Null));
    until("the deliveries", || receiver.confirmed() == [1, 2]);
    until_stored(&server, &created, 2);

    assert_eq!(act(&server, &created, "pause")["status"], "paused");
    add(&server, "feet", 2);
    add(&server, "feet", 3);
    std::thread::sleep(Duration::from_millis(1500));
    assert_eq!(receiver.confirmed(), [1, 2], "a paused hook is quiet");
    act(&server, &created, "resume");
    until("the rest", || receiver.confirmed() == [1, 2, 3, 4]);
    until_stored(&server, &created, 4);

    let redeliver = |since: u64| server.post(&path(&created, "redeliver"), &json!({ "since": since }));
    redeliver(2).expect(200);
    until("the repetition", || receiver.confirmed() == [1, 2, 3, 4, 3, 4]);
    until_stored(&server, &created, 4);
    let received = receiver.received();
    let ids =
        |sequence: u64| received.iter().filter(move |one| one.sequence() == sequence).map(|one| &one.id);
    assert_eq!(ids(3).collect::<BTreeSet<_>>().len(), 1);
    redeliver(5).expect_problem(422, "invalid-input", &["/since"]);
    server.post(&path(&created, "redeliver"), &json!({})).expect_problem(422, "invalid-input", &["/since"]);
    server.post("/v1/hooks/hok_none/redeliver", &json!({"since": 0})).expect_problem(404, "not-found", &[]);
    // What the receiver can never take is passed over.
    receiver.answer(400);
    add(&server, "feet", 4);
    until("the end", || found(&server, &created)["status"] == "failed");
    receiver.answer(200);
    redeliver(5).expect(200);
    add(&server, "feet", 5);
    until("what follows", || receiver.confirmed() == [1, 2, 3, 4, 3, 4, 6]);
}

#[test]
fn private_addresses_are_refused_unless_allowed() {
    let server = Server::fresh();
    for url in [
        "http://pipeline.example/",
        "https://127.0.0.1:9/",
        "https://localhost/",
        "https://[::1]/",
        "https://10.1.2.3/",
        "https://169.254.169.254/latest/meta-data/",
        "https://2130706433/",
        "https://[::ffff:192.168.0.1]/",
        "https://user:password@pipeline.example/",
    ] {
        server.post("/v1/hooks", &json!({ "url": url })).expect_problem(422, "invalid-input", &["/url"]);
    }
    // A name that resolves to this machine is found out when the connection is made.
    let receiver = Receiver::start();
    let allowing = server.terminate().flags(&["--allow-private-hooks", "true"]).start();
    let url = format!("http://localhost:{}/", receiver.address.port());
    let created = hook(&allowing, &json!({ "url": url }));
    make_cohort(&allowing, "feet");
    until("a delivery", || receiver.confirmed() == [1]);
    let strict = allowing.terminate().start();
    add(&strict, "feet", 1);
    until("a failure", || !failures(&strict, &created).is_empty());
    let detail = failures(&strict, &created)[0]["detail"].clone();
    assert_eq!(detail, "the address is not allowed any more: it is private, or without https");
    assert_eq!(receiver.confirmed(), [1]);
}

#[test]
fn single_networks_are_opened_to_hooks() {
    let server = Setting::fresh().flags(&["--hook-networks", "10.1.0.0/16, 127.0.0.1"]).start();
    for url in
        ["https://10.1.2.3/", "https://127.0.0.1:9/", "https://receiver.internal/", "https://hooks.example/"]
    {
        hook(&server, &json!({ "url": url }));
    }
    for url in ["https://10.2.0.1/", "https://169.254.169.254/", "http://10.1.2.3/", "https://127.0.0.2/"] {
        server.post("/v1/hooks", &json!({ "url": url })).expect_problem(422, "invalid-input", &["/url"]);
    }
}

#[test]
fn slow_receivers_of_one_tenant_do_not_delay_the_deliveries_of_another() {
    let server = server(&[]);
    let (slow, prompt) = (Receiver::answering_after(Duration::from_secs(9)), Receiver::start());
    let [first, second] =
        ["a", "b"].map(|tenant| create_key(&server, &["--role", "admin", "--tenant", tenant]));
    let post = |key: &str, path: &str, body: &Value| {
        server.send(server.request(Method::POST, path).bearer_auth(key).json(body)).expect(201);
    };
    for _ in 0..12 {
        post(&first, "/v1/hooks", &json!({"url": slow.url()}));
    }
    post(&second, "/v1/hooks", &json!({"url": prompt.url()}));
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 3});
    let cohort = json!({"name": "feet", "representation": representation});
    post(&first, "/v1/cohorts", &cohort);
    until("the slow deliveries", || slow.received().len() == 4);
    let start = Instant::now();
    post(&second, "/v1/cohorts", &cohort);
    until("the delivery", || !prompt.received().is_empty());
    assert!(start.elapsed() < Duration::from_secs(6), "{:?}", start.elapsed());
    assert_eq!(slow.received().len(), 4, "half of the places");
}

#[test]
fn hooks_belong_to_the_administrators_of_a_tenant() {
    let (server, receiver) = (server(&[]), Receiver::start());
    let own = hook(&server, &json!({"url": receiver.url()}));
    let other = create_key(&server, &["--role", "admin", "--tenant", "b"]);
    let writer = create_key(&server, &["--role", "writer"]);
    let send = |method: Method, path: &str, secret: &str| {
        let request = server.request(method, path).bearer_auth(secret);
        server.send(request.json(&json!({"url": receiver.url()}))).status
    };
    until("the keys", || server.get("/v1/hooks").status == 401);
    assert_eq!(send(Method::POST, "/v1/hooks", &writer), 403);
    assert_eq!(send(Method::GET, "/v1/hooks", &writer), 403);
    assert_eq!(send(Method::POST, &path(&own, "pause"), &other), 404);
    assert_eq!(send(Method::POST, "/v1/hooks", &other), 201);
    // What one tenant does is not delivered to another.
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 3});
    let cohort = json!({"name": "own", "representation": representation});
    let request = server.request(Method::POST, "/v1/cohorts").bearer_auth(&writer).json(&cohort);
    server.send(request).expect(201);
    until("the delivery", || !receiver.received().is_empty());
    std::thread::sleep(Duration::from_millis(1500));
    let ids: Vec<String> = receiver.received().into_iter().map(|one| one.id).collect();
    let end = format!("_{}_1", own["id"].as_str().unwrap().trim_start_matches("hok_"));
    assert!(ids.len() == 1 && ids[0].ends_with(&end), "{ids:?}");
    let trail =
        server.send(server.request(Method::GET, "/v1/audit?operation=create_hook").bearer_auth(&other));
    assert_eq!(trail.expect(200)["items"][0]["status"], 201);
}

/// A copy that is tried beside the store must not say what only the store may say.
#[test]
fn copies_of_a_store_are_silent_until_they_are_told_to_speak() {
    let (server, receiver) = (server(&[]), Receiver::start());
    let paused = hook(&server, &json!({"url": receiver.url()}));
    act(&server, &paused, "pause");
    let created = hook(&server, &json!({"url": receiver.url()}));
    make_cohort(&server, "feet");
    until("the delivery", || receiver.confirmed() == [1]);
    until_stored(&server, &created, 1);
    let export = server.folder().join("export");
    assert!(server.command("export").arg(&export).status().unwrap().success());
    let mut files = vec![("import", export)];
    if server.database().is_none() {
        files.push(("restore", server.folder().join("backup")));
        assert!(server.command("backup").arg(&files[1].1).status().unwrap().success());
    }
    add(&server, "feet", 1);
    until("the delivery of the store", || receiver.confirmed() == [1, 2]);
    let mut known: BTreeSet<String> = receiver.received().into_iter().map(|one| one.id).collect();
    for (command, file) in files {
        for resumes in [false, true] {
            let place = Setting::fresh().flags(&["--allow-private-hooks", "true"]);
            let mut made = place.command(command);
            made.arg(&file).args(resumes.then_some("--resume-hooks"));
            let output = made.output().unwrap();
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            let said = String::from_utf8(output.stdout).unwrap();
            assert_eq!(said.contains("1 hooks are paused"), !resumes, "{said}");
            let copy = place.start();
            assert_eq!(found(&copy, &paused)["reason"], Value::Null, "paused before");
            let before = receiver.received().len();
            add(&copy, "feet", 5);
            if !resumes {
                std::thread::sleep(Duration::from_millis(1500));
                assert_eq!(receiver.received().len(), before, "{command} delivers");
                let shown = found(&copy, &created);
                assert_eq!(shown["status"], "paused");
                assert!(shown["reason"].as_str().unwrap().contains("copy"), "{shown}");
                assert_eq!(act(&copy, &created, "resume")["reason"], Value::Null);
            }
            until("the delivery of the copy", || receiver.received().len() == before + 1);
            let delivery = receiver.received().pop().unwrap();
            assert_eq!(delivery.sequence(), 2, "another change with the number of one of the store");
            assert!(known.insert(delivery.id), "two stores deliver under the same id");
        }
    }
    let said = server.command("silence").output().unwrap();
    assert!(String::from_utf8_lossy(&said.stdout).contains("1 hooks are paused"), "{said:?}");
    assert_eq!(found(&server, &created)["status"], "paused");
}

/// Kills in the suite; `benches/reliability/hooks.py` makes hundreds.
const KILLS: usize = 8;

#[test]
fn no_delivery_is_lost_when_the_service_is_killed() {
    let receiver = Receiver::start();
    let mut server = server(&[]);
    let created = hook(&server, &json!({"url": receiver.url()}));
    make_cohort(&server, "c");
    let mut shapes = 0;
    for round in 0..KILLS {
        for _ in 0..12 {
            add(&server, "c", shapes);
            shapes += 1;
        }
        // At moments without a pattern while deliveries are under way; some fail besides.
        receiver.answer(if round % 4 == 3 { 500 } else { 200 });
        std::thread::sleep(Duration::from_millis(37 * (round as u64 * 7 % 23)));
        server = server.kill().flags(&["--allow-private-hooks", "true"]).start();
    }
    receiver.answer(200);
    let last = server.get("/v1/changes?since=0&limit=1000").expect(200)["next"].as_u64().unwrap();
    assert_eq!(last, 1 + shapes as u64);
    until("the last delivery", || receiver.confirmed().contains(&last));
    until_stored(&server, &created, last);
    let mut first_seen = BTreeMap::new();
    for (place, sequence) in receiver.confirmed().into_iter().enumerate() {
        first_seen.entry(sequence).or_insert(place);
    }
    assert_eq!(first_seen.keys().copied().collect::<Vec<_>>(), (1..=last).collect::<Vec<_>>(), "lost");
    assert!(first_seen.values().is_sorted(), "out of order: {first_seen:?}");
    let repeated = receiver.confirmed().len() as u64 - last;
    assert!(repeated <= KILLS as u64, "{repeated} repetitions for {KILLS} kills");
}
