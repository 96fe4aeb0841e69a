//! Reading of tables.

use std::borrow::Cow;
use std::cmp::Reverse;
use std::collections::BTreeSet;
use std::io::{self, Read};

use csv::StringRecord;

use super::super::limits::Limits;
use super::super::options::{Decimal, ReadOptions};
use super::super::record::{Geometry, Points, Record, Sink};
#[cfg(feature = "morphometrics")]
use super::super::scalismo;
use super::super::source::Source;
use super::super::text::{Missing, count, is_missing, number, push, shown, value};
use super::columns::{Coordinates, Roles, recognised};
use crate::error::{FileError, Place};
use crate::summary::Summary;
use crate::value::Value;

/// A row may have a sixteenth of the bytes that may be held: its fields take several times the memory of their text.
const ROWS: usize = 16;

/// Fault of a row, after which the next one can be read.
const NO_TEXT: &str = "expected UTF-8 text, got other bytes";

/// Bytes of the table, of which one row has a limited number.
struct Bounded<'s, 'a> {
    source: &'s mut Source<'a>,
    /// Number of bytes since the last row.
    count: usize,
    limit: usize,
}

impl Read for Bounded<'_, '_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.count > self.limit {
            let detail = format!("expected rows of at most {} bytes, got a longer one", self.limit);
            return Err(io::Error::new(io::ErrorKind::FileTooLarge, detail));
        }
        let count = self.source.read(buffer)?;
        self.count += count;
        Ok(count)
    }
}

/// Rows with their lines.
pub(super) struct Rows<'s, 'a> {
    reader: csv::Reader<Bounded<'s, 'a>>,
    pub(super) record: StringRecord,
}

impl<'s, 'a> Rows<'s, 'a> {
    pub(super) fn new(source: &'s mut Source<'a>, separator: u8) -> Self {
        let limit = source.limits().held / ROWS;
        let reader = csv::ReaderBuilder::new()
            .has_headers(false)
            .flexible(true)
            .delimiter(separator)
            .from_reader(Bounded { source, count: 0, limit });
        Self { reader, record: StringRecord::new() }
    }

    /// Reads the next row. Returns its line.
    pub(super) fn next(&mut self) -> Result<Option<u64>, FileError> {
        let line = self.reader.position().line();
        let found = self.reader.read_record(&mut self.record);
        self.reader.get_mut().count = 0;
        let found = found.map_err(|error| {
            let at = Place::line(error.position().map_or(line, csv::Position::line));
            match error.into_kind() {
                csv::ErrorKind::Io(error) => FileError::from(error).at(at),
                _ => FileError::malformed(at, NO_TEXT),
            }
        })?;
        Ok(found.then(|| self.record.position().map_or(line, csv::Position::line)))
    }
}

/// Comma, semicolon or tab: the one of which the header has most outside of quotation marks. Names of attributes may have others: one
/// that makes columns of coordinates of the header comes first.
pub(super) fn separator(head: &[u8]) -> u8 {
    let mut counts = [(b',', 0), (b';', 0), (b'\t', 0)];
    let mut quoted = false;
    for byte in head {
        quoted ^= *byte == b'"';
        if *byte == b'\n' && !quoted {
            break;
        }
        for (separator, count) in &mut counts {
            *count += usize::from(!quoted && byte == separator);
        }
    }
    // The first of equals is the comma.
    counts.sort_by_key(|(_, count)| Reverse(*count));
    let has_coordinates = |(separator, _): &&(u8, usize)| recognised(&header(head, *separator), None).is_ok();
    counts.iter().find(has_coordinates).unwrap_or(&counts[0]).0
}

/// Separator of fields, and whether a comma stands before decimals: where semicolons or tabs separate, and a number that has a
/// comma comes before one that has a point.
fn style(head: &[u8], options: &ReadOptions) -> (u8, bool) {
    let separator = separator(head);
    let given = options.decimal.map(|decimal| decimal == Decimal::Comma);
    (separator, given.unwrap_or_else(|| separator != b',' && has_commas(head, separator)))
}

/// Whether the first number of a table that has decimals has them behind a comma.
fn has_commas(head: &[u8], separator: u8) -> bool {
    let reader = csv::ReaderBuilder::new().delimiter(separator).flexible(true).from_reader(head);
    let rows = reader.into_records().map_while(Result::ok);
    let decimals = |row: StringRecord| {
        row.iter()
            .map(str::trim)
            .find(|field| field.contains([',', '.']) && number(&field.replacen(',', ".", 1)).is_ok())
            .map(|field| field.contains(','))
    };
    rows.filter_map(decimals).next().unwrap_or(false)
}

/// Names of the columns of a table.
fn header(head: &[u8], separator: u8) -> Vec<String> {
    let reader = csv::ReaderBuilder::new().has_headers(false).delimiter(separator).from_reader(head);
    let names = reader.into_records().next().and_then(Result::ok);
    names.as_ref().map(names_of).unwrap_or_default()
}

/// Names of columns without the mark of UTF-8 and the space around them.
fn names_of(record: &StringRecord) -> Vec<String> {
    record.iter().map(|name| name.trim_start_matches('\u{feff}').trim().to_owned()).collect()
}

pub(super) fn read(
    source: &mut Source<'_>,
    options: &ReadOptions,
    sink: Sink<'_>,
) -> Result<Summary, FileError> {
    #[cfg(feature = "morphometrics")]
    if options.columns.is_none() && scalismo::is_table(source.head()) {
        return scalismo::read_table(source, sink);
    }
    let limits = *source.limits();
    let (separator, comma) = style(source.head(), options);
    let mut rows = Rows::new(source, separator);
    if rows.next()?.is_none() {
        return Err(FileError::truncated(Place::line(0), "expected a header, got the end of the file"));
    }
    let roles = Roles::new(names_of(&rows.record), options, &limits)?;
    let missing = Missing::new(options, Missing::Words)?;
    let mut summary = Summary::default();
    for column in &roles.others {
        summary.drop("columns", Some(&roles.names[*column]), || Place::line(1));
    }
    let (layout, dimension) = match &roles.coordinates {
        Coordinates::Wide { dimension, .. } => ("wide", *dimension),
        Coordinates::Long(columns) => ("long", columns.len()),
    };
    summary.set("layout", layout);
    summary.set("dimension", dimension);
    if comma {
        summary.set("decimal", "comma");
    }
    let mut table = Table { roles, missing, closed: options.closed, comma, limits, summary };
    match &table.roles.coordinates {
        Coordinates::Wide { .. } => table.wide(&mut rows, options, sink)?,
        Coordinates::Long(_) => table.long(&mut rows, options, sink)?,
    }
    Ok(table.summary)
}

struct Table {
    roles: Roles,
    missing: Missing,
    closed: Option<bool>,
    /// Whether a comma stands before decimals.
    comma: bool,
    limits: Limits,
    summary: Summary,
}

/// The rows of one shape, in a table of one point a row.
struct Group {
    name: Option<String>,
    /// The shape so far, or the first fault of its rows.
    shape: Result<Draft, FileError>,
}

/// A shape of which more rows may follow.
struct Draft {
    record: Record,
    points: Points,
    closed: Option<bool>,
    names: Vec<String>,
    /// Attributes of the first row, as texts.
    attributes: Vec<String>,
}

impl Table {
    fn wide(
        &mut self,
        rows: &mut Rows<'_, '_>,
        options: &ReadOptions,
        sink: Sink<'_>,
    ) -> Result<(), FileError> {
        let mut item = 0;
        loop {
            let found = match rows.next() {
                Ok(None) => return Ok(()),
                Ok(Some(line)) => {
                    let place = Place { item: Some(item), ..Place::line(line) };
                    self.row(&rows.record, place)
                }
                Err(error) if error.detail == NO_TEXT => Err(error),
                Err(error) => return Err(error),
            };
            match found {
                Ok(record) => sink(record)?,
                Err(error) => options.leave_out(error, &mut self.summary)?,
            }
            item += 1;
        }
    }

    /// The shape of a row, in a table of one shape a row.
    fn row(&mut self, row: &StringRecord, place: Place) -> Result<Record, FileError> {
        self.check_width(row, &place)?;
        let Coordinates::Wide { dimension, columns } = &self.roles.coordinates else {
            return Err(FileError::malformed(place, "expected one shape a row, got one point a row"));
        };
        let mut points = Points::new(*dimension);
        for columns in columns.chunks_exact(*dimension) {
            self.point(row, columns, &mut points, &place)?;
        }
        let closed = self.closed(row, &place)?;
        // A row of a curve may have fewer points than the table has columns for.
        if closed.is_some() {
            let is_empty = |columns: &&[usize]| columns.iter().all(|at| row[*at].trim().is_empty());
            columns.chunks_exact(*dimension).rev().take_while(is_empty).for_each(|_| points.pop());
        }
        self.record(row, geometry(points, closed), place)
    }

    fn long(
        &mut self,
        rows: &mut Rows<'_, '_>,
        options: &ReadOptions,
        sink: Sink<'_>,
    ) -> Result<(), FileError> {
        let (mut seen, mut held) = (BTreeSet::new(), 0);
        let (mut group, mut item) = (None::<Group>, 0);
        while let Some(line) = rows.next()? {
            let place = Place { item: Some(item), ..Place::line(line) };
            let id = self.identity(&rows.record, &place)?;
            if let Some(done) = group.take_if(|group| group.name.as_deref() != id) {
                item += 1;
                held += done.name.as_ref().map_or(0, String::len) + size_of::<String>();
                if held > self.limits.held {
                    let detail =
                        format!("expected names of at most {} bytes in all, got more", self.limits.held);
                    return Err(FileError::too_large(place, detail));
                }
                seen.insert(done.name.clone());
                self.give(done, options, sink)?;
            }
            let place = Place { item: Some(item), ..place };
            let mut open = match group.take() {
                Some(group) => group,
                None if seen.contains(&id.map(str::to_owned)) => return Err(apart(id, place)),
                None => Group { name: id.map(str::to_owned), shape: self.begin(&rows.record, &place) },
            };
            if let Ok(draft) = &mut open.shape {
                self.limits.points(draft.points.len() as u64 + 1, || place.clone())?;
                if let Err(error) = self.add(&rows.record, draft, &place) {
                    open.shape = Err(error);
                }
            }
            match open.shape {
                Err(error) if !options.leaves_out(&error) => return Err(error),
                _ => group = Some(open),
            }
        }
        group.map_or(Ok(()), |group| self.give(group, options, sink))
    }

    /// Gives a shape on whose rows have ended, or counts it as broken.
    fn give(&mut self, group: Group, options: &ReadOptions, sink: Sink<'_>) -> Result<(), FileError> {
        match group.shape.and_then(Draft::finish) {
            Ok(record) => sink(record),
            Err(error) => options.leave_out(error, &mut self.summary),
        }
    }

    /// The name of the shape that a row belongs to, which a row of another width may have as well.
    fn identity<'r>(&self, row: &'r StringRecord, place: &Place) -> Result<Option<&'r str>, FileError> {
        match self.roles.id {
            Some(column) if column >= row.len() => self.check_width(row, place).map(|()| None),
            column => Ok(self.text(row, column)),
        }
    }

    fn begin(&self, row: &StringRecord, place: &Place) -> Result<Draft, FileError> {
        self.check_width(row, place)?;
        let Coordinates::Long(columns) = &self.roles.coordinates else {
            return Err(FileError::malformed(place.clone(), "expected one point a row, got one shape a row"));
        };
        let points = Points::new(columns.len());
        let closed = self.closed(row, place)?;
        let record = self.record(row, Geometry::Landmarks(points.clone()), place.clone())?;
        let attributes = self.roles.attributes.iter().map(|column| row[*column].to_owned()).collect();
        Ok(Draft { record, points, closed, names: Vec::new(), attributes })
    }

    fn add(&mut self, row: &StringRecord, draft: &mut Draft, place: &Place) -> Result<(), FileError> {
        self.check_width(row, place)?;
        if let Coordinates::Long(columns) = &self.roles.coordinates {
            self.point(row, columns, &mut draft.points, place)?;
        }
        if let Some(point) = self.roles.point {
            draft.names.push(row[point].trim().to_owned());
        }
        for (column, first) in self.roles.attributes.iter().zip(&draft.attributes) {
            if row[*column] != **first {
                let name = &self.roles.names[*column];
                self.summary.drop("values that differ within a shape", Some(name), || place.clone());
            }
        }
        Ok(())
    }

    fn check_width(&self, row: &StringRecord, place: &Place) -> Result<(), FileError> {
        let expected = self.roles.names.len();
        if row.len() == expected {
            return Ok(());
        }
        let detail = format!("expected {expected} fields as in the header, got {}", row.len());
        Err(FileError::malformed(place.clone(), detail))
    }

    /// A place in a column.
    fn within(&self, column: usize, place: &Place) -> Place {
        Place { tag: Some(format!("column {}", shown(&self.roles.names[column]))), ..place.clone() }
    }

    fn point(
        &self,
        row: &StringRecord,
        columns: &[usize],
        points: &mut Points,
        place: &Place,
    ) -> Result<(), FileError> {
        let mut point = [None; 3];
        let mut more = Vec::new();
        // Three coordinates need no memory.
        let point = if columns.len() <= 3 {
            &mut point[..columns.len()]
        } else {
            more.resize(columns.len(), None);
            &mut more[..]
        };
        for (x, column) in point.iter_mut().zip(columns) {
            let field = row[*column].trim();
            if !field.is_empty() && !is_missing(field) {
                let found = self.number(field);
                *x = Some(found.map_err(|detail| FileError::malformed(self.within(*column, place), detail))?);
            }
        }
        self.missing.apply(point);
        push(points, point).map_err(|detail| FileError::malformed(place.clone(), detail))
    }

    /// A number with the decimals of the table.
    fn number(&self, field: &str) -> Result<f64, String> {
        match (self.comma, number(field)) {
            (true, _) if field.contains('.') => {
                Err(format!("expected a number with a decimal comma (option decimal), got {}", shown(field)))
            }
            (true, _) => {
                number(&self.pointed(field)).map_err(|_| format!("expected a number, got {}", shown(field)))
            }
            (false, Err(detail)) if number(&field.replacen(',', ".", 1)).is_ok() => {
                Err(format!("{detail} (decimal=comma reads decimal commas)"))
            }
            (false, found) => found,
        }
    }

    /// A field with a point before its decimals.
    fn pointed<'f>(&self, field: &'f str) -> Cow<'f, str> {
        match self.comma && field.contains(',') && !field.contains('.') {
            true => field.replacen(',', ".", 1).into(),
            false => field.into(),
        }
    }

    /// An attribute with the decimals of the table.
    fn value(&self, field: &str) -> Value {
        match value(&self.pointed(field)) {
            Value::Text(_) => Value::Text(field.into()),
            found => found,
        }
    }

    /// A field that is neither empty nor missing.
    fn text<'r>(&self, row: &'r StringRecord, column: Option<usize>) -> Option<&'r str> {
        column
            .map(|column| row[column].trim())
            .filter(|text| !text.is_empty() && !text.eq_ignore_ascii_case("na"))
    }

    /// Whether a curve is closed; `None` for landmarks.
    fn closed(&self, row: &StringRecord, place: &Place) -> Result<Option<bool>, FileError> {
        let Some(text) = self.text(row, self.roles.closed) else { return Ok(self.closed) };
        match text.to_lowercase().as_str() {
            "true" | "1" | "t" | "yes" => Ok(Some(true)),
            "false" | "0" | "f" | "no" => Ok(Some(false)),
            _ => {
                let at = self.within(self.roles.closed.unwrap_or(0), place);
                Err(FileError::malformed(at, format!("expected true or false, got {}", shown(text))))
            }
        }
    }

    fn record(&self, row: &StringRecord, geometry: Geometry, place: Place) -> Result<Record, FileError> {
        let owned = |column| self.text(row, column).map(str::to_owned);
        let weight = self.text(row, self.roles.weight).map(|field| self.number(field)).transpose();
        let weight = weight.map_err(|detail| {
            FileError::malformed(self.within(self.roles.weight.unwrap_or(0), &place), detail)
        })?;
        let attribute = |column: &usize| {
            let value = self.value(self.text(row, Some(*column))?);
            // Row numbers of pandas and R beside ids have no name.
            let name = match self.roles.names[*column].as_str() {
                "" => format!("column_{}", column + 1),
                name => name.to_owned(),
            };
            Some((name, value))
        };
        Ok(Record {
            name: owned(self.roles.id),
            label: owned(self.roles.label),
            subject: owned(self.roles.subject),
            weight,
            labels: self.roles.attributes.iter().filter_map(attribute).collect(),
            ..Record::new(geometry, place)
        })
    }
}

/// The fault of rows of a shape that stand after those of others. It is one of the whole table: the shape has been given on without them.
fn apart(id: Option<&str>, place: Place) -> FileError {
    let name = id.map_or_else(|| "a shape without a name".into(), |id| format!("shape {}", shown(id)));
    FileError::malformed(place, format!("expected the rows of {name} side by side, got more after others"))
}

fn geometry(points: Points, closed: Option<bool>) -> Geometry {
    match closed {
        Some(closed) => Geometry::Curve { points, closed },
        None => Geometry::Landmarks(points),
    }
}

impl Draft {
    fn finish(self) -> Result<Record, FileError> {
        let Self { mut record, points, closed, names, .. } = self;
        let numbers: Option<Vec<u64>> = names.iter().map(|name| count(name).ok()).collect();
        match numbers {
            Some(numbers) => {
                let mut last = None;
                for number in numbers {
                    let in_order = last.map_or(number <= 1, |last: u64| last.checked_add(1) == Some(number));
                    if !in_order {
                        let after = last.map_or_else(|| "at first".into(), |last| format!("after {last}"));
                        let detail = format!("expected points numbered in order, got {number} {after}");
                        return Err(FileError::malformed(record.place, detail));
                    }
                    last = Some(number);
                }
            }
            None => {
                record.metadata.insert("landmark_names".into(), names.into());
            }
        }
        record.geometry = geometry(points, closed);
        Ok(record)
    }
}
