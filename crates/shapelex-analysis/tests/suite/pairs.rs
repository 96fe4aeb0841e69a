//! Pairs, disparity, trajectories, comparisons and bands against `tests/vectors/models/pairwise.json`, and their laws. Tolerances are those of
//! the source: 1e-10 relative, p equal, Z 1e-6.

use serde_json::Value;
use shapelex_analysis::inference::permutation::holm;
use shapelex_analysis::models::anova::{Model, Testing};
use shapelex_analysis::models::bands::Bands;
use shapelex_analysis::models::design::{Cell, Contrasts, Table, Values};
use shapelex_analysis::models::disparity::{About, DisparityOptions};
use shapelex_analysis::models::error::ModelError;
use shapelex_analysis::models::formula::{Formula, TermOrder};
use shapelex_analysis::models::groups::GroupWeights;
use shapelex_analysis::models::pairs::{PairStatistic, PairsOf, PairsOptions, PairsRecord, test_pairs};
use shapelex_analysis::models::resample::{ExchangedStatistic, Functions};
use shapelex_analysis::models::subspaces::SumType;
use shapelex_analysis::models::trajectories::{Trajectory, TrajectoryOptions};
use shapelex_analysis::watch::Unwatched;
use shapelex_numeric::dense::Matrix;

use crate::models::{SplitMix, close, load, numbers, response, table, texts};

/// The shapes of the vectors, and their exchanges.
struct Set {
    table: Table,
    y: Matrix,
    orders: Vec<Vec<usize>>,
}

impl Set {
    fn new(vectors: &Value) -> Self {
        let given = load("anova_given.json");
        let orders = SplitMix::orders(vectors["seed"].as_u64().unwrap(), 199, &vec![String::new(); 24]);
        Self { table: table(&given["data"]), y: response(&given["y"]), orders }
    }

    fn model(&self, formula: &str) -> Model {
        fitted(formula, &self.table, self.y.clone(), vec![1.0; 24])
    }

    fn testing(&self) -> Testing<'_> {
        Testing { given: Some(&self.orders), permutations: 199, ..Testing::default() }
    }
}

fn read(formula: &str) -> Formula {
    Formula::parse(formula, TermOrder::ByDegree).unwrap()
}

fn fitted(formula: &str, table: &Table, vectors: Matrix, weights: Vec<f64>) -> Model {
    Model::new(&read(formula), table, Contrasts::Treatment, vectors, weights).unwrap()
}

fn names(names: &[&str]) -> Vec<String> {
    names.iter().map(|name| (*name).to_owned()).collect()
}

/// Compares tests with those of the vectors, in the same order.
fn compare(found: &[ExchangedStatistic], wanted: &Value, what: &str) {
    let rows = wanted.as_array().unwrap();
    assert_eq!(found.len(), rows.len(), "{what}");
    for (found, wanted) in found.iter().zip(rows) {
        let what = format!("{what} {}", wanted["pair"]);
        close(found.value, wanted["value"].as_f64().unwrap(), 1e-10, &what);
        close(found.p.unwrap(), wanted["p"].as_f64().unwrap(), 1e-12, &what);
        if let (Some(critical), Some(z)) = (wanted["upper95"].as_f64(), wanted["z"].as_f64()) {
            close(found.critical95.unwrap(), critical, 1e-10, &what);
            assert!((found.z.unwrap() - z).abs() < 1e-6, "{what}: Z {:?} for {z}", found.z);
        }
    }
}

fn distances(pairs: &PairsRecord) -> Vec<ExchangedStatistic> {
    pairs.pairs.iter().map(|pair| pair.distance.clone().unwrap()).collect()
}

#[test]
fn means_and_slopes_of_pairs_are_those_of_the_vectors() {
    let vectors = load("pairwise.json");
    let (set, means) = (Set::new(&vectors), &vectors["means"]);
    let model = set.model("~ a*b + t");
    let options = PairsOptions { groups: names(&["a", "b"]), ..PairsOptions::default() };
    let found = model.pairs(&options, &set.table, None, &set.testing(), &Unwatched).unwrap();
    assert_eq!(found.null, means["null"].as_str().unwrap());
    let levels: Vec<String> = found.groups.iter().map(|group| group.name.replace(':', ".")).collect();
    assert_eq!(levels, texts(&means["levels"]));
    compare(&distances(&found), &means["distance"], "distance");
    let p: Vec<f64> = distances(&found).iter().map(|test| test.p.unwrap()).collect();
    let corrected: Vec<f64> = distances(&found).iter().map(|test| test.p_holm.unwrap()).collect();
    assert_eq!(corrected, holm(&p));
    // Rows of the means, and their angles about zero, which no request asks for.
    let groups = model.groups(&options.groups, "groups").unwrap();
    let rows = model.mean_rows(&groups, &set.table, GroupWeights::Observed);
    let functions = Functions::new(&model, groups.names, &rows, "groups").unwrap();
    let own = functions.vectors(&model);
    for (g, wanted) in means["least_squares_means"].as_array().unwrap().iter().enumerate() {
        for (i, wanted) in numbers(wanted).into_iter().enumerate() {
            assert!((own[(i, g)] - wanted).abs() < 1e-12, "{} for {wanted}", own[(i, g)]);
        }
    }
    let null = model.nested(&read(&found.null), &set.table, "null").unwrap();
    let statistics = [PairStatistic::Angle];
    let asked = (&statistics[..], false);
    let (tests, _) = test_pairs(&model, (&functions, &null), asked, &set.testing(), &Unwatched).unwrap();
    compare(&tests[0], &means["angle"], "angle about zero");

    let (slopes, model) = (&vectors["slopes"], set.model("~ a*t"));
    let statistics = [PairStatistic::Distance, PairStatistic::Angle, PairStatistic::LengthDifference];
    let options = PairsOptions {
        groups: names(&["a"]),
        of: PairsOf::Slopes,
        covariate: Some("t".into()),
        statistics: Some(statistics.to_vec()),
        ..PairsOptions::default()
    };
    let found = model.pairs(&options, &set.table, None, &set.testing(), &Unwatched).unwrap();
    assert_eq!(found.null, slopes["null"].as_str().unwrap());
    let pair = found.pairs[0].clone();
    compare(&[pair.distance.unwrap()], &slopes["distance"], "slopes, distance");
    compare(&[pair.angle.unwrap()], &slopes["angle"], "slopes, angle");
    compare(&[pair.length_difference.unwrap()], &slopes["length_difference"], "slopes, length");
    let groups = model.groups(&options.groups, "groups").unwrap();
    let rows = model.slope_rows(&groups, model.covariate("t", "t").unwrap(), "t").unwrap();
    let own = Functions::new(&model, groups.names, &rows, "t").unwrap().vectors(&model);
    for (g, wanted) in slopes["slopes"].as_array().unwrap().iter().enumerate() {
        let wanted = numbers(wanted);
        assert!((0..5).all(|i| (own[(i, g)] - wanted[i]).abs() < 1e-12), "{own} {wanted:?}");
    }
}

#[test]
fn disparity_and_trajectories_are_those_of_the_vectors() {
    let vectors = load("pairwise.json");
    let (set, wanted) = (Set::new(&vectors), &vectors["disparity"]);
    let model = set.model("~ b");
    for (options, wanted) in [
        (DisparityOptions { groups: names(&["b"]), ..DisparityOptions::default() }, wanted),
        (
            DisparityOptions {
                groups: names(&["b"]),
                about: About::Mean,
                partial: true,
                ..DisparityOptions::default()
            },
            &wanted["partial"],
        ),
    ] {
        let found = model.disparity(&options, &set.testing(), &Unwatched).unwrap();
        assert_eq!(found.formula, wanted["formula"].as_str().unwrap());
        for (group, wanted) in found.groups.iter().zip(numbers(&wanted["variance"])) {
            close(group.variance, wanted, 1e-10, &group.name);
        }
        let tests: Vec<ExchangedStatistic> = found.pairs.iter().map(|pair| pair.difference.clone()).collect();
        compare(&tests, &wanted["pairs"], &found.formula);
    }
    // About the model of the groups is about their means.
    let about = |about: About, unbiased: bool| {
        let options = DisparityOptions { groups: names(&["b"]), about, partial: false, unbiased };
        model.disparity(&options, &set.testing(), &Unwatched).unwrap().groups
    };
    for (own, other) in about(About::Groups, true).iter().zip(about(About::Model, true)) {
        close(own.variance, other.variance, 1e-12, &own.name);
        let biased = about(About::Groups, false).into_iter().find(|group| group.name == own.name).unwrap();
        let size = own.shapes as f64;
        close(own.variance, biased.variance * size / (size - 1.0), 1e-12, "unbiased");
    }

    let wanted = &vectors["trajectory"];
    let own: Vec<Trajectory> = wanted["points"]
        .as_array()
        .unwrap()
        .iter()
        .map(|points| Trajectory::new(&response(points)))
        .collect();
    for (i, trajectory) in own.iter().enumerate() {
        close(trajectory.length, wanted["lengths"][i].as_f64().unwrap(), 1e-10, "length");
        let direction = numbers(&wanted["directions"][i]);
        assert!(
            trajectory.direction.iter().zip(&direction).all(|(own, wanted)| (own - wanted).abs() < 1e-10)
        );
    }
    close(own[0].angle(&own[1]).to_degrees(), wanted["angle_degrees"].as_f64().unwrap(), 1e-10, "angle");
    close(own[0].distance(&own[1]), wanted["shape_distance"].as_f64().unwrap(), 1e-10, "shape");
}

#[test]
fn bands_of_predictions_are_those_of_the_vectors() {
    let vectors = load("pairwise.json");
    let (set, wanted) = (Set::new(&vectors), &vectors["prediction"]);
    let model = set.model("~ a*t");
    let at = |name: &str| wanted["at"][name].as_array().unwrap().clone();
    let rows: Vec<Vec<f64>> = (0..3)
        .map(|k| {
            let level = usize::from(at("a")[k] == "b");
            let number = at("t")[k].as_f64().unwrap();
            model.design.row(&|v| if v == 0 { Cell::Level(level) } else { Cell::Number(number) })
        })
        .collect();
    let leverages = numbers(&wanted["leverage"]);
    let bands = Bands { level: 0.95, samples: 1 };
    let found = model.bands(bands, (&rows, &leverages), None, &set.testing(), &Unwatched).unwrap();
    assert_eq!(model.degrees() as u64, wanted["degrees"].as_u64().unwrap());
    for (k, band) in found.iter().enumerate() {
        let own = |name: &str| numbers(&wanted[name][k]);
        for (i, (mean, new)) in own("half_width_95").iter().zip(own("half_width_95_new_shape")).enumerate() {
            close(band.half_width[i][0], *mean, 1e-10, "half width");
            close(band.half_width[i][0] * band.new_shape, new, 1e-10, "of a new shape");
            assert!((band.points[i][0] - own("predicted")[i]).abs() < 1e-12);
            let variance = numbers(&wanted["residual_variance"])[i];
            close(band.covariance[i][0], leverages[k] * variance, 1e-10, "covariance");
        }
        // Five places at once need more than one: Student's 2.09 and some.
        assert!((2.2..4.0).contains(&band.simultaneous.unwrap()), "{band:?}");
    }
}

/// Normal numbers, nearly: twelve uniform ones each.
fn normal(stream: &mut SplitMix) -> f64 {
    (0..12).map(|_| stream.below(1 << 30) as f64 / (1_u64 << 30) as f64).sum::<f64>() - 6.0
}

#[test]
fn intervals_and_simultaneous_bands_cover() {
    let mut stream = SplitMix(11);
    let groups: Vec<&str> = (0..24).map(|k| if k % 2 == 0 { "a" } else { "b" }).collect();
    let table = Table::default().with_factor("g", groups);
    let testing = Testing { permutations: 199, ..Testing::default() };
    let options = PairsOptions { groups: names(&["g"]), ..PairsOptions::default() };
    let (mut distances, mut shapes) = (0, 0);
    let trials = 200;
    for _ in 0..trials {
        // The second group lies 1.5 away, in the first of eight directions; the noise of each is 1.
        let vectors =
            Matrix::from_fn(8, 24, |i, k| normal(&mut stream) + if i == 0 && k % 2 == 1 { 1.5 } else { 0.0 });
        let model = fitted("~ g", &table, vectors, vec![1.0; 24]);
        let pairs = model.pairs(&options, &table, None, &testing, &Unwatched).unwrap();
        let interval = pairs.pairs[0].interval.unwrap();
        distances += usize::from((interval.low..=interval.high).contains(&1.5));
        let bands = Bands { level: 0.95, samples: 1 };
        let rows = [vec![1.0, 0.0]];
        let band =
            model.bands(bands, (&rows, &[1.0 / 12.0]), None, &testing, &Unwatched).unwrap().swap_remove(0);
        let factor = band.simultaneous.unwrap();
        let holds = |(point, deviation): (&Vec<f64>, &f64)| point[0].abs() <= factor * deviation;
        shapes += usize::from(band.points.iter().zip(&band.deviation).all(holds));
    }
    // The ball holds the difference in 95 %, and the interval more often; the standard error is 1.5 %.
    assert!(distances >= 185, "{distances} of {trials}");
    assert!((180..=198).contains(&shapes), "{shapes} of {trials}");
}

#[test]
fn a_comparison_of_nested_models_is_a_row_of_the_table() {
    let vectors = load("pairwise.json");
    let set = Set::new(&vectors);
    let model = set.model("~ t + a*b");
    let testing = Testing { kind: SumType::I, ..set.testing() };
    let row = model.anova(&testing, &Unwatched).unwrap().terms.swap_remove(3);
    let found = model.compare(&read("~ b + a + t"), &set.table, &testing, &Unwatched).unwrap();
    assert_eq!((found.terms.len(), row.term.as_str()), (1, "a:b"));
    let own = &found.terms[0];
    assert_eq!((&own.term, own.degrees, own.p), (&row.term, row.degrees, row.p));
    close(own.sum_of_squares, row.sum_of_squares, 1e-10, "sum of squares");
    close(own.f.unwrap(), row.f.unwrap(), 1e-10, "F");
    assert!((own.z.unwrap() - row.z.unwrap()).abs() < 1e-6);
    // Several terms at once, and what is not nested.
    let two = model.compare(&read("~ t"), &set.table, &testing, &Unwatched).unwrap();
    assert_eq!((two.terms[0].term.as_str(), two.terms[0].degrees), ("a + b + a:b", 5));
    for (reduced, said) in [
        ("~ I(t^2)", "expected a model within"),
        ("~ 0 + t", "with an intercept"),
        ("~ t + b*a", "a smaller model"),
        ("~ t + c", "got 'c'"),
    ] {
        let error = model.compare(&read(reduced), &set.table, &testing, &Unwatched).unwrap_err();
        assert!(error.to_string().contains(said), "{reduced}: {error}");
    }
}

/// All observed values of pairs, slopes, disparity and trajectories.
fn observed(table: &Table, vectors: &Matrix, weights: &[f64]) -> Vec<f64> {
    let testing = Testing { permutations: 0, ..Testing::default() };
    let model = |formula: &str| fitted(formula, table, vectors.clone(), weights.to_vec());
    let both = [PairStatistic::Distance, PairStatistic::LengthDifference];
    let mut found = Vec::new();
    for options in [
        PairsOptions { groups: names(&["a", "b"]), ..PairsOptions::default() },
        PairsOptions { groups: names(&["a"]), weights: GroupWeights::Equal, ..PairsOptions::default() },
        PairsOptions {
            groups: names(&["b"]),
            reference: Some("x".into()),
            statistics: Some(vec![PairStatistic::Angle]),
            ..PairsOptions::default()
        },
        PairsOptions {
            groups: names(&["a"]),
            of: PairsOf::Slopes,
            covariate: Some("t".into()),
            statistics: Some(both.to_vec()),
            ..PairsOptions::default()
        },
    ] {
        let pairs = model("~ a*b + a*t").pairs(&options, table, None, &testing, &Unwatched).unwrap();
        for pair in pairs.pairs {
            let tests = [pair.distance, pair.angle, pair.length_difference];
            found.extend(tests.into_iter().flatten().map(|test| test.value));
        }
    }
    for about in [About::Groups, About::Mean, About::Model] {
        let options = DisparityOptions { groups: names(&["b"]), about, partial: false, unbiased: false };
        let disparity = model("~ a + b").disparity(&options, &testing, &Unwatched).unwrap();
        found.extend(disparity.groups.iter().map(|group| group.variance));
    }
    let options = TrajectoryOptions { groups: names(&["a"]), points: "b".into(), null: None };
    let paths = model("~ a*b").trajectories(&options, table, None, &testing, &Unwatched).unwrap();
    found.extend(paths.groups.iter().map(|group| group.length));
    found.extend(paths.pairs.iter().flat_map(|pair| {
        [pair.angle.value, pair.length_difference.value, pair.shape.as_ref().unwrap().value]
    }));
    found
}

/// The shapes at these positions.
fn chosen(table: &Table, vectors: &Matrix, order: &[usize]) -> (Table, Matrix) {
    let attributes = table.attributes.iter().map(|(name, values)| {
        let values = match values {
            Values::Numbers(numbers) => Values::Numbers(order.iter().map(|&k| numbers[k]).collect()),
            Values::Texts(texts) => Values::Texts(order.iter().map(|&k| texts[k].clone()).collect()),
            Values::Levels { names, of_shapes } => Values::Levels {
                names: names.clone(),
                of_shapes: order.iter().map(|&k| of_shapes[k]).collect(),
            },
        };
        (name.clone(), values)
    });
    let moved = Matrix::from_fn(vectors.nrows(), order.len(), |i, k| vectors[(i, order[k])]);
    (Table { attributes: attributes.collect(), ..table.clone() }, moved)
}

#[test]
fn pairs_keep_the_laws_of_models() {
    let set = Set::new(&load("pairwise.json"));
    let own = observed(&set.table, &set.y, &[1.0; 24]);
    let same = |other: &[f64], what: &str| {
        assert_eq!(own.len(), other.len());
        own.iter().zip(other).for_each(|(own, other)| close(*other, *own, 1e-9, what));
    };
    let (table, vectors) = chosen(&set.table, &set.y, &set.orders[0]);
    same(&observed(&table, &vectors, &[1.0; 24]), "another order");
    // A constant added to the covariate.
    let mut moved = set.table.clone();
    let Some(Values::Numbers(t)) = moved.attributes.get_mut("t") else { panic!() };
    t.iter_mut().for_each(|t| *t += 40.0);
    same(&observed(&moved, &set.y, &[1.0; 24]), "a constant");
    // Weight 2 is the same shape twice.
    let order: Vec<usize> = (0..24).chain([3, 8, 20]).collect();
    let (table, vectors) = chosen(&set.table, &set.y, &order);
    let doubled = observed(&table, &vectors, &[1.0; 27]);
    let weights: Vec<f64> = (0..24).map(|k| if [3, 8, 20].contains(&k) { 2.0 } else { 1.0 }).collect();
    let weighted = observed(&set.table, &set.y, &weights);
    doubled.iter().zip(&weighted).for_each(|(two, one)| close(*one, *two, 1e-9, "weight 2"));
    assert!(own.iter().zip(&weighted).any(|(own, other)| (own - other).abs() > 1e-3));
    // The same bits again.
    let again = observed(&set.table, &set.y, &[1.0; 24]);
    assert_eq!(
        own.iter().map(|x| x.to_bits()).collect::<Vec<_>>(),
        again.iter().map(|x| x.to_bits()).collect::<Vec<_>>()
    );
}

#[test]
fn what_pairs_cannot_be_made_of_is_refused() {
    let set = Set::new(&load("pairwise.json"));
    let testing = set.testing();
    let refused = |formula: &str, options: PairsOptions, place: &str, said: &str| {
        let error = set.model(formula).pairs(&options, &set.table, None, &testing, &Unwatched).unwrap_err();
        let ModelError::Setting { field, detail } = error else { panic!("{formula}: {error}") };
        assert!(field == place && detail.contains(said), "{formula}: {field}, {detail}");
    };
    let of = |groups: &[&str]| PairsOptions { groups: names(groups), ..PairsOptions::default() };
    refused("~ a*b", of(&["c"]), "pairs/groups", "a, b, got 'c'");
    refused("~ a*b + t", of(&["t"]), "pairs/groups", "got 't'");
    refused("~ a", of(&["b"]), "pairs/groups", "a, got 'b'");
    refused("~ a", of(&["a", "a"]), "pairs/groups", "again");
    refused("~ a", of(&[]), "pairs/groups", "got none");
    refused("~ a*b + (1 | b)", of(&["a"]), "pairs", "random parts");
    let angle = Some(vec![PairStatistic::Angle]);
    refused("~ a", PairsOptions { statistics: angle.clone(), ..of(&["a"]) }, "pairs/statistics", "origin");
    refused("~ a", PairsOptions { null: Some("~ b".into()), ..of(&["a"]) }, "pairs/null", "within ~ a");
    refused("~ a", PairsOptions { null: Some("~ a".into()), ..of(&["a"]) }, "pairs/null", "smaller");
    refused("~ a", PairsOptions { null: Some("~ (".into()), ..of(&["a"]) }, "pairs/null", "character");
    refused("~ a", PairsOptions { reference: Some("z".into()), ..of(&["a"]) }, "pairs/reference", "got 'z'");
    refused(
        "~ a",
        PairsOptions { confidence: Some(1.0), ..of(&["a"]) },
        "pairs/confidence",
        "between 0 and 1",
    );
    let slopes = |covariate: Option<&str>| PairsOptions {
        of: PairsOf::Slopes,
        covariate: covariate.map(str::to_owned),
        ..of(&["a"])
    };
    refused("~ a*t", slopes(None), "pairs/covariate", "got none");
    refused("~ a*t", slopes(Some("b")), "pairs/covariate", "t, got 'b'");
    refused("~ a + t", slopes(Some("t")), "pairs/covariate", "interaction");
    // A group of one shape, and too many groups.
    let one = (0..24).map(|k| {
        if k == 5 {
            "alone"
        } else if k % 2 == 0 {
            "p"
        } else {
            "q"
        }
    });
    let many = (0..104).map(|k| format!("l{}", k / 2));
    let y = Matrix::from_fn(3, 104, |i, k| ((7 * i + 3 * k) as f64).sin());
    for (table, vectors, said) in [
        (Table::default().with_factor("g", one), set.y.clone(), "got one in 'alone'"),
        (Table::default().with_factor("g", many), y, "2 to 50 groups, got 52"),
    ] {
        let count = vectors.ncols();
        let model = fitted("~ g", &table, vectors, vec![1.0; count]);
        let error = model.pairs(&of(&["g"]), &table, None, &Testing::default(), &Unwatched).unwrap_err();
        assert!(error.to_string().contains(said), "{error}");
        let options = DisparityOptions { groups: names(&["g"]), ..DisparityOptions::default() };
        let error = model.disparity(&options, &Testing::default(), &Unwatched).unwrap_err();
        assert!(error.to_string().contains(said), "{error}");
    }
}
