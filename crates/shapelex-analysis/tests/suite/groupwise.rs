//! Laws of the groupwise correspondence of shapes on a sphere.

use shapelex_analysis::AnalysisError;
use shapelex_analysis::groupwise::{Groupwise, GroupwiseOptions, Reference, STIFFNESS, correspond};
use shapelex_analysis::watch::{StopWhen, Unwatched};
use shapelex_geometry::reparametrisation::Spherical;
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_geometry::rotation::Rotation;
use shapelex_geometry::surface::Topology;
use shapelex_geometry::surface::fit::spherical_direction;
use shapelex_geometry::surface::seam::Seam;
use shapelex_numeric::dense::{Matrix, svd};

const OPTIONS: GroupwiseOptions =
    GroupwiseOptions { degree: 2, rounds: 3, sizes: true, stiffness: STIFFNESS };

fn space() -> ShapeSpace {
    let topology = Topology::Sphere;
    let representation = Representation::Surface {
        topology,
        seam: Seam::Straight,
        control_points: [10, 10],
        generators: topology.usual_generators(),
    };
    ShapeSpace::new(&representation).unwrap()
}

/// A bean whose long half-axis grows with `t`, with its parameters turned.
fn bean(space: &ShapeSpace, t: f64, turn: Rotation) -> Matrix {
    space.surface().unwrap().interpolate_function(|u, v| {
        let [x, y, z] = turn.apply(spherical_direction([u, v]));
        [x * (1.0 + 0.1 * z), 1.4 * y + 0.2 * z * z, (2.0 + t) * z + 0.3 * z * z]
    })
}

fn beans(space: &ShapeSpace, turned: bool) -> Vec<Matrix> {
    let turn = |k: f64| {
        if turned {
            Rotation::about([1.7 * (1.3 * k).sin(), 2.0 * (2.1 * k).cos(), k])
        } else {
            Rotation::NONE
        }
    };
    (0..6).map(f64::from).map(|k| bean(space, 0.1 * k, turn(k))).collect()
}

fn found(spherical: &Spherical, shapes: &[Matrix]) -> Groupwise {
    correspond(spherical, shapes, &OPTIONS, &Unwatched).unwrap()
}

fn rows(found: &Groupwise) -> Vec<Matrix> {
    found.members.iter().map(|member| member.refit.rows.clone()).collect()
}

/// Largest distance of two lists of shapes, relative to their size.
fn apart(a: &[Matrix], b: &[Matrix]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).norm() / a.norm()).fold(0.0, f64::max)
}

#[test]
fn neither_the_order_nor_the_rotation_of_the_parameters_matters() {
    let space = space();
    let spherical = space.spherical().unwrap();
    let given = found(&spherical, &beans(&space, false));
    let turned = found(&spherical, &beans(&space, true));
    assert!(given.members.iter().all(|member| member.refit.folded < 1e-3 && member.least_jacobian > 0.1));
    let difference = apart(&rows(&given), &rows(&turned));
    assert!(difference < 3e-2, "{difference}");
    let mut backwards = beans(&space, true);
    backwards.reverse();
    let mut backwards = rows(&found(&spherical, &backwards));
    backwards.reverse();
    let difference = apart(&rows(&turned), &backwards);
    assert!(difference < 1e-6, "{difference}");
}

#[test]
fn the_bits_do_not_depend_on_the_number_of_threads() {
    let space = space();
    let spherical = space.spherical().unwrap();
    let shapes = beans(&space, true);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        rows(&pool.install(|| found(&spherical, &shapes)))
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn entropy_falls_and_a_new_shape_finds_its_place() {
    let space = space();
    let spherical = space.spherical().unwrap();
    let shapes = beans(&space, true);
    let group = found(&spherical, &shapes);
    assert!(group.entropy[1] <= group.entropy[0], "{:?}", group.entropy);
    let corresponding = rows(&group);
    let mean = corresponding.iter().sum::<Matrix>() / corresponding.len() as f64;
    let displacement = (&corresponding[5] - &corresponding[0]) * 0.3;
    let reference = Reference::new(&spherical, &mean, &[displacement]).unwrap();
    let new = bean(&space, 0.25, Rotation::about([1.0, 2.0, -0.5]));
    let placed = reference.correspond(&new, &OPTIONS, &Unwatched).unwrap();
    let between = (&corresponding[2] + &corresponding[3]) * 0.5;
    let difference = (&placed.refit.rows - &between).norm() / between.norm();
    assert!(difference < 3e-2, "{difference}");
}

/// A rounded box with a bump on one face, at `place` along its long edge. It has a plane of symmetry, along its middle axis.
fn box_with_bump(space: &ShapeSpace, place: f64, turn: Rotation) -> Matrix {
    space.surface().unwrap().interpolate_function(|u, v| {
        let direction = turn.apply(spherical_direction([u, v]));
        let radius = direction.iter().map(|x| x.abs().powi(6)).sum::<f64>().powf(-1.0 / 6.0);
        let [x, y, z] = [0, 1, 2].map(|c| radius * direction[c] * [30.0, 14.0, 10.0][c]);
        let apart = (x - place).powi(2) + y * y;
        let bump = if z > 0.0 { (-apart / (2.0 * 7.0 * 7.0)).exp() } else { 0.0 };
        [x, y, z + 12.0 * bump]
    })
}

/// Part of the variance that the first mode explains, where control points are compared as they are.
fn explained(shapes: &[Matrix]) -> f64 {
    let mean = shapes.iter().sum::<Matrix>() / shapes.len() as f64;
    let centred = Matrix::from_fn(shapes.len(), mean.len(), |k, i| shapes[k][i] - mean[i]);
    let squares: Vec<f64> =
        svd(centred, false, false).unwrap().singular_values.iter().map(|x| x * x).collect();
    squares.iter().fold(0.0, |most: f64, x| most.max(*x)) / squares.iter().sum::<f64>()
}

#[test]
fn a_bump_that_moves_along_a_box_is_one_mode() {
    let topology = Topology::Sphere;
    let representation = Representation::Surface {
        topology,
        seam: Seam::Straight,
        control_points: [14, 14],
        generators: topology.usual_generators(),
    };
    let space = ShapeSpace::new(&representation).unwrap();
    let spherical = space.spherical().unwrap();
    for turned in [false, true] {
        let turn = |k: f64| {
            let by = [1.7 * (1.3 * k).sin(), 2.0 * (2.1 * k).cos(), k];
            if turned { Rotation::about(by) } else { Rotation::NONE }
        };
        let shapes: Vec<Matrix> =
            (0..8).map(f64::from).map(|k| box_with_bump(&space, 2.0 * k - 15.0, turn(k))).collect();
        let at = |degree: usize| {
            let options = GroupwiseOptions { degree, rounds: 4, ..OPTIONS };
            let found = correspond(&spherical, &shapes, &options, &Unwatched).unwrap();
            assert!(found.members.iter().all(|member| member.refit.folded < 1e-2));
            explained(&rows(&found))
        };
        // With other poles, 14 × 14 control points represent the edges of the box differently in every shape: a tenth of the variance.
        let least = if turned { 0.8 } else { 0.98 };
        let (rotated, moved) = (at(0), at(4));
        assert!(moved > least && moved > rotated + 0.05, "{turned}: {rotated} {moved}");
    }
}

#[test]
fn shapes_without_extent_are_named_and_a_stop_is_obeyed() {
    let space = space();
    let spherical = space.spherical().unwrap();
    let one = beans(&space, false)[..1].to_vec();
    let few = correspond(&spherical, &one, &OPTIONS, &Unwatched);
    assert_eq!(few.unwrap_err(), AnalysisError::TooFewShapes { found: 1, needed: 2 });
    for axes in [0, 1, 2] {
        let mut shapes = beans(&space, false);
        (axes..3).for_each(|c| shapes[4].column_mut(c).fill(0.0));
        let error = correspond(&spherical, &shapes, &OPTIONS, &Unwatched).unwrap_err();
        assert_eq!(error.position(), Some(4), "{error}");
    }
    let stopped = correspond(&spherical, &beans(&space, false), &OPTIONS, &StopWhen(&|| true));
    assert_eq!(stopped.unwrap_err(), AnalysisError::Interrupted);
    // Equal shapes have no variance.
    let equal = vec![beans(&space, false)[0].clone(); 3];
    let found = found(&spherical, &equal);
    assert!(
        found.members.iter().all(|member| member.refit.folded == 0.0 && member.map.displacement() < 1e-3)
    );
}
