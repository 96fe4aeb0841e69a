//! Images of scanners and microscopes beside the checkout, compared with numpy, nibabel and Pillow.
//!
//! The figures: `a = numpy.asarray(nibabel.load(f).dataobj, float).ravel(order="F")` (`PIL.Image.open` for PNG), its sum, the sum
//! of `a * (numpy.arange(a.size) % 97)`, which a wrong order of axes changes, and the value at a third of the size along each axis.
//! All are sums of whole numbers below 2⁵³, so they agree exactly.

use std::path::{Path, PathBuf};

use shapelex_formats::image::{Grid, LengthUnit, Limits, describe, read, read_labels};

const LIMITS: Limits = Limits { bytes: 1 << 28, cells: 1 << 26 };

/// A file of the data, or a line that says that it is not there.
pub(crate) fn load(name: &str) -> Option<Vec<u8>> {
    let folder: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let bytes = std::fs::read(folder.join(name)).ok();
    if bytes.is_none() {
        eprintln!("SKIPPED: {name} is not here");
    }
    bytes
}

/// Reads a file and compares sum, weighted sum and the value at a third; the grid, unless the file is not there.
fn compare(name: &str, size: [usize; 3], figures: [f64; 3]) -> Option<Grid> {
    let bytes = load(name)?;
    let image = read(&bytes, &LIMITS).unwrap();
    let values: Vec<f64> = image.values.iter().map(|value| f64::from(*value)).collect();
    let weighted: f64 = values.iter().enumerate().map(|(cell, value)| value * (cell % 97) as f64).sum();
    let [i, j, k] = size.map(|size| size / 3);
    assert_eq!(image.grid.size(), size, "{name}");
    let third = values[(k * size[1] + j) * size[0] + i];
    assert_eq!([values.iter().sum(), weighted, third], figures, "{name}");
    assert_eq!(describe(&bytes[..bytes.len().min(4096)], &LIMITS).unwrap().grid, image.grid, "{name}");
    Some(image.grid)
}

/// Compares values and positions; the determinant is that of nibabel's affine map.
fn compare_volumes(
    rows: &[(&str, [f64; 3])],
    size: [usize; 3],
    affine: [[f64; 4]; 3],
    determinant: f64,
    unit: LengthUnit,
) {
    for (name, figures) in rows {
        let Some(grid) = compare(name, size, *figures) else { continue };
        assert_eq!((grid.affine(), grid.units()), (affine, [unit; 3]), "{name}");
        assert_eq!(grid.determinant(), determinant, "{name}");
    }
}

#[test]
fn a_ct_volume_and_its_mask_are_those_of_nibabel() {
    let rows = [
        ("volumes-ct-aorta/ct.nii.gz", [-497705824.0, -23870880386.0, 825.0]),
        ("volumes-ct-aorta/aorta.nii.gz", [72810.0, 3497676.0, 0.0]),
        ("volumes-ct-aorta/vertebrae_T12.nii.gz", [9617.0, 461103.0, 0.0]),
    ];
    let first = [71.658203125, 255.658203125, 540.2000122070312];
    let affine = [[-1.5, 0.0, 0.0, first[0]], [0.0, -1.5, 0.0, first[1]], [0.0, 0.0, 1.5, first[2]]];
    compare_volumes(&rows, [120, 126, 164], affine, 3.375, LengthUnit::Millimetre);
}

#[test]
fn volumes_of_the_brain_are_those_of_nibabel() {
    let rows = [
        ("volumes-hippocampus-mri/images/hippocampus_001.nii.gz", [3968524.0, 190292550.0, 39.0]),
        ("volumes-hippocampus-mri/masks/hippocampus_001.nii.gz", [4572.0, 217812.0, 0.0]),
    ];
    let affine = [[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 1.0, 1.0]];
    compare_volumes(&rows, [35, 51, 35], affine, 1.0, LengthUnit::Millimetre);
    let rows = [
        ("volumes-mni152/mni_icbm152_t1_tal_nlin_sym_09a.nii.gz", [333468829.0, 16004150231.0, 202.0]),
        ("volumes-mni152/mni_icbm152_gm_tal_nlin_sym_09a.nii.gz", [257090788.0, 12340070846.0, 87.0]),
    ];
    let affine = [[1.0, 0.0, 0.0, -98.0], [0.0, 1.0, 0.0, -134.0], [0.0, 0.0, 1.0, -72.0]];
    compare_volumes(&rows, [197, 233, 189], affine, 1.0, LengthUnit::Unknown);
}

#[test]
fn radiological_storage_reverses_the_orientation() {
    let rows = [
        ("volumes-mr-lesions/brain1_image.nii.gz", [631859459.0, 30332293381.0, 456.0]),
        ("volumes-mr-lesions/brain1_label.nii.gz", [4137.0, 197058.0, 0.0]),
    ];
    let affine = [[-0.78125, 0.0, 0.0, 99.609375], [0.0, 0.78125, 0.0, -99.609375], [0.0, 0.0, 6.5, -78.0]];
    compare_volumes(&rows, [256, 256, 25], affine, -3.96728515625, LengthUnit::Millimetre);
}

#[test]
fn the_pictures_are_those_of_pillow() {
    let rows = [
        ("images-nuclei/images/11a0170f44e3.png", [256, 256, 1], [288862.0, 13877940.0, 6.0]),
        ("images-nuclei/labels/2dd9d8c797fc.png", [256, 256, 1], [12965.0, 610693.0, 0.0]),
        ("images-objects/cell.png", [550, 660, 1], [24669746.0, 1184318387.0, 63.0]),
        ("images-objects/coins.png", [384, 303, 1], [11269333.0, 543473503.0, 73.0]),
    ];
    for (name, size, figures) in rows {
        compare(name, size, figures);
    }
}

#[test]
fn labels_of_16_bits_are_exact() {
    let Some(bytes) = load("images-nuclei/labels/11a0170f44e3.png") else { return };
    let labels = read_labels(&bytes, &LIMITS).unwrap().values;
    assert_eq!(
        (labels.iter().max(), labels.iter().map(|label| u64::from(*label)).sum()),
        (Some(&12), 11404_u64)
    );
}

#[test]
fn grey_pixels_with_alpha_keep_their_value() {
    let Some(bytes) = load("images-objects/horse.png") else { return };
    let image = read(&bytes, &LIMITS).unwrap();
    // Red, green and blue are equal: the sum is that of one channel.
    assert_eq!(image.values.iter().map(|value| f64::from(*value)).sum::<f64>(), 22391924.0);
    assert_eq!(image.grid.size(), [400, 328, 1]);
}
