//! Splits a stream of byte chunks into lines of bounded length.

use bytes::{Bytes, BytesMut};

/// One line of a stream.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Line {
    /// Line number, from 1; blank lines count.
    pub number: u64,
    /// Bytes of the line, with its line break, which the last one may lack.
    pub text: Bytes,
}

/// Error: a line is longer than the limit.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("expected lines of at most {limit} bytes, line {number} is longer")]
pub struct LineTooLong {
    /// Line number, from 1.
    pub number: u64,
    /// Limit in bytes.
    pub limit: usize,
}

/// Splits chunks into lines and skips blank ones. Lines within a chunk are parts of it; one that continues in the next
/// chunk is copied.
#[derive(Debug)]
pub struct Lines {
    /// Beginning of the line that the next chunk continues.
    buffer: BytesMut,
    number: u64,
    limit: usize,
}

impl Lines {
    /// Splitter for lines of at most `limit` bytes.
    pub fn new(limit: usize) -> Self {
        Self { buffer: BytesMut::new(), number: 0, limit }
    }

    /// Adds a chunk, and passes the lines it completes to `keep`. Cost: one pass over the chunk.
    ///
    /// # Errors
    /// [`LineTooLong`].
    pub fn push(&mut self, chunk: impl Into<Bytes>, mut keep: impl FnMut(Line)) -> Result<(), LineTooLong> {
        let mut chunk: Bytes = chunk.into();
        while let Some(end) = memchr::memchr(b'\n', &chunk) {
            let tail = chunk.split_to(end + 1);
            let text = if self.buffer.is_empty() {
                tail
            } else {
                self.buffer.extend_from_slice(&tail);
                std::mem::take(&mut self.buffer).freeze()
            };
            self.emit(text, &mut keep)?;
        }
        self.buffer.extend_from_slice(&chunk);
        if self.buffer.len() > self.limit { Err(self.too_long()) } else { Ok(()) }
    }

    /// Number of bytes of the unfinished line.
    pub fn pending(&self) -> usize {
        self.buffer.len()
    }

    /// Passes on the last line if it does not end in a line break.
    ///
    /// # Errors
    /// [`LineTooLong`].
    pub fn finish(mut self, mut keep: impl FnMut(Line)) -> Result<(), LineTooLong> {
        let text = std::mem::take(&mut self.buffer).freeze();
        self.emit(text, &mut keep)
    }

    fn emit(&mut self, text: Bytes, keep: &mut impl FnMut(Line)) -> Result<(), LineTooLong> {
        if text.len() > self.limit {
            return Err(self.too_long());
        }
        self.number += 1;
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
            lines.push(chunk, |line| found.push((line.number, line.text))).unwrap();
        }
        lines.finish(|line| found.push((line.number, line.text))).unwrap();
        let text: Vec<(u64, &[u8])> = found.iter().map(|(n, t)| (*n, t.as_ref())).collect();
        assert_eq!(text, [(1, &b"abc\n"[..]), (3, b"de\r\n"), (4, b"last")]);
    }

    #[test]
    fn an_endless_line_is_refused_early() {
        let mut lines = Lines::new(10);
        lines.push("x\n", |_| {}).unwrap();
        let error = lines.push(vec![b'y'; 11], |_| {}).unwrap_err();
        assert_eq!(error, LineTooLong { number: 2, limit: 10 });
    }
}
