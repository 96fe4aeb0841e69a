//! Chain codes of outlines, as SHAPE writes and Momocs and ktch read them.
//!
//! ```text
//! name x y area_per_pixel area_in_pixels c_1 c_2 … c_n -1
//!
//! 3 2 1
//! 4 · 0     directions on the screen: x to the right, y down
//! 5 6 7
//! ```
//!
//! Point k is (x, y) + s Σ_{j ≤ k} step(c_j) with s = √area_per_pixel, or 1 where that is not positive.

use std::fmt::Write as _;
use std::io::Write;

use super::format::Format;
use super::limits::Limits;
use super::options::{ReadOptions, WriteOptions};
use super::record::Sink;
use super::record::{Geometry, Kind, Points, Record};
use super::source::Source;
use super::text::{self, Lines, Words, shown};
use super::write::{Opened, Output, Writer};
use crate::error::{FileError, Place};
use crate::summary::Summary;

/// Chain codes.
pub(super) static FORMAT: Format = Format {
    id: "chc",
    name: "chain codes",
    media_types: &["application/x-chain-code"],
    extensions: &["chc"],
    recognise: |_| false,
    kinds: &[Kind::Curve],
    options: &["closed"],
    read: Some(read),
    open: Some(open),
};

/// Steps of the codes 0 to 7.
const STEPS: [[i64; 2]; 8] = [[1, 0], [1, -1], [0, -1], [-1, -1], [-1, 0], [-1, 1], [0, 1], [1, 1]];
/// Largest distance of a step from a whole number of pixels: coordinates of files often have six digits.
const TOLERANCE: f64 = 1e-4;

/// Largest distance that rounding of doubles explains.
const ROUNDING: f64 = 1e-9;

fn read(source: &mut Source<'_>, options: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let text = source.text()?;
    let mut words = Words::new(Lines::new(&text, 0));
    let mut summary = Summary::default();
    let (mut item, mut open) = (0, 0_u64);
    while let Some(name) = words.next() {
        let place = Place { item: Some(item), ..words.place() };
        item += 1;
        let found = chain(&mut words, &place, &limits);
        let (points, area, pixels, returns) = match found {
            Ok(chain) => chain,
            Err(error) => {
                options.leave_out(error, &mut summary)?;
                continue;
            }
        };
        open += u64::from(!returns);
        let geometry = Geometry::Curve { points, closed: returns || options.closed.unwrap_or(false) };
        let mut record = Record::new(geometry, place.clone());
        record.name = Some(name.into());
        record.metadata.insert("area_per_pixel".into(), area.into());
        record.metadata.insert("area_in_pixels".into(), pixels.into());
        sink(record)?;
    }
    summary.set("axes", "y down");
    if open > 0 {
        summary.warnings.push(format!(
            "{open} chain codes do not return to their start: open curves, unless closed is true"
        ));
    }
    Ok(summary)
}

/// The chain after its name: its points without the first one again, area of a pixel, area in pixels, and whether it returns to its
/// start. A fault leaves the words after the end of the chain.
fn chain(
    words: &mut Words<'_>,
    place: &Place,
    limits: &Limits,
) -> Result<(Points, f64, f64, bool), FileError> {
    let mut broken = None;
    let mut head = [0.0; 4];
    for (number, what) in head.iter_mut().zip(["x", "y", "the area of a pixel", "the area in pixels"]) {
        match text::number(take(words, what, place)?) {
            Ok(value) => *number = value,
            Err(detail) => drop(broken.get_or_insert(FileError::malformed(place.clone(), detail))),
        }
    }
    let [x, y, area, pixels] = head;
    let scale = if area > 0.0 { area.sqrt() } else { 1.0 };
    let mut points = Points::new(2);
    let mut at = [0_i64; 2];
    points.push(&[x, y]);
    loop {
        let word = take(words, "a chain code or -1", place).map_err(|end| match broken.take() {
            Some(first) => FileError { kind: end.kind, ..first },
            None => end,
        })?;
        let step = match word.parse::<i8>() {
            Ok(-1) => break,
            Ok(code) => usize::try_from(code).ok().and_then(|code| STEPS.get(code)),
            Err(_) => None,
        };
        match step {
            Some(step) if broken.is_none() => {
                at = [at[0] + step[0], at[1] + step[1]];
                limits.points(points.len() as u64 + 1, || place.clone())?;
                points.push(&[x + scale * at[0] as f64, y + scale * at[1] as f64]);
            }
            Some(_) => {}
            None => {
                let detail = format!("expected a chain code of 0 to 7 or -1, got {}", shown(word));
                let place = Place { item: place.item, ..words.place() };
                broken.get_or_insert_with(|| FileError::malformed(place, detail));
            }
        }
    }
    if let Some(error) = broken {
        return Err(error);
    }
    let returns = points.len() > 1 && at == [0, 0];
    if returns {
        points.pop();
    }
    Ok((points, area, pixels, returns))
}

/// The next word of a chain.
fn take<'t>(words: &mut Words<'t>, what: &str, place: &Place) -> Result<&'t str, FileError> {
    words.next().ok_or_else(|| {
        FileError::truncated(place.clone(), format!("expected {what}, got the end of the file"))
    })
}

struct Chains<'a> {
    output: Output<'a>,
    numbered: u64,
    summary: Summary,
}

fn open<'a>(output: Output<'a>, _: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(Chains { output, numbered: 0, summary: Summary::default() }))
}

impl Writer for Chains<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let (points, closed) = match &record.geometry {
            Geometry::Curve { points, closed } if points.dimension() == 2 => (points, *closed),
            Geometry::Curve { .. } => {
                return Err(text::unfit(record, "expected a curve in the plane, got one in space"));
            }
            _ => return Err(text::refused(record, "a curve")),
        };
        let area = record.metadata.get("area_per_pixel").and_then(serde_json::Value::as_f64);
        let area = area.filter(|area| area.is_finite());
        let scale = match area {
            Some(area) if area > 0.0 => area.sqrt(),
            Some(_) => 1.0,
            None => spacing(points),
        };
        let area = area.unwrap_or(scale * scale);
        if area == 0.0 && scale != 1.0 {
            return Err(text::unfit(record, format!("expected steps whose square is a number, got {scale}")));
        }
        let (codes, moved) = codes(points, closed, scale).map_err(|detail| text::unfit(record, detail))?;
        if moved > ROUNDING {
            let name = record.name.as_deref();
            self.summary.drop("digits of points beside the lattice of pixels", name, || record.place.clone());
        }
        let name = match &record.name {
            Some(name) if !name.trim().is_empty() => text::word(name, &mut self.summary, &record.place),
            _ => {
                self.numbered += 1;
                (self.summary.records + 1).to_string()
            }
        };
        let start = points.rows().next().unwrap_or(&[0.0, 0.0]);
        let mut line = format!("{name} {} {} {area} {}", start[0], start[1], area_in_pixels(&codes));
        for code in codes {
            // Writing to a text cannot fail.
            let _ = write!(line, " {code}");
        }
        line.push_str(" -1\n");
        self.output.write_all(line.as_bytes())?;
        text::left_out(&mut self.summary, record, &["area_per_pixel", "area_in_pixels"]);
        self.summary.records += 1;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        self.output.flush()?;
        if self.numbered > 0 {
            let warning = format!("{} shapes have no name: written with their number", self.numbered);
            self.summary.warnings.push(warning);
        }
        Ok(self.summary)
    }
}

/// The smallest side of a step, which on a lattice is its spacing; 1 if there is none.
fn spacing(points: &Points) -> f64 {
    let rows = points.rows().zip(points.rows().skip(1));
    let sides = rows.flat_map(|(a, b)| [(b[0] - a[0]).abs(), (b[1] - a[1]).abs()]);
    let size = points.coordinates().iter().fold(0.0, |size: f64, x| size.max(x.abs()));
    // Rounding of coordinates, not a side.
    let smallest = sides.filter(|side| *side > size * 1e-12).fold(f64::INFINITY, f64::min);
    if smallest.is_finite() { smallest } else { 1.0 }
}

/// The codes of a curve on a lattice and the largest distance of a coordinate from it in pixels, with the step back to the start of a closed one.
fn codes(points: &Points, closed: bool, scale: f64) -> Result<(Vec<usize>, f64), String> {
    let mut moved: f64 = 0.0;
    let (rows, mut found) = (points.rows(), Vec::with_capacity(points.len()));
    let Some(first) = points.rows().next() else { return Err("expected a point or more, got none".into()) };
    let mut at = [0_i64; 2];
    let back = closed.then_some(first);
    for (k, row) in rows.chain(back).enumerate().skip(1) {
        let place = || format!("between points {} and {}", k - 1, if k == points.len() { 0 } else { k });
        let mut step = [0; 2];
        for axis in 0..2 {
            // Measured from the start, so that rounding does not add up.
            let pixels = (row[axis] - first[axis]) / scale - at[axis] as f64;
            if !((pixels - pixels.round()).abs() <= TOLERANCE && pixels.abs() < 1.5) {
                return Err(format!(
                    "expected steps of one pixel of {scale}, got {pixels} pixels {}",
                    place()
                ));
            }
            moved = moved.max((pixels - pixels.round()).abs());
            step[axis] = if pixels > 0.5 { 1 } else { -i64::from(pixels < -0.5) };
        }
        let Some(code) = STEPS.iter().position(|of_code| *of_code == step) else {
            return Err(format!("expected steps of one pixel, got none {}", place()));
        };
        at = [at[0] + step[0], at[1] + step[1]];
        found.push(code);
    }
    if !closed && !found.is_empty() && at == [0, 0] {
        return Err("expected a closed curve, got an open one that ends at its start".into());
    }
    Ok((found, moved))
}

/// Number of pixels on and within an outline by Pick's theorem: A + B/2 + 1 for area A and B pixels on the outline.
fn area_in_pixels(codes: &[usize]) -> i64 {
    let (mut at, mut twice) = ([0_i64; 2], 0_i64);
    for code in codes {
        let [dx, dy] = STEPS[*code];
        twice += at[0] * dy - at[1] * dx;
        at = [at[0] + dx, at[1] + dy];
    }
    // A chain has at most as many codes as a shape has points.
    let boundary = i64::try_from(codes.len()).unwrap_or(i64::MAX / 2);
    (twice.abs() + boundary) / 2 + 1
}

#[cfg(test)]
mod tests {
    use super::super::testing::{check_truncations, converted, fault, records, written};
    use super::*;

    // A rectangle of 2 × 1 steps, whose lattice has 6 points, and an open chain.
    const TWO: &str = "leaf_1 10.5 -3 0.01 6 0 0 6 4 4 2 -1\nstem 0 0 -1 2 1 0 -1\n";

    #[test]
    fn a_file_is_written_as_it_was_read() {
        let (found, summary) = records(&FORMAT, TWO, &ReadOptions::default()).expect("a valid file");
        let Geometry::Curve { points, closed } = &found[0].geometry else { panic!("a curve") };
        assert_eq!((points.len(), *closed, found[0].name.as_deref()), (6, true, Some("leaf_1")));
        assert_eq!(points.coordinates()[..6], [10.5, -3.0, 10.6, -3.0, 10.7, -3.0]);
        assert_eq!(points.coordinates()[7], -2.9);
        assert_eq!((converted(&FORMAT, &found).as_str(), summary.warnings.len()), (TWO, 1));
        let split = TWO.replace(" 0 0 6", "\n0 0\n6");
        let (again, _) = records(&FORMAT, &split, &ReadOptions::default()).expect("a valid file");
        assert_eq!((&again[0], &again[1].geometry), (&found[0], &found[1].geometry));
    }

    #[test]
    fn curves_that_are_no_chains_are_refused_by_name() {
        let curve = |rows: &[f64]| {
            let points = Points::from_rows(2, rows.to_vec());
            Record {
                name: Some("a b".into()),
                ..Record::new(Geometry::Curve { points, closed: true }, Place::default())
            }
        };
        let (text, summary) =
            written(&FORMAT, &[curve(&[0.0, 0.0, 0.5, 0.0, 0.5, 0.5])], &WriteOptions::default())
                .expect("a chain");
        assert_eq!((text.as_str(), summary.dropped.len()), ("a_b 0 0 0.25 3 0 6 3 -1\n", 1));
        for (rows, message) in [
            (
                &[0.0, 0.0, 1.0, 0.0, 3.0, 0.0][..],
                "expected steps of one pixel of 1, got 2 pixels between points 1 and 2",
            ),
            (
                &[0.0, 0.0, 1.0, 0.5],
                "expected steps of one pixel of 0.5, got 2 pixels between points 0 and 1",
            ),
            (&[0.0, 0.0, 1.0, 0.0, 1.0, 0.0], "expected steps of one pixel, got none between points 1 and 2"),
            (
                &[0.0, 0.0, f64::NAN, f64::NAN],
                "expected steps of one pixel of 1, got NaN pixels between points 0 and 1",
            ),
            (&[], "expected a point or more, got none"),
            (&[0.0, 0.0], "expected steps of one pixel, got none between points 0 and 0"),
        ] {
            let error = written(&FORMAT, &[curve(rows)], &WriteOptions::default()).expect_err("no chain");
            assert_eq!(error.to_string(), format!("shape 'a b': {message}"));
        }
    }

    #[test]
    fn digits_beside_the_lattice_are_told() {
        let curve = |rows: &[f64]| {
            let points = Points::from_rows(2, rows.to_vec());
            Record::new(Geometry::Curve { points, closed: false }, Place::default())
        };
        let (text, summary) =
            written(&FORMAT, &[curve(&[0.0, 0.0, 1.0, 0.0, 2.00005, 1.0])], &WriteOptions::default())
                .expect("a chain");
        assert_eq!(text, "1 0 0 1 2 0 7 -1\n");
        assert_eq!(summary.dropped[0].what, "digits of points beside the lattice of pixels");
        assert_eq!(summary.warnings, ["1 shapes have no name: written with their number"]);
        let back = curve(&[0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
        let error = written(&FORMAT, &[back], &WriteOptions::default()).expect_err("a ring");
        let expected =
            "a shape without a name: expected a closed curve, got an open one that ends at its start";
        assert_eq!(error.to_string(), expected);
    }

    #[test]
    fn faults_name_their_line() {
        for (text, message) in [
            ("a 1 2 3", "item 0, line 1: expected the area in pixels, got the end of the file"),
            ("a 1 x 3 4", "item 0, line 1: expected a number, got 'x'"),
            ("a 1 2 3 4 0\n8 -1", "item 0, line 2: expected a chain code of 0 to 7 or -1, got '8'"),
            ("a 1 2 3 4 0\n-2 -1", "item 0, line 2: expected a chain code of 0 to 7 or -1, got '-2'"),
            ("\na 1 2 3 4 0", "item 0, line 2: expected a chain code or -1, got the end of the file"),
            (
                "a 1 2 1e300 4 0 -1",
                "item 0, line 1: expected coordinates within ±1e100, got 1e150 in point 1",
            ),
        ] {
            assert_eq!(fault(&FORMAT, text, &ReadOptions::default()), message);
        }
        check_truncations(&FORMAT, TWO.as_bytes());
    }
}
