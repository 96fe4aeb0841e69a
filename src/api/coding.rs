//! Content codings of request bodies (RFC 9110 §8.4). A body in gzip is decoded to its end, whatever number of members it has; one
//! that is cut, or followed by other bytes, is an error of the body. Other codings, and several of them, are refused.

use std::io::{self, Write};

use axum::body::{Body, BodyDataStream, Bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use flate2::write::MultiGzDecoder;
use futures_util::{Stream, StreamExt, stream};

use super::overload::Edge;
use super::problem::{Problem, ProblemKind};

/// Decodes a body by its `Content-Encoding`, and refuses codings that the service does not read.
pub(super) async fn decode(mut request: Request, next: Next) -> Response {
    let Some(edge) = Edge::of(&request) else { return next.run(request).await };
    match is_gzip(request.headers()) {
        Ok(false) => next.run(request).await,
        Ok(true) => {
            // They describe the sent body.
            request.headers_mut().remove(header::CONTENT_ENCODING);
            request.headers_mut().remove(header::CONTENT_LENGTH);
            let ratio = edge.compression_ratio;
            next.run(request.map(|body| Body::from_stream(decoded(body, ratio)))).await
        }
        Err(found) => {
            let detail = format!("expected the content coding gzip, or none, got '{found}'");
            let problem = Problem::new(ProblemKind::UnsupportedMediaType, detail);
            ([(header::ACCEPT_ENCODING, "gzip")], problem).into_response()
        }
    }
}

/// Whether a body is compressed by gzip; otherwise the codings that it has.
fn is_gzip(headers: &HeaderMap) -> Result<bool, String> {
    let given = headers.get_all(header::CONTENT_ENCODING).iter();
    let given: Vec<String> =
        given.map(|value| String::from_utf8_lossy(value.as_bytes()).to_ascii_lowercase()).collect();
    let given = given.join(",");
    let codings: Vec<&str> =
        given.split(',').map(str::trim).filter(|coding| !matches!(*coding, "" | "identity")).collect();
    match codings[..] {
        [] => Ok(false),
        ["gzip" | "x-gzip"] => Ok(true),
        _ => Err(codings.join(", ")),
    }
}

/// Compressed bytes that are decoded at a time: they become at most a thousand times as many.
const STEP: usize = 1 << 10;
/// Decoded bytes that are allowed at any ratio: short texts of one repeated character compress a thousandfold.
const EXPANDS_FREELY: u64 = 1 << 20;

/// Error of a body with too large a compression ratio.
#[derive(Debug, thiserror::Error)]
#[error(
    "decompression expands the body to more than {ratio} times its size: send it uncompressed, or in parts"
)]
pub(super) struct Expands {
    ratio: u64,
}

/// A body that is being decoded.
struct Decoding {
    body: BodyDataStream,
    decoder: MultiGzDecoder<Vec<u8>>,
    /// Bytes that have arrived and are not decoded yet.
    piece: Bytes,
    /// Number of compressed bytes decoded, and of bytes that came out.
    counts: (u64, u64),
    ratio: u64,
    has_ended: bool,
}

/// The content of a body in gzip. It fails where it exceeds the ratio to the bytes that have arrived.
fn decoded(body: Body, ratio: u64) -> impl Stream<Item = Result<Bytes, axum::Error>> {
    let decoding = Decoding {
        body: body.into_data_stream(),
        decoder: MultiGzDecoder::new(Vec::new()),
        piece: Bytes::new(),
        counts: (0, 0),
        ratio,
        has_ended: false,
    };
    stream::try_unfold(decoding, |mut decoding| async move {
        let piece = decoding.next().await?;
        Ok::<_, axum::Error>((!piece.is_empty()).then_some((piece, decoding)))
    })
    .fuse()
}

impl Decoding {
    /// The next bytes; none at the end.
    async fn next(&mut self) -> Result<Bytes, axum::Error> {
        while !self.has_ended {
            if self.piece.is_empty() {
                match self.body.next().await {
                    Some(piece) => self.piece = piece?,
                    None => self.has_ended = true,
                }
            }
            let part = self.piece.split_to(STEP.min(self.piece.len()));
            self.step(&part).map_err(axum::Error::new)?;
            let bytes = std::mem::take(self.decoder.get_mut());
            self.counts.0 += part.len() as u64;
            self.counts.1 += bytes.len() as u64;
            if self.counts.1 > self.counts.0.saturating_mul(self.ratio).max(EXPANDS_FREELY) {
                return Err(axum::Error::new(Expands { ratio: self.ratio }));
            }
            if !bytes.is_empty() {
                return Ok(bytes.into());
            }
        }
        Ok(Bytes::new())
    }

    /// Decodes the next bytes, or the end.
    fn step(&mut self, part: &[u8]) -> io::Result<()> {
        if self.has_ended { self.decoder.try_finish() } else { self.decoder.write_all(part) }
    }
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;
    use flate2::Compression;
    use flate2::write::GzEncoder;

    use super::*;

    fn gzip(text: &[u8]) -> Vec<u8> {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(text).unwrap();
        encoder.finish().unwrap()
    }

    /// The content of a body that arrives in pieces of so many bytes.
    async fn read(body: &[u8], piece: usize, ratio: u64) -> Result<Vec<u8>, String> {
        let pieces: Vec<io::Result<Bytes>> =
            body.chunks(piece.max(1)).map(|piece| Ok(Bytes::copy_from_slice(piece))).collect();
        let mut stream = std::pin::pin!(decoded(Body::from_stream(stream::iter(pieces)), ratio));
        let mut text = Vec::new();
        while let Some(piece) = stream.next().await {
            text.extend_from_slice(&piece.map_err(|error| error.to_string())?);
        }
        assert!(stream.next().await.is_none());
        Ok(text)
    }

    #[tokio::test]
    async fn a_body_is_read_whole_or_refused() {
        let text: Vec<u8> = (0..4000_u32).flat_map(|k| (k * k % 977).to_string().into_bytes()).collect();
        let (first, second) = text.split_at(3000);
        let one = gzip(&text);
        let two = [gzip(first), gzip(second)].concat();
        let empty = [gzip(b""), one.clone(), gzip(b"")].concat();
        for piece in [1, 7, 1024, 1025, usize::MAX] {
            for body in [&one, &two, &empty] {
                assert_eq!(read(body, piece, 1000).await.unwrap(), text);
            }
            assert_eq!(
                read(&[one.clone(), one.clone()].concat(), piece, 1000).await.unwrap(),
                text.repeat(2)
            );
            assert_eq!(read(&gzip(b""), piece, 1000).await.unwrap(), b"");
        }
        // Cut anywhere but between members, and followed by anything but a member.
        for end in 0..two.len() {
            let read = read(&two[..end], 100, 1000).await;
            assert_eq!(read.is_ok(), end == gzip(first).len(), "{end} of {}", two.len());
        }
        for after in [&b"x"[..], b"\0", b"{\"shapes\": []}", &one[..9]] {
            assert!(read(&[&one[..], after].concat(), 100, 1000).await.is_err(), "{after:?}");
        }
        for at in [0, 2, 3, one.len() / 2, one.len() - 1, one.len() - 5] {
            let mut body = one.clone();
            body[at] ^= 0x15;
            assert!(read(&body, 100, 1000).await.is_err(), "changed at {at}");
        }
    }

    #[tokio::test]
    async fn what_expands_too_much_is_not_decoded() {
        let body = gzip(&vec![b'a'; 4 << 20]);
        let error = read(&body, 1 << 16, 100).await.unwrap_err();
        assert!(error.contains("more than 100 times its size"), "{error}");
        assert_eq!(read(&gzip(&vec![b'a'; 1 << 20]), 1 << 16, 2).await.unwrap().len(), 1 << 20);
    }

    #[test]
    fn codings_are_compared_without_case_and_once() {
        for (given, wanted) in [
            (&["gzip"][..], Ok(true)),
            (&["GZIP"], Ok(true)),
            (&["x-gzip"], Ok(true)),
            (&["identity, X-GZip"], Ok(true)),
            (&[], Ok(false)),
            (&["identity"], Ok(false)),
            (&["gzip, gzip"], Err("gzip, gzip")),
            (&["gzip", "gzip"], Err("gzip, gzip")),
            (&["br"], Err("br")),
            (&["deflate,gzip"], Err("deflate, gzip")),
        ] {
            let mut headers = HeaderMap::new();
            for value in given {
                headers.append(header::CONTENT_ENCODING, HeaderValue::from_static(value));
            }
            assert_eq!(is_gzip(&headers), wanted.map_err(str::to_owned), "{given:?}");
        }
    }
}
