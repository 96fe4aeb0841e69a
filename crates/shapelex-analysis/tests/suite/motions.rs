//! Surfaces whose parameters are turned at random: under `cyclic` their statistics are those of their shapes.

use std::f64::consts::TAU;

use shapelex_analysis::accumulate::ShapesInMemory;
use shapelex_analysis::alignment::{Alignment, MeanShape, Method, align_all};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::frame::Frame;
use shapelex_analysis::matching::{Disagreement, Matching};
use shapelex_analysis::metric::Metric;
use shapelex_analysis::pca::FunctionalPca;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_geometry::surface::Topology;
use shapelex_geometry::surface::fit::spherical_direction;
use shapelex_geometry::surface::measures::SurfaceMeasures;
use shapelex_geometry::surface::seam::Seam;
use shapelex_numeric::dense::Matrix;

const COUNT: usize = 6;

fn space(topology: Topology, control_points: [usize; 2]) -> ShapeSpace {
    let generators = topology.usual_generators();
    let seam = Seam::Straight;
    ShapeSpace::new(&Representation::Surface { topology, seam, control_points, generators }).unwrap()
}

/// `R p` for a rotation by `turns` about an axis that `k` decides.
fn turned(k: usize, turns: f64, p: [f64; 3]) -> [f64; 3] {
    let t = k as f64;
    let axis = [(1.3 * t).sin(), (0.9 * t + 1.0).cos(), (2.1 * t).sin() + 0.1];
    let length = axis.iter().map(|a| a * a).sum::<f64>().sqrt();
    let n = axis.map(|a| a / length);
    let (sine, cosine) = (TAU * turns).sin_cos();
    let along: f64 = (0..3).map(|i| n[i] * p[i]).sum();
    let across = [n[1] * p[2] - n[2] * p[1], n[2] * p[0] - n[0] * p[2], n[0] * p[1] - n[1] * p[0]];
    [0, 1, 2].map(|i| cosine * p[i] + sine * across[i] + (1.0 - cosine) * along * n[i])
}

/// A bean without symmetry that bends and thickens with `k`, in a pose of its own, its parameters turned by `turns`.
fn bean(space: &ShapeSpace, k: usize, turns: f64) -> Vec<f64> {
    let (bend, thick) = (0.5 + 0.35 * (2.3 * k as f64).sin(), 1.0 + 0.15 * (1.7 * k as f64).cos());
    let rows = space.surface().unwrap().interpolate_function(|u, v| {
        let [x, y, z] = turned(k, turns, spherical_direction([u, v]));
        let point =
            [thick * x * (1.0 + 0.2 * z) + bend * z * z, 1.3 * y + 0.15 * z * z, 2.4 * z + 0.3 * x * x];
        let placed = turned(3 * k + 1, 0.37 * k as f64, point);
        placed.map(|value| (1.0 + 0.1 * k as f64) * value + k as f64)
    });
    rows.as_slice().to_vec()
}

fn method(name: ClassName) -> Method {
    let transformation = Transformation::Named(name);
    Method::new(&transformation, Alignment::usual(&transformation, 3), 3).unwrap()
}

fn mean(
    space: &ShapeSpace,
    name: ClassName,
    correspondence: Correspondence,
    shapes: &[Vec<f64>],
) -> (MeanShape, Vec<f64>) {
    let method = method(name);
    let matching = Matching::new(space, correspondence, Direction::Given, Mirror::Forbid)
        .translating(method.translates());
    let metric = Metric::of(space);
    let weights = vec![1.0; shapes.len()];
    let (mean, aligned) =
        align_all(&metric, &method, Frame::Canonical, &matching, shapes.concat(), weights.clone()).unwrap();
    for one in &aligned {
        assert_eq!(one.moved.is_some(), correspondence == Correspondence::Cyclic);
        assert!(one.moved.is_none_or(|(_, change)| change < 0.02), "{:?}", one.moved);
    }
    let aligned: Vec<f64> = aligned.into_iter().flat_map(|one| one.whitened).collect();
    let source = ShapesInMemory::prepared(aligned, weights);
    let pca = FunctionalPca::new(&source, &metric, &mean.whitened, true, 3).unwrap();
    (mean, pca.explained)
}

/// Volume over the power 3/2 of the area: no size, no parameters.
fn roundness(space: &ShapeSpace, mean: &MeanShape) -> f64 {
    let rows = Matrix::from_column_slice(space.gram().size(), 3, &mean.control_points);
    let measures = SurfaceMeasures::of(&space.surface().unwrap().surface(&rows));
    measures.enclosed.unwrap().signed_volume.abs() / measures.area.powf(1.5)
}

#[test]
fn turned_parameters_do_not_change_the_mean_nor_the_modes() {
    let space = space(Topology::Sphere, [10, 8]);
    let given: Vec<Vec<f64>> = (0..COUNT).map(|k| bean(&space, k, 0.0)).collect();
    let turned: Vec<Vec<f64>> = (0..COUNT).map(|k| bean(&space, k, 0.11 + 0.29 * k as f64)).collect();
    for name in [ClassName::Similarity, ClassName::Affine] {
        let (corresponding, explained) = mean(&space, name, Correspondence::Landmarks, &given);
        assert_eq!(
            corresponding.disagreement,
            Some(Disagreement { looked_at: COUNT, disagreeing: 0 }),
            "{name:?}"
        );
        let expected = roundness(&space, &corresponding);

        // As they are, their mean is none of their shapes, and the answer says so.
        let (apart, wrong) = mean(&space, name, Correspondence::Landmarks, &turned);
        assert!(apart.disagreement.unwrap().disagreeing > 1, "{:?}", apart.disagreement);
        assert!((wrong[0] - explained[0]).abs() > 0.1, "{wrong:?}");

        let (found, same) = mean(&space, name, Correspondence::Cyclic, &turned);
        assert!(found.converged && found.disagreement.is_none());
        let roundness_found = roundness(&space, &found);
        assert!((roundness_found / expected - 1.0).abs() < 0.01, "{name:?} {roundness_found} {expected}");
        assert!((same[0] - explained[0]).abs() < 0.05, "{name:?} {same:?} {explained:?}");

        // Another order: the same bits are not promised, the same mean is.
        let backwards: Vec<Vec<f64>> = turned.iter().rev().cloned().collect();
        let (reversed, _) = mean(&space, name, Correspondence::Cyclic, &backwards);
        let difference: f64 =
            found.whitened.iter().zip(&reversed.whitened).map(|(a, b)| (a - b).powi(2)).sum();
        assert!(difference.sqrt() < 1e-9, "{name:?} {difference}");
    }
}

#[test]
fn cylinders_are_matched_around_their_axis_and_end_to_end() {
    let space = space(Topology::Cylinder, [12, 6]);
    let metric = Metric::of(&space);
    let tube = |k: usize, shift: f64, reversed: bool| -> Vec<f64> {
        let bump = 0.3 + 0.02 * k as f64;
        let rows = space.surface().unwrap().interpolate_function(|u, v| {
            let (u, v) = if reversed { (shift - u, 1.0 - v) } else { (u + shift, v) };
            let r = 1.0 + bump * (TAU * u).cos() * v + 0.2 * (TAU * 2.0 * u).sin();
            [r * (TAU * u).cos(), r * (TAU * u).sin(), 3.0 * v]
        });
        rows.as_slice().to_vec()
    };
    let given: Vec<f64> = (0..6).flat_map(|k| tube(k, 0.0, false)).collect();
    let moved: Vec<f64> = (0..6).flat_map(|k| tube(k, 0.13 * k as f64, k % 2 == 1)).collect();
    let method = method(ClassName::Similarity);
    let run = |correspondence, shapes: Vec<f64>| {
        let matching = Matching::new(&space, correspondence, Direction::Either, Mirror::Forbid);
        let (mean, aligned) =
            align_all(&metric, &method, Frame::Canonical, &matching, shapes, vec![1.0; 6]).unwrap();
        (mean, aligned.iter().map(|one| one.residual).sum::<f64>())
    };
    let (_, expected) = run(Correspondence::Landmarks, given);
    let (apart, wrong) = run(Correspondence::Landmarks, moved.clone());
    assert!(apart.disagreement.unwrap().disagreeing > 0 && wrong > 3.0 * expected);
    let (_, found) = run(Correspondence::Cyclic, moved);
    assert!(found < 1.2 * expected, "{found} {expected}");
}
