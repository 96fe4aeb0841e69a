use std::io::Write;

use super::super::testing::records_within;
use super::*;

const LINE: &str = "{\"points\":[[0.0,1.0]]}\n";

/// An archive of files that are stored, without compression.
fn archive(files: &[(&str, &[u8])]) -> Vec<u8> {
    let (mut bytes, mut directory) = (Vec::new(), Vec::new());
    for (name, content) in files {
        let mut sum = flate2::Crc::new();
        sum.update(content);
        let size = (content.len() as u32).to_le_bytes();
        let common = [
            &[20, 0, 0, 0, 0, 0, 0, 0, 0x21, 0x50][..],
            &sum.sum().to_le_bytes(),
            &size,
            &size,
            &(name.len() as u16).to_le_bytes(),
            &[0, 0],
        ]
        .concat();
        directory.extend([&b"PK\x01\x02\x14\x00"[..], &common, &[0; 10]].concat());
        directory.extend((bytes.len() as u32).to_le_bytes());
        directory.extend(name.as_bytes());
        bytes.extend([&b"PK\x03\x04"[..], &common, name.as_bytes(), content].concat());
    }
    let count = (files.len() as u16).to_le_bytes();
    let [length, start] = [directory.len() as u32, bytes.len() as u32].map(u32::to_le_bytes);
    bytes.extend(directory);
    bytes.extend([&b"PK\x05\x06\0\0\0\0"[..], &count, &count, &length, &start, &[0, 0]].concat());
    bytes
}

fn records(bytes: &[u8], limits: Limits) -> Result<(Vec<Record>, Summary), FileError> {
    let mut found = Vec::new();
    let mut source = Source::new(bytes, limits)?;
    let format = detect(source.head(), None)?;
    let summary = read_file(format, &mut source, &ReadOptions::default(), &mut |record| {
        found.push(record);
        Ok(())
    })?;
    Ok((found, summary))
}

fn refusal(files: &[(&str, &[u8])]) -> String {
    records(&archive(files), Limits::default()).unwrap_err().to_string()
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

#[test]
fn files_are_read_in_the_order_of_the_directory() {
    let two = [LINE, LINE].concat();
    let bytes = archive(&[
        ("b/", b""),
        ("b/z.ndjson", LINE.as_bytes()),
        ("a.v1.ndjson.gz", &gzip(LINE.as_bytes())),
        ("__MACOSX/._a.ndjson", b"\0\x05\x16\x07"),
        ("read.me", b"hello"),
        ("c.ndjson", two.as_bytes()),
    ]);
    let (found, summary) = records(&bytes, Limits::default()).unwrap();
    let places: Vec<_> = found.iter().map(|r| (r.name.as_deref(), r.place.to_string())).collect();
    let expected = [
        (Some("z"), "file 'b/z.ndjson', line 1"),
        (Some("a.v1"), "file 'a.v1.ndjson.gz', line 1"),
        (Some("c/1"), "file 'c.ndjson', line 1"),
        (Some("c/2"), "file 'c.ndjson', line 2"),
    ];
    assert_eq!(places, expected.map(|(name, place)| (name, place.to_owned())));
    assert_eq!((summary.records, &summary.properties["files"]), (4, &3.into()));
    let dropped: Vec<_> = summary.dropped.iter().map(|d| (d.what.as_str(), d.names.concat())).collect();
    let expected = [
        ("attributes of an operating system", "__MACOSX/._a.ndjson"),
        ("files of no known format", "read.me"),
    ];
    assert_eq!(dropped, expected.map(|(what, name)| (what, name.to_owned())));
}

#[test]
fn names_that_lead_out_of_the_archive_are_refused() {
    for name in
        ["../a.ndjson", "b/../../a.ndjson", "/a.ndjson", "b\\..\\a.ndjson", "\\a.ndjson", "C:a.ndjson"]
    {
        let expected = "expected names of files within the archive, got one that leads out of it";
        let refused = refusal(&[("ok.ndjson", LINE.as_bytes()), (name, LINE.as_bytes())]);
        assert_eq!(refused, format!("file '{name}': {expected}"));
    }
    let long = refusal(&[(&"a".repeat(1025), LINE.as_bytes())]);
    assert!(long.starts_with("expected a name of at most 1024 bytes, got 1025 of 'aaa"), "{long}");
    let twice = refusal(&[("a.ndjson", LINE.as_bytes()), ("a.ndjson", b"")]);
    assert_eq!(twice, "expected files with names of their own, got two with the same name");
}

#[test]
fn faults_name_the_file() {
    let refused = refusal(&[("a.ndjson", b"{\"points\":[[0]")]);
    assert!(
        refused.starts_with("file 'a.ndjson', column 14, line 1: expected the end of a list"),
        "{refused}"
    );
    let inner = archive(&[("a.ndjson", LINE.as_bytes())]);
    for name in ["inner.zip", "inner"] {
        let expected = "expected files of shapes, got an archive within the archive";
        assert_eq!(refusal(&[(name, &inner)]), format!("file '{name}': {expected}"));
    }
    let expected = "expected an archive with files of a known format, got 1 others";
    assert_eq!(refusal(&[("read.me", b"hello")]), expected);
    assert_eq!(refusal(&[]), "expected an archive with files of a known format, got 0 others");
}

#[test]
fn bombs_end_at_the_limit_of_content() {
    let zeros = gzip(&vec![b' '; 1 << 20]);
    let bytes = archive(&[("a.ndjson.gz", &zeros), ("b.ndjson.gz", &zeros)]);
    let limits = Limits { content: (3 << 19) + bytes.len() as u64, ..Limits::default() };
    let error = records(&bytes, limits).unwrap_err();
    assert_eq!(error.kind, FaultKind::TooLarge, "{error}");
    assert_eq!(error.place.entry.as_deref(), Some("b.ndjson.gz"));
    assert_eq!(
        records(&bytes, Limits { records: 0, ..Limits::default() }).unwrap().0,
        [],
        "blank lines are no shapes"
    );
}

#[test]
fn damaged_archives_are_refused() {
    let bytes = archive(&[("a.ndjson", LINE.as_bytes()), ("b.ndjson", LINE.as_bytes())]);
    for length in 4..bytes.len() {
        records(&bytes[..length], Limits::default()).unwrap_err();
    }
    for k in 0..bytes.len() {
        let mut changed = bytes.clone();
        changed[k] ^= 0x41;
        // Reads or refuses, without a panic.
        let _ = records(&changed, Limits::default());
    }
    let mut changed = bytes.clone();
    let at = changed.windows(4).position(|window| window == b"0.0,").unwrap();
    changed[at] = b'1';
    let error = records(&changed, Limits::default()).unwrap_err();
    assert_eq!((error.kind, error.place.entry.as_deref()), (FaultKind::Malformed, Some("a.ndjson")));
}

#[cfg(feature = "meshes")]
#[test]
fn memory_is_asked_for_whole_files() {
    // Two files that are held as a whole, and one that is read line by line.
    let mesh = [b"OFF\n1 0 0\n0 0 0\n".as_slice(), &vec![b' '; 2 << 20]].concat();
    let lines = LINE.repeat(100_000);
    let bytes = archive(&[("a.off", &mesh), ("b.off", &mesh), ("c.ndjson", lines.as_bytes())]);
    let largest = std::cell::Cell::new(0);
    let source = Source::new(&bytes[..], Limits::default()).unwrap();
    let mut source = source.asking(|found| {
        largest.set(largest.get().max(found.bytes()));
        Ok(())
    });
    let summary = read_file(&FORMAT, &mut source, &ReadOptions::default(), &mut |_| Ok(())).unwrap();
    assert_eq!((summary.records, largest.get()), (100_002, mesh.len()));
}

#[test]
fn files_that_overlap_are_refused() {
    let mut bytes = archive(&[("a.ndjson", LINE.as_bytes()), ("b.ndjson", LINE.as_bytes())]);
    let entry = bytes.windows(4).rposition(|window| window == b"PK\x01\x02").unwrap();
    bytes[entry + 42..entry + 46].fill(0);
    let error = records(&bytes, Limits::default()).unwrap_err();
    let expected = "expected files with bytes of their own in the archive, got some that overlap";
    assert_eq!((error.kind, error.to_string().as_str()), (FaultKind::Malformed, expected));
}

#[cfg(all(feature = "meshes", feature = "morphometrics"))]
#[test]
fn files_that_are_read_again_are_bounded_by_those_that_have_been_read() {
    let file = format!("v 0 0 0\n# {}\n", "x".repeat(2 << 20));
    let read = |rows: usize| {
        let rows = [r#"{"shape_1":"a.obj"}"#].repeat(rows).join(",");
        let project = format!("{{\"data\":[{rows}]}}");
        let bytes = archive(&[("a.swproj", project.as_bytes()), ("a.obj", file.as_bytes())]);
        let options = ReadOptions::from_pairs([("files", "shape")]).unwrap();
        records_within(&FORMAT, &bytes, &options, Limits::default()).map(|(found, _)| found.len())
    };
    // It counts 4 MiB, in the archive and decompressed, and 128 MiB may be read again.
    assert_eq!(read(32).unwrap(), 32);
    let error = read(34).unwrap_err();
    assert_eq!((error.kind, error.place.entry.as_deref()), (FaultKind::TooLarge, Some("a.obj")));
    assert!(error.detail.contains(" bytes of files that are read again in "), "{error}");
}

#[cfg(all(feature = "meshes", feature = "morphometrics"))]
#[test]
fn a_file_that_is_read_again_is_counted_and_warns_once() {
    let project = r#"{"data":[{"shape_1":"a.obj"},{"shape_1":"a.obj"},{"shape_1":"b.obj"}]}"#;
    let point = b"v 0 0 0\n";
    let bytes = archive(&[("a.swproj", project.as_bytes()), ("a.obj", point), ("b.obj", point)]);
    let mut archive = opened(bytes.clone()).unwrap();
    let source = Source::new(&bytes[..], Limits::default()).unwrap();
    let summary = Summary::default();
    let first: Rc<Cell<u64>> = Rc::default();
    let again = Budget::new(AGAIN, Rc::clone(&first));
    let mut files = Files {
        archive: &source,
        images: &NoImages,
        content: 0,
        first,
        again,
        summary,
        facts: None,
        has_shapes: false,
        picture: None,
    };
    let options = ReadOptions::from_pairs([("files", "shape")]).unwrap();
    let count = projects::read(&mut archive, &mut files, &options, &mut |_| Ok(())).unwrap();
    assert_eq!(count, Some(3));
    // Each has eight bytes in the archive, and eight come out.
    assert_eq!((files.first.get(), files.again.taken()), (32, 16));
    let warning = "points without faces are read as landmarks";
    assert_eq!(files.summary.warnings, ["a", "b"].map(|name| format!("file '{name}.obj': {warning}")));
}

/// Takes every file of the name `….img` for an image with a label.
struct OneLabel(Option<&'static str>);

impl Images for OneLabel {
    fn has(&self, _: &[u8], name: &str) -> bool {
        name.ends_with(".img")
    }

    fn read(
        &self,
        source: &mut Source<'_>,
        options: &ReadOptions,
        sink: Sink<'_>,
    ) -> Result<Summary, FileError> {
        assert_eq!(options.select.as_deref(), self.0, "options are those of the archive");
        if source.bytes()?.is_empty() {
            return Err(FileError::new(FaultKind::Unsupported, "expected labels, got none"));
        }
        let points = crate::shape::Points::from_rows(2, vec![0.0, 0.0, 1.0, 0.0, 0.0, 1.0]);
        let geometry = crate::shape::Geometry::Curve { points, closed: true };
        sink(Record { name: Some("7".into()), ..Record::new(geometry, Place::item(0)) })?;
        Ok(Summary::default())
    }
}

#[test]
fn images_are_read_by_the_reader_of_the_caller() {
    let given = |files: &[(&str, &[u8])]| {
        let bytes = archive(files);
        let options = ReadOptions { select: Some("*".into()), ..ReadOptions::default() };
        let mut source = Source::new(&bytes[..], Limits::default())?;
        let mut names = Vec::new();
        let summary = super::super::registry::read_beside(
            &FORMAT,
            &mut source,
            &options,
            &OneLabel(Some("*")),
            &mut |record| {
                names.push(record.name.unwrap_or_default());
                Ok(())
            },
        )?;
        Ok::<_, FileError>((names, summary))
    };
    let (names, summary) = given(&[("day/a.img", b"x"), ("b.img", b"x"), ("read.me", b"hello")]).unwrap();
    assert_eq!((names.join(" ").as_str(), summary.records), ("a/7 b/7", 2));
    assert_eq!(summary.dropped[0].names, ["read.me"]);
    let refused = given(&[("a.img", b"x"), ("day/b.img", b"")]).unwrap_err();
    assert_eq!(refused.to_string(), "file 'day/b.img': expected labels, got none");
}

#[test]
fn a_picture_beside_shapes_is_counted() {
    let given = |files: &[(&str, &[u8])]| {
        let bytes = archive(files);
        let options = ReadOptions::default();
        let mut source = Source::new(&bytes[..], Limits::default())?;
        super::super::registry::read_beside(&FORMAT, &mut source, &options, &OneLabel(None), &mut |_| Ok(()))
    };
    let line = b"{\"points\":[[0,0],[1,0],[0,1]]}\n".as_slice();
    for files in [[("a.ndjson", line), ("texture.img", b"")], [("a.img", b""), ("b.ndjson", line)]] {
        let summary = given(&files).unwrap();
        assert_eq!((summary.records, summary.dropped[0].what.as_str()), (1, "pictures without labels"));
    }
    for files in [vec![("a.img", b"".as_slice())], vec![("a.img", b""), ("b.img", b"x")]] {
        let error = given(&files).unwrap_err();
        assert_eq!((error.kind, error.place.entry.as_deref()), (FaultKind::Unsupported, Some("a.img")));
    }
    // A fault of the caller is not a fault of the picture.
    let bytes = archive(&[("a.img", b"x"), ("b.ndjson", line)]);
    let options = ReadOptions::default();
    let mut source = Source::new(&bytes[..], Limits::default()).unwrap();
    let refuse = &mut |_| Err(FileError::new(FaultKind::Unsupported, "another unit"));
    let error = super::super::registry::read_beside(&FORMAT, &mut source, &options, &OneLabel(None), refuse)
        .unwrap_err();
    assert!(error.to_string().contains("another unit"), "{error}");
}
