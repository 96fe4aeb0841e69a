//! Linear models of stored shapes, beside the tables of geomorph 4.0.8 and RRPP 2.1.2, and what is refused.

use std::path::Path;

use serde_json::{Value, json};

use crate::server::Server;

pub(crate) fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("a number, got {value}"))
}

/// A table of landmarks, if it is there: its attributes are `labels`, texts but those of `numbers`.
pub(crate) fn cohort(server: &Server, name: &str, numbers: &[&str]) -> bool {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data").join(name).join("landmarks.csv");
    let Ok(text) = std::fs::read_to_string(file) else {
        println!("SKIPPED: {name} is not beside the project");
        return false;
    };
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let first = names.iter().position(|name| *name == "x1").unwrap();
    let shape = |line: &str| {
        let fields: Vec<&str> = line.split(',').collect();
        let points: Vec<f64> = fields[first..].iter().map(|field| field.parse().unwrap()).collect();
        let label = |k: usize| match numbers.contains(&names[k]) {
            true => (names[k].to_owned(), json!(fields[k].parse::<f64>().unwrap())),
            false => (names[k].to_owned(), json!(fields[k])),
        };
        let labels: serde_json::Map<String, Value> = (1..first).map(label).collect();
        json!({"external_id": fields[0], "labels": labels, "points": points.chunks(2).collect::<Vec<_>>()})
    };
    let shapes: Vec<Value> = lines.map(shape).collect();
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": (names.len() - first) / 2});
    server.post("/v1/cohorts", &json!({"name": name, "representation": representation})).expect(201);
    server.post(&format!("/v1/cohorts/{name}/shapes"), &json!({"shapes": shapes})).expect(201);
    true
}

/// Compares F of the terms with digits as they are printed.
#[track_caller]
fn prints(model: &Value, wanted: &[(&str, &str)]) {
    let terms = model["terms"].as_array().unwrap();
    assert_eq!(terms.len(), wanted.len(), "{model}");
    for (term, (name, digits)) in terms.iter().zip(wanted) {
        let places = digits.split_once('.').map_or(0, |(_, rest)| rest.len());
        let found = format!("{:.places$}", number(&term["f"]));
        assert_eq!((term["term"].as_str().unwrap(), found.as_str()), (*name, *digits));
    }
}

#[test]
fn salamanders_have_the_table_of_geomorph() {
    let server = Server::fresh();
    if !cohort(&server, "landmarks-plethodon", &[]) {
        return;
    }
    let body = json!({"cohort": "landmarks-plethodon", "formula": "~ species*site", "permutations": 199});
    let model = server.post("/v1/models", &body).expect(200);
    prints(&model, &[("species", "14.544"), ("site", "32.000"), ("species:site", "15.353")]);
    assert_eq!(
        (&model["formula"], &model["type"]),
        (&json!("~ species + site + species:site"), &json!("II"))
    );
    assert!((number(&model["total"]["sum_of_squares"]) - 0.196_939_732_825_42).abs() < 2e-7, "{model}");
    assert_eq!((&model["residual"]["df"], &model["total"]["df"]), (&json!(36), &json!(39)));
    for term in model["terms"].as_array().unwrap() {
        assert_eq!((&term["df"], &term["p"], &term["exchange"]), (&json!(1), &json!(0.005), &json!("free")));
        let counts = term["histogram"]["counts"].as_array().unwrap();
        assert_eq!(counts.iter().map(|count| count.as_u64().unwrap()).sum::<u64>(), 199);
        assert!((3.0..7.0).contains(&number(&term["z"])), "{term}");
    }
    // Balanced: the types agree, and those of treatment contrasts in type III are another question.
    for (kind, contrasts) in [("I", "treatment"), ("III", "sum")] {
        let mut other = body.clone();
        other["type"] = json!(kind);
        other["contrasts"] = json!(contrasts);
        let other = server.post("/v1/models", &other).expect(200);
        prints(&other, &[("species", "14.544"), ("site", "32.000"), ("species:site", "15.353")]);
    }
    let mut treatment = body.clone();
    treatment["type"] = json!("III");
    treatment["contrasts"] = json!("treatment");
    let treatment = server.post("/v1/models", &treatment).expect(200);
    prints(&treatment, &[("species", "1.471"), ("site", "22.747"), ("species:site", "15.353")]);
    assert!(treatment["warnings"].to_string().contains("reference level"), "{treatment}");
    // Predicted shapes of the cells differ by the coefficient, and the picture holds the table.
    let mut at = body.clone();
    at["at"] =
        json!([{"species": "Jord", "site": "Symp"}, {"species": "Teyah", "site": "Symp"}, {"site": "Symp"}]);
    let found = server.post("/v1/models", &at).expect(200);
    let shape = |k: usize| found["predictions"][k]["shape"][0][0].clone();
    let average = (number(&shape(0)) + number(&shape(1))) / 2.0;
    assert!((number(&shape(2)) - average).abs() < 1e-12, "balanced");
    assert!((number(&found["predictions"][0]["leverage"]) - 0.1).abs() < 1e-12, "ten shapes of a cell");
    let picture = server.post("/v1/models?format=svg", &at);
    let picture = picture.expect_svg();
    assert!(picture.contains("Teyah, Symp") || picture.contains("Symp, Teyah"), "{picture}");
    for cell in ["species:site<", ">0.15682<", ">15.353<", ">Residuals<"] {
        assert!(picture.contains(cell), "{cell}: {picture}");
    }
    let text = found["text"].as_str().unwrap();
    assert!(text.starts_with("~ species + site + species:site\n") && text.contains("  15.353  "), "{text}");
}

#[test]
fn pupfish_print_as_in_the_manual_of_rrpp() {
    let server = Server::fresh();
    if !cohort(&server, "landmarks-pupfish", &["centroid_size"]) {
        return;
    }
    // The coordinates of the file are aligned already, with sliding semilandmarks: only their position is taken out.
    let body = json!({"cohort": "landmarks-pupfish", "transformation": "translation", "type": "I", "permutations": 199,
        "formula": "~ log(centroid_size) + sex*population"});
    let model = server.post("/v1/models", &body).expect(200);
    prints(
        &model,
        &[
            ("log(centroid_size)", "28.5232"),
            ("sex", "15.4933"),
            ("population", "15.5860"),
            ("sex:population", "6.0105"),
        ],
    );
    let size = json!({"cohort": "landmarks-pupfish", "formula": "~ sex", "response": "centroid_size", "permutations": 99});
    let model = server.post("/v1/models", &size).expect(200);
    assert!(model["pooled"].is_null() && model["predictions"][0]["value"].is_f64(), "{model}");
}

/// Landmarks that depend on a group, and vary about it.
fn shape(k: usize, bend: f64) -> Value {
    let noise = |i: usize| 0.05 * ((7 * k * k + 13 * i + 3) as f64).sin();
    let points: Vec<[f64; 2]> = (0..6)
        .map(|i| {
            let t = std::f64::consts::TAU * i as f64 / 6.0;
            [2.0 * t.cos() + noise(i), t.sin() + bend * (2.0 * t).cos() + noise(i + 6)]
        })
        .collect();
    json!(points)
}

/// 24 shapes of six subjects on two days, a treatment of half of the subjects, and their ages.
pub(crate) fn made(server: &Server) {
    let representation = json!({"kind": "landmarks", "dimension": 2, "points": 6});
    server.post("/v1/cohorts", &json!({"name": "made", "representation": representation})).expect(201);
    let shapes: Vec<Value> = (0..24)
        .map(|k| {
            let (subject, day) = (k / 4, k % 2);
            let treatment = if subject < 3 { "control" } else { "drug" };
            json!({"external_id": format!("s{k}"), "subject": format!("p{subject}"), "points": shape(k, 0.1 * day as f64),
                "labels": {"day": format!("d{day}"), "treatment": treatment, "age": 40 + 3 * subject + k % 3, "one": "a",
                    "site": if k < 12 { "x" } else { "y" }}})
        })
        .collect();
    server.post("/v1/cohorts/made/shapes", &json!({"shapes": shapes})).expect(201);
}

#[test]
fn subjects_are_blocks() {
    let server = Server::fresh();
    made(&server);
    let ask = |further: Value| {
        let mut body = json!({"cohort": "made", "formula": "~ treatment + day", "permutations": 999});
        body.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
        server.post("/v1/models", &body).expect(200)
    };
    let free = ask(json!({}));
    assert!(free["warnings"].to_string().contains("subject"), "{free}");
    let blocks = ask(json!({"blocks": "subject"}));
    let terms = &blocks["terms"];
    assert_eq!((&terms[0]["exchange"], &terms[1]["exchange"]), (&json!("whole"), &json!("within")));
    // Three of six subjects: twenty exchanges, all of which are made.
    assert_eq!(
        (&terms[0]["distinct"], &terms[0]["exact"], &terms[0]["permutations"]),
        (&json!(20.0), &json!(true), &json!(19))
    );
    assert!(!blocks["warnings"].to_string().contains("one subject"), "{blocks}");
    // Terms that are constant in the groups of a random part are tested on their averages.
    let random = ask(json!({"formula": "~ treatment + day + (1 | subject)"}));
    let term = &random["terms"][0];
    assert_eq!(
        (&term["error_term"], &term["collapsed"], &term["exact"]),
        (&json!("subject"), &json!(true), &json!(true))
    );
    // The others within the groups, which are in the model besides.
    let day = &random["terms"][1];
    assert_eq!((&day["error_term"], &day["exchange"]), (&Value::Null, &json!("within")));
    let groups = &random["terms"][2];
    assert_eq!((&groups["term"], &groups["df"]), (&json!("(1 | subject)"), &json!(4)));
    let fixed = ask(json!({"formula": "~ treatment/subject + day", "blocks": "subject"}));
    let day_of = |model: &Value| {
        let terms = model["terms"].as_array().unwrap().clone();
        terms.into_iter().find(|term| term["term"] == "day").unwrap()
    };
    assert!((number(&day["f"]) - number(&day_of(&fixed)["f"])).abs() < 1e-9, "{fixed}");
    assert_eq!((&random["residual"]["df"], &fixed["residual"]["df"]), (&json!(17), &json!(17)));
    let nested = ask(
        json!({"formula": "~ treatment/subject + day", "error_terms": {"treatment": "treatment:subject"}}),
    );
    assert_eq!(nested["terms"][0]["f"], term["f"], "the same averages");
    // The same bits again, and as a job.
    let body =
        json!({"cohort": "made", "formula": "~ treatment*day + age", "permutations": 20_000, "seed": 7});
    let once = server.post("/v1/models", &body).expect(200);
    assert_eq!(server.post("/v1/models", &body).expect(200)["terms"], once["terms"]);
}

#[test]
fn what_is_no_model_is_refused_at_its_place() {
    let server = Server::fresh();
    made(&server);
    let body = json!({"cohort": "made", "formula": "~ treatment*day + age", "permutations": 9});
    server.post("/v1/models", &body).expect(200);
    let refused = |changes: &[(&str, Value)], pointer: &str, said: &str| {
        let mut body = body.clone();
        changes.iter().for_each(|(name, value)| body[name] = value.clone());
        let problem = server.post("/v1/models", &body).expect(422);
        let first = &problem["errors"][0];
        assert!(
            first["pointer"] == pointer && first["detail"].as_str().unwrap().contains(said),
            "{changes:?}: {problem}"
        );
    };
    for (formula, said) in [
        ("~ treatment +", "got the end at character 14"),
        ("~ sin(age)", "log, sqrt, factor, I or poly"),
        ("~ colour", "none of the 24 shapes has colour"),
        ("~ 1", "at least one term"),
        ("~ one", "at least two levels, got one for 'one': a"),
        ("~ log(treatment)", "expected numbers for 'log(treatment)', got texts"),
    ] {
        refused(&[("formula", json!(formula))], "/formula", said);
    }
    refused(
        &[("formula", json!("~ poly(labels.age,5)*subject*day"))],
        "/filter",
        "no degree of freedom is left",
    );
    refused(&[("response", json!("labels.treatment"))], "/response", "whose values are numbers");
    refused(&[("at", json!([{"treatment": "placebo"}]))], "/at/0/treatment", "'control', 'drug'");
    refused(&[("at", json!([{"day": "d0"}, {"site": "x"}]))], "/at/1/site", "an attribute of the formula");
    refused(&[("error_terms", json!({"treatment": "age"}))], "/error_terms", "contains 'treatment'");
    refused(&[("levels", json!({"treatment": ["control"]}))], "/levels/treatment", "got 'drug'");
    refused(&[("levels", json!({"colour": ["red"]}))], "/levels", "got 'colour'");
    refused(&[("exchange", json!("whole"))], "/exchange", "expected `blocks`");
    let inside = [("formula", json!("~ treatment + (1 | subject)")), ("strata", json!("labels.day"))];
    refused(&inside, "/strata", "equal within the groups of subject");
    refused(&[("permutations", json!(100_001))], "/permutations", "got 100001");
    let three = |formula: &str| [("formula", json!(formula)), ("type", json!("III"))];
    refused(&three("~ treatment*age"), "/type", "both sides of zero for 'age'");
    refused(&three("~ site*treatment"), "/type", "every combination of levels");
    let collinear = [("formula", json!("~ site + treatment")), ("collinear", json!("refuse"))];
    refused(&collinear, "/formula", "linearly independent");
    // An alias is told, not refused.
    let aliased = json!({"cohort": "made", "formula": "~ site + treatment", "type": "I", "permutations": 99});
    let aliased = server.post("/v1/models", &aliased).expect(200);
    let term = &aliased["terms"][1];
    assert_eq!((&term["df"], &term["f"], &term["p"]), (&json!(0), &Value::Null, &Value::Null));
    assert_eq!(term["aliased_with"], json!(["sitey"]), "{aliased}");
}

#[test]
fn random_parts_are_estimated() {
    let server = Server::fresh();
    made(&server);
    let ask = |further: Value| {
        let mut body =
            json!({"cohort": "made", "formula": "~ treatment + day + (1 | subject)", "permutations": 99});
        body.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
        server.post("/v1/models", &body)
    };
    let usual = ask(json!({})).expect(200)["random"].clone();
    assert_eq!(
        (&usual["part"], &usual["structure"], &usual["method"], &usual["groups"]),
        (&json!("(1 | subject)"), &json!("scalar"), &json!("reml"), &json!(6))
    );
    let (between, within) =
        (number(&usual["variance"]["between"][0][0]), number(&usual["variance"]["within"]));
    assert!((number(&usual["icc"]) - between / (between + within)).abs() < 1e-12, "{usual}");
    assert!(usual.get("subjects").is_none() && usual["coefficients"].as_array().unwrap().len() == 3);
    // The same as for the same number without groups' scatter: maximum likelihood is smaller.
    let ml = ask(json!({"random": {"method": "ml"}})).expect(200)["random"].clone();
    assert!(number(&ml["variance"]["within"]) < within, "{ml}");
    let full = ask(json!({"random": {"structure": "full", "components": 2, "subjects": true}})).expect(200);
    let full = &full["random"];
    assert_eq!((full["between"].as_array().unwrap().len(), &full["components"]), (2, &json!(2)));
    let subject = &full["subjects"][5];
    assert_eq!((&subject["group"], &subject["shapes"]), (&json!("p5"), &json!(4)));
    assert_eq!(subject["shape"].as_array().unwrap().len(), 6);
    // Slopes by score; what varies between the subjects is tested on them.
    let slopes = ask(json!({"formula": "~ age + treatment + (age | subject)"})).expect(200);
    assert_eq!(slopes["random"]["effects"], json!(["(Intercept)", "age"]));
    assert_eq!(slopes["random"]["structure"], "by_score");
    assert!(slopes["random"]["icc"].is_null() && !slopes["random"]["scores"].as_array().unwrap().is_empty());
    let age = &slopes["terms"][0];
    assert_eq!((&age["exchange"], &age["collapsed"]), (&json!("signs"), &json!(true)), "{slopes}");
    // Several parts are told where nothing is asked.
    let told = ask(json!({"formula": "~ day + (1 | site/subject)"})).expect(200);
    assert!(
        told.get("random").is_none() && told["warnings"].to_string().contains("one random part"),
        "{told}"
    );
    for (random, said) in [
        (json!({"structure": "full", "components": 15}), "at most"),
        (json!({"structure": "scalar"}), "by_score"),
    ] {
        let formula = if said == "by_score" { "~ age + (age | subject)" } else { "~ day + (1 | subject)" };
        let problem = ask(json!({"formula": formula, "random": random})).expect(422);
        assert_eq!(problem["errors"][0]["pointer"], "/random", "{problem}");
        assert!(problem["errors"][0]["detail"].as_str().unwrap().contains(said), "{problem}");
    }
    let problem = ask(json!({"random": {"components": 21}})).expect(422);
    assert_eq!(problem["errors"][0]["pointer"], "/random/components", "{problem}");
    ask(json!({"random": {"structure": "diagonal"}})).expect(422);
}

#[test]
fn models_know_covariances_scores_and_other_statistics() {
    let server = Server::fresh();
    made(&server);
    let body = json!({"cohort": "made", "formula": "~ treatment + day", "permutations": 99});
    let ask = |further: Value| {
        let mut body = body.clone();
        body.as_object_mut().unwrap().extend(further.as_object().unwrap().clone());
        server.post("/v1/models", &body)
    };
    let plain = ask(json!({})).expect(200);
    // A star of equal branches has no covariance.
    let star: Vec<String> = (0..24).map(|k| format!("s{k}:2")).collect();
    let tree = |tips: &[String]| format!("({});", tips.join(","));
    let known = ask(json!({"covariance": {"tree": tree(&star)}})).expect(200);
    for (a, b) in plain["terms"].as_array().unwrap().iter().zip(known["terms"].as_array().unwrap()) {
        assert!((number(&a["f"]) - number(&b["f"])).abs() < 1e-8 * number(&a["f"]), "{a} {b}");
        assert!((number(&a["sum_of_squares"]) / 2.0 - number(&b["sum_of_squares"])).abs() < 1e-9);
        assert_eq!(a["p"], b["p"]);
    }
    let pairs: Vec<String> = (0..12).map(|k| format!("(s{}:1,s{}:1):1", 2 * k, 2 * k + 1)).collect();
    let related = ask(json!({"covariance": {"tree": tree(&pairs)}})).expect(200);
    assert_ne!(related["terms"][0]["f"], plain["terms"][0]["f"]);
    let refused = |further: Value, pointer: &str, said: &str| {
        let problem = ask(further).expect(422);
        let first = &problem["errors"][0];
        assert!(first["pointer"] == pointer && first["detail"].as_str().unwrap().contains(said), "{problem}");
    };
    refused(json!({"covariance": {"tree": tree(&star[..23])}}), "/covariance", "none for 's23'");
    refused(json!({"covariance": {"tree": "(a:1,b);"}}), "/covariance", "at character 7");
    refused(json!({"covariance": {"tree": tree(&star), "by": "subject"}}), "/covariance", "none for 'p0'");
    refused(json!({"covariance": {"by": "subject"}}), "/covariance", "names and rows, or a tree");
    let random = json!({"covariance": {"tree": tree(&star)}, "formula": "~ day + (1 | subject)"});
    refused(random, "/covariance", "without random parts");
    // Scores: shapes within a plane of their space.
    let scores = ask(json!({"response": "score 1..2"})).expect(200);
    let part = number(&scores["total"]["sum_of_squares"]) / number(&plain["total"]["sum_of_squares"]);
    assert!((0.1..1.0).contains(&part) && scores["predictions"][0]["shape"].is_array(), "{part}");
    let all = ask(json!({"response": "score 1..6"})).expect(200);
    assert!((number(&all["terms"][0]["f"]) - number(&plain["terms"][0]["f"])).abs() < 1e-6, "{all}");
    refused(json!({"response": "score 0"}), "/response", "'score 1..3'");
    refused(json!({"response": "score 1..99"}), "/response", "at most");
    let manova = ask(json!({"manova": {"components": 2}})).expect(200)["manova"].clone();
    assert_eq!((&manova["components"], manova["terms"].as_array().unwrap().len()), (&json!(2), 2));
    let pillai = &manova["terms"][1]["pillai"];
    assert!((0.0..1.0).contains(&number(&pillai["value"])) && number(&pillai["p"]) >= 0.01, "{manova}");
    refused(json!({"manova": {"components": 101}}), "/manova/components", "1 to 100");
    refused(json!({"manova": {"components": 20}}), "/manova", "at most");
    let nested = json!({"formula": "~ treatment/subject", "error_terms": {"treatment": "treatment:subject"},
        "compatibility": "rrpp"});
    let nested = ask(nested).expect(200);
    assert!(
        nested["terms"][0]["rrpp"]["p"].is_number() && nested["terms"][1].get("rrpp").is_none(),
        "{nested}"
    );
}

#[test]
fn repeated_shapes_have_a_repeatability() {
    let server = Server::fresh();
    made(&server);
    let body = json!({"cohort": "made", "replicate": "day", "permutations": 99, "bootstrap": 100});
    let found = server.post("/v1/repeatability", &body).expect(200);
    assert_eq!(
        (&found["subjects"], &found["subject"], &found["bootstrap"]),
        (&json!(6), &json!("subject"), &json!(100))
    );
    let icc = &found["icc"];
    assert!(
        number(&icc["low"]) <= number(&icc["value"]) && number(&icc["value"]) <= number(&icc["high"]),
        "{icc}"
    );
    // Two shapes of each day: no complete replicates, but their systematic difference.
    assert!(found["agreement"].is_null() && found["map"].as_array().unwrap().len() == 6, "{found}");
    let rows = found["measurement_error"].as_array().unwrap();
    assert_eq!((&rows[0]["term"], &rows[1]["term"]), (&json!("subject"), &json!("replicate")));
    assert_eq!((&rows[1]["exchange"], &rows[1]["p"]), (&json!("within"), &json!(0.01)));
    assert_eq!(found["replicates"][1]["replicate"], "d1");
    let groups = json!({"cohort": "made", "replicate": "day", "groups": "treatment", "permutations": 9});
    let grouped = server.post("/v1/repeatability", &groups).expect(200);
    assert_eq!(grouped["measurement_error"][2]["term"], "group:replicate");
    let picture = server.post("/v1/repeatability?format=svg", &body);
    assert!(picture.expect_svg().contains("part of the variance within subjects"));
    for (changes, pointer, said) in [
        (json!({"subject": "colour"}), "/subject", "none of the 24 shapes has colour"),
        (json!({"subject": "label"}), "/subject", "label"),
        (json!({"groups": "day"}), "/subject", "one group"),
        (json!({"bootstrap": 10_001}), "/bootstrap", "got 10001"),
        (json!({"samples": 7}), "/samples", "got 7"),
        (json!({"replicate": null, "groups": "treatment"}), "/groups", "`replicate`"),
    ] {
        let mut body = body.clone();
        body.as_object_mut().unwrap().extend(changes.as_object().unwrap().clone());
        if body["replicate"].is_null() {
            body.as_object_mut().unwrap().remove("replicate");
        }
        let problem = server.post("/v1/repeatability", &body).expect(422);
        let first = &problem["errors"][0];
        assert!(
            first["pointer"] == pointer && first["detail"].as_str().unwrap().contains(said),
            "{changes}: {problem}"
        );
    }
}
