//! Blocks and modules against `tests/vectors/models/two_blocks.json`: r, RV and CR to 1e-10, p equal, Z to 1e-6; and their laws.

use serde_json::Value;
use shapelex_analysis::blocks::error::BlocksError;
use shapelex_analysis::blocks::modularity::{CovarianceRatio, ModularityQuestion, PointExchange, modularity};
use shapelex_analysis::blocks::pls::{Block, BlocksFound, Form, Sampling, two_blocks};
use shapelex_analysis::blocks::records::{ModularityRecord, TestedStatistic};
use shapelex_analysis::models::effect_size::Transform;
use shapelex_analysis::watch::Unwatched;
use shapelex_geometry::capability::domain::Domain;
use shapelex_numeric::dense::Matrix;

use crate::models::{SplitMix, close, load, numbers, response, texts};

#[track_caller]
fn tested(found: &TestedStatistic, vectors: &Value, [value, p, z]: [&str; 3]) {
    close(found.value, vectors[value].as_f64().unwrap(), 1e-10, value);
    close(found.p.unwrap(), vectors[p].as_f64().unwrap(), 1e-12, p);
    let wanted = vectors[z].as_f64().unwrap();
    assert!((found.z.unwrap() - wanted).abs() < 1e-6, "{z}: {:?} for {wanted}", found.z);
    assert_eq!((found.permutations, found.exact), (199, false));
    assert!((found.difference.unwrap() / found.deviation.unwrap() - wanted).abs() < 1e-6);
}

fn block(name: &str, vectors: Matrix) -> Block<'static> {
    Block { name: name.into(), vectors, form: Form::Points(2) }
}

fn sampling<'a>(strata: &'a [usize], permutations: usize, given: Option<&'a [Vec<usize>]>) -> Sampling<'a> {
    Sampling { strata, permutations, seed: 5, transform: Transform::BoxCox, given }
}

fn pls(blocks: &[Block<'_>], weights: &[f64], permutations: usize) -> BlocksFound {
    two_blocks(blocks, weights, &sampling(&vec![0; weights.len()], permutations, None), &Unwatched).unwrap()
}

#[test]
fn two_blocks_are_those_of_the_vectors() {
    let vectors = load("two_blocks.json");
    let (x, y) = (response(&vectors["x"]), response(&vectors["y"]));
    let orders = SplitMix::orders(vectors["seed"].as_u64().unwrap(), 199, &vec![String::new(); 20]);
    let blocks = [block("x", x.clone()), block("y", y.clone())];
    let found = two_blocks(&blocks, &[1.0; 20], &sampling(&[0; 20], 199, Some(&orders)), &Unwatched).unwrap();
    let pair = &found.record.pairs[0];
    tested(&pair.r, &vectors, ["r", "p", "z"]);
    tested(&pair.rv, &vectors, ["rv", "p_rv", "z_rv"]);
    let singular = numbers(&vectors["singular"]);
    let all: f64 = singular.iter().map(|value| value * value).sum();
    assert_eq!(pair.components.len(), singular.len());
    for (component, wanted) in pair.components.iter().zip(singular) {
        close(component.singular_value, wanted, 1e-10, "singular value");
        close(component.share, wanted * wanted / all, 1e-10, "share");
    }
    // Rows of control points are coordinate-major, the vectors as given.
    let rows = pair.components[0].first.shape.as_ref().unwrap();
    for (i, wanted) in numbers(&vectors["first_x"]).into_iter().enumerate() {
        assert!((rows[i % 3][i / 3] - wanted).abs() < 1e-10, "{i}: {rows:?}");
    }
    // Scores are those of the directions, and their covariance is the singular value.
    let sum: f64 = found.scores.iter().map(|[a, b]| a * b).sum();
    close(sum / 19.0, pair.components[0].singular_value, 1e-10, "covariance of the scores");
    assert!(pair.rv.permuted_mean.unwrap() > 0.05, "{:?}", pair.rv);
}

#[test]
fn weights_of_two_count_as_two_subjects() {
    let vectors = load("two_blocks.json");
    let (x, y) = (response(&vectors["x"]), response(&vectors["y"]));
    let twice = |m: &Matrix| Matrix::from_fn(m.nrows(), 25, |i, k| m[(i, if k < 20 { k } else { k - 20 })]);
    let weights: Vec<f64> = (0..20).map(|k| if k < 5 { 2.0 } else { 1.0 }).collect();
    let one = pls(&[block("x", x.clone()), block("y", y.clone())], &weights, 19);
    let other = pls(&[block("x", twice(&x)), block("y", twice(&y))], &[1.0; 25], 0);
    let (one, other) = (&one.record.pairs[0], &other.record.pairs[0]);
    close(one.r.value, other.r.value, 1e-12, "r");
    close(one.rv.value, other.rv.value, 1e-12, "RV");
    assert_eq!((other.r.p, other.r.z, other.r.permuted_mean), (None, None, None));
    assert!(one.r.p.unwrap() < 0.11);
}

#[test]
fn the_order_of_the_subjects_says_nothing_and_scales_of_blocks_neither() {
    let vectors = load("two_blocks.json");
    let (x, y) = (response(&vectors["x"]), response(&vectors["y"]));
    let moved = |m: &Matrix| Matrix::from_fn(m.nrows(), 20, |i, k| 3.0 + 7.0 * m[(i, (7 * k + 3) % 20)]);
    let one = pls(&[block("x", x.clone()), block("y", y.clone())], &[1.0; 20], 0).record;
    let other = pls(&[block("x", moved(&x)), block("y", moved(&y))], &[1.0; 20], 0).record;
    close(one.pairs[0].r.value, other.pairs[0].r.value, 1e-11, "r");
    close(one.pairs[0].rv.value, other.pairs[0].rv.value, 1e-11, "RV");
    let first = |record: &shapelex_analysis::blocks::records::BlocksRecord| {
        record.pairs[0].components[0].first.shape.clone().unwrap()
    };
    for (a, b) in first(&one).iter().flatten().zip(first(&other).iter().flatten()) {
        assert!((a - b).abs() < 1e-9, "the sign is fixed: {a} {b}");
    }
}

#[test]
fn few_subjects_are_exchanged_in_all_orders_and_many_blocks_pair_by_pair() {
    let made = |seed: usize, n: usize| {
        Matrix::from_fn(4, n, |i, k| {
            (((13 + 6 * seed) * k * k + 7 * i * i + (seed + i) * i * k) as f64).sin()
        })
    };
    let few = pls(&[block("a", made(1, 4)), block("b", made(2, 4))], &[1.0; 4], 100);
    assert_eq!((few.record.pairs[0].r.permutations, few.record.pairs[0].r.exact), (23, true));
    let three = [block("a", made(1, 12)), block("b", made(2, 12)), block("c", made(3, 12))];
    let found = pls(&three, &[1.0; 12], 99).record;
    let names: Vec<_> = found.pairs.iter().map(|pair| (pair.first.as_str(), pair.second.as_str())).collect();
    assert_eq!(names, [("a", "b"), ("a", "c"), ("b", "c")]);
    let overall = found.overall.unwrap();
    let mean = found.pairs.iter().map(|pair| pair.r.value).sum::<f64>() / 3.0;
    close(overall.value, mean, 1e-14, "mean of the correlations");
    assert!(overall.p.unwrap() > 0.2 && overall.permutations == 99, "unrelated numbers: {overall:?}");
    let again = pls(&three, &[1.0; 12], 99).record;
    assert_eq!(again.overall.unwrap(), overall);
    let constant = block("c", Matrix::from_element(4, 12, 0.3));
    let refused = two_blocks(
        &[block("a", made(1, 12)), constant],
        &[1.0; 12],
        &sampling(&[0; 12], 0, None),
        &Unwatched,
    );
    assert_eq!(refused, Err(BlocksError::Constant { block: 1, name: "c".into() }));
}

#[test]
fn labels_are_standardised() {
    let vectors = load("two_blocks.json");
    let ages: Vec<f64> = (0..20).map(|k| 40.0 + 5.0 * vectors["y"][k][0].as_f64().unwrap()).collect();
    let own = |factor: f64| {
        let list = [("age".to_owned(), ages.iter().map(|age| factor * age).collect())];
        let labels = Block::of_numbers(1, &list, &[1.0; 20]).unwrap();
        pls(&[block("x", response(&vectors["x"])), labels], &[1.0; 20], 0).record
    };
    let (one, other) = (own(1.0), own(1000.0));
    close(
        one.pairs[0].components[0].singular_value,
        other.pairs[0].components[0].singular_value,
        1e-11,
        "scale",
    );
    let labels = one.pairs[0].components[0].second.labels.clone().unwrap();
    assert!((labels["age"].abs() - 1.0).abs() < 1e-12 && one.blocks[1].average.is_none(), "{labels:?}");
    let flat = [("age".to_owned(), vec![3.3; 20])];
    let refused = Block::of_numbers(1, &flat, &[1.0; 20]).map(|_| ());
    assert_eq!(refused, Err(BlocksError::Constant { block: 1, name: "age".into() }));
}

/// Points of the vectors, coordinate-major, turned by an angle.
fn points(vectors: &Value, [cosine, sine]: [f64; 2]) -> Matrix {
    let (x, y) = (response(&vectors["x"]), response(&vectors["y"]));
    let value = |row: usize, k: usize| if row < 6 { x[(row, k)] } else { y[(row - 6, k)] };
    // Columns of the vectors are landmark-major; rows (a, b) become (a, b) times (0.6, −0.8; 0.8, 0.6).
    Matrix::from_fn(14, 20, |i, k| {
        let (a, b) = (value(2 * (i % 7), k), value(2 * (i % 7) + 1, k));
        if i < 7 { cosine * a + sine * b } else { cosine * b - sine * a }
    })
}

fn modules(names: &[String], labels: &[usize], cr: CovarianceRatio) -> ModularityQuestion<'static> {
    let (names, labels) = (names.to_vec().leak(), labels.to_vec().leak());
    let exchange = Some(PointExchange::Points);
    ModularityQuestion {
        cr,
        names,
        labels,
        exchange,
        permutations: 0,
        seed: 1,
        transform: Transform::BoxCox,
        given: None,
    }
}

fn ratio(points: &Matrix, question: &ModularityQuestion<'_>) -> ModularityRecord {
    modularity(points, 2, &vec![1.0; points.ncols()], question, &Unwatched).unwrap()
}

#[test]
fn covariance_ratios_are_those_of_the_vectors() {
    let all = load("two_blocks.json");
    let vectors = &all["modules"];
    let labels: Vec<usize> = texts(&vectors["labels"]).iter().map(|name| usize::from(name == "B")).collect();
    let names = ["A".to_owned(), "B".to_owned()];
    let orders = SplitMix::orders(vectors["seed"].as_u64().unwrap(), 199, &vec![String::new(); 7]);
    let (straight, turned) = (points(&all, [1.0, 0.0]), points(&all, [0.6, 0.8]));
    for (cr, fields, rotated) in [
        (CovarianceRatio::Adams2016, ["cr", "p", "z"], "cr_after_rotation"),
        (
            CovarianceRatio::Invariant,
            ["cr_invariant", "p_invariant", "z_invariant"],
            "cr_invariant_after_rotation",
        ),
    ] {
        let question = ModularityQuestion { given: Some(&orders), ..modules(&names, &labels, cr) };
        tested(&ratio(&straight, &question).ratio, vectors, fields);
        let turned = ratio(&turned, &modules(&names, &labels, cr)).ratio;
        close(turned.value, vectors[rotated].as_f64().unwrap(), 1e-10, rotated);
    }
}

#[test]
fn modules_that_vary_apart_are_found_and_the_frame_says_nothing() {
    // Two modules of five points, each moved by waves of its own.
    let wave = |module: usize, k: usize| ((module * 5 + 2) as f64 * (k * k) as f64).sin();
    let noise = |i: usize, k: usize| 0.2 * ((i * i * 7 + k * k * 3 + i * k + 1) as f64).sin();
    let cloud = Matrix::from_fn(20, 30, |i, k| wave(i % 10 / 5, k) * (1.0 + (i / 10) as f64) + noise(i, k));
    let labels: Vec<usize> = (0..10).map(|i| i / 5).collect();
    let names = ["a".to_owned(), "b".to_owned()];
    let question =
        ModularityQuestion { permutations: 1000, ..modules(&names, &labels, CovarianceRatio::Invariant) };
    let found = ratio(&cloud, &question);
    assert!(found.ratio.value < 0.6 && found.ratio.z.unwrap() < -2.0, "{found:?}");
    // All 252 exchanges; those that swap the modules are ties.
    assert_eq!((found.ratio.permutations, found.ratio.exact, found.ratio.exceeding), (251, true, 1));
    assert_eq!(found.exchanged.as_deref(), Some("points"));
    let (sine, cosine) = 1.1_f64.sin_cos();
    let turned = Matrix::from_fn(20, 30, |i, k| {
        let (a, b) = (cloud[(i % 10, k)], cloud[(i % 10 + 10, k)]);
        if i < 10 { cosine * a - sine * b } else { sine * a + cosine * b }
    });
    close(ratio(&turned, &question).ratio.value, found.ratio.value, 1e-12, "the frame");
    // Along a closed curve the modules are shifted, and a half turn swaps them.
    let shifts = ModularityQuestion { exchange: Some(PointExchange::Shifts), ..question };
    let found = ratio(&cloud, &shifts);
    assert_eq!((found.ratio.permutations, found.ratio.exceeding, found.ratio.p), (9, 1, Some(0.2)));
    // A point of no module counts for nothing.
    let some: Vec<usize> = (0..10).map(|i| if i == 4 { 2 } else { i / 5 }).collect();
    let question =
        ModularityQuestion { permutations: 1000, ..modules(&names, &some, CovarianceRatio::Invariant) };
    assert_eq!(ratio(&cloud, &question).ratio.permutations, 125);
}

#[test]
fn neighbours_that_cannot_be_exchanged_are_refused() {
    assert_eq!(PointExchange::of(Domain::Points), Ok(PointExchange::Points));
    assert_eq!(PointExchange::of(Domain::Line { closed: true }), Ok(PointExchange::Shifts));
    for domain in [Domain::Line { closed: false }, Domain::Vertices] {
        assert!(matches!(PointExchange::of(domain), Err(BlocksError::Exchange(_))));
    }
    let still = Matrix::from_fn(8, 6, |i, k| if i % 4 < 2 { 1.0 } else { (i * k) as f64 });
    let question = modules(&["a".into(), "b".into()], &[0, 0, 1, 1], CovarianceRatio::Invariant);
    let refused = modularity(&still, 2, &[1.0; 6], &question, &Unwatched);
    assert_eq!(refused, Err(BlocksError::Constant { block: 0, name: "a".into() }));
}
