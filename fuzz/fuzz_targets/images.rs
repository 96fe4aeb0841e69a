//! Files of images: described, read as values and as labels, and written again.

#![no_main]

use libfuzzer_sys::fuzz_target;
use shapelex_formats::image::mask::MaskRuns;
use shapelex_formats::image::{ImageError, Limits, describe, read, read_labels, write};

/// Limits under which no input keeps the target busy for long.
const LIMITS: Limits = Limits { bytes: 1 << 18, cells: 1 << 14 };

fuzz_target!(|data: &[u8]| {
    let described = describe(data, &LIMITS);
    match read(data, &LIMITS) {
        Ok(image) => {
            let described = described.expect("what is read can be described");
            assert_eq!(described.grid, image.grid);
            assert_eq!(image.values.len(), image.grid.cells());
            assert!(described.memory_bytes >= 4 * image.values.len() as u64);
            // Sizes or positions may be beyond what the format holds.
            if let Ok(file) = write::nifti_f32(&image.grid, &image.values) {
                let limits = Limits { bytes: u64::MAX, cells: u64::MAX };
                assert_eq!(read(&file, &limits).expect("what is written is read").values, image.values);
            }
        }
        Err(error) => {
            assert!(error.to_string().starts_with("expected "), "{error}");
            assert!(!matches!(error, ImageError::Memory { .. }), "{error}");
        }
    }
    if let Ok(labels) = read_labels(data, &LIMITS) {
        let mask = MaskRuns::from_labels(&labels, None);
        let back = mask.to_image(&LIMITS).expect("a mask of an image is valid");
        assert!(back.values.iter().zip(&labels.values).all(|(cell, label)| (*cell == 1) == (*label != 0)));
    }
});
