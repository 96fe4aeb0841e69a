use std::io::{Cursor, Write};

use zip::ZipWriter;
use zip::write::SimpleFileOptions;

use super::super::limits::Limits;
use super::*;
use crate::shape::{Geometry, detect, read as read_file};

const PROJECT: &str = r#"{"data": [
    {"name": "m02", "shape_1": "meshes/m02.ply", "local_particles_1": "./particles/m02_local.particles",
     "world_particles_1": "particles\\m02_world.particles", "group_sex": "f", "age": "61", "alignment_1": "1 0 0 0"},
    {"name": "m01", "local_particles_1": "particles/m01_local.particles",
     "world_particles_1": "particles/m01_world.particles", "group_sex": "m", "age": 70},
    {"name": "m03", "local_particles_1": "particles/m03_local.particles", "excluded": "true"},
    {"name": "m04", "local_particles_1": ""}
], "optimize": {"number_of_particles": "2"}}"#;

fn archive(files: &[(&str, &[u8])]) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in files {
        zip.start_file(*name, SimpleFileOptions::default()).unwrap();
        zip.write_all(content).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

fn records_within(
    bytes: &[u8],
    pairs: &[(&str, &str)],
    limits: Limits,
) -> Result<(Vec<Record>, Summary), FileError> {
    let options = ReadOptions::from_pairs(pairs.iter().copied())?;
    let mut source = Source::new(bytes, limits)?;
    let mut found = Vec::new();
    let format = detect(source.head(), Some("study.zip"))?;
    let summary = read_file(format, &mut source, &options, &mut |record| {
        found.push(record);
        Ok(())
    })?;
    Ok((found, summary))
}

fn records(bytes: &[u8], pairs: &[(&str, &str)]) -> Result<(Vec<Record>, Summary), FileError> {
    records_within(bytes, pairs, Limits::default())
}

/// The project in a folder, beside the folder of its particles.
fn study(project: &str) -> Vec<u8> {
    archive(&[
        ("study/particles/m01_local.particles", b"1 2 3\n4 5 6\n"),
        ("study/particles/m01_world.particles", b"0 0 0\n1 1 1\n"),
        ("study/particles/m02_local.particles", b"7 8 9\n1 1 1\n"),
        ("study/particles/m02_world.particles", b"2 2 2\n3 3 3\n"),
        ("study/a.swproj", project.as_bytes()),
    ])
}

fn first(record: &Record) -> f64 {
    let Geometry::Landmarks(points) = &record.geometry else { panic!("landmarks") };
    points.coordinates()[0]
}

fn left_out(summary: &Summary) -> Vec<(&str, u64, String)> {
    summary.dropped.iter().map(|left| (&*left.what, left.count, left.names.join(" "))).collect()
}

#[test]
fn subjects_come_in_their_order_with_what_the_project_says() {
    let (found, summary) = records(&study(PROJECT), &[]).unwrap();
    let said: Vec<_> =
        found.iter().map(|r| (r.name.as_deref().unwrap(), r.label.as_deref().unwrap(), first(r))).collect();
    assert_eq!(said, [("m02", "f", 7.0), ("m01", "m", 1.0)]);
    assert_eq!(found[0].labels, BTreeMap::from([("age".to_owned(), Value::Number(61.0))]));
    assert_eq!((&found[0].subject, found[0].metadata.len()), (&None, 0));
    assert_eq!(found[1].place.to_string(), "file 'study/particles/m01_local.particles'");
    assert_eq!(
        left_out(&summary),
        [
            (
                "files beside those that the project names",
                2,
                "study/particles/m01_world.particles study/particles/m02_world.particles".to_owned()
            ),
            ("columns of transformations", 1, "alignment_1".to_owned()),
            ("columns of other files", 2, "shape_1 world_particles_1".to_owned()),
            ("excluded subjects", 1, "m03".to_owned()),
            ("subjects without such a file", 1, "m04".to_owned()),
        ]
    );
    assert_eq!(
        (&summary.properties["project_files"], &summary.properties["files"]),
        (&"local_particles".into(), &2.into())
    );
    let (found, _) = records(&study(PROJECT), &[("files", "world_particles")]).unwrap();
    assert_eq!(found.iter().map(first).collect::<Vec<_>>(), [2.0, 0.0]);
}

#[test]
fn domains_are_shapes_of_one_subject() {
    let project = r#"{"data": [{"name": "s", "local_particles_pelvis": "p.particles", "local_particles_femur": "f.particles",
        "group_a": "1", "group_b": "x"}]}"#;
    let files = archive(&[
        ("p.particles", b"1 0 0\n"),
        ("f.particles", b"2 0 0\n"),
        ("x.SWPROJ", project.as_bytes()),
    ]);
    let (found, _) = records(&files, &[]).unwrap();
    let said: Vec<_> =
        found.iter().map(|r| (r.name.as_deref().unwrap(), r.subject.as_deref().unwrap(), first(r))).collect();
    assert_eq!(said, [("s/femur", "s", 2.0), ("s/pelvis", "s", 1.0)]);
    assert_eq!(found[0].metadata["domain"], "femur");
    // Several groups are attributes.
    let groups = [("a".to_owned(), Value::Number(1.0)), ("b".to_owned(), "x".into())];
    assert_eq!((&found[0].label, &found[0].labels), (&None, &BTreeMap::from(groups)));
    let (found, summary) = records(&files, &[("select", "pel*")]).unwrap();
    assert_eq!((found.len(), first(&found[0])), (1, 1.0));
    assert!(left_out(&summary).contains(&("domains that are not selected", 1, "femur".to_owned())));
}

#[test]
fn other_files_than_particles_are_read_by_their_formats() {
    let off = b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    let two = b"{\"points\":[[0,1]]}\n{\"points\":[[2,3]]}\n";
    let project = r#"{"data": [{"shape_1": "a.off", "landmarks_file_1": "l.ndjson"}]}"#;
    let files = archive(&[("a.off", off), ("l.ndjson", two), ("x.swproj", project.as_bytes())]);
    let (found, _) = records(&files, &[("files", "shape")]).unwrap();
    assert_eq!((found[0].geometry.kind(), found[0].name.as_deref()), (Kind::Mesh, Some("a")));
    let (found, _) = records(&files, &[("files", "landmarks_file"), ("closed", "true")]).unwrap();
    assert_eq!((found.len(), found[1].geometry.kind()), (2, Kind::Curve));
    let refused = records(&files, &[]).unwrap_err();
    let expected = "file 'x.swproj': expected a column local_particles_… or world_particles_…, got 'landmarks_file_1', 'shape_1'; \
                    files=groomed and files=shape read surfaces";
    assert_eq!(refused.to_string(), expected);
    let refused = records(&files, &[("files", "groomed")]).unwrap_err();
    assert_eq!(refused.kind, FaultKind::Option);
    assert!(
        refused.to_string().contains("expected a column groomed_contour_… or groomed_…, got"),
        "{refused}"
    );
}

#[test]
fn faults_name_the_subject_and_the_column() {
    let of = |path: &str| {
        let project = serde_json::json!({"data": [{}, {"local_particles_1": path}]}).to_string();
        records(&study(&project), &[]).unwrap_err().to_string()
    };
    let place = "file 'study/a.swproj', item 1, local_particles_1: expected";
    assert_eq!(of("b.particles"), format!("{place} the file 'b.particles' in the archive, got none"));
    assert_eq!(of("../../b"), format!("{place} the file '../../b' in the archive, got none"));
    for path in ["/etc/passwd", "C:\\a", "..", "a/.."] {
        let expected = format!("{place} a path from the folder of the project, got '{}'", path);
        assert_eq!(of(path).replace("\\\\", "\\"), expected);
    }
    assert!(of("a.swproj").contains("got one of no known format"), "{}", of("a.swproj"));
    let broken = records(&study("{\"data\": [{\"name\": [1]}]}"), &[]).unwrap_err().to_string();
    assert_eq!(broken, "file 'study/a.swproj', item 0, name: expected a text or a number, got '[1]'");
    let cut = records(&study("{\"data\": [{\"name\""), &[]).unwrap_err();
    assert_eq!(cut.kind, FaultKind::Truncated);
    let two = archive(&[("a.swproj", PROJECT.as_bytes()), ("b.swproj", PROJECT.as_bytes())]);
    assert_eq!(
        records(&two, &[]).unwrap_err().to_string(),
        "file 'b.swproj': expected one project in an archive, got a second one"
    );
    let limits = Limits { records: 3, ..Limits::default() };
    let many = records_within(&study(PROJECT), &[], limits).unwrap_err();
    assert_eq!(
        (many.kind, many.to_string().as_str()),
        (FaultKind::TooLarge, "file 'study/a.swproj': expected at most 3 subjects, got 4")
    );
    let mut source = Source::new(PROJECT.as_bytes(), Limits::default()).unwrap();
    let alone = read_file(&FORMAT, &mut source, &ReadOptions::default(), &mut |_| Ok(())).unwrap_err();
    assert_eq!(
        alone.to_string(),
        "expected a zip archive of the project and the 2 files that it names, got the project alone"
    );
}

/// A workbook as programs write it: shared texts, one in its cell, numbers, an empty row.
fn workbook(sheets: &str, rows: &str, shared: &str) -> Vec<u8> {
    let names: Vec<&str> = sheets.split(' ').collect();
    let of = |each: &dyn Fn(usize, &str) -> String| -> String {
        names.iter().enumerate().map(|(k, name)| each(k + 1, name)).collect()
    };
    let main = "http://schemas.openxmlformats.org/spreadsheetml/2006/main";
    let office = "http://schemas.openxmlformats.org/officeDocument/2006/relationships";
    let sheet = |rows: &str| format!("<worksheet xmlns=\"{main}\"><sheetData>{rows}</sheetData></worksheet>");
    let parts = [
        (
            "[Content_Types].xml".to_owned(),
            "<Types xmlns=\"http://schemas.openxmlformats.org/package/2006/content-types\"/>".to_owned(),
        ),
        (
            "_rels/.rels".to_owned(),
            format!(
                "<Relationships xmlns=\"http://schemas.openxmlformats.org/package/2006/relationships\">\
                 <Relationship Id=\"b\" Type=\"{office}/officeDocument\" Target=\"xl/workbook.xml\"/></Relationships>"
            ),
        ),
        (
            "xl/workbook.xml".to_owned(),
            format!(
                "<workbook xmlns=\"{main}\" xmlns:r=\"{office}\"><sheets>{}</sheets></workbook>",
                of(&|k, name| format!("<sheet name=\"{name}\" sheetId=\"{k}\" r:id=\"r{k}\"/>"))
            ),
        ),
        (
            "xl/_rels/workbook.xml.rels".to_owned(),
            format!(
                "<Relationships xmlns=\"http://schemas.openxmlformats.org/package/2006/relationships\">{}\
                 <Relationship Id=\"s\" Type=\"{office}/sharedStrings\" Target=\"sharedStrings.xml\"/></Relationships>",
                of(&|k, _| format!(
                    "<Relationship Id=\"r{k}\" Type=\"{office}/worksheet\" Target=\"worksheets/sheet{k}.xml\"/>"
                ))
            ),
        ),
        ("xl/sharedStrings.xml".to_owned(), format!("<sst xmlns=\"{main}\">{shared}</sst>")),
    ];
    let data = names.iter().position(|name| *name == "data").unwrap_or(0);
    let sheets = (0..names.len())
        .map(|k| (format!("xl/worksheets/sheet{}.xml", k + 1), sheet(if k == data { rows } else { "" })));
    let parts: Vec<(String, String)> = parts.into_iter().chain(sheets).collect();
    let parts: Vec<(&str, &[u8])> =
        parts.iter().map(|(name, text)| (name.as_str(), text.as_bytes())).collect();
    archive(&parts)
}

const ROWS: &str = r#"<row r="1"><c r="A1" t="s"><v>0</v></c><c r="B1" t="s"><v>1</v></c><c r="C1" t="s"><v>2</v></c><c r="D1" t="inlineStr"><is><t>age</t></is></c></row>
<row r="2"><c r="A2" t="inlineStr"><is><t>m02</t></is></c><c r="B2" t="s"><v>3</v></c><c r="C2" t="inlineStr"><is><t>f</t></is></c><c r="D2"><v>61</v></c></row>
<row r="4"><c r="B4" t="s"><v>4</v></c><c r="D4"><v>70.5</v></c></row>"#;
const SHARED: &str = "<si><t>name</t></si><si><t>local_particles_1</t></si><si><t>group_sex</t></si>\
                      <si><t>particles/m02_local.particles</t></si><si><t>particles/m01_local.particles</t></si>";

#[test]
fn workbooks_are_tables_too() {
    for sheets in ["data optimize", "optimize data", "Sheet1"] {
        let files = archive(&[
            ("particles/m01_local.particles", b"1 2 3\n4 5 6\n"),
            ("particles/m02_local.particles", b"7 8 9\n1 1 1\n"),
            ("study.xlsx", &workbook(sheets, ROWS, SHARED)),
        ]);
        let (found, _) = records(&files, &[]).unwrap();
        let said: Vec<_> =
            found.iter().map(|r| (r.name.as_deref().unwrap(), r.label.as_deref(), first(r))).collect();
        assert_eq!(said, [("m02", Some("f"), 7.0), ("m01_local", None, 1.0)], "{sheets}");
        let ages: Vec<_> = found.iter().map(|r| r.labels["age"].clone()).collect();
        assert_eq!(ages, [Value::Number(61.0), Value::Number(70.5)]);
    }
    // A workbook that names no files of shapes is left out of an archive, and refused alone.
    let other = workbook("Sheet1", "<row r=\"1\"><c r=\"A1\"><v>1</v></c></row>", "");
    let files = archive(&[("a.particles", b"1 2 3\n"), ("notes.xlsx", &other)]);
    let (found, summary) = records(&files, &[]).unwrap();
    assert_eq!(
        (found.len(), left_out(&summary)),
        (1, vec![("files of no known format", 1, "notes.xlsx".to_owned())])
    );
    let mut source = Source::new(&other[..], Limits::default()).unwrap();
    assert_eq!(detect(source.head(), None).unwrap().id, "swproj");
    let alone = read_file(&FORMAT, &mut source, &ReadOptions::default(), &mut |_| Ok(())).unwrap_err();
    assert!(alone.to_string().starts_with("expected a column local_particles_…"), "{alone}");
}

#[test]
fn workbooks_that_grow_are_refused() {
    let limits = Limits { held: 100_000, ..Limits::default() };
    let read = |book: &[u8]| Table::read(&mut Source::new(book, limits).expect("a source"));
    let refused = |book: &[u8]| read(book).unwrap_err().to_string();
    // A long text that many cells have.
    let long = "x".repeat(20_000);
    let cells = (1..=9).map(|row| format!("<row r=\"{row}\"><c r=\"A{row}\" t=\"s\"><v>0</v></c></row>"));
    let repeated = workbook("data", &cells.collect::<String>(), &format!("<si><t>{long}</t></si>"));
    assert_eq!(refused(&repeated), "expected a table of at most 100000 bytes in memory, got more");
    // Parts that are long when they are unpacked.
    let bomb = workbook("data", &" ".repeat(200_000), "");
    assert_eq!(refused(&bomb), "expected at most 100000 bytes of a workbook, got more");
    // Memory is asked for before they are.
    let asked = std::cell::RefCell::new(Vec::new());
    let source = Source::new(bomb.as_slice(), Limits::default()).expect("a source");
    let mut source = source.asking(|found| {
        let size = found.bytes();
        asked.borrow_mut().push(size > 200_000);
        if size < 200_000 { Ok(()) } else { Err(FileError::new(FaultKind::Memory, "none")) }
    });
    assert_eq!(Table::read(&mut source).unwrap_err().kind, FaultKind::Memory);
    assert_eq!(asked.borrow().iter().filter(|much| **much).count(), 1);
    // Texts for which memory would be taken before they are read.
    let part = |name: &str, content: &str| archive(&[(name, content.as_bytes())]);
    let claim = "<sst count=\"1\" uniqueCount = '1000000000000'><si/></sst>";
    let refusal =
        format!("item 0: expected a part of a workbook, got 1000000000000 texts in {} bytes", claim.len());
    assert_eq!(refused(&part("xl/sharedStrings.xml", claim)), refusal);
    let many = refused(&part("xl/a.xml", "uniqueCount=\"99999999999999999999999\""));
    assert!(many.contains(&format!("got {} texts", u64::MAX)), "{many}");
    let exact = part("xl/sharedStrings.xml", "<sst uniqueCount=\"8\"><si/><si/><si/></sst>");
    assert!(!refused(&exact).contains("texts"));
    // A cell far away takes no more memory than one near by.
    let far = workbook("data", "<row r=\"1048576\"><c r=\"XFD1048576\"><v>1</v></c></row>", "");
    assert_eq!(read(&far).unwrap().rows, []);
    let whole = workbook("data", ROWS, SHARED);
    for length in (4..whole.len()).step_by(7) {
        let error = read(&whole[..length]).unwrap_err();
        assert!(error.to_string().contains("expected "), "{error}");
    }
    for k in (0..whole.len()).step_by(3) {
        let mut changed = whole.clone();
        changed[k] ^= 0x41;
        // Reads or refuses, without a panic.
        let _ = read(&changed);
    }
}

#[test]
fn what_comes_out_of_workbooks_counts_as_content() {
    let book = workbook("Sheet1", &" ".repeat(30_000), "");
    let names = ["a.xlsx", "b.xlsx", "c.xlsx"];
    let books = |count: usize| {
        let files: Vec<(&str, &[u8])> = names[..count].iter().map(|name| (*name, &book[..])).collect();
        archive(&[&[("a.particles", &b"1 2 3\n"[..])], &files[..]].concat())
    };
    let limits = Limits { content: 80_000, ..Limits::default() };
    assert_eq!(records_within(&books(2), &[], limits).unwrap().0.len(), 1);
    let refused = records_within(&books(3), &[], limits).unwrap_err().to_string();
    assert!(refused.starts_with("file 'c.xlsx': expected at most "), "{refused}");
}

#[test]
fn a_project_is_packed_with_its_files() {
    let files = BTreeMap::from([
        ("particles/m02_local.particles", &b"7 8 9\n1 1 1\n"[..]),
        ("../shared/m01_local.particles", b"1 2 3\n4 5 6\n"),
    ]);
    let open = |path: &str| files.get(path).copied().ok_or_else(|| std::io::Error::other("no such file"));
    let project = PROJECT.replace("particles/m01_local", "../shared/m01_local");
    let pack =
        || pack_project(project.as_bytes(), "a.swproj", &ReadOptions::default(), &Limits::default(), open);
    let packed = pack().unwrap();
    assert_eq!(packed, pack().unwrap(), "the same bytes");
    let (found, summary) = records(&packed, &[]).unwrap();
    assert_eq!(found.iter().map(first).collect::<Vec<_>>(), [7.0, 1.0]);
    assert!(!left_out(&summary).iter().any(|(what, ..)| what.starts_with("files")), "{summary:?}");
    let refused =
        pack_project(PROJECT.as_bytes(), "a.swproj", &ReadOptions::default(), &Limits::default(), open);
    assert_eq!(
        refused.unwrap_err().to_string(),
        "item 1, local_particles_1: expected a file that the project names, got 'particles/m01_local.particles': no such file"
    );
    let far = format!(r#"{{"data":[{{"shape_1":"{}a.off"}}]}}"#, "../".repeat(33));
    let options = ReadOptions::from_pairs([("files", "shape")]).unwrap();
    let far = pack_project(far.as_bytes(), "a.swproj", &options, &Limits::default(), open).unwrap_err();
    assert_eq!(far.to_string(), "expected files at most 32 folders above the project, got 33");
    let limits = Limits { held: project.len() + 15, ..Limits::default() };
    let large =
        pack_project(project.as_bytes(), "a.swproj", &ReadOptions::default(), &limits, open).unwrap_err();
    assert_eq!(large.kind, FaultKind::TooLarge, "{large}");
    let mut source = Source::new(PROJECT.as_bytes(), Limits::default()).unwrap();
    let named = named_files(&mut source);
    assert_eq!((named.len(), named[0].as_str()), (6, "particles/m02_local.particles"));
}

fn project_of(table: &str) -> Project {
    let mut source = Source::new(table.as_bytes(), Limits::default()).unwrap();
    let options = ReadOptions::from_pairs([("files", "shape")]).unwrap();
    Project::new(&Table::read(&mut source).unwrap(), &options).unwrap()
}

#[test]
fn what_a_row_says_is_held_once_for_all_its_files() {
    let row = (0..300).map(|k| (format!("shape_{k:03}"), "a.off".into()));
    let row: BTreeMap<String, serde_json::Value> = row.chain([("sex".into(), "f".into())]).collect();
    let project = project_of(&serde_json::json!({"data": [row, {"shape_007": "b.off"}]}).to_string());
    let [first, .., last, other] = &project.files[..] else { panic!("files") };
    assert!(Rc::ptr_eq(&first.subject, &last.subject) && !Rc::ptr_eq(&first.subject, &other.subject));
    assert_eq!((Rc::strong_count(&first.subject), Rc::strong_count(&other.domain)), (300, 2));
    assert_eq!((last.place().to_string(), last.subject.labels.len()), ("item 0, shape_299".into(), 1));
}

#[test]
fn files_that_rows_do_not_name_are_counted() {
    let rows = ["{\"name\":\"s\",\"shape_b\":\"b.off\"}", &[",{}"; 999].concat()].concat();
    let columns: String = (0..199).map(|k| format!(",\"shape_c{k:03}\":\"c.off\"")).collect();
    let project = project_of(&format!("{{\"data\":[{rows},{{\"shape_b\":\"b.off\"{columns}}}]}}"));
    assert_eq!(project.files.len(), 201);
    let [left] = &project.summary.dropped[..] else { panic!("{:?}", project.summary) };
    assert_eq!((left.what.as_str(), left.count), ("subjects without such a file", 199 + 999 * 200));
    assert_eq!((left.first.to_string(), left.names.len()), ("item 0, shape_c000".into(), 100));
    let few = project_of(r#"{"data": [{"name": "s"}, {}, {"shape_a": "a", "shape_b": "b"}]}"#);
    assert_eq!(left_out(&few.summary), [("subjects without such a file", 4, "s s".to_owned())]);
}

#[test]
fn headings_of_workbooks_are_held_once() {
    let mut source = Source::new(Cursor::new(workbook("data", ROWS, SHARED)), Limits::default()).unwrap();
    let table = Table::read(&mut source).unwrap();
    let headings: Vec<&Rc<str>> =
        table.rows.iter().flat_map(|row| row.keys().filter(|name| &***name == "age")).collect();
    let [first, second] = headings[..] else { panic!("{headings:?}") };
    assert!(Rc::ptr_eq(first, second));
}

#[test]
fn long_texts_of_styles_are_refused() {
    let read = |part: &str, styles: &str| {
        let book = archive(&[(part, styles.as_bytes())]);
        Table::read(&mut Source::new(&book[..], Limits::default()).unwrap()).unwrap_err().to_string()
    };
    let long = "0".repeat(1100);
    for styles in [
        format!("<x:numFmt numFmtId=\"200\" formatCode=\"{long}\"/>"),
        format!("<a><!-- \" --></b><font><name val='{long}'></font>"),
    ] {
        let refused =
            read("xl/Styles.xml", &format!("<styleSheet>{styles}<xf numFmtId=\"200\"/></styleSheet>"));
        assert!(refused.starts_with("item 0: expected a part of a workbook, got a style of 11"), "{refused}");
        assert!(!read("xl/other.xml", &styles).contains("style of"));
    }
    let short = format!("<styleSheet note=\"{long}\"><numFmt formatCode=\"0.0\"/></styleSheet>");
    assert!(!read("xl/styles.xml", &short).contains("style of"));
}

#[test]
fn a_broken_file_costs_its_subject() {
    let project = |second: &str| {
        let of = |name: &str, file: &str| format!(r#"{{"name": "{name}", "local_particles_1": "{file}"}}"#);
        let subjects = [of("a", "a.particles"), of("b", second), of("c", "c.particles")].join(",");
        format!(r#"{{"data": [{subjects}]}}"#)
    };
    for second in ["b.particles", "missing.particles", "../../b.particles", "/b.particles"] {
        let file = archive(&[
            ("a.particles", b"1 2 3\n"),
            ("b.particles", b"1 2 x\n"),
            ("c.particles", b"4 5 6\n"),
            ("p.swproj", project(second).as_bytes()),
        ]);
        assert!(records(&file, &[]).is_err(), "{second}");
        let storing = crate::shape::Storing { skips_broken: true, persons: false };
        let options = ReadOptions { storing: Some(storing), ..ReadOptions::default() };
        let mut source = Source::new(&file[..], Limits::default()).unwrap();
        let mut names = Vec::new();
        let format = detect(source.head(), Some("study.zip")).unwrap();
        let summary = read_file(format, &mut source, &options, &mut |record| {
            names.extend(record.name);
            Ok(())
        });
        let dropped = summary.unwrap().dropped;
        let broken = dropped.iter().find(|dropped| dropped.what == "broken shapes").expect(second);
        assert_eq!((names.join(" ").as_str(), broken.count), ("a c", 1), "{second}");
    }
}
