//! What the service says of itself: metrics, version, logs, and the audit trail.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use reqwest::Method;
use serde_json::{Value, json};
use shapelex_server::domain::audit::{Entry, FIRST_LINK, Recorded};
use shapelex_server::service::app::metrics::METRICS;

use crate::server::{Reply, Server, Setting};

/// Name and kind of a metric, and its labels.
type Families = BTreeMap<String, (String, BTreeSet<String>)>;

fn document() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/observability.md");
    std::fs::read_to_string(path).unwrap()
}

/// The words between backticks.
fn quoted(text: &str) -> impl Iterator<Item = String> {
    text.split('`').skip(1).step_by(2).map(str::to_owned)
}

fn documented() -> Families {
    let text = document();
    let rows = text.lines().filter(|line| line.starts_with("| `shapelex_"));
    rows.map(|row| {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let name = quoted(cells[1]).next().unwrap();
        (name, (cells[2].to_owned(), quoted(cells[3]).collect()))
    })
    .collect()
}

/// A line of a scrape: name, labels, value.
type Sample<'a> = (&'a str, Vec<(String, String)>, f64);

fn sample(line: &str) -> Sample<'_> {
    let (series, value) = line.rsplit_once(' ').unwrap();
    let (name, labels) = series.split_once('{').unwrap_or((series, "}"));
    let labels = labels.trim_end_matches('}').split("\",").filter(|label| !label.is_empty());
    let labels = labels.map(|label| label.split_once("=\"").unwrap());
    let labels = labels.map(|(key, value)| (key.to_owned(), value.trim_end_matches('"').to_owned()));
    (name, labels.collect(), value.parse().unwrap())
}

fn samples(scrape: &str) -> Vec<Sample<'_>> {
    scrape.lines().filter(|line| !line.is_empty() && !line.starts_with('#')).map(sample).collect()
}

fn scraped(scrape: &str) -> Families {
    let mut families = Families::new();
    for line in scrape.lines().filter_map(|line| line.strip_prefix("# TYPE ")) {
        let (name, kind) = line.split_once(' ').unwrap();
        families.insert(name.into(), (kind.into(), BTreeSet::new()));
    }
    for (name, labels, _) in samples(scrape) {
        let of_histogram = ["_bucket", "_sum", "_count"].iter().find_map(|end| name.strip_suffix(end));
        let family = of_histogram.filter(|name| families.contains_key(*name)).unwrap_or(name);
        let known = &mut families.get_mut(family).unwrap_or_else(|| panic!("{name} has no type")).1;
        known.extend(labels.into_iter().map(|(key, _)| key).filter(|key| key != "le"));
    }
    families
}

fn scrape(server: &Server) -> String {
    let reply = server.get("/metrics");
    assert_eq!(reply.status, 200, "{}", reply.text());
    assert!(reply.header("content-type").unwrap().starts_with("text/plain; version=0.0.4"));
    reply.text().to_owned()
}

/// The value of the series with this name and these labels, among others.
fn value(scrape: &str, name: &str, labels: &[(&str, &str)]) -> f64 {
    let has = |found: &[(String, String)], (key, value): &(&str, &str)| {
        found.iter().any(|(k, v)| k == key && v == value)
    };
    let found = samples(scrape)
        .into_iter()
        .filter(|(found, of, _)| *found == name && labels.iter().all(|label| has(of, label)));
    found.map(|(_, _, value)| value).sum()
}

fn engine(server: &Server) -> String {
    server.get("/v1/version").expect(200)["database"]["engine"].as_str().unwrap().to_owned()
}

fn learn(server: &Server, name: &str) -> Reply {
    let body = json!({"name": name, "cohort": "example-cells", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 2, "centre": true}});
    server.send(server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=60").json(&body))
}

#[test]
fn the_table_of_the_metrics_is_the_documented_one() {
    let documented = documented();
    let table: BTreeMap<&str, &str> = METRICS.iter().map(|(name, kind, _)| (*name, kind.as_str())).collect();
    let names: BTreeMap<&str, &str> = documented.iter().map(|(name, (kind, _))| (&**name, &**kind)).collect();
    assert_eq!(table, names);
}

#[test]
fn a_scrape_has_what_is_documented_and_nothing_else() {
    let server = Setting::fresh().with_example().start();
    let mean = "/v1/cohorts/example-cells/mean?transformation=similarity";
    server.get(mean).expect(200);
    server.get(mean).expect(200);
    learn(&server, "counted").expect(201);
    server.get("/v1/cohorts/none-of-these").expect(404);
    server.get("/nothing/private-path").expect(404);
    server.send(server.request(Method::from_bytes(b"BREW").unwrap(), "/v1/cohorts"));
    let text = scrape(&server);
    let engine = engine(&server);
    let mut wanted = documented();
    if engine == "postgres" {
        // There is no data folder.
        wanted.remove("shapelex_store_disk_free_bytes");
    } else {
        assert!(value(&text, "shapelex_store_disk_free_bytes", &[]) > 0.0);
    }
    assert_eq!(scraped(&text), wanted, "{text}");
    let is = |name: &str, labels: &[(&str, &str)], wanted: f64| {
        assert_eq!(value(&text, name, labels), wanted, "{name} {labels:?} in\n{text}");
    };
    let requests = "shapelex_http_requests_total";
    let mean_route = ("route", "/v1/cohorts/{cohort}/mean");
    is(requests, &[mean_route, ("method", "GET"), ("status", "2xx")], 2.0);
    is("shapelex_http_request_duration_seconds_count", &[mean_route], 2.0);
    is(requests, &[("route", "/v1/cohorts/{cohort}"), ("status", "4xx")], 1.0);
    is(requests, &[("route", "unmatched"), ("status", "4xx")], 1.0);
    is(requests, &[("method", "other")], 1.0);
    // This scrape itself is not answered yet.
    is("shapelex_http_requests_in_flight", &[], 1.0);
    is("shapelex_cache_lookups_total", &[("cache", "means"), ("outcome", "miss")], 1.0);
    is("shapelex_cache_lookups_total", &[("cache", "means"), ("outcome", "hit")], 1.0);
    is("shapelex_job_attempts_total", &[("kind", "learn_dictionary"), ("outcome", "succeeded")], 1.0);
    is("shapelex_jobs_queued", &[], 0.0);
    is("shapelex_store_up", &[], 1.0);
    is("shapelex_compute_waiting", &[], 0.0);
    is("shapelex_build_info", &[("version", env!("CARGO_PKG_VERSION")), ("engine", &engine)], 1.0);
    assert!(value(&text, "shapelex_http_request_body_bytes_total", &[("route", "/v1/dictionaries")]) > 100.0);
    assert!(value(&text, "shapelex_http_response_body_bytes_total", &[mean_route]) > 1000.0);
    assert!(value(&text, "shapelex_store_database_bytes", &[]) > 10_000.0);
    assert!(value(&text, "shapelex_store_write_seconds_count", &[]) >= 1.0);
    for word in ["example-cells", "counted", "none-of-these", "private-path", "BREW"] {
        assert!(!text.contains(word), "{word} is in the metrics:\n{text}");
    }
}

#[test]
fn the_version_is_said_over_http_and_on_the_command_line() {
    let server = Server::fresh();
    let version = server.get("/v1/version").expect(200);
    assert_eq!(version["version"], env!("CARGO_PKG_VERSION"));
    assert!(version["rustc"].as_str().unwrap().starts_with("rustc 1."), "{version}");
    assert!(["sqlite", "postgres"].contains(&&*engine(&server)), "{version}");
    assert!(version["database"]["schema_version"].as_i64().unwrap() >= 7, "{version}");
    assert!(version["features"].is_array(), "{version}");
    // Without keys everyone on this machine is an administrator.
    let caller = json!({"role": "admin", "tenant": "default", "name": null, "open": true});
    assert_eq!(version["caller"], caller);
    let output = Command::new(env!("CARGO_BIN_EXE_shapelex")).arg("--version").output().unwrap();
    let line = String::from_utf8(output.stdout).unwrap();
    let wanted = match version["commit"].as_str() {
        Some(commit) => format!("shapelex {} ({commit})\n", env!("CARGO_PKG_VERSION")),
        None => format!("shapelex {}\n", env!("CARGO_PKG_VERSION")),
    };
    assert_eq!(line, wanted);
}

#[test]
fn the_settings_in_force_are_said_to_administrators() {
    let flags = ["--max-shapes", "77", "--rate-per-second", "50", "--refusals-per-minute", "0"];
    let server = Setting::fresh().flags(&flags).flags(&["--allow-origin", "https://a.example"]).start();
    let settings = server.get("/v1/settings").expect(200);
    let access = json!({"open": true, "token_issuer": null, "page_login": false, "metrics_open": false,
        "allowed_origins": ["https://a.example"]});
    assert_eq!(settings["access"], access);
    let limits = settings["limits"].as_array().unwrap();
    let limit = |name: &str| {
        let found = limits.iter().find(|limit| limit["name"] == name).unwrap();
        (found["value"].clone(), found["unit"].as_str().unwrap())
    };
    assert_eq!(limit("max_shapes"), (json!(77), "count"));
    assert_eq!(limit("max_request_seconds"), (json!(10), "seconds"));
    assert_eq!(limit("cache_seconds"), (json!(600), "seconds"));
    assert_eq!(limit("rate_burst"), (json!(100), "count"), "twice the rate");
    assert_eq!(limit("refusals_per_minute"), (Value::Null, "count"), "0 is no limit");
    // What is 0 for a part of the memory is that part.
    assert!(limit("max_buffered_bytes").0.as_u64().unwrap() >= 64 << 20);
    // Every one is the name of a flag.
    let output = Command::new(env!("CARGO_BIN_EXE_shapelex")).args(["serve", "--help"]).output().unwrap();
    let help = String::from_utf8(output.stdout).unwrap();
    for limit in limits {
        let flag = format!("--{} ", limit["name"].as_str().unwrap().replace('_', "-"));
        assert!(help.contains(&flag), "{flag}");
    }
}

// ---------------------------------------------------------------- logs

/// What no log may have: everything that [`marked_requests`] says.
const MARKS: [&str; 14] = [
    "1234.56789012",
    "77.000111222",
    "marked-cohort",
    "marked-description",
    "marked-external",
    "marked-subject",
    "marked-label",
    "marked-key",
    "marked-value",
    "marked-note",
    "marked-dictionary",
    "marked-text",
    "marked-query",
    "marked-token",
];

fn marked_shape(k: usize) -> Value {
    json!({"points": [[1_234.567_890_12, k], [0, 77.000_111_222], [-1 - (k as i64), 0], [0.5, -1]],
        "external_id": format!("marked-external-{k}"), "subject": "marked-subject", "label": "marked-label",
        "labels": {"marked-key": "marked-value"}, "metadata": {"note": "marked-note"}})
}

/// Requests of every kind that say what no log may have.
fn marked_requests(server: &Server) {
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 4});
    let cohort = json!({"name": "marked-cohort", "description": "marked-description",
        "representation": representation, "correspondence": "landmarks"});
    server.post("/v1/cohorts", &cohort).expect(201);
    server.post("/v1/cohorts", &cohort).expect(409);
    let path = "/v1/cohorts/marked-cohort/shapes";
    let shapes: Vec<Value> = (0..6).map(marked_shape).collect();
    server.post(path, &json!({ "shapes": shapes })).expect(201);
    let mut other = marked_shape(0);
    other["points"][0] = json!([77.000_111_222, 1_234.567_890_12]);
    server.post(path, &json!({ "shapes": [other] })).expect(409);
    server.post_lines(path, &[marked_shape(7), other.clone()]).expect(409);
    let mut bad = marked_shape(8);
    bad["points"][2] = json!([1_234.567_890_12, "marked-text"]);
    server.post_lines(path, &[bad.clone()]).expect(422);
    server.post_bytes(path, "text/marked-text", "marked-text 1234.56789012").expect(415);
    server.get(&format!("{path}?label=marked-label&subject=marked-subject&labels.marked-key=marked-value"));
    server.get(&format!("{path}?marked-query=marked-query")).expect(400);
    server.get(&format!("{path}?cursor=marked-query")).expect(400);
    server.get(&format!("{path}/marked-external-1")).expect(200);
    server.get(&format!("{path}/marked-external-none")).expect(404);
    server.get("/v1/cohorts/marked-cohort/mean?transformation=similarity&label=marked-label").expect(200);
    server.get("/v1/cohorts/marked-cohort/mean?transformation=marked-query").expect(400);
    let question = json!({"representation": representation, "transformation": "affine", "shapes": [bad]});
    for route in ["mean", "pca", "align", "project"] {
        server.post(&format!("/v1/{route}"), &question).expect(422);
        server.post_bytes(&format!("/v1/{route}"), "application/json", "{\"marked-text\": [1234.56789012");
    }
    let learn = json!({"name": "marked-dictionary", "cohort": "marked-cohort", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 2, "centre": true}});
    let learn = server.request(Method::POST, "/v1/dictionaries").header("prefer", "wait=60").json(&learn);
    server.send(learn).expect(201);
    let failing = json!({"name": "marked-dictionary", "cohort": "marked-cohort", "transformation": "similarity",
        "method": {"kind": "functional_pca", "components": 200, "centre": true}});
    server.post("/v1/dictionaries", &failing);
    server.post("/v1/dictionaries/marked-dictionary/encode", &json!({"shapes": [marked_shape(1)]}));
    server.post(
        "/v1/dictionaries/marked-dictionary/score",
        &json!({"cohort": "marked-cohort",
        "ids": ["marked-external-2", "marked-external-none"]}),
    );
    server.post("/v1/dictionaries/marked-none/classify", &json!({"shapes": [marked_shape(1)]})).expect(404);
    server.post_bytes("/v1/dictionaries/import", "application/json", "{\"name\": \"marked-text\"}");
    server.post("/v1/comparisons", &json!({"cohort": "marked-cohort", "attribute": "labels.marked-key"}));
    server.post("/v1/distances", &json!({"cohort": "marked-cohort", "transformation": "similarity"}));
    let search = json!({"transformation": "similarity", "shapes": [marked_shape(2)], "k": 1});
    server.post("/v1/cohorts/marked-cohort/search", &search);
    let token = server.request(Method::GET, "/v1/cohorts").header("authorization", "Bearer marked-token");
    server.send(token.header("x-request-id", "marked-text with more"));
    server.get("/v1/jobs/marked-text").expect(404);
    server.get("/v1/audit?object=marked-cohort&key=marked-key").expect(200);
    server.get("/v1/audit?since=marked-query").expect(400);
    server.get("/marked-text/marked-query?marked-query").expect(404);
    server.send(server.request(Method::from_bytes(b"marked-text").unwrap(), "/v1/cohorts"));
    server.delete(&format!("{path}/marked-external-3"));
    server.delete("/v1/dictionaries/marked-dictionary");
    server.delete("/v1/cohorts/marked-cohort");
}

#[test]
fn nothing_that_a_client_says_is_logged() {
    // Everything that this program and its libraries log at this level.
    for format in ["json", "text"] {
        let server = Setting::fresh()
            .environment("SHAPELEX_LOG", "debug")
            .environment("SHAPELEX_LOG_FORMAT", format)
            .start();
        marked_requests(&server);
        let log = server.log();
        for route in ["/v1/cohorts/{cohort}/shapes", "/v1/dictionaries/{dictionary}/encode", "/v1/audit"] {
            assert!(log.contains(route), "{route} is not in the log:\n{log}");
        }
        for mark in MARKS {
            let line = log.lines().find(|line| line.contains(mark));
            assert_eq!(line, None, "{mark} is in the log");
        }
    }
}

#[test]
fn every_request_has_a_line_with_what_operators_need() {
    let server = Server::fresh();
    let reply = server.get("/v1/cohorts");
    let id = reply.header("x-request-id").unwrap();
    let log = server.log();
    let lines = log.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let of_request: Vec<Value> = lines.filter(|line| line["span"]["id"] == id).collect();
    assert_eq!(of_request.len(), 1, "{log}");
    let line = &of_request[0];
    assert_eq!(line["level"], "INFO");
    assert_eq!(line["span"]["method"], "GET");
    assert_eq!(line["span"]["route"], "/v1/cohorts");
    assert_eq!(line["fields"]["status"], 200);
    assert_eq!(line["fields"]["key"], "local");
    assert!(line["fields"]["duration_ms"].as_f64().unwrap() > 0.0, "{line}");
}

#[test]
fn a_request_id_that_is_no_plain_word_is_replaced() {
    let server = Server::fresh();
    let long = "x".repeat(65);
    for (id, kept) in
        [("caller-17", true), ("a.b_c:D", true), ("with space", false), (&*long, false), ("", false)]
    {
        let reply = server.send(server.request(Method::GET, "/livez").header("x-request-id", id));
        assert_eq!(reply.header("x-request-id") == Some(id), kept, "{id}");
    }
}

// ---------------------------------------------------------------- the audit trail

fn audit(server: &Server, query: &str) -> Vec<Value> {
    server.get(&format!("/v1/audit{query}")).expect(200)["items"].as_array().unwrap().clone()
}

/// The trail when it has at least `count` entries: those of reads come a moment after their answers.
fn audit_of(server: &Server, query: &str, count: usize) -> Vec<Value> {
    let start = Instant::now();
    loop {
        let found = audit(server, query);
        if found.len() >= count {
            return found;
        }
        assert!(start.elapsed() < Duration::from_secs(10), "{} of {count}: {found:#?}", found.len());
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn new_cohort(server: &Server, name: &str) -> Reply {
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 4});
    server.post("/v1/cohorts", &json!({"name": name, "representation": representation}))
}

#[test]
fn every_request_is_recorded_with_its_outcome() {
    let server = Server::fresh();
    let created = new_cohort(&server, "c");
    let cohort = created.expect(201);
    let read = server.get("/v1/cohorts/c");
    server.send(server.request(Method::HEAD, "/v1/cohorts/c"));
    server.get("/v1/cohorts/none/shapes/one").expect(404);
    new_cohort(&server, "c").expect(409);
    server.get("/livez");
    server.delete("/v1/cohorts/c");
    let found = audit_of(&server, "", 6);
    let seen: Vec<(&str, &str, &str, u64)> = found
        .iter()
        .take(6)
        .map(|entry| {
            let text = |field: &str| entry[field].as_str().unwrap_or("-");
            (text("operation"), text("method"), text("route"), entry["status"].as_u64().unwrap())
        })
        .collect();
    let one = "/v1/cohorts/{cohort}";
    assert_eq!(
        seen,
        [
            ("create_cohort", "POST", "/v1/cohorts", 201),
            ("find_cohort", "GET", one, 200),
            ("find_cohort", "HEAD", one, 200),
            ("find_shape", "GET", "/v1/cohorts/{cohort}/shapes/{shape}", 404),
            ("create_cohort", "POST", "/v1/cohorts", 409),
            ("delete_cohort", "DELETE", one, 204),
        ]
    );
    assert_eq!(found[0]["objects"], json!({"created": cohort["id"]}));
    // As the caller called it, and what it was.
    assert_eq!(found[1]["objects"], json!({"cohort": "c", "cohort_id": cohort["id"]}));
    assert_eq!(found[3]["objects"], json!({"cohort": "none", "shape": "one"}));
    assert_eq!(found[1]["request_id"].as_str(), read.header("x-request-id"));
    for (place, entry) in found.iter().enumerate() {
        assert_eq!(entry["sequence"], place + 1, "{entry}");
        assert_eq!((&entry["tenant"], &entry["key"]), (&json!("default"), &json!("local")), "{entry}");
        assert_eq!((&entry["subject"], &entry["remote"]), (&Value::Null, &json!("127.0.0.1")), "{entry}");
    }
}

#[test]
fn objects_that_stand_in_bodies_are_recorded_too() {
    let server = Setting::fresh().with_example().start();
    let dictionary = learn(&server, "modes").expect(201);
    let shape = crate::http_contract::cells().remove(0);
    let score = json!({"shapes": [{"points": shape["points"]}]});
    server.post("/v1/dictionaries/modes/score", &score).expect(200);
    let found = audit_of(&server, "?operation=score", 1);
    assert_eq!(found[0]["objects"], json!({"dictionary": "modes", "dictionary_id": dictionary["id"]}));
    let learnt = &audit(&server, "?operation=learn_dictionary")[0]["objects"];
    assert!(learnt["cohort_id"].as_str().unwrap().starts_with("coh_"), "{learnt}");
    assert_eq!(learnt["created"], dictionary["id"], "{learnt}");
}

#[test]
fn the_trail_is_filtered_paged_and_exported() {
    let server = Server::fresh();
    let cohort = new_cohort(&server, "c").expect(201);
    for _ in 0..3 {
        server.get("/v1/cohorts/c").expect(200);
        server.get("/v1/cohorts/d").expect(404);
    }
    let all = audit_of(&server, "?operation=find_cohort", 6);
    let count = |query: &str| audit(&server, query).len();
    assert_eq!(count("?operation=find_cohort&status=404"), 3);
    assert_eq!(count("?object=c"), 3);
    assert_eq!(count(&format!("?object={}", cohort["id"].as_str().unwrap())), 4);
    assert_eq!(count("?object=cohort"), 0);
    assert_eq!(count("?key=local&object=d"), 3);
    assert_eq!(count("?key=other"), 0);
    let middle = all[3]["at"].as_str().unwrap();
    let since = count(&format!("?operation=find_cohort&since={middle}"));
    let until = count(&format!("?operation=find_cohort&until={middle}"));
    assert_eq!(since + until, 6);
    assert!((1..=3).contains(&until) || since == 6, "{since} since, {until} until");
    assert_eq!(count("?since=2999-01-01T00:00:00Z"), 0);
    for query in ["since=yesterday", "until=1", "limit=0", "cursor=x", "colour=red", "status=x", "format=csv"]
    {
        server.get(&format!("/v1/audit?{query}")).expect_problem(400, "invalid-query", &[]);
    }
    let first = server.get("/v1/audit?operation=find_cohort&limit=4").expect(200);
    let cursor = first["next"].as_str().unwrap();
    let second = server.get(&format!("/v1/audit?operation=find_cohort&limit=4&cursor={cursor}")).expect(200);
    let pages: Vec<&Value> =
        [&first, &second].into_iter().flat_map(|page| page["items"].as_array().unwrap()).collect();
    assert_eq!(pages, all.iter().collect::<Vec<_>>());
    assert_eq!(second["next"], Value::Null);
    let export = server.get("/v1/audit?operation=find_cohort&format=ndjson");
    assert_eq!(export.header("content-type"), Some("application/x-ndjson"));
    let lines: Vec<Value> = export.text().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(lines, all);
}

#[test]
fn the_chain_of_an_export_can_be_verified_without_the_service() {
    let server = Server::fresh();
    new_cohort(&server, "c").expect(201);
    server.get("/v1/cohorts/c?colour=red").expect(400);
    audit_of(&server, "", 2);
    let export = server.get("/v1/audit?format=ndjson");
    let mut link = FIRST_LINK;
    for (place, line) in export.text().lines().enumerate() {
        let entry: Value = serde_json::from_str(line).unwrap();
        let text = |field: &str| entry[field].as_str().map(str::to_owned);
        let at: jiff::Timestamp = text("at").unwrap().parse().unwrap();
        let recorded = Recorded::after(
            place as u64,
            &link,
            Entry {
                at_ms: at.as_millisecond(),
                tenant: text("tenant").unwrap(),
                key: text("key"),
                subject: text("subject"),
                operation: text("operation"),
                method: text("method").unwrap(),
                route: text("route"),
                objects: serde_json::from_value(entry["objects"].clone()).unwrap(),
                status: entry["status"].as_u64().map(|status| status.try_into().unwrap()),
                request_id: text("request_id").unwrap(),
                remote: text("remote"),
            },
        );
        link = recorded.digest;
        assert_eq!(text("digest").unwrap(), blake3::Hash::from_bytes(link).to_hex().as_str(), "{line}");
    }
    assert_ne!(link, FIRST_LINK);
}

#[test]
fn the_entry_of_an_acknowledged_change_survives_the_end_of_the_process() {
    let mut server = Server::fresh();
    for round in 0..5 {
        let name = format!("c{round}");
        let created = new_cohort(&server, &name).expect(201);
        server = server.kill().start();
        let id = created["id"].as_str().unwrap();
        assert_eq!(
            audit(&server, &format!("?object={id}&operation=create_cohort")).len(),
            1,
            "round {round}"
        );
    }
}

#[cfg(unix)]
#[test]
fn a_stop_writes_the_entries_that_wait() {
    let server = Server::fresh();
    let read = server.get("/v1/transformations");
    let server = server.terminate().start();
    let found = audit(&server, "?operation=list_transformations");
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!(found[0]["request_id"].as_str(), read.header("x-request-id"));
}
