//! NTS: matrices of landmarks of NTSYSpc, also as `.dta` of Landmark Editor.
//!
//! ```text
//! "a comment
//! 1 2L 4 1 9999 DIM=2     rectangular matrix, rows, columns, missing values: their code, dimension
//! a b                     labels of the rows
//! 1 2 3 4
//! 9999 9999 7 8
//! ```
//!
//! `L` after the number of rows or columns: their labels come before the matrix. `B`, `E`: at the beginning or the end of each row.

use std::fmt::Write as _;

use super::format::Format;
use super::limits::Limits;
use super::options::{ReadOptions, WriteOptions};
use super::record::Sink;
use super::record::{Geometry, Kind, Points, Record};
use super::source::Source;
use super::text::{self, Lines, Missing, Uniform, Words, coordinate, shown};
use super::write::{Opened, Output, Writer};
use crate::error::{FaultKind, FileError, Place};
use crate::summary::Summary;

/// NTS.
pub(super) static FORMAT: Format = Format {
    id: "nts",
    name: "NTS",
    media_types: &["application/x-nts"],
    extensions: &["nts", "dta"],
    recognise: |head| {
        let text = String::from_utf8_lossy(head);
        let mut lines = Lines::new(&text, 0).filter(|line| !is_comment(line));
        lines.next().is_some_and(|line| line.starts_with("1 ") && line.to_uppercase().contains("DIM="))
    },
    kinds: &[Kind::Landmarks],
    options: &["dimension", "missing"],
    read: Some(read),
    open: Some(open),
};

/// Where labels are.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Labels {
    None,
    Before,
    Beginning,
    End,
}

/// The first line.
struct Header {
    rows: u64,
    row_labels: Labels,
    columns: u64,
    column_labels: Labels,
    missing: Option<f64>,
    dimension: Option<usize>,
}

fn is_comment(line: &str) -> bool {
    line.starts_with(['"', '\''])
}

fn header(line: &str) -> Result<Header, String> {
    let mut words = line.split_whitespace();
    let mut next =
        |what: &str| words.next().ok_or_else(|| format!("expected {what}, got the end of the header"));
    let kind = next("the type of the matrix")?;
    if kind != "1" {
        return Err(format!("expected 1, a rectangular matrix, got {}", shown(kind)));
    }
    let (rows, row_labels) = size(next("the number of rows")?)?;
    let (columns, column_labels) = size(next("the number of columns")?)?;
    let has_missing = match next("whether values are missing")? {
        "0" => false,
        "1" => true,
        other => return Err(format!("expected 0 or 1 for missing values, got {}", shown(other))),
    };
    let missing = if has_missing { Some(text::number(next("the code of missing values")?)?) } else { None };
    let dimension = match words.next().map(|word| (word, word.to_uppercase())) {
        None => None,
        Some((word, upper)) => match upper.strip_prefix("DIM=").and_then(|size| size.parse().ok()) {
            Some(size @ 1..=3) => Some(size),
            _ => return Err(format!("expected DIM=2 or DIM=3, got {}", shown(word))),
        },
    };
    Ok(Header { rows, row_labels, columns, column_labels, missing, dimension })
}

/// A number of rows or columns with the place of their labels.
fn size(word: &str) -> Result<(u64, Labels), String> {
    let (digits, labels) = match word.as_bytes().last() {
        Some(b'L' | b'l') => (&word[..word.len() - 1], Labels::Before),
        Some(b'B' | b'b') => (&word[..word.len() - 1], Labels::Beginning),
        Some(b'E' | b'e') => (&word[..word.len() - 1], Labels::End),
        _ => (word, Labels::None),
    };
    Ok((text::count(digits)?, labels))
}

fn read(source: &mut Source<'_>, options: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let text = source.text()?;
    let mut lines = Lines::new(&text, 0);
    while lines.peek().is_some_and(is_comment) {
        lines.next();
    }
    let Some(first) = lines.next() else {
        return Err(FileError::truncated(lines.place(), "expected a header, got the end of the file"));
    };
    let at_header = |detail| FileError::malformed(lines.place(), detail);
    let header = header(first).map_err(at_header)?;
    let Some(dimension) = header.dimension.or(options.dimension) else {
        return Err(at_header("expected DIM= in the header or the option dimension, got neither".into()));
    };
    if dimension == 0
        || !header.columns.is_multiple_of(dimension as u64)
        || (header.columns == 0 && header.rows > 0)
    {
        let detail = format!("expected a multiple of {dimension} columns, got {}", header.columns);
        return Err(at_header(detail));
    }
    let missing = Missing::new(options, Missing::Words)?;
    let mut matrix = Matrix { words: Words::new(lines), is_line: false, header, dimension, missing };
    let mut summary = Summary::default();
    summary.set("dimension", dimension);
    matrix.read(&limits, options, &mut summary, sink)?;
    Ok(summary)
}

struct Matrix<'t> {
    words: Words<'t>,
    /// Whether the words are those of one row.
    is_line: bool,
    header: Header,
    dimension: usize,
    missing: Missing,
}

impl<'t> Matrix<'t> {
    fn read(
        &mut self,
        limits: &Limits,
        options: &ReadOptions,
        summary: &mut Summary,
        sink: Sink<'_>,
    ) -> Result<(), FileError> {
        // A matrix of one landmark a row is one specimen.
        let is_one = self.header.columns == self.dimension as u64 && self.header.rows > 1;
        let width = self.header.columns / self.dimension as u64;
        let count = if is_one { self.header.rows } else { width };
        limits.points(count, || self.words.place())?;
        let labels = self.labels(summary)?;
        if is_one {
            let record = self.one(labels)?;
            return sink(record);
        }
        let (rows, mut labels) = (self.header.rows, labels.into_iter());
        // Where rows are lines, one of too few or too many values leaves the others readable.
        let mut lines = self.words.lines().filter(|_| options.skips_broken());
        lines = lines.filter(|lines| lines.clone().count() as u64 == rows);
        for item in 0..rows {
            if let Some(line) = lines.as_mut().and_then(Lines::one) {
                (self.words, self.is_line) = (Words::new(line), true);
            }
            match self.row(item, width, labels.next()) {
                Ok(record) => sink(record)?,
                Err(error) => options.leave_out(error, summary)?,
            }
        }
        self.end()
    }

    /// Labels of the rows that stand before the matrix.
    fn labels(&mut self, summary: &mut Summary) -> Result<Vec<&'t str>, FileError> {
        let mut labels = Vec::new();
        if self.header.row_labels == Labels::Before {
            for _ in 0..self.header.rows {
                labels.push(self.word("labels of the rows")?);
            }
        }
        if self.header.column_labels == Labels::Before {
            for _ in 0..self.header.columns {
                let label = self.word("labels of the columns")?;
                summary.drop("labels of columns", Some(label), || self.words.place());
            }
        }
        Ok(labels)
    }

    /// The specimen of a matrix of one landmark a row. Labels of the rows name the landmarks.
    fn one(&mut self, labels: Vec<&'t str>) -> Result<Record, FileError> {
        let mut names = labels;
        let (mut points, mut place) = (Points::new(self.dimension), self.words.place());
        for _ in 0..self.header.rows {
            if self.header.row_labels == Labels::Beginning {
                names.push(self.word("a label")?);
            }
            self.point(&mut points)?;
            place = self.words.place();
            if self.header.row_labels == Labels::End {
                names.push(self.word("a label")?);
            }
        }
        self.end()?;
        let mut record = Record::new(Geometry::Landmarks(points), Place { item: Some(0), ..place });
        if !names.is_empty() {
            record.metadata.insert("landmark_names".into(), names.into());
        }
        Ok(record)
    }

    /// The specimen of a row of `width` points. Other text than a number leaves the words after the row to the next one.
    fn row(&mut self, item: u64, width: u64, label: Option<&'t str>) -> Result<Record, FileError> {
        let (mut points, mut name, mut broken) = (Points::new(self.dimension), label, None);
        if self.header.row_labels == Labels::Beginning {
            name = Some(self.word("a label")?);
        }
        for _ in 0..width {
            match self.point(&mut points) {
                Err(error) if error.kind == FaultKind::Malformed && !self.is_line => {
                    broken.get_or_insert(error);
                }
                found => found?,
            }
        }
        let place = Place { item: Some(item), ..self.words.place() };
        if self.header.row_labels == Labels::End {
            name = Some(self.word("a label")?);
        }
        if let Some(word) = self.is_line.then(|| self.words.next()).flatten() {
            let detail =
                format!("expected {} values of a row, got {} more", self.header.columns, shown(word));
            return Err(FileError::malformed(self.words.place(), detail));
        }
        let record = Record::new(Geometry::Landmarks(points), place);
        broken.map_or_else(|| Ok(Record { name: name.map(str::to_owned), ..record }), Err)
    }

    /// Refuses words after the last row.
    fn end(&mut self) -> Result<(), FileError> {
        let Some(word) = self.words.next() else { return Ok(()) };
        let detail =
            format!("expected the end of the file after {} rows, got {}", self.header.rows, shown(word));
        Err(FileError::malformed(self.words.place(), detail))
    }

    fn word(&mut self, what: &str) -> Result<&'t str, FileError> {
        let (kind, end) =
            if self.is_line { (FaultKind::Malformed, "line") } else { (FaultKind::Truncated, "file") };
        self.words.next().ok_or_else(|| {
            FileError::of(kind, self.words.place(), format!("expected {what}, got the end of the {end}"))
        })
    }

    fn point(&mut self, points: &mut Points) -> Result<(), FileError> {
        let mut words = Vec::with_capacity(self.dimension);
        for _ in 0..self.dimension {
            words.push((self.word("a number")?, self.words.place()));
        }
        let mut row = Vec::with_capacity(self.dimension);
        for (word, place) in words {
            let x = coordinate(word).map_err(|detail| FileError::malformed(place, detail))?;
            row.push(x.filter(|x| Some(*x) != self.header.missing));
        }
        self.missing.apply(&mut row);
        text::push(points, &row).map_err(|detail| FileError::malformed(self.words.place(), detail))
    }
}

/// Codes of missing values, the first of which that is not a coordinate is written.
const CODES: [f64; 6] = [9999.0, -9999.0, 99999.0, -99999.0, 999_999.0, -999_999.0];

struct Nts<'a> {
    output: Output<'a>,
    size: Uniform,
    /// One row a shape; `?` for a missing coordinate.
    rows: String,
    names: Vec<Option<String>>,
    has_missing: bool,
    /// Which codes are coordinates.
    taken: [bool; CODES.len()],
    held: usize,
    summary: Summary,
}

fn open<'a>(output: Output<'a>, _: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(Nts {
        output,
        size: Uniform::default(),
        rows: String::new(),
        names: Vec::new(),
        has_missing: false,
        taken: [false; CODES.len()],
        held: 0,
        summary: Summary::default(),
    }))
}

impl Writer for Nts<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let points = text::points(record, &mut self.summary)?;
        self.size.check(record, points)?;
        if !(2..=3).contains(&points.dimension()) || points.len() < 2 {
            let detail = format!(
                "expected 2 or more points of 2 or 3 coordinates, got {} of {}",
                points.len(),
                points.dimension()
            );
            return Err(text::unfit(record, detail));
        }
        text::write_row(&mut self.rows, points.coordinates(), "?");
        self.has_missing |= points.coordinates().iter().any(|x| x.is_nan());
        for (code, taken) in CODES.iter().zip(&mut self.taken) {
            *taken |= points.coordinates().contains(code);
        }
        let name = record.name.as_deref().filter(|name| !name.is_empty());
        self.names.push(name.map(|name| text::word(name, &mut self.summary, &record.place)));
        text::left_out(&mut self.summary, record, &[]);
        self.held += record.bytes();
        self.summary.records += 1;
        Ok(())
    }

    fn held(&self) -> usize {
        self.held
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        let (points, dimension) = self.size.size().unwrap_or((0, 2));
        let named = self.names.iter().flatten().count();
        let labels = if named == self.names.len() && named > 0 { "L" } else { "" };
        if labels.is_empty() && named > 0 {
            self.summary.drop("names, as not all shapes have one", None, Place::default);
        }
        let code = CODES.iter().zip(self.taken).find(|(_, taken)| !taken).map(|(code, _)| code);
        let (missing, word) = match code {
            _ if !self.has_missing => ("0".into(), String::new()),
            Some(code) => (format!("1 {code}"), code.to_string()),
            None => ("0".into(), "NA".into()),
        };
        let columns = points * dimension;
        let mut text = format!("1 {}{labels} {columns} {missing} DIM={dimension}\n", self.names.len());
        if !labels.is_empty() {
            for name in self.names.iter().flatten() {
                // Writing to a text cannot fail.
                let _ = writeln!(text, "{name}");
            }
        }
        text.push_str(&self.rows.replace('?', &word));
        text::end(&mut self.output, &text)?;
        Ok(self.summary)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{check_truncations, converted, fault, records, written};
    use super::*;

    const TWO: &str = "1 2L 4 1 9999 DIM=2\na\nb\n1 2.5 3 4\n9999 9999 -7 8e-3\n";

    #[test]
    fn a_file_is_written_as_it_was_read() {
        let text = TWO.replace("8e-3", "0.008");
        let (found, summary) = records(&FORMAT, TWO, &ReadOptions::default()).expect("a valid file");
        assert_eq!((converted(&FORMAT, &found), summary.properties["dimension"].as_u64()), (text, Some(2)));
        assert!((FORMAT.recognise)(TWO.as_bytes()));
        // A coordinate that is the usual code makes the writer take another one.
        let other = "1 1 4 1 -9999 DIM=2\n9999 1 -9999 -9999\n";
        let (found, _) = records(&FORMAT, other, &ReadOptions::default()).expect("a valid file");
        assert_eq!(converted(&FORMAT, &found), other);
    }

    #[test]
    fn labels_may_be_in_the_rows() {
        for text in [
            "\"made by hand\n'and by foot\n1 2B 4L 0 dim=2\nx1 y1 x2 y2\na 1 2 3 4\nb NA NA\n7 8",
            "1 2E 4 0 Dim=2 1 2 3 4 a NA NA 7 8 b",
        ] {
            let text = text.replace("Dim=2 ", "Dim=2\n");
            let (found, summary) = records(&FORMAT, &text, &ReadOptions::default()).expect("a valid file");
            let names: Vec<_> = found.iter().filter_map(|record| record.name.as_deref()).collect();
            assert_eq!(names, ["a", "b"]);
            let Geometry::Landmarks(points) = &found[1].geometry else { panic!("landmarks") };
            assert_eq!((points.missing(), points.coordinates()[3]), (vec![0], 8.0));
            assert_eq!(
                summary.dropped.first().map_or(0, |dropped| dropped.count),
                if text.contains("x1") { 4 } else { 0 }
            );
        }
    }

    #[test]
    fn a_matrix_of_one_landmark_a_row_is_one_specimen() {
        let text = "1 2L 3 0 dim=3\nnose chin\n1 2 3\n4 5 6\n";
        let (found, _) = records(&FORMAT, text, &ReadOptions::default()).expect("a valid file");
        assert_eq!(
            (found.len(), &found[0].metadata["landmark_names"]),
            (1, &serde_json::json!(["nose", "chin"]))
        );
        let Geometry::Landmarks(points) = &found[0].geometry else { panic!("landmarks") };
        assert_eq!(points.coordinates(), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
    }

    #[test]
    fn faults_name_their_line() {
        for (text, message) in [
            ("", "line 0: expected a header, got the end of the file"),
            ("2 1 1 0 DIM=2", "line 1: expected 1, a rectangular matrix, got '2'"),
            ("1 1 4 0", "line 1: expected DIM= in the header or the option dimension, got neither"),
            ("1 1 5 0 DIM=2", "line 1: expected a multiple of 2 columns, got 5"),
            ("1 1 0 0 DIM=2", "line 1: expected a multiple of 2 columns, got 0"),
            ("1 1 4 0 DIM=4", "line 1: expected DIM=2 or DIM=3, got 'DIM=4'"),
            ("1 1 4 2 DIM=2", "line 1: expected 0 or 1 for missing values, got '2'"),
            ("1 L 4 0 DIM=2", "line 1: expected a whole number, got ''"),
            ("1 1 999999998 0 DIM=2", "line 1: expected at most 4194304 points of a shape, got 499999999"),
            ("1 1 4 0 DIM=2\n1 2 3", "line 2: expected a number, got the end of the file"),
            ("1 1 4 0 DIM=2\n1 2 3 x", "line 2: expected a number, got 'x'"),
            (
                "1 1 4 0 DIM=2\n1 2 3 NA",
                "line 2: expected all coordinates of a point or none, got 1 of 2 in point 1",
            ),
            ("1 1 4 0 DIM=2\n1 2 3 4\n5", "line 3: expected the end of the file after 1 rows, got '5'"),
            ("1 99999999L 4 0 DIM=2\na", "line 2: expected labels of the rows, got the end of the file"),
        ] {
            assert_eq!(fault(&FORMAT, text, &ReadOptions::default()), message);
        }
        check_truncations(&FORMAT, TWO.as_bytes());
    }

    #[test]
    fn shapes_that_do_not_fit_are_refused_by_name() {
        let (mut found, _) = records(&FORMAT, TWO, &ReadOptions::default()).expect("a valid file");
        found[1].geometry = Geometry::Landmarks(Points::from_rows(2, vec![0.0; 6]));
        let error = written(&FORMAT, &found, &WriteOptions::default()).expect_err("another size");
        let expected = "shape 'b': expected 2 points of 2 coordinates as in the first shape, got 3 of 2";
        assert!(error.to_string().ends_with(expected), "{error}");
    }
}
