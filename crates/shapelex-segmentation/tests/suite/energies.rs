//! Terms of the energy against the stored vectors, differences and their laws.

use std::sync::Arc;

use serde_json::Value;
use shapelex_analysis::alignment::{Alignment, Method};
use shapelex_analysis::metric::Metric;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::knot_line::Line;
use shapelex_geometry::raster::Grid;
use shapelex_geometry::surface::Topology;
use shapelex_geometry::surface::basis::{Extent, SurfaceBasis};
use shapelex_geometry::surface::seam::Seam;
use shapelex_segmentation::boundary::curve::CurveBoundary;
use shapelex_segmentation::boundary::tensor::TensorBoundary;
use shapelex_segmentation::boundary::{Boundary, Differential};
use shapelex_segmentation::energy::{
    BoundaryCost, Contour, Energy, Hold, LocalContrast, Polarity, Prior, Shape, Spacing, Term, Threshold,
    TwoClass, Wall,
};
use shapelex_segmentation::field::{Image, Integrated};
use shapelex_segmentation::frame::Frame;
use shapelex_segmentation::run::scene::{EdgeScale, FieldTerm, ImageTerm, Scene};
use shapelex_segmentation::run::{Settings, Stage, segment};
use shapelex_segmentation::snake::Model;
use shapelex_segmentation::snake::curve::CurveSnake;
use shapelex_segmentation::snake::cylinder::CylinderSnake;
use shapelex_segmentation::snake::reparametrisation::Free;
use shapelex_segmentation::snake::surface::SurfaceSnake;

use crate::vectors::{assert_close, count, image, load, number, numbers, points};

const TOLERANCE: f64 = 1e-8;

/// The curve of `curve2d.json` with its image.
struct Planar {
    document: Value,
    image: Image,
    rows: Vec<[f64; 2]>,
    line: Line,
    boundary: CurveBoundary,
}

impl Planar {
    fn load() -> Self {
        let document = load("curve2d");
        let rows = points::<2>(&document["control"]);
        let line = Line::new(&GeneratorKind::Trigonometric {}, rows.len(), true).expect("a line");
        let per_span = count(&document["samples_per_span"]);
        let boundary = CurveBoundary::new(&line, per_span, &rows, Frame::identity());
        Self { image: image(&document), document, rows, line, boundary }
    }

    fn evaluate(&self, term: &Term<2>) -> Differential<2> {
        term.evaluate(&Shape::new(&self.boundary, &self.rows))
    }

    fn local_contrast(&self, image: &Image, polarity: Polarity, contrast: f64) -> Term<2> {
        let image = Arc::new(Integrated::new(image));
        let centre = vec![1.0 / self.rows.len() as f64; self.rows.len()].into();
        Term::LocalContrast(LocalContrast { image, polarity, contrast, centre })
    }

    fn two_class(&self, image: &Image) -> Term<2> {
        let (mean, total) = (image.mean(), image.values().len() as f64);
        let centred = Arc::new(Integrated::new(&image.map::<f64>(|value| value - mean)));
        Term::TwoClass(TwoClass { centred, total, variance: image.variance() })
    }

    fn prior(&self, class: ClassName) -> Prior<2> {
        let metric = Metric::new(self.line.gram().clone(), 2);
        let method = Method::new(&Transformation::Named(class), Alignment::Projection, 2).expect("a class");
        let reference = points(&load("prior")["reference"]);
        Prior::new(metric, method, &reference, None, Frame::identity()).expect("a reference")
    }
}

fn assert_differential<const D: usize>(found: &Differential<D>, value: &Value, gradient: &Value, what: &str) {
    assert_close(&[found.value], &[number(value)], TOLERANCE, what);
    assert_close(&found.gradient.concat(), &numbers(gradient), TOLERANCE, &format!("gradient of {what}"));
}

#[test]
fn contrast_and_two_classes_are_those_of_the_vectors() {
    let planar = Planar::load();
    let contrast = planar.evaluate(&planar.local_contrast(&planar.image, Polarity::Bright, 1.0));
    let expected = &planar.document["local_contrast"];
    assert_differential(&contrast, &expected["value"], &expected["grad"], "local contrast");
    let expected = &planar.document["two_class"];
    let two = planar.evaluate(&planar.two_class(&planar.image));
    assert_differential(&two, &expected["value"], &expected["grad"], "two classes");
}

#[test]
fn priors_are_those_of_the_vectors() {
    let (planar, document) = (Planar::load(), load("prior"));
    assert_eq!(points::<2>(&document["control"]), planar.rows);
    for (name, class) in [("similarity", ClassName::Similarity), ("affine", ClassName::Affine)] {
        let (prior, expected) = (planar.prior(class), &document[name]);
        let distance = prior.squared_distance(&planar.rows).expect("a shape with extent");
        assert_differential(&distance, &expected["squared_distance"], &expected["grad"], name);
        let normalised = planar.evaluate(&Term::Prior(prior));
        let what = format!("normalised {name}");
        assert_differential(
            &normalised,
            &expected["area_normalised"],
            &expected["area_normalised_grad"],
            &what,
        );
    }
}

/// Zero on the class; the same for a shape and its similarity images.
#[test]
fn priors_do_not_see_their_class() {
    let planar = Planar::load();
    let prior = planar.prior(ClassName::Similarity);
    let posed = |rows: &[[f64; 2]]| -> Vec<[f64; 2]> {
        rows.iter().map(|[x, y]| [3.0 + 0.6 * x - 0.4 * y, -2.0 + 0.4 * x + 0.6 * y]).collect()
    };
    let reference = posed(&points(&load("prior")["reference"]));
    assert!(prior.squared_distance(&reference).expect("a shape").value < 1e-12);
    let at = |rows: &[[f64; 2]]| {
        let boundary = CurveBoundary::new(&planar.line, 16, rows, Frame::identity());
        prior.evaluate(&Shape::new(&boundary, rows)).value
    };
    assert_close(&[at(&posed(&planar.rows))], &[at(&planar.rows)], 1e-11, "posed");
}

/// Along a fixed direction.
fn assert_differences<const D: usize>(boundary: &dyn Boundary<D>, rows: &[[f64; D]], terms: &[Term<D>]) {
    let direction = |i: usize, c: usize| (1.7 * i as f64 + 2.3 * c as f64 + 0.4).sin();
    let moved = |h: f64| -> Vec<[f64; D]> {
        let one = |(i, p): (usize, &[f64; D])| std::array::from_fn(|c| p[c] + h * direction(i, c));
        rows.iter().enumerate().map(one).collect()
    };
    let h = 1e-5;
    let (above, below) = (moved(h), moved(-h));
    for term in terms {
        let at = |rows: &[[f64; D]]| term.evaluate(&Shape::new(boundary, rows));
        let gradient = at(rows).gradient;
        let slope: f64 =
            (0..rows.len()).map(|i| (0..D).map(|c| gradient[i][c] * direction(i, c)).sum::<f64>()).sum();
        let difference = (at(&above).value - at(&below).value) / (2.0 * h);
        let error = (slope - difference).abs() / slope.abs();
        assert!(error < 1e-6, "{}: {slope} for {difference}, error {error:.1e}", term.name());
    }
}

#[test]
fn gradients_of_planar_terms_are_those_of_differences() {
    let planar = Planar::load();
    let field = Arc::new(Integrated::new(&planar.image));
    let terms = [
        Term::Contour(Contour { laplacian: field.clone(), polarity: Polarity::Dark, scale: 31.0 }),
        Term::Threshold(Threshold { saturated: field, theta: 0.7, scale: 90.0 }),
        planar.local_contrast(&planar.image, Polarity::Dark, 40.0),
        planar.two_class(&planar.image),
        Term::BoundaryCost(BoundaryCost { scale: 30.0 }),
        Term::Spacing(Spacing {}),
        Term::Prior(planar.prior(ClassName::Similarity)),
        Term::Prior(planar.prior(ClassName::Affine)),
    ];
    assert_differences(&planar.boundary, &planar.rows, &terms);
    // Anisotropic pixels with shear, mirrored.
    let frame = Frame::new([[-0.5, 0.1], [0.2, 1.5]], [3.0, 4.0]).expect("a frame");
    let boundary = CurveBoundary::new(&planar.line, 16, &planar.rows, frame);
    assert_differences(&boundary, &planar.rows, &terms);
    let energy = Energy { terms: terms.map(|term| (term, 0.5)).into() };
    let shape = Shape::new(&boundary, &planar.rows);
    let (total, values) = (energy.evaluate(&shape).value, energy.values(&shape));
    assert_close(&[values.iter().map(|term| term.weighted).sum()], &[total], 1e-12, "sum of terms");
    assert!(values.iter().all(|term| term.weighted == 0.5 * term.value));
}

/// A box around a shape that its boundary crosses, and a first shape beside it.
fn walls<const D: usize>(rows: &[[f64; D]], frame: Frame<D>) -> [Term<D>; 2] {
    let wall = Wall::around(rows.iter().map(|point| frame.to_world(*point)), 0.6, frame).expect("a box");
    let moved =
        |(i, p): (usize, &[f64; D])| std::array::from_fn(|c| p[c] + (0.9 * i as f64 + c as f64).cos());
    let start = rows.iter().enumerate().map(moved).collect();
    [Term::Wall(wall), Term::Hold(Hold { start, wall })]
}

/// Of every kind of boundary: curves, spheres, and cylinders, whose walls are those of their closed meshes.
#[test]
fn gradients_of_walls_are_those_of_differences() {
    let planar = Planar::load();
    let sheared = Frame::new([[-0.5, 0.1], [0.2, 1.5]], [3.0, 4.0]).expect("a frame");
    for frame in [Frame::identity(), sheared] {
        let boundary = CurveBoundary::new(&planar.line, 16, &planar.rows, frame);
        assert_differences(&boundary, &planar.rows, &walls(&planar.rows, frame));
    }
    let frame =
        Frame::new([[0.0, -2.0, 0.1], [1.5, 0.2, 0.0], [0.0, 0.3, 4.0]], [7.0, -3.0, 1.0]).expect("a frame");
    let document = load("sphere3d");
    let rows = points::<3>(&document["tied"]["free_points"]);
    assert_differences(&tied_boundary(&document, &rows, frame), &rows, &walls(&rows, frame));
    let extent = Extent { topology: Topology::Cylinder, intervals: [6, 4] };
    let basis = SurfaceBasis::new(extent, Seam::Straight, &Topology::Cylinder.usual_generators())
        .expect("a cylinder");
    let model = CylinderSnake::new(Arc::new(basis)).expect("a model");
    let around = |k: usize| std::f64::consts::TAU * k as f64 / 6.0;
    let point = |(k, l): (usize, usize)| {
        [5.0 * around(k).cos() + 9.0, 4.0 * around(k).sin() + 8.0, 3.0 * l as f64 + 2.0]
    };
    let rows: Vec<[f64; 3]> = (0..6).flat_map(|k| (0..5).map(move |l| (k, l))).map(point).collect();
    assert_differences(&*model.boundary(&rows, 1.0, frame), &rows, &walls(&rows, frame));
}

/// Nothing within the box, the square of the part beyond it outside; nothing at the first shape.
#[test]
fn walls_are_felt_beyond_the_box_only() {
    let planar = Planar::load();
    let around = |factor: f64| {
        Wall::around(planar.boundary.sample(&planar.rows).points.into_iter(), factor, Frame::identity())
    };
    let at = |wall: Wall<2>, rows: &[[f64; 2]]| wall.evaluate(&Shape::new(&planar.boundary, rows));
    let (tight, wide) = (around(1.0).expect("a box"), around(3.0).expect("a box"));
    let inside = at(tight, &planar.rows);
    assert!(
        inside.value == 0.0 && inside.gradient.iter().flatten().all(|slope| *slope == 0.0),
        "{}",
        inside.value
    );
    // Far to the right the whole boundary is d beyond: the mean of (d + x)², x the positions in half sides, is that of one point on.
    let far: Vec<[f64; 2]> = planar.rows.iter().map(|[x, y]| [x + 100.0 * tight.half[0], *y]).collect();
    let expected = |factor: f64| {
        let points = planar.boundary.sample(&planar.rows).points;
        let square = |[x, _]: &[f64; 2]| ((x - tight.middle[0]) / tight.half[0] + 100.0 - factor).powi(2);
        points.iter().map(square).sum::<f64>() / points.len() as f64
    };
    assert_close(
        &[at(tight, &far).value, at(wide, &far).value],
        &[expected(1.0), expected(3.0)],
        1e-12,
        "walls",
    );
    let hold = Hold { start: planar.rows.clone(), wall: tight };
    let value = |rows: &[[f64; 2]]| hold.evaluate(&Shape::new(&planar.boundary, rows)).value;
    assert_close(&[value(&planar.rows), value(&far)], &[0.0, 10_000.0], 1e-12, "holds");
}

/// The polarity that a term has by contrast is that of the image.
#[test]
fn polarities_follow_the_contrast() {
    let size = [40, 36, 1];
    let inside = |cell: usize| ((cell % 40) as f64 - 19.0).hypot((cell / 40) as f64 - 17.0) < 8.0;
    let model = CurveSnake::new(&GeneratorKind::Trigonometric {}, 8).expect("a model");
    let turn = |k: usize| std::f64::consts::TAU * k as f64 / 8.0;
    let start: Vec<[f64; 2]> =
        (0..8).map(|k| [18.5 + 6.0 * turn(k).cos(), 17.5 + 7.0 * turn(k).sin()]).collect();
    let found = |sign: f64, term: ImageTerm, by_contrast: bool| {
        let values = (0..40 * 36).map(|cell| sign * if inside(cell) { 9.0 } else { 2.0 }).collect();
        let field = Arc::new(Image::new(size, values).expect("an image"));
        let terms = [FieldTerm { field, term, weight: 1.0, by_contrast }];
        let scene =
            Scene::of_fields(size, Frame::identity(), &terms, &[1.0.into()], &|| false).expect("a scene");
        let settings = Settings::new(vec![Stage::new(Free::All, 1.0)]);
        segment(&scene, &model, &start, &settings, &|| false).expect("a shape").rows
    };
    for (sign, polarity) in [(1.0, Polarity::Bright), (-1.0, Polarity::Dark)] {
        let terms = |polarity| {
            let edges = EdgeScale::Percentile(99.0);
            [ImageTerm::Contour { polarity, edges }, ImageTerm::LocalContrast { polarity }]
        };
        for (given, usual) in terms(polarity).into_iter().zip(terms(Polarity::Bright)) {
            assert_eq!(found(sign, usual, true), found(sign, given, false), "{given:?}");
        }
    }
}

fn sphere(document: &Value) -> SurfaceBasis {
    let extent =
        Extent { topology: Topology::Sphere, intervals: [&document["M1"], &document["M2"]].map(count) };
    SurfaceBasis::new(extent, Seam::Straight, &Topology::Sphere.usual_generators()).expect("a sphere")
}

/// The sampling of a tied sphere as in the documents.
fn tied_boundary(document: &Value, rows: &[[f64; 3]], frame: Frame<3>) -> TensorBoundary {
    let basis = Arc::new(sphere(document));
    let lift = SurfaceSnake::tied_sphere(basis.clone()).expect("a sphere").lift().expect("ties");
    let per_span = [&document["Su"], &document["gauss_per_span"]].map(count);
    TensorBoundary::new(basis.lines(), basis.control_net().multiply(&lift), per_span, rows, frame)
}

#[test]
fn tied_spheres_are_those_of_the_vectors() {
    let document = load("sphere3d");
    let field = Integrated::<3>::new(&image(&document));
    let tied = &document["tied"];
    let rows = points::<3>(&tied["free_points"]);
    let boundary = tied_boundary(&document, &rows, Frame::identity());
    let found = boundary.integral(&boundary.sample(&rows), &field);
    assert_differential(&found, &tied["E"], &tied["grad"], "tied");
}

#[test]
fn frames_are_those_of_the_vectors() {
    let document = load("affine3d");
    let field = Integrated::<3>::new(&image(&document));
    let map = &document["voxel_to_world"];
    let matrix: [[f64; 3]; 3] = points(&map["A"]).try_into().expect("three rows");
    let offset = numbers(&map["b"]).try_into().expect("an offset");
    let frame = Frame::new(matrix, offset).expect("a frame");
    assert_close(&frame.metric().concat(), &numbers(&document["inverse_metric"]), TOLERANCE, "metric");
    let world = points::<3>(&document["tied_free_points_world"]);
    let rows: Vec<[f64; 3]> = world.iter().map(|point| frame.to_index(*point)).collect();
    let boundary = tied_boundary(&document, &rows, frame);
    let samples = boundary.sample(&rows);
    let mut found = boundary.integral(&samples, &field);
    found.gradient = found.gradient.into_iter().map(|slope| frame.gradient_to_world(slope)).collect();
    assert_differential(&found, &document["E_world"], &document["grad_world"], "world");
    let volume = boundary.volume(&samples).value;
    assert_close(&[volume], &[number(&document["volume_world"])], TOLERANCE, "volume");
    let field = Arc::new(field);
    let centre = SurfaceSnake::tied_sphere(Arc::new(sphere(&document))).expect("a sphere").centre();
    let local = LocalContrast {
        image: field.clone(),
        polarity: Polarity::Bright,
        contrast: 1.0,
        centre: centre.into(),
    };
    let terms = [
        Term::Threshold(Threshold { saturated: field.clone(), theta: 0.7, scale: 90.0 }),
        Term::LocalContrast(local),
        Term::TwoClass(TwoClass { centred: field, total: 6000.0, variance: 300.0 }),
        Term::BoundaryCost(BoundaryCost { scale: 30.0 }),
        Term::Spacing(Spacing {}),
    ];
    assert_differences(&boundary, &rows, &terms);
}

/// In space, similarities are Procrustes fits.
#[test]
fn gradients_of_priors_in_space_are_those_of_differences() {
    let document = load("sphere3d");
    let basis = Arc::new(sphere(&document));
    let model = SurfaceSnake::tied_sphere(basis.clone()).expect("a sphere");
    let rows = points::<3>(&document["tied"]["free_points"]);
    let boundary = tied_boundary(&document, &rows, Frame::identity());
    let bump = |(i, p): (usize, [f64; 3])| [p[0] * 1.3, p[1] + (i as f64).sin(), p[2]];
    let reference: Vec<[f64; 3]> = model.control_points(&rows).into_iter().enumerate().map(bump).collect();
    let priors = [(ClassName::Similarity, Alignment::Procrustes), (ClassName::Affine, Alignment::Projection)];
    let terms = priors.map(|(class, alignment)| {
        let method = Method::new(&Transformation::Named(class), alignment, 3).expect("a class");
        let metric = Metric::new(basis.gram().clone(), 3);
        Term::Prior(
            Prior::new(metric, method, &reference, model.lift(), Frame::identity()).expect("a reference"),
        )
    });
    assert_differences(&boundary, &rows, &terms);
    // A tied sphere is affine covariant: its affine images are at distance zero.
    let map = |[x, y, z]: [f64; 3]| [2.0 * x + 0.3 * z - 1.0, y - 0.2 * x + 5.0, 0.7 * z + 0.1 * y];
    let method =
        Method::new(&Transformation::Named(ClassName::Affine), Alignment::Projection, 3).expect("affine");
    let (metric, posed) = (Metric::new(basis.gram().clone(), 3), model.control_points(&rows));
    let prior = Prior::new(metric, method, &posed, model.lift(), Frame::identity()).expect("a reference");
    let image: Vec<[f64; 3]> = rows.into_iter().map(map).collect();
    let distance = prior.squared_distance(&image).expect("a shape").value;
    assert!(distance < 1e-20, "{distance:e}");
}

/// Contrast and two classes do not depend on the units of the image.
#[test]
fn energies_are_dimensionless() {
    let planar = Planar::load();
    let changed = planar.image.map::<f64>(|value| 3.0 * value + 100.0);
    let mirrored = planar.image.map::<f64>(|value| 7.0 - 2.0 * value);
    let two = |image: &Image| planar.evaluate(&planar.two_class(image)).value;
    assert_close(&[two(&changed), two(&mirrored)], &[two(&planar.image); 2], 1e-9, "two classes");
    // The mean inside and the mean in the shell change alike, as the shell has the area of the shape.
    let local = |image: &Image, polarity, contrast| {
        planar.evaluate(&planar.local_contrast(image, polarity, contrast)).value
    };
    let expected = local(&planar.image, Polarity::Bright, 1.0);
    assert_close(&[local(&changed, Polarity::Bright, 3.0)], &[expected], 1e-3, "brighter");
    assert_close(&[local(&mirrored, Polarity::Dark, 2.0)], &[expected], 1e-3, "inverted");
}

/// A constant inside of the image gives area and volume; whole pixels move nothing; transposed axes give the same.
#[test]
fn integrals_obey_the_laws_of_areas() {
    let planar = Planar::load();
    let size = planar.image.size();
    let constant = Integrated::<2>::new(&planar.image.map::<f64>(|_| 2.5));
    let samples = planar.boundary.sample(&planar.rows);
    let found = planar.boundary.integral(&samples, &constant).value;
    assert_close(&[found], &[2.5 * planar.boundary.volume(&samples).value], 1e-9, "constant");
    // The image with three more columns to the left and two more rows above.
    let mut values = vec![0.0; (size[0] + 3) * 2];
    for row in planar.image.values().chunks(size[0]) {
        values.extend([0.0; 3]);
        values.extend(row);
    }
    let moved = Integrated::<2>::new(&Image::new([size[0] + 3, size[1] + 2, 1], values).expect("an image"));
    let rows: Vec<[f64; 2]> = planar.rows.iter().map(|[x, y]| [x + 3.0, y + 2.0]).collect();
    let field = Integrated::<2>::new(&planar.image);
    let (found, expected) = (
        planar.boundary.integral(&planar.boundary.sample(&rows), &moved),
        planar.boundary.integral(&samples, &field),
    );
    assert_close(&[found.value], &[expected.value], 5e-13, "moved");
    assert_close(&found.gradient.concat(), &expected.gradient.concat(), 5e-12, "gradient of moved");
    let transposed: Vec<f64> = (0..size[0])
        .flat_map(|i| (0..size[1]).map(move |j| (i, j)))
        .map(|(i, j)| planar.image.at([i, j, 0]))
        .collect();
    let field_t = Integrated::<2>::new(&Image::new([size[1], size[0], 1], transposed).expect("an image"));
    let rows: Vec<[f64; 2]> = planar.rows.iter().map(|[x, y]| [*y, *x]).collect();
    let fine = |rows: &[[f64; 2]], field: &Integrated<2>| {
        let boundary = CurveBoundary::new(&planar.line, 2048, rows, Frame::identity());
        boundary.integral(&boundary.sample(rows), field).value
    };
    assert_close(&[fine(&rows, &field_t)], &[fine(&planar.rows, &field)], 1e-8, "transposed");
}

#[test]
fn outlines_are_filled_as_in_the_vectors() {
    let planar = Planar::load();
    let model = CurveSnake::new(&GeneratorKind::Trigonometric {}, planar.rows.len()).expect("a model");
    let [width, height, _] = planar.image.size();
    let grid = Grid { first: [0.0; 3], spacing: [1.0; 3], size: [width, height, 1] };
    let mask = model.outline(&planar.rows).cells(&grid);
    let rows = planar.document["mask_rows"].as_array().expect("rows");
    for (j, row) in rows.iter().enumerate() {
        let found: String = (0..width).map(|i| if mask.inside[i * height + j] { '1' } else { '0' }).collect();
        assert_eq!(row.as_str(), Some(found.as_str()), "row {j}");
    }
}
