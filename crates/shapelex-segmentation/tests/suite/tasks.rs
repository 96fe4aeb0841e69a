//! Segmentations of the phantoms, for the floors and for the tables of the evaluation.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use shapelex_analysis::alignment::{Alignment, Method as Fit};
use shapelex_analysis::metric::Metric;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_geometry::generator::{Exact, GeneratorKind};
use shapelex_geometry::raster::{Grid, Mask};
use shapelex_geometry::subdivision::control::ControlMesh;
use shapelex_geometry::subdivision::{Frequency, Scheme, Subdivision};
use shapelex_geometry::surface::Topology;
use shapelex_geometry::surface::basis::{Extent, SurfaceBasis};
use shapelex_geometry::surface::seam::Seam;
use shapelex_numeric::bounded::never;
use shapelex_segmentation::detector::{Innermost, Sheets, edge_map, innermost, largest_component};
use shapelex_segmentation::energy::{Polarity, Prior};
use shapelex_segmentation::field::Image;
use shapelex_segmentation::frame::Frame;
use shapelex_segmentation::run::scene::{EdgeScale, ImageTerm, Scene};
use shapelex_segmentation::run::{Method, Segmentation, Settings, Stage, segment};
use shapelex_segmentation::snake::curve::CurveSnake;
use shapelex_segmentation::snake::cylinder::CylinderSnake;
use shapelex_segmentation::snake::reparametrisation::Free;
use shapelex_segmentation::snake::subdivision::SubdivisionSnake;
use shapelex_segmentation::snake::surface::SurfaceSnake;
use shapelex_segmentation::snake::{Model, Outline};

use crate::phantoms::{Rod, rods, uniform};

/// Cells of a shape in an image of this size.
pub(crate) fn cells<const D: usize>(model: &dyn Model<D>, rows: &[[f64; D]], size: [usize; 3]) -> Mask {
    model.outline(rows).cells(&Grid { first: [0.0; 3], spacing: [1.0; 3], size })
}

/// Jaccard index of a mask and a condition on the indices.
pub(crate) fn jaccard(mask: &Mask, inside: impl Fn([f64; 3]) -> bool) -> f64 {
    let [_, ny, nz] = mask.grid.size;
    let (mut both, mut any) = (0, 0);
    for (at, found) in mask.inside.iter().enumerate() {
        let truth = inside([at / (ny * nz), at / nz % ny, at % nz].map(|i| i as f64));
        both += usize::from(*found && truth);
        any += usize::from(*found || truth);
    }
    f64::from(both as u32) / f64::from(any as u32)
}

/// Number of evaluations of the energy in all stages.
pub(crate) fn count<const D: usize>(found: &Segmentation<D>) -> usize {
    found.stages.iter().map(|stage| stage.evaluations).sum()
}

/// Dice index of a Jaccard index.
pub(crate) fn dice(jaccard: f64) -> f64 {
    2.0 * jaccard / (1.0 + jaccard)
}

pub(crate) const ROD_POINTS: usize = 10;

/// Least-squares control points of the capsule `h = 12, r = 7`, from 720 points at equal arc lengths.
pub(crate) fn rod_reference() -> Vec<[f64; 2]> {
    let (half, radius) = (12.0_f64, 7.0_f64);
    let (straight, round) = (2.0 * half, PI * radius);
    let total = 2.0 * (straight + round);
    let point = |s: f64| -> [f64; 2] {
        // From (h + r, 0): a quarter of a circle, a straight side, a half circle, a side, a quarter.
        let quarter = 0.5 * round;
        let s = s.rem_euclid(total);
        let arc = |centre: f64, angle: f64| [centre + radius * angle.cos(), radius * angle.sin()];
        if s < quarter {
            arc(half, s / radius)
        } else if s < quarter + straight {
            [half - (s - quarter), radius]
        } else if s < quarter + straight + round {
            arc(-half, 0.5 * PI + (s - quarter - straight) / radius)
        } else if s < quarter + 2.0 * straight + round {
            [-half + (s - quarter - straight - round), -radius]
        } else {
            arc(half, 1.5 * PI + (s - quarter - 2.0 * straight - round) / radius)
        }
    };
    let contour: Vec<[f64; 2]> = (0..720).map(|i| point(total * f64::from(i) / 720.0)).collect();
    // Uniform parameters make the normal matrix circulant: the dense solution is as good.
    let line =
        CurveSnake::new(&GeneratorKind::Trigonometric {}, ROD_POINTS).expect("a valid case").line().clone();
    let generator = line.generator();
    let weight = |i: usize, k: usize| -> f64 {
        let t = i as f64 * ROD_POINTS as f64 / 720.0 - k as f64;
        (-1..=1).map(|turn| generator.evaluate(t + f64::from(turn * ROD_POINTS as i32), 0)).sum()
    };
    let n = ROD_POINTS;
    let mut system = vec![vec![0.0; n + 2]; n];
    for (i, p) in contour.iter().enumerate() {
        let weights: Vec<f64> = (0..n).map(|k| weight(i, k)).collect();
        for (row, a) in system.iter_mut().zip(&weights) {
            for (entry, b) in row.iter_mut().zip(weights.iter().chain(p)) {
                *entry += a * b;
            }
        }
    }
    for pivot in 0..n {
        for row in (0..n).filter(|row| *row != pivot) {
            let factor = system[row][pivot] / system[pivot][pivot];
            for column in 0..n + 2 {
                let value = system[pivot][column];
                system[row][column] -= factor * value;
            }
        }
    }
    (0..n).map(|k| [system[k][n] / system[k][k], system[k][n + 1] / system[k][k]]).collect()
}

/// Every rod from its first shape; returns the Jaccard indices.
pub(crate) fn segment_rods(
    image: &Image,
    term: impl Fn(f64, f64) -> (ImageTerm, f64),
    spacing: f64,
    prior: Option<(ClassName, f64)>,
    method: Method,
) -> (Vec<f64>, usize) {
    let model = CurveSnake::new(&GeneratorKind::Trigonometric {}, ROD_POINTS).expect("a valid case");
    let reference = rod_reference();
    let random: Vec<f64> = uniform(7).take(5 * 19).collect();
    let (mut overlaps, mut evaluations) = (Vec::new(), 0);
    let mut scenes: Vec<((ImageTerm, f64), Scene<2>)> = Vec::new();
    for (m, rod) in rods().iter().enumerate() {
        let start = rod_start(rod, &reference, &random[5 * m..5 * m + 5]);
        let boundary = model.boundary(&start, 1.0, Frame::identity());
        let samples = boundary.sample(&start);
        let (area, length) = (boundary.volume(&samples).value, boundary.measure(&samples).value);
        let (term, sigma) = term(area, length);
        let scene = match scenes.iter().position(|(key, _)| *key == (term, sigma)) {
            Some(at) => at,
            None => {
                let scene = Scene::new(image, Frame::identity(), &[(term, 1.0)], &[sigma]);
                scenes.push(((term, sigma), scene));
                scenes.len() - 1
            }
        };
        let mut settings = Settings::new(vec![Stage::new(Free::All, sigma)]);
        (settings.spacing, settings.method) = (spacing, method);
        settings.prior = prior.map(|(class, gamma)| {
            let metric = Metric::new(model.line().gram().clone(), 2);
            let fit =
                Fit::new(&Transformation::Named(class), Alignment::Projection, 2).expect("a valid case");
            (Prior::new(metric, fit, &reference, None, Frame::identity()).expect("a valid case"), gamma)
        });
        let found = segment(&scenes[scene].1, &model, &start, &settings, &never).expect("a valid case");
        evaluations += count(&found);
        overlaps
            .push(jaccard(&cells(&model, &found.rows, image.size()), |[x, y, _]| rod.distance(x, y) <= 0.0));
    }
    (overlaps, evaluations)
}

/// The reference, posed at a rod by five random numbers.
pub(crate) fn rod_start(rod: &Rod, reference: &[[f64; 2]], u: &[f64]) -> Vec<[f64; 2]> {
    let scale = rod.radius / 7.0 * (0.7 + 0.4 * u[0]);
    let (sine, cosine) = (rod.degrees - 20.0 + 40.0 * u[1]).to_radians().sin_cos();
    let offset = 0.5 * rod.radius * u[2];
    let centre = [rod.centre[0] + offset * (TAU * u[3]).cos(), rod.centre[1] + offset * (TAU * u[3]).sin()];
    let pose = |[x, y]: &[f64; 2]| {
        [centre[0] + scale * (cosine * x - sine * y), centre[1] + scale * (sine * x + cosine * y)]
    };
    reference.iter().map(pose).collect()
}

/// The contour term for the rods, scaled with a circle of the area of the first shape.
pub(crate) fn rod_contour(image: &Image) -> impl Fn(f64, f64) -> (ImageTerm, f64) {
    let contrast = image.percentile(99.0) - image.percentile(1.0);
    move |area: f64, length: f64| {
        let edges = EdgeScale::Given(contrast * 4.0 * area.sqrt() / length);
        (ImageTerm::Contour { polarity: Polarity::Bright, edges }, 2.0)
    }
}

/// The region term for the rods.
pub(crate) fn rod_region(_: f64, _: f64) -> (ImageTerm, f64) {
    (ImageTerm::LocalContrast { polarity: Polarity::Bright }, 1.0)
}

/// A cylinder of 6 × 6 intervals with an upright first shape: axis, radius, lower and upper end.
pub(crate) fn upright(centre: [f64; 2], radius: f64, ends: [f64; 2]) -> (CylinderSnake, Vec<[f64; 3]>) {
    let extent = Extent { topology: Topology::Cylinder, intervals: [6, 6] };
    let basis = SurfaceBasis::new(extent, Seam::Straight, &Topology::Cylinder.usual_generators());
    let model = CylinderSnake::new(Arc::new(basis.expect("a valid case"))).expect("a valid case");
    let height = |l: usize| ends[0] + (ends[1] - ends[0]) * l as f64 / 6.0;
    let start = (0..6).flat_map(|k| (0..7).map(move |l| (TAU * f64::from(k) / 6.0, l)));
    let point = |(angle, l): (f64, usize)| {
        [centre[0] + radius * angle.cos(), centre[1] + radius * angle.sin(), height(l)]
    };
    (model, start.map(point).collect())
}

/// Stages and weights of cylinder B of the notes.
pub(crate) fn cylinder_settings() -> Settings<3> {
    let affine = [6.0, 3.0, 2.0, 1.5].map(|sigma| Stage::new(Free::Affine, sigma));
    let free = [1.5, 0.8].map(|sigma| Stage::new(Free::All, sigma));
    let mut settings = Settings::new(affine.into_iter().chain(free).collect());
    (settings.boundary, settings.spacing, settings.tolerance) = (0.3, 100.0, 0.02);
    settings
}

/// Cylinder B of the notes in a volume with a bright wall.
pub(crate) fn segment_cylinder(volume: &Image, model: &CylinderSnake, start: &[[f64; 3]]) -> Segmentation<3> {
    let terms = [(ImageTerm::Contour { polarity: Polarity::Dark, edges: EdgeScale::Sheets(99.5) }, 1.0)];
    let scene = Scene::new(volume, Frame::identity(), &terms, &[6.0, 3.0, 2.0, 1.5, 0.8]);
    segment(&scene, model, start, &cylinder_settings(), &never).expect("a valid case")
}

/// A scheme on the octahedron.
pub(crate) fn octahedral(scheme: Scheme, level: usize) -> SubdivisionSnake {
    let connectivity = ControlMesh::Named("octahedron".parse().expect("a valid case"));
    SubdivisionSnake::new(Subdivision { scheme, level, connectivity }).expect("a valid case")
}

/// BLOB on the octahedron.
pub(crate) fn blob(level: usize) -> SubdivisionSnake {
    octahedral(Scheme::Blob(Frequency::Real(Exact::new(PI / 2.0))), level)
}

/// The approximation of a sphere, with a mean radius and a centre.
pub(crate) fn blob_sphere(model: &SubdivisionSnake, radius: f64, centre: [f64; 3]) -> Vec<[f64; 3]> {
    let sphere = model.subdivision().connectivity.sphere().expect("a valid case").vertices;
    let Outline::Mesh(mesh) = model.outline(&sphere) else { unreachable!() };
    let radii = mesh.vertices.iter().map(|v| v.iter().map(|x| x * x).sum::<f64>().sqrt());
    let mean = radii.sum::<f64>() / mesh.vertices.len() as f64;
    sphere.iter().map(|v| std::array::from_fn(|c| centre[c] + radius / mean * v[c])).collect()
}

/// A scene with the contour term for bright objects, at the blurs of the nucleus.
pub(crate) fn nucleus_scene(volume: &Image) -> Scene<3> {
    let edges = EdgeScale::Percentile(99.5);
    let terms = [(ImageTerm::Contour { polarity: Polarity::Bright, edges }, 1.0)];
    Scene::new(volume, Frame::identity(), &terms, &[4.0, 2.0, 1.0])
}

/// Stages with the tolerance for nuclei.
pub(crate) fn nucleus_settings(stages: &[(Free, f64)]) -> Settings<3> {
    let mut settings = Settings::new(stages.iter().map(|(free, sigma)| Stage::new(*free, *sigma)).collect());
    settings.tolerance = 0.02;
    settings
}

/// A nucleus from control meshes of 6, 18, 66 … points up to a number, each nested in the next. `each` sees every result.
pub(crate) fn segment_nested(
    scene: &Scene<3>,
    mut model: SubdivisionSnake,
    wanted: usize,
    mut each: impl FnMut(&SubdivisionSnake, &Segmentation<3>),
) {
    let mut rows = blob_sphere(&model, 11.0, [32.5, 31.5, 31.0]);
    let mut stages = vec![(Free::Affine, 4.0), (Free::All, 4.0)];
    loop {
        let found = segment(scene, &model, &rows, &nucleus_settings(&stages), &never).expect("a valid case");
        each(&model, &found);
        if rows.len() >= wanted {
            break;
        }
        let (finer, step) = model.refined().expect("a valid case").expect("a level more");
        (rows, model) = (step.apply(&found.rows), finer);
        stages = vec![(Free::All, if rows.len() == 18 { 2.0 } else { 1.0 })];
    }
}

/// A tied sphere of 9 × 9 intervals.
pub(crate) fn tied_sphere() -> SurfaceSnake {
    let extent = Extent { topology: Topology::Sphere, intervals: [9, 9] };
    let basis = SurfaceBasis::new(extent, Seam::Straight, &Topology::Sphere.usual_generators());
    SurfaceSnake::tied_sphere(Arc::new(basis.expect("a valid case"))).expect("a valid case")
}

/// The frame of the head: voxels of 2 mm around the origin.
pub(crate) fn head_frame() -> Frame<3> {
    let axes = [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]];
    Frame::new(axes, [-90.0, -108.0, -90.0]).expect("a valid case")
}

/// Rough centre of the head, in voxels.
const HEAD_CENTRE: [f64; 3] = [43.0, 52.0, 46.0];

/// The first shape in the head.
pub(crate) fn head_start() -> Vec<[f64; 3]> {
    ellipsoid(9, 9, [22.5, 27.5, 20.0], HEAD_CENTRE)
}

/// A volume with a head in it, and where its segmentation begins.
pub(crate) struct HeadTask<'a> {
    pub(crate) image: &'a Image,
    pub(crate) frame: Frame<3>,
    /// Rough centre of the brain, in voxels.
    pub(crate) centre: [f64; 3],
    /// Points of a tied sphere.
    pub(crate) start: Vec<[f64; 3]>,
}

impl HeadTask<'_> {
    /// Pipeline B of the notes: the region brighter than a part of its median, at two blurs.
    pub(crate) fn by_region(&self, theta: f64, spacing: f64, [coarse, fine]: [f64; 2]) -> Segmentation<3> {
        let terms = [(ImageTerm::Threshold { theta, level: None }, 1.0)];
        let scene = Scene::new(self.image, self.frame, &terms, &[coarse, fine]);
        let stages = [(Free::Radial, coarse), (Free::All, coarse), (Free::All, fine)];
        let settings = Settings { spacing, ..nucleus_settings(&stages) };
        segment(&scene, &tied_sphere(), &self.start, &settings, &never).expect("a valid case")
    }

    /// Pipeline A of the notes: the skull is a dark sheet, whose crests nearest to the centre are the edge map.
    pub(crate) fn by_skull(&self) -> Segmentation<3> {
        let (frame, size) = (self.frame, self.image.size());
        let sheets: Sheets<f32> = Sheets::new(self.image, &frame, 4.0, Polarity::Dark, &never)
            .expect("a valid case")
            .expect("no stop");
        let crests = sheets.crests(sheets.threshold(0.3, 99.0), &never).expect("no stop");
        let surface = innermost(&sheets, &crests, &Innermost::around(self.centre, 20.0, &frame));
        let map: Image = edge_map(&largest_component(&surface, size), size);
        let edges = EdgeScale::Percentile(99.5);
        let terms = [(ImageTerm::Contour { polarity: Polarity::Dark, edges }, 1.0)];
        let scene = Scene::new(&map, frame, &terms, &[6.0, 3.0, 2.0]);
        let stages =
            [(Free::Affine, 6.0), (Free::Radial, 6.0), (Free::All, 6.0), (Free::All, 3.0), (Free::All, 2.0)];
        // After 150 iterations the overlap has changed by less than a thousandth.
        let stage = |(free, sigma)| Stage { iterations: 60, ..Stage::new(free, sigma) };
        let mut settings = Settings::new(stages.map(stage).into());
        (settings.spacing, settings.tolerance) = (5.0, 0.05);
        segment(&scene, &tied_sphere(), &self.start, &settings, &never).expect("a valid case")
    }
}

/// The task of the phantom of a head.
pub(crate) fn head_task(head: &Image) -> HeadTask<'_> {
    HeadTask { image: head, frame: head_frame(), centre: HEAD_CENTRE, start: head_start() }
}

pub(crate) fn segment_head_by_region(head: &Image) -> Segmentation<3> {
    head_task(head).by_region(0.6, 0.1, [2.0, 1.0])
}

pub(crate) fn segment_head_by_skull(head: &Image) -> Segmentation<3> {
    head_task(head).by_skull()
}

/// Points and poles of an ellipsoid for a tied sphere.
pub(crate) fn ellipsoid(around: usize, along: usize, axes: [f64; 3], centre: [f64; 3]) -> Vec<[f64; 3]> {
    let at =
        |[x, y, z]: [f64; 3]| [centre[0] + axes[0] * x, centre[1] + axes[1] * y, centre[2] + axes[2] * z];
    let ring = |k: usize| {
        (1..along).map(move |l| {
            let (u, v) = (TAU * k as f64 / around as f64, PI * l as f64 / along as f64);
            [v.sin() * u.cos(), v.sin() * u.sin(), v.cos()]
        })
    };
    (0..around).flat_map(ring).chain([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]).map(at).collect()
}
