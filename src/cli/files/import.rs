//! `shapelex import FILE… --cohort NAME`: takes files of shapes into a cohort.
//!
//! Each file is one request, stored as a whole or not at all. Its `Idempotency-Key` is the digest of its content, the cohort and the
//! options, among which is the name of the file: a file that was imported within the last seven days is not stored again. A journal
//! remembers longer, and spares sending.

use std::collections::BTreeSet;
use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, IsTerminal, Read, Write};
use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;
use serde_json::{Value, json};

use super::adding::{Adding, AddingArgs, BLOCK, Content, sentence};
use super::bar::Bar;
use super::content::shown;
use super::outlook::{Outlook, look};
use super::places::{Place, expand};
use super::target::{Service, Target, refusal};
use super::{note, say};
use crate::cli::at::{At, Outcome};
use crate::service::app::App;
use crate::service::app::idempotency::Retry;
use crate::service::cohorts::catalogue;
use crate::service::cohorts::upload::Stored;
use crate::service::cohorts::upload_file::add_file;
use crate::service::files::FileFormat;
use crate::wire::json;
use crate::wire::lengths::FileUnits;
use crate::wire::summary::FileSummary;

/// How files of shapes are imported.
#[derive(Debug, Clone, Args)]
pub(in crate::cli) struct ImportArgs {
    /// Cohort that takes the shapes of the files, by id or name. Without it, the file is an export of a whole store
    #[arg(long)]
    pub(in crate::cli) cohort: Option<String>,
    #[command(flatten)]
    adding: AddingArgs,
    /// File that lists what was imported: files in it are not sent again
    #[arg(long, requires = "cohort", value_name = "FILE")]
    journal: Option<PathBuf>,
    /// Tell what would become of the files, and store nothing
    #[arg(long, requires = "cohort")]
    dry_run: bool,
    /// Print a line of JSON for each file
    #[arg(long, requires = "cohort")]
    json: bool,
}

impl ImportArgs {
    /// Refuses options of files of shapes for the import of a whole store.
    ///
    /// # Errors
    /// An option that needs a cohort.
    pub(in crate::cli) fn check_store(&self) -> Result<(), String> {
        self.adding.check_without_cohort()
    }
}

/// Outcome of a file.
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
    /// They would be stored, or not.
    Previewed(Box<Outlook>),
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
    let mut adding = args.adding.open(cohort, at).await?;
    let mut journal = args.journal.as_deref().map(Journal::open).transpose()?;
    let progress = Progress::new(&places, args.json);
    adding.bar.clone_from(&progress.bar);
    let import = Import { adding, dry_run: args.dry_run, progress };
    let (mut stored, mut refused) = (0_u64, 0_u64);
    for place in &places {
        let fate = import.one(place, journal.as_mut()).await?;
        match &fate {
            Fate::Refused { .. } => refused += 1,
            Fate::Imported { skipped, .. } => {
                stored += 1;
                refused += u64::from(*skipped > 0);
            }
            Fate::Previewed(outlook) => {
                stored += u64::from(outlook.is_accepted());
                refused += u64::from(outlook.has_findings());
            }
            Fate::Known => stored += 1,
            Fate::LeftOut { .. } => {}
        }
        import.progress.tell(&Line { file: shown(&place.path), fate })?;
    }
    import.progress.end();
    if let Target::Store(app) = &import.adding.target {
        app.store.close().await;
    }
    match (stored, refused) {
        (_, 0) => Ok(Outcome::Done),
        (0, _) if args.dry_run => Err("nothing would be imported".into()),
        (0, _) => Err("nothing is imported".into()),
        _ => Ok(Outcome::Findings),
    }
}

/// An import of several files.
struct Import<'a> {
    adding: Adding<'a>,
    dry_run: bool,
    progress: Progress,
}

impl Import<'_> {
    /// Imports one file.
    ///
    /// # Errors
    /// Faults that would refuse all files: a service that does not answer, a journal that cannot be written.
    async fn one(&self, place: &Place, journal: Option<&mut Journal>) -> Result<Fate, String> {
        let path = &place.path;
        let refused = |error: String| Ok(Fate::Refused { error });
        let (format, content) = match self.adding.content(path) {
            Ok(found) => found,
            Err(error) if place.in_folder => return Ok(Fate::LeftOut { error: error.to_string() }),
            Err(error) => return refused(error.to_string()),
        };
        self.progress.grow(path, &content);
        let query = self.adding.query(path, format);
        let read = content.reader().and_then(|reader| digest(reader, &self.adding.cohort, &query));
        let digest = match read {
            Ok(digest) => digest,
            Err(error) => return refused(error.to_string()),
        };
        if journal.as_ref().is_some_and(|journal| journal.known.contains(&digest)) {
            self.progress.pass(&content);
            return Ok(Fate::Known);
        }
        if self.dry_run {
            return Ok(match look(&self.adding, &content, format, &query).await? {
                Ok(outlook) => Fate::Previewed(Box::new(outlook)),
                Err(error) => Fate::Refused { error },
            });
        }
        let fate = match &self.adding.target {
            Target::Service(service) => self.send(service, &content, &query, &digest).await?,
            Target::Store(app) => self.store(app, &content, format, &query, &digest).await?,
        };
        if let (Some(journal), Fate::Imported { .. } | Fate::Known) = (journal, &fate) {
            journal.add(&digest, path)?;
        }
        Ok(fate)
    }

    /// Sends a file to a service.
    async fn send(
        &self,
        service: &Service,
        content: &Content<'_>,
        query: &[(String, String)],
        digest: &str,
    ) -> Result<Fate, String> {
        let path = ["v1", "cohorts", &self.adding.cohort, "shapes"];
        let request = service.request(reqwest::Method::POST, &path, query)?;
        let body = match self.adding.body(content).await {
            Ok(body) => body,
            Err(error) => return Ok(Fate::Refused { error: error.to_string() }),
        };
        let request = Service::with_file(request, body);
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
        let (file, treatment) = self.adding.file(app, format, query)?;
        let retry =
            Retry::new(&format!("import-{digest}"), "shapelex import").map_err(|error| error.to_string())?;
        let app =
            app.clone().with_retry(Some(retry)).noting(crate::service::app::touched::Touched::default());
        let cohort = catalogue::find(&app, &self.adding.cohort).await.map_err(|error| error.to_string())?;
        let stream = match self.adding.pieces(content).await {
            Ok(stream) => stream,
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
}

/// Header of the answer to a request that was executed before, and its former name, which older services write.
pub(in crate::cli) const REPLAYED: [&str; 2] = ["idempotency-replayed", "idempotent-replayed"];

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

/// Imported files, a line of JSON for each.
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

    /// Counts the data sent with a file beside it.
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

/// Outcome of a file in words.
fn words(Line { file, fate }: &Line) -> String {
    match fate {
        Fate::Previewed(outlook) => outlook.lines(file).join("\n"),
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
