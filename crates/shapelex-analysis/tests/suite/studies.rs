//! Whole studies of shapes in memory: comparisons of groups and regressions.

use std::f64::consts::TAU;
use std::sync::Mutex;

use shapelex_analysis::AnalysisError;
use shapelex_analysis::alignment::{Alignment, Method};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::inference::aligned::{AlignedShapes, StudySpace, frame_for};
use shapelex_analysis::inference::compare::compare;
use shapelex_analysis::inference::error::StudyError;
use shapelex_analysis::inference::groups::Groups;
use shapelex_analysis::inference::permutation::Draws;
use shapelex_analysis::inference::regress::regress;
use shapelex_analysis::inference::variables::{Values, Variable, Variables};
use shapelex_analysis::matching::Matching;
use shapelex_analysis::metric::Metric;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::{Unwatched, Watch};
use shapelex_geometry::representation::{Representation, ShapeSpace};

const POINTS: usize = 8;

/// Landmarks on an ellipse, bent by `bend`.
fn landmarks(k: usize, bend: f64) -> Vec<f64> {
    let noise = |i: usize| 0.05 * ((7 * k * k + 13 * i + 3) as f64).sin();
    let t = |i: usize| TAU * i as f64 / POINTS as f64;
    let x = (0..POINTS).map(|i| 2.0 * t(i).cos() + noise(i));
    let y = (0..POINTS).map(|i| t(i).sin() + bend * (2.0 * t(i)).cos() + noise(i + POINTS));
    x.chain(y).collect()
}

/// Aligns the shapes modulo `class`, and hands them on.
fn aligned<T>(
    class: ClassName,
    (shapes, weights): (Vec<f64>, Vec<f64>),
    then: impl FnOnce(Result<AlignedShapes<'_>, StudyError>) -> T,
) -> T {
    let space = ShapeSpace::new(&Representation::Landmarks { dimension: 2, points: POINTS }).unwrap();
    let (metric, class) = (Metric::of(&space), Transformation::Named(class));
    let method = Method::new(&class, Alignment::Projection, 2).unwrap();
    let matching = Matching::new(&space, Correspondence::Landmarks, Direction::Given, Mirror::Forbid);
    let frame = frame_for(&class);
    let tangent = class.removes_size();
    let study =
        StudySpace { space: &space, metric: &metric, method: &method, tangent, frame, matching: &matching };
    then(AlignedShapes::new(study, shapes, weights, &Unwatched))
}

/// `count` shapes in `groups` groups, the last of which is bent.
fn in_groups(count: usize, groups: usize) -> (Groups, Vec<f64>) {
    let labels: Vec<usize> = (0..count).map(|k| k * groups / count).collect();
    let bend = |label: usize| if label + 1 == groups { 0.5 } else { 0.0 };
    let shapes = labels.iter().enumerate().flat_map(|(k, &label)| landmarks(k, bend(label))).collect();
    (Groups { names: ["a", "b", "c"][..groups].iter().map(|&name| name.into()).collect(), labels }, shapes)
}

/// Keeps what is reported, and stops at a fraction.
struct Until(f64, Mutex<Vec<f64>>);

impl Watch for Until {
    fn stop(&self) -> bool {
        self.1.lock().unwrap().last().is_some_and(|&last| last >= self.0)
    }

    fn progress(&self, fraction: f64) {
        self.1.lock().unwrap().push(fraction);
    }
}

#[test]
fn only_the_bent_group_differs_from_the_others() {
    let (groups, shapes) = in_groups(18, 3);
    let draws = Draws { strata: &[0; 18], seed: 4, permutations: 399 };
    let found = aligned(ClassName::Similarity, (shapes, vec![1.0; 18]), |shapes| {
        compare(&shapes.unwrap(), &groups, draws, POINTS, &Unwatched).unwrap()
    });
    assert_eq!((found.exchangeable, found.groups.len(), found.pairs.len()), (18, 3, 3));
    // Six shapes a group: the spreads of so few differ by chance.
    assert!(found.warnings.iter().all(|warning| warning.contains("scatter")), "{:?}", found.warnings);
    assert!(found.overall.unwrap().pseudo_f.test.p.unwrap() < 0.01);
    for pair in &found.pairs {
        let (p, corrected) = (pair.pseudo_f.test.p.unwrap(), pair.pseudo_f.test.p_holm.unwrap());
        assert!(corrected >= p, "{corrected} {p}");
        assert_eq!(p < 0.02, pair.second == "c", "{} {}: {p}", pair.first, pair.second);
        assert_eq!((pair.effect.len(), pair.sizes.len()), (POINTS, 1));
    }
}

#[test]
fn a_study_counts_its_relabellings_and_stops_between_tests() {
    let (groups, shapes) = in_groups(18, 3);
    let draws = Draws { strata: &[0; 18], seed: 4, permutations: 19 };
    let watch = Until(0.3, Mutex::default());
    let found = aligned(ClassName::Similarity, (shapes, vec![1.0; 18]), |shapes| {
        compare(&shapes.unwrap(), &groups, draws, POINTS, &watch)
    });
    assert_eq!(found, Err(StudyError::Analysis(AnalysisError::Interrupted)));
    assert_eq!(watch.1.into_inner().unwrap(), [0.25, 0.5]);
}

#[test]
fn a_regression_finds_the_bend_and_predicts_it() {
    let bends: Vec<f64> = (0..20).map(|k| 0.02 * k as f64).collect();
    let shapes: Vec<f64> = bends.iter().enumerate().flat_map(|(k, &bend)| landmarks(k, bend)).collect();
    let kinds: Vec<String> = (0..20).map(|k| ["x", "y", "z"][k * k % 3].into()).collect();
    let variables = Variables {
        covariates: vec![Variable { name: "kind".into(), values: Values::category(&kinds) }],
        attribute: Variable { name: "bend".into(), values: Values::Numbers(bends.clone()) },
    };
    let draws = Draws { strata: &[0; 20], seed: 9, permutations: 199 };
    let found = aligned(ClassName::Translation, (shapes, vec![1.0; 20]), |shapes| {
        regress(&shapes.unwrap(), &variables, draws, &Unwatched).unwrap()
    });
    let record = &found.record;
    assert_eq!((record.test.exceeding, record.degrees, found.values), (0, 17, bends));
    // The landmark at t = 0 moves by one unit upwards per unit of the bend.
    let rise = record.change_per_unit[0][1];
    assert!((rise - 1.0).abs() < 0.2, "{rise}");
    assert!(record.predictions[0].attribute < record.predictions[2].attribute);
    assert!(found.scores[0] < found.scores[19], "{:?}", found.scores);
}

#[test]
fn what_cannot_be_studied_is_refused() {
    let (mut groups, shapes) = in_groups(6, 2);
    let heavy = vec![1.0, 1.0, 1.0, 1.0, 1.0, 1e10];
    let refused = aligned(ClassName::Similarity, (shapes.clone(), heavy), |shapes| shapes.map(|_| ()));
    assert_eq!(refused, Err(StudyError::Weights { smallest: 1.0, largest: 1e10 }));
    groups.labels = vec![0, 1, 1, 1, 1, 1];
    let draws = Draws { strata: &[0; 6], seed: 0, permutations: 9 };
    let variables = Variables {
        covariates: Vec::new(),
        attribute: Variable { name: "size".into(), values: Values::Numbers(vec![2.0; 6]) },
    };
    aligned(ClassName::Similarity, (shapes, vec![1.0; 6]), |shapes| {
        let shapes = shapes.unwrap();
        let lonely = compare(&shapes, &groups, draws, POINTS, &Unwatched);
        assert_eq!(lonely, Err(StudyError::FewMembers { group: "a".into(), found: 1 }));
        let constant = regress(&shapes, &variables, draws, &Unwatched);
        assert_eq!(constant, Err(StudyError::CollinearAttribute));
    });
}
