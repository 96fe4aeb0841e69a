//! Maintenance commands for operators: check, back up, restore, migrate, export, import, silence, compact, erasures.

use std::fs::{self, File, OpenOptions};
use std::io::{BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

use clap::Subcommand;

mod erasures;

use super::at::{At, Outcome};
use super::files;
use super::files::export::ExportArgs;
use super::files::import::ImportArgs;
use crate::service::app::{clock, now_ms};
use crate::store::maintenance::{self, Checked, MaintenanceError, Site};
use crate::store::{Store, StoreError};

/// Number of PostgreSQL connections of an import.
const CONNECTIONS: u32 = 4;
/// Buffer size in bytes for reading and writing files.
const BUFFER: usize = 1 << 20;

/// Maintenance commands of a store.
#[derive(Debug, Subcommand)]
pub(super) enum Maintenance {
    /// Verify the whole store, even while the service runs; exits with 1 if there are findings
    Check(At),
    /// Copy the embedded store to a new file, even while the service runs
    Backup {
        /// File to write; it must not exist
        file: PathBuf,
        #[command(flatten)]
        at: At,
    },
    /// Create an embedded store from a backup, in an empty folder
    Restore {
        /// File written by `backup`
        file: PathBuf,
        /// Folder of the embedded store, created if missing
        #[arg(long, env = "SHAPELEX_DATA_DIR", default_value = "shapelex-data")]
        data_dir: PathBuf,
        /// Leave active hooks active: this copy takes the place of the store
        #[arg(long)]
        resume_hooks: bool,
    },
    /// Make a copy that was made by other means silent, as `restore` does: its active hooks are paused, and its deliveries get other ids
    Silence(At),
    /// Write the files of the store anew, so that they hold no copies of erased rows; others wait meanwhile
    Compact(At),
    /// List the subjects that were erased, as digests, or erase them in a store that was restored
    Erasures {
        /// Erase the subjects of this list, which `erasures` wrote; `-` is standard input. The service must not be running
        #[arg(long, value_name = "FILE")]
        repeat: Option<PathBuf>,
        #[command(flatten)]
        at: At,
    },
    /// Upgrade the schema of the store, as the start of the service does
    Migrate {
        /// Only report whether the schema is up to date; exits with 1 if it is not
        #[arg(long)]
        check: bool,
        #[command(flatten)]
        at: At,
    },
    /// Write everything as lines that any store can import, or the shapes of a cohort as a file, even while the service runs
    Export {
        /// File to write, which must not exist; `-` is standard output
        file: PathBuf,
        #[command(flatten)]
        shapes: Box<ExportArgs>,
        #[command(flatten)]
        at: At,
    },
    /// Accept the clock of this machine as correct, even while the service runs, so that expired data may be removed again
    ConfirmClock(At),
    /// Take files of shapes into a cohort, or read an export into an empty store, all or nothing
    ///
    /// With a cohort: exits with 1 if some files or shapes are refused.
    Import {
        /// File written by `export`, `-` is standard input; with a cohort: files, folders with all files in them, and patterns
        #[arg(required = true)]
        files: Vec<PathBuf>,
        #[command(flatten)]
        shapes: Box<ImportArgs>,
        /// Leave active hooks active: the store takes the place of the exported one
        #[arg(long, conflicts_with = "cohort")]
        resume_hooks: bool,
        #[command(flatten)]
        at: At,
    },
}

/// Executes the command, and reports on standard output.
///
/// # Errors
/// Reason for the failure, in one sentence.
pub(super) async fn run(command: Maintenance) -> Result<Outcome, String> {
    let done = match command {
        Maintenance::Check(at) => check(&at.site()?).await,
        Maintenance::Backup { file, at } => back_up(&file, &at.site()?).await,
        Maintenance::Restore { file, data_dir, resume_hooks } => {
            restore(&file, &data_dir, resume_hooks).await
        }
        Maintenance::Silence(at) => silence(&at.site()?).await,
        Maintenance::Compact(at) => compact(&at.site()?).await,
        Maintenance::Erasures { repeat: None, at } => erasures::list(&at.site()?).await,
        Maintenance::Erasures { repeat: Some(file), at } => erasures::repeat(&file, &at.site()?).await,
        Maintenance::Migrate { check: true, at } => versions(&at.site()?).await,
        Maintenance::Migrate { check: false, at } => migrate(&at.site()?).await,
        Maintenance::ConfirmClock(at) => confirm_clock(&at.site()?).await,
        Maintenance::Export { file, shapes, at } if shapes.cohort.is_some() => {
            return files::export::run(&file, *shapes, at).await;
        }
        Maintenance::Import { files, shapes, at, .. } if shapes.cohort.is_some() => {
            return files::import::run(&files, *shapes, at).await;
        }
        Maintenance::Export { file, shapes, at } => {
            shapes.check_store()?;
            export(&file, &at.site()?).await
        }
        Maintenance::Import { files, shapes, resume_hooks, at } => match files.as_slice() {
            [file] => {
                shapes.check_store()?;
                import(file, &at.site()?, resume_hooks).await
            }
            _ => return Err("expected one file written by export, or a cohort for files of shapes".into()),
        },
    };
    done.map_err(|error| sentence(&error))
}

async fn check(site: &Site) -> Result<Outcome, MaintenanceError> {
    let store = match Store::inspect(site).await {
        Err(MaintenanceError::Store(error @ StoreError::Older { .. })) => {
            say(&error.to_string());
            say("stopped reading the store: 1 finding");
            return Ok(Outcome::Findings);
        }
        // The store is too damaged to open.
        Err(MaintenanceError::Store(StoreError::Damaged { detail })) => {
            say(&detail);
            say("the rest of the store cannot be read: 1 finding");
            return Ok(Outcome::Findings);
        }
        store => store?,
    };
    let checked = store.check(&mut say).await?;
    store.close().await;
    say(&summary(&checked));
    Ok(if checked.findings == 0 { Outcome::Done } else { Outcome::Findings })
}

fn summary(checked: &Checked) -> String {
    let Checked { cohorts, chunks, shapes, dictionaries, jobs, outputs, receipts, audit, findings } = checked;
    let findings = match findings {
        0 => "no findings".to_owned(),
        1 => "1 finding".to_owned(),
        many => format!("{many} findings"),
    };
    format!(
        "checked {cohorts} cohorts, {shapes} shapes in {chunks} chunks, {dictionaries} dictionaries, {jobs} jobs, \
         {outputs} outputs, {receipts} receipts, {audit} entries of the audit trail: {findings}"
    )
}

async fn back_up(file: &Path, site: &Site) -> Result<Outcome, MaintenanceError> {
    let store = Store::inspect(site).await?;
    let bytes = store.back_up(file).await?;
    store.close().await;
    say(&format!("backed up to {}, {bytes} bytes", file.display()));
    Ok(Outcome::Done)
}

async fn restore(file: &Path, data_dir: &Path, resume: bool) -> Result<Outcome, MaintenanceError> {
    let restored = maintenance::restore(file, data_dir, resume, &mut say).await?;
    match restored.checked {
        Some(checked) => say(&summary(&checked)),
        None => say("the backup has the schema of an older version: only its file was checked"),
    }
    say(&format!("restored into {}", data_dir.display()));
    say_paused(restored.paused);
    Ok(Outcome::Done)
}

/// Tells how many hooks of a copy are paused, if any.
fn say_paused(hooks: u64) {
    if hooks > 0 {
        say(&format!(
            "{hooks} hooks are paused: POST /v1/hooks/{{hook}}/resume once this store is the one that delivers"
        ));
    }
}

async fn silence(site: &Site) -> Result<Outcome, MaintenanceError> {
    let store = Store::inspect(site).await?;
    let paused = store.silence().await?;
    store.close().await;
    say("the store is a copy with an id");
    say_paused(paused);
    Ok(Outcome::Done)
}

async fn compact(site: &Site) -> Result<Outcome, MaintenanceError> {
    let store = Store::inspect(site).await?;
    let erasures = store.compact(now_ms()).await?;
    store.close().await;
    say(&format!("the files are written anew, and hold nothing of {erasures} more erasures"));
    Ok(Outcome::Done)
}

async fn versions(site: &Site) -> Result<Outcome, MaintenanceError> {
    let versions = maintenance::versions(site).await?;
    if versions.found == versions.known {
        say(&format!("the schema is up to date: version {}", versions.found));
        return Ok(Outcome::Done);
    }
    say(&format!("the schema has version {}, this program needs {}", versions.found, versions.known));
    Ok(Outcome::Findings)
}

async fn migrate(site: &Site) -> Result<Outcome, MaintenanceError> {
    let versions = maintenance::migrate(site).await?;
    match versions.found {
        0 => say(&format!("a new store with schema version {}", versions.known)),
        found if found == versions.known => say(&format!("the schema is up to date: version {found}")),
        found => say(&format!("the schema went from version {found} to {}", versions.known)),
    }
    Ok(Outcome::Done)
}

async fn export(file: &Path, site: &Site) -> Result<Outcome, MaintenanceError> {
    if file.exists() {
        return Err(MaintenanceError::Exists(file.to_path_buf()));
    }
    let store = Store::inspect(site).await?;
    if is_standard(file) {
        store.export(&mut BufWriter::with_capacity(BUFFER, std::io::stdout())).await?;
        store.close().await;
        return Ok(Outcome::Done);
    }
    let partial = PathBuf::from(format!("{}.partial", file.display()));
    let exported = export_to(&store, &partial).await;
    let rows = match exported {
        Ok(rows) => rows,
        Err(error) => {
            // If removal fails, the name of the remaining file marks it as partial.
            let _ = fs::remove_file(&partial);
            return Err(error);
        }
    };
    fs::rename(&partial, file).map_err(|source| MaintenanceError::File { path: file.into(), source })?;
    store.close().await;
    say(&format!("exported {rows} rows to {}", file.display()));
    Ok(Outcome::Done)
}

/// Writes the export and syncs it to disk.
async fn export_to(store: &Store, file: &Path) -> Result<u64, MaintenanceError> {
    let failed = |source| MaintenanceError::File { path: file.to_path_buf(), source };
    let mut options = OpenOptions::new();
    options.write(true).create(true).truncate(true);
    // The export contains all data, so only its owner may read it.
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut out = BufWriter::with_capacity(BUFFER, options.open(file).map_err(failed)?);
    let rows = store.export(&mut out).await?;
    out.flush().map_err(failed)?;
    out.get_ref().sync_all().map_err(failed)?;
    Ok(rows)
}

async fn import(file: &Path, site: &Site, resume: bool) -> Result<Outcome, MaintenanceError> {
    let failed = |source| MaintenanceError::File { path: file.to_path_buf(), source };
    // Opened before the store is created, so that a wrong name leaves nothing behind.
    let input = if is_standard(file) { None } else { Some(File::open(file).map_err(failed)?) };
    let store = open(site).await?;
    let imported = match input {
        Some(input) => store.import(&mut BufReader::with_capacity(BUFFER, input), resume).await,
        None => store.import(&mut BufReader::with_capacity(BUFFER, std::io::stdin()), resume).await,
    };
    store.close().await;
    let (rows, paused) = imported?;
    say(&format!("imported {rows} rows"));
    say_paused(paused);
    Ok(Outcome::Done)
}

/// Opens the store as the service does.
async fn open(site: &Site) -> Result<Store, StoreError> {
    match site {
        Site::Folder(folder) => Store::open(folder).await,
        Site::Url(url) => Store::connect(url, CONNECTIONS).await,
    }
}

async fn confirm_clock(site: &Site) -> Result<Outcome, MaintenanceError> {
    let store = Store::inspect(site).await?;
    let shows = clock::confirm(&store).await?;
    store.close().await;
    say(&format!("the clock is trusted: it shows {shows}"));
    Ok(Outcome::Done)
}

fn is_standard(file: &Path) -> bool {
    file == Path::new("-")
}

/// The error with its source.
fn sentence(error: &MaintenanceError) -> String {
    match std::error::Error::source(error) {
        // The message of a system error is already part of the sentence.
        Some(source) if !source.is::<std::io::Error>() => format!("{error}: {source}"),
        _ => error.to_string(),
    }
}

fn say(line: &str) {
    #[allow(clippy::print_stdout, reason = "the answer is what was asked for")]
    {
        println!("{line}");
    }
}
