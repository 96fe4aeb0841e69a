//! Methods of minimisation against each other, on the same energies.

use std::f64::consts::TAU;

use shapelex_analysis::transformation::ClassName;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_numeric::bounded::never;
use shapelex_segmentation::SegmentationError;
use shapelex_segmentation::energy::Polarity;
use shapelex_segmentation::frame::Frame;
use shapelex_segmentation::run::scene::{EdgeScale, ImageTerm, Scene};
use shapelex_segmentation::run::{Method, Settings, Stage, segment};
use shapelex_segmentation::snake::curve::CurveSnake;
use shapelex_segmentation::snake::reparametrisation::Free;

use crate::phantoms::{image, nucleus, rod_image};
use crate::tasks::*;

/// Every image term, from an affine and from a free stage, in an anisotropic frame: the same energies to a thousandth.
#[test]
fn all_methods_find_the_same_minima() {
    let frame = Frame::new([[0.5, 0.0], [0.0, 0.6]], [3.0, -2.0]).unwrap();
    let picture = image([90, 70, 1], |[x, y, _]| {
        let r = ((x - 44.0) / 24.0).hypot((y - 36.0) / 15.0);
        20.0 + 200.0 * (0.5 + 15.0 * (1.0 - r)).clamp(0.0, 1.0)
    });
    let model = CurveSnake::new(&GeneratorKind::Trigonometric {}, 8).unwrap();
    let start: Vec<[f64; 2]> = (0..8)
        .map(|k| (TAU * f64::from(k) / 8.0).sin_cos())
        .map(|(sine, cosine)| [46.0 + 20.0 * cosine, 34.0 + 13.0 * sine])
        .collect();
    let polarity = Polarity::Bright;
    let terms = [
        ImageTerm::Contour { polarity, edges: EdgeScale::Percentile(99.0) },
        ImageTerm::Threshold { theta: 0.5, level: Some(200.0) },
        ImageTerm::LocalContrast { polarity },
        ImageTerm::TwoClass,
    ];
    for term in terms {
        let scene = Scene::new(&picture, frame, &[(term, 1.0)], &[1.5]);
        let stages =
            [Stage::new(Free::Affine, 1.5), Stage::new(Free::Radial, 1.5), Stage::new(Free::All, 1.5)];
        let run = |method: Method| {
            let mut settings = Settings::new(stages.to_vec());
            (settings.method, settings.boundary) = (method, 0.05);
            let found = segment(&scene, &model, &start, &settings, &never).unwrap();
            let energy: f64 = found.terms.iter().map(|term| term.weighted).sum();
            eprintln!("{term:?} {method:?}: {energy:.6} {:?} {}", found.outcome, count(&found));
            energy
        };
        let [lbfgs, newton, coordinates] = [Method::Lbfgs, Method::Newton, Method::Coordinates].map(run);
        for energy in [newton, coordinates] {
            assert!((energy - lbfgs).abs() < 1e-3 * lbfgs.abs(), "{energy} for {lbfgs}, {term:?}");
        }
    }
}

/// The table of the notes: Newton's method needs fewer evaluations than L-BFGS, one point after the other many times as many.
#[test]
fn methods_differ_in_evaluations() {
    let image = rod_image(25.0, 35);
    let contour = rod_contour(&image);
    let run = |method: Method| {
        let prior = Some((ClassName::Similarity, 30.0));
        let (overlaps, evaluations) = segment_rods(&image, &contour, 0.1, prior, method);
        let mean = overlaps.iter().sum::<f64>() / overlaps.len() as f64;
        eprintln!("{method:?}: {mean:.3}, {evaluations} evaluations");
        assert!(mean >= 0.92, "{mean} by {method:?}");
        evaluations
    };
    let [lbfgs, newton, coordinates] = [Method::Lbfgs, Method::Newton, Method::Coordinates].map(run);
    assert!(newton < lbfgs && coordinates > 10 * lbfgs, "{newton}, {lbfgs}, {coordinates}");
}

#[test]
fn surfaces_have_no_newton_steps() {
    let scene = nucleus_scene(&nucleus(false, 0.0));
    let model = blob(3);
    let start = blob_sphere(&model, 11.0, [32.5, 31.5, 31.0]);
    let mut settings = nucleus_settings(&[(Free::Affine, 4.0)]);
    settings.method = Method::Newton;
    let refused = segment(&scene, &model, &start, &settings, &never);
    assert_eq!(refused, Err(SegmentationError::Method));
}
