//! Landmarks of Scalismo: a list of named points in JSON, or a row for each in CSV.
//!
//! ```text
//! [{"id": "nose", "coordinates": [12.5, -3, 40], "description": "tip"}, …]
//!
//! # made by hand
//! nose,12.5,-3,40
//! ```
//!
//! The points of a file are one shape. Files have no unit; scalismo counts in the coordinates of its images, mm in LPS.

use serde::Deserialize;
use serde_json::value::RawValue;

use super::format::Format;
use super::json::Weights;
use super::options::ReadOptions;
use super::record::{Geometry, Kind, Points, Record, Sink};
use super::source::Source;
use super::text::{number, shown};
use crate::error::{FaultKind, FileError, Place};
use crate::summary::Summary;
use crate::words::plain;

/// Landmarks of Scalismo.
pub(super) static FORMAT: Format = Format {
    id: "scalismo",
    name: "Scalismo landmarks (JSON)",
    media_types: &["application/x-scalismo-landmarks+json"],
    extensions: &["landmarks.json"],
    recognise,
    kinds: &[Kind::Landmarks],
    options: &[],
    read: Some(read),
    open: None,
};

/// Memory of points.
const POINTS: Weights = Weights { object: 256, list: 64, item: 16 };

#[derive(Deserialize)]
struct Landmark<'a> {
    id: String,
    coordinates: Vec<f64>,
    description: Option<String>,
    /// A normal distribution of the position.
    #[serde(borrow)]
    uncertainty: Option<&'a RawValue>,
}

/// Whether a file begins with a list of an object that begins as a point does.
fn recognise(head: &[u8]) -> bool {
    let head = head.strip_prefix("\u{feff}".as_bytes()).unwrap_or(head).trim_ascii_start();
    let object =
        head.strip_prefix(b"[").map(<[u8]>::trim_ascii_start).and_then(|rest| rest.strip_prefix(b"{"));
    let Some(object) = object else { return false };
    let first = object.split(|byte| *byte == b'}').next().unwrap_or(object);
    let has = |name: &[u8]| first.windows(name.len()).any(|part| part == name);
    has(b"\"id\"") && has(b"\"coordinates\"")
}

fn read(source: &mut Source<'_>, _: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let text = source.text()?;
    POINTS.check(&text, limits.made(text.len()), Place::default)?;
    let landmarks: Vec<Landmark<'_>> = serde_json::from_str(&text).map_err(|error| {
        let at =
            Place { tag: Some(format!("column {}", error.column())), ..Place::line(error.line() as u64) };
        let kind = if error.is_eof() { FaultKind::Truncated } else { FaultKind::Malformed };
        FileError::of(kind, at, plain(&error))
    })?;
    let (mut rows, mut summary, mut descriptions) = (Rows::default(), Summary::default(), Vec::new());
    for (k, landmark) in (0..).zip(landmarks) {
        let place = Place::item(k);
        limits.points(k + 1, || place.clone())?;
        let Landmark { id, coordinates, description, uncertainty } = landmark;
        if uncertainty.is_some_and(|value| value.get() != "null") {
            summary.drop("uncertainties of points", Some(&id), || place.clone());
        }
        rows.push(id, &coordinates).map_err(|detail| FileError::malformed(place, detail))?;
        descriptions.push(description.unwrap_or_default());
    }
    let mut record = rows.record();
    if descriptions.iter().any(|text| !text.is_empty()) {
        record.metadata.insert("descriptions".into(), descriptions.into());
    }
    sink(record)?;
    Ok(summary)
}

/// Points with their names.
#[derive(Default)]
struct Rows {
    points: Points,
    names: Vec<String>,
}

impl Rows {
    fn push(&mut self, name: String, coordinates: &[f64]) -> Result<(), String> {
        if self.names.is_empty() && (2..=3).contains(&coordinates.len()) {
            self.points = Points::new(coordinates.len());
        }
        let expected = self.points.dimension();
        if coordinates.len() != expected || !(2..=3).contains(&expected) {
            let expected = if self.names.is_empty() { "2 or 3".into() } else { expected.to_string() };
            return Err(format!(
                "expected {expected} coordinates, got {} of {}",
                coordinates.len(),
                shown(&name)
            ));
        }
        self.points.push(coordinates);
        self.names.push(name);
        Ok(())
    }

    fn record(self) -> Record {
        let mut record = Record::new(Geometry::Landmarks(self.points), Place::item(0));
        record.metadata.insert("landmark_names".into(), self.names.into());
        record
    }
}

/// The name and the coordinates in a row of CSV.
fn row(line: &str) -> Option<(&str, Vec<f64>)> {
    let mut fields = line.split(',').map(str::trim);
    let name = fields.next().filter(|name| !name.is_empty() && number(name).is_err())?;
    let coordinates: Vec<f64> = fields.map(|field| number(field).ok()).collect::<Option<_>>()?;
    (2..=3).contains(&coordinates.len()).then_some((name, coordinates))
}

/// Whether a line is a comment or blank.
fn is_comment(line: &str) -> bool {
    line.trim().is_empty() || line.starts_with('#')
}

/// Whether a table begins, after comments, with a point and no names of columns.
pub(super) fn is_table(head: &[u8]) -> bool {
    let head = String::from_utf8_lossy(head);
    let first = head.trim_start_matches('\u{feff}').lines().find(|line| !is_comment(line));
    first.and_then(row).is_some()
}

/// Reads the points of a table.
pub(super) fn read_table(source: &mut Source<'_>, sink: Sink<'_>) -> Result<Summary, FileError> {
    let (mut line, mut rows) = (String::new(), Rows::default());
    while source.next_line(&mut line)? {
        if is_comment(&line) {
            continue;
        }
        let place = Place::line(source.line());
        source.limits().points(rows.names.len() as u64 + 1, || place.clone())?;
        let malformed = |detail| FileError::malformed(place.clone(), detail);
        let expected = || malformed(format!("expected a name and 2 or 3 numbers, got {}", shown(&line)));
        let (name, coordinates) = row(&line).ok_or_else(expected)?;
        rows.push(name.to_owned(), &coordinates).map_err(malformed)?;
    }
    sink(rows.record())?;
    Ok(Summary::default())
}

#[cfg(test)]
mod tests {
    use super::super::csv;
    use super::super::testing::{check_truncations, fault, records};
    use super::*;

    const FILE: &str = r#"[{"id": "nose", "coordinates": [12.5, -3, 40], "description": "tip"},
        {"id": "chin", "coordinates": [0, 1, 2], "uncertainty": {"stddevs": [1, 1, 1]}}]"#;
    const TABLE: &str = "# made by hand\nnose, 12.5,-3,40\n\n# below\nchin,0,1,2\n";

    #[test]
    fn named_points_are_one_shape() {
        assert!(recognise(FILE.as_bytes()) && is_table(TABLE.as_bytes()));
        assert!(!is_table(b"id,x,y\na,1,2\n") && !is_table(b"1,2,3\n") && !recognise(b"[[1, 2], [3, 4]]"));
        let options = ReadOptions::default();
        let (json, summary) = records(&FORMAT, FILE, &options).unwrap();
        assert_eq!(
            (summary.dropped[0].what.as_str(), summary.dropped[0].count),
            ("uncertainties of points", 1)
        );
        assert_eq!(json[0].metadata["descriptions"], serde_json::json!(["tip", ""]));
        let (table, _) = records(&csv::FORMAT, TABLE, &options).unwrap();
        for found in [&json[0], &table[0]] {
            let Geometry::Landmarks(points) = &found.geometry else { panic!("{found:?}") };
            assert_eq!(
                (points.dimension(), points.coordinates()),
                (3, &[12.5, -3.0, 40.0, 0.0, 1.0, 2.0][..])
            );
            assert_eq!(found.metadata["landmark_names"], serde_json::json!(["nose", "chin"]));
        }
        check_truncations(&FORMAT, FILE.as_bytes());
    }

    #[test]
    fn faults_name_the_point() {
        let options = ReadOptions::default();
        let short = r#"[{"id": "a", "coordinates": [1, 2, 3]}, {"id": "b", "coordinates": [1, 2]}]"#;
        assert_eq!(fault(&FORMAT, short, &options), "item 1: expected 3 coordinates, got 2 of 'b'");
        let one = r#"[{"id": "a", "coordinates": [1]}]"#;
        assert_eq!(fault(&FORMAT, one, &options), "item 0: expected 2 or 3 coordinates, got 1 of 'a'");
        let expected = "line 2: expected a name and 2 or 3 numbers, got 'b,1'";
        assert_eq!(fault(&csv::FORMAT, "a,1,2,3\nb,1\n", &options), expected);
        assert_eq!(
            fault(&csv::FORMAT, "a,1,2,3\nb,1,2\n", &options),
            "line 2: expected 3 coordinates, got 2 of 'b'"
        );
    }
}
