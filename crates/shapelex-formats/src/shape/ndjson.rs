//! NDJSON: one shape a line, as the service takes and answers them.
//!
//! | geometry | fields |
//! |---|---|
//! | curve | `points`, `closed` |
//! | landmarks | `points`; `null` for a missing one |
//! | mesh | `vertices`, `faces`, `fields` |
//! | Fourier coefficients | `fourier`: `constant`, `cosine`, `sine` |
//!
//! Beside them: `external_id`, `subject`, `label`, `labels`, `weight`, `metadata`, and `ring` (`object`, `part`, `hole`) of an object
//! with several parts or holes.

use std::collections::BTreeMap;
use std::fmt;
use std::io::Write;
use std::marker::PhantomData;

use serde::de::{DeserializeOwned, DeserializeSeed, Deserializer, SeqAccess, Visitor};
use serde::{Deserialize, Serialize, Serializer};
use serde_json::value::RawValue;

use super::format::Format;
use super::json::check_attributes;
use super::limits::MAX_DIMENSION;
use super::options::{ReadOptions, WriteOptions};
use super::record::Sink;
use super::record::{Domain, Faces, Field, Fourier, Geometry, Kind, Mesh, Points, Record, Ring};
use super::source::Source;
use super::text::shown;
use super::write::{Opened, Output, Writer};
use crate::error::{FileError, Place};
use crate::summary::Summary;
use crate::words::plain;

/// NDJSON.
pub(super) static FORMAT: Format = Format {
    id: "ndjson",
    name: "NDJSON",
    media_types: &["application/x-ndjson"],
    extensions: &["ndjson", "jsonl"],
    recognise,
    kinds: &[Kind::Curve, Kind::Landmarks, Kind::Mesh, Kind::Fourier],
    options: &["closed", "attributes"],
    read: Some(read),
    open: Some(open),
};

/// Fields by which a line begins as no other format does.
const FIRST: [&[u8]; 5] = [b"points", b"closed", b"vertices", b"fourier", b"external_id"];

/// Whether a file begins with an object of shapes.
fn recognise(head: &[u8]) -> bool {
    let head = head.strip_prefix("\u{feff}".as_bytes()).unwrap_or(head).trim_ascii_start();
    let name =
        head.strip_prefix(b"{").map(<[u8]>::trim_ascii_start).and_then(|rest| rest.strip_prefix(b"\""));
    name.is_some_and(|name| {
        FIRST.iter().any(|first| name.strip_prefix(*first).is_some_and(|rest| rest.starts_with(b"\"")))
    })
}

/// A line. Lists are read into flat vectors, so that it takes a few times its length.
#[derive(Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct Line {
    #[serde(skip_serializing_if = "Option::is_none")]
    points: Option<Rows>,
    #[serde(skip_serializing_if = "Option::is_none")]
    closed: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    vertices: Option<Rows>,
    #[serde(skip_serializing_if = "Option::is_none")]
    faces: Option<FaceLists>,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    fields: BTreeMap<String, FieldLine>,
    #[serde(skip_serializing_if = "Option::is_none")]
    fourier: Option<FourierLine>,
    #[serde(skip_serializing_if = "Option::is_none")]
    external_id: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    subject: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    label: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    labels: Option<Box<RawValue>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    weight: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    metadata: Option<Box<RawValue>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ring: Option<Box<RawValue>>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FieldLine {
    /// `vertices` or `faces`.
    on: Carrier,
    width: usize,
    values: Values,
}

#[derive(Serialize, Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum Carrier {
    Vertices,
    Faces,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FourierLine {
    constant: Vec<f64>,
    cosine: Rows,
    sine: Rows,
}

fn read(source: &mut Source<'_>, options: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let (mut text, mut summary) = (String::new(), Summary::default());
    while options.next_line(source, &mut text, &mut summary)? {
        if text.trim().is_empty() {
            continue;
        }
        let place = Place::line(source.line());
        let line = serde_json::from_str::<Line>(&text).map_err(|error| {
            let at = Place { tag: Some(format!("column {}", error.column())), ..place.clone() };
            FileError::malformed(at, plain(&error))
        });
        match line.and_then(|line| record(line, options, place)) {
            Ok(record) => sink(record)?,
            Err(error) => options.leave_out(error, &mut summary)?,
        }
    }
    Ok(summary)
}

fn record(line: Line, options: &ReadOptions, place: Place) -> Result<Record, FileError> {
    let fault = |detail: &str| Err(FileError::malformed(place.clone(), detail));
    let points = |rows: Rows| rows.points().map_err(|detail| FileError::malformed(place.clone(), detail));
    let closed = line.closed.or(options.closed);
    let geometry = match (line.points, line.vertices, line.fourier) {
        (Some(rows), None, None) => match closed {
            None => Geometry::Landmarks(points(rows)?),
            Some(closed) => Geometry::Curve { points: points(rows)?, closed },
        },
        (None, Some(rows), None) => Geometry::Mesh(Mesh {
            vertices: points(rows)?,
            faces: line.faces.unwrap_or_default().0,
            fields: line.fields.into_iter().map(|(name, field)| (name, field.into())).collect(),
        }),
        (None, None, Some(FourierLine { constant, cosine, sine })) => {
            let [cosine, sine] = [points(cosine)?, points(sine)?];
            if [&cosine, &sine].into_iter().any(|rows| !rows.is_empty() && rows.dimension() != constant.len())
            {
                return fault("expected coefficients of one dimension, got several");
            }
            let [cosine, sine] = [&cosine, &sine].map(|rows| rows.coordinates().to_vec());
            Geometry::Fourier(Fourier { constant, cosine, sine })
        }
        _ => return fault("expected one of points, vertices and fourier, got none or several"),
    };
    Ok(Record {
        name: line.external_id,
        subject: line.subject,
        label: line.label,
        labels: small(line.labels.as_deref(), "labels", &place)?,
        weight: line.weight,
        metadata: small(line.metadata.as_deref(), "metadata", &place)?,
        ring: ring(line.ring.as_deref(), &place)?,
        ..Record::new(geometry, place)
    })
}

/// A value that is read if it is small.
fn small<T: Default + DeserializeOwned>(
    text: Option<&RawValue>,
    field: &str,
    place: &Place,
) -> Result<T, FileError> {
    let Some(text) = text.map(RawValue::get) else { return Ok(T::default()) };
    let at = || Place { tag: Some(field.into()), ..place.clone() };
    check_attributes(text, at)?;
    let wrong = |_| FileError::malformed(at(), format!("expected an object of {field}, got other text"));
    serde_json::from_str(text).map_err(wrong)
}

/// Place of a line among the rings of an object.
fn ring(text: Option<&RawValue>, place: &Place) -> Result<Option<Ring>, FileError> {
    /// Tables, and many readers of JSON, have numbers of double precision: larger ones would be rounded there.
    const MOST: u64 = 1 << 53;
    let Some(text) = text.map(RawValue::get) else { return Ok(None) };
    let found = serde_json::from_str(text).ok().filter(|ring: &Ring| ring.object.max(ring.part) <= MOST);
    // The library would also take a list of the three values.
    found.filter(|_| text.starts_with('{')).map(Some).ok_or_else(|| {
        let place = Place { tag: Some("ring".into()), ..place.clone() };
        let expected = "expected whole numbers up to 2⁵³ as object and part, and true or false as hole";
        FileError::malformed(place, format!("{expected}, got {}", shown(text)))
    })
}

/// Points as they are read and written: one list of coordinates each, `null` for a missing one.
#[derive(Default)]
struct Rows {
    points: Points,
    /// Number of missing points before the dimension is known.
    before: usize,
    fault: Option<String>,
}

impl Rows {
    fn of(points: &Points) -> Self {
        Self { points: points.clone(), ..Self::default() }
    }

    /// Rows without missing ones.
    fn of_flat(dimension: usize, flat: &[f64]) -> Self {
        Self { points: Points::from_rows(dimension.max(1), flat.to_vec()), ..Self::default() }
    }

    fn points(mut self) -> Result<Points, String> {
        if self.points.dimension() == 0 {
            self.points = missing(2, self.before);
        }
        self.fault.map_or(Ok(self.points), Err)
    }

    /// Adds the row that was read, or a missing one.
    fn push(&mut self, row: Option<&[f64]>) {
        let (dimension, k) = (self.points.dimension(), self.points.len() + self.before);
        match row {
            None if dimension == 0 => self.before += 1,
            None => self.points.push_missing(),
            Some(row) if row.len() > MAX_DIMENSION => {
                let detail =
                    format!("expected at most {MAX_DIMENSION} coordinates, got {} in point {k}", row.len());
                self.fault.get_or_insert(detail);
            }
            Some(row) if dimension == 0 && !row.is_empty() => {
                self.points = missing(row.len(), std::mem::take(&mut self.before));
                self.points.push(row);
            }
            Some(row) if row.len() == dimension && dimension > 0 => self.points.push(row),
            Some(row) => {
                let detail = format!("expected {dimension} coordinates, got {} in point {k}", row.len());
                self.fault.get_or_insert(detail);
            }
        }
    }
}

fn missing(dimension: usize, count: usize) -> Points {
    let mut points = Points::new(dimension);
    (0..count).for_each(|_| points.push_missing());
    points
}

impl Serialize for Rows {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.points.rows().map(|row| row.iter().all(|x| !x.is_nan()).then_some(row)))
    }
}

impl<'de> Deserialize<'de> for Rows {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut rows = Self::default();
        each(deserializer, |row: Option<&[f64]>| rows.push(row))?;
        Ok(rows)
    }
}

/// Faces of a mesh, one list of indices each.
#[derive(Default)]
struct FaceLists(Faces);

impl Serialize for FaceLists {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter())
    }
}

impl<'de> Deserialize<'de> for FaceLists {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut faces = Faces::default();
        each(deserializer, |face: Option<&[u32]>| faces.push(face.unwrap_or_default().iter().copied()))?;
        Ok(Self(faces))
    }
}

/// Values of a field, `null` where there is none.
struct Values(Vec<f64>);

impl Serialize for Values {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter().map(|value| value.is_finite().then_some(*value)))
    }
}

impl<'de> Deserialize<'de> for Values {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct List;
        impl<'de> Visitor<'de> for List {
            type Value = Vec<f64>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of numbers")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Vec<f64>, A::Error> {
                let mut values = Vec::new();
                while let Some(value) = list.next_element::<Option<f64>>()? {
                    values.push(value.unwrap_or(f64::NAN));
                }
                Ok(values)
            }
        }
        deserializer.deserialize_seq(List).map(Self)
    }
}

/// Reads a list of lists, each into the same buffer; `null` in place of one is none.
fn each<'de, T: Deserialize<'de>, D: Deserializer<'de>>(
    deserializer: D,
    take: impl FnMut(Option<&[T]>),
) -> Result<(), D::Error> {
    struct Outer<T, F>(F, PhantomData<T>);
    impl<'de, T: Deserialize<'de>, F: FnMut(Option<&[T]>)> Visitor<'de> for Outer<T, F> {
        type Value = ();

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a list of lists of numbers")
        }

        fn visit_seq<A: SeqAccess<'de>>(mut self, mut list: A) -> Result<(), A::Error> {
            let mut buffer = Vec::new();
            while let Some(is_there) = list.next_element_seed(Inner(&mut buffer))? {
                (self.0)(is_there.then_some(&buffer));
            }
            Ok(())
        }
    }
    deserializer.deserialize_seq(Outer(take, PhantomData))
}

/// Reads a list into a buffer; whether there is one.
struct Inner<'a, T>(&'a mut Vec<T>);

impl<'de, T: Deserialize<'de>> DeserializeSeed<'de> for Inner<'_, T> {
    type Value = bool;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<bool, D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de, T: Deserialize<'de>> Visitor<'de> for Inner<'_, T> {
    type Value = bool;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list of numbers or null")
    }

    fn visit_unit<E>(self) -> Result<bool, E> {
        Ok(false)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<bool, A::Error> {
        self.0.clear();
        while let Some(value) = list.next_element()? {
            self.0.push(value);
        }
        Ok(true)
    }
}

impl From<FieldLine> for Field {
    fn from(FieldLine { on, width, values }: FieldLine) -> Self {
        let domain = match on {
            Carrier::Vertices => Domain::Vertices,
            Carrier::Faces => Domain::Faces,
        };
        Self { domain, width, values: values.0 }
    }
}

impl From<&Field> for FieldLine {
    fn from(field: &Field) -> Self {
        let on = match field.domain {
            Domain::Vertices => Carrier::Vertices,
            Domain::Faces => Carrier::Faces,
        };
        Self { on, width: field.width, values: Values(field.values.clone()) }
    }
}

impl From<&Record> for Line {
    fn from(record: &Record) -> Self {
        let mut line = Self {
            external_id: record.name.clone(),
            subject: record.subject.clone(),
            label: record.label.clone(),
            labels: (!record.labels.is_empty()).then(|| raw(&record.labels)).flatten(),
            weight: record.weight,
            metadata: (!record.metadata.is_empty()).then(|| raw(&record.metadata)).flatten(),
            ring: record.ring.as_ref().and_then(raw),
            ..Self::default()
        };
        match &record.geometry {
            Geometry::Curve { points, closed } => {
                (line.points, line.closed) = (Some(Rows::of(points)), Some(*closed));
            }
            Geometry::Landmarks(points) => line.points = Some(Rows::of(points)),
            Geometry::Mesh(Mesh { vertices, faces, fields }) => {
                line.vertices = Some(Rows::of(vertices));
                line.faces = Some(FaceLists(faces.clone()));
                line.fields = fields.iter().map(|(name, field)| (name.clone(), field.into())).collect();
            }
            Geometry::Fourier(fourier) => {
                let rows = |flat: &[f64]| Rows::of_flat(fourier.dimension(), flat);
                line.fourier = Some(FourierLine {
                    constant: fourier.constant.clone(),
                    cosine: rows(&fourier.cosine),
                    sine: rows(&fourier.sine),
                });
            }
        }
        line
    }
}

/// A value as text; `None` if JSON has none for it.
fn raw(value: &impl Serialize) -> Option<Box<RawValue>> {
    serde_json::value::to_raw_value(value).ok()
}

struct Lines<'a> {
    output: Output<'a>,
    count: u64,
}

fn open<'a>(output: Output<'a>, _: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(Lines { output, count: 0 }))
}

impl Writer for Lines<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        serde_json::to_writer(&mut self.output, &Line::from(record)).map_err(std::io::Error::from)?;
        self.output.write_all(b"\n")?;
        self.count += 1;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        self.output.flush()?;
        Ok(Summary { records: self.count, ..Summary::default() })
    }
}

#[cfg(test)]
mod tests;
