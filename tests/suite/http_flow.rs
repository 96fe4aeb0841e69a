//! Answers arrive whole at the pace of the client, over HTTP/1.1 and HTTP/2, with and without TLS: clients that read slowly, that
//! send before they read, and that stop reading.

use std::io::{Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::time::{Duration, Instant};

use bytes::Bytes;
use h2::client::SendRequest;
use h2::{RecvStream, SendStream};
use reqwest::Method;
use serde_json::{Value, json};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio_rustls::TlsConnector;
use tokio_rustls::rustls::pki_types::pem::PemObject;
use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

use crate::http_access::create_key;
use crate::http_limits::{address, answer, certificate, connect, measure, rest, send, until};
use crate::http_whole::{content, lines, unpacked};
use crate::server::{Server, Setting, wait};

/// Bytes that a client takes of a stream before it says that it has read them: the least that HTTP/2 begins with.
const WINDOW: u32 = 65_535;
const NDJSON: &str = "application/x-ndjson";

type Sending = SendRequest<Bytes>;

/// Speaks HTTP/2 over a connection, with a window for each stream.
async fn spoken<S>(stream: S) -> Sending
where
    S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
{
    let (sending, connection) =
        h2::client::Builder::new().initial_window_size(WINDOW).handshake(stream).await.unwrap();
    // It ends with the client, or when the service closes it.
    tokio::spawn(async move { connection.await.is_ok() });
    sending.ready().await.unwrap()
}

/// By prior knowledge.
async fn plain(server: &Server) -> Sending {
    spoken(tokio::net::TcpStream::connect(address(server)).await.unwrap()).await
}

/// By TLS, with the certificate of the service, which chooses HTTP/2.
async fn secret(server: &Server, certificate: &str) -> Sending {
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_slice(certificate.as_bytes()).unwrap()).unwrap();
    let mut config = ClientConfig::builder().with_root_certificates(roots).with_no_client_auth();
    config.alpn_protocols = vec![b"h2".to_vec(), b"http/1.1".to_vec()];
    let stream = tokio::net::TcpStream::connect(address(server)).await.unwrap();
    let name = ServerName::try_from("127.0.0.1").unwrap();
    let stream = TlsConnector::from(Arc::new(config)).connect(name, stream).await.unwrap();
    assert_eq!(stream.get_ref().1.alpn_protocol(), Some(&b"h2"[..]));
    spoken(stream).await
}

fn request(server: &Server, method: &str, path: &str, headers: &[(&str, &str)]) -> axum::http::Request<()> {
    let request = axum::http::Request::builder().method(method).uri(format!("{}{path}", server.address()));
    headers.iter().fold(request, |request, (name, value)| request.header(*name, *value)).body(()).unwrap()
}

/// Sends a request without a body, and gives status and body of the answer.
async fn asked(sending: &mut Sending, request: axum::http::Request<()>) -> (u16, RecvStream) {
    let (response, _) = sending.send_request(request, true).unwrap();
    let response = response.await.unwrap();
    (response.status().as_u16(), response.into_body())
}

/// All of a body, with a pause for each of its kibibytes.
async fn taken(body: &mut RecvStream, pause: Duration) -> Result<Vec<u8>, h2::Error> {
    let mut bytes = Vec::new();
    while let Some(piece) = body.data().await {
        let piece = piece?;
        bytes.extend_from_slice(&piece);
        body.flow_control().release_capacity(piece.len())?;
        tokio::time::sleep(pause * (piece.len() >> 10) as u32).await;
    }
    Ok(bytes)
}

/// Sends a body as fast as the service takes it, with a pause after each piece.
async fn given(stream: &mut SendStream<Bytes>, body: &[u8], pause: Duration) {
    for piece in body.chunks(256 << 10) {
        let mut piece = Bytes::copy_from_slice(piece);
        while !piece.is_empty() {
            stream.reserve_capacity(piece.len());
            let room = std::future::poll_fn(|context| stream.poll_capacity(context)).await;
            let room = room.expect("a stream that is open").unwrap();
            stream.send_data(piece.split_to(room.min(piece.len())), false).unwrap();
        }
        tokio::time::sleep(pause).await;
    }
    stream.send_data(Bytes::new(), true).unwrap();
}

/// A cohort whose export is many times as long as a window.
fn fill(server: &Server) {
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 4});
    server.post("/v1/cohorts", &json!({"name": "large", "representation": representation})).expect(201);
    server.post_bytes("/v1/cohorts/large/shapes", NDJSON, lines(20_000)).expect(201);
}

const EXPORT: &str = "/v1/cohorts/large/export?format=csv";

#[test]
fn answers_over_http2_arrive_whole_however_slowly_they_are_read() {
    let server = Setting::fresh().flags(&["--reader-seconds", "2"]).start();
    fill(&server);
    let whole = server.get(EXPORT).body;
    assert!(whole.len() > 12 * WINDOW as usize, "{} bytes", whole.len());
    wait(async {
        let mut sending = plain(&server).await;
        let begin = Instant::now();
        let slow = Duration::from_secs(5) / (whole.len() >> 10) as u32;
        let (status, mut body) = asked(&mut sending, request(&server, "GET", EXPORT, &[])).await;
        assert_eq!(status, 200);
        assert!(taken(&mut body, slow).await.unwrap() == whole, "an answer that is read slowly");
        assert!(begin.elapsed() > Duration::from_secs(3), "{:?}", begin.elapsed());
        // Several answers at once on one connection, packed and not.
        let bodies = ["identity", "gzip", "identity", "gzip"].map(|coding| {
            let (mut sending, asking) =
                (sending.clone(), request(&server, "GET", EXPORT, &[("accept-encoding", coding)]));
            async move {
                let (_, mut body) = asked(&mut sending, asking).await;
                let bytes = taken(&mut body, Duration::from_micros(100)).await.unwrap();
                if coding == "gzip" { unpacked(&bytes) } else { bytes }
            }
        });
        for body in futures_util::future::join_all(bodies).await {
            assert!(body == whole, "{} of {} bytes", body.len(), whole.len());
        }
    });
}

#[test]
fn http2_by_tls_is_read_at_the_pace_of_the_client_too() {
    let (folder, made) = (tempfile::tempdir().unwrap(), certificate());
    let [chain, key] = ["chain.pem", "key.pem"].map(|name| folder.path().join(name));
    std::fs::write(&chain, &made.0).unwrap();
    std::fs::write(&key, &made.1).unwrap();
    let flags =
        ["--tls-cert", chain.to_str().unwrap(), "--tls-key", key.to_str().unwrap(), "--reader-seconds", "1"];
    let server = Setting::fresh().flags(&flags).start();
    let text = lines(20_000);
    let sent = wait(async {
        let mut sending = secret(&server, &made.0).await;
        let asking =
            request(&server, "POST", "/v1/convert?format=ndjson&to=ndjson", &[("content-type", NDJSON)]);
        let (response, mut stream) = sending.send_request(asking, false).unwrap();
        given(&mut stream, text.as_bytes(), Duration::ZERO).await;
        let response = response.await.unwrap();
        assert_eq!(response.status(), 200);
        taken(&mut response.into_body(), Duration::from_millis(2)).await.unwrap()
    });
    assert_eq!(sent.split(|byte| *byte == b'\n').filter(|line| !line.is_empty()).count(), 20_000);
}

/// The whole request is sent, which takes longer than a client may be without reading, before anything is read.
#[test]
fn a_client_that_sends_slowly_before_it_reads_gets_a_whole_answer() {
    let server = Setting::fresh().flags(&["--reader-seconds", "1"]).start();
    let (count, path) = (350_000, "/v1/convert?format=ndjson&to=ndjson");
    let text = lines(count);
    let pause = Duration::from_millis(60);
    let sent = wait(async {
        let mut sending = plain(&server).await;
        let (response, mut stream) =
            sending.send_request(request(&server, "POST", path, &[("content-type", NDJSON)]), false).unwrap();
        given(&mut stream, text.as_bytes(), pause).await;
        let response = response.await.unwrap();
        assert_eq!(response.status(), 200);
        taken(&mut response.into_body(), Duration::ZERO).await.unwrap()
    });
    assert_eq!(sent.split(|byte| *byte == b'\n').filter(|line| !line.is_empty()).count(), count);

    let mut stream = connect(&server);
    let head = format!(
        "POST {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: {NDJSON}\r\nconnection: close\r\ncontent-length: {}\r\n\r\n",
        text.len()
    );
    send(&mut stream, &head);
    for piece in text.as_bytes().chunks(256 << 10) {
        stream.write_all(piece).unwrap();
        std::thread::sleep(pause);
    }
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 200 ") && answer.ends_with("\r\n0\r\n\r\n"), "the last chunk");
    assert_eq!(content(&answer).matches("\"points\"").count(), count);
    server.assert_alive();
}

/// After status 200 an answer can break off only with an error: of the stream, while others of the connection go on.
#[test]
fn an_answer_that_breaks_off_over_http2_is_an_error_of_its_stream() {
    let server = Server::fresh();
    let text = format!("{}{{\"points\":[[0,0],[1]]}}\n", lines(40_000));
    wait(async {
        let mut sending = plain(&server).await;
        let asking =
            request(&server, "POST", "/v1/convert?format=ndjson&to=ndjson", &[("content-type", NDJSON)]);
        let (response, mut stream) = sending.send_request(asking, false).unwrap();
        given(&mut stream, text.as_bytes(), Duration::ZERO).await;
        let response = response.await.unwrap();
        assert_eq!(response.status(), 200);
        let error = taken(&mut response.into_body(), Duration::ZERO).await.unwrap_err();
        assert!(error.is_reset() && error.is_remote(), "{error}");
        let (status, _) = asked(&mut sending, request(&server, "GET", "/livez", &[])).await;
        assert_eq!(status, 204);
    });
}

/// More than fits between the service and a client that does not read.
fn long_evaluation() -> String {
    let mut body = measure();
    body["samples"] = json!(170_000);
    body.to_string()
}

/// Of two connections, a caller may have one: the next request is served only when the place is given back.
#[test]
fn a_client_that_stops_reading_gives_its_place_back() {
    let server = Setting::fresh().flags(&["--max-connections", "2", "--reader-seconds", "2"]).start();
    let key = create_key(&server, &["--role", "reader"]);
    let bearer = format!("Bearer {key}");
    let next = || server.send(server.request(Method::GET, "/v1/cohorts").bearer_auth(&key)).status;
    let body = long_evaluation();
    let headers = [("authorization", bearer.as_str()), ("content-type", "application/json")];

    let mut held = wait(async {
        let mut sending = plain(&server).await;
        let asking = request(&server, "POST", "/v1/evaluate", &headers);
        let (response, mut stream) = sending.send_request(asking, false).unwrap();
        given(&mut stream, body.as_bytes(), Duration::ZERO).await;
        let response = response.await.unwrap();
        assert_eq!(response.status(), 200);
        (response.into_body(), sending)
    });
    assert_eq!(next(), 503, "the place is taken");
    until("the place of HTTP/2 is free", || next() == 200);
    // What was on its way is still there; then comes an error, and no end.
    let read = wait(taken(&mut held.0, Duration::ZERO));
    assert!(read.is_err(), "{} bytes seemed to be all", read.unwrap_or_default().len());

    let mut stream = connect(&server);
    let length = body.len();
    let head = format!("POST /v1/evaluate HTTP/1.1\r\nhost: localhost\r\nauthorization: {bearer}\r\n");
    send(
        &mut stream,
        &format!("{head}content-type: application/json\r\ncontent-length: {length}\r\n\r\n{body}"),
    );
    let (status, begun) = answer(&mut stream);
    let field = begun.lines().find_map(|line| line.strip_prefix("content-length: ")).map(str::to_owned);
    assert_eq!(status, 200);
    assert_eq!(next(), 503, "the place is taken");
    until("the place of HTTP/1.1 is free", || next() == 200);
    let read = rest(&mut stream);
    match field {
        Some(length) => assert!(read.len() < length.parse().unwrap(), "{} of {length} bytes", read.len()),
        None => assert!(!read.ends_with(b"\r\n0\r\n\r\n"), "{} bytes seemed to be all", read.len()),
    }
}

/// Reads answers with a length, one after the other.
fn answers(stream: &mut TcpStream, count: usize) -> Vec<(u16, String, Vec<u8>)> {
    let (mut bytes, mut found) = (Vec::new(), Vec::new());
    let mut buffer = vec![0; 1 << 16];
    while found.len() < count {
        if let Some(end) = bytes.windows(4).position(|end| end == b"\r\n\r\n") {
            let head = String::from_utf8(bytes[..end].to_vec()).unwrap();
            let field = |name: &str| {
                head.lines().find_map(|line| line.strip_prefix(name)).unwrap_or_default().trim().to_owned()
            };
            let length: usize = field("content-length:").parse().unwrap_or(0);
            if bytes.len() >= end + 4 + length {
                let status = head.split(' ').nth(1).unwrap().parse().unwrap();
                found.push((status, field("x-request-id:"), bytes[end + 4..end + 4 + length].to_vec()));
                bytes.drain(..end + 4 + length);
                continue;
            }
        }
        let read = stream.read(&mut buffer).unwrap();
        assert!(read > 0, "closed after {} answers", found.len());
        bytes.extend_from_slice(&buffer[..read]);
    }
    assert!(bytes.is_empty(), "{} bytes more", bytes.len());
    found
}

/// Requests one behind the other, all before anything is read, are answered in their order, each with its own answer: a body that
/// is refused unread is no request, whatever it looks like.
#[test]
fn requests_that_are_sent_ahead_are_answered_in_their_order() {
    let server = Server::fresh();
    let body = measure().to_string();
    let hidden = "GET /v1/settings HTTP/1.1\r\nhost: localhost\r\nx-request-id: hidden\r\n\r\n".repeat(20);
    let kinds: [(&str, &str, &str, u16); 5] = [
        ("GET /livez", "", "", 204),
        ("GET /v1/generators", "", "", 200),
        ("POST /v1/measure", "application/json", &body, 200),
        ("POST /v1/mean", "text/plain", &hidden, 415),
        ("POST /v1/nothing", "application/json", &hidden, 404),
    ];
    let mut text = String::new();
    for k in 0..400 {
        let (line, media_type, body, _) = kinds[k % kinds.len()];
        text.push_str(&format!("{line} HTTP/1.1\r\nhost: localhost\r\nx-request-id: ahead-{k}\r\n"));
        if !body.is_empty() {
            text.push_str(&format!("content-type: {media_type}\r\ncontent-length: {}\r\n", body.len()));
        }
        text.push_str(&format!("\r\n{body}"));
    }
    let mut stream = connect(&server);
    send(&mut stream, &text);
    let found = answers(&mut stream, 400);
    let expected: Vec<Vec<u8>> =
        vec![server.get("/v1/generators").body, server.post("/v1/measure", &measure()).body];
    for (k, (status, id, body)) in found.iter().enumerate() {
        assert_eq!((*status, id.as_str()), (kinds[k % kinds.len()].3, format!("ahead-{k}").as_str()));
        match k % kinds.len() {
            1 => assert!(*body == expected[0], "{k}"),
            2 => assert!(*body == expected[1], "{k}"),
            3 | 4 => assert_eq!(serde_json::from_slice::<Value>(body).unwrap()["status"], *status, "{k}"),
            _ => assert!(body.is_empty(), "{k}"),
        }
    }
}
