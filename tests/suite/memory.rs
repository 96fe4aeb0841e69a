//! What a body, and what answers that nobody reads, may take of memory: measured at the running program, in its peak of
//! resident memory.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use flate2::Compression;
use flate2::write::GzEncoder;
use reqwest::Method;
use reqwest::header::{CONTENT_ENCODING, CONTENT_TYPE};
use serde_json::{Value, json};

use crate::form::{form, label_picture, post_form};
use crate::server::{Server, Setting};

/// Length of the bodies: long enough to stand out from what the process takes anyway.
const BYTES: usize = 6 << 20;
/// Memory of a body in multiples of its length.
const FACTOR: usize = 12;
/// What an allocator holds back, threads and the first use of a route take.
const BESIDES: usize = 40 << 20;

/// A value of `/proc/{pid}/status` in bytes.
fn status(server: &Server, name: &str) -> usize {
    let text = std::fs::read_to_string(format!("/proc/{}/status", server.id())).unwrap();
    let line = text.lines().find(|line| line.starts_with(name)).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<usize>().unwrap() << 10
}

/// By how much the peak of `server` rises above what it has, meanwhile.
pub(crate) fn growth(server: &Server, work: impl FnOnce()) -> usize {
    std::fs::write(format!("/proc/{}/clear_refs", server.id()), "5").unwrap();
    let before = status(server, "VmRSS");
    work();
    status(server, "VmHWM").saturating_sub(before)
}

/// A document of `BYTES` whose list repeats one entry.
fn repeated(head: &str, entry: &str, tail: &str) -> String {
    let count = BYTES / (entry.len() + 1);
    let mut text = String::with_capacity(BYTES + head.len() + tail.len() + entry.len());
    text.push_str(head);
    for _ in 0..count {
        text.push_str(entry);
        text.push(',');
    }
    text.push_str(entry);
    text.push_str(tail);
    text
}

const CURVE: &str = r#""representation":{"kind":"closed_curve","dimension":2,"control_points":4,"generator":{"name":"cubic"}}"#;

/// Route, beginning, entry and end of documents with one long list.
fn lists() -> Vec<(&'static str, String, &'static str, &'static str)> {
    let shapes = || "{\"shapes\":[".to_owned();
    let with_curve = |rest: &str| format!("{{{CURVE},{rest}");
    vec![
        ("/v1/project", shapes(), "[]", "]}"),
        ("/v1/mean", shapes(), "{}", "]}"),
        ("/v1/measure", with_curve("\"shapes\":["), "{}", "]}"),
        ("/v1/pca", shapes(), "{\"a\":1}", "]}"),
        ("/v1/align", shapes(), "{\"weight\":\"a\"}", "]}"),
        ("/v1/distances", shapes(), "{\"points\":[[0,\"a\"]]}", "]}"),
        ("/v1/resample", "{\"count\":5,\"shapes\":[".into(), "{\"labels\":{\"a\":1}}", "]}"),
        ("/v1/evaluate", with_curve("\"shapes\":[{\"metadata\":["), "{\"a\":1}", "]}]}"),
        ("/v1/evaluate", with_curve("\"shapes\":[{\"points\":["), "[0,0]", "]}]}"),
        ("/v1/evaluate", with_curve("\"shapes\":[{\"points\":[["), "0", "]]}]}"),
        ("/v1/evaluate", with_curve("\"shapes\":[{\"points\":[["), "[]", "]]}]}"),
        ("/v1/evaluate", with_curve("\"shapes\":[],\"parameters\":["), "0", "]}"),
        ("/v1/fit", with_curve("\"shapes\":[],\"parameters\":["), "[]", "]}"),
        ("/v1/fit", "{\"meshes\":[".into(), "{}", "]}"),
        ("/v1/fit", "{\"meshes\":[{\"faces\":[".into(), "[0,0,0]", "]}]}"),
        ("/v1/mean", "{\"representation\":[".into(), "{\"a\":1}", "]}"),
        ("/v1/mean", "{\"transformation\":{\"matrices\":[".into(), "[[0]]", "]}}"),
        ("/v1/idealised", format!("{{{CURVE},\"curves\":["), "{}", "]}"),
        ("/v1/idealised", format!("{{{CURVE},\"curves\":["), "{\"curve\":{}}", "]}"),
        ("/v1/overlap", "{\"first\":{\"mask\":{\"runs\":[".into(), "1", "]}}}"),
        ("/v1/overlap", "{\"first\":{\"faces\":[".into(), "[0,0,0]", "]}}"),
        ("/v1/subdivide", "{\"mesh\":{\"vertices\":[".into(), "[]", "]}}"),
        ("/v1/morph", with_curve("\"positions\":["), "0", "]}"),
        ("/v1/deform", with_curve("\"handles\":["), "{\"parameters\":[],\"position\":[]}", "]}"),
        ("/v1/distances", "{\"cohort\":\"none\",\"ids\":[".into(), "\"\"", "]}"),
        ("/v1/comparisons", "{\"groups\":[".into(), "{\"name\":\"\",\"filter\":{}}", "]}"),
        ("/v1/regressions", "{\"covariates\":[".into(), "\"\"", "]}"),
        ("/v1/models", "{\"at\":[".into(), "{\"a\":1}", "]}"),
        ("/v1/models", "{\"blocks\":[".into(), "\"\"", "]}"),
        ("/v1/models", "{\"pairs\":{\"groups\":[".into(), "\"\"", "]}}"),
        ("/v1/models", "{\"pairs\":{\"statistics\":[".into(), "\"angle\"", "]}}"),
        ("/v1/models/compare", "{\"blocks\":[".into(), "\"\"", "]}"),
        ("/v1/models", "{\"covariance\":{\"rows\":[".into(), "[0]", "]}}"),
        ("/v1/repeatability", "{\"strata\":[".into(), "\"\"", "]}"),
        ("/v1/two-blocks", "{\"others\":[".into(), "{\"points\":[0]}", "]}"),
        ("/v1/two-blocks", "{\"x\":{\"labels\":[".into(), "\"\"", "]}}"),
        ("/v1/modularity", "{\"modules\":{\"a\":{\"points\":[".into(), "0", "]}}}"),
        ("/v1/match", shapes(), "{\"points\":[[0,0]]}", "]}"),
        ("/v1/slide", shapes(), "{\"points\":[[0,0]]}", "]}"),
        ("/v1/slide", "{\"sliders\":[".into(), "[0,1,2]", "]}"),
        ("/v1/slide", "{\"curves\":[".into(), "[0]", "]}"),
        ("/v1/warp", "{\"reference\":[".into(), "[0,0]", "]}"),
        ("/v1/warp", "{\"links\":[".into(), "[0,1]", "]}"),
        ("/v1/symmetry", "{\"pairs\":[".into(), "[0,0]", "]}"),
        ("/v1/symmetry", "{\"shape\":{\"points\":[".into(), "[0,0]", "]}}"),
        ("/v1/dictionaries", "{\"filter\":{\"labels\":[".into(), "{\"a\":1}", "]}}"),
        ("/v1/dictionaries/import", "{\"content\":[".into(), "{\"a\":1}", "]}"),
        ("/v1/cohorts", "{\"name\":[".into(), "{\"a\":1}", "]}"),
        ("/v1/cohorts/example-cells/search", shapes(), "[]", "]}"),
        ("/v1/cohorts/example-cells/search", "{\"ids\":[".into(), "\"\"", "]}"),
        ("/v1/cohorts/example-cells/shapes", shapes(), "[]", "]}"),
        ("/v1/cohorts/example-cells/shapes", shapes(), "{\"metadata\":{\"a\":[{\"a\":1}]}}", "]}"),
        ("/v1/keys", "{\"cohorts\":[".into(), "\"\"", "]}"),
    ]
}

#[test]
fn no_body_takes_more_than_a_multiple_of_its_length() {
    let server = Setting::fresh().with_example().start();
    let mut table = Vec::new();
    for (path, head, entry, tail) in lists() {
        let body = repeated(&head, entry, tail);
        let (length, mut answered) = (body.len(), 0);
        let taken = growth(&server, || {
            let reply = server.post_bytes(path, "application/json", body);
            answered = reply.status;
            assert!((400..500).contains(&reply.status), "{path} {head}{entry}: {}", reply.status);
            // Who sends much is not answered with as much.
            assert!(reply.text().len() < 64 << 10, "{path} {entry}: {} bytes", reply.text().len());
        });
        println!("{path} {entry}: {answered}, {} MB for {} MB", taken >> 20, length >> 20);
        if taken > FACTOR * length + BESIDES {
            table.push(format!("{path} {head}{entry}: {} MB", taken >> 20));
        }
    }
    assert_eq!(table, [""; 0], "more than {FACTOR} times {} MB", BYTES >> 20);
}

/// Path, beginning, entry and end of the documents of forms with one long list.
const FORMS: [(&str, &str, &str, &str); 12] = [
    ("/v1/segment", "{\"seeds\":[", "{}", "]}"),
    ("/v1/segment", "{\"seeds\":[", "{\"at\":[0,0]}", "]}"),
    ("/v1/segment", "{\"boxes\":[", "{\"lower\":[],\"upper\":[]}", "]}"),
    ("/v1/segment", "{\"shapes\":[", "{}", "]}"),
    ("/v1/segment", "{\"terms\":[", "{\"name\":\"contour\"}", "]}"),
    ("/v1/segment", "{\"stages\":[", "{\"sigma\":1}", "]}"),
    ("/v1/segment", "{\"mask_labels\":[", "1", "]}"),
    ("/v1/segment", "{\"prior\":{\"reference\":[", "{\"a\":1}", "]}}"),
    ("/v1/cohorts/example-cells/segment", "{\"objects\":[", "{}", "]}"),
    ("/v1/cohorts/example-cells/segment", "{\"objects\":[", "{\"labels\":{\"a\":1}}", "]}"),
    ("/v1/cohorts/example-cells/segment", "{\"objects\":[", "{\"metadata\":[1]}", "]}"),
    ("/v1/contours", "{\"labels\":[", "1", "]}"),
];

#[test]
fn no_document_of_a_form_takes_more_than_a_multiple_of_its_length() {
    let server = Setting::fresh().with_example().start();
    let (image, mut table) = (label_picture(), Vec::new());
    for (path, head, entry, tail) in FORMS {
        let document = repeated(head, entry, tail);
        let body =
            form(&[("parameters", "application/json", document.as_bytes()), ("image", "image/png", &image)]);
        let (length, mut answered) = (body.len(), 0);
        let taken = growth(&server, || {
            let reply = post_form(&server, path, body);
            answered = reply.status;
            assert!((400..500).contains(&reply.status), "{path} {head}{entry}: {}", reply.status);
            assert!(reply.text().len() < 64 << 10, "{path} {entry}: {} bytes", reply.text().len());
        });
        println!("{path} {head}{entry}: {answered}, {} MB for {} MB", taken >> 20, length >> 20);
        if taken > FACTOR * length + BESIDES {
            table.push(format!("{path} {head}{entry}: {} MB", taken >> 20));
        }
    }
    assert_eq!(table, [""; 0], "more than {FACTOR} times {} MB", BYTES >> 20);
}

#[test]
fn a_stream_takes_no_more_than_its_lines() {
    let server = Setting::fresh().with_example().start();
    for (line, query) in
        [("[]", "?on_error=skip"), ("{\"metadata\":{\"a\":[{\"a\":1}]}}", "?on_error=skip"), ("{", "")]
    {
        let body = format!("{line}\n").repeat(BYTES / (line.len() + 1));
        let length = body.len();
        let path = format!("/v1/cohorts/example-cells/shapes{query}");
        let taken = growth(&server, || {
            server.post_bytes(&path, "application/x-ndjson", body);
        });
        println!("{line}: {} MB for {} MB", taken >> 20, length >> 20);
        assert!(taken < FACTOR * length + BESIDES, "{line}: {} MB", taken >> 20);
    }
}

fn gzip(pieces: impl IntoIterator<Item = Vec<u8>>) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    pieces.into_iter().for_each(|piece| encoder.write_all(&piece).unwrap());
    encoder.finish().unwrap()
}

#[test]
fn bodies_that_expand_beyond_text_are_refused_early() {
    let server = Setting::fresh().with_example().start();
    let document = repeated("{\"shapes\":[", "[]", "]}").into_bytes();
    let lines = (0..64).map(|_| vec![b'\n'; 1 << 20]);
    for (path, media_type, body) in [
        ("/v1/project", "application/json", gzip([document])),
        ("/v1/cohorts/example-cells/shapes", "application/x-ndjson", gzip(lines)),
    ] {
        let request = server.request(Method::POST, path).header(CONTENT_TYPE, media_type);
        let reply = server.send(request.header(CONTENT_ENCODING, "gzip").body(body));
        reply.expect(413);
        assert!(reply.text().contains("times its size"), "{}", reply.text());
    }
    // What compresses as text does is read.
    let shapes: Vec<Value> = (0..3000)
        .map(|k| json!({"points": [[k, 0.1 * f64::from(k).sin()], [k + 7, 1.5], [k, 9.25]]}))
        .collect();
    let body = gzip([json!({"count": 5, "shapes": shapes}).to_string().into_bytes()]);
    let request = server.request(Method::POST, "/v1/resample").header(CONTENT_TYPE, "application/json");
    server.send(request.header(CONTENT_ENCODING, "gzip").body(body)).expect(200);
}

#[test]
fn a_body_of_too_many_values_or_shapes_names_the_limit() {
    let server = Setting::fresh().flags(&["--max-json-values", "1000", "--max-shapes", "100"]).start();
    let body = |count: usize| format!("{{{CURVE},\"shapes\":[{}]}}", vec!["[]"; count].join(","));
    let reply = server.post_bytes("/v1/measure", "application/json", body(600));
    reply.expect(413);
    assert!(reply.text().contains("more than 1000 values"), "{}", reply.text());
    let reply = server.post_bytes("/v1/measure", "application/json", body(101));
    reply.expect(422);
    let fault = &reply.json()["errors"][0];
    assert_eq!(
        (&fault["pointer"], &fault["detail"]),
        (&json!("/shapes"), &json!("expected at most 100 shapes, got 101"))
    );
    // All faults are counted, a hundred are named.
    let server = Setting::fresh().start();
    let reply = server.post_bytes("/v1/measure", "application/json", body(250));
    assert_eq!(reply.expect(422)["errors"].as_array().unwrap().len(), 100);
    assert!(reply.json()["detail"].as_str().unwrap().starts_with("250 errors"), "{}", reply.text());
}

#[test]
fn metadata_are_bounded_and_pages_of_shapes_too() {
    let server = Setting::fresh().flags(&["--max-metadata-bytes", "100000"]).start();
    let cohort = json!({"name": "notes", "representation":
        {"kind": "closed_curve", "dimension": 2, "control_points": 3, "generator": {"name": "cubic"}}});
    server.post("/v1/cohorts", &cohort).expect(201);
    let shape = |k: usize, note: usize| json!({"external_id": format!("s{k}"), "points": [[0, 0], [k + 1, 0], [0, 1]], "metadata": {"note": "n".repeat(note)}});
    let path = "/v1/cohorts/notes/shapes";
    let reply = server.post(path, &json!({"shapes": [shape(0, 10), shape(1, 100_000)]}));
    let fault = reply.expect(422)["errors"][0].clone();
    assert_eq!(fault["pointer"], "/shapes/1/metadata");
    assert!(fault["detail"].as_str().unwrap().contains("at most 100000"), "{fault}");
    let count = 150;
    let lines: Vec<Value> = (0..count).map(|k| shape(k, 90_000)).collect();
    server.post_lines(path, &lines).expect(201);
    let (mut found, mut pages, mut cursor) = (Vec::new(), 0, String::new());
    loop {
        let reply = server.get(&format!("{path}?limit=1000{cursor}"));
        assert!(
            {
                reply.expect(200);
                reply.text().len()
            } < 9 << 20,
            "{} bytes",
            reply.text().len()
        );
        let page = reply.json();
        found.extend(page["items"].as_array().unwrap().iter().map(|item| item["external_id"].clone()));
        pages += 1;
        let Some(next) = page["next"].as_str() else { break };
        cursor = format!("&cursor={next}");
    }
    assert_eq!(found, (0..count).map(|k| json!(format!("s{k}"))).collect::<Vec<_>>());
    assert!(pages > 1);
}

#[test]
fn refusals_repeat_their_input_in_short() {
    let server = Setting::fresh().start();
    let long = "a".repeat(1 << 20);
    let number = f64::MAX * 0.5;
    let curve =
        json!({"kind": "closed_curve", "dimension": 2, "control_points": 4, "generator": {"name": "cubic"}});
    let replies = [
        server.post("/v1/mean", &json!({ "representation": long })),
        server.post("/v1/mean", &json!({"representation": {"kind": long, "dimension": 2}})),
        server.post("/v1/mean", &json!({ "transformation": long })),
        server.post("/v1/mean", &json!({ long.as_str(): 1 })),
        server.post("/v1/mean", &json!({"shapes": [{ long.as_str(): 1 }], "frame": [long]})),
        server.post("/v1/mean", &json!({"shapes": [{"labels": { long.as_str(): [] }}]})),
        server.post("/v1/cohorts", &json!({ "name": long })),
        server.post("/v1/subdivide", &json!({"scheme": "blob", "start": long, "level": 1})),
        server.post(
            "/v1/subdivide",
            &json!({"scheme": "butterfly", "start": "octahedron", "tension": number, "level": 1}),
        ),
        server.post("/v1/evaluate", &json!({"representation": curve, "shapes": [{"points": [[number, 1]]}]})),
        server.get(&format!("/v1/cohorts/{}", "b".repeat(20_000))),
        server.get(&format!("/v1/jobs/{}", "b".repeat(20_000))),
        server.get(&format!("/v1/cohorts?{}=1", "b".repeat(20_000))),
        server.get(&format!("/v1/cohorts?limit={}", "9".repeat(20_000))),
        server.get(&format!("/v1/none/{}", "b".repeat(20_000))),
    ];
    for (i, reply) in replies.iter().enumerate() {
        assert!(reply.status >= 400, "{i}: {}", reply.status);
        let problem = reply.json();
        let short = |text: &Value| text.as_str().unwrap().chars().count() <= 610;
        assert!(short(&problem["detail"]), "{i}: {}", problem["detail"]);
        let digits = problem["detail"].as_str().unwrap().split(|c: char| !c.is_ascii_digit());
        assert!(digits.map(str::len).max().unwrap() <= 40, "{i}: {}", problem["detail"]);
        for fault in problem["errors"].as_array().unwrap() {
            let place = fault["pointer"].as_str().or(fault["parameter"].as_str());
            assert!(short(&fault["detail"]) && place.unwrap().len() <= 210, "{i}: {fault}");
        }
    }
}

/// A request that is answered with some megabytes, on a connection that reads nothing of it.
fn unread(server: &Server, body: &str) -> TcpStream {
    let address = server.address().split_once("://").unwrap().1;
    let mut stream = TcpStream::connect(address).unwrap();
    let length = body.len();
    write!(
        stream,
        "POST /v1/evaluate HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: {length}\r\n\r\n{body}"
    )
    .unwrap();
    stream
}

#[test]
fn answers_that_nobody_reads_are_bounded_together() {
    let answers = 48 << 20;
    let server = Setting::fresh().flags(&["--max-answer-bytes", &answers.to_string()]).start();
    let body = format!(
        "{{{CURVE},\"shapes\":[{{\"points\":[[2,0],[0,1.5],[-2.25,0],[0,-1]]}}],\"samples\":500000}}"
    );
    let one = server.post_bytes("/v1/evaluate", "application/json", body.clone()).text().len();
    assert!((16 << 20..24 << 20).contains(&one), "{one} bytes");
    let mut streams = Vec::new();
    let taken = growth(&server, || {
        // One after the other: what is measured is what stays, not what is computed at once.
        streams = (0..12)
            .map(|_| {
                let stream = unread(&server, &body);
                let mut head = [0; 12];
                stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
                (&stream).read_exact(&mut head).unwrap();
                (stream, String::from_utf8(head.to_vec()).unwrap())
            })
            .collect();
    });
    let refused = streams.iter().filter(|(_, head)| head.ends_with("503")).count();
    // A connection of this machine takes some megabytes before anybody reads: less than an answer.
    assert!(refused >= 12 - answers / one - 2, "{refused} of 12 were refused");
    assert!(taken < answers + 8 * one, "{} MB were taken", taken >> 20);
    // Who goes away gives back what was held.
    drop(streams);
    let deadline = Instant::now() + Duration::from_secs(30);
    while server.post_bytes("/v1/evaluate", "application/json", body.clone()).status != 200 {
        assert!(Instant::now() < deadline, "the memory of answers was not given back");
        std::thread::sleep(Duration::from_millis(50));
    }
}

#[test]
fn what_would_pass_the_memory_of_the_process_is_refused() {
    // Less than the program takes when it has started: nothing large fits, what is small goes on.
    let server = Setting::fresh().flags(&["--max-memory", "16000000"]).start();
    std::thread::sleep(Duration::from_millis(300));
    let large = repeated("{\"shapes\":[", "{\"points\":[[0,0],[1,0],[0,1]]}", "]}");
    let reply = server.post_bytes("/v1/mean", "application/json", large);
    reply.expect(503);
    assert_eq!(reply.json()["code"], "overloaded");
    let few = json!({"count": 5, "shapes": [{"points": [[0, 0], [3, 0], [0, 1]]}]});
    server.post("/v1/resample", &few).expect(200);
    server.assert_alive();
}
