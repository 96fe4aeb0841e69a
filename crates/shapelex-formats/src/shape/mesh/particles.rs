//! Particles of ShapeWorks: text with a point a line, as landmarks in space.

use std::io::Write;

use super::super::format::Format;
use super::super::options::{ReadOptions, WriteOptions};
use super::super::record::Sink;
use super::super::record::{Geometry, Kind, Points, Record};
use super::super::source::Source;
use super::super::write::{Opened, Output, Writer};
use super::part::{Part, count_lost, drop_name, one_only, refused};
use super::scan::{number, words};
use crate::error::{FileError, Place};
use crate::summary::Summary;

/// Particles of ShapeWorks.
pub(in super::super) static FORMAT: Format = Format {
    id: "particles",
    name: "ShapeWorks particles",
    media_types: &["text/x-shapeworks-particles"],
    extensions: &["particles"],
    recognise: |_| false,
    kinds: &[Kind::Landmarks],
    options: &[],
    read: Some(read),
    open: Some(open),
};

fn read(source: &mut Source<'_>, _: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let mut points = Points::new(3);
    let mut line = String::new();
    while source.next_line(&mut line)? {
        let place = || Place::line(source.line());
        let row = words(line.as_bytes()).map(|word| number(word, "a coordinate", place));
        match row.collect::<Result<Vec<f64>, _>>()?[..] {
            [] => {}
            [x, y, z] => {
                if let Some(x) = [x, y, z].iter().find(|x| !x.is_finite()) {
                    return Err(FileError::malformed(
                        place(),
                        format!("expected finite coordinates, got {x}"),
                    ));
                }
                source.limits().points(points.len() as u64 + 1, place)?;
                points.push(&[x, y, z]);
            }
            ref other => {
                return Err(FileError::malformed(
                    place(),
                    format!("expected 3 coordinates, got {}", other.len()),
                ));
            }
        }
    }
    if points.is_empty() {
        return Err(FileError::malformed(Place::default(), "expected points, got none"));
    }
    sink(Record::new(Geometry::Landmarks(points), Place::default()))?;
    Ok(Summary::default())
}

struct File<'a> {
    output: Output<'a>,
    summary: Summary,
}

fn open<'a>(output: Output<'a>, _: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(File { output, summary: Summary::default() }))
}

impl Writer for File<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        if self.summary.records > 0 {
            return Err(one_only("a file of particles"));
        }
        let part = Part::of(record, "a file of particles")?;
        let Part::Points(points) = part else {
            return Err(refused(record, "a file of particles", "another shape than landmarks"));
        };
        drop_name(record, &mut self.summary);
        count_lost(part, record, &[], &mut self.summary, |_, _| false);
        for row in points.rows() {
            writeln!(self.output, "{} {} {}", row[0], row[1], row[2])?;
        }
        self.summary.records += 1;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        self.output.flush()?;
        Ok(self.summary)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{changed, cut_off, read, refusal, write};
    use super::*;

    #[test]
    fn what_is_written_comes_back() {
        let text = "0.1 -2 3\n1e-300 0 4.000000000000001 \n\n7\t8  9\r\n";
        let (found, _) = read(&FORMAT, text.as_bytes()).unwrap();
        let Geometry::Landmarks(points) = &found[0].geometry else { panic!("no landmarks") };
        assert_eq!(points.coordinates(), [0.1, -2.0, 3.0, 1e-300, 0.0, 4.000000000000001, 7.0, 8.0, 9.0]);
        let bytes = write(&FORMAT, &found, &WriteOptions::default()).unwrap();
        assert_eq!(read(&FORMAT, &bytes).unwrap().0, found);
        cut_off(&FORMAT, text.as_bytes(), true);
        changed(&FORMAT, text.as_bytes());
    }

    #[test]
    fn faults_name_the_line() {
        for (text, expected) in [
            ("1 2 3\n1 2\n", "line 2: expected 3 coordinates, got 2"),
            ("1 2 x\n", "line 1: expected a coordinate, got 'x'"),
            ("1 2 nan\n", "line 1: expected finite coordinates, got NaN"),
            ("\n", "expected points, got none"),
        ] {
            assert_eq!(refusal(&FORMAT, text.as_bytes()), expected);
        }
        let plane = Record::new(Geometry::Landmarks(Points::from_rows(2, vec![0.0, 1.0])), Place::default());
        let plane = Record { name: Some("a".into()), ..plane };
        let error = write(&FORMAT, &[plane], &WriteOptions::default()).unwrap_err();
        let expected = "expected shapes in space that a file of particles can hold, got a shape of the plane of shape 'a'";
        assert_eq!(error.to_string(), expected);
    }
}
