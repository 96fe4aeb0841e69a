//! DICOM Segmentation: segments of a scan, a bit or a number for each cell.

use std::collections::BTreeMap;

use dicom_dictionary_std::{tags, uids};

use super::error::ImageError;
use super::file::{Description, ImageFile};
use super::grid::{Grid, LengthUnit, cross};
use super::limits::{Limits, reserve};
use super::value::{Source, Target, ValueType};
use crate::dicom::{self, Content, File, Node};
use crate::shape::FileError;

/// Name in messages.
pub(super) const NAME: &str = "DICOM Segmentation";

const PIXELS: &str = "DICOM Segmentation pixels";

/// Deepest nesting of sequences.
const DEPTH: usize = 64;

/// Largest distance, in mm, of a frame from the place that the others and the distance of slices give it.
const PLACE_MM: f64 = 0.01;

/// Bytes of memory for an element of a file, for each byte that it takes there.
const ELEMENT_BYTES: u64 = 16;

/// Segmentation Type (0062,0001).
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// A bit for each cell of a frame; each frame is of one segment.
    Binary,
    /// The number of a segment for each cell.
    Labels,
    /// A share for each cell of a frame.
    Fractional,
}

/// What is used of a file, checked.
struct Segments<'f> {
    grid: Grid,
    kind: Kind,
    stored: ValueType,
    frames: Vec<Frame>,
    pixels: &'f [u8],
}

/// A frame: the slice it lies in, and its segment if it has one.
struct Frame {
    slice: usize,
    segment: u32,
}

pub(super) fn describe(bytes: &[u8], limits: &Limits) -> Result<Description, ImageError> {
    with_segments(bytes, limits, |segments| {
        let cells = segments.grid.cells() as u64 * size_of::<f32>() as u64;
        let elements = bytes.len().saturating_sub(segments.pixels.len()) as u64;
        let memory_bytes = cells + ELEMENT_BYTES.saturating_mul(elements);
        Ok(Description { grid: segments.grid, stored: segments.stored, channels: 1, memory_bytes })
    })
}

pub(super) fn read(bytes: &[u8], limits: &Limits) -> Result<ImageFile, ImageError> {
    with_segments(bytes, limits, |segments| match segments.kind {
        Kind::Fractional => segments.shares(),
        Kind::Binary | Kind::Labels => {
            let labels = segments.labels()?;
            let mut values = reserve(labels.len())?;
            for (cell, label) in labels.into_iter().enumerate() {
                values.push(label.to(cell)?);
            }
            Ok(ImageFile { grid: segments.grid, values })
        }
    })
}

pub(super) fn read_labels(bytes: &[u8], limits: &Limits) -> Result<ImageFile<u32>, ImageError> {
    with_segments(bytes, limits, |segments| match segments.kind {
        Kind::Fractional => Err(unsupported("segments of whole cells (BINARY or LABELMAP)", "FRACTIONAL")),
        Kind::Binary | Kind::Labels => Ok(ImageFile { grid: segments.grid, values: segments.labels()? }),
    })
}

/// Labels of segments by their numbers.
pub(super) fn names(bytes: &[u8], limits: &Limits) -> Result<BTreeMap<u32, String>, ImageError> {
    let content = Content::new(bytes, limits.bytes, |_| Ok(())).map_err(refused)?;
    let file = content.parse(DEPTH).map_err(refused)?;
    let mut names = BTreeMap::new();
    for node in file.root().items(tags::SEGMENT_SEQUENCE).map_err(refused)? {
        let number = number(&node, tags::SEGMENT_NUMBER)?;
        if let Some(name) = node.short_text(tags::SEGMENT_LABEL).map_err(refused)? {
            names.insert(number, name);
        }
    }
    Ok(names)
}

fn refused(error: FileError) -> ImageError {
    ImageError::corrupt(NAME, error)
}

fn unsupported(expected: &'static str, found: impl ToString) -> ImageError {
    ImageError::Unsupported { format: NAME, expected, found: found.to_string() }
}

fn with_segments<T>(
    bytes: &[u8],
    limits: &Limits,
    use_them: impl FnOnce(&Segments<'_>) -> Result<T, ImageError>,
) -> Result<T, ImageError> {
    limits.bytes(NAME, bytes.len() as u128)?;
    let content = Content::new(bytes, limits.bytes, |_| Ok(())).map_err(refused)?;
    let file = content.parse(DEPTH).map_err(refused)?;
    let segments = Segments::new(&file, limits)?;
    use_them(&segments)
}

/// A whole number from 0 to 2³² − 1 that must be there.
fn number(node: &Node<'_>, tag: dicom_core::Tag) -> Result<u32, ImageError> {
    let found = node.count(tag, "a whole number").map_err(refused)?;
    u32::try_from(found)
        .map_err(|_| refused(node.malformed(tag, format!("expected a number below 2³², got {found}"))))
}

impl<'f> Segments<'f> {
    fn new(file: &'f File<'f>, limits: &Limits) -> Result<Self, ImageError> {
        let root = file.root();
        let classes = [uids::SEGMENTATION_STORAGE, uids::LABEL_MAP_SEGMENTATION_STORAGE];
        dicom::check_class(&root, &classes, &format!("a {NAME}")).map_err(refused)?;
        if file.big_endian() {
            return Err(unsupported("the least significant byte first", file.syntax()));
        }
        let kind =
            root.required_text(tags::SEGMENTATION_TYPE, "the type of the segments").map_err(refused)?;
        let kind = match kind.as_str() {
            "BINARY" => Kind::Binary,
            "LABELMAP" => Kind::Labels,
            "FRACTIONAL" => Kind::Fractional,
            other => return Err(unsupported("segments of the type BINARY, LABELMAP or FRACTIONAL", other)),
        };
        let bits = number(&root, tags::BITS_ALLOCATED)?;
        let stored = match (kind, bits) {
            (Kind::Binary, 1) | (Kind::Labels | Kind::Fractional, 8) => ValueType::U8,
            (Kind::Labels, 16) => ValueType::U16,
            _ => {
                return Err(unsupported("1 bit (BINARY), 8 bits, or 16 bits (LABELMAP) for each cell", bits));
            }
        };
        let [columns, rows] = [number(&root, tags::COLUMNS)?, number(&root, tags::ROWS)?];
        limits.size([columns.into(), rows.into(), 1])?;
        let count = root.integer(tags::NUMBER_OF_FRAMES).map_err(refused)?.unwrap_or(1);
        let per_frame = root.items(tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE).map_err(refused)?;
        if u64::try_from(count) != Ok(per_frame.len() as u64) || per_frame.is_empty() {
            let fault = format!("expected descriptions of {count} frames, got {}", per_frame.len());
            return Err(ImageError::corrupt(NAME, fault));
        }
        let cells = u64::from(columns) * u64::from(rows) * per_frame.len() as u64;
        let pixels = pixels(file, cells.saturating_mul(bits.into()))?;
        let shared = root.item(tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE).map_err(refused)?;
        let (grid, frames) = arrange(&per_frame, shared.as_ref(), [columns, rows], kind, limits)?;
        Ok(Self { grid, kind, stored, frames, pixels })
    }

    /// The number of the segment of each cell, 0 where there is none.
    fn labels(&self) -> Result<Vec<u32>, ImageError> {
        let mut labels = reserve(self.grid.cells())?;
        labels.resize(self.grid.cells(), 0_u32);
        let area = self.area();
        for (k, frame) in self.frames.iter().enumerate() {
            let at = frame.slice * area;
            for (cell, label) in labels[at..at + area].iter_mut().enumerate() {
                let found = match (self.kind, self.stored) {
                    (Kind::Binary, _) => self.bit(k * area + cell) * frame.segment,
                    (_, ValueType::U16) => self.pair(k * area + cell),
                    _ => u32::from(self.pixels[k * area + cell]),
                };
                if found != 0 && *label != 0 {
                    return Err(ImageError::Overlap { index: at + cell, segments: [*label, found] });
                }
                *label |= found;
            }
        }
        Ok(labels)
    }

    /// The shares of one segment, as stored.
    fn shares(&self) -> Result<ImageFile, ImageError> {
        if let Some(other) = self.frames.iter().find(|frame| frame.segment != self.frames[0].segment) {
            let found = format!("segments {} and {}", self.frames[0].segment, other.segment);
            return Err(unsupported("one segment where cells have shares (FRACTIONAL)", found));
        }
        let mut values = reserve(self.grid.cells())?;
        values.resize(self.grid.cells(), 0.0_f32);
        let area = self.area();
        for (frame, pixels) in self.frames.iter().zip(self.pixels.chunks_exact(area)) {
            let at = frame.slice * area;
            for (cell, (value, pixel)) in values[at..at + area].iter_mut().zip(pixels).enumerate() {
                *value = Target::integer(i64::from(*pixel), at + cell)?;
            }
        }
        Ok(ImageFile { grid: self.grid, values })
    }

    /// Number of cells of a frame.
    fn area(&self) -> usize {
        let [columns, rows, _] = self.grid.size();
        columns * rows
    }

    /// Bits of all frames follow each other, the least significant one of a byte first.
    fn bit(&self, cell: usize) -> u32 {
        u32::from(self.pixels[cell / 8] >> (cell % 8) & 1)
    }

    fn pair(&self, cell: usize) -> u32 {
        u32::from(u16::from_le_bytes([self.pixels[2 * cell], self.pixels[2 * cell + 1]]))
    }
}

/// Pixels of a number of bits, to which a byte may be added to make their number even.
fn pixels<'f>(file: &'f File<'f>, bits: u64) -> Result<&'f [u8], ImageError> {
    let Some(pixels) = file
        .root()
        .bytes(tags::PIXEL_DATA)
        .map_err(|_| unsupported("pixels without compression", file.syntax()))?
    else {
        return Err(ImageError::corrupt(NAME, "expected pixels (7FE0,0010), got none"));
    };
    let (expected, found) = (bits.div_ceil(8), pixels.len() as u64);
    if found < expected {
        return Err(ImageError::Truncated { place: PIXELS, expected, found });
    }
    if found > expected + 1 {
        return Err(ImageError::Excess { place: PIXELS, expected });
    }
    Ok(pixels)
}

/// An item of the description of a frame, or of that of all frames.
fn described<'f>(
    frame: &Node<'f>,
    shared: Option<&Node<'f>>,
    tag: dicom_core::Tag,
    what: &str,
) -> Result<Node<'f>, ImageError> {
    let own = frame.item(tag).map_err(refused)?;
    let found = match (own, shared) {
        (None, Some(shared)) => shared.item(tag).map_err(refused)?,
        (own, _) => own,
    };
    found.ok_or_else(|| refused(frame.malformed(tag, format!("expected {what} of a frame, got none"))))
}

fn vector<const N: usize>(node: &Node<'_>, tag: dicom_core::Tag, what: &str) -> Result<[f64; N], ImageError> {
    let found = node.array(tag).map_err(refused)?;
    found.ok_or_else(|| refused(node.malformed(tag, format!("expected {what}, got none"))))
}

/// The grid on which all frames lie, and the slice and segment of each.
///
/// Frames are parallel, one behind the other. Slices that no frame is in are empty: programs leave them out.
fn arrange(
    per_frame: &[Node<'_>],
    shared: Option<&Node<'_>>,
    [columns, rows]: [u32; 2],
    kind: Kind,
    limits: &Limits,
) -> Result<(Grid, Vec<Frame>), ImageError> {
    let mut positions = Vec::with_capacity(per_frame.len());
    let mut planes: Option<Plane> = None;
    for frame in per_frame {
        let found = plane(frame, shared)?;
        if *planes.get_or_insert(found) != found {
            return Err(unsupported("frames of one orientation and spacing", "several"));
        }
        let node = described(frame, shared, tags::PLANE_POSITION_SEQUENCE, "the position")?;
        positions.push(vector::<3>(&node, tags::IMAGE_POSITION_PATIENT, "the position of a frame")?);
    }
    let Some(Plane { directions, spacing: [row_spacing, column_spacing], between }) = planes else {
        return Err(ImageError::corrupt(NAME, "expected at least one frame, got none"));
    };
    dicom::check_orientation(&directions).map_err(|detail| ImageError::corrupt(NAME, detail))?;
    let [a, b, c, d, e, f] = directions;
    let (along, down) = ([a, b, c], [d, e, f]);
    let normal = cross(along, down);
    let (first, spacing, slices) = slices(&positions, normal, between)?;
    let depth = slices.iter().max().map_or(1, |last| last.saturating_add(1));
    let size = limits.size([columns.into(), rows.into(), depth])?;
    let affine = std::array::from_fn(|r| {
        [column_spacing * along[r], row_spacing * down[r], spacing * normal[r], first[r]]
    });
    let grid = Grid::new(size, affine, [LengthUnit::Millimetre; 3])?;
    let mut frames = Vec::with_capacity(per_frame.len());
    for (frame, slice) in per_frame.iter().zip(slices) {
        let segment = if kind == Kind::Labels {
            0
        } else {
            let node = described(frame, shared, tags::SEGMENT_IDENTIFICATION_SEQUENCE, "the segment")?;
            number(&node, tags::REFERENCED_SEGMENT_NUMBER)?
        };
        // Every slice is below the depth, which fits.
        frames.push(Frame { slice: slice as usize, segment });
    }
    check_repeated(&frames)?;
    Ok((grid, frames))
}

/// How a frame lies, but for its position.
#[derive(Clone, Copy, PartialEq)]
struct Plane {
    /// Directions of a row and of a column.
    directions: [f64; 6],
    /// Distances of rows and of columns, in mm.
    spacing: [f64; 2],
    /// Distance of slices, if the file says it.
    between: Option<f64>,
}

fn plane(frame: &Node<'_>, shared: Option<&Node<'_>>) -> Result<Plane, ImageError> {
    let node = described(frame, shared, tags::PLANE_ORIENTATION_SEQUENCE, "the orientation")?;
    let directions = vector(&node, tags::IMAGE_ORIENTATION_PATIENT, "the orientation of a frame")?;
    let node = described(frame, shared, tags::PIXEL_MEASURES_SEQUENCE, "the spacing")?;
    let spacing = vector(&node, tags::PIXEL_SPACING, "the spacing of the pixels of a frame")?;
    let between = node.array::<1>(tags::SPACING_BETWEEN_SLICES).map_err(refused)?;
    let thickness = node.array::<1>(tags::SLICE_THICKNESS).map_err(refused)?;
    Ok(Plane { directions, spacing, between: between.or(thickness).map(|[x]| x).filter(|x| *x > 0.0) })
}

/// The position of the first slice, the distance of slices, and the slice of each frame.
///
/// The distance is that of the file if all gaps are multiples of it, else the least gap.
fn slices(
    positions: &[[f64; 3]],
    normal: [f64; 3],
    between: Option<f64>,
) -> Result<([f64; 3], f64, Vec<u64>), ImageError> {
    let height = |p: &[f64; 3]| (0..3).map(|k| normal[k] * p[k]).sum::<f64>();
    let first = positions.iter().min_by(|a, b| height(a).total_cmp(&height(b))).copied().unwrap_or_default();
    let low = height(&first);
    for p in positions {
        let up = height(p) - low;
        let aside = (0..3).map(|k| (p[k] - first[k] - up * normal[k]).powi(2)).sum::<f64>().sqrt();
        if !(aside <= PLACE_MM) {
            return Err(unsupported(
                "frames one behind the other",
                format!("one that is {aside:.3} mm aside"),
            ));
        }
    }
    let mut heights: Vec<f64> = positions.iter().map(|p| height(p) - low).collect();
    heights.sort_by(f64::total_cmp);
    let gaps = heights.windows(2).map(|pair| pair[1] - pair[0]).filter(|gap| *gap > PLACE_MM);
    let least = gaps.fold(f64::INFINITY, f64::min);
    let fits = |spacing: &f64| {
        heights.iter().all(|height| ((height / spacing).round() * spacing - height).abs() <= PLACE_MM)
    };
    let own = least.is_finite().then_some(least);
    let Some(spacing) = [between, own].into_iter().flatten().find(fits) else {
        if own.is_none() {
            return Ok((first, 1.0, vec![0; positions.len()]));
        }
        return Err(unsupported("slices at equal distances", format!("gaps of {least:.3} mm and others")));
    };
    // Casts of real numbers end at the largest whole number, which the limits refuse.
    Ok((first, spacing, positions.iter().map(|p| ((height(p) - low) / spacing).round() as u64).collect()))
}

/// No segment has two frames in one slice.
fn check_repeated(frames: &[Frame]) -> Result<(), ImageError> {
    let mut places: Vec<(usize, u32)> = frames.iter().map(|frame| (frame.slice, frame.segment)).collect();
    places.sort_unstable();
    match places.windows(2).find(|pair| pair[0] == pair[1]) {
        None => Ok(()),
        Some(pair) => {
            let (slice, segment) = pair[0];
            let fault = format!(
                "expected one frame of a segment in a slice, got two of segment {segment} in slice {slice}"
            );
            Err(ImageError::corrupt(NAME, fault))
        }
    }
}
