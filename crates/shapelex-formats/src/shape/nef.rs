//! Elliptic Fourier coefficients of SHAPE.
//!
//! ```text
//! #CONST 1 1 1 0        which of a_1, b_1, c_1, d_1 are the same in all shapes
//! #HARMO 20             number of harmonics
//! name
//!   a_1 b_1 c_1 d_1     x(t) = Σ a_k cos 2πkt + b_k sin 2πkt,  y(t) = Σ c_k cos 2πkt + d_k sin 2πkt
//!   …
//! ```

use std::io::Write;

use super::format::Format;
use super::limits::Limits;
use super::options::{ReadOptions, WriteOptions};
use super::record::Sink;
use super::record::{Fourier, Geometry, Kind, Record};
use super::source::Source;
use super::text::{self, Lines, shown};
use super::write::{Opened, Output, Writer};
use crate::error::{FileError, Place};
use crate::summary::Summary;

/// Elliptic Fourier coefficients.
pub(super) static FORMAT: Format = Format {
    id: "nef",
    name: "Fourier coefficients (NEF)",
    media_types: &["application/x-nef"],
    extensions: &["nef"],
    recognise: |head| {
        let start = head.trim_ascii_start();
        start.starts_with(b"#CONST") || start.starts_with(b"#HARMO")
    },
    kinds: &[Kind::Fourier],
    options: &[],
    read: Some(read),
    open: Some(open),
};

/// Maximum number of rows of a file that is written: shapes with few harmonics get the zeros of that with most of them.
const MAX_ROWS: usize = 1 << 26;

fn read(source: &mut Source<'_>, options: &ReadOptions, sink: Sink<'_>) -> Result<Summary, FileError> {
    let limits = *source.limits();
    let text = source.text()?;
    let mut lines = Lines::new(&text, 0);
    let mut summary = Summary::default();
    let mut harmonics = None;
    while let Some(line) = lines.peek().filter(|line| line.starts_with('#')) {
        lines.next();
        let malformed = |detail| FileError::malformed(lines.place(), detail);
        let mut words = line.split_whitespace();
        let (key, words) = (words.next().unwrap_or_default(), words);
        let numbers = || words.map(text::count).collect::<Result<Vec<_>, _>>().map_err(malformed);
        match key {
            "#CONST" => summary.set("constant_coefficients", numbers()?),
            "#HARMO" => match numbers()?[..] {
                [0] => return Err(malformed("expected at least one harmonic, got 0".into())),
                [count] => harmonics = Some(limits.points(count, || lines.place())? as u64),
                _ => return Err(malformed(format!("expected #HARMO and a number, got {}", shown(line)))),
            },
            _ => summary.drop("comments", Some(line), || lines.place()),
        }
    }
    let mut item = 0;
    while let Some(name) = lines.next() {
        let place = Place { item: Some(item), ..lines.place() };
        item += 1;
        match shape(&mut lines, name, &place, harmonics, &limits) {
            Ok(fourier) => sink(Record { name: Some(name.into()), ..Record::new(fourier, place) })?,
            Err(error) => {
                options.leave_out(error, &mut summary)?;
                skip(&mut lines, harmonics);
            }
        }
    }
    summary.set("centre", "not in files of this format: 0");
    Ok(summary)
}

/// The coefficients that follow a name. The line of a fault stays.
fn shape(
    lines: &mut Lines<'_>,
    name: &str,
    place: &Place,
    harmonics: Option<u64>,
    limits: &Limits,
) -> Result<Fourier, FileError> {
    let mut fourier = Fourier { constant: vec![0.0; 2], cosine: Vec::new(), sine: Vec::new() };
    let mut found = 0;
    while harmonics.is_none_or(|harmonics| found < harmonics) {
        // Without a number of harmonics, a line of anything but four numbers is the next name.
        let Some(line) = lines.peek().filter(|line| harmonics.is_some() || four(line).is_ok()) else {
            break;
        };
        let [a, b, c, d] = four(line).map_err(|detail| FileError::malformed(lines.place_ahead(), detail))?;
        lines.next();
        fourier.cosine.extend([a, c]);
        fourier.sine.extend([b, d]);
        found += 1;
        limits.points(found, || place.clone())?;
    }
    match harmonics {
        Some(harmonics) if found < harmonics => {
            let detail = format!("expected {harmonics} harmonics, got the end of the file after {found}");
            Err(FileError::truncated(place.clone(), detail))
        }
        None if found == 0 => {
            let detail = format!("expected lines of four coefficients after {}, got none", shown(name));
            Err(FileError::malformed(place.clone(), detail))
        }
        _ => Ok(fourier),
    }
}

/// Passes over the rest of a broken shape: its next name is the line before as many lines of coefficients as there are harmonics.
fn skip(lines: &mut Lines<'_>, harmonics: Option<u64>) {
    let Some(harmonics) = harmonics else { return };
    loop {
        while lines.peek().is_some_and(|line| four(line).is_ok()) {
            lines.next();
        }
        let mut ahead = lines.clone();
        if ahead.next().is_none() || ahead.take_while(|line| four(line).is_ok()).count() as u64 == harmonics {
            return;
        }
        lines.next();
    }
}

/// The four coefficients of a harmonic.
fn four(line: &str) -> Result<[f64; 4], String> {
    let mut row = [0.0; 4];
    let mut words = line.split_whitespace();
    for coefficient in &mut row {
        let word = words.next().ok_or_else(|| format!("expected four coefficients, got {}", shown(line)))?;
        *coefficient = text::number(word)?;
    }
    match words.next() {
        None => Ok(row),
        Some(_) => Err(format!("expected four coefficients, got {}", shown(line))),
    }
}

struct Nef<'a> {
    output: Output<'a>,
    /// Names, and the four coefficients of each harmonic.
    shapes: Vec<(String, Vec<[f64; 4]>)>,
    /// Number of harmonics that is asked for.
    harmonics: Option<usize>,
    /// Number of shapes that lose harmonics, and the largest share of Σ a² + b² + c² + d² that one loses.
    cut: (u64, f64),
    held: usize,
    summary: Summary,
}

fn open<'a>(output: Output<'a>, options: &WriteOptions) -> Opened<'a> {
    Ok(Box::new(Nef {
        output,
        shapes: Vec::new(),
        harmonics: options.harmonics,
        cut: (0, 0.0),
        held: 0,
        summary: Summary::default(),
    }))
}

impl Writer for Nef<'_> {
    fn push(&mut self, record: &Record) -> Result<(), FileError> {
        let Geometry::Fourier(fourier) = &record.geometry else {
            return Err(text::refused(record, "Fourier coefficients"));
        };
        if fourier.dimension() != 2 {
            let detail =
                format!("expected coefficients in the plane, got {} dimensions", fourier.dimension());
            return Err(text::unfit(record, detail));
        }
        if fourier.constant.iter().any(|x| *x != 0.0) {
            self.summary.drop("centres", record.name.as_deref(), || record.place.clone());
        }
        let pairs = fourier.cosine.chunks_exact(2).zip(fourier.sine.chunks_exact(2));
        let mut rows: Vec<_> = pairs.map(|(cosine, sine)| [cosine[0], sine[0], cosine[1], sine[1]]).collect();
        if let Some(harmonics) = self.harmonics {
            let rest = rows.get(harmonics..).unwrap_or_default();
            if rest.iter().flatten().any(|x| *x != 0.0) {
                let largest = rows.iter().flatten().fold(0.0, |largest: f64, x| largest.max(x.abs()));
                let power =
                    |rows: &[[f64; 4]]| rows.iter().flatten().map(|x| (x / largest).powi(2)).sum::<f64>();
                self.cut = (self.cut.0 + 1, self.cut.1.max(power(rest) / power(&rows)));
                self.summary.drop("shapes cut off at a number of harmonics", record.name.as_deref(), || {
                    record.place.clone()
                });
            }
            rows.truncate(harmonics);
        }
        let name = record.name.as_deref().map(|name| name.split_whitespace().collect::<Vec<_>>().join(" "));
        let name =
            name.filter(|name| !name.is_empty()).unwrap_or_else(|| (self.shapes.len() + 1).to_string());
        if name.starts_with('#') {
            return Err(text::unfit(
                record,
                "expected a name that does not begin with '#', got one that does",
            ));
        }
        self.held += record.bytes();
        self.shapes.push((name, rows));
        text::left_out(&mut self.summary, record, &[]);
        self.summary.records += 1;
        Ok(())
    }

    fn held(&self) -> usize {
        self.held
    }

    fn finish(mut self: Box<Self>) -> Result<Summary, FileError> {
        let most = self.shapes.iter().map(|(_, rows)| rows.len()).max().unwrap_or(0);
        let harmonics = self.harmonics.unwrap_or(most).max(1);
        if self.shapes.len().saturating_mul(harmonics) > MAX_ROWS {
            let detail = format!(
                "expected at most {MAX_ROWS} harmonics of all shapes of a file, got {harmonics} for each of {}",
                self.shapes.len()
            );
            return Err(FileError::too_large(Place::default(), detail));
        }
        let first = |rows: &[[f64; 4]]| rows.first().is_some_and(|row| row[..3] == [1.0, 0.0, 0.0]);
        let normal = !self.shapes.is_empty() && self.shapes.iter().all(|(_, rows)| first(rows));
        let constant = if normal { "1 1 1 0" } else { "0 0 0 0" };
        let mut text = format!("#CONST {constant}\n#HARMO {harmonics}\n");
        for (name, rows) in &self.shapes {
            text.push_str(&format!("{name}\n"));
            for row in rows.iter().chain(std::iter::repeat(&[0.0; 4])).take(harmonics) {
                let [a, b, c, d] = row;
                text.push_str(&format!("  {a:e}  {b:e}  {c:e}  {d:e}\n"));
            }
            // One shape at a time: zeros of many harmonics are not held.
            self.output.write_all(text.as_bytes())?;
            text.clear();
        }
        text::end(&mut self.output, &text)?;
        if self.cut.0 > 0 {
            self.summary.warnings.push(format!(
                "{} shapes have more than {harmonics} harmonics; the rest is at most {:.3e} of the squared size of one",
                self.cut.0, self.cut.1
            ));
        }
        Ok(self.summary)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{check_truncations, converted, fault, records, written};
    use super::*;
    use crate::error::FaultKind;

    const TWO: &str = concat!(
        "#CONST 1 1 1 0\n#HARMO 2\nleaf 1\n  1e0  0e0  0e0  -5e-1\n  1.25e-2  2e-1  0e0  1e-300\n",
        "b\n  1e0  0e0  0e0  1e0\n  0e0  0e0  0e0  0e0\n",
    );

    #[test]
    fn a_file_is_written_as_it_was_read() {
        let (found, summary) = records(&FORMAT, TWO, &ReadOptions::default()).expect("a valid file");
        let Geometry::Fourier(fourier) = &found[0].geometry else { panic!("coefficients") };
        assert_eq!(
            (&fourier.cosine[..], &fourier.sine[..]),
            (&[1.0, 0.0, 0.0125, 0.0][..], &[0.0, -0.5, 0.2, 1e-300][..])
        );
        assert_eq!(converted(&FORMAT, &found), TWO);
        assert_eq!(summary.properties["constant_coefficients"], serde_json::json!([1, 1, 1, 0]));
        // Without a header the names end the coefficients.
        let bare = TWO.split_once("leaf").expect("a header").1;
        let (bare, _) =
            records(&FORMAT, &format!("leaf{bare}"), &ReadOptions::default()).expect("a valid file");
        assert_eq!(
            bare.iter().map(|r| &r.geometry).collect::<Vec<_>>(),
            found.iter().map(|r| &r.geometry).collect::<Vec<_>>()
        );
    }

    #[test]
    fn what_a_number_of_harmonics_loses_is_said() {
        let (mut found, _) = records(&FORMAT, TWO, &ReadOptions::default()).expect("a valid file");
        let options = WriteOptions { harmonics: Some(1), ..WriteOptions::default() };
        let (text, summary) = written(&FORMAT, &found, &options).expect("written");
        assert_eq!(
            text,
            "#CONST 1 1 1 0\n#HARMO 1\nleaf 1\n  1e0  0e0  0e0  -5e-1\nb\n  1e0  0e0  0e0  1e0\n"
        );
        // 0.2² + 0.0125² of 1 + 0.5² + 0.2² + 0.0125².
        let expected =
            "1 shapes have more than 1 harmonics; the rest is at most 3.113e-2 of the squared size of one";
        assert_eq!(
            (summary.dropped[0].names.as_slice(), summary.warnings[0].as_str()),
            (&["leaf 1".into()][..], expected)
        );
        let more = WriteOptions { harmonics: Some(3), ..WriteOptions::default() };
        let (text, summary) = written(&FORMAT, &found, &more).expect("written");
        assert!(text.contains("#HARMO 3") && summary.warnings.is_empty() && summary.dropped.is_empty());
        for harmonics in [0, 1025, usize::MAX] {
            let options = WriteOptions { harmonics: Some(harmonics), ..WriteOptions::default() };
            let refused = written(&FORMAT, &found, &options).expect_err("out of bounds").to_string();
            assert_eq!(refused, format!("harmonics: expected 1 to 1024 harmonics, got {harmonics}"));
        }
        let Geometry::Fourier(fourier) = &mut found[0].geometry else { panic!("coefficients") };
        fourier.constant[1] = 2.0;
        let (text, summary) = written(&FORMAT, &found, &WriteOptions::default()).expect("written");
        assert_eq!((text.as_str(), summary.dropped[0].what.as_str()), (TWO, "centres"));
    }

    #[test]
    fn one_shape_with_many_harmonics_does_not_make_all_others_long() {
        let fourier = |harmonics: usize| Fourier {
            constant: vec![0.0; 2],
            cosine: vec![1.0; 2 * harmonics],
            sine: vec![0.0; 2 * harmonics],
        };
        let mut output = Vec::new();
        let mut writer = FORMAT.writer(&mut output, &WriteOptions::default()).expect("a writer");
        for harmonics in std::iter::once(70_000).chain(std::iter::repeat_n(1, 999)) {
            writer.push(&Record::new(fourier(harmonics), Place::default())).expect("held");
        }
        assert_eq!(writer.held(), 70_999 * 32 + 1000 * 64);
        let error = writer.finish().expect_err("70 million rows");
        assert_eq!(error.kind, FaultKind::TooLarge);
        let expected =
            "expected at most 67108864 harmonics of all shapes of a file, got 70000 for each of 1000";
        assert_eq!((error.to_string().as_str(), output.len()), (expected, 0));
    }

    #[test]
    fn faults_name_their_line() {
        for (text, message) in [
            (
                "#HARMO 2\na\n1 0 0 1\n",
                "item 0, line 2: expected 2 harmonics, got the end of the file after 1",
            ),
            ("#HARMO 1\na\n1 0 0\n", "line 3: expected four coefficients, got '1 0 0'"),
            ("#HARMO 1\na\n1 0 0 1 2\n", "line 3: expected four coefficients, got '1 0 0 1 2'"),
            ("#HARMO 1\na\n1 0 0 nan\n", "line 3: expected a number, got 'nan'"),
            ("#HARMO x\n", "line 1: expected a whole number, got 'x'"),
            ("#HARMO 0\na\n", "line 1: expected at least one harmonic, got 0"),
            ("#HARMO 1 2\n", "line 1: expected #HARMO and a number, got '#HARMO 1 2'"),
            ("#HARMO 99999999999\n", "line 1: expected at most 4194304 points of a shape, got 99999999999"),
            ("a\nb\n", "item 0, line 1: expected lines of four coefficients after 'a', got none"),
            ("a\n1 0 0 1e200\n", "item 0, line 1: expected coefficients within ±1e100, got 1e200"),
        ] {
            assert_eq!(fault(&FORMAT, text, &ReadOptions::default()), message);
        }
        check_truncations(&FORMAT, TWO.as_bytes());
    }
}
