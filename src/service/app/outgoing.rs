//! Answers of writers that wait for their reader: files of other programs.

use std::io::{self, Write};

use bytes::Bytes;
use tokio::sync::mpsc;

/// Number of bytes passed on at a time.
const PIECE: usize = 64 << 10;
/// Number of pieces between writer and client.
const PIECES: usize = 4;

/// An answer as a blocking writer: a slow client slows it down.
#[derive(Debug)]
pub struct BodyWriter {
    pieces: mpsc::Sender<Bytes>,
    buffer: Vec<u8>,
}

impl BodyWriter {
    /// A writer, and the pieces that it writes.
    pub fn new() -> (Self, mpsc::Receiver<Bytes>) {
        let (pieces, received) = mpsc::channel(PIECES);
        (Self { pieces, buffer: Vec::new() }, received)
    }
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
        self.pieces.blocking_send(piece).map_err(|_| io::Error::from(io::ErrorKind::BrokenPipe))
    }
}

impl Drop for BodyWriter {
    fn drop(&mut self) {
        // A writer that has failed is followed by its error, whatever came before.
        let _ = self.flush();
    }
}
