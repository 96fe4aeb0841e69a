//! One page of a TIFF file: its size, type and spacing.

use tiff::ColorType;
use tiff::decoder::ifd::Value;
use tiff::decoder::{ChunkType, Decoder, DecodingSampleType};
use tiff::tags::{CompressionMethod, PhotometricInterpretation, Tag};

use super::bounded::Bounded;
use super::description::Sizes;
use super::{NAME, refusal};
use crate::image::LengthUnit;
use crate::image::error::ImageError;
use crate::image::grid::check_spacing;
use crate::image::limits::Limits;
use crate::image::value::ValueType;

pub(super) type Pages<'a> = Decoder<Bounded<'a>>;

/// Used part of a page, checked.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Page {
    pub(super) size: [u64; 2],
    pub(super) stored: ValueType,
    /// Numbers for each pixel after decoding: 1, 3 or 4.
    pub(super) channels: usize,
    /// Whether each channel is stored on its own.
    pub(super) separate: bool,
    /// Whether values are stored as they are.
    pub(super) plain: bool,
    /// Distances along x and y, in `unit`.
    pub(super) spacing: [f64; 2],
    pub(super) unit: LengthUnit,
    /// Bytes after decompression, with the padding of tiles.
    pub(super) padded: u64,
}

impl Page {
    /// The page that the decoder is at.
    pub(super) fn new(decoder: &mut Pages<'_>, limits: &Limits) -> Result<Self, ImageError> {
        let method = check_kind(decoder)?;
        let (width, height) = decoder.dimensions().map_err(refusal)?;
        let channels = channels(decoder.colortype().map_err(refusal)?)?;
        let layout = decoder.image_buffer_layout().map_err(refusal)?;
        let stored = value_type(layout.sample_type)?;
        if layout.complete_len as u128
            != u128::from(width) * u128::from(height) * (channels * stored.bytes()) as u128
        {
            return Err(unsupported("numbers of 8, 16, 32 or 64 bits", "numbers of another length"));
        }
        let separate = layout.planes > 1;
        let tiled = decoder.get_chunk_type() == ChunkType::Tile;
        let samples = decoder.find_tag_unsigned(Tag::SamplesPerPixel).map_err(refusal)?.unwrap_or(1_u16);
        check_tiles(tiled, separate, method)?;
        if usize::from(samples) > channels && method == CompressionMethod::LZW {
            // For the reason of LZW in tiles: rows are decoded one after the other.
            return Err(unsupported(
                "no further channels beside colour and alpha with LZW",
                format!("{samples} channels"),
            ));
        }
        let (unit, spacing) = spacing(decoder)?;
        let padded = padded(decoder, [width, height], usize::from(samples) * stored.bytes(), limits)?;
        let size = [width.into(), height.into()];
        Ok(Self {
            size,
            stored,
            channels,
            separate,
            plain: method == CompressionMethod::None,
            spacing,
            unit,
            padded,
        })
    }

    /// Sizes of its cells. TIFF has no distance between pages.
    pub(super) fn sizes(&self) -> Sizes {
        let [x, y] = self.spacing.map(|size| (size, self.unit));
        let z = if self.unit == LengthUnit::Cell { LengthUnit::Cell } else { LengthUnit::Unknown };
        Sizes([x, y, (1.0, z)])
    }

    /// Bytes of the decoded page.
    pub(super) fn bytes(&self) -> u64 {
        self.size[0] * self.size[1] * (self.channels * self.stored.bytes()) as u64
    }

    /// Size and type in messages.
    pub(super) fn text(&self) -> String {
        let [width, height] = self.size;
        let [x, y] = self.spacing;
        format!("{width} × {height} with {} × {:?}, spacing {x} × {y}", self.channels, self.stored)
    }
}

fn unsupported(expected: &'static str, found: impl ToString) -> ImageError {
    ImageError::Unsupported { format: NAME, expected, found: found.to_string() }
}

/// Refuses compressions, interpretations and orientations that are not read. The compression.
fn check_kind(decoder: &mut Pages<'_>) -> Result<CompressionMethod, ImageError> {
    let mut tag = |tag| decoder.find_tag_unsigned::<u16>(tag).map_err(refusal);
    let method = CompressionMethod::from_u16_exhaustive(tag(Tag::Compression)?.unwrap_or(1));
    let known = [
        CompressionMethod::None,
        CompressionMethod::LZW,
        CompressionMethod::Deflate,
        CompressionMethod::OldDeflate,
        CompressionMethod::PackBits,
    ];
    if !known.contains(&method) {
        return Err(unsupported("no compression, LZW, Deflate or PackBits", format!("{method:?}")));
    }
    let interpretation = tag(Tag::PhotometricInterpretation)?.and_then(PhotometricInterpretation::from_u16);
    match interpretation {
        Some(PhotometricInterpretation::BlackIsZero | PhotometricInterpretation::RGB) => {}
        Some(other) => return Err(unsupported("grey (BlackIsZero) or RGB pixels", format!("{other:?}"))),
        None => return Err(unsupported("grey (BlackIsZero) or RGB pixels", "an unknown interpretation")),
    }
    match tag(Tag::Orientation)?.unwrap_or(1) {
        1 => Ok(method),
        other => Err(unsupported("rows from the top and columns from the left (orientation 1)", other)),
    }
}

/// Refuses tiles for which the decoder, version 0.11.3, fails: an assertion about padding does not hold for the second channel,
/// and the end of LZW data is missed when a row ends there (image-tiff issue 395).
fn check_tiles(tiled: bool, separate: bool, method: CompressionMethod) -> Result<(), ImageError> {
    if tiled && separate {
        return Err(unsupported("tiles that hold all channels", "a tile for each channel"));
    }
    if tiled && method == CompressionMethod::LZW {
        return Err(unsupported("strips, or tiles without LZW", "tiles with LZW"));
    }
    Ok(())
}

fn channels(colour: ColorType) -> Result<usize, ImageError> {
    match colour {
        ColorType::Gray(_) => Ok(1),
        ColorType::RGB(_) => Ok(3),
        ColorType::RGBA(_) => Ok(4),
        ColorType::Multiband { num_samples, .. } => {
            Err(unsupported("one grey number for each pixel, or RGB", format!("{num_samples} channels")))
        }
        other => Err(unsupported("one grey number for each pixel, or RGB", format!("{other:?}"))),
    }
}

fn value_type(found: Option<DecodingSampleType>) -> Result<ValueType, ImageError> {
    match found {
        Some(DecodingSampleType::U8) => Ok(ValueType::U8),
        Some(DecodingSampleType::U16) => Ok(ValueType::U16),
        Some(DecodingSampleType::U32) => Ok(ValueType::U32),
        Some(DecodingSampleType::U64) => Ok(ValueType::U64),
        Some(DecodingSampleType::I8) => Ok(ValueType::I8),
        Some(DecodingSampleType::I16) => Ok(ValueType::I16),
        Some(DecodingSampleType::I32) => Ok(ValueType::I32),
        Some(DecodingSampleType::I64) => Ok(ValueType::I64),
        Some(DecodingSampleType::F32) => Ok(ValueType::F32),
        Some(DecodingSampleType::F64) => Ok(ValueType::F64),
        Some(DecodingSampleType::F16) => {
            Err(unsupported("integers, or floats of 32 or 64 bits", "floats of 16 bits"))
        }
        None => Err(unsupported("integers, or floats of 32 or 64 bits", "numbers of another type")),
    }
}

/// Cells to the inch that programs write where they know of no size: those of screens, and none at all.
const USUAL: [f64; 3] = [1.0, 72.0, 96.0];
/// Part by which resolutions differ that say the same: of 72 to the inch in centimetres, to three digits.
const SAME: f64 = 1e-3;

/// Spacing from the resolution, if the file gives its unit and it is none of the usual ones.
fn spacing(decoder: &mut Pages<'_>) -> Result<(LengthUnit, [f64; 2]), ImageError> {
    let unit = match decoder.find_tag_unsigned::<u16>(Tag::ResolutionUnit).map_err(refusal)? {
        Some(2) => LengthUnit::Inch,
        Some(3) => LengthUnit::Centimetre,
        _ => return Ok((LengthUnit::Cell, [1.0; 2])),
    };
    let Some(spacing) = resolution(decoder)? else { return Ok((LengthUnit::Cell, [1.0; 2])) };
    let inches = |size: f64| unit.millimetres(size) / LengthUnit::Inch.millimetres(1.0);
    let is_usual =
        |size: &f64| *size == 1.0 || USUAL.iter().any(|usual| (usual * inches(*size) - 1.0).abs() < SAME);
    if spacing.iter().all(is_usual) {
        return Ok((LengthUnit::Cell, [1.0; 2]));
    }
    Ok((unit, spacing))
}

/// Distances along x and y by the resolution, in its unit.
pub(super) fn resolution(decoder: &mut Pages<'_>) -> Result<Option<[f64; 2]>, ImageError> {
    let mut spacing = [1.0; 2];
    for ((value, tag), axis) in spacing.iter_mut().zip([Tag::XResolution, Tag::YResolution]).zip(['x', 'y']) {
        *value = match decoder.find_tag(tag).map_err(refusal)? {
            Some(Value::Rational(cells, lengths)) => f64::from(lengths) / f64::from(cells),
            Some(_) => return Err(ImageError::corrupt(NAME, "a resolution that is no fraction")),
            None => return Ok(None),
        };
        check_spacing(axis, *value)?;
    }
    Ok(Some(spacing))
}

/// Bytes after decompression, of pixels of `pixel_bytes`: tiles reach beyond the image.
fn padded(
    decoder: &mut Pages<'_>,
    size: [u32; 2],
    pixel_bytes: usize,
    limits: &Limits,
) -> Result<u64, ImageError> {
    let (across, down) = decoder.chunk_dimensions();
    let [width, height] = size.map(u128::from);
    // The last strip is cut off at the end of the image.
    let (across, down) = (u128::from(across), u128::from(down).min(height));
    if across == 0 || down == 0 {
        return Err(ImageError::corrupt(NAME, "strips or tiles without pixels"));
    }
    let rows =
        if decoder.get_chunk_type() == ChunkType::Tile { height.div_ceil(down) * down } else { height };
    let pixels = (width.div_ceil(across) * across).saturating_mul(rows);
    limits.bytes("TIFF pixels", pixels.saturating_mul(pixel_bytes as u128))
}
