//! Whole segmentations with prepared images: a curve of 12 points in 512², a nucleus of 66 points in 64³, a cylinder in 100³.

use std::f64::consts::{PI, TAU};
use std::hint::black_box;
use std::sync::Arc;

use criterion::{Criterion, criterion_group, criterion_main};
use shapelex_geometry::generator::{Exact, GeneratorKind};
use shapelex_geometry::subdivision::control::ControlMesh;
use shapelex_geometry::subdivision::{Frequency, Scheme, Subdivision};
use shapelex_geometry::surface::Topology;
use shapelex_geometry::surface::basis::{Extent, SurfaceBasis};
use shapelex_geometry::surface::seam::Seam;
use shapelex_numeric::bounded::never;
use shapelex_segmentation::energy::Polarity;
use shapelex_segmentation::field::Image;
use shapelex_segmentation::frame::Frame;
use shapelex_segmentation::run::scene::{EdgeScale, ImageTerm, Scene};
use shapelex_segmentation::run::{Settings, Stage, segment};
use shapelex_segmentation::snake::curve::CurveSnake;
use shapelex_segmentation::snake::cylinder::CylinderSnake;
use shapelex_segmentation::snake::reparametrisation::Free;
use shapelex_segmentation::snake::subdivision::SubdivisionSnake;

fn image(size: [usize; 3], value: impl Fn([f64; 3]) -> f64) -> Image {
    let cell = |at: usize| [at % size[0], at / size[0] % size[1], at / size[0] / size[1]].map(|i| i as f64);
    Image::new(size, (0..size.iter().product()).map(|at| value(cell(at))).collect()).expect("an image")
}

fn contour(polarity: Polarity) -> [(ImageTerm, f64); 1] {
    [(ImageTerm::Contour { polarity, edges: EdgeScale::Percentile(99.5) }, 1.0)]
}

fn curve(criterion: &mut Criterion) {
    let picture = image([512, 512, 1], |[x, y, _]| {
        let r = ((x - 250.0) / 60.0).hypot((y - 260.0) / 40.0);
        20.0 + 200.0 * (0.5 + 50.0 * (1.0 - r)).clamp(0.0, 1.0)
    });
    let scene = Scene::new(&picture, Frame::identity(), &contour(Polarity::Bright), &[8.0, 2.0]);
    let model = CurveSnake::new(&GeneratorKind::Trigonometric {}, 12).expect("a model");
    let start: Vec<[f64; 2]> = (0..12)
        .map(|k| (TAU * f64::from(k) / 12.0).sin_cos())
        .map(|(sine, cosine)| [255.0 + 40.0 * cosine, 255.0 + 40.0 * sine])
        .collect();
    let settings = Settings::new(vec![Stage::new(Free::Affine, 8.0), Stage::new(Free::All, 2.0)]);
    criterion.bench_function("curve_12_points", |bencher| {
        bencher.iter(|| segment(&scene, &model, black_box(&start), &settings, &never));
    });
}

fn nucleus(criterion: &mut Criterion) {
    let volume = image([64; 3], |[x, y, z]| {
        let r = ((x - 31.3) / 1.1).hypot(y - 30.6).hypot((z - 32.2) * 1.1);
        40.0 + 140.0 * (18.5 - r).clamp(0.0, 1.0)
    });
    let scene = Scene::new(&volume, Frame::identity(), &contour(Polarity::Bright), &[4.0, 2.0, 1.0]);
    let connectivity = ControlMesh::Named("octahedron/2".parse().expect("a mesh"));
    let scheme = Scheme::Blob(Frequency::Real(Exact::new(PI / 8.0)));
    let sphere = connectivity.sphere().expect("a sphere").vertices;
    let model = SubdivisionSnake::new(Subdivision { scheme, level: 2, connectivity }).expect("a model");
    let centre = [32.5, 31.5, 31.0];
    let start: Vec<[f64; 3]> =
        sphere.iter().map(|v| std::array::from_fn(|c| centre[c] + 11.0 * v[c])).collect();
    let stages = [(Free::Affine, 4.0), (Free::All, 4.0), (Free::All, 2.0), (Free::All, 1.0)];
    let mut settings = Settings::new(stages.map(|(free, sigma)| Stage::new(free, sigma)).into());
    settings.tolerance = 0.02;
    criterion.bench_function("nucleus_66_points", |bencher| {
        bencher.iter(|| segment(&scene, &model, black_box(&start), &settings, &never));
    });
}

fn cylinder(criterion: &mut Criterion) {
    let volume = image([100; 3], |[x, y, z]| {
        let radius = (x - 49.5).hypot(y - 49.5);
        let wall = (0.5 + (radius - 14.0).min(16.0 - radius)).clamp(0.0, 1.0);
        if (10.0..=89.0).contains(&z) { 255.0 * wall } else { 0.0 }
    });
    let sigmas = [6.0, 3.0, 2.0, 1.5, 0.8];
    let edges = EdgeScale::Sheets(99.5);
    let terms = [(ImageTerm::Contour { polarity: Polarity::Dark, edges }, 1.0)];
    criterion.bench_function("cylinder_fields_100_cubed", |bencher| {
        bencher.iter(|| Scene::new(&volume, Frame::<3>::identity(), &terms, &sigmas));
    });
    let scene = Scene::new(&volume, Frame::identity(), &terms, &sigmas);
    let extent = Extent { topology: Topology::Cylinder, intervals: [6, 6] };
    let basis = SurfaceBasis::new(extent, Seam::Straight, &Topology::Cylinder.usual_generators());
    let model = CylinderSnake::new(Arc::new(basis.expect("a basis"))).expect("a model");
    let start: Vec<[f64; 3]> = (0..6)
        .flat_map(|k| (0..7).map(move |l| (TAU * f64::from(k) / 6.0, 24.0 + 52.0 * f64::from(l) / 6.0)))
        .map(|(angle, z)| [51.0 + 6.0 * angle.cos(), 48.5 + 6.0 * angle.sin(), z])
        .collect();
    let affine = sigmas[..4].iter().map(|sigma| Stage::new(Free::Affine, *sigma));
    let free = sigmas[3..].iter().map(|sigma| Stage::new(Free::All, *sigma));
    let mut settings = Settings::new(affine.chain(free).collect());
    (settings.boundary, settings.spacing, settings.tolerance) = (0.3, 100.0, 0.02);
    criterion.bench_function("cylinder_100_cubed", |bencher| {
        bencher.iter(|| segment(&scene, &model, black_box(&start), &settings, &never));
    });
}

criterion_group! {
    name = snakes;
    config = Criterion::default().sample_size(10);
    targets = curve, nucleus, cylinder
}
criterion_main!(snakes);
