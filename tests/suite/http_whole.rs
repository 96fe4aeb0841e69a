//! Answers arrive whole: for clients that take them compressed, that read late, or that read slowly.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::time::Duration;

use flate2::read::GzDecoder;
use reqwest::Method;
use reqwest::header::{ACCEPT_ENCODING, CONTENT_TYPE};
use serde_json::json;

use crate::memory::growth;
use crate::server::{Server, Setting};

/// Shapes as lines, so many that their files are longer than what an answer holds before it is sent.
pub(crate) fn lines(count: usize) -> String {
    (0..count)
        .map(|k| format!("{{\"points\":[[0,0],[5,1],[1,3],[2,{k}.25]],\"label\":\"a{k}\"}}\n"))
        .collect()
}

pub(crate) fn unpacked(bytes: &[u8]) -> Vec<u8> {
    let mut text = Vec::new();
    GzDecoder::new(bytes).read_to_end(&mut text).unwrap();
    text
}

#[test]
fn streamed_answers_arrive_whole_in_gzip_too() {
    let server = Server::fresh();
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 4});
    server.post("/v1/cohorts", &json!({"name": "large", "representation": representation})).expect(201);
    let text = lines(40_000);
    server.post_bytes("/v1/cohorts/large/shapes", "application/x-ndjson", text.clone()).expect(201);
    let mut routes: Vec<(Method, String, &str, String)> =
        ["ndjson", "csv", "geojson", "parquet", "arrow", "npy", "npz", "tps"]
            .iter()
            .map(|format| {
                (Method::GET, format!("/v1/cohorts/large/export?format={format}"), "", String::new())
            })
            .collect();
    for format in ["ndjson", "csv", "geojson"] {
        let path = format!("/v1/convert?format=ndjson&to={format}");
        routes.push((Method::POST, path, "application/octet-stream", text.clone()));
    }
    for format in ["csv", "ndjson", "json", "parquet", "arrow"] {
        routes.push((Method::GET, format!("/v1/cohorts/large/table?format={format}"), "", String::new()));
    }
    for (method, path, media_type, body) in routes {
        let send = |coding: &str| {
            let mut request = server.request(method.clone(), &path).header(ACCEPT_ENCODING, coding);
            if method == Method::POST {
                request = request.header(CONTENT_TYPE, media_type).body(body.clone());
            }
            server.send(request)
        };
        let plain = send("identity");
        assert_eq!(plain.status, 200, "{path}: {}", String::from_utf8_lossy(&plain.body));
        let packed = send("gzip");
        assert_eq!(packed.header("content-encoding"), Some("gzip"), "{path}");
        assert_eq!(unpacked(&packed.body).len(), plain.body.len(), "{path}");
    }
    server.assert_alive();
}

/// The content of a chunked answer that has ended.
pub(crate) fn content(answer: &str) -> String {
    let (_, mut chunks) = answer.split_once("\r\n\r\n").unwrap();
    let mut text = String::new();
    loop {
        let (length, rest) = chunks.split_once("\r\n").unwrap();
        let length = usize::from_str_radix(length, 16).unwrap();
        if length == 0 {
            return text;
        }
        text.push_str(&rest[..length]);
        chunks = &rest[length + 2..];
    }
}

/// Sends a whole request before it reads, as many clients do, and gives the answer.
fn send_first(server: &Server, path: &str, body: &str) -> String {
    let address = server.address().trim_start_matches("http://");
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_write_timeout(Some(Duration::from_secs(60))).unwrap();
    let head = format!(
        "POST {path} HTTP/1.1\r\nhost: {address}\r\ncontent-type: application/octet-stream\r\nconnection: close\r\n\
         content-length: {}\r\n\r\n",
        body.len()
    );
    stream.write_all(head.as_bytes()).unwrap();
    stream.write_all(body.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    answer
}

#[test]
fn a_client_that_sends_before_it_reads_gets_a_whole_conversion() {
    // A client that does not take its answer would be cut off after two seconds.
    let server = Setting::fresh().flags(&["--reader-seconds", "2"]).start();
    let count = 350_000;
    let answer = send_first(&server, "/v1/convert?format=ndjson&to=ndjson", &lines(count));
    assert!(answer.starts_with("HTTP/1.1 200 "), "{}", &answer[..200.min(answer.len())]);
    assert_eq!(content(&answer).matches("\"points\"").count(), count);
    server.assert_alive();
}

/// A chunk of PNG with its length and its sum.
pub(crate) fn chunk(name: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let mut sum = flate2::Crc::new();
    sum.update(name);
    sum.update(data);
    let length = u32::try_from(data.len()).unwrap().to_be_bytes();
    [&length[..], name, data, &sum.sum().to_be_bytes()].concat()
}

/// A PNG of one bit a cell, all zero: some hundred bytes for each million of cells.
fn empty_picture(side: u32) -> Vec<u8> {
    let header = [&side.to_be_bytes()[..], &side.to_be_bytes(), &[1, 0, 0, 0, 0]].concat();
    let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    let row = vec![0; 1 + side.div_ceil(8) as usize];
    (0..side).for_each(|_| packed.write_all(&row).unwrap());
    let rows = packed.finish().unwrap();
    [b"\x89PNG\r\n\x1a\n".to_vec(), chunk(b"IHDR", &header), chunk(b"IDAT", &rows), chunk(b"IEND", b"")]
        .concat()
}

/// The account is asked by the header of an image, on every route that reads one.
#[test]
fn an_image_that_does_not_fit_in_memory_is_refused_before_it_is_decoded() {
    let server = Setting::fresh().flags(&["--max-memory", "1000000000"]).start();
    let representation =
        json!({"kind": "closed_curve", "dimension": 2, "control_points": 8, "generator": {"name": "cubic"}});
    let cohort = json!({"name": "images", "representation": representation, "correspondence": "arc_length"});
    server.post("/v1/cohorts", &cohort).expect(201);
    let (large, small) = (empty_picture(8000), empty_picture(64));
    for path in ["/v1/inspect", "/v1/convert?to=ndjson", "/v1/cohorts/images/shapes"] {
        let mut refused = None;
        let taken = growth(&server, || refused = Some(server.post_bytes(path, "image/png", large.clone())));
        assert!(taken < 100 << 20, "{path}: {} MiB", taken >> 20);
        let reply = refused.unwrap();
        assert!([413, 422, 503].contains(&reply.status), "{path}: {} {}", reply.status, reply.text());
        assert!(reply.text().contains("memory"), "{path}: {}", reply.text());
        let reply = server.post_bytes(path, "image/png", small.clone());
        assert!(
            [200, 422].contains(&reply.status) && !reply.text().contains("memory"),
            "{path}: {}",
            reply.text()
        );
    }
}

/// Eight requests of two hundred bytes each, compressed twice, ended a process with an address space of 6 GiB.
#[test]
fn images_at_once_do_not_end_the_process() {
    let server = Setting::fresh().flags(&["--max-memory", "2147483648"]).address_space(6 << 10).start();
    let picture = empty_picture(11_585);
    for path in ["/v1/inspect", "/v1/convert?to=ndjson"] {
        let statuses: Vec<u16> = std::thread::scope(|scope| {
            let send = || server.post_bytes(path, "image/png", picture.clone()).status;
            let threads: Vec<_> = (0..8).map(|_| scope.spawn(send)).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        assert!(statuses.iter().all(|status| [200, 413, 422, 503].contains(status)), "{path}: {statuses:?}");
    }
    server.assert_alive();
}
