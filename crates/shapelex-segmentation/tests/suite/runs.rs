//! Laws of whole segmentations.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use shapelex_geometry::generator::{Exact, GeneratorKind, PoleList};
use shapelex_geometry::subdivision::{Frequency, Scheme, Subdivision};
use shapelex_geometry::surface::Topology;
use shapelex_geometry::surface::basis::{Extent, SurfaceBasis};
use shapelex_geometry::surface::seam::Seam;
use shapelex_numeric::bounded::never;
use shapelex_segmentation::SegmentationError;
use shapelex_segmentation::energy::Polarity;
use shapelex_segmentation::field::Image;
use shapelex_segmentation::frame::Frame;
use shapelex_segmentation::run::check::{Fault, check};
use shapelex_segmentation::run::scene::{EdgeScale, ImageTerm, Scene};
use shapelex_segmentation::run::{Outcome, Segmentation, Settings, Stage, segment};
use shapelex_segmentation::snake::Model;
use shapelex_segmentation::snake::curve::CurveSnake;
use shapelex_segmentation::snake::reparametrisation::Free;
use shapelex_segmentation::snake::subdivision::SubdivisionSnake;
use shapelex_segmentation::snake::surface::SurfaceSnake;

use crate::phantoms::{image, nucleus};

const CONTOUR: ImageTerm =
    ImageTerm::Contour { polarity: Polarity::Bright, edges: EdgeScale::Percentile(99.5) };

/// An ellipse with half axes 14 and 9, centre (31.2, 26.7), intensity 30 on 5.
fn ellipse() -> Image {
    image([64, 52, 1], |[x, y, _]| {
        let r = ((x - 31.2) / 14.0).hypot((y - 26.7) / 9.0);
        5.0 + 25.0 * (0.5 + (1.0 - r) * 11.0).clamp(0.0, 1.0)
    })
}

fn circle(count: usize, radius: f64, [x, y]: [f64; 2]) -> Vec<[f64; 2]> {
    let at = |k: usize| (TAU * k as f64 / count as f64).sin_cos();
    (0..count).map(at).map(|(sine, cosine)| [x + radius * cosine, y + radius * sine]).collect()
}

fn area(model: &CurveSnake, rows: &[[f64; 2]]) -> f64 {
    let boundary = model.boundary(rows, 1.0, Frame::identity());
    boundary.volume(&boundary.sample(rows)).value
}

fn run(term: ImageTerm, image: &Image, model: &CurveSnake, start: &[[f64; 2]]) -> Segmentation<2> {
    let stages = vec![Stage::new(Free::Affine, 3.0), Stage::new(Free::All, 1.0)];
    let scene = Scene::new(image, Frame::identity(), &[(term, 1.0)], &[3.0, 1.0]);
    segment(&scene, model, start, &Settings::new(stages), &never).expect("a valid case")
}

#[test]
fn every_image_term_finds_an_ellipse_with_any_generator() {
    let poles = PoleList::from_domain(&[[0.0, 0.0], [0.0, TAU], [0.0, -TAU]]);
    let generators = [
        GeneratorKind::Trigonometric {},
        GeneratorKind::Bspline { degree: 3 },
        GeneratorKind::Exponential { poles },
    ];
    let (bright, dark) = (ellipse(), ellipse().map::<f64>(|value| 100.0 - value));
    let threshold = ImageTerm::Threshold { theta: 17.5 / 30.0, level: Some(30.0) };
    let cases = [
        (CONTOUR, &bright),
        (ImageTerm::Contour { polarity: Polarity::Dark, edges: EdgeScale::Percentile(99.5) }, &dark),
        (ImageTerm::LocalContrast { polarity: Polarity::Bright }, &bright),
        (ImageTerm::LocalContrast { polarity: Polarity::Dark }, &dark),
        (ImageTerm::TwoClass, &bright),
        (ImageTerm::TwoClass, &dark),
        (threshold, &bright),
    ];
    for generator in generators {
        let model = CurveSnake::new(&generator, 8).unwrap();
        for (term, image) in &cases {
            let found = run(*term, image, &model, &circle(8, 6.0, [33.0, 25.0]));
            let (area, exact) = (area(&model, &found.rows), PI * 14.0 * 9.0);
            let name = generator.name();
            assert!((area - exact).abs() < 0.05 * exact, "{term:?}, {name}: area {area} for {exact}");
            assert_eq!(found.stages.iter().filter_map(|stage| stage.fault).count(), 0, "{term:?}, {name}");
        }
    }
}

#[test]
fn reversed_curves_give_the_same_and_optima_stay() {
    let model = CurveSnake::new(&GeneratorKind::Trigonometric {}, 8).unwrap();
    let (image, start) = (ellipse(), circle(8, 6.0, [33.0, 25.0]));
    let mut reversed = start.clone();
    reversed[1..].reverse();
    let [a, mut b] = [&start, &reversed].map(|start| run(CONTOUR, &image, &model, start));
    b.rows[1..].reverse();
    for (a, b) in a.rows.concat().iter().zip(b.rows.concat()) {
        assert!((a - b).abs() < 1e-6, "{a} for {b}");
    }
    assert_eq!(a.outcome, Outcome::Converged);
    // The local contrast has no scale of the first shape: its optimum is one for a run that starts there.
    let term = ImageTerm::LocalContrast { polarity: Polarity::Bright };
    let optimum = run(term, &image, &model, &start);
    let scene = Scene::new(&image, Frame::identity(), &[(term, 1.0)], &[1.0]);
    let settings = Settings::new(vec![Stage::new(Free::All, 1.0)]);
    let again = segment(&scene, &model, &optimum.rows, &settings, &never).unwrap();
    let moved = optimum.rows.iter().zip(&again.rows).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
    let moved = moved.fold(0.0, f64::max);
    assert!(moved < 0.05 && again.iterations() <= 10, "{moved} in {} iterations", again.iterations());
}

fn tied(intervals: [usize; 2]) -> SurfaceSnake {
    let extent = Extent { topology: Topology::Sphere, intervals };
    let basis = SurfaceBasis::new(extent, Seam::Straight, &Topology::Sphere.usual_generators())
        .expect("a valid case");
    SurfaceSnake::tied_sphere(Arc::new(basis)).expect("a valid case")
}

fn ball_points([around, along]: [usize; 2], radius: f64, centre: [f64; 3]) -> Vec<[f64; 3]> {
    let at = |[x, y, z]: [f64; 3]| [centre[0] + radius * x, centre[1] + radius * y, centre[2] + radius * z];
    let point = |k: usize, l: usize| {
        let (u, v) = (TAU * k as f64 / around as f64, PI * l as f64 / along as f64);
        [v.sin() * u.cos(), v.sin() * u.sin(), v.cos()]
    };
    let rings = (0..around).flat_map(|k| (1..along).map(move |l| point(k, l)));
    rings.chain([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]).map(at).collect()
}

/// A volume and the same with the x axis reversed, whose frame has a negative determinant: equal energies of every term.
#[test]
fn mirrored_volumes_give_the_same_energies() {
    let size = [26, 24, 22];
    let value = |[x, y, z]: [f64; 3]| {
        let r = ((x - 12.3) / 1.2).hypot(y - 11.4).hypot((z - 10.6) * 1.5);
        10.0 + 50.0 * (0.5 + 7.0 - r).clamp(0.0, 1.0)
    };
    let volumes = [image(size, value), image(size, |[x, y, z]| value([25.0 - x, y, z]))];
    let frames = [(0.8, [0.0; 3]), (-0.8, [20.0, 0.0, 0.0])]
        .map(|(x, offset)| Frame::new([[x, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.5]], offset).unwrap());
    let model = tied([5, 4]);
    let world = ball_points([5, 4], 5.0, [10.5, 12.0, 15.0]);
    let terms = [
        CONTOUR,
        ImageTerm::Threshold { theta: 0.6, level: None },
        ImageTerm::LocalContrast { polarity: Polarity::Bright },
        ImageTerm::TwoClass,
    ];
    let found = [0, 1].map(|i| {
        let start: Vec<[f64; 3]> = world.iter().map(|point| frames[i].to_index(*point)).collect();
        let scene = Scene::new(&volumes[i], frames[i], &terms.map(|term| (term, 1.0)), &[1.5]);
        let mut settings = Settings::new(vec![Stage { iterations: 0, ..Stage::new(Free::All, 1.5) }]);
        settings.boundary = 0.3;
        segment(&scene, &model, &start, &settings, &never).unwrap().terms
    });
    assert_eq!(found[0].len(), 6);
    for (a, b) in found[0].iter().zip(&found[1]) {
        let error = (a.value - b.value).abs() / a.value.abs().max(1e-3);
        assert!(error < 2e-3, "{}: {} for {}", a.name, b.value, a.value);
    }
}

fn blob(text: &str, lambda: f64, level: usize) -> SubdivisionSnake {
    let scheme = Scheme::Blob(Frequency::Real(Exact::new(lambda)));
    let connectivity =
        text.parse().map(shapelex_geometry::subdivision::control::ControlMesh::Named).expect("a valid case");
    SubdivisionSnake::new(Subdivision { scheme, level, connectivity }).expect("a valid case")
}

/// One split halves `λ`; the vertices of the refined model are those of the coarse one.
#[test]
fn refined_models_contain_the_coarse_ones() {
    let coarse = blob("octahedron", PI / 2.0, 4);
    let rows: Vec<[f64; 3]> = (0..6)
        .map(|i| [(f64::from(i) * 1.3).sin(), (f64::from(i) * 2.1).cos(), f64::from(i % 3) - 1.0])
        .collect();
    let (fine, step) = coarse.refined().unwrap().unwrap();
    let named = blob("octahedron/1", PI / 4.0, 3);
    assert_eq!(fine.subdivision(), named.subdivision());
    let points = |model: &SubdivisionSnake, rows: &[[f64; 3]]| {
        let boundary = model.boundary(rows, 1.0, Frame::identity());
        boundary.sample(rows).vertices
    };
    let fine_rows = step.apply(&rows);
    assert_eq!((fine.rows(), fine_rows.len()), (18, 18));
    let (a, b) = (points(&coarse, &rows), points(&fine, &fine_rows));
    for (a, b) in a.concat().iter().zip(b.concat()) {
        assert!((a - b).abs() < 1e-14, "{a} for {b}");
    }
    assert!(blob("octahedron", 1.0, 0).refined().unwrap().is_none());
}

/// 66 points without the spacing energy fold; the check sees it, and the repetition with spacing succeeds.
#[test]
fn folds_are_found_and_repaired() {
    let scene = Scene::new(&nucleus(true, 0.0), Frame::identity(), &[(CONTOUR, 1.0)], &[4.0, 2.0, 1.0]);
    let model = blob("octahedron/2", PI / 8.0, 2);
    let start: Vec<[f64; 3]> = model
        .subdivision()
        .connectivity
        .sphere()
        .unwrap()
        .vertices
        .iter()
        .map(|v| [32.5 + 11.0 * v[0], 31.5 + 11.0 * v[1], 31.0 + 11.0 * v[2]])
        .collect();
    let stages = [4.0, 2.0, 1.0].map(|sigma| Stage { iterations: 100, ..Stage::new(Free::All, sigma) });
    let mut settings = Settings::new(stages.into());
    settings.spacing = 0.0;
    settings.tolerance = 0.02;
    settings.repairs = 0;
    let folded = segment(&scene, &model, &start, &settings, &never).unwrap();
    assert_eq!(folded.outcome, Outcome::Folded, "{:?}", folded.stages);
    assert_eq!(folded.stages.last().and_then(|stage| stage.fault), Some(Fault::Folded));
    settings.repairs = 2;
    let repaired = segment(&scene, &model, &start, &settings, &never).unwrap();
    assert!(repaired.outcome != Outcome::Folded, "{:?}", repaired.stages);
    assert!(repaired.stages.iter().any(|stage| stage.fault == Some(Fault::Folded)));
    let volume = |rows: &[[f64; 3]]| {
        let boundary = model.boundary(rows, 1.0, Frame::identity());
        boundary.volume(&boundary.sample(rows)).value
    };
    let exact = (0..64 * 64 * 64_usize)
        .filter(|at| {
            let cell = [at % 64, at / 64 % 64, at / 4096].map(|i| i as f64);
            crate::phantoms::nucleus_distance(cell, true) <= 0.0
        })
        .count() as f64;
    let found = volume(&repaired.rows);
    assert!((found - exact).abs() < 0.05 * exact, "{found} for {exact}");
}

#[test]
fn tori_have_the_volume_of_pappus() {
    let extent = Extent { topology: Topology::Torus, intervals: [7, 6] };
    let basis = SurfaceBasis::new(extent, Seam::Straight, &Topology::Torus.usual_generators()).unwrap();
    let model = SurfaceSnake::new(Arc::new(basis)).unwrap();
    let (large, small) = (12.0, 5.0);
    let rows: Vec<[f64; 3]> = (0..7)
        .flat_map(|k| (0..6).map(move |l| (TAU * f64::from(k) / 7.0, TAU * f64::from(l) / 6.0)))
        .map(|(u, v)| {
            let radius = large + small * v.cos();
            [20.0 + radius * u.cos(), 21.0 + radius * u.sin(), 15.0 + small * v.sin()]
        })
        .collect();
    let boundary = model.boundary(&rows, 1.0, Frame::identity());
    let samples = boundary.sample(&rows);
    let exact = 2.0 * PI * PI * large * small * small;
    let volume = boundary.volume(&samples).value;
    assert!((volume - exact).abs() < 1e-6 * exact, "{volume} for {exact}");
    let area = boundary.measure(&samples).value;
    assert!((area - 4.0 * PI * PI * large * small).abs() < 1e-4 * area, "{area}");
}

#[test]
fn the_bits_of_a_run_do_not_depend_on_the_number_of_threads() {
    let volume = image([24, 23, 22], |[x, y, z]| {
        10.0 + 50.0 * (7.5 - (x - 11.3).hypot(y - 11.0).hypot(z - 10.6)).clamp(0.0, 1.0)
    });
    let bits = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let scene = Scene::new(&volume, Frame::identity(), &[(CONTOUR, 1.0)], &[1.5]);
            let stage = Stage { iterations: 20, ..Stage::new(Free::All, 1.5) };
            let start = ball_points([5, 4], 4.0, [11.0, 11.5, 10.0]);
            let found = segment(&scene, &tied([5, 4]), &start, &Settings::new(vec![stage]), &never).unwrap();
            found.rows.concat().into_iter().map(f64::to_bits).collect::<Vec<_>>()
        })
    };
    assert_eq!(bits(1), bits(3));
}

#[test]
fn faulty_requests_are_refused() {
    let model = CurveSnake::new(&GeneratorKind::Trigonometric {}, 8).unwrap();
    let scene = Scene::new(&ellipse(), Frame::identity(), &[(CONTOUR, 1.0)], &[1.0]);
    let start = circle(8, 6.0, [33.0, 25.0]);
    let refused = |start: &[[f64; 2]], stages: Vec<Stage>| {
        segment(&scene, &model, start, &Settings::new(stages), &never).unwrap_err()
    };
    let stage = |sigma| vec![Stage::new(Free::All, sigma)];
    assert_eq!(refused(&start[1..], stage(1.0)), SegmentationError::Rows { expected: 8, found: 7 });
    assert_eq!(refused(&start, stage(2.0)), SegmentationError::Stages { sigma: Some(2.0.into()) });
    assert_eq!(refused(&start, vec![]), SegmentationError::Stages { sigma: None });
    assert!(matches!(refused(&[[3.0, 4.0]; 8], stage(1.0)), SegmentationError::NoVolume { .. }));
    let stopped = segment(&scene, &model, &start, &Settings::new(stage(1.0)), &|| true).unwrap();
    assert_eq!((stopped.outcome, stopped.rows == start), (Outcome::Stopped, true));
    let flat =
        Scene::new(&ellipse().map::<f64>(|_| 3.0), Frame::identity(), &[(ImageTerm::TwoClass, 1.0)], &[1.0]);
    let error = segment(&flat, &model, &start, &Settings::new(stage(1.0)), &never).unwrap_err();
    assert!(matches!(error, SegmentationError::Scale { .. }), "{error}");
}

/// The two sides of a waist pass each other by a tenth of a cell: no cell is enclosed twice, and the area is that of the cells.
#[test]
fn narrow_crossings_of_a_contour_are_folds() {
    let model = CurveSnake::new(&GeneratorKind::Bspline { degree: 1 }, 6).unwrap();
    let waist = |half: f64| {
        [[10.0, 16.0], [25.0, 20.0 - half], [40.0, 16.0], [40.0, 24.0], [25.0, 20.0 + half], [10.0, 24.0]]
    };
    let image = ellipse();
    let scene = Scene::new(&image, Frame::identity(), &[(CONTOUR, 1.0)], &[2.0]);
    let stages = vec![Stage { iterations: 0, ..Stage::new(Free::All, 2.0) }];
    for (half, expected) in [(0.05, Outcome::Limit), (-0.05, Outcome::Folded)] {
        let rows = waist(half);
        assert_eq!(check(&model.outline(&rows), area(&model, &rows), image.size()), None, "{half}");
        let found = segment(&scene, &model, &rows, &Settings::new(stages.clone()), &never).unwrap();
        assert_eq!(found.outcome, expected, "{half}");
    }
}
