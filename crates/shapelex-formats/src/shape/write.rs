//! Writing records one after the other.

use std::io::Write;

use super::record::Record;
use crate::error::FileError;
use crate::summary::Summary;
use crate::unit::Unit;

/// Where the bytes of a file go.
pub(super) type Output<'a> = Box<dyn Write + Send + 'a>;
/// A file that was begun, or why it cannot be.
pub(super) type Opened<'a> = Result<Box<dyn Writer + 'a>, FileError>;

/// A file that is being written.
pub trait Writer: Send {
    /// Writes a record.
    ///
    /// # Errors
    /// A record that the format cannot hold, by name; errors of the output.
    fn push(&mut self, record: &Record) -> Result<(), FileError>;

    /// Number of bytes that wait for the last record: some formats state their content at the beginning.
    fn held(&self) -> usize {
        0
    }

    /// Writes the part after the last record, and returns the items left out.
    ///
    /// # Errors
    /// Those of the output.
    fn finish(self: Box<Self>) -> Result<Summary, FileError>;
}

/// A file whose coordinates have the unit of its format.
pub(super) struct InUnit<'a> {
    writer: Box<dyn Writer + 'a>,
    /// Unit of records that do not say theirs.
    given: Option<Unit>,
    unit: Unit,
    /// Number of records with another unit that cannot be converted, and that of the first one.
    others: (u64, Option<Unit>),
}

impl<'a> InUnit<'a> {
    pub(super) fn new(writer: Box<dyn Writer + 'a>, given: Option<Unit>, unit: Unit) -> Self {
        Self { writer, given, unit, others: (0, None) }
    }
}

impl Writer for InUnit<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let from = record.unit.or(self.given).filter(|from| *from != self.unit);
        match from.map(|from| (from, from.to(self.unit))) {
            None => self.writer.push(record),
            Some((from, Some(_))) => {
                let place = || record.place.clone();
                let converted = record.clone().converted(from, self.unit);
                self.writer.push(&converted.map_err(|error| error.at(place()))?)
            }
            Some((from, None)) => {
                self.others = (self.others.0 + 1, self.others.1.or(Some(from)));
                self.writer.push(record)
            }
        }
    }

    fn held(&self) -> usize {
        self.writer.held()
    }

    fn finish(self: Box<Self>) -> Result<Summary, FileError> {
        let mut summary = self.writer.finish()?;
        if let (count, Some(from)) = self.others {
            summary.warnings.push(format!(
                "{count} shapes in {} are written with the same numbers, which the format takes for {}",
                from.word(),
                self.unit.word()
            ));
        }
        Ok(summary)
    }
}
