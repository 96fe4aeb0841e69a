//! Arrays in base64, perhaps compressed.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use crate::error::{FileError, Place};
use crate::inflate::{self, Fault};

/// Bytes that follow one another, raw or as base64 in one or more parts.
pub(super) enum Bytes<'a> {
    /// As they are.
    Raw(&'a [u8]),
    /// Base64 that is left, and bytes that are decoded already.
    Base64(&'a [u8], Vec<u8>),
}

impl<'a> Bytes<'a> {
    /// Bytes of a text of base64, in which spaces do not count.
    pub(super) fn base64(text: &'a [u8]) -> Self {
        Self::Base64(text, Vec::new())
    }

    /// Number of bytes that are left as they are in the file.
    pub(super) fn left(&self) -> usize {
        match self {
            Self::Raw(bytes) => bytes.len(),
            Self::Base64(text, _) => text.len(),
        }
    }

    /// The next bytes.
    pub(super) fn take(&mut self, count: usize, place: impl Fn() -> Place) -> Result<Vec<u8>, FileError> {
        let short = |found: usize| {
            FileError::truncated(place(), format!("expected {count} bytes of an array, got {found}"))
        };
        match self {
            Self::Raw(bytes) => {
                let (taken, rest) = bytes.split_at_checked(count).ok_or_else(|| short(bytes.len()))?;
                *bytes = rest;
                Ok(taken.to_vec())
            }
            Self::Base64(text, decoded) => {
                while decoded.len() < count {
                    let part = next_part(text, (count - decoded.len()).div_ceil(3));
                    if part.is_empty() {
                        return Err(short(decoded.len()));
                    }
                    STANDARD.decode_vec(&part, decoded).map_err(|error| {
                        FileError::malformed(place(), format!("expected base64, got a fault: {error}"))
                    })?;
                }
                let rest = decoded.split_off(count);
                Ok(std::mem::replace(decoded, rest))
            }
        }
    }

    /// All bytes that are left, of a text of base64 or raw.
    pub(super) fn all(mut self, place: impl Fn() -> Place) -> Result<Vec<u8>, FileError> {
        let count = match &self {
            Self::Raw(bytes) => bytes.len(),
            Self::Base64(text, decoded) => {
                let count = |byte: &&u8| !byte.is_ascii_whitespace();
                let sextets = text.iter().filter(count).filter(|byte| **byte != b'=').count();
                decoded.len() + sextets * 3 / 4
            }
        };
        self.take(count, place)
    }
}

/// At most `quads` groups of four characters, up to one with padding.
fn next_part(text: &mut &[u8], quads: usize) -> Vec<u8> {
    let mut part = Vec::new();
    while part.len() < quads.saturating_mul(4) {
        let [byte, rest @ ..] = *text else { break };
        *text = rest;
        if byte.is_ascii_whitespace() {
            continue;
        }
        part.push(*byte);
        if part.len().is_multiple_of(4) && *byte == b'=' {
            break;
        }
    }
    part
}

/// Data of zlib, which decompress to `size` bytes. No more memory is taken than there are bytes.
pub(super) fn inflate(data: &[u8], size: usize, place: impl Fn() -> Place) -> Result<Vec<u8>, FileError> {
    let wrong = |detail: String| FileError::malformed(place(), detail);
    let grow = |bytes| if bytes > size { Err(()) } else { Ok(()) };
    match inflate::inflate(data, true, grow) {
        Ok((bytes, 0)) if bytes.len() == size => Ok(bytes),
        Ok((_, 0)) => Err(wrong(format!("expected {size} bytes of compressed data, got fewer"))),
        Ok((_, after)) => {
            Err(wrong(format!("expected the end of the compressed data, got {after} bytes more")))
        }
        Err(Fault::Refused(())) => Err(wrong(format!("expected {size} bytes of compressed data, got more"))),
        Err(Fault::Cut) => Err(wrong("expected whole data of zlib, got only their beginning".into())),
        Err(Fault::Corrupt) => Err(wrong("expected data compressed by zlib, got other bytes".into())),
    }
}
