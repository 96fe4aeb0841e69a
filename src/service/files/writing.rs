//! Files that are written within the memory for answers.

use std::io::Write;

use crate::service::app::ServiceError;
use crate::service::app::memory::{Memory, Purpose};
use crate::wire::files::{FileError, Format, Place, Record, Summary, WriteOptions};

/// Memory for each byte that a writer holds: the byte, the room of its list to grow, and its text.
const PER_BYTE: usize = 3;
/// Number of bytes reserved at a time.
const STEP: usize = 1 << 20;

/// Writes the records that `fill` passes on. Records that the format holds until the last one count as memory for answers.
///
/// # Errors
/// Shapes that the format cannot hold, or that take more memory than there is; errors of `fill`.
pub(super) fn write<T>(
    memory: &Memory,
    format: &'static Format,
    output: impl Write + Send,
    options: &WriteOptions,
    fill: impl FnOnce(&mut dyn FnMut(&Record) -> Result<(), FileError>) -> Result<T, ServiceError>,
) -> Result<(T, Summary), ServiceError> {
    let mut writer = format.writer(output, options)?;
    let mut room = memory.hold(Purpose::Answers, 0)?;
    let mut refusal = None;
    let filled = fill(&mut |record| {
        writer.push(record)?;
        let held = writer.held().saturating_mul(PER_BYTE);
        if held <= room.bytes() {
            return Ok(());
        }
        room.resize(held.saturating_add(STEP)).map_err(|error| {
            let stopped = FileError::too_large(Place::default(), error.to_string());
            refusal = Some(error);
            stopped
        })
    });
    match refusal {
        Some(error) => Err(error),
        None => Ok((filled?, writer.finish()?)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::app::memory::Quota;
    use crate::wire::files::{Geometry, Points, find};

    /// Writes shapes of 1 MB; how many were passed on, how much was held at the end, and the outcome.
    fn written(format: &str, shapes: usize) -> (usize, usize, Result<Summary, ServiceError>) {
        let memory = Memory::new(Quota { process: usize::MAX, bodies: 0, answers: 32 << 20 });
        let (mut passed, mut held) = (0, 0);
        let outcome =
            write(&memory, find(format).unwrap(), std::io::sink(), &WriteOptions::default(), |push| {
                for _ in 0..shapes {
                    let points = Points::from_rows(2, vec![0.5; 1 << 17]);
                    push(&Record::new(Geometry::Landmarks(points), Place::default()))?;
                    passed += 1;
                    held = memory.held(Purpose::Answers);
                }
                Ok(())
            });
        assert_eq!(memory.held(Purpose::Answers), 0);
        (passed, held, outcome.map(|((), summary)| summary))
    }

    #[test]
    fn formats_that_hold_their_shapes_are_refused_beyond_the_memory_for_answers() {
        // The last shape is held before it is counted.
        let (passed, held, refused) = written("npy", 40);
        assert_eq!((passed, held), (9, 9 * (3 << 20) + STEP));
        let refused = refused.unwrap_err();
        assert!(matches!(refused, ServiceError::Invalid(_)), "{refused}");
        assert!(refused.to_string().contains("ask for less at a time"), "{refused}");
        assert_eq!(written("npy", 9).2.unwrap().records, 9);
        let (passed, held, streamed) = written("ndjson", 40);
        assert_eq!((passed, held, streamed.unwrap().records), (40, 0, 40));
    }
}
