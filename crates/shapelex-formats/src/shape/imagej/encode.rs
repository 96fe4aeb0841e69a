//! A record, or the rings of one object, to a region.

use std::io::Write;

use serde_json::{Map, Value as Json};

use super::super::objects::{Grouping, PartRef, parts, refusal};
use super::super::options::WriteOptions;
use super::super::record::{Points, Record};
use super::super::text::parts_left_out;
use super::super::write::{Opened, Output, Writer};
use super::{CLOSE, HEADER, LINE, LINE_TO, MOVE, POINT, POLYLINE, RECTANGLE, SUB_PIXEL, type_number};
use crate::error::{FaultKind, FileError};
use crate::summary::Summary;

/// Version of the files: the first one with properties of points and groups.
const VERSION: u16 = 228;
/// Numbers that bounds can hold, see [`Bytes::bound`](super::bytes::Bytes::bound).
const BOUNDS: std::ops::RangeInclusive<f64> = -5000.0..=60535.0;

/// A file that is being written.
struct Region<'a> {
    output: Output<'a>,
    grouping: Grouping,
    summary: Summary,
}

pub(super) fn open<'a>(output: Output<'a>, _: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(Region { output, grouping: Grouping::default(), summary: Summary::default() }))
}

impl Writer for Region<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        if !self.grouping.push(record, &mut self.summary).is_empty() {
            let name = record.name.as_ref().map(|name| format!(", '{name}'")).unwrap_or_default();
            let detail = format!("expected one shape, as a file of ImageJ ROI holds, got a second one{name}");
            return Err(FileError::unsupported(record.place.clone(), detail));
        }
        Ok(())
    }

    fn held(&self) -> usize {
        self.grouping.held()
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        let records = self.grouping.finish();
        let Some(first) = records.first() else {
            let detail = "expected one shape, as a file of ImageJ ROI holds, got none";
            return Err(FileError::new(FaultKind::Unsupported, detail));
        };
        let (file, rounded) = file(&records, first, &mut self.summary)?;
        self.output.write_all(&file)?;
        warn(rounded, &mut self.summary);
        self.output.flush()?;
        self.summary.records = self.grouping.count();
        Ok(self.summary)
    }
}

/// A region before its second header.
struct Content {
    kind: u8,
    /// Number of points, 0 for a line or a composite.
    count: usize,
    options: u16,
    /// Bytes 18 to 33.
    ends: [f64; 4],
    /// Number of floats of a path.
    path: usize,
    /// Bytes after the first header.
    bytes: Vec<u8>,
}

impl Content {
    /// Whether an entry of the metadata is written.
    fn keeps(&self, key: &str, value: &Json, metadata: &Map<String, Json>) -> bool {
        match key {
            "type" if self.path > 0 => value == "composite",
            "type" => type_number(value.as_str().unwrap_or_default()) == Some(self.kind),
            "stroke_color" | "fill_color" => colour(metadata, key) != [0; 4],
            "stroke_width" => stroke_width(metadata) > 0.0,
            "position" | "channel" | "slice" | "frame" => positive(metadata, key) != [0; 4],
            "group" => group(metadata) > 0,
            "properties" => value.is_object() || value.is_string(),
            "counters" | "slices" => self.kind == POINT && !counters(metadata, self.count).is_empty(),
            _ => false,
        }
    }
}

/// Says how many coordinates are rounded.
pub(super) fn warn(rounded: u64, summary: &mut Summary) {
    if rounded > 0 {
        summary.warnings.push(format!("{rounded} coordinates are rounded to single precision"));
    }
}

/// The bytes of a region, and how many coordinates are rounded in it. Content that it cannot hold is counted.
pub(super) fn file(
    records: &[Record],
    first: &Record,
    summary: &mut Summary,
) -> Result<(Vec<u8>, u64), FileError> {
    let parts = parts(records, "ImageJ ROI")?;
    let all: Vec<&Points> = parts
        .iter()
        .flat_map(|part| match part {
            PartRef::Area(rings) => rings.clone(),
            PartRef::Line(points) | PartRef::Points(points) => vec![*points],
        })
        .collect();
    if let Some(points) = all.iter().find(|points| points.dimension() != 2) {
        return Err(refusal(first, "ImageJ ROI", &format!("points of {} coordinates", points.dimension())));
    }
    let rounded = check_precision(&all, first)?;
    parts_left_out(summary, first, &["label", "ring"]);
    let content = content(&parts, first)?;
    let metadata = &first.metadata;
    let width = stroke_width(metadata);
    for (key, _) in metadata.iter().filter(|(key, value)| !content.keeps(key, value, metadata)) {
        summary.drop("metadata", Some(key), || first.place.clone());
    }
    let mut file = header(&content, bounds(&all), metadata, width)?;
    file.extend_from_slice(&content.bytes);
    second_header(&mut file, first, width, if content.kind == POINT { content.count } else { 0 })?;
    Ok((file, rounded))
}

/// Content after the header, by the kind of the shape and the type that the metadata wish for.
fn content(parts: &[PartRef<'_>], first: &Record) -> Result<Content, FileError> {
    let word = first.metadata.get("type").and_then(Json::as_str).unwrap_or_default();
    let known = |words: &[&str], other: u8| {
        words.iter().find(|known| **known == word).and_then(|word| type_number(word)).unwrap_or(other)
    };
    Ok(match parts {
        [PartRef::Area(rings)] if rings.len() == 1 => {
            plain(rings[0], known(&["polygon", "freehand", "traced"], 0))
        }
        [PartRef::Line(points)]
            if points.len() == 2 && known(&["line", "polyline", "freeline"], LINE) == LINE =>
        {
            line(points)
        }
        [PartRef::Line(points)] => plain(points, known(&["polyline", "freeline", "angle"], POLYLINE)),
        [PartRef::Points(points)] => plain(points, POINT),
        _ => composite(parts, first)?,
    })
}

/// The first header.
fn header(
    content: &Content,
    [left, top, right, bottom]: [f64; 4],
    metadata: &Map<String, Json>,
    width: f64,
) -> Result<Vec<u8>, FileError> {
    let mut file = Vec::with_capacity(HEADER + content.bytes.len() + HEADER);
    file.extend_from_slice(b"Iout");
    file.extend_from_slice(&VERSION.to_be_bytes());
    file.extend_from_slice(&[content.kind, 0]);
    for bound in [top, left, bottom, right] {
        file.extend_from_slice(&short(bound));
    }
    let few = u16::try_from(content.count).ok();
    file.extend_from_slice(&few.unwrap_or(0).to_be_bytes());
    if few.is_some() {
        content.ends.iter().for_each(|x| file.extend_from_slice(&single(*x)));
    } else {
        file.extend_from_slice(&size(content.count)?);
        file.extend_from_slice(&[0; 12]);
    }
    file.extend_from_slice(&short(width.clamp(0.0, 32767.0)));
    file.extend_from_slice(&size(content.path)?);
    file.extend_from_slice(&colour(metadata, "stroke_color"));
    file.extend_from_slice(&colour(metadata, "fill_color"));
    file.extend_from_slice(&[0; 2]);
    file.extend_from_slice(&content.options.to_be_bytes());
    file.extend_from_slice(&[0; 4]);
    file.extend_from_slice(&positive(metadata, "position"));
    file.extend_from_slice(&size(HEADER + content.bytes.len())?);
    Ok(file)
}

/// Refuses numbers that are not finite in single precision; how many are rounded.
fn check_precision(all: &[&Points], record: &Record) -> Result<u64, FileError> {
    let numbers = || all.iter().flat_map(|points| points.coordinates());
    if let Some(x) = numbers().find(|x| !nearest(**x).is_finite()) {
        return Err(refusal(record, "ImageJ ROI", &format!("a coordinate {x:e} beyond single precision")));
    }
    Ok(numbers().filter(|x| f64::from(nearest(**x)) != **x).count() as u64)
}

/// Points of one curve: as whole numbers if they are some, else with fractions beside them.
fn plain(points: &Points, kind: u8) -> Content {
    let [left, top, ..] = bounds(&[points]);
    let whole = points.coordinates().iter().all(|x| x.fract() == 0.0 && BOUNDS.contains(x));
    let mut bytes = Vec::with_capacity(points.len() * 12);
    for (axis, origin) in [(0, left), (1, top)] {
        for row in points.rows() {
            bytes.extend_from_slice(&short(
                (row[axis].clamp(*BOUNDS.start(), *BOUNDS.end()) - origin).floor(),
            ));
        }
    }
    if !whole {
        for axis in [0, 1] {
            points.rows().for_each(|row| bytes.extend_from_slice(&single(row[axis])));
        }
    }
    let options = if whole { 0 } else { SUB_PIXEL };
    Content { kind, count: points.len(), options, ends: [0.0; 4], path: 0, bytes }
}

fn line(points: &Points) -> Content {
    let mut ends = [0.0; 4];
    ends.iter_mut().zip(points.coordinates()).for_each(|(end, x)| *end = *x);
    Content { kind: LINE, count: 0, options: SUB_PIXEL, ends, path: 0, bytes: Vec::new() }
}

/// Areas and lines as a path.
fn composite(parts: &[PartRef<'_>], record: &Record) -> Result<Content, FileError> {
    let mut path = Vec::new();
    let mut follow = |points: &Points, closed: bool| {
        for (k, row) in points.rows().enumerate() {
            path.extend_from_slice(&[if k == 0 { MOVE } else { LINE_TO }, row[0], row[1]]);
        }
        if closed {
            path.push(CLOSE);
        }
    };
    for part in parts {
        match part {
            PartRef::Area(rings) => rings.iter().for_each(|ring| follow(ring, true)),
            PartRef::Line(points) => follow(points, false),
            PartRef::Points(_) => return Err(refusal(record, "ImageJ ROI", "points beside other parts")),
        }
    }
    let bytes = path.iter().flat_map(|x| single(*x)).collect();
    Ok(Content { kind: RECTANGLE, count: 0, options: 0, ends: [0.0; 4], path: path.len(), bytes })
}

/// Appends the second header with name, properties and counters of points.
fn second_header(file: &mut Vec<u8>, record: &Record, width: f64, count: usize) -> Result<(), FileError> {
    let metadata = &record.metadata;
    let name: Vec<u16> = record.name.iter().flat_map(|name| name.encode_utf16()).collect();
    let properties: Vec<u16> = properties(record).encode_utf16().collect();
    let counters = counters(metadata, count);
    let start = file.len() + HEADER;
    let after = start + 2 * name.len();
    let last = after + 2 * properties.len();
    let at = |offset: usize, length: usize| size(if length == 0 { 0 } else { offset });
    file.extend_from_slice(&[0; 4]);
    for key in ["channel", "slice", "frame"] {
        file.extend_from_slice(&positive(metadata, key));
    }
    file.extend_from_slice(&at(start, name.len())?);
    file.extend_from_slice(&size(name.len())?);
    file.extend_from_slice(&[0; 6]);
    file.extend_from_slice(&[group(metadata), 0]);
    file.extend_from_slice(&[0; 4]);
    file.extend_from_slice(&single(width));
    file.extend_from_slice(&at(after, properties.len())?);
    file.extend_from_slice(&size(properties.len())?);
    file.extend_from_slice(&at(last, counters.len())?);
    file.extend_from_slice(&[0; 12]);
    debug_assert_eq!(file.len(), start);
    file.extend(name.into_iter().chain(properties).flat_map(u16::to_be_bytes));
    file.extend(counters.into_iter().flat_map(u32::to_be_bytes));
    Ok(())
}

/// Counter (8 bits) and slice (24 bits) of every point, if the metadata have as many.
fn counters(metadata: &Map<String, Json>, count: usize) -> Vec<u32> {
    let numbers = |key: &str, most: u32| -> Vec<u32> {
        let list = metadata.get(key).and_then(Json::as_array).into_iter().flatten();
        let number = |value: &Json| value.as_u64().and_then(|number| u32::try_from(number).ok());
        list.filter_map(number).filter(|number| *number <= most).collect()
    };
    let (counters, slices) = (numbers("counters", 0xff), numbers("slices", 0xff_ffff));
    if counters.len() != count || slices.len() != count {
        return Vec::new();
    }
    counters.into_iter().zip(slices).map(|(counter, slice)| slice << 8 | counter).collect()
}

/// Properties as lines of a name, a colon and a value; the label of the record is one of them.
fn properties(record: &Record) -> String {
    let label = record.label.as_ref().map(|label| format!("label: {}\n", label.replace(['\n', '\r'], " ")));
    let others = match record.metadata.get("properties") {
        Some(Json::Object(properties)) => {
            let line = |(name, value): (&String, &Json)| {
                format!("{name}: {}\n", value.as_str().map_or_else(|| value.to_string(), str::to_owned))
            };
            properties.iter().map(line).collect()
        }
        Some(Json::String(text)) => text.clone(),
        _ => String::new(),
    };
    label.unwrap_or_default() + &others
}

/// Left, top, right and bottom in whole pixels, as far as bounds can hold them.
fn bounds(all: &[&Points]) -> [f64; 4] {
    let mut bounds = [f64::MAX, f64::MAX, f64::MIN, f64::MIN];
    for row in all.iter().flat_map(|points| points.rows()) {
        for axis in [0, 1] {
            bounds[axis] = bounds[axis].min(row[axis].floor());
            bounds[axis + 2] = bounds[axis + 2].max(row[axis].ceil());
        }
    }
    bounds.map(|bound| bound.clamp(*BOUNDS.start(), *BOUNDS.end()))
}

/// The low 16 bits of a whole number within ±65535.
#[allow(clippy::cast_possible_truncation, reason = "clamped to the range of bounds and their differences")]
fn short(number: f64) -> [u8; 2] {
    let [_, _, high, low] = (number.clamp(-65535.0, 65535.0) as i32).to_be_bytes();
    [high, low]
}

#[allow(
    clippy::cast_possible_truncation,
    reason = "rounding to the precision of the format, which is reported"
)]
fn nearest(number: f64) -> f32 {
    number as f32
}

fn single(number: f64) -> [u8; 4] {
    nearest(number).to_be_bytes()
}

fn size(number: usize) -> Result<[u8; 4], FileError> {
    i32::try_from(number).map(i32::to_be_bytes).map_err(|_| {
        let detail =
            format!("expected a region of less than 2³¹ bytes, got one with a size or offset of {number}");
        FileError::new(FaultKind::TooLarge, detail)
    })
}

/// Width of the stroke, 0 if there is none.
fn stroke_width(metadata: &Map<String, Json>) -> f64 {
    let width = metadata.get("stroke_width").and_then(Json::as_f64);
    width.filter(|width| *width > 0.0).unwrap_or(0.0)
}

/// Group of a region, 0 if there is none or it is not a number of 8 bits.
fn group(metadata: &Map<String, Json>) -> u8 {
    let group = metadata.get("group").and_then(Json::as_u64).and_then(|group| u8::try_from(group).ok());
    group.unwrap_or(0)
}

/// A number of the metadata, 0 if there is none or it is not a number of 31 bits.
fn positive(metadata: &Map<String, Json>, key: &str) -> [u8; 4] {
    let number = metadata.get(key).and_then(Json::as_i64).and_then(|number| i32::try_from(number).ok());
    number.filter(|number| *number > 0).unwrap_or(0).to_be_bytes()
}

/// A colour written `#aarrggbb`.
fn colour(metadata: &Map<String, Json>, key: &str) -> [u8; 4] {
    let text = metadata.get(key).and_then(Json::as_str).and_then(|text| text.strip_prefix('#'));
    text.and_then(|digits| u32::from_str_radix(digits, 16).ok()).unwrap_or(0).to_be_bytes()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::super::{Geometry, Place, Ring, Value};
    use super::super::{FORMAT, SET};
    use super::*;

    fn triangle(metadata: Json) -> Record {
        let points = Points::from_rows(2, vec![0.0, 0.0, 1.0, 5.0, 1.0, 6.0]);
        let Json::Object(metadata) = metadata else { panic!("{metadata}") };
        Record { metadata, ..Record::new(Geometry::Curve { points, closed: true }, Place::default()) }
    }

    fn summary(format: &super::super::Format, records: &[Record]) -> Summary {
        let mut writer = format.writer(std::io::sink(), &WriteOptions::default()).expect("a writer");
        records.iter().for_each(|record| writer.push(record).expect("written"));
        writer.finish().expect("the end")
    }

    #[test]
    fn what_a_region_cannot_say_is_counted() {
        let lost = json!({
            "type": "oval", "fill_color": "red", "position": 0, "slice": "first", "counters": [1, 1, 1],
            "slices": [0, 0, 0], "properties": [7], "ellipse": {"aspect_ratio": 0.5}, "scanner": 7,
        });
        let mut record = triangle(lost);
        let keys: Vec<String> = record.metadata.keys().cloned().collect();
        let kept =
            triangle(json!({"stroke_color": "#ff00ff7f", "stroke_width": 1.5, "channel": 2, "group": 9}));
        record.metadata.extend(kept.metadata);
        (record.name, record.subject) = (Some("a".into()), Some("p".into()));
        record.labels.insert("age".into(), Value::Number(7.0));
        let found = summary(&FORMAT, std::slice::from_ref(&record)).dropped;
        let found: Vec<_> = found.iter().map(|dropped| (&*dropped.what, dropped.names.join(" "))).collect();
        let expected = [("labels", "a".into()), ("subject", "a".into()), ("metadata", keys.join(" "))];
        assert_eq!(found, expected);
        // A set counts it for each region.
        let both = summary(&SET, &[record.clone(), record]);
        assert_eq!(both.dropped.last().map(|dropped| dropped.count), Some(2 * keys.len() as u64));
    }

    #[test]
    fn types_that_are_written_are_kept() {
        for kind in ["polygon", "freehand", "traced"] {
            assert_eq!(summary(&FORMAT, &[triangle(json!({ "type": kind }))]).dropped, []);
        }
        let part = |part: u64| Record {
            ring: Some(Ring { object: 0, part, hole: false }),
            ..triangle(json!({ "type": "composite", "properties": "x" }))
        };
        assert_eq!(summary(&FORMAT, &[part(0), part(1)]).dropped, []);
    }
}
