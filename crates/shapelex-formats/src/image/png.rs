//! PNG: grey, grey with alpha, colour or palette, 1 to 16 bits.

use std::io::Cursor;

use png::{BitDepth, ColorType, Decoder, DecodingError, Info, Reader, Transformations};

use super::error::ImageError;
use super::file::{Description, ImageFile};
use super::grid::{Grid, LengthUnit};
use super::limits::{Limits, reserve};
use super::stream::DEFLATE_RATIO;
use super::value::{Source, Target, ValueType};

/// Name in messages.
pub(super) const NAME: &str = "PNG";

const PIXELS: &str = "PNG pixels";

/// Memory of the decoder beside rows and pixels: its window, and chunks of other kinds.
const DECODER_BYTES: u64 = 1 << 20;

/// Position of width and height: signature, length and name of the first chunk come before.
const SIZE_AT: usize = 16;

type Pixels<'a> = Decoder<Cursor<&'a [u8]>>;

/// Used part of a header, checked.
struct Header {
    grid: Grid,
    colour: ColorType,
    depth: BitDepth,
    /// Number of bytes after decompression.
    compressed: u64,
    /// Most bytes after palettes and transparent colours are expanded.
    expanded: u64,
}

pub(super) fn describe(bytes: &[u8], limits: &Limits) -> Result<Description, ImageError> {
    let (_, header) = open(bytes, limits)?;
    let stored = if header.depth == BitDepth::Sixteen { ValueType::U16 } else { ValueType::U8 };
    let values = header.grid.cells() as u64 * size_of::<f32>() as u64;
    let channels = if header.colour == ColorType::Indexed { 3 } else { header.colour.samples() };
    let memory_bytes = values + header.expanded + 2 * row_bytes(&header) + DECODER_BYTES;
    Ok(Description { grid: header.grid, stored, channels, memory_bytes })
}

pub(super) fn read<T: Target>(bytes: &[u8], limits: &Limits) -> Result<ImageFile<T>, ImageError> {
    let (mut decoder, header) = open(bytes, limits)?;
    check_length(bytes, &header)?;
    decoder.set_transformations(Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(refusal)?;
    check_frames(reader.info())?;
    check_palette(reader.info())?;
    let pixels = frame(&mut reader, &header, limits)?;
    let (colour, depth) = reader.output_color_type();
    let mut values = reserve(header.grid.cells())?;
    if depth == BitDepth::Sixteen {
        append(pixels.as_chunks().0, u16::from_be_bytes, colour, &mut values)?;
    } else {
        let step = expansion(&header);
        append(pixels.as_chunks().0, |[byte]| byte / step, colour, &mut values)?;
    }
    Ok(ImageFile { grid: header.grid, values })
}

/// The labels: the positions in a palette where there is one, whatever its colours, else the grey values.
pub(super) fn read_labels(bytes: &[u8], limits: &Limits) -> Result<ImageFile<u32>, ImageError> {
    let (mut decoder, header) = open(bytes, limits)?;
    if header.colour != ColorType::Indexed {
        return read(bytes, limits);
    }
    check_length(bytes, &header)?;
    decoder.set_transformations(Transformations::IDENTITY);
    let mut reader = decoder.read_info().map_err(refusal)?;
    check_frames(reader.info())?;
    check_palette(reader.info())?;
    let pixels = frame(&mut reader, &header, limits)?;
    let bits = header.depth as usize;
    let [width, height, _] = header.grid.size();
    let row_bytes = (width * bits).div_ceil(8);
    let mut values = reserve(header.grid.cells())?;
    for row in pixels.chunks_exact(row_bytes).take(height) {
        // The first pixel of a byte is in its highest bits.
        values.extend((0..width * bits).step_by(bits).map(|at| {
            let below = 8 - bits - at % 8;
            u32::from(row[at / 8] >> below) & ((1 << bits) - 1)
        }));
    }
    Ok(ImageFile { grid: header.grid, values })
}

/// Refuses a file that is too short for its pixels, before memory is taken for them.
fn check_length(bytes: &[u8], header: &Header) -> Result<(), ImageError> {
    let found = (bytes.len() as u64).saturating_mul(DEFLATE_RATIO);
    match found < header.compressed {
        true => Err(ImageError::Truncated { place: PIXELS, expected: header.compressed, found }),
        false => Ok(()),
    }
}

/// The decoder of a file whose header is within the limits.
fn open<'a>(bytes: &'a [u8], limits: &Limits) -> Result<(Pixels<'a>, Header), ImageError> {
    // The decoder calls an empty image a fault of the header.
    let number = |at: usize| bytes.get(at..at + 4)?.first_chunk().copied().map(u32::from_be_bytes);
    if let (Some(width), Some(height)) = (number(SIZE_AT), number(SIZE_AT + 4)) {
        limits.size([width.into(), height.into(), 1])?;
    }
    let most = usize::try_from(limits.bytes.saturating_add(DECODER_BYTES)).unwrap_or(usize::MAX);
    let mut decoder = Decoder::new_with_limits(Cursor::new(bytes), png::Limits { bytes: most });
    decoder.set_ignore_text_chunk(true);
    decoder.set_ignore_iccp_chunk(true);
    let info = decoder.read_header_info().map_err(refusal)?;
    let header = Header::new(info, limits)?;
    Ok((decoder, header))
}

impl Header {
    fn new(info: &Info<'_>, limits: &Limits) -> Result<Self, ImageError> {
        let (width, height) = info.size();
        let size = limits.size([width.into(), height.into(), 1])?;
        let bits = info.color_type.samples() as u128 * info.bit_depth as u128;
        let row = 1 + (u128::from(width) * bits).div_ceil(8);
        let compressed = limits.bytes(PIXELS, row * u128::from(height))?;
        let channels = match info.color_type {
            ColorType::Grayscale | ColorType::GrayscaleAlpha => 2,
            ColorType::Rgb | ColorType::Rgba | ColorType::Indexed => 4,
        };
        let sample = if info.bit_depth == BitDepth::Sixteen { 2 } else { 1 };
        let cells = size.iter().map(|size| *size as u64).product::<u64>();
        let expanded = cells.saturating_mul(channels * sample);
        let grid = Grid::along_axes(size, [1.0; 3], [LengthUnit::Cell; 3])?;
        Ok(Self { grid, colour: info.color_type, depth: info.bit_depth, compressed, expanded })
    }
}

fn row_bytes(header: &Header) -> u64 {
    header.compressed / header.grid.size()[1] as u64
}

/// The decoder makes 0 to 255 of grey values of fewer than 8 bits: the factor, a whole number. Palettes are not multiplied.
fn expansion(header: &Header) -> u8 {
    match (header.colour, header.depth) {
        (ColorType::Grayscale, BitDepth::One) => 255,
        (ColorType::Grayscale, BitDepth::Two) => 85,
        (ColorType::Grayscale, BitDepth::Four) => 17,
        _ => 1,
    }
}

fn check_frames(info: &Info<'_>) -> Result<(), ImageError> {
    match info.animation_control {
        Some(animation) if animation.num_frames > 1 => {
            let found = format!("an animation of {}", animation.num_frames);
            Err(ImageError::Unsupported { format: NAME, expected: "one image", found })
        }
        _ => Ok(()),
    }
}

/// The decoder takes colours of three bytes from a palette of any length, and panics at its end.
fn check_palette(info: &Info<'_>) -> Result<(), ImageError> {
    let is_whole = |palette: &[u8]| (3..=3 * 256).contains(&palette.len()) && palette.len().is_multiple_of(3);
    match (info.color_type, info.palette.as_deref()) {
        (ColorType::Indexed, Some(palette)) if !is_whole(palette) => {
            Err(ImageError::corrupt(NAME, "a palette that is no list of colours"))
        }
        _ => Ok(()),
    }
}

/// The expanded pixels, and the check that the file is whole.
fn frame(
    reader: &mut Reader<Cursor<&[u8]>>,
    header: &Header,
    limits: &Limits,
) -> Result<Vec<u8>, ImageError> {
    let size = reader.output_buffer_size().filter(|size| *size as u64 <= header.expanded);
    let size = size.ok_or_else(|| {
        ImageError::corrupt(NAME, "a palette or transparency that does not fit its colour type")
    })?;
    limits.bytes(PIXELS, size as u128)?;
    let mut pixels = reserve(size)?;
    pixels.resize(size, 0);
    reader.next_frame(&mut pixels).map_err(refusal)?;
    reader.finish().map_err(refusal)?;
    Ok(pixels)
}

/// Appends a value for every pixel; alpha is left out.
fn append<S: Source, T: Target, const N: usize>(
    samples: &[[u8; N]],
    number: impl Fn([u8; N]) -> S,
    colour: ColorType,
    values: &mut Vec<T>,
) -> Result<(), ImageError> {
    for pixel in samples.chunks_exact(colour.samples()) {
        let cell = values.len();
        values.push(match pixel {
            [grey] | [grey, _] => number(*grey).to(cell)?,
            _ => T::colour([0, 1, 2].map(|c| number(pixel[c]).to_f64()), cell)?,
        });
    }
    Ok(())
}

fn refusal(error: DecodingError) -> ImageError {
    match error {
        DecodingError::IoError(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
            ImageError::Short { format: NAME }
        }
        DecodingError::LimitsExceeded => ImageError::Unsupported {
            format: NAME,
            expected: "chunks within the limits",
            found: "larger ones".into(),
        },
        other => ImageError::corrupt(NAME, other),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chunk(name: &[u8; 4], content: &[u8]) -> Vec<u8> {
        let body = [&name[..], content].concat();
        let mut sum = flate2::Crc::new();
        sum.update(&body);
        [&(content.len() as u32).to_be_bytes(), &body[..], &sum.sum().to_be_bytes()].concat()
    }

    /// One pixel, the first colour of a palette of so many bytes.
    fn indexed(palette: usize) -> Vec<u8> {
        let pixel = [0x78, 1, 1, 2, 0, 0xfd, 0xff, 0, 0, 0, 2, 0, 1];
        [
            b"\x89PNG\r\n\x1a\n".to_vec(),
            chunk(b"IHDR", &[0, 0, 0, 1, 0, 0, 0, 1, 8, 3, 0, 0, 0]),
            chunk(b"PLTE", &vec![7; palette]),
            chunk(b"IDAT", &pixel),
            chunk(b"IEND", &[]),
        ]
        .concat()
    }

    #[test]
    fn palettes_that_end_within_a_colour_are_refused() {
        let limits = Limits { bytes: 1 << 20, cells: 1 << 10 };
        for length in [3, 6, 768] {
            assert_eq!(read::<f32>(&indexed(length), &limits).unwrap().values, [7.0], "{length}");
        }
        for length in [0, 1, 2, 4, 40, 767, 769, 771] {
            let refused = read::<f32>(&indexed(length), &limits).unwrap_err().to_string();
            assert!(refused.starts_with("expected "), "{length}: {refused}");
        }
    }
}
