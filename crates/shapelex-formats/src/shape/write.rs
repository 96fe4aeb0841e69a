//! Writing records one after the other.

use std::io::Write;

use super::error::FileError;
use super::record::Record;
use super::summary::Summary;

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

    /// Number of bytes that wait for the last record: some formats say at their beginning what follows.
    fn held(&self) -> usize {
        0
    }

    /// Writes what follows the last record, and says what was left out.
    ///
    /// # Errors
    /// Those of the output.
    fn finish(self: Box<Self>) -> Result<Summary, FileError>;
}
