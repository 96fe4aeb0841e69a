//! The registry of formats.

use std::collections::BTreeSet;

use super::account::Account;
use super::archive::{Images, NoImages};
use super::format::Format;
use super::naming::Naming;
use super::options::ReadOptions;
use super::record::{Record, Sink};
use super::source::Source;
use super::{archive, csv, geojson, ndjson};
use crate::error::{FaultKind, FileError, Place};
use crate::summary::Summary;

/// All formats of the families that are compiled.
pub static FORMATS: &[&Format] = &[
    &ndjson::FORMAT,
    &archive::FORMAT,
    #[cfg(feature = "meshes")]
    &super::mesh::obj::FORMAT,
    #[cfg(feature = "meshes")]
    &super::mesh::ply::FORMAT,
    #[cfg(feature = "meshes")]
    &super::mesh::stl::FORMAT,
    #[cfg(feature = "meshes")]
    &super::mesh::off::FORMAT,
    #[cfg(feature = "meshes")]
    &super::mesh::vtk::FORMAT,
    #[cfg(feature = "meshes")]
    &super::mesh::vtp::FORMAT,
    #[cfg(feature = "meshes")]
    &super::mesh::gifti::FORMAT,
    #[cfg(feature = "meshes")]
    &super::mesh::gltf::FORMAT,
    #[cfg(feature = "meshes")]
    &super::mesh::particles::FORMAT,
    #[cfg(feature = "morphometrics")]
    &super::project::FORMAT,
    #[cfg(feature = "morphometrics")]
    &super::tps::FORMAT,
    #[cfg(feature = "morphometrics")]
    &super::nts::FORMAT,
    #[cfg(feature = "morphometrics")]
    &super::morphologika::FORMAT,
    #[cfg(feature = "morphometrics")]
    &super::slicer::fcsv::FORMAT,
    #[cfg(feature = "morphometrics")]
    &super::slicer::markups::FORMAT,
    #[cfg(feature = "morphometrics")]
    &super::scalismo::FORMAT,
    #[cfg(feature = "morphometrics")]
    &super::chc::FORMAT,
    #[cfg(feature = "morphometrics")]
    &super::nef::FORMAT,
    &csv::FORMAT,
    &geojson::FORMAT,
    #[cfg(feature = "microscopy")]
    &super::imagej::FORMAT,
    #[cfg(feature = "microscopy")]
    &super::imagej::SET,
    #[cfg(feature = "microscopy")]
    &super::wkt::FORMAT,
    #[cfg(feature = "microscopy")]
    &super::coco::FORMAT,
    #[cfg(feature = "dicom")]
    &super::rtstruct::FORMAT,
    #[cfg(feature = "tables")]
    &super::table::ARROW,
    #[cfg(feature = "tables")]
    &super::table::PARQUET,
    #[cfg(feature = "tables")]
    &super::table::NPY,
    #[cfg(feature = "tables")]
    &super::table::NPZ,
];

/// Reads all records of a file of a format. Those without points are left out, and counted.
///
/// # Errors
/// Faults of the file, sizes beyond the limits, options that the format does not have, and errors of `sink`.
pub fn read(
    format: &Format,
    source: &mut Source<'_>,
    options: &ReadOptions,
    sink: Sink<'_>,
) -> Result<Summary, FileError> {
    read_beside(format, source, options, &NoImages, sink)
}

/// Reads as [`read`] does, and the label images of an archive by `images`.
///
/// # Errors
/// As [`read`], and those of `images`.
pub fn read_beside(
    format: &Format,
    source: &mut Source<'_>,
    options: &ReadOptions,
    images: &dyn Images,
    sink: Sink<'_>,
) -> Result<Summary, FileError> {
    let Some(read) = format.read else {
        let detail =
            format!("expected a format that can be read, got {}, which is only written", format.name);
        return Err(FileError::new(FaultKind::Unsupported, detail));
    };
    options.check(format)?;
    let mut account = Account::new(*source.limits(), source.content());
    let (mut empty, mut left_out) = (0, Summary::default());
    let unit = format.unit();
    let mut units = BTreeSet::new();
    let (mut naming, ask) = (Naming::new(format.id, options), source.asker());
    let mut counted = |mut record: Record| {
        record.unit = record.unit.or(unit);
        units.insert(record.unit);
        options.thin(&mut record, &mut left_out);
        let checked = account.add(&record).and_then(|()| record.check());
        let checked = checked.map_err(|error| {
            let is_placed = record.place != Place::default();
            error.at(if is_placed { record.place.clone() } else { Place::item(account.records - 1) })
        });
        if let Err(error) = checked {
            options.leave_out(error, &mut left_out)?;
            empty += 1;
            return Ok(());
        }
        if record.is_empty() {
            empty += 1;
            left_out.drop("shapes without points", record.name.as_deref(), || record.place.clone());
            return Ok(());
        }
        naming.name(&mut record, &ask)?;
        sink(record)
    };
    let read = if format.id == archive::FORMAT.id {
        archive::read_beside(source, options, images, &mut counted)
    } else {
        read(source, options, &mut counted)
    };
    let read = read.and_then(|summary| source.finish().map(|()| summary));
    let mut summary = read.map_err(|error| match error.kind {
        FaultKind::Truncated if *error.place == Place::default() => error.at(Place::byte(source.offset())),
        _ => error,
    })?;
    summary.records = account.records - empty;
    // One unit of all shapes is a fact of the file.
    let common =
        if units.is_empty() { unit } else { units.pop_first().flatten().filter(|_| units.is_empty()) };
    if let Some(unit) = common {
        summary.properties.entry("unit".into()).or_insert_with(|| unit.word().into());
    }
    summary.dropped.extend(left_out.dropped);
    Ok(summary)
}

/// The format with an id, a media type or a file extension.
pub fn find(word: &str) -> Option<&'static Format> {
    let word = word.trim().to_lowercase();
    let named = |format: &&&Format| {
        format.id == word
            || format.media_types.contains(&word.as_str())
            || format.extensions.contains(&word.as_str())
    };
    FORMATS.iter().find(named).copied()
}

/// The format of a file by its first bytes, else by the end of its name, without the `.gz` of a compressed file; of several formats
/// with one ending, one that is read.
///
/// # Errors
/// [`FaultKind::Unknown`], which lists the formats.
pub fn detect(head: &[u8], name: Option<&str>) -> Result<&'static Format, FileError> {
    let recognised = FORMATS.iter().find(|format| (format.recognise)(head));
    let name = name.unwrap_or_default().to_lowercase();
    let name = name.strip_suffix(".gz").unwrap_or(&name);
    let ends = |extension: &&str| name.strip_suffix(*extension).is_some_and(|rest| rest.ends_with('.'));
    let named = |read: bool| {
        FORMATS.iter().find(|format| format.is_read() == read && format.extensions.iter().any(&ends)).copied()
    };
    let archive = || archive::is_archive(head).then_some(&archive::FORMAT);
    let found = recognised.copied().or_else(|| named(true)).or_else(archive).or_else(|| named(false));
    found.ok_or_else(|| {
        let known = FORMATS.iter().filter(|format| format.is_read()).map(|format| format.name);
        let known = known.collect::<Vec<_>>().join(", ");
        let detail = format!(
            "expected a file of one of the formats {known}, got one that begins with {}",
            shown(head)
        );
        FileError::new(FaultKind::Unknown, detail)
    })
}

/// The format that is written to a file with this name: the one with the longest ending, of those that are written.
///
/// # Errors
/// As [`detect`].
pub fn detect_written(name: &str) -> Result<&'static Format, FileError> {
    let lower = name.to_lowercase();
    let ends = |extension: &&&str| lower.strip_suffix(**extension).is_some_and(|rest| rest.ends_with('.'));
    let length = |format: &&&Format| format.extensions.iter().filter(ends).map(|ending| ending.len()).max();
    let found =
        FORMATS.iter().filter(|format| format.is_written() && length(format).is_some()).max_by_key(length);
    found.map_or_else(|| detect(&[], Some(name)), |format| Ok(*format))
}

/// The first bytes of an unknown file, hexadecimal.
fn shown(head: &[u8]) -> String {
    if head.is_empty() {
        return "no bytes".into();
    }
    head.iter().take(8).map(|byte| format!("{byte:02x}")).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::Limits;

    #[test]
    fn words_of_formats_are_their_own() {
        let mut words = BTreeSet::new();
        for format in FORMATS {
            for word in std::iter::once(&format.id).chain(format.media_types).chain(format.extensions) {
                assert_eq!(**word, word.to_lowercase());
                let own = format.extensions.contains(word) && *word == format.id;
                assert!(words.insert(*word) || own, "{word} is used twice");
            }
            assert!(format.is_read() || format.is_written());
        }
    }

    #[test]
    fn names_of_outputs_tell_the_format() {
        let id = |name| detect_written(name).map(|format| format.id);
        assert_eq!([id("a.ndjson"), id("A.MRK.JSON"), id("a.b.tps")], [Ok("ndjson"), Ok("mrk"), Ok("tps")]);
        #[cfg(feature = "microscopy")]
        assert_eq!([id("cells.roi.zip"), id("cells.roi")], [Ok("imagej-roi-set"), Ok("imagej-roi")]);
        assert_eq!(id("cells.zip"), Ok("zip"), "a format that is only read");
        assert!(id("cells").is_err());
    }

    #[test]
    fn shapes_without_points_are_left_out_and_counted() {
        let file = b"{\"points\": [[0, 1], [2, 3]]}\n{\"external_id\": \"b\", \"points\": []}\n[[]]\n";
        let mut source = Source::new(&file[..], Limits::default()).unwrap();
        let mut found = Vec::new();
        let summary = read(find("ndjson").unwrap(), &mut source, &ReadOptions::default(), &mut |record| {
            found.push(record);
            Ok(())
        });
        let summary = summary.unwrap();
        let dropped = &summary.dropped[0];
        assert_eq!((summary.records, found.len()), (1, 1));
        assert_eq!(
            (&*dropped.what, dropped.count, &*dropped.names),
            ("shapes without points", 2, &["b".to_owned()][..])
        );
        assert_eq!(dropped.first.to_string(), "line 2");
    }
}
