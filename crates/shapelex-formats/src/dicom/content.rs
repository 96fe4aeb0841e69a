//! Where the data set of a file begins, and how it is encoded.

use std::borrow::Cow;
use std::io::Cursor;

use dicom_core::{Tag, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_encoding::transfer_syntax::{TransferSyntax, TransferSyntaxIndex};
use dicom_parser::dataset::lazy_read::LazyDataSetReader;
use dicom_transfer_syntax_registry::{TransferSyntaxRegistry, entries};

use super::data_set::{self, Reader};
use super::values::File;
use crate::error::{FaultKind, FileError, Place};
use crate::inflate::{Fault, inflate};

/// Where `DICM` is in a file with a preamble.
const PREAMBLE: usize = 128;

/// Group of the elements that describe the file.
const META_GROUP: u16 = 2;

/// First bytes of the data sets of files without a preamble: the group 0008, little-endian, and one of the elements that come first.
const FIRST_ELEMENTS: [u16; 8] = [0x00, 0x01, 0x05, 0x06, 0x08, 0x12, 0x16, 0x18];

/// Explicit types, most significant byte first: retired, and still in archives.
const BIG_ENDIAN: &str = "1.2.840.10008.1.2.2";

/// The bytes of a file, with the place and the encoding of its data set.
pub(crate) struct Content<'a> {
    bytes: Cow<'a, [u8]>,
    start: usize,
    syntax: &'static TransferSyntax,
}

/// Whether the first bytes of a file are those of DICOM, with a preamble or without.
pub(crate) fn is_dicom(head: &[u8]) -> bool {
    if head.get(PREAMBLE..PREAMBLE + 4) == Some(b"DICM") || head.starts_with(b"\x02\0\0\0UL") {
        return true;
    }
    let (Some(tag), Some(rest)) = (head.first_chunk::<4>(), head.get(4..8)) else { return false };
    let element = u16::from_le_bytes([tag[2], tag[3]]);
    let plausible = VR::from_binary([rest[0], rest[1]]).is_some() || rest[1..] == [0, 0, 0];
    tag[..2] == [8, 0] && FIRST_ELEMENTS.contains(&element) && plausible
}

impl<'a> Content<'a> {
    /// Reads the part before the data set. A deflated one is inflated, to at most `limit` bytes; `grow` is asked for as many as
    /// there are.
    pub(crate) fn new(
        bytes: &'a [u8],
        limit: u64,
        grow: impl Fn(usize) -> Result<(), FileError>,
    ) -> Result<Self, FileError> {
        let start = if bytes.get(PREAMBLE..PREAMBLE + 4) == Some(b"DICM") { PREAMBLE + 4 } else { 0 };
        let rest = bytes.get(start..).unwrap_or_default();
        if !rest.starts_with(&[2, 0]) {
            return bare(bytes, start);
        }
        let (uid, start) = meta(bytes, start)?;
        let place = || Place::tag("(0002,0010)");
        if uid == uids::DEFLATED_EXPLICIT_VR_LITTLE_ENDIAN {
            let bytes = inflated(&bytes[start..], limit, grow)?;
            let content = Self { bytes: bytes.into(), start: 0, syntax: explicit() };
            return content.checked();
        }
        let syntax = TransferSyntaxRegistry.get(&uid).ok_or_else(|| {
            let detail = format!("expected a transfer syntax of the standard, got {uid}");
            FileError::unsupported(place(), detail)
        })?;
        if syntax.is_unsupported() && !syntax.is_encapsulated_pixel_data() {
            let detail = format!("expected a data set that is stored as it is, got {}", syntax.name());
            return Err(FileError::unsupported(place(), detail));
        }
        Self { bytes: bytes.into(), start, syntax }.checked()
    }

    /// The data set, in which sequences are nested at most `depth` times.
    pub(crate) fn parse(&self, depth: usize) -> Result<File<'_>, FileError> {
        self.parse_until(depth, |_| false)
    }

    /// The elements before the pixels. These may be missing.
    pub(super) fn parse_header(&self, depth: usize) -> Result<File<'_>, FileError> {
        self.parse_until(depth, |tag| tag >= tags::PIXEL_DATA)
    }

    fn parse_until(&self, depth: usize, stop: impl Fn(Tag) -> bool) -> Result<File<'_>, FileError> {
        let set = data_set::read(&self.bytes, reader(&self.bytes, self.start, self.syntax)?, depth, stop)?;
        File::new(set, self.is_big_endian(), self.syntax)
    }

    fn is_big_endian(&self) -> bool {
        self.syntax.uid() == BIG_ENDIAN
    }

    /// The first element shows a wrong byte order, and whether types are explicit.
    fn checked(self) -> Result<Self, FileError> {
        let Some(&[a, b, _, _, c, d]) = self.bytes.get(self.start..).and_then(<[u8]>::first_chunk::<6>)
        else {
            let detail = "expected a data set, got the end of the file";
            return Err(FileError::truncated(Place::byte(self.start as u64), detail));
        };
        let name = self.syntax.name();
        let big_endian = self.is_big_endian();
        let explicit = self.syntax.uid() != uids::IMPLICIT_VR_LITTLE_ENDIAN;
        let (group, other) = if big_endian { ([a, b], [b, a]) } else { ([b, a], [a, b]) };
        let [group, other] = [group, other].map(u16::from_be_bytes);
        let fault = |detail| Err(FileError::malformed(Place::byte(self.start as u64), detail));
        if group > 0xff && other <= 0xff {
            return fault(format!(
                "expected an element in the byte order of {name}, got group {group:04x}, which is {other:04x} \
                 in the other byte order"
            ));
        }
        match VR::from_binary([c, d]) {
            None if explicit => {
                fault(format!("expected a type of two capital letters ({name}), got {c:02x} {d:02x}"))
            }
            // A value of 16 kB or more would be a strange first element.
            Some(vr) if !explicit => fault(format!(
                "expected an element without its type ({name}), got the type {}",
                vr.to_string()
            )),
            _ => Ok(self),
        }
    }
}

fn reader<'a>(bytes: &'a [u8], start: usize, syntax: &TransferSyntax) -> Result<Reader<'a>, FileError> {
    let mut cursor = Cursor::new(bytes);
    cursor.set_position(start as u64);
    LazyDataSetReader::new_with_ts(cursor, syntax)
        .map_err(|error| FileError::of(FaultKind::Unsupported, Place::default(), error))
}

fn explicit() -> &'static TransferSyntax {
    static SYNTAX: std::sync::LazyLock<TransferSyntax> =
        std::sync::LazyLock::new(|| entries::EXPLICIT_VR_LITTLE_ENDIAN.erased());
    &SYNTAX
}

/// A data set without a description of the file: its first element shows how it is encoded.
fn bare(bytes: &[u8], start: usize) -> Result<Content<'_>, FileError> {
    let Some(&[a, b, _, _, c, d]) = bytes.get(start..).and_then(<[u8]>::first_chunk::<6>) else {
        let detail = "expected a file of DICOM, got one that ends too early";
        return Err(FileError::truncated(Place::byte(bytes.len() as u64), detail));
    };
    let explicit = VR::from_binary([c, d]).is_some();
    let uid = match (u16::from_le_bytes([a, b]), explicit) {
        (group, true) if group > 0xff => BIG_ENDIAN,
        (_, true) => uids::EXPLICIT_VR_LITTLE_ENDIAN,
        (_, false) => uids::IMPLICIT_VR_LITTLE_ENDIAN,
    };
    let syntax = TransferSyntaxRegistry.get(uid).ok_or_else(|| {
        FileError::unsupported(Place::default(), format!("expected a known transfer syntax, got {uid}"))
    })?;
    Content { bytes: bytes.into(), start, syntax }.checked()
}

/// Transfer syntax, and where the data set begins.
fn meta(bytes: &[u8], start: usize) -> Result<(String, usize), FileError> {
    let set = data_set::read(bytes, reader(bytes, start, explicit())?, 1, |tag| tag.group() != META_GROUP)?;
    let uid = set.get(tags::TRANSFER_SYNTAX_UID).and_then(|element| element.bytes());
    let Some(uid) = uid.and_then(|bytes| std::str::from_utf8(bytes).ok()) else {
        let detail = "expected a transfer syntax, got none";
        return Err(FileError::malformed(Place::tag("(0002,0010)"), detail));
    };
    let end = set.elements().last().map_or(start as u64, |last| last.at + last.length());
    let uid = uid.trim_end_matches(['\0', ' ']);
    Ok((uid.into(), usize::try_from(end).unwrap_or(bytes.len()).min(bytes.len())))
}

/// The data set of a deflated file. A byte of zero may follow, for an even length.
fn inflated(
    bytes: &[u8],
    limit: u64,
    grow: impl Fn(usize) -> Result<(), FileError>,
) -> Result<Vec<u8>, FileError> {
    let place = || Place::tag("(0002,0010)");
    let grow = |found: usize| {
        if found as u64 > limit {
            let detail = format!("expected at most {limit} bytes of content, got more");
            return Err(FileError::too_large(place(), detail));
        }
        grow(found)
    };
    match inflate(bytes, false, grow) {
        Ok((content, after)) if after == 0 || bytes.ends_with(&[0]) && after == 1 => Ok(content),
        Ok((_, after)) => {
            let detail = format!("expected the end of the file after the data set, got {after} bytes more");
            Err(FileError::malformed(place(), detail))
        }
        Err(Fault::Refused(error)) => Err(error),
        Err(Fault::Cut) => Err(FileError::of(
            FaultKind::Truncated,
            place(),
            "expected a whole deflated data set, got only its beginning",
        )),
        Err(Fault::Corrupt) => Err(FileError::malformed(
            place(),
            "expected a deflated data set, got bytes that cannot be inflated",
        )),
    }
}
