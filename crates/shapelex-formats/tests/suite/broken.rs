//! Broken records: of every format of several shapes, one that is broken is left out and counted where that is asked for.

use shapelex_formats::shape::{
    FORMATS, FaultKind, FileError, Limits, ReadOptions, Record, Scale, Source, Storing, Summary, find, read,
};

/// What a broken record of a format costs.
enum Cost {
    /// The record: a file of three, its place where the second one is broken, and the names of the others.
    Record { file: &'static str, line: Option<u64>, names: &'static [&'static str] },
    /// The record, which other tests break, as the files are binary.
    Tested,
    /// The file, which holds one shape, or numbers of shapes side by side.
    File,
}

const CSV_WIDE: &str = "id,x1,y1,x2,y2\na,0,0,1,0\nb,0,0,1,x\nc,0,0,1,2\n";
const TPS: &str = "LM=2\n0 0\n1 0\nID=a\nLM=2\n0 0\nID=b\nLM=2\n0 0\n1 2\nID=c\n";
const NTS: &str = "1 3L 4 0 DIM=2\na b c\n0 0 1 0\n0 0 1 x\n0 0 1 2\n";
const CHC: &str = "a 1 1 1 9 0 2 -1\nb 1 x 1 9 0 2 -1\nc 1 1 1 9 0 2 -1\n";
const NEF: &str = "#HARMO 2\na\n1 0 0 1\n0 0 0 0\nb\n1 0 0 x\n0 0 0 0\nc\n1 0 0 1\n0 0 0 0\n";
const MORPHOLOGIKA: &str = "[individuals]\n3\n[landmarks]\n2\n[dimensions]\n2\n[names]\na\nb\nc\n[rawpoints]\n'a\n0 0\n1 0\n'b\n0 0\n1\n'c\n0 0\n1 2\n";
const MARKUPS: &str = r#"{"markups":[{"type":"Fiducial","name":"a","controlPoints":[{"position":[0,0,1]}]},
{"type":"Fiducial","name":"b","controlPoints":[{"position":"x"}]},{"type":"Fiducial","name":"c","controlPoints":[{"position":[0,0,2]}]}]}"#;
const NDJSON: &str = "{\"external_id\":\"a\",\"points\":[[0,0],[1,0]]}\n{\"external_id\":\"b\"\n{\"external_id\":\"c\",\"points\":[[0,0],[1,2]]}\n";
const GEOJSON: &str = r#"{"type":"Feature","properties":{"name":"a"},"geometry":{"type":"Polygon","coordinates":[[[0,0],[1,0],[0,1],[0,0]]]}}
{"type":"Feature","properties":{"name":"b"},"geometry":{"type":"Polygon","coordinates":[[[0,0],[1,"x"],[0,1],[0,0]]]}}
{"type":"Feature","properties":{"name":"c"},"geometry":{"type":"Polygon","coordinates":[[[0,0],[2,0],[0,1],[0,0]]]}}"#;
const WKT: &str = "id;wkt\na;POLYGON((0 0,1 0,0 1,0 0))\nb;POLYGON((0 0,1 0\nc;POLYGON((0 0,2 0,0 1,0 0))\n";
const COCO: &str = r#"{"images":[{"id":1}],"categories":[{"id":1,"name":"cell"}],"annotations":[
{"id":1,"image_id":1,"category_id":1,"segmentation":[[0,0,1,0,0,1]]},{"id":2,"image_id":1,"category_id":1,"segmentation":[[0,0,1,0,0]]},
{"id":3,"image_id":1,"category_id":1,"segmentation":[[0,0,2,0,0,1]]}]}"#;

const NAMES: &[&str] = &["a", "c"];

fn cost(format: &str) -> Cost {
    let record = |file, line| Cost::Record { file, line, names: NAMES };
    match format {
        "csv" => record(CSV_WIDE, Some(3)),
        "tps" => record(TPS, Some(7)),
        "nts" => record(NTS, Some(4)),
        "chc" => record(CHC, Some(2)),
        "nef" => record(NEF, Some(6)),
        "morphologika" => record(MORPHOLOGIKA, Some(17)),
        "mrk" => record(MARKUPS, None),
        "ndjson" => record(NDJSON, Some(2)),
        "geojson" => record(GEOJSON, None),
        "wkt" => record(WKT, Some(3)),
        "coco" => Cost::Record { file: COCO, line: None, names: &["1", "3"] },
        "zip" | "swproj" | "rtstruct" | "arrow" | "parquet" => Cost::Tested,
        "obj" | "ply" | "stl" | "off" | "vtk" | "vtp" | "gifti" | "particles" | "fcsv" | "scalismo"
        | "imagej-roi" | "npy" | "npz" => Cost::File,
        other => panic!("{other} is read: what does a broken record cost?"),
    }
}

fn records(format: &str, file: &[u8], options: ReadOptions) -> Result<(Vec<Record>, Summary), FileError> {
    let mut found = Vec::new();
    let mut source = Source::new(file, Limits::default())?;
    let summary = read(find(format).unwrap(), &mut source, &options, &mut |record| {
        found.push(record);
        Ok(())
    })?;
    Ok((found, summary))
}

fn skipping() -> ReadOptions {
    ReadOptions { storing: Some(Storing { skips_broken: true, persons: false }), ..ReadOptions::default() }
}

/// Names of what is read while broken records are left out, and their number.
fn left(format: &str, file: &str, options: ReadOptions) -> (Vec<String>, u64, Summary) {
    let (found, summary) =
        records(format, file.as_bytes(), options).unwrap_or_else(|error| panic!("{format}: {error}"));
    let broken = summary.dropped.iter().find(|dropped| dropped.what == "broken shapes");
    let names = found.into_iter().filter_map(|record| record.name).collect();
    (names, broken.map_or(0, |dropped| dropped.count), summary)
}

#[test]
fn one_broken_record_costs_itself() {
    for format in FORMATS.iter().filter(|format| format.is_read()) {
        let id = format.id;
        let Cost::Record { file, line, names } = cost(id) else { continue };
        let refused = records(id, file.as_bytes(), ReadOptions::default()).expect_err(id);
        assert_eq!(refused.kind, FaultKind::Malformed, "{id}: {refused}");
        let (found, count, summary) = left(id, file, skipping());
        assert_eq!((found, count), (names.iter().map(|name| (*name).to_owned()).collect(), 1), "{id}");
        let dropped = summary.dropped.iter().find(|dropped| dropped.what == "broken shapes").unwrap();
        assert_eq!(dropped.names, [refused.detail], "{id}");
        assert_eq!(dropped.first.line, line, "{id}");
        assert_eq!(summary.records, names.len() as u64, "{id}");
    }
}

/// The page says the same.
#[test]
fn the_page_lists_what_a_broken_record_costs() {
    let page = include_str!("../../../../docs/formats/README.md");
    let (_, rest) = page.split_once("\n## Cost of a broken record\n").expect("the page has the heading");
    let rest = rest.split("\n## ").next().unwrap();
    let rows = |of: &str| {
        let of = format!("| {of} |");
        rest.lines().filter(|line| line.starts_with(&of)).collect::<String>()
    };
    let (alone, file) = (rows("itself"), rows("the file"));
    for format in FORMATS.iter().filter(|format| format.is_read()) {
        let word = format!("`{}`", format.id);
        let is_file = matches!(cost(format.id), Cost::File);
        assert_eq!((alone.contains(&word), file.contains(&word)), (!is_file, is_file), "{word}");
    }
}

#[test]
fn the_next_specimen_of_tps_is_found_wherever_one_is_broken() {
    let good = |name: &str| format!("LM=2\n0 0\n1 0\nID={name}\n");
    for broken in [
        "LM=2\n0 0\n",
        "LM=2\n0 0\n1 0\n2 0\nID=b\n",
        "LM=2\n0 0\n1\nID=b\n",
        "LM=x\n0 0\n1 0\nID=b\n",
        "LM=2\n0 0\n1 0\nCURVES=1\nPOINTS=2\n0 0\nID=b\n",
        "LM=2\n0 0\n1 0\nCURVES=2\nPOINTS=1\n0 0\n",
        "LM=2\n0 0\n1 0\nSCALE=-1\nID=b\n",
    ] {
        let file = [good("a"), broken.into(), good("c"), broken.into(), good("d")].concat();
        let (found, count, _) = left("tps", &file, skipping());
        assert_eq!((found.join(" ").as_str(), count), ("a c d", 2), "{broken}");
    }
    // A specimen without the scale that is asked for.
    let scaled = |name: &str| format!("{}SCALE=2\n", good(name));
    let file = [scaled("a"), good("b"), scaled("c")].concat();
    let options = ReadOptions { scale: Some(Scale::Apply), ..skipping() };
    let (found, count, summary) = left("tps", &file, options);
    assert_eq!((found.join(" ").as_str(), count), ("a c", 1));
    assert_eq!(summary.properties["scale"], "applied");
    // What ends too early, or does not begin as it should, is refused.
    for file in [format!("{}LM=2\n0 0\n", good("a")), format!("x\n{}", good("a"))] {
        assert!(records("tps", file.as_bytes(), skipping()).is_err(), "{file}");
    }
}

#[test]
fn rows_of_nts_are_lines_or_as_many_words() {
    for (row, count) in [("0 0 1", 1), ("0 0 1 0 7", 1), ("0 x 1 0", 1), ("0 NA 1 0", 1), ("0 0 1 0", 0)] {
        let file = format!("1 3B 4 0 DIM=2\na 0 0 1 0\nb {row}\nc 0 0 1 2\n");
        let (found, broken, _) = left("nts", &file, skipping());
        assert_eq!((found.len(), broken), (3 - count, count as u64), "{row}");
    }
    // Rows over several lines have as many words as the header says.
    let file = "1 3L 4 0 DIM=2\na b c\n0 0\n1 0\n0 0\nx 0\n0 0\n1 2\n";
    let (found, broken, _) = left("nts", file, skipping());
    assert_eq!((found.join(" ").as_str(), broken), ("a c", 1));
    let file = "1 3L 4 0 DIM=2\na b c\n0 0\n1 0\n0 0\n0\n0 0\n1 2\n";
    assert!(records("nts", file.as_bytes(), skipping()).is_err(), "a word less");
}

#[test]
fn a_broken_row_of_a_long_table_costs_its_shape() {
    let table = |row: &str| format!("id,point,x,y\na,1,0,0\na,2,1,0\n{row}\nb,2,1,0\nc,1,0,0\nc,2,1,2\n");
    for row in ["b,1,x,0", "b,1,0", "b,1,0,0,7", "b,1,NA,0", "b,3,0,0"] {
        let (found, count, _) = left("csv", &table(row), skipping());
        assert_eq!((found.join(" ").as_str(), count), ("a c", 1), "{row}");
        assert!(records("csv", table(row).as_bytes(), ReadOptions::default()).is_err(), "{row}");
    }
    // The last shape, and the first.
    let (found, count, _) = left("csv", "id,x,y\na,x,0\na,0,0\nb,0,0\nb,1,0\nc,y,0\n", skipping());
    assert_eq!((found.join(" ").as_str(), count), ("b", 2));
    // A shape that was given on without some of its rows is not stored: the whole table is refused.
    let apart = "id,x,y\na,0,0\nb,x,0\na,1,0\n";
    let error = records("csv", apart.as_bytes(), skipping()).unwrap_err().to_string();
    assert!(error.contains("expected the rows of shape 'a' side by side"), "{error}");
    let short = "x,y,id\n0,0,a\n1\n1,0,a\n";
    assert!(records("csv", short.as_bytes(), skipping()).is_err(), "a row of an unknown shape");
}

#[test]
fn lines_of_other_bytes_than_text_are_broken_records() {
    for (format, file) in [("ndjson", NDJSON), ("wkt", WKT), ("csv", CSV_WIDE)] {
        let mut bytes = file.as_bytes().to_vec();
        let at = file.lines().take(if format == "ndjson" { 1 } else { 2 }).map(|line| line.len() + 1).sum();
        bytes.insert(at, 0xff);
        let (found, summary) = records(format, &bytes, skipping()).unwrap();
        let broken = &summary.dropped.iter().find(|dropped| dropped.what == "broken shapes").unwrap();
        assert_eq!((found.len(), broken.count), (2, 1), "{format}");
        assert_eq!(broken.names, ["expected UTF-8 text, got other bytes"], "{format}");
    }
}

#[test]
fn the_next_shape_of_coefficients_is_found() {
    let shape = |name: &str| format!("{name}\n1 0 0 1\n0 0 0 0\n");
    for broken in ["b\n1 0 0 1\n", "b\n1 0 0\n0 0 0 0\n", "b\n1 0 0 1\n0 0 0 0 0\n"] {
        let file = ["#HARMO 2\n".into(), shape("a"), broken.into(), shape("c"), shape("d")].concat();
        let (found, count, _) = left("nef", &file, skipping());
        assert_eq!((found.join(" ").as_str(), count), ("a c d", 1), "{broken}");
    }
}
