//! Names of shapes: those of one file are told apart by numbers, those of several files by the names of the files.
//!
//! | format | name of a shape of the file `slide.roi.zip` |
//! |---|---|
//! | of one shape a file, such as meshes and regions of ImageJ | `slide` |
//! | of several objects | `slide/cell`, the next one of this name `slide/cell~2` |
//! | with identities that the maker of the file gives: tables, NDJSON | as it stands there |
//! | DICOM | by unique identifiers, which no other file has |
//!
//! Records without a name are numbered by their place in the file. Records that are left out have their numbers, so that the others keep theirs
//! when the file is mended.

use std::collections::HashMap;
use std::hash::{BuildHasher, RandomState};

use super::options::{Names, ReadOptions};
use super::record::{Record, Sink};
use crate::error::FileError;
use crate::value::Value;

/// Attribute that says which file a shape came from.
pub const FILE: &str = "file";

/// Endings of two parts, as programs write them.
const DOUBLE: [&str; 7] =
    [".mrk.json", ".coco.json", ".roi.zip", ".ome.tif", ".ome.tiff", ".seg.nrrd", ".label.gii"];
/// Endings of compressed files, before which their own ending stands.
const COMPRESSED: &str = ".gz";

/// Name of a file without its folder and its ending, of which `.nii.gz`, `.roi.zip` and `.ome.tif` are one.
pub fn stem(name: &str) -> &str {
    let name = name.rsplit(['/', '\\']).next().unwrap_or(name);
    let cut = |ending: &str| {
        let at = name.len().checked_sub(ending.len()).filter(|at| *at > 0)?;
        name.get(at..).is_some_and(|end| end.eq_ignore_ascii_case(ending)).then(|| &name[..at])
    };
    if let Some(plain) = DOUBLE.into_iter().find_map(cut) {
        return plain;
    }
    let plain = cut(COMPRESSED).unwrap_or(name);
    match plain.rfind('.') {
        Some(at) if at > 0 => &plain[..at],
        _ => plain,
    }
}

/// How far names of a format reach.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Scope {
    /// They name objects of the file.
    #[default]
    File,
    /// A file holds one shape, which is named as the file.
    Whole,
    /// They are identities that stay the same in every file.
    Everywhere,
}

impl Scope {
    /// That of the format with this id.
    pub(super) fn of(format: &str) -> Self {
        match format {
            "ndjson" | "csv" | "arrow" | "parquet" | "npz" | "npy" => Self::Everywhere,
            "obj" | "ply" | "stl" | "off" | "vtk" | "vtp" | "gifti" | "particles" | "imagej-roi" | "fcsv"
            | "mrk" => Self::Whole,
            _ => Self::File,
        }
    }
}

/// Bytes of memory for a name that was seen.
const SEEN: usize = 64;
/// Number of names for which memory is asked first.
const FIRST: usize = 1 << 12;

/// Names the records of a file one after the other, so that they differ.
pub(super) struct Naming {
    names: Option<Names>,
    scope: Scope,
    /// Whether records become stored shapes.
    stores: bool,
    /// Digests of the names so far, each with the last number that stands behind it.
    seen: HashMap<u128, u64>,
    /// Random keys of the digests, so that a client cannot choose two names with one digest.
    keys: [RandomState; 2],
    /// Number of names for which there is memory.
    room: usize,
    /// The object that the last record is a ring of, and the name of its rings.
    object: Option<Object>,
    /// Number of objects so far.
    count: u64,
}

/// An object of several rings.
struct Object {
    number: u64,
    /// The name that its first ring had, and the one that it got.
    own: String,
    given: String,
    rings: u64,
}

impl Naming {
    /// For the records of a file of a format with this id.
    pub(super) fn new(format: &str, options: &ReadOptions) -> Self {
        Self {
            names: options.names,
            scope: Scope::of(format),
            stores: options.storing.is_some(),
            seen: HashMap::new(),
            keys: std::array::from_fn(|_| RandomState::new()),
            room: FIRST,
            object: None,
            count: 0,
        }
    }

    /// Names a record. `ask` is asked for memory.
    ///
    /// # Errors
    /// Those of `ask`.
    pub(super) fn name(
        &mut self,
        record: &mut Record,
        ask: &dyn Fn(usize) -> Result<(), FileError>,
    ) -> Result<(), FileError> {
        let by_id = self.names == Some(Names::Id) || self.names.is_none() && self.stores;
        match record.id.take().filter(|_| by_id) {
            Some(id) => (record.name, record.scope) = (Some(id), Scope::Everywhere),
            None if self.stores && self.scope != Scope::File => record.scope = self.scope,
            None => {}
        }
        let ring = record.ring.as_ref().map(|ring| ring.object);
        let goes_on = ring.is_some() && self.object.as_ref().map(|object| object.number) == ring;
        if !goes_on {
            self.count = number_after(self.count, record);
            self.object = None;
        }
        if self.names == Some(Names::Number) {
            if let Some(name) = record.name.replace(self.count.to_string()) {
                record.metadata.entry("name").or_insert_with(|| name.into());
            }
            if record.scope == Scope::Everywhere {
                record.scope = Scope::File;
            }
        }
        let Some(own) = record.name.take() else { return Ok(()) };
        let wished = match &mut self.object {
            Some(object) if self.names == Some(Names::Number) => {
                object.rings += 1;
                format!("{}/{}", object.given, object.rings)
            }
            Some(object) => {
                own.strip_prefix(&object.own).map_or(own.clone(), |rest| format!("{}{rest}", object.given))
            }
            None => own.clone(),
        };
        let given = match record.scope {
            Scope::Everywhere => wished,
            Scope::File | Scope::Whole => self.unique(wished, ask)?,
        };
        if let (Some(number), None) = (ring, &self.object) {
            self.object = Some(Object { number, own, given: given.clone(), rings: 1 });
        }
        record.name = Some(given);
        Ok(())
    }

    /// A name that no record had: with `~2`, `~3`, … behind it where one had it.
    fn unique(
        &mut self,
        name: String,
        ask: &dyn Fn(usize) -> Result<(), FileError>,
    ) -> Result<String, FileError> {
        if self.seen.len() >= self.room {
            self.room *= 2;
            ask(self.room.saturating_mul(SEEN))?;
        }
        let digest = |name: &str| {
            let [high, low] = self.keys.each_ref().map(|key| key.hash_one(name));
            u128::from(high) << 64 | u128::from(low)
        };
        let key = digest(&name);
        let Some(last) = self.seen.get(&key).copied() else {
            self.seen.insert(key, 1);
            return Ok(name);
        };
        let mut number = last;
        loop {
            number += 1;
            let numbered = format!("{name}~{number}");
            let other = digest(&numbered);
            if !self.seen.contains_key(&other) {
                self.seen.insert(key, number);
                self.seen.insert(other, 1);
                return Ok(numbered);
            }
        }
    }
}

/// Names records after their file, and says which file it is.
#[derive(Debug)]
pub struct Filed {
    /// Name of the file without its ending.
    stem: Option<String>,
    /// Text before names, instead of the name of the file.
    prefix: Option<String>,
    /// Whether the attribute [`FILE`] says the name of the file.
    notes: bool,
    /// The first record, of which it is not known yet whether it is the only one.
    waiting: Option<Record>,
    /// Number of the last record.
    count: u64,
}

impl Filed {
    /// For a file with a name; `prefix` stands before the names of its shapes instead of that of the file.
    pub fn new(name: Option<&str>, prefix: Option<&str>) -> Self {
        let own = |text: &str| Some(text.to_owned());
        let stem = name.map(stem).filter(|stem| !stem.is_empty()).and_then(own);
        Self { stem, prefix: prefix.and_then(own), notes: true, waiting: None, count: 0 }
    }

    /// For a file within an archive; `notes` says whether its shapes have the attribute [`FILE`].
    pub(super) fn within(name: &str, prefix: Option<&str>, notes: bool) -> Self {
        Self { notes, ..Self::new(Some(name), prefix) }
    }

    /// Gives a record on, or keeps it until the next one.
    ///
    /// # Errors
    /// Those of `sink`.
    pub fn push(&mut self, record: Record, sink: Sink<'_>) -> Result<(), FileError> {
        if let Some(first) = self.waiting.take() {
            self.give(first, 1, sink)?;
        }
        self.count = number_after(self.count, &record);
        if self.count == 1 && self.stem.is_some() && may_be_whole(&record) {
            self.waiting = Some(record);
            return Ok(());
        }
        self.give(record, self.count, sink)
    }

    /// Gives the last record on. One of several is named as such, also if the others are broken.
    ///
    /// # Errors
    /// Those of `sink`.
    pub fn finish(&mut self, has_broken: bool, sink: Sink<'_>) -> Result<(), FileError> {
        let Some(mut only) = self.waiting.take() else { return Ok(()) };
        if has_broken {
            return self.give(only, 1, sink);
        }
        let stem = self.stem.as_deref().unwrap_or_default();
        // Where the name of the file stands before names, it is the whole name of its only shape.
        let named = |prefix: &&str| prefix.strip_suffix('/') != Some(stem);
        let prefix = self.prefix.as_deref().filter(named).unwrap_or_default();
        only.name = Some(format!("{prefix}{stem}"));
        self.note(&mut only);
        sink(only)
    }

    /// Gives a record on that is one of several, or has a name that counts.
    fn give(&self, mut record: Record, number: u64, sink: Sink<'_>) -> Result<(), FileError> {
        let is_identified = record.scope == Scope::Everywhere && record.name.is_some();
        let before = match (&self.prefix, &self.stem) {
            (Some(prefix), _) => prefix.clone(),
            (None, Some(stem)) if !is_identified => format!("{stem}/"),
            _ => String::new(),
        };
        let name = record.name.take();
        // Numbers of shapes without a name say nothing where the file has none.
        let name = name.or_else(|| self.stem.is_some().then(|| number.to_string()));
        record.name = name.map(|name| format!("{before}{name}"));
        self.note(&mut record);
        sink(record)
    }

    fn note(&self, record: &mut Record) {
        if let Some(stem) = self.stem.as_ref().filter(|_| self.notes) {
            record.labels.entry(FILE.into()).or_insert_with(|| Value::from(stem.as_str()));
        }
    }
}

/// Number of a record after one with the number `last`: that of its place in the file, unless it is one of several of that place.
fn number_after(last: u64, record: &Record) -> u64 {
    let place = record.place.item.map_or(0, |item| item.saturating_add(1));
    place.max(last.saturating_add(1))
}

/// Whether a record is named as its file if it is the only one: it has no name, or is of a format that holds one shape.
fn may_be_whole(record: &Record) -> bool {
    record.name.is_none() || record.scope == Scope::Whole
}

#[cfg(test)]
mod tests {
    use super::super::record::{Geometry, Mesh, Points, Ring};
    use super::*;
    use crate::error::Place;

    #[test]
    fn endings_of_several_parts_are_one() {
        for (name, expected) in [
            ("scan.nii.gz", "scan"),
            ("scan.nii", "scan"),
            ("a/b\\cells.ROI.ZIP", "cells"),
            ("x.ome.tif", "x"),
            ("v1.2.png", "v1.2"),
            ("lines.ndjson.gz", "lines"),
            (".hidden", ".hidden"),
            (".nii.gz", ".nii"),
            ("plain", "plain"),
            ("é.roi.zip", "é"),
            ("", ""),
        ] {
            assert_eq!(stem(name), expected, "{name}");
        }
    }

    fn named(name: Option<&str>) -> Record {
        let geometry = Geometry::Landmarks(Points::from_rows(2, vec![0.0, 1.0]));
        Record { name: name.map(str::to_owned), ..Record::new(geometry, Place::default()) }
    }

    fn numbered(records: Vec<Record>, names: Option<Names>) -> Vec<Option<String>> {
        let options = ReadOptions { names, ..ReadOptions::default() };
        let mut naming = Naming::new("geojson", &options);
        let name = |mut record: Record| {
            naming.name(&mut record, &|_| Ok(())).unwrap();
            record.name
        };
        records.into_iter().map(name).collect()
    }

    fn of(name: &str, object: Option<(u64, u64)>) -> Record {
        let ring = object.map(|(object, part)| Ring { object, part, hole: false });
        Record { ring, ..named(Some(name)) }
    }

    #[test]
    fn equal_names_get_numbers_and_rings_follow_their_object() {
        let records = || {
            vec![
                of("cell", None),
                of("cell~2", None),
                of("cell", Some((2, 0))),
                of("cell/2", Some((2, 1))),
                of("cell", Some((3, 0))),
                of("cell/2", Some((3, 1))),
                named(None),
                of("cell", None),
            ]
        };
        let found = numbered(records(), None);
        let found: Vec<&str> = found.iter().map(|name| name.as_deref().unwrap_or("-")).collect();
        let expected = ["cell", "cell~2", "cell~3", "cell~3/2", "cell~4", "cell~4/2", "-", "cell~5"];
        assert_eq!(found, expected);
        let found = numbered(records(), Some(Names::Number));
        let found: Vec<&str> = found.iter().map(|name| name.as_deref().unwrap_or("-")).collect();
        assert_eq!(found, ["1", "2", "3", "3/2", "4", "4/2", "5", "6"]);
    }

    #[test]
    fn memory_for_names_is_asked_for() {
        let mut naming = Naming::new("geojson", &ReadOptions::default());
        let asked = std::cell::RefCell::new(Vec::new());
        for k in 0..3 * FIRST {
            let mut record = named(Some(&k.to_string()));
            let ask = |bytes| {
                asked.borrow_mut().push(bytes);
                Ok(())
            };
            naming.name(&mut record, &ask).unwrap();
        }
        assert_eq!(*asked.borrow(), [2 * FIRST * SEEN, 4 * FIRST * SEEN]);
    }

    fn filed(name: Option<&str>, prefix: Option<&str>, records: Vec<Record>) -> Vec<String> {
        let (mut filed, mut found) = (Filed::new(name, prefix), Vec::new());
        let mut sink = |record: Record| {
            let file = record.labels.get(FILE).cloned();
            assert_eq!(file.is_some(), name.is_some());
            found.push(record.name.unwrap_or("-".into()));
            Ok(())
        };
        for record in records {
            filed.push(record, &mut sink).unwrap();
        }
        filed.finish(false, &mut sink).unwrap();
        found
    }

    #[test]
    fn a_broken_record_leaves_the_others_their_numbers() {
        let at = |item| Record { place: Place::item(item), ..named(None) };
        let given = |items: &[u64], has_broken: bool| {
            let (mut filed, mut found) = (Filed::new(Some("a.tps"), None), Vec::new());
            let mut sink = |record: Record| {
                found.push(record.name.unwrap_or_default());
                Ok(())
            };
            items.iter().for_each(|item| filed.push(at(*item), &mut sink).unwrap());
            filed.finish(has_broken, &mut sink).unwrap();
            found
        };
        assert_eq!(given(&[0, 1, 2], false), ["a/1", "a/2", "a/3"]);
        assert_eq!(given(&[1, 2], true), ["a/2", "a/3"]);
        assert_eq!(given(&[1], true), ["a/2"]);
        assert_eq!(given(&[0], true), ["a/1"]);
        assert_eq!(given(&[0], false), ["a"]);
        // Several records of one place.
        assert_eq!(given(&[0, 0, 1, 5], false), ["a/1", "a/2", "a/3", "a/6"]);
        let numbers = numbered([0, 2].map(at).into(), Some(Names::Number));
        assert_eq!(numbers, [Some("1".to_owned()), Some("3".to_owned())]);
    }

    #[test]
    fn shapes_are_named_after_their_file() {
        let mesh = |name: &str| Record {
            name: Some(name.into()),
            scope: Scope::Whole,
            ..Record::new(Mesh::default(), Place::default())
        };
        let known = || Record { scope: Scope::Everywhere, ..named(Some("id")) };
        let file = Some("a/LA_01.ply");
        assert_eq!(filed(file, None, vec![mesh("solid")]), ["LA_01"]);
        assert_eq!(filed(file, Some("p-"), vec![mesh("solid")]), ["p-LA_01"]);
        assert_eq!(filed(file, Some("LA_01/"), vec![mesh("solid")]), ["LA_01"]);
        assert_eq!(filed(file, None, vec![mesh("solid"), mesh("other")]), ["LA_01/solid", "LA_01/other"]);
        assert_eq!(filed(file, None, vec![named(None)]), ["LA_01"]);
        assert_eq!(filed(file, None, vec![named(None), named(None)]), ["LA_01/1", "LA_01/2"]);
        assert_eq!(filed(file, None, vec![named(Some("7"))]), ["LA_01/7"]);
        assert_eq!(filed(file, Some(""), vec![named(Some("7")), named(Some("8"))]), ["7", "8"]);
        assert_eq!(filed(file, None, vec![known()]), ["id"]);
        assert_eq!(filed(file, Some("p-"), vec![known(), known()]), ["p-id", "p-id"]);
        assert_eq!(filed(None, None, vec![named(Some("7")), named(None)]), ["7", "-"]);
    }
}
