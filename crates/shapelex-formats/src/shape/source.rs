//! The bytes of a file, one after the other, with their count.

use std::cell::Cell;
use std::io::{self, BufRead, BufReader, Cursor, Read};
use std::rc::Rc;

use flate2::read::MultiGzDecoder;

use super::limits::{Bound, Budget, Budgets, Limits};
use crate::error::{FileError, Place};

/// Number of bytes by which a format is recognised.
const HEAD: usize = 4096;
/// First bytes of a file compressed by gzip.
const GZIP: [u8; 2] = [0x1f, 0x8b];
/// Number of bytes read at once.
const BLOCK: usize = 1 << 16;

/// Number of bytes of a whole file that are read before memory for more is asked for.
const STEP: u64 = 1 << 20;

/// Reads on, by at most a MiB, so that memory can be asked for before the next one. Returns whether there was anything.
///
/// # Errors
/// Those of `reader`.
pub(crate) fn read_step(reader: &mut impl Read, bytes: &mut Vec<u8>) -> io::Result<bool> {
    Ok(reader.take(STEP).read_to_end(bytes)? > 0)
}

/// Memory that a reader asks for before it takes it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Asked {
    /// For as many bytes of a whole file, and the values made of them.
    Content(usize),
    /// For as many bytes beside them, such as those of an image that is decoded.
    Beside(usize),
}

impl Asked {
    /// Number of bytes.
    pub fn bytes(self) -> usize {
        match self {
            Self::Content(bytes) | Self::Beside(bytes) => bytes,
        }
    }
}

type Ask<'a> = Rc<dyn Fn(Asked) -> Result<(), FileError> + 'a>;

/// Bytes of a file. It counts them, and refuses more than the limits allow. A file compressed by gzip is decompressed: its bytes,
/// offsets and limits are those of its content.
pub struct Source<'a> {
    reader: BufReader<Box<dyn Read + 'a>>,
    /// First bytes of the file, which `reader` still gives.
    head: Vec<u8>,
    offset: u64,
    /// Number of bytes read of the file and of those within it.
    content: Rc<Cell<u64>>,
    budgets: Budgets,
    line: u64,
    limits: Limits,
    /// Whether more bytes may come out than have arrived.
    expands: bool,
    ask: Option<Ask<'a>>,
}

impl<'a> Source<'a> {
    /// The bytes that `reader` gives. Reads the first ones.
    ///
    /// # Errors
    /// Those of `reader`.
    pub fn new(mut reader: impl Read + 'a, limits: Limits) -> Result<Self, FileError> {
        let mut start = Vec::new();
        (&mut reader).take(2).read_to_end(&mut start)?;
        let compressed = start == GZIP;
        let reader = Cursor::new(start).chain(reader);
        let mut reader: Box<dyn Read + 'a> =
            if compressed { Box::new(Decompressed(MultiGzDecoder::new(reader))) } else { Box::new(reader) };
        let mut head = Vec::new();
        let begun = (&mut reader).take(HEAD as u64).read_to_end(&mut head);
        begun.map_err(|error| FileError::from(error).at(Place::byte(head.len() as u64)))?;
        let whole: Box<dyn Read + 'a> = Box::new(Cursor::new(head.clone()).chain(reader));
        let reader = BufReader::with_capacity(BLOCK, whole);
        let (content, budgets) = (Rc::default(), Budgets::default());
        Ok(Self {
            reader,
            head,
            offset: 0,
            content,
            budgets,
            line: 0,
            limits,
            expands: compressed,
            ask: None,
        })
    }

    /// Asks before more bytes are held than have arrived: of a compressed file, or of one within an archive.
    pub fn asking(self, ask: impl Fn(Asked) -> Result<(), FileError> + 'a) -> Self {
        Self { ask: Some(Rc::new(ask)), ..self }
    }

    /// The bytes of a file within this one, an archive.
    ///
    /// # Errors
    /// Those of `reader`.
    pub(super) fn inner<'b>(
        &'b self,
        reader: impl Read + 'b,
        limits: Limits,
    ) -> Result<Source<'b>, FileError> {
        let (ask, content, budgets) = (self.ask.clone(), self.content(), self.budgets.clone());
        Ok(Source { expands: true, ask, content, budgets, ..Source::new(reader, limits)? })
    }

    /// Asks for memory for `bytes` in all: those of the file, and the unpacked ones.
    ///
    /// # Errors
    /// [`FaultKind::Memory`](super::FaultKind::Memory) where there is none.
    pub(super) fn reserve(&self, bytes: usize) -> Result<(), FileError> {
        self.ask.as_ref().map_or(Ok(()), |ask| ask(Asked::Content(bytes)))
    }

    /// Asks for memory for `bytes` in all, beside those of the file.
    ///
    /// # Errors
    /// [`FaultKind::Memory`](super::FaultKind::Memory) where there is none.
    pub fn reserve_beside(&self, bytes: usize) -> Result<(), FileError> {
        self.ask.as_ref().map_or(Ok(()), |ask| ask(Asked::Beside(bytes)))
    }

    /// Asks for memory for bytes beside those of the file, while it is read.
    pub(super) fn asker(&self) -> impl Fn(usize) -> Result<(), FileError> + use<'a> {
        let ask = self.ask.clone();
        move |bytes| ask.as_ref().map_or(Ok(()), |ask| ask(Asked::Beside(bytes)))
    }

    /// The first bytes of the file, at most 4096.
    pub fn head(&self) -> &[u8] {
        &self.head
    }

    /// Limits of reading.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Number of bytes read.
    pub fn offset(&self) -> u64 {
        self.offset
    }

    /// Counts the bytes read of this file and of those within it.
    pub(super) fn content(&self) -> Rc<Cell<u64>> {
        Rc::clone(&self.content)
    }

    /// Budget of work of a kind for this file and those within it.
    pub(super) fn budget(&self, bound: Bound) -> Budget {
        self.budgets.get(bound, &self.content)
    }

    /// Number of lines read by [`next_line`](Self::next_line).
    pub fn line(&self) -> u64 {
        self.line
    }

    /// All bytes that are left, at most [`Limits::held`].
    ///
    /// # Errors
    /// [`FaultKind::TooLarge`](super::FaultKind::TooLarge); errors of the reader.
    pub fn bytes(&mut self) -> Result<Vec<u8>, FileError> {
        let limit = self.limits.held;
        let mut bytes = Vec::new();
        while read_step(self, &mut bytes)? {
            if bytes.len() > limit {
                let detail = format!("expected at most {limit} bytes of a file of this format, got more");
                return Err(FileError::too_large(Place::default(), detail));
            }
            if let Some(ask) = self.ask.as_ref().filter(|_| self.expands) {
                ask(Asked::Content(bytes.len()))?;
            }
        }
        Ok(bytes)
    }

    /// All text that is left, without a byte order mark.
    ///
    /// # Errors
    /// As [`bytes`](Self::bytes); the place of the first byte that is no UTF-8.
    pub fn text(&mut self) -> Result<String, FileError> {
        let bytes = self.bytes()?;
        let text = String::from_utf8(bytes).map_err(|error| {
            let at = error.utf8_error().valid_up_to() as u64;
            FileError::malformed(Place::byte(at), "expected UTF-8 text, got other bytes")
        })?;
        Ok(text.strip_prefix('\u{feff}').map(str::to_owned).unwrap_or(text))
    }

    /// Puts the next line into `line`, without its end (`\n`, `\r\n`). Returns `false` at the end of the file.
    ///
    /// # Errors
    /// A line longer than [`Limits::held`], one that is no UTF-8, errors of the reader.
    pub fn next_line(&mut self, line: &mut String) -> Result<bool, FileError> {
        let mut bytes = std::mem::take(line).into_bytes();
        bytes.clear();
        let (limit, number) = (self.limits.held, self.line + 1);
        let count = self.by_ref().take(limit as u64 + 1).read_until(b'\n', &mut bytes)?;
        if count == 0 {
            return Ok(false);
        }
        if count > limit {
            let detail = format!("expected lines of at most {limit} bytes, got a longer one");
            return Err(FileError::too_large(Place::line(number), detail));
        }
        self.line = number;
        while bytes.last().is_some_and(|byte| matches!(byte, b'\n' | b'\r')) {
            bytes.pop();
        }
        if number == 1 && bytes.starts_with("\u{feff}".as_bytes()) {
            bytes.drain(..3);
        }
        *line = String::from_utf8(bytes)
            .map_err(|_| FileError::malformed(Place::line(number), "expected UTF-8 text, got other bytes"))?;
        Ok(true)
    }

    /// Reads the rest, and refuses more than blanks: part of a file never passes for all of it.
    ///
    /// # Errors
    /// The place of the first other byte; errors of the reader.
    pub(super) fn finish(&mut self) -> Result<(), FileError> {
        loop {
            let bytes = self.fill_buf()?;
            if bytes.is_empty() {
                return Ok(());
            }
            let count = bytes.len();
            let blank = bytes.iter().take_while(|byte| byte.is_ascii_whitespace() || **byte == 0).count();
            if blank < count {
                let place = Place::byte(self.offset + blank as u64);
                return Err(FileError::malformed(place, "expected the end of the file, got other bytes"));
            }
            self.consume(count);
            self.check_content()?;
        }
    }

    fn pass(&mut self, count: usize) {
        self.offset += count as u64;
        self.content.set(self.content.get() + count as u64);
    }

    fn check_content(&self) -> io::Result<()> {
        if self.offset > self.limits.content {
            let detail = format!("expected at most {} bytes of content, got more", self.limits.content);
            return Err(io::Error::new(io::ErrorKind::FileTooLarge, detail));
        }
        Ok(())
    }
}

impl Read for Source<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.reader.read(buffer)?;
        self.pass(count);
        self.check_content()?;
        Ok(count)
    }
}

impl BufRead for Source<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        // `consume` cannot fail: the limit is checked here.
        self.check_content()?;
        self.reader.fill_buf()
    }

    fn consume(&mut self, amount: usize) {
        self.reader.consume(amount);
        self.pass(amount);
    }
}

impl std::fmt::Debug for Source<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Source").field("offset", &self.offset).finish_non_exhaustive()
    }
}

/// Content of a file compressed by gzip, with our words for its faults.
struct Decompressed<R: Read>(MultiGzDecoder<R>);

impl<R: Read> Read for Decompressed<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.0.read(buffer).map_err(|error| match error.kind() {
            io::ErrorKind::UnexpectedEof => {
                io::Error::new(error.kind(), "expected a whole gzip file, got only its beginning")
            }
            io::ErrorKind::InvalidInput | io::ErrorKind::InvalidData => io::Error::new(
                io::ErrorKind::InvalidData,
                "expected data compressed by gzip, got other bytes or a wrong checksum",
            ),
            _ => error,
        })
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::super::FaultKind;
    use super::*;

    fn gzip(bytes: &[u8]) -> Vec<u8> {
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    fn whole(bytes: &[u8], limits: Limits) -> Result<Vec<u8>, FileError> {
        let mut source = Source::new(bytes, limits)?;
        Source::bytes(&mut source)
    }

    #[test]
    fn compressed_files_are_decompressed() {
        let text: Vec<u8> = (0..20_000_u32).flat_map(u32::to_le_bytes).collect();
        let file = [gzip(&text[..30_000]), gzip(&text[30_000..])].concat();
        assert_eq!(whole(&file, Limits::default()).unwrap(), text);
        assert_eq!(Source::new(&file[..], Limits::default()).unwrap().head(), &text[..4096]);
        for length in (2..file.len()).step_by(97).chain([file.len() - 1]) {
            // A file that ends between two parts is whole.
            if length == gzip(&text[..30_000]).len() {
                continue;
            }
            let error = whole(&file[..length], Limits::default()).unwrap_err();
            assert_eq!(error.kind, FaultKind::Truncated, "{error} for {length} bytes");
        }
        let mut changed = gzip(&text);
        let at = changed.len() - 5;
        changed[at] ^= 1;
        let error = whole(&changed, Limits::default()).unwrap_err();
        assert_eq!(
            (error.kind, error.detail.as_str()),
            (FaultKind::Malformed, "expected data compressed by gzip, got other bytes or a wrong checksum")
        );
    }

    #[test]
    fn limits_are_those_of_what_a_compressed_file_holds() {
        let file = gzip(&vec![0; 1 << 24]);
        let limits = Limits { content: 1 << 20, ..Limits::default() };
        let error = whole(&file, limits).unwrap_err();
        assert_eq!(error.kind, FaultKind::TooLarge);
        assert_eq!(error.to_string(), "expected at most 1048576 bytes of content, got more");
        let limits = Limits { held: 1 << 20, ..Limits::default() };
        assert_eq!(whole(&file, limits).unwrap_err().kind, FaultKind::TooLarge);
    }

    #[test]
    fn files_within_a_file_share_its_budgets() {
        let source = Source::new(&b"archive"[..], Limits::default()).unwrap();
        let bound = Bound { what: "steps", free: 10, per_byte: 0 };
        let inner = || source.inner(&b"file"[..], Limits::default()).unwrap().budget(bound);
        assert!(inner().take(6).is_ok() && inner().take(4).is_ok());
        assert!(inner().take(1).is_err() && source.budget(bound).take(0).is_err());
    }

    #[test]
    fn memory_is_asked_for_what_expands() {
        let text = vec![b'a'; 3 << 20];
        let file = gzip(&text);
        let asked = std::cell::RefCell::new(Vec::new());
        let ask = |most: usize| {
            let asked = &asked;
            move |found: Asked| {
                let bytes = found.bytes();
                asked.borrow_mut().push(bytes >> 20);
                if bytes <= most { Ok(()) } else { Err(FileError::new(FaultKind::Memory, "none is left")) }
            }
        };
        let read = |file: &[u8], most: usize| {
            let source = Source::new(file, Limits::default()).unwrap();
            Source::bytes(&mut source.asking(ask(most))).map(|bytes| bytes.len())
        };
        assert_eq!(read(&text, 0).unwrap(), 3 << 20);
        assert_eq!(asked.borrow().len(), 0, "as many bytes as arrived");
        assert_eq!(read(&file, 3 << 20).unwrap(), 3 << 20);
        assert_eq!(*asked.borrow(), [1, 2, 3]);
        assert_eq!(read(&file, 2 << 20).unwrap_err().kind, FaultKind::Memory);
    }
}
