//! Lists of points in `.fcsv` files: a table whose header lines begin with `#`.
//!
//! ```text
//! # Markups fiducial file version = 4.11
//! # CoordinateSystem = LPS
//! # columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID
//! 1,12.5,-3,40,0,0,0,1,1,1,0,nasion,,
//! ```

use std::io::Write;

use super::super::format::Format;
use super::super::options::{ReadOptions, WriteOptions};
use super::super::record::Sink;
use super::super::record::{Geometry, Kind, Points, Record};
use super::super::source::Source;
use super::super::text::{coordinate, left_out, push, shown, unfit};
use super::super::write::{Opened, Output, Writer};
use super::{KEPT, keep, points, system, text_of};
use crate::error::{FileError, Place};
use crate::summary::Summary;

/// Points of 3D Slicer.
pub(in super::super) static FORMAT: Format = Format {
    id: "fcsv",
    name: "3D Slicer points (FCSV)",
    media_types: &["application/x-slicer-fcsv"],
    extensions: &["fcsv"],
    recognise: |head| head.starts_with(b"# Markups fiducial file version"),
    kinds: &[Kind::Landmarks],
    options: &[],
    read: Some(read),
    open: Some(open),
};

/// Columns of a file without a line that names them.
const COLUMNS: &str = "id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID";

/// Most columns of a row. The format has 14.
const MAX_COLUMNS: usize = 1024;

/// Where the columns are that are read.
struct Columns {
    position: [usize; 3],
    label: Option<usize>,
    description: Option<usize>,
}

impl Columns {
    fn new(names: &str) -> Result<Self, String> {
        let find = |wanted: &str| {
            names.split(',').take(MAX_COLUMNS).position(|name| name.trim().eq_ignore_ascii_case(wanted))
        };
        let required = |wanted: &str| {
            find(wanted).ok_or_else(|| format!("expected a column {wanted}, got {}", shown(names)))
        };
        Ok(Self {
            position: [required("x")?, required("y")?, required("z")?],
            label: find("label"),
            description: find("desc"),
        })
    }
}

fn read(source: &mut Source<'_>, _: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let mut line = String::new();
    let mut columns = None;
    // Old versions of Slicer wrote RAS, and no header that says so.
    let mut system = String::from("RAS");
    let (mut points, mut labels, mut descriptions) = (Points::new(3), Vec::new(), Vec::new());
    let mut fields = Vec::new();
    while source.next_line(&mut line)? {
        let place = Place::line(source.line());
        let malformed = |detail| FileError::malformed(place.clone(), detail);
        if let Some(comment) = line.strip_prefix('#') {
            match comment.split_once('=').map(|(key, value)| (key.trim(), value.trim())) {
                Some(("CoordinateSystem", value)) => system = system_of(value).map_err(malformed)?,
                Some(("columns", value)) => columns = Some(Columns::new(value).map_err(malformed)?),
                _ => {}
            }
            continue;
        }
        if line.trim().is_empty() {
            continue;
        }
        let columns = match &mut columns {
            Some(columns) => columns,
            none => none.insert(Columns::new(COLUMNS).map_err(malformed)?),
        };
        split(&line, &mut fields);
        let mut row = [None; 3];
        for (x, at) in row.iter_mut().zip(columns.position) {
            let Some(field) = fields.get(at) else {
                return Err(malformed(format!("expected {} or more fields, got {}", at + 1, fields.len())));
            };
            *x = coordinate(field.trim()).map_err(malformed)?;
        }
        source.limits().points(points.len() as u64 + 1, || place.clone())?;
        push(&mut points, &row).map_err(malformed)?;
        let text = |at: Option<usize>| at.and_then(|at| fields.get(at)).cloned().unwrap_or_default();
        labels.push(text(columns.label));
        descriptions.push(text(columns.description));
    }
    let mut summary = Summary::default();
    summary.set("coordinate_system", system.as_str());
    let mut record = Record::new(Geometry::Landmarks(points), Place::item(0));
    record.metadata.insert("coordinate_system".into(), system.into());
    keep(&mut record, "landmark_names", labels);
    keep(&mut record, "descriptions", descriptions);
    sink(record)?;
    Ok(summary)
}

/// The fields of a row, of which one may be in quotation marks. At most [`MAX_COLUMNS`] are taken.
fn split(line: &str, fields: &mut Vec<String>) {
    fields.clear();
    let (mut field, mut quoted) = (String::new(), false);
    let mut chars = line.chars().peekable();
    while let Some(c) = chars.next() {
        match c {
            '"' if quoted && chars.next_if_eq(&'"').is_some() => field.push(c),
            '"' if quoted || field.is_empty() => quoted = !quoted,
            ',' if !quoted => {
                fields.push(std::mem::take(&mut field));
                if fields.len() == MAX_COLUMNS {
                    return;
                }
            }
            _ => field.push(c),
        }
    }
    fields.push(field);
}

/// The name of a coordinate system, which old versions number.
fn system_of(text: &str) -> Result<String, String> {
    match text {
        "RAS" | "0" => Ok("RAS".into()),
        "LPS" | "1" => Ok("LPS".into()),
        _ => Err(format!("expected the coordinate system RAS or LPS, got {}", shown(text))),
    }
}

struct Fcsv<'a> {
    output: Output<'a>,
    summary: Summary,
}

fn open<'a>(output: Output<'a>, _: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(Fcsv { output, summary: Summary::default() }))
}

impl Writer for Fcsv<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let (points, _) = points(record, false)?;
        if self.summary.records > 0 {
            return Err(unfit(record, "expected one shape a file, got a second one"));
        }
        if let Some(point) = points.missing().first() {
            return Err(unfit(record, format!("expected no missing points, got point {point}")));
        }
        let system = system(record, &mut self.summary);
        let mut text = format!(
            "# Markups fiducial file version = 4.11\n# CoordinateSystem = {system}\n# columns = {COLUMNS}\n"
        );
        for (k, row) in points.rows().enumerate() {
            let number = k + 1;
            let label = text_of(record, "landmark_names", k).map_or_else(|| format!("F-{number}"), quoted);
            let description = text_of(record, "descriptions", k).map(quoted).unwrap_or_default();
            let [x, y, z] = [row[0], row[1], row[2]];
            text.push_str(&format!("{number},{x},{y},{z},0,0,0,1,1,1,0,{label},{description},\n"));
        }
        self.output.write_all(text.as_bytes())?;
        if record.name.is_some() {
            self.summary.drop("names", record.name.as_deref(), || record.place.clone());
        }
        left_out(&mut self.summary, record, &KEPT);
        self.summary.records += 1;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        self.output.flush()?;
        Ok(self.summary)
    }
}

/// A field of the table, on one line.
fn quoted(text: &str) -> String {
    let line = text.replace(['\n', '\r'], " ");
    if line.contains([',', '"']) { format!("\"{}\"", line.replace('"', "\"\"")) } else { line }
}

#[cfg(test)]
mod tests {
    use super::super::super::testing::{check_truncations, converted, fault, records, written};
    use super::*;

    const TWO: &str = concat!(
        "# Markups fiducial file version = 4.11\n# CoordinateSystem = LPS\n",
        "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID\n",
        "1,1.5,-2,3,0,0,0,1,1,1,0,nasion,\"a, \"\"b\"\"\",\n2,1e2,0,0,0,0,0,1,1,1,0,F-2,,\n",
    );

    #[test]
    fn a_file_is_written_as_it_was_read() {
        let (found, summary) = records(&FORMAT, TWO, &ReadOptions::default()).expect("a valid file");
        assert_eq!(converted(&FORMAT, &found), TWO.replace("1e2", "100"));
        assert_eq!(summary.properties["coordinate_system"], "LPS");
        assert_eq!(found[0].metadata["landmark_names"], serde_json::json!(["nasion", "F-2"]));
        assert_eq!(found[0].metadata["descriptions"][0], "a, \"b\"");
    }

    #[test]
    fn old_files_are_in_ras() {
        for text in ["P1,1,2,3\n", "# CoordinateSystem = 0\n# columns = label,x,y,z\nP1,1,2,3,\n"] {
            let (found, _) = records(&FORMAT, text, &ReadOptions::default()).expect("a valid file");
            assert_eq!(found[0].metadata["coordinate_system"], "RAS");
        }
    }

    #[test]
    fn what_does_not_fit_is_refused_by_name() {
        let (mut found, _) = records(&FORMAT, TWO, &ReadOptions::default()).expect("a valid file");
        found.push(found[0].clone());
        let error = written(&FORMAT, &found, &WriteOptions::default()).expect_err("two shapes");
        assert_eq!(
            error.to_string(),
            "item 0: a shape without a name: expected one shape a file, got a second one"
        );
        let mut points = Points::new(3);
        points.push_missing();
        found = vec![Record::new(Geometry::Landmarks(points), Place::default())];
        let error = written(&FORMAT, &found, &WriteOptions::default()).expect_err("a missing point");
        assert_eq!(error.to_string(), "a shape without a name: expected no missing points, got point 0");
        found = vec![Record::new(Geometry::Landmarks(Points::from_rows(3, vec![1.0; 3])), Place::default())];
        let (_, summary) = written(&FORMAT, &found, &WriteOptions::default()).expect("written");
        assert_eq!(summary.warnings, ["the coordinate system of shapes is unknown: LPS is written"]);
    }

    #[test]
    fn faults_name_their_line() {
        for (text, message) in [
            (",\"1,2,3\n", "line 1: expected a number, got '1,2,3'"),
            ("1,2,3\n", "line 1: expected 4 or more fields, got 3"),
            ("1,2,3,x\n", "line 1: expected a number, got 'x'"),
            ("1,2,3,nan\n", "line 1: expected all coordinates of a point or none, got 2 of 3 in point 0"),
            ("# CoordinateSystem = IJK\n", "line 1: expected the coordinate system RAS or LPS, got 'IJK'"),
            ("# columns = id,x,y\n", "line 1: expected a column z, got 'id,x,y'"),
        ] {
            assert_eq!(fault(&FORMAT, text, &ReadOptions::default()), message);
        }
        check_truncations(&FORMAT, TWO.as_bytes());
    }
}
