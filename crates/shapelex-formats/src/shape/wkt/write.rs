//! Records to lines.

use std::io::Write;

use super::super::objects::{Grouping, PartRef, number, parts, refusal};
use super::super::options::WriteOptions;
use super::super::record::{Points, Record};
use super::super::text::left_out;
use super::super::write::{Opened, Output, Writer};
use super::parse::begins_geometry;
use crate::error::FileError;
use crate::summary::Summary;

/// Lines that are being written: the name of the object, a tabulator and its geometry.
struct Lines<'a> {
    output: Output<'a>,
    grouping: Grouping,
    summary: Summary,
}

pub(super) fn open<'a>(output: Output<'a>, _: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(Lines { output, grouping: Grouping::default(), summary: Summary::default() }))
}

impl Writer for Lines<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let before = self.grouping.push(record, &mut self.summary);
        self.line(&before)
    }

    fn held(&self) -> usize {
        self.grouping.held()
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        let left = self.grouping.finish();
        self.line(&left)?;
        self.output.flush()?;
        self.summary.records = self.grouping.count();
        Ok(self.summary)
    }
}

impl Lines<'_> {
    fn line(&mut self, records: &[Record]) -> Result<(), FileError> {
        let Some(first) = records.first() else { return Ok(()) };
        let parts = parts(records, "WKT")?;
        let mut dimensions = parts.iter().map(dimension);
        let dimension = dimensions.next().unwrap_or(2);
        if dimensions.any(|other| other != dimension) {
            return Err(refusal(first, "WKT", "parts of several dimensions"));
        }
        left_out(&mut self.summary, first, &["ring", "srid"]);
        let mut text = Vec::new();
        if let Some(name) = &first.name {
            text.extend_from_slice(quoted(name).as_bytes());
            text.push(b'\t');
        }
        if let Some(srid) = first.metadata.get("srid").and_then(serde_json::Value::as_u64) {
            text.extend_from_slice(format!("SRID={srid};").as_bytes());
        }
        geometry(&mut text, &parts, if dimension == 3 { " Z" } else { "" });
        text.push(b'\n');
        self.output.write_all(&text)?;
        Ok(())
    }
}

fn dimension(part: &PartRef<'_>) -> usize {
    match part {
        PartRef::Area(rings) => rings.first().map_or(2, |ring| ring.dimension()),
        PartRef::Line(points) | PartRef::Points(points) => points.dimension(),
    }
}

/// A name, in quotation marks where it would be read as something else. Line ends become spaces.
fn quoted(name: &str) -> String {
    let name = name.replace(['\n', '\r'], " ");
    let plain = !name.contains(['\t', ';', ',', '"']) && name.trim() == name && !name.starts_with('#');
    if plain && !name.is_empty() && !begins_geometry(&name) && !super::names_columns(&name) {
        return name;
    }
    format!("\"{}\"", name.replace('"', "\"\""))
}

/// One part as itself, parts of one kind as a group of them, others as a collection.
fn geometry(text: &mut Vec<u8>, parts: &[PartRef<'_>], order: &str) {
    let group = |part: &PartRef<'_>| match part {
        PartRef::Area(_) => "MULTIPOLYGON",
        PartRef::Line(_) => "MULTILINESTRING",
        PartRef::Points(_) => "GEOMETRYCOLLECTION",
    };
    let one_kind = parts.windows(2).all(|pair| group(&pair[0]) == group(&pair[1]));
    match parts {
        [part] => single(text, part, order),
        [first, ..] if one_kind && group(first) != "GEOMETRYCOLLECTION" => {
            text.extend_from_slice(format!("{}{order} ", group(first)).as_bytes());
            list(text, parts, coordinates);
        }
        _ => {
            text.extend_from_slice(format!("GEOMETRYCOLLECTION{order} ").as_bytes());
            list(text, parts, |text, part| single(text, part, order));
        }
    }
}

fn single(text: &mut Vec<u8>, part: &PartRef<'_>, order: &str) {
    let kind = match part {
        PartRef::Area(_) => "POLYGON",
        PartRef::Line(_) => "LINESTRING",
        PartRef::Points(points) if points.len() == 1 => "POINT",
        PartRef::Points(_) => "MULTIPOINT",
    };
    text.extend_from_slice(format!("{kind}{order} ").as_bytes());
    coordinates(text, part);
}

fn coordinates(text: &mut Vec<u8>, part: &PartRef<'_>) {
    match part {
        PartRef::Area(rings) => list(text, rings, |text, ring| rows(text, ring, true)),
        PartRef::Line(points) | PartRef::Points(points) => rows(text, points, false),
    }
}

/// Writes points; a ring repeats its first one.
fn rows(text: &mut Vec<u8>, points: &Points, ring: bool) {
    let again = points.rows().take(usize::from(ring));
    list(text, points.rows().chain(again), |text, row| {
        for (k, x) in row.iter().enumerate() {
            if k > 0 {
                text.push(b' ');
            }
            number(text, *x);
        }
    });
}

fn list<T>(text: &mut Vec<u8>, items: impl IntoIterator<Item = T>, mut item: impl FnMut(&mut Vec<u8>, T)) {
    text.push(b'(');
    for (k, content) in items.into_iter().enumerate() {
        if k > 0 {
            text.extend_from_slice(b", ");
        }
        item(text, content);
    }
    text.push(b')');
}
