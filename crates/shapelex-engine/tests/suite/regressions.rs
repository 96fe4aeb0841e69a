//! Regressions by sums over parts are those of the analysis on all shapes at once.

use std::sync::Arc;

use shapelex_analysis::accumulate::PART;
use shapelex_analysis::alignment::Alignment;
use shapelex_analysis::inference::aligned::{AlignedShapes, StudySpace, frame_for};
use shapelex_analysis::inference::permutation::Draws;
use shapelex_analysis::inference::records::RegressionRecord;
use shapelex_analysis::inference::regress::regress as direct;
use shapelex_analysis::inference::variables::{Values, Variable as Given, Variables};
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_engine::EngineError;
use shapelex_engine::cohort::record::Record;
use shapelex_engine::cohort::revision::{Revision, Setting};
use shapelex_engine::cohort::writer::Writer;
use shapelex_engine::objects::Objects;
use shapelex_engine::pass::source::{AtRest, Runner};
use shapelex_engine::pass::variables::Variable;
pub(crate) use shapelex_engine::regression::Request;
use shapelex_engine::regression::{Regressed, regress};
use shapelex_geometry::representation::ShapeSpace;

use crate::passes::{engine, runtime};
use crate::support::{description, in_memory, triangle};

const PERMUTATIONS: usize = 99;

/// A triangle whose second corner moves with its age.
pub(crate) fn patient(k: usize, complete: bool) -> Record {
    let mut shape = triangle(k);
    let age = ((k * 37) % 61) as f64 / 2.0;
    shape.control_points[1] += 0.05 * age;
    shape.measures.centroid_size = Some(10.0 + (k % 7) as f64);
    shape.label = Some(["x", "y", "z"][k % 3].into());
    let site = ["a", "b"][k / 5 % 2];
    let age = if complete || k % 11 != 3 { format!(r#""age":{age},"#) } else { String::new() };
    shape.attributes = Some(format!(r#"{{{age}"site":"{site}"}}"#));
    shape
}

fn cohort(count: usize, complete: bool) -> (Objects, Arc<Revision>) {
    let (_, objects) = in_memory();
    let revision = runtime().block_on(async {
        let mut writer = Writer::begin(objects.clone(), description(1, count), false).await.unwrap();
        for k in 0..count {
            writer.add(patient(k, complete)).await.unwrap();
        }
        writer.finish().await.unwrap();
        Arc::new(Revision::open(objects.clone(), "coh_triangles", 1).await.unwrap())
    });
    (objects, revision)
}

pub(crate) fn request(attribute: &str, covariates: &[&str]) -> Request {
    let variable = |name: &str| Variable::try_from(name.to_string()).unwrap();
    Request {
        covariates: covariates.iter().map(|name| variable(name)).collect(),
        attribute: variable(attribute),
        tangent: false,
        skip_missing: false,
        permutations: PERMUTATIONS,
        seed: 4,
    }
}

pub(crate) fn by(
    runner: Option<&dyn Runner>,
    revision: &Arc<Revision>,
    class: ClassName,
    alignment: Alignment,
    mut request: Request,
) -> Result<Regressed, EngineError> {
    request.tangent = alignment == Alignment::PartialProcrustes;
    let setting = Setting::new(revision.manifest(), &Transformation::Named(class), Some(alignment)).unwrap();
    let setting = Arc::new(setting);
    let source = AtRest::new(revision.clone(), setting.clone(), runtime().handle(), runner);
    regress(&source, &setting, request)
}

/// The regression of the analysis, on shapes in memory.
fn in_memory_regression(count: usize, setting: &Setting) -> RegressionRecord {
    let shapes: Vec<Record> = (0..count).map(|k| patient(k, true)).collect();
    let representation = description(1, count).representation;
    let space = ShapeSpace::new(&representation).unwrap();
    let Setting { metric, method, matching, transformation, .. } = setting;
    let tangent = setting.chosen == Alignment::PartialProcrustes;
    let study =
        StudySpace { space: &space, metric, method, tangent, frame: frame_for(transformation), matching };
    let points = shapes.iter().flat_map(|shape| shape.control_points.iter().copied()).collect();
    let weights = shapes.iter().map(|shape| shape.weight).collect();
    let aligned = AlignedShapes::new(study, points, weights, &Unwatched).unwrap();
    let attribute =
        |k: usize| serde_json::from_str::<serde_json::Value>(shapes[k].attributes.as_ref().unwrap()).unwrap();
    let texts = |of: &dyn Fn(usize) -> String| Values::category(&(0..count).map(of).collect::<Vec<_>>());
    let given = |name: &str, values| Given { name: name.into(), values };
    let numbers = (0..count).map(|k| shapes[k].measures.centroid_size.unwrap().ln()).collect();
    let variables = Variables {
        covariates: vec![
            given("label", texts(&|k| shapes[k].label.clone().unwrap())),
            given("labels.site", texts(&|k| attribute(k)["site"].as_str().unwrap().into())),
            given("log_centroid_size", Values::Numbers(numbers)),
        ],
        attribute: given(
            "labels.age",
            Values::Numbers((0..count).map(|k| attribute(k)["age"].as_f64().unwrap()).collect()),
        ),
    };
    let strata = vec![0; count];
    let draws = Draws { strata: &strata, seed: 4, permutations: PERMUTATIONS };
    direct(&aligned, &variables, draws, &Unwatched).unwrap().record
}

const COVARIATES: [&str; 3] = ["label", "labels.site", "log_centroid_size"];

fn close(found: &serde_json::Value, expected: &serde_json::Value, place: &str) {
    use serde_json::Value::{Array, Number, Object};
    match (found, expected) {
        (Number(a), Number(b)) => {
            let (a, b) = (a.as_f64().unwrap(), b.as_f64().unwrap());
            // Sums of 20 000 products, in another order.
            assert!((a - b).abs() <= 1e-9 * b.abs().max(1.0), "{place}: {a}, expected {b}");
        }
        (Array(a), Array(b)) => {
            assert_eq!(a.len(), b.len(), "{place}");
            a.iter().zip(b).enumerate().for_each(|(i, (a, b))| close(a, b, &format!("{place}/{i}")));
        }
        (Object(a), Object(b)) => {
            assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>(), "{place}");
            a.iter().zip(b.values()).for_each(|((key, a), b)| close(a, b, &format!("{place}/{key}")));
        }
        (a, b) => assert_eq!(a, b, "{place}"),
    }
}

#[test]
fn a_regression_by_sums_is_that_of_all_shapes_on_any_number_of_threads() {
    for (count, class, alignment) in [
        (PART - 5, ClassName::Similarity, Alignment::Projection),
        (2 * PART + 100, ClassName::Similarity, Alignment::Projection),
        (2 * PART + 100, ClassName::Similarity, Alignment::PartialProcrustes),
    ] {
        let (_, revision) = cohort(count, true);
        let alone = by(None, &revision, class, alignment, request("labels.age", &COVARIATES)).unwrap();
        assert_eq!((alone.shape_count, alone.left_out), (count, 0));
        for threads in [1, 2, 5] {
            let engine = engine(threads, 64 << 20);
            let found =
                by(Some(&engine), &revision, class, alignment, request("labels.age", &COVARIATES)).unwrap();
            assert_eq!(found, alone, "{threads} threads");
        }
        let setting =
            Setting::new(revision.manifest(), &Transformation::Named(class), Some(alignment)).unwrap();
        let mut expected = in_memory_regression(count, &setting);
        if count > PART {
            // The draws are others.
            assert_eq!(expected.test.p, alone.record.test.p, "there is an effect");
            expected.test = alone.record.test.clone();
        }
        let document = |record: &RegressionRecord| serde_json::to_value(record).unwrap();
        close(&document(&alone.record), &document(&expected), "");
    }
}

#[test]
fn shapes_without_values_are_counted_and_left_out_when_asked() {
    let (_, revision) = cohort(PART + 300, false);
    let by = |request| {
        by(Some(&engine(2, 64 << 20)), &revision, ClassName::Similarity, Alignment::Projection, request)
    };
    let missing = (0..PART + 300).filter(|k| k % 11 == 3).count();
    let error = by(request("labels.age", &[])).unwrap_err().to_string();
    assert!(error.contains(&format!("got none for {missing} shapes, the first at [3]")), "{error}");
    let skipped = by(Request { skip_missing: true, ..request("labels.age", &["labels.site"]) }).unwrap();
    assert_eq!((skipped.shape_count, skipped.left_out as usize), (PART + 300 - missing, missing));
    assert!(skipped.warnings[0].starts_with(&format!("{missing} shapes lack a value")));
    assert_eq!(skipped.record.test.permutations, PERMUTATIONS);
    assert_eq!(skipped.record.covariates[0].levels, Some(vec!["a".into(), "b".into()]));
}

#[test]
fn what_cannot_be_regressed_is_refused_by_name() {
    let (_, revision) = cohort(600, true);
    let by = |request| {
        let found = by(None, &revision, ClassName::Similarity, Alignment::Projection, request);
        found.unwrap_err().to_string()
    };
    for (refused, part) in [
        (request("labels.site", &[]), "expected a value of every variable, and a number of 'labels.site'"),
        (request("labels.none", &[]), "got none for 600 shapes"),
        (request("measures.points", &[]), "measures.points: the attribute is constant"),
        (request("labels.age", &["measures.points"]), "measures.points: the covariate is constant"),
        (
            request("measures.centroid_size", &["labels.site", "measures.centroid_size"]),
            "measures.centroid_size: the attribute is constant, or a linear combination",
        ),
        (
            request("labels.age", &["log_centroid_size", "labels.site", "log_centroid_size"]),
            "log_centroid_size: the covariate is constant, or a linear combination",
        ),
        (request("labels.age", &["subject"]), "got none for 600 shapes"),
        (
            Request { permutations: 10_000_000, ..request("labels.age", &[]) },
            "permutations: expected at most",
        ),
    ] {
        let error = by(refused);
        assert!(error.contains(part), "{error}, expected {part}");
    }
    assert!(Variable::try_from("age".to_string()).unwrap_err().contains("got 'age'"));
    assert!(Variable::try_from("measures.mass".to_string()).is_err());
}
