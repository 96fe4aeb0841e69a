//! Symmetry against `tests/vectors/models/symmetry.json`: table 1e-10, p equal, Z 1e-6, angles 1e-7 degrees, asymmetry 1e-10; and its
//! laws.

use serde_json::Value;
use shapelex_analysis::alignment::{Alignment, Method};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::inference::aligned::{AlignedShapes, StudySpace, frame_for};
use shapelex_analysis::matching::Matching;
use shapelex_analysis::metric::Metric;
use shapelex_analysis::models::records::TermRecord;
use shapelex_analysis::symmetry::error::SymmetryError;
use shapelex_analysis::symmetry::plane::{best_plane, planes_of_curve};
use shapelex_analysis::symmetry::records::{PlaneRecord, SymmetryKind, SymmetryRecord};
use shapelex_analysis::symmetry::relabelling::{Relabelling, mirrored};
use shapelex_analysis::symmetry::sample::{Averages, Sides, SymmetryTesting, symmetry_table};
use shapelex_analysis::symmetry::study::{SymmetryQuestion, indices, symmetry};
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_geometry::surface::Topology;
use shapelex_numeric::dense::Matrix;

use crate::models::{SplitMix, close, load, numbers, response, texts};

#[track_caller]
fn row(found: &TermRecord, wanted: &Value, has_test: bool) {
    let number = |name: &str| wanted[name].as_f64().unwrap();
    assert_eq!(found.degrees as f64, number("df"), "{wanted}");
    close(found.sum_of_squares, number("ss"), 1e-10, "SS");
    close(found.mean_square.unwrap(), number("ms"), 1e-10, "MS");
    close(found.f.unwrap(), number("f"), 1e-9, "F");
    if has_test {
        close(found.p.unwrap(), number("p"), 1e-12, "p");
        assert!((found.z.unwrap() - number("z")).abs() < 1e-6, "Z {:?} for {wanted}", found.z);
    }
}

#[test]
fn the_table_of_matching_symmetry_is_that_of_the_vectors() {
    let vectors = load("symmetry.json");
    let case = &vectors["matching"];
    let y = response(&case["y"]);
    let names: Vec<String> = (0..6).map(|i| i.to_string()).collect();
    let individual: Vec<usize> =
        texts(&case["individual"]).iter().map(|name| name.parse().unwrap()).collect();
    let side: Vec<usize> = texts(&case["side"]).iter().map(|name| usize::from(name == "r")).collect();
    let sides = Sides { names: &names, individual: &individual, side: &side, measured: None };
    let seed = |value: &Value| value["seed"].as_u64().unwrap();
    let given = SplitMix::orders(seed(case), 199, &vec![String::new(); 24]);
    let collapsed = &case["stratum"]["individual_given_permutations_inside_sides"];
    let strata = texts(&case["stratum"]["cells"]["data"]["side"]);
    let given_averages = SplitMix::orders(seed(collapsed), 199, &strata);
    let testing = SymmetryTesting {
        permutations: 199,
        given: Some(&given),
        given_averages: Some(&given_averages),
        ..SymmetryTesting::default()
    };
    let averages = Averages::new(&y, &[1.0; 24], &sides).unwrap();
    let wanted = response(&case["stratum"]["cells"]["y"]);
    assert!((averages.vectors.clone() - wanted).amax() < 1e-13 && averages.has_replicates);
    let table = symmetry_table(&y, &[1.0; 24], &sides, &averages, &testing, &Unwatched).unwrap();
    let exact = &case["stratum"]["side_all_64_exchanges_inside_individuals"];
    row(&table.terms[0].row, &collapsed["row"], true);
    row(&table.terms[1].row, exact, true);
    row(&table.terms[2].row, &case["table"][2], true);
    let side = &table.terms[1].row;
    assert!(side.exact && side.permutations == 63 && side.collapsed, "{side:?}");
    assert_eq!((side.error_term.as_deref(), side.distinct), (Some("individual:side"), Some(64.0)));
    for (found, wanted) in table.terms.iter().zip(case["table"].as_array().unwrap()) {
        row(&found.row, wanted, false);
        close(found.row.r_squared, wanted["r_squared"].as_f64().unwrap(), 1e-10, "R²");
    }
    let residual = table.residual.unwrap();
    close(residual.sum_of_squares, case["table"][3]["ss"].as_f64().unwrap(), 1e-10, "residuals");
    assert_eq!((residual.degrees, table.total.degrees), (12, 23));
    close(table.total.sum_of_squares, case["table"][4]["ss"].as_f64().unwrap(), 1e-10, "total");
}

#[test]
fn indices_are_those_of_the_vectors() {
    let vectors = load("symmetry.json");
    let case = &vectors["matching"];
    let cells = response(&case["stratum"]["cells"]["y"]);
    let individual: Vec<usize> = (0..12).map(|cell| cell / 2).collect();
    let side: Vec<usize> = (0..12).map(|cell| cell % 2).collect();
    let names: Vec<String> = (0..6).map(|i| i.to_string()).collect();
    let sides = Sides { names: &names, individual: &individual, side: &side, measured: None };
    let averages = Averages::new(&cells, &[1.0; 12], &sides).unwrap();
    let differences = averages.differences();
    let directional: Vec<f64> = differences.column_mean().iter().copied().collect();
    for (found, wanted) in directional.iter().zip(numbers(&case["directional"])) {
        assert!((found - wanted).abs() < 1e-12, "{found} for {wanted}");
    }
    let found = indices(&names, &differences, &directional, Some(&[1e-3; 6]), |_| None);
    for (i, found) in found.iter().enumerate() {
        let wanted = |name: &str| case[name][i].as_f64().unwrap();
        close(found.unsigned, wanted("unsigned_index"), 1e-10, "unsigned");
        close(found.fluctuating, wanted("fluctuating_norm"), 1e-10, "fluctuating");
        close(found.signed.unwrap(), wanted("signed_index"), 1e-10, "signed");
        let corrected = (wanted("unsigned_index").powi(2) - 1e-3).max(0.0).sqrt();
        close(found.unsigned_corrected.unwrap(), corrected, 1e-9, "corrected");
    }
}

/// Coordinate-major numbers about their mean.
fn centred(points: &Value) -> Vec<f64> {
    let rows: Vec<Vec<f64>> = points.as_array().unwrap().iter().map(numbers).collect();
    let mean = |c: usize| rows.iter().map(|row| row[c]).sum::<f64>() / rows.len() as f64;
    let means: Vec<f64> = (0..rows[0].len()).map(mean).collect();
    (0..means.len()).flat_map(|c| rows.iter().map(|row| row[c] - means[c]).collect::<Vec<_>>()).collect()
}

#[track_caller]
fn is_plane(found: &PlaneRecord, wanted: &Value) {
    let turn = (found.axis_degrees.unwrap() - wanted["axis_degrees"].as_f64().unwrap()).rem_euclid(180.0);
    assert!(turn.min(180.0 - turn) < 1e-7, "{found:?} for {wanted}");
    close(found.correlation, wanted["correlation"].as_f64().unwrap(), 1e-10, "correlation");
    assert!(
        (found.asymmetry - wanted["asymmetry"].as_f64().unwrap()).abs() < 1e-10,
        "{found:?} for {wanted}"
    );
    if let Some(part) = wanted["symmetric_part"].as_f64() {
        close(found.symmetric_part, part, 1e-10, "symmetric part");
    }
    // The parts are orthogonal: their squares add up.
    let all = found.asymmetry.powi(2) + found.symmetric_part.powi(2);
    assert!((all - 1.0).abs() < 1e-12, "{all}");
}

fn landmarks(points: usize, dimension: usize) -> ShapeSpace {
    ShapeSpace::new(&Representation::Landmarks { dimension, points }).unwrap()
}

#[test]
fn planes_of_landmarks_are_those_of_the_vectors() {
    let vectors = load("symmetry.json");
    let case = &vectors["object"];
    let space = landmarks(7, 2);
    let pairs: Vec<[usize; 2]> = case["pairs"]
        .as_array()
        .unwrap()
        .iter()
        .map(|pair| [pair[0].as_u64().unwrap() as usize, pair[1].as_u64().unwrap() as usize])
        .collect();
    let relabelling = Relabelling::new(&space, &pairs).unwrap();
    assert_eq!(relabelling.fixed(), Some(1));
    let (shapes, results) = (case["shapes"].as_array().unwrap(), case["results"].as_array().unwrap());
    for (points, wanted) in shapes.iter().zip(results) {
        let x = centred(points);
        let mut image = x.clone();
        image.chunks_exact_mut(7).for_each(|column| relabelling.relabel(column));
        is_plane(&best_plane(&x, &image, 2).unwrap(), wanted);
    }
}

#[test]
fn planes_of_curves_without_markings_are_those_of_the_vectors() {
    let vectors = load("symmetry.json");
    for name in ["curve", "noisy_curve"] {
        let x = centred(&vectors[name]["points"]);
        let wanted = &vectors[name]["result"];
        let found = planes_of_curve(&x, 2).unwrap();
        assert_eq!(found[0].shift as u64, wanted["shift"].as_u64().unwrap(), "{found:?}");
        is_plane(&found[0].plane, wanted);
        // Another start moves the shift by twice as much, the other direction turns it round: the axis stays.
        let turned = |start: usize, back: bool| -> Vec<f64> {
            let of = |n: usize| (if back { 96 + start - n } else { start + n }) % 48;
            x.chunks_exact(48).flat_map(|column| (0..48).map(move |n| column[of(n)])).collect()
        };
        for (start, back) in [(5, false), (31, false), (0, true), (17, true)] {
            let other = planes_of_curve(&turned(start, back), 2).unwrap();
            assert_eq!(other.len(), found.len());
            assert!(
                (other[0].plane.axis_degrees.unwrap() - found[0].plane.axis_degrees.unwrap()).abs() < 1e-9
            );
            assert!((other[0].plane.asymmetry - found[0].plane.asymmetry).abs() < 1e-14);
        }
        // In space: the same curve with a third coordinate of zero has the same plane, or that in which it lies.
        let flat: Vec<f64> = x.iter().copied().chain((0..48).map(|_| 0.0)).collect();
        let other = planes_of_curve(&flat, 3).unwrap();
        assert_eq!((other[0].shift, other[0].plane.axis_degrees), (found[0].shift, None));
        assert!((other[0].plane.correlation - found[0].plane.correlation).abs() < 1e-12);
    }
}

#[test]
fn a_square_has_four_axes_and_a_circle_one_of_many() {
    let square: Vec<[f64; 2]> = (0..40)
        .map(|n| {
            let (side, along) = (n / 10, (n % 10) as f64 / 5.0 - 1.0);
            [[along, -1.0], [1.0, along], [-along, 1.0], [-1.0, -along]][side]
        })
        .collect();
    let x = |c: usize| square.iter().map(move |point| point[c]);
    let found = planes_of_curve(&x(0).chain(x(1)).collect::<Vec<_>>(), 2).unwrap();
    let mut axes: Vec<f64> =
        found.iter().map(|plane| plane.plane.axis_degrees.unwrap().round() % 180.0).collect();
    axes.sort_by(f64::total_cmp);
    assert_eq!(axes, [0.0, 45.0, 90.0, 135.0]);
    assert!(found.iter().all(|plane| plane.plane.asymmetry < 1e-14));
    assert!(found.windows(2).all(|two| two[0].shift < two[1].shift), "ties by the smallest shift: {found:?}");
    // Of a circle any axis is as good as another.
    let t = |n: usize| std::f64::consts::TAU * n as f64 / 30.0;
    let circle: Vec<f64> = (0..30).map(|n| t(n).cos()).chain((0..30).map(|n| t(n).sin())).collect();
    let found = planes_of_curve(&circle, 2).unwrap();
    assert!((found.len(), found[0].shift) == (1, 0) && found[0].plane.asymmetry < 1e-14, "{found:?}");
    assert_eq!(planes_of_curve(&[0.0; 60], 2).map(|_| ()), Err(SymmetryError::NoExtent));
}

#[test]
fn planes_in_space_have_the_normal_of_the_mirror() {
    // Three pairs and a point of the plane with normal (1, 2, 2)/3, which is symmetric but for one point.
    let (n, space) = ([1.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0], landmarks(7, 3));
    let point = |k: usize| [(k * k) as f64 * 0.3 + 1.0, (k as f64).cos(), (2.0 * k as f64).sin() + 0.2];
    let mirror = |p: [f64; 3]| {
        let along: f64 = (0..3).map(|c| n[c] * p[c]).sum();
        [0, 1, 2].map(|c| p[c] - 2.0 * n[c] * along)
    };
    let mut points: Vec<[f64; 3]> = (0..3).flat_map(|k| [point(k), mirror(point(k))]).collect();
    points.push([2.0, -1.0, 0.0]);
    let x = centred(&serde_json::json!(points));
    let relabelling = Relabelling::new(&space, &[[0, 1], [2, 3], [4, 5]]).unwrap();
    let mut image = x.clone();
    image.chunks_exact_mut(7).for_each(|column| relabelling.relabel(column));
    let found = best_plane(&x, &image, 3).unwrap();
    assert!(found.asymmetry < 1e-15, "{found:?}");
    for (a, b) in found.normal.iter().zip(n) {
        assert!((a - b).abs() < 1e-14, "{found:?}");
    }
}

/// Aligns shapes, and tells their symmetry.
fn study(
    space: &ShapeSpace,
    (control_points, count): (Vec<f64>, usize),
    correspondence: Correspondence,
    class: ClassName,
    question: &dyn Fn(&AlignedShapes<'_>) -> SymmetryRecord,
) -> SymmetryRecord {
    let (metric, class) = (Metric::of(space), Transformation::Named(class));
    let dimension = metric.dimension();
    let kind = if dimension == 2 { Alignment::Projection } else { Alignment::PartialProcrustes };
    let method = Method::new(&class, kind, dimension).unwrap();
    let matching = Matching::new(space, correspondence, Direction::Given, Mirror::Forbid);
    let space = StudySpace {
        space,
        metric: &metric,
        method: &method,
        tangent: true,
        frame: frame_for(&class),
        matching: &matching,
    };
    question(&AlignedShapes::new(space, control_points, vec![1.0; count], &Unwatched).unwrap())
}

/// Shapes and their images as individuals of object symmetry, `replicates` of each.
fn object(
    space: &ShapeSpace,
    pairs: &[[usize; 2]],
    shapes: &[Vec<f64>],
    replicates: usize,
    correspondence: Correspondence,
) -> SymmetryRecord {
    let relabelling = Relabelling::new(space, pairs).unwrap();
    let images = shapes.iter().map(|shape| {
        let mut image = shape.clone();
        relabelling.image(&mut image);
        image
    });
    let both: Vec<f64> = shapes.iter().cloned().chain(images).flatten().collect();
    let count = shapes.len();
    let names: Vec<String> = (0..count / replicates).map(|i| format!("i{i}")).collect();
    let individual: Vec<usize> = (0..2 * count).map(|k| k % count / replicates).collect();
    let side: Vec<usize> = (0..2 * count).map(|k| k / count).collect();
    let measured: Vec<usize> = (0..2 * count).map(|k| k % count).collect();
    study(space, (both, 2 * count), correspondence, ClassName::Similarity, &|aligned| {
        let question = SymmetryQuestion {
            kind: SymmetryKind::Object,
            sides: Sides { names: &names, individual: &individual, side: &side, measured: Some(&measured) },
            relabelling: Some(&relabelling),
            transformation: &Transformation::Named(ClassName::Similarity),
            testing: SymmetryTesting { permutations: 199, ..SymmetryTesting::default() },
            samples: 20,
            maps: true,
        };
        symmetry(aligned, &question, &Unwatched).unwrap()
    })
}

fn noise(i: usize, k: usize) -> f64 {
    ((13 * i * i + 7 * k * k + 3 * i * k + 5) as f64).sin()
}

/// Faces of four pairs and two points of the midline, turned and moved: `bend` moves the left side alone, `scatter` all points.
fn face(k: usize, bend: f64, scatter: f64) -> Vec<f64> {
    let half = [[1.0, 0.0], [1.5, 1.0], [0.8, 2.0], [0.4, 2.6]];
    let mut points: Vec<[f64; 2]> = half
        .iter()
        .enumerate()
        .flat_map(|(i, [x, y])| {
            let own = 0.1 * noise(i, k);
            [[-x - own - if i == 1 { bend } else { 0.0 }, y + own], [x + own, y + own]]
        })
        .chain([[0.0, -0.3], [0.0, 3.0 + 0.1 * noise(9, k)]])
        .collect();
    for (i, point) in points.iter_mut().enumerate() {
        point[0] += scatter * noise(i + 20, k);
        point[1] += scatter * noise(i + 40, k);
    }
    let (sine, cosine) = (k as f64).sin_cos();
    let turned = points.iter().map(|[x, y]| [cosine * x - sine * y + 3.0, sine * x + cosine * y - k as f64]);
    let turned: Vec<[f64; 2]> = turned.collect();
    (0..2).flat_map(|c| turned.iter().map(move |point| point[c])).collect()
}

const PAIRS: [[usize; 2]; 4] = [[0, 1], [2, 3], [4, 5], [6, 7]];

#[test]
fn symmetric_faces_have_no_asymmetry_and_bent_ones_have_it_where_they_are_bent() {
    let space = landmarks(10, 2);
    let still: Vec<Vec<f64>> = (0..8).map(|k| face(k, 0.0, 0.0)).collect();
    let found = object(&space, &PAIRS, &still, 1, Correspondence::Landmarks);
    for own in &found.individuals {
        assert!(own.unsigned < 1e-13 && own.fluctuating < 1e-13, "{own:?}");
        assert!(own.unsigned_corrected.is_none(), "no replicates");
    }
    assert!(found.table.residual.is_none() && found.plane.as_ref().unwrap().asymmetry < 1e-14);
    let bent: Vec<Vec<f64>> = (0..8).map(|k| face(k, 0.3, 0.01)).collect();
    let found = object(&space, &PAIRS, &bent, 1, Correspondence::Landmarks);
    let side = &found.table.terms[1];
    // 2⁷ signs of the differences, with those of all turned round.
    assert!(side.row.exact == (side.row.permutations < 199) && side.row.p.unwrap() < 0.02, "{side:?}");
    // Four pairs and two points: eight symmetric and eight asymmetric dimensions.
    let shapes: Vec<_> = found.table.terms.iter().map(|term| term.df_shape.unwrap()).collect();
    assert_eq!(shapes, [7 * 8, 8, 7 * 8]);
    let place = |point: &f64| found.map.iter().position(|other| other.directional == *point).unwrap();
    let largest = found.map.iter().map(|point| point.directional).fold(0.0, f64::max);
    assert!([2, 3].contains(&place(&largest)), "{:?}", found.map);
    assert!((found.map[2].directional - found.map[3].directional).abs() < 1e-12, "both of a pair");
    assert!(found.individuals.iter().all(|own| own.signed.unwrap() > 0.5 * found.directional.norm));
    assert_eq!(found.individuals[3].map.as_ref().unwrap().len(), 10);
    assert!(found.plane.unwrap().asymmetry < 1e-14, "the mean of shapes and images is symmetric");
}

#[test]
fn replicates_test_the_interaction_and_correct_the_indices() {
    let space = landmarks(10, 2);
    // Six individuals that differ in their bend, measured three times.
    let shapes: Vec<Vec<f64>> = (0..18)
        .map(|k| {
            let mut shape = face(k / 3, 0.2 * noise(3, k / 3), 0.0);
            shape.iter_mut().enumerate().for_each(|(i, x)| *x += 0.01 * noise(i, 100 + k));
            shape
        })
        .collect();
    let found = object(&space, &PAIRS, &shapes, 3, Correspondence::Landmarks);
    let interaction = &found.table.terms[2].row;
    assert!(interaction.p.unwrap() <= 0.02 && interaction.f.unwrap() > 5.0, "{interaction:?}");
    assert_eq!((interaction.degrees, found.table.residual.as_ref().unwrap().degrees), (5, 24));
    assert_eq!(found.table.residual_df_shape, Some(12 * 16));
    for own in &found.individuals {
        let (corrected, unsigned) = (own.unsigned_corrected.unwrap(), own.unsigned);
        assert!(corrected < unsigned && corrected > 0.5 * unsigned, "{own:?}");
    }
    // In any order of the shapes: the same numbers for each individual.
    let order: Vec<usize> = (0..18).map(|k| (k / 3 + 2) % 6 * 3 + (k + 1) % 3).collect();
    let other: Vec<Vec<f64>> = order.iter().map(|&k| shapes[k].clone()).collect();
    let other = object(&space, &PAIRS, &other, 3, Correspondence::Landmarks);
    for (i, own) in other.individuals.iter().enumerate() {
        close(own.unsigned, found.individuals[(i + 2) % 6].unsigned, 1e-9, "unsigned");
    }
    for (one, two) in other.table.terms.iter().zip(&found.table.terms) {
        close(one.row.sum_of_squares, two.row.sum_of_squares, 1e-9, "SS");
    }
}

#[test]
fn closed_curves_and_surfaces_are_their_own_images() {
    let generator = GeneratorKind::Bspline { degree: 3 };
    let space = ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points: 24, generator })
        .unwrap();
    // Drops that are symmetric about a line through their start, started elsewhere and turned.
    let drop = |k: usize, bend: f64| -> Vec<f64> {
        let (sine, cosine) = (0.7 * k as f64).sin_cos();
        let point = |i: usize| {
            let t = std::f64::consts::TAU * ((i + 5 * k) % 24) as f64 / 24.0;
            let x = 2.0 * t.cos() + 0.4 * (2.0 * t).cos() + 0.1 * k as f64 * (3.0 * t).cos();
            let y = t.sin() + bend * (2.0 * t).cos();
            [cosine * x - sine * y, sine * x + cosine * y + k as f64]
        };
        (0..2).flat_map(|c| (0..24).map(move |i| point(i)[c])).collect()
    };
    let straight: Vec<Vec<f64>> = (0..5).map(|k| drop(k, 0.0)).collect();
    let found = object(&space, &[], &straight, 1, Correspondence::Cyclic);
    assert!(found.individuals.iter().all(|own| own.unsigned < 1e-12), "{:?}", found.individuals);
    let bent: Vec<Vec<f64>> = (0..5).map(|k| drop(k, 0.1)).collect();
    let found = object(&space, &[], &bent, 1, Correspondence::Cyclic);
    assert!(found.individuals.iter().all(|own| own.unsigned > 0.01), "{:?}", found.individuals);
    assert_eq!(found.map.len(), 20);
    // Shapes and images have one mean, which is symmetric about some start.
    assert!(found.plane.as_ref().unwrap().asymmetry < 1e-14, "{:?}", found.plane);
    assert_eq!(found.table.terms[1].df_shape, Some(22));
    let surface = Representation::Surface {
        topology: Topology::Cylinder,
        seam: Default::default(),
        control_points: [8, 4],
        generators: [GeneratorKind::Bspline { degree: 3 }, GeneratorKind::Bspline { degree: 3 }],
    };
    let space = ShapeSpace::new(&surface).unwrap();
    let size = surface.size();
    let rows = size / 8;
    // A bent tube that is its own image under y → −y and u → −u.
    let tube = |k: usize| -> Vec<f64> {
        let point = |i: usize| {
            let (t, v) = (std::f64::consts::TAU * (i / rows) as f64 / 8.0, (i % rows) as f64);
            [(1.0 + 0.1 * k as f64) * t.cos() + 0.1 * v * v, t.sin() * (1.0 + 0.05 * v), v]
        };
        (0..3).flat_map(|c| (0..size).map(move |i| point(i)[c])).collect()
    };
    let tubes: Vec<Vec<f64>> = (0..4).map(tube).collect();
    let found = object(&space, &[], &tubes, 1, Correspondence::Landmarks);
    assert!(found.individuals.iter().all(|own| own.unsigned < 1e-9), "{:?}", found.individuals);
    assert!(found.plane.unwrap().normal.len() == 3 && found.table.terms[0].df_shape.is_some());
}

#[test]
fn left_and_mirrored_right_shapes_that_are_equal_have_no_asymmetry() {
    let space = landmarks(10, 2);
    let left: Vec<Vec<f64>> = (0..5).map(|k| face(k, 0.4 + 0.1 * noise(1, k), 0.05)).collect();
    let right = left.iter().map(|shape| {
        let mut mirror = shape.clone();
        mirrored(&space, Correspondence::Landmarks, &mut mirror);
        mirror
    });
    // What arrives are right shapes as they were seen: mirrored once more.
    let arrived: Vec<f64> = left
        .iter()
        .cloned()
        .chain(right.map(|mut shape| {
            mirrored(&space, Correspondence::Landmarks, &mut shape);
            shape
        }))
        .flatten()
        .collect();
    let names: Vec<String> = (0..5).map(|i| i.to_string()).collect();
    let individual: Vec<usize> = (0..10).map(|k| k % 5).collect();
    let side: Vec<usize> = (0..10).map(|k| k / 5).collect();
    let class = Transformation::Named(ClassName::Similarity);
    let found = study(&space, (arrived, 10), Correspondence::Landmarks, ClassName::Similarity, &|aligned| {
        let question = SymmetryQuestion {
            kind: SymmetryKind::Matching,
            sides: Sides { names: &names, individual: &individual, side: &side, measured: None },
            relabelling: None,
            transformation: &class,
            testing: SymmetryTesting { permutations: 99, ..SymmetryTesting::default() },
            samples: 10,
            maps: false,
        };
        symmetry(aligned, &question, &Unwatched).unwrap()
    });
    assert!(found.individuals.iter().all(|own| own.unsigned < 1e-13), "{:?}", found.individuals);
    assert_eq!(found.table.terms[0].df_shape, Some(4 * 16));
    assert!(found.plane.is_none() && found.individuals[0].map.is_none());
}

#[test]
fn what_has_no_sides_is_refused() {
    let space = landmarks(4, 2);
    let refused = |pairs: &[[usize; 2]]| Relabelling::new(&space, pairs).map(|_| ()).unwrap_err();
    assert_eq!(refused(&[]), SymmetryError::NoPairs);
    assert_eq!(refused(&[[0, 4]]), SymmetryError::Pair { position: 0, pair: [0, 4], size: 4 });
    assert_eq!(refused(&[[0, 1], [1, 2]]), SymmetryError::Pair { position: 1, pair: [1, 2], size: 4 });
    assert_eq!(refused(&[[3, 3]]), SymmetryError::Pair { position: 0, pair: [3, 3], size: 4 });
    let generator = GeneratorKind::Bspline { degree: 3 };
    let curve =
        ShapeSpace::new(&Representation::ClosedCurve { dimension: 2, control_points: 8, generator }).unwrap();
    let pairs = Relabelling::new(&curve, &[[0, 1]]).map(|_| ()).unwrap_err();
    assert_eq!(pairs, SymmetryError::PairsOfCurve { found: 1 });
    let vectors = Matrix::from_fn(2, 5, |i, k| (i * k) as f64);
    let names = ["a".to_owned(), "b".to_owned(), "c".to_owned()];
    let sides =
        |side: &'static [usize]| Sides { names: &names, individual: &[0, 0, 1, 1, 2], side, measured: None };
    let found = Averages::new(&vectors, &[1.0; 5], &sides(&[0, 1, 0, 1, 1])).map(|_| ());
    assert_eq!(found, Err(SymmetryError::OneSided { name: "c".into() }));
    let few = Sides { names: &names[..2], ..sides(&[0, 1, 0, 1, 1]) };
    let found = Averages::new(&vectors, &[1.0; 5], &few).map(|_| ());
    assert_eq!(found, Err(SymmetryError::FewIndividuals { found: 2 }));
}
