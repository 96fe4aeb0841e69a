//! Laws of the distances: against slow definitions, under the class, under everything that is searched.

use proptest::prelude::*;
use shapelex_analysis::alignment::{Alignment, Method};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::distance::DistanceSpace;
use shapelex_analysis::fit::Scaling;
use shapelex_analysis::fit::{Fit, transform};
use shapelex_analysis::matching::{Matching, Placement};
use shapelex_analysis::metric::{Metric, norm};
use shapelex_analysis::neighbours::NeighbourSearch;
use shapelex_analysis::transformation::{ClassName, CustomClass, Transformation, TransformationClass};
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_geometry::surface::Topology;
use shapelex_geometry::surface::seam::Seam;
use shapelex_numeric::dense::Matrix;

/// Rows of a shape: neither even nor a power of two.
const N: usize = 15;
/// Distances of equal shapes are rounding of this size: the root of that of a square.
const ROOT: f64 = 1e-7;

/// Deterministic pseudo-random numbers in [−1, 1] from a seed that proptest shrinks.
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 11) as f64 / (1u64 << 53) as f64) * 2.0 - 1.0
    }
}

/// Centred whitened shapes of no symmetry, `d·N` numbers each.
fn shapes(seed: u64, count: usize, d: usize) -> Vec<Vec<f64>> {
    let mut random = Noise(seed);
    let coordinate = |random: &mut Noise, c: usize| {
        let phase = 0.4 * random.next();
        let wave = |k: usize| {
            let t = std::f64::consts::TAU * k as f64 / N as f64;
            (1.0 + c as f64) * (t + 1.3 * c as f64 + phase).cos() + 0.5 * (2.0 * t + c as f64).sin()
        };
        let values: Vec<f64> = (0..N).map(|k| wave(k) + 0.3 * random.next()).collect();
        let mean = values.iter().sum::<f64>() / N as f64;
        values.into_iter().map(move |value| value - mean)
    };
    (0..count).map(|_| (0..d).flat_map(|c| coordinate(&mut random, c)).collect()).collect()
}

fn matching(d: usize, correspondence: Correspondence, direction: Direction, mirror: Mirror) -> Matching {
    let generator = GeneratorKind::Trigonometric {};
    let representation = Representation::ClosedCurve { dimension: d, control_points: N, generator };
    Matching::new(&ShapeSpace::new(&representation).unwrap(), correspondence, direction, mirror)
}

fn plain(d: usize) -> Matching {
    matching(d, Correspondence::Landmarks, Direction::Given, Mirror::Forbid)
}

fn projection(name: ClassName, d: usize) -> Method {
    Method::new(&Transformation::Named(name), Alignment::Projection, d).unwrap()
}

fn procrustes(name: ClassName, d: usize) -> Method {
    Method::new(&Transformation::Named(name), Alignment::Procrustes, d).unwrap()
}

fn matrix(method: &Method, matching: &Matching, shapes: &[Vec<f64>]) -> Vec<f64> {
    let space = DistanceSpace::new(method, matching).unwrap();
    space.matrix(&space.prepare(&shapes.concat()).unwrap(), &|_| true).unwrap()
}

fn distance(method: &Method, matching: &Matching, x: &[f64], y: &[f64]) -> f64 {
    matrix(method, matching, &[x.to_vec(), y.to_vec()])[1]
}

/// `√(1 − ‖Q₁ᵀQ₂‖²/I)` by dense bases of everything.
fn slow_chordal(class: &TransformationClass, x: &[f64], y: &[f64]) -> f64 {
    let basis = |x: &[f64]| {
        let columns = class.matrices().iter().flat_map(|b| transform(b, x)).collect();
        Matrix::from_vec(x.len(), class.matrices().len(), columns).qr().q()
    };
    let squares = basis(x).tr_mul(&basis(y)).norm_squared();
    (1.0 - squares / class.matrices().len() as f64).max(0.0).sqrt()
}

/// What is left of `x` after the best fit of `y`, relative to `x` when the fit scales.
fn slow_residual(fit: Fit, x: &[f64], y: &[f64]) -> f64 {
    let fitted = transform(&fit.matrix(y, x), y);
    let difference: Vec<f64> = x.iter().zip(fitted).map(|(x, y)| x - y).collect();
    norm(&difference) / if fit.scaling == Scaling::Full { norm(x) } else { 1.0 }
}

fn slow(method: &Method, x: &[f64], y: &[f64]) -> f64 {
    match method {
        Method::Projection(class) => slow_chordal(class, x, y),
        Method::Procrustes(fit) => slow_residual(*fit, x, y),
    }
}

/// Every method there is in dimension `d`.
fn methods(d: usize) -> Vec<Method> {
    let named = ClassName::ALL.into_iter().filter(|name| name.projection_dimensions().contains(&d));
    let fits = [ClassName::Similarity, ClassName::Rigid].map(|name| procrustes(name, d));
    named.map(|name| projection(name, d)).chain(fits).collect()
}

/// All placements that a cyclic search tries, mirrored ones traversed backwards in the plane.
fn placements(d: usize) -> impl Iterator<Item = Placement> {
    let placement = move |mirrored: bool, reversed: bool, shift: u32| Placement {
        shift,
        mirrored,
        reversed: if d == 2 { mirrored } else { reversed },
    };
    let both = [false, true];
    both.into_iter().flat_map(move |mirrored| {
        both.into_iter()
            .flat_map(move |reversed| (0..N as u32).map(move |shift| placement(mirrored, reversed, shift)))
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn distances_are_what_their_definitions_say(seed in any::<u64>(), d in 2usize..=3) {
        let shapes = shapes(seed, 2, d);
        for method in methods(d) {
            let (found, wanted) =
                (distance(&method, &plain(d), &shapes[0], &shapes[1]), slow(&method, &shapes[0], &shapes[1]));
            prop_assert!((found - wanted).abs() < 1e-10, "{method:?}: {found} for {wanted}");
        }
    }

    #[test]
    fn searches_find_the_least_of_all_placements(seed in any::<u64>(), d in 2usize..=3) {
        let shapes = shapes(seed, 2, d);
        let searched = matching(d, Correspondence::Cyclic, Direction::Either, Mirror::Allow);
        for method in methods(d) {
            let wanted = placements(d)
                .map(|placement| slow(&method, &shapes[0], &searched.place(&shapes[1], placement)))
                .fold(f64::MAX, f64::min);
            let found = distance(&method, &searched, &shapes[0], &shapes[1]);
            prop_assert!((found - wanted).abs() < 1e-9, "{method:?}: {found} for {wanted}");
        }
    }

    #[test]
    fn a_row_agrees_with_the_matrix_and_its_placement_has_the_distance(seed in any::<u64>(), d in 2usize..=3) {
        let shapes = shapes(seed, 5, d);
        for correspondence in [Correspondence::Landmarks, Correspondence::Cyclic] {
            let searched = matching(d, correspondence, Direction::Either, Mirror::Allow);
            for method in methods(d) {
                let space = DistanceSpace::new(&method, &searched).unwrap();
                let prepared = space.prepare(&shapes.concat()).unwrap();
                let row = space.compare(&prepared, 1, &prepared);
                let matrix = matrix(&method, &searched, &shapes);
                // Under rigid motions distances are lengths.
                let rounding = ROOT * (1.0 + 2.0 * norm(&shapes[1]));
                for (k, found) in row.iter().enumerate() {
                    prop_assert!((found.distance - matrix[5 + k]).abs() < rounding);
                    let placed = slow(&method, &shapes[1], &searched.place(&shapes[k], found.placement));
                    prop_assert!((found.distance - placed).abs() < rounding, "{method:?} {found:?} {placed}");
                }
            }
        }
    }

    #[test]
    fn nothing_that_is_removed_or_searched_changes_a_distance(seed in any::<u64>(), shift in 0..N as u32) {
        let mut random = Noise(seed ^ 1);
        let shapes = shapes(seed, 2, 2);
        let searched = matching(2, Correspondence::Cyclic, Direction::Either, Mirror::Allow);
        for name in [ClassName::Similarity, ClassName::Affine, ClassName::NonUniformScalingTranslation,
            ClassName::HorizontalShearTranslation] {
            let method = projection(name, 2);
            let Method::Projection(class) = &method else { unreachable!() };
            let matrix = loop {
                let sum = class.matrices().iter().map(|b| b * random.next()).sum::<Matrix>();
                let singular = sum.singular_values();
                if singular.min() > 0.3 * singular.max() && singular.max() > 0.1 {
                    break sum;
                }
            };
            let moved = transform(&matrix, &shapes[1]);
            let before = distance(&method, &searched, &shapes[0], &shapes[1]);
            for mirrored in [false, true] {
                let placement = Placement { shift, mirrored, reversed: mirrored };
                let placed = searched.place(&moved, placement);
                let after = distance(&method, &searched, &shapes[0], &placed);
                prop_assert!((before - after).abs() < ROOT, "{name:?}: {before} {after}");
                let same = distance(&method, &searched, &shapes[1], &placed);
                prop_assert!(same < ROOT, "{name:?}: {same}");
            }
        }
    }

    #[test]
    fn chordal_distances_obey_the_triangle(seed in any::<u64>(), d in 2usize..=3) {
        let shapes = shapes(seed, 6, d);
        for correspondence in [Correspondence::Landmarks, Correspondence::Cyclic] {
            let searched = matching(d, correspondence, Direction::Given, Mirror::Forbid);
            for method in methods(d) {
                let m = matrix(&method, &searched, &shapes);
                for (i, j, k) in (0..6).flat_map(|i| (0..6).flat_map(move |j| (0..6).map(move |k| (i, j, k)))) {
                    prop_assert!(m[i * 6 + k] <= m[i * 6 + j] + m[j * 6 + k] + ROOT, "{method:?} {i} {j} {k}");
                }
            }
        }
    }

    #[test]
    fn chordal_is_full_procrustes_for_similarities_of_the_plane(seed in any::<u64>()) {
        let shapes = shapes(seed, 4, 2);
        for mirror in [Mirror::Forbid, Mirror::Allow] {
            let searched = matching(2, Correspondence::Cyclic, Direction::Given, mirror);
            let chordal = matrix(&projection(ClassName::Similarity, 2), &searched, &shapes);
            let full = matrix(&procrustes(ClassName::Similarity, 2), &searched, &shapes);
            prop_assert!(chordal.iter().zip(&full).all(|(a, b)| (a - b).abs() < 1e-10), "{chordal:?} {full:?}");
        }
    }
}

#[test]
fn matrices_are_symmetric_and_have_the_same_bits_on_any_number_of_threads() {
    // More than a tile of either kind.
    for (d, count) in [(2, 150), (3, 90)] {
        let shapes = shapes(5, count, d);
        for correspondence in [Correspondence::Landmarks, Correspondence::Cyclic] {
            let searched = matching(d, correspondence, Direction::Either, Mirror::Allow);
            let names = [ClassName::Affine, ClassName::Translation];
            let methods = names.map(|name| projection(name, d)).into_iter();
            for method in methods.chain([procrustes(ClassName::Rigid, d)]) {
                let run = |threads: usize| {
                    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                    pool.install(|| matrix(&method, &searched, &shapes))
                };
                let one = run(1);
                assert_eq!(one, run(3), "{method:?}");
                for i in 0..count {
                    assert_eq!(one[i * count + i], 0.0);
                    assert!(
                        (0..i).all(|j| one[i * count + j] == one[j * count + i] && one[i * count + j] > 0.0)
                    );
                }
            }
        }
    }
}

#[test]
fn a_matrix_can_be_interrupted_and_says_how_far_it_is() {
    let shapes = shapes(3, 100, 2).concat();
    let searched = matching(2, Correspondence::Cyclic, Direction::Given, Mirror::Forbid);
    let space = DistanceSpace::new(&projection(ClassName::Similarity, 2), &searched).unwrap();
    let prepared = space.prepare(&shapes).unwrap();
    let parts = std::sync::Mutex::new(Vec::new());
    let go_on = |part: f64| {
        parts.lock().unwrap().push(part);
        part < 0.5
    };
    assert!(space.matrix(&prepared, &go_on).is_err());
    assert!(parts.into_inner().unwrap().iter().all(|part| (0.0..1.0).contains(part)));
}

#[test]
fn mirrors_of_a_class_that_has_none_are_refused() {
    let matrices = vec![vec![vec![1.0, 1.0], vec![0.0, 1.0]]];
    let custom = Transformation::Custom(CustomClass { matrices, translation: true });
    let method = Method::new(&custom, Alignment::Projection, 2).unwrap();
    let allow = matching(2, Correspondence::Cyclic, Direction::Given, Mirror::Allow);
    assert!(DistanceSpace::new(&method, &allow).unwrap_err().to_string().contains("mirror"));
    assert!(DistanceSpace::new(&method, &plain(2)).is_ok());
    for method in methods(2) {
        assert!(DistanceSpace::new(&method, &allow).is_ok(), "{method:?}");
    }
}

#[test]
fn degenerate_shapes_are_named_by_their_position() {
    let mut shapes = shapes(9, 70, 2);
    for bad in [41, 66] {
        let x: Vec<f64> = shapes[bad][..N].to_vec();
        shapes[bad] = [x.clone(), x].concat();
    }
    let space = DistanceSpace::new(&projection(ClassName::Affine, 2), &plain(2)).unwrap();
    assert_eq!(space.prepare(&shapes.concat()).unwrap_err().position(), Some(41));
}

#[test]
fn a_search_over_batches_finds_the_nearest_of_all() {
    let shapes = shapes(3, 40, 2);
    let space = DistanceSpace::new(&projection(ClassName::Similarity, 2), &plain(2)).unwrap();
    let queries = space.prepare(&shapes[..2].concat()).unwrap();
    let mut search = NeighbourSearch::new(&space, queries.clone(), 5);
    for shapes in shapes.chunks(16) {
        search.offer(&space.prepare(&shapes.concat()).unwrap(), &|| false).unwrap();
    }
    assert_eq!(search.queries(), 2);
    let all = space.prepare(&shapes.concat()).unwrap();
    for (query, found) in search.into_sorted().into_iter().enumerate() {
        let row = space.compare(&queries, query, &all);
        let mut wanted: Vec<usize> = (0..40).collect();
        wanted.sort_by(|&a, &b| row[a].distance.total_cmp(&row[b].distance));
        assert_eq!(found.iter().map(|neighbour| neighbour.position).collect::<Vec<_>>(), wanted[..5]);
    }
    let mut stopped = NeighbourSearch::new(&space, queries, 5);
    assert!(stopped.offer(&all, &|| true).is_err());
}

/// Half of them close to the first; copies at other start points; of all sizes.
fn crowd(count: usize, d: usize) -> Vec<Vec<f64>> {
    let mut all = shapes(77, count, d);
    let first = all[0].clone();
    for k in (2..count).step_by(2) {
        let part = 0.001 * k as f64;
        all[k].iter_mut().zip(&first).for_each(|(x, first)| *x = first + part * (*x - first));
    }
    for k in (10..count).step_by(10) {
        let turned = all[k - 1].chunks_exact(N).flat_map(|c| c[k % N..].iter().chain(&c[..k % N]).copied());
        all[k] = turned.collect();
    }
    for (k, shape) in all.iter_mut().enumerate().skip(3).step_by(7) {
        let factor = if k % 2 == 0 { 1e60 } else { 1e-60 };
        shape.iter_mut().for_each(|x| *x *= factor);
    }
    all
}

#[test]
fn bounds_exclude_no_neighbour() {
    let mut compared = 0;
    for d in [2, 3] {
        let shapes = crowd(300, d);
        for (direction, mirror) in [(Direction::Given, Mirror::Forbid), (Direction::Either, Mirror::Allow)] {
            let matching = matching(d, Correspondence::Cyclic, direction, mirror);
            for method in methods(d) {
                let space = DistanceSpace::new(&method, &matching).unwrap();
                let all = space.prepare(&shapes.concat()).unwrap();
                let queries = space.prepare(&shapes[..16].concat()).unwrap();
                for most in [1, 4] {
                    let mut search = NeighbourSearch::new(&space, queries.clone(), most);
                    for shapes in shapes.chunks(160) {
                        search.offer(&space.prepare(&shapes.concat()).unwrap(), &|| false).unwrap();
                    }
                    for (query, found) in search.into_sorted().into_iter().enumerate() {
                        let row = space.compare(&queries, query, &all);
                        let mut wanted: Vec<usize> = (0..300).collect();
                        wanted.sort_by(|&a, &b| row[a].distance.total_cmp(&row[b].distance).then(a.cmp(&b)));
                        for (found, wanted) in found.into_iter().zip(wanted) {
                            assert_eq!(
                                (found.position, found.found),
                                (wanted, row[wanted]),
                                "{method:?}, {query}"
                            );
                            compared += 1;
                        }
                    }
                }
            }
        }
    }
    assert!(compared > 1000);
}

/// `‖Q₂ − Q₁Q₁ᵀQ₂‖/√I` by dense bases of everything: the chordal distance without a difference of numbers near 1.
fn slow_chordal_of_close(class: &TransformationClass, x: &[f64], y: &[f64]) -> f64 {
    let basis = |x: &[f64]| {
        let columns = class.matrices().iter().flat_map(|b| transform(b, x)).collect();
        Matrix::from_vec(x.len(), class.matrices().len(), columns).qr().q()
    };
    let (one, other) = (basis(x), basis(y));
    let left = &other - &one * one.tr_mul(&other);
    (left.norm_squared() / class.matrices().len() as f64).sqrt()
}

fn slow_of_close(method: &Method, x: &[f64], y: &[f64]) -> f64 {
    match method {
        Method::Projection(class) => slow_chordal_of_close(class, x, y),
        Method::Procrustes(fit) => slow_residual(*fit, x, y),
    }
}

/// Every search that there is, and whether it tries start points.
fn searches(d: usize) -> [(Matching, bool); 4] {
    [
        (plain(d), false),
        (matching(d, Correspondence::Landmarks, Direction::Either, Mirror::Allow), false),
        (matching(d, Correspondence::Cyclic, Direction::Given, Mirror::Forbid), true),
        (matching(d, Correspondence::Cyclic, Direction::Either, Mirror::Allow), true),
    ]
}

#[test]
fn identical_shapes_have_the_distance_zero() {
    for d in [2, 3] {
        let mut all = shapes(21, 5, d);
        // A polygon that is nearly regular: many start points are nearly equal.
        let wave = |k: usize, c: usize| {
            let t = std::f64::consts::TAU * k as f64 / N as f64;
            if c == 2 { (2.0 * t).cos() } else { (t - 1.5 * c as f64).cos() }
        };
        all.push(
            (0..d).flat_map(|c| (0..N).map(move |k| wave(k, c) * (1.0 + 1e-7 * (k * c) as f64))).collect(),
        );
        let count = all.len();
        for (searched, cyclic) in searches(d) {
            let moved = all.iter().enumerate().map(|(k, x)| {
                let shift = if cyclic { k as u32 } else { 0 };
                searched.place(x, Placement { shift, ..Placement::default() }).into_owned()
            });
            let both: Vec<Vec<f64>> = all.iter().cloned().chain(all.iter().cloned()).chain(moved).collect();
            for method in methods(d) {
                let space = DistanceSpace::new(&method, &searched).unwrap();
                let prepared = space.prepare(&both.concat()).unwrap();
                let matrix = space.matrix(&prepared, &|_| true).unwrap();
                for k in 0..count {
                    let row = space.compare(&prepared, k, &prepared);
                    let mut search = NeighbourSearch::new(&space, space.prepare(&all[k]).unwrap(), 3);
                    search.offer(&prepared, &|| false).unwrap();
                    let nearest = search.into_sorted().remove(0);
                    assert_eq!(
                        nearest.iter().map(|found| found.position).collect::<Vec<_>>(),
                        [k, k + count, k + 2 * count]
                    );
                    for copy in [k, k + count, k + 2 * count] {
                        assert_eq!(row[copy].distance, 0.0, "{method:?} {k} {copy}");
                        assert_eq!(matrix[k * 3 * count + copy], 0.0, "{method:?} {k} {copy}");
                    }
                    assert!(
                        nearest.iter().all(|found| found.found.distance == 0.0),
                        "{method:?} {nearest:?}"
                    );
                    assert_eq!(row[k + count].placement, Placement::default(), "{method:?}");
                    assert!((0..count).filter(|&j| j != k).all(|j| row[j].distance > 0.0));
                }
            }
        }
    }
}

#[test]
fn copies_under_the_class_have_the_distance_zero() {
    for d in [2, 3] {
        let shape = shapes(4, 1, d).remove(0);
        let turn = if d == 2 {
            vec![0.6, -0.8, 0.8, 0.6]
        } else {
            vec![0.6, -0.8, 0.0, 0.8, 0.6, 0.0, 0.0, 0.0, 1.0]
        };
        let turned = transform(&Matrix::from_row_slice(d, d, &turn), &shape);
        for (searched, _) in searches(d) {
            let fits = [ClassName::Similarity, ClassName::Rigid].map(|name| procrustes(name, d));
            for method in fits.into_iter().chain([projection(ClassName::Affine, d)]) {
                assert_eq!(distance(&method, &searched, &shape, &turned), 0.0, "{method:?}");
            }
            if d == 2 {
                assert_eq!(distance(&projection(ClassName::Similarity, d), &searched, &shape, &turned), 0.0);
            }
        }
    }
}

#[test]
fn close_shapes_keep_their_digits() {
    for d in [2, 3] {
        let shape = shapes(8, 1, d).remove(0);
        for part in [1e-3, 1e-5, 1e-8, 1e-11] {
            let mut random = Noise(5);
            let mut near: Vec<f64> = shape.iter().map(|x| x + part * random.next()).collect();
            for coordinate in near.chunks_exact_mut(N) {
                let mean = coordinate.iter().sum::<f64>() / N as f64;
                coordinate.iter_mut().for_each(|x| *x -= mean);
            }
            for (searched, cyclic) in searches(d) {
                let shift = if cyclic { 4 } else { 0 };
                let placed = searched.place(&near, Placement { shift, ..Placement::default() });
                for method in methods(d) {
                    let wanted = slow_of_close(&method, &shape, &near);
                    let found = distance(&method, &searched, &shape, &placed);
                    // Rounding of the numbers themselves, and of products above 10⁻⁴ of the size.
                    let size = 1.0 + norm(&shape);
                    let tolerance = if wanted > 5e-5 { 1e-11 * size } else { 1e-14 * size + 1e-9 * wanted };
                    assert!(
                        (found - wanted).abs() <= tolerance,
                        "{method:?} {part:e}: {found:e} for {wanted:e}"
                    );
                }
            }
        }
    }
}

#[test]
fn lengths_scale_with_the_shapes() {
    for d in [2, 3] {
        let shapes = shapes(6, 3, d);
        for (searched, _) in searches(d) {
            for method in methods(d) {
                let wanted = matrix(&method, &searched, &shapes);
                let is_length = matches!(&method, Method::Procrustes(fit) if fit.scaling == Scaling::None);
                for factor in [1e-99, 1e-80, 1e-50, 1e50, 1e78, 1e99] {
                    let scaled: Vec<Vec<f64>> =
                        shapes.iter().map(|x| x.iter().map(|x| factor * x).collect()).collect();
                    let found = matrix(&method, &searched, &scaled);
                    let unit = if is_length { factor } else { 1.0 };
                    for (found, wanted) in found.iter().zip(&wanted) {
                        assert!(
                            (found - unit * wanted).abs() <= 1e-10 * unit * wanted,
                            "{method:?} {factor:e}: {found:e}"
                        );
                    }
                }
            }
        }
    }
}

/// Copies at other places of a batch: whitening, and the bases of shapes that are nearly flat, do not depend on the place.
#[test]
fn copies_at_other_places_of_a_batch_have_the_distance_zero() {
    let spline = GeneratorKind::Bspline { degree: 3 };
    let surface = |topology| Representation::Surface {
        topology,
        seam: Seam::Straight,
        control_points: [5, 4],
        generators: [spline.clone(), spline.clone()],
    };
    let representations = [
        Representation::ClosedCurve { dimension: 3, control_points: 12, generator: spline.clone() },
        Representation::OpenCurve { dimension: 3, intervals: 9, generator: spline.clone() },
        Representation::Landmarks { dimension: 3, points: 9 },
        surface(Topology::Torus),
        surface(Topology::Plane),
        surface(Topology::Cylinder),
        surface(Topology::Sphere),
        surface(Topology::SharpSphere),
    ];
    for representation in representations {
        let space = ShapeSpace::new(&representation).unwrap();
        let metric = Metric::of(&space);
        let matching = Matching::new(&space, Correspondence::Landmarks, Direction::Given, Mirror::Forbid);
        let mut random = Noise(3);
        let count = representation.size();
        let mut shape = || -> Vec<f64> {
            (0..3 * count).map(|k| random.next() * if k < 2 * count { 1.0 } else { 1e-7 }).collect()
        };
        let (one, others) = (shape(), [shape(), shape(), shape()]);
        let batch = [&one, &others[0], &one, &others[1], &others[2], &one].map(Vec::as_slice).concat();
        for method in methods(3) {
            let distances = DistanceSpace::new(&method, &matching).unwrap();
            let prepared = distances.prepare_given(&metric, batch.clone()).unwrap();
            let matrix = distances.matrix(&prepared, &|_| true).unwrap();
            let alone = distances.prepare_given(&metric, one.clone()).unwrap();
            let row = distances.compare(&alone, 0, &prepared);
            assert!(matrix[1] > 0.0, "{method:?}");
            for copy in [0, 2, 5] {
                assert_eq!(matrix[copy], 0.0, "{representation:?} {method:?}");
                assert_eq!(row[copy].distance, 0.0, "{representation:?} {method:?}");
            }
        }
    }
}
