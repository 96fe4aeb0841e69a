//! One stream of deflate, decompressed to its end (RFC 1950, 1951). The readers of the library end without an error where the data
//! end before the stream, and say nothing of the bytes after it.

use flate2::{Decompress, FlushDecompress, Status};

/// Bytes that are decompressed between two questions for memory.
const STEP: usize = 64 << 10;

/// Why data are not a stream of deflate.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Fault<E> {
    /// Other bytes, or a wrong checksum.
    Corrupt,
    /// The data end before the stream.
    Cut,
    /// There is no memory for the decompressed bytes.
    Refused(E),
}

/// Content of one stream, with the frame of zlib if it is `framed`, and the number of bytes after its end. `grow` is asked for as many
/// bytes as there are, again and again.
pub(crate) fn inflate<E>(
    data: &[u8],
    framed: bool,
    grow: impl Fn(usize) -> Result<(), E>,
) -> Result<(Vec<u8>, usize), Fault<E>> {
    let (mut decoder, mut bytes, mut rest) = (Decompress::new(framed), Vec::new(), data);
    loop {
        bytes.reserve(STEP);
        let (read, written) = (decoder.total_in(), decoder.total_out());
        let status =
            decoder.decompress_vec(rest, &mut bytes, FlushDecompress::None).map_err(|_| Fault::Corrupt)?;
        let taken = usize::try_from(decoder.total_in() - read).unwrap_or(usize::MAX);
        rest = rest.get(taken..).unwrap_or_default();
        grow(bytes.len()).map_err(Fault::Refused)?;
        match status {
            Status::StreamEnd => return Ok((bytes, rest.len())),
            _ if taken == 0 && decoder.total_out() == written => return Err(Fault::Cut),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use flate2::Compression;
    use flate2::write::{DeflateEncoder, ZlibEncoder};

    use super::*;

    #[test]
    fn a_stream_is_read_whole_or_refused() {
        let text: Vec<u8> = (0..60_000_u32).flat_map(|k| (k * k).to_le_bytes()).collect();
        let mut plain = DeflateEncoder::new(Vec::new(), Compression::default());
        let mut framed = ZlibEncoder::new(Vec::new(), Compression::default());
        plain.write_all(&text).unwrap();
        framed.write_all(&text).unwrap();
        for (stream, is_framed) in [(plain.finish().unwrap(), false), (framed.finish().unwrap(), true)] {
            let read = |data: &[u8]| inflate(data, is_framed, |_| Ok::<_, ()>(()));
            assert_eq!(read(&stream).unwrap(), (text.clone(), 0));
            assert_eq!(read(&[&stream[..], &stream[..7]].concat()).unwrap(), (text.clone(), 7));
            for end in (0..stream.len()).step_by(301).chain(stream.len() - 6..stream.len()) {
                assert_eq!(read(&stream[..end]).unwrap_err(), Fault::Cut, "{end} of {}", stream.len());
            }
            let most = |bytes| if bytes > 100_000 { Err(bytes) } else { Ok(()) };
            let Fault::Refused(asked) = inflate(&stream, is_framed, most).unwrap_err() else {
                panic!("not refused")
            };
            assert!(asked <= 100_000 + STEP, "{asked}");
        }
        assert_eq!(inflate(b"xyz", true, |_| Ok::<_, ()>(())).unwrap_err(), Fault::Corrupt);
    }
}
