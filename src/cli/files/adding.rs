//! How files are added to a cohort of a service or of a store, for commands that do it and for one that only tells the effect.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use bytes::Bytes;
use clap::Args;
use futures_util::{Stream, StreamExt, stream};
use tokio_util::io::ReaderStream;

use super::bar::Bar;
use super::content::{Opened, is_standard};
use super::target::{Target, TargetArgs};
use super::{Reading, pairs};
use crate::cli::at::At;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::pseudonyms::SubjectFrom;
use crate::service::cohorts::upload::{Returned, Treatment};
use crate::service::cohorts::upload_file::FileToAdd;
use crate::service::files::FileFormat;
use crate::service::files::translate::{FileReading, to_add};
use crate::service::shapes::outcome::OnError;
use crate::wire::files::{self, FileError};
use crate::wire::json;
use crate::wire::lengths::unit_of;
use crate::wire::record::{Facts, Placing, Plane};
use crate::wire::unit::Unit;

/// Number of bytes read at once.
pub(super) const BLOCK: usize = 256 << 10;

/// Where files of shapes are added, and how they become shapes.
#[derive(Debug, Clone, Args)]
pub(super) struct AddingArgs {
    #[command(flatten)]
    target: TargetArgs,
    #[command(flatten)]
    pub(super) reading: Reading,
    /// Store the other shapes of a file with shapes that are invalid, broken, or have the names of others
    #[arg(long, requires = "cohort")]
    skip_invalid: bool,
    /// Plane onto which shapes in space are projected, for planar cohorts: xy, xz or yz
    #[arg(long, requires = "cohort", value_parser = plane)]
    plane: Option<Plane>,
    /// Number of points of curves given by Fourier coefficients that the cohort does not contain
    #[arg(long, requires = "cohort", value_name = "N", value_parser = clap::value_parser!(u16).range(3..=10_000))]
    samples: Option<u16>,
    /// Text before the names of shapes; `{file}` is the name of the file without its ending. Default: `{file}/`, but for names that
    /// are identities: those of tables, of NDJSON, and unique identifiers of DICOM
    #[arg(long, requires = "cohort", value_name = "TEXT")]
    prefix: Option<String>,
    /// What the coordinates of the files are in, whatever they state: m, cm, mm, um, nm, inch, pixel, voxel or none
    #[arg(long, requires = "cohort", value_parser = unit_of)]
    unit: Option<Unit>,
    #[command(flatten)]
    facts: FactsArgs,
}

/// Facts of all shapes of the files.
#[derive(Debug, Clone, Args)]
struct FactsArgs {
    /// Subject of the shapes of which the file says none; `{file}` as in `--prefix`
    #[arg(long, requires = "cohort", value_name = "TEXT")]
    subject: Option<String>,
    /// What of a file says whose its shapes are: `PatientID`. The subject is a keyed digest, the same for a patient in all files
    #[arg(long, requires = "cohort", value_name = "WHAT", value_parser = subject_from)]
    subject_from: Option<SubjectFrom>,
    /// Class label of the shapes of which the file says none
    #[arg(long, requires = "cohort", value_name = "TEXT")]
    label: Option<String>,
    /// Attribute of the shapes that the file does not give them, such as `site=zrh`; may be repeated
    #[arg(long, requires = "cohort", value_name = "NAME=VALUE")]
    labels: Vec<String>,
    /// Weight of the shapes of which the file says none
    #[arg(long, requires = "cohort", value_name = "NUMBER")]
    weight: Option<f64>,
}

impl AddingArgs {
    /// Refuses options of files of shapes without a cohort.
    ///
    /// # Errors
    /// An option that needs a cohort.
    pub(super) fn check_without_cohort(&self) -> Result<(), String> {
        self.target.check_without_cohort()?;
        match self.reading.is_usual() {
            true => Ok(()),
            false => Err("expected --cohort beside --from and --option, got none".into()),
        }
    }

    /// Opens the store of the cohort, or prepares requests.
    ///
    /// # Errors
    /// Faults of options, which are found before anything is sent.
    pub(super) async fn open(&self, cohort: String, at: At) -> Result<Adding<'_>, String> {
        self.reading.options()?;
        pairs(&self.facts.labels)?;
        let stated = self.reading.format()?;
        let target = self.target.clone().open(at).await?;
        Ok(Adding { args: self, cohort, stated, target, bar: None })
    }
}

fn subject_from(word: &str) -> Result<SubjectFrom, String> {
    json::from_value(&word.into()).map_err(|_| "expected PatientID".into())
}

fn plane(word: &str) -> Result<Plane, String> {
    json::from_value(&word.into()).map_err(|_| "expected xy, xz or yz".into())
}

/// Files on their way to a cohort.
pub(super) struct Adding<'a> {
    args: &'a AddingArgs,
    pub(super) cohort: String,
    stated: Option<FileFormat>,
    pub(super) target: Target,
    /// Bar that counts the bytes, on a terminal.
    pub(super) bar: Option<Bar>,
}

impl Adding<'_> {
    /// The bytes of a file, and its format.
    ///
    /// # Errors
    /// A file that cannot be read, or has no known format.
    pub(super) fn content<'p>(&self, path: &'p Path) -> Result<(FileFormat, Content<'p>), FileError> {
        let options = self.args.reading.options().unwrap_or_default();
        let Opened { format, packed, .. } = Opened::new(path, self.stated, &options)?;
        Ok((format, Content { path, packed }))
    }

    /// Parameters of the request.
    pub(super) fn query(&self, path: &Path, format: FileFormat) -> Vec<(String, String)> {
        let args = self.args;
        let mut query = vec![("format".to_owned(), format.id().to_owned())];
        let options = pairs(&args.reading.options).unwrap_or_default();
        query.extend(options.into_iter().map(|(name, value)| (name.to_owned(), value.to_owned())));
        let mut add = |name: &str, value: Option<String>| {
            query.extend(value.map(|value| (name.to_owned(), value)));
        };
        add("plane", args.plane.and_then(|plane| json::to_value(&plane).ok()?.as_str().map(str::to_owned)));
        add("samples", args.samples.map(|count| count.to_string()));
        let name = (!is_standard(path)).then(|| path.file_name().unwrap_or_default().to_string_lossy());
        let stem = name.as_deref().map(files::stem).unwrap_or_default();
        let filled = |text: &String| text.replace("{file}", stem);
        add("name", name.as_deref().map(str::to_owned));
        add("prefix", args.prefix.as_ref().map(filled));
        let FactsArgs { subject, subject_from, label, labels, weight } = &args.facts;
        add("subject", subject.as_ref().map(filled));
        add(
            "subject_from",
            subject_from.and_then(|from| json::to_value(&from).ok()?.as_str().map(str::to_owned)),
        );
        add("label", label.clone());
        add("weight", weight.map(|weight| weight.to_string()));
        for (name, value) in pairs(labels).unwrap_or_default() {
            add(&format!("labels.{name}"), Some(value.to_owned()));
        }
        add("unit", args.unit.map(|unit| unit.word().to_owned()));
        add("on_error", args.skip_invalid.then(|| "skip".to_owned()));
        add("return", Some("none".into()));
        query
    }

    /// A file for a store, with the treatment of its shapes.
    ///
    /// # Errors
    /// Faults of options.
    pub(super) fn file(
        &self,
        app: &App,
        format: FileFormat,
        query: &[(String, String)],
    ) -> Result<(FileToAdd, Treatment), String> {
        let args = self.args;
        let value =
            |name: &str| query.iter().find(|(found, _)| found == name).map(|(_, value)| value.clone());
        let placing = Placing {
            plane: args.plane,
            samples: args.samples.map(usize::from),
            prefix: value("prefix"),
            unit: args.unit,
            name: value("name"),
            facts: self.facts(value("subject"))?,
            metadata_bytes: app.limits.metadata_bytes,
            ..Placing::default()
        };
        let reading =
            FileReading { format: Some(format), name: value("name"), options: args.reading.options()? };
        let on_error = if args.skip_invalid { OnError::Skip } else { OnError::Abort };
        let file = to_add(reading, placing, (on_error, args.facts.subject_from), &app.limits);
        let treatment =
            Treatment { on_error, conflicts: on_error, returned: Returned::None, ..Treatment::default() };
        Ok((file, treatment))
    }

    /// Facts of all shapes of a file.
    fn facts(&self, subject: Option<String>) -> Result<Facts, String> {
        let FactsArgs { label, labels, weight, .. } = &self.args.facts;
        let mut facts = Facts { subject, label: label.clone(), weight: *weight, ..Facts::default() };
        pairs(labels)?.into_iter().for_each(|(name, value)| facts.add(name, value));
        Ok(facts)
    }

    /// The bytes of a file as the body of a request to a service.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub(super) async fn body(&self, content: &Content<'_>) -> std::io::Result<reqwest::Body> {
        Ok(reqwest::Body::wrap_stream(self.stream(content).await?))
    }

    /// The bytes of a file for a store.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub(super) async fn pieces(
        &self,
        content: &Content<'_>,
    ) -> std::io::Result<impl Stream<Item = Result<Bytes, ServiceError>> + Send + 'static> {
        let stream = self.stream(content).await?;
        Ok(stream.map(|bytes| bytes.map_err(|error| ServiceError::Interrupted(error.to_string()))))
    }

    /// The bytes of a file, counted by the progress bar.
    async fn stream(
        &self,
        content: &Content<'_>,
    ) -> std::io::Result<impl Stream<Item = std::io::Result<Bytes>> + Send + 'static> {
        let bar = self.bar.clone();
        let stream = match &content.packed {
            Some(bytes) => stream::once(std::future::ready(Ok(bytes.clone()))).left_stream(),
            None => {
                let file = tokio::fs::File::open(content.path).await?;
                ReaderStream::with_capacity(file, BLOCK).right_stream()
            }
        };
        Ok(stream.inspect(move |bytes| {
            if let (Some(bar), Ok(bytes)) = (&bar, bytes) {
                bar.pass(bytes.len() as u64);
            }
        }))
    }
}

/// A refusal with the place of its first fault.
pub(super) fn sentence(error: &ServiceError) -> String {
    let fault = match error {
        ServiceError::Invalid(faults) => faults.listed().first(),
        ServiceError::Malformed(faults) | ServiceError::Parameters(faults) => faults.first(),
        ServiceError::TooLarge(fault) | ServiceError::ExternalIdConflict(fault) => Some(&**fault),
        _ => None,
    };
    let Some(fault) = fault else { return error.to_string() };
    let place = fault.place.as_ref().map_or_else(String::new, |place| format!("{place}: "));
    let pointer = if fault.pointer.is_empty() { String::new() } else { format!("{} ", fault.pointer) };
    format!("{place}{pointer}{}", fault.detail)
}

/// The bytes of a file: of a project, those of its archive.
pub(super) struct Content<'p> {
    path: &'p Path,
    packed: Option<Bytes>,
}

impl Content<'_> {
    /// Number of bytes.
    pub(super) fn len(&self) -> u64 {
        let of_file = || std::fs::metadata(self.path).map_or(0, |metadata| metadata.len());
        self.packed.as_ref().map_or_else(of_file, |bytes| bytes.len() as u64)
    }

    pub(super) fn reader(&self) -> std::io::Result<Box<dyn Read>> {
        Ok(match &self.packed {
            Some(bytes) => Box::new(std::io::Cursor::new(bytes.clone())),
            None => Box::new(File::open(self.path)?),
        })
    }
}
