//! Regressions by sums over parts are those of the analysis on all shapes at once.

use std::sync::Arc;

use shapelex_analysis::accumulate::PART;
use shapelex_analysis::alignment::{Alignment, mean_shape};
use shapelex_analysis::inference::aligned::{AlignedShapes, StudySpace, frame_for};
use shapelex_analysis::inference::permutation::Draws;
use shapelex_analysis::inference::records::RegressionRecord;
use shapelex_analysis::inference::regress::regress as direct;
use shapelex_analysis::inference::regression::Regression;
use shapelex_analysis::inference::regression_sums::{RegressionSums, Scale};
use shapelex_analysis::inference::variables::{Values, Variable as Given, Variables};
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_engine::EngineError;
use shapelex_engine::cohort::record::Record;
use shapelex_engine::cohort::revision::{Revision, Setting};
use shapelex_engine::cohort::writer::Writer;
use shapelex_engine::pass::regress::{Design, Regress, Step};
use shapelex_engine::pass::subject::{Runner, Subject};
use shapelex_engine::pass::variables::{Columns, Variable};
use shapelex_engine::pass::work::Work;
use shapelex_geometry::representation::ShapeSpace;

use crate::passes::{engine, runtime, similarity};
use crate::support::{WIDTH, description, in_memory, prepared, triangle};

const PERMUTATIONS: usize = 99;

/// Seed of the permutations.
const SEED: u64 = 4;

/// A triangle whose second corner moves with its age.
fn patient(k: usize, complete: bool) -> Record {
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

fn cohort(count: usize, complete: bool) -> Arc<Revision> {
    let (_, objects) = in_memory();
    runtime().block_on(async {
        let mut writer = Writer::begin(objects.clone(), description(1, count), false).await.unwrap();
        for k in 0..count {
            writer.add(patient(k, complete)).await.unwrap();
        }
        writer.finish().await.unwrap();
        Arc::new(Revision::open(objects.clone(), "coh_triangles", 1).await.unwrap())
    })
}

fn variables(names: &[&str]) -> Vec<Variable> {
    names.iter().map(|name| Variable::try_from(name.to_string()).unwrap()).collect()
}

fn number(smallest: f64, largest: f64) -> Columns {
    Columns::Number(Scale::of(smallest, largest).unwrap())
}

fn levels(levels: &[&str]) -> Columns {
    Columns::Levels(levels.iter().map(|level| level.to_string()).collect())
}

/// The result of a step of a regression.
fn step(
    runner: &dyn Runner,
    revision: &Arc<Revision>,
    setting: &Arc<Setting>,
    variables: &[Variable],
    step: Step,
) -> Result<Vec<u8>, EngineError> {
    let regress = Regress { variables: variables.to_vec(), step };
    regress.check(setting.metric.len())?;
    let subject = Subject::new(revision.clone(), setting.clone(), None);
    Ok(runtime().block_on(runner.run(subject, &Work::Regress(Box::new(regress))))?.0)
}

/// Summary and sums of triangles over their area, adjusted for their label, which not all have.
#[cfg(feature = "cluster")]
pub(crate) fn on_area(runner: &dyn Runner, revision: &Arc<Revision>) -> Result<[Vec<u8>; 2], EngineError> {
    let setting = Arc::new(similarity(revision.manifest()));
    let variables = variables(&["label", "measures.area"]);
    let columns = vec![levels(&["a", "b"]), number(0.0, revision.shapes() as f64 / 8.0)];
    let mean = [-8.0, 12.0, -4.0, -6.0, -3.0, 9.0].to_vec();
    let steps = [Step::Summarise, Step::Sum(Design { mean, tangent: false, columns })];
    let [summary, sums] = steps.map(|own| step(runner, revision, &setting, &variables, own));
    Ok([summary?, sums?])
}

/// The variables of patients, and their columns.
fn design() -> (Vec<Variable>, Vec<Columns>) {
    let variables = variables(&["label", "labels.site", "log_centroid_size", "labels.age"]);
    let sizes = number(10_f64.ln(), 16_f64.ln());
    (variables, vec![levels(&["x", "y", "z"]), levels(&["a", "b"]), sizes, number(0.0, 30.0)])
}

/// The regression by passes, and the bytes of both.
fn by(runner: &dyn Runner, revision: &Arc<Revision>, setting: &Arc<Setting>) -> (Regression, [Vec<u8>; 2]) {
    let (variables, columns) = design();
    let patients: Vec<Record> = (0..revision.shapes()).map(|k| patient(k, true)).collect();
    let Setting { metric, method, matching, transformation, .. } = &**setting;
    let shapes = prepared(setting, &patients);
    let mean = mean_shape(&shapes, metric, method, frame_for(transformation), matching).unwrap();
    let tangent = setting.chosen == Alignment::PartialProcrustes;
    let design = Design { mean: mean.whitened, tangent, columns };
    let run = |own| step(runner, revision, setting, &variables, own).unwrap();
    let summed = run(Step::Sum(design.clone()));
    // A category of three levels has two columns, every other variable one.
    let mut sums = RegressionSums::new(WIDTH, 5);
    sums.restore(&summed).unwrap();
    assert_eq!(sums.shapes(), revision.shapes());
    let solved = sums.solve(&design.mean, Scale::of(0.0, 30.0).unwrap()).unwrap();
    let reduced = solved.reduced.clone();
    let permuted = run(Step::Permute { design, reduced, seed: SEED, draws: PERMUTATIONS });
    let numbers: Vec<f64> =
        permuted.as_chunks::<8>().0.iter().map(|number| f64::from_le_bytes(*number)).collect();
    (solved.regression(&numbers, PERMUTATIONS), [summed, permuted])
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
    let draws = Draws { strata: &strata, seed: SEED, permutations: PERMUTATIONS };
    direct(&aligned, &variables, draws, &Unwatched).unwrap().record
}

fn close(found: f64, expected: f64, name: &str) {
    // Sums of 20 000 products, in another order.
    assert!(
        (found - expected).abs() <= 1e-9 * expected.abs().max(1.0),
        "{name}: {found}, expected {expected}"
    );
}

#[test]
fn a_regression_by_sums_is_that_of_all_shapes_on_any_number_of_threads() {
    for (count, class, alignment) in [
        (PART - 5, ClassName::Similarity, Alignment::Projection),
        (2 * PART + 100, ClassName::Similarity, Alignment::Projection),
        (2 * PART + 100, ClassName::Similarity, Alignment::PartialProcrustes),
    ] {
        let revision = cohort(count, true);
        let class = Transformation::Named(class);
        let setting = Arc::new(Setting::new(revision.manifest(), &class, Some(alignment)).unwrap());
        let (found, bytes) = by(&engine(1, 64 << 20), &revision, &setting);
        for threads in [2, 5] {
            assert_eq!(by(&engine(threads, 64 << 20), &revision, &setting).1, bytes, "{threads} threads");
        }
        let expected = in_memory_regression(count, &setting);
        close(found.r_squared, expected.r_squared, "R²");
        close(found.partial_r_squared, expected.partial_r_squared, "partial R²");
        close(found.model_r_squared, expected.model_r_squared, "R² of the model");
        close(found.pseudo_f.unwrap(), expected.pseudo_f.unwrap(), "pseudo-F");
        assert_eq!(found.degrees, expected.degrees);
        let rows = setting.metric.rows(&found.slope).concat();
        rows.iter().zip(expected.change_per_unit.concat()).for_each(|(a, b)| close(*a, b, "change per unit"));
        // Of several parts the draws are others, but there is an effect.
        assert_eq!(found.tally.p(), expected.test.p);
    }
}

#[test]
fn shapes_without_values_are_counted_and_left_out() {
    let count = PART + 300;
    let (revision, (variables, columns)) = (cohort(count, false), design());
    let setting = Arc::new(similarity(revision.manifest()));
    let two = engine(2, 64 << 20);
    let run = |own| step(&two, &revision, &setting, &variables, own).unwrap();
    let missing = (0..count).filter(|k| k % 11 == 3).count();
    let summary = run(Step::Summarise);
    let (length, rest) = summary.split_first_chunk::<8>().unwrap();
    let (head, values) = rest.split_at(u64::from_le_bytes(*length) as usize);
    let head: serde_json::Value = serde_json::from_slice(head).unwrap();
    assert_eq!((&head["missing"], &head["first_missing"]), (&missing.into(), &3.into()));
    assert_eq!(head["known"][1]["levels"], serde_json::json!(["a", "b"]));
    assert_eq!(values.len(), 8 * (count - missing));

    let mean = [-8.0, 12.0, -4.0, -6.0, -3.0, 9.0].to_vec();
    let mut sums = RegressionSums::new(WIDTH, 5);
    sums.restore(&run(Step::Sum(Design { mean, tangent: false, columns }))).unwrap();
    assert_eq!(sums.shapes(), count - missing);
}

#[test]
fn variables_have_the_names_of_the_service() {
    assert!(Variable::try_from("age".to_string()).unwrap_err().contains("got 'age'"));
    assert!(Variable::try_from("measures.mass".to_string()).is_err());
}
