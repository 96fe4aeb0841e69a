//! DICOM Segmentation: segments of a scan, a bit or a number for each cell.

use std::borrow::Cow;
use std::collections::BTreeMap;

use dicom_dictionary_std::{tags, uids};

use super::error::ImageError;
use super::file::{Description, ImageFile};
use super::format::{GiveLabels, LabelNames, LabelPart};
use super::grid::{Grid, LengthUnit, cross};
use super::limits::{Limits, reserve};
use super::value::{Source, Target, ValueType};
use crate::dicom::{self, Content, File, Node, run_lengths};
use crate::shape::FileError;

/// Name in messages.
pub(super) const NAME: &str = "DICOM Segmentation";

const PIXELS: &str = "DICOM Segmentation pixels";

/// Deepest nesting of sequences.
const DEPTH: usize = 64;

/// Largest distance, in mm, of a frame from the place that the others and the distance of slices give it.
const PLACE_MM: f64 = 0.01;

/// Cells of the label images of overlapping segments, all together, for each cell that one image may have.
const OVERLAPPING: u64 = 16;

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

/// Used part of a file, checked.
struct Segments<'f> {
    grid: Grid,
    kind: Kind,
    stored: ValueType,
    frames: Vec<Frame>,
    pixels: Pixels<'f>,
}

/// Pixels of all frames.
#[derive(Clone, Copy)]
enum Pixels<'f> {
    /// One after the other.
    Plain(&'f [u8]),
    /// Run lengths of each.
    Runs(&'f [&'f [u8]]),
}

impl Pixels<'_> {
    /// Number of bytes in the file.
    fn bytes(self) -> usize {
        match self {
            Self::Plain(bytes) => bytes.len(),
            Self::Runs(runs) => runs.iter().map(|run| run.len()).sum(),
        }
    }
}

/// A frame: the slice it lies in, and its segment if it has one.
#[derive(Clone, Copy)]
struct Frame {
    slice: usize,
    segment: u32,
}

pub(super) fn describe(bytes: &[u8], limits: &Limits) -> Result<Description, ImageError> {
    with_segments(bytes, limits, |segments| {
        let cells = segments.grid.cells() as u64 * size_of::<f32>() as u64;
        let elements = bytes.len().saturating_sub(segments.pixels.bytes()) as u64;
        let frame = 2 * segments.area() as u64;
        let memory_bytes = cells + frame + ELEMENT_BYTES.saturating_mul(elements);
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

/// The label image of all segments, or where segments overlap, one for each that is `wanted`.
pub(super) fn read_parts(
    bytes: &[u8],
    limits: &Limits,
    wanted: &dyn Fn(u32) -> bool,
    give: GiveLabels<'_>,
) -> Result<(), ImageError> {
    with_segments(bytes, limits, |segments| match (segments.kind, segments.labels()) {
        (Kind::Fractional, _) => {
            Err(unsupported("segments of whole cells (BINARY or LABELMAP)", "FRACTIONAL"))
        }
        (_, Ok(values)) => {
            give(LabelPart::whole(ImageFile { grid: segments.grid, values }));
            Ok(())
        }
        (_, Err(ImageError::Overlap { .. })) => segments.each(limits, wanted, give),
        (_, Err(other)) => Err(other),
    })
}

/// Labels of segments by their numbers.
pub(super) fn names(bytes: &[u8], limits: &Limits) -> Result<LabelNames, ImageError> {
    let content = Content::new(bytes, limits.bytes, |_| Ok(())).map_err(refused)?;
    let file = content.parse(DEPTH).map_err(refused)?;
    let mut names = BTreeMap::new();
    for node in file.root().items(tags::SEGMENT_SEQUENCE).map_err(refused)? {
        let number = number(&node, tags::SEGMENT_NUMBER)?;
        if let Some(name) = node.short_text(tags::SEGMENT_LABEL).map_err(refused)? {
            names.insert(number, name);
        }
    }
    Ok(LabelNames { of: names, warnings: file.warning().into_iter().collect() })
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
        let pixels = pixels(file, kind, per_frame.len(), cells.saturating_mul(bits.into()))?;
        let shared = root.item(tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE).map_err(refused)?;
        let (grid, frames) = arrange(&per_frame, shared.as_ref(), [columns, rows], kind, limits)?;
        let grid = grid.with_open_ends(referenced(&root)? != grid.size()[2]);
        Ok(Self { grid, kind, stored, frames, pixels })
    }

    /// Gives on a label image for each segment that is wanted, in the order of their numbers: of the slices from its first frame to
    /// its last one, and one more on each side, so that these are on the edge only where the volume ends.
    fn each(
        &self,
        limits: &Limits,
        wanted: &dyn Fn(u32) -> bool,
        give: GiveLabels<'_>,
    ) -> Result<(), ImageError> {
        let mut order: Vec<usize> = (0..self.frames.len()).collect();
        order.sort_by_key(|k| (self.frames[*k].segment, self.frames[*k].slice));
        let mut cells = 0_u64;
        for own in order.chunk_by(|a, b| self.frames[*a].segment == self.frames[*b].segment) {
            let segment = self.frames[own[0]].segment;
            if segment == 0 || !wanted(segment) {
                continue;
            }
            let [first, last] = [own[0], own[own.len() - 1]].map(|k| self.frames[k].slice);
            let first = first.saturating_sub(1);
            let count = (last + 2).min(self.grid.size()[2]) - first;
            let Some(grid) = self.grid.layers(first, count) else { continue };
            cells = cells.saturating_add(grid.cells() as u64);
            if cells > limits.cells.saturating_mul(OVERLAPPING) {
                let found = format!("{} and more after {segment} of them", cells);
                return Err(unsupported("overlapping segments of a bounded number of cells in all", found));
            }
            let image = ImageFile { grid, values: self.of_segment(own, first, &grid)? };
            if !give(LabelPart { image, label: Some(segment), first }) {
                break;
            }
        }
        Ok(())
    }

    /// The cells of one segment, by its frames, in a grid that begins with a slice.
    fn of_segment(&self, frames: &[usize], first: usize, grid: &Grid) -> Result<Vec<u32>, ImageError> {
        let mut labels = reserve(grid.cells())?;
        labels.resize(grid.cells(), 0_u32);
        let area = self.area();
        for k in frames {
            let Frame { slice, segment } = self.frames[*k];
            let at = (slice - first) * area;
            let pixels = self.frame(*k)?;
            for (cell, label) in labels[at..at + area].iter_mut().enumerate() {
                *label = bit(&pixels, k * area + cell) * segment;
            }
        }
        Ok(labels)
    }

    /// The number of the segment of each cell, 0 where there is none.
    fn labels(&self) -> Result<Vec<u32>, ImageError> {
        let mut labels = reserve(self.grid.cells())?;
        labels.resize(self.grid.cells(), 0_u32);
        let area = self.area();
        for (k, frame) in self.frames.iter().enumerate() {
            let at = frame.slice * area;
            let pixels = self.frame(k)?;
            for (cell, label) in labels[at..at + area].iter_mut().enumerate() {
                let found = match (self.kind, self.stored) {
                    (Kind::Binary, _) => bit(&pixels, k * area + cell) * frame.segment,
                    (_, ValueType::U16) => {
                        u32::from(u16::from_le_bytes([pixels[2 * cell], pixels[2 * cell + 1]]))
                    }
                    _ => u32::from(pixels[cell]),
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
        for (k, frame) in self.frames.iter().enumerate() {
            let at = frame.slice * area;
            let pixels = self.frame(k)?;
            for (cell, (value, pixel)) in values[at..at + area].iter_mut().zip(&*pixels).enumerate() {
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

    /// The bytes of a frame; of bits, which of all frames follow each other, those of all.
    fn frame(&self, k: usize) -> Result<Cow<'_, [u8]>, ImageError> {
        let bytes = if self.stored == ValueType::U16 { 2 } else { 1 };
        let area = self.area();
        match self.pixels {
            Pixels::Plain(pixels) if self.kind == Kind::Binary => Ok(pixels.into()),
            Pixels::Plain(pixels) => Ok(pixels[k * area * bytes..(k + 1) * area * bytes].into()),
            Pixels::Runs(runs) => run_lengths::frame(runs[k], area, bytes)
                .map(Cow::from)
                .map_err(|fault| ImageError::corrupt(NAME, format!("frame {k}: {fault}"))),
        }
    }
}

/// A bit, the least significant one of a byte first.
fn bit(pixels: &[u8], cell: usize) -> u32 {
    u32::from(pixels[cell / 8] >> (cell % 8) & 1)
}

/// Number of images that the segments refer to: the slices of the volume that was segmented, if each image is one.
fn referenced(root: &Node<'_>) -> Result<usize, ImageError> {
    let mut count = 0;
    for series in root.items(tags::REFERENCED_SERIES_SEQUENCE).map_err(refused)? {
        count += series.items(tags::REFERENCED_INSTANCE_SEQUENCE).map_err(refused)?.len();
    }
    Ok(count)
}

/// Pixels of a number of bits, to which a byte may be added to make their number even, or run lengths of each frame.
fn pixels<'f>(file: &'f File<'f>, kind: Kind, frames: usize, bits: u64) -> Result<Pixels<'f>, ImageError> {
    let root = file.root();
    if let (true, Some(runs)) =
        (file.has_run_lengths() && kind != Kind::Binary, root.fragments(tags::PIXEL_DATA))
    {
        return match runs.len() == frames {
            true => Ok(Pixels::Runs(runs)),
            false => Err(ImageError::corrupt(
                NAME,
                format!("expected {frames} frames of run lengths, got {}", runs.len()),
            )),
        };
    }
    let plain = root.bytes(tags::PIXEL_DATA);
    let Some(pixels) =
        plain.map_err(|_| unsupported("pixels as they are, or run lengths of bytes", file.syntax()))?
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
    Ok(Pixels::Plain(pixels))
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
