//! Linear models against the vectors of `tests/vectors/models`, with the tolerances of their source: sums of squares 1e-10 relative,
//! p equal, Z 1e-6.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;
use shapelex_analysis::alignment::{Alignment, Method};
use shapelex_analysis::correspondence::{Correspondence, Direction, Mirror};
use shapelex_analysis::inference::aligned::{AlignedShapes, StudySpace, frame_for};
use shapelex_analysis::matching::Matching;
use shapelex_analysis::metric::Metric;
use shapelex_analysis::models::anova::{Model, Statistic, Testing};
use shapelex_analysis::models::design::{Contrasts, Design, Table, Values};
use shapelex_analysis::models::effect_size::{Transform, effect_size};
use shapelex_analysis::models::formula::{Formula, TermOrder};
use shapelex_analysis::models::records::AnovaRecord;
use shapelex_analysis::models::subspaces::{Space, SumType};
use shapelex_analysis::transformation::{ClassName, Transformation};
use shapelex_analysis::watch::Unwatched;
use shapelex_geometry::representation::{Representation, ShapeSpace};
use shapelex_numeric::dense::Matrix;

pub(crate) fn load(name: &str) -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/vectors/models").join(name);
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

pub(super) fn data(set: &str) -> Option<PathBuf> {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data").join(set).join("landmarks.csv");
    if !path.exists() {
        println!("skipped: {set} is not here");
    }
    path.exists().then_some(path)
}

/// The stream of the vectors, for index lists alone.
pub(crate) struct SplitMix(pub(crate) u64);

impl SplitMix {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub(crate) fn below(&mut self, k: usize) -> usize {
        ((u128::from(self.next()) * k as u128) >> 64) as usize
    }

    /// A list in which the rows of each stratum are shuffled alone, in the order of the first appearance of the strata.
    fn order(&mut self, strata: &[String]) -> Vec<usize> {
        let mut order: Vec<usize> = (0..strata.len()).collect();
        let mut seen: Vec<&String> = Vec::new();
        strata.iter().for_each(|stratum| {
            if !seen.contains(&stratum) {
                seen.push(stratum);
            }
        });
        for stratum in seen {
            let members: Vec<usize> = (0..strata.len()).filter(|k| strata[*k] == *stratum).collect();
            let mut list = members.clone();
            for i in (1..list.len()).rev() {
                list.swap(i, self.below(i + 1));
            }
            members.iter().zip(list).for_each(|(&k, from)| order[k] = from);
        }
        order
    }

    pub(crate) fn orders(seed: u64, count: usize, strata: &[String]) -> Vec<Vec<usize>> {
        let mut stream = Self(seed);
        (0..count).map(|_| stream.order(strata)).collect()
    }
}

pub(crate) fn texts(value: &Value) -> Vec<String> {
    value.as_array().unwrap().iter().map(|text| text.as_str().unwrap().to_owned()).collect()
}

pub(crate) fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|number| number.as_f64().unwrap()).collect()
}

pub(crate) fn table(value: &Value) -> Table {
    let values = |value: &Value| match value[0].is_string() {
        true => Values::Texts(texts(value)),
        false => Values::Numbers(numbers(value)),
    };
    let attributes =
        value.as_object().unwrap().iter().map(|(name, value)| (name.clone(), values(value))).collect();
    Table { attributes, levels: BTreeMap::new() }
}

/// Rows of a response as columns of vectors.
pub(crate) fn response(value: &Value) -> Matrix {
    let rows: Vec<Vec<f64>> = value.as_array().unwrap().iter().map(numbers).collect();
    Matrix::from_fn(rows[0].len(), rows.len(), |i, k| rows[k][i])
}

fn contrasts(value: &Value) -> Contrasts {
    if value["contrasts"] == "sum" { Contrasts::Sum } else { Contrasts::Treatment }
}

fn kind(value: &Value) -> SumType {
    match value["type"].as_str().unwrap() {
        "I" => SumType::I,
        "II" => SumType::II,
        _ => SumType::III,
    }
}

fn formula(value: &Value) -> Formula {
    Formula::parse(value["formula"].as_str().unwrap(), TermOrder::ByDegree).unwrap()
}

#[track_caller]
pub(crate) fn close(found: f64, wanted: f64, tolerance: f64, what: &str) {
    assert!((found - wanted).abs() <= tolerance * wanted.abs().max(1e-300), "{what}: {found} for {wanted}");
}

/// Compares a table row by row.
fn compare(record: &AnovaRecord, wanted: &Value, tolerance: f64, what: &str) {
    let rows = wanted.as_array().unwrap();
    assert_eq!(record.terms.len() + 2, rows.len(), "{what}");
    for (found, wanted) in record.terms.iter().zip(rows) {
        let what = format!("{what}, {}", wanted["term"]);
        assert_eq!(found.term, wanted["term"].as_str().unwrap(), "{what}");
        assert_eq!(found.degrees as u64, wanted["df"].as_u64().unwrap(), "{what}");
        close(found.sum_of_squares, wanted["ss"].as_f64().unwrap(), tolerance, &what);
        close(found.mean_square.unwrap(), wanted["ms"].as_f64().unwrap(), tolerance, &what);
        close(found.f.unwrap(), wanted["f"].as_f64().unwrap(), 3.0 * tolerance, &what);
        if let (Some(p), Some(z)) = (wanted["p"].as_f64(), wanted["z"].as_f64()) {
            close(found.p.unwrap(), p, 1e-12, &format!("{what}, p"));
            // A flat likelihood, and tolerance of the response where it was aligned.
            let allowed = if tolerance > 1e-10 { 1e-4 } else { 1e-6 };
            assert!((found.z.unwrap() - z).abs() < allowed, "{what}: Z {} for {z}", found.z.unwrap());
        }
    }
    let (residual, total) = (&rows[rows.len() - 2], &rows[rows.len() - 1]);
    assert_eq!(record.residual.degrees as u64, residual["df"].as_u64().unwrap(), "{what}");
    close(record.residual.sum_of_squares, residual["ss"].as_f64().unwrap(), tolerance, what);
    assert_eq!(record.total.degrees as u64, total["df"].as_u64().unwrap(), "{what}");
    close(record.total.sum_of_squares, total["ss"].as_f64().unwrap(), tolerance, what);
}

#[test]
fn the_stream_of_the_vectors_is_theirs() {
    let vectors = load("permutations.json");
    let seed = vectors["seed"].as_u64().unwrap();
    let mut stream = SplitMix(seed);
    for word in texts(&vectors["first_words"]) {
        assert_eq!(stream.next().to_string(), word);
    }
    let lists = |value: &Value| -> Vec<Vec<usize>> {
        value
            .as_array()
            .unwrap()
            .iter()
            .map(|list| numbers(list).iter().map(|x| *x as usize).collect())
            .collect()
    };
    assert_eq!(SplitMix::orders(seed, 3, &vec![String::new(); 10]), lists(&vectors["n10"]));
    let strata = texts(&vectors["strata"]);
    assert_eq!(SplitMix::orders(seed, 3, &strata), lists(&vectors["in_strata"]));
}

#[test]
fn designs_have_the_columns_of_the_vectors() {
    let vectors = load("designs.json");
    let own = table(&vectors["data"]);
    for case in vectors["cases"].as_array().unwrap() {
        let formula = formula(case);
        let design = Design::new(&formula, &own, contrasts(case)).unwrap();
        let what = format!("{} {}", case["formula"], case["contrasts"]);
        assert_eq!(design.columns, texts(&case["columns"]), "{what}");
        let owners: Vec<u64> = design.term_of_column.iter().map(|owner| *owner as u64).collect();
        assert_eq!(serde_json::json!(owners), case["term_of_column"], "{what}");
        let terms: Vec<String> = formula.terms.iter().map(|term| formula.name(term)).collect();
        assert_eq!(terms, texts(&case["terms"]), "{what}");
        assert_eq!(formula.random.len(), case["random"].as_array().unwrap().len(), "{what}");
        let tolerance = if what.contains("poly") { 1e-10 } else { 1e-12 };
        for (k, row) in case["x"].as_array().unwrap().iter().enumerate() {
            for (j, wanted) in numbers(row).into_iter().enumerate() {
                let found = design.matrix[(k, j)];
                assert!((found - wanted).abs() <= tolerance, "{what} ({k}, {j}): {found} for {wanted}");
            }
        }
    }
    for case in vectors["refused"].as_array().unwrap() {
        let read = Formula::parse(case["formula"].as_str().unwrap(), TermOrder::ByDegree);
        let refused = read.is_err() || Design::new(&read.unwrap(), &own, Contrasts::Treatment).is_err();
        assert!(refused, "{case}");
    }
    let deficient = &vectors["rank_deficient"];
    let design = Design::new(&formula(deficient), &table(&deficient["data"]), Contrasts::Treatment).unwrap();
    let space = Space::new(&design, &[1.0; 10]).unwrap();
    assert_eq!(design.columns, texts(&deficient["columns"]));
    assert_eq!(space.dropped(&design), texts(&deficient["dropped"]));
}

#[test]
fn all_exchanges_give_the_p_values_of_enumeration() {
    for case in load("anova_exact.json")["cases"].as_array().unwrap() {
        let own = table(&case["data"]);
        let vectors = response(&case["y"]);
        let count = vectors.ncols();
        let model = Model::new(&formula(case), &own, contrasts(case), vectors, vec![1.0; count]).unwrap();
        let labels = |name: &Value| {
            let Values::Texts(texts) = &own.attributes[name.as_str().unwrap()] else { panic!() };
            shapelex_analysis::strata::strata(texts)
        };
        let strata = case.get("strata").map(labels);
        let blocks = case.get("blocks").map(labels);
        let testing = Testing {
            kind: kind(case),
            contrasts_of_three: contrasts(case),
            permutations: 50_000,
            strata: strata.as_deref(),
            blocks: blocks.as_deref(),
            ..Testing::default()
        };
        let record = model.anova(&testing, &Unwatched).unwrap();
        let mut wanted = case["table"].clone();
        if let Some(only) = case.get("only_term") {
            // The others are not tested by this exchange.
            wanted.as_array_mut().unwrap().iter_mut().filter(|row| row["term"] != *only).for_each(|row| {
                row.as_object_mut().unwrap().remove("p");
            });
        }
        compare(&record, &wanted, 1e-10, case["name"].as_str().unwrap());
        let tested = record.terms.last().unwrap();
        assert!(
            tested.exact && tested.permutations as u64 + 1 == case["evaluated"].as_u64().unwrap(),
            "{tested:?}"
        );
    }
}

#[test]
fn given_exchanges_give_the_p_values_and_sizes_of_the_vectors() {
    let vectors = load("anova_given.json");
    let orders = SplitMix::orders(vectors["seed"].as_u64().unwrap(), 199, &vec![String::new(); 24]);
    for case in vectors["cases"].as_array().unwrap() {
        let (mut own, mut y) = (table(&vectors["data"]), response(&vectors["y"]));
        match case["data"].as_str() {
            Some("nested") => {
                own = table(&vectors["nested"]["data"]);
                y = response(&vectors["nested"]["y"]);
            }
            Some(name) => {
                own.attributes.insert("b".into(), Values::Texts(texts(&vectors[name])));
            }
            None => {}
        }
        let weights = if case["weights"] == true { numbers(&vectors["w"]) } else { vec![1.0; 24] };
        let model = Model::new(&formula(case), &own, contrasts(case), y, weights).unwrap();
        let errors = [("site".to_owned(), "site:year".to_owned())];
        let mut testing = Testing {
            kind: kind(case),
            contrasts_of_three: contrasts(case),
            given: Some(&orders),
            error_terms: if case.get("error").is_some() { &errors } else { &[] },
            permutations: 199,
            rrpp: true,
            ..Testing::default()
        };
        let what = format!("{} {} {}", case["formula"], case["type"], case["contrasts"]);
        let record = model.anova(&testing, &Unwatched).unwrap();
        assert_eq!(record.design.dropped, texts(&case["dropped"]), "{what}");
        compare(&record, &case["table"], 1e-10, &what);
        if case.get("error").is_some() {
            let (found, wanted) = (&record.terms[0], &vectors["nested"]["site_by_exchanging_years"]);
            assert!(found.collapsed && found.exact && found.permutations == 69, "{found:?}");
            close(found.p.unwrap(), wanted["p"].as_f64().unwrap(), 1e-12, "p by years");
            assert!((found.z.unwrap() - wanted["z"].as_f64().unwrap()).abs() < 1e-6);
            let (found, wanted) = (found.rrpp.unwrap(), &case["table"][0]);
            close(found.p, wanted["p_rrpp"].as_f64().unwrap(), 1e-12, "p of RRPP");
            assert!((found.z.unwrap() - wanted["z_rrpp"].as_f64().unwrap()).abs() < 1e-6, "{found:?}");
        }
        testing.statistic = Statistic::SumOfSquares;
        let Some(sums) = case.get("table_of_ss") else { continue };
        let record = model.anova(&testing, &Unwatched).unwrap();
        for (found, wanted) in record.terms.iter().zip(sums.as_array().unwrap()) {
            close(found.p.unwrap(), wanted["p"].as_f64().unwrap(), 1e-12, &what);
            assert!((found.z.unwrap() - wanted["z"].as_f64().unwrap()).abs() < 1e-6, "{what}");
        }
    }
}

#[test]
fn effect_sizes_are_those_of_the_vectors() {
    for case in load("null_from_sums.json")["effect_size"].as_array().unwrap() {
        let found = effect_size(&numbers(&case["values"]), Transform::BoxCox).unwrap();
        close(found.lambda, case["lam"].as_f64().unwrap(), 1e-6, "λ");
        assert!((found.z - case["z"].as_f64().unwrap()).abs() < 1e-6);
    }
}

/// Columns of a table of landmarks: attributes as texts, coordinates one column a shape, coordinate-major, and the dimension.
pub(super) fn landmarks(path: &Path) -> (BTreeMap<String, Vec<String>>, Matrix, usize) {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    let is_coordinate =
        |name: &str| name[1..].parse::<usize>().is_ok() && matches!(&name[..1], "x" | "y" | "z");
    let coordinates: Vec<usize> = (0..names.len()).filter(|j| is_coordinate(names[*j])).collect();
    let dimension = 2 + usize::from(names.contains(&"z1"));
    let points = coordinates.len() / dimension;
    let value = |i: usize, k: usize| {
        rows[k][coordinates[i % points * dimension + i / points]].parse::<f64>().unwrap()
    };
    let vectors = Matrix::from_fn(coordinates.len(), rows.len(), value);
    let column = |j: usize| rows.iter().map(|row| row[j].to_owned()).collect();
    let attributes = (0..names.len())
        .filter(|j| !coordinates.contains(j))
        .map(|j| (names[j].to_owned(), column(j)))
        .collect();
    (attributes, vectors, dimension)
}

/// Shapes aligned as a case asks, one a column, and the logarithms of their centroid sizes.
pub(super) fn aligned(vectors: &Matrix, dimension: usize, alignment: &str) -> (Matrix, Vec<f64>) {
    let points = vectors.nrows() / dimension;
    let space = ShapeSpace::new(&Representation::Landmarks { dimension, points }).unwrap();
    let (metric, class) = (Metric::of(&space), Transformation::Named(ClassName::Similarity));
    let kind = if alignment == "tangent" { Alignment::PartialProcrustes } else { Alignment::Projection };
    let method = Method::new(&class, kind, dimension).unwrap();
    let matching = Matching::new(&space, Correspondence::Landmarks, Direction::Given, Mirror::Forbid);
    let (frame, tangent) = (frame_for(&class), alignment == "tangent");
    let study =
        StudySpace { space: &space, metric: &metric, method: &method, tangent, frame, matching: &matching };
    let weights = vec![1.0; vectors.ncols()];
    let shapes = AlignedShapes::new(study, vectors.as_slice().to_vec(), weights, &Unwatched).unwrap();
    (shapes.aligned.clone(), shapes.log_centroid_sizes().unwrap())
}

#[test]
fn tables_of_real_landmarks_are_those_of_the_vectors() {
    for case in load("anova_real.json")["cases"].as_array().unwrap() {
        let Some(path) = data(case["set"].as_str().unwrap()) else { return };
        let (columns, vectors, dimension) = landmarks(&path);
        let alignment = case["alignment"].as_str().unwrap();
        let (response, sizes) = match alignment {
            "as_given" => (vectors, Vec::new()),
            other => aligned(&vectors, dimension, other),
        };
        let count = response.ncols();
        let mut attributes = BTreeMap::new();
        for (name, column) in case["columns"].as_object().unwrap() {
            let own = &columns[column.as_str().unwrap()];
            let parsed: Option<Vec<f64>> = own.iter().map(|text| text.parse().ok()).collect();
            // The number of a rat is its name.
            let values =
                parsed.filter(|_| name != "rat").map_or_else(|| Values::Texts(own.clone()), Values::Numbers);
            attributes.insert(name.clone(), values);
        }
        if !sizes.is_empty() {
            attributes.insert("log_size".into(), Values::Numbers(sizes));
        }
        let own = Table { attributes, levels: BTreeMap::new() };
        let strata = case["strata"].as_str().map(|name| columns[name].clone());
        let strata = strata.unwrap_or_else(|| vec![String::new(); count]);
        let permutations = case["permutations"].as_u64().unwrap() as usize;
        let orders = SplitMix::orders(case["seed"].as_u64().unwrap(), permutations, &strata);
        let model = Model::new(&formula(case), &own, contrasts(case), response, vec![1.0; count]).unwrap();
        let testing = Testing {
            kind: kind(case),
            contrasts_of_three: contrasts(case),
            given: Some(&orders),
            permutations,
            ..Testing::default()
        };
        let what = format!("{} {} {} {alignment}", case["set"], case["formula"], case["type"]);
        let mut wanted = case["table"].clone();
        if !case["error"].is_null() {
            // F of the first row is a ratio to another term: see the collapsed table.
            wanted[0]["f"] = serde_json::json!(model.anova(&testing, &Unwatched).unwrap().terms[0].f);
        }
        let tolerance = match alignment {
            "as_given" => 1e-10,
            "tangent" => 1e-8,
            _ => 1e-9,
        };
        compare(&model.anova(&testing, &Unwatched).unwrap(), &wanted, tolerance, &what);
        let Some(collapsed) = case.get("collapsed") else { continue };
        let errors = [("species".to_owned(), "species:population".to_owned())];
        let testing = Testing { given: None, error_terms: &errors, permutations: 999, ..testing };
        let found = model.anova(&testing, &Unwatched).unwrap().terms.swap_remove(0);
        assert!(found.collapsed && !found.exact);
        close(found.sum_of_squares, collapsed["table"][0]["ss"].as_f64().unwrap(), 1e-10, &what);
        close(found.f.unwrap(), collapsed["table"][0]["f"].as_f64().unwrap(), 1e-9, &what);
        // Other draws: the standard error of p is .01.
        assert!(
            (found.p.unwrap() - collapsed["table"][0]["p"].as_f64().unwrap()).abs() < 0.04,
            "{what}: {:?}",
            found.p
        );
    }
}
