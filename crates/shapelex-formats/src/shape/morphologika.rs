//! Morphologika: landmarks of specimens in sections, with labels, groups and wireframes.
//!
//! ```text
//! [individuals]
//! 2
//! [landmarks]
//! 2
//! [dimensions]
//! 2
//! [names]
//! a
//! b
//! [labels]
//! Sex Age
//! [labelvalues]
//! f 3
//! m 4
//! [groups]
//! young 1 old 1
//! [rawpoints]
//! '1
//! 1 2
//! 3 4
//! '2
//! 1 2
//! 9999 9999
//! [wireframe]
//! 1 2
//! ```

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde_json::Value as Json;

use super::format::Format;
use super::limits::Limits;
use super::options::{ReadOptions, WriteOptions};
use super::record::Sink;
use super::record::{Geometry, Kind, Points, Record};
use super::source::Source;
use super::text::{self, Lines, Missing, Uniform, Words, coordinate, shown};
use super::write::{Opened, Output, Writer};
use crate::error::{FileError, Place};
use crate::summary::Summary;
use crate::value::Value;

/// Morphologika.
pub(super) static FORMAT: Format = Format {
    id: "morphologika",
    name: "Morphologika",
    media_types: &["application/x-morphologika"],
    extensions: &["morphologika"],
    recognise: |head| {
        let text = String::from_utf8_lossy(head);
        Lines::new(&text, 0).any(|line| line.eq_ignore_ascii_case("[individuals]"))
    },
    kinds: &[Kind::Landmarks],
    options: &["missing", "attributes"],
    read: Some(read),
    open: Some(open),
};

/// Coordinates of a missing landmark, as Landmark Editor exports it.
const MISSING: f64 = 9999.0;
/// Most sections of a file. The format has ten.
const MAX_SECTIONS: usize = 64;
/// Sections that are kept as lists of numbers of landmarks.
const LISTS: [&str; 2] = ["wireframe", "polygons"];
/// Sections that are read.
const SECTIONS: [&str; 8] =
    ["individuals", "landmarks", "dimensions", "names", "labels", "labelvalues", "groups", "rawpoints"];

/// Whether a line begins a section.
fn is_header(line: &str) -> bool {
    line.len() > 1 && line.starts_with('[') && line.ends_with(']')
}

/// Sections by name: the number of lines before their body, and the body.
struct Sections<'t>(BTreeMap<String, (u64, &'t str)>);

impl<'t> Sections<'t> {
    fn new(text: &'t str) -> Result<Self, FileError> {
        let mut sections = BTreeMap::new();
        let mut open: Option<(String, u64, usize)> = None;
        let (mut start, mut line) = (0, 0);
        for whole in text.split_inclusive('\n') {
            line += 1;
            let name = whole.trim().strip_prefix('[').and_then(|rest| rest.strip_suffix(']'));
            let end = start;
            start += whole.len();
            match (name, &open) {
                (Some(name), _) => {
                    if let Some((name, line, from)) = open.take() {
                        sections.insert(name, (line, &text[from..end]));
                    }
                    let name = name.trim().to_lowercase();
                    if sections.len() == MAX_SECTIONS {
                        let detail = format!("expected at most {MAX_SECTIONS} sections, got more");
                        return Err(FileError::too_large(Place::line(line), detail));
                    }
                    if sections.contains_key(&name) {
                        let detail = format!("expected each section once, got {} again", shown(&name));
                        return Err(FileError::malformed(Place::line(line), detail));
                    }
                    open = Some((name, line, start));
                }
                (None, None) if !whole.trim().is_empty() => {
                    let detail =
                        format!("expected a section such as [individuals], got {}", shown(whole.trim()));
                    return Err(FileError::malformed(Place::line(line), detail));
                }
                _ => {}
            }
        }
        if let Some((name, line, from)) = open {
            sections.insert(name, (line, &text[from..]));
        }
        Ok(Self(sections))
    }

    fn lines(&self, name: &str) -> Option<Lines<'t>> {
        self.0.get(name).map(|(before, body)| Lines::new(body, *before))
    }

    fn required(&self, name: &str) -> Result<Lines<'t>, FileError> {
        self.lines(name).ok_or_else(|| {
            let detail = format!("expected the section [{name}], got none");
            FileError::truncated(Place::tag(format!("[{name}]")), detail)
        })
    }

    /// The number of a section that has nothing else.
    fn number(&self, name: &str) -> Result<u64, FileError> {
        let mut lines = self.required(name)?;
        let text = next(&mut lines, name)?;
        text::count(text).map_err(|detail| FileError::malformed(lines.place(), detail))
    }
}

/// The next line of a section.
fn next<'t>(lines: &mut Lines<'t>, section: &str) -> Result<&'t str, FileError> {
    lines.next().ok_or_else(|| {
        let detail = format!("expected a line more in [{section}], got its end");
        FileError::truncated(lines.place(), detail)
    })
}

fn read(source: &mut Source<'_>, options: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let text = source.text()?;
    let sections = Sections::new(&text)?;
    let mut summary = Summary::default();
    for name in
        sections.0.keys().filter(|name| !SECTIONS.contains(&name.as_str()) && !LISTS.contains(&name.as_str()))
    {
        summary.drop("sections", Some(name), || Place::tag(format!("[{name}]")));
    }
    for name in LISTS {
        if let Some(lines) = sections.lines(name) {
            summary.set(name, list(lines, &limits)?);
        }
    }
    let mut specimens = Specimens::new(&sections, &limits, options)?;
    let mut has_lists = false;
    for item in 0..sections.number("individuals")? {
        let mut record = match specimens.next(item)? {
            Ok(record) => record,
            Err(error) => {
                options.leave_out(error, &mut summary)?;
                continue;
            }
        };
        // In the first record only: a list is as long as the file allows, and there may be many records.
        let is_first = !std::mem::replace(&mut has_lists, true);
        for name in LISTS.iter().filter(|_| is_first) {
            if let Some(list) = summary.properties.get(*name) {
                record.metadata.insert((*name).into(), list.clone());
            }
        }
        sink(record)?;
    }
    if let Some(line) = specimens.points.find(|line| !line.starts_with('\'')) {
        let detail =
            format!("expected as many points as [individuals] and [landmarks] say, got {} more", shown(line));
        return Err(FileError::malformed(specimens.points.place(), detail));
    }
    Ok(summary)
}

/// Lists of numbers of landmarks, from 1, one a line.
fn list(lines: Lines<'_>, limits: &Limits) -> Result<Json, FileError> {
    let (mut lists, mut held): (Vec<Json>, u64) = (Vec::new(), 0);
    let mut lines = lines;
    while let Some(line) = lines.next() {
        let numbers = line.split_whitespace().map(text::count).collect::<Result<Vec<_>, _>>();
        let numbers = numbers.map_err(|detail| FileError::malformed(lines.place(), detail))?;
        held += numbers.len() as u64;
        limits.faces(held, || lines.place())?;
        lists.push(numbers.into());
    }
    Ok(lists.into())
}

/// The sections that have a line or more for each specimen, side by side.
struct Specimens<'t> {
    points: Lines<'t>,
    names: Option<Lines<'t>>,
    labels: Vec<&'t str>,
    values: Option<Lines<'t>>,
    groups: Option<Words<'t>>,
    /// The group, and how many of its specimens are left.
    group: Option<(&'t str, u64)>,
    landmarks: u64,
    dimension: usize,
    missing: Missing,
}

impl<'t> Specimens<'t> {
    fn new(sections: &Sections<'t>, limits: &Limits, options: &ReadOptions) -> Result<Self, FileError> {
        let landmarks = sections.number("landmarks")?;
        limits.points(landmarks, || Place::tag("[landmarks]"))?;
        if landmarks == 0 && sections.number("individuals")? > 0 {
            // A number of specimens without points could be any.
            let detail = "expected 1 or more landmarks, got 0";
            return Err(FileError::malformed(Place::tag("[landmarks]"), detail));
        }
        let dimension = match sections.number("dimensions")? {
            2 => 2,
            3 => 3,
            other => {
                let detail = format!("expected 2 or 3 dimensions, got {other}");
                return Err(FileError::malformed(Place::tag("[dimensions]"), detail));
            }
        };
        let labels = sections.lines("labels").and_then(|mut lines| lines.next());
        for label in labels.into_iter().flat_map(str::split_whitespace) {
            text::name_fits(label).map_err(|detail| FileError::malformed(Place::tag("[labels]"), detail))?;
        }
        Ok(Self {
            points: sections.required("rawpoints")?,
            names: sections.lines("names"),
            labels: labels.map(|line| line.split_whitespace().collect()).unwrap_or_default(),
            values: sections.lines("labelvalues"),
            groups: sections.lines("groups").map(Words::new),
            group: None,
            landmarks,
            dimension,
            missing: Missing::new(options, Missing::Code(MISSING))?,
        })
    }

    /// The next specimen, or its fault, after which the next one can be read.
    fn next(&mut self, item: u64) -> Result<Result<Record, FileError>, FileError> {
        let points = self.points(item)?;
        let name = match &mut self.names {
            Some(names) => Some(next(names, "names")?.to_owned()),
            None => None,
        };
        let labels = self.attributes()?;
        let label = self.group()?.map(str::to_owned);
        let described = |(points, place): (Points, Place)| {
            let record = Record::new(Geometry::Landmarks(points), place);
            labels.map(|labels| Record { name, label, labels, ..record })
        };
        Ok(points.and_then(described))
    }

    /// The points of a specimen and their place.
    fn points(&mut self, item: u64) -> Result<Result<(Points, Place), FileError>, FileError> {
        while self.points.peek().is_some_and(|line| line.starts_with('\'')) {
            self.points.next();
        }
        let mut points = Points::new(self.dimension);
        let (mut place, mut broken) = (None, None);
        for _ in 0..self.landmarks {
            // A comment stands before the next specimen.
            if broken.is_some() && self.points.peek().is_some_and(|line| line.starts_with('\'')) {
                break;
            }
            let line = next(&mut self.points, "rawpoints")?;
            place.get_or_insert_with(|| Place { item: Some(item), ..self.points.place() });
            if broken.is_none() {
                let found = self.point(line, &mut points);
                broken = found.err().map(|detail| FileError::malformed(self.points.place(), detail));
            }
        }
        let place = place.unwrap_or_else(|| Place::item(item));
        Ok(broken.map_or(Ok((points, place)), Err))
    }

    /// The attributes of a specimen.
    fn attributes(&mut self) -> Result<Result<BTreeMap<String, Value>, FileError>, FileError> {
        let Some(values) = &mut self.values else { return Ok(Ok(BTreeMap::new())) };
        let line = next(values, "labelvalues")?;
        let count = line.split_whitespace().count();
        if count != self.labels.len() {
            let detail = format!("expected {} values, one a label, got {count}", self.labels.len());
            return Ok(Err(FileError::malformed(values.place(), detail)));
        }
        let values =
            self.labels.iter().zip(line.split_whitespace()).filter(|(_, value)| !text::is_missing(value));
        Ok(Ok(values.map(|(label, value)| ((*label).into(), text::value(value))).collect()))
    }

    fn point(&self, line: &str, points: &mut Points) -> Result<(), String> {
        let count = line.split_whitespace().count();
        if count != self.dimension {
            return Err(format!("expected {} coordinates, got {count}", self.dimension));
        }
        let mut row = line.split_whitespace().map(coordinate).collect::<Result<Vec<_>, _>>()?;
        self.missing.apply(&mut row);
        text::push(points, &row)
    }

    /// The group of the next specimen.
    fn group(&mut self) -> Result<Option<&'t str>, FileError> {
        let Some(words) = &mut self.groups else { return Ok(None) };
        loop {
            match &mut self.group {
                Some((name, left)) if *left > 0 => {
                    *left -= 1;
                    return Ok(Some(name));
                }
                _ => {
                    let Some(name) = words.next() else { return Ok(None) };
                    text::name_fits(name).map_err(|detail| FileError::malformed(words.place(), detail))?;
                    let count = words.next().unwrap_or_default();
                    let count =
                        text::count(count).map_err(|detail| FileError::malformed(words.place(), detail))?;
                    self.group = Some((name, count));
                }
            }
        }
    }
}

struct Morphologika<'a> {
    output: Output<'a>,
    size: Uniform,
    points: String,
    names: Vec<Option<String>>,
    /// Names of the attributes of the first shape.
    labels: Vec<String>,
    values: String,
    /// Runs of shapes with one label; `None` once a shape has none.
    groups: Option<Vec<(String, u64)>>,
    lists: BTreeMap<&'static str, String>,
    held: usize,
    summary: Summary,
}

fn open<'a>(output: Output<'a>, _: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(Morphologika {
        output,
        size: Uniform::default(),
        points: String::new(),
        names: Vec::new(),
        labels: Vec::new(),
        values: String::new(),
        groups: Some(Vec::new()),
        lists: BTreeMap::new(),
        held: 0,
        summary: Summary::default(),
    }))
}

impl Writer for Morphologika<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let points = text::points(record, &mut self.summary)?;
        self.size.check(record, points)?;
        if !(2..=3).contains(&points.dimension()) || points.is_empty() {
            let detail = format!(
                "expected a point or more of 2 or 3 coordinates, got {} of {}",
                points.len(),
                points.dimension()
            );
            return Err(text::unfit(record, detail));
        }
        if points.rows().any(|row| row.iter().all(|x| *x == MISSING)) {
            let detail = format!("expected no point at {MISSING}, which means a missing one, got one");
            return Err(text::unfit(record, detail));
        }
        if self.names.is_empty() {
            let has_column = |label: &&String| !label.trim().is_empty() && text::name_fits(label).is_ok();
            self.labels = record.labels.keys().filter(has_column).cloned().collect();
            if is_header(&self.labels.join(" ")) {
                self.labels.clear();
            }
            for (name, lines) in
                LISTS.iter().filter_map(|name| Some((name, lines(record.metadata.get(*name)?)?)))
            {
                self.lists.insert(name, lines);
            }
        }
        // Writing to a text cannot fail.
        let _ = writeln!(self.points, "'{}", self.names.len() + 1);
        points.rows().for_each(|row| text::write_row(&mut self.points, row, "9999"));
        let name = record.name.as_deref().map(|name| name.split_whitespace().collect::<Vec<_>>().join(" "));
        let name = name.filter(|name| !name.is_empty());
        if name.as_deref().is_some_and(is_header) {
            return Err(text::unfit(record, "expected a name without brackets around it, got one with them"));
        }
        self.names.push(name);
        self.attributes(record);
        self.held += record.bytes();
        text::left_out(&mut self.summary, record, &["label", "labels", "wireframe", "polygons"]);
        self.summary.records += 1;
        Ok(())
    }

    fn held(&self) -> usize {
        self.held
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        let (points, dimension) = self.size.size().unwrap_or((0, 2));
        let count = self.names.len();
        let mut text = format!("[individuals]\n{count}\n[landmarks]\n{points}\n[dimensions]\n{dimension}\n");
        let names: Vec<_> = self.names.iter().flatten().collect();
        if names.len() == count && count > 0 {
            text.push_str("[names]\n");
            names.iter().for_each(|name| text.push_str(&format!("{name}\n")));
        } else if !names.is_empty() {
            self.summary.drop("names, as not all shapes have one", None, Place::default);
        }
        if !self.labels.is_empty() {
            let labels: Vec<_> =
                self.labels.iter().map(|label| label.replace(char::is_whitespace, "_")).collect();
            text.push_str(&format!("[labels]\n{}\n[labelvalues]\n{}", labels.join(" "), self.values));
        }
        match &self.groups {
            Some(groups) if !groups.is_empty() => {
                let groups: Vec<_> = groups.iter().map(|(name, count)| format!("{name} {count}")).collect();
                text.push_str(&format!("[groups]\n{}\n", groups.join(" ")));
            }
            _ => {}
        }
        text.push_str(&format!("[rawpoints]\n{}", self.points));
        for (name, lines) in &self.lists {
            text.push_str(&format!("[{name}]\n{lines}"));
        }
        text::end(&mut self.output, &text)?;
        Ok(self.summary)
    }
}

impl Morphologika<'_> {
    fn attributes(&mut self, record: &Record) {
        let place = &record.place;
        if !self.labels.is_empty() {
            let summary = &mut self.summary;
            let values = self.labels.iter().map(|label| match record.labels.get(label).map(text::text_of) {
                Some(value) if !value.is_empty() => text::word(&value, summary, place),
                _ => "NA".into(),
            });
            let mut values = values.collect::<Vec<_>>().join(" ");
            if is_header(&values) {
                summary.drop("labels that would begin a section", record.name.as_deref(), || place.clone());
                values = vec!["NA"; self.labels.len()].join(" ");
            }
            self.values.push_str(&values);
            self.values.push('\n');
        }
        for label in record.labels.keys().filter(|label| !self.labels.contains(label)) {
            self.summary.drop("labels without a column", Some(label), || place.clone());
        }
        match (&mut self.groups, &record.label) {
            (Some(groups), Some(label)) if !label.trim().is_empty() && text::name_fits(label).is_ok() => {
                let label = text::word(label, &mut self.summary, place);
                match groups.last_mut() {
                    Some((last, count)) if *last == label => *count += 1,
                    _ => groups.push((label, 1)),
                }
            }
            (Some(groups), None) if groups.is_empty() && self.names.len() == 1 => self.groups = None,
            (None, None) => {}
            _ => {
                self.groups = None;
                let what = "classes, as not all shapes have one that fits";
                self.summary.drop(what, record.name.as_deref(), || place.clone());
            }
        }
    }
}

/// Lists of numbers of landmarks as lines.
fn lines(lists: &Json) -> Option<String> {
    let mut lines = String::new();
    for list in lists.as_array()? {
        let numbers = list.as_array()?.iter().map(|number| number.as_u64().map(|number| number.to_string()));
        lines.push_str(&numbers.collect::<Option<Vec<_>>>()?.join(" "));
        lines.push('\n');
    }
    Some(lines)
}

#[cfg(test)]
mod tests {
    use super::super::testing::{check_truncations, converted, fault, records, written};
    use super::*;

    const TWO: &str = concat!(
        "[individuals]\n2\n[landmarks]\n2\n[dimensions]\n3\n[names]\nfirst one\nb\n[labels]\nAge Sex\n[labelvalues]\n3 f\nNA m\n",
        "[groups]\nyoung 1 old 1\n[rawpoints]\n'1\n1 2 3\n4 5.5 6\n'2\n-1 -2 -3\n9999 9999 9999\n[polygons]\n1 2 1\n",
        "[wireframe]\n1 2\n2 1\n",
    );

    #[test]
    fn a_file_is_written_as_it_was_read() {
        let (found, summary) = records(&FORMAT, TWO, &ReadOptions::default()).expect("a valid file");
        assert_eq!(converted(&FORMAT, &found), TWO);
        assert_eq!((found[0].name.as_deref(), found[0].label.as_deref()), (Some("first one"), Some("young")));
        assert_eq!(found[0].labels["Age"], super::super::Value::Number(3.0));
        assert_eq!(found[1].labels.keys().collect::<Vec<_>>(), ["Sex"]);
        assert_eq!(summary.properties["wireframe"], serde_json::json!([[1, 2], [2, 1]]));
        let Geometry::Landmarks(points) = &found[1].geometry else { panic!("landmarks") };
        assert_eq!(points.missing(), [1]);
        assert!((FORMAT.recognise)(TWO.as_bytes()));
    }

    #[test]
    fn names_and_points_that_mean_something_else_are_refused() {
        let (found, _) = records(&FORMAT, TWO, &ReadOptions::default()).expect("a valid file");
        let refusal = |record: Record| {
            let text = written(&FORMAT, &[record], &WriteOptions::default());
            text.expect_err("a record that does not fit").to_string()
        };
        let named = Record { name: Some("[names]".into()), ..found[0].clone() };
        let expected = "shape '[names]': expected a name without brackets around it, got one with them";
        assert!(refusal(named).ends_with(expected));
        let mut coded = found[0].clone();
        coded.geometry = Geometry::Landmarks(Points::from_rows(2, vec![9999.0; 2]));
        assert!(refusal(coded).ends_with("expected no point at 9999, which means a missing one, got one"));
    }

    #[test]
    fn words_that_would_not_be_read_are_left_out() {
        let (found, _) = records(&FORMAT, TWO, &ReadOptions::default()).expect("a valid file");
        let write = |record: Record| {
            let (text, summary) =
                written(&FORMAT, &[record], &WriteOptions::default()).expect("a record that fits");
            let (again, _) =
                records(&FORMAT, &text, &ReadOptions::default()).expect("what is written is read");
            let dropped = summary.dropped.into_iter().map(|dropped| dropped.what).collect::<Vec<_>>();
            (again[0].label.clone(), again[0].labels.clone(), dropped.join(", "))
        };
        let classed = Record { label: Some("x".repeat(1025)), ..found[0].clone() };
        let (label, labels, dropped) = write(classed);
        assert_eq!((label, labels), (None, found[0].labels.clone()));
        assert_eq!(dropped, "classes, as not all shapes have one that fits");
        let labelled = |pairs: &[(&str, &str)]| {
            let pairs = pairs
                .iter()
                .map(|(name, value)| ((*name).into(), super::super::Value::Text((*value).into())));
            Record { labels: pairs.collect(), ..found[0].clone() }
        };
        for (pairs, what) in [
            ([("a", "[names"), ("b", "x]")], "labels that would begin a section"),
            ([("[a", "1"), ("b]", "2")], "labels without a column"),
        ] {
            let (label, labels, dropped) = write(labelled(&pairs));
            assert_eq!((label.as_deref(), labels.len(), dropped.as_str()), (Some("young"), 0, what));
        }
        let bracketed = labelled(&[("a", "[x]"), ("b", "y")]);
        assert_eq!(write(bracketed.clone()), (found[0].label.clone(), bracketed.labels, String::new()));
    }

    #[test]
    fn sections_may_stand_in_any_order() {
        let text =
            "[RawPoints]\n\n1 2\n3 4\n[Dimensions]\n2\n[Landmarks]\n2\n[Individuals]\n1\n[colours]\nred\n";
        let (found, summary) = records(&FORMAT, text, &ReadOptions::default()).expect("a valid file");
        assert_eq!(
            (found.len(), found[0].place.line, summary.dropped[0].names[0].as_str()),
            (1, Some(3), "colours")
        );
    }

    #[test]
    fn faults_name_their_line() {
        let small = "[individuals]\n1\n[landmarks]\n2\n[dimensions]\n2\n[rawpoints]\n1 2\n3 4\n";
        for (from, to, message) in [
            ("[ind", "x\n[ind", "line 1: expected a section such as [individuals], got 'x'"),
            ("[landmarks]\n2\n", "", "[landmarks]: expected the section [landmarks], got none"),
            ("[landmarks]\n2", "[landmarks]", "line 3: expected a line more in [landmarks], got its end"),
            ("[landmarks]\n2", "[landmarks]\n0", "[landmarks]: expected 1 or more landmarks, got 0"),
            ("[landmarks]\n2", "[landmarks]\n-2", "line 4: expected a whole number, got '-2'"),
            ("[landmarks]\n2", "[landmarks]\n3", "line 9: expected a line more in [rawpoints], got its end"),
            (
                "[landmarks]\n2",
                "[landmarks]\n99999999",
                "[landmarks]: expected at most 4194304 points of a shape, got 99999999",
            ),
            ("[dimensions]\n2", "[dimensions]\n4", "[dimensions]: expected 2 or 3 dimensions, got 4"),
            (
                "3 4\n",
                "3 4\n5 6\n",
                "line 10: expected as many points as [individuals] and [landmarks] say, got '5 6' more",
            ),
            ("3 4", "3 4 5", "line 9: expected 2 coordinates, got 3"),
            ("3 4", "3 x", "line 9: expected a number, got 'x'"),
            (
                "[rawpoints]",
                "[landmarks]\n[rawpoints]",
                "line 7: expected each section once, got 'landmarks' again",
            ),
            ("[rawpoints]", "[names]\n[rawpoints]", "line 7: expected a line more in [names], got its end"),
            (
                "[rawpoints]",
                "[labels]\na\n[labelvalues]\n1 2\n[rawpoints]",
                "line 10: expected 1 values, one a label, got 2",
            ),
            ("[rawpoints]", "[groups]\na b\n[rawpoints]", "line 8: expected a whole number, got 'b'"),
            ("[rawpoints]", "[wireframe]\n1 -2\n[rawpoints]", "line 8: expected a whole number, got '-2'"),
        ] {
            assert_eq!(fault(&FORMAT, &small.replace(from, to), &ReadOptions::default()), message);
        }
        check_truncations(&FORMAT, TWO.as_bytes());
    }
}
