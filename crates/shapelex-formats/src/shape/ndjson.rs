//! NDJSON: one shape a line, as the service takes and answers them.
//!
//! | geometry | fields |
//! |---|---|
//! | curve | `points`, `closed` |
//! | landmarks | `points`; `null` for a missing one |
//! | mesh | `vertices`, `faces`, `fields` |
//! | Fourier coefficients | `fourier`: `constant`, `cosine`, `sine` |
//!
//! Beside them: `external_id`, `subject`, `label`, `labels`, `weight`, `metadata`, `ring`.

use std::collections::BTreeMap;
use std::io::Write;

use serde::{Deserialize, Serialize};

use super::Sink;
use super::error::{FileError, Place};
use super::format::Format;
use super::options::{ReadOptions, WriteOptions};
use super::record::{Domain, Field, Fourier, Geometry, Kind, Mesh, Points, Record, Value};
use super::source::Source;
use super::summary::Summary;
use super::write::Writer;

/// NDJSON.
pub(super) static FORMAT: Format = Format {
    id: "ndjson",
    name: "NDJSON",
    media_types: &["application/x-ndjson"],
    extensions: &["ndjson", "jsonl"],
    recognise: |_| false,
    kinds: &[Kind::Curve, Kind::Landmarks, Kind::Mesh, Kind::Fourier],
    options: &["closed"],
    read: Some(read),
    open: Some(open),
};

/// A line. `ring` is written only: it follows from the order of other formats.
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
    faces: Option<Vec<Vec<u32>>>,
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
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    labels: BTreeMap<String, Value>,
    #[serde(skip_serializing_if = "Option::is_none")]
    weight: Option<f64>,
    #[serde(skip_serializing_if = "serde_json::Map::is_empty")]
    metadata: serde_json::Map<String, serde_json::Value>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ring: Option<serde_json::Value>,
}

/// Points, `null` for a missing one.
type Rows = Vec<Option<Vec<f64>>>;

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FieldLine {
    /// `vertices` or `faces`.
    on: Carrier,
    width: usize,
    values: Vec<Option<f64>>,
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
    cosine: Vec<Vec<f64>>,
    sine: Vec<Vec<f64>>,
}

fn read(source: &mut Source<'_>, options: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let mut text = String::new();
    while source.next_line(&mut text)? {
        if text.trim().is_empty() {
            continue;
        }
        let place = Place::line(source.line());
        let line: Line = serde_json::from_str(&text).map_err(|error| {
            let at = Place { tag: Some(format!("column {}", error.column())), ..place.clone() };
            FileError::malformed(at, "expected a shape as a JSON object, got other text or an unknown field")
        })?;
        sink(record(line, options, place)?)?;
    }
    Ok(Summary::default())
}

fn record(line: Line, options: &ReadOptions, place: Place) -> Result<Record, FileError> {
    let fault = |detail: &str| Err(FileError::malformed(place.clone(), detail));
    let closed = line.closed.or(options.closed);
    let geometry = match (line.points, line.vertices, line.fourier) {
        (Some(rows), None, None) => {
            let points = points(rows, &place)?;
            closed.map_or(Geometry::Landmarks(points.clone()), |closed| Geometry::Curve { points, closed })
        }
        (None, Some(rows), None) => {
            let mut mesh = Mesh { vertices: points(rows, &place)?, ..Mesh::default() };
            for face in line.faces.unwrap_or_default() {
                mesh.faces.push(face);
            }
            mesh.fields = line.fields.into_iter().map(|(name, field)| (name, field.into())).collect();
            Geometry::Mesh(mesh)
        }
        (None, None, Some(FourierLine { constant, cosine, sine })) => {
            if cosine.iter().chain(&sine).any(|row| row.len() != constant.len()) {
                return fault("expected coefficients of one dimension, got several");
            }
            Geometry::Fourier(Fourier { constant, cosine: cosine.concat(), sine: sine.concat() })
        }
        _ => return fault("expected one of points, vertices and fourier, got none or several"),
    };
    Ok(Record {
        name: line.external_id,
        subject: line.subject,
        label: line.label,
        labels: line.labels,
        weight: line.weight,
        metadata: line.metadata,
        ..Record::new(geometry, place)
    })
}

fn points(rows: Rows, place: &Place) -> Result<Points, FileError> {
    let dimension = rows.iter().flatten().map(Vec::len).next().unwrap_or(2);
    let mut points = Points::new(dimension);
    for (k, row) in rows.iter().enumerate() {
        match row {
            Some(row) if row.len() == dimension && dimension > 0 => points.push(row),
            Some(row) => {
                let detail = format!("expected {dimension} coordinates, got {} in point {k}", row.len());
                return Err(FileError::malformed(place.clone(), detail));
            }
            None => points.push_missing(),
        }
    }
    Ok(points)
}

fn rows(points: &Points) -> Rows {
    points.rows().map(|row| row.iter().all(|x| !x.is_nan()).then(|| row.to_vec())).collect()
}

impl From<FieldLine> for Field {
    fn from(FieldLine { on, width, values }: FieldLine) -> Self {
        let domain = match on {
            Carrier::Vertices => Domain::Vertices,
            Carrier::Faces => Domain::Faces,
        };
        Self { domain, width, values: values.into_iter().map(|value| value.unwrap_or(f64::NAN)).collect() }
    }
}

impl From<&Field> for FieldLine {
    fn from(field: &Field) -> Self {
        let on = match field.domain {
            Domain::Vertices => Carrier::Vertices,
            Domain::Faces => Carrier::Faces,
        };
        let values = field.values.iter().map(|value| value.is_finite().then_some(*value)).collect();
        Self { on, width: field.width, values }
    }
}

impl From<&Record> for Line {
    fn from(record: &Record) -> Self {
        let mut line = Self {
            external_id: record.name.clone(),
            subject: record.subject.clone(),
            label: record.label.clone(),
            labels: record.labels.clone(),
            weight: record.weight,
            metadata: record.metadata.clone(),
            ring: record.ring.as_ref().and_then(|ring| serde_json::to_value(ring).ok()),
            ..Self::default()
        };
        match &record.geometry {
            Geometry::Curve { points, closed } => {
                (line.points, line.closed) = (Some(rows(points)), Some(*closed));
            }
            Geometry::Landmarks(points) => line.points = Some(rows(points)),
            Geometry::Mesh(Mesh { vertices, faces, fields }) => {
                line.vertices = Some(rows(vertices));
                line.faces = Some(faces.iter().map(<[u32]>::to_vec).collect());
                line.fields = fields.iter().map(|(name, field)| (name.clone(), field.into())).collect();
            }
            Geometry::Fourier(fourier) => {
                let rows = |flat: &[f64]| {
                    flat.chunks_exact(fourier.dimension().max(1)).map(<[f64]>::to_vec).collect()
                };
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

struct Lines<'a> {
    output: Box<dyn Write + Send + 'a>,
    count: u64,
}

fn open<'a>(output: Box<dyn Write + Send + 'a>, _: &WriteOptions) -> Result<Box<dyn Writer + 'a>, FileError> {
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
mod tests {
    use super::super::{FaultKind, Limits, find};
    use super::*;

    fn records(text: &str, limits: Limits) -> Result<Vec<Record>, FileError> {
        let mut found = Vec::new();
        let mut source = Source::new(text.as_bytes(), limits)?;
        let format = find("ndjson").expect("a format");
        super::super::read(format, &mut source, &ReadOptions::default(), &mut |record| {
            found.push(record);
            Ok(())
        })?;
        Ok(found)
    }

    #[test]
    fn lines_come_back_as_they_were_written() {
        let text = concat!(
            r#"{"points":[[0.1,0.0],[2.0,0.0],[2.0,1e-7]],"closed":true,"external_id":"a","label":"x","labels":{"age":61.0,"left":true}}"#,
            "\n",
            r#"{"points":[[0.0,0.0,1.0],null]}"#,
            "\n",
            r#"{"vertices":[[0.0,0.0,0.0],[1.0,0.0,0.0],[0.0,1.0,0.0]],"faces":[[0,1,2]],"fields":{"t":{"on":"faces","width":1,"values":[null]}}}"#,
            "\n",
            r#"{"fourier":{"constant":[0.0,1.0],"cosine":[[1.0,0.0]],"sine":[[0.0,1.0]]},"metadata":{"a":[1,2]}}"#,
            "\n",
        );
        let found = records(text, Limits::default()).expect("valid lines");
        assert_eq!(found.iter().map(|r| r.geometry.kind()).collect::<Vec<_>>(), FORMAT.kinds);
        let mut bytes = Vec::new();
        let mut writer = FORMAT.writer(&mut bytes, &WriteOptions::default()).expect("a writer");
        for record in &found {
            writer.push(record).expect("written");
        }
        assert_eq!(writer.finish().expect("the end").records, 4);
        assert_eq!(String::from_utf8(bytes).expect("text"), text);
    }

    #[test]
    fn faults_name_their_line() {
        for (text, kind, message) in [
            (
                "\n{\"points\":[[0,1],[2]]}",
                FaultKind::Malformed,
                "line 2: expected 2 coordinates, got 1 in point 1",
            ),
            (
                "{\"points\":[[0,1e101]]}",
                FaultKind::Malformed,
                "line 1: expected coordinates within ±1e100, got 1e101 in point 0",
            ),
            (
                "{\"vertices\":[[0,1,2]],\"faces\":[[0,0,7]]}",
                FaultKind::Malformed,
                "line 1: expected indices of vertices below 1, got 7 in face 0",
            ),
            (
                "{\"point\":[]}",
                FaultKind::Malformed,
                "column 8, line 1: expected a shape as a JSON object, got other text or an unknown field",
            ),
        ] {
            let error = records(text, Limits::default()).expect_err("a fault");
            assert_eq!((error.kind, error.to_string().as_str()), (kind, message));
        }
        let limits = Limits { records: 1, ..Limits::default() };
        let error = records("{\"points\":[]}\n{\"points\":[]}\n", limits).expect_err("too many");
        assert_eq!(error.to_string(), "line 2: expected at most 1 shapes, got more");
        let limits = Limits { held: 10, ..Limits::default() };
        let error = records("{\"points\":[]}\n", limits).expect_err("too long");
        assert_eq!(error.to_string(), "line 1: expected lines of at most 10 bytes, got a longer one");
    }

    #[test]
    fn options_of_other_formats_are_refused() {
        let mut source = Source::new(&b""[..], Limits::default()).expect("a source");
        let options = ReadOptions { select: Some("*".into()), ..ReadOptions::default() };
        let error =
            super::super::read(&FORMAT, &mut source, &options, &mut |_| Ok(())).expect_err("an option");
        assert_eq!(error.to_string(), "expected options of NDJSON (closed), got select");
    }
}
