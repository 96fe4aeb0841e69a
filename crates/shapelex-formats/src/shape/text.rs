//! Common parts of formats of plain text: lines and words with their places, numbers, missing coordinates, attributes.

use std::borrow::Cow;
use std::fmt::Write as _;
use std::io::Write;

use super::options::ReadOptions;
use super::record::{Geometry, Points, Record};
use crate::error::{FaultKind, FileError, Place};
use crate::summary::Summary;
use crate::value::Value;
use crate::words::MAX_NAME;

/// Lines of a text that are not blank, without spaces at their ends.
#[derive(Clone)]
pub(super) struct Lines<'t> {
    lines: std::iter::Peekable<std::iter::Enumerate<std::str::Lines<'t>>>,
    /// Number of lines before the text.
    before: u64,
    /// Number of the line given last, from 1.
    line: u64,
}

impl<'t> Lines<'t> {
    /// The lines of a text that follows `before` lines of a file.
    pub(super) fn new(text: &'t str, before: u64) -> Self {
        Self { lines: text.lines().enumerate().peekable(), before, line: before }
    }

    /// The next line, which stays.
    pub(super) fn peek(&mut self) -> Option<&'t str> {
        while self.lines.next_if(|(_, line)| line.trim().is_empty()).is_some() {}
        self.lines.peek().map(|(_, line)| line.trim())
    }

    /// The place of the line given last.
    pub(super) fn place(&self) -> Place {
        Place::line(self.line)
    }

    /// The next line alone.
    pub(super) fn one(&mut self) -> Option<Self> {
        let line = self.next()?;
        let before = self.line - 1;
        Some(Self { lines: line.lines().enumerate().peekable(), before, line: before })
    }

    /// The place of the next line, or of the last one.
    pub(super) fn place_ahead(&mut self) -> Place {
        self.peek();
        let ahead = self.lines.peek().map(|(at, _)| self.before + *at as u64 + 1);
        Place::line(ahead.unwrap_or(self.line))
    }
}

impl<'t> Iterator for Lines<'t> {
    type Item = &'t str;

    fn next(&mut self) -> Option<&'t str> {
        self.peek()?;
        let (at, line) = self.lines.next()?;
        self.line = self.before + at as u64 + 1;
        Some(line.trim())
    }
}

/// Words of a text, separated by any white space.
#[derive(Clone)]
pub(super) struct Words<'t> {
    lines: Lines<'t>,
    words: std::str::SplitWhitespace<'t>,
}

impl<'t> Words<'t> {
    /// The words of these lines.
    pub(super) fn new(lines: Lines<'t>) -> Self {
        Self { lines, words: "".split_whitespace() }
    }

    /// The place of the word given last.
    pub(super) fn place(&self) -> Place {
        self.lines.place()
    }

    /// The lines after the last word, if it ended one.
    pub(super) fn lines(&self) -> Option<Lines<'t>> {
        self.words.clone().next().is_none().then(|| self.lines.clone())
    }
}

impl<'t> Iterator for Words<'t> {
    type Item = &'t str;

    fn next(&mut self) -> Option<&'t str> {
        loop {
            if let Some(word) = self.words.next() {
                return Some(word);
            }
            self.words = self.lines.next()?.split_whitespace();
        }
    }
}

/// A text in quotation marks, cut off.
pub(super) fn shown(text: &str) -> String {
    format!("'{}'", cut(text))
}

/// A text, cut off after 40 characters.
pub(super) fn cut(text: &str) -> Cow<'_, str> {
    match text.char_indices().nth(40) {
        Some((end, _)) => format!("{}…", &text[..end]).into(),
        None => text.into(),
    }
}

/// Refuses a long name that many records may repeat.
pub(super) fn name_fits(name: &str) -> Result<(), String> {
    if name.len() <= MAX_NAME {
        return Ok(());
    }
    Err(format!("expected a name of at most {MAX_NAME} bytes, got {} of {}", name.len(), shown(name)))
}

/// A finite number.
pub(super) fn number(text: &str) -> Result<f64, String> {
    let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
    value.ok_or_else(|| format!("expected a number, got {}", shown(text)))
}

/// A number of things.
pub(super) fn count(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| format!("expected a whole number, got {}", shown(text)))
}

/// A coordinate, or `None` for one of the words of a missing one: `NA`, `NaN`.
pub(super) fn coordinate(text: &str) -> Result<Option<f64>, String> {
    if is_missing(text) { Ok(None) } else { number(text).map(Some) }
}

/// Whether a text is one of the words of a missing value.
pub(super) fn is_missing(text: &str) -> bool {
    text.eq_ignore_ascii_case("na") || text.eq_ignore_ascii_case("nan")
}

/// Adds a point, of which all coordinates are given or none is.
pub(super) fn push(points: &mut Points, row: &[Option<f64>]) -> Result<(), String> {
    let given = row.iter().flatten().count();
    if given == row.len() {
        let row: Vec<f64> = row.iter().flatten().copied().collect();
        points.push(&row);
    } else if given == 0 {
        points.push_missing();
    } else {
        return Err(format!(
            "expected all coordinates of a point or none, got {given} of {} in point {}",
            row.len(),
            points.len()
        ));
    }
    Ok(())
}

/// By which coordinates a missing point is told, beside `NA` and `NaN`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Missing {
    /// By nothing else.
    Words,
    /// All coordinates are this number.
    Code(f64),
    /// All coordinates are negative.
    Negative,
}

impl Missing {
    /// The option `missing`, else the code of the format.
    pub(super) fn new(options: &ReadOptions, default: Self) -> Result<Self, FileError> {
        match options.missing.as_deref().map(str::trim) {
            None => Ok(default),
            Some("negative") => Ok(Self::Negative),
            Some(text) => number(text).map(Self::Code).map_err(|_| {
                let detail = format!("expected a number or 'negative' as missing, got {}", shown(text));
                FileError::new(FaultKind::Option, detail)
            }),
        }
    }

    /// Replaces the coordinates of a point by `None` if they say that it is missing.
    pub(super) fn apply(self, row: &mut [Option<f64>]) {
        let missing = match self {
            Self::Words => false,
            Self::Code(code) => row.iter().all(|x| *x == Some(code)),
            Self::Negative => row.iter().all(|x| x.is_some_and(|x| x < 0.0)),
        };
        if missing {
            row.fill(None);
        }
    }
}

/// An attribute: a Boolean or a number if it is written as one, else a text. Digits with leading zeros, and more of them than a
/// double holds, are names.
pub(super) fn value(text: &str) -> Value {
    match text {
        "true" | "TRUE" | "True" => return Value::Bool(true),
        "false" | "FALSE" | "False" => return Value::Bool(false),
        _ => {}
    }
    let digits = text.strip_prefix('-').unwrap_or(text);
    let whole = digits.split(['.', 'e', 'E']).next().unwrap_or_default();
    let is_plain = whole.bytes().all(|byte| byte.is_ascii_digit())
        && !whole.is_empty()
        && (whole == "0" || !whole.starts_with('0'))
        && digits.bytes().filter(u8::is_ascii_digit).count() <= 17;
    match number(text) {
        Ok(_) if is_plain && whole == digits => text.parse().map_or_else(|_| text.into(), Value::whole),
        Ok(number) if is_plain => Value::Number(number),
        _ => Value::Text(text.into()),
    }
}

/// An attribute as a text, which [`value`] reads.
pub(super) fn text_of(value: &Value) -> String {
    match value {
        Value::Bool(value) => value.to_string(),
        Value::Number(value) => value.to_string(),
        Value::Text(value) => value.clone(),
    }
}

/// Adds the coordinates of a point, each exact, and a line end.
pub(super) fn write_row(text: &mut String, row: &[f64], missing: &str) {
    for (k, x) in row.iter().enumerate() {
        let separator = if k == 0 { "" } else { " " };
        // Writing to a text cannot fail.
        let _ =
            if x.is_nan() { write!(text, "{separator}{missing}") } else { write!(text, "{separator}{x}") };
    }
    text.push('\n');
}

/// A text as a word: white space becomes `_`, and is counted.
pub(super) fn word(text: &str, summary: &mut Summary, place: &Place) -> String {
    if text.contains(char::is_whitespace) {
        summary.drop("spaces in names and labels, written as _", Some(text), || place.clone());
    }
    text.replace(char::is_whitespace, "_")
}

/// The name of a record in messages.
pub(super) fn title(record: &Record) -> String {
    record
        .name
        .as_ref()
        .map_or_else(|| "a shape without a name".into(), |name| format!("shape {}", shown(name)))
}

/// The points of a record for a format of points; outlines count as landmarks.
pub(super) fn points<'r>(record: &'r Record, summary: &mut Summary) -> Result<&'r Points, FileError> {
    match &record.geometry {
        Geometry::Landmarks(points) => Ok(points),
        Geometry::Curve { points, .. } => {
            let name = record.name.as_deref();
            summary.drop("curves written as landmarks", name, || record.place.clone());
            Ok(points)
        }
        Geometry::Mesh(_) | Geometry::Fourier(_) => Err(refused(record, "landmarks or a curve")),
    }
}

/// A record that a format cannot hold.
pub(super) fn refused(record: &Record, expected: &str) -> FileError {
    let kind = match &record.geometry {
        Geometry::Landmarks(_) => "landmarks",
        Geometry::Curve { .. } => "a curve",
        Geometry::Mesh(_) => "a mesh",
        Geometry::Fourier(_) => "Fourier coefficients",
    };
    unfit(record, format!("expected {expected}, got {kind}"))
}

/// A record that a format cannot hold, by name.
pub(super) fn unfit(record: &Record, detail: impl std::fmt::Display) -> FileError {
    FileError::unsupported(record.place.clone(), format!("{}: {detail}", title(record)))
}

/// Counts the content that a format has no place for. `kept`: parts of records, else keys of the metadata that are written.
pub(super) fn left_out(summary: &mut Summary, record: &Record, kept: &[&str]) {
    parts_left_out(summary, record, kept);
    for key in record.metadata.keys().filter(|key| !kept.contains(&key.as_str())) {
        summary.drop("metadata", Some(key), || record.place.clone());
    }
}

/// Counts the content that a format has no place for beside the metadata, which it counts itself. `kept`: parts of records that are written.
pub(super) fn parts_left_out(summary: &mut Summary, record: &Record, kept: &[&str]) {
    let parts = [
        ("label", record.label.is_some()),
        ("labels", !record.labels.is_empty()),
        ("subject", record.subject.is_some()),
        ("weight", record.weight.is_some()),
        ("ring", record.ring.is_some()),
    ];
    for (part, _) in parts.into_iter().filter(|(part, given)| *given && !kept.contains(part)) {
        summary.drop(part, record.name.as_deref(), || record.place.clone());
    }
}

/// Writes a text and ends the output.
pub(super) fn end(output: &mut dyn Write, text: &str) -> Result<(), FileError> {
    output.write_all(text.as_bytes())?;
    Ok(output.flush()?)
}

/// Shapes of one number of points and one dimension, as formats of matrices want them.
#[derive(Debug, Default)]
pub(super) struct Uniform(Option<(usize, usize)>);

impl Uniform {
    /// Number of points and dimension of the shapes so far.
    pub(super) fn size(&self) -> Option<(usize, usize)> {
        self.0
    }

    /// Refuses a shape that has another size than the first one.
    pub(super) fn check(&mut self, record: &Record, points: &Points) -> Result<(), FileError> {
        let size = (points.len(), points.dimension());
        let (count, dimension) = *self.0.get_or_insert(size);
        if size == (count, dimension) {
            return Ok(());
        }
        let detail = format!(
            "expected {count} points of {dimension} coordinates as in the first shape, got {} of {}",
            size.0, size.1
        );
        Err(unfit(record, detail))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attributes_are_numbers_only_where_nothing_is_lost() {
        for (text, expected) in [
            ("45.0", Value::Number(45.0)),
            ("-0.5", Value::Number(-0.5)),
            ("1e3", Value::Number(1000.0)),
            ("9007199254740991", Value::Number(9_007_199_254_740_991.0)),
            ("9007199254740993", "9007199254740993".into()),
            ("-90071992547409931", "-90071992547409931".into()),
            ("007", "007".into()),
            ("+1", "+1".into()),
            ("", "".into()),
            ("inf", "inf".into()),
            ("1.2.3", "1.2.3".into()),
            ("123456789012345678", "123456789012345678".into()),
            ("TRUE", Value::Bool(true)),
            ("f", "f".into()),
        ] {
            assert_eq!(value(text), expected, "{text}");
        }
    }

    #[test]
    fn lines_and_words_have_places() {
        let mut lines = Lines::new("a\r\n\n  b c \n", 2);
        assert_eq!((lines.peek(), lines.next(), lines.place().line), (Some("a"), Some("a"), Some(3)));
        assert_eq!((lines.next(), lines.place().line, lines.next()), (Some("b c"), Some(5), None));
        let mut words = Words::new(Lines::new("a\n\nb c", 0));
        assert_eq!((words.next(), words.next(), words.place().line), (Some("a"), Some("b"), Some(3)));
        assert_eq!((words.next(), words.next()), (Some("c"), None));
    }

    #[test]
    fn long_texts_are_cut_off_between_characters() {
        assert_eq!(shown(&"ä".repeat(41)), format!("'{}…'", "ä".repeat(40)));
        assert_eq!(shown("ä"), "'ä'");
    }
}
