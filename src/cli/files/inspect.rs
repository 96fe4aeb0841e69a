//! `shapelex inspect`: tells the content of files of shapes.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::adding::AddingArgs;
use super::content::{Opened, shown};
use super::outlook::{Outlook, look};
use super::places::{Place, expand};
use super::target::Target;
use super::{Reading, own_limits, say};
use crate::cli::at::{At, Outcome};
use crate::cli::runtime::runtime;
use crate::service::files::FileFormat;
use crate::wire::files::{FileError, Group, Inspected, Inspection, ReadOptions, Summary};
use crate::wire::record::count_unstored;
use crate::wire::summary::left_out;

/// Number of names in a line for people.
const NAMED: usize = 5;

#[derive(Debug, Args)]
pub(in crate::cli) struct InspectArgs {
    /// Files, folders with all files in them, and patterns; `-` is standard input
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Cohort, by id or name, against which the files are looked at: what `import` would do with the same options. Nothing is stored
    #[arg(long)]
    cohort: Option<String>,
    #[command(flatten)]
    adding: AddingArgs,
    /// Print a line of JSON for each file
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    at: At,
}

/// A line of the answer.
#[derive(Debug, Serialize)]
struct Line {
    file: String,
    #[serde(flatten)]
    inspected: Option<Inspected>,
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<String>,
}

/// Describes the files.
pub(super) fn run(args: InspectArgs) -> Result<Outcome, String> {
    let InspectArgs { files, cohort, adding, json, at } = args;
    match cohort {
        None => describe(&files, &adding.reading, json),
        Some(cohort) => runtime()?.block_on(look_at(&files, &adding, cohort, at, json)),
    }
}

/// Tells which content of the files a cohort would take.
async fn look_at(
    files: &[PathBuf],
    args: &AddingArgs,
    cohort: String,
    at: At,
    json: bool,
) -> Result<Outcome, String> {
    let adding = args.open(cohort, at).await?;
    let (mut accepted, mut findings) = (0_u64, 0_u64);
    for Place { path, in_folder } in expand(files)? {
        let file = shown(&path);
        let looked = match adding.content(&path) {
            // A file of a folder that has no known format.
            Err(error) if in_folder => Err(error.to_string()),
            Err(error) => {
                findings += 1;
                Err(error.to_string())
            }
            Ok((format, content)) => {
                let looked = look(&adding, &content, format, &adding.query(&path, format)).await?;
                accepted += u64::from(looked.as_ref().is_ok_and(Outlook::is_accepted));
                findings += u64::from(looked.as_ref().map_or(true, Outlook::has_findings));
                looked
            }
        };
        match (json, looked) {
            (true, looked) => say(&line(&file, looked)?),
            (false, Ok(outlook)) => outlook.lines(&file).iter().for_each(|line| say(line)),
            (false, Err(error)) => say(&format!("{file}: {error}")),
        }
    }
    if let Target::Store(app) = &adding.target {
        app.store.close().await;
    }
    match (accepted, findings) {
        (_, 0) => Ok(Outcome::Done),
        (0, _) => Err("the cohort would take none of the files".into()),
        _ => Ok(Outcome::Findings),
    }
}

/// A line of JSON.
fn line(file: &str, looked: Result<Outlook, String>) -> Result<String, String> {
    let line = match looked {
        Ok(outlook) => serde_json::to_value(outlook).map_err(|error| error.to_string())?,
        Err(error) => serde_json::json!({"error": error}),
    };
    let mut named = serde_json::json!({"file": file});
    if let (Some(named), serde_json::Value::Object(line)) = (named.as_object_mut(), line) {
        named.extend(line);
    }
    Ok(named.to_string())
}

/// Describes files by themselves.
fn describe(files: &[PathBuf], reading: &Reading, json: bool) -> Result<Outcome, String> {
    let (options, stated) = (reading.options()?, reading.format()?);
    let (mut read, mut refused) = (0_u64, 0_u64);
    for Place { path, .. } in expand(files)? {
        let inspected = Opened::new(&path, stated, &options).and_then(|opened| inspect(opened, &options));
        match &inspected {
            Ok(_) => read += 1,
            Err(_) => refused += 1,
        }
        let file = shown(&path);
        if json {
            let (inspected, error) = match inspected {
                Ok(inspected) => (Some(inspected), None),
                Err(error) => (None, Some(error.to_string())),
            };
            say(&serde_json::to_string(&Line { file, inspected, error })
                .map_err(|error| error.to_string())?);
        } else {
            match inspected {
                Ok(inspected) => lines(&file, &inspected).iter().for_each(|line| say(line)),
                Err(error) => say(&format!("{file}: {error}")),
            }
        }
    }
    match (read, refused) {
        (_, 0) => Ok(Outcome::Done),
        (0, _) => Err("none of the files can be read".into()),
        _ => Ok(Outcome::Findings),
    }
}

fn inspect(mut opened: Opened, options: &ReadOptions) -> Result<Inspected, FileError> {
    let mut found = Inspection::default();
    let mut unstored = Summary::default();
    let mut add = |record| {
        found.add(&record);
        count_unstored(&record, None, &mut unstored);
        Ok(())
    };
    let format = opened.format;
    let mut summary = format.read(&mut opened.source, options, &own_limits(), &|| false, &mut add)?;
    summary.dropped.append(&mut unstored.dropped);
    Ok(Inspected { format: format.id(), summary, found })
}

/// A file in words.
fn lines(file: &str, inspected: &Inspected) -> Vec<String> {
    let Inspected { format, summary, found } = inspected;
    let name = FileFormat::find(format).map_or(*format, FileFormat::name);
    let mut lines = vec![format!("{file}: {name}, {} shapes", summary.records)];
    lines.extend(found.groups.iter().map(group));
    for (what, counts) in [("labels", &found.labels), ("attributes", &found.attributes)] {
        if !counts.is_empty() {
            let counts = counts.iter().map(|(name, count)| format!("{name} ({count})"));
            lines.push(format!("  {what}: {}", counts.collect::<Vec<_>>().join(", ")));
        }
    }
    lines.extend(summary.properties.iter().map(|(name, value)| format!("  {name}: {value}")));
    lines.extend(left_out(summary));
    lines
}

fn group(group: &Group) -> String {
    let range = |[least, most]: [usize; 2], what: &str| match least == most {
        true => format!("{most} {what}"),
        false => format!("{least} to {most} {what}"),
    };
    let unit = if group.kind.name() == "fourier" { "harmonics" } else { "points" };
    let mut parts = vec![range(group.points, unit)];
    if group.faces[1] > 0 {
        parts.push(range(group.faces, "faces"));
    }
    for (count, what) in [(group.closed, "closed"), (group.holes, "holes"), (group.incomplete, "incomplete")]
    {
        if count > 0 {
            parts.push(format!("{count} {what}"));
        }
    }
    if !group.lower.is_empty() {
        parts.push(format!("between {:?} and {:?}", group.lower, group.upper));
    }
    if !group.names.is_empty() {
        let more = if group.records > NAMED as u64 { ", …" } else { "" };
        let names = &group.names[..group.names.len().min(NAMED)];
        parts.push(format!("{}{more}", names.join(", ")));
    }
    format!(
        "  {} × {} in {} dimensions: {}",
        group.records,
        group.kind.name(),
        group.dimension,
        parts.join("; ")
    )
}
