//! Archives (zip): every file within is read by the format of its name or of its first bytes.
//!
//! * The order is that of the directory of the archive. Names are never used as paths, yet those that would leave a folder are
//!   refused, as such an archive is suspect.
//! * Sizes that an archive declares are claims: the decompressed bytes count, at most [`Limits::content`] bytes of all files.
//! * Files of no known format are left out and counted. An archive within an archive is refused.
//! * Files that overlap are refused, and those of long names, which each of their shapes has.
//! * Where one file is a [project](projects), the files that it names are read, in its order and with its facts about them.

#[cfg(feature = "morphometrics")]
mod projects;
#[cfg(not(feature = "morphometrics"))]
#[path = "archive/no_projects.rs"]
mod projects;

use std::cell::Cell;
use std::collections::BTreeMap;
use std::io::Read;
use std::rc::Rc;

use super::format::Format;
use super::limits::{Bound, Budget, Limits};
use super::naming::{Filed, Scope};
use super::options::ReadOptions;
use super::record::Sink;
use super::record::{Kind, Record};
use super::registry::{detect, read as read_file};
use super::source::Source;
use super::text::name_fits;
use super::unzip::{Archive, fault, opened};
use crate::error::{FaultKind, FileError, Place};
use crate::summary::Summary;

/// Archives of several files.
pub(super) static FORMAT: Format = Format {
    id: "zip",
    name: "zip archives",
    media_types: &["application/zip"],
    extensions: &["zip"],
    // Files of other formats are archives too, and known by their names: see `detect`.
    recognise: |_| false,
    kinds: &[Kind::Curve, Kind::Landmarks, Kind::Mesh, Kind::Fourier],
    options: &["*"],
    read: Some(read),
    open: None,
};

/// Whether a file begins as an archive.
pub(super) fn is_archive(head: &[u8]) -> bool {
    head.starts_with(b"PK\x03\x04") || head.starts_with(b"PK\x05\x06")
}

/// Reader of the label images within archives. Their boundaries become shapes by means that no format has, so it is the caller's.
pub trait Images {
    /// Whether a file that begins with `head` is one.
    fn has(&self, head: &[u8], name: &str) -> bool;

    /// Reads all records of one.
    ///
    /// # Errors
    /// Faults of the image; errors of `sink`.
    fn read(
        &self,
        source: &mut Source<'_>,
        options: &ReadOptions,
        sink: Sink<'_>,
    ) -> Result<Summary, FileError>;
}

/// Without a reader, images are files of no known format.
pub(super) struct NoImages;

impl Images for NoImages {
    fn has(&self, _: &[u8], _: &str) -> bool {
        false
    }

    fn read(&self, _: &mut Source<'_>, _: &ReadOptions, _: Sink<'_>) -> Result<Summary, FileError> {
        Err(FileError::new(FaultKind::Unsupported, "expected a file of shapes, got an image"))
    }
}

fn read(source: &mut Source<'_>, options: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    read_beside(source, options, &NoImages, sink)
}

/// Reads an archive, and the label images within it by `images`.
pub(super) fn read_beside(
    source: &mut Source<'_>,
    options: &ReadOptions,
    images: &dyn Images,
    sink: Sink<'_>,
) -> Result<Summary, FileError> {
    let mut archive = opened(source.bytes()?)?;
    check_names(&archive)?;
    let first: Rc<Cell<u64>> = Rc::default();
    let again = Budget::new(AGAIN, Rc::clone(&first));
    let mut files = Files {
        archive: source,
        images,
        content: 0,
        first,
        again,
        summary: Summary::default(),
        facts: None,
        has_shapes: false,
        picture: None,
    };
    let count = match projects::read(&mut archive, &mut files, options, sink)? {
        None => files.read_all(&mut archive, options, sink)?,
        Some(count) => count,
    };
    let mut summary = files.summary;
    summary.properties = files.facts.unwrap_or_default();
    summary.set("files", count);
    Ok(summary)
}

/// Whether a file of an archive holds attributes of an operating system.
fn is_foreign(name: &str) -> bool {
    name.starts_with("__MACOSX/") || name.rsplit('/').next().is_some_and(|name| name.starts_with("._"))
}

/// Refuses names that leave a folder, long ones, and those that occur twice.
fn check_names(archive: &Archive) -> Result<(), FileError> {
    for name in archive.file_names() {
        let name = name.map_err(fault)?;
        name_fits(&name).map_err(|detail| FileError::malformed(Place::default(), detail))?;
        let parts = || name.split(['/', '\\']);
        let drive = name.as_bytes().get(1) == Some(&b':');
        if drive || name.starts_with(['/', '\\']) || parts().any(|part| part == "..") || name.contains('\0') {
            let place = Place { entry: Some(name.into_owned()), ..Place::default() };
            let detail = "expected names of files within the archive, got one that leads out of it";
            return Err(FileError::malformed(place, detail));
        }
    }
    if archive.has_duplicate_names() {
        let detail = "expected files with names of their own, got two with the same name";
        return Err(FileError::new(FaultKind::Malformed, detail));
    }
    Ok(())
}

/// Bytes of files that are read again, since many rows of a project may name the same one: in any archive, and for each byte of the
/// files that have been read first.
const AGAIN: Bound = Bound { what: "bytes of files that are read again", free: 64 << 20, per_byte: 16 };

/// Whether a fault is that of a picture without labels, which has given no record on.
fn has_no_labels(error: &FileError, is_given: bool, options: &ReadOptions) -> bool {
    error.kind == FaultKind::Unsupported && !is_given && !options.skips_broken()
}

/// State after some of the files.
struct Files<'a> {
    archive: &'a Source<'a>,
    images: &'a dyn Images,
    /// Number of bytes of the files so far.
    content: u64,
    /// Number of bytes of the files that a project names, when they are read first.
    first: Rc<Cell<u64>>,
    again: Budget,
    summary: Summary,
    /// Facts that all files so far agree on.
    facts: Option<BTreeMap<String, serde_json::Value>>,
    /// Whether some of the files are of a format of shapes.
    has_shapes: bool,
    /// The fault of the first picture without labels, such as the texture of a mesh. It refuses an archive without shapes.
    picture: Option<FileError>,
}

impl Files<'_> {
    /// Reads all files. Returns how many of them have a known format.
    fn read_all(
        &mut self,
        archive: &mut Archive,
        options: &ReadOptions,
        sink: Sink<'_>,
    ) -> Result<u64, FileError> {
        let mut count = 0;
        for k in 0..archive.len() {
            let file = archive.by_index(k).map_err(|error| fault(error).at(Place::item(k as u64)))?;
            let name = file.name().map_err(fault)?.into_owned();
            if file.is_dir() {
                continue;
            }
            let place = Place { entry: Some(name), ..Place::default() };
            match self.read(file, &place, options, sink) {
                Ok(is_known) => count += u64::from(is_known),
                Err(error) => {
                    options.leave_out(error.at(place), &mut self.summary)?;
                    count += 1;
                }
            }
        }
        if let Some(error) = self.picture.take().filter(|_| !self.has_shapes) {
            return Err(error);
        }
        if count == 0 {
            let detail = format!("expected an archive with files of a known format, got {}", archive.len());
            return Err(FileError::new(FaultKind::Unknown, format!("{detail} others")));
        }
        Ok(count)
    }

    /// Remaining limits of reading.
    fn left(&self) -> Limits {
        let limits = *self.archive.limits();
        Limits { content: limits.content.saturating_sub(self.content), ..limits }
    }

    /// The format of a file that begins with `head`: one of shapes, or the inner `None` for a label image; `None` if it is not known.
    fn format_of(&self, head: &[u8], name: &str) -> Result<Option<Option<&'static Format>>, FileError> {
        match detect(head, Some(name)) {
            _ if self.images.has(head, name) => Ok(Some(None)),
            Ok(format) if format.id == FORMAT.id => {
                let detail = "expected files of shapes, got an archive within the archive";
                Err(FileError::new(FaultKind::Unsupported, detail))
            }
            // A workbook without a project has no known format either.
            Ok(format) if format.id != projects::FORMAT => Ok(Some(Some(format))),
            _ => Ok(None),
        }
    }

    /// Reads a file. Returns whether it is one of a known format.
    fn read(
        &mut self,
        file: impl Read,
        place: &Place,
        options: &ReadOptions,
        sink: Sink<'_>,
    ) -> Result<bool, FileError> {
        let name = place.entry.as_deref().unwrap_or_default();
        let file_name = name.rsplit('/').next().unwrap_or_default();
        if is_foreign(name) {
            self.summary.drop("attributes of an operating system", Some(name), || place.clone());
            return Ok(false);
        }
        let mut source = self.archive.inner(file, self.left())?;
        let Some(format) = self.format_of(source.head(), file_name)? else {
            self.summary.drop("files of no known format", Some(name), || place.clone());
            return Ok(false);
        };
        let id = format.map_or("", |format| format.id);
        // Regions of ImageJ have names beside those of their files.
        let prefix = (id == "imagej-roi").then_some("");
        let mut filed = Filed::within(file_name, prefix, options.storing.is_some());
        let mut give = |mut record: Record| {
            if record.scope == Scope::Whole {
                record.scope = Scope::File;
            }
            sink(record)
        };
        let is_given = Cell::new(false);
        let mut push = |mut record: Record| {
            is_given.set(true);
            record.place = record.place.within(place);
            if record.scope == Scope::File {
                record.scope = Scope::of(id);
            }
            filed.push(record, &mut give)
        };
        let read = match format {
            Some(format) => read_file(format, &mut source, options, &mut push),
            None => self.images.read(&mut source, options, &mut push),
        };
        // The bytes after the shapes are checked too.
        let rest = std::io::copy(&mut source, &mut std::io::sink());
        self.content += source.offset();
        self.has_shapes |= format.is_some();
        let summary = match read {
            Err(error) if format.is_none() && has_no_labels(&error, is_given.get(), options) => {
                rest?;
                self.summary.drop("pictures without labels", Some(name), || place.clone());
                self.picture.get_or_insert_with(|| error.at(place.clone()));
                return Ok(false);
            }
            read => read?,
        };
        filed.finish(summary.has_broken(), &mut give)?;
        rest?;
        self.add(summary, place);
        Ok(true)
    }

    /// Adds the summary of one file by its reader.
    fn add(&mut self, summary: Summary, place: &Place) {
        let name = place.entry.as_deref().unwrap_or_default();
        self.summary
            .warnings
            .extend(summary.warnings.into_iter().map(|warning| format!("file '{name}': {warning}")));
        for dropped in summary.dropped {
            let names = dropped.names.iter().map(|name| Some(name.as_str())).chain(std::iter::repeat(None));
            for (name, _) in names.zip(0..dropped.count) {
                self.summary.drop(&dropped.what, name, || dropped.first.clone().within(place));
            }
        }
        let Some(facts) = &mut self.facts else {
            self.facts = Some(summary.properties);
            return;
        };
        let differing = |name: &&String| facts.get(*name) != summary.properties.get(*name);
        let names = facts.keys().chain(summary.properties.keys()).filter(differing);
        for name in names.cloned().collect::<std::collections::BTreeSet<_>>() {
            facts.remove(&name);
            self.summary.drop("facts that differ between files", Some(&name), || place.clone());
        }
    }
}

#[cfg(test)]
mod tests;
