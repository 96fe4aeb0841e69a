//! The format of a file: one of the registry of shapes, or one of images whose labels become shapes.

use std::cell::Cell;

use crate::service::app::Limits;
use crate::service::segmentation::records::{label_image_bytes, label_image_cells, read_label_image};
use crate::wire::files::{self, Images, Kind, Limits as FileLimits, ReadOptions, Sink, Source, Summary};
use crate::wire::files::{FaultKind, FileError};
use crate::wire::image::{self, LABEL_OPTIONS};

/// A format of files that hold shapes.
#[derive(Debug, Clone, Copy)]
pub enum FileFormat {
    /// Of the registry of shapes.
    Shapes(&'static files::Format),
    /// Of the registry of images, for label images.
    Labels(&'static image::Format),
}

impl FileFormat {
    /// All formats: those of shapes, then those of images.
    pub fn all() -> impl Iterator<Item = Self> {
        files::FORMATS
            .iter()
            .map(|format| Self::Shapes(format))
            .chain(image::FORMATS.iter().map(Self::Labels))
    }

    /// The format with an id, a media type or a file extension.
    pub fn find(word: &str) -> Option<Self> {
        let word = word.trim().to_lowercase();
        let is_image = |format: &&image::Format| {
            format.id == word
                || format.media_types.contains(&word.as_str())
                || format.extensions.contains(&word.as_str())
        };
        let shapes = files::find(&word).map(Self::Shapes);
        shapes.or_else(|| image::FORMATS.iter().find(is_image).map(Self::Labels))
    }

    /// The formats that are read and have a media type: several of DICOM.
    pub fn of_media_type(media_type: &str) -> impl Iterator<Item = Self> {
        Self::all().filter(move |format| format.is_read() && format.media_types().contains(&media_type))
    }

    /// The format of a file by its first bytes, else by the end of its name.
    ///
    /// # Errors
    /// [`FaultKind::Unknown`], which lists the formats.
    pub fn detect(head: &[u8], name: Option<&str>) -> Result<Self, FileError> {
        if let (true, Ok(format)) = (is_segmentation(head), image::detect(head)) {
            return Ok(Self::Labels(format));
        }
        // Formats of shapes come first: some are compressed, as are images.
        files::detect(head, name).map(Self::Shapes).or_else(|error| {
            let format = image::detect(head).map_err(|_| {
                let images = image::FORMATS.iter().map(|format| format.name).collect::<Vec<_>>().join(", ");
                FileError { detail: format!("{} (or a label image: {images})", error.detail), ..error }
            })?;
            Ok(Self::Labels(format))
        })
    }

    /// Word in options and queries.
    pub fn id(self) -> &'static str {
        match self {
            Self::Shapes(format) => format.id,
            Self::Labels(format) => format.id,
        }
    }

    /// Name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Shapes(format) => format.name,
            Self::Labels(format) => format.name,
        }
    }

    /// Media types of requests and responses.
    pub fn media_types(self) -> &'static [&'static str] {
        match self {
            Self::Shapes(format) => format.media_types,
            Self::Labels(format) => format.media_types,
        }
    }

    /// Endings of file names, lower case, without the first dot; the first one is written.
    pub fn extensions(self) -> &'static [&'static str] {
        match self {
            Self::Shapes(format) => format.extensions,
            Self::Labels(format) => format.extensions,
        }
    }

    /// Kinds of its records: boundaries of labels are curves, of volumes meshes.
    pub fn kinds(self) -> &'static [Kind] {
        match self {
            Self::Shapes(format) => format.kinds,
            Self::Labels(_) => &[Kind::Curve, Kind::Mesh],
        }
    }

    /// Options of reading that it obeys.
    pub fn options(self) -> &'static [&'static str] {
        match self {
            Self::Shapes(format) => format.options,
            Self::Labels(_) => &LABEL_OPTIONS,
        }
    }

    /// Whether files of the format can be read.
    pub fn is_read(self) -> bool {
        match self {
            Self::Shapes(format) => format.is_read(),
            Self::Labels(_) => true,
        }
    }

    /// Whether files of the format can be written.
    pub fn is_written(self) -> bool {
        match self {
            Self::Shapes(format) => format.is_written(),
            Self::Labels(_) => false,
        }
    }

    /// Reads all records of a file. It ends soon after `stop` says so: at the next record, or while boundaries are computed.
    ///
    /// # Errors
    /// Faults of the file, sizes beyond the limits, options that the format does not have, and errors of `sink`.
    pub fn read(
        self,
        source: &mut Source<'_>,
        options: &ReadOptions,
        limits: &Limits,
        stop: &(dyn Fn() -> bool + Sync),
        sink: Sink<'_>,
    ) -> Result<Summary, FileError> {
        match self {
            Self::Shapes(format) => {
                let images = ImagesWithin::new(limits, stop);
                files::read_beside(format, source, options, &images, &mut |record| {
                    if stop() {
                        return Err(FileError::new(FaultKind::Stopped, "the reading was stopped"));
                    }
                    sink(record)
                })
            }
            Self::Labels(format) => {
                let bytes = source.bytes()?;
                // A compressed image may have been decompressed on the way.
                let format = image::detect(&bytes).unwrap_or(format);
                source.reserve_beside(label_image_bytes(&bytes, options, limits)?)?;
                read_label_image(format, &bytes, options, limits, stop, sink)
            }
        }
    }
}

/// Cells of the label images of an archive for each byte of them, beside those that one image may have: a few bytes can be many cells.
const CELLS_PER_BYTE: usize = 256;

/// The label images of an archive, which are read one after the other.
struct ImagesWithin<'a> {
    limits: &'a Limits,
    stop: &'a (dyn Fn() -> bool + Sync),
    /// Cells and bytes of the images so far.
    cells: Cell<usize>,
    bytes: Cell<usize>,
}

impl<'a> ImagesWithin<'a> {
    fn new(limits: &'a Limits, stop: &'a (dyn Fn() -> bool + Sync)) -> Self {
        Self { limits, stop, cells: Cell::new(0), bytes: Cell::new(0) }
    }

    /// Counts an image.
    fn count(&self, bytes: &[u8]) -> Result<(), FileError> {
        self.bytes.set(self.bytes.get().saturating_add(bytes.len()));
        self.cells.set(self.cells.get().saturating_add(label_image_cells(bytes, self.limits)?));
        let read = self.bytes.get();
        let most = self.limits.voxels.saturating_add(read.saturating_mul(CELLS_PER_BYTE));
        if self.cells.get() <= most {
            return Ok(());
        }
        let detail = format!("expected at most {most} cells of label images in {read} bytes, got more");
        Err(FileError::new(FaultKind::TooLarge, detail))
    }
}

impl Images for ImagesWithin<'_> {
    fn has(&self, head: &[u8], name: &str) -> bool {
        matches!(FileFormat::detect(head, Some(name)), Ok(FileFormat::Labels(_)))
    }

    fn read(
        &self,
        source: &mut Source<'_>,
        options: &ReadOptions,
        sink: Sink<'_>,
    ) -> Result<Summary, FileError> {
        let bytes = source.bytes()?;
        self.count(&bytes)?;
        let format =
            image::detect(&bytes).map_err(|error| FileError::new(FaultKind::Malformed, error.to_string()))?;
        source.reserve_beside(label_image_bytes(&bytes, options, self.limits)?)?;
        read_label_image(format, &bytes, options, self.limits, self.stop, sink)
    }
}

/// Classes of the objects of DICOM that are label images, segmentations and label maps; those of other classes hold contours.
const SEGMENTATIONS: [&[u8]; 2] = [b"1.2.840.10008.5.1.4.1.1.66.4", b"1.2.840.10008.5.1.4.1.1.66.7"];

/// Whether the first bytes of a file name a class of segmentations.
fn is_segmentation(head: &[u8]) -> bool {
    SEGMENTATIONS.iter().any(|class| memchr::memmem::find(head, class).is_some())
}

/// Limits of files that the service reads: whole files and single features are as large as a body may be.
pub fn file_limits(limits: &Limits) -> FileLimits {
    FileLimits {
        content: (limits.body_bytes as u64).saturating_mul(limits.compression_ratio as u64),
        held: limits.body_bytes,
        points: limits.points.max(limits.vertices),
        ..FileLimits::default()
    }
}

/// The fault of a word that names no format.
pub fn unknown_format(word: &str) -> FileError {
    let known = FileFormat::all().map(FileFormat::id).collect::<Vec<_>>().join(", ");
    FileError::new(FaultKind::Unknown, format!("expected one of the formats {known}, got '{word}'"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_all_formats_are_their_own() {
        for format in FileFormat::all() {
            assert_eq!(FileFormat::find(format.id()).map(FileFormat::name), Some(format.name()));
        }
        let of_dicom = FileFormat::of_media_type("application/dicom").map(FileFormat::id);
        assert_eq!(of_dicom.collect::<Vec<_>>(), ["rtstruct", "segmentation"]);
        let shared = |word: &&str| FileFormat::of_media_type(word).count() > 1;
        for format in FileFormat::all() {
            let shared: Vec<_> = format.media_types().iter().filter(|word| shared(word)).collect();
            assert!(shared.is_empty() || *shared[0] == "application/dicom", "{shared:?}");
        }
    }

    #[test]
    fn reading_stops_at_the_next_record() {
        let lines = "{\"points\":[[0,1],[2,3]]}\n".repeat(5);
        let stopped = std::sync::atomic::AtomicBool::new(false);
        let mut count = 0;
        let mut source = Source::new(lines.as_bytes(), FileLimits::default()).unwrap();
        let format = FileFormat::find("ndjson").unwrap();
        let stop = || stopped.load(std::sync::atomic::Ordering::Relaxed);
        let read = format.read(&mut source, &ReadOptions::default(), &Limits::default(), &stop, &mut |_| {
            count += 1;
            stopped.store(count == 2, std::sync::atomic::Ordering::Relaxed);
            Ok(())
        });
        assert_eq!((read.unwrap_err().kind, count), (FaultKind::Stopped, 2));
    }

    #[test]
    fn formats_are_found_by_bytes_or_name() {
        let id = |head: &[u8], name| FileFormat::detect(head, name).map(FileFormat::id);
        assert_eq!(id(b"\x89PNG\r\n\x1a\n", None), Ok("png"));
        assert_eq!(id(b"{}", Some("a.NDJSON")), Ok("ndjson"));
        for (class, format) in [("66.4", "segmentation"), ("66.7", "segmentation"), ("481.3", "rtstruct")] {
            let preamble =
                [&[0; 128][..], b"DICM", format!("1.2.840.10008.5.1.4.1.1.{class}").as_bytes()].concat();
            assert_eq!(id(&preamble, None), Ok(format), "{class}");
        }
        let error = id(b"????", Some("a.xyz")).unwrap_err().to_string();
        assert!(error.contains("NDJSON") && error.contains("PNG") && error.contains("3f 3f"), "{error}");
    }
}
