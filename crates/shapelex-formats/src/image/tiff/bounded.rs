//! A reader with a bound on all bytes that are taken from a file.
//!
//! Strips may share their bytes, and compressed data may be long without making a pixel. A small file could so keep the decoder
//! busy for hours, although its image is within the limits.

use std::io::{Cursor, Error, Read, Result, Seek, SeekFrom};

/// Most bytes of a single read. Decompressors take as many as they get, usually more than a strip has.
const MOST_AT_ONCE: usize = 1 << 10;

/// How often all bytes of a file may be taken: directories twice, pixels once, and values that pages share.
const TIMES: u64 = 4;

/// The bytes of a file, some of them several times.
#[derive(Debug)]
pub(in crate::image) struct Bounded<'a> {
    bytes: Cursor<&'a [u8]>,
    left: u64,
}

impl<'a> Bounded<'a> {
    /// A reader of a file with lists of `entries` strips or tiles in all.
    pub(super) fn new(bytes: &'a [u8], entries: u64) -> Self {
        let ahead = entries.saturating_add(1).saturating_mul(MOST_AT_ONCE as u64);
        let left = (bytes.len() as u64).saturating_mul(TIMES).saturating_add(ahead);
        Self { bytes: Cursor::new(bytes), left }
    }
}

impl Read for Bounded<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        if self.left == 0 {
            return Err(Error::other("strips or tiles share their bytes"));
        }
        let most = buffer.len().min(MOST_AT_ONCE);
        let count = self.bytes.read(&mut buffer[..most])?;
        self.left = self.left.saturating_sub(count as u64);
        Ok(count)
    }
}

impl Seek for Bounded<'_> {
    fn seek(&mut self, position: SeekFrom) -> Result<u64> {
        self.bytes.seek(position)
    }
}
