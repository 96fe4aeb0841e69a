//! TIFF: types, strips, tiles, pages, resolutions, and files that are wrong.

use std::io::{Cursor, Write};

use ::tiff::encoder::{Compression, Predictor, TiffEncoder, colortype};
use shapelex_formats::image::{ImageError, LengthUnit, Limits, ValueType, describe, read, read_labels};
use shapelex_formats::unit::Unit;

use crate::files::{
    LIMITS, Tags, fraction, grey, header_refusal, is_refused_when_cut_off, longs, refusal, shorts, tiff,
};

const STRIPS: [u16; 2] = [273, 279];
const TILES: [u16; 2] = [324, 325];

fn one_page(tags: Tags, pixels: &[u8]) -> Vec<u8> {
    tiff(&[(tags, vec![pixels.to_vec()])], STRIPS)
}

fn changed(mut tags: Tags, change: (u16, u16, u32, Vec<u8>)) -> Tags {
    tags.retain(|tag| tag.0 != change.0);
    tags.push(change);
    tags
}

#[test]
fn grey_pages_of_every_type_are_read() {
    macro_rules! check {
        ($type:ident, $format:literal, $stored:ident) => {
            let values: [$type; 6] =
                [0 as $type, 1 as $type, 2 as $type, 100 as $type, 101 as $type, 127 as $type];
            let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
            let tags = changed(grey([3, 2], 8 * size_of::<$type>() as u16), shorts(339, &[$format]));
            let file = one_page(tags, &bytes);
            assert_eq!(read(&file, &LIMITS).unwrap().values, values.map(|value| value as f32));
            assert_eq!(read_labels(&file, &LIMITS).unwrap().values, [0, 1, 2, 100, 101, 127]);
            let described = describe(&file, &LIMITS).unwrap();
            assert_eq!((described.grid.size(), described.stored), ([3, 2, 1], ValueType::$stored));
            is_refused_when_cut_off(&file);
        };
    }
    check!(u8, 1, U8);
    check!(u16, 1, U16);
    check!(u32, 1, U32);
    check!(u64, 1, U64);
    check!(i8, 2, I8);
    check!(i16, 2, I16);
    check!(i32, 2, I32);
    check!(i64, 2, I64);
    check!(f32, 3, F32);
    check!(f64, 3, F64);
}

#[test]
fn compressed_strips_of_another_writer_are_read() {
    let values: Vec<u16> = (0..35 * 20).map(|cell| (cell * 37 % 1000) as u16).collect();
    let labels: Vec<u32> = values.iter().map(|value| u32::from(*value)).collect();
    for compression in [Compression::Lzw, Compression::Deflate(Default::default()), Compression::Packbits] {
        for predictor in [Predictor::None, Predictor::Horizontal] {
            let mut file = Cursor::new(Vec::new());
            let mut encoder =
                TiffEncoder::new(&mut file).unwrap().with_compression(compression).with_predictor(predictor);
            encoder.write_image::<colortype::Gray16>(35, 20, &values).unwrap();
            let image = read_labels(file.get_ref(), &LIMITS).unwrap();
            assert_eq!((image.grid.size(), &image.values), ([35, 20, 1], &labels));
        }
    }
}

#[test]
fn colours_become_luma() {
    // 0.2126 · 100 + 0.7152 · 50 + 0.0722 · 200 = 71.46; the nearest number of single precision.
    let colour = |samples: &[u16], pixels: &[u8]| {
        let tags = changed(changed(grey([2, 1], 8), shorts(262, &[2])), shorts(258, samples));
        one_page(changed(tags, shorts(277, &[samples.len() as u16])), pixels)
    };
    assert_eq!(read(&colour(&[8; 3], &[100, 50, 200, 9, 9, 9]), &LIMITS).unwrap().values, [71.46, 9.0]);
    assert_eq!(read(&colour(&[8; 4], &[100, 50, 200, 0, 9, 9, 9, 0]), &LIMITS).unwrap().values, [71.46, 9.0]);
    let error = read_labels(&colour(&[8; 3], &[4, 4, 4, 4, 5, 4]), &LIMITS);
    assert_eq!(error, Err(ImageError::Colour { index: 1, colour: [4.0, 5.0, 4.0] }));
    // Each channel in a strip of its own.
    let tags = changed(changed(grey([2, 1], 8), shorts(262, &[2])), shorts(258, &[8; 3]));
    let tags = changed(changed(tags, shorts(277, &[3])), shorts(284, &[2]));
    let file = tiff(&[(tags, vec![vec![100, 9], vec![50, 9], vec![200, 9]])], STRIPS);
    assert_eq!(read(&file, &LIMITS).unwrap().values, [71.46, 9.0]);
    // A fourth channel that is no alpha is left out, except with LZW.
    let further = |method| {
        let tags = changed(changed(grey([2, 1], 8), shorts(262, &[2])), shorts(258, &[8; 4]));
        let tags = changed(changed(tags, shorts(277, &[4])), shorts(338, &[0]));
        one_page(changed(tags, shorts(259, &[method])), &[100, 50, 200, 1, 9, 9, 9, 1])
    };
    assert_eq!(read(&further(1), &LIMITS).unwrap().values, [71.46, 9.0]);
    let expected =
        "expected no further channels beside colour and alpha with LZW in a TIFF file, got 4 channels";
    assert_eq!(header_refusal(&further(5)), expected);
    // Two channels that are no colour.
    let tags = changed(changed(grey([2, 1], 8), shorts(277, &[2])), shorts(258, &[8; 2]));
    let expected = "expected one grey number for each pixel, or RGB in a TIFF file, got 2 channels";
    assert_eq!(header_refusal(&one_page(tags, &[1, 2, 3, 4])), expected);
}

#[test]
fn tiles_are_put_together() {
    // Tiles of 16 × 16 for an image of 20 × 18: the padding is 255.
    let pixel = |x: usize, y: usize| if x < 20 && y < 18 { (x + 20 * y) as u8 / 2 } else { 255 };
    let tile = |left: usize, top: usize| -> Vec<u8> {
        (0..256).map(|place| pixel(left + place % 16, top + place / 16)).collect()
    };
    let mut tags = grey([20, 18], 8);
    tags.retain(|tag| tag.0 != 278);
    tags.extend([shorts(322, &[16]), shorts(323, &[16])]);
    let tiles = vec![tile(0, 0), tile(16, 0), tile(0, 16), tile(16, 16)];
    let file = tiff(&[(tags.clone(), tiles)], TILES);
    let expected: Vec<u32> = (0..20 * 18).map(|cell| u32::from(pixel(cell % 20, cell / 20))).collect();
    assert_eq!(read_labels(&file, &LIMITS).unwrap().values, expected);
    let file = tiff(&[(changed(tags.clone(), shorts(259, &[5])), vec![vec![0; 9]; 4])], TILES);
    assert_eq!(
        header_refusal(&file),
        "expected strips, or tiles without LZW in a TIFF file, got tiles with LZW"
    );
    let channels =
        changed(changed(changed(tags.clone(), shorts(262, &[2])), shorts(258, &[8; 3])), shorts(277, &[3]));
    let file = tiff(&[(changed(channels, shorts(284, &[2])), vec![vec![0; 256]; 12])], TILES);
    assert_eq!(
        header_refusal(&file),
        "expected tiles that hold all channels in a TIFF file, got a tile for each channel"
    );
    // A tile that is far larger than its image is decompressed in full.
    let file = tiff(&[(changed(tags, longs(322, &[1 << 24])), vec![vec![0; 100], vec![0; 100]])], TILES);
    assert_eq!(
        header_refusal(&file),
        format!("expected at most 65536 bytes of TIFF pixels, got {}", 32_u64 << 24)
    );
}

#[test]
fn pages_are_a_volume() {
    let page = |first: u8| (grey([2, 3], 8), vec![(first..first + 6).collect::<Vec<u8>>()]);
    let image = read(&tiff(&[page(0), page(6), page(12), page(18)], STRIPS), &LIMITS).unwrap();
    assert_eq!(image.grid.size(), [2, 3, 4]);
    assert_eq!(image.values, (0..24).map(|value| value as f32).collect::<Vec<_>>());
    let other = (grey([3, 2], 8), vec![vec![0; 6]]);
    let expected = "expected pages of one size and type, 2 × 3 with 1 × U8, spacing 1 × 1 as on page 1, \
                    got 3 × 2 with 1 × U8, spacing 1 × 1 on page 2";
    assert_eq!(header_refusal(&tiff(&[page(0), other], STRIPS)), expected);
    let few = Limits { bytes: 1 << 16, cells: 23 };
    let error = describe(&tiff(&[page(0), page(6), page(12), page(18)], STRIPS), &few).unwrap_err();
    assert_eq!(error, ImageError::Cells { limit: 23, size: [2, 3, 4] });
}

#[test]
fn spacing_follows_from_a_resolution_with_a_unit() {
    let with = |unit: Option<u16>, x: [u32; 2]| {
        let mut tags = grey([1, 1], 8);
        tags.extend([fraction(282, x), fraction(283, [40, 1])]);
        tags.extend(unit.map(|unit| shorts(296, &[unit])));
        one_page(tags, &[1])
    };
    let grid = |unit, x| read(&with(unit, x), &LIMITS).unwrap().grid;
    // 100 cells and 40 cells in a centimetre.
    let centimetre = grid(Some(3), [200, 2]);
    assert_eq!(
        (centimetre.spacing(), centimetre.units()[..2].to_vec()),
        ([0.1, 0.25, 1.0], vec![LengthUnit::Centimetre; 2])
    );
    assert_eq!(centimetre.units()[2], LengthUnit::Unknown);
    // 254 cells in an inch; the quotient and its product with 25.4 are rounded once each.
    assert!((grid(Some(2), [254, 1]).spacing()[0] - 0.1).abs() < 1e-16);
    for unit in [None, Some(1)] {
        let grid = grid(unit, [100, 1]);
        assert_eq!((grid.spacing(), grid.units()), ([1.0; 3], [LengthUnit::Cell; 3]));
    }
    // What programs write where they know of no size.
    for (unit, cells) in [(2, [72, 1]), (2, [96, 1]), (2, [1, 1]), (3, [1, 1]), (3, [28346, 1000])] {
        let mut tags = grey([1, 1], 8);
        tags.extend([fraction(282, cells), fraction(283, cells), shorts(296, &[unit])]);
        let grid = read(&one_page(tags, &[1]), &LIMITS).unwrap().grid;
        assert_eq!((grid.spacing(), grid.units()), ([1.0; 3], [LengthUnit::Cell; 3]), "{unit} {cells:?}");
    }
    assert_eq!(
        header_refusal(&with(Some(2), [0, 1])),
        "expected a positive, finite spacing along x, got inf"
    );
    assert_eq!(header_refusal(&with(Some(2), [1, 0])), "expected a positive, finite spacing along x, got 0");
    assert_eq!(
        header_refusal(&with(Some(2), [0, 0])),
        "expected a positive, finite spacing along x, got NaN"
    );
}

#[test]
fn what_is_not_read_is_refused_by_name() {
    let refused = |change| header_refusal(&one_page(changed(grey([2, 1], 8), change), &[1, 2]));
    let kind = "expected grey (BlackIsZero) or RGB pixels in a TIFF file, got";
    assert_eq!(refused(shorts(262, &[0])), format!("{kind} WhiteIsZero"));
    assert_eq!(refused(shorts(262, &[3])), format!("{kind} RGBPalette"));
    assert_eq!(
        refused(shorts(259, &[7])),
        "expected no compression, LZW, Deflate or PackBits in a TIFF file, got ModernJPEG"
    );
    let orientation =
        "expected rows from the top and columns from the left (orientation 1) in a TIFF file, got 6";
    assert_eq!(refused(shorts(274, &[6])), orientation);
    assert_eq!(
        refused(shorts(258, &[1])),
        "expected numbers of 8, 16, 32 or 64 bits in a TIFF file, got numbers of another length"
    );
    let samples =
        "expected 1 (grey), 3 (colour) or 4 (colour and alpha) numbers for each pixel in a TIFF file, got 9";
    assert_eq!(refused(shorts(277, &[9])), samples);
}

#[test]
fn claims_are_checked_before_memory_is_taken() {
    let large =
        |size: [u32; 2]| changed(changed(grey([1, 1], 8), longs(256, &size[..1])), longs(257, &size[1..]));
    let file = one_page(large([100_000; 2]), &[0; 800]);
    assert_eq!(header_refusal(&file), "expected at most 4096 cells, got 100000 × 100000 × 1");
    assert_eq!(
        header_refusal(&one_page(large([0, 3]), &[1])),
        "expected at least one cell along every axis, got 0 × 3 × 1"
    );
    let all = Limits { bytes: u64::MAX, cells: u64::MAX };
    let file = one_page(changed(large([100_000; 2]), longs(278, &[100_000])), &[0; 800]);
    let expected =
        ImageError::Truncated { place: "TIFF pixels", expected: 10_000_000_000, found: file.len() as u64 };
    assert_eq!(read(&file, &all), Err(expected));
    // A list of 2³⁰ strips that is not there.
    let mut tags = grey([2, 1], 8);
    tags.push((279, 4, 1 << 30, vec![0; 8]));
    let file = tiff(&[(tags, vec![vec![1, 2]])], [273, 280]);
    assert!(header_refusal(&file).ends_with("directories that overlap or go beyond the end of the file"));
}

#[test]
fn lying_and_damaged_files_are_refused() {
    let fault = "expected a valid TIFF file, got one with a fault:";
    // Fewer pixels than announced.
    assert_eq!(
        refusal(&one_page(grey([200, 20], 8), &[1; 5])),
        format!("expected 4000 bytes of TIFF pixels, got {}", one_page(grey([200, 20], 8), &[1; 5]).len())
    );
    let mut deflated = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    deflated.write_all(&[5; 100]).unwrap();
    let deflated = deflated.finish().unwrap();
    let file = one_page(changed(grey([20, 20], 8), shorts(259, &[8])), &deflated);
    assert_eq!(refusal(&file), "expected a whole TIFF file, got one that ends too early");
    let file = one_page(changed(grey([20, 20], 8), shorts(259, &[8])), &[0xff; 50]);
    assert!(refusal(&file).starts_with(fault), "{}", refusal(&file));
    // A directory that is its own successor.
    let mut file = one_page(grey([2, 1], 8), &[1, 2]);
    let (start, end) = (file[4..8].to_vec(), file.len() - 4);
    file[end..].copy_from_slice(&start);
    assert!(header_refusal(&file).starts_with(fault), "{}", header_refusal(&file));
    let float = one_page(changed(grey([2, 1], 32), shorts(339, &[3])), &[0, 0, 0, 0, 0, 0, 0xc0, 0x7f]);
    assert_eq!(refusal(&float), "expected a finite value in single precision, got NaN at cell 1");
}

#[test]
fn strips_that_share_their_bytes_do_not_multiply_the_work() {
    // 60 rows of one pixel each, all of the same 100 kB: empty blocks of Deflate, then a block with one byte.
    let blocks =
        [&[0x78, 0x01][..], &[0, 0, 0, 0xff, 0xff].repeat(20_000), &[1, 1, 0, 0xfe, 0xff, 7, 0, 8, 0, 8]]
            .concat();
    let tags = |height| changed(changed(grey([1, height], 8), shorts(259, &[8])), shorts(278, &[1]));
    let one = tiff(&[(tags(1), vec![blocks.clone()])], STRIPS);
    let limits = Limits { bytes: 1 << 20, cells: 100 };
    assert_eq!(read(&one, &limits).unwrap().values, [7.0]);
    let mut tags = tags(60);
    tags.extend([longs(273, &[8; 60]), longs(279, &[blocks.len() as u32; 60])]);
    // The lists of the helper get tags that nothing reads.
    let file = tiff(&[(tags, vec![blocks])], [60_000, 60_001]);
    let expected = "expected a valid TIFF file, got one with a fault: strips or tiles share their bytes";
    assert_eq!(read(&file, &limits).unwrap_err().to_string(), expected);
}

/// Two pages of 2 × 2 cells whose first one has a description, and a resolution of 4 cells in a unit without a name.
fn described(description: &[u8], pages: usize) -> Vec<u8> {
    let page = |index: usize| {
        let mut tags = grey([2, 2], 8);
        tags.extend([fraction(282, [4, 1]), fraction(283, [2, 1]), shorts(296, &[1])]);
        if index == 0 {
            tags.push((270, 2, description.len() as u32, description.to_vec()));
        }
        (tags, vec![vec![1, 0, 0, 2]])
    };
    tiff(&(0..pages).map(page).collect::<Vec<_>>(), STRIPS)
}

/// Spacing in millimetres, the units of the file, and the unit of its shapes.
fn sizes(description: &[u8], pages: usize) -> ([f64; 3], [LengthUnit; 3], Option<Unit>) {
    let file = described(description, pages);
    let grid = read_labels(&file, &LIMITS).unwrap().grid;
    assert_eq!(describe(&file, &LIMITS).unwrap().grid, grid);
    (grid.spacing(), grid.units(), grid.unit_of_shapes())
}

#[test]
fn sizes_that_ome_describes_are_read() {
    use LengthUnit::{Cell, Micrometre, Millimetre, Nanometre, Unknown};
    let ome = |attributes: &str| {
        format!(
            "<?xml version=\"1.0\" encoding=\"UTF-8\"?><!-- OME -->\n<OME xmlns=\"x\"><Instrument ID=\"a\"/>\
             <Image><Pixels {attributes} SizeX=\"2\"><Channel/></Pixels><Pixels PhysicalSizeX=\"9\"/></Image></OME>\0"
        )
    };
    let plain = "PhysicalSizeX=\"0.5\" PhysicalSizeY=\"0.25\" PhysicalSizeZ=\"2\"";
    let micrometres = ([0.0005, 0.00025, 0.002], [Micrometre; 3], Some(Unit::Micrometre));
    assert_eq!(sizes(ome(plain).as_bytes(), 2), micrometres);
    let prefixed =
        ome(plain).replace("<", "<o:").replace("<o:/", "</o:").replace("<o:?", "<?").replace("<o:!", "<!");
    assert_eq!(sizes(prefixed.as_bytes(), 2), micrometres);
    let named =
        |unit: &str| ["X", "Y", "Z"].map(|axis| format!("PhysicalSize{axis}Unit=\"{unit}\"")).join(" ");
    assert_eq!(sizes(ome(&format!("{plain} {}", named("µm"))).as_bytes(), 2), micrometres);
    let nanometres = sizes(ome(&format!("{plain} {}", named("nm"))).as_bytes(), 2);
    assert_eq!((nanometres.1, nanometres.2), ([Nanometre; 3], Some(Unit::Nanometre)));
    let millimetres = sizes(ome(&format!("{plain} {}", named("mm"))).as_bytes(), 2);
    assert_eq!(millimetres, ([0.5, 0.25, 2.0], [Millimetre; 3], Some(Unit::Millimetre)));
    // Ångström, and units of no length that is known here.
    let tenths = sizes(ome(&format!("{plain} {}", named("Å"))).as_bytes(), 2);
    assert!((tenths.0[2] / 2e-7 - 1.0).abs() < 1e-15 && tenths.1 == [Nanometre; 3], "{tenths:?}");
    for unit in ["pixel", "reference frame", "parsec"] {
        let cells = sizes(ome(&format!("{plain} {}", named(unit))).as_bytes(), 2);
        assert_eq!(cells, ([1.0; 3], [Cell; 3], Some(Unit::Voxel)), "{unit}");
    }
    // Without a distance between pages the unit of a volume is not known, that of one page is.
    let flat = ome("PhysicalSizeX=\"0.5\" PhysicalSizeY=\"0.25\"");
    assert_eq!(sizes(flat.as_bytes(), 2), ([0.0005, 0.00025, 1.0], [Micrometre, Micrometre, Unknown], None));
    assert_eq!(sizes(flat.as_bytes(), 1).2, Some(Unit::Micrometre));
    for odd in ["0", "-1", "NaN", "inf", "1e-320", "x", ""] {
        let text = ome(&plain.replace("0.5", odd));
        assert_eq!(sizes(text.as_bytes(), 2), ([1.0; 3], [Cell; 3], Some(Unit::Voxel)), "{odd}");
    }
    // Texts that are cut off or of another kind say nothing.
    let whole = ome(plain);
    for end in 0..whole.len() {
        sizes(&whole.as_bytes()[..end], 2);
    }
    for other in [
        &b"<Other><Pixels PhysicalSizeX=\"1\" PhysicalSizeY=\"1\"/></Other>"[..],
        b"{\"shape\": [2]}",
        b"\xff\xfe",
    ] {
        assert_eq!(sizes(other, 2).1, [Cell; 3]);
    }
}

#[test]
fn sizes_that_imagej_describes_are_read() {
    use LengthUnit::{Cell, Centimetre, Micrometre, Unknown};
    let lines = |unit: &[u8], spacing: &str| {
        [b"ImageJ=1.54f\nimages=2\nslices=2\nunit=", unit, b"\n", spacing.as_bytes(), b"loop=false\n\0"]
            .concat()
    };
    for unit in [&b"micron"[..], b"um", "µm".as_bytes(), b"\\u00B5m", b"\xb5m"] {
        let found = sizes(&lines(unit, "spacing=2.0\n"), 2);
        assert_eq!(found, ([0.00025, 0.0005, 0.002], [Micrometre; 3], Some(Unit::Micrometre)), "{unit:?}");
    }
    let centimetres = sizes(&lines(b"cm", "spacing=-0.5\n"), 2);
    assert_eq!(centimetres, ([2.5, 5.0, 5.0], [Centimetre; 3], Some(Unit::Millimetre)));
    let flat = sizes(&lines(b"um", ""), 2);
    assert_eq!((flat.1, flat.2), ([Micrometre, Micrometre, Unknown], None));
    for unit in [&b"pixel"[..], b"", b"furlong"] {
        assert_eq!(sizes(&lines(unit, "spacing=2.0\n"), 2), ([1.0; 3], [Cell; 3], Some(Unit::Voxel)));
    }
}
