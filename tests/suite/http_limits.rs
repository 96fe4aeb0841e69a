//! The edge of the service: connections, certificates, and what holds when there is too much.

use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::process::Command;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use flate2::Compression;
use flate2::write::GzEncoder;
use reqwest::Method;
use reqwest::header::{CONTENT_ENCODING, CONTENT_TYPE};
use serde_json::{Value, json};

use crate::http_access::{create_key, key_command};
use crate::server::{Server, Setting, wait};

const SOON: Duration = Duration::from_secs(30);

pub(crate) fn address(server: &Server) -> &str {
    server.address().split_once("://").unwrap().1
}

pub(crate) fn connect(server: &Server) -> TcpStream {
    let stream = TcpStream::connect(address(server)).unwrap();
    stream.set_read_timeout(Some(SOON)).unwrap();
    stream
}

/// Everything until the other side closes, which must be soon.
pub(crate) fn rest(stream: &mut TcpStream) -> Vec<u8> {
    let (mut bytes, mut buffer) = (Vec::new(), [0; 65_536]);
    loop {
        match stream.read(&mut buffer) {
            Ok(0) => return bytes,
            Ok(count) => bytes.extend_from_slice(&buffer[..count]),
            Err(error) if error.kind() == ErrorKind::ConnectionReset => return bytes,
            Err(error) => panic!("{error} after {} bytes", bytes.len()),
        }
    }
}

/// The status of the next answer, and the bytes that came with it.
pub(crate) fn answer(stream: &mut TcpStream) -> (u16, String) {
    let (mut text, mut buffer) = (String::new(), [0; 65_536]);
    while !text.contains("\r\n\r\n") {
        let count = stream.read(&mut buffer).unwrap();
        assert!(count > 0, "closed after {text:?}");
        text.push_str(std::str::from_utf8(&buffer[..count]).unwrap());
    }
    (text.split(' ').nth(1).unwrap().parse().unwrap(), text)
}

pub(crate) fn send(stream: &mut TcpStream, text: &str) {
    stream.write_all(text.as_bytes()).unwrap();
}

/// A closed curve of `count` points.
fn contour(k: usize, count: usize) -> Value {
    let point = |i: usize| {
        let t = std::f64::consts::TAU * i as f64 / count as f64;
        let radius = 1.0 + 0.2 * ((2 + k % 5) as f64 * t).cos() + 0.001 * k as f64;
        json!([radius * t.cos(), 0.7 * radius * t.sin()])
    };
    json!({"points": (0..count).map(point).collect::<Vec<_>>()})
}

fn curves(size: usize) -> Value {
    json!({"kind": "closed_curve", "dimension": 2, "control_points": size, "generator": {"name": "trigonometric"}})
}

/// The distances of so many shapes of this size.
fn distances(shapes: usize, size: usize) -> Value {
    let shapes: Vec<Value> = (0..shapes).map(|k| contour(k, 65)).collect();
    json!({"representation": curves(size),
        "correspondence": "cyclic", "transformation": "similarity", "shapes": shapes})
}

/// A mean, for which there is no place beside a heavy request: start points are searched for.
fn mean() -> Value {
    let shapes: Vec<Value> = (0..120).map(|k| contour(k, 65)).collect();
    json!({"representation": curves(128), "correspondence": "cyclic",
        "transformation": "similarity", "shapes": shapes})
}

/// Lengths and areas of few shapes, which are light.
pub(crate) fn measure() -> Value {
    let shapes: Vec<Value> = (0..3).map(|k| contour(k, 9)).collect();
    json!({"representation": curves(9), "shapes": shapes})
}

/// Repeats until it holds.
pub(crate) fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let begin = Instant::now();
    while !holds() {
        assert!(begin.elapsed() < SOON, "{what}: not in time");
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn a_caller_has_half_of_the_connections() {
    let server = Setting::fresh().flags(&["--max-connections", "4"]).start();
    let [first, second] = ["reader", "reader"].map(|role| create_key(&server, &["--role", role]));
    let of = |key: &str, path: &str| server.request(Method::GET, path).bearer_auth(key);
    let stream = || wait(async { of(&first, "/v1/events").send().await }).unwrap();
    let held = [stream(), stream()];
    assert_eq!(held.each_ref().map(|one| one.status().as_u16()), [200, 200]);
    server.send(of(&first, "/v1/cohorts")).expect_problem(503, "overloaded", &[]);
    server.send(of(&second, "/v1/cohorts")).expect(200);
    assert_eq!(server.get("/livez").status, 204);
    drop(held);
    until("the places are free", || server.send(of(&first, "/v1/cohorts")).status == 200);
}

#[test]
fn connections_without_a_request_do_not_last() {
    let server = Setting::fresh().flags(&["--first-request-seconds", "1", "--idle-seconds", "3"]).start();
    let begin = Instant::now();
    let mut silent = connect(&server);
    let mut slow = connect(&server);
    send(&mut slow, "GET /livez HTTP/1.1\r\nhost: localhost\r\nx-slow: ");
    let mut served = connect(&server);
    send(&mut served, "GET /livez HTTP/1.1\r\nhost: localhost\r\n\r\n");
    assert_eq!(answer(&mut served).0, 204);
    let trickle = std::thread::spawn(move || {
        // A head that never ends is no request.
        while slow.write_all(b"x").is_ok() {
            std::thread::sleep(Duration::from_millis(50));
        }
        begin.elapsed()
    });
    assert_eq!(rest(&mut silent), b"");
    let silence = begin.elapsed();
    assert!((900..3000).contains(&silence.as_millis()), "{silence:?}");
    let trickled = trickle.join().unwrap();
    assert!(trickled < Duration::from_secs(3), "{trickled:?}");
    send(&mut served, "GET /livez HTTP/1.1\r\nhost: localhost\r\n\r\n");
    assert_eq!(answer(&mut served).0, 204, "one that was of use has more time");
    let begin = Instant::now();
    assert_eq!(rest(&mut served), b"");
    assert!((2500..9000).contains(&begin.elapsed().as_millis()), "{:?}", begin.elapsed());
    server.assert_alive();
}

#[test]
fn heads_are_bounded_in_count_and_in_bytes() {
    let server = Setting::fresh().flags(&["--max-head-bytes", "16384"]).start();
    let lines = |count: usize, length: usize| -> String {
        (0..count).map(|i| format!("x-{i}: {}\r\n", "y".repeat(length))).collect()
    };
    for (what, head, status) in [
        ("few and short", lines(50, 100), 204),
        ("many", lines(101, 1), 431),
        ("long", lines(1, 20_000), 431),
        ("long together", lines(60, 400), 431),
    ] {
        let mut stream = connect(&server);
        send(&mut stream, &format!("GET /livez HTTP/1.1\r\nhost: localhost\r\n{head}\r\n"));
        assert_eq!(answer(&mut stream).0, status, "{what}");
    }
    let mut endless = connect(&server);
    send(&mut endless, "GET /livez HTTP/1.1\r\nx-endless: ");
    let begin = Instant::now();
    while endless.write_all(&[b'x'; 4096]).is_ok() {
        assert!(begin.elapsed() < SOON);
    }
    server.assert_alive();
}

/// How many files this process may have open.
fn open_files() -> usize {
    let limits = std::fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let line = limits.lines().find(|line| line.starts_with("Max open files")).unwrap_or_default();
    line.split_whitespace().nth(3).and_then(|most| most.parse().ok()).unwrap_or(1024)
}

#[test]
fn ten_thousand_connections_do_not_keep_others_out() {
    let count = 10_000.min(open_files().saturating_sub(600));
    let server = Setting::fresh().flags(&["--max-connections", "500"]).start();
    let mut useful = connect(&server);
    let mut streams = Vec::with_capacity(count);
    for i in 0..count {
        streams.push(connect(&server));
        if i % 1000 == 0 {
            let mut fresh = connect(&server);
            send(&mut fresh, "GET /livez HTTP/1.1\r\nhost: localhost\r\n\r\n");
            assert_eq!(answer(&mut fresh).0, 204, "beside {i} connections");
        }
    }
    let begin = Instant::now();
    server.assert_alive();
    assert!(begin.elapsed() < Duration::from_secs(5), "{:?} beside {count}", begin.elapsed());
    assert_eq!(rest(&mut useful), b"", "the longest idle one went first");
    let last = streams.last_mut().unwrap();
    send(last, "GET /livez HTTP/1.1\r\nhost: localhost\r\n\r\n");
    assert_eq!(answer(last).0, 204, "the last to come is served");
}

#[test]
fn a_client_that_does_not_send_gives_its_place() {
    let server = Setting::fresh().flags(&["--max-connections", "2"]).start();
    let head = "POST /v1/measure HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: 2\r\n\r\n{";
    let mut slow = [connect(&server), connect(&server)];
    for stream in &mut slow {
        send(stream, head);
        std::thread::sleep(Duration::from_millis(500));
    }
    let mut third = connect(&server);
    send(&mut third, "GET /livez HTTP/1.1\r\nhost: localhost\r\n\r\n");
    assert_eq!(answer(&mut third).0, 204);
    let [mut first, mut second] = slow;
    assert_eq!(rest(&mut first), b"", "the one that had waited for longest");
    send(&mut second, "}");
    assert_eq!(answer(&mut second).0, 422, "the other goes on");
}

#[test]
fn when_the_service_is_at_work_for_every_connection_a_new_one_is_closed_at_once() {
    let flags = ["--max-connections", "2", "--threads", "1", "--max-matrix-operations", "1000000000000"];
    let server = Setting::fresh().flags(&flags).start();
    let (body, head) =
        (distances(300, 513).to_string(), "POST /v1/distances HTTP/1.1\r\nhost: localhost\r\n");
    let ask = || {
        let mut stream = connect(&server);
        let length = body.len();
        send(
            &mut stream,
            &format!("{head}content-type: application/json\r\ncontent-length: {length}\r\n\r\n{body}"),
        );
        stream
    };
    let mut busy = [ask(), ask()];
    until("a connection is closed", || {
        // One that was still being read has given its place to the next.
        busy.iter_mut().filter(|stream| is_answered(stream)).for_each(|stream| *stream = ask());
        std::thread::sleep(Duration::from_millis(200));
        let mut third = connect(&server);
        third.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
        let closed = match third.read(&mut [0]) {
            Ok(count) => count == 0,
            Err(error) => error.kind() == ErrorKind::ConnectionReset,
        };
        closed && !busy.iter().any(is_answered)
    });
    drop(busy);
    until("a new connection is served", || {
        let mut fresh = connect(&server);
        // It may be closed already.
        let _ = fresh.write_all(b"GET /livez HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n");
        rest(&mut fresh).starts_with(b"HTTP/1.1 204")
    });
}

#[test]
fn a_client_that_does_not_read_is_dropped() {
    let server = Setting::fresh().flags(&["--reader-seconds", "1"]).start();
    let mut body = measure();
    body.as_object_mut().unwrap().insert("samples".into(), json!(170_000));
    let body = body.to_string();
    let length = body.len();
    let request = format!(
        "POST /v1/evaluate HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: {length}\r\n\r\n{body}"
    );
    let whole = {
        let mut stream = connect(&server);
        send(&mut stream, &request.replace("host: localhost", "host: localhost\r\nconnection: close"));
        rest(&mut stream).len()
    };
    assert!(whole > 16 << 20, "{whole} bytes are too few for this test");
    let mut stream = connect(&server);
    send(&mut stream, &request);
    assert_eq!(answer(&mut stream).0, 200);
    std::thread::sleep(Duration::from_secs(4));
    let read = rest(&mut stream).len();
    assert!(read < whole - (1 << 20), "{read} of {whole} bytes came after the pause");
    server.assert_alive();
}

#[test]
fn bodies_are_refused_by_their_length_before_they_are_read() {
    let server = Setting::fresh().flags(&["--max-body-bytes", "100000"]).start();
    let head = "POST /v1/mean HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: 100001\r\n";
    let mut asking = connect(&server);
    let begin = Instant::now();
    send(&mut asking, &format!("{head}expect: 100-continue\r\n\r\n"));
    let (status, text) = answer(&mut asking);
    assert!(status == 413 && text.contains("100000 bytes"), "{text}");
    assert!(begin.elapsed() < Duration::from_secs(1), "{:?}", begin.elapsed());
    let mut silent = connect(&server);
    send(&mut silent, &format!("{head}\r\n"));
    assert_eq!(answer(&mut silent).0, 413, "also when nothing of it is sent");

    // Packed bytes that unpack to nothing are bytes, too.
    let mut packed = vec![0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 255];
    packed.extend([0, 0, 0, 255, 255].repeat(100_000));
    let pieces: Vec<Result<Vec<u8>, std::io::Error>> =
        packed.chunks(10_000).map(|c| Ok(c.to_vec())).collect();
    let body = reqwest::Body::wrap_stream(futures_util::stream::iter(pieces));
    let request = server.request(Method::POST, "/v1/mean").header(CONTENT_TYPE, "application/json");
    let reply = server.send(request.header(CONTENT_ENCODING, "gzip").body(body));
    reply.expect_problem(413, "payload-too-large", &[]);
    server.assert_alive();
}

#[test]
fn the_bodies_of_all_requests_have_a_common_bound() {
    let server =
        Setting::fresh().flags(&["--max-body-bytes", "1000000", "--max-buffered-bytes", "1000000"]).start();
    let head = "POST /v1/mean HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\ncontent-length: 900001\r\n\r\n";
    let hold = || {
        let mut stream = connect(&server);
        send(&mut stream, &format!("{head}{}", " ".repeat(900_000)));
        stream
    };
    let (mut holding, large) = (hold(), " ".repeat(500_000));
    until("the memory is full", || {
        std::thread::sleep(Duration::from_millis(200));
        let reply = server.post_bytes("/v1/mean", "application/json", large.as_str());
        if reply.status == 503 {
            reply.expect_problem(503, "overloaded", &[]);
            assert!(reply.header("retry-after").is_some());
            return true;
        }
        // It came first, and there was no room for the other.
        holding = hold();
        false
    });
    server.post("/v1/measure", &measure()).expect(200);
    drop(holding);
    until("the memory is free", || {
        server.post_bytes("/v1/mean", "application/json", large.as_str()).status == 400
    });
}

#[test]
fn compressed_files_are_charged_for_what_they_hold() {
    let server =
        Setting::fresh().flags(&["--max-body-bytes", "8000000", "--max-buffered-bytes", "40000000"]).start();
    let file = |spaces: usize| {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
        encoder.write_all(b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n").unwrap();
        encoder.write_all(&vec![b' '; spaces]).unwrap();
        encoder.finish().unwrap()
    };
    let inspect = |spaces: usize| server.post_bytes("/v1/inspect", "model/off", file(spaces));
    assert_eq!(inspect(1_000_000).expect(200)["records"], 1);
    // A few kilobytes arrive, but a file and what is made of it take 30 MB.
    inspect(7_500_000).expect_problem(503, "overloaded", &[]);
    assert_eq!(inspect(1_000_000).expect(200)["records"], 1);
}

#[test]
fn callers_that_ask_too_often_are_told_when_to_come_back() {
    let server = Setting::fresh().flags(&["--rate-per-second", "1", "--rate-burst", "5"]).start();
    let statuses: Vec<u16> = (0..10).map(|_| server.get("/v1/generators").status).collect();
    assert!(statuses[..5].iter().all(|status| *status == 200), "{statuses:?}");
    assert!(statuses[5..].contains(&429), "{statuses:?}");
    until("one too many", || server.get("/v1/generators").status == 429);
    let refused = server.get("/v1/generators");
    if refused.status == 429 {
        refused.expect_problem(429, "too-many-requests", &[]);
        assert_eq!(refused.header("retry-after"), Some("1"));
    }
    for _ in 0..20 {
        assert_eq!(server.get("/livez").status, 204, "probes are not counted");
    }
    std::thread::sleep(Duration::from_millis(2100));
    server.get("/v1/generators").expect(200);
}

#[test]
fn who_has_no_key_is_slowed_down_and_fills_neither_trail_nor_log() {
    let flags = ["--refusals-per-minute", "20"];
    let server = Setting::fresh().flags(&flags).environment("SHAPELEX_LOG", "info").start();
    let secret = crate::http_access::create_key(&server, &["--role", "reader"]);
    let with = |secret: &str, path: &str| {
        server.send(server.request(reqwest::Method::GET, path).bearer_auth(secret))
    };
    until("the key is known", || with("shk_wrong", "/v1/cohorts").status == 401);
    let statuses: Vec<u16> = (0..200).map(|_| with("shk_wrong", "/v1/cohorts").status).collect();
    let told = statuses.iter().filter(|status| **status == 401).count();
    // The allowance grows by one in three seconds meanwhile.
    assert!(told <= 20 + 20 && statuses.iter().all(|status| [401, 429].contains(status)), "{statuses:?}");
    let refused = with("shk_wrong", "/v1/cohorts");
    refused.expect_problem(429, "too-many-requests", &[]);
    assert!(refused.header("retry-after").is_some());
    for _ in 0..100 {
        // The limit applies neither to callers with a key nor to addresses that do not exist.
        with(&secret, "/v1/cohorts").expect(200);
        with("shk_wrong", "/v1/nothing-here").expect(404);
        with("shk_wrong", "/nothing-here").expect(404);
    }
    let log = server.log();
    let lines = |word: &str| log.lines().filter(|line| line.contains(word)).count();
    assert!(lines("a credential was refused") <= 10, "{log}");
    assert!(lines("\"route\":\"unmatched\"") <= 10, "{log}");
    let setting = server.terminate();
    let export = setting.command("export").arg("-").output().unwrap();
    let export = String::from_utf8(export.stdout).unwrap();
    let rows = export.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok());
    let of_nobody: Vec<Value> = rows.filter(|row| row[0] == "audit" && row[1] == "").collect();
    // The first of a minute and all of it: the test may run over the end of one, or of two.
    assert!((2..=6).contains(&of_nobody.len()), "{of_nobody:?}");
    // Behind the name of the table, the ninth column.
    let count = |row: &Value| {
        let objects: Value = serde_json::from_str(row[9].as_str().unwrap()).unwrap();
        objects["count"].as_str().map_or(0, |count| count.parse::<usize>().unwrap())
    };
    assert!(of_nobody.iter().map(count).sum::<usize>() >= 400, "{of_nobody:?}");
}

/// Sends a heavy request and waits until it computes; it is given up when what is returned is dropped.
const ONE_HEAVY: [&str; 8] = [
    "--max-heavy-requests",
    "1",
    "--threads",
    "1",
    "--max-matrix-operations",
    "1000000000000",
    "--max-request-seconds",
    "100000",
];

fn occupied(server: &Server) -> TcpStream {
    // Many seconds of work on one thread, also when it is optimised.
    let body = distances(2000, 1024).to_string();
    let head = "POST /v1/distances HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n";
    let ask = || {
        let mut stream = connect(server);
        send(&mut stream, &format!("{head}content-length: {}\r\n\r\n{body}", body.len()));
        stream
    };
    let mut stream = ask();
    until("the lane is full", || {
        if is_answered(&stream) {
            // A request of this loop had the place when it came.
            stream = ask();
        }
        let reply = server.post("/v1/mean", &mean());
        if reply.status == 503 {
            reply.expect_problem(503, "overloaded", &[]);
            assert!(reply.header("retry-after").is_some());
        }
        reply.status == 503 && !is_answered(&stream)
    });
    stream
}

fn is_answered(stream: &TcpStream) -> bool {
    stream.set_nonblocking(true).unwrap();
    let waits = stream.peek(&mut [0]).is_err_and(|error| error.kind() == ErrorKind::WouldBlock);
    stream.set_nonblocking(false).unwrap();
    !waits
}

#[test]
fn light_requests_pass_heavy_ones_and_what_nobody_waits_for_is_not_computed() {
    let server = Setting::fresh().flags(&ONE_HEAVY).start();
    let stream = occupied(&server);
    for _ in 0..20 {
        let begin = Instant::now();
        server.post("/v1/measure", &measure()).expect(200);
        assert!(begin.elapsed() < Duration::from_secs(2), "{:?}", begin.elapsed());
    }
    // Still at it: the time it takes must be longer than that in which it is given up below.
    let begin = Instant::now();
    while begin.elapsed() < Duration::from_secs(2) {
        assert_eq!(
            server.post("/v1/mean", &mean()).status,
            503,
            "the heavy request ended after {:?}",
            begin.elapsed()
        );
    }
    assert!(!is_answered(&stream));
    drop(stream);
    let begin = Instant::now();
    until("the lane is free", || server.post("/v1/mean", &mean()).status == 200);
    // The mean itself, on a busy machine; the matrix would go on for many times as long.
    assert!(begin.elapsed() < Duration::from_secs(6), "{:?}", begin.elapsed());
}

#[test]
fn a_request_that_takes_too_long_is_given_up() {
    let server = Setting::fresh().flags(&ONE_HEAVY).flags(&["--compute-seconds", "5"]).start();
    let mut stream = occupied(&server);
    let (status, text) = answer(&mut stream);
    assert!(status == 503 && text.contains("took-too-long"), "{text}");
    until("the lane is free", || server.post("/v1/mean", &mean()).status == 200);
}

fn signal(server: &Server, name: &str) {
    // A shell has it built in; a machine without procps has no program of that name.
    let sent =
        Command::new("sh").args(["-c", "kill $0 $1", name, &server.id().to_string()]).status().unwrap();
    assert!(sent.success());
}

/// Waits until the service asks for the body of a request that expects this: the request has begun.
fn has_begun(asked: &mut TcpStream) {
    let mut begun = [0; 25];
    asked.read_exact(&mut begun).unwrap();
    assert_eq!(&begun, b"HTTP/1.1 100 Continue\r\n\r\n");
}

#[test]
fn a_stop_answers_what_was_asked_and_takes_nothing_new() {
    let server = Setting::fresh().start();
    let mut idle = connect(&server);
    let mut asked = connect(&server);
    let body = measure().to_string();
    let head = "POST /v1/measure HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n";
    send(&mut asked, &format!("{head}expect: 100-continue\r\ncontent-length: {}\r\n\r\n", body.len()));
    has_begun(&mut asked);
    signal(&server, "-TERM");
    assert_eq!(rest(&mut idle), b"");
    // Probes are answered while the last answers go out, everything else is refused.
    until("the probe fails", || server.get("/readyz").status == 503);
    server.get("/readyz").expect_problem(503, "unavailable", &[]);
    assert_eq!(server.get("/livez").status, 204);
    server.get("/v1/generators").expect_problem(503, "unavailable", &[]);
    send(&mut asked, &body);
    let (status, text) = answer(&mut asked);
    assert_eq!(status, 200, "{text}");
    let begin = Instant::now();
    assert!(server.ended().success());
    assert!(begin.elapsed() < Duration::from_secs(5), "{:?}", begin.elapsed());
}

#[test]
fn an_upload_hears_of_a_stop() {
    let server = Setting::fresh().start();
    let cohort = json!({"name": "hands", "representation": curves(9)});
    server.post("/v1/cohorts", &cohort).expect(201);
    let mut upload = connect(&server);
    let line = contour(1, 9).to_string() + "\n";
    let head =
        "POST /v1/cohorts/hands/shapes HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/x-ndjson\r\n";
    send(&mut upload, &format!("{head}expect: 100-continue\r\ntransfer-encoding: chunked\r\n\r\n"));
    has_begun(&mut upload);
    send(&mut upload, &format!("{:x}\r\n{line}\r\n", line.len()));
    let begin = Instant::now();
    signal(&server, "-TERM");
    let (status, text) = answer(&mut upload);
    assert!(status == 503 && text.contains("unavailable"), "{text}");
    drop(upload);
    assert!(server.ended().success());
    // It waited for the rest of the upload, 5 s, and not until requests are cut off, 20 s.
    assert!(begin.elapsed() < Duration::from_secs(15), "{:?}", begin.elapsed());
}

/// A key of a tenant.
fn key_of(server: &Server, tenant: &str) -> String {
    let made = key_command(server, &["create", "--name", tenant, "--role", "reader", "--tenant", tenant]);
    let text = String::from_utf8(made.stdout).unwrap();
    text.split_whitespace().find(|word| word.starts_with("shk_")).unwrap().to_owned()
}

#[test]
fn heavy_requests_of_one_tenant_do_not_hold_up_another() {
    // Two places in all: less than what one tenant asks for.
    let flags = ["--threads", "1", "--max-heavy-requests", "2", "--max-request-seconds", "1000"];
    let server = Setting::fresh().flags(&flags).start();
    let keys = ["a", "b"].map(|tenant| key_of(&server, tenant));
    let post = |key: &str, path: &str, body: &Value| {
        server.send(server.request(Method::POST, path).bearer_auth(key).json(body))
    };
    let heavy =
        json!({"representation": curves(192), "shapes": [contour(1, 192)], "reference": contour(2, 192)});
    let tiny = json!({"representation": curves(9), "transformation": "similarity",
        "reference": contour(1, 9), "shapes": [contour(2, 9)]});
    let (stop, done) = (AtomicBool::new(false), AtomicUsize::new(0));
    std::thread::scope(|scope| {
        for _ in 0..12 {
            scope.spawn(|| {
                while !stop.load(Ordering::Relaxed) {
                    let status = post(&keys[0], "/v1/measure", &heavy).status;
                    assert!([200, 503].contains(&status), "{status}");
                    done.fetch_add(1, Ordering::Relaxed);
                }
            });
        }
        until("tenant a is turned away", || done.load(Ordering::Relaxed) > 2);
        for _ in 0..40 {
            post(&keys[1], "/v1/project", &tiny).expect(200);
        }
        for _ in 0..2 {
            post(&keys[1], "/v1/measure", &heavy).expect(200);
        }
        stop.store(true, Ordering::Relaxed);
    });
}

/// A certificate for this machine with its key, both as PEM.
pub(crate) fn certificate() -> (String, String) {
    let made = rcgen::generate_simple_self_signed(["127.0.0.1".to_owned()]).unwrap();
    (made.cert.pem(), made.signing_key.serialize_pem())
}

/// Asks by a new connection that trusts this certificate alone.
fn asks(server: &Server, certificate: &str) -> bool {
    let root = reqwest::Certificate::from_pem(certificate.as_bytes()).unwrap();
    let client = reqwest::Client::builder().no_proxy().tls_certs_only([root]).build().unwrap();
    let url = format!("{}/livez", server.address());
    wait(async {
        client.get(url).send().await.is_ok_and(|response| {
            // A client that came by TLS is redirected to TLS.
            assert_eq!(response.headers()["strict-transport-security"], "max-age=31536000");
            response.status() == 204
        })
    })
}

#[test]
fn certificates_are_replaced_while_the_service_runs() {
    let folder = tempfile::tempdir().unwrap();
    let [chain, key] = ["chain.pem", "key.pem"].map(|name| folder.path().join(name));
    let [first, second, third] = [certificate(), certificate(), certificate()];
    let write = |certificate: &str, of_key: &str| {
        std::fs::write(&chain, certificate).unwrap();
        std::fs::write(&key, of_key).unwrap();
    };
    write(&first.0, &first.1);
    let [chain_flag, key_flag] = [&chain, &key].map(|path| path.to_str().unwrap().to_owned());
    let flags = ["--tls-cert", &chain_flag, "--tls-key", &key_flag, "--first-request-seconds", "2"];
    let server = Setting::fresh().flags(&flags).start();
    assert!(server.address().starts_with("https://"), "{}", server.address());
    let mut silent = connect(&server);
    assert!(asks(&server, &first.0) && !asks(&server, &second.0));
    // A pair that does not belong together is not taken.
    write(&second.0, &first.1);
    until("the log says so", || server.log().contains("the old one stays"));
    assert!(asks(&server, &first.0) && !asks(&server, &second.0));
    write(&second.0, &second.1);
    until("the files are looked at", || asks(&server, &second.0));
    assert!(!asks(&server, &first.0));
    write(&third.0, &third.1);
    signal(&server, "-HUP");
    until("the signal is heard", || asks(&server, &third.0));
    assert_eq!(rest(&mut silent), b"", "a handshake that does not begin is given up");
    let mut plain = connect(&server);
    send(&mut plain, "GET /livez HTTP/1.1\r\nhost: localhost\r\n\r\n");
    assert!(!rest(&mut plain).starts_with(b"HTTP"), "nothing is answered without TLS");
}
