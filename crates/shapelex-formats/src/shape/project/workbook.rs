//! Tables in workbooks (`.xlsx`), which are archives of XML.

use std::collections::BTreeMap;
use std::io::{Cursor, Write};
use std::rc::Rc;

use calamine::{DataRef, Reader, Xlsx, XlsxError};
use quick_xml::events::{BytesStart, Event};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::super::guarded::guarded;
use super::super::limits::Limits;
use super::super::source::{Source, read_step};
use super::super::unzip::opened;
use super::sheet::{ROWS, Row, Table};
use crate::error::{FaultKind, FileError, Place};

/// Sheet with the subjects; without it, the first one.
const SHEET: &str = "data";
/// First bytes of an archive, and the names that the first file of a workbook has.
const ARCHIVE: &[u8] = b"PK\x03\x04";
const FIRST: [&[u8]; 4] = [b"[Content_Types].xml", b"xl/", b"_rels/", b"docProps/"];

/// Attribute with the number of shared texts, and the shortest of these.
const CLAIM: &[u8] = b"uniqueCount";
const TEXT: &[u8] = b"<si/>";

/// End of the name of the part with styles, its elements with texts, and most bytes of their attributes: the library makes a copy of
/// these for each cell format.
const STYLES: &str = "styles.xml";
const STYLE_TEXTS: [&str; 2] = ["numFmt", "name"];
const MAX_STYLE: usize = 1024;

/// Whether a file begins as a workbook.
pub(super) fn is_workbook(head: &[u8]) -> bool {
    let name = head.get(30..).unwrap_or_default();
    head.starts_with(ARCHIVE) && FIRST.iter().any(|first| name.starts_with(first))
}

/// The rows below the first one, by the names in the first one. Empty rows and cells are left out.
///
/// # Errors
/// More bytes than may be held, or than there is memory for.
pub(super) fn table(bytes: &[u8], source: &Source<'_>) -> Result<Table, FileError> {
    let content = source.limits().content.saturating_sub(bytes.len() as u64);
    let limits = &Limits { content, ..*source.limits() };
    let (unpacked, parts) =
        check_parts(bytes, limits, |unpacked| source.reserve(bytes.len().saturating_add(unpacked)))?;
    let mut cells = guarded("a workbook", || cells(parts, limits))?.into_values();
    let names = cells.next().unwrap_or_default().into_iter();
    let names: BTreeMap<u32, Rc<str>> = names.map(|(column, name)| (column, name.trim().into())).collect();
    let row = |cells: BTreeMap<u32, String>| -> Row {
        let named = |(column, text)| Some((Rc::clone(names.get(&column)?), text));
        cells.into_iter().filter_map(named).filter(|(name, _)| !name.is_empty()).collect()
    };
    let rows = cells.map(row).filter(|row| row.values().any(|text| !text.trim().is_empty())).collect();
    Ok(Table { rows, unpacked })
}

/// Texts by row and column.
fn cells(bytes: Vec<u8>, limits: &Limits) -> Result<BTreeMap<u32, BTreeMap<u32, String>>, FileError> {
    let mut book: Xlsx<_> = Xlsx::new(Cursor::new(bytes)).map_err(fault)?;
    let sheets = book.sheet_names();
    let sheet = sheets.iter().find(|name| *name == SHEET).or(sheets.first()).cloned();
    let Some(sheet) = sheet else {
        return Err(FileError::new(FaultKind::Malformed, "expected a workbook with a sheet, got none"));
    };
    let mut table: BTreeMap<u32, BTreeMap<u32, String>> = BTreeMap::new();
    // One long text may be that of many cells.
    let mut held = 0_usize;
    let mut reader = book.worksheet_cells_reader(&sheet).map_err(fault)?;
    while let Some(cell) = reader.next_cell().map_err(fault)? {
        let text = match cell.get_value() {
            DataRef::String(text) => text.clone(),
            DataRef::SharedString(text) => (*text).to_owned(),
            DataRef::Int(value) => value.to_string(),
            DataRef::Float(value) => value.to_string(),
            DataRef::Bool(value) => value.to_string(),
            _ => continue,
        };
        let (row, column) = cell.get_position();
        let rows = table.len();
        let cells = table.entry(row).or_default();
        held = held.saturating_add(text.len() + ROWS.item);
        cells.insert(column, text);
        held = held.saturating_add(ROWS.object * (table.len() - rows));
        if held > limits.held {
            let detail = format!("expected a table of at most {} bytes in memory, got more", limits.held);
            return Err(FileError::too_large(Place::default(), detail));
        }
    }
    Ok(table)
}

/// Unpacked size of a workbook, for which `reserve` is asked: at most the size that may be held, as the library holds its
/// parts. Nor may a part claim more texts than it can hold, for which the library takes memory before it reads them.
///
/// Also returns a plain archive of the same parts: the library opens archives in its own way, which takes long for some.
fn check_parts(
    bytes: &[u8],
    limits: &Limits,
    reserve: impl Fn(usize) -> Result<(), FileError>,
) -> Result<(u64, Vec<u8>), FileError> {
    let mut archive = opened(bytes.to_vec())?;
    let mut parts = ZipWriter::new(Cursor::new(Vec::new()));
    let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    let most = usize::try_from(limits.content).unwrap_or(usize::MAX).min(limits.held);
    let mut left = most;
    let mut part = Vec::new();
    for k in 0..archive.len() {
        let malformed = |error: &dyn std::fmt::Display| {
            FileError::of(
                FaultKind::Malformed,
                Place::item(k as u64),
                format!("expected a part of a workbook, got {error}"),
            )
        };
        let mut content = archive.by_index(k).map_err(|error| malformed(&error))?;
        let name = content.name().map_err(|error| malformed(&error))?.into_owned();
        part.clear();
        while read_step(&mut content, &mut part).map_err(|error| malformed(&error))? {
            if part.len() > left {
                let detail = format!("expected at most {most} bytes of a workbook, got more");
                return Err(FileError::too_large(Place::default(), detail));
            }
            reserve(most - left + part.len())?;
        }
        left -= part.len();
        let claimed = claimed_texts(&part);
        if claimed > (part.len() / TEXT.len()) as u64 {
            return Err(malformed(&format!("{claimed} texts in {} bytes", part.len())));
        }
        let is_styles = name.to_ascii_lowercase().ends_with(STYLES);
        if let Some(length) = is_styles.then(|| longest_style(&part)).filter(|length| *length > MAX_STYLE) {
            return Err(malformed(&format!("a style of {length} bytes, more than {MAX_STYLE}")));
        }
        if !name.ends_with(['/', '\\']) {
            parts.start_file(name, stored).map_err(|error| malformed(&error))?;
            parts.write_all(&part)?;
        }
    }
    let parts = parts.finish().map_err(|error| {
        FileError::new(FaultKind::Malformed, format!("expected a workbook, got a fault: {error}"))
    })?;
    Ok(((most - left) as u64, parts.into_inner()))
}

/// Most bytes of attributes of an element that styles have a text from, as far as they can be read.
fn longest_style(part: &[u8]) -> usize {
    let mut reader = quick_xml::Reader::from_reader(part);
    // As the library reads them.
    reader.config_mut().check_end_names = false;
    let length = |start: &BytesStart<'_>| {
        let is_text = STYLE_TEXTS.contains(&start.local_name().as_ref());
        if is_text { start.attributes_raw().len() } else { 0 }
    };
    let (mut longest, mut bytes) = (0, Vec::new());
    loop {
        bytes.clear();
        match reader.read_event_into(&mut bytes) {
            Ok(Event::Start(start) | Event::Empty(start)) => longest = longest.max(length(&start)),
            Ok(Event::Eof) | Err(_) => return longest,
            Ok(_) => {}
        }
    }
}

/// Largest number that is given as that of the texts of a workbook.
fn claimed_texts(part: &[u8]) -> u64 {
    let claim = |(at, _): (usize, &[u8])| {
        let value = part[at + CLAIM.len()..].iter().skip_while(|byte| b" \t\r\n=+'\"".contains(byte));
        let digits = value.map_while(|byte| char::from(*byte).to_digit(10));
        digits.fold(0_u64, |value, digit| value.saturating_mul(10).saturating_add(digit.into()))
    };
    let names = part.windows(CLAIM.len()).enumerate().filter(|(_, name)| *name == CLAIM);
    names.map(claim).max().unwrap_or(0)
}

fn fault(error: XlsxError) -> FileError {
    FileError::new(FaultKind::Malformed, format!("expected a workbook, got a fault: {error}"))
}
