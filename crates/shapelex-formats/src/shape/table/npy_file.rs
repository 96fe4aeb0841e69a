//! NPY: shapes of equal numbers of points as one array of NumPy, shapes × points × coordinates.

use std::io::{Read, Write};

use super::super::format::Format;
use super::super::options::{ReadOptions, WriteOptions};
use super::super::record::Sink;
use super::super::record::{Geometry, Kind, Points, Record};
use super::super::source::Source;
use super::super::write::{Opened, Output, Writer};
use super::npy::{Header, Layout, MAGIC, exactly, header_bytes};
use crate::error::{FaultKind, FileError, Place};
use crate::summary::Summary;

/// NPY.
pub(in super::super) static FORMAT: Format = Format {
    id: "npy",
    name: "NPY",
    media_types: &["application/x-npy"],
    extensions: &["npy"],
    recognise: |head| head.starts_with(MAGIC),
    kinds: &[Kind::Curve, Kind::Landmarks],
    options: &["closed", "dimension"],
    read: Some(read),
    open: Some(open),
};

fn read(source: &mut Source<'_>, options: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let header = Header::read(source)?;
    let layout = Layout::of(&header, options, &limits)?;
    let mut give =
        |points, shape: usize| sink(Record::new(geometry(points, options), Place::item(shape as u64)));
    if header.fortran {
        let count = header.count()?.saturating_mul(header.size as u64);
        let count = usize::try_from(count).ok().filter(|count| *count <= limits.held).ok_or_else(|| {
            let detail = format!("expected at most {} bytes in Fortran order, got {count}", limits.held);
            FileError::too_large(Place::tag("header of the array"), detail)
        })?;
        let bytes = exactly(source, count)?;
        for shape in 0..layout.shapes {
            give(layout.transposed(&header, &bytes, shape), shape)?;
        }
    } else {
        for shape in 0..layout.shapes {
            let items = exactly(source, layout.width().saturating_mul(header.size))
                .map_err(|error| error.at(Place::item(shape as u64)))?;
            let coordinates = items.chunks_exact(header.size).map(|item| header.number(item)).collect();
            give(Points::from_rows(layout.dimension, coordinates), shape)?;
        }
    }
    let mut rest = [0];
    if source.read(&mut rest)? > 0 {
        return Err(FileError::malformed(
            Place::byte(source.offset() - 1),
            "expected the end of the file, got more bytes",
        ));
    }
    Ok(Summary::default())
}

/// Points as the options say: a curve if they say whether it is closed.
pub(super) fn geometry(points: Points, options: &ReadOptions) -> Geometry {
    match options.closed {
        Some(closed) => Geometry::Curve { points, closed },
        None => Geometry::Landmarks(points),
    }
}

/// The points of a record, and whether they are a closed curve.
///
/// # Errors
/// Geometry that has more than points.
pub(super) fn points_of(record: &Record) -> Result<(&Points, Option<bool>), FileError> {
    match &record.geometry {
        Geometry::Curve { points, closed } => Ok((points, Some(*closed))),
        Geometry::Landmarks(points) => Ok((points, None)),
        other => {
            let detail =
                format!("expected curves or landmarks in an array of points, got {:?}", other.kind());
            Err(FileError::unsupported(record.place.clone(), detail))
        }
    }
}

struct Array<'a> {
    output: Output<'a>,
    /// Points and coordinates of the first shape, which all have.
    size: Option<(usize, usize)>,
    /// Number of shapes, if it is known before the last one.
    count: Option<u64>,
    /// Coordinates of all shapes, if it is not.
    values: Vec<f64>,
    summary: Summary,
}

fn open<'a>(output: Output<'a>, options: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(Array {
        output,
        size: None,
        count: options.shapes,
        values: Vec::new(),
        summary: Summary::default(),
    }))
}

impl Array<'_> {
    fn write_header(&mut self, count: u64) -> Result<(), FileError> {
        let (points, dimension) = self.size.unwrap_or((0, 2));
        let count = usize::try_from(count).unwrap_or(usize::MAX);
        Ok(self.output.write_all(&header_bytes("<f8", &[count, points, dimension]))?)
    }
}

impl Writer for Array<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let (points, closed) = points_of(record)?;
        let found = (points.len(), points.dimension());
        let wanted = *self.size.get_or_insert(found);
        if found != wanted {
            let detail = format!(
                "expected {} points of {} coordinates in every shape of an array, got {} of {}; NPZ and Parquet hold others",
                wanted.0, wanted.1, found.0, found.1
            );
            return Err(FileError::unsupported(record.place.clone(), detail));
        }
        match self.count {
            None => self.values.extend_from_slice(points.coordinates()),
            Some(count) => {
                if self.summary.records == 0 {
                    self.write_header(count)?;
                }
                write_numbers(&mut self.output, points.coordinates())?;
            }
        }
        let lost = [
            ("external ids", record.name.is_some()),
            ("subjects", record.subject.is_some()),
            ("labels", record.label.is_some()),
            ("attributes", !record.labels.is_empty()),
            ("weights", record.weight.is_some()),
            ("metadata", !record.metadata.is_empty()),
            ("statements that a curve is closed or open", closed.is_some()),
            ("places among the rings of an object", record.ring.is_some()),
        ];
        for (what, _) in lost.into_iter().filter(|(_, lost)| *lost) {
            self.summary.drop(what, None, || record.place.clone());
        }
        self.summary.records += 1;
        Ok(())
    }

    fn held(&self) -> usize {
        size_of_val(&self.values[..])
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        let found = self.summary.records;
        match self.count {
            Some(count) if count != found => {
                let detail =
                    format!("expected {count} shapes, as was said before the first one, got {found}");
                return Err(FileError::new(FaultKind::Malformed, detail));
            }
            Some(_) if found > 0 => {}
            _ => self.write_header(found)?,
        }
        write_numbers(&mut self.output, &self.values)?;
        self.output.flush()?;
        Ok(self.summary)
    }
}

/// Little-endian doubles.
pub(super) fn write_numbers(output: &mut impl Write, values: &[f64]) -> Result<(), FileError> {
    for block in values.chunks(4096) {
        output.write_all(&block.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(count: Option<u64>, shapes: usize) -> (Result<Summary, FileError>, usize, Vec<u8>) {
        let mut bytes = Vec::new();
        let options = WriteOptions { shapes: count, ..WriteOptions::default() };
        let mut writer = FORMAT.writer(&mut bytes, &options).expect("a writer");
        for k in 0..shapes {
            let points = Points::from_rows(2, (0..6).map(|i| (6 * k + i) as f64).collect());
            writer.push(&Record::new(Geometry::Landmarks(points), Place::default())).expect("three points");
        }
        let held = writer.held();
        (writer.finish(), held, bytes)
    }

    #[test]
    fn an_array_whose_length_is_known_is_not_held() {
        let (summary, held, bytes) = written(None, 5);
        assert_eq!((summary.expect("written").records, held), (5, 5 * 6 * 8));
        let (summary, held, same) = written(Some(5), 5);
        assert_eq!((summary.expect("written").records, held), (5, 0));
        assert_eq!(bytes, same);
        assert_eq!(written(Some(0), 0).2, written(None, 0).2);
        let refused = written(Some(6), 5).0.expect_err("one is missing").to_string();
        assert_eq!(refused, "expected 6 shapes, as was said before the first one, got 5");
    }
}
