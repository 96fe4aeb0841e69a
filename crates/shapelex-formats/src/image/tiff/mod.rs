//! TIFF: pages of grey or RGB pixels in strips or tiles. Several pages are a volume, page after page along z.
//!
//! Sizes of cells are those that OME or ImageJ describe on the first page, else those of its resolution.

mod bounded;
mod description;
mod directory;
mod page;

use tiff::decoder::{Decoder, DecodingResult};
use tiff::{TiffError, TiffFormatError};

use super::error::ImageError;
use super::file::{Description, ImageFile};
use super::grid::Grid;
use super::limits::{Limits, reserve};
use super::value::{Source, Target};
use bounded::Bounded;
use directory::Lists;
use page::{Page, Pages};

/// Name in messages.
pub(super) const NAME: &str = "TIFF";

const PIXELS: &str = "TIFF pixels";

/// Most bytes that one compressed byte becomes: an LZW code of 12 bits stands for at most 3837 bytes, more than the 1032 of
/// Deflate and the 64 of PackBits for the same 8 bits.
const MOST_RATIO: u64 = 2558;

/// Memory of decompressors, and of the row that is cut off a tile.
const DECODER_BYTES: u64 = 1 << 18;

pub(super) fn describe(bytes: &[u8], limits: &Limits) -> Result<Description, ImageError> {
    let stack = Stack::new(bytes, limits)?;
    let page = stack.page;
    let values = stack.grid.cells() as u64 * size_of::<f32>() as u64;
    let memory_bytes =
        values + page.padded + directory::LIST_ENTRY_BYTES * stack.lists.longest + DECODER_BYTES;
    Ok(Description { grid: stack.grid, stored: page.stored, channels: page.channels, memory_bytes })
}

pub(super) fn read<T: Target>(bytes: &[u8], limits: &Limits) -> Result<ImageFile<T>, ImageError> {
    let stack = Stack::new(bytes, limits)?;
    let mut decoder = open(bytes, stack.lists, limits)?;
    let mut values = reserve(stack.grid.cells())?;
    for index in 0..stack.grid.size()[2] {
        if index > 0 {
            decoder.next_image().map_err(refusal)?;
        }
        append_page(&mut decoder, &stack.page, &mut values)?;
    }
    Ok(ImageFile { grid: stack.grid, values })
}

/// The decoder of a file whose directories are within the limits, at the first page.
fn open<'a>(bytes: &'a [u8], lists: Lists, limits: &Limits) -> Result<Pages<'a>, ImageError> {
    let most = usize::try_from(limits.bytes).unwrap_or(usize::MAX);
    let mut bounds = tiff::decoder::Limits::default();
    (bounds.decoding_buffer_size, bounds.intermediate_buffer_size, bounds.ifd_value_size) =
        (most, most, most);
    let decoder = Decoder::new(Bounded::new(bytes, lists.entries)).map_err(refusal)?;
    Ok(decoder.with_limits(bounds))
}

/// Pages of one size and type.
struct Stack {
    page: Page,
    grid: Grid,
    lists: Lists,
}

impl Stack {
    fn new(bytes: &[u8], limits: &Limits) -> Result<Self, ImageError> {
        let lists = directory::check(bytes, limits)?;
        let mut decoder = open(bytes, lists, limits)?;
        let first = Page::new(&mut decoder, limits)?;
        let sizes = description::sizes(bytes, &lists, &mut decoder)?.unwrap_or_else(|| first.sizes());
        let mut count = 1_u64;
        while decoder.more_images() {
            decoder.next_image().map_err(refusal)?;
            count += 1;
            let other = Page::new(&mut decoder, limits)?;
            if other != first {
                return Err(ImageError::Pages {
                    first: first.text(),
                    page: count as usize,
                    found: other.text(),
                });
            }
        }
        let size = limits.size([first.size[0], first.size[1], count])?;
        limits.bytes(PIXELS, u128::from(first.padded) * u128::from(count))?;
        check_length(bytes, &first, count)?;
        Ok(Self { page: first, grid: sizes.grid(size)?, lists })
    }
}

/// Refuses pages that are too large for the bytes of the file.
fn check_length(bytes: &[u8], page: &Page, count: u64) -> Result<(), ImageError> {
    let most = if page.plain { 1 } else { MOST_RATIO };
    let (expected, found) = (page.bytes() * count, (bytes.len() as u64).saturating_mul(most));
    if expected <= found { Ok(()) } else { Err(ImageError::Truncated { place: PIXELS, expected, found }) }
}

fn append_page<T: Target>(
    decoder: &mut Pages<'_>,
    page: &Page,
    values: &mut Vec<T>,
) -> Result<(), ImageError> {
    let mut pixels = DecodingResult::U8(Vec::new());
    decoder.read_image_to_buffer(&mut pixels).map_err(refusal)?;
    match pixels {
        DecodingResult::U8(pixels) => append(&pixels, page, values),
        DecodingResult::U16(pixels) => append(&pixels, page, values),
        DecodingResult::U32(pixels) => append(&pixels, page, values),
        DecodingResult::U64(pixels) => append(&pixels, page, values),
        DecodingResult::I8(pixels) => append(&pixels, page, values),
        DecodingResult::I16(pixels) => append(&pixels, page, values),
        DecodingResult::I32(pixels) => append(&pixels, page, values),
        DecodingResult::I64(pixels) => append(&pixels, page, values),
        DecodingResult::F32(pixels) => append(&pixels, page, values),
        DecodingResult::F64(pixels) => append(&pixels, page, values),
        DecodingResult::F16(_) => Err(ImageError::corrupt(NAME, "floats of 16 bits, unlike its header")),
    }
}

/// Appends a value for every pixel; alpha is left out.
fn append<S: Source, T: Target>(samples: &[S], page: &Page, values: &mut Vec<T>) -> Result<(), ImageError> {
    let pixels = samples.len() / page.channels;
    if pixels as u64 != page.size[0] * page.size[1] {
        return Err(ImageError::corrupt(
            NAME,
            format!("expected the pixels of {}, got {pixels}", page.text()),
        ));
    }
    let at = |pixel: usize, c: usize| {
        if page.separate { samples[c * pixels + pixel] } else { samples[pixel * page.channels + c] }
    };
    for pixel in 0..pixels {
        let cell = values.len();
        values.push(if page.channels == 1 {
            at(pixel, 0).to(cell)?
        } else {
            T::colour([0, 1, 2].map(|c| at(pixel, c).to_f64()), cell)?
        });
    }
    Ok(())
}

fn refusal(error: TiffError) -> ImageError {
    match error {
        TiffError::IoError(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => {
            ImageError::Short { format: NAME }
        }
        TiffError::LimitsExceeded => ImageError::Unsupported {
            format: NAME,
            expected: "strips, tiles and lists within the limits",
            found: "larger ones".into(),
        },
        TiffError::UnsupportedError(fault) => {
            ImageError::Unsupported { format: NAME, expected: "grey or RGB pixels", found: fault.to_string() }
        }
        TiffError::FormatError(TiffFormatError::ImageFileDirectoryNotFound) => {
            ImageError::corrupt(NAME, "expected at least one page, got none")
        }
        other => ImageError::corrupt(NAME, other),
    }
}
