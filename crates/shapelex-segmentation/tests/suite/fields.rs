//! Fields against the stored vectors and by their laws.

use shapelex_segmentation::field::{Image, Integrated};

use crate::vectors::{assert_close, image, load, numbers, points};

const TOLERANCE: f64 = 1e-8;

#[test]
fn integrated_images_are_those_of_the_vectors() {
    let document = load("curve2d");
    let field = Integrated::<2>::new(&image(&document));
    let expected = &document["preintegrated_quadratic"];
    let found = points(&expected["points"]).into_iter().map(|point| field.at(point));
    let found: Vec<[f64; 3]> = found.map(|(value, [x, y])| [value, x, y]).collect();
    for (part, name) in ["G", "Gx", "Gy"].into_iter().enumerate() {
        let column: Vec<f64> = found.iter().map(|found| found[part]).collect();
        assert_close(&column, &numbers(&expected[name]), TOLERANCE, name);
    }
}

#[test]
fn integrated_volumes_are_those_of_the_vectors() {
    let document = load("sphere3d");
    let field = Integrated::<3>::new(&image(&document));
    let expected = &document["preintegrated_quadratic"];
    let found: Vec<(f64, [f64; 3])> =
        points(&expected["points"]).into_iter().map(|point| field.at(point)).collect();
    let values: Vec<f64> = found.iter().map(|f| f.0).collect();
    let gradients: Vec<f64> = found.iter().flat_map(|f| f.1).collect();
    assert_close(&values, &numbers(&expected["G"]), TOLERANCE, "G");
    assert_close(&gradients, &numbers(&expected["grad"]), TOLERANCE, "grad");
}

/// The clamps, the padding and the switch between cells leave no kinks in the first derivative.
#[test]
fn gradients_are_those_of_differences_everywhere() {
    let document = load("sphere3d");
    let volume = image(&document);
    let field = Integrated::<3>::new(&volume);
    let h = 1e-5;
    for at in 0..4000_u32 {
        let size = volume.size();
        let part =
            |axis: usize| f64::from(at.wrapping_mul([747_796_405, 277_803_737, 2_891_336_453][axis]) >> 8);
        let point: [f64; 3] =
            std::array::from_fn(|axis| part(axis) / f64::from(1 << 24) * (size[axis] as f64 + 7.0) - 4.0);
        let (_, gradient) = field.at(point);
        for axis in 0..3 {
            let moved = |by: f64| {
                let mut moved = point;
                moved[axis] += by;
                field.at(moved).0
            };
            let slope = (moved(h) - moved(-h)) / (2.0 * h);
            assert!((slope - gradient[axis]).abs() < 1e-3, "{slope} for {} at {point:?}", gradient[axis]);
        }
    }
    for beyond in [f64::INFINITY, f64::NEG_INFINITY, 1e300, f64::NAN] {
        let _ = field.at([beyond, 1.0, 2.0]);
        let _ = field.at([1.0, beyond, 2.0]);
        assert!(!(field.at([3.0, 2.0, beyond]).0 != 0.0) || beyond.is_nan());
    }
}

#[test]
fn the_bits_do_not_depend_on_the_number_of_threads() {
    let volume: Image = image(&load("sphere3d"));
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let blurred = shapelex_segmentation::field::filter::blur(&volume, [1.5, 1.0, 0.7]);
            let field = Integrated::<3>::new(&blurred);
            (0..200).map(|at| field.at([f64::from(at) * 0.07, 5.1, 6.3]).0.to_bits()).collect::<Vec<_>>()
        })
    };
    assert_eq!(on(1), on(3));
}
