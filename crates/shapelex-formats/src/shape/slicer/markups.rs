//! Lists of points and curves in `.mrk.json` files.
//!
//! ```text
//! {"@schema": "…/markups-schema-v1.0.3.json#", "markups": [
//!   {"type": "ClosedCurve", "name": "C", "coordinateSystem": "LPS", "coordinateUnits": "mm", "controlPoints": [
//!     {"label": "C-1", "position": [12.5, -3, 40], "positionStatus": "defined"}, …]}]}
//! ```
//!
//! `Fiducial` becomes landmarks, `Curve` and `Line` open curves, `ClosedCurve` a closed one. Slicer draws a smooth curve through
//! the control points of a curve; only the control points are read.

use std::io::Write;

use serde::Deserialize;
use serde_json::value::RawValue;
use serde_json::{Value, json};

use super::super::format::Format;
use super::super::json::Weights;
use super::super::limits::Limits;
use super::super::options::{ReadOptions, WriteOptions};
use super::super::record::Sink;
use super::super::record::{Geometry, Kind, Points, Record};
use super::super::source::Source;
use super::super::text::{end, left_out, shown};
use super::super::write::{Opened, Output, Writer};
use super::{KEPT, keep, points, system, text_of};
use crate::error::{FaultKind, FileError, Place};
use crate::summary::Summary;
use crate::unit::Unit;
use crate::words::plain;

/// Points and curves of 3D Slicer.
pub(in super::super) static FORMAT: Format = Format {
    id: "mrk",
    name: "3D Slicer markups (JSON)",
    media_types: &["application/x-slicer-markups+json"],
    extensions: &["mrk.json"],
    recognise: |head| String::from_utf8_lossy(head).contains("/Markups/Resources/Schema/markups-"),
    kinds: &[Kind::Landmarks, Kind::Curve],
    options: &["select"],
    read: Some(read),
    open: Some(open),
};

const SCHEMA: &str = "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/markups-schema-v1.0.3.json#";

#[derive(Deserialize)]
struct File<M> {
    markups: Vec<M>,
}

/// Memory of markups and their points.
const MARKUPS: Weights = Weights { object: 256, list: 64, item: 16 };
/// Longest text of units that is read.
const UNITS: usize = 1000;

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Markup<'a> {
    #[serde(rename = "type")]
    kind: String,
    #[serde(default)]
    name: String,
    coordinate_system: Option<String>,
    /// A code, or a list of a code and its scheme and meaning.
    #[serde(borrow)]
    coordinate_units: Option<&'a RawValue>,
    #[serde(default)]
    control_points: Vec<ControlPoint>,
    #[serde(default)]
    measurements: Vec<serde::de::IgnoredAny>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct ControlPoint {
    #[serde(default)]
    label: String,
    #[serde(default)]
    description: String,
    position: Option<Vec<Option<f64>>>,
    position_status: Option<String>,
}

fn read(source: &mut Source<'_>, options: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let text = source.text()?;
    MARKUPS.check(&text, limits.made(text.len()), Place::default)?;
    let mut summary = Summary::default();
    for (item, markup) in markups(&text, options)?.into_iter().enumerate() {
        let place = Place::item(item as u64);
        let markup = match markup {
            Ok(markup) => markup,
            Err(error) => {
                options.leave_out(error.at(place), &mut summary)?;
                continue;
            }
        };
        if !options.selects(&markup.name) {
            summary.drop("markups that are not selected", Some(&markup.name), || place);
            continue;
        }
        if !markup.measurements.is_empty() {
            summary.drop("measurements of markups", Some(&markup.name), || place.clone());
        }
        match markup.record(&place, &limits, &mut summary).map_err(|error| error.at(place.clone())) {
            Ok(record) => record.map_or(Ok(()), &mut *sink)?,
            Err(error) => options.leave_out(error, &mut summary)?,
        }
    }
    Ok(summary)
}

/// The markups of a file, each alone where one is of another form and those are left out.
fn markups<'t>(
    text: &'t str,
    options: &ReadOptions,
) -> Result<Vec<Result<Markup<'t>, FileError>>, FileError> {
    let fault = |error: serde_json::Error| {
        let at =
            Place { tag: Some(format!("column {}", error.column())), ..Place::line(error.line() as u64) };
        let kind = if error.is_eof() { FaultKind::Truncated } else { FaultKind::Malformed };
        FileError::of(kind, at, plain(&error))
    };
    match serde_json::from_str::<File<Markup<'_>>>(text) {
        Ok(file) => Ok(file.markups.into_iter().map(Ok).collect()),
        Err(error) if options.skips_broken() => {
            let parts = serde_json::from_str::<File<&'t RawValue>>(text).map_err(|_| fault(error))?;
            // Lines and columns are those of the markup.
            let part = |text: &'t RawValue| {
                serde_json::from_str(text.get())
                    .map_err(|error| FileError::malformed(Place::default(), plain(&error)))
            };
            Ok(parts.markups.into_iter().map(part).collect())
        }
        Err(error) => Err(fault(error)),
    }
}

impl Markup<'_> {
    fn record(
        self,
        place: &Place,
        limits: &Limits,
        summary: &mut Summary,
    ) -> Result<Option<Record>, FileError> {
        let closed = match self.kind.as_str() {
            "Fiducial" => None,
            "Curve" | "Line" => Some(false),
            "ClosedCurve" => Some(true),
            _ => {
                let name = format!("{} ({})", self.name, self.kind);
                summary.drop("markups other than points and curves", Some(&name), || place.clone());
                return Ok(None);
            }
        };
        let system = self.coordinate_system.unwrap_or_else(|| "LPS".into());
        if !matches!(system.as_str(), "LPS" | "RAS") {
            let detail = format!("expected the coordinate system RAS or LPS, got {}", shown(&system));
            return Err(FileError::unsupported(Place::tag("coordinateSystem"), detail));
        }
        let units = self.coordinate_units.map(RawValue::get).filter(|text| text.len() <= UNITS);
        let units: Option<Value> = units.and_then(|text| serde_json::from_str(text).ok());
        let unit = match &units {
            Some(Value::Array(codes)) => codes.first().and_then(Value::as_str),
            Some(unit) => unit.as_str(),
            None => None,
        };
        let unit = unit.unwrap_or("mm").to_owned();
        let known = Unit::find(&unit);
        limits.points(self.control_points.len() as u64, || place.clone())?;
        let (mut points, mut labels, mut descriptions) = (Points::new(3), Vec::new(), Vec::new());
        for (k, point) in self.control_points.into_iter().enumerate() {
            point
                .push(&mut points)
                .map_err(|detail| FileError::malformed(Place::tag(format!("controlPoints/{k}")), detail))?;
            labels.push(point.label);
            descriptions.push(point.description);
        }
        let geometry = match closed {
            None => Geometry::Landmarks(points),
            Some(closed) => Geometry::Curve { points, closed },
        };
        let mut record = Record::new(geometry, place.clone());
        record.unit = known;
        record.name = Some(self.name).filter(|name| !name.is_empty());
        summary.set("coordinate_system", agreed(summary, "coordinate_system", &system));
        summary.set("unit", agreed(summary, "unit", &unit));
        record.metadata.insert("coordinate_system".into(), system.into());
        record.metadata.insert("unit".into(), unit.into());
        keep(&mut record, "landmark_names", labels);
        keep(&mut record, "descriptions", descriptions);
        Ok(Some(record))
    }
}

/// A fact of the file, or `several` where markups differ.
fn agreed(summary: &Summary, name: &str, value: &str) -> String {
    match summary.properties.get(name) {
        Some(other) if other != value => "several".into(),
        _ => value.into(),
    }
}

impl ControlPoint {
    /// Adds the position, if the point has one.
    fn push(&self, points: &mut Points) -> Result<(), String> {
        match (self.position_status.as_deref().unwrap_or("defined"), &self.position) {
            ("defined", Some(position)) => match position[..] {
                [Some(x), Some(y), Some(z)] => points.push(&[x, y, z]),
                _ => return Err(format!("expected a position of 3 numbers, got {}", position.len())),
            },
            ("defined", None) => return Err("expected a position, got none".into()),
            ("undefined" | "preview" | "missing", _) => points.push_missing(),
            (other, _) => {
                return Err(format!(
                    "expected defined, undefined, preview or missing as status, got {}",
                    shown(other)
                ));
            }
        }
        Ok(())
    }
}

struct Markups<'a> {
    output: Output<'a>,
    unit: Option<String>,
    summary: Summary,
}

fn open<'a>(mut output: Output<'a>, options: &WriteOptions) -> Opened<'a> {
    output.write_all(format!("{{\"@schema\": \"{SCHEMA}\", \"markups\": [").as_bytes())?;
    Ok(Box::new(Markups { output, unit: options.unit.clone(), summary: Summary::default() }))
}

impl Writer for Markups<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let (points, closed) = points(record, true)?;
        let (kind, letter) = match closed {
            None => ("Fiducial", "F"),
            Some(false) => ("Curve", "OC"),
            Some(true) => ("ClosedCurve", "CC"),
        };
        let stated = record.metadata.get("unit").and_then(Value::as_str);
        let unit = stated.or(record.unit.map(Unit::word)).or(self.unit.as_deref());
        let head = json!({
            "type": kind,
            "name": record.name.as_deref().unwrap_or_default(),
            "coordinateSystem": system(record, &mut self.summary),
            "coordinateUnits": unit.unwrap_or("mm"),
            "locked": false,
            "fixedNumberOfControlPoints": false,
            "labelFormat": "%N-%d",
            "lastUsedControlPointNumber": points.len(),
        });
        let head = head.to_string();
        let separator = if self.summary.records > 0 { ",\n" } else { "\n" };
        // The object stays open for its points, one a line.
        let open = head.strip_suffix('}').unwrap_or(&head);
        write!(self.output, "{separator}{open},\"controlPoints\":[")?;
        for (k, row) in points.rows().enumerate() {
            let label = text_of(record, "landmark_names", k);
            let mut point = json!({
                "id": (k + 1).to_string(),
                "label": label.map_or_else(|| format!("{letter}-{}", k + 1), str::to_owned),
                "description": text_of(record, "descriptions", k).unwrap_or_default(),
                "selected": true,
                "locked": false,
                "visibility": true,
                "positionStatus": "undefined",
            });
            if !row.iter().any(|x| x.is_nan()) {
                point["position"] = json!(row);
                point["orientation"] = json!([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
                point["positionStatus"] = "defined".into();
            }
            write!(self.output, "{}\n{point}", if k > 0 { "," } else { "" })?;
        }
        self.output.write_all(b"]}")?;
        let mut kept = KEPT.to_vec();
        kept.push("unit");
        left_out(&mut self.summary, record, &kept);
        self.summary.records += 1;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        end(&mut self.output, "\n]}\n")?;
        Ok(self.summary)
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::testing::{check_truncations, converted, fault, records};
    use super::*;

    const FILE: &str = r#"{"@schema": "https://raw.githubusercontent.com/Slicer/Slicer/main/Modules/Loadable/Markups/Resources/Schema/markups-schema-v1.0.3.json#",
"markups": [
{"type": "Fiducial", "name": "F", "coordinateSystem": "RAS", "coordinateUnits": ["mm", "UCUM", "millimeter"],
 "controlPoints": [{"label": "nasion", "position": [1.5, -2, 3e-7]}, {"positionStatus": "undefined"}],
 "display": {"visibility": true}},
{"type": "ClosedCurve", "name": "C", "controlPoints": [{"position": [0, 0, 0]}, {"position": [1, 0, 0]}, {"position": [0, 1, 0]}]},
{"type": "Curve", "controlPoints": [{"position": [0, 0, 0]}]},
{"type": "Plane", "name": "P"}]}"#;

    #[test]
    fn points_and_curves_come_back_as_they_were_written() {
        let (found, summary) = records(&FORMAT, FILE, &ReadOptions::default()).expect("a valid file");
        assert_eq!((found.len(), summary.dropped[0].names[0].as_str()), (3, "P (Plane)"));
        assert_eq!(summary.properties["coordinate_system"], "several");
        let Geometry::Landmarks(points) = &found[0].geometry else { panic!("landmarks") };
        assert_eq!((points.missing(), points.coordinates()[2]), (vec![1], 3e-7));
        assert!(matches!(found[1].geometry, Geometry::Curve { closed: true, .. }));
        let text = converted(&FORMAT, &found);
        assert!((FORMAT.recognise)(text.as_bytes()));
        let (again, _) = records(&FORMAT, &text, &ReadOptions::default()).expect("a valid file");
        assert_eq!(converted(&FORMAT, &again), text);
        for (a, b) in found.iter().zip(&again) {
            // As texts: missing coordinates do not equal themselves.
            assert_eq!(format!("{:?}", a.geometry), format!("{:?}", b.geometry));
            assert_eq!(
                (&a.name, &a.metadata["coordinate_system"]),
                (&b.name, &b.metadata["coordinate_system"])
            );
        }
        let options = ReadOptions { select: Some("c*".into()), ..ReadOptions::default() };
        assert_eq!(records(&FORMAT, FILE, &options).expect("a valid file").0.len(), 1);
    }

    #[test]
    fn faults_name_their_place() {
        let one =
            |point: &str| format!("{{\"markups\":[{{\"type\":\"Fiducial\",\"controlPoints\":[{point}]}}]}}");
        for (text, message) in [
            (
                one(r#"{"position":[1,2]}"#),
                "item 0, controlPoints/0: expected a position of 3 numbers, got 2",
            ),
            (
                one(r#"{"position":[1,2,null]}"#),
                "item 0, controlPoints/0: expected a position of 3 numbers, got 3",
            ),
            (one("{}"), "item 0, controlPoints/0: expected a position, got none"),
            (
                one(r#"{"position":[1,2,1e101]}"#),
                "item 0: expected coordinates within ±1e100, got 1e101 in point 0",
            ),
            (
                r#"{"markups":[{"type":"Line","coordinateSystem":"IJK"}]}"#.into(),
                "item 0, coordinateSystem: expected the coordinate system RAS or LPS, got 'IJK'",
            ),
        ] {
            assert_eq!(fault(&FORMAT, &text, &ReadOptions::default()), message);
        }
        let many = format!(
            "{{\"markups\":[{{\"type\":\"Curve\",\"controlPoints\":[{}{{}}]}}]}}",
            "{},".repeat(100_000)
        );
        assert!(fault(&FORMAT, &many, &ReadOptions::default()).contains("expected JSON that takes at most "));
        let deep = format!("{{\"markups\":{}", "[".repeat(100_000));
        assert!(fault(&FORMAT, &deep, &ReadOptions::default()).contains("expected a string, got a list"));
        check_truncations(&FORMAT, FILE.as_bytes());
    }
}
