//! Whole pipelines on shapes in memory: learn, use, validate, continue, compare.

use std::f64::consts::TAU;
use std::sync::Mutex;

use shapelex_analysis::AnalysisError;
use shapelex_analysis::accumulate::ShapesInMemory;
use shapelex_analysis::assessment::Assessor;
use shapelex_analysis::classification::labels::ClassLabels;
use shapelex_analysis::classification::study::train_classifier;
use shapelex_analysis::classifier_record::{ClassifierKind, ClassifierSettings};
use shapelex_analysis::dictionary::content::HoldOut;
use shapelex_analysis::dictionary::in_use::Dictionary;
use shapelex_analysis::dictionary::learn::{Learner, Learnt, learn};
use shapelex_analysis::dictionary::learning::Schedule;
use shapelex_analysis::dictionary::method::Method;
use shapelex_analysis::dictionary::procedure::Previous;
use shapelex_analysis::dictionary::recipe::{Recipe, Setting};
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::{Phase, Unwatched, Watch};
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::Representation;

const POINTS: usize = 16;

/// Control points of outlines: every second one has three corners.
fn outlines(count: usize) -> Vec<f64> {
    let outline = |k: usize| {
        let corners = 0.15 * (k % 2) as f64 + 0.05 * (7.0 * k as f64).sin();
        let other = 0.1 * (5.0 * k as f64).cos();
        let radius = move |u: f64| 1.0 + corners * (3.0 * u).cos() + other * (2.0 * u).sin();
        let coordinate = move |i: usize, turn: f64| {
            let u = TAU * i as f64 / POINTS as f64;
            k as f64 + radius(u) * (u - turn).cos()
        };
        (0..2 * POINTS).map(move |i| coordinate(i % POINTS, if i < POINTS { 0.0 } else { TAU / 4.0 }))
    };
    (0..count).flat_map(outline).collect()
}

fn recipe(method: Method) -> Recipe {
    let generator = GeneratorKind::Bspline { degree: 3 };
    let representation = Representation::ClosedCurve { dimension: 2, control_points: POINTS, generator };
    Recipe::new(representation, Transformation::Named(ClassName::Similarity), method)
}

fn prepared(setting: &Setting, count: usize) -> ShapesInMemory {
    setting.shapes(outlines(count), vec![1.0; count]).unwrap()
}

fn learnt(method: Method, count: usize) -> (ShapesInMemory, Learnt) {
    let recipe = recipe(method);
    let shapes = prepared(&recipe.setting().unwrap(), count);
    let learnt = learn(&shapes, &recipe, &Unwatched).unwrap();
    (shapes, learnt)
}

/// Records the phases; stops when the last allowed one begins.
struct Recorded {
    phases: Mutex<Vec<Phase>>,
    last: Phase,
}

impl Watch for Recorded {
    fn stop(&self) -> bool {
        self.phases.lock().unwrap().contains(&self.last)
    }

    fn phase(&self, phase: Phase, _: f64) {
        let mut phases = self.phases.lock().unwrap();
        if phases.last() != Some(&phase) {
            phases.push(phase);
        }
    }
}

#[test]
fn components_are_learnt_with_certificate_and_held_out_shapes() {
    let (_, Learnt { dictionary, .. }) = learnt(Method::components(2, true), 40);
    let statistics = &dictionary.content.statistics;
    assert_eq!((statistics.shapes, dictionary.content.atoms.len()), (40, 2));
    let held_out = statistics.held_out.as_ref().unwrap();
    assert_eq!((held_out.method, held_out.novelty.len()), (HoldOut::LeaveOneOut, 40));
    let coded = dictionary.encode(&outlines(4), &Unwatched).unwrap();
    let scores: Vec<_> = coded.iter().map(|coded| dictionary.score(coded, 0.99)).collect();
    assert!(scores.iter().all(|score| !score.outlier && score.scores.as_ref().unwrap().len() == 2));
    let mut square = outlines(1);
    square[0] += 2.0;
    let odd = dictionary.encode(&square, &Unwatched).unwrap();
    assert!(dictionary.score(&odd[0], 0.99).outlier);
}

#[test]
fn sparse_atoms_are_learnt_and_reconstruct() {
    let (_, Learnt { dictionary, .. }) = learnt(Method::sparse(3, 0.01), 40);
    assert_eq!(dictionary.content.statistics.held_out.as_ref().unwrap().method, HoldOut::Parts);
    let space = recipe(Method::sparse(3, 0.01)).setting().unwrap().space;
    for coded in dictionary.encode(&outlines(3), &Unwatched).unwrap() {
        let found = dictionary.reconstruct(&space, &coded, Default::default(), 10).unwrap();
        assert!(found.relative_error.unwrap() < 0.05 && found.residual.len() == 10, "{found:?}");
    }
    assert!(dictionary.mode(0, 1.0).is_none() && dictionary.sampler(0, 1.0).is_none());
}

/// At the default tolerance, an objective that has converged is within a thousandth of where a run of many passes ends.
#[test]
fn learning_ends_within_a_thousandth_of_its_end() {
    for (atoms, lambda, online) in [(6, 0.02, true), (12, 0.01, true), (12, 0.01, false)] {
        let by = |wanted: Option<f64>| {
            let mut method = Method::sparse(atoms, lambda);
            if let Method::Sparse { tolerance, max_epochs, schedule, .. } = &mut method {
                *schedule = if online { Schedule::Online } else { Schedule::Batch };
                *tolerance = wanted.unwrap_or(*tolerance);
                *max_epochs = 2000;
            }
            learnt(method, 150).1.dictionary.content.statistics
        };
        let (found, end) = (by(None), by(Some(1e-7)));
        assert!(found.converged && found.history.len() < end.history.len());
        let off = found.history.last().unwrap() / end.history.last().unwrap() - 1.0;
        assert!(off < 1e-3, "{atoms} atoms, {lambda}: {off:e} after {} passes", found.history.len());
    }
}

/// The content depends on the shapes and the recipe alone, and prepares the same dictionary again.
#[test]
fn the_same_shapes_give_the_same_content() {
    for method in [Method::components(3, false), Method::sparse(4, 0.05)] {
        let (first, second) = (learnt(method.clone(), 30).1, learnt(method, 30).1);
        assert_eq!(first.dictionary.content, second.dictionary.content);
        assert_eq!(first.state, second.state);
        let setting = Recipe::of(&first.dictionary.content).setting().unwrap();
        let again = Dictionary::new(first.dictionary.content.clone(), setting.measured()).unwrap();
        let codes = |dictionary: &Dictionary| dictionary.encode(&outlines(5), &Unwatched).unwrap();
        assert_eq!(codes(&first.dictionary), codes(&again));
    }
}

#[test]
fn a_version_continues_with_new_shapes() {
    let recipe = recipe(Method::components(2, true));
    let setting = recipe.setting().unwrap();
    let (all, first) = (prepared(&setting, 30), prepared(&setting, 20));
    let length = 2 * POINTS;
    let new = ShapesInMemory::prepared(all.all().whitened[20 * length..].to_vec(), vec![1.0; 10]);
    let learner =
        Learner { recipe: &recipe, measured: setting.measured(), watch: &Unwatched, help: &|_| Ok(None) };
    let earlier = learner.learn(&first).unwrap();
    let previous = Previous { content: &earlier.dictionary.content, state: &earlier.state };
    let later = learner.continue_from(previous, &all, &new).unwrap().dictionary.content;
    assert_eq!((later.statistics.shapes, later.statistics.weight), (30, 30.0));
    assert_eq!(later.mean, earlier.dictionary.content.mean);
    let wrong = Previous { state: &[1, 2, 3], ..previous };
    assert_eq!(learner.continue_from(wrong, &all, &new).unwrap_err(), AnalysisError::NotAnAccumulator);
}

#[test]
fn a_classifier_is_trained_validated_and_applied() {
    let (shapes, Learnt { dictionary, .. }) = learnt(Method::components(4, true), 40);
    let names: Vec<String> = (0..40).map(|k| ["round", "cornered"][k % 2].into()).collect();
    let labels = ClassLabels::from_names(&names);
    let settings = ClassifierSettings::new(ClassifierKind::Discriminant);
    let record = train_classifier(&dictionary, &shapes, &labels, &settings, &Unwatched).unwrap();
    assert!(record.validation.accuracy.value > 0.9, "{:?}", record.validation);
    let assessor = Assessor::trained(dictionary, record);
    let coded = assessor.dictionary.encode(&outlines(2), &Unwatched).unwrap();
    let found = assessor.classify(&coded, 0.99).unwrap().unwrap();
    let label = |k: usize| labels.labels[found[k].ranking[0].class].as_str();
    assert_eq!([label(0), label(1)], ["round", "cornered"]);
}

/// A class whose subjects all have shapes of another class too cannot be left out of the training.
#[test]
fn a_class_that_no_fold_leaves_is_named() {
    let (shapes, Learnt { dictionary, .. }) = learnt(Method::components(2, true), 8);
    let names: Vec<String> = (0..8).map(|k| if k < 6 { "a" } else { "b" }.into()).collect();
    let subjects: Vec<Option<String>> = (0..8).map(|k| (k >= 4).then(|| "one".into())).collect();
    let labels = ClassLabels::new(&names, &subjects);
    let settings = ClassifierSettings { folds: 2, ..ClassifierSettings::new(ClassifierKind::MeanSpace) };
    let error = train_classifier(&dictionary, &shapes, &labels, &settings, &Unwatched).unwrap_err();
    let AnalysisError::Parameter { field, detail } = error else { panic!("{error}") };
    assert!(field == "classifier.folds" && detail.contains("'b'"), "{field}: {detail}");
}

#[test]
fn drift_is_none_for_the_training_shapes() {
    let (shapes, Learnt { dictionary, .. }) = learnt(Method::components(2, true), 40);
    let assessor = Assessor::new(dictionary);
    let drift = assessor.drift(&shapes, &|_| unreachable!("nothing is searched"), 0.99, &Unwatched);
    let drift = drift.unwrap();
    assert_eq!(drift.shapes, 40);
    assert!(drift.outliers <= 2 && drift.mean.unwrap().angle_deg < 1e-6, "{}", drift.outliers);
    assert!(drift.scores.unwrap().iter().all(|score| score.shift.abs() < 1e-9));
    let none = ShapesInMemory::prepared(Vec::new(), Vec::new());
    let drift = assessor.drift(&none, &|_| unreachable!("nothing is new"), 0.99, &Unwatched).unwrap();
    assert_eq!(drift, Default::default());
}

#[test]
fn a_watch_sees_the_phases_and_stops_them() {
    let recipe = recipe(Method::components(2, true));
    let shapes = prepared(&recipe.setting().unwrap(), 20);
    let all = Recorded { phases: Mutex::default(), last: Phase::Validate };
    learn(&shapes, &recipe, &all).unwrap();
    let wanted = [Phase::Mean, Phase::Align, Phase::Learn, Phase::Certify, Phase::HoldOut];
    assert_eq!(*all.phases.lock().unwrap(), wanted);
    let some = Recorded { phases: Mutex::default(), last: Phase::Learn };
    assert_eq!(learn(&shapes, &recipe, &some).unwrap_err(), AnalysisError::Interrupted);
}
