//! Lines, words and blocks of a file in memory.

use crate::error::{FileError, Place};

/// A position in a file of text, or of text and binary blocks.
pub(super) struct Scan<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Number of line ends before `at`, those of binary blocks not counted.
    ends: u64,
    /// Line of the item given last, from 1.
    line: u64,
}

impl<'a> Scan<'a> {
    /// The beginning of a file, after a byte order mark.
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        let at = if bytes.starts_with(b"\xef\xbb\xbf") { 3 } else { 0 };
        Self { bytes, at, ends: 0, line: 1 }
    }

    /// The bytes that come next.
    pub(super) fn rest(&self) -> &'a [u8] {
        &self.bytes[self.at..]
    }

    /// Place of the line or word given last.
    pub(super) fn place(&self) -> Place {
        Place::line(self.line)
    }

    /// The next line, without its end; `None` at the end of the file.
    pub(super) fn line(&mut self) -> Option<&'a [u8]> {
        let rest = self.rest();
        if rest.is_empty() {
            return None;
        }
        self.line = self.ends + 1;
        let end = rest.iter().position(|byte| *byte == b'\n');
        self.at += end.map_or(rest.len(), |end| end + 1);
        self.ends += 1;
        let line = &rest[..end.unwrap_or(rest.len())];
        Some(line.strip_suffix(b"\r").unwrap_or(line))
    }

    /// The next word between spaces and line ends; `None` at the end of the file.
    pub(super) fn word(&mut self) -> Option<&'a [u8]> {
        self.skip_spaces();
        let rest = self.rest();
        let length = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        self.line = self.ends + 1;
        self.at += length;
        (length > 0).then(|| &rest[..length])
    }

    /// Goes to the next word.
    pub(super) fn skip_spaces(&mut self) {
        while let Some(byte) = self.bytes.get(self.at).filter(|byte| byte.is_ascii_whitespace()) {
            self.ends += u64::from(*byte == b'\n');
            self.at += 1;
        }
    }

    /// The next word, which must be there.
    pub(super) fn expect_word(&mut self, what: &str) -> Result<&'a [u8], FileError> {
        self.word().ok_or_else(|| {
            FileError::truncated(self.place(), format!("expected {what}, got the end of the file"))
        })
    }

    /// The next word as a number.
    pub(super) fn number(&mut self, what: &str) -> Result<f64, FileError> {
        let word = self.expect_word(what)?;
        number(word, what, || self.place())
    }

    /// The next `count` bytes.
    pub(super) fn take(&mut self, count: usize, what: &str) -> Result<&'a [u8], FileError> {
        let found = self.rest().get(..count).ok_or_else(|| {
            let detail = format!("expected {count} bytes of {what}, got {}", self.rest().len());
            FileError::truncated(Place::byte(self.at as u64), detail)
        })?;
        self.at += count;
        Ok(found)
    }

    /// Nothing but spaces may follow.
    pub(super) fn expect_end(&mut self) -> Result<(), FileError> {
        match self.word() {
            None => Ok(()),
            Some(word) => {
                let detail = format!("expected the end of the file, got {}", shown(word));
                Err(FileError::malformed(self.place(), detail))
            }
        }
    }
}

/// A number.
pub(super) fn number(word: &[u8], what: &str, place: impl FnOnce() -> Place) -> Result<f64, FileError> {
    let parsed = std::str::from_utf8(word).ok().and_then(|word| word.parse().ok());
    parsed.ok_or_else(|| wrong(word, what, place()))
}

/// A number of things, or an index.
pub(super) fn count(word: &[u8], what: &str, place: impl FnOnce() -> Place) -> Result<u64, FileError> {
    let parsed = std::str::from_utf8(word).ok().and_then(|word| word.parse().ok());
    parsed.ok_or_else(|| wrong(word, what, place()))
}

/// Text of a name.
pub(super) fn text(bytes: &[u8], place: impl FnOnce() -> Place) -> Result<&str, FileError> {
    std::str::from_utf8(bytes.trim_ascii())
        .map_err(|_| FileError::malformed(place(), "expected UTF-8 text, got other bytes"))
}

/// Another word than the expected one.
pub(super) fn wrong(word: &[u8], what: &str, place: Place) -> FileError {
    FileError::malformed(place, format!("expected {what}, got {}", shown(word)))
}

/// A word of a file in a message: at most 40 characters.
pub(super) fn shown(word: &[u8]) -> String {
    let text = String::from_utf8_lossy(&word[..word.len().min(160)]);
    let printable = |c: char| if c.is_control() { '\u{fffd}' } else { c };
    format!("'{}'", text.chars().take(40).map(printable).collect::<String>())
}

/// Words of a line.
pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> {
    line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty())
}
