//! Reading of TPS files.

use serde_json::{Map, Value, json};

use super::super::limits::Limits;
use super::super::options::{Curves, ReadOptions, Scale};
use super::super::record::Sink;
use super::super::record::{Geometry, Points, Record};
use super::super::source::Source;
use super::super::text::{Lines, Missing, coordinate, count, name_fits, number, push, shown};
use crate::error::{FileError, Place};
use crate::summary::Summary;

/// A specimen: everything from one `LM=` to the next.
struct Specimen {
    place: Place,
    landmarks: Points,
    /// Each with whether it is an outline.
    curves: Vec<(Points, bool)>,
    name: Option<String>,
    scale: Option<f64>,
    metadata: Map<String, Value>,
}

const NO_SCALE: &str = "expected SCALE= in every specimen, got one without";

impl Specimen {
    /// Refuses a specimen without the scale that is to be applied.
    fn scaled(self, option: Option<Scale>) -> Result<Self, FileError> {
        if option == Some(Scale::Apply) && self.scale.is_none() {
            return Err(FileError::malformed(self.place, NO_SCALE));
        }
        Ok(self)
    }
}

/// Signs of the coordinates of a file, by which negative codes of missing points are noticed.
#[derive(Default)]
struct Signs {
    negative_points: u64,
    other_negative: bool,
}

pub(super) fn read(
    source: &mut Source<'_>,
    options: &ReadOptions,
    sink: Sink<'_>,
) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let text = source.text()?;
    let mut summary = Summary::default();
    let apply = is_scaled(&text, options, &mut summary)?;
    let missing = Missing::new(options, Missing::Words)?;
    let mut reader = Reader { lines: Lines::new(&text, 0), limits, missing, signs: Signs::default() };
    let mut item = 0;
    while let Some(start) = reader.start()? {
        let place = Place { item: Some(item), ..reader.lines.place() };
        item += 1;
        let found = reader.specimen(start, place, &mut summary);
        match found.and_then(|specimen| specimen.scaled(options.scale)) {
            Ok(specimen) => give(specimen, apply, options, &mut summary, sink)?,
            Err(error) => {
                options.leave_out(error, &mut summary)?;
                reader.skip();
            }
        }
    }
    if reader.signs.negative_points > 0 && !reader.signs.other_negative {
        summary.warnings.push(format!(
            "{} points have only negative coordinates, and no other point has one: if they are missing, say so by the option \
             missing",
            reader.signs.negative_points
        ));
    }
    Ok(summary)
}

/// Whether coordinates are multiplied by their scales: if every specimen has one, as readers of R do, unless the caller decides.
fn is_scaled(text: &str, options: &ReadOptions, summary: &mut Summary) -> Result<bool, FileError> {
    let (mut specimens, mut scaled, mut start, mut has_scale, mut without) = (0_u64, 0_u64, 0, true, None);
    let mut lines = Lines::new(text, 0);
    let mut close = |has_scale: bool, start: u64| {
        if has_scale {
            scaled += 1;
        } else if without.is_none() {
            without = Some(start);
        }
    };
    while let Some(line) = lines.next() {
        match key(line) {
            Some((key, _)) if is_start(&key) => {
                if specimens > 0 {
                    close(has_scale, start);
                }
                (specimens, start, has_scale) = (specimens + 1, lines.place().line.unwrap_or(0), false);
            }
            Some((key, _)) if key == "SCALE" => has_scale = true,
            _ => {}
        }
    }
    if specimens > 0 {
        close(has_scale, start);
    }
    let apply = match (options.scale, without) {
        (Some(Scale::Apply), Some(line)) if !options.skips_broken() => {
            return Err(FileError::malformed(Place::line(line), NO_SCALE));
        }
        (Some(Scale::Apply), _) => specimens > 0,
        (Some(Scale::Leave), _) => false,
        (None, Some(line)) if scaled > 0 => {
            summary.warnings.push(format!(
                "{scaled} of {specimens} specimens have SCALE=: coordinates are those of the file; the first without begins in \
                 line {line}"
            ));
            false
        }
        (_, without) => without.is_none() && specimens > 0,
    };
    let fact = match (apply, scaled) {
        (true, _) => "applied",
        (false, 0) => "none",
        (false, _) => "left",
    };
    summary.set("scale", fact);
    Ok(apply)
}

/// `KEY=value`: the key in upper case.
fn key(line: &str) -> Option<(String, &str)> {
    let (key, value) = line.split_once('=')?;
    let key = key.trim();
    let is_word = key.starts_with(|c: char| c.is_ascii_alphabetic())
        && key.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
    is_word.then(|| (key.to_ascii_uppercase(), value.trim()))
}

fn is_start(key: &str) -> bool {
    matches!(key, "LM" | "LM3")
}

struct Reader<'t> {
    lines: Lines<'t>,
    limits: Limits,
    missing: Missing,
    signs: Signs,
}

impl<'t> Reader<'t> {
    fn fault(&self, detail: impl Into<String>) -> FileError {
        FileError::malformed(self.lines.place(), detail)
    }

    /// The line that begins a specimen: its key and the number of landmarks.
    fn start(&mut self) -> Result<Option<(String, &'t str)>, FileError> {
        let Some(line) = self.lines.next() else { return Ok(None) };
        let start = key(line).filter(|(key, _)| is_start(key));
        start.map(Some).ok_or_else(|| {
            self.fault(format!("expected LM= or LM3= at the start of a specimen, got {}", shown(line)))
        })
    }

    /// Passes over the rest of a broken specimen.
    fn skip(&mut self) {
        let begins = |line: &str| key(line).is_some_and(|(key, _)| is_start(&key));
        while self.lines.peek().is_some_and(|line| !begins(line)) {
            self.lines.next();
        }
    }

    fn specimen(
        &mut self,
        (start, size): (String, &str),
        place: Place,
        summary: &mut Summary,
    ) -> Result<Specimen, FileError> {
        // Some programs write points in space below LM= as well.
        let first = self
            .lines
            .peek()
            .filter(|line| !line.contains('='))
            .map_or(0, |line| line.split_whitespace().count());
        let dimension = if start == "LM3" || first == 3 { 3 } else { 2 };
        let mut held = 0;
        let landmarks = self.points(size, dimension, &mut held)?;
        let mut specimen =
            Specimen { place, landmarks, curves: Vec::new(), name: None, scale: None, metadata: Map::new() };
        while let Some(line) = self.lines.peek() {
            let entry = key(line);
            if entry.as_ref().is_some_and(|(key, _)| is_start(key)) {
                break;
            }
            self.lines.next();
            let Some((key, value)) = entry else {
                return Err(self.fault(format!("expected KEY=value or LM=, got {}", shown(line))));
            };
            self.entry(&key, value, dimension, &mut specimen, &mut held, summary)?;
        }
        Ok(specimen)
    }

    fn entry(
        &mut self,
        key: &str,
        value: &str,
        dimension: usize,
        specimen: &mut Specimen,
        held: &mut u64,
        summary: &mut Summary,
    ) -> Result<(), FileError> {
        match key {
            "CURVES" | "CURVES3" | "OUTLINES" | "OUTLINES3" => {
                let closed = key.starts_with("OUTLINES");
                let curves = count(value).map_err(|detail| self.fault(detail))?;
                for _ in 0..curves {
                    let size = self.points_key()?;
                    specimen.curves.push((self.points(size, dimension, held)?, closed));
                    // Empty ones take memory as well.
                    self.limits.points(specimen.curves.len() as u64, || self.lines.place())?;
                }
            }
            "ID" => {
                name_fits(value).map_err(|detail| self.fault(detail))?;
                specimen.name = Some(value.into()).filter(|name: &String| !name.is_empty());
            }
            "SCALE" => {
                let scale = number(value).map_err(|detail| self.fault(detail))?;
                if scale <= 0.0 {
                    return Err(self.fault(format!("expected a positive SCALE=, got {scale}")));
                }
                specimen.scale = Some(scale);
            }
            "COMMENT" | "COMMENTS" => append(&mut specimen.metadata, "comment", value),
            "IMAGE" => append(&mut specimen.metadata, "image", value),
            "VARIABLES" => {
                let mut values = vec![Value::from(value)];
                values.extend(self.rest().map(Value::from));
                specimen.metadata.insert("variables".into(), values.into());
            }
            "CHAIN" | "CHAINS" | "RADII" | "RADIIXY" => {
                let place = self.lines.place();
                self.rest().for_each(drop);
                summary.drop("chain codes and radii", specimen.name.as_deref(), || place);
            }
            _ => {
                let others = specimen.metadata.entry("other").or_insert_with(|| json!({}));
                if let Some(others) = others.as_object_mut() {
                    append(others, key, value);
                }
            }
        }
        Ok(())
    }

    /// The lines up to the next key.
    fn rest(&mut self) -> impl Iterator<Item = &'t str> {
        std::iter::from_fn(|| match self.lines.peek() {
            Some(line) if key(line).is_none() => self.lines.next(),
            _ => None,
        })
    }

    fn points_key(&mut self) -> Result<&'t str, FileError> {
        let Some(line) = self.lines.peek() else {
            return Err(FileError::truncated(
                self.lines.place(),
                "expected POINTS=, got the end of the file",
            ));
        };
        match key(line) {
            Some((key, value)) if matches!(key.as_str(), "POINTS" | "POINTS3") => {
                self.lines.next();
                Ok(value)
            }
            // The line stays, as it may begin the next specimen.
            _ => {
                let detail = format!("expected POINTS=, got {}", shown(line));
                Err(FileError::malformed(self.lines.place_ahead(), detail))
            }
        }
    }

    /// As many points as the value of a key says. `held`: points of the specimen so far.
    fn points(&mut self, size: &str, dimension: usize, held: &mut u64) -> Result<Points, FileError> {
        let size = count(size).map_err(|detail| self.fault(detail))?;
        *held = held.saturating_add(size);
        self.limits.points(*held, || self.lines.place())?;
        let mut points = Points::new(dimension);
        for found in 0..size {
            let Some(line) = self.lines.peek() else {
                let detail = format!("expected {size} points, got the end of the file after {found}");
                return Err(FileError::truncated(self.lines.place(), detail));
            };
            // A key stays, as it may begin the next specimen.
            if line.contains('=') {
                let detail = format!("expected {size} points, got {} after {found}", shown(line));
                return Err(FileError::malformed(self.lines.place_ahead(), detail));
            }
            self.lines.next();
            self.point(line, &mut points).map_err(|detail| self.fault(detail))?;
        }
        Ok(points)
    }

    fn point(&mut self, line: &str, points: &mut Points) -> Result<(), String> {
        let dimension = points.dimension();
        let words = line.split_whitespace().count();
        if words != dimension {
            return Err(format!("expected {dimension} coordinates, got {words}"));
        }
        let mut row = line.split_whitespace().map(coordinate).collect::<Result<Vec<_>, _>>()?;
        self.missing.apply(&mut row);
        match row.iter().flatten().filter(|x| **x < 0.0).count() {
            0 => {}
            negative if negative == dimension => self.signs.negative_points += 1,
            _ => self.signs.other_negative = true,
        }
        push(points, &row)
    }
}

/// Adds a line to a text of the metadata.
fn append(metadata: &mut Map<String, Value>, key: &str, value: &str) {
    match metadata.get_mut(key) {
        Some(Value::String(text)) => {
            text.push('\n');
            text.push_str(value);
        }
        _ => {
            metadata.insert(key.into(), value.into());
        }
    }
}

/// Gives on the records of a specimen.
fn give(
    specimen: Specimen,
    apply: bool,
    options: &ReadOptions,
    summary: &mut Summary,
    sink: Sink<'_>,
) -> Result<(), FileError> {
    let Specimen { place, mut landmarks, mut curves, name, scale, mut metadata } = specimen;
    match scale {
        Some(scale) if apply => {
            landmarks = scaled(&landmarks, scale);
            curves = curves.into_iter().map(|(points, closed)| (scaled(&points, scale), closed)).collect();
            metadata.insert("scale_applied".into(), scale.into());
        }
        Some(scale) => {
            metadata.insert("scale".into(), scale.into());
        }
        None => {}
    }
    let choice = options.curves.unwrap_or_default();
    if choice == Curves::Append && !curves.is_empty() {
        let counts: Vec<usize> = curves.iter().map(|(points, _)| points.len()).collect();
        metadata.insert("landmarks".into(), landmarks.len().into());
        metadata.insert("curves".into(), counts.into());
        for (points, _) in curves.drain(..) {
            points.rows().for_each(|row| landmarks.push(row));
        }
    }
    let has_landmarks = !landmarks.is_empty() || curves.is_empty();
    if choice == Curves::Only {
        summary.drop("landmarks", name.as_deref(), || place.clone());
    } else if has_landmarks || choice == Curves::Skip {
        let record = Record::new(Geometry::Landmarks(landmarks), place.clone());
        sink(Record { name: name.clone(), metadata: metadata.clone(), ..record })?;
    }
    for (k, (points, is_outline)) in curves.into_iter().enumerate() {
        let number = k + 1;
        let name_of_curve = name.as_ref().map(|name| format!("{name} curve {number}"));
        if choice == Curves::Skip {
            summary.drop("curves", name_of_curve.as_deref(), || place.clone());
            continue;
        }
        let closed = is_outline || options.closed.unwrap_or(false);
        // Written once, with the landmarks, where these are given on.
        let mut own =
            if has_landmarks && choice != Curves::Only || k > 0 { Map::new() } else { metadata.clone() };
        own.insert("curve".into(), number.into());
        for key in ["scale", "scale_applied"] {
            if let Some(scale) = metadata.get(key) {
                own.insert(key.into(), scale.clone());
            }
        }
        if let Some(name) = &name {
            own.insert("specimen".into(), name.as_str().into());
        }
        let record = Record::new(Geometry::Curve { points, closed }, place.clone());
        sink(Record { name: name_of_curve, metadata: own, ..record })?;
    }
    Ok(())
}

fn scaled(points: &Points, scale: f64) -> Points {
    Points::from_rows(points.dimension(), points.coordinates().iter().map(|x| x * scale).collect())
}
