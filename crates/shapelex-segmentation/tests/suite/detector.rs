//! The detector of sheets against the stored vectors, a closed form and its laws.

use shapelex_geometry::vector::{dot, norm};
use shapelex_numeric::bounded::never;
use shapelex_segmentation::SegmentationError;
use shapelex_segmentation::detector::{Innermost, Sheets, innermost, largest_component};
use shapelex_segmentation::energy::Polarity;
use shapelex_segmentation::field::{Image, Value};
use shapelex_segmentation::frame::Frame;

use crate::phantoms::image;
use crate::vectors::{assert_close, count, load, number, numbers};

/// Stored numbers have twelve digits, normals ten decimals.
const TOLERANCE: f64 = 1e-8;

fn stored() -> (Image, f64) {
    let document = load("detector");
    let size = [count(&document["size"]); 3];
    (Image::new(size, numbers(&document["volume"])).expect("a volume"), number(&document["sigma"]))
}

fn detect<T: Value>(image: &Image, frame: Frame<3>, sigma: f64, polarity: Polarity) -> Sheets<T> {
    Sheets::new(image, &frame, sigma, polarity, &never).expect("a valid case").expect("not stopped")
}

fn bright(image: &Image, sigma: f64) -> Sheets {
    detect(image, Frame::identity(), sigma, Polarity::Bright)
}

fn crests<T: Value>(sheets: &Sheets<T>, least: f64) -> Vec<usize> {
    sheets.crests(least, &never).expect("not stopped")
}

fn coordinates(cell: usize, size: [usize; 3]) -> [f64; 3] {
    [cell % size[0], cell / size[0] % size[1], cell / size[0] / size[1]].map(|i| i as f64)
}

#[test]
fn sheets_are_those_of_the_vectors() {
    let document = load("detector");
    let (volume, sigma) = stored();
    let (sheets, size) = (bright(&volume, sigma), volume.size());
    for sample in document["samples"].as_array().expect("a list") {
        let [k, j, i]: [usize; 3] = numbers(&sample["zyx"])
            .iter()
            .map(|x| *x as usize)
            .collect::<Vec<_>>()
            .try_into()
            .expect("a cell");
        let cell = (k * size[1] + j) * size[0] + i;
        let response = number(&sample["response"]);
        assert_close(&[sheets.response().at([i, j, k])], &[response], TOLERANCE, "response");
        let normal: [f64; 3] = numbers(&sample["normal"]).try_into().expect("a vector");
        let sign = dot(normal, sheets.normal(cell)).signum();
        assert_close(&sheets.normal(cell), &normal.map(|x| sign * x), TOLERANCE, "normal");
    }
    let cells = crests(&sheets, 0.0);
    assert_eq!(cells.len(), count(&document["nms_count"]));
    let sum: f64 = cells.iter().map(|cell| sheets.response().values()[*cell]).sum();
    assert_close(&[sum], &[number(&document["nms_sum"])], TOLERANCE, "sum over crests");
    // A least response keeps the crests above it.
    let least = sheets.threshold(0.3, 99.0);
    let above: Vec<usize> =
        cells.iter().copied().filter(|cell| sheets.response().values()[*cell] >= least).collect();
    assert_eq!(crests(&sheets, least), above);
    assert!(!above.is_empty() && above.len() < cells.len(), "{} of {}", above.len(), cells.len());
}

#[test]
fn thresholds_are_fractions_of_percentiles_of_positive_responses() {
    let (volume, sigma) = stored();
    let sheets = bright(&volume, sigma);
    let positive: Vec<f64> = sheets.response().values().iter().copied().filter(|r| *r > 0.0).collect();
    for percent in [0.0, 12.3, 50.0, 99.0, 100.0] {
        let expected = shapelex_segmentation::field::image::percentile(positive.clone(), percent).unwrap();
        assert_eq!(sheets.threshold(0.3, percent), 0.3 * expected, "{percent} %");
    }
    let nothing = bright(&image([5, 6, 7], |_| 0.0), 1.0);
    assert_eq!((nothing.threshold(0.3, 99.0), crests(&nothing, 0.0).len()), (0.0, 0));
}

/// A sheet with a Gaussian profile of width `s`: `r = 4 A/(s² + σ²)` on its crest, `A = s/√(s² + σ²)`, in a turned frame with
/// cells of 1 × 0.8 × 2 and in a mirrored one.
#[test]
fn normals_and_responses_are_those_of_the_world() {
    let turn = [[3.0, -6.0, 2.0], [2.0, 3.0, 6.0], [6.0, 2.0, -3.0]].map(|row| row.map(|x| x / 7.0));
    let (spacing, size, sigma, width) = ([1.0, 0.8, 2.0], [31, 36, 23], 3.0_f64, 1.5_f64);
    for mirror in [1.0, -1.0] {
        let matrix = turn
            .map(|row: [f64; 3]| [mirror * row[0] * spacing[0], row[1] * spacing[1], row[2] * spacing[2]]);
        let frame = Frame::new(matrix, [5.0, -3.0, 2.0]).unwrap();
        let normal = [0.48, 0.6, 0.64];
        assert!((norm(normal) - 1.0).abs() < 1e-12);
        let middle = frame.to_world([15.0, 17.0, 11.0]);
        let distance = |index: [f64; 3]| {
            let world = frame.to_world(index);
            dot(normal, [0, 1, 2].map(|c| world[c] - middle[c])) - 0.2
        };
        let volume = image(size, |index| (-0.5 * (distance(index) / width).powi(2)).exp());
        let sheets: Sheets = detect(&volume, frame, sigma, Polarity::Bright);
        let square = width * width + sigma * sigma;
        let on_crest = 4.0 * width / square.powf(1.5);
        let least = 0.5 * on_crest;
        let mut seen = 0;
        for cell in crests(&sheets, least) {
            let index = coordinates(cell, size);
            // Near the edges, the volume is continued by its outermost cells.
            if (0..3).any(|c| (index[c] - [15.0, 17.0, 11.0][c]).abs() > [5.0, 6.0, 5.0][c]) {
                continue;
            }
            seen += 1;
            let (away, found) = (distance(index), sheets.normal(cell));
            // Half of a step across, the longest of which has 2 units; the interpolation of a bent profile adds a little.
            assert!(away.abs() < 1.1, "{away} at {index:?}");
            // Kernels are cut at 4σ, and differences of sampled Gaussians with σ = 1.5 cells are no derivatives.
            assert!(dot(found, normal).abs() > 1.0 - 1e-4, "{found:?} for {normal:?} at {index:?}");
            let u = away * away / square;
            let expected = on_crest * (1.0 - u) * (-0.5 * u).exp();
            let response = sheets.response().values()[cell];
            assert!((response - expected).abs() < 0.01 * on_crest, "{response} for {expected} at {index:?}");
        }
        // The plane crosses the inner box of 11 × 13 × 11 cells.
        assert!(seen > 60, "{seen} crests");
    }
}

#[test]
fn permuted_axes_permute_the_sheets() {
    let (volume, sigma) = stored();
    let [nx, ny, nz] = [13, 15, 16];
    let part = image([nx, ny, nz], |[x, y, z]| volume.at([x as usize, y as usize, z as usize]));
    let turned = image([ny, nz, nx], |[x, y, z]| part.at([z as usize, x as usize, y as usize]));
    let spacing = [1.0, 1.3, 0.8];
    let frame = |spacing: [f64; 3]| {
        Frame::new([0, 1, 2].map(|r| [0, 1, 2].map(|c| if r == c { spacing[r] } else { 0.0 })), [0.0; 3])
            .unwrap()
    };
    let a: Sheets = detect(&part, frame(spacing), sigma, Polarity::Bright);
    let b: Sheets = detect(&turned, frame([1.3, 0.8, 1.0]), sigma, Polarity::Bright);
    let largest = a.response().values().iter().copied().fold(0.0, f64::max);
    for cell in 0..nx * ny * nz {
        let [x, y, z] = coordinates(cell, [nx, ny, nz]).map(|i| i as usize);
        let other = (x * nz + z) * ny + y;
        // The order of the passes changes the rounding.
        let [found, expected] = [a.response().values()[cell], b.response().values()[other]];
        assert!((found - expected).abs() < 1e-12 * largest, "{found} for {expected}");
        let (u, v) = (a.normal(cell), b.normal(other));
        // Where two eigenvalues are close, rounding turns the normal.
        assert!(dot(u, [v[2], v[0], v[1]]).abs() > 1.0 - 1e-9, "{u:?}, {v:?}");
    }
    let mut permuted: Vec<usize> = crests(&b, 0.0)
        .into_iter()
        .map(|cell| coordinates(cell, [ny, nz, nx]).map(|i| i as usize))
        .map(|[y, z, x]| (z * ny + y) * nx + x)
        .collect();
    permuted.sort_unstable();
    assert_eq!(crests(&a, 0.0), permuted);
}

#[test]
fn sheets_scale_with_the_image_and_change_sides_with_its_sign() {
    let (volume, sigma) = stored();
    let sheets = bright(&volume, sigma);
    // A power of two changes no digits.
    let four = bright(&volume.map(|value| 4.0 * value), sigma);
    assert_eq!(four.response(), &sheets.response().map(|r| 4.0 * r));
    assert_eq!(four.threshold(0.3, 99.0), 4.0 * sheets.threshold(0.3, 99.0));
    let cells = crests(&sheets, sheets.threshold(0.3, 99.0));
    assert_eq!(crests(&four, four.threshold(0.3, 99.0)), cells);
    assert!(cells.iter().all(|cell| four.normal(*cell) == sheets.normal(*cell)));
    let dark: Sheets = detect(&volume.map(|value| -value), Frame::identity(), sigma, Polarity::Dark);
    assert_eq!(dark, sheets);
    let other: Sheets = detect(&volume, Frame::identity(), sigma, Polarity::Dark);
    assert_ne!(other, sheets);
}

#[test]
fn single_precision_keeps_seven_digits() {
    let (volume, sigma) = stored();
    let (double, single) =
        (bright(&volume, sigma), detect::<f32>(&volume, Frame::identity(), sigma, Polarity::Bright));
    let widened: Vec<f64> = single.response().values().iter().map(|r| f64::from(*r)).collect();
    assert_close(&widened, double.response().values(), 6e-8, "response");
    let ratio = single.threshold(0.3, 99.0) / double.threshold(0.3, 99.0);
    assert!((ratio - 1.0).abs() < 6e-8, "{ratio}");
    let read: Sheets =
        Sheets::new(&volume.map::<f32>(|value| value), &Frame::identity(), sigma, Polarity::Bright, &never)
            .unwrap()
            .unwrap();
    // Values of the image are rounded once more.
    assert_close(read.response().values(), double.response().values(), 1e-6, "response of a rounded volume");
    let huge: Image = volume.map(|value| 1e38 * value);
    let found = Sheets::<f32>::new(&huge, &Frame::identity(), 1.0, Polarity::Bright, &never);
    assert!(matches!(found, Err(SegmentationError::NotFinite { .. })), "{:?}", found.map(|_| ()));
}

#[test]
fn the_bits_of_sheets_do_not_depend_on_the_number_of_threads() {
    let (volume, sigma) = stored();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let sheets = bright(&volume, sigma);
            let cells = crests(&sheets, 1.0);
            (sheets, cells)
        })
    };
    assert!(on(1) == on(3));
}

#[test]
fn detection_stops_and_refuses_small_blurs() {
    let (volume, sigma) = stored();
    let stopped = Sheets::<f32>::new(&volume, &Frame::identity(), sigma, Polarity::Bright, &|| true);
    assert_eq!(stopped, Ok(None));
    assert_eq!(bright(&volume, sigma).crests(0.0, &|| true), None);
    let frame = Frame::new([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 4.0]], [0.0; 3]).unwrap();
    for (sigma, smallest) in [(1.5, 0.375), (-1.0, -1.0), (0.0, 0.0)] {
        let found = Sheets::<f64>::new(&volume, &frame, sigma, Polarity::Bright, &never);
        assert_eq!(found, Err(SegmentationError::Blur { least: 0.5, sigma: smallest }));
    }
    assert!(Sheets::<f64>::new(&volume, &frame, f64::NAN, Polarity::Bright, &never).is_err());
    // Flat volumes have no inner cells.
    for size in [[9, 9, 1], [9, 9, 2], [1, 1, 1]] {
        assert!(crests(&bright(&image(size, |[x, y, _]| (x + 2.0 * y).sin()), 1.0), 0.0).is_empty());
    }
}

/// Two dark shells about a centre in cells of 1 × 1 × 1.25; the inner one has a hole through which the outer one is seen. A disc
/// through the centre has normals across the rays.
#[test]
fn innermost_surfaces_are_the_first_ones_from_the_centre() {
    let frame =
        Frame::new([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.25]], [-20.0, -19.0, -18.0]).unwrap();
    let size = [42, 40, 32];
    let position = |cell: usize| frame.to_world(coordinates(cell, size));
    let (inner, outer) = (8.0, 15.0);
    let volume = image(size, |index| {
        let at = frame.to_world(index);
        let sheet = |radius: f64| (-0.5 * (norm(at) - radius).powi(2)).exp();
        let hole = if at[0] > 6.5 { 0.0 } else { 1.0 };
        let disc = (-0.5 * at[2].powi(2) - (norm(at) / 4.5).powi(4)).exp();
        100.0 - 50.0 * (hole * sheet(inner) + sheet(outer) + disc)
    });
    let sheets: Sheets = detect(&volume, frame, 1.0, Polarity::Dark);
    let cells = crests(&sheets, sheets.threshold(0.3, 99.0));
    let centre = frame.to_index([0.5, -0.4, 0.3]);
    let mut rules = Innermost::around(centre, 3.0, &frame);
    // A ring of the inner shell is 2 units wide: every direction has a cell of it.
    rules.rings = 12;
    let near = |cells: &[usize], radius: f64| {
        cells.iter().filter(|cell| (norm(position(**cell)) - radius).abs() < 1.0).count()
    };
    let all = [inner, outer].map(|radius| near(&cells, radius));
    let found = innermost(&sheets, &cells, &rules);
    let seen = [inner, outer].map(|radius| near(&found, radius));
    // All of the inner shell, and a lid of the outer one: the hole is a tenth of a sphere, and directions of its rim see the
    // inner shell.
    assert!(seen[0] > all[0] * 95 / 100, "{seen:?} of {all:?}");
    assert!(seen[1] > 20 && seen[1] < all[1] / 10, "{seen:?} of {all:?}");
    let piece = largest_component(&found, size);
    let kept = [inner, outer].map(|radius| near(&piece, radius));
    assert!(kept[0] > all[0] * 95 / 100 && kept[1] == 0, "{kept:?} of {all:?}");
    let on_disc = |cells: &[usize]| cells.iter().filter(|cell| norm(position(**cell)) < 5.5).count();
    assert_eq!(on_disc(&found), 0);
    rules.along = 0.0;
    assert!(on_disc(&innermost(&sheets, &cells, &rules)) > 20);
    rules.along = 0.6;
    rules.beyond = 11.0;
    let found = innermost(&sheets, &cells, &rules);
    let seen = [inner, outer].map(|radius| near(&found, radius));
    assert!(seen[0] == 0 && seen[1] > all[1] * 95 / 100, "{seen:?} of {all:?}");
    rules.beyond = 40.0;
    assert!(innermost(&sheets, &cells, &rules).is_empty());
}
