//! Names, units, subjects and classes come back from every format that has a place for them; what has none is counted.

use shapelex_formats::shape::{
    FORMATS, Format, Kind, Limits, ReadOptions, Record, Source, Summary, WriteOptions, read,
};
use shapelex_formats::unit::Unit;

use crate::whole::record;

/// Page with the table of what comes back.
const PAGE: &str = include_str!("../../../../docs/formats/README.md");
/// Formats that take other shapes: Fourier coefficients, outlines along the edges of cells, contours on the images of a series.
const OTHERS: [&str; 3] = ["nef", "chc", "rtstruct"];
/// Units of which one is a length.
const UNITS: [Unit; 2] = [Unit::Millimetre, Unit::Pixel];

/// Two shapes that differ in all of these.
fn records(kind: Kind, dimension: usize, unit: Unit) -> Vec<Record> {
    let record = |k: usize| Record {
        unit: Some(unit),
        subject: Some(format!("subject{k}")),
        label: Some(["left", "right"][k].into()),
        ..record(kind, dimension, k)
    };
    (0..2).map(record).collect()
}

/// The records as a file, with what the writer says; none if the format has no such shapes.
fn written(format: &'static Format, records: &[Record]) -> Option<(Vec<u8>, Summary)> {
    let mut bytes = Vec::new();
    let unit = records[0].unit.map(|unit| unit.word().to_owned());
    let mut writer = format.writer(&mut bytes, &WriteOptions { unit, ..WriteOptions::default() }).ok()?;
    for record in records {
        writer.push(record).ok()?;
    }
    let summary = writer.finish().ok()?;
    Some((bytes, summary))
}

fn found(format: &'static Format, bytes: &[u8]) -> Option<Vec<Record>> {
    let mut source = Source::new(bytes, Limits::default()).ok()?;
    let mut records = Vec::new();
    let read = read(format, &mut source, &ReadOptions::default(), &mut |record| {
        records.push(record);
        Ok(())
    });
    read.ok().map(|_| records)
}

/// Whether name, unit, subject and class come back of shapes of a kind in a unit; none if the format has no such shapes.
fn kept(format: &'static Format, kind: Kind, dimension: usize, unit: Unit) -> Option<[bool; 4]> {
    // Formats of one shape a file take the first one.
    let mut sent = records(kind, dimension, unit);
    let (bytes, summary) = written(format, &sent).or_else(|| {
        sent.truncate(1);
        written(format, &sent)
    })?;
    let back = found(format, &bytes)?;
    assert_eq!(back.len(), sent.len(), "{}: {kind:?}", format.id);
    let all = |same: &dyn Fn(&Record, &Record) -> bool| sent.iter().zip(&back).all(|(a, b)| same(a, b));
    let dropped: Vec<&str> = summary.dropped.iter().map(|dropped| dropped.what.as_str()).collect();
    let check = |is_kept: bool, words: &[&str]| {
        let is_told = dropped.iter().any(|what| words.iter().any(|word| what.contains(word)));
        assert!(
            is_kept || is_told,
            "{}: {words:?} of {kind:?} are lost, and not counted: {dropped:?}",
            format.id
        );
        is_kept
    };
    let name = all(&|a, b| a.name == b.name);
    // A file of one shape names it, and the rings of a specimen have names behind that of the specimen.
    let is_named =
        all(&|a, b| b.name.as_ref().is_some_and(|name| name.starts_with(a.name.as_ref().unwrap())));
    check(name || is_named || sent.len() == 1, &["name", "external ids"]);
    let subject = check(all(&|a, b| a.subject == b.subject), &["subject"]);
    let class = check(all(&|a, b| a.label == b.label), &["label", "class"]);
    // A unit says how to read numbers: a format without a place for it loses nothing that could be counted.
    Some([name, all(&|a, b| a.unit == b.unit), subject, class])
}

/// A row of the table: whether any shapes of the format keep name, unit, subject and class.
fn row(format: &'static Format) -> [&'static str; 4] {
    let kinds = [Kind::Landmarks, Kind::Curve, Kind::Mesh];
    let of_unit = |unit: Unit| {
        let found = kinds.iter().flat_map(|kind| [2, 3].map(|dimension| (*kind, dimension)));
        let found = found.filter(|(kind, dimension)| *kind != Kind::Mesh || *dimension == 3);
        let found = found.filter_map(|(kind, dimension)| kept(format, kind, dimension, unit));
        found.reduce(|a, b| std::array::from_fn(|k| a[k] || b[k])).expect(format.id)
    };
    let [length, cells] = UNITS.map(of_unit);
    let word = |k: usize| if length[k] { "yes" } else { "" };
    let unit = match (length[1], cells[1]) {
        (true, true) => "yes",
        (true, false) => "mm",
        (false, true) => "pixel",
        (false, false) => "",
    };
    [word(0), unit, word(2), word(3)]
}

#[test]
fn what_a_format_has_a_place_for_comes_back() {
    let rows = PAGE.lines().skip_while(|line| *line != "| formats | name | unit | subject | class |").skip(2);
    let mut table = Vec::new();
    for line in rows.take_while(|line| line.starts_with('|')) {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        table.extend(cells[0].split(", ").map(|id| (id.trim_matches('`'), cells[1..].to_vec())));
    }
    let both = FORMATS.iter().filter(|format| format.is_read() && format.is_written());
    let both = both.filter(|format| !OTHERS.contains(&format.id));
    let mut found: Vec<(&str, Vec<&str>)> = both.map(|format| (format.id, row(format).to_vec())).collect();
    table.sort();
    found.sort();
    assert_eq!(table, found);
}
