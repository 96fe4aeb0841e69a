//! NRRD: encodings, types, positions, and headers that are wrong.

use shapelex_formats::image::{LengthUnit, describe, label_names, read, read_labels};

use crate::files::{LIMITS, gzip, header_refusal, is_refused_when_cut_off, refusal};

const HEADER: &str = "NRRD0004\n# a comment\ntype: ushort\ndimension: 3\nsizes: 2 2 1\nendian: little\n\
                      space: left-posterior-superior\nspace directions: (2,0,0) (0,3,0) (0,0,4)\n\
                      space origin: (10,20,30)\nkinds: domain domain domain\nencoding: raw\n\
                      Segment0_LabelValue:=300\nSegment0_Name:=heart: left\n\n";

fn raw(header: &str, cells: &[u8]) -> Vec<u8> {
    [header.as_bytes(), cells].concat()
}

fn cells(values: [u16; 4]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

#[test]
fn all_encodings_give_the_same_labels() {
    let values = [0, 300, 2, 65535];
    let file = raw(HEADER, &cells(values));
    let labels = read_labels(&file, &LIMITS).unwrap();
    assert_eq!(labels.values, [0, 300, 2, 65535]);
    assert_eq!(labels.grid.affine(), [[2.0, 0.0, 0.0, 10.0], [0.0, 3.0, 0.0, 20.0], [0.0, 0.0, 4.0, 30.0]]);
    assert_eq!(labels.grid.units(), [LengthUnit::Millimetre; 3]);
    is_refused_when_cut_off(&file);
    let zipped = raw(&HEADER.replace("raw", "gzip"), &gzip(&cells(values)));
    assert_eq!(read_labels(&zipped, &LIMITS).unwrap(), labels);
    is_refused_when_cut_off(&zipped);
    let text = raw(&HEADER.replace("raw", "ascii"), b"0 300\n2, 65535\n");
    assert_eq!(read_labels(&text, &LIMITS).unwrap(), labels);
    let swapped: Vec<u8> = values.iter().flat_map(|value| value.to_be_bytes()).collect();
    assert_eq!(read_labels(&raw(&HEADER.replace("little", "big"), &swapped), &LIMITS).unwrap(), labels);
    let dos = raw(&HEADER.replace('\n', "\r\n"), &cells(values));
    assert_eq!(read_labels(&dos, &LIMITS).unwrap(), labels);
    assert_eq!(read(&file, &LIMITS).unwrap().values, [0.0, 300.0, 2.0, 65535.0]);
    assert_eq!(describe(HEADER.as_bytes(), &LIMITS).unwrap().grid, labels.grid);
    assert_eq!(
        label_names(&file, &LIMITS).unwrap().into_iter().collect::<Vec<_>>(),
        [(300, "heart: left".into())]
    );
}

#[test]
fn labels_of_text_are_exact() {
    let header = HEADER.replace("raw", "text").replace("ushort", "uint64");
    let values = read_labels(&raw(&header, b"4294967295 16777217 0 1"), &LIMITS).unwrap().values;
    assert_eq!(values, [u32::MAX, 16_777_217, 0, 1]);
    assert!(refusal(&raw(&header, b"1 2 3")).ends_with("got 3"));
    assert!(refusal(&raw(&header, b"1 2 3 4 5")).ends_with("expected 4 NRRD cells, got 5"));
    assert!(refusal(&raw(&header, b"1 2 3 x")).ends_with("expected finite numbers in the cells, got 'x'"));
    assert!(refusal(&raw(&header, b"1 2 3 1e999")).ends_with("got '1e999'"));
}

#[test]
fn planes_and_spacings_are_placed() {
    let header = "NRRD0001\ntype: uchar\ndimension: 2\nsizes: 2 1\nencoding: raw\nspacings: 0.5 nan\nunits: \"cm\" \"cm\"\n\n";
    let image = read(&raw(header, &[1, 2]), &LIMITS).unwrap();
    assert_eq!((image.grid.size(), image.grid.spacing()), ([2, 1, 1], [5.0, 10.0, 10.0]));
    let header = header.replace("spacings: 0.5 nan", "space dimension: 3\nspace directions: (0,2,0) (0,0,2)");
    let image = read(&raw(&header, &[1, 2]), &LIMITS).unwrap();
    assert_eq!(image.grid.affine()[0][2].abs(), 10.0);
}

#[test]
fn what_is_not_read_is_named() {
    let with = |old: &str, new: &str| header_refusal(&raw(&HEADER.replace(old, new), &cells([0; 4])));
    let detached = with("encoding: raw", "encoding: raw\ndata file: cells.raw");
    assert_eq!(
        detached,
        "expected cells after the header in a NRRD file, got those of another file (cells.raw)"
    );
    assert!(
        with("raw", "bzip2").ends_with("expected the encoding raw, gzip or ascii in a NRRD file, got bzip2")
    );
    assert!(with("ushort", "block").contains("got block"));
    assert!(with("kinds: domain", "kinds: vector").contains("got vector"));
    assert!(with("dimension: 3", "dimension: 4").contains("expected 2 or 3 axes (dimension)"));
    assert!(with("sizes: 2 2 1", "sizes: 2 2").ends_with("expected 3 entries of sizes, got 2"));
    assert!(with("sizes: 2 2 1", "sizes: 2 0 1").starts_with("expected at least one cell along every axis"));
    assert!(with("sizes: 2 2 1", "sizes: 99999 99999 99999").starts_with("expected at most 4096 cells"));
    assert!(with("endian: little\n", "").ends_with("expected the endian little or big, got none"));
    assert!(with("(2,0,0)", "(2,0)x").contains("expected vectors '(x,y,z)'"));
    assert!(with("(2,0,0)", "(inf,0,0)").ends_with("got 'inf'"));
    assert!(with("(2,0,0)", "(0,3,0)").starts_with("expected an invertible affine map"));
    assert!(with("encoding: raw", "encoding: raw\nencoding: raw").ends_with("in line 12"));
    assert!(with("type: ushort\n", "").ends_with("expected a field 'type', got none"));
    assert!(with("endian: little", "byte skip: 5").contains("got byte skip 5"));
    assert!(refusal(&raw(HEADER, &cells([0; 4])[..5])).ends_with("expected 8 bytes of NRRD cells, got 5"));
    assert!(refusal(&raw(HEADER, &[0; 9])).starts_with("expected the file to end after 8 bytes"));
}

#[test]
fn names_of_segments_are_short() {
    let named =
        |name: &str| label_names(&raw(&HEADER.replace("heart: left", name), &cells([1, 2, 3, 4])), &LIMITS);
    assert_eq!(named(&"x".repeat(1024)).unwrap()[&300].len(), 1024);
    let refused = named(&"x".repeat(1025)).unwrap_err().to_string();
    assert!(refused.ends_with("expected names of segments of at most 1024 bytes, got 1025"), "{refused}");
}
