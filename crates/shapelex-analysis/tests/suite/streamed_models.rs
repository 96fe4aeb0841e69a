//! Models of streams beside models of the same shapes in memory, from control points to predictions.

use std::collections::BTreeMap;

use super::models::{close, load, numbers};
use shapelex_analysis::accumulate::ShapesInMemory;
use shapelex_analysis::alignment::{Alignment, Method};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::inference::aligned::{AlignedShapes, StudySpace, frame_for};
use shapelex_analysis::matching::Matching;
use shapelex_analysis::metric::Metric;
use shapelex_analysis::models::anova::Testing;
use shapelex_analysis::models::chi_squared::tail;
use shapelex_analysis::models::design::{Contrasts, Table, Values};
use shapelex_analysis::models::formula::{Formula, TermOrder};
use shapelex_analysis::models::outcome::ModelRecord;
use shapelex_analysis::models::records::At;
use shapelex_analysis::models::streamed::{KeyedExchange, StreamedShapes};
use shapelex_analysis::models::study::{Further, ModelQuestion, Response, model};
use shapelex_analysis::models::subspaces::SumType;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::{Representation, ShapeSpace};

const SHAPES: usize = 240;
const DRAWS: usize = 40;

/// Contours that turn, move, change their size and their start, with attributes that change them.
fn shapes(points: usize, starts: bool) -> (Vec<f64>, Table) {
    let wave = |k: usize, c: usize| ((k * 31 + c * 17 + 3) as f64 * 0.618_033_988_7).fract() - 0.5;
    let mut control_points = Vec::new();
    for k in 0..SHAPES {
        let (angle, size) = (6.0 * wave(k, 1), 1.0 + wave(k, 2));
        let shift = if starts { k * 5 % points } else { 0 };
        let point = |i: usize| {
            let t = std::f64::consts::TAU * ((i + shift) % points) as f64 / points as f64;
            let bump = 0.3 + 0.03 * (k % 3) as f64 + 0.02 * wave(k, 3);
            let [x, y] =
                [2.0 * t.cos() + bump * (2.0 * t).cos(), t.sin() + 0.1 * wave(k, 4) * (3.0 * t).sin()];
            let turned = [angle.cos() * x - angle.sin() * y, angle.sin() * x + angle.cos() * y];
            turned.map(|value| size * value + 3.0 * wave(k, 5))
        };
        (0..2).for_each(|c| control_points.extend((0..points).map(|i| point(i)[c])));
    }
    let table = Table::default()
        .with_factor("group", (0..SHAPES).map(|k| ["u", "v", "w"][k % 3]))
        .with_numbers("age", (0..SHAPES).map(|k| 40.0 + (k % 11) as f64))
        .with_numbers("size", (0..SHAPES).map(|k| 1.0 + wave(k, 2)));
    (control_points, table)
}

struct Case {
    space: ShapeSpace,
    metric: Metric,
    method: Method,
    matching: Matching,
    transformation: Transformation,
    tangent: bool,
}

impl Case {
    fn new(representation: &Representation, class: ClassName, alignment: Alignment, cyclic: bool) -> Self {
        let space = ShapeSpace::new(representation).unwrap();
        let correspondence = if cyclic { Correspondence::Cyclic } else { Correspondence::Landmarks };
        let transformation = Transformation::Named(class);
        Self {
            metric: Metric::of(&space),
            method: Method::new(&transformation, alignment, 2).unwrap(),
            matching: Matching::new(&space, correspondence, Direction::Given, Mirror::Forbid)
                .translating(true),
            tangent: transformation.removes_size(),
            transformation,
            space,
        }
    }

    fn study(&self) -> StudySpace<'_> {
        let Self { space, metric, method, matching, tangent, transformation } = self;
        StudySpace { space, metric, method, tangent: *tangent, frame: frame_for(transformation), matching }
    }
}

fn question<'a>(formula: &'a Formula, table: &'a Table, testing: Testing<'a>) -> ModelQuestion<'a> {
    ModelQuestion {
        formula,
        table,
        contrasts: Contrasts::Sum,
        response: Response::Shape,
        testing,
        random: None,
        manova: None,
        covariance: None,
        at: None,
        further: Further::default(),
    }
}

#[track_caller]
fn compare(found: &ModelRecord, expected: &ModelRecord, tolerance: f64) {
    let (own, other) = (&found.anova, &expected.anova);
    close(own.total.sum_of_squares, other.total.sum_of_squares, tolerance, "total");
    close(own.residual.sum_of_squares, other.residual.sum_of_squares, tolerance, "residual");
    assert_eq!((&own.design, &own.warnings), (&other.design, &other.warnings));
    assert_eq!(found.pooled, expected.pooled);
    for (own, other) in own.terms.iter().zip(&other.terms) {
        close(own.sum_of_squares, other.sum_of_squares, tolerance, &own.term);
        close(own.f.unwrap(), other.f.unwrap(), tolerance, &own.term);
        assert_eq!((own.p, own.exceeding, own.permutations), (other.p, other.exceeding, other.permutations));
        assert!((own.z.unwrap() - other.z.unwrap()).abs() < 1e-6, "{}", own.term);
    }
    let shapes = |record: &ModelRecord| -> Vec<f64> {
        let of_columns = record.coefficients.iter().filter_map(|coefficient| coefficient.shape.clone());
        let of_places = record.predictions.iter().filter_map(|prediction| prediction.shape.clone());
        of_columns.chain(of_places).flatten().flatten().collect()
    };
    let values = |record: &ModelRecord| -> Vec<f64> {
        let of_columns = record.coefficients.iter().filter_map(|coefficient| coefficient.value);
        let of_places = record.predictions.iter().flat_map(|at| [at.value.unwrap_or(0.0), at.leverage]);
        of_columns.chain(of_places).collect()
    };
    for (own, other) in [(shapes(found), shapes(expected)), (values(found), values(expected))] {
        assert_eq!(own.len(), other.len());
        assert!(own.iter().zip(&other).all(|(a, b)| (a - b).abs() < 1e-11 * (1.0 + b.abs())));
    }
    let places = |record: &ModelRecord| record.predictions.iter().map(|p| p.at.clone()).collect::<Vec<_>>();
    assert_eq!(places(found), places(expected));
}

/// Landmarks and curves whose start is searched, by projection and by Procrustes fits, with and without the tangent space: tables,
/// coefficients and predictions to rounding (sums of squares 1e-11: the mean is subtracted first), p equal for equal exchanges.
#[test]
fn models_of_streams_are_those_of_shapes_in_memory() {
    use Alignment::{PartialProcrustes, Procrustes, Projection};
    let landmarks = Representation::Landmarks { dimension: 2, points: 12 };
    let generator = GeneratorKind::Bspline { degree: 3 };
    let curves = Representation::ClosedCurve { dimension: 2, control_points: 12, generator };
    let at =
        [BTreeMap::from([("group".to_owned(), At::Level("v".into())), ("age".to_owned(), At::Number(47.5))])];
    for (representation, class, alignment, cyclic) in [
        (&landmarks, ClassName::Similarity, Projection, false),
        (&landmarks, ClassName::Similarity, PartialProcrustes, false),
        (&landmarks, ClassName::Rigid, Procrustes, false),
        (&curves, ClassName::Affine, Projection, false),
        (&curves, ClassName::Similarity, Projection, true),
    ] {
        let case = Case::new(representation, class, alignment, cyclic);
        let (control_points, table) = shapes(12, cyclic);
        for (weights, text, kind, at) in [
            (vec![1.0; SHAPES], "group*age", SumType::II, None),
            (
                (0..SHAPES).map(|k| 1.0 + 0.5 * (k % 4) as f64).collect(),
                "age + group",
                SumType::III,
                Some(&at[..]),
            ),
        ] {
            let formula = Formula::parse(text, TermOrder::ByDegree).unwrap();
            let exchange = KeyedExchange::new(SHAPES, None, 9, DRAWS);
            let given: Vec<Vec<usize>> = (0..DRAWS).map(|draw| exchange.list(draw, SHAPES)).collect();
            let testing = Testing { kind, permutations: DRAWS, seed: 9, ..Testing::default() };
            let in_memory = Testing { given: Some(&given), ..testing.clone() };
            let aligned =
                AlignedShapes::new(case.study(), control_points.clone(), weights.clone(), &Unwatched)
                    .unwrap();
            let asked = ModelQuestion { at, ..question(&formula, &table, in_memory) };
            let expected = model(&aligned, &asked, &Unwatched).unwrap();
            let source =
                ShapesInMemory::new(&case.metric, case.method.translates(), control_points.clone(), weights)
                    .unwrap();
            let streamed = StreamedShapes::new(&source, case.study(), true, &Unwatched).unwrap();
            let asked = ModelQuestion { at, ..question(&formula, &table, testing) };
            compare(&streamed.model(&asked, &Unwatched).unwrap(), &expected, 1e-11);
        }
    }
}

/// Numbers take no mean; two models are compared by the same exchanges.
#[test]
fn numbers_and_nested_models_stream() {
    let case = Case::new(
        &Representation::Landmarks { dimension: 2, points: 12 },
        ClassName::Similarity,
        Alignment::Projection,
        false,
    );
    let (control_points, table) = shapes(12, false);
    let (weights, formula) = (vec![1.0; SHAPES], Formula::parse("group*age", TermOrder::ByDegree).unwrap());
    let reduced = Formula::parse("age", TermOrder::ByDegree).unwrap();
    let Some(Values::Numbers(sizes)) = table.attributes.get("size") else { panic!("no numbers") };
    let strata: Vec<usize> = (0..SHAPES).map(|k| k / 50).collect();
    let short: Vec<u32> = strata.iter().map(|&label| label as u32).collect();
    let exchange = KeyedExchange::new(SHAPES, Some(&short), 2, DRAWS);
    let given: Vec<Vec<usize>> = (0..DRAWS).map(|draw| exchange.list(draw, SHAPES)).collect();
    let aligned =
        AlignedShapes::new(case.study(), control_points.clone(), weights.clone(), &Unwatched).unwrap();
    let source = ShapesInMemory::new(&case.metric, true, control_points, weights).unwrap();
    for (response, reduced) in [(Response::Numbers(sizes), None), (Response::Shape, Some(&reduced))] {
        let testing = Testing { permutations: DRAWS, seed: 2, strata: Some(&strata), ..Testing::default() };
        let in_memory = Testing { given: Some(&given), ..testing.clone() };
        let of = |testing| ModelQuestion {
            response,
            further: Further { reduced, ..Further::default() },
            ..question(&formula, &table, testing)
        };
        let expected = model(&aligned, &of(in_memory), &Unwatched).unwrap();
        let needs_mean = response == Response::Shape;
        let streamed = StreamedShapes::new(&source, case.study(), needs_mean, &Unwatched).unwrap();
        let found = streamed.model(&of(testing), &Unwatched).unwrap();
        compare(&found, &expected, 1e-11);
        assert_eq!(found.reduced, expected.reduced);
        assert!(found.anova.terms.iter().all(|term| term.p_asymptotic.is_none()), "strata");
    }
}

#[test]
fn tails_are_those_of_the_vectors() {
    for case in load("null_from_sums.json")["weighted_chi2"].as_array().unwrap() {
        let found = tail(
            &numbers(&case["weights"]),
            case["df"].as_u64().unwrap() as usize,
            case["x"].as_f64().unwrap(),
        );
        let wanted = case["tail"].as_f64().unwrap();
        assert!((found.unwrap() - wanted).abs() < 1e-8, "{found:?} for {wanted}");
    }
}
