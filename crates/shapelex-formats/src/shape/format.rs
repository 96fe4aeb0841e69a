//! The registry of formats.

use std::io::Write;

use super::error::{FaultKind, FileError};
use super::options::{ReadOptions, WriteOptions};
use super::record::Kind;
use super::source::Source;
use super::summary::Summary;
use super::write::Writer;
use super::{
    Sink, archive, chc, coco, csv, geojson, imagej, mesh, morphologika, ndjson, nef, nts, rtstruct, slicer,
    table, tps, wkt,
};

/// Reads all records of a file.
pub(super) type Read = fn(&mut Source<'_>, &ReadOptions, Sink<'_>) -> Result<Summary, FileError>;
/// Begins a file.
pub(super) type Open =
    for<'a> fn(Box<dyn Write + Send + 'a>, &WriteOptions) -> Result<Box<dyn Writer + 'a>, FileError>;

/// A format of files.
#[derive(Debug, Clone, Copy)]
pub struct Format {
    /// Word in options and queries, and the name of its page: `docs/formats/{id}.md`.
    pub id: &'static str,
    /// Name in messages.
    pub name: &'static str,
    /// Media types of requests and responses; the first one is written.
    pub media_types: &'static [&'static str],
    /// Endings of file names, lower case, without the first dot; the first one is written.
    pub extensions: &'static [&'static str],
    /// Whether the first bytes of a file (at most 4096) can only be of this format.
    pub recognise: fn(&[u8]) -> bool,
    /// What its records can be.
    pub kinds: &'static [Kind],
    /// Fields of [`ReadOptions`] that it obeys. `*` of archives: those of the files within.
    pub options: &'static [&'static str],
    pub(super) read: Option<Read>,
    pub(super) open: Option<Open>,
}

/// All formats.
pub static FORMATS: &[&Format] = &[
    &ndjson::FORMAT,
    &archive::FORMAT,
    &mesh::obj::FORMAT,
    &mesh::ply::FORMAT,
    &mesh::stl::FORMAT,
    &mesh::off::FORMAT,
    &mesh::vtk::FORMAT,
    &mesh::vtp::FORMAT,
    &mesh::gifti::FORMAT,
    &mesh::gltf::FORMAT,
    &mesh::particles::FORMAT,
    &tps::FORMAT,
    &nts::FORMAT,
    &morphologika::FORMAT,
    &slicer::fcsv::FORMAT,
    &slicer::markups::FORMAT,
    &chc::FORMAT,
    &nef::FORMAT,
    &csv::FORMAT,
    &geojson::FORMAT,
    &imagej::FORMAT,
    &imagej::SET,
    &wkt::FORMAT,
    &coco::FORMAT,
    &rtstruct::FORMAT,
    &table::ARROW,
    &table::PARQUET,
    &table::NPY,
    &table::NPZ,
];

impl Format {
    /// Whether files of the format can be read.
    pub fn is_read(&self) -> bool {
        self.read.is_some()
    }

    /// Whether files of the format can be written.
    pub fn is_written(&self) -> bool {
        self.open.is_some()
    }

    /// Begins a file of this format.
    ///
    /// # Errors
    /// A format that is only read; those of the output.
    pub fn writer<'a>(
        &self,
        output: impl Write + Send + 'a,
        options: &WriteOptions,
    ) -> Result<Box<dyn Writer + 'a>, FileError> {
        let Some(open) = self.open else {
            let detail =
                format!("expected a format that can be written, got {}, which is only read", self.name);
            return Err(FileError::new(FaultKind::Unsupported, detail));
        };
        open(Box::new(output), options)
    }
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
    use std::collections::BTreeSet;

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
}
