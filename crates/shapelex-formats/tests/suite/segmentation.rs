//! DICOM segmentations: bits, numbers, places of frames, and files that are wrong.

use shapelex_formats::image::{
    ImageError, ImageFile, Limits, describe, detect, label_names, read, read_labels,
};

use crate::cost::compare;
use crate::dicom::{BIG, EXPLICIT, Encoding, IMPLICIT, file};
use crate::files::{LIMITS, refusal};

/// A small file, each part of which can be wrong. Frames are 3 × 2 cells.
struct Small<'a> {
    encoding: Encoding,
    kind: &'a str,
    bits: u16,
    /// Segment and position of each frame.
    frames: Vec<(u16, [f64; 3])>,
    pixels: Vec<u8>,
    between: &'a str,
    /// Empty items behind what all frames share, and of a sequence that is not read.
    empty: [usize; 2],
    /// Number of images that it refers to.
    images: usize,
}

impl Default for Small<'_> {
    fn default() -> Self {
        // Three frames of 6 cells: 110000, 000011, 101010, the least significant bit first.
        let pixels = vec![0b0000_0011, 0b0101_1100, 0b01];
        let frames = vec![(1, [5.0, 6.0, 7.0]), (2, [5.0, 6.0, 7.0]), (1, [5.0, 6.0, 11.0])];
        Self {
            encoding: IMPLICIT,
            kind: "BINARY",
            bits: 1,
            frames,
            pixels,
            between: "2",
            empty: [0; 2],
            images: 0,
        }
    }
}

impl Small<'_> {
    fn data_set(&self) -> Vec<u8> {
        let e = self.encoding;
        let [shared, others] = self.empty.map(|count| vec![Vec::new(); count]);
        let plane = [vec![e.text(0x0020_0037, "DS", "1\\0\\0\\0\\1\\0")], shared].concat();
        let plane = e.sequence(0x0020_9116, &plane);
        let measures =
            [e.text(0x0018_0088, "DS", self.between), e.text(0x0028_0030, "DS", "0.5\\0.25")].concat();
        let shared = [plane, e.sequence(0x0028_9110, &[measures])].concat();
        let frame = |(segment, [x, y, z]): &(u16, [f64; 3])| {
            let position = e.text(0x0020_0032, "DS", &format!("{x}\\{y}\\{z}"));
            let number = e.number(0x0062_000b, *segment);
            [e.sequence(0x0020_9113, &[position]), e.sequence(0x0062_000a, &[number])].concat()
        };
        let frames: Vec<Vec<u8>> = self.frames.iter().map(frame).collect();
        let segment =
            |(k, name): (u16, &str)| [e.number(0x0062_0004, k), e.text(0x0062_0005, "LO", name)].concat();
        let segments: Vec<Vec<u8>> = [(1, "Liver"), (2, "Spleen")].map(segment).into();
        let images = e.sequence(0x0008_1115, &[e.sequence(0x0008_114a, &vec![Vec::new(); self.images])]);
        [
            e.text(0x0008_0016, "UI", "1.2.840.10008.5.1.4.1.1.66.4"),
            images,
            e.text(0x0028_0008, "IS", &self.frames.len().to_string()),
            e.number(0x0028_0010, 2),
            e.number(0x0028_0011, 3),
            e.number(0x0028_0100, self.bits),
            e.sequence(0x0040_0555, &others),
            e.text(0x0062_0001, "CS", self.kind),
            e.sequence(0x0062_0002, &segments),
            e.sequence(0x5200_9229, &[shared]),
            e.sequence(0x5200_9230, &frames),
            e.bytes(0x7fe0_0010, if self.bits > 8 { "OW" } else { "OB" }, &self.pixels),
        ]
        .concat()
    }

    fn file(&self) -> Vec<u8> {
        self.encoding.file(&self.data_set())
    }
}

#[test]
fn bits_become_labels_in_their_slices() {
    for encoding in [IMPLICIT, EXPLICIT] {
        let bytes = Small { encoding, ..Small::default() }.file();
        let labels = read_labels(&bytes, &LIMITS).unwrap();
        // 2 mm apart: the middle slice has no frame.
        assert_eq!(labels.grid.size(), [3, 2, 3]);
        assert_eq!(labels.grid.affine(), [[0.25, 0.0, 0.0, 5.0], [0.0, 0.5, 0.0, 6.0], [0.0, 0.0, 2.0, 7.0]]);
        assert_eq!(labels.values[..6], [1, 1, 0, 0, 2, 2]);
        assert_eq!(labels.values[6..12], [0; 6]);
        assert_eq!(labels.values[12..], [1, 0, 1, 0, 1, 0]);
        assert_eq!(describe(&bytes, &LIMITS).unwrap().grid, labels.grid);
        assert_eq!(read(&bytes, &LIMITS).unwrap().values[4], 2.0);
        let names: Vec<_> = label_names(&bytes, &LIMITS).unwrap().into_iter().collect();
        assert_eq!(names, [(1, "Liver".to_owned()), (2, "Spleen".to_owned())]);
    }
}

#[test]
fn numbers_of_labels_are_read() {
    let frames = vec![(0, [0.0, 0.0, 0.0]), (0, [0.0, 0.0, -2.0])];
    let pixels: Vec<u8> = (0..12).collect();
    let small = Small { kind: "LABELMAP", bits: 8, frames: frames.clone(), pixels, ..Small::default() };
    let values = read_labels(&small.file(), &LIMITS).unwrap().values;
    assert_eq!(values, [6, 7, 8, 9, 10, 11, 0, 1, 2, 3, 4, 5]);
    let pixels: Vec<u8> = (0..12_u16).flat_map(|value| (1000 * value).to_le_bytes()).collect();
    let small = Small { kind: "LABELMAP", bits: 16, frames, pixels, encoding: EXPLICIT, ..Small::default() };
    assert_eq!(read_labels(&small.file(), &LIMITS).unwrap().values[1], 7000);
}

#[test]
fn shares_are_values_of_an_image_and_no_labels() {
    let frames = vec![(1, [0.0, 0.0, 0.0])];
    let small = Small {
        kind: "FRACTIONAL",
        bits: 8,
        frames,
        pixels: vec![0, 50, 100, 150, 200, 255],
        ..Small::default()
    };
    assert_eq!(read(&small.file(), &LIMITS).unwrap().values, [0.0, 50.0, 100.0, 150.0, 200.0, 255.0]);
    let error = read_labels(&small.file(), &LIMITS).unwrap_err().to_string();
    let expected =
        "expected segments of whole cells (BINARY or LABELMAP) in a DICOM Segmentation file, got FRACTIONAL";
    assert_eq!(error, expected);
    let frames = vec![(1, [0.0, 0.0, 0.0]), (2, [0.0, 0.0, 0.0])];
    let small = Small { kind: "FRACTIONAL", bits: 8, frames, pixels: vec![0; 12], ..Small::default() };
    assert!(refusal(&small.file()).ends_with("got segments 1 and 2"));
}

#[test]
fn segments_that_overlap_are_refused() {
    let small = Small { pixels: vec![0b0100_0011, 0, 0], ..Small::default() };
    let expected = Err(ImageError::Overlap { index: 0, segments: [1, 2] });
    assert_eq!(read_labels(&small.file(), &LIMITS), expected);
}

/// The label images of a file, with their segments.
fn parts(bytes: &[u8], wanted: &dyn Fn(u32) -> bool) -> Vec<(Option<u32>, ImageFile<u32>)> {
    let mut found = Vec::new();
    let format = detect(bytes).unwrap();
    format
        .each_label_image(bytes, &LIMITS, wanted, &mut |part| {
            found.push((part.label, part.image));
            true
        })
        .unwrap();
    found
}

#[test]
fn segments_that_overlap_are_given_one_after_the_other() {
    // Six slices of 2 mm: segment 1 in the first two, segment 2 in the second and the last.
    let z = |k: u8| [0.0, 0.0, 2.0 * f64::from(k)];
    let frames = vec![(2, z(5)), (1, z(0)), (2, z(1)), (1, z(1))];
    // 111111, 110000, 011000, 110000
    let pixels = vec![0b1111_1111, 0b0110_0000, 0b0000_1100];
    let small = Small { frames, pixels, ..Small::default() };
    let error = read_labels(&small.file(), &LIMITS).unwrap_err();
    assert!(matches!(error, ImageError::Overlap { .. }), "{error}");
    let found = parts(&small.file(), &|_| true);
    let [(Some(1), one), (Some(2), two)] = &found[..] else { panic!("{found:?}") };
    // One slice more where there is one.
    assert_eq!((one.grid.size(), two.grid.size()), ([3, 2, 3], [3, 2, 6]));
    assert_eq!(one.values, [[1, 1, 0, 0, 0, 0], [1, 1, 0, 0, 0, 0], [0; 6]].concat());
    let blank = [0; 6];
    let expected = [blank, [0, 2, 2, 0, 0, 0], blank, blank, blank, [2; 6]].concat();
    assert_eq!(two.values, expected);
    assert_eq!(two.grid.affine()[2][3], 0.0);
    let few = parts(&small.file(), &|segment| segment == 2);
    assert_eq!(few.iter().map(|(segment, _)| *segment).collect::<Vec<_>>(), [Some(2)]);
    // Without an overlap there is one image of all.
    assert_eq!(parts(&Small::default().file(), &|_| false)[0].0, None);
}

#[test]
fn a_volume_ends_where_its_last_image_is() {
    // Two frames in slices 0 and 2 of three.
    for (images, open) in [(0, true), (2, true), (3, false), (40, true)] {
        let small = Small { images, ..Small::default() };
        assert_eq!(read_labels(&small.file(), &LIMITS).unwrap().grid.has_open_ends(), open, "{images}");
    }
    let flat = Small { frames: vec![(1, [0.0; 3])], pixels: vec![1], ..Small::default() };
    assert!(!read_labels(&flat.file(), &LIMITS).unwrap().grid.has_open_ends());
}

#[test]
fn frames_must_form_a_volume() {
    let at = |frames: Vec<(u16, [f64; 3])>| refusal(&Small { frames, ..Small::default() }.file());
    let z = |z: f64| [0.0, 0.0, z];
    assert!(
        at(vec![(1, z(0.0)), (2, z(0.0)), (1, [0.0, 1.0, 2.0])]).ends_with("got one that is 1.000 mm aside")
    );
    assert!(at(vec![(1, z(0.0)), (1, z(3.0)), (1, z(7.0))]).ends_with("got gaps of 3.000 mm and others"));
    assert!(at(vec![(1, z(0.0)), (1, z(0.0)), (1, z(7.0))]).ends_with("got two of segment 1 in slice 0"));
    assert!(at(vec![(1, z(0.0)), (1, z(2.0)), (1, z(1e12))]).starts_with("expected at most 4096 cells"));
    // Gaps that are no multiples of the distance of the file: the least gap is one.
    let frames = vec![(1, z(0.0)), (1, z(3.0)), (1, z(9.0))];
    let image = read_labels(&Small { frames, ..Small::default() }.file(), &LIMITS).unwrap();
    assert_eq!((image.grid.size()[2], image.grid.spacing()[2]), (4, 3.0));
}

#[test]
fn wrong_files_are_refused() {
    let bytes = Small::default().file();
    for length in 0..bytes.len() {
        assert!(read(&bytes[..length], &LIMITS).is_err(), "{length}");
    }
    for at in 128..bytes.len() {
        for value in [0x00, 0x01, 0x7f, 0xff] {
            let mut bytes = bytes.clone();
            bytes[at] = value;
            let _ = (read(&bytes, &LIMITS), label_names(&bytes, &LIMITS));
        }
    }
    let short = refusal(&Small { pixels: vec![3], ..Small::default() }.file());
    assert!(short.starts_with("expected 3 bytes of DICOM Segmentation pixels, got 2"), "{short}");
    let bits = refusal(&Small { bits: 8, ..Small::default() }.file());
    assert!(bits.ends_with("got 8"), "{bits}");
    let big = refusal(&Small { encoding: BIG, ..Small::default() }.file());
    assert!(big.starts_with("expected the least significant byte first"), "{big}");
    let mut set = Small { encoding: EXPLICIT, pixels: Vec::new(), ..Small::default() }.data_set();
    set.truncate(set.len() - EXPLICIT.header(0x7fe0_0010, "OB", 0).len());
    let mut compressed = set.clone();
    compressed.extend(EXPLICIT.header(0x7fe0_0010, "OB", u32::MAX));
    compressed.extend([0xfe, 0xff, 0, 0xe0, 0, 0, 0, 0, 0xfe, 0xff, 0xdd, 0xe0, 0, 0, 0, 0]);
    let refused = refusal(&file("1.2.840.10008.1.2.5", &compressed));
    assert!(
        refused.starts_with(
            "expected pixels as they are, or run lengths of bytes in a DICOM Segmentation file, got RLE"
        ),
        "{refused}"
    );
    assert!(refusal(&EXPLICIT.file(&set)).ends_with("expected pixels (7FE0,0010), got none"));
}

#[test]
fn what_frames_share_is_not_read_again_for_every_frame() {
    let frames: Vec<_> = (0..4000_u16).map(|k| (1, [0.0, 0.0, 2.0 * f64::from(k)])).collect();
    let file =
        |empty| Small { frames: frames.clone(), pixels: vec![0; 3000], empty, ..Small::default() }.file();
    let (shared, others) = (file([4000, 0]), file([0, 4000]));
    let limits = Limits { bytes: 1 << 24, cells: 1 << 16 };
    let read = |bytes: &[u8]| assert_eq!(read_labels(bytes, &limits).unwrap().grid.size(), [3, 2, 4000]);
    compare(|| read(&shared), || read(&others));
}

#[test]
fn long_texts_and_numbers_are_refused() {
    let between = format!("2{}", " ".repeat(1024));
    let refused = refusal(&Small { between: &between, ..Small::default() }.file());
    assert!(refused.ends_with("expected 1 numbers, got 1026 bytes"), "{refused}");
}
