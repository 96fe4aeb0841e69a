//! Mixed models against the vectors of `tests/vectors/models/mixed.json`: log-likelihood 1e-8 absolute, coefficients 1e-6, variances 1e-5.

use serde_json::Value;
use shapelex_analysis::models::anova::{Model, Testing};
use shapelex_analysis::models::covariance::Covariance;
use shapelex_analysis::models::design::{Contrasts, Table};
use shapelex_analysis::models::error::ModelError;
use shapelex_analysis::models::exchange::ExchangeKind;
use shapelex_analysis::models::formula::{Formula, TermOrder};
use shapelex_analysis::models::mixed::records::RandomRecord;
use shapelex_analysis::models::mixed::{Criterion, RandomQuestion, Structure, estimate};
use shapelex_analysis::watch::Unwatched;
use shapelex_numeric::dense::Matrix;

use super::models::{aligned, close, data, landmarks, load, numbers, response, texts};

fn model(formula: &str, table: &Table, vectors: &Matrix) -> Model {
    let formula = Formula::parse(formula, TermOrder::ByDegree).unwrap();
    let weights = vec![1.0; vectors.ncols()];
    Model::new(&formula, table, Contrasts::Treatment, vectors.clone(), weights).unwrap()
}

fn question(structure: Structure, criterion: Criterion) -> RandomQuestion {
    RandomQuestion { structure: Some(structure), criterion, ..RandomQuestion::default() }
}

fn found(formula: &str, table: &Table, vectors: &Matrix, question: &RandomQuestion) -> RandomRecord {
    estimate(&model(formula, table, vectors), question, None, &Unwatched).unwrap()
}

fn case(value: &Value) -> (Table, Matrix) {
    let mut table = Table::default().with_factor("subject", texts(&value["subject"]));
    if value["x"].is_array() {
        table = table.with_numbers("x", numbers(&value["x"]));
    }
    if value["replicate"].is_array() {
        table = table.with_factor("replicate", texts(&value["replicate"]));
    }
    (table, response(&value["y"]))
}

fn coordinate(vectors: &Matrix, i: usize) -> Matrix {
    vectors.rows(i, 1).into_owned()
}

/// Compares a univariate estimate; on the boundary, its log-likelihood and coefficients alone.
#[track_caller]
fn compare(found: &RandomRecord, wanted: &Value, what: &str) {
    compare_likelihood(found, wanted, what);
    if found.boundary {
        return;
    }
    close(found.variance.within, wanted["sigma2"].as_f64().unwrap(), 1e-5, what);
    for (found, wanted) in found.variance.between.iter().zip(wanted["G"].as_array().unwrap()) {
        found.iter().zip(numbers(wanted)).for_each(|(found, wanted)| close(*found, wanted, 1e-5, what));
    }
}

#[track_caller]
fn compare_likelihood(found: &RandomRecord, wanted: &Value, what: &str) {
    let log_likelihood = wanted["loglik"].as_f64().unwrap();
    assert!((found.log_likelihood - log_likelihood).abs() < 1e-8, "{what}: {}", found.log_likelihood);
    let values: Vec<f64> = found.coefficients.iter().map(|column| column.value.unwrap()).collect();
    values.iter().zip(numbers(&wanted["beta"])).for_each(|(found, wanted)| close(*found, wanted, 1e-6, what));
}

#[test]
fn numbers_have_the_estimates_of_the_vectors() {
    let vectors = load("mixed.json");
    let (table, y) = case(&vectors["unbalanced"]);
    let cases = [
        ("random_intercept", "~ x + (1 | subject)", Structure::Scalar, Criterion::Reml),
        ("random_intercept", "~ x + (1 | subject)", Structure::ByScore, Criterion::Reml),
        ("random_intercept_ml", "~ x + (1 | subject)", Structure::Scalar, Criterion::Ml),
        ("random_slope", "~ x + (x | subject)", Structure::ByScore, Criterion::Reml),
    ];
    for (name, formula, structure, criterion) in cases {
        for (i, wanted) in vectors["unbalanced"][name].as_array().unwrap().iter().enumerate() {
            let found = found(formula, &table, &coordinate(&y, i), &question(structure, criterion));
            compare(&found, wanted, &format!("{name} {i} {structure:?}"));
            assert_eq!(found.boundary, name == "random_intercept" && i == 2, "{name} {i}: {found:?}");
        }
    }
}

#[test]
fn one_ratio_of_all_coordinates_is_that_of_the_vectors() {
    let vectors = load("mixed.json");
    let (table, y) = case(&vectors["unbalanced"]);
    for (name, criterion) in [("scalar_reml", Criterion::Reml), ("scalar_ml", Criterion::Ml)] {
        let wanted = &vectors["unbalanced"][name];
        let found = found("~ x + (1 | subject)", &table, &y, &question(Structure::Scalar, criterion));
        let log_likelihood = wanted["log_likelihood"].as_f64().unwrap();
        assert!((found.log_likelihood - log_likelihood).abs() < 1e-8, "{name}: {}", found.log_likelihood);
        close(found.icc.unwrap(), wanted["icc"].as_f64().unwrap(), 1e-7, name);
        close(found.variance.within, wanted["within_trace"].as_f64().unwrap(), 1e-7, name);
        close(found.variance.between[0][0], wanted["between_trace"].as_f64().unwrap(), 1e-7, name);
    }
}

#[test]
fn free_covariances_are_those_of_the_vectors() {
    let vectors = load("mixed.json");
    let (table, y) = case(&vectors["unbalanced"]);
    let y = y.rows(0, 2).into_owned();
    for (name, criterion) in [("multivariate_reml", Criterion::Reml), ("multivariate_ml", Criterion::Ml)] {
        let wanted = &vectors["unbalanced"][name];
        let question = RandomQuestion { scores: Some(2), ..question(Structure::Full, criterion) };
        let found = found("~ x + (1 | subject)", &table, &y, &question);
        let log_likelihood = wanted["log_likelihood"].as_f64().unwrap();
        assert!((found.log_likelihood - log_likelihood).abs() < 1e-8, "{name}: {}", found.log_likelihood);
        // Scores are turned coordinates: invariants of both covariances.
        for (found, wanted) in [(found.between, &wanted["between"]), (found.within, &wanted["within"])] {
            let [found, wanted] = [found.unwrap(), wanted.as_array().unwrap().iter().map(numbers).collect()];
            let trace = |m: &[Vec<f64>]| m[0][0] + m[1][1];
            let determinant = |m: &[Vec<f64>]| m[0][0] * m[1][1] - m[0][1] * m[1][0];
            close(trace(&found), trace(&wanted), 1e-5, name);
            close(determinant(&found), determinant(&wanted), 1e-5, name);
        }
    }
}

#[test]
fn sizes_of_rats_are_those_of_the_vectors() {
    let Some(path) = data("landmarks-rat-growth") else { return };
    let wanted = &load("mixed.json")["real"];
    let (columns, vectors, dimension) = landmarks(&path);
    let (_, sizes) = aligned(&vectors, dimension, "tangent");
    let ages = columns["age_days"].iter().map(|age| age.parse().unwrap());
    let table = Table::default().with_numbers("age", ages).with_factor("rat", columns["rat"].clone());
    let sizes = Matrix::from_row_slice(1, sizes.len(), &sizes);
    let intercept = found("~ log(age) + (1 | rat)", &table, &sizes, &RandomQuestion::default());
    compare_likelihood(&intercept, &wanted["random_intercept"], "intercept");
    // All rats have eight ages: variances of the mean squares, which the search of the vectors has to 1.2e-5 alone.
    let ages = model("~ log(age) + rat", &table, &sizes).anova(&Testing::default(), &Unwatched).unwrap();
    let (between, within) = (ages.terms[1].mean_square.unwrap(), ages.residual.mean_square);
    close(intercept.variance.within, within, 1e-9, "within");
    close(intercept.variance.between[0][0], (between - within) / 8.0, 1e-9, "between");
    let slope = found("~ log(age) + (log(age) | rat)", &table, &sizes, &RandomQuestion::default());
    // Slopes depend on intercepts.
    assert!(slope.boundary && slope.icc.is_none(), "{slope:?}");
    compare(&slope, &wanted["random_slope"], "slope");
}

#[test]
fn balanced_designs_have_the_estimates_of_their_mean_squares() {
    let vectors = load("mixed.json");
    let (table, y) = case(&vectors["balanced"]);
    let (wanted, scalar) = (&vectors["balanced"]["icc"], &vectors["balanced"]["scalar_reml"]);
    let question = RandomQuestion { subjects: true, ..question(Structure::Scalar, Criterion::Reml) };
    let one = found("~ 1 + (1 | subject)", &table, &y, &question);
    close(one.icc.unwrap(), wanted["icc"].as_f64().unwrap(), 1e-10, "ICC");
    close(one.icc.unwrap(), scalar["icc"].as_f64().unwrap(), 1e-9, "ICC of the search");
    close(one.variance.within, wanted["variance_within"].as_f64().unwrap(), 1e-10, "within");
    close(one.variance.between[0][0], wanted["variance_subject"].as_f64().unwrap(), 1e-10, "between");
    // Free covariances of two coordinates whose difference of mean squares is positive definite: their traces are the same sums.
    let y = y.rows(0, 2).into_owned();
    let ratio = found("~ 1 + (1 | subject)", &table, &y, &question);
    let free = RandomQuestion { scores: Some(2), ..self::question(Structure::Full, Criterion::Reml) };
    let free = found("~ 1 + (1 | subject)", &table, &y, &free);
    assert!(!free.boundary && free.converged, "{free:?}");
    close(free.variance.within, ratio.variance.within, 1e-7, "within");
    close(free.variance.between[0][0], ratio.variance.between[0][0], 1e-7, "between");
}

#[test]
fn groups_shrink_towards_the_model_by_their_reliability() {
    let vectors = load("mixed.json");
    let (table, y) = case(&vectors["balanced"]);
    let y = coordinate(&y, 0);
    for structure in [Structure::Scalar, Structure::ByScore, Structure::Full] {
        let question = RandomQuestion { subjects: true, ..question(structure, Criterion::Reml) };
        let found = found("~ 1 + (1 | subject)", &table, &y, &question);
        let ratio = found.variance.between[0][0] / found.variance.within;
        let (mean, kept) = (y.mean(), 3.0 * ratio / (1.0 + 3.0 * ratio));
        close(found.coefficients[0].value.unwrap(), mean, 1e-9, "balanced");
        for (i, subject) in found.subjects.iter().enumerate() {
            let own = y.columns(3 * i, 3).mean();
            close(subject.value.unwrap(), mean + kept * (own - mean), 1e-7, &format!("{structure:?} {i}"));
            close(subject.effects[0].value.unwrap(), kept * (own - mean), 1e-6, "effect");
            let posterior = found.variance.within * ratio / (1.0 + 3.0 * ratio);
            close(subject.covariance[0][0], posterior, 1e-6, "posterior");
            assert_eq!((subject.group.as_str(), subject.shapes), (i.to_string().as_str(), 3));
        }
    }
}

#[test]
fn the_order_of_the_shapes_changes_no_estimate() {
    let vectors = load("mixed.json");
    let (table, y) = case(&vectors["unbalanced"]);
    let order: Vec<usize> = (0..21).map(|k| k * 8 % 21).collect();
    let (subjects, x) = (texts(&vectors["unbalanced"]["subject"]), numbers(&vectors["unbalanced"]["x"]));
    let other = Table::default()
        .with_factor("subject", order.iter().map(|&k| subjects[k].clone()))
        .with_numbers("x", order.iter().map(|&k| x[k]));
    let turned = y.select_columns(&order);
    for (formula, structure) in [
        ("~ x + (1 | subject)", Structure::Scalar),
        ("~ x + (x | subject)", Structure::ByScore),
        ("~ x + (1 | subject)", Structure::Full),
    ] {
        let question = RandomQuestion { scores: Some(1), ..question(structure, Criterion::Reml) };
        let (a, b) = (found(formula, &table, &y, &question), found(formula, &other, &turned, &question));
        close(b.log_likelihood, a.log_likelihood, 1e-9, formula);
        close(b.variance.within, a.variance.within, 1e-6, formula);
    }
}

#[test]
fn what_the_shapes_do_not_determine_is_refused_with_its_numbers() {
    let vectors = load("mixed.json");
    let (table, y) = case(&vectors["unbalanced"]);
    let alone = table.clone().with_factor("own", (0..21).map(|k| format!("{k}")));
    let pairs = alone.with_factor("pair", (0..21).map(|k| format!("{}", k / 2)));
    let slope = question(Structure::ByScore, Criterion::Reml);
    let scalar = question(Structure::Scalar, Criterion::Reml);
    for (formula, question, wanted) in [
        ("~ x + (1 | own)", scalar, "0 of 21 groups"),
        ("~ x + (x | pair)", slope, "at most 2"),
        ("~ pair + (1 | pair)", scalar, "11 groups and 11 columns"),
        ("~ x + (x | subject)", scalar, "by_score"),
        ("~ x + (1 | subject) + (1 | pair)", scalar, "one random part"),
        ("~ x + (1 | subject)", RandomQuestion { scores: Some(9), ..slope }, "at most 3 scores"),
    ] {
        match estimate(&model(formula, &pairs, &y), &question, None, &Unwatched) {
            Err(ModelError::Unidentified { detail }) => {
                assert!(detail.contains(wanted), "{formula}: {detail}")
            }
            other => panic!("{formula}: {other:?}"),
        }
    }
}

/// Eight subjects at four values of `x`, with their own slopes; half of them have a treatment.
fn slopes() -> (Table, Matrix, Vec<f64>) {
    let own = |s: usize| 1.0 + 0.4 * (3.0 * s as f64).sin() + if s < 4 { 0.0 } else { 0.8 };
    let table = Table::default()
        .with_factor("subject", (0..32).map(|k| format!("{}", k / 4)))
        .with_factor("treatment", (0..32).map(|k| if k < 16 { "a" } else { "b" }))
        .with_numbers("x", (0..32).map(|k| (k % 4) as f64));
    // The noise is orthogonal to the values of x and to the mean of a subject.
    let noise = |k: usize| 0.1 * [1.0, -1.0, -1.0, 1.0][k % 4] * ((k / 4) as f64).cos().signum();
    let value = |k: usize| (k / 4) as f64 * 0.3 + own(k / 4) * (k % 4) as f64 + noise(k);
    (table, Matrix::from_fn(1, 32, |_, k| value(k)), (0..8).map(own).collect())
}

#[test]
fn effects_that_vary_are_tested_on_the_groups() {
    let (table, y, own) = slopes();
    let testing = Testing { permutations: 199, ..Testing::default() };
    let found = model("~ x + (x | subject)", &table, &y).anova(&testing, &Unwatched).unwrap();
    let names: Vec<&str> = found.terms.iter().map(|row| row.term.as_str()).collect();
    assert_eq!(names, ["x", "(1 | subject)", "(x | subject)"]);
    let row = &found.terms[0];
    let mean = own.iter().sum::<f64>() / 8.0;
    let variance = own.iter().map(|slope| (slope - mean).powi(2)).sum::<f64>() / 7.0;
    close(row.f.unwrap(), mean * mean / (variance / 8.0), 1e-9, "squared t");
    assert_eq!((row.exchange, row.exact, row.permutations), (ExchangeKind::Signs, true, 127));
    close(row.p.unwrap(), 1.0 / 128.0, 1e-12, "all slopes are positive");
    assert_eq!(row.error_term.as_deref(), Some("(1 + x | subject)"));
    let found = model("~ x*treatment + (x | subject)", &table, &y).anova(&testing, &Unwatched).unwrap();
    let row = found.terms.iter().find(|row| row.term == "x:treatment").unwrap();
    let [a, b] = [&own[..4], &own[4..]].map(|own| own.iter().sum::<f64>() / 4.0);
    let square = |own: &[f64], mean: f64| own.iter().map(|slope| (slope - mean).powi(2)).sum::<f64>();
    let within = (square(&own[..4], a) + square(&own[4..], b)) / 6.0;
    close(row.f.unwrap(), 2.0 * (a - b).powi(2) / within, 1e-9, "two groups");
    assert!(row.exact && row.permutations == 69 && row.collapsed, "{row:?}");
    let treatment = found.terms.iter().find(|row| row.term == "treatment").unwrap();
    assert_eq!(treatment.error_term.as_deref(), Some("subject"));
}

#[test]
fn one_number_has_the_multivariate_statistics_of_its_sums_of_squares() {
    let vectors = load("mixed.json");
    let (table, y) = case(&vectors["unbalanced"]);
    let testing = Testing { permutations: 199, ..Testing::default() };
    let one = model("~ x + subject", &table, &coordinate(&y, 0));
    let (anova, manova) =
        (one.anova(&testing, &Unwatched).unwrap(), one.manova(None, &testing, &Unwatched).unwrap());
    assert_eq!((manova.components, manova.terms.len()), (1, 2));
    for (row, term) in anova.terms.iter().zip(&manova.terms) {
        let share = row.partial_eta_squared;
        let ratio = share / (1.0 - share);
        for (found, wanted) in [
            (term.pillai, share),
            (term.wilks, 1.0 - share),
            (term.hotelling_lawley, ratio),
            (term.roy, ratio),
        ] {
            close(found.value, wanted, 1e-10, &row.term);
            close(found.p.unwrap(), row.p.unwrap(), 1e-12, &row.term);
        }
    }
    // All coordinates, turned and stretched: the statistics and their exchanges are the same.
    let stretch = Matrix::from_row_slice(3, 3, &[2.0, 0.3, 0.0, 0.0, 0.5, 0.1, 0.7, 0.0, 1.0]);
    let all = model("~ x + subject", &table, &y).manova(Some(3), &testing, &Unwatched).unwrap();
    let turned =
        model("~ x + subject", &table, &(stretch * &y)).manova(Some(3), &testing, &Unwatched).unwrap();
    assert!((all.explained - 1.0).abs() < 1e-12);
    for (a, b) in all.terms.iter().zip(&turned.terms) {
        for (a, b) in [
            (a.pillai, b.pillai),
            (a.wilks, b.wilks),
            (a.hotelling_lawley, b.hotelling_lawley),
            (a.roy, b.roy),
        ] {
            close(b.value, a.value, 1e-10, "stretched");
            assert_eq!(a.p, b.p);
        }
    }
    let refused = model("~ x + subject", &table, &y).manova(Some(4), &testing, &Unwatched);
    assert!(matches!(refused, Err(ModelError::Multivariate { detail }) if detail.contains("at most 3")));
}

fn with_covariance(table: &Table, y: &Matrix, weights: &[f64], lower: Option<Matrix>) -> Model {
    let formula = Formula::parse("~ x + subject", TermOrder::ByDegree).unwrap();
    Model::with_covariance(&formula, table, Contrasts::Treatment, y.clone(), weights.to_vec(), lower).unwrap()
}

#[test]
fn variances_are_weights_and_covariances_are_generalised_least_squares() {
    let vectors = load("mixed.json");
    let (table, y) = case(&vectors["unbalanced"]);
    let names: Vec<String> = (0..21).map(|k| format!("s{k}")).collect();
    let shapes: Vec<&str> = names.iter().map(String::as_str).collect();
    let variance = |k: usize| 1.0 + 0.1 * k as f64;
    let rows = |shared: f64| -> Vec<Vec<f64>> {
        let entry = |i: usize, j: usize| match i == j {
            true => variance(i),
            false => shared * (-(i.abs_diff(j) as f64)).exp(),
        };
        (0..21).map(|i| (0..21).map(|j| entry(i, j)).collect()).collect()
    };
    let testing = Testing { permutations: 49, ..Testing::default() };
    let lower = Covariance::of_rows(&names, rows(0.0)).unwrap().factor(&shapes).unwrap();
    let known = with_covariance(&table, &y, &[1.0; 21], Some(lower)).anova(&testing, &Unwatched).unwrap();
    let weights: Vec<f64> = (0..21).map(|k| variance(k).recip()).collect();
    let weighted = with_covariance(&table, &y, &weights, None).anova(&testing, &Unwatched).unwrap();
    close(known.total.sum_of_squares, weighted.total.sum_of_squares, 1e-10, "total");
    for (a, b) in known.terms.iter().zip(&weighted.terms) {
        close(a.f.unwrap(), b.f.unwrap(), 1e-10, &a.term);
        assert_eq!(a.p, b.p);
    }
    // With covariances: sums of squares about the generalised mean, in any order of the shapes.
    let covariance = Covariance::of_rows(&names, rows(0.8)).unwrap();
    let model = with_covariance(&table, &y, &[1.0; 21], Some(covariance.factor(&shapes).unwrap()));
    let inverse = Matrix::from_fn(21, 21, |i, j| rows(0.8)[i][j]).try_inverse().unwrap();
    let ones = Matrix::from_element(21, 1, 1.0);
    let scale = (ones.transpose() * &inverse * &ones)[(0, 0)];
    let mean = &y * &inverse * &ones / scale;
    let about = &y - mean * ones.transpose();
    let total = (&about * &inverse * about.transpose()).trace();
    let found = model.anova(&testing, &Unwatched).unwrap();
    close(found.total.sum_of_squares, total, 1e-10, "about the generalised mean");
    let turned: Vec<&str> = shapes.iter().rev().copied().collect();
    let texts = texts(&vectors["unbalanced"]["subject"]);
    let other = Table::default()
        .with_factor("subject", texts.into_iter().rev())
        .with_numbers("x", numbers(&vectors["unbalanced"]["x"]).into_iter().rev());
    let order: Vec<usize> = (0..21).rev().collect();
    let lower = covariance.factor(&turned).unwrap();
    let back = with_covariance(&other, &y.select_columns(&order), &[1.0; 21], Some(lower));
    for (a, b) in found.terms.iter().zip(&back.anova(&testing, &Unwatched).unwrap().terms) {
        close(b.sum_of_squares, a.sum_of_squares, 1e-9, &a.term);
    }
}

#[test]
fn trees_are_the_lengths_of_shared_branches() {
    let tree = Covariance::of_tree("((a:1,'b c':1)ab:0.5,[outgroup]d_e:1.5):9;").unwrap();
    let lower = tree.factor(&["d_e", "b c", "a"]).unwrap();
    let found = &lower * lower.transpose();
    let wanted = Matrix::from_row_slice(3, 3, &[1.5, 0.0, 0.0, 0.0, 1.5, 0.5, 0.0, 0.5, 1.5]);
    assert!((found - wanted).amax() < 1e-14);
    let refused = |text: &str| match Covariance::of_tree(text) {
        Err(ModelError::Covariance { detail }) => detail,
        other => panic!("{text}: {other:?}"),
    };
    for (text, wanted) in [
        ("((a:1,b:1):1,c:2)", "ends with ';'"),
        ("(a:1,b);", "length of a branch before this place, got '' at character 7"),
        ("(a:1,b:-1);", "got '-1'"),
        ("(a:1,a:1);", "'a' twice"),
        ("(a:1,b:1)); ", "as many brackets"),
        ("a:1;", "got ';'"),
        ("(a:1,:1);", "name of a tip"),
        ("(a:1,b:1);c", "the end, got 'c'"),
    ] {
        let detail = refused(text);
        assert!(detail.contains(wanted), "{text}: {detail}");
    }
    let missing = tree.factor(&["a", "z"]).unwrap_err().to_string();
    assert!(missing.contains("none for 'z'"), "{missing}");
    assert!(tree.factor(&["a", "a"]).unwrap_err().to_string().contains("several of 'a'"));
    let names = ["a".to_owned(), "b".to_owned()];
    let flat = Covariance::of_rows(&names, vec![vec![1.0, 2.0], vec![2.0, 1.0]]).unwrap();
    let pivot = flat.factor(&["a", "b"]).unwrap_err().to_string();
    assert!(pivot.contains("pivot of -3.0e0"), "{pivot}");
    assert!(Covariance::of_rows(&names, vec![vec![1.0, 2.0], vec![1.0, 1.0]]).is_err());
}
