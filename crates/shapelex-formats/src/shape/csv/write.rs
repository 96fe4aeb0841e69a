//! Writing of tables.

use std::io::Write;

use super::super::options::{Layout, WriteOptions};
use super::super::record::{Geometry, Points, Record};
use super::super::text::{self, Uniform, left_out, name_fits, refused, unfit};
use super::super::write::{Opened, Output, Writer};
use super::AXES;
use super::columns::numbered;
use crate::error::{FileError, Place};
use crate::summary::Summary;

/// Columns of the table, those of the first shape.
struct Header {
    dimension: usize,
    subject: bool,
    weight: bool,
    closed: bool,
    attributes: Vec<String>,
}

struct Table<'a> {
    writer: csv::Writer<Box<dyn Write + Send + 'a>>,
    layout: Layout,
    header: Option<Header>,
    size: Uniform,
    /// Name of the shape before, in tables of one point a row.
    last: Option<String>,
    numbered: u64,
    summary: Summary,
}

pub(super) fn open<'a>(output: Output<'a>, options: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(Table {
        writer: csv::Writer::from_writer(output),
        layout: options.layout.unwrap_or_default(),
        header: None,
        size: Uniform::default(),
        last: None,
        numbered: 0,
        summary: Summary::default(),
    }))
}

impl Writer for Table<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let (points, closed) = match &record.geometry {
            Geometry::Landmarks(points) => (points, None),
            Geometry::Curve { points, closed } => (points, Some(*closed)),
            _ => return Err(refused(record, "landmarks or a curve")),
        };
        if !(2..=3).contains(&points.dimension()) || points.is_empty() {
            let detail = format!(
                "expected a point or more of 2 or 3 coordinates, got {} of {}",
                points.len(),
                points.dimension()
            );
            return Err(unfit(record, detail));
        }
        let header = match self.header.take() {
            Some(header) => header,
            None => self.begin(record, points, closed.is_some())?,
        };
        let written = match self.layout {
            Layout::Wide => self.wide(&header, record, points, closed),
            Layout::Long => self.long(&header, record, points, closed),
        };
        self.left_out(&header, record, closed.is_some());
        self.header = Some(header);
        self.summary.records += 1;
        written
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        self.writer.flush()?;
        if self.numbered > 0 {
            let warning = format!("{} shapes have no name: written with their number", self.numbered);
            self.summary.warnings.push(warning);
        }
        Ok(self.summary)
    }
}

impl Table<'_> {
    fn begin(&mut self, record: &Record, points: &Points, is_curve: bool) -> Result<Header, FileError> {
        let header = Header {
            dimension: points.dimension(),
            subject: record.subject.is_some(),
            weight: record.weight.is_some(),
            closed: is_curve,
            attributes: record.labels.keys().filter(|name| is_attribute(name)).cloned().collect(),
        };
        let mut names: Vec<String> = vec!["id".into(), "label".into()];
        let optional =
            [(header.subject, "subject"), (header.weight, "mean_weight"), (header.closed, "closed")];
        names.extend(optional.iter().filter(|(given, _)| *given).map(|(_, name)| (*name).into()));
        names.extend(header.attributes.iter().cloned());
        match self.layout {
            Layout::Wide => {
                let number =
                    |k: usize| AXES[..header.dimension].iter().map(move |axis| format!("{axis}{}", k + 1));
                names.extend((0..points.len()).flat_map(number));
            }
            Layout::Long => {
                names.push("point".into());
                names.extend(AXES[..header.dimension].iter().map(|axis| (*axis).into()));
            }
        }
        self.row(&names)?;
        Ok(header)
    }

    fn row(&mut self, fields: &[String]) -> Result<(), FileError> {
        self.writer.write_record(fields).map_err(|error| match error.into_kind() {
            csv::ErrorKind::Io(error) => error.into(),
            other => {
                FileError::malformed(Place::default(), format!("expected a row of the table, got {other:?}"))
            }
        })
    }

    /// The fields before the coordinates.
    fn fields(&self, header: &Header, record: &Record, name: &str, closed: Option<bool>) -> Vec<String> {
        let mut fields = vec![name.to_owned(), record.label.clone().unwrap_or_default()];
        let optional = [
            (header.subject, record.subject.clone()),
            (header.weight, record.weight.map(|weight| weight.to_string())),
            (header.closed, closed.map(|closed| closed.to_string())),
        ];
        fields.extend(
            optional.into_iter().filter(|(given, _)| *given).map(|(_, text)| text.unwrap_or_default()),
        );
        let attribute = |name: &String| record.labels.get(name).map(text::text_of).unwrap_or_default();
        fields.extend(header.attributes.iter().map(attribute));
        fields
    }

    fn wide(
        &mut self,
        header: &Header,
        record: &Record,
        points: &Points,
        closed: Option<bool>,
    ) -> Result<(), FileError> {
        self.size.check(record, points)?;
        let name = record.name.as_deref().unwrap_or_default();
        let mut fields = self.fields(header, record, name, closed.filter(|_| header.closed));
        fields.extend(points.coordinates().iter().map(coordinate));
        self.row(&fields)
    }

    fn long(
        &mut self,
        header: &Header,
        record: &Record,
        points: &Points,
        closed: Option<bool>,
    ) -> Result<(), FileError> {
        if points.dimension() != header.dimension {
            let detail = format!(
                "expected points of {} coordinates as in the first shape, got {}",
                header.dimension,
                points.dimension()
            );
            return Err(unfit(record, detail));
        }
        let name = match &record.name {
            Some(name) if !name.trim().is_empty() => name.clone(),
            _ => {
                self.numbered += 1;
                (self.summary.records + 1).to_string()
            }
        };
        if self.last.as_ref() == Some(&name) {
            return Err(unfit(record, "expected another name than that of the shape before, got the same"));
        }
        let names = record.metadata.get("landmark_names");
        let mut fields = self.fields(header, record, &name, closed.filter(|_| header.closed));
        let start = fields.len();
        for (k, row) in points.rows().enumerate() {
            fields.truncate(start);
            let point = names.and_then(|names| names.get(k)?.as_str().map(str::to_owned));
            fields.push(point.unwrap_or_else(|| (k + 1).to_string()));
            fields.extend(row.iter().map(coordinate));
            self.row(&fields)?;
        }
        self.last = Some(name);
        Ok(())
    }

    fn left_out(&mut self, header: &Header, record: &Record, is_curve: bool) {
        let mut kept = vec!["label", "labels"];
        kept.extend(header.subject.then_some("subject"));
        kept.extend(header.weight.then_some("weight"));
        kept.extend((self.layout == Layout::Long).then_some("landmark_names"));
        left_out(&mut self.summary, record, &kept);
        let place = || record.place.clone();
        for name in record.labels.keys().filter(|name| !header.attributes.contains(name)) {
            self.summary.drop("labels without a column", Some(name), place);
        }
        if is_curve && !header.closed {
            self.summary.drop("curves written as landmarks", record.name.as_deref(), place);
        }
    }
}

/// Whether the name of an attribute can be that of a column, which is none of a table's own.
fn is_attribute(name: &str) -> bool {
    let own = ["id", "label", "subject", "mean_weight", "closed", "point"];
    let lower = name.trim().to_lowercase();
    name_fits(name).is_ok()
        && !own.iter().chain(&AXES).any(|own| *own == lower)
        && numbered(name).is_none()
        && !lower.is_empty()
}

fn coordinate(x: &f64) -> String {
    if x.is_nan() { "NA".into() } else { x.to_string() }
}
