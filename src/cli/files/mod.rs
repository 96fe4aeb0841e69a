//! Commands for files of shapes: translate and describe them here, take them into a cohort, write a cohort as one.
//!
//! Exit code 0 if all is done, 1 if some of it was refused, 2 if nothing could be done.

mod adding;
mod bar;
mod content;
mod convert;
pub(super) mod export;
pub(super) mod import;
mod inspect;
mod outlook;
mod places;
mod target;

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand, ValueEnum};

use super::at::Outcome;
use crate::service::files::{FileFormat, unknown_format};
use crate::wire::dicom;
use crate::wire::files::{Format, Limits, ReadOptions, WriteOptions};

/// Commands for files that need no service and no store.
#[derive(Debug, Subcommand)]
pub(super) enum FileCommand {
    /// Translate a file of shapes to another format
    Convert(convert::ConvertArgs),
    /// Tell what is in files of shapes, or what a cohort would take of them; exits with 1 if some cannot be read, or would be refused
    Inspect(Box<inspect::InspectArgs>),
}

/// How files are read.
#[derive(Debug, Clone, Args)]
pub(super) struct Reading {
    /// Format of the files, as an id, a media type or an ending. Default: by content, else by name
    #[arg(long, value_name = "FORMAT")]
    from: Option<String>,
    /// Option of reading, such as `select=lung*` or `holes=keep`; may be repeated
    #[arg(long = "option", value_name = "NAME=VALUE")]
    options: Vec<String>,
}

impl Reading {
    /// Whether nothing is said of the files.
    fn is_usual(&self) -> bool {
        self.from.is_none() && self.options.is_empty()
    }

    /// The options.
    fn options(&self) -> Result<ReadOptions, String> {
        let pairs = pairs(&self.options)?;
        ReadOptions::from_pairs(pairs).map_err(|error| error.to_string())
    }

    /// The format that is stated, if one is.
    fn format(&self) -> Result<Option<FileFormat>, String> {
        let find = |word: &String| FileFormat::find(word).ok_or_else(|| unknown_format(word).to_string());
        self.from.as_ref().map(find).transpose()
    }
}

/// How a file is written.
#[derive(Debug, Clone, Args)]
pub(super) struct Writing {
    /// Option of writing, such as `unit=mm`; may be repeated
    #[arg(long, value_name = "NAME=VALUE")]
    write: Vec<String>,
    /// Image, or folder of images, of the DICOM series that a structure set refers to; may be repeated. Its headers stay here
    #[arg(long, value_name = "FILE")]
    series: Vec<PathBuf>,
    /// What becomes of texts in CSV that spreadsheets would run as formulas: `escape` puts an apostrophe before them
    #[arg(long, value_enum, value_name = "WHAT", default_value_t = Formulas::Keep)]
    formulas: Formulas,
}

/// Treatment of texts in CSV that a spreadsheet would run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Formulas {
    Keep,
    Escape,
}

impl Writing {
    /// Whether nothing is said of the file.
    fn is_usual(&self) -> bool {
        self.write.is_empty() && self.series.is_empty() && self.formulas == Formulas::Keep
    }

    /// Whether formulas are escaped in a file of a format.
    ///
    /// # Errors
    /// A format that is not CSV: its texts are not formulas.
    fn escapes(&self, format: &Format) -> Result<bool, String> {
        match self.formulas {
            Formulas::Keep => Ok(false),
            Formulas::Escape if format.id == "csv" => Ok(true),
            Formulas::Escape => Err(format!("expected --to csv beside --formulas escape, got {}", format.id)),
        }
    }

    /// The options.
    fn options(&self) -> Result<WriteOptions, String> {
        let options = WriteOptions::from_pairs(self.pairs()?).map_err(|error| error.to_string())?;
        let series = series_files(&self.series)?.iter().map(|path| header(path)).collect::<Result<_, _>>()?;
        Ok(WriteOptions { series, ..options })
    }

    /// Names and values of the options that a service takes too.
    fn pairs(&self) -> Result<Vec<(&str, &str)>, String> {
        pairs(&self.write)
    }
}

/// The files of a series: those that are named, and those of folders that are named, in the order of their names.
fn series_files(named: &[PathBuf]) -> Result<Vec<PathBuf>, String> {
    let mut files = Vec::new();
    for path in named {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let failed = |error: std::io::Error| format!("{}: {error}", path.display());
        let entries = std::fs::read_dir(path).map_err(failed)?;
        let mut inside: Vec<PathBuf> =
            entries.map(|entry| entry.map(|entry| entry.path())).collect::<Result<_, _>>().map_err(failed)?;
        inside.retain(|path| path.is_file());
        inside.sort();
        files.append(&mut inside);
    }
    Ok(files)
}

/// The header of an image of a series.
fn header(path: &Path) -> Result<dicom::SeriesImage, String> {
    let failed = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let limit = Limits::default().held as u64;
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(|error| failed(&error))?;
    file.take(limit).read_to_end(&mut bytes).map_err(|error| failed(&error))?;
    dicom::series(&bytes).map_err(|error| failed(&error))
}

/// Names and values of options.
fn pairs(options: &[String]) -> Result<Vec<(&str, &str)>, String> {
    let pair = |text: &'_ String| -> Result<(usize, usize), String> {
        let at = text.find('=').ok_or_else(|| format!("expected an option NAME=VALUE, got '{text}'"))?;
        Ok((at, at + 1))
    };
    options.iter().map(|text| pair(text).map(|(end, start)| (&text[..end], &text[start..]))).collect()
}

/// Limits of shapes of files on this machine: those of the memory are those of [`Limits`].
fn own_limits() -> crate::service::app::Limits {
    let usual = crate::service::app::Limits::default();
    crate::service::app::Limits { samples: usize::MAX, vertices: Limits::default().points, ..usual }
}

/// Executes the command.
///
/// # Errors
/// Reason for the failure, in one sentence.
pub(super) fn run(command: FileCommand) -> Result<Outcome, String> {
    match command {
        FileCommand::Convert(args) => convert::run(&args),
        FileCommand::Inspect(args) => inspect::run(*args),
    }
}

/// Prints a line of an answer.
fn say(line: &str) {
    #[allow(clippy::print_stdout, reason = "the answer is what was asked for")]
    {
        println!("{line}");
    }
}

/// Prints a line beside the answer.
fn note(line: &str) {
    #[allow(clippy::print_stderr, reason = "standard output holds the file")]
    {
        eprintln!("{line}");
    }
}

/// Writes a file that appears under its name only when it is complete.
struct Complete {
    path: PathBuf,
    partial: PathBuf,
}

impl Complete {
    /// A file that does not exist yet.
    fn new(path: &Path) -> Result<(Self, File), String> {
        if path.exists() {
            return Err(format!("{}: expected a new file, got one that already exists", path.display()));
        }
        let partial = PathBuf::from(format!("{}.partial", path.display()));
        let file = File::create(&partial).map_err(|error| format!("{}: {error}", partial.display()))?;
        Ok((Self { path: path.to_owned(), partial }, file))
    }

    /// Gives the file its name, or removes it.
    fn end<T>(self, written: Result<T, String>) -> Result<T, String> {
        let named = written.and_then(|value| {
            let renamed = std::fs::rename(&self.partial, &self.path);
            renamed.map(|()| value).map_err(|error| format!("{}: {error}", self.path.display()))
        });
        if named.is_err() {
            // If removal fails, the name of the remaining file marks it as partial.
            let _ = std::fs::remove_file(&self.partial);
        }
        named
    }
}
