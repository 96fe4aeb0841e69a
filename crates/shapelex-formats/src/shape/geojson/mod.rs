//! GeoJSON, as QuPath writes it and as RFC 7946 describes it.
//!
//! A file of any size is read with the memory of one feature: [`scan`] finds where a feature ends, [`feature`] reads it whatever the
//! order of its members is, [`map`] makes records of it. [`write`](mod@write) writes features one after the other.

mod coordinates;
mod feature;
mod map;
mod scan;
#[cfg(test)]
mod tests;
mod write;

use serde_json::Value as Json;

use super::format::Format;
use super::json::VALUES;
use super::limits::MAX_ATTRIBUTES;
use super::options::ReadOptions;
use super::record::Kind;
use super::record::Sink;
use super::source::Source;
use crate::error::{FileError, Place};
use crate::summary::Summary;
use crate::words::plain;
use feature::{MEMBERS, Node};
use map::Mapping;
use scan::Scanner;

/// GeoJSON.
pub(super) static FORMAT: Format = Format {
    id: "geojson",
    name: "GeoJSON",
    media_types: &["application/geo+json", "application/geo+json-seq"],
    extensions: &["geojson", "geojsonl", "geojsons"],
    recognise,
    kinds: &[Kind::Curve, Kind::Landmarks],
    options: &["holes", "names", "nuclei", "select", "attributes"],
    read: Some(read),
    open: Some(write::open),
};

/// Allowed beginnings of a file.
const BEGINNING: &str = "a FeatureCollection, a Feature or a list of features";

/// Whether there is a member `type` of a feature or of a collection among the first bytes.
fn recognise(head: &[u8]) -> bool {
    let text = String::from_utf8_lossy(head);
    let text = text.trim_start_matches(['\u{feff}', '\u{1e}', ' ', '\t', '\r', '\n']);
    text.starts_with(['{', '['])
        && text.split("\"type\"").skip(1).any(|rest| {
            let value = rest.trim_start().strip_prefix(':').unwrap_or_default().trim_start();
            value.starts_with("\"Feature\"") || value.starts_with("\"FeatureCollection\"")
        })
}

fn read(source: &mut Source<'_>, options: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let mapping = Mapping::new(options, *source.limits());
    let mut reading = Reading { scanner: Scanner::new(source), mapping, item: 0, repaired: 0, sink };
    reading.file()?;
    let Reading { mapping, repaired, .. } = reading;
    let mut summary = mapping.finish();
    if repaired > 0 {
        let warning = format!("{repaired} features have NaN or Infinity, which is no JSON, taken as null");
        summary.warnings.push(warning);
    }
    Ok(summary)
}

/// A file that is being read.
struct Reading<'s, 'a, 'k> {
    scanner: Scanner<'s, 'a>,
    mapping: Mapping<'s>,
    /// Number of features passed.
    item: u64,
    /// Number of features with words for numbers that JSON does not have.
    repaired: u64,
    sink: Sink<'k>,
}

impl Reading<'_, '_, '_> {
    /// One or more collections, lists and features, one after the other.
    fn file(&mut self) -> Result<(), FileError> {
        self.scanner.skip_mark()?;
        let mut next = Some(self.scanner.peek_more(BEGINNING)?);
        while let Some(byte) = next {
            self.scanner.kept.clear();
            match byte {
                b'[' => self.list()?,
                b'{' => self.object()?,
                other => return Err(self.scanner.unexpected(BEGINNING, other)),
            }
            self.scanner.place = Place::default();
            self.scanner.kept.clear();
            next = self.scanner.peek()?;
        }
        Ok(())
    }

    /// A list of features.
    fn list(&mut self) -> Result<(), FileError> {
        self.scanner.expect(b'[', "a list of features")?;
        if self.scanner.peek_more("features")? == b']' {
            return self.scanner.expect(b']', "the end of the list");
        }
        loop {
            self.scanner.place = Place::item(self.item);
            self.scanner.peek_more("a feature")?;
            self.scanner.kept.clear();
            let start = self.scanner.offset();
            self.scanner.value()?;
            self.next_feature(start)?;
            self.scanner.kept.clear();
            match self.scanner.peek_more("the next feature")? {
                b',' => self.scanner.expect(b',', "a comma")?,
                b']' => return self.scanner.expect(b']', "the end of the list"),
                other => return Err(self.scanner.unexpected("a comma or the end of the list", other)),
            }
        }
    }

    /// A collection, whose features are taken one by one wherever they stand, or one feature.
    fn object(&mut self) -> Result<(), FileError> {
        let start = self.scanner.offset();
        let mut is_collection = false;
        self.scanner.place = Place::item(self.item);
        self.scanner.expect(b'{', "an object")?;
        if self.scanner.peek_more("a member")? == b'}' {
            return Err(self.scanner.unexpected(BEGINNING, b'}'));
        }
        loop {
            self.scanner.peek_more("a member")?;
            let key = self.scanner.kept.len();
            self.scanner.value()?;
            let is_features = self.scanner.kept.get(key..) == Some(b"\"features\"");
            self.scanner.expect(b':', "a colon")?;
            if self.scanner.peek_more("a value")? == b'[' && is_features {
                let before = std::mem::take(&mut self.scanner.kept);
                self.list()?;
                self.scanner.place = Place::default();
                is_collection = true;
                self.scanner.kept = before;
                self.scanner.kept.extend_from_slice(b"null");
            } else {
                self.scanner.value()?;
            }
            match self.scanner.peek_more("the next member")? {
                b',' => self.scanner.expect(b',', "a comma")?,
                b'}' => break,
                other => return Err(self.scanner.unexpected("a comma or the end of the object", other)),
            }
        }
        self.scanner.expect(b'}', "the end of the object")?;
        if is_collection { self.collection(start) } else { self.next_feature(start) }
    }

    /// The feature that the scanner keeps, or its fault, which is counted where broken ones are left out.
    fn next_feature(&mut self, start: u64) -> Result<(), FileError> {
        if let Err(error) = self.feature(start) {
            self.mapping.options.leave_out(error, &mut self.mapping.summary)?;
            self.item += 1;
        }
        Ok(())
    }

    /// Members beside the features of a collection.
    fn collection(&mut self, start: u64) -> Result<(), FileError> {
        let text = &self.scanner.kept;
        let place = Place::byte(start);
        VALUES.check(text, MAX_ATTRIBUTES, || place.clone())?;
        let members: serde_json::Map<String, Json> = serde_json::from_slice(text)
            .map_err(|error| FileError::malformed(place.clone(), plain(&error)))?;
        for (name, value) in members {
            match (name.as_str(), value) {
                ("type", Json::String(kind)) if kind == "FeatureCollection" => {}
                ("type", kind) => {
                    let detail = format!(
                        "expected the type \"FeatureCollection\" of an object with features, got {kind}"
                    );
                    return Err(FileError::malformed(place, detail));
                }
                ("features" | "bbox", _) => {}
                ("crs" | "name", value) => self.mapping.summary.set(&name, value),
                _ => self.mapping.summary.drop("members of collections", Some(&name), || place.clone()),
            }
        }
        Ok(())
    }

    /// The feature that the scanner keeps, which begins at byte `start`.
    fn feature(&mut self, start: u64) -> Result<(), FileError> {
        let place = Place { byte: Some(start), ..Place::item(self.item) };
        let text = &self.scanner.kept;
        let node = match node(text, &place) {
            Ok(node) => node,
            Err(error) => {
                let repaired = without_words(text);
                let again = repaired.and_then(|text| self::node(&text, &place).ok());
                self.repaired += 1;
                again.ok_or_else(|| fault(&error, text, start, place.clone()))?
            }
        };
        self.mapping.give(node?, self.item, &place, self.sink)?;
        self.item += 1;
        Ok(())
    }
}

/// The feature of a text, if its content beside its shape is not too large.
fn node(text: &[u8], place: &Place) -> Result<Result<Node, FileError>, serde_json::Error> {
    match MEMBERS.check(text, || place.clone())? {
        Ok(()) => serde_json::from_slice(text).map(Ok),
        Err(refusal) => Ok(Err(refusal)),
    }
}

/// A fault of the text of a feature, with its offset in the file.
fn fault(error: &serde_json::Error, text: &[u8], start: u64, place: Place) -> FileError {
    let lines = text.split_inclusive(|byte| *byte == b'\n');
    let before: usize = lines.take(error.line().saturating_sub(1)).map(<[u8]>::len).sum();
    let byte = start + (before + error.column().saturating_sub(1)) as u64;
    FileError::malformed(Place { byte: Some(byte), ..place }, plain(error))
}

/// The text with `null` for `NaN`, `Infinity` and `-Infinity`, which QuPath writes for measurements without a value; `None` if
/// there are none.
fn without_words(text: &[u8]) -> Option<Vec<u8>> {
    let (mut found, mut at, mut in_string) = (Vec::with_capacity(text.len()), 0, false);
    let mut any = false;
    while let Some(byte) = text.get(at) {
        let words: [&[u8]; 3] = [b"NaN", b"Infinity", b"-Infinity"];
        let word = words.into_iter().find(|word| !in_string && text[at..].starts_with(word));
        if let Some(word) = word {
            found.extend_from_slice(b"null");
            (at, any) = (at + word.len(), true);
            continue;
        }
        match byte {
            b'"' => in_string = !in_string,
            b'\\' if in_string => {
                found.push(*byte);
                at += 1;
            }
            _ => {}
        }
        found.extend(text.get(at));
        at += 1;
    }
    any.then_some(found)
}
