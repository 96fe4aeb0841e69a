//! Records to features that QuPath reads.

use std::collections::BTreeMap;
use std::io::Write;

use serde_json::{Map, Value as Json, json};

use super::super::objects::{Grouping, PartRef, add_metadata, number, parts};
use super::super::options::WriteOptions;
use super::super::record::{Points, Record};
use super::super::write::{Opened, Output, Writer};
use super::feature::{KNOWN, Own};
use crate::error::FileError;
use crate::summary::Summary;
use crate::unit::Unit;
use crate::value::Value;

/// A collection that is being written, a feature a line.
struct Features<'a> {
    output: Output<'a>,
    grouping: Grouping,
    /// Unit of shapes that do not say theirs.
    unit: Option<Unit>,
    /// Number of records taken and of features written.
    features: u64,
    buffer: Vec<u8>,
    summary: Summary,
}

pub(super) fn open<'a>(mut output: Output<'a>, options: &WriteOptions) -> Opened<'a> {
    output.write_all(b"{\"type\":\"FeatureCollection\",\"features\":[")?;
    let (grouping, summary) = (Grouping::default(), Summary::default());
    let unit = options.unit.as_deref().and_then(Unit::find);
    Ok(Box::new(Features { output, grouping, unit, features: 0, buffer: Vec::new(), summary }))
}

impl Writer for Features<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let before = self.grouping.push(record, &mut self.summary);
        self.feature(&before)
    }

    fn held(&self) -> usize {
        self.grouping.held()
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        let left = self.grouping.finish();
        self.feature(&left)?;
        self.output.write_all(b"\n]}\n")?;
        self.output.flush()?;
        Ok(Summary { records: self.grouping.count(), ..self.summary })
    }
}

impl Features<'_> {
    /// Writes the feature of the rings of one object.
    fn feature(&mut self, records: &[Record]) -> Result<(), FileError> {
        let Some(first) = records.first() else { return Ok(()) };
        let parts = parts(records, "GeoJSON")?;
        let mut text = std::mem::take(&mut self.buffer);
        text.clear();
        text.extend_from_slice(if self.features > 0 { b",\n" } else { b"\n" });
        text.extend_from_slice(b"{\"type\":\"Feature\",");
        let mut metadata = first.metadata.clone();
        let (id, name) = names(first, &mut metadata);
        if let Some(id) = id {
            text.extend_from_slice(format!("\"id\":{},", Json::String(id)).as_bytes());
        }
        text.extend_from_slice(b"\"geometry\":");
        geometry(&mut text, &parts, geometry_members(&mut metadata));
        text.extend_from_slice(b",\"properties\":");
        let properties = properties(first, first.unit.or(self.unit), metadata, name, &mut self.summary);
        serde_json::to_writer(&mut text, &properties).map_err(std::io::Error::from)?;
        text.push(b'}');
        self.output.write_all(&text)?;
        (self.buffer, self.features) = (text, self.features + 1);
        Ok(())
    }
}

/// Id and name of a feature. A name that has the form of an id of QuPath is one: unnamed objects have it as name of their record.
fn names(record: &Record, metadata: &mut Map<String, Json>) -> (Option<String>, Option<String>) {
    let id = match metadata.remove("id") {
        Some(Json::String(id)) => Some(id),
        Some(other) => {
            metadata.insert("id".into(), other);
            None
        }
        None => None,
    };
    match (id, record.name.clone()) {
        (None, Some(name)) if is_uuid(&name) => (Some(name), None),
        (id, name) => (id, name),
    }
}

/// Takes the members of the geometry from the metadata. One that would replace a member made of its points, or is not an object, stays.
fn geometry_members(metadata: &mut Map<String, Json>) -> Map<String, Json> {
    match metadata.get_mut("geometry") {
        Some(Json::Object(members)) if members.keys().all(|name| !KNOWN.contains(&name.as_str())) => {
            let members = std::mem::take(members);
            metadata.remove("geometry");
            members
        }
        _ => Map::new(),
    }
}

/// Whether a text is five groups of 8, 4, 4, 4 and 12 hexadecimal digits.
fn is_uuid(text: &str) -> bool {
    let groups: Vec<&str> = text.split('-').collect();
    groups.iter().map(|group| group.len()).eq([8, 4, 4, 4, 12])
        && groups.iter().all(|group| group.bytes().all(|byte| byte.is_ascii_hexdigit()))
}

/// Properties whose values have a form, which metadata need not have.
const OWN: [&str; 2] = ["measurements", "shapelex"];

/// The properties as QuPath names them: numbers are measurements; those that it does not know stand in `shapelex`.
fn properties(
    record: &Record,
    unit: Option<Unit>,
    mut metadata: Map<String, Json>,
    name: Option<String>,
    summary: &mut Summary,
) -> Map<String, Json> {
    let mut properties = Map::new();
    let object_type = metadata.remove("objectType");
    let added = if object_type.is_none() { vec!["objectType".to_owned()] } else { Vec::new() };
    properties.insert("objectType".into(), object_type.unwrap_or_else(|| "annotation".into()));
    if let Some(name) = name {
        properties.insert("name".into(), name.into());
    }
    if let Some(label) = &record.label {
        let mut class = match metadata.remove("classification") {
            Some(Json::Object(class)) => class,
            other => {
                metadata.extend(other.map(|other| ("classification".to_owned(), other)));
                Map::new()
            }
        };
        class.insert("name".into(), label.clone().into());
        properties.insert("classification".into(), Json::Object(class));
    }
    let (mut measurements, mut labels) = (Map::new(), BTreeMap::new());
    for (name, value) in &record.labels {
        match value {
            Value::Number(_) => drop(measurements.insert(name.clone(), json!(value))),
            other => drop(labels.insert(name.clone(), other.clone())),
        }
    }
    if !measurements.is_empty() {
        properties.insert("measurements".into(), Json::Object(measurements));
    }
    // Objects that come from QuPath are in pixels.
    let unit = unit.filter(|unit| !added.is_empty() || *unit != Unit::Pixel);
    let unit = unit.map(|unit| unit.word().to_owned());
    let own = Own { subject: record.subject.clone(), labels, weight: record.weight, unit, added };
    if !own.is_empty() {
        properties.insert("shapelex".into(), json!(own));
    }
    add_metadata(&mut properties, metadata, &OWN, record, summary);
    properties
}

/// Writes a geometry: one part as itself, parts of one kind as a group of them, others as a collection; then its other members.
fn geometry(text: &mut Vec<u8>, parts: &[PartRef<'_>], members: Map<String, Json>) {
    let groups = |part: &PartRef<'_>| match part {
        PartRef::Area(_) => "MultiPolygon",
        PartRef::Line(_) => "MultiLineString",
        // Points of several parts would become one list of points.
        PartRef::Points(_) => "GeometryCollection",
    };
    let one_kind = parts.windows(2).all(|pair| groups(&pair[0]) == groups(&pair[1]));
    match parts {
        [part] => single(text, part),
        [first, ..] if one_kind && groups(first) != "GeometryCollection" => {
            text.extend_from_slice(format!("{{\"type\":\"{}\",\"coordinates\":", groups(first)).as_bytes());
            list(text, parts, coordinates);
        }
        _ => {
            text.extend_from_slice(b"{\"type\":\"GeometryCollection\",\"geometries\":");
            list(text, parts, |text, part| {
                single(text, part);
                text.push(b'}');
            });
        }
    }
    for (name, value) in members {
        text.extend_from_slice(format!(",{}:{value}", Json::String(name)).as_bytes());
    }
    text.push(b'}');
}

/// Writes one part without the bracket that closes it.
fn single(text: &mut Vec<u8>, part: &PartRef<'_>) {
    let kind = match part {
        PartRef::Area(_) => "Polygon",
        PartRef::Line(_) => "LineString",
        PartRef::Points(points) if points.len() == 1 => "Point",
        PartRef::Points(_) => "MultiPoint",
    };
    text.extend_from_slice(format!("{{\"type\":\"{kind}\",\"coordinates\":").as_bytes());
    coordinates(text, part);
}

fn coordinates(text: &mut Vec<u8>, part: &PartRef<'_>) {
    match part {
        PartRef::Area(rings) => list(text, rings, |text, ring| rows(text, ring, true)),
        PartRef::Line(points) => rows(text, points, false),
        PartRef::Points(points) => match points.rows().next() {
            Some(row) if points.len() == 1 => list(text, row, |text, x| number(text, *x)),
            _ => rows(text, points, false),
        },
    }
}

/// Writes points; a ring repeats its first one.
fn rows(text: &mut Vec<u8>, points: &Points, ring: bool) {
    let again = points.rows().take(usize::from(ring));
    list(text, points.rows().chain(again), |text, row| list(text, row, |text, x| number(text, *x)));
}

fn list<T>(text: &mut Vec<u8>, items: impl IntoIterator<Item = T>, mut item: impl FnMut(&mut Vec<u8>, T)) {
    text.push(b'[');
    for (k, content) in items.into_iter().enumerate() {
        if k > 0 {
            text.push(b',');
        }
        item(text, content);
    }
    text.push(b']');
}
