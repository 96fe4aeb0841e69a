//! Without the family `morphometrics` no file of an archive is a project.

use super::super::options::ReadOptions;
use super::super::record::Sink;
use super::super::unzip::Archive;
use super::Files;
use crate::error::FileError;

/// No format has this id.
pub(super) const FORMAT: &str = "";

/// There is no project.
pub(super) fn read(
    _: &mut Archive,
    _: &mut Files<'_>,
    _: &ReadOptions,
    _: Sink<'_>,
) -> Result<Option<u64>, FileError> {
    Ok(None)
}
