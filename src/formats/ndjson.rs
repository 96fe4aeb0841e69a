//! Newline-delimited text out of a stream of byte chunks, with bounded lines.

use bytes::{Bytes, BytesMut};

/// A line of a stream.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Line {
    /// Its number, from 1; blank lines count.
    pub number: u64,
    /// Its bytes, without the line break.
    pub text: Bytes,
}

/// A line longer than the limit.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("line {number} is longer than {limit} bytes")]
pub struct LineTooLong {
    /// Its number, from 1.
    pub number: u64,
    /// The limit.
    pub limit: usize,
}

/// Cuts chunks into lines; blank lines are passed over. Holds at most one line and one chunk.
#[derive(Debug)]
pub struct Lines {
    buffer: BytesMut,
    scanned: usize,
    number: u64,
    limit: usize,
}

impl Lines {
    /// Lines of at most `limit` bytes.
    pub fn new(limit: usize) -> Self {
        Self { buffer: BytesMut::new(), scanned: 0, number: 0, limit }
    }

    /// Takes a chunk and gives the lines that it completes to `keep`.
    ///
    /// # Errors
    /// [`LineTooLong`].
    pub fn push(&mut self, chunk: &[u8], mut keep: impl FnMut(Line)) -> Result<(), LineTooLong> {
        self.buffer.extend_from_slice(chunk);
        while let Some(offset) = self.buffer[self.scanned..].iter().position(|&byte| byte == b'\n') {
            let text = self.buffer.split_to(self.scanned + offset + 1);
            self.scanned = 0;
            self.emit(text, &mut keep)?;
        }
        self.scanned = self.buffer.len();
        if self.scanned > self.limit { Err(self.too_long()) } else { Ok(()) }
    }

    /// Bytes of a line that has not ended yet.
    pub fn pending(&self) -> usize {
        self.buffer.len()
    }

    /// The last line, when it does not end in a line break.
    ///
    /// # Errors
    /// [`LineTooLong`].
    pub fn finish(mut self, mut keep: impl FnMut(Line)) -> Result<(), LineTooLong> {
        let text = std::mem::take(&mut self.buffer);
        self.emit(text, &mut keep)
    }

    fn emit(&mut self, text: BytesMut, keep: &mut impl FnMut(Line)) -> Result<(), LineTooLong> {
        if text.len() > self.limit {
            return Err(self.too_long());
        }
        self.number += 1;
        let text = text.freeze();
        if !text.iter().all(u8::is_ascii_whitespace) {
            keep(Line { number: self.number, text });
        }
        Ok(())
    }

    fn too_long(&self) -> LineTooLong {
        LineTooLong { number: self.number + 1, limit: self.limit }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chunks_need_not_end_at_lines() {
        let mut lines = Lines::new(10);
        let mut found = Vec::new();
        for chunk in ["ab", "c\n\nde", "\r\n", "last"] {
            lines.push(chunk.as_bytes(), |line| found.push((line.number, line.text))).unwrap();
        }
        lines.finish(|line| found.push((line.number, line.text))).unwrap();
        let text: Vec<(u64, &[u8])> = found.iter().map(|(n, t)| (*n, t.as_ref())).collect();
        assert_eq!(text, [(1, &b"abc\n"[..]), (3, b"de\r\n"), (4, b"last")]);
    }

    #[test]
    fn an_endless_line_is_refused_early() {
        let mut lines = Lines::new(10);
        lines.push(b"x\n", |_| {}).unwrap();
        let error = lines.push(&[b'y'; 11], |_| {}).unwrap_err();
        assert_eq!(error, LineTooLong { number: 2, limit: 10 });
    }
}
