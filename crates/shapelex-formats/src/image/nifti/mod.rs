//! NIfTI-1: header and voxels in one file, plain or inside of gzip.

mod header;

use flate2::read::MultiGzDecoder;

use super::error::ImageError;
use super::file::{Description, ImageFile};
use super::limits::{Limits, reserve};
use super::stream::{DEFLATE_RATIO, STREAM_BYTES, Stream};
use super::value::Target;
use header::{HEADER_BYTES, Header};

/// Name in messages.
pub(super) const NAME: &str = "NIfTI-1";

/// Name of the compressed format in messages.
pub(super) const COMPRESSED: &str = "NIfTI-1 (gzip)";

const VOXELS: &str = "NIfTI-1 voxels";

pub(super) fn describe(bytes: &[u8], limits: &Limits) -> Result<Description, ImageError> {
    open(&mut Stream::new(bytes, NAME), limits).map(|header| header.description())
}

pub(super) fn describe_compressed(bytes: &[u8], limits: &Limits) -> Result<Description, ImageError> {
    open(&mut Stream::new(MultiGzDecoder::new(bytes), COMPRESSED), limits).map(|header| header.description())
}

pub(super) fn read<T: Target>(bytes: &[u8], limits: &Limits) -> Result<ImageFile<T>, ImageError> {
    read_stream(Stream::new(bytes, NAME), bytes.len() as u64, limits)
}

pub(super) fn read_compressed<T: Target>(bytes: &[u8], limits: &Limits) -> Result<ImageFile<T>, ImageError> {
    let most = (bytes.len() as u64).saturating_mul(DEFLATE_RATIO);
    read_stream(Stream::new(MultiGzDecoder::new(bytes), COMPRESSED), most, limits)
}

/// Header of a stream.
fn open(stream: &mut Stream<'_>, limits: &Limits) -> Result<Header, ImageError> {
    let mut bytes = [0; HEADER_BYTES];
    let filled = stream.fill(&mut bytes, "NIfTI-1 header");
    // Before the length: an inner file of gzip may be shorter than a header.
    if bytes.starts_with(b"\x1f\x8b") {
        return Err(ImageError::NestedGzip);
    }
    filled?;
    Header::new(&bytes, limits)
}

/// The image of a stream of at most `most` bytes.
fn read_stream<T: Target>(
    mut stream: Stream<'_>,
    most: u64,
    limits: &Limits,
) -> Result<ImageFile<T>, ImageError> {
    let header = open(&mut stream, limits)?;
    let expected = header.voxel_bytes();
    let found = most.saturating_sub(header.offset);
    if found < expected {
        return Err(ImageError::Truncated { place: VOXELS, expected, found });
    }
    let skipped = header.offset - HEADER_BYTES as u64;
    stream.blocks(skipped, 1, "NIfTI-1 extensions", |_| Ok(()))?;
    let mut values = reserve(header.grid.cells())?;
    stream.blocks(expected, header.numbers.stored.bytes(), VOXELS, |block| {
        header.numbers.decode(block, &mut values)
    })?;
    stream.end(expected, VOXELS)?;
    Ok(ImageFile { grid: header.grid, values })
}

impl Header {
    fn voxel_bytes(&self) -> u64 {
        self.grid.cells() as u64 * self.numbers.stored.bytes() as u64
    }

    fn description(&self) -> Description {
        let memory_bytes = self.grid.cells() as u64 * size_of::<f32>() as u64 + STREAM_BYTES;
        Description { grid: self.grid, stored: self.numbers.stored, channels: 1, memory_bytes }
    }
}
