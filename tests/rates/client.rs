//! A client that costs little beside the server it measures: requests on kept connections, from one thread.

use std::io;
use std::time::{Duration, Instant};

use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;

/// The bytes of a request with a body of the media type `application/…`.
pub(crate) fn request(method: &str, path: &str, media_type: &str, body: &str) -> Vec<u8> {
    let length = body.len();
    format!(
        "{method} {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/{media_type}\r\n\
         content-length: {length}\r\n\r\n{body}"
    )
    .into_bytes()
}

/// Answers of a server to one request, sent again and again on some connections.
#[derive(Debug)]
pub(crate) struct Answers {
    /// Seconds of every request that succeeded, ascending.
    pub(crate) latencies: Vec<f64>,
    /// Requests with another status than 2xx.
    pub(crate) refused: usize,
    /// Body of the last answer.
    pub(crate) body: Vec<u8>,
    seconds: f64,
}

impl Answers {
    /// Successful requests a second.
    pub(crate) fn rate(&self) -> f64 {
        self.latencies.len() as f64 / self.seconds
    }
}

/// Sends `request` to `address` as often as `connections` kept connections can in `time`.
pub(crate) fn load(address: &str, request: &[u8], connections: usize, time: Duration) -> io::Result<Answers> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    runtime.block_on(async {
        let start = Instant::now();
        let clients: Vec<_> = (0..connections)
            .map(|_| tokio::spawn(ask_until(address.to_owned(), request.to_vec(), start + time)))
            .collect();
        let mut all = Answers { latencies: Vec::new(), refused: 0, body: Vec::new(), seconds: 0.0 };
        for client in clients {
            let answers = client.await??;
            all.latencies.extend(answers.latencies);
            all.refused += answers.refused;
            all.body = answers.body;
        }
        all.seconds = start.elapsed().as_secs_f64();
        all.latencies.sort_by(f64::total_cmp);
        Ok(all)
    })
}

async fn ask_until(address: String, request: Vec<u8>, end: Instant) -> io::Result<Answers> {
    let mut answers = Answers { latencies: Vec::new(), refused: 0, body: Vec::new(), seconds: 0.0 };
    let mut stream = TcpStream::connect(address).await?;
    stream.set_nodelay(true)?;
    let mut buffer = Vec::new();
    while Instant::now() < end {
        let sent = Instant::now();
        stream.write_all(&request).await?;
        let (status, body) = answer(&mut stream, &mut buffer).await?;
        if (200..300).contains(&status) {
            answers.latencies.push(sent.elapsed().as_secs_f64());
        } else {
            answers.refused += 1;
        }
        answers.body = body;
    }
    Ok(answers)
}

/// Status and body of the next answer.
pub(crate) async fn answer(stream: &mut TcpStream, buffer: &mut Vec<u8>) -> io::Result<(u16, Vec<u8>)> {
    buffer.clear();
    loop {
        if stream.read_buf(buffer).await? == 0 {
            return Err(io::ErrorKind::UnexpectedEof.into());
        }
        if let Some((status, head, length)) = head(buffer)
            && buffer.len() >= head + length
        {
            return Ok((status, buffer[head..head + length].to_vec()));
        }
    }
}

/// Status, bytes of the head, and bytes of the body, once the whole head is there.
fn head(buffer: &[u8]) -> Option<(u16, usize, usize)> {
    let end = buffer.windows(4).position(|window| window == b"\r\n\r\n")? + 4;
    let text = std::str::from_utf8(&buffer[..end]).ok()?.to_ascii_lowercase();
    assert!(!text.contains("transfer-encoding"), "expected an answer with a content-length, got {text}");
    let status = text.split(' ').nth(1)?.parse().ok()?;
    let length = text.lines().find_map(|line| line.strip_prefix("content-length:"));
    Some((status, end, length.map_or(0, |length| length.trim().parse().unwrap_or(0))))
}
