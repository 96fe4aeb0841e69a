//! Cohorts without variation: copies of one shape, one shape, two, points on a line or in one place, weights far apart. All
//! results are finite, or what is expected instead is named.

use std::fmt::Debug;

use shapelex_analysis::AnalysisError;
use shapelex_analysis::accumulate::ShapesInMemory;
use shapelex_analysis::alignment::{Alignment, Method, mean_shape};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::dictionary::learn::learn;
use shapelex_analysis::dictionary::method::Method as Learning;
use shapelex_analysis::dictionary::recipe::Recipe;
use shapelex_analysis::dictionary::report::{ReportOptions, TrainingShapes};
use shapelex_analysis::distance::DistanceSpace;
use shapelex_analysis::drawing::{draw_atoms, view_of};
use shapelex_analysis::inference::aligned::{AlignedShapes, StudySpace, frame_for};
use shapelex_analysis::inference::compare::compare;
use shapelex_analysis::inference::error::StudyError;
use shapelex_analysis::inference::groups::Groups;
use shapelex_analysis::inference::permutation::Draws;
use shapelex_analysis::inference::records::GroupComparison;
use shapelex_analysis::inference::regress::regress;
use shapelex_analysis::inference::variables::{Values, Variable, Variables};
use shapelex_analysis::matching::Matching;
use shapelex_analysis::metric::Metric;
use shapelex_analysis::pca::Components;
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_geometry::drawing::svg::Style;
use shapelex_geometry::generator::GeneratorKind;
use shapelex_geometry::representation::{Representation, ShapeSpace};

/// Points of every shape.
const POINTS: usize = 8;

/// Shapes with their weights.
struct Cohort {
    name: &'static str,
    shapes: Vec<Vec<f64>>,
    weights: Vec<f64>,
}

/// Coordinates without a pattern, the first ones of all points first.
fn scattered(k: usize, dimension: usize) -> Vec<f64> {
    (0..dimension * POINTS).map(|i| (7.0 * i as f64 + 13.0 * k as f64 + (i * k) as f64 * 0.1).sin()).collect()
}

/// Points along a line through the origin.
fn on_a_line(k: usize, dimension: usize) -> Vec<f64> {
    let along = |i: usize| (i as f64 + 0.1 * k as f64).sin();
    (0..dimension).flat_map(|c| (0..POINTS).map(move |i| along(i) * (c + 1) as f64)).collect()
}

/// Shapes whose last coordinate is zero.
fn flat(k: usize, dimension: usize) -> Vec<f64> {
    let mut shape = scattered(k, dimension);
    shape[(dimension - 1) * POINTS..].fill(0.0);
    shape
}

fn cohorts(dimension: usize) -> Vec<Cohort> {
    let of = |name, shapes: Vec<Vec<f64>>| Cohort { name, weights: vec![1.0; shapes.len()], shapes };
    let copies = |count: usize| vec![scattered(0, dimension); count];
    let varied = |count: usize| (0..count).map(|k| scattered(k, dimension)).collect::<Vec<_>>();
    let weighted = |name, weight: fn(usize) -> f64| Cohort {
        name,
        shapes: varied(9),
        weights: (0..9).map(weight).collect(),
    };
    vec![
        of("four copies", copies(4)),
        of("nine copies", copies(9)),
        of("many copies", copies(40)),
        of("one", copies(1)),
        of("two", varied(2)),
        of("copies of two", [varied(2), varied(2), varied(2)].concat()),
        of("all but one equal", [copies(7), vec![scattered(1, dimension)]].concat()),
        of("lines", (0..6).map(|k| on_a_line(k, dimension)).collect()),
        of("copies of a line", vec![on_a_line(0, dimension); 6]),
        of("flat", (0..6).map(|k| flat(k, dimension)).collect()),
        of("points", vec![vec![0.0; dimension * POINTS]; 6]),
        of("points far off", vec![vec![1e9; dimension * POINTS]; 6]),
        weighted("one outweighs all", |k| if k == 4 { 1e16 } else { 1.0 }),
        weighted("one outweighs all by far", |k| if k == 4 { 1e100 } else { 1e-100 }),
        weighted("tiny weights", |_| 1e-100),
    ]
}

fn spaces() -> Vec<ShapeSpace> {
    let generator = GeneratorKind::Bspline { degree: 3 };
    let representations = [
        Representation::Landmarks { dimension: 2, points: POINTS },
        Representation::Landmarks { dimension: 3, points: POINTS },
        Representation::ClosedCurve { dimension: 2, control_points: POINTS, generator },
    ];
    representations.iter().map(|representation| ShapeSpace::new(representation).unwrap()).collect()
}

/// What every operation is asked under.
struct Setting<'a> {
    space: &'a ShapeSpace,
    metric: Metric,
    class: Transformation,
    alignment: Alignment,
    method: Method,
    matching: Matching,
}

impl<'a> Setting<'a> {
    /// `None` for a class that the method does not have in this dimension.
    fn new(space: &'a ShapeSpace, class: ClassName, alignment: Alignment) -> Option<Self> {
        let metric = Metric::of(space);
        let class = Transformation::Named(class);
        let method = Method::new(&class, alignment, metric.dimension()).ok()?;
        let matching = Matching::new(space, Correspondence::Landmarks, Direction::Given, Mirror::Forbid);
        Some(Self { space, metric, class, alignment, method, matching })
    }

    fn aligned(&self, cohort: &Cohort) -> Result<AlignedShapes<'_>, StudyError> {
        let Self { space, metric, method, matching, .. } = self;
        let tangent = self.class.removes_size();
        let study = StudySpace { space, metric, method, tangent, frame: frame_for(&self.class), matching };
        AlignedShapes::new(study, cohort.shapes.concat(), cohort.weights.clone(), &Unwatched)
    }

    fn comparison(&self, cohort: &Cohort, groups: usize) -> Result<GroupComparison, StudyError> {
        let count = cohort.shapes.len();
        let names = (0..groups).map(|group| group.to_string()).collect();
        let groups = Groups { names, labels: (0..count).map(|k| k % groups).collect() };
        let draws = Draws { strata: &vec![0; count], seed: 1, permutations: 19 };
        compare(&self.aligned(cohort)?, &groups, draws, POINTS, &Unwatched)
    }

    fn means_and_components(&self, cohort: &Cohort) -> Result<(), AnalysisError> {
        let (metric, method) = (&self.metric, &self.method);
        let shapes = cohort.shapes.concat();
        let source = ShapesInMemory::new(metric, method.translates(), shapes, cohort.weights.clone())?;
        let mean = mean_shape(&source, metric, method, frame_for(&self.class), &self.matching)?;
        assert_finite(cohort.name, &mean);
        for centred in [true, false] {
            let found = Components::new(&source, metric, &mean.whitened, centred, 3)?;
            assert_finite(cohort.name, &(&found.pca, &found.scores));
        }
        Ok(())
    }

    fn distances(&self, cohort: &Cohort) -> Result<(), AnalysisError> {
        let distances = DistanceSpace::new(&self.method, &self.matching)?;
        let prepared = distances.prepare_given(&self.metric, cohort.shapes.concat())?;
        assert_finite(cohort.name, &distances.matrix(&prepared, &|_| true)?);
        Ok(())
    }

    fn dictionary(&self, cohort: &Cohort, centre: bool) -> Result<(), AnalysisError> {
        let method = Learning::FunctionalPca { components: 3, centre };
        let mut recipe = Recipe::new(self.space.representation().clone(), self.class.clone(), method);
        recipe.alignment = self.alignment;
        let (control_points, weights) = (cohort.shapes.concat(), cohort.weights.clone());
        let shapes = recipe.setting()?.shapes(control_points.clone(), weights.clone())?;
        let dictionary = learn(&shapes, &recipe, &Unwatched)?.dictionary;
        assert_finite(cohort.name, &dictionary.content);
        let svg =
            draw_atoms(&view_of(self.space, &dictionary), "name", &dictionary).to_svg(&Style::default());
        assert!(svg.contains("<path") || svg.contains("<circle"), "{}: {svg}", cohort.name);
        let subjects = (0..weights.len()).collect();
        let training = TrainingShapes { control_points, weights, subjects };
        let options = ReportOptions { modes: 3, draws: 20, resamples: 10, seed: 1, measurements: Vec::new() };
        assert_finite(cohort.name, &dictionary.report(self.space, training, &options, &Unwatched)?);
        Ok(())
    }

    fn regression(&self, cohort: &Cohort) -> Result<(), StudyError> {
        let numbers = (0..cohort.shapes.len()).map(|k| (k * k) as f64).collect();
        let attribute = Variable { name: "age".into(), values: Values::Numbers(numbers) };
        let variables = Variables { covariates: Vec::new(), attribute };
        let draws = Draws { strata: &vec![0; cohort.shapes.len()], seed: 1, permutations: 19 };
        assert_finite(cohort.name, &regress(&self.aligned(cohort)?, &variables, draws, &Unwatched)?);
        Ok(())
    }
}

/// Checks every number in the text of a value.
#[track_caller]
fn assert_finite(name: &str, value: &impl Debug) {
    let text = format!("{value:?}");
    let words = text.split(|c: char| !c.is_alphanumeric());
    let found = words.into_iter().find(|word| ["NaN", "inf"].contains(word));
    assert_eq!(found, None, "{name}: {text}");
}

/// Whether a refusal says what is expected of the shapes; other errors are failures of the arithmetic.
fn is_of_shapes(error: &AnalysisError) -> bool {
    !matches!(error, AnalysisError::NoConvergence { .. } | AnalysisError::NotAnAccumulator)
}

#[track_caller]
fn assert_answered(name: &str, found: Result<(), AnalysisError>) {
    assert!(found.as_ref().err().is_none_or(is_of_shapes), "{name}: {found:?}");
}

#[track_caller]
fn assert_studied(name: &str, found: Result<(), StudyError>) {
    if let Err(StudyError::Analysis(error)) = found {
        assert_answered(name, Err(error));
    }
}

/// Every cohort under every class and method.
fn each(then: impl Fn(&Setting<'_>, &Cohort)) {
    let alignments = [Alignment::Projection, Alignment::Procrustes, Alignment::PartialProcrustes];
    let classes = [ClassName::Translation, ClassName::Similarity, ClassName::Affine];
    for space in spaces() {
        let cohorts = cohorts(space.representation().dimension());
        for (alignment, class) in alignments.iter().flat_map(|a| classes.iter().map(move |c| (*a, *c))) {
            let Some(setting) = Setting::new(&space, class, alignment) else { continue };
            cohorts.iter().for_each(|cohort| then(&setting, cohort));
        }
    }
}

#[test]
fn means_components_and_distances_are_finite() {
    each(|setting, cohort| {
        assert_answered(cohort.name, setting.means_and_components(cohort));
        assert_answered(cohort.name, setting.distances(cohort));
    });
}

#[test]
fn comparisons_and_regressions_are_finite() {
    each(|setting, cohort| {
        for groups in [2, 3] {
            let found = setting.comparison(cohort, groups).map(|found| assert_finite(cohort.name, &found));
            assert_studied(cohort.name, found);
        }
        assert_studied(cohort.name, setting.regression(cohort));
    });
}

#[test]
fn dictionaries_are_drawn_and_reported() {
    each(|setting, cohort| {
        for centre in [true, false] {
            assert_answered(cohort.name, setting.dictionary(cohort, centre));
        }
    });
}

#[test]
fn copies_in_groups_do_not_differ() {
    for space in spaces() {
        let copies = vec![scattered(0, space.representation().dimension()); 9];
        let cohort = Cohort { name: "copies", shapes: copies, weights: vec![1.0; 9] };
        for (class, alignment) in [
            (ClassName::Translation, Alignment::Projection),
            (ClassName::Similarity, Alignment::Procrustes),
            (ClassName::Similarity, Alignment::Projection),
        ] {
            let Some(setting) = Setting::new(&space, class, alignment) else { continue };
            let found = setting.comparison(&cohort, 3).unwrap();
            let overall = found.overall.unwrap();
            assert_eq!((overall.r_squared, overall.pseudo_f.test.p), (0.0, Some(1.0)));
            for pair in &found.pairs {
                let p = [&pair.distance, &pair.pseudo_f, &pair.hotelling].map(|found| found.test.p);
                assert_eq!((pair.components, pair.r_squared, p), (0, 0.0, [Some(1.0); 3]), "{pair:?}");
            }
        }
    }
}

/// Weights have no unit.
#[test]
fn components_do_not_depend_on_the_unit_of_the_weights() {
    let space = &spaces()[0];
    let setting = Setting::new(space, ClassName::Similarity, Alignment::Projection).unwrap();
    let explained = |weight: f64| {
        let shapes = (0..12).flat_map(|k| scattered(k, 2)).collect();
        let source = ShapesInMemory::new(&setting.metric, true, shapes, vec![weight; 12]).unwrap();
        let frame = frame_for(&setting.class);
        let mean = mean_shape(&source, &setting.metric, &setting.method, frame, &setting.matching).unwrap();
        Components::new(&source, &setting.metric, &mean.whitened, true, 2).unwrap().pca.explained
    };
    let wanted = explained(1.0);
    assert_eq!(wanted.len(), 2);
    for weight in [1e-100, 1e-15, 1e-13, 1e15, 1e100] {
        let found = explained(weight);
        assert_eq!(found.len(), 2, "{weight:e}");
        for (found, wanted) in found.iter().zip(&wanted) {
            assert!((found - wanted).abs() < 1e-12, "{weight:e}: {found} for {wanted}");
        }
    }
}
