//! A region to records.

use serde_json::{Map, Value as Json, json};

use super::super::limits::{Budget, Limits};
use super::super::objects::{Giving, Part};
use super::super::options::ReadOptions;
use super::super::record::Sink;
use super::super::record::{Geometry, Points, Record};
use super::super::source::Source;
use super::bytes::Bytes;
use super::nesting::{COMPARISONS, areas};
use super::outline::{bezier, ellipse, rounded};
use super::{CLOSE, HEADER, LINE_TO, MOVE, RECTANGLE, SUB_PIXEL, TYPES};
use crate::error::{FileError, Place};
use crate::summary::Summary;

/// Subtypes that are drawings, no shapes.
const TEXT: u16 = 1;
const IMAGE: u16 = 4;
/// Subtypes of freehand regions with an axis at offset 18.
const ELLIPSE: u16 = 3;
const ROTATED_RECTANGLE: u16 = 5;
/// Option: a polygon is drawn as a spline through its points.
const SPLINE: u16 = 1;

/// A file with the parts of its header that decide how it is read.
struct Region<'a> {
    bytes: Bytes<'a>,
    version: u16,
    kind: u8,
    subtype: u16,
    options: u16,
    /// Left, top, width and height.
    bounds: [f64; 4],
}

pub(super) fn read(
    source: &mut Source<'_>,
    options: &ReadOptions,
    sink: Sink<'_>,
) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let data = source.bytes()?;
    let region = Region::new(Bytes(&data))?;
    let mut summary = Summary::default();
    let place = Place::item(0);
    let mut template = Record::new(Geometry::Landmarks(Points::new(2)), place.clone());
    region.describe(&mut template)?;
    let name = template.name.clone();
    let unnamed = || name.as_deref().unwrap_or_default();
    if !options.selects(unnamed()) {
        summary.drop("regions that are not selected", name.as_deref(), || place.clone());
        return Ok(summary);
    }
    if region.subtype == TEXT || region.subtype == IMAGE {
        let what = if region.subtype == TEXT { "texts" } else { "images" };
        summary.drop(what, name.as_deref(), || place.clone());
        return Ok(summary);
    }
    if region.options & SPLINE != 0 {
        summary.warnings.push("ImageJ draws a spline through the points, which are given as they are".into());
    }
    let parts = region.parts(&limits, &source.budget(COMPARISONS))?;
    if parts.is_empty() {
        summary.drop("empty regions", name.as_deref(), || place.clone());
    }
    let giving = Giving { holes: options.holes.unwrap_or_default(), limits: &limits };
    giving.give(parts, 0, template, &mut summary, sink)?;
    Ok(summary)
}

impl<'a> Region<'a> {
    fn new(bytes: Bytes<'a>) -> Result<Self, FileError> {
        let magic = bytes.slice(0, HEADER)?;
        if !magic.starts_with(b"Iout") {
            return Err(FileError::malformed(
                Place::byte(0),
                "expected an ImageJ ROI that begins with 'Iout', got other bytes",
            ));
        }
        let [top, left, mut bottom, mut right] =
            [bytes.bound(8)?, bytes.bound(10)?, bytes.bound(12)?, bytes.bound(14)?];
        // Far ends may have wrapped around where the near ones have not.
        bottom += if bottom < top { 65536.0 } else { 0.0 };
        right += if right < left { 65536.0 } else { 0.0 };
        let mut region = Self {
            bytes,
            version: bytes.u16(4)?,
            kind: bytes.u8(6)?,
            subtype: bytes.u16(48)?,
            options: bytes.u16(50)?,
            bounds: [left, top, right - left, bottom - top],
        };
        if region.has_fractions()
            && region.version >= 223
            && (region.kind == RECTANGLE || region.word() == "oval")
        {
            region.bounds = [bytes.f32(18)?, bytes.f32(22)?, bytes.f32(26)?, bytes.f32(30)?];
            if let Some(size) = region.bounds[2..].iter().find(|size| **size < 0.0) {
                let detail = format!("expected width and height of at least 0, got {size}");
                return Err(FileError::malformed(Place::byte(26), detail));
            }
        }
        Ok(region)
    }

    fn has_fractions(&self) -> bool {
        self.version >= 222 && self.options & SUB_PIXEL != 0
    }

    /// Word for the type; empty for one that is not known.
    fn word(&self) -> &'static str {
        TYPES.get(usize::from(self.kind)).copied().unwrap_or_default()
    }

    /// Number of floats of a composite, 0 for another region.
    fn path_length(&self) -> Result<usize, FileError> {
        self.bytes.size(36, "a length of a path of at least 0")
    }

    fn parts(&self, limits: &Limits, work: &Budget) -> Result<Vec<Part>, FileError> {
        let [left, top, width, height] = self.bounds;
        if self.path_length()? > 0 {
            return self.composite(limits, work);
        }
        let ring = |points| vec![Part::Area(vec![points])];
        Ok(match self.word() {
            "rectangle" => {
                let arc = f64::from(self.bytes.u16(54)?);
                let corners = [left, top, left + width, top, left + width, top + height, left, top + height];
                let square = || Points::from_rows(2, corners.to_vec());
                ring(if arc > 0.0 { rounded(left, top, width, height, arc, arc) } else { square() })
            }
            "oval" => ring(ellipse(left, top, width, height)),
            "line" => {
                let ends =
                    [self.bytes.f32(18)?, self.bytes.f32(22)?, self.bytes.f32(26)?, self.bytes.f32(30)?];
                vec![Part::Line(Points::from_rows(2, ends.to_vec()))]
            }
            "none" => Vec::new(),
            "" => {
                let detail = format!("expected a type of at most 10, got {}", self.kind);
                return Err(FileError::unsupported(Place::byte(6), detail));
            }
            word => {
                let points = self.points(limits)?;
                match word {
                    _ if points.is_empty() => Vec::new(),
                    "polygon" | "freehand" | "traced" => ring(points),
                    "point" => vec![Part::Points(points)],
                    _ => vec![Part::Line(points)],
                }
            }
        })
    }

    /// Number of points, after a check that the file can hold them.
    fn count(&self, limits: &Limits) -> Result<usize, FileError> {
        let (mut count, mut at) = (usize::from(self.bytes.u16(16)?), 16);
        let is_axis = self.word() == "freehand" && matches!(self.subtype, ELLIPSE | ROTATED_RECTANGLE);
        if count == 0 && !is_axis {
            (count, at) = (self.bytes.size(18, "a number of points of at least 0")?, 18);
        }
        limits.points(count as u64, || Place::byte(at))
    }

    fn points(&self, limits: &Limits) -> Result<Points, FileError> {
        let count = self.count(limits)?;
        let size = if self.has_fractions() { 12 } else { 4 };
        self.bytes.slice(HEADER, count.saturating_mul(size))?;
        let mut points = Points::new(2);
        for k in 0..count {
            if self.has_fractions() {
                let at = HEADER + 4 * count + 4 * k;
                points.push(&[self.bytes.f32(at)?, self.bytes.f32(at + 4 * count)?]);
            } else {
                let at = HEADER + 2 * k;
                let [x, y] = [self.bytes.u16(at)?, self.bytes.u16(at + 2 * count)?];
                points.push(&[self.bounds[0] + f64::from(x), self.bounds[1] + f64::from(y)]);
            }
        }
        Ok(points)
    }

    /// The rings and lines of a composite.
    fn composite(&self, limits: &Limits, work: &Budget) -> Result<Vec<Part>, FileError> {
        if self.kind != RECTANGLE {
            let detail = format!("expected the type 1 of a composite, got {}", self.kind);
            return Err(FileError::malformed(Place::byte(6), detail));
        }
        let length = self.path_length()?;
        self.bytes.slice(HEADER, length.saturating_mul(4))?;
        let mut path = Path { points: Points::new(2), rings: Vec::new(), lines: Vec::new(), count: 0 };
        let mut at = HEADER;
        let end = HEADER + 4 * length;
        while at < end {
            let command = self.bytes.f32(at)?;
            let numbers = match command {
                MOVE | LINE_TO => 2,
                2.0 => 4,
                3.0 => 6,
                CLOSE => 0,
                _ => {
                    let detail = format!("expected a command of a path from 0 to 4, got {command}");
                    return Err(FileError::malformed(Place::byte(at as u64), detail));
                }
            };
            if at + 4 + 4 * numbers > end {
                let detail = format!("expected {numbers} numbers of a command, got the end of the path");
                return Err(FileError::truncated(Place::byte(at as u64), detail));
            }
            let mut controls = Vec::with_capacity(4);
            for k in 0..numbers / 2 {
                let x = at + 4 + 8 * k;
                controls.push([self.bytes.f32(x)?, self.bytes.f32(x + 4)?]);
            }
            path.follow(command, &controls, Place::byte(at as u64))?;
            limits.points(path.count, || Place::byte(at as u64))?;
            at += 4 + 4 * numbers;
        }
        path.end(false);
        let mut parts = areas(path.rings, work)?;
        parts.extend(path.lines.into_iter().map(Part::Line));
        Ok(parts)
    }

    /// Name, position, colours and other facts of the headers.
    fn describe(&self, record: &mut Record) -> Result<(), FileError> {
        let mut metadata = Map::new();
        let composite = self.path_length()? > 0;
        metadata.insert("type".into(), if composite { "composite" } else { self.word() }.into());
        if self.version >= 218 {
            let colours = [("stroke_color", self.bytes.u32(40)?), ("fill_color", self.bytes.u32(44)?)];
            for (name, colour) in colours.into_iter().filter(|(_, colour)| *colour != 0) {
                metadata.insert(name.into(), format!("#{colour:08x}").into());
            }
            let width = self.bytes.u16(34)?;
            if width > 0 {
                metadata.insert("stroke_width".into(), width.into());
            }
        }
        if !composite && self.word() == "freehand" && matches!(self.subtype, ELLIPSE | ROTATED_RECTANGLE) {
            let axis = [self.bytes.f32(18)?, self.bytes.f32(22)?, self.bytes.f32(26)?, self.bytes.f32(30)?];
            // An aspect ratio for an ellipse, a width for a rectangle.
            let (name, other) = if self.subtype == ELLIPSE {
                ("ellipse", "aspect_ratio")
            } else {
                ("rotated_rectangle", "width")
            };
            metadata.insert(name.into(), json!({"axis": axis, other: self.bytes.f32(52)?}));
        }
        let position = self.bytes.i32(56)?;
        if position > 0 {
            metadata.insert("position".into(), position.into());
        }
        let second = self.bytes.size(60, "an offset of at least 0")?;
        if second > 0 {
            record.name = self.second_header(second, &mut metadata)?;
        }
        // The writer keeps a label among the properties.
        if let Some(Json::Object(properties)) = metadata.get_mut("properties") {
            record.label = properties.remove("label").and_then(|label| label.as_str().map(str::to_owned));
            if properties.is_empty() {
                metadata.remove("properties");
            }
        }
        record.metadata = metadata;
        Ok(())
    }

    /// The second header; the name of the region.
    fn second_header(
        &self,
        at: usize,
        metadata: &mut Map<String, Json>,
    ) -> Result<Option<String>, FileError> {
        self.bytes.slice(at, HEADER)?;
        for (name, offset) in [("channel", 4), ("slice", 8), ("frame", 12)] {
            let number = self.bytes.i32(at + offset)?;
            if number > 0 {
                metadata.insert(name.into(), number.into());
            }
        }
        let (start, length) = (
            self.bytes.size(at + 16, "an offset of at least 0")?,
            self.bytes.size(at + 20, "a length of at least 0")?,
        );
        let name = if start > 0 && length > 0 { Some(self.bytes.text(start, length)?) } else { None };
        let group = self.bytes.u8(at + 30)?;
        if group > 0 {
            metadata.insert("group".into(), group.into());
        }
        let width = self.bytes.f32(at + 36)?;
        if width > 0.0 {
            metadata.insert("stroke_width".into(), json!(width));
        }
        let (start, length) = (
            self.bytes.size(at + 40, "an offset of at least 0")?,
            self.bytes.size(at + 44, "a length of at least 0")?,
        );
        if start > 0 && length > 0 {
            metadata.insert("properties".into(), properties(&self.bytes.text(start, length)?));
        }
        let counters = self.bytes.size(at + 48, "an offset of at least 0")?;
        if counters > 0 && self.word() == "point" {
            self.counters(counters, metadata)?;
        }
        Ok(name)
    }

    /// Counter and slice of each point.
    fn counters(&self, at: usize, metadata: &mut Map<String, Json>) -> Result<(), FileError> {
        let count = self.count(&Limits::default())?;
        let numbers = self.bytes.slice(at, count.saturating_mul(4))?;
        let numbers = || numbers.chunks_exact(4).map(|b| u32::from_be_bytes([b[0], b[1], b[2], b[3]]));
        metadata.insert("counters".into(), numbers().map(|number| number & 0xff).collect());
        metadata.insert("slices".into(), numbers().map(|number| number >> 8).collect());
        Ok(())
    }
}

/// A path that is being followed.
struct Path {
    points: Points,
    rings: Vec<Points>,
    lines: Vec<Points>,
    /// Number of points so far.
    count: u64,
}

impl Path {
    fn follow(&mut self, command: f64, controls: &[[f64; 2]], place: Place) -> Result<(), FileError> {
        if command == MOVE {
            self.end(false);
        } else if command == CLOSE {
            self.end(true);
            return Ok(());
        }
        let from = self.points.rows().next_back().map(|row| [row[0], row[1]]);
        let from = match (from, controls) {
            (_, [point]) => {
                self.points.push(point);
                self.count += 1;
                return Ok(());
            }
            (Some(from), _) => from,
            (None, _) => {
                let detail = "expected a command that begins a path before a curve, got none";
                return Err(FileError::malformed(place, detail));
            }
        };
        let controls: Vec<[f64; 2]> = std::iter::once(from).chain(controls.iter().copied()).collect();
        for point in bezier(&controls) {
            self.points.push(&point);
            self.count += 1;
        }
        Ok(())
    }

    /// Ends the ring or line at hand. A single point is only where a path was moved to.
    fn end(&mut self, closed: bool) {
        let mut points = std::mem::replace(&mut self.points, Points::new(2));
        let returns = points.len() > 3 && points.open();
        if closed || returns {
            points.open();
            if points.len() > 2 {
                self.rings.push(points);
                return;
            }
        }
        if points.len() > 1 {
            self.lines.push(points);
        }
    }
}

/// Properties as lines of a name, a colon and a value; a text of another form as it is.
fn properties(text: &str) -> Json {
    let lines = text.lines().filter(|line| !line.trim().is_empty());
    let pairs = lines
        .map(|line| line.split_once(':').map(|(name, value)| (name.trim().to_owned(), value.trim().into())));
    pairs.collect::<Option<Map<String, Json>>>().map_or_else(|| text.into(), Json::Object)
}
