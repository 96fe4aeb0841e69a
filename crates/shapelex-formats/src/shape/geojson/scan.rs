//! Splits JSON that is too large to be held into its values, without looking into them.

use std::io::BufRead;

use super::super::source::Source;
use crate::error::{FileError, Place};

/// Meaning of a byte outside of strings.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Class {
    Other,
    Open,
    Close,
    Quote,
}

/// Class of every byte.
static CLASSES: [Class; 256] = {
    let mut classes = [Class::Other; 256];
    classes[b'{' as usize] = Class::Open;
    classes[b'[' as usize] = Class::Open;
    classes[b'}' as usize] = Class::Close;
    classes[b']' as usize] = Class::Close;
    classes[b'"' as usize] = Class::Quote;
    classes
};

/// Walks over JSON text. Passed bytes are appended to `kept`.
pub(super) struct Scanner<'s, 'a> {
    source: &'s mut Source<'a>,
    /// The bytes passed since it was last emptied.
    pub(super) kept: Vec<u8>,
    /// Most that `kept` may hold.
    held: usize,
    /// Greatest depth of nested lists and objects.
    depth: usize,
    /// Where in the file this is, for faults.
    pub(super) place: Place,
}

/// State within a value of several bytes.
#[derive(Default)]
struct Nesting {
    depth: usize,
    in_string: bool,
    escaped: bool,
}

impl<'s, 'a> Scanner<'s, 'a> {
    pub(super) fn new(source: &'s mut Source<'a>) -> Self {
        let (held, depth) = (source.limits().held, source.limits().depth);
        Self { source, kept: Vec::new(), held, depth, place: Place::default() }
    }

    /// Number of bytes passed.
    pub(super) fn offset(&self) -> u64 {
        self.source.offset()
    }

    /// Skips a byte order mark at the beginning of the file.
    pub(super) fn skip_mark(&mut self) -> Result<(), FileError> {
        if self.offset() == 0 && self.source.head().starts_with("\u{feff}".as_bytes()) {
            for _ in 0..3 {
                self.source.fill_buf()?;
                self.source.consume(1);
            }
        }
        Ok(())
    }

    /// The next byte that is not white space. It is not passed. Record separators of text sequences (RFC 8142) count as space.
    pub(super) fn peek(&mut self) -> Result<Option<u8>, FileError> {
        loop {
            let block = self.source.fill_buf()?;
            if block.is_empty() {
                return Ok(None);
            }
            let is_space = |byte: &u8| matches!(byte, b' ' | b'\t' | b'\r' | b'\n' | 0x1e);
            let count = block.iter().position(|byte| !is_space(byte)).unwrap_or(block.len());
            let next = block.get(count).copied();
            self.pass(count)?;
            if next.is_some() {
                return Ok(next);
            }
        }
    }

    /// As [`peek`](Self::peek), where the file must go on.
    pub(super) fn peek_more(&mut self, expected: &str) -> Result<u8, FileError> {
        self.peek()?.ok_or_else(|| self.ended(expected))
    }

    /// Passes the next byte that is not white space, which must be `byte`.
    pub(super) fn expect(&mut self, byte: u8, expected: &str) -> Result<(), FileError> {
        match self.peek_more(expected)? {
            found if found == byte => self.pass(1),
            found => Err(self.unexpected(expected, found)),
        }
    }

    /// Passes the next value: an object, a list, a string or a word.
    pub(super) fn value(&mut self) -> Result<(), FileError> {
        match self.peek_more("a value")? {
            b'{' | b'[' | b'"' => self.nested(),
            _ => self.word(),
        }
    }

    /// Passes a value that begins with a bracket or a quotation mark.
    fn nested(&mut self) -> Result<(), FileError> {
        let mut state = Nesting::default();
        loop {
            let limit = self.depth;
            let block = self.source.fill_buf()?;
            if block.is_empty() {
                return Err(self.ended("the end of a value"));
            }
            let (count, done) = state.advance(block, limit);
            self.pass(count)?;
            if state.depth > limit {
                let detail = format!("expected at most {limit} nested lists and objects, got more");
                return Err(FileError::too_large(self.here(), detail));
            }
            if done {
                return Ok(());
            }
        }
    }

    /// Passes a number, `true`, `false`, `null`.
    fn word(&mut self) -> Result<(), FileError> {
        let start = self.kept.len();
        loop {
            let block = self.source.fill_buf()?;
            let ends = |byte: &u8| matches!(byte, b',' | b']' | b'}' | b':' | b' ' | b'\t' | b'\r' | b'\n');
            let end = block.iter().position(ends);
            let (count, done) = (end.unwrap_or(block.len()), end.is_some() || block.is_empty());
            self.pass(count)?;
            if done && self.kept.len() > start {
                return Ok(());
            }
            if done {
                let found = self.peek_more("a value")?;
                return Err(self.unexpected("a value", found));
            }
        }
    }

    /// Passes bytes of the block at hand and keeps them.
    fn pass(&mut self, count: usize) -> Result<(), FileError> {
        if self.kept.len().saturating_add(count) > self.held {
            let detail = format!("expected features of at most {} bytes, got a longer one", self.held);
            return Err(FileError::too_large(self.here(), detail));
        }
        let block = self.source.fill_buf()?;
        self.kept.extend_from_slice(block.get(..count).unwrap_or(block));
        self.source.consume(count);
        Ok(())
    }

    /// Where the scanner is.
    pub(super) fn here(&self) -> Place {
        Place::byte(self.offset()).within(&self.place)
    }

    /// A byte that does not belong here.
    pub(super) fn unexpected(&self, expected: &str, found: u8) -> FileError {
        let detail = format!("expected {expected}, got '{}'", char::from(found).escape_default());
        FileError::malformed(self.here(), detail)
    }

    fn ended(&self, expected: &str) -> FileError {
        FileError::truncated(self.here(), format!("expected {expected}, got the end of the file"))
    }
}

impl Nesting {
    /// Goes on over a block; the number of bytes that belong to the value, and whether it ends with them.
    fn advance(&mut self, block: &[u8], limit: usize) -> (usize, bool) {
        let mut at = 0;
        while let Some(byte) = block.get(at) {
            at += 1;
            if self.in_string {
                match byte {
                    _ if self.escaped => self.escaped = false,
                    b'\\' => self.escaped = true,
                    b'"' => {
                        self.in_string = false;
                        if self.depth == 0 {
                            return (at, true);
                        }
                    }
                    _ => {}
                }
                continue;
            }
            match CLASSES[usize::from(*byte)] {
                Class::Other => {}
                Class::Quote => self.in_string = true,
                Class::Open => {
                    self.depth += 1;
                    if self.depth > limit {
                        return (at, false);
                    }
                }
                Class::Close => {
                    self.depth = self.depth.saturating_sub(1);
                    if self.depth == 0 {
                        return (at, true);
                    }
                }
            }
        }
        (at, false)
    }
}
