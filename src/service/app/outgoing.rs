//! Answers of writers that wait for their reader: files of other programs.

use std::fs::File;
use std::io::{self, Read, Seek, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::Poll;

use bytes::Bytes;
use futures_util::stream::{self, Stream, StreamExt};
use tokio::sync::mpsc::{self, error::TrySendError};

/// Number of bytes passed on at a time.
const PIECE: usize = 64 << 10;
/// Number of pieces between writer and client.
const PIECES: usize = 4;
/// Bytes of an answer that are kept in a file while its request arrives: beyond them the client must read.
const MOST_KEPT: u64 = 1 << 30;

/// An answer as a blocking writer: a slow client slows it down.
///
/// Many clients read an answer only when they have sent their whole request. Bytes written before that, and not taken, go to a
/// temporary file, so that neither side waits for the other.
#[derive(Debug)]
pub struct BodyWriter {
    pieces: mpsc::Sender<Bytes>,
    buffer: Vec<u8>,
    arriving: Arriving,
    kept: Option<File>,
    kept_bytes: u64,
}

/// Whether the request of an answer is still arriving.
#[derive(Debug, Clone, Default)]
pub struct Arriving(Arc<AtomicBool>);

impl Arriving {
    /// A request that arrives until [`Self::end`].
    fn begun() -> Self {
        Self(Arc::new(AtomicBool::new(true)))
    }

    /// A request that arrives, and whether it still does.
    pub fn of<T>(pieces: impl Stream<Item = T>) -> (impl Stream<Item = T>, Self) {
        let arriving = Self::begun();
        let ended = arriving.clone();
        let end = stream::poll_fn(move |_| {
            ended.end();
            Poll::Ready(None)
        });
        (pieces.chain(end), arriving)
    }

    /// The whole request is there.
    fn end(&self) {
        self.0.store(false, Ordering::Relaxed);
    }

    fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

impl BodyWriter {
    /// A writer, and the pieces that it writes.
    pub fn new() -> (Self, mpsc::Receiver<Bytes>) {
        Self::during(Arriving::default())
    }

    /// A writer that does not wait for its reader while the request is `arriving`.
    pub fn during(arriving: Arriving) -> (Self, mpsc::Receiver<Bytes>) {
        let (pieces, received) = mpsc::channel(PIECES);
        (Self { pieces, buffer: Vec::new(), arriving, kept: None, kept_bytes: 0 }, received)
    }

    /// Passes a piece on, or keeps it while the request arrives.
    fn pass(&mut self, piece: Bytes) -> io::Result<()> {
        if !self.arriving.is_set() || self.kept_bytes >= MOST_KEPT {
            self.pass_kept()?;
            return self.send(piece);
        }
        if self.kept.is_some() {
            return self.keep(piece);
        }
        match self.pieces.try_send(piece) {
            Ok(()) => Ok(()),
            Err(TrySendError::Full(piece)) => self.keep(piece),
            Err(TrySendError::Closed(_)) => Err(broken()),
        }
    }

    /// Keeps a piece. Where no file can be made, the writer waits for its reader after all.
    fn keep(&mut self, piece: Bytes) -> io::Result<()> {
        if self.kept.is_none() {
            match tempfile::tempfile() {
                Ok(file) => self.kept = Some(file),
                Err(error) => {
                    tracing::warn!(%error, "there is no temporary file for an answer");
                    return self.send(piece);
                }
            }
        }
        let Some(file) = &mut self.kept else { return self.send(piece) };
        file.write_all(&piece)?;
        self.kept_bytes += piece.len() as u64;
        Ok(())
    }

    fn send(&self, piece: Bytes) -> io::Result<()> {
        self.pieces.blocking_send(piece).map_err(|_| broken())
    }

    /// Passes on the kept bytes.
    fn pass_kept(&mut self) -> io::Result<()> {
        let Some(mut file) = self.kept.take() else { return Ok(()) };
        self.kept_bytes = 0;
        file.rewind()?;
        loop {
            let mut piece = Vec::new();
            (&mut file).take(PIECE as u64).read_to_end(&mut piece)?;
            if piece.is_empty() {
                return Ok(());
            }
            self.send(piece.into())?;
        }
    }
}

fn broken() -> io::Error {
    io::ErrorKind::BrokenPipe.into()
}

impl Write for BodyWriter {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.buffer.extend_from_slice(bytes);
        if self.buffer.len() >= PIECE {
            self.flush()?;
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        if self.buffer.is_empty() {
            return Ok(());
        }
        let piece = Bytes::from(std::mem::take(&mut self.buffer));
        self.pass(piece)
    }
}

impl Drop for BodyWriter {
    fn drop(&mut self) {
        // A writer that has failed is followed by its error, whatever came before.
        let _ = self.flush().and_then(|()| self.pass_kept());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sent(mut received: mpsc::Receiver<Bytes>) -> Vec<u8> {
        let mut bytes = Vec::new();
        while let Some(piece) = received.blocking_recv() {
            bytes.extend_from_slice(&piece);
        }
        bytes
    }

    #[test]
    fn a_writer_waits_for_its_reader_only_when_the_request_is_there() {
        let text: Vec<u8> = (0..400_000_u32).flat_map(u32::to_le_bytes).collect();
        let arriving = Arriving::begun();
        let (mut writer, received) = BodyWriter::during(arriving.clone());
        // Nobody reads, and the writer does not wait.
        let (first, rest) = text.split_at(1_000_000);
        first.chunks(10_000).for_each(|part| writer.write_all(part).unwrap());
        assert!(writer.kept_bytes > 600_000);
        arriving.end();
        let reading = std::thread::spawn(move || sent(received));
        writer.write_all(rest).unwrap();
        drop(writer);
        assert_eq!(reading.join().unwrap(), text);
        // A request that ends after its writer.
        let (mut writer, received) = BodyWriter::during(Arriving::begun());
        text.chunks(10_000).for_each(|part| writer.write_all(part).unwrap());
        let reading = std::thread::spawn(move || sent(received));
        drop(writer);
        assert_eq!(reading.join().unwrap(), text);
        let (mut writer, received) = BodyWriter::during(Arriving::begun());
        drop(received);
        assert!(writer.write_all(&text).is_err(), "a reader that has gone");
    }
}
