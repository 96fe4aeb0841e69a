//! Arrow IPC: streams, in and out, and files, in.
//!
//! A stream is a sequence of messages: `FFFFFFFF`, the length of the metadata (32 bits), the metadata (a flat buffer), and a
//! body whose length the metadata give. A file is a stream between a magic text and a table of contents, which is not needed
//! to read it from front to back.

use std::io::{Read, Write};

use arrow_array::RecordBatch;
use arrow_buffer::Buffer;
use arrow_ipc::reader::StreamDecoder;
use arrow_ipc::writer::StreamWriter;

use super::super::format::Format;
use super::super::guarded::guarded;
use super::super::limits::{Budget, Limits};
use super::super::options::{ReadOptions, WriteOptions};
use super::super::record::Sink;
use super::super::record::{Kind, Record};
use super::super::source::Source;
use super::super::write::{Opened, Output, Writer};
use super::checks::{check_buffers, check_message};
use super::columns::{CELLS, unwritten};
use super::dictionaries::{COPIED, Dictionaries};
use super::layout::Layout;
use super::read_rows::Reading;
use super::rows::Rows;
use crate::error::{FileError, Place};
use crate::summary::Summary;

/// Arrow IPC.
pub(in super::super) static FORMAT: Format = Format {
    id: "arrow",
    name: "Arrow IPC",
    media_types: &["application/vnd.apache.arrow.stream", "application/vnd.apache.arrow.file"],
    extensions: &["arrows", "arrow", "feather"],
    recognise,
    kinds: &[Kind::Curve, Kind::Landmarks, Kind::Mesh],
    options: &["closed", "columns", "dimension", "attributes"],
    read: Some(read),
    open: Some(open),
};

/// First bytes of a file.
const MAGIC: &[u8] = b"ARROW1\0\0";
/// First bytes of a message.
const CONTINUATION: [u8; 4] = [0xff; 4];
/// Largest number of zeros behind them.
const MAX_PADDING: usize = 56;
/// Largest number of bytes of the metadata of a message.
const MAX_METADATA: usize = 16 << 20;

fn recognise(head: &[u8]) -> bool {
    if head.starts_with(MAGIC) {
        return true;
    }
    let length = head.strip_prefix(&CONTINUATION).and_then(|rest| rest.first_chunk::<4>());
    let length = length.and_then(|bytes| usize::try_from(u32::from_le_bytes(*bytes)).ok());
    length.is_some_and(|length| (8..=MAX_METADATA).contains(&length) && length.is_multiple_of(8))
}

fn read(source: &mut Source<'_>, options: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let is_file = source.head().starts_with(MAGIC);
    if is_file {
        // Zeros follow up to a boundary of 8 or 64 bytes.
        let padding =
            source.head()[MAGIC.len()..].iter().take(MAX_PADDING).take_while(|byte| **byte == 0).count();
        exactly(source, MAGIC.len() + padding, "the magic text of a file")?;
    }
    let mut decoder = StreamDecoder::new();
    let (mut reading, mut known) = (None, Known::new(source));
    loop {
        let Message { at, head, metadata, body } = next_message(source, &known)?;
        let here = |error: FileError| error.at(Place::byte(at));
        // The decoder takes a message without a body, as that with the schema is, when more bytes follow.
        let mut batches = decode(&mut decoder, head).map_err(here)?;
        if let (None, Some(schema)) = (&reading, decoder.schema()) {
            reading = Some(Reading::new(options, *source.limits(), schema.metadata()));
            known.layout = Some(Layout::new(schema)?);
        }
        let is_end = metadata.is_empty();
        if !is_end {
            known.check(&metadata, &body, source).map_err(here)?;
            for part in [metadata, body] {
                batches.extend(decode(&mut decoder, part).map_err(here)?);
            }
        }
        if let Some(reading) = &mut reading {
            batches.iter().try_for_each(|batch| reading.batch(batch, sink))?;
        }
        if is_end {
            break;
        }
    }
    if is_file {
        check_footer(source)?;
    }
    match reading {
        Some(reading) => Ok(reading.summary),
        None => Err(FileError::truncated(
            Place::byte(source.offset()),
            "expected a schema, got the end of the file",
        )),
    }
}

/// Reads the part after the messages of a file: a table of contents, its length and the magic text.
fn check_footer(source: &mut Source<'_>) -> Result<(), FileError> {
    let at = source.offset();
    let rest = source.bytes()?;
    let footer = rest.strip_suffix(b"ARROW1".as_slice()).and_then(|rest| rest.split_last_chunk::<4>());
    let is_whole =
        footer.is_some_and(|(footer, length)| u32::from_le_bytes(*length) as usize == footer.len());
    if is_whole {
        Ok(())
    } else {
        Err(FileError::malformed(Place::byte(at), "expected the end of one Arrow file, got other bytes"))
    }
}

/// The batches that are complete with a part of a message.
fn decode(decoder: &mut StreamDecoder, part: Vec<u8>) -> Result<Vec<RecordBatch>, FileError> {
    guarded("an Arrow message", || {
        let mut batches = Vec::new();
        let mut part = Buffer::from_vec(part);
        while !part.is_empty() {
            let batch = decoder.decode(&mut part).map_err(|error| {
                FileError::malformed(Place::default(), format!("expected a valid message, got {error}"))
            })?;
            batches.extend(batch);
        }
        Ok(batches)
    })
}

/// A message: its parts as they are given to the decoder.
struct Message {
    at: u64,
    /// The mark of a message, and the length of its metadata.
    head: Vec<u8>,
    /// None at the end of the stream.
    metadata: Vec<u8>,
    body: Vec<u8>,
}

impl Message {
    /// The mark of the end.
    fn end(at: u64) -> Self {
        Self { at, head: [CONTINUATION, [0; 4]].concat(), metadata: Vec::new(), body: Vec::new() }
    }
}

/// State of a stream by the messages so far.
struct Known {
    /// The columns, once the decoder has the schema.
    layout: Option<Layout>,
    dictionaries: Dictionaries,
    cells: Budget,
}

impl Known {
    fn new(source: &Source<'_>) -> Self {
        let dictionaries = Dictionaries::new(source.budget(COPIED));
        Self { layout: None, dictionaries, cells: source.budget(CELLS) }
    }

    /// Limits on the content beside the dictionaries.
    fn limits(&self, limits: &Limits) -> Limits {
        let dictionaries = usize::try_from(self.dictionaries.kept()).unwrap_or(usize::MAX);
        Limits { held: limits.held.saturating_sub(dictionaries), ..*limits }
    }

    /// Checks the message up to which a file is read, and counts its content.
    fn check(&mut self, metadata: &[u8], body: &[u8], source: &Source<'_>) -> Result<(), FileError> {
        let limits = self.limits(source.limits());
        let Some(batch) = check_buffers(metadata, body, self.layout.as_ref(), &limits)? else {
            return Ok(());
        };
        self.cells.take(batch.cells)?;
        match batch.dictionary {
            Some(dictionary) => self.dictionaries.add(dictionary),
            None => Ok(()),
        }
    }
}

/// The next message, or the mark of the end.
fn next_message(source: &mut Source<'_>, known: &Known) -> Result<Message, FileError> {
    let at = source.offset();
    let mut first = Vec::new();
    source.by_ref().take(4).read_to_end(&mut first)?;
    if first.is_empty() {
        return Ok(Message::end(at));
    }
    // Streams before version 0.15 have no continuation mark.
    let length = if first == CONTINUATION { exactly(source, 4, "the length of a message")? } else { first };
    let length: [u8; 4] = length
        .try_into()
        .map_err(|_| FileError::truncated(Place::byte(at), "expected a message, got the end of the file"))?;
    let size = u32::from_le_bytes(length) as usize;
    if size == 0 {
        return Ok(Message::end(source.offset()));
    }
    if size > MAX_METADATA {
        let detail = format!("expected metadata of at most {MAX_METADATA} bytes, got {size}");
        return Err(FileError::too_large(Place::byte(at), detail));
    }
    let metadata = exactly(source, size, "the metadata of a message")?;
    let held = known.limits(source.limits()).held;
    let body = check_message(&metadata, held).map_err(|error| error.at(Place::byte(at)))?;
    let body = exactly(source, body, "the body of a message")?;
    Ok(Message { at, head: [CONTINUATION, length].concat(), metadata, body })
}

/// The next `count` bytes, for which memory is taken as they arrive.
fn exactly(source: &mut Source<'_>, count: usize, what: &str) -> Result<Vec<u8>, FileError> {
    let mut bytes = Vec::new();
    let found = source.by_ref().take(count as u64).read_to_end(&mut bytes)?;
    if found == count {
        return Ok(bytes);
    }
    let detail = format!("expected {count} bytes of {what}, got {found}");
    Err(FileError::truncated(Place::byte(source.offset()), detail))
}

struct Stream<'a> {
    rows: Rows,
    stage: Stage<'a>,
}

/// The output, until the first rows say which columns there are.
enum Stage<'a> {
    Waiting(Output<'a>),
    Begun(Box<StreamWriter<Output<'a>>>),
    Ended,
}

fn open<'a>(output: Output<'a>, options: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(Stream { rows: Rows::new(options), stage: Stage::Waiting(output) }))
}

impl Stream<'_> {
    fn write(&mut self, batch: &RecordBatch) -> Result<(), FileError> {
        let mut writer = match std::mem::replace(&mut self.stage, Stage::Ended) {
            Stage::Waiting(output) => {
                Box::new(StreamWriter::try_new(output, &batch.schema()).map_err(unwritten)?)
            }
            Stage::Begun(writer) => writer,
            Stage::Ended => return Err(unwritten("expected rows before the end, got more")),
        };
        if batch.num_rows() > 0 {
            writer.write(batch).map_err(unwritten)?;
        }
        self.stage = Stage::Begun(writer);
        Ok(())
    }
}

impl Writer for Stream<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        match self.rows.push(record)? {
            Some(batch) => self.write(&batch),
            None => Ok(()),
        }
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        if !self.rows.is_empty() || matches!(self.stage, Stage::Waiting(_)) {
            let batch = self.rows.take()?;
            self.write(&batch)?;
        }
        if let Stage::Begun(mut writer) = std::mem::replace(&mut self.stage, Stage::Ended) {
            writer.finish().map_err(unwritten)?;
            writer.get_mut().flush()?;
        }
        Ok(self.rows.summary)
    }
}
