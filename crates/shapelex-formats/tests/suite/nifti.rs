//! NIfTI-1: types, byte orders, affine maps, units, and headers that are wrong.

use shapelex_formats::image::{ImageError, LengthUnit, Limits, ValueType, describe, read, read_labels};

use crate::files::{LIMITS, Nifti, gzip, header_refusal, is_refused_when_cut_off, refusal};

const SFORM: usize = 254;
const QFORM: usize = 252;

/// A 2 × 1 × 1 file of bytes.
fn bytes() -> Nifti {
    Nifti::new([2, 1, 1], 2, 8, false)
}

fn voxels(file: &Nifti) -> Vec<u8> {
    file.with(&[[3_u8], [7]])
}

#[test]
fn every_type_is_read_in_both_byte_orders() {
    for big_endian in [false, true] {
        macro_rules! check {
            ($datatype:literal, $type:ident, $stored:ident) => {
                let values: [$type; 6] =
                    [0 as $type, 1 as $type, 2 as $type, 100 as $type, 101 as $type, 127 as $type];
                let file = Nifti::new([3, 2, 1], $datatype, 8 * size_of::<$type>() as i16, big_endian);
                let file = file.with(&values.map(|value| value.to_be_bytes()));
                let image = read(&file, &LIMITS).unwrap();
                assert_eq!(image.values, values.map(|value| value as f32), "{} {big_endian}", $datatype);
                assert_eq!(image.grid.size(), [3, 2, 1]);
                assert_eq!(read_labels(&file, &LIMITS).unwrap().values, [0, 1, 2, 100, 101, 127]);
                assert_eq!(read(&gzip(&file), &LIMITS), Ok(image));
                assert_eq!(describe(&file, &LIMITS).unwrap().stored, ValueType::$stored);
                is_refused_when_cut_off(&file);
            };
        }
        check!(2, u8, U8);
        check!(4, i16, I16);
        check!(8, i32, I32);
        check!(16, f32, F32);
        check!(64, f64, F64);
        check!(256, i8, I8);
        check!(512, u16, U16);
        check!(768, u32, U32);
        check!(1024, i64, I64);
        check!(1280, u64, U64);
    }
}

#[test]
fn labels_of_32_bits_are_exact() {
    let labels = [16_777_217_u32, u32::MAX];
    let file = Nifti::new([2, 1, 1], 768, 32, false).with(&labels.map(u32::to_be_bytes));
    assert_eq!(read_labels(&file, &LIMITS).unwrap().values, labels);
    let file = Nifti::new([2, 1, 1], 4, 16, false).with(&[1_i16, -1].map(i16::to_be_bytes));
    let error = read_labels(&file, &LIMITS).unwrap_err().to_string();
    assert_eq!(error, "expected a label, a whole number from 0 to 4294967295, got -1 at cell 1");
    let file = Nifti::new([2, 1, 1], 64, 64, false).with(&[1.0_f64, 0.5].map(f64::to_be_bytes));
    assert_eq!(read_labels(&file, &LIMITS), Err(ImageError::Label { index: 1, value: 0.5 }));
}

#[test]
fn slope_and_intercept_are_applied_in_double_precision() {
    let scaled = |slope: f32, intercept: f32| voxels(bytes().float(112, slope).float(116, intercept));
    assert_eq!(read(&scaled(0.1, 1e6), &LIMITS).unwrap().values, [1_000_000.3, 1_000_000.7]);
    assert_eq!(read_labels(&scaled(2.0, 1.0), &LIMITS).unwrap().values, [7, 15]);
    for (slope, intercept) in [(0.0, 5.0), (f32::NAN, f32::NAN), (1.0, 0.0)] {
        assert_eq!(
            read(&scaled(slope, intercept), &LIMITS).unwrap().values,
            [3.0, 7.0],
            "{slope} {intercept}"
        );
    }
    let expected = "expected a valid NIfTI-1 file, got one with a fault: expected a finite slope and intercept \
                    (scl_slope, scl_inter), got inf and 0";
    assert_eq!(header_refusal(&scaled(f32::INFINITY, 0.0)), expected);
    assert_eq!(
        refusal(&scaled(f32::MAX, f32::MAX)),
        format!("expected a finite value in single precision, got {} at cell 0", 4.0 * f64::from(f32::MAX))
    );
}

#[test]
fn sform_comes_before_qform_and_qform_before_the_spacing() {
    let mut file = bytes();
    for (axis, spacing) in [2.0, 3.0, 4.0].into_iter().enumerate() {
        file.float(80 + 4 * axis, spacing);
    }
    let affine = |file: &Nifti| read(&voxels(file), &LIMITS).unwrap().grid.affine();
    assert_eq!(affine(&file), [[2.0, 0.0, 0.0, 0.0], [0.0, 3.0, 0.0, 0.0], [0.0, 0.0, 4.0, 0.0]]);
    // The quaternion (0, 0, 0, 1) turns by 180° about z; qfac −1 reverses z.
    file.short(QFORM, 1).float(264, 1.0).float(268, 7.0).float(272, 8.0).float(276, 9.0).float(76, -1.0);
    assert_eq!(affine(&file), [[-2.0, 0.0, 0.0, 7.0], [0.0, -3.0, 0.0, 8.0], [0.0, 0.0, -4.0, 9.0]]);
    let rows = [[0.0, 5.0, 0.0, 1.0], [-6.0, 0.0, 0.5, 2.0], [0.0, 0.0, 7.0, 3.0]];
    for (place, entry) in rows.as_flattened().iter().enumerate() {
        file.float(280 + 4 * place, *entry);
    }
    assert_eq!(affine(&file)[0][0], -2.0, "no sform without its code");
    file.short(SFORM, 4);
    assert_eq!(affine(&file), rows.map(|row| row.map(f64::from)));
    assert_eq!(read(&voxels(&file), &LIMITS).unwrap().grid.determinant(), 210.0);
}

#[test]
fn a_quaternion_is_a_rotation() {
    // A turn by 120° about (1, 1, 1)/√3: quaternion ½ (1, 1, 1, 1), x → y → z → x.
    let mut file = bytes();
    file.short(QFORM, 1).float(256, 0.5).float(260, 0.5).float(264, 0.5);
    let affine = read(&voxels(&file), &LIMITS).unwrap().grid.affine();
    assert_eq!(
        affine.map(|row| [row[0], row[1], row[2]]),
        [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    );
    file.float(256, 1.5);
    assert!(
        header_refusal(&voxels(&file))
            .ends_with("expected a quaternion with b² + c² + d² of at most 1, got 2.75")
    );
    file.float(256, f32::NAN);
    assert!(header_refusal(&voxels(&file)).ends_with("got NaN"));
}

#[test]
fn units_become_millimetres() {
    for (code, unit, spacing) in [
        (0, LengthUnit::Unknown, 1.0),
        (1, LengthUnit::Metre, 1000.0),
        (2 | 8, LengthUnit::Millimetre, 1.0),
        (3, LengthUnit::Micrometre, 0.001),
    ] {
        let grid = read(&voxels(bytes().raw(123, &[code])), &LIMITS).unwrap().grid;
        assert_eq!((grid.units(), grid.spacing()), ([unit; 3], [spacing; 3]));
    }
    let expected = "expected lengths in metres, millimetres, micrometres or no unit (xyzt_units 0 to 3) in a NIfTI-1 file, got 5";
    assert_eq!(header_refusal(&voxels(bytes().raw(123, &[5]))), expected);
}

#[test]
fn planes_and_further_axes_of_one_value_are_read() {
    let mut file = bytes();
    file.short(40, 2).float(88, 0.0).float(80, 2.0);
    let grid = read(&voxels(&file), &LIMITS).unwrap().grid;
    assert_eq!((grid.is_planar(), grid.spacing()), (true, [2.0, 1.0, 1.0]));
    // A plane whose sform has no third column.
    file.short(SFORM, 1).float(280, 0.0).float(284, -3.0).float(296, 2.0);
    let grid = read(&voxels(&file), &LIMITS).unwrap().grid;
    assert_eq!(grid.affine(), [[0.0, -3.0, 0.0, 0.0], [2.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);
    let file = voxels(bytes().short(40, 5).short(48, 1).short(50, 1));
    assert_eq!(read(&file, &LIMITS).unwrap().values, [3.0, 7.0]);
    let found = header_refusal(&voxels(bytes().short(40, 4).short(48, 2)));
    assert_eq!(
        found,
        "expected one value along each axis after the third in a NIfTI-1 file, got 2 along axis 4"
    );
}

#[test]
fn wrong_headers_are_refused() {
    let refused = |change: &dyn Fn(&mut Nifti) -> &mut Nifti| {
        let mut file = bytes();
        change(&mut file);
        header_refusal(&voxels(&file))
    };
    let whole =
        "expected a NIfTI-1 header with its voxels in the same file (magic n+1) in a NIfTI-1 file, got";
    assert_eq!(refused(&|file| file.raw(344, b"ni1\0")), format!("{whole} a header alone (magic ni1)"));
    assert_eq!(refused(&|file| file.raw(4, b"n+2\0")), format!("{whole} a NIfTI-2 header"));
    assert_eq!(
        refused(&|file| file.put(0, 349_i32.to_be_bytes())),
        "expected a header of 348 bytes (sizeof_hdr) in a NIfTI-1 file, got 349"
    );
    assert_eq!(
        refused(&|file| file.short(42, 0)),
        "expected at least one cell along every axis, got 0 × 1 × 1"
    );
    let fault = "expected a valid NIfTI-1 file, got one with a fault: expected";
    assert_eq!(refused(&|file| file.short(42, -5)), format!("{fault} 1 to 32767 cells (dim[1]), got -5"));
    assert_eq!(refused(&|file| file.short(40, 1)), "expected 2 or 3 axes (dim[0]) in a NIfTI-1 file, got 1");
    let types =
        "expected integers or floating-point numbers of 8 to 64 bits (datatype) in a NIfTI-1 file, got";
    assert_eq!(refused(&|file| file.short(70, 32)), format!("{types} 32 (Complex64)"));
    assert_eq!(refused(&|file| file.short(70, 128)), format!("{types} 128 (Rgb24)"));
    assert_eq!(refused(&|file| file.short(70, 3)), format!("{types} 3"));
    assert_eq!(refused(&|file| file.short(72, 16)), format!("{fault} bitpix 8 for datatype 2, got 16"));
    for offset in [351.0, 352.5, -352.0, f32::NAN, f32::INFINITY] {
        let found = refused(&|file| file.float(108, offset));
        assert_eq!(
            found,
            format!("{fault} voxels from a whole position of at least 352 on (vox_offset), got {offset}")
        );
    }
    assert!(
        refused(&|file| file.float(108, 1e30))
            .starts_with("expected at most 65536 bytes of NIfTI-1 header and voxels")
    );
    for spacing in [0.0, -1.0, f32::NAN] {
        assert_eq!(
            refused(&|file| file.float(84, spacing)),
            format!("expected a positive, finite spacing along y, got {spacing}")
        );
    }
    let singular = refused(&|file| {
        file.short(SFORM, 1).float(280, 1.0).float(296, 2.0).float(284, 1.0).float(300, 2.0).float(320, 1.0)
    });
    assert_eq!(singular, "expected an invertible affine map, got one with determinant 0.0e0");
    assert_eq!(refused(&|file| file.short(SFORM, 1)), "expected a positive, finite spacing along x, got 0");
}

#[test]
fn a_header_that_lies_about_its_voxels_is_refused() {
    let file = voxels(bytes().short(42, 3));
    assert_eq!(refusal(&file), "expected 3 bytes of NIfTI-1 voxels, got 2");
    assert_eq!(refusal(&gzip(&file)), "expected 3 bytes of NIfTI-1 voxels, got 2");
    let file = voxels(bytes().short(42, 1));
    assert_eq!(refusal(&file), "expected the file to end after 1 bytes of NIfTI-1 voxels, got more");
    assert_eq!(refusal(&gzip(&file)), "expected the file to end after 1 bytes of NIfTI-1 voxels, got more");
    // 16 000³ voxels in a small file: refused by the limits, and without limits by what gzip can hold.
    let file = gzip(&Nifti::new([16_000; 3], 2, 8, false).with(&[[1_u8]]));
    assert_eq!(header_refusal(&file), "expected at most 4096 cells, got 16000 × 16000 × 16000");
    let all = Limits { bytes: u64::MAX, cells: u64::MAX };
    let most = file.len() as u64 * 1032 - 352;
    let expected =
        ImageError::Truncated { place: "NIfTI-1 voxels", expected: 16_000_u64.pow(3), found: most };
    assert_eq!(read(&file, &all), Err(expected));
    let small = Limits { bytes: 353, cells: 2 };
    assert_eq!(
        read(&voxels(&bytes()), &small).unwrap_err().to_string(),
        "expected at most 353 bytes of NIfTI-1 header and voxels, got 354"
    );
}

#[test]
fn voxels_that_are_no_numbers_are_refused_by_their_position() {
    for bad in [f32::NAN, f32::INFINITY] {
        let file = Nifti::new([3, 1, 1], 16, 32, true).with(&[1.0, bad, bad].map(f32::to_be_bytes));
        assert_eq!(
            refusal(&file),
            format!("expected a finite value in single precision, got {bad} at cell 1")
        );
    }
}

#[test]
fn gzip_is_read_with_its_checksum() {
    let file = voxels(&bytes());
    let compressed = gzip(&file);
    is_refused_when_cut_off(&compressed);
    let mut wrong = compressed.clone();
    let checksum = wrong.len() - 8;
    wrong[checksum] ^= 1;
    assert!(refusal(&wrong).starts_with("expected a valid NIfTI-1 (gzip) file, got one with a fault:"));
    // A gzip file of several members is one stream.
    assert_eq!(read(&[gzip(&file[..100]), gzip(&file[100..])].concat(), &LIMITS).unwrap().values, [3.0, 7.0]);
    for inner in [gzip(&file), [gzip(&file), vec![0; 400]].concat()] {
        assert_eq!(
            header_refusal(&gzip(&inner)),
            "expected a NIfTI-1 file inside of the gzip file, got another gzip file"
        );
    }
    assert_eq!(header_refusal(&gzip(&file[..300])), "expected 348 bytes of NIfTI-1 header, got 300");
    let other = gzip(&[1; 400]);
    assert!(header_refusal(&other).ends_with("got a file without its magic bytes"));
    assert!(read(b"\x1f\x8b\x08\0garbage", &LIMITS).is_err());
}

#[test]
fn the_start_of_a_file_is_enough_to_describe_it() {
    let file = Nifti::new([9, 8, 7], 4, 16, false).with(&vec![[0, 1]; 504]);
    let described = describe(&file[..352], &LIMITS).unwrap();
    assert_eq!((described.grid.size(), described.stored, described.channels), ([9, 8, 7], ValueType::I16, 1));
    // Four bytes for each voxel, and 256 KiB of buffers.
    assert_eq!(described.memory_bytes, 4 * 504 + (1 << 18));
    let compressed = gzip(&file);
    assert_eq!(describe(&compressed[..compressed.len() - 8], &LIMITS), Ok(described));
}
