//! `shapelex import FILE… --cohort NAME`: takes files of shapes into a cohort.
//!
//! Each file is one request, stored as a whole or not at all. Its `Idempotency-Key` is the digest of its content, the cohort and the
//! options, among which is the name of the file: a file that was imported within the last seven days is not stored again. A journal
//! remembers longer, and spares sending.

use std::collections::BTreeSet;
use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, IsTerminal, Read, Write};
use std::path::{Path, PathBuf};

use bytes::Bytes;
use clap::Args;
use futures_util::{Stream, StreamExt, stream};
use serde::Serialize;
use serde_json::{Value, json};
use tokio_util::io::ReaderStream;

use super::bar::Bar;
use super::content::{Opened, is_standard, shown};
use super::places::{Place, expand};
use super::target::{Service, Target, TargetArgs, refusal};
use super::{Reading, note, say};
use crate::cli::maintenance::{At, Outcome};
use crate::formats::files;
use crate::formats::json;
use crate::formats::lengths::{FileUnits, unit_of};
use crate::formats::record::{Facts, Placing, Plane};
use crate::formats::summary::FileSummary;
use crate::formats::unit::Unit;
use crate::service::app::idempotency::Retry;
use crate::service::app::{App, ServiceError};
use crate::service::cohorts::catalogue;
use crate::service::cohorts::pseudonyms::SubjectFrom;
use crate::service::cohorts::upload::{Returned, Stored, Treatment};
use crate::service::cohorts::upload_file::add_file;
use crate::service::files::FileFormat;
use crate::service::files::translate::{FileReading, to_add};
use crate::service::shapes::outcome::OnError;

/// Number of bytes read at once.
const BLOCK: usize = 256 << 10;

/// How files of shapes are imported.
#[derive(Debug, Clone, Args)]
pub(in crate::cli) struct ImportArgs {
    /// Cohort that takes the shapes of the files, by id or name. Without it, the file is an export of a whole store
    #[arg(long)]
    pub(in crate::cli) cohort: Option<String>,
    #[command(flatten)]
    target: TargetArgs,
    #[command(flatten)]
    reading: Reading,
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
    /// File that lists what was imported: files in it are not sent again
    #[arg(long, requires = "cohort", value_name = "FILE")]
    journal: Option<PathBuf>,
    /// Print a line of JSON for each file
    #[arg(long, requires = "cohort")]
    json: bool,
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

impl ImportArgs {
    /// Refuses options of files of shapes for the import of a whole store.
    ///
    /// # Errors
    /// An option that needs a cohort.
    pub(in crate::cli) fn check_store(&self) -> Result<(), String> {
        match self.reading.is_usual() {
            true => Ok(()),
            false => Err("expected --cohort beside --from and --option, got none".into()),
        }
    }
}

fn subject_from(word: &str) -> Result<SubjectFrom, String> {
    json::from_value(&word.into()).map_err(|_| "expected PatientID".into())
}

fn plane(word: &str) -> Result<Plane, String> {
    json::from_value(&word.into()).map_err(|_| "expected xy, xz or yz".into())
}

/// What became of a file.
#[derive(Debug, Serialize)]
struct Line {
    file: String,
    #[serde(flatten)]
    fate: Fate,
}

#[derive(Debug, Serialize)]
#[serde(tag = "status", rename_all = "snake_case")]
enum Fate {
    /// Its shapes are stored.
    Imported { added: u64, unchanged: u64, skipped: u64, revision: u64, summary: Box<FileSummary> },
    /// It was imported before.
    Known,
    /// A file of a folder that has no known format.
    LeftOut { error: String },
    /// Nothing of it is stored.
    Refused { error: String },
}

/// Imports the files.
///
/// # Errors
/// Reason why none of them is stored, in one sentence.
pub(in crate::cli) async fn run(files: &[PathBuf], args: ImportArgs, at: At) -> Result<Outcome, String> {
    let places = expand(files)?;
    let cohort = args.cohort.clone().unwrap_or_default();
    // Faults of options are found before anything is sent.
    args.reading.options()?;
    super::pairs(&args.facts.labels)?;
    let stated = args.reading.format()?;
    let target = args.target.clone().open(at).await?;
    let mut journal = args.journal.as_deref().map(Journal::open).transpose()?;
    let progress = Progress::new(&places, args.json);
    let import = Import { args: &args, cohort, stated, target, progress };
    let (mut stored, mut refused) = (0_u64, 0_u64);
    for place in &places {
        let fate = import.one(place, journal.as_mut()).await?;
        match &fate {
            Fate::Refused { .. } => refused += 1,
            Fate::Imported { skipped, .. } => {
                stored += 1;
                refused += u64::from(*skipped > 0);
            }
            Fate::Known => stored += 1,
            Fate::LeftOut { .. } => {}
        }
        import.progress.tell(&Line { file: shown(&place.path), fate })?;
    }
    import.progress.end();
    if let Target::Store(app) = &import.target {
        app.store.close().await;
    }
    match (stored, refused) {
        (_, 0) => Ok(Outcome::Done),
        (0, _) => Err("nothing is imported".into()),
        _ => Ok(Outcome::Findings),
    }
}

/// An import of several files.
struct Import<'a> {
    args: &'a ImportArgs,
    cohort: String,
    stated: Option<FileFormat>,
    target: Target,
    progress: Progress,
}

impl Import<'_> {
    /// Imports one file.
    ///
    /// # Errors
    /// What would refuse all files: a service that does not answer, a journal that cannot be written.
    async fn one(&self, place: &Place, journal: Option<&mut Journal>) -> Result<Fate, String> {
        let path = &place.path;
        let refused = |error: String| Ok(Fate::Refused { error });
        let (format, content) = match Opened::new(path, self.stated, &self.args.reading.options()?) {
            Ok(Opened { format, packed, .. }) => (format, Content { path, packed }),
            Err(error) if place.in_folder => return Ok(Fate::LeftOut { error: error.to_string() }),
            Err(error) => return refused(error.to_string()),
        };
        self.progress.grow(path, &content);
        let query = self.query(path, format);
        let read = content.reader().and_then(|reader| digest(reader, &self.cohort, &query));
        let digest = match read {
            Ok(digest) => digest,
            Err(error) => return refused(error.to_string()),
        };
        if journal.as_ref().is_some_and(|journal| journal.known.contains(&digest)) {
            self.progress.pass(&content);
            return Ok(Fate::Known);
        }
        let fate = match &self.target {
            Target::Service(service) => self.send(service, &content, &query, &digest).await?,
            Target::Store(app) => self.store(app, &content, format, &query, &digest).await?,
        };
        if let (Some(journal), Fate::Imported { .. } | Fate::Known) = (journal, &fate) {
            journal.add(&digest, path)?;
        }
        Ok(fate)
    }

    /// Parameters of the request.
    fn query(&self, path: &Path, format: FileFormat) -> Vec<(String, String)> {
        let args = self.args;
        let mut query = vec![("format".to_owned(), format.id().to_owned())];
        let pairs = super::pairs(&args.reading.options).unwrap_or_default();
        query.extend(pairs.into_iter().map(|(name, value)| (name.to_owned(), value.to_owned())));
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
        for (name, value) in super::pairs(labels).unwrap_or_default() {
            add(&format!("labels.{name}"), Some(value.to_owned()));
        }
        add("unit", args.unit.map(|unit| unit.word().to_owned()));
        add("on_error", args.skip_invalid.then(|| "skip".to_owned()));
        add("return", Some("none".into()));
        query
    }

    /// Sends a file to a service.
    async fn send(
        &self,
        service: &Service,
        content: &Content<'_>,
        query: &[(String, String)],
        digest: &str,
    ) -> Result<Fate, String> {
        let request =
            service.request(reqwest::Method::POST, &["v1", "cohorts", &self.cohort, "shapes"], query)?;
        let stream = match self.stream(content).await {
            Ok(stream) => stream,
            Err(error) => return Ok(Fate::Refused { error: error.to_string() }),
        };
        let request = Service::with_file(request, reqwest::Body::wrap_stream(stream));
        let request = request.header("idempotency-key", format!("import-{digest}"));
        let response =
            request.send().await.map_err(|error| format!("the service does not answer: {error}"))?;
        match response.status().as_u16() {
            201 if REPLAYED.iter().any(|name| response.headers().contains_key(*name)) => Ok(Fate::Known),
            201 => {
                let answer: Value = response.json().await.map_err(|error| error.to_string())?;
                let count = |name: &str| answer[name].as_u64().unwrap_or_default();
                let summary = json::from_value(&answer["file"]).unwrap_or_default();
                let (added, skipped, revision) = (count("added"), count("skipped"), count("revision"));
                let unchanged = count("unchanged");
                Ok(Fate::Imported { added, unchanged, skipped, revision, summary: Box::new(summary) })
            }
            // These would refuse every file.
            401 | 403 | 404 => Err(refusal(response).await),
            _ => Ok(Fate::Refused { error: refusal(response).await }),
        }
    }

    /// Adds a file to a store.
    async fn store(
        &self,
        app: &App,
        content: &Content<'_>,
        format: FileFormat,
        query: &[(String, String)],
        digest: &str,
    ) -> Result<Fate, String> {
        let refused = |error: String| Ok(Fate::Refused { error });
        let value =
            |name: &str| query.iter().find(|(found, _)| found == name).map(|(_, value)| value.clone());
        let placing = Placing {
            plane: self.args.plane,
            samples: self.args.samples.map(usize::from),
            prefix: value("prefix"),
            unit: self.args.unit,
            name: value("name"),
            facts: self.facts(value("subject"))?,
            metadata_bytes: app.limits.metadata_bytes,
            ..Placing::default()
        };
        let (name, options) = (value("name"), self.args.reading.options()?);
        let reading = FileReading { format: Some(format), name, options };
        let on_error = if self.args.skip_invalid { OnError::Skip } else { OnError::Abort };
        let file = to_add(reading, placing, (on_error, self.args.facts.subject_from), &app.limits);
        let treatment =
            Treatment { on_error, conflicts: on_error, returned: Returned::None, ..Treatment::default() };
        let retry =
            Retry::new(&format!("import-{digest}"), "shapelex import").map_err(|error| error.to_string())?;
        let app =
            app.clone().with_retry(Some(retry)).noting(crate::service::app::touched::Touched::default());
        let cohort = catalogue::find(&app, &self.cohort).await.map_err(|error| error.to_string())?;
        let stream = match self.stream(content).await {
            Ok(stream) => {
                stream.map(|bytes| bytes.map_err(|error| ServiceError::Interrupted(error.to_string())))
            }
            Err(error) => return refused(error.to_string()),
        };
        match add_file(&app, cohort, stream, file, treatment, None).await {
            Ok(_) if app.touched.is_repeat() => Ok(Fate::Known),
            Ok(Stored { added, unchanged, skipped, revision, note, .. }) => {
                let summary = note.and_then(|note| json::from_value(&note).ok()).unwrap_or_default();
                let (added, unchanged, skipped) = (added as u64, unchanged as u64, skipped as u64);
                Ok(Fate::Imported { added, unchanged, skipped, revision, summary: Box::new(summary) })
            }
            Err(error) => refused(sentence(&error)),
        }
    }

    /// Facts of all shapes of a file.
    fn facts(&self, subject: Option<String>) -> Result<Facts, String> {
        let FactsArgs { label, labels, weight, .. } = &self.args.facts;
        let mut facts = Facts { subject, label: label.clone(), weight: *weight, ..Facts::default() };
        super::pairs(labels)?.into_iter().for_each(|(name, value)| facts.add(name, value));
        Ok(facts)
    }

    /// The bytes of a file, counted by the progress bar.
    async fn stream(
        &self,
        content: &Content<'_>,
    ) -> std::io::Result<impl Stream<Item = std::io::Result<Bytes>> + Send + 'static> {
        let bar = self.progress.bar.clone();
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

/// Header of the answer to a request that was executed before, and its former name, which older services write.
pub(in crate::cli) const REPLAYED: [&str; 2] = ["idempotency-replayed", "idempotent-replayed"];

/// A refusal with the place of its first fault.
fn sentence(error: &ServiceError) -> String {
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
struct Content<'p> {
    path: &'p Path,
    packed: Option<Bytes>,
}

impl Content<'_> {
    /// Number of bytes.
    fn len(&self) -> u64 {
        let of_file = || std::fs::metadata(self.path).map_or(0, |metadata| metadata.len());
        self.packed.as_ref().map_or_else(of_file, |bytes| bytes.len() as u64)
    }

    fn reader(&self) -> std::io::Result<Box<dyn Read>> {
        Ok(match &self.packed {
            Some(bytes) => Box::new(std::io::Cursor::new(bytes.clone())),
            None => Box::new(File::open(self.path)?),
        })
    }
}

/// Digest of a file, its cohort and the options.
fn digest(mut file: impl Read, cohort: &str, query: &[(String, String)]) -> std::io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    for text in [cohort].into_iter().chain(query.iter().flat_map(|(name, value)| [name.as_str(), value])) {
        hasher.update(&(text.len() as u64).to_le_bytes()).update(text.as_bytes());
    }
    let mut block = vec![0; BLOCK];
    loop {
        match file.read(&mut block)? {
            0 => return Ok(hasher.finalize().to_hex().to_string()),
            count => hasher.update(&block[..count]),
        };
    }
}

/// What was imported, a line of JSON for each file.
struct Journal {
    known: BTreeSet<String>,
    file: File,
    path: PathBuf,
}

impl Journal {
    fn open(path: &Path) -> Result<Self, String> {
        let failed = |error: std::io::Error| format!("{}: {error}", path.display());
        let file = OpenOptions::new().read(true).append(true).create(true).open(path).map_err(failed)?;
        let mut known = BTreeSet::new();
        for line in BufReader::new(&file).lines() {
            let line = line.map_err(failed)?;
            // The last line of a process that was killed may be incomplete.
            let entry: Value = serde_json::from_str(&line).unwrap_or_default();
            known.extend(entry["digest"].as_str().map(str::to_owned));
        }
        Ok(Self { known, file, path: path.to_owned() })
    }

    fn add(&mut self, digest: &str, path: &Path) -> Result<(), String> {
        let line = json!({"digest": digest, "file": path.display().to_string()});
        let written = writeln!(self.file, "{line}").and_then(|()| self.file.sync_data());
        self.known.insert(digest.to_owned());
        written.map_err(|error| format!("{}: {error}", self.path.display()))
    }
}

/// A bar on a terminal, lines elsewhere.
struct Progress {
    bar: Option<Bar>,
    json: bool,
}

impl Progress {
    fn new(places: &[Place], json: bool) -> Self {
        let sizes = places.iter().filter_map(|place| std::fs::metadata(&place.path).ok());
        let total = sizes.map(|metadata| metadata.len()).sum();
        let bar = (std::io::stderr().is_terminal() && !json).then(|| Bar::new(total));
        Self { bar, json }
    }

    /// Counts what is sent with a file beside it.
    fn grow(&self, path: &Path, content: &Content<'_>) {
        if let (Some(bar), Ok(metadata)) = (&self.bar, std::fs::metadata(path)) {
            bar.grow(content.len().saturating_sub(metadata.len()));
        }
    }

    /// Counts a file that is not sent.
    fn pass(&self, content: &Content<'_>) {
        if let Some(bar) = &self.bar {
            bar.pass(content.len());
        }
    }

    fn tell(&self, line: &Line) -> Result<(), String> {
        if self.json {
            say(&serde_json::to_string(line).map_err(|error| error.to_string())?);
            return Ok(());
        }
        let text = words(line);
        match &self.bar {
            Some(bar) => bar.tell(&text),
            None => note(&text),
        }
        Ok(())
    }

    fn end(&self) {
        if let Some(bar) = &self.bar {
            bar.end();
        }
    }
}

/// What became of a file in words.
fn words(Line { file, fate }: &Line) -> String {
    match fate {
        Fate::Known => format!("{file}: imported before"),
        Fate::LeftOut { error } => format!("{file}: left out: {error}"),
        Fate::Refused { error } => format!("{file}: refused: {error}"),
        Fate::Imported { added, unchanged, skipped, summary, .. } => {
            let mut parts = vec![format!("{file}: {added} shapes added")];
            if *unchanged > 0 {
                parts.push(format!("{unchanged} were there before"));
            }
            if *skipped > 0 {
                parts.push(format!("{skipped} skipped that cannot be stored"));
            }
            parts
                .extend(summary.left_out.iter().map(|left| format!("{} {} left out", left.count, left.what)));
            parts.extend(summary.units.as_ref().and_then(FileUnits::sentence));
            parts.extend(summary.warnings.iter().map(|warning| format!("warning: {warning}")));
            parts.join("; ")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digests_are_of_content_cohort_and_options() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            path
        };
        let (a, b, c) = (path("a", "x"), path("b", "x"), path("c", "y"));
        let query = |text: &str| vec![("format".to_owned(), text.to_owned())];
        let of = |path: &Path, cohort: &str, text: &str| {
            digest(File::open(path).unwrap(), cohort, &query(text)).unwrap()
        };
        assert_eq!(of(&a, "one", "tps"), of(&b, "one", "tps"));
        for other in [of(&c, "one", "tps"), of(&a, "two", "tps"), of(&a, "one", "nts")] {
            assert_ne!(other, of(&a, "one", "tps"));
        }
    }

    #[test]
    fn a_journal_survives_an_incomplete_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        let mut journal = Journal::open(&path).unwrap();
        journal.add("d1", Path::new("a.tps")).unwrap();
        std::fs::write(&path, std::fs::read_to_string(&path).unwrap() + "{\"digest\": \"d2").unwrap();
        let journal = Journal::open(&path).unwrap();
        assert_eq!(journal.known.iter().collect::<Vec<_>>(), ["d1"]);
    }
}
