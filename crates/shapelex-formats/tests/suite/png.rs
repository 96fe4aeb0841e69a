//! PNG: colour types, depths, labels, and files that are wrong.

use ::png::{BitDepth, ColorType};
use shapelex_formats::image::{ImageError, LengthUnit, Limits, ValueType, describe, read, read_labels};

use crate::files::{LIMITS, header_refusal, is_refused_when_cut_off, png, refusal};

#[test]
fn grey_values_are_kept_as_integers() {
    let file = png([3, 2], ColorType::Grayscale, BitDepth::Eight, &[0, 1, 2, 100, 200, 255]);
    let image = read(&file, &LIMITS).unwrap();
    assert_eq!(
        (image.grid.size(), &image.values[..]),
        ([3, 2, 1], &[0.0, 1.0, 2.0, 100.0, 200.0, 255.0][..])
    );
    assert_eq!((image.grid.spacing(), image.grid.units()), ([1.0; 3], [LengthUnit::Cell; 3]));
    assert_eq!(read_labels(&file, &LIMITS).unwrap().values, [0, 1, 2, 100, 200, 255]);
    is_refused_when_cut_off(&file[..file.len() - 12]);
    let file = png([2, 1], ColorType::Grayscale, BitDepth::Sixteen, &[1, 2, 255, 255]);
    assert_eq!(read(&file, &LIMITS).unwrap().values, [258.0, 65535.0]);
    assert_eq!(read_labels(&file, &LIMITS).unwrap().values, [258, 65535]);
    assert_eq!(describe(&file, &LIMITS).unwrap().stored, ValueType::U16);
}

#[test]
fn grey_values_of_few_bits_are_not_stretched() {
    for (depth, byte, expected) in [
        (BitDepth::One, 0b1011_0000, [1, 0, 1, 1]),
        (BitDepth::Two, 0b1101_1000, [3, 1, 2, 0]),
        (BitDepth::Four, 0xf0, [15, 0, 7, 1]),
    ] {
        let bytes = if depth == BitDepth::Four { vec![byte, 0x71] } else { vec![byte] };
        let file = png([4, 1], ColorType::Grayscale, depth, &bytes);
        assert_eq!(read_labels(&file, &LIMITS).unwrap().values, expected);
        assert_eq!(read(&file, &LIMITS).unwrap().values, expected.map(|value| value as f32));
    }
}

#[test]
fn colours_become_luma_and_alpha_is_left_out() {
    // 0.2126 · 100 + 0.7152 · 50 + 0.0722 · 200 = 71.46; the nearest number of single precision.
    let rgb = png([2, 1], ColorType::Rgb, BitDepth::Eight, &[100, 50, 200, 9, 9, 9]);
    assert_eq!(read(&rgb, &LIMITS).unwrap().values, [71.46, 9.0]);
    let rgba = png([2, 1], ColorType::Rgba, BitDepth::Eight, &[100, 50, 200, 0, 9, 9, 9, 128]);
    assert_eq!(read(&rgba, &LIMITS).unwrap().values, [71.46, 9.0]);
    let rgb = png([1, 1], ColorType::Rgb, BitDepth::Sixteen, &[1, 0, 2, 0, 3, 0]);
    // 256 (0.2126 + 2 · 0.7152 + 3 · 0.0722) = 476.0576
    assert_eq!(read(&rgb, &LIMITS).unwrap().values, [476.0576]);
    let grey = png([2, 1], ColorType::GrayscaleAlpha, BitDepth::Eight, &[5, 0, 6, 255]);
    assert_eq!(read(&grey, &LIMITS).unwrap().values, [5.0, 6.0]);
    // Entries 1, 2, 3 of the palette: red, grey 50, (10, 20, 30).
    let palette = png([3, 1], ColorType::Indexed, BitDepth::Two, &[0b0110_1100]);
    let expected =
        [0.2126 * 255.0, 50.0, 0.2126 * 10.0 + 0.7152 * 20.0 + 0.0722 * 30.0].map(|value: f64| value as f32);
    assert_eq!(read(&palette, &LIMITS).unwrap().values, expected);
    assert_eq!(describe(&palette, &LIMITS).unwrap().channels, 3);
}

#[test]
fn labels_may_be_grey_pixels_of_any_colour_type() {
    let rgba = png([2, 1], ColorType::Rgba, BitDepth::Eight, &[7, 7, 7, 255, 200, 200, 200, 0]);
    assert_eq!(read_labels(&rgba, &LIMITS).unwrap().values, [7, 200]);
    let coloured = png([2, 1], ColorType::Rgb, BitDepth::Eight, &[7, 7, 7, 255, 0, 0]);
    assert_eq!(
        read_labels(&coloured, &LIMITS),
        Err(ImageError::Colour { index: 1, colour: [255.0, 0.0, 0.0] })
    );
}

/// As VOC and DAVIS have them: colours are for the eye.
#[test]
fn labels_of_a_palette_are_its_positions() {
    for (depth, bytes, expected) in [
        (BitDepth::One, vec![0b1010_0000, 0b0100_0000], [1, 0, 1, 0, 1, 0]),
        (BitDepth::Two, vec![0b0001_1000, 0b1100_0100], [0, 1, 2, 3, 0, 1]),
        (BitDepth::Four, vec![0x01, 0x20, 0x32, 0x10], [0, 1, 2, 3, 2, 1]),
        (BitDepth::Eight, vec![0, 1, 2, 3, 2, 1], [0, 1, 2, 3, 2, 1]),
    ] {
        let file = png([3, 2], ColorType::Indexed, depth, &bytes);
        assert_eq!(read_labels(&file, &LIMITS).unwrap().values, expected, "{depth:?}");
        for length in 0..file.len() - 12 {
            assert!(read_labels(&file[..length], &LIMITS).is_err(), "{depth:?}, {length} bytes");
        }
    }
}

/// A chunk with its checksum.
fn chunk(name: &[u8; 4], content: &[u8]) -> Vec<u8> {
    let body = [&name[..], content].concat();
    let mut sum = flate2::Crc::new();
    sum.update(&body);
    [&(content.len() as u32).to_be_bytes()[..], &body, &sum.sum().to_be_bytes()].concat()
}

/// A file of 8-bit grey pixels that only claims its size.
fn claim(width: u32, height: u32) -> Vec<u8> {
    let header = [&width.to_be_bytes()[..], &height.to_be_bytes(), &[8, 0, 0, 0, 0]].concat();
    [b"\x89PNG\r\n\x1a\n".to_vec(), chunk(b"IHDR", &header), chunk(b"IDAT", &[1; 900]), chunk(b"IEND", &[])]
        .concat()
}

#[test]
fn sizes_are_checked_before_memory_is_taken() {
    assert_eq!(
        header_refusal(&claim(100_000, 100_000)),
        "expected at most 4096 cells, got 100000 × 100000 × 1"
    );
    assert_eq!(header_refusal(&claim(0, 7)), "expected at least one cell along every axis, got 0 × 7 × 1");
    // Without limits, 10¹⁰ pixels are more than 1032 times the bytes of the file.
    let (file, all) = (claim(100_000, 100_000), Limits { bytes: u64::MAX, cells: u64::MAX });
    let found = 1032 * file.len() as u64;
    let expected = ImageError::Truncated { place: "PNG pixels", expected: 100_001 * 100_000, found };
    assert_eq!(read(&file, &all), Err(expected));
    let few = Limits { bytes: 100, cells: 4096 };
    let error = read(&png([20, 5], ColorType::Grayscale, BitDepth::Eight, &[0; 100]), &few).unwrap_err();
    // Each row has a byte more, which names its filter.
    assert_eq!(error.to_string(), "expected at most 100 bytes of PNG pixels, got 105");
}

#[test]
fn damaged_files_are_refused() {
    let file = png([4, 4], ColorType::Grayscale, BitDepth::Eight, &[9; 16]);
    let fault = "expected a valid PNG file, got one with a fault:";
    let mut damaged = file.clone();
    damaged[45] ^= 0xff;
    assert!(refusal(&damaged).starts_with(fault), "{}", refusal(&damaged));
    assert!(refusal(&claim(4, 4)).starts_with(fault), "{}", refusal(&claim(4, 4)));
    assert_eq!(refusal(&file[..file.len() - 20]), "expected a whole PNG file, got one that ends too early");
    let frames = [&2_u32.to_be_bytes()[..], &0_u32.to_be_bytes()].concat();
    let animated = [&file[..33], &chunk(b"acTL", &frames), &file[33..]].concat();
    assert_eq!(refusal(&animated), "expected one image in a PNG file, got an animation of 2");
}

#[test]
fn the_start_of_a_file_is_enough_to_describe_it() {
    let file = png([40, 30], ColorType::Rgb, BitDepth::Eight, &[0; 3600]);
    let described = describe(&file[..33], &LIMITS).unwrap();
    assert_eq!(
        (described.grid.size(), described.stored, described.channels),
        ([40, 30, 1], ValueType::U8, 3)
    );
    // Four bytes for each value, four for each pixel with alpha, two rows, 1 MiB for the decoder.
    assert_eq!(described.memory_bytes, 8 * 1200 + 2 * 121 + (1 << 20));
}
