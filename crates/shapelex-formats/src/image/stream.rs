//! Bytes of a file or of the content of a gzip file, taken one block after the other.

use std::io::{ErrorKind, Read};

use super::error::ImageError;
use super::limits::reserve;

/// Deflate makes at most 258 bytes of 2 bits (RFC 1951, section 3.2.5): the content is at most 1032 times as large.
pub(super) const DEFLATE_RATIO: u64 = 1032;

/// Number of bytes that are decoded at once.
const BLOCK: usize = 1 << 16;

/// Memory of the state of a gzip decoder, its window of 32 KiB included, and of a block.
pub(super) const STREAM_BYTES: u64 = 1 << 18;

/// A reader with the name of its format, for messages.
pub(super) struct Stream<'a> {
    reader: Box<dyn Read + 'a>,
    format: &'static str,
}

impl<'a> Stream<'a> {
    /// Takes bytes from `reader`.
    pub(super) fn new(reader: impl Read + 'a, format: &'static str) -> Self {
        Self { reader: Box::new(reader), format }
    }

    /// Fills `buffer` with bytes of `place`.
    pub(super) fn fill(&mut self, buffer: &mut [u8], place: &'static str) -> Result<(), ImageError> {
        let found = self.read(buffer)?;
        let expected = buffer.len() as u64;
        if found == buffer.len() {
            Ok(())
        } else {
            Err(ImageError::Truncated { place, expected, found: found as u64 })
        }
    }

    /// Gives `count` bytes of `place` to `take`, in blocks whose lengths are multiples of `unit`, all but the last.
    pub(super) fn blocks(
        &mut self,
        count: u64,
        unit: usize,
        place: &'static str,
        mut take: impl FnMut(&[u8]) -> Result<(), ImageError>,
    ) -> Result<(), ImageError> {
        let length = (BLOCK / unit * unit) as u64;
        let mut buffer = reserve(length.min(count) as usize)?;
        for block in 0..count.div_ceil(length) {
            let done = block * length;
            buffer.resize(length.min(count - done) as usize, 0);
            let found = self.read(&mut buffer)?;
            if found < buffer.len() {
                return Err(ImageError::Truncated { place, expected: count, found: done + found as u64 });
            }
            take(&buffer)?;
        }
        Ok(())
    }

    /// Refuses bytes after the `expected` ones of `place`. At the end of a gzip file its checksum is compared.
    pub(super) fn end(&mut self, expected: u64, place: &'static str) -> Result<(), ImageError> {
        if self.read(&mut [0])? == 0 { Ok(()) } else { Err(ImageError::Excess { place, expected }) }
    }

    /// Reads until the buffer is full or the data end.
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, ImageError> {
        let length = buffer.len();
        let mut filled = 0;
        while filled < length {
            match self.reader.read(&mut buffer[filled..]) {
                Ok(0) => break,
                Ok(count) => filled += count,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::UnexpectedEof && filled > 0 => break,
                Err(error) if error.kind() == ErrorKind::UnexpectedEof => {
                    return Err(ImageError::Short { format: self.format });
                }
                Err(error) => return Err(ImageError::corrupt(self.format, error)),
            }
        }
        Ok(filled)
    }
}
