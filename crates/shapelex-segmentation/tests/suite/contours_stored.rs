//! Curves and surfaces of stored labels: nuclei of micrographs, hippocampi. Skipped where the data are absent.

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

use shapelex_numeric::bounded::never;
use shapelex_segmentation::contours::{Components, Labels, Selection};
use shapelex_segmentation::frame::Frame;

/// Vertices of any file.
const MANY: usize = 1 << 22;

/// The files of a folder of the shared data in the order of their names; none, with a message, where it is absent.
fn files(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(folder);
    let Ok(entries) = std::fs::read_dir(&folder) else {
        eprintln!("SKIPPED: {} is absent", folder.display());
        return Vec::new();
    };
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry").path()).collect();
    files.sort();
    files
}

/// Size and labels of a PNG with 16 bits of grey.
fn read_png(file: &Path) -> ([usize; 2], Vec<u32>) {
    let mut reader = png::Decoder::new(std::io::BufReader::new(File::open(file).expect("a file")))
        .read_info()
        .expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut bytes).expect("a picture");
    assert_eq!((info.bit_depth, info.color_type), (png::BitDepth::Sixteen, png::ColorType::Grayscale));
    let labels = bytes[..info.buffer_size()].chunks(2).map(|two| u32::from(two[0]) << 8 | u32::from(two[1]));
    ([info.width as usize, info.height as usize], labels.collect())
}

/// Size, spacing and labels of a compressed NIfTI-1 file with one byte per voxel.
fn read_nifti(file: &Path) -> ([usize; 3], [f64; 3], Vec<u32>) {
    let mut bytes = Vec::new();
    flate2::read::GzDecoder::new(File::open(file).expect("a file")).read_to_end(&mut bytes).expect("gzip");
    let short = |at: usize| i16::from_le_bytes(bytes[at..at + 2].try_into().expect("bytes of a number"));
    let float = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().expect("bytes of a number"));
    assert_eq!(short(70), 2, "one byte per voxel");
    let size = [42, 44, 46].map(|at| short(at) as usize);
    let first = float(108) as usize;
    let values = bytes[first..first + size.iter().product::<usize>()].iter().map(|byte| u32::from(*byte));
    (size, [80, 84, 88].map(|at| f64::from(float(at))), values.collect())
}

/// All nuclei of 25 pictures: the area of the rings is that of the cells, ½ less for the outer ring and ½ more for each hole.
#[test]
fn nuclei_have_the_area_of_their_cells() {
    let (mut nuclei, mut parts, mut holes, mut on_edge) = (0, 0, 0, 0);
    let files = files("images-nuclei/labels");
    for file in &files {
        let (size, values) = read_png(file);
        let labels = Labels::new(size, &values).unwrap();
        let found = Components::find(&labels, &Selection::default(), &never).unwrap().unwrap();
        let names: std::collections::BTreeSet<u32> = found.list().iter().map(|part| part.label).collect();
        nuclei += names.len();
        for region in found.regions(&Frame::identity(), 0.0, MANY, &never).unwrap().unwrap() {
            let area = |ring: &Vec<[f64; 2]>| -> f64 {
                let next = ring.iter().cycle().skip(1);
                ring.iter().zip(next).map(|(a, b)| 0.5 * (a[0] * b[1] - a[1] * b[0])).sum()
            };
            let sum = area(&region.outer) + region.holes.iter().map(area).sum::<f64>();
            let expected = region.component.cells as f64 - 0.5 + 0.5 * region.holes.len() as f64;
            // Products of half indices below 1024 are exact, and so are their sums.
            assert_eq!(sum, expected, "{}", file.display());
            parts += 1;
            holes += region.holes.len();
            on_edge += usize::from(region.component.border_faces > 0);
        }
    }
    if !files.is_empty() {
        // The numbers of nuclei, parts and parts on the edge are those of a flood fill by another program.
        assert_eq!((files.len(), nuclei, parts, on_edge, holes), (25, 618, 636, 173, 0));
    }
}

/// The hippocampi of 190 masks as one label: closed surfaces, and a volume within 2 % of the cells.
#[test]
fn hippocampi_have_the_volume_of_their_cells() {
    let (mut components, mut cavities, mut handles) = (0, 0, 0);
    let mut worst = 0.0_f64;
    let files = files("volumes-hippocampus-mri/masks");
    for file in &files {
        let (size, spacing, values) = read_nifti(file);
        let values: Vec<u32> = values.into_iter().map(|label| u32::from(label != 0)).collect();
        let labels = Labels::new(size, &values).unwrap();
        let found = Components::find(&labels, &Selection::default(), &never).unwrap().unwrap();
        let matrix =
            std::array::from_fn(|row| std::array::from_fn(|c| if row == c { spacing[c] } else { 0.0 }));
        let frame = Frame::new(matrix, [0.0; 3]).unwrap();
        for solid in found.solids(&frame, 0.0, MANY, &never).unwrap().unwrap() {
            let surfaces = || std::iter::once(&solid.outer).chain(&solid.cavities);
            for surface in surfaces() {
                let connectivity = surface.mesh.connectivity().unwrap();
                assert_eq!(connectivity.genus(), surface.genus(), "{}", file.display());
            }
            let volume: f64 = surfaces().map(|surface| surface.mesh.signed_volume()).sum();
            let cells = solid.component.cells as f64 * frame.determinant();
            if solid.component.cells > 100 {
                worst = worst.max((volume / cells - 1.0).abs());
            }
            components += 1;
            cavities += solid.cavities.len();
            handles += solid.outer.genus();
        }
    }
    if !files.is_empty() {
        // The numbers of components and cavities are those of a flood fill by another program.
        assert_eq!((files.len(), components, cavities, handles), (190, 198, 1, 13));
        // A ball of the same size, R = 9, loses 0.7 %, and a longer body more.
        assert!(worst < 0.02, "{worst}");
    }
}
