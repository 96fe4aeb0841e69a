//! Writing of TPS files.

use std::fmt::Write as _;
use std::io::Write;

use serde_json::Value;

use super::super::options::WriteOptions;
use super::super::record::{Geometry, Points, Record};
use super::super::text::{left_out, name_fits, refused, shown, unfit, write_row};
use super::super::write::{Opened, Output, Writer};
use crate::error::FileError;
use crate::summary::Summary;

/// Keys of the metadata that are written.
const KEPT: [&str; 7] = ["image", "comment", "variables", "scale", "scale_applied", "curve", "specimen"];

/// Keys that the metadata do not name: they have a meaning.
const RESERVED: [&str; 10] =
    ["LM", "LM3", "CURVES", "CURVES3", "OUTLINES", "OUTLINES3", "POINTS", "POINTS3", "ID", "SCALE"];

/// A specimen whose curves may still come.
struct Specimen {
    name: Option<String>,
    dimension: usize,
    landmarks: String,
    curves: Vec<String>,
    outlines: Vec<String>,
    /// The lines after points.
    entries: String,
}

struct Tps<'a> {
    output: Output<'a>,
    pending: Option<Specimen>,
    summary: Summary,
}

pub(super) fn open<'a>(output: Output<'a>, _: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(Tps { output, pending: None, summary: Summary::default() }))
}

impl Writer for Tps<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let (points, curve) = match &record.geometry {
            Geometry::Landmarks(points) => (points, None),
            Geometry::Curve { points, closed } => (points, Some(*closed)),
            _ => return Err(refused(record, "landmarks or a curve")),
        };
        if !(2..=3).contains(&points.dimension()) {
            let detail = format!("expected points of 2 or 3 coordinates, got {}", points.dimension());
            return Err(unfit(record, detail));
        }
        let belongs = curve.is_some()
            && record.metadata.contains_key("curve")
            && self.pending.as_ref().is_some_and(|specimen| {
                specimen.dimension == points.dimension()
                    && specimen.name.as_deref() == text(record, "specimen")
            });
        if !belongs {
            self.flush()?;
            self.pending = Some(Specimen::new(record, points, curve.is_some())?);
        }
        if let (Some(closed), Some(specimen)) = (curve, &mut self.pending) {
            let lines = if closed { &mut specimen.outlines } else { &mut specimen.curves };
            lines.push(block("POINTS=", points));
        }
        let others = record.metadata.get("other").filter(|other| other.is_object()).map_or("", |_| "other");
        let mut kept = KEPT.to_vec();
        kept.push(others);
        left_out(&mut self.summary, record, &kept);
        self.summary.records += 1;
        Ok(())
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        self.flush()?;
        self.output.flush()?;
        Ok(self.summary)
    }
}

impl Tps<'_> {
    fn flush(&mut self) -> Result<(), FileError> {
        let Some(specimen) = self.pending.take() else { return Ok(()) };
        let mut lines = specimen.landmarks;
        for (key, curves) in [("CURVES", specimen.curves), ("OUTLINES", specimen.outlines)] {
            if !curves.is_empty() {
                // Writing to a text cannot fail.
                let _ = writeln!(lines, "{key}={}", curves.len());
                lines.extend(curves);
            }
        }
        lines.push_str(&specimen.entries);
        lines.push('\n');
        Ok(self.output.write_all(lines.as_bytes())?)
    }
}

impl Specimen {
    /// Begins the specimen of a record: its landmarks, or none before its first curve.
    fn new(record: &Record, points: &Points, is_curve: bool) -> Result<Self, FileError> {
        let dimension = points.dimension();
        let start = if dimension == 3 { "LM3=" } else { "LM=" };
        let landmarks = if is_curve { format!("{start}0\n") } else { block(start, points) };
        let name = if is_curve && record.metadata.contains_key("curve") {
            text(record, "specimen").map(str::to_owned)
        } else {
            record.name.clone()
        };
        let entries = entries(record, name.as_deref()).map_err(|detail| unfit(record, detail))?;
        Ok(Self { name, dimension, landmarks, curves: Vec::new(), outlines: Vec::new(), entries })
    }
}

/// The lines after the points of a specimen.
fn entries(record: &Record, name: Option<&str>) -> Result<String, String> {
    let mut lines = String::new();
    let mut entry = |key: &str, value: &str| {
        let is_line = !value.contains(['\n', '\r']);
        if is_line {
            lines.push_str(&format!("{key}={value}\n"));
        }
        is_line.then_some(()).ok_or_else(|| format!("expected one line as {key}=, got several"))
    };
    if let Some(image) = text(record, "image") {
        entry("IMAGE", image)?;
    }
    if let Some(name) = name {
        name_fits(name)?;
        entry("ID", name)?;
    }
    for comment in text(record, "comment").into_iter().flat_map(|comment| comment.split('\n')) {
        entry("COMMENT", comment)?;
    }
    let variables = record.metadata.get("variables").and_then(Value::as_array);
    if let Some((first, rest)) = variables.and_then(|lines| lines.split_first()) {
        entry("VARIABLES", first.as_str().unwrap_or_default())?;
        for line in rest {
            let line = line.as_str().unwrap_or_default();
            if line.contains(['=', '\n', '\r']) {
                return Err(format!(
                    "expected one line of values without '=' in variables, got {}",
                    shown(line)
                ));
            }
            lines.push_str(&format!("{line}\n"));
        }
    }
    let mut entry = |key: &str, value: &str| {
        value.split('\n').for_each(|value| lines.push_str(&format!("{key}={}\n", value.trim())));
    };
    if let Some(scale) = record.metadata.get("scale").and_then(Value::as_f64) {
        entry("SCALE", &scale.to_string());
    }
    for (key, value) in record.metadata.get("other").and_then(Value::as_object).into_iter().flatten() {
        let is_key = key.starts_with(|c: char| c.is_ascii_alphabetic())
            && key.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
            && !RESERVED.contains(&key.to_ascii_uppercase().as_str());
        if let (true, Some(value)) = (is_key, value.as_str()) {
            entry(key, value);
        }
    }
    Ok(lines)
}

fn text<'r>(record: &'r Record, key: &str) -> Option<&'r str> {
    record.metadata.get(key).and_then(Value::as_str)
}

fn block(start: &str, points: &Points) -> String {
    let mut lines = format!("{start}{}\n", points.len());
    points.rows().for_each(|row| write_row(&mut lines, row, "NA"));
    lines
}
