//! Formats: how their files are recognised, read and written.

use std::io::Write;

use super::options::{ReadOptions, WriteOptions};
use super::record::{Kind, Sink};
use super::source::Source;
use super::write::{InUnit, Opened, Output, Writer};
use crate::error::{FaultKind, FileError};
use crate::summary::Summary;
use crate::unit::Unit;

/// Reads all records of a file.
pub(super) type Read = fn(&mut Source<'_>, &ReadOptions, Sink<'_>) -> Result<Summary, FileError>;
/// Begins a file.
pub(super) type Open = for<'a> fn(Output<'a>, &WriteOptions) -> Opened<'a>;

/// A format of files.
#[derive(Debug, Clone, Copy)]
pub struct Format {
    /// Word in options and queries, and the name of its page: `docs/formats/{id}.md`.
    pub id: &'static str,
    /// Name in messages.
    pub name: &'static str,
    /// Media types of requests and responses; the first one is written.
    pub media_types: &'static [&'static str],
    /// Endings of file names, lower case, without the first dot; the first one is written.
    pub extensions: &'static [&'static str],
    /// Whether the first bytes of a file (at most 4096) can only be of this format.
    pub recognise: fn(&[u8]) -> bool,
    /// Kinds of its records.
    pub kinds: &'static [Kind],
    /// Fields of [`ReadOptions`] that it obeys. `*` of archives: those of the files within.
    pub options: &'static [&'static str],
    pub(super) read: Option<Read>,
    pub(super) open: Option<Open>,
}

impl Format {
    /// Unit of coordinates by the definition of the format, in files that have no place for a unit.
    pub fn unit(&self) -> Option<Unit> {
        match self.id {
            "rtstruct" | "fcsv" => Some(Unit::Millimetre),
            "imagej-roi" | "imagej-roi-set" | "coco" => Some(Unit::Pixel),
            _ => None,
        }
    }

    /// Whether files of the format hold coordinates and nothing that describes a shape.
    pub fn holds_numbers_only(&self) -> bool {
        self.id == "npy"
    }

    /// Whether files of the format can be read.
    pub fn is_read(&self) -> bool {
        self.read.is_some()
    }

    /// Whether files of the format can be written.
    pub fn is_written(&self) -> bool {
        self.open.is_some()
    }

    /// Begins a file of this format. Coordinates are converted to its unit from that of each record, else from that of the options.
    ///
    /// # Errors
    /// A format that is only read; those of the output.
    pub fn writer<'a>(
        &self,
        output: impl Write + Send + 'a,
        options: &WriteOptions,
    ) -> Result<Box<dyn Writer + 'a>, FileError> {
        let Some(open) = self.open else {
            let detail =
                format!("expected a format that can be written, got {}, which is only read", self.name);
            return Err(FileError::new(FaultKind::Unsupported, detail));
        };
        options.check()?;
        let writer = open(Box::new(output), options)?;
        let given = options.unit.as_deref().and_then(Unit::find);
        Ok(match self.unit() {
            Some(unit) => Box::new(InUnit::new(writer, given, unit)),
            None => writer,
        })
    }
}
