//! Arrays of NumPy made by hand: of all types and orders, with faults, and with claims that are not true.

use super::super::{FaultKind, FileError, Geometry, Limits, ReadOptions, Source};
use super::npy::{Header, header_bytes};
use super::tests::{read_back, read_with};

/// An array by the parts of its header.
fn array(descr: &str, fortran: &str, shape: &str, items: &[u8]) -> Vec<u8> {
    let text = format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}\n");
    let length = u16::try_from(text.len()).expect("short").to_le_bytes();
    [b"\x93NUMPY\x01\x00".as_slice(), &length, text.as_bytes(), items].concat()
}

#[test]
fn arrays_of_all_types_and_orders() {
    let numbers = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0];
    let items = |write: fn(f64) -> Vec<u8>| numbers.into_iter().flat_map(write).collect::<Vec<u8>>();
    let expected = [[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]];
    for (descr, bytes) in [
        ("<f8", items(|x| x.to_le_bytes().to_vec())),
        (">f8", items(|x| x.to_be_bytes().to_vec())),
        ("<f4", items(|x| (x as f32).to_le_bytes().to_vec())),
        (">f4", items(|x| (x as f32).to_be_bytes().to_vec())),
        ("<i4", items(|x| (x as i32).to_le_bytes().to_vec())),
        (">i2", items(|x| (x as i16).to_be_bytes().to_vec())),
        ("|u1", items(|x| vec![x as u8])),
    ] {
        let (found, _) = read_back(&array(descr, "False", "(2, 2, 2)", &bytes)).expect("an array");
        let found: Vec<_> = found
            .into_iter()
            .map(|record| match record.geometry {
                Geometry::Landmarks(points) => points.coordinates().to_vec(),
                _ => vec![],
            })
            .collect();
        assert_eq!(found, expected.map(Vec::from), "{descr}");
    }
    let bytes = items(|x| x.to_le_bytes().to_vec());
    let rows = |bytes: &[u8], options: &ReadOptions| {
        let (found, _) = read_with(bytes, options, Limits::default()).expect("an array");
        found
            .into_iter()
            .map(|record| match record.geometry {
                Geometry::Landmarks(points) => points.coordinates().to_vec(),
                _ => vec![],
            })
            .collect::<Vec<_>>()
    };
    let plain = ReadOptions::default();
    let flat = ReadOptions { dimension: Some(2), ..ReadOptions::default() };
    let cube = array("<f8", "True", "(2, 2, 2)", &bytes);
    assert_eq!(rows(&cube, &plain), [vec![1.0, 5.0, 3.0, 7.0], vec![2.0, 6.0, 4.0, 8.0]]);
    let table = array("<f8", "True", "(4, 2)", &bytes);
    assert_eq!(rows(&table, &plain), [vec![1.0, 5.0, 2.0, 6.0, 3.0, 7.0, 4.0, 8.0]]);
    assert_eq!(
        rows(&array("<f8", "True", "(2, 4)", &bytes), &flat),
        [[1.0, 3.0, 5.0, 7.0], [2.0, 4.0, 6.0, 8.0]]
    );
    assert_eq!(rows(&array("<f8", "False", "(2, 4)", &bytes), &flat), expected);
    assert_eq!(rows(&array("<f8", "True", "(1, 8)", &bytes), &flat), [numbers]);
    let negative = array("<i2", "False", "(1, 2)", &[0xff, 0xff, 0x01, 0x80]);
    assert_eq!(rows(&negative, &plain), [[-1.0, -32767.0]]);
}

#[test]
fn faults_of_arrays() {
    let bytes: Vec<u8> = (1..9).flat_map(|k| f64::from(k).to_le_bytes()).collect();
    for (descr, shape, message) in [
        ("|O", "(1, 2)", "Python objects, which are programs"),
        ("<c16", "(1, 2)", "items of type '<c16'"),
        ("<U3", "(1, 2)", "flags or texts as points"),
        ("<f8", "(1, 0, 2)", "expected at least one point"),
        ("<f8", "(8,)", "expected shapes × points × coordinates"),
        ("<f8", "(99999999999, 99999999999, 2)", "expected fewer items"),
        ("<f8", "(1, 99999999999, 2)", "expected at most 4194304 points"),
        ("<f8", "(3, 2, 2)", "item 2: expected 32 bytes of an array, got 0"),
        ("<f8", "(1, 2, 2)", "expected the end of the file, got more bytes"),
    ] {
        let error = read_back(&array(descr, "False", shape, &bytes)).expect_err("a fault");
        assert!(error.to_string().contains(message), "{error}");
    }
    let error = read_back(&array("<f8", "True", "(99999999, 99, 2)", &bytes)).expect_err("a large array");
    assert_eq!(error.kind, FaultKind::TooLarge, "{error}");
}

#[test]
fn headers_are_those_of_numpy() {
    let bytes = header_bytes("<f8", &[3, 2]);
    assert_eq!(bytes.len() % 64, 0);
    let header = Header::read(&mut bytes.as_slice()).expect("a header");
    assert_eq!((header.shape.as_slice(), header.fortran, header.size), ([3, 2].as_slice(), false, 8));
    assert!(String::from_utf8_lossy(&header_bytes("<U3", &[4])).contains("'shape': (4,), }"));
}

#[test]
fn arrays_of_other_lengths_are_refused() {
    let zip = |entries: &[(&str, Vec<u8>)]| {
        let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
        for (name, bytes) in entries {
            zip.start_file(*name, zip::write::SimpleFileOptions::default()).expect("a file");
            std::io::Write::write_all(&mut zip, bytes).expect("written");
        }
        zip.finish().expect("the end").into_inner()
    };
    let doubles = |shape: &[usize], values: &[f64]| {
        [header_bytes("<f8", shape), values.iter().flat_map(|x| x.to_le_bytes()).collect()].concat()
    };
    let points = ("points.npy", doubles(&[3, 2], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]));
    let offsets = |values: &[f64]| ("offsets.npy", doubles(&[values.len()], values));
    let found =
        read_back(&zip(&[points.clone(), offsets(&[0.0, 1.0, 3.0]), ("x.npy", vec![])])).expect("arrays");
    assert_eq!((found.0.len(), found.1.dropped[0].names[0].as_str()), (2, "x.npy"));
    for faulty in [&[0.0, 4.0][..], &[1.0, 3.0], &[0.0, 2.5, 3.0], &[0.0, 3.0, 1.0, 3.0]] {
        let error = read_back(&zip(&[points.clone(), offsets(faulty)])).expect_err("offsets");
        assert!(error.to_string().contains("expected offsets that ascend from 0 to the 3 points"), "{error}");
    }
    let ids = ("ids.npy", [header_bytes("<U1", &[2]), vec![0; 8]].concat());
    let error = read_back(&zip(&[points.clone(), ids])).expect_err("two ids of one shape");
    assert_eq!(
        error.to_string(),
        "file 'ids.npy': expected an item for each of 1 shapes, got an array of shape [2]"
    );
    let objects = ("ids.npy", [header_bytes("|O", &[1]), vec![0; 8]].concat());
    let error = read_back(&zip(&[points, objects])).expect_err("objects");
    assert!(error.to_string().contains("Python objects, which are programs"), "{error}");
}

#[test]
fn memory_is_asked_for_arrays_before_they_are_unpacked() {
    let doubles = vec![0_u8; 80_000];
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for name in ["points.npy", "weights.npy"] {
        let shape: &[usize] = if name == "points.npy" { &[5000, 1, 2] } else { &[5000] };
        zip.start_file(name, zip::write::SimpleFileOptions::default()).expect("a file");
        let size = shape.iter().product::<usize>() * 8;
        std::io::Write::write_all(&mut zip, &header_bytes("<f8", shape)).expect("written");
        std::io::Write::write_all(&mut zip, &doubles[..size]).expect("written");
    }
    let bytes = zip.finish().expect("the end").into_inner();
    let asked = std::cell::RefCell::new(Vec::new());
    let source = Source::new(bytes.as_slice(), Limits::default()).expect("a source");
    let mut source = source.asking(|found| {
        let size = found.bytes();
        asked.borrow_mut().push(size - bytes.len());
        if size < bytes.len() + 100_000 { Ok(()) } else { Err(FileError::new(FaultKind::Memory, "none")) }
    });
    let read = super::npz::FORMAT.read.expect("a reader");
    let refused = read(&mut source, &ReadOptions::default(), &mut |_| Ok(())).map(|_| ());
    assert_eq!(refused.expect_err("no memory").kind, FaultKind::Memory);
    assert_eq!(*asked.borrow(), [80_000, 120_000]);
}
