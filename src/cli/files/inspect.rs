//! `shapelex inspect`: tells what is in files of shapes.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::content::{Opened, shown};
use super::places::{Place, expand};
use super::{Reading, own_limits, say};
use crate::cli::maintenance::Outcome;
use crate::formats::files::{FileError, Group, Inspected, Inspection, ReadOptions, Summary};
use crate::formats::record::count_unstored;
use crate::formats::summary::left_out;
use crate::service::files::FileFormat;

/// Number of names in a line for people.
const NAMED: usize = 5;

#[derive(Debug, Args)]
pub(in crate::cli) struct InspectArgs {
    /// Files, folders with all files in them, and patterns; `-` is standard input
    #[arg(required = true)]
    files: Vec<PathBuf>,
    #[command(flatten)]
    reading: Reading,
    /// Print a line of JSON for each file
    #[arg(long)]
    json: bool,
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
pub(super) fn run(args: &InspectArgs) -> Result<Outcome, String> {
    let (options, stated) = (args.reading.options()?, args.reading.format()?);
    let (mut read, mut refused) = (0_u64, 0_u64);
    for Place { path, .. } in expand(&args.files)? {
        let inspected = Opened::new(&path, stated, &options).and_then(|opened| inspect(opened, &options));
        match &inspected {
            Ok(_) => read += 1,
            Err(_) => refused += 1,
        }
        let file = shown(&path);
        if args.json {
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
