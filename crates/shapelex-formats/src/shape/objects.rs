//! Objects of the plane, as several formats have them: areas with holes, lines and points, alone or in groups.
//!
//! Reading makes one record of every ring, line or list of points; writing puts those with the same [`Ring::object`] together again.

use std::io::Write;

use serde_json::{Map, Value as Json};

use super::limits::Limits;
use super::options::Holes;
use super::record::Sink;
use super::record::{Geometry, Points, Record, Ring};
use crate::error::{FileError, Place};
use crate::summary::Summary;

/// A part of an object.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Part {
    /// A ring and those of its holes. No ring repeats its first point.
    Area(Vec<Points>),
    /// An open line.
    Line(Points),
    /// Points that belong together.
    Points(Points),
}

/// Settings of a reader for all its objects.
#[derive(Debug, Clone, Copy)]
pub(super) struct Giving<'a> {
    /// Treatment of holes.
    pub(super) holes: Holes,
    /// Bounds on the number of points.
    pub(super) limits: &'a Limits,
}

impl Giving<'_> {
    /// Gives the parts of an object on, each with the facts of `template`. Only an object of several rings or parts has a
    /// [`Ring`]; rings of skipped holes count as such. The second record and those after it have its position behind their name,
    /// `cell/2`, since names of stored shapes differ.
    pub(super) fn give(
        &self,
        parts: Vec<Part>,
        object: u64,
        template: Record,
        summary: &mut Summary,
        sink: Sink<'_>,
    ) -> Result<(), FileError> {
        let rings = parts.iter().map(|part| if let Part::Area(rings) = part { rings.len() } else { 1 });
        let several = rings.sum::<usize>() > 1;
        let mut found = Vec::new();
        for (part, content) in (0..).zip(parts) {
            match content {
                Part::Area(rings) => {
                    for (k, points) in rings.into_iter().enumerate() {
                        let hole = k > 0;
                        if hole && !self.keeps(&template, summary)? {
                            continue;
                        }
                        found.push((part, hole, Geometry::Curve { points, closed: true }));
                    }
                }
                Part::Line(points) => found.push((part, false, Geometry::Curve { points, closed: false })),
                Part::Points(points) => found.push((part, false, Geometry::Landmarks(points))),
            }
        }
        let record = |k: usize, (part, hole, geometry): (u64, bool, Geometry), template: Record| Record {
            ring: several.then_some(Ring { object, part, hole }),
            name: template.name.map(|name| if k > 0 { format!("{name}/{}", k + 1) } else { name }),
            geometry,
            ..template
        };
        let (last, count) = (found.pop(), found.len());
        for (k, content) in found.into_iter().enumerate() {
            self.check(&content.2, &template.place)?;
            sink(record(k, content, template.clone()))?;
        }
        last.map_or(Ok(()), |content| {
            self.check(&content.2, &template.place)?;
            sink(record(count, content, template))
        })
    }

    fn check(&self, geometry: &Geometry, place: &Place) -> Result<(), FileError> {
        if let Geometry::Curve { points, .. } | Geometry::Landmarks(points) = geometry {
            self.limits.points(points.len() as u64, || place.clone())?;
        }
        Ok(())
    }

    /// Whether a hole becomes a record.
    fn keeps(&self, template: &Record, summary: &mut Summary) -> Result<bool, FileError> {
        match self.holes {
            Holes::Keep => Ok(true),
            Holes::Skip => {
                summary.drop("holes", template.name.as_deref(), || template.place.clone());
                Ok(false)
            }
            Holes::Refuse => {
                let detail = "expected areas without holes, as the option holes asks, got a hole";
                Err(FileError::unsupported(template.place.clone(), detail))
            }
        }
    }
}

/// Collects the records of an object for writing.
#[derive(Debug, Default)]
pub(super) struct Grouping {
    records: Vec<Record>,
    count: u64,
    held: usize,
}

impl Grouping {
    /// Adds a record; returns those of the object before it, if the record begins another one. An object has the attributes of its
    /// first ring: other ones are counted, and holes that follow no area.
    pub(super) fn push(&mut self, record: &Record, summary: &mut Summary) -> Vec<Record> {
        let (name, place) = (record.name.as_deref(), || record.place.clone());
        let first = self.records.first().filter(|first| self.goes_on(first, record));
        let goes_on = first.is_some();
        match first {
            Some(first) if !is_said_alike(first, record) => {
                summary.drop("attributes of further rings of an object", name, place);
            }
            None if record.ring.as_ref().is_some_and(|ring| ring.hole) => {
                summary.drop("places of holes that follow no area", name, place);
            }
            _ => {}
        }
        let before = if goes_on { Vec::new() } else { self.finish() };
        let kept = if goes_on { outline(record) } else { record.clone() };
        self.held += kept.bytes();
        self.records.push(kept);
        self.count += 1;
        before
    }

    /// Whether a record belongs to the object that begins with `first`: it has the same number, label and dimension, and the numbers of
    /// parts go on, since files that are written one after the other all count their objects from 0. A part is named after the first
    /// one. A hole, which formats name in several ways, follows a ring of its part.
    fn goes_on(&self, first: &Record, record: &Record) -> bool {
        let Some(last) = self.records.last() else { return false };
        let (Some(before), Some(ring)) = (&last.ring, &record.ring) else { return false };
        let follows = if ring.hole {
            ring.part == before.part && is_closed(last) && is_closed(record)
        } else {
            ring.part > before.part && continues(first, record)
        };
        let is_alike = last.geometry.dimension() == record.geometry.dimension() && last.label == record.label;
        follows && is_alike && ring.object == before.object
    }

    /// Number of bytes of the records that wait for the end of their object.
    pub(super) fn held(&self) -> usize {
        self.held
    }

    /// Number of records so far.
    pub(super) fn count(&self) -> u64 {
        self.count
    }

    /// The records that are left.
    pub(super) fn finish(&mut self) -> Vec<Record> {
        self.held = 0;
        std::mem::take(&mut self.records)
    }
}

/// A record without attributes and metadata, but the label that tells objects apart.
fn outline(record: &Record) -> Record {
    Record {
        name: record.name.clone(),
        label: record.label.clone(),
        ring: record.ring.clone(),
        unit: record.unit,
        ..Record::new(record.geometry.clone(), record.place.clone())
    }
}

/// Whether a record has the name of the first one of an object, or that with a number behind it.
fn continues(first: &Record, record: &Record) -> bool {
    match (&first.name, &record.name) {
        (Some(first), Some(name)) => name.strip_prefix(first.as_str()).is_some_and(|rest| {
            let number = rest.strip_prefix('/');
            rest.is_empty() || number.is_some_and(|number| number.bytes().all(|byte| byte.is_ascii_digit()))
        }),
        (first, name) => first == name,
    }
}

/// Whether two records have the same attributes and metadata.
fn is_said_alike(a: &Record, b: &Record) -> bool {
    a.subject == b.subject && a.labels == b.labels && a.weight == b.weight && a.metadata == b.metadata
}

fn is_closed(record: &Record) -> bool {
    matches!(record.geometry, Geometry::Curve { closed: true, .. })
}

/// A part of an object to be written.
#[derive(Debug)]
pub(super) enum PartRef<'a> {
    /// A ring and those of its holes.
    Area(Vec<&'a Points>),
    /// An open line.
    Line(&'a Points),
    /// Points that belong together.
    Points(&'a Points),
}

/// The parts of an object, for a format that knows neither meshes nor missing points.
///
/// # Errors
/// A record that `format` cannot hold, by name.
pub(super) fn parts<'a>(records: &'a [Record], format: &str) -> Result<Vec<PartRef<'a>>, FileError> {
    let mut parts: Vec<(Option<u64>, PartRef<'a>)> = Vec::new();
    for record in records {
        let refused = |got: &str| Err(refusal(record, format, got));
        let (points, part) = match &record.geometry {
            Geometry::Curve { points, closed: true } => (points, PartRef::Area(vec![points])),
            Geometry::Curve { points, closed: false } => (points, PartRef::Line(points)),
            Geometry::Landmarks(points) => (points, PartRef::Points(points)),
            Geometry::Mesh(_) => return refused("a mesh"),
            Geometry::Fourier(_) => return refused("Fourier coefficients"),
        };
        if points.is_empty() {
            return refused("no points");
        }
        if !points.missing().is_empty() {
            return refused("missing points");
        }
        if !(2..=3).contains(&points.dimension()) {
            return refused(&format!("points of {} coordinates", points.dimension()));
        }
        if let (PartRef::Area(_), true) = (&part, points.len() < 3) {
            return refused(&format!("a closed curve of {} points", points.len()));
        }
        let number = record.ring.as_ref().map(|ring| ring.part);
        match (parts.last_mut(), &record.ring) {
            (Some((last, PartRef::Area(rings))), Some(ring)) if ring.hole && *last == number => {
                rings.push(points);
            }
            _ => parts.push((number, part)),
        }
    }
    Ok(parts.into_iter().map(|(_, part)| part).collect())
}

/// A record that a format cannot hold.
pub(super) fn refusal(record: &Record, format: &str, got: &str) -> FileError {
    let name = record.name.as_ref().map(|name| format!(" of '{name}'")).unwrap_or_default();
    let detail = format!("expected curves and points that {format} can hold, got {got}{name}");
    FileError::unsupported(record.place.clone(), detail)
}

/// Adds metadata to the members of an object, but those that it has and `own` ones, whose values have a form: these are counted.
pub(super) fn add_metadata(
    members: &mut Map<String, Json>,
    metadata: Map<String, Json>,
    own: &[&str],
    record: &Record,
    summary: &mut Summary,
) {
    for (name, value) in metadata {
        if own.contains(&name.as_str()) || members.contains_key(&name) {
            summary.drop("metadata with the name of a member", Some(&name), || record.place.clone());
        } else {
            members.insert(name, value);
        }
    }
}

/// Writes a number so that it is read as the same one. Whole numbers have no fraction, as most programs write them.
pub(super) fn number(text: &mut Vec<u8>, x: f64) {
    let whole = x.fract() == 0.0 && x.abs() < 1e15;
    let written = if whole { write!(text, "{x:.0}") } else { write!(text, "{}", serde_json::Value::from(x)) };
    written.expect("a list of bytes takes all that is written");
}

/// Signed area of a polygon of the plane, positive where `x` turns to `y`:
///
/// ```text
/// A = ½ Σ_k (x_k − x_0)(y_{k+1} − y_0) − (x_{k+1} − x_0)(y_k − y_0)
/// ```
pub(super) fn area(ring: &Points) -> f64 {
    let Some(first) = ring.rows().next() else { return 0.0 };
    let from_first = |row: &[f64]| (row[0] - first[0], row[1] - first[1]);
    let pairs = ring.rows().zip(ring.rows().skip(1));
    pairs
        .map(|(a, b)| {
            let ((ax, ay), (bx, by)) = (from_first(a), from_first(b));
            ax * by - bx * ay
        })
        .sum::<f64>()
        / 2.0
}

#[cfg(test)]
mod tests {
    use super::super::FaultKind;
    use super::*;

    fn ring(coordinates: &[f64]) -> Points {
        Points::from_rows(2, coordinates.to_vec())
    }

    fn square() -> Points {
        ring(&[0.0, 0.0, 2.0, 0.0, 2.0, 1.0, 0.0, 1.0])
    }

    fn given(parts: Vec<Part>, holes: Holes) -> Result<(Vec<Record>, Summary), FileError> {
        let (mut records, mut summary) = (Vec::new(), Summary::default());
        let template = Record {
            name: Some("a".into()),
            ..Record::new(Geometry::Landmarks(Points::new(2)), Place::item(7))
        };
        Giving { holes, limits: &Limits::default() }.give(
            parts,
            7,
            template,
            &mut summary,
            &mut |record| {
                records.push(record);
                Ok(())
            },
        )?;
        Ok((records, summary))
    }

    #[test]
    fn rings_of_an_object_are_put_together_again() {
        let object =
            vec![Part::Area(vec![square(), square()]), Part::Line(square()), Part::Area(vec![square()])];
        let (records, summary) = given(object.clone(), Holes::Keep).expect("records");
        let rings: Vec<_> =
            records.iter().filter_map(|r| r.ring.clone()).map(|r| (r.object, r.part, r.hole)).collect();
        assert_eq!(rings, [(7, 0, false), (7, 0, true), (7, 1, false), (7, 2, false)]);
        assert!(summary.dropped.is_empty());
        let names: Vec<_> = records.iter().filter_map(|r| r.name.as_deref()).collect();
        assert_eq!(names, ["a", "a/2", "a/3", "a/4"]);
        let mut grouping = Grouping::default();
        for record in &records {
            assert!(grouping.push(record, &mut Summary::default()).is_empty());
        }
        let mut summary = Summary::default();
        assert_eq!(
            grouping.push(&records[0], &mut summary).len(),
            4,
            "the same number again is another object"
        );
        assert!(summary.dropped.is_empty());
        let sizes: Vec<_> = parts(&records, "x")
            .expect("parts")
            .iter()
            .map(|part| match part {
                PartRef::Area(rings) => rings.len(),
                _ => 0,
            })
            .collect();
        assert_eq!(sizes, [2, 0, 1]);
    }

    /// Numbers of records of the objects that are made of them, and the counted items.
    fn grouped(records: &[Record]) -> (Vec<usize>, Vec<(String, u64)>) {
        let (mut grouping, mut summary) = (Grouping::default(), Summary::default());
        let mut sizes: Vec<_> =
            records.iter().map(|record| grouping.push(record, &mut summary).len()).collect();
        sizes.push(grouping.finish().len());
        sizes.retain(|size| *size > 0);
        (sizes, summary.dropped.into_iter().map(|dropped| (dropped.what, dropped.count)).collect())
    }

    fn named(name: &str, geometry: Geometry, part: u64, hole: bool) -> Record {
        let ring = Some(Ring { object: 0, part, hole });
        Record { name: Some(name.into()), ring, ..Record::new(geometry, Place::default()) }
    }

    #[test]
    fn only_closed_curves_of_one_dimension_are_rings_of_an_area() {
        let area = || Geometry::Curve { points: square(), closed: true };
        let in_space = Points::from_rows(3, vec![0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        let lost = [("places of holes that follow no area".to_owned(), 1)];
        for other in [
            Geometry::Landmarks(square()),
            Geometry::Curve { points: square(), closed: false },
            Geometry::Curve { points: in_space, closed: true },
        ] {
            let (sizes, counted) = grouped(&[named("a", area(), 0, false), named("a/2", other, 0, true)]);
            assert_eq!((sizes, &counted[..]), (vec![1, 1], &lost[..]));
        }
        // The area of the second part is missing.
        let records =
            [named("a", area(), 0, false), named("a", area(), 0, true), named("a/3", area(), 1, true)];
        let (sizes, counted) = grouped(&records);
        assert_eq!((sizes, &counted[..]), (vec![2, 1], &lost[..]));
    }

    #[test]
    fn parts_are_named_after_the_first_and_holes_as_formats_do() {
        let area = || Geometry::Curve { points: square(), closed: true };
        for (name, hole, part, is_one) in [
            ("7.hole1", true, 0, true),
            ("other 4", true, 0, true),
            ("7/2", false, 1, true),
            ("7/12", false, 3, true),
            ("7", false, 1, true),
            ("7.2", false, 1, false),
            ("8", false, 1, false),
            ("7/2", false, 0, false),
        ] {
            let (sizes, counted) = grouped(&[named("7", area(), 0, false), named(name, area(), part, hole)]);
            assert_eq!((sizes.len() == 1, counted.len()), (is_one, 0), "{name}");
        }
        let mut heavy = named("7/2", area(), 0, true);
        heavy.weight = Some(2.0);
        let (sizes, counted) = grouped(&[named("7", area(), 0, false), heavy]);
        assert_eq!(
            (sizes, counted),
            (vec![2], vec![("attributes of further rings of an object".to_owned(), 1)])
        );
    }

    #[test]
    fn holes_are_counted_or_refused() {
        let (records, summary) =
            given(vec![Part::Area(vec![square(), square()])], Holes::Skip).expect("records");
        assert_eq!((records.len(), records[0].ring.is_some()), (1, true));
        assert_eq!((summary.dropped[0].count, &summary.dropped[0].names[..]), (1, &["a".to_owned()][..]));
        let error = given(vec![Part::Area(vec![square(), square()])], Holes::Refuse).expect_err("a hole");
        assert_eq!(
            error.to_string(),
            "item 7: expected areas without holes, as the option holes asks, got a hole"
        );
        let (records, _) = given(vec![Part::Area(vec![square()])], Holes::Refuse).expect("records");
        assert_eq!(records[0].ring, None);
    }

    #[test]
    fn records_that_do_not_fit_are_named() {
        let mut missing = square();
        missing.push_missing();
        for (geometry, got) in [
            (Geometry::Landmarks(missing), "missing points"),
            (Geometry::Landmarks(Points::new(2)), "no points"),
            (Geometry::Curve { points: ring(&[0.0, 1.0]), closed: true }, "a closed curve of 1 points"),
            (Geometry::Landmarks(Points::from_rows(1, vec![1.0])), "points of 1 coordinates"),
        ] {
            let record = Record { name: Some("b".into()), ..Record::new(geometry, Place::default()) };
            let error = parts(std::slice::from_ref(&record), "WKT").expect_err("a fault");
            let message = format!("expected curves and points that WKT can hold, got {got} of 'b'");
            assert_eq!((error.kind, error.to_string()), (FaultKind::Unsupported, message));
        }
    }

    #[test]
    fn areas_have_a_sign() {
        assert_eq!(area(&square()), 2.0);
        assert_eq!(area(&ring(&[0.0, 0.0, 0.0, 1.0, 2.0, 1.0, 2.0, 0.0])), -2.0);
        assert_eq!(area(&Points::new(2)), 0.0);
    }
}
